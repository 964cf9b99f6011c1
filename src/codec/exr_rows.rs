//! Writing of OpenEXR row by row: blocks of rows are compressed by all threads and written when they are complete.
//!
//! Blocks have OpenEXR's ZIP compression, at the fastest level: four times as fast as the level that the `exr` crate has, for files that are larger by a
//! twentieth.

use crate::codec::deflate::zlib_fast;
use crate::codec::file;
use crate::{Error, Result};
use exr::block::chunk::{Chunk, CompressedBlock, CompressedScanLineBlock};
use exr::block::writer::ChunksWriter;
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::attribute::{ChannelDescription, LineOrder, SampleType, Text};
use exr::meta::header::{Header, LayerAttributes};
use exr::meta::{BlockDescription, Headers};
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;
use std::path::Path;

/// Rows that an EXR file with ZIP compression keeps together.
pub const BLOCK_ROWS: usize = 16;

/// One channel's values of some rows.
pub(super) struct ChannelValues<'a> {
    pub name: &'a str,
    pub values: Values<'a>,
}

/// The values of a channel: a list of them, or an axis of vectors.
#[derive(Clone, Copy)]
pub(super) enum Values<'a> {
    Plain(&'a [f32]),
    Axis(&'a [Vec3], usize),
}

impl ChannelValues<'_> {
    pub fn len(&self) -> usize {
        match self.values {
            Values::Plain(values) => values.len(),
            Values::Axis(values, _) => values.len(),
        }
    }

    pub fn at(&self, i: usize) -> f32 {
        match self.values {
            Values::Plain(values) => values[i],
            Values::Axis(values, axis) => values[i][axis],
        }
    }

    /// Appends the values of some pixels as a block has them.
    fn append(&self, pixels: Range<usize>, bytes: &mut Vec<u8>) {
        match self.values {
            Values::Plain(values) => {
                values[pixels].iter().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
            }
            Values::Axis(values, axis) => {
                values[pixels].iter().for_each(|value| bytes.extend_from_slice(&value[axis].to_le_bytes()));
            }
        }
    }
}

/// Writes an EXR of channels with these sorted names, whose rows `fill` pushes, with a comment or without.
pub(super) fn write_rows(
    path: &Path,
    names: &[&str],
    size: [usize; 2],
    comment: Option<&str>,
    fill: impl FnOnce(&mut ChannelRows) -> Result<()>,
) -> Result<()> {
    if size.contains(&0) || names.is_empty() {
        return Err(refused(path, "there are no pixels or no channels to write".to_owned()));
    }
    let headers = Headers::from_iter([header(names, size, comment)]);
    file::write_file(path, |writer| {
        let mut outcome = Ok(());
        let written = exr::block::write(writer, headers, true, |_, chunks| {
            let mut put = |index: usize, chunk: Chunk| chunks.write_chunk(index, chunk);
            let mut rows = ChannelRows { path, size, next_row: 0, waiting: Vec::new(), put: &mut put };
            outcome = fill(&mut rows).and_then(|()| rows.complete());
            if outcome.is_ok() { Ok(()) } else { Err(exr::error::Error::Aborted) }
        });
        outcome.and_then(|()| written.map_err(|error| failed(path, error)))
    })
}

fn header(names: &[&str], [width, height]: [usize; 2], comment: Option<&str>) -> Header {
    let channels = names.iter().map(|name| ChannelDescription::named(*name, SampleType::F32)).collect();
    // Its one part has no name.
    let attributes = LayerAttributes {
        software_name: Some(Text::from("Lobelia")),
        comments: comment.map(Text::from),
        ..LayerAttributes::default()
    };
    Header::new(Text::default(), Vec2(width, height), channels)
        .with_encoding(Compression::ZIP16, BlockDescription::ScanLines, LineOrder::Increasing)
        .with_attributes(attributes)
}

/// Takes a block of compressed rows by its number.
type PutChunk<'a> = dyn FnMut(usize, Chunk) -> exr::error::UnitResult + 'a;

/// The rows of an EXR that is being written.
pub(super) struct ChannelRows<'a> {
    pub path: &'a Path,
    size: [usize; 2],
    /// The first row that is not yet pushed.
    pub next_row: usize,
    /// The rows before it that do not make up a block yet, as bytes of a block.
    waiting: Vec<u8>,
    put: &'a mut PutChunk<'a>,
}

impl ChannelRows<'_> {
    /// Writes the next rows: `size` is their width and number.
    pub fn push(&mut self, size: [usize; 2], columns: &[ChannelValues]) -> Result<()> {
        self.check(size, columns)?;
        let ([width, height], start) = (size, self.next_row);
        let end = start + height;
        let append = |rows: Range<usize>, mut bytes: Vec<u8>| {
            for row in rows.start.max(start)..rows.end.min(end) {
                let first = (row - start) * width;
                columns.iter().for_each(|column| column.append(first..first + width, &mut bytes));
            }
            bytes
        };
        // The blocks that are complete now; the last one of the picture may be shorter.
        let first = start / BLOCK_ROWS;
        let blocks = if end == self.size[1] { end.div_ceil(BLOCK_ROWS) } else { end / BLOCK_ROWS };
        let waiting = std::mem::take(&mut self.waiting);
        let chunk = |block: usize| {
            let before = if block == first { waiting.clone() } else { Vec::new() };
            compressed(block, append(block * BLOCK_ROWS..(block + 1) * BLOCK_ROWS, before))
        };
        let chunks: Vec<Result<Chunk>> = (first..blocks).into_par_iter().map(chunk).collect();
        for (block, chunk) in (first..).zip(chunks) {
            (self.put)(block, chunk?).map_err(|error| failed(self.path, error))?;
        }
        let before = if blocks == first { waiting } else { Vec::new() };
        self.waiting = append(blocks * BLOCK_ROWS..end, before);
        self.next_row = end;
        Ok(())
    }

    fn check(&self, [width, height]: [usize; 2], columns: &[ChannelValues]) -> Result<()> {
        let count = width * height;
        if let Some(column) = columns.iter().find(|column| column.len() != count) {
            let problem = format!("channel {} has {} values, not {count}", column.name, column.len());
            return Err(refused(self.path, problem));
        }
        let ([whole_width, whole_height], end) = (self.size, self.next_row + height);
        if width != whole_width || height == 0 || end > whole_height {
            let (start, picture) = (self.next_row, format!("{whole_width}×{whole_height}"));
            let problem =
                format!("rows {start} to {end} of {width} pixels do not fit a picture of {picture}");
            return Err(refused(self.path, problem));
        }
        Ok(())
    }

    /// Whether all rows were pushed.
    fn complete(&self) -> Result<()> {
        let (rows, height) = (self.next_row, self.size[1]);
        if rows == height {
            return Ok(());
        }
        Err(refused(self.path, format!("only {rows} of {height} rows were rendered")))
    }
}

/// A block of rows by its number, with ZIP if that makes it smaller.
fn compressed(block: usize, data: Vec<u8>) -> Result<Chunk> {
    let zipped = zlib_fast(&predicted(&data))?;
    let block = CompressedScanLineBlock {
        y_coordinate: (block * BLOCK_ROWS) as i32,
        compressed_pixels_le: if zipped.len() < data.len() { zipped } else { data },
    };
    Ok(Chunk { layer_index: 0, compressed_block: CompressedBlock::ScanLine(block) })
}

/// Bytes as OpenEXR's ZIP compresses them: those of even places, then those of odd ones, each as 128 more than its difference to the one before.
fn predicted(data: &[u8]) -> Vec<u8> {
    let mut bytes: Vec<u8> = data.iter().step_by(2).chain(data.iter().skip(1).step_by(2)).copied().collect();
    // The first byte stays as it is.
    let mut before = 128u8;
    for byte in &mut bytes {
        let difference = byte.wrapping_sub(before).wrapping_add(128);
        before = std::mem::replace(byte, difference);
    }
    bytes
}

fn failed(path: &Path, error: exr::error::Error) -> Error {
    match error {
        exr::error::Error::Io(source) => Error::io("write", path)(source),
        other => refused(path, other.to_string()),
    }
}

fn refused(path: &Path, problem: String) -> Error {
    Error::run(format!("writing {}", path.display()), problem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_that_zip_makes_larger_is_kept_as_it_is() {
        let noise: Vec<u8> = (1u32..600)
            .map(|i| (i.wrapping_mul(0x9e37_79b9).rotate_left(i) ^ i.wrapping_mul(0x85eb_ca6b)) as u8)
            .collect();
        let of = |data: &[u8]| match compressed(2, data.to_vec()).unwrap().compressed_block {
            CompressedBlock::ScanLine(block) => (block.y_coordinate, block.compressed_pixels_le),
            _ => unreachable!(),
        };
        assert_eq!(of(&noise), (32, noise.clone()));
        assert!(of(&[7; 600]).1.len() < 40);
    }
}
