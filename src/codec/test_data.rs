//! Small files for the tests of this module.

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage,
};
use glam::Vec3;
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

/// A Radiance HDR file without runs; mantissas are truncated to eight bits.
pub fn hdr_bytes(width: usize, height: usize, pixels: &[Vec3]) -> Vec<u8> {
    let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
    for pixel in pixels {
        let exponent = pixel.max_element().max(1e-30).log2().floor() + 1.0;
        let mantissas = (*pixel * (8.0 - exponent).exp2()).to_array().map(|mantissa| mantissa as u8);
        bytes.extend(mantissas);
        bytes.push((exponent + 128.0) as u8);
    }
    bytes
}
