//! The part of a view that a survey keeps: a few numbers and a small mask, so that a thousand views
//! fit into little memory.

use crate::view::{Camera, Mask, Photograph, Placement, Split, ViewRecord, raster::FULL_COVERAGE};
use lobelia_sg::{color::luminance, statistics::quantile};
use serde::Serialize;

/// Most pixels along a side of the pictures that are looked at.
const LOOK_SIDE: u32 = 1024;
/// Most pixels along a side of the masks that silhouettes are compared on.
const SMALL_MASK_SIDE: u32 = 96;
/// Coverage of a pixel that counts as the object's.
const COVERED: f32 = 0.5;

/// Where a view's mask comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum MaskOrigin {
    /// A file of its own.
    File,
    /// The photograph's alpha.
    Alpha,
    /// There is none.
    Nowhere,
}

/// One view.
#[derive(Clone, Debug, Serialize)]
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
    /// Where the mask comes from.
    pub mask_source: MaskOrigin,
    /// The mask, unless there is none.
    pub mask: Option<MaskLook>,
    /// Intersection over union of the mask with the silhouette of the known mesh, or of the visual
    /// hull of all masks; set by a survey.
    pub overlap: Option<f32>,
    /// Exposure above that of views from nearly the same side, in stops; set by a survey.
    pub stops: Option<f32>,
}

/// The radiance of a photograph, in its mask where there is one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RadianceStatistics {
    /// Median luminance.
    pub median: f32,
    /// Mean luminance, that of each pixel at most four times the median: less than highlights, more
    /// than a median of two colors.
    pub level: f32,
    /// Luminance that a hundredth of the pixels exceed.
    pub bright: f32,
    /// The highest channel of any pixel.
    pub highest: f32,
    /// Share of pixels with a channel at the top of its range, in `[0, 1]`.
    pub clipped: f32,
}

/// A mask.
#[derive(Clone, Debug, Serialize)]
pub struct MaskLook {
    /// Mean coverage of the frame, in `[0, 1]`.
    pub coverage: f32,
    /// The highest coverage of any pixel.
    pub highest: f32,
    /// Whether there is no background at all.
    pub all_covered: bool,
    /// Share of the pixels along the border of the frame that are covered, in `[0, 1]`.
    pub border: f32,
    /// First and one past the last covered column and row, in pixels of the camera that was looked
    /// at; `None` if nothing is covered.
    pub bounds: Option<PixelBounds>,
    /// The mask at most `SMALL_MASK_SIDE` pixels wide and high; not serialized.
    #[serde(skip)]
    pub small: SmallMask,
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PixelBounds {
    /// First covered column and row.
    pub low: [f32; 2],
    /// One past the last.
    pub high: [f32; 2],
}

/// A mask of few pixels with the camera that belongs to it.
#[derive(Clone, Debug, PartialEq)]
pub struct SmallMask {
    /// The camera, for this size.
    pub camera: Camera,
    /// Width and height of the photograph's frame in pixels of this size; the last column and row
    /// may lie beyond it in part.
    pub frame: [f32; 2],
    /// Whether each pixel is covered, row by row from the top left.
    pub inside: Vec<bool>,
}

impl ViewLook {
    /// Looks at a view, at most `LOOK_SIDE` pixels wide and high.
    pub fn new(view: &ViewRecord, mask_source: MaskOrigin) -> Self {
        let whole = view.mask.as_ref().map(|mask| mask.mask());
        let factor = view.camera.width.max(view.camera.height).div_ceil(LOOK_SIDE).max(1);
        let camera = view.camera.scaled(factor);
        let frame = [view.camera.width, view.camera.height].map(|side| side as f32 / factor as f32);
        let mask = whole.as_ref().map(|mask| mask.downscaled(factor));
        let statistics = |of| RadianceStatistics::new(of, factor, whole.as_ref(), mask.as_ref());
        Self {
            light: view.photograph.as_ref().map(statistics),
            camera,
            mask_source: if mask.is_some() { mask_source } else { MaskOrigin::Nowhere },
            mask: mask.map(|mask| MaskLook::new(&mask, &camera, frame)),
            ..Self::unseen(view)
        }
    }

    /// A view of which no pixel is looked at: its size and whether there is a photograph are known,
    /// its light is 0.
    pub fn unseen(record: &ViewRecord) -> Self {
        Self {
            name: record.name.clone(),
            split: record.split,
            size: [record.camera.width, record.camera.height],
            camera: record.camera,
            light: record.photograph.as_ref().map(|_| RadianceStatistics::default()),
            placement: record.placement,
            mask_source: MaskOrigin::Nowhere,
            mask: None,
            overlap: None,
            stops: None,
        }
    }

    /// Pixels of `size` that the object covers.
    pub fn object_pixels(&self) -> Option<f32> {
        let [width, height] = self.size.map(|side| side as f32);
        self.mask.as_ref().map(|mask| mask.coverage * width * height)
    }
}

impl RadianceStatistics {
    /// Of a photograph, all of it and reduced by a factor, with its mask, whole and reduced.
    fn new(photograph: &Photograph, factor: u32, whole: Option<&Mask>, mask: Option<&Mask>) -> Self {
        let [width, height] = photograph.size();
        let is_inside = |i: &usize| whole.is_none_or(|mask| mask.coverage[*i] >= FULL_COVERAGE);
        let inside = || (0..width as usize * height as usize).filter(is_inside);
        let saturated = inside().filter(|i| photograph.is_saturated(*i)).count();
        let pixels = photograph.image().downscaled(factor).pixels;
        let covered = |least: f32| {
            let is_inside = move |i: &usize| mask.is_none_or(|mask| mask.coverage[*i] >= least);
            (0..pixels.len()).filter(is_inside).map(|i| pixels[i]).collect::<Vec<_>>()
        };
        let mut chosen = covered(FULL_COVERAGE);
        if chosen.is_empty() {
            // A mask without a fully covered pixel: whatever it covers.
            chosen = covered(f32::MIN_POSITIVE);
        }
        let mut lights: Vec<f32> = chosen.iter().map(|pixel| luminance(*pixel)).collect();
        let median = quantile(&mut lights, 0.5).unwrap_or(0.0);
        let most = 4.0 * median.max(0.0);
        let sum: f64 = lights.iter().map(|light| f64::from(light.min(most))).sum();
        Self {
            median,
            level: (sum / lights.len().max(1) as f64) as f32,
            bright: quantile(&mut lights, 0.99).unwrap_or(0.0),
            highest: chosen.iter().map(|pixel| pixel.max_element()).fold(f32::NEG_INFINITY, f32::max),
            clipped: saturated as f32 / inside().count().max(1) as f32,
        }
    }
}

impl MaskLook {
    fn new(mask: &Mask, camera: &Camera, frame: [f32; 2]) -> Self {
        let (width, height) = (mask.width as usize, mask.height as usize);
        let (mut low, mut high) = ([f32::INFINITY; 2], [0.0_f32; 2]);
        let (mut border, mut covered_border) = (0, 0);
        for (i, coverage) in mask.coverage.iter().enumerate() {
            let (at, is_covered) = ([i % width, i / width], *coverage >= COVERED);
            let is_border = at[0] == 0 || at[1] == 0 || at[0] + 1 == width || at[1] + 1 == height;
            border += usize::from(is_border);
            covered_border += usize::from(is_border && is_covered);
            if is_covered {
                low = [0, 1].map(|k| low[k].min(at[k] as f32));
                high = [0, 1].map(|k| high[k].max(at[k] as f32 + 1.0));
            }
        }
        let sum: f64 = mask.coverage.iter().map(|&c| f64::from(c)).sum();
        Self {
            coverage: (sum / mask.coverage.len().max(1) as f64) as f32,
            highest: mask.coverage.iter().copied().fold(0.0, f32::max),
            all_covered: mask.coverage.iter().all(|&coverage| coverage >= COVERED),
            border: covered_border as f32 / border.max(1) as f32,
            bounds: low[0].is_finite().then_some(PixelBounds { low, high }),
            small: SmallMask::of(mask, camera, frame, SMALL_MASK_SIDE),
        }
    }

    /// Whether the frame cuts the object.
    pub fn is_cut(&self, camera: &Camera) -> bool {
        let size = [camera.width as f32, camera.height as f32];
        let is_cut = |of: PixelBounds| (0..2).any(|k| of.low[k] == 0.0 || of.high[k] == size[k]);
        self.bounds.is_some_and(is_cut)
    }
}

impl SmallMask {
    /// A mask and its camera, shrunk by a whole factor until neither side is over `side`; a pixel
    /// is covered if most of its block is.
    fn of(mask: &Mask, camera: &Camera, frame: [f32; 2], side: u32) -> Self {
        let factor = mask.width.max(mask.height).div_ceil(side).max(1);
        let small = mask.downscaled(factor);
        Self {
            camera: camera.scaled(factor),
            frame: frame.map(|side| side / factor as f32),
            inside: small.coverage.iter().map(|&coverage| coverage >= COVERED).collect(),
        }
    }

    /// The mask at most `side` pixels wide and high.
    pub fn at_most(&self, side: u32) -> Self {
        Self::of(&self.mask(), &self.camera, self.frame, side)
    }

    /// The mask as coverage, 0 or 1.
    pub fn mask(&self) -> Mask {
        let (width, height) = (self.camera.width, self.camera.height);
        let coverage = self.inside.iter().map(|&inside| f32::from(u8::from(inside))).collect();
        Mask { width, height, coverage }
    }
}
