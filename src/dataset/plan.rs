//! What a layout says of a split, before its photographs are read.

use super::lens::Lens;
use crate::codec::file::{FileUse, Links, check_inside};
use crate::codec::image::{Orientation, image_header};
use crate::error::{Error, Result};
use crate::view::Split;
use glam::Affine3A;
use std::path::{Path, PathBuf};

/// What a layout says of a view.
#[derive(Clone, Debug)]
pub(super) struct ViewPlan {
    /// File stem of the image.
    pub(super) name: String,
    /// The file that describes the camera.
    pub(super) camera_file: PathBuf,
    /// Where in that file.
    pub(super) place: String,
    pub(super) image: Option<PathBuf>,
    pub(super) mask: MaskPlan,
    pub(super) lens: Lens,
    pub(super) world_from_camera: Affine3A,
    /// How far the matrix of the file was from a rotation.
    pub(super) pose_error: f64,
}

impl ViewPlan {
    /// The file of the mask, unless alpha is the mask.
    pub(super) fn mask_path(&self) -> Option<&Path> {
        match &self.mask {
            MaskPlan::File(path) => Some(path),
            MaskPlan::Alpha | MaskPlan::AlphaRequired(_) => None,
        }
    }

    /// Photograph and mask, as files that are read.
    pub(super) fn pictures(&self) -> impl Iterator<Item = FileUse> {
        let photograph = self.image.as_deref().map(|path| FileUse::new(path, "a photograph"));
        let mask = self.mask_path().map(|path| FileUse::new(path, "a mask"));
        photograph.into_iter().chain(mask)
    }

    pub(super) fn check_inside(&self, roots: Option<&[PathBuf]>) -> Result<()> {
        let Some(roots) = roots else { return Ok(()) };
        let cameras = FileUse::new(&self.camera_file, "which has the cameras");
        let mut files = std::iter::once(cameras).chain(self.pictures());
        files.try_for_each(|file| check_inside(roots, &file, Links::Trusted))
    }

    /// Looks into the photograph for its size, where the lens needs it: as it is stored, without its EXIF orientation.
    pub(super) fn measure(&mut self) -> Result<()> {
        if let (true, Some(image)) = (self.lens.by_side, &self.image) {
            self.lens = self.lens.measured(image_header(image)?.size(Orientation::AsStored));
        }
        Ok(())
    }
}

/// The source of the mask of a view.
#[derive(Clone, Debug)]
pub(super) enum MaskPlan {
    /// A separate file.
    File(PathBuf),
    /// The image's alpha, if it has any.
    Alpha,
    /// The image's alpha; an image without alpha is an error with this text.
    AlphaRequired(String),
}

/// A split of a data set before its files are read.
pub(super) struct Plan {
    pub(super) views: Vec<ViewPlan>,
    pub(super) notes: Vec<String>,
}

pub(super) fn split_name(split: Split) -> &'static str {
    match split {
        Split::Train => "train",
        Split::Test => "test",
    }
}

/// The error for a split whose camera file does not exist; it names the split that exists.
pub(super) fn absent_split(dir: &Path, split: Split, camera_file: fn(&Path, Split) -> PathBuf) -> Error {
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
