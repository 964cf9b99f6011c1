//! Output of passes while they run. The library prints nothing itself: the caller supplies a
//! [`Progress`].

use lobelia_solve::fit::run::FitProgress;
use std::cell::RefCell;

/// A moment of a run in which its state is whole.
#[derive(Clone, Copy, Debug)]
pub enum Moment<'a> {
    /// A pass begins.
    Pass {
        /// Its name.
        name: &'a str,
        /// Its place among the passes of the scene, from 1.
        number: usize,
        /// How many there are.
        count: usize,
    },
    /// A step of a `Fit` or `Shape` is done.
    Step {
        /// The step, counted over all levels.
        step: u32,
        /// The number of all steps.
        steps: u32,
        /// The fit of the level.
        fit: &'a FitProgress,
    },
}

/// Receives the notes, results and progress bars of a run.
pub trait Progress {
    /// A note for the user that is not an error.
    fn note(&self, _text: &str) {}

    /// A line of result.
    fn print(&self, _text: &str) {}

    /// Creates a bar of `length` steps with a title; [`Bar::finish_and_clear`] or dropping removes
    /// it. A length of 0 is one that is not known, or not yet.
    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar>;

    /// Called at each [`Moment`].
    fn moment(&self, _at: Moment) {}
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

    /// Finishes the task and removes the bar.
    fn finish_and_clear(&self) {}
}

/// A [`Progress`] that passes everything on, and keeps lines of result and notes for the run's
/// record.
pub struct RecordedMessages<'a> {
    to: &'a dyn Progress,
    lines: RefCell<Vec<String>>,
}

impl<'a> RecordedMessages<'a> {
    /// Passes on `to` another.
    pub fn new(to: &'a dyn Progress) -> Self {
        Self { to, lines: RefCell::default() }
    }

    /// The lines since this was called last.
    pub fn take(&self) -> Vec<String> {
        self.lines.take()
    }
}

impl Progress for RecordedMessages<'_> {
    fn note(&self, text: &str) {
        self.lines.borrow_mut().push(text.to_owned());
        self.to.note(text);
    }

    fn print(&self, text: &str) {
        self.lines.borrow_mut().push(text.to_owned());
        self.to.print(text);
    }

    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar> {
        self.to.bar(title, length)
    }

    fn moment(&self, at: Moment) {
        self.to.moment(at);
    }
}

/// A [`Progress`] and a [`Bar`] without output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Silent;

impl Progress for Silent {
    fn bar(&self, _: &str, _: u64) -> Box<dyn Bar> {
        Box::new(Self)
    }
}

impl Bar for Silent {}
