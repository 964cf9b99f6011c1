//! How a run is stopped from outside, and how its work finds out: one flag that every long loop
//! asks.
//!
//! The flag is of the process, as a signal is: it stops the work of all pipelines and threads, and
//! is never reset. A program that runs several and wants to stop one of them returns
//! `ControlFlow::Break` from that fit's `watch` instead.

use crate::{Error, Result};
use std::fmt;
use std::sync::atomic::{AtomicU8, Ordering};

/// Source of a request to stop a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum StopSignal {
    /// Ctrl-C.
    Interrupt = 1,
    /// SIGTERM.
    Terminate = 2,
    /// SIGHUP: the terminal was closed.
    HangUp = 3,
}

impl StopSignal {
    const ALL: [Self; 3] = [Self::Interrupt, Self::Terminate, Self::HangUp];

    /// The exit code of a process that it stops: 128 plus the number of the signal.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Interrupt => 130,
            Self::Terminate => 143,
            Self::HangUp => 129,
        }
    }
}

impl fmt::Display for StopSignal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Interrupt => "Ctrl-C",
            Self::Terminate => "SIGTERM",
            Self::HangUp => "SIGHUP",
        })
    }
}

/// The signal, and [`FINISHING`].
static STOP: AtomicU8 = AtomicU8::new(0);
/// Set once the work has ended and only its results are written.
const FINISHING: u8 = 0x80;

/// Asks all work in progress in this process to stop; returns whether it is the first to ask.
pub fn ask_to_stop(signal: StopSignal) -> bool {
    STOP.compare_exchange(0, signal as u8, Ordering::Relaxed, Ordering::Relaxed).is_ok()
}

/// Returns the source of the request to stop, if there was one.
pub fn stopped_by() -> Option<StopSignal> {
    let signal = STOP.load(Ordering::Relaxed) & !FINISHING;
    StopSignal::ALL.into_iter().find(|known| *known as u8 == signal)
}

/// Whether the work in progress is to stop. A loop over rows may leave the rest as they are then,
/// if whoever called it asks [`check_interrupted`] before the rows are used.
#[inline]
pub fn is_stopping() -> bool {
    let stop = STOP.load(Ordering::Relaxed);
    stop != 0 && stop & FINISHING == 0
}

/// Checks whether the work in progress is to stop.
///
/// # Errors
/// [`Error::Interrupted`] if the work in progress is to stop.
#[inline]
pub fn check_interrupted() -> Result<()> {
    if is_stopping() { Err(Error::Interrupted) } else { Ok(()) }
}

/// Marks the work as ended: results found until then can be written, and nothing stops that.
pub fn finish_stopping() {
    if is_stopping() {
        STOP.fetch_or(FINISHING, Ordering::Relaxed);
    }
}
