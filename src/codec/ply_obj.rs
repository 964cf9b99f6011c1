//! Writing a mesh as PLY and as Wavefront OBJ, for programs that read no glTF.
//!
//! Both keep the coordinates of the data and write numbers without loss.

use crate::codec::finite::check_finite;
use crate::mesh::triangles::Mesh;
use crate::{Error, Result};
use glam::{Vec2, Vec3};
use std::collections::HashMap;
use std::fmt::Write;
use std::path::Path;

/// Writes a binary little-endian PLY with normals and one sRGB color per vertex.
///
/// Vertices that differ only in their texture coordinates, which a PLY does not have, are merged, so that a closed mesh
/// is closed in the file; the merged vertex has the color of the first.
///
/// # Errors
/// [`Error::Run`] if there is not one color for each vertex, or a vertex is not finite; [`Error::Io`] if the file cannot be written.
pub fn write_ply(path: &Path, mesh: &Mesh, colors: &[[u8; 3]]) -> Result<()> {
    if colors.len() != mesh.positions.len() || mesh.normals.len() != mesh.positions.len() {
        let problem = format!(
            "{} vertices, {} normals, {} colors",
            mesh.positions.len(),
            mesh.normals.len(),
            colors.len()
        );
        return Err(Error::run(format!("writing {}", path.display()), problem));
    }
    check_vertices(path, mesh)?;
    let (kept, index) = joined_vertices(mesh);
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        kept.len(),
        mesh.triangles.len()
    );
    let mut bytes = header.into_bytes();
    for &vertex in &kept {
        for number in mesh.positions[vertex].to_array().into_iter().chain(mesh.normals[vertex].to_array()) {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(colors[vertex]);
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        bytes.extend(triangle.iter().flat_map(|&vertex| index[vertex as usize].to_le_bytes()));
    }
    crate::codec::file::write_bytes(path, &bytes)
}

fn check_vertices(path: &Path, mesh: &Mesh) -> Result<()> {
    let vectors = mesh.positions.iter().chain(&mesh.normals).flat_map(Vec3::to_array);
    let values = vectors.chain(mesh.uvs.iter().flatten().flat_map(Vec2::to_array));
    check_finite(path, values, |_| "a position, normal or texture coordinate is not finite".to_owned())
}

/// The first vertex of each position and normal, and for every vertex the number of its first.
fn joined_vertices(mesh: &Mesh) -> (Vec<usize>, Vec<u32>) {
    let (mut kept, mut number_of) = (Vec::new(), HashMap::new());
    let mut number = |vertex: usize| {
        // −0 and 0 are the same position.
        let bits = |v: Vec3| (v + Vec3::ZERO).to_array().map(f32::to_bits);
        *number_of.entry((bits(mesh.positions[vertex]), bits(mesh.normals[vertex]))).or_insert_with(|| {
            kept.push(vertex);
            kept.len() as u32 - 1
        })
    };
    let index = (0..mesh.positions.len()).map(&mut number).collect();
    (kept, index)
}

/// A material for [`write_obj`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjMaterial<'a> {
    /// A PNG file's bytes (sRGB): the diffuse albedo.
    pub albedo_png: &'a [u8],
    /// Reflectance at normal incidence, linear RGB.
    pub specular: Vec3,
    /// The paper's roughness R.
    pub roughness: f32,
}

/// Writes `path` (`mesh.obj`), and `mesh.mtl` and `mesh_albedo.png` in the same folder.
///
/// The material is `Kd` 1 with the texture, `Ks` the specular albedo, and `Ns` the exponent whose Blinn–Phong lobe is as wide as R:
/// 2/R⁴ − 2, at most 1000; `Pr` is R, for programs that support it.
///
/// # Errors
/// [`Error::Run`] for a mesh without texture coordinates, or a number that is not finite; [`Error::Io`] if a file cannot be written.
pub fn write_obj(path: &Path, mesh: &Mesh, material: &ObjMaterial) -> Result<()> {
    let Some(uvs) = &mesh.uvs else {
        let context = format!("writing {}", path.display());
        return Err(Error::run(context, "the mesh has no texture coordinates"));
    };
    check_vertices(path, mesh)?;
    let material_values = material.specular.to_array().into_iter().chain([material.roughness]);
    check_finite(path, material_values, |_| "the specular material is not finite".to_owned())?;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let mut text = format!("mtllib {stem}.mtl\no surface\nusemtl surface\n");
    // Writing to a `String` cannot fail.
    for p in &mesh.positions {
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
    }
    for uv in uvs {
        // In an OBJ, v points up.
        let _ = writeln!(text, "vt {} {}", uv.x, 1.0 - uv.y);
    }
    for n in &mesh.normals {
        let _ = writeln!(text, "vn {} {} {}", n.x, n.y, n.z);
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| vertex + 1);
        let _ = writeln!(text, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}");
    }
    crate::codec::file::write_bytes(path, text.as_bytes())?;
    crate::codec::file::write_bytes(&path.with_file_name(format!("{stem}_albedo.png")), material.albedo_png)?;
    crate::codec::file::write_bytes(&path.with_extension("mtl"), mtl(material, &stem).as_bytes())
}

fn mtl(material: &ObjMaterial, stem: &str) -> String {
    let [r, g, b] = material.specular.to_array();
    let roughness = material.roughness;
    let exponent = (2.0 / roughness.powi(4) - 2.0).clamp(0.0, 1000.0);
    format!(
        "newmtl surface\nKd 1 1 1\nmap_Kd {stem}_albedo.png\nKs {r} {g} {b}\nNs {exponent}\nPr {roughness}\nPm 0\nillum 2\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::{box_mesh, sphere_mesh};

    #[test]
    fn a_ply_has_what_its_header_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.ply");
        let mesh = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        let colors: Vec<[u8; 3]> = (0..mesh.positions.len()).map(|i| [i as u8, 7, 9]).collect();
        write_ply(&path, &mesh, &colors).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        assert!(header.contains("element vertex 24\n") && header.contains("element face 12\n"), "{header}");
        assert_eq!(bytes.len() - end, 24 * 27 + 12 * 13);
        let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        for (i, (p, n)) in mesh.positions.iter().zip(&mesh.normals).enumerate() {
            let at = end + i * 27;
            assert_eq!([float(at), float(at + 4), float(at + 8)], p.to_array());
            assert_eq!([float(at + 12), float(at + 16), float(at + 20)], n.to_array());
            assert_eq!(bytes[at + 24..at + 27], colors[i]);
        }
        let face = end + 24 * 27 + 13;
        let corner = |k: usize| u32::from_le_bytes(bytes[face + 1 + 4 * k..][..4].try_into().unwrap());
        assert_eq!((bytes[face], [corner(0), corner(1), corner(2)]), (3, mesh.triangles[1]));
        assert!(matches!(write_ply(&path, &mesh, &colors[1..]), Err(Error::Run { .. })));
        let mut broken = mesh.clone();
        broken.normals[2].z = f32::NAN;
        assert!(write_ply(&path, &broken, &colors).unwrap_err().to_string().contains("not finite"));
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }

    #[test]
    fn seams_are_closed_in_a_ply() {
        let mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
        let (kept, index) = joined_vertices(&mesh);
        // One vertex per pole, and no column twice.
        assert_eq!(kept.len(), 95 * 192 + 2);
        for (vertex, &number) in index.iter().enumerate() {
            assert_eq!(mesh.positions[kept[number as usize]], mesh.positions[vertex]);
        }
    }

    #[test]
    fn an_obj_names_its_material_and_numbers_from_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.obj");
        let mesh = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        let material = ObjMaterial { albedo_png: b"png", specular: Vec3::new(0.3, 0.2, 0.1), roughness: 0.5 };
        write_obj(&path, &mesh, &material).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let numbers = |word: &str| -> Vec<Vec<f32>> {
            let lines = text.lines().filter_map(|line| line.strip_prefix(word)?.strip_prefix(' '));
            lines.map(|line| line.split(' ').map(|n| n.parse().unwrap()).collect()).collect()
        };
        assert_eq!(numbers("v"), mesh.positions.iter().map(|p| p.to_array().to_vec()).collect::<Vec<_>>());
        assert_eq!(numbers("vn").len(), 24);
        let uv = mesh.uvs.as_ref().unwrap()[5];
        assert_eq!(numbers("vt")[5], [uv.x, 1.0 - uv.y]);
        let [a, b, c] = mesh.triangles[3].map(|v| v + 1);
        let face = format!("f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}");
        assert_eq!(text.lines().filter(|line| line.starts_with("f ")).nth(3), Some(face.as_str()));
        assert!(text.starts_with("mtllib mesh.mtl\n") && text.contains("\nusemtl surface\n"));
        let mtl = std::fs::read_to_string(folder.path().join("mesh.mtl")).unwrap();
        for line in ["newmtl surface", "map_Kd mesh_albedo.png", "Ks 0.3 0.2 0.1", "Ns 30", "Pr 0.5"] {
            assert!(mtl.lines().any(|l| l == line), "{line} in {mtl}");
        }
        assert_eq!(std::fs::read(folder.path().join("mesh_albedo.png")).unwrap(), b"png");
        let infinite = ObjMaterial { roughness: f32::INFINITY, ..material };
        assert!(write_obj(&path, &mesh, &infinite).unwrap_err().to_string().contains("not finite"));
        let bare = Mesh { uvs: None, ..mesh };
        assert!(matches!(write_obj(&path, &bare, &material), Err(Error::Run { .. })));
    }
}
