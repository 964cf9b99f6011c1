//! Small files for the tests of this module.

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage,
};
use glam::Vec3;
use std::io::{Cursor, Write};
use std::path::Path;

/// An EXR file of `f32` channels.
pub(crate) fn exr_bytes(width: usize, height: usize, channels: &[(&str, Vec<f32>)]) -> Vec<u8> {
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

/// An `.npy` file of a matrix, row by row, in `f64`.
pub(crate) fn npy_matrix(rows: usize, columns: usize, values: &[f64]) -> Vec<u8> {
    assert_eq!(values.len(), rows * columns);
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    let padding = (10 + header.len() + 1).next_multiple_of(64) - 11 - header.len();
    header.extend(std::iter::repeat_n(' ', padding));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// Writes an `.npz` file of arrays with these names.
pub(crate) fn write_npz(path: &Path, method: zip::CompressionMethod, arrays: &[(impl AsRef<str>, Vec<u8>)]) {
    let mut archive = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    let options = zip::write::SimpleFileOptions::default().compression_method(method);
    for (name, bytes) in arrays {
        archive.start_file(format!("{}.npy", name.as_ref()), options).unwrap();
        archive.write_all(bytes).unwrap();
    }
    archive.finish().unwrap();
}
/// A Radiance HDR file without runs; mantissas are truncated to eight bits.
pub(crate) fn hdr_bytes(width: usize, height: usize, pixels: &[Vec3]) -> Vec<u8> {
    let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
    for pixel in pixels {
        let exponent = pixel.max_element().max(1e-30).log2().floor() + 1.0;
        let mantissas = (*pixel * (8.0 - exponent).exp2()).to_array().map(|mantissa| mantissa as u8);
        bytes.extend(mantissas);
        bytes.push((exponent + 128.0) as u8);
    }
    bytes
}
