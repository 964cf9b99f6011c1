//! `lobelia new`: a commented scene file for a data set.

use super::prepare_args::NewArgs;
use super::terminal::print;
use lobelia::codec::file::write_bytes;
use lobelia::prepare::scene_file::scene_for;
use lobelia::{Error, Result};

/// Runs the command.
pub fn run(args: &NewArgs) -> Result<()> {
    if args.out.symlink_metadata().is_ok() {
        let problem = format!("{} exists", args.out.display());
        return Err(Error::usage(problem, "Choose another name with --out, or remove it."));
    }
    let text = scene_for(&args.data, args.layout, &args.out)?;
    write_bytes(&args.out, text.as_bytes())?;
    let next =
        if text.contains("$DATA") { format!(" --data {}", args.data.display()) } else { String::new() };
    print(&format!("{} is written\nnext: lobelia check {}{next}\n", args.out.display(), args.out.display()))
}
