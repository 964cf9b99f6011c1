use super::*;
use crate::accurate::adjoint::pull_back_pair;
use crate::accurate::cubature::integrate;
use crate::accurate::narrow::is_narrow;
use crate::accurate::pair::{Pair, evaluate_pair};
use crate::accurate::point::pull_back_point;
use crate::accurate::tests::{spread, tame_case, wide_case};
use crate::brdf::Ndf;
use crate::cases::{Case, unit};
use crate::real::{add, dot, sub};
use rand::{SeedableRng, rngs::SmallRng};
use std::f64::consts::PI;

fn pair<F: Real, const ALONG: usize, const ACROSS: usize>(case: &Case, to: impl Fn(f64) -> F) -> Pair<F> {
    let three = |v: [f64; 3]| v.map(&to);
    let (point, _) = prepare_ggx_point(three(case.normal), three(case.to_viewer), to(case.roughness));
    evaluate_pair::<F, ALONG, ACROSS, GGX_TERMS>(&point, three(case.axis), to(case.sharpness))
}

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

#[test]
fn ggx_pairs_are_finite_and_their_roughness_adjoint_follows_the_sum() {
    let (normal, to_viewer) = ([0.0, 0.0, 1.0], [0.6, 0.0, 0.8]);
    let axis = [-0.48, 0.36, 0.8];
    for i in 3..=100 {
        let r = f64::from(i) / 100.0;
        let (point, derivatives) = prepare_ggx_point(normal, to_viewer, r);
        let (_, back) = pull_back_pair::<f64, 4, 3, GGX_TERMS>(&point, axis, 30.0, [0.0, 1.0, 1.0]);
        let (_, adjoint) = pull_back_point(&point, &derivatives, &back.point);
        let value = |r: f64| {
            let (point, _) = prepare_ggx_point(normal, to_viewer, r);
            let pair = evaluate_pair::<f64, 4, 3, GGX_TERMS>(&point, axis, 30.0);
            pair.constant + pair.slope
        };
        assert!(value(r).is_finite() && adjoint.is_finite());
        let narrow = |r: f64| is_narrow(&prepare_ggx_point(normal, to_viewer, r).0, axis, 30.0);
        // The sum has a step where the rule changes.
        if (0.1..0.99).contains(&r) && narrow(r * 1.001) == narrow(r * 0.999) {
            let difference = (value(r * 1.001) - value(r * 0.999)) / 0.002;
            let error = (difference - adjoint * r).abs() / (difference.abs() + value(r));
            assert!(error < 0.02, "R {r}: {difference} {}", adjoint * r);
        }
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
        coarse.push(error(pair::<f64, 3, 2>(&case, |x| x)).abs());
        fine.push(error(pair::<f64, 4, 3>(&case, |x| x)).abs());
        signed.push(error(pair::<f64, 4, 3>(&case, |x| x)));
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
            let p = pair::<f64, 3, 2>(&case, |x| x);
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
            let p = pair::<f64, 4, 3>(case, |x| x);
            0.4 * p.diffuse.value + 0.8 * p.constant + 0.3 * p.slope
        };
        let (point, derivatives) = prepare_ggx_point(case.normal, case.to_viewer, case.roughness);
        let weights = [0.4, 0.8, 0.3];
        let (_, back) = pull_back_pair::<f64, 4, 3, GGX_TERMS>(&point, case.axis, case.sharpness, weights);
        let (normal, roughness) = pull_back_point(&point, &derivatives, &back.point);
        let [tangent, bitangent, _] = point.frame;
        let across = unit(sub(tangent, case.axis.map(|x| x * dot(tangent, case.axis))));
        let moved = |v: [f64; 3], by: [f64; 3], e: f64| unit(add(v, by.map(|x| x * e)));
        let size = weighted(&case);
        let mut check = |adjoint: f64, moved: &dyn Fn(f64) -> Case| {
            let step = 1e-5;
            let difference = (weighted(&moved(step)) - weighted(&moved(-step))) / (2.0 * step);
            errors.push((difference - adjoint).abs() / (difference.abs() + size + 1e-12));
        };
        check(back.sharpness * case.sharpness, &|e| Case { sharpness: case.sharpness * (1.0 + e), ..case });
        check(roughness * case.roughness, &|e| Case { roughness: case.roughness * (1.0 + e), ..case });
        check(dot(back.axis, across), &|e| Case { axis: moved(case.axis, across, e), ..case });
        check(dot(normal, tangent), &|e| Case { normal: moved(case.normal, tangent, e), ..case });
        check(dot(normal, bitangent), &|e| Case { normal: moved(case.normal, bitangent, e), ..case });
    }
    let [median, ninetieth] = spread(errors);
    assert!(median < 1e-3 && ninetieth < 2e-2, "{median} {ninetieth}");
}

#[test]
fn single_precision_keeps_four_digits() {
    let mut rng = SmallRng::seed_from_u64(33);
    for _ in 0..2000 {
        let case = wide_case(&mut rng);
        if dot(case.normal, case.to_viewer) < 0.01 || case.sharpness > 1e5 {
            continue;
        }
        let narrowed = |v: [f64; 3]| v.map(|x| f64::from(x as f32));
        let rounded = Case {
            normal: narrowed(case.normal),
            to_viewer: narrowed(case.to_viewer),
            axis: narrowed(case.axis),
            ..case
        };
        let (exact, single) = (pair::<f64, 3, 2>(&rounded, |x| x), pair::<f32, 3, 2>(&case, |x| x as f32));
        for (exact, single) in [(exact.constant, single.constant), (exact.slope, single.slope)] {
            let bound = 1e-4 * exact + 1e-6 / case.amplitude[0];
            assert!((f64::from(single) - exact).abs() < bound, "{single} {exact} {case:?}");
        }
    }
}
