//! Two clocks: wall time, and the time that all threads of the process have had of processors; with them what these have allocated.

use super::allocation::{AllocationCounter, AllocationReading};
use std::time::{Duration, Instant};

/// A time on both clocks and what has been allocated until then, from the begin of a profile.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ClockReading {
    pub wall: Duration,
    /// Zero where the system does not say it.
    pub cpu: Duration,
    /// Zero where the program's allocator does not count.
    pub allocated: AllocationReading,
}

impl ClockReading {
    /// From an earlier moment to this one.
    pub fn since(self, earlier: Self) -> Self {
        Self {
            wall: self.wall.saturating_sub(earlier.wall),
            cpu: self.cpu.saturating_sub(earlier.cpu),
            allocated: self.allocated.since(earlier.allocated),
        }
    }

    pub fn plus(self, other: Self) -> Self {
        Self {
            wall: self.wall + other.wall,
            cpu: self.cpu + other.cpu,
            allocated: self.allocated.plus(other.allocated),
        }
    }
}

/// Both clocks and the counter, set to zero when it is made.
pub(super) struct Clock {
    wall: Instant,
    cpu: Option<Duration>,
    allocations: Option<AllocationCounter>,
}

impl Clock {
    pub fn new() -> Self {
        Self { wall: Instant::now(), cpu: cpu_time(), allocations: AllocationCounter::new() }
    }

    /// Whether the system says processor time.
    pub fn has_cpu(&self) -> bool {
        self.cpu.is_some()
    }

    /// Whether the program's allocator counts.
    pub fn has_allocations(&self) -> bool {
        self.allocations.is_some()
    }

    pub fn now(&self) -> ClockReading {
        let cpu = self.cpu.zip(cpu_time()).map(|(begin, now)| now.saturating_sub(begin));
        let allocated = self.allocations.as_ref().map(AllocationCounter::read);
        ClockReading {
            wall: self.wall.elapsed(),
            cpu: cpu.unwrap_or_default(),
            allocated: allocated.unwrap_or_default(),
        }
    }
}

/// Processor time of all threads of the process, user and system.
#[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple", target_os = "freebsd"))]
fn cpu_time() -> Option<Duration> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(Duration::new(time.tv_sec.try_into().ok()?, time.tv_nsec.try_into().ok()?))
}

#[cfg(not(any(target_os = "linux", target_os = "android", target_vendor = "apple", target_os = "freebsd")))]
fn cpu_time() -> Option<Duration> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_takes_processor_time_and_sleep_does_not() {
        let clock = Clock::new();
        let begin = clock.now();
        let mut sum = 0u64;
        while clock.now().since(begin).wall < Duration::from_millis(40) {
            sum = std::hint::black_box(sum.wrapping_mul(3).wrapping_add(1));
        }
        let worked = clock.now().since(begin);
        assert!(worked.wall >= Duration::from_millis(40));
        assert_eq!(clock.has_cpu(), worked.cpu > Duration::ZERO);
        let twice = worked.plus(worked);
        assert_eq!((twice.wall, twice.cpu), (2 * worked.wall, 2 * worked.cpu));
        assert_eq!(twice.allocated, worked.allocated.plus(worked.allocated));
        assert_eq!(begin.since(clock.now()), ClockReading::default());
    }
}
