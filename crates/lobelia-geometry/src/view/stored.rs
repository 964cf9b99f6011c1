//! Photographs and masks as they are kept: in the bytes of their files where those are 8-bit, as
//! half floats where these hold the values, and only inside a window, since most photographs are
//! mostly background.

use crate::view::{Image, Mask, PixelWindow};
use crate::{Error, Result};
use bevy_ecs::prelude::Component;
use glam::Vec3;
use half::f16;
use std::sync::Arc;

/// Numbers in as few bytes as hold them.
#[derive(Clone, Debug, PartialEq)]
enum Numbers {
    /// Places in a table.
    Bytes(Box<[u8]>, Arc<[f32]>),
    /// Places in a table.
    Words(Box<[u16]>, Arc<[f32]>),
    Halves(Box<[f16]>),
    Floats(Box<[f32]>),
}

impl Numbers {
    /// As half floats if they hold all values exactly, or if rounding is allowed and none is too
    /// large.
    fn of(values: impl Iterator<Item = f32> + Clone, may_round: bool) -> Self {
        let holds = |value: f32| {
            let rounded = f16::from_f32(value);
            rounded.to_f32() == value || may_round && rounded.is_finite()
        };
        if values.clone().all(holds) {
            Self::Halves(values.map(f16::from_f32).collect())
        } else {
            Self::Floats(values.collect())
        }
    }

    #[inline]
    fn get(&self, i: usize) -> f32 {
        match self {
            Self::Bytes(stored, table) => table[usize::from(stored[i])],
            Self::Words(stored, table) => table[usize::from(stored[i])],
            Self::Halves(stored) => stored[i].to_f32(),
            Self::Floats(stored) => stored[i],
        }
    }

    /// The greatest value, and no less than 0: of stored integers the greatest that they could be.
    fn highest(&self) -> f32 {
        match self {
            Self::Bytes(_, table) | Self::Words(_, table) => table.iter().copied().fold(0.0, f32::max),
            Self::Halves(stored) => stored.iter().map(|value| value.to_f32()).fold(0.0, f32::max),
            Self::Floats(stored) => stored.iter().copied().fold(0.0, f32::max),
        }
    }
}

/// Flags, eight in a byte.
#[derive(Clone, Debug)]
struct Flags(Vec<u8>);

impl Flags {
    /// Nothing is stored if no flag is set.
    fn of(flags: impl Iterator<Item = bool>) -> Self {
        let mut packed = Vec::new();
        for (i, _) in flags.enumerate().filter(|(_, flag)| *flag) {
            if packed.len() <= i / 8 {
                packed.resize(i / 8 + 1, 0);
            }
            packed[i / 8] |= 1 << (i % 8);
        }
        packed.shrink_to_fit();
        Self(packed)
    }

    #[inline]
    fn get(&self, i: usize) -> bool {
        self.0.get(i / 8).is_some_and(|byte| byte >> (i % 8) & 1 == 1)
    }
}

/// Integer samples of a picture, as a file holds them: straight alpha, if any, is the last channel.
#[derive(Clone, Copy, Debug)]
pub enum IntegerSamples<'a> {
    /// 8 bits a channel.
    Bytes(&'a [u8]),
    /// 16 bits a channel.
    Words(&'a [u16]),
}

/// Tables from stored integers to linear radiance and to coverage, shared by photographs.
#[derive(Clone, Debug)]
pub struct Curve {
    color: Arc<[f32]>,
    alpha: Arc<[f32]>,
}

impl Curve {
    /// From the linear radiance of each stored value.
    pub fn new(color: Vec<f32>) -> Self {
        let top = color.len().saturating_sub(1).max(1) as f32;
        Self { alpha: (0..color.len()).map(|stored| stored as f32 / top).collect(), color: color.into() }
    }
}

/// A photograph as it is kept.
///
/// Pixels are numbered `y * width + x`. Outside its window a photograph is black and not saturated.
#[derive(Component, Clone, Debug)]
pub struct Photograph {
    width: u32,
    height: u32,
    window: PixelWindow,
    /// Channels of `color`: 1 or 3.
    channels: usize,
    color: Numbers,
    /// Factors of the colors; 1 if there are none.
    alpha: Option<Arc<Numbers>>,
    saturated: Flags,
    /// The greatest of `color`.
    highest: f32,
}

impl Photograph {
    /// From linear radiance, coverage-weighted on black, and flags of saturated pixels, inside a
    /// window.
    ///
    /// With `may_round` values are rounded to half floats (11 bits); without, they are kept
    /// exactly.
    ///
    /// # Errors
    /// [`Error::Run`] if the lists have other lengths than the picture.
    pub fn new(image: &Image, saturated: &[bool], window: PixelWindow, may_round: bool) -> Result<Self> {
        let count = image.width as usize * image.height as usize;
        if image.pixels.len() != count || saturated.len() != count {
            let (pixels, flags) = (image.pixels.len(), saturated.len());
            let problem = format!("{pixels} pixels and {flags} flags for {}×{}", image.width, image.height);
            return Err(Error::run("a photograph", problem));
        }
        let inside = || window.pixels(image.width);
        let color = Numbers::of(inside().flat_map(|i| image.pixels[i].to_array()), may_round);
        let saturated = Flags::of(inside().map(|i| saturated[i]));
        Ok(Self { window, saturated, ..Self::of_numbers(image.width, image.height, color) })
    }

    /// From linear radiance, coverage-weighted on black, kept exactly; nothing is saturated.
    pub fn of_image(image: &Image) -> Self {
        let values = image.pixels.iter().flat_map(Vec3::to_array);
        Self::of_numbers(image.width, image.height, Numbers::of(values, false))
    }

    /// From three channels of all pixels; nothing is saturated.
    fn of_numbers(width: u32, height: u32, color: Numbers) -> Self {
        let (window, saturated) = (PixelWindow::whole(width, height), Flags(Vec::new()));
        let highest = color.highest();
        Self { width, height, window, channels: 3, color, alpha: None, saturated, highest }
    }

    /// The place of a photograph whose pixels nobody looks at: black.
    pub fn without_pixels(width: u32, height: u32) -> Self {
        let window = PixelWindow { width: 0, height: 0, ..PixelWindow::whole(width, height) };
        Self { window, ..Self::of_numbers(width, height, Numbers::of(std::iter::empty(), false)) }
    }

    /// From integer samples of 1 to 4 channels (an even count has straight alpha as the last),
    /// inside a window.
    pub fn of_integers(
        size: [u32; 2],
        samples: IntegerSamples,
        channels: usize,
        curve: &Curve,
        window: PixelWindow,
    ) -> Self {
        let [width, height] = size;
        let colors = if channels < 3 { 1 } else { 3 };
        let inside = || window.pixels(width);
        let top = curve.color.len() - 1;
        let stored = |i: usize| match samples {
            IntegerSamples::Bytes(bytes) => usize::from(bytes[i]),
            IntegerSamples::Words(words) => usize::from(words[i]),
        };
        let color_of = |pixel: usize, channel: usize| stored(pixel * channels + channel);
        let is_saturated = |pixel: usize| {
            let covered = colors == channels || stored(pixel * channels + colors) > 0;
            covered && (0..colors).any(|channel| color_of(pixel, channel) == top)
        };
        let pack = |table: Arc<[f32]>, values: &mut dyn Iterator<Item = usize>| match samples {
            IntegerSamples::Bytes(_) => Numbers::Bytes(values.map(|v| v as u8).collect(), table),
            IntegerSamples::Words(_) => Numbers::Words(values.map(|v| v as u16).collect(), table),
        };
        let mut color = inside().flat_map(|pixel| (0..colors).map(move |channel| color_of(pixel, channel)));
        let color = pack(curve.color.clone(), &mut color);
        let mut alpha = inside().map(|pixel| stored(pixel * channels + colors));
        let alpha = (channels > colors).then(|| Arc::new(pack(curve.alpha.clone(), &mut alpha)));
        let saturated = Flags::of(inside().map(is_saturated));
        let whole = Self::of_numbers(width, height, color);
        Self { window, channels: colors, alpha, saturated, ..whole }
    }

    /// Shares the memory of a mask that is its own alpha.
    pub fn share_alpha(&mut self, mask: &StoredMask) {
        if let Some(alpha) = self.alpha.as_mut().filter(|_| self.window == mask.window)
            && **alpha == *mask.coverage
        {
            *alpha = mask.coverage.clone();
        }
    }

    /// Width and height of the picture in pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// The part of the picture that is kept; the rest is black.
    pub fn window(&self) -> PixelWindow {
        self.window
    }

    /// Linear radiance of a pixel, coverage-weighted on black.
    #[inline]
    pub fn radiance(&self, pixel: usize) -> Vec3 {
        let Some(at) = self.window.place(pixel, self.width) else { return Vec3::ZERO };
        let color = match self.channels {
            1 => Vec3::splat(self.color.get(at)),
            _ => Vec3::new(self.color.get(3 * at), self.color.get(3 * at + 1), self.color.get(3 * at + 2)),
        };
        match &self.alpha {
            Some(alpha) => color * alpha.get(at),
            None => color,
        }
    }

    /// Whether a channel of the pixel is at the top of its range (8-bit 255, 16-bit 65535): the
    /// loss uses a clipped channel as a lower bound. Also set where a value of a file was not
    /// finite.
    #[inline]
    pub fn is_saturated(&self, pixel: usize) -> bool {
        self.window.place(pixel, self.width).is_some_and(|at| self.saturated.get(at))
    }

    /// The greatest channel of any pixel that is kept: of 8- and 16-bit photographs the greatest
    /// that it could be.
    pub fn highest(&self) -> f32 {
        self.highest
    }

    /// The whole picture as linear radiance.
    pub fn image(&self) -> Image {
        let mut pixels = vec![Vec3::ZERO; self.width as usize * self.height as usize];
        self.window.pixels(self.width).for_each(|i| pixels[i] = self.radiance(i));
        Image { width: self.width, height: self.height, pixels }
    }
}

/// A mask as it is kept. A clone shares its memory.
///
/// Pixels are numbered `y * width + x`. Outside its window the coverage is 0.
#[derive(Clone, Debug)]
pub struct StoredMask {
    width: u32,
    height: u32,
    window: PixelWindow,
    /// Shared by clones.
    coverage: Arc<Numbers>,
}

impl StoredMask {
    /// Keeps a mask: one with values k/255 in bytes, others as half floats.
    pub fn new(mask: &Mask) -> Self {
        let window = PixelWindow::of_mask(mask);
        let values = window.pixels(mask.width).map(|i| mask.coverage[i]);
        let table: Arc<[f32]> = (0..=255u8).map(|v| f32::from(v) / 255.0).collect();
        let nearest = |coverage: f32| (coverage * 255.0).round() as u8;
        let coverage = if values.clone().all(|c| table[usize::from(nearest(c))] == c) {
            Numbers::Bytes(values.map(nearest).collect(), table)
        } else {
            Numbers::of(values, true)
        };
        Self { width: mask.width, height: mask.height, window, coverage: Arc::new(coverage) }
    }

    /// Width and height of the picture in pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// The part that holds all covered pixels.
    pub fn window(&self) -> PixelWindow {
        self.window
    }

    /// Whether every pixel is covered by half or more.
    pub fn is_full(&self) -> bool {
        let pixels = self.width as usize * self.height as usize;
        self.window.len() == pixels && (0..pixels).all(|i| self.coverage.get(i) >= 0.5)
    }

    /// Coverage of a pixel, in `[0, 1]`.
    #[inline]
    pub fn coverage(&self, pixel: usize) -> f32 {
        self.window.place(pixel, self.width).map_or(0.0, |at| self.coverage.get(at))
    }

    /// The whole mask.
    pub fn mask(&self) -> Mask {
        let mut coverage = vec![0.0; self.width as usize * self.height as usize];
        self.window.pixels(self.width).for_each(|i| coverage[i] = self.coverage(i));
        Mask { width: self.width, height: self.height, coverage }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(value: impl Fn(usize) -> f32) -> Image {
        Image { width: 5, height: 4, pixels: (0..20).map(|i| Vec3::new(value(i), 0.5, 2.0)).collect() }
    }

    /// Memory that numbers take, without the table.
    fn bytes(numbers: &Numbers) -> usize {
        match numbers {
            Numbers::Bytes(stored, _) => stored.len(),
            Numbers::Words(stored, _) => 2 * stored.len(),
            Numbers::Halves(stored) => 2 * stored.len(),
            Numbers::Floats(stored) => 4 * stored.len(),
        }
    }

    fn middle() -> PixelWindow {
        PixelWindow { x: 1, y: 1, width: 3, height: 2 }
    }

    #[test]
    fn a_photograph_is_black_outside_its_window() {
        let image = picture(|i| i as f32);
        let kept = Photograph::new(&image, &[true; 20], middle(), false).unwrap();
        for i in 0..20 {
            let inside = [6, 7, 8, 11, 12, 13].contains(&i);
            assert_eq!(kept.radiance(i), if inside { image.pixels[i] } else { Vec3::ZERO });
            assert_eq!(kept.is_saturated(i), inside);
        }
        assert_eq!((bytes(&kept.color), kept.saturated.0.len()), (6 * 6, 1));
        assert_eq!(kept.image().pixels[7], image.pixels[7]);
    }

    #[test]
    fn what_half_floats_do_not_hold_stays_exact_unless_rounding_is_allowed() {
        let image = picture(|_| 0.1);
        let whole = PixelWindow::whole(5, 4);
        let exact = Photograph::new(&image, &[false; 20], whole, false).unwrap();
        assert_eq!((exact.radiance(3), bytes(&exact.color)), (image.pixels[3], 20 * 12));
        let rounded = Photograph::new(&image, &[false; 20], whole, true).unwrap();
        assert_eq!(bytes(&rounded.color), 20 * 6);
        assert!((rounded.radiance(3).x / 0.1 - 1.0).abs() < 1.0 / 2048.0);
        let bright = picture(|_| 1e6);
        assert_eq!(Photograph::new(&bright, &[false; 20], whole, true).unwrap().radiance(0).x, 1e6);
    }

    #[test]
    fn a_mask_that_is_the_alpha_of_a_photograph_shares_its_memory() {
        let curve = Curve::new((0..=255).map(|v| v as f32 / 255.0).collect());
        let bytes: Vec<u8> = (0..80).map(|i| 3 * i).collect();
        let of = |bytes| Photograph::of_integers([5, 4], IntegerSamples::Bytes(bytes), 4, &curve, middle());
        let inside: Vec<usize> = middle().pixels(5).collect();
        let coverage = |i| if inside.contains(&i) { f32::from(bytes[4 * i + 3]) / 255.0 } else { 0.0 };
        let mut mask = Mask { width: 5, height: 4, coverage: (0..20).map(coverage).collect() };
        for is_alike in [true, false] {
            let (mut kept, before) = (of(&bytes), of(&bytes));
            let stored = StoredMask::new(&mask);
            kept.share_alpha(&stored);
            assert_eq!(Arc::ptr_eq(kept.alpha.as_ref().unwrap(), &stored.coverage), is_alike);
            assert!((0..20).all(|i| kept.radiance(i) == before.radiance(i)));
            mask.coverage[7] = 1.0;
        }
    }

    #[test]
    fn lists_of_another_length_are_refused() {
        let image = Image { pixels: vec![Vec3::ONE; 3], ..picture(|_| 0.0) };
        assert!(Photograph::new(&image, &[false; 20], middle(), false).is_err());
        assert!(Photograph::new(&picture(|_| 0.0), &[false; 2], middle(), false).is_err());
    }

    #[test]
    fn integers_are_kept_as_stored() {
        let square: Vec<f32> = (0..=255).map(|v| (v as f32 / 255.0).powi(2)).collect();
        let curve = Curve::new(square.clone());
        let samples: Vec<u8> = (0..20u8).flat_map(|i| [i, 255, 3, if i == 7 { 0 } else { 51 }]).collect();
        let samples = IntegerSamples::Bytes(&samples);
        let kept = Photograph::of_integers([5, 4], samples, 4, &curve, middle());
        assert_eq!(kept.radiance(8), Vec3::new(square[8], 1.0, square[3]) * 0.2);
        assert_eq!((bytes(&kept.color), bytes(kept.alpha.as_ref().unwrap())), (6 * 3, 6));
        assert!(kept.is_saturated(6) && !kept.is_saturated(7), "nothing is covered at 7");
        let gray = IntegerSamples::Words(&[65535; 20]);
        let curve = Curve::new((0..=65535).map(|v| v as f32 / 65535.0).collect());
        let kept = Photograph::of_integers([5, 4], gray, 1, &curve, middle());
        assert_eq!((kept.radiance(6), kept.is_saturated(6)), (Vec3::ONE, true));
    }

    #[test]
    fn masks_are_cropped_and_keep_their_values() {
        let coverage = |i: usize| if [6, 8, 13].contains(&i) { 0.2 } else { 0.0 };
        let mask = Mask { width: 5, height: 4, coverage: (0..20).map(coverage).collect() };
        let kept = StoredMask::new(&mask);
        assert_eq!((kept.window(), bytes(&kept.coverage)), (middle(), 6));
        assert_eq!(kept.mask(), mask);
        let quarter = Mask { coverage: mask.coverage.iter().map(|c| c * 1.25).collect(), ..mask };
        let kept = StoredMask::new(&quarter);
        assert_eq!((kept.mask(), bytes(&kept.coverage)), (quarter, 12));
        let empty = StoredMask::new(&Mask { width: 3, height: 2, coverage: vec![0.0; 6] });
        assert!(empty.window().is_empty() && empty.mask().coverage == [0.0; 6]);
    }
}
