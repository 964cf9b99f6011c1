//! A light lobe: a spherical Gaussian with one amplitude per channel.

use crate::real::Vec3Of;

/// A light lobe as the kernel reads it.
#[derive(Clone, Copy, Debug)]
pub struct Lobe<F> {
    /// Unit axis.
    pub axis: Vec3Of<F>,
    /// Sharpness ≥ 0.
    pub sharpness: F,
    /// RGB amplitude.
    pub amplitude: Vec3Of<F>,
}

/// The shape of a lobe: axis and sharpness, without the amplitude.
#[derive(Clone, Copy)]
pub struct Shape<F> {
    /// Unit axis.
    pub axis: Vec3Of<F>,
    /// Sharpness ≥ 0.
    pub sharpness: F,
}
