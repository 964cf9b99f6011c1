//! Tangents along texture coordinates, and normals relative to them, as glTF 2.0 has them (specification, section 3.7.2.1).
//!
//! The frame of a point is (t, b, n): n the interpolated normal, t the interpolated tangent toward growing u, b = w (n × t), which points
//! toward falling v, the top of the picture. A normal map holds normals in that frame, whose z is along n.

use crate::mesh::atlas::TexelAtlas;
use crate::mesh::triangles::Mesh;
use glam::{Mat3, Vec3, Vec4};

/// Determinant of a frame below which it is none; where the texture is mirrored it is negative.
const FLAT: f32 = 1e-3;

/// The tangent of each vertex: a unit vector across the normal toward growing u, and w = ±1. Along any direction across the normal where the
/// texture coordinates tell none, or there are none.
pub fn vertex_tangents(mesh: &Mesh) -> Vec<Vec4> {
    let mut along_u = vec![Vec3::ZERO; mesh.positions.len()];
    let mut along_v = along_u.clone();
    for triangle in mesh.uvs.iter().flat_map(|_| &mesh.triangles) {
        let [of_u, of_v] = directions(mesh, triangle);
        for vertex in triangle.map(|vertex| vertex as usize) {
            along_u[vertex] += of_u;
            along_v[vertex] += of_v;
        }
    }
    let tangent = |((normal, u), v): ((&Vec3, &Vec3), &Vec3)| {
        let across = (*u - *normal * normal.dot(*u)).try_normalize();
        let tangent = across.unwrap_or_else(|| normal.any_orthonormal_vector());
        let w = if normal.cross(tangent).dot(*v) > 0.0 { -1.0 } else { 1.0 };
        tangent.extend(w)
    };
    mesh.normals.iter().zip(&along_u).zip(&along_v).map(tangent).collect()
}

/// The directions of growing u and v in a triangle, times its area in the texture and in space.
fn directions(mesh: &Mesh, triangle: &[u32; 3]) -> [Vec3; 2] {
    let Some(uvs) = &mesh.uvs else { return [Vec3::ZERO; 2] };
    let [a, b, c] = triangle.map(|vertex| vertex as usize);
    let [first, second] = [b, c].map(|at| mesh.positions[at] - mesh.positions[a]);
    let [in_first, in_second] = [b, c].map(|at| uvs[at] - uvs[a]);
    let sign = in_first.perp_dot(in_second).signum();
    let weight = sign * first.cross(second).length();
    let of_u = (first * in_second.y - second * in_first.y).normalize_or_zero();
    let of_v = (second * in_first.x - first * in_second.x).normalize_or_zero();
    [of_u * weight, of_v * weight]
}

/// The frame of each texel of the mesh's `atlas`, from the object's axes: its columns are t, b and n.
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

/// Normals in these frames, unit vectors; (0, 0, 1) where there is no frame or the normal is on its other side.
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
    use glam::Vec2;

    #[test]
    fn tangents_point_along_the_texture() {
        let mesh = unwrap_mesh(&sphere_mesh(Vec3::ZERO, 1.0).unwrap(), 64).unwrap().mesh;
        let tangents = vertex_tangents(&mesh);
        for triangle in &mesh.triangles {
            let [of_u, of_v] = directions(&mesh, triangle);
            for vertex in triangle.map(|vertex| vertex as usize) {
                let (normal, tangent) = (mesh.normals[vertex], tangents[vertex]);
                let bitangent = normal.cross(tangent.truncate()) * tangent.w;
                assert!(normal.dot(tangent.truncate()).abs() < 1e-5);
                assert!(tangent.truncate().dot(of_u) >= 0.0 && bitangent.dot(of_v) <= 1e-6, "{vertex}");
            }
        }
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
        let bent: Vec<Vec3> = atlas
            .normal
            .iter()
            .map(|normal| (*normal + Vec3::new(0.3, 0.2, -0.1)).normalize_or_zero())
            .collect();
        let relative = relative_normals(&frames, &bent);
        for row in (0..bent.len()).filter(|row| atlas.covered[*row]) {
            assert!((frames[row] * relative[row]).distance(bent[row]) < 1e-5);
        }
        assert_eq!(relative_normals(&[Mat3::ZERO, frames[0]], &[Vec3::X, Vec3::ZERO]), [Vec3::Z; 2]);
    }
}
