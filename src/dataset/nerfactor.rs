//! The layout of NeRFactor and of TensoIR-Synthetic: a folder for each view, `DIR/{train,test}_000/`, with its camera in `metadata.json` and its
//! pictures under one or several lights beside it.
//!
//! | in `metadata.json` | unit | meaning |
//! | --- | --- | --- |
//! | `cam_transform_mat` | | 16 numbers in a text, with commas: the rows of world_from_camera, with OpenGL axes (x right, y up, z backward) |
//! | `cam_angle_x` | radians | full horizontal field of view |
//! | `imw`, `imh` | pixels | image size |
//!
//! The photograph is `rgba.png` (NeRFactor's), or else `rgba_sunset.png` or `rgba_sunset_000.png` (the light that TensoIR fits to), or else the only picture
//! called `rgba_….png`; alpha is its mask. Views of the test split for which that leaves none, or a choice, are cameras only. The others are the truth of relit pictures, and `albedo.png` and `normal.png` that of the layers
//! ([`Truth::Files`](crate::scene::Truth::Files)). Where no folder is called `test_…`, those called `val_…` are the test split.

use crate::codec::file::{is_there, read_folder};
use crate::codec::nearby::natural_order;
use crate::dataset::distortion::Distortion;
use crate::dataset::lens::{Focal, Lens};
use crate::dataset::load::{parse_json, read_text};
use crate::dataset::names::quoted;
use crate::dataset::plan::{MaskPlan, Plan, ViewPlan, split_name};
use crate::dataset::pose::Rigid;
use crate::error::{Error, Result};
use crate::view::Split;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The file of the camera of a view.
const CAMERA: &str = "metadata.json";
/// Pictures that are photographs, the first that is there.
const PHOTOGRAPHS: [&str; 3] = ["rgba.png", "rgba_sunset.png", "rgba_sunset_000.png"];

/// Whether the folder has views of this split.
pub(crate) fn has_split(dir: &Path, split: Split) -> bool {
    view_folders(dir, split).is_ok_and(|folders| !folders.is_empty())
}

/// Plans the views of a split.
pub(super) fn plan(dir: &Path, split: Split) -> Result<Plan> {
    let folders = view_folders(dir, split)?;
    if folders.is_empty() {
        let problem = format!("the data set has no {} split: no folder is called so", split_name(split));
        let first = dir.join(format!("{}_000", split_name(split))).join(CAMERA);
        return Err(Error::input(first, "", problem, "Each view has a folder, train_000 and so on."));
    }
    let views = folders.iter().map(|folder| plan_view(folder, split)).collect::<Result<Vec<_>>>()?;
    Ok(Plan { views, notes: Vec::new() })
}

/// The folders of the views of a split, in natural order.
fn view_folders(dir: &Path, split: Split) -> Result<Vec<PathBuf>> {
    let mut named: [Vec<PathBuf>; 3] = Default::default();
    for entry in read_folder(dir)? {
        let path = entry.map_err(Error::io("read", dir))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let kind = ["train_", "test_", "val_"].iter().position(|kind| {
            let number = name.strip_prefix(kind).unwrap_or_default();
            !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
        });
        if let Some(kind) = kind.filter(|_| is_there(&path.join(CAMERA))) {
            named[kind].push(path);
        }
    }
    let [train, test, val] = named;
    let mut found = match split {
        Split::Train => train,
        Split::Test if test.is_empty() => val,
        Split::Test => test,
    };
    found.sort_by(|a, b| natural_order(&name_of(a), &name_of(b)));
    Ok(found)
}

fn name_of(folder: &Path) -> String {
    folder.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// A camera file.
#[derive(Deserialize)]
struct Metadata {
    cam_transform_mat: String,
    cam_angle_x: f64,
    imw: u32,
    imh: u32,
}

fn plan_view(folder: &Path, split: Split) -> Result<ViewPlan> {
    let file = folder.join(CAMERA);
    let camera: Metadata = parse_json(&file, &read_text(&file)?)?;
    let wrong = |problem: String| {
        let help = "cam_transform_mat is 16 numbers with commas: a rotation and a translation, from OpenGL camera axes to the world.";
        Error::input(&file, "", format!("cam_transform_mat {problem}"), help)
    };
    let pose = rows(&camera.cam_transform_mat).and_then(|rows| Rigid::from_rows(&rows)).map_err(wrong)?;
    let pose = pose.in_opencv_axes();
    let lens = Lens {
        size: Some([camera.imw, camera.imh]),
        focal_x: Focal::Angle(camera.cam_angle_x),
        focal_y: None,
        center: [None; 2],
        skew: 0.0,
        distortion: Distortion::NONE,
        resizable: true,
        by_side: false,
    };
    let image = match photograph(folder) {
        Err(Error::Input { .. }) if split == Split::Test => None,
        found => Some(found?),
    };
    Ok(ViewPlan {
        name: name_of(folder),
        image,
        mask: MaskPlan::Alpha,
        camera_file: file,
        place: String::new(),
        lens,
        world_from_camera: pose.to_affine(),
        pose_error: pose.error,
    })
}

/// The numbers of a matrix.
fn rows(text: &str) -> Result<[f64; 16], String> {
    let words = text.split(',').map(str::trim);
    let numbers: Vec<f64> = words
        .map(|word| word.parse().map_err(|_| format!("has {}, which is not a number", quoted(word))))
        .collect::<Result<_, _>>()?;
    let count = numbers.len();
    numbers.try_into().map_err(|_| format!("has {count} numbers, not 16"))
}

/// The picture that a fit sees.
fn photograph(folder: &Path) -> Result<PathBuf> {
    let usual = PHOTOGRAPHS.iter().map(|name| folder.join(name)).find(|path| is_there(path));
    if let Some(path) = usual {
        return Ok(path);
    }
    let mut others = Vec::new();
    for entry in read_folder(folder)? {
        let name = entry.map_err(Error::io("read", folder))?.file_name().to_string_lossy().into_owned();
        if name.starts_with("rgba_") && name.ends_with(".png") {
            others.push(name);
        }
    }
    others.sort();
    let [usual, sunset, _] = PHOTOGRAPHS;
    match others.as_slice() {
        [only] => Ok(folder.join(only)),
        [] => {
            let problem = format!("the photograph of this view is missing: there is no {usual}");
            Err(Error::input(folder.join(usual), "", problem, "It is a PNG with alpha."))
        }
        several => {
            let problem = format!("which is the photograph? There are {}", several.join(", "));
            let help =
                format!("Name the one to fit to {usual} in each folder; {sunset} would be taken, too.");
            Err(Error::input(folder, "", problem, help))
        }
    }
}
