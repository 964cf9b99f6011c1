//! Light lobes in columns, and the gradient with respect to the parameters that all points share.

use crate::lanes::{MAX_LANES, Row};
use crate::{brdf::SpecularAdjoint, real::Vec3Of, sg::Lobe};

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

    /// Columns of these lobes. Padding lobes have zero amplitude, and a sharpness for which the
    /// kernels take the fast path.
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

/// The sums of a [`SharedGradient`] over each chunk of [`CHUNK`](crate::shading::CHUNK) points,
/// from the first chunk to the last. Their total has the same bits wherever the chunks were summed.
#[derive(Clone, Debug, Default)]
pub struct ChunkSums {
    /// Of each chunk [`LOBE_COLUMNS`] rows per block of lobes, and a row for the specular material.
    pub(crate) rows: Vec<Row>,
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

/// Visibility of the light lobes at points that other parts of the object may occlude.
#[derive(Clone, Copy, Debug)]
pub struct LobeVisibility<'a> {
    /// One row of [`LobeColumns::stride`] values per point: the fraction of each lobe's irradiance
    /// that reaches it, 0 to 255. If empty, all light reaches all points.
    pub lobes: &'a [u8],
    /// One entry per point.
    pub points: &'a [PointVisibility],
}

impl<'a> LobeVisibility<'a> {
    /// The visibility of one point: its row of lobes (`None` if all light reaches it) and the part
    /// that does not depend on the lobe.
    #[inline(always)]
    pub fn point(
        visibility: Option<Self>,
        index: usize,
        stride: usize,
    ) -> (Option<&'a [u8]>, PointVisibility) {
        match visibility {
            Some(v) if v.lobes.is_empty() => (None, v.points[index]),
            Some(v) => (Some(&v.lobes[index * stride..][..stride]), v.points[index]),
            None => (None, PointVisibility::OPEN),
        }
    }
}

/// The part of the visibility of a point that does not depend on the lobe.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct PointVisibility {
    /// Ratio per channel of the specular light to the specular light without occlusion; above 1
    /// where the point reflects a bright part of the object.
    pub specular: Vec3Of<f32>,
    /// Irradiance from other parts of the object.
    pub indirect: Vec3Of<f32>,
}

impl PointVisibility {
    /// No occlusion and no interreflection.
    pub const OPEN: Self = Self { specular: [1.0; 3], indirect: [0.0; 3] };
}

impl Default for PointVisibility {
    fn default() -> Self {
        Self::OPEN
    }
}

/// The light of a call.
#[derive(Clone, Copy, Debug)]
pub struct Lighting<'a> {
    /// The lobes.
    pub lobes: &'a LobeColumns,
    /// Their visibility at the points; if `None`, all light reaches all points.
    pub visibility: Option<LobeVisibility<'a>>,
}

impl<'a> From<&'a LobeColumns> for Lighting<'a> {
    fn from(lobes: &'a LobeColumns) -> Self {
        Self { lobes, visibility: None }
    }
}

impl<'a> Lighting<'a> {
    /// The visibility of chunk `index` of `count` points each.
    pub fn chunk(&self, index: usize, count: usize) -> Option<LobeVisibility<'a>> {
        let part =
            |of: usize, each: usize| (index * count * each).min(of)..((index + 1) * count * each).min(of);
        self.visibility.map(|LobeVisibility { lobes, points }| LobeVisibility {
            lobes: &lobes[part(lobes.len(), self.lobes.stride)],
            points: &points[part(points.len(), 1)],
        })
    }

    /// Checks that the visibility fits so many points.
    ///
    /// # Panics
    /// If there is a visibility, but not one for each of `points` points.
    pub fn check(&self, points: usize) {
        if let Some(visibility) = &self.visibility {
            assert_eq!(visibility.points.len(), points, "one visibility per point");
            let rows = [0, points * self.lobes.stride()];
            assert!(rows.contains(&visibility.lobes.len()), "one row of lobes per point, or none");
        }
    }
}

/// A surface point as the kernels read it; a zero normal marks a ray without a hit, whose radiance
/// is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct ShadePoint {
    /// Unit normal.
    pub normal: Vec3Of<f32>,
    /// Unit direction from the point to the viewer.
    pub to_viewer: Vec3Of<f32>,
    /// Diffuse albedo.
    pub albedo: Vec3Of<f32>,
}

impl ShadePoint {
    /// Whether this marks a ray without a hit.
    pub fn is_missed(&self) -> bool {
        self.normal == [0.0; 3]
    }
}

/// Outgoing radiance, as a diffuse and a specular layer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct Layers {
    /// Diffusely reflected radiance.
    pub diffuse: Vec3Of<f32>,
    /// Specularly reflected radiance.
    pub specular: Vec3Of<f32>,
}

/// Adjoint of the outgoing radiance of a point, the sum of its layers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct RadianceAdjoint(pub Vec3Of<f32>);

/// Adjoints of the inputs of one point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct PointAdjoint {
    /// With respect to the diffuse albedo.
    pub albedo: Vec3Of<f32>,
    /// With respect to the normal (along its tangent plane).
    pub normal: Vec3Of<f32>,
}

/// The radiance of many points and its adjoint, the input of the adjoint kernel. Both have one
/// value per point.
#[derive(Clone, Copy, Debug)]
pub struct RadianceColumns<'a> {
    /// Result of the forward kernel; where a channel is zero, its adjoint is dropped.
    pub shaded: &'a [Layers],
    /// Adjoint of the sum of its layers.
    pub adjoint: &'a [RadianceAdjoint],
}
