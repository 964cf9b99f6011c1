//! OpenEXR: any channels by name, and the layered frame that a render pass writes.

use super::atomic;
use crate::{Error, Result};
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder, MetaData,
    ReadChannels, ReadLayers, SmallVec, Text, Vec2, WritableImage, read,
};
use glam::Vec3;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

/// Most samples (pixels × channels) that a file may ask for: 4 GiB of `f32`. A damaged header asks for more.
const MOST_SAMPLES: u64 = 1 << 30;

/// Most samples per byte of file (no lossless method of the format comes near it), and the number that any file may have.
const MOST_SAMPLES_PER_BYTE: u64 = 1 << 14;
const FREE_SAMPLES: u64 = 1 << 22;

/// The channels of one image, by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Channels {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `width * height` values per channel, row by row from the top left; a layer's channels are called `layer.channel`.
    pub by_name: BTreeMap<String, Vec<f32>>,
}

impl Channels {
    /// Three channels as vectors; `None` if one is missing.
    pub fn triple(&self, names: [&str; 3]) -> Option<Vec<Vec3>> {
        let [x, y, z] = names.map(|name| self.by_name.get(name));
        let (x, y, z) = (x?, y?, z?);
        Some(x.iter().zip(y).zip(z).map(|((&x, &y), &z)| Vec3::new(x, y, z)).collect())
    }

    fn insert_triple(&mut self, names: [&str; 3], values: &[Vec3]) {
        for (axis, name) in names.into_iter().enumerate() {
            self.by_name.insert(name.to_owned(), values.iter().map(|v| v[axis]).collect());
        }
    }

    /// "R, G, B, …", for messages.
    pub fn names(&self) -> String {
        self.by_name.keys().map(String::as_str).collect::<Vec<_>>().join(", ")
    }
}

/// One rendered view with its layers; every list holds `width * height` values, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Linear Rec. 709 radiance, coverage-weighted on black: channels `R G B`.
    pub color: Vec<Vec3>,
    /// Coverage in `[0, 1]`: channel `A`.
    pub alpha: Vec<f32>,
    /// Diffusely reflected part of `color`: `diffuse.R` …
    pub diffuse: Vec<Vec3>,
    /// Specularly reflected part of `color`: `specular.R` …
    pub specular: Vec<Vec3>,
    /// Diffuse albedo: `albedo.R` …
    pub albedo: Vec<Vec3>,
    /// World-space normal: `normal.X` …
    pub normal: Vec<Vec3>,
    /// Distance along the ray in world units, 0 where nothing was hit: `depth.Z`.
    pub depth: Vec<f32>,
}

const COLOR: [&str; 3] = ["R", "G", "B"];
const DIFFUSE: [&str; 3] = ["diffuse.R", "diffuse.G", "diffuse.B"];
const SPECULAR: [&str; 3] = ["specular.R", "specular.G", "specular.B"];
const ALBEDO: [&str; 3] = ["albedo.R", "albedo.G", "albedo.B"];
const NORMAL: [&str; 3] = ["normal.X", "normal.Y", "normal.Z"];
const ALPHA: &str = "A";
const DEPTH: &str = "depth.Z";

impl Frame {
    fn channels(&self) -> Channels {
        let mut channels = Channels { width: self.width, height: self.height, by_name: BTreeMap::new() };
        channels.insert_triple(COLOR, &self.color);
        channels.insert_triple(DIFFUSE, &self.diffuse);
        channels.insert_triple(SPECULAR, &self.specular);
        channels.insert_triple(ALBEDO, &self.albedo);
        channels.insert_triple(NORMAL, &self.normal);
        channels.by_name.insert(ALPHA.to_owned(), self.alpha.clone());
        channels.by_name.insert(DEPTH.to_owned(), self.depth.clone());
        channels
    }
}

/// Writes `frame` as one single-part EXR with the channels named in [`Frame`], 32-bit float, ZIP (lossless).
///
/// # Errors
/// [`Error::Run`] if a list has the wrong length or holds a non-finite value; [`Error::Io`] if the disk refuses.
pub fn write_frame(path: impl AsRef<Path>, frame: &Frame) -> Result<()> {
    let channels = frame.channels();
    for (name, values) in &channels.by_name {
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            let pixel = (at % channels.width.max(1), at / channels.width.max(1));
            return Err(refused(path.as_ref(), format!("channel {name} is not finite at pixel {pixel:?}")));
        }
    }
    write_channels(path, &channels)
}

/// Writes `channels` as one single-part EXR, 32-bit float, ZIP (lossless), increasing lines.
///
/// # Errors
/// [`Error::Run`] if the image is empty or a channel has the wrong length; [`Error::Io`] if the disk refuses.
pub fn write_channels(path: impl AsRef<Path>, channels: &Channels) -> Result<()> {
    let path = path.as_ref();
    let count = channels.width * channels.height;
    if count == 0 || channels.by_name.is_empty() {
        return Err(refused(path, "there are no pixels or no channels to write".to_owned()));
    }
    if let Some((name, values)) = channels.by_name.iter().find(|(_, values)| values.len() != count) {
        return Err(refused(path, format!("channel {name} has {} values, not {count}", values.len())));
    }
    let image = single_part(channels);
    atomic::write_file(path, |writer| {
        // One thread: callers write many views at once, and the bytes are the same at any thread count.
        image.write().non_parallel().to_buffered(writer).map_err(|error| match error {
            exr::error::Error::Io(source) => Error::io("write", path)(source),
            other => refused(path, other.to_string()),
        })
    })
}

fn single_part(channels: &Channels) -> Image<Layer<AnyChannels<FlatSamples>>> {
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> = channels
        .by_name
        .iter()
        .map(|(name, values)| AnyChannel::new(name.as_str(), FlatSamples::F32(values.clone())))
        .collect();
    let attributes =
        LayerAttributes { software_name: Some(Text::from("Lobelia")), ..LayerAttributes::default() };
    let encoding = Encoding { line_order: LineOrder::Increasing, ..Encoding::SMALL_LOSSLESS };
    let size = Vec2(channels.width, channels.height);
    Image::from_layer(Layer::new(size, attributes, encoding, AnyChannels::sort(list)))
}

fn refused(path: &Path, problem: String) -> Error {
    Error::run(format!("writing {}", path.display()), problem)
}

/// Reads every channel of an EXR as `f32`: half, float and integer samples, scan lines or tiles (largest level), any number of
/// parts (a named part's channels are called `part.channel` if there is more than one part). A data window smaller or larger than
/// the display window is padded with zeros or cropped to it.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, [`Error::Input`] if it is not a whole EXR, has deep or subsampled data, parts of unequal
/// size, or two channels of one name.
pub fn read_channels(path: impl AsRef<Path>) -> Result<Channels> {
    let path = path.as_ref();
    let bytes = std::fs::read(path).map_err(Error::io("read", path))?;
    let broken = |error: exr::error::Error| {
        Error::input(
            path,
            "",
            format!("not a readable EXR: {error}"),
            "the file may be cut short; write it again",
        )
    };
    let most = (bytes.len() as u64 * MOST_SAMPLES_PER_BYTE).clamp(FREE_SAMPLES, MOST_SAMPLES);
    check_header(path, &MetaData::read_from_buffered(Cursor::new(&bytes), false).map_err(broken)?, most)?;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(&bytes))
        .map_err(broken)?;
    let window = image.attributes.display_window;
    let (width, height) = (window.size.0, window.size.1);
    let mut channels = Channels { width, height, by_name: BTreeMap::new() };
    let named = image.layer_data.len() > 1;
    for layer in &image.layer_data {
        let prefix = match &layer.attributes.layer_name {
            Some(name) if named => format!("{name}."),
            _ => String::new(),
        };
        let offset = [0, 1].map(|axis| {
            [layer.attributes.layer_position.0, layer.attributes.layer_position.1][axis] as i64
                - [window.position.0, window.position.1][axis] as i64
        });
        for channel in &layer.channel_data.list {
            let values: Vec<f32> = channel.sample_data.values_as_f32().collect();
            let from = Window { width: layer.size.0, height: layer.size.1, offset };
            let placed = place(&from, values, [width, height]);
            let name = format!("{prefix}{}", channel.name);
            if channels.by_name.insert(name.clone(), placed).is_some() {
                return Err(Error::input(path, "", format!("channel {name} is there twice"), ""));
            }
        }
    }
    Ok(channels)
}

/// Refuses what this reader does not do, and sizes that no real image has, before memory is asked for.
fn check_header(path: &Path, meta: &MetaData, most_samples: u64) -> Result<()> {
    let bad = |problem: String| Err(Error::input(path, "", problem, "write it as a plain scan-line EXR"));
    let mut samples = 0u64;
    for header in &meta.headers {
        if header.deep {
            return bad("deep EXR images cannot be read".to_owned());
        }
        if let Some(channel) = header.channels.list.iter().find(|channel| channel.sampling != Vec2(1, 1)) {
            return bad(format!("channel {} is subsampled", channel.name));
        }
        let display = header.shared_attributes.display_window.size;
        let pixels = [header.layer_size, display]
            .map(|size| (size.0 as u64).saturating_mul(size.1 as u64))
            .into_iter()
            .fold(0, u64::max);
        samples = samples.saturating_add(pixels.saturating_mul(header.channels.list.len() as u64));
        if display.0 == 0 || display.1 == 0 {
            return bad("the image has no pixels".to_owned());
        }
    }
    if samples > most_samples {
        return bad(format!("its header asks for {samples} samples, more than {most_samples} for this file"));
    }
    Ok(())
}

/// A data window: its size and where it lies in the display window.
struct Window {
    width: usize,
    height: usize,
    offset: [i64; 2],
}

/// The display window's values: those of the data window where they overlap, zero elsewhere.
fn place(from: &Window, values: Vec<f32>, [width, height]: [usize; 2]) -> Vec<f32> {
    if from.offset == [0, 0] && [from.width, from.height] == [width, height] {
        return values;
    }
    let mut placed = vec![0.0; width * height];
    for (row, line) in values.chunks_exact(from.width.max(1)).enumerate().take(from.height) {
        let y = row as i64 + from.offset[1];
        for (column, value) in line.iter().enumerate() {
            let x = column as i64 + from.offset[0];
            if (0..width as i64).contains(&x) && (0..height as i64).contains(&y) {
                placed[y as usize * width + x as usize] = *value;
            }
        }
    }
    placed
}

/// Reads a frame that [`write_frame`] wrote.
///
/// # Errors
/// Those of [`read_channels`], and [`Error::Input`] if a layer is missing.
pub fn read_frame(path: impl AsRef<Path>) -> Result<Frame> {
    let path = path.as_ref();
    let mut channels = read_channels(path)?;
    let missing = |name: &str, has: &Channels| {
        Error::input(
            path,
            "",
            format!("channel {name} is missing; it has {}", has.names()),
            "a frame is an EXR that a render pass has written",
        )
    };
    let triple = |names: [&str; 3]| channels.triple(names).ok_or_else(|| missing(names[0], &channels));
    let (color, diffuse, specular) = (triple(COLOR)?, triple(DIFFUSE)?, triple(SPECULAR)?);
    let (albedo, normal) = (triple(ALBEDO)?, triple(NORMAL)?);
    let mut single = |name: &str| match channels.by_name.remove(name) {
        Some(values) => Ok(values),
        None => Err(missing(name, &channels)),
    };
    let (alpha, depth) = (single(ALPHA)?, single(DEPTH)?);
    let (width, height) = (channels.width, channels.height);
    Ok(Frame { width, height, color, alpha, diffuse, specular, albedo, normal, depth })
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{IntegerBounds, f16};

    fn frame(width: usize, height: usize) -> Frame {
        let vectors = |seed: usize| -> Vec<Vec3> {
            (0..width * height).map(|i| Vec3::new(i as f32 * 0.37, seed as f32 - i as f32, 1e-30)).collect()
        };
        let values = |seed: usize| (0..width * height).map(|i| (i * seed) as f32 * 0.01).collect();
        Frame {
            width,
            height,
            color: vectors(1),
            alpha: values(3),
            diffuse: vectors(2),
            specular: vectors(3),
            albedo: vectors(4),
            normal: vectors(5),
            depth: values(7),
        }
    }

    #[test]
    fn frames_round_trip_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.exr");
        let written = frame(19, 35);
        write_frame(&path, &written).unwrap();
        assert_eq!(read_frame(&path).unwrap(), written);
        let names = read_channels(&path).unwrap().names();
        assert_eq!(
            names,
            "A, B, G, R, albedo.B, albedo.G, albedo.R, depth.Z, diffuse.B, diffuse.G, diffuse.R, \
             normal.X, normal.Y, normal.Z, specular.B, specular.G, specular.R"
        );
        let bytes = std::fs::read(&path).unwrap();
        write_frame(&path, &written).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), bytes, "the same frame must give the same bytes");
    }

    #[test]
    fn bad_frames_are_refused_and_leave_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.exr");
        let mut short = frame(4, 4);
        short.albedo.pop();
        assert!(
            write_frame(&path, &short).unwrap_err().to_string().contains("albedo.B has 15 values, not 16")
        );
        let mut nan = frame(4, 4);
        nan.normal[6].y = f32::NAN;
        let message = write_frame(&path, &nan).unwrap_err().to_string();
        assert!(message.contains("normal.Y is not finite at pixel (2, 1)"), "{message}");
        assert!(write_frame(&path, &Frame::default()).is_err());
        assert!(!path.exists());
    }

    #[test]
    fn truncated_and_damaged_files_are_errors_not_panics() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.exr");
        write_frame(&path, &frame(5, 3)).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for length in (0..whole.len()).step_by(7) {
            std::fs::write(&path, &whole[..length]).unwrap();
            let error = read_frame(&path).unwrap_err();
            assert!(matches!(error, Error::Input { .. }), "{length}: {error}");
        }
        for at in (0..whole.len()).step_by(3) {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x5A;
            std::fs::write(&path, &damaged).unwrap();
            // Damage may hide in a value or an attribute; it must only never panic or hang.
            let _ = read_frame(&path);
        }
        assert!(matches!(read_channels(folder.path().join("none.exr")).unwrap_err(), Error::Io { .. }));
    }

    #[test]
    fn a_missing_layer_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plain.exr");
        let mut channels = Channels { width: 2, height: 1, by_name: BTreeMap::new() };
        channels.insert_triple(COLOR, &[Vec3::X, Vec3::Y]);
        write_channels(&path, &channels).unwrap();
        assert_eq!(read_channels(&path).unwrap(), channels);
        let message = read_frame(&path).unwrap_err().to_string();
        assert!(message.contains("diffuse.R is missing; it has B, G, R"), "{message}");
    }

    #[test]
    fn half_samples_and_windows_are_placed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("crop.exr");
        let values: Vec<f16> = (1..=6).map(|i| f16::from_f32(i as f32)).collect();
        let channels =
            AnyChannels::sort(SmallVec::from_vec(vec![AnyChannel::new("Y", FlatSamples::F16(values))]));
        let attributes = LayerAttributes { layer_position: Vec2(2, -1), ..LayerAttributes::named("only") };
        let mut image = Image::from_layer(Layer::new((3, 2), attributes, Encoding::UNCOMPRESSED, channels));
        image.attributes.display_window = IntegerBounds::new((0, 0), (4, 2));
        image.write().to_file(&path).unwrap();
        let read = read_channels(&path).unwrap();
        assert_eq!((read.width, read.height), (4, 2));
        assert_eq!(read.by_name["Y"], [0.0, 0.0, 4.0, 5.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
