//! `lobelia prepare`: from photographs or a video to a data set; and `lobelia new`: a scene file
//! for one.

use super::start::{Choices, ThreadArgs, choices, start_threads, stop_on_signals};
use super::terminal::{Terminal, print};
use clap::Args;
use lobelia::prepare::scene_file::scene_for;
use lobelia::prepare::{FrameCount, MaskSource, Matching, PrepareOptions, prepare};
use lobelia::{Error, Result, codec::file::write_bytes, dataset::Layout, progress::Progress};
use std::path::PathBuf;

const EXAMPLES: &str = include_str!("help/prepare.txt").trim_ascii_end();

/// Makes a data set of photographs whose cameras are unknown.
///
/// COLMAP finds the cameras: features, matches, mapping, undistortion. OUT then has images/,
/// sparse/0/, masks/ if there are masks, logs/, and a commented scene file scene.ron. OUT must be
/// new or empty. A run that was stopped goes on where it was when the same command is given again;
/// steps whose options changed are done again.
#[derive(Args, Debug)]
#[command(
    about = "From photographs or a video to a data set: cameras by COLMAP, masks, a scene file",
    verbatim_doc_comment, after_long_help = EXAMPLES
)]
pub struct PrepareArgs {
    /// A folder of JPEG and PNG photographs, or a video
    photos: PathBuf,
    /// The folder of the data set; new or empty
    out: PathBuf,
    /// A folder of masks with the names of the photographs: the object white, or cutouts with alpha
    #[arg(long, value_name = "DIR", group = "mask_source")]
    masks: Option<PathBuf>,
    /// A command that writes the mask {out} of the photograph {in}, run once per photograph
    #[arg(long, value_name = "COMMAND", group = "mask_source")]
    mask_command: Option<String>,
    /// The part of a photograph that shows where the camera is: everything, or with masks the
    /// object alone
    #[arg(long, value_name = "AREA", default_value = "all", value_parser = choices(FEATURES))]
    features: bool,
    /// Which photographs are matched with each other
    #[arg(long, value_name = "PAIRS", default_value = "auto", value_parser = choices(MATCHINGS))]
    matching: Matching,
    /// Which photographs share focal length and distortion
    #[arg(long, value_name = "SHARING", default_value = "shared", value_parser = choices(SHARINGS))]
    camera: bool,
    /// The lens distortion that is estimated and removed
    #[arg(long, value_name = "LENS", default_value = "simple-radial", value_parser = choices(LENSES))]
    lens: &'static str,
    /// Copy photographs as they are, for Lobelia to remove the distortion: keeps 16 bits
    #[arg(long)]
    keep_distortion: bool,
    /// Frames of a video that are used, evenly spaced; else 150, or a quarter of fewer than 600
    #[arg(long, value_name = "N", conflicts_with = "fps")]
    frames: Option<u32>,
    /// Frames of a video per second that are used
    #[arg(long, value_name = "N")]
    fps: Option<f32>,
    /// Let COLMAP use the graphics card (it must be built with CUDA)
    #[arg(long)]
    gpu: bool,
    /// COLMAP's program
    #[arg(long, value_name = "PROGRAM", default_value = "colmap")]
    colmap: PathBuf,
    /// ffmpeg's program, for videos
    #[arg(long, value_name = "PROGRAM", default_value = "ffmpeg")]
    ffmpeg: PathBuf,
    /// Nothing but errors on the terminal
    #[arg(short, long)]
    quiet: bool,
}

const FEATURES: Choices<bool> = &[
    ("all", false, "Everything"),
    ("object", true, "The object alone: it turned before a camera that stood still"),
];
const MATCHINGS: Choices<Matching> = &[
    ("auto", Matching::Auto, "All pairs; of more than 500 photographs or 100 frames, neighbors"),
    ("exhaustive", Matching::Exhaustive, "All pairs"),
    ("sequential", Matching::Sequential, "Each with its neighbors by name"),
];
const SHARINGS: Choices<bool> =
    &[("shared", false, "All of one size and EXIF focal length"), ("per-image", true, "None")];
const LENSES: Choices<&str> = &[
    ("simple-pinhole", "SIMPLE_PINHOLE", "No distortion, one focal length"),
    ("pinhole", "PINHOLE", "No distortion, two focal lengths"),
    ("simple-radial", "SIMPLE_RADIAL", "One radial coefficient"),
    ("radial", "RADIAL", "Two radial coefficients"),
    ("opencv", "OPENCV", "Two radial and two tangential coefficients"),
    ("opencv-fisheye", "OPENCV_FISHEYE", "A fisheye lens"),
];

/// Runs `lobelia prepare`.
pub fn run(args: &PrepareArgs) -> Result<()> {
    stop_on_signals()?;
    start_threads(ThreadArgs { threads: None })?;
    let options = PrepareOptions {
        masks: match (&args.masks, &args.mask_command) {
            (Some(folder), _) => MaskSource::Folder(folder.clone()),
            (None, Some(command)) => MaskSource::Command(command.clone()),
            (None, None) => MaskSource::Auto,
        },
        object_features: args.features,
        matching: args.matching,
        camera_per_image: args.camera,
        lens: args.lens,
        keep_distortion: args.keep_distortion,
        frames: match (args.frames, args.fps) {
            (Some(frames), _) => FrameCount::Count(frames),
            (None, Some(rate)) => FrameCount::PerSecond(rate),
            (None, None) => FrameCount::Auto,
        },
        gpu: args.gpu,
        colmap: args.colmap.clone(),
        ffmpeg: args.ffmpeg.clone(),
        ..PrepareOptions::new(&args.photos, &args.out)
    };
    let terminal = Terminal { quiet: args.quiet };
    let prepared = prepare(&options, &terminal)?;
    let Some(scene) = &prepared.scene else {
        terminal.note(
            "there are no masks: put them into masks/ of the data set, or a mesh beside them; `lobelia new` then writes a scene file",
        );
        terminal.print(&prepared.to_string());
        return Ok(());
    };
    terminal.print(&format!("{prepared}\nnext: lobelia check {}", scene.display()));
    Ok(())
}

/// Write a commented scene file for a data set
#[derive(Args, Debug)]
pub struct NewArgs {
    /// The folder of a data set
    data: PathBuf,
    /// The file to write; it must not exist
    #[arg(long, value_name = "SCENE.ron", default_value = "scene.ron")]
    out: PathBuf,
    /// The layout of the data, where the folder has several: Colmap, Llff, Nerf, …
    #[arg(long, value_name = "LAYOUT", default_value = "Auto", hide_default_value = true,
        value_parser = |name: &str| ron::from_str::<Layout>(name).map_err(|error| error.code.to_string()))]
    layout: Layout,
}

/// Writes a commented scene file for a data set.
pub fn new(args: &NewArgs) -> Result<()> {
    if args.out.symlink_metadata().is_ok() {
        let problem = format!("{} exists", args.out.display());
        return Err(Error::usage(problem, "Choose another name with --out, or remove it."));
    }
    let text = scene_for(&args.data, args.layout, &args.out)?;
    write_bytes(&args.out, text.as_bytes())?;
    let (out, data) = (args.out.display(), args.data.display());
    let next = if text.contains("$DATA") { format!(" --data {data}") } else { String::new() };
    print(&format!("{out} is written\nnext: lobelia check {out}{next}\n"))
}
