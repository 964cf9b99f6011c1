//! Near-uniform directions. Lobes on them, as sharp as their number asks for, are the start of an
//! unknown light.

use glam::Vec3;

/// `n` near-uniform unit directions on the Fibonacci spiral, from near +Y to near −Y.
///
/// Direction i has y = 1 − (2i + 1)/n and turns by the golden angle from one to the next (Swinbank
/// and Purser 2006).
pub fn fibonacci_axes(n: usize) -> Vec<Vec3> {
    let golden_angle = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..n)
        .map(|i| {
            let y = 1.0 - (2 * i + 1) as f64 / n as f64;
            let radius = (1.0 - y * y).sqrt();
            let (sin, cos) = (golden_angle * i as f64).sin_cos();
            Vec3::new((cos * radius) as f32, y as f32, (sin * radius) as f32)
        })
        .collect()
}

/// Sharpness at which `n` near-uniform lobes overlap well: neighbors meet at about half their peak.
///
/// Each of `n` directions covers 4π/n steradians, a cap of 1 − cos ρ = 2/n; λ = ln 2 · n/2 gives
/// half the peak at its rim.
pub fn spacing_sharpness(n: usize) -> f32 {
    std::f32::consts::LN_2 * n.max(1) as f32 / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_unit_and_spread() {
        assert!(fibonacci_axes(0).is_empty());
        for n in [1, 2, 24, 128, 512] {
            let axes = fibonacci_axes(n);
            assert_eq!(axes.len(), n);
            assert!(axes.iter().all(|a| (a.length() - 1.0).abs() < 1e-6));
        }
        let axes = fibonacci_axes(128);
        let mean: Vec3 = axes.iter().sum::<Vec3>() / 128.0;
        assert!(mean.length() < 0.01, "{mean}");
        for (i, a) in axes.iter().enumerate() {
            let others = axes.iter().enumerate().filter(|(j, _)| *j != i);
            let nearest = others.map(|(_, b)| a.angle_between(*b)).fold(f32::MAX, f32::min);
            // A perfect hexagonal packing of 128 would have 0.337 rad.
            assert!((0.2..0.36).contains(&nearest), "axis {i}: nearest at {nearest} rad");
        }
    }
}
