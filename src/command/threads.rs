//! How many threads work.

use clap::Args;
use lobelia::{Error, Result};

/// How many threads work.
#[derive(Args, Clone, Copy, Debug)]
pub struct ThreadArgs {
    /// Worker threads, 1 to 1024 [default: one per processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// Starts as many worker threads as asked for; without a number, one per processor, or what `RAYON_NUM_THREADS` says.
pub fn start_threads(args: ThreadArgs) -> Result<()> {
    let started =
        rayon::ThreadPoolBuilder::new().num_threads(args.threads.map_or(0, usize::from)).build_global();
    started.map_err(|error| {
        let problem = format!("worker threads cannot be started: {error}");
        Error::usage(problem, "Raise the limit of processes (ulimit -u), or ask for fewer threads: --threads, or RAYON_NUM_THREADS.")
    })
}
