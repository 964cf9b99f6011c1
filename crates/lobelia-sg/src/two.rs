//! Two numbers at a time, as one number.
//!
//! The formulas of a pair are one long chain of dependent operations, most of whose time is
//! waiting. With two vectors in one number, the processor works on one while it waits for the
//! other.

use crate::real::Real;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// Two numbers with operations on each.
#[derive(Clone, Copy)]
pub struct Two<F>(pub F, pub F);

macro_rules! binary {
    ($op:ident, $method:ident) => {
        impl<F: Real> $op for Two<F> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self($op::$method(self.0, other.0), $op::$method(self.1, other.1))
            }
        }
    };
}
binary!(Add, add);
binary!(Sub, sub);
binary!(Mul, mul);
binary!(Div, div);

impl<F: Real> AddAssign for Two<F> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<F: Real> Neg for Two<F> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0, -self.1)
    }
}

macro_rules! one_by_one {
    ($($method:ident($($other:ident),*);)*) => {
        $(#[inline(always)]
        fn $method(self, $($other: Self),*) -> Self {
            Self(self.0.$method($($other.0),*), self.1.$method($($other.1),*))
        })*
    };
}

impl<F: Real> Real for Two<F> {
    one_by_one! {
        sqrt();
        exp();
        decay();
        abs();
        inverse();
        quick_rsqrt();
        rough_rsqrt();
        max(other);
        min(other);
        copysign(sign);
        mul_add(a, b);
        select_lt(bound, yes, no);
    }
    #[inline(always)]
    fn lit(self, value: f64) -> Self {
        Self(self.0.lit(value), self.0.lit(value))
    }
    #[inline(always)]
    fn any_lt(self, bound: Self) -> bool {
        self.0.any_lt(bound.0) | self.1.any_lt(bound.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_is_as_it_would_be_alone() {
        fn formula<F: Real>(x: F, y: F) -> F {
            let z = (x - y).abs().copysign(-x) * x.quick_rsqrt() / y.sqrt().inverse();
            let w = x.select_lt(y, z.exp(), (-z * z).decay()).max(x.min(y).times(0.1));
            w.mul_add(z, x.plus(0.5))
        }
        let Two(first, second) = formula(Two(0.5f32, 2.0), Two(0.75, 0.25));
        assert_eq!([first, second], [formula(0.5f32, 0.75), formula(2.0, 0.25)]);
        assert!(Two(1.0f32, 3.0).any_lt(Two(0.5, 4.0)));
        assert!(!Two(1.0f32, 3.0).any_lt(Two(0.5, 2.0)));
    }
}
