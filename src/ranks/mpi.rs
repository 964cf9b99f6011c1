//! Ranks of MPI, the message passing interface.

use super::{Communicator, Ranks, broken};
use crate::error::Result;
use mpi::Threading;
use mpi::collective::SystemOperation;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator as _, CommunicatorCollectives as _};
use std::sync::Arc;

/// MPI at work; dropping it waits for all processes and ends it.
pub struct Mpi {
    _universe: Universe,
    ranks: Ranks,
}

impl Mpi {
    /// Starts MPI, which a process does once, on the thread that runs the fit.
    ///
    /// # Errors
    /// If it has started before.
    pub fn start() -> Result<Self> {
        let started = mpi::initialize_with_threading(Threading::Funneled);
        let (universe, _) = started.ok_or_else(|| broken("MPI has started before"))?;
        let world = universe.world();
        let (rank, size) = (world.rank() as usize, world.size() as usize);
        Ok(Self { _universe: universe, ranks: Ranks::new(Arc::new(MpiRank { rank, size })) })
    }

    /// How many of the processes are on this machine; all of them ask together.
    pub fn processes_here(&self) -> u64 {
        u64::from(SimpleCommunicator::world().split_shared(0).size().unsigned_abs())
    }

    /// The processes.
    pub fn ranks(&self) -> &Ranks {
        &self.ranks
    }

    /// Ends all processes at once.
    pub fn abort(&self, exit_code: u8) -> ! {
        SimpleCommunicator::world().abort(i32::from(exit_code))
    }
}

impl Drop for Mpi {
    /// After a panic the others would wait forever.
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.abort(101);
        }
    }
}

/// One of the processes that `mpirun` has started.
struct MpiRank {
    rank: usize,
    size: usize,
}

impl Communicator for MpiRank {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.size
    }

    fn all_gather(&self, bytes: &[u8]) -> Result<Vec<Vec<u8>>> {
        let world = SimpleCommunicator::world();
        let count = i32::try_from(bytes.len()).map_err(|_| broken("a message is too large"))?;
        let mut counts = vec![0; self.size];
        world.all_gather_into(&count, &mut counts[..]);
        let starts: Vec<i32> = counts
            .iter()
            .scan(0i32, |end, count| {
                let start = *end;
                *end = end.checked_add(*count)?;
                Some(start)
            })
            .collect();
        let total: usize = counts.iter().map(|count| *count as usize).sum();
        if starts.len() < self.size || i32::try_from(total).is_err() {
            return Err(broken("the messages are too large"));
        }
        let mut all = vec![0u8; total];
        world.all_gather_varcount_into(bytes, &mut PartitionMut::new(&mut all[..], &counts[..], &starts[..]));
        let part = |(start, count): (&i32, &i32)| all[*start as usize..][..*count as usize].to_vec();
        Ok(starts.iter().zip(&counts).map(part).collect())
    }

    fn all_any(&self, said: bool) -> Result<bool> {
        let (said, mut any) = (i32::from(said), 0i32);
        SimpleCommunicator::world().all_reduce_into(&said, &mut any, SystemOperation::max());
        Ok(any > 0)
    }
}
