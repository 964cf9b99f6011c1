//! Bytes compressed by deflate, without a header.

use crate::error::{Error, Result};
use flate2::{Compression, write::DeflateEncoder};
use std::io::Write as _;

/// The bytes, compressed as well as it goes.
///
/// # Errors
/// [`Error::Run`] if they cannot be compressed, which does not happen in memory.
pub fn deflate(bytes: &[u8]) -> Result<Vec<u8>> {
    let refused = |error: std::io::Error| Error::run("compressing", error.to_string());
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).map_err(refused)?;
    encoder.finish().map_err(refused)
}
