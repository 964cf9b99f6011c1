//! The tree of sums: what took how long, inside what.

use serde::{Deserialize, Serialize};

/// What a part of a run is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum PartKind {
    /// All that a profiler has seen, from its begin on.
    #[default]
    Whole,
    /// A pass of a scene.
    Pass,
    /// A stage of a pass, of a fit, or of the run.
    Stage,
    /// A schedule of the pipeline: a phase.
    Schedule,
    /// The run conditions of a schedule's systems.
    Conditions,
    /// A system.
    System,
    /// What a system put off until after it: spawned and despawned entities.
    Commands,
}

/// A part of a run, with the parts inside it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// Its name; of a system that of its function.
    pub name: String,
    /// What it is.
    pub kind: PartKind,
    /// How often it ran.
    pub runs: u64,
    /// Wall time of all runs, seconds.
    pub wall_secs: f64,
    /// Part of the wall time of the whole.
    pub wall_share: f64,
    /// Processor time of all threads during these runs, seconds; `null` where the system does not say it.
    pub cpu_secs: Option<f64>,
    /// Part of the processor time of the whole.
    pub cpu_share: Option<f64>,
    /// Mean number of threads that were busy: processor time over wall time.
    pub threads_busy: Option<f64>,
    /// Allocations of all threads during these runs; `null` where the program's allocator does not count
    /// ([`CountingAllocator`](super::CountingAllocator)).
    #[serde(default)]
    pub allocations: Option<u64>,
    /// What these asked for, MiB, whether or not it has been given back since; `null` as above.
    #[serde(default)]
    pub allocated_mib: Option<f64>,
    /// The parts inside it, in the order of their first runs.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub parts: Vec<Part>,
}

impl Part {
    /// Wall and processor time that is in none of the parts inside, seconds.
    pub fn rest(&self) -> (f64, Option<f64>) {
        let wall: f64 = self.parts.iter().map(|part| part.wall_secs).sum();
        let cpu: f64 = self.parts.iter().filter_map(|part| part.cpu_secs).sum();
        ((self.wall_secs - wall).max(0.0), self.cpu_secs.map(|all| (all - cpu).max(0.0)))
    }

    /// Allocations that are in none of the parts inside: their number, and MiB.
    pub fn rest_allocations(&self) -> (Option<u64>, Option<f64>) {
        let count: u64 = self.parts.iter().filter_map(|part| part.allocations).sum();
        let mib: f64 = self.parts.iter().filter_map(|part| part.allocated_mib).sum();
        let rest = self.allocations.map(|all| all.saturating_sub(count));
        (rest, self.allocated_mib.map(|all| (all - mib).max(0.0)))
    }
}

/// Where the time of a run went; the section `profile` of `metrics.json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// Worker threads that could have been busy.
    pub threads: usize,
    /// All of it.
    pub whole: Part,
}

impl Profile {
    /// The part that these names lead to, from the outermost inward; none leads to the whole.
    pub fn find(&self, names: &[&str]) -> Option<&Part> {
        names.iter().try_fold(&self.whole, |part, name| part.parts.iter().find(|inner| inner.name == *name))
    }
}
