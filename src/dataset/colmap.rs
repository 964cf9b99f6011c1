//! COLMAP's layout: a reconstruction in `DIR/sparse/0` (or `DIR/sparse`), photographs in `DIR/images`, masks in `DIR/masks`.
//!
//! The reconstruction is `cameras` and `images`, `.bin` or `.txt`; points are not needed. A mask has the name of its photograph,
//! with `.png` added or in place of the extension; without a `masks` folder alpha is the mask. There is no test split: see
//! [`crate::dataset::DatasetOptions::hold_out`].

use crate::codec::nearby::missing_file_help;
use crate::dataset::colmap_model;
use crate::dataset::colmap_model::{ModelImage, read_model};
use crate::dataset::load::{StemIndex, view_name};
use crate::dataset::{MaskPlan, Plan, ViewPlan};
use crate::error::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The `images` file of the folder's reconstruction, if it has one.
pub fn camera_file(dir: &Path) -> Option<PathBuf> {
    let sparse = dir.join("sparse");
    [sparse.join("0"), sparse].iter().find_map(|folder| colmap_model::image_file(folder))
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
    let Some(file) = camera_file(dir) else {
        let problem =
            "there is no COLMAP model: looked for cameras and images, .bin or .txt, in sparse/0 and sparse";
        return Err(Error::input(dir, "", problem, missing_file_help(&dir.join("sparse/0/cameras.bin"))));
    };
    let model = read_model(file)?;
    let mut photographs = Folders::below(&dir.join("images"));
    let mut masks = Folders::below(&dir.join("masks"));
    if !photographs.root.is_dir() {
        let help = missing_file_help(&photographs.root);
        return Err(Error::input(&photographs.root, "", "the folder of photographs is missing", help));
    }
    let mut images = model.images;
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let mut views = Vec::with_capacity(images.len());
    for image in &images {
        let place = format!("image `{}`", image.name);
        let Some(lens) = model.cameras.get(&image.camera).copied() else {
            let problem = format!("there is no camera {} in the model", image.camera);
            return Err(Error::input(&model.image_file, place, problem, "Write the model again."));
        };
        views.push(ViewPlan {
            name: flat_name(image),
            camera_file: model.image_file.clone(),
            place,
            image: Some(photographs.photograph(&image.name)?),
            mask: if masks.root.is_dir() {
                MaskPlan::File(masks.mask(&image.name)?)
            } else {
                MaskPlan::Alpha
            },
            lens,
            world_from_camera: image.camera_from_world.inverse().to_affine(),
        });
    }
    let notes = notes(dir, &photographs, &images);
    Ok(Plan { views, notes })
}

/// The name of the view: the path below the image folder without extension, as one file name.
fn flat_name(image: &ModelImage) -> String {
    let folders = Path::new(&image.name).parent().into_iter().flat_map(Path::components);
    let folders = folders.map(|part| format!("{}_", part.as_os_str().to_string_lossy()));
    folders.collect::<String>() + &view_name(&image.name)
}

fn notes(dir: &Path, photographs: &Folders, images: &[ModelImage]) -> Vec<String> {
    let mut notes = Vec::new();
    if dir.join("sparse/1").is_dir() {
        notes.push("the reconstruction has several models; only sparse/0 is read".to_owned());
    }
    let used: BTreeSet<PathBuf> =
        images.iter().map(|image| Path::new(&image.name).with_extension("")).collect();
    let extra: usize = photographs
        .found
        .iter()
        .map(|(folder, index)| index.stems().filter(|stem| !used.contains(&folder.join(stem))).count())
        .sum();
    if extra > 0 {
        let folder = photographs.root.display();
        notes.push(format!("{extra} images in {folder} have no camera and are left out"));
    }
    notes
}

/// Image files below a folder, looked up by path.
struct Folders {
    root: PathBuf,
    found: BTreeMap<PathBuf, StemIndex>,
}

impl Folders {
    fn below(root: &Path) -> Self {
        Self { root: root.to_owned(), found: BTreeMap::new() }
    }

    fn folder(&mut self, name: &str) -> Result<(&StemIndex, String)> {
        let path = Path::new(name);
        let parent = path.parent().unwrap_or(Path::new("")).to_owned();
        let key = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if !self.found.contains_key(&parent) {
            let folder = self.root.join(&parent);
            let index = StemIndex::of_folder(&folder)?.ok_or_else(|| {
                let help = missing_file_help(&folder);
                Error::input(
                    &folder,
                    "",
                    format!("the folder is missing, but `{name}` should be in it"),
                    help,
                )
            })?;
            self.found.insert(parent.clone(), index);
        }
        Ok((&self.found[&parent], key))
    }

    fn photograph(&mut self, name: &str) -> Result<PathBuf> {
        let (folder, key) = self.folder(name)?;
        folder.find(&key)
    }

    /// COLMAP's masks have `.png` added to the full name of the photograph.
    fn mask(&mut self, name: &str) -> Result<PathBuf> {
        let (folder, key) = self.folder(name)?;
        let added = folder.exact(&format!("{key}.png"));
        added.map_or_else(|| folder.find(&key), Ok)
    }
}
