//! COLMAP's layout: a reconstruction in `DIR/sparse/0`, photographs in `DIR/images`, masks in `DIR/masks`.
//!
//! The reconstruction is `cameras` and `images`, `.bin` or `.txt`; points, rigs and frames are not needed. It may also be where COLMAP's
//! own programs, nerfstudio and 3D Gaussian splatting leave it; of several models the one with the most images is read. Masks may have
//! any usual name, and be beside the photographs or in `DIR`; without a folder of masks alpha is the mask. Photographs are taken as they are stored, since COLMAP ignores their
//! EXIF orientation. There is no test split: see [`crate::dataset::DatasetOptions::hold_out`].

use crate::codec::nearby::missing_file_help;
use crate::dataset::colmap_model;
use crate::dataset::colmap_model::{image_count, read_model};
use crate::dataset::folders::{Folders, flat_name};
use crate::dataset::masks::mask_folder;
use crate::dataset::names::{ImageName, quoted, view_name};
use crate::dataset::photographs::note_of_unused;
use crate::dataset::{MaskPlan, Plan, ViewPlan};
use crate::error::{Error, Result};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Where reconstructions are, and the folder of photographs that belongs to each: COLMAP's own, nerfstudio's, the outputs of COLMAP's
/// `image_undistorter` and `automatic_reconstructor`, and what 3D Gaussian splatting keeps of the distorted photographs.
const PLACES: [(&str, &str); 6] = [
    ("sparse", "images"),
    ("colmap/sparse", "images"),
    ("colmap/sparse", "colmap/images"),
    ("dense/sparse", "dense/images"),
    ("dense/0/sparse", "dense/0/images"),
    ("distorted/sparse", "input"),
];

/// A reconstruction that was found.
struct Place {
    /// The `images` files of its models; at least one.
    models: Vec<PathBuf>,
    photographs: PathBuf,
}

/// The `images` file of the folder's reconstruction, if it has one.
pub fn camera_file(dir: &Path) -> Option<PathBuf> {
    find_place(dir).and_then(|place| place.models.into_iter().next())
}

/// Whether the folder is a COLMAP data set. One with nerfstudio's `transforms.json` keeps its reconstruction in `colmap` for the record.
pub fn is_there(dir: &Path) -> bool {
    let is_for_the_record =
        |file: &Path| file.starts_with(dir.join("colmap")) && dir.join("transforms.json").is_file();
    camera_file(dir).is_some_and(|file| !is_for_the_record(&file))
}

/// The first place with both models and photographs, or else with models.
fn find_place(dir: &Path) -> Option<Place> {
    let places = PLACES.iter().map(|(models, photographs)| Place {
        models: models_in(&dir.join(models)),
        photographs: dir.join(photographs),
    });
    let mut places: Vec<Place> = places.filter(|place| !place.models.is_empty()).collect();
    let complete = places.iter().position(|place| place.photographs.is_dir());
    if places.is_empty() { None } else { Some(places.swap_remove(complete.unwrap_or(0))) }
}

/// The models in the folders `0`, `1`, … of `folder`, or else in itself.
fn models_in(folder: &Path) -> Vec<PathBuf> {
    let numbered = (0..).map(|i| folder.join(i.to_string())).take_while(|model| model.is_dir());
    let models: Vec<PathBuf> = numbered.filter_map(|model| colmap_model::image_file(&model)).collect();
    if models.is_empty() { colmap_model::image_file(folder).into_iter().collect() } else { models }
}

/// The model with the most images, the first of equals, and a note about the others.
fn largest(models: Vec<PathBuf>) -> Result<(PathBuf, Option<String>)> {
    if let [only] = models.as_slice() {
        return Ok((only.clone(), None));
    }
    let counts = models.iter().map(|file| image_count(file)).collect::<Result<Vec<_>>>()?;
    let most = counts.iter().copied().max().unwrap_or(0);
    let chosen = counts.iter().position(|&count| count == most).unwrap_or(0);
    let list: Vec<String> = counts.iter().map(u64::to_string).collect();
    let note = format!(
        "the reconstruction has {} models of {} images; only the largest, {}, is read",
        models.len(),
        list.join(", "),
        models[chosen].parent().unwrap_or(Path::new("")).display()
    );
    Ok((models[chosen].clone(), Some(note)))
}

/// The names of the photographs that a model in `folder` has cameras for, as paths below the folder of photographs.
///
/// # Errors
/// [`Error::Input`] if there is no model, or it cannot be read.
pub fn registered_names(folder: &Path) -> Result<Vec<String>> {
    let Some(file) = colmap_model::image_file(folder) else {
        let problem = "there is no COLMAP model: looked for cameras and images, .bin or .txt";
        return Err(Error::input(folder, "", problem, missing_file_help(&folder.join("cameras.bin"))));
    };
    Ok(read_model(file)?.images.into_iter().map(|image| image.name).collect())
}

/// Plans all views, in the order of their names.
pub(super) fn plan(dir: &Path) -> Result<Plan> {
    let Some(place) = find_place(dir) else {
        let looked: Vec<&str> = PLACES.iter().map(|(models, _)| *models).collect();
        let problem = format!(
            "there is no COLMAP model: looked for cameras and images, .bin or .txt, in sparse/0 and in {}",
            looked.join(", ")
        );
        return Err(Error::input(dir, "", problem, missing_file_help(&dir.join("sparse/0/cameras.bin"))));
    };
    let (file, of_models) = largest(place.models)?;
    let model = read_model(file)?;
    let mut photographs = Folders::below(&place.photographs);
    let masks = place.photographs.parent().and_then(mask_folder).or_else(|| mask_folder(dir));
    let mut masks = masks.map(|folder| Folders::below(&folder));
    if !photographs.root.is_dir() {
        let help = missing_file_help(&photographs.root);
        return Err(Error::input(&photographs.root, "", "the folder of photographs is missing", help));
    }
    let mut images = model.images;
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let mut views = Vec::with_capacity(images.len());
    for image in &images {
        let place = format!("image {}", quoted(&image.name));
        let Some(lens) = model.cameras.get(&image.camera).copied() else {
            let problem = format!("there is no camera {} in the model", image.camera);
            return Err(Error::input(&model.image_file, place, problem, "Write the model again."));
        };
        let name = ImageName::new(&image.name, &model.image_file, &place)?;
        views.push(ViewPlan {
            name: flat_name(&image.name),
            camera_file: model.image_file.clone(),
            place,
            image: Some(photographs.photograph(name)?),
            mask: masks.as_mut().map_or(Ok(MaskPlan::Alpha), |masks| masks.mask(&image.name))?,
            lens,
            world_from_camera: image.camera_from_world.inverse().to_affine(),
        });
    }
    let used: BTreeSet<PathBuf> =
        images.iter().map(|image| Path::new(&image.name).with_file_name(view_name(&image.name))).collect();
    let extra = photographs.unused(|path| used.contains(path));
    let notes = of_models.into_iter().chain(note_of_unused(extra, &photographs.root)).collect();
    Ok(Plan { views, notes })
}
