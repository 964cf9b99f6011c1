//! Data sets: folders of posed photographs, read into [`ViewRecord`]s.
//!
//! The files in the folder determine the layout:
//! - **PhySG** ([`physg`]): `DIR/{train,test}/{image,mask}/` and `DIR/{train,test}/cam_dict_norm.json`;
//! - **NeRF/Blender** ([`nerf`]): `DIR/transforms_{train,test}.json`, or one `DIR/transforms.json` as of nerfstudio, Polycam and
//!   instant-ngp, and the images it names;
//! - **COLMAP** ([`colmap`]): `DIR/sparse/0/{cameras,images}.{bin,txt}` or other usual places, `DIR/images/`, `DIR/masks/`, and
//!   Stanford-ORB's lists `DIR/{train,test}_id.txt`;
//! - **DeepVoxels** ([`deepvoxels`]): `intrinsics.txt`, `pose/`, `rgb/`, in `DIR` or `DIR/{train,validation,test}`;
//! - **IDR, NeuS, VolSDF** ([`idr`]): `DIR/cameras_sphere.npz`, `DIR/image/`, `DIR/mask/`;
//! - **LLFF, NeRD** ([`llff`]): `DIR/poses_bounds.npy`, `DIR/images/`, `DIR/masks/`;
//! - **Stanford-ORB** ([`stanford_orb`], its `blender_HDR` and `blender_LDR`): NeRF's, and `DIR/{train,test}_mask/`;
//! - **RealityCapture** ([`reality_capture`]): `DIR/*.csv` of camera parameters, `DIR/images/`, `DIR/masks/`;
//! - **Metashape** ([`metashape`]): `DIR/*.xml` of cameras, `DIR/images/`, `DIR/masks/`.
//!
//! Where a folder has two, Stanford-ORB goes before NeRF, and COLMAP before LLFF; a COLMAP model that is kept for the record yields to the
//! cameras that were made of it.
//!
//! | option | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | `layout` | [`Layout`] | | `Auto` | which layout the folder has |
//! | `gamma` | [`Gamma`] | | `Srgb` | conversion of 8- and 16-bit values to linear |
//! | `pixel_center` | `Option<f32>` | pixels | the layout's | offset of a pixel's center from its index (0 for PhySG's own code) |
//! | `downscale` | `u32` | | 1 | factor by which images are downscaled along each axis, with a box filter |
//! | `every` | `u32` | | 1 | only every n-th view of the split (or selection) is read |
//! | `hold_out` | `u32` | | 8 | data without a test split: every n-th view by name belongs to the test split; 0: none |
//! | `select` | `Option<Vec<String>>` | | all | names of the views to read |
//! | `up` | [`Vec3`] | | (0, 1, 0) | the data's up direction, for orbits; nothing is rotated |

mod beside;
pub mod colmap;
mod colmap_model;
pub mod deepvoxels;
mod distortion;
mod exports;
mod folders;
pub mod idr;
mod layout;
mod lens;
mod lists;
pub mod llff;
mod load;
mod masks;
pub mod metashape;
mod names;
pub mod nerf;
mod nerf_frames;
mod nerf_lens;
mod photographs;
pub mod physg;
mod picture;
mod pose;
pub mod reality_capture;
pub mod stanford_orb;
mod straighten;

use crate::codec::file::{FileUse, Links, check_inside};
use crate::codec::image::{Gamma, Orientation, image_header};
use crate::codec::nearby::closest;
use crate::error::{Error, Result};
use crate::view::{Split, ViewRecord};
use beside::Beside;
pub use beside::masks_hint;
use glam::{Affine3A, Vec3};
use layout::{Found, find_format, in_scene_file};
pub use layout::{find_layout, has_split};
use lens::{Lens, crop_note};
pub use load::{LoadedView, PlannedView, load_notes};
pub(crate) use masks::mask_stems;
use names::check_names;
use picture::Curves;
use pose::PRECISE;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How a data set's folder is laid out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Layout {
    /// The layout that is found.
    #[default]
    Auto,
    /// PhySG's: `{train,test}/{image,mask}` and `cam_dict_norm.json`.
    PhySg,
    /// NeRF's and Blender's: `transforms_{train,test}.json`; nerfstudio's: `transforms.json`.
    Nerf,
    /// COLMAP's: `sparse/0`, `images` and `masks`; lists of the splits in `train_id.txt` and `test_id.txt`.
    Colmap,
    /// DeepVoxels': `intrinsics.txt`, `pose` and `rgb`.
    DeepVoxels,
    /// That of IDR, NeuS and VolSDF: `cameras_sphere.npz` or `cameras.npz`, `image` and `mask`.
    Idr,
    /// That of LLFF and NeRD: `poses_bounds.npy`, `images` and `masks`.
    Llff,
    /// Stanford-ORB's: `transforms_{train,test}.json` and `{train,test}_mask`.
    StanfordOrb,
    /// RealityCapture's: camera parameters in a `.csv` file, `images` and `masks`.
    RealityCapture,
    /// Metashape's: cameras in an `.xml` file, `images` and `masks`.
    Metashape,
}

/// What to read of a data set, and how; see the table at the top of this module.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DatasetOptions {
    /// Which layout the folder has.
    pub layout: Layout,
    /// Conversion of 8- and 16-bit values to linear.
    pub gamma: Gamma,
    /// Offset of a pixel's center from its index, in pixels: that of the layout if `None`, which is 0 for IDR and 0.5 for all
    /// others. Data for PhySG's own code needs 0.
    pub pixel_center: Option<f32>,
    /// Factor by which images and masks are downscaled along each axis, with a box filter; at least 1.
    pub downscale: u32,
    /// Only every n-th view is read, beginning with the first in natural name order; at least 1.
    pub every: u32,
    /// Of data that brings no test split, whatever its layout, every n-th view by name, beginning with the first, belongs to the test
    /// split; 0: none does.
    pub hold_out: u32,
    /// Names of the views to read (file stems); all if `None`. Applied before `every`.
    pub select: Option<Vec<String>>,
    /// The data's up direction, for orbits and the like; nothing is rotated. Need not have unit length.
    pub up: Vec3,
    /// Folders in which what camera files name must lie; links in them may lead elsewhere. `None`: it may be anywhere.
    pub roots: Option<Vec<PathBuf>>,
}

impl Default for DatasetOptions {
    fn default() -> Self {
        Self {
            layout: Layout::Auto,
            gamma: Gamma::Srgb,
            pixel_center: None,
            downscale: 1,
            every: 1,
            hold_out: 8,
            select: None,
            up: Vec3::Y,
            roots: None,
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
        if let Some(center) = self.pixel_center.filter(|center| !center.is_finite()) {
            return wrong(format!("pixel_center: {center}"), "Give 0.5, or 0.0 for PhySG's own code.");
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
    /// How far the matrix of the file was from a rotation.
    pose_error: f64,
}

impl ViewPlan {
    /// The file of the mask, unless alpha is the mask.
    fn mask_path(&self) -> Option<&Path> {
        match &self.mask {
            MaskPlan::File(path) => Some(path),
            MaskPlan::Alpha | MaskPlan::AlphaRequired(_) => None,
        }
    }

    /// Photograph and mask, as files that are read.
    fn pictures(&self) -> impl Iterator<Item = FileUse> {
        let photograph = self.image.as_deref().map(|path| FileUse::new(path, "a photograph"));
        let mask = self.mask_path().map(|path| FileUse::new(path, "a mask"));
        photograph.into_iter().chain(mask)
    }

    fn check_inside(&self, roots: Option<&[PathBuf]>) -> Result<()> {
        let Some(roots) = roots else { return Ok(()) };
        let cameras = FileUse::new(&self.camera_file, "which has the cameras");
        let mut files = std::iter::once(cameras).chain(self.pictures());
        files.try_for_each(|file| check_inside(roots, &file, Links::Trusted))
    }

    /// Looks into the photograph for its size, where the lens needs it: as it is stored, without its EXIF orientation.
    fn measure(&mut self) -> Result<()> {
        if let (true, Some(image)) = (self.lens.by_side, &self.image) {
            self.lens = self.lens.measured(image_header(image)?.size(Orientation::AsStored));
        }
        Ok(())
    }
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
    /// Where there are no masks: a folder with an image for each photograph that is not called as one of masks.
    pub masks_beside: Option<PathBuf>,
}

/// Opens a split of the data set in folder `dir`: reads camera files and looks for photographs and masks, but reads none of these, except
/// for one of each where masks may be in a folder of an unusual name.
///
/// # Errors
/// [`Error::Input`] that names file and place if the layout cannot be determined, the split is absent, or a camera file is
/// unusable or names a file that is missing; [`Error::Usage`] if `options` are out of range or leave no view.
pub fn open_dataset(dir: impl AsRef<Path>, split: Split, options: &DatasetOptions) -> Result<OpenDataset> {
    let dir = dir.as_ref();
    options.check()?;
    let Found { format, note } = find_format(dir, options.layout, in_scene_file)?;
    let mut plan = format.plan(dir, split, options.hold_out)?;
    plan.notes.splice(0..0, note.filter(|_| split == Split::Train).map(str::to_owned));
    plan.notes.extend(check_names(&plan.views)?);
    let mut wanted = selected(plan.views, options)?;
    if wanted.is_empty() {
        let problem = format!("the {} split has no views", split_name(split));
        let help =
            if options.hold_out == 0 { "Give `hold_out: 8`, if the data has no test split." } else { "" };
        return Err(Error::input(dir, "", problem, help));
    }
    refuse_far_away(&wanted)?;
    // No file that a camera file names is read before it is known to lie where it may.
    for view in &wanted {
        view.check_inside(options.roots.as_deref())?;
    }
    let beside = Beside::find(dir, &wanted)?;
    let masks_beside = beside.as_ref().and_then(Beside::unused_folder);
    if let Some(beside) = beside {
        plan.notes.push(beside.apply(&mut wanted));
        wanted.iter().try_for_each(|view| view.check_inside(options.roots.as_deref()))?;
    }
    wanted.iter_mut().try_for_each(ViewPlan::measure)?;
    plan.notes.extend(rounding_note(&wanted));
    plan.notes.extend(crop_note(wanted.iter().map(|view| &view.lens)));
    let curves = Arc::new(Curves::new(options.gamma));
    let view = |plan| PlannedView::new(plan, split, options, format.pixel_center, &curves);
    Ok(OpenDataset {
        views: wanted.into_iter().map(view).collect(),
        layout: format.layout,
        notes: plan.notes,
        masks_beside,
    })
}

/// Reads a split of the data set in folder `dir`: cameras, photographs and masks, in natural name order.
///
/// Views are loaded in parallel; the result does not depend on the number of threads. A view's photograph is `None` if the
/// data set has cameras only, its mask if there is neither a mask file nor alpha.
///
/// # Errors
/// Those of [`open_dataset`], and [`Error::Input`] if an image or mask is unusable.
pub fn read_dataset(dir: impl AsRef<Path>, split: Split, options: &DatasetOptions) -> Result<Dataset> {
    let OpenDataset { views, layout, mut notes, .. } = open_dataset(dir, split, options)?;
    let loaded: Vec<Result<LoadedView>> = views.par_iter().map(PlannedView::load).collect();
    let loaded = loaded.into_iter().collect::<Result<Vec<_>>>()?;
    notes.extend(load_notes(&loaded));
    Ok(Dataset { views: loaded.into_iter().map(|view| view.record).collect(), layout, notes })
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
        let [there, wanted] = [other, split].map(split_name);
        format!(
            "There is a {there} split only. Add the {wanted} split, or give the files of the {there} split its name."
        )
    } else {
        "There is no split of this layout at all.".to_owned()
    };
    Error::input(camera_file(dir, split), "", problem, help)
}

/// A note on poses with so few decimals that their matrices are visibly no rotations.
fn rounding_note(plans: &[ViewPlan]) -> Option<String> {
    let rounded = || plans.iter().filter(|plan| plan.pose_error >= PRECISE);
    let worst = rounded().max_by(|a, b| a.pose_error.total_cmp(&b.pose_error))?;
    Some(format!(
        "the poses of {} views are written with too few decimals, so that their matrices are no rotations ({}: off by {:.1e}); the \
         nearest rotations are used. Export the poses with 6 decimals, or refine them (`cameras: Poses`)",
        rounded().count(),
        worst.name,
        worst.pose_error
    ))
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
    let help = if is_along_z(middle) {
        // Inverted poses of cameras that look at the origin have one place, in front of the camera's axes.
        "All are at one place on the z axis, as cameras that look at the origin are if camera_from_world is taken for \
         world_from_camera: invert each matrix."
            .to_owned()
    } else {
        format!("Subtract ({:.0}, {:.0}, {:.0}) from all positions.", middle.x, middle.y, middle.z)
    };
    Err(Error::input(&plans[0].camera_file, "", problem, help))
}

/// Whether a place is on the z axis, but for a thousandth of its distance.
fn is_along_z(place: Vec3) -> bool {
    place.x.hypot(place.y) <= 1e-3 * place.z.abs()
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
