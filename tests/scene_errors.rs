//! A wrong scene file gives one clear report with file, line, column and caret, exit code 2, and writes nothing.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A scene that is right, without outside files.
const RIGHT: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.8),
    views: Cameras([(name: "front", eye: (0, 0, 3), width: 16, height: 16)]),
    light: Fixed(Lobes(lobes: [(axis: (0, 1, 0), sharpness: 5, amplitude: (1, 1, 1))])),
    material: (
        albedo: Fixed(Constant(0.5, 0.5, 0.5)),
        specular: (albedo: Fixed(0.3, 0.3, 0.3), roughness: Fixed(0.3)),
    ),
    passes: [
        Render(name: "novel", render: (exposure: 0.5)),
        Edit(name: "edited", edits: [Diffuse(action: Set(0.8, 0.1, 0.1))]),
    ],
)
"#;

struct Outcome {
    code: Option<i32>,
    stdout: String,
    stderr: String,
    /// What the folder holds afterward, besides the scene file.
    written: Vec<PathBuf>,
}

/// Runs `lobelia COMMAND scene.ron ARGUMENTS` in a folder of its own.
fn lobelia(command: &str, scene: &str, arguments: &[&str]) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.ron"), scene).unwrap();
    let Output { status, stdout, stderr } = Command::new(env!("CARGO_BIN_EXE_lobelia"))
        .current_dir(folder.path())
        .args([command, "scene.ron"])
        .args(arguments)
        .output()
        .unwrap();
    let entries = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path());
    let written = entries.filter(|path| path.file_name() != Some("scene.ron".as_ref())).collect();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Outcome { code: status.code(), stdout: text(stdout), stderr: text(stderr), written }
}

/// `RIGHT` with `from` replaced by `to`.
fn wrong(from: &str, to: &str) -> String {
    assert_eq!(RIGHT.matches(from).count(), 1, "{from:?} must be there once");
    RIGHT.replace(from, to)
}

/// Expects a report about `scene` at the line and column of `caret`, with an underline and all `words`.
#[track_caller]
fn refused(scene: &str, caret: &str, words: &[&str]) {
    for command in ["run", "check"] {
        refused_with(command, scene, &[], caret, scene, words);
    }
}

#[track_caller]
fn refused_with(command: &str, scene: &str, arguments: &[&str], caret: &str, shown: &str, words: &[&str]) {
    let outcome = lobelia(command, scene, arguments);
    let before = &shown[..shown.find(caret).unwrap()];
    let line = 1 + before.matches('\n').count();
    let column = 1 + before.rsplit('\n').next().unwrap().chars().count();
    let place = format!("scene.ron:{line}:{column}\n");
    let stderr = &outcome.stderr;
    assert_eq!(outcome.code, Some(2), "{stderr}");
    assert!(stderr.contains(&place), "no {place} in\n{stderr}");
    assert!(stderr.contains('━'), "no underline in\n{stderr}");
    for word in words {
        assert!(flat(stderr).contains(word), "no {word:?} in\n{stderr}");
    }
    assert_eq!(outcome.written, [] as [PathBuf; 0], "something was written");
    assert_eq!(outcome.stdout, "");
}

/// The text on one line, so that a wrapped sentence is found.
fn flat(text: &str) -> String {
    text.split(|c: char| c.is_whitespace() || c == '│')
        .filter(|w| !w.is_empty())
        .collect::<Vec<_>>()
        .join(" ")
}

#[test]
fn a_right_scene_is_fine() {
    let outcome = lobelia("check", RIGHT, &[]);
    assert_eq!((outcome.code, outcome.stderr.as_str()), (Some(0), ""));
    assert!(outcome.stdout.contains("novel (Render), edited (Edit)"), "{}", outcome.stdout);
    assert!(outcome.written.is_empty());
}

#[test]
fn a_wrong_field_names_the_nearest_right_one() {
    let scene = wrong("roughness:", "rougness:");
    refused(&scene, "rougness", &["unknown field `rougness`", "Did you mean `roughness`?"]);
    let scene = wrong("exposure:", "colour:");
    refused(&scene, "colour", &["unknown field `colour`", "`samples_per_pixel`"]);
}

#[test]
fn published_shading_has_no_ggx() {
    let scene = wrong("exposure: 0.5", "shading: Published").replace("Fixed(0.3))", "Fixed(0.3), ndf: Ggx)");
    refused(&scene, "Published", &["`Published` shading cannot show", "`ndf: Ggx`", "`Accurate`"]);
    let outcome = lobelia("check", &scene.replace("Published", "Accurate"), &[]);
    assert_eq!((outcome.code, outcome.stderr.as_str()), (Some(0), ""));
}

#[test]
fn only_path_tracing_with_enough_paths_is_denoised() {
    let scene = wrong("exposure: 0.5", "denoise: true");
    refused(&scene, "denoise", &["unknown field `denoise`", "`shading: PathTraced(spp: 16, denoise: true)`"]);
    let scene = wrong("exposure: 0.5", "shading: Accurate(denoise: true)");
    refused(&scene, "Accurate", &["`Accurate` alone, which has no fields", "`shading: PathTraced("]);
    let scene = wrong("exposure: 0.5", "shading: PathTraced(spp: 2, denoise: true)");
    refused(&scene, "true)", &["2 paths per pixel", "`spp` to be at least 4"]);
    let outcome = lobelia("check", &scene.replace("spp: 2", "spp: 4"), &[]);
    assert_eq!((outcome.code, outcome.stderr.as_str()), (Some(0), ""));
}

#[test]
fn a_wrong_choice_lists_the_choices() {
    let scene = wrong("surface: Sphere", "surface: Spere");
    refused(&scene, "Spere", &["unknown choice `Spere`", "Did you mean `Sphere`?", "`Mesh`"]);
    let scene = wrong("Fixed(0.3))", "Fixed(0.3), ndf: Gxx)");
    refused(&scene, "Gxx", &["unknown choice `Gxx`", "Did you mean `Ggx`?"]);
    let scene = wrong("Edit(name", "Scale(name");
    refused(&scene, "Scale(name", &["unknown choice `Scale`", "`Relight`"]);
}

#[test]
fn a_stroke_has_points_and_a_width() {
    let stroke =
        |region: &str| wrong("Set(0.8, 0.1, 0.1)", &format!("Set(0.8, 0.1, 0.1), region: Stroke({region})"));
    let outcome =
        lobelia("check", &stroke("points: [(0, 0.8, 0), (0.1, 0.7, 0.3)], radius: 0.2, falloff: 0.1"), &[]);
    assert_eq!((outcome.code, outcome.stderr.as_str()), (Some(0), ""));
    let (none, far) =
        (stroke("points: [], radius: 0.2"), stroke("points: [(0, 0, 0), (0, inf, 0)], radius: 0.2"));
    refused(&none, "[], radius", &["points is 0", "from 1 to 256"]);
    refused(&far, "(0, inf", &["points is [0, inf, 0]", "none beyond 1e9"]);
    let many = stroke(&format!("points: [{}], radius: 0.2", "(0, 0, 0), ".repeat(257)));
    let outcome = lobelia("check", &many, &[]);
    assert_eq!(outcome.code, Some(2));
    assert!(flat(&outcome.stderr).contains("points is 257"), "{}", outcome.stderr);
    refused(&stroke("points: [(0, 0, 0)], radius: 0"), "0))]", &["radius is 0", "a number above 0"]);
    refused(&stroke("points: [(0, 0, 0)]"), "Stroke", &["missing field `radius`"]);
}

#[test]
fn a_missing_field_is_named() {
    refused(&wrong("    version: 1,\n", ""), "Scene", &["missing field `version`"]);
    refused(&wrong("eye: (0, 0, 3), ", ""), "(name: \"front\"", &["missing field `eye`"]);
    refused(&wrong("name: \"novel\", ", ""), "Render", &["missing field `name`"]);
}

#[test]
fn a_field_given_twice_is_named() {
    refused(&wrong("version: 1,", "version: 1, seed: 3, seed: 4,"), "seed: 4", &["`seed` is given twice"]);
}

#[test]
fn a_wrong_type_says_what_was_expected() {
    refused(&wrong("exposure: 0.5", "exposure: \"high\""), "\"high\"", &["expected a number"]);
    refused(&wrong("width: 16", "width: -4"), "-4", &["expected a whole number"]);
    refused(&wrong("width: 16", "width: 1.5"), "1.5", &["expected a whole number"]);
    refused(&wrong("radius: 0.8", "radius: (1, 2)"), "(1, 2)", &["expected a number"]);
    refused(&wrong("name: \"novel\"", "name: novel"), "novel", &["expected a string in quotes"]);
    refused(&wrong("eye: (0, 0, 3)", "eye: 3"), "3, width", &["expected"]);
    refused(&wrong("eye: (0, 0, 3)", "eye: (0, 3)"), "(0, 3)", &["expected three numbers, found 2"]);
    refused(&wrong("eye: (0, 0, 3)", "eye: (0, 0, 3, 4)"), "4)", &["expected"]);
    refused(
        &wrong("Constant(0.5, 0.5, 0.5)", "Constant((0.5, 0.5, 0.5))"),
        "(0.5",
        &["one pair of brackets"],
    );
    refused(&wrong("Fixed(Lobes", "Unknown, passes: (Lobes"), "Unknown", &["Write `Unknown()`"]);
}

#[test]
fn a_wrong_value_says_the_range() {
    let roughness = wrong("roughness: Fixed(0.3)", "roughness: Fixed(0)");
    refused(&roughness, "Fixed(0)", &["roughness is 0", "from 0.03 to 1"]);
    refused(&wrong("radius: 0.8", "radius: -1"), "-1", &["radius is -1", "a number from"]);
    refused(&wrong("radius: 0.8", "radius: NaN"), "NaN", &["radius is NaN"]);
    refused(&wrong("Set(0.8,", "Set(1.8,"), "Set(1.8", &["from 0 to 1"]);
    refused(&wrong("width: 16", "width: 0"), "0, height", &["width is 0"]);
    refused(&wrong("version: 1", "version: 2"), "2,", &["version 2", "expected 1"]);
    refused(&wrong("name: \"edited\"", "name: \"novel\""), "\"novel\", edits", &["two passes are called"]);
    refused(&wrong("name: \"edited\"", "name: \"../up\""), "\"../up\"", &["letters, digits"]);
}

#[test]
fn zero_lobes_are_refused() {
    let lobes = "lobes: [(axis: (0, 1, 0), sharpness: 5, amplitude: (1, 1, 1))]";
    refused(&wrong(lobes, "lobes: []"), "[])", &["lobes is 0", "from 1 to 2048"]);
}

#[test]
fn a_missing_file_is_shown_with_its_neighbors() {
    let scene = wrong("Sphere(radius: 0.8)", "Mesh(path: \"scene.rom\")");
    refused(&scene, "\"scene.rom\"", &["scene.rom: there is no such file", "did you mean `scene.ron`?"]);
    let scene = wrong("Sphere(radius: 0.8)", "Mesh(path: \"$DATA/mesh.glb\")");
    refused_with("run", &scene, &[], "\"$DATA/mesh.glb\"", &scene, &["--data DIR"]);
    let outcome = lobelia("check", &scene, &[]);
    assert!(
        outcome.code == Some(0) && outcome.stdout.contains("1 below $DATA not looked for"),
        "{}",
        outcome.stdout
    );
    let scene = wrong("Constant(0.5, 0.5, 0.5)", "Texture(\"none/albedo.png\")");
    refused(&scene, "\"none/albedo.png\"", &["none/albedo.png: there is no such file", "has no `none`"]);
}

#[test]
fn an_unknown_pass_is_refused() {
    let evaluate = "Evaluate(scores: [(pass: \"nowel\", truth: Folder(\".\"))]),\n    ],\n)";
    refused(&wrong("    ],\n)", evaluate), "\"nowel\"", &["Did you mean \"novel\"?"]);
}

#[test]
fn what_a_fit_must_find_is_not_used_before() {
    let scene = wrong("roughness: Fixed(0.3)", "roughness: Unknown()");
    refused(&scene, "Render", &["needs the roughness", "Put a `Fit`"]);
}

#[test]
fn several_problems_are_told_at_once() {
    let scene = wrong("radius: 0.8", "radius: -1").replace("exposure: 0.5", "exposure: 99");
    refused(&scene, "-1", &["2 problems in scene.ron", "radius is -1"]);
    refused(&scene, "99", &["exposure is 99", "from -20 to 20"]);
}

#[test]
fn broken_text_shows_what_is_open() {
    let scene = wrong(
        "        Edit(name: \"edited\", edits: [Diffuse(action: Set(0.8, 0.1, 0.1))]),\n    ],\n)\n",
        "",
    );
    let outcome = lobelia("check", &scene, &[]);
    assert_eq!(outcome.code, Some(2));
    for words in ["expected a closing `]`", "opened here", "passes: ["] {
        assert!(outcome.stderr.contains(words), "{}", outcome.stderr);
    }
    refused(&wrong("version: 1,", "version: 1"), "surface", &["expected `,` or `)`"]);
}

#[test]
fn set_is_checked_like_the_file() {
    let shown = wrong("exposure: 0.5", "exposure: 99");
    let set = ["--set", "passes.novel.render.exposure=99"];
    refused_with("run", RIGHT, &set, "99", &shown, &["from -20 to 20", "--set values in it"]);
    let shown = wrong("exposure: 0.5", "exposure: 0.5, tones: Filmic");
    let set = ["--set", "passes.novel.render.tones=Filmic"];
    refused_with("run", RIGHT, &set, "tones", &shown, &["Did you mean `tone`?"]);
    let outcome = lobelia("check", RIGHT, &["--set", "passes.novel.render.tone=Filmic", "--set", "seed=3"]);
    assert_eq!(outcome.code, Some(0), "{}", outcome.stderr);
}

/// Expects exit code 2 and a plain message with all `words`.
#[track_caller]
fn usage(arguments: &[&str], words: &[&str]) {
    let outcome = lobelia("run", RIGHT, arguments);
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    for word in words {
        assert!(outcome.stderr.contains(word), "no {word:?} in\n{}", outcome.stderr);
    }
    assert!(outcome.written.is_empty());
}

#[test]
fn bad_arguments_are_refused() {
    usage(&["--set", "passes.missing.name=1"], &["`passes` has no `missing`", "novel, edited"]);
    usage(&["--set", "seed=(1"], &["not a RON value"]);
    usage(&["--set", "seed"], &["expected PATH=VALUE"]);
    usage(&["--threads", "0"], &["--threads"]);
    usage(&["--threads", "5000"], &["--threads"]);
    usage(&["--data", "nowhere"], &["no such folder"]);
    usage(&["--seed", "-1"], &["--seed"]);
    usage(&["--out", "scene.ron"], &["is a file"]);
    usage(&["--out", "."], &["not empty", "--force"]);
}

#[test]
fn a_scene_file_that_cannot_be_read_is_named() {
    let run = |path: &Path| {
        let output = Command::new(env!("CARGO_BIN_EXE_lobelia")).arg("check").arg(path).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let folder = tempfile::tempdir().unwrap();
    let (code, stderr) = run(&folder.path().join("none.ron"));
    assert!(code == Some(2) && stderr.contains("none.ron: there is no such file"), "{stderr}");
    let (code, stderr) = run(folder.path());
    assert!(code == Some(2) && stderr.contains("is a folder"), "{stderr}");
    let binary = folder.path().join("binary.ron");
    std::fs::write(&binary, [b'(', 0xff, 0xfe]).unwrap();
    let (code, stderr) = run(&binary);
    assert!(code == Some(2) && stderr.contains("byte 1") && stderr.contains("UTF-8"), "{stderr}");
    std::fs::write(&binary, "").unwrap();
    assert_eq!(run(&binary).0, Some(2));
}

#[test]
fn surfaces_too_large_for_the_arithmetic_are_refused() {
    for radius in ["1e20", "1e38", "1e-20"] {
        let scene = wrong("radius: 0.8", &format!("radius: {radius}"));
        refused(&scene, radius, &["a number from"]);
    }
}
