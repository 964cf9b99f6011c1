//! Data sets: folders of posed photographs, read into [`ViewRecord`]s.
//!
//! The files in the folder determine the layout:
//! - **PhySG** ([`physg`]): `DIR/{train,test}/{image,mask}/` and `DIR/{train,test}/cam_dict_norm.json`;
//! - **NeRF/Blender** ([`nerf`]): `DIR/transforms_{train,test}.json` and the images it names;
//! - **COLMAP** ([`colmap`]): `DIR/sparse/0/{cameras,images}.{bin,txt}`, `DIR/images/`, `DIR/masks/`;
//! - **DeepVoxels** ([`deepvoxels`]): `intrinsics.txt`, `pose/`, `rgb/`, in `DIR` or `DIR/{train,validation,test}`.
//!
//! | option | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | `layout` | [`Layout`] | | `Auto` | which layout the folder has |
//! | `gamma` | [`Gamma`] | | `Srgb` | conversion of 8- and 16-bit values to linear |
//! | `pixel_center` | `f32` | pixels | 0.5 | offset of a pixel's center from its index (0 for PhySG's own code) |
//! | `downscale` | `u32` | | 1 | factor by which images are downscaled along each axis, with a box filter |
//! | `every` | `u32` | | 1 | only every n-th view of the split (or selection) is read |
//! | `hold_out` | `u32` | | 8 | data without a test split: every n-th view by name belongs to the test split; 0: none |
//! | `select` | `Option<Vec<String>>` | | all | names of the views to read |
//! | `up` | [`Vec3`] | | (0, 1, 0) | the data's up direction, for orbits; nothing is rotated |

pub mod colmap;
mod colmap_model;
pub mod deepvoxels;
mod distortion;
mod layout;
mod lens;
mod load;
pub mod nerf;
pub mod physg;
mod pose;

use crate::codec::image::Gamma;
use crate::codec::nearby::{closest, natural_order};
use crate::error::{Error, Result};
use crate::view::{Split, ViewRecord};
use glam::{Affine3A, Vec3};
pub use layout::{find_layout, has_split};
use lens::Lens;
pub use load::{LoadedView, PlannedView, load_notes};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// How a data set's folder is laid out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Layout {
    /// The layout that is found.
    #[default]
    Auto,
    /// PhySG's: `{train,test}/{image,mask}` and `cam_dict_norm.json`.
    PhySg,
    /// NeRF's and Blender's: `transforms_{train,test}.json`.
    Nerf,
    /// COLMAP's: `sparse/0`, `images` and `masks`.
    Colmap,
    /// DeepVoxels': `intrinsics.txt`, `pose` and `rgb`.
    DeepVoxels,
}

/// What to read of a data set, and how; see the table at the top of this module.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DatasetOptions {
    /// Which layout the folder has.
    pub layout: Layout,
    /// Conversion of 8- and 16-bit values to linear.
    pub gamma: Gamma,
    /// Offset of a pixel's center from its index, in pixels: 0.5, or 0 for PhySG's own code.
    pub pixel_center: f32,
    /// Factor by which images and masks are downscaled along each axis, with a box filter; at least 1.
    pub downscale: u32,
    /// Only every n-th view is read, beginning with the first in natural name order; at least 1.
    pub every: u32,
    /// Of data without a test split, every n-th view by name, beginning with the first, belongs to the test split; 0: none does.
    pub hold_out: u32,
    /// Names of the views to read (file stems); all if `None`. Applied before `every`.
    pub select: Option<Vec<String>>,
    /// The data's up direction, for orbits and the like; nothing is rotated. Need not have unit length.
    pub up: Vec3,
}

impl Default for DatasetOptions {
    fn default() -> Self {
        Self {
            layout: Layout::Auto,
            gamma: Gamma::Srgb,
            pixel_center: 0.5,
            downscale: 1,
            every: 1,
            hold_out: 8,
            select: None,
            up: Vec3::Y,
        }
    }
}

impl DatasetOptions {
    /// # Errors
    /// [`Error::Usage`] if a value is out of its range.
    pub fn check(&self) -> Result<()> {
        self.gamma.check()?;
        let wrong = |problem: String, help: &str| Err(Error::usage(problem, help));
        if self.downscale == 0 || self.every == 0 {
            return wrong("`downscale` and `every` are at least 1".into(), "Leave them out, or write 1.");
        }
        if self.hold_out == 1 {
            return wrong(
                "hold_out: 1 leaves no view to fit to".into(),
                "Write 0 for no test split, or 2 and more.",
            );
        }
        if !self.pixel_center.is_finite() {
            return wrong(
                format!("pixel_center: {}", self.pixel_center),
                "Give 0.5, or 0.0 for PhySG's own code.",
            );
        }
        if self.up.try_normalize().is_none() {
            return wrong(
                format!("up: {}", self.up),
                "Give a direction of non-zero length, e.g. (0.0, 1.0, 0.0).",
            );
        }
        Ok(())
    }
}

/// One split of a data set, as read.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// The views, in natural name order (`r_2` before `r_10`).
    pub views: Vec<ViewRecord>,
    /// The layout that was found; never `Auto`.
    pub layout: Layout,
    /// Notes for the user: repairs and omissions, with counts.
    pub notes: Vec<String>,
}

/// What a layout says of a view.
#[derive(Clone, Debug)]
struct ViewPlan {
    /// File stem of the image.
    name: String,
    /// The file that describes the camera.
    camera_file: PathBuf,
    /// Where in that file.
    place: String,
    image: Option<PathBuf>,
    mask: MaskPlan,
    lens: Lens,
    world_from_camera: Affine3A,
}

/// The source of the mask of a view.
#[derive(Clone, Debug)]
enum MaskPlan {
    /// A separate file.
    File(PathBuf),
    /// The image's alpha, if it has any.
    Alpha,
    /// The image's alpha; an image without alpha is an error with this text.
    AlphaRequired(String),
}

/// A split of a data set before its files are read.
struct Plan {
    views: Vec<ViewPlan>,
    notes: Vec<String>,
}

/// A split of a data set whose views are known and not read.
#[derive(Clone, Debug)]
pub struct OpenDataset {
    /// The views, in natural name order (`r_2` before `r_10`).
    pub views: Vec<PlannedView>,
    /// The layout that was found; never `Auto`.
    pub layout: Layout,
    /// Notes for the user about all views.
    pub notes: Vec<String>,
}

/// Opens a split of the data set in folder `dir`: reads camera files and looks for photographs and masks, but reads none of these.
///
/// # Errors
/// [`Error::Input`] that names file and place if the layout cannot be determined, the split is absent, or a camera file is
/// unusable or names a file that is missing; [`Error::Usage`] if `options` are out of range or leave no view.
pub fn open_dataset(dir: impl AsRef<Path>, split: Split, options: &DatasetOptions) -> Result<OpenDataset> {
    let dir = dir.as_ref();
    options.check()?;
    let layout = find_layout(dir, options.layout)?;
    let mut plan = match layout {
        Layout::PhySg => physg::plan(dir, split)?,
        Layout::Nerf | Layout::Auto => nerf::plan(dir, split)?,
        Layout::Colmap => held_out(colmap::plan(dir)?, split, options.hold_out),
        Layout::DeepVoxels => match deepvoxels::split_folder(dir, split) {
            Some((folder, true)) => held_out(deepvoxels::plan(&folder)?, split, options.hold_out),
            Some((folder, false)) => deepvoxels::plan(&folder)?,
            None => return Err(deepvoxels::absent_split(dir, split)),
        },
    };
    plan.views.sort_by(|a, b| natural_order(&a.name, &b.name));
    refuse_duplicates(&plan.views)?;
    let wanted = selected(plan.views, options)?;
    if wanted.is_empty() {
        let problem = format!("the {} split has no views", split_name(split));
        let help =
            if options.hold_out == 0 { "Give `hold_out: 8`, if the data has no test split." } else { "" };
        return Err(Error::input(dir, "", problem, help));
    }
    refuse_far_away(&wanted)?;
    let view = |plan| PlannedView::new(plan, split, options);
    Ok(OpenDataset { views: wanted.into_iter().map(view).collect(), layout, notes: plan.notes })
}

/// Reads a split of the data set in folder `dir`: cameras, photographs and masks, in natural name order.
///
/// Views are loaded in parallel; the result does not depend on the number of threads. A view's photograph is `None` if the
/// data set has cameras only, its mask if there is neither a mask file nor alpha.
///
/// # Errors
/// Those of [`open_dataset`], and [`Error::Input`] if an image or mask is unusable.
pub fn read_dataset(dir: impl AsRef<Path>, split: Split, options: &DatasetOptions) -> Result<Dataset> {
    let OpenDataset { views, layout, mut notes } = open_dataset(dir, split, options)?;
    let loaded: Vec<Result<LoadedView>> = views.par_iter().map(PlannedView::load).collect();
    let loaded = loaded.into_iter().collect::<Result<Vec<_>>>()?;
    notes.extend(load_notes(&loaded));
    Ok(Dataset { views: loaded.into_iter().map(|view| view.record).collect(), layout, notes })
}

/// The views of a split, from all views, ordered by name.
fn held_out(plan: Plan, split: Split, hold_out: u32) -> Plan {
    let is_test = |i: usize| hold_out > 0 && i.is_multiple_of(hold_out as usize);
    let views = plan.views.into_iter().enumerate();
    let views = views.filter(|(i, _)| is_test(*i) == (split == Split::Test)).map(|(_, view)| view).collect();
    // Notes about all views are reported once, with the training split, which always exists.
    Plan { views, notes: if split == Split::Train { plan.notes } else { Vec::new() } }
}

fn split_name(split: Split) -> &'static str {
    match split {
        Split::Train => "train",
        Split::Test => "test",
    }
}

/// The error for a split whose camera file does not exist; it names the split that exists.
fn absent_split(dir: &Path, split: Split, camera_file: fn(&Path, Split) -> PathBuf) -> Error {
    let other = match split {
        Split::Train => Split::Test,
        Split::Test => Split::Train,
    };
    let problem = format!("the data set has no {} split: this file is missing", split_name(split));
    let help = if camera_file(dir, other).is_file() {
        format!("There is a {} split only.", split_name(other))
    } else {
        "There is no split of this layout at all.".to_owned()
    };
    Error::input(camera_file(dir, split), "", problem, help)
}

/// Positions are `f32`: for cameras that are thousands of times farther from the origin than from each other, rounding would be
/// as large as a pixel.
fn refuse_far_away(plans: &[ViewPlan]) -> Result<()> {
    const FARTHEST: f32 = 4000.0;
    let positions = || plans.iter().map(|plan| Vec3::from(plan.world_from_camera.translation));
    let low = positions().fold(Vec3::INFINITY, Vec3::min);
    let high = positions().fold(Vec3::NEG_INFINITY, Vec3::max);
    let (extent, middle) = (low.distance(high), low.midpoint(high));
    if extent == 0.0 || middle.length() <= FARTHEST * extent {
        return Ok(());
    }
    let problem = format!(
        "the cameras are {:.0} times farther from the origin than from each other: too far for single precision",
        middle.length() / extent
    );
    let help = format!("Subtract ({:.0}, {:.0}, {:.0}) from all positions.", middle.x, middle.y, middle.z);
    Err(Error::input(&plans[0].camera_file, "", problem, help))
}

/// Plans are sorted by name.
fn refuse_duplicates(plans: &[ViewPlan]) -> Result<()> {
    match plans.windows(2).find(|pair| pair[0].name == pair[1].name) {
        Some(pair) => Err(Error::input(
            &pair[1].camera_file,
            &pair[1].place,
            format!("two views are called `{}`; the other is {}", pair[0].name, pair[0].place),
            "Output files have the view's name: remove one, or give the images different names.",
        )),
        None => Ok(()),
    }
}

fn selected(plans: Vec<ViewPlan>, options: &DatasetOptions) -> Result<Vec<ViewPlan>> {
    let chosen = match &options.select {
        None => plans,
        Some(names) if names.is_empty() => {
            return Err(Error::usage(
                "`select` is an empty list: no views are left",
                "Name views, or leave it out.",
            ));
        }
        Some(names) => {
            for name in names {
                if !plans.iter().any(|plan| plan.name == *name) {
                    return Err(unknown_view(name, &plans));
                }
            }
            plans.into_iter().filter(|plan| names.contains(&plan.name)).collect()
        }
    };
    Ok(chosen.into_iter().step_by(options.every as usize).collect())
}

fn unknown_view(name: &str, plans: &[ViewPlan]) -> Error {
    let near = closest(name, plans.iter().map(|plan| plan.name.as_str()));
    let help = match (near.is_empty(), plans.first(), plans.last()) {
        (false, ..) => format!("Near: {}.", near.join(", ")),
        (true, Some(first), Some(last)) => {
            format!("There are {} views, from {} to {}.", plans.len(), first.name, last.name)
        }
        _ => String::new(),
    };
    Error::usage(format!("`select` names a view `{name}` that is not in the data set"), help)
}

#[cfg(test)]
mod tests;
