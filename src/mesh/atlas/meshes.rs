//! Meshes for tests.

use crate::mesh::triangles::Mesh;
use glam::Vec3;
use std::f32::consts::TAU;

/// A grid of vertices, `columns` × `rows`, closed along x, along both, or open; two triangles for each square.
fn grid(columns: u32, rows: u32, closed: [bool; 2], place: impl Fn(f32, f32) -> Vec3) -> Mesh {
    let squares = |count: u32, closed: bool| if closed { count } else { count - 1 };
    let (across, along) = (squares(columns, closed[0]), squares(rows, closed[1]));
    let mut mesh = Mesh::default();
    for (x, y) in (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))) {
        mesh.positions.push(place(x as f32 / across as f32, y as f32 / along as f32));
    }
    for (x, y) in (0..along).flat_map(|y| (0..across).map(move |x| (x, y))) {
        let at = |x: u32, y: u32| (y % rows) * columns + x % columns;
        let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
        mesh.triangles.extend([[a, b, c], [a, c, d]]);
    }
    mesh.repair_normals();
    mesh
}

/// A flat square from −1 to 1 in x and y, of `count`² squares.
pub fn plate(count: u32) -> Mesh {
    grid(count + 1, count + 1, [false; 2], |x, y| Vec3::new(2.0 * x - 1.0, 2.0 * y - 1.0, 0.0))
}

/// A tube of radius 1 and length 3 around z, open at both ends.
pub fn tube(around: u32, along: u32) -> Mesh {
    grid(around, along, [true, false], |x, y| Vec3::new((TAU * x).cos(), (TAU * x).sin(), 3.0 * y))
}

/// A torus of radii 1 and 0.4 around z.
pub(crate) fn torus(around: u32, across: u32) -> Mesh {
    grid(around, across, [true; 2], |x, y| {
        let radius = 1.0 + 0.4 * (TAU * y).cos();
        Vec3::new(radius * (TAU * x).cos(), radius * (TAU * x).sin(), 0.4 * (TAU * y).sin())
    })
}

/// A closed ball of radius 1, made of a cube with `count`² squares a face; each vertex is moved by at most `noise` outward or inward.
pub fn ball(count: u32, noise: f32) -> Mesh {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let face = plate(count);
            let first = mesh.positions.len() as u32;
            // The same bits on both sides of an edge of the cube.
            let even = |c: f32| (c * count as f32).round() / count as f32;
            let place = |p: &Vec3| {
                let mut at = [sign, even(p.x) * sign, even(p.y)];
                at.rotate_right(axis);
                let on_ball = Vec3::from(at).normalize();
                // Of the place alone, so that vertices of two faces stay together.
                let wild = (on_ball.dot(Vec3::new(127.1, 311.7, 74.7)) * 43.7).sin();
                on_ball * (1.0 + noise * wild)
            };
            mesh.positions.extend(face.positions.iter().map(place));
            mesh.triangles.extend(face.triangles.iter().map(|t| t.map(|v| v + first)));
        }
    }
    mesh.repair_normals();
    mesh
}

/// Triangles apart from each other.
pub(crate) fn scattered(count: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for k in 0..count {
        let p = Vec3::new(k as f32, 0.0, 0.0);
        mesh.positions.extend([p, p + Vec3::X * 0.5, p + Vec3::Y]);
        mesh.triangles.push([3 * k, 3 * k + 1, 3 * k + 2]);
    }
    mesh.repair_normals();
    mesh
}
