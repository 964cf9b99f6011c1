//! Images, masks and rectangles of them as grids of pixels: box filtering, interpolation, and
//! distance to silhouettes. Pixels are stored row by row from the top left.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::view::{Image, raster::bilinear};
//!
//! let pixels = vec![Vec3::ZERO, Vec3::ONE, Vec3::ONE, Vec3::ZERO];
//! let image = Image { width: 2, height: 2, pixels };
//! assert_eq!(image.downscaled(2).pixels, [Vec3::splat(0.5)]);
//! let between = bilinear(2, 2, 0.25, 0.0).map(|(pixel, weight)| image.pixels[pixel] * weight);
//! assert_eq!(between.into_iter().sum::<Vec3>(), Vec3::splat(0.25));
//! ```

use glam::{DVec3, Vec3};

/// A linear RGB image, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// `width * height` linear Rec. 709 radiances.
    pub pixels: Vec<Vec3>,
}

/// Coverage of each pixel by the object, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mask {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// `width * height` values in `[0, 1]`.
    pub coverage: Vec<f32>,
}

/// A rectangle of a picture, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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

    /// The smallest window with all pixels of a mask that are covered at all; of an empty mask
    /// nothing.
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
        places.map(move |(across, down)| {
            let (width, height) = (side.min(self.width - across), side.min(self.height - down));
            Self { x: self.x + across, y: self.y + down, width, height }
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

/// Coverage above which a pixel counts as fully covered (8-bit masks hold 254/255 = 0.996 and 1).
pub const FULL_COVERAGE: f32 = 0.999;

impl Image {
    /// The image `factor` times smaller along each axis; each pixel is the mean of its block.
    /// Remaining pixels at the right and bottom edge are dropped, as in
    /// [`crate::view::Camera::scaled`]. A `factor` of 0 counts as 1.
    pub fn downscaled(&self, factor: u32) -> Self {
        let (width, height) = small_size(self.width, self.height, factor);
        let scale = 1.0 / f64::from(factor.max(1)).powi(2);
        let blocks = blocks(self.width, self.height, factor);
        let sums = blocks.map(|block| block.map(|i| self.pixels[i].as_dvec3()).sum::<DVec3>());
        Self { width, height, pixels: sums.map(|sum| (sum * scale).as_vec3()).collect() }
    }
}

impl Mask {
    /// The mask `factor` times smaller along each axis; see [`Image::downscaled`].
    pub fn downscaled(&self, factor: u32) -> Self {
        let (width, height) = small_size(self.width, self.height, factor);
        let scale = 1.0 / f64::from(factor.max(1)).powi(2);
        let blocks = blocks(self.width, self.height, factor);
        let sums = blocks.map(|block| block.map(|i| f64::from(self.coverage[i])).sum::<f64>());
        Self { width, height, coverage: sums.map(|sum| (sum * scale) as f32).collect() }
    }
}

/// Whether any pixel of each block is set; see [`Image::downscaled`].
pub fn any_downscaled(flags: &[bool], width: u32, height: u32, factor: u32) -> Vec<bool> {
    blocks(width, height, factor).map(|mut block| block.any(|i| flags[i])).collect()
}

fn small_size(width: u32, height: u32, factor: u32) -> (u32, u32) {
    (width / factor.max(1), height / factor.max(1))
}

/// For each pixel of the small image, row by row, the indices of its block in the large one.
fn blocks(width: u32, height: u32, factor: u32) -> impl Iterator<Item = impl Iterator<Item = usize>> {
    let ((across, down), side) = (small_size(width, height, factor), factor.max(1));
    let places = (0..down).flat_map(move |y| (0..across).map(move |x| (x * side, y * side)));
    places.map(move |(x, y)| PixelWindow { x, y, width: side, height: side }.pixels(width))
}

/// Index of a pixel, and its weight in a sum.
pub type Tap = (usize, f32);

/// The four pixels around a position, with bilinear weights; (0, 0) is the center of the first
/// pixel. Positions outside are clamped to the border.
#[inline]
pub fn bilinear(width: u32, height: u32, x: f32, y: f32) -> [Tap; 4] {
    let split = |at: f32, count: u32| {
        let at = at.clamp(0.0, count.saturating_sub(1) as f32);
        let first = at as usize;
        (first, (first + 1).min(count.saturating_sub(1) as usize), at - first as f32)
    };
    let ((x0, x1, tx), (y0, y1, ty)) = (split(x, width), split(y, height));
    let width = width as usize;
    [
        (y0 * width + x0, (1.0 - tx) * (1.0 - ty)),
        (y0 * width + x1, tx * (1.0 - ty)),
        (y1 * width + x0, (1.0 - tx) * ty),
        (y1 * width + x1, tx * ty),
    ]
}

/// Signed distance in pixels from the center of every pixel to the silhouette of a mask, negative
/// inside.
///
/// The exact Euclidean transform of Felzenszwalb and Huttenlocher ("Distance Transforms of Sampled
/// Functions", 2012), run for the pixels on either side; next to the silhouette the coverage of
/// partly covered pixels gives subpixel distances. `coverage` holds `width * height` values in [0,
/// 1]; the silhouette is at half coverage. A mask that is all inside or all outside has no
/// silhouette, and distances of the size of the image.
pub fn signed_distance(coverage: &[f32], width: usize, height: usize) -> Vec<f32> {
    assert_eq!(coverage.len(), width * height, "one coverage per pixel");
    let inside = |i: usize| coverage[i] >= 0.5;
    let to_inside = squared_distance(width, height, inside);
    let to_outside = squared_distance(width, height, |i| !inside(i));
    let distance = |i: usize| {
        // Pixels next to the other side: the silhouette lies between the two centers, half a pixel
        // away on average.
        let (far, sign) = if inside(i) { (to_outside[i], -1.0) } else { (to_inside[i], 1.0) };
        let partly = coverage[i] > 0.0 && coverage[i] < 1.0;
        if partly && far <= 2.0 { 0.5 - coverage[i] } else { sign * (far.sqrt() - 0.5) }
    };
    (0..coverage.len()).map(distance).collect()
}

/// Squared distance from every pixel to the nearest one that is `set`; at most that across the
/// image.
fn squared_distance(width: usize, height: usize, set: impl Fn(usize) -> bool) -> Vec<f32> {
    let far = ((width + height) * (width + height)) as f32;
    let mut grid: Vec<f32> = (0..width * height).map(|i| if set(i) { 0.0 } else { far }).collect();
    let mut line = Vec::new();
    for x in 0..width {
        line.clear();
        line.extend((0..height).map(|y| grid[y * width + x]));
        for (y, value) in lower_envelope(&line).into_iter().enumerate() {
            grid[y * width + x] = value;
        }
    }
    for row in grid.chunks_exact_mut(width.max(1)) {
        let transformed = lower_envelope(row);
        row.copy_from_slice(&transformed);
    }
    grid
}

/// min over q of (p − q)² + f(q), for every p: the lower envelope of parabolas.
fn lower_envelope(f: &[f32]) -> Vec<f32> {
    let crossing = |q: usize, v: usize| {
        let (qf, vf) = (q as f32, v as f32);
        ((f[q] + qf * qf) - (f[v] + vf * vf)) / (2.0 * (qf - vf))
    };
    // Parabolas of the envelope, and the start of each.
    let (mut hull, mut starts) = (vec![0], vec![f32::NEG_INFINITY]);
    for q in 1..f.len() {
        let mut start = crossing(q, hull[hull.len() - 1]);
        while start <= starts[starts.len() - 1] {
            hull.pop();
            starts.pop();
            start = crossing(q, hull[hull.len() - 1]);
        }
        hull.push(q);
        starts.push(start);
    }
    let mut k = 0;
    let least = |p: usize| {
        while k + 1 < hull.len() && starts[k + 1] < p as f32 {
            k += 1;
        }
        let d = p as f32 - hull[k] as f32;
        d * d + f[hull[k]]
    };
    (0..f.len()).map(least).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bilinear_weights_are_exact_for_planes() {
        let plane = |x: f32, y: f32| 2.0 * x - 3.0 * y + 1.0;
        let values: Vec<f32> = (0..35).map(|i| plane((i % 7) as f32, (i / 7) as f32)).collect();
        let at = |x: f32, y: f32| bilinear(7, 5, x, y).iter().map(|tap| values[tap.0] * tap.1).sum::<f32>();
        for (x, y) in [(0.0, 0.0), (6.0, 4.0), (2.25, 3.5), (5.9, 0.1)] {
            assert!((at(x, y) - plane(x, y)).abs() < 1e-5);
        }
        assert_eq!((at(-3.0, 9.0), at(f32::NAN, 0.0).is_nan()), (plane(0.0, 4.0), true));
    }

    #[test]
    fn blocks_are_averaged_and_the_rest_dropped() {
        let pixels = (0..15).map(|i| Vec3::new(i as f32, 1.0, -2.0 * i as f32)).collect();
        let small = Image { width: 5, height: 3, pixels }.downscaled(2);
        assert_eq!((small.width, small.height), (2, 1));
        assert_eq!(small.pixels, [Vec3::new(3.0, 1.0, -6.0), Vec3::new(5.0, 1.0, -10.0)]);
        let mask = Mask { width: 2, height: 2, coverage: vec![1.0, 0.0, 0.5, 0.5] };
        assert_eq!(mask.downscaled(2).coverage, [0.5]);
        assert_eq!(any_downscaled(&[false, false, true, false], 4, 1, 1), [false, false, true, false]);
        let flags = [false, false, false, true, false, false, false, false];
        assert_eq!(any_downscaled(&flags, 4, 2, 2), [false, true]);
    }

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

    #[test]
    fn the_distance_to_a_disc_is_right_to_a_fraction_of_a_pixel() {
        let (n, radius) = (64usize, 20.0f32);
        let from_center = |i: usize| {
            let (x, y) = ((i % n) as f32 + 0.5 - 32.0, (i / n) as f32 + 0.5 - 32.0);
            (x * x + y * y).sqrt()
        };
        let coverage: Vec<f32> =
            (0..n * n).map(|i| (radius - from_center(i) + 0.5).clamp(0.0, 1.0)).collect();
        for (i, d) in signed_distance(&coverage, n, n).into_iter().enumerate() {
            assert!((d - (from_center(i) - radius)).abs() < 0.75, "pixel {i}: {d}");
        }
    }

    #[test]
    fn masks_without_a_silhouette_give_finite_distances() {
        for value in [0.0, 1.0] {
            assert!(signed_distance(&[value; 12], 4, 3).iter().all(|d| d.is_finite() && d.abs() > 5.0));
        }
    }
}
