use super::*;
use crate::material::{DiffuseAlbedo, SpecularLobe};
use crate::material::{DiffuseSheen, DiffuseTilt};
use crate::mesh::primitive::sphere_mesh;
use flate2::read::DeflateDecoder;
use std::io::Read as _;

/// A sphere with two base materials under two lights.
fn page() -> String {
    let surface = Surface::new(sphere_mesh(Vec3::ZERO, 0.8).unwrap(), 16).unwrap();
    let count = surface.atlas().position.len();
    let material = MaterialState {
        albedo: vec![DiffuseAlbedo(Vec3::new(0.5, 0.25, 1.0)); count],
        sheen: vec![DiffuseSheen(Vec3::new(0.25, 0.0, -0.5)); count],
        tilt: vec![DiffuseTilt(Vec3::new(0.25, 0.0, -0.5)); count],
        blends: vec![SpecularBlend::even(2); count],
        lobes: vec![Some(SpecularLobe::new(Vec3::splat(0.04), 0.5)), Some(SpecularLobe::new(Vec3::ONE, 0.2))],
    };
    let lobe = LightLobe { axis: Vec3::Y, sharpness: 3.0, amplitude: Vec3::ONE };
    let light = |name: &str, own| PageLight {
        name: name.into(),
        lobes: vec![lobe; 3],
        frame: LightFrame::World,
        own,
    };
    let camera = Camera::look_at(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, Vec3::Y, 38.0, 32, 24).unwrap();
    let contents = Contents {
        title: "a </title><script> & more",
        up: Vec3::Y * 2.0,
        surface: &surface,
        material: &material,
        edits: vec!["Roughness(action: Set(0.2))".into()],
        lights: vec![light("found", true), light("</script>{{BLOCK}}", false)],
        cameras: vec![
            PageCamera { name: "bare".into(), split: Split::Train, camera, photograph: None },
            PageCamera { name: "front".into(), split: Split::Test, camera, photograph: Some(photograph()) },
        ],
        visibility: None,
    };
    html(&contents).unwrap()
}

fn photograph() -> PagePhotograph {
    let window = PixelWindow { x: 3, y: 4, width: 8, height: 4 };
    let coverage = Some((0..8).collect());
    PagePhotograph {
        window,
        size: [4, 2],
        address: "data:image/jpeg;base64,AAAA".into(),
        mat: [1, 2, 3],
        coverage,
    }
}

/// What is between two texts.
fn between<'a>(text: &'a str, start: &str, end: &str) -> &'a str {
    let from = text.find(start).unwrap_or_else(|| panic!("no {start}")) + start.len();
    &text[from..from + text[from..].find(end).unwrap()]
}

fn scene_of(page: &str) -> Value {
    serde_json::from_str(between(page, "id=\"scene\">", "</script>")).unwrap()
}

fn array(page: &str, scene: &Value, name: &str, width: usize) -> Vec<Vec<u8>> {
    let packed = STANDARD.decode(between(page, "id=\"block\">", "</script>")).unwrap();
    let mut bytes = Vec::new();
    DeflateDecoder::new(&packed[..]).read_to_end(&mut bytes).unwrap();
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
    let value = |of: &str, c: usize| scene["mesh"][of][c].as_f64().unwrap() as f32;
    let positions = shorts(&page, &scene, "positions");
    let at = |c: usize, fraction: u16| {
        mesh::Range { low: value("low", c), size: value("size", c) }.value(fraction)
    };
    for (place, p) in positions.chunks(3).zip(&mesh.positions) {
        let found = Vec3::from_array([0, 1, 2].map(|c| at(c, place[c])));
        assert!(found.distance(*p) < 3e-5, "{found} {p}");
    }
    for (pair, normal) in shorts(&page, &scene, "normals").chunks(2).zip(&mesh.normals) {
        assert!(mesh::direction([pair[0], pair[1]]).distance(*normal) < 1e-4);
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
    assert_eq!(
        (&photograph["mat"], &photograph["address"]),
        (&json!([1, 2, 3]), &json!("data:image/jpeg;base64,AAAA"))
    );
    assert_eq!(array(&page, &scene, "coverage1", 1).concat(), [0, 1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(scene["edits"], json!(["Roughness(action: Set(0.2))"]));
    let albedo = array(&page, &scene, "albedo", 1);
    assert_eq!(albedo[..3].concat(), [188, 137, 255]);
    let along = array(&page, &scene, "along", 1);
    assert_eq!(along[..3].concat(), [225, 137, 188], "albedo and sheen");
    let tilt = array(&page, &scene, "tilt", 1);
    assert_eq!(tilt[..4].concat(), [160, 128, 64, 255], "31 steps to each side of 128, 4 apart");
    let light: Vec<f32> = array(&page, &scene, "light1", 4)
        .iter()
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect();
    assert_eq!(light[..7], [0.0, 1.0, 0.0, 3.0, 1.0, 1.0, 1.0]);
    assert_eq!(light.len(), 21);
}
