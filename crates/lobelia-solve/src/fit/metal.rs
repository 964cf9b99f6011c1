//! Metal beside a dielectric: what is known of the two base materials that a fit may choose by
//! itself ([`Unknowns::metal`]).
//!
//! Metal reflects at its surface, in a color of its own, and has no diffuse light beneath; a
//! dielectric such as paint, wood or glaze reflects a few percent of the light there, gray. A fit
//! that does not know this shows gold as silver under a golden light, over a diffuse layer that
//! holds what its reflections do not explain: the photographs look the same, and no other light
//! does.

use crate::fit::components::{StepRates, Unknowns};
use crate::fit::roughness::TexelPlaces;
use bevy_ecs::prelude::{Query, Res};
use glam::Vec3;
use lobelia_geometry::parallel;
use lobelia_world::material::{
    BaseMaterial, Diffuse, MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe, Texels, USUAL_ALBEDO,
};
use lobelia_world::pipeline::SystemResult;

/// The specular albedo of dielectrics: water has 0.02, glass and varnish 0.04, dense glaze 0.08.
pub const DIELECTRIC_ALBEDO: (f32, f32) = (0.02, 0.08);
/// The largest channel of a metal's specular albedo, toward which that of the brightest metal is
/// drawn: silver has 0.97, copper and gold 0.95 to 1, brass 0.9, but iron 0.56.
const USUAL_METAL: f32 = 0.95;
/// Part of the diffuse albedo beneath metal that goes with each step, times the square of the
/// metal's weight and relative to the rate of the albedo: what the bound leaves of it while the
/// weights are still undecided.
const DECAY: f32 = 0.15;
/// Specular albedos up to which a base material is a dielectric, and from which on it is metal.
const BETWEEN: (f32, f32) = (0.2, 0.4);
/// How metallic a base material must be for its brightness to tell that of the light.
const CERTAIN: f32 = 0.5;
/// Weight of the prior that what is not metal has the usual albedo, relative to that of a usual
/// metal: of metals the specular albedo is known to a fifth or so.
const ALBEDO_PRIOR: f32 = 0.15;

/// How metallic each base material is, by number; 0 of all where a fit knows nothing of metal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Metals {
    metalness: [f32; MAX_SPECULAR_LOBES],
    albedo: [Vec3; MAX_SPECULAR_LOBES],
}

impl Metals {
    /// Collects the metals of these base materials.
    pub fn of<'a>(materials: impl IntoIterator<Item = (usize, &'a SpecularLobe)>) -> Self {
        let mut metals = Self::default();
        for (number, lobe) in materials {
            metals.metalness[number] = metalness(lobe);
            metals.albedo[number] = lobe.albedo;
        }
        metals
    }

    /// Collects the metals of a fit's base materials, if it knows of metal.
    pub fn in_fit<'a>(
        unknowns: &Unknowns,
        materials: impl IntoIterator<Item = (&'a BaseMaterial, &'a SpecularLobe)>,
    ) -> Self {
        if !unknowns.metal {
            return Self::default();
        }
        Self::of(materials.into_iter().map(|(number, lobe)| (number.0 as usize, lobe)))
    }

    /// Whether no base material is metal at all.
    pub fn are_none(&self) -> bool {
        self.metalness.iter().all(|metal| *metal == 0.0)
    }

    /// The part of a surface that is metal, in [0, 1], by the weights of its base materials.
    pub fn share(&self, weights: &[f32; MAX_SPECULAR_LOBES]) -> f32 {
        self.metalness.iter().zip(weights).map(|(metal, weight)| metal * weight).sum()
    }

    /// The part of the specular light of each channel, about, that is from metals whose specular
    /// albedo is at least `bound` in the channel: by specular albedo and weight of the base
    /// materials.
    pub fn specular_share(&self, bound: f32, weights: &[f32; MAX_SPECULAR_LOBES]) -> Vec3 {
        let (mut part, mut all) = (Vec3::ZERO, Vec3::ZERO);
        for ((metal, albedo), weight) in self.metalness.iter().zip(&self.albedo).zip(weights) {
            let counts = Vec3::select(albedo.cmpge(Vec3::splat(bound)), Vec3::ONE, Vec3::ZERO);
            part += counts * *albedo * (metal * weight);
            all += *albedo * *weight;
        }
        part / all.max(Vec3::splat(f32::MIN_POSITIVE))
    }

    /// Derivative of a prior with respect to the logarithm of the light's level, where `share` of
    /// the photographs shows metal and the rest has the mean albedo `rest`: metal is as bright as
    /// metals are, and the rest has the usual albedo. 0 without a base material that is metal.
    pub fn level_derivative(&self, share: f32, rest: f32) -> f32 {
        let metals = self.metalness.iter().zip(&self.albedo).filter(|(metal, _)| **metal >= CERTAIN);
        let most = metals.map(|(_, albedo)| albedo.max_element()).fold(0.0, f32::max);
        if most <= 0.0 {
            return 0.0;
        }
        share * (USUAL_METAL / most).ln()
            + ALBEDO_PRIOR * (1.0 - share) * (USUAL_ALBEDO / rest.max(1e-3)).ln()
    }

    /// The largest diffuse albedo of a surface: none reflects more than it receives, and metal
    /// reflects all of it at its surface.
    pub fn most_diffuse(&self, weights: &[f32; MAX_SPECULAR_LOBES]) -> f32 {
        (1.0 - self.share(weights)).clamp(0.0, 1.0)
    }
}

/// How metallic a base material is by its specular albedo, from 0 (dielectric) to 1.
pub fn metalness(lobe: &SpecularLobe) -> f32 {
    let t = ((lobe.albedo.max_element() - BETWEEN.0) / (BETWEEN.1 - BETWEEN.0)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Whether a base material with this number is a dielectric in a fit that knows of metal: all but
/// the first are.
pub(crate) fn is_dielectric(unknowns: &Unknowns, number: BaseMaterial) -> bool {
    unknowns.metal && number.0 > 0
}

/// Update: no texel keeps a diffuse albedo beneath metal: it is bound, and decays. Only where
/// blends move as well, for else nothing tells metal from the rest.
pub fn bound_diffuse_albedo(
    (unknowns, rates): (Res<Unknowns>, Res<StepRates>),
    places: Res<TexelPlaces>,
    materials: Query<(&BaseMaterial, &SpecularLobe)>,
    texels: Texels<(&mut Diffuse, &SpecularBlend)>,
) -> SystemResult {
    if !unknowns.metal || !unknowns.albedo || !unknowns.blends {
        return Ok(());
    }
    let metals = Metals::in_fit(&unknowns, materials);
    let (mut texels, blends) = texels.columns()?;
    if places.positions.len() != blends.len() {
        return Ok(());
    }
    let decay = DECAY * rates.albedo;
    parallel::for_each_row((&mut *texels, &*blends), 4096, |(texel, blend)| {
        let left = 1.0 - (decay * metals.share(&blend.0).powi(2)).min(1.0);
        let (albedo, sheen) = (texel.albedo * left, texel.sheen * left);
        (texel.albedo, texel.sheen) = within(albedo, sheen, metals.most_diffuse(&blend.0));
    });
    Ok(())
}

/// Albedo straight on and sheen with neither albedo above a bound.
fn within(albedo: Vec3, sheen: Vec3, most: f32) -> (Vec3, Vec3) {
    let most = Vec3::splat(most);
    let (straight, along) = (albedo.min(most), (albedo + sheen).min(most));
    (straight, if sheen == Vec3::ZERO { sheen } else { along - straight })
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOLD: SpecularLobe = SpecularLobe::new(Vec3::new(1.0, 0.7, 0.3), 0.2);
    const VARNISH: SpecularLobe = SpecularLobe::new(Vec3::splat(0.04), 0.2);

    fn weights(first: f32) -> [f32; MAX_SPECULAR_LOBES] {
        std::array::from_fn(|k| [first, 1.0 - first].get(k).copied().unwrap_or(0.0))
    }

    #[test]
    fn gold_is_metal_and_varnish_is_not() {
        assert_eq!((metalness(&GOLD), metalness(&VARNISH)), (1.0, 0.0));
        let dark = SpecularLobe::new(Vec3::splat(0.3), 0.2);
        assert!((metalness(&dark) - 0.5).abs() < 1e-6);
        let metals = Metals::of([(0, &GOLD), (1, &VARNISH)]);
        assert_eq!(metals.share(&weights(0.25)), 0.25);
        // A quarter of gold and three quarters of varnish: 0.25 of 0.25 + 0.03, 0.175 of 0.205,
        // 0.075 of 0.105.
        let share = metals.specular_share(0.0, &weights(0.25));
        assert!((share - Vec3::new(0.892857, 0.853659, 0.714286)).length() < 1e-5, "{share}");
        assert_eq!(metals.specular_share(0.95, &weights(0.25)), Vec3::new(share.x, 0.0, 0.0));
        assert_eq!(metals.most_diffuse(&weights(1.0)), 0.0);
        assert_eq!(Metals::default().specular_share(0.0, &weights(0.5)), Vec3::ZERO);
    }

    #[test]
    fn the_level_rests_where_metal_and_the_rest_are_usual() {
        let metals =
            |albedo: f32| Metals::of([(0, &SpecularLobe::new(Vec3::splat(albedo), 0.2)), (1, &VARNISH)]);
        assert!(metals(0.95).level_derivative(0.5, USUAL_ALBEDO).abs() < 1e-6);
        assert!(metals(0.6).level_derivative(0.5, USUAL_ALBEDO) > 0.0, "a dark metal asks for less light");
        assert!(metals(0.6).level_derivative(0.01, 0.8) < 0.0, "a little does not outweigh white paint");
        assert_eq!(metals(0.1).level_derivative(0.0, 0.8), 0.0, "two kinds of paint say nothing");
    }

    #[test]
    fn only_a_fit_that_knows_of_metal_has_some() {
        let materials = [(BaseMaterial(0), GOLD), (BaseMaterial(1), VARNISH)];
        let unknowns = |metal| Unknowns { metal, ..Unknowns::default() };
        let found = |metal| Metals::in_fit(&unknowns(metal), materials.iter().map(|(k, lobe)| (k, lobe)));
        assert_eq!(found(false), Metals::default());
        assert_eq!(found(true), Metals::of([(0, &GOLD), (1, &VARNISH)]));
        // Only the first material may be one.
        let dielectric = |metal, number| is_dielectric(&unknowns(metal), BaseMaterial(number));
        assert_eq!([dielectric(false, 1), dielectric(true, 0), dielectric(true, 1)], [false, false, true]);
    }

    #[test]
    fn neither_albedo_exceeds_its_bound() {
        let (albedo, sheen) = (Vec3::new(0.5, 0.2, 0.1), Vec3::new(-0.3, 0.3, 0.0));
        let (straight, difference) = within(albedo, sheen, 0.3);
        assert_eq!(straight, Vec3::new(0.3, 0.2, 0.1));
        assert!((straight + difference - Vec3::new(0.2, 0.3, 0.1)).length() < 1e-6);
        assert_eq!(within(albedo, Vec3::ZERO, 0.3).1, Vec3::ZERO, "no sheen stays none");
        assert_eq!(within(albedo, sheen, 1.0), (albedo, (albedo + sheen) - albedo));
    }
}
