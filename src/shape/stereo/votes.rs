//! What all views together say of each vertex: displacements, and how far these are to be trusted.

use crate::math::statistics::median;
use crate::mesh::triangles::Mesh;
use crate::ranks::packed::PackedFloats;
use crate::shape::field::ModelError;
use crate::shape::stereo::match_picture::MatchPicture;
use crate::shape::stereo::sweep::{Matched, Seen};
use crate::shape::vertex_graph::VertexGraph;
use glam::Vec3;

/// Least cosine between a ray and the surface for a vote.
const LEAST_COSINE: f32 = 0.1;
/// Pixels from a mask's rim within which a silhouette determines the surface.
const RIM: usize = 2;
/// λ of the smoothing of statistics over the mesh.
pub(crate) const WIDE: f32 = 10.0;
/// Squared error of the model, relative to the variance of patches, at which half of the votes count.
const HALF_ERROR: f32 = 0.3;
/// Variance of the views' shifts, in squared pixels, at which half of the votes count.
const HALF_SPREAD: f32 = 0.15;
/// Gates from which a vertex's votes count, and count fully.
pub(crate) const LOCAL: (f32, f32) = (0.05, 0.2);
/// The same for the median gate of the object.
const OBJECT: (f32, f32) = (0.1, 0.3);

/// Sums over the pixels that see a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Votes {
    /// Trust, times the cosine between ray and normal.
    weight: f32,
    /// Weighted displacement along the normal, world units.
    along: f32,
    /// Weighted shift along the ray, in pixels of a neighbor.
    shift: f32,
    /// Its weighted square.
    shift_squared: f32,
    /// Weighted variance of patches.
    variance: f32,
    /// Cosines, whether trusted or not.
    seen: f32,
    /// Sines at silhouettes.
    rim: f32,
}

impl PackedFloats<7> for Votes {
    fn to_floats(self) -> [f32; 7] {
        let Self { weight, along, shift, shift_squared, variance, seen, rim } = self;
        [weight, along, shift, shift_squared, variance, seen, rim]
    }

    fn of_floats([weight, along, shift, shift_squared, variance, seen, rim]: [f32; 7]) -> Self {
        Self { weight, along, shift, shift_squared, variance, seen, rim }
    }
}

impl Votes {
    /// Adds other sums.
    pub fn add(&mut self, other: &Self) {
        self.weight += other.weight;
        self.along += other.along;
        self.shift += other.shift;
        self.shift_squared += other.shift_squared;
        self.variance += other.variance;
        self.seen += other.seen;
        self.rim += other.rim;
    }

    /// The mean displacement along the normal, world units.
    pub fn displacement(&self) -> f32 {
        if self.weight > 0.0 { self.along / self.weight } else { 0.0 }
    }

    /// How much of what is seen is trusted, in [0, 1); `half` gives ½.
    pub fn share(&self, half: f32) -> f32 {
        let share = self.weight / (self.seen + 1.0);
        share / (share + half)
    }

    /// How far silhouettes determine the vertex, in [0, 1).
    pub fn silhouette(&self) -> f32 {
        self.rim / (self.seen + self.rim + 1.0)
    }
}

/// The merged vertices of the mesh, as votes see them.
pub(crate) struct Shell {
    /// Triangles and neighbors.
    pub(crate) graph: VertexGraph,
    /// World positions.
    pub(crate) positions: Vec<Vec3>,
    /// Unit normals by area.
    pub(crate) normals: Vec<Vec3>,
}

impl Shell {
    /// Of a mesh.
    pub(crate) fn new(mesh: &Mesh) -> Self {
        let (graph, _) = VertexGraph::new(mesh);
        Self::moved(graph, mesh)
    }

    /// Of a mesh whose vertices have moved since they were merged.
    pub(crate) fn moved(graph: VertexGraph, mesh: &Mesh) -> Self {
        let mut positions = vec![Vec3::ZERO; graph.merged()];
        graph.of.iter().zip(&mesh.positions).for_each(|(of, at)| positions[*of as usize] = *at);
        let mut shell = Self { graph, positions: Vec::new(), normals: Vec::new() };
        shell.move_to(positions);
        shell
    }

    /// Moves the merged vertices to other positions.
    pub(crate) fn move_to(&mut self, positions: Vec<Vec3>) {
        self.normals = self.graph.area_vectors(&positions).iter().map(|n| n.normalize_or_zero()).collect();
        self.positions = positions;
    }
}

/// Adds the votes of a view.
pub(crate) fn gather(
    votes: &mut [Votes],
    picture: &MatchPicture,
    seen: &[Seen],
    found: &Matched,
    shell: &Shell,
) {
    let Shell { graph, positions, normals } = shell;
    for (at, pixel) in picture.window.pixels(picture.camera.width).enumerate() {
        let Some(triangle) = seen[at].triangle() else { continue };
        let ray = picture.camera.pixel_ray(pixel as u32);
        let corners = graph.triangles[triangle as usize].map(|v| v as usize);
        let weights =
            barycentric(corners.map(|v| positions[v]), ray.origin + ray.direction * seen[at].distance);
        let normal: Vec3 = (0..3).map(|k| normals[corners[k]] * weights[k]).sum();
        let cosine = -normal.normalize_or_zero().dot(ray.direction);
        if cosine < LEAST_COSINE {
            continue;
        }
        let weight = found.trust[at] * cosine;
        let shift = (found.distance[at] / seen[at].distance - 1.0) / found.step;
        let vote = Votes {
            weight,
            along: -weight * (found.distance[at] - seen[at].distance) * cosine,
            shift: weight * shift,
            shift_squared: weight * shift * shift,
            variance: weight * found.variance[at],
            seen: cosine,
            rim: if picture.near_rim(at, RIM) { 1.0 - cosine } else { 0.0 },
        };
        for (corner, share) in corners.into_iter().zip(weights) {
            votes[corner].add(&vote.times(share));
        }
    }
}

impl Votes {
    fn times(&self, share: f32) -> Self {
        Self {
            weight: share * self.weight,
            along: share * self.along,
            shift: share * self.shift,
            shift_squared: share * self.shift_squared,
            variance: share * self.variance,
            seen: share * self.seen,
            rim: share * self.rim,
        }
    }
}

/// Weights of a triangle's corners at a point of its plane, clamped to the triangle.
fn barycentric([a, b, c]: [Vec3; 3], point: Vec3) -> [f32; 3] {
    let normal = (b - a).cross(c - a);
    let whole = normal.length_squared().max(1e-30);
    let second = (point - a).cross(c - a).dot(normal) / whole;
    let third = (b - a).cross(point - a).dot(normal) / whole;
    let weights = [1.0 - second - third, second, third].map(|w| w.clamp(0.0, 1.0));
    let sum: f32 = weights.iter().sum();
    weights.map(|w| w / sum.max(1e-6))
}

/// Per vertex, in [0, 1]: how far its photographs are unexplained by the model and its views agree. A vertex without votes gets 0.
pub(crate) fn gates(shell: &Shell, votes: &[Votes], error: &ModelError) -> Vec<f32> {
    let Shell { graph, positions, .. } = shell;
    let smooth = |column: &dyn Fn(&Votes) -> f32| {
        graph.smoothed(&votes.iter().map(column).collect::<Vec<f32>>(), WIDE)
    };
    let (weight, variance) = (smooth(&|v| v.weight), smooth(&|v| v.variance));
    let (shift, squared) = (smooth(&|v| v.shift), smooth(&|v| v.shift_squared));
    let (errors, samples): (Vec<f32>, Vec<f32>) = positions.iter().map(|p| error.around(*p)).unzip();
    let (errors, samples) = (graph.smoothed(&errors, WIDE), graph.smoothed(&samples, WIDE));
    let gate = |i: usize| {
        if weight[i] < 1e-3 || samples[i] < 1e-3 {
            return 0.0;
        }
        let spread = (squared[i] / weight[i] - (shift[i] / weight[i]).powi(2)).max(0.0);
        gate(errors[i] / samples[i], variance[i] / weight[i], spread)
    };
    (0..positions.len()).map(gate).collect()
}

/// High if the squared error of the model is large beside the variance of patches, and the spread of shifts is small.
fn gate(error: f32, variance: f32, spread: f32) -> f32 {
    let unexplained = error * error / (error * error + (HALF_ERROR * variance).powi(2)).max(1e-20);
    unexplained / (1.0 + (spread / HALF_SPREAD).powi(2))
}

/// How far stereo serves the object as a whole, in [0, 1], by the median of the gates of vertices with votes.
pub(crate) fn object_gate(gates: &[f32]) -> f32 {
    let mut gates: Vec<f32> = gates.iter().copied().filter(|gate| *gate > 0.0).collect();
    median(&mut gates).map_or(0.0, |gate| smooth_step(gate, OBJECT))
}

/// From 0 at `low` to 1 at `high`, with slope 0 at both.
pub(crate) fn smooth_step(x: f32, (low, high): (f32, f32)) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn votes_count_where_the_model_fails_and_views_agree() {
        // Errors, variances and spreads as measured on patterned fabric and on glossy paint.
        assert!(gate(0.005, 0.01, 0.03) > 0.6);
        assert!(gate(0.0003, 0.004, 0.03) < 0.1, "the model explains it");
        assert!(gate(0.005, 0.01, 1.0) < 0.05, "views contradict each other");
        assert_eq!(gate(0.0, 0.0, 0.0), 0.0);
        assert_eq!(object_gate(&[0.0, 0.0]), 0.0);
        assert_eq!(object_gate(&[0.0, 0.02, 0.03, 0.9]), 0.0);
        assert_eq!(object_gate(&[0.7, 0.8, 0.0]), 1.0);
    }

    #[test]
    fn weights_of_corners_are_those_of_the_point() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let weights = barycentric(corners, Vec3::new(0.2, 0.5, 0.0));
        assert!(weights.iter().zip([0.3, 0.2, 0.5]).all(|(a, b)| (a - b).abs() < 1e-6));
        let beyond = barycentric(corners, Vec3::new(-0.1, 0.5, 0.0));
        assert!((beyond.iter().sum::<f32>() - 1.0).abs() < 1e-6 && beyond[1] == 0.0);
    }
}
