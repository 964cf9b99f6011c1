//! Numbers of an `.npy` file, whatever they mean.

use super::header::{self, Header};

/// A matrix, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub columns: usize,
    /// `rows * columns` values; they may be NaN or infinite.
    pub values: Vec<f64>,
}

/// The matrix in an `.npy` file of `bytes`: `f32` or `f64`, C or Fortran order, either byte order.
///
/// # Errors
/// The problem, as the rest of a sentence that starts with the name of the file.
pub(crate) fn parse_matrix(bytes: &[u8]) -> Result<Matrix, String> {
    let floats = Floats::new(bytes)?;
    let &[rows, columns] = floats.shape() else {
        return Err(format!("has shape {:?}, not that of a matrix", floats.shape()));
    };
    // No overflow: the data is as long as the shape says.
    let (rows, columns) = (rows as usize, columns as usize);
    Ok(Matrix { rows, columns, values: floats.matrix(rows, columns) })
}

/// Floating-point data whose length is that of its header's shape.
pub(super) struct Floats<'a> {
    header: Header<'a>,
    size: usize,
    decode: fn(&[u8]) -> f64,
    data: &'a [u8],
}

impl<'a> Floats<'a> {
    pub fn new(bytes: &'a [u8]) -> Result<Self, String> {
        let (header, data) = header::split(bytes)?;
        let (size, decode): (usize, fn(&[u8]) -> f64) = match header.descr {
            "<f4" => (4, |v| f64::from(f32::from_le_bytes(exactly(v)))),
            ">f4" => (4, |v| f64::from(f32::from_be_bytes(exactly(v)))),
            "<f8" => (8, |v| f64::from_le_bytes(exactly(v))),
            ">f8" => (8, |v| f64::from_be_bytes(exactly(v))),
            other => return Err(format!("holds {}, not 32- or 64-bit floats", other.escape_debug())),
        };
        // No overflow: a header's shape has at most 2⁴⁰ values.
        let length = header.shape.iter().product::<u64>() as usize * size;
        match data.get(..length) {
            Some(data) => Ok(Self { header, size, decode, data }),
            None => Err(format!("is truncated: too short for its shape {:?}", header.shape)),
        }
    }

    pub fn shape(&self) -> &[u64] {
        &self.header.shape
    }

    /// All values in C order, for a shape of these rows and columns.
    pub fn matrix(&self, rows: usize, columns: usize) -> Vec<f64> {
        let values: Vec<f64> = self.data.chunks_exact(self.size).map(self.decode).collect();
        if self.header.fortran_order { transposed(&values, rows, columns) } else { values }
    }
}

/// The bytes as an array; zeros if there are not `N` bytes.
fn exactly<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.try_into().unwrap_or([0; N])
}

fn transposed(values: &[f64], rows: usize, columns: usize) -> Vec<f64> {
    (0..rows * columns).map(|k| values[(k % columns) * rows + k / columns]).collect()
}
