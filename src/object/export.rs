//! An object as a mesh for other programs, with fewer triangles if asked, and the light beside it
//! as environment maps.

use crate::object::{Object, fit::carried_blends, show::Appearance};
use crate::scene::{ExportPass, ExportScale, ExportUp, Light, MeshFormat, Pass};
use bevy_ecs::prelude::World;
use glam::{Mat3, Quat, Vec3};
use image::ExtendedColorType;
use lobelia_geometry::error::{Error, Result};
use lobelia_geometry::mesh::tangents::{relative_normals, texel_frames, vertex_tangents};
use lobelia_geometry::mesh::{Surface, atlas::fill_uncovered, atlas::unwrap_mesh, decimate::decimate};
use lobelia_geometry::parallel;
use lobelia_geometry::view::{Camera, Placement, ViewName};
use lobelia_geometry::{mesh::nearest::NearestTriangle, mesh::triangles::Mesh};
use lobelia_io::codec::gltf::material::{
    Dielectric, GltfMaterial, GltfReflectance, GltfTable, LobeReflectance,
};
use lobelia_io::codec::tone::srgb8;
use lobelia_io::codec::usd::{UpAxis, UsdImage, UsdInput, UsdMaterial, write_usda, write_usdz};
use lobelia_io::codec::{
    envmap::write_map_hdr, file::write_bytes, gltf::export::write_glb, image::encode_png,
};
use lobelia_sg::{color::srgb_from_linear, ray::Hit, reflectance::ANGLES, sg::sphere_integral};
use lobelia_world::light::convention::MapConvention;
use lobelia_world::light::light_frame::{LightFrame, OwnLightFrame};
use lobelia_world::light::{EnvironmentMap, LightLobe, render_lobes, rotate_lobes};
use lobelia_world::material::{Diffuse, SpecularBlend, SpecularLobe, edit::MaterialState};
use std::{f32::consts::TAU, path::Path, path::PathBuf, sync::Arc};

/// Texture files of a USD file, after its stem and a `_`.
const BASE_COLOR: &str = "base_color.png";
const REFLECTANCE: &str = "reflectance.png";
const ROUGHNESS: &str = "roughness.png";

impl Object {
    /// Writes the object as [`Appearance::export`] does.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn export(&mut self, path: impl AsRef<Path>) -> Result<()> {
        self.shown().export(path)
    }
}

impl Appearance<'_> {
    /// Writes the mesh with the material that is shown, in the format of the file's ending: `.glb`,
    /// `.usdz`, or `.usda` with its textures beside it.
    ///
    /// # Errors
    /// If the ending is another, or the file cannot be written.
    pub fn export(&mut self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let named = |format: &MeshFormat| Path::new(file_of(*format)).extension() == path.extension();
        let format = FORMATS.into_iter().find(named).ok_or_else(|| {
            let problem = format!("{} is no format of a mesh", path.display());
            Error::usage(problem, "Give a file that ends with .glb, .usda or .usdz.")
        })?;
        let exported = Exported::new(self.object.surface(), self.material()?);
        let (mesh, _, up) =
            transformed(self.object.scene().up, &ExportPass::default(), exported.surface.mesh());
        exported.write(format, path, &mesh, up, None)
    }

    /// Writes the formats and the light of a pass into its folder; returns the files of the formats.
    pub(crate) fn export_as(&mut self, pass: &ExportPass, folder: &Path) -> Result<Vec<PathBuf>> {
        let mut exported = Exported::new(self.object.surface(), self.material()?);
        let triangles = exported.surface.mesh().triangles.len();
        if let Some(target) = pass.triangles.filter(|&target| (target as usize) < triangles) {
            exported = exported.coarser(target as usize)?;
        }
        let (mesh, turn, up) = transformed(self.object.scene().up, pass, exported.surface.mesh());
        let light = self.environment(pass, turn);
        for (map, (name, convention)) in light.iter().flat_map(|map| MAPS.map(|file| (map, file))) {
            write_map_hdr(&convention.from_lobelia(map.clone()), &folder.join(name))?;
        }
        let mut files = Vec::new();
        for format in &pass.formats {
            let path = folder.join(file_of(*format));
            // The map of the light is in the convention of three.js.
            exported.write(*format, &path, &mesh, up, light.as_ref().map(|_| (LIGHT, LIGHT_TURN)))?;
            files.push(path);
        }
        if pass.formats.contains(&MeshFormat::Glb) {
            let page = page(file_of(MeshFormat::Glb), light.map(|_| LIGHT));
            write_bytes(&folder.join(MODEL_PAGE), page.as_bytes())?;
        }
        Ok(files)
    }

    /// The light that is shown, turned as the object, as a map: the given one, or the lobes'
    /// radiance; `None` if there is none yet.
    fn environment(&mut self, pass: &ExportPass, turn: Quat) -> Option<EnvironmentMap> {
        let (scene, (lobes, map)) = (self.object.scene(), self.light());
        let is_relit = self.relit.is_some();
        // The lobes of a light that is found differ from the map that they were initialized from.
        let map = map.filter(|_| is_relit || matches!(scene.light, Light::Fixed(_)));
        let turn = if is_relit { turn } else { turn * own_turn(&mut self.object.pipeline.world) };
        let mut earlier = scene.passes.iter().take_while(|other| other.name() != pass.name);
        let is_found = is_relit
            || !matches!(scene.light, Light::Unknown(_))
            || earlier.any(|other| matches!(other, Pass::Fit(_) | Pass::Shape(_)));
        match map {
            Some(map) => Some(turned_map(map.map(), turn)),
            None => is_found.then(|| map_of_lobes(&lobes, turn)),
        }
    }
}

const FORMATS: [MeshFormat; 3] = [MeshFormat::Glb, MeshFormat::Usda, MeshFormat::Usdz];

/// The file of a format, beside its textures.
fn file_of(format: MeshFormat) -> &'static str {
    match format {
        MeshFormat::Glb => "mesh.glb",
        MeshFormat::Usda => "mesh.usda",
        MeshFormat::Usdz => "mesh.usdz",
    }
}

/// All that the pass may write, without its folder.
pub fn files(pass: &ExportPass) -> Vec<String> {
    let of_format = |format: &MeshFormat| {
        let beside: &[&str] = match format {
            MeshFormat::Glb => &[MODEL_PAGE],
            MeshFormat::Usda => &["mesh_base_color.png", "mesh_reflectance.png", "mesh_roughness.png"],
            MeshFormat::Usdz => &[],
        };
        [&[file_of(*format)], beside].concat()
    };
    pass.formats.iter().flat_map(of_format).chain(MAPS.map(|(name, _)| name)).map(str::to_owned).collect()
}

fn gltf(object: &Exported) -> Result<GltfMaterial> {
    let TexelMaterial { base, dielectrics, roughness } = object.look(None);
    // The normal map of an object with fewer triangles.
    let normal = |normal: &Vec3| (0.5 * *normal + 0.5).to_array().map(byte);
    let normals = object.relative_normals.as_ref();
    let normal_image = normals.map(|normals| object.png(normals.iter().map(normal))).transpose()?;
    let base_color_image = Some(object.color_png(&base)?);
    if let ([dielectric], [roughness]) = (&dielectrics[..], &roughness[..]) {
        let material = GltfMaterial::of_dielectric(dielectric, *roughness);
        return Ok(GltfMaterial { base_color_image, normal_image, ..material });
    }
    // The factors of the reflectance texture, whose values are at most one: colors as sRGB, and
    // linear numbers as alpha.
    let ratio = |d: &Dielectric| if d.f90 > 0.0 { d.f0 / d.f90 } else { Vec3::ZERO };
    let strongest = dielectrics.iter().map(ratio).fold(Vec3::ZERO, Vec3::max);
    let f90 = dielectrics.iter().map(|d| d.f90).fold(0.0, f32::max);
    let fraction = |x: Vec3| Vec3::select(strongest.cmpgt(Vec3::ZERO), x / strongest, Vec3::ONE);
    let reflectance = dielectrics.iter().map(|d| {
        let [r, g, b] = fraction(ratio(d)).to_array().map(|x| byte(srgb_from_linear(x)));
        [r, g, b, byte(if f90 > 0.0 { d.f90 / f90 } else { 1.0 })]
    });
    let factors = Dielectric { f0: strongest * f90, f90, diffuse_share: 1.0 };
    Ok(GltfMaterial {
        base_color_image,
        normal_image,
        roughness: 1.0,
        // Roughness in green, linear; metallic in blue, 0.
        roughness_image: Some(object.png(roughness.iter().map(|r| [0, byte(*r), 0]))?),
        specular_image: Some(object.png(reflectance)?),
        ..GltfMaterial::of_dielectric(&factors, 1.0)
    })
}

/// The material as USD has it, in which F90 is one.
fn usd(object: &Exported, path: &Path) -> Result<UsdMaterial> {
    let look = object.look(Some(1.0));
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let image = |name: &str, png: Vec<u8>| UsdImage { name: format!("{stem}_{name}"), png };
    let diffuse = image(BASE_COLOR, object.color_png(&look.base)?);
    if let ([dielectric], [roughness]) = (&look.dielectrics[..], &look.roughness[..]) {
        let (specular, roughness) = (UsdInput::Value(dielectric.f0), UsdInput::Value(*roughness));
        return Ok(UsdMaterial { diffuse, specular, roughness });
    }
    let f0: Vec<_> = look.dielectrics.iter().map(|dielectric| dielectric.f0).collect();
    let gray = look.roughness.iter().map(|r| [byte(*r)]);
    Ok(UsdMaterial {
        diffuse,
        specular: UsdInput::Texture(image(REFLECTANCE, object.color_png(&f0)?)),
        roughness: UsdInput::Texture(image(ROUGHNESS, object.png(gray)?)),
    })
}

/// The mesh in which a point p of data in which `data_up` is up is at `scale` · (`turn` p −
/// `origin`); the turn, which is that of the light as well; and the axis that is up then, or the
/// nearest of the two that files can name.
fn transformed(data_up: Vec3, pass: &ExportPass, mesh: &Mesh) -> (Mesh, Quat, UpAxis) {
    let data_up = data_up.normalize_or(Vec3::Y);
    let (turn, up) = match pass.up {
        ExportUp::Data if data_up.z.abs() > data_up.y.abs() => (Quat::IDENTITY, UpAxis::Z),
        ExportUp::Data => (Quat::IDENTITY, UpAxis::Y),
        ExportUp::Y => (between(data_up, Vec3::Y), UpAxis::Y),
        ExportUp::Z => (between(data_up, Vec3::Z), UpAxis::Z),
    };
    // The box of the turned mesh.
    let used = mesh.triangles.iter().flatten().map(|&vertex| turn * mesh.positions[vertex as usize]);
    let none = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) = used.fold(none, |(low, high), p| (low.min(p), high.max(p)));
    let (low, high) = if low.x <= high.x { (low, high) } else { (Vec3::ZERO, Vec3::ZERO) };
    let scale = match pass.scale {
        ExportScale::Factor(factor) => factor,
        ExportScale::Size(size) => size / (high - low).max_element().max(f32::MIN_POSITIVE),
    };
    let origin = if pass.center { (low + high) / 2.0 } else { Vec3::ZERO };
    let mut placed = mesh.clone();
    // Nothing changes a bit of what stays where it is.
    if turn != Quat::IDENTITY {
        placed.positions.iter_mut().for_each(|p| *p = turn * *p);
        placed.normals.iter_mut().for_each(|n| *n = (turn * *n).normalize_or(*n));
    }
    if origin != Vec3::ZERO || scale != 1.0 {
        placed.positions.iter_mut().for_each(|p| *p = (*p - origin) * scale);
    }
    (placed, turn, up)
}

/// The shortest rotation that brings one direction to another; exactly none if they are the same.
fn between(from: Vec3, to: Vec3) -> Quat {
    if from.distance(to) < 1e-6 { Quat::IDENTITY } else { Quat::from_rotation_arc(from, to) }
}

/// A page with the exported object under its light, ready to be put on a site.
pub const MODEL_PAGE: &str = "model-viewer.html";

/// Where the element of the page comes from, a server of others.
const SCRIPT: &str = "https://ajax.googleapis.com/ajax/libs/model-viewer/4.0.0/model-viewer.min.js";

/// The page that shows `mesh` under `light`, files beside it.
pub fn page(mesh: &str, light: Option<&str>) -> String {
    let light = light.map(|light| format!("\n      environment-image=\"{light}\"")).unwrap_or_default();
    format!(
        r#"<!DOCTYPE html>
<html lang="en">
  <head>
    <meta charset="utf-8">
    <meta name="viewport" content="width=device-width, initial-scale=1">
    <title>The object under its light</title>
    <!-- The only thing that is not beside this file: the <model-viewer> element, from a server of Google. To do without
         it, save the script beside this file and name it here. -->
    <script type="module" src="{SCRIPT}"></script>
    <style>
      html, body, model-viewer {{ width: 100%; height: 100%; margin: 0; }}
    </style>
  </head>
  <body>
    <!-- Browsers load the mesh and the light from a server only, not from the disk: python3 -m http.server, for one.
         tone-mapping="none" shows colors as they are computed, clipped at white. -->
    <model-viewer
      src="{mesh}"{light}
      alt="The object"
      exposure="1"
      tone-mapping="none"
      shadow-intensity="0"
      camera-controls
      touch-action="pan-y"></model-viewer>
  </body>
</html>
"#
    )
}

/// The light in the convention of glTF viewers built on three.js.
const LIGHT: &str = "light.hdr";
/// Turn of that map about +Y in degrees, from the convention of USD, which is that of this crate.
const LIGHT_TURN: f32 = 90.0;
/// The files of the light, with the conventions that they are in.
const MAPS: [(&str, MapConvention); 2] =
    [(LIGHT, MapConvention::ThreeJs), ("light_blender.hdr", MapConvention::BlenderYUp)];
/// Width of the maps in texels, twice their height.
const WIDTH: u32 = 1024;

/// The rotation of the own light into the world. One that goes with the camera stands as the first
/// view has it.
fn own_turn(world: &mut World) -> Quat {
    let frame = world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default();
    if frame == LightFrame::World {
        return Quat::IDENTITY;
    }
    // In the first placement.
    let mut views = world.query::<(&ViewName, &Camera, &Placement)>();
    let upright = views.iter(world).filter(|(_, _, placement)| placement.0 == 0);
    let first = upright.min_by(|a, b| a.0.0.cmp(&b.0.0));
    first.map_or(Quat::IDENTITY, |(_, camera, _)| {
        let axes = Mat3::from(camera.world_from_camera.matrix3);
        Quat::from_mat3(&frame.light_from_world(axes).transpose())
    })
}

fn turned_map(map: &EnvironmentMap, turn: Quat) -> EnvironmentMap {
    let map = if map.width > WIDTH { map.downsampled(WIDTH, WIDTH / 2) } else { map.clone() };
    if turn == Quat::IDENTITY { map } else { map.rotated(turn) }
}

/// The lobes' radiance. One narrower than a texel is as wide as a texel, with the same power.
fn map_of_lobes(lobes: &[LightLobe], turn: Quat) -> EnvironmentMap {
    let finest = 2.0 * (WIDTH as f32 / TAU).powi(2);
    let widened = |lobe: &LightLobe| {
        let sharpness = lobe.sharpness.min(finest);
        let power = |sharpness: f32| sphere_integral(f64::from(sharpness));
        let dimmed = (power(lobe.sharpness) / power(sharpness)) as f32;
        LightLobe { sharpness, amplitude: lobe.amplitude * dimmed, ..*lobe }
    };
    let lobes: Vec<LightLobe> = lobes.iter().map(widened).collect();
    render_lobes(&rotate_lobes(&lobes, turn), WIDTH, WIDTH / 2)
}

/// The exported object.
struct Exported {
    surface: Arc<Surface>,
    albedo: Vec<Vec3>,
    /// Its base materials, with their numbers.
    lobes: Vec<(usize, SpecularLobe)>,
    /// Their weights at each texel; `None` if there is one lobe with weight one everywhere.
    blends: Option<Vec<SpecularBlend>>,
    /// The normals of the full surface relative to this one's
    /// ([`tangents`](lobelia_geometry::mesh::tangents)), for an object with fewer triangles.
    relative_normals: Option<Vec<Vec3>>,
}

/// The material of texels in other programs.
struct TexelMaterial {
    base: Vec<Vec3>,
    /// Specular part: one for all, or one of each texel.
    dielectrics: Vec<Dielectric>,
    /// Roughness, as many.
    roughness: Vec<f32>,
}

impl Exported {
    /// Writes a file, of USD text beside a light with this name and turn.
    fn write(
        &self,
        format: MeshFormat,
        path: &Path,
        mesh: &Mesh,
        up: UpAxis,
        light: Option<(&str, f32)>,
    ) -> Result<()> {
        match format {
            MeshFormat::Glb => write_glb(path, mesh, Some(&gltf(self)?)),
            MeshFormat::Usda => write_usda(path, mesh, &usd(self, path)?, up, light),
            MeshFormat::Usdz => write_usdz(path, mesh, &usd(self, path)?, up),
        }
    }

    fn new(surface: Arc<Surface>, material: MaterialState) -> Self {
        // Other programs know no sheen of this kind: they get its mean.
        let albedo = material.diffuse.iter().map(Diffuse::mean_albedo).collect();
        let lobes: Vec<_> = material.materials().map(|(number, lobe)| (number, *lobe)).collect();
        let is_uniform = material.uniform().is_some();
        let blends = (!is_uniform).then_some(material.blends);
        Self { surface, albedo, lobes, blends, relative_normals: None }
    }

    /// The object with about `target` triangles; normals, albedo and weights are those of the
    /// nearest points of the full surface.
    fn coarser(&self, target: usize) -> Result<Self> {
        let size = self.surface.atlas().width;
        let nearest = NearestTriangle::new(self.surface.mesh());
        let below = |at: &Vec3| nearest.nearest(*at).map(|found| self.surface.hit(found));
        let mut mesh = decimate(self.surface.mesh(), target);
        let normal = |at: &Vec3| below(at).map_or(Vec3::Y, |hit| hit.normal);
        mesh.normals = parallel::map_slice(&mesh.positions, 64, normal);
        let surface = Surface::new(unwrap_mesh(&mesh, size)?.mesh, size)?;
        let atlas = surface.atlas();
        let mut hits: Vec<Option<Hit>> = vec![None; atlas.position.len()];
        let texels = (&mut *hits, (&*atlas.position, &*atlas.covered));
        parallel::for_each_row(texels, 1024, |(hit, (at, covered))| {
            *hit = covered.then(|| below(at)).flatten();
        });
        let full: Vec<Vec3> = hits.iter().map(|hit| hit.map_or(Vec3::ZERO, |hit| hit.normal)).collect();
        let frames = texel_frames(surface.mesh(), &vertex_tangents(surface.mesh()), atlas);
        let normals = relative_normals(&frames, &full);
        let carried = |values: &[Vec3]| {
            let at = |hit: &Option<Hit>| hit.map_or(Vec3::ZERO, |hit| hit.texels.blend(values));
            let mut carried: Vec<Vec3> = parallel::map_slice(&hits, 1024, at);
            fill_uncovered(&mut carried, &atlas.covered, atlas);
            carried
        };
        let albedo = carried(&self.albedo);
        let blends = self.blends.as_ref().map(|blends| carried_blends(blends, &carried));
        let (surface, lobes, relative_normals) = (Arc::new(surface), self.lobes.clone(), Some(normals));
        Ok(Self { surface, albedo, lobes, blends, relative_normals })
    }

    /// The material that reflects as much in other programs; `f90` is F90 where it is given.
    fn look(&self, f90: Option<f32>) -> TexelMaterial {
        let reflectances: Vec<_> = self
            .lobes
            .iter()
            .map(|(number, lobe)| (*number, lobe.albedo, LobeReflectance::of(lobe)))
            .collect();
        let target = |blend: &SpecularBlend| {
            let mut target = [Vec3::ZERO; ANGLES];
            for (number, albedo, reflectance) in reflectances.iter().filter(|(k, ..)| blend.0[*k] > 0.0) {
                reflectance.add(*albedo, blend.0[*number], &mut target);
            }
            target
        };
        let (roughness, dielectrics): (Vec<f32>, Vec<Dielectric>) = match &self.blends {
            None => {
                let none = SpecularLobe::new(Vec3::ZERO, 1.0);
                let lobe = self.lobes.first().map_or(none, |(_, lobe)| *lobe);
                let found = GltfReflectance::of(lobe.roughness).fit(&target(&SpecularBlend::default()), f90);
                (vec![lobe.roughness], vec![found])
            }
            Some(blends) => {
                let table = GltfTable::default();
                let each = |blend: &SpecularBlend| {
                    let roughness = blend.roughness(self.lobes.iter().map(|(number, lobe)| (*number, lobe)));
                    (roughness, table.at(roughness).fit(&target(blend), f90))
                };
                parallel::map_slice(blends, 1024, each).into_iter().unzip()
            }
        };
        let share = |i: usize| dielectrics[i.min(dielectrics.len() - 1)].diffuse_share;
        let base = self.albedo.iter().enumerate().map(|(i, albedo)| (*albedo / share(i)).min(Vec3::ONE));
        TexelMaterial { base: base.collect(), dielectrics, roughness }
    }

    /// A texture of linear colors as an sRGB PNG.
    fn color_png(&self, colors: &[Vec3]) -> Result<Vec<u8>> {
        self.png(colors.iter().map(|color| srgb8(*color)))
    }

    /// A texture of gray, RGB or RGBA texels.
    fn png<const N: usize>(&self, texels: impl Iterator<Item = [u8; N]>) -> Result<Vec<u8>> {
        let atlas = self.surface.atlas();
        let kind = match N {
            1 => ExtendedColorType::L8,
            3 => ExtendedColorType::Rgb8,
            _ => ExtendedColorType::Rgba8,
        };
        encode_png(&texels.flatten().collect::<Vec<u8>>(), [atlas.width, atlas.height], kind)
    }
}

fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_geometry::mesh::primitive::{box_mesh, sphere_mesh};
    use lobelia_io::codec::envmap::read_map;
    use lobelia_sg::{brdf::Ndf, fibonacci::fibonacci_axes};
    use lobelia_world::light::{lobes_power, lobes_radiance};

    #[test]
    fn the_data_stay_as_they_are_unless_something_is_said() {
        let mesh = box_mesh(Vec3::new(3.0, 4.0, 5.0), Vec3::new(1.0, 2.0, 4.0)).unwrap();
        for (up, axis) in [(Vec3::Y, UpAxis::Y), (Vec3::Z, UpAxis::Z), (-Vec3::Z, UpAxis::Z)] {
            let (placed, _, up) = transformed(up, &ExportPass::default(), &mesh);
            assert_eq!((placed, up), (mesh.clone(), axis));
        }
    }

    #[test]
    fn up_center_and_size_are_as_asked() {
        let mesh = box_mesh(Vec3::new(3.0, 4.0, 5.0), Vec3::new(1.0, 2.0, 4.0)).unwrap();
        let asked = ExportPass {
            up: ExportUp::Y,
            center: true,
            scale: ExportScale::Size(2.0),
            ..ExportPass::default()
        };
        let (placed, ..) = transformed(Vec3::Z * 3.0, &asked, &mesh);
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
        let factor =
            ExportPass { up: ExportUp::Z, scale: ExportScale::Factor(10.0), ..ExportPass::default() };
        let (low, high) = transformed(-Vec3::Y, &factor, &mesh).0.bounds().unwrap();
        assert!((low.z + 50.0).abs() < 1e-3 && (high.z + 30.0).abs() < 1e-3, "{low} {high}");
    }

    fn lobes() -> Vec<LightLobe> {
        let lobe = |at: Vec3, sharpness, amplitude| LightLobe { axis: at.normalize(), sharpness, amplitude };
        vec![
            lobe(Vec3::new(0.2, 0.9, -0.3), 0.5, Vec3::new(0.3, 0.4, 0.6)),
            lobe(Vec3::new(1.0, 0.2, 0.1), 30.0, Vec3::new(9.0, 4.0, 1.0)),
            lobe(Vec3::new(-0.4, -0.1, 0.8), 80.0, Vec3::new(1.0, 7.0, 2.0)),
        ]
    }

    #[test]
    fn each_file_has_the_lobes_where_its_program_looks_for_them() {
        let folder = tempfile::tempdir().unwrap();
        let turn = Quat::from_rotation_arc(Vec3::Z, Vec3::Y);
        let map = map_of_lobes(&lobes(), turn);
        for (name, convention) in MAPS {
            let path = folder.path().join(name);
            write_map_hdr(&convention.from_lobelia(map.clone()), &path).unwrap();
            let read = read_map(&path).unwrap();
            for direction in fibonacci_axes(300) {
                // As the program computes the place of a direction, by the formulas of its own
                // sources.
                let d = direction;
                let (u, v) = match convention {
                    // Blender's importer turns (x, y, z) to (x, −z, y); there u = ½ − atan2(y,
                    // x)/2π, v = ½ − asin(z)/π.
                    MapConvention::BlenderYUp => {
                        let b = Vec3::new(d.x, -d.z, d.y);
                        (0.5 - b.y.atan2(b.x) / TAU, 0.5 - 2.0 * b.z.asin() / TAU)
                    }
                    _ => (0.5 + d.z.atan2(d.x) / TAU, 0.5 - 2.0 * d.y.asin() / TAU),
                };
                let found = read.bilinear_at(u.rem_euclid(1.0), v);
                let true_radiance = lobes_radiance(&lobes(), turn.inverse() * d);
                let error = (found - true_radiance).abs().max_element();
                let most = 0.02 * (1.0 + true_radiance.max_element());
                assert!(error < most, "{name} {d}: {found} {true_radiance}");
            }
            let lobelia = convention.to_lobelia(read);
            let way = turn * lobes()[1].axis;
            assert!(lobelia.sample_bilinear(way).distance(map.sample_bilinear(way)) < 0.1, "{name}");
        }
    }

    #[test]
    fn a_lobe_between_texels_keeps_its_power() {
        let sun = LightLobe { axis: Vec3::new(0.6, 0.64, 0.48), sharpness: 1e7, amplitude: Vec3::splat(1e6) };
        let map = map_of_lobes(&[sun], Quat::IDENTITY);
        let (found, power) = (map.power().x, lobes_power(&[sun]).x);
        assert!((found / power - 1.0).abs() < 0.02, "{found} {power}");
    }

    #[test]
    fn a_given_map_is_turned_with_the_object() {
        let map = render_lobes(&lobes(), 256, 128);
        let turn = Quat::from_rotation_arc(Vec3::Z, Vec3::Y);
        assert_eq!(turned_map(&map, Quat::IDENTITY), map);
        let turned = turned_map(&map, turn);
        let axis = lobes()[1].axis;
        assert!((turned.sample_bilinear(turn * axis) - map.sample_bilinear(axis)).length() < 0.2);
        assert_eq!(turned_map(&render_lobes(&lobes(), 2048, 1024), Quat::IDENTITY).width, WIDTH);
    }

    #[test]
    fn a_normal_map_has_the_normals_of_the_full_surface() {
        // Normals that vary more finely than the triangles of the coarse mesh.
        let bent = |at: Vec3| (at.normalize() + 0.2 * (9.0 * at).map(f32::sin)).normalize();
        let mut mesh = unwrap_mesh(&sphere_mesh(Vec3::ZERO, 1.0).unwrap(), 128).unwrap().mesh;
        mesh.normals = mesh.positions.iter().map(|at| bent(*at)).collect();
        let surface = Arc::new(Surface::new(mesh, 128).unwrap());
        let texels = surface.atlas().covered.len();
        let material = MaterialState {
            diffuse: vec![Diffuse::of_albedo(Vec3::splat(0.5)); texels],
            blends: vec![SpecularBlend::default(); texels],
            lobes: vec![Some(SpecularLobe { ndf: Ndf::Sg, ..SpecularLobe::new(Vec3::splat(0.04), 0.4) })],
        };
        let full = Exported::new(surface, material);
        assert!(full.relative_normals.is_none());
        let coarse = full.coarser(120).unwrap();
        let atlas = coarse.surface.atlas();
        let frames = texel_frames(coarse.surface.mesh(), &vertex_tangents(coarse.surface.mesh()), atlas);
        let (mut with, mut without, mut count) = (0.0, 0.0, 0.0);
        for row in (0..atlas.covered.len()).filter(|row| atlas.covered[*row]) {
            let truth = bent(atlas.position[row].normalize());
            // As a program reads it: eight bits a channel.
            let code = coarse.relative_normals.as_ref().unwrap()[row];
            let read = (0.5 * code + 0.5).to_array().map(|value| f32::from(byte(value)) / 127.5 - 1.0);
            let mapped = (frames[row] * Vec3::from(read)).normalize();
            with += mapped.angle_between(truth).to_degrees();
            without += atlas.normal[row].angle_between(truth).to_degrees();
            count += 1.0;
        }
        let (with, without) = (with / count, without / count);
        assert!(with < 2.0 && without > 3.0 * with, "{with} {without}");
    }
}
