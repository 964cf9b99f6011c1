//! Writing a mesh with its material as USD: text (`.usda`) with files beside it, or one package
//! (`.usdz`).
//!
//! The material is a `UsdPreviewSurface` in its specular workflow: F0 is given, F90 is one, and the
//! lobe is GGX with α = roughness².

use crate::codec::{file::not_written, file::write_bytes, gltf::export::check_mesh};
use glam::Vec3;
use lobelia_geometry::{Result, mesh::triangles::Mesh};
use std::{io::Cursor, io::Write as _, path::Path};
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

/// Where the parts of a package begin: at multiples of this.
const ALIGNMENT: u16 = 64;

/// A PNG file beside a USD file.
#[derive(Clone, Debug, PartialEq)]
pub struct UsdImage {
    /// Its file name.
    pub name: String,
    /// Its bytes.
    pub png: Vec<u8>,
}

/// A value of the material: one for all, or a texture.
#[derive(Clone, Debug, PartialEq)]
pub enum UsdInput<T> {
    /// The value.
    Value(T),
    /// A texture: sRGB for colors, linear gray for numbers.
    Texture(UsdImage),
}

/// A material for [`write_usda`] and [`write_usdz`].
#[derive(Clone, Debug, PartialEq)]
pub struct UsdMaterial {
    /// `diffuseColor`, sRGB.
    pub diffuse: UsdImage,
    /// `specularColor`: F0, linear RGB.
    pub specular: UsdInput<Vec3>,
    /// `roughness`.
    pub roughness: UsdInput<f32>,
}

/// The direction that a file says is up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpAxis {
    /// +Y.
    Y,
    /// +Z.
    Z,
}

/// Writes `path` (`.usda`) and the textures beside it. Of a `light` there are the file name of its
/// image, beside the USD file, and its rotation about +Y in degrees from USD's convention: the
/// middle of the image at +Z, the quarter from the left at +X.
///
/// # Errors
/// [`Error::Run`](lobelia_geometry::Error::Run) for a mesh without texture coordinates, or a number
/// that is not finite; [`Error::Io`](lobelia_geometry::Error::Io) if a file cannot be written.
pub fn write_usda(
    path: &Path,
    mesh: &Mesh,
    material: &UsdMaterial,
    up: UpAxis,
    light: Option<(&str, f32)>,
) -> Result<()> {
    let text = stage(path, mesh, material, up, light)?;
    for image in material.images() {
        write_bytes(&path.with_file_name(&image.name), &image.png)?;
    }
    write_bytes(path, text.as_bytes())
}

/// Writes `path` (`.usdz`): the same without a light, with its textures in one file.
///
/// # Errors
/// As [`write_usda`].
pub fn write_usdz(path: &Path, mesh: &Mesh, material: &UsdMaterial, up: UpAxis) -> Result<()> {
    let text = stage(path, mesh, material, up, None)?;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let name = format!("{stem}.usda");
    let textures = material.images().map(|image| (image.name.as_str(), image.png.as_slice()));
    // The stage comes first: that is how readers find it.
    let parts = std::iter::once((name.as_str(), text.as_bytes())).chain(textures);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .with_alignment(ALIGNMENT)
        .last_modified_time(zip::DateTime::default());
    for (name, bytes) in parts {
        archive.start_file(name, options).map_err(|error| not_written(path, error))?;
        archive.write_all(bytes).map_err(|error| not_written(path, error))?;
    }
    let bytes = archive.finish().map_err(|error| not_written(path, error))?;
    write_bytes(path, bytes.get_ref())
}

impl UsdMaterial {
    fn images(&self) -> impl Iterator<Item = &UsdImage> {
        fn image<T>(input: &UsdInput<T>) -> Option<&UsdImage> {
            if let UsdInput::Texture(image) = input { Some(image) } else { None }
        }
        std::iter::once(&self.diffuse).chain(image(&self.specular)).chain(image(&self.roughness))
    }
}

/// The text of the whole stage.
fn stage(
    path: &Path,
    mesh: &Mesh,
    material: &UsdMaterial,
    up: UpAxis,
    light: Option<(&str, f32)>,
) -> Result<String> {
    let (Some(uvs), Some((low, high))) = (&mesh.uvs, mesh.bounds()) else {
        return Err(not_written(path, "the mesh has no texture coordinates or no triangles"));
    };
    let mut of_material = Vec::new();
    let mut textures = texture("Diffuse", &material.diffuse, "sRGB", "float3 outputs:rgb");
    let specular = match &material.specular {
        UsdInput::Value(s) => {
            of_material.extend(s.to_array());
            format!(" = ({}, {}, {})", s.x, s.y, s.z)
        }
        UsdInput::Texture(image) => {
            textures += &texture("Specular", image, "sRGB", "float3 outputs:rgb");
            ".connect = </Object/Material/Specular.outputs:rgb>".to_owned()
        }
    };
    let roughness = match &material.roughness {
        UsdInput::Value(roughness) => {
            of_material.push(*roughness);
            format!(" = {roughness}")
        }
        UsdInput::Texture(image) => {
            textures += &texture("Roughness", image, "raw", "float outputs:r");
            ".connect = </Object/Material/Roughness.outputs:r>".to_owned()
        }
    };
    check_mesh(path, mesh, of_material.into_iter())?;
    let vectors = |values: &[Vec3]| list(values.iter().map(|v| format!("({}, {}, {})", v.x, v.y, v.z)));
    let fields = [
        ("{version}", env!("CARGO_PKG_VERSION").to_owned()),
        ("{up}", format!("{up:?}")),
        ("{specular}", specular),
        ("{roughness}", roughness),
        ("{textures}", textures),
        ("{extent}", vectors(&[low, high])),
        ("{counts}", list(mesh.triangles.iter().map(|_| "3".to_owned()))),
        ("{indices}", list(mesh.triangles.iter().flatten().map(u32::to_string))),
        // In USD, t points up.
        ("{places}", list(uvs.iter().map(|uv| format!("({}, {})", uv.x, 1.0 - uv.y)))),
        ("{normals}", vectors(&mesh.normals)),
        ("{points}", vectors(&mesh.positions)),
    ];
    let template = include_str!("stage.usda").to_owned();
    let text = fields.iter().fold(template, |text, (field, value)| text.replacen(field, value, 1));
    Ok(text + &light.map(dome).unwrap_or_default())
}

fn list(items: impl Iterator<Item = String>) -> String {
    format!("[{}]", items.collect::<Vec<_>>().join(", "))
}

fn texture(name: &str, image: &UsdImage, space: &str, output: &str) -> String {
    format!(
        "\n        def Shader \"{name}\"\n        {{\n            uniform token info:id = \"UsdUVTexture\"\n            \
         asset inputs:file = @{}@\n            token inputs:sourceColorSpace = \"{space}\"\n            \
         float2 inputs:st.connect = </Object/Material/Coordinates.outputs:result>\n            \
         token inputs:wrapS = \"clamp\"\n            token inputs:wrapT = \"clamp\"\n            {output}\n        }}\n",
        image.name
    )
}

fn dome((file, turn_degrees): (&str, f32)) -> String {
    format!(
        "\ndef DomeLight \"Light\"\n{{\n    asset inputs:texture:file = @{file}@\n    \
         token inputs:texture:format = \"latlong\"\n    float xformOp:rotateY = {turn_degrees}\n    \
         uniform token[] xformOpOrder = [\"xformOp:rotateY\"]\n}}\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::temporary;
    use lobelia_geometry::mesh::primitive::box_mesh;
    use std::io::Read as _;

    fn image(name: &str) -> UsdImage {
        UsdImage { name: name.to_owned(), png: format!("bytes of {name}").into_bytes() }
    }

    fn textured() -> UsdMaterial {
        UsdMaterial {
            diffuse: image("mesh_base_color.png"),
            specular: UsdInput::Texture(image("mesh_f0.png")),
            roughness: UsdInput::Texture(image("mesh_roughness.png")),
        }
    }

    /// A box with sides of 1, 2 and 3.
    fn block() -> Mesh {
        box_mesh(Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0)).unwrap()
    }

    /// The stage of the block with this material, written into `folder`.
    fn written(folder: &Path, material: &UsdMaterial, up: UpAxis, light: Option<(&str, f32)>) -> String {
        let path = folder.join("mesh.usda");
        write_usda(&path, &block(), material, up, light).unwrap();
        std::fs::read_to_string(path).unwrap()
    }

    #[test]
    fn a_stage_names_what_it_has() {
        let folder = tempfile::tempdir().unwrap();
        let plain = UsdMaterial {
            specular: UsdInput::Value(Vec3::new(0.1, 0.2, 0.3)),
            roughness: UsdInput::Value(0.25),
            ..textured()
        };
        let text = written(folder.path(), &plain, UpAxis::Z, Some(("light.hdr", 90.0)));
        for line in [
            "#usda 1.0",
            "upAxis = \"Z\"",
            "float3[] extent = [(-0.5, -1, -1.5), (0.5, 1, 1.5)]",
            "color3f inputs:specularColor = (0.1, 0.2, 0.3)",
            "float inputs:roughness = 0.25",
            "asset inputs:file = @mesh_base_color.png@",
            "asset inputs:texture:file = @light.hdr@",
            "float xformOp:rotateY = 90",
        ] {
            assert!(text.lines().any(|found| found.trim() == line), "{line} in {text}");
        }
        let opened = text.matches(['{', '(', '[']).count();
        assert_eq!(opened, text.matches(['}', ')', ']']).count());
        let points = text.lines().find(|line| line.contains("point3f[]")).unwrap();
        assert_eq!(points.matches('(').count(), block().positions.len());
        let bare = Mesh { uvs: None, ..block() };
        assert!(write_usda(&folder.path().join("bare.usda"), &bare, &textured(), UpAxis::Y, None).is_err());
    }

    #[test]
    fn the_parts_of_a_package_are_stored_and_aligned() {
        let (_folder, path) = temporary("mesh.usdz");
        let mesh = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        write_usdz(&path, &mesh, &textured(), UpAxis::Y).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).unwrap();
        let mut names = Vec::new();
        for i in 0..archive.len() {
            let mut part = archive.by_index(i).unwrap();
            assert_eq!(part.compression(), CompressionMethod::Stored);
            assert_eq!(part.data_start().unwrap() % 64, 0, "{:?}", part.name());
            let mut content = Vec::new();
            part.read_to_end(&mut content).unwrap();
            names.push((part.name().unwrap().to_string(), content.len()));
        }
        assert_eq!(names[0].0, "mesh.usda");
        assert_eq!(names[1], ("mesh_base_color.png".to_owned(), 28));
        assert_eq!(names.len(), 4);
    }
}
