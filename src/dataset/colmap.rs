//! COLMAP's layout: a reconstruction in `DIR/sparse/0`, photographs in `DIR/images`, masks in `DIR/masks`.
//!
//! The reconstruction is `cameras` and `images`, `.bin` or `.txt`; points, rigs and frames are not needed. It may also be where COLMAP's
//! own programs, nerfstudio and 3D Gaussian splatting leave it, and the photographs in a folder of another usual name; of several models
//! the one with the most images is read. Masks may have any usual name, and be beside the photographs or in `DIR`; without a folder of
//! masks alpha is the mask. Photographs are taken as they are stored, since COLMAP ignores their EXIF orientation. `DIR/test_id.txt` and `DIR/train_id.txt`, as of Stanford-ORB's `llff_colmap_HDR`,
//! list the views of each split. Without the former see [`crate::dataset::DatasetOptions::hold_out`].

use crate::codec::nearby::missing_file_help;
use crate::dataset::colmap_model;
use crate::dataset::colmap_model::{Model, ModelImage, image_count, read_model};
use crate::dataset::folders::{Folders, flat_name};
use crate::dataset::lists::{Lists, has_test_list};
use crate::dataset::load::has_images;
use crate::dataset::masks::mask_folder;
use crate::dataset::names::{ImageName, PHOTOGRAPH_FOLDERS, composed, portable, quoted, view_name};
use crate::dataset::photographs::note_of_unused;
use crate::dataset::plan::{MaskPlan, Plan, ViewPlan};
use crate::error::{Error, Result};
use crate::view::Split;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Where reconstructions are, and the folder of photographs that belongs to each: COLMAP's own, nerfstudio's, the outputs of COLMAP's
/// `image_undistorter` and `automatic_reconstructor`, what 3D Gaussian splatting keeps of the distorted photographs, and instant-ngp's.
const PLACES: [(&str, &str); 9] = [
    ("sparse", "images"),
    ("colmap/sparse", "images"),
    ("colmap/sparse", "colmap/images"),
    ("dense/sparse", "dense/images"),
    ("dense/0/sparse", "dense/0/images"),
    ("distorted/sparse", "input"),
    ("colmap_text", "images"),
    ("colmap", "images"),
    ("model", "images"),
];
/// Models that are looked for in a folder.
const MOST_MODELS: usize = 100;
/// Folders of reconstructions of which the cameras of another layout are made.
const FOR_THE_RECORD: [&str; 3] = ["colmap", "colmap_text", "model"];

/// A reconstruction that was found.
struct Place {
    /// The `images` files of its models; at least one.
    models: Vec<PathBuf>,
    photographs: PathBuf,
    /// Whether the photographs are not where they usually are, but in a folder of another usual name.
    is_renamed: bool,
}

impl Place {
    fn new(models: Vec<PathBuf>, photographs: PathBuf) -> Self {
        let other = if photographs.is_dir() { None } else { named_otherwise(&photographs) };
        Self { models, is_renamed: other.is_some(), photographs: other.unwrap_or(photographs) }
    }
}

/// The folder beside this one, which is missing, that has photographs and another of the usual names.
fn named_otherwise(photographs: &Path) -> Option<PathBuf> {
    let entries = std::fs::read_dir(photographs.parent()?).ok()?.flatten().map(|entry| entry.path());
    let rank = |path: &Path| {
        let name = path.file_name()?.to_str()?.to_lowercase();
        PHOTOGRAPH_FOLDERS.iter().position(|usual| *usual == name)
    };
    let usual = entries.filter_map(|path| Some((rank(&path)?, path)));
    let mut usual: Vec<(usize, PathBuf)> =
        usual.filter(|(_, path)| path.is_dir() && has_images(path, |_| false)).collect();
    usual.sort();
    usual.into_iter().next().map(|(_, path)| path)
}

/// The `images` file of the folder's reconstruction, if it has one.
pub(crate) fn camera_file(dir: &Path) -> Option<PathBuf> {
    find_place(dir).and_then(|place| place.models.into_iter().next())
}

/// Whether the folder has this split of a COLMAP data set: the test split is a list.
pub(crate) fn has_split(dir: &Path, split: Split) -> bool {
    camera_file(dir).is_some() && (split == Split::Train || has_test_list(dir))
}

/// Whether the reconstruction is there for the record only, beside the cameras of another layout that were made of it, or has no
/// photographs in the folder that belongs to it.
pub(super) fn is_for_the_record(dir: &Path) -> bool {
    let is_kept = |file: &PathBuf| FOR_THE_RECORD.iter().any(|folder| file.starts_with(dir.join(folder)));
    find_place(dir).is_some_and(|place| {
        place.models.iter().all(is_kept) || place.is_renamed || !place.photographs.is_dir()
    })
}

/// The first place with both models and photographs, or else with models.
fn find_place(dir: &Path) -> Option<Place> {
    let places = PLACES
        .iter()
        .map(|(models, photographs)| Place::new(models_in(&dir.join(models)), dir.join(photographs)));
    // A folder of numbered models alone is that in which COLMAP puts them.
    let loose = Place::new(numbered_models(dir), dir.join("images"));
    let loose = Some(loose).filter(|loose| loose.photographs.is_dir());
    let mut places: Vec<Place> = places.chain(loose).filter(|place| !place.models.is_empty()).collect();
    let complete = places.iter().position(|place| place.photographs.is_dir());
    if places.is_empty() { None } else { Some(places.swap_remove(complete.unwrap_or(0))) }
}

/// The models in the folders `0`, `1`, … of `folder`, or else in itself.
fn models_in(folder: &Path) -> Vec<PathBuf> {
    let models = numbered_models(folder);
    if models.is_empty() { colmap_model::image_file(folder).into_iter().collect() } else { models }
}

/// The models in the folders `0`, `1`, … of `folder`.
fn numbered_models(folder: &Path) -> Vec<PathBuf> {
    // COLMAP counts from 0, but a model that is of no use may have been removed.
    let numbered = (0..MOST_MODELS).map(|i| folder.join(i.to_string()));
    numbered.filter_map(|model| colmap_model::image_file(&model)).collect()
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
pub(crate) fn registered_names(folder: &Path) -> Result<Vec<String>> {
    let Some(file) = colmap_model::image_file(folder) else {
        let problem = "there is no COLMAP model: looked for cameras and images, .bin or .txt";
        return Err(Error::input(folder, "", problem, missing_file_help(&folder.join("cameras.bin"))));
    };
    Ok(read_model(file)?.images.into_iter().map(|image| image.name).collect())
}

/// The model with the most images, which has some, and a note about the others.
fn read_largest(models: Vec<PathBuf>) -> Result<(Model, Option<String>)> {
    let (file, note) = largest(models)?;
    let model = read_model(file)?;
    if model.images.is_empty() {
        let problem = "the model has no images, so that there are no views";
        let help = "Give a model in which photographs are registered; COLMAP may have written several.";
        return Err(Error::input(&model.image_file, "", problem, help));
    }
    Ok((model, note))
}

/// Plans the views of a split, in the order of their names; without lists, all are of the training split.
pub(super) fn plan(dir: &Path, split: Split) -> Result<Plan> {
    let place = find_place(dir).ok_or_else(|| no_model(dir))?;
    let (model, of_models) = read_largest(place.models)?;
    let masks = place.photographs.parent().and_then(mask_folder).or_else(|| mask_folder(dir));
    let masks = masks.map(|folder| Folders::below(&folder));
    let mut pictures =
        Pictures { photographs: Folders::below(&place.photographs), masks, used: BTreeSet::new() };
    if !place.photographs.is_dir() {
        let help = format!(
            "The photographs that COLMAP was given belong there: rename their folder. {}",
            missing_file_help(&place.photographs)
        );
        return Err(Error::input(&place.photographs, "", "the folder of photographs is missing", help));
    }
    let mut images: Vec<&ModelImage> = model.images.iter().collect();
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let (wanted, unlisted) = listed(dir, split, &images)?;
    let views = wanted.iter().map(|image| pictures.view(&model, image)).collect::<Result<Vec<_>>>()?;
    if split == Split::Test {
        // Notes about all views are reported once, with the training split.
        return Ok(Plan { views, notes: Vec::new() });
    }
    images.iter().try_for_each(|image| pictures.found(&model, image).map(|_| ()))?;
    let Pictures { photographs, used, .. } = pictures;
    let extra = photographs.unused(|path| used.contains(path));
    let unused = note_of_unused(extra, &photographs.root);
    Ok(Plan { views, notes: of_models.into_iter().chain(unlisted).chain(unused).collect() })
}

/// The images of a split, and a note on those that the lists beside the model leave out.
fn listed<'a>(
    dir: &Path,
    split: Split,
    images: &[&'a ModelImage],
) -> Result<(Vec<&'a ModelImage>, Option<String>)> {
    let names: Vec<&str> = images.iter().map(|image| image.name.as_str()).collect();
    let lists = Lists::read(dir)?;
    lists.check(&names)?;
    let wanted = images.iter().copied().filter(|image| lists.contains(split, &image.name));
    Ok((wanted.collect(), lists.note_of_unlisted(&names)))
}

fn no_model(dir: &Path) -> Error {
    let looked: Vec<&str> = PLACES.iter().map(|(models, _)| *models).collect();
    let problem = format!(
        "there is no COLMAP model: looked for cameras and images, .bin or .txt, in sparse/0, in {}, and in 0 beside images",
        looked.join(", ")
    );
    Error::input(dir, "", problem, missing_file_help(&dir.join("sparse/0/cameras.bin")))
}

/// Where an image is in a model.
fn place_of(image: &ModelImage) -> String {
    format!("image {}", quoted(&image.name))
}

/// Photographs and masks of a reconstruction.
struct Pictures {
    photographs: Folders,
    masks: Option<Folders>,
    /// The photographs of the model, as paths below their folder without extension, composed.
    used: BTreeSet<PathBuf>,
}

impl Pictures {
    /// The path below the folder of photographs by which an image of the model is found, if it is.
    fn found(&mut self, model: &Model, image: &ModelImage) -> Result<String> {
        let name = portable(&image.name);
        ImageName::new(&name, &model.image_file, &place_of(image))?;
        let name = self.photographs.reachable(&name)?;
        let stem = Path::new(&name).with_file_name(view_name(&name));
        self.used.insert(composed(&stem.to_string_lossy()).into_owned().into());
        Ok(name)
    }

    fn view(&mut self, model: &Model, image: &ModelImage) -> Result<ViewPlan> {
        let place = place_of(image);
        let Some(lens) = model.cameras.get(&image.camera).copied() else {
            let problem = format!("there is no camera {} in the model", image.camera);
            return Err(Error::input(&model.image_file, place, problem, "Write the model again."));
        };
        let name = self.found(model, image)?;
        let photograph = self.photographs.photograph(ImageName::new(&name, &model.image_file, &place)?)?;
        Ok(ViewPlan {
            name: flat_name(&name),
            camera_file: model.image_file.clone(),
            place,
            image: Some(photograph),
            mask: self.masks.as_mut().map_or(Ok(MaskPlan::Alpha), |masks| masks.mask(&name))?,
            lens,
            world_from_camera: image.camera_from_world.inverse().to_affine(),
            pose_error: 0.0,
        })
    }
}
