//! e^x for x ≤ 0 in `f32`, written so that a loop over it becomes vector code.

use std::f32::consts::LOG2_E;

/// e^`x` for `x` ≤ 0, to 2·10⁻⁷ relative; 0 below −87 (where the true value is under 10⁻³⁷).
///
/// Range reduction and polynomial as in Cephes `expf` (Moshier 1992); rounding by adding 1.5·2²³.
#[inline(always)]
pub(crate) fn exp_nonpositive(x: f32) -> f32 {
    const ROUND: f32 = 12_582_912.0;
    let clamped = x.max(-87.0);
    let shifted = clamped * LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = clamped - n * 0.693_359_4 - n * -2.121_944_4e-4;
    let mut p = 1.987_569_1e-4;
    p = p * r + 1.398_2e-3;
    p = p * r + 8.333_452e-3;
    p = p * r + 4.166_579_6e-2;
    p = p * r + 0.166_666_65;
    p = p * r + 0.5;
    let mantissa = p * r * r + r + 1.0;
    // The low bits of `shifted` hold n; moved into the exponent field they make 2^n.
    let power = f32::from_bits(shifted.to_bits().wrapping_add(127) << 23);
    if x < -87.0 { 0.0 } else { mantissa * power }
}

#[cfg(test)]
mod tests {
    use crate::light::map_fit::exp::exp_nonpositive;

    #[test]
    fn agrees_with_the_library() {
        for i in 0..=86_900 {
            let x = -(i as f32) * 1e-3;
            let exact = f64::from(x).exp();
            let error = (f64::from(exp_nonpositive(x)) / exact - 1.0).abs();
            assert!(error < 3e-7, "x {x}: relative error {error}");
        }
        assert_eq!(exp_nonpositive(0.0), 1.0);
        assert_eq!(exp_nonpositive(-100.0), 0.0);
        assert_eq!(exp_nonpositive(f32::NEG_INFINITY), 0.0);
    }
}
