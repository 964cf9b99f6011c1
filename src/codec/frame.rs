//! Writing of OpenEXR: any channels by name, and the layered frame that a render pass writes, which can also be read.

use crate::codec::exr::{ExrLayers, read_exr_layers};
use crate::codec::file;
use crate::codec::finite::check_finite;
use crate::{Error, Result};
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder, SmallVec, Text,
    Vec2, WritableImage,
};
use glam::Vec3;
use std::path::Path;

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
    fn channels(&self) -> ExrLayers {
        let mut channels =
            ExrLayers { width: self.width as u32, height: self.height as u32, ..ExrLayers::default() };
        channels.insert_triple(COLOR, &self.color);
        channels.insert_triple(DIFFUSE, &self.diffuse);
        channels.insert_triple(SPECULAR, &self.specular);
        channels.insert_triple(ALBEDO, &self.albedo);
        channels.insert_triple(NORMAL, &self.normal);
        channels.channels.insert(ALPHA.to_owned(), self.alpha.clone());
        channels.channels.insert(DEPTH.to_owned(), self.depth.clone());
        channels
    }
}

/// Writes `frame` as one single-part EXR with the channels named in [`Frame`], 32-bit float, ZIP (lossless).
///
/// # Errors
/// [`Error::Run`] if a list has the wrong length or holds a non-finite value; [`Error::Io`] if the file cannot be written.
pub fn write_frame(path: impl AsRef<Path>, frame: &Frame) -> Result<()> {
    write_channels(path, &frame.channels())
}

/// Writes `channels` as one single-part EXR, 32-bit float, ZIP (lossless), increasing lines.
///
/// # Errors
/// [`Error::Run`] if the image is empty or a channel has the wrong length or holds a non-finite value; [`Error::Io`] if the file
/// cannot be written.
pub fn write_channels(path: impl AsRef<Path>, channels: &ExrLayers) -> Result<()> {
    let path = path.as_ref();
    let count = channels.width as usize * channels.height as usize;
    if count == 0 || channels.channels.is_empty() {
        return Err(refused(path, "there are no pixels or no channels to write".to_owned()));
    }
    if let Some((name, values)) = channels.channels.iter().find(|(_, values)| values.len() != count) {
        return Err(refused(path, format!("channel {name} has {} values, not {count}", values.len())));
    }
    for (name, values) in &channels.channels {
        check_finite(path, values.iter().copied(), |at| {
            let (x, y) = (at % channels.width as usize, at / channels.width as usize);
            format!("channel {name} is not finite at pixel ({x}, {y})")
        })?;
    }
    let image = single_part(channels);
    file::write_file(path, |writer| {
        // One thread: callers write many views at once, and the bytes do not depend on the number of threads.
        image.write().non_parallel().to_buffered(writer).map_err(|error| match error {
            exr::error::Error::Io(source) => Error::io("write", path)(source),
            other => refused(path, other.to_string()),
        })
    })
}

fn single_part(channels: &ExrLayers) -> Image<Layer<AnyChannels<FlatSamples>>> {
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> = channels
        .channels
        .iter()
        .map(|(name, values)| AnyChannel::new(name.as_str(), FlatSamples::F32(values.clone())))
        .collect();
    let attributes =
        LayerAttributes { software_name: Some(Text::from("Lobelia")), ..LayerAttributes::default() };
    let encoding = Encoding { line_order: LineOrder::Increasing, ..Encoding::SMALL_LOSSLESS };
    let size = Vec2(channels.width as usize, channels.height as usize);
    Image::from_layer(Layer::new(size, attributes, encoding, AnyChannels::sort(list)))
}

fn refused(path: &Path, problem: String) -> Error {
    Error::run(format!("writing {}", path.display()), problem)
}

/// Reads a frame that [`write_frame`] wrote.
///
/// # Errors
/// Those of [`read_exr_layers`], and [`Error::Input`] if a layer is missing.
pub fn read_frame(path: impl AsRef<Path>) -> Result<Frame> {
    let path = path.as_ref();
    let mut channels = read_exr_layers(path)?;
    let missing = |name: &str, has: &ExrLayers| {
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
    let mut single = |name: &str| match channels.channels.remove(name) {
        Some(values) => Ok(values),
        None => Err(missing(name, &channels)),
    };
    let (alpha, depth) = (single(ALPHA)?, single(DEPTH)?);
    let (width, height) = (channels.width as usize, channels.height as usize);
    Ok(Frame { width, height, color, alpha, diffuse, specular, albedo, normal, depth })
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let names = read_exr_layers(&path).unwrap().names();
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
            // Damage may be in a value or an attribute; reading must never panic or hang.
            let _ = read_frame(&path);
        }
        assert!(matches!(read_exr_layers(folder.path().join("none.exr")).unwrap_err(), Error::Input { .. }));
    }

    #[test]
    fn a_missing_layer_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plain.exr");
        let mut channels = ExrLayers { width: 2, height: 1, ..ExrLayers::default() };
        channels.insert_triple(COLOR, &[Vec3::X, Vec3::Y]);
        write_channels(&path, &channels).unwrap();
        assert_eq!(read_exr_layers(&path).unwrap(), channels);
        let message = read_frame(&path).unwrap_err().to_string();
        assert!(message.contains("diffuse.R is missing; it has B, G, R"), "{message}");
    }
}
