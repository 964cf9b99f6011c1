//! The rule for smooth lobes against exact moments, the cubature, and differences of it.

use super::{pair_smoothness, ring::two_nodes};
use crate::accurate::ggx::{GGX_TERMS, GgxSgs};
use crate::accurate::point::{Mixture, OneSg, prepare_with_ndf};
use crate::accurate::tests::{cubature::integrate, moves, pair, spread, wide_case};
use crate::cases::{Case, unit};
use crate::real::{dot, scale, sub};
use rand::{RngExt, SeedableRng, rngs::SmallRng};

/// The first three moments of v − t for the weight v·e^(−(v − t)²/2) on v > 0, by the trapezoidal
/// rule.
fn moments(t: f64) -> [f64; 3] {
    let (n, high) = (100_000, t.max(0.0) + 12.0);
    let h = high / f64::from(n);
    let mut sums = [0.0; 4];
    for i in 1..n {
        let v = f64::from(i) * h;
        let weight = v * (-0.5 * (v - t) * (v - t)).exp();
        for (k, sum) in sums.iter_mut().enumerate() {
            *sum += weight * (v - t).powi(k as i32);
        }
    }
    [sums[1] / sums[0], sums[2] / sums[0], sums[3] / sums[0]]
}

#[test]
fn two_nodes_have_the_moments_of_the_clipped_gaussian() {
    for t in [-3.0, -2.0, -1.0, -0.3, 0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 20.0, 90.0] {
        let (offsets, weight) = two_nodes(t);
        let exact = moments(t);
        for (k, exact) in exact.iter().enumerate() {
            let power = k as i32 + 1;
            let sum = weight * offsets[0].powi(power) + (1.0 - weight) * offsets[1].powi(power);
            assert!(
                (sum - exact).abs() < 0.02 * exact.abs().max(1.0),
                "t {t}, moment {power}: {sum} {exact}"
            );
        }
    }
}

/// A smooth case that is not in grazing view; a third are near the horizon.
fn smooth_case<D: Mixture<NDF>, const NDF: usize>(rng: &mut SmallRng) -> Case {
    loop {
        let mut case = wide_case(rng);
        case.roughness = rng.random_range(0.2..1.0);
        case.sharpness = 10f64.powf(rng.random_range(0.7..3.5));
        case.amplitude = [(1.0 + case.sharpness) / 6.0; 3];
        if rng.random_bool(0.33) {
            let height = rng.random_range(-1.5..2.0) / case.sharpness.sqrt();
            let level = sub(case.axis, scale(case.normal, dot(case.axis, case.normal) - height));
            case.axis = unit(level);
        }
        let (point, _) = prepare_with_ndf::<f64, D, NDF>(case.normal, case.to_viewer, case.roughness);
        let grazing = dot(case.normal, case.to_viewer) < 0.05;
        if !grazing && pair_smoothness(&point, case.axis, case.sharpness) > 0.0 {
            return case;
        }
    }
}

fn light_agrees<D: Mixture<NDF>, const NDF: usize>(seed: u64, bounds: [f64; 2]) {
    let mut rng = SmallRng::seed_from_u64(seed);
    let mut errors = vec![];
    while errors.len() < 200 {
        let case = smooth_case::<D, NDF>(&mut rng);
        let [_, constant, slope] = integrate(&case, D::KIND, 1e-6);
        let exact = constant + case.specular[0] * slope;
        if case.amplitude[0] * exact > 3e-4 {
            let p = pair::<D, f64, NDF, 3, 2>(&case, |x| x);
            errors.push(((p.constant + case.specular[0] * p.slope) / exact - 1.0).abs());
        }
    }
    let [median, ninetieth] = spread(errors);
    assert!(median < bounds[0] && ninetieth < bounds[1], "{median} {ninetieth}");
}

#[test]
fn light_of_smooth_lobes_agrees_with_the_cubature() {
    light_agrees::<OneSg, 1>(41, [2e-4, 4e-3]);
    light_agrees::<GgxSgs, GGX_TERMS>(42, [6e-4, 0.01]);
}

fn adjoint_agrees<D: Mixture<NDF>, const NDF: usize>(seed: u64, bounds: [f64; 2]) {
    let mut rng = SmallRng::seed_from_u64(seed);
    let mut errors = std::collections::BTreeMap::<_, Vec<f64>>::new();
    for _ in 0..40 {
        let case = smooth_case::<D, NDF>(&mut rng);
        let value = |case: &Case| {
            let [_, constant, slope] = integrate(case, D::KIND, 1e-9);
            0.8 * constant + 0.3 * slope
        };
        let size = value(&case);
        if case.amplitude[0] * size < 1e-3 {
            continue;
        }
        for (name, adjoint, moved) in moves::<D, NDF, 3, 2>(&case, [0.0, 0.8, 0.3], true) {
            let step = 1e-3 / (1.0 + case.sharpness).sqrt();
            let difference = (value(&moved(step)) - value(&moved(-step))) / (2.0 * step);
            errors.entry(name).or_default().push((difference - adjoint).abs() / (difference.abs() + size));
        }
    }
    for (name, errors) in errors {
        assert!(errors.len() > 15, "{name}: {}", errors.len());
        let [median, ninetieth] = spread(errors);
        assert!(median < bounds[0] && ninetieth < bounds[1], "{name}: {median} {ninetieth}");
    }
}

#[test]
fn adjoint_of_smooth_lobes_agrees_with_the_exact_integral() {
    adjoint_agrees::<OneSg, 1>(43, [0.004, 0.02]);
    adjoint_agrees::<GgxSgs, GGX_TERMS>(44, [0.006, 0.025]);
}
