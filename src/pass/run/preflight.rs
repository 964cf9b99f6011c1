//! The files of a run, known before it begins, and the checks before its first pass: a wrong name
//! or a missing ground truth is an error at the start, not after a long fit. `lobelia check` makes
//! the same checks.

use crate::object::{
    Object, export, photograph::ring, show::apply_edits, show::edits_of_nothing, view_report::VIEWS,
};
use crate::pass::{
    evaluate::PARTS, evaluate::read_fitting, fit::TRUE_ENVIRONMENT, fit::light_files, render::FILM_FILES,
    render::chosen_stems, render::chosen_views, view::PAGE,
};
use crate::report::PassRecord;
use crate::scene::{
    EvaluatePass, Gloss, LayerTruth, LightSource, Pass, PlacementLight, RenderSettings, Scene, Truth,
    ViewChoice, Views, load::LoadedScene,
};
use crate::spawn::light::{files_of, inlined};
use crate::survey::open::OpenScene;
use bevy_ecs::prelude::World;
use glam::Vec3;
use lobelia_geometry::parallel;
use lobelia_geometry::view::{Frame, Photograph, Split, ViewName};
use lobelia_geometry::{error::Error, error::Result};
use lobelia_io::codec::file::{FileUse, check_apart, check_not_among};
use lobelia_io::codec::gltf::import::read_mesh;
use lobelia_io::codec::{exr_frame::Layer, gltf::side_files, image::Gamma, nearby::closest};
use lobelia_solve::fit::{cameras::CameraUnknowns, exposure::ExposureChoice};
use lobelia_solve::shade::frame::{PixelSums, check_memory};
use lobelia_world::material::{SpecularBlend, shown::recovered_material};
use std::{collections::BTreeSet, fs, path::Path, path::PathBuf, time::SystemTime};

/// The manifest of a run, in its output folder.
pub(crate) const RUN: &str = "run.json";
/// Bytes of a rendered photograph's pixel: radiance and the mask.
const PHOTOGRAPH_PIXEL_BYTES: u64 = 12 + 2;

/// The passes of a scene before they begin, with all files that they may write. `open` is the
/// scene's data set, if it has one.
pub(super) fn outputs(scene: &Scene, open: Option<&OpenScene>, debug_every: Option<u32>) -> Vec<PassRecord> {
    // Before any view is read.
    let views: Vec<(String, Split)> = match (&scene.views, open) {
        (Views::Cameras(cameras), _) => cameras.iter().map(|view| (view.name.clone(), view.split)).collect(),
        (Views::Photographed(spec), _) => {
            ring(&spec.cameras, scene.up).into_iter().map(|view| (view.name, view.split)).collect()
        }
        (Views::Dataset(_), Some(open)) => {
            open.views.iter().map(|view| (view.plan.name.clone(), view.split)).collect()
        }
        (Views::Dataset(_), None) => Vec::new(),
    };
    let views: Vec<(&str, Split)> = views.iter().map(|(name, split)| (name.as_str(), *split)).collect();
    let stems = |settings: &RenderSettings| chosen_stems(&views, settings).into_iter().map(|(_, stem)| stem);
    let both = |stem: &str| [format!("{stem}.exr"), format!("{stem}.png")];
    let of_views = |cameras: CameraUnknowns, exposure: ExposureChoice| {
        let cameras = (cameras != CameraUnknowns::Given).then_some("cam_dict_norm.json");
        let exposures = (exposure != ExposureChoice::Equal).then_some("exposures.csv");
        cameras.into_iter().chain(exposures).map(str::to_owned)
    };
    let of_pass = |pass: &Pass| {
        let mut names = Vec::new();
        match pass {
            Pass::Fit(fit) => {
                names.extend(["albedo", "albedo_along", "blend", "roughness"].into_iter().flat_map(both));
                names.extend(["seen.png", "materials.ron", "log.csv"].map(str::to_owned));
                if matches!(scene.views, Views::Photographed(_)) {
                    names.push(TRUE_ENVIRONMENT.to_owned());
                }
                names.extend((1..scene.views.other_lights().len() + 2).flat_map(light_files));
                names.extend(of_views(fit.cameras, fit.exposure));
            }
            Pass::Shape(shape) => {
                names.extend(of_views(shape.cameras, shape.exposure));
                names.extend(debug_every.map(|_| "debug/".to_owned()));
            }
            Pass::Render(of) | Pass::Edit(of) | Pass::Relight(of) => {
                names.extend(stems(&of.render).flat_map(|stem| both(&stem)));
                names.extend(of.render.orbit.iter().flat_map(|_| FILM_FILES.map(str::to_owned)));
            }
            Pass::Evaluate(pass) => {
                // A contact sheet, a table of the views, and small pictures of all views of the
                // scored passes, each in a folder of that pass's name.
                names.extend(["contact_sheet.png", VIEWS].map(str::to_owned));
                for score in &pass.scores {
                    let scored = scene.passes.iter().find(|pass| pass.name() == score.pass);
                    for stem in scored.and_then(Pass::render).into_iter().flat_map(stems) {
                        names.extend(PARTS.map(|part| format!("{}/{stem}_{part}.jpg", score.pass)));
                    }
                }
            }
            Pass::Save(_) => names.extend(of_save(scene)),
            Pass::Export(export) => names.extend(export::files(export)),
            Pass::View(_) => names.push(PAGE.to_owned()),
        }
        let files = names.iter().map(|name| format!("{}/{name}", pass.name())).collect();
        PassRecord::waiting(pass.name(), files)
    };
    scene.passes.iter().map(of_pass).collect()
}

/// The files of a saved scene. A map is copied, with its own extension; one that cannot be read is
/// told of where it is loaded.
fn of_save(scene: &Scene) -> BTreeSet<String> {
    let name = |stem: &str, source: &LightSource| {
        let given = match source {
            LightSource::Ron { path, .. } => inlined(path, 1.0, Vec3::ZERO).ok(),
            other => Some(other.clone()),
        };
        let extension = match &given {
            Some(LightSource::Map { path, .. }) => path.extension().unwrap_or_default().to_string_lossy(),
            _ => "npy".into(),
        };
        format!("{stem}.{extension}")
    };
    let shown = scene.light.source().into_iter().chain(scene.passes.iter().filter_map(Pass::light));
    let mut names: BTreeSet<String> = shown.map(|source| name("light", source)).collect();
    names.extend(scene.views.other_lights().iter().zip(2..).map(|(light, number)| match light {
        PlacementLight::Fixed(source) => name(&format!("light_{number}"), source),
        PlacementLight::Own | PlacementLight::Same => format!("light_{number}.npy"),
    }));
    names.extend(["scene.ron", "mesh.glb", "light.npy"].map(str::to_owned));
    names.extend(["albedo", "albedo_along", "albedo_tilt", "blend"].map(|stem| format!("{stem}.exr")));
    names
}

/// The files that a run reads: the scene file, what it names, what these name, and the files of the
/// views. Of the folders that passes are scored against all files count, or those that may be of
/// views.
pub(super) fn inputs(loaded: &LoadedScene, open: Option<&OpenScene>) -> Vec<FileUse> {
    let mut inputs = vec![FileUse::new(&loaded.path, "the scene file")];
    for file in loaded.files.iter().filter(|path| path.is_file()) {
        inputs.push(FileUse::new(file, "which the scene file names"));
        let by = format!("which {} names", file.display());
        let is_mesh = file
            .extension()
            .is_some_and(|kind| kind.eq_ignore_ascii_case("glb") || kind.eq_ignore_ascii_case("gltf"));
        let of_mesh = if is_mesh { side_files(file) } else { Vec::new() };
        let named = files_of(file).into_iter().skip(1).chain(of_mesh);
        inputs.extend(named.map(|path| FileUse::new(path, &by)));
    }
    let truths = loaded.scene.passes.iter().flat_map(|pass| {
        let Pass::Evaluate(pass) = pass else { return Vec::new() };
        let images = pass.scores.iter().filter_map(|score| score.truth.files());
        let layers = [&pass.albedo, &pass.normal].into_iter().flatten().filter_map(LayerTruth::files);
        images.chain(layers).collect()
    });
    for truth in truths {
        let by = format!("which is in {}, a folder of ground truth", truth.folder.display());
        inputs.extend(truth.found().into_iter().map(|path| FileUse::new(path, &by)));
    }
    let views = open.map(|open| open.views.as_slice()).unwrap_or_default();
    let cameras: BTreeSet<&Path> = views.iter().map(|view| view.plan.camera_file.as_path()).collect();
    inputs.extend(cameras.into_iter().map(|path| FileUse::new(path, "which has the cameras")));
    inputs.extend(views.iter().flat_map(|view| view.pictures()));
    inputs
}

/// Checks that no file that is to be written is one that a run reads, or lies among photographs or
/// masks.
///
/// # Errors
/// [`Error::Usage`] that names the first such file.
pub fn check_outputs(
    loaded: &LoadedScene,
    open: Option<&OpenScene>,
    outputs: &[FileUse],
    help: &str,
) -> Result<()> {
    check_apart(&inputs(loaded, open), outputs, help)?;
    let pictures: Vec<_> = open.iter().flat_map(|of| &of.views).flat_map(|view| view.pictures()).collect();
    check_not_among(&pictures, outputs, help)
}

/// The files whose contents a run depends on, beside the scene, sorted.
pub(super) fn contents(loaded: &LoadedScene, open: Option<&OpenScene>) -> Vec<PathBuf> {
    let inputs = inputs(loaded, open).into_iter().map(|input| input.path);
    let files: BTreeSet<PathBuf> = inputs.filter(|path| *path != loaded.path && path.is_file()).collect();
    files.into_iter().collect()
}

/// Size of a file and the time of its last change, where the system says it; `None` if it is not
/// there.
type Stamp = Option<(u64, Option<SystemTime>)>;

/// Files as they were when the run began, watched: one that changes or goes while the run is at
/// work is told of.
#[derive(Clone, Debug, Default)]
pub(crate) struct Watched(Vec<(PathBuf, Stamp)>);

impl Watched {
    pub fn new(files: impl Iterator<Item = PathBuf>) -> Self {
        Self(files.map(|path| (path.clone(), Self::stamp(&path))).collect())
    }

    fn stamp(path: &Path) -> Stamp {
        fs::metadata(path).ok().map(|found| (found.len(), found.modified().ok()))
    }

    /// Watches these files no longer.
    pub fn without(mut self, files: impl Iterator<Item = PathBuf>) -> Self {
        let files: BTreeSet<PathBuf> = files.collect();
        self.0.retain(|(path, _)| !files.contains(path));
        self
    }

    /// Checks that no file has changed.
    pub fn check(&self) -> Result<()> {
        let changed = self.0.iter().map(|(path, before)| (path, before, Self::stamp(path)));
        let Some((path, _, now)) = changed.into_iter().find(|(_, before, now)| *before != now) else {
            return Ok(());
        };
        let what = if now.is_none() { "gone" } else { "changed" };
        let help = "Put it back as it was and go on with --resume, or start again with --force.";
        Err(Error::input(path, "", format!("the file has {what} since the run began"), help))
    }
}

/// Checks what a scene says of its pictures: each takes memory that is known before anything is
/// read.
///
/// # Errors
/// [`Error::Usage`] for photographs that take more than there may be.
pub fn check_sizes(scene: &Scene) -> Result<()> {
    // Views and films are rendered in bands of rows, and take little whatever their size.
    let Views::Photographed(spec) = &scene.views else { return Ok(()) };
    let ring = &spec.cameras;
    let (photographs, pixels) = (u64::from(ring.count) + u64::from(ring.test), u64::from(ring.size).pow(2));
    let frame = (size_of::<PixelSums>() + 4 * Frame::PIXEL_BYTES) as u64;
    let bytes = pixels * (photographs * PHOTOGRAPH_PIXEL_BYTES + frame);
    check_memory(&format!("rendering {photographs} photographs"), ring.size, ring.size, bytes)
}

/// Checks every pass against the world before any of them runs.
///
/// # Errors
/// [`Error::Usage`] or [`Error::Input`] for a view that does not exist, a pass without views, an
/// image of an edit that cannot be read, or a missing ground truth.
pub(super) fn check_passes(object: &mut Object) -> Result<()> {
    let (scene, surface) = (object.scene(), object.surface());
    let mut unedited = recovered_material(&mut object.pipeline.world)?;
    if matches!(scene.material.gloss, Gloss::Texels { .. }) {
        // Any texel may get any of the base materials.
        unedited.blends.fill(SpecularBlend::even(unedited.lobes.len()));
    }
    for pass in &scene.passes {
        let name = pass.name();
        if let Some(settings) = pass.render() {
            check_views(&mut object.pipeline.world, name, settings)?;
        }
        if !pass.edits().is_empty() {
            apply_edits(&mut unedited.clone(), pass.edits(), &surface)?;
            for number in edits_of_nothing(pass.edits(), &surface)? {
                let which = format!("pass {name}: edit {}", number + 1);
                object.progress().note(&format!("{which} changes nothing: its region contains no texel"));
            }
        }
        if let Pass::Evaluate(pass) = pass {
            check_truths(&mut object.pipeline.world, &scene, pass)?;
        }
    }
    Ok(())
}

/// Checks that the views of a pass exist, and that there is something to render.
fn check_views(world: &mut World, pass: &str, settings: &RenderSettings) -> Result<()> {
    if let ViewChoice::Named(wanted) = &settings.views {
        let names: Vec<String> = world.query::<&ViewName>().iter(world).map(|n| n.0.clone()).collect();
        if let Some(missing) = wanted.iter().find(|name| !names.contains(name)) {
            let near = closest(missing, names.iter().map(String::as_str)).join(", ");
            let help = match (near.is_empty(), names.first(), names.last()) {
                (false, ..) => format!("Near it: {near}."),
                (true, Some(first), Some(last)) => format!("There are {}, {first} to {last}.", names.len()),
                _ => "There are no views.".to_owned(),
            };
            return Err(Error::usage(format!("pass {pass}: there is no view {missing}"), help));
        }
    }
    if settings.orbit.is_none() && chosen_views(world, settings).is_empty() {
        let problem = format!("pass {pass} renders nothing: no view matches");
        let help = "Use `render: (views: All)`, or give it an `orbit`.";
        return Err(Error::usage(problem, help));
    }
    Ok(())
}

/// Checks that every scored view has its ground truth, and the surface, too.
fn check_truths(world: &mut World, scene: &Scene, pass: &EvaluatePass) -> Result<()> {
    if let Some(path) = &pass.mesh {
        read_mesh(path)?;
    }
    for (i, score) in pass.scores.iter().enumerate() {
        let settings = scene.pass_named(Some(&score.pass)).and_then(Pass::render);
        let Some(settings) = settings else { continue };
        let views = chosen_views(world, settings);
        let world = &*world;
        let checked = parallel::map_slice(&views, 1, |view| match &score.truth {
            Truth::Photographs if world.get::<Photograph>(view.entity).is_none() => Err(Error::usage(
                format!("pass {} is scored against photographs, but view {} has none", score.pass, view.stem),
                "Score only views with photographs: choose them with `render: (views: …)`.",
            )),
            truth => truth.files().map_or(Ok(()), |files| {
                read_fitting(&files.image(&view.name), Gamma::Srgb, &view.camera).map(drop)
            }),
        });
        checked.into_iter().collect::<Result<()>>()?;
        // Layers are scored on the views of the first score.
        for (truth, layer) in [(&pass.albedo, Layer::Albedo), (&pass.normal, Layer::Normal)] {
            if let (0, Some(files)) = (i, truth.as_ref().and_then(LayerTruth::files)) {
                let checked = parallel::map_slice(&views, 1, |view| {
                    files.read_layer(layer, [&view.stem, &view.name], &view.camera).map(drop)
                });
                checked.into_iter().collect::<Result<()>>()?;
            }
        }
    }
    Ok(())
}
