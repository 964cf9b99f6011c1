//! The layout of NeRF, Blender, nerfstudio, Polycam and instant-ngp, and of Stanford-ORB's
//! `blender_HDR`, as the manual's chapter on layouts tells it: camera files
//! `DIR/transforms_{train,test}.json`, or one `DIR/transforms.json` for all views, and the images
//! they name.
//!
//! Each frame has a `transform_matrix` (4×4 or 3×4, world_from_camera with OpenGL axes: x right, y
//! up, z backward), which is taken as it is: `applied_transform` is not undone. Intrinsics are at
//! the top of the file or in a frame; those of the frame have priority.

use crate::codec::image::{IMAGE_EXTENSIONS, is_unread_name};
use crate::codec::{file::is_there, nearby::missing_file_help};
use crate::dataset::files::{
    Folders, SplitList, check_image_name, check_path, entries, file_name, flat_name, image_files, leads_away,
    listed, portable, quoted, read_json, refusal_of_unread, tails, view_name,
};
use crate::dataset::lens::{Distortion, Focal, Lens, Trouble, whole_size};
use crate::dataset::pose::Rigid;
use crate::dataset::views::{Plan, ViewPlan, split_name};
use lobelia_geometry::{Error, Result, view::Split};
use serde::{Deserialize, de::IgnoredAny};
use std::path::{Path, PathBuf};

/// The file that describes the cameras of one split.
pub(super) fn camera_file(dir: &Path, split: Split) -> PathBuf {
    file_of(dir, split_word(dir, split))
}

/// The word for a split in names: `val` where the folder has a file of that for the test split, and
/// none of `test`.
fn split_word(dir: &Path, split: Split) -> &'static str {
    let is_val = split == Split::Test && !is_there(&file_of(dir, "test")) && is_there(&file_of(dir, "val"));
    if is_val { "val" } else { split_name(split) }
}

fn file_of(dir: &Path, word: &str) -> PathBuf {
    dir.join(format!("transforms_{word}.json"))
}

/// Stanford-ORB's folder of the masks of a split.
pub(super) fn split_mask_folder(dir: &Path, split: Split) -> PathBuf {
    dir.join(format!("{}_mask", split_word(dir, split)))
}

/// The file that describes the cameras of all splits, if the folder has that and none of a split.
fn common_file(dir: &Path) -> Option<PathBuf> {
    let is_split = ["train", "test"].iter().any(|word| is_there(&file_of(dir, word)));
    Some(dir.join("transforms.json")).filter(|file| !is_split && is_there(file))
}

/// Whether the folder has this split: a file of it, or one file for all views, which has a test
/// split if it lists one.
pub(super) fn has_split(dir: &Path, split: Split) -> bool {
    match (common_file(dir), split) {
        (None, _) => is_there(&camera_file(dir, split)),
        (Some(_), Split::Train) => true,
        // A file that cannot be read is reported when it is.
        (Some(file), Split::Test) => read_json(&file).is_ok_and(|top: Level| top.held_out().is_some()),
    }
}

/// The top of a camera file, or one of its frames. Both may have intrinsics; what only one of them
/// has is absent from the other.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Level {
    frames: Vec<Level>,
    train_filenames: Option<Vec<String>>,
    val_filenames: Option<Vec<String>>,
    test_filenames: Option<Vec<String>>,
    applied_transform: Option<Vec<Vec<f64>>>,
    file_path: Option<String>,
    mask_path: Option<String>,
    transform_matrix: Vec<Vec<f64>>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    x_fov: Option<f64>,
    y_fov: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    k5: Option<f64>,
    k6: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    distortion_params: Option<Vec<f64>>,
    // Instead of a pinhole or fisheye lens, instant-ngp has these.
    ftheta_p0: Option<IgnoredAny>,
    latlong: Option<IgnoredAny>,
    equirectangular: Option<IgnoredAny>,
}

impl Level {
    /// The list of the test split, which may be called validation, and its name; an empty list is
    /// none.
    fn held_out(&self) -> Option<(&'static str, &Vec<String>)> {
        let lists = [("test_filenames", &self.test_filenames), ("val_filenames", &self.val_filenames)];
        let mut stated = lists.into_iter().filter_map(|(name, list)| Some((name, list.as_ref()?)));
        stated.find(|(_, list)| !list.is_empty())
    }

    /// nerfstudio's lists of the views of each split.
    fn lists(&self, file: &Path) -> Vec<SplitList> {
        let (name, held_out) = self.held_out().unzip();
        // Of neither split where there is a list of test views as well.
        let validation = self.val_filenames.as_ref().filter(|_| name == Some("test_filenames"));
        let lists = [
            (Some(Split::Train), "train_filenames", self.train_filenames.as_ref()),
            (Some(Split::Test), name.unwrap_or_default(), held_out),
            (None, "val_filenames", validation),
        ];
        let list = |(split, name, names): (Option<Split>, &str, Option<&Vec<String>>)| {
            let names = names?.iter().map(|path| (path.clone(), name.to_owned())).collect();
            Some(SplitList { file: file.to_owned(), split, names })
        };
        lists.into_iter().filter_map(list).collect()
    }

    /// The coefficient of lens distortion called so.
    fn coefficient(&self, name: &str) -> Option<f64> {
        // The first six in the order of the list.
        let n = ["k1", "k2", "k3", "k4", "p1", "p2", "k5", "k6"].iter().position(|known| *known == name)?;
        let stated = [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2, self.k5, self.k6][n];
        self.distortion_params.as_ref().and_then(|list| list.get(n).copied()).or(stated)
    }
}

/// Plans the views of a split, with this folder of masks if no frame names one; those of one file
/// without lists are all of the training split.
pub(super) fn plan(dir: &Path, split: Split, masks: Option<PathBuf>) -> Result<Plan> {
    let common = common_file(dir);
    let is_common = common.is_some();
    let file = common.unwrap_or_else(|| camera_file(dir, split));
    let mut top: Level = read_json(&file)?;
    if top.frames.is_empty() {
        let problem = format!("the {} split has no views: there are no `frames`", split_name(split));
        return Err(Error::input(file, "", problem, "Export the cameras again, or remove the file."));
    }
    for (index, frame) in top.frames.iter_mut().enumerate() {
        frame.file_path = frame.file_path.as_deref().map(portable);
        frame.mask_path = frame.mask_path.as_deref().map(portable);
        check_paths(&file, index, frame)?;
    }
    let frames = &top.frames;
    let mut search = Search { dir, file: &file, frames, folders: Folders::below(dir) };
    let (files, note) = search.images()?;
    let are_moved = note.is_some();
    let masks = masks.filter(|_| frames.iter().all(|frame| frame.mask_path.is_none()));
    let mut masks = masks.map(Folders::below);
    let root = common_folder(frames);
    let mut views = Vec::with_capacity(frames.len());
    for ((index, frame), image) in frames.iter().enumerate().zip(files) {
        let place = place_of(index, frame);
        let wrong = |(problem, help): Trouble| Error::input(&file, &place, problem, help);
        let pose = matrix(&frame.transform_matrix).and_then(|rows| Rigid::from_rows(rows.as_flattened()));
        let pose = pose.map_err(|problem| {
            let help =
                "transform_matrix is a rotation and a translation, from OpenGL camera axes to the world.";
            wrong((format!("transform_matrix {problem}"), help))
        })?;
        let lens = Levels { own: frame, shared: &top }.lens().map_err(wrong)?;
        let mask = match (&image, &frame.mask_path, &mut masks) {
            (Some(_), Some(path), _) => {
                let elsewhere =
                    |search: &mut Search| are_moved.then(|| search.elsewhere("masks", path)).flatten();
                let found = search.folders.image(path).or_else(|| elsewhere(&mut search));
                Some(found.unwrap_or_else(|| dir.join(path)))
            }
            (Some(image), None, Some(masks)) => {
                let photograph = image.strip_prefix(dir).unwrap_or(image).to_string_lossy();
                Some(masks.mask(&portable(&photograph))?)
            }
            _ => None,
        };
        // That of its image, with its folders if images are in several.
        let named = |path: &str| match root.and_then(|root| Path::new(path).strip_prefix(root).ok()) {
            Some(below) => flat_name(&below.to_string_lossy()),
            None => view_name(path),
        };
        views.push(ViewPlan {
            name: frame.file_path.as_deref().map_or_else(|| format!("frame_{index:06}"), named),
            camera_file: file.clone(),
            place,
            image,
            mask,
            lens,
            pose: pose.in_opencv_axes(),
        });
    }
    let mut rows = top.applied_transform.iter().flatten().enumerate();
    let is_one = |i: usize, k: usize, value: f64| value == if i == k { 1.0 } else { 0.0 };
    let is_identity = rows.all(|(i, row)| row.iter().enumerate().all(|(k, &value)| is_one(i, k, value)));
    let transform = "the poses are taken as the file has them: applied_transform is not undone, and results are in that world";
    let mut notes: Vec<_> = (!is_identity).then(|| transform.to_owned()).into_iter().chain(note).collect();
    let lists = top.lists(&file);
    if is_common && !lists.is_empty() {
        let paths: Vec<&str> = frames.iter().map(|frame| frame.file_path.as_deref().unwrap_or("")).collect();
        let (wanted, left_out) = listed(&lists, split, &paths)?;
        let mut wanted = wanted.into_iter();
        views.retain(|_| wanted.next() == Some(true));
        notes.extend(left_out);
    }
    // Notes about all views of a file are reported once.
    notes.retain(|_| split == Split::Train || !is_common);
    Ok(Plan { views, notes })
}

/// Rows of a 4×4 matrix; a 3×4 one gets the last row of a rigid transform.
fn matrix(rows: &[Vec<f64>]) -> Result<[[f64; 4]; 4], String> {
    if !matches!(rows.len(), 3 | 4) {
        return Err(format!("has {} rows, not 4", rows.len()));
    }
    let mut result = [[0.0, 0.0, 0.0, 1.0]; 4];
    for (i, row) in rows.iter().enumerate() {
        let wrong = |_| format!("has {} numbers in row {}, not 4", row.len(), i + 1);
        result[i] = row.as_slice().try_into().map_err(wrong)?;
    }
    Ok(result)
}

fn place_of(index: usize, frame: &Level) -> String {
    let path = frame.file_path.as_ref().map(|path| format!(" ({})", quoted(path)));
    format!("frame {index}{}", path.unwrap_or_default())
}

/// Refuses paths that no file or view can have, before files are looked for.
fn check_paths(file: &Path, index: usize, frame: &Level) -> Result<()> {
    let place = place_of(index, frame);
    frame.mask_path.as_ref().map_or(Ok(()), |mask| check_path(mask, file, &place))?;
    let Some(path) = &frame.file_path else { return Ok(()) };
    if path.trim().is_empty() {
        let help = "Write the path of the frame's image, from the folder of this file on.";
        return Err(Error::input(file, format!("frame {index}"), "file_path is empty", help));
    }
    check_image_name(path, file, &place)
}

/// The folder that all images are in, below that of the camera file, if they are in several
/// folders.
fn common_folder(frames: &[Level]) -> Option<&Path> {
    let paths = || frames.iter().filter_map(|frame| Path::new(frame.file_path.as_deref()?).parent());
    let first = paths().next()?;
    if paths().all(|folder| folder == first) {
        return None;
    }
    first.ancestors().find(|above| paths().all(|folder| folder.starts_with(above)))
}

/// The search for the images of all frames. Where none is where the file says, since that was
/// written on another machine or in another folder, they are looked for below `DIR/images` and
/// below `DIR`, without the folders above them.
struct Search<'a> {
    dir: &'a Path,
    file: &'a Path,
    frames: &'a [Level],
    folders: Folders,
}

impl Search<'_> {
    /// The image of every frame, and a note on all: none, if the data set has cameras only, or else
    /// all that are named.
    fn images(&mut self) -> Result<(Vec<Option<PathBuf>>, Option<String>)> {
        let (dir, file) = (self.dir, file_name(self.file));
        let paths: Vec<Option<&str>> = self.frames.iter().map(|frame| frame.file_path.as_deref()).collect();
        let mut named = paths.iter().copied().flatten();
        let Some(first) = named.next() else { return Ok((vec![None; paths.len()], None)) };
        let files: Vec<_> = paths.iter().map(|path| self.folders.image((*path)?)).collect();
        if files.iter().any(Option::is_some) {
            self.check_complete(&files, |path| dir.join(path))?;
            return Ok((files, None));
        }
        let moved: Vec<_> = paths.iter().map(|path| self.elsewhere("images", (*path)?)).collect();
        if let Some(folder) = moved.iter().flatten().next().and_then(|image| image.parent()) {
            self.check_complete(&moved, |path| folder.join(file_name(Path::new(path))))?;
            let (first, folder) = (quoted(first), folder.display());
            let note = format!(
                "the images are not where {file} says, e.g. {first}; files of the same names in {folder} are read"
            );
            return Ok((moved, Some(note)));
        }
        let has_folder =
            |path: &str| dir.join(path).parent().is_some_and(|parent| parent != dir && parent.is_dir());
        if has_folder(first) || named.any(has_folder) {
            self.check_complete(&files, |path| dir.join(path))?;
        }
        self.refuse_other_images(first)?;
        let first = quoted(first);
        let note = format!(
            "the views are cameras only: none of the images that {file} names is there, e.g. {first}"
        );
        Ok((files, Some(note)))
    }

    /// The image with this path below `folder` of the data set, or below that itself, with or
    /// without the folders above it.
    fn elsewhere(&mut self, folder: &str, path: &str) -> Option<PathBuf> {
        let inside = tails(path).filter(|tail| !leads_away(tail));
        let mut candidates = inside.flat_map(|tail| [format!("{folder}/{tail}"), tail.to_owned()]);
        candidates.find_map(|candidate| self.folders.image(&candidate))
    }

    /// Refuses frames without an image; `expected` says where the image of a path should be.
    fn check_complete(&self, files: &[Option<PathBuf>], expected: impl Fn(&str) -> PathBuf) -> Result<()> {
        let Some(index) = files.iter().position(Option::is_none) else { return Ok(()) };
        let (frame, place) = (&self.frames[index], place_of(index, &self.frames[index]));
        let Some(path) = &frame.file_path else {
            let problem = "the frame has no file_path, but others have";
            let help = "Add the path of its image, or remove the frame.";
            return Err(Error::input(self.file, place, problem, help));
        };
        let image = expected(path);
        let is_own = image.strip_prefix(self.dir).is_ok_and(|path| !leads_away(&path.to_string_lossy()));
        let refusal = || refusal_of_unread(image.parent()?, Some(&view_name(path)));
        Err(is_own.then(refusal).flatten().unwrap_or_else(|| {
            let problem =
                format!("the image {} ({}) is missing", image.display(), IMAGE_EXTENSIONS.join(", "));
            Error::input(self.file, place, problem, missing_file_help(&image))
        }))
    }

    /// Refuses a folder with images of which none is named, where images are named: first of all
    /// this one.
    fn refuse_other_images(&self, path: &str) -> Result<()> {
        let folders = || ["images", ""].iter().map(|folder| self.dir.join(folder));
        let stem = view_name(path);
        if let Some(refusal) = folders().find_map(|folder| refusal_of_unread(&folder, Some(&stem))) {
            return Err(refusal);
        }
        let has_images = |folder: &PathBuf| {
            image_files(folder).is_ok_and(|files| !files.is_empty())
                || entries(folder).any(|path| is_unread_name(&path))
        };
        let Some(folder) = folders().find(has_images) else { return Ok(()) };
        let problem = format!(
            "none of the images that the file names is there, e.g. {}; those in {} have other names",
            quoted(path),
            folder.display()
        );
        let help = "Give the images the names of the file, or correct each file_path. For cameras without photographs remove file_path \
                    from all frames.";
        Err(Error::input(self.file, "", problem, help))
    }
}

const ADD_HELP: &str = "Add it to the frame or at the top of the file.";
const MODEL_HELP: &str = "Undistort the photographs to pinhole cameras first; PINHOLE, OPENCV, FULL_OPENCV and OPENCV_FISHEYE are read.";

/// A frame, and the file that it is in.
struct Levels<'a> {
    own: &'a Level,
    shared: &'a Level,
}

impl Levels<'_> {
    fn lens(&self) -> Result<Lens, Trouble> {
        let size = match (self.either(|i| i.w), self.either(|i| i.h)) {
            (Some(w), Some(h)) => Some(whole_size([w, h]).map_err(|problem| (problem, ADD_HELP))?),
            (None, None) => None,
            _ => return Err(("only one of w and h is given".into(), ADD_HELP)),
        };
        let focal_x = self.focal(|i| [i.fl_x, i.camera_angle_x, i.x_fov]);
        Ok(Lens {
            size,
            focal_x: focal_x.ok_or(("there is neither camera_angle_x nor fl_x".into(), ADD_HELP))?,
            focal_y: self.focal(|i| [i.fl_y, i.camera_angle_y, i.y_fov]),
            center: [self.either(|i| i.cx), self.either(|i| i.cy)],
            skew: 0.0,
            distortion: self.distortion()?,
            resizable: false,
        })
    }

    fn either<T>(&self, value: impl Fn(&Level) -> Option<T>) -> Option<T> {
        value(self.own).or_else(|| value(self.shared))
    }

    /// Focal length along one axis, of that in pixels, in radians and in degrees: the frame's value
    /// has priority over the shared one, and pixels over angles.
    fn focal(&self, of: fn(&Level) -> [Option<f64>; 3]) -> Option<Focal> {
        self.either(|level| {
            let [pixels, radians, degrees] = of(level);
            let angle = radians.or_else(|| degrees.map(f64::to_radians));
            pixels.map(Focal::Pixels).or_else(|| angle.map(Focal::Angle))
        })
    }

    fn distortion(&self) -> Result<Distortion, Trouble> {
        let others =
            |of: &Level| [of.ftheta_p0, of.latlong, of.equirectangular].iter().position(Option::is_some);
        if let Some(n) = [self.own, self.shared].into_iter().find_map(others) {
            let field = ["ftheta_p0", "latlong", "equirectangular"][n];
            return Err((format!("`{field}` is of a lens that cannot be read"), MODEL_HELP));
        }
        let mut lists = [self.own, self.shared].into_iter().filter_map(|of| of.distortion_params.as_ref());
        if let Some(list) = lists.find(|list| list.len() != 6) {
            let problem = format!("distortion_params has {} numbers, not 6", list.len());
            return Err((problem, "Write k1, k2, k3, k4, p1, p2, as nerfstudio does."));
        }
        let coefficient = |name: &str| self.either(|level| level.coefficient(name)).unwrap_or(0.0);
        let is_fisheye = self.either(|i| i.is_fisheye).unwrap_or(false);
        // Only the model with a divisor has these.
        let is_full = ["k5", "k6"].into_iter().any(|name| coefficient(name) != 0.0);
        let usual = if is_full { "FULL_OPENCV" } else { "OPENCV" };
        let stated = self.either(|i| i.camera_model.as_deref().map(str::to_ascii_uppercase));
        let model = match stated.as_deref() {
            None | Some("OPENCV") if is_fisheye => "OPENCV_FISHEYE",
            Some(model @ ("OPENCV_FISHEYE" | "FULL_OPENCV")) => model,
            None | Some("SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV") => usual,
            Some(other) => return Err((format!("the camera_model {other} cannot be read"), MODEL_HELP)),
        };
        Ok(Distortion::of_model(model, coefficient))
    }
}
