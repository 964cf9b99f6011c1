//! Threads of one process as ranks, for tests and for programs that want no MPI.

use super::ranks::{Communicator, broken};
use crate::error::Result;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Mutex, PoisonError};

/// One of several threads that talk through channels.
pub struct ThreadRank {
    rank: usize,
    /// The ways to all threads and from all threads, by rank; those to itself are used as well.
    ways: Mutex<(Vec<Sender<Vec<u8>>>, Vec<Receiver<Vec<u8>>>)>,
}

impl ThreadRank {
    /// So many ranks; each thread takes one.
    pub fn group(size: usize) -> Vec<Self> {
        let mut to: Vec<Vec<Sender<Vec<u8>>>> = (0..size).map(|_| Vec::new()).collect();
        let mut from: Vec<Vec<Receiver<Vec<u8>>>> = (0..size).map(|_| Vec::new()).collect();
        for senders in &mut to {
            for receivers in &mut from {
                let (sender, receiver) = channel();
                senders.push(sender);
                receivers.push(receiver);
            }
        }
        let ways = to.into_iter().zip(from).map(Mutex::new);
        ways.enumerate().map(|(rank, ways)| Self { rank, ways }).collect()
    }
}

impl Communicator for ThreadRank {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.ways.lock().unwrap_or_else(PoisonError::into_inner).0.len()
    }

    fn all_gather(&self, bytes: &[u8]) -> Result<Vec<Vec<u8>>> {
        let ways = self.ways.lock().unwrap_or_else(PoisonError::into_inner);
        let gone = |rank: usize| broken(format!("rank {rank} is gone"));
        for (rank, to) in ways.0.iter().enumerate() {
            to.send(bytes.to_vec()).map_err(|_| gone(rank))?;
        }
        let receive = |(rank, from): (usize, &Receiver<Vec<u8>>)| from.recv().map_err(|_| gone(rank));
        ways.1.iter().enumerate().map(receive).collect()
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
