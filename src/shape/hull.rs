//! The robust visual hull: at every point of space, how far outside the silhouettes it is.
//!
//! In a view a point is about (pixels to the silhouette) · depth / focal away from the silhouette's cone. The largest of
//! these over the views is the hull's signed distance; the k-th largest forgives k − 1 wrong masks. Views that do not see
//! the point, or see it at the border of the frame, abstain: what the frame cuts is kept. What a few masks remove
//! although many show it is restored (`hull_repair`).

use crate::error::stop::is_stopping;
use crate::ranks::{Ranks, check_interrupted_together};
use crate::sdf::SdfGrid;
use crate::shape::hull_repair::{SLOPE, regrow};
use crate::shape::silhouette::{MIN_VIEWS, Silhouette};
use crate::shape::trust::{hull_distance, mark_trusted};
use crate::{Error, Result};
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Share of the views that see a point whose masks may be wrong there.
pub(super) const FORGIVEN: f32 = 0.02;
/// The same where masks show what others carved.
pub(super) const FORGIVEN_AT_GAPS: f32 = 0.12;
/// Cells a side of the grid that finds out how large the object is.
const COARSE_CELLS: u32 = 48;
/// Cells outside a coarse surface beyond which the hull is not looked at more closely: no part of it is as far from all vertices.
const FAR: f32 = 2.5;
/// Cells that a surface may lie outside the hull.
const TRIM_SLACK: f32 = 0.25;
/// Cells outside the surface that are trimmed as well.
const TRIM_REACH: f32 = 3.0;

/// The visual hull of an object, on a grid of `cells` cells a side that just holds it. Marks the views that it trusts. `ranks` divide the layers of the grid.
///
/// # Errors
/// [`Error::Usage`] if there are fewer than three masks, their middle rays do not meet, or no point is inside all masks; an error if another process is gone.
pub fn visual_hull(silhouettes: &mut [Silhouette], cells: u32, ranks: Option<&Ranks>) -> Result<SdfGrid> {
    if silhouettes.len() < MIN_VIEWS {
        let problem = "a shape needs at least three views with masks that are not empty";
        return Err(Error::usage(problem, "Give more photographs a mask, white where the object is."));
    }
    let center = meeting_point(silhouettes).ok_or_else(|| {
        Error::usage("the views all look along one line: they show no shape", "Add views from other sides.")
    })?;
    let reach = |s: &Silhouette| s.camera.position().distance(center) * s.spread;
    let radius = silhouettes.iter().map(reach).fold(0.0, f32::max);
    let mut coarse = carve(silhouettes, (center, 1.1 * radius), COARSE_CELLS, None, ranks)?;
    regrow(&mut coarse, silhouettes, FORGIVEN_AT_GAPS);
    mark_trusted(silhouettes, &coarse);
    check_interrupted_together(ranks)?;
    let (low, high) = bounds_inside(&coarse).ok_or_else(|| no_hull(silhouettes, &coarse))?;
    let half = 0.5 * (high - low).max_element() + coarse.spacing;
    let mut hull = carve(silhouettes, (0.5 * (low + high), half), cells, Some(&coarse), ranks)?;
    regrow(&mut hull, silhouettes, FORGIVEN_AT_GAPS);
    check_interrupted_together(ranks)?;
    if hull.values.iter().all(|value| *value >= 0.0) {
        return Err(no_hull(silhouettes, &hull));
    }
    Ok(hull)
}

/// An empty hull, with the view that is farthest from seeing what the others come nearest to agreeing on.
fn no_hull(silhouettes: &[Silhouette], coarse: &SdfGrid) -> Error {
    let seen = |point: Vec3| silhouettes.iter().filter_map(move |s| Some((s, s.world_distance(point)?)));
    // The point that most masks show, and of those the one least outside.
    let agreement = |row: &usize| {
        let point = coarse.position(coarse.vertex(*row));
        let inside = seen(point).filter(|(_, distance)| *distance < 0.0).count();
        (inside, std::cmp::Reverse(*row))
    };
    let best = (0..coarse.values.len()).into_par_iter().max_by_key(agreement).unwrap_or(0);
    let point = coarse.position(coarse.vertex(best));
    let worst = seen(point).max_by(|a, b| a.1.total_cmp(&b.1)).map_or(&silhouettes[0], |worst| worst.0);
    let (inside, all) = (agreement(&best).0, silhouettes.len());
    let problem = format!(
        "no point of space is inside all masks: the best is in {inside} of {all}; view `{}` is farthest off",
        worst.name
    );
    let help = "Do cameras and masks belong together? Repair that view's pose or mask, or leave it out with `select`.";
    Error::usage(problem, help)
}

/// The hull in the cube around a center, with half its side. Far outside a `coarse` one its values are taken; not inside, for it knows of no mask that carves alone.
fn carve(
    silhouettes: &[Silhouette],
    (center, half_side): (Vec3, f32),
    cells: u32,
    coarse: Option<&SdfGrid>,
    ranks: Option<&Ranks>,
) -> Result<SdfGrid> {
    let outside = 2.0 * half_side / cells as f32;
    let far = |point| {
        let (value, cell) = coarse.map(|coarse| (coarse.value(point), coarse.spacing))?;
        (value > FAR * cell).then_some(value)
    };
    // What is not carved is dropped by whoever asked for it.
    let distance = |point| far(point).unwrap_or_else(|| hull_distance(silhouettes, point, FORGIVEN, outside));
    let (side, plane) = (cells + 1, (cells as usize + 1).pow(2));
    let layers = ranks.map_or(0..side, |ranks| {
        let own = ranks.share(side as usize, 1);
        own.start as u32..own.end as u32
    });
    let value = |point| if is_stopping() { outside } else { distance(point) };
    let mut hull = SdfGrid::from_fn_in_layers(center, half_side, cells, layers, value);
    if let Some(ranks) = ranks {
        ranks.complete(&mut hull.values, plane)?;
    }
    Ok(hull)
}

/// Removes from `grid` what lies outside the hull, as [`visual_hull`] has it, by more than [`TRIM_SLACK`] cells, and restores what most
/// masks show. Marks the views that it trusts. Changed values are not exact distances.
pub(super) fn trim(grid: &mut SdfGrid, silhouettes: &mut [Silhouette]) {
    mark_trusted(silhouettes, grid);
    let silhouettes = &*silhouettes;
    let (whole, cell) = (&*grid, grid.spacing);
    let trimmed = |row: usize| {
        let value = whole.values[row];
        if value > TRIM_REACH * cell || is_stopping() {
            return value;
        }
        let point = whole.position(whole.vertex(row));
        value.max(hull_distance(silhouettes, point, FORGIVEN, value) - TRIM_SLACK * cell)
    };
    // No mask, not even one that would be forgiven, comes near such a block.
    let is_inside = |middle: Vec3, radius: f32| {
        let holds = |view: &Silhouette| view.world_distance(middle).is_some_and(|d| d < -SLOPE * radius);
        silhouettes.iter().all(holds).then_some(f32::INFINITY)
    };
    grid.values = whole.replaced_in_blocks(is_inside, trimmed);
    regrow(grid, silhouettes, FORGIVEN_AT_GAPS);
}

/// The point nearest to all middle rays, in the least-squares sense; `None` if they are parallel.
fn meeting_point(silhouettes: &[Silhouette]) -> Option<Vec3> {
    let (mut a, mut b) = (Mat3::ZERO, Vec3::ZERO);
    for s in silhouettes {
        let d = s.middle;
        let across = Mat3::IDENTITY - Mat3::from_cols(d * d.x, d * d.y, d * d.z);
        a += across;
        b += across * s.camera.position();
    }
    let point = a.inverse() * b;
    (a.determinant() > 1e-6 && point.is_finite()).then_some(point)
}

/// The box around all vertices inside or so near that a thin part may be between them and the next.
fn bounds_inside(grid: &SdfGrid) -> Option<(Vec3, Vec3)> {
    let inside = (0..grid.values.len()).into_par_iter().filter(|&i| grid.values[i] < 0.5 * grid.spacing);
    inside
        .map(|i| (grid.position(grid.vertex(i)), grid.position(grid.vertex(i))))
        .reduce_with(|(a, b), (c, d)| (a.min(c), b.max(d)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::StoredMask;
    use crate::view::{Camera, Mask};

    /// Masks of a ball, seen from all around.
    fn ball_views(center: Vec3, radius: f32, count: usize) -> Vec<(Camera, Mask)> {
        let axes = crate::math::fibonacci::fibonacci_axes(count);
        axes.into_iter()
            .map(|axis| {
                let up = if axis.y.abs() > 0.9 { Vec3::X } else { Vec3::Y };
                let camera =
                    Camera::look_at(center + 4.0 * axis + 0.1 * up, center, up, 40.0, 96, 96).unwrap();
                let coverage = (0..96 * 96)
                    .map(|i| {
                        let ray = camera.ray((i % 96) as f32 + 0.5, (i / 96) as f32 + 0.5);
                        let distance = ray.direction.cross(center - ray.origin).length();
                        if distance < radius { 1.0 } else { 0.0 }
                    })
                    .collect();
                (camera, Mask { width: 96, height: 96, coverage })
            })
            .collect()
    }

    fn silhouettes(views: &[(Camera, Mask)]) -> Vec<Silhouette> {
        views
            .iter()
            .enumerate()
            .filter_map(|(i, (camera, mask))| {
                Silhouette::new(&format!("v{i}"), camera, &StoredMask::new(mask))
            })
            .collect()
    }

    #[test]
    fn the_hull_of_a_ball_is_the_ball_wherever_it_lies() {
        let (center, radius) = (Vec3::new(5.0, -3.0, 2.0), 0.9);
        let grid = visual_hull(&mut silhouettes(&ball_views(center, radius, 40)), 40, None).unwrap();
        for (i, value) in grid.values.iter().enumerate() {
            let exact = grid.position(grid.vertex(i)).distance(center) - radius;
            if exact.abs() < 0.3 {
                assert!((value - exact).abs() < 0.05, "{value} {exact}");
            }
        }
    }

    #[test]
    fn one_wrong_mask_of_many_does_not_carve_the_object_away() {
        let mut views = ball_views(Vec3::ZERO, 0.9, 60);
        views[7].1.coverage.iter_mut().enumerate().for_each(|(i, c)| *c = if i == 0 { 1.0 } else { 0.0 });
        let grid = visual_hull(&mut silhouettes(&views), 24, None).unwrap();
        assert!(grid.value(Vec3::ZERO) < -0.5);
    }

    /// A fin beyond the masks goes; what is inside stays as it is.
    #[test]
    fn what_lies_outside_the_hull_is_trimmed() {
        let mut views = silhouettes(&ball_views(Vec3::ZERO, 0.9, 40));
        let fin = |p: Vec3| (p.abs() - Vec3::new(1.2, 0.06, 0.2)).max_element();
        let mut grid = SdfGrid::from_fn(Vec3::ZERO, 1.3, 52, |p| (p.length() - 0.88).min(fin(p)));
        let before = grid.clone();
        trim(&mut grid, &mut views);
        for (i, value) in grid.values.iter().enumerate() {
            let distance = grid.position(grid.vertex(i)).length();
            assert!(distance < 1.0 || *value > 0.0, "{distance} {value}");
            assert!(distance > 0.8 || *value == before.values[i], "{distance} {value}");
        }
    }

    #[test]
    fn inconsistent_views_are_one_clear_error() {
        let mut views = ball_views(Vec3::ZERO, 0.9, 12);
        for (i, (_, mask)) in views.iter_mut().enumerate() {
            mask.coverage
                .iter_mut()
                .enumerate()
                .for_each(|(p, c)| *c = if p == 300 + 997 * i % 9000 { 1.0 } else { 0.0 });
        }
        let error = visual_hull(&mut silhouettes(&views), 24, None).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(
            error.to_string().contains("inside all masks") && error.to_string().contains("view `v"),
            "{error}"
        );
        assert!(visual_hull(&mut silhouettes(&views[..2]), 24, None).is_err());
    }
}
