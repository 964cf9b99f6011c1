//! A survey as a contact sheet: the cameras from above and from the side, then every view with its mask's outline and its flags.

use crate::math::color::linear_from_srgb;
use crate::math::statistics::median;
use crate::report::sheet::{Sheet, SheetCell, SheetRow, Theme, choose_evenly};
use crate::report::tone::srgb8;
use crate::survey::examine::Survey;
use crate::survey::look::{SmallMask, ViewLook};
use crate::survey::table::verdict;
use crate::view::Split;
use glam::Vec3;
use image::{Rgb, RgbImage};

/// Width of a picture on the sheet, and pictures in a row.
const CELL: u32 = 152;
const COLUMNS: usize = 8;
/// Most views on a sheet; of more, those with flags and some of the others.
const MOST_VIEWS: usize = 160;
/// Pixels a side of a plot of the cameras, and half a side of a dot.
const PLOT: u32 = 2 * CELL;
const DOT: i64 = 2;
/// Luminance of the median of all photographs on the sheet.
const MIDDLE: f32 = 0.18;
const OUTLINE: Rgb<u8> = Rgb([255, 40, 160]);
const TRAIN: Rgb<u8> = Rgb([30, 90, 200]);
const TEST: Rgb<u8> = Rgb([230, 120, 20]);
const FLAGGED: Rgb<u8> = Rgb([210, 20, 20]);

/// The sheet of a survey made with thumbnails.
pub fn contact_sheet(survey: &Survey, title: &str) -> Sheet {
    let mut medians: Vec<f32> = survey
        .looks
        .iter()
        .filter_map(|look| look.light.map(|light| light.median))
        .filter(|m| *m > 0.0)
        .collect();
    let gain = median(&mut medians).map_or(1.0, |median| (MIDDLE / median).clamp(0.0, 1e12));
    let mut rows = plots(survey);
    let shown = shown(survey);
    let cells: Vec<SheetCell> = shown.iter().map(|&i| cell(survey, i, gain)).collect();
    for (i, row) in cells.chunks(COLUMNS).enumerate() {
        let heading = match (i, shown.len() == survey.looks.len()) {
            (0, true) => format!("{} views", shown.len()),
            (0, false) => format!("{} of {} views", shown.len(), survey.looks.len()),
            _ => String::new(),
        };
        rows.push(SheetRow { heading, cells: row.to_vec() });
    }
    Sheet {
        title: title.to_owned(),
        subtitle: verdict(Some(survey), 0),
        rows,
        theme: Theme::Light,
        cell_width: CELL,
        ..Sheet::default()
    }
}

/// Names of the findings that tell a view from the others.
fn marks(survey: &Survey, view: &str) -> Vec<&'static str> {
    let is_of_few = |name: &&'static str| {
        let findings = survey.findings.iter().filter(|finding| finding.name == *name);
        findings.map(|finding| finding.views.len()).max() <= Some(survey.looks.len() / 2)
    };
    survey.flags(view).into_iter().filter(is_of_few).collect()
}

/// All views, or those with flags and some of the others.
fn shown(survey: &Survey) -> Vec<usize> {
    let flagged: Vec<bool> = survey.looks.iter().map(|look| !marks(survey, &look.name).is_empty()).collect();
    let (with, without): (Vec<usize>, Vec<usize>) = (0..flagged.len()).partition(|&i| flagged[i]);
    let mut shown: Vec<usize> = with.into_iter().take(MOST_VIEWS).collect();
    let room = MOST_VIEWS - shown.len();
    shown.extend(choose_evenly(without.len(), room).into_iter().map(|k| without[k]));
    shown.sort_unstable();
    shown
}

fn cell(survey: &Survey, i: usize, gain: f32) -> SheetCell {
    let look = &survey.looks[i];
    let flags = marks(survey, &look.name);
    let is_plain = look.split == Split::Train || look.name.starts_with("test/");
    let split = if is_plain { "" } else { " (test)" };
    let label = if flags.is_empty() {
        format!("{}{split}", look.name)
    } else {
        format!("{}: {}", look.name, flags.join(", "))
    };
    let mut image = picture(look, gain);
    if let Some(mask) = &look.mask {
        outline(&mut image, &mask.small);
    }
    if !flags.is_empty() {
        frame(&mut image);
    }
    SheetCell { label, image }
}

/// The thumbnail, as bright as the others of the same exposure; a gray one of the right shape if there is none.
fn picture(look: &ViewLook, gain: f32) -> RgbImage {
    let Some(thumbnail) = &look.thumbnail else {
        let [width, height] = look.size;
        let height =
            (u64::from(CELL) * u64::from(height) / u64::from(width.max(1))).clamp(1, 4 * u64::from(CELL));
        return RgbImage::from_pixel(CELL, height as u32, Rgb(Theme::Light.mat()));
    };
    let mut picture = thumbnail.picture.clone();
    for pixel in picture.pixels_mut() {
        let linear = Vec3::from(pixel.0.map(|value| linear_from_srgb(f32::from(value) / 255.0)));
        *pixel = Rgb(srgb8(linear * thumbnail.white * gain));
    }
    picture
}

/// Colors the pixels on the border of the mask, just inside it.
fn outline(picture: &mut RgbImage, mask: &SmallMask) {
    let (width, height) = picture.dimensions();
    let inside = |x: i64, y: i64| {
        if x < 0 || y < 0 || x >= i64::from(width) || y >= i64::from(height) {
            return false;
        }
        let column = x as u64 * u64::from(mask.camera.width) / u64::from(width);
        let row = y as u64 * u64::from(mask.camera.height) / u64::from(height);
        mask.inside[(row * u64::from(mask.camera.width) + column) as usize]
    };
    for y in 0..i64::from(height) {
        for x in 0..i64::from(width) {
            let neighbors = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)];
            if inside(x, y) && neighbors.iter().any(|&(x, y)| !inside(x, y)) {
                picture.put_pixel(x as u32, y as u32, OUTLINE);
            }
        }
    }
}

/// A red frame.
fn frame(picture: &mut RgbImage) {
    let (width, height) = picture.dimensions();
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        if x < 2 || y < 2 || x + 2 >= width || y + 2 >= height {
            *pixel = FLAGGED;
        }
    }
}

/// The cameras around what they look at, from above and from the side.
fn plots(survey: &Survey) -> Vec<SheetRow> {
    let Some(arrangement) = &survey.arrangement else { return Vec::new() };
    let (side, front) = arrangement.axis.any_orthonormal_pair();
    let plot = |label: &str, across: Vec3, up: Vec3| {
        let mut image = RgbImage::from_pixel(PLOT, PLOT, Rgb(Theme::Light.mat()));
        let reach = arrangement.distance[1].max(f32::MIN_POSITIVE) * 1.08;
        let at = |point: Vec3| {
            let offset = (point - arrangement.target) / reach;
            let place = |along: f32| (0.5 * f64::from(PLOT) * (1.0 + f64::from(along))) as i64;
            (place(offset.dot(across)), place(-offset.dot(up)))
        };
        dot(&mut image, at(arrangement.target), 3 * DOT, Rgb([90, 90, 90]));
        for look in &survey.looks {
            let flagged = !marks(survey, &look.name).is_empty();
            let of_split = if look.split == Split::Train { TRAIN } else { TEST };
            dot(&mut image, at(look.camera.position()), DOT, if flagged { FLAGGED } else { of_split });
        }
        SheetCell { label: label.to_owned(), image }
    };
    let cells = vec![
        plot("from above", side, front),
        plot("from the front", side, arrangement.axis),
        plot("from the side", front, arrangement.axis),
    ];
    vec![SheetRow { heading: format!("cameras: {}", arrangement.words()), cells }]
}

fn dot(picture: &mut RgbImage, (x, y): (i64, i64), half: i64, color: Rgb<u8>) {
    for row in (y - half).max(0)..=(y + half).min(i64::from(PLOT) - 1) {
        for column in (x - half).max(0)..=(x + half).min(i64::from(PLOT) - 1) {
            picture.put_pixel(column as u32, row as u32, color);
        }
    }
}
