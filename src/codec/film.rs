//! The frames of a film: PNG files, so that a film is never whole in memory, and a [`Video`]. A thread of their own makes them while the next frame
//! is rendered.

use crate::codec::file;
use crate::codec::png_file;
use crate::codec::video::Video;
use crate::{Error, Result};
use image::RgbImage;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{Builder, JoinHandle};
use tempfile::TempDir;

/// Frames that wait for the one that is being written.
const WAITING: usize = 1;

/// A film whose frames are all there.
#[derive(Debug)]
pub struct Film {
    /// Where the frames lie; `None` if there is a video alone.
    folder: Option<PathBuf>,
    /// The hidden folder, which goes when this is dropped, unless frames are to stay.
    scratch: Option<TempDir>,
    size: [u32; 2],
    count: usize,
    /// Number of the first one, in the names of files.
    first: usize,
    video: Option<Video>,
    comment: Option<String>,
}

impl Film {
    /// Width and height in pixels of all frames.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// How many frames there are.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The frames in order, each read when it is its turn; none if there is a video alone.
    pub fn frames(&self) -> impl Iterator<Item = Result<RgbImage>> {
        let files = (0..self.count).filter_map(|i| self.path(i));
        files.map(|path| png_file::read_rgb8(&path))
    }

    /// What its files say about it, if anything.
    pub fn comment(&self) -> Option<&str> {
        self.comment.as_deref()
    }

    /// Takes the video out, if one was made.
    pub fn take_video(&mut self) -> Option<Video> {
        self.video.take()
    }

    /// The file of frame `i`.
    pub(crate) fn path(&self, i: usize) -> Option<PathBuf> {
        self.folder.as_ref().map(|folder| folder.join(frame_file(self.first + i)))
    }
}

/// The file of a frame in the folder of its film.
pub(crate) fn frame_file(frame: usize) -> String {
    format!("{frame:06}.png")
}

/// A film that is being made. If it is dropped before [`finish`](Self::finish), the frames that wait are written first.
#[derive(Debug)]
pub struct FilmRecorder {
    // Before the folder, which must not go while something is written into it.
    writer: Option<Writer>,
    film: Film,
    video_fps: Option<u32>,
}

impl FilmRecorder {
    /// A film without frames, whose files lie in a hidden folder in `folder` (created if missing) until the film is dropped. They are compressed
    /// fast.
    ///
    /// # Errors
    /// [`Error::Io`] if a folder cannot be created.
    pub fn new(folder: &Path) -> Result<Self> {
        let scratch = file::scratch_folder(folder)?;
        Ok(Self::of(Some(scratch.path().to_owned()), Some(scratch)))
    }

    /// A film without frames, whose files stay in `folder`: of frame 0, if that is the `first`, 000000.png and so on.
    pub fn kept(folder: PathBuf, first: usize) -> Self {
        let mut recorder = Self::of(Some(folder), None);
        recorder.film.first = first;
        recorder
    }

    /// A film without frames and without files.
    pub fn without_files() -> Self {
        Self::of(None, None)
    }

    fn of(folder: Option<PathBuf>, scratch: Option<TempDir>) -> Self {
        let film = Film { folder, scratch, size: [0; 2], count: 0, first: 0, video: None, comment: None };
        Self { writer: None, film, video_fps: None }
    }

    /// Makes a video as well, at this number of frames per second.
    #[must_use]
    pub fn with_video(mut self, fps: u32) -> Self {
        self.video_fps = Some(fps);
        self
    }

    /// Makes its files say something about it: frames ([`png_file::comment_of`]), animations and the video, as its title.
    #[must_use]
    pub fn with_comment(mut self, comment: impl Into<String>) -> Self {
        self.film.comment = Some(comment.into());
        self
    }

    /// Appends a frame. An error in writing it is told by a later call.
    ///
    /// # Errors
    /// [`Error::Run`] if it is empty or differs in size from those before; [`Error::Io`] if one before cannot be written.
    pub fn push(&mut self, frame: RgbImage) -> Result<()> {
        let film = &mut self.film;
        let (size, path) = ([frame.width(), frame.height()], film.path(film.count));
        let wrong = |problem: String| Err(Error::run("making a film", problem));
        if size.contains(&0) {
            return wrong(format!("frame {} is empty", film.count));
        }
        if film.count > 0 && size != film.size {
            return wrong(format!("frame {} and frame 0 differ in size", film.count));
        }
        (film.size, film.count) = (size, film.count + 1);
        if self.writer.is_none() {
            let comment = film.comment.clone();
            let video = self.video_fps.map(|fps| Video::new(size, fps, comment.as_deref())).transpose()?;
            self.writer = Some(Writer::start(Frames { is_fast: film.scratch.is_some(), comment, video })?);
        }
        self.writer.as_mut().map_or(Ok(()), |writer| writer.take((path, frame)))
    }

    /// The film, once all frames are written.
    ///
    /// # Errors
    /// [`Error::Io`] if one cannot be written.
    pub fn finish(mut self) -> Result<Film> {
        self.film.video = self.writer.take().map_or(Ok(None), |mut writer| writer.join())?;
        Ok(self.film)
    }
}

/// A frame and its file, if it gets one.
type Waiting = (Option<PathBuf>, RgbImage);

/// What is made of the frames.
struct Frames {
    is_fast: bool,
    comment: Option<String>,
    video: Option<Video>,
}

impl Frames {
    fn take(&mut self, (path, frame): &Waiting) -> Result<()> {
        if let Some(path) = path {
            png_file::write_film_frame(path, frame, self.is_fast, self.comment.as_deref())?;
        }
        self.video.as_mut().map_or(Ok(()), |video| video.push(frame))
    }
}

/// A thread that makes the frames until the first one that cannot be written, and then has the video.
#[derive(Debug)]
struct Writer {
    waiting: Option<SyncSender<Waiting>>,
    thread: Option<JoinHandle<Result<Option<Video>>>>,
}

impl Writer {
    fn start(mut frames: Frames) -> Result<Self> {
        let (sender, waiting) = sync_channel::<Waiting>(WAITING);
        let work = move || {
            waiting.into_iter().try_for_each(|frame| frames.take(&frame))?;
            Ok(frames.video)
        };
        let failed = |error: std::io::Error| Error::run("making a film", format!("no thread: {error}"));
        let thread = Builder::new().name("film".into()).spawn(work).map_err(failed)?;
        Ok(Self { waiting: Some(sender), thread: Some(thread) })
    }

    fn take(&mut self, frame: Waiting) -> Result<()> {
        let sent = self.waiting.as_ref().is_some_and(|waiting| waiting.send(frame).is_ok());
        if sent { Ok(()) } else { self.join().and(Err(failed_before())) }
    }

    fn join(&mut self) -> Result<Option<Video>> {
        self.waiting = None;
        let thread = self.thread.take().ok_or_else(failed_before)?;
        thread.join().unwrap_or_else(|_| Err(Error::run("making a film", "its thread has failed")))
    }
}

fn failed_before() -> Error {
    Error::run("making a film", "a frame before could not be written")
}

impl Drop for Writer {
    /// An error was told before, or its film is given up.
    fn drop(&mut self) {
        let _ = self.join();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::animation::{write_apng, write_gif};
    use crate::codec::video::{TITLE, title_of};
    use image::Rgb;

    fn frame(i: u8) -> RgbImage {
        RgbImage::from_fn(9, 7, |x, y| Rgb([(x * 20) as u8, (y * 25) as u8, 40 * i]))
    }

    #[test]
    fn frames_come_back_in_order_and_go_with_the_film() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = FilmRecorder::new(folder.path()).unwrap();
        (0..6).for_each(|i| recorder.push(frame(i)).unwrap());
        let film = recorder.finish().unwrap();
        assert_eq!((film.size(), film.count()), ([9, 7], 6));
        for (i, read) in (0..).zip(film.frames()) {
            assert_eq!(read.unwrap(), frame(i));
        }
        drop(film);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn frames_stay_if_they_are_to() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = FilmRecorder::kept(folder.path().join("frames"), 0);
        (0..2).for_each(|i| recorder.push(frame(i)).unwrap());
        drop(recorder.finish().unwrap());
        for i in 0..2 {
            let path = folder.path().join(format!("frames/{i:06}.png"));
            assert_eq!(png_file::read_rgb8(&path).unwrap(), frame(i));
            assert_eq!(png_file::comment_of(&path), None);
        }
    }

    #[test]
    fn files_say_what_is_to_be_said() {
        let folder = tempfile::tempdir().unwrap();
        let kept = FilmRecorder::kept(folder.path().join("frames"), 0).with_video(4);
        let mut recorder = kept.with_comment("filtered");
        (0..2).for_each(|i| recorder.push(frame(i)).unwrap());
        let mut film = recorder.finish().unwrap();
        let path = |name: &str| folder.path().join(name);
        assert_eq!(png_file::comment_of(path("frames/000001.png")).as_deref(), Some("filtered"));
        film.take_video().unwrap().write(&path("film.mp4")).unwrap();
        assert_eq!(title_of(&path("film.mp4")).unwrap(), format!("{TITLE}: filtered"));
        write_apng(path("film.png"), &film, 4.0).unwrap();
        assert_eq!(png_file::comment_of(path("film.png")).as_deref(), Some("filtered"));
        write_gif(path("film.gif"), &film, 4.0).unwrap();
        let gif = std::fs::read(path("film.gif")).unwrap();
        assert!(gif.windows(11).any(|bytes| bytes == b"\x21\xfe\x08filtered"));
    }

    #[test]
    fn frames_of_another_size_are_refused_and_a_film_that_is_given_up_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = FilmRecorder::new(folder.path()).unwrap();
        assert!(recorder.push(RgbImage::new(0, 0)).is_err());
        (0..2).for_each(|i| recorder.push(frame(i)).unwrap());
        let error = recorder.push(RgbImage::new(3, 3)).unwrap_err();
        assert!(error.to_string().contains("frame 2 and frame 0 differ in size"), "{error}");
        drop(recorder);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn what_cannot_be_written_is_told() {
        let folder = tempfile::tempdir().unwrap();
        // A file where the folder should be.
        let path = folder.path().join("frames");
        std::fs::write(&path, "x").unwrap();
        let mut recorder = FilmRecorder::kept(path, 0);
        let told = (0..8).try_for_each(|i| recorder.push(frame(i))).and_then(|()| recorder.finish());
        assert!(told.unwrap_err().to_string().contains("frames"));
    }
}
