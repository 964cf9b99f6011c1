//! Accuracy against the cubature, adjoints against differences, behavior at the limits.

pub(super) mod cubature;

use super::diffuse::{cosine_integral, scaled_erfc};
use super::placement::{LocalLight, SG, place};
use super::point::{Mixture, OneSg};
use super::smooth::pair_smoothness;
use super::specular::{PointTermsView, node};
use super::*;
use crate::cases::{Case, unit};
use crate::real::{Real, add, dot, scale, sub};
use crate::{brdf::Ndf, dispatch, lanes::Lanes, lanes::MAX_LANES};
use cubature::{Integrals, integrand, integrate};
use fearless_simd::Simd;
use rand::{RngExt, SeedableRng, rngs::SmallRng};
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

pub(super) fn pair<D: Mixture<NDF>, F: Real, const NDF: usize, const ALONG: usize, const ACROSS: usize>(
    case: &Case,
    to: impl Fn(f64) -> F,
) -> Pair<F> {
    let three = |v: [f64; 3]| v.map(&to);
    let (normal, to_viewer) = (three(case.normal), three(case.to_viewer));
    let (point, _) = prepare_with_ndf::<F, D, NDF>(normal, to_viewer, to(case.roughness));
    evaluate_pair::<F, ALONG, ACROSS, NDF>(&point, three(case.axis), to(case.sharpness))
}

fn quality(case: &Case, quality: Quality) -> Integrals {
    let p = match quality {
        Quality::Default => pair::<OneSg, f64, 1, 3, 2>(case, |x| x),
        Quality::High => pair::<OneSg, f64, 1, 4, 3>(case, |x| x),
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

/// The nodes that the kernel uses for a case, weighted so that Σ weight·integrand is the kernel's
/// sum.
fn frozen(case: &Case) -> Frozen {
    let (point, _) = prepare_point(case.normal, case.to_viewer, case.roughness);
    let light = LocalLight { axis: point.in_frame(case.axis), sharpness: case.sharpness };
    let (view, ndf) = (PointTermsView::new(&point), &point.ndf[0]);
    let placement = place::<f64, SG>(point.view, ndf, &light);
    let mut nodes = vec![];
    let placed = placement.nodes::<3, 2>();
    for row in &placed.rows {
        for column in placed.columns {
            let node = node::<f64, SG>(&view, ndf, &light, &placement, row, column);
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

/// A name, an adjoint's prediction of the objective's derivative, and the case moved by a number
/// along an input.
type Move<'a> = (&'static str, f64, Box<dyn Fn(f64) -> Case + 'a>);

/// The derivative of diffuse·d + constant·a + slope·b along every kind of move, given the weights;
/// the axis also moves toward the normal if asked to.
pub(super) fn moves<D: Mixture<NDF>, const NDF: usize, const ALONG: usize, const ACROSS: usize>(
    case: &Case,
    weights: [f64; 3],
    axis_rises: bool,
) -> Vec<Move<'_>> {
    let (point, derivatives) = prepare_with_ndf::<f64, D, NDF>(case.normal, case.to_viewer, case.roughness);
    let (_, back) = pull_back_pair::<f64, ALONG, ACROSS, NDF>(&point, case.axis, case.sharpness, weights);
    let (normal, roughness) = pull_back_point(&point, &derivatives, &back.point);
    let [tangent, bitangent, up] = point.frame;
    let sharper = |e: f64| Case { sharpness: case.sharpness * (1.0 + e), ..*case };
    let rougher = |e: f64| Case { roughness: case.roughness * (1.0 + e), ..*case };
    let mut moves: Vec<Move<'_>> = vec![
        ("sharpness", back.sharpness * case.sharpness, Box::new(sharper)),
        ("roughness", roughness * case.roughness, Box::new(rougher)),
    ];
    for way in [tangent, bitangent] {
        let moved = move |e| Case { normal: unit(add(case.normal, scale(way, e))), ..*case };
        moves.push(("normal", dot(normal, way), Box::new(moved)));
    }
    for way in [tangent, up].into_iter().take(if axis_rises { 2 } else { 1 }) {
        let across = unit(sub(way, scale(case.axis, dot(way, case.axis))));
        let moved = move |e| Case { axis: unit(add(case.axis, scale(across, e))), ..*case };
        moves.push(("axis", dot(back.axis, across), Box::new(moved)));
    }
    moves
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
        let nodes = frozen(&case);
        let [a, b] = [0.8, 0.3];
        let value =
            |case: &Case| frozen_sum(&nodes, case).iter().zip([a, b]).map(|(s, w)| s * w).sum::<f64>();
        // Nodes within a step of the horizon would switch off.
        let low = nodes.iter().any(|(omega, _)| dot(*omega, case.normal) < 1e-4);
        if value(&case) * case.amplitude[0] < 1e-6 || low {
            continue;
        }
        for (name, adjoint, moved) in moves::<OneSg, 1, 3, 2>(&case, [0.0, a, b], false) {
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
        for (_, adjoint, moved) in moves::<OneSg, 1, 4, 3>(&case, [0.0, 0.8, 0.3], false) {
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
        for (difference, adjoint) in [(by_l, at.by_sharpness * l), (by_c, at.by_cosine)] {
            let bound = 1e-4 * difference.abs() + 1e-4 * size;
            assert!((difference - adjoint).abs() < bound, "{l} {c} {difference} {adjoint}");
        }
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
            value.store(&mut stored);
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
        let single = pair::<OneSg, f32, 1, 3, 2>(case, |x| x as f32);
        let single = [single.diffuse.value, single.constant, single.slope].map(f64::from);
        for i in 0..3 {
            let bound = 1e-4 * exact[i] + 1e-6 / case.amplitude[0];
            let off = [single[i], f64::from(lanes[i])].map(|found| (found - exact[i]).abs());
            assert!(off[0] < bound && off[1] < 2.0 * bound, "{i}: {off:?} from {} {case:?}", exact[i]);
        }
    }
}

#[inline(always)]
fn quick_all<S: Simd>(simd: S, values: &mut [f32]) {
    for chunk in values.chunks_exact_mut(Lanes::<S>::LEN) {
        Lanes::load(simd, chunk).quick_rsqrt().store(chunk);
    }
}

#[test]
fn quick_roots_are_within_their_stated_error() {
    let values: Vec<f32> = (0..16_000).map(|i| 10f32.powf(-18.0 + 36.0 * i as f32 / 16_000.0)).collect();
    let mut out = values.clone();
    dispatch!(simd => quick_all(simd, &mut out));
    for (x, found) in values.iter().zip(out) {
        assert!((f64::from(found) * f64::from(*x).sqrt() - 1.0).abs() < 1e-5, "1/√{x} = {found}");
    }
}
