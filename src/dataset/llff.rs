//! The layout of LLFF and NeRD: `poses_bounds.npy`, `images/`, `masks/`.
//!
//! The n-th row of `poses_bounds.npy` has 17 numbers and belongs to the n-th photograph by name: a 3×5 matrix, row by row, and the depths
//! of the nearest and farthest points, which are not needed. The first four columns are world_from_camera with the axes down, right and
//! backward, and the position; the last is height, width and focal length in pixels. Photographs may be scaled versions of that
//! size, in `images_4` and the like if there is no `images`. Masks have the names of the photographs, or their order. There is no
//! test split: see [`crate::dataset::DatasetOptions::hold_out`].

use crate::codec::file;
use crate::codec::nearby::missing_file_help;
use crate::codec::npy::{Matrix, parse_matrix};
use crate::dataset::lens::Lens;
use crate::dataset::photographs::{Photographs, view_of};
use crate::dataset::plan::Plan;
use crate::dataset::pose::Rigid;
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Folders of photographs, in the order in which they are looked for.
const FOLDERS: [&str; 6] = ["images", "images_1", "images_2", "images_4", "images_8", "image"];
const COLUMNS: usize = 17;
/// Bytes of a row of double precision.
const MOST_ROW_BYTES: u64 = 8 * COLUMNS as u64;
const HELP: &str = "A row has 17 numbers: a 3×5 matrix of axes (down, right, backward), position, and height, width and focal \
                    length; then two depths.";

/// The file of cameras.
pub(crate) fn camera_file(dir: &Path) -> PathBuf {
    dir.join("poses_bounds.npy")
}

/// Plans all views, in the order of their names.
pub(super) fn plan(dir: &Path) -> Result<Plan> {
    let file = camera_file(dir);
    let wrong = |place: &str, problem: String| Error::input(&file, place, problem, HELP);
    let opened = file::open(&file, missing_file_help)?;
    let length = opened.get_ref().metadata().map_err(Error::io("read", &file))?.len();
    let photographs = Photographs::find(dir, &FOLDERS)?;
    let most = photographs.most_bytes(&file, length, MOST_ROW_BYTES)?;
    let bytes = file::read_up_to(&file, most, missing_file_help)?;
    let Matrix { rows, columns, values } =
        parse_matrix(&bytes).map_err(|problem| wrong("", format!("the file {problem}")))?;
    if columns != COLUMNS {
        return Err(wrong("", format!("the array has {columns} columns, not {COLUMNS}")));
    }
    let photographs = photographs.in_order(&file, rows)?;
    let mut views = Vec::with_capacity(rows);
    for ((n, (image, mask)), row) in photographs.into_iter().enumerate().zip(values.chunks_exact(COLUMNS)) {
        let place = format!("row {n}");
        let (lens, world_from_camera) = camera_of_row(row).map_err(|problem| wrong(&place, problem))?;
        views.push(view_of(image, mask, &file, place, lens, world_from_camera));
    }
    Ok(Plan { views, notes: Vec::new() })
}

/// Lens and world_from_camera; `Err` says what is wrong.
fn camera_of_row(row: &[f64]) -> Result<(Lens, Rigid), String> {
    let at = |i: usize, j: usize| row[5 * i + j];
    let [height, width, focal] = [at(0, 4), at(1, 4), at(2, 4)];
    let is_size = |value: f64| value.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&value);
    if !(is_size(height) && is_size(width)) {
        return Err(format!("the image size {width}×{height} is not whole numbers above 0"));
    }
    // Right, down, forward.
    let axes = |i: usize| [at(i, 1), at(i, 0), -at(i, 2), at(i, 3)];
    let rows = [axes(0), axes(1), axes(2), [0.0, 0.0, 0.0, 1.0]].concat();
    let rows: [f64; 16] = rows.try_into().map_err(|_| "the pose is not 3×4".to_owned())?;
    let world_from_camera = Rigid::from_rows(&rows).map_err(|problem| format!("the pose {problem}"))?;
    let size = Some([width as u32, height as u32]);
    let lens = Lens { size, resizable: true, ..Lens::pinhole([focal; 2], [None; 2]) };
    Ok((lens, world_from_camera))
}
