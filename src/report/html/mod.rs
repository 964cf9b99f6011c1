//! The report of a run, or of several side by side: one HTML file that holds everything, pictures
//! included, and asks no server for anything. It is readable without the script in `assets/`, which
//! only adds the wipe.

mod plot;

use crate::report::scores::{PassScores, Scaling, Scores, ViewScores};
use crate::report::{PassRecord, RunState};
use indexmap::IndexSet;
use lobelia_geometry::error::{Error, Result};
use plot::{Series, svg};

/// A run. All texts are as they come from its files; the page escapes them.
#[derive(Clone, Debug, Default)]
pub struct RunReport {
    /// Name on the page: that of its folder.
    pub name: String,
    /// How it ended: "finished", "failed", …
    pub(crate) state: String,
    pub(crate) error: Option<String>,
    /// Version, scene file, seed, arguments, machine: name and value.
    pub(crate) facts: Vec<(String, String)>,
    pub(crate) scene_text: String,
    /// The values of the scene file, by their paths.
    pub(crate) fields: Vec<(String, String)>,
    /// Notes before the first pass.
    pub(crate) said: Vec<String>,
    pub(crate) passes: Vec<PassRecord>,
    pub(crate) scores: Scores,
    pub(crate) logs: Vec<FitLog>,
    pub(crate) pictures: Vec<ReportPicture>,
    pub(crate) views: Vec<PassViews>,
    pub(crate) findings: Vec<FitFinding>,
    /// Seconds after which the page loads itself again, while the run goes on.
    pub(crate) reload_secs: Option<u64>,
}

/// The log of a fit: columns of numbers by name, one entry each per line.
#[derive(Clone, Debug, Default)]
pub(crate) struct FitLog {
    pub pass: String,
    pub columns: Vec<(String, Vec<f64>)>,
}

impl FitLog {
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|(column, _)| column == name).map(|(_, values)| values.as_slice())
    }
}

/// A picture: a light or a texture.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReportPicture {
    /// Title: "fit: recovered light". Pictures of the same title are of several runs side by side.
    pub title: String,
    /// A `data:` address.
    pub address: String,
}

/// The views of a pass.
#[derive(Clone, Debug, Default)]
pub(crate) struct PassViews {
    pub pass: String,
    pub views: Vec<ViewReport>,
    /// How many more there are in the pass's folder.
    pub left_out: usize,
}

/// A view: `data:` addresses of its pictures, as far as there are any.
#[derive(Clone, Debug, Default)]
pub(crate) struct ViewReport {
    pub name: String,
    /// The photograph, or another ground truth.
    pub truth: Option<String>,
    /// The render, with the scale that its score is found with.
    pub render: Option<String>,
    pub error: Option<String>,
}

/// Something that a fit found or decided, with a color (sRGB) to show beside it.
#[derive(Clone, Debug, Default)]
pub(crate) struct FitFinding {
    pub what: String,
    pub value: String,
    pub color: Option<[u8; 3]>,
}

/// The file name of a report in the folder of its run.
pub const REPORT: &str = "report.html";

/// Text in the head of every report.
pub const SIGNATURE: &str = r#"name="generator" content="Lobelia report""#;

/// Most runs side by side: each has a color of its own.
pub(crate) const MOST_RUNS: usize = 8;

const PAGE: &str = include_str!("assets/report.html");
const STYLE: &str = include_str!("assets/report.css");
const SCRIPT: &str = include_str!("assets/report.js");
/// The scale of error maps, as `heat_color` has it.
const SCALE: &str = include_str!("assets/scale.html");

/// The page of one run, or of several side by side; the first one is what the others are compared
/// with.
///
/// # Errors
/// [`Error::Usage`] for no run, or more than `MOST_RUNS`.
pub fn html(runs: &[RunReport]) -> Result<String> {
    if runs.is_empty() || runs.len() > MOST_RUNS {
        let problem = format!("a report shows 1 to {MOST_RUNS} runs, not {}", runs.len());
        return Err(Error::usage(problem, "Give the output folders of fewer runs."));
    }
    // Identifier, heading and content, which is empty if the runs have nothing for it.
    let mut sections = vec![
        ("scores", "Scores", scores(runs)),
        ("views", "Views", views(runs)),
        ("light", "Light and textures", pictures(runs)),
        ("curves", "Curves", curves(runs)),
        ("found", "What was found", findings(runs)),
        ("passes", "Passes: time and memory", passes(runs)),
        ("scene", "Scene", scene(runs)),
        ("run", "Run", facts(runs)),
    ];
    sections.retain(|(_, _, content)| !content.is_empty());
    let links = sections.iter().map(|(id, heading, _)| format!("<a href=\"#{id}\">{heading}</a>"));
    let body = sections.iter().map(|(id, heading, content)| {
        format!("<section id=\"{id}\" aria-labelledby=\"{id}-h\">\n<h2 id=\"{id}-h\">{heading}</h2>\n{content}</section>\n")
    });
    let title = escaped(&runs.iter().map(|run| run.name.as_str()).collect::<Vec<_>>().join(" · "));
    let reload = runs.iter().find_map(|run| run.reload_secs);
    let reload = reload.map(|secs| format!("<meta http-equiv=\"refresh\" content=\"{secs}\">\n"));
    let slots = [
        ("{{RELOAD}}", reload.unwrap_or_default()),
        ("{{TITLE}}", title.clone()),
        ("{{STYLE}}", STYLE.to_owned()),
        ("{{HEADING}}", title),
        ("{{LEAD}}", lead(runs)),
        ("{{LINKS}}", links.collect::<Vec<_>>().join("\n")),
        ("{{BODY}}", body.collect()),
        ("{{VERSION}}", escaped(crate::version())),
        ("{{SCRIPT}}", SCRIPT.to_owned()),
    ];
    filled(PAGE, &slots)
}

/// A page with values in its slots, which come in this order: one pass over the page, so that
/// nothing of the values is taken for a slot.
pub(crate) fn filled(page: &str, slots: &[(&str, String)]) -> Result<String> {
    let mut text = String::new();
    let mut rest = page;
    for (slot, value) in slots {
        let Some((before, after)) = rest.split_once(slot) else {
            return Err(Error::run("writing the page", format!("its template lacks {slot}")));
        };
        text += before;
        text += value;
        rest = after;
    }
    Ok(text + rest)
}

/// Text inside an element or an attribute with quotes around it; what no document may hold (control
/// characters) is left out.
pub fn escaped(text: &str) -> String {
    let kept: String = text.chars().filter(|c| ['\n', '\t'].contains(c) || !c.is_control()).collect();
    // The ampersand first: those of the others stay.
    let marks = [('&', "&amp;"), ('<', "&lt;"), ('>', "&gt;"), ('"', "&quot;"), ('\'', "&#39;")];
    marks.into_iter().fold(kept, |text, (mark, written)| text.replace(mark, written))
}

/// What stands in a cell without a value.
const NOTHING: &str = "–";

/// Markup that only stands where there are several runs.
fn if_several(runs: &[RunReport], markup: impl FnOnce() -> String) -> String {
    if runs.len() > 1 { markup() } else { String::new() }
}

/// The mark of a run's color, where there are several.
fn mark(runs: &[RunReport], i: usize) -> String {
    if_several(runs, || format!("<i class=\"mark c{i}\"></i>"))
}

/// The name of a run with its mark.
fn run_name(runs: &[RunReport], i: usize) -> String {
    mark(runs, i) + &escaped(&runs[i].name)
}

fn details(open: bool, summary: &str, content: &str) -> String {
    let open = if open { " open" } else { "" };
    format!("<details{open}><summary>{summary}</summary>\n{content}\n</details>\n")
}

/// A folded text of a run.
fn text_of(runs: &[RunReport], i: usize, open: bool, what: &str, text: &str) -> String {
    let of = if_several(runs, || format!(" of {}", run_name(runs, i)));
    details(open, &format!("{what}{of}"), &format!("<pre>{}</pre>", escaped(text)))
}

/// A picture; `alt` is markup already.
fn img(address: &str, alt: &str) -> String {
    format!("<img src=\"{}\" alt=\"{alt}\" decoding=\"async\">", escaped(address))
}

fn table(class: &str, caption: &str, head: &str, rows: &str) -> String {
    format!(
        "<div class=\"wide\"><table{class}>\n<caption>{caption}</caption>\n{head}<tbody>\n{rows}</tbody>\n</table></div>\n"
    )
}

/// The head of a table, of columns with these names as markup.
fn head(first: &str, names: impl Iterator<Item = String>) -> String {
    let names: String = names.map(|name| format!("<th scope=\"col\">{name}</th>")).collect();
    format!("<thead><tr>{first}{names}</tr></thead>\n")
}

fn cells(cells: impl Iterator<Item = String>) -> String {
    cells.map(|cell| format!("<td>{cell}</td>")).collect()
}

/// A row of a table: its heading as text, and a cell of markup per run.
type Row = (String, Vec<String>);

/// A table in which a row is one value of all runs. Empty if there is no row.
fn by_run(runs: &[RunReport], caption: &str, rows: Vec<Row>) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let head = if_several(runs, || head("<td></td>", (0..runs.len()).map(|i| run_name(runs, i))));
    let rows = rows.into_iter().map(|(heading, row)| {
        format!("<tr><th scope=\"row\">{}</th>{}</tr>\n", escaped(&heading), cells(row.into_iter()))
    });
    table("", caption, &head, &rows.collect::<String>())
}

/// Rows of named values: one for each name that any run has, in the order in which names come up.
fn named_rows(runs: &[RunReport], values: impl Fn(&RunReport) -> Vec<(String, String)>) -> Vec<Row> {
    let values: Vec<Vec<(String, String)>> = runs.iter().map(values).collect();
    let names: IndexSet<&String> = values.iter().flatten().map(|(name, _)| name).collect();
    let row = |wanted: &String| {
        let cell = |of: &Vec<(String, String)>| {
            let found = of.iter().find(|(name, _)| name == wanted);
            found.map_or_else(|| NOTHING.into(), |(_, cell)| cell.clone())
        };
        (wanted.clone(), values.iter().map(cell).collect())
    };
    names.into_iter().map(row).collect()
}

/// How a score is shown: digits, and 1 if more is better, −1 if less is.
#[derive(Clone, Copy)]
struct Unit(usize, f64);

const DECIBEL: Unit = Unit(2, 1.0);
const RATIO: Unit = Unit(4, 1.0);
const DEGREES: Unit = Unit(3, -1.0);

/// A score of a pass, or of a run as a whole.
type Score<T> = (&'static str, Unit, fn(&T) -> Option<f64>);

const LINEAR: [Score<PassScores>; 3] = [
    ("PSNR dB", DECIBEL, |s| Some(s.psnr)),
    ("unscaled dB", DECIBEL, |s| Some(s.psnr_raw)),
    ("SSIM", RATIO, |s| Some(s.ssim)),
];

const SRGB: [Score<PassScores>; 5] = [
    ("mask dB", DECIBEL, |s| Some(s.srgb?.psnr_mask)),
    ("white dB", DECIBEL, |s| Some(s.srgb?.psnr_white)),
    ("SSIM", RATIO, |s| Some(s.srgb?.ssim_white)),
    ("black dB", DECIBEL, |s| Some(s.srgb?.psnr_black)),
    ("SSIM", RATIO, |s| Some(s.srgb?.ssim_black)),
];

const ORB: [Score<PassScores>; 2] = [
    ("PSNR-H dB", DECIBEL, |s| Some(s.stanford_orb?.psnr_hdr)),
    ("PSNR-L dB", DECIBEL, |s| Some(s.stanford_orb?.psnr_ldr)),
];

const WHOLE: [Score<Scores>; 7] = [
    ("albedo PSNR, dB", DECIBEL, |s| s.albedo_psnr),
    ("normal error, mean °", DEGREES, |s| s.normal_deg),
    ("normal error, median °", DEGREES, |s| s.normal_median_deg),
    ("mask IoU", RATIO, |s| s.mask_iou),
    ("Chamfer distance", Unit(5, -1.0), |s| s.chamfer),
    ("time of fits, s", Unit(1, -1.0), |s| s.fit_secs),
    ("peak memory, MiB", Unit(0, -1.0), |s| s.peak_rss_mib),
];

/// The scores of the passes, and the others.
fn scores(runs: &[RunReport]) -> String {
    let linear = "Passes against their ground truth, in linear light, the mask eroded by a pixel";
    let srgb = "Passes against photographs and other pictures of encoded colors, in sRGB: over the mask, and over all pixels on white and on black";
    let orb =
        "Passes as Stanford-ORB scores them: each picture scaled by itself, the mask eroded by two pixels";
    let whole = WHOLE.iter().filter(|(.., of)| runs.iter().any(|run| of(&run.scores).is_some()));
    let row = |(heading, unit, of): &Score<Scores>| {
        let cell = |i| cell(runs, i, *unit, |run| of(&run.scores));
        ((*heading).to_owned(), (0..runs.len()).map(cell).collect())
    };
    let text = pass_table(runs, linear, &LINEAR, true)
        + &pass_table(runs, srgb, &SRGB, false)
        + &pass_table(runs, orb, &ORB, false)
        + &by_run(runs, "The object as a whole", whole.map(row).collect());
    if text.is_empty() {
        return text;
    }
    let note =
        "<p class=\"note\">In brackets: the difference from the first run; ▲ is better, ▼ is worse.</p>\n";
    if_several(runs, || note.to_owned()) + &text
}

/// A score of run `i`, and its difference from that of the first run.
fn cell(runs: &[RunReport], i: usize, unit: Unit, of: impl Fn(&RunReport) -> Option<f64>) -> String {
    let Unit(digits, better) = unit;
    let Some(value) = of(&runs[i]) else { return NOTHING.to_owned() };
    let shown = format!("{value:.digits$}");
    let Some(first) = of(&runs[0]).filter(|_| i > 0) else { return shown };
    let change = value - first;
    let rounded = format!("{change:+.digits$}");
    let is_zero = rounded.trim_start_matches(['+', '-']).chars().all(|c| c == '0' || c == '.');
    let (class, mark) = match change * better {
        gain if gain > 0.0 && !is_zero => ("better", "▲ "),
        gain if gain < 0.0 && !is_zero => ("worse", "▼ "),
        _ => ("same", ""),
    };
    format!("{shown} <small class=\"{class}\">({mark}{rounded})</small>")
}

/// A row per run of each pass that has the first of these scores in any run; empty if none has.
/// `scale` adds a column of the factors that were taken out before scoring.
fn pass_table(runs: &[RunReport], caption: &str, columns: &[Score<PassScores>], scale: bool) -> String {
    let all = runs.iter().flat_map(|run| &run.scores.passes);
    let names: IndexSet<&String> =
        all.filter(|(_, scores)| columns[0].2(scores).is_some()).map(|(name, _)| name).collect();
    if names.is_empty() {
        return String::new();
    }
    let mut rows = String::new();
    for name in names {
        let count = runs.len();
        let mut start =
            format!("<tr class=\"first\"><th scope=\"rowgroup\" rowspan=\"{count}\">{}</th>", escaped(name));
        for (i, run) in runs.iter().enumerate() {
            let score = |of: fn(&PassScores) -> Option<f64>| {
                move |run: &RunReport| run.scores.passes.get(name).and_then(of)
            };
            let scores = columns.iter().map(|(_, unit, of)| cell(runs, i, *unit, score(*of)));
            let factors = || run.scores.passes.get(name).map_or_else(|| NOTHING.to_owned(), scale_words);
            let scores = cells(scores.chain(scale.then(factors)));
            let run_cell = if_several(runs, || format!("<td>{}</td>", run_name(runs, i)));
            rows += &format!("{start}{run_cell}{scores}</tr>\n");
            start = "<tr>".to_owned();
        }
    }
    let columns = columns.iter().map(|(name, ..)| *name).chain(scale.then_some("scale removed"));
    let heads = ["pass"].into_iter().chain((runs.len() > 1).then_some("run")).chain(columns);
    table(" class=\"numbers\"", caption, &head("", heads.map(str::to_owned)), &rows)
}

/// The factors that were taken out before scoring.
fn scale_words(scores: &PassScores) -> String {
    let words = |[r, g, b]: [f64; 3]| format!("{r:.3}, {g:.3}, {b:.3}");
    let factors = words(scores.scale);
    match (scores.scaling, scores.scale_specular) {
        (Scaling::None, _) => "none".to_owned(),
        (Scaling::PerView, _) => format!("of each view; mean {factors}"),
        (Scaling::PerLayer, Some(specular)) => format!("diffuse {factors}; specular {}", words(specular)),
        _ => factors,
    }
}

/// Views of a pass that are shown at once; the others are folded.
const UNFOLDED: usize = 12;
/// The views of all passes that rendered, below the scale of their error maps.
fn views(runs: &[RunReport]) -> String {
    let all = || runs.iter().flat_map(|run| &run.views);
    let passes: IndexSet<&str> = all().map(|views| views.pass.as_str()).collect();
    let text: String = passes.iter().map(|pass| pass_views(runs, pass)).collect();
    let has_errors = all().flat_map(|pass| &pass.views).any(|view| view.error.is_some());
    if has_errors { SCALE.to_owned() + &text } else { text }
}
/// A view as one of the runs has it, with its scores there.
type RunView<'a> = (Option<&'a ViewReport>, Option<&'a ViewScores>);

/// The views of a pass that any run has, the worst first: by the score of the first run that has
/// one.
fn pass_views<'a>(runs: &'a [RunReport], pass: &str) -> String {
    let of = |run: &'a RunReport| (run.views.iter().find(|of| of.pass == pass), run.scores.passes.get(pass));
    let of_runs: Vec<(Option<&PassViews>, Option<&PassScores>)> = runs.iter().map(of).collect();
    let all = || of_runs.iter().filter_map(|(views, _)| *views).flat_map(|views| &views.views);
    let names: IndexSet<&str> = all().map(|view| view.name.as_str()).collect();
    // Scored against photographs, if the run has scores of sRGB values.
    let photographs = of_runs.iter().any(|(_, scores)| scores.is_some_and(|scores| scores.srgb.is_some()));
    let truth = if photographs { "photograph" } else { "truth" };
    let mut cards: Vec<(f64, String)> = Vec::new();
    for name in names {
        let found = of_runs.iter().map(|(views, scores)| {
            let view = views.and_then(|views| views.views.iter().find(|view| view.name == name));
            (view, scores.and_then(|scores| scores.views.iter().find(|scores| scores.name == name)))
        });
        let found: Vec<RunView> = found.collect();
        let psnr = found.iter().find_map(|(_, scores)| Some((*scores)?.psnr)).unwrap_or(f64::INFINITY);
        cards.push((psnr, card(runs, pass, name, &found, truth)));
    }
    cards.sort_by(|a, b| a.0.total_cmp(&b.0));
    let size = if all().any(|view| view.truth.is_some()) { "" } else { " small" };
    let drawn = |cards: &[(f64, String)]| {
        let cards: String = cards.iter().map(|(_, card)| card.as_str()).collect();
        format!("<div class=\"cards{size}\">\n{cards}</div>")
    };
    let (shown, folded) = cards.split_at(UNFOLDED.min(cards.len()));
    let score = match (runs.len(), of_runs[0].1) {
        (1, Some(scores)) => format!(" <small>{}</small>", escaped(&scores.summary())),
        _ => String::new(),
    };
    let mut text = format!("<h3>{}{score}</h3>\n{}\n", escaped(pass), drawn(shown));
    if !folded.is_empty() {
        let views = if folded.len() == 1 { "view" } else { "views" };
        text += &details(false, &format!("{} more {views}", folded.len()), &drawn(folded));
    }
    let left_out = of_runs.iter().filter_map(|(views, _)| Some((*views)?.left_out)).max().unwrap_or(0);
    if left_out > 0 {
        text += &format!("<p class=\"note\">{left_out} more in the folder of the pass.</p>\n");
    }
    text
}

/// A view as all runs have it: the truth, and below each other the runs' pictures and scores.
fn card(runs: &[RunReport], pass: &str, name: &str, of_runs: &[RunView], truth: &str) -> String {
    let name = escaped(name);
    let part = |class: &str, what: String, address: &String| {
        let img = img(address, &format!("{what} of view {name}"));
        format!("<span class=\"{class}\">{img}<em>{what}</em></span>")
    };
    let true_picture = of_runs.iter().find_map(|(view, _)| (*view)?.truth.as_ref());
    let rows = if runs.len() > 1 && true_picture.is_some() { " several" } else { "" };
    let mut parts = true_picture.map_or(String::new(), |address| part("t", truth.to_owned(), address));
    let mut lines = String::new();
    for (i, (view, scores)) in of_runs.iter().enumerate() {
        let of = if_several(runs, || format!("{}: ", escaped(&runs[i].name)));
        if let Some(view) = view {
            parts.extend(view.render.iter().map(|address| part("r", format!("{of}render"), address)));
            parts.extend(view.error.iter().map(|address| part("e", format!("{of}error"), address)));
        }
        if let Some(ViewScores { psnr, ssim, .. }) = scores {
            lines += &format!("<span>{}{psnr:.2} dB, SSIM {ssim:.4}</span>", mark(runs, i));
        }
    }
    format!(
        "<figure class=\"card\"><button type=\"button\" class=\"strip{rows}\" data-view=\"{}: {name}\" aria-label=\"Compare the pictures of view {name}\">{parts}</button>\
         <figcaption><b>{name}</b>{lines}</figcaption></figure>\n",
        escaped(pass)
    )
}

/// Returns the top of the page: the states of the runs, and the main scores of a single one.
fn lead(runs: &[RunReport]) -> String {
    let mut text = String::new();
    for (i, run) in runs.iter().enumerate() {
        let name = if_several(runs, || format!("{} ", run_name(runs, i)));
        let state = escaped(&run.state);
        text += &format!("<p class=\"state\">{name}<b class=\"s-{state}\">{state}</b></p>");
        if let Some(error) = &run.error {
            text += &format!("<p class=\"error\">{}</p>", escaped(error));
        }
    }
    let [RunReport { scores, .. }] = runs else { return text };
    let whole = [
        ("albedo", scores.albedo_psnr, 1, " <small>dB"),
        ("normals", scores.normal_deg, 2, "<small>°"),
        ("fit", scores.fit_secs, 0, " <small>s"),
        ("memory", scores.peak_rss_mib, 0, " <small>MiB"),
    ];
    let passes = scores.passes.iter().map(|(name, s)| (name.as_str(), Some(s.psnr), 1, " <small>dB"));
    let tile = |(name, value, digits, unit): (&str, Option<f64>, usize, &str)| {
        let value = value?;
        Some(format!("<div><dt>{}</dt><dd>{value:.digits$}{unit}</small></dd></div>", escaped(name)))
    };
    let tiles: String = passes.chain(whole).filter_map(tile).collect();
    if tiles.is_empty() { text } else { format!("{text}<dl class=\"tiles\">{tiles}</dl>") }
}

/// Lights and textures; those of one title side by side.
fn pictures(runs: &[RunReport]) -> String {
    let all = runs.iter().flat_map(|run| &run.pictures);
    let titles: IndexSet<&str> = all.map(|picture| picture.title.as_str()).collect();
    let mut figures = String::new();
    for title in titles {
        let shown = escaped(title);
        for (i, run) in runs.iter().enumerate() {
            let Some(picture) = run.pictures.iter().find(|picture| picture.title == title) else { continue };
            let of = if_several(runs, || format!("{} · ", run_name(runs, i)));
            let img = img(&picture.address, &shown);
            figures += &format!("<figure>{img}<figcaption>{of}{shown}</figcaption></figure>\n");
        }
    }
    if figures.is_empty() { figures } else { format!("<div class=\"pictures\">\n{figures}</div>\n") }
}

/// Plots of a log: title, whether the axis is logarithmic, and the columns, of which the mean
/// counts.
const PLOTS: [(&str, bool, &[&str]); 5] = [
    ("Loss", true, &["loss"]),
    ("PSNR of training pixels, dB", false, &["psnr"]),
    ("Roughness", false, &["roughness"]),
    ("Specular albedo, mean of R, G, B", false, &["specular_r", "specular_g", "specular_b"]),
    ("Lobes with 99 % of the light", false, &["lobes"]),
];

/// The curves of all fits, over steps and over seconds.
fn curves(runs: &[RunReport]) -> String {
    // Colors are those of runs, or of the fits of one run.
    let several = runs.len() > 1;
    let logs = || {
        runs.iter().enumerate().flat_map(move |(i, run)| {
            run.logs.iter().enumerate().map(move |(k, log)| match several {
                true => (i, format!("{}, {}", run.name, log.pass), log),
                false => (k, log.pass.clone(), log),
            })
        })
    };
    let over = |column: &str, label: &str| -> String {
        let chart = |(title, logarithmic, columns): &(&str, bool, &[&str])| {
            let series = logs().filter_map(|(color, name, log)| {
                Some(Series { name, color, points: points(log, column, columns)? })
            });
            svg(title, label, *logarithmic, series.collect())
        };
        PLOTS.iter().map(chart).collect()
    };
    let (steps, seconds) = (over("step", "steps"), over("elapsed_secs", "seconds"));
    if steps.is_empty() {
        return String::new();
    }
    let [over_steps, over_seconds] = [("steps", " checked"), ("seconds", "")].map(|(over, checked)| {
        format!("<label><input type=\"radio\" name=\"over\" id=\"over-{over}\"{checked}> over {over}</label>")
    });
    let names: Vec<&String> = match runs {
        [run] => run.logs.iter().map(|log| &log.pass).collect(),
        _ => runs.iter().map(|run| &run.name).collect(),
    };
    let mut legend = String::new();
    if names.len() > 1 {
        let names = names.into_iter().map(|name| escaped(name)).enumerate();
        let entries = names.map(|(i, name)| format!("<span><i class=\"mark c{i}\"></i>{name}</span>"));
        legend = format!("<p class=\"legend\">{}</p>", entries.collect::<String>());
    }
    format!(
        "<div class=\"curves\"><div class=\"choice\" role=\"radiogroup\" aria-label=\"Horizontal axis\">{over_steps}{over_seconds}</div>{legend}\n\
         <div class=\"charts steps\">\n{steps}</div>\n<div class=\"charts seconds\">\n{seconds}</div></div>\n"
    )
}

/// The mean of columns over another; `None` if the log lacks one.
fn points(log: &FitLog, across: &str, columns: &[&str]) -> Option<Vec<[f64; 2]>> {
    let columns: Vec<&[f64]> = columns.iter().map(|name| log.column(name)).collect::<Option<_>>()?;
    let mean = |i: usize| columns.iter().filter_map(|of| of.get(i)).sum::<f64>() / columns.len() as f64;
    Some(log.column(across)?.iter().enumerate().map(|(i, x)| [*x, mean(i)]).collect())
}

/// Returns the findings and decisions of the fits.
fn findings(runs: &[RunReport]) -> String {
    let cell = |FitFinding { what, value, color }: &FitFinding| {
        let swatch =
            color.map(|[r, g, b]| format!("<i class=\"swatch\" style=\"background:rgb({r} {g} {b})\"></i>"));
        (what.clone(), swatch.unwrap_or_default() + &escaped(value))
    };
    let rows = named_rows(runs, |run| run.findings.iter().map(cell).collect());
    by_run(runs, "As the fits left it", rows)
}

/// Time and memory of the passes, and the lines that the runs told their user.
fn passes(runs: &[RunReport]) -> String {
    let cell = |pass: &PassRecord| {
        let secs = match pass.secs {
            None => NOTHING.to_owned(),
            Some(secs) if secs < 100.0 => format!("{secs:.1} s"),
            Some(secs) => format!("{} min {:02} s", secs as u64 / 60, secs as u64 % 60),
        };
        let peak = pass.peak_rss_mib.map(|mib| format!(", {mib:.0} MiB")).unwrap_or_default();
        let state = if pass.state == RunState::Finished { String::new() } else { pass.state.word() + " " };
        (pass.name.clone(), format!("{state}{secs}{peak}"))
    };
    let rows = named_rows(runs, |run| run.passes.iter().map(cell).collect());
    let mut text = by_run(runs, "Time of each pass; largest memory of the process until its end", rows);
    for (i, run) in runs.iter().enumerate() {
        let lines = run.said.iter().chain(run.passes.iter().flat_map(|pass| &pass.said));
        let lines: Vec<&str> = lines.map(String::as_str).collect();
        if !lines.is_empty() {
            text += &text_of(runs, i, runs.len() == 1, "Lines of the run", &lines.join("\n"));
        }
    }
    text
}

/// Values of a scene file longer than this are cut in tables.
const LONGEST_VALUE: usize = 120;

/// The scene files: what differs, and their text.
fn scene(runs: &[RunReport]) -> String {
    let cut = |value: &String| match value.char_indices().nth(LONGEST_VALUE) {
        Some((end, _)) => format!("{}…", &value[..end]),
        None => value.clone(),
    };
    let mut text = if_several(runs, || {
        let field = |(path, value): &(String, String)| (path.clone(), escaped(&cut(value)));
        let mut rows = named_rows(runs, |run| run.fields.iter().map(field).collect());
        rows.retain(|(_, cells)| cells.iter().any(|cell| *cell != cells[0]));
        match rows.len() {
            0 => "<p>The scene files have the same values.</p>\n".to_owned(),
            _ => by_run(runs, "Values of the scene files that differ; – where a file leaves one out", rows),
        }
    });
    for (i, run) in runs.iter().enumerate().filter(|(_, run)| !run.scene_text.is_empty()) {
        text += &text_of(runs, i, false, "Scene file", &run.scene_text);
    }
    text
}

/// Version, seed, arguments, machine.
fn facts(runs: &[RunReport]) -> String {
    let escape = |(name, value): &(String, String)| (name.clone(), escaped(value));
    by_run(runs, "How to do it again", named_rows(runs, |run| run.facts.iter().map(escape).collect()))
}

#[cfg(test)]
mod tests;
