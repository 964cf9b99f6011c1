//! The `lobelia` command: arguments in, one report of an error out, and the exit code.

mod cli;

use clap::Parser;
use cli::{CheckArgs, Cli, Command, EvalArgs, RunArgs, ShadeCasesArgs, ThreadArgs};
use lobelia::scene::pass_types::Pass;
use lobelia::scene::types::{Scene, Surface, Views};
use lobelia::scene::{LoadOptions, LoadedScene, RunOptions, load, unknown_parts};
use lobelia::{Error, Result};
use std::fmt::Write as _;
use std::io::{ErrorKind, IsTerminal, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

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
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = std::io::stderr().write_all(report(&error).as_bytes());
            ExitCode::from(error.exit_code())
        }
    }
}

/// An error as a person reads it.
fn report(error: &Error) -> String {
    let mut text = String::new();
    if let Error::Scene(diagnostic) = error {
        let plain = !std::io::stderr().is_terminal() || std::env::var_os("NO_COLOR").is_some();
        let theme =
            if plain { miette::GraphicalTheme::unicode_nocolor() } else { miette::GraphicalTheme::unicode() };
        let handler = miette::GraphicalReportHandler::new_themed(theme).with_width(100).with_links(false);
        if handler.render_report(&mut text, diagnostic.as_ref()).is_ok() {
            return text;
        }
        text.clear();
    }
    text = format!("error: {error}\n");
    if let Some(help) = error.help() {
        text += &format!("help: {help}\n");
    }
    text
}

/// Writes to stdout; a reader that has gone away (`lobelia check … | head -1`) is no failure.
fn print(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Error::io("write", "standard output")(error))
        }
        _ => Ok(()),
    }
}

fn start_threads(args: ThreadArgs) -> Result<()> {
    let Some(threads) = args.threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(usize::from(threads))
        .build_global()
        .map_err(|error| Error::run("starting threads", error.to_string()))
}

fn run(args: &RunArgs) -> Result<()> {
    let loaded = load(&args.scene.scene, &args.scene.load_options())?;
    let out = args.out.clone().unwrap_or_else(|| default_out(&args.scene.scene));
    refuse_used(&out, args.force)?;
    start_threads(args.threads)?;
    let options = RunOptions { out, force: args.force, quiet: args.quiet };
    run_passes(&loaded, &options)
}

fn run_passes(loaded: &LoadedScene, _options: &RunOptions) -> Result<()> {
    Err(Error::run(loaded.path.display().to_string(), "passes cannot be run yet"))
}

fn default_out(scene: &Path) -> PathBuf {
    Path::new("out").join(scene.file_stem().unwrap_or_default())
}

/// An output folder with something in it is kept, unless `--force`.
fn refuse_used(out: &Path, force: bool) -> Result<()> {
    let used = match std::fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_some() && !force,
        Err(error) if error.kind() == ErrorKind::NotFound => false,
        Err(error) if error.kind() == ErrorKind::NotADirectory => {
            let problem = format!("the output folder {} is a file", out.display());
            return Err(Error::usage(problem, "Choose another folder with --out."));
        }
        Err(error) => return Err(Error::io("read", out)(error)),
    };
    if used {
        let problem = format!("the output folder {} is not empty", out.display());
        return Err(Error::usage(problem, "Choose another with --out, or write into it with --force."));
    }
    Ok(())
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
        Surface::Mesh { path, texture_size } => format!("{}, texture {texture_size}²", path.display()),
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
        Pass::Render(_) => "Render",
        Pass::Edit(_) => "Edit",
        Pass::Relight(_) => "Relight",
        Pass::Evaluate(_) => "Evaluate",
        Pass::Save(_) => "Save",
        Pass::Export(_) => "Export",
    }
}

fn eval(args: &EvalArgs) -> Result<()> {
    Err(Error::run(args.prediction.display().to_string(), "images cannot be compared yet"))
}

fn shade_cases(args: &ShadeCasesArgs) -> Result<()> {
    start_threads(args.threads)?;
    Err(Error::run(
        args.cases.display().to_string(),
        format!("cases cannot be shaded yet ({:?}, {:?})", args.mode, args.precision),
    ))
}
