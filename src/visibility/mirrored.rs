//! The object in its own mirror: where the lobe of the BRDF is narrower than the directions of [`TexelVisibility`] lie apart, a few rays find what
//! the surface mirrors.

use crate::math::ray::{Intersect, Ray};
use crate::visibility::occlusion::{Bounce, Sky};
use crate::visibility::texel_visibility::TexelVisibility;
use glam::{Mat3, Vec3};

/// Rays of a point.
const RAYS: u32 = 16;
const OFFSET: f32 = 1e-4;

/// What rays may meet.
#[derive(Clone, Copy)]
pub(crate) struct Mirrored<'a> {
    pub surface: &'a dyn Intersect,
    pub visibility: &'a TexelVisibility,
    pub sky: &'a Sky,
    pub bounce: &'a Bounce,
}

impl Mirrored<'_> {
    /// The part of the light in a lobe around `axis` that arrives at a point.
    pub fn part(&self, at: Vec3, [normal, axis]: [Vec3; 2], sharpness: f32, most: f32) -> Vec3 {
        let frame = frame_around(axis);
        let (mut arriving, mut unhidden) = (Vec3::ZERO, Vec3::ZERO);
        for i in 0..RAYS {
            let direction = frame * in_lobe(i, sharpness);
            let cosine = normal.dot(direction);
            if cosine <= 0.0 {
                continue;
            }
            let sky = self.sky.toward(direction);
            unhidden += sky * cosine;
            arriving += self.from(at, direction).unwrap_or(sky) * cosine;
        }
        let floor = Vec3::splat(1e-6 * unhidden.max_element().max(1e-20));
        (arriving / unhidden.max(floor)).clamp(Vec3::ZERO, Vec3::splat(most))
    }

    /// Radiance that the surface sends from a direction; `None` if there is only sky.
    fn from(&self, at: Vec3, direction: Vec3) -> Option<Vec3> {
        let ray = Ray { origin: at, direction };
        let hit = self.surface.intersect(&ray, OFFSET * self.surface.radius())?;
        if hit.geometric_normal.dot(direction) >= 0.0 {
            return Some(Vec3::ZERO);
        }
        let texels = hit.texels.indices.into_iter().zip(hit.texels.weights);
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        let mode = std::env::var("MODE").is_ok();
        for (texel, weight) in texels {
            if let Some(leaving) = self.bounce.leaving.get(self.visibility.rows[texel as usize] as usize) {
                let row = self.visibility.rows[texel as usize] as usize;
                if mode {
                    let out = direction - 2.0 * direction.dot(hit.normal) * hit.normal;
                    let f0 = self.bounce.mirrored[row];
                    let cosine = -direction.dot(hit.normal);
                    let fresnel = f0 + (Vec3::ONE - f0) * (1.0 - cosine.clamp(0.0, 1.0)).powi(5);
                    sum += weight * (self.bounce.diffuse[row] + fresnel * self.sky.toward(out));
                } else {
                    sum += *leaving * weight;
                }
                total += weight;
            }
        }
        (total > 0.0).then(|| sum / total)
    }
}

/// The i-th of the directions of equal weight of a lobe around +Z, on a spiral (Vogel 1979).
fn in_lobe(i: u32, sharpness: f32) -> Vec3 {
    let part = (i as f32 + 0.5) / RAYS as f32;
    let z = 1.0 + (1.0 - part * (1.0 - (-2.0 * sharpness).exp())).ln() / sharpness;
    let (sin, cos) = (i as f32 * 2.399_963_2).sin_cos();
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(radius * cos, radius * sin, z)
}

fn frame_around(axis: Vec3) -> Mat3 {
    let (x, y) = axis.any_orthonormal_pair();
    Mat3::from_cols(x, y, axis)
}
