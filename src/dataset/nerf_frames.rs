//! The frames of the camera files of NeRF's layout, and where their images are.
//!
//! A camera file that was written on another machine, or in another folder, names images that are not where it says. Where none of them is,
//! they are looked for below `DIR/images` and below `DIR`, without the folders above them.

use crate::codec::image::{IMAGE_EXTENSIONS, is_unread_name};
use crate::codec::nearby::missing_file_help;
use crate::dataset::load::{file_name, find_image, has_images, leads_away, refusal_of_unread};
use crate::dataset::names::{ImageName, check_path, portable, quoted, tails, view_name};
use crate::error::{Error, Result};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where images are looked for that are not where a file says, below the folder of the data set.
const PLACES: [&str; 2] = ["images", ""];

/// A view as the file has it, but for its intrinsics.
#[derive(Deserialize)]
pub(super) struct NerfFrame {
    pub file_path: Option<String>,
    pub mask_path: Option<String>,
    pub transform_matrix: Vec<Vec<f64>>,
}

impl NerfFrame {
    /// Brings paths into the form in which this program compares and opens them.
    pub fn make_portable(&mut self) {
        for path in [&mut self.file_path, &mut self.mask_path].into_iter().flatten() {
            *path = portable(path);
        }
    }
}

pub(super) fn place_of(index: usize, frame: &NerfFrame) -> String {
    match &frame.file_path {
        Some(path) => format!("frame {index} ({})", quoted(path)),
        None => format!("frame {index}"),
    }
}

/// Refuses paths that no file or view can have, before files are looked for.
pub(super) fn check_paths(file: &Path, frames: &[NerfFrame]) -> Result<()> {
    for (index, frame) in frames.iter().enumerate() {
        if let Some(mask) = &frame.mask_path {
            check_path(mask, file, &place_of(index, frame))?;
        }
        let Some(path) = &frame.file_path else { continue };
        if path.trim().is_empty() {
            let help = "Write the path of the frame's image, from the folder of this file on.";
            return Err(Error::input(file, format!("frame {index}"), "file_path is empty", help));
        }
        ImageName::new(path, file, &place_of(index, frame))?;
    }
    Ok(())
}

/// The folder that all images are in, below that of the camera file, if they are in several folders.
pub(super) fn common_folder(frames: &[NerfFrame]) -> Option<PathBuf> {
    let paths = || frames.iter().filter_map(|frame| Path::new(frame.file_path.as_deref()?).parent());
    let first = paths().next()?;
    if paths().all(|folder| folder == first) {
        return None;
    }
    first.ancestors().find(|above| paths().all(|folder| folder.starts_with(above))).map(Path::to_owned)
}

/// The image with this path below `folder` of `dir`, or below `dir`, with or without the folders above it.
pub(super) fn find_elsewhere(dir: &Path, folder: &str, path: &str) -> Option<PathBuf> {
    let inside = tails(path).filter(|tail| !leads_away(tail));
    let mut candidates = inside.flat_map(|tail| [dir.join(folder).join(tail), dir.join(tail)]);
    candidates.find_map(|candidate| find_image(&candidate))
}

/// The images of a camera file's frames.
pub(super) struct Images {
    /// Of every frame: either none, because the data set has cameras only, or all that are named.
    pub files: Vec<Option<PathBuf>>,
    /// Whether they are not where the frames say.
    pub are_moved: bool,
    /// What the user should know of all of them.
    pub note: Option<String>,
}

/// Finds the images of all frames.
pub(super) fn find_images(dir: &Path, file: &Path, frames: &[NerfFrame]) -> Result<Images> {
    Search { dir, file, frames }.images()
}

struct Search<'a> {
    dir: &'a Path,
    file: &'a Path,
    frames: &'a [NerfFrame],
}

impl Search<'_> {
    fn images(&self) -> Result<Images> {
        let named = |path: &str| self.dir.join(path);
        let files = self.each(|path| find_image(&named(path)));
        let has_folder =
            |path: &str| named(path).parent().is_some_and(|parent| parent != self.dir && parent.is_dir());
        if files.iter().any(Option::is_some) {
            self.check_complete(&files, named)?;
            return Ok(Images { files, are_moved: false, note: None });
        }
        if let Some(moved) = self.moved()? {
            return Ok(moved);
        }
        if self.paths().any(has_folder) {
            self.check_complete(&files, named)?;
        }
        self.refuse_other_images()?;
        let note = self.paths().next().map(|path| {
            let file = file_name(self.file);
            format!(
                "the views are cameras only: none of the images that {file} names is there, e.g. {}",
                quoted(path)
            )
        });
        Ok(Images { files, are_moved: false, note })
    }

    fn paths(&self) -> impl Iterator<Item = &str> {
        self.frames.iter().filter_map(|frame| frame.file_path.as_deref())
    }

    fn each(&self, find: impl Fn(&str) -> Option<PathBuf>) -> Vec<Option<PathBuf>> {
        self.frames.iter().map(|frame| frame.file_path.as_deref().and_then(&find)).collect()
    }

    /// The images in other folders than the file says, if there are any.
    fn moved(&self) -> Result<Option<Images>> {
        let files = self.each(|path| find_elsewhere(self.dir, PLACES[0], path));
        let Some(folder) = files.iter().flatten().next().and_then(|image| image.parent()) else {
            return Ok(None);
        };
        self.check_complete(&files, |path| folder.join(file_name(Path::new(path))))?;
        self.check_apart(&files)?;
        let note = format!(
            "the images are not where {} says, e.g. {}; files of the same names in {} are read",
            file_name(self.file),
            quoted(self.paths().next().unwrap_or_default()),
            folder.display()
        );
        Ok(Some(Images { files, are_moved: true, note: Some(note) }))
    }

    /// Refuses frames without an image; `expected` says where the image of a path should be.
    fn check_complete(&self, files: &[Option<PathBuf>], expected: impl Fn(&str) -> PathBuf) -> Result<()> {
        let mut incomplete =
            self.frames.iter().zip(files).enumerate().filter(|(_, (_, file))| file.is_none());
        let Some((index, (frame, _))) = incomplete.next() else { return Ok(()) };
        let place = place_of(index, frame);
        let Some(path) = &frame.file_path else {
            let problem = "the frame has no file_path, but others have";
            let help = "Add the path of its image, or remove the frame.";
            return Err(Error::input(self.file, place, problem, help));
        };
        let image = expected(path);
        let stem = image.file_name().unwrap_or_default().to_string_lossy();
        let is_own = image.strip_prefix(self.dir).is_ok_and(|path| !leads_away(&path.to_string_lossy()));
        let refusal = || refusal_of_unread(image.parent().unwrap_or(self.dir), Some(&stem));
        if let Some(refusal) = is_own.then(refusal).flatten() {
            return Err(refusal);
        }
        let problem = format!("the image {} ({}) is missing", image.display(), IMAGE_EXTENSIONS.join(", "));
        Err(Error::input(self.file, place, problem, missing_file_help(&image)))
    }

    /// Refuses two frames with one image, of which neither is where the file says.
    fn check_apart(&self, files: &[Option<PathBuf>]) -> Result<()> {
        let mut seen = BTreeMap::new();
        for (index, (frame, image)) in self.frames.iter().zip(files).enumerate() {
            if let Some(other) = image.as_ref().and_then(|image| seen.insert(image, index)) {
                let problem = format!(
                    "its image is not where the file says, and of that name there is only the one of {}",
                    place_of(other, &self.frames[other])
                );
                let help = "Put the images into the folders that file_path names, below that of the file.";
                return Err(Error::input(self.file, place_of(index, frame), problem, help));
            }
        }
        Ok(())
    }

    /// Refuses a folder with images of which none is named, where images are named.
    fn refuse_other_images(&self) -> Result<()> {
        let Some(path) = self.paths().next() else { return Ok(()) };
        let folders = || PLACES.iter().map(|folder| self.dir.join(folder));
        let stem = view_name(path);
        if let Some(refusal) = folders().find_map(|folder| refusal_of_unread(&folder, Some(&stem))) {
            return Err(refusal);
        }
        let Some(folder) = folders().find(|folder| has_images(folder, is_unread_name)) else { return Ok(()) };
        let problem = format!(
            "none of the images that the file names is there, e.g. {}; those in {} have other names",
            quoted(path),
            folder.display()
        );
        let help = "Give the images the names of the file, or correct each file_path. For cameras without photographs remove file_path \
                    from all frames.";
        Err(Error::input(self.file, "", problem, help))
    }
}
