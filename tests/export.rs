//! Exported files hold the object: read back, they give the same picture. `Save` and `Export` write
//! it as an `Edit` or `Relight` pass shows it, if asked to.

use crate::common::{Data, changed, files_below, known_scene, write_image};
use glam::Vec3;
use lobelia::codec::exr_frame::{read_frame, write_channels};
use lobelia::{
    codec::envmap::read_map, codec::exr::ExrLayers, codec::gltf::material::read_material,
    light::convention::MapConvention, material::SpecularLobe,
};
use serde_json::Value;

/// A box with a painted texture; `{SURFACE}`, `{MATERIAL}` and `{PASSES}` are filled in.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: {SURFACE},
    views: Cameras([
        (name: "a", eye: (1.6, 1.3, 1.9), width: 96, height: 96),
        (name: "b", eye: (-1.9, -1.2, -1.1), width: 96, height: 96),
    ]),
    light: Fixed(Lobes(lobes: [
        (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.35, 0.45, 0.6)),
        (axis: (0.5, 0.6, 0.62), sharpness: 20, amplitude: (2.5, 2.2, 1.9)),
        (axis: (-0.8, -0.5, -0.3), sharpness: 8, amplitude: (0.9, 1.1, 1.6)),
    ])),
    {MATERIAL}
    passes: [Render(name: "novel"), {PASSES}],
)"#;

const PAINTED: &str = r#"material: (
    albedo: Fixed(Texture("paint.exr")),
    specular: (albedo: Fixed(0.3, 0.22, 0.08), roughness: Fixed(0.3)),
),"#;

fn scene(surface: &str, material: &str, passes: &str) -> String {
    SCENE.replace("{SURFACE}", surface).replace("{MATERIAL}", material).replace("{PASSES}", passes)
}

/// A folder with `paint.exr`: smooth, with channels from 0.05 to 0.65, which 1 − F̄ leaves room
/// for.
fn studio() -> Data {
    let data = Data::new();
    let wave = |i: usize, k: f32| 0.35 + 0.3 * ((i % 64) as f32 * 0.11 * k + (i / 64) as f32 * 0.07).sin();
    let color = |i: usize| Vec3::from([1.0, -0.6, 0.3].map(|k| wave(i, k)));
    write_image(&data.path("paint.exr"), &(0..64 * 64).map(color).collect::<Vec<_>>(), 64);
    data
}

/// PSNR of the colors of two runs' pictures, display range, over the pixels that the first shows
/// anything in.
fn psnr(data: &Data, a: &str, b: &str) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for view in ["a", "b"] {
        let [a, b] = [a, b].map(|out| read_frame(data.path(format!("{out}/novel/{view}.exr"))).unwrap());
        for i in (0..a.color.len()).filter(|&i| a.alpha[i] > 0.0) {
            let difference = a.color[i].min(Vec3::ONE) - b.color[i].min(Vec3::ONE);
            sum += f64::from(difference.length_squared());
            count += 3;
        }
    }
    assert!(count > 3000, "{count}");
    -10.0 * (sum / f64::from(count)).log10()
}

#[test]
fn an_exported_mesh_read_back_gives_the_same_picture() {
    let data = studio();
    let painted = scene("Box(texture_size: 64)", PAINTED, r#"Export(name: "export")"#);
    data.run(&painted, "out", &["--quiet"]).succeeded();
    let surface = r#"Mesh(path: "out/export/mesh.glb", texture_size: 64, own_material: true)"#;
    data.run(&scene(surface, "", ""), "again", &["--quiet"]).succeeded();
    let found = psnr(&data, "out", "again");
    assert!(found > 45.0, "{found}");
}

#[test]
fn a_tenth_of_the_triangles_looks_nearly_the_same() {
    let data = studio();
    let passes = r#"Export(name: "export", formats: [Glb], triangles: 3600),
        Evaluate(mesh: "mesh.glb")"#;
    let sphere = "Sphere(texture_size: 128)";
    data.run(&scene(sphere, PAINTED, passes), "out", &["--quiet"]).succeeded();
    let files = ["light.hdr", "light_blender.hdr", "mesh.glb", "model-viewer.html"];
    assert_eq!(files_below(&data.path("out/export")), files);
    let glb = data.bytes("out/export/mesh.glb");
    assert!(glb.windows(15).any(|part| part == b"\"normalTexture\""));
    let metrics = data.metrics("out");
    assert!(metrics["chamfer"].as_f64().unwrap() < 1e-6, "{metrics}");
    let surface = r#"Mesh(path: "out/export/mesh.glb", texture_size: 128, own_material: true)"#;
    let again = scene(surface, "", r#"Evaluate(mesh: "mesh.glb")"#);
    let outcome = data.run(&again, "again", &[]).succeeded();
    assert!(outcome.stdout.contains("Chamfer 0.00"), "{}", outcome.stdout);
    let found = psnr(&data, "out", "again");
    assert!(found > 35.0, "{found}");
}

#[test]
fn an_object_set_upright_is_lit_as_before() {
    let data = studio();
    let upward = |text: &str| text.replace("version: 1,", "version: 1, up: (0, 0, 1),");
    let with_up = |text: &str, up: &str| text.replace("width: 96", &format!("up: {up}, width: 96"));
    let export = r#"Export(name: "export", up: Y, center: true, scale: Factor(2))"#;
    let first = with_up(&upward(&scene("Box(texture_size: 64)", PAINTED, export)), "(0, 0, 1)");
    data.run(&first, "out", &["--quiet"]).succeeded();
    // (x, y, z) to 2 (x, z, −y): what was at +Z is at +Y.
    let surface = r#"Mesh(path: "out/export/mesh.glb", texture_size: 64, own_material: true)"#;
    let again = with_up(&scene(surface, "", ""), "(0, 1, 0)");
    let again = changed(&again, "1.6, 1.3, 1.9", "3.2, 3.8, -2.6");
    let again = changed(&again, "-1.9, -1.2, -1.1", "-3.8, -2.2, 2.4");
    let (start, end) = (again.find("Fixed(Lobes").unwrap(), again.find("])),").unwrap() + 4);
    for (file, convention) in [("light", "ThreeJs"), ("light_blender", "BlenderYUp")] {
        let map = format!("Map(path: \"out/export/{file}.hdr\", convention: {convention}, lobes: 12)");
        let text = [&again[..start], &format!("Fixed({map}),"), &again[end..]].concat();
        data.run(&text, file, &["--quiet"]).succeeded();
        let found = psnr(&data, "out", file);
        assert!(found > 38.0, "{file}: {found}");
    }
}

#[test]
fn usd_files_name_their_textures_and_the_light() {
    let data = studio();
    let blend = r#"material: (
        albedo: Fixed(Texture("paint.exr")),
        gloss: Fixed(lobes: [
            (albedo: (0.05, 0.05, 0.05), roughness: 0.6),
            (albedo: (0.4, 0.3, 0.1), roughness: 0.2),
        ], weights: "weights.exr"),
    ),"#;
    let share: Vec<f32> = (0..64 * 64).map(|i| (i % 64) as f32 / 63.0).collect();
    let mut weights = ExrLayers { width: 64, height: 64, ..ExrLayers::default() };
    weights.channels.insert("weight0".to_owned(), share.iter().map(|x| 1.0 - x).collect());
    weights.channels.insert("weight1".to_owned(), share);
    write_channels(data.path("weights.exr"), &weights).unwrap();
    let passes = r#"Export(name: "export", formats: [Glb, Usda, Usdz])"#;
    data.run(&scene("Box(texture_size: 64)", blend, passes), "out", &["--quiet"]).succeeded();
    let textures = ["mesh_base_color.png", "mesh_reflectance.png", "mesh_roughness.png"];
    let text = data.text("out/export/mesh.usda");
    for name in textures {
        let size = image::image_dimensions(data.path(format!("out/export/{name}"))).unwrap();
        assert!(size == (64, 64) && text.contains(&format!("@{name}@")), "{name} {size:?}");
    }
    assert!(text.contains("@light.hdr@") && text.contains("upAxis = \"Y\""));
    assert!(data.path("out/export/mesh.usdz").exists());
    let glb = data.bytes("out/export/mesh.glb");
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let root: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    let material = &root["materials"][0];
    let specular = &material["extensions"]["KHR_materials_specular"];
    assert_eq!(root["images"].as_array().unwrap().len(), 3);
    assert_eq!(specular["specularTexture"], specular["specularColorTexture"]);
    assert_eq!(material["pbrMetallicRoughness"]["roughnessFactor"], 1.0);
}

// As a pass shows it.

const SHOWN: &str = r#"
        Render(name: "novel"),
        Edit(name: "painted", edits: [
            Diffuse(action: Set(0.1, 0.6, 0.2), region: Box(min: (-2, 0, -2), max: (2, 2, 2))),
            Roughness(action: Scale(0.5), region: Sphere(center: (0, 0, 0.8), radius: 0.7)),
        ]),
        Relight(name: "noon", light: Lobes(lobes: [(axis: (0, 1, 0), sharpness: 2, amplitude: (1, 1, 1))]), edits: [
            Specular(action: Set(0.9, 0.6, 0.3)),
        ]),
        Save(name: "saved"),
        Save(name: "saved_painted", of: "painted"),
        Save(name: "saved_noon", of: "noon"),
        Export(name: "export_noon", of: "noon"),
        Export(name: "export_painted", of: "painted"),
    "#;

#[test]
fn what_a_pass_shows_is_saved_and_opens_again_with_the_same_bits() {
    let data = Data::new();
    data.run(&known_scene(SHOWN), "out", &[]).succeeded();
    for (saved, shown) in [("saved", "novel"), ("saved_painted", "painted"), ("saved_noon", "noon")] {
        let again = format!("{saved}_again");
        data.run_file(&format!("out/{saved}/scene.ron"), &again, &[]).succeeded();
        data.same_pictures(&format!("out/{shown}"), &format!("{again}/novel"));
    }
    let read = |name: &str| read_material(&data.path(format!("out/{name}/mesh.glb")));
    let noon = read("export_noon").unwrap();
    let noon = noon.specular_albedo(&SpecularLobe::new(Vec3::ONE, noon.roughness));
    assert!((noon - Vec3::new(0.9, 0.6, 0.3)).abs().max_element() < 0.02, "{noon}");
    // The light of that pass lies beside it: brightest above, where it is white.
    let map = data.path("out/export_noon/light.hdr");
    let map = MapConvention::ThreeJs.to_lobelia(read_map(map).unwrap());
    let (up, down) = (map.sample_bilinear(Vec3::Y), map.sample_bilinear(Vec3::NEG_Y));
    assert!((up - Vec3::ONE).length() < 0.02 && down.max_element() < 0.03, "{up} {down}");
    // Two base materials are a texture of roughness, which is written and not read back.
    let painted = read("export_painted").map(|_| ()).unwrap_err().to_string();
    assert!(painted.contains("has a roughness texture"), "{painted}");
}

#[test]
fn a_mesh_without_its_material_and_a_pass_that_shows_nothing_else_are_refused() {
    let data = studio();
    let surface = r#"Mesh(path: "mesh.glb", texture_size: 64, own_material: true)"#;
    data.run(&scene(surface, "", ""), "out", &[]).refused(&["same material"]);
    data.run(&scene(surface, PAINTED, ""), "out", &[]).refused(&["own material is taken"]);
    for (of, near) in [("novel", "painted, noon"), ("painter", "painted")] {
        let passes = SHOWN.replacen(r#"of: "noon""#, &format!("of: {of:?}"), 1);
        data.run(&known_scene(&passes), "out", &[]).refused(&[of, near]);
        assert!(!data.path("out").exists());
    }
}
