//! Data sets: folders of posed photographs, read into [`ViewRecord`]s.
//!
//! The files in the folder determine the [`Layout`]; the manual describes each. Where a folder has
//! two, Stanford-ORB goes before NeRF, and COLMAP before LLFF; a COLMAP model that is kept for the
//! record yields to the cameras that were made of it.

pub mod colmap;
pub mod files;
mod in_order;
mod layout;
mod lens;
mod nerf;
mod nerfactor;
mod physg;
mod pose;
pub mod priors;
#[cfg(test)]
mod tests;
mod views;

pub use layout::{find_layout, has_split};
pub use priors::Priors;
pub use views::{LoadedView, PlannedView, ViewPlan, load_notes};

use crate::codec::image::Gamma;
use files::{check_name, near, quoted};
use glam::Vec3;
use layout::{find_with_note, in_scene_file};
use lobelia_geometry::view::{Placement, Split, ViewRecord};
use lobelia_geometry::{Error, Result, parallel};
use pose::PRECISE;
use priors::find_priors;
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, ffi::OsStr, path::Path, sync::Arc};
use views::{Curves, split_name};

/// How a data set's folder is laid out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Layout {
    /// The layout that is found.
    #[default]
    Auto,
    /// PhySG's: `{train,test}/{image,mask}` and `cam_dict_norm.json`.
    PhySg,
    /// NeRF's and Blender's: `transforms_{train,test}.json`; nerfstudio's: `transforms.json`.
    Nerf,
    /// COLMAP's: `sparse/0`, `images` and `masks`; lists of the splits in `train_id.txt` and
    /// `test_id.txt`.
    Colmap,
    /// IDR's, NeuS's and VolSDF's: `cameras_sphere.npz` or `cameras.npz`, `image` and `mask`.
    Idr,
    /// LLFF's and NeRD's: `poses_bounds.npy`, `images` and `masks`.
    Llff,
    /// Stanford-ORB's: `transforms_{train,test}.json` and `{train,test}_mask`.
    StanfordOrb,
    /// NeRFactor's and TensoIR-Synthetic's: a folder for each view, `train_000`, with
    /// `metadata.json` and `rgba.png`.
    Nerfactor,
}

/// The part of a data set that is read, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DatasetOptions {
    /// The layout of the folder.
    pub layout: Layout,
    /// Conversion of 8- and 16-bit values to linear.
    pub gamma: Gamma,
    /// Offset of a pixel's center from its index, in pixels: that of the layout if `None`, which is
    /// 0 for IDR and 0.5 for all others. Data for PhySG's own code needs 0.
    pub pixel_center: Option<f32>,
    /// Factor by which images and masks are downscaled along each axis, with a box filter; at least
    /// 1.
    pub downscale: u32,
    /// Only every n-th view is read, beginning with the first in natural name order; at least 1.
    pub every: u32,
    /// Of data that brings no test split, whatever its layout, every n-th view by name, beginning
    /// with the first, belongs to the test split; 0: none does.
    pub hold_out: u32,
    /// Names of the views to read (file stems); all if `None`. Applied before `every`.
    pub select: Option<Vec<String>>,
    /// The data's up direction, for orbits and the like; nothing is rotated. Need not have unit
    /// length.
    pub up: Vec3,
    /// Maps from elsewhere of the training photographs.
    pub priors: Priors,
    /// Folder, or beginning of the names, of the photographs of each placement of the object;
    /// empty: there is one.
    pub placements: Vec<String>,
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
            priors: Priors::default(),
            placements: Vec::new(),
        }
    }
}

impl DatasetOptions {
    /// # Errors
    /// [`Error::Usage`] if a value is out of its range.
    pub fn check(&self) -> Result<()> {
        self.gamma.check()?;
        let (problem, help) = if self.downscale == 0 || self.every == 0 {
            ("`downscale` and `every` are at least 1".to_owned(), "Leave them out, or write 1.")
        } else if self.hold_out == 1 {
            ("hold_out: 1 leaves no view to fit to".to_owned(), "Write 0 for no test split, or 2 and more.")
        } else if let Some(center) = self.pixel_center.filter(|center| !center.is_finite()) {
            (format!("pixel_center: {center}"), "Give 0.5, or 0.0 for PhySG's own code.")
        } else if self.up.try_normalize().is_none() {
            (format!("up: {}", self.up), "Give a direction of non-zero length, e.g. (0.0, 1.0, 0.0).")
        } else {
            return Ok(());
        };
        Err(Error::usage(problem, help))
    }
}

/// One split of a data set.
#[derive(Clone, Debug)]
pub struct Views<View> {
    /// The views, in natural name order (`r_2` before `r_10`).
    pub views: Vec<View>,
    /// The layout that was found; never `Auto`.
    pub layout: Layout,
    /// Notes for the user: repairs and omissions, with counts.
    pub notes: Vec<String>,
}

/// A split whose views are read.
pub type LoadedDataset = Views<ViewRecord>;
/// A split whose views are known and not read.
pub type OpenDataset = Views<PlannedView>;

/// Opens a split of the data set in folder `dir`: reads camera files and looks for photographs and
/// masks, but reads none of these.
///
/// # Errors
/// [`Error::Input`] that names file and place if the layout cannot be determined, the split is
/// absent, or a camera file is unusable or names a file that is missing; [`Error::Usage`] if
/// `options` are out of range or leave no view.
pub fn open_dataset(dir: impl AsRef<Path>, split: Split, options: &DatasetOptions) -> Result<OpenDataset> {
    let dir = dir.as_ref();
    options.check()?;
    let (layout, note) = find_with_note(dir, options.layout, in_scene_file)?;
    let views::Plan { views, mut notes } = layout.plan(dir, split, options.hold_out)?;
    notes.splice(0..0, note.filter(|_| split == Split::Train).map(str::to_owned));
    check_names(&views)?;
    let wanted = selected(views, options)?;
    if wanted.is_empty() {
        let problem = format!("the {} split has no views", split_name(split));
        let has_held = options.hold_out > 0;
        let help = if has_held { "" } else { "Give `hold_out: 8`, if the data has no test split." };
        return Err(Error::input(dir, "", problem, help));
    }
    refuse_far_away(&wanted)?;
    notes.extend(rounding_note(&wanted));
    let curves = Arc::new(Curves::new(options.gamma));
    let names: Vec<&str> = wanted.iter().map(|view| view.name.as_str()).collect();
    let priors = find_priors(&options.priors, split, &names, &mut notes)?;
    let planned = |(plan, priors)| {
        Ok(PlannedView {
            placement: placement_of(dir, &plan, &options.placements)?,
            plan,
            split,
            curves: curves.clone(),
            pixel_center: options.pixel_center.unwrap_or(layout.pixel_center()),
            downscale: options.downscale,
            priors,
        })
    };
    let views = wanted.into_iter().zip(priors).map(planned).collect::<Result<_>>()?;
    Ok(OpenDataset { views, layout, notes })
}

/// Reads a split of the data set in folder `dir`: cameras, photographs and masks, in natural name
/// order.
///
/// Views are loaded in parallel; the result does not depend on the number of threads. A view's
/// photograph is `None` if the data set has cameras only, its mask if there is neither a mask file
/// nor alpha.
///
/// # Errors
/// The errors of [`open_dataset`], and [`Error::Input`] if an image or mask is unusable.
pub fn read_dataset(dir: impl AsRef<Path>, split: Split, options: &DatasetOptions) -> Result<LoadedDataset> {
    let OpenDataset { views, layout, mut notes } = open_dataset(dir, split, options)?;
    let loaded: Vec<Result<LoadedView>> = parallel::map_slice(&views, 1, PlannedView::load);
    let loaded = loaded.into_iter().collect::<Result<Vec<_>>>()?;
    notes.extend(load_notes(&loaded));
    Ok(LoadedDataset { views: loaded.into_iter().map(|view| view.record).collect(), layout, notes })
}

/// Refuses names that files cannot have, and names that two views have.
fn check_names(views: &[ViewPlan]) -> Result<()> {
    let mut seen = BTreeMap::new();
    for view in views {
        check_name(&view.name, &view.camera_file, &view.place)?;
        if let Some(other) = seen.insert(&view.name, &view.place) {
            let problem = format!("two views are called `{}`; the other is {other}", view.name);
            let help = "Output files have the view's name: remove one, or give the images different names.";
            return Err(view.wrong(problem, help));
        }
    }
    Ok(())
}

/// The views that the options ask for, in their order.
fn selected(views: Vec<ViewPlan>, options: &DatasetOptions) -> Result<Vec<ViewPlan>> {
    let names = options.select.as_ref();
    let all = || views.iter().map(|view| view.name.as_str());
    if names.is_some_and(Vec::is_empty) {
        let help = "Name views, or leave it out.";
        return Err(Error::usage("`select` is an empty list: no views are left", help));
    }
    if let Some(unknown) = names.into_iter().flatten().find(|name| !all().any(|view| view == **name)) {
        let problem = format!("`select` names a view `{unknown}` that is not in the data set");
        let (first, last) = (all().next().unwrap_or_default(), all().next_back().unwrap_or_default());
        let near = near(unknown, all());
        let help = format!("There are {} views, from {first} to {last}.{near}", views.len());
        return Err(Error::usage(problem, help));
    }
    let is_selected = |view: &ViewPlan| names.is_none_or(|names| names.contains(&view.name));
    Ok(views.into_iter().filter(is_selected).step_by(options.every as usize).collect())
}

/// Positions are `f32`: for cameras that are thousands of times farther from the origin than from
/// each other, rounding would be as large as a pixel.
fn refuse_far_away(views: &[ViewPlan]) -> Result<()> {
    const FARTHEST: f32 = 4000.0;
    let positions = || views.iter().map(|view| view.pose.translation.as_vec3());
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
    let help = if middle.x.hypot(middle.y) <= 1e-3 * middle.z.abs() {
        // Inverted poses of cameras that look at the origin have one place, in front of the
        // camera's axes.
        "All are at one place on the z axis, as cameras that look at the origin are if camera_from_world is taken for \
         world_from_camera: invert each matrix."
            .to_owned()
    } else {
        format!("Subtract ({:.0}, {:.0}, {:.0}) from all positions.", middle.x, middle.y, middle.z)
    };
    Err(Error::input(&views[0].camera_file, "", problem, help))
}

/// A note on poses with so few decimals that their matrices are visibly no rotations.
fn rounding_note(views: &[ViewPlan]) -> Option<String> {
    let rounded = || views.iter().filter(|view| view.pose.error >= PRECISE);
    let worst = rounded().max_by(|a, b| a.pose.error.total_cmp(&b.pose.error))?;
    Some(format!(
        "the poses of {} views are written with too few decimals, so that their matrices are no rotations ({}: off by {:.1e}); the \
         nearest rotations are used. Export the poses with 6 decimals, or refine them (`cameras: Poses`)",
        rounded().count(),
        worst.name,
        worst.pose.error
    ))
}

/// The first of these placements of which the photograph is in a folder with that name below `dir`,
/// or has a name that begins so.
///
/// # Errors
/// [`Error::Input`] that names the view if it belongs to none of `names`, though there are some.
fn placement_of(dir: &Path, view: &ViewPlan, names: &[String]) -> Result<Placement> {
    let below = view.image.as_deref().map(|image| image.strip_prefix(dir).unwrap_or(image));
    let folders = below.iter().flat_map(|image| image.ancestors().skip(1));
    let folders: Vec<&OsStr> = folders.filter_map(Path::file_name).collect();
    let suits = |of: &String| view.name.starts_with(of.as_str()) || folders.contains(&OsStr::new(of));
    match names.iter().position(suits) {
        Some(number) => Ok(Placement(number as u32)),
        None if names.is_empty() => Ok(Placement::default()),
        None => {
            let problem = format!("the view {} belongs to none of the `placements`", quoted(&view.name));
            let help = "Name the folder that it is in, or what its name begins with, in `placements`.";
            Err(view.wrong(problem, help))
        }
    }
}
