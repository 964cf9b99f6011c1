//! Nodes and weights for a Gaussian that the horizon cuts: Gauss rules of the weight v·e^(−(v − t)²/2) on v > 0.
//!
//! v is the cosine with the normal in units in which the rest of the integrand has unit variance, and t is where that rest
//! would have its centre. For t ≫ 0 (far above the horizon) the rule becomes Gauss–Hermite, for t ≪ 0 (light from
//! below) Gauss–Laguerre. Nodes are counted from the weight's peak 1/a in units of its Laplace width σ; nodes, weights
//! and mass are then smooth functions of τ = t/√(t² + 9) and are kept as polynomials, fitted to rules computed by the
//! Stieltjes procedure, of the form Gauss–Hermite + s²P(τ) with s = (1 − τ)/2. The weights belong to the fitted
//! nodes (they reproduce the first K moments), so that the nodes' own fitting error costs nothing to first order.

use crate::math::real::Real;

/// Gauss–Hermite node or weight, and the coefficients of P from the constant up.
type Fit<const N: usize> = (f64, [f64; N]);

/// Mass of the weight relative to Laplace's √(2π)·σ·peak; error 4e-4.
const MASS: Fit<7> =
    (1.0, [-0.28007861, -0.51815018, 0.18182413, 0.69461141, 0.27841869, -0.25379475, -0.17329746]);

const NODES_2: [Fit<5>; 2] = [
    (-1.0, [2.7500375, 2.5655475, 0.53413143, -1.5133768, -0.97119542]),
    (1.0, [2.5065138, 0.31155153, 0.24742889, -0.19976133, 0.082894644]),
];
const WEIGHTS_2: [Fit<5>; 2] = [
    (0.5, [0.61186393, 0.59145898, 0.16873107, -0.29828474, -0.20018197]),
    (0.5, [-0.61186393, -0.59145898, -0.16873107, 0.29828474, 0.20018197]),
];
const NODES_3: [Fit<6>; 3] = [
    (-1.7320508075688772, [4.322201, 5.6028252, 4.2144074, -1.1692858, -5.2413054, -2.8132394]),
    (0.0, [3.0421303, 2.2013426, 1.9852592, -0.37195725, -2.4524361, -1.5609461]),
    (1.7320508075688772, [3.6200093, 0.24941973, 2.0057071, 0.98113145, -1.4500193, -2.0722976]),
];
const WEIGHTS_3: [Fit<6>; 3] = [
    (1.0 / 6.0, [0.85521287, 0.94041214, 0.68297771, -0.35782394, -1.152747, -0.62034498]),
    (2.0 / 3.0, [-0.47762567, -0.4241477, -0.21810405, 0.36690399, 0.73212068, 0.36947608]),
    (1.0 / 6.0, [-0.3775872, -0.51626444, -0.46487366, -0.0090800512, 0.42062632, 0.2508689]),
];
const NODES_4: [Fit<6>; 4] = [
    (-2.3344142183389773, [5.9616362, 8.931471, 8.471567, 0.32934886, -7.8306263, -4.7513139]),
    (-0.7419637843027259, [3.984339, 4.342401, 4.1742744, 0.017920235, -4.1684906, -2.6885897]),
    (0.7419637843027259, [3.8261447, 2.0450984, 3.1978089, 0.79173753, -2.809986, -2.6074956]),
    (2.3344142183389773, [4.670456, 0.10667319, 3.8039984, 2.8796775, -2.46742, -4.5674836]),
];
const WEIGHTS_4: [Fit<6>; 4] = [
    (0.0458758547680685, [0.72778572, 0.79113618, 0.72771149, -0.31456696, -1.4187525, -0.84319668]),
    (0.4541241452319315, [0.34774186, 0.69886448, 0.638466, 0.36802605, 0.24732524, 0.14372687]),
    (0.4541241452319315, [-0.93909984, -1.2620825, -1.1022194, 0.03044009, 1.013493, 0.58508699]),
    (0.0458758547680685, [-0.13642774, -0.22791814, -0.26395808, -0.083899181, 0.15793419, 0.11438283]),
];

/// Gauss–Hermite nodes of the unit normal density and their weights times e^(w²/2).
const ACROSS_1: [(f64, f64); 1] = [(0.0, 1.0)];
const ACROSS_2: [(f64, f64); 2] = [(-1.0, 0.824_360_635_350_064_1), (1.0, 0.824_360_635_350_064_1)];
const ACROSS_3: [(f64, f64); 3] = [
    (-1.7320508075688772, 0.746_948_178_390_010_8),
    (0.0, 2.0 / 3.0),
    (1.7320508075688772, 0.746_948_178_390_010_8),
];

/// Node and weight (times e^(w²/2)) `index` of `count` across the clipped direction.
#[inline(always)]
pub fn across(count: usize, index: usize) -> (f64, f64) {
    match count {
        1 => ACROSS_1[index],
        2 => ACROSS_2[index],
        3 => ACROSS_3[index],
        _ => unreachable!("rules across the clipped direction have 1 to 3 nodes"),
    }
}

/// A clipped Gaussian: where its peak is, how wide it is, how much it holds.
#[derive(Clone, Copy)]
pub struct Clipped<F> {
    /// a: from the unclipped centre to the peak; 1/a − a = t.
    pub shift: F,
    /// σ = 1/√(1 + a²): Laplace width at the peak.
    pub width: F,
    /// aσ: the width as a share of the peak's v.
    pub share: F,
    /// Mass relative to √(2π)·σ·peak.
    pub mass: F,
    tau: F,
    gap_squared: F,
}

/// One node of a clipped Gaussian's rule.
#[derive(Clone, Copy)]
pub struct AlongNode<F> {
    /// Distance from the peak in units of its width.
    pub offset: F,
    /// Share of the mass.
    pub weight: F,
}

impl<F: Real> Clipped<F> {
    /// The weight v·e^(−(v − t)²/2).
    #[inline(always)]
    pub fn new(t: F) -> Self {
        let (zero, one) = (t.zero(), t.one());
        let root = t.mul_add(t, t.lit(4.0)).sqrt();
        // Of the two roots ±a of a² + ta = 1 the one without cancellation: m = max(a, 1/a), and 1 + m² = m·root.
        let m = (root + t.max(-t)).times(0.5);
        let long = (m * root).sqrt();
        let inverse = (m * long).recip();
        let (narrow, wide) = (m * inverse, m * m * inverse);
        let tau = t / t.mul_add(t, t.lit(9.0)).sqrt();
        let gap = (one - tau).times(0.5);
        let clipped = Self {
            shift: t.select_lt(zero, m, inverse * long),
            width: t.select_lt(zero, narrow, wide),
            share: t.select_lt(zero, wide, narrow),
            mass: zero,
            tau,
            gap_squared: gap * gap,
        };
        Self { mass: clipped.fit(&MASS), ..clipped }
    }

    #[inline(always)]
    fn fit<const N: usize>(&self, fit: &Fit<N>) -> F {
        let mut p = self.tau.lit(fit.1[N - 1]);
        let mut i = N - 1;
        while i > 0 {
            i -= 1;
            p = p.mul_add(self.tau, p.lit(fit.1[i]));
        }
        p.mul_add(self.gap_squared, p.lit(fit.0))
    }

    /// Node `index` of the rule with `count` nodes.
    #[inline(always)]
    pub fn along(&self, count: usize, index: usize) -> AlongNode<F> {
        let (offset, weight) = match count {
            2 => (self.fit(&NODES_2[index]), self.fit(&WEIGHTS_2[index])),
            3 => (self.fit(&NODES_3[index]), self.fit(&WEIGHTS_3[index])),
            4 => (self.fit(&NODES_4[index]), self.fit(&WEIGHTS_4[index])),
            _ => unreachable!("rules along the clipped direction have 2 to 4 nodes"),
        };
        AlongNode { offset, weight }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moments of v^(1 + k)·e^(−(v − t)²/2) for k = 0.. by the trapezoidal rule from a far tail.
    fn moments(t: f64) -> [f64; 4] {
        let (low, high, n) = (0.0, t.max(0.0) + 12.0, 400_000);
        let h = (high - low) / f64::from(n);
        let mut sums = [0.0; 4];
        for i in 1..n {
            let v = f64::from(i) * h;
            let g = h * v * (-0.5 * (v - t) * (v - t)).exp();
            for (k, sum) in sums.iter_mut().enumerate() {
                *sum += g * v.powi(k as i32);
            }
        }
        sums
    }

    #[test]
    fn rules_reproduce_the_clipped_moments() {
        for t in [-9.0, -6.0, -3.0, -1.0, 0.0, 0.7, 2.0, 3.5, 5.0, 9.0] {
            let exact = moments(t);
            let clipped = Clipped::new(t);
            let peak = 1.0 / clipped.shift;
            let top = peak * (-0.5 * clipped.shift * clipped.shift).exp();
            let mass = clipped.mass * (2.0 * std::f64::consts::PI).sqrt() * clipped.width * top;
            assert!((mass / exact[0] - 1.0).abs() < 5e-4, "mass at {t}: {mass} {}", exact[0]);
            for count in 2..=4 {
                for (k, exact) in exact.iter().enumerate().take(count) {
                    let nodes = (0..count).map(|i| clipped.along(count, i));
                    let sum: f64 =
                        nodes.map(|n| n.weight * (peak + clipped.width * n.offset).powi(k as i32)).sum();
                    let error = mass * sum / exact - 1.0;
                    assert!(error.abs() < 2e-2, "t {t}, {count} nodes, moment {k}: {error}");
                }
            }
        }
    }

    #[test]
    fn nodes_stay_above_the_horizon() {
        for i in -400..400 {
            let t = f64::from(i) * 0.05;
            let clipped = Clipped::new(t);
            for count in 2..=4 {
                for index in 0..count {
                    let node = clipped.along(count, index);
                    assert!(1.0 + clipped.share * node.offset > 0.2 && node.weight > 0.0, "{t} {count} {index}");
                }
            }
        }
    }
}
