use crate::cases::{Case, random_case, unit};
use crate::published::{evaluate_pair, prepare_point, pull_back_normal, pull_back_pair, shade_pair};
use crate::real::{add, dot, scale, sub};
use crate::sg::Lobe;
use rand::{SeedableRng, rngs::SmallRng};
use std::f64::consts::PI;

pub(crate) fn forward(case: &Case) -> ([f64; 3], [f64; 3]) {
    let lobe = Lobe { axis: case.axis, sharpness: case.sharpness, amplitude: case.amplitude };
    shade_pair(case.normal, case.to_viewer, &lobe, case.albedo, case.specular, case.roughness)
}

/// The gradient of Σ w·(diffuse, specular) by the same steps as the slice kernel.
pub(crate) fn gradient(case: &Case, wd: [f64; 3], ws: [f64; 3]) -> Case {
    let (terms, brdf) = prepare_point(case.normal, case.to_viewer, case.roughness);
    let pair = evaluate_pair(&terms, case.axis, case.sharpness);
    let m: [f64; 3] = case.specular.map(|s| brdf.constant + brdf.slope * s);
    let kd: [f64; 3] = std::array::from_fn(|c| wd[c] * case.albedo[c] / PI);
    let ks: [f64; 3] = std::array::from_fn(|c| ws[c] * m[c]);
    let (ed, es) = (dot(kd, case.amplitude), dot(ks, case.amplitude));
    let back = pull_back_pair(&pair, &terms, case.axis, case.sharpness, ed, es);
    let glossy: [f64; 3] = std::array::from_fn(|c| ws[c] * case.amplitude[c] * pair.specular);
    let constant: f64 = glossy.iter().sum();
    let slope = dot(glossy, case.specular);
    let chain = |by: &[f64; 3]| constant * by[0] + slope * by[1] + back.point.warp_sharpness * by[2];
    let cosine = chain(&brdf.by_cosine) + back.point.mirror_cosine;
    Case {
        normal: add(
            back.point.normal,
            pull_back_normal(case.normal, case.to_viewer, back.point.mirror, cosine),
        ),
        to_viewer: [0.0; 3],
        axis: back.axis,
        sharpness: back.sharpness,
        amplitude: std::array::from_fn(|c| kd[c] * pair.diffuse.value + ks[c] * pair.specular),
        albedo: std::array::from_fn(|c| wd[c] / PI * case.amplitude[c] * pair.diffuse.value),
        specular: glossy.map(|g| g * brdf.slope),
        roughness: chain(&brdf.by_roughness),
    }
}

fn weighted(case: &Case, wd: [f64; 3], ws: [f64; 3]) -> f64 {
    let (d, s) = forward(case);
    dot(d, wd) + dot(s, ws)
}

/// Weights of diffuse and specular light in [`check`].
const WEIGHTS: [[f64; 3]; 2] = [[0.7, -0.4, 0.5], [0.3, 0.9, -0.2]];

/// Central difference along a change of the case, compared with the gradient's prediction.
fn check(name: &str, case: &Case, step: f64, predicted: f64, change: impl Fn(&mut Case, f64)) {
    let at = |step: f64| {
        let mut moved = *case;
        change(&mut moved, step);
        weighted(&moved, WEIGHTS[0], WEIGHTS[1])
    };
    let difference = (at(step) - at(-step)) / (2.0 * step);
    let size = weighted(case, [1.0; 3], [1.0; 3]).abs().max(1e-6);
    let error = (difference - predicted).abs() / (difference.abs() + 1e-2 * size + 2e-6);
    assert!(error < 1e-4, "{name}: difference {difference}, adjoint {predicted}, case {case:?}");
}

#[test]
fn every_adjoint_agrees_with_central_differences() {
    let mut rng = SmallRng::seed_from_u64(7);
    for _ in 0..400 {
        let case = random_case(&mut rng);
        let g = gradient(&case, WEIGHTS[0], WEIGHTS[1]);
        let h = 1e-5;
        check("sharpness", &case, h * case.sharpness, g.sharpness, |moved, e| moved.sharpness += e);
        check("roughness", &case, 1e-6, g.roughness, |moved, e| moved.roughness += e);
        for c in 0..3 {
            check("amplitude", &case, h, g.amplitude[c], |moved, e| moved.amplitude[c] += e);
            check("albedo", &case, h, g.albedo[c], |moved, e| moved.albedo[c] += e);
            check("specular", &case, h, g.specular[c], |moved, e| moved.specular[c] += e);
            check("axis", &case, 1e-6, g.axis[c], |moved, e| moved.axis[c] += e);
        }
        // A unit normal moves along its tangent plane only.
        let helper = if case.normal[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let tangent = unit(sub(helper, scale(case.normal, dot(helper, case.normal))));
        let turn = |moved: &mut Case, e| moved.normal = unit(add(case.normal, scale(tangent, e)));
        check("normal", &case, 1e-6, dot(g.normal, tangent), turn);
    }
}

/// The formulas as the published code writes them, without any of the rewriting above.
fn reference(case: &Case) -> ([f64; 3], [f64; 3]) {
    let shrink = |v: [f64; 3]| scale(v, 1.0 / (dot(v, v).sqrt() + 1e-6));
    let product = |l1: f64, x1: [f64; 3], l2: f64, x2: [f64; 3]| {
        let q = l1 / l2;
        let t = (q * q + 1.0 + 2.0 * q * dot(x1, x2)).sqrt().min(q + 1.0);
        (l2 * t, scale(add(scale(x1, q), x2), 1.0 / t), (l2 * (t - q - 1.0)).exp())
    };
    let hemisphere = |l: f64, c: f64| {
        let l = l + 1e-6;
        let t = l.sqrt() * (1.6988 * l * l + 10.8438 * l) / (l * l + 6.2201 * l + 10.2415);
        let s = (1.0 - (-t).exp() * (-t * c).exp()) / ((1.0 - (-t).exp()) * (1.0 + (-t * c).exp()));
        2.0 * PI / l * (1.0 - (-l).exp()) * (s + (1.0 - s) * (-l).exp())
    };
    let (n, v) = (case.normal, case.to_viewer);
    let lit = |l: f64, x: [f64; 3]| {
        let (m, axis, factor) = product(0.0315, n, l, x);
        32.7080 * factor * hemisphere(m, dot(axis, n)) - 31.7003 * hemisphere(l, dot(x, n))
    };
    let axis = shrink(case.axis);
    let nv = dot(n, v).max(0.0);
    let r4 = case.roughness.powi(4);
    let r = shrink(sub(scale(n, 2.0 * nv), v));
    let warped = 2.0 / r4 / (4.0 * nv + 1e-6);
    let vh = dot(v, shrink(add(r, v))).max(0.0);
    let k = (case.roughness + 1.0).powi(2) / 8.0;
    let nr = dot(n, r).max(0.0);
    let g = nr / (nr * (1.0 - k) + k + 1e-6) * (nv / (nv * (1.0 - k) + k + 1e-6));
    let power = (-(5.55473 * vh + 6.8316) * vh).exp2();
    let (m, p, factor) = product(case.sharpness, axis, warped, r);
    let (e, p_lit) = (lit(case.sharpness, axis), factor * lit(m, p));
    let diffuse = std::array::from_fn(|c| case.amplitude[c] * case.albedo[c] / PI * e);
    let specular = std::array::from_fn(|c| {
        let f = case.specular[c] + (1.0 - case.specular[c]) * power;
        case.amplitude[c] * f * g / (4.0 * nr * nv + 1e-6) / (PI * r4) * p_lit
    });
    (diffuse, specular)
}

#[test]
fn rewritten_formulas_equal_the_published_ones() {
    let mut rng = SmallRng::seed_from_u64(3);
    for _ in 0..2000 {
        let case = random_case(&mut rng);
        let ((d, s), (rd, rs)) = (forward(&case), reference(&case));
        for c in 0..3 {
            assert!((d[c] - rd[c]).abs() <= 1e-5 * rd[c].abs() + 1e-9, "{} {} {case:?}", d[c], rd[c]);
            assert!((s[c] - rs[c]).abs() <= 1e-4 * rs[c].abs() + 1e-8, "{} {} {case:?}", s[c], rs[c]);
        }
    }
}
