//! `Save` and `Export` write the object as an `Edit` or `Relight` pass shows it, if asked to.

use crate::common::{Data, Outcome, command};
use lobelia::codec::exr::read_exr_layers;
use lobelia::codec::gltf::material::read_material;
use lobelia::light::EnvironmentMap;
use lobelia::light::convention::MapConvention;
use lobelia::material::SpecularLobe;

const SCENE: &str = r#"
Scene(
    version: 1,
    surface: Mesh(path: "$DATA/mesh.glb", texture_size: 32),
    views: Dataset(path: "$DATA"),
    light: Fixed(Npy(path: "$DATA/evening.npy")),
    material: (
        albedo: Fixed(Constant(0.5, 0.4, 0.3)),
        specular: (albedo: Fixed(0.2, 0.2, 0.2), roughness: Fixed(0.4)),
    ),
    visibility: None,
    passes: [
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
    ],
)
"#;

fn again(data: &Data, saved: &str) -> String {
    let out = format!("{saved}_again");
    let scene = data.path(&format!("out/{saved}/scene.ron"));
    let run = ["run", "--allow-outside", "--out", data.path(&out).to_str().unwrap()].map(str::to_owned);
    Outcome::of(command(&[]).args(run).arg(scene)).succeeded();
    out
}

#[test]
fn what_a_pass_shows_is_saved_and_opens_again_with_the_same_bits() {
    let data = Data::new();
    data.run(SCENE, "out", &[]).succeeded();
    for (saved, shown) in [("saved", "novel"), ("saved_painted", "painted"), ("saved_noon", "noon")] {
        let out = again(&data, saved);
        for view in ["rgb_000000", "rgb_000001"] {
            let file = |folder: &str| read_exr_layers(data.path(&format!("{folder}/{view}.exr"))).unwrap();
            let (again, first) = (file(&format!("{out}/novel")), file(&format!("out/{shown}")));
            for (channel, values) in &first.channels {
                assert!(again.channels[channel] == *values, "{saved}, {view}, {channel}");
            }
        }
    }
    let read = |name: &str| read_material(&data.path(&format!("out/{name}/mesh.glb")));
    let noon = read("export_noon").unwrap();
    let noon = noon.specular_albedo(&SpecularLobe::new(glam::Vec3::ONE, noon.roughness));
    assert!((noon - glam::Vec3::new(0.9, 0.6, 0.3)).abs().max_element() < 0.02, "{noon}");
    // The light of that pass lies beside it: brightest above, where it is white.
    let map = data.path("out/export_noon/light.hdr");
    let map = MapConvention::ThreeJs.to_lobelia(EnvironmentMap::read(map).unwrap());
    let (up, down) = (map.sample_bilinear(glam::Vec3::Y), map.sample_bilinear(glam::Vec3::NEG_Y));
    assert!((up - glam::Vec3::ONE).length() < 0.02 && down.max_element() < 0.03, "{up} {down}");
    // Two base materials are a texture of roughness, which is written and not read back.
    let painted = read("export_painted").map(|_| ()).unwrap_err().to_string();
    assert!(painted.contains("has a roughness texture"), "{painted}");
}

#[test]
fn a_pass_that_shows_nothing_else_is_refused() {
    let data = Data::new();
    for (of, near) in [("novel", "painted, noon"), ("painter", "painted")] {
        let scene = SCENE.replace(r#"of: "noon""#, &format!("of: {of:?}"));
        let outcome = data.run(&scene, "out", &[]);
        assert_eq!(outcome.code, Some(2));
        assert!(outcome.stderr.contains(of) && outcome.stderr.contains(near), "{}", outcome.stderr);
        assert!(!data.path("out").exists());
    }
}
