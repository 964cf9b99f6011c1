//! Reading OpenEXR: channels of flat layers as `f32`, laid out on the display window.

use crate::codec::file::open;
use crate::codec::nearby::missing_file_help;
use crate::error::{Error, Result};
use exr::block::UncompressedBlock;
use exr::block::reader::{ChunksReader, Reader};
use exr::math::Vec2;
use exr::meta::attribute::{IntegerBounds, SampleType};
use exr::meta::header::Header;
use exr::prelude::f16;
use glam::Vec3;
use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// Decoded size in bytes above which a file is refused.
pub(super) const MAX_DECODED_BYTES: usize = 1 << 31;

/// Decoded size in bytes up to which a header is accepted for a file of any size.
const LITTLE_BYTES: usize = 1 << 26;

/// The channels of an EXR file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExrLayers {
    /// Width of the display window in pixels.
    pub width: u32,
    /// Height of the display window in pixels.
    pub height: u32,
    /// Each channel's `width * height` values, row by row from the top left, by full name: `R`, `diffuse.R`, `depth.Z`.
    /// In files with several named parts the name of the part comes before that of the channel. Pixels outside a layer are 0.
    pub channels: BTreeMap<String, Vec<f32>>,
}

impl ExrLayers {
    /// Inserts three channels from vectors.
    pub fn insert_triple(&mut self, names: [&str; 3], values: &[Vec3]) {
        for (axis, name) in names.into_iter().enumerate() {
            self.channels.insert(name.to_owned(), values.iter().map(|v| v[axis]).collect());
        }
    }

    /// "A, B, G, …", for messages.
    pub fn names(&self) -> String {
        self.channels.keys().map(String::as_str).collect::<Vec<_>>().join(", ")
    }
}

/// The full names of the channels that make up the picture itself, R, G, B or Y, with A behind them if there is one: the channels
/// without prefix if they have these, else those of the first prefix, in the order of names, that has them.
fn picture<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Option<Vec<&'a str>> {
    let prefix_of = |name: &'a str| name.rfind('.').map_or("", |dot| &name[..=dot]);
    let mut prefixes: Vec<&str> = names.clone().map(prefix_of).collect();
    prefixes.sort_unstable();
    prefixes.dedup();
    // The empty prefix sorts first.
    prefixes.into_iter().find_map(|prefix| {
        let find = |channel: &str| names.clone().find(|name| name.strip_prefix(prefix) == Some(channel));
        let mut found = match ([find("R"), find("G"), find("B")], find("Y")) {
            ([Some(r), Some(g), Some(b)], _) => vec![r, g, b],
            (_, Some(y)) => vec![y],
            _ => return None,
        };
        found.extend(find("A"));
        Some(found)
    })
}

/// What the header of an EXR says of its picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ExrHeader {
    /// Width of the display window in pixels.
    pub width: u32,
    /// Height of the display window in pixels.
    pub height: u32,
    /// Number of samples per pixel: gray, gray and alpha, RGB, RGB and alpha.
    pub channels: usize,
    /// Bits of a stored color sample: 16 or 32.
    pub bits: u32,
}

/// Reads the header of an EXR; `path` is for messages.
///
/// # Errors
/// Those of [`read_exr_layers`]; also if there is no picture, that is, no channels R, G, B or Y.
pub(crate) fn exr_header(path: &Path, source: impl Read + Seek) -> Result<ExrHeader> {
    Contents::open(path, source)?.picture(path).map(|(header, _)| header)
}

/// Reads the picture of an EXR: samples of a pixel lie side by side, rows from the top down.
///
/// # Errors
/// Those of [`exr_header`].
pub(crate) fn decode_exr_picture(path: &Path, source: impl Read + Seek) -> Result<(ExrHeader, Vec<f32>)> {
    let contents = Contents::open(path, source)?;
    let (header, places) = contents.picture(path)?;
    let stride = places.len();
    let target = |(offset, place)| Target { place, buffer: 0, offset, stride };
    let targets: Vec<Target> = places.into_iter().enumerate().map(target).collect();
    let samples = contents.read(path, &targets)?.swap_remove(0);
    Ok((header, samples))
}

/// Reads all channels of all flat layers (half, float or uint) of an EXR file as `f32`.
///
/// # Errors
/// [`Error::Input`] if the file is missing, not an EXR, damaged, truncated, deep, chroma-subsampled, or empty.
pub fn read_exr_layers(path: impl AsRef<Path>) -> Result<ExrLayers> {
    let path = path.as_ref();
    decode_exr(path, open(path, missing_file_help)?)
}

/// Reads some channels of an EXR: those of a group lie side by side, pixel by pixel. Returns the size too; `path` is for messages.
///
/// # Errors
/// Those of [`read_exr_layers`]; also if a channel is missing.
pub(crate) fn read_exr_groups(path: &Path, groups: &[&[&str]]) -> Result<([usize; 2], Vec<Vec<f32>>)> {
    let contents = Contents::open(path, open(path, missing_file_help)?)?;
    let mut targets = Vec::new();
    for (buffer, names) in groups.iter().enumerate() {
        for (offset, name) in names.iter().enumerate() {
            let place = *contents.channels.get(*name).ok_or_else(|| contents.missing(path, name))?;
            targets.push(Target { place, buffer, offset, stride: names.len() });
        }
    }
    Ok((contents.size(), contents.read(path, &targets)?))
}

/// [`read_exr_layers`] of a file already open; `path` is for messages.
fn decode_exr(path: &Path, source: impl Read + Seek) -> Result<ExrLayers> {
    let contents = Contents::open(path, source)?;
    let [width, height] = contents.size().map(|side| side as u32);
    let target = |(buffer, &place)| Target { place, buffer, offset: 0, stride: 1 };
    let targets: Vec<Target> = contents.channels.values().enumerate().map(target).collect();
    let names: Vec<String> = contents.channels.keys().cloned().collect();
    let channels = names.into_iter().zip(contents.read(path, &targets)?).collect();
    Ok(ExrLayers { width, height, channels })
}

/// Where a channel lies in the file.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Place {
    layer: usize,
    channel: usize,
}

/// Where the samples of a channel go: to `offset` and every `stride` samples from there in one of the buffers.
struct Target {
    place: Place,
    buffer: usize,
    offset: usize,
    stride: usize,
}

/// An EXR whose headers are read and checked; the pixels follow.
struct Contents<R> {
    reader: Reader<R>,
    window: IntegerBounds,
    /// By full name. Of several channels of one name it is the first.
    channels: BTreeMap<String, Place>,
    /// Decoded bytes that a file of this size may have.
    most_bytes: usize,
}

impl<R: Read + Seek> Contents<R> {
    fn open(path: &Path, mut source: R) -> Result<Self> {
        let file_bytes = source.seek(SeekFrom::End(0)).map_err(Error::io("read", path))?;
        source.rewind().map_err(Error::io("read", path))?;
        let file_bytes = usize::try_from(file_bytes).unwrap_or(usize::MAX);
        let reader = exr::block::read(source, false).map_err(|error| exr_error(path, &error))?;
        // A damaged size implies a compression ratio that no picture has; small pictures are accepted without this check.
        let most_bytes =
            MAX_DECODED_BYTES.min(LITTLE_BYTES.saturating_add(file_bytes.saturating_mul(10_000)));
        let window = check_headers(reader.headers(), file_bytes, most_bytes)
            .map_err(|problem| unusable(path, problem))?;
        let channels = full_names(reader.headers());
        Ok(Self { reader, window, channels, most_bytes })
    }

    fn size(&self) -> [usize; 2] {
        [self.window.size.width(), self.window.size.height()]
    }

    /// "A, B, G, …", for messages.
    fn names(&self) -> String {
        self.channels.keys().map(String::as_str).collect::<Vec<_>>().join(", ")
    }

    fn missing(&self, path: &Path, name: &str) -> Error {
        let problem = format!("channel {name} is missing; it has {}", self.names());
        Error::input(path, "", problem, "a frame is an EXR that a render pass has written")
    }

    fn picture(&self, path: &Path) -> Result<(ExrHeader, Vec<Place>)> {
        let Some(names) = picture(self.channels.keys().map(String::as_str)) else {
            let problem = format!("no channels R, G, B or Y; the file has {}", self.names());
            return Err(Error::input(path, "", problem, "Write the picture as channels R, G, B."));
        };
        let places: Vec<Place> = names.iter().map(|name| self.channels[*name]).collect();
        self.check_size(path, places.len())?;
        let first = &self.reader.headers()[places[0].layer].channels.list[places[0].channel];
        let bits = 8 * first.sample_type.bytes_per_sample() as u32;
        let [width, height] = self.size().map(|side| side as u32);
        Ok((ExrHeader { width, height, channels: places.len(), bits }, places))
    }

    /// Whether `channels` channels of the display window fit into memory, and may come out of such a file.
    fn check_size(&self, path: &Path, channels: usize) -> Result<()> {
        let [width, height] = self.size();
        let bytes = width.checked_mul(height).and_then(|area| area.checked_mul(4 * channels));
        if bytes.is_none_or(|bytes| bytes > self.most_bytes) {
            let problem = format!(
                "the header declares {width}×{height} pixels, more than the file can hold or this program can read"
            );
            return Err(unusable(path, problem));
        }
        if bytes == Some(0) {
            return Err(unusable(path, "the image has no pixels or no channels".to_owned()));
        }
        Ok(())
    }

    /// Reads the channels of `targets` into as many buffers as these name. Pixels outside a layer are 0.
    fn read(self, path: &Path, targets: &[Target]) -> Result<Vec<Vec<f32>>> {
        self.check_size(path, targets.len())?;
        let [width, height] = self.size();
        let window = self.window;
        let mut buffers: Vec<Vec<f32>> = Vec::new();
        for target in targets.iter().filter(|target| target.offset == 0) {
            debug_assert_eq!(target.buffer, buffers.len());
            buffers.push(vec![0.0; width * height * target.stride]);
        }
        let wanted = |layer: usize| targets.iter().filter(move |target| target.place.layer == layer);
        let damaged = |error: exr::error::Error| exr_error(path, &error);
        let largest = Vec2(0, 0);
        let chunks = self
            .reader
            .filter_chunks(false, |_, tile, block| {
                tile.level_index == largest && wanted(block.layer).next().is_some()
            })
            .map_err(damaged)?;
        // Not parallel: views are decoded in parallel already.
        let mut blocks = chunks.sequential_decompressor(false);
        while let Some(block) = blocks.next() {
            let block = block.map_err(damaged)?;
            let header = &blocks.meta_data().headers[block.index.layer];
            for target in wanted(block.index.layer).filter(|_| block.index.level == largest) {
                copy_block(&block, header, target, window, &mut buffers[target.buffer]);
            }
        }
        Ok(buffers)
    }
}

/// Copies the samples of one channel of a block to their places on the window; what lies outside is left out.
fn copy_block(
    block: &UncompressedBlock,
    header: &Header,
    target: &Target,
    window: IntegerBounds,
    to: &mut [f32],
) {
    let origin = header.own_attributes.layer_position;
    let corner = |axis: fn(Vec2<i32>) -> i32, within: usize| {
        i64::from(axis(origin)) - i64::from(axis(window.position)) + within as i64
    };
    let left = corner(Vec2::x, block.index.pixel_position.x());
    let top = corner(Vec2::y, block.index.pixel_position.y());
    let channels = &header.channels.list;
    let kind = channels[target.place.channel].sample_type;
    let size = |kind: SampleType| kind.bytes_per_sample();
    let before: usize = channels[..target.place.channel].iter().map(|c| size(c.sample_type)).sum();
    let columns = block.index.pixel_size.width();
    for row in 0..block.index.pixel_size.height() {
        let y = top + row as i64;
        let start = (row * header.channels.bytes_per_pixel + before) * columns;
        let Some(bytes) = block.data.get(start..start + size(kind) * columns) else { continue };
        if y < 0 || y >= window.size.height() as i64 {
            continue;
        }
        let line = window.size.width() * target.stride;
        let cells = to[y as usize * line..][..line].iter_mut().skip(target.offset).step_by(target.stride);
        copy_line(bytes, kind, (-left).max(0) as usize, cells.skip(left.max(0) as usize));
    }
}

/// Converts samples, from that at `first` on.
fn copy_line<'a>(bytes: &[u8], kind: SampleType, first: usize, to: impl Iterator<Item = &'a mut f32>) {
    fn from_here<const N: usize>(bytes: &[u8], first: usize) -> impl Iterator<Item = [u8; N]> {
        bytes.as_chunks().0.iter().copied().skip(first)
    }
    match kind {
        SampleType::F16 => {
            to.zip(from_here(bytes, first)).for_each(|(to, from)| *to = f16::from_ne_bytes(from).to_f32());
        }
        SampleType::F32 => {
            to.zip(from_here(bytes, first)).for_each(|(to, from)| *to = f32::from_ne_bytes(from));
        }
        SampleType::U32 => {
            to.zip(from_here(bytes, first)).for_each(|(to, from)| *to = u32::from_ne_bytes(from) as f32);
        }
    }
}

/// The display window, if this reader can decode the headers.
fn check_headers(headers: &[Header], file_bytes: usize, most_bytes: usize) -> Result<IntegerBounds, String> {
    let window = headers.first().ok_or("the file has no layers")?.shared_attributes.display_window;
    // Each chunk has 8 bytes in the offset table and at least 8 of its own.
    if headers.iter().any(|header| header.chunk_count > file_bytes / 16) {
        return Err(
            "the file is damaged or truncated: its header declares more data than the file contains".into()
        );
    }
    for header in headers {
        let block = header.max_block_pixel_size();
        let area = block.width().checked_mul(block.height());
        let bytes = area.and_then(|area| area.checked_mul(header.channels.bytes_per_pixel));
        if bytes.is_none_or(|bytes| bytes > most_bytes) {
            let (width, height) = (block.width(), block.height());
            return Err(format!(
                "the header declares tiles of {width}×{height} pixels, more than the file can hold"
            ));
        }
        if header.deep {
            return Err("deep data are not supported".into());
        }
        if header.channels.list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
            return Err("subsampled channels (luminance-chroma) are not supported".into());
        }
    }
    Ok(window)
}

fn full_names(headers: &[Header]) -> BTreeMap<String, Place> {
    let has_parts = headers.len() > 1;
    let mut channels = BTreeMap::new();
    for (layer, header) in headers.iter().enumerate() {
        let part = header.own_attributes.layer_name.as_ref().filter(|_| has_parts).map(ToString::to_string);
        for (channel, description) in header.channels.list.iter().enumerate() {
            let name = full_name(part.as_deref(), &description.name.to_string());
            channels.entry(name).or_insert(Place { layer, channel });
        }
    }
    channels
}

fn full_name(part: Option<&str>, channel: &str) -> String {
    match part {
        Some(part) if !part.is_empty() && !channel.starts_with(&format!("{part}.")) => {
            format!("{part}.{channel}")
        }
        _ => channel.to_owned(),
    }
}

fn unusable(path: &Path, problem: String) -> Error {
    let help = "Write the file again as flat scan lines or tiles at full resolution.";
    Error::input(path, "", problem, help)
}

fn exr_error(path: &Path, error: &exr::error::Error) -> Error {
    match error {
        exr::error::Error::NotSupported(what) => Error::input(
            path,
            "",
            format!("this kind of EXR cannot be read: {what}"),
            "Write it again with ZIP, PIZ or no compression, without deep data.",
        ),
        other => Error::input(
            path,
            "",
            format!("the EXR is damaged or truncated: {other}"),
            "Copy or render the file again.",
        ),
    }
}

#[cfg(test)]
mod tests;
