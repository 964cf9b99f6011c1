//! The `lobelia` command: arguments in, one report of an error out, and the exit code.

mod cli;
mod env_command;
mod terminal;

use clap::Parser;
use cli::{
    BenchArgs, CaseMode, CasePrecision, CheckArgs, Cli, Command, EvalArgs, RunArgs, ShadeCasesArgs,
    ThreadArgs,
};
use lobelia::math::shading::ClosedForm;
use lobelia::pass;
use lobelia::pass::bench::{BenchOptions, BenchRow};
use lobelia::pass::shade_cases::{Precision, ShadeMode};
use lobelia::report::compare::compare;
use lobelia::report::scores::Scaling;
use lobelia::scene::description::{Scene, Surface, Views};
use lobelia::scene::passes::Pass;
use lobelia::scene::{LoadOptions, LoadedScene, RunOptions, load, unknown_parts};
use lobelia::{Error, Result};
use std::fmt::Write as _;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use terminal::Terminal;

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        // Help and version go to stdout and are no error. A closed pipe is not worth a word.
        Err(error) => {
            let _ = error.print();
            return if error.use_stderr() { ExitCode::from(2) } else { ExitCode::SUCCESS };
        }
    };
    let done = match cli.command {
        Command::Run(args) => run(&args),
        Command::Check(args) => check(&args),
        Command::Eval(args) => eval(&args),
        Command::ShadeCases(args) => shade_cases(&args),
        Command::Bench(args) => bench(&args),
        Command::Env(args) => env_command::run(&args.command),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = std::io::stderr().write_all(terminal::report(&error).as_bytes());
            ExitCode::from(error.exit_code())
        }
    }
}

/// Writes to stdout; a reader that has gone away (`lobelia check … | head -1`) is no failure.
pub(crate) fn print(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Error::io("write", "standard output")(error))
        }
        _ => Ok(()),
    }
}

pub(crate) fn start_threads(args: ThreadArgs) -> Result<()> {
    let Some(threads) = args.threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(usize::from(threads))
        .build_global()
        .map_err(|error| Error::run("starting threads", error.to_string()))
}

/// The first Ctrl-C lets the pass in progress end cleanly; a second one ends the process at once.
fn stop_on_ctrl_c() -> Result<()> {
    ctrlc::set_handler(|| {
        if pass::INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    })
    .map_err(|error| Error::run("listening for Ctrl-C", error.to_string()))
}

fn run(args: &RunArgs) -> Result<()> {
    let loaded = load(&args.scene.scene, &args.scene.load_options())?;
    let out = args.out.clone().unwrap_or_else(|| default_out(&args.scene.scene));
    start_threads(args.threads)?;
    let options = RunOptions { out, force: args.force, debug_every: args.debug_every };
    stop_on_ctrl_c()?;
    pass::run(&loaded, &options, &Terminal::new(args.quiet))
}

fn default_out(scene: &Path) -> PathBuf {
    Path::new("out").join(scene.file_stem().unwrap_or_default())
}

fn check(args: &CheckArgs) -> Result<()> {
    let options = LoadOptions { without_data: true, ..args.scene.load_options() };
    print(&summary(&load(&args.scene.scene, &options)?))
}

/// What `check` prints.
fn summary(loaded: &LoadedScene) -> String {
    let scene = &loaded.scene;
    let unknown = unknown_parts(scene);
    let unknown = if unknown.is_empty() { "nothing".to_owned() } else { unknown.join(", ") };
    let passes: Vec<String> =
        scene.passes.iter().map(|pass| format!("{} ({})", pass.name(), kind(pass))).collect();
    let mut text = format!("{}: fine\n", loaded.path.display());
    let mut line = |label: &str, value: &str| writeln!(text, "  {label:<8} {value}");
    // Writing to a `String` cannot fail.
    let _ = line("surface", &surface(scene));
    let _ = line("views", &views(scene));
    let _ = line("unknown", &unknown);
    let _ = line("passes", &format!("{}: {}", passes.len(), passes.join(", ")));
    let _ = line("files", &files(loaded));
    for file in loaded.files.iter().chain(&loaded.unseen) {
        let _ = line("", &file.display().to_string());
    }
    text
}

fn files(loaded: &LoadedScene) -> String {
    let found = loaded.files.len();
    match loaded.unseen.len() {
        0 => format!("{found} named, all found"),
        unseen => format!("{found} found, {unseen} below $DATA not looked for (say --data DIR to look)"),
    }
}

fn surface(scene: &Scene) -> String {
    match &scene.surface {
        Surface::Mesh { path, texture_size, .. } => format!("{}, texture {texture_size}²", path.display()),
        Surface::Unknown { cells, texture_size } => {
            format!("unknown, on a grid of {cells}³, texture {texture_size}²")
        }
        Surface::Sphere { radius, texture_size, .. } => {
            format!("sphere of radius {radius}, texture {texture_size}²")
        }
        Surface::Box { size, texture_size, .. } => format!("box {size}, texture {texture_size}²"),
    }
}

fn views(scene: &Scene) -> String {
    match &scene.views {
        Views::Dataset(dataset) => format!("photographs in {}", dataset.path.display()),
        Views::Cameras(cameras) => format!("{} cameras without photographs", cameras.len()),
        Views::Photographed(made) => {
            format!("{} to fit and {} to test, photographed here", made.cameras.count, made.cameras.test)
        }
    }
}

fn kind(pass: &Pass) -> &'static str {
    match pass {
        Pass::Fit(_) => "Fit",
        Pass::Shape(_) => "Shape",
        Pass::Render(_) => "Render",
        Pass::Edit(_) => "Edit",
        Pass::Relight(_) => "Relight",
        Pass::Evaluate(_) => "Evaluate",
        Pass::Save(_) => "Save",
        Pass::Export(_) => "Export",
    }
}

fn eval(args: &EvalArgs) -> Result<()> {
    let scaling = if args.scale { Scaling::PerChannel } else { Scaling::None };
    let comparison = compare(&args.prediction, &args.truth, scaling)?;
    print(&comparison.table())
}

fn shade_cases(args: &ShadeCasesArgs) -> Result<()> {
    start_threads(args.threads)?;
    let mode = match args.mode {
        CaseMode::Published => ShadeMode::ClosedForm(ClosedForm::Published),
        CaseMode::Accurate => ShadeMode::ClosedForm(ClosedForm::Accurate(args.quality.into())),
        CaseMode::PathTraced => ShadeMode::PathTraced { samples: args.samples },
    };
    let precision = match args.precision {
        CasePrecision::F32 => Precision::F32,
        CasePrecision::F64 => Precision::F64,
    };
    let report = pass::shade_cases::shade_cases(&args.cases, &args.out, mode, precision)?;
    print(&format!(
        "{} cases in {:.2} s; {} of {} values agree with those of the table\n",
        report.cases, report.elapsed_secs, report.agreement.within, report.agreement.values
    ))
}

fn bench(args: &BenchArgs) -> Result<()> {
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
        json: args.json.clone(),
    };
    let mut head = format!(
        "Nanoseconds per point × lobe, the least of all repetitions in {} s.\n{}\n",
        options.seconds,
        BenchRow::HEADER
    );
    let mut show = |row: &BenchRow| print(&format!("{}{}\n", std::mem::take(&mut head), row.line()));
    pass::bench::bench(&options, &mut show).map(|_| ())
}
