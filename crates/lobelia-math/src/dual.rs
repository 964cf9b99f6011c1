//! A function of a lobe's sharpness and a cosine, with its partial derivatives.

/// A function's value and its two partial derivatives.
#[derive(Clone, Copy)]
pub struct Dual<F> {
    /// The value.
    pub value: F,
    /// Derivative with respect to the sharpness.
    pub by_sharpness: F,
    /// Derivative with respect to the cosine.
    pub by_cosine: F,
}
