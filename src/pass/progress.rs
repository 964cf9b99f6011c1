//! Output of passes while they run. The library prints nothing itself: the caller supplies a [`Progress`].

use crate::error::Result;
use crate::fit::run::FitProgress;
use crate::pass::live::Snapshot;
use std::cell::RefCell;
use std::path::Path;

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
        /// Index of the level, and how many there are; a `Fit` has one.
        level: [usize; 2],
        /// The step, counted over all levels, and how many there are.
        step: [u32; 2],
        /// The fit of the level.
        fit: &'a FitProgress,
    },
}

/// Copies the state at a [`Moment`]. It takes over what an earlier copy has of the photographs.
///
/// # Errors
/// If there is no object yet.
pub type Copier<'a> = dyn FnMut(Option<&Snapshot>) -> Result<Snapshot> + 'a;

/// Receives the notes, results and progress bars of a run.
pub trait Progress {
    /// A note for the user that is not an error.
    fn note(&self, text: &str);

    /// A line of result.
    fn print(&self, text: &str);

    /// The last picture of a run, a PNG file, for whoever can show it.
    fn picture(&self, _path: &Path) {}

    /// Creates a bar of `length` steps with a title; [`Bar::finish_and_clear`] or dropping removes it. A length of 0 is one that is not
    /// known, or not yet.
    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar>;

    /// Called at each [`Moment`]. The state is copied only if `copy` is called, which takes time from the run; it changes nothing of it.
    fn look(&self, _at: Moment, _copy: &mut Copier) {}
}

/// The progress bar of a task.
pub trait Bar: Send + Sync {
    /// Adds finished steps.
    fn inc(&self, steps: u64);

    /// Sets the number of finished steps.
    fn set_position(&self, steps: u64);

    /// Sets the number of all steps, once it is known better. The first that is not 0 ends the message of what was before.
    fn set_length(&self, _steps: u64) {}

    /// Sets the message beside the bar.
    fn set_message(&self, message: String);

    /// Finishes the task and removes the bar.
    fn finish_and_clear(&self);
}

/// A [`Progress`] that passes everything on, and keeps lines of result and notes for the run's record.
pub struct RecordedMessages<'a> {
    to: &'a dyn Progress,
    lines: RefCell<Vec<String>>,
}

impl<'a> RecordedMessages<'a> {
    /// Passes on to `to`.
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

    fn picture(&self, path: &Path) {
        self.to.picture(path);
    }

    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar> {
        self.to.bar(title, length)
    }

    fn look(&self, at: Moment, copy: &mut Copier) {
        self.to.look(at, copy);
    }
}

/// A [`Progress`] and a [`Bar`] without output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Silent;

impl Progress for Silent {
    fn note(&self, _: &str) {}

    fn print(&self, _: &str) {}

    fn bar(&self, _: &str, _: u64) -> Box<dyn Bar> {
        Box::new(Self)
    }
}

impl Bar for Silent {
    fn inc(&self, _: u64) {}

    fn set_position(&self, _: u64) {}

    fn set_message(&self, _: String) {}

    fn finish_and_clear(&self) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_said_is_kept_once() {
        let told = RecordedMessages::new(&Silent);
        told.note("a note");
        told.print("a result");
        told.bar("bar", 3).inc(1);
        assert_eq!(told.take(), ["a note", "a result"]);
        assert!(told.take().is_empty());
    }
}
