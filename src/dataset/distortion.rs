//! Lens distortion: the models of camera files, and their inverses.
//!
//! A ray meets the plane at depth 1 in a point p. The lens shows it where a pinhole camera of the same focal lengths shows another
//! point of that plane, in three steps:
//!
//! 1. the [`Projection`] scales p by a function of its length; a fisheye lens shows the angle θ = atan ‖p‖ instead of its tangent;
//! 2. a quotient of polynomials in the squared length scales the result;
//! 3. tangential and thin-prism terms shift it.
//!
//! All models of OpenCV (`calib3d`) and of COLMAP (`sensor/models`) but panoramas are special cases.

use glam::{DMat2, DVec2};
use std::fmt;

/// Steps of the continuation from the image's center to a point, and Newton steps in each of them.
const CONTINUATION_STEPS: u32 = 8;
const NEWTON_STEPS: u32 = 12;
/// Points between the center and an image point where folds are looked for.
const FOLD_SAMPLES: u32 = 24;
/// Least determinant of the Jacobian where an image counts as not folded.
const LEAST_DETERMINANT: f64 = 1e-6;
/// Points of the plane farther out than this are as good as behind the camera (89.9°).
const FARTHEST: f64 = 1e3;
/// Fisheye polynomials are calibrated up to the rim of the image circle; beyond this angle in radians a fold is that rim.
const RIM: f64 = 1.2;

/// How far from the principal point, in focal lengths, a ray at the angle θ from the optical axis is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Projection {
    /// tan θ.
    Pinhole,
    /// θ: fisheye lenses.
    Equidistant,
    /// atan(2 tan θ tan(ω/2)) / ω, with ω in radians (Devernay and Faugeras 2001).
    Fov(f64),
    /// The r with tan θ = r / (1 + k r²) (Fitzgibbon 2001).
    Division(f64),
    /// tan θ / (α √(β tan²θ + 1) + 1 − α) (Khomutenko, Garcia and Martinet 2016).
    Unified { alpha: f64, beta: f64 },
}

/// Why no point of the plane at depth 1 is seen at an image point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unseen {
    /// The ray leads backward, or so far to the side that a pinhole camera does not show it.
    Behind,
    /// The distortion folds the image over before that point.
    Folded,
}

impl Projection {
    /// The factor on points at squared distance `r2`, and its derivative by `r2`; NaN where the lens has no image.
    fn scale(self, r2: f64) -> (f64, f64) {
        match self {
            Self::Pinhole => (1.0, 0.0),
            Self::Equidistant => arc(r2),
            Self::Fov(omega) => {
                let stretch = 2.0 * (0.5 * omega).tan();
                let gain = if omega == 0.0 { 1.0 } else { stretch / omega };
                let (factor, slope) = arc(stretch * stretch * r2);
                (gain * factor, gain * stretch * stretch * slope)
            }
            Self::Division(k) => {
                let root = (1.0 - 4.0 * k * r2).sqrt();
                let factor = 2.0 / (1.0 + root);
                (factor, k * factor * factor / root)
            }
            Self::Unified { alpha, beta } => {
                let root = (beta * r2 + 1.0).sqrt();
                let factor = 1.0 / (alpha * root + 1.0 - alpha);
                (factor, -0.5 * alpha * beta * factor * factor / root)
            }
        }
    }

    /// The point of the plane that is seen at `q`.
    fn inverse(self, q: DVec2) -> Result<DVec2, Unseen> {
        let r = q.length();
        let factor = match self {
            Self::Pinhole => 1.0,
            Self::Equidistant => tangent(r)?,
            Self::Fov(0.0) => 1.0,
            Self::Fov(omega) => omega * tangent(r * omega.abs())? / (2.0 * (0.5 * omega).tan()),
            Self::Division(k) if k * r * r >= 1.0 => return Err(Unseen::Folded),
            Self::Division(k) => 1.0 / (1.0 + k * r * r).max(0.0),
            Self::Unified { alpha, beta } => {
                let under_root = 1.0 - (2.0 * alpha - 1.0) * beta * r * r;
                let depth = (1.0 - alpha * alpha * beta * r * r) / (alpha * under_root.sqrt() + 1.0 - alpha);
                1.0 / depth.max(0.0)
            }
        };
        let p = q * factor;
        if p.length() < FARTHEST { Ok(p) } else { Err(Unseen::Behind) }
    }

    /// `Err` says what is wrong with the parameters, as a clause.
    fn check(self) -> Result<(), String> {
        match self {
            Self::Fov(omega) if omega.abs() >= std::f64::consts::PI => Err(format!(
                "the lens distortion's field of view ω is {omega} radians; it must lie between −π and π"
            )),
            Self::Unified { alpha, beta } if !((0.0..=1.0).contains(&alpha) && beta > 0.0) => Err(format!(
                "the lens distortion's α is {alpha} and its β {beta}; α must lie between 0 and 1, β above 0"
            )),
            _ => Ok(()),
        }
    }

    fn parameters(self) -> [f64; 2] {
        match self {
            Self::Pinhole | Self::Equidistant => [0.0; 2],
            Self::Fov(value) | Self::Division(value) => [value, 0.0],
            Self::Unified { alpha, beta } => [alpha, beta],
        }
    }
}

/// atan(r) / r for r = √`r2`, and its derivative by `r2`.
fn arc(r2: f64) -> (f64, f64) {
    if r2 < 1e-4 {
        let factor = 1.0 - r2 * (1.0 / 3.0 - r2 * (1.0 / 5.0 - r2 / 7.0));
        return (factor, -1.0 / 3.0 + r2 * (2.0 / 5.0 - r2 * (3.0 / 7.0 - r2 * 4.0 / 9.0)));
    }
    let r = r2.sqrt();
    let factor = r.atan() / r;
    (factor, (1.0 / (1.0 + r2) - factor) / (2.0 * r2))
}

/// tan(angle) / angle.
fn tangent(angle: f64) -> Result<f64, Unseen> {
    match angle {
        angle if angle >= std::f64::consts::FRAC_PI_2 => Err(Unseen::Behind),
        angle if angle < 1e-6 => Ok(1.0),
        angle => Ok(angle.tan() / angle),
    }
}

/// 1 + c₁x + c₂x² + …, and its derivative.
fn polynomial(coefficients: &[f64], x: f64) -> (f64, f64) {
    let terms = coefficients.iter().rev().copied().chain([1.0]);
    terms.fold((0.0, 0.0), |(value, slope), c| (value * x + c, slope * x + value))
}

/// The derivative of p ↦ p · factor(‖p‖²), of which `slope` is the factor's derivative.
fn derivative_of_scaling(p: DVec2, factor: f64, slope: f64) -> DMat2 {
    DMat2::from_diagonal(DVec2::splat(factor)) + DMat2::from_cols(p * p.x, p * p.y) * (2.0 * slope)
}

/// A lens model without focal lengths and principal point. All coefficients are 0 in [`Distortion::NONE`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Distortion {
    pub projection: Projection,
    /// k₁, k₂, … of 1 + k₁r² + k₂r⁴ + ….
    pub radial: [f64; 6],
    /// The same of the polynomial by which that is divided.
    pub divisor: [f64; 3],
    /// OpenCV's p₁, p₂.
    pub tangential: [f64; 2],
    /// Thin prism: x is shifted by s₁r² + s₂r⁴, y by s₃r² + s₄r⁴.
    pub prism: [f64; 4],
    /// Whether the tangential and thin-prism terms are of the point after its radial scaling, not before.
    pub shifts_scaled: bool,
}

impl Distortion {
    pub const NONE: Self = Self {
        projection: Projection::Pinhole,
        radial: [0.0; 6],
        divisor: [0.0; 3],
        tangential: [0.0; 2],
        prism: [0.0; 4],
        shifts_scaled: false,
    };

    /// OpenCV's model with k₁, k₂, k₃ and p₁, p₂.
    pub fn brown_conrady(radial: [f64; 3], tangential: [f64; 2]) -> Self {
        let [k1, k2, k3] = radial;
        Self { radial: [k1, k2, k3, 0.0, 0.0, 0.0], tangential, ..Self::NONE }
    }

    /// OpenCV's fisheye model: θ(1 + k₁θ² + k₂θ⁴ + k₃θ⁶ + k₄θ⁸).
    pub fn fisheye(radial: [f64; 4]) -> Self {
        let [k1, k2, k3, k4] = radial;
        Self { projection: Projection::Equidistant, radial: [k1, k2, k3, k4, 0.0, 0.0], ..Self::NONE }
    }

    /// `Err` says which parameter is impossible, as a clause.
    pub fn check(&self) -> Result<(), String> {
        let groups: [&[f64]; 5] =
            [&self.radial, &self.divisor, &self.tangential, &self.prism, &self.projection.parameters()];
        match groups.into_iter().flatten().find(|value| !value.is_finite()) {
            Some(value) => Err(format!("a coefficient of the lens distortion is {value}")),
            None => self.projection.check(),
        }
    }

    /// The image point of the ray through `p`, relative to a pinhole camera; NaN where the lens has no image.
    pub fn distort(&self, p: DVec2) -> DVec2 {
        self.warp(self.project(p)).0
    }

    /// The derivative of [`Self::distort`] by `p`.
    #[cfg(test)]
    pub fn derivative(&self, p: DVec2) -> DMat2 {
        let (factor, slope) = self.projection.scale(p.length_squared());
        self.warp(p * factor).1 * derivative_of_scaling(p, factor, slope)
    }

    /// The ray that is seen at `target`, as its point on the plane at depth 1.
    pub fn undistort(&self, target: DVec2) -> Result<DVec2, Unseen> {
        self.projection.inverse(self.unwarp(target)?)
    }

    /// Whether the image is not folded over between its center and the ray through `p`.
    pub fn reaches(&self, p: DVec2) -> bool {
        self.is_unfolded(self.project(p))
    }

    fn project(&self, p: DVec2) -> DVec2 {
        p * self.projection.scale(p.length_squared()).0
    }

    /// Steps 2 and 3, and their derivative.
    fn warp(&self, q: DVec2) -> (DVec2, DMat2) {
        let r2 = q.length_squared();
        let (over, over_slope) = polynomial(&self.radial, r2);
        let (under, under_slope) = polynomial(&self.divisor, r2);
        let factor = over / under;
        let slope = (over_slope - factor * under_slope) / under;
        let (scaled, by_q) = (q * factor, derivative_of_scaling(q, factor, slope));
        if self.shifts_scaled {
            let (shift, by_scaled) = self.shift(scaled);
            (scaled + shift, by_q + by_scaled * by_q)
        } else {
            let (shift, shift_by_q) = self.shift(q);
            (scaled + shift, by_q + shift_by_q)
        }
    }

    /// The tangential and thin-prism terms, and their derivative.
    fn shift(&self, p: DVec2) -> (DVec2, DMat2) {
        let (r2, DVec2 { x, y }) = (p.length_squared(), p);
        let [p1, p2] = self.tangential;
        let [s1, s2, s3, s4] = self.prism;
        let shift = DVec2::new(
            2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + s2 * r2),
            2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y) + r2 * (s3 + s4 * r2),
        );
        let (prism_x, prism_y) = (2.0 * (s1 + 2.0 * s2 * r2), 2.0 * (s3 + 2.0 * s4 * r2));
        let across = 2.0 * (p1 * x + p2 * y);
        let by_x = DVec2::new(2.0 * p1 * y + 6.0 * p2 * x + prism_x * x, across + prism_y * x);
        let by_y = DVec2::new(across + prism_x * y, 6.0 * p1 * y + 2.0 * p2 * x + prism_y * y);
        (shift, DMat2::from_cols(by_x, by_y))
    }

    /// The inverse of [`Self::warp`] on the part of the image that hangs together with its center.
    fn unwarp(&self, target: DVec2) -> Result<DVec2, Unseen> {
        let mut q = DVec2::ZERO;
        for step in 1..=CONTINUATION_STEPS {
            let goal = target * (f64::from(step) / f64::from(CONTINUATION_STEPS));
            q = self.newton(q, goal).ok_or_else(|| self.fold_toward(target))?;
        }
        if self.is_unfolded(q) { Ok(q) } else { Err(self.fold_toward(target)) }
    }

    /// What it means that the image is folded over on the way to `target`.
    fn fold_toward(&self, target: DVec2) -> Unseen {
        let is_fisheye = self.projection == Projection::Equidistant;
        let is_rim = is_fisheye && self.is_unfolded(target.normalize_or_zero() * RIM);
        if is_rim { Unseen::Behind } else { Unseen::Folded }
    }

    fn newton(&self, mut q: DVec2, goal: DVec2) -> Option<DVec2> {
        for _ in 0..NEWTON_STEPS {
            let (value, derivative) = self.warp(q);
            let miss = value - goal;
            if miss.length() < 1e-13 * (1.0 + goal.length()) {
                return Some(q);
            }
            let determinant = derivative.determinant();
            if determinant.is_nan() || determinant < LEAST_DETERMINANT {
                return None;
            }
            q -= derivative.inverse() * miss;
        }
        ((self.warp(q).0 - goal).length() < 1e-9).then_some(q)
    }

    fn is_unfolded(&self, q: DVec2) -> bool {
        (0..=FOLD_SAMPLES).all(|i| {
            let (value, derivative) = self.warp(q * (f64::from(i) / f64::from(FOLD_SAMPLES)));
            value.is_finite() && derivative.determinant() > LEAST_DETERMINANT
        })
    }
}

/// The projection, and the coefficients up to the last that is not 0.
impl fmt::Display for Distortion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.projection)?;
        let groups: [(&str, &[f64]); 4] = [
            ("radial", &self.radial),
            ("divided by", &self.divisor),
            ("tangential", &self.tangential),
            ("prism", &self.prism),
        ];
        for (name, values) in groups {
            if let Some(last) = values.iter().rposition(|&value| value != 0.0) {
                write!(f, ", {name} {:?}", &values[..=last])?;
            }
        }
        Ok(())
    }
}
