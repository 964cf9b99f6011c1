//! Views: cameras, photographs and masks.
//!
//! Camera axes are OpenCV's (x right, y down, z forward). The center of pixel (i, j) is (i + 0.5, j +
//! 0.5).

pub mod camera;
pub mod look;
pub mod metrics;
pub mod raster;
pub mod stored;

pub use camera::{Camera, CameraOrbit};
pub use raster::{Image, Mask, PixelWindow};
pub use stored::{Photograph, StoredMask};

use crate::{Error, Result};
use bevy_ecs::prelude::{Component, EntityWorldMut, World};
use glam::Vec3;
use half::f16;
use lobelia_sg::statistics::median;
use serde::{Deserialize, Serialize};
use std::{ops::Range, sync::Arc};

/// Name of a view; output files have this name.
#[derive(Component, Clone, Debug, PartialEq, Eq)]
pub struct ViewName(pub String);

/// Number of a view, by which pixel samples refer to it. Unique, and otherwise arbitrary.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ViewIndex(pub u32);

/// One value per view, by the index of the view.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ByView<T>(Vec<Option<T>>);

impl<T> ByView<T> {
    /// The value of one view.
    ///
    /// # Errors
    /// [`Error::Run`] if there is no such view.
    pub fn of(&self, view: ViewIndex) -> Result<&T> {
        self.get(view).ok_or_else(|| no_view(view))
    }

    /// The value of one view, if it has one.
    pub fn get(&self, view: ViewIndex) -> Option<&T> {
        self.0.get(view.0 as usize)?.as_ref()
    }

    /// All values, by the index of the view; `None` where there is no view.
    pub fn all(&self) -> &[Option<T>] {
        &self.0
    }

    /// The mutable value of one view.
    ///
    /// # Errors
    /// [`Error::Run`] if there is no such view.
    pub fn of_mut(&mut self, view: ViewIndex) -> Result<&mut T> {
        self.0.get_mut(view.0 as usize).and_then(Option::as_mut).ok_or_else(|| no_view(view))
    }
}

fn no_view(view: ViewIndex) -> Error {
    Error::run("the views", format!("a pixel sample is of view {}, which is not there", view.0))
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

/// The placement of the object that a view shows, counted from 0: it may be turned over between two
/// rounds of photographs.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Placement(pub u32);

/// Which part of a data set a view belongs to.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Split {
    /// Used by fits.
    Train,
    /// Held out.
    Test,
}

/// One view as read from a data set, before it is spawned.
#[derive(Clone, Debug)]
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
    /// Prior maps of the surface that it shows.
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

    /// The view with a rendered picture as its photograph and mask.
    #[must_use]
    pub fn with_frame(self, frame: Frame) -> Self {
        let Camera { width, height, .. } = self.camera;
        let image = Image { width, height, pixels: frame.color };
        let mask = Mask { width, height, coverage: frame.alpha };
        let (photograph, mask) = (Some(Photograph::of_image(&image)), Some(StoredMask::new(&mask)));
        Self { photograph, mask, ..self }
    }
}

/// Spawns views, numbered on from those that are there.
pub fn spawn_views(world: &mut World, views: Vec<ViewRecord>) {
    let next = world.query::<&ViewIndex>().iter(world).map(|index| index.0 + 1).max().unwrap_or(0);
    for (view, index) in views.into_iter().zip(next..) {
        let mut entity =
            world.spawn((ViewIndex(index), ViewName(view.name), view.camera, view.split, view.placement));
        insert(&mut entity, view.photograph);
        insert(&mut entity, view.mask.map(ViewMask));
        insert(&mut entity, view.priors.albedo.map(AlbedoMap));
        insert(&mut entity, view.priors.normals.map(NormalMap));
    }
}

fn insert<T: Component>(entity: &mut EntityWorldMut, component: Option<T>) {
    if let Some(component) = component {
        entity.insert(component);
    }
}

/// Rows that OpenEXR files with ZIP compression keep together; bands of a picture are whole
/// multiples of it.
pub const BLOCK_ROWS: usize = 16;

/// One rendered view with its layers; every list holds `width * height` values, row by row from the
/// top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Linear Rec. 709 radiance, coverage-weighted on black: channels `R G B`.
    pub color: Vec<Vec3>,
    /// Coverage in `[0, 1]`: channel `A`.
    pub alpha: Vec<f32>,
    /// Diffusely reflected part of `color`: `diffuse.R` …
    pub diffuse: Vec<Vec3>,
    /// Specularly reflected part of `color`: `specular.R` …
    pub specular: Vec<Vec3>,
    /// Diffuse albedo: `albedo.R` …
    pub albedo: Vec<Vec3>,
    /// World-space normal: `normal.X` …
    pub normal: Vec<Vec3>,
    /// Distance along the ray in world units, 0 where nothing was hit: `depth.Z`.
    pub depth: Vec<f32>,
}

impl Frame {
    /// Bytes of one pixel, in memory and in a file before compression.
    pub const PIXEL_BYTES: usize = (3 * 5 + 2) * size_of::<f32>();

    /// A copy of some rows, counted from 0.
    ///
    /// # Panics
    /// If the frame does not have these rows.
    #[must_use]
    pub fn band(&self, rows: Range<usize>) -> Self {
        let pixels = rows.start * self.width..rows.end * self.width;
        let vectors = [&self.color, &self.diffuse, &self.specular, &self.albedo, &self.normal];
        let [color, diffuse, specular, albedo, normal] =
            vectors.map(|values| values[pixels.clone()].to_vec());
        let [alpha, depth] = [&self.alpha, &self.depth].map(|values| values[pixels.clone()].to_vec());
        let (width, height) = (self.width, rows.len());
        Self { width, height, color, alpha, diffuse, specular, albedo, normal, depth }
    }
}

/// How many times brighter than the brightest pixel of a typical photograph a pixel may be: beyond,
/// it is broken, or a highlight that no other photograph has.
pub const GLARING: f32 = 64.0;

/// The greatest radiance that a pixel may have in a set of photographs whose brightest channels are
/// `highest`: [`GLARING`] times their median. Infinite if most are black.
pub fn glare_limit(highest: impl Iterator<Item = f32>) -> f32 {
    let mut highest: Vec<f32> = highest.collect();
    median(&mut highest).filter(|usual| *usual > 0.0).map_or(f32::INFINITY, |usual| GLARING * usual)
}

/// Three numbers for the pixels of a view that have some, as half floats and only inside a window.
/// A clone shares its memory.
#[derive(Clone, Debug)]
pub struct PriorMap {
    width: u32,
    window: PixelWindow,
    /// Zero where nothing is known.
    values: Arc<[[f16; 3]]>,
}

impl PriorMap {
    /// Keeps the part of a picture inside a window; zero marks an unknown pixel.
    pub fn new(image: &Image, window: PixelWindow) -> Self {
        let values = window.pixels(image.width).map(|i| image.pixels[i].to_array().map(f16::from_f32));
        Self { width: image.width, window, values: values.collect() }
    }

    /// Returns the value of pixel `y * width + x`, if known.
    #[inline]
    pub fn at(&self, pixel: usize) -> Option<Vec3> {
        let value = Vec3::from(self.values[self.window.place(pixel, self.width)?].map(f16::to_f32));
        (value != Vec3::ZERO).then_some(value)
    }
}

/// Somebody's diffuse albedo of what a view shows: linear, known up to one factor for the whole
/// picture.
#[derive(Component, Clone, Debug)]
pub struct AlbedoMap(pub PriorMap);

impl AlbedoMap {
    /// Whether a view has one, which is then where a fit of light and albedo begins.
    pub fn are_in(world: &mut World) -> bool {
        world.query::<&Self>().iter(world).next().is_some()
    }
}

/// Somebody's unit normals of what a view shows, in the world.
#[derive(Component, Clone, Debug)]
pub struct NormalMap(pub PriorMap);

/// The maps of a view.
#[derive(Clone, Debug, Default)]
pub struct ViewPriors {
    /// Diffuse albedo, as in [`AlbedoMap`].
    pub albedo: Option<PriorMap>,
    /// Normals, as in [`NormalMap`].
    pub normals: Option<PriorMap>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_photograph_does_not_move_the_limit() {
        let limit = |last: f32| glare_limit([1.0, 2.0, 3.0, last].into_iter());
        assert_eq!((limit(4.0), limit(1e9)), (glare_limit([2.0, 3.0, 4.0].into_iter()), limit(4.0)));
        assert_eq!(glare_limit([2.0].into_iter()), 128.0);
        assert_eq!(glare_limit([0.0, 0.0, 5.0].into_iter()), f32::INFINITY);
        assert_eq!(glare_limit([].into_iter()), f32::INFINITY);
    }

    #[test]
    fn a_map_knows_the_pixels_of_its_window_that_are_not_zero() {
        let pixels = (0..20).map(|i| if i == 7 { Vec3::ZERO } else { Vec3::new(i as f32, -0.5, 0.25) });
        let image = Image { width: 5, height: 4, pixels: pixels.collect() };
        let map = PriorMap::new(&image, PixelWindow { x: 1, y: 1, width: 3, height: 2 });
        for i in 0..20 {
            let known = [6, 8, 11, 12, 13].contains(&i);
            assert_eq!(map.at(i), known.then(|| image.pixels[i]), "{i}");
        }
        assert_eq!(map.values.len(), 6);
    }
}
