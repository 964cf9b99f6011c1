//! One SG of light, and lists of them: radiance, power, rotation, checks. The radiance of a list is
//! the sum over its lobes; it depends on the direction alone.

use crate::fibonacci::{fibonacci_axes, spacing_sharpness};
use crate::{published::Lobe, sg};
use glam::{DVec3, Quat, Vec3};
use serde::{Deserialize, Serialize};

/// Most lobes of a light.
pub const MOST_LOBES: usize = 2048;

/// Largest radiance of a light, linear: sums over lobes and their squares stay finite in `f32`. The
/// sun's disc is below 10¹⁰ in any usual unit.
pub const MAX_RADIANCE: f32 = 1e15;

/// Largest sharpness of a lobe: its width of 10⁻⁶ radians is below any pixel.
pub const MAX_SHARPNESS: f32 = 1e12;

/// One SG of distant light: radiance μ exp(λ(ω·ξ − 1)) from direction ω.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
#[serde(deny_unknown_fields)]
pub struct LightLobe {
    /// ξ, unit direction toward the light, world space.
    pub axis: Vec3,
    /// λ ≥ 0.
    pub sharpness: f32,
    /// μ ≥ 0, linear RGB radiance at the axis.
    pub amplitude: Vec3,
}

impl LightLobe {
    /// `count` equal white lobes that cover the sphere uniformly: the initialization of an unknown
    /// light.
    pub fn even(count: usize) -> Vec<Self> {
        let sharpness = spacing_sharpness(count);
        let lobe = |axis| Self { axis, sharpness, amplitude: Vec3::ONE };
        fibonacci_axes(count).into_iter().map(lobe).collect()
    }

    /// Radiance from the unit direction `omega`, linear RGB.
    pub fn radiance(&self, omega: Vec3) -> Vec3 {
        self.amplitude * sg::evaluate(omega.to_array(), self.axis.to_array(), self.sharpness)
    }

    /// Integral of the radiance over the whole sphere, linear RGB × steradians: μ 2π(1 −
    /// e^(−2λ))/λ.
    pub fn power(&self) -> DVec3 {
        self.amplitude.as_dvec3() * sg::sphere_integral(f64::from(self.sharpness))
    }
}

impl From<&LightLobe> for Lobe<f32> {
    fn from(lobe: &LightLobe) -> Self {
        Self { axis: lobe.axis.into(), sharpness: lobe.sharpness, amplitude: lobe.amplitude.into() }
    }
}

/// Sum of the lobes' radiance from the unit direction `omega`, linear RGB.
pub fn lobes_radiance(lobes: &[LightLobe], omega: Vec3) -> Vec3 {
    lobes.iter().map(|lobe| lobe.radiance(omega)).sum()
}

/// The number of lobes, the strongest first, that hold 99 % of the power of all.
pub fn lobes_in_use<'a>(lobes: impl IntoIterator<Item = &'a LightLobe>) -> usize {
    let mut powers: Vec<f64> = lobes.into_iter().map(|lobe| lobe.power().element_sum()).collect();
    powers.sort_by(|a, b| b.total_cmp(a));
    let needed = powers.iter().scan(0.99 * powers.iter().sum::<f64>(), |left, power| {
        let is_needed = *left > 0.0;
        *left -= power;
        is_needed.then_some(())
    });
    needed.count()
}

/// Integral of the lobes' radiance over the whole sphere, linear RGB × steradians.
pub fn lobes_power(lobes: &[LightLobe]) -> DVec3 {
    lobes.iter().map(LightLobe::power).sum()
}

/// The lobes rotated by `rotation`: light from direction d comes from `rotation * d` afterward.
///
/// The identity keeps every bit, so that a saved light is read back unchanged.
pub fn rotate_lobes(lobes: &[LightLobe], rotation: Quat) -> Vec<LightLobe> {
    if rotation == Quat::IDENTITY {
        return lobes.to_vec();
    }
    let turned = |lobe: &LightLobe| (rotation * lobe.axis).normalize_or(lobe.axis);
    lobes.iter().map(|lobe| LightLobe { axis: turned(lobe), ..*lobe }).collect()
}

/// The lobes with their radiance multiplied by `factor` (per channel, not negative).
pub fn scale_lobes(lobes: &[LightLobe], factor: Vec3) -> Vec<LightLobe> {
    lobes.iter().map(|lobe| LightLobe { amplitude: lobe.amplitude * factor, ..*lobe }).collect()
}

/// Checks that the lobes are a valid light.
///
/// # Errors
/// A clause that names the first lobe (counted from 0) with a zero or non-unit axis (|length − 1| >
/// 10⁻³), or a sharpness or amplitude that is negative, not finite, or above [`MAX_SHARPNESS`] or
/// [`MAX_RADIANCE`]; or says that there are no lobes, or more than [`MOST_LOBES`].
pub fn validate_lobes(lobes: &[LightLobe]) -> Result<(), String> {
    if lobes.is_empty() {
        return Err("there are no light lobes; at least one is needed".to_owned());
    }
    if lobes.len() > MOST_LOBES {
        return Err(format!("there are {} light lobes; a light has at most {MOST_LOBES}", lobes.len()));
    }
    for (i, lobe) in lobes.iter().enumerate() {
        let length = lobe.axis.length();
        if !lobe.axis.is_finite() {
            return Err(format!("lobe {i}: axis {} is not finite", lobe.axis));
        }
        if length == 0.0 {
            return Err(format!("lobe {i}: axis is zero, so it has no direction"));
        }
        if (length - 1.0).abs() > 1e-3 {
            return Err(format!("lobe {i}: axis {} has length {length}, not 1", lobe.axis));
        }
        if !(0.0..=MAX_SHARPNESS).contains(&lobe.sharpness) {
            let sharpness = lobe.sharpness;
            return Err(format!("lobe {i}: sharpness {sharpness:e} must be from 0 to {MAX_SHARPNESS:e}"));
        }
        if let Some(bad) = lobe.amplitude.to_array().into_iter().find(|a| !(0.0..=MAX_RADIANCE).contains(a)) {
            return Err(format!("lobe {i}: amplitude {bad:e} must be from 0 to {MAX_RADIANCE:e}"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lobe() -> LightLobe {
        LightLobe { axis: Vec3::X, sharpness: 5.0, amplitude: Vec3::new(1.0, 2.0, 3.0) }
    }

    #[test]
    fn lobes_in_use_are_those_with_the_power() {
        let lobe = |part: f32| LightLobe { axis: Vec3::Z, sharpness: 5.0, amplitude: Vec3::splat(part) };
        let count = |parts: &[f32]| lobes_in_use(&parts.iter().map(|part| lobe(*part)).collect::<Vec<_>>());
        assert_eq!((count(&[]), count(&[0.0, 0.0]), count(&[2.0; 7])), (0, 0, 7));
        assert_eq!(count(&[0.003, 0.6, 0.003, 0.4, 0.0]), 2);
    }

    #[test]
    fn validation_names_the_lobe() {
        assert!(validate_lobes(&[lobe(), lobe()]).is_ok());
        assert!(validate_lobes(&[]).unwrap_err().contains("no light lobes"));
        let bad = [
            LightLobe { axis: Vec3::ZERO, ..lobe() },
            LightLobe { axis: Vec3::NAN, ..lobe() },
            LightLobe { axis: Vec3::splat(2.0), ..lobe() },
            LightLobe { sharpness: -1.0, ..lobe() },
            LightLobe { sharpness: f32::INFINITY, ..lobe() },
            LightLobe { sharpness: 1e38, ..lobe() },
            LightLobe { amplitude: Vec3::new(1.0, 1.0, 1e38), ..lobe() },
            LightLobe { amplitude: Vec3::new(0.0, -1.0, 0.0), ..lobe() },
            LightLobe { amplitude: Vec3::new(f32::NAN, 1.0, 0.0), ..lobe() },
        ];
        for broken in bad {
            let message = validate_lobes(&[lobe(), broken]).unwrap_err();
            assert!(message.starts_with("lobe 1: "), "{message}");
        }
        assert!(validate_lobes(&vec![lobe(); MOST_LOBES]).is_ok());
        assert!(validate_lobes(&vec![lobe(); MOST_LOBES + 1]).unwrap_err().contains("at most 2048"));
    }

    #[test]
    fn rotating_lobes_turns_their_light() {
        let turn = Quat::from_rotation_z(std::f32::consts::FRAC_PI_2);
        let turned = rotate_lobes(&[lobe()], turn);
        assert!(turned[0].axis.distance(Vec3::Y) < 1e-6);
        assert!(lobes_radiance(&turned, Vec3::Y).distance(Vec3::new(1.0, 2.0, 3.0)) < 1e-5);
    }
}
