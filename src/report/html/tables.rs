//! Tables with a row per value and a column per run.

use crate::report::html::data::RunReport;
use crate::report::html::text::escaped;

/// A row of a table: its heading, and a cell of HTML per run.
pub struct TableRow {
    /// The heading, as text.
    pub heading: String,
    /// The cells, as HTML.
    pub cells: Vec<String>,
}

/// A table in which a row is one value of all runs. Empty if there is no row.
pub(crate) fn by_run(runs: &[RunReport], caption: &str, rows: &[TableRow]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let head = if runs.len() > 1 {
        format!("<thead><tr><td></td>{}</tr></thead>\n", run_heads(runs))
    } else {
        String::new()
    };
    let rows = rows.iter().map(|row| {
        let cells: String = row.cells.iter().map(|cell| format!("<td>{cell}</td>")).collect();
        format!("<tr><th scope=\"row\">{}</th>{cells}</tr>\n", escaped(&row.heading))
    });
    let rows: String = rows.collect();
    format!(
        "<div class=\"wide\"><table>\n<caption>{}</caption>\n{head}<tbody>\n{rows}</tbody>\n</table></div>\n",
        escaped(caption)
    )
}

/// Headings of columns: the runs' names, each with its color.
fn run_heads(runs: &[RunReport]) -> String {
    (0..runs.len()).map(|i| format!("<th scope=\"col\">{}</th>", run_name(runs, i))).collect()
}

/// The name of a run, with the mark of its color where there are several.
pub(crate) fn run_name(runs: &[RunReport], i: usize) -> String {
    let mark = if runs.len() > 1 { format!("<i class=\"mark c{i}\"></i>") } else { String::new() };
    format!("{mark}{}", escaped(&runs[i].name))
}

/// Rows of named values: one for each name that any run has, in the order in which names come up.
pub(crate) fn named_rows(
    runs: &[RunReport],
    values: impl Fn(&RunReport) -> Vec<(String, String)>,
) -> Vec<TableRow> {
    let values: Vec<Vec<(String, String)>> = runs.iter().map(values).collect();
    let mut names: Vec<&String> = Vec::new();
    for (name, _) in values.iter().flatten() {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let cell = |of: &Vec<(String, String)>, wanted: &String| {
        of.iter().find(|(name, _)| name == wanted).map_or_else(|| "–".to_owned(), |(_, cell)| cell.clone())
    };
    let row = |name: &&String| TableRow {
        heading: (*name).clone(),
        cells: values.iter().map(|of| cell(of, name)).collect(),
    };
    names.iter().map(row).collect()
}
