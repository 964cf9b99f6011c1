//! `lobelia list`: the units of many objects or frames.

use super::terminal::print;
use clap::Args;
use lobelia::jobs::list;
use lobelia::jobs::unit::Unit;
use lobelia::{Error, Result};
use std::path::PathBuf;

/// The long help.
pub const LIST_LONG: &str = "\
Names the units of many objects, or of the frames of films, a line each: what a scheduler shares out over machines.

JOBS is a folder of scene files, a table objects.csv (columns `scene`, `data`, `name`, and values of the scene file by
their paths), or a scene file whose passes make films. `lobelia run JOBS --only UNIT --out OUT` does one unit in
OUT/UNIT. It knows nothing of the others: units run in any order, at once, on any machine. One that was killed goes
on, one that has finished is left as it is. `lobelia report OUT` then says what all have come to, in OUT/report.html
and OUT/units.csv, and joins the films whose frames are all there.";

/// Examples of schedulers.
pub const LIST_EXAMPLES: &str = "\
Examples:
  lobelia list objects.csv | xargs -P 4 -d '\\n' -I {} lobelia run objects.csv --only {} --out out --threads 2 --quiet
      Four at a time on one machine; also by GNU parallel or make -j (examples/jobs/Makefile).
  sbatch --array=1-$(lobelia list objects.csv | wc -l) examples/jobs/slurm.sh objects.csv out
      A Slurm array, a unit a task.
  lobelia list turn.ron --frames 24 --json
      The film of turn.ron in parts of 24 frames, with what each unit is, for a program.";

/// `lobelia list`.
#[derive(Args, Debug)]
pub struct ListArgs {
    /// A folder of scene files, a table objects.csv, or the scene file of a film
    #[arg(value_name = "JOBS")]
    pub jobs: PathBuf,
    /// The folder that $DATA stands for, where a table does not say it
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Frames of a film in a unit
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub frames: u32,
    /// What each unit is, as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn run(args: &ListArgs) -> Result<()> {
    let units = list(&args.jobs, args.data.as_deref(), args.frames)?;
    let text = if args.json {
        let json = serde_json::to_string_pretty(&units);
        json.map_err(|error| Error::run("writing the units as JSON", error.to_string()))? + "\n"
    } else {
        units.iter().map(|Unit { name, .. }| format!("{name}\n")).collect()
    };
    print(&text)
}
