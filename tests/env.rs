//! Environment lights from end to end: `lobelia env`, and maps that light the side of a sphere they
//! should.

use crate::common::{Data, GRAY_SPHERE, day, write_unchecked};
use glam::Vec3;
use lobelia::light::{EnvironmentMap, LightLobe, lobes_power, render_lobes};
use lobelia::spawn::light::{LightConventions, LightFile, read_light};
use lobelia::{codec::envmap::write_map_exr, codec::exr::ExrLayers, light::convention::MapConvention};

/// A folder with `sky.exr`, a small map of the light of [`day`].
fn folder() -> Data {
    let data = Data::bare();
    write_map_exr(&render_lobes(&day(), 64, 32), data.path("sky.exr")).unwrap();
    data
}

/// Runs a command of `lobelia env`, which succeeds; returns what it says.
#[track_caller]
fn env(data: &Data, words: &str) -> String {
    let arguments: Vec<&str> = words.split(' ').collect();
    let said = data.lobelia(&[&["env"], &arguments[..]].concat()).succeeded();
    said.stdout + &said.stderr
}

/// Expects one error that has all `words`, and no new file.
#[track_caller]
fn refused(data: &Data, arguments: &str, words: &[&str]) {
    let arguments: Vec<&str> = arguments.split(' ').collect();
    data.refuses(&[&["env"], &arguments[..]].concat(), words);
}

fn map_in(data: &Data, name: &str) -> EnvironmentMap {
    match read_light(&data.path(name), LightConventions::default()).unwrap().0 {
        LightFile::Map(map) => map,
        LightFile::Lobes(_) => panic!("{name} has lobes"),
    }
}

fn lobes_in(data: &Data, name: &str) -> Vec<LightLobe> {
    match read_light(&data.path(name), LightConventions::default()).unwrap().0 {
        LightFile::Lobes(lobes) => lobes,
        LightFile::Map(_) => panic!("{name} is a map"),
    }
}

#[test]
fn a_map_becomes_lobes_a_picture_and_a_map_again() {
    let data = folder();
    let said = env(&data, "fit sky.exr --lobes 6 --out sky.ron");
    assert!(said.contains("sky.ron") && said.contains("sky.png"), "{said}");
    assert_eq!(lobes_in(&data, "sky.ron").len(), 6);
    env(&data, "fit sky.exr --lobes 6 --out sky.npy --quiet");
    assert_eq!(lobes_in(&data, "sky.npy"), lobes_in(&data, "sky.ron"));
    env(&data, "render sky.ron --size 64x32 back.exr");
    let [back, sky] = ["back.exr", "sky.exr"].map(|name| map_in(&data, name));
    let black = sky.mean_squared_difference(&sky.scaled(Vec3::ZERO)).unwrap();
    assert!(back.mean_squared_difference(&sky).unwrap() < 1e-3 * black);
    env(&data, "render sky.npy back.png");
    let size = |name: &str| image::open(data.path(name)).unwrap().to_rgb8().dimensions();
    assert_eq!((size("back.png"), size("sky.png")), ((512, 256), (64, 64)));
}

/// A file that is read, or a picture that is somebody else's, is not replaced.
#[test]
fn a_light_is_never_written_over_what_it_is_made_of() {
    let data = folder();
    let refused = |arguments: &str, words: &[&str]| refused(&data, arguments, words);
    image::RgbImage::new(4, 4).save(data.path("sky.png")).unwrap();
    let (map, photograph) = (data.bytes("sky.exr"), data.bytes("sky.png"));
    let fit = "fit sky.exr --lobes 2 --out sky.ron";
    refused(fit, &["sky.png exists", "another name"]);
    data.write("sky.png", "no picture");
    refused(fit, &["sky.png exists"]);
    data.write("sky.png", &photograph);
    refused("render sky.exr ./sky.exr", &["the picture would replace", "sky.exr"]);
    refused("rotate sky.exr --euler 0,90,0 --out sky.exr", &["--out would replace"]);
    data.write("named.ron", r#"Map(path: "sky.exr", lobes: 2)"#);
    refused("render named.ron sky.exr", &["the picture would replace", "sky.exr"]);
    refused("rotate named.ron --euler 0,90,0 --out sky.exr", &["--out would replace"]);
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("sky.exr", data.path("link.exr")).unwrap();
        refused("render sky.exr link.exr", &["the picture would replace"]);
        refused("render link.exr sky.exr", &["the picture would replace"]);
    }
    assert!(data.bytes("sky.exr") == map && data.bytes("sky.png") == photograph);
    std::fs::remove_file(data.path("sky.png")).unwrap();
    // The picture of an earlier fit is.
    env(&data, fit);
    env(&data, "fit sky.exr --lobes 2 --out sky.npy");
}

#[test]
fn several_counts_make_a_table_and_options_change_the_light() {
    let data = folder();
    let said = env(&data, "fit sky.exr --lobes 2,4,8 --quiet");
    let errors: Vec<f64> = said.lines().filter_map(|l| l.split_whitespace().nth(1)?.parse().ok()).collect();
    assert!(errors.len() == 3 && errors[0] > errors[2], "{said}");
    env(&data, "fit sky.exr --lobes 8 --upper-hemisphere --white --out up.npy");
    for lobe in lobes_in(&data, "up.npy") {
        assert!(lobe.axis.y >= -1e-6 && lobe.amplitude.min_element() == lobe.amplitude.max_element());
    }
    refused(&data, "fit sky.exr --lobes 2,4 --out a.ron", &["several", "help:"]);
    refused(&data, "fit sky.exr --out a.txt", &["a.txt", ".ron"]);
    refused(&data, "fit sky.exr --lobes 0", &["1..=512"]);
}

#[test]
fn lights_are_turned_and_described() {
    let data = folder();
    LightFile::Lobes(day()).write(&data.path("l.ron"), LightConventions::default()).unwrap();
    env(&data, "rotate l.ron --euler 0,90,0 --out turned.ron");
    env(&data, "rotate l.ron --quaternion 0,1,0,1 --out too.npy");
    for name in ["turned.ron", "too.npy"] {
        for (turned, lobe) in lobes_in(&data, name).iter().zip(day()) {
            // A quarter about +Y takes +Z to +X.
            let expected = Vec3::new(lobe.axis.z, lobe.axis.y, -lobe.axis.x);
            assert!(turned.axis.distance(expected) < 1e-5, "{name}");
        }
    }
    env(&data, "rotate sky.exr --euler 0,-90,0 --out turned.exr");
    let d = Vec3::new(-0.6, 0.5, 0.6).normalize();
    let turned = map_in(&data, "turned.exr").sample_bilinear(d);
    assert!(turned.x > 2.0, "the bright spot went from +Z toward −X");
    let said = env(&data, "info l.ron");
    let power = format!("{:.4}", lobes_power(&day()).x);
    assert!(said.contains("3 lobes") && said.contains(&power) && said.contains("axis"), "{said}");
    assert!(env(&data, "info sky.exr").contains("64 × 32"));
    refused(&data, "rotate l.ron --euler 1,2 --out x.ron", &["3 numbers"]);
    refused(&data, "rotate l.ron --out x.ron", &["--euler"]);
    refused(&data, "rotate l.ron --quaternion 0,0,0,0 --out x.ron", &["zero"]);
    refused(&data, "rotate sky.exr --euler 0,1,0 --out x.ron", &["x.ron", "map"]);
}

#[test]
fn what_is_repaired_in_a_map_is_said() {
    let data = folder();
    let mut radiance = vec![Vec3::ONE; 16 * 8];
    (radiance[3].x, radiance[4].y) = (f32::INFINITY, -1.0);
    let mut layers = ExrLayers { width: 16, height: 8, ..ExrLayers::default() };
    layers.insert_triple(["R", "G", "B"], &radiance);
    write_unchecked(&data.path("repaired.exr"), &layers);
    let said = env(&data, "fit repaired.exr --lobes 2");
    assert!(said.contains("1 NaN or infinite") && said.contains("1 negative"), "{said}");
}

#[test]
fn one_bright_texel_lights_the_right_side_of_a_sphere() {
    use MapConvention::{Blender, Lobelia, ThreeJs};
    let data = Data::bare();
    // Columns 8, 16, 24 of 32 are a quarter, the middle, three quarters; rows 0 and 15 are the
    // poles.
    let cases = [
        (Lobelia, (8, 8), "right"),
        (Lobelia, (16, 8), "center"),
        (Lobelia, (24, 8), "left"),
        (Lobelia, (5, 0), "top"),
        (Lobelia, (5, 15), "bottom"),
        (ThreeJs, (16, 8), "right"),
        (ThreeJs, (24, 8), "center"),
        (ThreeJs, (0, 8), "left"),
        // Blender's +Z, its maps' top, looks into the camera; its −Y, at three quarters, is down in
        // this picture.
        (Blender, (16, 8), "right"),
        (Blender, (24, 8), "bottom"),
        (Blender, (5, 0), "center"),
    ];
    let shadings = ["Published", "PathTraced(spp: 32)"];
    let mut passes = String::new();
    for (case, (convention, (i, j), _)) in cases.iter().enumerate() {
        let mut map = EnvironmentMap::from_directions(32, 16, |_| Vec3::splat(0.01));
        // At a pole a row is one place.
        let columns = if [0, 15].contains(j) { 0..32 } else { *i..i + 1 };
        columns.for_each(|i| map.radiance[j * 32 + i] = Vec3::splat(40.0));
        write_map_exr(&map, data.path(format!("spot{case}.exr"))).unwrap();
        let light = format!(r#"Map(path: "spot{case}.exr", lobes: 4, convention: {convention:?})"#);
        for (k, shading) in shadings.iter().enumerate() {
            passes +=
                &format!(r#"Relight(name: "lit{case}_{k}", light: {light}, render: (shading: {shading})), "#);
        }
    }
    // Seen from +Z with +X to the right.
    let scene = GRAY_SPHERE
        .replace("3), width: 16, height: 16", "6), fov_degrees: 20, width: 33, height: 33")
        .replace("(0.1, 0.1, 0.1), roughness: Fixed(0.3)", "(0, 0, 0), roughness: Fixed(1)")
        .replace("{PASS}", &passes);
    data.run(&scene, "out", &["--quiet"]).succeeded();
    let places = [("left", 5, 16), ("right", 27, 16), ("top", 16, 5), ("bottom", 16, 27), ("center", 16, 16)];
    for (case, (convention, texel, side)) in cases.iter().enumerate() {
        for (k, shading) in shadings.iter().enumerate() {
            let red = &data.exr(format!("out/lit{case}_{k}/a.exr")).channels["R"];
            let at = |&(_, x, y): &(&str, usize, usize)| red[y * 33 + x];
            let found = places.iter().max_by(|a, b| at(a).total_cmp(&at(b))).unwrap().0;
            assert_eq!(found, *side, "{convention:?} {texel:?} {shading}");
        }
    }
}
