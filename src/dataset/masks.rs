//! Masks in files of their own, under the usual names of folders and files.

use crate::codec::file::is_there;
use crate::codec::nearby::missing_file_help;
use crate::dataset::load::{StemIndex, view_name};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Names of mask folders, in the order in which they are looked for.
const FOLDERS: [&str; 7] =
    ["masks", "mask", "silhouettes", "silhouette", "segmentation", "segmentations", "seg"];

/// The folder of masks in `dir`, if it has one.
pub(super) fn mask_folder(dir: &Path) -> Option<PathBuf> {
    FOLDERS.iter().map(|name| dir.join(name)).find(|folder| is_there(folder))
}

/// The mask of the photograph with the file name `photograph`, e.g. `a.jpg`: `a.jpg.png`, `a.png`, `a_mask.png`, `mask_a.png` and the
/// like, with any image extension.
pub(super) fn find_mask(masks: &StemIndex, photograph: &str) -> Result<PathBuf> {
    mask_file(masks, photograph).ok_or_else(|| {
        let name = view_name(photograph);
        let path = masks.folder.join(format!("{name}.png"));
        let problem = format!(
            "the mask of `{photograph}` is missing; {photograph}.png, {name}_mask.png or mask_{name}.png would also do"
        );
        Error::input(&path, "", problem, missing_file_help(&path))
    })
}

/// [`find_mask`] without an error.
pub(super) fn mask_file(masks: &StemIndex, photograph: &str) -> Option<PathBuf> {
    let name = view_name(photograph);
    let stems = [
        photograph.to_owned(),
        name.clone(),
        format!("{photograph}.mask"),
        format!("{name}.mask"),
        format!("{name}_mask"),
        format!("{name}-mask"),
        format!("mask_{name}"),
    ];
    stems.iter().find_map(|stem| masks.stem(stem))
}
