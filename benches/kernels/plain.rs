//! The straightforward implementation: a `Vec` of lobes, two loops and the published formulas in
//! `f32`.

use lobelia_sg::published::{Lobe, evaluate_pair, prepare_point, pull_back_normal, pull_back_pair};
use lobelia_sg::real::{Vec3Of, dot};
use lobelia_sg::shading::{Layers, LobeColumns, PointAdjoint, RadianceAdjoint, ShadePoint, SpecularValue};
use std::f32::consts::PI;

pub fn lobes(columns: &LobeColumns) -> Vec<Lobe<f32>> {
    (0..columns.len()).map(|i| columns.get(i)).collect()
}

pub fn shade(points: &[ShadePoint], specular: &SpecularValue, lobes: &[Lobe<f32>], out: &mut [Layers]) {
    for (point, out) in points.iter().zip(out) {
        let (terms, brdf) = prepare_point(point.normal, point.to_viewer, specular.roughness);
        *out = Layers::default();
        for lobe in lobes {
            let pair = evaluate_pair(&terms, lobe.axis, lobe.sharpness);
            for c in 0..3 {
                out.diffuse[c] += lobe.amplitude[c] * pair.diffuse.value;
                out.specular[c] += lobe.amplitude[c] * pair.specular;
            }
        }
        for c in 0..3 {
            let m = brdf.constant + brdf.slope * specular.albedo[c];
            out.diffuse[c] = (out.diffuse[c] * point.albedo[c] / PI).max(0.0);
            out.specular[c] = (out.specular[c] * m).max(0.0);
        }
    }
}

/// Adjoints of all but the specular material, which costs nothing to speak of.
pub fn shade_adjoint(
    points: &[ShadePoint],
    specular: &SpecularValue,
    lobes: &[Lobe<f32>],
    adjoint: &[RadianceAdjoint],
    out: &mut [PointAdjoint],
) -> Vec<Lobe<f32>> {
    let zero = Lobe { axis: [0.0; 3], sharpness: 0.0, amplitude: [0.0; 3] };
    let mut gradient = vec![zero; lobes.len()];
    for ((point, adjoint), out) in points.iter().zip(adjoint).zip(out) {
        let (terms, brdf) = prepare_point(point.normal, point.to_viewer, specular.roughness);
        let kd: Vec3Of<f32> = std::array::from_fn(|c| adjoint.0[c] * point.albedo[c] / PI);
        let ks: Vec3Of<f32> =
            std::array::from_fn(|c| adjoint.0[c] * (brdf.constant + brdf.slope * specular.albedo[c]));
        *out = PointAdjoint::default();
        let mut mirror = [0.0; 3];
        let (mut cosine, mut warp) = (0.0, 0.0);
        for (lobe, gradient) in lobes.iter().zip(&mut gradient) {
            let pair = evaluate_pair(&terms, lobe.axis, lobe.sharpness);
            let (kd_mu, ks_mu) = (dot(kd, lobe.amplitude), dot(ks, lobe.amplitude));
            let back = pull_back_pair(&pair, &terms, lobe.axis, lobe.sharpness, kd_mu, ks_mu);
            gradient.sharpness += back.sharpness;
            cosine += back.point.mirror_cosine;
            warp += back.point.warp_sharpness;
            for c in 0..3 {
                gradient.axis[c] += back.axis[c];
                gradient.amplitude[c] += kd[c] * pair.diffuse.value + ks[c] * pair.specular;
                out.albedo[c] += adjoint.0[c] / PI * lobe.amplitude[c] * pair.diffuse.value;
                out.normal[c] += back.point.normal[c];
                mirror[c] += back.point.mirror[c];
            }
        }
        cosine += warp * brdf.by_cosine[2];
        let through_view = pull_back_normal(point.normal, point.to_viewer, mirror, cosine);
        for (sum, value) in out.normal.iter_mut().zip(through_view) {
            *sum += value;
        }
    }
    gradient
}
