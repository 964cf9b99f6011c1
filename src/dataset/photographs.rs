//! Photographs and masks of layouts whose camera files do not say where they are.

use crate::codec::file::is_there;
use crate::codec::nearby::missing_file_help;
use crate::dataset::lens::Lens;
use crate::dataset::load::{StemIndex, file_name, image_files, refusal_of_unread};
use crate::dataset::masks::{find_mask, mask_file, masks_in};
use crate::dataset::names::{ImageName, shown, view_name};
use crate::dataset::plan::{MaskPlan, ViewPlan};
use crate::dataset::pose::Rigid;
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Most photographs or masks that an error names.
const MOST_NAMED: usize = 3;

/// Bytes that a file of cameras may have beyond those that its photographs need.
const MOST_SPARE_BYTES: u64 = 1 << 20;

/// The photographs and masks of a data set.
pub(super) struct Photographs {
    folder: PathBuf,
    /// In the order of their file names.
    files: Vec<PathBuf>,
    index: StemIndex,
    masks: Option<StemIndex>,
}

impl Photographs {
    /// Those in the first of `folders` below `dir` that has any; the folder `""` is `dir` itself.
    pub fn find(dir: &Path, folders: &[&str]) -> Result<Self> {
        for folder in folders.iter().map(|name| dir.join(name)).filter(|folder| is_there(folder)) {
            let files = image_files(&folder)?;
            if let (false, Some(index)) = (files.is_empty(), StemIndex::of_folder(&folder)?) {
                let masks = masks_in(dir)?;
                return Ok(Self { folder, files, index, masks });
            }
        }
        if let Some(refusal) = folders.iter().find_map(|name| refusal_of_unread(&dir.join(name), None)) {
            return Err(refusal);
        }
        let first = dir.join(folders.first().copied().unwrap_or_default());
        let names: Vec<&str> = folders.iter().map(|name| if name.is_empty() { "." } else { *name }).collect();
        let problem = format!("there are no photographs: looked for images in {}", names.join(", "));
        Err(Error::input(dir, "", problem, missing_file_help(&first)))
    }

    /// All photographs in the order of their file names, each with its mask, for `cameras` cameras in the same order.
    ///
    /// If no mask has the name of a photograph, masks belong to photographs in the order of their names.
    pub fn in_order(&self, camera_file: &Path, cameras: usize) -> Result<Vec<(PathBuf, MaskPlan)>> {
        if self.files.len() != cameras {
            return Err(self.counts_differ(camera_file, cameras));
        }
        for file in &self.files {
            ImageName::new(&file_name(file), camera_file, "")?;
        }
        let Some(masks) = &self.masks else {
            return Ok(self.files.iter().map(|file| (file.clone(), MaskPlan::Alpha)).collect());
        };
        let found = if self.files.iter().any(|file| mask_file(masks, &file_name(file)).is_some()) {
            self.files.iter().map(|file| find_mask(masks, &file_name(file))).collect::<Result<Vec<_>>>()?
        } else {
            image_files(&masks.folder)?
        };
        if found.len() != self.files.len() {
            let (photographs, folder) = (self.files.len(), self.folder.display());
            let problem =
                format!("there are {} masks here, but {photographs} photographs in {folder}", found.len());
            let help = "Give each photograph a mask of the same name.";
            return Err(Error::input(&masks.folder, "", problem, help));
        }
        Ok(self.files.iter().cloned().zip(found.into_iter().map(MaskPlan::File)).collect())
    }

    /// The photograph called `name`, with or without extension, and its mask.
    pub fn called(&self, name: ImageName) -> Result<(PathBuf, MaskPlan)> {
        let file = self.index.find(name)?;
        let mask = match &self.masks {
            Some(masks) => MaskPlan::File(find_mask(masks, &file_name(&file))?),
            None => MaskPlan::Alpha,
        };
        Ok((file, mask))
    }

    /// A note on photographs that no view shows.
    pub fn unused(&self, views: &[ViewPlan]) -> Option<String> {
        let is_used = |stem: &str| {
            let file = self.index.stem(stem);
            views.iter().any(|view| view.image == file)
        };
        let extra = self.index.stems().filter(|stem| !is_used(stem)).count();
        note_of_unused(extra, &self.folder)
    }

    /// The most bytes that a file of these photographs' cameras may have, each of `per_camera` bytes at most: `length`, which is that of
    /// the file, is compared with it before anything is read.
    ///
    /// # Errors
    /// [`Error::Input`] that names how many cameras and photographs there are, if the file is longer.
    pub fn most_bytes(&self, camera_file: &Path, length: u64, per_camera: u64) -> Result<u64> {
        let most = MOST_SPARE_BYTES + per_camera * self.files.len() as u64;
        if length <= most {
            return Ok(most);
        }
        let problem = format!(
            "the file has room for {} cameras, but there are {} photographs in {}",
            length / per_camera,
            self.files.len(),
            self.folder.display()
        );
        let help =
            "Check that it is the right file: cameras belong to photographs in the order of their names.";
        Err(Error::input(camera_file, "", problem, help))
    }

    /// The error for cameras and photographs that belong together by their order, but differ in number.
    fn counts_differ(&self, camera_file: &Path, cameras: usize) -> Error {
        let problem = format!(
            "there are {cameras} cameras, but {} photographs in {}",
            self.files.len(),
            self.folder.display()
        );
        let order = "Cameras belong to photographs in the order of their names";
        let help = match self.suspects(cameras) {
            Some(suspects) => format!("{order}. {suspects}."),
            None => format!("{order}: add what is missing, or remove what has no camera."),
        };
        Error::input(camera_file, "", problem, help)
    }

    /// Which photographs are missing or have no camera, as far as masks and numbers in names tell.
    fn suspects(&self, cameras: usize) -> Option<String> {
        let stems: Vec<String> = self.files.iter().map(|file| view_name(&file_name(file))).collect();
        if stems.len() > cameras {
            let masks = self.masks.as_ref()?;
            let bare = self.files.iter().filter(|file| mask_file(masks, &file_name(file)).is_none());
            let bare: Vec<String> = bare.map(|file| file_name(file)).collect();
            return (bare.len() == stems.len() - cameras)
                .then(|| format!("Without a mask: {}", named(&bare)));
        }
        let of_masks = self.masks.iter().flat_map(StemIndex::stems).map(str::to_owned);
        let lone: Vec<String> = of_masks.filter(|stem| !stems.contains(stem)).collect();
        if lone.len() == cameras - stems.len() {
            return Some(format!("With a mask and no photograph: {}", named(&lone)));
        }
        let gaps = gaps(&stems);
        (gaps.len() == cameras - stems.len()).then(|| format!("Missing in the sequence: {}", named(&gaps)))
    }
}

/// A note on so many images in a folder that no view shows.
pub(super) fn note_of_unused(extra: usize, folder: &Path) -> Option<String> {
    (extra > 0).then(|| format!("{extra} images in {} have no camera and are left out", folder.display()))
}

fn named(names: &[String]) -> String {
    let more = names.len().saturating_sub(MOST_NAMED);
    let list = names[..names.len() - more].iter().map(|name| shown(name)).collect::<Vec<_>>().join(", ");
    if more > 0 { format!("{list} and {more} more") } else { list }
}

/// Names that are missing in a sequence of names that differ by a number at the end; at most ten thousand.
fn gaps(stems: &[String]) -> Vec<String> {
    let parts: Option<Vec<(&str, u64)>> = stems
        .iter()
        .map(|stem| {
            let prefix = stem.trim_end_matches(|c: char| c.is_ascii_digit());
            Some((prefix, stem[prefix.len()..].parse().ok()?))
        })
        .collect();
    let (Some(parts), Some(first)) = (parts, stems.first()) else { return Vec::new() };
    let prefix = parts[0].0;
    let digits = first.len() - prefix.len();
    let numbers: Vec<u64> = parts.iter().map(|part| part.1).collect();
    let (low, high) = (numbers.iter().min().copied(), numbers.iter().max().copied());
    let (Some(low), Some(high)) = (low, high) else { return Vec::new() };
    if high - low > 10_000 || parts.iter().any(|part| part.0 != prefix) {
        return Vec::new();
    }
    let missing = (low..high).filter(|number| !numbers.contains(number));
    missing.map(|number| format!("{prefix}{number:0digits$}")).collect()
}

/// The view that shows a photograph.
pub(super) fn view_of(
    image: PathBuf,
    mask: MaskPlan,
    camera_file: &Path,
    place: String,
    lens: Lens,
    world_from_camera: Rigid,
) -> ViewPlan {
    ViewPlan {
        name: view_name(&file_name(&image)),
        camera_file: camera_file.to_owned(),
        place,
        image: Some(image),
        mask,
        lens,
        world_from_camera: world_from_camera.to_affine(),
        pose_error: world_from_camera.error,
    }
}
