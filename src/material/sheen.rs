//! Sheen: a diffuse albedo that depends on the angle of view.
//!
//! Woven and coated surfaces show another color along the surface than straight on: threads of the warp hide those of the weft, fibers
//! scatter forward, a varnish reflects instead of letting light in. With c = max(n·v, 0) the albedo toward a viewer is
//!
//! ρ(v) = ρ + (1 − c) s,
//!
//! where ρ is the texel's [`DiffuseAlbedo`](super::DiffuseAlbedo) and s its [`DiffuseSheen`]: linear in both, so that closed forms, shadows and
//! interreflection stay as they are. The blend by c is that of a layer's *facing* weight in production shaders; it is not
//! reciprocal. Of `chair`'s error with a single gray specular lobe it explains more than a colored specular albedo per texel does.

use super::DiffuseSheen;
use glam::Vec3;

/// The mean of 1 − c over the hemisphere, weighted by c.
const MEAN_GRAZING: f32 = 1.0 / 3.0;

/// Diffuse albedo toward a viewer at the cosine `facing` = n·v, for the albedo ρ and the sheen s of a point.
pub fn albedo_toward(albedo: Vec3, sheen: Vec3, facing: f32) -> Vec3 {
    albedo + sheen * grazing(facing)
}

/// 1 − max(n·v, 0), the weight of the sheen.
pub fn grazing(facing: f32) -> f32 {
    1.0 - facing.clamp(0.0, 1.0)
}

/// The part of light that leaves a surface of this albedo and sheen: the mean of ρ(v) over the hemisphere, weighted by c.
pub fn mean_albedo(albedo: Vec3, sheen: Vec3) -> Vec3 {
    albedo + sheen * MEAN_GRAZING
}

/// Whether any texel has a sheen.
pub fn has_sheen(sheen: &[DiffuseSheen]) -> bool {
    sheen.iter().any(|sheen| sheen.0 != Vec3::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn albedo_goes_from_that_straight_on_to_that_along_the_surface() {
        let (albedo, sheen) = (Vec3::new(0.2, 0.4, 0.6), Vec3::new(0.3, 0.0, -0.5));
        assert_eq!(albedo_toward(albedo, sheen, 1.0), albedo);
        assert_eq!(albedo_toward(albedo, sheen, 0.0), albedo + sheen);
        assert_eq!(
            albedo_toward(albedo, sheen, -0.5),
            albedo + sheen,
            "seen from behind, as along the surface"
        );
        assert_eq!(albedo_toward(albedo, Vec3::ZERO, 0.3), albedo);
    }

    #[test]
    fn the_mean_is_that_over_the_hemisphere() {
        let (albedo, sheen) = (Vec3::splat(0.2), Vec3::splat(0.6));
        let steps = 1000;
        let (sum, weight) = (0..steps).fold((Vec3::ZERO, 0.0), |(sum, weight), i| {
            // Uniform in c over the hemisphere's solid angle, times c.
            let c = (i as f32 + 0.5) / steps as f32;
            (sum + albedo_toward(albedo, sheen, c) * c, weight + c)
        });
        assert!((sum / weight - mean_albedo(albedo, sheen)).length() < 1e-4);
    }
}
