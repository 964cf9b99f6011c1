//! The layout of IDR, NeuS and VolSDF: `cameras_sphere.npz` (or `cameras.npz`), `image/`, `mask/`.
//!
//! The n-th photograph by name has the 3×4 or 4×4 projection matrix `world_mat_n`, from the world of the capture to pixels, up to
//! scale. It is taken apart into calibration and pose. `scale_mat_n`, which maps the ball around the object that these programs work in
//! to that world, is not needed: views, and what is exported, are in the world of the capture. Pixel centers are at integers. Masks
//! have the names of the photographs, or their order. There is no test split: see
//! [`crate::dataset::DatasetOptions::hold_out`].

use crate::codec::file::is_there;
use crate::codec::nearby::missing_file_help;
use crate::codec::npy::Matrix;
use crate::codec::npz::Npz;
use crate::dataset::lens::Lens;
use crate::dataset::photographs::{Photographs, view_of};
use crate::dataset::plan::Plan;
use crate::dataset::pose::Rigid;
use crate::error::{Error, Result};
use glam::{DMat3, DVec3};
use std::path::{Path, PathBuf};

/// Files of cameras, in the order in which they are looked for.
const CAMERA_FILES: [&str; 3] = ["cameras_sphere.npz", "cameras_large.npz", "cameras.npz"];
/// The volume that the rows of a 3×3 matrix span, relative to their lengths, below which it counts as singular.
const LEAST_VOLUME: f64 = 1e-9;
const HELP: &str =
    "world_mat_n is the 4×4 matrix that projects points of the world to pixels of the n-th photograph.";

/// The file of cameras, if the folder has one.
pub(crate) fn camera_file(dir: &Path) -> Option<PathBuf> {
    CAMERA_FILES.iter().map(|name| dir.join(name)).find(|file| is_there(file))
}

/// Plans all views, in the order of their names.
pub(super) fn plan(dir: &Path) -> Result<Plan> {
    let file = camera_file(dir).unwrap_or_else(|| dir.join(CAMERA_FILES[0]));
    let mut cameras = Npz::open(&file, missing_file_help)?;
    let count = camera_count(&file, &cameras.names())?;
    let photographs = Photographs::find(dir, &["image", "images", "rgb"])?.in_order(&file, count)?;
    let mut views = Vec::with_capacity(count);
    for (n, (image, mask)) in photographs.into_iter().enumerate() {
        let place = format!("`world_mat_{n}`");
        let wrong = |problem: String| Error::input(&file, &place, problem, HELP);
        let matrix = cameras.matrix(&format!("world_mat_{n}"))?;
        let matrix = matrix.ok_or_else(|| wrong("the matrix is missing".to_owned()))?;
        let (lens, world_from_camera) =
            taken_apart(&matrix).map_err(|problem| wrong(format!("the matrix {problem}")))?;
        views.push(view_of(image, mask, &file, place, lens, world_from_camera));
    }
    Ok(Plan { views, notes: Vec::new() })
}

/// How many matrices `world_mat_n` there are; their numbers must be those from 0 on.
fn camera_count(file: &Path, names: &[String]) -> Result<usize> {
    let numbers = names.iter().filter_map(|name| name.strip_prefix("world_mat_")?.parse::<usize>().ok());
    let mut numbers: Vec<usize> = numbers.collect();
    numbers.sort_unstable();
    if numbers.is_empty() {
        let near: Vec<&str> = names.iter().take(4).map(String::as_str).collect();
        let problem = "there is no `world_mat_0`, so there are no cameras";
        let help =
            if near.is_empty() { HELP.to_owned() } else { format!("{HELP} There is {}.", near.join(", ")) };
        return Err(Error::input(file, "", problem, help));
    }
    match numbers.iter().enumerate().find(|(n, number)| n != *number) {
        Some((n, _)) => {
            let problem = format!("`world_mat_{n}` is missing, but others follow");
            Err(Error::input(file, "", problem, HELP))
        }
        None => Ok(numbers.len()),
    }
}

/// Lens and world_from_camera of a projection matrix K [R | t], which is given up to a factor. `Err` is a clause that follows
/// "the matrix".
pub(super) fn taken_apart(matrix: &Matrix) -> Result<(Lens, Rigid), String> {
    if !matches!((matrix.rows, matrix.columns), (3 | 4, 4)) {
        return Err(format!("is {}×{}, not 4×4", matrix.rows, matrix.columns));
    }
    if let Some(i) = matrix.values.iter().position(|value| !value.is_finite()) {
        return Err(format!("has a NaN or infinite value in row {}, column {}", i / 4 + 1, i % 4 + 1));
    }
    let row = |i: usize| DVec3::from_slice(&matrix.values[4 * i..4 * i + 3]);
    let mut linear = DMat3::from_cols(row(0), row(1), row(2));
    let mut last = DVec3::new(matrix.values[3], matrix.values[7], matrix.values[11]);
    // The largest entry as the unit, so that no product overflows.
    let unit = linear.to_cols_array().into_iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let scale = if linear.determinant() < 0.0 { -unit } else { unit };
    linear *= 1.0 / scale;
    last /= scale;
    let volume =
        linear.determinant() / (linear.x_axis.length() * linear.y_axis.length() * linear.z_axis.length());
    if volume.is_nan() || volume <= LEAST_VOLUME {
        return Err("is singular: it is no camera's".to_owned());
    }
    // Rows of K R from the last one: each is a combination of rows of R that begins one row later.
    let depth = linear.z_axis.length();
    let forward = linear.z_axis / depth;
    let [first, second] = [linear.x_axis / depth, linear.y_axis / depth];
    let center = [first.dot(forward), second.dot(forward)];
    let second = second - center[1] * forward;
    let down = second.normalize();
    let skew = first.dot(down);
    let first = first - center[0] * forward - skew * down;
    let focal = [first.length(), second.length()];
    let position = -(linear.transpose().inverse() * last);
    if !position.as_vec3().is_finite() {
        return Err("puts the camera at infinity".to_owned());
    }
    let rotation = DMat3::from_cols(first.normalize(), down, forward);
    let lens = Lens { skew, ..Lens::pinhole(focal, center.map(Some)) };
    Ok((lens, Rigid::new(rotation, position)))
}
