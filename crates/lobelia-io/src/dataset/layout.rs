//! The layouts: what identifies each, which splits a folder has in it, and who reads it.

use crate::codec::file::{FileKind, Obstacle, first_bytes, is_there, obstacle, open};
use crate::codec::image::{IMAGE_EXTENSIONS, has_extension, is_unread_name};
use crate::codec::nearby::{missing_file_help, natural_order};
use crate::dataset::files::{PHOTOGRAPH_FOLDERS, entries, mask_folder};
use crate::dataset::views::{Plan, split_name};
use crate::dataset::{DatasetOptions, Layout, colmap, in_order, nerf, nerfactor, physg};
use lobelia_geometry::{Error, Result, view::Split};
use std::path::{Path, PathBuf};

/// The layouts, and the files that identify each, for errors.
const MARKS: [(Layout, &str); 7] = [
    (Layout::PhySg, "train/cam_dict_norm.json or test/cam_dict_norm.json"),
    (Layout::Nerf, "transforms_train.json, transforms_test.json or transforms.json"),
    (
        Layout::Colmap,
        "cameras and images, .bin or .txt, in sparse/0, sparse, colmap/sparse, dense/sparse, colmap_text, colmap, model or 0",
    ),
    (Layout::Idr, "cameras_sphere.npz or cameras.npz"),
    (Layout::Llff, "poses_bounds.npy"),
    (Layout::StanfordOrb, "train_mask beside transforms_train.json"),
    (Layout::Nerfactor, "metadata.json in train_000 or test_000"),
];

/// Whether a layout is not read in a folder that has these.
fn yields(layout: Layout, dir: &Path, there: &[Layout]) -> bool {
    let has = |of: &[Layout]| of.iter().any(|other| there.contains(other));
    match layout {
        // The scripts that render sets of NeRFactor write files of NeRF's form beside the folders,
        // whose paths lack the light.
        Layout::Nerf => has(&[Layout::StanfordOrb, Layout::Nerfactor]),
        // The poses of public data of LLFF and mip-NeRF 360 are computed from the model, which has
        // lens distortion as well.
        Layout::Llff => has(&[Layout::Colmap]) && !colmap::is_for_the_record(dir),
        Layout::Colmap => has(&[Layout::Llff, Layout::Nerf, Layout::Idr]) && colmap::is_for_the_record(dir),
        _ => false,
    }
}

impl Layout {
    /// Offset of a pixel's center from its index, unless the options say otherwise.
    pub(super) fn pixel_center(self) -> f32 {
        if self == Self::Idr { 0.0 } else { 0.5 }
    }

    /// Whether a folder has files of this split. Views that nothing divides are of the training
    /// split.
    fn has(self, dir: &Path, split: Split) -> bool {
        let is_train = split == Split::Train;
        let is_of_orb = |split| {
            is_there(&nerf::camera_file(dir, split)) && is_there(&nerf::split_mask_folder(dir, split))
        };
        match self {
            Self::Auto => false,
            Self::PhySg => is_there(&physg::camera_file(dir, split)),
            Self::Nerf => nerf::has_split(dir, split),
            Self::Colmap => colmap::has_split(dir, split),
            Self::Idr => is_train && in_order::idr_file(dir).is_some(),
            Self::Llff => is_train && is_there(&in_order::llff_file(dir)),
            Self::StanfordOrb => {
                (is_of_orb(Split::Train) || is_of_orb(Split::Test))
                    && is_there(&nerf::camera_file(dir, split))
            }
            Self::Nerfactor => !nerfactor::view_folders(dir, split).is_empty(),
        }
    }

    /// Plans the views of a split that the folder has.
    fn plan_files(self, dir: &Path, split: Split) -> Result<Plan> {
        match self {
            Self::PhySg => physg::plan(dir, split),
            Self::Auto | Self::Nerf => nerf::plan(dir, split, mask_folder(dir)),
            Self::Colmap => colmap::plan(dir, split),
            Self::Idr => in_order::plan_idr(dir),
            Self::Llff => in_order::plan_llff(dir),
            Self::StanfordOrb => nerf::plan(dir, split, Some(nerf::split_mask_folder(dir, split))),
            Self::Nerfactor => nerfactor::plan(dir, split),
        }
    }

    /// Plans the views of a split, in natural order of their names; of data without a test split,
    /// those that `hold_out` gives it.
    pub(super) fn plan(self, dir: &Path, split: Split, hold_out: u32) -> Result<Plan> {
        let is_held_out = self.is_held_out(dir);
        let split_of_files = if is_held_out { Split::Train } else { split };
        if !self.has(dir, split_of_files) {
            let mark = MARKS.iter().find(|(layout, _)| *layout == self).map_or("", |(_, mark)| mark);
            let wanted = split_name(split);
            let problem = format!("the data set has no {wanted} split of this layout: looked for {mark}");
            let help = if self.is_there(dir) {
                "There is a test split only. Add the train split, or give the files of the test split its name.".to_owned()
            } else {
                missing_file_help(&dir.join(mark.split([' ', ',']).next().unwrap_or_default()))
            };
            return Err(Error::input(dir, "", problem, help));
        }
        let Plan { mut views, mut notes } = self.plan_files(dir, split_of_files)?;
        views.sort_by(|a, b| natural_order(&a.name, &b.name));
        if is_held_out {
            let is_test = |i: usize| hold_out > 0 && i.is_multiple_of(hold_out as usize);
            if let (Split::Train, true, [only]) = (split, is_test(0), views.as_slice()) {
                let problem =
                    "the train split has no views: the only view of the file is held out as the test split";
                return Err(only.wrong(problem, "Give `hold_out: 0`, or a file with more views."));
            }
            let mut indices = 0..;
            views.retain(|_| is_test(indices.next().unwrap_or(0)) == (split == Split::Test));
            // Notes about all views are reported once, with the training split, which always
            // exists.
            notes.retain(|_| split == Split::Train);
        }
        Ok(Plan { views, notes })
    }

    fn is_there(self, dir: &Path) -> bool {
        self.has(dir, Split::Train) || self.has(dir, Split::Test)
    }

    /// Whether the test split is made of training views: the folder brings none.
    fn is_held_out(self, dir: &Path) -> bool {
        self.has(dir, Split::Train) && !self.has(dir, Split::Test)
    }
}

/// Whether the data set in folder `dir` has this split, or `hold_out` makes it.
///
/// # Errors
/// [`Error::Input`] if the layout cannot be determined.
pub fn has_split(dir: impl AsRef<Path>, split: Split, options: &DatasetOptions) -> Result<bool> {
    let dir = dir.as_ref();
    let layout = find_layout(dir, options.layout, in_scene_file)?;
    let makes = split == Split::Test && options.hold_out > 0 && layout.is_held_out(dir);
    Ok(makes || layout.has(dir, split))
}

/// How a scene file asks for a layout.
pub(super) fn in_scene_file(layout: Layout) -> String {
    format!("`layout: {layout:?}`")
}

/// The requested layout of the data set in folder `dir`, or for `Auto` the only one that is
/// present. `choice` says how the user asks for a layout: it is the help for a folder of several.
///
/// # Errors
/// [`Error::Input`] if there is no such folder, or for `Auto` not exactly one layout.
pub fn find_layout(dir: impl AsRef<Path>, asked: Layout, choice: fn(Layout) -> String) -> Result<Layout> {
    find_with_note(dir.as_ref(), asked, choice).map(|(layout, _)| layout)
}

/// [`find_layout`], where the layout that is found yields to no other, with what the user should
/// know of the choice.
pub(super) fn find_with_note(
    dir: &Path,
    asked: Layout,
    choice: fn(Layout) -> String,
) -> Result<(Layout, Option<&'static str>)> {
    if let Some(Obstacle { problem, help }) = obstacle(dir, FileKind::Folder) {
        let help = if help.is_empty() { missing_file_help(dir) } else { help };
        return Err(Error::input(dir, "", problem, help));
    }
    if asked != Layout::Auto {
        return Ok((asked, None));
    }
    let there: Vec<Layout> = MARKS.iter().map(|mark| mark.0).filter(|of| of.is_there(dir)).collect();
    let found: Vec<Layout> = there.iter().copied().filter(|layout| !yields(*layout, dir, &there)).collect();
    match found.as_slice() {
        [layout] => {
            let has_poses = *layout == Layout::Colmap && there.contains(&Layout::Llff);
            let note = "the cameras are those of the COLMAP model; poses_bounds.npy is not read (`layout: Llff` reads it)";
            Ok((*layout, has_poses.then_some(note)))
        }
        [] => {
            let looked_for = MARKS.map(|(layout, mark)| format!("{mark} (layout {layout:?})")).join("; ");
            let help =
                near_miss(dir).unwrap_or_else(|| missing_file_help(&dir.join("transforms_train.json")));
            Err(Error::input(dir, "", format!("this is not a data set: looked for {looked_for}"), help))
        }
        several => {
            let names: Vec<String> = several.iter().map(|layout| format!("{layout:?}")).collect();
            let choices: Vec<String> = several.iter().map(|layout| choice(*layout)).collect();
            let problem = format!("the folder has several layouts: {}", names.join(", "));
            Err(Error::input(dir, "", problem, format!("Say which one with {}.", choices.join(" or "))))
        }
    }
}

/// Help for a folder in no layout: its probable kind, and what to do with it.
fn near_miss(dir: &Path) -> Option<String> {
    let has = |name: &str| dir.join(name).is_file();
    if has("cameras.bin") || has("cameras.txt") {
        return Some(
            "This is a COLMAP model; give the folder that has it in sparse/0, beside images and masks."
                .into(),
        );
    }
    let mut inside: Vec<PathBuf> = entries(dir).collect();
    inside.sort();
    let is_data = |path: &Path| MARKS.iter().map(|mark| mark.0).find(|of| path.is_dir() && of.is_there(path));
    if let Some((path, layout)) = inside.iter().find_map(|path| Some((path.display(), is_data(path)?))) {
        return Some(format!("{path} is a data set (layout {layout:?}): give that folder."));
    }
    if let Some(above) = dir.parent().filter(|above| is_data(above).is_some()) {
        return Some(format!("Give the folder above it: {}.", above.display()));
    }
    if let Some(help) = inside.iter().find_map(|file| foreign(file)) {
        return Some(help);
    }
    let is_image = |path: &PathBuf| has_extension(path, &IMAGE_EXTENSIONS) || is_unread_name(path);
    for folder in [""].iter().chain(&PHOTOGRAPH_FOLDERS).map(|name| dir.join(name)) {
        let count = entries(&folder).filter(is_image).count();
        if count > 1 {
            let folder = folder.display();
            return Some(format!(
                "It has {count} photographs and no cameras. `lobelia prepare {folder} OUT` finds the cameras."
            ));
        }
    }
    let film =
        inside.iter().find(|path| has_extension(path, &["mp4", "mov", "m4v", "mkv", "avi", "webm"]))?;
    Some(format!("`lobelia prepare {} OUT` makes a data set of the film.", film.display()))
}

/// Help for cameras of Metashape or RealityCapture in a format of their own, and for their
/// projects.
fn foreign(file: &Path) -> Option<String> {
    const HEAD_BYTES: usize = 4096;
    let head = if has_extension(file, &["xml", "csv"]) {
        first_bytes(file, &mut open(file, |_| String::new()).ok()?, HEAD_BYTES).ok()?
    } else {
        Vec::new()
    };
    let head = String::from_utf8_lossy(&head).to_lowercase();
    let has_columns = |line: &str| {
        let trim = |name: &str| name.trim().trim_start_matches(['\u{feff}', '#']).to_owned();
        let names: Vec<String> = line.split([',', ';', '\t']).map(trim).collect();
        ["name", "x", "y", "alt"].iter().all(|name| names.iter().any(|found| found == name))
    };
    let is_project = head.contains("<document") && head.contains("<chunk");
    let (program, menu) = if has_extension(file, &["psx"]) || (has_extension(file, &["xml"]) && is_project) {
        ("Metashape", "File > Export > Export Cameras, COLMAP")
    } else if has_extension(file, &["rcproj", "rsproj"])
        || (has_extension(file, &["csv"]) && head.lines().any(has_columns))
    {
        ("RealityCapture", "Export > Registration > COLMAP")
    } else {
        return None;
    };
    let file = file.display();
    Some(format!("{file} is of {program}, which exports COLMAP's format: {menu}. That is read."))
}
