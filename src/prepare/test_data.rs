//! What the tests of this room share: programs made of a few lines of shell, and photographs.

use image::{Rgb, RgbImage};
#[cfg(unix)]
use std::path::{Path, PathBuf};

/// An executable shell script.
#[cfg(unix)]
pub fn script(folder: &Path, name: &str, body: &str) -> PathBuf {
    use std::io::Write as _;
    use std::os::unix::fs::OpenOptionsExt as _;
    let path = folder.join(name);
    let mut options = std::fs::OpenOptions::new();
    let mut file = options.write(true).create(true).truncate(true).mode(0o755).open(&path).unwrap();
    write!(file, "#!/bin/sh\n{body}\n").unwrap();
    drop(file);
    path
}

/// A photograph of a reddish disc in front of a gray backdrop that gets darker to the right.
pub fn disc(width: u32, height: u32) -> RgbImage {
    let (x0, y0) = (width as f32 / 2.0, height as f32 / 2.0);
    let radius = width.min(height) as f32 / 4.0;
    RgbImage::from_fn(width, height, |x, y| {
        let distance = (x as f32 + 0.5 - x0).hypot(y as f32 + 0.5 - y0);
        let backdrop = (200.0 - 60.0 * x as f32 / width as f32) as u8 + (7 * x + 13 * y) as u8 % 3;
        if distance < radius { Rgb([160, 60 + (x % 5) as u8, 40]) } else { Rgb([backdrop; 3]) }
    })
}
