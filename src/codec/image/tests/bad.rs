//! Tests of files that are refused, and of pixels that are repaired.

use super::*;

#[test]
fn wrong_files_are_named_with_help() {
    let (_dir, at) = folder();
    RgbImage::new(2, 2).save(at("a.png")).unwrap();
    fs::write(at("empty.exr"), "").unwrap();
    assert!(problem_of(read_image(at("empty.exr"), Gamma::Srgb, Orientation::Upright)).contains("0 bytes"));
    fs::write(at("text.exr"), "hello").unwrap();
    assert!(
        problem_of(read_image(at("text.exr"), Gamma::Srgb, Orientation::Upright)).contains("neither PNG")
    );
    fs::write(at("lfs.exr"), "version https://git-lfs.github.com/spec/v1").unwrap();
    assert!(
        problem_of(read_image(at("lfs.exr"), Gamma::Srgb, Orientation::Upright)).contains("git lfs pull")
    );
    let problem = problem_of(read_image(at("b.exr"), Gamma::Srgb, Orientation::Upright));
    assert!(problem.contains("no such file") && problem.contains("The folder has 3 .exr files"), "{problem}");
    assert!(problem_of(read_image(at(""), Gamma::Srgb, Orientation::Upright)).contains("folder"));
    let bytes = exr_bytes(2, 2, &[("R", vec![0.0; 4])]);
    fs::write(at("cut.exr"), &bytes[..bytes.len() / 2]).unwrap();
    assert!(problem_of(read_exr_layers(at("cut.exr"))).contains("damaged or truncated"));
}

#[test]
fn absurd_sizes_are_refused_before_memory_is_taken() {
    let (_dir, at) = folder();
    fs::write(at("a.hdr"), "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 900000 +X 900000\n").unwrap();
    assert!(problem_of(read_image(at("a.hdr"), Gamma::Srgb, Orientation::Upright)).contains("900000×900000"));
    RgbImage::new(2, 2).save(at("a.png")).unwrap();
    let mut bytes = fs::read(at("a.png")).unwrap();
    bytes[16..20].copy_from_slice(&[0x7f, 0, 0, 0]);
    fs::write(at("a.png"), bytes).unwrap();
    assert!(problem_of(read_image(at("a.png"), Gamma::Srgb, Orientation::Upright)).contains("16384×16384"));
}

#[test]
fn a_png_of_zero_width_is_an_error() {
    let (_dir, at) = folder();
    RgbImage::new(2, 2).save(at("a.png")).unwrap();
    let mut bytes = fs::read(at("a.png")).unwrap();
    bytes[16..20].copy_from_slice(&[0; 4]);
    fs::write(at("a.png"), bytes).unwrap();
    assert!(problem_of(read_image(at("a.png"), Gamma::Srgb, Orientation::Upright)).contains("damaged"));
}

fn header_problem(path: PathBuf) -> String {
    let of_header = problem_of(image_header(&path));
    assert_eq!(of_header, problem_of(read_image(&path, Gamma::Srgb, Orientation::Upright)));
    assert_eq!(of_header, problem_of(read_mask(&path, Orientation::AsStored)));
    of_header
}

/// A PNG of this size whose one chunk of pixels is empty.
fn png_declaring(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().unwrap();
    writer.write_chunk(png::chunk::IDAT, &[]).unwrap();
    drop(writer);
    bytes
}

#[test]
fn pngs_that_declare_more_than_is_read_or_than_they_hold_are_refused() {
    let (_dir, at) = folder();
    fs::write(at("a.png"), png_declaring(26_000, 26_000)).unwrap();
    let problem = header_problem(at("a.png"));
    assert!(problem.contains("26000×26000") && problem.contains("16384×16384"), "{problem}");
    fs::write(at("a.png"), png_declaring(16_000, 16_000)).unwrap();
    let problem = header_problem(at("a.png"));
    assert!(problem.contains("16000×16000") && problem.contains("bytes can hold"), "{problem}");
    fs::write(at("a.png"), png_declaring(u32::MAX >> 1, 1)).unwrap();
    assert!(header_problem(at("a.png")).contains("16384×16384"));
}

#[test]
fn jpegs_that_declare_more_than_is_read_or_than_they_hold_are_refused() {
    let (_dir, at) = folder();
    let declaring = |side: u16| {
        let mut bytes = jpeg_with_orientation(1);
        let frame = bytes.windows(4).position(|w| w == [0xff, 0xc0, 0, 17]).unwrap();
        bytes[frame + 5..frame + 7].copy_from_slice(&side.to_be_bytes());
        bytes[frame + 7..frame + 9].copy_from_slice(&side.to_be_bytes());
        fs::write(at("a.jpg"), bytes).unwrap();
        header_problem(at("a.jpg"))
    };
    assert!(declaring(20_000).contains("20000×20000 pixels, more than 16384×16384"));
    assert!(declaring(12_000).contains("bytes can hold"));
    assert!(declaring(0).contains("its size is 0×0"));
}

#[test]
fn tiffs_and_webps_that_declare_too_much_are_refused() {
    let (_dir, at) = folder();
    for (side, words) in [(26_000, "26000×26000 pixels, more than 16384×16384"), (16_000, "bytes can hold")]
    {
        let bytes = super::formats::bare_tiff(side, side, &[(258, 8), (262, 1), (277, 1)], &[1, 2, 3, 4]);
        fs::write(at("a.tif"), bytes).unwrap();
        assert!(header_problem(at("a.tif")).contains(words));
    }
    let lossy = super::formats::LOSSY_WEBP;
    for length in 0..lossy.len() - 4 {
        fs::write(at("a.webp"), &lossy[..length]).unwrap();
        problem_of(read_image(at("a.webp"), Gamma::Srgb, Orientation::Upright));
    }
}

#[test]
fn raw_files_are_refused_with_what_to_do() {
    let (_dir, at) = folder();
    let tiff = super::formats::tiff_bytes(|encoder| {
        encoder.write_image::<tiff::encoder::colortype::Gray8>(2, 1, &[0, 255]).unwrap();
    });
    for name in ["a.dng", "a.NEF", "a.arw", "a.cr2", "a.pef"] {
        fs::write(at(name), &tiff).unwrap();
        let problem = header_problem(at(name));
        assert!(problem.contains("RAW file") && problem.contains("darktable-cli"), "{problem}");
    }
    // A preview first, or the tag of DNG, whatever the name.
    for (tag, value) in [(tiff::tags::Tag::NewSubfileType, 1u32), (tiff::tags::Tag::Unknown(50_706), 4)] {
        let tagged = super::formats::tiff_bytes(|encoder| {
            let mut image = encoder.new_image::<tiff::encoder::colortype::Gray8>(2, 1).unwrap();
            image.encoder().write_tag(tag, value).unwrap();
            image.write_data(&[0, 255]).unwrap();
        });
        fs::write(at("a.tif"), tagged).unwrap();
        assert!(header_problem(at("a.tif")).contains("RAW file"));
    }
    for (name, start) in [
        ("a.raf", &b"FUJIFILMCCD-RAW 0201"[..]),
        ("b.orf", b"IIRO\x08\0\0\0"),
        ("c.rw2", b"IIU\0\x18\0\0\0"),
        ("d.cr3", b"\0\0\0\x18ftypcrx \0\0\0\x01"),
        ("e.crw", b"II\x1a\0\0\0HEAPCCDR"),
    ] {
        for name in [name.to_owned(), format!("{name}.tif")] {
            fs::write(at(&name), start).unwrap();
            assert!(header_problem(at(&name)).contains("RAW file"), "{name}");
        }
    }
    // A name alone says nothing of a PNG.
    RgbImage::new(2, 2).save_with_format(at("png.dng"), ImageFormat::Png).unwrap();
    image_header(at("png.dng")).unwrap();
}

#[test]
fn other_formats_are_named_with_the_tool_that_converts_them() {
    let (_dir, at) = folder();
    for (name, start, words) in [
        ("a.heic", &b"\0\0\0\x18ftypheic\0\0\0\0"[..], ["a HEIC", "heif-convert"]),
        ("b.heif", b"\0\0\0\x18ftypmif1\0\0\0\0", ["a HEIC", "heif-convert"]),
        ("c.avif", b"\0\0\0\x18ftypavif\0\0\0\0", ["an AVIF", "avifdec"]),
        ("d.mp4", b"\0\0\0\x18ftypisom\0\0\0\0", ["a video", "ffmpeg"]),
        ("d.webm", b"\x1a\x45\xdf\xa3\x01\0\0\0", ["a video", "lobelia prepare"]),
        ("e.jxl", b"\xff\x0a\0\0", ["a JPEG XL", "djxl"]),
        ("f.gif", b"GIF89a", ["a GIF", "magick"]),
        ("g.bmp", b"BM\0\0\0\0", ["a BMP", "magick"]),
        ("h.jpg", b"<!DOCTYPE html>", ["a web page", "Fetch"]),
        ("i.png", b"version https://git-lfs.github.com/spec/v1", ["Git LFS pointer", "git lfs pull"]),
    ] {
        fs::write(at(name), start).unwrap();
        let problem = header_problem(at(name));
        assert!(words.iter().all(|word| problem.contains(word)), "{name}: {problem}");
    }
}

/// A photograph as linear light.
fn photograph(path: &std::path::Path) -> Result<LoadedImage> {
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
    let problem = problem_of(write(5, 1e38));
    assert!(
        problem.contains("5 of 400 pixels are absurdly bright") && problem.contains("Divide"),
        "{problem}"
    );
}

#[test]
fn negative_pixels_are_set_to_zero_in_photographs_and_refused_if_most_are() {
    let (_dir, at) = folder();
    let write = |values: Vec<f32>| {
        let count = values.len();
        write_exr(&at("a.exr"), count, 1, &[("Y", values)]);
    };
    write(vec![0.5, -0.01, 0.0, 0.25]);
    let loaded = photograph(&at("a.exr")).unwrap();
    assert_eq!((loaded.repairs.negative, loaded.repairs.pixels.len()), (1, 0));
    assert_eq!(loaded.image.pixels.iter().map(|p| p.x).collect::<Vec<_>>(), [0.5, 0.0, 0.0, 0.25]);
    // Normals are read by the same code.
    let kept = read_image(at("a.exr"), Gamma::Srgb, Orientation::Upright).unwrap();
    assert_eq!((kept.image.pixels[1].x, kept.repairs.negative), (-0.01, 1));
    write(vec![-0.5, -0.01, 0.0, 0.25]);
    let problem = problem_of(photograph(&at("a.exr")));
    assert!(problem.contains("2 of 3 pixels that are not black are negative"), "{problem}");
    read_image(at("a.exr"), Gamma::Srgb, Orientation::Upright).unwrap();
}
