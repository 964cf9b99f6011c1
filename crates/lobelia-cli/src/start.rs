//! Preparations of commands: the scene, the number of threads, signals, and files that must not be
//! written over.

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use lobelia::codec::file::{FileUse, check_apart, is_there, read_bytes};
use lobelia::{Error, Result, error::stop::StopSignal, error::stop::ask_to_stop, scene::LoadOptions};
use std::path::{Path, PathBuf};

const SET_LONG: &str = include_str!("help/set.txt").trim_ascii_end();

/// Which scene, and what the command line adds to it.
#[derive(Args, Debug)]
pub struct SceneArgs {
    /// The scene file
    #[arg(value_name = "SCENE.ron")]
    pub scene: PathBuf,
    /// The folder that $DATA stands for in the scene file
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Seed of every random choice, instead of the scene's own
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Replace a value of the scene file, e.g. --set passes.fit.steps=4
    #[arg(long = "set", value_name = "PATH=VALUE", value_parser = path_and_value, long_help = SET_LONG)]
    pub sets: Vec<(String, String)>,
}

fn path_and_value(text: &str) -> Result<(String, String), String> {
    let parts = text.split_once('=').map(|(path, value)| (path.trim().to_owned(), value.trim().to_owned()));
    let whole = parts.filter(|(path, value)| !path.is_empty() && !value.is_empty());
    whole.ok_or_else(|| "expected PATH=VALUE, e.g. passes.fit.steps=4".to_owned())
}

/// Returns the additions of the command line to a scene file, as the library reads them.
pub fn load_options(args: &SceneArgs) -> LoadOptions {
    LoadOptions { data: args.data.clone(), sets: args.sets.clone(), seed: args.seed, without_data: false }
}

/// Values of an option: each with its name and its help.
pub type Choices<T> = &'static [(&'static str, T, &'static str)];

/// Reads one of the choices by its name.
pub fn choices<T: Copy + Send + Sync + 'static>(all: Choices<T>) -> impl TypedValueParser<Value = T> {
    let shown = all.iter().map(|(name, _, help)| PossibleValue::new(*name).help(*help));
    PossibleValuesParser::new(shown).try_map(move |name| {
        all.iter().find(|choice| choice.0 == name).map(|choice| choice.1).ok_or("no such choice")
    })
}

/// How many threads work.
#[derive(Args, Clone, Copy, Debug)]
pub struct ThreadArgs {
    /// Worker threads, 1 to 1024 [default: one per processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// Starts as many worker threads as asked for; without a number, one per processor, or what
/// `RAYON_NUM_THREADS` says.
pub fn start_threads(args: ThreadArgs) -> Result<()> {
    let threads = rayon::ThreadPoolBuilder::new().num_threads(args.threads.map_or(0, usize::from));
    threads.build_global().map_err(|error| {
        let problem = format!("worker threads cannot be started: {error}");
        Error::usage(problem, "Raise the limit of processes (ulimit -u), or ask for fewer threads: --threads, or RAYON_NUM_THREADS.")
    })
}

/// Listens for Ctrl-C, SIGTERM and SIGHUP from now on, but for those that the process was told to
/// ignore, as `nohup` does with SIGHUP. The first one lets the work in progress end cleanly, a
/// second one ends the process at once.
#[cfg(unix)]
pub fn stop_on_signals() -> Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::iterator::Signals;
    let heard = [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|signal| !is_ignored(*signal));
    let mut signals = Signals::new(heard).map_err(refused)?;
    let listen = move || {
        for signal in signals.forever() {
            stop(match signal {
                SIGINT => StopSignal::Interrupt,
                SIGTERM => StopSignal::Terminate,
                _ => StopSignal::HangUp,
            });
        }
    };
    std::thread::Builder::new().name("signals".into()).spawn(listen).map(drop).map_err(refused)
}

/// Tells whether the process was started with a signal ignored. Only Linux says it without a system
/// call that Rust has no safe name for.
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask =
        status.lines().find_map(|line| u64::from_str_radix(line.strip_prefix("SigIgn:")?.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// Listens for Ctrl-C from now on.
#[cfg(not(unix))]
pub fn stop_on_signals() -> Result<()> {
    use std::sync::atomic::{AtomicBool, Ordering};
    let asked = std::sync::Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(signal_hook::consts::SIGINT, asked.clone()).map_err(refused)?;
    let listen = move || loop {
        if asked.swap(false, Ordering::Relaxed) {
            stop(StopSignal::Interrupt);
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    };
    std::thread::Builder::new().name("signals".into()).spawn(listen).map(|_| ()).map_err(refused)
}

fn stop(signal: StopSignal) {
    if !ask_to_stop(signal) {
        std::process::exit(i32::from(signal.exit_code()));
    }
}

fn refused(error: std::io::Error) -> Error {
    Error::run("listening for signals", error.to_string())
}

/// Refuses to write what is read: `inputs` are paths that are read, `outputs` are paths with what
/// writes them.
pub fn refuse_inputs(inputs: &[PathBuf], outputs: &[(&Path, &str)]) -> Result<()> {
    let inputs: Vec<FileUse> = inputs.iter().map(|path| FileUse::new(path, "which is read")).collect();
    let outputs: Vec<FileUse> = outputs.iter().map(|(path, by)| FileUse::new(*path, *by)).collect();
    check_apart(&inputs, &outputs, "Give what is written another name.")
}

/// Refuses to replace a page that this program did not write: one without its signature.
pub fn refuse_foreign(page: &Path, signature: &str) -> Result<()> {
    let signed = |bytes: &[u8]| bytes.windows(signature.len()).any(|window| window == signature.as_bytes());
    let is_signed = || read_bytes(page, |_| String::new()).is_ok_and(|bytes| signed(&bytes));
    // Of a folder in its place the writer tells.
    if !is_there(page) || page.is_dir() || is_signed() {
        return Ok(());
    }
    let problem = format!("{} is not a page that this command wrote", page.display());
    Err(Error::usage(problem, "Move it away; it is not replaced."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_takes_the_first_equals_sign() {
        assert_eq!(path_and_value("a.b = x=1"), Ok(("a.b".into(), "x=1".into())));
        assert!(["a.b", "=1", "a="].iter().all(|bad| path_and_value(bad).is_err()));
    }
}
