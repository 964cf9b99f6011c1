//! `lobelia env`: environment lights from the command line.

mod info;
mod preview;

use super::args::{ConventionArgs, EnvCommand, FitArgs, MapName, NpyName, RenderArgs, RotateArgs};
use super::output_checks::refuse_inputs;
use super::terminal::{Terminal, print};
use super::threads::start_threads;
use glam::{EulerRot, Quat};
use info::{info, sun_notes};
use lobelia::codec::file::{check_writable, is_there};
use lobelia::codec::npy::NpyConvention;
use lobelia::codec::png_file::{software_of, write_rgb8, write_rgb8_by};
use lobelia::light::convention::MapConvention;
use lobelia::light::map_fit::{MapFit, MapFitReport, fit_map_with, target_of};
use lobelia::light::{EnvironmentMap, LightLobe};
use lobelia::pass::progress::Progress;
use lobelia::shade::frame::check_memory;
use lobelia::spawn::light_file::{LightConventions, LightFile, check_lit, files_of, read_light, read_map};
use lobelia::{Error, Result};
use preview::{before_and_after, picture, preview_factor};
use std::path::Path;
use std::time::Instant;

/// Bytes of a rendered map's texel: radiance by rows, joined, and encoded.
const MAP_TEXEL_BYTES: u64 = 3 * 12;

/// What pictures of fits say of their origin, by which a later fit knows that it may replace them.
const PICTURE_BY: &str = "lobelia env fit";

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

/// How files are to be understood, as the library names it.
fn conventions(args: ConventionArgs) -> LightConventions {
    let map = match args.convention {
        MapName::Lobelia => MapConvention::Lobelia,
        MapName::Mitsuba => MapConvention::Mitsuba,
        MapName::ThreeJs => MapConvention::ThreeJs,
        MapName::Blender => MapConvention::Blender,
        MapName::BlenderYUp => MapConvention::BlenderYUp,
    };
    let npy = match args.npy_convention {
        NpyName::Lobelia => NpyConvention::Lobelia,
        NpyName::PhysgFit => NpyConvention::PhySgFit,
    };
    LightConventions { npy, map }
}

fn read(path: &Path, said: ConventionArgs) -> Result<LightFile> {
    let (light, notes) = read_light(path, conventions(said))?;
    notes.iter().for_each(|note| Terminal::new(false).note(note));
    Ok(light)
}

fn fit(args: &FitArgs) -> Result<()> {
    refuse_before_work(args)?;
    start_threads(args.threads)?;
    let progress = Terminal::new(args.quiet);
    let (map, notes) = read_map(&args.map, conventions(args.conventions).map)?;
    notes.iter().for_each(|note| progress.note(note));
    let options = MapFit { upper_hemisphere: args.upper_hemisphere, white: args.white, ..MapFit::default() };
    check_lit(&args.map, &target_of(&map, &options))?;
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
    let shown = out.with_extension("png");
    refuse_inputs(&files_of(&args.map), &[(out, "--out"), (&shown, "the picture beside --out")])?;
    if is_there(&shown) && software_of(&shown).as_deref() != Some(PICTURE_BY) {
        let problem = format!("{} exists, and is no picture that `env fit` made", shown.display());
        return Err(Error::usage(
            problem,
            "A picture goes beside --out: choose another name, or move that file.",
        ));
    }
    check_writable(out.parent().unwrap_or(Path::new("")))
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
    LightFile::Lobes(lobes).write(out, conventions(as_said))?;
    let shown = out.with_extension("png");
    write_rgb8_by(&shown, &before_and_after(map, report), PICTURE_BY)?;
    print(&format!("Written: {} and {}\n", out.display(), shown.display()))
}

fn render(args: &RenderArgs) -> Result<()> {
    refuse_inputs(&files_of(&args.light), &[(&args.out, "the picture")])?;
    let (width, height) = args.size;
    check_memory("a map", width, height, u64::from(width) * u64::from(height) * MAP_TEXEL_BYTES)?;
    let light = read(&args.light, args.conventions)?;
    let map = light.to_map(width, height);
    let ways = conventions(args.conventions);
    if args.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        let factor = preview_factor(&map);
        return write_rgb8(&args.out, &picture(&ways.map.from_lobelia(map), factor));
    }
    LightFile::Map(map).write(&args.out, ways)
}

fn rotate(args: &RotateArgs) -> Result<()> {
    refuse_inputs(&files_of(&args.light), &[(&args.out, "--out")])?;
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
    light.rotated(turn).write(&args.out, conventions(args.conventions))
}
