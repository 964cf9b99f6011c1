//! Kernels against a plain scalar loop over a `Vec` of the same formulas, on one thread.
//!
//! `hot` works on the same points again and again; `cold` on points whose memory was last touched
//! [`POOL_POINTS`] points ago, which is more than caches hold. Times are for [`POINTS`] points ×
//! [`LOBES`] lobes; for nanoseconds per pair over many sizes see
//! `lobelia bench`.

// Criterion makes public functions.
#![allow(missing_docs)]

mod plain;
mod pool;
mod shading;

use criterion::{Criterion, criterion_group, criterion_main};
use std::{ops::Range, time::Duration};

/// Points of one run: what a thread takes at a time.
pub const POINTS: usize = 256;
/// Light lobes.
pub const LOBES: usize = 128;
/// Points of all runs together; with results and adjoints they take some 100 MiB.
pub const POOL_POINTS: usize = 1 << 20;

/// Hot or cold, and how many points there are to choose from.
pub const CACHES: [(&str, usize); 2] = [("hot", POINTS), ("cold", POOL_POINTS)];

/// The points of successive runs: one slice after another, around and around.
pub struct Turns {
    next: usize,
    len: usize,
}

impl Turns {
    pub fn new(len: usize) -> Self {
        Self { next: 0, len }
    }

    /// The next `size` of them.
    pub fn take(&mut self, size: usize) -> Range<usize> {
        let start = self.next;
        self.next = (start + size) % self.len;
        start..start + size
    }
}

fn short() -> Criterion {
    Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2))
        .without_plots()
}

criterion_group! {
    name = kernels;
    config = short();
    targets = shading::forward, shading::adjoint, pool::pool
}
criterion_main!(kernels);
