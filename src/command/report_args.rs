//! What can be typed after `lobelia report`.

use clap::Args;
use std::path::PathBuf;

/// The long help.
pub const REPORT_LONG: &str = "\
Writes one HTML page that shows a run, or sets several side by side, and needs nothing else, no server and no network.

`lobelia run` writes the page of its own run, OUT/report.html, after every pass. Of several runs the page has the
scores in one table with the differences from the first one, the same views of all runs under one wipe, their curves
in one chart, and the values in which their scene files differ.

Of a folder of units (`lobelia list`) the page has a row for each, beside units.csv; films whose frames are all there
are joined. With --jobs it has a row also for each unit that has not begun.";

/// `lobelia report`.
#[derive(Args, Debug)]
pub struct ReportArgs {
    /// The output folder of units, or those of 1 to 8 runs; the first one is what the others are compared with
    #[arg(value_name = "OUT", required = true, num_args = 1..=8)]
    pub runs: Vec<PathBuf>,
    /// The file to write [default: report.html, in the folder of the run if it is only one]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// What OUT has the units of, as given to `lobelia list`: those that have not begun are shown too
    #[arg(long, value_name = "JOBS")]
    pub jobs: Option<PathBuf>,
    /// The folder that $DATA stands for in JOBS, where a table does not say it
    #[arg(long, value_name = "DIR", requires = "jobs")]
    pub data: Option<PathBuf>,
    /// Frames of a film in a unit
    #[arg(long, value_name = "N", requires = "jobs", default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub frames: u32,
}
