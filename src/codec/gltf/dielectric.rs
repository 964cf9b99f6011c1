//! The dielectric of glTF that reflects as much as a specular lobe of this crate.
//!
//! glTF's lobe has other shadowing, another Fresnel curve, and dims the diffuse part. With E(c) the reflectance of a
//! lobe seen at the cosine c = n·v ([`reflectance`](crate::math::reflectance)), of the lobe here E_s, of glTF's F0·A + F90·B:
//!
//! - F0 (per channel) and F90 (one for all) minimize ∫ (F0·A + F90·B − E_s)² 2c dc over the channels, with 0 ≤ F0 ≤ F90 ≤ 1, as
//!   `KHR_materials_specular` has it. Both are linear in E_s, and so a blend of base materials is fitted as a whole.
//! - What glTF leaves to the diffuse part is the mean of 1 − max E over the hemisphere, and the base color is the albedo divided
//!   by that share.
//! - The roughness stays.

use crate::material::SpecularLobe;
use crate::math::brdf::Facets;
use crate::math::reflectance::{ANGLES, cosine, gltf_reflectance, specular_reflectance, weight};
use glam::Vec3;

/// The specular part of a dielectric in glTF, and what it leaves to the diffuse part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dielectric {
    /// F0, reflectance at normal incidence, linear RGB.
    pub f0: Vec3,
    /// F90, reflectance along the surface, not below F0.
    pub f90: f32,
    /// The part of diffuse light that is left, a mean over the hemisphere.
    pub diffuse_share: f32,
}

/// Reflectances of a specular lobe at the tabulated cosines: `constant` + `slope`·s.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LobeReflectance {
    constant: [f32; ANGLES],
    slope: [f32; ANGLES],
}

impl LobeReflectance {
    /// Those of a lobe, whatever its albedo is.
    pub fn of(lobe: &SpecularLobe) -> Self {
        let facets = Facets { ndf: lobe.ndf, roughness: f64::from(lobe.roughness) };
        let pairs: [_; ANGLES] = std::array::from_fn(|i| specular_reflectance(facets, cosine(i)));
        Self {
            constant: pairs.map(|(constant, _)| constant as f32),
            slope: pairs.map(|(_, slope)| slope as f32),
        }
    }

    /// Adds the reflectance for the specular albedo `albedo`, times `share`, to `sum`.
    pub fn add(&self, albedo: Vec3, share: f32, sum: &mut [Vec3; ANGLES]) {
        for (sum, (constant, slope)) in sum.iter_mut().zip(self.constant.iter().zip(&self.slope)) {
            *sum += (albedo * *slope + *constant) * share;
        }
    }
}

/// Reflectances of glTF's lobe at the tabulated cosines, F0·A + F90·B.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GltfReflectance {
    a: [f32; ANGLES],
    b: [f32; ANGLES],
}

impl GltfReflectance {
    /// Those of a `roughnessFactor`.
    pub fn of(roughness: f32) -> Self {
        let pairs: [_; ANGLES] = std::array::from_fn(|i| gltf_reflectance(f64::from(roughness), cosine(i)));
        Self { a: pairs.map(|(a, _)| a as f32), b: pairs.map(|(_, b)| b as f32) }
    }

    /// Those between two, at `t` from `self` (0) to `other` (1).
    fn toward(&self, other: &Self, t: f32) -> Self {
        let mix = |x: &[f32; ANGLES], y: &[f32; ANGLES]| std::array::from_fn(|i| x[i] + (y[i] - x[i]) * t);
        Self { a: mix(&self.a, &other.a), b: mix(&self.b, &other.b) }
    }

    /// The dielectric whose reflectance is nearest to `target`; `f90` is F90 where a format gives no choice.
    pub fn fit(&self, target: &[Vec3; ANGLES], f90: Option<f32>) -> Dielectric {
        let (aa, ab, bb) = (dot(&self.a, &self.a), dot(&self.a, &self.b), dot(&self.b, &self.b));
        let (on_a, on_b) = (project(&self.a, target), project(&self.b, target));
        let mean = |v: Vec3| v.element_sum() / 3.0;
        let free = (mean(on_b) * aa - mean(on_a) * ab) / (aa * bb - ab * ab).max(f32::MIN_POSITIVE);
        let mut f90 = f90.unwrap_or(free).clamp(0.0, 1.0);
        let f0_beside = |f90: f32| (on_a - f90 * ab) / aa;
        if f0_beside(f90).max_element() > f90 {
            // The strongest channel is then the same at all angles.
            f90 = ((on_a + on_b).max_element() / (aa + 2.0 * ab + bb)).clamp(0.0, 1.0);
        }
        let f0 = f0_beside(f90).clamp(Vec3::ZERO, Vec3::splat(f90));
        Dielectric { f0, f90, diffuse_share: self.diffuse_share(f0, f90) }
    }

    /// The specular albedo with which a lobe reflects as much as glTF's with this F0 and F90: inverse of [`Self::fit`].
    pub fn specular_albedo(&self, f0: Vec3, f90: f32, lobe: &LobeReflectance) -> Vec3 {
        let (aa, ab, bb) = (dot(&self.a, &self.a), dot(&self.a, &self.b), dot(&self.b, &self.b));
        let (constant_a, slope_a) = (dot(&self.a, &lobe.constant), dot(&self.a, &lobe.slope));
        let (constant_b, slope_b) = (dot(&self.b, &lobe.constant), dot(&self.b, &lobe.slope));
        let channel = |f0: f32| {
            let flat = f90 > 0.0 && f0 > 0.999 * f90;
            let (reflected, constant, slope) = if flat {
                (f90 * (aa + 2.0 * ab + bb), constant_a + constant_b, slope_a + slope_b)
            } else {
                (f0 * aa + f90 * ab, constant_a, slope_a)
            };
            ((reflected - constant) / slope).clamp(0.0, 1.0)
        };
        Vec3::from_array(f0.to_array().map(channel))
    }

    /// The mean over the hemisphere of 1 − E, in the channel that reflects most.
    pub fn diffuse_share(&self, f0: Vec3, f90: f32) -> f32 {
        let reflected = |i: usize| f0.max_element() * self.a[i] + f90 * self.b[i];
        (1.0 - (0..ANGLES).map(|i| reflected(i) * weight(i) as f32).sum::<f32>()).clamp(0.01, 1.0)
    }
}

/// The sum over angles of the product, weighted as means over the hemisphere are.
fn dot(x: &[f32; ANGLES], y: &[f32; ANGLES]) -> f32 {
    (0..ANGLES).map(|i| x[i] * y[i] * weight(i) as f32).sum()
}

fn project(x: &[f32; ANGLES], target: &[Vec3; ANGLES]) -> Vec3 {
    (0..ANGLES).map(|i| target[i] * (x[i] * weight(i) as f32)).sum()
}

/// glTF's reflectances for any roughness, between tabulated ones.
pub(crate) struct GltfTable(Vec<GltfReflectance>);

/// Steps of roughness in a table.
const STEPS: usize = 48;

impl Default for GltfTable {
    fn default() -> Self {
        Self((0..=STEPS).map(|i| GltfReflectance::of((i as f32 / STEPS as f32).max(0.01))).collect())
    }
}

impl GltfTable {
    /// The reflectances of a roughness.
    pub fn at(&self, roughness: f32) -> GltfReflectance {
        let place = roughness.clamp(0.0, 1.0) * STEPS as f32;
        let below = (place as usize).min(STEPS - 1);
        self.0[below].toward(&self.0[below + 1], place - below as f32)
    }
}

/// glTF's reflectances of one roughness, and the dielectric that is nearest to a lobe.
#[cfg(test)]
pub(crate) fn dielectric_of(lobe: &SpecularLobe) -> Dielectric {
    let mut target = [Vec3::ZERO; ANGLES];
    LobeReflectance::of(lobe).add(lobe.albedo, 1.0, &mut target);
    GltfReflectance::of(lobe.roughness).fit(&target, None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::brdf::Ndf;

    /// Albedo of the diffuse part in these tests.
    const DIFFUSE: f32 = 0.4;

    /// What the surface here and its dielectric reflect in all at each cosine.
    fn totals(lobe: &SpecularLobe) -> [(f32, f32); ANGLES] {
        let (ours, theirs) = (LobeReflectance::of(lobe), GltfReflectance::of(lobe.roughness));
        let found = dielectric_of(lobe);
        std::array::from_fn(|i| {
            let specular = found.f0.x * theirs.a[i] + found.f90 * theirs.b[i];
            let here = DIFFUSE + ours.constant[i] + ours.slope[i] * lobe.albedo.x;
            (here, DIFFUSE / found.diffuse_share * (1.0 - specular) + specular)
        })
    }

    fn lobes() -> impl Iterator<Item = SpecularLobe> {
        let roughness = [0.1_f32, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9];
        let albedos = [0.02_f32, 0.05, 0.1, 0.2, 0.3];
        let each = move |roughness| albedos.map(|s| SpecularLobe::new(Vec3::splat(s), roughness));
        let sg = roughness.into_iter().flat_map(each);
        sg.flat_map(|lobe| [lobe, SpecularLobe { ndf: Ndf::Ggx, ..lobe }])
    }

    #[test]
    fn a_dielectric_reflects_as_much_as_its_lobe() {
        for lobe in lobes() {
            let totals = totals(&lobe);
            let mean = |pick: fn((f32, f32)) -> f32| -> f32 {
                (0..ANGLES).map(|i| pick(totals[i]) * weight(i) as f32).sum()
            };
            // All that is reflected over the hemisphere, as the slopes of an object add up in a picture.
            let ratio = mean(|t| t.1) / mean(|t| t.0);
            assert!((ratio - 1.0).abs() < 0.01, "{lobe:?}: {ratio}");
            // At single angles one base color cannot follow glTF's diffuse part, which falls as E rises.
            // With GGX's shadowing more is reflected along the surface, and there is more to follow.
            let most = match (lobe.ndf, lobe.albedo.x > 0.1) {
                (_, true) => 0.09,
                (Ndf::Sg, false) => 0.045,
                (Ndf::Ggx, false) => 0.055,
            };
            for i in (0..ANGLES).filter(|i| cosine(*i) > 0.4) {
                let (here, there) = totals[i];
                assert!((there / here - 1.0).abs() < most, "{lobe:?} at {}: {there} for {here}", cosine(i));
            }
        }
    }

    #[test]
    fn a_lobe_comes_back() {
        for lobe in lobes().filter(|lobe| lobe.ndf == Ndf::Sg) {
            let colored = SpecularLobe { albedo: lobe.albedo * Vec3::new(1.0, 0.7, 0.5), ..lobe };
            let found = dielectric_of(&colored);
            let gltf = GltfReflectance::of(colored.roughness);
            let back = gltf.specular_albedo(found.f0, found.f90, &LobeReflectance::of(&colored));
            assert!(back.distance(colored.albedo) < 2e-3, "{colored:?}: {back} {found:?}");
        }
    }

    #[test]
    fn f90_is_never_below_f0_and_may_be_given() {
        for lobe in lobes() {
            let found = dielectric_of(&lobe);
            assert!(found.f0.min_element() >= 0.0 && found.f0.max_element() <= found.f90 && found.f90 <= 1.0);
            let mut target = [Vec3::ZERO; ANGLES];
            LobeReflectance::of(&lobe).add(lobe.albedo, 1.0, &mut target);
            assert_eq!(GltfReflectance::of(lobe.roughness).fit(&target, Some(1.0)).f90, 1.0);
        }
    }

    #[test]
    fn a_table_is_near_what_it_tabulates() {
        let table = GltfTable::default();
        for roughness in [0.05, 0.13, 0.31, 0.77, 1.0] {
            let (near, exact) = (table.at(roughness), GltfReflectance::of(roughness));
            let worst =
                (0..ANGLES).map(|i| (near.a[i] - exact.a[i]).abs().max((near.b[i] - exact.b[i]).abs()));
            assert!(worst.fold(0.0, f32::max) < 0.01, "{roughness}");
        }
    }
}
