//! Reading OpenEXR: every flat layer's channels as `f32`, laid out on the display window.

use crate::codec::file::read_bytes;
use crate::codec::nearby::missing_file_help;
use crate::error::{Error, Result};
use exr::block::reader::Reader;
use exr::image::{AnyChannel, FlatSamples};
use exr::math::Vec2;
use exr::meta::attribute::IntegerBounds;
use exr::meta::header::Header;
use exr::prelude::{ReadChannels, ReadLayers, read};
use glam::Vec3;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

/// Decoded size in bytes above which a header is assumed to be damaged.
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
    /// Three channels as vectors; `None` if one is missing.
    pub fn triple(&self, names: [&str; 3]) -> Option<Vec<Vec3>> {
        let [x, y, z] = names.map(|name| self.channels.get(name));
        let (x, y, z) = (x?, y?, z?);
        Some(x.iter().zip(y).zip(z).map(|((&x, &y), &z)| Vec3::new(x, y, z)).collect())
    }

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

    /// The full names of the color channels and of alpha that make up the picture itself: the channels without prefix if
    /// they are R, G, B (or Y), else those of the first prefix, in the order of names, that has them. Alpha is optional.
    pub(crate) fn picture(&self) -> Option<([&str; 3], Option<&str>)> {
        let prefix_of = |name: &str| name.rfind('.').map_or(String::new(), |dot| name[..=dot].to_owned());
        let mut prefixes: Vec<String> = self.channels.keys().map(|name| prefix_of(name)).collect();
        prefixes.sort();
        prefixes.dedup();
        let find = |prefix: &str, channel: &str| {
            self.channels.get_key_value(&format!("{prefix}{channel}")).map(|(name, _)| name.as_str())
        };
        // The empty prefix sorts first.
        prefixes.iter().find_map(|prefix| {
            let rgb = [find(prefix, "R"), find(prefix, "G"), find(prefix, "B")];
            let color = match (rgb, find(prefix, "Y")) {
                ([Some(r), Some(g), Some(b)], _) => [r, g, b],
                (_, Some(y)) => [y; 3],
                _ => return None,
            };
            Some((color, find(prefix, "A")))
        })
    }
}

/// Reads all channels of all flat layers (half, float or uint) of an EXR file as `f32`.
///
/// # Errors
/// [`Error::Input`] if the file is missing, not an EXR, damaged, truncated, deep, chroma-subsampled, or empty.
pub fn read_exr_layers(path: impl AsRef<Path>) -> Result<ExrLayers> {
    let path = path.as_ref();
    decode_exr(path, &read_bytes(path, missing_file_help)?)
}

/// [`read_exr_layers`] on bytes already read; `path` is for messages.
pub(crate) fn decode_exr(path: &Path, bytes: &[u8]) -> Result<ExrLayers> {
    let damaged = |error: exr::error::Error| exr_error(path, &error);
    let reader = exr::block::read(Cursor::new(bytes), false).map_err(damaged)?;
    let window = check_headers(&reader, bytes.len()).map_err(|problem| {
        Error::input(
            path,
            "",
            problem,
            "Write the file again as flat scan lines or tiles at full resolution.",
        )
    })?;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        // Views are decoded in parallel already.
        .non_parallel()
        .from_chunks(reader)
        .map_err(damaged)?;

    let mut channels = BTreeMap::new();
    let has_parts = image.layer_data.len() > 1;
    for layer in image.layer_data {
        let part = layer.attributes.layer_name.filter(|_| has_parts).map(|name| name.to_string());
        let bounds = IntegerBounds::new(layer.attributes.layer_position, layer.size);
        for channel in layer.channel_data.list {
            let name = full_name(part.as_deref(), &channel.name.to_string());
            let values = on_window(to_f32(channel), bounds, window);
            channels.entry(name).or_insert(values);
        }
    }
    Ok(ExrLayers { width: window.size.x() as u32, height: window.size.y() as u32, channels })
}

/// The display window, if this reader can decode the headers and the size is plausible.
fn check_headers(reader: &Reader<Cursor<&[u8]>>, file_bytes: usize) -> Result<IntegerBounds, String> {
    let headers = reader.headers();
    let window = headers.first().ok_or("the file has no layers")?.shared_attributes.display_window;
    let area = |size: Vec2<usize>| size.x().checked_mul(size.y());
    let bytes_of = |header: &Header| {
        let largest = area(header.layer_size)?.max(area(window.size)?);
        largest.checked_mul(4 * header.channels.list.len())
    };
    let total = headers.iter().try_fold(0usize, |sum, header| sum.checked_add(bytes_of(header)?));
    // A damaged size implies a compression ratio that no picture has; small pictures are accepted without this check.
    let limit = MAX_DECODED_BYTES.min(LITTLE_BYTES + 10_000 * file_bytes);
    if total.is_none_or(|total| total > limit) {
        return Err(format!(
            "the header declares {}×{} pixels, more than the file can hold or this program can read",
            window.size.x(),
            window.size.y()
        ));
    }
    if total == Some(0) {
        return Err("the image has no pixels or no channels".into());
    }
    // Each chunk has 8 bytes in the offset table and at least 8 of its own.
    if headers.iter().any(|header| header.chunk_count > file_bytes / 16) {
        return Err(
            "the file is damaged or truncated: its header declares more data than the file contains".into()
        );
    }
    for header in headers {
        if header.deep {
            return Err("deep data are not supported".into());
        }
        if header.channels.list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
            return Err("subsampled channels (luminance-chroma) are not supported".into());
        }
    }
    Ok(window)
}

fn full_name(part: Option<&str>, channel: &str) -> String {
    match part {
        Some(part) if !part.is_empty() && !channel.starts_with(&format!("{part}.")) => {
            format!("{part}.{channel}")
        }
        _ => channel.to_owned(),
    }
}

fn to_f32(channel: AnyChannel<FlatSamples>) -> Vec<f32> {
    match channel.sample_data {
        FlatSamples::F16(values) => values.into_iter().map(|value| value.to_f32()).collect(),
        FlatSamples::F32(values) => values,
        FlatSamples::U32(values) => values.into_iter().map(|value| value as f32).collect(),
    }
}

/// Copies values that fill `bounds` to `window`, with 0 where there are none.
fn on_window(values: Vec<f32>, bounds: IntegerBounds, window: IntegerBounds) -> Vec<f32> {
    if bounds == window {
        return values;
    }
    let (width, height) = (window.size.x(), window.size.y());
    let offset =
        |axis: fn(Vec2<i32>) -> i32| i64::from(axis(bounds.position)) - i64::from(axis(window.position));
    let (left, top) = (offset(Vec2::x), offset(Vec2::y));
    let mut result = vec![0.0; width * height];
    for (row, line) in values.chunks_exact(bounds.size.x()).enumerate() {
        let y = top + row as i64;
        if y < 0 || y >= height as i64 {
            continue;
        }
        let target = &mut result[y as usize * width..][..width];
        let skipped = (-left).max(0) as usize;
        let start = left.max(0) as usize;
        for (to, from) in target.iter_mut().skip(start).zip(line.iter().skip(skipped)) {
            *to = *from;
        }
    }
    result
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
mod tests {
    use super::*;
    use crate::codec::test_data::{exr_bytes, write_exr};
    use exr::prelude::{
        AnyChannels, Compression, Encoding, Image, ImageAttributes, Layer, LayerAttributes, Layers,
        WritableImage, f16,
    };

    #[test]
    fn all_channels_come_back_by_their_full_names() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr");
        let ramp = |k: f32| (0..6).map(|i| i as f32 * k).collect::<Vec<_>>();
        write_exr(
            &path,
            3,
            2,
            &[("B", ramp(3.0)), ("diffuse.R", ramp(0.5)), ("R", ramp(1.0)), ("G", ramp(2.0))],
        );
        let layers = read_exr_layers(&path).unwrap();
        assert_eq!((layers.width, layers.height), (3, 2));
        assert_eq!(layers.channels.keys().collect::<Vec<_>>(), ["B", "G", "R", "diffuse.R"]);
        assert_eq!(layers.channels["diffuse.R"], ramp(0.5));
        assert_eq!(layers.picture(), Some((["R", "G", "B"], None)));
    }

    fn layers_named(names: &[&str]) -> ExrLayers {
        let channels = names.iter().map(|name| ((*name).to_owned(), vec![0.0])).collect();
        ExrLayers { width: 1, height: 1, channels }
    }

    #[test]
    fn the_picture_is_the_layer_without_prefix_else_the_first() {
        let both = layers_named(&["R", "G", "B", "A", "diffuse.R", "diffuse.G", "diffuse.B"]);
        assert_eq!(both.picture(), Some((["R", "G", "B"], Some("A"))));
        let prefixed = layers_named(&["z.R", "z.G", "z.B", "depth.Z", "b.c.R", "b.c.G", "b.c.B", "b.c.A"]);
        assert_eq!(prefixed.picture(), Some((["b.c.R", "b.c.G", "b.c.B"], Some("b.c.A"))));
        assert_eq!(layers_named(&["Y", "depth.Z"]).picture(), Some((["Y", "Y", "Y"], None)));
        assert_eq!(layers_named(&["Z", "R"]).picture(), None);
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
        let layers = decode_exr(Path::new("parts.exr"), &bytes).unwrap();
        assert_eq!((layers.width, layers.height), (3, 2));
        assert_eq!(layers.channels["one.R"], [2.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
        assert_eq!(layers.channels["two.B"], [0.0, 0.0, 0.0, 0.0, 0.0, 5.0]);
        assert_eq!(layers.picture(), Some((["one.R", "one.G", "one.B"], None)));
    }

    #[test]
    fn half_and_uint_are_read() {
        let list = vec![
            AnyChannel::new("Y", FlatSamples::F16(vec![f16::from_f32(0.5), f16::from_f32(2.0)])),
            AnyChannel::new("id", FlatSamples::U32(vec![7, 9])),
        ];
        let layer = Layer::new(
            (2, 1),
            LayerAttributes::default(),
            Encoding::UNCOMPRESSED,
            AnyChannels::sort(list.into_iter().collect()),
        );
        let mut bytes = Cursor::new(Vec::new());
        Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
        let layers = decode_exr(Path::new("half.exr"), bytes.get_ref()).unwrap();
        assert_eq!(layers.channels["Y"], [0.5, 2.0]);
        assert_eq!(layers.channels["id"], [7.0, 9.0]);
    }

    #[test]
    fn a_file_cut_short_anywhere_is_an_error() {
        let bytes = exr_bytes(4, 40, &[("R", vec![0.25; 160]), ("G", vec![0.5; 160]), ("B", vec![1.0; 160])]);
        let whole = decode_exr(Path::new("whole.exr"), &bytes).unwrap();
        for length in 0..bytes.len() {
            match decode_exr(Path::new("cut.exr"), &bytes[..length]) {
                Ok(layers) => {
                    assert_eq!(layers, whole, "wrong pixels from {length} of {} bytes", bytes.len());
                }
                Err(error) => assert!(matches!(error, Error::Input { .. })),
            }
        }
        assert!(decode_exr(Path::new("cut.exr"), &bytes[..bytes.len() - 8]).is_err());
    }

    #[test]
    fn a_damaged_file_never_panics() {
        let half = (0..80).map(|i| f16::from_f32(i as f32)).collect();
        let list = vec![AnyChannel::new("R", FlatSamples::F16(half))];
        for compression in [
            Compression::Uncompressed,
            Compression::RLE,
            Compression::ZIP16,
            Compression::PIZ,
            Compression::B44,
        ] {
            let encoding = Encoding { compression, ..Encoding::UNCOMPRESSED };
            let channels = AnyChannels::sort(list.clone().into());
            let mut bytes = Cursor::new(Vec::new());
            let layer = Layer::new((4, 20), LayerAttributes::default(), encoding, channels);
            Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
            let bytes = bytes.into_inner();
            let mut refused = 0;
            for i in 0..bytes.len() {
                for flip in [0x01, 0xff] {
                    let mut damaged = bytes.clone();
                    damaged[i] ^= flip;
                    refused += usize::from(decode_exr(Path::new("damaged.exr"), &damaged).is_err());
                }
            }
            assert!(refused > 0);
        }
    }

    #[test]
    fn absurd_sizes_are_refused_before_memory_is_taken() {
        let window = IntegerBounds::new((0, 0), (60_000, 60_000));
        let bytes = file_of_parts(&[("a", Vec2(0, 0), 1.0)], window);
        let error = decode_exr(Path::new("huge.exr"), &bytes).unwrap_err();
        assert!(error.to_string().contains("60000×60000"), "{error}");
    }
}
