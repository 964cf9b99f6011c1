//! The normal equations of a texel's albedo, sheen and tilt.
//!
//! With light, shape and specular lobes held, the radiance of a pixel is L = (ρ + g s + ρ̄ t · v⊥) u + L_s in the albedo ρ, the sheen s
//! ([`crate::material::sheen`]) and the tilt t ([`crate::material::tilt`]) of its texels, where g = 1 − c and u is the diffuse radiance
//! of a white surface. A pixel with residual r then says, for changes of the albedo, the sheen and the difference ρ̄ t between sides,
//!
//! δρ + g δs + ρ̄ δt · v⊥ = r / u.
//!
//! All channels share the weight, that of their mean radiance, and the direction of the tilt, so that weighted least squares over the
//! pixels of a texel needs 31 sums.

use crate::material::tilt::MOST_TILT;
use glam::{Mat2, Mat3, Vec2, Vec3};

/// What counts against a change of the albedo, in pixels that show the texel straight on and say that nothing changes.
const STILL_ALBEDO: f32 = 0.1;
/// What counts against a change of the sheen, likewise.
const STILL_SHEEN: f32 = 0.5;
/// The same, as a part of all that is known: an albedo along the surface that is hardly seen stays what it is.
const STILL_PART: f32 = 0.01;

/// Least part of the mean of the channels that a channel of the light counts with.
const LEAST_CHANNEL: f32 = 0.05;
/// Sum of the squared channels of an albedo below which it has no tilt.
pub(crate) const LEAST_COLOR: f32 = 1e-4;
/// What counts against a tilt, likewise.
const STILL_TILT: f32 = 0.3;

/// What changes at a texel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct TexelChange {
    /// Change of the albedo.
    pub albedo: Vec3,
    /// Change of the sheen.
    pub sheen: Vec3,
    /// Change of the tilt.
    pub tilt: Vec3,
}

/// Sums over the pixels that show a texel, with weights w u², where u is the mean of the channels; the unknowns of a channel are those
/// of the functions 1, g and v⊥ of the view direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct TexelEquations {
    /// 1, g, g².
    one_along: [f32; 3],
    /// v⊥, g v⊥.
    side: [Vec3; 2],
    /// v⊥ v⊥ᵀ: xx, yy, zz and xy, xz, yz.
    side_side: [Vec3; 2],
    /// r / u, g r / u by channel.
    changes: [Vec3; 2],
    /// v⊥ r / u for each channel.
    side_changes: [Vec3; 3],
    /// w.
    seen: f32,
}

impl TexelEquations {
    /// Adds a pixel of this weight: diffuse radiance `unit` of a white surface, g = `along`, v⊥ = `side`, and observed minus predicted
    /// radiance.
    #[inline]
    pub fn add(&mut self, unit: Vec3, along: f32, side: Vec3, residual: Vec3, weight: f32) {
        let gray = unit.element_sum() / 3.0;
        // A light that lacks a channel says nothing about it.
        let change = residual / unit.max(Vec3::splat(LEAST_CHANNEL * gray));
        if !change.is_finite() {
            return;
        }
        let w = weight * gray * gray;
        self.seen += weight;
        self.one_along =
            [self.one_along[0] + w, self.one_along[1] + w * along, self.one_along[2] + w * along * along];
        let (sided, swapped) = (side * w, Vec3::new(side.x, side.x, side.y));
        self.side[0] += sided;
        self.side[1] += sided * along;
        self.side_side[0] += sided * side;
        self.side_side[1] += swapped * Vec3::new(sided.y, sided.z, sided.z);
        self.changes[0] += change * w;
        self.changes[1] += change * (w * along);
        (0..3).for_each(|c| self.side_changes[c] += sided * change[c]);
    }

    /// Sum of the weights of the pixels that show the texel.
    pub fn seen(&self) -> f32 {
        self.seen
    }

    /// The changes that explain most of the residuals. Without `sheen` it stays; so does the tilt without the mean albedo and the tilt
    /// `before`.
    pub fn solve(&self, sheen: bool, before: Option<(Vec3, Vec3)>) -> TexelChange {
        let one = self.one_along[0] / self.seen;
        if one.is_nan() || one <= 0.0 {
            return TexelChange::default();
        }
        let colors = self.inverse_of_colors(one, sheen);
        let (color, tilt) = before.map_or_else(Default::default, |(color, tilt)| {
            (color, self.solve_tilt(colors, STILL_TILT * one, color, tilt))
        });
        let solved = |c: usize| colors * (self.change(c) - self.toward(tilt) * color[c]);
        let solved: [Vec2; 3] = std::array::from_fn(solved);
        let [albedo, sheen] = [0, 1].map(|unknown| Vec3::from_array(solved.map(|change| change[unknown])));
        TexelChange { albedo, sheen, tilt }
    }

    /// The change of the tilt, where albedo and sheen of each channel follow it (their Schur complement).
    fn solve_tilt(&self, colors: Mat2, still: f32, color: Vec3, tilt: Vec3) -> Vec3 {
        let power = color.length_squared();
        if power < LEAST_COLOR {
            return Vec3::ZERO;
        }
        let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| self.back(colors * self.toward(axis)));
        let matrix = self.sides() - Mat3::from_cols(x, y, z) + Mat3::from_diagonal(Vec3::splat(still));
        let left = |c: usize| self.side_changes[c] - self.back(colors * self.change(c));
        let explained: Vec3 = (0..3).map(|c| left(c) * color[c]).sum();
        let change = matrix.inverse() * (explained / power - tilt * still);
        // Albedo and sheen then explain what a tilt within its bound does not.
        if change.is_finite() { (tilt + change).clamp_length_max(MOST_TILT) - tilt } else { Vec3::ZERO }
    }

    /// The matrix of v⊥ v⊥ᵀ.
    fn sides(&self) -> Mat3 {
        let [[xx, yy, zz], [xy, xz, yz]] = self.side_side.map(|part| part.to_array());
        Mat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
    }

    /// What a tilt is to the equations of albedo and sheen.
    fn toward(&self, tilt: Vec3) -> Vec2 {
        Vec2::new(self.side[0].dot(tilt), self.side[1].dot(tilt))
    }

    /// What albedo and sheen are to the equations of the tilt.
    fn back(&self, colors: Vec2) -> Vec3 {
        self.side[0] * colors.x + self.side[1] * colors.y
    }

    /// The right side of the equations of albedo and sheen of channel `c`.
    fn change(&self, c: usize) -> Vec2 {
        Vec2::new(self.changes[0][c], self.changes[1][c])
    }

    /// The inverse of the part of the matrix that albedo and sheen have.
    fn inverse_of_colors(&self, one: f32, sheen: bool) -> Mat2 {
        let [a, b, d] = self.one_along;
        let (a, d) = (a + STILL_ALBEDO * one, d + STILL_SHEEN * one + STILL_PART * a);
        if !sheen {
            return Mat2::from_diagonal(Vec2::new(1.0 / a, 0.0));
        }
        let determinant = (a * d - b * b).max(1e-6 * a * d);
        Mat2::from_cols_array(&[d, -b, -b, a]) * (1.0 / determinant)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLOR: Vec3 = Vec3::new(0.5, 0.3, 0.2);

    /// Pixel `i` of a texel whose normal is +Z: g and v⊥ of a view up to `most` from straight on, as a part of the hemisphere.
    fn view(i: u32, most: f32) -> (f32, Vec3) {
        let along = most * (i * 29 % 100) as f32 / 100.0;
        let sine = (1.0 - (1.0 - along) * (1.0 - along)).sqrt();
        let angle = i as f32 * 2.399_963;
        (along, Vec3::new(angle.cos(), angle.sin(), 0.0) * sine)
    }

    /// Many pixels of a texel that changes by this.
    fn equations(change: TexelChange, most_along: f32) -> TexelEquations {
        let mut sums = TexelEquations::default();
        for i in 0..4000 {
            let (along, side) = view(i, most_along);
            let unit = Vec3::new(0.5, 0.7, 1.1) * (0.6 + 0.01 * (i % 37) as f32);
            let residual = change.albedo + change.sheen * along + COLOR * change.tilt.dot(side);
            sums.add(unit, along, side, residual * unit, 1.0);
        }
        sums
    }

    fn albedo(albedo: Vec3) -> TexelChange {
        TexelChange { albedo, ..TexelChange::default() }
    }

    #[test]
    fn residuals_that_the_model_can_explain_are_explained() {
        let truth = TexelChange {
            albedo: Vec3::new(0.2, -0.1, 0.3),
            sheen: Vec3::new(-0.3, 0.2, 0.1),
            tilt: Vec3::new(0.4, -0.2, 0.0),
        };
        let found = equations(truth, 1.0).solve(true, Some((COLOR, Vec3::ZERO)));
        assert!((found.albedo - truth.albedo).abs().max_element() < 0.02, "{found:?}");
        assert!((found.sheen - truth.sheen).abs().max_element() < 0.05, "{found:?}");
        assert!((found.tilt - truth.tilt).abs().max_element() < 0.01, "{found:?}");
        let found = equations(albedo(truth.albedo), 1.0).solve(false, None);
        assert!((found.albedo - truth.albedo).abs().max_element() < 1e-3, "{found:?}");
        assert_eq!((found.sheen, found.tilt), (Vec3::ZERO, Vec3::ZERO));
    }

    #[test]
    fn what_is_hardly_seen_does_not_change() {
        let found = equations(albedo(Vec3::splat(0.2)), 0.02).solve(true, Some((COLOR, Vec3::ZERO)));
        assert!(found.sheen.abs().max_element() < 0.02, "{found:?}");
        // From one side only, a brighter albedo explains what a tilt does.
        let mut sums = TexelEquations::default();
        for _ in 0..3 {
            sums.add(Vec3::ONE, 0.1, Vec3::X * 0.4, COLOR * 0.2, 1.0);
        }
        let found = sums.solve(false, Some((COLOR, Vec3::ZERO)));
        assert!(found.albedo.length() > 0.5 * (COLOR * 0.2).length(), "{found:?}");
        assert!(found.tilt.length() < 0.25, "{found:?}");
    }

    #[test]
    fn a_tilt_that_nothing_supports_goes() {
        let found = equations(TexelChange::default(), 1.0).solve(true, Some((COLOR, Vec3::Z * 0.5)));
        assert!((found.tilt.z + 0.5).abs() < 1e-3, "a tilt along the normal is not seen: {found:?}");
    }

    #[test]
    fn a_texel_that_is_not_seen_not_lit_or_black_has_no_tilt() {
        let before = Some((COLOR, Vec3::ZERO));
        assert_eq!(TexelEquations::default().solve(true, before), TexelChange::default());
        let mut dark = TexelEquations::default();
        dark.add(Vec3::ZERO, 0.5, Vec3::X, Vec3::ONE, 1.0);
        assert_eq!(dark.solve(true, before), TexelChange::default());
        let black = equations(albedo(Vec3::splat(0.1)), 1.0).solve(true, Some((Vec3::ZERO, Vec3::ZERO)));
        assert_eq!(black.tilt, Vec3::ZERO);
    }

    #[test]
    fn the_change_is_the_least_squares_solution() {
        // The gradient of the sum of squares vanishes there, but for what counts against a change.
        let rows = [(0.5, 0.03, 1.0), (0.8, -0.02, 2.0), (0.3, 0.01, 0.5), (0.6, 0.04, 1.5)];
        let mut sums = TexelEquations::default();
        for (i, &(u, r, w)) in (0..).zip(&rows) {
            let (along, side) = view(40 + 7 * i, 1.0);
            sums.add(Vec3::splat(u), along, side, Vec3::splat(r), w);
        }
        let one = rows.iter().map(|(u, _, w)| w * u * u).sum::<f32>() / sums.seen();
        let color = Vec3::splat(0.4);
        let found = sums.solve(true, Some((color, Vec3::ZERO)));
        let by = |weight: &dyn Fn(f32, Vec3) -> f32| -> f32 {
            let row = |(i, &(u, r, w)): (u32, &(f32, f32, f32))| {
                let (g, v) = view(40 + 7 * i, 1.0);
                let change = found.albedo.x + found.sheen.x * g + color.x * found.tilt.dot(v);
                w * u * weight(g, v) * (r - change * u)
            };
            (0..).zip(&rows).map(row).sum()
        };
        assert!((by(&|_, _| 1.0) - STILL_ALBEDO * one * found.albedo.x).abs() < 1e-4);
        let all = one * sums.seen();
        assert!((by(&|g, _| g) - (STILL_SHEEN * one + STILL_PART * all) * found.sheen.x).abs() < 1e-4);
        assert!(
            (by(&|_, v| color.x * v.x) - color.x * color.x * STILL_TILT * one * found.tilt.x).abs() < 1e-4
        );
    }
}
