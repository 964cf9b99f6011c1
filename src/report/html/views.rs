//! Every view: ground truth, renders and errors of all runs, the worst view first.

use crate::report::heat::{LARGEST_ERROR, heat_color};
use crate::report::html::data::{PassViews, RunReport, ViewReport};
use crate::report::html::text::escaped;
use crate::report::scores::ViewScores;

/// Views of a pass that are shown at once; the others are folded.
const UNFOLDED: usize = 12;
/// Errors with a number on the scale.
const TICKS: [f32; 5] = [0.0, 0.01, 0.05, 0.1, LARGEST_ERROR];

/// The views of all passes that rendered.
pub fn section(runs: &[RunReport]) -> String {
    let mut passes: Vec<&str> = Vec::new();
    for pass in runs.iter().flat_map(|run| &run.views) {
        if !passes.contains(&pass.pass.as_str()) {
            passes.push(&pass.pass);
        }
    }
    let text: String = passes.iter().map(|pass| pass_views(runs, pass)).collect();
    let any_error = runs.iter().flat_map(|run| &run.views).flat_map(|pass| &pass.views);
    let scale = if any_error.clone().any(|view| view.error.is_some()) { scale() } else { String::new() };
    if text.is_empty() { text } else { scale + &text }
}

/// The scale of the error maps.
fn scale() -> String {
    let stops: Vec<String> = (0..=8u8)
        .map(|i| {
            let [r, g, b] = heat_color(f32::from(i) / 8.0);
            format!("rgb({r} {g} {b}) {:.1}%", f32::from(i) * 12.5)
        })
        .collect();
    let ticks: String = TICKS
        .iter()
        .map(|tick| {
            format!("<span style=\"left:{:.1}%\">{tick}</span>", 100.0 * (tick / LARGEST_ERROR).sqrt())
        })
        .collect();
    format!(
        "<p class=\"note\">Worst views first. A view opens under a wipe. Errors are means of |R|, |G|, |B| differences of linear values in [0, 1], \
         on one scale for all pictures:</p>\n<div class=\"scale\" role=\"img\" aria-label=\"Color scale of errors, from 0 (black) to {LARGEST_ERROR} (pale yellow)\">\
         <div style=\"background:linear-gradient(90deg,{})\"></div>{ticks}</div>\n",
        stops.join(",")
    )
}

/// A view as the runs have it.
struct Card<'a> {
    name: &'a str,
    of_run: Vec<Option<&'a ViewReport>>,
    scores: Vec<Option<&'a ViewScores>>,
}

impl Card<'_> {
    /// Its score in the first run that has one.
    fn psnr(&self) -> f64 {
        self.scores.iter().flatten().next().map_or(f64::INFINITY, |scores| scores.psnr)
    }
}

fn pass_views(runs: &[RunReport], pass: &str) -> String {
    let of_run: Vec<Option<&PassViews>> =
        runs.iter().map(|run| run.views.iter().find(|views| views.pass == pass)).collect();
    let cards = cards(runs, pass, &of_run);
    // Scored against photographs, if the run has scores of sRGB values.
    let photographs =
        runs.iter().filter_map(|run| run.scores.passes.get(pass)).any(|scores| scores.srgb.is_some());
    let drawn: Vec<String> = cards.iter().map(|card| drawn(runs, pass, card, photographs)).collect();
    let is_pair = |card: &Card| card.of_run.iter().flatten().any(|view| view.truth.is_some());
    let size = if cards.iter().any(is_pair) { "" } else { " small" };
    let (shown, folded) = drawn.split_at(UNFOLDED.min(drawn.len()));
    let more = match folded.len() {
        0 => String::new(),
        count => format!(
            "<details><summary>{count} more {}</summary>\n<div class=\"cards{size}\">\n{}</div>\n</details>\n",
            if count == 1 { "view" } else { "views" },
            folded.concat()
        ),
    };
    let left_out = of_run.iter().flatten().map(|views| views.left_out).max().unwrap_or(0);
    let elsewhere = match left_out {
        0 => String::new(),
        count => format!("<p class=\"note\">{count} more in the folder of the pass.</p>\n"),
    };
    let only = if runs.len() == 1 { runs[0].scores.passes.get(pass) } else { None };
    let score =
        only.map(|scores| format!(" <small>{}</small>", escaped(&scores.summary()))).unwrap_or_default();
    format!(
        "<h3>{}{score}</h3>\n<div class=\"cards{size}\">\n{}</div>\n{more}{elsewhere}",
        escaped(pass),
        shown.concat()
    )
}

/// The views of a pass that any run has, the worst first.
fn cards<'a>(runs: &'a [RunReport], pass: &str, of_run: &[Option<&'a PassViews>]) -> Vec<Card<'a>> {
    let mut names: Vec<&str> = Vec::new();
    for view in of_run.iter().flatten().flat_map(|views| &views.views) {
        if !names.contains(&view.name.as_str()) {
            names.push(&view.name);
        }
    }
    let scores_of = |run: &'a RunReport, name: &str| {
        run.scores.passes.get(pass)?.views.iter().find(|scores| scores.name == name)
    };
    let card = |name: &'a str| Card {
        name,
        of_run: of_run
            .iter()
            .map(|of| of.and_then(|of| of.views.iter().find(|view| view.name == name)))
            .collect(),
        scores: runs.iter().map(|run| scores_of(run, name)).collect(),
    };
    let mut cards: Vec<Card> = names.into_iter().map(card).collect();
    cards.sort_by(|a, b| a.psnr().total_cmp(&b.psnr()));
    cards
}

fn drawn(runs: &[RunReport], pass: &str, card: &Card, photographs: bool) -> String {
    let name = escaped(card.name);
    let several = runs.len() > 1;
    let label = |i: usize, what: &str| {
        if several { format!("{}: {what}", escaped(&runs[i].name)) } else { what.to_owned() }
    };
    let part = |class: &str, what: String, address: &str| {
        format!(
            "<span class=\"{class}\"><img src=\"{}\" alt=\"{what} of view {name}\" decoding=\"async\"><em>{what}</em></span>",
            escaped(address)
        )
    };
    let mut parts = Vec::new();
    let truth = card.of_run.iter().flatten().find_map(|view| view.truth.as_ref());
    // Runs stand below each other, beside the truth.
    let rows = if several && truth.is_some() { " several" } else { "" };
    if let Some(truth) = truth {
        parts.push(part("t", if photographs { "photograph" } else { "truth" }.to_owned(), truth));
    }
    for (i, view) in card.of_run.iter().enumerate() {
        let Some(view) = view else { continue };
        parts.extend(view.render.iter().map(|address| part("r", label(i, "render"), address)));
        parts.extend(view.error.iter().map(|address| part("e", label(i, "error"), address)));
    }
    let scores = card.scores.iter().enumerate().filter_map(|(i, scores)| {
        let scores = (*scores)?;
        let mark = if several { format!("<i class=\"mark c{i}\"></i>") } else { String::new() };
        Some(format!("<span>{mark}{:.2} dB, SSIM {:.4}</span>", scores.psnr, scores.ssim))
    });
    let scores: String = scores.collect();
    format!(
        "<figure class=\"card\"><button type=\"button\" class=\"strip{rows}\" data-view=\"{}: {name}\" aria-label=\"Compare the pictures of view {name}\">{}</button>\
         <figcaption><b>{name}</b>{scores}</figcaption></figure>\n",
        escaped(pass),
        parts.concat()
    )
}
