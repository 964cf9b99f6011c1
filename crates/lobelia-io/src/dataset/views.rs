//! Views of a split: their files as a layout describes them, and reading photograph, mask and prior
//! maps.

use crate::codec::file::FileUse;
use crate::codec::image::{
    Decoded, Gamma, ImageHeader, ImageSamples, LoadedImage, Orientation, Repairs, decode_photograph,
    image_header, linear_image, read_mask,
};
use crate::dataset::lens::{Distortion, Lens, Straightening};
use crate::dataset::{pose::Rigid, priors::MapLookup, priors::PriorFiles};
use glam::{Affine3A, Vec3};
use lobelia_geometry::view::stored::{Curve, IntegerSamples};
use lobelia_geometry::view::{
    Camera, Mask, Photograph, PixelWindow, Placement, Split, StoredMask, ViewRecord,
};
use lobelia_geometry::{Error, Result, view::raster::any_downscaled};
use std::{path::Path, path::PathBuf, sync::Arc};

/// A view as a layout describes it, before its photograph is read.
#[derive(Clone, Debug)]
pub struct ViewPlan {
    /// File stem of the image.
    pub name: String,
    /// The file that describes the camera.
    pub camera_file: PathBuf,
    /// Where in that file.
    pub(super) place: String,
    /// The file of the photograph, unless the data set has cameras only.
    pub image: Option<PathBuf>,
    /// The file of the mask; if `None`, the image's alpha is the mask, if it has any.
    pub mask: Option<PathBuf>,
    pub(super) lens: Lens,
    /// World_from_camera.
    pub(super) pose: Rigid,
}

impl ViewPlan {
    /// The error for a camera of which something is wrong.
    pub(super) fn wrong(&self, problem: impl Into<String>, help: impl Into<String>) -> Error {
        Error::input(&self.camera_file, &self.place, problem, help)
    }

    /// Width and height from the image and the camera file, which must be equal if both state them.
    fn size(&self, header: Option<&ImageHeader>) -> Result<[u32; 2]> {
        let of_image = header.map(|header| header.size(Orientation::AsStored));
        let of_camera = of_image.map_or(self.lens.size, |size| self.lens.resized(size).size);
        let (Some(image), Some(camera)) = (of_image, of_camera) else {
            return of_image.or(of_camera).ok_or_else(|| {
                let help = "Add w and h (in pixels), or the images.";
                self.wrong("there is neither an image nor its size", help)
            });
        };
        if image == camera {
            return Ok(image);
        }
        let (problem, help) = match turned(header, "its camera", camera) {
            Some(problem) => {
                let help = "Images of this layout are taken as stored. Turn their pixels and drop the orientation, e.g. with \
                            `mogrify -auto-orient`.";
                (problem, help.to_owned())
            }
            None => {
                let [[width, height], [w, h]] = [image, camera];
                let problem = format!("the image has {width}×{height} pixels, its camera {w}×{h}");
                let (place, file) = (&self.place, self.camera_file.display());
                (problem, format!("Resize the image, or scale the intrinsics at {place} in {file}."))
            }
        };
        Err(Error::input(self.image.as_ref().unwrap_or(&self.camera_file), "", problem, help))
    }

    /// The mask, from its file or from the alpha of the photograph.
    fn mask(&self, picture: Option<&Picture>, [width, height]: [u32; 2]) -> Result<Option<Mask>> {
        let mask = match &self.mask {
            Some(path) => Some(read_mask(path, Orientation::AsStored)?),
            None => picture.and_then(Picture::alpha).map(|coverage| Mask { width, height, coverage }),
        };
        if mask.as_ref().is_some_and(|mask| mask.coverage.iter().all(|&coverage| coverage == 0.0)) {
            let problem = format!("the mask of view `{}` is empty: no pixel is covered", self.name);
            let path = self.mask.as_ref().or(self.image.as_ref()).unwrap_or(&self.camera_file);
            let help = "Repair the mask, or leave the view out with `select`.";
            return Err(Error::input(path, "", problem, help));
        }
        Ok(mask)
    }
}

/// The problem if the EXIF orientation of a view's image explains why `other`, of size `whose`, has
/// not its size.
fn turned(header: Option<&ImageHeader>, other: &str, whose: [u32; 2]) -> Option<String> {
    let header = header?;
    let ([width, height], [w, h]) = (header.size(Orientation::AsStored), whose);
    (header.size(Orientation::Upright) == whose && whose != [width, height]).then(|| {
        format!(
            "the image is {width}×{height} as stored and {w}×{h} as its EXIF orientation shows it; {other} is {w}×{h}"
        )
    })
}

/// A split of a data set before its files are read.
pub(super) struct Plan {
    pub views: Vec<ViewPlan>,
    pub notes: Vec<String>,
}

pub(super) fn split_name(split: Split) -> &'static str {
    if split == Split::Train { "train" } else { "test" }
}

/// A view of a data set whose files are found and not read.
#[derive(Clone, Debug)]
pub struct PlannedView {
    /// Its name and files.
    pub plan: ViewPlan,
    /// Its part of the data set.
    pub split: Split,
    pub(super) curves: Arc<Curves>,
    pub(super) pixel_center: f32,
    pub(super) downscale: u32,
    pub(super) priors: PriorFiles,
    pub(super) placement: Placement,
}

/// A loaded view, with the changes made to it.
#[derive(Clone, Debug)]
pub struct LoadedView {
    /// The view.
    pub record: ViewRecord,
    /// Repairs of a float photograph.
    pub repairs: Repairs,
    /// Whether the background outside the mask is made black.
    pub blackened: bool,
    /// The field of view in degrees that is left by undistortion, if it leaves out what the
    /// photograph shows.
    pub cropped: Option<[f64; 2]>,
}

impl PlannedView {
    /// The camera's axes (x right, y down, z forward) and position in the world.
    pub fn world_from_camera(&self) -> Affine3A {
        self.plan.pose.to_affine()
    }

    /// Photograph, mask and prior maps, as files that are read.
    pub fn pictures(&self) -> impl Iterator<Item = FileUse> {
        let photograph = self.plan.image.iter().map(|path| FileUse::new(path, "a photograph"));
        let mask = self.plan.mask.iter().map(|path| FileUse::new(path, "a mask"));
        photograph.chain(mask).chain(self.priors.uses())
    }

    /// Reads photograph and mask: first what their headers say, so that no pixel is decoded of
    /// files that do not fit.
    ///
    /// # Errors
    /// [`Error::Input`] that names file and place if photograph, mask or camera is unusable.
    pub fn load(&self) -> Result<LoadedView> {
        let (plan, downscale) = (&self.plan, self.downscale);
        let header = plan.image.as_ref().map(image_header).transpose()?;
        let size = plan.size(header.as_ref())?;
        let lens = plan.lens.resized(size);
        let bent = lens
            .camera(size, plan.pose.to_affine(), self.pixel_center)
            .map_err(|problem| plan.wrong(problem, "Correct the camera's intrinsics."))?;
        let [width, height] = size;
        if downscale > width.min(height) {
            let problem = format!("downscale: {downscale} leaves no pixel of {width}×{height}");
            return Err(plan.wrong(problem, "Use a smaller `downscale`."));
        }
        let mask_header = plan.mask.as_ref().map(image_header).transpose()?;
        let mask_size = mask_header.map(|header| header.size(Orientation::AsStored));
        if let (Some([w, h]), Some(path)) = (mask_size.filter(|mask| *mask != size), &plan.mask) {
            let problem = turned(header.as_ref(), "its mask", [w, h])
                .unwrap_or_else(|| format!("the mask has {w}×{h} pixels, its view {width}×{height}"));
            let help = "Resize or turn the mask, so that it fits the pixels of its image.";
            return Err(Error::input(path, "", problem, help));
        }
        let is_bent = lens.distortion != Distortion::NONE;
        let is_resampled = downscale > 1 || is_bent;
        let read = |path: &PathBuf| Picture::read(path, self.curves.gamma, is_resampled);
        let mut picture = plan.image.as_ref().map(read).transpose()?;
        let mut mask = plan.mask(picture.as_ref(), size)?;
        let way = is_bent.then(|| Straightening::new(lens.distortion, &bent)).transpose();
        let way = way.map_err(|problem| {
            plan.wrong(problem, "Undistort the photographs first, or correct the coefficients.")
        })?;
        if let Some(way) = &way {
            if let Some(Picture::Linear(loaded)) = &mut picture {
                loaded.image = way.image(&loaded.image);
                loaded.saturated = way.flags(&loaded.saturated);
            }
            mask = mask.map(|mask| way.mask(&mask));
        }
        let camera = way.as_ref().map_or(bent, |way| way.camera).scaled(downscale);
        let blackened = picture.as_mut().zip(mask.as_ref()).is_some_and(|(of, mask)| of.blacken(mask));
        let repairs = match &picture {
            Some(Picture::Linear(loaded)) => loaded.repairs.clone(),
            _ => Repairs::default(),
        };
        let mask = mask.map(|mask| if downscale > 1 { mask.downscaled(downscale) } else { mask });
        let keep =
            |picture: Picture| picture.keep(&camera, downscale, is_resampled, mask.as_ref(), &self.curves);
        let mut photograph = picture.map(keep).transpose()?;
        let stored = mask.as_ref().map(StoredMask::new);
        // A photograph shares the memory of the mask that it is cut out by.
        photograph.iter_mut().zip(&stored).for_each(|(photograph, mask)| photograph.share_alpha(mask));
        let lookup = MapLookup { bent: &bent, way: way.as_ref(), downscale, camera };
        let record = ViewRecord {
            photograph,
            mask: stored,
            priors: self.priors.read(&lookup, mask.as_ref())?,
            placement: self.placement,
            ..ViewRecord::of_camera(plan.name.clone(), self.split, camera)
        };
        let cropped = way.filter(|way| way.is_cropped).map(|way| way.field_degrees());
        Ok(LoadedView { record, repairs, blackened, cropped })
    }
}

/// Notes for the user about what was done to loaded views, with counts.
pub fn load_notes(loaded: &[LoadedView]) -> Vec<String> {
    const MOST_NAMED: usize = 5;
    let mut notes = Vec::new();
    let mut count = |of: fn(&Repairs) -> usize, what: &str| {
        let counts = loaded.iter().map(|view| (&view.record.name, of(&view.repairs)));
        let broken: Vec<(&String, usize)> = counts.filter(|(_, count)| *count > 0).collect();
        let total: usize = broken.iter().map(|(_, count)| count).sum();
        let list: Vec<String> =
            broken.iter().take(MOST_NAMED).map(|(name, count)| format!("{name}: {count}")).collect();
        let rest = match broken.len().saturating_sub(MOST_NAMED) {
            0 => String::new(),
            rest => format!(" and {rest} more"),
        };
        notes.extend((total > 0).then(|| format!("{total} {what} ({}{rest})", list.join(", "))));
    };
    count(|repairs| repairs.not_finite, "NaN or infinite pixels set to 0 and left out of the loss");
    count(|repairs| repairs.too_bright, "absurdly bright pixels set to 0 and left out of the loss");
    count(|repairs| repairs.negative, "negative pixels set to 0");
    let blackened = loaded.iter().filter(|view| view.blackened).count();
    notes.extend((blackened > 0).then(|| {
        format!("the background outside the mask is made black in {blackened} photographs without alpha")
    }));
    let fields: Vec<[f64; 2]> = loaded.iter().filter_map(|view| view.cropped).collect();
    notes.extend(fields.first().map(|[width, height]| {
        let count = fields.len();
        format!("{count} photographs show more than a pinhole camera can; undistorted they are cropped to {width:.0}° × {height:.0}°")
    }));
    notes
}

/// Tables from stored integers to linear light, made once for all photographs of a data set.
#[derive(Debug)]
pub(super) struct Curves {
    gamma: Gamma,
    bytes: Curve,
    words: Curve,
}

impl Curves {
    pub fn new(gamma: Gamma) -> Self {
        let [bytes, words] = [255, 65_535].map(|top| Curve::new(gamma.curve(top)));
        Self { gamma, bytes, words }
    }
}

/// A photograph that is being read.
enum Picture {
    /// Integers that become the pixels of the view one by one, as the file has them.
    Stored(Decoded),
    /// Linear light, of floats or where pixels of the view are means of several.
    Linear(LoadedImage),
}

impl Picture {
    fn read(path: &Path, gamma: Gamma, is_resampled: bool) -> Result<Self> {
        let (decoded, repairs) = decode_photograph(path, Orientation::AsStored)?;
        if is_resampled || decoded.header.is_float {
            return Ok(Self::Linear(linear_image(&decoded, repairs, gamma)));
        }
        Ok(Self::Stored(decoded))
    }

    /// Coverage in `[0, 1]`, if the file has alpha.
    fn alpha(&self) -> Option<Vec<f32>> {
        let decoded = match self {
            Self::Linear(loaded) => return loaded.alpha.clone(),
            Self::Stored(decoded) => Some(decoded).filter(|decoded| decoded.header.has_alpha())?,
        };
        let channels = decoded.header.channels;
        let alphas = || (channels - 1..decoded.samples.count()).step_by(channels);
        Some(match &decoded.samples {
            ImageSamples::Bytes8(bytes) => alphas().map(|i| f32::from(bytes[i]) / 255.0).collect(),
            ImageSamples::Words16(words) => alphas().map(|i| f32::from(words[i]) / 65_535.0).collect(),
            ImageSamples::Floats(floats) => alphas().map(|i| floats[i]).collect(),
        })
    }

    /// Makes the picture black where its mask is empty, so that it is on black like all others;
    /// returns whether anything changed.
    ///
    /// A picture with alpha is on black already. A float image is often a rendering on black, whose
    /// light at the rim reaches beyond a mask of 8 bits; that is left as it is.
    fn blacken(&mut self, mask: &Mask) -> bool {
        const RIM_SHARE: f32 = 0.05;
        match self {
            Self::Stored(decoded) if decoded.header.has_alpha() => false,
            Self::Stored(decoded) => {
                let channels = decoded.header.channels;
                match &mut decoded.samples {
                    ImageSamples::Bytes8(bytes) => blacken(bytes, channels, mask),
                    ImageSamples::Words16(words) => blacken(words, channels, mask),
                    ImageSamples::Floats(floats) => blacken(floats, channels, mask),
                }
            }
            Self::Linear(loaded) if loaded.alpha.is_some() => false,
            Self::Linear(LoadedImage { image, saturated, is_float, .. }) => {
                let outside = || (0..mask.coverage.len()).filter(|&i| mask.coverage[i] == 0.0);
                let lit = outside().filter(|&i| image.pixels[i] != Vec3::ZERO).count();
                if *is_float && lit as f32 <= RIM_SHARE * outside().count() as f32 {
                    return false;
                }
                outside().for_each(|i| (image.pixels[i], saturated[i]) = (Vec3::ZERO, false));
                lit > 0
            }
        }
    }

    /// The photograph as it is kept: cropped to its mask, and rounded to half floats if its pixels
    /// are means anyway.
    fn keep(
        self,
        camera: &Camera,
        downscale: u32,
        is_resampled: bool,
        mask: Option<&Mask>,
        curves: &Curves,
    ) -> Result<Photograph> {
        let size = [camera.width, camera.height];
        let window = mask.map_or(PixelWindow::whole(size[0], size[1]), PixelWindow::of_mask);
        match self {
            Self::Stored(decoded) => {
                let (samples, curve) = match &decoded.samples {
                    ImageSamples::Bytes8(bytes) => (IntegerSamples::Bytes(bytes), &curves.bytes),
                    ImageSamples::Words16(words) => (IntegerSamples::Words(words), &curves.words),
                    ImageSamples::Floats(_) => unreachable!("floats are read as linear light"),
                };
                Ok(Photograph::of_integers(size, samples, decoded.header.channels, curve, window))
            }
            Self::Linear(LoadedImage { mut image, mut saturated, .. }) => {
                if downscale > 1 {
                    saturated = any_downscaled(&saturated, image.width, image.height, downscale);
                    image = image.downscaled(downscale);
                }
                Photograph::new(&image, &saturated, window, is_resampled)
            }
        }
    }
}

fn blacken<T: Copy + Default + PartialEq>(samples: &mut [T], channels: usize, mask: &Mask) -> bool {
    let mut changed = false;
    let pixels = samples.chunks_exact_mut(channels).zip(&mask.coverage);
    for (pixel, _) in pixels.filter(|(_, coverage)| **coverage == 0.0) {
        changed |= pixel.iter().any(|sample| *sample != T::default());
        pixel.fill(T::default());
    }
    changed
}
