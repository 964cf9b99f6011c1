//! Arguments of `lobelia prepare` and `lobelia new`, and their help.

use clap::{Args, ValueEnum};
use lobelia::dataset::Layout;
use std::path::PathBuf;

/// What `lobelia prepare --help` says first.
pub const PREPARE_LONG: &str = "\
Makes a data set of photographs whose cameras are unknown.

COLMAP finds the cameras: features, matches, mapping, undistortion. OUT then has images/, sparse/0/, masks/ if there
are masks, logs/, and a commented scene file scene.ron. OUT must be new or empty. A run that was stopped goes on where
it was when the same command is given again; steps whose options changed are done again.";

/// What it says last.
pub const PREPARE_EXAMPLES: &str = "\
Examples:
  lobelia prepare ~/photos ~/data/vase --mask-command 'rembg i {in} {out}'
      Masks by a program of your own: it is run once per photograph.
  lobelia prepare ~/photos ~/data/vase --backdrop
      An object before plain paper, on a turntable or not.
  lobelia prepare walk.mp4 ~/data/statue --frames 120
      A video: the sharpest frame of each of 120 intervals. Needs ffmpeg.
  lobelia run ~/data/vase/scene.ron --out out/vase
      What to do then.";

/// `lobelia prepare`.
#[derive(Args, Debug)]
pub struct PrepareArgs {
    /// A folder of JPEG and PNG photographs, or a video
    pub photos: PathBuf,
    /// The folder of the data set; new or empty
    pub out: PathBuf,
    /// A folder of masks with the names of the photographs: the object white, or cutouts with alpha
    #[arg(long, value_name = "DIR", group = "mask_source")]
    pub masks: Option<PathBuf>,
    /// A command that writes the mask {out} of the photograph {in}, run once per photograph
    #[arg(long, value_name = "COMMAND", group = "mask_source")]
    pub mask_command: Option<String>,
    /// Masks from the photographs themselves, of an object before a plain backdrop
    #[arg(long, group = "mask_source")]
    pub backdrop: bool,
    /// What of a photograph shows where the camera is: with masks, the object alone or everything
    #[arg(long, value_enum, value_name = "AREA", default_value_t = FeatureArg::Auto)]
    pub features: FeatureArg,
    /// Which photographs are matched with each other
    #[arg(long, value_enum, value_name = "PAIRS", default_value_t = MatchingArg::Auto)]
    pub matching: MatchingArg,
    /// Which photographs share focal length and distortion
    #[arg(long, value_enum, value_name = "SHARING", default_value_t = CameraArg::Shared)]
    pub camera: CameraArg,
    /// The lens distortion that is estimated and removed
    #[arg(long, value_enum, value_name = "LENS", default_value_t = LensArg::SimpleRadial)]
    pub lens: LensArg,
    /// Copy photographs as they are, for Lobelia to remove the distortion: keeps 16 bits
    #[arg(long)]
    pub keep_distortion: bool,
    /// Frames of a video that are used, evenly spaced, each the sharpest of its interval; else 150, or a quarter of fewer than 600
    #[arg(long, value_name = "N", conflicts_with = "fps")]
    pub frames: Option<u32>,
    /// The same as frames per second
    #[arg(long, value_name = "N")]
    pub fps: Option<f32>,
    /// Let COLMAP use the graphics card (it must be built with CUDA)
    #[arg(long)]
    pub gpu: bool,
    /// COLMAP's program
    #[arg(long, value_name = "PROGRAM", default_value = "colmap")]
    pub colmap: PathBuf,
    /// ffmpeg's program, for videos
    #[arg(long, value_name = "PROGRAM", default_value = "ffmpeg")]
    pub ffmpeg: PathBuf,
    /// Nothing but errors on the terminal
    #[arg(short, long)]
    pub quiet: bool,
}

/// What of a photograph features are taken from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FeatureArg {
    /// The object where the background is the same in all photographs, as on a turntable; else everything
    Auto,
    /// The object alone
    Object,
    /// Everything
    All,
}

/// Which pairs of photographs are matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MatchingArg {
    /// All pairs; of more than 500 photographs or 100 frames, neighbors
    Auto,
    /// All pairs
    Exhaustive,
    /// Each with its neighbors by name
    Sequential,
}

/// Which photographs share a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CameraArg {
    /// All of one size and EXIF focal length
    Shared,
    /// None
    PerImage,
}

/// Lens models of COLMAP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LensArg {
    /// No distortion, one focal length
    SimplePinhole,
    /// No distortion, two focal lengths
    Pinhole,
    /// One radial coefficient
    SimpleRadial,
    /// Two radial coefficients
    Radial,
    /// Two radial and two tangential coefficients
    Opencv,
    /// A fisheye lens
    OpencvFisheye,
}

/// `lobelia new`.
#[derive(Args, Debug)]
pub struct NewArgs {
    /// The folder of a data set
    pub data: PathBuf,
    /// The file to write; it must not exist
    #[arg(long, value_name = "SCENE.ron", default_value = "scene.ron")]
    pub out: PathBuf,
    /// The layout of the data, where the folder has several: Colmap, Llff, Nerf, …
    #[arg(long, value_name = "LAYOUT", default_value = "Auto", hide_default_value = true, value_parser = parse_layout)]
    pub layout: Layout,
}

/// A layout by the name that it has in scene files.
fn parse_layout(name: &str) -> Result<Layout, String> {
    ron::from_str(name).map_err(|error| error.code.to_string())
}
