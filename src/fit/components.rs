//! Components and resources of a fit: gradients and moments of the parameters, and the state of the fit.

use crate::fit::adam::Moments;
use crate::fit::loss::{Loss, LossSums};
use crate::math::shading::{ChunkSums, LobeColumns, SharedGradient, SpecularAdjoint};
use bevy_ecs::prelude::{Component, Resource};
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Gradient of the loss with respect to a texel's diffuse albedo.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct AlbedoGradient(pub Vec3);

/// Adam's moments of a texel.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AlbedoMoments(pub Moments<3>);

/// Sum of the weights of a texel over all fitted pixels.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct TexelSeen(pub f32);

/// Adam's moments of a light lobe: axis (3), sharpness, amplitude (3).
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LobeMoments(pub Moments<7>);

/// Gradient of the loss with respect to a light lobe, in the order of [`LobeMoments`].
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct LobeGradient(pub [f32; 7]);

/// Adam's moments of a specular lobe: albedo (3), roughness.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SpecularMoments(pub Moments<4>);

/// Gradient of the loss with respect to a specular lobe, in the order of [`SpecularMoments`].
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct SpecularGradient(pub [f32; 4]);

/// The parameters that a fit optimizes.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unknowns {
    /// Texel albedo.
    pub albedo: bool,
    /// Texel sheen; only together with `albedo`.
    pub sheen: bool,
    /// Light lobes.
    pub light: bool,
    /// Specular albedo.
    pub specular_albedo: bool,
    /// One gray specular albedo instead of three channels.
    pub mono_specular: bool,
    /// The first base material may be a metal, and the others are dielectrics ([`metal`](crate::fit::metal)); only with several.
    pub metal: bool,
    /// Roughness.
    pub roughness: bool,
    /// Blend weights of the base materials, per texel.
    pub blends: bool,
}

impl Default for Unknowns {
    /// All except sheen and blends; the specular albedo is gray.
    fn default() -> Self {
        Self {
            albedo: true,
            sheen: false,
            light: true,
            specular_albedo: true,
            mono_specular: true,
            metal: false,
            roughness: true,
            blends: false,
        }
    }
}

/// Adam's rates at the current step.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct StepRates {
    /// Number of the step, from 1.
    pub step: u32,
    /// Number of the step among those that visit the photographs under the same light, from 1.
    pub visit: u32,
    /// Completed part of the fit, in [0, 1).
    pub progress: f32,
    /// Rate of the logit of texel albedo.
    pub albedo: f32,
    /// Rate of lobe axes, log sharpness and log amplitude.
    pub light: f32,
    /// Rate of the logits of specular albedo and roughness.
    pub specular: f32,
}

/// The loss, and its sums of the last step.
#[derive(Resource, Clone, Copy, Debug)]
pub struct LossState {
    /// The loss.
    pub loss: Loss,
    /// Sums over the last window.
    pub last: LossSums,
}

/// Gradient of the shared parameters, from the last step.
#[derive(Resource, Clone, Debug, Default)]
pub struct StepGradient {
    /// With respect to the light.
    pub shared: SharedGradient,
    /// With respect to each base material.
    pub specular: Vec<SpecularAdjoint>,
    /// What these are the total of.
    chunks: StepSums,
}

/// Sums over each chunk of [`CHUNK`](crate::math::shading::CHUNK) samples, from the first chunk to the last. Their total has the same bits wherever the chunks were summed.
#[derive(Clone, Debug)]
enum StepSums {
    /// With one base material.
    One(ChunkSums),
    /// With several.
    Blended { chunks: Vec<BlendedSums>, lobes: usize, materials: usize },
}

impl Default for StepSums {
    fn default() -> Self {
        Self::One(ChunkSums::default())
    }
}

/// Gradient of what the samples of a chunk share, with several base materials.
#[derive(Clone, Debug)]
pub struct BlendedSums {
    /// With respect to the light.
    pub lobes: LobeColumns,
    /// With respect to each base material.
    pub specular: Vec<SpecularAdjoint>,
}

impl BlendedSums {
    fn zeros(lobes: usize, materials: usize) -> Self {
        Self { lobes: LobeColumns::zeros(lobes), specular: vec![SpecularAdjoint::default(); materials] }
    }

    fn values(&self) -> impl Iterator<Item = f32> {
        let of_specular = |SpecularAdjoint { albedo: [r, g, b], roughness }: &_| [*r, *g, *b, *roughness];
        self.lobes.values().iter().copied().chain(self.specular.iter().flat_map(of_specular))
    }

    /// Adds [values](Self::values) of as many lobes and materials.
    fn add_values(&mut self, values: impl IntoIterator<Item = f32>) {
        let mut values = values.into_iter();
        let of_lobes: Vec<f32> = values.by_ref().take(self.lobes.values().len()).collect();
        self.lobes.add_values(&of_lobes);
        for sum in &mut self.specular {
            sum.albedo
                .iter_mut()
                .chain([&mut sum.roughness])
                .zip(&mut values)
                .for_each(|(sum, value)| *sum += value);
        }
    }
}

impl StepGradient {
    /// Memory for sums over chunks with one base material.
    pub(super) fn take_chunks(&mut self) -> ChunkSums {
        match std::mem::take(&mut self.chunks) {
            StepSums::One(chunks) => chunks,
            StepSums::Blended { .. } => ChunkSums::default(),
        }
    }

    /// Takes the sums over chunks with one base material.
    pub(super) fn set_chunks(&mut self, chunks: ChunkSums) {
        self.chunks = StepSums::One(chunks);
        self.take_total();
    }

    /// Whether it is that of several base materials.
    pub(super) fn is_blended(&self) -> bool {
        matches!(self.chunks, StepSums::Blended { .. })
    }

    /// Takes the sums over chunks with several base materials.
    pub(super) fn set_blended(&mut self, chunks: Vec<BlendedSums>, lobes: usize, materials: usize) {
        self.chunks = StepSums::Blended { chunks, lobes, materials };
        self.take_total();
    }

    /// Takes the total of the chunks.
    fn take_total(&mut self) {
        match &self.chunks {
            StepSums::One(chunks) => {
                chunks.total_into(&mut self.shared);
                self.specular = vec![self.shared.specular];
            }
            StepSums::Blended { chunks, lobes, materials } => {
                let mut total = BlendedSums::zeros(*lobes, *materials);
                chunks.iter().for_each(|chunk| total.add_values(chunk.values()));
                self.shared = SharedGradient { lobes: total.lobes, specular: total.specular[0] };
                self.specular = total.specular;
            }
        }
    }

    /// All values of the chunks, chunk by chunk.
    pub(super) fn chunk_values(&self) -> Vec<f32> {
        match &self.chunks {
            StepSums::One(chunks) => chunks.values().collect(),
            StepSums::Blended { chunks, .. } => chunks.iter().flat_map(BlendedSums::values).collect(),
        }
    }

    /// Replaces the chunks by those of these [values](Self::chunk_values), for as many lobes and materials, and takes their total.
    pub(super) fn set_chunk_values(&mut self, values: &[f32]) {
        match &mut self.chunks {
            StepSums::One(chunks) => chunks.set_values(values),
            StepSums::Blended { chunks, lobes, materials } => {
                let zeros = BlendedSums::zeros(*lobes, *materials);
                let chunk = |values: &[f32]| {
                    let mut chunk = zeros.clone();
                    chunk.add_values(values.iter().copied());
                    chunk
                };
                *chunks = values.chunks_exact(zeros.values().count()).map(chunk).collect();
            }
        }
        self.take_total();
    }
}
