//! What to read of a data set, and how.

use crate::codec::image::Gamma;
use crate::dataset::priors::Priors;
use crate::error::{Error, Result};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

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
    /// NeRFactor's and TensoIR-Synthetic's: a folder for each view, `train_000`, with `metadata.json` and `rgba.png`.
    Nerfactor,
    /// RealityCapture's: camera parameters in a `.csv` file, `images` and `masks`.
    RealityCapture,
    /// Metashape's: cameras in an `.xml` file, `images` and `masks`.
    Metashape,
}

/// What to read of a data set, and how; see the table at the top of [`dataset`](crate::dataset).
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
    /// What is known from elsewhere of the training photographs.
    pub priors: Priors,
    /// What the photographs of each placement of the object are in, or begin with; empty: there is one.
    pub placements: Vec<String>,
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
            priors: Priors::default(),
            placements: Vec::new(),
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
