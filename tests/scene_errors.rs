//! A wrong scene file gives one clear report with file, line, column and caret, exit code 2, and writes nothing.

use crate::common::{self, Data, Outcome, changed, files_below, flat};

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

/// Runs `lobelia COMMAND scene.ron ARGUMENTS` in a folder of its own, in which nothing is written.
#[track_caller]
fn lobelia(command: &str, scene: &str, arguments: &[&str]) -> Outcome {
    let folder = Data::bare();
    std::fs::write(folder.path("scene.ron"), scene).unwrap();
    let mut program = common::command(&[command, "scene.ron"]);
    let outcome = Outcome::of(program.args(arguments).current_dir(folder.root()));
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

/// Expects a report about `scene` at the line and column of `caret`, with an underline and all `words`.
#[track_caller]
fn refused(scene: &str, caret: &str, words: &[&str]) {
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
    fine(&scene.replace("Published", "Accurate"), &[]);
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
    fine(&stroke("points: [(0, 0.8, 0), (0.1, 0.7, 0.3)], radius: 0.2, falloff: 0.1"), &[]);
    let none = stroke("points: [], radius: 0.2");
    refused(&none, "[], radius", &["points is 0", "from 1 to 256"]);
    let far = stroke("points: [(0, 0, 0), (0, inf, 0)], radius: 0.2");
    refused(&far, "(0, inf", &["points is [0, inf, 0]", "none beyond 1e9"]);
    let many = stroke(&format!("points: [{}], radius: 0.2", "(0, 0, 0), ".repeat(257)));
    lobelia("check", &many, &[]).refused(&["points is 257"]);
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
    refused(&scene, "\"scene.rom\"", &["scene.rom: there is no such file", "The folder has scene.ron."]);
    let scene = wrong("Sphere(radius: 0.8)", "Mesh(path: \"$DATA/mesh.glb\")");
    refused_with("run", &scene, &[], "\"$DATA/mesh.glb\"", &scene, &["--data DIR"]);
    let said = fine(&scene, &[]);
    assert!(said.contains("1 below $DATA not looked for"), "{said}");
    let scene = wrong("Constant(0.5, 0.5, 0.5)", "Texture(\"none/albedo.png\")");
    refused(
        &scene,
        "\"none/albedo.png\"",
        &["none/albedo.png: there is no such file", "There is no folder none"],
    );
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
    lobelia("check", &scene, &[]).refused(&["expected a closing `]`", "opened here", "passes: ["]);
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
    let none = Outcome::of(&mut common::command(&["check", "nowhere/none.ron"]));
    none.refused(&["none.ron: there is no such file"]);
    lobelia("check", "", &[]).refused(&[]);
}

#[test]
fn surfaces_too_large_for_the_arithmetic_are_refused() {
    for radius in ["1e20", "1e38", "1e-20"] {
        let scene = wrong("radius: 0.8", &format!("radius: {radius}"));
        refused(&scene, radius, &["a number from"]);
    }
}
