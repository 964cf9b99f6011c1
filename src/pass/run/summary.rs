//! `OUT/report.html`: what is in the folder of a run, as one page, and runs in a table. Both are
//! made of the run's files alone, so that the report of a run that goes on, of one that ended, and
//! of several side by side are made in the same way.

use crate::object::view_report::csv_entry;
use crate::pass::fit::{TRUE_ENVIRONMENT, light_files};
use crate::pass::run::record::Record;
use crate::pass::{evaluate::PARTS, run::METRICS, view::embedded};
use crate::report::html::{
    FitFinding, FitLog, PassViews, REPORT, ReportPicture, RunReport, ViewReport, html,
};
use crate::report::{PassRecord, RunState, scores::Scores, scores::aligned};
use crate::{object::fit::StepLog, progress::Step};
use crate::{pass::run::preflight::RUN, report::sheet::choose_evenly, scene::fields};
use bevy_ecs::prelude::{Entity, World};
use image::{Rgb, RgbImage, RgbaImage};
use indexmap::{IndexMap, IndexSet};
use lobelia_geometry::{error::Error, error::Result, view::ViewIndex, view::ViewName};
use lobelia_io::codec::file::{MOST_TEXT, is_there, read_text, read_up_to, write_bytes};
use lobelia_io::codec::image::decode;
use lobelia_io::codec::tone::{MAT, jpeg_address, thumbnail_jpeg};
use lobelia_sg::color::srgb_from_linear;
use lobelia_solve::fit::loss::sums_of_step;
use lobelia_world::material::SpecularLobe;
use std::collections::{BTreeMap, BTreeSet};
use std::{path::Path, path::PathBuf, time::Duration, time::Instant};

/// Bytes of `data:` addresses in the report of one run, at most: with them it stays below 10 MB.
const BUDGET: usize = 9_000_000;
/// Bytes of a picture that is taken as it is, and of one that is made smaller, at most.
const MOST_SMALL_BYTES: u64 = 1 << 20;
const MOST_BYTES: u64 = 256 << 20;
/// Longer side of pictures of lights and textures, in pixels.
const TEXTURE_SIDE: u32 = 512;
/// Views that are shown of a pass without scores, and their longer side in pixels.
const UNSCORED_VIEWS: usize = 12;
const UNSCORED_SIDE: u32 = 320;
/// Time between two pages of a run that is watched.
const RELOAD: Duration = Duration::from_secs(5);
/// Training views that these show, the worst, and the longer side of their photographs in pixels.
const WORST: usize = 4;
const WORST_SIDE: u32 = 320;

/// The pictures that a fit writes beside those of lights, and what they show.
const PICTURES: [(&str, &str); 5] = [
    (TRUE_ENVIRONMENT, "true light"),
    ("albedo.png", "albedo"),
    ("blend.png", "weights of the base materials"),
    ("roughness.png", "roughness"),
    ("seen.png", "texels that are seen"),
];

/// Writes the report of a run again and again, and keeps the pictures in between.
#[derive(Default)]
pub(crate) struct Reporter {
    pictures: Pictures,
    /// The time of the last page, if the run is watched.
    written: Option<Instant>,
}

impl Reporter {
    /// A reporter; if the run is watched (`live`), its pages load themselves again until it ends.
    pub fn new(live: bool) -> Self {
        Self { written: live.then(Instant::now), ..Self::default() }
    }

    /// Now and then writes a page with the curves and worst views of the fit or shape at work, if
    /// the run is watched.
    pub fn step(&mut self, out: &Path, at: &Step, world: &mut World) {
        if self.written.is_none_or(|written| written.elapsed() < RELOAD) {
            return;
        }
        let log = world.get_resource::<StepLog>().and_then(|log| parse_log(at.pass, &log.0));
        // A page that cannot be written is no reason to lose the run; the pass writes it again at
        // its end.
        let _ = self.write_with(out, |run| {
            run.logs.extend(log);
            run.views.insert(0, worst_views(world));
        });
        self.written = Some(Instant::now());
    }

    /// Writes `OUT/report.html`.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be written; what can be read of the folder is in it.
    pub fn write(&mut self, out: &Path) -> Result<()> {
        self.write_with(out, |_| ())
    }

    fn write_with(&mut self, out: &Path, add: impl FnOnce(&mut RunReport)) -> Result<()> {
        let record =
            Record::read(out).ok_or_else(|| Error::run("report", format!("{RUN} cannot be read")))?;
        let scores = read_scores(out).unwrap_or_default();
        let mut report = gather(out, &record, scores, &mut self.pictures);
        add(&mut report);
        let is_live = self.written.is_some() && record.state == RunState::Running;
        report.reload_secs = is_live.then_some(RELOAD.as_secs());
        write_bytes(&out.join(REPORT), html(&[report])?.as_bytes())
    }
}

/// The photographs that the last step of a fit explains worst, each named with its PSNR.
fn worst_views(world: &mut World) -> PassViews {
    let sums = world.run_system_cached(sums_of_step).ok().and_then(|sums| sums.ok()).unwrap_or_default();
    let mut query = world.query::<(Entity, &ViewIndex, &ViewName)>();
    let view = |(view, index, name): (Entity, &ViewIndex, &ViewName)| {
        Some((sums.of(*index).psnr()?, view, name.0.clone()))
    };
    let mut views: Vec<(f64, Entity, String)> = query.iter(world).filter_map(view).collect();
    views.sort_by(|a, b| a.0.total_cmp(&b.0));
    let shown = views.into_iter().take(WORST).map(|(psnr, entity, name)| {
        let photograph = embedded(world, entity, WORST_SIDE).ok().flatten();
        let truth = photograph.map(|photograph| photograph.address);
        ViewReport { name: format!("{name}, {psnr:.1} dB"), truth, ..ViewReport::default() }
    });
    let pass = "worst training views, by the pixels of the last step".to_owned();
    PassViews { pass, views: shown.collect(), left_out: 0 }
}

/// Reads the contents of the report of a run in `out` from its files.
///
/// # Errors
/// [`Error::Usage`] if `out` is not a folder of a run whose record this version reads, or no pass
/// of it has ended; [`Error::Input`] if its scores cannot be read.
pub fn read_run(out: &Path) -> Result<RunReport> {
    let shown = out.display();
    let refuse = |problem: String, help: &str| Err(Error::usage(problem, help));
    let Some(record) = Record::read(out) else {
        if is_there(&out.join(RUN)) {
            let problem = format!("{} was not written by this version of lobelia", out.join(RUN).display());
            return refuse(problem, "Run the scene again, with this version.");
        }
        let is = if out.is_dir() { "is not the folder of a run: it has no run.json" } else { "is not there" };
        return refuse(format!("{shown} {is}"), "Give the output folder of a run.");
    };
    if !is_there(&out.join(METRICS)) {
        let help = "Run the scene until a pass has ended; `lobelia run` writes a report after each.";
        return refuse(format!("{shown} has no {METRICS}: no pass of the run has ended"), help);
    }
    let scores = read_scores(out)?;
    Ok(gather(out, &record, scores, &mut Pictures::default()))
}

fn read_scores(out: &Path) -> Result<Scores> {
    let path = out.join(METRICS);
    let text = read_text(&path, MOST_TEXT, |_| String::new())?;
    serde_json::from_str(&text).map_err(|error| {
        let place = format!("line {}, column {}", error.line(), error.column());
        let problem = format!("is not the scores of a run of this version: {error}");
        Error::input(&path, place, problem, "Run the scene again, with this version.")
    })
}

/// Gathers all that there is of a run. Unreadable files are left out: a run may have been stopped
/// anywhere, and its files moved.
fn gather(out: &Path, record: &Record, scores: Scores, pictures: &mut Pictures) -> RunReport {
    pictures.left = BUDGET;
    let is_fit = |pass: &&PassRecord| pass.files.contains(&format!("{}/log.csv", pass.name));
    let fits: Vec<&str> = record.passes.iter().filter(is_fit).map(|pass| pass.name.as_str()).collect();
    let log = |fit: &&str| {
        let text = read_text(&out.join(fit).join("log.csv"), MOST_TEXT, |_| String::new()).ok()?;
        parse_log(fit, &text)
    };
    // Also of a folder that is given as `.`.
    let full = out.canonicalize().unwrap_or_else(|_| out.to_owned());
    let facts = [
        ("program", Some(format!("lobelia {}", record.start.version))),
        ("scene file", Some(record.scene.clone())),
        ("arguments", (!record.arguments.is_empty()).then(|| record.arguments.join(" "))),
        ("seed", record.seed.map(|seed| seed.to_string())),
        ("machine", record.machine.as_ref().map(|machine| machine.words())),
    ];
    // In the order in which they may spend the budget.
    let shown = fits.iter().flat_map(|fit| fit_pictures(out, fit, pictures)).collect();
    let mut views = scored_views(out, record, &scores, pictures);
    views.extend(unscored_views(out, record, &scores, pictures));
    RunReport {
        name: full.file_name().map_or("run".into(), |name| name.to_string_lossy().into_owned()),
        state: record.state.word(),
        error: record.error.clone(),
        facts: facts.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect(),
        fields: fields(&record.scene_text),
        scene_text: record.scene_text.clone(),
        said: record.said.clone(),
        passes: record.passes.clone(),
        logs: fits.iter().filter_map(log).collect(),
        pictures: shown,
        views,
        findings: findings(out, &fits, &scores),
        scores,
        reload_secs: None,
    }
}

/// The columns of a log; `None` if there are none.
fn parse_log(pass: &str, text: &str) -> Option<FitLog> {
    let mut lines = text.lines();
    let mut columns: Vec<(_, Vec<f64>)> = lines.next()?.split(',').map(|n| (n.to_owned(), vec![])).collect();
    for line in lines {
        for ((_, values), entry) in columns.iter_mut().zip(line.split(',')) {
            values.push(entry.parse().unwrap_or(f64::NAN));
        }
    }
    Some(FitLog { pass: pass.to_owned(), columns })
}

fn fit_pictures(out: &Path, pass: &str, pictures: &mut Pictures) -> Vec<ReportPicture> {
    let mut shown = |file: &str, title: &str| {
        let address = pictures.small(&out.join(pass).join(file), TEXTURE_SIDE)?;
        Some(ReportPicture { title: format!("{pass}: {title}"), address })
    };
    // As many as there are of groups of photographs.
    let light = |number: usize| {
        let of = if number == 1 { String::new() } else { format!(" {number}") };
        shown(&light_files(number)[2], &format!("recovered light{of}"))
    };
    let mut all: Vec<ReportPicture> = (1..).map_while(light).collect();
    all.extend(PICTURES.iter().filter_map(|(file, title)| shown(file, title)));
    all
}

/// The findings of the fits of these names, and of the scores, with words on how far they can be
/// trusted.
fn findings(out: &Path, fits: &[&str], scores: &Scores) -> Vec<FitFinding> {
    let plain = |what: &str, value: String| FitFinding { what: what.to_owned(), value, color: None };
    let mut found = Vec::new();
    if let Some(scale) = &scores.scale {
        let sure = match scale.rule.as_str() {
            "Known" => "",
            _ => " — photographs do not determine it: light and albedo are known up to this choice",
        };
        found.push(plain("scale between light and albedo", format!("{}{sure}", scale.rule)));
        found.push(colored("mean light".into(), scale.mean_light, ""));
        found.push(colored("mean albedo of seen texels".into(), scale.mean_albedo, ""));
    }
    let determined = scores.determined.and_then(|found| found.words());
    found.extend(determined.map(|words| plain("determined by the photographs", words)));
    found.extend(scores.warnings.iter().map(|warning| plain("warning", warning.clone())));
    for pass in fits {
        let path = out.join(pass).join("materials.ron");
        let text = read_text(&path, MOST_TEXT, |_| String::new()).unwrap_or_default();
        let lobes: Vec<SpecularLobe> = ron::from_str(&text).unwrap_or_default();
        for (number, lobe) in (1..).zip(&lobes) {
            let more = format!("; roughness {:.3}, distribution of normals {:?}", lobe.roughness, lobe.ndf);
            found.push(colored(format!("{pass}: specular albedo {number}"), lobe.albedo.to_array(), &more));
        }
    }
    found
}

/// A linear color, with its numbers.
fn colored(what: String, color: [f32; 3], more: &str) -> FitFinding {
    let [r, g, b] = color;
    let largest = color.into_iter().fold(1.0, f32::max);
    let shown = color.map(|c| (srgb_from_linear((c / largest).clamp(0.0, 1.0)) * 255.0).round() as u8);
    FitFinding { what, value: format!("{r:.3}, {g:.3}, {b:.3}{more}"), color: Some(shown) }
}

/// The views of the passes that have scores, with the pictures that `Evaluate` made; the worst
/// views first, in turn over the passes, as far as the budget goes.
fn scored_views(out: &Path, record: &Record, scores: &Scores, pictures: &mut Pictures) -> Vec<PassViews> {
    let mut passes: Vec<PassViews> = Vec::new();
    // Rank in its pass, number of the pass, folder and name of each view.
    let mut ranked: Vec<(usize, usize, PathBuf, &str)> = Vec::new();
    for (name, scored) in &scores.passes {
        // The last pass that scores it is the one whose scores count.
        let has_pictures = |pass: &&PassRecord| {
            let start = format!("{}/{name}/", pass.name);
            pass.files.iter().any(|file| file.starts_with(&start) && file.ends_with(".jpg"))
        };
        let Some(evaluate) = record.passes.iter().rev().find(has_pictures) else { continue };
        let mut views: Vec<_> = scored.views.iter().collect();
        views.sort_by(|a, b| a.psnr.total_cmp(&b.psnr));
        let folder = out.join(&evaluate.name).join(name);
        let places = views.iter().enumerate();
        ranked.extend(places.map(|(rank, view)| (rank, passes.len(), folder.clone(), view.name.as_str())));
        passes.push(PassViews { pass: name.clone(), ..PassViews::default() });
    }
    ranked.sort_by_key(|(rank, pass, ..)| (*rank, *pass));
    for (_, pass, folder, name) in ranked {
        let [truth, render, error] = PARTS.map(|p| pictures.file(&folder.join(format!("{name}_{p}.jpg"))));
        if render.is_some() {
            passes[pass].views.push(ViewReport { name: name.to_owned(), truth, render, error });
        } else {
            passes[pass].left_out += 1;
        }
    }
    passes
}

/// A few views of the passes that rendered and have no scores.
fn unscored_views(out: &Path, record: &Record, scores: &Scores, pictures: &mut Pictures) -> Vec<PassViews> {
    let mut views = Vec::new();
    for pass in record.passes.iter().filter(|pass| pass.state == RunState::Finished) {
        // The views that it rendered, each an EXR and a PNG. A fit writes such pairs as well, with
        // its light.
        let start = pass.name.len() + 1;
        let files: BTreeSet<&str> = pass.files.iter().filter_map(|file| file.get(start..)).collect();
        let is_view = |stem: &&str| !stem.contains('/') && files.contains(format!("{stem}.exr").as_str());
        let stems = files.iter().filter_map(|file| file.strip_suffix(".png")).filter(is_view);
        let stems: Vec<&str> = stems.filter(|_| !files.contains("light.npy")).collect();
        if stems.is_empty() || scores.passes.contains_key(&pass.name) {
            continue;
        }
        let view = |i: usize| {
            let path = out.join(&pass.name).join(format!("{}.png", stems[i]));
            let render = pictures.small(&path, UNSCORED_SIDE);
            let name = stems[i].to_owned();
            render.is_some().then(|| ViewReport { name, render, ..ViewReport::default() })
        };
        let shown: Vec<_> = choose_evenly(stems.len(), UNSCORED_VIEWS).into_iter().filter_map(view).collect();
        let left_out = stems.len() - shown.len();
        views.push(PassViews { pass: pass.name.clone(), views: shown, left_out });
    }
    views
}

/// The table of runs for the terminal; each has a name and its output folder.
pub fn table_of_runs(runs: &[(String, &Path)]) -> String {
    aligned(&rows(runs))
}

/// The table of runs as CSV, with a line of column names first.
pub fn csv_of_runs(runs: &[(String, &Path)]) -> String {
    let line = |row: &Vec<String>| row.iter().map(|of| csv_entry(of)).collect::<Vec<_>>().join(",") + "\n";
    rows(runs).iter().map(line).collect()
}

/// Column names, then a row per run; a score that a run does not have is empty.
fn rows(runs: &[(String, &Path)]) -> Vec<Vec<String>> {
    let rows: Vec<IndexMap<String, String>> = runs.iter().map(|(run, out)| row(run, out)).collect();
    let names: IndexSet<&String> = rows.iter().flat_map(IndexMap::keys).collect();
    let entries = |row: &IndexMap<String, String>| {
        names.iter().map(|name| row.get(*name).cloned().unwrap_or_default()).collect()
    };
    let head = names.iter().map(|name| (*name).clone()).collect();
    std::iter::once(head).chain(rows.iter().map(entries)).collect()
}

/// How far a run is, its time, memory and scores, by column.
fn row(run: &str, out: &Path) -> IndexMap<String, String> {
    let (record, scores) = (Record::read(out), read_scores(out).unwrap_or_default());
    let passes = || record.iter().flat_map(|record| &record.passes);
    let seconds: f64 = passes().filter_map(|pass| pass.secs).sum();
    let memory = passes().filter_map(|pass| pass.peak_rss_mib).reduce(f64::max);
    let text = |value: Option<f64>, digits: usize| value.map(|value| format!("{value:.digits$}"));
    let state = record.as_ref().map_or("no run".to_owned(), |record| record.state.word());
    let mut row: IndexMap<String, String> = [
        ("run", run.to_owned()),
        ("state", state),
        ("seconds", text(record.as_ref().map(|_| seconds), 1).unwrap_or_default()),
        ("memory_mib", text(memory, 0).unwrap_or_default()),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into();
    for (pass, score) in &scores.passes {
        row.insert(format!("{pass}_psnr"), format!("{:.2}", score.psnr));
        row.insert(format!("{pass}_ssim"), format!("{:.4}", score.ssim));
    }
    let whole = [
        ("albedo_psnr", text(scores.albedo_psnr, 2)),
        ("normal_deg", text(scores.normal_deg, 3)),
        ("mask_iou", text(scores.mask_iou, 4)),
        ("chamfer", text(scores.chamfer, 5)),
    ];
    row.extend(whole.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))));
    row
}

/// Addresses of pictures; a file is read once.
#[derive(Default)]
struct Pictures {
    known: BTreeMap<PathBuf, String>,
    /// Bytes of addresses that may still be given out.
    left: usize,
}

impl Pictures {
    /// A small JPEG as it is; `None` if it cannot be read or the budget is spent.
    fn file(&mut self, path: &Path) -> Option<String> {
        self.address(path, || read_up_to(path, MOST_SMALL_BYTES, |_| String::new()).ok())
    }

    /// A PNG whose longer side is at most `side` pixels, on the mat of a contact sheet; `None` if
    /// it cannot be read or the budget is spent.
    fn small(&mut self, path: &Path, side: u32) -> Option<String> {
        self.address(path, || {
            let bytes = read_up_to(path, MOST_BYTES, |_| String::new()).ok()?;
            let picture = decode(&bytes).ok()?.to_rgba8();
            thumbnail_jpeg(&on_mat(&picture), side).ok()
        })
    }

    fn address(&mut self, path: &Path, bytes: impl FnOnce() -> Option<Vec<u8>>) -> Option<String> {
        if !self.known.contains_key(path) {
            let address = jpeg_address(&bytes()?);
            self.known.insert(path.to_owned(), address);
        }
        let address = self.known.get(path)?;
        self.left = self.left.checked_sub(address.len())?;
        Some(address.clone())
    }
}

/// The picture without transparency.
fn on_mat(picture: &RgbaImage) -> RgbImage {
    RgbImage::from_fn(picture.width(), picture.height(), |x, y| {
        let [color @ .., alpha] = picture.get_pixel(x, y).0.map(u32::from);
        let over = |c: usize| ((color[c] * alpha + u32::from(MAT[c]) * (255 - alpha)) / 255) as u8;
        Rgb([0, 1, 2].map(over))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{scores::PassScores, scores::ScaleFound, scores::ViewScores};
    use base64::Engine as _;
    use base64::engine::general_purpose::STANDARD;
    use image::Rgba;
    use lobelia_io::codec::tone::write_thumbnail;
    use serde_json::{Value, json};
    use std::fs;
    use tempfile::TempDir;

    /// A folder of a run with a fit, scored views and an unscored pass.
    fn folder() -> TempDir {
        let out = tempfile::tempdir().unwrap();
        let files = ["novel/a.exr", "novel/a.png", "turned/b.exr", "turned/b.png", "fit/log.csv"];
        for folder in ["novel", "turned", "fit", "scores/novel"] {
            fs::create_dir_all(out.path().join(folder)).unwrap();
        }
        let picture = RgbImage::from_pixel(8, 8, Rgb([90, 20, 10]));
        for file in ["novel/a.png", "turned/b.png"] {
            picture.save(out.path().join(file)).unwrap();
        }
        let mut scored = vec!["scores/contact_sheet.png".to_owned()];
        for (view, part) in ["a", "c"].into_iter().flat_map(|view| PARTS.map(|part| (view, part))) {
            let name = format!("scores/novel/{view}_{part}.jpg");
            write_thumbnail(&out.path().join(&name), &picture, 8).unwrap();
            scored.push(name);
        }
        fs::write(out.path().join("fit/log.csv"), "step,loss\n1,0.5\n2,bad\n").unwrap();
        let of = |pass: &str| files.iter().filter(|file| file.starts_with(pass)).collect::<Vec<_>>();
        let pass = |name: &str, files: Value| json!({ "name": name, "state": "finished", "files": files, "said": ["done"] });
        let record = json!({
            "program": "lobelia", "version": "0.1", "state": "interrupted", "scene": "s.ron", "files": [],
            "scene_text": "Scene(version: 1, seed: 4)", "seed": 4,
            "passes": [
                pass("fit", json!(of("fit"))), pass("novel", json!(of("novel"))), pass("turned", json!(of("turned"))),
                pass("scores", json!(scored)),
            ],
        });
        fs::write(out.path().join(RUN), record.to_string()).unwrap();
        let view = |name: &str, psnr| ViewScores {
            name: name.into(),
            psnr,
            psnr_raw: psnr,
            ssim: 0.9,
            scale: None,
            srgb: None,
            stanford_orb: None,
        };
        let views = vec![view("a", 30.0), view("c", 20.0), view("gone", 10.0)];
        let novel = PassScores { views, ..PassScores::default() };
        let scores = Scores { passes: IndexMap::from([("novel".to_owned(), novel)]), ..Scores::default() };
        scores.write_json(out.path().join(METRICS)).unwrap();
        out
    }

    #[test]
    fn a_folder_is_read_as_it_is() {
        let out = folder();
        let report = read_run(out.path()).unwrap();
        assert_eq!((report.state.as_str(), report.passes.len()), ("interrupted", 4));
        assert_eq!(report.fields[1], ("seed".to_owned(), "4".to_owned()));
        assert!(report.facts.contains(&("seed".to_owned(), "4".to_owned())));
        let names = |of: &PassViews| of.views.iter().map(|view| view.name.clone()).collect::<Vec<_>>();
        let [novel, turned] = &report.views[..] else { panic!("{} passes", report.views.len()) };
        assert_eq!((novel.pass.as_str(), names(novel).concat(), novel.left_out), ("novel", "ca".into(), 1));
        assert!(novel.views.iter().all(|view| view.truth.is_some() && view.error.is_some()));
        assert_eq!((turned.pass.as_str(), names(turned).concat()), ("turned", "b".into()));
        assert!(turned.views[0].render.is_some() && turned.views[0].truth.is_none());
        let loss = report.logs[0].column("loss").unwrap();
        assert!(loss[0] == 0.5 && loss[1].is_nan());
        assert!(report.logs[0].column("psnr").is_none());
    }

    #[test]
    fn what_fits_found_is_told_and_what_cannot_be_read_left_out() {
        let out = tempfile::tempdir().unwrap();
        let path = out.path().join("fit/materials.ron");
        fs::create_dir(out.path().join("fit")).unwrap();
        fs::write(&path, "// words\n[\n    (albedo: (0.3, 0.2, 0.1), roughness: 0.25, ndf: Sg),\n]\n")
            .unwrap();
        let of = ScaleFound { rule: "WhiteLight".into(), mean_light: [2.0, 1.0, 0.0], mean_albedo: [0.1; 3] };
        let found = findings(out.path(), &["fit"], &Scores { scale: Some(of), ..Scores::default() });
        let lines: Vec<String> = found.iter().map(|f| format!("{} = {}", f.what, f.value)).collect();
        assert!(lines[0].contains("albedo = WhiteLight — photographs"), "{lines:?}");
        assert_eq!(lines[1], "mean light = 2.000, 1.000, 0.000");
        let fit = "fit: specular albedo 1 = 0.300, 0.200, 0.100; roughness 0.250, distribution of normals Sg";
        assert_eq!(lines[3], fit);
        assert_eq!(found[1].color, Some([255, 188, 0]));
        fs::write(&path, "nothing, of, use").unwrap();
        assert!(findings(out.path(), &["fit", "none"], &Scores::default()).is_empty());
        assert!(fit_pictures(out.path(), "fit", &mut Pictures::default()).is_empty());
    }

    #[test]
    fn pictures_are_made_small_once_and_within_the_budget() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        RgbaImage::from_pixel(64, 32, Rgba([255, 0, 0, 0])).save(&path).unwrap();
        let mut pictures = Pictures { left: 1 << 20, ..Pictures::default() };
        let address = pictures.small(&path, 16).unwrap();
        let bytes = STANDARD.decode(address.strip_prefix("data:image/jpeg;base64,").unwrap()).unwrap();
        let read = decode(&bytes).unwrap().to_rgb8();
        assert_eq!(read.dimensions(), (16, 8));
        assert!(read.get_pixel(3, 3).0.iter().zip(MAT).all(|(a, b)| a.abs_diff(b) < 4));
        fs::remove_file(&path).unwrap();
        assert_eq!(pictures.small(&path, 16), Some(address.clone()));
        pictures.left = address.len() + 1;
        assert!(pictures.small(&path, 16).is_some() && pictures.small(&path, 16).is_none());
        // What is no picture is left out.
        let mut pictures = Pictures { left: 1 << 20, ..Pictures::default() };
        assert_eq!((pictures.small(&path, 16), pictures.file(&path)), (None, None));
        fs::write(&path, "no picture").unwrap();
        assert_eq!(pictures.small(&path, 16), None);
        fs::write(&path, vec![0; 2 << 20]).unwrap();
        assert_eq!(pictures.file(&path), None);
    }
}
