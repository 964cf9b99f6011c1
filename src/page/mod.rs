//! The page that shows the object in a browser: one HTML file that holds everything, and asks no
//! server for anything.
//!
//! `assets/` has the page itself: HTML, style, script and shaders, as they are served; `pack` the
//! arrays of numbers. The page shades every pixel by the closed forms of
//! [`accurate`](lobelia_sg::accurate), ported to GLSL, with all lobes, all base materials, and
//! shadows and reflected light found as [`visibility`](lobelia_solve::visibility) finds them.

mod pack;

use crate::{report::html::escaped, report::html::filled};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use glam::Vec3;
use lobelia_geometry::view::{Camera, PixelWindow, Split};
use lobelia_geometry::{Result, mesh::Surface};
use lobelia_io::codec::tone::MAT;
use lobelia_sg::{brdf::Ndf, color::srgb_from_linear};
use lobelia_solve::visibility::ObjectVisibility;
use lobelia_world::material::diffuse::{Diffuse, has_sheen, has_tilt};
use lobelia_world::{light::LightLobe, light::light_frame::LightFrame, material::edit::MaterialState};
use pack::{Pack, pack_mesh, pack_visibility};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// The page without its data.
const PAGE: &str = include_str!("assets/page.html");
/// Its style.
const STYLE: &str = include_str!("assets/style.css");
/// Modules of `assets/`, by their names.
macro_rules! modules {
    ($($name:literal)*) => { [$(($name, include_str!(concat!("assets/", $name, ".js")))),*] };
}
/// Its modules, by the names under which they import each other; the last one starts the page.
const MODULES: [(&str, &str); 20] = modules!(
    "data" "linear" "gpu" "light" "masks" "shadow" "camera" "renderer" "regions" "brush" "ron"
    "history" "mapfile" "mapfit" "lightfile" "lightball" "compare" "controls" "pace" "main"
);
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
    /// Name on the page.
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
    /// The picture as a `data:` address, sRGB; outside the object it shows the mat of contact
    /// sheets.
    pub address: String,
    /// How much of each pixel is the object, up to 255; none if the view has no mask.
    pub coverage: Option<Vec<u8>>,
}

/// Contents of a page.
pub struct Contents<'a> {
    /// Title of the page.
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
    /// Visibility between parts of the object, if the scene has shadows.
    pub visibility: Option<&'a ObjectVisibility>,
}

/// The page as text.
///
/// # Errors
/// If a number is not finite, or shadows are too large for a page.
pub fn html(contents: &Contents) -> Result<String> {
    let mut pack = Pack::default();
    let mut scene = describe(contents, &mut pack)?;
    scene["arrays"] = Value::Object(pack.table.clone());
    let imports = MODULES.map(|(name, module)| {
        let address = format!("data:text/javascript;base64,{}", STANDARD.encode(module));
        (format!("lobelia/{name}"), address)
    });
    // Inside a script element, no other element may seem to begin or end.
    let in_script = |value: &Value| value.to_string().replace('<', "\\u003c");
    let slots = [
        ("{{TITLE}}", escaped(contents.title)),
        ("{{STYLE}}", STYLE.to_owned()),
        ("{{VERSION}}", env!("CARGO_PKG_VERSION").to_owned()),
        ("{{IMPORTS}}", json!({ "imports": BTreeMap::from(imports) }).to_string()),
        ("{{SHADERS}}", in_script(&json!(BTreeMap::from(SHADERS)))),
        ("{{SCENE}}", in_script(&scene)),
        ("{{BLOCK}}", pack.block()?),
    ];
    filled(PAGE, &slots)
}

/// Returns the contents of the page besides arrays, which go into `pack`.
fn describe(contents: &Contents, pack: &mut Pack) -> Result<Value> {
    let Contents { surface, material, .. } = contents;
    let atlas = surface.atlas();
    let (center, radius) = surface.bounding_sphere();
    let mesh = pack_mesh(pack, surface.mesh());
    pack.bytes("albedo", &albedo_bytes(contents, |texel| texel.albedo));
    if has_sheen(&material.diffuse) {
        pack.bytes("along", &albedo_bytes(contents, Diffuse::along));
    }
    if has_tilt(&material.diffuse) {
        // Each component as 128 and 4 times a number from −31 to 31, because fewer values are
        // packed into less, and 255.
        let byte = |t: f32| (128.0 + 4.0 * (31.0 * t.clamp(-1.0, 1.0)).round()) as u8;
        let tilts = material.diffuse.iter().flat_map(|texel| {
            let [x, y, z] = texel.tilt.to_array().map(byte);
            [x, y, z, 255]
        });
        pack.bytes("tilt", &tilts.collect::<Vec<_>>());
    }
    // Whether texels blend base materials, each in its own way.
    let is_blended = material.uniform().is_none();
    if is_blended {
        let byte = |weight: f32| (weight.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        pack.bytes("blend", &material.blends.iter().flat_map(|blend| blend.0.map(byte)).collect::<Vec<_>>());
    }
    let shadows = match contents.visibility {
        Some(visibility) => pack_visibility(pack, surface, material, visibility)?,
        None => Value::Null,
    };
    let mut lights: Vec<Value> = Vec::new();
    for (i, PageLight { name, lobes, frame, own }) in contents.lights.iter().enumerate() {
        let numbers = lobes.iter().flat_map(|LightLobe { axis: a, sharpness, amplitude: c }| {
            [a.x, a.y, a.z, *sharpness, c.x, c.y, c.z]
        });
        pack.floats(&format!("light{i}"), numbers)?;
        let frame = match frame {
            LightFrame::World => json!("world"),
            LightFrame::Camera => json!("camera"),
            LightFrame::Turntable(axis) => json!(axis.normalize_or(Vec3::Y)),
        };
        lights.push(json!({ "name": name, "own": own, "frame": frame }));
    }
    let cameras = contents.cameras.iter().enumerate();
    let cameras: Vec<Value> = cameras.map(|(i, view)| camera_json(i, view, pack)).collect();
    let materials = material.materials().map(|(number, lobe)| {
        json!({
            "number": number, "albedo": lobe.albedo, "roughness": lobe.roughness, "ggx": lobe.ndf == Ndf::Ggx,
        })
    });
    Ok(json!({
        "title": contents.title, "up": contents.up.normalize_or(Vec3::Y), "center": center, "radius": radius,
        "mesh": mesh, "texture": [atlas.width, atlas.height], "blended": is_blended,
        "materials": materials.collect::<Vec<_>>(), "edits": contents.edits, "visibility": shadows,
        "lights": lights, "cameras": cameras,
    }))
}

/// sRGB albedo of each texel, and whether the texel has a place on the surface.
fn albedo_bytes(contents: &Contents, albedo: impl Fn(&Diffuse) -> Vec3) -> Vec<u8> {
    let atlas = contents.surface.atlas();
    let bytes = |(i, texel): (usize, &Diffuse)| {
        let byte = |value: f32| (srgb_from_linear(value) * 255.0 + 0.5) as u8;
        let there = atlas.covered[i] && atlas.normal[i] != Vec3::ZERO;
        let [r, g, b] = albedo(texel).to_array().map(byte);
        [r, g, b, if there { 255 } else { 0 }]
    };
    contents.material.diffuse.iter().enumerate().flat_map(bytes).collect()
}

fn camera_json(index: usize, view: &PageCamera, pack: &mut Pack) -> Value {
    let camera = &view.camera;
    let axes = camera.world_from_camera.matrix3;
    let axes: [Vec3; 3] = [axes.x_axis, axes.y_axis, axes.z_axis].map(Vec3::from);
    let shift = camera.pixel_center - 0.5;
    let photograph = view.photograph.as_ref().map(|PagePhotograph { window, size, address, coverage }| {
        if let Some(coverage) = coverage {
            pack.bytes(&format!("coverage{index}"), coverage);
        }
        let window = [window.x, window.y, window.width, window.height];
        json!({ "window": window, "size": size, "mat": MAT, "address": address })
    });
    json!({
        "name": view.name, "test": view.split == Split::Test, "width": camera.width, "height": camera.height,
        "focal": camera.focal, "center": camera.center.map(|c| c - shift), "skew": camera.skew,
        "eye": camera.position(), "axes": axes, "photograph": photograph,
    })
}

/// Least length of the mean of the cameras' upward directions for which they agree on one.
const AGREED: f32 = 0.3;
/// Cosine from which a direction is taken for an axis: 20°.
const NEAR_AXIS: f32 = 0.94;

/// The direction that is up in most photographs, or that of the scene if they do not agree: data
/// sets have their own axes. It is an axis of the world if one is near.
pub fn upright(cameras: &[PageCamera], scene_up: Vec3) -> Vec3 {
    let up = |camera: &PageCamera| Vec3::from(-camera.camera.world_from_camera.matrix3.y_axis);
    let mean = cameras.iter().map(up).sum::<Vec3>() / cameras.len().max(1) as f32;
    if mean.length() < AGREED {
        return scene_up;
    }
    let mean = mean.normalize();
    let axes = [Vec3::X, Vec3::Y, Vec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
    axes.into_iter().find(|axis| axis.dot(mean) > NEAR_AXIS).unwrap_or(mean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_geometry::mesh::primitive::sphere_mesh;
    use lobelia_world::material::{SpecularBlend, SpecularLobe};
    use pack::Range;
    use pack::tests::{direction, unpacked, value};

    /// A sphere with two base materials under two lights.
    fn page() -> String {
        let surface = Surface::new(sphere_mesh(Vec3::ZERO, 0.8).unwrap(), 16).unwrap();
        let count = surface.atlas().position.len();
        let (albedo, bent) = (Vec3::new(0.5, 0.25, 1.0), Vec3::new(0.25, 0.0, -0.5));
        let material = MaterialState {
            diffuse: vec![Diffuse { albedo, sheen: bent, tilt: bent }; count],
            blends: vec![SpecularBlend::even(2); count],
            lobes: [(0.04, 0.5), (1.0, 0.2)]
                .map(|(albedo, roughness)| Some(SpecularLobe::new(Vec3::splat(albedo), roughness)))
                .into(),
        };
        let lobes = vec![LightLobe { axis: Vec3::Y, sharpness: 3.0, amplitude: Vec3::ONE }; 3];
        let frame = LightFrame::World;
        let light = |name: &str, own| PageLight { name: name.into(), lobes: lobes.clone(), frame, own };
        let camera = Camera::look_at(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, Vec3::Y, 38.0, 32, 24).unwrap();
        let contents = Contents {
            title: "a </title><script> & more",
            up: Vec3::Y * 2.0,
            surface: &surface,
            material: &material,
            edits: vec!["Roughness(action: Set(0.2))".into()],
            lights: vec![light("found", true), light("</script>{{BLOCK}}", false)],
            cameras: [("bare", Split::Train, None), ("front", Split::Test, Some(photograph()))]
                .map(|(name, split, photograph)| PageCamera { name: name.into(), split, camera, photograph })
                .into(),
            visibility: None,
        };
        html(&contents).unwrap()
    }

    const ADDRESS: &str = "data:image/jpeg;base64,AAAA";

    fn photograph() -> PagePhotograph {
        let window = PixelWindow { x: 3, y: 4, width: 8, height: 4 };
        PagePhotograph { window, size: [4, 2], address: ADDRESS.into(), coverage: Some((0..8).collect()) }
    }

    /// Returns the part of `text` between two others.
    fn between<'a>(text: &'a str, start: &str, end: &str) -> &'a str {
        let from = text.find(start).unwrap_or_else(|| panic!("no {start}")) + start.len();
        &text[from..from + text[from..].find(end).unwrap()]
    }

    fn scene_of(page: &str) -> Value {
        serde_json::from_str(between(page, "id=\"scene\">", "</script>")).unwrap()
    }

    fn array(page: &str, scene: &Value, name: &str, width: usize) -> Vec<Vec<u8>> {
        let bytes = unpacked(between(page, "id=\"block\">", "</script>"));
        let entry = &scene["arrays"][name];
        let [at, count] = ["at", "count"].map(|key| entry[key].as_u64().unwrap() as usize);
        (0..count).map(|i| (0..width).map(|plane| bytes[at + plane * count + i]).collect()).collect()
    }

    /// 16-bit numbers whose differences from those `delta` places before are kept.
    fn shorts(page: &str, scene: &Value, name: &str) -> Vec<u16> {
        let delta = scene["arrays"][name]["delta"].as_u64().unwrap() as usize;
        let mut values: Vec<u16> =
            array(page, scene, name, 2).iter().map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        for i in delta..values.len() {
            values[i] = values[i].wrapping_add(values[i - delta]);
        }
        values
    }

    #[test]
    fn a_page_asks_no_one_for_anything() {
        let page = page();
        for word in ["http:", "https:", "//cdn", "url(", "@import", "src=", "XMLHttpRequest", "fetch("] {
            assert!(!page.contains(word), "the page has {word}");
        }
        let modules = between(&page, "type=\"importmap\">", "</script>");
        let modules: Value = serde_json::from_str(modules).unwrap();
        for (name, address) in modules["imports"].as_object().unwrap() {
            let text = STANDARD.decode(address.as_str().unwrap().split_once(',').unwrap().1).unwrap();
            let text = String::from_utf8(text).unwrap();
            for word in ["http:", "https:", "XMLHttpRequest", "fetch(", "WebSocket", "import("] {
                assert!(!text.contains(word), "{name} has {word}");
            }
        }
        assert!(page.contains("default-src 'none'"));
        assert!(page.len() < 360_000, "{} bytes", page.len());
    }

    #[test]
    fn names_cannot_break_out_of_the_page() {
        let page = page();
        assert!(page.contains("<title>a &lt;/title&gt;&lt;script&gt; &amp; more</title>"));
        let scene = scene_of(&page);
        assert_eq!(scene["lights"][1]["name"], "</script>{{BLOCK}}");
        assert_eq!(scene["title"], "a </title><script> & more");
        assert_eq!(page.matches("<script").count(), 5, "the page's own script elements");
    }

    #[test]
    fn the_mesh_comes_back() {
        let page = page();
        let scene = scene_of(&page);
        let mesh = sphere_mesh(Vec3::ZERO, 0.8).unwrap();
        let number = |of: &str, c: usize| scene["mesh"][of][c].as_f64().unwrap() as f32;
        let positions = shorts(&page, &scene, "positions");
        let at = |c: usize, fraction: u16| {
            value(Range { low: number("low", c), size: number("size", c) }, fraction)
        };
        for (place, p) in positions.chunks(3).zip(&mesh.positions) {
            let found = Vec3::from_array([0, 1, 2].map(|c| at(c, place[c])));
            assert!(found.distance(*p) < 3e-5, "{found} {p}");
        }
        for (pair, normal) in shorts(&page, &scene, "normals").chunks(2).zip(&mesh.normals) {
            assert!(direction([pair[0], pair[1]]).distance(*normal) < 1e-4);
        }
        let words = array(&page, &scene, "triangles", 4);
        let mut last = 0u32;
        for (word, index) in words.iter().zip(mesh.triangles.as_flattened()) {
            last = last.wrapping_add(u32::from_le_bytes([word[0], word[1], word[2], word[3]]));
            assert_eq!(last, *index);
        }
        assert_eq!(words.len(), 3 * mesh.triangles.len());
    }

    #[test]
    fn the_scene_says_what_it_was_given() {
        let page = page();
        let scene = scene_of(&page);
        assert_eq!(scene["up"], json!([0.0, 1.0, 0.0]));
        assert_eq!((&scene["blended"], &scene["visibility"]), (&json!(true), &Value::Null));
        assert_eq!(scene["materials"][1]["number"], 1);
        assert_eq!(scene["cameras"][0]["eye"], json!([0.0, 0.0, 3.0]));
        assert_eq!(scene["cameras"][0]["photograph"], Value::Null);
        let photograph = &scene["cameras"][1]["photograph"];
        assert_eq!((&photograph["window"], &photograph["size"]), (&json!([3, 4, 8, 4]), &json!([4, 2])));
        assert_eq!((&photograph["mat"], &photograph["address"]), (&json!(MAT), &json!(ADDRESS)));
        assert_eq!(array(&page, &scene, "coverage1", 1).concat(), [0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(scene["edits"], json!(["Roughness(action: Set(0.2))"]));
        for (name, expected) in [
            ("albedo", [188, 137, 255]),
            // Albedo and sheen.
            ("along", [225, 137, 188]),
            // 31 steps to each side of 128, 4 apart.
            ("tilt", [160, 128, 64]),
        ] {
            assert_eq!(array(&page, &scene, name, 1)[..3].concat(), expected, "{name}");
        }
        let light = array(&page, &scene, "light1", 4);
        let light: Vec<f32> = light.iter().map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        assert_eq!(light[..7], [0.0, 1.0, 0.0, 3.0, 1.0, 1.0, 1.0]);
        assert_eq!(light.len(), 21);
    }

    fn looking_from(eye: Vec3, up: Vec3) -> PageCamera {
        let camera = Camera::look_at(eye, Vec3::ZERO, up, 40.0, 64, 64).unwrap();
        PageCamera { name: String::new(), split: Split::Test, camera, photograph: None }
    }

    #[test]
    fn the_photographs_say_what_is_up() {
        let ring = |up: Vec3, from: usize| -> Vec<PageCamera> {
            let eyes =
                (0..12).map(|i| f32::to_radians(30.0 * i as f32)).map(|t| Vec3::new(t.cos(), t.sin(), 0.6));
            eyes.skip(from).map(|eye| looking_from(eye, up)).collect()
        };
        assert_eq!(upright(&ring(Vec3::Z, 0), Vec3::Y), Vec3::Z);
        assert_eq!(upright(&ring(-Vec3::Z, 0), Vec3::Y), -Vec3::Z);
        assert_eq!(upright(&[], Vec3::Y), Vec3::Y);
        let both = [ring(Vec3::Z, 0), ring(-Vec3::Z, 0)].concat();
        assert_eq!(upright(&both, Vec3::Y), Vec3::Y);
    }
}
