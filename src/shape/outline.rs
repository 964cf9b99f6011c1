//! Outlines: moves the surface so that its contours meet the outlines of the masks.
//!
//! A fit of the field determines an object's outline to a fraction of a cell, and smoothness pulls it inward; masks show it to a
//! fraction of a pixel. An edge of the extracted mesh between a triangle that faces the camera and one that does not lies on a contour. Where
//! nothing of the object is seen just beyond it, this contour is the object's outline in that view, and its distance to the mask's is what
//! its vertices are to move along their normals. All views vote; a thin plate carries the votes to the vertices that are contours in no view.
//!
//! Source: contour generators as constraints on a surface (Cipolla and Giblin, "Visual Motion of Curves and Surfaces", 2000);
//! the plate as in [`stereo`](crate::shape::stereo).

use crate::error::Result;
use crate::error::stop::is_stopping;
use crate::math::ray::Ray;
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::triangles::{Side, sorted_sides};
use crate::ranks::Ranks;
use crate::ranks::packed::{PackedFloats, divided};
use crate::sdf::SdfGrid;
use crate::shape::displace::displace;
use crate::shape::parts::extract_parts;
use crate::shape::silhouette::{Silhouette, is_inner, pixel_size};
use crate::shape::stereo::plate::{Plate, bent};
use crate::shape::stereo::votes::Shell;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Rounds: a moved surface has other contours.
const ROUNDS: usize = 3;
/// Farthest outline that is taken for that of a contour, in mean edges and in pixels, whichever is more.
const REACH: (f32, f32) = (2.0, 4.0);
/// Distance at which a vote counts a quarter, relative to the mean, and the least in pixels: masks that are wrong lose against those that
/// are not.
const QUARTER_DISTANCE: (f32, f32) = (2.0, 1.0);
/// Pixels beyond a contour at which nothing of the object may be seen. More would count the dents between bumps as outlines.
const BEYOND: f32 = 0.25;
/// Least cosine in the picture between a contour's normal and the direction to the mask's outline.
const LEAST_COSINE: f32 = 0.5;
/// How strongly each vertex is held where it is, in votes.
const HELD: f32 = 0.005;
/// Votes beyond which more do not hold a vertex more strongly.
const MOST_VOTES: f32 = 4.0;
/// Mean distance of the given mesh from the outlines, in pixels, up to which votes have full weight beside the shading of a fit; beyond it
/// the weight falls with its square.
const SHARP: f32 = 0.01;
/// Weight of the squared Laplacian of displacements.
const BENDING: f32 = 10.0;

/// What [`fit_outlines`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OutlineReport {
    /// Mean distance between the outlines of surface and masks before, pixels.
    pub before: f32,
    /// The same after it.
    pub after: f32,
}

/// Moves the surface of `grid` so that its contours meet the outlines of the masks. A run that is stopping
/// ([`is_stopping`]) moves it no further. `ranks` divide the masks.
///
/// # Errors
/// If another process is gone.
pub fn fit_outlines(
    grid: &mut SdfGrid,
    silhouettes: &[Silhouette],
    ranks: Option<&Ranks>,
) -> Result<OutlineReport> {
    let mut report = OutlineReport::default();
    for round in 0..=ROUNDS {
        let mesh = extract_parts(grid, silhouettes);
        let (bvh, shell) = (TriangleBvh::new(&mesh), Shell::new(&mesh));
        let votes = Contours::new(&shell, &bvh).votes(silhouettes, ranks)?;
        report.after = votes.mean_distance;
        if round == 0 {
            report.before = report.after;
        }
        if round == ROUNDS || votes.none || is_stopping() {
            break;
        }
        displace(grid, &bvh, &shell, &votes.displacements(&shell, 1.0));
    }
    Ok(report)
}

/// The outlines of masks beside other evidence, such as the shading, by which a mesh moves. A look at them is short and does not stop with
/// a run, for the step that it belongs to may be kept in a checkpoint.
pub(crate) struct OutlineGuide {
    silhouettes: Arc<[Silhouette]>,
    /// What the votes ask of the given mesh: as far as that is known, its outlines are right.
    given: Vec<f32>,
    /// Weight of the votes, at most 1: with the inverse square of the given mesh's mean distance, for that tells how sharp the masks are.
    weight: f32,
}

impl OutlineGuide {
    /// For a given mesh.
    pub(crate) fn new(shell: &Shell, bvh: &TriangleBvh, silhouettes: Arc<[Silhouette]>) -> Self {
        let votes = Contours::new(shell, bvh).all_votes(&silhouettes);
        let weight = (SHARP / votes.mean_distance.max(SHARP)).powi(2);
        Self { given: votes.displacements(shell, weight), silhouettes, weight }
    }

    /// How far the vertices of the mesh, which has moved, are to move along their normals for its outlines to be what they were, world units.
    pub(crate) fn displacements(&self, shell: &Shell, bvh: &TriangleBvh) -> Vec<f32> {
        let votes = Contours::new(shell, bvh).all_votes(&self.silhouettes);
        let now = votes.displacements(shell, self.weight);
        now.iter().zip(&self.given).map(|(now, given)| now - given).collect()
    }
}

/// What contours say of a vertex.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Vote {
    /// Σ w c², c the cosine between the vertex's normal and the contour's.
    hold: f32,
    /// Σ w c δ, δ the displacement that the contour needs, world units.
    pull: f32,
}

impl Vote {
    /// The spring that pulls the vertex to the outlines.
    pub(crate) fn plate(&self) -> Plate {
        let share = MOST_VOTES / self.hold.max(MOST_VOTES);
        Plate { hold: share * self.hold, pull: share * self.pull }
    }
}

/// A vertex of a contour beside a mask's outline.
#[derive(Clone, Copy)]
struct Seen {
    vertex: u32,
    /// Cosine between the vertex's normal and the contour's.
    cosine: f32,
    /// How far the mask's outline lies beyond, pixels.
    distance: f32,
    /// World size of a pixel there.
    pixel_size: f32,
}

impl PackedFloats<4> for Seen {
    fn to_floats(self) -> [f32; 4] {
        [f32::from_bits(self.vertex), self.cosine, self.distance, self.pixel_size]
    }

    fn of_floats([vertex, cosine, distance, pixel_size]: [f32; 4]) -> Self {
        Self { vertex: vertex.to_bits(), cosine, distance, pixel_size }
    }
}

/// The votes of all views.
pub(crate) struct OutlineVotes {
    /// One for each vertex of the shell.
    pub(crate) of_vertices: Vec<Vote>,
    /// Mean distance of outlines in pixels.
    mean_distance: f32,
    /// Whether no view has an outline.
    none: bool,
}

impl OutlineVotes {
    fn new(seen: &[Vec<Seen>], vertices: usize) -> Self {
        let all = || seen.iter().flatten();
        let (count, sum) = all().fold((0, 0.0), |(n, sum), s| (n + 1, sum + f64::from(s.distance.abs())));
        let mean_distance = (sum / f64::from(count.max(1))) as f32;
        let scale = (QUARTER_DISTANCE.0 * mean_distance).max(QUARTER_DISTANCE.1);
        let mut of_vertices = vec![Vote::default(); vertices];
        for seen in all() {
            let weight = 0.5 / (1.0 + (seen.distance / scale).powi(2)).powi(2);
            let vote = &mut of_vertices[seen.vertex as usize];
            vote.hold += weight * seen.cosine * seen.cosine;
            vote.pull += weight * seen.cosine * seen.distance * seen.pixel_size;
        }
        Self { of_vertices, mean_distance, none: count == 0 }
    }

    /// The displacements along the normals that the votes, times `weight`, ask for, carried by a thin plate to all vertices, world units.
    fn displacements(&self, shell: &Shell, weight: f32) -> Vec<f32> {
        let held = |vote: &Vote| {
            let plate = vote.plate();
            Plate { hold: HELD + weight * plate.hold, pull: weight * plate.pull }
        };
        let plates: Vec<Plate> = self.of_vertices.iter().map(held).collect();
        bent(&shell.graph, &plates, BENDING)
    }
}

/// An edge, with what decides whether it lies on a contour: a view looks at all of them, one after the other.
struct Edge {
    ends: [u32; 2],
    /// Its middle.
    at: Vec3,
    /// Normals of the two triangles that share it, twice their area long.
    normals: [Vec3; 2],
}

/// Where the mask's outline is, as seen from a contour.
struct Outline {
    /// How far it lies beyond the contour, pixels.
    distance: f32,
    /// World size of a pixel at the contour.
    pixel_size: f32,
    /// Unit vector outward, across the ray.
    outward: Vec3,
}

/// A surface whose contours are compared with masks.
pub(crate) struct Contours<'a> {
    shell: &'a Shell,
    bvh: &'a TriangleBvh,
    edges: Vec<Edge>,
    mean_edge: f32,
}

impl<'a> Contours<'a> {
    /// Of a mesh.
    pub(crate) fn new(shell: &'a Shell, bvh: &'a TriangleBvh) -> Self {
        let normal = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|v| shell.positions[v as usize]);
            (b - a).cross(c - a)
        };
        let normals: Vec<Vec3> = shell.graph.triangles.iter().map(normal).collect();
        let edge = |same: &[Side]| {
            let [one, other] = same else { return None };
            let [a, b] = one.ends.map(|v| shell.positions[v as usize]);
            let normals = [one, other].map(|side| normals[side.triangle as usize]);
            Some(Edge { ends: one.ends, at: 0.5 * (a + b), normals })
        };
        let sides = sorted_sides(&shell.graph.triangles);
        Self {
            bvh,
            edges: sides.chunk_by(|a, b| a.ends == b.ends).filter_map(edge).collect(),
            mean_edge: shell.graph.mean_edge(&shell.positions),
            shell,
        }
    }

    /// The votes of all views, which `ranks` divide, added in their order; none once a run is stopping.
    ///
    /// # Errors
    /// If another process is gone.
    pub(crate) fn votes(&self, silhouettes: &[Silhouette], ranks: Option<&Ranks>) -> Result<OutlineVotes> {
        let seen = divided(ranks, silhouettes.len(), |view| self.seen(&silhouettes[view], is_stopping))?;
        Ok(OutlineVotes::new(&seen, self.shell.positions.len()))
    }

    /// The same in this process alone, also while a run is stopping.
    fn all_votes(&self, silhouettes: &[Silhouette]) -> OutlineVotes {
        let seen: Vec<Vec<Seen>> = silhouettes.par_iter().map(|view| self.seen(view, || false)).collect();
        OutlineVotes::new(&seen, self.shell.positions.len())
    }

    /// The vertices of a view's outline.
    fn seen(&self, view: &Silhouette, stop: fn() -> bool) -> Vec<Seen> {
        let eye = view.camera.position();
        let mut seen = Vec::new();
        for edge in self.edges.iter().filter(|_| !stop()) {
            let at = edge.at;
            let [first, second] = edge.normals.map(|normal| normal.dot(at - eye));
            if first * second > 0.0 {
                continue;
            }
            let [a, b] = edge.ends.map(|v| v as usize);
            let normal = self.shell.normals[a] + self.shell.normals[b];
            let Some(Outline { distance, pixel_size, outward }) = self.outline(view, at, normal) else {
                continue;
            };
            seen.extend(edge.ends.map(|vertex| {
                let cosine = self.shell.normals[vertex as usize].dot(outward).max(0.0);
                Seen { vertex, cosine, distance, pixel_size }
            }));
        }
        seen
    }

    /// The mask's outline beside a contour at `at`; `None` if the contour is not the object's outline, or the mask has none nearby.
    fn outline(&self, view: &Silhouette, at: Vec3, normal: Vec3) -> Option<Outline> {
        let (camera, eye) = (&view.camera, view.camera.position());
        let (x, y, depth) = camera.project(at)?;
        if !is_inner(camera, x, y) {
            return None;
        }
        let pixel_size = depth * pixel_size(camera);
        let distance = view.pixels(x, y);
        if distance.abs() > REACH.1.max(REACH.0 * self.mean_edge / pixel_size) {
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
        let is_outline = self.bvh.nearest(&ray, 0.0).is_none();
        is_outline.then_some(Outline { distance: -distance / slope, pixel_size, outward })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::sphere_mesh;
    use crate::sdf::extract::extract_mesh;
    use crate::view::{Camera, Mask, StoredMask};

    const SIZE: u32 = 128;

    /// Masks of a ball around the origin, seen from all around, with anti-aliased outlines.
    fn ball(radius: f32) -> Vec<Silhouette> {
        let cameras = Camera::around(40, 3.5, 40.0, SIZE).unwrap();
        cameras.iter().map(|camera| silhouette(camera, Vec3::ZERO, radius)).collect()
    }

    fn silhouette(camera: &Camera, center: Vec3, radius: f32) -> Silhouette {
        let covered = |pixel: u32| {
            let ray = camera.pixel_ray(pixel);
            let offset = center - ray.origin;
            let miss = ray.direction.cross(offset).length() - radius;
            (0.5 - miss / (pixel_size(camera) * offset.dot(ray.direction))).clamp(0.0, 1.0)
        };
        let coverage = (0..SIZE * SIZE).map(covered).collect();
        let mask = StoredMask::new(&Mask { width: SIZE, height: SIZE, coverage });
        Silhouette::new("ball", camera, &mask).unwrap()
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
            let report = fit_outlines(&mut grid, &ball(1.0), None).unwrap();
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
        fit_outlines(&mut grid, &masks, None).unwrap();
        assert!(off(&grid, 1.0) < 0.015, "{}", off(&grid, 1.0));
    }

    #[test]
    fn masks_that_show_something_else_move_nothing() {
        let mut grid = sphere(0.6);
        let before = off(&grid, 0.6);
        fit_outlines(&mut grid, &ball(1.0), None).unwrap();
        assert_eq!(off(&grid, 0.6), before, "an outline that far away is not that of the contour");
    }

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        let masks = ball(1.0);
        let moved = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut grid = sphere(0.96);
            pool.install(|| fit_outlines(&mut grid, &masks, None).unwrap());
            grid
        };
        assert_eq!(moved(1), moved(3));
    }
}
