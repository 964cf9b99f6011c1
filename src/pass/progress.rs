//! What passes say while they run. The library shows nothing itself: whoever runs passes hands over a [`Progress`].

/// Where a run's notes, results and bars go.
pub trait Progress {
    /// Something worth knowing that is not an error.
    fn note(&self, text: &str);

    /// A line of result.
    fn print(&self, text: &str);

    /// A bar of `length` steps under a title; it is gone once [`Bar::finish_and_clear`] is called or it is dropped.
    fn bar(&self, title: &str, length: u64) -> Box<dyn Bar>;
}

/// How far a piece of work has come.
pub trait Bar: Send + Sync {
    /// So many more steps are done.
    fn inc(&self, steps: u64);

    /// So many steps are done in all.
    fn set_position(&self, steps: u64);

    /// A word beside the bar.
    fn set_message(&self, message: String);

    /// The work is done, and the bar no longer of interest.
    fn finish_and_clear(&self);
}

/// A [`Progress`] and a [`Bar`] that show nothing.
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
