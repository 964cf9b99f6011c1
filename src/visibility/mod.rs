//! Shadows and interreflection in closed-form shading: occlusion by other parts of the object, and light that they reflect.
//!
//! A separate capability in [`Slot::Visibility`](crate::pipeline::Slot::Visibility); without it all light reaches every point.
//!
//! | parameter | type | default | meaning |
//! | --- | --- | --- | --- |
//! | `directions` | `u32` | 512 | directions over the sphere per texel, a multiple of 64 |
//! | `bounces` | `u32` | 2 | interreflections between parts of the object; 0 for shadows only |
//! | `refresh_every` | `u32` | 50 | steps of a fit between two updates of shadows and interreflection |
//!
//! | module | holds |
//! | --- | --- |
//! | `trace` | the occluded directions of each texel, and the texels that occlude them |
//! | `occlusion` | kernels: light on a set of directions, and the part of it that reaches texels and points |
//! | [`systems`] | the systems in `Slot::Visibility`, and their run conditions |
//!
//! Diffuse light has one factor per texel and lobe, interpolated at the point like albedo, so that the light can be fitted with it.
//! Specular light has one per point, for the mirror direction and the mean roughness of the base materials there. In the adjoint all
//! factors and the interreflection are constant.

pub(crate) mod occlusion;
pub mod systems;
pub(crate) mod trace;

pub use systems::{FitVisibilityPlugin, FrameVisibilityPlugin};

use crate::material::source::MaterialSource;
use crate::math::brdf::ndf_sharpness;
use crate::math::fibonacci::fibonacci_axes;
use crate::math::shading::{LobeColumns, PointVisibility, ShadePoint, Visibility};
use crate::mesh::Surface;
use crate::sample::point::SurfacePoint;
use crate::visibility::occlusion::{Blend, Bounce, Sky, light_rows, point_visibility};
use crate::visibility::trace::TexelVisibility;
use bevy_ecs::prelude::{Entity, Resource};
use glam::Vec3;
use rayon::prelude::*;
use std::any::TypeId;

/// Settings of shadows and interreflection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VisibilitySettings {
    /// Directions over the sphere.
    pub directions: u32,
    /// Interreflections between parts of the object.
    pub bounces: u32,
    /// Steps of a fit between two updates.
    pub refresh_every: u32,
}

impl VisibilitySettings {
    /// Estimated bytes per texel, with 128 lobes and a quarter of the directions above it occluded.
    pub fn bytes_per_texel(&self) -> usize {
        let directions = self.directions as usize;
        directions / 8 + directions / 2 + 128 + 48
    }
}

impl Default for VisibilitySettings {
    fn default() -> Self {
        Self { directions: 512, bounces: 2, refresh_every: 50 }
    }
}

/// Occlusion of the object by itself, and the light on it at the last update.
#[derive(Resource, Default)]
pub struct ObjectVisibility {
    settings: VisibilitySettings,
    texels: TexelVisibility,
    /// The inputs of the last update.
    made: Option<Made>,
    sky: Sky,
    bounce: Bounce,
    parts: Vec<u8>,
    stride: usize,
}

/// The inputs of shadows and interreflection.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Made {
    /// The light's lobes and the base materials, by entity.
    from: Vec<Entity>,
    /// The type of the material: recovered or shown.
    source: TypeId,
}

impl ObjectVisibility {
    /// Traces a surface.
    pub fn new(surface: &Surface, settings: VisibilitySettings) -> Self {
        let directions = fibonacci_axes(settings.directions.next_multiple_of(64).max(64) as usize);
        let texels = TexelVisibility::trace(surface.atlas(), surface, directions);
        Self { settings, texels, ..Self::default() }
    }

    /// Whether no texel occludes another.
    pub fn sees_all(&self) -> bool {
        (0..self.texels.len()).all(|row| self.texels.sees_all(row))
    }

    /// The settings.
    pub fn settings(&self) -> VisibilitySettings {
        self.settings
    }

    /// Memory in bytes, for at least 128 lobes.
    pub fn bytes(&self) -> usize {
        let per_row = self.stride.max(128) + 2 * size_of::<Vec3>();
        self.texels.bytes() + self.texels.len() * per_row
    }

    /// Computes shadows and interreflection for this light and this reflectance (diffuse and specular, by texel).
    pub fn refresh(&mut self, lobes: &LobeColumns, reflectance: &(dyn Fn(u32) -> Vec3 + Sync)) {
        self.made = None;
        self.sky = Sky::new(&self.texels.directions, lobes);
        self.stride = lobes.stride();
        let mut direct = Vec::new();
        light_rows(&self.texels, &self.sky, &mut self.parts, &mut direct);
        self.bounce = Bounce::new(&self.texels, &direct, reflectance, self.settings.bounces);
    }

    /// Whether the last update was for this material, these lobes and base materials.
    fn is_made_from<M: MaterialSource>(&self, from: &[Entity]) -> bool {
        self.made.as_ref().is_some_and(|made| made.from == from && made.source == TypeId::of::<M>())
    }

    /// Computes the visibility of points, given the roughness of each by index; overwrites `rows` and `seen`.
    pub fn window(
        &self,
        points: &[SurfacePoint],
        gathered: &[ShadePoint],
        roughness: impl Fn(usize) -> f32 + Sync,
        rows: &mut WindowVisibility,
        seen: &mut [PointVisibility],
    ) {
        rows.stride = self.stride;
        rows.rows.resize(points.len() * self.stride, 255);
        let outputs = rows.rows.par_chunks_mut(self.stride.max(1)).zip(seen);
        let each = outputs.zip(points.par_iter().zip(gathered)).enumerate().with_min_len(256);
        each.for_each(|(i, ((parts, seen), (point, gathered)))| {
            *seen = PointVisibility::OPEN;
            parts.fill(255);
            let Some(blend) = self.blend(point).filter(|_| point.is_hit()) else { return };
            self.blend_parts(&blend, parts);
            let sharpness = ndf_sharpness(roughness(i));
            *seen = point_visibility(&self.texels, &self.sky, &self.bounce, &blend, gathered, sharpness);
        });
    }

    /// The rows that are interpolated at a point.
    fn blend(&self, point: &SurfacePoint) -> Option<Blend> {
        let mut blend = [(0, 0.0); 4];
        let mut total = 0.0;
        for (i, slot) in blend.iter_mut().enumerate() {
            let row = self.texels.rows[point.texels.indices[i] as usize];
            if row != TexelVisibility::NONE {
                *slot = (row as usize, point.texels.weights[i]);
                total += slot.1;
            }
        }
        blend.iter_mut().for_each(|(_, weight)| *weight /= total);
        (total > 0.0).then_some(blend)
    }

    /// Interpolates the visibility of the lobes at a point.
    fn blend_parts(&self, blend: &Blend, out: &mut [u8]) {
        let rows = blend.map(|(row, _)| &self.parts[row * self.stride..][..self.stride]);
        // Weights in units of 1/65536, so that 255 in all four rows stays 255.
        let mut weights = blend.map(|(_, weight)| (weight * 65536.0) as u32);
        weights[0] += 65536 - weights.iter().sum::<u32>();
        for (i, out) in out.iter_mut().enumerate() {
            let sum: u32 = (0..4).map(|k| u32::from(rows[k][i]) * weights[k]).sum();
            *out = (sum >> 16) as u8;
        }
    }
}

/// The visibility of the lobes at the points of the current window.
#[derive(Resource, Default)]
pub struct WindowVisibility {
    rows: Vec<u8>,
    stride: usize,
}

impl WindowVisibility {
    /// The visibility as the kernels read it, if there is any; `points` are those of the window.
    pub fn view<'a>(&'a self, points: &'a [PointVisibility]) -> Option<Visibility<'a>> {
        let there = self.stride > 0 && self.rows.len() == points.len() * self.stride;
        there.then_some(Visibility { lobes: &self.rows, points })
    }
}
