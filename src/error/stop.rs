//! How a run is stopped from outside, and how its work finds out: one flag that every long loop asks.
//!
//! The flag is of the process, as a signal is: it stops the work of all pipelines and threads, and is never reset. A program that runs several
//! and wants to stop one of them returns `ControlFlow::Break` from that fit's `watch` instead.

use crate::error::{Error, Result};
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicUsize, Ordering};

/// What asked a run to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[non_exhaustive]
pub enum StopSignal {
    /// Ctrl-C.
    Interrupt = 1,
    /// SIGTERM.
    Terminate = 2,
    /// SIGHUP: the terminal was closed.
    HangUp = 3,
    /// The button of the page that `lobelia run --live` serves.
    Page = 4,
}

impl StopSignal {
    const ALL: [Self; 4] = [Self::Interrupt, Self::Terminate, Self::HangUp, Self::Page];

    /// The exit code of a process that it stops: 128 plus the number of the signal; that of Ctrl-C for the page.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Interrupt | Self::Page => 130,
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
            Self::Page => "the button of its page",
        })
    }
}

/// The signal, and [`FINISHING`].
static STOP: AtomicU8 = AtomicU8::new(0);
/// Set once the work has ended and only its results are written.
const FINISHING: u8 = 0x80;
/// How many [`HeldStops`] there are.
static HELD: AtomicUsize = AtomicUsize::new(0);
/// Whether all processes have begun to stop, as far as signals wait for that.
static AGREED: AtomicBool = AtomicBool::new(false);

/// Asks all work in progress in this process to stop; returns whether it is the first to ask. While there are [`HeldStops`] that waits
/// for [`begin_to_stop`].
pub fn ask_to_stop(signal: StopSignal) -> bool {
    STOP.compare_exchange(0, signal as u8, Ordering::Relaxed, Ordering::Relaxed).is_ok()
}

/// Makes a signal wait: as long as there is one, work that several processes do alike does not find out that it is to stop, for each would
/// at another place. They ask each other ([`is_asked_to_stop`]) and begin together ([`begin_to_stop`]).
///
/// ```standalone_crate
/// use lobelia::error::stop::{HeldStops, StopSignal, ask_to_stop, begin_to_stop, is_asked_to_stop, is_stopping, stopped_by};
///
/// let (held, other) = (HeldStops::new(), HeldStops::new());
/// assert!(ask_to_stop(StopSignal::Interrupt) && !ask_to_stop(StopSignal::Terminate));
/// assert!(is_asked_to_stop() && !is_stopping() && stopped_by().is_none());
/// drop(held);
/// assert!(!is_stopping());
/// // All processes know.
/// begin_to_stop(StopSignal::Terminate);
/// assert!(is_stopping() && stopped_by() == Some(StopSignal::Interrupt));
/// drop(other);
/// assert!(is_stopping());
/// ```
#[derive(Debug)]
pub struct HeldStops(());

impl HeldStops {
    /// From now on, until it is dropped.
    #[must_use]
    pub fn new() -> Self {
        HELD.fetch_add(1, Ordering::Relaxed);
        Self(())
    }
}

impl Default for HeldStops {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for HeldStops {
    fn drop(&mut self) {
        HELD.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Whether anything has asked the run to stop, also if that waits, or if the work has ended by now.
pub fn is_asked_to_stop() -> bool {
    STOP.load(Ordering::Relaxed) != 0
}

/// Stops the work in progress now, as all other processes do; they were asked by `signal` if this one was not.
pub fn begin_to_stop(signal: StopSignal) {
    ask_to_stop(signal);
    AGREED.store(true, Ordering::Relaxed);
}

/// Whether a signal need not wait for other processes.
fn is_due() -> bool {
    AGREED.load(Ordering::Relaxed) || HELD.load(Ordering::Relaxed) == 0
}

/// What asked the run to stop, if anything has and it does not wait.
pub fn stopped_by() -> Option<StopSignal> {
    let signal = STOP.load(Ordering::Relaxed) & !FINISHING;
    StopSignal::ALL.into_iter().find(|known| *known as u8 == signal).filter(|_| is_due())
}

/// Whether the work in progress is to stop. A loop over rows may leave the rest as they are then, if whoever called it asks
/// [`check_interrupted`] before the rows are used.
#[inline]
pub fn is_stopping() -> bool {
    let stop = STOP.load(Ordering::Relaxed);
    stop != 0 && stop & FINISHING == 0 && is_due()
}

/// [`Error::Interrupted`] if the work in progress is to stop.
///
/// # Errors
/// That one.
#[inline]
pub fn check_interrupted() -> Result<()> {
    if is_stopping() { Err(Error::Interrupted) } else { Ok(()) }
}

/// Says that the work has ended: what was found until then can be written, and nothing stops that.
pub fn finish_stopping() {
    if is_stopping() {
        STOP.fetch_or(FINISHING, Ordering::Relaxed);
    }
}
