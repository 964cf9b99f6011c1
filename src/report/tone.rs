//! Conversion of linear radiance to a picture: exposure, tone curve, backdrop, 8-bit sRGB.

use crate::codec::exr_frame::Frame;
use crate::codec::png_file::{self, PngRows};
use crate::math::color::srgb_from_linear;
use crate::{Error, Result};
use glam::{Mat3, Vec3};
use image::{RgbImage, RgbaImage};
use png::ColorType;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::LazyLock;

/// Tone mapping of linear radiance to the range of a display.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Tone {
    /// Clipped at 1: values in range are shown exactly.
    #[default]
    Srgb,
    /// A film-like shoulder and toe: S. Hill's fit of the ACES RRT and ODT (BakingLab, `ACES.hlsl`, 2016),
    /// pre-scaled by 1/0.6 so that mid-gray stays about the same.
    Filmic,
    /// Exact up to about 0.76 and then compressed toward white, hue preserved: the Khronos PBR Neutral tone mapper (2024).
    /// Best for judging materials under a bright light.
    Neutral,
}

impl Tone {
    /// Display-referred linear value, in `[0, 1]`, of a scene-referred one. Non-finite and negative parts count as 0.
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
    // Rows of the published matrices (sRGB → XYZ → D65_2_D60 → AP1 → RRT_SAT, and ODT_SAT → … → sRGB), so transposed here.
    let aces_from_srgb = Mat3::from_cols_array_2d(&[
        [0.59719, 0.35458, 0.04823],
        [0.07600, 0.90834, 0.01566],
        [0.02840, 0.13383, 0.83777],
    ])
    .transpose();
    let srgb_from_aces = Mat3::from_cols_array_2d(&[
        [1.60475, -0.53108, -0.07367],
        [-0.10208, 1.10813, -0.00605],
        [-0.00327, -0.07276, 1.07602],
    ])
    .transpose();
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
#[derive(Clone, Copy, Debug, Default)]
#[non_exhaustive]
pub enum Backdrop<'a> {
    /// None: straight alpha.
    #[default]
    Transparent,
    /// One display-referred linear color in `[0, 1]`, without exposure and tone curve.
    Solid(Vec3),
    /// The radiance behind each pixel (the environment), with the exposure and tone curve of the object.
    Radiance(&'a [Vec3]),
}

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

    /// 8-bit sRGB with straight alpha (255 throughout unless the backdrop is transparent).
    ///
    /// # Errors
    /// [`Error::Run`] if a list does not have `width * height` entries.
    pub fn rgba8(&self, look: &Look, backdrop: Backdrop) -> Result<RgbaImage> {
        self.check(backdrop)?;
        let samples = self.samples(|at| {
            let (value, alpha) = self.shown(at, look, backdrop);
            let [r, g, b] = srgb8(value);
            [r, g, b, byte(alpha)]
        });
        let [width, height] = [self.width, self.height].map(|side| side as u32);
        Ok(RgbaImage::from_raw(width, height, samples).expect("there are as many samples"))
    }

    /// 8-bit sRGB, opaque; a transparent backdrop is black.
    ///
    /// # Errors
    /// [`Error::Run`] if a list does not have `width * height` entries.
    pub fn rgb8(&self, look: &Look, backdrop: Backdrop) -> Result<RgbImage> {
        let backdrop = match backdrop {
            Backdrop::Transparent => Backdrop::Solid(Vec3::ZERO),
            other => other,
        };
        self.check(backdrop)?;
        let samples = self.samples(|at| srgb8(self.shown(at, look, backdrop).0));
        let [width, height] = [self.width, self.height].map(|side| side as u32);
        Ok(RgbImage::from_raw(width, height, samples).expect("there are as many samples"))
    }

    /// The samples of all pixels, in order.
    fn samples<const CHANNELS: usize>(&self, pixel: impl Fn(usize) -> [u8; CHANNELS] + Sync) -> Vec<u8> {
        let mut pixels = vec![[0; CHANNELS]; self.width * self.height];
        pixels.par_iter_mut().enumerate().with_min_len(4096).for_each(|(at, out)| *out = pixel(at));
        pixels.into_flattened()
    }

    /// The samples of a PNG: those of [`Picture::rgba8`] for a transparent backdrop, else those of [`Picture::rgb8`].
    ///
    /// # Errors
    /// [`Error::Run`] if a list does not have `width * height` entries.
    pub fn samples8(&self, look: &Look, backdrop: Backdrop) -> Result<Vec<u8>> {
        match backdrop {
            Backdrop::Transparent => Ok(self.rgba8(look, backdrop)?.into_raw()),
            _ => Ok(self.rgb8(look, backdrop)?.into_raw()),
        }
    }

    /// Display-referred linear value and alpha of a pixel.
    fn shown(&self, at: usize, look: &Look, backdrop: Backdrop) -> (Vec3, f32) {
        let (color, alpha) = (self.color[at], self.alpha[at].clamp(0.0, 1.0));
        // The color of the object for full coverage; the curve applies to this color, not to its mixture with black.
        let straight = if alpha > 1e-4 { color / alpha } else { color };
        match backdrop {
            Backdrop::Transparent => (look.develop(straight), alpha),
            Backdrop::Solid(solid) => (solid.lerp(look.develop(straight), alpha), 1.0),
            Backdrop::Radiance(behind) => (look.develop(color + (1.0 - alpha) * behind[at]), 1.0),
        }
    }

    fn check(&self, backdrop: Backdrop) -> Result<()> {
        let count = self.width * self.height;
        let behind = if let Backdrop::Radiance(behind) = backdrop { behind.len() } else { count };
        for (what, len) in [("color", self.color.len()), ("alpha", self.alpha.len()), ("backdrop", behind)] {
            if len != count {
                let problem = format!("the {what} has {len} pixels, not {} × {}", self.width, self.height);
                return Err(Error::run("developing a picture", problem));
            }
        }
        Ok(())
    }
}

/// Writes a rendered frame as an 8-bit sRGB PNG with straight alpha, and creates its folder.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written.
pub fn save_png(path: impl AsRef<Path>, frame: &Frame, look: &Look) -> Result<()> {
    write_png(path, &Picture::of(frame), look, Backdrop::Transparent)
}

/// Writes `picture` as an 8-bit sRGB PNG: RGBA with straight alpha for a transparent backdrop, else RGB.
///
/// # Errors
/// [`Error::Run`] for lists of the wrong length, [`Error::Io`] if the file cannot be written.
pub fn write_png(path: impl AsRef<Path>, picture: &Picture, look: &Look, backdrop: Backdrop) -> Result<()> {
    let size = [picture.width as u32, picture.height as u32];
    write_png_rows(path, size, matches!(backdrop, Backdrop::Transparent), None, |rows| {
        rows.push(&picture.samples8(look, backdrop)?)
    })
}

/// [`write_png`] for a picture of `size` (width, height) that is never whole in memory: `fill` pushes [`Picture::samples8`] of its bands
/// from the top, all with a `transparent` backdrop or none. A `comment` says something about it, to those who look at the file
/// ([`comment_of`](crate::codec::png_file::comment_of)).
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Run`] for an empty picture, and those of `rows`.
pub fn write_png_rows(
    path: impl AsRef<Path>,
    size: [u32; 2],
    transparent: bool,
    comment: Option<&str>,
    fill: impl FnOnce(&mut PngRows) -> Result<()>,
) -> Result<()> {
    let color = if transparent { ColorType::Rgba } else { ColorType::Rgb };
    png_file::write_rows(path, size, color, comment, fill)
}

fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}

/// 8-bit sRGB of a display-referred linear value, which is clipped to `[0, 1]`.
pub fn srgb8(linear: Vec3) -> [u8; 3] {
    // Which byte a value becomes is looked up: a power for each channel of each pixel would take a tenth of the time of a film.
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

#[cfg(test)]
mod tests {
    use super::*;

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
        // peak 4 − 0.04 = 3.96: 1 − 0.24² / (3.96 + 0.24 − 0.76) on gray, which desaturation leaves alone.
        let value = Tone::Neutral.curve(Vec3::splat(4.0));
        assert!((value.x - (1.0 - 0.0576 / 3.44)).abs() < 1e-5, "{value}");
    }

    #[test]
    fn backdrops() {
        let (color, alpha) = ([Vec3::splat(0.25), Vec3::ZERO], [0.5, 0.0]);
        let picture = Picture { width: 2, height: 1, color: &color, alpha: &alpha };
        let look = Look::default();
        let shown = picture.rgba8(&look, Backdrop::Transparent).unwrap();
        assert_eq!(shown.get_pixel(0, 0).0, [188, 188, 188, 128], "straight color 0.5 at alpha ½");
        assert_eq!(shown.get_pixel(1, 0).0, [0, 0, 0, 0]);
        let shown = picture.rgb8(&look, Backdrop::Solid(Vec3::ONE)).unwrap();
        assert_eq!(shown.get_pixel(0, 0).0, srgb8(Vec3::splat(0.75)));
        assert_eq!(shown.get_pixel(1, 0).0, [255, 255, 255]);
        let behind = [Vec3::splat(0.1), Vec3::splat(0.2)];
        let bright = Look { exposure: 1.0, tone: Tone::Srgb };
        let shown = picture.rgb8(&bright, Backdrop::Radiance(&behind)).unwrap();
        assert_eq!(shown.get_pixel(0, 0).0, srgb8(Vec3::splat(2.0 * (0.25 + 0.05))));
        assert_eq!(shown.get_pixel(1, 0).0, srgb8(Vec3::splat(0.4)));
        assert!(picture.rgb8(&look, Backdrop::Radiance(&behind[..1])).is_err());
        assert_eq!(picture.rgb8(&look, Backdrop::Transparent).unwrap().get_pixel(1, 0).0, [0, 0, 0]);
    }

    #[test]
    fn png_has_alpha_only_when_transparent() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let picture = Picture { width: 1, height: 1, color: &[Vec3::splat(0.2)], alpha: &[0.4] };
        write_png(&path, &picture, &Look::default(), Backdrop::Transparent).unwrap();
        let read = image::open(&path).unwrap();
        assert_eq!(read.color(), image::ColorType::Rgba8);
        assert_eq!(read.into_rgba8().get_pixel(0, 0).0, [188, 188, 188, 102]);
        write_png(&path, &picture, &Look::default(), Backdrop::Solid(Vec3::ZERO)).unwrap();
        assert_eq!(image::open(&path).unwrap().color(), image::ColorType::Rgb8);
    }
}
