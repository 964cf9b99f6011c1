//! Outlines: moves the surface so that its contours meet the outlines of the masks.
//!
//! A fit of the field determines an object's outline to a fraction of a cell, and smoothness pulls
//! it inward; masks show it to a fraction of a pixel. An edge of the extracted mesh between a
//! triangle that faces the camera and one that does not lies on a contour. Where nothing of the
//! object is seen just beyond it, this contour is the object's outline in that view, and its
//! distance to the mask's is what its vertices are to move along their normals. All views vote; a
//! thin plate carries the votes to the vertices that are contours in no view.
//!
//! The field moves, not the mesh: a mesh folds and tears where sheets meet. A displacement t along
//! the normal is φ − t, with t carried from the vertices to the grid around them.
//!
//! Source: contour generators as constraints on a surface (Cipolla and Giblin, "Visual Motion of
//! Curves and Surfaces", 2000); the plate as in [`stereo`](crate::shape::stereo).

use crate::shape::hull::extract_parts;
use crate::shape::shell::{Plate, Shell, area_vector};
use crate::shape::silhouette::{Sighting, Silhouette};
use glam::{IVec3, UVec3, Vec2, Vec3};
use lobelia_geometry::mesh::triangles::{Side, sorted_sides};
use lobelia_geometry::{error::stop::is_stopping, mesh::bvh::TriangleBvh, parallel, sdf::SdfGrid};
use lobelia_sg::ray::Ray;
use std::sync::Arc;

/// Rounds: a moved surface has other contours.
const ROUNDS: usize = 3;
/// Farthest outline that is taken for that of a contour, in mean edges and in pixels, whichever is
/// more.
const REACH: (f32, f32) = (2.0, 4.0);
/// Distance at which a vote counts a quarter, relative to the mean, and the least in pixels: masks
/// that are wrong lose against those that are not.
const QUARTER_DISTANCE: (f32, f32) = (2.0, 1.0);
/// Pixels beyond a contour at which nothing of the object may be seen. More would count the dents
/// between bumps as outlines.
const BEYOND: f32 = 0.25;
/// Least cosine in the picture between a contour's normal and the direction to the mask's outline.
const LEAST_COSINE: f32 = 0.5;
/// How strongly each vertex is held where it is, in votes.
const HELD: f32 = 0.005;
/// Votes beyond which more do not hold a vertex more strongly.
const MOST_VOTES: f32 = 4.0;
/// Mean distance of the given mesh from the outlines, in pixels, up to which votes have full weight
/// beside the shading of a fit; beyond it the weight falls with its square.
const SHARP: f32 = 0.01;
/// Weight of the squared Laplacian of displacements.
const BENDING: f32 = 10.0;
/// Largest part of the distance to the opposite side, within or across a gap, that a vertex moves
/// in a round.
const ROOM: f32 = 0.15;
/// Height of a ray's start above the surface, in cells.
const LIFT: f32 = 0.06;
/// Cells around a vertex to which its displacement is carried, and the largest displacement, which
/// must stay within.
const CARRIED: i32 = 3;
const MOST: f32 = 2.0;
/// Layers of the grid to which a task carries.
const LAYERS: usize = 8;
/// Standard deviation in cells of the weights with which displacements are carried.
const SPREAD: f32 = 0.7;
/// Standard deviation in cells of the weights by the difference between a distance and that along
/// the vertex's normal.
const SHEET: f32 = 0.3;

/// Result of the motion to outlines.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OutlineReport {
    /// Mean distance between the outlines of surface and masks before, pixels.
    pub before: f32,
    /// Mean distance between the outlines after, pixels.
    pub after: f32,
}

/// Moves the surface of `grid` so that its contours meet the outlines of the masks. A run that is
/// stopping ([`is_stopping`]) moves it no further.
pub(crate) fn fit_outlines(grid: &mut SdfGrid, silhouettes: &[Silhouette]) -> OutlineReport {
    let mut report = OutlineReport::default();
    for round in 0..=ROUNDS {
        let mesh = extract_parts(grid, silhouettes);
        let (bvh, shell) = (TriangleBvh::new(&mesh), Shell::new(&mesh));
        let votes = outline_votes(&shell, &bvh, silhouettes, is_stopping);
        report.after = votes.mean_distance;
        if round == 0 {
            report.before = report.after;
        }
        if round == ROUNDS || votes.none || is_stopping() {
            break;
        }
        displace(grid, &bvh, &shell, &votes.displacements(&shell, 1.0));
    }
    report
}

/// The outlines of masks beside other evidence, such as the shading, by which a mesh moves. A look
/// at them is short and does not stop with a run.
pub(crate) struct OutlineGuide {
    silhouettes: Arc<[Silhouette]>,
    /// Displacements by which the votes would move the given mesh, whose outlines count as right,
    /// world units.
    given: Vec<f32>,
    /// Weight of the votes, at most 1: with the inverse square of the given mesh's mean distance,
    /// for that tells how sharp the masks are.
    weight: f32,
}

impl OutlineGuide {
    pub(crate) fn new(shell: &Shell, bvh: &TriangleBvh, silhouettes: Arc<[Silhouette]>) -> Self {
        let votes = outline_votes(shell, bvh, &silhouettes, || false);
        let weight = (SHARP / votes.mean_distance.max(SHARP)).powi(2);
        Self { given: votes.displacements(shell, weight), silhouettes, weight }
    }

    /// How far the vertices of the mesh, which has moved, are to move along their normals for its
    /// outlines to be what they were, world units.
    pub(crate) fn displacements(&self, shell: &Shell, bvh: &TriangleBvh) -> Vec<f32> {
        let votes = outline_votes(shell, bvh, &self.silhouettes, || false);
        let now = votes.displacements(shell, self.weight);
        now.iter().zip(&self.given).map(|(now, given)| now - given).collect()
    }
}

pub(crate) struct OutlineVotes {
    /// The spring that pulls each vertex of the shell to the outlines.
    pub(crate) plates: Vec<Plate>,
    /// Mean distance of outlines in pixels.
    mean_distance: f32,
    /// Whether no view has an outline.
    none: bool,
}

impl OutlineVotes {
    /// The displacements along the normals that the votes, times `weight`, ask for, carried by a
    /// thin plate to all vertices, world units.
    fn displacements(&self, shell: &Shell, weight: f32) -> Vec<f32> {
        let held = |plate: &Plate| Plate { hold: HELD + weight * plate.hold, pull: weight * plate.pull };
        shell.graph.bent(&self.plates.iter().map(held).collect::<Vec<Plate>>(), BENDING)
    }
}

/// An edge, with what decides whether it lies on a contour: a view looks at all of them, one after
/// the other.
struct Edge {
    ends: [u32; 2],
    at: Vec3,
    /// Normals of the two triangles that share it, twice their area long.
    normals: [Vec3; 2],
}

fn edges(shell: &Shell) -> Vec<Edge> {
    let Shell { graph, positions, .. } = shell;
    let normals: Vec<Vec3> = graph.triangles.iter().map(|corners| area_vector(positions, corners)).collect();
    let edge = |same: &[Side]| {
        let [one, other] = same else { return None };
        let [a, b] = one.ends.map(|v| positions[v as usize]);
        let normals = [one, other].map(|side| normals[side.triangle as usize]);
        Some(Edge { ends: one.ends, at: 0.5 * (a + b), normals })
    };
    sorted_sides(&graph.triangles).chunk_by(|a, b| a.ends == b.ends).filter_map(edge).collect()
}

/// A vertex of a contour beside a mask's outline.
struct Seen {
    vertex: u32,
    /// Cosine c between the vertex's normal and the contour's.
    cosine: f32,
    /// How far the mask's outline lies beyond, pixels.
    distance: f32,
    /// World size of a pixel there.
    pixel_size: f32,
}

/// The votes of all views, added in their order; views are left out once `stop` says so.
pub(crate) fn outline_votes(
    shell: &Shell,
    bvh: &TriangleBvh,
    silhouettes: &[Silhouette],
    stop: fn() -> bool,
) -> OutlineVotes {
    let Shell { graph, positions, normals } = shell;
    let (edges, mean_edge) = (edges(shell), graph.mean_edge(positions));
    let seen_by = |view: &Silhouette| {
        let eye = view.camera.position();
        let mut seen = Vec::new();
        for Edge { ends, at, normals: beside } in edges.iter().filter(|_| !stop()) {
            let [first, second] = beside.map(|normal| normal.dot(at - eye));
            if first * second > 0.0 {
                continue;
            }
            let normal = normals[ends[0] as usize] + normals[ends[1] as usize];
            let Some((distance, pixel_size, outward)) = outline(bvh, view, *at, normal, mean_edge) else {
                continue;
            };
            seen.extend(ends.map(|vertex| {
                let cosine = normals[vertex as usize].dot(outward).max(0.0);
                Seen { vertex, cosine, distance, pixel_size }
            }));
        }
        seen
    };
    let seen: Vec<Vec<Seen>> = parallel::map_slice(silhouettes, 1, seen_by);
    let all = || seen.iter().flatten();
    let (count, sum) = all().fold((0, 0.0), |(n, sum), s| (n + 1, sum + f64::from(s.distance.abs())));
    let mean_distance = (sum / f64::from(count.max(1))) as f32;
    let scale = (QUARTER_DISTANCE.0 * mean_distance).max(QUARTER_DISTANCE.1);
    // Σ w c², and Σ w c δ with δ the displacement that the contour needs.
    let mut plates = vec![Plate::default(); positions.len()];
    for seen in all() {
        let weight = 0.5 / (1.0 + (seen.distance / scale).powi(2)).powi(2);
        let plate = &mut plates[seen.vertex as usize];
        plate.hold += weight * seen.cosine * seen.cosine;
        plate.pull += weight * seen.cosine * seen.distance * seen.pixel_size;
    }
    for plate in &mut plates {
        let share = MOST_VOTES / plate.hold.max(MOST_VOTES);
        *plate = Plate { hold: share * plate.hold, pull: share * plate.pull };
    }
    OutlineVotes { plates, mean_distance, none: count == 0 }
}

/// How far beyond a contour at `at` the mask's outline lies, in pixels, the world size of a pixel
/// there, and the unit vector outward, across the ray; `None` if the contour is not the object's
/// outline, or the mask has none nearby.
fn outline(
    bvh: &TriangleBvh,
    view: &Silhouette,
    at: Vec3,
    normal: Vec3,
    mean_edge: f32,
) -> Option<(f32, f32, Vec3)> {
    let (camera, eye) = (&view.camera, view.camera.position());
    let Sighting { x, y, pixels: distance, pixel_size } = view.look(at)?;
    if distance.abs() > REACH.1.max(REACH.0 * mean_edge / pixel_size) {
        return None;
    }
    let along = (at - eye).normalize();
    let outward = (normal - along * normal.dot(along)).try_normalize()?;
    let (beyond_x, beyond_y, _) = camera.project(at + outward * pixel_size)?;
    let direction = Vec2::new(beyond_x - x, beyond_y - y).try_normalize()?;
    let slope = view.slope_at(x, y).dot(direction);
    if slope < LEAST_COSINE {
        return None;
    }
    let beyond = at + outward * (BEYOND * pixel_size);
    let ray = Ray { origin: eye, direction: (beyond - eye).normalize() };
    let is_outline = bvh.nearest(&ray, 0.0).is_none();
    is_outline.then_some((-distance / slope, pixel_size, outward))
}

/// Moves the zero level by `along` (one per vertex, along its normal, world units), but by no more
/// than two cells, and leaves room to the opposite side. Redistances the field near the surface.
fn displace(grid: &mut SdfGrid, bvh: &TriangleBvh, shell: &Shell, along: &[f32]) {
    let most = MOST * grid.spacing;
    let room = |i: usize| {
        let along = along[i].clamp(-most, most);
        within_room(bvh, shell.positions[i], shell.normals[i], along, LIFT * grid.spacing)
    };
    let along: Vec<f32> = parallel::map(along.len(), 64, room);
    let plane = (grid.side * grid.side) as usize;
    let mut sums = vec![[0.0f32; 2]; grid.values.len()];
    // Each task has some layers of the grid, and the vertices in their order: their displacements
    // are carried to the grid around them.
    parallel::for_each(sums.chunks_mut(LAYERS * plane).enumerate(), |(task, sums)| {
        let layers = (task * LAYERS) as u32..(task * LAYERS + sums.len() / plane) as u32;
        let first = grid.index(UVec3::new(0, 0, layers.start));
        for ((position, normal), along) in shell.positions.iter().zip(&shell.normals).zip(&along) {
            let place = (*position - grid.origin) / grid.spacing;
            let middle = place.round().as_ivec3();
            let low = (middle - CARRIED).max(IVec3::ZERO).as_uvec3();
            let high = (middle + CARRIED + 1).clamp(IVec3::ZERO, IVec3::splat(grid.side as i32)).as_uvec3();
            let rows = (low.z.max(layers.start)..high.z.min(layers.end))
                .flat_map(|z| (low.y..high.y).map(move |y| (y, z)));
            for vertex in rows.flat_map(|(y, z)| (low.x..high.x).map(move |x| UVec3::new(x, y, z))) {
                let row = grid.index(vertex);
                let offset = vertex.as_vec3() - place;
                // Where the field does not see this vertex, it sees another sheet.
                let other = offset.dot(*normal) - grid.values[row] / grid.spacing;
                let apart = offset.length_squared() / (SPREAD * SPREAD) + other * other / (SHEET * SHEET);
                let weight = (-0.5 * apart).exp();
                let sum = &mut sums[row - first];
                *sum = [sum[0] + weight * along, sum[1] + weight];
            }
        }
    });
    parallel::for_each_row((&mut *grid.values, &*sums), 1024, |(value, [sum, weight])| {
        if *weight > 1e-12 {
            *value -= sum / weight;
        }
    });
    grid.redistance_near();
}

/// A displacement along the normal, of which no more is left than a part of the distance to the
/// opposite side, within or across a gap; the ray that looks for that starts `lift` away. Zero
/// without a normal.
pub(crate) fn within_room(bvh: &TriangleBvh, position: Vec3, normal: Vec3, along: f32, lift: f32) -> f32 {
    let direction = normal * along.signum();
    if direction == Vec3::ZERO {
        return 0.0_f32.copysign(along);
    }
    let ray = Ray { origin: position + direction * lift, direction };
    let room = bvh.nearest(&ray, 0.0).map_or(f32::INFINITY, |hit| ROOM * hit.distance);
    along.clamp(-room, room)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::silhouette::pixel_size;
    use crate::shape::test_support::{around, mask};
    use lobelia_geometry::{mesh::primitive::sphere_mesh, sdf::extract::extract_mesh, view::Camera};

    /// Masks of a ball around the origin, seen from all around, with anti-aliased outlines.
    fn ball(radius: f32) -> Vec<Silhouette> {
        around(40, 3.5, 128).iter().map(|camera| silhouette(camera, Vec3::ZERO, radius)).collect()
    }

    fn silhouette(camera: &Camera, center: Vec3, radius: f32) -> Silhouette {
        let covered = |ray: &Ray| {
            let offset = center - ray.origin;
            let miss = ray.direction.cross(offset).length() - radius;
            (0.5 - miss / (pixel_size(camera) * offset.dot(ray.direction))).clamp(0.0, 1.0)
        };
        Silhouette::new("ball", camera, &mask(camera, covered)).unwrap()
    }

    fn sphere(radius: f32) -> SdfGrid {
        SdfGrid::from_fn(Vec3::ZERO, 1.3, 40, |p| p.length() - radius)
    }

    /// Largest difference of the vertices' distance from the origin to `radius`.
    fn off(grid: &SdfGrid, radius: f32) -> f32 {
        extract_mesh(grid).positions.iter().map(|p| (p.length() - radius).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn a_surface_moves_to_the_outlines_from_inside_and_from_outside() {
        for start in [0.95, 1.04] {
            let mut grid = sphere(start);
            let report = fit_outlines(&mut grid, &ball(1.0));
            assert!(off(&grid, 1.0) < 0.006, "{start}: {} {report:?}", off(&grid, 1.0));
            assert!(report.before > 1.0 && report.after < 0.15, "{report:?}");
        }
    }

    #[test]
    fn a_mesh_that_bulges_is_brought_back_to_its_outlines() {
        let (mut mesh, masks) = (sphere_mesh(Vec3::ZERO, 1.0).unwrap(), ball(1.0));
        mesh.uvs = None;
        let mut shell = Shell::new(&mesh);
        let bvh = TriangleBvh::new(&mesh);
        let guide = OutlineGuide::new(&shell, &bvh, masks.into());
        assert!(guide.displacements(&shell, &bvh).iter().all(|along| *along == 0.0));
        let bulge = |p: &Vec3| 0.01 * (5.0 * p.x).sin() * (4.0 * p.y).cos();
        let wrong: Vec<f32> = shell.positions.iter().map(bulge).collect();
        mesh.positions.iter_mut().for_each(|p| *p *= 1.0 + bulge(p));
        shell.move_to(shell.positions.iter().zip(&wrong).map(|(p, by)| p * (1.0 + by)).collect());
        let along = guide.displacements(&shell, &TriangleBvh::new(&mesh));
        let size = |of: &mut dyn Iterator<Item = f32>| of.map(|x| x * x).sum::<f32>();
        let left = size(&mut wrong.iter().zip(&along).map(|(wrong, along)| wrong + along));
        let before = size(&mut wrong.iter().copied());
        assert!(left < 0.3 * before, "{left} {before}");
    }

    #[test]
    fn one_wrong_mask_of_many_does_not_bend_the_outline() {
        let (mut grid, mut masks) = (sphere(0.97), ball(1.0));
        let camera = masks[7].camera;
        masks[7] = silhouette(&camera, Vec3::ZERO, 0.9);
        fit_outlines(&mut grid, &masks);
        assert!(off(&grid, 1.0) < 0.015, "{}", off(&grid, 1.0));
    }

    #[test]
    fn masks_that_show_something_else_move_nothing() {
        let mut grid = sphere(0.6);
        let before = off(&grid, 0.6);
        fit_outlines(&mut grid, &ball(1.0));
        assert_eq!(off(&grid, 0.6), before, "an outline that far away is not that of the contour");
    }

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        let masks = ball(1.0);
        let moved = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut grid = sphere(0.96);
            pool.install(|| fit_outlines(&mut grid, &masks));
            grid
        };
        assert_eq!(moved(1), moved(3));
    }

    fn moved(mut grid: SdfGrid, along: impl Fn(Vec3) -> f32) -> SdfGrid {
        let mesh = extract_mesh(&grid);
        let shell = Shell::new(&mesh);
        let along: Vec<f32> = shell.positions.iter().map(|p| along(*p)).collect();
        displace(&mut grid, &TriangleBvh::new(&mesh), &shell, &along);
        grid
    }

    #[test]
    fn a_sphere_grows_and_shrinks_by_the_displacement() {
        for (t, found) in [(-0.05, 0.85), (0.08, 0.98)] {
            let grid = moved(SdfGrid::from_fn(Vec3::ZERO, 1.3, 40, |p| p.length() - 0.9), |_| t);
            assert!(off(&grid, found) < 0.004, "{t} {}", off(&grid, found));
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
