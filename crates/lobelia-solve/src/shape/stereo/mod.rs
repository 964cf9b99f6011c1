//! Stereo: moves a mesh to where neighboring photographs agree.
//!
//! Silhouettes show no hollows, and shading shows slopes rather than positions; a printed pattern
//! even looks like slopes. Where photographs have texture, patches of neighboring views agree at
//! the right depth only. Each view is compared with its neighbors at several depths around the mesh
//! (`sweep`), all views together vote for displacements of vertices, and a thin plate carries these
//! across places without votes. Coarse pictures come first, then finer ones.
//!
//! A highlight moves over the surface from view to view, so that patches of a glossy object agree
//! at wrong depths. Two things tell that apart: the model explains such photographs already, and
//! the views contradict each other. Votes count only where neither holds, and an object of which
//! that is true as a whole is left alone. At the end displacements are taken back where all views
//! together show reflections rather than a pattern of the surface (`pattern_shares`): neighbors
//! alone do agree on those of metal.
//!
//! Sources: a search along rays with normalized cross-correlation, the best of several views
//! (Goesele, Curless and Seitz, "Multi-View Stereo Revisited", CVPR 2006); displacements of a mesh
//! with thin-plate smoothness (Vu et al., "High Accuracy and Visibility-Consistent Dense Multiview
//! Stereo", PAMI 2012).

mod sweep;

use crate::shape::outline::{outline_votes, within_room};
use crate::shape::pictures::{MatchPicture, Seen, TrainingView, focal, picture_factor};
use crate::shape::shell::{Plate, Shell, VertexGraph, area_vector};
use crate::shape::{field::ModelError, silhouette::Silhouette};
use glam::Vec3;
use lobelia_geometry::mesh::{bvh::TriangleBvh, triangles::Mesh};
use lobelia_geometry::{error::stop::is_stopping, parallel, view::Placement};
use lobelia_sg::statistics::median;
use std::ops::ControlFlow;
use sweep::{Matched, Sweep, neighbors, sweep};

/// From coarse to fine: size of a pixel relative to the finest picture's, and the search around the
/// mesh.
const ROUNDS: [(u32, Sweep); 4] = [
    (4, Sweep { steps: 3, step: 1.0 }),
    (2, Sweep { steps: 3, step: 0.5 }),
    (1, Sweep { steps: 3, step: 0.5 }),
    (1, Sweep { steps: 2, step: 0.5 }),
];
/// Pixels of the finest pictures per edge of the mesh; finer ones show what the mesh cannot.
const PIXELS_PER_EDGE: f32 = 5.0;
/// Least cosine between a ray and the surface for a vote.
const LEAST_COSINE: f32 = 0.1;
/// Pixels from a mask's rim within which a silhouette determines the surface.
const RIM: usize = 2;
/// λ of the smoothing of statistics over the mesh.
const WIDE: f32 = 10.0;
/// Squared error of the model, relative to the variance of patches, at which half of the votes
/// count.
const HALF_ERROR: f32 = 0.3;
/// Variance of the views' shifts, in squared pixels, at which half of the votes count.
const HALF_SPREAD: f32 = 0.15;
/// Gates from which a vertex's votes count, and count fully.
const LOCAL: (f32, f32) = (0.05, 0.2);
/// Median gates of the object from which votes count, and count fully.
const OBJECT: (f32, f32) = (0.1, 0.3);
/// Share of votes in what a vertex is seen by at which they count half.
const HALF_SHARE: f32 = 0.1;
/// How strongly each vertex is held where it is, in units of full trust.
const HELD: f32 = 0.03;
/// Weight of the squared Laplacian of displacements.
const BENDING: f32 = 2.0;
/// Weight of the squared Laplacian of positions, where votes are trusted.
const FAIRNESS: f32 = 2.0;
/// Largest displacement of a round, in mean edges.
const REACH: f32 = 3.0;
/// Height of a ray's start above the surface, relative to that reach.
const LIFT: f32 = 0.02;
/// Trust from which a vertex counts as one that follows its votes.
const TRUSTED: f32 = 0.25;
/// Fraction of the vertices that must be trusted for any to move: few scattered ones are chance,
/// and pit a glossy surface.
const LEAST_TRUSTED: f32 = 0.03;
/// Share of the pattern, as [`pattern_shares`] has it, from which a displacement counts, and counts
/// fully.
const PATTERN: (f32, f32) = (0.3, 0.5);
/// A view shows a vertex: the least cosine between the direction to it and the normal, and how far
/// behind what the view sees the vertex may lie, in pixels of the view.
const SHOWN_COSINE: f32 = 0.3;
const SHOWN_SLACK: f32 = 3.0;
/// Views that must show a vertex for its share of the pattern.
const LEAST_VIEWS: u32 = 3;
/// Variance of values in [0, 1] that is noise.
const NOISE: f32 = 1e-5;
/// Most pixels that vote in a round; of more views, some do, evenly chosen. All serve as neighbors.
const MOST_PIXELS: usize = 6_000_000;
/// Chunks of views that are summed apart.
const CHUNKS: usize = 16;
/// Least cosine between the normals of a triangle before and after a move; others are folded.
const LEAST_TURN: f32 = 0.3;
/// Attempts to unfold triangles by halving the displacement of their corners.
const UNFOLDINGS: usize = 4;

/// Result of the refinement by stereo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StereoReport {
    /// Fraction of the vertices whose votes were trusted in the last round that moved any, in [0,
    /// 1].
    pub trusted: f32,
    /// Root mean square of the displacement of all rounds, world units.
    pub moved: f32,
}

/// Rounds that a refinement asks before.
pub const fn rounds() -> usize {
    ROUNDS.len()
}

/// Moves the vertices of `mesh` to where the photographs agree, where that is better known than by
/// shading, which leaves this `error`. Contours stay at the outlines of the `silhouettes`. `go_on`
/// is asked before each round.
pub(crate) fn refine(
    mesh: &mut Mesh,
    views: &[TrainingView],
    silhouettes: &[Silhouette],
    error: &ModelError,
    mut go_on: impl FnMut(usize) -> ControlFlow<()>,
) -> StereoReport {
    let mut report = StereoReport::default();
    let start = mesh.clone();
    let Some(finest) = finest_factor(mesh, views) else { return report };
    // How far stereo serves this object at all, from the first round.
    let mut object = None;
    for (round, (relative, search)) in ROUNDS.into_iter().enumerate() {
        if go_on(round).is_break() {
            break;
        }
        let pictures = MatchPicture::of_views(views, finest * relative);
        let (bvh, shell) = (TriangleBvh::new(mesh), Shell::new(mesh));
        let votes = all_votes(&bvh, &shell, &pictures, search);
        if is_stopping() {
            break;
        }
        let gates = gates(&shell, &votes, error);
        let object = *object.get_or_insert_with(|| object_gate(&gates));
        let trusted = |(v, gate): (&Votes, &f32)| object * smooth_step(*gate, LOCAL) * v.share();
        let trust: Vec<f32> = votes.iter().zip(&gates).map(trusted).collect();
        let follow = trust.iter().filter(|trust| **trust > TRUSTED).count() as f32;
        let follow = follow / trust.len().max(1) as f32;
        if follow < LEAST_TRUSTED {
            break;
        }
        let outlines = outline_votes(&shell, &bvh, silhouettes, is_stopping);
        let moved = moved_positions(&bvh, &shell, &pictures, &votes, &trust, &outlines.plates);
        put(mesh, &shell, &moved);
        report.trusted = follow;
    }
    if report.trusted > 0.0 && !is_stopping() {
        take_back(mesh, &start, views, finest);
    }
    let squares = start.positions.iter().zip(&mesh.positions).map(|(a, b)| f64::from(a.distance_squared(*b)));
    report.moved = (squares.sum::<f64>() / start.positions.len().max(1) as f64).sqrt() as f32;
    report
}

/// Takes the displacements from `start` back where the photographs show no pattern of the surface,
/// but what it mirrors.
fn take_back(mesh: &mut Mesh, start: &Mesh, views: &[TrainingView], factor: u32) {
    // From another placement the light is another, and a place without a pattern looks different.
    let of_views = || views.iter().map(|view| view.placement);
    let count = |placement: Placement| of_views().filter(|other| *other == placement).count();
    let most = of_views().max_by_key(|placement| count(*placement));
    let alike = views.iter().filter(|view| Some(view.placement) == most).copied().collect::<Vec<_>>();
    // The vertices that were merged before are those that moved together.
    let (graph, before) = VertexGraph::new(start);
    let shell = Shell::moved(graph, mesh);
    let shares = pattern_shares(mesh, &shell, &MatchPicture::of_views(&alike, factor));
    if is_stopping() {
        return;
    }
    let kept: Vec<f32> = shares.iter().map(|share| smooth_step(*share, PATTERN)).collect();
    let kept = shell.graph.smoothed(&kept, WIDE);
    let back: Vec<Vec3> = (0..before.len()).map(|i| before[i].lerp(shell.positions[i], kept[i])).collect();
    put(mesh, &shell, &back);
}

/// How many times smaller than the photographs the finest pictures are; `None` without views or
/// triangles.
fn finest_factor(mesh: &Mesh, views: &[TrainingView]) -> Option<u32> {
    let (graph, positions) = VertexGraph::new(mesh);
    let center = positions.iter().sum::<Vec3>() / positions.len().max(1) as f32;
    let factor = picture_factor(views, center, graph.mean_edge(&positions), PIXELS_PER_EDGE);
    factor.filter(|_| !mesh.triangles.is_empty())
}

fn moved_positions(
    bvh: &TriangleBvh,
    shell: &Shell,
    pictures: &[MatchPicture],
    votes: &[Votes],
    trust: &[f32],
    outlines: &[Plate],
) -> Vec<Vec3> {
    let Shell { graph, positions, normals } = shell;
    let plate = |i: usize| {
        let Votes { weight, along, seen, rim, .. } = votes[i];
        let displacement = if weight > 0.0 { along / weight } else { 0.0 };
        // How far silhouettes determine the vertex.
        let silhouette = rim / (seen + rim + 1.0);
        Plate {
            hold: trust[i] + silhouette + outlines[i].hold + HELD,
            pull: trust[i] * displacement + outlines[i].pull,
        }
    };
    let plates: Vec<Plate> = (0..positions.len()).map(plate).collect();
    let along = graph.bent(&plates, BENDING);
    let reach = REACH * graph.mean_edge(positions);
    let bent: Vec<Vec3> =
        (0..positions.len()).map(|i| positions[i] + normals[i] * along[i].clamp(-reach, reach)).collect();
    // Fairing would pull outlines inward.
    let free: Vec<f32> = trust.iter().zip(outlines).map(|(trust, o)| trust / (1.0 + o.hold)).collect();
    let wanted = graph.faired(&bent, &free, FAIRNESS);
    let missed = |point: Vec3| pictures.iter().filter(|picture| picture.misses(point)).count();
    let step = |i: usize| {
        let (position, normal) = (positions[i], normals[i]);
        let mut step = wanted[i] - position;
        let along = step.dot(normal);
        if along != 0.0 {
            step *= within_room(bvh, position, normal, along, LIFT * reach) / along;
        }
        // A displacement that leaves more silhouettes than the vertex did before is taken back.
        let to = position + step;
        if missed(to) > missed(position) { Vec3::ZERO } else { to - position }
    };
    let steps = parallel::map(positions.len(), 64, step);
    unfolded(graph, positions, steps)
}

fn all_votes(bvh: &TriangleBvh, shell: &Shell, pictures: &[MatchPicture], search: Sweep) -> Vec<Votes> {
    let (center, _) = bvh.bounding_sphere();
    let seen: Vec<Vec<Seen>> = parallel::map_slice(pictures, 1, |picture| picture.cast(bvh));
    let of_views = |views: &&[usize]| {
        let mut votes = vec![Votes::default(); shell.positions.len()];
        for &i in views.iter().take_while(|_| !is_stopping()) {
            let near = neighbors(pictures, i, center);
            let sources: Vec<_> = near.iter().map(|&j| (&pictures[j], &*seen[j])).collect();
            if let Some(found) = sweep(&pictures[i], &seen[i], &sources, center, search) {
                gather(&mut votes, &pictures[i], &seen[i], &found, shell);
            }
        }
        votes
    };
    let pixels = seen.iter().flatten().filter(|seen| seen.distance.is_finite()).count();
    // Chunks of fixed size, added in order: the same bits with any number of threads.
    let all: Vec<usize> = (0..pictures.len()).step_by(pixels.div_ceil(MOST_PIXELS).max(1)).collect();
    let chunks: Vec<&[usize]> = all.chunks(all.len().div_ceil(CHUNKS).max(1)).collect();
    let parts: Vec<Vec<Votes>> = parallel::map_slice(&chunks, 1, of_views);
    let mut sums = vec![Votes::default(); shell.positions.len()];
    for part in parts {
        sums.iter_mut().zip(part).for_each(|(sum, votes)| sum.add(&votes, 1.0));
    }
    sums
}

/// The moved positions; displacements that fold triangles are halved.
fn unfolded(graph: &VertexGraph, positions: &[Vec3], mut steps: Vec<Vec3>) -> Vec<Vec3> {
    let place = |steps: &[Vec3]| positions.iter().zip(steps).map(|(p, s)| *p + *s).collect::<Vec<Vec3>>();
    let mut moved = place(&steps);
    for _ in 0..UNFOLDINGS {
        let mut folded = vec![false; positions.len()];
        for corners in &graph.triangles {
            let (before, after) = (area_vector(positions, corners), area_vector(&moved, corners));
            let (least, turned) = (before.length() * after.length(), before.dot(after));
            if turned < LEAST_TURN * least || after.length() < 0.1 * before.length() {
                corners.iter().for_each(|&v| folded[v as usize] = true);
            }
        }
        if !folded.contains(&true) {
            break;
        }
        steps.iter_mut().zip(&folded).filter(|(_, folded)| **folded).for_each(|(step, _)| *step *= 0.5);
        moved = place(&steps);
    }
    moved
}

/// Writes positions; normals turn as those of the triangles do.
fn put(mesh: &mut Mesh, shell: &Shell, after: &[Vec3]) {
    let turned = shell.graph.normals(after);
    for (vertex, of) in shell.graph.of.iter().map(|of| *of as usize).enumerate() {
        mesh.positions[vertex] = after[of];
        let normal = mesh.normals[vertex] + turned[of] - shell.normals[of];
        mesh.normals[vertex] = normal.try_normalize().unwrap_or(mesh.normals[vertex]);
    }
}

/// Sums over the pixels that see a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Votes {
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

impl Votes {
    fn add(&mut self, other: &Self, share: f32) {
        self.weight += share * other.weight;
        self.along += share * other.along;
        self.shift += share * other.shift;
        self.shift_squared += share * other.shift_squared;
        self.variance += share * other.variance;
        self.seen += share * other.seen;
        self.rim += share * other.rim;
    }

    /// How much of what is seen is trusted, in [0, 1); [`HALF_SHARE`] gives ½.
    fn share(&self) -> f32 {
        let share = self.weight / (self.seen + 1.0);
        share / (share + HALF_SHARE)
    }
}

fn gather(votes: &mut [Votes], picture: &MatchPicture, seen: &[Seen], found: &Matched, shell: &Shell) {
    for (at, ray) in picture.rays().enumerate().filter(|(at, _)| seen[*at].distance.is_finite()) {
        let corners = shell.graph.triangles[seen[at].triangle as usize].map(|v| v as usize);
        let point = ray.origin + ray.direction * seen[at].distance;
        let weights = barycentric(corners.map(|v| shell.positions[v]), point);
        let normal: Vec3 = (0..3).map(|k| shell.normals[corners[k]] * weights[k]).sum();
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
            votes[corner].add(&vote, share);
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

/// Per vertex, in [0, 1]: how far its photographs are unexplained by the model and its views agree.
/// A vertex without votes gets 0.
fn gates(shell: &Shell, votes: &[Votes], error: &ModelError) -> Vec<f32> {
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

/// High if the squared error of the model is large beside the variance of patches, and the spread
/// of shifts is small.
fn gate(error: f32, variance: f32, spread: f32) -> f32 {
    let unexplained = error * error / (error * error + (HALF_ERROR * variance).powi(2)).max(1e-20);
    unexplained / (1.0 + (spread / HALF_SPREAD).powi(2))
}

/// How far stereo serves the object as a whole, in [0, 1], by the median of the gates of vertices
/// with votes.
fn object_gate(gates: &[f32]) -> f32 {
    let mut gates: Vec<f32> = gates.iter().copied().filter(|gate| *gate > 0.0).collect();
    median(&mut gates).map_or(0.0, |gate| smooth_step(gate, OBJECT))
}

/// From 0 at `low` to 1 at `high`, with slope 0 at both.
fn smooth_step(x: f32, (low, high): (f32, f32)) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Whether what photographs show around each merged vertex of `shell` is a pattern on the surface,
/// or something that it mirrors: in [0, 1), near 1 for a pattern. 0 where fewer than three views
/// see the surface.
///
/// Two neighboring views agree on what metal or glaze mirrors: it seems to lie behind the surface.
/// Views farther apart see other things in the mirror. So each vertex gets the mean and the
/// variance of what all views show there. Where the mean still varies along the surface, that is a
/// pattern of the surface itself; where the views vary more than their mean does along the surface,
/// they show reflections, or the surface is not where it should be. The result is the variance of
/// the mean along the surface, as a part of that and the variance over the views.
pub(crate) fn pattern_shares(mesh: &Mesh, shell: &Shell, pictures: &[MatchPicture]) -> Vec<f32> {
    let bvh = TriangleBvh::new(mesh);
    let seen: Vec<Vec<Seen>> = parallel::map_slice(pictures, 1, |picture| picture.cast(&bvh));
    // Whether enough views show a vertex, and the mean and variance over these views.
    let of_vertex = |i: usize| {
        let (at, normal) = (shell.positions[i], shell.normals[i]);
        let (mut count, mut sum, mut squares) = (0, 0.0, 0.0);
        let values = pictures.iter().zip(&seen).filter_map(|(p, seen)| shown_by(p, seen, at, normal));
        values.for_each(|value| (count, sum, squares) = (count + 1, sum + value, squares + value * value));
        let mean = sum / count as f32;
        let variance = (squares / count as f32 - mean * mean).max(0.0);
        if count >= LEAST_VIEWS { [1.0, mean, variance] } else { [0.0; 3] }
    };
    let shown: Vec<[f32; 3]> = parallel::map(shell.positions.len(), 1024, of_vertex);
    let smooth = |value: fn(&[f32; 3]) -> f32| {
        shell.graph.smoothed(&shown.iter().map(value).collect::<Vec<f32>>(), WIDE)
    };
    let (count, over_views) = (smooth(|shown| shown[0]), smooth(|shown| shown[2]));
    let (mean, squares) = (smooth(|shown| shown[1]), smooth(|shown| shown[1] * shown[1]));
    let share = |i: usize| {
        if count[i] < 1e-3 {
            return 0.0;
        }
        let along = (squares[i] / count[i] - (mean[i] / count[i]).powi(2)).max(0.0);
        along / (along + over_views[i] / count[i] + NOISE)
    };
    (0..count.len()).map(share).collect()
}

/// The value that a view shows at a point with this normal; `None` if it does not see it.
fn shown_by(picture: &MatchPicture, seen: &[Seen], at: Vec3, normal: Vec3) -> Option<f32> {
    let to_view = picture.camera.position() - at;
    let distance = to_view.length();
    if normal.dot(to_view) < SHOWN_COSINE * distance {
        return None;
    }
    let (value, place) = picture.at(at)?;
    let slack = SHOWN_SLACK * distance / focal(&picture.camera);
    (distance <= seen[place].distance + slack).then_some(value)
}

#[cfg(test)]
mod tests;
