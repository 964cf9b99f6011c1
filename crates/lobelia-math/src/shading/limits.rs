//! The exponent above which a lobe's specular part is negligible.

use crate::columns::LobeColumns;

/// Upper bound of the light that culling leaves out, summed over all lobes, as a fraction of the mean radiance. Measured values
/// are far lower: with 128 lobes and by the exponent alone, 0.07 % of the specular light at R = 0.1, 0.03 % at R = 0.3, 0.004 % at R = 0.5.
const CULLED: f32 = 0.1;

/// The part of that bound for lobes that are left out because of their irradiance, most of them below the horizon, where a rough
/// surface would receive light from each of them otherwise.
pub const STRICTNESS: f32 = 0.01;

/// The exponent per lobe above which its specular part is negligible: e^(−exponent)·amplitude < CULLED/lobes · mean radiance.
/// A dim lobe counts as a lobe of mean amplitude, because the gradient of its amplitude does not shrink with the amplitude.
pub fn exponent_limits(lobes: &LobeColumns) -> impl Fn(usize) -> f32 {
    let brightest = |i: usize| {
        let [r, g, b] = lobes.get(i).amplitude;
        r.max(g).max(b)
    };
    // The mean over the sphere of an SG is μ(1 − e^(−2λ))/2λ.
    let mean = |i: usize| {
        let l = f64::from(lobes.get(i).sharpness).max(1e-6);
        f64::from(brightest(i)) * -(-2.0 * l).exp_m1() / (2.0 * l)
    };
    let count = lobes.len().max(1) as f64;
    let total: f64 = (0..lobes.len()).map(mean).sum();
    let average = ((0..lobes.len()).map(|i| f64::from(brightest(i))).sum::<f64>() / count) as f32;
    let least = ((f64::from(CULLED) * total / count) as f32).max(f32::MIN_POSITIVE);
    move |i| {
        let padding = i >= lobes.len();
        if padding { f32::MIN } else { (brightest(i).max(average) / least).max(f32::MIN_POSITIVE).ln() }
    }
}
