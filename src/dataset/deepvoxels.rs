//! DeepVoxels' layout: `intrinsics.txt`, `pose/*.txt` and `rgb/*.png`, in `DIR` or in `DIR/{train,validation,test}`.
//!
//! Lines of `intrinsics.txt`: focal length, cx, cy (and an unused number); the center of the object's grid; the near plane;
//! a scale; height and width of the image that the first line refers to; and optionally 1 if the poses are camera_from_world. A pose
//! is 16 numbers, a row-major 4×4 matrix, world_from_camera with OpenCV axes. Masks are in `mask/`, or alpha. Without a
//! `test` folder `validation` is the test split; without either see [`crate::dataset::DatasetOptions::hold_out`].

use crate::codec::file::is_there;
use crate::codec::nearby::missing_file_help;
use crate::dataset::distortion::Distortion;
use crate::dataset::lens::{Focal, Lens};
use crate::dataset::load::{StemIndex, file_name, read_text};
use crate::dataset::masks::{find_mask, masks_in};
use crate::dataset::names::{ImageName, composed, quoted};
use crate::dataset::plan::{MaskPlan, Plan, ViewPlan, split_name};
use crate::dataset::pose::Rigid;
use crate::error::{Error, Result};
use crate::view::Split;
use std::path::{Path, PathBuf};

const INTRINSICS: &str = "intrinsics.txt";

/// The folder of a split; `dir` itself has views without splits, which count as training views.
pub(crate) fn split_folder(dir: &Path, split: Split) -> Option<PathBuf> {
    let with_intrinsics =
        |name: &&str| Some(dir.join(name)).filter(|folder| is_there(&folder.join(INTRINSICS)));
    match (with_intrinsics(&""), split) {
        (Some(all), Split::Train) => Some(all),
        (Some(_), Split::Test) => None,
        (None, Split::Train) => with_intrinsics(&"train"),
        (None, Split::Test) => ["test", "validation"].iter().find_map(with_intrinsics),
    }
}

/// The error for a missing split.
fn absent_split(dir: &Path, split: Split) -> Error {
    let file = dir.join(split_name(split)).join(INTRINSICS);
    let problem = format!("the data set has no {} split: this file is missing", split_name(split));
    let help = missing_file_help(&file);
    Error::input(file, "", problem, help)
}

/// Plans the views of a split, in the order of their names.
pub(super) fn plan(dir: &Path, split: Split) -> Result<Plan> {
    let Some(folder) = split_folder(dir, split) else { return Err(absent_split(dir, split)) };
    let files = SplitFiles::open(folder)?;
    let poses = pose_files(&files.folder.join("pose"))?;
    let mut views = Vec::with_capacity(poses.len());
    for (name, file) in poses {
        views.push(files.plan_view(name, file)?);
    }
    let is_used = |stem: &str| views.iter().any(|view| composed(&view.name) == composed(stem));
    let extra = files.images.stems().filter(|stem| !is_used(stem)).count();
    let images = files.folder.join("rgb");
    let note = format!("{extra} images in {} have no pose and are left out", images.display());
    Ok(Plan { views, notes: if extra > 0 { vec![note] } else { Vec::new() } })
}

/// The files of a split, and what all its views share.
struct SplitFiles {
    folder: PathBuf,
    images: StemIndex,
    masks: Option<StemIndex>,
    lens: Lens,
    /// Whether poses are camera_from_world.
    poses_are_inverse: bool,
}

impl SplitFiles {
    /// Reads the intrinsics, and looks for images and masks in `folder`.
    fn open(folder: PathBuf) -> Result<Self> {
        let (lens, poses_are_inverse) = read_intrinsics(&folder.join(INTRINSICS))?;
        let photographs = folder.join("rgb");
        let images = StemIndex::of_folder(&photographs)?.ok_or_else(|| {
            let problem = "this folder of the DeepVoxels layout is missing";
            Error::input(&photographs, "", problem, missing_file_help(&photographs))
        })?;
        let masks = masks_in(&folder)?;
        Ok(Self { folder, images, masks, lens, poses_are_inverse })
    }

    /// Plans the view of this name, whose pose is in `file`.
    fn plan_view(&self, name: String, file: PathBuf) -> Result<ViewPlan> {
        let image = self.images.find(ImageName::new(&name, &self.folder.join("pose"), "")?)?;
        let pose = read_pose(&file)?;
        let world_from_camera = if self.poses_are_inverse { pose.inverse() } else { pose };
        let mask = match &self.masks {
            Some(masks) => MaskPlan::File(find_mask(masks, &file_name(&image))?),
            None => MaskPlan::AlphaRequired(format!(
                "the view `{name}` has no mask: there is no folder {} and the image has no alpha",
                self.folder.join("mask").display()
            )),
        };
        Ok(ViewPlan {
            image: Some(image),
            name,
            camera_file: file,
            place: String::new(),
            mask,
            lens: self.lens,
            world_from_camera: world_from_camera.to_affine(),
            pose_error: pose.error,
        })
    }
}

/// Names and files of the poses, by name.
fn pose_files(folder: &Path) -> Result<Vec<(String, PathBuf)>> {
    let missing = || Error::input(folder, "", "the folder of poses is missing", missing_file_help(folder));
    if !is_there(folder) {
        return Err(missing());
    }
    let mut files = Vec::new();
    for entry in crate::codec::file::read_folder(folder)? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        if path.extension().is_some_and(|kind| kind == "txt") {
            files.push((path.file_stem().unwrap_or_default().to_string_lossy().into_owned(), path));
        }
    }
    files.sort();
    Ok(files)
}

/// All numbers of a text; `Err` names the first word that is not a number.
fn numbers(text: &str) -> Result<Vec<f64>, String> {
    text.split_whitespace()
        .map(|word| word.parse().map_err(|_| format!("{} is not a number", quoted(word))))
        .collect()
}

/// The lens, and whether poses are camera_from_world.
fn read_intrinsics(file: &Path) -> Result<(Lens, bool)> {
    let text = read_text(file)?;
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    let line = |number: usize, least: usize| {
        let values = numbers(lines.get(number - 1).copied().unwrap_or_default());
        let values = values.and_then(|values| match values.len() {
            count if count < least => Err(format!("there are {count} numbers, not {least}")),
            _ => Ok(values),
        });
        let help = "Line 1 is `f cx cy 0`, lines 2 to 4 are the grid's center, the near plane and a scale, line 5 is \
                    `height width`.";
        values.map_err(|problem| Error::input(file, format!("line {number}"), problem, help))
    };
    let (first, size) = (line(1, 3)?, line(5, 2)?);
    let [height, width] = [size[0], size[1]];
    let whole = |value: f64| value.fract() == 0.0 && (1.0..65536.0).contains(&value);
    if !(whole(height) && whole(width)) {
        let problem = format!("the image size {width}×{height} is not whole numbers above 0");
        return Err(Error::input(file, "line 5", problem, "Line 5 is `height width` in pixels."));
    }
    let lens = Lens {
        size: Some([width as u32, height as u32]),
        focal_x: Focal::Pixels(first[0]),
        focal_y: None,
        center: [Some(first[1]), Some(first[2])],
        skew: 0.0,
        distortion: Distortion::NONE,
        resizable: true,
        by_side: false,
    };
    Ok((lens, lines.get(5).is_some_and(|line| line.trim() == "1")))
}

fn read_pose(file: &Path) -> Result<Rigid> {
    let values = numbers(&read_text(file)?).and_then(|values| {
        let count = values.len();
        <[f64; 16]>::try_from(values).map_err(|_| format!("there are {count} numbers, not 16"))
    });
    let pose =
        values.and_then(|rows| Rigid::from_rows(&rows).map_err(|problem| format!("the pose {problem}")));
    pose.map_err(|problem| {
        Error::input(
            file,
            "",
            problem,
            "A pose is a row-major 4×4 matrix, world from camera with OpenCV axes.",
        )
    })
}
