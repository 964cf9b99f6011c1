//! Contact sheets: rows of labeled pictures under headings, as one PNG.

use crate::codec::png_file;
use crate::report::{font, heat};
use crate::{Error, Result};
use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use std::path::Path;

/// A picture with its caption.
#[derive(Clone, Debug)]
pub struct SheetCell {
    /// Caption below the picture; may be empty.
    pub label: String,
    /// The picture, sRGB.
    pub image: RgbImage,
}

/// Pictures side by side.
#[derive(Clone, Debug, Default)]
pub struct SheetRow {
    /// Heading of the row (a pass and its scores); empty for a row that continues the one above.
    pub heading: String,
    /// From left to right.
    pub cells: Vec<SheetCell>,
}

/// Colors of a sheet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Theme {
    /// Light neutral gray.
    #[default]
    Light,
    /// Dark neutral gray.
    Dark,
}

impl Theme {
    /// Background, sRGB; also a suitable backdrop for pictures of the object.
    pub fn background(self) -> [u8; 3] {
        match self {
            Self::Light => [244, 244, 242],
            Self::Dark => [38, 38, 40],
        }
    }

    /// Background of a cell, sRGB: slightly different from the page, so that cells are visible.
    pub fn mat(self) -> [u8; 3] {
        match self {
            Self::Light => [228, 228, 225],
            Self::Dark => [54, 54, 57],
        }
    }

    fn ink(self) -> [u8; 3] {
        match self {
            Self::Light => [32, 32, 34],
            Self::Dark => [238, 238, 236],
        }
    }

    fn faint_ink(self) -> [u8; 3] {
        match self {
            Self::Light => [104, 104, 106],
            Self::Dark => [166, 166, 164],
        }
    }

    fn rule(self) -> [u8; 3] {
        match self {
            Self::Light => [206, 206, 203],
            Self::Dark => [78, 78, 82],
        }
    }
}

/// A contact sheet.
#[derive(Clone, Debug)]
pub struct Sheet {
    /// Large line at the top; may be empty.
    pub title: String,
    /// Small line under it; may be empty.
    pub subtitle: String,
    /// From top to bottom.
    pub rows: Vec<SheetRow>,
    /// Colors.
    pub theme: Theme,
    /// Width in pixels of every picture; the aspect ratio is kept.
    pub cell_width: u32,
    /// The factor of the error maps, if the sheet has any; the color scale is then drawn at the bottom.
    pub heat_factor: Option<f32>,
}

impl Default for Sheet {
    fn default() -> Self {
        Self {
            title: String::new(),
            subtitle: String::new(),
            rows: Vec::new(),
            theme: Theme::Light,
            cell_width: 256,
            heat_factor: None,
        }
    }
}

/// Space around everything, between pictures, and between lines, in pixels.
const MARGIN: u32 = 28;
const GUTTER: u32 = 14;
const GAP: u32 = 8;
/// Pixels per font dot of title, headings and captions.
const TITLE: f32 = 3.5;
const HEADING: f32 = 2.25;
const LABEL: f32 = 1.75;
/// Largest width and height of the sheet in pixels.
const MOST_SIDE: u32 = 32_000;

/// At most `most` of `count` views, evenly spaced, including the first and the last.
pub(crate) fn choose_evenly(count: usize, most: usize) -> Vec<usize> {
    match (count, most) {
        (0, _) | (_, 0) => Vec::new(),
        (_, 1) => vec![0],
        _ if count <= most => (0..count).collect(),
        _ => (0..most).map(|i| (i * (count - 1) + (most - 1) / 2) / (most - 1)).collect(),
    }
}

/// Composes `sheet` and writes it as a PNG.
///
/// # Errors
/// Those of [`compose`]; [`Error::Io`] if the file cannot be written.
pub fn write_sheet(path: impl AsRef<Path>, sheet: &Sheet) -> Result<()> {
    png_file::write_rgb8(path, &compose(sheet)?)
}

/// The sheet as a picture.
///
/// # Errors
/// [`Error::Run`] if there is no cell, a picture is empty, `cell_width` is below 16, or the sheet would be over 32 000 pixels wide or high.
pub fn compose(sheet: &Sheet) -> Result<RgbImage> {
    let layout = Layout::new(sheet)?;
    let mut page = RgbImage::from_pixel(layout.width, layout.height, Rgb(sheet.theme.background()));
    let mut top = draw_head(&mut page, sheet);
    for (row, height) in sheet.rows.iter().zip(&layout.row_heights) {
        draw_row(&mut page, sheet, row, top);
        top += height;
    }
    if let Some(factor) = sheet.heat_factor {
        draw_scale(&mut page, sheet.theme, factor, top);
    }
    Ok(page)
}

struct Layout {
    width: u32,
    height: u32,
    row_heights: Vec<u32>,
}

impl Layout {
    fn new(sheet: &Sheet) -> Result<Self> {
        let refuse = |problem: &str| Err(Error::run("drawing a contact sheet", problem));
        let most_cells = sheet.rows.iter().map(|row| row.cells.len()).max().unwrap_or(0) as u64;
        if most_cells == 0 {
            return refuse("there is nothing to show");
        }
        if sheet.cell_width < 16 {
            return refuse("cells must be at least 16 pixels wide");
        }
        let empty = |cell: &SheetCell| cell.image.width() == 0 || cell.image.height() == 0;
        if sheet.rows.iter().any(|row| row.cells.iter().any(empty)) {
            return refuse("a picture has no pixels");
        }
        let pictures = most_cells * u64::from(sheet.cell_width) + (most_cells - 1) * u64::from(GUTTER);
        let width = 2 * u64::from(MARGIN) + pictures.max(u64::from(text_room(sheet)));
        let row_heights: Vec<u32> = sheet.rows.iter().map(|row| row_height(sheet, row)).collect();
        let rows: u64 = row_heights.iter().map(|&height| u64::from(height)).sum();
        let foot = if sheet.heat_factor.is_some() { scale_height() } else { 0 };
        let height = u64::from(head_height(sheet)) + rows + u64::from(foot + MARGIN);
        if width.max(height) > u64::from(MOST_SIDE) {
            return refuse("it would be too large; show fewer views or smaller cells");
        }
        Ok(Self { width: width as u32, height: height as u32, row_heights })
    }
}

/// Width of titles and headings; a narrow sheet is widened for them, up to a limit.
fn text_room(sheet: &Sheet) -> u32 {
    let headings = sheet.rows.iter().map(|row| font::text_width(&row.heading, HEADING)).max().unwrap_or(0);
    let head = font::text_width(&sheet.title, TITLE).max(font::text_width(&sheet.subtitle, LABEL));
    headings.max(head).min(1600)
}

fn head_height(sheet: &Sheet) -> u32 {
    let mut height = MARGIN;
    if !sheet.title.is_empty() {
        height += font::line_height(TITLE) + GAP;
    }
    if !sheet.subtitle.is_empty() {
        height += font::line_height(LABEL) + GAP;
    }
    height
}

fn draw_head(page: &mut RgbImage, sheet: &Sheet) -> u32 {
    let room = page.width() - 2 * MARGIN;
    let mut top = MARGIN;
    if !sheet.title.is_empty() {
        let text = font::fitted(&sheet.title, TITLE, room);
        font::draw_text(page, [MARGIN, top], TITLE, sheet.theme.ink(), &text);
        top += font::line_height(TITLE) + GAP;
    }
    if !sheet.subtitle.is_empty() {
        let text = font::fitted(&sheet.subtitle, LABEL, room);
        font::draw_text(page, [MARGIN, top], LABEL, sheet.theme.faint_ink(), &text);
    }
    head_height(sheet)
}

fn heading_height(row: &SheetRow) -> u32 {
    if row.heading.is_empty() { 0 } else { 2 * GAP + 1 + font::line_height(HEADING) + GAP }
}

fn label_height(row: &SheetRow) -> u32 {
    let labeled = row.cells.iter().any(|cell| !cell.label.is_empty());
    if labeled { GAP + font::line_height(LABEL) } else { 0 }
}

fn cell_height(cell: &SheetCell, width: u32) -> u32 {
    let (w, h) = (u64::from(cell.image.width()), u64::from(cell.image.height()));
    ((u64::from(width) * h + w / 2) / w).clamp(1, u64::from(MOST_SIDE)) as u32
}

fn picture_height(sheet: &Sheet, row: &SheetRow) -> u32 {
    row.cells.iter().map(|cell| cell_height(cell, sheet.cell_width)).max().unwrap_or(0)
}

fn row_height(sheet: &Sheet, row: &SheetRow) -> u32 {
    heading_height(row) + picture_height(sheet, row) + label_height(row) + GUTTER
}

fn draw_row(page: &mut RgbImage, sheet: &Sheet, row: &SheetRow, top: u32) {
    if !row.heading.is_empty() {
        fill(page, [MARGIN, top + GAP, page.width() - 2 * MARGIN, 1], sheet.theme.rule());
        let text = font::fitted(&row.heading, HEADING, page.width() - 2 * MARGIN);
        font::draw_text(page, [MARGIN, top + 2 * GAP + 1], HEADING, sheet.theme.ink(), &text);
    }
    let top = top + heading_height(row);
    let label_top = top + picture_height(sheet, row) + GAP;
    for (i, cell) in row.cells.iter().enumerate() {
        let left = MARGIN + i as u32 * (sheet.cell_width + GUTTER);
        let picture = resized(&cell.image, sheet.cell_width, cell_height(cell, sheet.cell_width));
        imageops::replace(page, &picture, i64::from(left), i64::from(top));
        let text = font::fitted(&cell.label, LABEL, sheet.cell_width);
        font::draw_text(page, [left, label_top], LABEL, sheet.theme.faint_ink(), &text);
    }
}

/// Enlarged by an integer factor if that fits exactly, else resampled smoothly.
fn resized(picture: &RgbImage, width: u32, height: u32) -> RgbImage {
    let exact = width.is_multiple_of(picture.width()) && height.is_multiple_of(picture.height());
    let filter = if exact { FilterType::Nearest } else { FilterType::CatmullRom };
    imageops::resize(picture, width, height, filter)
}

const SCALE_WIDTH: u32 = 220;
const SCALE_BAR: u32 = 12;

fn scale_height() -> u32 {
    GAP + SCALE_BAR + GAP + font::line_height(LABEL)
}

/// The color scale of the error maps: a bar from 0 to 1 / factor.
fn draw_scale(page: &mut RgbImage, theme: Theme, factor: f32, top: u32) {
    let top = top + GAP;
    let width = SCALE_WIDTH.min(page.width() - 2 * MARGIN);
    for x in 0..width {
        fill(page, [MARGIN + x, top, 1, SCALE_BAR], heat::heat_color(x as f32 / (width - 1) as f32));
    }
    let text_top = top + SCALE_BAR + GAP;
    let end = format!("{}", (1000.0 / factor).round() / 1000.0);
    let end_left = MARGIN + width.saturating_sub(font::text_width(&end, LABEL));
    font::draw_text(page, [MARGIN, text_top], LABEL, theme.faint_ink(), "0");
    font::draw_text(page, [end_left, text_top], LABEL, theme.faint_ink(), &end);
    let caption = format!("error (mean of |R|, |G|, |B| differences, linear), amplified ×{factor}");
    let caption_left = MARGIN + width + GUTTER;
    let room = (page.width() - MARGIN).saturating_sub(caption_left);
    let caption = font::fitted(&caption, LABEL, room);
    font::draw_text(page, [caption_left, top], LABEL, theme.faint_ink(), &caption);
}

/// Fills the rectangle `[left, top, width, height]`, clipped to the page.
fn fill(page: &mut RgbImage, [left, top, width, height]: [u32; 4], color: [u8; 3]) {
    for y in top..(top + height).min(page.height()) {
        for x in left..(left + width).min(page.width()) {
            page.put_pixel(x, y, Rgb(color));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(label: &str, size: [u32; 2], color: [u8; 3]) -> SheetCell {
        SheetCell { label: label.to_owned(), image: RgbImage::from_pixel(size[0], size[1], Rgb(color)) }
    }

    #[test]
    fn views_are_chosen_evenly() {
        assert_eq!(choose_evenly(3, 5), [0, 1, 2]);
        assert_eq!(choose_evenly(200, 5), [0, 50, 100, 149, 199]);
        assert_eq!(choose_evenly(10, 1), [0]);
        assert!(choose_evenly(0, 4).is_empty() && choose_evenly(4, 0).is_empty());
        for (count, most) in [(7, 6), (100, 99), (31, 2)] {
            let chosen = choose_evenly(count, most);
            assert_eq!((chosen.len(), chosen[0], chosen[most - 1]), (most, 0, count - 1));
            assert!(chosen.is_sorted_by(|a, b| a < b));
        }
    }

    #[test]
    fn pictures_stand_where_the_layout_says() {
        let mut sheet = Sheet { cell_width: 40, theme: Theme::Dark, ..Sheet::default() };
        sheet.rows.push(SheetRow {
            heading: String::new(),
            cells: vec![cell("", [20, 10], [200, 0, 0]), cell("", [40, 80], [0, 200, 0])],
        });
        let page = compose(&sheet).unwrap();
        assert_eq!(page.dimensions(), (2 * MARGIN + 2 * 40 + GUTTER, 2 * MARGIN + 80 + GUTTER));
        assert_eq!(page.get_pixel(MARGIN + 39, MARGIN + 19).0, [200, 0, 0], "shape kept: 40 × 20");
        assert_eq!(page.get_pixel(MARGIN + 39, MARGIN + 20).0, Theme::Dark.background());
        assert_eq!(page.get_pixel(MARGIN + 40 + GUTTER, MARGIN + 79).0, [0, 200, 0]);
    }

    #[test]
    fn text_and_scale_are_drawn() {
        let rows = vec![SheetRow {
            heading: "novel · 41.6 dB".into(),
            cells: vec![cell("truth", [64, 64], [90; 3])],
        }];
        let plain = Sheet { rows: rows.clone(), cell_width: 64, ..Sheet::default() };
        let full = Sheet {
            title: "sphere".into(),
            subtitle: "two lines".into(),
            heat_factor: Some(8.0),
            ..plain.clone()
        };
        let (plain, full) = (compose(&plain).unwrap(), compose(&full).unwrap());
        assert!(full.height() > plain.height());
        let dark = |page: &RgbImage| page.pixels().filter(|p| p.0 == Theme::Light.ink()).count();
        assert!(dark(&plain) > 50 && dark(&full) > dark(&plain));
        let hottest = Rgb(heat::heat_color(1.0));
        assert!(full.pixels().any(|&p| p == hottest) && !plain.pixels().any(|&p| p == hottest));
    }

    #[test]
    fn impossible_sheets_are_refused() {
        assert!(compose(&Sheet::default()).is_err());
        let with = |cells: Vec<SheetCell>, cell_width| Sheet {
            rows: vec![SheetRow { heading: String::new(), cells }],
            cell_width,
            ..Sheet::default()
        };
        assert!(compose(&with(vec![cell("", [0, 4], [0; 3])], 64)).is_err());
        assert!(compose(&with(vec![cell("", [4, 4], [0; 3])], 0)).is_err());
        assert!(compose(&with(vec![cell("", [1, 4000], [0; 3])], 64)).is_err());
        assert!(compose(&with(vec![cell("", [4, 4], [0; 3])], u32::MAX)).is_err());
    }
}
