//! Repair of the visual hull where a few masks contradict the others: restored parts, and rejected silhouettes.
//!
//! A mask that lacks a part of the object removes it from the hull for all views. Other masks then contain pixels whose rays
//! miss the hull. Where such rays of several views cross, and most views see the object, the part is restored. The same step
//! restores parts that a coarse grid or a step of the fit lost.

use crate::error::stop::{check_interrupted, is_stopping};
use crate::error::{Error, Result};
use crate::sdf::SdfGrid;
use crate::sdf::distance_transform::signed_distance;
use crate::shape::silhouette::{Silhouette, is_inner};
use crate::shape::trust::hull_distance;
use crate::view::{Mask, StoredMask};
use glam::Vec3;
use rayon::prelude::*;

/// Pixels inside a mask's outline beyond which a ray should meet the object.
const GAP_DEPTH: f32 = 2.5;
/// Views whose gaps must cross in a point, and the same as a share of all views.
const GAP_VIEWS: usize = 3;
const GAP_SHARE: f32 = 0.04;
/// Cells around a gap's rays within which the object is restored.
const GAP_REACH: f32 = 1.5;
/// Most that the distance from a silhouette changes with the way: √2 where it is continued beyond its window, and more off the axis.
pub(super) const SLOPE: f32 = 2.5;
/// Distance in pixels between the silhouettes of mask and hull from which the mask is rejected; cells of a coarse grid allow more.
const OUTLINE_TOLERANCE: f32 = 3.0;

/// Stride in pixels of the check how well the hull fills a mask.
const SHARE_STRIDE: usize = 7;
/// Shares of a mask that the hull fills, below which the view is noted, and below which in half the views there is no shape.
const NOTED_SHARE: f32 = 0.9;
const REFUSED_SHARE: f32 = 0.6;

/// Restores what all masks but a share of `forgiven` show and `grid` lacks. Changed values are not exact distances. A run that is
/// stopping ([`is_stopping`]) restores not all.
pub(crate) fn regrow(grid: &mut SdfGrid, silhouettes: &[Silhouette], forgiven: f32) {
    let gaps: Vec<Silhouette> = silhouettes.par_iter().filter_map(|view| gaps(grid, view)).collect();
    let needed = GAP_VIEWS.max((GAP_SHARE * silhouettes.len() as f32).ceil() as usize);
    if gaps.len() < needed {
        return;
    }
    let (whole, reach) = (&*grid, GAP_REACH * grid.spacing);
    // The distance to the nearest gaps that are needed; `None` if too few are seen.
    let gap_distance = |point: Vec3| {
        let mut near: Vec<f32> = gaps.iter().filter_map(|gap| gap.world_distance(point)).collect();
        (near.len() >= needed).then(|| *near.select_nth_unstable_by(needed - 1, f32::total_cmp).1)
    };
    // What is restored lies within reach of the gaps: values far from them remain, but none says more than the distance to that.
    let is_far = |middle: Vec3, radius: f32| {
        let all_see = gaps.iter().all(|gap| gap.world_distance(middle).is_some());
        let room = gap_distance(middle).filter(|_| all_see)? - reach - SLOPE * radius;
        (room > whole.spacing).then_some(room)
    };
    let grown = |row: usize| {
        let point = whole.position(whole.vertex(row));
        let beyond = gap_distance(point).map(|distance| distance - reach);
        match beyond.filter(|beyond| *beyond <= whole.values[row] && !is_stopping()) {
            Some(beyond) => {
                whole.values[row].min(beyond.max(hull_distance(silhouettes, point, forgiven, reach)))
            }
            None => whole.values[row],
        }
    };
    grid.values = whole.replaced_in_blocks(is_far, grown);
}

/// The pixels well inside a mask whose rays miss the surface, as a mask; `None` if there are none. Of the pixels in a square as wide as a
/// cell the one deepest inside is asked for all.
fn gaps(grid: &SdfGrid, view: &Silhouette) -> Option<Silhouette> {
    let (width, height) = (view.camera.width, view.camera.height);
    let square = view.cell_pixels(grid) as u32;
    let mut coverage = vec![0.0; view.pixel_count()];
    for square in view.mask.window().squares(square.max(1)).take_while(|_| !is_stopping()) {
        let is_inner = |i: usize| {
            let (x, y) = view.center(i);
            is_inner(&view.camera, x, y)
        };
        let depths = square.pixels(width).map(|i| (view.distance(i), i));
        let inside: Vec<(f32, usize)> =
            depths.filter(|(distance, i)| *distance < -GAP_DEPTH && is_inner(*i)).collect();
        let Some((_, deepest)) = inside.iter().min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
        let (x, y) = view.center(*deepest);
        if grid.first_crossing(&view.camera.ray(x, y), 0.0).is_none() {
            inside.iter().for_each(|(_, i)| coverage[*i] = 1.0);
        }
    }
    let missing = Mask { width, height, coverage };
    Silhouette::new(&view.name, &view.camera, &StoredMask::new(&missing))
}

/// Share of a mask's pixels, not at the frame's border, whose rays meet the surface, or pass as near as the grid can tell; 1 if it has none there.
fn covered_share(grid: &SdfGrid, view: &Silhouette) -> f32 {
    let inside = |i: &usize| {
        let (x, y) = view.center(*i);
        view.distance(*i) < 0.0 && is_inner(&view.camera, x, y)
    };
    let pixels: Vec<usize> = (0..view.pixel_count()).filter(inside).step_by(SHARE_STRIDE).collect();
    // Near counts as met, to half the diagonal of a cell: what is thinner falls between the grid's vertices.
    let near = 0.87 * grid.spacing;
    let hits = |i: &&usize| {
        if is_stopping() {
            return false;
        }
        let (x, y) = view.center(**i);
        let ray = view.camera.ray(x, y);
        grid.least_distance(&ray, near).is_some_and(|least| least.value < near)
    };
    let hit = pixels.iter().filter(hits).count();
    if pixels.is_empty() { 1.0 } else { hit as f32 / pixels.len() as f32 }
}

/// Checks that the hull fills the masks it was made of; the notes name views whose masks it does not.
///
/// # Errors
/// [`Error::Usage`] with a view's name if it leaves most of most masks empty: they do not belong to their cameras.
pub(crate) fn check_hull(hull: &SdfGrid, silhouettes: &[Silhouette]) -> Result<Vec<String>> {
    let mut shares: Vec<(f32, &str)> =
        silhouettes.par_iter().map(|view| (covered_share(hull, view), view.name.as_str())).collect();
    check_interrupted()?;
    shares.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(b.1)));
    let percent = |share: f32| (100.0 * share).round();
    let Some((median, worst)) = shares.get(shares.len() / 2).zip(shares.first()) else {
        return Ok(Vec::new());
    };
    if median.0 < REFUSED_SHARE {
        let problem = format!(
            "cameras and masks do not belong together: what all masks share fills {} % of the mask of view `{}`, and {} % \
             of a typical one",
            percent(worst.0),
            worst.1,
            percent(median.0)
        );
        let help = "Are masks and poses paired by the right names, and poses in the layout's axes? Are intrinsics in pixels \
                    of these images?";
        return Err(Error::usage(problem, help));
    }
    let poor = shares.iter().take_while(|share| share.0 < NOTED_SHARE);
    Ok(poor
        .map(|(share, name)| {
            format!(
                "the other views' masks fill only {} % of the mask of view {name}: is it right?",
                percent(*share)
            )
        })
        .collect())
}

/// For each pixel of a view, whether its mask is reliable there: not at the border of the frame, and nowhere near a place
/// where the silhouette of the hull is far from that of the mask.
pub(crate) fn reliable_pixels(hull: &SdfGrid, view: &Silhouette) -> Vec<bool> {
    let camera = &view.camera;
    let tolerance = OUTLINE_TOLERANCE.max(1.0 + view.cell_pixels(hull));
    let pixels = (0..view.pixel_count()).into_par_iter().with_min_len(1024);
    let contradicts = |i: usize| {
        let far = !is_stopping() && (tolerance..3.0 * tolerance).contains(&view.distance(i).abs());
        let (x, y) = view.center(i);
        let hit = || hull.first_crossing(&camera.ray(x, y), 0.0).is_some();
        if far && is_inner(camera, x, y) && hit() != (view.distance(i) < 0.0) { 1.0 } else { 0.0 }
    };
    let wrong: Vec<f32> = pixels.map(contradicts).collect();
    let to_wrong = if wrong.contains(&1.0) {
        signed_distance(&wrong, camera.width as usize, camera.height as usize)
    } else {
        vec![f32::INFINITY; wrong.len()]
    };
    let reliable = |i: usize| {
        let (x, y) = view.center(i);
        is_inner(camera, x, y) && to_wrong[i] > tolerance + 1.0
    };
    (0..wrong.len()).map(reliable).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::fibonacci::fibonacci_axes;
    use crate::shape::hull::visual_hull;
    use crate::view::Camera;

    const SIZE: u32 = 96;
    const VIEWS: usize = 60;

    /// A ball with a horn.
    fn horned(p: Vec3) -> f32 {
        let horn = (p - Vec3::Y * p.y.clamp(0.0, 0.8)).length() - 0.15;
        (p.length() - 0.5).min(horn)
    }

    /// Views of the object; in those of `blind` the mask ends at a height, as if the horn had been too dark.
    fn views(blind: &[usize]) -> Vec<Silhouette> {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 64, horned);
        let view = |(i, axis): (usize, Vec3)| {
            let up = if axis.y.abs() > 0.9 { Vec3::X } else { Vec3::Y };
            let camera = Camera::look_at(4.0 * axis, Vec3::ZERO, up, 36.0, SIZE, SIZE).unwrap();
            let covered = |i: u32, blind: bool| {
                let ray = camera.ray((i % SIZE) as f32 + 0.5, (i / SIZE) as f32 + 0.5);
                let hit = grid.first_crossing(&ray, 0.0).map(|t| ray.origin + t * ray.direction);
                hit.is_some_and(|point| !blind || point.y < 0.5)
            };
            let is_blind = blind.contains(&i);
            let coverage = (0..SIZE * SIZE).map(|i| if covered(i, is_blind) { 1.0 } else { 0.0 }).collect();
            let mask = StoredMask::new(&Mask { width: SIZE, height: SIZE, coverage });
            Silhouette::new(&format!("v{i}"), &camera, &mask).unwrap()
        };
        fibonacci_axes(VIEWS).into_iter().enumerate().map(view).collect()
    }

    const BLIND: [usize; 5] = [20, 25, 30, 35, 40];
    const HORN: Vec3 = Vec3::new(0.0, 0.7, 0.0);

    #[test]
    fn a_part_that_a_few_masks_lack_is_put_back() {
        let sound = visual_hull(&mut views(&[]), 48, None).unwrap();
        let repaired = visual_hull(&mut views(&BLIND), 48, None).unwrap();
        assert!(sound.value(HORN) < 0.0 && repaired.value(HORN) < 0.0);
        // Nothing else changes by more than about two cells.
        for row in 0..sound.values.len() {
            let point = sound.position(sound.vertex(row));
            let off = (repaired.value(point) - sound.values[row]).abs();
            let near = sound.values[row].abs() < 0.1;
            assert!(!near || off < 2.5 * sound.spacing, "{point}: {off} {}", sound.spacing);
        }
    }

    #[test]
    fn silhouettes_that_the_hull_contradicts_are_rejected() {
        let mut views = views(&BLIND);
        let hull = visual_hull(&mut views, 48, None).unwrap();
        for (i, view) in views.iter().enumerate() {
            let reliable = reliable_pixels(&hull, view);
            let kept = reliable.iter().filter(|reliable| **reliable).count();
            assert!(kept > reliable.len() / 2, "view {i}: {kept}");
            if BLIND.contains(&i) {
                let (x, y, _) = view.camera.project(HORN).unwrap();
                assert!(!reliable[y as usize * SIZE as usize + x as usize], "view {i}");
            } else {
                let inner = (0..reliable.len()).filter(|&p| {
                    let (x, y) = view.center(p);
                    is_inner(&view.camera, x, y)
                });
                let doubted = inner.filter(|&p| !reliable[p]).count();
                assert!(doubted < reliable.len() / 50, "view {i}: {doubted}");
            }
        }
    }

    /// The same mask with a camera that is 30 pixels off.
    fn shifted(view: &Silhouette) -> Silhouette {
        let mut camera = view.camera;
        camera.center[0] += 30.0;
        Silhouette::new(&view.name, &camera, &view.mask).unwrap()
    }

    #[test]
    fn masks_that_the_hull_does_not_fill_are_named_or_refused() {
        let mut views = views(&[]);
        let hull = visual_hull(&mut views, 48, None).unwrap();
        assert!(check_hull(&hull, &views).unwrap().is_empty());
        views[4] = shifted(&views[4]);
        let notes = check_hull(&hull, &views).unwrap();
        assert!(notes.len() == 1 && notes[0].contains("v4"), "{notes:?}");
        let wrong: Vec<Silhouette> = views.iter().map(shifted).collect();
        let error = check_hull(&hull, &wrong).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("`v"), "{error}");
    }
}
