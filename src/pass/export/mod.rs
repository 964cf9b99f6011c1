//! The `Export` pass: the object as a mesh for other programs, and the light beside it.
//!
//! | module | holds |
//! | --- | --- |
//! | [`object`] | the surface with its material, with fewer triangles if asked, and its textures |
//! | `transform` | the axes, origin and size of the exported object |
//! | [`light`] | the light as environment maps |
//! | [`mod@page`] | a page with the object and its light |

pub mod light;
pub mod object;
pub mod page;
pub(crate) mod transform;

use crate::codec::file::write_bytes;
use crate::codec::gltf::export::write_glb;
use crate::codec::gltf::material::GltfMaterial;
use crate::codec::ply_obj::{ObjMaterial, write_obj, write_ply};
use crate::codec::usd::{UpAxis, UsdImage, UsdInput, UsdLight, UsdMaterial, write_usda, write_usdz};
use crate::error::Result;
use crate::mesh::triangles::Mesh;
use crate::pass::export::light::{LIGHT, LIGHT_TURN, write_light};
use crate::pass::export::object::Object;
use crate::pass::export::page::{PAGE, page};
use crate::pass::export::transform::ExportTransform;
use crate::pass::session::Session;
use crate::pass::show::material_of;
use crate::scene::{ExportPass, MeshFormat};
use std::path::Path;

/// Texture files of a USD file.
const BASE_COLOR: &str = "mesh_base_color.png";
const REFLECTANCE: &str = "mesh_reflectance.png";
const ROUGHNESS: &str = "mesh_roughness.png";

/// Writes the object in the formats that the pass names.
///
/// # Errors
/// If the object cannot be unwrapped, or a file cannot be written.
pub(crate) fn run(session: &mut Session, pass: &ExportPass) -> Result<()> {
    let material = material_of(session, pass.of.as_deref())?;
    let mut object = Object::new(session.surface.clone(), material);
    if let Some(target) = pass.triangles.filter(|&n| (n as usize) < object.triangles()) {
        object = object.coarser(target as usize)?;
    }
    let placement = ExportTransform::new(session.scene.up, pass, object.mesh());
    let folder = session.folder(&pass.name);
    let has_light = with_light(pass) && write_light(session, pass, placement.turn, &folder)?;
    let exported = Exported { mesh: placement.placed(object.mesh()), object, up: placement.up, has_light };
    for format in &pass.formats {
        exported.write(&folder, *format)?;
        session.progress.print(&format!("{}: {}", pass.name, folder.join(file_of(*format)).display()));
    }
    if pass.formats.contains(&MeshFormat::Glb) {
        write_bytes(
            &folder.join(PAGE),
            page(file_of(MeshFormat::Glb), has_light.then_some(LIGHT)).as_bytes(),
        )?;
    }
    Ok(())
}

/// The file of a format, beside its textures.
fn file_of(format: MeshFormat) -> &'static str {
    match format {
        MeshFormat::Glb => "mesh.glb",
        MeshFormat::Ply => "mesh.ply",
        MeshFormat::Obj => "mesh.obj",
        MeshFormat::Usda => "mesh.usda",
        MeshFormat::Usdz => "mesh.usdz",
    }
}

/// Whether the light is written: PLY and OBJ files are for programs with lights of their own.
fn with_light(pass: &ExportPass) -> bool {
    pass.formats.iter().any(|format| matches!(format, MeshFormat::Glb | MeshFormat::Usda | MeshFormat::Usdz))
}

/// All that the pass may write, without its folder.
pub fn files(pass: &ExportPass) -> Vec<String> {
    let of_format = |format: &MeshFormat| {
        let beside: &[&str] = match format {
            MeshFormat::Glb => &[PAGE],
            MeshFormat::Obj => &["mesh.mtl", "mesh_albedo.png"],
            MeshFormat::Usda => &[BASE_COLOR, REFLECTANCE, ROUGHNESS],
            MeshFormat::Ply | MeshFormat::Usdz => &[],
        };
        [&[file_of(*format)], beside].concat()
    };
    let light = if with_light(pass) { light::FILES.to_vec() } else { Vec::new() };
    pass.formats.iter().flat_map(of_format).chain(light).map(str::to_owned).collect()
}

/// The object as it is written.
struct Exported {
    mesh: Mesh,
    object: Object,
    up: UpAxis,
    has_light: bool,
}

impl Exported {
    /// Writes one format into a folder.
    fn write(&self, folder: &Path, format: MeshFormat) -> Result<()> {
        let path = folder.join(file_of(format));
        match format {
            MeshFormat::Glb => write_glb(&path, &self.mesh, Some(&self.gltf()?)),
            MeshFormat::Ply => write_ply(&path, &self.mesh, &self.object.vertex_colors()),
            MeshFormat::Obj => {
                let albedo_png = &self.object.color_png(&self.object.albedo)?;
                let mean = self.object.mean_lobe();
                let material = ObjMaterial { albedo_png, specular: mean.albedo, roughness: mean.roughness };
                write_obj(&path, &self.mesh, &material)
            }
            MeshFormat::Usda => {
                // The map of the light is in the convention of three.js.
                let light = UsdLight { file: LIGHT, turn_degrees: LIGHT_TURN };
                write_usda(&path, &self.mesh, &self.usd()?, self.up, self.has_light.then_some(light))
            }
            MeshFormat::Usdz => write_usdz(&path, &self.mesh, &self.usd()?, self.up),
        }
    }

    fn gltf(&self) -> Result<GltfMaterial> {
        let look = self.object.look(None);
        let normal_image = self.object.normal_png()?;
        let base_color_image = Some(self.object.color_png(&look.base)?);
        if let ([dielectric], [roughness]) = (&look.dielectrics[..], &look.roughness[..]) {
            let material = GltfMaterial::of_dielectric(dielectric, *roughness);
            return Ok(GltfMaterial { base_color_image, normal_image, ..material });
        }
        let (factors, images) = look.factors();
        Ok(GltfMaterial {
            base_color_image,
            normal_image,
            roughness: 1.0,
            roughness_image: Some(self.object.roughness_png(&look.roughness)?),
            specular_image: Some(self.object.reflectance_png(&images)?),
            ..GltfMaterial::of_dielectric(&factors, 1.0)
        })
    }

    /// The material as USD has it, in which F90 is one.
    fn usd(&self) -> Result<UsdMaterial> {
        let look = self.object.look(Some(1.0));
        let image = |name: &str, png: Vec<u8>| UsdImage { name: name.to_owned(), png };
        let diffuse = image(BASE_COLOR, self.object.color_png(&look.base)?);
        if let ([dielectric], [roughness]) = (&look.dielectrics[..], &look.roughness[..]) {
            let (specular, roughness) = (UsdInput::Value(dielectric.f0), UsdInput::Value(*roughness));
            return Ok(UsdMaterial { diffuse, specular, roughness });
        }
        let f0: Vec<_> = look.dielectrics.iter().map(|dielectric| dielectric.f0).collect();
        Ok(UsdMaterial {
            diffuse,
            specular: UsdInput::Texture(image(REFLECTANCE, self.object.color_png(&f0)?)),
            roughness: UsdInput::Texture(image(ROUGHNESS, self.object.gray_png(&look.roughness)?)),
        })
    }
}
