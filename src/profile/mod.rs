//! Where the time of a run goes: wall and processor time, and allocations, by stage, schedule and system.
//!
//! Stages of the library ([`stage`], [`pass`]) and the schedules and systems of `bevy_ecs` are `tracing` spans. A [`Profiler`] listens to those
//! of the calling thread while work is done, sums them up as a tree ([`Profile`]), and can keep each of them as an event of a trace that
//! [Perfetto](https://ui.perfetto.dev) shows ([`Profiler::write_trace`]). Until there is a profiler in the program, a span is one look at a flag. Another
//! `tracing` subscriber, such as Tracy's, sees the same spans.
//!
//! | module | holds |
//! | --- | --- |
//! | `clock` | wall time, and processor time of all threads |
//! | `allocation` | how often and how much all threads have allocated, in a program with a [`CountingAllocator`] |
//! | `recorder` | the subscriber: what is open now, and sums over what has ended |
//! | [`part`] | the tree of sums |
//! | `chrome_trace` | the events as JSON |
//!
//! A system's span is made when the system is: build the pipeline under the profiler, too.
//!
//! ```
//! use lobelia::prelude::*;
//! use lobelia::profile::{Profiler, stage};
//!
//! #[derive(ScheduleLabel, Clone, Debug, PartialEq, Eq, Hash)]
//! struct Tick;
//!
//! fn count_texels(texels: Query<&TexelIndex>) {
//!     let _ = texels.iter().count();
//! }
//!
//! let profiler = Profiler::new(false);
//! profiler.during(|| {
//!     let mut pipeline = Pipeline::new();
//!     pipeline.add_phase(Tick).add_systems(Tick, Stage::Gather, count_texels);
//!     let _counting = stage("counting");
//!     pipeline.run(Tick)
//! })?;
//! let profile = profiler.profile();
//! let system = profile.find(&["counting", "Tick", "count_texels"]).expect("it ran");
//! assert_eq!(system.runs, 1);
//! assert!(system.wall_secs <= profile.whole.wall_secs);
//! # Ok::<(), lobelia::Error>(())
//! ```

mod allocation;
mod chrome_trace;
mod clock;
pub mod part;
mod recorder;

#[cfg(test)]
mod tests;

pub use allocation::CountingAllocator;
pub use part::{Part, PartKind, Profile};

use recorder::Recorder;
use std::fmt::Display;
use std::io::{self, Write};
use std::sync::{Arc, LazyLock};
use tracing::Dispatch;
use tracing::dispatcher::with_default;
use tracing::span::EnteredSpan;

/// A stage that is at work until this is dropped.
#[must_use = "a stage ends when this is dropped"]
pub struct StageGuard(#[expect(dead_code, reason = "it is dropped")] EnteredSpan);

/// Begins a stage inside whatever is at work: a part of a pass, of a fit, of a program of your own. Stages of one name inside the same part
/// are summed up.
pub fn stage(name: impl Display) -> StageGuard {
    StageGuard(tracing::info_span!("stage", name = %name).entered())
}

/// Begins a pass of a scene, as [`stage`] does a stage.
pub fn pass(name: impl Display) -> StageGuard {
    StageGuard(tracing::info_span!("pass", name = %name).entered())
}

/// A recorder that nothing goes on under. While `tracing` knows of one recorder only, it asks the thread that is first at a place whether the place's spans are wanted,
/// for all threads and for good: a thread without a profiler would lose those of the others. With two it asks them all.
static ALWAYS_THERE: LazyLock<Dispatch> = LazyLock::new(|| Dispatch::new(Recorder::new(false)));

/// Measures what goes on under it. Clones are the same profiler.
#[derive(Clone)]
pub struct Profiler {
    recorder: Arc<Recorder>,
    dispatch: Dispatch,
}

impl Profiler {
    /// A profiler whose time begins now; `keeps_events` says whether it can write a trace, for some eighty bytes a span.
    pub fn new(keeps_events: bool) -> Self {
        LazyLock::force(&ALWAYS_THERE);
        let recorder = Arc::new(Recorder::new(keeps_events));
        Self { dispatch: Dispatch::new(recorder.clone()), recorder }
    }

    /// Does some work on this thread, and records its spans. What other threads do is in the processor time and the allocations of
    /// the span that waits for them.
    pub fn during<T>(&self, work: impl FnOnce() -> T) -> T {
        with_default(&self.dispatch, work)
    }

    /// All so far; what is still at work counts until now.
    pub fn profile(&self) -> Profile {
        self.recorder.profile()
    }

    /// Whether it can write a trace.
    pub fn keeps_events(&self) -> bool {
        self.recorder.keeps_events()
    }

    /// Writes all events so far as a JSON trace: nested, with wall time and, in `args`, processor time and allocations. Empty if none are kept.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn write_trace(&self, writer: &mut impl Write) -> io::Result<()> {
        chrome_trace::write(&self.recorder.events(), writer)
    }
}
