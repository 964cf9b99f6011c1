//! Tests of headers and of turning by EXIF orientation.

use super::*;

#[test]
fn jpegs_are_turned_by_their_exif_orientation() {
    let (_dir, at) = folder();
    let corner = |orientation: u8, corner: fn(u32, u32) -> u32| {
        fs::write(at("a.jpg"), jpeg_with_orientation(orientation)).unwrap();
        let image = read_image(at("a.jpg"), Gamma::Linear, Orientation::Upright).unwrap().image;
        let value = image.pixels[corner(image.width, image.height) as usize].x;
        (image.width, image.height, value > 0.5)
    };
    type Corner = fn(u32, u32) -> u32;
    let (top_left, bottom_left): (Corner, Corner) = (|_, _| 0, |w, h| w * (h - 1));
    assert_eq!(corner(1, top_left), (16, 8, true));
    assert_eq!(corner(3, top_left), (16, 8, false));
    assert_eq!(corner(6, top_left), (8, 16, true));
    assert_eq!(corner(6, bottom_left), (8, 16, false));
    assert_eq!(corner(8, top_left), (8, 16, false));
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
    for (exif, size, upright) in UPRIGHT {
        let tiff = super::formats::tiff_bytes(|encoder| {
            let mut image = encoder.new_image::<tiff::encoder::colortype::Gray8>(3, 2).unwrap();
            image.encoder().write_tag(tiff::tags::Tag::Orientation, u16::from(exif)).unwrap();
            image.write_data(&STORED).unwrap();
        });
        fs::write(at("a.tif"), tiff).unwrap();
        fs::write(at("a.png"), png_with_orientation(&STORED, exif)).unwrap();
        for name in ["a.tif", "a.png"] {
            let header = image_header(at(name)).unwrap();
            assert_eq!((header.exif, header.width, header.height), (exif, 3, 2), "{name}");
            for (orientation, size, pixels) in
                [(Orientation::Upright, size, upright), (Orientation::AsStored, [3, 2], STORED)]
            {
                assert_eq!(header.size(orientation), size, "{name}, {exif}");
                let decoded = decode_samples(at(name), orientation).unwrap();
                assert_eq!([decoded.width, decoded.height], size, "{name}, {exif}");
                assert_eq!(decoded.samples, ImageSamples::Bytes8(pixels.to_vec()), "{name}, {exif}");
            }
            let mask = read_mask(at(name), Orientation::Upright).unwrap().mask;
            assert_eq!([mask.width, mask.height], size);
        }
    }
}

fn exif_chunk(orientation: u8) -> Vec<u8> {
    let mut chunk = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
    chunk.extend([orientation, 0, 0, 0, 0, 0, 0]);
    chunk
}

fn png_with_orientation(samples: &[u8; 6], orientation: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 3, 2);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    writer.write_chunk(png::chunk::eXIf, &exif_chunk(orientation)).unwrap();
    writer.write_image_data(samples).unwrap();
    writer.finish().unwrap();
    bytes
}

#[test]
fn headers_of_jpegs_are_read_past_other_segments() {
    let (_dir, at) = folder();
    for exif in 1..=8 {
        let mut bytes = jpeg_with_orientation(exif);
        // A thumbnail with a frame of its own in another segment, and a fill byte.
        bytes.splice(2..2, [0xff, 0xe2, 0, 8, 0xff, 0xd8, 0xff, 0xc0, 0xff, 0xd9, 0xff]);
        fs::write(at("a.jpg"), &bytes).unwrap();
        let header = image_header(at("a.jpg")).unwrap();
        let size = if exif < 5 { [16, 8] } else { [8, 16] };
        assert_eq!((header.exif, header.size(Orientation::Upright)), (exif, size));
        assert_eq!((header.channels, header.bits, header.is_float), (3, 8, false));
        let stored = read_image(at("a.jpg"), Gamma::Linear, Orientation::AsStored).unwrap().image;
        assert_eq!((stored.width, stored.height), (16, 8));
        assert!(stored.pixels[0].x > 0.9 && stored.pixels[15].x < 0.1);
    }
    GrayImage::new(8, 8).save(at("gray.jpg")).unwrap();
    assert_eq!(image_header(at("gray.jpg")).unwrap().channels, 1);
}

#[test]
fn headers_agree_with_what_is_decoded() {
    let (_dir, at) = folder();
    RgbaImage::new(5, 3).save(at("a.png")).unwrap();
    let deep: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_raw(2, 1, vec![65535u16, 13107]).unwrap();
    deep.save(at("deep.png")).unwrap();
    write_exr(&at("a.exr"), 4, 2, &[("Y", vec![0.5; 8]), ("A", vec![1.0; 8])]);
    fs::write(at("a.hdr"), hdr_bytes(3, 2, &[Vec3::ONE; 6])).unwrap();
    for (name, format, size, channels, bits, is_float) in [
        ("a.png", Format::Png, [5, 3], 4, 8, false),
        ("deep.png", Format::Png, [2, 1], 1, 16, false),
        ("a.exr", Format::Exr, [4, 2], 2, 32, true),
        ("a.hdr", Format::Hdr, [3, 2], 3, 32, true),
    ] {
        let [width, height] = size;
        let header = ImageHeader { format, width, height, channels, bits, is_float, exif: 1 };
        assert_eq!(image_header(at(name)).unwrap(), header);
        let decoded = decode_samples(at(name), Orientation::Upright).unwrap();
        assert_eq!((decoded.header, decoded.width, decoded.height), (header, width, height));
        assert_eq!(decoded.samples.count(), width as usize * height as usize * channels);
        assert_eq!(header.has_alpha(), channels.is_multiple_of(2));
    }
}
