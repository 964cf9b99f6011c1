//! Folders beside the photographs that have images of the same names: masks, if they are called so.

use crate::codec::image::{Orientation, image_header, read_mask};
use crate::codec::nearby::natural_order;
use crate::dataset::load::{StemIndex, file_name};
use crate::dataset::masks::mask_file;
use crate::dataset::plan::{MaskPlan, ViewPlan};
use crate::dataset::priors::Priors;
use crate::error::Result;
use std::path::{Path, PathBuf};

/// Words within the names of folders of masks.
const WITHIN: [&str; 5] = ["mask", "matte", "matting", "silhouette", "segment"];
/// Whole words of the names of folders of masks.
const WORDS: [&str; 8] = ["seg", "segs", "alpha", "alphas", "fg", "foreground", "sil", "sils"];
/// How the names of folders begin that have other images of the views: photographs of another size, and what is computed from them.
const OTHERS: [&str; 10] =
    ["image", "rgb", "photo", "color", "input", "depth", "normal", "albedo", "distorted", "undistorted"];
/// Words in the names of folders of one split, whose images may have the names of those of another.
const SPLITS: [&str; 5] = ["train", "training", "test", "val", "validation"];
/// Part of the pixels of a mask that are nearly black or white.
const DECIDED: f32 = 0.9;

/// A folder with an image for each photograph, which may be its mask.
pub(super) struct Beside {
    folder: PathBuf,
    /// In the order of the views.
    images: Vec<PathBuf>,
    /// Whether the folder is called as one of masks is, and its first image is one.
    are_masks: bool,
}

impl Beside {
    /// The first such folder by name, of those that are called as masks are, or else of all; `None` if a view has a mask, or no photograph,
    /// or photographs have alpha or are in several folders. Folders of `priors` are none. A photograph's header and a mask are read at most.
    ///
    /// # Errors
    /// If the first photograph cannot be read.
    pub fn find(dir: &Path, views: &[ViewPlan], priors: &Priors) -> Result<Option<Self>> {
        let Some(photographs) = bare_photographs(views) else { return Ok(None) };
        let Some(folder) = photographs[0].parent() else { return Ok(None) };
        if photographs.iter().any(|photograph| photograph.parent() != Some(folder)) {
            return Ok(None);
        }
        let mut found: Vec<Self> = candidates(dir, folder)
            .into_iter()
            .filter(|folder| !priors.folders().any(|prior| are_same(prior, folder)))
            .filter_map(|folder| Self::complete(folder, &photographs))
            .collect();
        if found.is_empty() || image_header(photographs[0])?.has_alpha() {
            return Ok(None);
        }
        let chosen = found.iter().position(|beside| is_called_masks(&beside.name()));
        let mut beside = found.swap_remove(chosen.unwrap_or(0));
        beside.are_masks = chosen.is_some() && beside.images.first().is_some_and(|image| is_mask(image));
        Ok(Some(beside))
    }

    /// The folder with the mask of each photograph under any of its usual names.
    fn complete(folder: PathBuf, photographs: &[&Path]) -> Option<Self> {
        let index = StemIndex::of_folder(&folder).ok().flatten()?;
        let images = photographs.iter().map(|photograph| mask_file(&index, &file_name(photograph)));
        let images = images.collect::<Option<Vec<_>>>()?;
        Some(Self { folder, images, are_masks: false })
    }

    /// The folder's name in lower case.
    fn name(&self) -> String {
        file_name(&self.folder).to_lowercase()
    }

    /// The folder, where its images are not taken as masks.
    pub fn unused_folder(&self) -> Option<PathBuf> {
        (!self.are_masks).then(|| self.folder.clone())
    }

    /// Takes the images as masks if they are, and else says in errors what they may be. Returns what the user should
    /// know.
    pub fn apply(self, views: &mut [ViewPlan]) -> String {
        let folder = self.folder.display().to_string();
        if self.are_masks {
            for (view, mask) in views.iter_mut().zip(self.images) {
                view.mask = MaskPlan::File(mask);
            }
            return format!("the masks are those in {folder}, which has an image for each photograph");
        }
        let hint = masks_hint(&self.folder);
        for view in views {
            if let MaskPlan::AlphaRequired(problem) = &mut view.mask {
                *problem = format!("{problem}; {hint}");
            }
        }
        format!("there are no masks, but {hint}")
    }
}

/// What a folder may be that has an image for each photograph.
pub(crate) fn masks_hint(folder: &Path) -> String {
    format!("{} has images of the same names: rename it to masks/ if it holds masks", folder.display())
}

/// Whether two paths are of one folder.
fn are_same(a: &Path, b: &Path) -> bool {
    a == b || a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b))
}

/// The word for a split in a name in lower case.
fn split_word(name: &str) -> Option<&str> {
    name.split(|c: char| !c.is_alphabetic()).find(|word| SPLITS.contains(word))
}

/// Whether a name in lower case is one of a folder of masks.
fn is_called_masks(name: &str) -> bool {
    let mut words = name.split(|c: char| !c.is_alphabetic());
    WITHIN.iter().any(|word| name.contains(word)) || words.any(|word| WORDS.contains(&word))
}

/// Whether an image that can be read is nearly black or white almost everywhere, and has both.
fn is_mask(image: &Path) -> bool {
    read_mask(image, Orientation::AsStored).is_ok_and(|loaded| {
        let coverage = &loaded.mask.coverage;
        let decided = coverage.iter().filter(|value| !(0.1..0.9).contains(*value)).count();
        let has_both = coverage.iter().any(|value| *value < 0.1) && coverage.iter().any(|value| *value > 0.9);
        has_both && decided as f32 >= DECIDED * coverage.len() as f32
    })
}

/// The photographs of views of which none has a mask of its own.
fn bare_photographs(views: &[ViewPlan]) -> Option<Vec<&Path>> {
    let is_bare = |view: &ViewPlan| !matches!(view.mask, MaskPlan::File(_));
    let photographs = views.iter().map(|view| view.image.as_deref().filter(|_| is_bare(view)));
    photographs.collect::<Option<Vec<_>>>().filter(|photographs| !photographs.is_empty())
}

/// Folders in that of the data set, and in the one above that of the photographs; by name, those of the data set first.
fn candidates(dir: &Path, photographs: &Path) -> Vec<PathBuf> {
    let above = photographs.parent().filter(|above| *above != dir && above.starts_with(dir));
    let of_photographs = file_name(photographs).to_lowercase();
    let is_candidate = |path: &PathBuf| {
        let name = file_name(path).to_lowercase();
        let has_other_images = OTHERS.iter().any(|other| name.starts_with(other)) && !is_called_masks(&name);
        let is_of_another_split =
            split_word(&name).is_some_and(|word| split_word(&of_photographs) != Some(word));
        let is_other = name.starts_with('.') || has_other_images || is_of_another_split;
        path != photographs && path.is_dir() && !photographs.starts_with(path) && !is_other
    };
    let inside = |folder: &Path| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut folders: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_candidate).collect();
        folders.sort_by(|a, b| natural_order(&file_name(a), &file_name(b)));
        folders
    };
    inside(dir).into_iter().chain(above.into_iter().flat_map(inside)).collect()
}
