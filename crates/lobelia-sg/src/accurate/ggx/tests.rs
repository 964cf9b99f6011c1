use super::*;
use crate::accurate::tests::{cubature::integrate, moves, pair, spread, tame_case, wide_case};
use crate::{accurate::narrow::is_narrow, accurate::pair::Pair, cases::Case};
use rand::{SeedableRng, rngs::SmallRng};
use std::f64::consts::PI;

#[test]
fn mixture_is_within_its_stated_error_of_ggx() {
    for i in 3..=100 {
        let r = f64::from(i) / 100.0;
        let a2 = r.powi(4);
        let (lobes, _) = ggx_mixture(r);
        let (mut off, mut all) = (0.0, 0.0);
        for k in 0..20_000 {
            let t = (f64::from(k) + 0.5) / 20_000.0;
            let (x, weight) = (t.powi(4), t.powi(3));
            let cosine = 1.0 - x;
            let exact = a2 / (PI * (1.0 - (1.0 - a2) * cosine * cosine).powi(2));
            let fit: f64 = lobes.iter().map(|[l, w]| w * l / (2.0 * PI) * (-l * x).exp()).sum();
            off += (fit - exact).abs() * cosine * weight;
            all += exact * cosine * weight;
        }
        let bound = if r <= 0.5 { 0.05 } else { 0.07 };
        assert!(off / all < bound, "R {r}: {}", off / all);
    }
}

/// Three SGs and a quadrature against GGX itself and a cubature.
#[test]
fn specular_light_is_within_its_stated_error_of_ggx() {
    let mut rng = SmallRng::seed_from_u64(31);
    let (mut coarse, mut fine, mut signed) = (vec![], vec![], vec![]);
    for _ in 0..400 {
        let case = wide_case(&mut rng);
        let [_, constant, slope] = integrate(&case, Ndf::Ggx, 1e-5);
        let exact = constant + case.specular[0] * slope;
        if case.amplitude[0] * exact < 1e-3 {
            continue;
        }
        let error = |p: Pair<f64>| (p.constant + case.specular[0] * p.slope) / exact - 1.0;
        coarse.push(error(pair::<GgxSgs, f64, GGX_TERMS, 3, 2>(&case, |x| x)).abs());
        fine.push(error(pair::<GgxSgs, f64, GGX_TERMS, 4, 3>(&case, |x| x)).abs());
        signed.push(error(pair::<GgxSgs, f64, GGX_TERMS, 4, 3>(&case, |x| x)));
    }
    assert!(coarse.len() > 200, "{}", coarse.len());
    let mean = signed.iter().sum::<f64>() / signed.len() as f64;
    for (name, errors) in [("3 x 2", coarse), ("4 x 3", fine)] {
        let [median, ninetieth] = spread(errors);
        println!("{name}: {median} {ninetieth}, mean {mean}");
        assert!(median < 0.05 && ninetieth < 0.2, "{name}: {median} {ninetieth}");
    }
}

/// Lobes that are narrow against GGX have no error of its fit.
#[test]
fn narrow_lobes_are_as_exact_as_with_one_sg() {
    let mut rng = SmallRng::seed_from_u64(34);
    let mut errors = vec![];
    for _ in 0..600 {
        let case = wide_case(&mut rng);
        let (point, _) = prepare_ggx_point(case.normal, case.to_viewer, case.roughness);
        if !is_narrow(&point, case.axis, case.sharpness) {
            continue;
        }
        let [_, constant, slope] = integrate(&case, Ndf::Ggx, 1e-5);
        let exact = constant + case.specular[0] * slope;
        if case.amplitude[0] * exact > 1e-3 {
            let p = pair::<GgxSgs, f64, GGX_TERMS, 3, 2>(&case, |x| x);
            errors.push(((p.constant + case.specular[0] * p.slope) / exact - 1.0).abs());
        }
    }
    assert!(errors.len() > 100, "{}", errors.len());
    let [median, ninetieth] = spread(errors);
    assert!(median < 2e-3 && ninetieth < 4e-2, "{median} {ninetieth}");
}

#[test]
fn every_adjoint_follows_the_sum() {
    let mut rng = SmallRng::seed_from_u64(32);
    let mut errors = vec![];
    for _ in 0..300 {
        let case = tame_case(&mut rng);
        let weighted = |case: &Case| {
            let p = pair::<GgxSgs, f64, GGX_TERMS, 4, 3>(case, |x| x);
            0.4 * p.diffuse.value + 0.8 * p.constant + 0.3 * p.slope
        };
        let size = weighted(&case);
        for (_, adjoint, moved) in moves::<GgxSgs, GGX_TERMS, 4, 3>(&case, [0.4, 0.8, 0.3], false) {
            let step = 1e-5;
            let difference = (weighted(&moved(step)) - weighted(&moved(-step))) / (2.0 * step);
            errors.push((difference - adjoint).abs() / (difference.abs() + size + 1e-12));
        }
    }
    let [median, ninetieth] = spread(errors);
    assert!(median < 1e-3 && ninetieth < 2e-2, "{median} {ninetieth}");
}
