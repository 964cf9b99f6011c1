//! Views whose files are known: reading their photographs, masks and prior maps.

use crate::codec::file::FileUse;
use crate::codec::image::{ImageHeader, Orientation, Repairs, image_header, read_mask};
use crate::dataset::decoded_photograph::{Curves, DecodedPhotograph};
use crate::dataset::distortion::Distortion;
use crate::dataset::options::DatasetOptions;
use crate::dataset::plan::{MaskPlan, ViewPlan};
use crate::dataset::priors::{MapLookup, PriorFiles};
use crate::dataset::straighten::Straightening;
use crate::error::{Error, Result};
use crate::view::Placement;
use crate::view::{Camera, Mask, Photograph, Split, StoredMask, ViewRecord};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A view of a data set whose files are found and not read.
#[derive(Clone, Debug)]
pub struct PlannedView {
    plan: ViewPlan,
    split: Split,
    curves: Arc<Curves>,
    pixel_center: f32,
    downscale: u32,
    priors: PriorFiles,
    placement: Placement,
}

/// A loaded view, with what was done to it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LoadedView {
    /// The view.
    pub record: ViewRecord,
    /// What was repaired in a float photograph.
    pub repairs: Repairs,
    /// Whether the background outside the mask is made black.
    pub blackened: bool,
    /// EXIF orientations of photograph and mask, 1 to 8, which are ignored; 1 where the size tells that the pixels are meant as stored.
    pub exif: [u8; 2],
}

impl PlannedView {
    /// `pixel_center` is that of the layout, which holds unless the options say otherwise.
    pub(super) fn new(
        (plan, priors): (ViewPlan, PriorFiles),
        placement: Placement,
        split: Split,
        options: &DatasetOptions,
        pixel_center: f32,
        curves: &Arc<Curves>,
    ) -> Self {
        let pixel_center = options.pixel_center.unwrap_or(pixel_center);
        let (curves, downscale) = (curves.clone(), options.downscale);
        Self { plan, split, curves, pixel_center, downscale, priors, placement }
    }

    /// Name of the view.
    pub fn name(&self) -> &str {
        &self.plan.name
    }

    /// Which part of the data set.
    pub fn split(&self) -> Split {
        self.split
    }

    /// The camera's axes (x right, y down, z forward) and position in the world.
    pub fn world_from_camera(&self) -> glam::Affine3A {
        self.plan.world_from_camera
    }

    /// The file that describes the camera.
    pub fn camera_file(&self) -> &Path {
        &self.plan.camera_file
    }

    /// The file of the photograph, unless the data set has cameras only.
    pub fn image_path(&self) -> Option<&Path> {
        self.plan.image.as_deref()
    }

    /// The file of the mask, unless alpha is the mask.
    pub fn mask_path(&self) -> Option<&Path> {
        self.plan.mask_path()
    }

    /// Photograph, mask and prior maps, as files that are read.
    pub fn pictures(&self) -> impl Iterator<Item = FileUse> {
        self.plan.pictures().chain(self.priors.uses())
    }

    /// Factor by which the view is downscaled along each axis.
    pub fn downscale(&self) -> u32 {
        self.downscale
    }

    /// Reads photograph and mask: first what their headers say, so that no pixel is decoded of files that do not fit.
    ///
    /// # Errors
    /// [`Error::Input`] that names file and place if photograph, mask or camera is unusable.
    pub fn load(&self) -> Result<LoadedView> {
        let plan = &self.plan;
        let wrong = |problem: String, help: &str| Error::input(&plan.camera_file, &plan.place, problem, help);
        let header = plan.image.as_ref().map(image_header).transpose()?;
        let size = image_size(plan, header.as_ref())?;
        let lens = plan.lens.resized(size);
        let bent = lens
            .camera(size, plan.world_from_camera, self.pixel_center)
            .map_err(|problem| wrong(problem, "Correct the camera's intrinsics."))?;
        if self.downscale > size[0].min(size[1]) {
            let problem = format!("downscale: {} leaves no pixel of {}×{}", self.downscale, size[0], size[1]);
            return Err(wrong(problem, "Use a smaller `downscale`."));
        }
        let mask_header = self.mask_path().map(image_header).transpose()?;
        check_mask_size(plan, header.as_ref(), mask_header.as_ref(), size)?;
        let is_resampled = self.downscale > 1 || plan.lens.distortion != Distortion::NONE;
        let read = |path: &PathBuf| DecodedPhotograph::read(path, self.curves.gamma(), is_resampled);
        let mut picture = plan.image.as_ref().map(read).transpose()?;
        let mut mask = load_mask(plan, picture.as_ref(), &bent)?;
        let way = straighten(lens.distortion, &bent, &mut picture, &mut mask).map_err(|problem| {
            wrong(problem, "Undistort the photographs first, or correct the coefficients.")
        })?;
        let camera = way.as_ref().map_or(bent, |way| way.camera).scaled(self.downscale);
        let blackened =
            picture.as_mut().zip(mask.as_ref()).is_some_and(|(picture, mask)| picture.blacken(mask));
        let repairs = picture.as_ref().map(|picture| picture.repairs().clone()).unwrap_or_default();
        let mask = mask.map(|mask| if self.downscale > 1 { mask.downscaled(self.downscale) } else { mask });
        let (photograph, stored) = self.kept(picture, mask.as_ref())?;
        let lookup = MapLookup { bent: &bent, way: way.as_ref(), downscale: self.downscale, camera };
        let record = ViewRecord {
            photograph,
            mask: stored,
            priors: self.priors.read(&lookup, mask.as_ref())?,
            placement: self.placement,
            ..ViewRecord::of_camera(plan.name.clone(), self.split, camera)
        };
        let exif = [header, mask_header].map(|header| header.map_or(1, |header| silent_exif(&header)));
        Ok(LoadedView { record, repairs, blackened, exif })
    }

    /// Photograph and mask as they are kept.
    fn kept(
        &self,
        picture: Option<DecodedPhotograph>,
        mask: Option<&Mask>,
    ) -> Result<(Option<Photograph>, Option<StoredMask>)> {
        let photograph = picture.map(|picture| picture.keep(self.downscale, mask, &self.curves));
        let (mut photograph, mask) = (photograph.transpose()?, mask.map(StoredMask::new));
        share_alpha(&mut photograph, mask.as_ref());
        Ok((photograph, mask))
    }
}

impl LoadedView {
    /// Lets the photograph of a view that another process has read share the tables of those that are read here, as `planned`.
    pub(crate) fn share_tables(&mut self, planned: &PlannedView) {
        if let Some(photograph) = &mut self.record.photograph
            && let Some(curve) = photograph.levels().and_then(|levels| planned.curves.of(levels))
        {
            photograph.share(curve);
        }
        share_alpha(&mut self.record.photograph, self.record.mask.as_ref());
    }
}

/// Lets a photograph share the memory of the mask that it is cut out by.
fn share_alpha(photograph: &mut Option<Photograph>, mask: Option<&StoredMask>) {
    photograph.iter_mut().zip(mask).for_each(|(photograph, mask)| photograph.share_alpha(mask));
}

/// Notes for the user about what was done to loaded views, with counts.
pub(crate) fn load_notes(loaded: &[LoadedView]) -> Vec<String> {
    let mut notes = Vec::new();
    let mut count = |of: fn(&Repairs) -> usize, what: &str| {
        let broken: Vec<(&str, usize)> = loaded
            .iter()
            .map(|view| (view.record.name.as_str(), of(&view.repairs)))
            .filter(|(_, count)| *count > 0)
            .collect();
        if !broken.is_empty() {
            let total: usize = broken.iter().map(|(_, count)| count).sum();
            let rest = broken.len().saturating_sub(5);
            let rest = if rest > 0 { format!(" and {rest} more") } else { String::new() };
            let list: Vec<String> =
                broken.iter().take(5).map(|(name, count)| format!("{name}: {count}")).collect();
            notes.push(format!("{total} {what} ({}{rest})", list.join(", ")));
        }
    };
    count(|repairs| repairs.not_finite, "NaN or infinite pixels set to 0 and left out of the loss");
    count(|repairs| repairs.too_bright, "absurdly bright pixels set to 0 and left out of the loss");
    count(|repairs| repairs.negative, "negative pixels set to 0");
    let blackened = loaded.iter().filter(|view| view.blackened).count();
    if blackened > 0 {
        notes.push(format!(
            "the background outside the mask is made black in {blackened} photographs without alpha"
        ));
    }
    notes
}

/// Resamples photograph and mask to a camera without distortion, and returns how.
fn straighten(
    distortion: Distortion,
    bent: &Camera,
    picture: &mut Option<DecodedPhotograph>,
    mask: &mut Option<Mask>,
) -> Result<Option<Straightening>, String> {
    if distortion == Distortion::NONE {
        return Ok(None);
    }
    let way = Straightening::new(distortion, bent)?;
    if let Some(picture) = picture {
        picture.straighten(&way);
    }
    *mask = mask.as_ref().map(|mask| way.mask(mask));
    Ok(Some(way))
}

const TURN_HELP: &str = "Images of this layout are taken as stored. Turn their pixels and drop the orientation, e.g. with \
                         `mogrify -auto-orient`.";

/// The EXIF orientation of a file whose size is the same with and without it; else 1.
fn silent_exif(header: &ImageHeader) -> u8 {
    if header.is_turned() && header.width != header.height { 1 } else { header.exif }
}

/// Width and height from the image and the camera file, which must be equal if both state them.
fn image_size(plan: &ViewPlan, header: Option<&ImageHeader>) -> Result<[u32; 2]> {
    let of_image = header.map(|header| header.size(Orientation::AsStored));
    match (of_image, of_image.map_or(plan.lens.size, |size| plan.lens.resized(size).size)) {
        (Some(image), Some(camera)) if image != camera => {
            let path = plan.image.as_ref().unwrap_or(&plan.camera_file);
            let file = plan.camera_file.display();
            let (problem, help) = match turned(header, "its camera", camera) {
                Some(problem) => (problem, TURN_HELP.to_owned()),
                None => (
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

/// What is wrong if the EXIF orientation of a view's image explains why `other`, of size `whose`, has not its size.
fn turned(header: Option<&ImageHeader>, other: &str, whose: [u32; 2]) -> Option<String> {
    let upright = header?.size(Orientation::Upright);
    let stored = header?.size(Orientation::AsStored);
    (upright == whose && stored != whose).then(|| {
        format!(
            "the image is {}×{} as stored and {}×{} as its EXIF orientation shows it; {other} is {}×{}",
            stored[0], stored[1], upright[0], upright[1], whose[0], whose[1]
        )
    })
}

/// Refuses a mask file that has not the size of its view.
fn check_mask_size(
    plan: &ViewPlan,
    image: Option<&ImageHeader>,
    mask: Option<&ImageHeader>,
    view: [u32; 2],
) -> Result<()> {
    let (Some(mask), MaskPlan::File(path)) = (mask, &plan.mask) else { return Ok(()) };
    let size = mask.size(Orientation::AsStored);
    if size == view {
        return Ok(());
    }
    let problem = turned(image, "its mask", size).unwrap_or_else(|| {
        format!("the mask has {}×{} pixels, its view {}×{}", size[0], size[1], view[0], view[1])
    });
    Err(Error::input(path, "", problem, "Resize or turn the mask, so that it fits the pixels of its image."))
}

fn load_mask(plan: &ViewPlan, picture: Option<&DecodedPhotograph>, camera: &Camera) -> Result<Option<Mask>> {
    let alpha = picture.and_then(DecodedPhotograph::alpha);
    let (mask, path) = match (&plan.mask, alpha, &plan.image) {
        (MaskPlan::File(path), ..) => (read_mask(path, Orientation::AsStored)?.mask, path),
        (_, Some(coverage), Some(path)) => {
            (Mask { width: camera.width, height: camera.height, coverage }, path)
        }
        (MaskPlan::AlphaRequired(problem), None, Some(path)) => {
            let help = "Add a mask for every image: white where the object is, black elsewhere.";
            return Err(Error::input(path, "", problem.clone(), help));
        }
        _ => return Ok(None),
    };
    if mask.coverage.iter().all(|&coverage| coverage == 0.0) {
        let problem = format!("the mask of view `{}` is empty: no pixel is covered", plan.name);
        let help = "Repair the mask, or leave the view out with `select`.";
        return Err(Error::input(path, "", problem, help));
    }
    Ok(Some(mask))
}
