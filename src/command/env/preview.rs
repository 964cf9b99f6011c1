//! What `lobelia env` shows of lights: maps as pictures.

use glam::Vec3;
use image::{Rgb, RgbImage, imageops};
use lobelia::light::map_fit::MapFitReport;
use lobelia::light::{EnvironmentMap, render_lobes};
use lobelia::math::color::luminance;
use lobelia::report::font::{draw_text, line_height};
use lobelia::report::tone::{Tone, srgb8};
use std::f64::consts::PI;

/// Mid-gray, which the geometric mean luminance of a previewed map is brought to.
const KEY: f32 = 0.18;
/// Size of the text in pictures, pixels per font dot.
const TEXT_SIZE: f32 = 2.0;
/// Widest picture of a fit, in pixels; two stand one above the other.
const WIDEST_PICTURE: u32 = 1024;

/// Factor on a map's radiance for a preview: brings the solid-angle-weighted geometric mean luminance to mid-gray
/// (Reinhard et al. 2002, eq. 1).
pub fn preview_factor(map: &EnvironmentMap) -> f32 {
    let mean = f64::from(luminance(map.power().as_vec3())) / (4.0 * PI);
    if mean <= 0.0 {
        return 1.0;
    }
    let row = |(j, row): (usize, &[Vec3])| -> f64 {
        let logs: f64 = row.iter().map(|&r| (f64::from(luminance(r)) + 1e-3 * mean).ln()).sum();
        logs * map.texel_solid_angle(j as u32)
    };
    let logs: f64 = map.radiance.chunks_exact(map.width as usize).enumerate().map(row).sum();
    KEY / (logs / (4.0 * PI)).exp() as f32
}

/// A map as an 8-bit picture, its radiance multiplied by `factor`.
pub fn picture(map: &EnvironmentMap, factor: f32) -> RgbImage {
    let texel = |x: u32, y: u32| {
        let radiance = map.radiance[(y * map.width + x) as usize];
        Rgb(srgb8(Tone::Neutral.curve(radiance * factor)))
    };
    RgbImage::from_fn(map.width, map.height, texel)
}

/// The map above, what the lobes make of it below, each with a line of text.
pub fn before_and_after(map: &EnvironmentMap, report: &MapFitReport) -> RgbImage {
    let factor = preview_factor(map);
    let narrow = map.downsampled(map.width.min(WIDEST_PICTURE), map.height.min(WIDEST_PICTURE / 2));
    let after = render_lobes(&report.lobes, narrow.width, narrow.height);
    let mut both = RgbImage::new(narrow.width, 2 * narrow.height);
    imageops::replace(&mut both, &picture(&narrow, factor), 0, 0);
    imageops::replace(&mut both, &picture(&after, factor), 0, i64::from(narrow.height));
    let line = line_height(TEXT_SIZE) + 6;
    let text = format!("{} lobes, mean squared error {:.3e}", report.used, report.mse);
    for (bottom, text) in [(narrow.height, "map"), (2 * narrow.height, text.as_str())] {
        draw_text(&mut both, [8, bottom.saturating_sub(line)], TEXT_SIZE, [255; 3], text);
    }
    both
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia::light::LightLobe;
    use lobelia::light::map_fit::{MapFit, fit_map};

    fn lobes() -> Vec<LightLobe> {
        let lobe = |axis, sharpness, gray| LightLobe { axis, sharpness, amplitude: Vec3::splat(gray) };
        vec![lobe(Vec3::Y, 1.0, 0.5), lobe(Vec3::X, 40.0, 9.0), lobe(Vec3::Z, 3.0, 0.0)]
    }

    #[test]
    fn the_picture_of_a_fit_shows_both() {
        let map = render_lobes(&lobes(), 64, 32);
        let options = MapFit { working_width: 64, polish_width: 64, ..MapFit::default() };
        let report = fit_map(&map, 3, &options).unwrap();
        let both = before_and_after(&map, &report);
        assert_eq!(both.dimensions(), (64, 64));
        let differs = |x: u32, y: u32| {
            let (a, b) = (both.get_pixel(x, y), both.get_pixel(x, y + 32));
            (0..3).map(|c| a[c].abs_diff(b[c])).max().unwrap_or(0)
        };
        assert!((0..64).all(|x| differs(x, 4) < 24));
        let black = map.scaled(Vec3::ZERO);
        assert_eq!(preview_factor(&black), 1.0);
        assert_eq!(picture(&black, 1.0).get_pixel(0, 0).0, [0; 3]);
    }
}
