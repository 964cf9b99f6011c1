//! Displacements of a field by those of the vertices of its surface.
//!
//! Votes are counted at the vertices of an extracted mesh, but the field moves: a mesh folds and tears where sheets meet, a field
//! does not. A displacement t along the normal is φ − t, with t carried from the vertices to the grid around them.

use crate::math::ray::Ray;
use crate::mesh::bvh::TriangleBvh;
use crate::sdf::SdfGrid;
use crate::shape::stereo::votes::Shell;
use glam::{UVec3, Vec3};
use rayon::prelude::*;
use std::ops::Range;

/// Largest part of the distance to the opposite side, within or across a gap, that a vertex moves in a round.
const ROOM: f32 = 0.15;
/// Height of a ray's start above the surface, in cells.
const LIFT: f32 = 0.06;
/// Cells around a vertex to which its displacement is carried, and the largest displacement, which must stay within.
const CARRIED: i32 = 3;
const MOST: f32 = 2.0;
/// Layers of the grid to which a task carries.
const LAYERS: usize = 8;
/// Standard deviation in cells of the weights with which displacements are carried.
const SPREAD: f32 = 0.7;
/// The same of the difference between a distance and that along the vertex's normal.
const SHEET: f32 = 0.3;

/// Moves the zero level by `along` (one per vertex, along its normal, world units), but by no more than two cells, and leaves room to the
/// opposite side. Redistances the field near the surface.
pub(crate) fn displace(grid: &mut SdfGrid, bvh: &TriangleBvh, shell: &Shell, along: &[f32]) {
    let most = MOST * grid.spacing;
    let along: Vec<f32> = (0..along.len())
        .into_par_iter()
        .map(|i| {
            let along = along[i].clamp(-most, most);
            within_room(bvh, shell.positions[i], shell.normals[i], along, LIFT * grid.spacing)
        })
        .collect();
    let plane = (grid.side * grid.side) as usize;
    let mut sums = vec![[0.0f32; 2]; grid.values.len()];
    // Each task has some layers of the grid, and the vertices in their order.
    sums.par_chunks_mut(LAYERS * plane).enumerate().for_each(|(task, sums)| {
        let layers = (task * LAYERS) as u32..(task * LAYERS + sums.len() / plane) as u32;
        for ((position, normal), along) in shell.positions.iter().zip(&shell.normals).zip(&along) {
            carry(grid, *position, *normal, *along, layers.clone(), sums);
        }
    });
    let moved = grid.values.par_iter_mut().zip(&sums).filter(|(_, sum)| sum[1] > 1e-12);
    moved.for_each(|(value, [sum, weight])| *value -= sum / weight);
    grid.redistance_near();
}

/// Adds a displacement at `position` to the grid's vertices around it that are in `layers`, whose weighted sums, and weights, are `sums`.
fn carry(
    grid: &SdfGrid,
    position: Vec3,
    normal: Vec3,
    along: f32,
    layers: Range<u32>,
    sums: &mut [[f32; 2]],
) {
    let place = (position - grid.origin) / grid.spacing;
    let middle = place.round().as_ivec3();
    let range = |axis: usize| {
        (middle[axis] - CARRIED).max(0) as u32..(middle[axis] + CARRIED + 1).clamp(0, grid.side as i32) as u32
    };
    let first = grid.index(UVec3::new(0, 0, layers.start));
    for z in range(2).start.max(layers.start)..range(2).end.min(layers.end) {
        for y in range(1) {
            for x in range(0) {
                let vertex = UVec3::new(x, y, z);
                let row = grid.index(vertex);
                let offset = vertex.as_vec3() - place;
                // Where the field does not see this vertex, it sees another sheet.
                let other = offset.dot(normal) - grid.values[row] / grid.spacing;
                let weight = (-0.5
                    * (offset.length_squared() / (SPREAD * SPREAD) + other * other / (SHEET * SHEET)))
                    .exp();
                let sum = &mut sums[row - first];
                *sum = [sum[0] + weight * along, sum[1] + weight];
            }
        }
    }
}

/// A displacement of a vertex that leaves room to the opposite side.
pub(crate) fn within_room(bvh: &TriangleBvh, position: Vec3, normal: Vec3, along: f32, lift: f32) -> f32 {
    let room = room(bvh, position, normal * along.signum(), lift);
    along.clamp(-room, room)
}

/// How far a point of the surface may move in a direction (a unit vector): a part of the distance to the opposite side, within or across a gap.
/// The ray that looks for it starts `lift` away. Zero without a direction.
fn room(bvh: &TriangleBvh, position: Vec3, direction: Vec3, lift: f32) -> f32 {
    if direction == Vec3::ZERO {
        return 0.0;
    }
    let ray = Ray { origin: position + direction * lift, direction };
    bvh.nearest(&ray, 0.0).map_or(f32::INFINITY, |hit| ROOM * hit.distance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sdf::extract::extract_mesh;

    fn moved(mut grid: SdfGrid, along: impl Fn(Vec3) -> f32) -> SdfGrid {
        let mesh = extract_mesh(&grid);
        let shell = Shell::new(&mesh);
        let along: Vec<f32> = shell.positions.iter().map(|p| along(*p)).collect();
        displace(&mut grid, &TriangleBvh::new(&mesh), &shell, &along);
        grid
    }

    #[test]
    fn a_sphere_grows_and_shrinks_by_the_displacement() {
        for t in [-0.05, 0.08] {
            let grid = moved(SdfGrid::from_fn(Vec3::ZERO, 1.3, 40, |p| p.length() - 0.9), |_| t);
            let off = extract_mesh(&grid)
                .positions
                .iter()
                .map(|p| (p.length() - 0.9 - t).abs())
                .fold(0.0, f32::max);
            assert!(off < 0.004, "{t} {off}");
        }
    }

    #[test]
    fn a_displacement_is_at_most_two_cells() {
        let grid = moved(SdfGrid::from_fn(Vec3::ZERO, 1.3, 52, |p| p.length() - 0.8), |_| 1.0);
        let far = extract_mesh(&grid).positions.iter().map(|p| p.length()).fold(0.0, f32::max);
        assert!((0.88..0.91).contains(&far), "{far}");
    }

    /// A plate of four cells: its upper side moves, its lower side does not.
    #[test]
    fn one_side_of_a_plate_moves_alone() {
        let plate = |p: Vec3| (p.abs() - Vec3::new(0.7, 0.1, 0.7)).max_element();
        let grid =
            moved(SdfGrid::from_fn(Vec3::ZERO, 1.0, 40, plate), |p| if p.y > 0.05 { 0.04 } else { 0.0 });
        let inner = |p: &&Vec3| p.x.abs() < 0.5 && p.z.abs() < 0.5;
        for p in extract_mesh(&grid).positions.iter().filter(inner) {
            let wanted = if p.y > 0.0 { 0.14 } else { -0.1 };
            assert!((p.y - wanted).abs() < 0.008, "{p}");
        }
    }

    #[test]
    fn a_thin_plate_is_not_pushed_through_itself() {
        let plate = |p: Vec3| (p.abs() - Vec3::new(0.7, 0.06, 0.7)).max_element();
        let grid = moved(SdfGrid::from_fn(Vec3::ZERO, 1.0, 40, plate), |_| -0.1);
        let inner = |p: &&Vec3| p.x.abs() < 0.5 && p.z.abs() < 0.5;
        let mesh = extract_mesh(&grid);
        let thick: Vec<f32> = mesh.positions.iter().filter(inner).map(|p| p.y.abs()).collect();
        assert!(thick.len() > 100 && thick.iter().all(|y| (0.035..0.05).contains(y)), "{:?}", &thick[..9]);
    }
}
