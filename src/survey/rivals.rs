//! Explanations that silhouettes alone hardly tell apart: a mesh of another size, another focal length, and masks that are narrower or
//! wider than the object.

use crate::math::statistics::median;
use crate::mesh::bvh::TriangleBvh;
use crate::survey::change::{Cause, Change};
use crate::survey::look::{SmallMask, ViewLook};
use crate::survey::mesh_overlap::{covered, median_agreement, overlap};
use crate::survey::mesh_placement::short;
use rayon::prelude::*;

/// Overlaps this close do not tell which cause is the right one. With focal lengths 1.6 or 0.6 times as long, another size of the mesh
/// explains a ball as well as that, and a cow or a figure by more than this worse.
const TIE: f32 = 0.06;
/// Rounds of correcting the focal length.
const ROUNDS: usize = 4;
/// A factor this close to 1 is 1.
const ONE_SLACK: f32 = 0.03;
/// Factors beyond which it is a mistake of units, not of the lens.
const MOST: f32 = 3.0;
/// Largest width that masks may lack or have too much, and its steps, in pixels of a small mask.
const MOST_MARGIN: usize = 16;
const MARGIN_STEP: f32 = 0.5;

/// The causes that explain masks about as well as the best of them, the best first, with its overlap. `placed` is the mesh of another
/// size, if one is found; `views` are of `looks`.
pub(crate) fn rivals(
    bvh: &TriangleBvh,
    looks: &[ViewLook],
    views: &[SmallMask],
    placed: Option<Cause>,
) -> Vec<(Cause, f32)> {
    let after = |cause: Cause| {
        let changed: Vec<SmallMask> = views.iter().map(|view| cause.change.of(view)).collect();
        let reached = median_agreement(bvh, &changed);
        (cause, reached)
    };
    let mut found: Vec<(Cause, f32)> = placed.into_iter().map(after).collect();
    found.extend(focal(bvh, views).map(after));
    found.extend(margin(bvh, looks, views));
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    let best = found.first().map_or(0.0, |found| found.1);
    found.retain(|(_, reached)| *reached >= best - TIE);
    found
}

/// Several causes as one.
pub fn joined(causes: &[(Cause, f32)]) -> Option<Cause> {
    let (first, _) = causes.first()?;
    let mut cause = first.clone();
    for (other, _) in &causes[1..] {
        cause.words += &format!("; or, which silhouettes hardly tell apart, {}", other.words);
        cause.help += &format!(" Or: {}", other.help);
    }
    Some(cause)
}

/// Another focal length for all cameras, by which the mesh covers as much as the masks.
fn focal(bvh: &TriangleBvh, views: &[SmallMask]) -> Option<Cause> {
    let mut factor = 1.0f32;
    for _ in 0..ROUNDS {
        let change = Change::Focal(factor);
        let ratio = |view: &SmallMask| {
            let count = |inside: &[bool]| inside.iter().filter(|inside| **inside).count() as f32;
            let seen = count(&covered(bvh, &change.of(view)));
            (seen > 0.0).then(|| (count(&view.inside) / seen).sqrt())
        };
        let mut ratios: Vec<f32> = views.par_iter().filter_map(ratio).collect();
        factor *= median(&mut ratios)?.clamp(0.5, 2.0);
    }
    let is_lens = factor.is_finite() && (1.0 / MOST..=MOST).contains(&factor);
    let way = if factor > 1.0 { "short" } else { "long" };
    let words = format!("the focal lengths are {} times too {way}", short(factor.max(1.0 / factor)));
    let help = format!(
        "Check the intrinsics (were they written for photographs of another size?): multiply the focal lengths by {}.",
        short(factor)
    );
    (is_lens && (factor - 1.0).abs() > ONE_SLACK).then_some(Cause {
        change: Change::Focal(factor),
        words,
        help,
    })
}

/// Masks whose outline is everywhere inside or outside that of the mesh by the same width.
fn margin(bvh: &TriangleBvh, looks: &[ViewLook], views: &[SmallMask]) -> Option<(Cause, f32)> {
    let depths: Vec<Vec<f32>> =
        views.par_iter().map(|view| depths(&covered(bvh, view), view.camera.width as usize)).collect();
    let reached = |least: f32| {
        let overlaps = views.iter().zip(&depths).map(|(view, depths)| {
            let inside: Vec<bool> = depths.iter().map(|depth| *depth > least).collect();
            overlap(&inside, &view.inside).unwrap_or(0.0)
        });
        median(&mut overlaps.collect::<Vec<f32>>()).unwrap_or(0.0)
    };
    let widths = (1..=2 * MOST_MARGIN).flat_map(|i| [1.0, -1.0].map(|sign| sign * i as f32 * MARGIN_STEP));
    let (width, reached) = widths.map(|width| (width, reached(width))).max_by(|a, b| a.1.total_cmp(&b.1))?;
    let mask = looks.iter().find_map(|look| Some((look.size[0], look.mask.as_ref()?.small.camera.width)))?;
    let pixels = (width.abs() * mask.0 as f32 / mask.1 as f32).round();
    let (way, help) = if width > 0.0 {
        ("smaller", "Write masks that reach the object's outline; perhaps they were eroded.")
    } else {
        ("larger", "Write masks that end at the object's outline; perhaps they were dilated.")
    };
    let words =
        format!("the masks are {way} than the silhouettes of the mesh by about {pixels} pixels all around");
    Some((Cause { change: Change::Masks, words, help: help.to_owned() }, reached))
}

/// Distance of each covered pixel from those that are not, and minus that of the others from the covered ones, in pixels (chamfer). Beyond
/// the frame nothing is known.
fn depths(inside: &[bool], width: usize) -> Vec<f32> {
    let (within, beyond) = (distances(inside, width, false), distances(inside, width, true));
    within.into_iter().zip(beyond).map(|(within, beyond)| within - beyond).collect()
}

/// Distance from the nearest pixel that is `goal`.
fn distances(inside: &[bool], width: usize, goal: bool) -> Vec<f32> {
    const FAR: f32 = 1e6;
    let height = inside.len() / width.max(1);
    let mut found: Vec<f32> = inside.iter().map(|is| if *is == goal { 0.0 } else { FAR }).collect();
    let steps = [(-1isize, 0isize), (0, -1), (-1, -1), (1, -1)];
    let mut sweep = |i: usize, sign: isize| {
        let at = [(i % width) as isize, (i / width) as isize];
        for (dx, dy) in steps {
            let (x, y) = (at[0] + sign * dx, at[1] + sign * dy);
            if (0..width as isize).contains(&x) && (0..height as isize).contains(&y) {
                let length = if dx != 0 && dy != 0 { std::f32::consts::SQRT_2 } else { 1.0 };
                found[i] = found[i].min(found[y as usize * width + x as usize] + length);
            }
        }
    };
    (0..inside.len()).for_each(|i| sweep(i, 1));
    (0..inside.len()).rev().for_each(|i| sweep(i, -1));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_are_positive_inside_and_negative_outside() {
        // A row of three covered pixels of seven.
        let inside = [false, false, true, true, true, false, false];
        assert_eq!(depths(&inside, 7), [-2.0, -1.0, 1.0, 2.0, 1.0, -1.0, -2.0]);
        let square: Vec<bool> = (0..25).map(|i| i % 5 > 0 && i / 5 > 0).collect();
        // The frame is no outline.
        assert_eq!((depths(&square, 5)[24], depths(&square, 5)[12]), (4.0, 2.0));
    }
}
