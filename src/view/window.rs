//! Rectangles of pictures.

use crate::view::image::Mask;
use serde::{Deserialize, Serialize};

/// A rectangle of a picture, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PixelWindow {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
}

impl PixelWindow {
    /// The whole of a picture.
    pub fn whole(width: u32, height: u32) -> Self {
        Self { x: 0, y: 0, width, height }
    }

    /// The smallest window with all pixels of a mask that are covered at all; of an empty mask nothing.
    pub fn of_mask(mask: &Mask) -> Self {
        let (mut low, mut high) = ([u32::MAX; 2], [0; 2]);
        let width = mask.width.max(1) as usize;
        for (y, row) in (0..).zip(mask.coverage.chunks(width)) {
            let first = row.iter().position(|coverage| *coverage > 0.0);
            let last = row.iter().rposition(|coverage| *coverage > 0.0);
            if let (Some(first), Some(last)) = (first, last) {
                low = [low[0].min(first as u32), low[1].min(y)];
                high = [high[0].max(last as u32 + 1), y + 1];
            }
        }
        let low = [low[0].min(high[0]), low[1].min(high[1])];
        Self { x: low[0], y: low[1], width: high[0] - low[0], height: high[1] - low[1] }
    }

    /// Squares of `side` pixels that make up the window; smaller ones where it ends. `side` ≥ 1.
    pub fn squares(self, side: u32) -> impl Iterator<Item = Self> {
        let starts = move |count: u32| (0..count).step_by(side as usize);
        let places =
            starts(self.height).flat_map(move |down| starts(self.width).map(move |across| (across, down)));
        places.map(move |(across, down)| Self {
            x: self.x + across,
            y: self.y + down,
            width: side.min(self.width - across),
            height: side.min(self.height - down),
        })
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Whether there is no pixel in it.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Place in the window of pixel `y * picture_width + x` of the picture; `None` outside.
    #[inline]
    pub fn place(&self, pixel: usize, picture_width: u32) -> Option<usize> {
        let (x, y) = ((pixel % picture_width as usize) as u32, (pixel / picture_width as usize) as u32);
        let (x, y) = (x.wrapping_sub(self.x), y.wrapping_sub(self.y));
        (x < self.width && y < self.height).then(|| y as usize * self.width as usize + x as usize)
    }

    /// The pixel of the picture, as `y * picture_width + x`, at a place in the window.
    #[inline]
    pub fn pixel(&self, place: usize, picture_width: u32) -> usize {
        let (x, y) = (place % self.width as usize, place / self.width as usize);
        (self.y as usize + y) * picture_width as usize + self.x as usize + x
    }

    /// The pixels of the picture in it, as `y * picture_width + x`, row by row.
    pub fn pixels(self, picture_width: u32) -> impl Iterator<Item = usize> + Clone {
        let columns = move |y: u32| (self.x..self.x + self.width).map(move |x| (x, y));
        let cells = (self.y..self.y + self.height).flat_map(columns);
        cells.map(move |(x, y)| y as usize * picture_width as usize + x as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_hold_each_pixel_of_a_window_once() {
        let window = PixelWindow { x: 3, y: 5, width: 10, height: 7 };
        for side in [1, 4, 7, 100] {
            let mut pixels: Vec<usize> = window.squares(side).flat_map(|square| square.pixels(40)).collect();
            pixels.sort_unstable();
            assert_eq!(pixels, window.pixels(40).collect::<Vec<_>>(), "{side}");
        }
        assert_eq!(PixelWindow { width: 0, ..window }.squares(4).count(), 0);
    }
}
