//! Inputs that could take all time or memory, or end in a panic: one clear message, exit code 2, little time, little memory, and
//! nothing written. What may be odd but is understood is taken.

use crate::common::{Outcome, files_below, is_temporary};
use lobelia::codec::exr::read_exr_layers;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Most address space of the program here, in KiB: hostile input must not take what the machine has.
const MOST_KIB: u32 = 3 << 20;
/// Most seconds; a debug build on a busy machine is slow, and what is hostile takes minutes or never ends.
const MOST_SECS: u64 = 60;

const LIGHT: &str = "Lobes(lobes: [(axis: (0, 1, 0), sharpness: 5, amplitude: (1, 1, 1))])";
const SPHERE: &str = "Sphere(radius: 0.8, texture_size: 16)";
const CAMERA: &str = r#"(name: "front", eye: (0, 0, 3), width: 16, height: 16)"#;

/// A scene that is right and small.
fn right() -> String {
    format!(
        r#"Scene(
    version: 1,
    surface: {SPHERE},
    views: Cameras([{CAMERA}]),
    light: Fixed({LIGHT}),
    material: (albedo: Fixed(Constant(0.5, 0.5, 0.5)), specular: (albedo: Fixed(0.2, 0.2, 0.2), roughness: Fixed(0.3))),
    visibility: None,
    passes: [Render(name: "novel")],
)
"#
    )
}

/// The right scene with `from` replaced by `to`.
#[track_caller]
fn scene(from: &str, to: &str) -> String {
    assert_eq!(right().matches(from).count(), 1, "{from:?} must be there once");
    right().replace(from, to)
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn with_scene(text: impl AsRef<[u8]>) -> Self {
        let folder = Self::new();
        std::fs::write(folder.path("scene.ron"), text).unwrap();
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Runs the program in this folder, with bounded memory and time.
    #[track_caller]
    fn lobelia(&self, arguments: &[&str]) -> Outcome {
        let program = env!("CARGO_BIN_EXE_lobelia");
        let mut command = if cfg!(unix) {
            let mut shell = Command::new("sh");
            let line = format!("ulimit -v {MOST_KIB}; exec \"$@\"");
            shell.args(["-c", &line, "sh", program]);
            shell
        } else {
            Command::new(program)
        };
        // An arena for each thread would count as address space.
        command.args(arguments).current_dir(self.0.path()).env("MALLOC_ARENA_MAX", "2");
        let [stdout, stderr] = ["stdout", "stderr"].map(|name| tempfile::tempfile().expect(name));
        let handle = |file: &std::fs::File| Stdio::from(file.try_clone().unwrap());
        command.stdin(Stdio::null()).stdout(handle(&stdout)).stderr(handle(&stderr));
        let (mut child, started) = (command.spawn().unwrap(), Instant::now());
        let code = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break status.code();
            }
            if started.elapsed() > Duration::from_secs(MOST_SECS) {
                child.kill().unwrap();
                panic!("{arguments:?} still runs after {MOST_SECS} s");
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        Outcome { code, stdout: text(stdout), stderr: text(stderr) }
    }

    /// Expects that the command is refused with one short message that has all `words`, and that no file is new.
    #[track_caller]
    fn refused(&self, arguments: &[&str], words: &[&str]) {
        let before = files_below(self.0.path());
        let Outcome { code, stderr, .. } = self.lobelia(arguments);
        assert_eq!(code, Some(2), "{stderr}");
        assert!(!stderr.contains("panicked"), "{stderr}");
        for word in words {
            assert!(flat(&stderr).contains(word), "no {word:?} in\n{stderr}");
        }
        assert_eq!(stderr.matches("error: ").count(), 1, "one message, not:\n{stderr}");
        assert!(stderr.len() < 3000, "a short message, not {} bytes", stderr.len());
        assert_eq!(files_below(self.0.path()), before);
    }

    /// Expects that `check` and `run` refuse the scene.
    #[track_caller]
    fn refused_by_both(&self, words: &[&str]) {
        self.refused(&["check", "scene.ron"], words);
        self.refused(&["run", "scene.ron", "--out", "out", "--quiet"], words);
    }

    /// Expects that `run` refuses the scene.
    #[track_caller]
    fn refused_run(&self, words: &[&str]) {
        self.refused(&["run", "scene.ron", "--out", "out", "--quiet"], words);
    }

    /// Runs the scene, and expects finite pictures.
    #[track_caller]
    fn runs(&self) {
        self.lobelia(&["run", "scene.ron", "--out", "out", "--force", "--quiet"]).succeeded();
        let layers = read_exr_layers(self.path("out/novel/front.exr")).unwrap();
        assert!(layers.channels.values().flatten().all(|value| value.is_finite()));
        assert!(!files_below(self.0.path()).iter().any(|file| is_temporary(file)));
    }
}

/// What was written into a file without a name.
fn text(mut file: std::fs::File) -> String {
    use std::io::{Read as _, Seek as _};
    let mut bytes = Vec::new();
    file.rewind().unwrap();
    file.read_to_end(&mut bytes).unwrap();
    String::from_utf8(bytes).unwrap()
}

/// The text on one line, so that a wrapped sentence is found.
fn flat(text: &str) -> String {
    let words = text.split(|c: char| c.is_whitespace() || c == '│').filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join(" ")
}

/// Without this, the refusals below could have any reason.
#[test]
fn the_right_scene_is_taken_also_with_a_byte_order_mark() {
    Folder::with_scene(right()).runs();
    Folder::with_scene(format!("\u{feff}{}", right())).runs();
}

#[test]
fn scenes_with_long_lines() {
    for length in [65_535, 65_536, 65_537, 1_000_000] {
        let comment = format!("/*{}*/", "é".repeat(length));
        let one_line = right().replace('\n', " ").replace("radius: 0.8", "radius: -1");
        for text in [
            one_line.replace("version", &format!("{comment} version")),
            one_line.replace("passes", &format!("{comment} passes")),
        ] {
            Folder::with_scene(text).refused_by_both(&["radius is -1", "scene.ron:1:", "from"]);
        }
    }
    let word = "x".repeat(65_536);
    Folder::with_scene(scene("\"front\"", &format!("{word:?}")))
        .refused_by_both(&["name is \"xxx", "1 to 100"]);
    Folder::with_scene(scene("version: 1", &format!("version: 1, {word}: 2")))
        .refused_by_both(&["unknown field"]);
    Folder::with_scene(scene("Sphere", &word)).refused_by_both(&["unknown choice"]);
    Folder::with_scene(scene("0.8", &word)).refused_by_both(&["expected a number"]);
    Folder::with_scene(&word).refused(&["check", "scene.ron"], &["scene.ron"]);
    Folder::with_scene(format!("Scene({}", " ".repeat(65_536)))
        .refused(&["check", "scene.ron"], &["closing `)`"]);
}

#[test]
fn scenes_that_would_take_much_memory() {
    let folder = Folder::with_scene("");
    let file = std::fs::File::create(folder.path("scene.ron")).unwrap();
    let mut file = std::io::BufWriter::new(file);
    (0..100).for_each(|_| file.write_all(&vec![b'('; 1 << 20]).unwrap());
    drop(file);
    folder.refused_by_both(&["the file has 100.0 MiB", "at most 16.0 MiB are read"]);
    Folder::with_scene(format!("Scene(version: 1, passes: [{}])", "1,".repeat(8_000_000)))
        .refused_by_both(&["scene.ron"]);
    Folder::with_scene("(".repeat(100_000)).refused_by_both(&["fewer brackets inside each other"]);
    let cameras = format!("{CAMERA}, ").repeat(3000);
    let said = Folder::with_scene(scene(CAMERA, &cameras)).lobelia(&["check", "scene.ron"]);
    assert!(said.code == Some(2) && said.stderr.len() < 20_000, "{} bytes", said.stderr.len());
    assert!(
        said.stderr.contains("2999 problems") && said.stderr.contains("and 2979 more"),
        "{}",
        said.stderr
    );
}

#[test]
fn scenes_that_are_no_text() {
    Folder::with_scene([b'(', 0xff, 0xfe]).refused_by_both(&["byte 1", "UTF-8"]);
    let wide: Vec<u8> = right().encode_utf16().flat_map(u16::to_le_bytes).collect();
    Folder::with_scene([&[0xff, 0xfe], &wide[..]].concat()).refused_by_both(&["UTF-16: save it as UTF-8"]);
    Folder::with_scene(scene("version", "\0version")).refused_by_both(&["expected a value"]);
    let folder = Folder::new();
    std::fs::create_dir(folder.path("scene.ron")).unwrap();
    folder.refused_by_both(&["this is a folder"]);
}

#[cfg(unix)]
#[test]
fn pipes_devices_and_broken_links() {
    let folder = Folder::with_scene(right());
    let made = Command::new("mkfifo").arg(folder.path("pipe.ron")).arg(folder.path("pipe.exr")).status();
    assert!(made.unwrap().success());
    std::os::unix::fs::symlink("nowhere.npy", folder.path("link.npy")).unwrap();
    for command in ["check", "run"] {
        folder.refused(&[command, "pipe.ron"], &["pipe.ron: this is a pipe"]);
    }
    folder.refused(&["env", "info", "pipe.exr"], &["pipe.exr: this is a pipe"]);
    folder.refused(&["env", "info", "pipe.ron"], &["pipe.ron: this is a pipe"]);
    folder.refused(&["eval", "pipe.exr", "pipe.exr"], &["this is a pipe"]);
    for (light, words) in [
        (r#"Npy(path: "/dev/zero")"#, "/dev/zero: this is a device"),
        (r#"Map(path: "pipe.exr")"#, "pipe.exr: this is a pipe"),
        (r#"Npy(path: "link.npy")"#, "symbolic link to nowhere.npy, which does not exist"),
        (r#"Npy(path: "scene.ron/light.npy")"#, "a part of its path is a file"),
        (r#"Npy(path: "a\u{0}b.npy")"#, "NUL"),
    ] {
        std::fs::write(folder.path("scene.ron"), scene(LIGHT, light)).unwrap();
        folder.refused_by_both(&[words]);
    }
    let long = format!("Npy(path: {:?})", "a".repeat(300));
    std::fs::write(folder.path("scene.ron"), scene(LIGHT, &long)).unwrap();
    folder.refused_by_both(&["longer than a file system allows"]);
}

/// An `.npy` file with this dictionary, or one of `<f4` in this shape.
fn npy(dictionary: &str, data: &[u8]) -> Vec<u8> {
    let text = match dictionary {
        shape if shape.ends_with("7)") => {
            format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}}}")
        }
        other => other.to_owned(),
    };
    [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes(), data].concat()
}

#[test]
fn light_files_of_numbers() {
    let row: Vec<u8> = [0.0_f32, 1.0, 0.0, 5.0, 1.0, 1.0, 1.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let bright: Vec<u8> =
        [0.0_f32, 1.0, 0.0, 5.0, 1.0, 1e38, 1.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let folder = Folder::with_scene(scene(LIGHT, r#"Npy(path: "light.npy")"#));
    let cases = [
        (npy(&"(".repeat(24), b""), "broken header"),
        (npy(&"{'shape': (".repeat(24), b""), "broken header"),
        (npy("(1000000, 7)", &row.repeat(1_000_000)), "has 1000000 rows, and a light has at most 2048 lobes"),
        (npy("(1000000000, 7)", &row), "at most 2048 lobes"),
        (npy("(512, 7)", &row), "truncated"),
        (npy("(1, 7)", &bright), "row 0: has amplitude 1.000e38"),
    ];
    for (bytes, words) in cases {
        std::fs::write(folder.path("light.npy"), bytes).unwrap();
        folder.refused_run(&["light.npy", words]);
        folder.refused(&["env", "info", "light.npy"], &["light.npy", words]);
    }
    std::fs::File::create(folder.path("light.npy")).unwrap().set_len(100 << 30).unwrap();
    folder.refused_run(&["light.npy", "at most 256.0 MiB are read"]);
}

#[test]
fn lights_that_no_picture_can_hold() {
    let lobe = |sharpness: &str, amplitude: &str, scale: &str| {
        format!(
            "Lobes(lobes: [(axis: (0, 1, 0), sharpness: {sharpness}, amplitude: ({amplitude}, 1, 1))], scale: {scale})"
        )
    };
    for (light, words) in [
        (lobe("5", "1e38", "1"), "amplitude is"),
        (lobe("5", "1e14", "1e38"), "lobe 0: amplitude inf"),
        (lobe("1e38", "1", "1"), "sharpness is"),
        (lobe("5", "NaN", "1"), "amplitude"),
        (lobe("inf", "1", "1"), "sharpness"),
    ] {
        let folder = Folder::with_scene(scene(LIGHT, &light));
        folder.refused_run(&[words]);
        std::fs::write(folder.path("light.ron"), &light).unwrap();
        for arguments in [["info", "light.ron"].as_slice(), &["render", "light.ron", "a.exr"]] {
            folder.refused(&[&["env"], arguments].concat(), &["light.ron", "lobe 0"]);
        }
    }
    for light in [lobe("1e11", "1", "1"), lobe("0", "1", "1"), lobe("5", "1e14", "1"), lobe("5", "0", "0")] {
        Folder::with_scene(scene(LIGHT, &light)).runs();
    }
}

/// A Radiance picture of 8 × 4 texels: 16 `above`, 16 `below`.
fn radiance(above: [u8; 4], below: [u8; 4]) -> Vec<u8> {
    let head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n";
    [&head[..], &above.repeat(16), &below.repeat(16)].concat()
}

#[test]
fn maps_without_light_or_with_too_much() {
    let folder = Folder::new();
    std::fs::write(folder.path("below.hdr"), radiance([0; 4], [200, 200, 200, 129])).unwrap();
    std::fs::write(folder.path("black.hdr"), radiance([0; 4], [0; 4])).unwrap();
    std::fs::write(folder.path("faint.hdr"), radiance([200, 200, 200, 60], [200, 200, 200, 60])).unwrap();
    std::fs::write(folder.path("glaring.hdr"), radiance([255; 4], [2, 2, 2, 129])).unwrap();
    let fit = |map: &'static str| ["env", "fit", map, "--lobes", "2", "--upper-hemisphere", "--quiet"];
    folder.refused(&fit("below.hdr"), &["below.hdr: the map gives no light from above"]);
    folder.refused(&fit("black.hdr"), &["black.hdr", "black everywhere"]);
    folder.refused(&fit("faint.hdr"), &["faint.hdr", "black everywhere"]);
    folder.refused(&fit("glaring.hdr"), &["glaring.hdr: 16 of 32 texels are absurdly bright"]);
    let map = r#"Map(path: "below.hdr", lobes: 2, upper_hemisphere: true)"#;
    std::fs::write(folder.path("scene.ron"), scene(LIGHT, map)).unwrap();
    folder.refused_run(&["below.hdr: the map gives no light from above"]);
    let map = r#"Map(path: "below.hdr", lobes: 2, scale: 1e30)"#;
    std::fs::write(folder.path("scene.ron"), scene(LIGHT, map)).unwrap();
    folder.refused_run(&["below.hdr: texel (0, 2) has radiance"]);
    let said = folder.lobelia(&["env", "fit", "below.hdr", "--lobes", "2", "--quiet"]).succeeded();
    assert!(!said.stdout.contains("NaN") && !said.stdout.contains("inf"), "{}", said.stdout);
}

#[test]
fn pictures_that_take_more_memory_than_there_may_be() {
    let folder = Folder::with_scene(scene(CAMERA, CAMERA));
    std::fs::write(folder.path("light.ron"), LIGHT).unwrap();
    folder.refused(
        &["env", "render", "light.ron", "--size", "16384x16384", "a.exr"],
        &["a map of 16384×16384 pixels takes 9.0 GiB"],
    );
    let made = format!(
        "Photographed(cameras: (count: 1000, size: 4096), truth: (albedo: Constant(0.5, 0.5, 0.5), specular: (albedo: (0, 0, 0), roughness: 1), light: {LIGHT}))"
    );
    let folder = Folder::with_scene(scene(&format!("Cameras([{CAMERA}])"), &made));
    folder.refused_by_both(&["photographs of 4096×4096 pixels takes"]);
}

#[test]
#[cfg(target_os = "linux")]
fn runs_that_take_more_memory_than_their_process_may_have() {
    let large = right()
        .replace("texture_size: 16", "texture_size: 4096")
        .replace("visibility: None", "visibility: Traced(directions: 4096)");
    let folder = Folder::with_scene(large);
    // Three quarters of the limit of the address space.
    folder.refused_by_both(&["this run takes about", "2.2 GiB are allowed", "--memory"]);
}

#[test]
fn cameras_that_see_nothing() {
    for (field, value, words) in [
        ("fov_degrees", "1e-40", "fov_degrees is"),
        ("fov_degrees", "1e30", "fov_degrees is"),
        ("fov_degrees", "NaN", "fov_degrees is NaN"),
        ("fov_degrees", "0.0001", "from 0.001 to 170"),
        ("target", "(0, 0, 1e30)", "target is"),
        ("target", "(0, 0, inf)", "target is"),
        ("up", "(0, 1e-30, 0)", "up is"),
    ] {
        let camera = CAMERA.replace("width: 16,", &format!("width: 16, {field}: {value},"));
        Folder::with_scene(scene(CAMERA, &camera)).refused_by_both(&[words]);
    }
    let camera = CAMERA.replace("(0, 0, 3)", "(0, 3e38, -3e38)");
    Folder::with_scene(scene(CAMERA, &camera)).refused_by_both(&["eye is"]);
    let camera = CAMERA.replace("width: 16,", "width: 16, fov_degrees: 0.001,");
    Folder::with_scene(scene(CAMERA, &camera)).runs();
}

#[test]
fn names_that_files_cannot_have() {
    let long = "a".repeat(300);
    for name in ["", "..", "a/b", "a\\\\b", "fr\\u{0}ont", "a\\nb", "é", &long] {
        let camera = CAMERA.replace("front", name);
        Folder::with_scene(scene(CAMERA, &camera)).refused_by_both(&["name is", "1 to 100 letters, digits"]);
        let pass = format!(r#"Render(name: "{name}")"#);
        Folder::with_scene(scene(r#"Render(name: "novel")"#, &pass))
            .refused_by_both(&["1 to 100 letters, digits"]);
    }
    let two = format!("{CAMERA}, {}", CAMERA.replace("front", "Front"));
    Folder::with_scene(scene(CAMERA, &two))
        .refused_by_both(&["two cameras are called \"Front\"", "cases apart"]);
    let two = r#"Render(name: "novel"), Render(name: "NOVEL")"#;
    Folder::with_scene(scene(r#"Render(name: "novel")"#, two))
        .refused_by_both(&["two passes are called \"NOVEL\"", "cases apart"]);
}

#[test]
fn output_folders_that_cannot_be_written() {
    let folder = Folder::with_scene(right());
    let out = |out: &'static str| ["run", "scene.ron", "--quiet", "--force", "--out", out];
    folder.refused(&out("scene.ron"), &["scene.ron is a file", "--out"]);
    folder.refused(&out("scene.ron/out"), &["scene.ron is a file"]);
    std::fs::create_dir(folder.path("used")).unwrap();
    std::fs::write(folder.path("used/novel"), "").unwrap();
    folder.refused(&out("used"), &["used/novel is a file"]);
    if std::path::Path::new("/proc/self").exists() {
        folder.refused(&out("/proc/out"), &["nothing can be written into /proc"]);
    }
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("nowhere", folder.path("link")).unwrap();
        folder.refused(&out("link/out"), &["symbolic link to nowhere"]);
    }
    let long: &'static str = Box::leak("o".repeat(300).into_boxed_str());
    folder.refused(&out(long), &["--out"]);
}

/// A mesh of `count` sparse positions, shown by `instances` nodes.
fn sparse_mesh(count: u64, instances: usize) -> String {
    let nodes: Vec<_> = (0..instances).map(|_| serde_json::json!({ "mesh": 0 })).collect();
    serde_json::json!({
        "asset": { "version": "2.0" },
        "scenes": [{ "nodes": (0..instances).collect::<Vec<_>>() }],
        "nodes": nodes,
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "componentType": 5126, "count": count, "type": "VEC3", "sparse": {
            "count": 1,
            "indices": { "bufferView": 0, "componentType": 5125 },
            "values": { "bufferView": 0 },
        } }],
        "bufferViews": [{ "buffer": 0, "byteLength": 12 }],
        "buffers": [{ "uri": "data:;base64,AAAAAAAAAAAAAAAA", "byteLength": 12 }],
    })
    .to_string()
}

#[test]
fn meshes_of_more_triangles_than_a_file_can_hold() {
    let folder = Folder::with_scene(scene(SPHERE, r#"Mesh(path: "mesh.gltf", texture_size: 16)"#));
    for (count, instances, words) in [
        (100_000_000, 1, "has 33333333 triangles and 100000000 vertices"),
        (u64::MAX, 1, "mesh.gltf"),
        (300_000, 490, "has 49000000 triangles"),
        (3, 1, "1 degenerate"),
    ] {
        std::fs::write(folder.path("mesh.gltf"), sparse_mesh(count, instances)).unwrap();
        folder.refused_run(&["mesh.gltf", words]);
    }
}
