//! Signals that end a process: the first one lets the work in progress end cleanly, a second one ends the process at once.

use lobelia::error::stop::{StopSignal, ask_to_stop};
use lobelia::{Error, Result};

/// Listens for Ctrl-C, SIGTERM and SIGHUP from now on.
#[cfg(unix)]
pub fn stop_on_signals() -> Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::iterator::Signals;
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP]).map_err(refused)?;
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

/// Listens for Ctrl-C from now on.
#[cfg(not(unix))]
pub fn stop_on_signals() -> Result<()> {
    let refused = |error: ctrlc::Error| refused(std::io::Error::other(error));
    ctrlc::set_handler(|| stop(StopSignal::Interrupt)).map_err(refused)
}

fn stop(signal: StopSignal) {
    if !ask_to_stop(signal) {
        std::process::exit(i32::from(signal.exit_code()));
    }
}

fn refused(error: std::io::Error) -> Error {
    Error::run("listening for signals", error.to_string())
}
