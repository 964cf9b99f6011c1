//! Animations that loop forever: GIF and APNG.

use crate::codec::file;
use crate::codec::film::Film;
use crate::codec::palette::{ColorHistogram, Ditherer, Palette};
use crate::codec::png_file;
use crate::codec::video::video_bytes;
use crate::{Error, Result};
use png::{BitDepth, ColorType, Compression, Encoder, SrgbRenderingIntent};
use std::path::Path;

/// Peak memory in bytes of a film of so many frames of this width and height, beside that of rendering: its video, and the frames that wait to be
/// written, or one frame, its numbers of colors or its filtered copy, and what it is compressed to.
pub fn film_bytes(size: [u32; 2], frames: u32) -> u64 {
    12 * u64::from(size[0]) * u64::from(size[1]) + video_bytes(size, frames)
}

/// Writes a GIF that loops forever, with one palette of 256 colors for all frames and a dither that is constant over time.
///
/// `fps` is in frames per second. GIF counts in hundredths of a second; delays are rounded so that the whole animation keeps its
/// length. Viewers slow down frames shorter than 0.02 s, so that `fps` above 50 plays at 50.
///
/// # Errors
/// [`Error::Run`] for no frames, sides over 65 535 pixels, or an `fps` that is not positive; [`Error::Io`] if the file cannot be
/// written.
pub fn write_gif(path: impl AsRef<Path>, film: &Film, fps: f32) -> Result<()> {
    let path = path.as_ref();
    check(path, film, fps)?;
    let sides = film.size().map(u16::try_from);
    let [Ok(width), Ok(height)] = sides else {
        return Err(failure(path, "the sides of a GIF are at most 65535 pixels"));
    };
    let mut colors = ColorHistogram::default();
    film.frames().try_for_each(|frame| frame.map(|frame| colors.add(&frame)))?;
    let palette = Palette::of(&colors, 256);
    let mut ditherer = Ditherer::new(&palette);
    let failed = |error: gif::EncodingError| match error {
        gif::EncodingError::Io(source) => Error::io("write", path)(source),
        other => failure(path, other.to_string()),
    };
    file::write_file(path, |writer| {
        let mut encoder =
            gif::Encoder::new(writer, width, height, palette.colors.as_flattened()).map_err(failed)?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(failed)?;
        if let Some(comment) = film.comment() {
            let kind = gif::Extension::Comment.into();
            encoder.write_raw_extension(kind, &[comment.as_bytes()]).map_err(failed)?;
        }
        for (i, frame) in film.frames().enumerate() {
            let buffer = ditherer.dithered(&frame?).into();
            let delay = hundredths(i, fps) as u16;
            let frame = gif::Frame { width, height, delay, buffer, ..gif::Frame::default() };
            encoder.write_frame(&frame).map_err(failed)?;
        }
        // This ends the file.
        encoder.into_inner().map(|_| ()).map_err(failed)
    })
}

/// Duration of frame `i` in hundredths of a second, such that the first n together last n / fps, rounded.
fn hundredths(i: usize, fps: f32) -> u32 {
    let end_of = |frames: usize| (100.0 * frames as f64 / f64::from(fps)).round();
    (end_of(i + 1) - end_of(i)).clamp(2.0, 65_535.0) as u32
}

/// Writes an animated PNG that loops forever, in full color.
///
/// # Errors
/// Those of [`write_gif`], without the limit on the sides.
pub fn write_apng(path: impl AsRef<Path>, film: &Film, fps: f32) -> Result<()> {
    let path = path.as_ref();
    check(path, film, fps)?;
    let failed = |error| png_file::failed(path, error);
    let (numerator, denominator) = delay_ratio(fps);
    file::write_file(path, |writer| {
        let mut encoder = Encoder::new(writer, film.size()[0], film.size()[1]);
        encoder.set_color(ColorType::Rgb);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_compression(Compression::Balanced);
        encoder.set_source_srgb(SrgbRenderingIntent::Perceptual);
        if let Some(comment) = film.comment() {
            encoder.add_text_chunk(png_file::COMMENT.to_owned(), comment.to_owned()).map_err(failed)?;
        }
        encoder.set_animated(film.count() as u32, 0).map_err(failed)?;
        encoder.set_frame_delay(numerator, denominator).map_err(failed)?;
        let mut animation = encoder.write_header().map_err(failed)?;
        for frame in film.frames() {
            animation.write_image_data(frame?.as_raw()).map_err(failed)?;
        }
        animation.finish().map_err(failed)
    })
}

/// Seconds per frame as a fraction of 16-bit numbers, accurate to a hundredth of a frame per second.
fn delay_ratio(fps: f32) -> (u16, u16) {
    if fps < 1.0 {
        return ((100.0 / fps).round().min(65_535.0) as u16, 100);
    }
    (100, (100.0 * fps).round().min(65_535.0) as u16)
}

fn check(path: &Path, film: &Film, fps: f32) -> Result<()> {
    if !(fps.is_finite() && fps > 0.0) {
        return Err(failure(path, format!("{fps} frames per second are not possible")));
    }
    if film.count() == 0 {
        return Err(failure(path, "an animation needs at least one frame"));
    }
    Ok(())
}

fn failure(path: &Path, problem: impl Into<String>) -> Error {
    Error::run(format!("writing {}", path.display()), problem)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::film::FilmRecorder;
    use image::codecs::gif::GifDecoder;
    use image::{AnimationDecoder, Rgb, RgbImage};

    fn film(folder: &Path, frames: &[RgbImage]) -> Film {
        let mut recorder = FilmRecorder::new(folder).unwrap();
        frames.iter().for_each(|frame| recorder.push(frame.clone()).unwrap());
        recorder.finish().unwrap()
    }

    fn frames(count: u32) -> Vec<RgbImage> {
        let pixel = |i: u32| move |x: u32, y: u32| Rgb([(x * 20) as u8, (y * 25) as u8, (i * 40) as u8]);
        (0..count).map(|i| RgbImage::from_fn(9, 7, pixel(i))).collect()
    }

    #[test]
    fn gif_keeps_colors_time_and_loops() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("orbit.gif");
        write_gif(&path, &film(folder.path(), &frames(3)), 24.0).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "the frames' files are gone");
        let bytes = std::fs::read(&path).unwrap();
        assert!(bytes.windows(11).any(|w| w == b"NETSCAPE2.0"), "no loop");
        let decoder = GifDecoder::new(std::io::Cursor::new(&bytes)).unwrap();
        let read = decoder.into_frames().collect_frames().unwrap();
        let delays: Vec<u32> = read.iter().map(|frame| frame.delay().numer_denom_ms().0).collect();
        assert_eq!(delays, [40, 40, 50], "3 frames at 24 a second last 0.125 s, to a hundredth");
        for (read, made) in read.iter().zip(frames(3)) {
            let rgb = image::DynamicImage::from(read.buffer().clone()).into_rgb8();
            assert_eq!(rgb, made, "189 colors fit the palette");
        }
    }

    #[test]
    fn apng_keeps_every_frame() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("orbit.png");
        write_apng(&path, &film(folder.path(), &frames(4)), 12.5).unwrap();
        let file = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
        let mut reader = png::Decoder::new(file).read_info().unwrap();
        let control = *reader.info().animation_control().unwrap();
        assert_eq!((control.num_frames, control.num_plays), (4, 0));
        for made in frames(4) {
            let mut buffer = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut buffer).unwrap();
            assert_eq!(buffer, made.into_raw());
            let shown = reader.info().frame_control().unwrap();
            assert_eq!((shown.delay_num, shown.delay_den), (100, 1250));
        }
    }

    #[test]
    fn delays() {
        assert_eq!((0..4).map(|i| hundredths(i, 30.0)).collect::<Vec<_>>(), [3, 4, 3, 3]);
        assert_eq!(hundredths(5, 1000.0), 2);
        assert_eq!(hundredths(0, 1e-6), 65_535);
        assert_eq!(delay_ratio(0.5), (200, 100));
        assert_eq!(delay_ratio(29.97), (100, 2997));
    }

    #[test]
    fn bad_animations_are_refused_and_leave_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("orbit.gif");
        for (count, fps) in [(0, 10.0), (2, 0.0), (2, f32::NAN)] {
            let film = film(folder.path(), &frames(count));
            assert!(write_gif(&path, &film, fps).is_err());
            assert!(write_apng(&path, &film, fps).is_err());
        }
        let wide = film(folder.path(), &[RgbImage::new(65_536, 1)]);
        let error = write_gif(&path, &wide, 10.0).unwrap_err();
        assert!(error.to_string().contains("at most 65535 pixels"), "{error}");
        drop(wide);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_frame_that_is_lost_is_an_error_and_leaves_no_film() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out/orbit.film");
        let film = film(folder.path(), &frames(3));
        std::fs::remove_file(film.path(2).unwrap()).unwrap();
        assert!(matches!(write_gif(&path, &film, 10.0), Err(Error::Io { .. })));
        assert!(matches!(write_apng(&path, &film, 10.0), Err(Error::Io { .. })));
        assert!(!path.exists());
    }
}
