//! Edits of a material: pure functions on the texel and lobe columns.
//!
//! An edit of the specular material inside a region splits every specular lobe that lives there: the edited copy takes
//! over the region's share of the texels' blend weights, so that gloss may differ from place to place.

use crate::error::{Error, Result};
use crate::material::{DiffuseAlbedo, MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe};
use glam::Vec3;

/// How a colour changes.
#[derive(Clone, Debug, PartialEq)]
pub enum ColorChange {
    /// Becomes this.
    Set(Vec3),
    /// Is multiplied by this.
    Scale(Vec3),
    /// old + weight (color − old).
    Blend(Vec3, f32),
    /// Becomes this, texel by texel (as many as the object has).
    PerTexel(Vec<Vec3>),
}

impl ColorChange {
    fn apply(&self, old: Vec3, texel: usize) -> Vec3 {
        let new = match self {
            Self::Set(color) => *color,
            Self::Scale(factor) => old * *factor,
            Self::Blend(color, weight) => old.lerp(*color, *weight),
            Self::PerTexel(colors) => colors[texel],
        };
        new.clamp(Vec3::ZERO, Vec3::ONE)
    }
}

/// How the roughness changes; results stay in `[0.03, 1]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ScalarChange {
    /// Becomes this.
    Set(f32),
    /// Is multiplied by this.
    Scale(f32),
    /// old + weight (value − old).
    Blend(f32, f32),
}

impl ScalarChange {
    fn apply(self, old: f32) -> f32 {
        let new = match self {
            Self::Set(value) => value,
            Self::Scale(factor) => old * factor,
            Self::Blend(value, weight) => old + weight * (value - old),
        };
        new.clamp(0.03, 1.0)
    }
}

/// What changes.
#[derive(Clone, Debug, PartialEq)]
pub enum MaterialChange {
    /// The diffuse albedo.
    Diffuse(ColorChange),
    /// The specular albedo.
    Specular(ColorChange),
    /// The roughness.
    Roughness(ScalarChange),
}

/// The columns an edit works on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaterialState {
    /// Diffuse albedo per texel.
    pub albedo: Vec<DiffuseAlbedo>,
    /// Blend weights per texel.
    pub blends: Vec<SpecularBlend>,
    /// The specular lobes.
    pub lobes: Vec<SpecularLobe>,
}

/// Applies one change where `region` (a weight in `[0, 1]` per texel; `None`: everywhere) says so.
///
/// # Errors
/// If the object would need more than [`MAX_SPECULAR_LOBES`] specular lobes.
pub fn apply_edit(state: &mut MaterialState, change: &MaterialChange, region: Option<&[f32]>) -> Result<()> {
    match change {
        MaterialChange::Diffuse(change) => {
            for (i, albedo) in state.albedo.iter_mut().enumerate() {
                let weight = region.map_or(1.0, |r| r[i]);
                albedo.0 = albedo.0.lerp(change.apply(albedo.0, i), weight);
            }
            Ok(())
        }
        MaterialChange::Specular(change) => {
            edit_lobes(state, region, |lobe| SpecularLobe { albedo: change.apply(lobe.albedo, 0), ..lobe })
        }
        MaterialChange::Roughness(change) => {
            edit_lobes(state, region, |lobe| SpecularLobe { roughness: change.apply(lobe.roughness), ..lobe })
        }
    }
}

fn edit_lobes(
    state: &mut MaterialState,
    region: Option<&[f32]>,
    edit: impl Fn(SpecularLobe) -> SpecularLobe,
) -> Result<()> {
    let Some(region) = region else {
        state.lobes.iter_mut().for_each(|lobe| *lobe = edit(*lobe));
        return Ok(());
    };
    let before = state.lobes.len();
    for k in 0..before {
        let lives_there = state.blends.iter().zip(region).any(|(b, r)| *r > 0.0 && b.0[k] > 0.0);
        let edited = edit(state.lobes[k]);
        if !lives_there || edited == state.lobes[k] {
            continue;
        }
        // Lobes that become the same one share it.
        let same = state.lobes[before..].iter().position(|lobe| *lobe == edited);
        let copy = same.map_or(state.lobes.len(), |number| before + number);
        if copy == MAX_SPECULAR_LOBES {
            return Err(Error::usage(
                format!("the edits need more than {MAX_SPECULAR_LOBES} different specular materials"),
                "Let some regions share their roughness and specular albedo.",
            ));
        }
        if same.is_none() {
            state.lobes.push(edited);
        }
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
    use crate::math::brdf::Ndf;

    fn state() -> MaterialState {
        MaterialState {
            albedo: vec![DiffuseAlbedo(Vec3::splat(0.5)); 3],
            blends: vec![SpecularBlend::default(); 3],
            lobes: vec![SpecularLobe::new(Vec3::splat(0.3), 0.4)],
        }
    }

    #[test]
    fn a_region_edit_of_gloss_splits_the_lobe_and_leaves_the_rest() -> Result<()> {
        let mut state = state();
        let change = MaterialChange::Roughness(ScalarChange::Scale(0.5));
        apply_edit(&mut state, &change, Some(&[0.0, 0.25, 1.0]))?;
        assert_eq!(state.lobes[0].roughness, 0.4);
        assert_eq!(state.lobes[1].roughness, 0.2);
        assert_eq!(state.blends[1].0[..2], [0.75, 0.25]);
        assert_eq!(state.blends[2].0[..2], [0.0, 1.0]);
        assert!(state.blends.iter().all(|b| (b.0.iter().sum::<f32>() - 1.0).abs() < 1e-6));
        Ok(())
    }

    #[test]
    fn lobes_that_a_region_edit_makes_equal_become_one() -> Result<()> {
        let mut state = state();
        state.lobes.push(SpecularLobe { roughness: 0.6, ..state.lobes[0] });
        state.blends.iter_mut().for_each(|blend| blend.0[..2].copy_from_slice(&[0.25, 0.75]));
        let change = MaterialChange::Roughness(ScalarChange::Set(0.2));
        apply_edit(&mut state, &change, Some(&[0.0, 0.5, 1.0]))?;
        assert_eq!(state.lobes.len(), 3);
        assert_eq!(state.blends[1].0[..3], [0.125, 0.375, 0.5]);
        assert_eq!(state.blends[2].0[..3], [0.0, 0.0, 1.0]);
        Ok(())
    }

    #[test]
    fn a_whole_object_edit_keeps_one_lobe() -> Result<()> {
        let mut state = state();
        state.lobes[0].ndf = Ndf::Ggx;
        apply_edit(&mut state, &MaterialChange::Specular(ColorChange::Blend(Vec3::ONE, 0.5)), None)?;
        assert_eq!(state.lobes, [SpecularLobe { albedo: Vec3::splat(0.65), roughness: 0.4, ndf: Ndf::Ggx }]);
        Ok(())
    }

    #[test]
    fn diffuse_edits_set_scale_blend_and_clamp() -> Result<()> {
        let mut state = state();
        let edits = [
            (ColorChange::Scale(Vec3::splat(3.0)), Some(vec![1.0, 0.0, 0.0]), [1.0, 0.5, 0.5]),
            (ColorChange::Set(Vec3::splat(0.1)), Some(vec![0.0, 1.0, 0.0]), [1.0, 0.1, 0.5]),
            (ColorChange::PerTexel(vec![Vec3::splat(0.2); 3]), Some(vec![0.0, 0.0, 0.5]), [1.0, 0.1, 0.35]),
        ];
        for (change, region, expected) in edits {
            apply_edit(&mut state, &MaterialChange::Diffuse(change), region.as_deref())?;
            for (albedo, expected) in state.albedo.iter().zip(expected) {
                assert!((albedo.0.x - expected).abs() < 1e-6, "{albedo:?} {expected}");
            }
        }
        Ok(())
    }

    #[test]
    fn too_many_materials_are_refused() {
        let mut state = state();
        let half = [0.5; 3];
        let result = (0..9).try_for_each(|i| {
            let change = MaterialChange::Roughness(ScalarChange::Set(0.1 + 0.05 * i as f32));
            apply_edit(&mut state, &change, Some(&half))
        });
        assert!(result.is_err_and(|e| e.to_string().contains("more than 8")));
    }
}
