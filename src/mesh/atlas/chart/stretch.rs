//! Evening out: descent of the symmetric Dirichlet energy, which keeps every triangle from turning over.
//!
//! Energy and steps: Smith, Schaefer: "Bijective parameterization with free boundaries", SIGGRAPH 2015. The gradient is taken through the
//! Laplacian, as in Kovalsky, Galun, Lipman: "Accelerated quadratic proxy for geometric optimization", SIGGRAPH 2016, with
//! conjugate directions instead of their acceleration.

use super::laplacian::Laplacian;
use super::patch::{Patch, PlanarTriangle};
use glam::DVec2;

/// Accuracy and most rounds of the linear system.
const ACCURACY: (f64, usize) = (0.1, 40);
/// A step goes at most this part of the way to where a triangle would collapse.
const SAFE: f64 = 0.8;
/// Energy must fall by this part of what the slope promises (Armijo).
const SUFFICIENT: f64 = 1e-3;
/// Shortest step that is tried, of the first one.
const SHORTEST: f64 = 1e-4;

/// Energy of a triangle per area: σ₁² + σ₂² + σ₁⁻² + σ₂⁻² of the map's singular values, 4 where it is rigid.
pub fn energy([by_x, by_y]: [DVec2; 2]) -> f64 {
    let det = by_x.perp_dot(by_y);
    let squares = by_x.length_squared() + by_y.length_squared();
    if det > 0.0 { squares * (1.0 + 1.0 / (det * det)) } else { f64::INFINITY }
}

/// The adjoint of the map's derivatives for [`energy`].
fn energy_gradient([by_x, by_y]: [DVec2; 2]) -> [DVec2; 2] {
    let det = by_x.perp_dot(by_y);
    let squares = by_x.length_squared() + by_y.length_squared();
    let (same, turned) = (2.0 * (1.0 + 1.0 / (det * det)), -2.0 * squares / det.powi(3));
    // det = by_x × by_y, so its derivatives are the other column, turned.
    [by_x * same - by_y.perp() * turned, by_y * same + by_x.perp() * turned]
}

/// A patch on its way into the plane.
pub(crate) struct Descent<'a> {
    patch: &'a Patch,
    shapes: &'a [PlanarTriangle],
    laplacian: &'a Laplacian,
}

impl<'a> Descent<'a> {
    /// The descent for a patch.
    pub fn new(patch: &'a Patch, shapes: &'a [PlanarTriangle], laplacian: &'a Laplacian) -> Self {
        Self { patch, shapes, laplacian }
    }

    fn jacobians(
        &self,
        map: &[DVec2],
    ) -> impl Iterator<Item = (&'a [u32; 3], &'a PlanarTriangle, [DVec2; 2])> {
        let triangles = self.patch.triangles.iter().zip(self.shapes);
        triangles.map(|(t, shape)| (t, shape, shape.jacobian(t.map(|v| map[v as usize]))))
    }

    /// Energy over the patch, divided by its area: at least 4; infinite if a triangle is turned over.
    pub fn mean_energy(&self, map: &[DVec2]) -> f64 {
        self.jacobians(map).map(|(_, shape, j)| shape.area * energy(j)).sum::<f64>() / self.patch.area
    }

    /// The adjoint of the map for [`Self::mean_energy`].
    pub fn gradient(&self, map: &[DVec2]) -> Vec<DVec2> {
        let mut sums = vec![DVec2::ZERO; map.len()];
        for (triangle, shape, j) in self.jacobians(map) {
            let weight = shape.area / self.patch.area;
            let corners = shape.pull_back(energy_gradient(j).map(|column| column * weight));
            triangle.iter().zip(corners).for_each(|(v, corner)| sums[*v as usize] += corner);
        }
        sums
    }

    /// Lowers the mean energy of a map without turned triangles in at most `rounds` steps, until one gains less than `enough` of what is above
    /// 4, or it is at most `good`. Returns the energy.
    pub fn run(&self, map: &mut Vec<DVec2>, rounds: usize, enough: f64, good: f64) -> f64 {
        let mut energy = self.mean_energy(map);
        let (mut direction, mut before): (Vec<DVec2>, Option<(Vec<DVec2>, f64)>) = (Vec::new(), None);
        let mut step = 0.25 * self.patch.area;
        for _ in 0..rounds {
            if energy <= good || !energy.is_finite() {
                break;
            }
            let gradient = self.gradient(map);
            let down = self.laplacian.solve(&gradient, ACCURACY.0, ACCURACY.1);
            let dot = |a: &[DVec2], b: &[DVec2]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
            let power = dot(&gradient, &down);
            // Polak–Ribière; steepest where that is no descent.
            let share = before.as_ref().map_or(0.0, |(last, power_before)| {
                ((power - dot(last, &down)) / power_before).clamp(0.0, 4.0)
            });
            direction.resize(map.len(), DVec2::ZERO);
            direction.iter_mut().zip(&down).for_each(|(d, down)| *d = *d * share - *down);
            let mut slope = dot(&gradient, &direction);
            if slope >= 0.0 {
                direction = down.iter().map(|d| -*d).collect();
                slope = -power;
            }
            let Some((found, length)) = self.search(map, &direction, energy, slope, step) else { break };
            let gain = (energy - found) / (energy - 4.0);
            (energy, step) = (found, 2.0 * length);
            before = Some((gradient, power));
            if gain < enough {
                break;
            }
        }
        energy
    }

    /// Goes along `direction`: the energy there and the length of the step; `None` if nothing is gained.
    fn search(
        &self,
        map: &mut Vec<DVec2>,
        direction: &[DVec2],
        energy: f64,
        slope: f64,
        first: f64,
    ) -> Option<(f64, f64)> {
        let mut step = first.min(SAFE * self.first_collapse(map, direction));
        while step > SHORTEST * first && slope < 0.0 {
            let there: Vec<DVec2> = map.iter().zip(direction).map(|(p, d)| *p + *d * step).collect();
            let found = self.mean_energy(&there);
            if found <= energy + SUFFICIENT * step * slope {
                *map = there;
                return Some((found, step));
            }
            step *= 0.5;
        }
        None
    }

    /// The shortest step along `direction` at which a triangle has no area.
    fn first_collapse(&self, map: &[DVec2], direction: &[DVec2]) -> f64 {
        let of_triangle = |triangle: &[u32; 3]| {
            let [p, q, r] = triangle.map(|v| map[v as usize]);
            let [dp, dq, dr] = triangle.map(|v| direction[v as usize]);
            let (u, v, du, dv) = (q - p, r - p, dq - dp, dr - dp);
            smallest_root(du.perp_dot(dv), u.perp_dot(dv) + du.perp_dot(v), u.perp_dot(v))
        };
        self.patch.triangles.iter().map(of_triangle).fold(f64::INFINITY, f64::min)
    }
}

/// The smallest positive root of a t² + b t + c with c > 0; infinite if there is none.
fn smallest_root(a: f64, b: f64, c: f64) -> f64 {
    let inside = b * b - 4.0 * a * c;
    if inside < 0.0 {
        return f64::INFINITY;
    }
    // Of the two forms of the roots, those without cancellation.
    let q = -0.5 * (b + inside.sqrt().copysign(b));
    let roots = [q / a, c / q];
    roots.into_iter().filter(|t| *t > 0.0).fold(f64::INFINITY, f64::min)
}
