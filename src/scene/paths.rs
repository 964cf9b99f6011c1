//! The files that a scene names: `$DATA` and relative paths resolved, and whether they exist.

use crate::codec::file::{FileKind, Obstacle, lies_in, obstacle};
use crate::dataset::priors::Priors;
use crate::scene::description::Scene;
use crate::scene::diagnostic::{Problem, nearest};
use crate::scene::edit::{DiffuseAction, Edit, Region};
use crate::scene::evaluate::{LayerTruth, Truth};
use crate::scene::light::{Light, LightSource};
use crate::scene::material::{Albedo, AlbedoSource, Gloss, Sheen, Tilt};
use crate::scene::passes::Pass;
use crate::scene::surface::Surface;
use crate::scene::views::{Dataset, PlacementLight, Views};
use std::path::{Path, PathBuf};

/// The files that a scene names.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Files {
    /// Resolved and there, without repeats, in the order of the scene file.
    pub found: Vec<PathBuf>,
    /// Below `$DATA`, which stands for nothing.
    pub unseen: Vec<PathBuf>,
    /// Where in the scene file the first of `unseen` is named.
    pub at: Option<String>,
}

/// Where the files of a scene are.
#[derive(Clone, Copy, Debug)]
pub struct Bounds<'a> {
    /// Where relative paths start: the folder of the scene file.
    pub base_dir: &'a Path,
    /// What `$DATA` stands for.
    pub data: Option<&'a Path>,
    /// Whether nothing beyond these is read.
    pub confined: bool,
}

impl Bounds<'_> {
    /// The folders.
    pub fn roots(self) -> Vec<PathBuf> {
        let base_dir = if self.base_dir.as_os_str().is_empty() { Path::new(".") } else { self.base_dir };
        std::iter::once(base_dir).chain(self.data).map(Path::to_owned).collect()
    }

    /// Whether a file that exists lies within, whatever links lead there.
    fn hold(self, path: &Path) -> bool {
        self.roots().iter().any(|folder| lies_in(path, folder))
    }
}

/// The problem of a path that is not within.
fn outside(at: &str, path: &Path, kind: FileKind) -> Problem {
    let folder = if kind == FileKind::Folder { path } else { path.parent().unwrap_or(path) };
    Problem {
        path: at.to_owned(),
        problem: format!("{}: this is outside the folder of the scene file and --data", path.display()),
        expected: "expected a path within".into(),
        help: format!(
            "A scene that a `Save` pass wrote names its data by path: give the folder of the data, --data {}, or say \
             --allow-outside to read whatever this scene names.",
            folder.display()
        ),
    }
}

/// Resolves every path of the scene in place and looks for it; what is not there, or not within `bounds`, becomes a problem.
///
/// `$DATA/…` starts at the data and is left as it is without; other relative paths start at the folder of the scene file.
pub fn resolve(scene: &mut Scene, bounds: Bounds, problems: &mut Vec<Problem>) -> Files {
    let mut files = Files::default();
    for_each_path(scene, &mut |at, kind, path| match place(path, bounds.base_dir, bounds.data) {
        Some(full) => {
            match complaint(&full, kind) {
                Some((problem, help)) => problems.push(Problem {
                    path: at.to_owned(),
                    problem,
                    expected: if kind == FileKind::File { "expected a file" } else { "expected a folder" }
                        .into(),
                    help,
                }),
                None if bounds.confined && !bounds.hold(&full) => problems.push(outside(at, &full, kind)),
                None if !files.found.contains(&full) => files.found.push(full.clone()),
                None => {}
            }
            *path = full;
        }
        None => {
            files.at.get_or_insert_with(|| at.to_owned());
            if !files.unseen.contains(path) {
                files.unseen.push(path.clone());
            }
        }
    });
    files
}

fn place(path: &Path, base_dir: &Path, data: Option<&Path>) -> Option<PathBuf> {
    match path.strip_prefix("$DATA") {
        Ok(rest) if rest.as_os_str().is_empty() => data.map(Path::to_owned),
        Ok(rest) => data.map(|data| data.join(rest)),
        Err(_) => Some(base_dir.join(path)),
    }
}

fn complaint(path: &Path, kind: FileKind) -> Option<(String, String)> {
    let Obstacle { problem, help } = obstacle(path, kind)?;
    let help = match kind {
        _ if !help.is_empty() => help,
        FileKind::File if path.is_dir() => "Name a file in it.".into(),
        FileKind::Folder if path.is_file() => "Name the folder that it is in.".into(),
        _ => missing_help(path),
    };
    Some((format!("{}: {problem}", path.display()), help))
}

/// What is there instead: the deepest folder that exists, and a name in it that is nearly the wanted one.
fn missing_help(path: &Path) -> String {
    let mut wanted = path;
    loop {
        let parent = match wanted.parent() {
            Some(parent) if parent.as_os_str().is_empty() => Path::new("."),
            Some(parent) => parent,
            None => return String::new(),
        };
        if parent.is_dir() {
            let name = wanted.file_name().unwrap_or_default().to_string_lossy();
            let mut there: Vec<String> = std::fs::read_dir(parent)
                .map(|entries| {
                    entries.flatten().map(|e| e.file_name().to_string_lossy().into_owned()).collect()
                })
                .unwrap_or_default();
            there.sort();
            return match nearest(&name, there.iter().map(String::as_str)) {
                Some(near) => format!("{} has no `{name}`; did you mean `{near}`?", parent.display()),
                None => format!("{} has no `{name}`.", parent.display()),
            };
        }
        wanted = parent;
    }
}

/// Calls `visit` with the scene-file place, the kind and the path of every file or folder that must exist.
fn for_each_path(scene: &mut Scene, visit: &mut impl FnMut(&str, FileKind, &mut PathBuf)) {
    if let Surface::Mesh { path, .. } = &mut scene.surface {
        visit("surface.path", FileKind::File, path);
    }
    match &mut scene.views {
        Views::Dataset(dataset) => dataset_paths(dataset, visit),
        Views::Photographed(made) => {
            light("views.truth.light.path", &mut made.truth.light, visit);
            for (i, other) in made.truth.other_lights.iter_mut().enumerate() {
                light(&format!("views.truth.other_lights.{i}.path"), other, visit);
            }
            edits("views.truth", &mut made.truth.edits, visit);
        }
        Views::Cameras(_) => {}
    }
    if let Light::Initial(source) | Light::Fixed(source) = &mut scene.light {
        light("light.path", source, visit);
    }
    if let Gloss::Fixed { weights, .. } = &mut scene.material.gloss {
        visit("material.gloss.weights", FileKind::File, weights);
    }
    if let Albedo::Initial(AlbedoSource::Texture(path)) | Albedo::Fixed(AlbedoSource::Texture(path)) =
        &mut scene.material.albedo
    {
        visit("material.albedo.0", FileKind::File, path);
    }
    if let Sheen::Fixed(AlbedoSource::Texture(path)) = &mut scene.material.sheen {
        visit("material.sheen.0", FileKind::File, path);
    }
    if let Tilt::Fixed(path) = &mut scene.material.tilt {
        visit("material.tilt.0", FileKind::File, path);
    }
    for (index, pass) in scene.passes.iter_mut().enumerate() {
        pass_paths(&format!("passes.{index}"), pass, visit);
    }
}

fn dataset_paths(dataset: &mut Dataset, visit: &mut impl FnMut(&str, FileKind, &mut PathBuf)) {
    visit("views.path", FileKind::Folder, &mut dataset.path);
    for (i, placement) in dataset.placements.iter_mut().enumerate() {
        if let PlacementLight::Fixed(source) = &mut placement.light {
            light(&format!("views.placements.{i}.light.path"), source, visit);
        }
    }
    let Priors { albedo, normals } = &mut dataset.priors;
    if let Some(prior) = albedo {
        visit("views.priors.albedo.folder", FileKind::Folder, &mut prior.folder);
    }
    if let Some(prior) = normals {
        visit("views.priors.normals.folder", FileKind::Folder, &mut prior.folder);
    }
}

/// The files and folders that a pass names.
pub(crate) fn paths_of(pass: &Pass) -> Vec<PathBuf> {
    let mut found = Vec::new();
    pass_paths("", &mut pass.clone(), &mut |_, _, path| found.push(path.clone()));
    found
}

fn pass_paths(at: &str, pass: &mut Pass, visit: &mut impl FnMut(&str, FileKind, &mut PathBuf)) {
    match pass {
        Pass::Edit(edit) => {
            edits(at, &mut edit.edits, visit);
            if let Some(source) = &mut edit.light {
                light(&format!("{at}.light.path"), source, visit);
            }
        }
        Pass::Relight(relight) => {
            light(&format!("{at}.light.path"), &mut relight.light, visit);
            edits(at, &mut relight.edits, visit);
        }
        Pass::Evaluate(evaluate) => {
            for (index, score) in evaluate.scores.iter_mut().enumerate() {
                let at = format!("{at}.scores.{index}.truth");
                match &mut score.truth {
                    Truth::Folder(path) => visit(&format!("{at}.0"), FileKind::Folder, path),
                    Truth::Files { folder, .. } => visit(&format!("{at}.folder"), FileKind::Folder, folder),
                    Truth::Photographs | Truth::SelfMade { .. } => {}
                }
            }
            for (field, truth) in [("albedo", &mut evaluate.albedo), ("normal", &mut evaluate.normal)] {
                let at = format!("{at}.{field}");
                match truth {
                    Some(LayerTruth::Folder(path)) => visit(&format!("{at}.0"), FileKind::Folder, path),
                    Some(LayerTruth::Files { folder, .. }) => {
                        visit(&format!("{at}.folder"), FileKind::Folder, folder);
                    }
                    Some(LayerTruth::SelfMade) | None => {}
                }
            }
            if let Some(path) = &mut evaluate.mesh {
                visit(&format!("{at}.mesh"), FileKind::File, path);
            }
        }
        Pass::Fit(_) | Pass::Shape(_) | Pass::Render(_) | Pass::Save(_) | Pass::Export(_) | Pass::View(_) => {
        }
    }
}

fn edits(at: &str, edits: &mut [Edit], visit: &mut impl FnMut(&str, FileKind, &mut PathBuf)) {
    for (index, edit) in edits.iter_mut().enumerate() {
        if let Edit::Diffuse { action: DiffuseAction::Texture(path), .. } = edit {
            visit(&format!("{at}.edits.{index}.action.0"), FileKind::File, path);
        }
        let (Edit::Diffuse { region, .. } | Edit::Specular { region, .. } | Edit::Roughness { region, .. }) =
            edit;
        if let Region::Mask(path) = region {
            visit(&format!("{at}.edits.{index}.region.0"), FileKind::File, path);
        }
    }
}

fn light(at: &str, source: &mut LightSource, visit: &mut impl FnMut(&str, FileKind, &mut PathBuf)) {
    match source {
        LightSource::Npy { path, .. } | LightSource::Map { path, .. } | LightSource::Ron { path, .. } => {
            visit(at, FileKind::File, path);
        }
        LightSource::Lobes { .. } => {}
    }
}
