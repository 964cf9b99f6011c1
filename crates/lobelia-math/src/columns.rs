//! Light lobes in columns, and the gradient with respect to the parameters that all points share.

use crate::brdf::SpecularAdjoint;
use crate::lanes::{MAX_LANES, Row};
use crate::lobe::Lobe;

/// Number of columns of a lobe: axis x, y, z, sharpness, amplitude r, g, b.
pub const LOBE_COLUMNS: usize = 7;

/// Light lobes (or their gradient) in columns of equal, padded length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LobeColumns {
    data: Vec<f32>,
    len: usize,
    stride: usize,
}

impl LobeColumns {
    /// Columns for `len` lobes, all zero.
    pub fn zeros(len: usize) -> Self {
        let mut columns = Self::default();
        columns.reset(len);
        columns
    }

    /// Resizes to `len` lobes, all zero.
    fn reset(&mut self, len: usize) {
        self.len = len;
        self.stride = len.div_ceil(MAX_LANES) * MAX_LANES;
        self.data.clear();
        self.data.resize(self.stride * LOBE_COLUMNS, 0.0);
    }

    /// The values of column `column` in block `block` of [`MAX_LANES`] lobes.
    pub(crate) fn block(&self, column: usize, block: usize) -> &[f32] {
        &self.data[column * self.stride + block * MAX_LANES..][..MAX_LANES]
    }

    /// Number of blocks of [`MAX_LANES`] lobes.
    pub(crate) fn blocks(&self) -> usize {
        self.stride / MAX_LANES
    }

    /// Columns of these lobes. Padding lobes have zero amplitude, and a sharpness for which the kernels take the fast path.
    pub fn from_lobes(lobes: impl ExactSizeIterator<Item = Lobe<f32>>) -> Self {
        let mut columns = Self::zeros(lobes.len());
        for (i, lobe) in lobes.enumerate() {
            columns.set(i, &lobe);
        }
        for i in columns.len..columns.stride {
            columns.set(i, &Lobe { axis: [0.0, 1.0, 0.0], sharpness: 100.0, amplitude: [0.0; 3] });
        }
        columns
    }

    /// Number of lobes.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Length of a column: [`LobeColumns::len`] rounded up to whole SIMD vectors.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Adds the values of `other`, which has the same number of lobes.
    pub fn add(&mut self, other: &Self) {
        assert_eq!(self.len, other.len, "as many lobes");
        self.add_values(&other.data);
    }

    /// All values, column by column, those of the padding included.
    pub fn values(&self) -> &[f32] {
        &self.data
    }

    /// Adds [values](Self::values) of as many lobes.
    pub fn add_values(&mut self, values: &[f32]) {
        assert_eq!(self.data.len(), values.len(), "as many lobes");
        self.data.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }

    /// The values of lobe `i`.
    pub fn get(&self, i: usize) -> Lobe<f32> {
        let at = |c: usize| self.data[c * self.stride + i];
        Lobe { axis: [at(0), at(1), at(2)], sharpness: at(3), amplitude: [at(4), at(5), at(6)] }
    }

    /// Sets the values of lobe `i`.
    pub fn set(&mut self, i: usize, lobe: &Lobe<f32>) {
        let [x, y, z] = lobe.axis;
        let [r, g, b] = lobe.amplitude;
        for (c, value) in [x, y, z, lobe.sharpness, r, g, b].into_iter().enumerate() {
            self.data[c * self.stride + i] = value;
        }
    }
}

/// Gradient with respect to the parameters that all points share.
#[derive(Clone, Debug, Default)]
pub struct SharedGradient {
    /// With respect to the light lobes.
    pub lobes: LobeColumns,
    /// With respect to the specular material.
    pub specular: SpecularAdjoint,
}

/// The sums of a [`SharedGradient`] over each chunk of [`CHUNK`](crate::shading::CHUNK) points, from the first chunk to the last. Their total has
/// the same bits wherever the chunks were summed.
#[derive(Clone, Debug, Default)]
pub struct ChunkSums {
    /// Of each chunk [`LOBE_COLUMNS`] rows per block of lobes, and a row for the specular material.
    rows: Vec<Row>,
    lobes: usize,
}

impl ChunkSums {
    /// Zeros for so many chunks and lobes.
    pub(crate) fn reset(&mut self, chunks: usize, lobes: usize) {
        self.lobes = lobes;
        self.rows.clear();
        self.rows.resize(chunks * self.rows_of_chunk(), Row::ZERO);
    }

    /// Rows of a chunk.
    pub(crate) fn rows_of_chunk(&self) -> usize {
        self.lobes.div_ceil(MAX_LANES) * LOBE_COLUMNS + 1
    }

    /// The rows of all chunks.
    pub(crate) fn rows_mut(&mut self) -> &mut [Row] {
        &mut self.rows
    }

    /// All values, chunk by chunk.
    pub fn values(&self) -> impl Iterator<Item = f32> {
        self.rows.iter().flat_map(|row| row.0)
    }

    /// Replaces the chunks by those of these [values](Self::values), for as many lobes; values of a chunk that is not whole are left out.
    pub fn set_values(&mut self, values: &[f32]) {
        let chunk = self.rows_of_chunk() * MAX_LANES;
        self.rows.clear();
        for rows in values.chunks_exact(chunk).flat_map(|chunk| chunk.chunks_exact(MAX_LANES)) {
            let mut row = Row::ZERO;
            row.0.copy_from_slice(rows);
            self.rows.push(row);
        }
    }

    /// Replaces the chunks by one that has these sums.
    pub fn set_total(&mut self, gradient: &SharedGradient) {
        let SharedGradient { lobes, specular } = gradient;
        self.reset(1, lobes.len);
        let last = self.rows.len() - 1;
        for (at, row) in self.rows[..last].iter_mut().enumerate() {
            row.0.copy_from_slice(lobes.block(at % LOBE_COLUMNS, at / LOBE_COLUMNS));
        }
        let [r, g, b] = specular.albedo;
        self.rows[last].0[..4].copy_from_slice(&[r, g, b, specular.roughness]);
    }

    /// Writes the sum over the chunks, from first to last, into `gradient`, whose memory is reused.
    pub fn total_into(&self, gradient: &mut SharedGradient) {
        let SharedGradient { lobes, specular } = gradient;
        lobes.reset(self.lobes);
        let mut of_specular = Row::ZERO;
        let blocks = self.lobes.div_ceil(MAX_LANES) * LOBE_COLUMNS;
        for (i, chunk) in self.rows.chunks_exact(self.rows_of_chunk()).enumerate() {
            let (of_lobes, rest) = chunk.split_at(blocks);
            for (at, row) in of_lobes.iter().enumerate() {
                let (block, column) = (at / LOBE_COLUMNS, at % LOBE_COLUMNS);
                let start = column * lobes.stride + block * MAX_LANES;
                add_row(&mut lobes.data[start..start + MAX_LANES], row, i == 0);
            }
            rest.iter().for_each(|row| add_row(&mut of_specular.0, row, i == 0));
        }
        let [r, g, b, roughness, ..] = of_specular.0;
        *specular = SpecularAdjoint { albedo: [r, g, b], roughness };
    }
}

/// Adds a row to sums, or begins them with it.
fn add_row(sums: &mut [f32], row: &Row, begins: bool) {
    if begins {
        sums.copy_from_slice(&row.0);
    } else {
        sums.iter_mut().zip(&row.0).for_each(|(sum, value)| *sum += value);
    }
}
