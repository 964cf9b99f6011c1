//! What runs the loops over points × lobes: this processor, or a device that another crate brings.

use super::closed_form::ClosedForm;
use crate::brdf::{Ndf, SpecularValue};
use crate::columns::ChunkSums;
use crate::lighting::Lighting;
use crate::sample::{Layers, PointAdjoint, RadianceColumns, ShadePoint};
use std::fmt::Debug;

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
    /// What the device says of its failure.
    fn shade(&self, call: ShadeCall<'_>, out: &mut [Layers]) -> Result<(), String>;

    /// Adjoints, as [`ClosedForm::shade_adjoint`] defines them: of each point, and those of what points share, summed over chunks as the device
    /// likes.
    ///
    /// # Errors
    /// What the device says of its failure.
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
