//! Writing of OpenEXR row by row: any channels by name, and the layered frame that a render pass
//! writes, which can also be read.
//!
//! Blocks of rows are compressed by all threads and written when they are complete. They have
//! OpenEXR's ZIP compression, at the fastest level: four times as fast as the level that the `exr`
//! crate has, for files that are larger by a twentieth.
//!
//! ```
//! use lobelia_io::codec::exr::{ExrLayers, read_exr_layers};
//! use lobelia_io::codec::exr_frame::write_channels;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("depth.exr");
//! let channels = [("Z".to_owned(), vec![1.0, 2.0, 4.0])].into();
//! let depth = ExrLayers { width: 3, height: 1, channels };
//! write_channels(&path, &depth)?;
//! assert_eq!(read_exr_layers(&path)?, depth);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::codec::exr::{ExrLayers, read_exr_groups};
use crate::codec::file::{check_finite, not_written, write_file};
use exr::block::chunk::{Chunk, CompressedBlock, CompressedScanLineBlock};
use exr::meta::attribute::{ChannelDescription, LineOrder, SampleType, Text};
use exr::meta::header::{Header, LayerAttributes};
use exr::meta::{BlockDescription, Headers};
use exr::{block::writer::ChunksWriter, math::Vec2};
use flate2::{Compression, write::ZlibEncoder};
use glam::Vec3;
use lobelia_geometry::{Error, Result, parallel, view::BLOCK_ROWS, view::Frame};
use std::{io::Write as _, path::Path};

const COLOR: [&str; 3] = ["R", "G", "B"];
const DIFFUSE: [&str; 3] = ["diffuse.R", "diffuse.G", "diffuse.B"];
const SPECULAR: [&str; 3] = ["specular.R", "specular.G", "specular.B"];
const ALBEDO: [&str; 3] = ["albedo.R", "albedo.G", "albedo.B"];
const NORMAL: [&str; 3] = ["normal.X", "normal.Y", "normal.Z"];
const ALPHA: &str = "A";
const DEPTH: &str = "depth.Z";

/// One channel's values of some rows.
struct Column<'a> {
    name: &'a str,
    count: usize,
    at: Box<dyn Fn(usize) -> f32 + Sync + 'a>,
}

impl<'a> Column<'a> {
    fn new(name: &'a str, values: &'a [f32]) -> Self {
        Self { name, count: values.len(), at: Box::new(|i| values[i]) }
    }
}

/// The channels of a frame in the order of a file: by name.
fn columns(frame: &Frame) -> Vec<Column<'_>> {
    let mut columns = vec![Column::new(ALPHA, &frame.alpha), Column::new(DEPTH, &frame.depth)];
    for (names, values) in [
        (COLOR, &frame.color),
        (DIFFUSE, &frame.diffuse),
        (SPECULAR, &frame.specular),
        (ALBEDO, &frame.albedo),
        (NORMAL, &frame.normal),
    ] {
        let count = values.len();
        let column = |axis| Column { name: names[axis], count, at: Box::new(move |i| values[i][axis]) };
        columns.extend([0, 1, 2].map(column));
    }
    columns.sort_by_key(|column| column.name);
    columns
}

/// Writes `frame` as one single-part EXR with the channels named in [`Frame`], 32-bit float, ZIP
/// (lossless).
///
/// # Errors
/// [`Error::Run`] if a list has the wrong length or holds a non-finite value; [`Error::Io`] if the
/// file cannot be written.
pub fn write_frame(path: impl AsRef<Path>, frame: &Frame) -> Result<()> {
    write_frame_rows(path, [frame.width, frame.height], |rows| rows.push(frame))
}

/// [`write_frame`] for a frame of `size` (width, height) that is never whole in memory: `fill`
/// pushes its bands from the top. The file has the same bytes, however many rows a band has, and
/// gets its name when `fill` has succeeded and all rows are there.
///
/// # Errors
/// As for [`write_frame`], and whatever `fill` returns.
pub fn write_frame_rows(
    path: impl AsRef<Path>,
    size: [usize; 2],
    fill: impl FnOnce(&mut FrameRows) -> Result<()>,
) -> Result<()> {
    write_rows(path.as_ref(), &columns(&Frame::default()), size, fill)
}

/// Writes `channels` as one single-part EXR, 32-bit float, ZIP (lossless), increasing lines.
///
/// # Errors
/// [`Error::Run`] if the image is empty or a channel has the wrong length or holds a non-finite
/// value; [`Error::Io`] if the file cannot be written.
pub fn write_channels(path: impl AsRef<Path>, channels: &ExrLayers) -> Result<()> {
    let size = [channels.width as usize, channels.height as usize];
    let columns: Vec<_> = channels.channels.iter().map(|(name, values)| Column::new(name, values)).collect();
    write_rows(path.as_ref(), &columns, size, |rows| rows.push_columns(size, &columns))
}

/// Writes an EXR of channels with the sorted names of `columns`, whose rows `fill` pushes.
fn write_rows(
    path: &Path,
    columns: &[Column],
    size: [usize; 2],
    fill: impl FnOnce(&mut FrameRows) -> Result<()>,
) -> Result<()> {
    if size.contains(&0) || columns.is_empty() {
        return Err(not_written(path, "there are no pixels or no channels to write"));
    }
    let channels = columns.iter().map(|column| ChannelDescription::named(column.name, SampleType::F32));
    let (zip, lines) = (exr::compression::Compression::ZIP16, BlockDescription::ScanLines);
    // Its one part has no name.
    let header = Header::new(Text::default(), Vec2(size[0], size[1]), channels.collect())
        .with_encoding(zip, lines, LineOrder::Increasing)
        .with_attributes(LayerAttributes {
            software_name: Some(Text::from("Lobelia")),
            ..LayerAttributes::default()
        });
    write_file(path, |writer| {
        let mut outcome = Ok(());
        let written = exr::block::write(writer, Headers::from_iter([header]), true, |_, chunks| {
            let mut put = |index: usize, chunk: Chunk| chunks.write_chunk(index, chunk);
            let mut rows = FrameRows { path, size, next_row: 0, waiting: Vec::new(), put: &mut put };
            outcome = fill(&mut rows);
            let (pushed, all) = (rows.next_row, size[1]);
            if outcome.is_ok() && pushed != all {
                outcome = Err(not_written(path, format!("only {pushed} of {all} rows were rendered")));
            }
            if outcome.is_ok() { Ok(()) } else { Err(exr::error::Error::Aborted) }
        });
        outcome.and_then(|()| written.map_err(|error| failed(path, error)))
    })
}

/// The rows of a frame that is being written.
pub struct FrameRows<'a> {
    path: &'a Path,
    size: [usize; 2],
    /// The first row that is not yet pushed.
    next_row: usize,
    /// The rows before it that do not make up a block yet, as bytes of a block.
    waiting: Vec<u8>,
    /// Takes a block of compressed rows by its number.
    put: &'a mut dyn FnMut(usize, Chunk) -> exr::error::UnitResult,
}

impl FrameRows<'_> {
    /// Writes the next rows.
    ///
    /// # Errors
    /// As for [`write_frame`]; [`Error::Run`] if the width differs or there are more rows than the
    /// frame has.
    pub fn push(&mut self, band: &Frame) -> Result<()> {
        self.push_columns([band.width, band.height], &columns(band))
    }

    /// Writes the next rows: `size` is their width and number.
    fn push_columns(&mut self, size: [usize; 2], columns: &[Column]) -> Result<()> {
        let ([width, height], start, first_block) = (size, self.next_row, self.next_row / BLOCK_ROWS);
        for Column { name, count, at } in columns {
            check_finite(self.path, (0..*count).map(at), |at| {
                let (x, y) = (at % width.max(1), start + at / width.max(1));
                format!("channel {name} is not finite at pixel ({x}, {y})")
            })?;
            if *count != width * height {
                let problem = format!("channel {name} has {count} values, not {}", width * height);
                return Err(not_written(self.path, problem));
            }
        }
        let ([whole_width, whole_height], end) = (self.size, start + height);
        if width != whole_width || height == 0 || end > whole_height {
            let problem = format!(
                "rows {start} to {end} of {width} pixels do not fit a picture of {whole_width}×{whole_height}"
            );
            return Err(not_written(self.path, problem));
        }
        self.next_row += height;
        let row_bytes = 4 * width * columns.len();
        let mut bytes = std::mem::take(&mut self.waiting);
        let start = bytes.len();
        bytes.resize(start + height * row_bytes, 0);
        let rows = bytes[start..].chunks_exact_mut(row_bytes).enumerate();
        parallel::for_each(rows, |(row, bytes)| {
            for (column, cells) in columns.iter().zip(bytes.chunks_exact_mut(4 * width)) {
                let cells = cells.as_chunks_mut().0.iter_mut();
                (row * width..).zip(cells).for_each(|(i, cell)| *cell = (column.at)(i).to_le_bytes());
            }
        });
        let block_bytes = BLOCK_ROWS * row_bytes;
        // The last block of the picture may be shorter.
        let is_last = self.next_row == self.size[1];
        let complete = if is_last { bytes.len() } else { bytes.len() / block_bytes * block_bytes };
        self.waiting = bytes.split_off(complete);
        let chunk = |(k, data)| compressed(first_block + k, data);
        let chunks: Vec<Result<Chunk>> = parallel::map_items(bytes.chunks(block_bytes).enumerate(), chunk);
        for (block, chunk) in (first_block..).zip(chunks) {
            (self.put)(block, chunk?).map_err(|error| failed(self.path, error))?;
        }
        Ok(())
    }
}

/// A block of rows by its number, with ZIP if that makes it smaller.
fn compressed(block: usize, data: &[u8]) -> Result<Chunk> {
    // OpenEXR compresses the bytes of even places, then those of odd ones, each as 128 more than
    // its difference to the one before; the first stays as it is.
    let mut bytes: Vec<u8> = data.iter().step_by(2).chain(data.iter().skip(1).step_by(2)).copied().collect();
    let mut before = 128u8;
    for byte in &mut bytes {
        let difference = byte.wrapping_sub(before).wrapping_add(128);
        before = std::mem::replace(byte, difference);
    }
    let mut encoder = ZlibEncoder::new(Vec::with_capacity(data.len() / 4), Compression::fast());
    let zipped = encoder.write_all(&bytes).and_then(|()| encoder.finish());
    let zipped = zipped.map_err(|error| Error::run("compressing", error.to_string()))?;
    let block = CompressedScanLineBlock {
        y_coordinate: (block * BLOCK_ROWS) as i32,
        compressed_pixels_le: if zipped.len() < data.len() { zipped } else { data.to_vec() },
    };
    Ok(Chunk { layer_index: 0, compressed_block: CompressedBlock::ScanLine(block) })
}

fn failed(path: &Path, error: exr::error::Error) -> Error {
    match error {
        exr::error::Error::Io(source) => Error::io("write", path)(source),
        other => not_written(path, other),
    }
}

/// A layer of a [`Frame`] in three channels, which can be left out on reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
    /// Its channels, and its place in a frame.
    fn of(self, frame: &mut Frame) -> (&'static [&'static str], &mut Vec<Vec3>) {
        match self {
            Self::Diffuse => (&DIFFUSE, &mut frame.diffuse),
            Self::Specular => (&SPECULAR, &mut frame.specular),
            Self::Albedo => (&ALBEDO, &mut frame.albedo),
            Self::Normal => (&NORMAL, &mut frame.normal),
        }
    }
}

/// Reads a frame that [`write_frame`] wrote.
///
/// # Errors
/// As for [`read_frame_layers`].
pub fn read_frame(path: impl AsRef<Path>) -> Result<Frame> {
    let path = path.as_ref();
    let layers = [Layer::Diffuse, Layer::Specular, Layer::Albedo, Layer::Normal];
    let mut frame = read_frame_layers(path, &layers)?;
    frame.depth = read_exr_groups(path, &[&[DEPTH]])?.1.swap_remove(0);
    Ok(frame)
}

/// Reads color, coverage and some other layers of a frame that [`write_frame`] wrote; the others,
/// and depth, are empty.
///
/// # Errors
/// As for [`read_exr_layers`](crate::codec::exr::read_exr_layers), and [`Error::Input`] if a layer
/// is missing.
pub fn read_frame_layers(path: impl AsRef<Path>, layers: &[Layer]) -> Result<Frame> {
    let mut frame = Frame::default();
    let mut groups: Vec<&[&str]> = vec![&COLOR];
    groups.extend(layers.iter().map(|layer| layer.of(&mut frame).0));
    groups.push(&[ALPHA]);
    let (size, mut values) = read_exr_groups(path.as_ref(), &groups)?;
    [frame.width, frame.height] = size;
    frame.alpha = values.pop().unwrap_or_default();
    let vectors = |values: Vec<f32>| values.chunks_exact(3).map(Vec3::from_slice).collect();
    let mut vectors = values.into_iter().map(vectors);
    frame.color = vectors.next().unwrap_or_default();
    for (layer, vectors) in layers.iter().zip(vectors) {
        *layer.of(&mut frame).1 = vectors;
    }
    Ok(frame)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::{exr::read_exr_layers, test_data::frame, test_data::temporary};

    #[test]
    fn rows_that_cannot_be_compressed_are_kept_as_they_are() {
        let (_folder, path) = temporary("noise.exr");
        let noise = |i: u32| {
            let mixed = (i.wrapping_mul(0x9e37_79b9) ^ i << 7).wrapping_mul(0x85eb_ca6b);
            f32::from_bits((mixed ^ mixed >> 13).wrapping_mul(0xc2b2_ae35) & 0xbfff_ffff)
        };
        // A block that is compressed, and one of random bits.
        let values = (1..148).map(|i| if i <= 7 * 16 { 0.25 } else { noise(i) }).collect();
        let layers = ExrLayers { width: 7, height: 21, channels: [("Y".to_owned(), values)].into() };
        write_channels(&path, &layers).unwrap();
        let length = std::fs::metadata(&path).unwrap().len();
        assert!((35 * 4..700).contains(&length), "{length}");
        assert_eq!(read_exr_layers(&path).unwrap().channels, layers.channels);
    }

    #[test]
    fn frames_round_trip_bit_for_bit() {
        let (_folder, path) = temporary("view.exr");
        let written = frame(19, 35);
        write_frame(&path, &written).unwrap();
        assert_eq!(read_frame(&path).unwrap(), written);
        let layers = read_exr_layers(&path).unwrap().channels;
        let names = "A B G R albedo.B albedo.G albedo.R depth.Z diffuse.B diffuse.G diffuse.R normal.X normal.Y \
                     normal.Z specular.B specular.G specular.R";
        assert!(layers.keys().eq(names.split(' ')), "{:?}", layers.keys());
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

    #[test]
    fn bands_of_any_height_give_the_bytes_of_the_whole() {
        let (_folder, path) = temporary("view.exr");
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
    fn bad_rows_and_frames_are_refused_and_leave_no_file() {
        let (folder, path) = temporary("view.exr");
        let refused = |bands: &[&Frame], words: &str| {
            let pushed = write_frame_rows(&path, [5, 20], |file| bands.iter().try_for_each(|b| file.push(b)));
            let message = pushed.unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        };
        let whole = frame(5, 20);
        let (upper, mut lower) = (whole.band(0..17), whole.band(17..20));
        refused(&[&upper], "only 17 of 20 rows");
        refused(&[&upper, &upper], "rows 17 to 34 of 5 pixels do not fit a picture of 5×20");
        refused(&[&frame(6, 20)], "of 6 pixels do not fit");
        lower.depth[11] = f32::INFINITY;
        refused(&[&upper, &lower], "depth.Z is not finite at pixel (1, 19)");
        lower.depth[11] = 0.0;
        lower.albedo.pop();
        refused(&[&upper, &lower], "albedo.B has 14 values, not 15");
        let stopped = write_frame_rows(&path, [5, 20], |_| Err(Error::Interrupted));
        assert!(matches!(stopped, Err(Error::Interrupted)), "the reason comes out as it is");
        assert!(write_frame(&path, &Frame::default()).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_missing_layer_is_named() {
        let (_folder, path) = temporary("plain.exr");
        let mut channels = ExrLayers { width: 2, height: 1, ..ExrLayers::default() };
        channels.insert_triple(COLOR, &[Vec3::X, Vec3::Y]);
        write_channels(&path, &channels).unwrap();
        assert_eq!(read_exr_layers(&path).unwrap(), channels);
        let message = read_frame(&path).unwrap_err().to_string();
        assert!(message.contains("has no channel diffuse.R; it has B, G, R"), "{message}");
    }
}
