//! Tests of reading photographs and masks, on files made here.

use super::*;
use crate::codec::test_data::{exif, exr_bytes, input_error, jpeg_with_orientation, write_exr};
use glam::Vec3;
use image::{GrayImage, ImageBuffer, ImageFormat, Luma, Rgb, Rgba, RgbaImage};
use std::{fs, path::PathBuf};
use tempfile::TempDir;
use tiff::encoder::colortype::{Gray8, Gray16, Gray32Float, RGB8, RGB16, RGB32Float, RGBA8};
use tiff::encoder::{Compression, DeflateLevel, TiffEncoder};
use tiff::tags::Tag;

fn folder() -> (TempDir, impl Fn(&str) -> PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let base = dir.path().to_owned();
    (dir, move |name: &str| base.join(name))
}

/// The problem that a file has in its header, whatever it is read as.
fn header_problem(path: PathBuf) -> String {
    let of_header = input_error(image_header(&path));
    assert_eq!(of_header, input_error(read(path.clone())));
    assert_eq!(of_header, input_error(read_mask(&path, Orientation::AsStored)));
    of_header
}

/// A photograph's picture, upright, in sRGB.
fn read(path: PathBuf) -> Result<LoadedImage> {
    read_image(path, Gamma::Srgb, Orientation::Upright)
}

/// The stored values themselves.
fn read_linear(path: PathBuf) -> LoadedImage {
    read_image(path, Gamma::Linear, Orientation::Upright).unwrap()
}

fn stored(path: PathBuf) -> ImageSamples {
    decode_samples(path, Orientation::Upright).unwrap().samples
}

#[test]
fn integers_become_linear_light_on_black_and_saturation_is_marked() {
    let (_dir, at) = folder();
    let image = RgbImage::from_fn(2, 1, |x, _| if x == 0 { Rgb([188, 0, 10]) } else { Rgb([3, 255, 4]) });
    image.save(at("a.png")).unwrap();
    let loaded = read(at("a.png")).unwrap();
    assert!((loaded.image.pixels[0].x - 0.502_886_5).abs() < 1e-5);
    assert_eq!(loaded.image.pixels[1].y, 1.0);
    let LoadedImage { saturated, alpha, repairs, .. } = loaded;
    assert_eq!((saturated, alpha, repairs), (vec![false, true], None, Repairs::default()));
    for (gamma, expected) in [(Gamma::Power(2.0), (188.0f32 / 255.0).powi(2)), (Gamma::Linear, 188.0 / 255.0)]
    {
        let loaded = read_image(at("a.png"), gamma, Orientation::Upright).unwrap();
        assert!((loaded.image.pixels[0].x - expected).abs() < 1e-6);
    }
    let straight = vec![100, 50, 0, 51, 255, 255, 255, 0];
    RgbaImage::from_raw(2, 1, straight).unwrap().save(at("a.png")).unwrap();
    let loaded = read_linear(at("a.png"));
    assert!(loaded.image.pixels[0].distance(Vec3::new(100.0, 50.0, 0.0) / 255.0 * 0.2) < 1e-6);
    assert_eq!((loaded.image.pixels[1], loaded.alpha), (Vec3::ZERO, Some(vec![0.2, 0.0])));
    assert_eq!(loaded.saturated, [false, false], "what is not covered cannot be saturated");
    let deep: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_raw(2, 1, vec![65535u16, 32768]).unwrap();
    deep.save(at("a.png")).unwrap();
    let loaded = read_linear(at("a.png"));
    assert_eq!(loaded.image.pixels, [Vec3::ONE, Vec3::splat(32768.0 / 65535.0)]);
    assert_eq!(loaded.saturated, [true, false]);
    let color: ImageBuffer<Rgba<u16>, _> = ImageBuffer::from_raw(1, 1, vec![65534u16, 0, 1, 65535]).unwrap();
    color.save(at("a.png")).unwrap();
    let loaded = read_linear(at("a.png"));
    assert_eq!((loaded.image.pixels[0].x, loaded.saturated), (65534.0 / 65535.0, vec![false]));
}

#[test]
fn cut_files_give_an_error_or_the_whole_picture() {
    let (_dir, at) = folder();
    let image = RgbImage::from_fn(24, 24, |x, y| Rgb([(x * 10) as u8, (y * 10) as u8, (x * y) as u8]));
    let deflate = Compression::Deflate(DeflateLevel::Fast);
    let tiff = tiff_bytes(deflate, |encoder| encoder.write_image::<Gray8>(4, 2, &[9; 8]).unwrap());
    let jpeg = encode_jpeg(&image, 75).unwrap();
    let png = encode_png(image.as_raw(), [24, 24], ExtendedColorType::Rgb8).unwrap();
    let exr = exr_bytes(4, 40, &["R", "G", "B"].map(|name| (name, vec![0.25; 160])));
    for (name, bytes) in
        [("a.jpg", &jpeg[..]), ("a.png", &png), ("a.tif", &tiff), ("a.webp", &LOSSY_WEBP), ("a.exr", &exr)]
    {
        fs::write(at(name), bytes).unwrap();
        let whole = read(at(name)).unwrap();
        for length in (1..bytes.len() - 4).step_by(if bytes.len() > 200 { 3 } else { 1 }) {
            fs::write(at(name), &bytes[..length]).unwrap();
            match read(at(name)) {
                Ok(loaded) => assert_eq!(loaded, whole, "{name} cut to {length} of {}", bytes.len()),
                Err(error) => assert!(matches!(error, Error::Input { .. }), "{error:?}"),
            }
        }
        fs::write(at(name), &bytes[..bytes.len() * 9 / 10]).unwrap();
        assert!(read(at(name)).is_err());
    }
    // A thumbnail, which has an end marker of its own, does not hide a cut.
    let mut bytes = jpeg_with_orientation(1);
    bytes.splice(2..2, [0xff, 0xe2, 0, 6, 0xff, 0xd8, 0xff, 0xd9]);
    fs::write(at("a.jpg"), &bytes).unwrap();
    read(at("a.jpg")).unwrap();
    fs::write(at("a.jpg"), &bytes[..bytes.len() - 2]).unwrap();
    assert!(input_error(read(at("a.jpg"))).contains("its end is missing"));
}

#[test]
fn exr_pixels_are_taken_as_stored_whatever_the_gamma() {
    let (_dir, at) = folder();
    let channels =
        [("A", vec![0.5, 2.0]), ("B", vec![0.1, 0.2]), ("G", vec![3.0, -0.4]), ("R", vec![5.0, 0.0])];
    write_exr(&at("a.exr"), 2, 1, &channels);
    let loaded = read(at("a.exr")).unwrap();
    assert_eq!(loaded.image.pixels, [Vec3::new(5.0, 3.0, 0.1), Vec3::new(0.0, -0.4, 0.2)]);
    assert_eq!(loaded.alpha.unwrap(), [0.5, 1.0]);
    assert_eq!(loaded.saturated, [false, false]);
    assert!(loaded.is_float);
    write_exr(&at("gray.exr"), 2, 1, &[("Y", vec![0.5, 2.0])]);
    assert_eq!(read(at("gray.exr")).unwrap().image.pixels, [Vec3::splat(0.5), Vec3::splat(2.0)]);
    write_exr(&at("depth.exr"), 2, 1, &[("Z", vec![0.5, 2.0])]);
    assert!(input_error(read(at("depth.exr"))).contains("the file has Z"));
}

#[test]
fn nan_and_infinity_are_set_to_zero_counted_and_left_out() {
    let (_dir, at) = folder();
    let channels = [
        ("R", vec![1.0, f32::NAN, 1.0, 1.0]),
        ("G", vec![1.0, 1.0, f32::INFINITY, 1.0]),
        ("B", vec![1.0; 4]),
        ("A", vec![1.0, 1.0, 1.0, f32::NAN]),
    ];
    write_exr(&at("a.exr"), 4, 1, &channels);
    let loaded = read(at("a.exr")).unwrap();
    assert_eq!((loaded.repairs.not_finite, loaded.repairs.pixels), (3, vec![1, 2, 3]));
    assert_eq!(loaded.saturated, [false, true, true, true]);
    assert_eq!(loaded.image.pixels, [Vec3::ONE, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO]);
    assert_eq!(loaded.alpha.unwrap(), [1.0, 1.0, 1.0, 0.0]);
    write_exr(&at("nan.exr"), 2, 1, &["R", "G", "B"].map(|name| (name, vec![f32::NAN; 2])));
    assert!(input_error(read(at("nan.exr"))).contains("every pixel is NaN or infinite"));
}

#[test]
fn files_that_are_not_read_are_named_with_what_to_do() {
    let (_dir, at) = folder();
    let plain = Compression::Uncompressed;
    let tiff = tiff_bytes(plain, |encoder| encoder.write_image::<Gray8>(2, 1, &[0, 255]).unwrap());
    // A preview first, or the tag of DNG, whatever the name.
    let [preview, dng] = [(Tag::NewSubfileType, 1u32), (Tag::Unknown(50_706), 4)].map(|(tag, value)| {
        tiff_bytes(plain, |encoder| {
            let mut image = encoder.new_image::<Gray8>(2, 1).unwrap();
            image.encoder().write_tag(tag, value).unwrap();
            image.write_data(&[0, 255]).unwrap();
        })
    });
    let exr = exr_bytes(2, 2, &[("R", vec![0.0; 4])]);
    for (name, bytes, words) in [
        ("empty.exr", &b""[..], ["0 bytes", "Copy"]),
        ("text.exr", b"hello", ["neither PNG", "magick"]),
        ("cut.exr", &exr[..exr.len() / 2], ["damaged or truncated", "Copy"]),
        ("lfs.exr", b"version https://git-lfs.github.com/spec/v1", ["Git LFS", "git lfs pull"]),
        ("a.jpg", b"\0\0\0\x18ftypheic\0\0\0\0", ["a HEIC", "heif-convert"]),
        ("a.jpg", b"\0\0\0\x18ftypavif\0\0\0\0", ["an AVIF", "avifdec"]),
        ("a.jpg", b"\0\0\0\x18ftypisom\0\0\0\0", ["a video", "ffmpeg"]),
        ("a.jpg", b"GIF89a", ["a GIF", "magick"]),
        ("a.jpg", b"<!DOCTYPE html>", ["a web page", "Fetch"]),
        ("a.NEF", &tiff, ["RAW file", "darktable-cli"]),
        ("a.raf", b"FUJIFILMCCD-RAW 0201", ["RAW file", "darktable-cli"]),
        ("d.cr3.tif", b"\0\0\0\x18ftypcrx \0", ["RAW file", "darktable-cli"]),
        ("a.tif", &preview, ["RAW file", "darktable-cli"]),
        ("a.tif", &dng, ["RAW file", "darktable-cli"]),
        ("cmyk.tif", &bare_tiff(1, 1, &[(258, 8), (262, 5), (277, 4)], &[1, 2, 3, 4]), ["not read", "RGB"]),
        ("palette.tif", &bare_tiff(1, 1, &[(258, 8), (262, 3), (277, 1)], &[1]), ["not read", "RGB"]),
    ] {
        fs::write(at(name), bytes).unwrap();
        let problem = header_problem(at(name));
        assert!(words.iter().all(|word| problem.contains(word)), "{problem} should say {words:?}");
    }
    let problem = input_error(read(at("b.exr")));
    assert!(problem.contains("no such file") && problem.contains("The folder has"), "{problem}");
    // A name alone says nothing of a PNG.
    RgbImage::new(2, 2).save_with_format(at("png.dng"), ImageFormat::Png).unwrap();
    assert_eq!(image_header(at("png.dng")).unwrap().format, Format::Png);
}

#[test]
fn pictures_that_declare_more_than_is_read_or_than_they_hold_are_refused() {
    let (_dir, at) = folder();
    let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 900000 +X 900000\n".to_vec();
    let tiff = |side| bare_tiff(side, side, &[(258, 8), (262, 1), (277, 1)], &[1, 2, 3, 4]);
    let jpeg = |side: u16| {
        let mut bytes = jpeg_with_orientation(1);
        let frame = bytes.windows(4).position(|w| w == [0xff, 0xc0, 0, 17]).unwrap();
        bytes[frame + 5..frame + 9].copy_from_slice(&[side.to_be_bytes(), side.to_be_bytes()].concat());
        bytes
    };
    for (bytes, words) in [
        (hdr, "900000×900000"),
        (tiff(26_000), "26000×26000 pixels in 644 MiB, more than 16384×16384"),
        (tiff(16_000), "bytes can hold"),
        (jpeg(20_000), "20000×20000 pixels in"),
        (jpeg(12_000), "bytes can hold"),
        (jpeg(0), "damaged"),
    ] {
        fs::write(at("picture"), bytes).unwrap();
        let problem = header_problem(at("picture"));
        assert!(problem.contains(words), "{problem} should say {words}");
    }
}

/// A photograph as linear light.
fn photograph(path: &Path) -> Result<LoadedImage> {
    let (decoded, repairs) = decode_photograph(path, Orientation::Upright)?;
    Ok(linear_image(&decoded, repairs, Gamma::Srgb))
}

#[test]
fn absurdly_bright_pixels_are_set_to_zero_and_counted_or_refused() {
    let (_dir, at) = folder();
    let write = |bright: usize, value: f32| {
        let mut red = vec![0.5; 400];
        red[10..10 + bright].fill(value);
        write_exr(&at("a.exr"), 20, 20, &[("R", red), ("G", vec![0.5; 400]), ("B", vec![0.5; 400])]);
        photograph(&at("a.exr"))
    };
    for value in [1e38, 1e36, 2e6, -1e20] {
        let loaded = write(2, value).unwrap();
        assert_eq!((loaded.repairs.too_bright, loaded.repairs.pixels.clone()), (2, vec![10, 11]));
        assert_eq!((loaded.image.pixels[10], loaded.image.pixels[9]), (Vec3::ZERO, Vec3::splat(0.5)));
        assert!(loaded.saturated[10] && !loaded.saturated[9]);
    }
    assert_eq!(write(2, 65_504.0).unwrap().repairs.pixels.len(), 0);
    let problem = input_error(write(5, 1e38));
    assert!(problem.contains("5 of 400 pixels are absurdly bright"), "{problem}");
    assert!(problem.contains("Divide"), "{problem}");
}

#[test]
fn negative_pixels_are_set_to_zero_in_photographs() {
    let (_dir, at) = folder();
    write_exr(&at("a.exr"), 4, 1, &[("Y", vec![0.5, -0.01, 0.0, 0.25])]);
    let loaded = photograph(&at("a.exr")).unwrap();
    assert_eq!((loaded.repairs.negative, loaded.repairs.pixels.len()), (1, 0));
    assert_eq!(loaded.image.pixels.iter().map(|p| p.x).collect::<Vec<_>>(), [0.5, 0.0, 0.0, 0.25]);
    // Normals are read by the same code.
    let kept = read(at("a.exr")).unwrap();
    assert_eq!((kept.image.pixels[1].x, kept.repairs.negative), (-0.01, 1));
}

/// 4×2 pixels of green by a lossy encoder.
const LOSSY_WEBP: [u8; 68] = [
    0x52, 0x49, 0x46, 0x46, 0x3c, 0x00, 0x00, 0x00, 0x57, 0x45, 0x42, 0x50, 0x56, 0x50, 0x38, 0x20, 0x30,
    0x00, 0x00, 0x00, 0x10, 0x02, 0x00, 0x9d, 0x01, 0x2a, 0x04, 0x00, 0x02, 0x00, 0x01, 0x40, 0x26, 0x25,
    0xa0, 0x02, 0x74, 0xba, 0x01, 0xf8, 0x01, 0xf8, 0x00, 0x03, 0xc8, 0x00, 0xfe, 0xe7, 0x8b, 0xff, 0xfb,
    0x19, 0x88, 0x2b, 0x9a, 0xfc, 0x21, 0x7f, 0xf7, 0x79, 0xb0, 0x06, 0x12, 0xff, 0x84, 0x00, 0x00, 0x00,
];

fn tiff_bytes(
    compression: Compression,
    write: impl FnOnce(&mut TiffEncoder<&mut Cursor<Vec<u8>>>),
) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    write(&mut TiffEncoder::new(&mut bytes).unwrap().with_compression(compression));
    bytes.into_inner()
}

/// A TIFF by hand: one strip without compression, and these tags of one number each beside it.
fn bare_tiff(width: u32, height: u32, tags: &[(u16, u32)], strip: &[u8]) -> Vec<u8> {
    let mut entries: Vec<(u16, u32)> = vec![(256, width), (257, height), (259, 1), (278, height)];
    entries.extend([(279, strip.len() as u32)]);
    entries.extend(tags);
    entries.push((273, 8 + 2 + 12 * (entries.len() as u32 + 1) + 4));
    entries.sort_unstable();
    let mut bytes = b"II*\0\x08\0\0\0".to_vec();
    bytes.extend((entries.len() as u16).to_le_bytes());
    for (tag, value) in entries {
        bytes.extend(tag.to_le_bytes());
        bytes.extend([4, 0, 1, 0, 0, 0]);
        bytes.extend(value.to_le_bytes());
    }
    bytes.extend([0; 4]);
    bytes.extend(strip);
    bytes
}

#[test]
fn tiffs_of_every_kind_are_read() {
    let (_dir, at) = folder();
    let deep: Vec<u16> = (0..12).map(|i| i * 5000).collect();
    let flat: Vec<u8> = (0..12).map(|i| i * 20).collect();
    let floats = [0.5, 2.0, 0.1, 9.0, 0.0, 0.2];
    let mut kinds = Vec::new();
    for compression in
        [Compression::Uncompressed, Compression::Lzw, Compression::Deflate(DeflateLevel::Balanced)]
    {
        let words = tiff_bytes(compression, |encoder| encoder.write_image::<RGB16>(2, 2, &deep).unwrap());
        kinds.push((words, [2, 2, 3, 16], ImageSamples::Words16(deep.clone())));
        let bytes = tiff_bytes(compression, |encoder| encoder.write_image::<RGB8>(2, 2, &flat).unwrap());
        kinds.push((bytes, [2, 2, 3, 8], ImageSamples::Bytes8(flat.clone())));
    }
    let plain = Compression::Uncompressed;
    let gray = tiff_bytes(plain, |encoder| encoder.write_image::<Gray16>(2, 1, &[7, 9]).unwrap());
    kinds.push((gray, [2, 1, 1, 16], ImageSamples::Words16(vec![7, 9])));
    let rgb = tiff_bytes(plain, |encoder| encoder.write_image::<RGB32Float>(2, 1, &floats).unwrap());
    kinds.push((rgb, [2, 1, 3, 32], ImageSamples::Floats(floats.to_vec())));
    let gray = tiff_bytes(plain, |encoder| encoder.write_image::<Gray32Float>(2, 1, &floats[..2]).unwrap());
    kinds.push((gray, [2, 1, 1, 32], ImageSamples::Floats(vec![0.5, 2.0])));
    // 1 bit: rows of 10 pixels begin at whole bytes; 4 bit: two pixels in a byte.
    let bits = bare_tiff(10, 2, &[(258, 1), (262, 1), (277, 1)], &[0b1010_0000, 0b0100_0000, 0xff, 0xc0]);
    let widened = [&[255, 0, 255, 0, 0, 0, 0, 0, 0, 255][..], &[255; 10]].concat();
    kinds.push((bits, [10, 2, 1, 8], ImageSamples::Bytes8(widened)));
    let nibbles = bare_tiff(3, 1, &[(258, 4), (262, 1), (277, 1)], &[0x0f, 0x50]);
    kinds.push((nibbles, [3, 1, 1, 8], ImageSamples::Bytes8(vec![0, 255, 85])));
    for (bytes, [width, height, channels, bits], samples) in kinds {
        fs::write(at("a.tif"), bytes).unwrap();
        let header = image_header(at("a.tif")).unwrap();
        assert_eq!([header.width, header.height], [width, height]);
        assert_eq!([header.channels as u32, header.bits], [channels, bits]);
        assert_eq!(header.is_float, matches!(samples, ImageSamples::Floats(_)));
        assert_eq!(stored(at("a.tif")), samples);
    }
}

#[test]
fn alpha_of_tiffs_is_straight_or_already_multiplied_in() {
    let pixel = [100, 50, 0, 102];
    // ExtraSamples: 1 says multiplied in, 2 straight.
    for (kind, color) in [(2u16, [100.0, 50.0, 0.0]), (1, [250.0, 125.0, 0.0])] {
        let (_dir, at) = folder();
        let bytes = tiff_bytes(Compression::Uncompressed, |encoder| {
            let mut image = encoder.new_image::<RGBA8>(1, 1).unwrap();
            image.encoder().write_tag(Tag::ExtraSamples, kind).unwrap();
            image.write_data(&pixel).unwrap();
        });
        fs::write(at("a.tif"), bytes).unwrap();
        let loaded = read_linear(at("a.tif"));
        assert_eq!(loaded.alpha.unwrap(), [0.4]);
        let expected = Vec3::from_array(color) / 255.0 * 0.4;
        assert!(loaded.image.pixels[0].distance(expected) < 1e-5, "{kind}: {:?}", loaded.image.pixels);
    }
}

#[test]
fn webps_are_read_and_turned() {
    let (_dir, at) = folder();
    fs::write(at("a.webp"), LOSSY_WEBP).unwrap();
    let header = image_header(at("a.webp")).unwrap();
    assert_eq!((header.format, header.width, header.height, header.channels), (Format::Webp, 4, 2, 3));
    let green = Vec3::new(0.0, 192.0, 0.0) / 255.0;
    let pixels = read_linear(at("a.webp")).image.pixels;
    assert!(pixels.iter().all(|pixel| pixel.distance(green) < 0.03), "{pixels:?}");
    let write = |samples: &[u8], color, orientation| {
        let mut bytes = Vec::new();
        let mut encoder = image::codecs::webp::WebPEncoder::new_lossless(&mut bytes);
        encoder.set_exif_metadata(exif(orientation)).unwrap();
        encoder.write_image(samples, 2, 1, color).unwrap();
        fs::write(at("a.webp"), bytes).unwrap();
    };
    let rgba = [250, 9, 1, 255, 3, 4, 5, 51];
    write(&rgba, ExtendedColorType::Rgba8, 1);
    assert_eq!(stored(at("a.webp")), ImageSamples::Bytes8(rgba.to_vec()));
    let rgb = [1, 2, 3, 4, 5, 6];
    write(&rgb, ExtendedColorType::Rgb8, 6);
    let turned = decode_samples(at("a.webp"), Orientation::Upright).unwrap();
    assert_eq!([turned.header.width, turned.header.height], [1, 2]);
    assert_eq!(turned.samples, ImageSamples::Bytes8(rgb.to_vec()));
}

/// Gray values of 3×2 pixels as stored; EXIF says where row 0 and column 0 are seen.
const STORED: [u8; 6] = [10, 20, 30, 40, 50, 60];

/// Each EXIF orientation, with size and gray values of these pixels once they are turned upright.
const UPRIGHT: [(u8, [u32; 2], [u8; 6]); 8] = [
    (1, [3, 2], [10, 20, 30, 40, 50, 60]),
    (2, [3, 2], [30, 20, 10, 60, 50, 40]),
    (3, [3, 2], [60, 50, 40, 30, 20, 10]),
    (4, [3, 2], [40, 50, 60, 10, 20, 30]),
    (5, [2, 3], [10, 40, 20, 50, 30, 60]),
    (6, [2, 3], [40, 10, 50, 20, 60, 30]),
    (7, [2, 3], [60, 30, 50, 20, 40, 10]),
    (8, [2, 3], [30, 60, 20, 50, 10, 40]),
];

#[test]
fn every_orientation_is_turned_upright_or_left_as_stored() {
    let (_dir, at) = folder();
    for (turn, size, upright) in UPRIGHT {
        let tiff = tiff_bytes(Compression::Uncompressed, |encoder| {
            let mut image = encoder.new_image::<Gray8>(3, 2).unwrap();
            image.encoder().write_tag(Tag::Orientation, u16::from(turn)).unwrap();
            image.write_data(&STORED).unwrap();
        });
        fs::write(at("a.tif"), tiff).unwrap();
        let mut png = Vec::new();
        let mut encoder = image::codecs::png::PngEncoder::new(&mut png);
        encoder.set_exif_metadata(exif(turn)).unwrap();
        encoder.write_image(&STORED, 3, 2, ExtendedColorType::L8).unwrap();
        fs::write(at("a.png"), png).unwrap();
        for name in ["a.tif", "a.png"] {
            let header = image_header(at(name)).unwrap();
            assert_eq!((header.exif, header.width, header.height), (turn, 3, 2), "{name}");
            for (orientation, size, pixels) in
                [(Orientation::Upright, size, upright), (Orientation::AsStored, [3, 2], STORED)]
            {
                assert_eq!(header.size(orientation), size, "{name}, {turn}");
                let decoded = decode_samples(at(name), orientation).unwrap();
                assert_eq!([decoded.header.width, decoded.header.height], size, "{name}, {turn}");
                assert_eq!(decoded.samples, ImageSamples::Bytes8(pixels.to_vec()), "{name}, {turn}");
            }
            let mask = read_mask(at(name), Orientation::Upright).unwrap();
            assert_eq!([mask.width, mask.height], size);
        }
    }
}

#[test]
fn headers_of_jpegs_are_read_past_other_segments() {
    let (_dir, at) = folder();
    let mut bytes = jpeg_with_orientation(6);
    // A thumbnail with a frame of its own in another segment, and a fill byte.
    bytes.splice(2..2, [0xff, 0xe2, 0, 8, 0xff, 0xd8, 0xff, 0xc0, 0xff, 0xd9, 0xff]);
    fs::write(at("a.jpg"), &bytes).unwrap();
    let header = image_header(at("a.jpg")).unwrap();
    assert_eq!((header.exif, header.size(Orientation::Upright)), (6, [8, 16]));
    assert_eq!((header.channels, header.bits, header.is_float), (3, 8, false));
    let [upright, stored] = [Orientation::Upright, Orientation::AsStored]
        .map(|orientation| read_image(at("a.jpg"), Gamma::Linear, orientation).unwrap().image);
    assert_eq!(([upright.width, upright.height], [stored.width, stored.height]), ([8, 16], [16, 8]));
    assert!(stored.pixels[0].x > 0.9 && stored.pixels[15].x < 0.1);
    assert!(upright.pixels[7].x > 0.9 && upright.pixels[8 * 15].x < 0.1);
    GrayImage::new(8, 8).save(at("gray.jpg")).unwrap();
    assert_eq!(image_header(at("gray.jpg")).unwrap().channels, 1);
}

#[test]
fn masks_are_luma_or_alpha() {
    let (_dir, at) = folder();
    let mask = |name: &str| read_mask(at(name), Orientation::Upright).map(|mask| mask.coverage);
    GrayImage::from_raw(3, 1, vec![0, 51, 255]).unwrap().save(at("gray.png")).unwrap();
    assert_eq!(mask("gray.png").unwrap(), [0.0, 0.2, 1.0]);
    for (pixels, expected) in [
        (vec![0, 0, 0, 255, 0, 0, 0, 51], [1.0, 0.2]),
        (vec![255, 255, 255, 255, 0, 0, 0, 255], [1.0, 0.0]),
        (vec![0, 0, 0, 255, 0, 0, 0, 255], [0.0, 0.0]),
    ] {
        RgbaImage::from_raw(2, 1, pixels).unwrap().save(at("rgba.png")).unwrap();
        assert_eq!(mask("rgba.png").unwrap(), expected);
    }
    write_exr(&at("m.exr"), 2, 1, &[("Y", vec![0.25, 1.5])]);
    assert_eq!(mask("m.exr").unwrap(), [0.25, 1.0]);
    write_exr(&at("m.exr"), 2, 1, &[("Y", vec![0.25, f32::NAN])]);
    assert!(input_error(mask("m.exr")).contains("pixel (1, 0)"));
}

fn gray(at: &impl Fn(&str) -> PathBuf, values: &[u8]) -> Vec<f32> {
    let path = at("mask.png");
    GrayImage::from_raw(values.len() as u32, 1, values.to_vec()).unwrap().save(&path).unwrap();
    read_mask(path, Orientation::Upright).unwrap().coverage
}

#[test]
fn one_low_value_is_full_coverage() {
    let (_dir, at) = folder();
    for low in [1, 127, 254] {
        assert_eq!(gray(&at, &[0, low, low, 0]), [0.0, 1.0, 1.0, 0.0]);
    }
    // Edges between 0 and 127.
    let edged = gray(&at, &[0, 64, 127, 127, 126, 32]);
    assert_eq!(edged[2..4], [1.0, 1.0]);
    assert!((edged[1] - 64.0 / 127.0).abs() < 1e-6);
    assert_eq!(gray(&at, &[0, 204, 255, 0]), [0.0, 0.8, 1.0, 0.0]);
    // Soft coverage that has no one value is what it is.
    assert_eq!(gray(&at, &[40, 80, 120, 160, 200, 120, 80, 40])[4], 200.0 / 255.0);
    assert_eq!(gray(&at, &[0, 0]), [0.0, 0.0]);
}

/// A row of palette indices.
fn palette(path: &PathBuf, colors: &[[u8; 3]], indices: &[u8]) {
    let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), indices.len() as u32, 1);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(colors.concat());
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(indices).unwrap();
    writer.finish().unwrap();
}

#[test]
fn one_color_of_a_palette_is_full_coverage_and_several_are_refused() {
    let (_dir, at) = folder();
    let (black, red, green) = ([0, 0, 0], [128, 0, 0], [0, 128, 0]);
    palette(&at("p.png"), &[black, red, green], &[0, 1, 1, 0]);
    let coverage = || read_mask(at("p.png"), Orientation::Upright).unwrap().coverage;
    assert_eq!(coverage(), [0.0, 1.0, 1.0, 0.0]);
    // Colors count, not indices.
    palette(&at("p.png"), &[[255; 3], black], &[0, 1, 1, 0]);
    assert_eq!(coverage(), [1.0, 0.0, 0.0, 1.0]);
    palette(&at("p.png"), &[black, red, green], &[0, 1, 2, 0]);
    let problem = input_error(read_mask(at("p.png"), Orientation::Upright));
    assert!(problem.contains("2 colors") && problem.contains("white where the object is"), "{problem}");
}

#[test]
fn gray_labels_are_refused() {
    let (_dir, at) = folder();
    GrayImage::from_raw(4, 1, vec![0, 1, 2, 3]).unwrap().save(at("m.png")).unwrap();
    let problem = input_error(read_mask(at("m.png"), Orientation::Upright));
    assert!(problem.contains("values from 0 to 3"), "{problem}");
}

#[test]
fn noise_of_a_black_jpeg_is_no_object() {
    let (_dir, at) = folder();
    GrayImage::from_fn(16, 16, |x, _| Luma([u8::from(x > 7) * 3])).save(at("m.jpg")).unwrap();
    let mask = read_mask(at("m.jpg"), Orientation::Upright).unwrap();
    assert!(mask.coverage.iter().all(|&c| c < 0.03), "{mask:?}");
}

#[test]
fn the_alpha_of_a_cut_out_photograph_is_the_mask() {
    let (_dir, at) = folder();
    let cut = RgbaImage::from_fn(8, 8, |x, y| {
        if x < 4 { Rgba([30 * x as u8, 9 * y as u8, 200, 255]) } else { Rgba([0; 4]) }
    });
    cut.save(at("m.png")).unwrap();
    let coverage = read_mask(at("m.png"), Orientation::Upright).unwrap().coverage;
    assert!(coverage.iter().enumerate().all(|(i, &c)| c == if i % 8 < 4 { 1.0 } else { 0.0 }));
}
