//! The texel atlas: the surface point of each texel, and the texels of a surface point.
//!
//! Texel (i, j) has its center at uv = ((i + ½)/W, (j + ½)/H); lookups are bilinear and clamp at
//! the borders. [`unwrap_mesh`] gives a mesh that has none coordinates: `chart` takes the surface
//! apart and lays the parts flat, `pack` puts them side by side, `fill_uncovered` fills what no
//! view sees.

mod chart;
mod fill;
mod neighbors;
mod pack;
mod unwrap;

pub use fill::fill_uncovered;
pub use unwrap::{UnwrappedMesh, unwrap_mesh};

use crate::{mesh::triangles::Mesh, view::raster::bilinear};
use glam::{DVec2, DVec3, Vec2, Vec3};
use lobelia_sg::{ray::TexelAddress, statistics::median};

/// Distance from a triangle, in texels, within which texels are covered: a bilinear footprint is
/// the square of half-width 1 around a texel center, whose corners are √2 away.
const REACH: f64 = std::f64::consts::SQRT_2;

/// The surface in texture space: one row per texel, `y * width + x`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TexelAtlas {
    /// Width in texels.
    pub width: u32,
    /// Height in texels.
    pub height: u32,
    /// World position of the surface point nearest to the texel's center (in texture space); zero
    /// where not covered.
    pub position: Vec<Vec3>,
    /// Unit shading normal there; zero where not covered.
    pub normal: Vec<Vec3>,
    /// Whether a lookup at some surface point can reach the texel: true for every texel of every
    /// bilinear footprint.
    pub covered: Vec<bool>,
}

impl TexelAtlas {
    /// Rasterizes the triangles of `mesh` in texture space; a mesh without texture coordinates
    /// covers nothing.
    ///
    /// If several triangles reach a texel, the one nearest to its center is used; of equal ones,
    /// the first.
    pub fn new(mesh: &Mesh, width: u32, height: u32) -> Self {
        let count = width as usize * height as usize;
        let (position, normal) = (vec![Vec3::ZERO; count], vec![Vec3::ZERO; count]);
        let mut atlas = Self { width, height, position, normal, covered: vec![false; count] };
        let mut nearest = vec![REACH; count];
        let size = DVec2::new(f64::from(width), f64::from(height));
        for triangle in mesh.uvs.iter().flat_map(|_| &mesh.triangles) {
            let Some(corners) = texture_corners(mesh, triangle, size) else { continue };
            for (x, y) in texels_near(corners, width, height) {
                let row = (y * width + x) as usize;
                let (distance, weights) = nearest_point(corners, DVec2::new(f64::from(x), f64::from(y)));
                if distance < nearest[row] {
                    nearest[row] = distance;
                    atlas.covered[row] = true;
                    atlas.position[row] = interpolate(&mesh.positions, triangle, weights).as_vec3();
                    atlas.normal[row] =
                        interpolate(&mesh.normals, triangle, weights).normalize_or_zero().as_vec3();
                }
            }
        }
        atlas
    }

    /// Median distance in the world between covered texels that are neighbors in a row; zero if
    /// nothing is covered.
    pub fn texel_size(&self) -> f32 {
        let width = self.width as usize;
        let is_pair = |t: &usize| !t.is_multiple_of(width) && self.covered[*t] && self.covered[t - 1];
        let distance = |t: usize| self.position[t].distance(self.position[t - 1]);
        let mut distances: Vec<f32> = (1..self.covered.len()).filter(is_pair).map(distance).collect();
        median(&mut distances).unwrap_or(0.0)
    }
}

/// The four texels that are interpolated at `uv` in a texture of `width` × `height` texels (both at
/// least 1), clamped at the borders.
#[inline]
pub fn address(uv: Vec2, width: u32, height: u32) -> TexelAddress {
    let taps = bilinear(width, height, uv.x * width as f32 - 0.5, uv.y * height as f32 - 0.5);
    TexelAddress { indices: taps.map(|(texel, _)| texel as u32), weights: taps.map(|(_, weight)| weight) }
}

/// The triangle in units of texels, texel centers at whole numbers; `None` if it is not finite.
fn texture_corners(mesh: &Mesh, triangle: &[u32; 3], size: DVec2) -> Option<[DVec2; 3]> {
    let uvs = mesh.uvs.as_ref()?;
    let corners = triangle.map(|vertex| uvs[vertex as usize].as_dvec2() * size - 0.5);
    corners.iter().all(|c| c.is_finite()).then_some(corners)
}

/// The texels in the bounding box of `corners`, grown by [`REACH`], row by row.
fn texels_near(corners: [DVec2; 3], width: u32, height: u32) -> impl Iterator<Item = (u32, u32)> {
    let low = corners[0].min(corners[1]).min(corners[2]) - REACH;
    let high = corners[0].max(corners[1]).max(corners[2]) + REACH;
    // Float to integer conversion saturates, so far-away corners give empty or clipped ranges.
    let range = |low: f64, high: f64, size: u32| {
        let begin = low.ceil().max(0.0) as u32;
        let end = if high < 0.0 { 0 } else { (high.floor() as u32).saturating_add(1).min(size) };
        begin..end
    };
    let columns = range(low.x, high.x, width);
    range(low.y, high.y, height).flat_map(move |y| columns.clone().map(move |x| (x, y)))
}

/// Distance from `point` to the triangle, and the barycentric weights of the triangle's nearest
/// point.
fn nearest_point(corners: [DVec2; 3], point: DVec2) -> (f64, [f64; 3]) {
    let doubled_area = (corners[1] - corners[0]).perp_dot(corners[2] - corners[0]);
    let part =
        |i: usize| (corners[(i + 2) % 3] - corners[(i + 1) % 3]).perp_dot(point - corners[(i + 1) % 3]);
    let weights = [0, 1, 2].map(|i| part(i) / doubled_area);
    if weights.iter().all(|&w| w >= 0.0) && doubled_area != 0.0 {
        return (0.0, weights);
    }
    let mut best = (f64::INFINITY, [1.0, 0.0, 0.0]);
    for (i, j) in [(0, 1), (1, 2), (2, 0)] {
        let edge = corners[j] - corners[i];
        let length_squared = edge.length_squared();
        let along = if length_squared > 0.0 {
            ((point - corners[i]).dot(edge) / length_squared).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let distance = (corners[i] + edge * along - point).length();
        if distance < best.0 {
            let mut weights = [0.0; 3];
            weights[i] = 1.0 - along;
            weights[j] = along;
            best = (distance, weights);
        }
    }
    best
}

fn interpolate(values: &[Vec3], triangle: &[u32; 3], weights: [f64; 3]) -> DVec3 {
    (0..3).map(|k| values[triangle[k] as usize].as_dvec3() * weights[k]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::{box_mesh, sphere_mesh};

    /// Fraction of all texels that is covered.
    fn covered_part(atlas: &TexelAtlas) -> f32 {
        atlas.covered.iter().filter(|covered| **covered).count() as f32 / atlas.covered.len() as f32
    }

    #[test]
    fn addresses_blend_texel_centers() {
        // At a center, that texel alone.
        let exact = address(Vec2::new(2.5 / 4.0, 1.5 / 3.0), 4, 3);
        let weight_of = |a: &TexelAddress, texel| -> f32 {
            (0..4).filter(|&i| a.indices[i] == texel).map(|i| a.weights[i]).sum()
        };
        assert!((weight_of(&exact, 6) - 1.0).abs() < 1e-6);
        // A quarter of the way to the right neighbor.
        let between = address(Vec2::new(2.75 / 4.0, 1.5 / 3.0), 4, 3);
        assert!((weight_of(&between, 6) - 0.75).abs() < 1e-6 && (weight_of(&between, 7) - 0.25).abs() < 1e-6);
        // Corners clamp.
        for (uv, texel) in [(Vec2::ZERO, 0), (Vec2::ONE, 11), (Vec2::new(5.0, -3.0), 3)] {
            assert_eq!(weight_of(&address(uv, 4, 3), texel), 1.0);
        }
        assert_eq!(address(Vec2::splat(0.3), 1, 1).blend(&[Vec3::X]), Vec3::X);
    }

    #[test]
    fn every_footprint_of_a_surface_point_is_covered() {
        use rand::{RngExt, SeedableRng};
        let mut rng = rand::rngs::StdRng::seed_from_u64(7);
        let sphere = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
        let cube = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        let unwrapped = unwrap_mesh(&Mesh { uvs: None, ..sphere.clone() }, 96).unwrap().mesh;
        for mesh in [sphere, cube, unwrapped] {
            let atlas = TexelAtlas::new(&mesh, 96, 96);
            for _ in 0..20_000 {
                let t = mesh.triangles[rng.random_range(0..mesh.triangles.len())];
                let (a, b): (f32, f32) = (rng.random(), rng.random());
                let (a, b) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
                let uvs = mesh.uvs.as_ref().unwrap();
                let uv = t.map(|v| uvs[v as usize]);
                let found = address(uv[0] * (1.0 - a - b) + uv[1] * a + uv[2] * b, 96, 96);
                for (texel, weight) in found.indices.into_iter().zip(found.weights) {
                    assert!(weight == 0.0 || atlas.covered[texel as usize]);
                }
            }
        }
    }

    #[test]
    fn texels_know_their_place_on_the_surface() {
        let center = Vec3::new(1.0, 2.0, 3.0);
        let atlas = TexelAtlas::new(&sphere_mesh(center, 0.5).unwrap(), 64, 32);
        for y in 0..32 {
            for x in 0..64 {
                let row = y * 64 + x;
                if !atlas.covered[row] {
                    continue;
                }
                let phi = std::f32::consts::PI * (y as f32 + 0.5) / 32.0;
                let theta = std::f32::consts::TAU * (x as f32 + 0.5) / 64.0 - std::f32::consts::FRAC_PI_2;
                let direction = Vec3::new(theta.cos() * phi.sin(), phi.cos(), theta.sin() * phi.sin());
                assert!((atlas.position[row] - (center + 0.5 * direction)).length() < 2e-3);
                assert!((atlas.normal[row] - direction).length() < 2e-3);
            }
        }
        assert!(covered_part(&atlas) > 0.99);
    }

    #[test]
    fn texture_coordinates_from_afar_cover_nothing_and_do_no_harm() {
        let mut mesh = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        for (i, uv) in mesh.uvs.as_mut().unwrap().iter_mut().enumerate() {
            *uv = *uv * 1e20 + 1e21 * if i % 2 == 0 { 1.0 } else { 1.5 };
        }
        assert_eq!(covered_part(&TexelAtlas::new(&mesh, 16, 16)), 0.0);
        assert_eq!(covered_part(&TexelAtlas::new(&Mesh { uvs: None, ..mesh }, 16, 16)), 0.0);
    }
}
