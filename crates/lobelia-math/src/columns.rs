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
        self.data.iter_mut().zip(&other.data).for_each(|(sum, value)| *sum += value);
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

impl SharedGradient {
    /// Sums partial gradients of `rows` rows each, from first to last.
    pub(crate) fn sum_in_order(&mut self, partial: &mut [Row], rows: usize, len: usize) {
        self.lobes.reset(len);
        self.specular = SpecularAdjoint::default();
        let Some((total, rest)) = partial.split_at_mut_checked(rows) else { return };
        for part in rest.chunks_exact(rows) {
            for (sum, value) in total.iter_mut().flat_map(|r| &mut r.0).zip(part.iter().flat_map(|r| &r.0)) {
                *sum += value;
            }
        }
        let [r, g, b, roughness, ..] = total[rows - 1].0;
        self.specular = SpecularAdjoint { albedo: [r, g, b], roughness };
        for (block, rows) in total.chunks_exact(LOBE_COLUMNS).enumerate() {
            for (c, row) in rows.iter().enumerate() {
                let start = c * self.lobes.stride + block * MAX_LANES;
                self.lobes.data[start..start + MAX_LANES].copy_from_slice(&row.0);
            }
        }
    }
}
