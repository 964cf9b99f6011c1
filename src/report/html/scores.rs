//! The tables of scores, with the differences of other runs from the first one.

use crate::report::html::data::RunReport;
use crate::report::html::tables::{TableRow, by_run, run_name};
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
    let linear = "Passes against their ground truth, in linear light, the mask eroded by a pixel";
    let mut text = pass_table(runs, linear, &COLUMNS, |_| true);
    let srgb = "Passes against photographs and other pictures of encoded colors, in sRGB: over the mask, and over all pixels on white and on black";
    text += &pass_table(runs, srgb, &SRGB_COLUMNS, |pass| pass.srgb.is_some());
    let orb =
        "Passes as Stanford-ORB scores them: each picture scaled by itself, the mask eroded by two pixels";
    text += &pass_table(runs, orb, &ORB_COLUMNS, |pass| pass.stanford_orb.is_some());
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

/// A column of a table of passes.
type Column = (&'static str, Show);

/// What is in a column: a score, or the factors that were taken out before scoring.
#[derive(Clone, Copy)]
enum Show {
    Score(Unit, fn(&PassScores) -> Option<f64>),
    Scale,
}

const COLUMNS: [Column; 4] = [
    ("PSNR dB", Show::Score(DECIBEL, |s| Some(s.psnr))),
    ("unscaled dB", Show::Score(DECIBEL, |s| Some(s.psnr_raw))),
    ("SSIM", Show::Score(RATIO, |s| Some(s.ssim))),
    ("scale removed", Show::Scale),
];

const SRGB_COLUMNS: [Column; 5] = [
    ("mask dB", Show::Score(DECIBEL, |s| srgb(s, |s| s.psnr_mask))),
    ("white dB", Show::Score(DECIBEL, |s| srgb(s, |s| s.psnr_white))),
    ("SSIM", Show::Score(RATIO, |s| srgb(s, |s| s.ssim_white))),
    ("black dB", Show::Score(DECIBEL, |s| srgb(s, |s| s.psnr_black))),
    ("SSIM", Show::Score(RATIO, |s| srgb(s, |s| s.ssim_black))),
];

const ORB_COLUMNS: [Column; 2] = [
    ("PSNR-H dB", Show::Score(DECIBEL, |s| s.stanford_orb.map(|s| s.psnr_hdr))),
    ("PSNR-L dB", Show::Score(DECIBEL, |s| s.stanford_orb.map(|s| s.psnr_ldr))),
];

fn srgb(scores: &PassScores, of: fn(&SrgbScores) -> f64) -> Option<f64> {
    scores.srgb.as_ref().map(of)
}

/// A row per run of each pass that counts in any run; empty if none does.
fn pass_table(
    runs: &[RunReport],
    caption: &str,
    columns: &[Column],
    counts: fn(&PassScores) -> bool,
) -> String {
    let mut names: Vec<&str> = Vec::new();
    for (name, scores) in runs.iter().flat_map(|run| &run.scores.passes) {
        if counts(scores) && !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    if names.is_empty() {
        return String::new();
    }
    let heads: String = columns.iter().map(|(name, _)| format!("<th scope=\"col\">{name}</th>")).collect();
    let run_head = if runs.len() > 1 { "<th scope=\"col\">run</th>" } else { "" };
    let rows: String = names.iter().map(|name| pass_rows(runs, name, columns)).collect();
    format!(
        "<div class=\"wide\"><table class=\"numbers\">\n<caption>{caption}</caption>\n\
         <thead><tr><th scope=\"col\">pass</th>{run_head}{heads}</tr></thead>\n<tbody>\n{rows}</tbody>\n</table></div>\n"
    )
}

fn pass_rows(runs: &[RunReport], name: &str, columns: &[Column]) -> String {
    let first = runs[0].scores.passes.get(name);
    let mut text = String::new();
    for (i, run) in runs.iter().enumerate() {
        let scores = run.scores.passes.get(name);
        let cells = columns.iter().map(|(_, show)| match show {
            Show::Score(unit, of) => cell(scores.and_then(of), first.filter(|_| i > 0).and_then(of), *unit),
            Show::Scale => scores.map_or_else(|| "–".to_owned(), scale_words),
        });
        let cells: String = cells.map(|cell| format!("<td>{cell}</td>")).collect();
        let run_cell = if runs.len() > 1 { format!("<td>{}</td>", run_name(runs, i)) } else { String::new() };
        let head = match i {
            0 => format!("<th scope=\"rowgroup\" rowspan=\"{}\">{}</th>", runs.len(), escaped(name)),
            _ => String::new(),
        };
        let class = if i == 0 { " class=\"first\"" } else { "" };
        text += &format!("<tr{class}>{head}{run_cell}{cells}</tr>\n");
    }
    text
}

/// The factors that were taken out before scoring.
fn scale_words(scores: &PassScores) -> String {
    let words = |[r, g, b]: [f64; 3]| format!("{r:.3}, {g:.3}, {b:.3}");
    match (scores.scaling, scores.scale_specular) {
        (Scaling::None, _) => "none".to_owned(),
        (Scaling::PerView, _) => format!("of each view; mean {}", words(scores.scale)),
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

fn other_rows(runs: &[RunReport]) -> Vec<TableRow> {
    let row = |(heading, unit, of): &Whole| {
        let first = of(&runs[0].scores);
        let cell = |(i, run): (usize, &RunReport)| cell(of(&run.scores), first.filter(|_| i > 0), *unit);
        TableRow { heading: (*heading).to_owned(), cells: runs.iter().enumerate().map(cell).collect() }
    };
    let known = |(_, _, of): &&Whole| runs.iter().any(|run| of(&run.scores).is_some());
    WHOLE.iter().filter(known).map(row).collect()
}
