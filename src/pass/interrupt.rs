//! How a run is stopped from outside.

use crate::error::{Error, Result};
use std::sync::atomic::{AtomicBool, Ordering};

/// Set by Ctrl-C: the fit in progress ends at its next step, other passes at their next picture.
pub static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// [`Error::Interrupted`] once Ctrl-C was pressed.
///
/// # Errors
/// That one.
pub fn check_interrupted() -> Result<()> {
    if INTERRUPTED.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
}
