//! The normal equations of a texel's albedo and sheen.
//!
//! With light, shape and specular lobes held, the radiance of a pixel is linear in the albedo ρ and the sheen s of its texels
//! ([`crate::material::sheen`]): L = (ρ + g s) u + L_s, where g = 1 − c and u is the diffuse radiance of a white surface. A pixel with
//! residual r then says (δρ + g δs) u = r for the change of its texels. Weighted least squares over the pixels of a texel needs six
//! sums a channel.

use glam::Vec3;

/// What counts against a change of the albedo, in pixels that show the texel straight on and say that nothing changes.
const STILL_ALBEDO: f32 = 0.1;
/// What counts against a change of the sheen, likewise.
const STILL_SHEEN: f32 = 0.5;
/// The same, as a part of all that is known: an albedo along the surface that is hardly seen stays what it is.
const STILL_PART: f32 = 0.01;

/// Sums over the pixels that show a texel, by channel, with weights w.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TexelEquations {
    /// w u², w u² g, w u² g².
    uu: [Vec3; 3],
    /// w u r, w u g r.
    ur: [Vec3; 2],
    /// w.
    seen: f32,
}

impl TexelEquations {
    /// Adds a pixel of this weight: diffuse radiance `unit` of a white surface, g = `along`, and observed minus predicted radiance.
    #[inline]
    pub fn add(&mut self, unit: Vec3, along: f32, residual: Vec3, weight: f32) {
        let (uu, ur) = (unit * unit * weight, unit * residual * weight);
        self.uu[0] += uu;
        self.uu[1] += uu * along;
        self.uu[2] += uu * (along * along);
        self.ur[0] += ur;
        self.ur[1] += ur * along;
        self.seen += weight;
    }

    /// Sum of the weights of the pixels that show the texel.
    pub fn seen(&self) -> f32 {
        self.seen
    }

    /// The changes of albedo and sheen that explain most of the residuals; of the albedo alone without `sheen`.
    pub fn solve(&self, sheen: bool) -> [Vec3; 2] {
        if self.seen <= 0.0 {
            return [Vec3::ZERO; 2];
        }
        let by_channel: [[f32; 2]; 3] = std::array::from_fn(|c| self.solve_channel(c, sheen));
        [0, 1].map(|unknown| Vec3::from_array(by_channel.map(|change| change[unknown])))
    }

    fn solve_channel(&self, c: usize, sheen: bool) -> [f32; 2] {
        let one = self.uu[0][c] / self.seen;
        let a = self.uu[0][c] + STILL_ALBEDO * one;
        if a <= 0.0 {
            return [0.0; 2];
        }
        let (x, y) = (self.ur[0][c], self.ur[1][c]);
        if !sheen {
            return [x / a, 0.0];
        }
        let b = self.uu[1][c];
        let d = self.uu[2][c] + STILL_SHEEN * one + STILL_PART * self.uu[0][c];
        let determinant = (a * d - b * b).max(1e-6 * a * d);
        [(d * x - b * y) / determinant, (a * y - b * x) / determinant]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Many pixels of a texel with these residuals of albedo and sheen.
    fn equations(albedo: Vec3, sheen: Vec3, most_along: f32) -> TexelEquations {
        let mut sums = TexelEquations::default();
        for i in 0..4000 {
            let along = most_along * (i * 29 % 100) as f32 / 100.0;
            let unit = Vec3::new(0.5, 0.7, 1.1) * (0.6 + 0.01 * (i % 37) as f32);
            sums.add(unit, along, (albedo + sheen * along) * unit, 1.0);
        }
        sums
    }

    #[test]
    fn residuals_that_the_model_can_explain_are_explained() {
        let (albedo, sheen) = (Vec3::new(0.2, -0.1, 0.3), Vec3::new(-0.3, 0.2, 0.1));
        let [found, along] = equations(albedo, sheen, 1.0).solve(true);
        assert!((found - albedo).abs().max_element() < 0.02, "{found}");
        assert!((along - sheen).abs().max_element() < 0.05, "{along}");
        let [found, along] = equations(albedo, Vec3::ZERO, 1.0).solve(false);
        assert!((found - albedo).abs().max_element() < 1e-3, "{found}");
        assert_eq!(along, Vec3::ZERO);
    }

    #[test]
    fn a_sheen_that_is_hardly_seen_does_not_change() {
        let [_, along] = equations(Vec3::splat(0.2), Vec3::ZERO, 0.02).solve(true);
        assert!(along.abs().max_element() < 0.02, "{along}");
    }

    #[test]
    fn a_texel_that_is_not_seen_or_not_lit_does_not_change() {
        assert_eq!(TexelEquations::default().solve(true), [Vec3::ZERO; 2]);
        let mut dark = TexelEquations::default();
        dark.add(Vec3::ZERO, 0.5, Vec3::ONE, 1.0);
        assert_eq!(dark.solve(true), [Vec3::ZERO; 2]);
    }

    #[test]
    fn the_change_is_the_least_squares_solution() {
        // The gradient of the sum of squares vanishes there, but for what counts against a change.
        let rows = [(0.5, 0.1, 0.3, 1.0), (0.8, 0.7, -0.2, 2.0), (0.3, 0.4, 0.1, 0.5)];
        let mut sums = TexelEquations::default();
        rows.iter().for_each(|&(u, g, r, w)| sums.add(Vec3::splat(u), g, Vec3::splat(r), w));
        let one = rows.iter().map(|(u, _, _, w)| w * u * u).sum::<f32>() / sums.seen();
        let all = one * sums.seen();
        let [a, s] = sums.solve(true).map(|change| change.x);
        let by = |weight: fn(f32) -> f32| -> f32 {
            rows.iter().map(|&(u, g, r, w)| w * u * weight(g) * (r - (a + s * g) * u)).sum()
        };
        assert!((by(|_| 1.0) - STILL_ALBEDO * one * a).abs() < 1e-5);
        assert!((by(|g| g) - (STILL_SHEEN * one + STILL_PART * all) * s).abs() < 1e-5);
    }
}
