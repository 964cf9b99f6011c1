//! Pixels that are brighter than light can be, judged by the other photographs.

use crate::math::statistics::median;

/// How many times brighter than the brightest pixel of a typical photograph a pixel may be: beyond, it is broken, or a highlight that no
/// other photograph has.
pub(crate) const GLARING: f32 = 64.0;

/// The greatest radiance that a pixel may have in a set of photographs whose brightest channels are `highest`: [`GLARING`] times their
/// median. Infinite if most are black.
pub(crate) fn glare_limit(highest: impl Iterator<Item = f32>) -> f32 {
    let mut highest: Vec<f32> = highest.collect();
    median(&mut highest).filter(|usual| *usual > 0.0).map_or(f32::INFINITY, |usual| GLARING * usual)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_photograph_does_not_move_the_limit() {
        let limit = |last: f32| glare_limit([1.0, 2.0, 3.0, last].into_iter());
        assert_eq!((limit(4.0), limit(1e9)), (glare_limit([2.0, 3.0, 4.0].into_iter()), limit(4.0)));
        assert_eq!(glare_limit([2.0].into_iter()), 128.0);
        assert_eq!(glare_limit([0.0, 0.0, 5.0].into_iter()), f32::INFINITY);
        assert_eq!(glare_limit([].into_iter()), f32::INFINITY);
    }
}
