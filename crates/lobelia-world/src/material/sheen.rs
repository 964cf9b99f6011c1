//! Sheen: a diffuse albedo that depends on the angle of view.
//!
//! Woven and coated surfaces show another color along the surface than straight on: threads of the
//! warp hide those of the weft, fibers scatter forward, a varnish reflects instead of letting light
//! in. With c = max(n·v, 0) the albedo toward a viewer is
//!
//! ρ(v) = ρ + (1 − c) s,
//!
//! where ρ is the texel's [`DiffuseAlbedo`] and s its [`DiffuseSheen`]: linear in both, so that
//! closed forms, shadows and interreflection stay as they are. The blend by c is that of a layer's
//! *facing* weight in production shaders; it is not reciprocal. Of `chair`'s error with a single
//! gray specular lobe it explains more than a colored specular albedo per texel does.

use super::{DiffuseAlbedo, DiffuseSheen, TexelIndex};
use crate::pipeline::pool::write_column;
use bevy_ecs::prelude::{Resource, World};
use glam::Vec3;
use lobelia_geometry::Result;
use lobelia_sg::ray::TexelAddress;

/// The mean of 1 − c over the hemisphere, weighted by c.
const MEAN_GRAZING: f32 = 1.0 / 3.0;

/// Diffuse albedo toward a viewer at the cosine `facing` = n·v, for the albedo ρ and the sheen s of
/// a point.
pub(crate) fn albedo_toward(albedo: Vec3, sheen: Vec3, facing: f32) -> Vec3 {
    albedo + sheen * grazing(facing)
}

/// 1 − max(n·v, 0), the weight of the sheen.
pub fn grazing(facing: f32) -> f32 {
    1.0 - facing.clamp(0.0, 1.0)
}

/// The part of light that leaves a surface of this albedo and sheen: the mean of ρ(v) over the
/// hemisphere, weighted by c.
pub fn mean_albedo(albedo: Vec3, sheen: Vec3) -> Vec3 {
    albedo + sheen * MEAN_GRAZING
}

/// Whether any texel has a sheen.
pub fn has_sheen(sheen: &[DiffuseSheen]) -> bool {
    sheen.iter().any(|sheen| sheen.0 != Vec3::ZERO)
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
    /// The sheen of all texels beside their albedo; `None` for texels of another surface.
    pub fn sheen(&self, albedo: &[Vec3]) -> Option<Vec<DiffuseSheen>> {
        let along = match self {
            Self::Everywhere(along) => vec![*along; albedo.len()],
            Self::Texels(along) => along.clone(),
        };
        let sheen = |(along, albedo): (&Vec3, &Vec3)| DiffuseSheen(*along - *albedo);
        (along.len() == albedo.len()).then(|| along.iter().zip(albedo).map(sheen).collect())
    }

    /// Resamples the albedo for texels of the same surface at these places among those of now.
    pub fn divided(&self, from: &[TexelAddress]) -> Self {
        match self {
            Self::Everywhere(along) => Self::Everywhere(*along),
            Self::Texels(along) => Self::Texels(from.iter().map(|at| at.blend(along)).collect()),
        }
    }
}

/// Sets the recovered albedo of all texels. Where that along the surface is known, the sheen
/// follows.
///
/// # Errors
/// If the pool of texels is incomplete.
pub fn write_albedo(world: &mut World, albedo: Vec<Vec3>) -> Result<()> {
    if let Some(sheen) = world.get_resource::<KnownAlong>().and_then(|known| known.sheen(&albedo)) {
        write_column::<TexelIndex, DiffuseSheen>(world, &sheen)?;
    }
    let albedo: Vec<DiffuseAlbedo> = albedo.into_iter().map(DiffuseAlbedo).collect();
    write_column::<TexelIndex, DiffuseAlbedo>(world, &albedo)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::pool::read_column;

    #[test]
    fn albedo_goes_from_that_straight_on_to_that_along_the_surface() {
        let (albedo, sheen) = (Vec3::new(0.2, 0.4, 0.6), Vec3::new(0.3, 0.0, -0.5));
        assert_eq!(albedo_toward(albedo, sheen, 1.0), albedo);
        assert_eq!(albedo_toward(albedo, sheen, 0.0), albedo + sheen);
        assert_eq!(albedo_toward(albedo, sheen, -0.5), albedo + sheen, "from behind, as along the surface");
        assert_eq!(albedo_toward(albedo, Vec3::ZERO, 0.3), albedo);
    }

    #[test]
    fn a_known_albedo_along_the_surface_stays_when_that_straight_on_moves() {
        let mut world = World::new();
        let (old, new) = (vec![Vec3::splat(0.4); 3], vec![Vec3::splat(0.1), Vec3::X, Vec3::ZERO]);
        let texels = (0..3).map(TexelIndex).zip(old.into_iter().map(DiffuseAlbedo));
        world.spawn_batch(texels.collect::<Vec<_>>());
        write_albedo(&mut world, new.clone()).unwrap();
        let sheen = |world: &mut World| read_column::<TexelIndex, DiffuseSheen>(world).unwrap();
        assert!(!has_sheen(&sheen(&mut world)));
        for known in [KnownAlong::Everywhere(Vec3::Y), KnownAlong::Texels(vec![Vec3::Y; 3])] {
            world.insert_resource(known);
            write_albedo(&mut world, new.clone()).unwrap();
            for (sheen, albedo) in sheen(&mut world).iter().zip(&new) {
                assert!((sheen.0 + *albedo).abs_diff_eq(Vec3::Y, 1e-6));
            }
        }
        assert_eq!(KnownAlong::Texels(Vec::new()).sheen(&new), None);
    }
}
