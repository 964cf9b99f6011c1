//! Axes, origin and size of the exported object.

use crate::codec::usd::UpAxis;
use crate::mesh::triangles::Mesh;
use crate::scene::{ExportPass, ExportScale, ExportUp};
use glam::{Quat, Vec3};

/// Where points of the data go: `scale` · (`turn` p − `origin`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ExportTransform {
    /// Rotation, of the light as well.
    pub turn: Quat,
    origin: Vec3,
    scale: f32,
    /// The axis that is up afterward, or the nearest of the two that files can name.
    pub up: UpAxis,
}

impl ExportTransform {
    /// As the pass says, for data in which `data_up` is up.
    pub fn new(data_up: Vec3, pass: &ExportPass, mesh: &Mesh) -> Self {
        let data_up = data_up.normalize_or(Vec3::Y);
        let (turn, up) = match pass.up {
            ExportUp::Data if data_up.z.abs() > data_up.y.abs() => (Quat::IDENTITY, UpAxis::Z),
            ExportUp::Data => (Quat::IDENTITY, UpAxis::Y),
            ExportUp::Y => (between(data_up, Vec3::Y), UpAxis::Y),
            ExportUp::Z => (between(data_up, Vec3::Z), UpAxis::Z),
        };
        let (low, high) = bounds(mesh, turn);
        let scale = match pass.scale {
            ExportScale::Factor(factor) => factor,
            ExportScale::Size(size) => size / (high - low).max_element().max(f32::MIN_POSITIVE),
        };
        Self { turn, origin: if pass.center { (low + high) / 2.0 } else { Vec3::ZERO }, scale, up }
    }

    /// The mesh with positions and normals of the file.
    pub fn placed(&self, mesh: &Mesh) -> Mesh {
        let mut placed = mesh.clone();
        // Nothing changes a bit of what stays where it is.
        if self.turn != Quat::IDENTITY {
            placed.positions.iter_mut().for_each(|p| *p = self.turn * *p);
            placed.normals.iter_mut().for_each(|n| *n = (self.turn * *n).normalize_or(*n));
        }
        if self.origin != Vec3::ZERO || self.scale != 1.0 {
            placed.positions.iter_mut().for_each(|p| *p = (*p - self.origin) * self.scale);
        }
        placed
    }
}

/// The shortest rotation that brings one direction to another; exactly none if they are the same.
fn between(from: Vec3, to: Vec3) -> Quat {
    if from.distance(to) < 1e-6 { Quat::IDENTITY } else { Quat::from_rotation_arc(from, to) }
}

/// The box of the turned mesh.
fn bounds(mesh: &Mesh, turn: Quat) -> (Vec3, Vec3) {
    let used = mesh.triangles.iter().flatten().map(|&vertex| turn * mesh.positions[vertex as usize]);
    let none = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) = used.fold(none, |(low, high), p| (low.min(p), high.max(p)));
    if low.x <= high.x { (low, high) } else { (Vec3::ZERO, Vec3::ZERO) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::box_mesh;

    fn pass() -> ExportPass {
        ExportPass::default()
    }

    #[test]
    fn the_data_stay_as_they_are_unless_something_is_said() {
        let mesh = box_mesh(Vec3::new(3.0, 4.0, 5.0), Vec3::new(1.0, 2.0, 4.0)).unwrap();
        for (up, axis) in [(Vec3::Y, UpAxis::Y), (Vec3::Z, UpAxis::Z), (-Vec3::Z, UpAxis::Z)] {
            let placement = ExportTransform::new(up, &pass(), &mesh);
            assert_eq!((placement.placed(&mesh), placement.up), (mesh.clone(), axis));
        }
    }

    #[test]
    fn up_center_and_size_are_as_asked() {
        let mesh = box_mesh(Vec3::new(3.0, 4.0, 5.0), Vec3::new(1.0, 2.0, 4.0)).unwrap();
        let asked = ExportPass { up: ExportUp::Y, center: true, scale: ExportScale::Size(2.0), ..pass() };
        let placement = ExportTransform::new(Vec3::Z * 3.0, &asked, &mesh);
        let placed = placement.placed(&mesh);
        let (low, high) = placed.bounds().unwrap();
        // What was up, 4 long, is y now and 2 long; x keeps its direction.
        assert!(low.distance(Vec3::new(-0.25, -1.0, -0.5)) < 1e-5, "{low} {high}");
        assert!(high.distance(Vec3::new(0.25, 1.0, 0.5)) < 1e-5, "{low} {high}");
        let top = mesh.normals.iter().position(|n| *n == Vec3::Z).unwrap();
        assert!(placed.normals[top].distance(Vec3::Y) < 1e-6);
        // Handedness is kept: the outer side stays outside.
        for triangle in 0..placed.triangles.len() {
            let [a, b, c] = placed.corners(triangle);
            let normal = placed.normals[placed.triangles[triangle][0] as usize];
            assert!((b - a).cross(c - a).dot(normal) > 0.0);
        }
        let factor = ExportPass { up: ExportUp::Z, scale: ExportScale::Factor(10.0), ..pass() };
        let (low, high) = ExportTransform::new(-Vec3::Y, &factor, &mesh).placed(&mesh).bounds().unwrap();
        assert!((low.z + 50.0).abs() < 1e-3 && (high.z + 30.0).abs() < 1e-3, "{low} {high}");
    }
}
