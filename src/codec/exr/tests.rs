//! Tests of reading OpenEXR, on files made here.

use super::*;
use crate::codec::test_data::{exr_bytes, write_exr};
use exr::image::{AnyChannel, FlatSamples};
use exr::prelude::{
    AnyChannels, Compression, Encoding, Image, ImageAttributes, Layer, LayerAttributes, Layers,
    WritableImage, f16,
};
use std::io::Cursor;

#[test]
fn all_channels_come_back_by_their_full_names() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.exr");
    let ramp = |k: f32| (0..6).map(|i| i as f32 * k).collect::<Vec<_>>();
    write_exr(&path, 3, 2, &[("B", ramp(3.0)), ("diffuse.R", ramp(0.5)), ("R", ramp(1.0)), ("G", ramp(2.0))]);
    let layers = read_exr_layers(&path).unwrap();
    assert_eq!((layers.width, layers.height), (3, 2));
    assert_eq!(layers.channels.keys().collect::<Vec<_>>(), ["B", "G", "R", "diffuse.R"]);
    assert_eq!(layers.channels["diffuse.R"], ramp(0.5));
    assert_eq!(picture_in(&layers), ["R", "G", "B"]);
}

fn picture_in(layers: &ExrLayers) -> Vec<&str> {
    picture(layers.channels.keys().map(String::as_str)).unwrap()
}

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
    let image = Image { attributes: ImageAttributes::new(window), layer_data: layers.collect::<Layers<_>>() };
    let mut bytes = Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

#[test]
fn parts_are_laid_out_on_the_display_window() {
    let window = IntegerBounds::new((0, 0), (3, 2));
    let bytes = file_of_parts(&[("one", Vec2(-1, 0), 2.0), ("two", Vec2(2, 1), 5.0)], window);
    let layers = decode_exr(Path::new("parts.exr"), Cursor::new(&bytes)).unwrap();
    assert_eq!((layers.width, layers.height), (3, 2));
    assert_eq!(layers.channels["one.R"], [2.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    assert_eq!(layers.channels["two.B"], [0.0, 0.0, 0.0, 0.0, 0.0, 5.0]);
    assert_eq!(picture_in(&layers), ["one.R", "one.G", "one.B"]);
    let (header, samples) = decode_exr_picture(Path::new("parts.exr"), Cursor::new(&bytes)).unwrap();
    assert_eq!(header, ExrHeader { width: 3, height: 2, channels: 3, bits: 32 });
    assert_eq!(samples[..6], [2.0, 2.0, 2.0, 0.0, 0.0, 0.0]);
    assert_eq!(exr_header(Path::new("parts.exr"), Cursor::new(&bytes)).unwrap(), header);
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
    let (header, samples) = decode_exr_picture(Path::new("half.exr"), Cursor::new(bytes.get_ref())).unwrap();
    assert_eq!((header.bits, header.channels, samples), (16, 1, vec![0.5, 2.0]));
    let layers = decode_exr(Path::new("half.exr"), Cursor::new(bytes.get_ref())).unwrap();
    assert_eq!(layers.channels["Y"], [0.5, 2.0]);
    assert_eq!(layers.channels["id"], [7.0, 9.0]);
}

#[test]
fn a_file_cut_short_anywhere_is_an_error() {
    let bytes = exr_bytes(4, 40, &[("R", vec![0.25; 160]), ("G", vec![0.5; 160]), ("B", vec![1.0; 160])]);
    let whole = decode_exr(Path::new("whole.exr"), Cursor::new(&bytes)).unwrap();
    for length in 0..bytes.len() {
        match decode_exr(Path::new("cut.exr"), Cursor::new(&bytes[..length])) {
            Ok(layers) => {
                assert_eq!(layers, whole, "wrong pixels from {length} of {} bytes", bytes.len());
            }
            Err(error) => assert!(matches!(error, Error::Input { .. })),
        }
    }
    assert!(decode_exr(Path::new("cut.exr"), Cursor::new(&bytes[..bytes.len() - 8])).is_err());
}

#[test]
fn a_damaged_file_never_panics() {
    let half = (0..80).map(|i| f16::from_f32(i as f32)).collect();
    let list = vec![AnyChannel::new("R", FlatSamples::F16(half))];
    for compression in
        [Compression::Uncompressed, Compression::RLE, Compression::ZIP16, Compression::PIZ, Compression::B44]
    {
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
                refused += usize::from(decode_exr(Path::new("damaged.exr"), Cursor::new(&damaged)).is_err());
            }
        }
        assert!(refused > 0);
    }
}

#[test]
fn absurd_sizes_are_refused_before_memory_is_taken() {
    let window = IntegerBounds::new((0, 0), (60_000, 60_000));
    let bytes = file_of_parts(&[("a", Vec2(0, 0), 1.0)], window);
    let error = decode_exr(Path::new("huge.exr"), Cursor::new(&bytes)).unwrap_err();
    assert!(error.to_string().contains("60000×60000"), "{error}");
}
