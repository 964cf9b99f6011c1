//! The albedo that follows the light: eliminated from a solve for amplitudes, as in variable
//! projection (Golub and Pereyra 1973).
//!
//! Pixels show y, lobes of unit amplitude add R x, and a change u of the logarithm l of a texel's
//! albedo adds w u, w its diffuse radiance. In
//!
//! Σ (y − R x − w u)² + Σ pᵢⱼ (lᵢ + uᵢ − lⱼ − uⱼ)² + g Σ (lᵢ + uᵢ − ln a)²,
//!
//! sums over pixels, pairs of near texels, and texels, the best change is M⁻¹ (h − B x): M is
//! diag(Σ w² + g) and the Laplacian of p, B sums w R, and h sums w y and what the priors pull. So the
//! normal equations lose Bᵀ M⁻¹ B, and their right side Bᵀ M⁻¹ h.
//!
//! The priors: near texels have the same paint but at edges, a total variation of l with weights
//! from the albedo until now; and a usual paint is gray, a = 0.4. Shading changes from texel to texel
//! as well, and this tells the light where nothing shines.

use glam::Vec3;
use lobelia_geometry::parallel;
use lobelia_sg::linear::conjugate_gradients;
use lobelia_world::material::USUAL_ALBEDO;

/// Near texels that each is held to.
const NEAR: usize = 6;
/// Weight of the variation of l, in pixels of mean w², for the near texels that a texel chooses; a
/// pair of which both choose each other counts twice.
const VARIATION: f32 = 2.0;
/// Differences well below this are held by a square.
const KINK: f32 = 0.03;
/// Weight g of the prior at a usual albedo, in pixels of mean w².
const GRAY: f32 = 2.0;
/// Least albedo whose logarithm is taken.
const DARKEST: f32 = 0.02;

/// Sums over the pixels of each texel, in one channel.
#[derive(Default)]
pub(super) struct TexelSums {
    /// Of w².
    pub squares: Vec<f32>,
    /// Of w y.
    pub targets: Vec<f32>,
    /// Of w R: all lobes of a texel after each other.
    pub responses: Vec<f32>,
}

/// What is known of the paint of texels before photographs are looked at.
pub(super) struct Paints {
    logs: Vec<Vec3>,
    /// The near texels of each, and the weights of the pairs.
    near: Vec<Vec<(usize, f32)>>,
    gray: f32,
}

impl Paints {
    /// Of texels at these places, world units, with this albedo until now; `pixel` is the mean w².
    pub fn new(places: &[Vec3], albedo: &[Vec3], pixel: f32) -> Self {
        let logs: Vec<Vec3> = albedo.iter().map(|a| a.max(Vec3::splat(DARKEST)).map(f32::ln)).collect();
        let nearest = |i: usize| -> Vec<usize> {
            let squared = |j: usize| (places[i].distance_squared(places[j]), j);
            let mut near: Vec<(f32, usize)> = (0..places.len()).filter(|j| *j != i).map(squared).collect();
            if near.len() > NEAR {
                near.select_nth_unstable_by(NEAR, |a, b| a.0.total_cmp(&b.0));
                near.truncate(NEAR);
            }
            near.into_iter().map(|(_, j)| j).collect()
        };
        let mut near = vec![Vec::new(); places.len()];
        for (i, found) in parallel::map(places.len(), 16, nearest).into_iter().enumerate() {
            for j in found {
                let apart = (logs[i] - logs[j]).length_squared();
                let weight = pixel * VARIATION / NEAR as f32 / (apart + KINK * KINK).sqrt();
                near[i].push((j, weight));
                near[j].push((i, weight));
            }
        }
        Self { logs, near, gray: (GRAY * pixel).max(1e-20) }
    }

    /// Takes from the normal equations of a channel what the albedo can explain.
    pub fn eliminate(&self, c: usize, sums: &TexelSums, (matrix, right): &mut (Vec<f64>, Vec<f64>)) {
        let (texels, lobes) = (self.logs.len(), right.len());
        let of_pairs = |i: usize, value: &dyn Fn(usize) -> f32| -> f32 {
            self.near[i].iter().map(|(j, weight)| weight * value(*j)).sum()
        };
        let own: Vec<f32> =
            (0..texels).map(|i| sums.squares[i] + self.gray + of_pairs(i, &|_| 1.0)).collect();
        let scale: Vec<f32> = own.iter().map(|own| own.recip()).collect();
        let apply =
            |u: &[f32]| (0..texels).map(|i| own[i] * u[i] - of_pairs(i, &|j| u[j])).collect::<Vec<f32>>();
        let pulled = |i: usize| {
            let log = self.logs[i][c];
            let gray = self.gray * (USUAL_ALBEDO.ln() - log);
            sums.targets[i] + gray + of_pairs(i, &|j| self.logs[j][c] - log)
        };
        let column = |k: usize| -> Vec<f32> {
            let of_texel = |i: usize| if k < lobes { sums.responses[i * lobes + k] } else { pulled(i) };
            (0..texels).map(of_texel).collect()
        };
        let solved =
            parallel::map(lobes + 1, 1, |k| conjugate_gradients(apply, column(k), &scale, 1e-10, 200));
        // Up to the diagonal, and last of the right side.
        let explained = parallel::map(lobes, 1, |k| {
            let column = column(k);
            let with = |x: &[f32]| column.iter().zip(x).map(|(a, b)| f64::from(a * b)).sum::<f64>();
            solved[..=k].iter().chain(&solved[lobes..]).map(|x| with(x)).collect::<Vec<f64>>()
        });
        for (k, line) in explained.iter().enumerate() {
            right[k] -= line[k + 1];
            for j in 0..=k {
                matrix[k * lobes + j] -= line[j];
                matrix[j * lobes + k] = matrix[k * lobes + j];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_sg::linear::{cholesky, solve_factored};

    #[test]
    fn amplitudes_are_those_of_a_solve_for_both() {
        // Three lobes, 24 pixels of eight texels on a line: the equations of x and u together.
        let (lobes, texels, pixels) = (3, 8, 24);
        let wave = |k: usize, i: usize| 0.6 + 0.5 * (1.7 * (k * (i + 1)) as f32).sin();
        let places: Vec<Vec3> = (0..texels).map(|i| Vec3::X * i as f32 * wave(i, 1)).collect();
        let albedo: Vec<Vec3> = (0..texels).map(|i| Vec3::splat(wave(i, 7))).collect();
        let paints = Paints::new(&places, &albedo, 0.3);
        let n = lobes + texels;
        let mut both = (vec![0.0; n * n], vec![0.0; n]);
        let mut add = |row: &[(usize, f32)], target: f32, weight: f32| {
            for (i, a) in row {
                row.iter().for_each(|(j, b)| both.0[i * n + j] += f64::from(weight * a * b));
                both.1[*i] += f64::from(weight * a * target);
            }
        };
        let mut sums = TexelSums::default();
        (sums.squares, sums.targets) = (vec![0.0; texels], vec![0.0; texels]);
        sums.responses = vec![0.0; texels * lobes];
        let mut system = (vec![0.0; lobes * lobes], vec![0.0; lobes]);
        for k in 0..pixels {
            let (t, w, y) = (k / 3, wave(k, 4), wave(k, 5));
            let responses: Vec<(usize, f32)> = (0..lobes).map(|i| (i, wave(k, i))).collect();
            add(&[responses.as_slice(), &[(lobes + t, w)]].concat(), y, 1.0);
            sums.squares[t] += w * w;
            sums.targets[t] += w * y;
            for (i, a) in &responses {
                sums.responses[t * lobes + i] += w * a;
                system.1[*i] += f64::from(a * y);
                responses.iter().for_each(|(j, b)| system.0[i * lobes + j] += f64::from(a * b));
            }
        }
        let logs = &paints.logs;
        for (i, near) in paints.near.iter().enumerate() {
            // Each pair is in the lists of both.
            for (j, weight) in near {
                add(&[(lobes + i, 1.0), (lobes + j, -1.0)], logs[*j].x - logs[i].x, 0.5 * weight);
            }
            add(&[(lobes + i, 1.0)], USUAL_ALBEDO.ln() - logs[i].x, paints.gray);
        }
        paints.eliminate(0, &sums, &mut system);
        assert!(cholesky(&mut both.0, n) && cholesky(&mut system.0, lobes));
        solve_factored(&both.0, &mut both.1);
        solve_factored(&system.0, &mut system.1);
        for (x, of_both) in system.1.iter().zip(&both.1) {
            assert!((x - of_both).abs() < 1e-3 * of_both.abs().max(1.0), "{x} {of_both}");
        }
    }
}
