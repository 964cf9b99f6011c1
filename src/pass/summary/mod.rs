//! `OUT/report.html`: what is in the folder of a run, as one page. It is made of the run's files alone, so that the report of a run that goes
//! on, of one that ended, and of several side by side are made in the same way.
//!
//! | module | holds |
//! | --- | --- |
//! | `pictures` | pictures of the folder as `data:` addresses, within a budget |
//! | `outcome` | a run in a row |
//! | `findings` | lights, textures and what the fits found |

mod findings;
mod outcome;
mod pictures;

pub use outcome::{Outcome, read_outcome};

use crate::codec::file::{MOST_TEXT, is_there, read_text, write_bytes};
use crate::error::{Error, Result};
use crate::pass::evaluate::PARTS;
use crate::pass::files::RUN;
use crate::pass::record::{PassRecord, Record, RunState};
use crate::pass::session::METRICS;
use crate::report::html::data::{FitLog, PassReport, PassViews, RunReport, ViewReport};
use crate::report::html::{REPORT, html};
use crate::report::scores::Scores;
use crate::report::sheet::choose_evenly;
use crate::scene::fields::fields;
use findings::{findings, fit_pictures};
use outcome::read_scores;
use pictures::Pictures;
use std::collections::BTreeSet;
use std::path::Path;

/// Bytes of `data:` addresses in the report of one run, at most: with them it stays below 10 MB.
const BUDGET: usize = 9_000_000;
/// Views that are shown of a pass without scores, and their longer side in pixels.
const UNSCORED_VIEWS: usize = 12;
const UNSCORED_SIDE: u32 = 320;

/// Writes the report of a run again and again, and keeps the pictures in between.
#[derive(Default)]
pub(crate) struct Reporter {
    pictures: Pictures,
}

impl Reporter {
    /// Writes `OUT/report.html`.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be written; what can be read of the folder is in it.
    pub fn write(&mut self, out: &Path) -> Result<()> {
        let record =
            Record::read(out).ok_or_else(|| Error::run("the report", format!("{RUN} cannot be read")))?;
        let scores = read_scores(out).unwrap_or_default();
        let report = gather(out, &record, scores, &mut self.pictures);
        write_bytes(&out.join(REPORT), html(&[report])?.as_bytes())
    }
}

/// What the report of a run in `out` shows, from its files.
///
/// # Errors
/// [`Error::Usage`] if `out` is not a folder of a run whose record this version reads, or no pass of it has ended; [`Error::Input`] if its
/// scores cannot be read.
pub fn read_run(out: &Path) -> Result<RunReport> {
    let shown = out.display();
    let refuse = |problem: String, help: &str| Err(Error::usage(problem, help));
    if !out.is_dir() {
        let what = if is_there(out) { "is not a folder" } else { "is not there" };
        return refuse(format!("{shown} {what}"), "Give the output folder of a run.");
    }
    let Some(record) = Record::read(out) else {
        return match is_there(&out.join(RUN)) {
            false => refuse(
                format!("{shown} is not the folder of a run: it has no {RUN}"),
                "Give the output folder of a run.",
            ),
            true => refuse(
                format!("{} was not written by this version of lobelia", out.join(RUN).display()),
                "Run the scene again, with this version.",
            ),
        };
    };
    if !is_there(&out.join(METRICS)) {
        let help = "Run the scene until a pass has ended; `lobelia run` writes a report after each.";
        return refuse(format!("{shown} has no {METRICS}: no pass of the run has ended"), help);
    }
    let scores = read_scores(out)?;
    Ok(gather(out, &record, scores, &mut Pictures::default()))
}

/// All that there is of a run. What cannot be read is left out: a run may have been stopped anywhere, and its files moved.
fn gather(out: &Path, record: &Record, scores: Scores, pictures: &mut Pictures) -> RunReport {
    pictures.begin(BUDGET);
    let is_fit = |pass: &&PassRecord| pass.files.contains(&format!("{}/log.csv", pass.name));
    let fits: Vec<&str> = record.passes.iter().filter(is_fit).map(|pass| pass.name.as_str()).collect();
    let logs = fits.iter().filter_map(|fit| read_log(out, fit)).collect();
    let shown = fits.iter().flat_map(|fit| fit_pictures(out, fit, pictures)).collect();
    let findings = findings(out, &fits, &scores);
    let mut views = scored_views(out, record, &scores, pictures);
    views.extend(unscored_views(out, record, &scores, pictures));
    RunReport {
        name: name_of(out),
        state: record.state.word().to_owned(),
        error: record.error.clone(),
        facts: facts(record),
        fields: fields(&record.scene_text),
        scene_text: record.scene_text.clone(),
        said: record.said.clone(),
        passes: record.passes.iter().map(pass_report).collect(),
        logs,
        pictures: shown,
        views,
        findings,
        scores,
    }
}

/// The name of a folder, also of one that is given as `.`.
fn name_of(out: &Path) -> String {
    let full = out.canonicalize().unwrap_or_else(|_| out.to_owned());
    full.file_name().map_or_else(|| "run".to_owned(), |name| name.to_string_lossy().into_owned())
}

fn facts(record: &Record) -> Vec<(String, String)> {
    let facts = [
        ("program", Some(format!("lobelia {}", record.version))),
        ("scene file", Some(record.scene.clone())),
        ("arguments", (!record.arguments.is_empty()).then(|| record.arguments.join(" "))),
        ("seed", record.seed.map(|seed| seed.to_string())),
        ("machine", record.machine.as_ref().map(|machine| machine.words())),
    ];
    facts.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
}

fn pass_report(pass: &PassRecord) -> PassReport {
    PassReport {
        name: pass.name.clone(),
        state: pass.state.word().to_owned(),
        secs: pass.secs,
        peak_rss_mib: pass.peak_rss_mib,
        said: pass.said.clone(),
    }
}

/// The log of a fit; `None` if there is none that can be read.
fn read_log(out: &Path, pass: &str) -> Option<FitLog> {
    let text = read_text(&out.join(pass).join("log.csv"), MOST_TEXT, |_| String::new()).ok()?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let mut columns: Vec<(String, Vec<f64>)> =
        reader.headers().ok()?.iter().map(|name| (name.to_owned(), Vec::new())).collect();
    for row in reader.records() {
        for ((_, values), entry) in columns.iter_mut().zip(row.ok()?.iter()) {
            values.push(entry.parse().unwrap_or(f64::NAN));
        }
    }
    Some(FitLog { pass: pass.to_owned(), columns })
}

/// The views of the passes that have scores, with the pictures that `Evaluate` made; the worst views first, in turn over the passes, as far as the budget goes.
fn scored_views(out: &Path, record: &Record, scores: &Scores, pictures: &mut Pictures) -> Vec<PassViews> {
    let mut passes: Vec<PassViews> = Vec::new();
    let mut orders: Vec<(String, Vec<&str>)> = Vec::new();
    for (name, scored) in &scores.passes {
        // The last pass that scores it is the one whose scores count.
        let folder = |pass: &&PassRecord| {
            let start = format!("{}/{name}/", pass.name);
            pass.files.iter().any(|file| file.starts_with(&start) && file.ends_with(".jpg"))
        };
        let Some(evaluate) = record.passes.iter().rev().find(folder) else { continue };
        let mut order: Vec<_> = scored.views.iter().collect();
        order.sort_by(|a, b| a.psnr.total_cmp(&b.psnr));
        orders.push((
            format!("{}/{name}", evaluate.name),
            order.iter().map(|view| view.name.as_str()).collect(),
        ));
        passes.push(PassViews { pass: name.clone(), ..PassViews::default() });
    }
    let most = orders.iter().map(|(_, views)| views.len()).max().unwrap_or(0);
    for rank in 0..most {
        for ((folder, order), pass) in orders.iter().zip(&mut passes) {
            let Some(name) = order.get(rank) else { continue };
            let mut part =
                |k: usize| pictures.file(&out.join(folder).join(format!("{name}_{}.jpg", PARTS[k])));
            let [truth, render, error] = [part(0), part(1), part(2)];
            if render.is_some() {
                pass.views.push(ViewReport { name: (*name).to_owned(), truth, render, error });
            } else {
                pass.left_out += 1;
            }
        }
    }
    passes
}

/// A few views of the passes that rendered and have no scores.
fn unscored_views(out: &Path, record: &Record, scores: &Scores, pictures: &mut Pictures) -> Vec<PassViews> {
    let rendered = record.passes.iter().filter_map(|pass| {
        let stems = stems_of(pass);
        let counts =
            pass.state == RunState::Finished && !stems.is_empty() && !scores.passes.contains_key(&pass.name);
        counts.then_some((pass, stems))
    });
    let mut views = Vec::new();
    for (pass, stems) in rendered {
        let chosen = choose_evenly(stems.len(), UNSCORED_VIEWS);
        let mut of_pass = PassViews {
            pass: pass.name.clone(),
            left_out: stems.len() - chosen.len(),
            ..PassViews::default()
        };
        for stem in chosen.into_iter().map(|i| stems[i]) {
            match pictures.small(&out.join(&pass.name).join(format!("{stem}.png")), UNSCORED_SIDE) {
                Some(address) => of_pass.views.push(ViewReport {
                    name: stem.to_owned(),
                    render: Some(address),
                    ..ViewReport::default()
                }),
                None => of_pass.left_out += 1,
            }
        }
        views.push(of_pass);
    }
    views
}

/// The views that a pass rendered, each an EXR and a PNG. A fit writes such pairs as well, with its light.
fn stems_of(pass: &PassRecord) -> Vec<&str> {
    let start = pass.name.len() + 1;
    let files: BTreeSet<&str> = pass.files.iter().filter_map(|file| file.get(start..)).collect();
    let stems = files.iter().filter_map(|file| file.strip_suffix(".png"));
    let is_view = |stem: &&str| !stem.contains('/') && files.contains(format!("{stem}.exr").as_str());
    if files.contains("light.npy") { Vec::new() } else { stems.filter(is_view).collect() }
}

#[cfg(test)]
mod tests;
