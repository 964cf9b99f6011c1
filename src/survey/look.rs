//! What a survey keeps of one view: a few numbers, a small mask and a thumbnail, so that a thousand views fit into little memory.

use crate::dataset::LoadedView;
use crate::math::color::luminance;
use crate::math::statistics::quantile;
use crate::report::metrics::erode;
use crate::report::tone::srgb8;
use crate::survey::sharpness::{Sharpness, sharpness};
use crate::view::raster::FULL_COVERAGE;
use crate::view::{Camera, Image, Mask, Placement, Split, ViewRecord};
use glam::Vec3;
use image::{Rgb, RgbImage};
use serde::{Deserialize, Serialize};

/// Most pixels along a side of the masks that silhouettes are compared on.
pub(crate) const SMALL_MASK_SIDE: u32 = 96;
/// Most pixels along a side of a thumbnail.
pub(crate) const THUMBNAIL_SIDE: u32 = 128;
/// Coverage of a pixel that counts as the object's.
const COVERED: f32 = 0.5;

/// Where a view's mask comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum MaskOrigin {
    /// A file of its own.
    File,
    /// The photograph's alpha.
    Alpha,
    /// There is none.
    Nowhere,
}

/// A view with all its pixels, as it is looked at.
#[derive(Clone, Debug)]
pub struct OpenView {
    /// The view's name.
    pub name: String,
    /// Which part of the data it is of.
    pub split: Split,
    /// The camera.
    pub camera: Camera,
    /// The photograph, unless there is none.
    pub photograph: Option<OpenPhotograph>,
    /// The mask, unless there is none.
    pub mask: Option<Mask>,
    /// How the object lies in it.
    pub placement: Placement,
    /// As [`ViewLook::negative`].
    pub negative: f32,
    /// As [`LoadedView::exif`].
    pub exif: [u8; 2],
}

/// A photograph with all its pixels.
#[derive(Clone, Debug)]
pub struct OpenPhotograph {
    /// Linear radiance on black.
    pub image: Image,
    /// Whether each pixel has a channel at the top of its range.
    pub saturated: Vec<bool>,
}

impl OpenView {
    /// From a view as it was read.
    pub fn new(LoadedView { record, repairs, exif, .. }: &LoadedView) -> Self {
        let photograph = record.photograph.as_ref().map(|kept| {
            let image = kept.image();
            let saturated = (0..image.pixels.len()).map(|i| kept.is_saturated(i)).collect();
            OpenPhotograph { image, saturated }
        });
        Self {
            name: record.name.clone(),
            split: record.split,
            camera: record.camera,
            photograph,
            mask: record.mask.as_ref().map(|mask| mask.mask()),
            placement: record.placement,
            negative: repairs.negative as f32 / repairs.lit.max(1) as f32,
            exif: *exif,
        }
    }
}

/// One view.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ViewLook {
    /// The view's name.
    pub name: String,
    /// Which part of the data it is of.
    pub split: Split,
    /// Width and height in pixels, as passes see the view.
    pub size: [u32; 2],
    /// The camera of the picture that was looked at, which may be smaller than `size`.
    pub camera: Camera,
    /// The photograph, unless there is none.
    pub light: Option<RadianceStatistics>,
    /// How the object lies in it; it has another light than in other placements.
    pub placement: Placement,
    /// Share of the photograph's pixels that are not black which were negative in its file and are 0 now, in `[0, 1]`.
    pub negative: f32,
    /// As [`LoadedView::exif`].
    pub exif: [u8; 2],
    /// Where the mask comes from.
    pub mask_source: MaskOrigin,
    /// The mask, unless there is none.
    pub mask: Option<MaskLook>,
    /// The photograph, small; not serialized.
    #[serde(skip)]
    pub thumbnail: Option<Thumbnail>,
}

/// The radiance of a photograph, in its mask where there is one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RadianceStatistics {
    /// Median luminance.
    pub median: f32,
    /// Mean luminance, that of each pixel at most four times the median: less than highlights, more than a median of two colors.
    pub level: f32,
    /// Luminance that a hundredth of the pixels exceed.
    pub bright: f32,
    /// The highest channel of any pixel.
    pub highest: f32,
    /// Share of pixels with a channel at the top of its range, in `[0, 1]`.
    pub clipped: f32,
    /// Fine detail; `None` if the object is too small or has none.
    pub sharpness: Option<Sharpness>,
    /// A hash of all pixels: photographs with the same are identical.
    pub fingerprint: u64,
}

/// A mask.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MaskLook {
    /// Mean coverage of the frame, in `[0, 1]`.
    pub coverage: f32,
    /// The highest coverage of any pixel.
    pub highest: f32,
    /// Whether there is no background at all.
    pub all_covered: bool,
    /// Share of the pixels with any coverage that are neither nearly empty nor nearly full, in `[0, 1]`.
    pub soft: f32,
    /// Whether any pixel counts in a score: whether its whole neighborhood is fully covered.
    pub scorable: bool,
    /// Share of the pixels along the border of the frame that are covered, in `[0, 1]`.
    pub border: f32,
    /// First and one past the last covered column and row, in pixels of the camera that was looked at; `None` if nothing is covered.
    pub bounds: Option<PixelBounds>,
    /// The mask at most `SMALL_MASK_SIDE` pixels wide and high.
    pub small: SmallMask,
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PixelBounds {
    /// First covered column and row.
    pub low: [f32; 2],
    /// One past the last.
    pub high: [f32; 2],
}

/// A mask of few pixels with the camera that belongs to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SmallMask {
    /// The camera, for this size.
    pub camera: Camera,
    /// Whether each pixel is covered, row by row from the top left.
    pub inside: Vec<bool>,
}

/// A small picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Thumbnail {
    /// sRGB, relative to `white`.
    pub picture: RgbImage,
    /// The linear radiance of 255.
    pub white: f32,
}

impl ViewLook {
    /// Looks at a view of `size` pixels, which `view` may show smaller. Thumbnails are for contact sheets alone.
    pub fn new(view: &OpenView, size: [u32; 2], mask_source: MaskOrigin, with_thumbnail: bool) -> Self {
        let mask = view.mask.as_ref();
        let photograph = view.photograph.as_ref();
        Self {
            name: view.name.clone(),
            split: view.split,
            size,
            camera: view.camera,
            light: photograph.map(|photograph| RadianceStatistics::new(photograph, mask)),
            placement: view.placement,
            negative: view.negative,
            exif: view.exif,
            mask_source: if mask.is_some() { mask_source } else { MaskOrigin::Nowhere },
            mask: mask.map(|mask| MaskLook::new(mask, &view.camera)),
            thumbnail: photograph.filter(|_| with_thumbnail).and_then(Thumbnail::new),
        }
    }

    /// A view of which no pixel is looked at: its size and whether there is a photograph are known, its light is 0.
    pub fn unseen(record: &ViewRecord) -> Self {
        Self {
            name: record.name.clone(),
            split: record.split,
            size: [record.camera.width, record.camera.height],
            camera: record.camera,
            light: record.photograph.as_ref().map(|_| RadianceStatistics::default()),
            placement: record.placement,
            negative: 0.0,
            exif: [1; 2],
            mask_source: MaskOrigin::Nowhere,
            mask: None,
            thumbnail: None,
        }
    }

    /// Pixels of `size` that the object covers.
    pub fn object_pixels(&self) -> Option<f32> {
        let [width, height] = self.size.map(|side| side as f32);
        self.mask.as_ref().map(|mask| mask.coverage * width * height)
    }
}

impl RadianceStatistics {
    fn new(photograph: &OpenPhotograph, mask: Option<&Mask>) -> Self {
        let pixels = &photograph.image.pixels;
        let inside = |i: usize| mask.is_none_or(|mask| mask.coverage[i] >= FULL_COVERAGE);
        let mut chosen: Vec<usize> = (0..pixels.len()).filter(|&i| inside(i)).collect();
        if chosen.is_empty() {
            // A mask without a fully covered pixel: whatever it covers.
            chosen = (0..pixels.len()).filter(|&i| mask.is_none_or(|mask| mask.coverage[i] > 0.0)).collect();
        }
        let mut lights: Vec<f32> = chosen.iter().map(|&i| luminance(pixels[i])).collect();
        let median = quantile(&mut lights, 0.5).unwrap_or(0.0);
        let most = 4.0 * median.max(0.0);
        let level =
            lights.iter().map(|light| f64::from(light.min(most))).sum::<f64>() / lights.len().max(1) as f64;
        let share = |count: usize| count as f32 / chosen.len().max(1) as f32;
        Self {
            median,
            level: level as f32,
            bright: quantile(&mut lights, 0.99).unwrap_or(0.0),
            highest: chosen.iter().map(|&i| pixels[i].max_element()).fold(f32::NEG_INFINITY, f32::max),
            clipped: share(chosen.iter().filter(|&&i| photograph.saturated[i]).count()),
            sharpness: sharpness(&photograph.image, median, inside),
            fingerprint: fingerprint(pixels),
        }
    }
}

/// FNV-1a over the bits of all pixels.
fn fingerprint(pixels: &[Vec3]) -> u64 {
    let words = pixels.iter().flat_map(|pixel| pixel.to_array());
    words.fold(0xcbf2_9ce4_8422_2325, |hash: u64, word| {
        (hash ^ u64::from(word.to_bits())).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

impl MaskLook {
    fn new(mask: &Mask, camera: &Camera) -> Self {
        let count = mask.coverage.len().max(1) as f32;
        let any = mask.coverage.iter().filter(|&&c| c > 0.02).count();
        let soft = mask.coverage.iter().filter(|&&c| c > 0.02 && c < 0.98).count();
        let sum: f64 = mask.coverage.iter().map(|&c| f64::from(c)).sum();
        let size = [mask.width as usize, mask.height as usize];
        Self {
            coverage: (sum / f64::from(count)) as f32,
            highest: mask.coverage.iter().copied().fold(0.0, f32::max),
            all_covered: mask.coverage.iter().all(|&coverage| coverage >= COVERED),
            soft: soft as f32 / any.max(1) as f32,
            scorable: erode(size, &mask.coverage).contains(&true),
            border: border_share(mask),
            bounds: bounds(mask),
            small: SmallMask::new(mask, camera),
        }
    }

    /// Whether the frame cuts the object.
    pub fn is_cut(&self, camera: &Camera) -> bool {
        let size = [camera.width as f32, camera.height as f32];
        self.bounds
            .is_some_and(|PixelBounds { low, high }| (0..2).any(|k| low[k] == 0.0 || high[k] == size[k]))
    }
}

fn border_share(mask: &Mask) -> f32 {
    let (width, height) = (mask.width as usize, mask.height as usize);
    let is_border = |i: &usize| {
        let (x, y) = (i % width, i / width);
        x == 0 || y == 0 || x + 1 == width || y + 1 == height
    };
    let border: Vec<usize> = (0..mask.coverage.len()).filter(is_border).collect();
    let covered = border.iter().filter(|&&i| mask.coverage[i] >= COVERED).count();
    covered as f32 / border.len().max(1) as f32
}

fn bounds(mask: &Mask) -> Option<PixelBounds> {
    let mut found: Option<PixelBounds> = None;
    for (i, _) in mask.coverage.iter().enumerate().filter(|(_, coverage)| **coverage >= COVERED) {
        let at = [(i as u32 % mask.width) as f32, (i as u32 / mask.width) as f32];
        let found = found.get_or_insert(PixelBounds { low: at, high: at });
        found.low = [found.low[0].min(at[0]), found.low[1].min(at[1])];
        found.high = [found.high[0].max(at[0] + 1.0), found.high[1].max(at[1] + 1.0)];
    }
    found
}

impl SmallMask {
    /// A mask and its camera, shrunk by a whole factor.
    pub fn new(mask: &Mask, camera: &Camera) -> Self {
        let factor = mask.width.max(mask.height).div_ceil(SMALL_MASK_SIDE).max(1);
        let small = mask.downscaled(factor);
        Self {
            camera: camera.scaled(factor),
            inside: small.coverage.iter().map(|&coverage| coverage >= COVERED).collect(),
        }
    }

    /// Half as wide and high, or less, until neither side is over `side`; a pixel is covered if most of its block is.
    pub fn at_most(&self, side: u32) -> Self {
        let (width, height) = (self.camera.width, self.camera.height);
        let coverage = self.inside.iter().map(|&inside| f32::from(u8::from(inside))).collect();
        let factor = width.max(height).div_ceil(side).max(1);
        let small = Mask { width, height, coverage }.downscaled(factor);
        Self {
            camera: self.camera.scaled(factor),
            inside: small.coverage.iter().map(|&coverage| coverage >= COVERED).collect(),
        }
    }
}

impl Thumbnail {
    /// `None` if the photograph has no light.
    fn new(photograph: &OpenPhotograph) -> Option<Self> {
        let image = &photograph.image;
        let small = image.downscaled(image.width.max(image.height).div_ceil(THUMBNAIL_SIDE).max(1));
        let mut channels: Vec<f32> = small.pixels.iter().map(|pixel| pixel.max_element()).collect();
        let white = quantile(&mut channels, 0.999).filter(|white| *white > 0.0 && white.is_finite())?;
        let mut picture = RgbImage::new(small.width, small.height);
        for (to, from) in picture.pixels_mut().zip(&small.pixels) {
            *to = Rgb(srgb8(*from / white));
        }
        Some(Self { picture, white })
    }
}
