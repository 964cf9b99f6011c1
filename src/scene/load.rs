//! Reading a scene file: `--set`, parsing, paths and checks, each error with a caret. Nothing is
//! written.
//!
//! ```
//! use lobelia::scene::{LoadOptions, load, to_ron};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("scene.ron");
//! let text = r#"(version: 1, seed: 3, surface: Sphere(),
//!     views: Cameras([(name: "front", eye: (0, 0, 3))]))"#;
//! std::fs::write(&path, text)?;
//! let sets = vec![("seed".to_owned(), "7".to_owned())];
//! let scene = load(&path, &LoadOptions { sets, ..LoadOptions::default() })?.scene;
//! assert_eq!(scene.seed, 7);
//! std::fs::write(&path, to_ron(&scene)?)?;
//! assert_eq!(load(&path, &LoadOptions::default())?.scene, scene);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::scene::diagnostic::{Problem, SceneText};
use crate::scene::{
    Edit, Scene, VERSION, ron_tree, ron_tree::Node, source::LoadOptions, source::set, validate::check,
};
use lobelia_geometry::{Error, Result};
use lobelia_io::codec::file::{FileKind, MOST_TEXT, obstacle, read_text};
use std::path::{Path, PathBuf};

/// A scene that was read and checked.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedScene {
    /// The scene; every path in it is resolved and, where it must exist, was found.
    pub scene: Scene,
    /// The scene file.
    pub path: PathBuf,
    /// The text that was read, with `--set` applied.
    pub text: String,
    /// The files and folders that the scene needs, in the order of the scene file; all were found.
    pub files: Vec<PathBuf>,
    /// Paths not looked for, because `$DATA` stands for nothing ([`LoadOptions::without_data`]).
    pub unseen: Vec<PathBuf>,
}

/// Reads and checks a scene file.
///
/// # Errors
/// [`Error::Input`] if the file cannot be read, [`Error::Usage`] for a `--set` that cannot be
/// applied, [`Error::Scene`] with a caret for everything that is wrong in the text.
pub fn load(path: &Path, options: &LoadOptions) -> Result<LoadedScene> {
    if let Some(data) = &options.data
        && let Some(obstacle) = obstacle(data, FileKind::Folder)
    {
        let problem = format!("--data {}: {}", data.display(), obstacle.problem);
        return Err(Error::usage(problem, "Give the folder that `$DATA` stands for."));
    }
    let help = |path: &Path| match path.is_dir() {
        true => format!("Give a scene file; `lobelia new {}` writes one for a folder.", path.display()),
        false => "Give a scene file, e.g. scenes/quickstart.ron.".to_owned(),
    };
    read(read_text(path, MOST_TEXT, help)?, path, options)
}

/// Reads and checks the text of a scene file that is at `path`, or would be.
pub(crate) fn read(mut text: String, path: &Path, options: &LoadOptions) -> Result<LoadedScene> {
    for (target, value) in &options.sets {
        text = set(&text, target, value)
            .map_err(|(problem, help)| Error::usage(format!("--set {target}={value}: {problem}"), help))?;
    }
    let words = SceneText { path, text: &text, edited: !options.sets.is_empty() };
    let (mut scene, root) = parse(&words)?;
    if let Some(seed) = options.seed {
        scene.seed = seed;
    }
    let found = check(&mut scene, path.parent().unwrap_or(Path::new("")), options);
    if !found.problems.is_empty() {
        return Err(words.problems(root.as_ref(), found.problems));
    }
    Ok(LoadedScene { scene, path: path.to_owned(), text, files: found.files, unseen: found.unseen })
}

/// The scene as RON text, laid out for people; it reads back to an equal scene.
///
/// # Errors
/// [`Error::Run`] if a path is not UTF-8, which RON cannot say.
pub fn to_ron(scene: &Scene) -> Result<String> {
    let config = ron::ser::PrettyConfig::new().depth_limit(6).struct_names(false);
    let text = ron_tree::options().to_string_pretty(scene, config);
    let text = text.map_err(|error| Error::run("writing the scene as RON", error.to_string()))?;
    // A variant with that name is written as a raw identifier; no field of a scene is an option of
    // such a type, so that both are read alike.
    Ok(text.replace(": r#None", ": None") + "\n")
}

/// An edit as RON text on one line, as a scene file has it.
///
/// # Errors
/// As [`to_ron`].
pub(crate) fn edit_to_ron(edit: &Edit) -> Result<String> {
    let text = ron_tree::options().to_string(edit);
    text.map_err(|error| Error::run("writing an edit as RON", error.to_string()))
}

/// The scene and, for carets, its tree of ranges.
fn parse(words: &SceneText) -> Result<(Scene, Option<Node>)> {
    let root = ron_tree::parse(words.text);
    let version = root.as_ref().ok().and_then(|root| root.field(words.text, "version"));
    let version = version.map(|node| &words.text[node.span.clone()]);
    // Another version is reported first, because it would explain every other complaint.
    if let (Ok(root), Some(found)) = (&root, version)
        && found.parse::<u32>().is_ok_and(|version| version != VERSION)
    {
        let problem = Problem {
            path: "version".into(),
            problem: format!("scene files of version {found} are not known"),
            expected: format!("expected {VERSION}"),
            help: format!("This program reads version {VERSION}."),
        };
        return Err(words.problems(Some(root), vec![problem]));
    }
    match (ron_tree::options().from_str::<Scene>(words.text), root) {
        (Ok(scene), root) => Ok((scene, root.ok())),
        (Err(error), Ok(root)) => Err(words.shape(&root, &error)),
        (Err(_), Err(error)) => Err(words.syntax(&error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Pass;

    /// Says most of what can be said.
    const RICH: &str = r#"Scene(
        version: 1,
        seed: 3,
        surface: Box(size: (1, 2, 1)),
        views: Photographed(
            cameras: (count: 6, test: 2, size: 32),
            truth: (
                albedo: Stripes(colors: [(0.8, 0.1, 0.1), (0.1, 0.1, 0.8)]),
                specular: (albedo: (0.2, 0.2, 0.2), roughness: 0.3, ndf: Ggx),
                light: Lobes(lobes: [(axis: (0, 1, 0), sharpness: 5, amplitude: (1, 0.1, 3e-7))], scale: 2),
            ),
        ),
        light: Unknown(),
        material: (specular: (albedo: Unknown(mono: false), roughness: Fixed(0.25), ndf: Ggx)),
        passes: [
            Fit(steps: 10, milestones: []),
            Render(name: "novel", render: (views: Named(["a"]), shading: PathTraced(spp: 8), orbit: (radius: 3))),
            Edit(name: "edited", edits: [
                Diffuse(action: Blend(color: (1, 1, 1), weight: 0.5), region: Box(min: (-1, -1, -1), max: (1, 0, 1))),
                Diffuse(action: Scale(0.5, 0.5, 0.5), region: Sphere(center: (0, 0, 0), radius: 1)),
                Specular(action: Set(0.9, 0.65, 0.3)),
                Roughness(action: Set(0.15), region: Stroke(points: [(0, 0.25, 0), (0.1, -2, 3)], radius: 0.5)),
            ]),
            Relight(name: "relit", light: Lobes(lobes: [(axis: (1, 0, 0), sharpness: 0, amplitude: (1, 1, 1))])),
            Evaluate(
                scores: [(pass: "novel", truth: Photographs), (pass: "edited", truth: SelfMade(), scale: PerLayer)],
                albedo: SelfMade,
            ),
            Save(),
            Export(name: "glb", formats: [Glb, Usda], triangles: 500),
        ],
    )"#;

    fn load_text(text: &str, options: &LoadOptions) -> Result<LoadedScene> {
        let folder = tempfile::tempdir().map_err(Error::io("create", "a temporary folder"))?;
        let path = folder.path().join("scene.ron");
        std::fs::write(&path, text).map_err(Error::io("write", &path))?;
        load(&path, options)
    }

    #[test]
    fn a_scene_survives_being_written_and_read() {
        let loaded = load_text(RICH, &LoadOptions::default()).unwrap();
        let text = to_ron(&loaded.scene).unwrap();
        let again = load_text(&text, &LoadOptions::default()).unwrap();
        assert_eq!(again.scene, loaded.scene, "{text}");
        let Pass::Render(render) = &again.scene.passes[1] else { panic!("{text}") };
        assert_eq!(render.render.orbit.as_ref().unwrap().radius, Some(3.0));
    }

    #[test]
    fn a_variant_called_none_is_written_as_people_write_it() {
        let text = r#"(version: 1, surface: Sphere(), views: Cameras([(name: "a", eye: (0, 0, 3))]),
            material: (sheen: None, tilt: None))"#;
        let scene = load_text(text, &LoadOptions::default()).unwrap().scene;
        let written = to_ron(&scene).unwrap();
        assert!(written.contains("sheen: None,") && written.contains("tilt: None,"), "{written}");
        assert_eq!(load_text(&written, &LoadOptions::default()).unwrap().scene, scene);
    }

    #[test]
    fn paths_are_resolved_against_data_and_the_scene_file() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        std::fs::create_dir(&data).unwrap();
        std::fs::write(data.join("mesh.glb"), "").unwrap();
        std::fs::write(folder.path().join("a.png"), "").unwrap();
        let path = folder.path().join("scene.ron");
        let text = r#"(version: 1, surface: Mesh(path: "$DATA/mesh.glb"), views: Dataset(path: "$DATA"),
            material: (albedo: Fixed(Texture("a.png"))))"#;
        std::fs::write(&path, text).unwrap();
        let options = LoadOptions { data: Some(data.clone()), ..LoadOptions::default() };
        let loaded = load(&path, &options).unwrap();
        assert_eq!(loaded.files, [data.join("mesh.glb"), data, folder.path().join("a.png")]);
        assert_eq!(load(&path, &LoadOptions::default()).unwrap_err().exit_code(), 2);
        let loaded = load(&path, &LoadOptions { without_data: true, ..LoadOptions::default() }).unwrap();
        assert_eq!(loaded.files, [folder.path().join("a.png")]);
        assert_eq!(loaded.unseen, [PathBuf::from("$DATA/mesh.glb"), PathBuf::from("$DATA")]);
    }

    #[test]
    fn the_largest_scenes_that_are_saved_are_far_below_the_limit() {
        let camera = |k: usize| format!(r#"(name: "view_{k:06}", eye: ({k}.123456, 4.5678901, 2.3456789))"#);
        let cameras: Vec<String> = (0..20_000).map(camera).collect();
        let views = format!("Cameras([{}])", cameras.join(", "));
        let text = format!("(version: 1, surface: Sphere(), views: {views})");
        let scene = load_text(&text, &LoadOptions::default()).unwrap().scene;
        assert!(to_ron(&scene).unwrap().len() as u64 * 2 < MOST_TEXT);
        let more = text.replace("Cameras([", r#"Cameras([(name: "one_more", eye: (1, 2, 3)), "#);
        let error = load_text(&more, &LoadOptions::default()).unwrap_err();
        assert!(error.to_string().contains("20001 cameras"), "{error}");
    }

    #[test]
    fn text_that_would_take_much_memory_or_time_is_refused() {
        let started = std::time::Instant::now();
        let refused = |text: &str, word: &str| {
            let error = load_text(text, &LoadOptions::default()).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains(word), "{word}: {error}");
            assert!(error.to_string().len() < 400, "{}", error.to_string().len());
        };
        refused(&" ".repeat(MOST_TEXT as usize + 1), "at most 16.0 MiB are read");
        refused(&format!("[{}", "1,".repeat(3_000_000)), "a scene file of fewer values");
        refused(&"(".repeat(100_000), "fewer brackets");
        refused(&"/*".repeat(100_000), "closing `*/`");
        refused(&format!("({}: 1)", "x".repeat(65_536)), "unknown field `xxx");
        refused("(\0version: 1)", "a value");
        let pass = |k: usize| format!(r#"Render(name: "p{k}"), "#);
        let passes: String = (0..1001).map(pass).collect();
        let text = format!(
            r#"(version: 1, surface: Sphere(), views: Cameras([(name: "a", eye: (0, 0, 3))]), passes: [{passes}])"#
        );
        refused(&text, "1001 passes");
        assert!(started.elapsed().as_secs() < 20);
    }

    #[test]
    fn every_prefix_of_a_scene_is_refused_without_a_panic() {
        for end in (0..RICH.len()).step_by(7) {
            assert_eq!(load_text(&RICH[..end], &LoadOptions::default()).unwrap_err().exit_code(), 2);
        }
    }
}
