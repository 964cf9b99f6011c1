//! `lobelia report`: a run, or several side by side, as one page.

use super::output_checks::refuse_foreign;
use super::report_args::ReportArgs;
use super::terminal::print;
use lobelia::codec::file::write_bytes;
use lobelia::jobs::unit::UnitRow;
use lobelia::jobs::{list, merge};
use lobelia::pass::summary::read_run;
use lobelia::report::html::data::RunReport;
use lobelia::report::html::{REPORT, SIGNATURE, html};
use lobelia::{Error, Result};
use std::fmt::Write as _;
use std::path::{Component, Path, PathBuf};

/// Runs the command.
pub fn run(args: &ReportArgs) -> Result<()> {
    let page = match (&args.out, args.runs.as_slice()) {
        (Some(out), _) => out.clone(),
        (None, [run]) => run.join(REPORT),
        (None, _) => PathBuf::from(REPORT),
    };
    refuse_foreign(&page, SIGNATURE)?;
    if page.is_dir() {
        let problem = format!("--out {}: it is a folder", page.display());
        return Err(Error::usage(problem, "Give the file to write, as --out report.html."));
    }
    if let ([out], Some(_)) = (args.runs.as_slice(), &args.jobs)
        && !out.is_dir()
    {
        let problem = format!("{}: there is no such folder: no unit has begun", out.display());
        return Err(Error::usage(
            problem,
            "Give the folder that units write into, as `lobelia run --only UNIT --out`.",
        ));
    }
    if let [out] = args.runs.as_slice()
        && !out.join("run.json").exists()
        && out.is_dir()
        && let units @ [_, ..] = units(out, args)?.as_slice()
    {
        return write_units(out, &page, units.to_vec());
    }
    if args.jobs.is_some() {
        let problem = "--jobs belongs to a folder of units, and this is one of runs";
        return Err(Error::usage(
            problem,
            "Give the one folder into which units write, as `lobelia report out --jobs objects.csv`.",
        ));
    }
    let mut runs: Vec<RunReport> = args.runs.iter().map(|run| read_run(run)).collect::<Result<_>>()?;
    name_apart(&mut runs, &args.runs);
    let text = html(&runs)?;
    write_bytes(&page, text.as_bytes())?;
    print(&format!("{}: {:.1} MiB\n", page.display(), text.len() as f64 / 1_048_576.0))
}

/// The units whose folders are in `out`, and those of the jobs that have none.
fn units(out: &Path, args: &ReportArgs) -> Result<Vec<UnitRow>> {
    let named = args.jobs.as_ref().map(|jobs| list(jobs, args.data.as_deref(), args.frames)).transpose()?;
    merge::units(out, &named.unwrap_or_default())
}

/// What many units have come to. All is written before the error of a film that cannot be read.
fn write_units(out: &Path, page: &Path, units: Vec<UnitRow>) -> Result<()> {
    let merged = merge::merge(out, units)?;
    write_bytes(page, merged.page.as_bytes())?;
    let mut text = merged.words + "\n";
    for film in &merged.films {
        let _ = writeln!(text, "{}: {}", film.file.display(), film.words());
    }
    let _ = writeln!(text, "{}, {}", page.display(), out.join(merge::UNITS).display());
    print(&text)?;
    match merged.films.into_iter().find(|film| film.is_unreadable) {
        Some(film) => Err(Error::run(film.file.display().to_string(), film.words())),
        None => Ok(()),
    }
}

/// Folders of one name are called by as much of their paths as tells them apart.
fn name_apart(runs: &mut [RunReport], paths: &[PathBuf]) {
    let parts: Vec<Vec<String>> = paths.iter().map(|path| parts(path)).collect();
    let most = parts.iter().map(Vec::len).max().unwrap_or(0);
    for length in 2..=most {
        let names: Vec<String> = runs.iter().map(|run| run.name.clone()).collect();
        for (i, run) in runs.iter_mut().enumerate() {
            let is_shared = names.iter().filter(|name| **name == names[i]).count() > 1;
            if is_shared && parts[i].len() >= length {
                run.name = parts[i][parts[i].len() - length..].join("/");
            }
        }
    }
}

fn parts(path: &Path) -> Vec<String> {
    let full = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let normal = full.components().filter_map(|part| match part {
        Component::Normal(name) => Some(name.to_string_lossy().into_owned()),
        _ => None,
    });
    normal.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_one_name_are_told_apart() {
        let paths = ["/a/one/spot", "/a/two/spot", "/a/other"].map(PathBuf::from);
        let named = |name: &str| RunReport { name: name.into(), ..RunReport::default() };
        let mut runs = [named("spot"), named("spot"), named("other")];
        name_apart(&mut runs, &paths);
        assert_eq!(runs.map(|run| run.name), ["one/spot", "two/spot", "other"]);
    }
}
