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

/// An ffmpeg that counts this many frames in a video of this length, and writes the frames that lie beside it as `000001.jpg`….
#[cfg(unix)]
pub(crate) fn fake_ffmpeg(folder: &Path, frames: u64, length: &str) -> PathBuf {
    // The last argument is the pattern of the frames, or nothing that is written.
    let body = format!(
        r#"here=$(dirname "$0"); echo "$@" >> "$here/ffmpeg-calls"; for last; do :; done
if [ "$last" = - ]; then
  echo "  Duration: {length}, start: 0.0" >&2; echo frame={frames}; echo out_time=00:00:01.500000
else
  cp "$here"/0*.jpg "$(dirname "$last")"; echo frame=1
fi"#
    );
    script(folder, "ffmpeg", &body)
}

/// A photograph of a reddish disc in front of a gray backdrop that gets darker to the right.
pub(crate) fn disc(width: u32, height: u32) -> RgbImage {
    let (x0, y0) = (width as f32 / 2.0, height as f32 / 2.0);
    let radius = width.min(height) as f32 / 4.0;
    RgbImage::from_fn(width, height, |x, y| {
        let distance = (x as f32 + 0.5 - x0).hypot(y as f32 + 0.5 - y0);
        let backdrop = (200.0 - 60.0 * x as f32 / width as f32) as u8 + (7 * x + 13 * y) as u8 % 3;
        if distance < radius { Rgb([160, 60 + (x % 5) as u8, 40]) } else { Rgb([backdrop; 3]) }
    })
}
