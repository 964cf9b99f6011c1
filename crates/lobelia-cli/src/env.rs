//! `lobelia env`: environment lights from the command line.

use super::start::{Choices, ThreadArgs, choices, refuse_inputs, start_threads};
use super::terminal::{Terminal, print};
use clap::{Args, Subcommand};
use glam::{DVec3, EulerRot, Quat, Vec3};
use image::{Rgb, RgbImage, imageops};
use lobelia::codec::file::{check_writable, is_there};
use lobelia::codec::png_file::{software_of, write_rgb8, write_rgb8_by};
use lobelia::codec::tone::{Tone, srgb8};
use lobelia::light::convention::MapConvention as Map;
use lobelia::light::map_fit::{MapFit, MapFitProgress, MapFitReport, fit_map_with, target_of};
use lobelia::light::{EnvironmentMap, LightLobe, lobes_power, lobes_radiance, render_lobes};
use lobelia::report::sheet::{draw_text, line_height};
use lobelia::sg::color::luminance;
use lobelia::shade::frame::check_memory;
use lobelia::spawn::light::{LightConventions, LightFile, check_lit, files_of, read_light, read_map};
use lobelia::{
    Error, Result, codec::npy::NpyConvention as Npy, error::stop::is_stopping, progress::Progress,
};
use std::{f64::consts::PI, fmt::Write as _, path::Path, path::PathBuf, time::Instant};

/// The end of the help.
pub const EXAMPLES: &str = include_str!("help/env.txt").trim_ascii_end();

/// Command for a light.
#[derive(Debug, Subcommand)]
pub enum EnvCommand {
    #[command(after_long_help = EXAMPLES)]
    Fit(FitArgs),
    Render(RenderArgs),
    Rotate(RotateArgs),
    Info(InfoArgs),
}

/// How files are to be understood.
#[derive(Args, Clone, Copy, Debug)]
pub struct ConventionArgs {
    /// Which program's way EXR and HDR maps face, read or written
    #[arg(long, value_name = "PROGRAM", default_value = "lobelia", value_parser = choices(MAPS))]
    convention: Map,
    /// Which way the axes of .npy lobes point, read or written
    #[arg(long, value_name = "WAY", default_value = "lobelia", value_parser = choices(NPYS))]
    npy_convention: Npy,
}

const MAPS: Choices<Map> = &[
    ("lobelia", Map::Lobelia, "+Y up, middle +Z, a quarter in +X"),
    ("mitsuba", Map::Mitsuba, "Mitsuba 3: the same"),
    ("three-js", Map::ThreeJs, "three.js and glTF viewers built on it: +Y up, middle +X, a quarter in −Z"),
    ("blender", Map::Blender, "Blender's own world: +Z up, middle +X, a quarter in +Y"),
    ("blender-y-up", Map::BlenderYUp, "Blender's world for an object exported with +Y up: as three-js"),
];
const NPYS: Choices<Npy> = &[
    ("lobelia", Npy::Lobelia, "World directions"),
    ("physg-fit", Npy::PhySgFit, "PhySG's published envmap*_sg_fit files: (x, y, z) stands for (z, y, −x)"),
];

impl From<ConventionArgs> for LightConventions {
    fn from(ConventionArgs { convention: map, npy_convention: npy }: ConventionArgs) -> Self {
        Self { npy, map }
    }
}

/// Fit spherical Gaussians to a map
#[derive(Args, Debug)]
pub struct FitArgs {
    /// An OpenEXR or Radiance HDR latitude-longitude map
    map: PathBuf,
    /// How many lobes, 1 to 512; several numbers, as 16,32,64, print a table and write nothing
    #[arg(long, value_name = "N[,N…]", value_delimiter = ',', default_value = "128",
        value_parser = clap::value_parser!(u16).range(1..=512))]
    lobes: Vec<u16>,
    /// Write the lobes here (.ron or .npy), and beside it a .png of the map and what the lobes make
    /// of it, unless another picture is there
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Light from above only: the map below the horizon counts as black, no lobe's axis points
    /// below it
    #[arg(long)]
    upper_hemisphere: bool,
    /// Gray light: fit the map's luminance
    #[arg(long)]
    white: bool,
    #[command(flatten)]
    conventions: ConventionArgs,
    #[command(flatten)]
    threads: ThreadArgs,
    /// No progress bar and no notes
    #[arg(short, long)]
    quiet: bool,
}

/// Draw a light as a latitude-longitude map
#[derive(Args, Debug)]
pub struct RenderArgs {
    /// A .ron light, .npy lobes, or a map
    light: PathBuf,
    /// The file to write: .exr (radiance) or .png (a picture, exposed to a mid-gray mean)
    out: PathBuf,
    /// Width and height of the map in texels
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "512x256")]
    size: (u32, u32),
    #[command(flatten)]
    conventions: ConventionArgs,
}

/// Turn a light
#[derive(Args, Debug)]
pub struct RotateArgs {
    /// A .ron light, .npy lobes, or a map
    light: PathBuf,
    /// Turn about the world's x, then y, then z axis, in degrees
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, allow_hyphen_values = true,
        required_unless_present = "quaternion", conflicts_with = "quaternion")]
    euler: Option<[f32; 3]>,
    /// Turn by a quaternion, which is normalized
    #[arg(long, value_name = "X,Y,Z,W", value_parser = numbers::<4>, allow_hyphen_values = true)]
    quaternion: Option<[f32; 4]>,
    /// The file to write: .ron or .npy for lobes, .exr for a map
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    conventions: ConventionArgs,
}

/// Say what is in a light: mean, power, peak, lobes
#[derive(Args, Debug)]
pub struct InfoArgs {
    /// A .ron light, .npy lobes, or a map
    light: PathBuf,
    /// List every lobe, not only the 16 of the greatest power
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    conventions: ConventionArgs,
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let side = |side: &str| side.trim().parse::<u32>().ok().filter(|n| (1..=16_384).contains(n));
    let sides = text.split_once(['x', '×']).and_then(|(width, height)| side(width).zip(side(height)));
    sides.ok_or_else(|| "expected WIDTHxHEIGHT, each 1 to 16384, e.g. 512x256".to_owned())
}

fn numbers<const N: usize>(text: &str) -> Result<[f32; N], String> {
    let values: Option<Vec<f32>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    let finite = values.filter(|values| values.iter().all(|v| v.is_finite()));
    let example = ["1"; N].join(",");
    let wrong = || format!("expected {N} numbers with commas between them, e.g. {example}");
    finite.and_then(|values| values.try_into().ok()).ok_or_else(wrong)
}

/// Bytes of a rendered map's texel: radiance by rows, joined, and encoded.
const MAP_TEXEL_BYTES: u64 = 3 * 12;

/// Mark of origin in pictures of fits, by which a later fit knows that it may replace them.
const PICTURE_BY: &str = "lobelia env fit";

/// Lines of the lobe table unless all are asked for.
const TABLE_LINES: usize = 16;

/// Mid-gray, which the geometric mean luminance of a previewed map is brought to.
const KEY: f32 = 0.18;
/// Size of the text in pictures, pixels per font dot.
const TEXT_SIZE: f32 = 2.0;
/// Widest picture of a fit, in pixels; two stand one above the other.
const WIDEST_PICTURE: u32 = 1024;

/// Runs `lobelia env`.
pub fn run(command: &EnvCommand) -> Result<()> {
    match command {
        EnvCommand::Fit(args) => fit(args),
        EnvCommand::Render(args) => render(args),
        EnvCommand::Rotate(args) => rotate(args),
        EnvCommand::Info(args) => print(&info(&read(&args.light, args.conventions)?, args.all)),
    }
}

fn read(path: &Path, said: ConventionArgs) -> Result<LightFile> {
    let (light, notes) = read_light(path, said.into())?;
    notes.iter().for_each(|note| Terminal { quiet: false }.note(note));
    Ok(light)
}

fn fit(args: &FitArgs) -> Result<()> {
    refuse_before_work(args)?;
    start_threads(args.threads)?;
    let progress = Terminal { quiet: args.quiet };
    let (map, notes) = read_map(&args.map, args.conventions.convention)?;
    notes.iter().for_each(|note| progress.note(note));
    let options = MapFit { upper_hemisphere: args.upper_hemisphere, white: args.white, ..MapFit::default() };
    let target = target_of(&map, &options);
    check_lit(&args.map, &target)?;
    print("lobes  mean squared error  relative rms  power kept r g b         seconds\n")?;
    for &count in &args.lobes {
        let started = Instant::now();
        let bar = progress.bar(&format!("{count} lobes"), 100);
        let mut tell = |told: MapFitProgress| {
            bar.set_position((100.0 * told.done) as u64);
            bar.set_message(format!("error {:.5}", told.mse));
        };
        let report = fit_map_with(&map, usize::from(count), &options, &mut tell, &is_stopping)?;
        drop(bar);
        let secs = started.elapsed().as_secs_f64();
        // One line for each sun that was fitted apart, with what its lobe does to the peak.
        for sun in report.suns.iter().filter(|_| count == args.lobes[0]) {
            progress.note(&format!(
                "sun at {}: peak {:.3e} over {:.1e} sr, {:.1} % of the power; its lobe has sharpness {:.0} and peak {:.3e}",
                direction(sun.lobe.axis),
                sun.peak.max_element(),
                sun.solid_angle,
                100.0 * sun.power_share,
                sun.lobe.sharpness,
                sun.lobe.amplitude.max_element()
            ));
        }
        let [r, g, b] = report.power_ratio;
        let (mse, relative) = (report.mse, 100.0 * (report.mse / report.mean_square).sqrt());
        print(&format!("{count:>5}  {mse:>18.5}  {relative:>10.2} %  {r:.4} {g:.4} {b:.4}  {secs:>10.1}\n"))?;
        if let Some(out) = &args.out {
            LightFile::Lobes(report.lobes.clone()).write(out, args.conventions.into())?;
            let shown = out.with_extension("png");
            write_rgb8_by(&shown, &before_and_after(&target, &report), PICTURE_BY)?;
            print(&format!("Written: {} and {}\n", out.display(), shown.display()))?;
        }
    }
    Ok(())
}

/// Refuses unusable outputs before minutes are spent.
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
        let help = "A picture goes beside --out: choose another name, or move that file.";
        return Err(Error::usage(problem, help));
    }
    check_writable(out.parent().unwrap_or(Path::new("")))
}

fn render(args: &RenderArgs) -> Result<()> {
    refuse_inputs(&files_of(&args.light), &[(&args.out, "the picture")])?;
    let (width, height) = args.size;
    check_memory("a map", width, height, u64::from(width) * u64::from(height) * MAP_TEXEL_BYTES)?;
    let light = read(&args.light, args.conventions)?;
    let map = light.to_map(width, height);
    if args.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        let factor = preview_factor(&map);
        return write_rgb8(&args.out, &picture(&args.conventions.convention.from_lobelia(map), factor));
    }
    LightFile::Map(map).write(&args.out, args.conventions.into())
}

fn rotate(args: &RotateArgs) -> Result<()> {
    refuse_inputs(&files_of(&args.light), &[(&args.out, "--out")])?;
    let [x, y, z] = args.euler.unwrap_or_default().map(f32::to_radians);
    let given = args.quaternion.map_or_else(|| Quat::from_euler(EulerRot::XYZEx, x, y, z), Quat::from_array);
    if given.length() < 1e-6 {
        let problem = "the quaternion is zero, which turns nothing";
        return Err(Error::usage(problem, "The identity is 0,0,0,1."));
    }
    let turn = if args.quaternion.is_some() { given.normalize() } else { given };
    let light = read(&args.light, args.conventions)?;
    light.rotated(turn).write(&args.out, args.conventions.into())
}

// What is in a light, in words.

/// Describes a light: mean, power, peak, and a table of its lobes by power (all of them, or the
/// first 16).
fn info(light: &LightFile, all: bool) -> String {
    let (mut text, power) = match light {
        LightFile::Lobes(lobes) => {
            let lit = lobes.iter().filter(|l| l.amplitude.max_element() > 0.0).count();
            (format!("{} lobes, {lit} of them not black\n", lobes.len()), lobes_power(lobes))
        }
        LightFile::Map(map) => (format!("map of {} × {} texels\n", map.width, map.height), map.power()),
    };
    let (peak, toward) = peak(light);
    let mut above = light.to_map(512, 256);
    let half = above.radiance.len() / 2;
    above.radiance[half..].fill(Vec3::ZERO);
    let upper = luminous(above.power());
    // Writing to a `String` cannot fail.
    let _ = writeln!(text, "  mean radiance   {}", rgb(power / (4.0 * PI)));
    let _ = writeln!(text, "  power           {} (integral over the sphere, radiance × sr)", rgb(power));
    let from_above = match luminous(power) {
        whole if whole > 0.0 => format!("{:.1} % of the luminous power", 100.0 * upper / whole),
        _ => "nothing: it gives no light".to_owned(),
    };
    let _ = writeln!(text, "  from above      {from_above}");
    let _ = writeln!(text, "  peak            {} at {}", rgb(peak.as_dvec3()), direction(toward));
    if let LightFile::Lobes(lobes) = light {
        table(&mut text, lobes, if all { lobes.len() } else { TABLE_LINES });
    }
    text
}

fn luminous(power: DVec3) -> f64 {
    f64::from(luminance(power.as_vec3()))
}

/// The brightest radiance and its direction; of lobes at the axis of one, for the peak of their sum
/// is there or close by.
fn peak(light: &LightFile) -> (Vec3, Vec3) {
    let brighter = |a: (Vec3, Vec3), b: (Vec3, Vec3)| if luminance(b.0) > luminance(a.0) { b } else { a };
    let brightest = match light {
        LightFile::Lobes(lobes) => {
            lobes.iter().map(|lobe| (lobes_radiance(lobes, lobe.axis), lobe.axis)).reduce(brighter)
        }
        LightFile::Map(map) => {
            let at = |k: u32| map.texel_direction(k % map.width, k / map.width);
            (0..).zip(&map.radiance).map(|(k, &radiance)| (radiance, at(k))).reduce(brighter)
        }
    };
    brightest.unwrap_or((Vec3::ZERO, Vec3::Y))
}

fn table(text: &mut String, lobes: &[LightLobe], lines: usize) {
    let total = luminous(lobes_power(lobes));
    let share = |l: &LightLobe| if total > 0.0 { 100.0 * luminous(l.power()) / total } else { 0.0 };
    let mut order: Vec<(usize, f64)> = lobes.iter().map(share).enumerate().collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1));
    let _ = writeln!(
        text,
        "  {:>4}  {:>6}  {:^24}  {:>9}  {:>10}  {:^29}",
        "lobe", "power", "axis x y z", "sharpness", "half-width", "amplitude r g b"
    );
    for (k, share) in order.iter().take(lines) {
        let lobe = &lobes[*k];
        let _ = writeln!(
            text,
            "  {k:>4}  {share:>5.1}%  {}  {:>9.2}  {:>9.1}°  {}",
            direction(lobe.axis),
            lobe.sharpness,
            half_width_degrees(lobe.sharpness),
            rgb(lobe.amplitude.as_dvec3())
        );
    }
    if order.len() > lines {
        let _ = writeln!(text, "  … and {} more (--all)", order.len() - lines);
    }
}

/// Angle from the axis at which an SG has half its peak, in degrees: cos = 1 − ln 2/λ; 180 where it
/// nowhere falls so low.
fn half_width_degrees(sharpness: f32) -> f32 {
    (1.0 - std::f32::consts::LN_2 / sharpness).max(-1.0).acos().to_degrees()
}

fn direction(d: Vec3) -> String {
    format!("({:>6.3}, {:>6.3}, {:>6.3})", d.x, d.y, d.z)
}

fn rgb(v: DVec3) -> String {
    format!("{:>9.4} {:>9.4} {:>9.4}", v.x, v.y, v.z)
}

// Pictures of maps.

/// Factor on a map's radiance for a preview: brings the solid-angle-weighted geometric mean
/// luminance to mid-gray (Reinhard et al. 2002, eq. 1).
fn preview_factor(map: &EnvironmentMap) -> f32 {
    let mean = luminous(map.power()) / (4.0 * PI);
    if mean <= 0.0 {
        return 1.0;
    }
    let row = |(j, row): (usize, &[Vec3])| -> f64 {
        let logs: f64 = row.iter().map(|&r| (f64::from(luminance(r)) + 1e-3 * mean).ln()).sum();
        logs * map.texel_solid_angle(j as u32)
    };
    let logs: f64 = map.radiance.chunks_exact(map.width as usize).enumerate().map(row).sum();
    KEY / (logs / (4.0 * PI)).exp() as f32
}

/// A map as an 8-bit picture, its radiance multiplied by `factor`.
fn picture(map: &EnvironmentMap, factor: f32) -> RgbImage {
    RgbImage::from_fn(map.width, map.height, |x, y| {
        let radiance = map.radiance[(y * map.width + x) as usize];
        Rgb(srgb8(Tone::Neutral.curve(radiance * factor)))
    })
}

/// The map above, what the lobes make of it below, each with a line of text.
fn before_and_after(map: &EnvironmentMap, report: &MapFitReport) -> RgbImage {
    let factor = preview_factor(map);
    let narrow = map.downsampled(map.width.min(WIDEST_PICTURE), map.height.min(WIDEST_PICTURE / 2));
    let after = render_lobes(&report.lobes, narrow.width, narrow.height);
    let mut both = RgbImage::new(narrow.width, 2 * narrow.height);
    imageops::replace(&mut both, &picture(&narrow, factor), 0, 0);
    imageops::replace(&mut both, &picture(&after, factor), 0, i64::from(narrow.height));
    let line = line_height(TEXT_SIZE) + 6;
    let text = format!("{} lobes, mean squared error {:.3e}", report.used, report.mse);
    for (bottom, text) in [(narrow.height, "map"), (2 * narrow.height, text.as_str())] {
        draw_text(&mut both, [8, bottom.saturating_sub(line)], TEXT_SIZE, [255; 3], text);
    }
    both
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia::light::map_fit::fit_map;

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

    fn lobes() -> Vec<LightLobe> {
        let lobe = |axis, sharpness, gray| LightLobe { axis, sharpness, amplitude: Vec3::splat(gray) };
        vec![lobe(Vec3::Y, 1.0, 0.5), lobe(Vec3::X, 40.0, 9.0), lobe(Vec3::Z, 3.0, 0.0)]
    }

    #[test]
    fn info_says_what_is_there() {
        let text = info(&LightFile::Lobes(lobes()), false);
        assert!(text.contains("3 lobes, 2 of them not black"), "{text}");
        assert!(text.lines().any(|l| l.contains("peak") && l.contains("( 1.000,  0.000,  0.000)")), "{text}");
        let map = info(&LightFile::Map(render_lobes(&lobes(), 64, 32)), false);
        assert!(map.contains("64 × 32") && !map.contains("axis x y z"), "{map}");
        let black = info(&LightFile::Lobes(vec![lobes()[2]]), false);
        assert!(black.contains("it gives no light") && !black.contains("NaN"), "{black}");
        assert_eq!(half_width_degrees(0.0), 180.0);
        let cos = half_width_degrees(40.0).to_radians().cos();
        assert!(((40.0 * (cos - 1.0)).exp() - 0.5).abs() < 1e-4);
    }

    #[test]
    fn the_picture_of_a_fit_shows_both() {
        let map = render_lobes(&lobes(), 64, 32);
        let options = MapFit { working_width: 64, polish_width: 64, ..MapFit::default() };
        let report = fit_map(&map, 3, &options).unwrap();
        let both = before_and_after(&map, &report);
        assert_eq!(both.dimensions(), (64, 64));
        let differs = |x: u32, y: u32| {
            let (a, b) = (both.get_pixel(x, y), both.get_pixel(x, y + 32));
            (0..3).map(|c| a[c].abs_diff(b[c])).max().unwrap_or(0)
        };
        assert!((0..64).all(|x| differs(x, 4) < 24));
        let black = map.scaled(Vec3::ZERO);
        assert_eq!(preview_factor(&black), 1.0);
        assert_eq!(picture(&black, 1.0).get_pixel(0, 0).0, [0; 3]);
    }
}
