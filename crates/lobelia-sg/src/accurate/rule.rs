//! Nodes and weights for a Gaussian that the horizon cuts: Gauss rules of the weight v·e^(−(v −
//! t)²/2) on v > 0.
//!
//! v is the cosine with the normal in units in which the rest of the integrand has unit variance,
//! and t is the center of that rest. For t ≫ 0 (far above the horizon) the rule becomes
//! Gauss–Hermite, for t ≪ 0 (light from below) Gauss–Laguerre. Positions of nodes are measured from
//! the peak 1/a of the weight, in units of its Laplace width σ; nodes, weights and mass are then
//! smooth functions of τ = t/√(t² + 4) and are kept as polynomials, fitted to rules computed by the
//! Stieltjes procedure, of the form Gauss–Hermite + s²P(τ) with s = (1 − τ)/2. The weights belong
//! to the fitted nodes (they reproduce the first K moments), so that the fitting error of the nodes
//! has no effect to first order.

use crate::real::{Real, polynomial};
use crate::two::Two;

/// Gauss–Hermite node or weight, and the coefficients of P from the constant up.
type Fit<const N: usize> = (f64, [f64; N]);

/// Mass of the weight relative to Laplace's √(2π)·σ·peak; error 3e-4.
const MASS: Fit<8> = (
    1.0,
    [-0.27863366, -0.52792871, -0.39857341, -0.37610475, -0.12435211, 0.36396699, 0.5248399, 0.1791278],
);

const NODES_2: [Fit<5>; 2] = [
    (-1.0, [2.6992336, 3.6106817, 4.4628148, 4.0674755, 1.7847592]),
    (1.0, [2.4851265, 1.6643393, 2.2338647, 3.0770173, 2.7229621]),
];
const WEIGHTS_2: [Fit<5>; 2] = [
    (0.5, [0.59544853, 0.80722213, 1.0791489, 1.0862866, 0.50818761]),
    (0.5, [-0.59544853, -0.80722213, -1.0791489, -1.0862866, -0.50818761]),
];
const NODES_3: [Fit<6>; 3] = [
    (-1.7320508075688772, [4.268551, 6.2772404, 8.1328012, 9.7692081, 7.7177806, 2.4109737]),
    (0.0, [2.9982697, 3.2836375, 4.8373994, 5.7221413, 3.3382652, -0.1183123]),
    (1.7320508075688772, [3.5220099, 2.1943723, 5.6697588, 7.6940795, 1.3345721, -4.3110822]),
];
const WEIGHTS_3: [Fit<6>; 3] = [
    (1.0 / 6.0, [0.84431388, 1.1530788, 1.5278404, 1.568209, 0.83404027, 0.064161864]),
    (2.0 / 3.0, [-0.47550393, -0.59462394, -0.69744621, -0.47437752, 0.0012346291, 0.17126932]),
    (1.0 / 6.0, [-0.36880995, -0.55845486, -0.83039414, -1.0938314, -0.8352749, -0.23543119]),
];
const NODES_4: [Fit<6>; 4] = [
    (-2.3344142183389773, [5.8527594, 8.8549866, 12.299381, 18.794767, 18.653839, 7.0956613]),
    (-0.7419637843027259, [3.9151489, 5.0183749, 7.3075701, 10.307531, 8.5369818, 2.1438452]),
    (0.7419637843027259, [3.7336872, 3.4101123, 6.6127277, 9.4291165, 4.7818016, -1.6382596]),
    (2.3344142183389773, [4.4837229, 2.4373429, 9.0848328, 13.802749, 0.83166459, -9.2756289]),
];
const WEIGHTS_4: [Fit<6>; 4] = [
    (0.0458758547680685, [0.72353383, 0.9383288, 1.2354384, 1.2578358, 0.60204325, -0.033959372]),
    (0.4541241452319315, [0.32539004, 0.61293876, 1.0450021, 2.0776733, 2.3797521, 1.0354328]),
    (0.4541241452319315, [-0.91770579, -1.3381718, -1.9148754, -2.7469085, -2.4566422, -0.82594748]),
    (0.0458758547680685, [-0.13121808, -0.21309581, -0.3655651, -0.58860064, -0.52515316, -0.1755259]),
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

/// A clipped Gaussian: position of its peak, width and mass.
#[derive(Clone, Copy)]
pub struct Clipped<F> {
    /// a, the distance from the unclipped center to the peak; 1/a − a = t.
    pub shift: F,
    /// σ = 1/√(1 + a²): Laplace width at the peak.
    pub width: F,
    /// aσ: the width as a fraction of v at the peak.
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
    /// Fraction of the mass.
    pub weight: F,
}

impl<F: Copy> Clipped<Two<F>> {
    /// One of the two, which `one` takes.
    #[inline(always)]
    pub fn each(&self, one: impl Fn(Two<F>) -> F) -> Clipped<F> {
        Clipped {
            shift: one(self.shift),
            width: one(self.width),
            share: one(self.share),
            mass: one(self.mass),
            tau: one(self.tau),
            gap_squared: one(self.gap_squared),
        }
    }
}

impl<F: Real> Clipped<F> {
    /// The weight v·e^(−(v − t)²/2).
    #[inline(always)]
    pub fn new(t: F) -> Self {
        let (zero, one) = (t.zero(), t.one());
        let square = t.mul_add(t, t.lit(4.0));
        let inverse_root = square.quick_rsqrt();
        let root = square * inverse_root;
        // The root without cancellation of the two roots ±a of a² + ta = 1: m = max(a, 1/a), and 1 +
        // m² = m·root.
        let m = (root + t.max(-t)).times(0.5);
        let narrow = (m * root).quick_rsqrt();
        let wide = m * narrow;
        let tau = t * inverse_root;
        let gap = (one - tau).times(0.5);
        let clipped = Self {
            shift: t.select_lt(zero, m, m.inverse()),
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
        polynomial(self.tau, &fit.1).mul_plus(self.gap_squared, fit.0)
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
                    assert!(
                        1.0 + clipped.share * node.offset > 0.2 && node.weight > 0.0,
                        "{t} {count} {index}"
                    );
                }
            }
        }
    }
}
