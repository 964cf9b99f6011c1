//! Writing a mesh as binary glTF 2.0.

use crate::codec::gltf::material::GltfMaterial;
use crate::mesh::tangents::vertex_tangents;
use crate::mesh::triangles::Mesh;
use crate::{Error, Result};
use serde_json::{Value, json};
use std::path::Path;

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Writes `mesh` to `path` as a GLB with one node, one mesh and one primitive; floats keep all their bits.
///
/// The file is created only when it is complete.
///
/// # Errors
/// [`Error::Run`] if the arrays of the mesh have different lengths, it is empty or not finite, a texture has no texture coordinates, or the file would
/// exceed 4 GiB; [`Error::Io`] if the file cannot be written.
pub fn write_glb(path: &Path, mesh: &Mesh, material: Option<&GltfMaterial>) -> Result<()> {
    check(mesh, material).map_err(|problem| Error::run(format!("writing {}", path.display()), problem))?;
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
    let too_large = || Error::run(format!("writing {}", path.display()), "a GLB cannot hold more than 4 GiB");
    let container = container(&root.to_string(), &binary.bytes).ok_or_else(too_large)?;
    crate::codec::file::write_bytes(path, &container)
}

fn check(mesh: &Mesh, material: Option<&GltfMaterial>) -> std::result::Result<(), String> {
    let count = mesh.positions.len();
    let uv_count = mesh.uvs.as_ref().map_or(count, Vec::len);
    if mesh.normals.len() != count || uv_count != count {
        let normals = mesh.normals.len();
        return Err(format!(
            "the mesh has {count} positions, {normals} normals and {uv_count} texture coordinates; these must be equal"
        ));
    }
    if mesh.triangles.is_empty() {
        return Err("the mesh has no triangles".to_owned());
    }
    if mesh.triangles.iter().flatten().any(|&vertex| vertex as usize >= count) {
        return Err("a triangle refers to a vertex that does not exist".to_owned());
    }
    let finite_uvs = mesh.uvs.iter().flatten().all(|uv| uv.is_finite());
    if !finite_uvs || mesh.positions.iter().chain(&mesh.normals).any(|v| !v.is_finite()) {
        return Err("a position, normal or texture coordinate is not finite".to_owned());
    }
    let Some(material) = material else { return Ok(()) };
    let images = [
        &material.base_color_image,
        &material.roughness_image,
        &material.specular_image,
        &material.normal_image,
    ];
    if images.iter().any(|image| image.is_some()) && mesh.uvs.is_none() {
        return Err("a texture needs texture coordinates".to_owned());
    }
    let scalars = [material.roughness, material.specular, material.ior];
    let finite = scalars.iter().all(|x| x.is_finite());
    if !(finite && material.base_color.is_finite() && material.specular_color.is_finite()) {
        return Err("a material parameter is not finite".to_owned());
    }
    Ok(())
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

    /// Appends an accessor of float vectors (with its range, if `with_range`) and returns its index.
    fn add_floats<const N: usize>(&mut self, values: &[[f32; N]], with_range: bool) -> usize {
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
    let positions: Vec<_> = mesh.positions.iter().map(|p| p.to_array()).collect();
    let normals: Vec<_> = mesh.normals.iter().map(|n| n.to_array()).collect();
    let mut attributes = json!({
        "POSITION": binary.add_floats(&positions, true),
        "NORMAL": binary.add_floats(&normals, false),
    });
    if let Some(uvs) = &mesh.uvs {
        let uvs: Vec<_> = uvs.iter().map(|uv| uv.to_array()).collect();
        attributes["TEXCOORD_0"] = json!(binary.add_floats(&uvs, false));
    }
    if with_tangents {
        let tangents: Vec<_> = vertex_tangents(mesh).iter().map(|tangent| tangent.to_array()).collect();
        attributes["TANGENT"] = json!(binary.add_floats(&tangents, false));
    }
    let indices = mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes());
    let view = binary.add_view(indices, Some(ELEMENT_ARRAY_BUFFER));
    let count = 3 * mesh.triangles.len();
    binary
        .accessors
        .push(json!({"bufferView": view, "componentType": UNSIGNED_INT, "count": count, "type": "SCALAR"}));
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
    if let Some(png) = &material.base_color_image {
        metallic_roughness["baseColorTexture"] = texture(binary, &mut images, png);
    }
    if let Some(png) = &material.roughness_image {
        metallic_roughness["metallicRoughnessTexture"] = texture(binary, &mut images, png);
    }
    if let Some(png) = &material.specular_image {
        specular["specularColorTexture"] = texture(binary, &mut images, png);
        specular["specularTexture"] = specular["specularColorTexture"].clone();
    }
    let normals = material.normal_image.as_ref().map(|png| texture(binary, &mut images, png));
    add_textures(root, &images);
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

/// Appends an image to the binary chunk, and the index of its buffer view to `images`. Returns what names its texture in a material.
fn texture(binary: &mut Binary, images: &mut Vec<usize>, png: &[u8]) -> Value {
    images.push(binary.add_view(png.iter().copied(), None));
    json!({"index": images.len() - 1})
}

/// Adds a texture for each image, given by the index of its buffer view.
fn add_textures(root: &mut Value, images: &[usize]) {
    if images.is_empty() {
        return;
    }
    // Linear filtering, clamped at the borders, as for texels in this crate.
    root["samplers"] = json!([{"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}]);
    let image = |view: &usize| json!({"bufferView": view, "mimeType": "image/png"});
    root["images"] = images.iter().map(image).collect();
    root["textures"] = (0..images.len()).map(|source| json!({"source": source, "sampler": 0})).collect();
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
    use crate::mesh::primitive::{box_mesh, sphere_mesh};
    use glam::Vec3;

    #[test]
    fn a_written_mesh_comes_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.glb");
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
    fn another_reader_accepts_the_file_and_its_material() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.glb");
        let mut png = Vec::new();
        let pixels = image::RgbImage::from_pixel(3, 2, image::Rgb([10, 200, 30]));
        pixels.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
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
        // The crate's own importer validates the whole document.
        let (document, _, images) = gltf::import(&path).unwrap();
        assert_eq!((images[0].width, images[0].height, images.len()), (3, 2, 2));
        assert_eq!(document.materials().next().unwrap().normal_texture().unwrap().texture().index(), 1);
        let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
        assert_eq!(primitive.get(&gltf::Semantic::Tangents).unwrap().count(), 24);
        assert_eq!(images[0].pixels[..3], [10, 200, 30]);
        let pbr = document.materials().next().unwrap().pbr_metallic_roughness();
        assert_eq!(pbr.base_color_factor(), [0.1, 0.2, 0.3, 1.0]);
        assert_eq!((pbr.roughness_factor(), pbr.metallic_factor()), (0.3, 0.0));
        let bytes = std::fs::read(&path).unwrap();
        let text = gltf::Glb::from_slice(&bytes).unwrap().json.into_owned();
        let root: Value = serde_json::from_slice(&text).unwrap();
        let extensions = &root["materials"][0]["extensions"];
        assert_eq!(extensions["KHR_materials_specular"]["specularFactor"], json!(0.5));
        assert_eq!(extensions["KHR_materials_specular"]["specularColorFactor"], json!([1.0, 0.5, 0.25]));
        assert_eq!(extensions["KHR_materials_ior"]["ior"], json!(2.0));
        assert_eq!(root["accessors"][0]["min"], json!([-0.5, -0.5, -0.5]));
    }

    #[test]
    fn what_cannot_be_written_is_refused_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.glb");
        let good = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        let textured = GltfMaterial { base_color_image: Some(vec![0]), ..GltfMaterial::default() };
        let mut out_of_range = good.clone();
        out_of_range.triangles[0][0] = 1000;
        let mut not_finite = good.clone();
        not_finite.positions[3].y = f32::NAN;
        let no_normals = Mesh { normals: Vec::new(), ..good.clone() };
        let no_uvs = Mesh { uvs: None, ..good.clone() };
        for (mesh, material) in [
            (&Mesh::default(), None),
            (&out_of_range, None),
            (&not_finite, None),
            (&no_normals, None),
            (&no_uvs, Some(&textured)),
        ] {
            assert!(matches!(write_glb(&path, mesh, material), Err(Error::Run { .. })));
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(matches!(write_glb(&file.join("mesh.glb"), &good, None), Err(Error::Io { .. })));
    }
}
