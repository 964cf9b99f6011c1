//! How work is stopped from outside, and how it finds out.
//!
//! A signal is of the process: it stops the work of all threads, and is never taken back. A [`Stop`]
//! stops the pieces of work that are done under it: whoever has a clone of it may ask, from any
//! thread. Long loops ask [`is_stopping`], which answers for the work that their thread is at.
//!
//! ```
//! use lobelia_geometry::error::stop::{Stop, is_stopping};
//!
//! let stop = Stop::default();
//! stop.ask();
//! assert!(stop.over(is_stopping) && !is_stopping());
//! ```

use crate::{Error, Result};
use std::sync::atomic::{AtomicU8, Ordering};
use std::{cell::RefCell, fmt, sync::Arc};

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

/// The signal.
static SIGNAL: AtomicU8 = AtomicU8::new(0);

/// Asks all work in this process to stop; returns whether it is the first to ask.
pub fn ask_to_stop(signal: StopSignal) -> bool {
    SIGNAL.compare_exchange(0, signal as u8, Ordering::Relaxed, Ordering::Relaxed).is_ok()
}

/// Returns the signal that the process got, if it got one.
pub fn stopped_by() -> Option<StopSignal> {
    let signal = SIGNAL.load(Ordering::Relaxed);
    StopSignal::ALL.into_iter().find(|known| *known as u8 == signal)
}

/// A request to stop; clones are the same request, and it is never taken back.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicU8>);

/// The work that a thread is at: what may stop it, and how far that is.
#[derive(Clone, Default)]
pub(crate) struct Work {
    stop: Stop,
    state: Arc<AtomicU8>,
}

/// Bits of the state of a piece of work: that it asked itself to stop, and that it has ended and
/// only its results are written.
const ASKED: u8 = 1;
const FINISHING: u8 = 2;

thread_local! {
    static CURRENT: RefCell<Work> = RefCell::default();
}

/// Goes back to the work around.
struct Around(Work);

impl Drop for Around {
    fn drop(&mut self) {
        CURRENT.set(std::mem::take(&mut self.0));
    }
}

impl Work {
    /// The work of this thread.
    pub fn current() -> Self {
        CURRENT.with_borrow(Clone::clone)
    }

    /// Does a part of it on this thread.
    pub fn over<T>(&self, part: impl FnOnce() -> T) -> T {
        let _around = Around(CURRENT.replace(self.clone()));
        part()
    }

    fn was_asked(&self) -> bool {
        let own = self.state.load(Ordering::Relaxed) & ASKED != 0;
        own || self.stop.0.load(Ordering::Relaxed) != 0 || SIGNAL.load(Ordering::Relaxed) != 0
    }
}

impl Stop {
    /// The request that stops the work of this thread.
    pub fn current() -> Self {
        CURRENT.with_borrow(|work| work.stop.clone())
    }

    /// Asks all work under this to stop.
    pub fn ask(&self) {
        self.0.store(1, Ordering::Relaxed);
    }

    /// Does a piece of work that this stops, with the loops of [`parallel`](crate::parallel) in it.
    pub fn over<T>(&self, work: impl FnOnce() -> T) -> T {
        Work { stop: self.clone(), state: Arc::default() }.over(work)
    }
}

/// Asks the work of this thread to stop, and no other.
pub fn stop_this_work() {
    CURRENT.with_borrow(|work| _ = work.state.fetch_or(ASKED, Ordering::Relaxed));
}

/// Whether the work of this thread was asked to stop: by a signal, its [`Stop`], or itself.
pub fn was_asked_to_stop() -> bool {
    CURRENT.with_borrow(Work::was_asked)
}

/// Whether the work in progress is to stop. A loop over rows may leave the rest as they are then,
/// if whoever called it asks [`check_interrupted`] before the rows are used.
#[inline]
pub fn is_stopping() -> bool {
    CURRENT.with_borrow(|work| work.was_asked() && work.state.load(Ordering::Relaxed) & FINISHING == 0)
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
        CURRENT.with_borrow(|work| _ = work.state.fetch_or(FINISHING, Ordering::Relaxed));
    }
}
