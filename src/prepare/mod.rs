//! From photographs, or a video, to a data set: cameras by COLMAP, masks, and a scene file to begin with.
//!
//! | module | holds |
//! | --- | --- |
//! | `photographs` | the photographs of a folder, by their headers |
//! | `left_out` | files that are not used, and what to do about them |
//! | `video` | frames of a video, by `ffmpeg` |
//! | `masks`, `backdrop`, `regions` | masks from alpha, a folder, a command, or the color of a plain backdrop |
//! | `background` | whether the background stands still while the object turns |
//! | `colmap`, `model` | COLMAP's arguments and progress, and what its models hold |
//! | `options` | what is prepared and how, and what came of it |
//! | `reconstruct` | the steps that run it |
//! | `platter` | the cameras adjusted by what turns with the object |
//! | `program` | running another program |
//! | `work` | the output folder: steps that are done once, results that get their names at the end |
//! | [`scene_file`] | a commented scene file for a data set |
//!
//! | option | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | `photographs` | `PathBuf` | | | a folder of JPEG and PNG files, or a video |
//! | `out` | `PathBuf` | | | the data set; new, empty, or begun before |
//! | `masks` | [`MaskSource`] | | alpha | where masks come from |
//! | `features` | [`FeatureArea`] | | `Auto` | whether the background shows where cameras are |
//! | `matching` | [`Matching`] | | `Auto` | which pairs of photographs are matched |
//! | `cameras` | [`CameraSharing`] | | `Shared` | which photographs share focal length and distortion |
//! | `lens` | [`LensModel`] | | `SimpleRadial` | the distortion that is estimated |
//! | `keep_distortion` | `bool` | | `false` | photographs are copied as they are, with cameras that have distortion |
//! | `frames` | [`FrameCount`] | | `Auto` | how many frames of a video are used |
//! | `gpu` | `bool` | | `false` | COLMAP uses the graphics card |
//! | `colmap`, `ffmpeg` | `PathBuf` | | names on the PATH | the programs |

mod backdrop;
mod background;
mod colmap;
mod left_out;
mod masks;
mod model;
mod options;
mod photographs;
mod platter;
mod program;
mod reconstruct;
mod regions;
pub mod scene_file;
#[cfg(test)]
mod test_data;
#[cfg(unix)]
#[cfg(test)]
mod tests;
mod video;
mod work;

pub use colmap::{CameraSharing, LensModel};
pub use masks::MaskSource;
pub use options::{FeatureArea, FrameCount, Matching, PrepareOptions, Prepared};

use crate::codec::file::{lies_in, write_bytes};
use crate::dataset::Layout;
use crate::error::{Error, Result};
use crate::pass::progress::Progress;
use crate::prepare::background::{BackgroundMotion, background};
use crate::prepare::colmap::Colmap;
use crate::prepare::photographs::{Listing, PhotographFile};
use crate::prepare::program::Program;
use crate::prepare::reconstruct::{Features, Reconstruction};
use crate::prepare::video::FramePlan;
use crate::prepare::work::Work;
use std::path::Path;

/// Names of what a prepared data set consists of.
const FINISHED: [&str; 4] = ["images", "masks", "sparse", "scene.ron"];

/// Makes a data set in COLMAP's layout: `images`, `masks`, `sparse/0` and `scene.ron` in `options.out`.
///
/// The work lies in `.work` there until all of it is done; a run that was stopped goes on where it was. Programs write into `logs`.
///
/// # Errors
/// [`Error::Usage`] if an option is out of range, the output folder has other files, or a program is missing; [`Error::Input`] if photographs or
/// masks cannot be used, or no cameras are found; [`Error::Run`] with the last lines of a program that fails;
/// [`Error::Interrupted`] after Ctrl-C.
pub fn prepare(options: &PrepareOptions, progress: &dyn Progress) -> Result<Prepared> {
    options.masks.check()?;
    options.frames.check()?;
    check_apart(options)?;
    let colmap = Colmap::find(options.colmap.clone(), options.gpu)?;
    // A bad folder or video is refused before the output folder is made.
    let source = Source::open(options)?;
    let mut work = Work::claim(&options.out, &FINISHED)?;
    let video_frames = source.video_frames();
    let Listing { photographs, notes } = match source {
        Source::Photographs(listing) => listing,
        Source::Video(ffmpeg, plan) => frames(options, &ffmpeg, plan, &mut work, progress)?,
    };
    notes.iter().for_each(|note| progress.note(note));
    work.step("photographs", &format!("{photographs:?}"), |work| {
        photographs::check_pixels(&photographs, progress)?;
        photographs::place(&photographs, &work.emptied("photographs")?)
    })?;
    let has_masks = masks(options, &photographs, &mut work, progress)?;
    let features = if has_masks {
        features(options, &photographs, &work, progress)?
    } else {
        warn_of_turntable(options, &photographs, &work, progress)?;
        Features::All
    };
    let (photographs, is_video) = (photographs.as_slice(), video_frames.is_some());
    let steps = Reconstruction { options, colmap, photographs, is_video, has_masks, features, progress };
    let prepared = Prepared { video_frames, ..steps.run(&mut work)? };
    publish(&options.out, work, prepared)
}

/// Checks that nothing that is read lies where results go: those of work in progress are replaced.
fn check_apart(options: &PrepareOptions) -> Result<()> {
    let masks = match &options.masks {
        MaskSource::Folder(folder) => Some(folder),
        MaskSource::Alpha | MaskSource::Backdrop | MaskSource::Command(_) => None,
    };
    for (path, what) in [(Some(&options.photographs), "photographs"), (masks, "masks")] {
        if let Some(path) = path.filter(|path| lies_in(path, &options.out)) {
            let (path, out) = (path.display(), options.out.display());
            let problem =
                format!("the {what}, {path}, are in the output folder {out}, where they could be replaced");
            return Err(Error::usage(problem, "Give a folder that is new or empty."));
        }
    }
    Ok(())
}

/// What is prepared, before anything is written.
enum Source {
    Photographs(Listing),
    /// The program that reads the video, and which of its frames are used.
    Video(Program, FramePlan),
}

impl Source {
    fn open(options: &PrepareOptions) -> Result<Self> {
        let path = &options.photographs;
        if !video::is_video(path) {
            let listing = photographs::list(path)?;
            if options.frames != FrameCount::Auto {
                let problem = format!(
                    "a number of frames is that of a video, and {} is a folder of photographs",
                    path.display()
                );
                return Err(Error::usage(problem, "Leave out --frames and --fps: all photographs are used."));
            }
            return Ok(Self::Photographs(listing));
        }
        let ffmpeg = Program { path: options.ffmpeg.clone(), install: video::INSTALL };
        let plan = video::plan(&ffmpeg, path, options.frames)?;
        Ok(Self::Video(ffmpeg, plan))
    }

    /// How many frames the video has, if it is one.
    fn video_frames(&self) -> Option<u64> {
        match self {
            Self::Photographs(_) => None,
            Self::Video(_, plan) => Some(plan.total),
        }
    }
}

/// The frames of a video, as a folder of photographs.
fn frames(
    options: &PrepareOptions,
    ffmpeg: &Program,
    plan: FramePlan,
    work: &mut Work,
    progress: &dyn Progress,
) -> Result<Listing> {
    let video = &options.photographs;
    let metadata = video.metadata().map_err(Error::io("read", video))?;
    let settings = format!("{video:?} {} bytes, {plan:?}", metadata.len());
    work.step("video", &settings, |work| {
        let frames = work.emptied("frames")?;
        video::extract(ffmpeg, video, plan, &frames, &work.log("video"), progress)
    })?;
    photographs::list(&work.path("frames"))
}

/// Makes the masks, if there are to be any.
fn masks(
    options: &PrepareOptions,
    photographs: &[PhotographFile],
    work: &mut Work,
    progress: &dyn Progress,
) -> Result<bool> {
    let has_masks = options.masks.gives_masks(photographs);
    if !has_masks && photographs.iter().any(|photograph| photograph.has_alpha) {
        progress.note("some photographs have alpha and some have none: no alpha is taken as mask");
    }
    work.step("masks", &format!("{has_masks} {:?}", options.masks), |work| {
        let folder = work.emptied("masks")?;
        let (images, log) = (work.path("photographs"), work.log("masks"));
        if has_masks {
            masks::write_masks(&options.masks, photographs, &images, &folder, &log, progress)
        } else {
            Ok(())
        }
    })?;
    Ok(has_masks)
}

/// Where features are taken from.
fn features(
    options: &PrepareOptions,
    photographs: &[PhotographFile],
    work: &Work,
    progress: &dyn Progress,
) -> Result<Features> {
    let (images, masks) = (work.path("photographs"), work.path("masks"));
    let found = match (options.features, &options.masks) {
        (FeatureArea::Object, _) => return Ok(Features::Object),
        (FeatureArea::All, _) => return Ok(Features::All),
        // All that stands out from the backdrop is the object.
        (FeatureArea::Auto, MaskSource::Backdrop) => BackgroundMotion::SaysNothing,
        (FeatureArea::Auto, _) => background(photographs, &images, Some(&masks))?,
    };
    let (features, note) = match found {
        BackgroundMotion::Moves => {
            (Features::All, "the background differs between photographs: it helps to find the cameras")
        }
        BackgroundMotion::StandsStill => (
            Features::ObjectAndPlatter,
            "the background is the same in all photographs, as on a turntable: cameras are found by the object and what turns with it",
        ),
        BackgroundMotion::SaysNothing => {
            (Features::Object, "the background is plain: cameras are found by the object alone")
        }
    };
    progress.note(note);
    Ok(features)
}

/// Says what comes of a turntable without masks.
fn warn_of_turntable(
    options: &PrepareOptions,
    photographs: &[PhotographFile],
    work: &Work,
    progress: &dyn Progress,
) -> Result<()> {
    let is_asked = options.features == FeatureArea::Auto;
    if is_asked && background(photographs, &work.path("photographs"), None)? == BackgroundMotion::StandsStill
    {
        progress.note(
            "the background is the same in all photographs, as on a turntable, and there are no masks: cameras may be found by the background \
             and be wrong. Give masks with --masks DIR, --mask-command or --backdrop",
        );
    }
    Ok(())
}

/// Gives the results their names and writes the scene file.
fn publish(out: &Path, work: Work, mut prepared: Prepared) -> Result<Prepared> {
    let made = work.path("data");
    if prepared.has_masks {
        work.publish(&made.join("masks"), "masks")?;
    }
    work.publish(&made.join("images"), "images")?;
    work.publish(&made.join("sparse"), "sparse/0")?;
    if prepared.has_masks {
        let scene = out.join("scene.ron");
        let text = scene_file::scene_for(out, Layout::Auto, &scene)?;
        write_bytes(&scene, text.as_bytes())?;
        prepared.scene = Some(scene);
    }
    work.finish()?;
    Ok(prepared)
}
