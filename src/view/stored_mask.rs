//! Masks as they are kept: in bytes where these hold the values, and only inside a window.

use crate::view::image::Mask;
use crate::view::numbers::{Numbers, tight};
use crate::view::window::PixelWindow;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A mask as it is kept. A clone shares its memory.
///
/// Pixels are numbered `y * width + x`. Outside its window the coverage is 0.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StoredMask {
    width: u32,
    height: u32,
    window: PixelWindow,
    /// Shared by clones.
    coverage: Arc<Numbers>,
}

impl StoredMask {
    /// Keeps a mask: one with values k/255 in bytes, others as half floats.
    pub fn new(mask: &Mask) -> Self {
        let window = PixelWindow::of_mask(mask);
        let values = window.pixels(mask.width).map(|i| mask.coverage[i]);
        let table: Arc<[f32]> = (0..=255u8).map(|v| f32::from(v) / 255.0).collect();
        let nearest = |coverage: f32| (coverage * 255.0).round() as u8;
        let coverage = if values.clone().all(|c| table[usize::from(nearest(c))] == c) {
            Numbers::Bytes(tight(values.map(nearest)), table)
        } else {
            Numbers::of(values, true)
        };
        Self { width: mask.width, height: mask.height, window, coverage: Arc::new(coverage) }
    }

    /// Width and height of the picture in pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// The part that holds all covered pixels.
    pub fn window(&self) -> PixelWindow {
        self.window
    }

    /// Whether every pixel is covered by half or more.
    pub fn is_full(&self) -> bool {
        let pixels = self.width as usize * self.height as usize;
        self.window.len() == pixels && (0..pixels).all(|i| self.coverage.get(i) >= 0.5)
    }

    /// Coverage of a pixel, in `[0, 1]`.
    #[inline]
    pub fn coverage(&self, pixel: usize) -> f32 {
        self.window.place(pixel, self.width).map_or(0.0, |at| self.coverage.get(at))
    }

    /// The whole mask.
    pub fn mask(&self) -> Mask {
        let mut coverage = vec![0.0; self.width as usize * self.height as usize];
        self.window.pixels(self.width).for_each(|i| coverage[i] = self.coverage(i));
        Mask { width: self.width, height: self.height, coverage }
    }

    /// Coverage of the pixels in the window.
    pub(super) fn numbers(&self) -> &Arc<Numbers> {
        &self.coverage
    }

    /// Memory that it takes, in bytes.
    pub fn bytes(&self) -> usize {
        self.coverage.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_cropped_and_keep_their_values() {
        let coverage = |i: usize| if [6, 8, 13].contains(&i) { 0.2 } else { 0.0 };
        let mask = Mask { width: 5, height: 4, coverage: (0..20).map(coverage).collect() };
        let kept = StoredMask::new(&mask);
        let middle = PixelWindow { x: 1, y: 1, width: 3, height: 2 };
        assert_eq!((kept.window(), kept.bytes()), (middle, 6));
        assert_eq!(kept.mask(), mask);
        let quarter = Mask { coverage: mask.coverage.iter().map(|c| c * 1.25).collect(), ..mask };
        assert_eq!((StoredMask::new(&quarter).mask(), StoredMask::new(&quarter).bytes()), (quarter, 12));
    }

    #[test]
    fn an_empty_mask_has_an_empty_window() {
        let mask = Mask { width: 3, height: 2, coverage: vec![0.0; 6] };
        assert!(PixelWindow::of_mask(&mask).is_empty());
        assert_eq!(StoredMask::new(&mask).mask(), mask);
    }
}
