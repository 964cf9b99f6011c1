//! Frames of a video, by `ffmpeg`: evenly spaced, of each interval the sharpest.
//!
//! A first pass counts the frames without decoding them, so that a broken or short video is refused before anything is written. A
//! second one writes a few candidates of each interval, of which the sharpest stays.

use crate::codec::file::{first_bytes, open};
use crate::codec::image::{decode_picture, is_video_start};
use crate::codec::nearby::natural_order;
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::pass::progress::Progress;
use crate::prepare::left_out::{FEWEST, VIDEOS};
use crate::prepare::options::FrameCount;
use crate::prepare::program::{Program, without_log};
use image::GrayImage;
use image::imageops::thumbnail;
use rayon::prelude::*;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

/// What to do without ffmpeg.
pub(super) const INSTALL: &str = "Install ffmpeg (Debian and Ubuntu: `apt install ffmpeg`; macOS: `brew install ffmpeg`), name the \
                                  program with `--ffmpeg PROGRAM`, or give a folder of photographs instead of the video.";
/// Most frames that are used if nothing is said.
const USUAL: u64 = 150;
/// Most frames of an interval among which the sharpest is looked for.
const CANDIDATES: u64 = 4;
/// Longer side of the picture on which sharpness is measured: noise and blocks of the compression are finer.
const MEASURED_SIDE: u32 = 1024;
/// Bytes that tell a format.
const START: usize = 64;

/// Which frames of a video are used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FramePlan {
    /// How many frames the video has.
    pub total: u64,
    /// How many are used.
    pub used: u64,
}

impl FramePlan {
    /// Frames that are written, of which the sharpest of each interval stay.
    fn candidates(self) -> u64 {
        self.used * (self.total / self.used).clamp(1, CANDIDATES)
    }
}

/// Whether a file is a video, by its first bytes or its name.
pub(super) fn is_video(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let starts_so = || {
        let mut file = open(path, |_| String::new()).ok()?;
        first_bytes(path, &mut file, START).ok()
    };
    path.is_file()
        && (VIDEOS.contains(&extension.as_str()) || starts_so().is_some_and(|start| is_video_start(&start)))
}

/// Counts the frames of `video` and chooses how many are used.
///
/// # Errors
/// [`Error::Usage`] if ffmpeg is missing; [`Error::Input`] if the file cannot be read, or ffmpeg finds no frames in it, or fewer than are
/// asked for.
pub(super) fn plan(ffmpeg: &Program, video: &Path, wanted: FrameCount) -> Result<FramePlan> {
    open(video, |_| String::new())?;
    let counted = count(ffmpeg, video)?;
    let total = counted.frames;
    let problem = |problem: String, help: &str| Err(Error::input(video, "", problem, help));
    let used = match wanted {
        FrameCount::Auto => (total / CANDIDATES).clamp(FEWEST as u64, USUAL),
        FrameCount::Count(frames) => u64::from(frames),
        // A stated length may be a little longer than that of the pictures.
        FrameCount::PerSecond(rate) => ((f64::from(rate) * counted.seconds).round() as u64).min(total),
    };
    if total < FEWEST as u64 {
        let frames = if total == 1 { "frame" } else { "frames" };
        return problem(
            format!("the video has {total} {frames}, and cameras need at least {FEWEST}"),
            "Give a longer video, or a folder of photographs.",
        );
    }
    if used < FEWEST as u64 {
        return problem(
            format!("{} gives {used} frames of a video of {:.1} s", words(wanted), counted.seconds),
            "Cameras need at least 3: take more with --fps, say how many with --frames, or give a longer video.",
        );
    }
    if used > total {
        return problem(
            format!("the video has {total} frames, fewer than the {used} of {}", words(wanted)),
            "Ask for fewer frames, or give a longer video.",
        );
    }
    Ok(FramePlan { total, used })
}

fn words(wanted: FrameCount) -> String {
    match wanted {
        FrameCount::Auto => "the usual choice".to_owned(),
        FrameCount::Count(frames) => format!("--frames {frames}"),
        FrameCount::PerSecond(rate) => format!("--fps {rate}"),
    }
}

/// What ffmpeg says of a video.
#[derive(Clone, Debug, Default, PartialEq)]
struct Counted {
    frames: u64,
    /// How long it lasts.
    seconds: f64,
    /// The length that the file states; a file that was never closed has none.
    stated: Option<f64>,
    /// The last line that is no progress.
    said: String,
}

impl Counted {
    fn hear(&mut self, line: &str) {
        self.stated = self.stated.or_else(|| duration(line));
        self.frames = frames_done(line).unwrap_or(self.frames);
        self.seconds = self.stated.or_else(|| position(line)).unwrap_or(self.seconds);
        if line.contains(' ') {
            line.trim().clone_into(&mut self.said);
        }
    }
}

/// Counts frames without decoding them.
fn count(ffmpeg: &Program, video: &Path) -> Result<Counted> {
    let mut words = input_words(video);
    words.extend(["-c", "copy", "-f", "null", "-"].map(OsString::from));
    // The output folder is not made for a video that cannot be used.
    let folder = tempfile::tempdir().map_err(Error::io("create a folder in", std::env::temp_dir()))?;
    let mut counted = Counted::default();
    let ran = ffmpeg.run(&words, &folder.path().join("count.log"), &mut |line| counted.hear(line));
    let reason = match ran {
        Ok(()) if counted.frames > 0 => return Ok(counted),
        Ok(()) => "it has no frames".to_owned(),
        Err(Error::Run { problem, .. }) if counted.said.is_empty() => without_log(&problem).to_owned(),
        Err(Error::Run { .. }) => counted.said,
        Err(other) => return Err(other),
    };
    let help = "Does a player show it? Copy or record it again, or give a folder of photographs.";
    Err(Error::input(video, "", format!("ffmpeg finds no video in this file: {reason}"), help))
}

/// Writes the frames of the plan, as `000001.jpg`… with gaps, into the empty folder `frames`.
///
/// # Errors
/// Those of [`Program::run`]; [`Error::Input`] if no frame can be decoded.
pub(super) fn extract(
    ffmpeg: &Program,
    video: &Path,
    plan: FramePlan,
    frames: &Path,
    log: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let bar = progress.bar("video", plan.candidates());
    ffmpeg.run(&arguments(video, plan, frames), log, &mut |line| {
        if let Some(done) = frames_done(line) {
            bar.set_position(done.min(plan.candidates()));
        }
    })?;
    bar.finish_and_clear();
    let mut files: Vec<PathBuf> = fs::read_dir(frames)
        .map_err(Error::io("read", frames))?
        .map(|entry| entry.map(|entry| entry.path()).map_err(Error::io("read", frames)))
        .collect::<Result<_>>()?;
    if files.len() < FEWEST {
        let problem = format!("only {} of its {} frames can be decoded", files.len(), plan.total);
        let help = format!("Copy or record the video again. What ffmpeg said is in {}.", log.display());
        return Err(Error::input(video, "", problem, help));
    }
    files.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    keep_sharpest(&files, plan.used as usize, progress)
}

/// The beginning of a command line: what is read and how progress is told.
fn input_words(video: &Path) -> Vec<OsString> {
    let mut words: Vec<OsString> =
        ["-hide_banner", "-nostdin", "-nostats", "-progress", "pipe:1", "-i"].map(Into::into).into();
    // A name such as `-a.mp4` or `a:b.mp4` would be an option or a protocol.
    let is_plain = video.is_absolute();
    words.push(if is_plain { video.into() } else { Path::new(".").join(video).into_os_string() });
    words.extend(["-an", "-sn", "-dn"].map(OsString::from));
    words
}

/// ffmpeg turns frames as the video says, so that they are upright.
fn arguments(video: &Path, plan: FramePlan, frames: &Path) -> Vec<OsString> {
    let (total, chosen) = (plan.total, plan.candidates());
    // JPEG files have the colors of BT.601, videos mostly those of BT.709. The frames are renumbered, so that none is written
    // twice or dropped for the sake of an even rate.
    let filter = format!(
        "select='gt(floor((n+1)*{chosen}/{total}),floor(n*{chosen}/{total}))',\
         scale=out_color_matrix=bt601:out_range=full,format=yuvj420p,settb=1/25,setpts=N"
    );
    let mut words = input_words(video);
    words.extend(["-vf".into(), filter.into()]);
    words.extend(["-r", "25", "-q:v", "1", "-qmin", "1"].map(OsString::from));
    words.push(output_pattern(frames));
    words
}

/// Numbered files in a folder, in whose path `%` and `:` mean themselves.
fn output_pattern(folder: &Path) -> OsString {
    let folder = if folder.is_absolute() { folder.to_owned() } else { Path::new(".").join(folder) };
    let folder = folder.to_str().map_or_else(|| folder.clone(), |text| text.replace('%', "%%").into());
    folder.join("%06d.jpg").into_os_string()
}

/// Seconds of `Duration: 00:01:02.50`.
fn duration(line: &str) -> Option<f64> {
    let clock = line.split_once("Duration: ")?.1.split(',').next()?;
    seconds(clock).filter(|seconds| *seconds > 0.0)
}

/// Seconds of `out_time=00:00:01.500000`.
fn position(line: &str) -> Option<f64> {
    // Before the first frame it is negative: `-00:00:00.066602`.
    let clock = line.strip_prefix("out_time=").filter(|clock| !clock.starts_with('-'))?;
    seconds(clock).filter(|seconds| *seconds > 0.0)
}

/// Frames of `frame=12`.
fn frames_done(line: &str) -> Option<u64> {
    line.strip_prefix("frame=")?.trim().parse().ok()
}

fn seconds(clock: &str) -> Option<f64> {
    let mut sum = 0.0;
    for part in clock.trim().split(':') {
        sum = 60.0 * sum + part.parse::<f64>().ok()?;
    }
    Some(sum)
}

/// Removes all but the sharpest of each of `intervals` of consecutive frames.
fn keep_sharpest(files: &[PathBuf], intervals: usize, progress: &dyn Progress) -> Result<()> {
    let intervals = intervals.min(files.len());
    let bar = progress.bar("sharpest", intervals as u64);
    (0..intervals).into_par_iter().try_for_each(|i| {
        check_interrupted()?;
        // Where frames could not be decoded, intervals have fewer candidates.
        let interval = i * files.len() / intervals..(i + 1) * files.len() / intervals;
        keep_sharpest_of(&files[interval])?;
        bar.inc(1);
        Ok(())
    })?;
    bar.finish_and_clear();
    Ok(())
}

fn keep_sharpest_of(candidates: &[PathBuf]) -> Result<()> {
    let mut scored = Vec::new();
    for path in candidates.iter().filter(|_| candidates.len() > 1) {
        scored.push((sharpness(&decode_picture(path)?.into_luma8()), path));
    }
    // A later frame replaces an earlier one only if it is sharper.
    let best = scored.iter().rev().max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, path)| *path);
    scored
        .iter()
        .filter(|(_, path)| Some(*path) != best)
        .try_for_each(|(_, path)| fs::remove_file(path).map_err(Error::io("remove", path)))
}

/// Variance of the Laplacian of the frame made smaller: motion and wrong focus lower it.
fn sharpness(frame: &GrayImage) -> f64 {
    let longer = frame.width().max(frame.height());
    if longer <= MEASURED_SIDE {
        return laplacian_variance(frame);
    }
    let scaled = |side: u32| (u64::from(side) * u64::from(MEASURED_SIDE) / u64::from(longer)).max(1) as u32;
    laplacian_variance(&thumbnail(frame, scaled(frame.width()), scaled(frame.height())))
}

fn laplacian_variance(frame: &GrayImage) -> f64 {
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
    use crate::prepare::test_data::{disc, fake_ffmpeg, script};
    use image::imageops::blur;

    fn ffmpeg(path: PathBuf) -> Program {
        Program { path, install: INSTALL }
    }

    /// What the fake says does not depend on the file.
    fn planned(ffmpeg: &Program, wanted: FrameCount) -> Result<FramePlan> {
        let folder = tempfile::tempdir().unwrap();
        let video = folder.path().join("a.mp4");
        fs::write(&video, "x").unwrap();
        plan(ffmpeg, &video, wanted)
    }

    fn refused(ffmpeg: &Program, wanted: FrameCount) -> String {
        let error = planned(ffmpeg, wanted).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        format!("{error} {}", error.help().unwrap_or_default())
    }

    #[test]
    fn a_folder_with_signs_of_ffmpeg_is_a_folder() {
        let pattern = |folder: &str| output_pattern(Path::new(folder)).into_string().unwrap();
        assert_eq!(pattern("/a/100% done"), "/a/100%% done/%06d.jpg");
        assert_eq!(pattern("a:b"), "./a:b/%06d.jpg");
    }

    #[test]
    fn output_says_how_far_it_is() {
        assert_eq!(duration("  Duration: 00:01:02.50, start: 0.0, bitrate: 9 kb/s"), Some(62.5));
        assert_eq!(duration("  Duration: N/A, start: 0.0"), None);
        assert_eq!(position("out_time=00:00:01.500000"), Some(1.5));
        assert_eq!((position("frame=3"), position("out_time=-00:00:00.066")), (None, None));
        assert_eq!((frames_done("frame=12"), frames_done("fps=12")), (Some(12), None));
    }

    #[test]
    fn frames_are_evenly_spaced_and_as_many_as_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        // A minute of 1800 frames.
        let minute = ffmpeg(fake_ffmpeg(folder.path(), 1800, "00:01:00.00"));
        let used = |wanted| planned(&minute, wanted).unwrap();
        assert_eq!(used(FrameCount::Auto), FramePlan { total: 1800, used: 150 });
        assert_eq!(used(FrameCount::Count(1800)).candidates(), 1800);
        assert_eq!(used(FrameCount::Count(700)).candidates(), 1400);
        assert_eq!(used(FrameCount::PerSecond(2.0)), FramePlan { total: 1800, used: 120 });
        assert_eq!(used(FrameCount::PerSecond(2.0)).candidates(), 480);
        let text = refused(&minute, FrameCount::Count(1801));
        assert!(text.contains("1800 frames, fewer than the 1801 of --frames 1801"), "{text}");
        let text = refused(&minute, FrameCount::PerSecond(0.02));
        assert!(text.contains("--fps 0.02 gives 1 frames of a video of 60.0 s"), "{text}");
        // A file that was never closed does not say how long it is: 1.5 s by the fake's progress.
        let short = ffmpeg(fake_ffmpeg(folder.path(), 40, "N/A"));
        assert_eq!(planned(&short, FrameCount::Auto).unwrap(), FramePlan { total: 40, used: 10 });
        assert_eq!(planned(&short, FrameCount::PerSecond(4.0)).unwrap().used, 6);
    }

    #[test]
    fn the_sharpest_frame_of_each_interval_stays() {
        let folder = tempfile::tempdir().unwrap();
        let frames = folder.path().join("frames");
        fs::create_dir(&frames).unwrap();
        // 9 candidates of 3 intervals; the third interval has none that is sharper than another.
        for i in 1..=9 {
            let sharp = disc(40, 30);
            let picture = if i == 3 || i == 5 { sharp } else { blur(&sharp, 1.5) };
            picture.save(folder.path().join(format!("{i:06}.jpg"))).unwrap();
        }
        let fake = ffmpeg(fake_ffmpeg(folder.path(), 9, "00:00:01.00"));
        let log = folder.path().join("log");
        let plan = FramePlan { total: 9, used: 3 };
        extract(&fake, Path::new("a.mp4"), plan, &frames, &log, &Silent).unwrap();
        let mut kept: Vec<_> =
            fs::read_dir(&frames).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        kept.sort();
        assert_eq!(kept, ["000003.jpg", "000005.jpg", "000007.jpg"]);
        let said = fs::read_to_string(folder.path().join("ffmpeg-calls")).unwrap();
        assert!(said.contains("gt(floor((n+1)*9/9),floor(n*9/9))") && said.contains("-i ./a.mp4"), "{said}");
    }

    #[test]
    fn noise_is_no_sharpness() {
        let sharp = image::DynamicImage::ImageRgb8(disc(2400, 1800)).into_luma8();
        let mut noisy = blur(&sharp, 12.0);
        assert!(sharpness(&noisy) < 0.5 * sharpness(&sharp));
        for (i, value) in noisy.iter_mut().enumerate() {
            *value += (((i as u32).wrapping_mul(2_654_435_761) >> 16) % 5) as u8;
        }
        assert!(laplacian_variance(&noisy) > laplacian_variance(&sharp));
        assert!(sharpness(&noisy) < sharpness(&sharp));
    }

    #[test]
    fn a_video_that_is_broken_empty_or_too_short_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let silent = ffmpeg(script(folder.path(), "silent", "exit 0"));
        assert!(refused(&silent, FrameCount::Auto).contains("no video in this file: it has no frames"));
        let failing = ffmpeg(script(folder.path(), "failing", "echo moov atom not found >&2; exit 1"));
        let text = refused(&failing, FrameCount::Auto);
        assert!(text.contains("moov atom not found") && text.contains("a.mp4"), "{text}");
        let missing = ffmpeg(folder.path().join("none"));
        assert!(refused(&missing, FrameCount::Auto).contains("apt install ffmpeg"));
        let empty = folder.path().join("empty.mp4");
        fs::write(&empty, "").unwrap();
        let error = plan(&silent, &empty, FrameCount::Auto).unwrap_err();
        assert!(error.to_string().contains("the file is empty"), "{error}");
        let still = ffmpeg(fake_ffmpeg(folder.path(), 1, "00:00:00.04"));
        assert!(refused(&still, FrameCount::Auto).contains("the video has 1 frame, and cameras need"));
    }

    #[test]
    fn frames_that_cannot_be_decoded_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let frames = folder.path().join("frames");
        fs::create_dir(&frames).unwrap();
        disc(40, 30).save(folder.path().join("000001.jpg")).unwrap();
        let fake = ffmpeg(fake_ffmpeg(folder.path(), 90, "00:00:03.00"));
        let plan = planned(&fake, FrameCount::Auto).unwrap();
        let log = folder.path().join("log");
        let error = extract(&fake, Path::new("a.mp4"), plan, &frames, &log, &Silent).unwrap_err();
        assert!(error.to_string().contains("only 1 of its 90 frames can be decoded"), "{error}");
    }

    #[test]
    fn videos_are_known_by_their_names_or_first_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.MOV");
        assert!(!is_video(&path));
        fs::write(&path, "x").unwrap();
        assert!(is_video(&path) && !is_video(folder.path()));
        let named = |name: &str, start: &[u8]| {
            fs::write(folder.path().join(name), start).unwrap();
            is_video(&folder.path().join(name))
        };
        assert!(named("clip", b"\0\0\0\x18ftypqt  \0\0\0\0"));
        assert!(named("clip.bin", b"\x1a\x45\xdf\xa3\x01\0\0\0"));
        assert!(named("clip.dat", b"RIFF\0\0\0\0AVI LIST"));
        assert!(!named("still", b"\0\0\0\x18ftypheic\0\0\0\0"));
        assert!(!named("picture", b"RIFF\0\0\0\0WEBPVP8 "));
        assert!(!named("text", b"text"));
    }
}
