//! What can be typed after `lobelia`: arguments, their help, and the values that are refused.

use super::list::{LIST_EXAMPLES, LIST_LONG, ListArgs};
use super::prepare_args::{NewArgs, PREPARE_EXAMPLES, PREPARE_LONG, PrepareArgs};
use super::report_args::{REPORT_LONG, ReportArgs};
use super::run_args::{RUN_LONG, RunArgs, SceneArgs};
use super::threads::ThreadArgs;
use super::view_args::{VIEW_LONG, ViewArgs};
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  lobelia run scenes/quickstart.ron
      A first look: makes its own photographs, fits them, edits, relights and scores. Needs no data.
  lobelia run scenes/spot.ron --data ~/data/spot --out out/spot
      Your own photographs: $DATA in the scene file stands for ~/data/spot.
  lobelia run scenes/spot.ron --data ~/data/spot --set passes.fit.steps=200 --set views.downscale=2
      A quick try of the same, without touching the file.
  lobelia prepare ~/photos ~/data/vase --mask-command 'rembg i {in} {out}'
      Photographs without cameras: COLMAP finds these, and a scene file is written.
  lobelia check scenes/spot.ron --data ~/data/spot
      Is everything there and sensible? Nothing is run or written. (Without --data, what is below $DATA is not
      looked for.)
  lobelia view out/spot --light sky.hdr
      A page to turn, relight and edit the result in a browser: out/spot/view.html.
  lobelia report out/spot out/spot-again --out both.html
      Two runs side by side. The page of one run is written with it: out/spot/report.html.
  lobelia eval out/spot/novel ~/data/spot/test/image
      How close are these images to those?

Exit codes: 0 done, 1 ran and failed, 2 bad input, 130, 143 or 129 stopped by Ctrl-C, SIGTERM or
SIGHUP (what was found is kept).";

const BENCH_LONG: &str = "\
Measures how long shading takes per point and light lobe on this machine, in about a minute.

Needs no data: points look in all directions, lobes lie evenly around them with sharpness 20 to some 300. Two
kernels are timed: `forward` computes radiance, as rendering does; `forward+adjoint` is what a step of a fit adds,
radiance again and the gradient with respect to light, material, albedo and normal. A number is the time of a whole
batch over points × lobes, with all threads together: the least of many repetitions, since other programs can only
make a repetition longer. Multiply by the pixels of a batch and by the lobes to know what a step costs.

`simd` is the instruction set the kernels chose; `skipped` is the part of the pairs that a mode leaves out.";

const BENCH_EXAMPLES: &str = "\
Examples:
  lobelia bench
      8, 32, 128 and 512 lobes, three roughnesses, one thread and all threads.
  lobelia bench --points 4096 --lobes 128 --threads 2 --seconds 5
      One batch of a fit, quickly.
  lobelia bench --json before.json
      Rows to compare with: mode, points, lobes, threads, roughness, forward_ns, forward_adjoint_ns, …";

const ENV_EXAMPLES: &str = "\
Examples:
  lobelia env fit sky.exr --lobes 100 --out sky.ron
      100 spherical Gaussians for a map, and sky.png: the map above, the lobes below. In a scene, put the text of
      sky.ron into light: Fixed(…), or say light: Fixed(Map(path: \"sky.exr\", lobes: 100)) to the same effect.
  lobelia env fit sky.exr --lobes 16,32,64,128,256
      How good would how many be? A table, nothing written.
  lobelia env fit studio.hdr --convention blender --white --upper-hemisphere --out studio.npy
      A map made for Blender's world; gray light from above only; as [M, 7] array.
  lobelia env render sky.ron --size 512x256 back.exr
      The lobes as a map again; a .png instead gives a picture to look at.
  lobelia env rotate sky.ron --euler 0,90,0 --out turned.ron
      What came from +Z now comes from +X.
  lobelia env info sky.ron
      Mean, power, peak, and the lobes by power.

LIGHT is a .ron light (what a scene has inside light: Fixed(…)), .npy lobes of shape [M, 7], or an OpenEXR or
Radiance HDR latitude-longitude map. Maps: +Y is up, the left edge looks along −Z, a quarter in is +X, the middle
is +Z; --convention says that a map faces as in another program.";

/// Recovers surface, material and light of a photographed object as spherical Gaussians; then edits and relights it.
#[derive(Debug, Parser)]
#[command(name = "lobelia", version = env!("LOBELIA_VERSION"), after_long_help = EXAMPLES, arg_required_else_help = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the passes of a scene file
    #[command(long_about = RUN_LONG, after_long_help = EXAMPLES)]
    Run(RunArgs),
    /// Read a scene file, look at its photographs and masks, and say what it would do and what is wrong
    Check(CheckArgs),
    /// From photographs or a video to a data set: cameras by COLMAP, masks, a scene file
    #[command(long_about = PREPARE_LONG, after_long_help = PREPARE_EXAMPLES)]
    Prepare(PrepareArgs),
    /// Write a commented scene file for a data set
    New(NewArgs),
    /// Write a page that shows a saved object in a browser: turned, relit, edited
    #[command(long_about = VIEW_LONG)]
    View(ViewArgs),
    /// Write a page that shows a run, or sets several side by side: scores, views, curves
    #[command(long_about = REPORT_LONG)]
    Report(ReportArgs),
    /// Name the units of many objects or frames, for what runs jobs on many machines
    #[command(long_about = LIST_LONG, after_long_help = LIST_EXAMPLES)]
    List(ListArgs),
    /// Compare two images, or the images of two folders by name: PSNR and SSIM in linear light
    Eval(EvalArgs),
    /// Shade a table of single points and add `diffuse` and `specular` to each case
    ShadeCases(ShadeCasesArgs),
    /// Measure how long shading takes per point and light lobe on this machine, in about a minute
    #[command(long_about = BENCH_LONG, after_long_help = BENCH_EXAMPLES)]
    Bench(BenchArgs),
    /// Environment light: fit SG lobes to a map, draw lobes as a map, turn a light, say what is in it
    Env(EnvArgs),
}

/// `lobelia check`.
#[derive(Args, Debug)]
pub struct CheckArgs {
    /// Which scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Write a contact sheet of all views, with masks and cameras, and survey.json into this folder
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// How many threads.
    #[command(flatten)]
    pub threads: ThreadArgs,
    /// Memory that a run would have to keep to: 8GiB, 500MiB [default: three quarters of what a process may have]
    #[arg(long, value_name = "SIZE", value_parser = lobelia::pass::memory::parse_bytes)]
    pub memory: Option<u64>,
    /// Processes of MPI that would share the run: what it needs is then that of one of them
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pub processes: u16,
}

/// `lobelia eval`.
#[derive(Args, Debug)]
pub struct EvalArgs {
    /// An image, or a folder of images
    pub prediction: PathBuf,
    /// What it should be: an image, or a folder with images of the same names
    pub truth: PathBuf,
    /// Take out one least-squares factor per channel, shared by all images, before scoring
    #[arg(long)]
    pub scale: bool,
}

/// `lobelia shade-cases`.
#[derive(Args, Debug)]
pub struct ShadeCasesArgs {
    /// A JSON list of cases: normal, view, light lobe, roughness, specular albedo, diffuse albedo
    #[arg(value_name = "CASES.json")]
    pub cases: PathBuf,
    /// The file to write: the same list with `diffuse` and `specular` RGB in each case
    #[arg(value_name = "OUT.json")]
    pub out: PathBuf,
    /// How light is computed
    #[arg(long, value_enum, default_value_t = CaseMode::Published)]
    pub mode: CaseMode,
    /// Floating-point numbers that cases are shaded in; path traced, f32 is the renderer itself and f64 the same sampling in doubles,
    /// for tables with values too small for f32
    #[arg(long, value_enum, default_value_t = CasePrecision::F64)]
    pub precision: CasePrecision,
    /// Nodes of `--mode accurate`
    #[arg(long, value_enum, default_value_t = CaseQuality::Default)]
    pub quality: CaseQuality,
    /// Paths per case, for `--mode path-traced`
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(2..=1 << 24))]
    pub samples: u32,
    /// How many threads.
    #[command(flatten)]
    pub threads: ThreadArgs,
}

/// `lobelia bench`.
#[derive(Args, Debug)]
pub struct BenchArgs {
    /// Points in a batch, 1 to 16777216
    #[arg(long, value_name = "N", default_value_t = 16_384, value_parser = clap::value_parser!(u32).range(1..=1 << 24))]
    pub points: u32,
    /// Numbers of light lobes, 1 to 4096 each
    #[arg(long, value_name = "M,…", value_delimiter = ',', default_values_t = [8, 32, 128, 512],
        value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub lobes: Vec<u32>,
    /// How many threads [default: first one, then one per processor]
    #[arg(long, value_name = "T", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Time for all measurements together, in seconds
    #[arg(long, value_name = "S", default_value_t = 50.0, value_parser = seconds)]
    pub seconds: f64,
    /// Measure a graphics adapter as well, the first or that whose name has this in it; a program built with the feature `gpu` can
    #[arg(long, value_name = "NAME", num_args = 0..=1, default_missing_value = "gpu")]
    pub gpu: Option<String>,
    /// Write the rows to this file too
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// How a case is shaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CaseMode {
    /// The published closed-form SG renderer.
    Published,
    /// Accurate closed-form integrals.
    Accurate,
    /// Monte Carlo integration of the exact BRDF.
    PathTraced,
}

/// How many nodes the accurate integrals have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CaseQuality {
    /// Six.
    Default,
    /// Twelve.
    High,
}

/// Floating-point numbers of the closed forms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CasePrecision {
    /// 32 bits, as in a fit.
    F32,
    /// 64 bits.
    F64,
}

/// `lobelia env`.
#[derive(Args, Debug)]
#[command(after_long_help = ENV_EXAMPLES, arg_required_else_help = true)]
pub struct EnvArgs {
    /// What to do.
    #[command(subcommand)]
    pub command: EnvCommand,
}

/// What to do with a light.
#[derive(Debug, Subcommand)]
pub enum EnvCommand {
    /// Fit spherical Gaussians to a map
    #[command(after_long_help = ENV_EXAMPLES)]
    Fit(FitArgs),
    /// Draw a light as a latitude-longitude map
    Render(RenderArgs),
    /// Turn a light
    Rotate(RotateArgs),
    /// Say what is in a light: mean, power, peak, lobes
    Info(InfoArgs),
}

/// How files are to be understood.
#[derive(Args, Clone, Copy, Debug)]
pub struct ConventionArgs {
    /// Which program's way EXR and HDR maps face, read or written
    #[arg(long, value_enum, value_name = "PROGRAM", default_value_t = MapName::Lobelia)]
    pub convention: MapName,
    /// Which way the axes of .npy lobes point, read or written
    #[arg(long, value_enum, value_name = "WAY", default_value_t = NpyName::Lobelia)]
    pub npy_convention: NpyName,
}

/// Which way a map faces, by the name of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MapName {
    /// +Y up, middle +Z, a quarter in +X
    Lobelia,
    /// Mitsuba 3: the same
    Mitsuba,
    /// three.js and glTF viewers built on it: +Y up, middle +X, a quarter in −Z
    ThreeJs,
    /// Blender's own world: +Z up, middle +X, a quarter in +Y
    Blender,
    /// Blender's world for an object exported with +Y up: as three-js
    BlenderYUp,
}

/// Which way the axes of `.npy` lobes point, by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum NpyName {
    /// World directions
    Lobelia,
    /// PhySG's published envmap*_sg_fit files: (x, y, z) stands for (z, y, −x)
    PhysgFit,
}

/// `lobelia env fit`.
#[derive(Args, Debug)]
pub struct FitArgs {
    /// An OpenEXR or Radiance HDR latitude-longitude map
    pub map: PathBuf,
    /// How many lobes, 1 to 512; several numbers, as 16,32,64, print a table and write nothing
    #[arg(long, value_name = "N[,N…]", value_delimiter = ',', default_value = "128",
        value_parser = clap::value_parser!(u16).range(1..=512))]
    pub lobes: Vec<u16>,
    /// Write the lobes here (.ron or .npy), and beside it a .png of the map and what the lobes make of it, unless another
    /// picture is there
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Light from above only: the map below the horizon counts as black, no lobe's axis points below it
    #[arg(long)]
    pub upper_hemisphere: bool,
    /// Gray light: fit the map's luminance
    #[arg(long)]
    pub white: bool,
    /// How files are to be understood.
    #[command(flatten)]
    pub conventions: ConventionArgs,
    /// How many threads.
    #[command(flatten)]
    pub threads: ThreadArgs,
    /// No progress bar and no notes
    #[arg(short, long)]
    pub quiet: bool,
}

/// `lobelia env render`.
#[derive(Args, Debug)]
pub struct RenderArgs {
    /// A .ron light, .npy lobes, or a map
    pub light: PathBuf,
    /// The file to write: .exr (radiance) or .png (a picture, exposed to a mid-gray mean)
    pub out: PathBuf,
    /// Width and height of the map in texels
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "512x256")]
    pub size: (u32, u32),
    /// How files are to be understood.
    #[command(flatten)]
    pub conventions: ConventionArgs,
}

/// `lobelia env rotate`.
#[derive(Args, Debug)]
pub struct RotateArgs {
    /// A .ron light, .npy lobes, or a map
    pub light: PathBuf,
    /// Turn about the world's x, then y, then z axis, in degrees
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, allow_hyphen_values = true,
        required_unless_present = "quaternion", conflicts_with = "quaternion")]
    pub euler: Option<[f32; 3]>,
    /// Turn by a quaternion, which is normalized
    #[arg(long, value_name = "X,Y,Z,W", value_parser = numbers::<4>, allow_hyphen_values = true)]
    pub quaternion: Option<[f32; 4]>,
    /// The file to write: .ron or .npy for lobes, .exr for a map
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// How files are to be understood.
    #[command(flatten)]
    pub conventions: ConventionArgs,
}

/// `lobelia env info`.
#[derive(Args, Debug)]
pub struct InfoArgs {
    /// A .ron light, .npy lobes, or a map
    pub light: PathBuf,
    /// List every lobe, not only the 16 of the greatest power
    #[arg(long)]
    pub all: bool,
    /// How files are to be understood.
    #[command(flatten)]
    pub conventions: ConventionArgs,
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let parse = |side: &str| side.trim().parse::<u32>().ok().filter(|n| (1..=16_384).contains(n));
    match text.split_once(['x', '×']) {
        Some((width, height)) => parse(width).zip(parse(height)),
        None => None,
    }
    .ok_or_else(|| "expected WIDTHxHEIGHT, each 1 to 16384, e.g. 512x256".to_owned())
}

fn numbers<const N: usize>(text: &str) -> Result<[f32; N], String> {
    let values: Option<Vec<f32>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    let finite = values.filter(|values| values.iter().all(|v| v.is_finite()));
    finite.and_then(|values| values.try_into().ok()).ok_or_else(|| {
        format!(
            "expected {N} numbers with commas between them, e.g. {}",
            [1; N].map(|n| n.to_string()).join(",")
        )
    })
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.0..=86_400.0).contains(&seconds) => Ok(seconds),
        _ => Err("expected a number of seconds from 0 to 86400".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_commands_are_well_formed() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }

    #[test]
    fn bench_refuses_senseless_numbers() {
        let refused =
            |arguments: &[&str]| Cli::try_parse_from([&["lobelia", "bench"], arguments].concat()).is_err();
        assert!(!refused(&["--lobes", "8,32", "--points", "1", "--threads", "2", "--seconds", "0.5"]));
        for bad in ["--lobes=0", "--lobes=8,x", "--points=0", "--threads=0", "--seconds=-1", "--seconds=nan"]
        {
            assert!(refused(&[bad]), "{bad}");
        }
    }

    #[test]
    fn sizes_and_numbers_are_read_or_refused() {
        assert_eq!(size("512x256"), Ok((512, 256)));
        for bad in ["512", "0x4", "512x", "axb", "99999x4", "-4x4"] {
            assert!(size(bad).is_err(), "{bad}");
        }
        assert_eq!(numbers::<3>("0, -90,1e1"), Ok([0.0, -90.0, 10.0]));
        for bad in ["1,2", "1,2,3,4", "1,2,nan", "", "1,,2"] {
            assert!(numbers::<3>(bad).is_err(), "{bad}");
        }
    }
}
