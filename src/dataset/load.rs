//! Functions that all layouts share: reading JSON with errors that name the position, finding files, and loading planned views.

use crate::codec::image::{Gamma, IMAGE_EXTENSIONS, LoadedImage, Orientation, read_image, read_mask};
use crate::codec::nearby::missing_file_help;
use crate::dataset::distortion::Distortion;
use crate::dataset::straighten::Straightening;
use crate::dataset::{DatasetOptions, MaskPlan, ViewPlan};
use crate::error::{Error, Result};
use crate::view::raster::any_downscaled;
use crate::view::{Camera, Mask, Photograph, Split, ViewRecord};
use glam::Vec3;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Reads a text file, as [`Error::Input`] if it is not UTF-8.
pub(super) fn read_text(path: &Path) -> Result<String> {
    let bytes = crate::codec::file::read_bytes(path, missing_file_help)?;
    String::from_utf8(bytes)
        .map_err(|_| Error::input(path, "", "the file is not UTF-8 text", "Is it a JSON file?"))
}

/// Parses JSON; errors name line and column.
pub(super) fn parse_json<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T> {
    serde_json::from_str(text).map_err(|error| {
        let (line, column) = (error.line(), error.column());
        let message = error.to_string();
        let message = message.split(" at line ").next().unwrap_or_default();
        let line_text = text.lines().nth(line.saturating_sub(1)).unwrap_or_default();
        let near = |word: &str| column_window(line_text, column).contains(word);
        let (problem, help) = if error.is_syntax() && (near("NaN") || near("nfinity")) {
            (
                "a number is NaN or infinite, which JSON does not have".to_owned(),
                "Correct the camera: all its numbers must be finite.",
            )
        } else {
            (format!("the JSON is wrong: {message}"), "Correct the file at that place, or export it again.")
        };
        Error::input(path, format!("line {line}, column {column}"), problem, help)
    })
}

/// The text around a (1-based, byte) column.
fn column_window(line: &str, column: usize) -> String {
    let start = column.saturating_sub(3).min(line.len());
    let bytes = &line.as_bytes()[start..];
    String::from_utf8_lossy(&bytes[..bytes.len().min(12)]).into_owned()
}

fn has_image_extension(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
    extension.is_some_and(|extension| IMAGE_EXTENSIONS.contains(&extension.as_str()))
}

/// A view's name from its image's path: the file name without an image extension (`./train/r_0.5` is called `r_0.5`).
pub(super) fn view_name(path: &str) -> String {
    let path = Path::new(path);
    let name = if has_image_extension(path) { path.file_stem() } else { path.file_name() };
    name.unwrap_or_default().to_string_lossy().into_owned()
}

/// The file itself if it exists, else with an image extension added.
pub(super) fn find_image(path: &Path) -> Option<PathBuf> {
    if path.is_file() {
        return Some(path.to_owned());
    }
    IMAGE_EXTENSIONS.iter().find_map(|extension| {
        let mut name = path.as_os_str().to_owned();
        name.push(format!(".{extension}"));
        let candidate = PathBuf::from(name);
        candidate.is_file().then_some(candidate)
    })
}

/// A folder's image files by name without extension.
pub(super) struct StemIndex {
    pub folder: PathBuf,
    files: BTreeMap<String, PathBuf>,
}

impl StemIndex {
    /// `None` if there is no such folder.
    pub fn of_folder(folder: &Path) -> Result<Option<Self>> {
        if !folder.is_dir() {
            return Ok(None);
        }
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(Error::io("read", folder))? {
            paths.push(entry.map_err(Error::io("read", folder))?.path());
        }
        paths.retain(|path| has_image_extension(path));
        paths.sort();
        let mut files = BTreeMap::new();
        for path in paths {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            files.entry(stem).or_insert(path);
        }
        Ok(Some(Self { folder: folder.to_owned(), files }))
    }

    /// The file called `key`, or another image with its stem.
    pub fn find(&self, key: &str) -> Result<PathBuf> {
        let exact = Some(self.folder.join(key)).filter(|path| path.is_file());
        let found = exact.or_else(|| self.stem(&view_name(key)));
        found.ok_or_else(|| {
            let path = self.folder.join(key);
            let problem = "the camera file names this view, but its image is missing (with any extension)";
            Error::input(&path, "", problem, missing_file_help(&path))
        })
    }

    /// The image with this file stem, if there is one.
    pub fn stem(&self, stem: &str) -> Option<PathBuf> {
        self.files.get(stem).cloned()
    }

    pub fn stems(&self) -> impl Iterator<Item = &str> {
        self.files.keys().map(String::as_str)
    }
}

/// A view of a data set whose files are found and not read.
#[derive(Clone, Debug)]
pub struct PlannedView {
    plan: ViewPlan,
    split: Split,
    gamma: Gamma,
    pixel_center: f32,
    downscale: u32,
}

/// A loaded view, with what was done to it.
#[derive(Clone, Debug)]
pub struct LoadedView {
    /// The view.
    pub record: ViewRecord,
    /// Number of NaN or infinite pixels, which are set to 0.
    pub repaired: usize,
    /// Whether the background outside the mask is made black.
    pub blackened: bool,
}

impl PlannedView {
    pub(super) fn new(plan: ViewPlan, split: Split, options: &DatasetOptions) -> Self {
        let DatasetOptions { gamma, pixel_center, downscale, .. } = *options;
        Self { plan, split, gamma, pixel_center, downscale }
    }

    /// Name of the view.
    pub fn name(&self) -> &str {
        &self.plan.name
    }

    /// Which part of the data set.
    pub fn split(&self) -> Split {
        self.split
    }

    /// The file of the photograph, unless the data set has cameras only.
    pub fn image_path(&self) -> Option<&Path> {
        self.plan.image.as_deref()
    }

    /// The file of the mask, unless alpha is the mask.
    pub fn mask_path(&self) -> Option<&Path> {
        match &self.plan.mask {
            MaskPlan::File(path) => Some(path),
            MaskPlan::Alpha | MaskPlan::AlphaRequired(_) => None,
        }
    }

    /// Factor by which the view is downscaled along each axis.
    pub fn downscale(&self) -> u32 {
        self.downscale
    }

    /// The same view, downscaled by this factor along each axis instead.
    pub fn with_downscale(&self, downscale: u32) -> Self {
        Self { downscale, ..self.clone() }
    }

    /// Reads photograph and mask.
    ///
    /// # Errors
    /// [`Error::Input`] that names file and place if photograph, mask or camera is unusable.
    pub fn load(&self) -> Result<LoadedView> {
        let plan = &self.plan;
        let wrong = |problem: String, help: &str| Error::input(&plan.camera_file, &plan.place, problem, help);
        let read = |path| read_image(path, self.gamma, plan.orientation);
        let mut loaded = plan.image.as_ref().map(read).transpose()?;
        let size = image_size(plan, loaded.as_ref())?;
        let lens = plan.lens.resized(size);
        let bent = lens
            .camera(size, plan.world_from_camera, self.pixel_center)
            .map_err(|problem| wrong(problem, "Correct the camera's intrinsics."))?;
        if self.downscale > size[0].min(size[1]) {
            let problem = format!("downscale: {} leaves no pixel of {}×{}", self.downscale, size[0], size[1]);
            return Err(wrong(problem, "Use a smaller `downscale`."));
        }
        let mut mask = load_mask(plan, loaded.as_ref(), &bent)?;
        let camera = straighten(lens.distortion, &bent, &mut loaded, &mut mask).map_err(|problem| {
            wrong(problem, "Undistort the photographs first, or correct the coefficients.")
        })?;
        let blackened = match (&mut loaded, &mask) {
            (Some(loaded), Some(mask)) if !loaded.is_float && loaded.alpha.is_none() => blacken(loaded, mask),
            _ => false,
        };
        let repaired = loaded.as_ref().map_or(0, |loaded| loaded.repaired);
        let record = ViewRecord {
            name: plan.name.clone(),
            split: self.split,
            camera: camera.scaled(self.downscale),
            photograph: loaded.map(|loaded| photograph(loaded, self.downscale)),
            mask: mask.map(|mask| mask.downscaled(self.downscale)),
        };
        Ok(LoadedView { record, repaired, blackened })
    }
}

/// Notes for the user about what was done to loaded views, with counts.
pub fn load_notes(loaded: &[LoadedView]) -> Vec<String> {
    let mut notes = Vec::new();
    let broken: Vec<String> = loaded
        .iter()
        .filter(|view| view.repaired > 0)
        .map(|view| format!("{}: {}", view.record.name, view.repaired))
        .collect();
    if !broken.is_empty() {
        let total: usize = loaded.iter().map(|view| view.repaired).sum();
        let rest = broken.len().saturating_sub(5);
        let rest = if rest > 0 { format!(" and {rest} more") } else { String::new() };
        let list = broken.into_iter().take(5).collect::<Vec<_>>().join(", ");
        notes
            .push(format!("{total} NaN or infinite pixels set to 0 and left out of the loss ({list}{rest})"));
    }
    let blackened = loaded.iter().filter(|view| view.blackened).count();
    if blackened > 0 {
        notes.push(format!(
            "the background outside the mask is made black in {blackened} photographs without alpha"
        ));
    }
    notes
}

/// Resamples photograph and mask to a camera without distortion, and returns that camera.
fn straighten(
    distortion: Distortion,
    bent: &Camera,
    loaded: &mut Option<LoadedImage>,
    mask: &mut Option<Mask>,
) -> Result<Camera, String> {
    if distortion == Distortion::NONE {
        return Ok(*bent);
    }
    let way = Straightening::new(distortion, bent)?;
    if let Some(loaded) = loaded {
        loaded.image = way.image(&loaded.image);
        loaded.saturated = way.flags(&loaded.saturated);
    }
    *mask = mask.as_ref().map(|mask| way.mask(mask));
    Ok(way.camera)
}

fn photograph(loaded: LoadedImage, downscale: u32) -> Photograph {
    if downscale == 1 {
        return Photograph { image: loaded.image, saturated: loaded.saturated };
    }
    let saturated = any_downscaled(&loaded.saturated, loaded.image.width, loaded.image.height, downscale);
    Photograph { image: loaded.image.downscaled(downscale), saturated }
}

const TURN_HELP: &str = "Images of this layout are taken as stored. Turn their pixels and drop the orientation, e.g. with \
                         `mogrify -auto-orient`.";
const KEEP_HELP: &str =
    "Images of this layout are turned upright. Remove their orientation, e.g. with `exiftool -Orientation=`.";

/// Width and height from the image and the camera file, which must be equal if both state them.
fn image_size(plan: &ViewPlan, loaded: Option<&LoadedImage>) -> Result<[u32; 2]> {
    let of_image = loaded.map(|loaded| [loaded.image.width, loaded.image.height]);
    match (of_image, of_image.map_or(plan.lens.size, |size| plan.lens.resized(size).size)) {
        (Some(image), Some(camera)) if image != camera => {
            let path = plan.image.as_ref().unwrap_or(&plan.camera_file);
            let file = plan.camera_file.display();
            let (problem, help) = match (turned(plan, image, "its camera", camera), plan.orientation) {
                (Some(problem), Orientation::AsStored) => (problem, TURN_HELP.to_owned()),
                (Some(problem), Orientation::Upright) => (problem, KEEP_HELP.to_owned()),
                (None, _) => (
                    format!(
                        "the image has {}×{} pixels, its camera {}×{}",
                        image[0], image[1], camera[0], camera[1]
                    ),
                    format!("Resize the image, or scale the intrinsics at {} in {file}.", plan.place),
                ),
            };
            Err(Error::input(path, "", problem, help))
        }
        (Some(size), _) | (None, Some(size)) => Ok(size),
        (None, None) => Err(Error::input(
            &plan.camera_file,
            &plan.place,
            "there is neither an image nor its size",
            "Add w and h (in pixels), or the images.",
        )),
    }
}

/// What is wrong if the EXIF orientation of the view's image explains why `other`, of size `whose`, has not its size.
fn turned(plan: &ViewPlan, image: [u32; 2], other: &str, whose: [u32; 2]) -> Option<String> {
    let path = plan.image.as_ref().filter(|_| whose == [image[1], image[0]])?;
    let (unread, stored, upright) = match plan.orientation {
        Orientation::AsStored => (Orientation::Upright, image, whose),
        Orientation::Upright => (Orientation::AsStored, whose, image),
    };
    let seen = read_image(path, Gamma::Linear, unread).ok()?.image;
    ([seen.width, seen.height] == whose).then(|| {
        format!(
            "the image is {}×{} as stored and {}×{} as its EXIF orientation shows it; {other} is {}×{}",
            stored[0], stored[1], upright[0], upright[1], whose[0], whose[1]
        )
    })
}

fn load_mask(plan: &ViewPlan, loaded: Option<&LoadedImage>, camera: &Camera) -> Result<Option<Mask>> {
    let alpha = loaded.and_then(|loaded| loaded.alpha.clone());
    let (mask, path) = match (&plan.mask, alpha, &plan.image) {
        (MaskPlan::File(path), ..) => (read_mask(path, plan.orientation)?.mask, path),
        (_, Some(coverage), Some(path)) => {
            (Mask { width: camera.width, height: camera.height, coverage }, path)
        }
        (MaskPlan::AlphaRequired(problem), None, Some(path)) => {
            let help = "Add a mask for every image: white where the object is, black elsewhere.";
            return Err(Error::input(path, "", problem.clone(), help));
        }
        _ => return Ok(None),
    };
    let (size, view) = ([mask.width, mask.height], [camera.width, camera.height]);
    if size != view {
        let problem = turned(plan, view, "its mask", size).unwrap_or_else(|| {
            format!("the mask has {}×{} pixels, its view {}×{}", size[0], size[1], view[0], view[1])
        });
        let help = "Resize or turn the mask, so that it fits the pixels of its image.";
        return Err(Error::input(path, "", problem, help));
    }
    if mask.coverage.iter().all(|&coverage| coverage == 0.0) {
        let problem = format!("the mask of view `{}` is empty: no pixel is covered", plan.name);
        let help = "Repair the mask, or leave the view out with `select`.";
        return Err(Error::input(path, "", problem, help));
    }
    Ok(Some(mask))
}

/// Makes a photograph black where its mask is empty, so that it is on black like all others; returns whether anything changed.
fn blacken(loaded: &mut LoadedImage, mask: &Mask) -> bool {
    let mut changed = false;
    let outside = |coverage: &f32| *coverage == 0.0;
    for (i, _) in mask.coverage.iter().enumerate().filter(|(_, coverage)| outside(coverage)) {
        changed |= loaded.image.pixels[i] != Vec3::ZERO;
        loaded.image.pixels[i] = Vec3::ZERO;
        loaded.saturated[i] = false;
    }
    changed
}
