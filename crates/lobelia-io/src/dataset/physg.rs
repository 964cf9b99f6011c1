//! PhySG's layout, as the manual's chapter on layouts tells it: `DIR/{train,test}/image`, `mask`,
//! and `cam_dict_norm.json`, which maps each image's file name to `K` and `W2C` (16 numbers each,
//! row-major 4×4, camera_from_world with OpenCV axes) and `img_size`.

use crate::codec::file::is_there;
use crate::dataset::files::{Folders, check_image_name, mask_folder, quoted, read_json, view_name};
use crate::dataset::views::{Plan, ViewPlan, split_name};
use crate::dataset::{lens::Lens, pose::Rigid};
use lobelia_geometry::{Error, Result, view::Split};
use serde::Deserialize;
use std::{collections::BTreeMap, path::Path, path::PathBuf};

/// The file that describes the cameras of a split.
pub(super) fn camera_file(dir: &Path, split: Split) -> PathBuf {
    dir.join(split_name(split)).join("cam_dict_norm.json")
}

#[derive(Deserialize)]
struct CameraEntry {
    #[serde(rename = "K")]
    k: Vec<f64>,
    #[serde(rename = "W2C")]
    w2c: Vec<f64>,
    img_size: [u32; 2],
}

/// Plans the views of a split.
pub(super) fn plan(dir: &Path, split: Split) -> Result<Plan> {
    let file = camera_file(dir, split);
    let entries: BTreeMap<String, CameraEntry> = read_json(&file)?;
    let folder = dir.join(split_name(split));
    let mut images = Some(folder.join("image")).filter(|folder| is_there(folder)).map(Folders::below);
    let mut masks = mask_folder(&folder).map(Folders::below);
    let mut views = Vec::with_capacity(entries.len());
    for (key, entry) in entries {
        let place = format!("camera {}", quoted(&key));
        check_image_name(&key, &file, &place)?;
        let wrong = |problem: String, help: &str| Error::input(&file, &place, problem, help);
        let lens = Lens::from_matrix(&entry.k, entry.img_size).map_err(|problem| {
            wrong(
                format!("K {problem}"),
                "K is a row-major 4×4 matrix of focal lengths and principal point, in pixels.",
            )
        })?;
        let camera_from_world = Rigid::from_rows(&entry.w2c).map_err(|problem| {
            wrong(
                format!("W2C {problem}"),
                "W2C is a rotation and a translation, from world to OpenCV camera axes.",
            )
        })?;
        let name = view_name(&key);
        let image = images.as_mut().map(|images| images.photograph(&key)).transpose()?.map(|found| found.1);
        views.push(ViewPlan {
            name,
            camera_file: file.clone(),
            place,
            image,
            mask: masks.as_mut().map(|masks| masks.mask(&key)).transpose()?,
            lens,
            pose: camera_from_world.inverse(),
        });
    }
    Ok(Plan { views, notes: images.and_then(|images| images.note_of_unused()).into_iter().collect() })
}
