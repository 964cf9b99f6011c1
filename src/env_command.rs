//! `lobelia env`: environment lights from the command line.

use crate::cli::ThreadArgs;
use crate::terminal::Terminal;
use crate::{print, start_threads};
use clap::{Args, Subcommand, ValueEnum};
use glam::{EulerRot, Quat};
use lobelia::codec::npy::NpyConvention;
use lobelia::codec::png_file::write_rgb8;
use lobelia::light::convention::MapConvention;
use lobelia::light::map_fit::{MapFit, MapFitReport, fit_map_with, target_of};
use lobelia::light::{EnvironmentMap, LightLobe};
use lobelia::pass::env::{before_and_after, info, picture, preview_factor, sun_notes};
use lobelia::pass::progress::Progress;
use lobelia::spawn::light_file::{LightConventions, LightFile, read_light, read_map};
use lobelia::{Error, Result};
use std::path::{Path, PathBuf};
use std::time::Instant;

const EXAMPLES: &str = "\
Examples:
  lobelia env fit sky.exr --lobes 100 --out sky.ron
      100 spherical Gaussians for a map, and sky.png: the map above, the lobes below. In a scene, put the text of
      sky.ron into light: Fixed(…), or say light: Fixed(Map(path: \"sky.exr\", lobes: 100)) to the same effect.
  lobelia env fit sky.exr --lobes 16,32,64,128,256
      How good would how many be? A table, nothing written.
  lobelia env fit studio.hdr --convention blender --white --upper-hemisphere --out studio.npy
      A map made for Blender's world; grey light from above only; as [M, 7] array.
  lobelia env render sky.ron --size 512x256 back.exr
      The lobes as a map again; a .png instead gives a picture to look at.
  lobelia env rotate sky.ron --euler 0,90,0 --out turned.ron
      What came from +Z now comes from +X.
  lobelia env info sky.ron
      Mean, power, peak, and the lobes by power.

LIGHT is a .ron light (what a scene has inside light: Fixed(…)), .npy lobes of shape [M, 7], or an OpenEXR or
Radiance HDR latitude-longitude map. Maps: +Y is up, the left edge looks along −Z, a quarter in is +X, the middle
is +Z; --convention says that a map faces as in another program.";

/// `lobelia env`.
#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES, arg_required_else_help = true)]
pub struct EnvArgs {
    /// What to do.
    #[command(subcommand)]
    pub command: EnvCommand,
}

/// What to do with a light.
#[derive(Debug, Subcommand)]
pub enum EnvCommand {
    /// Fit spherical Gaussians to a map
    #[command(after_long_help = EXAMPLES)]
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
    convention: MapName,
    /// Which way the axes of .npy lobes point, read or written
    #[arg(long, value_enum, value_name = "WAY", default_value_t = NpyName::Lobelia)]
    npy_convention: NpyName,
}

/// [`MapConvention`] by name.
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

/// [`NpyConvention`] by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum NpyName {
    /// World directions
    Lobelia,
    /// PhySG's published envmap*_sg_fit files: (x, y, z) stands for (z, y, −x)
    PhysgFit,
}

impl ConventionArgs {
    fn conventions(self) -> LightConventions {
        let map = match self.convention {
            MapName::Lobelia => MapConvention::Lobelia,
            MapName::Mitsuba => MapConvention::Mitsuba,
            MapName::ThreeJs => MapConvention::ThreeJs,
            MapName::Blender => MapConvention::Blender,
            MapName::BlenderYUp => MapConvention::BlenderYUp,
        };
        let npy = match self.npy_convention {
            NpyName::Lobelia => NpyConvention::Lobelia,
            NpyName::PhysgFit => NpyConvention::PhySgFit,
        };
        LightConventions { npy, map }
    }
}

/// `lobelia env fit`.
#[derive(Args, Debug)]
pub struct FitArgs {
    /// An OpenEXR or Radiance HDR latitude-longitude map
    map: PathBuf,
    /// How many lobes, 1 to 512; several numbers, as 16,32,64, print a table and write nothing
    #[arg(long, value_name = "N[,N…]", value_delimiter = ',', default_value = "128",
        value_parser = clap::value_parser!(u16).range(1..=512))]
    lobes: Vec<u16>,
    /// Write the lobes here (.ron or .npy), and beside it a .png of the map and what the lobes make of it
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Light from above only: the map below the horizon counts as black, no lobe's axis points below it
    #[arg(long)]
    upper_hemisphere: bool,
    /// Grey light: fit the map's luminance
    #[arg(long)]
    white: bool,
    /// How files are to be understood.
    #[command(flatten)]
    conventions: ConventionArgs,
    /// How many threads.
    #[command(flatten)]
    threads: ThreadArgs,
    /// No progress bar and no notes
    #[arg(long)]
    quiet: bool,
}

/// `lobelia env render`.
#[derive(Args, Debug)]
pub struct RenderArgs {
    /// A .ron light, .npy lobes, or a map
    light: PathBuf,
    /// The file to write: .exr (radiance) or .png (a picture, exposed to a mid-grey mean)
    out: PathBuf,
    /// Width and height of the map in texels
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "512x256")]
    size: (u32, u32),
    /// How files are to be understood.
    #[command(flatten)]
    conventions: ConventionArgs,
}

/// `lobelia env rotate`.
#[derive(Args, Debug)]
pub struct RotateArgs {
    /// A .ron light, .npy lobes, or a map
    light: PathBuf,
    /// Turn about the world's x, then y, then z axis, in degrees
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, allow_hyphen_values = true,
        required_unless_present = "quaternion", conflicts_with = "quaternion")]
    euler: Option<[f32; 3]>,
    /// Turn by a quaternion, which is normalised
    #[arg(long, value_name = "X,Y,Z,W", value_parser = numbers::<4>, allow_hyphen_values = true)]
    quaternion: Option<[f32; 4]>,
    /// The file to write: .ron or .npy for lobes, .exr for a map
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// How files are to be understood.
    #[command(flatten)]
    conventions: ConventionArgs,
}

/// `lobelia env info`.
#[derive(Args, Debug)]
pub struct InfoArgs {
    /// A .ron light, .npy lobes, or a map
    light: PathBuf,
    /// List every lobe, not only the 16 of the greatest power
    #[arg(long)]
    all: bool,
    /// How files are to be understood.
    #[command(flatten)]
    conventions: ConventionArgs,
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

/// Runs `lobelia env`.
pub fn run(command: &EnvCommand) -> Result<()> {
    match command {
        EnvCommand::Fit(args) => fit(args),
        EnvCommand::Render(args) => render(args),
        EnvCommand::Rotate(args) => rotate(args),
        EnvCommand::Info(args) => {
            let light = read(&args.light, args.conventions)?;
            print(&info(&light, args.all))
        }
    }
}

fn read(path: &Path, conventions: ConventionArgs) -> Result<LightFile> {
    let (light, notes) = read_light(path, conventions.conventions())?;
    notes.iter().for_each(|note| eprintln!("note: {note}"));
    Ok(light)
}

fn fit(args: &FitArgs) -> Result<()> {
    refuse_before_work(args)?;
    start_threads(args.threads)?;
    let progress = Terminal::new(args.quiet);
    let (map, notes) = read_map(&args.map, args.conventions.conventions().map)?;
    notes.iter().for_each(|note| progress.note(note));
    let options = MapFit { upper_hemisphere: args.upper_hemisphere, white: args.white, ..MapFit::default() };
    print("lobes  mean squared error  relative rms  power kept r g b         seconds\n")?;
    for &count in &args.lobes {
        let started = Instant::now();
        let report = fit_one(&map, count, &options, &progress)?;
        let secs = started.elapsed().as_secs_f64();
        if count == args.lobes[0] {
            sun_notes(&report.suns).iter().for_each(|note| progress.note(note));
        }
        let [r, g, b] = report.power_ratio;
        let relative = (report.mse / report.mean_square).sqrt();
        print(&format!(
            "{count:>5}  {:>18.5}  {:>10.2} %  {r:.4} {g:.4} {b:.4}  {secs:>10.1}\n",
            report.mse,
            100.0 * relative
        ))?;
        if let Some(out) = &args.out {
            write_fit(out, &target_of(&map, &options), &report, args.conventions)?;
        }
    }
    Ok(())
}

/// What can be told before minutes are spent.
fn refuse_before_work(args: &FitArgs) -> Result<()> {
    let Some(out) = &args.out else { return Ok(()) };
    if args.lobes.len() > 1 {
        let problem = "--out takes the lobes of one fit, but --lobes asks for several";
        return Err(Error::usage(problem, "Give one number of lobes, or leave --out away for the table."));
    }
    let extension = out.extension().unwrap_or_default().to_ascii_lowercase();
    if extension != "ron" && extension != "npy" {
        let problem = format!("{}: lobes are written as .ron or .npy", out.display());
        return Err(Error::usage(problem, "Name the output accordingly."));
    }
    Ok(())
}

fn fit_one(
    map: &EnvironmentMap,
    count: u16,
    options: &MapFit,
    progress: &dyn Progress,
) -> Result<MapFitReport> {
    let bar = progress.bar(&format!("{count} lobes"), 100);
    let report = fit_map_with(map, usize::from(count), options, &mut |told| {
        bar.set_position((100.0 * told.done) as u64);
        bar.set_message(format!("error {:.5}", told.mse));
    });
    bar.finish_and_clear();
    report
}

fn write_fit(out: &Path, map: &EnvironmentMap, report: &MapFitReport, as_said: ConventionArgs) -> Result<()> {
    let lobes: Vec<LightLobe> = report.lobes.clone();
    LightFile::Lobes(lobes).write(out, as_said.conventions())?;
    let shown = out.with_extension("png");
    write_rgb8(&shown, &before_and_after(map, report))?;
    print(&format!("Written: {} and {}\n", out.display(), shown.display()))
}

fn render(args: &RenderArgs) -> Result<()> {
    let light = read(&args.light, args.conventions)?;
    let (width, height) = args.size;
    let map = light.to_map(width, height);
    let conventions = args.conventions.conventions();
    if args.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        let factor = preview_factor(&map);
        return write_rgb8(&args.out, &picture(&conventions.map.from_lobelia(map), factor));
    }
    LightFile::Map(map).write(&args.out, conventions)
}

fn rotate(args: &RotateArgs) -> Result<()> {
    let turn = match (args.euler, args.quaternion) {
        (Some(degrees), _) => {
            let [x, y, z] = degrees.map(f32::to_radians);
            Quat::from_euler(EulerRot::XYZEx, x, y, z)
        }
        (None, Some(parts)) => {
            let given = Quat::from_array(parts);
            if given.length() < 1e-6 {
                return Err(Error::usage(
                    "the quaternion is zero, which turns nothing",
                    "The identity is 0,0,0,1.",
                ));
            }
            given.normalize()
        }
        (None, None) => Quat::IDENTITY,
    };
    let light = read(&args.light, args.conventions)?;
    light.rotated(turn).write(&args.out, args.conventions.conventions())
}

#[cfg(test)]
mod tests {
    use super::*;

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
