//! Threads of one process as ranks, for tests and for programs that want no MPI.

use super::{Communicator, broken};
use crate::error::Result;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Mutex, PoisonError};

type Bytes = Vec<u8>;

/// One of several threads that talk through channels.
pub struct ThreadRank {
    rank: usize,
    ways: Mutex<Ways>,
}

/// The ways to all threads and from all threads, by rank; those to itself are used as well.
struct Ways {
    to: Vec<Sender<Bytes>>,
    from: Vec<Receiver<Bytes>>,
}

impl ThreadRank {
    /// So many ranks; each thread takes one.
    pub fn group(size: usize) -> Vec<Self> {
        let mut ways: Vec<Ways> = (0..size).map(|_| Ways { to: Vec::new(), from: Vec::new() }).collect();
        for (a, b) in (0..size).flat_map(|a| (0..size).map(move |b| (a, b))) {
            let (to, from) = channel();
            ways[a].to.push(to);
            ways[b].from.push(from);
        }
        ways.into_iter().enumerate().map(|(rank, ways)| Self { rank, ways: Mutex::new(ways) }).collect()
    }
}

impl Communicator for ThreadRank {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.ways.lock().unwrap_or_else(PoisonError::into_inner).to.len()
    }

    fn all_gather(&self, bytes: &[u8]) -> Result<Vec<Vec<u8>>> {
        let ways = self.ways.lock().unwrap_or_else(PoisonError::into_inner);
        let gone = |rank: usize| broken(format!("rank {rank} is gone"));
        for (rank, to) in ways.to.iter().enumerate() {
            to.send(bytes.to_vec()).map_err(|_| gone(rank))?;
        }
        let receive = |(rank, from): (usize, &Receiver<Bytes>)| from.recv().map_err(|_| gone(rank));
        ways.from.iter().enumerate().map(receive).collect()
    }

    fn all_any(&self, said: bool) -> Result<bool> {
        Ok(self.all_gather(&[u8::from(said)])?.iter().any(|said| *said == [1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_get_what_each_has_sent_until_one_is_gone() {
        let ranks = ThreadRank::group(3);
        std::thread::scope(|scope| {
            for rank in ranks {
                scope.spawn(move || {
                    assert_eq!(rank.size(), 3);
                    let sent = vec![rank.rank() as u8; rank.rank()];
                    assert_eq!(rank.all_gather(&sent).unwrap(), [vec![], vec![1], vec![2, 2]]);
                    assert!(rank.all_any(rank.rank() == 1).unwrap());
                    assert!(!rank.all_any(false).unwrap());
                    if rank.rank() > 0 {
                        assert!(rank.all_any(false).is_err());
                    }
                });
            }
        });
    }
}
