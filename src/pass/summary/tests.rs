use super::*;
use crate::report::scores::{PassScores, ViewScores};
use crate::report::thumbnail::write_thumbnail;
use image::{Rgb, RgbImage};
use indexmap::IndexMap;
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
    let novel = PassScores {
        views: vec![view("a", 30.0), view("c", 20.0), view("gone", 10.0)],
        ..PassScores::default()
    };
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
    let names =
        |i: usize| -> Vec<&str> { report.views[i].views.iter().map(|view| view.name.as_str()).collect() };
    assert_eq!(
        (report.views[0].pass.as_str(), names(0), report.views[0].left_out),
        ("novel", vec!["c", "a"], 1)
    );
    assert!(report.views[0].views.iter().all(|view| view.truth.is_some() && view.error.is_some()));
    assert_eq!((report.views[1].pass.as_str(), names(1)), ("turned", vec!["b"]));
    assert!(report.views[1].views[0].render.is_some() && report.views[1].views[0].truth.is_none());
    let loss = report.logs[0].column("loss").unwrap();
    assert!(loss[0] == 0.5 && loss[1].is_nan());
    assert!(report.logs[0].column("psnr").is_none());
}

#[test]
fn a_report_keeps_to_its_budget() {
    let out = folder();
    let record = Record::read(out.path()).unwrap();
    let scores = read_scores(out.path()).unwrap();
    let all = gather(out.path(), &record, scores.clone(), &mut Pictures::default());
    let used = |report: &RunReport| {
        let of = |view: &ViewReport| {
            [&view.truth, &view.render, &view.error].into_iter().flatten().map(String::len).sum::<usize>()
        };
        report.views.iter().flat_map(|pass| &pass.views).map(of).sum::<usize>()
    };
    assert!(used(&all) < BUDGET);
    let mut pictures = Pictures::default();
    pictures.begin(used(&all) / 2);
    let some = scored_views(out.path(), &record, &scores, &mut pictures);
    assert_eq!((some[0].views.len(), some[0].views[0].name.as_str(), some[0].left_out), (1, "c", 2));
}

#[test]
fn a_report_is_written_into_the_folder_while_the_run_goes_on() {
    let out = folder();
    let mut reporter = Reporter::default();
    reporter.write(out.path()).unwrap();
    let first = fs::read_to_string(out.path().join(REPORT)).unwrap();
    fs::remove_file(out.path().join(METRICS)).unwrap();
    reporter.write(out.path()).unwrap();
    let second = fs::read_to_string(out.path().join(REPORT)).unwrap();
    assert!(first.contains("id=\"scores\"") && !second.contains("id=\"scores\""));
    fs::remove_file(out.path().join(RUN)).unwrap();
    assert!(reporter.write(out.path()).is_err());
}

#[test]
fn folders_that_are_no_runs_are_refused() {
    let out = folder();
    let refused = |path: &Path, words: &str| {
        let error = read_run(path).unwrap_err();
        assert!(error.to_string().contains(words) && error.help().is_some(), "{error}");
    };
    refused(&out.path().join("nowhere"), "nowhere is not there");
    refused(&out.path().join(RUN), "run.json is not a folder");
    refused(&out.path().join("novel"), "not the folder of a run: it has no run.json");
    let metrics = fs::read_to_string(out.path().join(METRICS)).unwrap();
    fs::write(out.path().join(METRICS), metrics.replace("\"passes\"", "\"other\"")).unwrap();
    refused(out.path(), "not the scores of a run of this version");
    fs::remove_file(out.path().join(METRICS)).unwrap();
    refused(out.path(), "no pass of the run has ended");
    for text in
        ["{}", "{\"program\": \"lobelia\", \"version\": \"0.0\"}", "no JSON", "{\"program\": \"other\"}"]
    {
        fs::write(out.path().join(RUN), text).unwrap();
        refused(out.path(), "run.json was not written by this version of lobelia");
    }
}
