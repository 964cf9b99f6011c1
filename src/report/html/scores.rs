//! The tables of scores, with the differences of other runs from the first one.

use crate::report::html::data::RunReport;
use crate::report::html::tables::{Row, by_run, run_name};
use crate::report::html::text::escaped;
use crate::report::scores::{PassScores, Scaling, Scores};
use crate::report::srgb::SrgbScores;

/// How a score is shown, and what is better.
#[derive(Clone, Copy)]
struct Unit {
    digits: usize,
    /// 1 if more is better, −1 if less is, 0 if neither.
    better: f64,
}

const DECIBEL: Unit = Unit { digits: 2, better: 1.0 };
const RATIO: Unit = Unit { digits: 4, better: 1.0 };
const DEGREES: Unit = Unit { digits: 3, better: -1.0 };
const LENGTH: Unit = Unit { digits: 5, better: -1.0 };
const AMOUNT: Unit = Unit { digits: 1, better: -1.0 };

/// The scores of the passes, and the others.
pub fn section(runs: &[RunReport]) -> String {
    let mut text = pass_table(runs);
    text += &by_run(runs, "The object as a whole", &other_rows(runs));
    let better = runs.len() > 1 && !text.is_empty();
    let note =
        "<p class=\"note\">In brackets: the difference from the first run; ▲ is better, ▼ is worse.</p>\n";
    if better { note.to_owned() + &text } else { text }
}

/// A value and its difference from that of the first run.
fn cell(value: Option<f64>, first: Option<f64>, unit: Unit) -> String {
    let Some(value) = value else { return "–".to_owned() };
    let digits = unit.digits;
    let shown = format!("{value:.digits$}");
    let Some(change) = first.map(|first| value - first) else { return shown };
    let rounded = format!("{change:+.digits$}");
    let is_zero = rounded.trim_start_matches(['+', '-']).chars().all(|c| c == '0' || c == '.');
    let (class, mark) = match change * unit.better {
        _ if is_zero => ("same", ""),
        gain if gain > 0.0 => ("better", "▲ "),
        gain if gain < 0.0 => ("worse", "▼ "),
        _ => ("same", ""),
    };
    format!("{shown} <small class=\"{class}\">({mark}{rounded})</small>")
}

/// A column of the table of passes.
type Column = (&'static str, Unit, fn(&PassScores) -> Option<f64>);

const COLUMNS: [Column; 3] = [
    ("PSNR dB", DECIBEL, |s| Some(s.psnr)),
    ("unscaled dB", DECIBEL, |s| Some(s.psnr_raw)),
    ("SSIM", RATIO, |s| Some(s.ssim)),
];

/// Those of passes that are scored against photographs.
const SRGB_COLUMNS: [Column; 5] = [
    ("sRGB, mask dB", DECIBEL, |s| srgb(s, |s| s.psnr_mask)),
    ("on white dB", DECIBEL, |s| srgb(s, |s| s.psnr_white)),
    ("SSIM on white", RATIO, |s| srgb(s, |s| s.ssim_white)),
    ("on black dB", DECIBEL, |s| srgb(s, |s| s.psnr_black)),
    ("SSIM on black", RATIO, |s| srgb(s, |s| s.ssim_black)),
];

fn srgb(scores: &PassScores, of: fn(&SrgbScores) -> f64) -> Option<f64> {
    scores.srgb.as_ref().map(of)
}

/// The names of the passes that any run scores, in their order.
pub fn scored_passes(runs: &[RunReport]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for name in runs.iter().flat_map(|run| run.scores.passes.keys()) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    names
}

/// A row per pass and run; empty if nothing is scored.
fn pass_table(runs: &[RunReport]) -> String {
    let names = scored_passes(runs);
    if names.is_empty() {
        return String::new();
    }
    let any_srgb = runs.iter().flat_map(|run| run.scores.passes.values()).any(|pass| pass.srgb.is_some());
    let columns: Vec<Column> =
        COLUMNS.into_iter().chain(if any_srgb { SRGB_COLUMNS.to_vec() } else { Vec::new() }).collect();
    let heads: String = columns.iter().map(|(name, ..)| format!("<th scope=\"col\">{name}</th>")).collect();
    let run_head = if runs.len() > 1 { "<th scope=\"col\">run</th>" } else { "" };
    let rows: String = names.iter().map(|name| pass_rows(runs, name, &columns)).collect();
    format!(
        "<div class=\"wide\"><table class=\"numbers\">\n<caption>Passes against their ground truth, in linear light, the mask eroded by a pixel</caption>\n\
         <thead><tr><th scope=\"col\">pass</th>{run_head}{heads}<th scope=\"col\">scale removed</th></tr></thead>\n<tbody>\n{rows}</tbody>\n</table></div>\n"
    )
}

fn pass_rows(runs: &[RunReport], name: &str, columns: &[Column]) -> String {
    let of_run = |run: &RunReport| run.scores.passes.get(name).cloned();
    let first = of_run(&runs[0]);
    let mut text = String::new();
    for (i, run) in runs.iter().enumerate() {
        let scores = of_run(run);
        let cells = columns.iter().map(|(_, unit, of)| {
            let compared = if i > 0 { first.as_ref().and_then(of) } else { None };
            format!("<td>{}</td>", cell(scores.as_ref().and_then(of), compared, *unit))
        });
        let cells: String = cells.collect();
        let run_cell = if runs.len() > 1 { format!("<td>{}</td>", run_name(runs, i)) } else { String::new() };
        let head = match i {
            0 => format!("<th scope=\"rowgroup\" rowspan=\"{}\">{}</th>", runs.len(), escaped(name)),
            _ => String::new(),
        };
        let scale = scores.as_ref().map_or_else(|| "–".to_owned(), scale_words);
        let class = if i == 0 { " class=\"first\"" } else { "" };
        text += &format!("<tr{class}>{head}{run_cell}{cells}<td>{scale}</td></tr>\n");
    }
    text
}

/// The factors that were taken out before scoring.
fn scale_words(scores: &PassScores) -> String {
    let words = |[r, g, b]: [f64; 3]| format!("{r:.3}, {g:.3}, {b:.3}");
    match (scores.scaling, scores.scale_specular) {
        (Scaling::None, _) => "none".to_owned(),
        (Scaling::PerLayer, Some(specular)) => {
            format!("diffuse {}; specular {}", words(scores.scale), words(specular))
        }
        _ => words(scores.scale),
    }
}

/// A score that a run has once.
type Whole = (&'static str, Unit, fn(&Scores) -> Option<f64>);

const WHOLE: [Whole; 7] = [
    ("albedo PSNR, dB", DECIBEL, |s| s.albedo_psnr),
    ("normal error, mean °", DEGREES, |s| s.normal_deg),
    ("normal error, median °", DEGREES, |s| s.normal_median_deg),
    ("mask IoU", RATIO, |s| s.mask_iou),
    ("Chamfer distance", LENGTH, |s| s.chamfer),
    ("time of fits, s", AMOUNT, |s| s.fit_secs),
    ("peak memory, MiB", Unit { digits: 0, better: -1.0 }, |s| s.peak_rss_mib),
];

fn other_rows(runs: &[RunReport]) -> Vec<Row> {
    let row = |(heading, unit, of): &Whole| {
        let first = of(&runs[0].scores);
        let cell = |(i, run): (usize, &RunReport)| cell(of(&run.scores), first.filter(|_| i > 0), *unit);
        Row { heading: (*heading).to_owned(), cells: runs.iter().enumerate().map(cell).collect() }
    };
    let known = |(_, _, of): &&Whole| runs.iter().any(|run| of(&run.scores).is_some());
    WHOLE.iter().filter(known).map(row).collect()
}
