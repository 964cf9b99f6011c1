//! NeRF's and Blender's layout: `DIR/transforms_{train,test}.json` and the images it names.
//!
//! Each frame has a `transform_matrix` (4×4, world_from_camera with OpenGL axes: x right, y up, z backwards) and a
//! `file_path` relative to `DIR`, with or without extension. Intrinsics are at the top level or in a frame; those of the frame
//! have priority: `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h` in pixels, or `camera_angle_x`, `camera_angle_y`, the full fields of view in
//! radians. Alpha is the mask, unless a frame has a `mask_path`. If neither the images nor their folders exist, the views
//! are cameras only and `w`, `h` are needed.

use crate::codec::nearby::missing_file_help;
use crate::dataset::distortion::Distortion;
use crate::dataset::lens::{Focal, Lens};
use crate::dataset::load::{find_image, parse_json, read_text, view_name};
use crate::dataset::pose::Rigid;
use crate::dataset::{MaskPlan, Plan, ViewPlan, absent_split, split_name};
use crate::error::{Error, Result};
use crate::view::Split;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The file that describes the cameras of a split.
pub fn camera_file(dir: &Path, split: Split) -> PathBuf {
    dir.join(format!("transforms_{}.json", split_name(split)))
}

#[derive(Deserialize)]
struct Frame {
    file_path: Option<String>,
    mask_path: Option<String>,
    transform_matrix: Vec<Vec<f64>>,
}

/// The fields that may be at the top level and in each frame.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(default)]
struct Intrinsics {
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

impl Intrinsics {
    /// Focal length along one axis: the frame's value has priority over the shared one, and pixels over angles.
    fn focal(
        frame: &Self,
        shared: &Self,
        pixels: fn(&Self) -> Option<f64>,
        angle: fn(&Self) -> Option<f64>,
    ) -> Option<Focal> {
        [frame, shared]
            .into_iter()
            .find_map(|level| pixels(level).map(Focal::Pixels).or_else(|| angle(level).map(Focal::Angle)))
    }

    fn is_distorted(&self) -> bool {
        [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2].into_iter().flatten().any(|k| k != 0.0)
    }
}

// `#[serde(flatten)]` loses the line and column of an error, so the text is parsed once for each of these.
#[derive(Deserialize)]
struct Frames {
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct FrameIntrinsics {
    frames: Vec<Intrinsics>,
}

pub(super) fn plan(dir: &Path, split: Split) -> Result<Plan> {
    let file = camera_file(dir, split);
    if !file.is_file() {
        return Err(absent_split(dir, split, camera_file));
    }
    let text = read_text(&file)?;
    let Frames { frames } = parse_json(&file, &text)?;
    let shared: Intrinsics = parse_json(&file, &text)?;
    let FrameIntrinsics { frames: own } = parse_json(&file, &text)?;
    let images = find_images(dir, &file, &frames)?;
    let mut views = Vec::with_capacity(frames.len());
    for (index, ((frame, own), image)) in frames.iter().zip(&own).zip(images).enumerate() {
        views.push(plan_view(dir, &file, index, frame, own, &shared, image)?);
    }
    let distorted = own.iter().filter(|own| own.is_distorted() || shared.is_distorted()).count();
    let notes = match distorted {
        0 => Vec::new(),
        _ => vec![format!(
            "{distorted} views state lens distortion, which is ignored: undistort the photographs first"
        )],
    };
    Ok(Plan { views, notes })
}

fn place_of(index: usize, frame: &Frame) -> String {
    match &frame.file_path {
        Some(path) => format!("frame {index} (`{path}`)"),
        None => format!("frame {index}"),
    }
}

/// The image of every frame: either none, because the data set has cameras only, or all that are named.
fn find_images(dir: &Path, file: &Path, frames: &[Frame]) -> Result<Vec<Option<PathBuf>>> {
    let named: Vec<Option<PathBuf>> =
        frames.iter().map(|frame| frame.file_path.as_ref().map(|path| dir.join(path))).collect();
    let found: Vec<Option<PathBuf>> = named.iter().map(|path| path.as_deref().and_then(find_image)).collect();
    let has_folder = |path: &PathBuf| path.parent().is_some_and(|parent| parent != dir && parent.is_dir());
    let has_images = found.iter().any(Option::is_some) || named.iter().flatten().any(has_folder);
    if !has_images {
        return Ok(vec![None; frames.len()]);
    }
    for (index, (path, image)) in named.iter().zip(&found).enumerate() {
        match (path, image) {
            (Some(path), None) => {
                let problem = format!("the image {} (.exr, .png, .jpg, .hdr) is missing", path.display());
                return Err(Error::input(
                    file,
                    place_of(index, &frames[index]),
                    problem,
                    missing_file_help(path),
                ));
            }
            (None, _) => {
                let problem = "the frame has no file_path, but others have";
                return Err(Error::input(file, place_of(index, &frames[index]), problem, ""));
            }
            _ => {}
        }
    }
    Ok(found)
}

fn plan_view(
    dir: &Path,
    file: &Path,
    index: usize,
    frame: &Frame,
    own: &Intrinsics,
    shared: &Intrinsics,
    image: Option<PathBuf>,
) -> Result<ViewPlan> {
    let place = place_of(index, frame);
    let wrong = |problem: String, help: &str| Error::input(file, place.clone(), problem, help);
    let help = "transform_matrix is a rotation and a translation, from OpenGL camera axes to the world.";
    let world_from_camera = matrix(&frame.transform_matrix)
        .and_then(|rows| Rigid::from_rows(&rows))
        .map_err(|problem| wrong(format!("transform_matrix {problem}"), help))?
        .in_opencv_axes();
    let lens = lens(own, shared)
        .map_err(|problem| wrong(problem, "Add it to the frame or at the top of the file."))?;
    let name = match &frame.file_path {
        Some(path) => view_name(path),
        None => format!("frame_{index:06}"),
    };
    let mask = match &frame.mask_path {
        Some(path) if image.is_some() => MaskPlan::File(dir.join(path)),
        _ => MaskPlan::Alpha,
    };
    let world_from_camera = world_from_camera.to_affine();
    Ok(ViewPlan { name, camera_file: file.to_owned(), place, image, mask, lens, world_from_camera })
}

fn lens(own: &Intrinsics, shared: &Intrinsics) -> Result<Lens, String> {
    let either = |value: fn(&Intrinsics) -> Option<f64>| value(own).or(value(shared));
    let focal_x = Intrinsics::focal(own, shared, |i| i.fl_x, |i| i.camera_angle_x);
    let focal_y = Intrinsics::focal(own, shared, |i| i.fl_y, |i| i.camera_angle_y);
    let size = match (either(|i| i.w), either(|i| i.h)) {
        (Some(w), Some(h)) => Some([whole(w)?, whole(h)?]),
        (None, None) => None,
        _ => return Err("only one of w and h is given".into()),
    };
    Ok(Lens {
        size,
        focal_x: focal_x.ok_or("there is neither camera_angle_x nor fl_x")?,
        focal_y,
        center: [either(|i| i.cx), either(|i| i.cy)],
        skew: 0.0,
        distortion: Distortion::NONE,
        resizable: false,
    })
}

fn whole(value: f64) -> Result<u32, String> {
    let is_size = value.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&value);
    if is_size {
        Ok(value as u32)
    } else {
        Err(format!("the image size {value} is not a whole number above 0"))
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
