//! A wrong scene file gives one clear report with file, line, column and caret, exit code 2, and
//! writes nothing.

use crate::common::{Data, Outcome, changed, files_below, flat};

/// A scene that is right, without outside files.
const RIGHT: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.8),
    views: Cameras([(name: "front", eye: (0, 0, 3), width: 16, height: 16)]),
    light: Fixed(Lobes(lobes: [(axis: (0, 1, 0), sharpness: 5, amplitude: (1, 1, 1))])),
    material: (albedo: Fixed(Constant(0.5, 0.5, 0.5)), specular: (albedo: Fixed(0.3, 0.3, 0.3), roughness: Fixed(0.3))),
    passes: [
        Render(name: "novel", render: (exposure: 0.5)),
        Edit(name: "edited", edits: [Diffuse(action: Set(0.8, 0.1, 0.1))]),
    ],
)
"#;

/// Runs `lobelia COMMAND scene.ron ARGUMENTS` in a folder of its own, in which nothing is written.
#[track_caller]
fn lobelia(command: &str, scene: &str, arguments: &[&str]) -> Outcome {
    let folder = Data::bare();
    folder.write("scene.ron", scene);
    let outcome = folder.lobelia(&[&[command, "scene.ron"], arguments].concat());
    assert_eq!(files_below(folder.root()), ["scene.ron"], "something was written");
    outcome
}

/// Expects that `check` finds nothing wrong; returns what it says.
#[track_caller]
fn fine(scene: &str, arguments: &[&str]) -> String {
    let outcome = lobelia("check", scene, arguments);
    assert_eq!((outcome.code, outcome.stderr.as_str()), (Some(0), ""));
    outcome.stdout
}

/// `RIGHT` with `from` replaced by `to`.
fn wrong(from: &str, to: &str) -> String {
    changed(RIGHT, from, to)
}

/// Expects a report about `RIGHT` with `from` replaced by `to`, at the line and column of `caret`,
/// with an underline and all `words`.
#[track_caller]
fn refused(from: &str, to: &str, caret: &str, words: &[&str]) {
    refused_scene(&wrong(from, to), caret, words);
}

#[track_caller]
fn refused_scene(scene: &str, caret: &str, words: &[&str]) {
    refused_with("check", scene, &[], caret, scene, words);
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
    assert_eq!(outcome.stdout, "");
}

#[test]
fn a_right_scene_is_fine() {
    let said = fine(RIGHT, &[]);
    assert!(said.contains("novel (Render), edited (Edit)"), "{said}");
}

#[test]
fn a_wrong_word_names_the_nearest_right_one_or_all() {
    let words = ["unknown field `rougness`", "Did you mean `roughness`?"];
    refused("roughness:", "rougness:", "rougness", &words);
    refused("exposure:", "colour:", "colour", &["unknown field `colour`", "`samples_per_pixel`"]);
    let words = ["unknown choice `Spere`", "Did you mean `Sphere`?", "`Mesh`"];
    refused("surface: Sphere", "surface: Spere", "Spere", &words);
    let words = ["unknown choice `Gxx`", "Did you mean `Ggx`?"];
    refused("Fixed(0.3))", "Fixed(0.3), ndf: Gxx)", "Gxx", &words);
    refused("Edit(name", "Scale(name", "Scale(name", &["unknown choice `Scale`", "`Relight`"]);
    let evaluate = "Evaluate(scores: [(pass: \"nowel\", truth: Folder(\".\"))]),\n    ],\n)";
    refused("    ],\n)", evaluate, "\"nowel\"", &["Did you mean \"novel\"?"]);
}

#[test]
fn published_shading_has_no_ggx() {
    let scene = wrong("exposure: 0.5", "shading: Published").replace("Fixed(0.3))", "Fixed(0.3), ndf: Ggx)");
    refused_scene(&scene, "Published", &["`Published` shading cannot show", "`ndf: Ggx`", "`Accurate`"]);
    fine(&scene.replace("Published", "Accurate"), &[]);
}

#[test]
fn a_stroke_has_points_and_a_width() {
    let set = "Set(0.8, 0.1, 0.1)";
    let stroke = |region: &str| format!("{set}, region: Stroke({region})");
    let right = stroke("points: [(0, 0.8, 0), (0.1, 0.7, 0.3)], radius: 0.2, falloff: 0.1");
    fine(&wrong(set, &right), &[]);
    let many = format!("points: [{}], radius: 0.2", "(0, 0, 0), ".repeat(257));
    lobelia("check", &wrong(set, &stroke(&many)), &[]).refused(&["points is 257"]);
    for (region, caret, words) in [
        ("points: [], radius: 0.2", "[], radius", ["points is 0", "from 1 to 256"]),
        ("points: [(0, 0, 0), (0, inf, 0)], radius: 0.2", "(0, inf", ["is [0, inf, 0]", "none beyond 1e9"]),
        ("points: [(0, 0, 0)], radius: 0", "0))]", ["radius is 0", "a number above 0"]),
        ("points: [(0, 0, 0)]", "Stroke", ["missing field `radius`", ""]),
    ] {
        refused(set, &stroke(region), caret, &words);
    }
}

#[test]
fn a_field_that_is_missing_or_given_twice_is_named() {
    refused("    version: 1,\n", "", "Scene", &["missing field `version`"]);
    refused("eye: (0, 0, 3), ", "", "(name: \"front\"", &["missing field `eye`"]);
    refused("name: \"novel\", ", "", "Render", &["missing field `name`"]);
    refused("version: 1,", "version: 1, seed: 3, seed: 4,", "seed: 4", &["`seed` is given twice"]);
}

#[test]
fn a_wrong_type_says_what_was_expected() {
    let constant = "Constant(0.5, 0.5, 0.5)";
    for (from, to, caret, words) in [
        ("exposure: 0.5", "exposure: \"high\"", "\"high\"", "expected a number"),
        ("width: 16", "width: -4", "-4", "expected a whole number"),
        ("width: 16", "width: 1.5", "1.5", "expected a whole number"),
        ("radius: 0.8", "radius: (1, 2)", "(1, 2)", "expected a number"),
        ("name: \"novel\"", "name: novel", "novel", "expected a string in quotes"),
        ("eye: (0, 0, 3)", "eye: 3", "3, width", "expected"),
        ("eye: (0, 0, 3)", "eye: (0, 3)", "(0, 3)", "expected three numbers, found 2"),
        ("eye: (0, 0, 3)", "eye: (0, 0, 3, 4)", "4)", "expected"),
        (constant, "Constant((0.5, 0.5, 0.5))", "(0.5", "one pair of brackets"),
        ("Fixed(Lobes", "Unknown, passes: (Lobes", "Unknown", "Write `Unknown()`"),
        ("version: 1,", "version: 1", "surface", "expected `,` or `)`"),
    ] {
        refused(from, to, caret, &[words]);
    }
}

#[test]
fn a_wrong_value_says_the_range() {
    let lobes = "lobes: [(axis: (0, 1, 0), sharpness: 5, amplitude: (1, 1, 1))]";
    for (from, to, caret, words) in [
        ("roughness: Fixed(0.3)", "roughness: Fixed(0)", "Fixed(0)", ["roughness is 0", "from 0.03 to 1"]),
        ("radius: 0.8", "radius: -1", "-1", ["radius is -1", "a number from"]),
        ("radius: 0.8", "radius: NaN", "NaN", ["radius is NaN", ""]),
        ("Set(0.8,", "Set(1.8,", "Set(1.8", ["from 0 to 1", ""]),
        ("width: 16", "width: 0", "0, height", ["width is 0", ""]),
        ("version: 1", "version: 2", "2,", ["version 2", "expected 1"]),
        ("name: \"edited\"", "name: \"novel\"", "\"novel\", edits", ["two passes are called", ""]),
        ("name: \"edited\"", "name: \"../up\"", "\"../up\"", ["letters, digits", ""]),
        (lobes, "lobes: []", "[])", ["lobes is 0", "from 1 to 2048"]),
        // What a fit must find is not used before.
        ("roughness: Fixed(0.3)", "roughness: Unknown()", "Render", ["needs the roughness", "Put a `Fit`"]),
        // Too large or too small for the arithmetic.
        ("radius: 0.8", "radius: 1e20", "1e20", ["a number from", ""]),
        ("radius: 0.8", "radius: 1e-20", "1e-20", ["a number from", ""]),
    ] {
        refused(from, to, caret, &words);
    }
}

#[test]
fn a_missing_file_is_shown_with_its_neighbors() {
    let sphere = "Sphere(radius: 0.8)";
    let words = ["scene.rom: there is no such file", "The folder has scene.ron."];
    refused(sphere, "Mesh(path: \"scene.rom\")", "\"scene.rom\"", &words);
    let words = ["none/albedo.png: there is no such file", "There is no folder none"];
    refused("Constant(0.5, 0.5, 0.5)", "Texture(\"none/albedo.png\")", "\"none/albedo.png\"", &words);
    let scene = wrong(sphere, "Mesh(path: \"$DATA/mesh.glb\")");
    refused_with("run", &scene, &[], "\"$DATA/mesh.glb\"", &scene, &["--data DIR"]);
    let said = fine(&scene, &[]);
    assert!(said.contains("1 below $DATA not looked for"), "{said}");
}

#[test]
fn several_problems_are_told_at_once() {
    let scene = wrong("radius: 0.8", "radius: -1").replace("exposure: 0.5", "exposure: 99");
    refused_scene(&scene, "-1", &["2 problems in scene.ron", "radius is -1"]);
    refused_scene(&scene, "99", &["exposure is 99", "from -20 to 20"]);
}

#[test]
fn broken_text_shows_what_is_open() {
    let scene = &RIGHT[..RIGHT.find("        Edit(").unwrap()];
    lobelia("check", scene, &[]).refused(&["expected a closing `]`", "opened here", "passes: ["]);
    lobelia("check", "", &[]).refused(&[]);
}

#[test]
fn set_is_checked_like_the_file() {
    let shown = wrong("exposure: 0.5", "exposure: 99");
    let set = ["--set", "passes.novel.render.exposure=99"];
    refused_with("run", RIGHT, &set, "99", &shown, &["from -20 to 20", "--set values in it"]);
    let shown = wrong("exposure: 0.5", "exposure: 0.5, tones: Filmic");
    let set = ["--set", "passes.novel.render.tones=Filmic"];
    refused_with("run", RIGHT, &set, "tones", &shown, &["Did you mean `tone`?"]);
    fine(RIGHT, &["--set", "passes.novel.render.tone=Filmic", "--set", "seed=3"]);
}

#[test]
fn bad_arguments_are_refused() {
    for (arguments, words) in [
        (["--set", "passes.missing.name=1"], ["`passes` has no `missing`", "novel, edited"]),
        (["--set", "seed=(1"], ["not a RON value", ""]),
        (["--set", "seed"], ["expected PATH=VALUE", ""]),
        (["--threads", "0"], ["--threads", ""]),
        (["--threads", "5000"], ["--threads", ""]),
        (["--data", "nowhere"], ["no such folder", ""]),
        (["--seed", "-1"], ["--seed", ""]),
        (["--out", "scene.ron"], ["is a file", ""]),
        (["--out", "."], ["not empty", "--force"]),
    ] {
        lobelia("run", RIGHT, &arguments).refused(&words);
    }
    Data::bare().refuses(&["check", "nowhere/none.ron"], &["none.ron: there is no such file"]);
}
