//! Material edits: entities whose components describe what changes, how, and where; and the kernel
//! that applies one.
//!
//! An edit is an entity with an [`EditName`] (which edits belong together), an [`EditOrder`], an
//! [`EditTarget`], an [`EditAction`] and an [`EditRegion`].
//! [`show_edited`](super::shown::show_edited) applies the edits of one name to the shown material.
//!
//! An edit of the specular material inside a region splits every base material with a weight there:
//! the edited copy gets the region's part of the blend weights, so that roughness may vary over the
//! surface.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_world::material::edit::{EditAction, EditRegion, EditTarget};
//! use lobelia_world::material::edit::{MaterialState, apply_edit};
//! use lobelia_world::material::{Diffuse, SpecularBlend, SpecularLobe};
//!
//! let mut state = MaterialState {
//!     diffuse: vec![Diffuse::of_albedo(Vec3::splat(0.5)); 2],
//!     blends: vec![SpecularBlend::default(); 2],
//!     lobes: vec![Some(SpecularLobe::new(Vec3::splat(0.04), 0.4))],
//! };
//! let (half, there) = (EditAction::Scale(Vec3::splat(0.5)), EditRegion(Some([0.0, 1.0].into())));
//! apply_edit(&mut state, EditTarget::Roughness, &half, &there)?;
//! let [first, second] = [0, 1].map(|texel| state.blends[texel].roughness(state.materials()));
//! assert!((first - 0.4).abs() < 1e-6 && (second - 0.2).abs() < 1e-6);
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use super::material_source::check_numbers;
use super::{BaseMaterial, Diffuse, MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe};
use bevy_ecs::prelude::Component;
use glam::Vec3;
use lobelia_geometry::{Error, Result};
use std::sync::Arc;

/// The name of a group of edits; those of a pass of a scene file have the name of the pass.
#[derive(Component, Clone, Debug, PartialEq, Eq)]
pub struct EditName(pub String);

/// Order of an edit among those with its name: ascending.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct EditOrder(pub u32);

/// The property changed by an edit.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
#[require(EditOrder, EditRegion)]
pub enum EditTarget {
    /// The diffuse albedo.
    Diffuse,
    /// The specular albedo.
    Specular,
    /// The roughness: `x` of an action's values. Results stay in `[0.03, 1]`.
    Roughness,
}

/// How it changes; colors are clamped to `[0, 1]`.
#[derive(Component, Clone, Debug, PartialEq)]
pub enum EditAction {
    /// Is set to this value.
    Set(Vec3),
    /// Is multiplied by this factor.
    Scale(Vec3),
    /// old + weight (value − old).
    Blend {
        /// The value to blend with.
        value: Vec3,
        /// The weight, in `[0, 1]`.
        weight: f32,
    },
    /// Is set to one value per texel of the object; only for [`EditTarget::Diffuse`].
    PerTexel(Arc<[Vec3]>),
}

impl EditAction {
    fn apply(&self, old: Vec3, texel: usize) -> Vec3 {
        match self {
            Self::Set(value) => *value,
            Self::Scale(factor) => old * *factor,
            Self::Blend { value, weight } => old.lerp(*value, *weight),
            Self::PerTexel(values) => values[texel],
        }
    }

    /// The part of what was there that is left, in [0, 1].
    fn left(&self) -> f32 {
        match self {
            Self::Set(_) | Self::PerTexel(_) => 0.0,
            Self::Scale(_) => 1.0,
            Self::Blend { weight, .. } => 1.0 - weight,
        }
    }

    fn color(&self, old: Vec3, texel: usize) -> Vec3 {
        self.apply(old, texel).clamp(Vec3::ZERO, Vec3::ONE)
    }
}

/// Where: a weight in `[0, 1]` for each texel; `None` is everywhere.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct EditRegion(pub Option<Arc<[f32]>>);

/// The columns that an edit changes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaterialState {
    /// Diffuse material per texel.
    pub diffuse: Vec<Diffuse>,
    /// Blend weights per texel.
    pub blends: Vec<SpecularBlend>,
    /// The specular lobe of each base material, by number; unused numbers are `None`.
    pub lobes: Vec<Option<SpecularLobe>>,
}

impl MaterialState {
    /// Sets the lobe of base material `number`.
    ///
    /// # Errors
    /// If the number is out of range or already used.
    pub fn set_lobe(&mut self, number: BaseMaterial, lobe: SpecularLobe) -> Result<()> {
        let number = number.0 as usize;
        let used = self.lobes.get(number).is_some_and(Option::is_some).then_some(number);
        check_numbers(used.into_iter().chain([number]))?;
        self.lobes.resize(self.lobes.len().max(number + 1), None);
        self.lobes[number] = Some(lobe);
        Ok(())
    }

    /// The base materials, with their numbers.
    pub fn materials(&self) -> impl Iterator<Item = (usize, &SpecularLobe)> + Clone {
        self.lobes.iter().enumerate().filter_map(|(number, lobe)| Some((number, lobe.as_ref()?)))
    }

    /// The base material of the whole object, if it has only one and its weight is one at every
    /// texel.
    pub fn uniform(&self) -> Option<SpecularLobe> {
        let [Some(one)] = self.lobes[..] else { return None };
        self.blends.iter().all(|blend| *blend == SpecularBlend::default()).then_some(one)
    }
}

/// Applies one edit.
///
/// # Errors
/// If the object would need more than [`MAX_SPECULAR_LOBES`] base materials, or the edit has
/// another number of texels than the object.
pub fn apply_edit(
    state: &mut MaterialState,
    target: EditTarget,
    action: &EditAction,
    region: &EditRegion,
) -> Result<()> {
    let region = region.0.as_deref();
    let values = if let EditAction::PerTexel(values) = action { Some(values.len()) } else { None };
    for count in [values, region.map(<[f32]>::len)].into_iter().flatten() {
        if count != state.diffuse.len() {
            let problem = format!("it has {count} texels, and the object has {}", state.diffuse.len());
            return Err(Error::run("an edit", problem));
        }
    }
    match target {
        EditTarget::Diffuse => {
            for (i, texel) in state.diffuse.iter_mut().enumerate() {
                let weight = region.map_or(1.0, |r| r[i]);
                texel.tilt *= 1.0 - weight * (1.0 - action.left());
                // What is seen along the surface is edited like what is seen straight on.
                let along = texel.along();
                texel.albedo = texel.albedo.lerp(action.color(texel.albedo, i), weight);
                texel.sheen = along.lerp(action.color(along, i), weight) - texel.albedo;
            }
            Ok(())
        }
        EditTarget::Specular => {
            edit_lobes(state, region, |lobe| SpecularLobe { albedo: action.color(lobe.albedo, 0), ..lobe })
        }
        EditTarget::Roughness => edit_lobes(state, region, |lobe| SpecularLobe {
            roughness: action.apply(Vec3::splat(lobe.roughness), 0).x.clamp(0.03, 1.0),
            ..lobe
        }),
    }
}

/// Edits the base materials; inside a region, copies of them that get its part of the blend
/// weights.
fn edit_lobes(
    state: &mut MaterialState,
    region: Option<&[f32]>,
    edit: impl Fn(SpecularLobe) -> SpecularLobe,
) -> Result<()> {
    let Some(region) = region else {
        state.lobes.iter_mut().flatten().for_each(|lobe| *lobe = edit(*lobe));
        return Ok(());
    };
    let before = state.lobes.len();
    for k in 0..before {
        let Some(lobe) = state.lobes[k] else { continue };
        let lives_there = state.blends.iter().zip(region).any(|(b, r)| *r > 0.0 && b.0[k] > 0.0);
        let edited = edit(lobe);
        if !lives_there || edited == lobe {
            continue;
        }
        // A material that lies in the region with all its weight needs no copy, such as that of an
        // earlier edit of the region.
        if state.blends.iter().zip(region).all(|(b, r)| *r >= 1.0 || b.0[k] <= 0.0) {
            state.lobes[k] = Some(edited);
            continue;
        }
        // Lobes that become equal share a copy.
        let same = state.lobes[before..].iter().position(|lobe| *lobe == Some(edited));
        let copy = same.map_or(state.lobes.len(), |same| before + same);
        if copy == MAX_SPECULAR_LOBES {
            let problem =
                format!("the edits need more than {MAX_SPECULAR_LOBES} different specular materials");
            return Err(Error::usage(problem, "Let some regions share their roughness and specular albedo."));
        }
        state.lobes.extend(same.is_none().then_some(Some(edited)));
        for (blend, share) in state.blends.iter_mut().zip(region) {
            blend.0[copy] += blend.0[k] * share;
            blend.0[k] *= 1.0 - share;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_sg::brdf::Ndf;

    fn state() -> MaterialState {
        let (sheen, tilt) = (Vec3::splat(0.25), Vec3::new(0.5, 0.0, -0.25));
        MaterialState {
            diffuse: vec![Diffuse { albedo: Vec3::splat(0.5), sheen, tilt }; 3],
            blends: vec![SpecularBlend::default(); 3],
            lobes: vec![Some(SpecularLobe::new(Vec3::splat(0.3), 0.4))],
        }
    }

    fn region(weights: &[f32]) -> EditRegion {
        EditRegion(Some(weights.into()))
    }

    #[test]
    fn a_region_edit_of_roughness_splits_the_material_and_leaves_the_rest() -> Result<()> {
        let mut state = state();
        let action = EditAction::Scale(Vec3::splat(0.5));
        apply_edit(&mut state, EditTarget::Roughness, &action, &region(&[0.0, 0.25, 1.0]))?;
        let roughness: Vec<f32> = state.materials().map(|(_, lobe)| lobe.roughness).collect();
        assert_eq!(roughness, [0.4, 0.2]);
        assert_eq!(state.blends[1].0[..2], [0.75, 0.25]);
        assert_eq!(state.blends[2].0[..2], [0.0, 1.0]);
        assert!(state.blends.iter().all(|b| (b.0.iter().sum::<f32>() - 1.0).abs() < 1e-6));
        Ok(())
    }

    #[test]
    fn materials_that_a_region_edit_makes_equal_become_one() -> Result<()> {
        let mut state = state();
        let second = state.lobes[0].map(|lobe| SpecularLobe { roughness: 0.6, ..lobe });
        state.lobes.push(second);
        state.blends.iter_mut().for_each(|blend| blend.0[..2].copy_from_slice(&[0.25, 0.75]));
        let action = EditAction::Set(Vec3::splat(0.2));
        apply_edit(&mut state, EditTarget::Roughness, &action, &region(&[0.0, 0.5, 1.0]))?;
        assert_eq!(state.lobes.len(), 3);
        assert_eq!(state.blends[1].0[..3], [0.125, 0.375, 0.5]);
        assert_eq!(state.blends[2].0[..3], [0.0, 0.0, 1.0]);
        Ok(())
    }

    #[test]
    fn several_edits_of_a_region_with_a_hard_edge_need_one_copy() -> Result<()> {
        let mut state = state();
        let sharp = region(&[0.0, 0.0, 1.0]);
        for (target, value) in [(EditTarget::Specular, 0.6), (EditTarget::Roughness, 0.2)] {
            apply_edit(&mut state, target, &EditAction::Set(Vec3::splat(value)), &sharp)?;
        }
        let edited =
            SpecularLobe { albedo: Vec3::splat(0.6), roughness: 0.2, ..SpecularLobe::new(Vec3::ZERO, 0.4) };
        assert_eq!(state.lobes, [Some(SpecularLobe::new(Vec3::splat(0.3), 0.4)), Some(edited)]);
        assert_eq!(state.blends[2].0[..2], [0.0, 1.0]);
        Ok(())
    }

    #[test]
    fn a_whole_object_edit_keeps_one_material() -> Result<()> {
        let mut state = state();
        state.lobes[0].iter_mut().for_each(|lobe| lobe.ndf = Ndf::Ggx);
        let action = EditAction::Blend { value: Vec3::ONE, weight: 0.5 };
        apply_edit(&mut state, EditTarget::Specular, &action, &EditRegion(None))?;
        let expected = SpecularLobe { albedo: Vec3::splat(0.65), roughness: 0.4, ndf: Ndf::Ggx };
        assert_eq!(state.uniform(), Some(expected));
        Ok(())
    }

    #[test]
    fn a_number_that_nobody_has_stays_empty() -> Result<()> {
        let mut state = state();
        state.set_lobe(BaseMaterial(2), SpecularLobe::new(Vec3::splat(0.1), 0.5))?;
        let action = EditAction::Set(Vec3::splat(0.9));
        apply_edit(&mut state, EditTarget::Specular, &action, &EditRegion(None))?;
        assert_eq!(state.materials().map(|(number, _)| number).collect::<Vec<_>>(), [0, 2]);
        assert!(state.set_lobe(BaseMaterial(2), SpecularLobe::new(Vec3::ZERO, 0.5)).is_err());
        assert!(state.set_lobe(BaseMaterial(8), SpecularLobe::new(Vec3::ZERO, 0.5)).is_err());
        Ok(())
    }

    #[test]
    fn diffuse_edits_set_scale_blend_and_clamp() -> Result<()> {
        let mut state = state();
        let per_texel = EditAction::PerTexel(vec![Vec3::splat(0.2); 3].into());
        let edits = [
            (EditAction::Scale(Vec3::splat(3.0)), [1.0, 0.0, 0.0], [1.0, 0.5, 0.5]),
            (EditAction::Set(Vec3::splat(0.1)), [0.0, 1.0, 0.0], [1.0, 0.1, 0.5]),
            (per_texel, [0.0, 0.0, 0.5], [1.0, 0.1, 0.35]),
        ];
        for (action, weights, expected) in edits {
            apply_edit(&mut state, EditTarget::Diffuse, &action, &region(&weights))?;
            for (texel, expected) in state.diffuse.iter().zip(expected) {
                assert!((texel.albedo.x - expected).abs() < 1e-6, "{texel:?} {expected}");
            }
        }
        Ok(())
    }

    #[test]
    fn too_many_materials_and_texels_of_another_object_are_refused() {
        let mut state = state();
        let half = region(&[0.5; 3]);
        let result = (0..9).try_for_each(|i| {
            let action = EditAction::Set(Vec3::splat(0.1 + 0.05 * i as f32));
            apply_edit(&mut state, EditTarget::Roughness, &action, &half)
        });
        assert!(result.is_err_and(|e| e.to_string().contains("more than 8")));
        let action = EditAction::Set(Vec3::ZERO);
        let result = apply_edit(&mut state, EditTarget::Diffuse, &action, &region(&[1.0; 4]));
        assert!(result.is_err_and(|e| e.to_string().contains("4 texels")));
    }
}
