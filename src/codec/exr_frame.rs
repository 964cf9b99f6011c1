//! Writing of OpenEXR: any channels by name, and the layered frame that a render pass writes, which can also be read.

use crate::Result;
use crate::codec::exr::{ExrLayers, read_exr_groups};
use crate::codec::exr_rows::{ChannelRows, ChannelValues, Values, write_rows};
use crate::codec::finite::check_finite;
use glam::Vec3;
use std::ops::Range;
use std::path::Path;

pub use crate::codec::exr_rows::BLOCK_ROWS;

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

/// Bytes of one pixel of a [`Frame`], in memory and in a file before compression.
pub(crate) const FRAME_PIXEL_BYTES: usize = (3 * 5 + 2) * size_of::<f32>();

impl Frame {
    /// A copy of some rows, counted from 0.
    ///
    /// # Panics
    /// If the frame does not have these rows.
    #[must_use]
    pub fn band(&self, rows: Range<usize>) -> Self {
        let pixels = rows.start * self.width..rows.end * self.width;
        let vectors = |values: &[Vec3]| values[pixels.clone()].to_vec();
        Self {
            width: self.width,
            height: rows.len(),
            color: vectors(&self.color),
            alpha: self.alpha[pixels.clone()].to_vec(),
            diffuse: vectors(&self.diffuse),
            specular: vectors(&self.specular),
            albedo: vectors(&self.albedo),
            normal: vectors(&self.normal),
            depth: self.depth[pixels.clone()].to_vec(),
        }
    }

    /// The channels in the order of a file: by name.
    fn columns(&self) -> Vec<ChannelValues<'_>> {
        let plain = [(ALPHA, &self.alpha), (DEPTH, &self.depth)];
        let triples = [
            (COLOR, &self.color),
            (DIFFUSE, &self.diffuse),
            (SPECULAR, &self.specular),
            (ALBEDO, &self.albedo),
            (NORMAL, &self.normal),
        ];
        let plain = plain.map(|(name, values)| ChannelValues { name, values: Values::Plain(values) });
        let triples = triples.into_iter().flat_map(|(names, values)| {
            [0, 1, 2].map(|axis| ChannelValues { name: names[axis], values: Values::Axis(values, axis) })
        });
        let mut columns: Vec<ChannelValues> = plain.into_iter().chain(triples).collect();
        columns.sort_by_key(|column| column.name);
        columns
    }
}

/// Writes `frame` as one single-part EXR with the channels named in [`Frame`], 32-bit float, ZIP (lossless).
///
/// # Errors
/// [`Error::Run`](crate::Error::Run) if a list has the wrong length or holds a non-finite value; [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write_frame(path: impl AsRef<Path>, frame: &Frame) -> Result<()> {
    write_frame_rows(path, [frame.width, frame.height], |rows| rows.push(frame))
}

/// [`write_frame`] for a frame of `size` (width, height) that is never whole in memory: `fill` pushes its bands from the top. The file
/// has the same bytes, however many rows a band has, and gets its name when `fill` has succeeded and all rows are there.
///
/// # Errors
/// Those of [`write_frame`], and whatever `fill` returns.
pub fn write_frame_rows(
    path: impl AsRef<Path>,
    size: [usize; 2],
    fill: impl FnOnce(&mut FrameRows) -> Result<()>,
) -> Result<()> {
    write_frame_rows_with(path, size, None, fill)
}

/// [`write_frame_rows`] with a comment on the picture, which becomes the attribute `comments`.
///
/// # Errors
/// Those of [`write_frame_rows`].
pub fn write_frame_rows_with(
    path: impl AsRef<Path>,
    size: [usize; 2],
    comment: Option<&str>,
    fill: impl FnOnce(&mut FrameRows) -> Result<()>,
) -> Result<()> {
    let frame = Frame::default();
    let names: Vec<&str> = frame.columns().iter().map(|column| column.name).collect();
    write_rows(path.as_ref(), &names, size, comment, |rows| fill(&mut FrameRows(rows)))
}

/// The rows of a frame that is being written.
pub struct FrameRows<'r, 'a>(&'r mut ChannelRows<'a>);

impl FrameRows<'_, '_> {
    /// Writes the next rows.
    ///
    /// # Errors
    /// Those of [`write_frame`]; [`Error::Run`](crate::Error::Run) if the width differs or there are more rows than the frame has.
    pub fn push(&mut self, band: &Frame) -> Result<()> {
        let columns = band.columns();
        for column in &columns {
            check_finite(self.0.path, (0..column.len()).map(|i| column.at(i)), |at| {
                let (width, first_row) = (band.width.max(1), self.0.next_row);
                format!(
                    "channel {} is not finite at pixel ({}, {})",
                    column.name,
                    at % width,
                    first_row + at / width
                )
            })?;
        }
        self.0.push([band.width, band.height], &columns)
    }
}

/// Writes `channels` as one single-part EXR, 32-bit float, ZIP (lossless), increasing lines.
///
/// # Errors
/// [`Error::Run`](crate::Error::Run) if the image is empty or a channel has the wrong length or holds a non-finite value; [`Error::Io`](crate::Error::Io) if the file
/// cannot be written.
pub fn write_channels(path: impl AsRef<Path>, channels: &ExrLayers) -> Result<()> {
    let path = path.as_ref();
    for (name, values) in &channels.channels {
        check_finite(path, values.iter().copied(), |at| {
            let width = channels.width.max(1) as usize;
            format!("channel {name} is not finite at pixel ({}, {})", at % width, at / width)
        })?;
    }
    let size = [channels.width as usize, channels.height as usize];
    let column = |(name, values)| ChannelValues { name, values: Values::Plain(values) };
    let columns: Vec<ChannelValues> =
        channels.channels.iter().map(|(name, values)| column((name.as_str(), values.as_slice()))).collect();
    let names: Vec<&str> = columns.iter().map(|column| column.name).collect();
    write_rows(path, &names, size, None, |rows| rows.push(size, &columns))
}

/// A layer of a [`Frame`] in three channels, which can be left out on reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Layer {
    /// [`Frame::diffuse`].
    Diffuse,
    /// [`Frame::specular`].
    Specular,
    /// [`Frame::albedo`].
    Albedo,
    /// [`Frame::normal`].
    Normal,
}

impl Layer {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Diffuse, Self::Specular, Self::Albedo, Self::Normal];

    fn channels(self) -> &'static [&'static str] {
        match self {
            Self::Diffuse => &DIFFUSE,
            Self::Specular => &SPECULAR,
            Self::Albedo => &ALBEDO,
            Self::Normal => &NORMAL,
        }
    }

    fn of(self, frame: &mut Frame) -> &mut Vec<Vec3> {
        match self {
            Self::Diffuse => &mut frame.diffuse,
            Self::Specular => &mut frame.specular,
            Self::Albedo => &mut frame.albedo,
            Self::Normal => &mut frame.normal,
        }
    }
}

/// Reads a frame that [`write_frame`] wrote.
///
/// # Errors
/// Those of [`read_frame_layers`].
pub fn read_frame(path: impl AsRef<Path>) -> Result<Frame> {
    let path = path.as_ref();
    let mut frame = read_frame_layers(path, &Layer::ALL)?;
    frame.depth = read_exr_groups(path, &[&[DEPTH]])?.1.swap_remove(0);
    Ok(frame)
}

/// Reads color, coverage and some other layers of a frame that [`write_frame`] wrote; the others, and depth, are empty.
///
/// # Errors
/// Those of [`read_exr_layers`](crate::codec::exr::read_exr_layers), and [`Error::Input`](crate::Error::Input) if a layer is missing.
pub fn read_frame_layers(path: impl AsRef<Path>, layers: &[Layer]) -> Result<Frame> {
    let mut groups: Vec<&[&str]> = vec![&COLOR];
    groups.extend(layers.iter().map(|layer| layer.channels()));
    groups.push(&[ALPHA]);
    let ([width, height], values) = read_exr_groups(path.as_ref(), &groups)?;
    let mut values = values.into_iter();
    let mut frame = Frame { width, height, ..Frame::default() };
    frame.color = values.next().map(vectors).unwrap_or_default();
    for layer in layers {
        *layer.of(&mut frame) = values.next().map(vectors).unwrap_or_default();
    }
    frame.alpha = values.next().unwrap_or_default();
    Ok(frame)
}

fn vectors(values: Vec<f32>) -> Vec<Vec3> {
    values.chunks_exact(3).map(Vec3::from_slice).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::exr::read_exr_layers;
    use crate::error::Error;
    use exr::meta::attribute::Text;
    use exr::meta::header::LayerAttributes;
    use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, Vec2, WritableImage};

    #[test]
    fn rows_that_cannot_be_compressed_are_kept_as_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("noise.exr");
        // All bits of 7 × 21 values are random; the last block has five rows. Then a file of blocks of both kinds.
        let noise: Vec<f32> = (1u32..148)
            .map(|i| {
                let mixed = (i.wrapping_mul(0x9e37_79b9) ^ i << 7).wrapping_mul(0x85eb_ca6b);
                f32::from_bits((mixed ^ mixed >> 13).wrapping_mul(0xc2b2_ae35) & 0xbfff_ffff)
            })
            .collect();
        let mixed: Vec<f32> =
            noise.iter().enumerate().map(|(i, v)| if i < 7 * 16 { 0.25 } else { *v }).collect();
        for (values, bytes) in [(noise, 147 * 4..1100), (mixed, 35 * 4..700)] {
            let channels = [("Y".to_owned(), values)].into_iter().collect();
            let layers = ExrLayers { width: 7, height: 21, channels };
            write_channels(&path, &layers).unwrap();
            let length = std::fs::metadata(&path).unwrap().len();
            assert!(bytes.contains(&length), "{length}");
            assert_eq!(read_exr_layers(&path).unwrap().channels, layers.channels);
        }
    }

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

    fn write_in_bands(path: &Path, frame: &Frame, rows: usize) -> Result<()> {
        write_frame_rows(path, [frame.width, frame.height], |file| {
            (0..frame.height)
                .step_by(rows)
                .try_for_each(|start| file.push(&frame.band(start..(start + rows).min(frame.height))))
        })
    }

    /// The file as the `exr` crate writes a whole image.
    fn by_the_crate(frame: &Frame) -> Vec<u8> {
        let all =
            |column: &ChannelValues| FlatSamples::F32((0..column.len()).map(|i| column.at(i)).collect());
        let columns = frame.columns();
        let list = columns.iter().map(|column| AnyChannel::new(column.name, all(column))).collect();
        let attributes =
            LayerAttributes { software_name: Some(Text::from("Lobelia")), ..LayerAttributes::default() };
        let size = Vec2(frame.width, frame.height);
        let layer = Layer::new(size, attributes, Encoding::SMALL_LOSSLESS, AnyChannels::sort(list));
        let mut bytes = std::io::Cursor::new(Vec::new());
        Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn bands_of_any_height_give_the_bytes_of_the_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.exr");
        for height in [1, 15, 16, 37, 48] {
            let whole = frame(11, height);
            write_frame(&path, &whole).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            for rows in [1, 3, 7, 16, 20, 32, 48] {
                write_in_bands(&path, &whole, rows).unwrap();
                assert!(std::fs::read(&path).unwrap() == bytes, "{height} rows, {rows} at a time");
            }
        }
    }

    #[test]
    fn a_file_is_what_the_crate_makes_of_the_whole_but_for_how_far_it_compresses() {
        let folder = tempfile::tempdir().unwrap();
        let [own, theirs] = ["own.exr", "theirs.exr"].map(|name| folder.path().join(name));
        for height in [1, 37] {
            let whole = frame(11, height);
            write_frame(&own, &whole).unwrap();
            std::fs::write(&theirs, by_the_crate(&whole)).unwrap();
            let headers = |path: &Path| exr::meta::MetaData::read_from_file(path, true).unwrap().headers;
            assert_eq!(headers(&own), headers(&theirs));
            assert_eq!(read_frame(&own).unwrap(), read_frame(&theirs).unwrap());
        }
    }

    #[test]
    fn a_comment_becomes_an_attribute_and_changes_no_pixel() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.exr");
        let whole = frame(11, 20);
        for comment in [None, Some("no noise")] {
            write_frame_rows_with(&path, [11, 20], comment, |rows| rows.push(&whole)).unwrap();
            let headers = exr::meta::MetaData::read_from_file(&path, false).unwrap().headers;
            let found = headers[0].own_attributes.comments.as_ref().map(Text::to_string);
            assert_eq!(found.as_deref(), comment);
            assert_eq!(read_frame(&path).unwrap(), whole);
        }
    }

    #[test]
    fn rows_that_are_missing_or_too_many_are_refused_and_leave_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.exr");
        let whole = frame(5, 20);
        let refused = |bands: &[Frame]| {
            let pushed = write_frame_rows(&path, [5, 20], |file| bands.iter().try_for_each(|b| file.push(b)));
            pushed.unwrap_err().to_string()
        };
        let upper = whole.band(0..17);
        assert!(refused(std::slice::from_ref(&upper)).contains("only 17 of 20 rows"));
        let message = refused(&[upper.clone(), upper.clone()]);
        assert!(message.contains("rows 17 to 34 of 5 pixels do not fit a picture of 5×20"), "{message}");
        assert!(refused(&[frame(6, 20)]).contains("of 6 pixels do not fit"));
        let mut nan = whole.band(17..20);
        nan.depth[11] = f32::INFINITY;
        assert!(refused(&[upper, nan]).contains("depth.Z is not finite at pixel (1, 19)"));
        let stopped = write_frame_rows(&path, [5, 20], |_| Err(Error::Interrupted));
        assert!(matches!(stopped, Err(Error::Interrupted)), "the reason comes out as it is");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
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
