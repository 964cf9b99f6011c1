//! Linear radiance as pictures: exposure, tone curve, backdrop, 8-bit sRGB; heat maps of errors of
//! radiance; and small JPEGs for pages, of a size that keeps a page within its budget. An exposure
//! is in stops, and is applied before the curve.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_io::codec::tone::{Look, Tone, srgb8};
//!
//! let look = Look { exposure: 1.0, tone: Tone::Srgb };
//! assert_eq!(look.develop(Vec3::new(0.25, 0.4, 0.75)), Vec3::new(0.5, 0.8, 1.0));
//! assert_eq!(srgb8(Vec3::new(0.0, 0.5, 2.0)), [0, 188, 255]);
//! ```

use crate::codec::png_file::{self, PngRows};
use crate::{codec::file::write_bytes, codec::image::encode_jpeg};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use glam::{Mat3, Vec3};
use image::{GrayImage, Rgb, RgbImage, imageops::thumbnail};
use lobelia_geometry::{Error, Result, parallel, view::Frame};
use lobelia_sg::color::{linear_from_srgb, srgb_from_linear};
use png::ColorType;
use serde::{Deserialize, Serialize};
use std::{path::Path, sync::LazyLock};

/// Tone mapping of linear radiance to the range of a display.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Tone {
    /// Clipped at 1: values in range are shown exactly.
    #[default]
    Srgb,
    /// A film-like shoulder and toe: S. Hill's fit of the ACES RRT and ODT (BakingLab, `ACES.hlsl`,
    /// 2016), pre-scaled by 1/0.6 so that mid-gray stays about the same.
    Filmic,
    /// Exact up to about 0.76 and then compressed toward white, hue preserved: the Khronos PBR
    /// Neutral tone mapper (2024). Best for judging materials under a bright light.
    Neutral,
}

impl Tone {
    /// Display-referred linear value, in `[0, 1]`, of a scene-referred one. Non-finite and negative
    /// parts count as 0.
    pub fn curve(self, radiance: Vec3) -> Vec3 {
        let radiance = radiance.map(|c| if c.is_finite() { c.max(0.0) } else { 0.0 });
        let mapped = match self {
            Self::Srgb => radiance,
            Self::Filmic => filmic(radiance),
            Self::Neutral => neutral(radiance),
        };
        mapped.clamp(Vec3::ZERO, Vec3::ONE)
    }
}

fn filmic(radiance: Vec3) -> Vec3 {
    // Rows of the published matrices (sRGB → XYZ → D65_2_D60 → AP1 → RRT_SAT, and ODT_SAT → … →
    // sRGB), so transposed here.
    const ACES: [[f32; 3]; 3] =
        [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]];
    const SRGB: [[f32; 3]; 3] =
        [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]];
    let [aces_from_srgb, srgb_from_aces] =
        [ACES, SRGB].map(|rows| Mat3::from_cols_array_2d(&rows).transpose());
    // Beyond this the curve is flat and its squares would overflow.
    let v = (aces_from_srgb * (radiance / 0.6)).min(Vec3::splat(1e6));
    let curved = (v * (v + 0.024_578_6) - 0.000_090_537) / (v * (0.983_729 * v + 0.432_951) + 0.238_081);
    srgb_from_aces * curved
}

fn neutral(radiance: Vec3) -> Vec3 {
    const START: f32 = 0.8 - 0.04;
    const DESATURATION: f32 = 0.15;
    let least = radiance.min_element();
    let offset = if least < 0.08 { least - 6.25 * least * least } else { 0.04 };
    let color = radiance - offset;
    let peak = color.max_element();
    if peak < START {
        return color;
    }
    let room = 1.0 - START;
    let new_peak = 1.0 - room * room / (peak + room - START);
    let white = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    (color * (new_peak / peak)).lerp(Vec3::splat(new_peak), white)
}

/// Exposure and tone curve of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Look {
    /// Radiance is multiplied by 2 to this power, in stops.
    pub exposure: f32,
    /// The tone curve.
    pub tone: Tone,
}

impl Look {
    /// Display-referred linear value of a radiance.
    pub fn develop(&self, radiance: Vec3) -> Vec3 {
        self.tone.curve(radiance * self.exposure.exp2())
    }
}

/// The background outside the object.
#[derive(Clone, Copy, Debug)]
pub enum Backdrop<'a> {
    /// None: straight alpha.
    Transparent,
    /// One display-referred linear color in `[0, 1]`, without exposure and tone curve.
    Solid(Vec3),
    /// The radiance behind each pixel (the environment), with the exposure and tone curve of the
    /// object.
    Radiance(&'a [Vec3]),
}

/// The light gray that pictures of the object lie on in contact sheets and pages, sRGB.
pub const MAT: [u8; 3] = [228, 228, 225];

/// A linear image to be tone mapped: coverage-weighted color on black, and coverage in `[0, 1]`.
#[derive(Clone, Copy, Debug)]
pub struct Picture<'a> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `width * height` linear radiances, coverage-weighted on black.
    pub color: &'a [Vec3],
    /// `width * height` coverages.
    pub alpha: &'a [f32],
}

impl<'a> Picture<'a> {
    /// Color and coverage of a rendered frame.
    pub fn of(frame: &'a Frame) -> Self {
        Self { width: frame.width, height: frame.height, color: &frame.color, alpha: &frame.alpha }
    }

    /// The 8-bit sRGB samples of all pixels, in order: with straight alpha for a transparent
    /// backdrop, else opaque.
    ///
    /// # Errors
    /// [`Error::Run`] if a list does not have `width * height` entries.
    pub fn samples8(&self, look: &Look, backdrop: Backdrop) -> Result<Vec<u8>> {
        let count = self.width * self.height;
        let behind = if let Backdrop::Radiance(behind) = backdrop { behind.len() } else { count };
        for (what, len) in [("color", self.color.len()), ("alpha", self.alpha.len()), ("backdrop", behind)] {
            if len != count {
                let problem = format!("the {what} has {len} pixels, not {} × {}", self.width, self.height);
                return Err(Error::run("developing a picture", problem));
            }
        }
        let covered = |at: usize| self.alpha[at].clamp(0.0, 1.0);
        // The color of the object for full coverage; the curve applies to this color, not to its
        // mixture with black.
        let straight = |at: usize| {
            let (color, alpha) = (self.color[at], covered(at));
            look.develop(if alpha > 1e-4 { color / alpha } else { color })
        };
        Ok(match backdrop {
            Backdrop::Transparent => self.samples(|at| {
                let [r, g, b] = srgb8(straight(at));
                [r, g, b, byte(covered(at))]
            }),
            Backdrop::Solid(solid) => self.samples(|at| srgb8(solid.lerp(straight(at), covered(at)))),
            Backdrop::Radiance(behind) => {
                self.samples(|at| srgb8(look.develop(self.color[at] + (1.0 - covered(at)) * behind[at])))
            }
        })
    }

    fn samples<const CHANNELS: usize>(&self, pixel: impl Fn(usize) -> [u8; CHANNELS] + Sync) -> Vec<u8> {
        parallel::map(self.width * self.height, 4096, pixel).into_flattened()
    }

    /// The picture on the mat.
    pub fn on_mat(&self) -> Result<RgbImage> {
        let mat = Vec3::from(MAT.map(|byte| linear_from_srgb(f32::from(byte) / 255.0)));
        let samples = self.samples8(&Look::default(), Backdrop::Solid(mat))?;
        let [width, height] = [self.width, self.height].map(|side| side as u32);
        Ok(RgbImage::from_raw(width, height, samples).expect("there are as many samples"))
    }
}

/// Writes a rendered frame as an 8-bit sRGB PNG with straight alpha, and creates its folder.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written.
pub fn save_png(path: impl AsRef<Path>, frame: &Frame, look: &Look) -> Result<()> {
    let samples = Picture::of(frame).samples8(look, Backdrop::Transparent)?;
    write_png_rows(path, [frame.width as u32, frame.height as u32], true, |rows| rows.push(&samples))
}

/// Writes a PNG of `size` (width, height) that is never whole in memory: `fill` pushes
/// [`Picture::samples8`] of its bands from the top, all with a `transparent` backdrop or none.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Run`] for an empty picture, and those of
/// `rows`.
pub fn write_png_rows(
    path: impl AsRef<Path>,
    size: [u32; 2],
    transparent: bool,
    fill: impl FnOnce(&mut PngRows) -> Result<()>,
) -> Result<()> {
    let color = if transparent { ColorType::Rgba } else { ColorType::Rgb };
    png_file::write_rows(path, size, color, None, fill)
}

fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}

/// 8-bit sRGB of a display-referred linear value, which is clipped to `[0, 1]`.
pub fn srgb8(linear: Vec3) -> [u8; 3] {
    // Which byte a value becomes is looked up: a power for each channel of each pixel would take a
    // tenth of the time of a film.
    linear.to_array().map(|c| FIRST_OF_BYTE.partition_point(|first| *first <= c) as u8)
}

/// The least linear values of the bytes 1 to 255.
static FIRST_OF_BYTE: LazyLock<[f32; 255]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        // Floats of one sign are in the order of their bits.
        let (mut below, mut found) = (0.0f32.to_bits(), 1.0f32.to_bits());
        while found - below > 1 {
            let middle = below + (found - below) / 2;
            let is_less = usize::from(byte(srgb_from_linear(f32::from_bits(middle)))) <= i;
            *(if is_less { &mut below } else { &mut found }) = middle;
        }
        f32::from_bits(found)
    })
});

/// sRGB stops of the color scale at 0, 1/8 … 1: matplotlib's "inferno" (N. Smith and S. van der
/// Walt, 2015), which is perceptually uniform and suitable for color-blind readers.
const INFERNO: [[u8; 3]; 9] = [
    [0, 0, 4],
    [31, 12, 72],
    [85, 15, 109],
    [136, 34, 106],
    [186, 54, 85],
    [227, 89, 51],
    [249, 140, 10],
    [249, 201, 50],
    [252, 255, 164],
];

/// Color of the scale at `value`, which is clamped to `[0, 1]` (NaN is cyan, which the scale does
/// not contain).
pub fn heat_color(value: f32) -> [u8; 3] {
    if value.is_nan() {
        return [0, 255, 255];
    }
    let at = value.clamp(0.0, 1.0) * (INFERNO.len() - 1) as f32;
    let low = (at as usize).min(INFERNO.len() - 2);
    let blend = at - low as f32;
    let (a, b) = (INFERNO[low], INFERNO[low + 1]);
    std::array::from_fn(|c| (f32::from(a[c]) + (f32::from(b[c]) - f32::from(a[c])) * blend).round() as u8)
}

/// The error at the end of the scale of error maps.
pub const LARGEST_ERROR: f32 = 0.25;

/// Map of the errors of a prediction, on a scale that is the same for all pictures: the color at
/// the root of error / [`LARGEST_ERROR`], so that small errors are seen and large ones told apart.
/// An error is the mean absolute difference of the channels, both values clipped to `[0, 1]`, in
/// linear light. Pixels with zero coverage show the mat.
pub fn error_map(
    [width, height]: [usize; 2],
    [prediction, truth]: [&[Vec3]; 2],
    coverage: &[f32],
) -> RgbImage {
    let clipped = |value: Vec3| value.clamp(Vec3::ZERO, Vec3::ONE);
    RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let at = y as usize * width + x as usize;
        let error = (clipped(prediction[at]) - clipped(truth[at])).abs().element_sum() / 3.0;
        Rgb(if coverage[at] > 0.0 { heat_color((error / LARGEST_ERROR).sqrt()) } else { MAT })
    })
}

/// Quality of the JPEGs, 1 to 100: traces of compression are not seen.
const QUALITY: u8 = 85;
/// Bytes that all small pictures of the views of a run may take together.
pub const VIEWS_BUDGET: f64 = 5.5e6;
/// Bytes of a pixel of a picture of an object, about: measured on renders and error maps at
/// [`QUALITY`].
const BYTES_PER_PIXEL: f64 = 0.2;
/// Longest sides: of few pictures, and of so many that the budget is not kept.
const LONGEST: f64 = 512.0;
const SHORTEST: f64 = 96.0;

/// The longest side of each of `count` pictures that are to keep to about `budget` bytes together,
/// in pixels.
pub fn side_within(count: usize, budget: f64) -> u32 {
    let side = (budget / BYTES_PER_PIXEL / count.max(1) as f64).sqrt();
    side.clamp(SHORTEST, LONGEST) as u32
}

/// A JPEG as an address, for a page that holds its pictures.
pub fn jpeg_address(bytes: &[u8]) -> String {
    format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes))
}

/// The size of a picture whose longer side is at most `side` pixels; `None` if it is no larger.
fn smaller((width, height): (u32, u32), side: u32) -> Option<(u32, u32)> {
    let factor = f64::from(side.max(1)) / f64::from(width.max(height).max(1));
    let scaled = |length: u32| ((f64::from(length) * factor).round() as u32).max(1);
    (factor < 1.0).then(|| (scaled(width), scaled(height)))
}

/// A mask at the size of [`thumbnail_jpeg`].
pub fn thumbnail_mask(mask: &GrayImage, side: u32) -> GrayImage {
    smaller(mask.dimensions(), side).map_or_else(|| mask.clone(), |(w, h)| thumbnail(mask, w, h))
}

/// The picture as a JPEG whose longer side is at most `side` pixels; it is never enlarged.
pub fn thumbnail_jpeg(picture: &RgbImage, side: u32) -> Result<Vec<u8>> {
    let small = smaller(picture.dimensions(), side).map(|(w, h)| thumbnail(picture, w, h));
    encode_jpeg(small.as_ref().unwrap_or(picture), QUALITY)
}

/// Writes [`thumbnail_jpeg`] to a file.
pub fn write_thumbnail(path: &Path, picture: &RgbImage, side: u32) -> Result<()> {
    write_bytes(path, &thumbnail_jpeg(picture, side)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::image::decode;
    use image::Luma;

    #[test]
    fn looked_up_bytes_are_those_of_the_curve() {
        for i in 0..100_000 {
            let linear = (i as f32 / 90_000.0).powi(2) - 0.01;
            assert_eq!(srgb8(Vec3::splat(linear))[1], byte(srgb_from_linear(linear)), "{linear}");
        }
        assert_eq!(srgb8(Vec3::new(f32::NAN, f32::NEG_INFINITY, f32::INFINITY)), [0, 0, 255]);
    }

    #[test]
    fn srgb_by_hand() {
        assert_eq!(srgb8(Vec3::new(0.0, 1.0, 2.0)), [0, 255, 255]);
        assert_eq!(srgb8(Vec3::new(0.214_041_14, 0.5, 0.18)), [128, 188, 118]);
        let look = Look { exposure: 1.0, tone: Tone::Srgb };
        assert_eq!(look.develop(Vec3::new(0.25, 0.4, 0.75)), Vec3::new(0.5, 0.8, 1.0));
    }

    #[test]
    fn curves_rise_and_stay_in_range() {
        for tone in [Tone::Srgb, Tone::Filmic, Tone::Neutral] {
            let mut before = Vec3::splat(-1.0);
            for step in 0..400 {
                let value = tone.curve(Vec3::splat((step as f32 * 0.05 - 10.0).exp2()));
                assert!(value.cmpge(before).all() && value.cmple(Vec3::ONE).all(), "{tone:?} {step} {value}");
                before = value;
            }
            assert!(tone.curve(Vec3::ZERO).max_element() < 0.01);
            assert_eq!(tone.curve(Vec3::new(f32::NAN, f32::INFINITY, -1.0)), tone.curve(Vec3::ZERO));
            assert!(tone.curve(Vec3::splat(f32::MAX)).is_finite());
        }
    }

    #[test]
    fn filmic_keeps_mid_gray_and_grays_gray() {
        let gray = Tone::Filmic.curve(Vec3::splat(0.18));
        assert!((gray.x - 0.18).abs() < 0.05, "{gray}");
        assert!(gray.max_element() - gray.min_element() < 1e-3);
        assert!(Tone::Filmic.curve(Vec3::splat(1.0)).x < 0.9, "a white card is below the shoulder's end");
    }

    #[test]
    fn neutral_by_hand() {
        // Dull colors only lose the offset; x < 0.08 lowers by x − 6.25x².
        let value = Tone::Neutral.curve(Vec3::new(0.5, 0.3, 0.2));
        assert!(value.abs_diff_eq(Vec3::new(0.46, 0.26, 0.16), 1e-6), "{value}");
        // peak 4 − 0.04 = 3.96: 1 − 0.24² / (3.96 + 0.24 − 0.76) on gray, which desaturation leaves
        // alone.
        let value = Tone::Neutral.curve(Vec3::splat(4.0));
        assert!((value.x - (1.0 - 0.0576 / 3.44)).abs() < 1e-5, "{value}");
    }

    #[test]
    fn backdrops() {
        let (color, alpha) = ([Vec3::splat(0.25), Vec3::ZERO], [0.5, 0.0]);
        let picture = Picture { width: 2, height: 1, color: &color, alpha: &alpha };
        let shown = |look: Look, backdrop| picture.samples8(&look, backdrop);
        let straight = shown(Look::default(), Backdrop::Transparent).unwrap();
        assert_eq!(straight, [188, 188, 188, 128, 0, 0, 0, 0], "straight color 0.5 at alpha ½");
        let white = shown(Look::default(), Backdrop::Solid(Vec3::ONE)).unwrap();
        assert_eq!(white, [srgb8(Vec3::splat(0.75)), [255; 3]].concat());
        let behind = [Vec3::splat(0.1), Vec3::splat(0.2)];
        let bright = Look { exposure: 1.0, tone: Tone::Srgb };
        let before_light = shown(bright, Backdrop::Radiance(&behind)).unwrap();
        let expected = [2.0 * (0.25 + 0.05), 0.4].map(|gray| srgb8(Vec3::splat(gray)));
        assert_eq!(before_light, expected.concat());
        assert!(shown(bright, Backdrop::Radiance(&behind[..1])).is_err());
        assert_eq!(picture.on_mat().unwrap().get_pixel(1, 0).0, MAT);
    }

    #[test]
    fn a_frame_is_saved_with_straight_alpha() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let (color, alpha) = (vec![Vec3::splat(0.2)], vec![0.4]);
        let frame = Frame { width: 1, height: 1, color, alpha, ..Frame::default() };
        save_png(&path, &frame, &Look::default()).unwrap();
        let read = image::open(&path).unwrap();
        assert_eq!(read.color(), image::ColorType::Rgba8);
        assert_eq!(read.into_rgba8().get_pixel(0, 0).0, [188, 188, 188, 102]);
    }

    #[test]
    fn the_scale_of_errors_ends_and_rises() {
        assert_eq!(heat_color(-1.0), INFERNO[0]);
        assert_eq!(heat_color(2.0), INFERNO[8]);
        assert_eq!(heat_color(0.5), INFERNO[4]);
        let lightness = |v: f32| {
            let [r, g, b] = heat_color(v).map(f32::from);
            0.21 * r + 0.72 * g + 0.07 * b
        };
        assert!((1..=64).all(|i| lightness(i as f32 / 64.0) > lightness((i - 1) as f32 / 64.0)));
    }

    #[test]
    fn an_error_has_its_place_on_the_scale() {
        let (p, t) = (
            [Vec3::new(0.5, 2.0, 0.29), Vec3::ONE, Vec3::ONE],
            [Vec3::new(0.52, 1.0, 0.3), Vec3::ZERO, Vec3::ZERO],
        );
        let map = error_map([3, 1], [&p, &t], &[1.0, 1.0, 0.0]);
        let colors: Vec<[u8; 3]> = map.pixels().map(|pixel| pixel.0).collect();
        assert_eq!(colors, [heat_color(0.2), INFERNO[8], MAT]);
    }

    #[test]
    fn few_pictures_are_large_and_many_keep_to_the_budget() {
        let side_for = |count| side_within(count, VIEWS_BUDGET);
        assert_eq!((side_for(0), side_for(3), side_for(1_000_000)), (512, 512, 96));
        let side = f64::from(side_for(900));
        assert!(side < 200.0 && 900.0 * side * side * BYTES_PER_PIXEL <= VIEWS_BUDGET, "{side}");
    }

    #[test]
    fn thumbnails_keep_their_shape_and_are_not_enlarged() {
        for (size, side, expected) in
            [((40, 20), 512, (40, 20)), ((40, 20), 10, (10, 5)), ((1, 300), 10, (1, 10))]
        {
            let picture = RgbImage::from_pixel(size.0, size.1, Rgb([200, 40, 10]));
            let read = decode(&thumbnail_jpeg(&picture, side).unwrap()).unwrap().to_rgb8();
            let [r, g, b] = read.get_pixel(0, 0).0;
            assert!(r.abs_diff(200) < 6 && g.abs_diff(40) < 6 && b.abs_diff(10) < 6, "{r} {g} {b}");
            let mask = thumbnail_mask(&GrayImage::from_pixel(size.0, size.1, Luma([9])), side);
            assert_eq!((read.dimensions(), mask.dimensions()), (expected, expected));
            assert_eq!(mask.get_pixel(0, 0).0, [9]);
        }
        assert!(thumbnail_jpeg(&RgbImage::new(0, 4), 10).is_err());
    }
}
