//! From photographs, or a video, to a data set: cameras by COLMAP, masks, and a scene file to begin
//! with.

mod colmap;
mod masks;
mod photographs;
pub mod scene_file;
#[cfg(unix)]
#[cfg(test)]
mod tests;
mod video;
mod work;

pub use masks::MaskSource;

use crate::progress::Progress;
use colmap::Reconstruction;
use lobelia_geometry::error::{Error, Result};
use lobelia_io::{codec::file::lies_in, codec::file::write_bytes, dataset::Layout};
use photographs::FEWEST;
use std::{fmt, path::PathBuf};
use video::Video;
use work::Work;

/// Names in a message before "and so many more".
const NAMED: usize = 10;

/// Which pairs of photographs are matched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Matching {
    /// All pairs, or neighbors only for videos and very many photographs.
    #[default]
    Auto,
    /// All pairs.
    Exhaustive,
    /// Each with those next to it by name.
    Sequential,
}

/// How many frames of a video are used, evenly spaced.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum FrameCount {
    /// 150, or of a short video a quarter of its frames.
    #[default]
    Auto,
    /// This many, 3 or more.
    Count(u32),
    /// This many per second, above 0 and at most 60.
    PerSecond(f32),
}

/// Photographs and how they are prepared.
#[derive(Clone, Debug, PartialEq)]
pub struct PrepareOptions {
    /// A folder of JPEG and PNG photographs, or a video.
    pub photographs: PathBuf,
    /// The folder of the data set; new, empty, or begun before.
    pub out: PathBuf,
    /// Where masks come from.
    pub masks: MaskSource,
    /// Whether cameras are found by the object alone, where there are masks: it turns before a
    /// camera that stands still.
    pub object_features: bool,
    /// Which pairs of photographs are matched.
    pub matching: Matching,
    /// Whether each photograph has a camera (focal length, center and distortion) of its own; else
    /// all of the same size and EXIF focal length share one.
    pub camera_per_image: bool,
    /// COLMAP's name of the lens model, whose distortion is estimated: `SIMPLE_RADIAL`, `PINHOLE`,
    /// `OPENCV_FISHEYE`…
    pub lens: &'static str,
    /// Copy photographs as they are, with cameras that have distortion, instead of removing it.
    pub keep_distortion: bool,
    /// How many frames of a video are used.
    pub frames: FrameCount,
    /// Whether COLMAP uses the graphics card.
    pub gpu: bool,
    /// COLMAP's program: a name on the PATH, or a path.
    pub colmap: PathBuf,
    /// ffmpeg's program.
    pub ffmpeg: PathBuf,
    /// rembg's program.
    pub rembg: PathBuf,
}

impl PrepareOptions {
    /// The defaults for these photographs.
    pub fn new(photographs: impl Into<PathBuf>, out: impl Into<PathBuf>) -> Self {
        Self {
            photographs: photographs.into(),
            out: out.into(),
            masks: MaskSource::Auto,
            object_features: false,
            matching: Matching::Auto,
            camera_per_image: false,
            lens: "SIMPLE_RADIAL",
            keep_distortion: false,
            frames: FrameCount::Auto,
            gpu: false,
            colmap: "colmap".into(),
            ffmpeg: "ffmpeg".into(),
            rembg: "rembg".into(),
        }
    }

    /// Checks what can be checked without a look at the disk, and that nothing that is read lies
    /// where results go: those of work in progress are replaced.
    fn check(&self) -> Result<()> {
        let refuse = |problem: String, help: &str| Err(Error::usage(problem, help));
        match self.frames {
            FrameCount::PerSecond(rate) if !(rate > 0.0 && rate <= 60.0) => {
                return refuse(format!("{rate} frames per second"), "Give a number above 0, at most 60.");
            }
            FrameCount::Count(frames) if (frames as usize) < FEWEST => {
                let problem = format!("{frames} frames of a video, and cameras need at least {FEWEST}");
                return refuse(problem, "Give 50 or more.");
            }
            _ => {}
        }
        self.masks.check()?;
        let mut read = vec![(&self.photographs, "photographs")];
        if let MaskSource::Folder(folder) = &self.masks {
            read.push((folder, "masks"));
        }
        let Some((path, what)) = read.into_iter().find(|(path, _)| lies_in(path, &self.out)) else {
            return Ok(());
        };
        let (path, out) = (path.display(), self.out.display());
        let problem =
            format!("the {what}, {path}, are in the output folder {out}, where they could be replaced");
        refuse(problem, "Give a folder that is new or empty.")
    }
}

/// The result of [`prepare`].
#[derive(Clone, Debug, PartialEq)]
pub struct Prepared {
    /// How many photographs there were.
    pub photographs: usize,
    /// How many frames the video has of which these were taken, if it is one.
    pub video_frames: Option<u64>,
    /// The names of those whose camera was not found.
    pub left_out: Vec<String>,
    /// Mean distance in pixels between a point and its feature, if there are points.
    pub reprojection_error: Option<f64>,
    /// The scene file, if there are masks.
    pub scene: Option<PathBuf>,
}

impl fmt::Display for Prepared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(frames) = self.video_frames {
            writeln!(f, "{} of {frames} frames", self.photographs)?;
        }
        let registered = self.photographs - self.left_out.len();
        write!(f, "registered {registered} of {}", self.photographs)?;
        if let Some(error) = self.reprojection_error {
            write!(f, ", reprojection error {error:.2} px")?;
        }
        if self.left_out.is_empty() {
            return Ok(());
        }
        let (named, more) = self.left_out.split_at(NAMED.min(self.left_out.len()));
        write!(f, "; left out: {}", named.join(", "))?;
        if more.is_empty() { Ok(()) } else { write!(f, " and {} more", more.len()) }
    }
}

/// Makes a data set in COLMAP's layout: `images`, `masks`, `sparse/0` and `scene.ron` in
/// `options.out`.
///
/// The work lies in `.work` there until all of it is done; a run that was stopped goes on where it
/// was. Programs write into `logs`.
///
/// # Errors
/// [`Error::Usage`] if an option is out of range, the output folder has other files, or a program
/// is missing; [`Error::Input`] if photographs or masks cannot be used, or no cameras are found;
/// [`Error::Run`] with the last lines of a program that fails; [`Error::Interrupted`] after Ctrl-C.
pub fn prepare(options: &PrepareOptions, progress: &dyn Progress) -> Result<Prepared> {
    options.check()?;
    let (program, use_gpu) = colmap::find(&options.colmap)?;
    // A bad folder or video is refused before the output folder is made.
    let path = &options.photographs;
    let video = video::is_video(path).then(|| Video::plan(options)).transpose()?;
    let mut photographs = if video.is_none() { photographs::list(path, progress)? } else { Vec::new() };
    if video.is_none() && options.frames != FrameCount::Auto {
        let path = path.display();
        let problem = format!("a number of frames is that of a video, and {path} is a folder of photographs");
        return Err(Error::usage(problem, "Leave out --frames and --fps: all photographs are used."));
    }
    let mut work = Work::claim(&options.out, progress)?;
    if let Some(video) = &video {
        work.step("video", &video.settings()?, |work| video.extract(work))?;
        photographs = photographs::list(&work.path("frames"), progress)?;
    }
    work.step("photographs", &format!("{photographs:?}"), |work| {
        photographs::check_pixels(&photographs, progress)?;
        photographs::place(&photographs, &work.emptied("photographs")?)
    })?;
    let maker = MaskSource::decided(options, &photographs, progress);
    work.step("masks", &format!("{maker:?}"), |work| {
        work.emptied("masks")?;
        maker.as_ref().map_or(Ok(()), |maker| maker.write(&photographs, work))
    })?;
    let has_masks = maker.is_some();
    if has_masks && !options.object_features {
        progress.note(
            "cameras are found by the whole photographs; where the object turned before a camera that stood still, give `--features object`",
        );
    }
    let (photographs, is_video) = (photographs.as_slice(), video.is_some());
    let reconstruction = Reconstruction { options, program, use_gpu, photographs, is_video, has_masks };
    let mut prepared = reconstruction.run(&mut work)?;
    prepared.video_frames = video.map(|video| video.total);
    // Results get their names, and the scene file is written.
    if has_masks {
        work.publish("data/masks", "masks")?;
    }
    work.publish("data/images", "images")?;
    work.publish("data/sparse", "sparse/0")?;
    if has_masks {
        let scene = options.out.join("scene.ron");
        let text = scene_file::scene_for(&options.out, Layout::Auto, &scene)?;
        write_bytes(&scene, text.as_bytes())?;
        prepared.scene = Some(scene);
    }
    work.finish()?;
    Ok(prepared)
}
