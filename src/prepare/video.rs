//! Frames of a video, by `ffmpeg`.
//!
//! A first pass counts the frames without decoding them, so that a broken or short video is refused
//! before anything is written. A second one takes a few candidates of each of as many intervals as
//! frames are wanted, and of these ffmpeg's `thumbnail` the most typical.

use crate::prepare::photographs::{FEWEST, VIDEOS};
use crate::prepare::work::{Program, Work};
use crate::prepare::{FrameCount, PrepareOptions};
use lobelia_geometry::error::{Error, Result};
use lobelia_io::{codec::file::first_bytes, codec::file::open, codec::image::is_video_start};
use std::{ffi::OsString, path::Path, path::PathBuf, str::FromStr};

/// Help for a missing ffmpeg.
const INSTALL: &str = "Install ffmpeg (Debian and Ubuntu: `apt install ffmpeg`; macOS: `brew install ffmpeg`), name the program with \
                       `--ffmpeg PROGRAM`, or give a folder of photographs instead of the video.";
/// Most frames that are used if nothing is said.
const USUAL: u64 = 150;
/// Most candidates of an interval.
const CANDIDATES: u64 = 4;
/// Bytes that tell a format.
const START: usize = 64;

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

/// A video, and how many of its frames are used.
pub(super) struct Video {
    ffmpeg: Program,
    path: PathBuf,
    pub total: u64,
    used: u64,
}

impl Video {
    /// Counts the frames and chooses how many are used.
    pub fn plan(options: &PrepareOptions) -> Result<Self> {
        let video = &options.photographs;
        let ffmpeg = Program { path: options.ffmpeg.clone(), install: INSTALL };
        open(video, |_| String::new())?;
        // The output folder is not made for a video that cannot be used.
        let folder = tempfile::tempdir().map_err(Error::io("create a folder in", std::env::temp_dir()))?;
        let (mut total, mut microseconds, mut said) = (0, 0.0, String::new());
        let mut words = input_words(video);
        words.extend(["-c", "copy", "-f", "null", "-"].map(OsString::from));
        let counted = ffmpeg.run(&words, &folder.path().join("count.log"), |line| {
            total = number(line, "frame=").unwrap_or(total);
            // In microseconds, in spite of its name.
            microseconds = number(line, "out_time_ms=").unwrap_or(microseconds);
            if line.contains(' ') {
                line.trim().clone_into(&mut said);
            }
        });
        let wrong = |problem: String, help: &str| Err(Error::input(video, "", problem, help));
        match counted {
            Ok(()) if total > 0 => {}
            Ok(()) | Err(Error::Run { .. }) => {
                let reason = if counted.is_ok() || said.is_empty() { "it has no frames" } else { &said };
                let help = "Does a player show it? Copy or record it again, or give a folder of photographs.";
                return wrong(format!("ffmpeg finds no video in this file: {reason}"), help);
            }
            Err(other) => return Err(other),
        }
        let fewest = FEWEST as u64;
        let used = match options.frames {
            FrameCount::Auto => (total / CANDIDATES).clamp(fewest, USUAL),
            FrameCount::Count(frames) => u64::from(frames),
            FrameCount::PerSecond(rate) => ((f64::from(rate) * microseconds / 1e6).round() as u64).min(total),
        };
        if used < fewest || used > total {
            let problem = format!("{used} frames cannot be taken of the {total} of this video");
            let help = "Cameras need at least 3: give another --frames or --fps, or a longer video.";
            return wrong(problem, help);
        }
        Ok(Self { ffmpeg, path: video.clone(), total, used })
    }

    /// What the frames depend on.
    pub fn settings(&self) -> Result<String> {
        let bytes = self.path.metadata().map_err(Error::io("read", &self.path))?.len();
        Ok(format!("{:?} {bytes} bytes, {} of {} frames", self.path, self.used, self.total))
    }

    /// Writes the frames, as `000001.jpg`…, into the folder `frames`. They are upright: ffmpeg
    /// turns them as the video says.
    pub fn extract(&self, work: &Work) -> Result<()> {
        let Self { ffmpeg, path, total, used } = self;
        let frames = work.emptied("frames")?;
        let candidates = (total / used).clamp(1, CANDIDATES);
        let chosen = used * candidates;
        // JPEG files have the colors of BT.601, videos mostly those of BT.709. The frames are
        // renumbered, so that none is written twice or dropped for the sake of an even rate.
        let filter = format!(
            "select='gt(floor((n+1)*{chosen}/{total}),floor(n*{chosen}/{total}))',thumbnail=n={candidates},\
             scale=out_color_matrix=bt601:out_range=full,format=yuvj420p,settb=1/25,setpts=N"
        );
        let mut words = input_words(path);
        words.extend(["-vf".into(), filter.into()]);
        words.extend(["-r", "25", "-q:v", "1", "-qmin", "1"].map(OsString::from));
        // Numbered files; `%` and `:` in the folder's path mean themselves.
        let folder = if frames.is_absolute() { frames } else { Path::new(".").join(frames) };
        let folder = folder.to_str().map_or_else(|| folder.clone(), |text| text.replace('%', "%%").into());
        words.push(folder.join("%06d.jpg").into_os_string());
        let done = |line: &str| Some(number::<u64>(line, "frame=")?.min(*used));
        work.run("video", ffmpeg, &words, *used, done)
    }
}

/// The beginning of a command line: the video, and how progress is told.
fn input_words(video: &Path) -> Vec<OsString> {
    let mut words: Vec<OsString> =
        ["-hide_banner", "-nostdin", "-nostats", "-progress", "pipe:1", "-i"].map(Into::into).into();
    // A name such as `-a.mp4` or `a:b.mp4` would be an option or a protocol.
    words.push(if video.is_absolute() { video.into() } else { Path::new(".").join(video).into_os_string() });
    words.extend(["-an", "-sn", "-dn"].map(OsString::from));
    words
}

/// The number of a line of progress, such as `frame=12`.
fn number<T: FromStr>(line: &str, name: &str) -> Option<T> {
    line.strip_prefix(name)?.trim().parse().ok()
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::{prepare::tests::fake_ffmpeg, prepare::tests::script, progress::Silent};
    use std::fs;

    fn planned(ffmpeg: PathBuf, frames: FrameCount) -> Result<Video> {
        let folder = tempfile::tempdir().unwrap();
        let video = folder.path().join("a.mp4");
        fs::write(&video, "x").unwrap();
        Video::plan(&PrepareOptions { frames, ffmpeg, ..PrepareOptions::new(video, "") })
    }

    #[test]
    fn frames_are_evenly_spaced_and_as_many_as_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        // A minute of 1800 frames.
        let minute = || fake_ffmpeg(folder.path(), 1800, 60);
        for (wanted, used) in [
            (FrameCount::Auto, 150),
            (FrameCount::Count(1800), 1800),
            (FrameCount::PerSecond(2.0), 120),
            (FrameCount::PerSecond(60.0), 1800),
        ] {
            let video = planned(minute(), wanted).unwrap();
            assert_eq!((video.total, video.used), (1800, used), "{wanted:?}");
        }
        let ffmpeg = Program { path: minute(), install: INSTALL };
        let work = Work::claim(&folder.path().join("100% a:b"), &Silent).unwrap();
        Video { ffmpeg, path: "a.mp4".into(), total: 1800, used: 700 }.extract(&work).unwrap();
        let said = fs::read_to_string(folder.path().join("ffmpeg-calls")).unwrap();
        let filter = "select='gt(floor((n+1)*1400/1800),floor(n*1400/1800))',thumbnail=n=2,";
        assert!(said.contains(filter) && said.contains("-i ./a.mp4 -an"), "{said}");
        assert!(said.contains("100%% a:b/.work/frames/%06d.jpg"), "{said}");
    }

    #[test]
    fn a_video_that_cannot_be_used_is_refused() {
        let (folder, still) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let minute = fake_ffmpeg(folder.path(), 1800, 60);
        let failing = script(folder.path(), "failing", "echo moov atom not found >&2; exit 1");
        for (program, wanted, words) in [
            (minute.clone(), FrameCount::Count(1801), "1801 frames cannot be taken of the 1800"),
            (minute, FrameCount::PerSecond(0.02), "1 frames cannot be taken of the 1800"),
            (fake_ffmpeg(still.path(), 1, 0), FrameCount::Auto, "3 frames cannot be taken of the 1 of"),
            (script(folder.path(), "silent", "exit 0"), FrameCount::Auto, "it has no frames"),
            (failing, FrameCount::Auto, "moov atom not found"),
            (folder.path().join("none"), FrameCount::Auto, "apt install ffmpeg"),
        ] {
            let error = planned(program, wanted).err().unwrap();
            let text = format!("{error} {}", error.help().unwrap_or_default());
            assert!(text.contains(words) && error.exit_code() == 2, "{text}");
        }
        let empty = folder.path().join("empty.mp4");
        fs::write(&empty, "").unwrap();
        let error = Video::plan(&PrepareOptions::new(empty, "")).err().unwrap();
        assert!(error.to_string().contains("the file is empty"), "{error}");
    }

    #[test]
    fn videos_are_known_by_their_names_or_first_bytes() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!is_video(&folder.path().join("a.MOV")) && !is_video(folder.path()));
        for (name, start, is) in [
            ("a.MOV", b"x".as_slice(), true),
            ("clip", b"\0\0\0\x18ftypqt  \0\0\0\0", true),
            ("clip.bin", b"\x1a\x45\xdf\xa3\x01\0\0\0", true),
            ("clip.dat", b"RIFF\0\0\0\0AVI LIST", true),
            ("still", b"\0\0\0\x18ftypheic\0\0\0\0", false),
            ("picture", b"RIFF\0\0\0\0WEBPVP8 ", false),
            ("text", b"text", false),
        ] {
            fs::write(folder.path().join(name), start).unwrap();
            assert_eq!(is_video(&folder.path().join(name)), is, "{name}");
        }
    }
}
