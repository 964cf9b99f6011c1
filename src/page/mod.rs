//! The page that shows the object in a browser: one HTML file that holds everything, and asks no server for anything.
//!
//! | module | holds |
//! | --- | --- |
//! | [`pack`] | arrays of numbers in one compressed block |
//! | [`mesh`] | the mesh in 16-bit numbers |
//! | `shadow` | hidden directions of texels, and what hides them |
//! | [`upright`] | which way is up |
//! | `assets/` | the page itself: HTML, style, script and shaders, as they are served |
//!
//! The page shades every pixel by the closed forms of [`accurate`](crate::math::accurate), ported to GLSL, with all lobes, all base
//! materials, and shadows and reflected light found as [`visibility`](crate::visibility) finds them.

pub mod mesh;
pub mod pack;
pub(crate) mod shadow;
pub mod upright;

use crate::error::Result;
use crate::light::LightLobe;
use crate::light::light_frame::LightFrame;
use crate::material::edit::MaterialState;
use crate::material::sheen::has_sheen;
use crate::material::tilt::has_tilt;
use crate::material::{MAX_SPECULAR_LOBES, SpecularBlend};
use crate::math::brdf::Ndf;
use crate::math::color::srgb_from_linear;
use crate::mesh::Surface;
use crate::report::html::filled;
use crate::report::html::text::escaped;
use crate::view::{Camera, PixelWindow, Split};
use crate::visibility::ObjectVisibility;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::Vec3;
use mesh::pack_mesh;
use pack::Pack;
use serde_json::{Value, json};
use shadow::pack_visibility;

/// The page without its data.
const PAGE: &str = include_str!("assets/page.html");
/// Its style.
const STYLE: &str = include_str!("assets/style.css");
/// Its modules, by the names under which they import each other; the last one starts the page.
const MODULES: [(&str, &str); 20] = [
    ("data", include_str!("assets/data.js")),
    ("linear", include_str!("assets/linear.js")),
    ("gpu", include_str!("assets/gpu.js")),
    ("light", include_str!("assets/light.js")),
    ("masks", include_str!("assets/masks.js")),
    ("shadow", include_str!("assets/shadow.js")),
    ("camera", include_str!("assets/camera.js")),
    ("renderer", include_str!("assets/renderer.js")),
    ("regions", include_str!("assets/regions.js")),
    ("brush", include_str!("assets/brush.js")),
    ("ron", include_str!("assets/ron.js")),
    ("history", include_str!("assets/history.js")),
    ("mapfile", include_str!("assets/mapfile.js")),
    ("mapfit", include_str!("assets/mapfit.js")),
    ("lightfile", include_str!("assets/lightfile.js")),
    ("lightball", include_str!("assets/lightball.js")),
    ("compare", include_str!("assets/compare.js")),
    ("controls", include_str!("assets/controls.js")),
    ("pace", include_str!("assets/pace.js")),
    ("main", include_str!("assets/main.js")),
];
/// Its shaders, by name.
const SHADERS: [(&str, &str); 10] = [
    ("octahedral", include_str!("assets/octahedral.glsl")),
    ("diffuse", include_str!("assets/diffuse.glsl")),
    ("specular", include_str!("assets/specular.glsl")),
    ("surface.vert", include_str!("assets/surface.vert")),
    ("buffer.frag", include_str!("assets/buffer.frag")),
    ("surface.frag", include_str!("assets/surface.frag")),
    ("texels.vert", include_str!("assets/texels.vert")),
    ("occlusion.frag", include_str!("assets/occlusion.frag")),
    ("indirect.frag", include_str!("assets/indirect.frag")),
    ("develop.frag", include_str!("assets/develop.frag")),
];

/// A light that the page offers.
#[derive(Clone, Debug, PartialEq)]
pub struct PageLight {
    /// What the page calls it.
    pub name: String,
    /// Its lobes, in its frame.
    pub lobes: Vec<LightLobe>,
    /// The frame in which it stands still.
    pub frame: LightFrame,
    /// Whether it is the object's own: a pass without a light has it.
    pub own: bool,
}

/// A camera that the page offers.
#[derive(Clone, Debug, PartialEq)]
pub struct PageCamera {
    /// The view's name.
    pub name: String,
    /// Which part of the data it is of.
    pub split: Split,
    /// The camera.
    pub camera: Camera,
    /// Its photograph, if the page has it.
    pub photograph: Option<PagePhotograph>,
}

/// A photograph that the page lays beside its own picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PagePhotograph {
    /// The part of the camera's picture that it shows.
    pub window: PixelWindow,
    /// Its size in the page, in pixels.
    pub size: [u32; 2],
    /// The picture as a `data:` address, sRGB; outside the object it has the color of the mat.
    pub address: String,
    /// The color of the mat.
    pub mat: [u8; 3],
    /// How much of each pixel is the object, up to 255; none if the view has no mask.
    pub coverage: Option<Vec<u8>>,
}

/// What a page shows.
pub struct Contents<'a> {
    /// What the page is called.
    pub title: &'a str,
    /// The world's up direction.
    pub up: Vec3,
    /// The object.
    pub surface: &'a Surface,
    /// The material that it shows.
    pub material: &'a MaterialState,
    /// Edits that made this material of the recovered one, as RON; "copy as RON" begins with them.
    pub edits: Vec<String>,
    /// The lights; the first is shown at the start.
    pub lights: Vec<PageLight>,
    /// The cameras of the views.
    pub cameras: Vec<PageCamera>,
    /// What hides what, if the scene has shadows.
    pub visibility: Option<&'a ObjectVisibility>,
}

/// The page as text.
///
/// # Errors
/// If a number is not finite, or shadows are too large for a page.
pub fn html(contents: &Contents) -> Result<String> {
    let mut pack = Pack::default();
    let mut scene = describe(contents, &mut pack)?;
    scene["arrays"] = pack.table();
    let imports = MODULES.iter().map(|(name, text)| {
        let address = format!("data:text/javascript;base64,{}", STANDARD.encode(text));
        (format!("lobelia/{name}"), Value::String(address))
    });
    let shaders: serde_json::Map<String, Value> =
        SHADERS.iter().map(|(name, text)| ((*name).to_owned(), Value::String((*text).to_owned()))).collect();
    let slots = [
        ("{{TITLE}}", escaped(contents.title)),
        ("{{STYLE}}", STYLE.to_owned()),
        ("{{VERSION}}", env!("CARGO_PKG_VERSION").to_owned()),
        ("{{IMPORTS}}", json!({ "imports": imports.collect::<serde_json::Map<_, _>>() }).to_string()),
        ("{{SHADERS}}", in_script(&Value::Object(shaders))),
        ("{{SCENE}}", in_script(&scene)),
        ("{{BLOCK}}", pack.block()?),
    ];
    filled(PAGE, &slots)
}

/// JSON inside a script element, in which no other element may seem to begin or end.
fn in_script(value: &Value) -> String {
    value.to_string().replace('<', "\\u003c")
}

/// What is in the page besides arrays, which go into `pack`.
fn describe(contents: &Contents, pack: &mut Pack) -> Result<Value> {
    let Contents { surface, material, .. } = contents;
    let atlas = surface.atlas();
    let (center, radius) = surface.bounding_sphere();
    let mesh = pack_mesh(pack, surface.mesh());
    pack_texels(contents, pack);
    let shadows = match contents.visibility {
        Some(visibility) => pack_visibility(pack, surface, material, visibility)?,
        None => Value::Null,
    };
    let lights: Vec<Value> = contents
        .lights
        .iter()
        .enumerate()
        .map(|(i, light)| light_json(i, light, pack))
        .collect::<Result<_>>()?;
    let cameras = contents.cameras.iter().enumerate();
    let cameras: Vec<Value> = cameras.map(|(i, view)| camera_json(i, view, pack)).collect();
    Ok(json!({
        "title": contents.title, "up": contents.up.normalize_or(Vec3::Y), "center": center, "radius": radius,
        "mesh": mesh, "texture": [atlas.width, atlas.height], "blended": is_blended(material),
        "materials": materials_json(material), "edits": contents.edits, "visibility": shadows, "lights": lights,
        "cameras": cameras,
    }))
}

/// Puts what the material has of each texel into `pack`: albedo, and where there are any, sheen, tilt and blend weights.
fn pack_texels(contents: &Contents, pack: &mut Pack) {
    let material = contents.material;
    pack.bytes("albedo", &albedo_bytes(contents, |i| material.albedo[i].0));
    if has_sheen(&material.sheen) {
        pack.bytes("along", &albedo_bytes(contents, |i| material.albedo[i].0 + material.sheen[i].0));
    }
    if has_tilt(&material.tilt) {
        pack.bytes("tilt", &material.tilt.iter().flat_map(|tilt| tilt_bytes(tilt.0)).collect::<Vec<_>>());
    }
    if is_blended(material) {
        pack.bytes("blend", &material.blends.iter().flat_map(blend_bytes).collect::<Vec<_>>());
    }
}

/// Whether texels blend base materials, each in its own way.
fn is_blended(material: &MaterialState) -> bool {
    material.uniform().is_none()
}

/// The base materials, with their numbers.
fn materials_json(material: &MaterialState) -> Vec<Value> {
    let materials = material.materials().map(|(number, lobe)| {
        json!({
            "number": number, "albedo": lobe.albedo, "roughness": lobe.roughness, "ggx": lobe.ndf == Ndf::Ggx,
        })
    });
    materials.collect()
}

/// sRGB albedo of each texel, and whether the texel has a place on the surface.
fn albedo_bytes(contents: &Contents, albedo: impl Fn(usize) -> Vec3) -> Vec<u8> {
    let atlas = contents.surface.atlas();
    let texel = |i: usize| {
        let byte = |value: f32| (srgb_from_linear(value) * 255.0 + 0.5) as u8;
        let there = atlas.covered[i] && atlas.normal[i] != Vec3::ZERO;
        let [r, g, b] = albedo(i).to_array().map(byte);
        [r, g, b, if there { 255 } else { 0 }]
    };
    (0..contents.material.albedo.len()).flat_map(texel).collect()
}

/// Each component of a tilt as 128 and 4 times a number from −31 to 31, because fewer values are packed into less, and 255.
fn tilt_bytes(tilt: Vec3) -> [u8; 4] {
    let [x, y, z] = tilt.to_array().map(|t| (128.0 + 4.0 * (31.0 * t.clamp(-1.0, 1.0)).round()) as u8);
    [x, y, z, 255]
}

fn blend_bytes(blend: &SpecularBlend) -> [u8; MAX_SPECULAR_LOBES] {
    blend.0.map(|weight| (weight.clamp(0.0, 1.0) * 255.0 + 0.5) as u8)
}

fn light_json(index: usize, light: &PageLight, pack: &mut Pack) -> Result<Value> {
    let numbers = |lobe: &LightLobe| {
        let LightLobe { axis, sharpness, amplitude } = *lobe;
        [axis.x, axis.y, axis.z, sharpness, amplitude.x, amplitude.y, amplitude.z]
    };
    pack.floats(&format!("light{index}"), light.lobes.iter().flat_map(numbers))?;
    let frame = match light.frame {
        LightFrame::World => json!("world"),
        LightFrame::Camera => json!("camera"),
        LightFrame::Turntable(axis) => json!(axis.normalize_or(Vec3::Y)),
    };
    Ok(json!({ "name": light.name, "own": light.own, "frame": frame }))
}

fn camera_json(index: usize, view: &PageCamera, pack: &mut Pack) -> Value {
    let camera = &view.camera;
    let rotation: [Vec3; 3] = [
        camera.world_from_camera.matrix3.x_axis.into(),
        camera.world_from_camera.matrix3.y_axis.into(),
        camera.world_from_camera.matrix3.z_axis.into(),
    ];
    let shift = camera.pixel_center - 0.5;
    json!({
        "name": view.name, "test": view.split == Split::Test, "width": camera.width, "height": camera.height,
        "focal": camera.focal, "center": camera.center.map(|c| c - shift), "skew": camera.skew,
        "eye": camera.position(), "axes": rotation,
        "photograph": view.photograph.as_ref().map(|photograph| photograph_json(index, photograph, pack)),
    })
}

fn photograph_json(index: usize, photograph: &PagePhotograph, pack: &mut Pack) -> Value {
    let PagePhotograph { window, size, address, mat, coverage } = photograph;
    if let Some(coverage) = coverage {
        pack.bytes(&format!("coverage{index}"), coverage);
    }
    json!({
        "window": [window.x, window.y, window.width, window.height], "size": size, "mat": mat, "address": address,
    })
}

#[cfg(test)]
mod tests;
