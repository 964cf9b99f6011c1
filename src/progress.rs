//! What an object says while it is found, rendered and written. The library prints nothing itself:
//! the caller supplies a [`Progress`], which a closure over [`Step`]s is as well.
//!
//! ```
//! use lobelia::progress::{Progress, Step};
//! use std::ops::ControlFlow;
//!
//! // Stops a fit after 300 steps; what was found until then stays.
//! let watch = |at: &Step| if at.step < 300 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
//! let progress: Box<dyn Progress> = Box::new(watch);
//! progress.print("a line of result, which the closure leaves out");
//! ```

use bevy_ecs::prelude::World;
use lobelia_geometry::Result;
use lobelia_solve::fit::run::FitProgress;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, PoisonError};

/// A step of a fit or of a shape, done.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// The pass that it is of.
    pub pass: &'a str,
    /// The step, from 1, counted over all levels.
    pub step: u32,
    /// The number of all steps.
    pub steps: u32,
    /// The fit, of the level.
    pub fit: &'a FitProgress,
}

/// Receives the notes, results and progress bars of work on an object.
pub trait Progress: Send + Sync {
    /// A note for the user that is not an error.
    fn note(&self, _text: &str) {}

    /// A line of result.
    fn print(&self, _text: &str) {}

    /// Creates a bar of `length` steps with a title; dropping removes it. A length of 0 is one that
    /// is not known, or not yet.
    fn bar(&self, _title: &str, _length: u64) -> Box<dyn Bar> {
        Box::new(Silent)
    }

    /// A pass begins: its name, its place among those of the run, from 1, and how many there are.
    fn pass(&self, _name: &str, _number: usize, _count: usize) {}

    /// A step is done, with the state of the world after it. `Break` ends the work as a
    /// request to stop does: what was found stays.
    ///
    /// # Errors
    /// Its own, which end the fit as well.
    fn step(&self, _at: &Step, _world: &mut World) -> Result<ControlFlow<()>> {
        Ok(ControlFlow::Continue(()))
    }
}

impl<F: Fn(&Step) -> ControlFlow<()> + Send + Sync> Progress for F {
    fn step(&self, at: &Step, _world: &mut World) -> Result<ControlFlow<()>> {
        Ok(self(at))
    }
}

/// The progress bar of a task.
pub trait Bar: Send + Sync {
    /// Adds finished steps.
    fn inc(&self, _steps: u64) {}

    /// Sets the number of finished steps.
    fn set_position(&self, _steps: u64) {}

    /// Sets the number of all steps, once it is known better. The first that is not 0 ends the
    /// message of what was before.
    fn set_length(&self, _steps: u64) {}

    /// Sets the message beside the bar.
    fn set_message(&self, _message: String) {}
}

/// What is done with each step before it is passed on.
type Watch = Box<dyn Fn(&Step, &mut World) -> Result<()> + Send + Sync>;

/// A [`Progress`] that passes everything on, and keeps lines of result and notes for the run's
/// record.
pub struct RecordedMessages {
    to: Arc<dyn Progress>,
    lines: Mutex<Vec<String>>,
    watch: Option<Watch>,
}

impl RecordedMessages {
    /// Passes on `to` another.
    pub fn new(to: Arc<dyn Progress>) -> Self {
        Self { to, lines: Mutex::default(), watch: None }
    }

    /// Does something with each step as well.
    pub(crate) fn watching(self, watch: Watch) -> Self {
        Self { watch: Some(watch), ..self }
    }

    /// The lines since this was called last.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut self.lines.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn keep(&self, text: &str) {
        self.lines.lock().unwrap_or_else(PoisonError::into_inner).push(text.to_owned());
    }
}

impl Progress for RecordedMessages {
    fn note(&self, text: &str) {
        self.keep(text);
        self.to.note(text);
    }

    fn print(&self, text: &str) {
        self.keep(text);
        self.to.print(text);
    }

    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar> {
        self.to.bar(title, length)
    }

    fn pass(&self, name: &str, number: usize, count: usize) {
        self.to.pass(name, number, count);
    }

    fn step(&self, at: &Step, world: &mut World) -> Result<ControlFlow<()>> {
        self.watch.as_ref().map_or(Ok(()), |watch| watch(at, world))?;
        self.to.step(at, world)
    }
}

/// A [`Progress`] and a [`Bar`] without output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Silent;

impl Progress for Silent {}

impl Bar for Silent {}
