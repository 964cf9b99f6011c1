//! Films of frames that are PNG files: an MP4 by the program `ffmpeg`, or a GIF where it is not
//! installed. All frames have one size.

use crate::codec::{file, png_file};
use image::{Delay, DynamicImage, ImageError, RgbImage, codecs::gif::GifEncoder, codecs::gif::Repeat};
use lobelia_geometry::{Error, Result, error::stop::check_interrupted};
use std::io::{self, ErrorKind, Write as _};
use std::process::{ChildStdin, Command, Stdio};
use std::{ffi::OsStr, fs, fs::File, path::Path, path::PathBuf};

/// The program that encodes films.
pub const FFMPEG: &str = "ffmpeg";
/// Colors in BT.709 of limited range, and said to be: players take another matrix for small
/// pictures that say nothing. Lower numbers behind `-crf`, if the encoder is x264, are better
/// pictures in larger files: 18 looks as the frames do.
const ENCODING: &str = "-vf scale=out_color_matrix=bt709:out_range=tv -pix_fmt yuv420p -c:v h264 -crf 18 \
    -color_range tv -colorspace bt709 -color_primaries bt709 -color_trc bt709 -movflags +faststart film.mp4";
/// Speed of the search for the 256 colors of each frame of a GIF, 1 to 30.
const GIF_SPEED: i32 = 10;
/// Lines of a failed program's output that its error quotes.
const QUOTED_LINES: usize = 5;

/// Writes the film of PNG files of one size, at `fps` frames per second: `stem`.mp4 (H.264), or
/// `stem`.gif, which loops forever, where no program [`FFMPEG`] is found. The result is the path of
/// the film. The bytes of an MP4 depend on the program.
///
/// # Errors
/// [`Error::Io`] if a frame cannot be read or the film cannot be written; [`Error::Run`] with the
/// last lines of its output if the program fails; [`Error::Interrupted`] after Ctrl-C.
pub fn write_film(stem: &Path, frames: &[PathBuf], fps: u32) -> Result<PathBuf> {
    write_by(FFMPEG.as_ref(), stem, frames, fps)
}

fn write_by(program: &OsStr, stem: &Path, frames: &[PathBuf], fps: u32) -> Result<PathBuf> {
    let video = stem.with_extension("mp4");
    if write_mp4(program, &video, frames, fps)? {
        return Ok(video);
    }
    let gif = stem.with_extension("gif");
    write_gif(&gif, frames, fps)?;
    Ok(gif)
}

/// Writes an MP4; `false` if there is no such program.
fn write_mp4(program: &OsStr, path: &Path, frames: &[PathBuf], fps: u32) -> Result<bool> {
    let failed = |why: String| Error::run(format!("{} of {}", program.display(), path.display()), why);
    let first = frames.first().ok_or_else(|| failed("a film needs at least one frame".into()))?;
    let size = even(&png_file::read_rgb8(first)?).dimensions();
    // The program works in a folder of its own: no path is taken for an option or a protocol.
    let folder = file::scratch_folder(file::folder_of(path))?;
    let [made, said] = ["film.mp4", "said.txt"].map(|name| folder.path().join(name));
    let log = File::create(&said).map_err(Error::io("write", &said))?;
    let mut command = Command::new(program);
    command.args("-loglevel error -f rawvideo -pix_fmt rgb24 -s".split(' '));
    command.arg(format!("{}x{}", size.0, size.1)).args(["-r", &fps.to_string(), "-i", "-"]);
    command.args(ENCODING.split_whitespace()).current_dir(folder.path());
    let mut child = match command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(log).spawn() {
        Ok(child) => child,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(false),
        Err(error) => return Err(failed(format!("it cannot be started: {error}"))),
    };
    // The program ends when it gets no more frames. One that has ended before takes none, and has
    // said why.
    let fed = child.stdin.take().map_or(Ok(true), |input| feed(input, frames));
    let status = child.wait().map_err(|error| failed(error.to_string()))?;
    check_interrupted()?;
    if !(fed? && status.success()) {
        let said = fs::read(&said).map_err(Error::io("read", &said))?;
        let said = String::from_utf8_lossy(&said);
        let lines: Vec<&str> = said.trim().lines().collect();
        let last = lines[lines.len().saturating_sub(QUOTED_LINES)..].join("\n");
        return Err(failed(format!("it failed ({status}): {last}")));
    }
    file::write_file(path, |writer| {
        let mut made = File::open(&made).map_err(Error::io("read", &made))?;
        io::copy(&mut made, writer).map(|_| ()).map_err(Error::io("write", path))
    })?;
    Ok(true)
}

/// Gives the frames to a program; `false` if it ends before it has them all.
fn feed(mut input: ChildStdin, frames: &[PathBuf]) -> Result<bool> {
    for path in frames {
        check_interrupted()?;
        if input.write_all(even(&png_file::read_rgb8(path)?).as_raw()).is_err() {
            return Ok(false);
        }
    }
    Ok(true)
}

/// A picture with even sides, as 4:2:0 needs: the last column and row are there twice.
fn even(picture: &RgbImage) -> RgbImage {
    let [w, h] = [picture.width(), picture.height()];
    RgbImage::from_fn(w + w % 2, h + h % 2, |x, y| *picture.get_pixel(x.min(w - 1), y.min(h - 1)))
}

fn write_gif(path: &Path, frames: &[PathBuf], fps: u32) -> Result<()> {
    let failed = |error: ImageError| match error {
        ImageError::IoError(source) => Error::io("write", path)(source),
        other => file::not_written(path, other),
    };
    file::write_file(path, |writer| {
        let mut encoder = GifEncoder::new_with_speed(writer, GIF_SPEED);
        encoder.set_repeat(Repeat::Infinite).map_err(failed)?;
        for (i, frame) in (0..).zip(frames) {
            check_interrupted()?;
            let picture = DynamicImage::from(png_file::read_rgb8(frame)?).into_rgba8();
            let delay = Delay::from_numer_denom_ms(10 * hundredths(i, fps), 1);
            encoder.encode_frame(image::Frame::from_parts(picture, 0, 0, delay)).map_err(failed)?;
        }
        Ok(())
    })
}

/// Duration of frame `i` in hundredths of a second, in which GIF counts, such that the first n
/// together last n / fps, rounded. Viewers slow down frames shorter than two.
fn hundredths(i: u32, fps: u32) -> u32 {
    let end_of = |frames: u32| (100.0 * f64::from(frames) / f64::from(fps)).round();
    (end_of(i + 1) - end_of(i)).max(2.0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{AnimationDecoder, Rgb, codecs::gif::GifDecoder};

    /// Frames of uneven sides in a folder.
    fn frames(folder: &Path, count: u32) -> Vec<PathBuf> {
        let pixel = |i: u32| move |x: u32, y: u32| Rgb([(x * 20) as u8, (y * 25) as u8, (i * 40) as u8]);
        let write = |i: u32| {
            let path = folder.join(format!("frames/{i:06}.png"));
            png_file::write_rgb8(&path, &RgbImage::from_fn(9, 7, pixel(i))).unwrap();
            path
        };
        (0..count).map(write).collect()
    }

    #[test]
    fn without_the_program_a_film_is_a_gif_that_loops_with_all_its_frames() {
        let folder = tempfile::tempdir().unwrap();
        let frames = frames(folder.path(), 3);
        let path = write_by("no-such-program".as_ref(), &folder.path().join("orbit"), &frames, 24).unwrap();
        assert_eq!(path, folder.path().join("orbit.gif"));
        let bytes = fs::read(&path).unwrap();
        assert!(bytes.windows(11).any(|w| w == b"NETSCAPE2.0"), "no loop");
        let read = GifDecoder::new(io::Cursor::new(&bytes)).unwrap().into_frames().collect_frames().unwrap();
        let delays: Vec<u32> = read.iter().map(|frame| frame.delay().numer_denom_ms().0).collect();
        assert_eq!(delays, [40, 40, 50], "3 frames at 24 a second last 0.125 s, to a hundredth");
        assert_eq!(hundredths(5, 100), 2, "viewers slow down shorter ones");
        for (read, made) in read.into_iter().zip(&frames) {
            let shown = DynamicImage::from(read.into_buffer()).into_rgb8();
            assert_eq!(shown, png_file::read_rgb8(made).unwrap(), "63 colors fit the palette");
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "nothing else is left");
    }

    #[test]
    fn a_program_that_fails_is_quoted_and_a_lost_frame_is_an_error_without_a_film() {
        let folder = tempfile::tempdir().unwrap();
        let (mut frames, stem) = (frames(folder.path(), 2), folder.path().join("orbit"));
        if cfg!(unix) {
            let error = write_by("false".as_ref(), &stem, &frames, 10).unwrap_err().to_string();
            assert!(error.contains("it failed (exit status: 1)"), "{error}");
        }
        frames.push(folder.path().join("frames/lost.png"));
        assert!(write_by("no-such-program".as_ref(), &stem, &frames, 10).is_err());
        assert!(write_film(&stem, &[], 10).is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "the frames alone are left");
    }

    #[test]
    fn a_video_has_its_frames_in_their_colors() {
        let folder = tempfile::tempdir().unwrap();
        let frames = frames(folder.path(), 3);
        let path = write_film(&folder.path().join("orbit"), &frames, 24).unwrap();
        if path.extension() != Some("mp4".as_ref()) {
            println!("skipped: ffmpeg is not installed");
            return;
        }
        let back = folder.path().join("back%d.png");
        let status = Command::new(FFMPEG).args(["-loglevel", "error", "-i"]).arg(&path).arg(back).status();
        assert!(status.unwrap().success());
        for (i, made) in (1..).zip(&frames) {
            let (read, made) = (
                png_file::read_rgb8(&folder.path().join(format!("back{i}.png"))).unwrap(),
                even(&png_file::read_rgb8(made).unwrap()),
            );
            assert_eq!(read.dimensions(), (10, 8));
            let off: u32 = read.iter().zip(made.iter()).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
            assert!(off < 12 * made.len() as u32, "frame {i}: {off}");
        }
        assert!(!folder.path().join("back4.png").exists());
    }
}
