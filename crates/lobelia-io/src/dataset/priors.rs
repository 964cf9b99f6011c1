//! Prior maps: what somebody else says of albedo or normals, one picture for a training photograph.
//!
//! A map may have another size than its photograph, in the same shape: it is looked up between its
//! pixels, through the photograph's lens as that is straightened. A pixel without coverage (alpha
//! below one half), and a normal that is none, say nothing.

use crate::codec::file::FileUse;
use crate::codec::image::{Gamma, LoadedImage, Orientation, image_header, read_image};
use crate::dataset::{files::StemIndex, lens::Straightening};
use glam::{DVec2, Vec3};
use lobelia_geometry::view::{Camera, Image, Mask, PixelWindow, PriorMap, Split, ViewPriors};
use lobelia_geometry::{Error, Result, view::raster::bilinear};
use lobelia_sg::statistics::quantile;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Lengths between which the mean of some stored normals is one.
const KNOWN_LENGTHS: std::ops::RangeInclusive<f32> = 0.5..=1.5;
/// Part of the pixels of a map of albedo that are at most 1 after it is scaled, if some are above.
const BRIGHTEST: f32 = 0.995;
/// Part by which the sides of a map may differ in shape from those of its photograph.
const SAME_SHAPE: f64 = 0.02;

/// Prior maps of the surface, as pictures of the user's own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Priors {
    /// Diffuse albedo. Default: nothing is known.
    pub albedo: Option<AlbedoPrior>,
    /// Normals. Default: nothing is known.
    pub normals: Option<NormalPrior>,
}

/// Albedo of the training photographs, such as a network estimates: where the fit of light and
/// albedo begins, and the mean color that it keeps to unless `scale` is `WhiteLight`, `MeanAlbedo`
/// or `Free`. It pays only if the maps are right: see the manual's chapter on photographs. A factor
/// on all of a picture does not matter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AlbedoPrior {
    /// The folder; must exist. A map is called as its photograph, with any image extension;
    /// photographs may be without.
    pub folder: PathBuf,
    /// How 8- and 16-bit maps are decoded (EXR and HDR are linear). Default `Srgb`.
    #[serde(default)]
    pub gamma: Gamma,
}

/// Normals of the training photographs, such as a network estimates; in integer formats as (n + 1)/2
/// without a curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NormalPrior {
    /// The folder; must exist. A map is called as its photograph, with any image extension;
    /// photographs may be without.
    pub folder: PathBuf,
    /// The axes that the normals are in. Default `Camera`.
    #[serde(default)]
    pub axes: NormalAxes,
    /// Weight ≥ 0, relative to the image loss, with which a surface that moves is held to the maps.
    /// Default 0.05.
    #[serde(default = "normal_weight")]
    pub weight: f32,
}

fn normal_weight() -> f32 {
    0.05
}

/// The axes of stored normals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum NormalAxes {
    /// The camera's, as most estimators write them: x right, y up, z from the surface toward the
    /// camera.
    #[default]
    Camera,
    /// The world's, those of the cameras' poses.
    World,
}

/// The files of the maps of a view.
#[derive(Clone, Debug, Default)]
pub(super) struct PriorFiles {
    albedo: Option<(PathBuf, Gamma)>,
    normals: Option<(PathBuf, NormalAxes)>,
}

impl PriorFiles {
    /// As files that are read.
    pub fn uses(&self) -> impl Iterator<Item = FileUse> {
        let albedo = self.albedo.iter().map(|(path, _)| path);
        albedo.chain(self.normals.iter().map(|(path, _)| path)).map(|path| FileUse::new(path, "a prior map"))
    }

    /// Reads them for a view, and keeps what its mask covers.
    ///
    /// # Errors
    /// [`Error::Input`] that names the map, if it cannot be read or does not suit its photograph.
    pub fn read(&self, lookup: &MapLookup, mask: Option<&Mask>) -> Result<ViewPriors> {
        let whole = PixelWindow::whole(lookup.camera.width, lookup.camera.height);
        let window = mask.map_or(whole, PixelWindow::of_mask);
        let keep = |image: Image| PriorMap::new(&image, window);
        let albedo = |(path, gamma): &(PathBuf, Gamma)| lookup.read_albedo(path, *gamma);
        let normals = |(path, axes): &(PathBuf, NormalAxes)| lookup.read_normals(path, *axes);
        Ok(ViewPriors {
            albedo: self.albedo.as_ref().map(albedo).transpose()?.map(keep),
            normals: self.normals.as_ref().map(normals).transpose()?.map(keep),
        })
    }
}

/// The maps of each of the views with these names, if the split is that of the training; adds notes
/// on photographs without.
///
/// # Errors
/// [`Error::Input`] if a folder has no map of any of them.
pub(super) fn find_priors(
    priors: &Priors,
    split: Split,
    views: &[&str],
    notes: &mut Vec<String>,
) -> Result<Vec<PriorFiles>> {
    let mut maps_in = |folder: &Path, what: &str| {
        let index = StemIndex::of_folder(folder)?;
        let maps: Vec<_> = views.iter().map(|view| index.as_ref()?.stem(view)).collect();
        let (there, all) = (maps.iter().flatten().count(), views.len());
        if there == 0 {
            let (first, problem) =
                (views[0], format!("none of the {all} training photographs has {what} here"));
            let help =
                format!("A map is called as its photograph, e.g. {first}.png, with any image extension.");
            return Err(Error::input(folder, "", problem, help));
        }
        if there < all {
            notes.push(format!("{there} of {all} training photographs have {what} in {}", folder.display()));
        }
        Ok(maps)
    };
    let mut found = vec![PriorFiles::default(); views.len()];
    if let (Split::Train, Some(AlbedoPrior { folder, gamma })) = (split, &priors.albedo) {
        let maps = maps_in(folder, "an albedo map")?;
        found.iter_mut().zip(maps).for_each(|(files, map)| files.albedo = map.map(|map| (map, *gamma)));
    }
    if let (Split::Train, Some(NormalPrior { folder, axes, .. })) = (split, &priors.normals) {
        let maps = maps_in(folder, "a map of normals")?;
        found.iter_mut().zip(maps).for_each(|(files, map)| files.normals = map.map(|map| (map, *axes)));
    }
    Ok(found)
}

/// Where the pixels of a view are in the picture that its photograph was made of.
pub(super) struct MapLookup<'a> {
    /// The camera of the photograph's file.
    pub bent: &'a Camera,
    /// How the photograph was straightened, if it was.
    pub way: Option<&'a Straightening>,
    /// The factor by which it was then made smaller.
    pub downscale: u32,
    /// The view's camera.
    pub camera: Camera,
}

impl MapLookup<'_> {
    /// Reads a map, and makes of each value that is known what `value` says. What is unknown is
    /// zero.
    fn read(&self, path: &Path, gamma: Gamma, value: impl Fn(Vec3) -> Vec3) -> Result<Image> {
        let loaded = read_image(path, gamma, Orientation::AsStored)?;
        self.check_shape(path, &loaded.image)?;
        let (width, height) = (self.camera.width, self.camera.height);
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let pixels = places.map(|(x, y)| self.value(&loaded, x, y).map_or(Vec3::ZERO, &value)).collect();
        Ok(Image { width, height, pixels })
    }

    /// Reads albedo; a map of values above 1 is one of another factor.
    fn read_albedo(&self, path: &Path, gamma: Gamma) -> Result<Image> {
        let mut albedo = self.read(path, gamma, |albedo| albedo.max(Vec3::ZERO))?;
        let mut brightest: Vec<f32> = albedo.pixels.iter().map(|albedo| albedo.max_element()).collect();
        brightest.retain(|brightest| *brightest > 0.0);
        // A few broken pixels do not make all others dark.
        let largest = quantile(&mut brightest, BRIGHTEST).unwrap_or(1.0).max(1.0);
        albedo.pixels.iter_mut().for_each(|albedo| *albedo = (*albedo / largest).min(Vec3::ONE));
        Ok(albedo)
    }

    fn read_normals(&self, path: &Path, axes: NormalAxes) -> Result<Image> {
        let is_float = image_header(path)?.is_float;
        let camera = &self.camera.world_from_camera.matrix3;
        let world = |stored: Vec3| {
            let stored = if is_float { stored } else { 2.0 * stored - 1.0 };
            let known = KNOWN_LENGTHS.contains(&stored.length());
            let normal = stored.normalize_or_zero() * f32::from(u8::from(known));
            let in_camera = normal * Vec3::new(1.0, -1.0, -1.0);
            if axes == NormalAxes::Camera { *camera * in_camera } else { normal }
        };
        let normals = self.read(path, Gamma::Linear, world)?;
        self.check_facing(path, axes, &normals)?;
        Ok(normals)
    }

    /// The mean of the covered pixels around the place of a pixel of the view; `None` where there
    /// is nothing.
    fn value(&self, map: &LoadedImage, x: u32, y: u32) -> Option<Vec3> {
        let scale = f64::from(self.downscale);
        let middle = |at: u32| (f64::from(at) + 0.5) * scale - 0.5;
        let straight = DVec2::new(middle(x), middle(y));
        let bent = self.way.map_or(straight, |way| way.source(straight));
        let (width, height) = (map.image.width, map.image.height);
        let along = |at: f64, from: u32, to: u32| (at + 0.5) * f64::from(to) / f64::from(from) - 0.5;
        let (x, y) = (along(bent.x, self.bent.width, width), along(bent.y, self.bent.height, height));
        let taps = bilinear(width, height, x as f32, y as f32);
        let sum: Vec3 = taps.iter().map(|tap| map.image.pixels[tap.0] * tap.1).sum();
        let coverage =
            map.alpha.as_ref().map_or(1.0, |alpha| taps.iter().map(|tap| alpha[tap.0] * tap.1).sum());
        (coverage >= 0.5 && sum.is_finite()).then(|| sum / coverage)
    }

    /// Refuses a map that cannot be of the whole photograph.
    fn check_shape(&self, path: &Path, map: &Image) -> Result<()> {
        let shape = |width: u32, height: u32| f64::from(width) / f64::from(height);
        let of_photograph = shape(self.bent.width, self.bent.height);
        if (shape(map.width, map.height) / of_photograph - 1.0).abs() <= SAME_SHAPE {
            return Ok(());
        }
        let (width, height) = (self.bent.width, self.bent.height);
        let problem = format!(
            "the map has {}×{} pixels, its photograph {width}×{height}, which is another shape",
            map.width, map.height
        );
        let help = "Give maps of whole photographs, of any size but of their shape.";
        Err(Error::input(path, "", problem, help))
    }

    /// Refuses normals of which most look away from the camera: their axes are others.
    fn check_facing(&self, path: &Path, axes: NormalAxes, normals: &Image) -> Result<()> {
        let known = || (0..).zip(&normals.pixels).filter(|(_, normal)| **normal != Vec3::ZERO);
        let is_away = |pixel, normal: &Vec3| normal.dot(self.camera.pixel_ray(pixel).direction) > 0.0;
        let (away, all) =
            (known().filter(|(pixel, normal)| is_away(*pixel, normal)).count(), known().count());
        if 2 * away <= all {
            return Ok(());
        }
        let share = 100.0 * away as f64 / all as f64;
        let problem = format!("{share:.0} % of the normals look away from the camera");
        let help = match axes {
            NormalAxes::Camera => {
                "They are taken to be in the camera's axes: x right, y up, z toward the camera. Say `axes: World` if they are in the \
                 world's, or turn their channels."
            }
            NormalAxes::World => {
                "They are taken to be in the world's axes, those of the poses. Say `axes: Camera` if they are in the camera's."
            }
        };
        Err(Error::input(path, "", problem, help))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::{temporary, write_exr};
    use crate::dataset::lens::Distortion;

    #[test]
    fn maps_go_through_the_lens_as_their_photographs_do() {
        let bent = Camera::look_at(Vec3::Z, Vec3::ZERO, Vec3::Y, 60.0, 24, 18).unwrap();
        let lens = Distortion { radial: [-0.2, 0.03, 0.0, 0.0], ..Distortion::NONE };
        let way = Straightening::new(lens, &bent).unwrap();
        let value = |i: usize| 0.1 + 0.01 * (i % 24) as f32 + 0.02 * (i / 24) as f32;
        let pixels: Vec<f32> = (0..24 * 18).map(value).collect();
        let (_folder, path) = temporary("v.exr");
        write_exr(&path, 24, 18, &["R", "G", "B"].map(|channel| (channel, pixels.clone())));
        let image = Image { width: 24, height: 18, pixels: pixels.into_iter().map(Vec3::splat).collect() };
        for downscale in [1, 3] {
            let camera = way.camera.scaled(downscale);
            let lookup = MapLookup { bent: &bent, way: Some(&way), downscale, camera };
            let map = lookup.read(&path, Gamma::Linear, |value| value).unwrap();
            let expected = way.image(&image).downscaled(downscale);
            assert_eq!((map.width, map.height), (expected.width, expected.height));
            for (found, expected) in map.pixels.iter().zip(&expected.pixels) {
                assert!(found.abs_diff_eq(*expected, 3e-3), "{downscale}: {found} {expected}");
            }
        }
    }
}
