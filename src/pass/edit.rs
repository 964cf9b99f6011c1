//! Conversion of the edits of a scene file to edit entities.

use crate::codec::texture::{read_texture, read_texture_mask};
use crate::error::Result;
use crate::material::edit::{
    EditAction, EditName, EditOrder, EditRegion, EditTarget, MaterialState, apply_edit,
};
use crate::mesh::Surface;
use crate::mesh::atlas::TexelAtlas;
use crate::scene::{ColorAction, DiffuseAction, Edit, Region, ScalarAction};
use bevy_ecs::prelude::{Entity, World};
use glam::Vec3;
use rayon::prelude::*;

/// One edit, evaluated for the texels of a surface.
type ResolvedEdit = (EditTarget, EditAction, EditRegion);

/// Spawns edits with a name; replaces the edits that have it already.
///
/// # Errors
/// If an image cannot be read.
pub fn spawn_edits(world: &mut World, name: &str, edits: &[Edit], surface: &Surface) -> Result<()> {
    let resolved = resolved(edits, surface)?;
    let mut query = world.query::<(Entity, &EditName)>();
    let old: Vec<Entity> = query.iter(world).filter(|(_, of)| of.0 == name).map(|(edit, _)| edit).collect();
    old.into_iter().for_each(|edit| _ = world.despawn(edit));
    for ((target, action, region), order) in resolved.into_iter().zip(0..) {
        world.spawn((EditName(name.to_owned()), EditOrder(order), target, action, region));
    }
    Ok(())
}

/// Applies a scene file's edits in order.
///
/// # Errors
/// If an image cannot be read or there would be too many base materials.
pub fn apply_edits(state: &mut MaterialState, edits: &[Edit], surface: &Surface) -> Result<()> {
    let mut resolved = resolved(edits, surface)?.into_iter();
    resolved.try_for_each(|(target, action, region)| apply_edit(state, target, &action, &region))
}

fn resolved(edits: &[Edit], surface: &Surface) -> Result<Vec<ResolvedEdit>> {
    edits.iter().map(|edit| resolve(edit, surface.atlas())).collect()
}

fn resolve(edit: &Edit, atlas: &TexelAtlas) -> Result<ResolvedEdit> {
    let region = EditRegion(region_weights(edit.region(), atlas)?.map(Into::into));
    let (target, action) = match edit {
        Edit::Diffuse { action, .. } => (EditTarget::Diffuse, diffuse_action(action, atlas)?),
        Edit::Specular { action, .. } => (EditTarget::Specular, color_action(action)),
        Edit::Roughness { action, .. } => (EditTarget::Roughness, scalar_action(action)),
    };
    Ok((target, action, region))
}

fn diffuse_action(action: &DiffuseAction, atlas: &TexelAtlas) -> Result<EditAction> {
    Ok(match action {
        DiffuseAction::Set(color) => EditAction::Set(*color),
        DiffuseAction::Scale(factor) => EditAction::Scale(*factor),
        DiffuseAction::Blend { color, weight } => EditAction::Blend { value: *color, weight: *weight },
        DiffuseAction::Texture(path) => {
            EditAction::PerTexel(read_texture(path, atlas.width, atlas.height)?.into())
        }
    })
}

fn color_action(action: &ColorAction) -> EditAction {
    match action {
        ColorAction::Set(color) => EditAction::Set(*color),
        ColorAction::Scale(factor) => EditAction::Scale(*factor),
        ColorAction::Blend { color, weight } => EditAction::Blend { value: *color, weight: *weight },
    }
}

fn scalar_action(action: &ScalarAction) -> EditAction {
    match action {
        ScalarAction::Set(value) => EditAction::Set(Vec3::splat(*value)),
        ScalarAction::Scale(factor) => EditAction::Scale(Vec3::splat(*factor)),
        ScalarAction::Blend { value, weight } => {
            EditAction::Blend { value: Vec3::splat(*value), weight: *weight }
        }
    }
}

/// The indices of the edits, from 0, whose region contains no texel of the surface.
///
/// # Errors
/// If a mask cannot be read.
pub fn edits_of_nothing(edits: &[Edit], surface: &Surface) -> Result<Vec<usize>> {
    let atlas = surface.atlas();
    let mut numbers = Vec::new();
    for (number, edit) in edits.iter().enumerate() {
        let Some(weights) = region_weights(edit.region(), atlas)? else { continue };
        if !weights.iter().zip(&atlas.covered).any(|(weight, covered)| *covered && *weight > 0.0) {
            numbers.push(number);
        }
    }
    Ok(numbers)
}

/// The weight of each texel; `None` means 1 everywhere.
fn region_weights(region: &Region, atlas: &TexelAtlas) -> Result<Option<Vec<f32>>> {
    let each = |depth: &(dyn Fn(Vec3) -> f32 + Sync), falloff: f32| {
        Some(atlas.position.par_iter().map(|p| weight_at(depth(*p), falloff)).collect::<Vec<f32>>())
    };
    let around =
        |points: &[Vec3], radius: f32, falloff: f32| each(&|p| radius - distance_to_line(p, points), falloff);
    Ok(match region {
        Region::All => None,
        Region::Box { min, max, falloff } => {
            each(&|p| (p - *min).min_element().min((*max - p).min_element()), *falloff)
        }
        Region::Sphere { center, radius, falloff } => around(&[*center], *radius, *falloff),
        Region::Stroke { points, radius, falloff } => around(points, *radius, *falloff),
        Region::Mask(path) => Some(read_texture_mask(path, atlas.width, atlas.height)?),
    })
}

/// Distance of a point from the line through others, straight from each to the next; infinite if there are none.
fn distance_to_line(from: Vec3, points: &[Vec3]) -> f32 {
    let first = points.first().map_or(f32::INFINITY, |point| from.distance(*point));
    points.windows(2).map(|ends| distance_to_segment(from, ends[0], ends[1])).fold(first, f32::min)
}

fn distance_to_segment(from: Vec3, start: Vec3, end: Vec3) -> f32 {
    let (offset, along) = (from - start, end - start);
    let squared = along.length_squared();
    let t = if squared > 0.0 { (offset.dot(along) / squared).clamp(0.0, 1.0) } else { 0.0 };
    offset.distance(t * along)
}

/// The weight at a depth inside the boundary of the region: 0 outside, 1 from `falloff` on, smooth between.
fn weight_at(depth: f32, falloff: f32) -> f32 {
    if depth < 0.0 {
        return 0.0;
    }
    let t = if depth < falloff { depth / falloff } else { 1.0 };
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::sphere_mesh;

    /// A bent line, from its first point to the right, and then up.
    const BENT: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 2.0, 0.0)];

    #[test]
    fn a_region_sets_in_over_its_falloff() {
        assert_eq!([-0.1, 0.0, 0.2].map(|depth| weight_at(depth, 0.0)), [0.0, 1.0, 1.0]);
        assert_eq!([-0.1, 0.0, 0.1, 0.2].map(|depth| weight_at(depth, 0.2)), [0.0, 0.0, 0.5, 1.0]);
    }

    #[test]
    fn a_stroke_is_around_its_segments_and_points() {
        let found = |x: f32, y: f32, z: f32| distance_to_line(Vec3::new(x, y, z), &BENT);
        assert_eq!([found(0.5, 0.0, 0.0), found(1.0, 1.5, 0.0)], [0.0, 0.0], "on the line");
        assert_eq!([found(0.5, 0.25, 0.0), found(1.0, 1.0, -0.5)], [0.25, 0.5], "beside it");
        assert_eq!([found(-3.0, 0.0, 4.0), found(1.0, 2.5, 0.0)], [5.0, 0.5], "beyond its ends");
        assert_eq!([found(2.0, -1.0, 0.0), found(1.25, 0.0, 0.0)], [2f32.sqrt(), 0.25], "outside the bend");
        let twice = [Vec3::X, Vec3::X];
        assert_eq!(distance_to_line(Vec3::ZERO, &twice), 1.0, "a segment without length");
        assert_eq!(distance_to_line(Vec3::ZERO, &[]), f32::INFINITY);
    }

    #[test]
    fn a_stroke_of_one_point_is_a_ball() {
        let surface = Surface::new(sphere_mesh(Vec3::ZERO, 0.8).unwrap(), 32).unwrap();
        let weights = |region: Region| region_weights(&region, surface.atlas()).unwrap().unwrap();
        let (center, radius, falloff) = (Vec3::new(0.1, 0.7, 0.3), 0.5, 0.2);
        let ball = weights(Region::Sphere { center, radius, falloff });
        assert_eq!(weights(Region::Stroke { points: vec![center], radius, falloff }), ball);
        let longer = weights(Region::Stroke { points: vec![center, Vec3::Z], radius, falloff });
        assert!(longer.iter().zip(&ball).all(|(longer, ball)| longer >= ball));
        assert!(longer.iter().sum::<f32>() > 1.2 * ball.iter().sum::<f32>());
    }
}
