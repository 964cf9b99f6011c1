//! Placement of the lobes of an unknown light: few in dark regions, many in bright ones.
//!
//! The initialization begins with uniformly distributed lobes. Once their amplitudes are known, lobes with very little power are
//! moved to resolve the bright parts: like split and merge in [`fit_map`](crate::light::map_fit), with
//! photographs in place of the map.

use crate::light::LightLobe;
use crate::math::color::luminance;
use crate::math::sg::sphere_integral;
use glam::Vec3;

/// A lobe may be moved if its power is below this fraction of the mean power.
const FAINT: f32 = 0.25;
/// Most lobes that are moved at a time, as a fraction of all.
const MOST: f32 = 0.25;
/// A lobe sharper than this is not split, because photographs do not resolve more.
const SHARPEST: f32 = 400.0;

/// Removes up to a quarter of the lobes, the faintest, and for each splits one of the brightest in two; the total power stays the same.
///
/// A lobe of sharpness λ becomes two of sharpness 2λ, half a standard deviation (1/√λ) to either side on a great circle, so
/// that together they are as wide as the original.
pub(crate) fn move_lobes_to_the_light(lobes: &mut [LightLobe]) {
    let total: f32 = lobes.iter().map(power).sum();
    if total <= 0.0 || total.is_nan() {
        return;
    }
    let faint = FAINT * total / lobes.len() as f32;
    for turn in 0..(lobes.len() as f32 * MOST) as usize {
        let by_power = |a: &usize, b: &usize| power(&lobes[*a]).total_cmp(&power(&lobes[*b]));
        let weakest = (0..lobes.len()).min_by(by_power);
        let strongest = (0..lobes.len()).filter(|i| lobes[*i].sharpness <= SHARPEST).max_by(by_power);
        let (Some(weakest), Some(strongest)) = (weakest, strongest) else { return };
        if power(&lobes[weakest]) > faint || power(&lobes[strongest]) < 2.0 * faint {
            return;
        }
        let (one, other) = halves(&lobes[strongest], turn);
        lobes[strongest] = one;
        lobes[weakest] = other;
    }
}

/// Luminance of the amplitude times the integral over the sphere.
fn power(lobe: &LightLobe) -> f32 {
    luminance(lobe.amplitude) * integral(lobe.sharpness)
}

fn integral(sharpness: f32) -> f32 {
    sphere_integral(f64::from(sharpness)) as f32
}

/// Two lobes in place of one; `turn` varies the direction of the split.
fn halves(lobe: &LightLobe, turn: usize) -> (LightLobe, LightLobe) {
    let (across, along) = lobe.axis.any_orthonormal_pair();
    let (sin, cos) = (turn as f32 * 2.4).sin_cos();
    let apart = (across * cos + along * sin) * (0.5 / lobe.sharpness.max(1.0).sqrt());
    let sharpness = 2.0 * lobe.sharpness;
    let amplitude = lobe.amplitude * (0.5 * integral(lobe.sharpness) / integral(sharpness));
    let half = |axis: Vec3| LightLobe { axis: axis.normalize(), sharpness, amplitude };
    (half(lobe.axis + apart), half(lobe.axis - apart))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::fibonacci::{fibonacci_axes, spacing_sharpness};

    #[test]
    fn faint_lobes_go_to_the_bright_side_and_power_stays() {
        let sharpness = spacing_sharpness(64);
        let bright = |axis: Vec3| if axis.y > 0.8 { 1.0 } else { 1e-3 };
        let lobe = |axis| LightLobe { axis, sharpness, amplitude: Vec3::splat(bright(axis)) };
        let mut lobes: Vec<LightLobe> = fibonacci_axes(64).into_iter().map(lobe).collect();
        let before: f32 = lobes.iter().map(power).sum();
        let shining = |lobes: &[LightLobe]| lobes.iter().filter(|l| l.amplitude.x > 0.1).count();
        let many = shining(&lobes);
        move_lobes_to_the_light(&mut lobes);
        assert_eq!(shining(&lobes), many + 16);
        assert!(lobes.iter().all(|l| l.amplitude.x < 0.1 || l.axis.y > 0.6));
        let after: f32 = lobes.iter().map(power).sum();
        assert!((after / before - 1.0).abs() < 0.02, "{before} {after}");
        assert!(lobes.iter().all(|l| (l.axis.length() - 1.0).abs() < 1e-5 && l.amplitude.is_finite()));
    }

    #[test]
    fn an_even_or_dark_light_is_left_alone() {
        for amplitude in [Vec3::ZERO, Vec3::ONE] {
            let lobe = |axis| LightLobe { axis, sharpness: 20.0, amplitude };
            let lobes: Vec<LightLobe> = fibonacci_axes(32).into_iter().map(lobe).collect();
            let mut moved = lobes.clone();
            move_lobes_to_the_light(&mut moved);
            assert_eq!(moved, lobes);
        }
    }
}
