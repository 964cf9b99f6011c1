//! The diffuse material of a texel: an albedo that depends on the angle and the side from which it
//! is seen.
//!
//! Woven and coated surfaces show another color along the surface than straight on: threads of the
//! warp hide those of the weft, fibers scatter forward, a varnish reflects instead of letting light
//! in. Fibers and brush strokes lean, and relief finer than the mesh turns its lit flanks to one
//! side: such a surface is brighter from there than from the opposite side, at the same angle. With
//! c = max(n·v, 0) and v⊥ = v − (n·v) n, the part of the view direction along the surface, the
//! albedo toward a viewer is
//!
//! ρ(v) = ρ + (1 − c) s + ρ̄ t · v⊥,
//!
//! with the albedo ρ, the sheen s and the tilt t of the texel's [`Diffuse`], and the mean ρ̄ of the
//! first two terms over the hemisphere.
//!
//! Albedo and sheen are linear, so that closed forms, shadows and interreflection stay as they are.
//! The blend by c is that of a layer's *facing* weight in production shaders. Of `chair`'s error
//! with a single gray specular lobe it explains more than a colored specular albedo per texel does.
//! The tilt is the next order of a series in the view direction, as surface light fields have it
//! (Wood et al. 2000), with the color of the albedo. The mean over the hemisphere stays ρ̄, so that
//! interreflection and exports are those without a tilt. Neither is reciprocal.

use super::{Shown, SpecularBlend, TexelIndex};
use crate::pipeline::pool::{check_rows, with_columns};
use bevy_ecs::prelude::{Component, Resource, World};
use glam::Vec3;
use lobelia_geometry::Result;
use lobelia_sg::ray::TexelAddress;
use serde::{Deserialize, Serialize};

/// The mean of 1 − c over the hemisphere, weighted by c.
const MEAN_GRAZING: f32 = 1.0 / 3.0;
/// Longest tilt: from every side a part of the mean albedo is left.
pub const MOST_TILT: f32 = 0.9;

/// Diffuse material of a texel, or of a point between texels.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[require(SpecularBlend, Shown<Diffuse>)]
pub struct Diffuse {
    /// The albedo ρ toward a viewer straight above, linear RGB in `[0, 1]`.
    pub albedo: Vec3,
    /// The sheen s, the difference between the albedo along the surface and straight on, linear
    /// RGB in [−1, 1]; the sum of both is in [0, 1].
    pub sheen: Vec3,
    /// The tilt t, how much brighter the albedo is toward one side: a vector in the object's axes,
    /// at most [`MOST_TILT`] long.
    pub tilt: Vec3,
}

impl Diffuse {
    /// One albedo toward all viewers.
    pub const fn of_albedo(albedo: Vec3) -> Self {
        Self { albedo, sheen: Vec3::ZERO, tilt: Vec3::ZERO }
    }

    /// The albedo along the surface.
    pub fn along(&self) -> Vec3 {
        self.albedo + self.sheen
    }

    /// The part of light that leaves the surface: the mean ρ̄ of ρ(v) over the hemisphere, weighted
    /// by c.
    pub fn mean_albedo(&self) -> Vec3 {
        self.albedo + self.sheen * MEAN_GRAZING
    }

    /// Interpolates the texels `of` at a place.
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
        let straight = self.albedo + self.sheen * grazing(facing);
        if self.tilt == Vec3::ZERO {
            return straight;
        }
        let side = self.mean_albedo() * self.tilt.dot(side);
        // Unlike the clamp of vectors, that of numbers keeps what is not a number, which must not
        // pass for black.
        Vec3::from_array((straight + side).to_array().map(|channel| channel.clamp(0.0, 1.0)))
    }
}

/// 1 − max(n·v, 0), the weight of the sheen.
pub fn grazing(facing: f32) -> f32 {
    1.0 - facing.clamp(0.0, 1.0)
}

/// The part v⊥ of a unit direction along the surface.
pub fn along_surface(normal: Vec3, direction: Vec3) -> Vec3 {
    direction - normal * normal.dot(direction)
}

/// Whether any texel has a sheen.
pub fn has_sheen(texels: &[Diffuse]) -> bool {
    texels.iter().any(|texel| texel.sheen != Vec3::ZERO)
}

/// Whether any texel has a tilt.
pub fn has_tilt(texels: &[Diffuse]) -> bool {
    texels.iter().any(|texel| texel.tilt != Vec3::ZERO)
}

/// The albedo along the surface where it is known: a change of the albedo straight on changes the
/// sheen, which is their difference.
#[derive(Resource, Clone, Debug, PartialEq)]
pub enum KnownAlong {
    /// One albedo everywhere, independent of the texels.
    Everywhere(Vec3),
    /// The albedo of each texel of the surface.
    Texels(Vec<Vec3>),
}

impl KnownAlong {
    /// Sets the sheen of all texels beside their albedo; texels of another surface stay.
    pub fn set_sheen(&self, texels: &mut [Diffuse]) {
        let set = |(texel, along): (&mut Diffuse, &Vec3)| texel.sheen = *along - texel.albedo;
        match self {
            Self::Everywhere(along) => texels.iter_mut().for_each(|texel| set((texel, along))),
            Self::Texels(along) if along.len() == texels.len() => texels.iter_mut().zip(along).for_each(set),
            Self::Texels(_) => {}
        }
    }

    /// Resamples the albedo for texels of the same surface at these places among those of now.
    pub fn divided(&self, from: &[TexelAddress]) -> Self {
        match self {
            Self::Everywhere(along) => Self::Everywhere(*along),
            Self::Texels(along) => Self::Texels(from.iter().map(|at| at.blend(along)).collect()),
        }
    }
}

/// All texels of an object, by their albedo; without a sheen, but where that along the surface is
/// known.
pub fn of_albedos(world: &World, albedos: impl IntoIterator<Item = Vec3>) -> Vec<Diffuse> {
    let mut texels: Vec<Diffuse> = albedos.into_iter().map(Diffuse::of_albedo).collect();
    world.get_resource::<KnownAlong>().into_iter().for_each(|known| known.set_sheen(&mut texels));
    texels
}

/// Sets the recovered albedo of all texels. Where that along the surface is known, the sheen
/// follows.
///
/// # Errors
/// If the pool of texels is incomplete, or has another number of texels.
pub fn write_albedo(world: &mut World, albedo: &[Vec3]) -> Result<()> {
    let known = world.get_resource::<KnownAlong>().cloned();
    with_columns::<TexelIndex, &mut Diffuse, _>(world, |mut texels| {
        check_rows::<TexelIndex>(albedo.len(), texels.len())?;
        texels.iter_mut().zip(albedo).for_each(|(texel, albedo)| texel.albedo = *albedo);
        known.iter().for_each(|known| known.set_sheen(&mut texels));
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::pool::read_column;

    #[test]
    fn albedo_goes_from_that_straight_on_to_that_along_the_surface() {
        let (albedo, sheen) = (Vec3::new(0.2, 0.4, 0.6), Vec3::new(0.3, 0.0, -0.5));
        let cloth = Diffuse { sheen, ..Diffuse::of_albedo(albedo) };
        assert_eq!(cloth.along(), albedo + sheen);
        assert_eq!(cloth.seen_at(1.0, Vec3::ZERO), albedo);
        assert_eq!(cloth.seen_at(0.0, Vec3::X), cloth.along());
        assert_eq!(cloth.seen_at(-0.5, Vec3::X), cloth.along(), "from behind, as along the surface");
        assert_eq!(Diffuse::of_albedo(albedo).seen_at(0.3, Vec3::X), albedo);
    }

    #[test]
    fn a_known_albedo_along_the_surface_stays_when_that_straight_on_moves() {
        let mut world = World::new();
        let (old, new) = (Diffuse::of_albedo(Vec3::splat(0.4)), [Vec3::splat(0.1), Vec3::X, Vec3::ZERO]);
        world.spawn_batch([0, 1, 2].map(|row| (TexelIndex(row), old)));
        let texels = |world: &mut World| read_column::<TexelIndex, Diffuse>(world).unwrap();
        write_albedo(&mut world, &new).unwrap();
        assert_eq!(texels(&mut world), new.map(Diffuse::of_albedo));
        for known in [KnownAlong::Everywhere(Vec3::Y), KnownAlong::Texels(vec![Vec3::Y; 3])] {
            world.insert_resource(known);
            write_albedo(&mut world, &new).unwrap();
            let found = texels(&mut world);
            assert!(has_sheen(&found) && found == of_albedos(&world, new));
            assert!(found.iter().all(|texel| texel.along().abs_diff_eq(Vec3::Y, 1e-6)));
        }
        let mut others = new.map(Diffuse::of_albedo);
        KnownAlong::Texels(Vec::new()).set_sheen(&mut others);
        assert!(!has_sheen(&others));
        assert!(write_albedo(&mut world, &new[..2]).is_err());
    }

    #[test]
    fn the_albedo_is_brighter_from_the_side_of_the_tilt() {
        let point = Diffuse {
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
            let point = Diffuse { tilt, ..Diffuse::of_albedo(Vec3::new(f32::NAN, 0.5, 0.5)) };
            assert!(point.toward(Vec3::Z, Vec3::new(0.6, 0.0, 0.8)).x.is_nan());
        }
    }

    #[test]
    fn the_mean_over_the_hemisphere_is_that_without_a_tilt() {
        let (albedo, sheen) = (Vec3::splat(0.4), Vec3::splat(0.2));
        let point = Diffuse { albedo, sheen, tilt: Vec3::new(0.5, -0.3, 0.2) };
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
        let off = (sum / weight - point.mean_albedo()).length();
        assert!(off < 1e-3, "{off}");
    }

    #[test]
    fn a_point_between_texels_is_a_mixture_of_them() {
        let address = TexelAddress { indices: [0, 1, 2, 3], weights: [0.5, 0.25, 0.25, 0.0] };
        let of = |number: f32| Diffuse {
            albedo: Vec3::splat(number),
            sheen: Vec3::X * number,
            tilt: Vec3::Y * number,
        };
        assert_eq!(Diffuse::mixed(&address, |texel| of(texel as f32)), of(0.75));
    }
}
