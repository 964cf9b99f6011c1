//! The reference for the tests: adaptive cubature of light SG × BRDF × cosine over the hemisphere,
//! in `f64`.

use crate::brdf::{Facets, Ndf, specular_affine};
use crate::cases::{Case, unit};
use crate::real::{add, dot, scale, sub};
use crate::sg;
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, PI};

/// Eight-point Gauss–Legendre rule on [−1, 1]: the positive nodes and their weights.
const NODES: [f64; 4] =
    [0.183_434_642_495_649_8, 0.525_532_409_916_329, 0.796_666_477_413_626_7, 0.960_289_856_497_536_3];
const WEIGHTS: [f64; 4] =
    [0.362_683_783_378_362, 0.313_706_645_877_887_3, 0.222_381_034_453_374_5, 0.101_228_536_290_376_26];

/// Integrals for unit amplitude: SG × cosine, and the specular light's `constant` and `slope`.
pub(crate) type Integrals = [f64; 3];

/// The three integrands at ω.
pub(crate) fn integrand(case: &Case, ndf: Ndf, omega: [f64; 3]) -> Integrals {
    let cosine = dot(case.normal, omega);
    if cosine <= 0.0 {
        return [0.0; 3];
    }
    let light = sg::evaluate(omega, case.axis, case.sharpness) * cosine;
    if dot(case.normal, case.to_viewer) <= 0.0 {
        return [light, 0.0, 0.0];
    }
    let facets = Facets { ndf, roughness: case.roughness };
    let (constant, slope) = specular_affine(case.normal, case.to_viewer, omega, facets);
    [light, light * constant, light * slope]
}

/// A patch of the hemisphere in (s, φ) with cos θ = 1 − s², so that the horizon is an edge and the
/// pole is smooth.
#[derive(Clone, Copy)]
struct Patch {
    corner: [f64; 2],
    size: [f64; 2],
}

/// A direction around which the integrands have a peak, and the width of the peak there.
#[derive(Clone, Copy)]
struct Peak {
    direction: [f64; 3],
    width: f64,
}

struct Cubature<'a> {
    case: &'a Case,
    ndf: Ndf,
    tangent: [f64; 3],
    bitangent: [f64; 3],
    /// Brightest direction so far, and its value.
    brightest: (f64, [f64; 3]),
}

impl Cubature<'_> {
    fn direction(&self, [s, phi]: [f64; 2]) -> [f64; 3] {
        let sine = s * (2.0 - s * s).max(0.0).sqrt();
        let plane = add(scale(self.tangent, sine * phi.cos()), scale(self.bitangent, sine * phi.sin()));
        add(plane, scale(self.case.normal, 1.0 - s * s))
    }

    fn estimate(&mut self, patch: &Patch) -> Integrals {
        let mut sums = [0.0; 3];
        for i in 0..8 {
            for j in 0..8 {
                let at = |axis: usize, k: usize| {
                    let node = if k < 4 { NODES[k] } else { -NODES[k - 4] };
                    patch.corner[axis] + patch.size[axis] * (0.5 + 0.5 * node)
                };
                let place = [at(0, i), at(1, j)];
                let omega = self.direction(place);
                let value = integrand(self.case, self.ndf, omega);
                let weight = WEIGHTS[i % 4] * WEIGHTS[j % 4] * 0.5 * patch.size[0] * patch.size[1] * place[0];
                if value[1] + value[2] > self.brightest.0 {
                    self.brightest = (value[1] + value[2], omega);
                }
                for c in 0..3 {
                    sums[c] += weight * value[c];
                }
            }
        }
        sums
    }

    /// Splits until every patch near a peak is no larger than the peak.
    fn grade(&self, patch: Patch, peaks: &[Peak], out: &mut Vec<Patch>) {
        let s = patch.corner[0] + patch.size[0];
        let extent = [1.5 * patch.size[0], s * (2.0 - s * s).max(0.0).sqrt() * patch.size[1]];
        let diameter = extent[0].hypot(extent[1]);
        let center = self.direction([0, 1].map(|c| patch.corner[c] + 0.5 * patch.size[c]));
        let near = |peak: &Peak| {
            let away = sub(peak.direction, center);
            diameter > 1.5 * peak.width && dot(away, away).sqrt() < 1.2 * diameter
        };
        if !peaks.iter().any(near) {
            out.push(patch);
            return;
        }
        let axis = usize::from(extent[1] > extent[0]);
        for half in 0..2 {
            let mut child = patch;
            child.size[axis] *= 0.5;
            child.corner[axis] += child.size[axis] * f64::from(half);
            self.grade(child, peaks, out);
        }
    }

    /// The hemisphere in patches that are fine near the peaks.
    fn patches(&self, peaks: &[Peak]) -> Vec<Patch> {
        let quarter = |k: usize| Patch { corner: [0.0, FRAC_PI_2 * k as f64], size: [1.0, FRAC_PI_2] };
        let mut patches = vec![];
        (0..4).for_each(|k| self.grade(quarter(k), peaks, &mut patches));
        patches
    }

    fn refine(&mut self, patch: &Patch, coarse: Integrals, tolerance: Integrals, depth: u32) -> Integrals {
        let child = |k: usize| Patch {
            corner: [0, 1].map(|c| patch.corner[c] + 0.5 * patch.size[c] * ((k >> c) & 1) as f64),
            size: patch.size.map(|s| 0.5 * s),
        };
        let parts: [Integrals; 4] = std::array::from_fn(|k| self.estimate(&child(k)));
        let fine: Integrals = std::array::from_fn(|c| parts.iter().map(|p| p[c]).sum());
        if depth == 14 || (0..3).all(|c| (fine[c] - coarse[c]).abs() <= tolerance[c]) {
            return fine;
        }
        let mut sums = [0.0; 3];
        for (k, part) in parts.iter().enumerate() {
            let refined = self.refine(&child(k), *part, tolerance, depth + 1);
            for c in 0..3 {
                sums[c] += refined[c];
            }
        }
        sums
    }
}

/// Tangent and bitangent of a unit normal.
fn plane_of(normal: [f64; 3]) -> [[f64; 3]; 2] {
    let helper = if normal[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let tangent = unit(sub(helper, scale(normal, dot(helper, normal))));
    [tangent, DVec3::from(normal).cross(tangent.into()).into()]
}

/// The peaks of the light, which is lifted above the horizon, and of the BRDF.
fn peaks_of(case: &Case) -> [Peak; 2] {
    let normal = case.normal;
    let nv = dot(normal, case.to_viewer);
    let mirror = unit(sub(scale(normal, 2.0 * nv), case.to_viewer));
    let light_width = 1.0 / (case.sharpness + 1.0).sqrt();
    let mirror_width = case.roughness.powi(2) * 2f64.sqrt() / (1.0 + nv.max(0.02).powi(-2)).sqrt();
    let above = dot(case.axis, normal).min(0.0) * 0.9999;
    let lifted = unit(sub(case.axis, scale(normal, above)));
    [Peak { direction: lifted, width: light_width }, Peak { direction: mirror, width: mirror_width }]
}

/// The integrals of a case; the error of each patch is about `relative` times the whole.
pub(crate) fn integrate(case: &Case, ndf: Ndf, relative: f64) -> Integrals {
    let [tangent, bitangent] = plane_of(case.normal);
    let [light, mirror] = peaks_of(case);
    let mut peaks = vec![light, mirror];
    let mut cubature = Cubature { case, ndf, tangent, bitangent, brightest: (0.0, mirror.direction) };
    for _ in 0..2 {
        for patch in cubature.patches(&peaks) {
            cubature.estimate(&patch);
        }
        peaks.push(Peak { direction: cubature.brightest.1, width: light.width.min(mirror.width) });
    }
    let patches = cubature.patches(&peaks);
    let coarse: Vec<Integrals> = patches.iter().map(|p| cubature.estimate(p)).collect();
    let whole: Integrals = std::array::from_fn(|c| coarse.iter().map(|p| p[c]).sum());
    let glossy = relative * (whole[1] + whole[2]);
    let tolerance = [relative * whole[0], glossy, glossy];
    let mut sums = [0.0; 3];
    for (patch, part) in patches.iter().zip(coarse) {
        let refined = cubature.refine(patch, part, tolerance, 0);
        for c in 0..3 {
            sums[c] += refined[c];
        }
    }
    sums
}

#[test]
fn cubature_knows_what_is_known() {
    // Over the whole hemisphere the cosine integrates to π; a lobe along the normal has a closed
    // form.
    let case = |sharpness: f64| Case {
        normal: [0.0, 0.6, 0.8],
        to_viewer: [0.0, 0.6, 0.8],
        axis: [0.0, 0.6, 0.8],
        sharpness,
        amplitude: [1.0; 3],
        albedo: [1.0; 3],
        specular: [1.0; 3],
        roughness: 0.5,
    };
    assert!((integrate(&case(0.0), Ndf::Sg, 1e-8)[0] / PI - 1.0).abs() < 1e-7);
    for l in [0.3, 7.0, 4e4] {
        let exact = 2.0 * PI * (1.0 - (1.0 - f64::exp(-l)) / l) / l;
        assert!((integrate(&case(l), Ndf::Sg, 1e-8)[0] / exact - 1.0).abs() < 1e-7);
    }
}
