//! The layout of NeRF, Blender, nerfstudio, Polycam and instant-ngp: camera files `DIR/transforms_{train,test}.json`, or one
//! `DIR/transforms.json` for all views, and the images they name.
//!
//! Each frame has a `transform_matrix` (4×4 or 3×4, world_from_camera with OpenGL axes: x right, y up, z backward) and a
//! `file_path` relative to `DIR`, with or without extension. Intrinsics are at the top level or in a frame; those of the frame
//! have priority: `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h` in pixels, or full fields of view: `camera_angle_x`, `camera_angle_y` in
//! radians, `x_fov`, `y_fov` in degrees. `camera_model` (or `is_fisheye`) says which lens `k1` to `k6`, `p1` and `p2` are of.
//!
//! A frame may have a `mask_path`; where none has, a folder of masks in `DIR` is read, with the folders of the images in it or without.
//! Else alpha is the mask. Images that are not where `file_path` says are looked for in `DIR/images` and `DIR`. If there are no images, the
//! views are cameras only and `w`, `h` are needed.
//!
//! Without `transforms_test.json`, `transforms_val.json` is the test split. One file for all views may have the lists `train_filenames`,
//! `val_filenames` and `test_filenames`. Where neither gives a test split see [`crate::dataset::DatasetOptions::hold_out`]. Poses are taken
//! as they are: `applied_transform` is not undone. Photographs are taken as they are stored, as all these programs read them.

use crate::codec::file::is_there;
use crate::codec::nearby::closest;
use crate::dataset::folders::{Folders, flat_name};
use crate::dataset::load::{find_image, parse_json, read_text};
use crate::dataset::masks::mask_folder;
use crate::dataset::names::{portable, quoted, view_name};
use crate::dataset::nerf_frames::{
    NerfFrame, check_paths, common_folder, find_elsewhere, find_images, place_of,
};
use crate::dataset::nerf_lens::{Intrinsics, Levels};
use crate::dataset::plan::{MaskPlan, Plan, ViewPlan, absent_split, split_name};
use crate::dataset::pose::Rigid;
use crate::error::{Error, Result};
use crate::view::Split;
use serde::Deserialize;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The file that describes the cameras of one split.
pub(crate) fn camera_file(dir: &Path, split: Split) -> PathBuf {
    file_of(dir, split_word(dir, split))
}

/// The word for a split in names: `val` where the folder has a file of that for the test split, and none of `test`.
pub(crate) fn split_word(dir: &Path, split: Split) -> &'static str {
    let is_val = split == Split::Test && !is_there(&file_of(dir, "test")) && is_there(&file_of(dir, "val"));
    if is_val { "val" } else { split_name(split) }
}

fn file_of(dir: &Path, word: &str) -> PathBuf {
    dir.join(format!("transforms_{word}.json"))
}

/// The file that describes the cameras of all splits, if the folder has that and none of a split.
fn common_file(dir: &Path) -> Option<PathBuf> {
    let is_split = ["train", "test"].iter().any(|word| is_there(&file_of(dir, word)));
    Some(dir.join("transforms.json")).filter(|file| !is_split && is_there(file))
}

/// Whether the folder has this split: a file of it, or one file for all views, which has a test split if it lists one.
pub(crate) fn has_split(dir: &Path, split: Split) -> bool {
    match (common_file(dir), split) {
        (None, _) => is_there(&camera_file(dir, split)),
        (Some(_), Split::Train) => true,
        // A file that cannot be read is reported when it is.
        (Some(file), Split::Test) => lists(&file).is_ok_and(|lists| lists.held_out().is_some()),
    }
}

// `#[serde(flatten)]` loses the line and column of an error, so the text is parsed once for each of these.
#[derive(Deserialize)]
struct Frames {
    frames: Vec<NerfFrame>,
}

#[derive(Deserialize)]
struct FrameIntrinsics {
    frames: Vec<Intrinsics>,
}

/// nerfstudio's lists of the views of each split.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Lists {
    train_filenames: Option<Vec<String>>,
    val_filenames: Option<Vec<String>>,
    test_filenames: Option<Vec<String>>,
    applied_transform: Option<Vec<Vec<f64>>>,
}

fn lists(file: &Path) -> Result<Lists> {
    parse_json(file, &read_text(file)?)
}

impl Lists {
    fn are_stated(&self) -> bool {
        self.train_filenames.is_some() || self.held_out().is_some()
    }

    /// The test split, which may be called validation; an empty list is none.
    fn held_out(&self) -> Option<&Vec<String>> {
        [&self.test_filenames, &self.val_filenames].into_iter().flatten().find(|names| !names.is_empty())
    }

    fn all(&self) -> impl Iterator<Item = (&'static str, &String)> {
        let lists = [
            ("train_filenames", &self.train_filenames),
            ("val_filenames", &self.val_filenames),
            ("test_filenames", &self.test_filenames),
        ];
        lists.into_iter().flat_map(|(list, names)| names.iter().flatten().map(move |name| (list, name)))
    }

    /// Whether the split has the image `path`; without a list, the training split has those of no other list.
    fn contains(&self, split: Split, path: &str) -> bool {
        let is_in = |names: &Vec<String>| names.iter().any(|name| portable(name) == path);
        match (split, &self.train_filenames, self.held_out()) {
            (Split::Train, Some(train), _) => is_in(train),
            (Split::Train, None, _) => !self.all().any(|(_, name)| portable(name) == path),
            (Split::Test, _, Some(test)) => is_in(test),
            (Split::Test, _, None) => false,
        }
    }
}

/// Plans the views of a split; those of one file without lists are all of the training split.
pub(super) fn plan(dir: &Path, split: Split) -> Result<Plan> {
    plan_with(dir, split, mask_folder(dir))
}

/// [`plan`] with this folder of masks for frames that name none.
pub(super) fn plan_with(dir: &Path, split: Split, masks: Option<PathBuf>) -> Result<Plan> {
    let common = common_file(dir);
    let file = common.clone().unwrap_or_else(|| camera_file(dir, split));
    if !is_there(&file) {
        return Err(absent_split(dir, split, camera_file));
    }
    let text = read_text(&file)?;
    let frames = frames_of(&file, &text, split)?;
    let shared: Intrinsics = parse_json(&file, &text)?;
    let FrameIntrinsics { frames: own } = parse_json(&file, &text)?;
    let lists: Lists = parse_json(&file, &text)?;
    let images = find_images(dir, &file, &frames)?;
    let masks = masks.filter(|_| frames.iter().all(|frame| frame.mask_path.is_none()));
    let masks = masks.map(|folder| RefCell::new(Folders::below(&folder)));
    let (root, are_moved) = (common_folder(&frames), images.are_moved);
    let reader = Reader { dir, file: &file, shared: &shared, masks, root, are_moved };
    let mut views = Vec::with_capacity(frames.len());
    for (index, ((frame, own), image)) in frames.iter().zip(&own).zip(images.files).enumerate() {
        views.push(reader.plan_view(index, frame, own, image)?);
    }
    // Notes about all views of a file are reported once.
    let mut notes: Vec<String> = note_of_transform(&lists).into_iter().chain(images.note).collect();
    notes.retain(|_| split == Split::Train || common.is_none());
    if common.is_some() && lists.are_stated() {
        views = reader.listed(&lists, split, &frames, views, &mut notes)?;
    }
    Ok(Plan { views, notes })
}

/// The frames of a file, with paths that files and views can have.
fn frames_of(file: &Path, text: &str, split: Split) -> Result<Vec<NerfFrame>> {
    let Frames { mut frames } = parse_json(file, text)?;
    if frames.is_empty() {
        let problem = format!("the {} split has no views: the list `frames` is empty", split_name(split));
        return Err(Error::input(file, "", problem, "Export the cameras again, or remove the file."));
    }
    frames.iter_mut().for_each(NerfFrame::make_portable);
    check_paths(file, &frames)?;
    Ok(frames)
}

fn note_of_transform(lists: &Lists) -> Option<String> {
    let rows = lists.applied_transform.as_ref()?;
    let is_identity = rows
        .iter()
        .enumerate()
        .all(|(i, row)| row.iter().enumerate().all(|(k, &value)| value == if i == k { 1.0 } else { 0.0 }));
    let note = "the poses are taken as the file has them: applied_transform is not undone, and results are in that world";
    (!is_identity).then(|| note.to_owned())
}

/// What all frames of a camera file share.
struct Reader<'a> {
    dir: &'a Path,
    file: &'a Path,
    shared: &'a Intrinsics,
    /// The folder of masks, if frames do not name theirs.
    masks: Option<RefCell<Folders>>,
    /// The folder of all images, if they are in several below it.
    root: Option<PathBuf>,
    /// Whether the images are not where the frames say.
    are_moved: bool,
}

impl Reader<'_> {
    fn plan_view(
        &self,
        index: usize,
        frame: &NerfFrame,
        own: &Intrinsics,
        image: Option<PathBuf>,
    ) -> Result<ViewPlan> {
        let place = place_of(index, frame);
        let wrong = |problem: String, help: &str| Error::input(self.file, place.clone(), problem, help);
        let help = "transform_matrix is a rotation and a translation, from OpenGL camera axes to the world.";
        let world_from_camera = matrix(&frame.transform_matrix)
            .and_then(|rows| Rigid::from_rows(&rows))
            .map_err(|problem| wrong(format!("transform_matrix {problem}"), help))?
            .in_opencv_axes();
        let lens =
            Levels { own, shared: self.shared }.lens().map_err(|(problem, help)| wrong(problem, help))?;
        let name = match &frame.file_path {
            Some(path) => self.name(path),
            None => format!("frame_{index:06}"),
        };
        Ok(ViewPlan {
            name,
            camera_file: self.file.to_owned(),
            mask: self.mask(frame, image.as_deref())?,
            place,
            image,
            lens,
            world_from_camera: world_from_camera.to_affine(),
            pose_error: world_from_camera.error,
        })
    }

    /// The name of a view: that of its image, with its folders if images are in several.
    fn name(&self, path: &str) -> String {
        let below = self.root.as_ref().and_then(|root| Path::new(path).strip_prefix(root).ok());
        below.map_or_else(|| view_name(path), |below| flat_name(&below.to_string_lossy()))
    }

    fn mask(&self, frame: &NerfFrame, image: Option<&Path>) -> Result<MaskPlan> {
        let Some(image) = image else { return Ok(MaskPlan::Alpha) };
        let photograph = image.strip_prefix(self.dir).unwrap_or(image).to_string_lossy();
        Ok(match (&frame.mask_path, &self.masks) {
            (Some(path), _) => {
                let named = self.dir.join(path);
                let elsewhere = || self.are_moved.then(|| find_elsewhere(self.dir, "masks", path)).flatten();
                MaskPlan::File(find_image(&named).or_else(elsewhere).unwrap_or(named))
            }
            (None, Some(masks)) => masks.borrow_mut().mask_anywhere(&photograph)?,
            (None, None) => MaskPlan::Alpha,
        })
    }

    /// The views that the lists give to a split.
    fn listed(
        &self,
        lists: &Lists,
        split: Split,
        frames: &[NerfFrame],
        views: Vec<ViewPlan>,
        notes: &mut Vec<String>,
    ) -> Result<Vec<ViewPlan>> {
        let paths: Vec<&str> = frames.iter().map(|frame| frame.file_path.as_deref().unwrap_or("")).collect();
        let there: BTreeSet<&str> = paths.iter().copied().collect();
        if let Some((list, name)) = lists.all().find(|(_, name)| !there.contains(portable(name).as_str())) {
            let near = closest(&portable(name), paths.iter().copied()).join(", ");
            let help = if near.is_empty() { String::new() } else { format!("Near: {near}.") };
            return Err(Error::input(
                self.file,
                list,
                format!("no frame has the image {}", quoted(name)),
                help,
            ));
        }
        let is_in = |split: Split, path: &&&str| lists.contains(split, path);
        let unused =
            paths.iter().filter(|path| !is_in(Split::Train, path) && !is_in(Split::Test, path)).count();
        if unused > 0 && split == Split::Train {
            notes.push(format!(
                "{unused} frames are in neither the training nor the test list and are left out"
            ));
        }
        let wanted = views.into_iter().zip(&paths).filter(|(_, path)| is_in(split, path));
        Ok(wanted.map(|(view, _)| view).collect())
    }
}

/// Rows of a 4×4 matrix; a 3×4 one gets the last row of a rigid transform.
fn matrix(rows: &[Vec<f64>]) -> Result<[f64; 16], String> {
    if !matches!(rows.len(), 3 | 4) {
        return Err(format!("has {} rows, not 4", rows.len()));
    }
    let mut result = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    for (i, row) in rows.iter().enumerate() {
        if row.len() != 4 {
            return Err(format!("has {} numbers in row {}, not 4", row.len(), i + 1));
        }
        result[4 * i..4 * i + 4].copy_from_slice(row);
    }
    Ok(result)
}
