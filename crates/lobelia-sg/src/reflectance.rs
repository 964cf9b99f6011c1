//! How much light the specular part of a BRDF reflects toward a viewer from all sides: the
//! directional–hemispherical reflectance
//!
//! E(c) = ∫ f_s(v, ω) (n·ω) dω, with c = n·v,
//!
//! by quadrature over half vectors that follow the distribution of normals. There are two BRDFs:
//! that of the PhySG supplement ([`crate::brdf`]), and that of glTF 2.0 (appendix B), with which
//! other programs show an object: GGX, the height-correlated Smith term, and Schlick's F = F0 +
//! (F90 − F0)(1 − v·h)⁵. Both are affine in what their F depends on.

use crate::brdf::{Facets, Ndf, fresnel_power, ndf_sharpness, shadowing_k, shadowing_over_cosine};
use std::f64::consts::PI;

/// Cosines n·v at which reflectances are tabulated.
pub const ANGLES: usize = 20;

/// Nodes of the quadrature: in the angle from the normal, and around it.
const NODES: [usize; 2] = [96, 48];

/// Cosine number `i` of a table, the middle of an equal part of [0, 1].
pub fn cosine(i: usize) -> f64 {
    (i as f64 + 0.5) / ANGLES as f64
}

/// Weight of cosine number `i` in means over the hemisphere, 2c per step of c. The weights sum to
/// one.
pub fn weight(i: usize) -> f64 {
    2.0 * cosine(i) / ANGLES as f64
}

/// `(constant, slope)` so that E = constant + slope·s for the specular albedo s.
pub fn specular_reflectance(facets: Facets<f64>, cosine: f64) -> (f64, f64) {
    let [k, _] = shadowing_k(facets);
    let alpha2 = facets.roughness.powi(4);
    let sharpness = ndf_sharpness(facets.roughness);
    // The part of the SG over the whole sphere, which the density of half vectors is divided by.
    let whole = -(-2.0 * sharpness).exp_m1();
    let height = |u: f64| match facets.ndf {
        Ndf::Sg => 1.0 + (-u * whole).ln_1p() / sharpness,
        Ndf::Ggx => ggx_height(u, alpha2),
    };
    mean_over_half_vectors(cosine, height, |facing, cos_light, up| {
        let shadowing = shadowing_over_cosine(cosine, k) * shadowing_over_cosine(cos_light, k);
        // f_s cos over the density D/(4 v·h) of directions to the light, or D (n·h)/(4 v·h) for
        // GGX.
        let density = match facets.ndf {
            Ndf::Sg => whole,
            Ndf::Ggx => up.recip(),
        };
        let common = shadowing * cos_light * facing * density;
        let power = fresnel_power(facing);
        (common * power, common * (1.0 - power))
    })
}

/// `(a, b)` so that E = a·F0 + b·F90 for glTF's dielectric of this `roughnessFactor`.
pub fn gltf_reflectance(roughness: f64, cosine: f64) -> (f64, f64) {
    let alpha2 = roughness.powi(4);
    mean_over_half_vectors(
        cosine,
        |u| ggx_height(u, alpha2),
        |facing, cos_light, up| {
            let term = |along: f64, across: f64| along * (across * across * (1.0 - alpha2) + alpha2).sqrt();
            let visibility = 0.5 / (term(cos_light, cosine) + term(cosine, cos_light));
            let common = visibility * 4.0 * cos_light * facing / up;
            let power = (1.0 - facing).powi(5);
            (common * (1.0 - power), common * power)
        },
    )
}

/// n·h of GGX's half vectors with density D (n·h), at `u` in (0, 1).
fn ggx_height(u: f64, alpha2: f64) -> f64 {
    ((1.0 - u) / ((alpha2 - 1.0).mul_add(u, 1.0))).sqrt()
}

/// The mean of `value(v·h, n·l, n·h)` over half vectors h at heights `height(u)`, u even in (0, 1),
/// all around the normal; those that mirror the viewer below the horizon count as zero.
fn mean_over_half_vectors(
    cosine: f64,
    height: impl Fn(f64) -> f64,
    value: impl Fn(f64, f64, f64) -> (f64, f64),
) -> (f64, f64) {
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let middle = |i: usize, axis: usize| (i as f64 + 0.5) / NODES[axis] as f64;
    let (mut sum_a, mut sum_b) = (0.0, 0.0);
    for i in 0..NODES[0] {
        let up = height(middle(i, 0));
        let out = (1.0 - up * up).max(0.0).sqrt();
        // Both sides of the plane of incidence are alike.
        for j in 0..NODES[1] {
            let facing = out * sine * (PI * middle(j, 1)).cos() + up * cosine;
            let cos_light = 2.0 * facing * up - cosine;
            if facing > 0.0 && cos_light > 0.0 && up > 0.0 {
                let (a, b) = value(facing.min(1.0), cos_light, up);
                (sum_a, sum_b) = (sum_a + a, sum_b + b);
            }
        }
    }
    let count = (NODES[0] * NODES[1]) as f64;
    (sum_a / count, sum_b / count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::specular_affine;

    /// The integral over directions to the light, evenly over the hemisphere, of (a, b).
    fn brute(cosine: f64, pair: impl Fn([f64; 3], [f64; 3]) -> (f64, f64)) -> (f64, f64) {
        const SIDE: usize = 700;
        let viewer = [(1.0 - cosine * cosine).sqrt(), 0.0, cosine];
        let (mut a, mut b) = (0.0, 0.0);
        for i in 0..SIDE {
            let z = (i as f64 + 0.5) / SIDE as f64;
            let out = (1.0 - z * z).sqrt();
            for j in 0..SIDE {
                let around = PI * (j as f64 + 0.5) / SIDE as f64;
                let (x, y) = pair(viewer, [out * around.cos(), out * around.sin(), z]);
                (a, b) = (a + x * z, b + y * z);
            }
        }
        let each = 2.0 * PI / (SIDE * SIDE) as f64;
        (a * each, b * each)
    }

    /// glTF 2.0, appendix B: V·D times 1 − (1 − v·h)⁵ and (1 − v·h)⁵.
    fn gltf_pair(roughness: f64, v: [f64; 3], l: [f64; 3]) -> (f64, f64) {
        let sum = [v[0] + l[0], v[1] + l[1], v[2] + l[2]];
        let length = sum.iter().map(|x| x * x).sum::<f64>().sqrt();
        let h = sum.map(|x| x / length);
        let alpha2 = roughness.powi(4);
        let d = alpha2 / (PI * (h[2] * h[2] * (alpha2 - 1.0) + 1.0).powi(2));
        let part = |a: f64, b: f64| a * (alpha2 + (1.0 - alpha2) * b * b).sqrt();
        let visibility = 0.5 / (part(v[2], l[2]) + part(l[2], v[2]));
        let power = (1.0 - (v[0] * h[0] + v[1] * h[1] + v[2] * h[2])).powi(5);
        (visibility * d * (1.0 - power), visibility * d * power)
    }

    #[test]
    fn reflectances_are_the_integrals_over_the_hemisphere() {
        let near = |a: (f64, f64), b: (f64, f64)| {
            let size = b.0.abs() + b.1.abs();
            (a.0 - b.0).abs() < 4e-3 * size && (a.1 - b.1).abs() < 4e-3 * size
        };
        for (roughness, cosine) in [(0.35, 0.9), (0.35, 0.3), (0.7, 0.6), (1.0, 0.2)] {
            for ndf in [Ndf::Sg, Ndf::Ggx] {
                let facets = Facets { ndf, roughness };
                let found = specular_reflectance(facets, cosine);
                let exact = brute(cosine, |v, l| specular_affine([0.0, 0.0, 1.0], v, l, facets));
                assert!(near(found, exact), "{ndf:?} {roughness} {cosine}: {found:?} {exact:?}");
            }
            let found = gltf_reflectance(roughness, cosine);
            let exact = brute(cosine, |v, l| gltf_pair(roughness, v, l));
            assert!(near(found, exact), "glTF {roughness} {cosine}: {found:?} {exact:?}");
        }
    }

    #[test]
    fn a_smooth_lobe_is_a_mirror_and_weights_sum_to_one() {
        let (constant, slope) = specular_reflectance(Facets::sg(0.03), 0.999);
        assert!((constant + slope - 1.0).abs() < 5e-3 && constant < 0.01);
        let (f0, f90) = gltf_reflectance(0.03, 0.999);
        assert!((f0 + f90 - 1.0).abs() < 5e-3 && f90 < 1e-3);
        assert!(((0..ANGLES).map(weight).sum::<f64>() - 1.0).abs() < 1e-12);
    }
}
