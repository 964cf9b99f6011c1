//! PhySG's layout: `DIR/{train,test}/image`, `mask`, and `cam_dict_norm.json`.
//!
//! The JSON maps each image's file name to `K` and `W2C` (16 numbers each, row-major 4×4, camera_from_world with OpenCV
//! axes) and `img_size` (`[width, height]`). Without an `image` folder the views are cameras only. Images and masks are
//! found by file stem, so a mask may be a PNG beside an EXR; masks may have any usual name. Without a `mask` folder the images' alpha is
//! the mask.

use crate::codec::file::is_there;
use crate::dataset::lens::Lens;
use crate::dataset::load::{StemIndex, file_name, parse_json, read_text};
use crate::dataset::masks::{find_mask, masks_in};
use crate::dataset::names::{ImageName, composed, quoted, view_name};
use crate::dataset::photographs::note_of_unused;
use crate::dataset::plan::{MaskPlan, Plan, ViewPlan, absent_split, split_name};
use crate::dataset::pose::Rigid;
use crate::error::{Error, Result};
use crate::view::Split;
use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};

/// The file that describes the cameras of a split.
pub(crate) fn camera_file(dir: &Path, split: Split) -> PathBuf {
    dir.join(split_name(split)).join("cam_dict_norm.json")
}

#[derive(serde::Deserialize)]
struct CameraEntry {
    #[serde(rename = "K")]
    k: Vec<f64>,
    #[serde(rename = "W2C")]
    w2c: Vec<f64>,
    img_size: Vec<u32>,
}

impl CameraEntry {
    /// The lens, and the pose camera_from_world.
    ///
    /// # Errors
    /// [`Error::Input`] that names the `place` in the camera file, if they are not those of a camera.
    fn lens_and_pose(&self, file: &Path, place: &str) -> Result<(Lens, Rigid)> {
        let wrong = |problem: String, help: &str| Error::input(file, place, problem, help);
        let k = sixteen(&self.k)
            .map_err(|problem| wrong(format!("K {problem}"), "K is a row-major 4×4 matrix."))?;
        let w2c = sixteen(&self.w2c)
            .map_err(|problem| wrong(format!("W2C {problem}"), "W2C is a row-major 4×4 matrix."))?;
        let &[width, height] = self.img_size.as_slice() else {
            let problem = format!("img_size has {} numbers, not 2", self.img_size.len());
            return Err(wrong(problem, "img_size is [width, height]."));
        };
        let lens = Lens::from_matrix(&k, [width, height]).map_err(|problem| {
            wrong(format!("K {problem}"), "K holds focal lengths and the principal point in pixels.")
        })?;
        let camera_from_world = Rigid::from_rows(&w2c).map_err(|problem| {
            let help = "W2C is a rotation and a translation, from world to OpenCV camera axes.";
            wrong(format!("W2C {problem}"), help)
        })?;
        Ok((lens, camera_from_world))
    }
}

/// A JSON object in file order, so that duplicate names can be detected.
struct Entries(Vec<(String, CameraEntry)>);

impl<'de> Deserialize<'de> for Entries {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct InOrder;
        impl<'de> Visitor<'de> for InOrder {
            type Value = Entries;
            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("an object that maps image names to cameras")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Entries, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Entries(entries))
            }
        }
        deserializer.deserialize_map(InOrder)
    }
}

pub(super) fn plan(dir: &Path, split: Split) -> Result<Plan> {
    let file = camera_file(dir, split);
    if !is_there(&file) {
        return Err(absent_split(dir, split, camera_file));
    }
    let Entries(entries) = parse_json(&file, &read_text(&file)?)?;
    let folder = dir.join(split_name(split));
    let images = StemIndex::of_folder(&folder.join("image"))?;
    let masks = masks_in(&folder)?;
    let mut views = Vec::with_capacity(entries.len());
    for (key, entry) in entries {
        views.push(plan_view(&file, &key, &entry, images.as_ref(), masks.as_ref())?);
    }
    let names: BTreeSet<Cow<str>> = views.iter().map(|view| composed(&view.name)).collect();
    let is_extra = |stem: &&str| !names.contains(&composed(stem));
    let extra = images.map_or(0, |images| images.stems().filter(is_extra).count());
    Ok(Plan { views, notes: note_of_unused(extra, &folder.join("image")).into_iter().collect() })
}

fn plan_view(
    file: &Path,
    key: &str,
    entry: &CameraEntry,
    images: Option<&StemIndex>,
    masks: Option<&StemIndex>,
) -> Result<ViewPlan> {
    let place = format!("camera {}", quoted(key));
    let image_name = ImageName::new(key, file, &place)?;
    let (lens, camera_from_world) = entry.lens_and_pose(file, &place)?;
    let name = view_name(key);
    let image = images.map(|images| images.find(image_name)).transpose()?;
    let mask = match masks {
        Some(masks) => MaskPlan::File(match masks.exact(key) {
            Some(mask) => mask,
            None => find_mask(masks, &file_name(Path::new(key)))?,
        }),
        None => MaskPlan::AlphaRequired(format!(
            "the view `{name}` has no mask: there is no folder {} and the image has no alpha",
            file.with_file_name("mask").display()
        )),
    };
    let world_from_camera = camera_from_world.inverse().to_affine();
    let (camera_file, pose_error) = (file.to_owned(), camera_from_world.error);
    Ok(ViewPlan { name, camera_file, place, image, mask, lens, world_from_camera, pose_error })
}

fn sixteen(values: &[f64]) -> Result<[f64; 16], String> {
    values.try_into().map_err(|_| format!("has {} numbers, not 16", values.len()))
}
