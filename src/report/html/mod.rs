//! The report of a run, or of several side by side: one HTML file that holds everything, pictures included, and asks no server for
//! anything.
//!
//! | module | holds |
//! | --- | --- |
//! | [`data`] | what a report shows of a run |
//! | [`text`] | text of users' files inside HTML |
//! | [`plot`] | curves as SVG |
//! | [`tables`] | tables of values with a column per run |
//! | [`scores`] | the tables of scores, with differences |
//! | [`views`] | every view: truth, renders and errors |
//! | [`sections`] | the other parts of the page |
//! | `assets/` | the page around them, its style and its script |
//!
//! Everything is readable without the script, which only adds the wipe.

pub mod data;
pub mod plot;
pub mod scores;
pub mod sections;
pub mod tables;
pub mod text;
pub mod views;

use crate::error::{Error, Result};
use data::RunReport;
use text::escaped;

/// The file name of a report in the folder of its run.
pub const REPORT: &str = "report.html";

/// What every report has in its head.
pub const SIGNATURE: &str = r#"name="generator" content="Lobelia report""#;

/// Most runs side by side: each has a color of its own.
pub(crate) const MOST_RUNS: usize = 8;

/// The page without its content.
const PAGE: &str = include_str!("assets/report.html");
/// Its style, which other pages of a run share.
pub const STYLE: &str = include_str!("assets/report.css");
/// Its script, likewise.
pub const SCRIPT: &str = include_str!("assets/report.js");

/// A part of the page: its identifier, its heading and its content, which is empty if the runs have nothing for it.
type Section = (&'static str, &'static str, String);

/// The page of one run, or of several side by side; the first one is what the others are compared with.
///
/// # Errors
/// [`Error::Usage`] for no run, or more than `MOST_RUNS`.
pub fn html(runs: &[RunReport]) -> Result<String> {
    if runs.is_empty() || runs.len() > MOST_RUNS {
        let problem = format!("a report shows 1 to {MOST_RUNS} runs, not {}", runs.len());
        return Err(Error::usage(problem, "Give the output folders of fewer runs."));
    }
    let sections: [Section; 9] = [
        ("scores", "Scores", scores::section(runs)),
        ("views", "Views", views::section(runs)),
        ("light", "Light and textures", sections::pictures(runs)),
        ("curves", "Curves", sections::curves(runs)),
        ("found", "What was found", sections::findings(runs)),
        ("passes", "Passes: time and memory", sections::passes(runs)),
        ("profile", "Where the time goes", sections::profiles(runs)),
        ("scene", "Scene", sections::scene(runs)),
        ("run", "Run", sections::facts(runs)),
    ];
    let sections: Vec<&Section> = sections.iter().filter(|(_, _, content)| !content.is_empty()).collect();
    let links = sections.iter().map(|(id, heading, _)| format!("<a href=\"#{id}\">{heading}</a>"));
    let body = sections.iter().map(|(id, heading, content)| {
        format!("<section id=\"{id}\" aria-labelledby=\"{id}-h\">\n<h2 id=\"{id}-h\">{heading}</h2>\n{content}</section>\n")
    });
    let title = title(runs);
    let slots = [
        ("{{TITLE}}", escaped(&title)),
        ("{{STYLE}}", STYLE.to_owned()),
        ("{{HEADING}}", escaped(&title)),
        ("{{LEAD}}", sections::lead(runs)),
        ("{{LINKS}}", links.collect::<Vec<_>>().join("\n")),
        ("{{BODY}}", body.collect()),
        ("{{VERSION}}", escaped(env!("LOBELIA_VERSION"))),
        ("{{SCRIPT}}", SCRIPT.to_owned()),
    ];
    filled(PAGE, &slots)
}

/// The dialog of the wipe, for other pages with views and the script.
pub fn wipe_dialog() -> &'static str {
    const END: &str = "</dialog>";
    let dialog = PAGE.find("<dialog").zip(PAGE.find(END));
    dialog.map_or("", |(start, end)| &PAGE[start..end + END.len()])
}

fn title(runs: &[RunReport]) -> String {
    runs.iter().map(|run| run.name.as_str()).collect::<Vec<_>>().join(" · ")
}

/// A page with values in its slots, which come in this order: one pass over the page, so that nothing of the values is taken for a slot.
///
/// # Errors
/// [`Error::Run`] if the page lacks a slot.
pub fn filled(page: &str, slots: &[(&str, String)]) -> Result<String> {
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

#[cfg(test)]
mod tests;
