//! Tilt: a diffuse albedo that depends on the side it is seen from.
//!
//! Fibers and brush strokes lean, and relief finer than the mesh turns its lit flanks to one side:
//! such a surface is brighter from there than from the opposite side, at the same angle. With v⊥ =
//! v − (n·v) n, the part of the view direction along the surface, the albedo toward a viewer is
//!
//! ρ(v) = ρ + (1 − c) s + ρ̄ t · v⊥,
//!
//! with the albedo ρ and sheen s of [`super::sheen`], their mean ρ̄ over the hemisphere, and the
//! texel's [`DiffuseTilt`] t, in the object's axes. It is the next order of a series in the view
//! direction, as surface light fields have it (Wood et al. 2000), with the color of the albedo. The
//! mean over the hemisphere stays ρ̄, so that interreflection and exports are those without a tilt.
//! Like the sheen, it is not reciprocal.

use super::DiffuseTilt;
use super::sheen::{albedo_toward, mean_albedo};
use glam::Vec3;
use lobelia_sg::ray::TexelAddress;

/// Longest tilt: from every side a part of the mean albedo is left.
pub const MOST_TILT: f32 = 0.9;

/// Diffuse albedo of a point toward all viewers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DirectionalAlbedo {
    /// ρ, toward a viewer straight above.
    pub albedo: Vec3,
    /// The sheen s.
    pub sheen: Vec3,
    /// The tilt t.
    pub tilt: Vec3,
}

impl DirectionalAlbedo {
    /// Interpolates the albedo of the texels `of` at a place.
    pub fn mixed(address: &TexelAddress, of: impl Fn(usize) -> Self) -> Self {
        let parts = address.indices.into_iter().zip(address.weights);
        parts.fold(Self::default(), |sum, (texel, weight)| {
            let at = of(texel as usize);
            let (albedo, sheen) = (sum.albedo + at.albedo * weight, sum.sheen + at.sheen * weight);
            Self { albedo, sheen, tilt: sum.tilt + at.tilt * weight }
        })
    }

    /// ρ(v) for the unit `normal` and the unit direction `to_viewer`, in the object's axes; with a
    /// tilt, clamped to [0, 1].
    pub fn toward(&self, normal: Vec3, to_viewer: Vec3) -> Vec3 {
        self.seen_at(normal.dot(to_viewer), along_surface(normal, to_viewer))
    }

    /// Returns ρ(v) for the cosine n·v and the part v⊥ of the view direction along the surface.
    pub fn seen_at(&self, facing: f32, side: Vec3) -> Vec3 {
        let straight = albedo_toward(self.albedo, self.sheen, facing);
        if self.tilt == Vec3::ZERO {
            return straight;
        }
        let side = mean_albedo(self.albedo, self.sheen) * self.tilt.dot(side);
        // Unlike the clamp of vectors, that of numbers keeps what is not a number, which must not
        // pass for black.
        Vec3::from_array((straight + side).to_array().map(|channel| channel.clamp(0.0, 1.0)))
    }
}

/// The part v⊥ of a unit direction along the surface.
pub fn along_surface(normal: Vec3, direction: Vec3) -> Vec3 {
    direction - normal * normal.dot(direction)
}

/// Whether any texel has a tilt.
pub fn has_tilt(tilt: &[DiffuseTilt]) -> bool {
    tilt.iter().any(|tilt| tilt.0 != Vec3::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_albedo_is_brighter_from_the_side_of_the_tilt() {
        let point = DirectionalAlbedo {
            albedo: Vec3::new(0.2, 0.4, 0.9),
            sheen: Vec3::new(0.3, 0.0, 0.0),
            tilt: Vec3::new(0.5, 0.0, 0.7),
        };
        let from = |x: f32| point.toward(Vec3::Z, Vec3::new(x, 0.0, (1.0 - x * x).sqrt()));
        assert_eq!(from(0.0), point.albedo, "straight on there are no sides");
        assert!(from(0.8).abs_diff_eq(Vec3::new(0.2 + 0.12 + 0.12, 0.4 + 0.16, 1.0), 1e-6), "{}", from(0.8));
        assert!(from(-0.8).abs_diff_eq(Vec3::new(0.2 + 0.12 - 0.12, 0.24, 0.54), 1e-6), "{}", from(-0.8));
    }

    #[test]
    fn what_is_not_a_number_stays() {
        for tilt in [Vec3::ZERO, Vec3::X] {
            let point =
                DirectionalAlbedo { albedo: Vec3::new(f32::NAN, 0.5, 0.5), tilt, ..Default::default() };
            assert!(point.toward(Vec3::Z, Vec3::new(0.6, 0.0, 0.8)).x.is_nan());
        }
    }

    #[test]
    fn the_mean_over_the_hemisphere_is_that_without_a_tilt() {
        let (albedo, sheen) = (Vec3::splat(0.4), Vec3::splat(0.2));
        let point = DirectionalAlbedo { albedo, sheen, tilt: Vec3::new(0.5, -0.3, 0.2) };
        let normal = Vec3::new(0.36, 0.48, 0.8);
        let (x, y) = normal.any_orthonormal_pair();
        let directions = (0..4000).map(|i| {
            let (c, angle) = ((i as f32 + 0.5) / 4000.0, i as f32 * 2.399_963);
            normal * c + (x * angle.cos() + y * angle.sin()) * (1.0 - c * c).sqrt()
        });
        let (sum, weight) = directions.fold((Vec3::ZERO, 0.0), |(sum, weight), direction| {
            let c = normal.dot(direction);
            (sum + point.toward(normal, direction) * c, weight + c)
        });
        let off = (sum / weight - mean_albedo(albedo, sheen)).length();
        assert!(off < 1e-3, "{off}");
    }

    #[test]
    fn a_point_between_texels_is_a_mixture_of_them() {
        let address = TexelAddress { indices: [0, 1, 2, 3], weights: [0.5, 0.25, 0.25, 0.0] };
        let of = |texel: usize| DirectionalAlbedo {
            albedo: Vec3::splat(texel as f32),
            sheen: Vec3::X * texel as f32,
            tilt: Vec3::Y * texel as f32,
        };
        let expected =
            DirectionalAlbedo { albedo: Vec3::splat(0.75), sheen: Vec3::X * 0.75, tilt: Vec3::Y * 0.75 };
        assert_eq!(DirectionalAlbedo::mixed(&address, of), expected);
    }
}
