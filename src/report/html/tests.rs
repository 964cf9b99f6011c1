use super::*;
use crate::report::published::SrgbScores;
use indexmap::IndexMap;
use lobelia_io::codec::tone::{LARGEST_ERROR, heat_color};

fn view_scores(name: &str, psnr: f64) -> ViewScores {
    let (name, psnr_raw, scale, srgb, stanford_orb) = (name.into(), psnr - 1.0, None, None, None);
    ViewScores { name, psnr, psnr_raw, ssim: 0.9, scale, srgb, stanford_orb }
}

fn view(name: &str) -> ViewReport {
    let address = |part: &str| Some(format!("data:image/jpeg;base64,{name}{part}"));
    ViewReport { name: name.into(), truth: address("T"), render: address("R"), error: address("E") }
}

/// The scores of a pass with a good view and a bad one.
fn pass_scores(psnr: f64) -> PassScores {
    PassScores {
        psnr,
        psnr_raw: psnr - 1.0,
        ssim: 0.95,
        scale: [1.0; 3],
        srgb: Some(SrgbScores { psnr_mask: 20.0, ..SrgbScores::default() }),
        views: vec![view_scores("good", psnr + 2.0), view_scores("bad", psnr - 2.0)],
        ..PassScores::default()
    }
}

/// The log of a fit with two rows.
fn fit_log() -> FitLog {
    let columns = ["step", "elapsed_secs", "loss", "psnr", "roughness"];
    FitLog { pass: "fit".into(), columns: columns.map(|name| (name.to_owned(), vec![1.0, 20.0])).to_vec() }
}

fn pass(name: &str, state: RunState) -> PassRecord {
    PassRecord { state, ..PassRecord::waiting(name, Vec::new()) }
}

fn picture(title: &str, address: &str) -> ReportPicture {
    ReportPicture { title: title.into(), address: address.into() }
}

fn finding(what: &str, value: &str, color: Option<[u8; 3]>) -> FitFinding {
    FitFinding { what: what.into(), value: value.into(), color }
}

fn run(name: &str, psnr: f64) -> RunReport {
    RunReport {
        name: name.into(),
        state: "finished".into(),
        facts: vec![("seed".into(), "7".into())],
        scene_text: "Scene(version: 1)".into(),
        fields: vec![("version".into(), "1".into()), ("passes.fit.steps".into(), psnr.to_string())],
        passes: vec![PassRecord { secs: Some(125.2), ..pass("fit", RunState::Finished) }],
        scores: Scores {
            passes: IndexMap::from([("novel".into(), pass_scores(psnr))]),
            normal_deg: Some(psnr / 10.0),
            ..Scores::default()
        },
        logs: vec![fit_log()],
        pictures: vec![picture("fit: albedo", "data:image/jpeg;base64,A")],
        views: vec![PassViews { pass: "novel".into(), views: vec![view("good"), view("bad")], left_out: 0 }],
        findings: vec![finding("mean light", "1, 1, 1", Some([9, 8, 7]))],
        ..RunReport::default()
    }
}

#[test]
fn the_scale_shows_the_colors_of_errors() {
    for i in 0..=8u8 {
        let [r, g, b] = heat_color(f32::from(i) / 8.0);
        has(SCALE, &[&format!("rgb({r} {g} {b}) {:.1}%", f32::from(i) * 12.5)]);
    }
    for tick in [0.0, 0.01, 0.05, 0.1, LARGEST_ERROR] {
        has(SCALE, &[&format!("left:{:.1}%\">{tick}<", 100.0 * (tick / LARGEST_ERROR).sqrt())]);
    }
}

/// The part of the page with this identifier.
fn part<'a>(page: &'a str, id: &str) -> &'a str {
    let (_, after) = page.split_once(&format!("<section id=\"{id}\"")).unwrap_or_else(|| panic!("no {id}"));
    after.split_once("</section>").unwrap().0
}

#[track_caller]
fn has(text: &str, all: &[&str]) {
    for words in all {
        assert!(text.contains(words), "no {words:?} in\n{text}");
    }
}

#[test]
fn a_run_is_one_page_with_all_parts() {
    let page = html(&[run("spot", 30.0)]).unwrap();
    has(&page, &["<title>spot</title>", SIGNATURE, "s-finished\">finished<", "<dd>30.0 <small>dB"]);
    let row = "<td>30.00</td><td>29.00</td><td>0.9500</td><td>none</td>";
    has(part(&page, "scores"), &[row, "in sRGB", "normal error, mean °"]);
    has(part(&page, "views"), &["photograph of view bad", "base64,badE", "28.00 dB, SSIM 0.9000"]);
    has(part(&page, "light"), &["base64,A", "fit: albedo"]);
    has(part(&page, "curves"), &["Loss", "PSNR of training pixels", "over seconds", "<polyline"]);
    has(part(&page, "found"), &["mean light", "rgb(9 8 7)"]);
    has(part(&page, "passes"), &["2 min 05 s"]);
    has(part(&page, "scene"), &["Scene(version: 1)"]);
    has(part(&page, "run"), &["seed", "<td>7</td>"]);
    let worst_first = |a: &str, b: &str| page.find(a).unwrap() < page.find(b).unwrap();
    assert!(worst_first("base64,badR", "base64,goodR"));
    // No log has these columns, so no chart has them.
    assert!(!page.contains("Specular albedo, mean"), "{page}");
    assert!(!page.contains("{{") && !page.contains("http://") && !page.contains("https://"));
}

#[test]
fn runs_stand_side_by_side_with_differences() {
    let (first, mut second) = (run("a", 30.0), run("b", 31.5));
    second.views[0].views.push(view("new"));
    second.scores.passes["novel"].ssim = 0.95;
    second.fields.push(("seed".into(), "3".into()));
    let page = html(&[first, second]).unwrap();
    let better = "31.50 <small class=\"better\">(▲ +1.50)</small>";
    has(part(&page, "scores"), &[better, "0.9500 <small class=\"same\">(+0.0000)"]);
    has(part(&page, "scores"), &["3.150 <small class=\"worse\">(▼ +0.150)</small>", "rowspan=\"2\""]);
    let views = part(&page, "views");
    has(views, &["a: render of view bad", "b: error of view bad", "b: render of view new", "novel: new"]);
    assert_eq!(views.matches("photograph of view bad").count(), 1, "{views}");
    has(part(&page, "scene"), &["passes.fit.steps", "<td>30</td><td>31.5</td>", "<td>–</td><td>3</td>"]);
    assert!(!part(&page, "scene").contains("<th scope=\"row\">version<"));
    assert_eq!(part(&page, "curves").matches("<g class=\"c1\"").count(), 6);
    let page = html(&[run("a", 30.0), run("b", 30.0)]).unwrap();
    has(part(&page, "scene"), &["The scene files have the same values."]);
}

#[test]
fn an_interrupted_run_has_a_report_of_what_there_is() {
    let empty = RunReport {
        name: "x".into(),
        state: "failed".into(),
        error: Some("fit: no <pixels>".into()),
        passes: vec![pass("fit", RunState::Failed)],
        ..RunReport::default()
    };
    let page = html(&[empty]).unwrap();
    has(&page, &["fit: no &lt;pixels&gt;", "s-failed", "failed –"]);
    for missing in ["scores", "views", "light", "curves", "found", "scene", "run"] {
        let links = [format!("id=\"{missing}\""), format!("#{missing}\"")];
        assert!(!links.iter().any(|link| page.contains(link)), "{missing}");
    }
}

#[test]
fn nothing_of_a_users_files_is_markup() {
    let evil = "<script>alert('x')</script>\"&{{BODY}}";
    let mut bad = run(evil, 30.0);
    bad.state = evil.into();
    bad.error = Some(evil.into());
    bad.facts.push((evil.into(), evil.into()));
    bad.scene_text = evil.into();
    bad.fields.push((evil.into(), evil.into()));
    bad.said = vec![evil.into()];
    bad.passes.push(PassRecord { said: vec![evil.into()], ..pass(evil, RunState::Failed) });
    bad.logs[0].pass = evil.into();
    bad.pictures.push(picture(evil, evil));
    bad.findings.push(finding(evil, evil, None));
    bad.views.push(PassViews { pass: evil.into(), views: vec![view(evil)], left_out: 1 });
    let scores = bad.scores.passes["novel"].clone();
    bad.scores.passes.insert(evil.into(), PassScores { views: vec![view_scores(evil, 1.0)], ..scores });
    for runs in [vec![bad.clone()], vec![run("a", 1.0), bad]] {
        let page = html(&runs).unwrap();
        assert_eq!(page.matches("<script>").count(), 1, "only the page's own");
        assert!(!page.contains("alert('x')") && !page.contains("\"\"&"), "{page}");
        assert!(page.matches("{{BODY}}").count() > 10, "values are no slots");
    }
}

#[test]
fn many_views_are_folded_and_too_many_runs_refused() {
    let mut many = run("many", 30.0);
    many.views[0].views = (0..40).map(|i| view(&format!("v{i}"))).collect();
    many.views[0].left_out = 3;
    let page = html(&[many]).unwrap();
    has(part(&page, "views"), &["28 more views", "3 more in the folder"]);
    assert!(html(&[]).is_err());
    let error = html(&vec![RunReport::default(); 9]).unwrap_err();
    assert!(error.to_string().contains("1 to 8 runs, not 9"), "{error}");
    assert!(filled("no slot", &[("{{A}}", String::new())]).is_err());
}

#[test]
fn nothing_of_the_text_is_markup() {
    assert_eq!(escaped("<a href='x'>\"&\"</a>"), "&lt;a href=&#39;x&#39;&gt;&quot;&amp;&quot;&lt;/a&gt;");
    assert_eq!(escaped("a\0b\x1b[1m\nc\td – é"), "ab[1m\nc\td – é");
}
