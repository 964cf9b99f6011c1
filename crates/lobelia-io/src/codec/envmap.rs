//! Environment maps from OpenEXR and Radiance HDR files, and back. Values that no light can have
//! are repaired, each with a note, and very wide maps are averaged.
//!
//! ```
//! use lobelia_io::codec::envmap::{read_map, write_map_exr};
//! use lobelia_world::light::EnvironmentMap;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("sky.exr");
//! let sky = EnvironmentMap::from_directions(8, 4, |direction| direction + 2.0);
//! write_map_exr(&sky, &path)?;
//! assert_eq!(read_map(&path)?, sky);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::codec::image::{Decoded, ImageSamples, Orientation, decode_samples};
use crate::codec::{exr::ExrLayers, exr_frame::write_channels, file};
use glam::Vec3;
use image::{Rgb, codecs::hdr::HdrEncoder};
use lobelia_geometry::{Error, Result};
use lobelia_world::{light::EnvironmentMap, light::envmap::BoxFilter, light::validate_map};
use std::path::Path;

/// Maps wider than this are averaged down while they are read.
const WIDEST_KEPT: u32 = 4096;
/// The greatest width after averaging down.
const WIDEST_AVERAGED: u32 = 2048;
/// The greatest radiance of a texel. The disc of the sun has 1.6·10⁹ cd/m².
const BRIGHTEST_TEXEL: f32 = 1.0e10;
/// A map no texel of which is above this is black: squares of its values vanish in single
/// precision.
const BLACK_MAP: f32 = 1.0e-9;
/// The share of brighter texels from which on a map is refused: they are no stray ones.
const MOST_TOO_BRIGHT: f64 = 0.01;
const EXPORT_HELP: &str = "export the map again as OpenEXR (R, G, B or Y channels) or Radiance .hdr";

/// Reads an OpenEXR or Radiance HDR latitude-longitude map; the first bytes of the file determine
/// the format.
///
/// Like [`read_map_with_notes`], without the notes about repairs and resizing.
///
/// # Errors
/// As [`read_map_with_notes`].
pub fn read_map(path: impl AsRef<Path>) -> Result<EnvironmentMap> {
    read_map_with_notes(path).map(|(map, _)| map)
}

/// Reads a map and returns notes about repairs and changes, one sentence each.
///
/// Other channels of an EXR than those of its picture, R, G, B or Y, are ignored. Values that are
/// not finite are set to 0, negative ones clamped to 0, and texels above 10¹⁰ set to 0; each is
/// counted in a note. Maps wider than 4096 texels are averaged to at most 2048.
///
/// # Errors
/// [`Error::Input`] for what [`decode_samples`] refuses, for integers, a shape that is not exactly
/// 2:1, all values non-finite, all black, or more than 1 % of texels absurdly bright.
pub fn read_map_with_notes(path: impl AsRef<Path>) -> Result<(EnvironmentMap, Vec<String>)> {
    let path = path.as_ref();
    let wrong = |problem: String, help: &str| Error::input(path, "", problem, help);
    let Decoded { header, samples } = decode_samples(path, Orientation::AsStored)?;
    let (width, height) = (header.width, header.height);
    let ImageSamples::Floats(samples) = samples else {
        let problem = format!("is {}, neither OpenEXR nor Radiance HDR", header.format.name());
        return Err(wrong(problem, EXPORT_HELP));
    };
    if width < 2 || width.abs_diff(2 * height) > 1 {
        let problem = format!("is {width} × {height}, but a latitude-longitude map is twice as wide as high");
        return Err(wrong(problem, "crop or resize it to 2:1, e.g. 1024 × 512"));
    }
    let kept = kept_size([width, height]);
    let mut filter = BoxFilter::new([width, height], kept);
    let (mut not_finite, mut too_bright, mut negative, mut is_lit) = (0, 0, 0, false);
    let texels = samples.chunks_exact(header.channels);
    let count = texels.len();
    for (at, texel) in texels.enumerate() {
        let read = if header.channels < 3 { Vec3::splat(texel[0]) } else { Vec3::from_slice(texel) };
        let mut texel = Vec3::from_array(read.to_array().map(|c| if c.is_finite() { c } else { 0.0 }));
        not_finite += usize::from(!read.is_finite());
        if texel.abs().max_element() > BRIGHTEST_TEXEL {
            too_bright += 1;
            texel = Vec3::ZERO;
        }
        if texel.min_element() < 0.0 {
            negative += 1;
            texel = texel.max(Vec3::ZERO);
        }
        is_lit |= texel.max_element() > BLACK_MAP;
        filter.add(at % width as usize, at / width as usize, texel);
    }
    if not_finite == count {
        return Err(wrong("every texel is NaN or infinite".to_owned(), EXPORT_HELP));
    }
    if too_bright as f64 > MOST_TOO_BRIGHT * count as f64 {
        let problem =
            format!("{too_bright} of {count} texels are absurdly bright (above {BRIGHTEST_TEXEL:e})");
        return Err(wrong(problem, "divide its values so that a gray sky is about 1"));
    }
    if !is_lit {
        let problem = "the map is black everywhere, or nearly, or negative: it gives no light";
        return Err(wrong(problem.to_owned(), "check the export, or use another map"));
    }
    let map = filter.finish();
    validate_map(&map).map_err(|problem| wrong(problem, "check the unit of the map, or clamp its texels"))?;
    let notes = [
        (not_finite, format!("{not_finite} NaN or infinite texels set to 0")),
        (too_bright, format!("{too_bright} absurdly bright texels set to 0")),
        (negative, format!("{negative} negative texels clamped to 0")),
        (
            usize::from(kept != [width, height]),
            format!("averaged from {width} × {height} to {} × {}", kept[0], kept[1]),
        ),
    ];
    let happened = notes.into_iter().filter(|(count, _)| *count > 0);
    Ok((map, happened.map(|(_, note)| format!("{}: {note}", path.display())).collect()))
}

/// Writes an OpenEXR file with `f32` R, G, B channels; `path` is created only when the file is
/// complete.
///
/// # Errors
/// [`Error::Run`] for a map without texels or with a radiance that is not finite; [`Error::Io`] if
/// the file cannot be written.
pub fn write_map_exr(map: &EnvironmentMap, path: impl AsRef<Path>) -> Result<()> {
    let mut layers = ExrLayers { width: map.width, height: map.height, ..ExrLayers::default() };
    layers.insert_triple(["R", "G", "B"], &map.radiance);
    write_channels(path, &layers)
}

/// Writes a Radiance HDR file, for programs that read no OpenEXR; `path` is created only when the
/// file is complete.
///
/// # Errors
/// [`Error::Run`] for a map of another size than its texels, or with a radiance that is negative,
/// not finite or above [`MAX_RADIANCE`](lobelia_world::light::MAX_RADIANCE); [`Error::Io`] if the
/// file cannot be written.
pub fn write_map_hdr(map: &EnvironmentMap, path: &Path) -> Result<()> {
    let wrong = |problem: String| file::not_written(path, problem);
    let [width, height] = [map.width, map.height].map(|side| side as usize);
    if map.radiance.len() != width * height || map.radiance.is_empty() {
        return Err(wrong(format!("{} texels do not fill {width} × {height}", map.radiance.len())));
    }
    validate_map(map).map_err(wrong)?;
    let texels: Vec<_> = map.radiance.iter().map(|texel| Rgb(nearest_rgbe(*texel).to_array())).collect();
    let mut bytes = Vec::new();
    let encoded = HdrEncoder::new(&mut bytes).encode(&texels, width, height);
    encoded.map_err(|error| wrong(error.to_string()))?;
    file::write_bytes(path, &bytes)
}

/// The nearest radiance of three mantissas of eight bits and one exponent; the encoder itself
/// rounds toward zero, which dims a light.
fn nearest_rgbe(radiance: Vec3) -> Vec3 {
    let largest = f64::from(radiance.max_element());
    if largest < f64::from(f32::MIN_POSITIVE) {
        return Vec3::ZERO;
    }
    let step = |exponent: f64| (exponent - 7.0).exp2();
    let exponent = largest.log2().floor();
    // Rounding may need a ninth bit.
    let carries = (largest / step(exponent)).round() > 255.0;
    let step = step(if carries { exponent + 1.0 } else { exponent });
    Vec3::from_array(radiance.to_array().map(|x| ((f64::from(x) / step).round() * step) as f32))
}

/// The size of a map after averaging down.
fn kept_size([width, height]: [u32; 2]) -> [u32; 2] {
    if width <= WIDEST_KEPT {
        return [width, height];
    }
    let factor = width.div_ceil(WIDEST_AVERAGED);
    let kept = (width / factor).max(2) & !1;
    [kept, (kept / 2).min(height)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::{exr_of, hdr_bytes, temporary};
    use exr::prelude::{FlatSamples, f16};
    use std::path::PathBuf;

    fn gradient(width: u32, height: u32) -> EnvironmentMap {
        EnvironmentMap::from_directions(width, height, |d| Vec3::new(2.0 + d.x, 2.0 + d.y, 2.0 + d.z))
    }

    fn write_samples(path: &PathBuf, [width, height]: [usize; 2], channels: Vec<(&str, FlatSamples)>) {
        std::fs::write(path, exr_of(width, height, channels)).unwrap();
    }

    /// A map as another program might write it.
    fn write_unchecked(path: &PathBuf, map: &EnvironmentMap) {
        let channel = |k: usize| FlatSamples::F32(map.radiance.iter().map(|r| r[k]).collect());
        let channels = vec![("R", channel(0)), ("G", channel(1)), ("B", channel(2))];
        write_samples(path, [map.width as usize, map.height as usize], channels);
    }

    fn error_of(path: &Path) -> String {
        let error = read_map(path).expect_err("a bad map must be refused");
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.help().is_some(), "{error}");
        error.to_string()
    }

    #[test]
    fn written_maps_come_back_bit_for_bit_and_leave_nothing_else() {
        let (folder, path) = temporary("map.exr");
        let map = gradient(20, 10);
        write_map_exr(&map, &path).unwrap();
        let (back, notes) = read_map_with_notes(&path).unwrap();
        assert_eq!(back, map);
        assert!(notes.is_empty());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(write_map_exr(&map, path.join("below_a_file.exr")).is_err());
    }

    #[test]
    fn the_channels_of_the_picture_are_read_whatever_their_type() {
        let (_folder, path) = temporary("map.exr");
        let half = FlatSamples::F16((0..8).map(|i| f16::from_f32(i as f32)).collect());
        let (uint, float) = (FlatSamples::U32((0..8).collect()), FlatSamples::F32(vec![0.5; 8]));
        let depth = || FlatSamples::F32(vec![9.0; 8]);
        write_samples(&path, [4, 2], vec![("Z", depth()), ("R", half), ("G", uint), ("B", float)]);
        assert_eq!(read_map(&path).unwrap().radiance[5], Vec3::new(5.0, 5.0, 0.5));
        write_samples(&path, [4, 2], vec![("Y", depth()), ("A", depth())]);
        assert_eq!(read_map(&path).unwrap().radiance[3], Vec3::splat(9.0));
        write_samples(&path, [4, 2], vec![("R", depth()), ("Z", depth())]);
        assert!(error_of(&path).contains("the file has R, Z"));
    }

    #[test]
    fn bad_values_are_repaired_and_counted_or_refused() {
        let (_folder, path) = temporary("map.exr");
        let mut map = gradient(8, 4);
        map.radiance[3].x = f32::NAN;
        map.radiance[4] = Vec3::INFINITY;
        map.radiance[9].y = -2.0;
        assert!(write_map_exr(&map, &path).unwrap_err().to_string().contains("not finite at pixel"));
        write_unchecked(&path, &map);
        let (back, notes) = read_map_with_notes(&path).unwrap();
        assert_eq!(back.radiance[3], Vec3::new(0.0, map.radiance[3].y, map.radiance[3].z));
        assert_eq!((back.radiance[4], back.radiance[9].y), (Vec3::ZERO, 0.0));
        assert!(notes[0].contains("2 NaN") && notes[1].contains("1 negative"), "{notes:?}");
        write_unchecked(&path, &EnvironmentMap { radiance: vec![Vec3::NAN; 32], ..map });
        assert!(error_of(&path).contains("every texel"));
        write_map_exr(&gradient(8, 4).scaled(Vec3::ZERO), &path).unwrap();
        assert!(error_of(&path).contains("black"));
        let mut map = gradient(40, 20);
        (map.radiance[3].x, map.radiance[7].z, map.radiance[9].y) = (1e38, 1e36, 1.6e9);
        write_map_exr(&map, &path).unwrap();
        let (back, notes) = read_map_with_notes(&path).unwrap();
        assert_eq!((back.radiance[3], back.radiance[7]), (Vec3::ZERO, Vec3::ZERO));
        assert_eq!(back.radiance[9], map.radiance[9], "the sun is kept");
        assert!(notes.len() == 1 && notes[0].contains("2 absurdly bright texels"), "{notes:?}");
        map.radiance[..9].fill(Vec3::splat(3e12));
        write_map_exr(&map, &path).unwrap();
        assert!(error_of(&path).contains("9 of 800 texels are absurdly bright"));
    }

    #[test]
    fn wrong_shapes_are_refused_with_their_size() {
        let (_folder, path) = temporary("map.exr");
        write_map_exr(&gradient(9, 4), &path).unwrap();
        assert_eq!(read_map(&path).unwrap().width, 9);
        for (width, height) in [(10, 4), (4, 4), (1, 1)] {
            write_map_exr(&gradient(width, height), &path).unwrap();
            assert!(error_of(&path).contains(&format!("{width} × {height}")));
        }
        image::RgbImage::new(4, 2).save_with_format(&path, image::ImageFormat::Png).unwrap();
        assert!(error_of(&path).contains("is a PNG, neither"));
    }

    #[test]
    fn radiance_files_come_back_within_eight_bits_and_truncated_ones_are_refused() {
        let (_folder, path) = temporary("map.hdr");
        for width in [6, 64, 300] {
            let mut map = EnvironmentMap::from_directions(width, width / 2, |d| {
                Vec3::new(d.x.max(0.0) * 1e3, (d.y * 9.0).exp(), 0.25 + d.z * d.z * 1e-3)
            });
            map.radiance[3] = Vec3::ZERO;
            map.radiance[5] = Vec3::new(0.9999, 0.1, 0.0);
            write_map_hdr(&map, &path).unwrap();
            let back = read_map(&path).unwrap();
            for (found, written) in back.radiance.iter().zip(&map.radiance) {
                let error = (*found - *written).abs().max_element();
                // Half of the last of eight bits.
                assert!(error <= written.max_element() / 255.0, "{found} {written}");
            }
            let [found, written] = [&back, &map].map(|map| map.power().element_sum());
            // The mean over many texels is not dimmed by rounding.
            assert!(width < 300 || (found / written - 1.0).abs() < 1e-3, "{found} {written}");
            let bytes = std::fs::read(&path).unwrap();
            for part in [40, bytes.len() / 2, bytes.len() - 1] {
                std::fs::write(&path, &bytes[..part]).unwrap();
                error_of(&path);
            }
        }
        let flat = EnvironmentMap::from_directions(512, 256, |_| Vec3::new(0.5, 0.25, 1.0));
        write_map_hdr(&flat, &path).unwrap();
        assert_eq!(read_map(&path).unwrap(), flat);
        assert!(std::fs::metadata(&path).unwrap().len() < 256 * 50, "runs are written as runs");
        let bad = EnvironmentMap::from_directions(8, 4, |_| Vec3::splat(-1.0));
        assert!(write_map_hdr(&bad, &path).unwrap_err().to_string().contains("radiance"));
        let bytes = hdr_bytes(16, 8, &gradient(16, 8).radiance);
        std::fs::write(&path, [b"#?RGBE", &bytes[10..]].concat()).unwrap();
        assert_eq!(read_map(&path).unwrap().width, 16);
        std::fs::write(&path, b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8000 +X 16000\n").unwrap();
        assert!(error_of(&path).contains("truncated"));
    }

    #[test]
    fn gigantic_maps_are_averaged_down() {
        let (_folder, path) = temporary("map.exr");
        assert_eq!(kept_size([4096, 2048]), [4096, 2048]);
        assert_eq!(kept_size([8192, 4096]), [2048, 1024]);
        assert_eq!(kept_size([5001, 2500]), [1666, 833]);
        let size = [4100_usize, 2050];
        let ramp = |position: usize| (position / size[0]) as f32 / size[1] as f32;
        let gray = FlatSamples::F32((0..size[0] * size[1]).map(ramp).collect());
        write_samples(&path, size, vec![("Y", gray)]);
        let (map, notes) = read_map_with_notes(&path).unwrap();
        assert_eq!((map.width, map.height), (1366, 683));
        assert!(notes[0].contains("4100 × 2050"), "{notes:?}");
        // The mean of v over the sphere is a half.
        assert!((map.power().x / (4.0 * std::f64::consts::PI) - 0.5).abs() < 1e-3);
    }
}
