//! Small files for the tests of this module.

use crate::codec::image::encode_jpeg;
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage,
};
use glam::Vec3;
use image::{Rgb, RgbImage};
use lobelia_geometry::{Error, Result, view::Frame};
use std::{io::Cursor, io::Write, path::Path, path::PathBuf};
use tempfile::TempDir;

/// The path of a file in a new folder, which is gone when the first value is dropped.
pub(crate) fn temporary(name: &str) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    (folder, path)
}

/// A frame of finite values, each layer another.
pub(crate) fn frame(width: usize, height: usize) -> Frame {
    let vectors = |seed: usize| -> Vec<Vec3> {
        (0..width * height).map(|i| Vec3::new(i as f32 * 0.37, seed as f32 - i as f32, 1e-30)).collect()
    };
    let [color, diffuse, specular, albedo, normal] = [1, 2, 3, 4, 5].map(vectors);
    let [alpha, depth] = [3, 7].map(|seed| (0..width * height).map(|i| (i * seed) as f32 * 0.01).collect());
    Frame { width, height, color, alpha, diffuse, specular, albedo, normal, depth }
}

/// An EXR file.
pub(crate) fn exr_of(width: usize, height: usize, channels: Vec<(&str, FlatSamples)>) -> Vec<u8> {
    let list = channels.into_iter().map(|(name, samples)| AnyChannel::new(name, samples)).collect();
    let (attributes, channels) = (LayerAttributes::default(), AnyChannels::sort(list));
    let layer = Layer::new((width, height), attributes, Encoding::FAST_LOSSLESS, channels);
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

/// An EXR file of `f32` channels.
pub(crate) fn exr_bytes(width: usize, height: usize, channels: &[(&str, Vec<f32>)]) -> Vec<u8> {
    exr_of(
        width,
        height,
        channels.iter().map(|(name, values)| (*name, FlatSamples::F32(values.clone()))).collect(),
    )
}

/// Writes [`exr_bytes`].
pub fn write_exr(path: &Path, width: usize, height: usize, channels: &[(&str, Vec<f32>)]) {
    std::fs::write(path, exr_bytes(width, height, channels)).unwrap();
}

/// An `.npy` file of version 1.0.
pub(crate) fn npy(descr: &str, is_fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let order = if is_fortran { "True" } else { "False" };
    let text = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
    [b"\x93NUMPY\x01\0", &(text.len() as u16).to_le_bytes()[..], text.as_bytes(), data].concat()
}

/// An `.npy` file of a matrix, row by row, in `f64`.
pub(crate) fn npy_matrix(rows: usize, columns: usize, values: &[f64]) -> Vec<u8> {
    assert_eq!(values.len(), rows * columns);
    let data: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    npy("<f8", false, &format!("({rows}, {columns})"), &data)
}

/// The TIFF of an EXIF block that gives the orientation.
pub(crate) fn exif(orientation: u8) -> Vec<u8> {
    let mut chunk = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
    chunk.extend([orientation, 0, 0, 0, 0, 0, 0]);
    chunk
}

/// A JPEG of 16×8 pixels, bright on the left as stored, with an EXIF block that gives the orientation.
pub(crate) fn jpeg_with_orientation(orientation: u8) -> Vec<u8> {
    let image = RgbImage::from_fn(16, 8, |x, _| if x < 8 { Rgb([240; 3]) } else { Rgb([10; 3]) });
    let bytes = encode_jpeg(&image, 75).unwrap();
    let block = [&b"Exif\0\0"[..], &exif(orientation)].concat();
    let length = (block.len() as u16 + 2).to_be_bytes();
    [&bytes[..2], &[0xff, 0xe1], &length, &block, &bytes[2..]].concat()
}

/// Message and help of an error that is the input's fault.
#[track_caller]
pub(crate) fn input_error<T: std::fmt::Debug>(result: Result<T>) -> String {
    let error = result.unwrap_err();
    assert!(matches!(error, Error::Input { .. }), "{error:?}");
    format!("{error} | {}", error.help().unwrap_or_default())
}

/// Writes an `.npz` file of arrays with these names, deflated and stored by turns.
pub(crate) fn write_npz(path: &Path, arrays: &[(impl AsRef<str>, Vec<u8>)]) {
    let mut archive = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    let methods = [zip::CompressionMethod::Deflated, zip::CompressionMethod::Stored].into_iter().cycle();
    for ((name, bytes), method) in arrays.iter().zip(methods) {
        let options = zip::write::SimpleFileOptions::default().compression_method(method);
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
