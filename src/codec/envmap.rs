//! Environment maps from OpenEXR and Radiance HDR files, and back to OpenEXR.

use std::io::{BufRead, BufReader, Cursor};
use std::path::Path;

use crate::codec::file;
use crate::codec::finite::check_finite;
use crate::codec::hdr::RadianceReader;
use crate::light::envmap::BoxFilter;
use crate::light::{EnvironmentMap, validate_map};
use crate::{Error, Result};
use exr::prelude::{
    MetaData, ReadChannels, ReadLayers, ReadSpecificChannel, SpecificChannels, WritableImage,
};
use glam::Vec3;

/// Maps wider than this are averaged down while they are read.
const WIDEST_KEPT: u32 = 4096;
/// The greatest width after averaging down.
const WIDEST_AVERAGED: u32 = 2048;
/// The greatest radiance of a texel. The disc of the sun has 1.6·10⁹ cd/m².
const BRIGHTEST_TEXEL: f32 = 1.0e10;
/// A map no texel of which is above this is black: squares of its values vanish in single precision.
const BLACK_MAP: f32 = 1.0e-9;
/// The share of brighter texels from which on a map is refused: they are no stray ones.
const MOST_TOO_BRIGHT: f64 = 0.01;
/// Maps wider than this are an error (the file would take minutes and gigabytes to decode).
const WIDEST_READ: usize = 32_768;

const EXPORT_HELP: &str = "export the map again as OpenEXR (R, G, B or Y channels) or Radiance .hdr";

impl EnvironmentMap {
    /// Reads an OpenEXR or Radiance HDR latitude-longitude map; the first bytes of the file determine the format.
    ///
    /// Like [`Self::read_with_notes`], without the notes about repairs and resizing.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        Self::read_with_notes(path).map(|(map, _)| map)
    }

    /// Reads a map and returns notes about repairs and changes, one sentence each.
    ///
    /// EXR: half, float or uint samples, channels R, G, B in any order, or Y as gray; other channels are ignored; the
    /// first layer that has them is read. Negative values are clamped to 0, non-finite ones set to 0, and so are texels
    /// above 10¹⁰; each is counted in a note. Maps wider than 4096 texels are averaged to at most 2048 while they are
    /// read, a block or scanline at a time: memory does not grow with the file.
    ///
    /// # Errors
    /// [`Error::Input`] for: no such file, another format, a truncated or damaged file, no usable channels, a shape
    /// that is not exactly 2:1, more than 32 768 texels across, all values non-finite, all black, more than 1 % of texels absurdly bright.
    pub fn read_with_notes(path: impl AsRef<Path>) -> Result<(Self, Vec<String>)> {
        let path = path.as_ref();
        let open = || file::open(path, |_| "check the path of the environment map".to_owned());
        let mut first = open()?;
        let start = file::first_bytes(path, &mut first, 16)?;
        if start.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
            read_exr(path, open)?.finish(path)
        } else if start.starts_with(b"#?") {
            read_hdr(path, first)?.finish(path)
        } else {
            Err(Error::input(path, "", "is neither OpenEXR nor Radiance HDR", EXPORT_HELP))
        }
    }

    /// Writes an OpenEXR file with `f32` R, G, B channels; `path` is created only when the file is complete.
    ///
    /// # Errors
    /// [`Error::Run`] for a map without texels or with a radiance that is not finite; [`Error::Io`] if the file cannot be written.
    pub fn write_exr(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let size = (self.width as usize, self.height as usize);
        if self.radiance.len() != size.0 * size.1 || self.radiance.is_empty() {
            let problem = format!("{} texels do not fill {} × {}", self.radiance.len(), size.0, size.1);
            return Err(Error::run(format!("writing {}", path.display()), problem));
        }
        check_finite(path, self.radiance.iter().flat_map(Vec3::to_array), |at| {
            let (i, j) = (at / 3 % size.0, at / 3 / size.0);
            format!("texel ({i}, {j}) is not finite")
        })?;
        let channels = SpecificChannels::rgb(|position: exr::math::Vec2<usize>| {
            let texel = self.radiance[position.y() * size.0 + position.x()];
            (texel.x, texel.y, texel.z)
        });
        let mut bytes = Cursor::new(Vec::new());
        let image = exr::image::Image::from_channels(size, channels);
        image
            .write()
            .non_parallel()
            .to_buffered(&mut bytes)
            .map_err(|e| Error::run(format!("encoding {}", path.display()), e.to_string()))?;
        file::write_bytes(path, bytes.get_ref())
    }
}

/// Collects texels in any order; repairs and counts them, and averages them down if the map is too wide.
struct Sink {
    size: [u32; 2],
    filter: BoxFilter,
    finite: u64,
    repaired: u64,
    too_bright: u64,
    clamped: u64,
    bright: bool,
}

impl Sink {
    /// A collector for a map of `size` (already checked).
    fn new(size: [u32; 2]) -> Self {
        Self {
            size,
            filter: BoxFilter::new(size, kept_size(size)),
            finite: 0,
            repaired: 0,
            too_bright: 0,
            clamped: 0,
            bright: false,
        }
    }

    fn add(&mut self, x: usize, y: usize, value: Vec3) {
        let mut repaired = value;
        if value.is_finite() {
            self.finite += 1;
        } else {
            self.repaired += 1;
            repaired = Vec3::from_array(value.to_array().map(|c| if c.is_finite() { c } else { 0.0 }));
        }
        if repaired.abs().max_element() > BRIGHTEST_TEXEL {
            self.too_bright += 1;
            repaired = Vec3::ZERO;
        }
        if repaired.min_element() < 0.0 {
            self.clamped += 1;
            repaired = repaired.max(Vec3::ZERO);
        }
        self.bright |= repaired.max_element() > BLACK_MAP;
        self.filter.add(x, y, repaired);
    }

    /// The map, and notes on what was done to it, one sentence each.
    fn finish(self, path: &Path) -> Result<(EnvironmentMap, Vec<String>)> {
        self.check(path)?;
        let mut notes = self.notes_of_repairs(path);
        let map = self.filter.finish();
        validate_map(&map).map_err(|problem| {
            Error::input(path, "", problem, "check the unit of the map, or clamp its texels")
        })?;
        if [map.width, map.height] != self.size {
            let [w, h] = self.size;
            let text =
                format!("{}: averaged from {w} × {h} to {} × {}", path.display(), map.width, map.height);
            notes.push(text);
        }
        Ok((map, notes))
    }

    /// Refuses a map that is not finite, is absurdly bright or gives no light.
    fn check(&self, path: &Path) -> Result<()> {
        if self.finite == 0 {
            return Err(Error::input(path, "", "every texel is NaN or infinite", EXPORT_HELP));
        }
        let texels = f64::from(self.size[0]) * f64::from(self.size[1]);
        if self.too_bright as f64 > MOST_TOO_BRIGHT * texels {
            let problem = format!(
                "{} of {texels} texels are absurdly bright (above {BRIGHTEST_TEXEL:e})",
                self.too_bright
            );
            return Err(Error::input(path, "", problem, "divide its values so that a gray sky is about 1"));
        }
        if !self.bright {
            let is_negative = self.clamped > 0;
            let problem = if is_negative {
                "no texel of the map is above 0, and some are negative: it gives no light"
            } else {
                "the map is black everywhere, or nearly: it gives no light"
            };
            return Err(Error::input(path, "", problem, "check the export, or use another map"));
        }
        Ok(())
    }

    /// What of the texels was repaired.
    fn notes_of_repairs(&self, path: &Path) -> Vec<String> {
        let mut notes = Vec::new();
        if self.repaired > 0 {
            notes.push(format!("{}: {} NaN or infinite texels set to 0", path.display(), self.repaired));
        }
        if self.too_bright > 0 {
            let count = self.too_bright;
            notes.push(format!("{}: {count} absurdly bright texels set to 0", path.display()));
        }
        if self.clamped > 0 {
            notes.push(format!("{}: {} negative texels clamped to 0", path.display(), self.clamped));
        }
        notes
    }
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

/// The size as `[width, height]` if it is exactly 2:1 and at most [`WIDEST_READ`] wide.
fn checked_size(path: &Path, width: usize, height: usize) -> Result<[u32; 2]> {
    if width < 2 || height < 1 || width.abs_diff(2 * height) > 1 {
        let problem = format!("is {width} × {height}, but a latitude-longitude map is twice as wide as high");
        return Err(Error::input(path, "", problem, "crop or resize it to 2:1, e.g. 1024 × 512"));
    }
    if width > WIDEST_READ {
        let problem = format!("is {width} × {height}, more than {WIDEST_READ} texels across");
        return Err(Error::input(path, "", problem, "reduce its size; 2048 × 1024 is enough"));
    }
    Ok([width as u32, height as u32])
}

fn read_exr(path: &Path, open: impl Fn() -> Result<BufReader<file::DiskFile>>) -> Result<Sink> {
    let broken = |e: exr::error::Error| {
        Error::input(path, "", format!("cannot be decoded as OpenEXR ({e})"), EXPORT_HELP)
    };
    let meta = MetaData::read_from_buffered(open()?, false).map_err(broken)?;
    let (size, names) = exr_layer(path, &meta)?;
    let [red, green, blue] = names;
    let add = |sink: &mut Sink, at: exr::math::Vec2<usize>, value: Vec3| sink.add(at.x(), at.y(), value);
    // Not parallel, because blocks would be summed in any order.
    let reader = exr::prelude::read().no_deep_data().largest_resolution_level().specific_channels();
    if red == green {
        let image = reader
            .required(red.as_str())
            .collect_pixels(
                move |_, _| Sink::new(size),
                move |s, at, (y,): (f32,)| add(s, at, Vec3::splat(y)),
            )
            .first_valid_layer()
            .all_attributes()
            .non_parallel()
            .from_buffered(open()?)
            .map_err(broken)?;
        return Ok(image.layer_data.channel_data.pixels);
    }
    let image = reader
        .required(red.as_str())
        .required(green.as_str())
        .required(blue.as_str())
        .collect_pixels(
            move |_, _| Sink::new(size),
            move |s, at, (r, g, b): (f32, f32, f32)| add(s, at, Vec3::new(r, g, b)),
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(open()?)
        .map_err(broken)?;
    Ok(image.layer_data.channel_data.pixels)
}

/// Size and red, green and blue channel names (all the same for a gray map) of the first layer that has color.
fn exr_layer(path: &Path, meta: &MetaData) -> Result<([u32; 2], [String; 3])> {
    let mut seen = Vec::new();
    for header in &meta.headers {
        let names: Vec<String> = header.channels.list.iter().map(|c| c.name.to_string()).collect();
        let find = |wanted: &str| names.iter().find(|n| n.eq_ignore_ascii_case(wanted)).cloned();
        let color = match (find("R"), find("G"), find("B"), find("Y")) {
            (Some(r), Some(g), Some(b), _) => Some([r, g, b]),
            (_, _, _, Some(y)) => Some([y.clone(), y.clone(), y]),
            _ => None,
        };
        if let (Some(color), false) = (color, header.deep) {
            let size = checked_size(path, header.layer_size.width(), header.layer_size.height())?;
            return Ok((size, color));
        }
        seen.extend(names);
    }
    let problem = format!("has no R, G and B channels and no Y channel (it has: {})", seen.join(", "));
    Err(Error::input(path, "", problem, EXPORT_HELP))
}

fn read_hdr(path: &Path, reader: impl BufRead) -> Result<Sink> {
    let broken = |place: String| {
        move |problem: String| {
            let problem = format!("cannot be decoded as Radiance HDR ({problem})");
            Error::input(path, place, problem, EXPORT_HELP)
        }
    };
    let mut reader = RadianceReader::new(reader).map_err(broken(String::new()))?;
    let [width, height] = reader.size;
    let mut sink = Sink::new(checked_size(path, width, height)?);
    for y in 0..height {
        let place = format!("scanline {y} of {height}");
        reader.scanline(|x, value| sink.add(x, y, value)).map_err(broken(place))?;
    }
    Ok(sink)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::hdr_bytes;
    use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Layer, LayerAttributes, f16};
    use std::path::PathBuf;

    fn gradient(width: u32, height: u32) -> EnvironmentMap {
        EnvironmentMap::from_directions(width, height, |d| Vec3::new(2.0 + d.x, 2.0 + d.y, 2.0 + d.z))
    }

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().expect("a temporary folder")
    }

    fn write_channels(path: &PathBuf, size: (usize, usize), channels: Vec<(&str, FlatSamples)>) {
        let list = channels.into_iter().map(|(name, samples)| AnyChannel::new(name, samples));
        let channels = AnyChannels::sort(list.collect());
        let layer = Layer::new(size, LayerAttributes::named("map"), Encoding::SMALL_LOSSLESS, channels);
        exr::image::Image::from_layer(layer).write().to_file(path).expect("a test file");
    }

    /// A map as another program might write it.
    fn write_unchecked(path: &PathBuf, map: &EnvironmentMap) {
        let channel = |k: usize| FlatSamples::F32(map.radiance.iter().map(|r| r[k]).collect());
        let channels = vec![("R", channel(0)), ("G", channel(1)), ("B", channel(2))];
        write_channels(path, (map.width as usize, map.height as usize), channels);
    }

    fn error_of(path: &Path) -> String {
        let error = EnvironmentMap::read(path).expect_err("a bad map must be refused");
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.help().is_some(), "{error}");
        error.to_string()
    }

    #[test]
    fn written_maps_come_back_bit_for_bit_and_leave_nothing_else() {
        let folder = folder();
        let path = folder.path().join("map.exr");
        let map = gradient(20, 10);
        map.write_exr(&path).unwrap();
        let (back, notes) = EnvironmentMap::read_with_notes(&path).unwrap();
        assert_eq!(back, map);
        assert!(notes.is_empty());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(map.write_exr(path.join("below_a_file.exr")).is_err());
    }

    #[test]
    fn half_uint_gray_and_extra_channels_are_read() {
        let folder = folder();
        let path = folder.path().join("map.exr");
        let half = FlatSamples::F16((0..8).map(|i| f16::from_f32(i as f32)).collect());
        let uint = FlatSamples::U32((0..8).collect());
        let float = FlatSamples::F32(vec![0.5; 8]);
        let depth = FlatSamples::F32(vec![9.0; 8]);
        write_channels(&path, (4, 2), vec![("Z", depth.clone()), ("R", half), ("G", uint), ("B", float)]);
        let map = EnvironmentMap::read(&path).unwrap();
        assert_eq!(map.radiance[5], Vec3::new(5.0, 5.0, 0.5));
        write_channels(&path, (4, 2), vec![("Y", depth.clone()), ("A", depth.clone())]);
        assert_eq!(EnvironmentMap::read(&path).unwrap().radiance[3], Vec3::splat(9.0));
        write_channels(&path, (4, 2), vec![("R", depth.clone()), ("Z", depth)]);
        assert!(error_of(&path).contains("it has: R, Z"));
    }

    #[test]
    fn bad_values_are_repaired_and_counted_or_refused() {
        let folder = folder();
        let path = folder.path().join("map.exr");
        let mut map = gradient(8, 4);
        map.radiance[3].x = f32::NAN;
        map.radiance[4] = Vec3::INFINITY;
        map.radiance[9].y = -2.0;
        assert!(map.write_exr(&path).unwrap_err().to_string().contains("texel (3, 0) is not finite"));
        write_unchecked(&path, &map);
        let (back, notes) = EnvironmentMap::read_with_notes(&path).unwrap();
        assert_eq!(back.radiance[3], Vec3::new(0.0, map.radiance[3].y, map.radiance[3].z));
        assert_eq!((back.radiance[4], back.radiance[9].y), (Vec3::ZERO, 0.0));
        assert!(notes[0].contains("2 NaN") && notes[1].contains("1 negative"), "{notes:?}");
        write_unchecked(&path, &EnvironmentMap { radiance: vec![Vec3::NAN; 32], ..map });
        assert!(error_of(&path).contains("every texel"));
        gradient(8, 4).scaled(Vec3::ZERO).write_exr(&path).unwrap();
        assert!(error_of(&path).contains("black"));
        gradient(8, 4).scaled(Vec3::NEG_ONE).write_exr(&path).unwrap();
        assert!(error_of(&path).contains("some are negative"));
    }

    #[test]
    fn absurdly_bright_texels_are_set_to_zero_and_counted_or_refused() {
        let folder = folder();
        let path = folder.path().join("map.exr");
        let mut map = gradient(40, 20);
        (map.radiance[3].x, map.radiance[7].z, map.radiance[9].y) = (1e38, 1e36, 1.6e9);
        map.write_exr(&path).unwrap();
        let (back, notes) = EnvironmentMap::read_with_notes(&path).unwrap();
        assert_eq!((back.radiance[3], back.radiance[7]), (Vec3::ZERO, Vec3::ZERO));
        assert_eq!(back.radiance[9], map.radiance[9], "the sun is kept");
        assert!(notes.len() == 1 && notes[0].contains("2 absurdly bright texels"), "{notes:?}");
        map.radiance[..9].fill(Vec3::splat(3e12));
        map.write_exr(&path).unwrap();
        assert!(error_of(&path).contains("9 of 800 texels are absurdly bright"));
    }

    #[test]
    fn wrong_shapes_are_refused_with_their_size() {
        let folder = folder();
        let path = folder.path().join("map.exr");
        gradient(9, 4).write_exr(&path).unwrap();
        assert_eq!(EnvironmentMap::read(&path).unwrap().width, 9);
        for (width, height) in [(10, 4), (4, 4), (1, 1)] {
            gradient(width, height).write_exr(&path).unwrap();
            assert!(error_of(&path).contains(&format!("{width} × {height}")));
        }
    }

    #[test]
    fn truncated_foreign_and_missing_files_are_refused() {
        let folder = folder();
        let path = folder.path().join("map.exr");
        gradient(64, 32).write_exr(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for part in [0, 3, 4, 50, 200, whole.len() / 2, whole.len() - 1] {
            std::fs::write(&path, &whole[..part]).unwrap();
            error_of(&path);
        }
        std::fs::write(&path, b"\x89PNG\r\n").unwrap();
        assert!(error_of(&path).contains("neither"));
        assert!(error_of(&folder.path().join("none.exr")).contains("no such file"));
        assert!(error_of(folder.path()).contains("folder"));
    }

    #[test]
    fn radiance_files_are_read_and_truncated_ones_refused() {
        let folder = folder();
        let path = folder.path().join("map.hdr");
        let map = gradient(16, 8);
        let bytes = hdr_bytes(16, 8, &map.radiance);
        std::fs::write(&path, &bytes).unwrap();
        let back = EnvironmentMap::read(&path).unwrap();
        // Shared exponent, eight bits of mantissa.
        let error = |(a, b): (&Vec3, &Vec3)| (*a - *b).abs().max_element() / a.max_element();
        assert!(map.radiance.iter().zip(&back.radiance).map(error).fold(0.0, f32::max) < 1.0 / 128.0);
        for part in [8, 40, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..part]).unwrap();
            error_of(&path);
        }
        std::fs::write(&path, b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16000 +X 32000\n").unwrap();
        assert!(error_of(&path).contains("truncated"));
    }

    #[test]
    fn damaged_bytes_never_panic() {
        let folder = folder();
        let path = folder.path().join("map");
        let map = gradient(16, 8);
        map.write_exr(&path).unwrap();
        let exr = std::fs::read(&path).unwrap();
        let hdr = hdr_bytes(16, 8, &map.radiance);
        for whole in [exr, hdr] {
            for at in 0..whole.len() {
                for value in [0, 0xff] {
                    let mut bytes = whole.clone();
                    bytes[at] = value;
                    std::fs::write(&path, &bytes).unwrap();
                    // A changed sample may still be valid; a map that is accepted must be usable.
                    if let Ok(map) = EnvironmentMap::read(&path) {
                        assert!(map.radiance.iter().all(|r| r.is_finite() && r.min_element() >= 0.0));
                    }
                }
            }
        }
    }

    #[test]
    fn gigantic_maps_are_averaged_down() {
        let folder = folder();
        let path = folder.path().join("map.exr");
        assert_eq!(kept_size([4096, 2048]), [4096, 2048]);
        assert_eq!(kept_size([8192, 4096]), [2048, 1024]);
        assert_eq!(kept_size([5001, 2500]), [1666, 833]);
        let size = (4100_usize, 2050_usize);
        let ramp = |position: usize| (position / size.0) as f32 / size.1 as f32;
        let gray = FlatSamples::F32((0..size.0 * size.1).map(ramp).collect());
        write_channels(&path, size, vec![("Y", gray)]);
        let (map, notes) = EnvironmentMap::read_with_notes(&path).unwrap();
        assert_eq!((map.width, map.height), (1366, 683));
        assert!(notes[0].contains("4100 × 2050"), "{notes:?}");
        // The mean of v over the sphere is a half.
        assert!((map.power().x / (4.0 * std::f64::consts::PI) - 0.5).abs() < 1e-3);
    }
}
