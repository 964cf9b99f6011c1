//! How many threads work.

use super::args::ThreadArgs;
use lobelia::{Error, Result};

/// Starts as many worker threads as asked for; without a number, rayon starts one per processor by itself.
pub fn start_threads(args: ThreadArgs) -> Result<()> {
    let Some(threads) = args.threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(usize::from(threads))
        .build_global()
        .map_err(|error| Error::run("starting threads", error.to_string()))
}
