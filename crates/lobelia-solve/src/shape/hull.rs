//! The robust visual hull: at every point of space, how far outside the silhouettes it is.
//!
//! In a view a point is about (pixels to the silhouette) · depth / focal away from the silhouette's
//! cone. The largest of these over the views is the hull's signed distance; the k-th largest
//! forgives k − 1 wrong masks. Views that do not see the point, or see it at the border of the
//! frame, abstain: what the frame cuts is kept.
//!
//! A mask that lacks a part of the object removes it from the hull for all views. Other masks then
//! contain pixels whose rays miss the hull. Where such rays of several views cross, and most views
//! see the object, the part is restored (`regrow`). The same step restores parts that a coarse grid
//! or a step of the fit lost.
//!
//! Often only one or two cameras look from below, and what they alone show to be empty, such as the
//! space under a seat, would stay filled where a share of the masks is forgiven. A mask is
//! therefore trusted if what it removes leaves no ray of another mask without a surface. A trusted
//! mask carves by itself, up to some pixels beside its outline, which is more than the noise of
//! outlines. Its holes do not: a wrong one would become a tunnel that no other outline shows.
//!
//! A field has floaters: space that no mask contradicts. They project into the masks, but always
//! onto what the object covers anyway. A part of the object, such as a link of a chain, is needed:
//! without it masks have pixels that show nothing ([`extract_parts`]).

use crate::shape::silhouette::{MIN_VIEWS, Sighting, Silhouette};
use glam::{Mat3, Vec3};
use lobelia_geometry::error::stop::{check_interrupted, is_stopping};
use lobelia_geometry::mesh::{bvh::TriangleBvh, triangles::Mesh};
use lobelia_geometry::{Error, Result, parallel, sdf::SdfGrid, view::StoredMask};
use lobelia_geometry::{sdf::extract::extract_components, view::Mask, view::raster::signed_distance};
use lobelia_sg::ray::Ray;

/// Share of the views that see a point whose masks may be wrong there.
pub(super) const FORGIVEN: f32 = 0.02;
/// Share of forgiven views where masks show parts that others carved.
const FORGIVEN_AT_GAPS: f32 = 0.12;
/// Cells a side of the grid that finds out how large the object is.
const COARSE_CELLS: u32 = 48;
/// Cells outside a coarse surface beyond which the hull is not looked at more closely: no part of
/// it is as far from all vertices.
const FAR: f32 = 2.5;
/// Cells that a surface may lie outside the hull.
const TRIM_SLACK: f32 = 0.25;
/// Cells outside the surface that are trimmed as well.
const TRIM_REACH: f32 = 3.0;
/// Pixels inside a mask's outline beyond which a ray should meet the object.
const GAP_DEPTH: f32 = 2.5;
/// Views whose gaps must cross in a point, and the same as a share of all views.
const GAP_VIEWS: usize = 3;
const GAP_SHARE: f32 = 0.04;
/// Cells around a gap's rays within which the object is restored.
const GAP_REACH: f32 = 1.5;
/// Most that the distance from a silhouette changes with the way: √2 where it is continued beyond
/// its window, and more off the axis.
const SLOPE: f32 = 2.5;
/// Distance in pixels between the silhouettes of mask and hull from which the mask is rejected;
/// cells of a coarse grid allow more.
const OUTLINE_TOLERANCE: f32 = 3.0;
/// Stride in pixels of the check how well the hull fills a mask.
const SHARE_STRIDE: usize = 7;
/// Shares of a mask that the hull fills, below which the view is noted, and below which in half the
/// views there is no shape.
const NOTED_SHARE: f32 = 0.9;
const REFUSED_SHARE: f32 = 0.6;
/// Pixels beside the outline of a trusted mask that it does not carve alone.
const CARVE_SLACK: f32 = 3.0;
/// Pixels inside a mask's outline beyond which a ray should meet what trusted masks leave; cells of
/// a coarse grid allow more.
const CHECK_DEPTH: f32 = 3.0;
const CHECK_CELLS: f32 = 2.0;
/// Stride of the pixels that are checked.
const CHECK_STRIDE: usize = 7;
/// Share of all checked pixels that a trusted mask may take from the others.
const TAKEN_SHARE: f32 = 1e-4;
/// Length of the steps along a ray inside the surface, in cells.
const STEP: f32 = 0.5;
/// Pixels inside a mask's outline beyond which a ray should meet a part of the object; one of as
/// many pixels is asked.
const PART_DEPTH: f32 = 2.0;
const PART_STRIDE: usize = 7;
/// Pixels of those in a view that a part must show alone for the view to need it.
const PART_PIXELS: usize = 2;
/// Share of the views that must need a part, none of which it may hide behind.
const PART_SHARE: f32 = 0.25;
/// Components beyond the largest that are looked at.
const MOST_PARTS: usize = 63;

/// The visual hull of an object, on a grid of `cells` cells a side that just holds it. Marks the
/// views that it trusts.
///
/// # Errors
/// [`Error::Usage`] if there are fewer than three masks, their middle rays do not meet, or no point
/// is inside all masks.
pub fn visual_hull(silhouettes: &mut [Silhouette], cells: u32) -> Result<SdfGrid> {
    if silhouettes.len() < MIN_VIEWS {
        let problem = "a shape needs at least three views with masks that are not empty";
        return Err(Error::usage(problem, "Give more photographs a mask, white where the object is."));
    }
    let center = meeting_point(silhouettes).ok_or_else(|| {
        Error::usage("the views all look along one line: they show no shape", "Add views from other sides.")
    })?;
    let reach = |s: &Silhouette| s.camera.position().distance(center) * s.spread;
    let radius = silhouettes.iter().map(reach).fold(0.0, f32::max);
    let mut coarse = carve(silhouettes, (center, 1.1 * radius), COARSE_CELLS, None);
    regrow(&mut coarse, silhouettes, FORGIVEN_AT_GAPS);
    mark_trusted(silhouettes, &coarse);
    check_interrupted()?;
    // The box around all vertices inside or so near that a thin part may be between them and the
    // next.
    let is_near = |row: &usize| coarse.values[*row] < 0.5 * coarse.spacing;
    let near = (0..coarse.values.len()).filter(is_near).map(|row| coarse.position(coarse.vertex(row)));
    let bounds = near.map(|at| (at, at)).reduce(|(a, b), (c, d)| (a.min(c), b.max(d)));
    let (low, high) = bounds.ok_or_else(|| no_hull(silhouettes, &coarse))?;
    let half = 0.5 * (high - low).max_element() + coarse.spacing;
    let mut hull = carve(silhouettes, (0.5 * (low + high), half), cells, Some(&coarse));
    regrow(&mut hull, silhouettes, FORGIVEN_AT_GAPS);
    check_interrupted()?;
    if hull.values.iter().all(|value| *value >= 0.0) {
        return Err(no_hull(silhouettes, &hull));
    }
    Ok(hull)
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

/// The hull in the cube around a center, with half its side. Far outside a `coarse` one its values
/// are taken; not inside, for it knows of no mask that carves alone.
fn carve(
    silhouettes: &[Silhouette],
    (center, half_side): (Vec3, f32),
    cells: u32,
    coarse: Option<&SdfGrid>,
) -> SdfGrid {
    let outside = 2.0 * half_side / cells as f32;
    let far = |point| {
        let (value, cell) = coarse.map(|coarse| (coarse.value(point), coarse.spacing))?;
        (value > FAR * cell).then_some(value)
    };
    // What is not carved is dropped by whoever asked for it.
    let distance = |point| far(point).unwrap_or_else(|| hull_distance(silhouettes, point, FORGIVEN, outside));
    SdfGrid::from_fn(center, half_side, cells, |point| if is_stopping() { outside } else { distance(point) })
}

/// The hull's signed distance at a point, with this share of the views forgiven, except what
/// trusted views carve alone; `outside` if too few see it.
fn hull_distance(silhouettes: &[Silhouette], point: Vec3, forgiven: f32, outside: f32) -> f32 {
    let (mut seen, mut trusted) = (Vec::with_capacity(silhouettes.len()), f32::NEG_INFINITY);
    for view in silhouettes {
        let Some(sighting) = view.look(point) else { continue };
        seen.push(sighting.pixels * sighting.pixel_size);
        trusted = carve_distance(view, &sighting).map_or(trusted, |distance| trusted.max(distance));
    }
    if seen.len() < MIN_VIEWS {
        return outside;
    }
    let forgiven = (forgiven * seen.len() as f32).floor() as usize;
    let (_, kth, _) = seen.select_nth_unstable_by(forgiven, |a, b| b.total_cmp(a));
    kth.max(trusted)
}

/// An empty hull, with the view that is farthest from seeing what the others come nearest to
/// agreeing on.
fn no_hull(silhouettes: &[Silhouette], coarse: &SdfGrid) -> Error {
    let seen = |point: Vec3| silhouettes.iter().filter_map(move |s| Some((s, s.world_distance(point)?)));
    // The point that most masks show, and of those the one least outside.
    let agreement = |row: usize| {
        let point = coarse.position(coarse.vertex(row));
        let inside = seen(point).filter(|(_, distance)| *distance < 0.0).count();
        (inside, std::cmp::Reverse(row))
    };
    let agreements = parallel::map(coarse.values.len(), 1024, agreement).into_iter();
    let (inside, std::cmp::Reverse(best)) = agreements.max().unwrap_or_default();
    let point = coarse.position(coarse.vertex(best));
    let worst = seen(point).max_by(|a, b| a.1.total_cmp(&b.1)).map_or(&silhouettes[0], |worst| worst.0);
    let all = silhouettes.len();
    let problem = format!(
        "no point of space is inside all masks: the best is in {inside} of {all}; view `{}` is farthest off",
        worst.name
    );
    let help = "Do cameras and masks belong together? Repair that view's pose or mask, or leave it out with `select`.";
    Error::usage(problem, help)
}

/// Removes from `grid` what lies outside the hull, as [`visual_hull`] has it, by more than
/// [`TRIM_SLACK`] cells, and restores what most masks show. Marks the views that it trusts. Changed
/// values are not exact distances.
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

/// Restores what all masks but a share of `forgiven` show and `grid` lacks. Changed values are not
/// exact distances. A run that is stopping ([`is_stopping`]) restores not all.
pub(super) fn regrow(grid: &mut SdfGrid, silhouettes: &[Silhouette], forgiven: f32) {
    let gaps: Vec<Silhouette> = parallel::flat_map(silhouettes.len(), 1, |i| gaps(grid, &silhouettes[i]));
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
    // What is restored lies within reach of the gaps: values far from them remain, but none says
    // more than the distance to that.
    let is_far = |middle: Vec3, radius: f32| {
        let all_see = gaps.iter().all(|gap| gap.world_distance(middle).is_some());
        let room = gap_distance(middle).filter(|_| all_see)? - reach - SLOPE * radius;
        (room > whole.spacing).then_some(room)
    };
    let grown = |row: usize| {
        let (point, value) = (whole.position(whole.vertex(row)), whole.values[row]);
        let beyond = gap_distance(point).map(|distance| distance - reach);
        let beyond = beyond.filter(|beyond| *beyond <= value && !is_stopping());
        beyond
            .map_or(value, |beyond| value.min(beyond.max(hull_distance(silhouettes, point, forgiven, reach))))
    };
    grid.values = whole.replaced_in_blocks(is_far, grown);
}

/// The pixels well inside a mask whose rays miss the surface, as a mask; `None` if there are none.
/// Of the pixels in a square as wide as a cell the one deepest inside is asked for all.
fn gaps(grid: &SdfGrid, view: &Silhouette) -> Option<Silhouette> {
    let (width, height) = (view.camera.width, view.camera.height);
    let side = (view.cell_pixels(grid) as u32).max(1);
    let mut coverage = vec![0.0; view.pixel_count()];
    for square in view.mask.window().squares(side).take_while(|_| !is_stopping()) {
        let inside: Vec<usize> = square.pixels(width).filter(|i| view.is_within(*i, GAP_DEPTH)).collect();
        let deepest = inside.iter().min_by(|a, b| view.distance(**a).total_cmp(&view.distance(**b)));
        if deepest.is_some_and(|deepest| grid.first_crossing(&view.ray(*deepest), 0.0).is_none()) {
            inside.iter().for_each(|i| coverage[*i] = 1.0);
        }
    }
    let missing = Mask { width, height, coverage };
    Silhouette::new(&view.name, &view.camera, &StoredMask::new(&missing))
}

/// Checks that the hull fills the masks it was made of; the notes name views whose masks it does
/// not.
///
/// # Errors
/// [`Error::Usage`] with a view's name if it leaves most of most masks empty: they do not belong to
/// their cameras.
pub fn check_hull(hull: &SdfGrid, silhouettes: &[Silhouette]) -> Result<Vec<String>> {
    // Near counts as met, to half the diagonal of a cell: what is thinner falls between the grid's
    // vertices.
    let near = 0.87 * hull.spacing;
    let is_met = |ray: &Ray| hull.least_distance(ray, near).is_some_and(|least| least.value < near);
    // The share of a mask's pixels, not at the frame's border, whose rays meet the surface; 1 if it
    // has none there.
    let covered = |view: &Silhouette| {
        let pixels = (0..view.pixel_count()).filter(|i| view.is_within(*i, 0.0)).step_by(SHARE_STRIDE);
        let (all, hit) = pixels.fold((0, 0), |(all, hit), i| {
            (all + 1, hit + usize::from(!is_stopping() && is_met(&view.ray(i))))
        });
        if all == 0 { 1.0 } else { hit as f32 / all as f32 }
    };
    let mut shares: Vec<_> = parallel::map_slice(silhouettes, 1, |view| (covered(view), view.name.as_str()));
    check_interrupted()?;
    shares.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(b.1)));
    let percent = |share: f32| (100.0 * share).round();
    let (Some((worst, name)), Some((median, _))) = (shares.first(), shares.get(shares.len() / 2)) else {
        return Ok(Vec::new());
    };
    if *median < REFUSED_SHARE {
        let problem = format!(
            "cameras and masks do not belong together: what all masks share fills {} % of the mask of view `{name}`, and {} % \
             of a typical one",
            percent(*worst),
            percent(*median)
        );
        let help = "Are masks and poses paired by the right names, and poses in the layout's axes? Are intrinsics in pixels \
                    of these images?";
        return Err(Error::usage(problem, help));
    }
    let note = |(share, name): &(f32, &str)| {
        let percent = percent(*share);
        format!("the other views' masks fill only {percent} % of the mask of view {name}: is it right?")
    };
    Ok(shares.iter().take_while(|share| share.0 < NOTED_SHARE).map(note).collect())
}

/// For each pixel of a view, whether its mask is reliable there: not at the border of the frame,
/// and nowhere near a place where the silhouette of the hull is far from that of the mask.
pub(super) fn reliable_pixels(hull: &SdfGrid, view: &Silhouette) -> Vec<bool> {
    let tolerance = OUTLINE_TOLERANCE.max(1.0 + view.cell_pixels(hull));
    let contradicts = |i: usize| {
        let far = !is_stopping() && (tolerance..3.0 * tolerance).contains(&view.distance(i).abs());
        let hit = || hull.first_crossing(&view.ray(i), 0.0).is_some();
        if far && view.is_inner(i) && hit() != (view.distance(i) < 0.0) { 1.0 } else { 0.0 }
    };
    let wrong: Vec<f32> = parallel::map(view.pixel_count(), 1024, contradicts);
    let to_wrong = wrong
        .contains(&1.0)
        .then(|| signed_distance(&wrong, view.camera.width as usize, view.camera.height as usize));
    let is_apart = |i: usize| to_wrong.as_ref().is_none_or(|to_wrong| to_wrong[i] > tolerance + 1.0);
    (0..wrong.len()).map(|i| view.is_inner(i) && is_apart(i)).collect()
}

/// How far a point that a view sees is outside what its mask carves alone, in world units; `None`
/// where it does not, or is doubted.
fn carve_distance(view: &Silhouette, sighting: &Sighting) -> Option<f32> {
    let carves = view.carves.as_ref()?;
    let beyond = sighting.pixels - CARVE_SLACK;
    let pixel = sighting.y as usize * view.camera.width as usize + sighting.x as usize;
    let is_outside = || view.mask.window().place(pixel, view.camera.width).is_none_or(|at| carves[at]);
    (beyond <= 0.0 || is_outside()).then_some(beyond * sighting.pixel_size)
}

/// Marks where each mask carves alone: the background around it if no other mask contradicts it,
/// judged by a surface that all masks but a few agree on. When a run is stopping ([`is_stopping`])
/// the marks are of no use.
fn mark_trusted(silhouettes: &mut [Silhouette], surface: &SdfGrid) {
    parallel::for_each(silhouettes.iter_mut(), |view| view.carves = Some(view.outside()));
    // The surface without what each mask carves alone.
    let carved = |row: usize| {
        let value = surface.values[row];
        if value > surface.spacing || is_stopping() {
            return value;
        }
        let point = surface.position(surface.vertex(row));
        let distances = silhouettes.iter().filter_map(|view| carve_distance(view, &view.look(point)?));
        value.max(distances.fold(f32::NEG_INFINITY, f32::max))
    };
    let values = parallel::map(surface.values.len(), 1024, carved);
    let carved = SdfGrid { values, ..*surface };
    let check = |view: &Silhouette| takers(view, silhouettes, surface, &carved);
    let checks: Vec<(usize, Vec<usize>)> = parallel::map_slice(silhouettes, 1, check);
    let most = TAKEN_SHARE * checks.iter().map(|(checked, _)| *checked as f32).sum::<f32>();
    let mut taken = vec![0; silhouettes.len()];
    checks.iter().flat_map(|(_, takers)| takers).for_each(|taker| taken[*taker] += 1);
    let doubted = silhouettes.iter_mut().zip(taken).filter(|(_, taken)| *taken as f32 > most);
    doubted.for_each(|(view, _)| view.carves = None);
}

/// The number of pixels of a view that were checked, and for each of them whose ray meets the
/// surface, but nothing once it is carved, the rows of the views that carve there.
fn takers(view: &Silhouette, all: &[Silhouette], surface: &SdfGrid, carved: &SdfGrid) -> (usize, Vec<usize>) {
    let depth = CHECK_DEPTH.max(CHECK_CELLS * view.cell_pixels(surface));
    let (mut checked, mut takers) = (0, Vec::new());
    let pixels = (0..view.pixel_count()).step_by(CHECK_STRIDE);
    for pixel in pixels.filter(|i| view.is_within(*i, depth)).take_while(|_| !is_stopping()) {
        checked += 1;
        let ray = view.ray(pixel);
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
        let carves = |view: &Silhouette, point: &Vec3| {
            view.look(*point).and_then(|at| carve_distance(view, &at)).is_some_and(|distance| distance > 0.0)
        };
        takers.extend((0..all.len()).filter(|row| inside.iter().any(|point| carves(&all[*row], point))));
    }
    (checked, takers)
}

/// The zero level of the field as a mesh: its largest component, and the others that the masks
/// show.
pub fn extract_parts(grid: &SdfGrid, silhouettes: &[Silhouette]) -> Mesh {
    let mut components = extract_components(grid).into_iter();
    let Some(mut mesh) = components.next() else { return Mesh::default() };
    let others: Vec<Mesh> = components.take(MOST_PARTS).collect();
    if others.is_empty() || silhouettes.is_empty() {
        return mesh;
    }
    let largest = TriangleBvh::new(&mesh);
    // Rays through pixels well inside a mask that miss the surface; other columns in each row,
    // whatever the width.
    let missing = |view: &Silhouette| -> Vec<Ray> {
        let width = view.camera.width as usize;
        let is_asked = |i: &usize| (i % width + 3 * (i / width)).is_multiple_of(PART_STRIDE);
        let asked = (0..view.pixel_count()).filter(is_asked).filter(|i| view.is_within(*i, PART_DEPTH));
        asked.map(|i| view.ray(i)).filter(|ray| largest.nearest(ray, 0.0).is_none()).collect()
    };
    let mut missing: Vec<Vec<Ray>> = parallel::map_slice(silhouettes, 1, missing);
    let needed = MIN_VIEWS.max((PART_SHARE * silhouettes.len() as f32).ceil() as usize);
    for other in others {
        let bvh = TriangleBvh::new(&other);
        let meets = |ray: &&Ray| bvh.nearest(ray, 0.0).is_some();
        let shows = |rays: &Vec<Ray>| rays.iter().filter(meets).take(PART_PIXELS).count() == PART_PIXELS;
        if parallel::map_slice(&missing, 1, shows).into_iter().filter(|shows| *shows).count() < needed {
            continue;
        }
        parallel::for_each(&mut missing, |rays| rays.retain(|ray| !meets(&ray)));
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(other.positions);
        mesh.normals.extend(other.normals);
        mesh.triangles.extend(other.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::test_support::{around, meets_ball, silhouettes, silhouettes_but};
    use glam::Vec3A;
    use lobelia_geometry::view::Camera;

    const BALL: f32 = 0.9;
    const SIZE: u32 = 96;

    fn ball(count: usize) -> Vec<Silhouette> {
        silhouettes_but(&around(count, 4.0, SIZE), |ray| meets_ball(ray, Vec3::ZERO, BALL), |_, _| false)
    }

    fn with_pixel(view: &Silhouette, pixel: usize) -> Silhouette {
        let coverage = (0..96 * 96).map(|i| f32::from(u8::from(i == pixel))).collect();
        let mask = StoredMask::new(&Mask { width: 96, height: 96, coverage });
        Silhouette::new(&view.name, &view.camera, &mask).unwrap()
    }

    #[test]
    fn the_hull_of_a_ball_is_the_ball_wherever_it_lies() {
        let center = Vec3::new(5.0, -3.0, 2.0);
        let mut cameras = around(40, 4.0, 96);
        cameras.iter_mut().for_each(|camera: &mut Camera| {
            camera.world_from_camera.translation += Vec3A::from(center);
        });
        let mut views = silhouettes_but(&cameras, |ray| meets_ball(ray, center, BALL), |_, _| false);
        let grid = visual_hull(&mut views, 40).unwrap();
        for (i, value) in grid.values.iter().enumerate() {
            let exact = grid.position(grid.vertex(i)).distance(center) - BALL;
            assert!(exact.abs() >= 0.3 || (value - exact).abs() < 0.05, "{value} {exact}");
        }
    }

    #[test]
    fn one_wrong_mask_of_many_does_not_carve_the_object_away() {
        let mut views = ball(60);
        views[7] = with_pixel(&views[7], 0);
        assert!(visual_hull(&mut views, 24).unwrap().value(Vec3::ZERO) < -0.5);
    }

    /// A fin beyond the masks goes; what is inside stays as it is.
    #[test]
    fn what_lies_outside_the_hull_is_trimmed() {
        let mut views = ball(40);
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
        let views = ball(12);
        let mut views: Vec<_> =
            views.iter().enumerate().map(|(i, view)| with_pixel(view, 300 + 997 * i % 8900)).collect();
        let error = visual_hull(&mut views, 24).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let said = error.to_string();
        assert!(said.contains("inside all masks") && said.contains("view `v"), "{said}");
        assert!(visual_hull(&mut views[..2], 24).is_err());
    }

    fn horned(p: Vec3) -> f32 {
        let horn = (p - Vec3::Y * p.y.clamp(0.0, 0.8)).length() - 0.15;
        (p.length() - 0.5).min(horn)
    }

    /// Views of the object; in those of `blind` the mask ends at a height, as if the horn had been
    /// too dark.
    fn horned_views(blind: &[usize]) -> Vec<Silhouette> {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 64, horned);
        let hidden = |view: usize, point: Vec3| blind.contains(&view) && point.y >= 0.5;
        silhouettes_but(&around(60, 4.0, SIZE), |ray| grid.first_crossing(ray, 0.0), hidden)
    }

    const BLIND: [usize; 5] = [20, 25, 30, 35, 40];
    const HORN: Vec3 = Vec3::new(0.0, 0.7, 0.0);

    #[test]
    fn a_part_that_a_few_masks_lack_is_put_back() {
        let sound = visual_hull(&mut horned_views(&[]), 48).unwrap();
        let repaired = visual_hull(&mut horned_views(&BLIND), 48).unwrap();
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
        let mut views = horned_views(&BLIND);
        let hull = visual_hull(&mut views, 48).unwrap();
        for (i, view) in views.iter().enumerate() {
            let reliable = reliable_pixels(&hull, view);
            let kept = reliable.iter().filter(|reliable| **reliable).count();
            assert!(kept > reliable.len() / 2, "view {i}: {kept}");
            if BLIND.contains(&i) {
                let (x, y, _) = view.camera.project(HORN).unwrap();
                assert!(!reliable[y as usize * SIZE as usize + x as usize], "view {i}");
            } else {
                let doubted = (0..reliable.len()).filter(|&p| view.is_inner(p) && !reliable[p]).count();
                assert!(doubted < reliable.len() / 50, "view {i}: {doubted}");
            }
        }
    }

    fn shifted(view: &Silhouette) -> Silhouette {
        let mut camera = view.camera;
        camera.center[0] += 30.0;
        Silhouette::new(&view.name, &camera, &view.mask).unwrap()
    }

    #[test]
    fn masks_that_the_hull_does_not_fill_are_named_or_refused() {
        let mut views = horned_views(&[]);
        let hull = visual_hull(&mut views, 48).unwrap();
        assert!(check_hull(&hull, &views).unwrap().is_empty());
        views[4] = shifted(&views[4]);
        let notes = check_hull(&hull, &views).unwrap();
        assert!(notes.len() == 1 && notes[0].contains("v4"), "{notes:?}");
        let wrong: Vec<Silhouette> = views.iter().map(shifted).collect();
        let error = check_hull(&hull, &wrong).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("`v"), "{error}");
    }

    fn table(p: Vec3) -> f32 {
        let part = |center: Vec3, half: Vec3| ((p - center).abs() - half).max_element();
        let leg = |x: f32| part(Vec3::new(x, -0.3, 0.0), Vec3::new(0.08, 0.4, 0.4));
        part(Vec3::new(0.0, 0.2, 0.0), Vec3::new(0.6, 0.1, 0.4)).min(leg(-0.5)).min(leg(0.5))
    }

    /// Masks of the table: many from above, two that see between its legs. `wrong` changes what the
    /// masks show, by view and point.
    fn table_views(wrong: impl Fn(usize, Vec3) -> bool + Sync) -> Vec<Silhouette> {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 80, table);
        let above = (0..60).map(|k| {
            let angle = k as f32 * 2.4;
            Vec3::new(angle.cos(), 0.9 + 0.01 * k as f32, angle.sin())
        });
        let low = [Vec3::new(0.05, 0.02, 1.0), Vec3::new(-0.05, 0.02, -1.0)];
        let camera = |axis: Vec3| {
            Camera::look_at(4.0 * axis.normalize(), Vec3::ZERO, Vec3::Y, 36.0, SIZE, SIZE).unwrap()
        };
        let cameras: Vec<Camera> = above.chain(low).map(camera).collect();
        silhouettes_but(&cameras, |ray| grid.first_crossing(ray, 0.0), wrong)
    }

    const UNDER: Vec3 = Vec3::new(0.0, -0.3, 0.0);
    const LEG: Vec3 = Vec3::new(0.5, -0.4, 0.0);

    #[test]
    fn one_low_view_empties_the_space_under_a_table() {
        let mut views = table_views(|_, _| false);
        views.pop();
        let hull = visual_hull(&mut views, 48).unwrap();
        assert!(views.iter().all(|view| view.carves.is_some()));
        let between = |p: Vec3| p.x.abs() < 0.3 && p.z.abs() < 0.3 && (-0.6..-0.1).contains(&p.y);
        let inner = (0..hull.values.len()).filter(|row| between(hull.position(hull.vertex(*row))));
        let inner: Vec<f32> = inner.map(|row| hull.values[row]).collect();
        // Beside the legs and the plate a mask carves alone only from some pixels on.
        let least = inner.iter().copied().fold(f32::INFINITY, f32::min);
        assert!(inner.len() > 500 && least > -0.1, "{least}");
        assert!(hull.value(UNDER) > 0.1 && hull.value(LEG) < 0.0);
    }

    #[test]
    fn a_mask_that_lacks_a_leg_carves_nothing_alone() {
        let mut views = table_views(|view, point| view == 60 && point.x > 0.3 && point.y < 0.1);
        let hull = visual_hull(&mut views, 48).unwrap();
        let trusted: Vec<bool> = views.iter().map(|view| view.carves.is_some()).collect();
        assert!(!trusted[60] && trusted[61] && trusted[..60].iter().all(|trusted| *trusted), "{trusted:?}");
        assert!(hull.value(UNDER) > 0.1 && hull.value(LEG) < 0.0);
    }

    #[test]
    fn a_hole_in_one_mask_makes_no_tunnel() {
        let hole = |point: Vec3| point.with_y(0.0).length() < 0.2;
        let mut views = table_views(|view, point| view == 30 && hole(point));
        let hull = visual_hull(&mut views, 48).unwrap();
        assert!(hull.value(Vec3::new(0.0, 0.2, 0.0)) < 0.0);
    }

    fn bead(p: Vec3, x: f32, radius: f32) -> f32 {
        p.distance(Vec3::new(x, 0.0, 0.0)) - radius
    }

    fn on_grid(field: impl Fn(Vec3) -> f32 + Sync) -> SdfGrid {
        SdfGrid::from_fn(Vec3::ZERO, 1.0, 48, field)
    }

    /// The least and the largest x of the mesh.
    fn width(mesh: &Mesh) -> (f32, f32) {
        mesh.positions.iter().fold((f32::MAX, f32::MIN), |(low, high), p| (low.min(p.x), high.max(p.x)))
    }

    #[test]
    fn every_part_that_masks_show_is_kept() {
        let beads = |p: Vec3| bead(p, -0.6, 0.3).min(bead(p, 0.1, 0.25)).min(bead(p, 0.7, 0.2));
        let mesh = extract_parts(&on_grid(beads), &silhouettes(&around(24, 3.5, 96), &on_grid(beads)));
        let (low, high) = width(&mesh);
        assert!((low + 0.9).abs() < 0.01 && (high - 0.9).abs() < 0.01, "{low} {high}");
        assert!(mesh.positions.iter().any(|p| (p.x - 0.1).abs() < 0.05), "the bead between them");
        assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < mesh.positions.len()));
    }

    #[test]
    fn what_no_mask_needs_is_dropped() {
        let object = |p: Vec3| bead(p, 0.0, 0.6);
        // One floater is beside the object in every mask, a void is within it.
        let found = |p: Vec3| object(p).max(-bead(p, 0.0, 0.2)).min(bead(p, 0.85, 0.1));
        let mesh = extract_parts(&on_grid(found), &silhouettes(&around(24, 3.5, 96), &on_grid(object)));
        assert!(width(&mesh).1 < 0.62, "{:?}", width(&mesh));
        assert!(mesh.positions.iter().all(|p| p.length() > 0.5));
    }
}
