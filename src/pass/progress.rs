//! Output of passes while they run. The library prints nothing itself: the caller supplies a [`Progress`].

/// Receives the notes, results and progress bars of a run.
pub trait Progress {
    /// A note for the user that is not an error.
    fn note(&self, text: &str);

    /// A line of result.
    fn print(&self, text: &str);

    /// Creates a bar of `length` steps with a title; [`Bar::finish_and_clear`] or dropping removes it.
    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar>;
}

/// The progress bar of a task.
pub trait Bar: Send + Sync {
    /// Adds finished steps.
    fn inc(&self, steps: u64);

    /// Sets the number of finished steps.
    fn set_position(&self, steps: u64);

    /// Sets the message beside the bar.
    fn set_message(&self, message: String);

    /// Finishes the task and removes the bar.
    fn finish_and_clear(&self);
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
