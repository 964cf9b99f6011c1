//! Frames of a video, by `ffmpeg`: of each group of frames the sharpest.

use crate::codec::nearby::natural_order;
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::pass::progress::Progress;
use crate::prepare::program::Program;
use image::GrayImage;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

/// What to do without ffmpeg.
pub(super) const INSTALL: &str = "Install ffmpeg (Debian and Ubuntu: `apt install ffmpeg`; macOS: `brew install ffmpeg`), name the \
                                  program with `--ffmpeg PROGRAM`, or give a folder of photographs instead of the video.";
/// Frames of which the sharpest is kept.
const GROUP: usize = 4;
/// Extensions of video files.
const VIDEOS: [&str; 9] = ["mp4", "mov", "m4v", "mkv", "webm", "avi", "mpg", "mpeg", "mts"];

/// Whether a file is a video by its name.
pub(super) fn is_video(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    path.is_file() && VIDEOS.contains(&extension.as_str())
}

/// Writes the sharpest frames of `video`, `per_second` of them, as `000001.jpg`… into the empty folder `frames`.
///
/// # Errors
/// Those of [`Program::run`]; [`Error::Input`] if the video has no frames.
pub(super) fn extract(
    ffmpeg: &Program,
    video: &Path,
    per_second: f32,
    frames: &Path,
    log: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let bar = progress.bar("video", 100);
    let mut length = None;
    ffmpeg.run(&arguments(video, per_second, frames), log, &mut |line| {
        length = length.or_else(|| duration(line));
        if let (Some(length), Some(at)) = (length, position(line)) {
            bar.set_position((100.0 * at / length).clamp(0.0, 100.0) as u64);
        }
    })?;
    bar.finish_and_clear();
    let mut files: Vec<PathBuf> = fs::read_dir(frames)
        .map_err(Error::io("read", frames))?
        .map(|entry| entry.map(|entry| entry.path()).map_err(Error::io("read", frames)))
        .collect::<Result<_>>()?;
    if files.is_empty() {
        return Err(Error::input(video, "", "the video has no frames", "Does a player show it?"));
    }
    files.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    keep_sharpest(&files, progress)
}

/// ffmpeg turns frames as the video says, so that they are upright.
fn arguments(video: &Path, per_second: f32, frames: &Path) -> Vec<OsString> {
    let mut words: Vec<OsString> =
        ["-hide_banner", "-nostdin", "-nostats", "-progress", "pipe:1", "-i"].map(Into::into).into();
    words.push(video.as_os_str().to_owned());
    words.extend(["-vf".into(), format!("fps={}", per_second * GROUP as f32).into()]);
    words.extend(["-q:v", "1", "-qmin", "1"].map(OsString::from));
    words.push(frames.join("%06d.jpg").into_os_string());
    words
}

/// Seconds of `Duration: 00:01:02.50`.
fn duration(line: &str) -> Option<f64> {
    let clock = line.split_once("Duration: ")?.1.split(',').next()?;
    seconds(clock).filter(|seconds| *seconds > 0.0)
}

/// Seconds of `out_time=00:00:01.500000`.
fn position(line: &str) -> Option<f64> {
    seconds(line.strip_prefix("out_time=")?)
}

fn seconds(clock: &str) -> Option<f64> {
    let mut sum = 0.0;
    for part in clock.trim().split(':') {
        sum = 60.0 * sum + part.parse::<f64>().ok()?;
    }
    Some(sum)
}

/// Removes all but the sharpest of each group of consecutive frames.
fn keep_sharpest(files: &[PathBuf], progress: &dyn Progress) -> Result<()> {
    let bar = progress.bar("sharpest", files.len() as u64);
    for group in files.chunks(GROUP) {
        check_interrupted()?;
        let mut scored = Vec::new();
        for path in group {
            let damaged = |error: image::ImageError| {
                Error::input(
                    path,
                    "",
                    format!("the frame cannot be read: {error}"),
                    "Extract the video again.",
                )
            };
            scored.push((sharpness(&image::open(path).map_err(damaged)?.into_luma8()), path));
        }
        // A later frame replaces an earlier one only if it is sharper.
        let best = scored.iter().rev().max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, path)| *path);
        for path in group.iter().filter(|path| Some(*path) != best) {
            fs::remove_file(path).map_err(Error::io("remove", path))?;
        }
        bar.inc(group.len() as u64);
    }
    bar.finish_and_clear();
    Ok(())
}

/// Variance of the Laplacian: motion and wrong focus lower it.
fn sharpness(frame: &GrayImage) -> f64 {
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    if width < 3 || height < 3 {
        return 0.0;
    }
    let value = |x: usize, y: usize| f64::from(frame.as_raw()[y * width + x]);
    let (mut sum, mut squares) = (0.0, 0.0);
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let around = value(x - 1, y) + value(x + 1, y) + value(x, y - 1) + value(x, y + 1);
            let laplacian = around - 4.0 * value(x, y);
            sum += laplacian;
            squares += laplacian * laplacian;
        }
    }
    let count = ((width - 2) * (height - 2)) as f64;
    squares / count - (sum / count).powi(2)
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::pass::progress::Silent;
    use crate::prepare::test_data::{disc, script};
    use image::imageops::blur;

    fn ffmpeg(path: PathBuf) -> Program {
        Program { path, install: INSTALL }
    }

    #[test]
    fn output_says_how_far_it_is() {
        assert_eq!(duration("  Duration: 00:01:02.50, start: 0.0, bitrate: 9 kb/s"), Some(62.5));
        assert_eq!(duration("  Duration: N/A, start: 0.0"), None);
        assert_eq!(position("out_time=00:00:01.500000"), Some(1.5));
        assert_eq!(position("frame=3"), None);
    }

    #[test]
    fn the_sharpest_frame_of_each_group_stays() {
        let folder = tempfile::tempdir().unwrap();
        let frames = folder.path().join("frames");
        fs::create_dir(&frames).unwrap();
        for i in 1..=6 {
            let sharp = disc(40, 30);
            let picture = if i == 3 || i == 5 { sharp } else { blur(&sharp, 1.5) };
            picture.save(folder.path().join(format!("{i:06}.jpg"))).unwrap();
        }
        // The last argument is the pattern of the frames.
        let body =
            format!("for last; do :; done; cp {}/0*.jpg \"$(dirname \"$last\")\"", folder.path().display());
        let fake = ffmpeg(script(folder.path(), "ffmpeg", &body));
        let log = folder.path().join("log");
        extract(&fake, Path::new("a.mp4"), 2.0, &frames, &log, &Silent).unwrap();
        let mut kept: Vec<_> =
            fs::read_dir(&frames).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        kept.sort();
        assert_eq!(kept, ["000003.jpg", "000005.jpg"]);
    }

    #[test]
    fn a_video_without_frames_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let frames = folder.path().join("frames");
        fs::create_dir(&frames).unwrap();
        let log = folder.path().join("log");
        let silent = ffmpeg(script(folder.path(), "ffmpeg", "exit 0"));
        let error = extract(&silent, Path::new("a.mp4"), 2.0, &frames, &log, &Silent).unwrap_err();
        assert!(error.to_string().contains("no frames"), "{error}");
        let failing = ffmpeg(script(folder.path(), "failing", "echo moov atom not found >&2; exit 1"));
        let error = extract(&failing, Path::new("a.mp4"), 2.0, &frames, &log, &Silent).unwrap_err();
        assert!(error.to_string().contains("moov atom not found"), "{error}");
        let missing = ffmpeg(folder.path().join("none"));
        let error = extract(&missing, Path::new("a.mp4"), 2.0, &frames, &log, &Silent).unwrap_err();
        assert!(error.help().unwrap().contains("apt install ffmpeg"), "{error}");
    }

    #[test]
    fn videos_are_files_with_such_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.MOV");
        assert!(!is_video(&path));
        fs::write(&path, "x").unwrap();
        assert!(is_video(&path) && !is_video(folder.path()));
    }
}
