//! The published formulas one pair at a time in `f64`, for tests.

use super::pair::{evaluate_pair, pull_back_pair, shade_pair};
use super::point::{prepare_point, pull_back_normal};
use crate::cases::Case;
use crate::lobe::Lobe;
use crate::real::{add, dot};
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
