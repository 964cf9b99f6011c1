//! Shadows and reflected light in closed-form shading: what other parts of the object hide from a point, and what they send it.
//!
//! A capability of its own in [`Slot::Visibility`](crate::pipeline::Slot::Visibility); without it every point sees all light.
//!
//! | parameter | type | default | meaning |
//! | --- | --- | --- | --- |
//! | `directions` | `u32` | 512 | directions over the sphere in which texels look, a multiple of 64 |
//! | `bounces` | `u32` | 2 | reflections between parts of the object; 0 has shadows only |
//! | `refresh_every` | `u32` | 50 | steps of a fit after which shadows and reflected light are computed again |
//!
//! | module | holds |
//! | --- | --- |
//! | `trace` | which directions are hidden from each texel, and by which texel |
//! | `occlusion` | kernels: light on a set of directions, and what of it reaches texels and points |
//! | [`systems`] | the systems in `Slot::Visibility`, and what makes them run |
//!
//! Diffuse light has one factor per texel and lobe, blended at the point like albedo, so light can be fitted through it. Specular
//! light has one per point, along the mirrored view, at the mean roughness of the base materials there. The adjoint holds all of
//! them, and reflected light, fixed.

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

/// How shadows and reflected light are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VisibilitySettings {
    /// Directions over the sphere.
    pub directions: u32,
    /// Reflections between parts of the object.
    pub bounces: u32,
    /// Steps of a fit between two refreshes.
    pub refresh_every: u32,
}

impl VisibilitySettings {
    /// Bytes that a texel may be expected to need, with 128 lobes and a quarter of the directions above it hidden.
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

/// What the object hides from itself, and the light on it as it was at the last refresh.
#[derive(Resource, Default)]
pub struct ObjectVisibility {
    settings: VisibilitySettings,
    texels: TexelVisibility,
    /// What the rest was made from.
    made: Option<Made>,
    sky: Sky,
    bounce: Bounce,
    parts: Vec<u8>,
    stride: usize,
}

/// What shadows and reflected light were made from.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Made {
    /// The light's lobes and the base materials, by entity.
    from: Vec<Entity>,
    /// Which material.
    source: TypeId,
}

impl ObjectVisibility {
    /// Traces a surface.
    pub fn new(surface: &Surface, settings: VisibilitySettings) -> Self {
        let directions = fibonacci_axes(settings.directions.next_multiple_of(64).max(64) as usize);
        let texels = TexelVisibility::trace(surface.atlas(), surface, directions);
        Self { settings, texels, ..Self::default() }
    }

    /// Whether no texel hides anything from another.
    pub fn sees_all(&self) -> bool {
        (0..self.texels.len()).all(|row| self.texels.sees_all(row))
    }

    /// How it is found.
    pub fn settings(&self) -> VisibilitySettings {
        self.settings
    }

    /// Bytes in use, or to be used once there is light of 128 lobes.
    pub fn bytes(&self) -> usize {
        let per_row = self.stride.max(128) + 2 * size_of::<Vec3>();
        self.texels.bytes() + self.texels.len() * per_row
    }

    /// Makes shadows and reflected light anew for this light and reflectance (albedo and gloss, by texel).
    pub fn refresh(&mut self, lobes: &LobeColumns, reflectance: &(dyn Fn(u32) -> Vec3 + Sync)) {
        self.made = None;
        self.sky = Sky::new(&self.texels.directions, lobes);
        self.stride = lobes.stride();
        let mut direct = Vec::new();
        light_rows(&self.texels, &self.sky, &mut self.parts, &mut direct);
        self.bounce = Bounce::new(&self.texels, &direct, reflectance, self.settings.bounces);
    }

    /// Whether this was last computed for this material, these lobes and base materials.
    fn is_made_from<M: MaterialSource>(&self, from: &[Entity]) -> bool {
        self.made.as_ref().is_some_and(|made| made.from == from && made.source == TypeId::of::<M>())
    }

    /// What points see, given the roughness of each, by its number; `rows` and `seen` are overwritten.
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

    /// The rows that a point blends.
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

    /// Blends the lobes' parts of a point's rows.
    fn blend_parts(&self, blend: &Blend, out: &mut [u8]) {
        let rows = blend.map(|(row, _)| &self.parts[row * self.stride..][..self.stride]);
        // Weights in 65536ths: what is 255 in all four stays so.
        let mut weights = blend.map(|(_, weight)| (weight * 65536.0) as u32);
        weights[0] += 65536 - weights.iter().sum::<u32>();
        for (i, out) in out.iter_mut().enumerate() {
            let sum: u32 = (0..4).map(|k| u32::from(rows[k][i]) * weights[k]).sum();
            *out = (sum >> 16) as u8;
        }
    }
}

/// The lobes' parts at the points of the present window.
#[derive(Resource, Default)]
pub struct WindowVisibility {
    rows: Vec<u8>,
    stride: usize,
}

impl WindowVisibility {
    /// What the kernels read, if there is any; `points` are the window's.
    pub fn view<'a>(&'a self, points: &'a [PointVisibility]) -> Option<Visibility<'a>> {
        let there = self.stride > 0 && self.rows.len() == points.len() * self.stride;
        there.then_some(Visibility { lobes: &self.rows, points })
    }
}
