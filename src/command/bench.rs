//! `lobelia bench`: how long one point × light lobe takes, forward and with its adjoint, on this machine.
//!
//! What is shaded is a [`Workload`]. A kernel is run again and again for its share of the time; the
//! least time counts, because whatever else the machine does can only make a run longer.

use super::args::BenchArgs;
use super::terminal::print;
use lobelia::codec::file::write_bytes;
use lobelia::math::accurate::Quality;
use lobelia::math::brdf::Ndf;
use lobelia::math::lanes::level_name;
use lobelia::math::shading::{
    ChunkSums, ClosedForm, Cpu, Layers, Lighting, PairLoops, PointAdjoint, RadianceAdjoint, RadianceColumns,
    ShadeCall, ShadePoint,
};
use lobelia::math::workload::Workload;
use lobelia::shade::device::ShadingDevice;
use lobelia::{Error, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A mode: its name, its closed form, the NDF of its material.
type Mode = (&'static str, ClosedForm, Ndf);

/// Shading modes that are measured, with the NDF of their material. A further mode is one more line.
const MODES: [Mode; 4] = [
    ("published", ClosedForm::Published, Ndf::Sg),
    ("accurate", ClosedForm::Accurate(Quality::Default), Ndf::Sg),
    ("accurate-high", ClosedForm::Accurate(Quality::High), Ndf::Sg),
    ("accurate-ggx", ClosedForm::Accurate(Quality::Default), Ndf::Ggx),
];

/// Roughness of the specular lobe: glossy, between, rough.
const ROUGHNESS: [f32; 3] = [0.1, 0.3, 0.7];

/// What to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchOptions {
    /// Points in a batch, at least 1.
    pub points: usize,
    /// Numbers of light lobes, each at least 1.
    pub lobes: Vec<usize>,
    /// Numbers of threads, each at least 1.
    pub threads: Vec<usize>,
    /// Time for all measurements together, in seconds.
    pub seconds: f64,
    /// A graphics adapter that is measured as well.
    pub gpu: Option<ShadingDevice>,
    /// Where to write the rows as JSON.
    pub json: Option<PathBuf>,
}

/// One line of the table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchRow {
    /// Shading mode.
    pub mode: &'static str,
    /// Points in a batch.
    pub points: usize,
    /// Light lobes.
    pub lobes: usize,
    /// Threads.
    pub threads: usize,
    /// Roughness R of the specular lobe.
    pub roughness: f32,
    /// Radiance: nanoseconds per point × lobe, least of all repetitions.
    pub forward_ns: f64,
    /// The gradient's kernel, which computes the radiance again and the adjoint of everything: likewise.
    pub forward_adjoint_ns: f64,
    /// How often each kernel was run.
    pub repetitions: [usize; 2],
    /// Bytes that a point's inputs, outputs and adjoints take.
    pub bytes_per_point: usize,
    /// Part of the pairs whose specular light the mode leaves out, in percent.
    pub skipped_percent: f64,
    /// Instruction set that the kernels chose, or `gpu`.
    pub simd: &'static str,
}

/// Runs the command.
pub fn run(args: &BenchArgs) -> Result<()> {
    let all = std::thread::available_parallelism().map_or(1, usize::from);
    let options = BenchOptions {
        points: args.points as usize,
        lobes: args.lobes.iter().map(|&lobes| lobes as usize).collect(),
        threads: match args.threads {
            Some(threads) => vec![usize::from(threads)],
            None if all > 1 => vec![1, all],
            None => vec![1],
        },
        seconds: args.seconds,
        gpu: args.gpu.as_deref().map(ShadingDevice::open).transpose()?,
        json: args.json.clone(),
    };
    let mut head = format!(
        "Nanoseconds per point × lobe, the least of all repetitions in {} s.\n{}\n",
        options.seconds,
        BenchRow::HEADER
    );
    let mut show = |row: &BenchRow| print(&format!("{}{}\n", std::mem::take(&mut head), row.line()));
    bench(&options, &mut show).map(|_| ())
}

/// What a mode's kernels took.
struct Timing {
    /// Least time of the forward and of the adjoint kernel, for the whole batch.
    least: [Duration; 2],
    repetitions: [usize; 2],
    skipped_percent: f64,
}

/// Measures every combination; `on_row` is told of each row as soon as it is there.
///
/// # Errors
/// [`Error::Usage`] if the JSON file cannot be one (before anything is measured); [`Error::Run`] if threads cannot be
/// started; [`Error::Io`]; whatever `on_row` returns.
pub fn bench(
    options: &BenchOptions,
    mut on_row: impl FnMut(&BenchRow) -> Result<()> + Send,
) -> Result<Vec<BenchRow>> {
    options.json.as_deref().map_or(Ok(()), check_file)?;
    let on_gpu = on_gpu(options);
    let count = (MODES.len() * options.threads.len() + on_gpu.len()) * options.lobes.len() * ROUGHNESS.len();
    let budget = Duration::from_secs_f64(options.seconds / (2 * count) as f64);
    let mut rows = Vec::with_capacity(count);
    for &threads in &options.threads {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .map_err(|error| Error::run("starting threads", error.to_string()))?;
        for mode in MODES {
            let mut on_row = |timing: Timing, work: &Workload| {
                rows.push(BenchRow::new(mode.0, threads, work, &timing, level_name()));
                on_row(&rows[rows.len() - 1])
            };
            pool.install(|| measure(&Cpu, mode, options, budget, &mut on_row))?;
        }
    }
    for (name, mode) in on_gpu {
        let Some(ShadingDevice(loops)) = &options.gpu else { continue };
        measure(&**loops, mode, options, budget, &mut |timing, work| {
            rows.push(BenchRow::new(name, 1, work, &timing, "gpu"));
            on_row(&rows[rows.len() - 1])
        })?;
    }
    if let Some(path) = &options.json {
        write_json(path, &rows)?;
    }
    Ok(rows)
}

/// The modes that the graphics adapter has, with their names there.
fn on_gpu(options: &BenchOptions) -> Vec<(&'static str, Mode)> {
    let names = ["published-gpu", "accurate-gpu", "high-gpu", "ggx-gpu"];
    let has = |(_, (_, form, ndf)): &(&str, Mode)| {
        options.gpu.as_ref().is_some_and(|device| device.0.supports(*form, *ndf))
    };
    names.into_iter().zip(MODES).filter(has).collect()
}

/// Measures a mode with all numbers of lobes and roughnesses.
fn measure(
    loops: &dyn PairLoops,
    (_, form, ndf): Mode,
    options: &BenchOptions,
    budget: Duration,
    on_row: &mut (dyn FnMut(Timing, &Workload) -> Result<()> + Send),
) -> Result<()> {
    for &lobes in &options.lobes {
        for roughness in ROUGHNESS {
            let mut work = Workload::new(options.points, lobes, roughness);
            work.specular.ndf = ndf;
            let timing = time_kernels(loops, form, &mut work, budget)?;
            on_row(timing, &work)?;
        }
    }
    Ok(())
}

impl BenchRow {
    /// The head of the table that [`Self::line`] fills.
    pub const HEADER: &'static str = "\
mode          points  lobes  roughness  threads  forward ns  forward+adjoint ns  bytes/point  skipped  simd";

    fn new(mode: &'static str, threads: usize, work: &Workload, timing: &Timing, simd: &'static str) -> Self {
        let (points, lobes) = (work.points.len(), work.lobes.len());
        let ns = |time: Duration| time.as_secs_f64() * 1e9 / (points * lobes) as f64;
        Self {
            mode,
            points,
            lobes,
            threads,
            roughness: work.specular.roughness,
            forward_ns: ns(timing.least[0]),
            forward_adjoint_ns: ns(timing.least[1]),
            repetitions: timing.repetitions,
            bytes_per_point: bytes_per_point(),
            skipped_percent: timing.skipped_percent,
            simd,
        }
    }

    /// As a line of the table.
    pub fn line(&self) -> String {
        format!(
            "{:<13} {:>6}  {:>5}  {:>9}  {:>7}  {:>10.3}  {:>18.3}  {:>11}  {:>6.1}%  {}",
            self.mode,
            self.points,
            self.lobes,
            self.roughness,
            self.threads,
            self.forward_ns,
            self.forward_adjoint_ns,
            self.bytes_per_point,
            self.skipped_percent,
            self.simd
        )
    }
}

fn bytes_per_point() -> usize {
    size_of::<ShadePoint>() + size_of::<Layers>() + size_of::<RadianceAdjoint>() + size_of::<PointAdjoint>()
}

/// Refuses a file that could not be written after a minute of measuring.
fn check_file(path: &Path) -> Result<()> {
    let problem = if path.is_dir() || path.file_name().is_none() {
        format!("{} is not a file name to write to", path.display())
    } else if let Some(file) = path.ancestors().skip(1).find(|folder| folder.is_file()) {
        format!("{} cannot be written: {} is a file, not a folder", path.display(), file.display())
    } else {
        return Ok(());
    };
    Err(Error::usage(problem, "Name a .json file with --json."))
}

fn write_json(path: &Path, rows: &[BenchRow]) -> Result<()> {
    let mut text = serde_json::to_string_pretty(rows)
        .map_err(|error| Error::run("writing the measurements", error.to_string()))?;
    text.push('\n');
    write_bytes(path, text.as_bytes())
}

fn time_kernels(
    loops: &dyn PairLoops,
    form: ClosedForm,
    work: &mut Workload,
    budget: Duration,
) -> Result<Timing> {
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
    Ok(Timing {
        least: [forward.0, adjoint.0],
        repetitions: [forward.1, adjoint.1],
        skipped_percent: 100.0 * form.culled_part(&points, &specular, &lobes),
    })
}

/// Runs `kernel` until `budget` is spent, and once more than once at least: the first run finds cold caches.
fn least_time(
    budget: Duration,
    mut kernel: impl FnMut() -> std::result::Result<(), String>,
) -> Result<(Duration, usize)> {
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

    fn quick(json: Option<PathBuf>) -> BenchOptions {
        BenchOptions { points: 300, lobes: vec![3, 20], threads: vec![1, 2], seconds: 0.0, gpu: None, json }
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
        assert!(rows.iter().all(|row| (0.0..=100.0).contains(&row.skipped_percent)));
        assert_eq!((rows.len(), told), (MODES.len() * 2 * 2 * ROUGHNESS.len(), rows.len()));
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
}
