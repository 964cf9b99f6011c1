//! Tests of TIFF and WebP.

use super::*;
use tiff::encoder::colortype::{Gray8, Gray16, Gray32Float, RGB8, RGB16, RGB32Float, RGBA8};
use tiff::encoder::{Compression, TiffEncoder};
use tiff::tags::Tag;

/// 4×2 pixels of green by a lossy encoder.
pub(super) const LOSSY_WEBP: [u8; 68] = [
    0x52, 0x49, 0x46, 0x46, 0x3c, 0x00, 0x00, 0x00, 0x57, 0x45, 0x42, 0x50, 0x56, 0x50, 0x38, 0x20, 0x30,
    0x00, 0x00, 0x00, 0x10, 0x02, 0x00, 0x9d, 0x01, 0x2a, 0x04, 0x00, 0x02, 0x00, 0x01, 0x40, 0x26, 0x25,
    0xa0, 0x02, 0x74, 0xba, 0x01, 0xf8, 0x01, 0xf8, 0x00, 0x03, 0xc8, 0x00, 0xfe, 0xe7, 0x8b, 0xff, 0xfb,
    0x19, 0x88, 0x2b, 0x9a, 0xfc, 0x21, 0x7f, 0xf7, 0x79, 0xb0, 0x06, 0x12, 0xff, 0x84, 0x00, 0x00, 0x00,
];

pub(super) fn tiff_bytes(write: impl FnOnce(&mut TiffEncoder<&mut Cursor<Vec<u8>>>)) -> Vec<u8> {
    tiff_compressed(Compression::Uncompressed, write)
}

fn tiff_compressed(
    compression: Compression,
    write: impl FnOnce(&mut TiffEncoder<&mut Cursor<Vec<u8>>>),
) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    write(&mut TiffEncoder::new(&mut bytes).unwrap().with_compression(compression));
    bytes.into_inner()
}

fn samples_of(bytes: &[u8]) -> (ImageHeader, ImageSamples) {
    let (_dir, at) = folder();
    fs::write(at("a.tif"), bytes).unwrap();
    let header = image_header(at("a.tif")).unwrap();
    let decoded = decode_samples(at("a.tif"), Orientation::Upright).unwrap();
    assert_eq!(decoded.header, header);
    (header, decoded.samples)
}

#[test]
fn tiffs_of_integers_are_read_with_every_compression() {
    let deep: Vec<u16> = (0..12).map(|i| i * 5000).collect();
    let flat: Vec<u8> = (0..12).map(|i| i * 20).collect();
    for compression in [
        Compression::Uncompressed,
        Compression::Lzw,
        Compression::Deflate(tiff::encoder::DeflateLevel::Balanced),
        Compression::Packbits,
    ] {
        let bytes =
            tiff_compressed(compression, |encoder| encoder.write_image::<RGB16>(2, 2, &deep).unwrap());
        let (header, samples) = samples_of(&bytes);
        assert_eq!((header.width, header.height, header.channels, header.bits), (2, 2, 3, 16));
        assert_eq!(
            (header.format, header.is_float, samples),
            (Format::Tiff, false, ImageSamples::Words16(deep.clone()))
        );
        let bytes = tiff_compressed(compression, |encoder| encoder.write_image::<RGB8>(2, 2, &flat).unwrap());
        assert_eq!(samples_of(&bytes).1, ImageSamples::Bytes8(flat.clone()));
    }
    let bytes = tiff_bytes(|encoder| encoder.write_image::<Gray16>(2, 1, &[7, 9]).unwrap());
    assert_eq!(samples_of(&bytes).1, ImageSamples::Words16(vec![7, 9]));
}

#[test]
fn tiffs_of_floats_are_linear() {
    let (_dir, at) = folder();
    let bytes = tiff_bytes(|encoder| {
        encoder.write_image::<RGB32Float>(2, 1, &[0.5, 2.0, 0.1, 9.0, 0.0, 0.2]).unwrap();
    });
    fs::write(at("a.tif"), bytes).unwrap();
    let loaded = read_image(at("a.tif"), Gamma::Srgb, Orientation::Upright).unwrap();
    assert!(loaded.is_float);
    assert_eq!(loaded.image.pixels, [Vec3::new(0.5, 2.0, 0.1), Vec3::new(9.0, 0.0, 0.2)]);
    let bytes = tiff_bytes(|encoder| encoder.write_image::<Gray32Float>(2, 1, &[0.5, f32::NAN]).unwrap());
    fs::write(at("a.tif"), bytes).unwrap();
    let loaded = read_image(at("a.tif"), Gamma::Srgb, Orientation::Upright).unwrap();
    assert_eq!((loaded.image.pixels[0], loaded.repairs.not_finite), (Vec3::splat(0.5), 1));
}

#[test]
fn alpha_of_tiffs_is_straight_or_already_multiplied_in() {
    let pixel = [100, 50, 0, 102];
    // ExtraSamples: 1 says multiplied in, 2 straight.
    for (kind, color) in [(2u16, [100.0, 50.0, 0.0]), (1, [250.0, 125.0, 0.0])] {
        let (_dir, at) = folder();
        let bytes = tiff_bytes(|encoder| {
            let mut image = encoder.new_image::<RGBA8>(1, 1).unwrap();
            image.encoder().write_tag(Tag::ExtraSamples, kind).unwrap();
            image.write_data(&pixel).unwrap();
        });
        fs::write(at("a.tif"), bytes).unwrap();
        let loaded = read_image(at("a.tif"), Gamma::Linear, Orientation::Upright).unwrap();
        assert_eq!(loaded.alpha.unwrap(), [0.4]);
        let expected = Vec3::from_array(color) / 255.0 * 0.4;
        assert!(loaded.image.pixels[0].distance(expected) < 1e-5, "{kind}: {:?}", loaded.image.pixels);
    }
}

/// A TIFF by hand: one strip without compression, and these tags of one number each beside it.
pub(super) fn bare_tiff(width: u32, height: u32, tags: &[(u16, u32)], strip: &[u8]) -> Vec<u8> {
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
fn gray_of_few_bits_is_widened() {
    // 1 bit: rows of 10 pixels begin at whole bytes; 4 bit: two pixels in a byte.
    let bits = bare_tiff(10, 2, &[(258, 1), (262, 1), (277, 1)], &[0b1010_0000, 0b0100_0000, 0xff, 0xc0]);
    let (header, samples) = samples_of(&bits);
    let mut expected = vec![255, 0, 255, 0, 0, 0, 0, 0, 0, 255];
    expected.extend([255; 10]);
    assert_eq!((header.bits, samples), (8, ImageSamples::Bytes8(expected)));
    let nibbles = bare_tiff(3, 1, &[(258, 4), (262, 1), (277, 1)], &[0x0f, 0x50]);
    assert_eq!(samples_of(&nibbles).1, ImageSamples::Bytes8(vec![0, 255, 85]));
}

#[test]
fn other_tiffs_are_refused_and_damage_never_panics() {
    let (_dir, at) = folder();
    let cmyk = bare_tiff(1, 1, &[(258, 8), (262, 5), (277, 4)], &[1, 2, 3, 4]);
    fs::write(at("a.tif"), cmyk).unwrap();
    let problem = problem_of(image_header(at("a.tif")));
    assert!(problem.contains("TIFF") && problem.contains("Save it as RGB"), "{problem}");
    let palette = bare_tiff(1, 1, &[(258, 8), (262, 3), (277, 1)], &[1]);
    fs::write(at("a.tif"), palette).unwrap();
    assert!(problem_of(image_header(at("a.tif"))).contains("this kind of TIFF is not read"));
    let deflate = Compression::Deflate(tiff::encoder::DeflateLevel::Fast);
    let whole = tiff_compressed(deflate, |encoder| encoder.write_image::<Gray8>(4, 2, &[9; 8]).unwrap());
    for at_byte in 0..whole.len() {
        fs::write(at("a.tif"), &whole[..at_byte]).unwrap();
        problem_of(read_image(at("a.tif"), Gamma::Srgb, Orientation::Upright));
        for value in [0, 0x7f, 0xff] {
            let mut bytes = whole.clone();
            bytes[at_byte] = value;
            fs::write(at("a.tif"), bytes).unwrap();
            if let Err(error) = read_image(at("a.tif"), Gamma::Srgb, Orientation::Upright) {
                assert!(matches!(error, Error::Input { .. }), "{error:?}");
            }
        }
    }
}

#[test]
fn lossy_webps_are_read() {
    let (_dir, at) = folder();
    fs::write(at("a.webp"), LOSSY_WEBP).unwrap();
    let header = image_header(at("a.webp")).unwrap();
    assert_eq!((header.format, header.width, header.height, header.channels), (Format::Webp, 4, 2, 3));
    let loaded = read_image(at("a.webp"), Gamma::Linear, Orientation::Upright).unwrap();
    let green = Vec3::new(0.0, 192.0, 0.0) / 255.0;
    assert!(
        loaded.image.pixels.iter().all(|pixel| pixel.distance(green) < 0.03),
        "{:?}",
        loaded.image.pixels
    );
}

#[test]
fn lossless_webps_are_read_exactly_and_turned() {
    let (_dir, at) = folder();
    let write = |samples: &[u8], color, exif: &[u8]| {
        let mut bytes = Vec::new();
        let mut encoder = image_webp::WebPEncoder::new(&mut bytes);
        encoder.set_exif_metadata(exif.to_vec());
        encoder.encode(samples, 2, 1, color).unwrap();
        fs::write(at("a.webp"), bytes).unwrap();
    };
    let rgba = [250, 9, 1, 255, 3, 4, 5, 51];
    write(&rgba, image_webp::ColorType::Rgba8, &[]);
    let decoded = decode_samples(at("a.webp"), Orientation::Upright).unwrap();
    assert_eq!((decoded.channels(), decoded.samples), (4, ImageSamples::Bytes8(rgba.to_vec())));
    let mut exif = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06".to_vec();
    exif.extend([0; 6]);
    write(&[1, 2, 3, 4, 5, 6], image_webp::ColorType::Rgb8, &exif);
    let header = image_header(at("a.webp")).unwrap();
    assert_eq!((header.exif, header.size(Orientation::Upright)), (6, [1, 2]));
    let turned = decode_samples(at("a.webp"), Orientation::Upright).unwrap();
    assert_eq!(
        ([turned.width, turned.height], turned.samples),
        ([1, 2], ImageSamples::Bytes8(vec![1, 2, 3, 4, 5, 6]))
    );
}

#[test]
fn contents_and_not_names_determine_the_format() {
    let (_dir, at) = folder();
    let image = RgbImage::from_fn(6, 4, |x, y| Rgb([40 * x as u8, 60 * y as u8, 9]));
    image.save(at("a.png")).unwrap();
    image.save(at("b.jpg")).unwrap();
    write_exr(&at("c.exr"), 6, 4, &["R", "G", "B"].map(|channel| (channel, vec![2.5; 24])));
    for (file, named, format) in [
        ("a.png", "a.jpg", Format::Png),
        ("a.png", "a.exr", Format::Png),
        ("b.jpg", "b.PNG", Format::Jpeg),
        ("b.jpg", "b.tif", Format::Jpeg),
        ("c.exr", "c.png", Format::Exr),
    ] {
        fs::copy(at(file), at(named)).unwrap();
        assert_eq!(image_header(at(named)).unwrap().format, format, "{named}");
        let [renamed, own] =
            [named, file].map(|name| read_image(at(name), Gamma::Srgb, Orientation::Upright).unwrap().image);
        assert_eq!(renamed.pixels, own.pixels, "{named}");
    }
    // The contents of what is not read are told, too.
    fs::write(at("d.jpg"), b"\0\0\0\x18ftypheic\0\0\0\0").unwrap();
    let problem = problem_of(read_image(at("d.jpg"), Gamma::Srgb, Orientation::Upright));
    assert!(problem.contains("this is a HEIC") && problem.contains("mogrify -format jpg"), "{problem}");
    // A RAW file is TIFF inside: its name counts.
    fs::write(at("e.nef"), b"II*\0\x08\0\0\0\0\0").unwrap();
    assert!(problem_of(image_header(at("e.nef"))).contains("RAW file"));
}
