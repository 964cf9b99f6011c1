//! The page of many units: how many are done, a row each, and their films.

use crate::jobs::unit::{JoinedFilm, NOT_BEGUN, UnitRow, scored_passes};
use crate::report::html::text::escaped;
use crate::report::html::{REPORT, SIGNATURE, STYLE};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// The page. Its links lead into the folders of the units, beside which it lies.
pub(super) fn page(out: &Path, units: &[UnitRow], films: &[JoinedFilm]) -> String {
    let full = out.canonicalize().unwrap_or_else(|_| out.to_owned());
    let name = full.file_name().map_or_else(|| "units".into(), |name| name.to_string_lossy().into_owned());
    let (title, style, version) = (escaped(&name), STYLE, escaped(env!("LOBELIA_VERSION")));
    let (words, rows, films) = (words(units), rows(units), film_words(films));
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta {SIGNATURE}>\n\
        <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
        <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data:\">\n\
        <meta name=\"color-scheme\" content=\"light dark\">\n<link rel=\"icon\" href=\"data:,\">\n\
        <title>{title}</title>\n<style>\n{style}\n</style>\n</head>\n<body>\n<header>\n<h1>{title}</h1>\n<p>{words}</p>\n</header>\n\
        <main>\n{films}<section>\n{rows}</section>\n</main>\n<footer>Report by Lobelia {version}</footer>\n</body>\n</html>\n"
    )
}

/// How many units are in each state.
pub(super) fn words(units: &[UnitRow]) -> String {
    let mut states: BTreeMap<&str, usize> = BTreeMap::new();
    units.iter().for_each(|(_, outcome)| *states.entry(&outcome.state).or_default() += 1);
    let parts: Vec<String> =
        states.iter().map(|(state, count)| format!("{count} {}", escaped(state))).collect();
    format!("{} units: {}", units.len(), parts.join(", "))
}

fn film_words(films: &[JoinedFilm]) -> String {
    let word = |film: &JoinedFilm| {
        let name = escaped(&film.file.file_name().unwrap_or_default().to_string_lossy());
        let link = if film.is_joined() { format!("<a href=\"{name}\">{name}</a>") } else { name };
        format!("<p>{link}: {}</p>\n", escaped(&film.words()))
    };
    films.iter().map(word).collect()
}

fn rows(units: &[UnitRow]) -> String {
    let passes = scored_passes(units);
    let heads = passes.iter().map(|pass| format!("<th scope=\"col\">{} dB</th>", escaped(pass)));
    let mut table = format!(
        "<table>\n<thead><tr><th scope=\"col\">unit</th><th scope=\"col\">state</th>{}<th scope=\"col\">albedo dB</th><th scope=\"col\">s</th><th scope=\"col\">MiB</th></tr></thead>\n<tbody>\n",
        heads.collect::<String>()
    );
    for (name, outcome) in units {
        let number = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "<td>–</td>".to_owned(), |value| format!("<td>{value:.digits$}</td>"))
        };
        let score = |pass: &String| {
            let found = outcome.scores.iter().find(|(scored, _)| scored == pass);
            number(found.map(|(_, score)| score[0]), 2)
        };
        let scores: String = passes.iter().map(score).collect();
        let name = escaped(name);
        let state = escaped(
            &outcome
                .error
                .as_ref()
                .map_or_else(|| outcome.state.clone(), |error| format!("{}: {error}", outcome.state)),
        );
        let has_begun = outcome.state != NOT_BEGUN;
        let link = if has_begun { format!("<a href=\"{name}/{REPORT}\">{name}</a>") } else { name };
        let secs = number(has_begun.then_some(outcome.secs), 1);
        let (albedo, memory) = (number(outcome.albedo_psnr, 2), number(outcome.peak_rss_mib, 0));
        // Writing to a String cannot fail.
        let _ = writeln!(
            table,
            "<tr><th scope=\"row\">{link}</th><td>{state}</td>{scores}{albedo}{secs}{memory}</tr>"
        );
    }
    table + "</tbody>\n</table>\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pass::summary::Outcome;

    #[test]
    fn the_page_has_a_row_for_each_unit_and_no_markup_of_theirs() {
        let good = Outcome {
            state: "finished".into(),
            scores: vec![("novel".into(), [31.25, 0.9])],
            ..Outcome::default()
        };
        let bad = Outcome { state: "failed".into(), error: Some("<script>".into()), ..Outcome::default() };
        let units = [("vase".to_owned(), good), ("jug".to_owned(), bad)];
        let film = JoinedFilm {
            file: "/jobs/museum/turn.mp4".into(),
            there: 3,
            frames: 48,
            ..JoinedFilm::default()
        };
        let page = page(Path::new("/jobs/museum"), &units, &[film]);
        assert!(
            page.contains("2 units: 1 failed, 1 finished") && page.contains("href=\"vase/report.html\""),
            "{page}"
        );
        assert!(page.contains("31.25") && page.contains("3 of 48 frames") && page.contains("&lt;script&gt;"));
        assert!(page.contains(SIGNATURE) && !page.contains("<script>"));
    }
}
