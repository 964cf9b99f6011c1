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
//! - **NeRFactor, TensoIR-Synthetic** ([`nerfactor`]): `DIR/{train,test}_000/{metadata.json,rgba.png}`;
//! - **RealityCapture** ([`reality_capture`]): `DIR/*.csv` of camera parameters, `DIR/images/`, `DIR/masks/`;
//! - **Metashape** ([`metashape`]): `DIR/*.xml` of cameras, `DIR/images/`, `DIR/masks/`.
//!
//! Where a folder has two, Stanford-ORB goes before NeRF, and COLMAP before LLFF; a COLMAP model that is kept for the record yields to the
//! cameras that were made of it.
//!
//! | option | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | `layout` | [`Layout`] | | `Auto` | which layout the folder has |
//! | `gamma` | [`Gamma`](crate::codec::image::Gamma) | | `Srgb` | conversion of 8- and 16-bit values to linear |
//! | `pixel_center` | `Option<f32>` | pixels | the layout's | offset of a pixel's center from its index (0 for PhySG's own code) |
//! | `downscale` | `u32` | | 1 | factor by which images are downscaled along each axis, with a box filter |
//! | `every` | `u32` | | 1 | only every n-th view of the split (or selection) is read |
//! | `hold_out` | `u32` | | 8 | data without a test split: every n-th view by name belongs to the test split; 0: none |
//! | `select` | `Option<Vec<String>>` | | all | names of the views to read |
//! | `priors` | [`Priors`] | | none | pictures of albedo or normals for the training photographs |
//! | `up` | [`Vec3`] | | (0, 1, 0) | the data's up direction, for orbits; nothing is rotated |

mod beside;
pub mod colmap;
mod colmap_model;
mod decoded_photograph;
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
pub mod nerfactor;
mod options;
mod photographs;
pub mod physg;
mod placements;
mod plan;
mod planned_view;
mod pose;
pub mod priors;
pub mod reality_capture;
pub mod stanford_orb;
mod straighten;

use crate::codec::nearby::closest;
use crate::error::{Error, Result};
use crate::view::{Split, ViewRecord};
use beside::Beside;
pub(crate) use beside::masks_hint;
use decoded_photograph::Curves;
use glam::Vec3;
use layout::{FoundLayout, find_reader, in_scene_file};
pub(crate) use layout::{find_layout, has_split};
use lens::crop_note;
pub(crate) use masks::mask_stems;
use names::check_names;
pub use options::{DatasetOptions, Layout};
use placements::placements_of;
use plan::{ViewPlan, split_name};
pub(crate) use planned_view::load_notes;
pub use planned_view::{LoadedView, PlannedView};
use pose::PRECISE;
pub use priors::Priors;
use priors::find_priors;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// One split of a data set, as read.
#[derive(Clone, Debug)]
pub struct LoadedDataset {
    /// The views, in natural name order (`r_2` before `r_10`).
    pub views: Vec<ViewRecord>,
    /// The layout that was found; never `Auto`.
    pub layout: Layout,
    /// Notes for the user: repairs and omissions, with counts.
    pub notes: Vec<String>,
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
    let FoundLayout { reader, note } = find_reader(dir, options.layout, in_scene_file)?;
    let mut plan = reader.plan(dir, split, options.hold_out)?;
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
    let beside = Beside::find(dir, &wanted, &options.priors)?;
    let masks_beside = beside.as_ref().and_then(Beside::unused_folder);
    if let Some(beside) = beside {
        plan.notes.push(beside.apply(&mut wanted));
        wanted.iter().try_for_each(|view| view.check_inside(options.roots.as_deref()))?;
    }
    wanted.iter_mut().try_for_each(ViewPlan::measure)?;
    plan.notes.extend(rounding_note(&wanted));
    plan.notes.extend(crop_note(wanted.iter().map(|view| &view.lens)));
    let curves = Arc::new(Curves::new(options.gamma));
    let priors = find_priors(&options.priors, split, &wanted, &mut plan.notes)?;
    let placements = placements_of(dir, &wanted, &options.placements)?;
    let view =
        |(found, placement)| PlannedView::new(found, placement, split, options, reader.pixel_center, &curves);
    Ok(OpenDataset {
        views: wanted.into_iter().zip(priors).zip(placements).map(view).collect(),
        layout: reader.layout,
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
pub fn read_dataset(dir: impl AsRef<Path>, split: Split, options: &DatasetOptions) -> Result<LoadedDataset> {
    let OpenDataset { views, layout, mut notes, .. } = open_dataset(dir, split, options)?;
    let loaded: Vec<Result<LoadedView>> = views.par_iter().map(PlannedView::load).collect();
    let loaded = loaded.into_iter().collect::<Result<Vec<_>>>()?;
    notes.extend(load_notes(&loaded));
    Ok(LoadedDataset { views: loaded.into_iter().map(|view| view.record).collect(), layout, notes })
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
