//! `lobelia bench`: how long one point × light lobe takes, forward and with its adjoint, on this
//! machine.
//!
//! A [`Workload`] is shaded. A kernel is run again and again for its share of the time; the least
//! time counts, because other work of the machine can only make a run longer.

use super::terminal::print;
use clap::Args;
use lobelia::codec::file::{check_writable, write_bytes};
use lobelia::sg::shading::{
    ChunkSums, ClosedForm, Cpu, Layers, Lighting, PairLoops, PointAdjoint, RadianceAdjoint, RadianceColumns,
    ShadeCall, ShadePoint,
};
use lobelia::shade::device::ShadingDevice;
use lobelia::{Error, Result};
use lobelia::{sg::accurate::Quality, sg::brdf::Ndf, sg::lanes::level_name, sg::workload::Workload};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const EXAMPLES: &str = include_str!("help/bench.txt").trim_ascii_end();

/// Measures how long shading takes per point and light lobe on this machine, in about a minute.
///
/// Needs no data: points look in all directions, lobes lie evenly around them with sharpness 20 to
/// some 300. Two kernels are timed: `forward` computes radiance, as rendering does;
/// `forward+adjoint` is what a step of a fit adds, radiance again and the gradient with respect to
/// light, material, albedo and normal. A number is the time of a whole batch over points × lobes,
/// with all threads together: the least of many repetitions, since other programs can only make a
/// repetition longer. Multiply by the pixels of a batch and by the lobes to know what a step costs.
///
/// `simd` is the instruction set the kernels chose; `skipped` is the part of the pairs that a mode
/// leaves out.
#[derive(Args, Debug)]
#[command(
    about = "Measure how long shading takes per point and light lobe on this machine, in about a minute",
    verbatim_doc_comment, after_long_help = EXAMPLES
)]
pub struct BenchArgs {
    /// Points in a batch, 1 to 16777216
    #[arg(long, value_name = "N", default_value_t = 16_384, value_parser = clap::value_parser!(u32).range(1..=1 << 24))]
    points: u32,
    /// Numbers of light lobes, 1 to 4096 each
    #[arg(long, value_name = "M,…", value_delimiter = ',', default_values_t = [8, 32, 128, 512],
        value_parser = clap::value_parser!(u32).range(1..=4096))]
    lobes: Vec<u32>,
    /// How many threads [default: first one, then one per processor]
    #[arg(long, value_name = "T", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Time for all measurements together, in seconds
    #[arg(long, value_name = "S", default_value_t = 50.0, value_parser = seconds)]
    seconds: f64,
    /// Measure a graphics adapter as well, the first or that whose name has this in it; a program
    /// built with the feature `gpu` can
    #[arg(long, value_name = "NAME", num_args = 0..=1, default_missing_value = "gpu")]
    gpu: Option<String>,
    /// Write the rows to this file too
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.0..=86_400.0).contains(&seconds) => Ok(seconds),
        _ => Err("expected a number of seconds from 0 to 86400".to_owned()),
    }
}

/// A mode: its name, its closed form, the NDF of its material.
type Mode = (&'static str, ClosedForm, Ndf);

/// Shading modes that are measured, each with its name on a graphics adapter. A further mode is one
/// more line.
const MODES: [(Mode, &str); 4] = [
    (("published", ClosedForm::Published, Ndf::Sg), "published-gpu"),
    (("accurate", ClosedForm::Accurate(Quality::Default), Ndf::Sg), "accurate-gpu"),
    (("accurate-high", ClosedForm::Accurate(Quality::High), Ndf::Sg), "high-gpu"),
    (("accurate-ggx", ClosedForm::Accurate(Quality::Default), Ndf::Ggx), "ggx-gpu"),
];

/// Roughness of the specular lobe: glossy, between, rough.
const ROUGHNESS: [f32; 3] = [0.1, 0.3, 0.7];

/// One line of the table.
#[derive(Debug, Serialize)]
struct BenchRow {
    mode: &'static str,
    /// In a batch.
    points: usize,
    lobes: usize,
    threads: usize,
    roughness: f32,
    /// Radiance: nanoseconds per point × lobe, least of all repetitions.
    forward_ns: f64,
    /// The gradient's kernel, which computes the radiance again and the adjoint of everything:
    /// likewise.
    forward_adjoint_ns: f64,
    /// How often each kernel was run.
    repetitions: [usize; 2],
    /// Of its inputs, outputs and adjoints.
    bytes_per_point: usize,
    /// Instruction set that the kernels chose, or `gpu`.
    simd: &'static str,
}

/// Runs the command.
pub fn run(args: &BenchArgs) -> Result<()> {
    let mut head = format!(
        "Nanoseconds per point × lobe, the least of all repetitions in {} s.\nmode          points  lobes  roughness  threads  forward ns  forward+adjoint ns  bytes/point  simd\n",
        args.seconds
    );
    bench(args, |row| print(&format!("{}{}\n", std::mem::take(&mut head), row.line()))).map(drop)
}

/// Measures every combination; `on_row` is told of each row as soon as it is there.
fn bench(args: &BenchArgs, mut on_row: impl FnMut(&BenchRow) -> Result<()>) -> Result<Vec<BenchRow>> {
    args.json.as_deref().map_or(Ok(()), check_file)?;
    let gpu = args.gpu.as_deref().map(ShadingDevice::open).transpose()?;
    let threads = match (args.threads, std::thread::available_parallelism().map_or(1, usize::from)) {
        (Some(threads), _) => vec![usize::from(threads)],
        (None, 1) => vec![1],
        (None, all) => vec![1, all],
    };
    // Device, instruction set, threads, and what is measured.
    let mut parts: Vec<(&dyn PairLoops, &str, usize, Mode)> = Vec::new();
    for threads in threads {
        parts.extend(MODES.map(|(mode, _)| (&Cpu as _, level_name(), threads, mode)));
    }
    if let Some(ShadingDevice(gpu)) = &gpu {
        let on_gpu = MODES.into_iter().filter(|((_, form, ndf), _)| gpu.supports(*form, *ndf));
        parts.extend(on_gpu.map(|((_, form, ndf), name)| (&**gpu, "gpu", 1, (name, form, ndf))));
    }
    let count = parts.len() * args.lobes.len() * ROUGHNESS.len();
    let budget = Duration::from_secs_f64(args.seconds / (2 * count) as f64);
    let mut rows = Vec::with_capacity(count);
    for (device, simd, threads, (mode, form, ndf)) in parts {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let pool = pool.map_err(|error| Error::run("starting threads", error.to_string()))?;
        for lobes in args.lobes.iter().map(|lobes| *lobes as usize) {
            for roughness in ROUGHNESS {
                let points = args.points as usize;
                let mut work = Workload::new(points, lobes, roughness);
                work.specular.ndf = ndf;
                let timed = pool.install(|| time_kernels(device, form, &mut work, budget))?;
                let [forward_ns, forward_adjoint_ns] =
                    timed.map(|(least, _)| least.as_secs_f64() * 1e9 / (points * lobes) as f64);
                rows.push(BenchRow {
                    mode,
                    points,
                    lobes,
                    threads,
                    roughness,
                    forward_ns,
                    forward_adjoint_ns,
                    repetitions: timed.map(|(_, repetitions)| repetitions),
                    bytes_per_point: size_of::<(ShadePoint, Layers, RadianceAdjoint, PointAdjoint)>(),
                    simd,
                });
                on_row(&rows[rows.len() - 1])?;
            }
        }
    }
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&rows);
        let text = text.map_err(|error| Error::run("writing the measurements", error.to_string()))? + "\n";
        write_bytes(path, text.as_bytes())?;
    }
    Ok(rows)
}

impl BenchRow {
    /// As a line of the table.
    fn line(&self) -> String {
        format!(
            "{:<13} {:>6}  {:>5}  {:>9}  {:>7}  {:>10.3}  {:>18.3}  {:>11}  {}",
            self.mode,
            self.points,
            self.lobes,
            self.roughness,
            self.threads,
            self.forward_ns,
            self.forward_adjoint_ns,
            self.bytes_per_point,
            self.simd
        )
    }
}

/// Refuses a file that could not be written after a minute of measuring.
fn check_file(path: &Path) -> Result<()> {
    if path.is_dir() || path.file_name().is_none() {
        let problem = format!("{} is not a file name to write to", path.display());
        return Err(Error::usage(problem, "Name a .json file with --json."));
    }
    check_writable(path.parent().unwrap_or(Path::new("")))
}

/// Least time of the forward and of the adjoint kernel for the whole batch, and how often each was
/// run.
fn time_kernels(
    loops: &dyn PairLoops,
    form: ClosedForm,
    work: &mut Workload,
    budget: Duration,
) -> Result<[(Duration, usize); 2]> {
    let Workload { points, specular, lobes, .. } = &*work;
    let (points, lobes, specular) = (points.clone(), lobes.clone(), *specular);
    let call = ShadeCall { form, points: &points, specular: &specular, lighting: Lighting::from(&lobes) };
    let mut sums = ChunkSums::default();
    let forward = least_time(budget, || loops.shade(call, &mut work.shaded))?;
    let adjoint = least_time(budget, || {
        let radiance = RadianceColumns { shaded: &work.shaded, adjoint: &work.adjoint };
        loops.shade_adjoint(call, radiance, &mut work.point_adjoint, &mut sums)?;
        sums.total_into(&mut work.gradient);
        Ok(())
    })?;
    Ok([forward, adjoint])
}

/// Runs `kernel` until `budget` is spent, and once more than once at least: the first run finds
/// cold caches.
fn least_time(budget: Duration, mut kernel: impl FnMut() -> Result<(), String>) -> Result<(Duration, usize)> {
    let started = Instant::now();
    let (mut least, mut repetitions) = (Duration::MAX, 0);
    while repetitions < 2 || started.elapsed() < budget {
        let before = Instant::now();
        kernel().map_err(|problem| Error::run("shading", problem))?;
        least = least.min(before.elapsed());
        repetitions += 1;
    }
    Ok((least, repetitions))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quick(json: Option<PathBuf>) -> BenchArgs {
        BenchArgs { points: 300, lobes: vec![3, 20], threads: Some(2), seconds: 0.0, gpu: None, json }
    }

    #[test]
    fn every_combination_is_measured_and_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/bench.json");
        let mut told = 0;
        let rows = bench(&quick(Some(path.clone())), |row| {
            told += 1;
            assert!(row.line().contains(row.mode), "{}", row.line());
            Ok(())
        })
        .unwrap();
        assert_eq!((rows.len(), told), (MODES.len() * 2 * ROUGHNESS.len(), rows.len()));
        let read: Vec<serde_json::Map<String, serde_json::Value>> =
            serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(read.len(), rows.len());
        for row in &read {
            for key in ["mode", "points", "lobes", "threads", "roughness", "forward_ns", "forward_adjoint_ns"]
            {
                assert!(row.contains_key(key), "{key}");
            }
            assert!(row["forward_ns"].as_f64().is_some_and(|ns| ns.is_finite() && ns > 0.0));
        }
    }

    #[test]
    fn a_file_that_cannot_be_is_refused_before_measuring() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, b"x").unwrap();
        for bad in [folder.path().to_owned(), file.join("below.json")] {
            let error = bench(&quick(Some(bad)), |_| panic!("measured")).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{error}");
        }
    }

    #[test]
    fn bench_refuses_senseless_numbers() {
        use clap::Parser;
        let refused = |arguments: &[&str]| {
            crate::Cli::try_parse_from([&["lobelia", "bench"], arguments].concat()).is_err()
        };
        assert!(!refused(&["--lobes", "8,32", "--points", "1", "--threads", "2", "--seconds", "0.5"]));
        for bad in ["--lobes=0", "--lobes=8,x", "--points=0", "--threads=0", "--seconds=-1", "--seconds=nan"]
        {
            assert!(refused(&[bad]), "{bad}");
        }
    }
}
