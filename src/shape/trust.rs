//! Masks that may carve alone, because no other mask contradicts them.
//!
//! The hull forgives a share of the masks at every point: one mask that lacks a part of the object would remove that part from all
//! views. But often only one or two cameras look from below, and what they alone show to be empty, such as the space under a seat,
//! would stay filled. A mask is therefore trusted if what it removes leaves no ray of another mask without a surface. A trusted mask
//! carves by itself, up to [`CARVE_SLACK`] pixels beside its outline, which is more than the noise of outlines. Its holes do not: a
//! wrong one would become a tunnel that no other outline shows.

use crate::error::stop::is_stopping;
use crate::sdf::SdfGrid;
use crate::shape::silhouette::{MIN_VIEWS, Outside, Sighting, Silhouette, is_inner};
use glam::Vec3;
use rayon::prelude::*;

/// Pixels beside the outline of a trusted mask that it does not carve alone.
const CARVE_SLACK: f32 = 3.0;
/// Pixels inside a mask's outline beyond which a ray should meet the surface; cells of a coarse grid allow more.
const CHECK_DEPTH: f32 = 3.0;
const CHECK_CELLS: f32 = 2.0;
/// Stride of the pixels that are checked.
const CHECK_STRIDE: usize = 7;
/// Share of all checked pixels that a trusted mask may take from the others.
const TAKEN_SHARE: f32 = 1e-4;
/// Length of the steps along a ray inside the surface, in cells.
const STEP: f32 = 0.5;

/// How far a point is outside what a mask carves alone, in world units; `None` if the view is doubted or abstains.
fn carve_distance(view: &Silhouette, point: Vec3) -> Option<f32> {
    view.carves.as_ref()?;
    carve_distance_at(view, &view.look(point)?)
}

/// The same where the point is seen.
fn carve_distance_at(view: &Silhouette, sighting: &Sighting) -> Option<f32> {
    let carves = view.carves.as_ref()?;
    let beyond = sighting.pixels - CARVE_SLACK;
    (beyond <= 0.0 || carves.contains(sighting.x, sighting.y)).then_some(beyond * sighting.pixel_size)
}

/// How far a point is outside what the trusted masks carve alone; negative infinity if none sees it.
fn trusted_distance(silhouettes: &[Silhouette], point: Vec3) -> f32 {
    silhouettes.iter().filter_map(|view| carve_distance(view, point)).fold(f32::NEG_INFINITY, f32::max)
}

/// The hull's signed distance at a point, with this share of the views forgiven, except what trusted views carve alone; `outside` if
/// too few see it.
pub(super) fn hull_distance(silhouettes: &[Silhouette], point: Vec3, forgiven: f32, outside: f32) -> f32 {
    let (mut seen, mut trusted) = (Vec::with_capacity(silhouettes.len()), f32::NEG_INFINITY);
    for view in silhouettes {
        let Some(sighting) = view.look(point) else { continue };
        seen.push(sighting.world_distance());
        trusted = carve_distance_at(view, &sighting).map_or(trusted, |distance| trusted.max(distance));
    }
    if seen.len() < MIN_VIEWS {
        return outside;
    }
    let forgiven = (forgiven * seen.len() as f32).floor() as usize;
    let (_, kth, _) = seen.select_nth_unstable_by(forgiven, |a, b| b.total_cmp(a));
    kth.max(trusted)
}

/// Marks where each mask carves alone: the background around it if no other mask contradicts it, judged by a surface that all
/// masks but a few agree on. When a run is stopping ([`is_stopping`]) the marks are of no use.
pub(super) fn mark_trusted(silhouettes: &mut [Silhouette], surface: &SdfGrid) {
    silhouettes.par_iter_mut().for_each(|view| view.carves = Some(Outside::of(view)));
    let carved = carved_by_all(silhouettes, surface);
    let check = |view: &Silhouette| taken_pixels(view, silhouettes, surface, &carved);
    let checks: Vec<(usize, Vec<usize>)> = silhouettes.par_iter().map(check).collect();
    let most = TAKEN_SHARE * checks.iter().map(|(checked, _)| *checked as f32).sum::<f32>();
    let mut taken = vec![0; silhouettes.len()];
    checks.iter().flat_map(|(_, takers)| takers).for_each(|taker| taken[*taker] += 1);
    let doubted = silhouettes.iter_mut().zip(taken).filter(|(_, taken)| *taken as f32 > most);
    doubted.for_each(|(view, _)| view.carves = None);
}

/// The surface without what each mask carves alone.
fn carved_by_all(silhouettes: &[Silhouette], surface: &SdfGrid) -> SdfGrid {
    let carved = |row: usize| {
        let value = surface.values[row];
        if value > surface.spacing || is_stopping() {
            return value;
        }
        value.max(trusted_distance(silhouettes, surface.position(surface.vertex(row))))
    };
    SdfGrid { values: (0..surface.values.len()).into_par_iter().map(carved).collect(), ..surface.clone() }
}

/// The number of pixels of a view that were checked, and for each of them whose ray meets the surface, but nothing once it is carved, the
/// rows of the views that carve there.
fn taken_pixels(
    view: &Silhouette,
    all: &[Silhouette],
    surface: &SdfGrid,
    carved: &SdfGrid,
) -> (usize, Vec<usize>) {
    let depth = CHECK_DEPTH.max(CHECK_CELLS * view.cell_pixels(surface));
    let (mut checked, mut takers) = (0, Vec::new());
    for pixel in (0..view.pixel_count()).step_by(CHECK_STRIDE).filter(|i| view.distance(*i) < -depth) {
        let (x, y) = view.center(pixel);
        if !is_inner(&view.camera, x, y) || is_stopping() {
            continue;
        }
        checked += 1;
        let ray = view.camera.ray(x, y);
        if carved.first_crossing(&ray, 0.0).is_some() {
            continue;
        }
        let Some(first) = surface.first_crossing(&ray, 0.0) else { continue };
        let step = STEP * surface.spacing;
        let along = |k: u32| ray.origin + ray.direction * (first + k as f32 * step);
        // No ray is longer within the grid, beyond which values go on as they are at its border.
        let last = 4 * surface.side;
        let behind = (1..=last).map(along).take_while(|point| surface.value(*point) < 0.0);
        let inside: Vec<Vec3> = std::iter::once(along(0)).chain(behind).collect();
        let carves = |point: &Vec3, row: usize| carve_distance(&all[row], *point).is_some_and(|d| d > 0.0);
        takers.extend((0..all.len()).filter(|row| inside.iter().any(|point| carves(point, *row))));
    }
    (checked, takers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::hull::visual_hull;
    use crate::view::{Camera, Mask, StoredMask};

    const SIZE: u32 = 96;

    /// A table: a plate on two legs.
    fn table(p: Vec3) -> f32 {
        let part = |center: Vec3, half: Vec3| ((p - center).abs() - half).max_element();
        let leg = |x: f32| part(Vec3::new(x, -0.3, 0.0), Vec3::new(0.08, 0.4, 0.4));
        part(Vec3::new(0.0, 0.2, 0.0), Vec3::new(0.6, 0.1, 0.4)).min(leg(-0.5)).min(leg(0.5))
    }

    /// Masks of the table: many from above, two that see between its legs. `wrong` changes what the masks show, by view and point.
    fn views(wrong: impl Fn(usize, Vec3) -> bool) -> Vec<Silhouette> {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 80, table);
        let above = (0..60).map(|k| {
            let angle = k as f32 * 2.4;
            Vec3::new(angle.cos(), 0.9 + 0.01 * k as f32, angle.sin())
        });
        let low = [Vec3::new(0.05, 0.02, 1.0), Vec3::new(-0.05, 0.02, -1.0)];
        let view = |(i, axis): (usize, Vec3)| {
            let camera =
                Camera::look_at(4.0 * axis.normalize(), Vec3::ZERO, Vec3::Y, 36.0, SIZE, SIZE).unwrap();
            let covered = |pixel: u32| {
                let ray = camera.pixel_ray(pixel);
                let hit = grid.first_crossing(&ray, 0.0).map(|t| ray.origin + t * ray.direction);
                if hit.is_some_and(|point| !wrong(i, point)) { 1.0 } else { 0.0 }
            };
            let coverage = (0..SIZE * SIZE).map(covered).collect();
            let mask = StoredMask::new(&Mask { width: SIZE, height: SIZE, coverage });
            Silhouette::new(&format!("v{i}"), &camera, &mask).unwrap()
        };
        above.chain(low).enumerate().map(view).collect()
    }

    const UNDER: Vec3 = Vec3::new(0.0, -0.3, 0.0);
    const LEG: Vec3 = Vec3::new(0.5, -0.4, 0.0);

    #[test]
    fn one_low_view_empties_the_space_under_a_table() {
        let mut views = views(|_, _| false);
        views.pop();
        let hull = visual_hull(&mut views, 48, None).unwrap();
        assert!(views.iter().all(|view| view.carves.is_some()));
        let between = |p: Vec3| p.x.abs() < 0.3 && p.z.abs() < 0.3 && (-0.6..-0.1).contains(&p.y);
        let inner = (0..hull.values.len()).filter(|row| between(hull.position(hull.vertex(*row))));
        let inner: Vec<f32> = inner.map(|row| hull.values[row]).collect();
        // Beside the legs and the plate a mask carves alone only from some pixels on.
        let least = inner.iter().copied().fold(f32::INFINITY, f32::min);
        assert!(inner.len() > 500 && least > -0.1, "{least}");
        assert!(
            hull.value(UNDER) > 0.1 && hull.value(LEG) < 0.0,
            "{} {}",
            hull.value(UNDER),
            hull.value(LEG)
        );
    }

    #[test]
    fn a_mask_that_lacks_a_leg_carves_nothing_alone() {
        let mut views = views(|view, point| view == 60 && point.x > 0.3 && point.y < 0.1);
        let hull = visual_hull(&mut views, 48, None).unwrap();
        let trusted: Vec<bool> = views.iter().map(|view| view.carves.is_some()).collect();
        assert!(!trusted[60] && trusted[61] && trusted[..60].iter().all(|trusted| *trusted), "{trusted:?}");
        assert!(
            hull.value(UNDER) > 0.1 && hull.value(LEG) < 0.0,
            "{} {}",
            hull.value(UNDER),
            hull.value(LEG)
        );
    }

    #[test]
    fn a_hole_in_one_mask_makes_no_tunnel() {
        let hole = |point: Vec3| point.with_y(0.0).length() < 0.2;
        let mut views = views(|view, point| view == 30 && hole(point));
        let hull = visual_hull(&mut views, 48, None).unwrap();
        assert!(hull.value(Vec3::new(0.0, 0.2, 0.0)) < 0.0);
    }
}
