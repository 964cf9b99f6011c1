//! Pixels as they are kept for the sweeps: shaded once, because light and shadows stay as they are while the texture is solved for.

use super::equations::TexelEquations;
use crate::material::sheen::grazing;
use crate::material::tilt::DirectionalAlbedo;
use crate::math::ray::TexelAddress;
use crate::sample::pixel::Observed;
use crate::view::numbers::packed;
use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use half::f16;
use serde::{Deserialize, Serialize};

/// Residual relative to the radiance (and [`DARK`]) at which a pixel counts half.
const TOLERATED: f32 = 1.0;
/// Radiance below which residuals count as if it were this.
const DARK: f32 = 0.1;

/// A pixel that shows the surface, as if the surface were white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ShadedPixel {
    /// The texels that it shows.
    pub texels: TexelAddress,
    /// Cosine between normal and view direction, above 0.
    pub facing: f32,
    /// The part of the view direction along the surface.
    pub side: Vec3,
    /// Diffuse radiance of a white surface, in units of the photograph.
    pub unit: Vec3,
    /// Specular radiance, likewise.
    pub specular: Vec3,
    /// What the photograph shows.
    pub observed: Observed,
}

/// A [`ShadedPixel`] in 40 bytes: numbers have 11 bits, places in a texel 16.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct KeptPixel {
    /// The first texel of the upper and of the lower row.
    rows: [u32; 2],
    /// Place between the four texels, in 1/65535.
    place: [u16; 2],
    side: [f16; 3],
    unit: [f16; 3],
    specular: [f16; 3],
    observed: [f16; 3],
    facing: f16,
    /// 1 if it is, else 0.
    saturated: u16,
}

/// Kept pixels, as processes send them.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct PackedPixels(#[serde(with = "packed")] pub Vec<KeptPixel>);

impl From<ShadedPixel> for KeptPixel {
    fn from(pixel: ShadedPixel) -> Self {
        let [_, right, below, both] = pixel.texels.weights;
        let fraction = |part: f32| (part.clamp(0.0, 1.0) * 65535.0).round() as u16;
        let halves = |v: Vec3| v.to_array().map(f16::from_f32);
        Self {
            rows: [pixel.texels.indices[0], pixel.texels.indices[2]],
            place: [fraction(right + both), fraction(below + both)],
            side: halves(pixel.side),
            unit: halves(pixel.unit),
            specular: halves(pixel.specular),
            observed: halves(pixel.observed.radiance),
            facing: f16::from_f32(pixel.facing),
            saturated: u16::from(pixel.observed.saturated),
        }
    }
}

impl From<KeptPixel> for ShadedPixel {
    fn from(kept: KeptPixel) -> Self {
        let [x, y] = kept.place.map(|place| f32::from(place) / 65535.0);
        let [above, below] = kept.rows;
        // At the last column there is no texel to the right, and its weight is 0.
        let right = u32::from(kept.place[0] > 0);
        let vector = |halves: [f16; 3]| Vec3::from(halves.map(f16::to_f32));
        Self {
            texels: TexelAddress {
                indices: [above, above + right, below, below + right],
                weights: [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y],
            },
            facing: kept.facing.to_f32(),
            side: vector(kept.side),
            unit: vector(kept.unit),
            specular: vector(kept.specular),
            observed: Observed { radiance: vector(kept.observed), saturated: kept.saturated != 0 },
        }
    }
}

/// Adds what the pixels say to the `equations` of their texels, which now have the albedo `of`. Beside a known albedo along the surface
/// (`is_known`) the unknown one has only its part.
pub(crate) fn add_pixels(
    pixels: &[KeptPixel],
    of: impl Fn(usize) -> DirectionalAlbedo,
    is_known: bool,
    equations: &mut [TexelEquations],
) {
    for pixel in pixels.iter().map(|kept| ShadedPixel::from(*kept)) {
        let albedo = DirectionalAlbedo::mixed(&pixel.texels, &of);
        let predicted = albedo.seen_at(pixel.facing, pixel.side) * pixel.unit + pixel.specular;
        let difference = |c: usize| -pixel.observed.difference(c, predicted[c]);
        let residual = Vec3::from_array(std::array::from_fn(difference));
        if !(pixel.unit.is_finite() && residual.is_finite()) {
            continue;
        }
        // A pixel seen at an angle shows more than its texels.
        let weight = pixel.facing * pixel.facing * agreement(residual, predicted);
        let along = grazing(pixel.facing);
        let (unit, along) = if is_known { (pixel.unit * (1.0 - along), 0.0) } else { (pixel.unit, along) };
        for (texel, share) in pixel.texels.indices.into_iter().zip(pixel.texels.weights) {
            equations[texel as usize].add(unit, along, pixel.side, residual, share * weight);
        }
    }
}

/// How much a pixel counts whose residual may be that of something the model does not have (Geman and McClure's weight), in [0, 1].
fn agreement(residual: Vec3, predicted: Vec3) -> f32 {
    let relative = residual.length() / (predicted.length() + DARK);
    (1.0 + (relative / TOLERATED).powi(2)).recip()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::atlas::address;
    use glam::Vec2;

    fn shaded(uv: Vec2) -> ShadedPixel {
        ShadedPixel {
            texels: address(uv, 8, 8),
            facing: 0.8,
            side: Vec3::new(0.6, 0.0, 0.0),
            unit: Vec3::new(2.0, 1.5, 1.0),
            specular: Vec3::new(0.25, 0.125, 0.5),
            observed: Observed { radiance: Vec3::new(1.0, 0.5, 0.25), saturated: true },
        }
    }

    #[test]
    fn a_kept_pixel_is_the_pixel_at_any_place() {
        for uv in [Vec2::new(0.4, 0.7), Vec2::ZERO, Vec2::ONE, Vec2::new(1.0, 0.3), Vec2::new(0.1, 1.0)] {
            let pixel = shaded(uv);
            let again = ShadedPixel::from(KeptPixel::from(pixel));
            let share = |of: &ShadedPixel, texel: u32| -> f32 {
                let parts = of.texels.indices.into_iter().zip(of.texels.weights);
                parts.filter(|(index, _)| *index == texel).map(|(_, weight)| weight).sum()
            };
            for texel in 0..64 {
                assert!((share(&pixel, texel) - share(&again, texel)).abs() < 1e-4, "{uv} {texel}");
            }
            assert!((pixel.facing - again.facing).abs() < 1e-3 && pixel.side.abs_diff_eq(again.side, 1e-3));
            assert_eq!(
                (pixel.unit, pixel.specular, pixel.observed),
                (again.unit, again.specular, again.observed)
            );
        }
    }

    #[test]
    fn sweeps_find_the_texels_that_pixels_were_made_of() {
        let truth = |texel: usize| Vec3::new(0.2 + 0.01 * texel as f32, 0.5, 0.7);
        let places = (0..40).flat_map(|y| (0..40).map(move |x| Vec2::new(x as f32, y as f32) / 39.0));
        let pixels: Vec<KeptPixel> = places
            .map(|uv| {
                let pixel = shaded(uv);
                let plain = |texel| DirectionalAlbedo { albedo: truth(texel), ..Default::default() };
                let albedo = DirectionalAlbedo::mixed(&pixel.texels, plain).albedo;
                let radiance = albedo * pixel.unit + pixel.specular;
                KeptPixel::from(ShadedPixel { observed: Observed { radiance, saturated: false }, ..pixel })
            })
            .collect();
        let mut albedo = vec![Vec3::splat(0.5); 64];
        for _ in 0..12 {
            let mut equations = vec![TexelEquations::default(); 64];
            let now = |texel: usize| DirectionalAlbedo { albedo: albedo[texel], ..Default::default() };
            add_pixels(&pixels, now, false, &mut equations);
            let changes = equations.iter().map(|equations| equations.solve(false, None).albedo);
            albedo = albedo.iter().zip(changes).map(|(albedo, change)| *albedo + change).collect();
        }
        for (texel, found) in albedo.iter().enumerate() {
            assert!(found.abs_diff_eq(truth(texel), 0.02), "{texel}: {found} {}", truth(texel));
        }
    }
}
