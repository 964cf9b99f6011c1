//! [`Real`] for a SIMD vector of `f32`, at whatever width the machine has at run time.

use super::real::Real;
use fearless_simd::prelude::*;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// A native-width vector of `f32` with its level token.
#[derive(Clone, Copy)]
pub struct Lanes<S: Simd> {
    value: S::f32s,
    simd: S,
}

impl<S: Simd> Lanes<S> {
    /// Lanes in one vector; always divides [`MAX_LANES`].
    pub const LEN: usize = <S::f32s as SimdBase<S>>::LEN;

    /// The same value in every lane.
    #[inline(always)]
    pub fn splat(simd: S, value: f32) -> Self {
        Self { value: value.simd_into(simd), simd }
    }

    /// Lanes from a slice of exactly [`Self::LEN`] values.
    #[inline(always)]
    pub fn load(simd: S, slice: &[f32]) -> Self {
        Self { value: S::f32s::from_slice(simd, slice), simd }
    }

    /// Writes the lanes to a slice of exactly [`Self::LEN`] values.
    #[inline(always)]
    pub fn store(self, slice: &mut [f32]) {
        self.value.store_slice(slice);
    }

    /// Adds the lanes onto a slice of exactly [`Self::LEN`] values.
    #[inline(always)]
    pub fn add_to(self, slice: &mut [f32]) {
        (S::f32s::from_slice(self.simd, slice) + self.value).store_slice(slice);
    }

    /// Sum of the lanes, in a fixed order.
    #[inline(always)]
    pub fn sum(self) -> f32 {
        self.value.as_slice().iter().sum()
    }
}

/// The widest vector any level has; buffers are padded to multiples of it.
pub const MAX_LANES: usize = 16;

macro_rules! binary {
    ($op:ident, $method:ident) => {
        impl<S: Simd> $op for Lanes<S> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self { value: $op::$method(self.value, other.value), simd: self.simd }
            }
        }
    };
}
binary!(Add, add);
binary!(Sub, sub);
binary!(Mul, mul);
binary!(Div, div);

impl<S: Simd> AddAssign for Lanes<S> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        self.value += other.value;
    }
}

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self { value: -self.value, simd: self.simd }
    }
}

impl<S: Simd> Real for Lanes<S> {
    #[inline(always)]
    fn lit(self, value: f64) -> Self {
        Self::splat(self.simd, value as f32)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self { value: self.value.sqrt(), simd: self.simd }
    }
    /// Cody–Waite reduction to |r| ≤ ln 2/2 and a degree-6 polynomial (Cephes `expf`): relative error below
    /// 2e-7 on [−87, 88]; arguments beyond are clamped, so the result is finite and never below 1e-38.
    #[inline(always)]
    fn exp(self) -> Self {
        let x = self.max(self.lit(-87.0)).min(self.lit(88.0));
        let k = Self { value: (x.value * std::f32::consts::LOG2_E).round_ties_even(), simd: self.simd };
        let r = k.mul_add(x.lit(-0.693_359_375), x);
        let r = k.mul_add(x.lit(2.121_944_4e-4), r);
        let mut p = x.lit(1.987_569_1e-4);
        for c in [1.398_2e-3, 8.333_452e-3, 4.166_579_6e-2, 1.666_666_5e-1, 0.5] {
            p = p.mul_add(r, x.lit(c));
        }
        let p = p.mul_add(r * r, r.plus(1.0));
        let bits = (k.value.to_int::<S::i32s>() + 127) << 23;
        let power: S::f32s = bits.bitcast();
        Self { value: p.value * power, simd: self.simd }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self { value: self.value.max(other.value), simd: self.simd }
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self { value: self.value.min(other.value), simd: self.simd }
    }
    #[inline(always)]
    fn select_lt(self, bound: Self, yes: Self, no: Self) -> Self {
        Self { value: self.value.simd_lt(bound.value).select(yes.value, no.value), simd: self.simd }
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        Self { value: self.value.mul_add(a.value, b.value), simd: self.simd }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};

    #[inline(always)]
    fn exp_all<S: Simd>(simd: S, values: &mut [f32]) {
        for chunk in values.chunks_exact_mut(Lanes::<S>::LEN) {
            let result = Lanes::load(simd, chunk).exp();
            chunk.fill(0.0);
            result.add_to(chunk);
        }
    }

    #[test]
    fn exp_is_within_its_stated_error() {
        let inputs: Vec<f32> = (0..16_000).map(|i| -87.0 + 174.0 * i as f32 / 15_999.0).collect();
        let mut outputs = inputs.clone();
        dispatch!(Level::new(), simd => exp_all(simd, &mut outputs));
        for (x, y) in inputs.iter().zip(&outputs) {
            let exact = f64::from(*x).exp();
            assert!((f64::from(*y) / exact - 1.0).abs() < 2e-7, "exp({x}) = {y}, not {exact}");
        }
    }
}
