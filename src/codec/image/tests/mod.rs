//! Tests of reading photographs and masks, on files made here.

mod bad;
mod formats;
mod headers;
mod masks;

use super::*;
use crate::codec::exr::read_exr_layers;
use crate::codec::test_data::{exr_bytes, hdr_bytes, write_exr};
use crate::error::{Error, Result};
use glam::Vec3;
use image::{GrayAlphaImage, GrayImage, ImageBuffer, ImageFormat, Luma, Rgb, RgbImage, Rgba, RgbaImage};
use std::fs;
use std::io::Cursor;
use std::path::PathBuf;
use tempfile::TempDir;

fn folder() -> (TempDir, impl Fn(&str) -> PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let base = dir.path().to_owned();
    (dir, move |name: &str| base.join(name))
}

fn problem_of<T: std::fmt::Debug>(result: Result<T>) -> String {
    let error = result.unwrap_err();
    assert!(matches!(error, Error::Input { .. }), "{error:?}");
    assert_eq!(error.exit_code(), 2);
    format!("{error} | {}", error.help().unwrap_or_default())
}

#[test]
fn eight_bit_rgb_is_decoded_from_srgb_and_saturation_is_marked() {
    let (_dir, at) = folder();
    let image = RgbImage::from_fn(2, 1, |x, _| if x == 0 { Rgb([188, 0, 10]) } else { Rgb([3, 255, 4]) });
    image.save(at("a.png")).unwrap();
    let loaded = read_image(at("a.png"), Gamma::Srgb, Orientation::Upright).unwrap();
    assert!((loaded.image.pixels[0].x - 0.502_886_5).abs() < 1e-5);
    assert_eq!(loaded.image.pixels[1].y, 1.0);
    assert_eq!(
        (loaded.saturated, loaded.alpha, loaded.repairs),
        (vec![false, true], None, Repairs::default())
    );
    let power = read_image(at("a.png"), Gamma::Power(2.0), Orientation::Upright).unwrap();
    assert!((power.image.pixels[0].x - (188.0f32 / 255.0).powi(2)).abs() < 1e-6);
    let linear = read_image(at("a.png"), Gamma::Linear, Orientation::Upright).unwrap();
    assert!((linear.image.pixels[0].x - 188.0 / 255.0).abs() < 1e-6);
}

#[test]
fn impossible_gammas_are_usage_errors() {
    for exponent in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let error = read_image("never-read.png", Gamma::Power(exponent), Orientation::Upright).unwrap_err();
        assert!(matches!(error, Error::Usage { .. }), "{error:?}");
    }
}

#[test]
fn straight_alpha_is_multiplied_in() {
    let (_dir, at) = folder();
    let image =
        RgbaImage::from_fn(
            2,
            1,
            |x, _| if x == 0 { Rgba([100, 50, 0, 51]) } else { Rgba([255, 255, 255, 0]) },
        );
    image.save(at("a.png")).unwrap();
    let loaded = read_image(at("a.png"), Gamma::Linear, Orientation::Upright).unwrap();
    assert!(loaded.image.pixels[0].distance(Vec3::new(100.0, 50.0, 0.0) / 255.0 * 0.2) < 1e-6);
    assert_eq!(loaded.image.pixels[1], Vec3::ZERO);
    assert_eq!(loaded.alpha.unwrap(), [0.2, 0.0]);
    assert_eq!(loaded.saturated, [false, false], "what is not covered cannot be saturated");
}

#[test]
fn sixteen_bit_gray_and_gray_alpha_are_read() {
    let (_dir, at) = folder();
    let deep: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_raw(2, 1, vec![65535u16, 32768]).unwrap();
    deep.save(at("deep.png")).unwrap();
    let loaded = read_image(at("deep.png"), Gamma::Linear, Orientation::Upright).unwrap();
    assert_eq!(loaded.image.pixels, [Vec3::ONE, Vec3::splat(32768.0 / 65535.0)]);
    assert_eq!(loaded.saturated, [true, false]);
    let color: ImageBuffer<Rgba<u16>, _> = ImageBuffer::from_raw(1, 1, vec![65534u16, 0, 1, 65535]).unwrap();
    color.save(at("color.png")).unwrap();
    let loaded = read_image(at("color.png"), Gamma::Linear, Orientation::Upright).unwrap();
    assert_eq!((loaded.image.pixels[0].x, loaded.saturated), (65534.0 / 65535.0, vec![false]));
    GrayAlphaImage::from_raw(1, 1, vec![255, 51]).unwrap().save(at("ga.png")).unwrap();
    let loaded = read_image(at("ga.png"), Gamma::Linear, Orientation::Upright).unwrap();
    assert_eq!((loaded.image.pixels[0], loaded.alpha), (Vec3::splat(0.2), Some(vec![0.2])));
}

#[test]
fn palettes_are_expanded() {
    let (_dir, at) = folder();
    let file = fs::File::create(at("p.png")).unwrap();
    let mut encoder = png::Encoder::new(file, 3, 1);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Two);
    encoder.set_palette(vec![255, 0, 0, 0, 51, 0, 0, 0, 102]);
    encoder.set_trns(vec![255u8, 255, 0]);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&[0b00_01_10_00]).unwrap();
    writer.finish().unwrap();
    let loaded = read_image(at("p.png"), Gamma::Linear, Orientation::Upright).unwrap();
    assert_eq!(loaded.image.pixels, [Vec3::X, Vec3::Y * 0.2, Vec3::ZERO]);
    assert_eq!(loaded.alpha.unwrap(), [1.0, 1.0, 0.0]);
    assert_eq!(loaded.saturated, [true, false, false]);
}

/// A JPEG of 16×8 pixels, bright on the left, with an EXIF block that gives the orientation.
fn jpeg_with_orientation(orientation: u8) -> Vec<u8> {
    let image = RgbImage::from_fn(16, 8, |x, _| if x < 8 { Rgb([240; 3]) } else { Rgb([10; 3]) });
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Jpeg).unwrap();
    let bytes = bytes.into_inner();
    let mut tiff = b"Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
    tiff.extend([orientation, 0, 0, 0, 0, 0, 0]);
    let length = (tiff.len() as u16 + 2).to_be_bytes();
    [&bytes[..2], &[0xff, 0xe1], &length, &tiff, &bytes[2..]].concat()
}

#[test]
fn cut_jpegs_and_pngs_give_an_error_or_the_whole_picture() {
    let (_dir, at) = folder();
    let image = RgbImage::from_fn(24, 24, |x, y| Rgb([(x * 10) as u8, (y * 10) as u8, (x * y) as u8]));
    for (name, format) in [("a.jpg", ImageFormat::Jpeg), ("a.png", ImageFormat::Png)] {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        let bytes = bytes.into_inner();
        fs::write(at(name), &bytes).unwrap();
        let whole = read_image(at(name), Gamma::Srgb, Orientation::Upright).unwrap();
        let mut refused = 0;
        for length in 0..bytes.len() {
            fs::write(at(name), &bytes[..length]).unwrap();
            match read_image(at(name), Gamma::Srgb, Orientation::Upright) {
                Ok(loaded) => assert_eq!(loaded, whole, "{name} cut to {length} of {}", bytes.len()),
                Err(error) => {
                    refused += 1;
                    assert!(matches!(error, Error::Input { .. }), "{error:?}");
                }
            }
        }
        assert!(refused > bytes.len() * 9 / 10, "{name}: {refused} of {}", bytes.len());
    }
}

#[test]
fn a_jpeg_thumbnail_does_not_hide_a_cut() {
    let (_dir, at) = folder();
    let mut bytes = jpeg_with_orientation(1);
    let thumbnail = [0xff, 0xe2, 0, 6, 0xff, 0xd8, 0xff, 0xd9];
    bytes.splice(2..2, thumbnail);
    fs::write(at("a.jpg"), &bytes).unwrap();
    read_image(at("a.jpg"), Gamma::Srgb, Orientation::Upright).unwrap();
    fs::write(at("a.jpg"), &bytes[..bytes.len() - 2]).unwrap();
    assert!(
        problem_of(read_image(at("a.jpg"), Gamma::Srgb, Orientation::Upright)).contains("its end is missing")
    );
}

#[test]
fn exr_pixels_are_taken_as_stored_whatever_the_gamma() {
    let (_dir, at) = folder();
    let channels =
        [("A", vec![0.5, 2.0]), ("B", vec![0.1, 0.2]), ("G", vec![3.0, -0.4]), ("R", vec![5.0, 0.0])];
    write_exr(&at("a.exr"), 2, 1, &channels);
    let loaded = read_image(at("a.exr"), Gamma::Srgb, Orientation::Upright).unwrap();
    assert_eq!(loaded.image.pixels, [Vec3::new(5.0, 3.0, 0.1), Vec3::new(0.0, -0.4, 0.2)]);
    assert_eq!(loaded.alpha.unwrap(), [0.5, 1.0]);
    assert_eq!(loaded.saturated, [false, false]);
    assert!(loaded.is_float);
    write_exr(&at("gray.exr"), 2, 1, &[("Y", vec![0.5, 2.0])]);
    assert_eq!(
        read_image(at("gray.exr"), Gamma::Srgb, Orientation::Upright).unwrap().image.pixels,
        [Vec3::splat(0.5), Vec3::splat(2.0)]
    );
    write_exr(&at("depth.exr"), 2, 1, &[("Z", vec![0.5, 2.0])]);
    assert!(
        problem_of(read_image(at("depth.exr"), Gamma::Srgb, Orientation::Upright)).contains("the file has Z")
    );
}

#[test]
fn radiance_hdr_is_linear() {
    let (_dir, at) = folder();
    let pixels: Vec<Vec3> = (0..16).map(|i| Vec3::new((i % 8) as f32, 0.5, 100.0)).collect();
    fs::write(at("a.hdr"), hdr_bytes(8, 2, &pixels)).unwrap();
    let loaded = read_image(at("a.hdr"), Gamma::Srgb, Orientation::Upright).unwrap();
    assert_eq!((loaded.image.width, loaded.image.height), (8, 2));
    // The three mantissas share one exponent: here steps of half a unit, truncated.
    assert!((loaded.image.pixels[4] - Vec3::new(4.0, 0.5, 100.0)).abs().max_element() <= 0.5);
    let bytes = fs::read(at("a.hdr")).unwrap();
    fs::write(at("cut.hdr"), &bytes[..bytes.len() - 4]).unwrap();
    assert!(
        problem_of(read_image(at("cut.hdr"), Gamma::Srgb, Orientation::Upright))
            .contains("damaged or truncated")
    );
}

#[test]
fn nan_and_infinity_are_set_to_zero_counted_and_left_out() {
    let (_dir, at) = folder();
    let channels = [
        ("R", vec![1.0, f32::NAN, 1.0, 1.0, 1.0]),
        ("G", vec![1.0, 1.0, f32::INFINITY, 1.0, 1.0]),
        ("B", vec![1.0, 1.0, 1.0, f32::NEG_INFINITY, 1.0]),
        ("A", vec![1.0, 1.0, 1.0, 1.0, f32::NAN]),
    ];
    write_exr(&at("a.exr"), 5, 1, &channels);
    let loaded = read_image(at("a.exr"), Gamma::Srgb, Orientation::Upright).unwrap();
    assert_eq!((loaded.repairs.not_finite, loaded.repairs.pixels), (4, vec![1, 2, 3, 4]));
    assert_eq!(loaded.saturated, [false, true, true, true, true]);
    assert_eq!(loaded.image.pixels, [Vec3::ONE, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO]);
    assert_eq!(loaded.alpha.unwrap(), [1.0, 1.0, 1.0, 1.0, 0.0]);
    let nothing = vec![f32::NAN; 2];
    write_exr(&at("nan.exr"), 2, 1, &[("R", nothing.clone()), ("G", nothing.clone()), ("B", nothing)]);
    assert!(
        problem_of(read_image(at("nan.exr"), Gamma::Srgb, Orientation::Upright))
            .contains("every pixel is NaN or infinite")
    );
}
