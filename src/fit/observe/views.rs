//! Training views, and which of their pixels say something.

use super::candidate::Candidate;
use crate::error::Result;
use crate::ranks::Ranks;
use crate::ranks::owned::OwnedItems;
use crate::sample::pixel::{ImageGradient, Observed, PixelOf, SATURATION};
use crate::view::glare::glare_limit;
use crate::view::raster::FULL_COVERAGE;
use crate::view::{Camera, Photograph, PixelWindow, Split, StoredMask, ViewIndex, ViewMask};
use glam::Vec2;

/// A training view with a photograph.
pub(super) struct ObservedView<'a> {
    pub index: ViewIndex,
    pub camera: &'a Camera,
    pub photograph: &'a Photograph,
    pub mask: Option<&'a StoredMask>,
    /// The greatest radiance of a pixel that is not broken.
    pub limit: f32,
}

/// The columns of a view with a photograph.
pub(super) type ViewColumns =
    (&'static ViewIndex, &'static Camera, &'static Photograph, Option<&'static ViewMask>, &'static Split);

/// A row of [`ViewColumns`].
type ViewRow<'a> = (&'a ViewIndex, &'a Camera, &'a Photograph, Option<&'a ViewMask>, &'a Split);

/// The training views among these, in the order of their indices, as `ranks` share them.
pub(super) fn training_views<'a>(
    views: impl Iterator<Item = ViewRow<'a>>,
    ranks: Option<&'a Ranks>,
) -> SharedViews<'a> {
    let training: Vec<ViewRow<'a>> = views.filter(|(.., split)| **split == Split::Train).collect();
    let limit = glare_limit(training.iter().map(|(_, _, photograph, ..)| photograph.highest()));
    let observed = |(index, camera, photograph, mask, _): ViewRow<'a>| ObservedView {
        index: *index,
        camera,
        photograph,
        mask: mask.map(|mask| &mask.0),
        limit,
    };
    let mut training: Vec<_> = training.into_iter().map(observed).collect();
    training.sort_by_key(|view| view.index);
    SharedViews::new(training, ranks, |view| view.photograph.keeper())
}

/// The training views, the pixels of which several processes may share.
pub(super) type SharedViews<'a> = OwnedItems<'a, ObservedView<'a>>;

/// The number of usable foreground pixels of each.
///
/// # Errors
/// If another process is gone.
pub(super) fn usable_counts(training: &SharedViews) -> Result<Vec<usize>> {
    training.each(|_, view| view.usable().count())
}

impl ObservedView<'_> {
    /// Pixels that are fully covered and whose value says something.
    pub fn usable(&self) -> impl Iterator<Item = usize> {
        self.window().pixels(self.camera.width).filter(|i| self.is_usable(*i))
    }

    /// The part of the picture with pixels of the object.
    pub fn window(&self) -> PixelWindow {
        self.mask.map_or(PixelWindow::whole(self.camera.width, self.camera.height), StoredMask::window)
    }

    #[inline]
    pub fn is_usable(&self, pixel: usize) -> bool {
        if self.mask.is_some_and(|mask| mask.coverage(pixel) < FULL_COVERAGE) {
            return false;
        }
        // A non-finite pixel is read as black, an average of saturated pixels has no information, and no light glares in one view alone.
        let brightest = self.photograph.radiance(pixel).max_element();
        brightest <= self.limit && (brightest >= SATURATION || !self.photograph.is_saturated(pixel))
    }

    /// The usable pixels with these numbers, in rising order, of which the first has number `first`.
    pub fn candidates(&self, first: usize, numbers: &[(u32, u32)], gradients: bool) -> Vec<Candidate> {
        let mut wanted = numbers.iter().map(|(number, _)| *number as usize - first).peekable();
        let is_wanted = |(number, _): &(usize, usize)| wanted.next_if_eq(number).is_some();
        let found = self.usable().enumerate().filter(is_wanted);
        found.map(|(_, pixel)| self.candidate(pixel, gradients)).collect()
    }

    /// The pixel as a candidate, with its gradient or without.
    pub fn candidate(&self, pixel: usize, gradients: bool) -> Candidate {
        let (radiance, saturated) = (self.photograph.radiance(pixel), self.photograph.is_saturated(pixel));
        Candidate {
            pixel: PixelOf { view: self.index, pixel: pixel as u32 },
            observed: Observed { radiance, saturated },
            gradient: if gradients { self.gradient(pixel) } else { ImageGradient(None) },
        }
    }

    fn gradient(&self, pixel: usize) -> ImageGradient {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let (x, y) = (pixel % width, pixel / width);
        if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
            return ImageGradient(None);
        }
        let at = |i: usize| {
            let whole = self.mask.is_none_or(|mask| mask.coverage(i) >= FULL_COVERAGE);
            let known = whole && !self.photograph.is_saturated(i);
            known.then(|| self.photograph.radiance(i).element_sum() / 3.0)
        };
        let along = |step: usize| Some(0.5 * (at(pixel + step)? - at(pixel - step)?));
        ImageGradient(along(1).zip(along(width)).map(Vec2::from))
    }
}
