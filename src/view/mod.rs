//! Views: cameras, photographs and masks.
//!
//! Camera axes are OpenCV's (x right, y down, z forward). The center of pixel (i, j) is (i + 0.5, j + 0.5).
//!
//! | module | holds |
//! | --- | --- |
//! | [`camera`] | the pinhole camera, projection, construction by target point, orbits |
//! | `glare` | pixels that are brighter than light can be |
//! | [`prior_map`] | what somebody else says of albedo and normals in a photograph |
//! | `raster` | box filtering, bilinear look-up, mask erosion |
//! | [`stored`] | photographs as they are kept: small, and cropped |
//! | `stored_mask` | masks as they are kept |
//! | `window` | rectangles of pictures |
//!
//! [`dataset`](crate::dataset) reads folders of posed photographs as [`ViewRecord`]s, [`codec::image`](crate::codec::image) single
//! images and masks.
//!
//! Parameters of a [`CameraOrbit`]:
//!
//! | orbit field | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | `target` | `Vec3` | world | (0, 0, 0) | the point that all cameras look at |
//! | `radius` | `f32` | world | 2.8 | distance from the target |
//! | `elevation_degrees` | `f32` | degrees | 20 | height above the horizon, −90 to 90 |
//! | `start_degrees` | `f32` | degrees | 0 | where the circle starts; 0 is in front |
//! | `frames` | `u32` | | 60 | cameras on the circle |
//! | `up` | `Vec3` | | (0, 1, 0) | the world's up direction |
//! | `vertical_fov_degrees` | `f32` | degrees | 38 | full field of view |
//! | `width`, `height` | `u32` | pixels | 512 | image size |

pub mod camera;
pub(crate) mod glare;
mod image;
pub(crate) mod numbers;
pub mod prior_map;
pub(crate) mod raster;
pub mod stored;
mod stored_mask;
mod window;

pub use camera::{Camera, CameraOrbit};
pub use image::{Image, Mask};
pub use prior_map::{AlbedoMap, NormalMap, ViewPriors};
pub use stored::Photograph;
pub use stored_mask::StoredMask;
pub use window::PixelWindow;

use crate::{Error, Result};
use bevy_ecs::prelude::Component;
use serde::{Deserialize, Serialize};

/// Name of a view; output files have this name.
#[derive(Component, Clone, Debug, PartialEq, Eq)]
pub struct ViewName(pub String);

/// Number of a view, by which pixel samples refer to it. Unique, and otherwise arbitrary.
#[derive(
    Component, Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize,
)]
pub struct ViewIndex(pub u32);

/// One value per view, by the index of the view.
#[derive(Clone, Debug)]
pub struct ByView<T>(Vec<Option<T>>);

impl<T> ByView<T> {
    /// The value of one view.
    ///
    /// # Errors
    /// [`Error::Run`] if there is no such view.
    pub fn of(&self, view: ViewIndex) -> Result<&T> {
        self.get(view).ok_or_else(|| {
            Error::run("the views", format!("a pixel sample is of view {}, which is not there", view.0))
        })
    }

    /// The value of one view, if it has one.
    pub fn get(&self, view: ViewIndex) -> Option<&T> {
        self.0.get(view.0 as usize)?.as_ref()
    }

    /// The mutable value of one view.
    ///
    /// # Errors
    /// [`Error::Run`] if there is no such view.
    pub fn of_mut(&mut self, view: ViewIndex) -> Result<&mut T> {
        let found = self.0.get_mut(view.0 as usize).and_then(Option::as_mut);
        found.ok_or_else(|| {
            Error::run("the views", format!("a pixel sample is of view {}, which is not there", view.0))
        })
    }
}

impl<T> FromIterator<(ViewIndex, T)> for ByView<T> {
    fn from_iter<I: IntoIterator<Item = (ViewIndex, T)>>(views: I) -> Self {
        let mut table = Vec::new();
        for (ViewIndex(index), view) in views {
            let index = index as usize;
            if index >= table.len() {
                table.resize_with(index + 1, || None);
            }
            table[index] = Some(view);
        }
        Self(table)
    }
}

/// A view's mask.
#[derive(Component, Clone, Debug)]
pub struct ViewMask(pub StoredMask);

/// The placement of the object that a view shows, counted from 0: it may be turned over between two rounds of photographs.
#[derive(
    Component, Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize,
)]
pub struct Placement(pub u32);

/// Which part of a data set a view belongs to.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Split {
    /// Used by fits.
    Train,
    /// Held out.
    Test,
}

/// One view as read from a data set, before it is spawned.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ViewRecord {
    /// File stem of the image, e.g. `rgb_000000`.
    pub name: String,
    /// Which part of the data set.
    pub split: Split,
    /// The camera.
    pub camera: Camera,
    /// The photograph, unless the data set has cameras only.
    pub photograph: Option<Photograph>,
    /// The mask, unless there is none.
    pub mask: Option<StoredMask>,
    /// What is known from elsewhere of what it shows.
    pub priors: ViewPriors,
    /// The placement of the object that it shows.
    pub placement: Placement,
}

impl ViewRecord {
    /// A view of which only the camera is known.
    pub fn of_camera(name: String, split: Split, camera: Camera) -> Self {
        let (priors, placement) = (ViewPriors::default(), Placement::default());
        Self { name, split, camera, photograph: None, mask: None, priors, placement }
    }
}
