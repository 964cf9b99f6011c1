//! Small files for the tests of this module.

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage,
};
use std::io::Cursor;
use std::path::Path;

/// An EXR file of `f32` channels.
pub fn exr_bytes(width: usize, height: usize, channels: &[(&str, Vec<f32>)]) -> Vec<u8> {
    let list = channels
        .iter()
        .map(|(name, values)| AnyChannel::new(*name, FlatSamples::F32(values.clone())))
        .collect();
    let layer = Layer::new(
        (width, height),
        LayerAttributes::default(),
        Encoding::FAST_LOSSLESS,
        AnyChannels::sort(list),
    );
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

/// Writes [`exr_bytes`].
pub fn write_exr(path: &Path, width: usize, height: usize, channels: &[(&str, Vec<f32>)]) {
    std::fs::write(path, exr_bytes(width, height, channels)).unwrap();
}
