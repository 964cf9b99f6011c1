//! Bytes compressed by deflate.

use crate::error::{Error, Result};
use flate2::{Compression, write::DeflateEncoder, write::ZlibEncoder};
use std::io::Write as _;

/// The bytes without a header, compressed as well as it goes.
///
/// # Errors
/// [`Error::Run`] if they cannot be compressed, which does not happen in memory.
pub fn deflate(bytes: &[u8]) -> Result<Vec<u8>> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).map_err(refused)?;
    encoder.finish().map_err(refused)
}

/// The bytes in zlib's format, compressed as fast as it goes.
///
/// # Errors
/// Those of [`deflate`].
pub fn zlib_fast(bytes: &[u8]) -> Result<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::with_capacity(bytes.len() / 4), Compression::fast());
    encoder.write_all(bytes).map_err(refused)?;
    encoder.finish().map_err(refused)
}

fn refused(error: std::io::Error) -> Error {
    Error::run("compressing", error.to_string())
}
