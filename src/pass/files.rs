//! The files of a run, known before it begins: those that its passes may write, and those that it reads.

use crate::codec::file::{FileUse, Links, check_apart, check_inside, check_not_among};
use crate::codec::gltf::side_files;
use crate::error::Result;
use crate::fit::cameras::CameraUnknowns;
use crate::fit::exposure::ExposureChoice;
use crate::pass::evaluate::PARTS;
use crate::pass::export;
use crate::pass::fit::{TRUE_ENVIRONMENT, light_files};
use crate::pass::photograph::ring;
use crate::pass::render::{chosen_stems, film_files};
use crate::pass::truth_files::ViewFiles;
use crate::pass::view::PAGE;
use crate::pass::view_report::VIEWS;
use crate::scene::LayerTruth;
use crate::scene::load::LoadedScene;
use crate::scene::paths::paths_of;
use crate::scene::{EvaluatePass, Light, LightSource, Pass, PlacementLight, Scene, Surface, Views};
use crate::spawn::light_file::inlined;
use crate::survey::open::OpenScene;
use crate::view::Split;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The manifest of a run, in its output folder.
pub(crate) const RUN: &str = "run.json";

/// What a pass may write, by paths below the output folder, with `/` between their parts. One that ends with `/` is a folder of
/// which all files are the pass's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PassFiles {
    /// The pass's name.
    pub pass: String,
    /// The files.
    pub files: Vec<String>,
}

/// What the passes of a scene may write: no less than what they will. `open` is the scene's data set, if it has one.
pub fn outputs(scene: &Scene, open: Option<&OpenScene>, debug_every: Option<u32>) -> Vec<PassFiles> {
    let views = views(scene, open);
    let views: Vec<(&str, Split)> = views.iter().map(|(name, split)| (name.as_str(), *split)).collect();
    let of_pass = |pass: &Pass| {
        let names = match pass {
            Pass::Fit(fit) => [of_fit(scene), of_views(fit.cameras, fit.exposure)].concat(),
            Pass::Shape(shape) => {
                let debug = debug_every.map(|_| "debug/".to_owned());
                [of_views(shape.cameras, shape.exposure), debug.into_iter().collect()].concat()
            }
            Pass::Render(_) | Pass::Edit(_) | Pass::Relight(_) => of_pictures(pass, &views),
            Pass::Evaluate(evaluate) => of_scores(scene, evaluate, &views),
            Pass::Save(_) => of_save(scene),
            Pass::Export(export) => export::files(export),
            Pass::View(_) => vec![PAGE.to_owned()],
        };
        let files = names.iter().map(|name| format!("{}/{name}", pass.name())).collect();
        PassFiles { pass: pass.name().to_owned(), files }
    };
    scene.passes.iter().map(of_pass).collect()
}

/// The names and splits of a scene's views, before any is read.
fn views(scene: &Scene, open: Option<&OpenScene>) -> Vec<(String, Split)> {
    match (&scene.views, open) {
        (Views::Cameras(cameras), _) => cameras.iter().map(|view| (view.name.clone(), view.split)).collect(),
        (Views::Photographed(spec), _) => {
            ring(&spec.cameras, scene.up).into_iter().map(|view| (view.name, view.split)).collect()
        }
        (Views::Dataset(_), Some(open)) => {
            open.views.iter().map(|view| (view.name().to_owned(), view.split())).collect()
        }
        (Views::Dataset(_), None) => Vec::new(),
    }
}

fn owned(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

fn of_fit(scene: &Scene) -> Vec<String> {
    let known = matches!(scene.views, Views::Photographed(_));
    let truth = if known { owned(&[TRUE_ENVIRONMENT]) } else { Vec::new() };
    let others = 2..scene.views.other_lights().len() + 2;
    let suffixes = std::iter::once(String::new()).chain(others.map(|number| format!("_{number}")));
    let light: Vec<String> = suffixes.flat_map(|suffix| light_files(&suffix)).collect();
    let albedo = [
        "albedo.png",
        "albedo.exr",
        "albedo_along.png",
        "albedo_along.exr",
        "seen.png",
        "materials.ron",
        "log.csv",
    ];
    let gloss = ["blend.exr", "blend.png", "roughness.exr", "roughness.png"];
    [light, truth, owned(&albedo), owned(&gloss)].concat()
}

fn of_views(cameras: CameraUnknowns, exposure: ExposureChoice) -> Vec<String> {
    let cameras = (cameras != CameraUnknowns::Given).then(|| "cam_dict_norm.json".to_owned());
    let exposures = (exposure != ExposureChoice::Equal).then(|| "exposures.csv".to_owned());
    cameras.into_iter().chain(exposures).collect()
}

fn of_pictures(pass: &Pass, views: &[(&str, Split)]) -> Vec<String> {
    let Some(settings) = pass.render() else { return Vec::new() };
    let stems = chosen_stems(views, settings).into_iter();
    let pictures = stems.flat_map(|(_, stem)| [format!("{stem}.exr"), format!("{stem}.png")]);
    let film = settings.orbit.iter().flat_map(|orbit| film_files(orbit.format));
    pictures.chain(film).collect()
}

/// A contact sheet, a table of the views, and small pictures of all views of the scored passes, each in a folder of that pass's name.
fn of_scores(scene: &Scene, pass: &EvaluatePass, views: &[(&str, Split)]) -> Vec<String> {
    let mut names = owned(&["contact_sheet.png", VIEWS]);
    for score in &pass.scores {
        let scored = scene.passes.iter().find(|pass| pass.name() == score.pass).and_then(Pass::render);
        for (_, stem) in scored.map(|settings| chosen_stems(views, settings)).unwrap_or_default() {
            names.extend(PARTS.map(|part| format!("{}/{stem}_{part}.jpg", score.pass)));
        }
    }
    names
}

fn of_save(scene: &Scene) -> Vec<String> {
    let textures = ["albedo.exr", "albedo_along.exr", "albedo_tilt.exr", "blend.exr"];
    let mut names = owned(&[textures.as_slice(), &["scene.ron", "mesh.glb", "light.npy"]].concat());
    // A map is copied, with its own extension.
    for source in lights(scene) {
        if let Some(LightSource::Map { path, .. }) = given(source) {
            let name = Path::new("light").with_extension(path.extension().unwrap_or_default());
            names.push(name.to_string_lossy().into_owned());
        }
    }
    for (light, number) in scene.views.other_lights().iter().zip(2..) {
        let source = if let PlacementLight::Fixed(source) = light { given(source) } else { None };
        let extension = match &source {
            Some(LightSource::Map { path, .. }) => path.extension().unwrap_or_default().to_string_lossy(),
            _ => "npy".into(),
        };
        names.push(format!("light_{number}.{extension}"));
    }
    names
}

/// The lights that a scene shows the object under.
fn lights(scene: &Scene) -> impl Iterator<Item = &LightSource> {
    let own = match &scene.light {
        Light::Initial(source) | Light::Fixed(source) => Some(source),
        Light::Unknown(_) => None,
    };
    own.into_iter().chain(scene.passes.iter().filter_map(Pass::light))
}

/// All lights that a scene names: also the one that its photographs are taken under.
fn all_lights(scene: &Scene) -> impl Iterator<Item = &LightSource> {
    let of_views: Vec<&LightSource> = match &scene.views {
        Views::Photographed(made) => {
            std::iter::once(&made.truth.light).chain(&made.truth.other_lights).collect()
        }
        Views::Dataset(_) | Views::Cameras(_) => lights_of_placements(scene).collect(),
    };
    lights(scene).chain(of_views)
}

/// The known lights of groups of photographs after the first.
fn lights_of_placements(scene: &Scene) -> impl Iterator<Item = &LightSource> {
    let placements = match &scene.views {
        Views::Dataset(data) => data.placements.as_slice(),
        Views::Photographed(_) | Views::Cameras(_) => &[],
    };
    placements.iter().filter_map(|placement| match &placement.light {
        PlacementLight::Fixed(source) => Some(source),
        PlacementLight::Same | PlacementLight::Own => None,
    })
}

/// The meshes that a scene names.
fn meshes(scene: &Scene) -> impl Iterator<Item = &PathBuf> {
    let own = match &scene.surface {
        Surface::Mesh { path, .. } => Some(path),
        Surface::Unknown { .. } | Surface::Sphere { .. } | Surface::Box { .. } => None,
    };
    let of_passes = scene.passes.iter().filter_map(|pass| match pass {
        Pass::Evaluate(pass) => pass.mesh.as_ref(),
        _ => None,
    });
    own.into_iter().chain(of_passes)
}

/// A light, or what its RON file says; one that cannot be read is told of where it is loaded.
fn given(source: &LightSource) -> Option<LightSource> {
    match source {
        LightSource::Ron { path, scale, rotation_degrees } => inlined(path, *scale, *rotation_degrees).ok(),
        other => Some(other.clone()),
    }
}

/// The files that a run reads: the scene file, what it names, what these name, and camera files, photographs and masks of the views. Of the
/// folders that passes are scored against all files count, or those that may be of views.
pub fn inputs(loaded: &LoadedScene, open: Option<&OpenScene>) -> Vec<FileUse> {
    [named(loaded), of_data(loaded, open)].concat()
}

/// The scene file, the files that it names, and those that its lights and meshes name.
fn named(loaded: &LoadedScene) -> Vec<FileUse> {
    let mut inputs = vec![FileUse::new(&loaded.path, "the scene file")];
    let files = loaded.files.iter().filter(|path| path.is_file());
    inputs.extend(files.map(|path| FileUse::new(path, "which the scene file names")));
    for source in all_lights(&loaded.scene) {
        if let Some(LightSource::Map { path, .. } | LightSource::Npy { path, .. }) = given(source) {
            inputs.push(FileUse::new(path, "a light of the scene"));
        }
    }
    for mesh in meshes(&loaded.scene) {
        let by = format!("which {} names", mesh.display());
        inputs.extend(side_files(mesh).into_iter().map(|path| FileUse::new(path, &by)));
    }
    inputs.retain(|input| !loaded.unseen.contains(&input.path));
    inputs
}

/// The files in folders of data: ground truths, camera files, photographs, masks.
fn of_data(loaded: &LoadedScene, open: Option<&OpenScene>) -> Vec<FileUse> {
    let mut inputs = Vec::new();
    for truth in truths(&loaded.scene) {
        let by = format!("which is in {}, a folder of ground truth", truth.0.display());
        inputs.extend(ViewFiles::of(truth).found().into_iter().map(|path| FileUse::new(path, &by)));
    }
    let views = open.map(|open| open.views.as_slice()).unwrap_or_default();
    let cameras: BTreeSet<&Path> = views.iter().map(|view| view.camera_file()).collect();
    inputs.extend(cameras.into_iter().map(|path| FileUse::new(path, "which has the cameras")));
    inputs.extend(views.iter().flat_map(|view| view.pictures()));
    inputs
}

/// Checks that no file that is to be written is one that a run reads, or lies among photographs or masks.
///
/// # Errors
/// [`Error::Usage`](crate::Error::Usage) that names the first such file.
pub fn check_outputs(
    loaded: &LoadedScene,
    open: Option<&OpenScene>,
    outputs: &[FileUse],
    help: &str,
) -> Result<()> {
    check_apart(&inputs(loaded, open), outputs, help)?;
    let pictures: Vec<FileUse> =
        open.iter().flat_map(|open| &open.views).flat_map(|view| view.pictures()).collect();
    check_not_among(&pictures, outputs, help)
}

/// Checks that a confined scene reads nothing outside its folders through files that it names: a light, a mesh. Camera files of a data set
/// are held to that when it is opened ([`OpenScene::new`]). Links that are within a data set may lead where they will, for whoever gave the
/// data made them; all others count by what they lead to.
///
/// # Errors
/// [`Error::Usage`](crate::Error::Usage) that names the first file outside.
pub fn check_within(loaded: &LoadedScene) -> Result<()> {
    let Some(roots) = &loaded.roots else { return Ok(()) };
    let check = |input: &FileUse, links| check_inside(roots, input, links);
    named(loaded).iter().try_for_each(|input| check(input, Links::Followed))?;
    of_data(loaded, None).iter().try_for_each(|input| check(input, Links::Trusted))
}

/// The files of [`inputs`] whose contents a run depends on, beside the scene, sorted.
pub fn contents(loaded: &LoadedScene, open: Option<&OpenScene>) -> Vec<PathBuf> {
    let inputs = inputs(loaded, open).into_iter().map(|input| input.path);
    let files: BTreeSet<PathBuf> = inputs.filter(|path| *path != loaded.path && path.is_file()).collect();
    files.into_iter().collect()
}

/// What a pass reads only when it runs: files, and folders of files.
pub(crate) fn read_late(scene: &Scene, pass: &Pass) -> Vec<PathBuf> {
    match pass {
        // A map is copied as it is.
        Pass::Save(_) => lights(scene)
            .chain(lights_of_placements(scene))
            .filter_map(given)
            .filter_map(|light| match light {
                LightSource::Map { path, .. } => Some(path),
                _ => None,
            })
            .collect(),
        Pass::Fit(_) | Pass::Shape(_) | Pass::Render(_) | Pass::Export(_) | Pass::View(_) => Vec::new(),
        Pass::Evaluate(evaluate) => {
            let meshes =
                evaluate.mesh.iter().flat_map(|mesh| [vec![mesh.clone()], side_files(mesh)].concat());
            let truths = truths_of(evaluate).flat_map(|truth| match truth {
                (folder, None) => vec![folder.clone()],
                files => ViewFiles::of(files).found(),
            });
            meshes.chain(truths).collect()
        }
        Pass::Edit(_) | Pass::Relight(_) => paths_of(pass),
    }
}

/// The folder of a ground truth, and the path of each file from there if the scene says it.
type TruthFiles<'a> = (&'a PathBuf, Option<&'a str>);

fn truths(scene: &Scene) -> BTreeSet<TruthFiles<'_>> {
    let passes = scene.passes.iter().filter_map(|pass| match pass {
        Pass::Evaluate(pass) => Some(pass),
        _ => None,
    });
    passes.flat_map(truths_of).collect()
}

fn truths_of(pass: &EvaluatePass) -> impl Iterator<Item = TruthFiles<'_>> {
    let images = pass.scores.iter().filter_map(|score| score.truth.files());
    let layers = [&pass.albedo, &pass.normal].into_iter().flatten().filter_map(LayerTruth::files);
    images.chain(layers)
}
