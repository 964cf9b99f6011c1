//! The WGSL of the kernels, and their pipelines.

use lobelia_sg::accurate::{ACCURATE_DEFAULT, Quality};
use lobelia_sg::{brdf::Ndf, model::PairModel, published::Published, shading::ClosedForm};
use std::collections::HashMap;

/// The formulas that are there in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Model {
    Published,
    Accurate,
}

impl Model {
    /// The formulas of a closed form with a distribution of normals.
    pub(crate) fn of(form: ClosedForm, ndf: Ndf) -> Option<Self> {
        match (form, ndf) {
            (ClosedForm::Published, _) => Some(Self::Published),
            (ClosedForm::Accurate(Quality::Default), Ndf::Sg) => Some(Self::Accurate),
            _ => None,
        }
    }

    /// The terms of a lobe of this sharpness that its pairs read.
    pub(crate) fn lobe_terms(self, sharpness: f32) -> [f32; 8] {
        match self {
            Self::Published => Published.prepare_lobe(sharpness),
            Self::Accurate => ACCURATE_DEFAULT.prepare_lobe(sharpness),
        }
    }

    fn source(self) -> [&'static str; 5] {
        match self {
            Self::Published => [
                include_str!("published/point.wgsl"),
                include_str!("published/integral.wgsl"),
                include_str!("published/sharp.wgsl"),
                include_str!("published/pair.wgsl"),
                include_str!("published/model.wgsl"),
            ],
            Self::Accurate => [
                include_str!("accurate/point.wgsl"),
                include_str!("accurate/diffuse.wgsl"),
                concat!(include_str!("accurate/rule.wgsl"), include_str!("accurate/placement.wgsl")),
                concat!(include_str!("accurate/specular.wgsl"), include_str!("accurate/smooth.wgsl")),
                include_str!("accurate/model.wgsl"),
            ],
        }
    }
}

/// A kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Kernel {
    /// Radiance of points.
    Forward(Model),
    /// Adjoint of points, and sums of workgroups.
    Adjoint(Model),
    /// Sums of these sums.
    Sums,
}

impl Kernel {
    fn source(self) -> String {
        let (model, loops) = match self {
            Self::Forward(model) => (model, include_str!("shading/forward.wgsl")),
            Self::Adjoint(model) => (model, include_str!("shading/adjoint.wgsl")),
            Self::Sums => return include_str!("shading/sums.wgsl").to_owned(),
        };
        let shared = [include_str!("real.wgsl"), include_str!("brdf.wgsl"), include_str!("lobe.wgsl")];
        let ends = [include_str!("shading/inputs.wgsl"), loops];
        [&shared[..], &model.source(), &ends].concat().join("\n")
    }

    fn pipeline(self, device: &wgpu::Device) -> wgpu::ComputePipeline {
        let label = format!("{self:?}");
        let source = wgpu::ShaderSource::Wgsl(self.source().into());
        let module =
            device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label.as_str()), source });
        // Workgroup memory is written before it is read.
        let options = wgpu::PipelineCompilationOptions {
            zero_initialize_workgroup_memory: false,
            ..wgpu::PipelineCompilationOptions::default()
        };
        device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(label.as_str()),
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: options,
            cache: None,
        })
    }
}

/// Pipelines, each compiled when it is first used.
#[derive(Default)]
pub(crate) struct Pipelines(HashMap<Kernel, wgpu::ComputePipeline>);

impl Pipelines {
    pub(crate) fn get(&mut self, kernel: Kernel, device: &wgpu::Device) -> &wgpu::ComputePipeline {
        self.0.entry(kernel).or_insert_with(|| kernel.pipeline(device))
    }
}
