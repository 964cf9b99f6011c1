//! Accuracy against the cubature, adjoints against differences, behavior at the limits.

use super::cubature::{Integrals, integrand, integrate};
use super::diffuse::{cosine_integral, scaled_erfc};
use super::placement::{LocalLight, SG, place};
use super::point::{prepare_point, pull_back_point};
use super::rule::across;
use super::smooth::pair_smoothness;
use super::specular::{PointTermsView, node};
use super::*;
use crate::brdf::Ndf;
use crate::cases::{Case, direction, unit};
use crate::lanes::{Lanes, MAX_LANES, dispatch};
use crate::real::{Real, add, dot, scale, sub};
use fearless_simd::Simd;
use proptest::prelude::*;
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use std::f64::consts::PI;

/// A case from the whole range of use; half of the lights near the mirror direction.
pub(super) fn wide_case(rng: &mut SmallRng) -> Case {
    let direction = |rng: &mut SmallRng| loop {
        let v: [f64; 3] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        if (0.01..1.0).contains(&dot(v, v)) {
            return unit(v);
        }
    };
    let normal = direction(rng);
    let side = direction(rng);
    let nv: f64 = rng.random_range(0.001..1.0);
    let side = unit(sub(side, scale(normal, dot(side, normal))));
    let to_viewer = add(scale(normal, nv), scale(side, (1.0 - nv * nv).sqrt()));
    let roughness: f64 = if rng.random_bool(0.5) {
        rng.random_range(0.03..1.0)
    } else {
        0.03f64.powf(rng.random_range(0.0..1.0))
    };
    let sharpness = 10f64.powf(rng.random_range(-3.0..6.0));
    let mut axis = direction(rng);
    if rng.random_bool(0.5) {
        let mirror = sub(scale(normal, 2.0 * nv), to_viewer);
        let spread = 2.0 * (1.0 / sharpness + 2.0 * roughness.powi(4)).sqrt() * rng.random_range(0.0..1.0);
        axis = unit(add(mirror, scale(axis, spread)));
    }
    let mut color = || std::array::from_fn(|_| rng.random_range(0.05..0.9));
    let (albedo, specular) = (color(), color());
    // The same flux from every lobe.
    Case {
        normal,
        to_viewer,
        axis,
        sharpness,
        amplitude: [(1.0 + sharpness) / 6.0; 3],
        albedo,
        specular,
        roughness,
    }
}

fn pair<F: Real, const ALONG: usize, const ACROSS: usize>(case: &Case, to: impl Fn(f64) -> F) -> Pair<F> {
    let three = |v: [f64; 3]| v.map(&to);
    let (point, _) = prepare_point(three(case.normal), three(case.to_viewer), to(case.roughness));
    evaluate_pair::<F, ALONG, ACROSS, 1>(&point, three(case.axis), to(case.sharpness))
}

fn quality(case: &Case, quality: Quality) -> Integrals {
    let p = match quality {
        Quality::Default => pair::<f64, 3, 2>(case, |x| x),
        Quality::High => pair::<f64, 4, 3>(case, |x| x),
    };
    [p.diffuse.value, p.constant, p.slope]
}

/// Median and 90th percentile.
pub(super) fn spread(mut errors: Vec<f64>) -> [f64; 2] {
    errors.sort_by(f64::total_cmp);
    [errors[errors.len() / 2], errors[errors.len() * 9 / 10]]
}

/// Specular light of the first channel.
fn glossy(case: &Case, i: Integrals) -> f64 {
    case.amplitude[0] * (i[1] + case.specular[0] * i[2])
}

#[test]
fn integrals_agree_with_the_cubature() {
    let mut rng = SmallRng::seed_from_u64(21);
    let cases: Vec<Case> = (0..400).map(|_| wide_case(&mut rng)).collect();
    let exact: Vec<Integrals> = cases.iter().map(|c| integrate(c, Ndf::Sg, 1e-6)).collect();
    for (setting, bounds) in [(Quality::Default, [0.001, 0.04]), (Quality::High, [0.0005, 0.02])] {
        let lit = cases.iter().zip(&exact).filter(|(c, e)| glossy(c, **e) > 3e-4);
        let errors = lit.map(|(c, e)| (glossy(c, quality(c, setting)) / glossy(c, *e) - 1.0).abs()).collect();
        let [median, ninetieth] = spread(errors);
        assert!(median < bounds[0] && ninetieth < bounds[1], "{setting:?}: {median} {ninetieth}");
    }
    let lit = cases.iter().zip(&exact).filter(|(c, e)| c.amplitude[0] * e[0] > 1e-3);
    let errors = lit.map(|(c, e)| (quality(c, Quality::Default)[0] / e[0] - 1.0).abs()).collect();
    let [median, ninetieth] = spread(errors);
    assert!(median < 5e-4 && ninetieth < 7e-3, "diffuse: {median} {ninetieth}");
}

/// One node of a frozen sum: a world-space direction and what it is weighted with.
type Frozen = Vec<([f64; 3], f64)>;

/// The nodes that the kernel uses for a case, weighted so that Σ weight·integrand is the kernel's sum.
fn frozen<const ALONG: usize, const ACROSS: usize>(case: &Case) -> Frozen {
    let (point, _) = prepare_point(case.normal, case.to_viewer, case.roughness);
    let light = LocalLight { axis: point.in_frame(case.axis), sharpness: case.sharpness };
    let (view, ndf) = (PointTermsView::new(&point), &point.ndf[0]);
    let placement = place::<f64, SG>(point.view, ndf, &light);
    let mut nodes = vec![];
    for i in 0..ALONG {
        let row = placement.row(ALONG, i);
        for j in 0..ACROSS {
            let (w, weight) = across(ACROSS, j);
            let node = node::<f64, SG>(&view, ndf, &light, &placement, &row, w, weight);
            let omega = unit(point.in_world([node.direction[0], node.direction[1], node.cosine]));
            let [_, constant, slope] = integrand(case, Ndf::Sg, omega);
            let value = node.over_cosine * node.cosine * ndf.scale;
            if value > 1e-200 && constant + slope > 1e-200 {
                nodes.push((omega, value / (constant + slope)));
            }
        }
    }
    nodes
}

fn frozen_sum(nodes: &Frozen, case: &Case) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for (omega, weight) in nodes {
        let [_, constant, slope] = integrand(case, Ndf::Sg, *omega);
        sums[0] += weight * constant;
        sums[1] += weight * slope;
    }
    sums
}

/// A direction in the space of inputs: a case moved by `e`, and the adjoint's prediction of the objective's derivative.
type Move<'a> = (&'static str, f64, Box<dyn Fn(f64) -> Case + 'a>);

/// The derivative of diffuse·d + constant·a + slope·b along every kind of move.
fn predicted<'a, const ALONG: usize, const ACROSS: usize>(
    case: &'a Case,
    adjoint: [f64; 3],
) -> Vec<Move<'a>> {
    let (point, derivatives) = prepare_point(case.normal, case.to_viewer, case.roughness);
    let (_, back) = pull_back_pair::<f64, ALONG, ACROSS, 1>(&point, case.axis, case.sharpness, adjoint);
    let (normal, roughness) = pull_back_point(&point, &derivatives, &back.point);
    let [tangent, bitangent, _] = point.frame;
    let across = unit(sub(tangent, scale(case.axis, dot(tangent, case.axis))));
    vec![
        (
            "sharpness",
            back.sharpness * case.sharpness,
            Box::new(|e| Case { sharpness: case.sharpness * (1.0 + e), ..*case }),
        ),
        (
            "roughness",
            roughness * case.roughness,
            Box::new(|e| Case { roughness: case.roughness * (1.0 + e), ..*case }),
        ),
        (
            "axis",
            dot(back.axis, across),
            Box::new(move |e| Case { axis: unit(add(case.axis, scale(across, e))), ..*case }),
        ),
        (
            "normal",
            dot(normal, tangent),
            Box::new(move |e| Case { normal: unit(add(case.normal, scale(tangent, e))), ..*case }),
        ),
        (
            "normal",
            dot(normal, bitangent),
            Box::new(move |e| Case { normal: unit(add(case.normal, scale(bitangent, e))), ..*case }),
        ),
    ]
}

pub(super) fn tame_case(rng: &mut SmallRng) -> Case {
    loop {
        let case = wide_case(rng);
        let nv = dot(case.normal, case.to_viewer);
        if case.roughness > 0.1 && case.sharpness < 1e4 && nv > 0.05 {
            return case;
        }
    }
}

#[test]
fn specular_adjoint_is_the_derivative_of_the_frozen_sum() {
    let mut rng = SmallRng::seed_from_u64(5);
    let mut checked = 0;
    for _ in 0..400 {
        let case = tame_case(&mut rng);
        let (point, _) = prepare_point(case.normal, case.to_viewer, case.roughness);
        if pair_smoothness(&point, case.axis, case.sharpness) > 0.0 {
            continue;
        }
        let nodes = frozen::<3, 2>(&case);
        let [a, b] = [0.8, 0.3];
        let value =
            |case: &Case| frozen_sum(&nodes, case).iter().zip([a, b]).map(|(s, w)| s * w).sum::<f64>();
        // Nodes within a step of the horizon would switch off.
        let low = nodes.iter().any(|(omega, _)| dot(*omega, case.normal) < 1e-4);
        if value(&case) * case.amplitude[0] < 1e-6 || low {
            continue;
        }
        for (name, adjoint, moved) in predicted::<3, 2>(&case, [0.0, a, b]) {
            let step = 1e-6;
            let difference = (value(&moved(step)) - value(&moved(-step))) / (2.0 * step);
            let error = (difference - adjoint).abs() / (difference.abs() + value(&case));
            assert!(error < 1e-4, "{name}: difference {difference}, adjoint {adjoint}, {case:?}");
            checked += 1;
        }
    }
    assert!(checked > 800, "{checked}");
}

#[test]
fn specular_adjoint_agrees_with_the_exact_integral() {
    let mut rng = SmallRng::seed_from_u64(6);
    let mut errors = vec![];
    for _ in 0..60 {
        let case = tame_case(&mut rng);
        let value = |case: &Case| {
            let [_, constant, slope] = integrate(case, Ndf::Sg, 1e-9);
            0.8 * constant + 0.3 * slope
        };
        let size = value(&case);
        if size * case.amplitude[0] < 1e-3 {
            continue;
        }
        for (_, adjoint, moved) in predicted::<4, 3>(&case, [0.0, 0.8, 0.3]) {
            let step = 1e-3 / (1.0 + case.sharpness).sqrt().max(case.roughness.powi(-2));
            let difference = (value(&moved(step)) - value(&moved(-step))) / (2.0 * step);
            errors.push((difference - adjoint).abs() / (difference.abs() + size));
        }
    }
    assert!(errors.len() > 100);
    let [median, ninetieth] = spread(errors);
    assert!(median < 2e-3 && ninetieth < 3e-2, "{median} {ninetieth}");
}

#[test]
fn diffuse_adjoint_is_exact() {
    let mut rng = SmallRng::seed_from_u64(9);
    for _ in 0..4000 {
        let l = 10f64.powf(rng.random_range(-3.0..6.0));
        let c: f64 = rng.random_range(-0.999..0.999);
        let at = cosine_integral(l, c);
        let step = 1e-5;
        let by_l = (cosine_integral(l * (1.0 + step), c).value - cosine_integral(l * (1.0 - step), c).value)
            / (2.0 * step);
        let narrow = step / (1.0 + l).sqrt();
        let by_c =
            (cosine_integral(l, c + narrow).value - cosine_integral(l, c - narrow).value) / (2.0 * narrow);
        let size = 2.0 * PI / (2.0 + l);
        assert!(
            (by_l - at.by_sharpness * l).abs() < 1e-4 * by_l.abs() + 1e-4 * size,
            "{l} {c} {by_l} {}",
            at.by_sharpness * l
        );
        assert!(
            (by_c - at.by_cosine).abs() < 1e-4 * by_c.abs() + 1e-4 * size,
            "{l} {c} {by_c} {}",
            at.by_cosine
        );
    }
}

#[test]
fn scaled_erfc_is_within_its_stated_error() {
    // e^(x²)·erfc(x) = 2/√π ∫ e^(−s² − 2xs) ds, by the midpoint rule on the part that matters.
    for i in 0..=60 {
        let x = 0.0005 * 1.3f64.powi(i);
        let reach = f64::min(6.0, 10.0 / x);
        let n = 20_000;
        let h = reach / f64::from(n);
        let sum: f64 =
            (0..n).map(|k| (f64::from(k) + 0.5) * h).map(|s| h * (-s * s - 2.0 * x * s).exp()).sum();
        let exact = 2.0 / PI.sqrt() * sum;
        assert!((scaled_erfc(x) / exact - 1.0).abs() < 1.2e-7, "{x}");
        assert!((f64::from(scaled_erfc(x as f32)) / exact - 1.0).abs() < 1e-6, "{x} in f32");
    }
}

#[inline(always)]
fn lanes_integrals<S: Simd>(simd: S, cases: &[Case], out: &mut [[f32; 3]]) {
    for (chunk, out) in cases.chunks_exact(Lanes::<S>::LEN).zip(out.chunks_exact_mut(Lanes::<S>::LEN)) {
        let load = |f: &dyn Fn(&Case) -> f64| {
            let values: Vec<f32> = chunk.iter().map(|c| f(c) as f32).collect();
            Lanes::load(simd, &values)
        };
        let three =
            |f: &dyn Fn(&Case) -> [f64; 3]| [load(&|c| f(c)[0]), load(&|c| f(c)[1]), load(&|c| f(c)[2])];
        let (point, _) = prepare_point(three(&|c| c.normal), three(&|c| c.to_viewer), load(&|c| c.roughness));
        let pair = evaluate_pair::<_, 3, 2, 1>(&point, three(&|c| c.axis), load(&|c| c.sharpness));
        for (i, value) in [pair.diffuse.value, pair.constant, pair.slope].into_iter().enumerate() {
            let mut stored = vec![0.0; chunk.len()];
            value.add_to(&mut stored);
            out.iter_mut().zip(stored).for_each(|(o, s)| o[i] = s);
        }
    }
}

#[test]
fn single_precision_and_lanes_keep_four_digits() {
    let mut rng = SmallRng::seed_from_u64(4);
    let wide = |rng: &mut SmallRng| loop {
        let case = wide_case(rng);
        let (point, _) = prepare_point(case.normal, case.to_viewer, case.roughness);
        // Where the rule changes, rounding decides.
        let close = pair_smoothness(&point, case.axis, case.sharpness).abs() < 1e-3 * (1.0 + case.sharpness);
        if dot(case.normal, case.to_viewer) > 0.01 && case.sharpness < 1e5 && !close {
            return case;
        }
    };
    let cases: Vec<Case> = (0..2000 / MAX_LANES * MAX_LANES).map(|_| wide(&mut rng)).collect();
    let mut lanes = vec![[0.0; 3]; cases.len()];
    dispatch!(simd => lanes_integrals(simd, &cases, &mut lanes));
    for (case, lanes) in cases.iter().zip(&lanes) {
        let narrowed = |v: [f64; 3]| v.map(|x| f64::from(x as f32));
        let rounded = Case {
            normal: narrowed(case.normal),
            to_viewer: narrowed(case.to_viewer),
            axis: narrowed(case.axis),
            ..*case
        };
        let exact = quality(&rounded, Quality::Default);
        let single = pair::<f32, 3, 2>(case, |x| x as f32);
        let single = [single.diffuse.value, single.constant, single.slope].map(f64::from);
        for i in 0..3 {
            let bound = 1e-4 * exact[i] + 1e-6 / case.amplitude[0];
            assert!((single[i] - exact[i]).abs() < bound, "{i}: {} {} {case:?}", single[i], exact[i]);
            assert!(
                (f64::from(lanes[i]) - exact[i]).abs() < 2.0 * bound,
                "lanes {i}: {} {} {case:?}",
                lanes[i],
                exact[i]
            );
        }
    }
}

#[inline(always)]
fn quick_all<S: Simd>(simd: S, values: &[f32], out: &mut [[f32; 2]]) {
    for (chunk, out) in values.chunks_exact(Lanes::<S>::LEN).zip(out.chunks_exact_mut(Lanes::<S>::LEN)) {
        let x = Lanes::load(simd, chunk);
        for (i, y) in [x.inverse(), x.quick_rsqrt()].into_iter().enumerate() {
            let mut stored = vec![0.0; chunk.len()];
            y.add_to(&mut stored);
            out.iter_mut().zip(stored).for_each(|(o, s)| o[i] = s);
        }
    }
}

#[test]
fn quick_reciprocals_and_roots_are_within_their_stated_error() {
    let values: Vec<f32> = (0..16_000).map(|i| 10f32.powf(-18.0 + 36.0 * i as f32 / 16_000.0)).collect();
    let mut out = vec![[0.0; 2]; values.len()];
    dispatch!(simd => quick_all(simd, &values, &mut out));
    for (x, [recip, rsqrt]) in values.iter().map(|x| f64::from(*x)).zip(out) {
        assert!((f64::from(recip) * x - 1.0).abs() < 1e-6, "1/{x} = {recip}");
        assert!((f64::from(rsqrt) * x.sqrt() - 1.0).abs() < 1e-5, "1/√{x} = {rsqrt}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]
    #[test]
    fn nothing_is_negative_or_not_finite(
        normal in direction(), to_viewer in direction(), axis in direction(),
        log_sharpness in -3.0f32..6.0, roughness in 0.03f32..=1.0, dark in any::<bool>(),
    ) {
        let sharpness = if dark { 0.0 } else { 10f32.powf(log_sharpness) };
        let (point, derivatives) = prepare_point(normal, to_viewer, roughness);
        let (pair, back) = pull_back_pair::<f32, 3, 2, 1>(&point, axis, sharpness, [1.0, -0.5, 0.7]);
        let again = evaluate_pair::<f32, 3, 2, 1>(&point, axis, sharpness);
        prop_assert_eq!([pair.diffuse.value, pair.constant, pair.slope], [again.diffuse.value, again.constant, again.slope]);
        prop_assert!(pair.diffuse.value >= 0.0 && pair.constant >= 0.0 && pair.slope >= 0.0);
        prop_assert!([pair.diffuse.value, pair.constant, pair.slope].iter().all(|x| x.is_finite()));
        if dot(normal, to_viewer) <= 0.0 {
            prop_assert_eq!([pair.constant, pair.slope], [0.0, 0.0]);
        }
        let (normal_adjoint, roughness_adjoint) = pull_back_point(&point, &derivatives, &back.point);
        let all = normal_adjoint.into_iter().chain(back.axis).chain([back.sharpness, roughness_adjoint]);
        for x in all {
            prop_assert!(x.is_finite(), "{:?}", back.axis);
        }
    }
}
