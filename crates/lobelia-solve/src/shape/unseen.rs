//! Surface that no photograph sees: spanned like a film of soap.
//!
//! Photographs from above leave a cone below the object, those from the front a wedge behind it:
//! the hull is as large as the masks allow. Nothing in the photographs holds this surface. It moves
//! by its mean curvature, only into the hull, while what is seen stays: a seat gets a flat bottom.
//! Where a mask would lose its surface, the surface is held too, and the motion begins again. On a
//! fine grid it begins with what it comes to on a coarser one.
//!
//! Source: motion of level sets by mean curvature (Osher and Sethian, "Fronts Propagating with
//! Curvature-Dependent Speed", 1988, ∂φ/∂t = κ |∇φ|).

use crate::shape::{cube, is_border, silhouette::Silhouette, volume};
use glam::Vec3;
use lobelia_geometry::{error::stop::is_stopping, parallel, sdf::SdfGrid};

/// Cosine of the angle between ray and normal from which one view, and from which each of two, sees
/// a surface: flatter rays only touch the cone that the masks leave.
const ONE_VIEW: f32 = 0.5;
const TWO_VIEWS: f32 = 0.2;
/// Rays of a view per cell, along each axis; cells, and most pixels, within the outline of a mask
/// from which a pixel must not lose its surface.
const RAYS_PER_CELL: f32 = 2.0;
const DEPTH: f32 = 1.0;
const MOST_DEPTH: f32 = 12.0;
/// Cells around the zero level that move.
const BAND: f32 = 2.5;
/// Most steps; steps from one redistancing to the next; steps before the volume may end the motion.
const MOST_STEPS: usize = 1000;
const REDISTANCE: usize = 20;
const LEAST_STEPS: usize = 200;
/// Cells a side of the grid on which the surface moves farthest; on a finer grid it only gets
/// smooth, in so many steps.
pub(super) const SPANNED_CELLS: u32 = 128;
const SMOOTHING_STEPS: usize = 40;
/// Most motions, each with what the masks lost in the one before held too.
const ROUNDS: usize = 4;
/// Step of time in squares of a cell; more than ¼ is unstable.
const TIME_STEP: f32 = 1.0 / 6.0;
/// Largest curvature that counts, per cell.
const MOST_CURVATURE: f32 = 2.0;

/// Spans the surface that no silhouette's camera sees; returns the share of the object's volume
/// that goes. A field that is seen from all sides keeps its bits. On a grid of more than `most`
/// cells a side it begins with the film that it comes to on as many: the film is smooth, and on
/// fine cells it would move for a time that grows with the square of their number. A run that is
/// stopping ([`is_stopping`]) leaves the field as it was at the last redistancing.
pub(super) fn span_unseen(grid: &mut SdfGrid, silhouettes: &[Silhouette], most: u32) -> f32 {
    let mut hull = grid.clone();
    hull.redistance_near();
    let mut is_seen = seen(&hull, silhouettes);
    let is_held = |(value, is_seen): (&f32, &bool)| *is_seen || value.abs() >= hull.spacing;
    if hull.values.iter().zip(&is_seen).all(is_held) {
        return 0.0;
    }
    let film = (grid.side - 1 > most).then(|| {
        let mut film = hull.resampled(most);
        span_unseen(&mut film, silhouettes, most);
        film
    });
    let steps = if film.is_some() { SMOOTHING_STEPS } else { MOST_STEPS };
    for _ in 0..ROUNDS {
        grid.clone_from(&hull);
        if let Some(film) = &film {
            // What the coarser film has removed goes where the hull is not seen.
            let value = |row: usize| {
                let value = hull.values[row];
                if is_seen[row] { value } else { value.max(film.value(hull.position(hull.vertex(row)))) }
            };
            grid.values = parallel::map(is_seen.len(), 1024, value);
            grid.redistance_near();
        }
        settle(grid, &hull.values, &is_seen, steps);
        let lost = lost(&hull, grid, silhouettes);
        if is_stopping() || !lost.contains(&true) {
            break;
        }
        // A coarse film is not to be put in beside what is held, or that would hang before it.
        let cells = film.as_ref().map_or(1, |film| 1 + (film.spacing / hull.spacing).ceil() as usize);
        let held = (0..cells).fold(lost, |lost, _| grown(&hull, &lost));
        is_seen.iter_mut().zip(held).for_each(|(is_seen, is_held)| *is_seen |= is_held);
    }
    1.0 - volume(grid) as f32 / volume(&hull).max(1) as f32
}

/// Moves what is not seen until the volume stays, or for `steps`.
fn settle(grid: &mut SdfGrid, hull: &[f32], is_seen: &[bool], steps: usize) {
    let (reach, time) = (BAND * grid.spacing, TIME_STEP * grid.spacing * grid.spacing);
    let held: Vec<usize> = (0..hull.len()).filter(|&row| is_seen[row] && hull[row].abs() < reach).collect();
    let mut last = 0;
    for step in (REDISTANCE..=steps).step_by(REDISTANCE) {
        if is_stopping() {
            break;
        }
        let is_near = |row: &usize| !is_seen[*row] && grid.values[*row].abs() < 2.0 * reach;
        let near: Vec<usize> = (0..hull.len()).filter(is_near).collect();
        for _ in 0..REDISTANCE {
            // Those in the band move by mean curvature, not outward.
            let moved = |i: usize| {
                let row = near[i];
                let value = grid.values[row];
                let speed = if value.abs() < reach { curvature(grid, row) } else { None }?;
                Some((row, (value + time * speed).max(hull[row])))
            };
            let band: Vec<(usize, f32)> = parallel::flat_map(near.len(), 1024, moved);
            band.into_iter().for_each(|(row, value)| grid.values[row] = value);
        }
        grid.redistance_near();
        held.iter().for_each(|&row| grid.values[row] = hull[row]);
        let now = volume(grid);
        if step > LEAST_STEPS && now == last {
            break;
        }
        last = now;
    }
}

/// κ |∇φ| = Δφ − ∇φᵀ H ∇φ / |∇φ|² by central differences; `None` on the border of the grid.
fn curvature(grid: &SdfGrid, row: usize) -> Option<f32> {
    if is_border(grid, row) {
        return None;
    }
    let (h, side) = (grid.spacing, grid.side as usize);
    let value = &grid.values;
    let strides = [1, side, side * side];
    let slope = Vec3::from(strides.map(|s| (value[row + s] - value[row - s]) / (2.0 * h)));
    let second = Vec3::from(strides.map(|s| (value[row + s] - 2.0 * value[row] + value[row - s]) / (h * h)));
    let mixed = |a: usize, b: usize| {
        let (same, opposite) =
            (value[row + a + b] + value[row - a - b], value[row + a - b] + value[row - a + b]);
        (same - opposite) / (4.0 * h * h)
    };
    let [x, y, z] = strides;
    let cross = Vec3::new(mixed(y, z), mixed(x, z), mixed(x, y));
    let along = (slope * slope).dot(second)
        + 2.0 * (slope.y * slope.z * cross.x + slope.x * slope.z * cross.y + slope.x * slope.y * cross.z);
    let laplacian = second.element_sum();
    let limit = MOST_CURVATURE / h;
    Some((laplacian - along / slope.length_squared().max(1e-4)).clamp(-limit, limit))
}

/// The vertices within a cell of those around the surface that is seen: steeply by one view, or by
/// two.
fn seen(grid: &SdfGrid, silhouettes: &[Silhouette]) -> Vec<bool> {
    let of_views: Vec<_> = parallel::map_slice(silhouettes, 1, |view| seen_by(grid, view));
    let mut sightings = vec![0u8; grid.values.len()];
    for (row, is_steep) in of_views.into_iter().flatten() {
        sightings[row] = sightings[row].saturating_add(if is_steep { 2 } else { 1 });
    }
    let marked: Vec<bool> = sightings.into_iter().map(|count| count >= 2).collect();
    grown(grid, &marked)
}

/// The vertices within a cell of those that are marked.
fn grown(grid: &SdfGrid, marked: &[bool]) -> Vec<bool> {
    let is_near = |row: usize| cube(grid, row).any(|(other, _)| marked[other]);
    parallel::map(grid.values.len(), 1024, is_near)
}

/// Evenly spread pixels of a view's mask.
fn mask_pixels<'a>(grid: &SdfGrid, view: &'a Silhouette) -> impl Iterator<Item = usize> + use<'a> {
    let stride = ((view.cell_pixels(grid) / RAYS_PER_CELL) as usize).max(1);
    let (width, height) = (view.camera.width as usize, view.camera.height as usize);
    let rows = (stride / 2..height).step_by(stride);
    let pixels = rows.flat_map(move |y| (stride / 2..width).step_by(stride).map(move |x| y * width + x));
    pixels.filter(|&pixel| view.mask.coverage(pixel) > 0.0).take_while(|_| !is_stopping())
}

/// The vertices around the surface that one view sees, each once, and whether it sees them steeply
/// enough to count alone.
fn seen_by(grid: &SdfGrid, view: &Silhouette) -> Vec<(usize, bool)> {
    let mut vertices = Vec::new();
    for pixel in mask_pixels(grid, view) {
        let ray = view.ray(pixel);
        let Some(distance) = grid.first_crossing(&ray, 0.0) else { continue };
        let point = ray.origin + ray.direction * distance;
        let cosine = -grid.gradient(point).normalize_or_zero().dot(ray.direction);
        if cosine > TWO_VIEWS {
            vertices.extend(grid.corners(point).map(|(row, _)| (row, cosine > ONE_VIEW)));
        }
    }
    // Of several rays, the steepest counts.
    vertices.sort_unstable_by_key(|&(row, is_steep)| (row, !is_steep));
    vertices.dedup_by_key(|(row, _)| *row);
    vertices.shrink_to_fit();
    vertices
}

/// The vertices around the points of the hull that masks show and the field `now` has no longer.
fn lost(hull: &SdfGrid, now: &SdfGrid, silhouettes: &[Silhouette]) -> Vec<bool> {
    let of_view = |view: &Silhouette| -> Vec<usize> {
        let depth = (DEPTH * view.cell_pixels(hull)).min(MOST_DEPTH);
        let inner = mask_pixels(hull, view).filter(|&pixel| view.distance(pixel) < -depth);
        let rays = inner.map(|pixel| view.ray(pixel)).filter(|ray| now.first_crossing(ray, 0.0).is_none());
        let met = rays.filter_map(|ray| Some(ray.origin + ray.direction * hull.first_crossing(&ray, 0.0)?));
        met.flat_map(|point| hull.corners(point).map(|(row, _)| row)).collect()
    };
    let rows: Vec<Vec<usize>> = parallel::map_slice(silhouettes, 1, of_view);
    let mut is_lost = vec![false; hull.values.len()];
    rows.into_iter().flatten().for_each(|row| is_lost[row] = true);
    is_lost
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{hull::visual_hull, test_support};
    use lobelia_geometry::view::Camera;

    /// The masks of a field, by cameras on a part of a circle at a height.
    fn silhouettes(height: f32, circle: f32, of: impl Fn(Vec3) -> f32 + Sync) -> Vec<Silhouette> {
        let field = SdfGrid::from_fn(Vec3::ZERO, 0.8, 48, of);
        let cameras = (0..24).map(|k| {
            let angle = k as f32 * circle * std::f32::consts::TAU / 24.0;
            let eye = Vec3::new(3.0 * angle.cos(), height, 3.0 * angle.sin());
            Camera::look_at(eye, Vec3::ZERO, Vec3::Y, 36.0, 96, 96).unwrap()
        });
        test_support::silhouettes(&cameras.collect::<Vec<_>>(), &field)
    }

    fn ball(p: Vec3) -> f32 {
        p.length() - 0.5
    }

    fn lowest(grid: &SdfGrid) -> f32 {
        let inside = (0..grid.values.len()).filter(|&row| grid.values[row] < 0.0);
        inside.map(|row| grid.position(grid.vertex(row)).y).fold(f32::INFINITY, f32::min)
    }

    #[test]
    fn a_table_seen_from_above_loses_the_cone_below_it() {
        let plate = |p: Vec3| (p.with_y(0.0).length() - 0.5).max(p.y.abs() - 0.1);
        let mut above_it = silhouettes(1.5, 1.0, plate);
        let grid = visual_hull(&mut above_it, 40).unwrap();
        assert!(lowest(&grid) < -0.25, "no cone: {}", lowest(&grid));
        let top = |grid: &SdfGrid| grid.value(Vec3::new(0.1, 0.1, 0.2));
        let before = top(&grid);
        // At once, and on half as many cells first.
        for most in [SPANNED_CELLS, 20] {
            let mut grid = grid.clone();
            let gone = span_unseen(&mut grid, &above_it, most);
            assert!(lowest(&grid) > -0.17, "{most}: {}", lowest(&grid));
            assert!((top(&grid) - before).abs() < 0.1 * grid.spacing, "{most}: {before} {}", top(&grid));
            assert!(grid.value(Vec3::new(0.1, -0.06, 0.2)) < 0.0, "{most}: the plate is eaten");
            assert!((0.1..0.7).contains(&gone), "{most}: {gone}");
        }
    }

    /// At the ends of an arc of cameras a mask's outline is seen by no other view.
    #[test]
    fn masks_stay_filled_at_the_ends_of_an_arc() {
        let mut views = silhouettes(0.5, 0.5, ball);
        let hull = visual_hull(&mut views, 40).unwrap();
        let outermost = [&views[0], &views[23]];
        for (most, view) in
            [SPANNED_CELLS, 20].into_iter().flat_map(|most| outermost.map(|view| (most, view)))
        {
            let mut grid = hull.clone();
            assert!(span_unseen(&mut grid, &views, most) > 0.01, "nothing is unseen");
            let inner = (0..96 * 96).filter(|&pixel| view.distance(pixel) < -3.0);
            let is_empty =
                |&pixel: &usize| grid.first_crossing(&view.camera.pixel_ray(pixel as u32), 0.0).is_none();
            assert_eq!(inner.filter(is_empty).count(), 0);
        }
    }

    #[test]
    fn what_is_seen_from_all_sides_keeps_its_bits() {
        let mut all_around = silhouettes(1.0, 1.0, ball);
        all_around.extend(silhouettes(-1.0, 1.0, ball));
        let hull = visual_hull(&mut all_around, 40).unwrap();
        let mut grid = hull.clone();
        assert_eq!(span_unseen(&mut grid, &all_around, SPANNED_CELLS), 0.0);
        assert!(grid == hull);
    }

    #[test]
    fn one_steep_view_sees_and_one_flat_view_does_not() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 0.8, 40, ball);
        let views = silhouettes(0.0, 0.0, ball);
        let near = |direction: Vec3, count: usize| {
            let corners = grid.corners(0.5 * direction);
            let is_seen = seen(&grid, &views[..count]);
            corners.iter().all(|(row, _)| is_seen[*row])
        };
        let flat = Vec3::new(0.46, 0.89, 0.0).normalize();
        assert!(near(Vec3::X, 1), "steep");
        assert!(!near(flat, 1) && near(flat, 2), "flat");
        assert!(!near(-Vec3::X, 24), "behind");
    }

    #[test]
    fn curvature_is_that_of_a_ball() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 32, |p| p.length() - 0.6);
        for row in (0..grid.values.len()).filter(|&row| grid.values[row].abs() < 0.1) {
            let exact = 2.0 / grid.position(grid.vertex(row)).length();
            let found = curvature(&grid, row).unwrap();
            assert!((found - exact).abs() < 0.05 * exact, "{found} {exact}");
        }
    }
}
