//! SG shading of many points by many lobes: the slice kernels behind the Shade and Gradient stages.
//!
//! Lobes lie in columns, padded to a whole number of SIMD vectors; points are taken one by one, in chunks over
//! the threads. Sums over points are made per chunk and then over chunks in order, so the result does not depend
//! on the number of threads. The formulas are a [`PairModel`]'s; [`ClosedForm`] chooses one at run time.

mod adjoint;
mod cull;
mod kernels;

use super::accurate::{ACCURATE_DEFAULT, ACCURATE_HIGH, GGX_DEFAULT, GGX_HIGH, Quality};
use super::brdf::{Facets, Ndf};
use super::lanes::{MAX_LANES, Row};
use super::model::PairModel;
use super::published::{Lobe, Published};
use super::real::{Real, Vec3Of};
use super::{accurate, published};
use fearless_simd::{Level, dispatch};
use kernels::Shared;
use rayon::prelude::*;
use std::cell::Cell;

/// Points a thread takes at a time; also the grain of the fixed-order sums.
const CHUNK: usize = 256;

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

    /// Makes this the columns for `len` lobes, all zero.
    fn reset(&mut self, len: usize) {
        self.len = len;
        self.stride = len.div_ceil(MAX_LANES) * MAX_LANES;
        self.data.clear();
        self.data.resize(self.stride * LOBE_COLUMNS, 0.0);
    }

    /// Number of blocks of [`MAX_LANES`] lobes.
    fn blocks(&self) -> usize {
        self.stride / MAX_LANES
    }

    /// Columns of these lobes; padding has no amplitude, and a sharpness that is quick to compute.
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

    /// Adds the values of as many other lobes.
    pub fn add(&mut self, other: &Self) {
        assert_eq!(self.len, other.len, "as many lobes");
        self.data.iter_mut().zip(&other.data).for_each(|(sum, value)| *sum += value);
    }

    /// The values of lobe `i`.
    pub fn get(&self, i: usize) -> Lobe<f32> {
        let at = |c: usize| self.data[c * self.stride + i];
        Lobe { axis: [at(0), at(1), at(2)], sharpness: at(3), amplitude: [at(4), at(5), at(6)] }
    }

    fn set(&mut self, i: usize, lobe: &Lobe<f32>) {
        let [x, y, z] = lobe.axis;
        let [r, g, b] = lobe.amplitude;
        for (c, value) in [x, y, z, lobe.sharpness, r, g, b].into_iter().enumerate() {
            self.data[c * self.stride + i] = value;
        }
    }
}

/// A surface point as the kernels read it; a zero normal marks a ray that met nothing, which shades to zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShadePoint {
    /// Unit normal.
    pub normal: Vec3Of<f32>,
    /// Unit direction from the point to the viewer.
    pub to_viewer: Vec3Of<f32>,
    /// Diffuse albedo.
    pub albedo: Vec3Of<f32>,
}

impl ShadePoint {
    /// Whether this stands for a ray that met nothing.
    pub fn is_missed(&self) -> bool {
        self.normal == [0.0; 3]
    }
}

/// What of the lobes' light reaches points that other parts of the object can hide them from. Without it, all does.
#[derive(Clone, Copy, Debug)]
pub struct Visibility<'a> {
    /// A row of [`LobeColumns::stride`] values a point: the part of each lobe's irradiance that reaches it, 0 to 255. Empty: all does.
    pub lobes: &'a [u8],
    /// One a point.
    pub points: &'a [PointVisibility],
}

impl<'a> Visibility<'a> {
    /// Runs of `count` points, as the points' own chunks.
    fn chunk(&self, index: usize, count: usize, stride: usize) -> Self {
        let part =
            |of: usize, each: usize| (index * count * each).min(of)..((index + 1) * count * each).min(of);
        Self {
            lobes: &self.lobes[part(self.lobes.len(), stride)],
            points: &self.points[part(self.points.len(), 1)],
        }
    }

    /// Of one point: its row of lobes (`None` if all light reaches it) and the rest.
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

/// What of a point's visibility does not depend on the lobe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointVisibility {
    /// Per channel, specular light over what it would be if nothing were hidden; more than 1 where a bright part of the object
    /// is mirrored.
    pub specular: Vec3Of<f32>,
    /// Irradiance from other parts of the object.
    pub indirect: Vec3Of<f32>,
}

impl PointVisibility {
    /// Nothing is hidden, nothing is reflected.
    pub const OPEN: Self = Self { specular: [1.0; 3], indirect: [0.0; 3] };
}

impl Default for PointVisibility {
    fn default() -> Self {
        Self::OPEN
    }
}

/// What points are lit by.
#[derive(Clone, Copy, Debug)]
pub struct Lighting<'a> {
    /// The lobes.
    pub lobes: &'a LobeColumns,
    /// What of their light reaches the points; all if `None`.
    pub visibility: Option<Visibility<'a>>,
}

impl<'a> From<&'a LobeColumns> for Lighting<'a> {
    fn from(lobes: &'a LobeColumns) -> Self {
        Self { lobes, visibility: None }
    }
}

impl<'a> Lighting<'a> {
    /// The lighting of a chunk of the points.
    fn chunk(&self, index: usize) -> Option<Visibility<'a>> {
        self.visibility.map(|all| all.chunk(index, CHUNK, self.lobes.stride))
    }

    fn check(&self, points: usize) {
        if let Some(visibility) = &self.visibility {
            assert_eq!(visibility.points.len(), points, "one visibility a point");
            let rows = [0, points * self.lobes.stride];
            assert!(rows.contains(&visibility.lobes.len()), "one row of lobes a point, or none");
        }
    }
}

/// The specular material as the kernels read it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpecularValue {
    /// Specular albedo.
    pub albedo: Vec3Of<f32>,
    /// Roughness R.
    pub roughness: f32,
    /// Distribution of microfacet normals; [`ClosedForm::Published`] knows one SG only and takes that.
    pub ndf: Ndf,
}

/// Adjoints of the specular material.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpecularAdjoint {
    /// With respect to the specular albedo.
    pub albedo: Vec3Of<f32>,
    /// With respect to the roughness.
    pub roughness: f32,
}

/// Outgoing radiance in its two layers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Layers {
    /// Diffusely reflected radiance.
    pub diffuse: Vec3Of<f32>,
    /// Specularly reflected radiance.
    pub specular: Vec3Of<f32>,
}

/// Adjoint of a point's outgoing radiance, the sum of its layers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RadianceAdjoint(pub Vec3Of<f32>);

/// Adjoints of one point's inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PointAdjoint {
    /// With respect to the diffuse albedo.
    pub albedo: Vec3Of<f32>,
    /// With respect to the normal (along its tangent plane).
    pub normal: Vec3Of<f32>,
}

/// Gradient with respect to everything that the points share.
#[derive(Clone, Debug, Default)]
pub struct SharedGradient {
    /// With respect to the light lobes.
    pub lobes: LobeColumns,
    /// With respect to the specular material.
    pub specular: SpecularAdjoint,
}

/// Which closed form shades.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClosedForm {
    /// The formulas of PhySG's own code, for comparison.
    Published,
    /// The integrals themselves, to the given accuracy.
    Accurate(Quality),
}

impl Default for ClosedForm {
    fn default() -> Self {
        Self::Accurate(Quality::Default)
    }
}

/// `$body` with `$model` the [`PairModel`] of a closed form and a distribution of microfacet normals.
macro_rules! with_model {
    ($form:expr, $ndf:expr, $model:ident => $body:expr) => {
        match ($form, $ndf) {
            (ClosedForm::Published, _) => with_model!(@ $model, Published, $body),
            (ClosedForm::Accurate(Quality::Default), Ndf::Sg) => with_model!(@ $model, ACCURATE_DEFAULT, $body),
            (ClosedForm::Accurate(Quality::High), Ndf::Sg) => with_model!(@ $model, ACCURATE_HIGH, $body),
            (ClosedForm::Accurate(Quality::Default), Ndf::Ggx) => with_model!(@ $model, GGX_DEFAULT, $body),
            (ClosedForm::Accurate(Quality::High), Ndf::Ggx) => with_model!(@ $model, GGX_HIGH, $body),
        }
    };
    (@ $model:ident, $value:expr, $body:expr) => {{
        let $model = $value;
        $body
    }};
}

impl ClosedForm {
    /// Diffuse and specular radiance of one point under one lobe, each at least 0, in any float.
    pub fn shade_pair<F: Real>(
        self,
        [normal, to_viewer]: [Vec3Of<F>; 2],
        lobe: &Lobe<F>,
        albedo: Vec3Of<F>,
        specular_albedo: Vec3Of<F>,
        facets: Facets<F>,
    ) -> [Vec3Of<F>; 2] {
        let (diffuse, specular) = match self {
            Self::Published => {
                published::shade_pair(normal, to_viewer, lobe, albedo, specular_albedo, facets.roughness)
            }
            Self::Accurate(quality) => {
                accurate::shade_pair(quality, normal, to_viewer, lobe, albedo, specular_albedo, facets)
            }
        };
        [diffuse.map(F::relu), specular.map(F::relu)]
    }

    /// [`shade_with`] of this form.
    pub fn shade<'a>(
        self,
        points: &[ShadePoint],
        specular: &SpecularValue,
        lighting: impl Into<Lighting<'a>>,
        out: &mut [Layers],
    ) {
        let lighting = lighting.into();
        with_model!(self, specular.ndf, model => shade_with(model, points, specular, lighting, out));
    }

    /// The part of all pairs whose specular light this form leaves out, in [0, 1].
    pub fn culled_part(self, points: &[ShadePoint], specular: &SpecularValue, lobes: &LobeColumns) -> f64 {
        with_model!(self, specular.ndf, model => culled_part(model, points, specular, lobes))
    }

    /// [`shade_adjoint_with`] of this form.
    pub fn shade_adjoint<'a>(
        self,
        points: &[ShadePoint],
        specular: &SpecularValue,
        lighting: impl Into<Lighting<'a>>,
        radiance: (&[Layers], &[RadianceAdjoint]),
        out: &mut [PointAdjoint],
        gradient: &mut SharedGradient,
    ) {
        let lighting = lighting.into();
        with_model!(self, specular.ndf, model => {
            shade_adjoint_with(model, points, specular, lighting, radiance, out, gradient);
        });
    }
}

/// The part of all pairs whose specular part `model` leaves out, in [0, 1].
fn culled_part<M: PairModel>(
    model: M,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lobes: &LobeColumns,
) -> f64 {
    if !M::CULLS {
        return 0.0;
    }
    let mut prepared = Vec::new();
    let level = Level::new();
    dispatch!(level, simd => kernels::prepare_lobes(simd, model, lobes, &mut prepared));
    let shared = Shared { model, specular, lobes: &prepared };
    let kept = dispatch!(level, simd => kernels::count_kept(simd, &shared, points));
    1.0 - kept as f64 / (points.len() * lobes.len()).max(1) as f64
}

thread_local! {
    /// Kept between calls, so that a step of a fit allocates nothing. Taken out while in use: a thread that waits for
    /// its share of the work may meanwhile be given another call's.
    static SCRATCH: Cell<(Vec<Row>, Vec<Row>)> = const { Cell::new((Vec::new(), Vec::new())) };
}

/// Shades `points` by the formulas of `model`; `out` has their length.
pub fn shade_with<M: PairModel>(
    model: M,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    out: &mut [Layers],
) {
    assert_eq!(points.len(), out.len(), "one output a point");
    lighting.check(points.len());
    let level = Level::new();
    let mut scratch = SCRATCH.take();
    dispatch!(level, simd => kernels::prepare_lobes(simd, model, lighting.lobes, &mut scratch.0));
    let shared = Shared { model, specular, lobes: &scratch.0 };
    let chunks = points.par_chunks(CHUNK).zip(out.par_chunks_mut(CHUNK));
    chunks.enumerate().for_each(|(i, (points, out))| {
        dispatch!(level, simd => kernels::shade_chunk(simd, &shared, points, lighting.chunk(i), out));
    });
    SCRATCH.set(scratch);
}

/// Pulls the adjoint of each point's radiance back to the points and to what they share (not to the visibility), by the formulas of `model`; `radiance`
/// is (what [`shade_with`] gave, its adjoint). Where a channel was clamped to zero its adjoint is dropped. Overwrites
/// `gradient`, whose memory it uses again.
pub fn shade_adjoint_with<M: PairModel>(
    model: M,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    (shaded, adjoint): (&[Layers], &[RadianceAdjoint]),
    point_adjoint: &mut [PointAdjoint],
    gradient: &mut SharedGradient,
) {
    assert!(points.len() == shaded.len() && points.len() == adjoint.len(), "one value a point");
    assert_eq!(points.len(), point_adjoint.len(), "one output a point");
    lighting.check(points.len());
    let lobes = lighting.lobes;
    let level = Level::new();
    let mut scratch = SCRATCH.take();
    let (prepared, partial) = (&mut scratch.0, &mut scratch.1);
    dispatch!(level, simd => kernels::prepare_lobes(simd, model, lobes, prepared));
    let shared = Shared { model, specular, lobes: prepared };
    // One partial gradient a chunk: LOBE_COLUMNS rows a block of lobes, and a row for the specular material.
    let rows = lobes.blocks() * LOBE_COLUMNS + 1;
    partial.clear();
    partial.resize(rows * points.len().div_ceil(CHUNK), Row::ZERO);
    points
        .par_chunks(CHUNK)
        .zip(shaded.par_chunks(CHUNK).zip(adjoint.par_chunks(CHUNK)))
        .zip(point_adjoint.par_chunks_mut(CHUNK).zip(partial.par_chunks_mut(rows)))
        .enumerate()
        .for_each(|(i, ((points, radiance), (out, partial)))| {
            let lit = (points, lighting.chunk(i));
            dispatch!(level, simd => adjoint::adjoint_chunk(simd, &shared, lit, radiance, out, partial));
        });
    gradient.sum_in_order(partial, rows, lobes.len);
    SCRATCH.set(scratch);
}

impl SharedGradient {
    /// Sums partial gradients of `rows` rows each, first to last.
    fn sum_in_order(&mut self, partial: &mut [Row], rows: usize, len: usize) {
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

#[cfg(test)]
pub(crate) mod properties;
#[cfg(test)]
mod tests;
