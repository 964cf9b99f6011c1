//! Detection of the layout of a folder.

use crate::codec::nearby::missing_file_help;
use crate::dataset::{DatasetOptions, Layout, colmap, deepvoxels, nerf, physg};
use crate::error::{Error, Result};
use crate::view::Split;
use std::path::Path;

/// The layouts, their names in errors, and the files that identify them.
const LAYOUTS: [(Layout, &str, &str); 4] = [
    (Layout::PhySg, "PhySg", "train/cam_dict_norm.json or test/cam_dict_norm.json"),
    (Layout::Nerf, "Nerf", "transforms_train.json or transforms_test.json"),
    (Layout::Colmap, "Colmap", "cameras and images, .bin or .txt, in sparse/0 or sparse"),
    (Layout::DeepVoxels, "DeepVoxels", "intrinsics.txt, or train/intrinsics.txt"),
];

/// Whether the data set in folder `dir` has this split.
///
/// # Errors
/// [`Error::Input`] if the layout cannot be determined.
pub fn has_split(dir: impl AsRef<Path>, split: Split, options: &DatasetOptions) -> Result<bool> {
    let dir = dir.as_ref();
    let holds_out = split == Split::Train || options.hold_out > 0;
    Ok(match find_layout(dir, options.layout)? {
        Layout::PhySg => physg::camera_file(dir, split).is_file(),
        Layout::Nerf | Layout::Auto => nerf::camera_file(dir, split).is_file(),
        Layout::Colmap => holds_out,
        Layout::DeepVoxels => {
            deepvoxels::split_folder(dir, split).is_some_and(|(_, is_all)| !is_all || holds_out)
        }
    })
}

/// The requested layout of the data set in folder `dir`, or for `Auto` the only one that is present.
///
/// # Errors
/// [`Error::Input`] if there is no such folder, or for `Auto` not exactly one layout.
pub fn find_layout(dir: &Path, asked: Layout) -> Result<Layout> {
    if !dir.is_dir() {
        let what = if dir.exists() { "this is a file, not a folder" } else { "there is no such folder" };
        return Err(Error::input(dir, "", what, missing_file_help(dir)));
    }
    if asked != Layout::Auto {
        return Ok(asked);
    }
    let found: Vec<_> = LAYOUTS.iter().filter(|(layout, ..)| is_there(dir, *layout)).collect();
    match found.as_slice() {
        [(layout, ..)] => Ok(*layout),
        [] => Err(unrecognized(dir)),
        several => Err(ambiguous(dir, several)),
    }
}

fn is_there(dir: &Path, layout: Layout) -> bool {
    [Split::Train, Split::Test].into_iter().any(|split| match layout {
        Layout::PhySg => physg::camera_file(dir, split).is_file(),
        Layout::Nerf => nerf::camera_file(dir, split).is_file(),
        Layout::Colmap => colmap::camera_file(dir).is_some(),
        Layout::DeepVoxels => deepvoxels::split_folder(dir, split).is_some(),
        Layout::Auto => false,
    })
}

fn ambiguous(dir: &Path, several: &[&(Layout, &str, &str)]) -> Error {
    let names: Vec<&str> = several.iter().map(|(_, name, _)| *name).collect();
    let choices: Vec<String> = names.iter().map(|name| format!("`layout: {name}`")).collect();
    let problem = format!("the folder has several layouts: {}", names.join(", "));
    Error::input(dir, "", problem, format!("Say which one with {}.", choices.join(" or ")))
}

fn unrecognized(dir: &Path) -> Error {
    let looked_for: Vec<String> =
        LAYOUTS.iter().map(|(_, name, mark)| format!("{mark} (layout {name})")).collect();
    let problem = format!("this is not a data set: looked for {}", looked_for.join("; "));
    let has = |name: &str| dir.join(name).is_file();
    let help = if has("cam_dict_norm.json") {
        "This is one split; give the folder above it.".to_owned()
    } else if has("cameras.bin") || has("cameras.txt") {
        "This is a COLMAP model; give the folder that has it in sparse/0, beside images and masks.".to_owned()
    } else {
        missing_file_help(&dir.join("transforms_train.json"))
    };
    Error::input(dir, "", problem, help)
}
