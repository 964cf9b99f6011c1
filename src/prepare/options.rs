//! What is prepared and how, and what came of it.

use crate::error::{Error, Result};
use crate::prepare::colmap::{CameraSharing, LensModel};
use crate::prepare::left_out::FEWEST;
use crate::prepare::masks::MaskSource;
use std::fmt;
use std::path::PathBuf;

/// Names in a message before "and so many more".
const NAMED: usize = 10;

/// Which pairs of photographs are matched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Matching {
    /// All pairs, or neighbors only for videos and very many photographs.
    #[default]
    Auto,
    /// All pairs.
    Exhaustive,
    /// Each with those next to it by name.
    Sequential,
}

/// What of a photograph with a mask shows where its camera is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum FeatureArea {
    /// The object alone if the background is the same in all photographs, as on a turntable, or plain; else everything.
    #[default]
    Auto,
    /// The object alone.
    Object,
    /// Everything.
    All,
}

/// How many frames of a video are used, evenly spaced.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum FrameCount {
    /// 150, or of a short video a quarter of its frames.
    #[default]
    Auto,
    /// This many, 3 or more.
    Count(u32),
    /// This many per second, above 0 and at most 60.
    PerSecond(f32),
}

impl FrameCount {
    /// # Errors
    /// [`Error::Usage`] if it is out of range.
    pub(super) fn check(self) -> Result<()> {
        match self {
            Self::PerSecond(rate) if !(rate > 0.0 && rate <= 60.0) => {
                let problem = format!("{rate} frames per second");
                Err(Error::usage(problem, "Give a number above 0, at most 60."))
            }
            Self::Count(frames) if (frames as usize) < FEWEST => {
                let problem = format!("{frames} frames of a video, and cameras need at least {FEWEST}");
                Err(Error::usage(problem, "Give 50 or more."))
            }
            Self::Auto | Self::Count(_) | Self::PerSecond(_) => Ok(()),
        }
    }
}

/// What is prepared, and how; see the table of [`prepare`](crate::prepare).
#[derive(Clone, Debug, PartialEq)]
pub struct PrepareOptions {
    /// A folder of JPEG and PNG photographs, or a video.
    pub photographs: PathBuf,
    /// The folder of the data set.
    pub out: PathBuf,
    /// Where masks come from.
    pub masks: MaskSource,
    /// What of a photograph with a mask shows where its camera is.
    pub features: FeatureArea,
    /// Which pairs of photographs are matched.
    pub matching: Matching,
    /// Which photographs share focal length and distortion.
    pub cameras: CameraSharing,
    /// The distortion that is estimated.
    pub lens: LensModel,
    /// Copy photographs as they are, with cameras that have distortion, instead of removing it.
    pub keep_distortion: bool,
    /// How many frames of a video are used.
    pub frames: FrameCount,
    /// Whether COLMAP uses the graphics card.
    pub gpu: bool,
    /// COLMAP's program.
    pub colmap: PathBuf,
    /// ffmpeg's program.
    pub ffmpeg: PathBuf,
}

impl PrepareOptions {
    /// The defaults for these photographs.
    pub fn new(photographs: impl Into<PathBuf>, out: impl Into<PathBuf>) -> Self {
        Self {
            photographs: photographs.into(),
            out: out.into(),
            masks: MaskSource::default(),
            features: FeatureArea::default(),
            matching: Matching::default(),
            cameras: CameraSharing::default(),
            lens: LensModel::default(),
            keep_distortion: false,
            frames: FrameCount::default(),
            gpu: false,
            colmap: "colmap".into(),
            ffmpeg: "ffmpeg".into(),
        }
    }
}

/// What was prepared.
#[derive(Clone, Debug, PartialEq)]
pub struct Prepared {
    /// How many photographs there were.
    pub photographs: usize,
    /// How many frames the video has whose sharpest these are, if it is one.
    pub video_frames: Option<u64>,
    /// The names of those whose camera was not found.
    pub left_out: Vec<String>,
    /// Mean distance in pixels between a point and its feature, if there are points.
    pub reprojection_error: Option<f64>,
    /// The names of those that see far fewer points than the others: their cameras may be off.
    pub weak: Vec<String>,
    /// Whether there are masks.
    pub has_masks: bool,
    /// The scene file, if one could be written.
    pub scene: Option<PathBuf>,
}

impl fmt::Display for Prepared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(frames) = self.video_frames {
            let used = grouped(self.photographs as u64);
            writeln!(f, "{used} of {} frames, the sharpest of each interval", grouped(frames))?;
        }
        let registered = self.photographs - self.left_out.len();
        write!(f, "registered {registered} of {}", self.photographs)?;
        if let Some(error) = self.reprojection_error {
            write!(f, ", reprojection error {error:.2} px")?;
        }
        if !self.left_out.is_empty() {
            write!(f, "; left out: {}", names(&self.left_out))?;
        }
        if self.weak.is_empty() {
            return Ok(());
        }
        write!(f, "; few points, so that their cameras may be off: {}", names(&self.weak))
    }
}

/// The first names of a list.
fn names(all: &[String]) -> String {
    let more = all.len().saturating_sub(NAMED);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", all[..all.len().min(NAMED)].join(", "))
}

/// A number in groups of three digits.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let breaks = |(i, digit): (usize, char)| {
        let space = i > 0 && (digits.len() - i).is_multiple_of(3);
        space.then_some(' ').into_iter().chain([digit])
    };
    digits.chars().enumerate().flat_map(breaks).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_numbers_have_groups() {
        assert_eq!([7, 150, 1820, 1234567].map(grouped), ["7", "150", "1 820", "1 234 567"]);
    }
}
