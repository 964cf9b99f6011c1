//! Signals that end a process: the first one lets the work in progress end cleanly, a second one ends the process at once.

use lobelia::error::stop::{StopSignal, ask_to_stop};
use lobelia::{Error, Result};
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether a signal has come. What else asks a run to stop, such as the button of a page, leaves the first signal what it is.
static HEARD: AtomicBool = AtomicBool::new(false);

/// Listens for Ctrl-C, SIGTERM and SIGHUP from now on, but for those that the process was told to ignore: `nohup` does so with SIGHUP.
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
    std::thread::Builder::new().name("signals".into()).spawn(listen).map(|_| ()).map_err(refused)
}

/// Whether the process was started with a signal ignored. Only Linux says it without a system call that Rust has no safe name for.
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
    let refused = |error: ctrlc::Error| refused(std::io::Error::other(error));
    ctrlc::set_handler(|| stop(StopSignal::Interrupt)).map_err(refused)
}

fn stop(signal: StopSignal) {
    ask_to_stop(signal);
    if HEARD.swap(true, Ordering::Relaxed) {
        std::process::exit(i32::from(signal.exit_code()));
    }
}

fn refused(error: std::io::Error) -> Error {
    Error::run("listening for signals", error.to_string())
}
