//! `lobelia prepare`: from photographs or a video to a data set.

use super::prepare_args::{CameraArg, FeatureArg, LensArg, MatchingArg, PrepareArgs};
use super::signals::stop_on_signals;
use super::terminal::Terminal;
use super::threads::{ThreadArgs, start_threads};
use lobelia::Result;
use lobelia::pass::progress::Progress;
use lobelia::prepare::{
    CameraSharing, FeatureArea, FrameCount, LensModel, MaskSource, Matching, PrepareOptions, Prepared,
    prepare,
};

/// Runs the command.
pub fn run(args: &PrepareArgs) -> Result<()> {
    stop_on_signals()?;
    start_threads(ThreadArgs { threads: None })?;
    let terminal = Terminal::new(args.quiet);
    let prepared = prepare(&options(args), &terminal)?;
    if prepared.scene.is_none() {
        terminal.note(
            "there are no masks: put them into masks/ of the data set, or a mesh beside them; `lobelia new` then writes a scene file",
        );
    }
    terminal.print(&result(&prepared));
    Ok(())
}

fn result(prepared: &Prepared) -> String {
    match &prepared.scene {
        Some(scene) => format!("{prepared}\nnext: lobelia check {}", scene.display()),
        None => prepared.to_string(),
    }
}

fn options(args: &PrepareArgs) -> PrepareOptions {
    PrepareOptions {
        masks: masks(args),
        features: match args.features {
            FeatureArg::Auto => FeatureArea::Auto,
            FeatureArg::Object => FeatureArea::Object,
            FeatureArg::All => FeatureArea::All,
        },
        matching: match args.matching {
            MatchingArg::Auto => Matching::Auto,
            MatchingArg::Exhaustive => Matching::Exhaustive,
            MatchingArg::Sequential => Matching::Sequential,
        },
        cameras: match args.camera {
            CameraArg::Shared => CameraSharing::Shared,
            CameraArg::PerImage => CameraSharing::PerImage,
        },
        lens: match args.lens {
            LensArg::SimplePinhole => LensModel::SimplePinhole,
            LensArg::Pinhole => LensModel::Pinhole,
            LensArg::SimpleRadial => LensModel::SimpleRadial,
            LensArg::Radial => LensModel::Radial,
            LensArg::Opencv => LensModel::OpenCv,
            LensArg::OpencvFisheye => LensModel::OpenCvFisheye,
        },
        keep_distortion: args.keep_distortion,
        frames: frames(args),
        gpu: args.gpu,
        colmap: args.colmap.clone(),
        ffmpeg: args.ffmpeg.clone(),
        ..PrepareOptions::new(&args.photos, &args.out)
    }
}

fn frames(args: &PrepareArgs) -> FrameCount {
    match (args.frames, args.fps) {
        (Some(frames), _) => FrameCount::Count(frames),
        (None, Some(rate)) => FrameCount::PerSecond(rate),
        (None, None) => FrameCount::Auto,
    }
}

fn masks(args: &PrepareArgs) -> MaskSource {
    match (&args.masks, &args.mask_command) {
        (Some(folder), _) => MaskSource::Folder(folder.clone()),
        (None, Some(command)) => MaskSource::Command(command.clone()),
        (None, None) if args.backdrop => MaskSource::Backdrop,
        (None, None) => MaskSource::Alpha,
    }
}
