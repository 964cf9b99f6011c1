//! Inner products of SGs and of their derivatives over the sphere, in closed form: the Gauss–Newton
//! matrix of the map fit, independent of the map.
//!
//! The product of two unit-amplitude SGs is e^(v·ω − λ₁ − λ₂) with v = λ₁ξ₁ + λ₂ξ₂, proportional to
//! a von Mises–Fisher density of concentration L = |v|; mean and second moments of that density are
//! known (Mardia and Jupp 2000, §9.3.2). All four basis functions of a lobe are G times a function
//! linear in ω, so those moments suffice.

use crate::map_fit::kernel::FitLobe;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Below e to this power an inner product is taken as zero.
const CUTOFF: f64 = -30.0;

/// Inner products of the basis functions of two lobes: G, and ∂G with respect to the two tangents
/// and log λ.
pub type Block = [[f64; 4]; 4];

/// Lower triangle of the matrix of inner products of all lobes' bases, a 4 × 4 block for each pair.
#[derive(Clone, Debug)]
pub struct Gram {
    blocks: Vec<Block>,
}

impl Gram {
    /// The matrix of all pairs of `lobes`.
    pub fn of(lobes: &[FitLobe]) -> Self {
        let row = |k: usize| (0..=k).map(move |l| inner_products(&lobes[k], &lobes[l]));
        Self { blocks: (0..lobes.len()).into_par_iter().flat_map_iter(row).collect() }
    }

    /// Inner product of basis `a` of lobe `k` with basis `b` of lobe `l`.
    pub fn at(&self, k: usize, a: usize, l: usize, b: usize) -> f64 {
        if k >= l { self.blocks[k * (k + 1) / 2 + l][a][b] } else { self.blocks[l * (l + 1) / 2 + k][b][a] }
    }
}

/// Mean over the sphere of the product of two unit-amplitude SGs, an SG of sharpness L = |v| and
/// amplitude e^(L − λ₁ − λ₂); and v.
pub fn mean_product(a: DVec3, sharpness_a: f64, b: DVec3, sharpness_b: f64) -> (f64, DVec3) {
    let v = a * sharpness_a + b * sharpness_b;
    let (length, sum) = (v.length(), sharpness_a + sharpness_b);
    // L − λ₁ − λ₂, without the cancellation: (λ₁ + λ₂)² − L² = λ₁λ₂|ξ₁ − ξ₂|².
    let exponent =
        -sharpness_a * sharpness_b * (a - b).length_squared() / (length + sum).max(f64::MIN_POSITIVE);
    if exponent < CUTOFF {
        return (0.0, v);
    }
    let mean = if length < 1e-6 { 1.0 } else { -(-2.0 * length).exp_m1() / (2.0 * length) };
    (exponent.exp() * mean, v)
}

/// Length of the mean direction of a von Mises–Fisher density of concentration `length`, over
/// `length`: (coth L − 1/L)/L.
fn mean_over_length(length: f64) -> f64 {
    if length < 0.1 {
        let square = length * length;
        return 1.0 / 3.0 - square / 45.0 + 2.0 * square * square / 945.0;
    }
    (1.0 / length.tanh() - 1.0 / length) / length
}

fn inner_products(a: &FitLobe, b: &FitLobe) -> Block {
    let (product, v) = mean_product(a.axis, a.sharpness, b.axis, b.sharpness);
    if product == 0.0 {
        return [[0.0; 4]; 4];
    }
    let length = v.length();
    let ratio = mean_over_length(length);
    let mean = v * ratio;
    let along = v.normalize_or(DVec3::Y);
    let outer = DMat3::from_cols(along * along.x, along * along.y, along * along.z);
    let second = DMat3::IDENTITY * ratio + outer * (1.0 - 3.0 * ratio);
    let (basis_a, basis_b) = (linear(a), linear(b));
    basis_a.map(|(p, s)| {
        let turned = second * s;
        basis_b.map(|(q, t)| product * (p * q + (p * t + q * s).dot(mean) + turned.dot(t)))
    })
}

/// Each basis function of a lobe divided by its G, as constant and slope in ω: G, λ(ω·t)G, λ(ω·ξ −
/// 1)G.
fn linear(lobe: &FitLobe) -> [(f64, DVec3); 4] {
    let FitLobe { axis, tangents: [one, other], sharpness, .. } = *lobe;
    [(1.0, DVec3::ZERO), (0.0, one * sharpness), (0.0, other * sharpness), (-sharpness, axis * sharpness)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::envmap::EnvironmentMap;

    /// Mean over the sphere, on a fine grid.
    fn mean_of(f: impl Fn(DVec3) -> f64) -> f64 {
        let grid = EnvironmentMap { width: 800, height: 400, radiance: Vec::new() };
        let row = |j| (0..800).map(|i| f(grid.texel_direction(i, j).as_dvec3())).sum::<f64>();
        (0..400).map(|j| row(j) * grid.texel_solid_angle(j)).sum::<f64>() / (4.0 * std::f64::consts::PI)
    }

    fn basis(lobe: &FitLobe, a: usize, omega: DVec3) -> f64 {
        let (constant, slope) = linear(lobe)[a];
        let value = (lobe.sharpness * (omega.dot(lobe.axis) - 1.0)).exp();
        value * (constant + slope.dot(omega))
    }

    #[test]
    fn closed_forms_are_their_quadratures() {
        let lobes = [
            FitLobe::new(DVec3::new(0.6, 0.0, 0.8), 5.0, [1.0; 3]),
            FitLobe::new(DVec3::new(0.0, 0.6, 0.8), 12.0, [1.0; 3]),
            FitLobe::new(DVec3::new(-0.6, 0.0, -0.8), 0.05, [1.0; 3]),
            FitLobe::new(DVec3::new(0.6, 0.1, 0.8), 150.0, [1.0; 3]),
        ];
        let gram = Gram::of(&lobes);
        for k in 0..4 {
            for l in 0..4 {
                for (a, b) in [(0, 0), (0, 3), (1, 0), (2, 1), (3, 3), (1, 2)] {
                    let exact = mean_of(|d| basis(&lobes[k], a, d) * basis(&lobes[l], b, d));
                    let scale = (gram.at(k, a, k, a) * gram.at(l, b, l, b)).sqrt();
                    let value = gram.at(k, a, l, b);
                    assert!((value - exact).abs() < 1e-4 * scale, "{k} {a} {l} {b}: {value} {exact}");
                }
            }
        }
        assert_eq!(mean_product(DVec3::Y, 500.0, DVec3::NEG_Y, 500.0).0, 0.0);
    }

    #[test]
    fn the_series_meets_the_closed_form() {
        for length in [0.09999, 0.1] {
            let exact = (1.0 / f64::tanh(length) - 1.0 / length) / length;
            assert!((mean_over_length(length) - exact).abs() < 1e-8);
        }
    }
}
