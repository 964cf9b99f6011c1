//! Masks in files of their own, under the usual names of folders and files.

use crate::codec::file::is_there;
use crate::codec::nearby::missing_file_help;
use crate::dataset::load::{StemIndex, file_name};
use crate::dataset::names::{PHOTOGRAPH_FOLDERS, quoted, view_name};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Names of mask folders in lower case, in the order in which they are looked for.
const FOLDERS: [&str; 12] = [
    "masks",
    "mask",
    "silhouettes",
    "silhouette",
    "segmentation",
    "segmentations",
    "seg",
    "alpha",
    "images_mask",
    "images_masks",
    "image_mask",
    "image_masks",
];
/// Words in the names of masks, besides the name of the photograph.
const WORDS: [&str; 3] = ["mask", "seg", "alpha"];

/// The folder of masks in `dir`, or in its folder of photographs, if there is one. Case does not count.
pub(super) fn mask_folder(dir: &Path) -> Option<PathBuf> {
    let first = |dir: &Path, names: &[&str]| names.iter().find_map(|name| called(dir, name));
    let above = PHOTOGRAPH_FOLDERS.iter().filter_map(|name| called(dir, name));
    let mut above = above.filter(|folder| folder.is_dir());
    first(dir, &FOLDERS).or_else(|| above.find_map(|folder| first(&folder, &FOLDERS[..2])))
}

/// The entry of `dir` with this name in lower case; of several, the one that has it as it is, or else the first.
fn called(dir: &Path, name: &str) -> Option<PathBuf> {
    let exact = dir.join(name);
    if is_there(&exact) {
        return Some(exact);
    }
    let entries = std::fs::read_dir(dir).ok()?.flatten().map(|entry| entry.path());
    entries.filter(|path| file_name(path).to_lowercase() == name).min()
}

/// The images in the folder of masks in `dir`, if it has one.
pub(super) fn masks_in(dir: &Path) -> Result<Option<StemIndex>> {
    Ok(mask_folder(dir).map(|folder| StemIndex::of_folder(&folder)).transpose()?.flatten())
}

/// Names without extension that the mask of the photograph with the file name `photograph` may have, the most exact first. For `a.jpg`:
/// `a.jpg`, `a`, `a.jpg.mask`, `a.mask`, `a_mask`, `a-mask`, `mask_a` and the like.
pub(crate) fn mask_stems(photograph: &str) -> Vec<String> {
    let name = view_name(photograph);
    let mut stems =
        vec![photograph.to_owned(), name.clone(), format!("{photograph}.mask"), format!("{name}.mask")];
    for word in WORDS {
        stems.extend([format!("{name}_{word}"), format!("{name}-{word}"), format!("{word}_{name}")]);
    }
    stems
}

/// The mask of the photograph with the file name `photograph`, under any of its [`mask_stems`], with any image extension.
pub(super) fn find_mask(masks: &StemIndex, photograph: &str) -> Result<PathBuf> {
    mask_file(masks, photograph).ok_or_else(|| {
        let name = view_name(photograph);
        let path = masks.folder.join(format!("{name}.png"));
        let problem = format!(
            "the mask of {} is missing; {photograph}.png, {name}_mask.png or mask_{name}.png would also do, with any \
             image extension",
            quoted(photograph)
        );
        Error::input(&path, "", problem, missing_file_help(&path))
    })
}

/// [`find_mask`] without an error. Case counts only where two names differ in nothing else.
pub(super) fn mask_file(masks: &StemIndex, photograph: &str) -> Option<PathBuf> {
    let stems = mask_stems(photograph);
    let in_lower_case = || stems.iter().find_map(|stem| masks.stem_in_lower_case(&stem.to_lowercase()));
    stems.iter().find_map(|stem| masks.stem(stem)).or_else(in_lower_case)
}
