//! The closed forms of this crate, selected at run time.

use super::loops::{Kernels, Loops};
use super::slices;
use crate::accurate::{ACCURATE_DEFAULT, ACCURATE_HIGH, GGX_DEFAULT, GGX_HIGH, Quality};
use crate::brdf::{Facets, Ndf, SpecularValue};
use crate::columns::{
    ChunkSums, Layers, Lighting, LobeColumns, PointAdjoint, RadianceColumns, ShadePoint, SharedGradient,
};
use crate::real::{Real, Vec3Of};
use crate::{accurate, published, published::Published, sg::Lobe};
use std::fmt::Debug;

/// The closed form that shades.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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

impl ClosedForm {
    /// Diffuse and specular radiance of one point under one lobe, each at least 0.
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

    /// The response of each point to each lobe as if its amplitude were 1 and all of it arrived, at
    /// least 0, on this thread alone: of a point [`RESPONSE_ROWS`](super::RESPONSE_ROWS) rows of
    /// [`LobeColumns::stride`] values: irradiance, then specular radiance in red, green and blue.
    /// The albedo of the points is not read; the amplitudes of the lobes say only what is
    /// negligible.
    pub fn respond(
        self,
        points: &[ShadePoint],
        specular: &SpecularValue,
        lobes: &LobeColumns,
        out: &mut [f32],
    ) {
        slices::respond(self.kernels(specular.ndf), points, specular, lobes, out);
    }

    /// [`shade_adjoint_with`](super::slices::shade_adjoint_with) with this form; of
    /// [`Quality::High`] with the default number of nodes.
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

    /// [`Self::shade_adjoint`] with the sums over each chunk of [`CHUNK`](super::CHUNK) points
    /// instead of their total, which [`ChunkSums::total_into`] then takes.
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
    /// Never inlined, because a crate that uses these trait objects directly compiles all their
    /// loops again.
    #[inline(never)]
    fn kernels(self, ndf: Ndf) -> &'static dyn Kernels {
        match (self, ndf) {
            (Self::Published, _) => &Loops(Published, Published),
            (Self::Accurate(Quality::Default), Ndf::Sg) => &Loops(ACCURATE_DEFAULT, ACCURATE_DEFAULT),
            (Self::Accurate(Quality::High), Ndf::Sg) => &Loops(ACCURATE_HIGH, ACCURATE_DEFAULT),
            (Self::Accurate(Quality::Default), Ndf::Ggx) => &Loops(GGX_DEFAULT, GGX_DEFAULT),
            (Self::Accurate(Quality::High), Ndf::Ggx) => &Loops(GGX_HIGH, GGX_DEFAULT),
        }
    }
}

/// Points, and what shades them.
#[derive(Clone, Copy)]
pub struct ShadeCall<'a> {
    /// The closed form.
    pub form: ClosedForm,
    /// The points.
    pub points: &'a [ShadePoint],
    /// Their specular material.
    pub specular: &'a SpecularValue,
    /// The light.
    pub lighting: Lighting<'a>,
}

/// The loops over points × lobes, forward and adjoint. Lengths of outputs are those of the points.
pub trait PairLoops: Debug + Send + Sync {
    /// Whether this device has the closed form with this distribution of normals.
    fn supports(&self, form: ClosedForm, ndf: Ndf) -> bool;

    /// Radiance, as [`ClosedForm::shade`] defines it.
    ///
    /// # Errors
    /// The device's description of its failure.
    fn shade(&self, call: ShadeCall<'_>, out: &mut [Layers]) -> Result<(), String>;

    /// Adjoints, as [`ClosedForm::shade_adjoint`] defines them: of each point, and of the shared
    /// inputs, summed over chunks as the device likes.
    ///
    /// # Errors
    /// The device's description of its failure.
    fn shade_adjoint(
        &self,
        call: ShadeCall<'_>,
        radiance: RadianceColumns<'_>,
        out: &mut [PointAdjoint],
        sums: &mut ChunkSums,
    ) -> Result<(), String>;
}

/// This processor, all of its threads. It has every form and never fails.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cpu;

impl PairLoops for Cpu {
    fn supports(&self, _form: ClosedForm, _ndf: Ndf) -> bool {
        true
    }

    fn shade(&self, call: ShadeCall<'_>, out: &mut [Layers]) -> Result<(), String> {
        call.form.shade(call.points, call.specular, call.lighting, out);
        Ok(())
    }

    fn shade_adjoint(
        &self,
        ShadeCall { form, points, specular, lighting }: ShadeCall<'_>,
        radiance: RadianceColumns<'_>,
        out: &mut [PointAdjoint],
        sums: &mut ChunkSums,
    ) -> Result<(), String> {
        form.shade_adjoint_in_chunks(points, specular, lighting, radiance, out, sums);
        Ok(())
    }
}
