//! A radiance field inside the hull: densities and colors at the vertices of a grid.
//!
//! A surface that is fitted cannot leap over the space between a lid and the floor below it. A field of densities can: it begins nearly
//! transparent, so that each photograph colors all that lies along its rays, and what many rays agree on becomes dense. Colors do not
//! depend on the direction of view: that would explain a lid as well as what is seen through it.

use super::colors::ColorPicture;
use crate::math::ray::Ray;
use crate::sdf::SdfGrid;
use glam::{UVec3, Vec3, Vec4};

/// How far outside the surface the field reaches, in cells.
const REACH: f32 = 1.0;
/// Density of all that is outside, before the softplus.
const OUTSIDE: f32 = -6.0;
/// Density at which a fit begins, before the softplus: about 0.13 per cell.
const BEGIN: f32 = -2.0;

/// Densities and colors at the vertices of a grid that are inside the object or near it.
#[derive(Clone, Debug)]
pub struct RadianceField {
    /// Vertices per side.
    pub side: u32,
    origin: Vec3,
    /// Width of a cell, world units.
    pub spacing: f32,
    /// The row in `values` of each vertex of the grid; 0 for those that are outside.
    pub rows: Vec<u32>,
    /// Whether the cell above each vertex has one that is not outside.
    holds: Vec<bool>,
    /// The vertex of each row; that of row 0 is meaningless.
    pub vertices: Vec<u32>,
    /// Color with the curve of sRGB, and density per cell before the softplus. Row 0 stands for all that is outside.
    pub values: Vec<Vec4>,
}

/// A ray of a fit: a pixel of a picture, and where along its ray the surface is.
#[derive(Clone, Copy, Debug)]
pub struct FieldRay {
    /// Index of the picture.
    pub picture: u32,
    /// Index of the pixel in the picture's window.
    pub place: u32,
    /// Distance to the surface, world units.
    pub surface: f32,
}

impl FieldRay {
    /// The ray in the world, and the color that the picture shows there.
    pub fn of(&self, pictures: &[ColorPicture]) -> (Ray, Vec3) {
        pictures[self.picture as usize].ray_and_color(self.place as usize)
    }
}

/// How far the indices of a cell's vertices are from that of its first, in a grid of `side` vertices along each axis.
#[inline]
fn corners(side: usize) -> [usize; 8] {
    let (back, both) = (side * side, side + side * side);
    [0, 1, side, side + 1, back, back + 1, both, both + 1]
}

impl RadianceField {
    /// A nearly transparent field of one color.
    pub fn new(grid: &SdfGrid, color: Vec3) -> Self {
        let mut field = Self {
            side: grid.side,
            origin: grid.origin,
            spacing: grid.spacing,
            rows: vec![0; grid.values.len()],
            holds: vec![false; grid.values.len()],
            vertices: vec![0],
            values: vec![color.extend(OUTSIDE)],
        };
        for (vertex, distance) in grid.values.iter().enumerate() {
            if *distance < REACH * grid.spacing {
                field.rows[vertex] = field.vertices.len() as u32;
                field.vertices.push(vertex as u32);
                field.values.push(color.extend(BEGIN));
                let place = grid.vertex(vertex);
                for (k, offset) in (0..).zip(corners(grid.side as usize)) {
                    if place.cmpge(UVec3::new(k & 1, k >> 1 & 1, k >> 2)).all() {
                        field.holds[vertex - offset] = true;
                    }
                }
            }
        }
        field
    }

    /// Begins with the values of a coarser field.
    pub fn beginning_with(mut self, coarse: &Self) -> Self {
        for row in 1..self.values.len() {
            let (rows, weights) = coarse.corners(self.position(row));
            let known = || rows.iter().zip(weights).filter(|(row, _)| **row > 0);
            let total: f32 = known().map(|(_, weight)| weight).sum();
            if total > 0.0 {
                self.values[row] =
                    known().map(|(row, w)| coarse.values[*row as usize] * w).sum::<Vec4>() / total;
            }
        }
        self
    }

    /// The world position of a row's vertex.
    pub fn position(&self, row: usize) -> Vec3 {
        let (side, vertex) = (self.side, self.vertices[row]);
        self.origin
            + UVec3::new(vertex % side, vertex / side % side, vertex / (side * side)).as_vec3() * self.spacing
    }

    /// How far along a ray the grid ends, world units.
    pub fn exit(&self, ray: &Ray) -> f32 {
        let high = self.origin + Vec3::splat((self.side - 1) as f32 * self.spacing);
        let along = |axis: usize| match ray.direction[axis] {
            0.0 => f32::INFINITY,
            slope if slope > 0.0 => (high[axis] - ray.origin[axis]) / slope,
            slope => (self.origin[axis] - ray.origin[axis]) / slope,
        };
        along(0).min(along(1)).min(along(2))
    }

    /// Rows of the eight vertices around a point, with their trilinear weights.
    #[inline]
    pub fn corners(&self, point: Vec3) -> ([u32; 8], [f32; 8]) {
        let (first, t) = self.cell(point);
        self.corners_of(first, t)
    }

    /// The same; `None` if all of them are outside.
    #[inline]
    pub fn corners_inside(&self, point: Vec3) -> Option<([u32; 8], [f32; 8])> {
        let (first, t) = self.cell(point);
        self.holds[first].then(|| self.corners_of(first, t))
    }

    /// The first vertex of the cell around a point, and the position in the cell, in [0, 1]³.
    #[inline]
    fn cell(&self, point: Vec3) -> (usize, Vec3) {
        let last = (self.side - 1) as f32;
        let at = ((point - self.origin) / self.spacing).clamp(Vec3::ZERO, Vec3::splat(last - 1e-3));
        let cell = at.as_uvec3();
        let side = self.side as usize;
        (cell.x as usize + side * (cell.y as usize + side * cell.z as usize), at - cell.as_vec3())
    }

    #[inline]
    fn corners_of(&self, first: usize, t: Vec3) -> ([u32; 8], [f32; 8]) {
        let s = Vec3::ONE - t;
        let vertices = corners(self.side as usize);
        let (low, high, far_low, far_high) = (s.y * s.z, t.y * s.z, s.y * t.z, t.y * t.z);
        let weights = [low, low, high, high, far_low, far_low, far_high, far_high];
        let across = [s.x, t.x, s.x, t.x, s.x, t.x, s.x, t.x];
        (vertices.map(|vertex| self.rows[first + vertex]), std::array::from_fn(|k| weights[k] * across[k]))
    }

    /// The row of the vertex nearest to a point; 0 outside.
    #[inline]
    pub fn nearest(&self, point: Vec3) -> usize {
        let at = ((point - self.origin) / self.spacing).round();
        let last = (self.side - 1) as f32;
        if at.min_element() < 0.0 || at.max_element() > last {
            return 0;
        }
        let (at, side) = (at.as_uvec3(), self.side);
        self.rows[(at.x + side * (at.y + side * at.z)) as usize] as usize
    }
}
