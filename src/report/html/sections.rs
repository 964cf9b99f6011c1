//! The parts of a report besides scores and views.

use crate::report::html::data::{FitLog, RunReport};
use crate::report::html::plot::{Plot, Series, svg};
use crate::report::html::tables::{TableRow, by_run, named_rows, run_name};
use crate::report::html::text::escaped;
use crate::report::profile::profile_table;

/// Values of a scene file longer than this are cut in tables.
const LONGEST_VALUE: usize = 120;

/// What comes first: how the runs ended, and the scores that one looks for.
pub fn lead(runs: &[RunReport]) -> String {
    let states = runs.iter().enumerate().map(|(i, run)| {
        let name = if runs.len() > 1 { format!("{} ", run_name(runs, i)) } else { String::new() };
        let error = run.error.as_ref().map(|error| format!("<p class=\"error\">{}</p>", escaped(error)));
        let state = escaped(&run.state);
        format!(
            "<p class=\"state\">{name}<b class=\"s-{state}\">{state}</b></p>{}",
            error.unwrap_or_default()
        )
    });
    let states: String = states.collect();
    let [run] = runs else { return states };
    let tile = |name: &str, value: String| format!("<div><dt>{}</dt><dd>{value}</dd></div>", escaped(name));
    let passes =
        run.scores.passes.iter().map(|(name, s)| tile(name, format!("{:.1} <small>dB</small>", s.psnr)));
    let whole = [
        run.scores.albedo_psnr.map(|v| tile("albedo", format!("{v:.1} <small>dB</small>"))),
        run.scores.normal_deg.map(|v| tile("normals", format!("{v:.2}<small>°</small>"))),
        run.scores.fit_secs.map(|v| tile("fit", format!("{v:.0} <small>s</small>"))),
        run.scores.peak_rss_mib.map(|v| tile("memory", format!("{v:.0} <small>MiB</small>"))),
    ];
    let tiles: String = passes.chain(whole.into_iter().flatten()).collect();
    if tiles.is_empty() { states } else { format!("{states}<dl class=\"tiles\">{tiles}</dl>") }
}

/// Lights and textures; those of one title side by side.
pub fn pictures(runs: &[RunReport]) -> String {
    let mut titles: Vec<&str> = Vec::new();
    for picture in runs.iter().flat_map(|run| &run.pictures) {
        if !titles.contains(&picture.title.as_str()) {
            titles.push(&picture.title);
        }
    }
    let figure = |title: &&str| {
        let of_run = runs.iter().enumerate().filter_map(|(i, run)| {
            let picture = run.pictures.iter().find(|picture| picture.title == **title)?;
            let of = if runs.len() > 1 { format!("{} · ", run_name(runs, i)) } else { String::new() };
            Some(format!(
                "<figure><img src=\"{}\" alt=\"{}\" decoding=\"async\"><figcaption>{of}{}</figcaption></figure>\n",
                escaped(&picture.address),
                escaped(title),
                escaped(title)
            ))
        });
        of_run.collect::<String>()
    };
    let figures: String = titles.iter().map(figure).collect();
    if figures.is_empty() { figures } else { format!("<div class=\"pictures\">\n{figures}</div>\n") }
}

/// What is plotted of a log: title, whether the axis is logarithmic, and the columns, of which the mean counts.
const PLOTS: [(&str, bool, &[&str]); 5] = [
    ("Loss", true, &["loss"]),
    ("PSNR of training pixels, dB", false, &["psnr"]),
    ("Roughness", false, &["roughness"]),
    ("Specular albedo, mean of R, G, B", false, &["specular_r", "specular_g", "specular_b"]),
    ("Lobes with 99 % of the light", false, &["lobes"]),
];

/// The curves of all fits, over steps and over seconds.
pub fn curves(runs: &[RunReport]) -> String {
    let over = |column: &str, label: &str| -> String {
        let charts = PLOTS.iter().map(|(title, logarithmic, columns)| {
            let series = runs.iter().enumerate().flat_map(|(i, run)| {
                run.logs.iter().enumerate().filter_map(move |(k, log)| {
                    let color = if runs.len() > 1 { i } else { k };
                    let name =
                        if runs.len() > 1 { format!("{}, {}", run.name, log.pass) } else { log.pass.clone() };
                    Some(Series { name, color, points: points(log, column, columns)? })
                })
            });
            svg(&Plot {
                title: (*title).to_owned(),
                across: label.to_owned(),
                logarithmic: *logarithmic,
                series: series.collect(),
            })
        });
        charts.collect()
    };
    let (steps, seconds) = (over("step", "steps"), over("elapsed_secs", "seconds"));
    if steps.is_empty() {
        return String::new();
    }
    let choice = |id: &str, label: &str, checked: &str| {
        format!("<label><input type=\"radio\" name=\"over\" id=\"{id}\"{checked}> over {label}</label>")
    };
    format!(
        "<div class=\"curves\"><div class=\"choice\" role=\"radiogroup\" aria-label=\"Horizontal axis\">{}{}</div>{}\n\
         <div class=\"charts steps\">\n{steps}</div>\n<div class=\"charts seconds\">\n{seconds}</div></div>\n",
        choice("over-steps", "steps", " checked"),
        choice("over-seconds", "seconds", ""),
        legend(runs)
    )
}

/// The colors of the curves: of runs, or of the fits of one run.
fn legend(runs: &[RunReport]) -> String {
    let names: Vec<&str> = match runs {
        [run] => run.logs.iter().map(|log| log.pass.as_str()).collect(),
        _ => runs.iter().map(|run| run.name.as_str()).collect(),
    };
    if names.len() < 2 {
        return String::new();
    }
    let entry =
        |(i, name): (usize, &&str)| format!("<span><i class=\"mark c{i}\"></i>{}</span>", escaped(name));
    format!("<p class=\"legend\">{}</p>", names.iter().enumerate().map(entry).collect::<String>())
}

/// The mean of columns over another; `None` if the log lacks one.
fn points(log: &FitLog, across: &str, columns: &[&str]) -> Option<Vec<[f64; 2]>> {
    let across = log.column(across)?;
    let columns: Vec<&[f64]> = columns.iter().map(|name| log.column(name)).collect::<Option<_>>()?;
    let mean =
        |i: usize| columns.iter().filter_map(|column| column.get(i)).sum::<f64>() / columns.len() as f64;
    Some(across.iter().enumerate().map(|(i, x)| [*x, mean(i)]).collect())
}

/// What the fits found and decided.
pub fn findings(runs: &[RunReport]) -> String {
    let rows = named_rows(runs, |run| {
        let cell = |finding: &crate::report::html::data::FitFinding| {
            let color = finding
                .color
                .map(|[r, g, b]| format!("<i class=\"swatch\" style=\"background:rgb({r} {g} {b})\"></i>"));
            (finding.what.clone(), format!("{}{}", color.unwrap_or_default(), escaped(&finding.value)))
        };
        run.findings.iter().map(cell).collect()
    });
    by_run(runs, "As the fits left it", &rows)
}

/// Time and memory of the passes, and what they said.
pub fn passes(runs: &[RunReport]) -> String {
    let rows = named_rows(runs, |run| {
        let cell = |pass: &crate::report::html::data::PassReport| {
            let secs = pass.secs.map_or_else(|| "–".to_owned(), seconds);
            let peak = pass.peak_rss_mib.map(|mib| format!(", {mib:.0} MiB")).unwrap_or_default();
            let state =
                if pass.state == "finished" { String::new() } else { format!("{} ", escaped(&pass.state)) };
            (pass.name.clone(), format!("{state}{secs}{peak}"))
        };
        run.passes.iter().map(cell).collect()
    });
    let table = by_run(runs, "Time of each pass; largest memory of the process until its end", &rows);
    let said: String = (0..runs.len()).map(|i| said(runs, i)).collect();
    table + &said
}

fn seconds(secs: f64) -> String {
    if secs < 100.0 {
        format!("{secs:.1} s")
    } else {
        format!("{} min {:02} s", secs as u64 / 60, secs as u64 % 60)
    }
}

/// The lines that a run told its user.
fn said(runs: &[RunReport], i: usize) -> String {
    let run = &runs[i];
    let lines = run.said.iter().chain(run.passes.iter().flat_map(|pass| &pass.said));
    let lines: Vec<String> = lines.map(|line| escaped(line)).collect();
    if lines.is_empty() {
        return String::new();
    }
    let of = if runs.len() > 1 { format!(" of {}", run_name(runs, i)) } else { String::new() };
    let open = if runs.len() > 1 { "" } else { " open" };
    format!(
        "<details{open}><summary>Lines of the run{of}</summary>\n<pre>{}</pre>\n</details>\n",
        lines.join("\n")
    )
}

/// The scene files: what differs, and their text.
pub fn scene(runs: &[RunReport]) -> String {
    let mut text = String::new();
    if runs.len() > 1 {
        let rows = named_rows(runs, |run| {
            run.fields.iter().map(|(path, value)| (path.clone(), escaped(&cut(value)))).collect()
        });
        let differs = |row: &TableRow| row.cells.iter().any(|cell| *cell != row.cells[0]);
        let rows: Vec<TableRow> = rows.into_iter().filter(differs).collect();
        text += &match rows.len() {
            0 => "<p>The scene files have the same values.</p>\n".to_owned(),
            _ => by_run(runs, "Values of the scene files that differ; – where a file leaves one out", &rows),
        };
    }
    for (i, run) in runs.iter().enumerate().filter(|(_, run)| !run.scene_text.is_empty()) {
        let of = if runs.len() > 1 { format!(" of {}", run_name(runs, i)) } else { String::new() };
        text += &format!(
            "<details><summary>Scene file{of}</summary>\n<pre>{}</pre>\n</details>\n",
            escaped(&run.scene_text)
        );
    }
    text
}

fn cut(value: &str) -> String {
    if value.chars().count() <= LONGEST_VALUE {
        return value.to_owned();
    }
    value.chars().take(LONGEST_VALUE).chain(['…']).collect()
}

/// The time of profiled runs, by part.
pub fn profiles(runs: &[RunReport]) -> String {
    let of_run = |(i, run): (usize, &RunReport)| {
        let table = profile_table(run.scores.profile.as_ref()?);
        let name = if runs.len() > 1 { format!("<h3>{}</h3>\n", run_name(runs, i)) } else { String::new() };
        Some(format!("{name}<pre class=\"table\">{}</pre>\n", escaped(&table)))
    };
    runs.iter().enumerate().filter_map(of_run).collect()
}

/// Version, seed, arguments, machine.
pub(crate) fn facts(runs: &[RunReport]) -> String {
    let escape = |(name, value): &(String, String)| (name.clone(), escaped(value));
    by_run(runs, "How to do it again", &named_rows(runs, |run| run.facts.iter().map(escape).collect()))
}
