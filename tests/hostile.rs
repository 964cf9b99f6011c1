//! Hostile, damaged and senseless input: one clear message that names the file, exit code 2, little
//! time, little memory, and nothing written; never a panic. What may be odd but is understood is
//! taken. Readers of files have such tests of their own, of every kind.

use crate::common::{self, *};
use image::{DynamicImage, GrayImage, Luma};
use std::process::{Command, Stdio};
use std::{sync::mpsc::channel, time::Duration};

/// Most address space of the program here, in KiB: hostile input must not take what the machine
/// has.
const MOST_KIB: u32 = 3 << 20;
/// Most seconds; a debug build on a busy machine is slow, and what is hostile takes minutes or
/// never ends.
const MOST_SECS: u64 = 60;

const LIGHT: &str = "Lobes(lobes: [(axis: (1, 0.2, 0.5), sharpness: 4, amplitude: (1, 1, 1))])";
const CAMERA: &str = r#"(name: "a", eye: (0, 0, 3), width: 16, height: 16)"#;

/// A scene that is right and small, with `from` replaced by `to`.
#[track_caller]
fn small(from: &str, to: &str) -> String {
    changed(&GRAY_SPHERE.replace("{PASS}", NOVEL), from, to)
}

/// A folder with `scene.ron`.
fn with_scene(text: impl AsRef<[u8]>) -> Data {
    let folder = Data::bare();
    folder.write("scene.ron", text);
    folder
}

/// Makes a file that has this many bytes and takes no room.
fn write_sparse(folder: &Data, file: &str, bytes: u64) {
    std::fs::File::create(folder.path(file)).unwrap().set_len(bytes).unwrap();
}

/// Runs the program in a folder, with bounded memory and time.
fn bounded(folder: &Data, arguments: &[&str]) -> Outcome {
    let mut run = common::command(&[]);
    if cfg!(unix) {
        run = Command::new("sh");
        run.args(["-c", &format!("ulimit -v {MOST_KIB}; exec \"$@\""), "sh"]);
        run.arg(env!("CARGO_BIN_EXE_lobelia"));
    }
    // An arena for each thread would count as address space.
    run.args(arguments).current_dir(folder.root()).env("MALLOC_ARENA_MAX", "2").stdin(Stdio::null());
    let child = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let (sender, ended) = channel();
    std::thread::spawn(move || sender.send(child.wait_with_output()));
    let output = ended.recv_timeout(Duration::from_secs(MOST_SECS));
    output.unwrap_or_else(|_| panic!("{arguments:?} still runs after {MOST_SECS} s")).unwrap().into()
}

/// Expects that the command is refused with one short message that has all `words`, and that no
/// file is new.
#[track_caller]
fn refuses(folder: &Data, arguments: &[&str], words: &[&str]) {
    let before = files_below(folder.root());
    bounded(folder, arguments).refused(words);
    assert_eq!(files_below(folder.root()), before);
}

/// Expects that `check` and `run` refuse the scene.
#[track_caller]
fn refuse_scene(folder: &Data, words: &[&str]) {
    refuses(folder, &["check", "scene.ron"], words);
    refuse_run(folder, words);
}

#[track_caller]
fn refuse_run(folder: &Data, words: &[&str]) {
    refuses(folder, &["run", "scene.ron", "--out", "out", "--quiet"], words);
}

/// Without this, the refusals below could have any reason.
#[test]
fn the_right_scene_is_taken_also_with_a_byte_order_mark() {
    let folder = with_scene(format!("\u{feff}{}", small("version", "visibility: None, version")));
    bounded(&folder, &["run", "scene.ron", "--out", "out", "--quiet"]).succeeded();
    let layers = folder.exr("out/novel/a.exr");
    assert!(layers.channels.values().flatten().all(|value| value.is_finite()));
    assert!(!files_below(folder.root()).iter().any(|file| is_temporary(file)));
}

#[test]
fn scenes_with_long_lines_and_that_are_no_text_or_would_take_much_memory() {
    let one_line = small("texture_size: 16", "radius: -1").replace('\n', " ");
    let comment = one_line.replace("version", &format!("/*{}*/ version", "é".repeat(1_000_000)));
    let name = small("\"a\"", &format!("{:?}", "x".repeat(65_536)));
    for (text, words) in [
        (comment.into_bytes(), ["radius is -1", "scene.ron:1:"]),
        (name.into_bytes(), ["name is \"xxx", "1 to 100"]),
        (vec![b'(', 0xff, 0xfe], ["byte 1", "UTF-8"]),
    ] {
        refuse_scene(&with_scene(text), &words);
    }
    let folder = with_scene("");
    write_sparse(&folder, "scene.ron", 100 << 20);
    refuse_scene(&folder, &["the file has 100.0 MiB", "at most 16.0 MiB are read"]);
    let folder = Data::bare();
    std::fs::create_dir(folder.path("scene.ron")).unwrap();
    refuse_scene(&folder, &["this is a folder"]);
    let cameras = format!("{CAMERA}, ").repeat(3000);
    let Outcome { code, stderr, .. } = bounded(&with_scene(small(CAMERA, &cameras)), &["check", "scene.ron"]);
    assert!(code == Some(2) && stderr.len() < 20_000, "{} bytes", stderr.len());
    assert!(stderr.contains("2999 problems") && stderr.contains("and 2979 more"), "{stderr}");
}

#[cfg(unix)]
#[test]
fn pipes_devices_and_broken_links() {
    let folder = with_scene("");
    let made = Command::new("mkfifo").arg(folder.path("pipe.ron")).arg(folder.path("pipe.exr")).status();
    assert!(made.unwrap().success());
    for command in [["check"].as_slice(), &["run"], &["env", "info"]] {
        refuses(&folder, &[command, &["pipe.ron"]].concat(), &["pipe.ron: this is a pipe"]);
    }
    refuses(&folder, &["env", "info", "pipe.exr"], &["pipe.exr: this is a pipe"]);
    refuses(&folder, &["eval", "pipe.exr", "pipe.exr"], &["this is a pipe"]);
    std::os::unix::fs::symlink("nowhere.npy", folder.path("link.npy")).unwrap();
    for (light, words) in [
        (r#"Npy(path: "/dev/zero")"#, "/dev/zero: this is a device"),
        (r#"Map(path: "pipe.exr")"#, "pipe.exr: this is a pipe"),
        (r#"Npy(path: "link.npy")"#, "symbolic link to nowhere.npy, which does not exist"),
    ] {
        folder.write("scene.ron", small(LIGHT, light));
        refuse_scene(&folder, &[words]);
    }
}

#[test]
fn maps_without_light_or_with_too_much() {
    let map = r#"Map(path: "below.hdr", lobes: 2, scale: 1e30)"#;
    let folder = with_scene(small(LIGHT, map));
    // A Radiance picture of 8 × 4 texels.
    let head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n";
    folder.write("below.hdr", [&head[..], &[0; 64], &[200, 200, 200, 129].repeat(16)].concat());
    let fit = ["env", "fit", "below.hdr", "--lobes", "2", "--quiet"];
    let words = ["below.hdr", "the map gives no light from above"];
    refuses(&folder, &[&fit[..], &["--upper-hemisphere"]].concat(), &words);
    refuse_run(&folder, &["below.hdr: texel (0, 2) has radiance"]);
    let said = bounded(&folder, &fit).succeeded().stdout;
    assert!(!said.contains("NaN") && !said.contains("inf"), "{said}");
}

#[test]
fn pictures_that_take_more_memory_than_there_may_be() {
    let made = format!(
        "Photographed(cameras: (count: 1000, size: 4096), truth: (albedo: Constant(0.5, 0.5, 0.5), \
         specular: (albedo: (0, 0, 0), roughness: 1), light: {LIGHT}))"
    );
    let folder = with_scene(small(&format!("Cameras([{CAMERA}])"), &made));
    refuse_scene(&folder, &["photographs of 4096×4096 pixels takes"]);
    folder.write("light.ron", LIGHT);
    let render = ["env", "render", "light.ron", "--size", "16384x16384", "a.exr"];
    refuses(&folder, &render, &["a map of 16384×16384 pixels takes 9.0 GiB"]);
}

#[test]
#[cfg(target_os = "linux")]
fn runs_that_take_more_memory_than_their_process_may_have() {
    let large = small("texture_size: 16", "texture_size: 4096");
    let traced = changed(&large, "version", "visibility: Traced(directions: 4096), version");
    let folder = with_scene(traced);
    // Three quarters of the limit of the address space.
    refuse_scene(&folder, &["this run takes about", "2.2 GiB are allowed", "--memory"]);
}

// Photographs, meshes and lights that are damaged or senseless.

const UNKNOWN: &str = "light: Unknown(lobes: 6),";

/// A scene that is right for [`Data::new`], with `from` replaced by `to`.
#[track_caller]
fn scene(from: &str, to: &str) -> String {
    changed(&common::scene(&[FIT, NOVEL].concat()), from, to)
}

/// Expects that `scene` with this data is refused before anything is written, with all `words`.
#[track_caller]
fn refused_scene(data: &Data, scene: &str, words: &[&str]) {
    data.run(scene, "out", &["--quiet"]).refused(words);
    assert!(!data.path("out").exists(), "something was written: {:?}", files_below(&data.path("out")));
}

/// Breaks sound data and expects that the right scene is refused.
#[track_caller]
fn refused(damage: impl FnOnce(&Data), words: &[&str]) {
    let data = Data::new();
    damage(&data);
    refused_scene(&data, &scene(NOVEL, NOVEL), words);
}

/// Cuts a file to the given part of its length.
fn cut(data: &Data, file: &str, part: f64) {
    let bytes = data.bytes(file);
    data.write(file, &bytes[..(bytes.len() as f64 * part) as usize]);
}

#[test]
fn photographs_and_masks_that_are_cut_missing_empty_or_of_another_size() {
    for part in [0.0, 0.5] {
        refused(|data| cut(data, "train/image/rgb_000001.exr", part), &["rgb_000001.exr"]);
    }
    refused(|data| cut(data, "train/mask/rgb_000003.png", 0.5), &["rgb_000003.png"]);
    let remove = |file: &'static str| move |data: &Data| std::fs::remove_file(data.path(file)).unwrap();
    refused(remove("train/mask/rgb_000002.png"), &["rgb_000002", "missing"]);
    refused(remove("test/image/rgb_000001.exr"), &["rgb_000001.exr", "missing"]);
    let small = DynamicImage::ImageLuma8(GrayImage::from_pixel(8, 24, Luma([255])));
    let words = ["rgb_000001.png", "8×24", "24×24"];
    // What is needed last is checked first, too.
    refused(|data| save_png(&data.path("test/mask/rgb_000001.png"), &small), &words);
}

#[test]
fn nan_and_infinite_pixels_are_repaired_counted_and_reported() {
    let data = Data::new();
    data.change_image("train/image/rgb_000001.exr", |image| {
        let red = image.channels.get_mut("R").unwrap();
        (red[300], red[301]) = (f32::NAN, f32::INFINITY);
    });
    data.change_image("test/image/rgb_000000.exr", |image| {
        image.channels.get_mut("B").unwrap()[290] = f32::NEG_INFINITY;
    });
    let outcome = data.run(&scene(NOVEL, NOVEL), "out", &[]).succeeded();
    for words in ["3 NaN or infinite pixels", "rgb_000001: 2", "rgb_000000: 1"] {
        assert!(outcome.stderr.contains(words), "no {words:?} in\n{}", outcome.stderr);
    }
    for view in ["rgb_000000", "rgb_000001"] {
        let picture = data.exr(format!("out/novel/{view}.exr"));
        assert!(picture.channels.values().flatten().all(|v| v.is_finite()));
        assert!(picture.channels["R"].iter().any(|v| *v > 0.05), "the object is there");
    }
}

#[test]
fn meshes_and_lights_that_are_damaged_and_values_that_cannot_be() {
    refused(|data| cut(data, "mesh.glb", 0.5), &["mesh.glb"]);
    let data = Data::new();
    refused_scene(&data, &scene(UNKNOWN, "light: Unknown(lobes: 0),"), &["lobes is 0", "from 1 to 2048"]);
    let edit = r#"Edit(name: "novel", edits: [Roughness(action: Set(0))]),"#;
    refused_scene(&data, &scene(NOVEL, edit), &["from 0.03 to 1"]);
    let light = scene(UNKNOWN, r#"light: Initial(Npy(path: "$DATA/evening.npy")),"#);
    data.run(&light, "sound", &["--quiet"]).succeeded();
    cut(&data, "evening.npy", 0.8);
    refused_scene(&data, &light, &["evening.npy"]);
    let later = scene(NOVEL, r#"Relight(name: "novel", light: Npy(path: "$DATA/evening.npy")),"#);
    data.run(&later, "out", &["--quiet"]).refused(&["evening.npy"]);
    let files = files_below(&data.path("out"));
    assert!(!files.iter().any(|f| f.starts_with("novel/") || is_temporary(f)), "{files:?}");
}

#[test]
fn truths_that_do_not_fit() {
    let evaluate = r#"Render(name: "novel"), Evaluate(scores: [(pass: "novel", truth: Folder("$DATA/test/gt/relit"))]),"#;
    let (data, scene) = (Data::new(), scene(NOVEL, evaluate));
    let truth = "test/gt/relit/rgb_000001.exr";
    cut(&data, truth, 0.7);
    data.run(&scene, "out", &["--quiet"]).refused(&["rgb_000001.exr"]);
    std::fs::remove_file(data.path(truth)).unwrap();
    data.run(&scene, "out2", &["--quiet"]).refused(&["rgb_000001.exr"]);
    write_image(&data.path(truth), &[glam::Vec3::ONE; 16 * 36], 16);
    data.run(&scene, "out3", &["--quiet"]).refused(&["rgb_000001.exr", "16×36", "24×24"]);
}
