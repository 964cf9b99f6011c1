//! Tangents along texture coordinates, and normals relative to them, as glTF 2.0 has them
//! (specification, section 3.7.2.1): the frames of MikkTSpace, which other programs rebuild where a
//! file has no tangents.
//!
//! The frame of a point is (t, b, n): n the interpolated normal, t the interpolated tangent toward
//! growing u, b = w (n × t), which points toward falling v, the top of the picture. A normal map
//! holds normals in that frame, whose z is along n.

use crate::{mesh::atlas::TexelAtlas, mesh::triangles::Mesh};
use bevy_mikktspace::{Geometry, TangentSpace, generate_tangents};
use glam::{Mat3, Vec2, Vec3, Vec4};

/// Determinant of a frame below which it is none; where the texture is mirrored it is negative.
const FLAT: f32 = 1e-3;

/// The corners of a mesh's triangles, and the tangents found for its vertices.
struct Corners<'a> {
    mesh: &'a Mesh,
    uvs: &'a [Vec2],
    tangents: Vec<Option<Vec4>>,
}

impl Corners<'_> {
    fn vertex(&self, face: usize, corner: usize) -> usize {
        self.mesh.triangles[face][corner] as usize
    }
}

impl Geometry for Corners<'_> {
    fn num_faces(&self) -> usize {
        self.mesh.triangles.len()
    }

    fn num_vertices_of_face(&self, _: usize) -> usize {
        3
    }

    fn position(&self, face: usize, corner: usize) -> [f32; 3] {
        self.mesh.positions[self.vertex(face, corner)].to_array()
    }

    fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
        self.mesh.normals[self.vertex(face, corner)].to_array()
    }

    fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
        self.uvs[self.vertex(face, corner)].to_array()
    }

    fn set_tangent(&mut self, found: Option<TangentSpace>, face: usize, corner: usize) {
        let vertex = self.vertex(face, corner);
        // In glTF, v grows downward, and b toward its top.
        let found = found.map(|space| {
            Vec3::from(space.tangent()).extend(if space.is_orientation_preserving() { -1.0 } else { 1.0 })
        });
        self.tangents[vertex] = self.tangents[vertex].or(found);
    }
}

/// The tangent of each vertex: a unit vector across the normal toward growing u, and w = ±1. Along
/// any direction across the normal where the texture coordinates tell none, or there are none.
pub fn vertex_tangents(mesh: &Mesh) -> Vec<Vec4> {
    let uvs = mesh.uvs.as_deref().unwrap_or_default();
    let mut corners = Corners { mesh, uvs, tangents: vec![None; mesh.positions.len()] };
    if !uvs.is_empty() {
        // There is no way for it to fail yet.
        let _ = generate_tangents(&mut corners);
    }
    let usable = |tangent: &Vec4| tangent.truncate().is_normalized();
    let any = |normal: &Vec3| normal.any_orthonormal_vector().extend(1.0);
    let tangents = corners.tangents.into_iter().zip(&mesh.normals);
    tangents.map(|(tangent, normal)| tangent.filter(usable).unwrap_or_else(|| any(normal))).collect()
}

/// The frame of each texel of the mesh's `atlas`, from the object's axes: its columns are t, b and
/// n.
pub fn texel_frames(mesh: &Mesh, tangents: &[Vec4], atlas: &TexelAtlas) -> Vec<Mat3> {
    let interpolated = |vectors: Vec<Vec3>| {
        TexelAtlas::new(&Mesh { normals: vectors, ..mesh.clone() }, atlas.width, atlas.height).normal
    };
    let bitangent = |(normal, tangent): (&Vec3, &Vec4)| normal.cross(tangent.truncate()) * tangent.w;
    let along = interpolated(tangents.iter().map(|tangent| tangent.truncate()).collect());
    let across = interpolated(mesh.normals.iter().zip(tangents).map(bitangent).collect());
    let frames = along.into_iter().zip(across).zip(&atlas.normal);
    frames.map(|((tangent, bitangent), normal)| Mat3::from_cols(tangent, bitangent, *normal)).collect()
}

/// Normals in these frames, unit vectors; (0, 0, 1) where there is no frame or the normal is on its
/// other side.
pub fn relative_normals(frames: &[Mat3], normals: &[Vec3]) -> Vec<Vec3> {
    let relative = |(frame, normal): (&Mat3, &Vec3)| {
        let is_frame = frame.determinant().abs() > FLAT && frame.z_axis.dot(*normal) > 0.0;
        let found = is_frame.then(|| (frame.inverse() * *normal).try_normalize()).flatten();
        found.filter(|found| found.z > 0.0).unwrap_or(Vec3::Z)
    };
    frames.iter().zip(normals).map(relative).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::atlas::unwrap_mesh;
    use crate::mesh::primitive::{box_mesh, sphere_mesh};

    #[test]
    fn tangents_point_along_the_texture() {
        let mesh = unwrap_mesh(&sphere_mesh(Vec3::ZERO, 1.0).unwrap(), 64).unwrap().mesh;
        let (tangents, uvs) = (vertex_tangents(&mesh), mesh.uvs.as_ref().unwrap());
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|vertex| vertex as usize);
            let [first, second] = [b, c].map(|at| mesh.positions[at] - mesh.positions[a]);
            let [in_first, in_second] = [b, c].map(|at| uvs[at] - uvs[a]);
            let sign = in_first.perp_dot(in_second).signum();
            let of_u = (first * in_second.y - second * in_first.y) * sign;
            let of_v = (second * in_first.x - first * in_second.x) * sign;
            for vertex in [a, b, c] {
                let (normal, tangent) = (mesh.normals[vertex], tangents[vertex]);
                let bitangent = normal.cross(tangent.truncate()) * tangent.w;
                assert!(normal.dot(tangent.truncate()).abs() < 1e-5);
                assert!(tangent.truncate().dot(of_u) >= 0.0 && bitangent.dot(of_v) <= 1e-6, "{vertex}");
            }
        }
    }

    /// The definition of MikkTSpace: a vertex has the mean of its triangles' directions, weighted
    /// by their angles there.
    #[test]
    fn tangents_of_a_vertex_are_weighted_by_angle() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Y - Vec3::X],
            normals: vec![Vec3::Z; 4],
            uvs: Some([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]].map(Vec2::from).to_vec()),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        // 90° along (1, 0), and 45° along (1, −1).
        let expected = (2.0 * Vec3::X + Vec3::new(1.0, -1.0, 0.0).normalize()).normalize();
        let tangents = vertex_tangents(&mesh);
        assert!(tangents[0].distance(expected.extend(-1.0)) < 1e-6, "{}", tangents[0]);
        assert!(tangents[1].distance(Vec4::new(1.0, 0.0, 0.0, -1.0)) < 1e-6, "{}", tangents[1]);
    }

    #[test]
    fn a_mirrored_texture_has_the_other_sign() {
        let square = |flip: f32| Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y],
            normals: vec![Vec3::Z; 3],
            uvs: Some([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]].map(|[u, v]| Vec2::new(u * flip, v)).to_vec()),
            triangles: vec![[0, 1, 2]],
        };
        // v grows along y: the top of the picture is toward −y.
        assert_eq!(vertex_tangents(&square(1.0))[0], Vec4::new(1.0, 0.0, 0.0, -1.0));
        assert_eq!(vertex_tangents(&square(-1.0))[0], Vec4::new(-1.0, 0.0, 0.0, 1.0));
        let none = Mesh { uvs: None, ..square(1.0) };
        assert!(vertex_tangents(&none).iter().all(|tangent| tangent.is_finite()));
    }

    #[test]
    fn a_normal_is_found_again_from_its_map() {
        let mesh = unwrap_mesh(&box_mesh(Vec3::ZERO, Vec3::ONE).unwrap(), 64).unwrap().mesh;
        let atlas = TexelAtlas::new(&mesh, 64, 64);
        let frames = texel_frames(&mesh, &vertex_tangents(&mesh), &atlas);
        let bend = |normal: &Vec3| (*normal + Vec3::new(0.3, 0.2, -0.1)).normalize_or_zero();
        let bent: Vec<Vec3> = atlas.normal.iter().map(bend).collect();
        let relative = relative_normals(&frames, &bent);
        for row in (0..bent.len()).filter(|row| atlas.covered[*row]) {
            assert!((frames[row] * relative[row]).distance(bent[row]) < 1e-5);
        }
        assert_eq!(relative_normals(&[Mat3::ZERO, frames[0]], &[Vec3::X, Vec3::ZERO]), [Vec3::Z; 2]);
    }
}
