//! From a patch to a chart: its vertices in the plane.
//!
//! A patch is seen along its mean normal. If triangles face away, the view is unfolded until none
//! does; then the map is evened out. It counts if its distortion is small, and if it covers no
//! point twice.
//!
//! Unfolding keeps each triangle's shape, by turns of triangles and one linear system (Liu, Zhang,
//! Xu, Gotsman, Gortler: "A local/global approach to mesh parameterization", SGP 2008: ARAP).
//! Evening out is a descent of the symmetric Dirichlet energy, which keeps every triangle from
//! turning over. Energy and steps: Smith, Schaefer: "Bijective parameterization with free
//! boundaries", SIGGRAPH 2015. The gradient is taken through the Laplacian, as in Kovalsky, Galun,
//! Lipman: "Accelerated quadratic proxy for geometric optimization", SIGGRAPH 2016, with conjugate
//! directions instead of their acceleration.

use super::{Patch, PlanarTriangle, area_in_plane, loops};
use glam::{DVec2, DVec3};

/// Largest part of the area that may face away from the view.
const MOST_HIDDEN: f64 = 0.3;
/// Rounds of unfolding.
const UNFOLDING_ROUNDS: usize = 4;
/// Rounds of moving vertices of the last turned triangles between their neighbors.
const UNTANGLING_ROUNDS: usize = 16;
/// Steps of evening out; the least part of the rest that a step must gain; an energy that is good
/// enough.
const EVENING: (usize, f64, f64) = (16, 0.02, 4.02);
/// Accuracy and most rounds of the linear system of unfolding.
const UNFOLDING_ACCURACY: (f64, usize) = (0.05, 40);
/// Accuracy and most rounds of the linear system of evening out.
const EVENING_ACCURACY: (f64, usize) = (0.1, 40);
/// A step goes at most this part of the way to where a triangle would collapse.
const SAFE: f64 = 0.8;
/// Energy must fall by this part of what the slope promises (Armijo).
const SUFFICIENT: f64 = 1e-3;
/// Shortest step that is tried, of the first one.
const SHORTEST: f64 = 1e-4;
/// Bounds of an edge's weight of the Laplacian: positive, so that the matrix is semidefinite, and
/// finite at slivers.
const WEIGHTS: (f64, f64) = (0.02, 20.0);
/// Most cells of the grid along a side.
const MOST_CELLS: f64 = 512.0;
/// A hole that has turned inside out by less than this part of the outer loop's area is a slit.
const SLIT: f64 = 1e-9;

/// How much a chart may be distorted.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// Largest mean energy ([`energy`]); 4 is rigid, 4.5 squares that become rectangles of 1 by
    /// 1.64.
    pub mean: f64,
    /// Largest part of the area whose triangles become more than twice as large, or less than half.
    pub uneven: f64,
}

/// The patch in the plane, as large as in the world and not mirrored: one place for each vertex,
/// world units. `None` if it has no border, has handles, or cannot lie flat within the tolerance
/// without triangles that are turned over or parts that overlap.
pub fn flatten(patch: &Patch, tolerance: &Tolerance) -> Option<Vec<DVec2>> {
    let mut map = patch.view();
    let is_hidden = |j: [DVec2; 2]| !energy(j).is_finite();
    if !patch.is_planar() || patch.part(&map, is_hidden) > MOST_HIDDEN {
        return None;
    }
    let laplacian = Laplacian::new(patch);
    for _ in 0..UNFOLDING_ROUNDS {
        if patch.part(&map, is_hidden) == 0.0 {
            break;
        }
        patch.unfold(&laplacian, &mut map);
    }
    patch.untangle(&laplacian, &mut map);
    let found = patch.even_out(&laplacian, &mut map, EVENING);
    // As large as the patch.
    let factor = (patch.area / area_in_plane(&patch.triangles, &map)).sqrt();
    map.iter_mut().for_each(|p| *p *= factor);
    let is_uneven = |[by_x, by_y]: [DVec2; 2]| !(0.5..=2.0).contains(&by_x.perp_dot(by_y));
    (found <= tolerance.mean
        && factor.is_normal()
        && patch.part(&map, is_uneven) <= tolerance.uneven
        && is_simple(&patch.border, &map))
    .then_some(map)
}

/// Energy of a triangle per area: σ₁² + σ₂² + σ₁⁻² + σ₂⁻² of the map's singular values, 4 where it
/// is rigid.
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

/// On the way into the plane.
impl Patch {
    /// The vertices along the patch's mean normal.
    fn view(&self) -> Vec<DVec2> {
        let normal = self.area_vector.try_normalize().unwrap_or(DVec3::Z);
        let (right, up) = normal.any_orthonormal_pair();
        let first = self.points[0];
        // Counter-clockwise triangles stay so: (right, up, normal) is right-handed.
        self.points.iter().map(|p| DVec2::new((*p - first).dot(right), (*p - first).dot(up))).collect()
    }

    /// Each triangle, its shape, and the derivatives of the map there.
    fn jacobians(&self, map: &[DVec2]) -> impl Iterator<Item = (&[u32; 3], &PlanarTriangle, [DVec2; 2])> {
        let triangles = self.triangles.iter().zip(&self.shapes);
        triangles.map(|(t, shape)| (t, shape, shape.jacobian(t.map(|v| map[v as usize]))))
    }

    /// The part of the patch's area in triangles whose derivatives are such.
    fn part(&self, map: &[DVec2], is_such: impl Fn([DVec2; 2]) -> bool) -> f64 {
        let areas = self.jacobians(map).map(|(_, shape, j)| if is_such(j) { shape.area } else { 0.0 });
        areas.sum::<f64>() / self.area
    }

    /// One round of unfolding: turns each triangle to fit the map as it is, and moves the vertices
    /// to where these turned triangles meet best.
    fn unfold(&self, laplacian: &Laplacian, map: &mut [DVec2]) {
        let mut force = vec![DVec2::ZERO; map.len()];
        for (triangle, shape, [by_x, by_y]) in self.jacobians(map) {
            // The turn nearest to J has its first column along (J₀₀ + J₁₁, J₁₀ − J₀₁).
            let turn = DVec2::new(by_x.x + by_y.y, by_x.y - by_y.x).try_normalize().unwrap_or(DVec2::X);
            let off = [turn - by_x, turn.perp() - by_y];
            let corners = shape.pull_back(off.map(|column| column * shape.area));
            triangle.iter().zip(corners).for_each(|(v, corner)| force[*v as usize] += corner);
        }
        let moves = laplacian.solve(&force, UNFOLDING_ACCURACY.0, UNFOLDING_ACCURACY.1);
        map.iter_mut().zip(moves).for_each(|(place, by)| *place += by);
    }

    /// Moves vertices of turned triangles to the middle of their neighbors, until there are none or
    /// the rounds are over.
    fn untangle(&self, laplacian: &Laplacian, map: &mut [DVec2]) {
        for _ in 0..UNTANGLING_ROUNDS {
            let turned = self.jacobians(map).filter(|(.., j)| !energy(*j).is_finite());
            let mut vertices: Vec<u32> = turned.flat_map(|(t, ..)| *t).collect();
            if vertices.is_empty() {
                return;
            }
            vertices.sort_unstable();
            vertices.dedup();
            for vertex in vertices {
                let around = &laplacian.edges[vertex as usize];
                let sum: DVec2 = around.iter().map(|(other, _)| map[*other as usize]).sum();
                map[vertex as usize] = sum / around.len() as f64;
            }
        }
    }

    /// Energy over the patch, divided by its area: at least 4; infinite if a triangle is turned
    /// over.
    pub fn mean_energy(&self, map: &[DVec2]) -> f64 {
        self.jacobians(map).map(|(_, shape, j)| shape.area * energy(j)).sum::<f64>() / self.area
    }

    /// The adjoint of the map for [`Self::mean_energy`].
    pub fn gradient(&self, map: &[DVec2]) -> Vec<DVec2> {
        let mut sums = vec![DVec2::ZERO; map.len()];
        for (triangle, shape, j) in self.jacobians(map) {
            let weight = shape.area / self.area;
            let corners = shape.pull_back(energy_gradient(j).map(|column| column * weight));
            triangle.iter().zip(corners).for_each(|(v, corner)| sums[*v as usize] += corner);
        }
        sums
    }

    /// Lowers the mean energy of a map without turned triangles in at most `rounds` steps, until
    /// one gains less than `enough` of what is above 4, or it is at most `good`. Returns the
    /// energy.
    pub fn even_out(
        &self,
        laplacian: &Laplacian,
        map: &mut Vec<DVec2>,
        (rounds, enough, good): (usize, f64, f64),
    ) -> f64 {
        let mut energy = self.mean_energy(map);
        let (mut direction, mut before): (Vec<DVec2>, Option<(Vec<DVec2>, f64)>) = (Vec::new(), None);
        let mut step = 0.25 * self.area;
        for _ in 0..rounds {
            if energy <= good || !energy.is_finite() {
                break;
            }
            let gradient = self.gradient(map);
            let down = laplacian.solve(&gradient, EVENING_ACCURACY.0, EVENING_ACCURACY.1);
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

    /// Goes along `direction`: the energy there and the length of the step; `None` if nothing is
    /// gained.
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
            // The smallest positive root of a t² + b t + c with c > 0, if there is one: of the two
            // forms of the roots, those without cancellation.
            let (a, b, c) = (du.perp_dot(dv), u.perp_dot(dv) + du.perp_dot(v), u.perp_dot(v));
            let inside = b * b - 4.0 * a * c;
            if inside < 0.0 {
                return f64::INFINITY;
            }
            let q = -0.5 * (b + inside.sqrt().copysign(b));
            [q / a, c / q].into_iter().filter(|t| *t > 0.0).fold(f64::INFINITY, f64::min)
        };
        self.triangles.iter().map(of_triangle).fold(f64::INFINITY, f64::min)
    }
}

/// The cotangent Laplacian of a patch (Pinkall, Polthier: "Computing discrete minimal surfaces and
/// their conjugates", Experimental Mathematics 2, 1993), as rows of edges: a symmetric matrix with
/// the sums of its rows zero.
#[derive(Debug)]
pub struct Laplacian {
    /// The edges of each vertex: the other vertex, and the weight.
    pub edges: Vec<Vec<(u32, f64)>>,
    /// Sum of the weights of each vertex's edges.
    diagonal: Vec<f64>,
}

impl Laplacian {
    /// The matrix of a patch; half the quadratic form is the Dirichlet energy, but for bounds of
    /// the weights.
    pub fn new(patch: &Patch) -> Self {
        let mut edges: Vec<Vec<(u32, f64)>> = vec![Vec::with_capacity(8); patch.points.len()];
        let mut add = |from: u32, to: u32, weight: f64| {
            let row = &mut edges[from as usize];
            match row.iter_mut().find(|(other, _)| *other == to) {
                Some((_, sum)) => *sum += weight,
                None => row.push((to, weight)),
            }
        };
        for (triangle, shape) in patch.triangles.iter().zip(&patch.shapes) {
            let corners = shape.corners();
            for k in 0..3 {
                let [a, b] = [corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]];
                let half_cotangent = 0.25 * a.dot(b) / shape.area;
                let (from, to) = (triangle[(k + 1) % 3], triangle[(k + 2) % 3]);
                add(from, to, half_cotangent);
                add(to, from, half_cotangent);
            }
        }
        edges.iter_mut().flatten().for_each(|(_, weight)| *weight = weight.clamp(WEIGHTS.0, WEIGHTS.1));
        let diagonal = edges.iter().map(|row| row.iter().map(|(_, weight)| weight).sum()).collect();
        Self { edges, diagonal }
    }

    /// About the solution of L x = `right`, whose sum is zero, by conjugate gradients from x = 0
    /// with the diagonal as preconditioner (Hestenes, Stiefel: "Methods of conjugate gradients for
    /// solving linear systems", 1952): until the residual has fallen to `tolerance` of the right
    /// side, or for `rounds`. If `right` is a gradient, −x is a direction of descent whatever the
    /// round.
    pub fn solve(&self, right: &[DVec2], tolerance: f64, rounds: usize) -> Vec<DVec2> {
        let mut x = vec![DVec2::ZERO; right.len()];
        let mut residual = right.to_vec();
        let mut direction = vec![DVec2::ZERO; right.len()];
        let mut image = direction.clone();
        let (mut before, mut first) = (0.0, None);
        for _ in 0..rounds {
            let weighted: f64 =
                residual.iter().zip(&self.diagonal).map(|(r, d)| r.length_squared() / d).sum();
            let goal = tolerance * tolerance * *first.get_or_insert(weighted);
            // Also where the right side is zero, or not a number.
            if !(weighted > goal && weighted.is_normal()) {
                break;
            }
            let share = if before > 0.0 { weighted / before } else { 0.0 };
            before = weighted;
            for ((direction, residual), weight) in direction.iter_mut().zip(&residual).zip(&self.diagonal) {
                *direction = *residual / *weight + *direction * share;
            }
            for (vertex, (image, edges)) in image.iter_mut().zip(&self.edges).enumerate() {
                let others: DVec2 = edges.iter().map(|(to, weight)| direction[*to as usize] * *weight).sum();
                *image = direction[vertex] * self.diagonal[vertex] - others;
            }
            let curvature: f64 = direction.iter().zip(&image).map(|(d, i)| d.dot(*i)).sum();
            if !(curvature > 0.0 && curvature.is_finite()) {
                break;
            }
            let step = weighted / curvature;
            x.iter_mut().zip(&direction).for_each(|(x, direction)| *x += *direction * step);
            residual.iter_mut().zip(&image).for_each(|(residual, image)| *residual -= *image * step);
        }
        x
    }
}

/// Whether a map without turned triangles covers no point twice. `border` holds closed loops, one
/// after another, with the patch on their left.
///
/// The number of times that a point is covered is the sum of how often the loops wind around it. If
/// no two segments cross, each loop winds once: around the patch if it is the outer one, the other
/// way if it is that of a hole. A hole may have closed to a slit.
pub(super) fn is_simple(border: &[[u32; 2]], map: &[DVec2]) -> bool {
    // The area inside each loop, negative if it runs clockwise.
    let area = |edges: &[[u32; 2]]| -> f64 {
        let ends = |edge: &[u32; 2]| edge.map(|v| map[v as usize] - map[edges[0][0] as usize]);
        edges.iter().map(ends).map(|[from, to]| 0.5 * from.perp_dot(to)).sum()
    };
    let areas: Vec<f64> = loops(border).map(area).collect();
    let outer = areas.iter().copied().fold(0.0, f64::max);
    areas.iter().filter(|area| **area > SLIT * outer).count() == 1 && !crosses(border, map)
}

/// Whether any two segments cross.
fn crosses(border: &[[u32; 2]], map: &[DVec2]) -> bool {
    let ends = |[a, b]: [u32; 2]| [map[a as usize], map[b as usize]];
    // Square cells over the box around all segments, about as wide as these are long.
    let points = || border.iter().flat_map(|segment| ends(*segment));
    let low = points().fold(DVec2::INFINITY, DVec2::min);
    let side = (points().fold(DVec2::NEG_INFINITY, DVec2::max) - low).max_element();
    let length: f64 = border.iter().map(|segment| ends(*segment)).map(|[a, b]| a.distance(b)).sum();
    let cell = (length / border.len().max(1) as f64).max(side / MOST_CELLS).max(f64::MIN_POSITIVE);
    let columns = (side / cell) as i32 + 1;
    let cell_at = |p: DVec2| ((p - low) / cell).as_ivec2();
    // Cell, left end and segment, so that those of a cell lie together and from left to right.
    let mut entries: Vec<(u32, f64, u32)> = Vec::with_capacity(4 * border.len());
    for (i, segment) in (0..).zip(border) {
        let [a, b] = ends(*segment);
        let (first, last) = (cell_at(a.min(b)), cell_at(a.max(b)));
        let cells = (first.y..=last.y).flat_map(|y| (first.x..=last.x).map(move |x| y * columns + x));
        entries.extend(cells.map(|cell| (cell as u32, a.x.min(b.x), i)));
    }
    entries.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    entries.chunk_by(|a, b| a.0 == b.0).any(|cell| {
        cell.iter().enumerate().any(|(k, (_, _, i))| {
            let one = border[*i as usize];
            let [a, b] = ends(one);
            cell[k + 1..].iter().take_while(|(_, left, _)| *left <= a.x.max(b.x)).any(|(_, _, j)| {
                let two = border[*j as usize];
                !one.iter().any(|v| two.contains(v)) && cross([a, b], ends(two))
            })
        })
    })
}

/// Whether two segments cross inside both.
fn cross([a, b]: [DVec2; 2], [c, d]: [DVec2; 2]) -> bool {
    let side = |from: DVec2, to: DVec2, at: DVec2| (to - from).perp_dot(at - from);
    side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
}
