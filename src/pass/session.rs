//! What the passes of one run share.

use crate::codec::file::write_file;
use crate::error::stop::HeldStops;
use crate::error::{Error, Result};
use crate::fit::FramesTried;
use crate::fit::components::Unknowns;
use crate::fit::guard::StepGuard;
use crate::fit::run::{Done, FitPlugin, Initialize};
use crate::fit::share::AllReducePlugin;
use crate::light::light_frame::{LightFrame, OwnLightFrame};
use crate::light::placement::{PlacementTurn, Placements, TurnSource};
use crate::mesh::Surface;
use crate::pass::inputs::Watched;
use crate::pass::photograph::TrueObject;
use crate::pass::progress::Progress;
use crate::pipeline::Pipeline;
use crate::profile::{Profiler, stage};
use crate::ranks::{Ranks, check_interrupted_together};
use crate::report::profile::profile_table;
use crate::report::scores::{Communication, FrameTried, PlacementFound, Scores};
use crate::scene::{Albedo, Light, LightSource, Pass, PlacementLight, Scene, Views, Visibility};
use crate::shade::device::ShadingDevice;
use crate::shade::frame::FramePlugin;
use crate::spawn::light_file::angles;
use crate::spawn::{LoadedLight, load_light, unknowns};
use crate::visibility::{ObjectVisibility, VisibilitySettings};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

/// The scores of a run, in its output folder.
pub(crate) const METRICS: &str = "metrics.json";

/// The trace of a profiled run, in its output folder.
pub(crate) const TRACE: &str = "trace.json";

/// What beside shading has placed a surface: a fit then leaves its vertices where they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Placed {
    /// Its normals are not those of its triangles, but found by what it mirrors.
    pub normals: bool,
    /// Stereo has moved much of it.
    pub by_stereo: bool,
}

impl Placed {
    /// Whether vertices stay where they are.
    pub const fn holds_vertices(self) -> bool {
        self.normals || self.by_stereo
    }
}

/// Where a fit is between the choices about its material.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Chosen {
    /// The steps before the last choice.
    pub done: Done,
    /// The step after which several base materials are tried again, if they are.
    pub again_after: Option<u32>,
}

/// Everything the passes of one run share.
pub struct Session<'a> {
    /// The scene that is run.
    pub scene: &'a Scene,
    /// The world and its schedules.
    pub pipeline: Pipeline,
    /// The object's surface.
    pub surface: Arc<Surface>,
    /// The object that took its own photographs, if there is one.
    pub truth: Option<TrueObject>,
    /// Output folder.
    pub out: PathBuf,
    /// The lights that the scene names, loaded.
    pub lights: SceneLights,
    /// What the next fit initializes from the data: what is unknown without an initial value, until there has been one.
    pub initialize: Initialize,
    /// Steps of a `Shape` between two looks at it.
    pub debug_every: Option<u32>,
    /// What the terminal shows.
    pub progress: &'a dyn Progress,
    /// Scores so far.
    pub scores: Scores,
    /// Whether a fit has chosen several base materials, where the scene leaves that open.
    pub several: bool,
    /// Where the fit at work is between its choices.
    pub(super) chosen: Chosen,
    /// What beside shading has placed the surface.
    pub placed: Placed,
    /// Whether a pass has found the surface, or moved it.
    pub surface_found: bool,
    /// The files that the run reads, as they were when it began.
    pub(super) watched: Watched,
    /// The picture that a pass has written last.
    pub(super) last_picture: Option<PathBuf>,
    /// What measures the run, if it is profiled.
    pub(super) profiler: Option<Profiler>,
    /// The device of closed-form shading, if the run names one.
    pub(super) device: Option<ShadingDevice>,
    /// The processes that share the work of a fit, if there are several.
    pub(super) ranks: Option<Ranks>,
    /// As long as these do all alike: none stops before the others know.
    held_stops: Option<HeldStops>,
    /// Whether there is an object to write: all is given, or a `Shape` or `Fit` has found something.
    pub has_object: bool,
}

/// The lights that a scene names; read before anything is fitted, so that a bad file is found at once.
pub struct SceneLights {
    /// The scene's own, if it is not unknown.
    pub own: Option<LoadedLight>,
    /// Those of the groups of photographs after the first, as far as they are known.
    pub of_groups: Vec<Option<LoadedLight>>,
    /// Those of passes, by the pass's name.
    pub of_passes: BTreeMap<String, LoadedLight>,
}

impl SceneLights {
    pub(super) fn load(scene: &Scene, progress: &dyn Progress) -> Result<Self> {
        let load = |source: &LightSource| {
            let light = load_light(source)?;
            light.notes.iter().for_each(|note| progress.note(note));
            Ok(light)
        };
        let own = match &scene.light {
            Light::Initial(source) | Light::Fixed(source) => Some(load(source)?),
            Light::Unknown(_) => None,
        };
        let of_group = |light: PlacementLight| match light {
            PlacementLight::Fixed(source) => load(&source).map(Some),
            PlacementLight::Own | PlacementLight::Same => Ok(None),
        };
        let of_groups = scene.views.other_lights().into_iter().map(of_group).collect::<Result<_>>()?;
        let mut of_passes = BTreeMap::new();
        for pass in &scene.passes {
            if let Some(source) = pass.light() {
                of_passes.insert(pass.name().to_owned(), load(source)?);
            }
        }
        Ok(Self { own, of_groups, of_passes })
    }
}

/// Most memory that shadows and reflections may be expected to take.
const MOST_VISIBILITY_BYTES: usize = 4 << 30;

impl Session<'_> {
    /// Whether the object has shadows and reflections that the scene does not leave out; if so, the world has what it takes to find them.
    ///
    /// # Errors
    /// If that would take more than `MOST_VISIBILITY_BYTES`.
    pub fn has_visibility(&mut self) -> Result<bool> {
        let Visibility::Traced { directions, bounces, refresh_every } = self.scene.visibility else {
            return Ok(false);
        };
        if !self.pipeline.world.contains_resource::<ObjectVisibility>() {
            let settings = VisibilitySettings { directions, bounces, refresh_every };
            let texels = self.surface.atlas().covered.iter().filter(|covered| **covered).count();
            let bytes = settings.bytes(
                texels,
                self.scene.views.placements(),
                self.scene.views.other_lights().len() + 1,
            );
            if bytes > MOST_VISIBILITY_BYTES {
                let gib = bytes as f64 / f64::from(1 << 30);
                let problem =
                    format!("shadows of {texels} texels in {directions} directions may take {gib:.1} GiB");
                let help =
                    "Lower `texture_size` or `visibility: Traced(directions: …)`, or say `visibility: None`.";
                return Err(Error::usage(problem, help));
            }
            let start = Instant::now();
            let _tracing = stage("shadows traced");
            let bar = self.progress.bar("shadows", 0);
            bar.set_message("tracing".into());
            let ranks = self.pipeline.world.get_resource::<Ranks>();
            let traced = ObjectVisibility::new(&self.surface, settings, ranks)?;
            bar.finish_and_clear();
            check_interrupted_together(ranks)?;
            let (mib, elapsed) = (traced.bytes() as f64 / 1048576.0, start.elapsed().as_secs_f64());
            self.progress.print(&format!("visibility: traced in {elapsed:.1} s, {mib:.1} MiB"));
            self.pipeline.world.insert_resource(traced);
        }
        // A convex object hides nothing, and need not look at every step.
        Ok(!self.pipeline.world.resource::<ObjectVisibility>().sees_all())
    }
}

impl<'a> Session<'a> {
    /// A session before anything is put into its world; it has no output folder yet.
    pub(super) fn new(
        scene: &'a Scene,
        surface: Arc<Surface>,
        lights: SceneLights,
        progress: &'a dyn Progress,
    ) -> Self {
        let initialize = Initialize {
            light: matches!(scene.light, Light::Unknown(_)),
            albedo: matches!(scene.material.albedo, Albedo::Unknown),
            specular: scene.material.specular.is_open(),
        };
        Self {
            scene,
            pipeline: Pipeline::new(),
            surface,
            truth: None,
            out: PathBuf::new(),
            lights,
            initialize,
            debug_every: None,
            progress,
            scores: Scores::default(),
            several: false,
            chosen: Chosen::default(),
            placed: Placed::default(),
            surface_found: false,
            watched: Watched::default(),
            last_picture: None,
            profiler: None,
            device: None,
            ranks: None,
            held_stops: None,
            has_object: !scene.passes.iter().any(|pass| matches!(pass, Pass::Shape(_) | Pass::Fit(_))),
        }
    }

    /// Puts the systems of frames and fits into the world.
    pub(super) fn add_plugins(&mut self) {
        self.pipeline.add_plugin(&FramePlugin).add_plugin(&FitPlugin);
        if let Some(device) = &self.device {
            self.pipeline.world.insert_resource(device.clone());
        }
        if let Some(ranks) = &self.ranks {
            self.pipeline.add_plugin(&AllReducePlugin(ranks.clone()));
            self.held_stops.get_or_insert_default();
        }
    }

    /// Whether pass `index` comes after all fits, in which every process has a share.
    pub(super) fn is_after_fits(&self, index: usize) -> bool {
        !self.scene.passes[index..].iter().any(|pass| matches!(pass, Pass::Fit(_) | Pass::Shape(_)))
    }

    /// The processes that share the work, as long as all do alike.
    pub(super) fn sharing_ranks(&self) -> Option<&Ranks> {
        self.ranks.as_ref().filter(|_| self.held_stops.is_some())
    }

    /// Divides nothing any more if pass `index` comes after all fits. Returns whether this process then leaves it to the first one.
    pub(super) fn leave_to_first(&mut self, index: usize) -> bool {
        let Some(ranks) = self.ranks.as_ref().filter(|_| self.is_after_fits(index)) else { return false };
        self.pipeline.remove_plugin::<AllReducePlugin>();
        self.held_stops = None;
        ranks.rank() > 0
    }

    /// Stops now if another process was asked to, as long as all do alike.
    pub(super) fn agree_on_stop(&self) -> Result<()> {
        self.sharing_ranks().map_or(Ok(false), Ranks::any_stops).map(|_| ())
    }

    /// The frame in which the scene's own light stands still; `None` if a fit is to find it.
    pub fn light_frame(&self) -> Option<LightFrame> {
        self.scene.light_frame.frame(&self.scene.light)
    }

    /// Says which frame the pass found the light to stand still in, if it looked for it.
    pub(super) fn report_light_frame(&mut self, pass: &str) {
        let world = &mut self.pipeline.world;
        let Some(FramesTried(tried)) = world.remove_resource::<FramesTried>() else { return };
        let frame = world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default();
        self.scores.light_frame = ron::to_string(&frame).ok();
        self.scores.light_frames_tried =
            tried.iter().map(|(frame, error)| FrameTried { frame: frame.words(), error: *error }).collect();
        let error = |of: LightFrame| tried.iter().find(|(frame, _)| *frame == of).map(|(_, error)| *error);
        if let (Some(own), Some(world)) = (error(frame), error(LightFrame::World)) {
            let found = frame.words();
            let beside = match frame {
                LightFrame::World => String::new(),
                _ => format!(
                    " (error of the initialization {own:.4}; as one that stands around the object {world:.4})"
                ),
            };
            self.progress.print(&format!("{pass}: the light {found}{beside}"));
        }
    }

    /// Says how the object lies in placements whose rotation the pass has found.
    pub(super) fn report_placements(&mut self, pass: &str) {
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

    /// Says what the steps of the pass have sent, if several processes share them.
    pub(super) fn report_communication(&mut self, pass: &str) {
        let Some(ranks) = &self.ranks else { return };
        let sent = ranks.take_traffic();
        let steps = f64::from(sent.steps.max(1));
        let found = Communication {
            ranks: ranks.size(),
            bytes_per_step: sent.of_steps.bytes as f64 / steps,
            seconds_per_step: sent.of_steps.seconds / steps,
            bytes_of_shares: sent.of_shares.bytes as f64,
            seconds_of_shares: sent.of_shares.seconds,
        };
        self.progress.print(&format!("{pass}: {}", found.words()));
        self.scores.communication = Some(found);
    }

    /// What a fit may move now.
    pub fn unknowns(&self) -> Unknowns {
        let found = unknowns(self.scene);
        if self.several {
            Unknowns { blends: true, mono_specular: false, metal: true, ..found }
        } else {
            found
        }
    }

    /// The pass of this name.
    pub fn pass_named(&self, name: Option<&str>) -> Option<&'a Pass> {
        self.scene.passes.iter().find(|pass| Some(pass.name()) == name)
    }

    /// The folder of a pass.
    pub fn folder(&self, pass: &str) -> PathBuf {
        self.out.join(pass)
    }

    /// Writes the scores so far.
    pub(super) fn write_scores(&mut self) -> Result<()> {
        let guard = self.pipeline.world.get_resource::<StepGuard>();
        self.scores.steps_taken_back = guard.map_or(0, |guard| guard.taken_back);
        self.scores.profile = self.profiler.as_ref().map(Profiler::profile);
        self.scores.peak_rss_mib = crate::report::scores::peak_rss_mib();
        self.scores.write_json(self.out.join(METRICS))
    }

    /// Writes the trace of a profiled run, if it keeps one.
    fn write_trace(&self) -> Result<()> {
        let Some(profiler) = self.profiler.as_ref().filter(|profiler| profiler.keeps_events()) else {
            return Ok(());
        };
        let path = self.out.join(TRACE);
        write_file(&path, |writer| profiler.write_trace(writer).map_err(Error::io("write", &path)))
    }

    /// Writes the scores and shows the table.
    pub(super) fn finish(mut self) -> Result<()> {
        self.write_scores()?;
        self.progress.print(&self.scores.table());
        if let Some(profile) = &self.scores.profile {
            self.progress.print(&profile_table(profile));
        }
        self.write_trace()?;
        if let Some(picture) = &self.last_picture {
            self.progress.picture(picture);
        }
        self.progress.print(&format!("Results are in {}.", self.out.display()));
        Ok(())
    }
}
