//! The processes that work on one fit, and what they say to each other.
//!
//! Work on many items is divided in shares of whole chunks ([`share`]); each process does its own, and all get all. What only one process has is worked on by
//! that one ([`owned`]).

#[cfg(feature = "mpi")]
pub mod mpi;
pub mod owned;
pub(crate) mod packed;
pub mod threads;

use crate::error::stop::{StopSignal, begin_to_stop, check_interrupted, is_asked_to_stop};
use crate::error::{Error, Result};
use bevy_ecs::prelude::{Resource, World};
use std::fmt;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Bytes that all processes together send at a time.
const BLOCK_BYTES: usize = 1 << 28;
/// What went wrong if lengths differ.
const OTHER_DATA: &str = "another process works on other data";
/// What to do about processes that do not begin alike.
const AGREE: &str = "Start the same program with the same arguments and --threads everywhere, on processors of one kind and a file system that all of them see.";

/// What an MPI library or its launcher says to each process: how many there are, or which of them it is.
const STARTED: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK"];

/// Whether this process was started by `mpirun` or what has its place.
pub fn is_started() -> bool {
    STARTED.iter().any(|name| std::env::var_os(name).is_some())
}

/// Whether it was started as one of several, as far as the launcher says how many they are.
pub fn is_one_of_several() -> bool {
    let size = |name: &&str| std::env::var(name).ok()?.parse::<u64>().ok();
    STARTED.iter().filter(|name| name.ends_with("SIZE")).filter_map(size).any(|size| size > 1)
}

/// A group of processes (or threads) that call the same functions in the same order. A call returns once all have called it.
pub trait Communicator: Send + Sync {
    /// The number of this process, from 0.
    fn rank(&self) -> usize;

    /// How many there are.
    fn size(&self) -> usize;

    /// Sends bytes to all, and returns what each has sent, by rank.
    ///
    /// # Errors
    /// If another one is gone.
    fn all_gather(&self, bytes: &[u8]) -> Result<Vec<Vec<u8>>>;

    /// Whether any of them says so.
    ///
    /// # Errors
    /// If another one is gone.
    fn all_any(&self, said: bool) -> Result<bool>;
}

/// What a fit has sent so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Traffic {
    /// Steps.
    pub steps: u32,
    /// Of the samples of these steps.
    pub of_steps: Sent,
    /// Of shadows, before the first step, and of what was done between fits.
    pub of_shares: Sent,
}

/// What was sent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sent {
    /// Bytes that came from other processes.
    pub bytes: u64,
    /// Seconds, waiting for other processes included.
    pub seconds: f64,
}

/// The processes that work on one fit, as a resource of each one's world.
#[derive(Resource, Clone)]
pub struct Ranks {
    communicator: Arc<dyn Communicator>,
    traffic: Arc<Mutex<Traffic>>,
    stopped: Arc<AtomicBool>,
}

impl Ranks {
    /// Those of a communicator.
    pub fn new(communicator: Arc<dyn Communicator>) -> Self {
        Self { communicator, traffic: Arc::default(), stopped: Arc::default() }
    }

    /// The number of this process, from 0.
    pub fn rank(&self) -> usize {
        self.communicator.rank()
    }

    /// How many processes there are.
    pub fn size(&self) -> usize {
        self.communicator.size()
    }

    /// The share of this process in the work on `count` items, in whole chunks.
    pub fn share(&self, count: usize, chunk: usize) -> Range<usize> {
        share(count, chunk, self.rank(), self.size())
    }

    /// Sends bytes to all as part of a step, and returns what each has sent, by rank.
    pub(crate) fn all_gather(&self, bytes: &[u8]) -> Result<Vec<Vec<u8>>> {
        self.gather(bytes, |traffic| &mut traffic.of_steps)
    }

    /// Sends what this process has found for its share to all, in blocks, and returns what each has sent, by rank. If one is asked to stop, all are from now on.
    pub(crate) fn gather_shares(&self, bytes: &[u8]) -> Result<Vec<Vec<u8>>> {
        let of: fn(&mut Traffic) -> &mut Sent = |traffic| &mut traffic.of_shares;
        let length = (bytes.len() as u64).to_le_bytes();
        let mut longest = 0;
        for said in self.gather(&[&length[..], &[u8::from(is_asked_to_stop())]].concat(), of)? {
            let Ok([length @ .., stops]) = <[u8; 9]>::try_from(said) else { return Err(broken(OTHER_DATA)) };
            longest = longest.max(u64::from_le_bytes(length) as usize);
            if stops == 1 {
                self.stop_all();
            }
        }
        let mut all = vec![Vec::new(); self.size()];
        let most = (BLOCK_BYTES / self.size()).max(1);
        for start in (0..longest).step_by(most) {
            let block = &bytes[start.min(bytes.len())..bytes.len().min(start + most)];
            all.iter_mut().zip(self.gather(block, of)?).for_each(|(all, part)| all.extend(part));
        }
        Ok(all)
    }

    fn gather(&self, bytes: &[u8], of: fn(&mut Traffic) -> &mut Sent) -> Result<Vec<Vec<u8>>> {
        let begun = Instant::now();
        let parts = self.communicator.all_gather(bytes)?;
        let received: usize = parts.iter().map(Vec::len).sum();
        self.count(|traffic| {
            let sent = of(traffic);
            sent.bytes += (received - bytes.len()) as u64;
            sent.seconds += begun.elapsed().as_secs_f64();
        });
        Ok(parts)
    }

    /// Whether one of the processes is asked to stop; if so, all are from now on.
    fn agree_on_stop(&self) -> Result<bool> {
        let begun = Instant::now();
        let stops = self.any_stops()?;
        self.count(|traffic| {
            traffic.steps += 1;
            traffic.of_steps.seconds += begun.elapsed().as_secs_f64();
        });
        Ok(stops)
    }

    /// The same, not counted as a step.
    pub(crate) fn any_stops(&self) -> Result<bool> {
        let stops = self.communicator.all_any(is_asked_to_stop())?;
        if stops {
            self.stop_all();
        }
        Ok(stops)
    }

    /// Makes this process one of those that are stopping, as all others know of themselves.
    fn stop_all(&self) {
        self.stopped.store(true, Ordering::Relaxed);
        begin_to_stop(StopSignal::Terminate);
    }

    /// Whether all processes have stopped at the same place.
    pub fn have_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    /// Waits until all processes are here.
    ///
    /// # Errors
    /// If another one is gone.
    pub fn meet(&self) -> Result<()> {
        self.communicator.all_any(false).map(|_| ())
    }

    /// The number that each process gives, by rank.
    ///
    /// # Errors
    /// If another one is gone.
    pub fn numbers(&self, number: u64) -> Result<Vec<u64>> {
        let parts = self.communicator.all_gather(&number.to_le_bytes())?;
        let number =
            |bytes: Vec<u8>| bytes.try_into().map(u64::from_le_bytes).map_err(|_| broken(OTHER_DATA));
        parts.into_iter().map(number).collect()
    }

    /// Checks that all processes say the same of each thing, which is named.
    ///
    /// # Errors
    /// [`Error::Usage`] in all of them that names the first thing of which they do not; if another one is gone.
    pub(crate) fn agree(&self, things: &[(&str, String)]) -> Result<()> {
        for (name, said) in things {
            let all = self.communicator.all_gather(said.as_bytes())?;
            if let Some(other) = all.iter().find(|other| **other != all[0]) {
                let [first, other] = [&all[0], other].map(|said| String::from_utf8_lossy(said).into_owned());
                let problem = format!("the processes of this run have different {name}: {first} and {other}");
                return Err(Error::usage(problem, AGREE));
            }
        }
        Ok(())
    }

    /// What was sent since this was called last.
    pub fn take_traffic(&self) -> Traffic {
        std::mem::take(&mut *self.traffic.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn count(&self, add: impl FnOnce(&mut Traffic)) {
        add(&mut self.traffic.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

impl fmt::Debug for Ranks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "rank {} of {}", self.rank(), self.size())
    }
}

/// Two are the same if they talk through the same communicator.
impl PartialEq for Ranks {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.communicator, &other.communicator)
    }
}

/// The items of a process among `count`: whole chunks, about as many for each.
pub fn share(count: usize, chunk: usize, rank: usize, size: usize) -> Range<usize> {
    let border = |rank: usize| (count.div_ceil(chunk) * rank / size * chunk).min(count);
    border(rank)..border(rank + 1)
}

/// Whether the processes stop after this step; called once a step by each. Without several processes nothing is said.
pub(crate) fn agree_on_stop(world: &World) -> Result<bool> {
    world.get_resource::<Ranks>().map_or(Ok(false), Ranks::agree_on_stop)
}

/// [`check_interrupted`], on which all `ranks` agree: none goes on to divided work that another has left.
pub(crate) fn check_interrupted_together(ranks: Option<&Ranks>) -> Result<()> {
    if let Some(ranks) = ranks {
        ranks.any_stops()?;
    }
    check_interrupted()
}

/// The error of a process that others have left, or that has got something unexpected.
fn broken(problem: impl Into<String>) -> Error {
    Error::run("work of several processes", problem)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ranks::packed::divided;
    use crate::ranks::threads::ThreadRank;
    use glam::Vec3;

    #[test]
    fn shares_are_whole_chunks_of_all_items() {
        assert_eq!([0, 1].map(|rank| share(1024, 256, rank, 2)), [0..512, 512..1024]);
        assert_eq!([0, 1, 2].map(|rank| share(1000, 256, rank, 3)), [0..256, 256..512, 512..1000]);
        assert_eq!([0, 1, 2].map(|rank| share(100, 256, rank, 3)), [0..0, 0..0, 0..100]);
        assert_eq!([0, 1].map(|rank| share(0, 256, rank, 2)), [0..0, 0..0]);
    }

    #[test]
    fn lists_of_shares_are_those_of_one_process() {
        let list =
            |i: usize| -> Vec<Vec3> { (0..i % 4).map(|k| Vec3::new(i as f32, k as f32, 0.5)).collect() };
        let alone = divided(None, 11, list).unwrap();
        assert_eq!(alone[7], list(7));
        std::thread::scope(|scope| {
            for rank in ThreadRank::group(3) {
                scope.spawn(|| {
                    let ranks = Ranks::new(Arc::new(rank));
                    assert_eq!(divided(Some(&ranks), 11, list).unwrap(), alone);
                });
            }
        });
    }

    #[test]
    fn what_processes_do_not_agree_on_is_told_by_all() {
        std::thread::scope(|scope| {
            for rank in ThreadRank::group(3) {
                scope.spawn(|| {
                    let ranks = Ranks::new(Arc::new(rank));
                    let same = ("seeds", "7".to_owned());
                    ranks.agree(std::slice::from_ref(&same)).unwrap();
                    let threads = ("threads", (4 + ranks.rank() / 2).to_string());
                    let told = ranks.agree(&[same, threads]).unwrap_err().to_string();
                    assert!(told.ends_with("different threads: 4 and 5"), "{told}");
                    assert_eq!(ranks.numbers(10 + ranks.rank() as u64).unwrap(), [10, 11, 12]);
                });
            }
        });
    }

    #[test]
    fn a_column_of_shares_is_completed_by_all() {
        let value = |i: usize| Vec3::new(i as f32, 0.5, -1.0);
        std::thread::scope(|scope| {
            for rank in ThreadRank::group(3) {
                scope.spawn(move || {
                    let ranks = Ranks::new(Arc::new(rank));
                    let (mut floats, mut bytes) = (vec![Vec3::ZERO; 50], vec![0u8; 2 * 50]);
                    for i in ranks.share(50, 4) {
                        floats[i] = value(i);
                        bytes[2 * i..2 * i + 2].copy_from_slice(&[i as u8, 7]);
                    }
                    ranks.complete(&mut floats, 4).unwrap();
                    ranks.complete_bytes(&mut bytes, 2, 4).unwrap();
                    assert!(floats.iter().enumerate().all(|(i, found)| *found == value(i)));
                    assert!(bytes.chunks(2).enumerate().all(|(i, found)| found == [i as u8, 7]));
                    let traffic = ranks.take_traffic();
                    assert!(traffic.of_shares.bytes > 300 && traffic.of_steps.bytes == 0);
                });
            }
        });
    }
}
