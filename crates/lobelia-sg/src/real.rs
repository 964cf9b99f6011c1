//! The number type that kernels are generic over: `f32` to run, `f64` to test, a SIMD vector of
//! `f32` to run fast.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// A real number, or a short vector of real numbers with operations per lane.
///
/// Constants are made from an existing value (`x.lit(0.5)`), because a SIMD type needs its level
/// token. Choices are written with [`Real::select_lt`], because lanes cannot branch.
pub trait Real:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
{
    /// The constant `value`, in every lane.
    fn lit(self, value: f64) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// e to the power of `self`.
    fn exp(self) -> Self;
    /// e to the power of `self` ≤ 0; vectors return e^−50 for arguments below −50, since products
    /// of smaller numbers are subnormal, which is slow.
    fn decay(self) -> Self;
    /// Larger of the two.
    fn max(self, other: Self) -> Self;
    /// Smaller of the two.
    fn min(self, other: Self) -> Self;
    /// `if self < bound { yes } else { no }`, lane by lane.
    fn select_lt(self, bound: Self, yes: Self, no: Self) -> Self;
    /// Whether `self < bound` in any lane.
    fn any_lt(self, bound: Self) -> bool;
    /// Magnitude.
    fn abs(self) -> Self;
    /// The magnitude of `self` with the sign of `sign`.
    fn copysign(self, sign: Self) -> Self;
    /// `self * a + b`, fused where the hardware supports it.
    fn mul_add(self, a: Self, b: Self) -> Self;
    /// 1 / self for `self` in [1e-37, 1e37] only; vectors may have a relative error of 3e-7, which
    /// saves a division.
    fn inverse(self) -> Self;

    /// Zero.
    #[inline(always)]
    fn zero(self) -> Self {
        self.lit(0.0)
    }
    /// One.
    #[inline(always)]
    fn one(self) -> Self {
        self.lit(1.0)
    }
    /// Product with a constant.
    #[inline(always)]
    fn times(self, value: f64) -> Self {
        self * self.lit(value)
    }
    /// Sum with a constant.
    #[inline(always)]
    fn plus(self, value: f64) -> Self {
        self + self.lit(value)
    }
    /// `self * a + c` with a constant.
    #[inline(always)]
    fn mul_plus(self, a: Self, c: f64) -> Self {
        self.mul_add(a, self.lit(c))
    }
    /// 1 / self.
    #[inline(always)]
    fn recip(self) -> Self {
        self.one() / self
    }
    /// 1 / √self for positive, normal `self`, with a relative error of at most 1e-5.
    #[inline(always)]
    fn quick_rsqrt(self) -> Self {
        self.sqrt().recip()
    }
    /// 1 / √self for positive, normal `self`, with a relative error of 2e-3: for where nodes lie,
    /// not for their weights.
    fn rough_rsqrt(self) -> Self;
    /// `self` if positive, else 0.
    #[inline(always)]
    fn relu(self) -> Self {
        self.max(self.zero())
    }
}

macro_rules! inherent {
    ($($method:ident($($other:ident)?);)*) => {
        $(#[inline(always)]
        fn $method(self, $($other: Self)?) -> Self {
            self.$method($($other)?)
        })*
    };
}

macro_rules! scalar_real {
    ($t:ty, $halved_exponent:expr) => {
        impl Real for $t {
            inherent! {
                sqrt();
                exp();
                abs();
                max(other);
                min(other);
                copysign(sign);
            }
            #[inline(always)]
            fn lit(self, value: f64) -> Self {
                value as $t
            }
            #[inline(always)]
            fn decay(self) -> Self {
                self.exp()
            }
            #[inline(always)]
            fn select_lt(self, bound: Self, yes: Self, no: Self) -> Self {
                if self < bound { yes } else { no }
            }
            #[inline(always)]
            fn any_lt(self, bound: Self) -> bool {
                self < bound
            }
            #[inline(always)]
            fn mul_add(self, a: Self, b: Self) -> Self {
                self * a + b
            }
            #[inline(always)]
            fn inverse(self) -> Self {
                1.0 / self
            }
            /// Equals the function of vectors up to rounding: half the exponent and a Newton step.
            #[inline(always)]
            fn rough_rsqrt(self) -> Self {
                let y = <$t>::from_bits($halved_exponent - (self.to_bits() >> 1));
                y * (1.5 - 0.5 * self * y * y)
            }
        }
    };
}
scalar_real!(f32, 0x5f37_59df);
scalar_real!(f64, 0x5fe6_eb3b_e000_0000);

/// A polynomial; the constant term comes first.
#[inline(always)]
pub fn polynomial<F: Real, const N: usize>(x: F, coefficients: &[f64; N]) -> F {
    let mut p = x.lit(coefficients[N - 1]);
    let mut i = N - 1;
    while i > 0 {
        i -= 1;
        p = p.mul_plus(x, coefficients[i]);
    }
    p
}

/// Three reals: a direction, a position or a color.
pub type Vec3Of<F> = [F; 3];

/// Dot product.
#[inline(always)]
pub fn dot<F: Real>(a: Vec3Of<F>, b: Vec3Of<F>) -> F {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// Sum.
#[inline(always)]
pub fn add<F: Real>(a: Vec3Of<F>, b: Vec3Of<F>) -> Vec3Of<F> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Difference.
#[inline(always)]
pub fn sub<F: Real>(a: Vec3Of<F>, b: Vec3Of<F>) -> Vec3Of<F> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Product with a scalar.
#[inline(always)]
pub fn scale<F: Real>(a: Vec3Of<F>, s: F) -> Vec3Of<F> {
    [a[0] * s, a[1] * s, a[2] * s]
}
