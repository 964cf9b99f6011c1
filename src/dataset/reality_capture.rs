//! RealityCapture's layout: the CSV file of its export "Internal/External camera parameters", beside `images/` and `masks/`.
//!
//! Columns are found by their names, in a line below comments if there are any: `#name` (the photograph), `x`, `y`, `alt` (position),
//! `heading`, `pitch`, `roll` (degrees), `f` (focal length in millimeters on a frame whose longer side is 36 mm), and, if they are there,
//! `px`, `py` (principal point from the image's middle, in longer sides), `k1`, `k2`, `k3`, `t1`, `t2` (lens distortion as OpenCV's).
//! With all angles 0 the camera looks down (−z) and the top of the image is north (+y); roll turns it around the top of the image, pitch
//! around its right (east), heading clockwise seen from above. There is no test split: see
//! [`crate::dataset::DatasetOptions::hold_out`].

use crate::dataset::distortion::Distortion;
use crate::dataset::exports::Export;
use crate::dataset::lens::Lens;
use crate::dataset::load::read_text;
use crate::dataset::names::{ImageName, portable, quoted};
use crate::dataset::photographs::{Photographs, view_of};
use crate::dataset::plan::Plan;
use crate::dataset::pose::Rigid;
use crate::error::{Error, Result};
use csv::{Position, ReaderBuilder, StringRecord, Trim};
use glam::{DMat3, DVec3};
use std::path::Path;

/// Columns without which a file is not of this kind.
const NEEDED: [&str; 8] = ["name", "x", "y", "alt", "heading", "pitch", "roll", "f"];
/// Columns that are 0 if they are absent.
const OPTIONAL: [&str; 8] = ["px", "py", "k1", "k2", "k3", "k4", "t1", "t2"];
/// Width of the frame that focal lengths refer to, in millimeters.
const FRAME_MM: f64 = 36.0;
const EXPORT_HELP: &str = "Export it again: Alignment, Registration, Internal/External camera parameters, with commas between values.";

/// The only export with all columns.
const EXPORT_NAME: &str = "the export Internal/External camera parameters";

/// The file of cameras.
pub(super) const EXPORT: Export = Export {
    extension: "csv",
    mark: ".csv file with the columns #name, x, y, alt, heading, pitch, roll, f",
    is_head: has_columns,
    help: EXPORT_HELP,
};

fn has_columns(head: &str) -> bool {
    header(head).is_some()
}

/// The line with the names of columns, and how many lines are above it: empty ones and comments.
fn header(text: &str) -> Option<(usize, &str)> {
    first_lines(text).find(|(_, line)| missing_columns(line).is_empty())
}

/// Lines up to the first that is neither empty nor a comment, with their indices. That with the names of columns begins as a comment.
fn first_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let is_comment =
        |line: &str| line.trim().is_empty() || line.trim_start_matches('\u{feff}').starts_with('#');
    let comments = text.lines().take_while(|line| is_comment(line)).count();
    text.lines().enumerate().take(comments + 1)
}

fn missing_columns(line: &str) -> Vec<&'static str> {
    let names: Vec<String> = line.split(',').map(plain_name).collect();
    NEEDED.into_iter().filter(|needed| !names.iter().any(|name| name == needed)).collect()
}

/// What keeps a file in `dir` from being an export of this kind, if one nearly is.
pub(super) fn near_miss(dir: &Path) -> Option<String> {
    EXPORT.heads(dir).into_iter().find_map(|(file, head)| {
        if matches!(head.as_slice(), [0xff, 0xfe, ..] | [0xfe, 0xff, ..]) {
            return Some(format!("{} is UTF-16: save it as UTF-8.", file.display()));
        }
        let head = String::from_utf8_lossy(&head).replace([';', '\t'], ",");
        if has_columns(&head) {
            return Some(format!(
                "The values of {} are not separated by commas. {EXPORT_HELP}",
                file.display()
            ));
        }
        let missing = first_lines(&head).map(|(_, line)| missing_columns(line));
        let missing = missing.min_by_key(Vec::len).filter(|missing| has_position(missing))?;
        let columns = if missing.len() == 1 { "column" } else { "columns" };
        let (file, missing) = (file.display(), missing.join(", "));
        Some(format!("{file} has no {columns} {missing}, which {EXPORT_NAME} has. {EXPORT_HELP}"))
    })
}

/// Whether a file without these columns has the names and positions of photographs.
fn has_position(missing: &[&str]) -> bool {
    !NEEDED[..4].iter().any(|needed| missing.contains(needed))
}

/// A column's name as the constants have it.
fn plain_name(name: &str) -> String {
    name.trim().trim_start_matches('\u{feff}').trim_start_matches('#').to_ascii_lowercase()
}

/// Plans all views, in the order of the file.
pub(super) fn plan(dir: &Path) -> Result<Plan> {
    let file = &EXPORT.only(dir)?;
    let photographs = Photographs::find(dir, &["images", "image", ""])?;
    let mut views = Vec::new();
    for row in rows(file)? {
        let wrong = |problem: String| Error::input(file, &row.place, problem, EXPORT_HELP);
        let (image, mask) = photographs.called(ImageName::new(&portable(&row.name), file, &row.place)?)?;
        let lens = row.lens().map_err(wrong)?;
        let world_from_camera = row.pose().map_err(wrong)?;
        views.push(view_of(image, mask, file, row.place.clone(), lens, world_from_camera));
    }
    if views.is_empty() {
        return Err(Error::input(file, "", "the file has no cameras", EXPORT_HELP));
    }
    let notes = photographs.unused(&views).into_iter().collect();
    Ok(Plan { views, notes })
}

/// A camera as it stands in the file.
struct Row {
    name: String,
    place: String,
    /// Position, then heading, pitch and roll in degrees, then the focal length.
    needed: [f64; NEEDED.len() - 1],
    optional: [f64; OPTIONAL.len()],
}

fn rows(file: &Path) -> Result<Vec<Row>> {
    // The reader counts lines by single line breaks.
    let text = read_text(file)?.replace("\r\n", "\n");
    let above = header(&text).map_or(0, |(above, _)| above);
    let below = text.splitn(above + 1, '\n').last().unwrap_or_default();
    let place_of = |position: &Position| format!("line {}", position.line() + above as u64);
    let broken = |error: csv::Error| {
        let place = error.position().map(place_of).unwrap_or_default();
        Error::input(file, place, trouble(&error), EXPORT_HELP)
    };
    let mut reader = ReaderBuilder::new().trim(Trim::All).from_reader(below.as_bytes());
    let names: Vec<String> = reader.headers().map_err(broken)?.iter().map(plain_name).collect();
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(broken)?;
        let place = record.position().map(place_of).unwrap_or_default();
        let row = row_of(&names, &record, place.clone());
        rows.push(row.map_err(|problem| Error::input(file, place, problem, EXPORT_HELP))?);
    }
    Ok(rows)
}

/// What is wrong with a file that cannot be taken apart.
fn trouble(error: &csv::Error) -> String {
    match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("there are {len} values, not {expected_len} as in the line of names")
        }
        _ => format!("this is not CSV: {error}"),
    }
}

/// The camera of a line; `Err` says what is wrong.
fn row_of(names: &[String], record: &StringRecord, place: String) -> Result<Row, String> {
    let column = |wanted: &str| names.iter().position(|name| name == wanted);
    let value = |name: &str| number(record, column(name), name);
    let mut row = Row {
        name: record.get(column("name").unwrap_or(0)).unwrap_or_default().to_owned(),
        place,
        needed: [0.0; NEEDED.len() - 1],
        optional: [0.0; OPTIONAL.len()],
    };
    for (to, name) in row.needed.iter_mut().zip(&NEEDED[1..]) {
        *to = value(name)?.ok_or_else(|| format!("there is no column {name}"))?;
    }
    for (to, name) in row.optional.iter_mut().zip(OPTIONAL) {
        *to = value(name)?.unwrap_or(0.0);
    }
    Ok(row)
}

/// The finite number in a column, if there is such a column.
fn number(record: &StringRecord, column: Option<usize>, name: &str) -> Result<Option<f64>, String> {
    let Some(text) = column.and_then(|column| record.get(column)) else { return Ok(None) };
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(Some(value)),
        Ok(_) => Err(format!("{name} is {text}, which is not finite")),
        Err(_) => Err(format!("{name} is {}, which is not a number", quoted(text))),
    }
}

impl Row {
    /// `Err` says what is wrong.
    fn lens(&self) -> Result<Lens, String> {
        let [px, py, k1, k2, k3, k4, t1, t2] = self.optional;
        if k4 != 0.0 {
            return Err(format!(
                "k4 is {k4}: a fourth radial coefficient cannot be read (choose the distortion model Brown3)"
            ));
        }
        let focal = self.needed[6] / FRAME_MM;
        let distortion = Distortion::brown_conrady([k1, k2, k3], [t1, t2]);
        Ok(Lens { by_side: true, distortion, ..Lens::pinhole([focal; 2], [Some(px), Some(py)]) })
    }

    /// World_from_camera; `Err` says what is wrong.
    fn pose(&self) -> Result<Rigid, String> {
        let [x, y, alt, heading, pitch, roll, _] = self.needed;
        let translation = DVec3::new(x, y, alt);
        if !translation.as_vec3().is_finite() {
            return Err(format!("the position {translation} is too far away"));
        }
        let [heading, pitch, roll] = [heading, pitch, roll].map(f64::to_radians);
        let rotation =
            DMat3::from_rotation_z(-heading) * DMat3::from_rotation_x(pitch) * DMat3::from_rotation_y(roll);
        Ok(Rigid::new(rotation, translation).in_opencv_axes())
    }
}
