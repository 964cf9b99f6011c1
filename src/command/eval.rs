//! `lobelia eval`: two images, or the images of two folders, compared.

use super::args::EvalArgs;
use super::terminal::print;
use lobelia::Result;
use lobelia::report::compare::compare;
use lobelia::report::scores::Scaling;

/// Runs the command.
pub fn run(args: &EvalArgs) -> Result<()> {
    let scaling = if args.scale { Scaling::PerChannel } else { Scaling::None };
    let comparison = compare(&args.prediction, &args.truth, scaling)?;
    print(&comparison.table())
}
