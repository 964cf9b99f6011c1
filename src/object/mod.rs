//! An object: its surface, material and light, the photographs of it, and what is known of these, in
//! one world. A scene file and a program make one and call the same functions.
//!
//! ```no_run
//! use lobelia::prelude::*;
//!
//! let capture = Capture::read("kettle")?.hold_out(8);
//! let mut object = Object::reconstruct(&capture, &ReconstructOptions::default())?;
//! let camera = capture.test()[0].camera;
//! let frame = object.render(camera)?;
//! let night = object.relit(&Light::map("night.hdr")?).render(camera)?;
//! object.edited([Edit::metal("#d4af37", 0.2)?]).export("kettle.glb")?;
//! object.save("kettle/found")?;
//! # Ok::<(), lobelia::Error>(())
//! ```
//!
//! | module | holds |
//! | --- | --- |
//! | `fit` | light and material from photographs, with the choices on the way |
//! | `shape` | an unknown surface, with light and material beside it |
//! | [`show`] | what is shown of it: with edits, under another light, by another shading |
//! | [`save`], [`export`] | it as a scene file, and as a mesh for other programs |
//! | `photograph` | photographs that an object takes of itself, from a truth |

pub mod export;
pub(crate) mod fit;
pub(crate) mod photograph;
pub mod save;
pub(crate) mod shape;
pub mod show;
pub(crate) mod view_report;

use crate::capture::{Capture, read_views};
use crate::progress::{Progress, Silent};
use crate::report::scores::{FrameTried, PlacementFound, Scores};
use crate::scene::{
    Albedo, FitPass, Light, LightSource, LoadOptions, Material, Pass, PlacementLight, Scene, ShapePass,
    Surface as SurfaceSpec, UnknownLight, Views, Visibility, check_without_views, load,
};
use crate::spawn::{
    LoadedLight, Made, SurfaceUse, insert_known_along, light::angles, load_light, make_surface, spawn,
    unknowns,
};
use crate::survey::open::OpenScene;
use bevy_ecs::prelude::{Mut, Resource, World};
use bevy_ecs::{schedule::ScheduleConfigs, system::ScheduleSystem};
use glam::Vec3;
use lobelia_geometry::error::{Error, Result, stop::Stop, stop::check_interrupted, stop::finish_stopping};
use lobelia_geometry::{
    mesh::Surface, mesh::atlas::unwrap_mesh, mesh::triangles::Mesh, view::Split, view::ViewRecord,
};
use lobelia_solve::fit::run::{Done, FitPlugin, FitSummary, Initialize};
use lobelia_solve::fit::{FramesTried, ObjectTurned, components::Unknowns};
use lobelia_solve::shade::frame::FramePlugin;
use lobelia_solve::shape::run::{GeometryPlugin, keep_texel_count};
use lobelia_solve::visibility::{ObjectVisibility, VisibilitySettings};
use lobelia_world::checkpoint::{Span, from_bytes, keep_resource, keep_state, to_bytes};
use lobelia_world::light::lights::spawn_light;
use lobelia_world::light::placement::{PlacementTurn, Placements, TurnSource};
use lobelia_world::light::{light_frame::LightFrame, light_frame::OwnLightFrame};
use lobelia_world::material::{SpecularBlend, SpecularLobe, recovered_materials, replace_materials};
use lobelia_world::pipeline::{Phase, Pipeline, Slot};
use lobelia_world::sample::point::Scenery;
use photograph::TrueObject;
use serde::{Deserialize, Serialize};
use std::{path::Path, path::PathBuf, sync::Arc, time::Instant};
use tracing::info_span;
use view_report::warn;

/// Most memory that shadows and reflections may be expected to take.
const MOST_VISIBILITY_BYTES: usize = 4 << 30;

/// An object in a world of its own.
pub struct Object {
    pub(crate) pipeline: Pipeline,
}

/// What is said of an object: known, unknown, and how it is found, in the words of a scene file.
#[derive(Resource, Clone)]
struct Description(Arc<Scene>);

/// The surface of an object; [`Scenery`] is the same, or the field that a fit of the shape moves.
#[derive(Resource, Clone)]
struct ObjectSurface {
    surface: Arc<Surface>,
    /// Whether it was found, or moved.
    is_found: bool,
}

/// The receiver of what an object says.
#[derive(Resource, Clone)]
struct Listener(Arc<dyn Progress>);

/// What fits have found beside components and leave to later passes.
#[derive(Resource, Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Found {
    /// Unknowns that the next fit initializes from the data: those without an initial value, until
    /// there has been a fit.
    pub initialize: Initialize,
    /// Whether there is an object to write: all is given, or a `Shape` or `Fit` has found
    /// something.
    pub has_object: bool,
    /// Whether a fit has chosen several base materials, where the scene leaves that open.
    pub several: bool,
    /// The parts of the fit at work that are done.
    pub chosen: Chosen,
    /// Whether the surface's normals are not those of its triangles, but found from reflections,
    /// and whether stereo has moved much of it: a fit then leaves its vertices where they are.
    pub normals_found: bool,
    pub by_stereo: bool,
}

/// The parts of a fit that are done.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Chosen {
    /// The steps before the last pause or choice about the material.
    pub done: Done,
    /// The step after which the next choice is due, if one is.
    pub asked_after: Option<u32>,
    /// The step after which several base materials are tried again, if they are.
    pub again_after: Option<u32>,
    /// The end of all steps.
    pub finished: Option<FitSummary>,
}

/// How an object is found from photographs; what is not said is unknown, and found.
#[derive(Clone)]
pub struct ReconstructOptions {
    /// Width and height of the texture, in texels, 8 to 4096.
    pub texture_size: u32,
    /// The light, if it is known.
    pub light: Option<LoadedLight>,
    /// SG lobes of a light that is not known, 1 to 2048.
    pub lobes: u32,
    /// What is known of the material.
    pub material: Material,
    /// Shadows and reflections of the object on itself.
    pub visibility: Visibility,
    /// How the shape is found, where it is; `None`: as suits the photographs.
    pub shape: Option<ShapePass>,
    /// How light and material are found; `None`: as suits the photographs.
    pub fit: Option<FitPass>,
    /// Seed of every random choice.
    pub seed: u64,
    /// A request to stop, which another thread may make: what was found until then stays.
    pub stop: Stop,
    /// The receiver of messages and steps, which may end the work: [`Silent`], or a closure over
    /// [`Step`](crate::progress::Step)s.
    pub progress: Arc<dyn Progress>,
}

impl Default for ReconstructOptions {
    /// All is unknown and found as suits the photographs, on 512² texels, without messages.
    fn default() -> Self {
        Self {
            texture_size: 512,
            light: None,
            lobes: 128,
            material: Material::default(),
            visibility: Visibility::default(),
            shape: None,
            fit: None,
            seed: 0,
            stop: Stop::default(),
            progress: Arc::new(Silent),
        }
    }
}

impl Object {
    /// Finds the surface, light and material of what photographs with masks show.
    ///
    /// # Errors
    /// If a photograph has no mask, the masks have no hull, or a fit fails.
    pub fn reconstruct(capture: &Capture, options: &ReconstructOptions) -> Result<Self> {
        options.stop.over(|| {
            let spec = SurfaceSpec::Unknown { cells: 128, texture_size: options.texture_size };
            let shape = options.shape.clone().unwrap_or_else(|| capture.shape_pass());
            let fit = options.fit.clone().unwrap_or_else(|| capture.fit_pass_of_shape());
            let passes = vec![Pass::Shape(shape.clone()), Pass::Fit(fit.clone())];
            let mut object = Self::of_capture(spec, passes, capture, options, |spec| {
                make_surface(spec, capture, SurfaceUse::UntilShape)
            })?;
            if !object.find_shape(&shape)? {
                match object.find(&fit) {
                    // The shape stays.
                    Err(Error::Interrupted) => finish_stopping(),
                    found => drop(found?),
                }
            }
            Ok(object)
        })
    }

    /// Finds light and material of a surface that is known, from photographs.
    ///
    /// # Errors
    /// If the mesh cannot be unwrapped, no photograph shows it, or the fit fails.
    pub fn fit(mesh: &Mesh, capture: &Capture, options: &ReconstructOptions) -> Result<Self> {
        options.stop.over(|| {
            let texture_size = options.texture_size;
            let spec = SurfaceSpec::Mesh { path: PathBuf::new(), texture_size, own_material: false };
            let fit = options.fit.clone().unwrap_or_else(|| capture.fit_pass());
            let mut object = Self::of_capture(spec, vec![Pass::Fit(fit.clone())], capture, options, |_| {
                let unwrapped = unwrap_mesh(mesh, texture_size)?;
                Ok((Surface::new(unwrapped.mesh, texture_size)?, unwrapped.note.into_iter().collect()))
            })?;
            object.find(&fit)?;
            Ok(object)
        })
    }

    fn of_capture(
        surface: SurfaceSpec,
        passes: Vec<Pass>,
        capture: &Capture,
        options: &ReconstructOptions,
        make: impl FnOnce(&SurfaceSpec) -> Result<Made>,
    ) -> Result<Self> {
        let ReconstructOptions { light, lobes, material, visibility, seed, progress, .. } = options.clone();
        let light = light.map_or(Light::Unknown(UnknownLight { lobes }), |light| Light::Fixed(light.said()));
        let scene = Scene { seed, surface, light, material, visibility, passes, ..capture.scene() };
        check_without_views(&scene)?;
        let made = make(&scene.surface)?;
        let mut object = Self::of_scene(scene, made, capture.to_vec(), progress, false)?;
        capture.warnings().iter().for_each(|warning| warn(&mut object, warning.clone()));
        if capture.is_turntable() {
            object.pipeline.world.insert_resource(ObjectTurned);
        }
        Ok(object)
    }

    /// Opens an object that was saved, or that a scene file says in another way; no pass is run, and
    /// what is unknown has the values that a fit starts from.
    ///
    /// # Errors
    /// If the scene file or what it names cannot be read.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let mut scene = load(path.as_ref(), &LoadOptions::default())?.scene;
        if let Views::Photographed(spec) = &scene.views {
            scene.views = Views::Cameras(photograph::ring(&spec.cameras, scene.up));
        }
        let data = OpenScene::new(&scene)?;
        let (views, _) = read_views(&scene, data.as_ref(), &Silent)?;
        let made = make_surface(&scene.surface, &views, SurfaceUse::Lasting)?;
        Self::of_scene(scene.clone(), made, views, Arc::new(Silent), false)
    }

    /// The world and its systems.
    pub fn pipeline(&mut self) -> &mut Pipeline {
        &mut self.pipeline
    }

    /// Puts what a scene says, its surface and its views into a world, and reads its other inputs.
    /// All lights are read before anything is fitted, so that a bad file is found at once.
    /// Photographs that the scene makes of its own object have pixels if they are to be `rendered`.
    pub(crate) fn of_scene(
        scene: Scene,
        (surface, notes): Made,
        mut views: Vec<ViewRecord>,
        progress: Arc<dyn Progress>,
        rendered: bool,
    ) -> Result<Self> {
        let _opening = info_span!("scene opened").entered();
        notes.iter().for_each(|note| progress.note(note));
        let surface = Arc::new(surface);
        let load = |source: &LightSource| {
            let light = load_light(source)?;
            light.notes.iter().for_each(|note| progress.note(note));
            Ok(light)
        };
        let own_light = scene.light.source().map(load).transpose()?;
        let of_pass = |pass: &Pass| Some((pass.name().to_owned(), pass.light()?.clone()));
        let of_passes = scene.passes.iter().filter_map(of_pass);
        let of_passes: Vec<_> =
            of_passes.map(|(name, light)| Ok((name, load(&light)?))).collect::<Result<_>>()?;
        let of_group = |light: PlacementLight| match light {
            PlacementLight::Fixed(source) => load(&source).map(Some),
            PlacementLight::Own | PlacementLight::Same => Ok(None),
        };
        let others: Vec<_> = scene.views.other_lights().into_iter().map(of_group).collect::<Result<_>>()?;
        let mut pipeline = Pipeline::new();
        let world = &mut pipeline.world;
        if let Views::Photographed(spec) = &scene.views {
            let mut truth = TrueObject::new(spec, &surface)?;
            views = match rendered {
                true => truth.take(spec, &scene, &*progress)?,
                false => photograph::imagine(spec, &scene)?,
            };
            world.insert_resource(truth);
        }
        check_cameras(&scene, &views, &surface)?;
        let initialize = initialized(&scene, scene.material.specular.is_open());
        let has_object = !scene.passes.iter().any(|pass| matches!(pass, Pass::Shape(_) | Pass::Fit(_)));
        let chosen = Chosen::default();
        let (several, normals_found, by_stereo) = (false, false, false);
        world.insert_resource(Found { initialize, has_object, several, chosen, normals_found, by_stereo });
        world.insert_resource(Scores::default());
        keep_object(world);
        pipeline.add_plugin(&FramePlugin).add_plugin(&FitPlugin).add_plugin(&GeometryPlugin);
        spawn(&mut pipeline, &scene, &surface, views, own_light.as_ref(), &others)?;
        let world = &mut pipeline.world;
        for (name, light) in of_passes {
            spawn_light(world, name, &light.lobes, light.map);
        }
        world.insert_resource(ObjectSurface { surface, is_found: false });
        world.insert_resource(Listener(progress));
        world.insert_resource(Description(Arc::new(scene)));
        Ok(Self { pipeline })
    }

    /// What is said of the object, in the words of a scene file.
    pub fn scene(&self) -> Arc<Scene> {
        self.pipeline.world.resource::<Description>().0.clone()
    }

    /// The surface, with its texels.
    pub fn surface(&self) -> Arc<Surface> {
        self.pipeline.world.resource::<ObjectSurface>().surface.clone()
    }

    /// The scores, warnings and findings so far.
    pub fn scores(&mut self) -> Mut<'_, Scores> {
        self.pipeline.world.resource_mut()
    }

    pub(crate) fn found(&mut self) -> Mut<'_, Found> {
        self.pipeline.world.resource_mut()
    }

    pub(crate) fn progress(&self) -> Arc<dyn Progress> {
        self.pipeline.world.resource::<Listener>().0.clone()
    }

    /// Says a line of result.
    pub(crate) fn print(&self, text: &str) {
        self.progress().print(text);
    }

    /// Whether the object has shadows and reflections that the scene does not leave out; if so, the
    /// world has what it takes to find them.
    pub(crate) fn has_visibility(&mut self) -> Result<bool> {
        let scene = self.scene();
        let Visibility::Traced { directions, bounces, refresh_every } = scene.visibility else {
            return Ok(false);
        };
        if !self.pipeline.world.contains_resource::<ObjectVisibility>() {
            let settings = VisibilitySettings { directions, bounces, refresh_every };
            let texels = self.surface().atlas().covered.iter().filter(|covered| **covered).count();
            let views = &scene.views;
            let bytes = settings.bytes(texels, views.placements(), views.other_lights().len() + 1);
            if bytes > MOST_VISIBILITY_BYTES {
                let gib = bytes as f64 / f64::from(1 << 30);
                return Err(Error::usage(
                    format!("shadows of {texels} texels in {directions} directions may take {gib:.1} GiB"),
                    "Lower `texture_size` or `visibility: Traced(directions: …)`, or say `visibility: None`.",
                ));
            }
            let start = Instant::now();
            let _tracing = info_span!("shadows traced").entered();
            let bar = self.progress().bar("shadows", 0);
            bar.set_message("tracing".into());
            let traced = ObjectVisibility::new(&self.surface(), settings);
            drop(bar);
            check_interrupted()?;
            let (mib, elapsed) = (traced.bytes() as f64 / 1048576.0, start.elapsed().as_secs_f64());
            self.print(&format!("visibility: traced in {elapsed:.1} s, {mib:.1} MiB"));
            self.pipeline.world.insert_resource(traced);
        }
        // A convex object hides nothing, and need not look at every step.
        Ok(!self.pipeline.world.resource::<ObjectVisibility>().sees_all())
    }

    /// Puts these shadows and reflections into a phase if they are `wanted` and
    /// [there](Self::has_visibility), and else none.
    pub(crate) fn set_shadows(
        &mut self,
        phase: Phase,
        wanted: bool,
        systems: ScheduleConfigs<ScheduleSystem>,
    ) -> Result<()> {
        if wanted && self.has_visibility()? {
            self.pipeline.swap(phase, Slot::Visibility, systems);
        } else {
            self.pipeline.clear(phase, Slot::Visibility);
        }
        Ok(())
    }

    /// Says which frame the pass found the light to stand still in, if it looked for it.
    fn report_light_frame(&mut self, pass: &str) {
        let world = &mut self.pipeline.world;
        let Some(FramesTried(tried)) = world.remove_resource::<FramesTried>() else { return };
        let frame = world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default();
        let words = |(frame, error): &(LightFrame, f32)| FrameTried { frame: frame.words(), error: *error };
        let mut scores = self.scores();
        scores.light_frame = ron::to_string(&frame).ok();
        scores.light_frames_tried = tried.iter().map(words).collect();
        let error = |of: LightFrame| tried.iter().find(|(frame, _)| *frame == of).map(|(_, error)| *error);
        let (Some(own), Some(world)) = (error(frame), error(LightFrame::World)) else { return };
        let beside = match frame {
            LightFrame::World => String::new(),
            _ => format!(
                " (error of the initialization {own:.4}; as one that stands around the object {world:.4})"
            ),
        };
        self.print(&format!("{pass}: the light {}{beside}", frame.words()));
    }

    /// Says how the object lies in placements whose rotation the pass has found.
    fn report_placements(&mut self, pass: &str) {
        let Some(Placements(turns)) = self.pipeline.world.get_resource::<Placements>() else { return };
        let found = (1..).zip(turns.iter().skip(1)).filter(|(_, turn)| turn.source == TurnSource::Found);
        let scene = self.scene();
        let named = |(number, turn): (usize, &PlacementTurn)| PlacementFound {
            photographs: match &scene.views {
                Views::Dataset(data) => data.placements[number].photographs.clone(),
                Views::Photographed(_) | Views::Cameras(_) => format!("round {}", number + 1),
            },
            turned_degrees: angles(turn.room_from_object).into(),
        };
        let found: Vec<PlacementFound> = found.map(named).collect();
        for PlacementFound { photographs, turned_degrees: [x, y, z] } in &found {
            let turned = format!("({x:.1}, {y:.1}, {z:.1})°");
            self.print(&format!("{pass}: `{photographs}` shows the object turned by {turned}"));
        }
        self.scores().placements = found;
    }

    /// Returns the unknowns that a fit may move now.
    fn unknowns(&self) -> Unknowns {
        let found = unknowns(&self.scene());
        let several = Unknowns { blends: true, mono_specular: false, metal: true, ..found };
        if self.pipeline.world.resource::<Found>().several { several } else { found }
    }
}

/// What a first fit of a scene initializes from the data: what has no initial value.
fn initialized(scene: &Scene, specular: bool) -> Initialize {
    let light = matches!(scene.light, Light::Unknown(_));
    Initialize { light, albedo: matches!(scene.material.albedo, Albedo::Unknown), specular }
}

/// Puts a surface that was found, or moved, in place of the one before. Visibility is traced again
/// when it is needed.
fn replace_surface(world: &mut World, surface: Arc<Surface>) {
    world.insert_resource(Scenery(surface.clone()));
    world.insert_resource(ObjectSurface { surface, is_found: true });
    world.remove_resource::<ObjectVisibility>();
}

/// Registers what is found of an object beside the columns of a fit, which are loaded after it.
fn keep_object(world: &mut World) {
    let save = |world: &mut World| {
        let found = world.get_resource::<ObjectSurface>().filter(|surface| surface.is_found);
        found
            .map(|ObjectSurface { surface, .. }| to_bytes(&(surface.mesh(), surface.atlas().width)))
            .transpose()
    };
    let load = |world: &mut World, bytes: &[u8]| {
        let (mesh, width): (Mesh, u32) = from_bytes(bytes)?;
        let now = &world.resource::<ObjectSurface>().surface;
        if *now.mesh() != mesh || now.atlas().width != width {
            let surface = Arc::new(Surface::new(mesh, width)?);
            let scene = world.resource::<Description>().0.clone();
            insert_known_along(world, &scene.material.sheen, &surface)?;
            replace_surface(world, surface);
        }
        Ok(())
    };
    keep_state(world, "surface", Span::Run, save, load);
    keep_texel_count(world);
    // Lobes of base materials come after their numbers.
    let numbers = |world: &mut World| -> Vec<usize> {
        recovered_materials(world).into_iter().map(|(number, _)| number).collect()
    };
    let save = move |world: &mut World| to_bytes(&numbers(world)).map(Some);
    let load = move |world: &mut World, bytes: &[u8]| {
        let kept: Vec<usize> = from_bytes(bytes)?;
        if kept != numbers(world) {
            let lobes = vec![SpecularLobe::default(); kept.len()];
            replace_materials(world, &lobes, SpecularBlend::default())?;
        }
        Ok(())
    };
    keep_state(world, "base materials", Span::Run, save, load);
    keep_resource::<Found>(world, Span::Run);
    // In RON, which has numbers that are not finite and leaves out what is not there.
    let save = |world: &mut World| {
        let text = ron::to_string(world.resource::<Scores>());
        text.map(|text| Some(text.into_bytes()))
            .map_err(|error| Error::run("writing a checkpoint", error.to_string()))
    };
    let load = |world: &mut World, bytes: &[u8]| {
        let scores = ron::de::from_bytes::<Scores>(bytes);
        world.insert_resource(scores.map_err(|error| Error::run("reading a checkpoint", error.to_string()))?);
        Ok(())
    };
    keep_state(world, "scores", Span::Run, save, load);
}

/// Checks that each placement has a training photograph, where something is fitted to them; that
/// the cameras can be used, and that none is inside a closed object, where it sees only back faces.
fn check_cameras(scene: &Scene, views: &[ViewRecord], surface: &Surface) -> Result<()> {
    let names: Vec<String> = match &scene.views {
        Views::Dataset(data) => data.placements.iter().map(|of| format!("`{}`", of.photographs)).collect(),
        Views::Photographed(spec) => (1..=spec.truth.rounds()).map(|round| round.to_string()).collect(),
        Views::Cameras(_) => Vec::new(),
    };
    let fits = scene.passes.iter().any(|pass| matches!(pass, Pass::Fit(_) | Pass::Shape(_)));
    let train = || views.iter().filter(|view| view.split == Split::Train);
    let is_seen = |number: &usize| train().any(|view| view.placement.0 as usize == *number);
    if let Some(unseen) = (0..names.len()).find(|number| fits && !is_seen(number)) {
        return Err(Error::usage(
            format!("no training photograph shows the placement {}", names[unseen]),
            "A photograph belongs to the first entry of `placements` that it suits: say the longer name first, or leave the entry out.",
        ));
    }
    for view in views {
        view.camera.check().map_err(|problem| {
            let help = "Correct the camera, its field of view or `focal_scale`.";
            Error::usage(format!("the camera of view {} cannot be used: {problem}", view.name), help)
        })?;
    }
    let Some(view) = views.iter().find(|view| surface.is_inside(view.camera.position())) else {
        return Ok(());
    };
    let Vec3 { x, y, z } = view.camera.position();
    Err(Error::usage(
        format!("the camera of view {} is inside the object, at ({x:.3}, {y:.3}, {z:.3})", view.name),
        "Check that the cameras and the object have the same coordinate system and unit, or leave out that view.",
    ))
}
