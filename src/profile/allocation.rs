//! How often, and how much, all threads of the program have allocated.

use alloc_tracker::{Operation, ProcessSpan, Session};
use std::alloc::System;
use std::hint::black_box;
use std::sync::{Mutex, PoisonError};

/// The system's allocator, counting what is asked of it: a [`Profiler`](super::Profiler) says allocations where a program has it as its
/// `#[global_allocator]`, as the `lobelia` command does. Each thread counts for itself, which takes a nanosecond an allocation.
///
/// ```
/// use lobelia::profile::{CountingAllocator, Profiler, stage};
///
/// #[global_allocator]
/// static ALLOCATOR: CountingAllocator = CountingAllocator::system();
///
/// fn main() {
///     let profiler = Profiler::new(false);
///     let kept = profiler.during(|| {
///         let _filling = stage("filling");
///         (0..100).map(|_| vec![1u8; 10_000]).collect::<Vec<_>>()
///     });
///     let profile = profiler.profile();
///     let filling = profile.find(&["filling"]).expect("it ran");
///     assert!(filling.allocations >= Some(kept.len() as u64) && filling.allocated_mib >= Some(0.9));
/// }
/// ```
pub type CountingAllocator = alloc_tracker::Allocator<System>;

/// Allocations of all threads.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct AllocationReading {
    /// How many there were; a block that grows or shrinks counts again.
    pub count: u64,
    /// How many bytes they asked for; a block that grows or shrinks counts with all of its new ones.
    pub bytes: u64,
}

impl AllocationReading {
    /// From an earlier moment to this one.
    pub fn since(self, earlier: Self) -> Self {
        let (count, bytes) =
            (self.count.saturating_sub(earlier.count), self.bytes.saturating_sub(earlier.bytes));
        Self { count, bytes }
    }

    pub fn plus(self, other: Self) -> Self {
        Self { count: self.count + other.count, bytes: self.bytes + other.bytes }
    }
}

/// Counts from zero. What is allocated while it is read, as for the reading itself, is not counted.
pub(super) struct AllocationCounter {
    session: Session,
    operation: Operation,
    /// What has been counted since the last reading; it is added to the operation when it is dropped.
    since: Mutex<Option<ProcessSpan>>,
}

impl AllocationCounter {
    /// `None` where the program's allocator does not count.
    pub fn new() -> Option<Self> {
        let trial = Self::begin();
        drop(black_box(Box::new(0u8)));
        (trial.read().count > 0).then(Self::begin)
    }

    fn begin() -> Self {
        // Without the two a session prints and writes what it has found.
        let session = Session::new().no_stdout().no_file();
        let operation = session.operation("");
        let since = Mutex::new(Some(count_on(&operation)));
        Self { session, operation, since }
    }

    pub fn read(&self) -> AllocationReading {
        let mut since = self.since.lock().unwrap_or_else(PoisonError::into_inner);
        *since = None;
        let report = self.session.to_report();
        let all = report.operations().map(|(_, operation)| AllocationReading {
            count: operation.total_allocations_count(),
            bytes: operation.total_bytes_allocated(),
        });
        let all = all.fold(AllocationReading::default(), AllocationReading::plus);
        *since = Some(count_on(&self.operation));
        all
    }
}

/// Begins a span, ready to be dropped at any time.
fn count_on(operation: &Operation) -> ProcessSpan {
    operation.measure_process().iterations(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    /// That of all unit tests.
    #[global_allocator]
    static ALLOCATOR: CountingAllocator = CountingAllocator::system();

    /// Other tests allocate meanwhile, and so there may be more.
    #[test]
    fn allocations_of_all_threads_are_counted() {
        let counter = AllocationCounter::new().expect("the allocator counts");
        let begin = counter.read();
        let kept = black_box(vec![1u8; 3 << 20]);
        let mine = counter.read().since(begin);
        assert!(mine.count >= 1 && mine.bytes >= kept.len() as u64, "{mine:?}");
        let fill = || (0..1000).map(|i| *black_box(Box::new(i))).collect::<Vec<u64>>().len();
        let begin = counter.read();
        let filled = thread::scope(|scope| {
            [scope.spawn(fill), scope.spawn(fill)].map(|filling| filling.join().unwrap())
        });
        assert_eq!(filled, [1000; 2]);
        let of_both = counter.read().since(begin);
        assert!(of_both.count >= 2000 && of_both.bytes >= 2 * 8000, "{of_both:?}");
        assert_eq!(begin.since(counter.read()), AllocationReading::default());
    }

    #[test]
    fn a_block_that_grows_counts_again() {
        let counter = AllocationCounter::new().expect("the allocator counts");
        let begin = counter.read();
        let mut kept = black_box(Vec::<u8>::with_capacity(1 << 20));
        kept.reserve_exact(2 << 20);
        black_box(&kept);
        let grown = counter.read().since(begin);
        assert!(grown.count >= 2 && grown.bytes >= 3 << 20, "{grown:?}");
    }
}
