//! Triangle meshes in world space. Vertices are in columns, which triangles index into,
//! counterclockwise seen from outside.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::triangles::Mesh;
//!
//! let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
//! let mut mesh = Mesh { positions, triangles: vec![[0, 1, 2], [0, 0, 1]], ..Mesh::default() };
//! assert_eq!(mesh.drop_degenerate_triangles(), 1);
//! assert_eq!(mesh.repair_normals(), 3);
//! assert_eq!(mesh.normals, [Vec3::Z; 3]);
//! assert_eq!(mesh.area(), 0.5);
//! ```

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// An indexed triangle mesh in world space.
///
/// All vertex arrays have the same length; `triangles` index into them, counter-clockwise seen from
/// outside.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Mesh {
    /// Vertex positions, world units, finite.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals on the outer side.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, v down (texel row 0 is v = 0), if the mesh has any.
    pub uvs: Option<Vec<Vec2>>,
    /// Three vertex indices each.
    pub triangles: Vec<[u32; 3]>,
}

/// A triangle whose height is less than this part of its longest edge counts as degenerate.
const DEGENERATE_HEIGHT: f64 = 1e-7;

impl Mesh {
    /// The positions of triangle `triangle`'s corners.
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|vertex| self.positions[vertex as usize])
    }

    /// Lowest and highest corner of the axis-aligned box around all vertices that a triangle uses;
    /// `None` without triangles.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let mut points = self.triangles.iter().flatten().map(|&vertex| self.positions[vertex as usize]);
        let first = points.next()?;
        Some(points.fold((first, first), |(low, high), p| (low.min(p), high.max(p))))
    }

    /// Cross product of two edges of a triangle: twice the area, along the normal of the winding.
    pub(crate) fn doubled_area_vector(&self, triangle: usize) -> DVec3 {
        let [a, b, c] = self.corners(triangle).map(|p| p.as_dvec3());
        (b - a).cross(c - a)
    }

    /// Total surface area, in squared world units.
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|triangle| 0.5 * self.doubled_area_vector(triangle).length()).sum()
    }

    /// Whether triangle `triangle` has no usable area: repeated corners, or (nearly) collinear
    /// ones.
    pub fn is_degenerate(&self, triangle: usize) -> bool {
        let corners = self.corners(triangle).map(|p| p.as_dvec3());
        let longest_squared =
            (0..3).map(|edge| (corners[(edge + 1) % 3] - corners[edge]).length_squared()).fold(0.0, f64::max);
        // In this form NaN counts as degenerate.
        let usable = self.doubled_area_vector(triangle).length() > DEGENERATE_HEIGHT * longest_squared;
        !usable
    }

    /// Drops degenerate triangles and returns how many there were.
    pub fn drop_degenerate_triangles(&mut self) -> usize {
        let before = self.triangles.len();
        let kept = (0..before).filter(|&t| !self.is_degenerate(t)).map(|t| self.triangles[t]).collect();
        self.triangles = kept;
        before - self.triangles.len()
    }

    /// Area-weighted face normals summed at every vertex, vertices at the same position sharing one
    /// sum, normalized.
    ///
    /// Vertices without a face (or whose faces cancel) get +Y.
    pub fn smooth_normals(&self) -> Vec<Vec3> {
        let weld = self.welded_vertices();
        let mut sums = vec![DVec3::ZERO; self.positions.len()];
        for (triangle, indices) in self.triangles.iter().enumerate() {
            let face = self.doubled_area_vector(triangle);
            for &vertex in indices {
                sums[weld[vertex as usize] as usize] += face;
            }
        }
        let unit = |&vertex: &u32| sums[vertex as usize].try_normalize().unwrap_or(DVec3::Y).as_vec3();
        weld.iter().map(unit).collect()
    }

    /// Replaces zero, non-finite and missing normals by smooth ones and normalizes the rest.
    ///
    /// Normals within 1e-5 of unit length keep their bits. Returns how many were replaced.
    pub fn repair_normals(&mut self) -> usize {
        self.normals.resize(self.positions.len(), Vec3::ZERO);
        let mut smooth: Option<Vec<Vec3>> = None;
        let mut replaced = 0;
        for vertex in 0..self.normals.len() {
            let normal = self.normals[vertex];
            if (normal.length_squared() - 1.0).abs() <= 2e-5 {
                continue;
            }
            let unit = normal.as_dvec3().try_normalize();
            self.normals[vertex] = unit.map(|n| n.as_vec3()).unwrap_or_else(|| {
                replaced += 1;
                smooth.get_or_insert_with(|| self.smooth_normals())[vertex]
            });
        }
        replaced
    }

    /// For each vertex, the first vertex at the identical position (−0 equals 0).
    pub fn welded_vertices(&self) -> Vec<u32> {
        let mut first_at = HashMap::with_capacity(self.positions.len());
        let first = |(vertex, at): (u32, &Vec3)| {
            *first_at.entry((*at + Vec3::ZERO).to_array().map(f32::to_bits)).or_insert(vertex)
        };
        (0..).zip(&self.positions).map(first).collect()
    }

    /// Checks that each vertex has all its values and a finite position, and that each triangle
    /// names such vertices; the error is the problem.
    pub(crate) fn check_lists(&self) -> Result<(), String> {
        let (count, normals) = (self.positions.len(), self.normals.len());
        let uvs = self.uvs.as_ref().map_or(count, Vec::len);
        if normals != count || uvs != count {
            return Err(format!(
                "the mesh has {count} positions, {normals} normals and {uvs} texture coordinates; these must be equal"
            ));
        }
        if let Some(triangle) = self.triangles.iter().position(|t| t.iter().any(|v| *v as usize >= count)) {
            return Err(format!("triangle {triangle} names a vertex beyond the {count} that there are"));
        }
        match self.positions.iter().position(|p| !p.is_finite()) {
            Some(vertex) => Err(format!("vertex {vertex} is not finite")),
            None => Ok(()),
        }
    }

    /// Unit normal of the flat triangle `triangle`, on the side of its vertex normals; zero if it
    /// is degenerate.
    pub fn geometric_normal(&self, triangle: usize) -> Vec3 {
        let face = self.doubled_area_vector(triangle);
        let vertex_normals: Vec3 = self.triangles[triangle].iter().map(|&v| self.normals[v as usize]).sum();
        let face = if face.dot(vertex_normals.as_dvec3()) < 0.0 { -face } else { face };
        face.normalize_or_zero().as_vec3()
    }
}

/// A side of a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Side {
    /// The vertices at its ends, in ascending order.
    pub ends: [u32; 2],
    /// The triangle.
    pub triangle: u32,
}

/// The sides of all triangles, those of an edge one after another, in the order of their triangles.
pub fn sorted_sides(triangles: &[[u32; 3]]) -> Vec<Side> {
    let sides = |(triangle, &[a, b, c]): (u32, &[u32; 3])| {
        [[a, b], [b, c], [c, a]].map(|[a, b]| Side { ends: [a.min(b), a.max(b)], triangle })
    };
    let mut sides: Vec<Side> = (0..).zip(triangles).flat_map(sides).collect();
    sides.par_sort_unstable();
    sides
}

/// Disjoint sets of numbers. The root of a set is its lowest number.
pub(crate) struct DisjointSets(Vec<u32>);

impl DisjointSets {
    /// Each of `count` numbers alone.
    pub fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    /// The root of the set of a number.
    pub fn root(&mut self, mut i: u32) -> u32 {
        let parents = &mut self.0;
        while parents[i as usize] != i {
            parents[i as usize] = parents[parents[i as usize] as usize];
            i = parents[i as usize];
        }
        i
    }

    /// Joins the sets of two numbers.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit right triangle in the plane z = 0, and a copy with separate vertices, folded up along
    /// x.
    fn folded() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::new(-0.0, 0.0, 0.0), Vec3::Z, Vec3::X],
            normals: vec![Vec3::ZERO; 6],
            uvs: None,
            triangles: vec![[0, 1, 2], [3, 4, 5]],
        }
    }

    #[test]
    fn smooth_normals_are_shared_across_split_vertices() {
        let mut mesh = folded();
        assert_eq!(mesh.repair_normals(), 6);
        // Faces +z and +y of equal area meet at the x axis.
        let diagonal = Vec3::new(0.0, 1.0, 1.0).normalize();
        for vertex in [0, 1, 3, 5] {
            assert!((mesh.normals[vertex] - diagonal).length() < 1e-6, "{:?}", mesh.normals[vertex]);
        }
        assert_eq!(mesh.normals[2], Vec3::Z);
        assert_eq!(mesh.normals[4], Vec3::Y);
    }

    #[test]
    fn only_bad_normals_are_touched() {
        let mut mesh = folded();
        let given = Vec3::new(0.3, -0.2, 0.93).normalize();
        mesh.normals = vec![given, Vec3::X * 4.0, Vec3::NAN, given, given, Vec3::ZERO];
        assert_eq!(mesh.repair_normals(), 2);
        assert_eq!(mesh.normals[0], given);
        assert_eq!(mesh.normals[1], Vec3::X);
        assert_eq!(mesh.normals[2], Vec3::Z);
    }

    #[test]
    fn degenerate_triangles_are_counted_and_dropped() {
        let mut mesh = folded();
        mesh.positions.push(Vec3::new(0.5, 0.0, 0.0));
        mesh.triangles.extend([[0, 0, 1], [0, 1, 6], [2, 2, 2]]);
        assert_eq!(mesh.drop_degenerate_triangles(), 3);
        assert_eq!(mesh.triangles, folded().triangles);
    }

    #[test]
    fn box_and_area() {
        let mesh = folded();
        assert_eq!(mesh.bounds(), Some((Vec3::ZERO, Vec3::ONE)));
        assert!((mesh.area() - 1.0).abs() < 1e-12);
        assert_eq!(Mesh::default().bounds(), None);
    }
}
