//! The layouts: what identifies each, which splits a folder has in it, and who reads it.

use crate::codec::file::{FileKind, Obstacle, is_there, obstacle};
use crate::codec::image::{IMAGE_EXTENSIONS, is_unread_name};
use crate::codec::nearby::{missing_file_help, natural_order};
use crate::dataset::names::PHOTOGRAPH_FOLDERS;
use crate::dataset::options::{DatasetOptions, Layout};
use crate::dataset::plan::Plan;
use crate::dataset::{
    colmap, deepvoxels, idr, llff, metashape, nerf, nerfactor, physg, reality_capture, stanford_orb,
};
use crate::error::{Error, Result};
use crate::view::Split;
use std::path::{Path, PathBuf};

/// How one layout is recognized and read.
pub(super) struct LayoutReader {
    /// The layout; never `Auto`.
    pub layout: Layout,
    /// Offset of a pixel's center from its index, unless the options say otherwise.
    pub pixel_center: f32,
    /// The files that identify it, for errors.
    mark: &'static str,
    /// Whether a folder has files of this split. Views that nothing divides are of the training split.
    has: fn(&Path, Split) -> bool,
    /// Plans the views of a split that the folder has.
    plan: fn(&Path, Split) -> Result<Plan>,
}

static READERS: [LayoutReader; 10] = [
    LayoutReader {
        layout: Layout::PhySg,
        pixel_center: 0.5,
        mark: "train/cam_dict_norm.json or test/cam_dict_norm.json",
        has: |dir, split| is_there(&physg::camera_file(dir, split)),
        plan: physg::plan,
    },
    LayoutReader {
        layout: Layout::Nerf,
        pixel_center: 0.5,
        mark: "transforms_train.json, transforms_test.json or transforms.json",
        has: nerf::has_split,
        plan: nerf::plan,
    },
    LayoutReader {
        layout: Layout::Colmap,
        pixel_center: 0.5,
        mark: "cameras and images, .bin or .txt, in sparse/0, sparse, colmap/sparse, dense/sparse, colmap_text, colmap, model or 0",
        has: colmap::has_split,
        plan: colmap::plan,
    },
    LayoutReader {
        layout: Layout::DeepVoxels,
        pixel_center: 0.5,
        mark: "intrinsics.txt, or train/intrinsics.txt",
        has: |dir, split| deepvoxels::split_folder(dir, split).is_some(),
        plan: deepvoxels::plan,
    },
    LayoutReader {
        layout: Layout::Idr,
        pixel_center: 0.0,
        mark: "cameras_sphere.npz or cameras.npz",
        has: |dir, split| split == Split::Train && idr::camera_file(dir).is_some(),
        plan: |dir, _| idr::plan(dir),
    },
    LayoutReader {
        layout: Layout::Llff,
        pixel_center: 0.5,
        mark: "poses_bounds.npy",
        has: |dir, split| split == Split::Train && is_there(&llff::camera_file(dir)),
        plan: |dir, _| llff::plan(dir),
    },
    LayoutReader {
        layout: Layout::StanfordOrb,
        pixel_center: 0.5,
        mark: "train_mask beside transforms_train.json",
        has: |dir, split| is_stanford_orb(dir) && is_there(&nerf::camera_file(dir, split)),
        plan: stanford_orb::plan,
    },
    LayoutReader {
        layout: Layout::Nerfactor,
        pixel_center: 0.5,
        mark: "metadata.json in train_000 or test_000",
        has: nerfactor::has_split,
        plan: nerfactor::plan,
    },
    LayoutReader {
        layout: Layout::RealityCapture,
        pixel_center: 0.5,
        mark: reality_capture::EXPORT.mark,
        has: |dir, split| split == Split::Train && !reality_capture::EXPORT.files(dir).is_empty(),
        plan: |dir, _| reality_capture::plan(dir),
    },
    LayoutReader {
        layout: Layout::Metashape,
        pixel_center: 0.5,
        mark: metashape::EXPORT.mark,
        has: |dir, split| split == Split::Train && !metashape::EXPORT.files(dir).is_empty(),
        plan: |dir, _| metashape::plan(dir),
    },
];

/// That one layout is read where a folder has two.
struct Precedence {
    layout: Layout,
    /// The one that is not read.
    over: Layout,
    /// In which folders.
    holds: fn(&Path) -> bool,
    /// What the user should know; may be empty.
    note: &'static str,
}

static PRECEDENCE: [Precedence; 6] = [
    // The scripts that render such sets write files of NeRF's form beside the folders, whose paths lack the light.
    Precedence { layout: Layout::Nerfactor, over: Layout::Nerf, holds: |_| true, note: "" },
    Precedence { layout: Layout::StanfordOrb, over: Layout::Nerf, holds: |_| true, note: "" },
    // The poses of public data of LLFF and mip-NeRF 360 are computed from the model, which has lens distortion as well.
    Precedence {
        layout: Layout::Colmap,
        over: Layout::Llff,
        holds: |dir| !colmap::is_for_the_record(dir),
        note: "the cameras are those of the COLMAP model; poses_bounds.npy is not read (`layout: Llff` reads it)",
    },
    Precedence { layout: Layout::Llff, over: Layout::Colmap, holds: colmap::is_for_the_record, note: "" },
    Precedence { layout: Layout::Nerf, over: Layout::Colmap, holds: colmap::is_for_the_record, note: "" },
    Precedence { layout: Layout::Idr, over: Layout::Colmap, holds: colmap::is_for_the_record, note: "" },
];

/// NeRF's layout with folders of masks beside those of the photographs.
fn is_stanford_orb(dir: &Path) -> bool {
    let is_there =
        |split| is_there(&nerf::camera_file(dir, split)) && is_there(&stanford_orb::mask_folder(dir, split));
    is_there(Split::Train) || is_there(Split::Test)
}

impl LayoutReader {
    /// Plans the views of a split, in natural order of their names; of data without a test split, those that `hold_out` gives it.
    pub fn plan(&self, dir: &Path, split: Split, hold_out: u32) -> Result<Plan> {
        let is_held_out = self.is_held_out(dir);
        let mut plan = (self.plan)(dir, if is_held_out { Split::Train } else { split })?;
        plan.views.sort_by(|a, b| natural_order(&a.name, &b.name));
        if is_held_out { held_out(plan, split, hold_out) } else { Ok(plan) }
    }

    fn is_there(&self, dir: &Path) -> bool {
        (self.has)(dir, Split::Train) || (self.has)(dir, Split::Test)
    }

    /// Whether the test split is made of training views: the folder brings none.
    fn is_held_out(&self, dir: &Path) -> bool {
        (self.has)(dir, Split::Train) && !(self.has)(dir, Split::Test)
    }

    /// The word for `layout:` in a scene file.
    fn name(&self) -> String {
        format!("{:?}", self.layout)
    }
}

/// Whether the data set in folder `dir` has this split, or `hold_out` makes it.
///
/// # Errors
/// [`Error::Input`] if the layout cannot be determined.
pub(crate) fn has_split(dir: impl AsRef<Path>, split: Split, options: &DatasetOptions) -> Result<bool> {
    let dir = dir.as_ref();
    let reader = find_reader(dir, options.layout, in_scene_file)?.reader;
    let makes = split == Split::Test && options.hold_out > 0 && reader.is_held_out(dir);
    Ok(makes || (reader.has)(dir, split))
}

/// How a scene file asks for a layout.
pub(super) fn in_scene_file(layout: Layout) -> String {
    format!("`layout: {layout:?}`")
}

/// The requested layout of the data set in folder `dir`, or for `Auto` the only one that is present. `choice` says how the user asks for a
/// layout: it is the help for a folder of several.
///
/// # Errors
/// [`Error::Input`] if there is no such folder, or for `Auto` not exactly one layout.
pub(crate) fn find_layout(
    dir: impl AsRef<Path>,
    asked: Layout,
    choice: fn(Layout) -> String,
) -> Result<Layout> {
    find_reader(dir.as_ref(), asked, choice).map(|found| found.reader.layout)
}

/// The reader of a layout, and what the user should know of the choice.
pub(super) struct FoundLayout {
    pub reader: &'static LayoutReader,
    pub note: Option<&'static str>,
}

/// The reader of the requested layout, or for `Auto` of the only one that is present and yields to no other.
pub(super) fn find_reader(dir: &Path, asked: Layout, choice: fn(Layout) -> String) -> Result<FoundLayout> {
    if let Some(Obstacle { problem, help }) = obstacle(dir, FileKind::Folder) {
        let help = if help.is_empty() { missing_file_help(dir) } else { help };
        return Err(Error::input(dir, "", problem, help));
    }
    if let Some(reader) = READERS.iter().find(|reader| reader.layout == asked) {
        return Ok(FoundLayout { reader, note: None });
    }
    let mut found: Vec<&LayoutReader> = READERS.iter().filter(|reader| reader.is_there(dir)).collect();
    let there: Vec<Layout> = found.iter().map(|reader| reader.layout).collect();
    let holds =
        |rule: &&Precedence| there.contains(&rule.layout) && there.contains(&rule.over) && (rule.holds)(dir);
    let rules: Vec<&Precedence> = PRECEDENCE.iter().filter(holds).collect();
    found.retain(|reader| !rules.iter().any(|rule| rule.over == reader.layout));
    match found.as_slice() {
        [reader] => {
            let note = rules.iter().find(|rule| rule.layout == reader.layout && !rule.note.is_empty());
            Ok(FoundLayout { reader, note: note.map(|rule| rule.note) })
        }
        [] => Err(unrecognized(dir)),
        several => Err(ambiguous(dir, several, choice)),
    }
}

/// The views of a split, from all views, ordered by name.
fn held_out(plan: Plan, split: Split, hold_out: u32) -> Result<Plan> {
    let is_test = |i: usize| hold_out > 0 && i.is_multiple_of(hold_out as usize);
    if let (Split::Train, [only]) = (split, plan.views.as_slice())
        && is_test(0)
    {
        let problem = "the train split has no views: the only view of the file is held out as the test split";
        let help = "Give `hold_out: 0`, or a file with more views.";
        return Err(Error::input(&only.camera_file, &only.place, problem, help));
    }
    let views = plan.views.into_iter().enumerate();
    let views = views.filter(|(i, _)| is_test(*i) == (split == Split::Test)).map(|(_, view)| view).collect();
    // Notes about all views are reported once, with the training split, which always exists.
    Ok(Plan { views, notes: if split == Split::Train { plan.notes } else { Vec::new() } })
}

fn ambiguous(dir: &Path, several: &[&LayoutReader], choice: fn(Layout) -> String) -> Error {
    let names: Vec<String> = several.iter().map(|reader| reader.name()).collect();
    let choices: Vec<String> = several.iter().map(|reader| choice(reader.layout)).collect();
    let problem = format!("the folder has several layouts: {}", names.join(", "));
    Error::input(dir, "", problem, format!("Say which one with {}.", choices.join(" or ")))
}

fn unrecognized(dir: &Path) -> Error {
    let marks = READERS.iter().map(|reader| format!("{} (layout {})", reader.mark, reader.name()));
    let looked_for: Vec<String> = marks.collect();
    let problem = format!("this is not a data set: looked for {}", looked_for.join("; "));
    let help = near_miss(dir).unwrap_or_else(|| missing_file_help(&dir.join("transforms_train.json")));
    Error::input(dir, "", problem, help)
}

/// What a folder in no layout probably is, and what to do with it.
fn near_miss(dir: &Path) -> Option<String> {
    let has = |name: &str| dir.join(name).is_file();
    if has("cam_dict_norm.json") {
        return Some("This is one split; give the folder above it.".to_owned());
    }
    if has("cameras.bin") || has("cameras.txt") {
        let help =
            "This is a COLMAP model; give the folder that has it in sparse/0, beside images and masks.";
        return Some(help.to_owned());
    }
    let entries: Vec<PathBuf> = std::fs::read_dir(dir).ok()?.flatten().map(|entry| entry.path()).collect();
    let is_data = |path: &Path| READERS.iter().find(|reader| path.is_dir() && reader.is_there(path));
    let mut inside: Vec<(&PathBuf, &LayoutReader)> =
        entries.iter().filter_map(|path| Some((path, is_data(path)?))).collect();
    inside.sort_by_key(|(path, _)| *path);
    if let Some((path, reader)) = inside.first() {
        return Some(format!(
            "{} is a data set (layout {}): give that folder.",
            path.display(),
            reader.name()
        ));
    }
    if let Some(above) = dir.parent().filter(|above| is_data(above).is_some()) {
        return Some(format!("Give the folder above it: {}.", above.display()));
    }
    reality_capture::near_miss(dir).or_else(|| unposed(dir, &entries))
}

/// Help for photographs, a film or another program's project without cameras.
fn unposed(dir: &Path, entries: &[PathBuf]) -> Option<String> {
    let is_kind = |path: &Path, kinds: &[&str]| {
        let kind = path.extension().and_then(|kind| kind.to_str()).map(str::to_ascii_lowercase);
        kind.is_some_and(|kind| kinds.contains(&kind.as_str()))
    };
    let first = |kinds: &[&str]| entries.iter().filter(|path| is_kind(path, kinds)).min();
    if let Some(project) = first(&["psx", "rcproj", "rsproj"]) {
        let menu = if is_kind(project, &["psx"]) {
            "Metashape: File, Export, Export Cameras, Agisoft XML"
        } else {
            "RealityCapture: Alignment, Registration, Internal/External camera parameters"
        };
        return Some(format!(
            "{} is a project. Export its cameras beside the photographs ({menu}).",
            project.display()
        ));
    }
    let photographs = |folder: &Path| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let is_image = |path: &Path| is_kind(path, &IMAGE_EXTENSIONS) || is_unread_name(path);
        entries.filter(|entry| is_image(&entry.path())).count()
    };
    let mut folders = [""].iter().chain(&PHOTOGRAPH_FOLDERS).map(|name| dir.join(name));
    let folder =
        folders.find_map(|folder| Some((photographs(&folder), folder)).filter(|(count, _)| *count > 1));
    if let Some((count, folder)) = folder {
        return Some(format!(
            "It has {count} photographs and no cameras. `lobelia prepare {} OUT` finds the cameras.",
            folder.display()
        ));
    }
    let film = first(&["mp4", "mov", "m4v", "mkv", "avi", "webm"])?;
    Some(format!("`lobelia prepare {} OUT` makes a data set of the film.", film.display()))
}
