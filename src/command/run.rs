//! `lobelia run`: the passes of a scene file, in their order.

use super::json_log::JsonLog;
use super::live::Live;
use super::run_args::{LogForm, RunArgs};
use super::scene_files::load_options;
use super::signals::stop_on_signals;
use super::terminal::Terminal;
use super::threads::start_threads;
use lobelia::jobs;
use lobelia::pass::memory::usual_budget;
use lobelia::pass::progress::Progress;
use lobelia::pass::{self, RunOptions};
use lobelia::ranks::is_one_of_several;
use lobelia::scene::{LoadedScene, load};
use lobelia::shade::device::ShadingDevice;
use lobelia::{Error, Result};
use std::path::{Path, PathBuf};

/// What changes the options of a run that was started in an unusual way.
pub type Adapt<'a> = dyn FnMut(&mut RunOptions) -> Result<()> + 'a;

/// Runs the command.
pub fn run(args: &RunArgs) -> Result<()> {
    if !cfg!(feature = "mpi") && args.only.is_none() && is_one_of_several() {
        let problem = "this program is built without MPI, and mpirun has started several of it: each would do the whole run";
        let help = "Build it with `--features mpi`, or start it without mpirun.";
        return Err(Error::usage(problem, help));
    }
    run_and_report(args, &mut |_| Ok(()))
}

/// Runs the scene, and reports as the arguments say.
pub fn run_and_report(args: &RunArgs, adapt: &mut Adapt) -> Result<()> {
    match args.log {
        LogForm::Text => carry_out(args, &Terminal::new(args.quiet), adapt),
        LogForm::Json => {
            let log = JsonLog::new();
            let ended = carry_out(args, &log, adapt);
            log.end(&ended);
            ended
        }
    }
}

/// Runs the scene, and reports to `shown`.
pub fn carry_out(args: &RunArgs, shown: &dyn Progress, adapt: &mut Adapt) -> Result<()> {
    let mut out = args.out.clone().unwrap_or_else(|| default_out(&args.scene.scene));
    let loaded = match &args.only {
        None => load(&args.scene.scene, &load_options(&args.scene))?,
        Some(name) => {
            out.push(name);
            load_unit(args, name)?
        }
    };
    let begun = out.join("run.json").exists();
    start_threads(args.threads)?;
    let memory = args.memory.or_else(usual_budget);
    let arguments = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    let mut options = RunOptions {
        out,
        force: args.force,
        debug_every: args.debug_every,
        memory,
        memory_shared_by: 1,
        arguments,
        checkpoint: args.checkpoint.0,
        // A unit that was begun goes on.
        resume: args.resume || (args.only.is_some() && !args.force && begun),
        begin_again: args.only.is_some(),
        device: device(&args.device)?,
        profile: args.profile(),
        ranks: None,
    };
    adapt(&mut options)?;
    stop_on_signals()?;
    let is_first = options.ranks.as_ref().is_none_or(|ranks| ranks.rank() == 0);
    let Some(port) = args.live.filter(|_| is_first) else { return pass::run(&loaded, &options, shown) };
    let live = Live::start(port, &options.out, shown)?;
    let ended = pass::run(&loaded, &options, &live);
    live.end(&ended);
    ended
}

/// What shades, where it is not this processor.
fn device(name: &str) -> Result<Option<ShadingDevice>> {
    if name == "cpu" { Ok(None) } else { ShadingDevice::open(name).map(Some) }
}

/// The scene of a unit, with what the command line adds, and its passes alone.
fn load_unit(args: &RunArgs, name: &str) -> Result<LoadedScene> {
    let unit = jobs::find(&args.scene.scene, args.scene.data.as_deref(), name)?;
    let mut options = load_options(&args.scene);
    // The command line goes before a table, and behind the frames that a unit of a film has.
    let at = if unit.pass.is_some() { options.sets.len() } else { 0 };
    options.sets.splice(at..at, unit.sets);
    options.data = unit.data;
    let mut loaded = load(&unit.scene, &options)?;
    if let Some(only) = unit.pass {
        loaded.scene.passes.retain(|pass| pass.name() == only);
    }
    Ok(loaded)
}

fn default_out(scene: &Path) -> PathBuf {
    Path::new("out").join(scene.file_stem().unwrap_or_default())
}
