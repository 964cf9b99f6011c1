//! `lobelia run` as one of several processes that `mpirun` has started.

use super::error_message::{exit_code, report};
use super::run::{carry_out, run_and_report};
use super::run_args::RunArgs;
use lobelia::pass::progress::Silent;
use lobelia::pass::{Profiling, RunOptions};
use lobelia::ranks::mpi::Mpi;
use lobelia::ranks::{Ranks, is_started};
use lobelia::{Error, Result};
use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::time::Duration;
use tempfile::TempDir;

/// How long another process than the first waits with its error: the first one mostly has the same.
const AFTER_FIRST: Duration = Duration::from_secs(5);
/// Time between two checkpoints of another process than the first, whose are for nothing.
const NEVER: Duration = Duration::from_secs(1 << 30);

/// Runs the command, with the other processes if there are some.
pub fn run(args: &RunArgs) -> Result<()> {
    if is_started() { run_as(args, &Mpi::start()?) } else { super::run::run(args) }
}

/// The first process writes the output folder and says how far it is; the others are silent, and write into a folder that goes.
fn run_as(args: &RunArgs, mpi: &Mpi) -> Result<()> {
    let ranks = mpi.ranks();
    let mut own = None;
    let mut adapt = |options: &mut RunOptions| {
        let least = ranks.numbers(options.memory.unwrap_or(u64::MAX))?.into_iter().min();
        let most = ranks.numbers(mpi.processes_here())?.into_iter().max();
        if args.memory.is_none() {
            options.memory = least.filter(|bytes| *bytes < u64::MAX);
            options.memory_shared_by = most.unwrap_or(1) as usize;
        }
        if ranks.rank() > 0 {
            own = Some(step_aside(options)?);
        }
        options.ranks = Some(Ranks::clone(ranks));
        // The first one changes the output folder only once the others have read it.
        ranks.meet()
    };
    let ended = match ranks.rank() {
        0 => run_and_report(args, &mut adapt),
        _ => carry_out(args, &Silent, &mut adapt),
    };
    drop(own);
    match ended {
        Err(Error::Interrupted) if ranks.have_stopped() && ranks.rank() > 0 => Ok(()),
        Err(error) if !(ranks.have_stopped() && matches!(error, Error::Interrupted)) => end_all(mpi, &error),
        ended => ended,
    }
}

/// Gives another process than the first a folder of its own, with what a run goes on from.
fn step_aside(options: &mut RunOptions) -> Result<TempDir> {
    let folder = tempfile::Builder::new().prefix(".lobelia-rank-").tempdir();
    let folder = folder.map_err(Error::io("create", std::env::temp_dir()))?;
    let out = folder.path().join("out");
    if options.resume {
        copy(&options.out, &out)?;
    }
    options.checkpoint = options.resume.then_some(NEVER);
    options.profile = Profiling::Off;
    options.out = out;
    Ok(folder)
}

/// Copies a folder and the files in it; links are left out.
fn copy(from: &Path, to: &Path) -> Result<()> {
    if !from.is_dir() {
        return Ok(());
    }
    fs::create_dir_all(to).map_err(Error::io("create", to))?;
    for entry in fs::read_dir(from).map_err(Error::io("read", from))? {
        let entry = entry.map_err(Error::io("read", from))?;
        let (path, kind) = (entry.path(), entry.file_type().map_err(Error::io("read", from))?);
        if kind.is_dir() {
            copy(&path, &to.join(entry.file_name()))?;
        } else if kind.is_file() {
            fs::copy(&path, to.join(entry.file_name())).map_err(Error::io("copy", &path))?;
        }
    }
    Ok(())
}

/// Reports an error that the other processes do not know of, and ends them.
fn end_all(mpi: &Mpi, error: &Error) -> ! {
    if mpi.ranks().rank() > 0 {
        std::thread::sleep(AFTER_FIRST);
    }
    let _ = std::io::stderr().write_all(report(error).as_bytes());
    mpi.abort(exit_code(error))
}
