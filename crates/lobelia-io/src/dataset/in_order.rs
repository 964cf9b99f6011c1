//! Layouts whose n-th camera belongs to the n-th photograph by name, as the manual's chapter on
//! layouts tells them: IDR's, NeuS's and VolSDF's, LLFF's and NeRD's. Masks have the names of the
//! photographs, or their order.
//!
//! **IDR**: the 3×4 or 4×4 matrix `world_mat_n` projects the world of the capture to pixels, up to
//! scale; pixel centers are at integers.
//!
//! **LLFF**: a row of 17 numbers is a 3×5 matrix, row by row, and two depths. The first four
//! columns are world_from_camera with the axes down, right and backward, and the position; the last
//! is height, width and focal length in pixels, of which photographs may be scaled versions.

use crate::codec::npy::{Matrix, Npz, parse_matrix};
use crate::codec::{file::is_there, file::read_up_to, nearby::missing_file_help};
use crate::dataset::files::{
    StemIndex, file_name, find_mask, image_files, mask_file, mask_folder, refusal_of_unread, view_name,
};
use crate::dataset::lens::{Lens, whole_size};
use crate::dataset::pose::{Rigid, check_finite};
use crate::dataset::views::{Plan, ViewPlan};
use glam::{DMat3, DVec3};
use lobelia_geometry::{Error, Result};
use std::path::{Path, PathBuf};

/// IDR's files of cameras, in the order in which they are looked for.
const IDR_FILES: [&str; 3] = ["cameras_sphere.npz", "cameras_large.npz", "cameras.npz"];
const IDR_PHOTOGRAPHS: [&str; 3] = ["image", "images", "rgb"];
const IDR_HELP: &str =
    "world_mat_n is the 4×4 matrix that projects points of the world to pixels of the n-th photograph.";
/// The volume that the rows of a 3×3 matrix span, relative to their lengths, below which it counts
/// as singular.
const LEAST_VOLUME: f64 = 1e-9;
const LLFF_PHOTOGRAPHS: [&str; 6] = ["images", "images_1", "images_2", "images_4", "images_8", "image"];
const LLFF_COLUMNS: usize = 17;
/// Most bytes of LLFF's file: half a million cameras.
const LLFF_BYTES: u64 = 64 << 20;
const LLFF_HELP: &str = "A row has 17 numbers: a 3×5 matrix of axes (down, right, backward), position, and height, width and focal \
                         length; then two depths.";

/// IDR's file of cameras, if the folder has one.
pub(super) fn idr_file(dir: &Path) -> Option<PathBuf> {
    IDR_FILES.iter().map(|name| dir.join(name)).find(|file| is_there(file))
}

/// LLFF's file of cameras.
pub(super) fn llff_file(dir: &Path) -> PathBuf {
    dir.join("poses_bounds.npy")
}

/// Where a camera is in its file, its lens and world_from_camera.
type PlacedCamera = (String, Lens, Rigid);

/// Plans all views of IDR's layout, in the order of their names.
pub(super) fn plan_idr(dir: &Path) -> Result<Plan> {
    let file = idr_file(dir).unwrap_or_else(|| dir.join(IDR_FILES[0]));
    let mut archive = Npz::open(&file, missing_file_help)?;
    let names = archive.names();
    // There is world_mat_inv_0 as well.
    let number = |name: &String| name.strip_prefix("world_mat_")?.parse::<usize>().ok();
    let count = names.iter().filter_map(number).count();
    let mut cameras: Vec<PlacedCamera> = Vec::with_capacity(count);
    for n in 0..count.max(1) {
        let place = format!("`world_mat_{n}`");
        let wrong = |problem: String| Error::input(&file, &place, problem, IDR_HELP);
        let matrix = archive.matrix(&format!("world_mat_{n}"))?.ok_or_else(|| {
            let others = names.iter().take(4).map(String::as_str).collect::<Vec<_>>().join(", ");
            wrong(format!("the matrix is missing; the file has {others}"))
        })?;
        let (lens, pose) = taken_apart(&matrix).map_err(|problem| wrong(format!("the matrix {problem}")))?;
        cameras.push((place, lens, pose));
    }
    views_in_order(dir, &IDR_PHOTOGRAPHS, &file, cameras)
}

/// Plans all views of LLFF's layout, in the order of their names.
pub(super) fn plan_llff(dir: &Path) -> Result<Plan> {
    let file = llff_file(dir);
    let wrong = |place: &str, problem: String| Error::input(&file, place, problem, LLFF_HELP);
    let matrix = parse_matrix(&read_up_to(&file, LLFF_BYTES, missing_file_help)?);
    let Matrix { columns, values, .. } =
        matrix.map_err(|problem| wrong("", format!("the file {problem}")))?;
    if columns != LLFF_COLUMNS {
        return Err(wrong("", format!("the array has {columns} columns, not {LLFF_COLUMNS}")));
    }
    let mut cameras: Vec<PlacedCamera> = Vec::new();
    for (n, row) in values.chunks_exact(LLFF_COLUMNS).enumerate() {
        let place = format!("row {n}");
        let (lens, pose) = camera_of_row(row).map_err(|problem| wrong(&place, problem))?;
        cameras.push((place, lens, pose));
    }
    views_in_order(dir, &LLFF_PHOTOGRAPHS, &file, cameras)
}

/// The views of these cameras, whose photographs are in the first of `folders` below `dir` that has
/// any, in the order of their names. If no mask has the name of a photograph, masks belong to
/// photographs in the order of their names.
fn views_in_order(
    dir: &Path,
    folders: &[&str],
    camera_file: &Path,
    cameras: Vec<PlacedCamera>,
) -> Result<Plan> {
    let there = folders.iter().map(|name| dir.join(name)).filter(|folder| is_there(folder));
    let photographs = there
        .map(|folder| image_files(&folder))
        .find(|files| !matches!(files, Ok(files) if files.is_empty()));
    let Some(photographs) = photographs.transpose()? else {
        let refusal = folders.iter().find_map(|name| refusal_of_unread(&dir.join(name), None));
        return Err(refusal.unwrap_or_else(|| {
            let problem = format!("there are no photographs: looked for images in {}", folders.join(", "));
            Error::input(dir, "", problem, missing_file_help(&dir.join(folders[0])))
        }));
    };
    let folder = photographs[0].parent().unwrap_or(dir).display();
    let count = photographs.len();
    if count != cameras.len() {
        let problem = format!("there are {} cameras, but {count} photographs in {folder}", cameras.len());
        let help = "Cameras belong to photographs in the order of their names: add what is missing, or remove what has no camera.";
        return Err(Error::input(camera_file, "", problem, help));
    }
    let names = || photographs.iter().map(|file| file_name(file));
    let masks = match mask_folder(dir).map(|folder| StemIndex::of_folder(&folder)).transpose()?.flatten() {
        None => vec![None; count],
        Some(masks) if names().any(|name| mask_file(&masks, &name).is_some()) => {
            names().map(|name| find_mask(&masks, &name).map(Some)).collect::<Result<_>>()?
        }
        Some(masks) => {
            let files = image_files(&masks.folder)?;
            if files.len() != count {
                let problem =
                    format!("there are {} masks here, but {count} photographs in {folder}", files.len());
                let help = "Give each photograph a mask of the same name.";
                return Err(Error::input(&masks.folder, "", problem, help));
            }
            files.into_iter().map(Some).collect()
        }
    };
    let views = photographs.iter().zip(masks).zip(cameras).map(|((image, mask), (place, lens, pose))| {
        let (name, camera_file) = (view_name(&file_name(image)), camera_file.to_owned());
        ViewPlan { name, camera_file, place, image: Some(image.clone()), mask, lens, pose }
    });
    Ok(Plan { views: views.collect(), notes: Vec::new() })
}

/// Lens and world_from_camera of a row of LLFF's array. `Err` says what is wrong.
fn camera_of_row(row: &[f64]) -> Result<(Lens, Rigid), String> {
    let at = |i: usize, j: usize| row[5 * i + j];
    let size = whole_size([at(1, 4), at(0, 4)])?;
    // Right, down, forward.
    let axes = |i: usize| [at(i, 1), at(i, 0), -at(i, 2), at(i, 3)];
    let rows = [axes(0), axes(1), axes(2), [0.0, 0.0, 0.0, 1.0]];
    let pose = Rigid::from_rows(rows.as_flattened()).map_err(|problem| format!("the pose {problem}"))?;
    let lens = Lens { size: Some(size), resizable: true, ..Lens::pinhole([at(2, 4); 2], [None; 2]) };
    Ok((lens, pose))
}

/// Lens and world_from_camera of a projection matrix K [R | t], which is given up to a factor.
/// `Err` is a clause that follows "the matrix".
fn taken_apart(matrix: &Matrix) -> Result<(Lens, Rigid), String> {
    if !matches!((matrix.rows, matrix.columns), (3 | 4, 4)) {
        return Err(format!("is {}×{}, not 4×4", matrix.rows, matrix.columns));
    }
    check_finite(&matrix.values, |value| value.is_finite())?;
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
