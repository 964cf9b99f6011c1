//! Reading OpenEXR: channels of flat layers as `f32`, laid out on the display window. Pixels of the
//! window outside a layer are 0.

use crate::codec::image::format::{Format, ImageHeader, MAX_DECODED_BYTES};
use crate::codec::{file::Source, file::open, nearby::missing_file_help};
use exr::block::reader::{ChunksReader, Reader};
use exr::meta::attribute::{IntegerBounds, SampleType};
use exr::{error::Error as ExrError, math::Vec2, meta::header::Header, prelude::f16};
use glam::Vec3;
use lobelia_geometry::{Error, Result};
use std::{collections::BTreeMap, io::SeekFrom, path::Path};

/// The channels of an EXR file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExrLayers {
    /// Width of the display window in pixels.
    pub width: u32,
    /// Height of the display window in pixels.
    pub height: u32,
    /// Each channel's `width * height` values, row by row from the top left, by full name: `R`,
    /// `diffuse.R`, `depth.Z`. In files with several named parts the name of the part comes before
    /// that of the channel. Pixels outside a layer are 0.
    pub channels: BTreeMap<String, Vec<f32>>,
}

impl ExrLayers {
    /// Inserts three channels from vectors.
    pub fn insert_triple(&mut self, names: [&str; 3], values: &[Vec3]) {
        for (axis, name) in names.into_iter().enumerate() {
            self.channels.insert(name.to_owned(), values.iter().map(|v| v[axis]).collect());
        }
    }
}

/// The full names of the channels that make up the picture itself, R, G, B or Y, with A behind them
/// if there is one: the channels without prefix if they have these, else those of the first prefix,
/// in the order of names, that has them.
fn picture<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Option<Vec<&'a str>> {
    let prefix_of = |name: &'a str| name.rfind('.').map_or("", |dot| &name[..=dot]);
    let mut prefixes: Vec<&str> = names.clone().map(prefix_of).collect();
    // The empty prefix sorts first.
    prefixes.sort_unstable();
    prefixes.dedup();
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

/// Reads the header of the picture in an EXR; `path` is for messages.
///
/// # Errors
/// As for [`read_exr_layers`]; also if there is no picture, that is, no channels R, G, B or Y.
pub(crate) fn exr_header<'p>(path: &'p Path, source: Box<dyn Source + 'p>) -> Result<ImageHeader> {
    Contents::open(path, source)?.picture().map(|(header, _)| header)
}

/// Reads the picture of an EXR: samples of a pixel lie side by side, rows from the top down.
///
/// # Errors
/// As for [`exr_header`].
pub(crate) fn decode_exr_picture<'p>(path: &'p Path, source: Box<dyn Source + 'p>) -> Result<Vec<f32>> {
    let contents = Contents::open(path, source)?;
    let (_, places) = contents.picture()?;
    Ok(contents.read(&[places])?.swap_remove(0))
}

/// Reads all channels of all flat layers (half, float or uint) of an EXR file as `f32`.
///
/// # Errors
/// [`Error::Input`] if the file is missing, not an EXR, damaged, truncated, deep,
/// chroma-subsampled, or empty.
pub fn read_exr_layers(path: impl AsRef<Path>) -> Result<ExrLayers> {
    let path = path.as_ref();
    let contents = Contents::open(path, Box::new(open(path, missing_file_help)?))?;
    let [width, height] = contents.size().map(|side| side as u32);
    let (names, places): (Vec<String>, Vec<Vec<Place>>) =
        contents.channels.iter().map(|(name, place)| (name.clone(), vec![*place])).unzip();
    let channels = names.into_iter().zip(contents.read(&places)?).collect();
    Ok(ExrLayers { width, height, channels })
}

/// Reads some channels of an EXR: those of a group lie side by side, pixel by pixel. Returns the
/// size too.
///
/// # Errors
/// As for [`read_exr_layers`]; also if a channel is missing.
pub(crate) fn read_exr_groups(path: &Path, groups: &[&[&str]]) -> Result<([usize; 2], Vec<Vec<f32>>)> {
    let contents = Contents::open(path, Box::new(open(path, missing_file_help)?))?;
    let place = |name: &&str| {
        contents.channels.get(*name).copied().ok_or_else(|| {
            let problem = format!("has no channel {name}; it has {}", contents.names());
            Error::input(path, "", problem, "Use a file that this program wrote.")
        })
    };
    let places = groups.iter().map(|names| names.iter().map(place).collect()).collect::<Result<Vec<_>>>()?;
    Ok((contents.size(), contents.read(&places)?))
}

/// Where a channel lies in the file: the layer, and the channel of it.
type Place = (usize, usize);

/// An EXR whose headers are read and checked; the pixels follow.
struct Contents<'p> {
    path: &'p Path,
    reader: Reader<Box<dyn Source + 'p>>,
    window: IntegerBounds,
    /// By full name. Of several channels of one name it is the first.
    channels: BTreeMap<String, Place>,
}

impl<'p> Contents<'p> {
    fn open(path: &'p Path, mut source: Box<dyn Source + 'p>) -> Result<Self> {
        let file_bytes = source.seek(SeekFrom::End(0)).map_err(Error::io("read", path))?;
        source.rewind().map_err(Error::io("read", path))?;
        let reader = exr::block::read(source, false).map_err(|error| exr_error(path, &error))?;
        let window = check_headers(reader.headers(), file_bytes);
        let window = window.map_err(|problem| unusable(path, problem))?;
        Ok(Self { path, window, channels: full_names(reader.headers()), reader })
    }

    fn size(&self) -> [usize; 2] {
        [self.window.size.width(), self.window.size.height()]
    }

    /// "A, B, G, …", for messages.
    fn names(&self) -> String {
        self.channels.keys().map(String::as_str).collect::<Vec<_>>().join(", ")
    }

    fn picture(&self) -> Result<(ImageHeader, Vec<Place>)> {
        let Some(names) = picture(self.channels.keys().map(String::as_str)) else {
            let problem = format!("no channels R, G, B or Y; the file has {}", self.names());
            return Err(Error::input(self.path, "", problem, "Write the picture as channels R, G, B."));
        };
        let places: Vec<Place> = names.iter().map(|name| self.channels[*name]).collect();
        self.check_size(places.len())?;
        let (layer, channel) = places[0];
        let first = &self.reader.headers()[layer].channels.list[channel];
        let bits = 8 * first.sample_type.bytes_per_sample() as u32;
        let ([width, height], channels) = (self.size().map(|side| side as u32), places.len());
        let format = Format::Exr;
        Ok((ImageHeader { format, width, height, channels, bits, is_float: true, exif: 1 }, places))
    }

    /// Checks that so many channels of the display window fit into memory.
    fn check_size(&self, channels: usize) -> Result<()> {
        let [width, height] = self.size();
        let bytes = width.checked_mul(height).and_then(|area| area.checked_mul(4 * channels));
        let problem = match bytes {
            Some(0) => "the image has no pixels or no channels".to_owned(),
            Some(bytes) if bytes <= MAX_DECODED_BYTES => return Ok(()),
            _ => format!("the header declares {width}×{height} pixels, more than this program can read"),
        };
        Err(unusable(self.path, problem))
    }

    /// Reads the channels of each group side by side into a buffer. Pixels outside a layer are 0.
    fn read(self, groups: &[Vec<Place>]) -> Result<Vec<Vec<f32>>> {
        self.check_size(groups.iter().map(Vec::len).sum())?;
        let ([width, height], corner) = (self.size(), self.window.position);
        let mut buffers: Vec<Vec<f32>> =
            groups.iter().map(|group| vec![0.0; width * height * group.len()]).collect();
        let damaged = |error: ExrError| exr_error(self.path, &error);
        let is_wanted = |layer: usize| groups.iter().flatten().any(|place| place.0 == layer);
        let largest = Vec2(0, 0);
        let chunks = self
            .reader
            .filter_chunks(false, |_, tile, block| tile.level_index == largest && is_wanted(block.layer))
            .map_err(damaged)?;
        // Not parallel: views are decoded in parallel already.
        let mut blocks = chunks.sequential_decompressor(false);
        while let Some(block) = blocks.next() {
            let block = block.map_err(damaged)?;
            let header = &blocks.meta_data().headers[block.index.layer];
            let origin = header.own_attributes.layer_position;
            for line in block.lines(&header.channels).filter(|line| line.location.level == largest) {
                let at = line.location;
                let left = i64::from(origin.x()) - i64::from(corner.x()) + at.position.x() as i64;
                let top = i64::from(origin.y()) - i64::from(corner.y()) + at.position.y() as i64;
                if !(0..height as i64).contains(&top) {
                    continue;
                }
                let place = (at.layer, at.channel);
                for (group, buffer) in groups.iter().zip(&mut buffers) {
                    let row = &mut buffer[top as usize * width * group.len()..][..width * group.len()];
                    for offset in (0..group.len()).filter(|offset| group[*offset] == place) {
                        let cells = row.iter_mut().skip(offset).step_by(group.len());
                        let samples = floats(line.value, header.channels.list[at.channel].sample_type);
                        // Samples without a cell are left out.
                        let inside = samples.into_iter().skip((-left).max(0) as usize);
                        let cells = cells.skip(left.max(0) as usize);
                        cells.zip(inside).for_each(|(cell, sample)| *cell = sample);
                    }
                }
            }
        }
        Ok(buffers)
    }
}

/// Samples of this type as floats.
fn floats(raw: &[u8], kind: SampleType) -> Vec<f32> {
    match kind {
        SampleType::F16 => raw.as_chunks().0.iter().map(|half| f16::from_ne_bytes(*half).to_f32()).collect(),
        SampleType::F32 => raw.as_chunks().0.iter().map(|float| f32::from_ne_bytes(*float)).collect(),
        SampleType::U32 => raw.as_chunks().0.iter().map(|uint| u32::from_ne_bytes(*uint) as f32).collect(),
    }
}

/// The display window, if this reader can decode the headers.
fn check_headers(headers: &[Header], file_bytes: u64) -> Result<IntegerBounds, &'static str> {
    let window = headers.first().ok_or("the file has no layers")?.shared_attributes.display_window;
    for header in headers {
        let block = header.max_block_pixel_size();
        let area = block.width().checked_mul(block.height());
        let bytes = area.and_then(|area| area.checked_mul(header.channels.bytes_per_pixel));
        // Each chunk has 8 bytes in the offset table and at least 8 of its own.
        let is_possible = header.chunk_count as u64 <= file_bytes / 16;
        if !is_possible || bytes.is_none_or(|bytes| bytes > MAX_DECODED_BYTES) {
            return Err("the file is damaged or truncated: its header declares more data than it can hold");
        }
        if header.deep {
            return Err("deep data are not supported");
        }
        if header.channels.list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
            return Err("subsampled channels (luminance-chroma) are not supported");
        }
    }
    Ok(window)
}

/// Places of channels by their names, behind that of their part if there are several.
fn full_names(headers: &[Header]) -> BTreeMap<String, Place> {
    let mut channels = BTreeMap::new();
    for (layer, header) in headers.iter().enumerate() {
        let part = header.own_attributes.layer_name.as_ref().filter(|_| headers.len() > 1);
        let prefix = part.map(|part| format!("{part}.")).filter(|prefix| prefix != ".").unwrap_or_default();
        for (channel, description) in header.channels.list.iter().enumerate() {
            let name = description.name.to_string();
            let name = if name.starts_with(&prefix) { name } else { format!("{prefix}{name}") };
            channels.entry(name).or_insert((layer, channel));
        }
    }
    channels
}

fn unusable(path: &Path, problem: impl Into<String>) -> Error {
    let help = "Write the file again as flat scan lines or tiles at full resolution, with ZIP, PIZ or no compression.";
    Error::input(path, "", problem, help)
}

fn exr_error(path: &Path, error: &ExrError) -> Error {
    match error {
        ExrError::NotSupported(what) => unusable(path, format!("this kind of EXR cannot be read: {what}")),
        other => {
            let problem = format!("the EXR is damaged or truncated: {other}");
            Error::input(path, "", problem, "Copy or render the file again.")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::temporary;
    use exr::image::{AnyChannel, FlatSamples};
    use exr::prelude::{
        AnyChannels, Encoding, Image, ImageAttributes, Layer, LayerAttributes, Layers, WritableImage,
    };
    use std::io::Cursor;

    #[test]
    fn the_picture_is_the_layer_without_prefix_else_the_first() {
        let of = |names: &'static [&'static str]| picture(names.iter().copied()).unwrap_or_default();
        let both = ["R", "G", "B", "A", "diffuse.R", "diffuse.G", "diffuse.B"];
        assert_eq!(picture(both.into_iter()).unwrap(), ["R", "G", "B", "A"]);
        let prefixed = of(&["z.R", "z.G", "z.B", "depth.Z", "b.c.R", "b.c.G", "b.c.B", "b.c.A"]);
        assert_eq!(prefixed, ["b.c.R", "b.c.G", "b.c.B", "b.c.A"]);
        assert_eq!(of(&["Y", "depth.Z"]), ["Y"]);
        assert_eq!(of(&["A", "Y"]), ["Y", "A"]);
        assert!(of(&["Z", "R"]).is_empty());
    }

    fn file_of_parts(parts: &[(&str, Vec2<i32>, f32)], window: IntegerBounds) -> Vec<u8> {
        let layers = parts.iter().map(|&(name, position, value)| {
            let list = ["R", "G", "B"].map(|c| AnyChannel::new(c, FlatSamples::F32(vec![value; 4])));
            let mut layer = Layer::new(
                (2, 2),
                LayerAttributes::named(name),
                Encoding::FAST_LOSSLESS,
                AnyChannels::sort(list.into_iter().collect()),
            );
            layer.attributes.layer_position = position;
            layer
        });
        let image =
            Image { attributes: ImageAttributes::new(window), layer_data: layers.collect::<Layers<_>>() };
        let mut bytes = Cursor::new(Vec::new());
        image.write().to_buffered(&mut bytes).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn parts_are_laid_out_on_the_display_window() {
        let window = IntegerBounds::new((0, 0), (3, 2));
        let bytes = file_of_parts(&[("one", Vec2(-1, 0), 2.0), ("two", Vec2(2, 1), 5.0)], window);
        let (_folder, path) = temporary("parts.exr");
        std::fs::write(&path, &bytes).unwrap();
        let layers = read_exr_layers(&path).unwrap();
        assert_eq!((layers.width, layers.height), (3, 2));
        assert_eq!(layers.channels["one.R"], [2.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
        assert_eq!(layers.channels["two.B"], [0.0, 0.0, 0.0, 0.0, 0.0, 5.0]);
        assert!(layers.channels.keys().eq(["one.B", "one.G", "one.R", "two.B", "two.G", "two.R"]));
        let samples = decode_exr_picture(&path, Box::new(Cursor::new(&bytes))).unwrap();
        assert_eq!(samples[..6], [2.0, 2.0, 2.0, 0.0, 0.0, 0.0]);
        let header = exr_header(&path, Box::new(Cursor::new(&bytes))).unwrap();
        assert_eq!((header.width, header.height, header.channels, header.bits), (3, 2, 3, 32));
    }

    #[test]
    fn absurd_sizes_are_refused_before_memory_is_taken() {
        let window = IntegerBounds::new((0, 0), (60_000, 60_000));
        let bytes = file_of_parts(&[("a", Vec2(0, 0), 1.0)], window);
        let error = exr_header(Path::new("huge.exr"), Box::new(Cursor::new(&bytes))).unwrap_err();
        assert!(error.to_string().contains("60000×60000"), "{error}");
    }
}
