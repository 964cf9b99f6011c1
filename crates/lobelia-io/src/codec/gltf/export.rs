//! Writing a mesh as binary glTF 2.0. Its floats keep all their bits, and a material has its
//! textures inside the file.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::primitive::box_mesh;
//! use lobelia_io::codec::gltf::export::write_glb;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("box.glb");
//! write_glb(&path, &box_mesh(Vec3::ZERO, Vec3::ONE)?, None)?;
//! assert!(std::fs::read(&path)?.starts_with(b"glTF"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::codec::file::{check_finite, not_written, write_bytes};
use crate::codec::gltf::material::GltfMaterial;
use glam::{Vec2, Vec3};
use lobelia_geometry::{Result, mesh::tangents::vertex_tangents, mesh::triangles::Mesh};
use serde_json::{Value, json};
use std::path::Path;

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Writes `mesh` to `path` as a GLB with one node, one mesh and one primitive; floats keep all
/// their bits.
///
/// The file is created only when it is complete.
///
/// # Errors
/// [`Error::Run`](lobelia_geometry::Error::Run) if the mesh is empty or not finite, or the file
/// would exceed 4 GiB; [`Error::Io`](lobelia_geometry::Error::Io) if the file cannot be written.
pub fn write_glb(path: &Path, mesh: &Mesh, material: Option<&GltfMaterial>) -> Result<()> {
    check_mesh(path, mesh, material.into_iter().flat_map(GltfMaterial::values))?;
    let mut binary = Binary::default();
    let has_map = material.is_some_and(|material| material.normal_image.is_some());
    let primitive = primitive(&mut binary, mesh, has_map);
    let mut root = json!({
        "asset": {"version": "2.0", "generator": concat!("lobelia ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "surface"}],
        "meshes": [{"name": "surface", "primitives": [primitive]}],
    });
    if let Some(material) = material {
        root["meshes"][0]["primitives"][0]["material"] = json!(0);
        add_material(&mut root, &mut binary, material);
    }
    root["accessors"] = Value::Array(binary.accessors);
    root["bufferViews"] = Value::Array(binary.views);
    root["buffers"] = json!([{"byteLength": binary.bytes.len()}]);
    let container = container(&root.to_string(), &binary.bytes)
        .ok_or_else(|| not_written(path, "a GLB cannot hold more than 4 GiB"))?;
    write_bytes(path, &container)
}

/// Checks that a mesh that is to be written has triangles, and that it and the values of its
/// material are finite.
///
/// # Errors
/// [`Error::Run`](lobelia_geometry::Error::Run).
pub(crate) fn check_mesh(path: &Path, mesh: &Mesh, material: impl Iterator<Item = f32>) -> Result<()> {
    if mesh.triangles.is_empty() {
        return Err(not_written(path, "the mesh has no triangles"));
    }
    let vectors = mesh.positions.iter().chain(&mesh.normals).flat_map(Vec3::to_array);
    let uvs = mesh.uvs.iter().flatten().flat_map(Vec2::to_array);
    let what = "a position, normal, texture coordinate or value of the material is not finite";
    check_finite(path, vectors.chain(uvs).chain(material), |_| what.to_owned())
}

/// The binary chunk and its buffer views and accessors, under construction.
#[derive(Default)]
struct Binary {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Binary {
    /// Appends a buffer view, aligned to 4 bytes, and returns its index.
    fn add_view(&mut self, bytes: impl Iterator<Item = u8>, target: Option<u32>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        let mut view = json!({"buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start});
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.views.push(view);
        self.views.len() - 1
    }

    /// Appends an accessor of float vectors (with its range, if `with_range`) and returns its
    /// index.
    fn add_floats<const N: usize>(
        &mut self,
        values: impl Iterator<Item = [f32; N]>,
        with_range: bool,
    ) -> usize {
        let values: Vec<[f32; N]> = values.collect();
        let view = self.add_view(values.iter().flatten().flat_map(|x| x.to_le_bytes()), Some(ARRAY_BUFFER));
        let kind = format!("VEC{N}");
        let mut accessor =
            json!({"bufferView": view, "componentType": FLOAT, "count": values.len(), "type": kind});
        if with_range {
            let fold = |pick: fn(f32, f32) -> f32, start: f32| -> Vec<f32> {
                (0..N).map(|k| values.iter().fold(start, |so_far, v| pick(so_far, v[k]))).collect()
            };
            accessor["min"] = json!(fold(f32::min, f32::INFINITY));
            accessor["max"] = json!(fold(f32::max, f32::NEG_INFINITY));
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}

/// The attributes and indices of a mesh; with tangents for a normal map.
fn primitive(binary: &mut Binary, mesh: &Mesh, with_tangents: bool) -> Value {
    let mut attributes = json!({
        "POSITION": binary.add_floats(mesh.positions.iter().map(|p| p.to_array()), true),
        "NORMAL": binary.add_floats(mesh.normals.iter().map(|n| n.to_array()), false),
    });
    if let Some(uvs) = &mesh.uvs {
        attributes["TEXCOORD_0"] = json!(binary.add_floats(uvs.iter().map(|uv| uv.to_array()), false));
    }
    if with_tangents {
        let tangents = vertex_tangents(mesh);
        attributes["TANGENT"] = json!(binary.add_floats(tangents.iter().map(|t| t.to_array()), false));
    }
    let indices = mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes());
    let (view, count) = (binary.add_view(indices, Some(ELEMENT_ARRAY_BUFFER)), 3 * mesh.triangles.len());
    let indices =
        json!({"bufferView": view, "componentType": UNSIGNED_INT, "count": count, "type": "SCALAR"});
    binary.accessors.push(indices);
    json!({"attributes": attributes, "indices": binary.accessors.len() - 1, "mode": 4})
}

fn add_material(root: &mut Value, binary: &mut Binary, material: &GltfMaterial) {
    let [r, g, b] = material.base_color.to_array();
    let mut metallic_roughness = json!({
        "baseColorFactor": [r, g, b, 1.0],
        "metallicFactor": 0.0,
        "roughnessFactor": material.roughness,
    });
    let mut specular = json!({
        "specularFactor": material.specular,
        "specularColorFactor": material.specular_color.to_array(),
    });
    let mut images = Vec::new();
    let mut texture = |png: &Vec<u8>| {
        let view = binary.add_view(png.iter().copied(), None);
        images.push(json!({"bufferView": view, "mimeType": "image/png"}));
        json!({"index": images.len() - 1})
    };
    if let Some(png) = &material.base_color_image {
        metallic_roughness["baseColorTexture"] = texture(png);
    }
    if let Some(png) = &material.roughness_image {
        metallic_roughness["metallicRoughnessTexture"] = texture(png);
    }
    if let Some(png) = &material.specular_image {
        specular["specularColorTexture"] = texture(png);
        specular["specularTexture"] = specular["specularColorTexture"].clone();
    }
    let normals = material.normal_image.as_ref().map(texture);
    if !images.is_empty() {
        // Linear filtering, clamped at the borders, as for texels in this crate.
        root["samplers"] = json!([{"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}]);
        let textures = (0..images.len()).map(|source| json!({"source": source, "sampler": 0})).collect();
        root["images"] = Value::Array(images);
        root["textures"] = textures;
    }
    root["materials"] = json!([{
        "name": material.name,
        "pbrMetallicRoughness": metallic_roughness,
        "extensions": {"KHR_materials_specular": specular, "KHR_materials_ior": {"ior": material.ior}},
    }]);
    if let Some(normals) = normals {
        root["materials"][0]["normalTexture"] = normals;
    }
    root["extensionsUsed"] = json!(["KHR_materials_specular", "KHR_materials_ior"]);
}

/// Header, JSON chunk and binary chunk (glTF 2.0 specification, section 4); `None` above 4 GiB.
fn container(text: &str, binary: &[u8]) -> Option<Vec<u8>> {
    let (text_length, binary_length) = (text.len().next_multiple_of(4), binary.len().next_multiple_of(4));
    let total = 12 + 8 + text_length + 8 + binary_length;
    let mut out = Vec::with_capacity(total);
    out.extend(b"glTF");
    out.extend(2u32.to_le_bytes());
    out.extend(u32::try_from(total).ok()?.to_le_bytes());
    out.extend((text_length as u32).to_le_bytes());
    out.extend(b"JSON");
    out.extend(text.as_bytes());
    out.resize(20 + text_length, b' ');
    out.extend((binary_length as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(binary);
    out.resize(total, 0);
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::gltf::import::{MeshReport, read_mesh_with_report};
    use crate::codec::{image::encode_png, test_data::temporary};
    use gltf_json::validation::Validate;
    use image::ExtendedColorType;
    use lobelia_geometry::{Error, mesh::primitive::box_mesh, mesh::primitive::sphere_mesh};

    #[test]
    fn a_written_mesh_comes_back_bit_for_bit() {
        let (folder, path) = temporary("mesh.glb");
        for mesh in [
            sphere_mesh(Vec3::new(0.1, -0.7, 1e-3), 0.777).unwrap(),
            box_mesh(Vec3::splat(-0.3), Vec3::new(1.0 / 3.0, 2e-5, 7.0)).unwrap(),
            Mesh { uvs: None, ..sphere_mesh(Vec3::ZERO, 1e4).unwrap() },
        ] {
            write_glb(&path, &mesh, None).unwrap();
            let (read, report) = read_mesh_with_report(&path).unwrap();
            assert_eq!(read, mesh);
            assert_eq!(report, MeshReport { primitives: 1, ..MeshReport::default() });
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file was left behind");
    }

    #[test]
    fn the_document_is_valid_and_has_the_material() {
        let (_folder, path) = temporary("mesh.glb");
        let png = encode_png(&[10, 200, 30].repeat(6), [3, 2], ExtendedColorType::Rgb8).unwrap();
        let material = GltfMaterial {
            base_color: Vec3::new(0.1, 0.2, 0.3),
            base_color_image: Some(png.clone()),
            normal_image: Some(png),
            roughness: 0.3,
            specular: 0.5,
            specular_color: Vec3::new(1.0, 0.5, 0.25),
            ior: 2.0,
            ..GltfMaterial::default()
        };
        write_glb(&path, &box_mesh(Vec3::ZERO, Vec3::ONE).unwrap(), Some(&material)).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let document = gltf_json::Root::from_slice(&bytes[20..20 + length]).unwrap();
        let mut wrong = Vec::new();
        document.validate(&document, gltf_json::Path::new, &mut |path, error| wrong.push((path(), error)));
        assert!(wrong.is_empty(), "{wrong:?}");
        let root: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        let found = &root["materials"][0];
        assert_eq!(root["images"].as_array().unwrap().len(), 2);
        assert_eq!(found["normalTexture"]["index"], json!(1));
        let tangents = root["meshes"][0]["primitives"][0]["attributes"]["TANGENT"].as_u64().unwrap();
        assert_eq!(root["accessors"][tangents as usize]["count"], json!(24));
        let pbr = &found["pbrMetallicRoughness"];
        let color: Vec<f32> = serde_json::from_value(pbr["baseColorFactor"].clone()).unwrap();
        assert_eq!((color, &pbr["metallicFactor"]), (vec![0.1, 0.2, 0.3, 1.0], &json!(0.0)));
        let extensions = &found["extensions"];
        assert_eq!(extensions["KHR_materials_specular"]["specularFactor"], json!(0.5));
        assert_eq!(extensions["KHR_materials_specular"]["specularColorFactor"], json!([1.0, 0.5, 0.25]));
        assert_eq!(extensions["KHR_materials_ior"]["ior"], json!(2.0));
        assert_eq!(root["accessors"][0]["min"], json!([-0.5, -0.5, -0.5]));
    }

    #[test]
    fn what_cannot_be_written_is_refused_and_leaves_nothing() {
        let (folder, path) = temporary("mesh.glb");
        let good = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        let mut not_finite = good.clone();
        not_finite.positions[3].y = f32::NAN;
        let infinite = GltfMaterial { ior: f32::INFINITY, ..GltfMaterial::default() };
        for (mesh, material) in [(&Mesh::default(), None), (&not_finite, None), (&good, Some(&infinite))] {
            assert!(matches!(write_glb(&path, mesh, material), Err(Error::Run { .. })));
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(matches!(write_glb(&file.join("mesh.glb"), &good, None), Err(Error::Io { .. })));
    }
}
