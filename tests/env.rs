//! Environment lights from end to end: `lobelia env`, and maps that light the side of a sphere they should.

use crate::common::{Data, Outcome, command, files_below, write_unchecked};
use glam::Vec3;
use lobelia::codec::envmap::write_map_exr;
use lobelia::codec::exr::ExrLayers;
use lobelia::light::convention::MapConvention;
use lobelia::light::{EnvironmentMap, LightLobe, lobes_power, render_lobes};
use lobelia::spawn::light::{LightConventions, LightFile, read_light};
use std::path::{Path, PathBuf};

fn lobes() -> Vec<LightLobe> {
    let lobe = |axis: Vec3, sharpness, amplitude| LightLobe { axis: axis.normalize(), sharpness, amplitude };
    vec![
        lobe(Vec3::Y, 1.5, Vec3::new(0.3, 0.4, 0.6)),
        lobe(Vec3::new(0.5, 0.6, 0.6), 40.0, Vec3::new(4.0, 3.0, 2.0)),
        lobe(Vec3::new(-0.9, -0.2, 0.3), 12.0, Vec3::new(0.8, 0.3, 0.2)),
    ]
}

struct Folder(Data);

impl Folder {
    /// A folder with `sky.exr`, a small map of [`lobes`].
    fn new() -> Self {
        let folder = Self(Data::bare());
        write_map_exr(&render_lobes(&lobes(), 64, 32), folder.path("sky.exr")).unwrap();
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path(name)
    }

    fn env(&self, arguments: &[&str]) -> Outcome {
        Outcome::of(command(&["env"]).args(arguments).current_dir(self.0.root()))
    }

    fn light(&self, name: &str) -> LightFile {
        read_light(&self.path(name), LightConventions::default()).unwrap().0
    }

    fn lobes(&self, name: &str) -> Vec<LightLobe> {
        match self.light(name) {
            LightFile::Lobes(lobes) => lobes,
            LightFile::Map(_) => panic!("{name} is a map"),
        }
    }

    /// Expects one error that has all `words`, and no new file.
    #[track_caller]
    fn refused(&self, arguments: &[&str], words: &[&str]) {
        let before = files_below(self.0.root());
        self.env(arguments).refused(words);
        assert_eq!(files_below(self.0.root()), before);
    }
}

#[test]
fn a_map_becomes_lobes_a_picture_and_a_map_again() {
    let folder = Folder::new();
    let said = folder.env(&["fit", "sky.exr", "--lobes", "6", "--out", "sky.ron"]).succeeded();
    assert!(said.stdout.contains("sky.ron") && said.stdout.contains("sky.png"), "{}", said.stdout);
    assert_eq!(folder.lobes("sky.ron").len(), 6);
    folder.env(&["fit", "sky.exr", "--lobes", "6", "--out", "sky.npy", "--quiet"]).succeeded();
    assert_eq!(folder.lobes("sky.npy"), folder.lobes("sky.ron"));
    folder.env(&["render", "sky.ron", "--size", "64x32", "back.exr"]).succeeded();
    let (LightFile::Map(back), LightFile::Map(sky)) = (folder.light("back.exr"), folder.light("sky.exr"))
    else {
        panic!("maps are maps");
    };
    let black = sky.mean_squared_difference(&sky.scaled(Vec3::ZERO)).unwrap();
    assert!(back.mean_squared_difference(&sky).unwrap() < 1e-3 * black);
    folder.env(&["render", "sky.npy", "back.png"]).succeeded();
    let size = |name: &str| image::open(folder.path(name)).unwrap().to_rgb8().dimensions();
    assert_eq!((size("back.png"), size("sky.png")), ((512, 256), (64, 64)));
}

/// A file that is read, or a picture that is somebody else's, is not replaced.
#[test]
fn a_light_is_never_written_over_what_it_is_made_of() {
    let folder = Folder::new();
    let bytes = |name: &str| std::fs::read(folder.path(name)).unwrap();
    let picture = image::RgbImage::new(4, 4);
    picture.save(folder.path("sky.png")).unwrap();
    let (map, photograph) = (bytes("sky.exr"), bytes("sky.png"));
    folder.refused(
        &["fit", "sky.exr", "--lobes", "2", "--out", "sky.ron"],
        &["sky.png exists", "another name"],
    );
    std::fs::write(folder.path("sky.png"), "no picture").unwrap();
    folder.refused(&["fit", "sky.exr", "--lobes", "2", "--out", "sky.ron"], &["sky.png exists"]);
    std::fs::write(folder.path("sky.png"), &photograph).unwrap();
    folder.refused(&["render", "sky.exr", "./sky.exr"], &["the picture would replace", "sky.exr"]);
    folder.refused(&["rotate", "sky.exr", "--euler", "0,90,0", "--out", "sky.exr"], &["--out would replace"]);
    std::fs::write(folder.path("named.ron"), r#"Map(path: "sky.exr", lobes: 2)"#).unwrap();
    folder.refused(&["render", "named.ron", "sky.exr"], &["the picture would replace", "sky.exr"]);
    folder
        .refused(&["rotate", "named.ron", "--euler", "0,90,0", "--out", "sky.exr"], &["--out would replace"]);
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("sky.exr", folder.path("link.exr")).unwrap();
        folder.refused(&["render", "sky.exr", "link.exr"], &["the picture would replace"]);
        folder.refused(&["render", "link.exr", "sky.exr"], &["the picture would replace"]);
    }
    assert!(bytes("sky.exr") == map && bytes("sky.png") == photograph);
    std::fs::remove_file(folder.path("sky.png")).unwrap();
    // The picture of an earlier fit is.
    for out in ["sky.ron", "sky.npy"] {
        folder.env(&["fit", "sky.exr", "--lobes", "2", "--out", out, "--quiet"]).succeeded();
    }
}

#[test]
fn several_counts_make_a_table_and_options_change_the_light() {
    let folder = Folder::new();
    let said = folder.env(&["fit", "sky.exr", "--lobes", "2,4,8", "--quiet"]).succeeded();
    let errors: Vec<f64> =
        said.stdout.lines().skip(1).map(|l| l.split_whitespace().nth(1).unwrap().parse().unwrap()).collect();
    assert!(errors.len() == 3 && errors[0] > errors[2], "{}", said.stdout);
    let up = ["fit", "sky.exr", "--lobes", "8", "--upper-hemisphere", "--white", "--out", "up.npy"];
    folder.env(&up).succeeded();
    for lobe in folder.lobes("up.npy") {
        assert!(lobe.axis.y >= -1e-6 && lobe.amplitude.min_element() == lobe.amplitude.max_element());
    }
    folder.refused(&["fit", "sky.exr", "--lobes", "2,4", "--out", "a.ron"], &["several", "help:"]);
    folder.refused(&["fit", "sky.exr", "--out", "a.txt"], &["a.txt", ".ron"]);
    folder.refused(&["fit", "sky.exr", "--lobes", "0"], &["1..=512"]);
}

#[test]
fn lights_are_turned_and_described() {
    let folder = Folder::new();
    LightFile::Lobes(lobes()).write(&folder.path("l.ron"), LightConventions::default()).unwrap();
    folder.env(&["rotate", "l.ron", "--euler", "0,90,0", "--out", "turned.ron"]).succeeded();
    folder.env(&["rotate", "l.ron", "--quaternion", "0,1,0,1", "--out", "too.npy"]).succeeded();
    for ((turned, too), lobe) in folder.lobes("turned.ron").iter().zip(folder.lobes("too.npy")).zip(lobes()) {
        // A quarter about +Y takes +Z to +X.
        let expected = Vec3::new(lobe.axis.z, lobe.axis.y, -lobe.axis.x);
        assert!(turned.axis.distance(expected) < 1e-5 && too.axis.distance(expected) < 1e-5);
    }
    folder.env(&["rotate", "sky.exr", "--euler", "0,-90,0", "--out", "turned.exr"]).succeeded();
    let LightFile::Map(turned) = folder.light("turned.exr") else { panic!("a map") };
    let d = Vec3::new(-0.6, 0.6, 0.5).normalize();
    assert!(turned.sample_bilinear(d).x > 2.0, "the bright spot went from +Z toward −X");
    let said = folder.env(&["info", "l.ron"]).succeeded().stdout;
    let power = format!("{:.4}", lobes_power(&lobes()).x);
    assert!(said.contains("3 lobes") && said.contains(&power) && said.contains("axis"), "{said}");
    assert!(folder.env(&["info", "sky.exr"]).succeeded().stdout.contains("64 × 32"));
    folder.refused(&["rotate", "l.ron", "--euler", "1,2", "--out", "x.ron"], &["3 numbers"]);
    folder.refused(&["rotate", "l.ron", "--out", "x.ron"], &["--euler"]);
    folder.refused(&["rotate", "l.ron", "--quaternion", "0,0,0,0", "--out", "x.ron"], &["zero"]);
    folder.refused(&["rotate", "sky.exr", "--euler", "0,1,0", "--out", "x.ron"], &["x.ron", "map"]);
}

/// Writes a map as another program might.
fn write_map(path: &Path, map: &EnvironmentMap) {
    let mut layers = ExrLayers { width: map.width, height: map.height, ..ExrLayers::default() };
    layers.insert_triple(["R", "G", "B"], &map.radiance);
    write_unchecked(path, &layers);
}

#[test]
fn bad_maps_are_refused_with_one_message() {
    let folder = Folder::new();
    let flat = |w: u32, h: u32, value: f32| EnvironmentMap::from_directions(w, h, |_| Vec3::splat(value));
    for (name, map, word) in
        [("square.exr", flat(16, 16, 1.0), "16 × 16"), ("black.exr", flat(16, 8, 0.0), "black")]
    {
        write_map(&folder.path(name), &map);
        folder.refused(&["fit", name, "--out", "a.ron"], &[name, word, "help:"]);
    }
    folder.refused(&["info", "none.exr"], &["no such file"]);
    let mut repaired = flat(16, 8, 1.0);
    repaired.radiance[3].x = f32::INFINITY;
    repaired.radiance[4].y = -1.0;
    write_map(&folder.path("repaired.exr"), &repaired);
    let said = folder.env(&["fit", "repaired.exr", "--lobes", "2"]).succeeded().stderr;
    assert!(said.contains("1 NaN or infinite") && said.contains("1 negative"), "{said}");
}

#[test]
fn one_bright_texel_lights_the_right_side_of_a_sphere() {
    use MapConvention::{Blender, Lobelia, ThreeJs};
    let folder = Folder::new();
    // Columns 8, 16, 24 of 32 are a quarter, the middle, three quarters; rows 0 and 15 are the poles.
    let cases = [
        (Lobelia, (8, 8), "right"),
        (Lobelia, (16, 8), "center"),
        (Lobelia, (24, 8), "left"),
        (Lobelia, (5, 0), "top"),
        (Lobelia, (5, 15), "bottom"),
        (ThreeJs, (16, 8), "right"),
        (ThreeJs, (24, 8), "center"),
        (ThreeJs, (0, 8), "left"),
        // Blender's +Z, its maps' top, looks into the camera; its −Y, at three quarters, is down in this picture.
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
        write_map_exr(&map, folder.path(&format!("spot{case}.exr"))).unwrap();
        let light = format!(r#"Map(path: "spot{case}.exr", lobes: 4, convention: {convention:?})"#);
        for (k, shading) in shadings.iter().enumerate() {
            passes +=
                &format!(r#"Relight(name: "lit{case}_{k}", light: {light}, render: (shading: {shading})), "#);
        }
    }
    // Seen from +Z with +X to the right.
    let scene = format!(
        r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.9, texture_size: 8),
    views: Cameras([(name: "front", eye: (0, 0, 6), fov_degrees: 20, width: 33, height: 33)]),
    light: Fixed(Map(path: "spot0.exr", lobes: 4)),
    material: (albedo: Fixed(Constant(0.8, 0.8, 0.8)), specular: (albedo: Fixed(0, 0, 0), roughness: Fixed(1))),
    passes: [{passes}],
)"#
    );
    folder.0.run(&scene, "out", &["--quiet"]).succeeded();
    let places = [("left", 5, 16), ("right", 27, 16), ("top", 16, 5), ("bottom", 16, 27), ("center", 16, 16)];
    for (case, (convention, texel, side)) in cases.iter().enumerate() {
        for (k, shading) in shadings.iter().enumerate() {
            let red = &folder.0.exr(format!("out/lit{case}_{k}/front.exr")).channels["R"];
            let at = |&(_, x, y): &(&str, usize, usize)| red[y * 33 + x];
            let found = places.iter().max_by(|a, b| at(a).total_cmp(&at(b))).unwrap().0;
            assert_eq!(found, *side, "{convention:?} {texel:?} {shading}");
        }
    }
}
