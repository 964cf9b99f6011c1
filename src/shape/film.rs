//! What no photograph sees: spanned like a film of soap.
//!
//! Photographs from above leave a cone below the object, those from the front a wedge behind it: the hull is as large as the masks allow.
//! Nothing in the photographs holds this surface. It moves by its mean curvature, only into the hull, while what is seen stays,
//! until it spans its rim with the least area: a seat gets a flat bottom. The masks stay filled, since what they see stays.
//!
//! Source: motion of level sets by mean curvature (Osher and Sethian, "Fronts Propagating with Curvature-Dependent Speed", 1988,
//! ∂φ/∂t = κ |∇φ|).

use crate::error::stop::is_stopping;
use crate::mesh::bvh::TriangleBvh;
use crate::sdf::SdfGrid;
use crate::shape::parts::extract_parts;
use crate::shape::silhouette::{Silhouette, pixel_size};
use glam::{IVec3, Vec3};
use rayon::prelude::*;

/// Cosine of the angle between ray and normal from which one view, and from which each of two, sees a surface: flatter rays only touch the
/// cone that the masks leave.
const ONE_VIEW: f32 = 0.5;
const TWO_VIEWS: f32 = 0.2;
/// Rays of a view per cell, along each axis.
const RAYS_PER_CELL: f32 = 2.0;
/// Cells around the zero level that move.
const BAND: f32 = 2.5;
/// Most steps; steps from one redistancing to the next; steps before the volume may end the motion.
const MOST_STEPS: usize = 1000;
const REDISTANCE: usize = 20;
const LEAST_STEPS: usize = 200;
/// Step of time in squares of a cell; more than ¼ is unstable.
const TIME_STEP: f32 = 1.0 / 6.0;
/// Largest curvature that counts, per cell.
const MOST_CURVATURE: f32 = 2.0;

/// Spans what no silhouette's camera sees; returns the share of the object's volume that goes. A run that is stopping ([`is_stopping`])
/// leaves the field as it was at the last redistancing.
pub fn span_unseen(grid: &mut SdfGrid, silhouettes: &[Silhouette]) -> f32 {
    let is_seen = seen(grid, silhouettes);
    let reach = BAND * grid.spacing;
    let hull = grid.values.clone();
    let held: Vec<usize> = (0..hull.len()).filter(|&row| is_seen[row] && hull[row].abs() < reach).collect();
    let inside = |grid: &SdfGrid| grid.values.iter().filter(|value| **value < 0.0).count();
    let whole = inside(grid);
    if hull.iter().zip(&is_seen).all(|(value, is_seen)| *is_seen || value.abs() >= grid.spacing) {
        return 0.0;
    }
    let mut last = whole;
    for step in (REDISTANCE..=MOST_STEPS).step_by(REDISTANCE) {
        if is_stopping() {
            break;
        }
        (0..REDISTANCE).for_each(|_| contract(grid, &hull, &is_seen));
        grid.redistance();
        held.iter().for_each(|&row| grid.values[row] = hull[row]);
        let now = inside(grid);
        if step > LEAST_STEPS && now == last {
            break;
        }
        last = now;
    }
    1.0 - last as f32 / whole.max(1) as f32
}

/// One step of motion by mean curvature, not outward, of what is not seen.
fn contract(grid: &mut SdfGrid, hull: &[f32], is_seen: &[bool]) {
    let time = TIME_STEP * grid.spacing * grid.spacing;
    let moved = |row: usize| {
        let value = grid.values[row];
        if is_seen[row] || value.abs() >= BAND * grid.spacing {
            return None;
        }
        Some((row, (value + time * curvature(grid, row)?).max(hull[row])))
    };
    let band: Vec<(usize, f32)> = (0..hull.len()).into_par_iter().filter_map(moved).collect();
    band.into_iter().for_each(|(row, value)| grid.values[row] = value);
}

/// κ |∇φ| = Δφ − ∇φᵀ H ∇φ / |∇φ|² by central differences; `None` on the border of the grid.
fn curvature(grid: &SdfGrid, row: usize) -> Option<f32> {
    let vertex = grid.vertex(row);
    if vertex.min_element() == 0 || vertex.max_element() + 1 == grid.side {
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

/// The vertices within a cell of those around surface that enough views see.
fn seen(grid: &SdfGrid, silhouettes: &[Silhouette]) -> Vec<bool> {
    let bvh = TriangleBvh::new(&extract_parts(grid, silhouettes));
    let of_views: Vec<_> = silhouettes.par_iter().map(|view| seen_by(grid, &bvh, view)).collect();
    // Two halves are enough.
    let mut halves = vec![0u8; grid.values.len()];
    for (row, is_steep) in of_views.into_iter().flatten() {
        halves[row] = halves[row].saturating_add(1 + u8::from(is_steep));
    }
    let is_seen = |vertex: IVec3| halves[grid.index(vertex.as_uvec3())] >= 2;
    let last = IVec3::splat(grid.side as i32 - 1);
    let is_near = |row: usize| {
        let vertex = grid.vertex(row).as_ivec3();
        let (low, high) = ((vertex - 1).max(IVec3::ZERO), (vertex + 1).min(last));
        (low.z..=high.z)
            .any(|z| (low.y..=high.y).any(|y| (low.x..=high.x).any(|x| is_seen(IVec3::new(x, y, z)))))
    };
    (0..grid.values.len()).into_par_iter().map(is_near).collect()
}

/// The vertices around the surface that one view sees, each once, and whether it sees them steeply enough to count alone.
fn seen_by(grid: &SdfGrid, bvh: &TriangleBvh, view: &Silhouette) -> Vec<(usize, bool)> {
    let camera = &view.camera;
    let (center, _) = bvh.bounding_sphere();
    let footprint = pixel_size(camera) * camera.position().distance(center);
    let stride = ((grid.spacing / (RAYS_PER_CELL * footprint)) as usize).max(1);
    let (width, height) = (camera.width as usize, camera.height as usize);
    let rows = (stride / 2..height).step_by(stride);
    let pixels = rows.flat_map(|y| (stride / 2..width).step_by(stride).map(move |x| y * width + x));
    let mut vertices = Vec::new();
    for pixel in pixels.filter(|&pixel| view.mask.coverage(pixel) > 0.0).take_while(|_| !is_stopping()) {
        let ray = camera.pixel_ray(pixel as u32);
        let Some(hit) = bvh.nearest(&ray, 0.0) else { continue };
        let point = ray.origin + ray.direction * hit.distance;
        let cosine = -grid.gradient(point).normalize_or_zero().dot(ray.direction);
        if cosine > TWO_VIEWS {
            vertices.extend(grid.corners(point).map(|(row, _)| (row, cosine > ONE_VIEW)));
        }
    }
    // Of several rays, the steepest counts.
    vertices.sort_unstable_by_key(|&(row, is_steep)| (row, !is_steep));
    vertices.dedup_by_key(|(row, _)| *row);
    vertices
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::hull::visual_hull;
    use crate::view::{Camera, Mask, StoredMask};

    /// The masks of a ball, by cameras on a circle at a height.
    fn silhouettes(height: f32, of: impl Fn(Vec3) -> f32 + Sync) -> Vec<Silhouette> {
        let field = SdfGrid::from_fn(Vec3::ZERO, 0.8, 48, of);
        let cameras = (0..24).map(|k| {
            let angle = k as f32 * std::f32::consts::TAU / 24.0;
            let eye = Vec3::new(3.0 * angle.cos(), height, 3.0 * angle.sin());
            Camera::look_at(eye, Vec3::ZERO, Vec3::Y, 36.0, 96, 96).unwrap()
        });
        let silhouette = |camera: Camera| {
            let covered = |pixel| field.first_crossing(&camera.pixel_ray(pixel), 0.0).is_some();
            let coverage = (0..96 * 96).map(|pixel| f32::from(u8::from(covered(pixel)))).collect();
            let mask = StoredMask::new(&Mask { width: 96, height: 96, coverage });
            Silhouette::new("view", &camera, &mask).unwrap()
        };
        cameras.map(silhouette).collect()
    }

    fn lowest(grid: &SdfGrid) -> f32 {
        let inside = (0..grid.values.len()).filter(|&row| grid.values[row] < 0.0);
        inside.map(|row| grid.position(grid.vertex(row)).y).fold(f32::INFINITY, f32::min)
    }

    #[test]
    fn a_table_seen_from_above_loses_the_cone_below_it() {
        let plate = |p: Vec3| (p.with_y(0.0).length() - 0.5).max(p.y.abs() - 0.1);
        let mut above_it = silhouettes(1.5, plate);
        let mut grid = visual_hull(&mut above_it, 40).unwrap();
        assert!(lowest(&grid) < -0.25, "no cone: {}", lowest(&grid));
        let top = |grid: &SdfGrid| grid.value(Vec3::new(0.1, 0.1, 0.2));
        let before = top(&grid);
        let gone = span_unseen(&mut grid, &above_it);
        assert!(lowest(&grid) > -0.17, "{}", lowest(&grid));
        assert!((top(&grid) - before).abs() < 0.1 * grid.spacing, "{before} {}", top(&grid));
        assert!(gone > 0.1, "{gone}");
    }

    #[test]
    fn what_is_seen_stays() {
        let ball = |p: Vec3| p.length() - 0.5;
        let mut all_around = silhouettes(1.0, ball);
        all_around.extend(silhouettes(-1.0, ball));
        let mut grid = visual_hull(&mut all_around, 40).unwrap();
        assert!(span_unseen(&mut grid, &all_around) < 1e-3);
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
