//! `lobelia report`: a run as a page, or several side by side as a table, as CSV, or as one page;
//! and `lobelia eval`: pictures compared.

use super::{start::refuse_foreign, terminal::print};
use clap::Args;
use lobelia::pass::summary::{csv_of_runs, read_run, table_of_runs};
use lobelia::report::html::{REPORT, SIGNATURE, html};
use lobelia::{Error, Result, codec::file::write_bytes, report::compare::compare, report::scores::Scaling};
use std::{collections::HashSet, path::PathBuf};

/// Sets runs side by side, by their scores, times and states: a table on the terminal, or CSV with
/// --csv.
///
/// Of one run it writes the page that `lobelia run` writes into OUT/report.html after every pass.
/// With --out it writes one page of 1 to 8 runs, which needs nothing else, no server and no
/// network: the scores with the differences from the first run, the same views of all runs under
/// one wipe, their curves in one chart, and the values in which their scene files differ.
#[derive(Args, Debug)]
#[command(
    about = "Write a page that shows a run, or sets several side by side: scores, views, curves",
    verbatim_doc_comment
)]
pub struct ReportArgs {
    /// The output folders of runs; the first one is what the others are compared with
    #[arg(value_name = "OUT", required = true)]
    runs: Vec<PathBuf>,
    /// Write one page of 1 to 8 runs to this file [default of a single run: OUT/report.html]
    #[arg(long, value_name = "FILE", conflicts_with = "csv")]
    out: Option<PathBuf>,
    /// Write the table as CSV to standard output, and nothing else
    #[arg(long)]
    csv: bool,
}

/// Compare two images, or the images of two folders by name: PSNR and SSIM in linear light
#[derive(Args, Debug)]
pub struct EvalArgs {
    /// An image, or a folder of images
    prediction: PathBuf,
    /// The reference: an image, or a folder with images of the same names
    truth: PathBuf,
    /// Take out one least-squares factor per channel, shared by all images, before scoring
    #[arg(long)]
    scale: bool,
}

/// Compares two images, or the images of two folders.
pub fn eval(args: &EvalArgs) -> Result<()> {
    let scaling = if args.scale { Scaling::PerChannel } else { Scaling::None };
    print(&compare(&args.prediction, &args.truth, scaling)?.table())
}

/// Runs `lobelia report`.
pub fn run(args: &ReportArgs) -> Result<()> {
    let page = match (&args.out, args.runs.as_slice()) {
        (Some(out), _) => out.clone(),
        (None, [run]) if !args.csv => run.join(REPORT),
        _ => {
            let names = names_apart(&args.runs);
            let runs: Vec<_> = names.into_iter().zip(args.runs.iter().map(PathBuf::as_path)).collect();
            return print(&if args.csv { csv_of_runs(&runs) } else { table_of_runs(&runs) });
        }
    };
    refuse_foreign(&page, SIGNATURE)?;
    if page.is_dir() {
        let problem = format!("--out {}: it is a folder", page.display());
        return Err(Error::usage(problem, "Give the file to write, as --out report.html."));
    }
    let mut runs = args.runs.iter().map(|run| read_run(run)).collect::<Result<Vec<_>>>()?;
    for (run, name) in runs.iter_mut().zip(names_apart(&args.runs)) {
        run.name = name;
    }
    let text = html(&runs)?;
    write_bytes(&page, text.as_bytes())?;
    print(&format!("{}: {:.1} MiB\n", page.display(), text.len() as f64 / 1_048_576.0))
}

/// The names of folders, or their paths if two have one name.
fn names_apart(paths: &[PathBuf]) -> Vec<String> {
    let name = |path: &PathBuf| {
        let full = path.canonicalize().unwrap_or_else(|_| path.clone());
        full.file_name().unwrap_or_default().to_string_lossy().into_owned()
    };
    let names: Vec<String> = paths.iter().map(name).collect();
    let are_apart = names.iter().collect::<HashSet<_>>().len() == names.len();
    if are_apart { names } else { paths.iter().map(|path| path.display().to_string()).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_one_name_are_told_apart() {
        let paths = ["one/spot", "two/spot", "other"].map(PathBuf::from);
        assert_eq!(names_apart(&paths), ["one/spot", "two/spot", "other"]);
        assert_eq!(names_apart(&paths[1..]), ["spot", "other"]);
    }
}
