//! State that the passes of one run share.

use crate::pass::run::preflight::{Watched, check_cameras, check_passes};
use crate::pass::run::progress::Progress;
use crate::pass::{photograph, photograph::TrueObject, run::RunOptions, run::summary::Reporter};
use crate::report::scores::{FrameTried, PlacementFound, Scores, peak_rss_mib};
use crate::scene::{Albedo, Light, LightSource, Pass, PlacementLight, Scene, Views, Visibility};
use crate::spawn::{LoadedLight, SurfaceUse, light::angles, load_light, make_surface, spawn, unknowns};
use bevy_ecs::{schedule::ScheduleConfigs, system::ScheduleSystem};
use lobelia_geometry::error::{Error, Result, stop::check_interrupted};
use lobelia_geometry::{mesh::Surface, view::ViewRecord};
use lobelia_solve::fit::run::{Done, FitPlugin, FitSummary, Initialize};
use lobelia_solve::fit::{FramesTried, components::Unknowns, guard::StepGuard};
use lobelia_solve::shape::run::GeometryPlugin;
use lobelia_solve::{
    shade::frame::FramePlugin, visibility::ObjectVisibility, visibility::VisibilitySettings,
};
use lobelia_world::light::placement::{PlacementTurn, Placements, TurnSource};
use lobelia_world::light::{light_frame::LightFrame, light_frame::OwnLightFrame};
use lobelia_world::pipeline::{Phase, Pipeline, Slot};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::PathBuf, sync::Arc, time::Instant};
use tracing::info_span;

/// The scores of a run, in its output folder.
pub(crate) const METRICS: &str = "metrics.json";
/// Most memory that shadows and reflections may be expected to take.
const MOST_VISIBILITY_BYTES: usize = 4 << 30;

/// What passes leave to later ones beside the world; checkpoints keep it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct PassState {
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

/// Everything the passes of one run share.
pub(crate) struct Session<'a> {
    pub scene: &'a Scene,
    pub pipeline: Pipeline,
    pub surface: Arc<Surface>,
    /// Whether a pass has found the surface, or moved it.
    pub surface_found: bool,
    /// The object that took its own photographs, if there is one.
    pub truth: Option<TrueObject>,
    pub out: PathBuf,
    /// The scene's own light, if it is not unknown. All lights are read before anything is fitted,
    /// so that a bad file is found at once.
    pub own_light: Option<LoadedLight>,
    /// Lights of passes, by the pass's name.
    pub pass_lights: BTreeMap<String, LoadedLight>,
    /// Steps of a `Shape` between two looks at it.
    pub debug_every: Option<u32>,
    pub progress: &'a dyn Progress,
    pub scores: Scores,
    pub kept: PassState,
    /// The files that passes read when they run, as they were when the run began.
    pub watched: Watched,
    pub report: Reporter,
}

impl<'a> Session<'a> {
    /// Puts the scene and its views into a world, reads its other inputs, and checks all passes.
    /// Nothing is written yet. Photographs that the scene makes of its own object have pixels if
    /// they are to be `rendered`; checks look at none.
    pub fn open(
        scene: &'a Scene,
        mut views: Vec<ViewRecord>,
        options: &RunOptions,
        progress: &'a dyn Progress,
        use_of: SurfaceUse,
        rendered: bool,
    ) -> Result<Self> {
        let _opening = info_span!("scene opened").entered();
        let (surface, notes) = make_surface(&scene.surface, &views, use_of)?;
        notes.iter().for_each(|note| progress.note(note));
        let surface = Arc::new(surface);
        let load = |source: &LightSource| {
            let light = load_light(source)?;
            light.notes.iter().for_each(|note| progress.note(note));
            Ok(light)
        };
        let own_light = scene.light.source().map(load).transpose()?;
        let of_group = |light: PlacementLight| match light {
            PlacementLight::Fixed(source) => load(&source).map(Some),
            PlacementLight::Own | PlacementLight::Same => Ok(None),
        };
        let others: Vec<_> = scene.views.other_lights().into_iter().map(of_group).collect::<Result<_>>()?;
        let of_pass = |pass: &Pass| Some(load(pass.light()?).map(|light| (pass.name().to_owned(), light)));
        let pass_lights = scene.passes.iter().filter_map(of_pass).collect::<Result<_>>()?;
        let mut truth = None;
        if let Views::Photographed(spec) = &scene.views {
            let truth = truth.insert(TrueObject::new(spec, &surface)?);
            views = match rendered {
                true => truth.take(spec, scene, progress)?,
                false => photograph::imagine(spec, scene)?,
            };
        }
        check_cameras(scene, &views, &surface)?;
        let initialize = Initialize {
            light: matches!(scene.light, Light::Unknown(_)),
            albedo: matches!(scene.material.albedo, Albedo::Unknown),
            specular: scene.material.specular.is_open(),
        };
        let has_object = !scene.passes.iter().any(|pass| matches!(pass, Pass::Shape(_) | Pass::Fit(_)));
        let chosen = Chosen::default();
        let (several, normals_found, by_stereo) = (false, false, false);
        let mut session = Self {
            scene,
            pipeline: Pipeline::new(),
            surface,
            surface_found: false,
            truth,
            out: options.out.clone(),
            own_light,
            pass_lights,
            debug_every: options.debug_every,
            progress,
            scores: Scores::default(),
            kept: PassState { initialize, has_object, several, chosen, normals_found, by_stereo },
            watched: Watched::default(),
            report: Reporter::default(),
        };
        session.pipeline.add_plugin(&FramePlugin).add_plugin(&FitPlugin).add_plugin(&GeometryPlugin);
        if let Some(device) = &options.device {
            session.pipeline.world.insert_resource(device.clone());
        }
        let Self { pipeline, surface, own_light, .. } = &mut session;
        spawn(pipeline, scene, surface, views, own_light.as_ref(), &others)?;
        check_passes(&mut session)?;
        Ok(session)
    }

    /// Whether the object has shadows and reflections that the scene does not leave out; if so, the
    /// world has what it takes to find them.
    pub fn has_visibility(&mut self) -> Result<bool> {
        let Visibility::Traced { directions, bounces, refresh_every } = self.scene.visibility else {
            return Ok(false);
        };
        if !self.pipeline.world.contains_resource::<ObjectVisibility>() {
            let settings = VisibilitySettings { directions, bounces, refresh_every };
            let texels = self.surface.atlas().covered.iter().filter(|covered| **covered).count();
            let views = &self.scene.views;
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
            let bar = self.progress.bar("shadows", 0);
            bar.set_message("tracing".into());
            let traced = ObjectVisibility::new(&self.surface, settings);
            bar.finish_and_clear();
            check_interrupted()?;
            let (mib, elapsed) = (traced.bytes() as f64 / 1048576.0, start.elapsed().as_secs_f64());
            self.progress.print(&format!("visibility: traced in {elapsed:.1} s, {mib:.1} MiB"));
            self.pipeline.world.insert_resource(traced);
        }
        // A convex object hides nothing, and need not look at every step.
        Ok(!self.pipeline.world.resource::<ObjectVisibility>().sees_all())
    }

    /// Puts these shadows and reflections into a phase if they are `wanted` and
    /// [there](Self::has_visibility), and else none.
    pub fn set_shadows(
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
    pub fn report_light_frame(&mut self, pass: &str) {
        let world = &mut self.pipeline.world;
        let Some(FramesTried(tried)) = world.remove_resource::<FramesTried>() else { return };
        let frame = world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default();
        self.scores.light_frame = ron::to_string(&frame).ok();
        self.scores.light_frames_tried =
            tried.iter().map(|(frame, error)| FrameTried { frame: frame.words(), error: *error }).collect();
        let error = |of: LightFrame| tried.iter().find(|(frame, _)| *frame == of).map(|(_, error)| *error);
        let (Some(own), Some(world)) = (error(frame), error(LightFrame::World)) else { return };
        let beside = match frame {
            LightFrame::World => String::new(),
            _ => format!(
                " (error of the initialization {own:.4}; as one that stands around the object {world:.4})"
            ),
        };
        self.progress.print(&format!("{pass}: the light {}{beside}", frame.words()));
    }

    /// Says how the object lies in placements whose rotation the pass has found.
    pub fn report_placements(&mut self, pass: &str) {
        let Some(Placements(turns)) = self.pipeline.world.get_resource::<Placements>() else { return };
        let found = (1..).zip(turns.iter().skip(1)).filter(|(_, turn)| turn.source == TurnSource::Found);
        let named = |(number, turn): (usize, &PlacementTurn)| PlacementFound {
            photographs: match &self.scene.views {
                Views::Dataset(data) => data.placements[number].photographs.clone(),
                Views::Photographed(_) | Views::Cameras(_) => format!("round {}", number + 1),
            },
            turned_degrees: angles(turn.room_from_object).into(),
        };
        self.scores.placements = found.map(named).collect();
        for PlacementFound { photographs, turned_degrees: [x, y, z] } in &self.scores.placements {
            let turned = format!("({x:.1}, {y:.1}, {z:.1})°");
            self.progress.print(&format!("{pass}: `{photographs}` shows the object turned by {turned}"));
        }
    }

    /// Returns the unknowns that a fit may move now.
    pub fn unknowns(&self) -> Unknowns {
        let found = unknowns(self.scene);
        let several = Unknowns { blends: true, mono_specular: false, metal: true, ..found };
        if self.kept.several { several } else { found }
    }

    pub fn pass_named(&self, name: Option<&str>) -> Option<&'a Pass> {
        self.scene.passes.iter().find(|pass| Some(pass.name()) == name)
    }

    pub fn write_scores(&mut self) -> Result<()> {
        let guard = self.pipeline.world.get_resource::<StepGuard>();
        self.scores.steps_taken_back = guard.map_or(0, |guard| guard.taken_back);
        self.scores.peak_rss_mib = peak_rss_mib();
        self.scores.write_json(self.out.join(METRICS))
    }
}
