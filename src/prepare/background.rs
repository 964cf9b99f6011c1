//! Whether the background stands still while the object turns.
//!
//! Cameras are found from what moves together. Before a camera that stands still, as at a turntable, background and object
//! contradict each other, and only the object says where the camera is. If the camera moves, the background helps.

use crate::codec::image::decode_picture;
use crate::error::Result;
use crate::error::stop::check_interrupted;
use crate::prepare::photographs::PhotographFile;
use image::imageops::thumbnail;
use image::{GrayImage, Luma};
use std::path::Path;

/// Photographs that are compared, spread over all.
const COMPARED: usize = 10;
/// Longer side of the small pictures that are compared.
const SIDE: u32 = 64;
/// Contrast of a background, in 8-bit steps, below which it says nothing of the camera.
const PLAIN: f64 = 5.0;
/// Mean difference of two photographs' backgrounds, as a part of their contrast, up to which they are the same.
const SAME: f64 = 0.35;
/// Width of the border that is taken for background where there are no masks, as a part of the picture.
const BORDER: f64 = 0.15;
/// Part of a picture that is compared at least; with less, an object fills the frame.
const LEAST_BACKGROUND: f64 = 0.05;

/// What the background does from photograph to photograph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BackgroundMotion {
    /// It differs, or the photographs do in size.
    Moves,
    /// It is the same in all.
    StandsStill,
    /// It is plain, or not to be seen.
    SaysNothing,
}

/// What the background of the photographs does; without masks, it is the border of the frame.
///
/// # Errors
/// [`Error::Input`] if a photograph or a mask cannot be read.
pub(super) fn background(
    photographs: &[PhotographFile],
    images: &Path,
    masks: Option<&Path>,
) -> Result<BackgroundMotion> {
    if photographs.iter().any(|photograph| photograph.size != photographs[0].size) {
        return Ok(BackgroundMotion::Moves);
    }
    let pictures = compared(photographs, images, masks)?;
    let (mut difference, mut values) = (0.0, Vec::new());
    for (k, one) in pictures.iter().enumerate() {
        let other = &pictures[(k + 1) % pictures.len()];
        for i in (0..one.gray.as_raw().len()).filter(|&i| one.is_background(i) && other.is_background(i)) {
            let [a, b] = [one, other].map(|picture| f64::from(picture.gray.as_raw()[i]));
            difference += (a - b).abs();
            values.push(a);
        }
    }
    let pixels: usize = pictures.iter().map(|picture| picture.gray.as_raw().len()).sum();
    if (values.len() as f64) < LEAST_BACKGROUND * pixels as f64 {
        return Ok(BackgroundMotion::SaysNothing);
    }
    let contrast = deviation(&values);
    Ok(if contrast < PLAIN {
        BackgroundMotion::SaysNothing
    } else if difference / (values.len() as f64) < SAME * contrast {
        BackgroundMotion::StandsStill
    } else {
        BackgroundMotion::Moves
    })
}

/// A photograph in gray with its mask, both a few pixels wide.
struct SmallPicture {
    gray: GrayImage,
    mask: GrayImage,
}

impl SmallPicture {
    /// Whether pixel `i` is not of the object.
    fn is_background(&self, i: usize) -> bool {
        self.mask.as_raw()[i] == 0
    }
}

/// The photographs that are compared, spread over all.
fn compared(
    photographs: &[PhotographFile],
    images: &Path,
    masks: Option<&Path>,
) -> Result<Vec<SmallPicture>> {
    let mut pictures = Vec::new();
    for photograph in photographs.iter().step_by(photographs.len().div_ceil(COMPARED)) {
        check_interrupted()?;
        let gray = small(&images.join(&photograph.name))?;
        let mask = match masks {
            Some(masks) => small(&masks.join(format!("{}.png", photograph.name)))?,
            None => middle(gray.width(), gray.height()),
        };
        pictures.push(SmallPicture { gray, mask });
    }
    Ok(pictures)
}

fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// A mask of all but the border.
fn middle(width: u32, height: u32) -> GrayImage {
    let is_inside = |at: u32, side: u32| {
        let share = (f64::from(at) + 0.5) / f64::from(side);
        share > BORDER && share < 1.0 - BORDER
    };
    let value = |inside: bool| Luma([if inside { 255 } else { 0 }]);
    GrayImage::from_fn(width, height, |x, y| value(is_inside(x, width) && is_inside(y, height)))
}

/// A picture in gray, a few pixels wide.
fn small(path: &Path) -> Result<GrayImage> {
    let picture = decode_picture(path)?.into_luma8();
    let (width, height) = picture.dimensions();
    let shrink = (f64::from(width.max(height)) / f64::from(SIDE)).max(1.0);
    let [width, height] = [width, height].map(|side| ((f64::from(side) / shrink) as u32).max(1));
    Ok(thumbnail(&picture, width, height))
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::prepare::photographs::{list, place};
    use image::{Rgb, RgbImage};
    use std::fs;

    /// Photographs whose background is `shade` at a place and a number, behind a square that changes.
    fn judged(shade: impl Fn(u32, u32, u32) -> u8) -> BackgroundMotion {
        let folder = tempfile::tempdir().unwrap();
        let [photos, images, masks] = ["photos", "images", "masks"].map(|name| folder.path().join(name));
        fs::create_dir(&photos).unwrap();
        fs::create_dir(&masks).unwrap();
        let inside = |x: u32, y: u32| (30..60).contains(&x) && (20..50).contains(&y);
        for i in 0..6 {
            let value = |x, y| if inside(x, y) { (40 * i) as u8 } else { shade(x, y, i) };
            RgbImage::from_fn(96, 64, |x, y| Rgb([value(x, y); 3]))
                .save(photos.join(format!("{i}.png")))
                .unwrap();
            let mask = GrayImage::from_fn(96, 64, |x, y| Luma([if inside(x, y) { 255 } else { 0 }]));
            mask.save(masks.join(format!("{i}.png.png"))).unwrap();
        }
        let photographs = list(&photos).unwrap().photographs;
        place(&photographs, &images).unwrap();
        let found = background(&photographs, &images, Some(&masks)).unwrap();
        // The square is nowhere near the border.
        assert_eq!(background(&photographs, &images, None).unwrap(), found);
        found
    }

    #[test]
    fn a_background_that_stays_is_told_from_one_that_moves() {
        let pattern =
            |x: u32, y: u32| (128.0 + 90.0 * (0.13 * x as f32).sin() * (0.17 * y as f32).cos()) as u8;
        assert_eq!(judged(|x, y, i| pattern(x, y).saturating_add(i as u8)), BackgroundMotion::StandsStill);
        assert_eq!(judged(|x, y, i| pattern(x + 17 * i, y + 5 * i)), BackgroundMotion::Moves);
        assert_eq!(judged(|_, _, i| 200 + i as u8), BackgroundMotion::SaysNothing);
    }
}
