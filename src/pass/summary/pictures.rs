//! Pictures of a run's folder as `data:` addresses.

use crate::codec::file::read_up_to;
use crate::codec::image::decode;
use crate::report::sheet::Theme;
use crate::report::thumbnail::{jpeg_address, thumbnail_jpeg};
use image::{Rgb, RgbImage, RgbaImage};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Bytes of a file that is taken as it is, and of one that is made smaller, at most.
const MOST_SMALL_BYTES: u64 = 1 << 20;
const MOST_BYTES: u64 = 256 << 20;

/// Addresses of pictures; a file is read once.
#[derive(Default)]
pub struct Pictures {
    known: BTreeMap<PathBuf, String>,
    /// Bytes of addresses that may still be given out.
    left: usize,
}

impl Pictures {
    /// Begins a report whose addresses have at most `budget` bytes together.
    pub fn begin(&mut self, budget: usize) {
        self.left = budget;
    }

    /// A small JPEG as it is; `None` if it cannot be read or the budget is spent.
    pub fn file(&mut self, path: &Path) -> Option<String> {
        self.address(path, || read_up_to(path, MOST_SMALL_BYTES, |_| String::new()).ok())
    }

    /// A PNG whose longer side is at most `side` pixels, on the mat of a contact sheet; `None` if it cannot be read or the budget is spent.
    pub fn small(&mut self, path: &Path, side: u32) -> Option<String> {
        self.address(path, || {
            let bytes = read_up_to(path, MOST_BYTES, |_| String::new()).ok()?;
            let picture = decode(&bytes).ok()?.to_rgba8();
            thumbnail_jpeg(&on_mat(&picture), side).ok()
        })
    }

    fn address(&mut self, path: &Path, bytes: impl FnOnce() -> Option<Vec<u8>>) -> Option<String> {
        if !self.known.contains_key(path) {
            let address = jpeg_address(&bytes()?);
            self.known.insert(path.to_owned(), address);
        }
        let address = self.known.get(path)?;
        self.left = self.left.checked_sub(address.len())?;
        Some(address.clone())
    }
}

/// The picture without transparency.
fn on_mat(picture: &RgbaImage) -> RgbImage {
    let mat = Theme::Light.mat();
    RgbImage::from_fn(picture.width(), picture.height(), |x, y| {
        let [r, g, b, a] = picture.get_pixel(x, y).0;
        let over =
            |c: u8, m: u8| ((u32::from(c) * u32::from(a) + u32::from(m) * (255 - u32::from(a))) / 255) as u8;
        Rgb([over(r, mat[0]), over(g, mat[1]), over(b, mat[2])])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use base64::Engine as _;
    use base64::engine::general_purpose::STANDARD;
    use image::Rgba;

    #[test]
    fn pictures_are_made_small_once_and_within_the_budget() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        RgbaImage::from_pixel(64, 32, Rgba([255, 0, 0, 0])).save(&path).unwrap();
        let mut pictures = Pictures::default();
        pictures.begin(1 << 20);
        let address = pictures.small(&path, 16).unwrap();
        let bytes = STANDARD.decode(address.strip_prefix("data:image/jpeg;base64,").unwrap()).unwrap();
        let read = decode(&bytes).unwrap().to_rgb8();
        assert_eq!(read.dimensions(), (16, 8));
        assert!(read.get_pixel(3, 3).0.iter().zip(Theme::Light.mat()).all(|(a, b)| a.abs_diff(b) < 4));
        std::fs::remove_file(&path).unwrap();
        assert_eq!(pictures.small(&path, 16), Some(address.clone()));
        pictures.begin(address.len() + 1);
        assert!(pictures.small(&path, 16).is_some() && pictures.small(&path, 16).is_none());
    }

    #[test]
    fn what_is_no_picture_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let mut pictures = Pictures::default();
        pictures.begin(1 << 20);
        assert_eq!((pictures.small(&path, 16), pictures.file(&path)), (None, None));
        std::fs::write(&path, "no picture").unwrap();
        assert_eq!(pictures.small(&path, 16), None);
        std::fs::write(&path, vec![0; 2 << 20]).unwrap();
        assert_eq!(pictures.file(&path), None);
    }
}
