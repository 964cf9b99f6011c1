//! The closed forms of this crate, selected at run time.

use super::loops::{Kernels, Loops};
use super::slices;
use crate::accurate::{self, ACCURATE_DEFAULT, ACCURATE_HIGH, GGX_DEFAULT, GGX_HIGH, Quality};
use crate::brdf::{Facets, Ndf, SpecularValue};
use crate::columns::{ChunkSums, LobeColumns, SharedGradient};
use crate::lighting::Lighting;
use crate::lobe::Lobe;
use crate::published::{self, Published};
use crate::real::{Real, Vec3Of};
use crate::sample::{Layers, PointAdjoint, RadianceColumns, ShadePoint};

/// The closed form that shades.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ClosedForm {
    /// The formulas of PhySG's published code, for comparison.
    Published,
    /// Quadrature of the integrals, at the given quality.
    Accurate(Quality),
}

impl Default for ClosedForm {
    fn default() -> Self {
        Self::Accurate(Quality::Default)
    }
}

/// Diffuse and specular radiance of one point under one lobe.
type LayersOf<F> = (Vec3Of<F>, Vec3Of<F>);

/// A float type for single pairs. Its formulas are compiled in this crate, not in every crate that calls them.
pub trait Scalar: Real {
    /// [`published::shade_pair`] in this float.
    fn published(
        normal: Vec3Of<Self>,
        to_viewer: Vec3Of<Self>,
        lobe: &Lobe<Self>,
        albedo: Vec3Of<Self>,
        specular_albedo: Vec3Of<Self>,
        roughness: Self,
    ) -> LayersOf<Self>;
    /// [`accurate::shade_pair`] in this float.
    fn accurate(
        quality: Quality,
        normal: Vec3Of<Self>,
        to_viewer: Vec3Of<Self>,
        lobe: &Lobe<Self>,
        albedo: Vec3Of<Self>,
        specular_albedo: Vec3Of<Self>,
        facets: Facets<Self>,
    ) -> LayersOf<Self>;
}

macro_rules! scalar {
    ($t:ty) => {
        impl Scalar for $t {
            #[inline(never)]
            fn published(
                normal: Vec3Of<Self>,
                to_viewer: Vec3Of<Self>,
                lobe: &Lobe<Self>,
                albedo: Vec3Of<Self>,
                specular_albedo: Vec3Of<Self>,
                roughness: Self,
            ) -> LayersOf<Self> {
                published::shade_pair(normal, to_viewer, lobe, albedo, specular_albedo, roughness)
            }
            #[inline(never)]
            fn accurate(
                quality: Quality,
                normal: Vec3Of<Self>,
                to_viewer: Vec3Of<Self>,
                lobe: &Lobe<Self>,
                albedo: Vec3Of<Self>,
                specular_albedo: Vec3Of<Self>,
                facets: Facets<Self>,
            ) -> LayersOf<Self> {
                accurate::shade_pair(quality, normal, to_viewer, lobe, albedo, specular_albedo, facets)
            }
        }
    };
}
scalar!(f32);
scalar!(f64);

impl ClosedForm {
    /// Diffuse and specular radiance of one point under one lobe, each at least 0.
    pub fn shade_pair<F: Scalar>(
        self,
        [normal, to_viewer]: [Vec3Of<F>; 2],
        lobe: &Lobe<F>,
        albedo: Vec3Of<F>,
        specular_albedo: Vec3Of<F>,
        facets: Facets<F>,
    ) -> [Vec3Of<F>; 2] {
        let layers = match self {
            Self::Published => {
                F::published(normal, to_viewer, lobe, albedo, specular_albedo, facets.roughness)
            }
            Self::Accurate(quality) => {
                F::accurate(quality, normal, to_viewer, lobe, albedo, specular_albedo, facets)
            }
        };
        [layers.0.map(F::relu), layers.1.map(F::relu)]
    }

    /// [`shade_with`](super::slices::shade_with) with this form.
    pub fn shade<'a>(
        self,
        points: &[ShadePoint],
        specular: &SpecularValue,
        lighting: impl Into<Lighting<'a>>,
        out: &mut [Layers],
    ) {
        slices::shade(self.kernels(specular.ndf), points, specular, lighting.into(), out);
    }

    /// The response of each point to each lobe as if its amplitude were 1 and all of it arrived, at least 0, on this thread alone: of a point
    /// [`RESPONSE_ROWS`](super::RESPONSE_ROWS) rows of [`LobeColumns::stride`] values: irradiance, then specular radiance in red, green and blue. The albedo
    /// of the points is not read; the amplitudes of the lobes say only what is negligible.
    pub fn respond(
        self,
        points: &[ShadePoint],
        specular: &SpecularValue,
        lobes: &LobeColumns,
        out: &mut [f32],
    ) {
        slices::respond(self.kernels(specular.ndf), points, specular, lobes, out);
    }

    /// Fraction of all pairs whose specular light this form skips, in [0, 1].
    pub fn culled_part(self, points: &[ShadePoint], specular: &SpecularValue, lobes: &LobeColumns) -> f64 {
        slices::culled_part(self.kernels(specular.ndf), points, specular, lobes)
    }

    /// [`shade_adjoint_with`](super::slices::shade_adjoint_with) with this form.
    pub fn shade_adjoint<'a>(
        self,
        points: &[ShadePoint],
        specular: &SpecularValue,
        lighting: impl Into<Lighting<'a>>,
        radiance: RadianceColumns<'_>,
        out: &mut [PointAdjoint],
        gradient: &mut SharedGradient,
    ) {
        let (kernels, lighting) = (self.kernels(specular.ndf), lighting.into());
        slices::shade_adjoint(kernels, points, specular, lighting, radiance, out, gradient);
    }

    /// [`Self::shade_adjoint`] with the sums over each chunk of [`CHUNK`](super::CHUNK) points instead of their total, which
    /// [`ChunkSums::total_into`] then takes.
    pub fn shade_adjoint_in_chunks<'a>(
        self,
        points: &[ShadePoint],
        specular: &SpecularValue,
        lighting: impl Into<Lighting<'a>>,
        radiance: RadianceColumns<'_>,
        out: &mut [PointAdjoint],
        sums: &mut ChunkSums,
    ) {
        let (kernels, lighting) = (self.kernels(specular.ndf), lighting.into());
        slices::shade_adjoint_in_chunks(kernels, points, specular, lighting, radiance, out, sums);
    }

    /// The loops of this form with a distribution of microfacet normals.
    ///
    /// Never inlined, because a crate that uses these trait objects directly compiles all their loops again.
    #[inline(never)]
    fn kernels(self, ndf: Ndf) -> &'static dyn Kernels {
        match (self, ndf) {
            (Self::Published, _) => &Loops(Published),
            (Self::Accurate(Quality::Default), Ndf::Sg) => &Loops(ACCURATE_DEFAULT),
            (Self::Accurate(Quality::High), Ndf::Sg) => &Loops(ACCURATE_HIGH),
            (Self::Accurate(Quality::Default), Ndf::Ggx) => &Loops(GGX_DEFAULT),
            (Self::Accurate(Quality::High), Ndf::Ggx) => &Loops(GGX_HIGH),
        }
    }
}
