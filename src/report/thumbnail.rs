//! Small pictures for pages: JPEG, of a size that keeps a page within its budget.

use crate::codec::file::write_bytes;
use crate::codec::image::encode_jpeg;
use crate::error::Result;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::imageops::thumbnail;
use image::{GrayImage, RgbImage};
use std::path::Path;

/// Quality of the JPEGs, 1 to 100: traces of compression are not seen.
const QUALITY: u8 = 85;
/// Bytes that all small pictures of the views of a run may take together.
const BUDGET: f64 = 5.5e6;
/// Bytes of a pixel of a picture of an object, about: measured on renders and error maps at [`QUALITY`].
const BYTES_PER_PIXEL: f64 = 0.2;
/// Longest sides: of few pictures, and of so many that the budget is not kept.
const LONGEST: f64 = 512.0;
const SHORTEST: f64 = 96.0;

/// The longest side of each of `count` pictures that are to keep to the budget of a run together, in pixels.
pub(crate) fn side_for(count: usize) -> u32 {
    side_within(count, BUDGET)
}

/// The longest side of each of `count` pictures that are to keep to about `budget` bytes together, in pixels.
pub(crate) fn side_within(count: usize, budget: f64) -> u32 {
    let side = (budget / BYTES_PER_PIXEL / count.max(1) as f64).sqrt();
    side.clamp(SHORTEST, LONGEST) as u32
}

/// A JPEG as an address, for a page that holds its pictures.
pub(crate) fn jpeg_address(bytes: &[u8]) -> String {
    format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes))
}

/// The size of a picture whose longer side is at most `side` pixels; `None` if it is no larger.
fn smaller((width, height): (u32, u32), side: u32) -> Option<(u32, u32)> {
    let factor = f64::from(side.max(1)) / f64::from(width.max(height).max(1));
    let scaled = |length: u32| ((f64::from(length) * factor).round() as u32).max(1);
    (factor < 1.0).then(|| (scaled(width), scaled(height)))
}

/// A mask at the size of [`thumbnail_jpeg`].
pub(crate) fn thumbnail_mask(mask: &GrayImage, side: u32) -> GrayImage {
    smaller(mask.dimensions(), side)
        .map_or_else(|| mask.clone(), |(width, height)| thumbnail(mask, width, height))
}

/// The picture as a JPEG whose longer side is at most `side` pixels; it is never enlarged.
///
/// # Errors
/// [`Error::Run`](crate::Error::Run) for a picture without pixels.
pub(crate) fn thumbnail_jpeg(picture: &RgbImage, side: u32) -> Result<Vec<u8>> {
    let small = smaller(picture.dimensions(), side).map(|(width, height)| thumbnail(picture, width, height));
    encode_jpeg(small.as_ref().unwrap_or(picture), QUALITY)
}

/// Writes [`thumbnail_jpeg`] to a file.
///
/// # Errors
/// Those of [`thumbnail_jpeg`]; [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub(crate) fn write_thumbnail(path: &Path, picture: &RgbImage, side: u32) -> Result<()> {
    write_bytes(path, &thumbnail_jpeg(picture, side)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::image::decode;
    use image::{Luma, Rgb};

    #[test]
    fn few_pictures_are_large_and_many_keep_to_the_budget() {
        assert_eq!((side_for(0), side_for(3)), (512, 512));
        let side = f64::from(side_for(900));
        assert!(side < 200.0 && 900.0 * side * side * BYTES_PER_PIXEL <= BUDGET, "{side}");
        assert_eq!(side_for(1_000_000), 96);
        assert!(side_within(100, 1e6) < side_within(100, 2e6));
    }

    #[test]
    fn pictures_keep_their_shape_and_are_not_enlarged() {
        let size = |width, height, side| {
            let picture = RgbImage::from_pixel(width, height, Rgb([200, 40, 10]));
            let read = decode(&thumbnail_jpeg(&picture, side).unwrap()).unwrap().to_rgb8();
            let [r, g, b] = read.get_pixel(0, 0).0;
            assert!(r.abs_diff(200) < 6 && g.abs_diff(40) < 6 && b.abs_diff(10) < 6, "{r} {g} {b}");
            read.dimensions()
        };
        assert_eq!(size(40, 20, 512), (40, 20));
        assert_eq!(size(40, 20, 10), (10, 5));
        assert_eq!(size(1, 300, 10), (1, 10));
        let mask =
            |width, height, side| thumbnail_mask(&GrayImage::from_pixel(width, height, Luma([9])), side);
        assert_eq!((mask(1, 300, 10).dimensions(), mask(40, 20, 512).dimensions()), ((1, 10), (40, 20)));
        assert_eq!(mask(40, 20, 10).get_pixel(3, 3).0, [9]);
        assert!(thumbnail_jpeg(&RgbImage::new(0, 4), 10).is_err());
    }
}
