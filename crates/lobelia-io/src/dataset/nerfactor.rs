//! The layout of NeRFactor and of TensoIR-Synthetic, as the manual's chapter on layouts tells it: a
//! folder for each view, with its camera in `metadata.json` and its pictures under one or several
//! lights beside it. `cam_transform_mat` is the rows of world_from_camera, with OpenGL axes (x
//! right, y up, z backward); `cam_angle_x` the full horizontal field of view in radians; `imw` and
//! `imh` are pixels.

use crate::codec::file::is_there;
use crate::dataset::files::{entries, file_name, quoted, read_json};
use crate::dataset::{lens::Focal, lens::Lens, pose::Rigid, views::Plan, views::ViewPlan};
use lobelia_geometry::{Error, Result, view::Split};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The file of the camera of a view.
const CAMERA: &str = "metadata.json";
/// Pictures that are photographs, the first that is there.
const PHOTOGRAPHS: [&str; 3] = ["rgba.png", "rgba_sunset.png", "rgba_sunset_000.png"];

/// The folders of the views of a split.
pub(super) fn view_folders(dir: &Path, split: Split) -> Vec<PathBuf> {
    let called = |kind: &str| {
        let is_view = |folder: &PathBuf| {
            let name = file_name(folder);
            let number = name.strip_prefix(kind).unwrap_or_default();
            let is_number = !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit());
            is_number && is_there(&folder.join(CAMERA))
        };
        entries(dir).filter(is_view).collect::<Vec<_>>()
    };
    let kinds: &[&str] = if split == Split::Train { &["train_"] } else { &["test_", "val_"] };
    kinds.iter().map(|kind| called(kind)).find(|views| !views.is_empty()).unwrap_or_default()
}

/// A camera file.
#[derive(Deserialize)]
struct Metadata {
    cam_transform_mat: String,
    cam_angle_x: f64,
    imw: u32,
    imh: u32,
}

/// Plans the views of a split.
pub(super) fn plan(dir: &Path, split: Split) -> Result<Plan> {
    let views = view_folders(dir, split).into_iter().map(|folder| {
        let file = folder.join(CAMERA);
        let camera: Metadata = read_json(&file)?;
        let pose = rows(&camera.cam_transform_mat).and_then(|rows| Rigid::from_rows(&rows));
        let pose = pose.map_err(|problem| {
            let help = "cam_transform_mat is 16 numbers with commas: a rotation and a translation, from OpenGL camera axes to the world.";
            Error::input(&file, "", format!("cam_transform_mat {problem}"), help)
        })?;
        let image = match photograph(&folder) {
            Err(_) if split == Split::Test => None,
            found => Some(found?),
        };
        let lens = Lens {
            size: Some([camera.imw, camera.imh]),
            focal_x: Focal::Angle(camera.cam_angle_x),
            focal_y: None,
            resizable: true,
            ..Lens::pinhole([0.0; 2], [None; 2])
        };
        let (name, place) = (file_name(&folder), String::new());
        Ok(ViewPlan { name, camera_file: file, place, image, mask: None, lens, pose: pose.in_opencv_axes() })
    });
    Ok(Plan { views: views.collect::<Result<_>>()?, notes: Vec::new() })
}

/// The numbers of a matrix.
fn rows(text: &str) -> Result<Vec<f64>, String> {
    let words = text.split(',').map(str::trim);
    words
        .map(|word| word.parse().map_err(|_| format!("has {}, which is not a number", quoted(word))))
        .collect()
}

/// The picture that a fit sees.
fn photograph(folder: &Path) -> Result<PathBuf> {
    if let Some(path) = PHOTOGRAPHS.iter().map(|name| folder.join(name)).find(|path| is_there(path)) {
        return Ok(path);
    }
    let is_other = |name: &String| name.starts_with("rgba_") && name.ends_with(".png");
    let mut others: Vec<String> = entries(folder).map(|path| file_name(&path)).filter(is_other).collect();
    others.sort();
    let [usual, sunset, _] = PHOTOGRAPHS;
    if let [only] = others.as_slice() {
        return Ok(folder.join(only));
    }
    let list = if others.is_empty() { "none".to_owned() } else { others.join(", ") };
    let problem =
        format!("the photograph of this view is missing: there is no {usual}, and of other lights {list}");
    let help = format!(
        "Name the one to fit to {usual} in each folder; {sunset} would be taken, too. It is a PNG with alpha."
    );
    Err(Error::input(folder, "", problem, help))
}
