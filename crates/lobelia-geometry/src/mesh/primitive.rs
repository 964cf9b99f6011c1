//! Meshes of simple solids, with normals and texture coordinates that do not overlap. They are
//! closed and face outward.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::primitive::{box_mesh, sphere_mesh};
//! use std::f64::consts::PI;
//!
//! let brick = box_mesh(Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0))?;
//! let ball = sphere_mesh(Vec3::X, 1.0)?;
//! assert!((brick.area() - 22.0).abs() < 1e-5);
//! assert!((ball.area() / (4.0 * PI) - 1.0).abs() < 1e-3);
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use crate::{Error, Result, mesh::triangles::Mesh};
use glam::{DVec3, Vec2, Vec3};

/// Rows of a sphere from pole to pole; the surface is within 3e-4 of the radius.
const SPHERE_ROWS: u32 = 96;
/// Columns of a sphere around the axis.
const SPHERE_COLUMNS: u32 = 2 * SPHERE_ROWS;
/// Empty border of each chart of a box, in texture coordinates: two texels at a texture size of
/// 128.
const BOX_GUTTER: f32 = 1.0 / 64.0;

/// A smooth sphere with exact normals and latitude-longitude texture coordinates.
///
/// The top row of the texture is around +Y and u is as in an environment map: direction of (u, v) =
/// (cos θ sin φ, cos φ, sin θ sin φ), φ = πv, θ = 2πu − π/2. Vertices are on the sphere; the flat
/// triangles lie up to 3e-4 of the radius inside it.
///
/// # Errors
/// [`Error::Usage`] if the radius is not positive or something is not finite.
pub fn sphere_mesh(center: Vec3, radius: f32) -> Result<Mesh> {
    if !(center.is_finite() && radius.is_finite() && radius > 0.0) {
        let problem = format!("a sphere of radius {radius} around {center} is not a surface");
        return Err(Error::usage(problem, "the radius must be positive and all numbers finite"));
    }
    let mut mesh = Mesh { uvs: Some(Vec::new()), ..Mesh::default() };
    for row in 0..=SPHERE_ROWS {
        let at_pole = row == 0 || row == SPHERE_ROWS;
        for column in 0..=SPHERE_COLUMNS {
            // A pole has one vertex per column, in the middle of its triangle in u.
            let shift = if at_pole { 0.5 } else { 0.0 };
            let u = ((column as f32 + shift) / SPHERE_COLUMNS as f32).min(1.0);
            let normal = sphere_direction(row, column);
            mesh.positions.push(center + normal * radius);
            mesh.normals.push(normal);
            mesh.uvs.iter_mut().for_each(|uvs| uvs.push(Vec2::new(u, row as f32 / SPHERE_ROWS as f32)));
        }
    }
    let vertex = |row, column| row * (SPHERE_COLUMNS + 1) + column;
    for row in 0..SPHERE_ROWS {
        for column in 0..SPHERE_COLUMNS {
            let [a, b] = [vertex(row, column), vertex(row, column + 1)];
            let [c, d] = [vertex(row + 1, column), vertex(row + 1, column + 1)];
            // A pole is one corner of its triangles; everywhere else two triangles make a
            // quadrilateral.
            match row {
                0 => mesh.triangles.push([a, d, c]),
                _ if row + 1 == SPHERE_ROWS => mesh.triangles.push([a, b, c]),
                _ => mesh.triangles.extend([[a, b, d], [a, d, c]]),
            }
        }
    }
    Ok(mesh)
}

/// The unit direction of grid point (`row`, `column`); first and last column, and all columns of a
/// pole, are identical.
fn sphere_direction(row: u32, column: u32) -> Vec3 {
    use std::f64::consts::PI;
    let phi = PI * f64::from(row) / f64::from(SPHERE_ROWS);
    let theta = 2.0 * PI * f64::from(column % SPHERE_COLUMNS) / f64::from(SPHERE_COLUMNS) - PI / 2.0;
    let (sin, cos) = phi.sin_cos();
    match row {
        0 => Vec3::Y,
        SPHERE_ROWS => Vec3::NEG_Y,
        _ => DVec3::new(theta.cos() * sin, cos, theta.sin() * sin).as_vec3(),
    }
}

/// An axis-aligned box with flat normals: one chart per face, three by two, each with a gutter of
/// 1/64 on all sides.
///
/// The first row of charts shows +X, −X, +Y, the second −Y, +Z, −Z, each as seen from outside.
///
/// # Errors
/// [`Error::Usage`] if a side is not positive or something is not finite.
pub fn box_mesh(center: Vec3, size: Vec3) -> Result<Mesh> {
    if !(center.is_finite() && size.is_finite() && size.min_element() > 0.0) {
        let problem = format!("a box of size {size} around {center} is not a surface");
        return Err(Error::usage(problem, "all three sides must be positive and all numbers finite"));
    }
    let mut mesh = Mesh { uvs: Some(Vec::new()), ..Mesh::default() };
    // Right and down as seen from outside, so that right × down points inward.
    let faces = [
        (Vec3::X, Vec3::NEG_Z, Vec3::NEG_Y),
        (Vec3::NEG_X, Vec3::Z, Vec3::NEG_Y),
        (Vec3::Y, Vec3::X, Vec3::Z),
        (Vec3::NEG_Y, Vec3::X, Vec3::NEG_Z),
        (Vec3::Z, Vec3::X, Vec3::NEG_Y),
        (Vec3::NEG_Z, Vec3::NEG_X, Vec3::NEG_Y),
    ];
    for (face, (normal, right, down)) in faces.into_iter().enumerate() {
        let cell = Vec2::new(1.0 / 3.0, 0.5);
        let low = Vec2::new((face % 3) as f32, (face / 3) as f32) * cell + BOX_GUTTER;
        let span = cell - 2.0 * BOX_GUTTER;
        let first = mesh.positions.len() as u32;
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            let corner = normal + right * (2.0 * x - 1.0) + down * (2.0 * y - 1.0);
            mesh.positions.push(center + corner * size * 0.5);
            mesh.normals.push(normal);
            mesh.uvs.iter_mut().for_each(|uvs| uvs.push(low + span * Vec2::new(x, y)));
        }
        mesh.triangles.push([first, first + 2, first + 1]);
        mesh.triangles.push([first, first + 3, first + 2]);
    }
    Ok(mesh)
}

/// A ball, its center at a height, over a plate of 2 × 2 around the origin; each has half of the
/// texture.
#[doc(hidden)]
pub fn ball_over_plate(thickness: f32, height: f32, radius: f32) -> Mesh {
    let mut mesh = box_mesh(Vec3::ZERO, Vec3::new(2.0, thickness, 2.0)).unwrap();
    let ball = sphere_mesh(Vec3::new(0.0, height, 0.0), radius).unwrap();
    let offset = mesh.positions.len() as u32;
    mesh.positions.extend(&ball.positions);
    mesh.normals.extend(&ball.normals);
    mesh.triangles.extend(ball.triangles.iter().map(|t| t.map(|v| v + offset)));
    let uvs = mesh.uvs.as_mut().unwrap();
    uvs.iter_mut().for_each(|uv| uv.x *= 0.5);
    uvs.extend(ball.uvs.unwrap().iter().map(|uv| Vec2::new(0.5 + 0.5 * uv.x, uv.y)));
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::tests::is_closed;

    fn all_faces_point_outwards(mesh: &Mesh, center: Vec3) -> bool {
        (0..mesh.triangles.len()).all(|t| {
            let [a, b, c] = mesh.corners(t);
            (b - a).cross(c - a).dot(a - center) > 0.0
        })
    }

    #[test]
    fn sphere_is_closed_round_and_faces_outwards() {
        let (center, radius) = (Vec3::new(0.5, -1.0, 2.0), 0.7);
        let mesh = sphere_mesh(center, radius).unwrap();
        assert!(is_closed(&mesh));
        assert!(all_faces_point_outwards(&mesh, center));
        assert_eq!(mesh.clone().drop_degenerate_triangles(), 0);
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t);
            // The deepest point of a chord triangle is nearest the center: its circumcenter or the
            // middle of an edge.
            for point in [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0, (a + b + c) / 3.0] {
                let error = ((point - center).length() - radius).abs() / radius;
                assert!(error < 4e-4, "{error}");
            }
        }
        assert!((mesh.area() / (4.0 * std::f64::consts::PI * 0.49) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn sphere_texture_is_latitude_longitude() {
        let mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
        for (uv, direction) in [
            (Vec2::new(0.0, 0.5), Vec3::NEG_Z),
            (Vec2::new(0.25, 0.5), Vec3::X),
            (Vec2::new(0.5, 0.5), Vec3::Z),
            (Vec2::new(0.75, 0.5), Vec3::NEG_X),
        ] {
            let vertex = mesh.uvs.as_ref().unwrap().iter().position(|&x| x == uv).unwrap();
            assert!((mesh.normals[vertex] - direction).length() < 1e-6);
        }
        assert_eq!((mesh.uvs.as_ref().unwrap()[0].y, mesh.normals[0]), (0.0, Vec3::Y));
    }

    #[test]
    fn box_is_closed_faces_outwards_and_its_charts_are_apart() {
        let (center, size) = (Vec3::new(-1.0, 0.0, 3.0), Vec3::new(0.5, 1.0, 2.0));
        let mesh = box_mesh(center, size).unwrap();
        assert!(is_closed(&mesh));
        assert!(all_faces_point_outwards(&mesh, center));
        assert_eq!(mesh.bounds(), Some((center - size / 2.0, center + size / 2.0)));
        let uvs = mesh.uvs.as_ref().unwrap();
        let around =
            |uv: &[Vec2]| uv.iter().fold((uv[0], uv[0]), |(low, high), &p| (low.min(p), high.max(p)));
        let charts: Vec<(Vec2, Vec2)> = uvs.chunks(4).map(around).collect();
        for (i, a) in charts.iter().enumerate() {
            assert!(a.0.min_element() >= BOX_GUTTER && a.1.max_element() <= 1.0 - BOX_GUTTER + 1e-6);
            for b in &charts[..i] {
                let gap = (a.0 - b.1).max(b.0 - a.1).max_element();
                assert!(gap > 1.9 * BOX_GUTTER, "{gap}");
            }
        }
        // Mirrored charts would flip a texture: u × v must point out of the surface (v is down, so
        // into it).
        for t in &mesh.triangles {
            let uv = t.map(|v| uvs[v as usize]);
            assert!((uv[1] - uv[0]).perp_dot(uv[2] - uv[0]) < 0.0);
        }
    }

    #[test]
    fn nonsense_sizes_are_refused() {
        for radius in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(matches!(sphere_mesh(Vec3::ZERO, radius), Err(Error::Usage { .. })));
            assert!(matches!(box_mesh(Vec3::ZERO, Vec3::new(1.0, radius, 1.0)), Err(Error::Usage { .. })));
        }
        assert!(sphere_mesh(Vec3::NAN, 1.0).is_err());
    }
}
