//! Stereo: moves a mesh to where neighboring photographs agree.
//!
//! Silhouettes show no hollows, and shading shows slopes rather than positions; a printed pattern even looks like slopes. Where
//! photographs have texture, patches of neighboring views agree at the right depth only. Each view is compared with its neighbors
//! at several depths around the mesh ([`mod@sweep`]), all views together vote for displacements of vertices ([`votes`]), and a thin
//! plate carries these across places without votes ([`plate`]). Coarse pictures come first, then finer ones.
//!
//! A highlight moves over the surface from view to view, so that patches of a glossy object agree at wrong depths. Two things tell
//! that apart: the model explains such photographs already, and the views contradict each other. Votes count only where neither
//! holds, and an object of which that is true as a whole is left alone. At the end displacements are taken back where all views
//! together show reflections rather than a pattern of the surface (`pattern`): neighbors alone do agree on those of metal.
//!
//! | file | holds |
//! | --- | --- |
//! | `pattern` | patterns of the surface apart from what it mirrors |
//! | [`match_picture`] | photographs in gray for matching, and which of them are neighbors |
//! | [`mod@sweep`] | the search along rays: depth and trust per pixel |
//! | [`votes`] | sums over views per vertex, and how far they are trusted |
//! | [`plate`] | smooth displacements from votes |
//!
//! Sources: a search along rays with normalized cross-correlation, the best of several views (Goesele, Curless and Seitz, "Multi-View
//! Stereo Revisited", CVPR 2006); displacements of a mesh with thin-plate smoothness (Vu et al., "High Accuracy and
//! Visibility-Consistent Dense Multiview Stereo", PAMI 2012).

pub mod match_picture;
pub(crate) mod pattern;
pub mod plate;
pub mod sweep;
pub mod votes;

use crate::error::Result;
use crate::error::stop::is_stopping;
use crate::math::statistics::median;
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::triangles::Mesh;
use crate::ranks::Ranks;
use crate::ranks::owned::OwnedItems;
use crate::ranks::packed::divided;
use crate::shape::displace::within_room;
use crate::shape::field::ModelError;
use crate::shape::outline::{Contours, Vote};
use crate::shape::silhouette::{Silhouette, pixel_size};
use crate::shape::vertex_graph::VertexGraph;
use crate::view::Placement;
use crate::view::{Camera, Photograph, StoredMask};
use glam::Vec3;
use match_picture::{MatchPicture, neighbors};
use pattern::pattern_shares;
use plate::{Plate, bent, faired};
use rayon::prelude::*;
use std::ops::ControlFlow;
use sweep::{Seen, Source, Sweep, cast, sweep};
use votes::{LOCAL, Shell, Votes, WIDE, gates, gather, object_gate, smooth_step};

/// From coarse to fine: size of a pixel relative to the finest picture's, and the search around the mesh.
pub(crate) const ROUNDS: [(u32, Sweep); 4] = [
    (4, Sweep { steps: 3, step: 1.0 }),
    (2, Sweep { steps: 3, step: 0.5 }),
    (1, Sweep { steps: 3, step: 0.5 }),
    (1, Sweep { steps: 2, step: 0.5 }),
];
/// Pixels of the finest pictures per edge of the mesh; finer ones show what the mesh cannot.
const PIXELS_PER_EDGE: f32 = 5.0;
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
/// Fraction of the vertices that must be trusted for any to move: few scattered ones are chance, and pit a glossy surface.
const LEAST_TRUSTED: f32 = 0.03;
/// Share of the pattern, as [`pattern_shares`] has it, from which a displacement counts, and counts fully.
const PATTERN: (f32, f32) = (0.3, 0.5);
/// Most pixels that vote in a round; of more views, some do, evenly chosen. All serve as neighbors.
const MOST_PIXELS: usize = 6_000_000;
/// Chunks of views that are summed apart.
const CHUNKS: usize = 16;
/// Least cosine between the normals of a triangle before and after a move; others are folded.
const LEAST_TURN: f32 = 0.3;
/// Attempts to unfold triangles by halving the displacement of their corners.
const UNFOLDINGS: usize = 4;

/// A photograph with what is known of its view.
#[derive(Clone, Copy)]
pub struct StereoView<'a> {
    /// Its camera.
    pub camera: &'a Camera,
    /// Linear radiance.
    pub photograph: &'a Photograph,
    /// The pixels that show the object.
    pub mask: &'a StoredMask,
    /// How the object lies in it.
    pub placement: Placement,
}

/// The training views, the photographs of which several processes may share.
pub type TrainingViews<'a> = OwnedItems<'a, StereoView<'a>>;

/// Views of one placement whose photographs each process has.
#[cfg(test)]
pub(crate) fn everybodys_views<'a>(
    shot: impl Iterator<Item = (&'a Camera, &'a Photograph, &'a StoredMask)>,
) -> TrainingViews<'a> {
    let view = |(camera, photograph, mask)| StereoView { camera, photograph, mask, placement: Placement(0) };
    TrainingViews::new(shot.map(view).collect(), None, |_| None)
}

/// What [`refine`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StereoReport {
    /// Fraction of the vertices whose votes were trusted in the last round that moved any, in [0, 1].
    pub trusted: f32,
    /// Root mean square of the displacement of all rounds, world units.
    pub moved: f32,
}

/// What stereo is given besides photographs.
#[derive(Clone, Copy, Debug)]
pub struct StereoGuides<'a> {
    /// The masks, at whose outlines contours stay.
    pub silhouettes: &'a [Silhouette],
    /// What the shading leaves unexplained.
    pub error: &'a ModelError,
}

/// Moves the vertices of `mesh` to where the photographs agree, where that is better known than by shading. `go_on` is asked before each round.
///
/// # Errors
/// If another process is gone.
pub fn refine(
    mesh: &mut Mesh,
    views: &TrainingViews,
    guides: &StereoGuides,
    mut go_on: impl FnMut(usize) -> ControlFlow<()>,
) -> Result<StereoReport> {
    let mut report = StereoReport::default();
    let start = mesh.clone();
    let Some(finest) = finest_factor(mesh, views) else { return Ok(report) };
    let mut object = None;
    for (round, (relative, search)) in ROUNDS.into_iter().enumerate() {
        if go_on(round).is_break() {
            break;
        }
        let pictures = match_pictures(views, finest * relative)?;
        let trusted = refine_round(mesh, (&pictures, views.ranks()), guides, search, &mut object)?;
        if trusted == 0.0 {
            break;
        }
        report.trusted = trusted;
    }
    if report.trusted > 0.0 && !is_stopping() {
        take_back(mesh, &start, views, finest)?;
    }
    let squares = start.positions.iter().zip(&mesh.positions).map(|(a, b)| f64::from(a.distance_squared(*b)));
    report.moved = (squares.sum::<f64>() / start.positions.len().max(1) as f64).sqrt() as f32;
    Ok(report)
}

/// Takes the displacements from `start` back where the photographs show no pattern of the surface, but what it mirrors.
fn take_back(mesh: &mut Mesh, start: &Mesh, views: &TrainingViews, factor: u32) -> Result<()> {
    // From another placement the light is another, and a place without a pattern looks different.
    let of_views = || views.items.iter().map(|view| view.placement);
    let count = |placement: Placement| of_views().filter(|other| *other == placement).count();
    let most = of_views().max_by_key(|placement| count(*placement));
    let alike = views.clone().filtered(|view| Some(view.placement) == most);
    let pictures = match_pictures(&alike, factor)?;
    // The vertices that were merged before are those that moved together.
    let (graph, before) = VertexGraph::new(start);
    let shell = Shell::moved(graph, mesh);
    let shares = pattern_shares(mesh, &shell, &pictures);
    if is_stopping() {
        return Ok(());
    }
    let kept: Vec<f32> = shares.iter().map(|share| smooth_step(*share, PATTERN)).collect();
    let kept = shell.graph.smoothed(&kept, WIDE);
    let back: Vec<Vec3> = (0..before.len()).map(|i| before[i].lerp(shell.positions[i], kept[i])).collect();
    put(mesh, &shell, &back);
    Ok(())
}

/// The photographs for matching, `factor` times smaller along each axis.
///
/// # Errors
/// If another process is gone.
pub(crate) fn match_pictures(views: &TrainingViews, factor: u32) -> Result<Vec<MatchPicture>> {
    let pictures = views.each(|_, v| MatchPicture::new(v.camera, v.photograph, v.mask, factor))?;
    Ok(pictures.into_iter().flatten().collect())
}

/// How many times smaller than the photographs the finest pictures are; `None` without views or triangles.
fn finest_factor(mesh: &Mesh, views: &TrainingViews) -> Option<u32> {
    let (graph, positions) = VertexGraph::new(mesh);
    let center = positions.iter().sum::<Vec3>() / positions.len().max(1) as f32;
    let footprint = |v: &StereoView| pixel_size(v.camera) * v.camera.position().distance(center);
    let footprint = median(&mut views.items.iter().map(footprint).collect::<Vec<f32>>())?;
    let factor = graph.mean_edge(&positions) / (PIXELS_PER_EDGE * footprint);
    (!mesh.triangles.is_empty()).then(|| factor.round().clamp(1.0, 1024.0) as u32)
}

/// One round; returns the fraction of the vertices whose votes are trusted, or zero if these are too few to move any. `object` is how far
/// stereo serves this object at all, from the first round.
fn refine_round(
    mesh: &mut Mesh,
    (pictures, ranks): (&[MatchPicture], Option<&Ranks>),
    StereoGuides { silhouettes, error }: &StereoGuides,
    search: Sweep,
    object: &mut Option<f32>,
) -> Result<f32> {
    let bvh = TriangleBvh::new(mesh);
    let shell = Shell::new(mesh);
    let votes = all_votes(&bvh, &shell, pictures, search, ranks)?;
    if is_stopping() {
        return Ok(0.0);
    }
    let gates = gates(&shell, &votes, error);
    let object = *object.get_or_insert_with(|| object_gate(&gates));
    if object == 0.0 {
        return Ok(0.0);
    }
    let trusted = |(v, gate): (&Votes, &f32)| object * smooth_step(*gate, LOCAL) * v.share(HALF_SHARE);
    let trust: Vec<f32> = votes.iter().zip(&gates).map(trusted).collect();
    let follow = trust.iter().filter(|trust| **trust > TRUSTED).count() as f32 / trust.len().max(1) as f32;
    if follow < LEAST_TRUSTED {
        return Ok(0.0);
    }
    let outlines = Contours::new(&shell, &bvh).votes(silhouettes, ranks)?;
    let outlines: Vec<Plate> = outlines.of_vertices.iter().map(Vote::plate).collect();
    let moved = moved_positions(&bvh, &shell, pictures, &votes, &trust, &outlines);
    put(mesh, &shell, &moved);
    Ok(follow)
}

/// Where the votes bring the vertices.
fn moved_positions(
    bvh: &TriangleBvh,
    shell: &Shell,
    pictures: &[MatchPicture],
    votes: &[Votes],
    trust: &[f32],
    outlines: &[Plate],
) -> Vec<Vec3> {
    let Shell { graph, positions, normals } = shell;
    let plate = |i: usize| Plate {
        hold: trust[i] + votes[i].silhouette() + outlines[i].hold + HELD,
        pull: trust[i] * votes[i].displacement() + outlines[i].pull,
    };
    let plates: Vec<Plate> = (0..positions.len()).map(plate).collect();
    let along = bent(graph, &plates, BENDING);
    let reach = REACH * graph.mean_edge(positions);
    let bent: Vec<Vec3> =
        (0..positions.len()).map(|i| positions[i] + normals[i] * along[i].clamp(-reach, reach)).collect();
    // Fairing would pull outlines inward.
    let free: Vec<f32> = trust.iter().zip(outlines).map(|(trust, o)| trust / (1.0 + o.hold)).collect();
    let wanted = faired(graph, &bent, &free, FAIRNESS);
    let steps = steps_within_room(bvh, positions, normals, &wanted, LIFT * reach);
    let within: Vec<Vec3> = positions.iter().zip(&steps).map(|(p, step)| *p + *step).collect();
    let within = within_silhouettes(pictures, shell, &within);
    let steps = within.iter().zip(positions).map(|(to, from)| *to - *from).collect();
    unfolded(graph, positions, steps)
}

/// The votes of all views, which `ranks` divide.
fn all_votes(
    bvh: &TriangleBvh,
    shell: &Shell,
    pictures: &[MatchPicture],
    search: Sweep,
    ranks: Option<&Ranks>,
) -> Result<Vec<Votes>> {
    let (center, _) = bvh.bounding_sphere();
    let cast = |i: usize| if is_stopping() { Vec::new() } else { cast(bvh, &pictures[i]) };
    let seen: Vec<Vec<Seen>> = divided(ranks, pictures.len(), cast)?;
    let of_views = |views: &[usize]| {
        let mut votes = vec![Votes::default(); shell.positions.len()];
        for &i in views.iter().take_while(|_| !is_stopping()) {
            let near = neighbors(pictures, i, center);
            let sources: Vec<Source> =
                near.iter().map(|&j| Source { picture: &pictures[j], seen: &seen[j] }).collect();
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
    let parts = divided(ranks, chunks.len(), |chunk| of_views(chunks[chunk]))?;
    let mut sums = vec![Votes::default(); shell.positions.len()];
    for part in parts {
        sums.iter_mut().zip(part).for_each(|(sum, votes)| sum.add(&votes));
    }
    Ok(sums)
}

/// Displacements toward `wanted` that leave room to the opposite side; rays start `lift` away from the surface.
fn steps_within_room(
    bvh: &TriangleBvh,
    positions: &[Vec3],
    normals: &[Vec3],
    wanted: &[Vec3],
    lift: f32,
) -> Vec<Vec3> {
    let step = |i: usize| {
        let step = wanted[i] - positions[i];
        let along = step.dot(normals[i]);
        if along == 0.0 {
            return step;
        }
        step * (within_room(bvh, positions[i], normals[i], along, lift) / along)
    };
    (0..positions.len()).into_par_iter().map(step).collect()
}

/// Displacements that do not leave more silhouettes than the vertices did before; those that do are taken back.
fn within_silhouettes(pictures: &[MatchPicture], shell: &Shell, wanted: &[Vec3]) -> Vec<Vec3> {
    let missed = |point: Vec3| pictures.iter().filter(|picture| picture.misses(point)).count();
    let kept = |i: usize| {
        let (before, after) = (shell.positions[i], wanted[i]);
        if missed(after) > missed(before) { before } else { after }
    };
    (0..wanted.len()).into_par_iter().map(kept).collect()
}

/// The moved positions; displacements that fold triangles are halved.
fn unfolded(graph: &VertexGraph, positions: &[Vec3], mut steps: Vec<Vec3>) -> Vec<Vec3> {
    let area = |at: &[Vec3], corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| at[v as usize]);
        (b - a).cross(c - a)
    };
    let place = |steps: &[Vec3]| positions.iter().zip(steps).map(|(p, s)| *p + *s).collect::<Vec<Vec3>>();
    let mut moved = place(&steps);
    for _ in 0..UNFOLDINGS {
        let mut folded = vec![false; positions.len()];
        for corners in &graph.triangles {
            let (before, after) = (area(positions, corners), area(&moved, corners));
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
    let areas = shell.graph.area_vectors(after);
    for (vertex, of) in shell.graph.of.iter().map(|of| *of as usize).enumerate() {
        mesh.positions[vertex] = after[of];
        let normal = mesh.normals[vertex] + areas[of].normalize_or_zero() - shell.normals[of];
        mesh.normals[vertex] = normal.try_normalize().unwrap_or(mesh.normals[vertex]);
    }
}

#[cfg(test)]
mod tests;
