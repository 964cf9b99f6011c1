//! Whether what photographs show is a pattern on the surface, or something that it mirrors.
//!
//! Two neighboring views agree on what metal or glaze mirrors: it seems to lie behind the surface. Views farther apart see other things
//! in the mirror. So each vertex gets the mean and the variance of what all views show there. Where the mean over the views
//! still varies along the surface, that variation is a pattern of the surface itself; where the views vary more than their mean does
//! along the surface, they show reflections, or the surface is not where it should be.

use crate::mesh::bvh::TriangleBvh;
use crate::mesh::triangles::Mesh;
use crate::shape::stereo::match_picture::MatchPicture;
use crate::shape::stereo::sweep::{Seen, cast};
use crate::shape::stereo::votes::{Shell, WIDE};
use glam::Vec3;
use rayon::prelude::*;

/// Least cosine between the direction to a view and the normal.
const LEAST_COSINE: f32 = 0.3;
/// How far behind what a view sees a vertex may lie, in pixels of the view.
const SLACK: f32 = 3.0;
/// Views that must see a vertex.
const LEAST_VIEWS: u32 = 3;
/// Variance of values in [0, 1] that is noise.
const NOISE: f32 = 1e-5;

/// Variance along the surface of the mean over the views, as a part of that and the variance over the views, around each merged vertex of
/// `shell`: in [0, 1), near 1 for a pattern on the surface, small for reflections. 0 where fewer than three views see the surface.
pub(crate) fn pattern_shares(mesh: &Mesh, shell: &Shell, pictures: &[MatchPicture]) -> Vec<f32> {
    let shown = shown_by_views(mesh, shell, pictures);
    let smooth = |value: &dyn Fn(&Shown) -> f32| {
        let values = shown.iter().map(|shown| shown.as_ref().map_or(0.0, value));
        shell.graph.smoothed(&values.collect::<Vec<f32>>(), WIDE)
    };
    let (count, over_views) = (smooth(&|_| 1.0), smooth(&|shown| shown.variance));
    let (mean, squares) = (smooth(&|shown| shown.mean), smooth(&|shown| shown.mean * shown.mean));
    let share = |i: usize| {
        if count[i] < 1e-3 {
            return 0.0;
        }
        let along = (squares[i] / count[i] - (mean[i] / count[i]).powi(2)).max(0.0);
        along / (along + over_views[i] / count[i] + NOISE)
    };
    (0..count.len()).map(share).collect()
}

/// What views show at a vertex: the mean over them, and their variance.
struct Shown {
    mean: f32,
    variance: f32,
}

/// What the views that see it show at each merged vertex; `None` if too few do.
fn shown_by_views(mesh: &Mesh, shell: &Shell, pictures: &[MatchPicture]) -> Vec<Option<Shown>> {
    let bvh = TriangleBvh::new(mesh);
    let seen: Vec<Vec<Seen>> = pictures.par_iter().map(|picture| cast(&bvh, picture)).collect();
    let of_vertex = |(at, normal): (&Vec3, &Vec3)| {
        let (mut count, mut sum, mut squares) = (0, 0.0, 0.0);
        for (picture, seen) in pictures.iter().zip(&seen) {
            if let Some(value) = shown_by(picture, seen, *at, *normal) {
                count += 1;
                sum += value;
                squares += value * value;
            }
        }
        let mean = sum / count as f32;
        let variance = (squares / count as f32 - mean * mean).max(0.0);
        (count >= LEAST_VIEWS).then_some(Shown { mean, variance })
    };
    shell.positions.par_iter().zip(&shell.normals).map(of_vertex).collect()
}

/// What a view shows at a point with this normal; `None` if it does not see it.
fn shown_by(picture: &MatchPicture, seen: &[Seen], at: Vec3, normal: Vec3) -> Option<f32> {
    let to_view = picture.camera.position() - at;
    let distance = to_view.length();
    if normal.dot(to_view) < LEAST_COSINE * distance {
        return None;
    }
    let (x, y, _) = picture.camera.project(at)?;
    let (value, place) = picture.at(x, y)?;
    let focal = 0.5 * (picture.camera.focal[0].abs() + picture.camera.focal[1].abs());
    (distance <= seen[place].distance + SLACK * distance / focal).then_some(value)
}
