//! Contact sheets: rows of labeled pictures under headings, as one PNG; and the text on them.
//!
//! Text is of a built-in 5×7 bitmap font. Each glyph is enlarged eightfold by the Scale2x rule (A.
//! Mazzoleni, 2001), applied three times, which rounds its corners, and then averaged down to the
//! requested size, so that letters have smooth edges.

use image::{Rgb, RgbImage, imageops, imageops::FilterType};
use lobelia_geometry::{Error, Result};
use lobelia_io::codec::png_file;
use std::path::Path;

/// Pictures side by side under a heading.
pub(crate) struct SheetRow {
    /// A pass and its scores.
    pub heading: String,
    /// Captions and pictures (sRGB), from left to right.
    pub cells: Vec<(String, RgbImage)>,
}

/// Light neutral grays, sRGB: of the page, of text, of captions and of lines.
const BACKGROUND: [u8; 3] = [244, 244, 242];
const INK: [u8; 3] = [32, 32, 34];
const FAINT_INK: [u8; 3] = [104, 104, 106];
const RULE: [u8; 3] = [206, 206, 203];
/// Width of every picture in pixels.
const CELL: u32 = 256;
/// Space around everything, between pictures, and between lines, in pixels.
const MARGIN: u32 = 28;
const GUTTER: u32 = 14;
const GAP: u32 = 8;
/// Pixels per font dot of title, headings and captions.
const TITLE: f32 = 3.5;
const HEADING: f32 = 2.25;
const LABEL: f32 = 1.75;
/// Most pixels by which titles and headings widen a narrow sheet.
const MOST_TEXT: u32 = 1600;
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

/// Writes a sheet under a large title and a small line as a PNG.
pub(crate) fn write_sheet(path: &Path, title: &str, subtitle: &str, rows: &[SheetRow]) -> Result<()> {
    png_file::write_rgb8(path, &compose(title, subtitle, rows)?)
}

fn compose(title: &str, subtitle: &str, rows: &[SheetRow]) -> Result<RgbImage> {
    let headings = rows.iter().map(|row| text_width(&row.heading, HEADING)).max().unwrap_or(0);
    let text = headings.max(text_width(title, TITLE)).max(text_width(subtitle, LABEL)).min(MOST_TEXT);
    let cells = rows.iter().map(|row| row.cells.len()).max().unwrap_or(0) as u32;
    let width = 2 * MARGIN + (cells * (CELL + GUTTER)).saturating_sub(GUTTER).max(text);
    let heights = |row: &SheetRow| row.cells.iter().map(|(_, picture)| shown_height(picture)).max();
    let pictures = |row: &SheetRow| heights(row).unwrap_or(0);
    // Above and below the pictures of a row.
    let (above, below) = (3 * GAP + 1 + line_height(HEADING), GAP + line_height(LABEL) + GUTTER);
    let head = MARGIN + line_height(TITLE) + GAP + line_height(LABEL) + GAP;
    let height = head + rows.iter().map(|row| above + pictures(row) + below).sum::<u32>() + MARGIN;
    if width.max(height) > MOST_SIDE {
        return Err(Error::run("drawing a contact sheet", "it would be too large: show fewer passes"));
    }
    let mut page = RgbImage::from_pixel(width, height, Rgb(BACKGROUND));
    let room = width - 2 * MARGIN;
    let draw = |page: &mut RgbImage, at: [u32; 2], size: f32, color: [u8; 3], text: &str, room: u32| {
        draw_text(page, at, size, color, &fitted(text, size, room));
    };
    draw(&mut page, [MARGIN, MARGIN], TITLE, INK, title, room);
    draw(&mut page, [MARGIN, MARGIN + line_height(TITLE) + GAP], LABEL, FAINT_INK, subtitle, room);
    let mut top = head;
    for row in rows {
        (MARGIN..width - MARGIN).for_each(|x| page.put_pixel(x, top + GAP, Rgb(RULE)));
        draw(&mut page, [MARGIN, top + 2 * GAP + 1], HEADING, INK, &row.heading, room);
        let label_top = top + above + pictures(row) + GAP;
        for (left, (label, picture)) in (MARGIN..).step_by((CELL + GUTTER) as usize).zip(&row.cells) {
            // Enlarged by an integer factor if that fits exactly, else resampled smoothly.
            let height = shown_height(picture);
            let exact = CELL.is_multiple_of(picture.width()) && height.is_multiple_of(picture.height());
            let filter = if exact { FilterType::Nearest } else { FilterType::CatmullRom };
            let picture = imageops::resize(picture, CELL, height, filter);
            imageops::replace(&mut page, &picture, i64::from(left), i64::from(top + above));
            draw(&mut page, [left, label_top], LABEL, FAINT_INK, label, CELL);
        }
        top = label_top - GAP + below;
    }
    Ok(page)
}

/// The height of a picture of the width of a cell.
fn shown_height(picture: &RgbImage) -> u32 {
    let (w, h) = (u64::from(picture.width()), u64::from(picture.height()));
    ((u64::from(CELL) * h + w / 2) / w).clamp(1, u64::from(MOST_SIDE)) as u32
}

/// Rows of a glyph: seven, and one for descenders.
const ROWS: usize = 8;

/// Enlargement before averaging down.
const FINE: usize = 8;

/// Glyphs from the space to the tilde: five bytes are the columns from left to right, of which bit
/// 0 is the top row, bit 7 the descender's.
#[rustfmt::skip]
const GLYPHS: [u64; 95] = [
    0x0000000000, 0x00005F0000, 0x0007000700, 0x147F147F14, 0x242A7F2A12, 0x2313086462, 0x3649562050,
    0x0000070000, 0x001C224100, 0x0041221C00, 0x14083E0814, 0x08083E0808, 0x0080600000, 0x0008080808,
    0x0060600000, 0x2010080402, 0x3E5149453E, 0x00427F4000, 0x4261514946, 0x2141454B31, 0x1814127F10,
    0x2745454539, 0x3C4A494930, 0x0171090503, 0x3649494936, 0x064949291E, 0x0036360000, 0x0080660000,
    0x0814224100, 0x1414141414, 0x0041221408, 0x0201510906, 0x3E415D555E, 0x7E1111117E, 0x7F49494936,
    0x3E41414122, 0x7F4141221C, 0x7F49494941, 0x7F09090901, 0x3E4149497A, 0x7F0808087F, 0x00417F4100,
    0x2040413F01, 0x7F08142241, 0x7F40404040, 0x7F020C027F, 0x7F0408107F, 0x3E4141413E, 0x7F09090906,
    0x3E4151215E, 0x7F09192946, 0x4649494931, 0x01017F0101, 0x3F4040403F, 0x1F2040201F, 0x3F4038403F,
    0x6314081463, 0x0708700807, 0x6151494543, 0x007F414100, 0x0204081020, 0x0041417F00, 0x0402010204,
    0x8080808080, 0x0001020400, 0x2054545478, 0x7F48444438, 0x3844444428, 0x384444487F, 0x3854545418,
    0x00087E0902, 0x18A4A4A47C, 0x7F08040478, 0x00447D4000, 0x0080847D00, 0x007F102844, 0x00417F4000,
    0x7C04780478, 0x7C08040478, 0x3844444438, 0xFC24242418, 0x18242424FC, 0x7C08040408, 0x4854545424,
    0x00043F4440, 0x3C4040207C, 0x1C2040201C, 0x3C4030403C, 0x4428102844, 0x1CA0A0A07C, 0x4464544C44,
    0x0008364100, 0x00007F0000, 0x0041360800, 0x1008181008,
];

/// The glyph for characters that the font does not have: an empty box.
const UNKNOWN: u64 = 0x7F4141417F;

fn glyph(character: char) -> u64 {
    match character {
        '×' => 0x2214081422,
        '°' => 0x0006090906,
        '·' => 0x0018180000,
        '–' | '—' | '−' => glyph('-'),
        'Δ' => 0x704C434C70,
        '±' => 0x44445F4444,
        '’' => glyph('\''),
        _ => *GLYPHS.get((character as usize).wrapping_sub(usize::from(b' '))).unwrap_or(&UNKNOWN),
    }
}

/// The columns of a character: blank edges are removed, but digits keep their full width so that
/// numbers align.
fn inked(character: char) -> Vec<u8> {
    let all = &glyph(character).to_be_bytes()[3..];
    let first = all.iter().position(|&c| c != 0);
    match first.zip(all.iter().rposition(|&c| c != 0)) {
        None => vec![0; 3],
        Some(_) if character.is_ascii_digit() => all.to_vec(),
        Some((first, last)) => all[first..=last].to_vec(),
    }
}

/// Height of a line of text in pixels at `size` pixels per font dot, descenders included.
pub fn line_height(size: f32) -> u32 {
    (ROWS as f32 * size).ceil() as u32
}

/// Width in pixels of `text` on one line at `size` pixels per font dot.
pub fn text_width(text: &str, size: f32) -> u32 {
    let dots: usize = text.chars().map(|c| inked(c).len() + 1).sum();
    (dots.saturating_sub(1) as f32 * size).ceil() as u32
}

/// `text`, shortened with "..." if it would be wider than `width` pixels.
fn fitted(text: &str, size: f32, width: u32) -> String {
    if text_width(text, size) <= width {
        return text.to_owned();
    }
    let ends = text.char_indices().rev().map(|(end, _)| end);
    let mut shorter = ends.map(|end| text[..end].trim_end().to_owned() + "...");
    shorter.find(|text| text_width(text, size) <= width).unwrap_or_default()
}

/// Draws `text` with its top left corner at (`left`, `top`), `size` pixels per font dot, in sRGB
/// `color`. Parts outside the picture are clipped.
pub fn draw_text(picture: &mut RgbImage, [left, top]: [u32; 2], size: f32, color: [u8; 3], text: &str) {
    let mut column = 0usize;
    for character in text.chars() {
        let columns = inked(character);
        let glyph = Glyph::new(&columns);
        let (start, end) = (column as f32 * size, (column + columns.len()) as f32 * size);
        for y in 0..line_height(size) {
            for x in start.floor() as u32..end.ceil() as u32 {
                let coverage = glyph.coverage((x as f32 - start) / size, y as f32 / size, 1.0 / size);
                let Some(pixel) = picture.get_pixel_mut_checked(left + x, top + y) else { continue };
                for (under, ink) in pixel.0.iter_mut().zip(color) {
                    let before = f32::from(*under);
                    *under = (before + (f32::from(ink) - before) * coverage).round() as u8;
                }
            }
        }
        column += columns.len() + 1;
    }
}

/// An enlarged and rounded glyph.
struct Glyph {
    width: usize,
    height: usize,
    ink: Vec<bool>,
}

impl Glyph {
    fn new(columns: &[u8]) -> Self {
        let mut glyph = Self {
            width: columns.len(),
            height: ROWS,
            ink: (0..ROWS).flat_map(|row| columns.iter().map(move |c| c >> row & 1 == 1)).collect(),
        };
        while glyph.height < ROWS * FINE {
            glyph = glyph.doubled();
        }
        glyph
    }

    fn at(&self, x: isize, y: isize) -> bool {
        let inside = (0..self.width as isize).contains(&x) && (0..self.height as isize).contains(&y);
        inside && self.ink[y as usize * self.width + x as usize]
    }

    /// Twice the size by Scale2x: a corner gets the color of its two outer neighbors if they are
    /// equal.
    fn doubled(&self) -> Self {
        let (width, height) = (2 * self.width, 2 * self.height);
        let dot = |i: usize| {
            let (x, y) = ((i % width / 2) as isize, (i / width / 2) as isize);
            let (dx, dy) = ((i % width % 2) as isize * 2 - 1, (i / width % 2) as isize * 2 - 1);
            let (side, other_side) = (self.at(x + dx, y), self.at(x - dx, y));
            let (end, other_end) = (self.at(x, y + dy), self.at(x, y - dy));
            if side == end && side != other_end && end != other_side { side } else { self.at(x, y) }
        };
        Self { width, height, ink: (0..width * height).map(dot).collect() }
    }

    /// Coverage of the square of side `step` font dots whose corner is (`x`, `y`) dots from the
    /// corner of the glyph.
    fn coverage(&self, x: f32, y: f32, step: f32) -> f32 {
        const TAPS: usize = 8;
        let tap = |from: f32, i: usize| {
            ((from + step * (i as f32 + 0.5) / TAPS as f32) * FINE as f32).floor() as isize
        };
        let hits = (0..TAPS * TAPS).filter(|i| self.at(tap(x, i % TAPS), tap(y, i / TAPS))).count();
        hits as f32 / (TAPS * TAPS) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn pictures_and_texts_stand_where_the_layout_says() {
        let picture = |w, h, color| ("truth".to_owned(), RgbImage::from_pixel(w, h, Rgb(color)));
        let row = |cells| SheetRow { heading: "novel · 41.6 dB".into(), cells };
        let rows = [row(vec![picture(64, 32, [200, 0, 0]), picture(128, 256, [0, 200, 0])])];
        let page = compose("sphere", "two pictures", &rows).unwrap();
        let top = page.height() - MARGIN - GUTTER - line_height(LABEL) - GAP - 512;
        assert_eq!(page.width(), 2 * MARGIN + 2 * CELL + GUTTER);
        assert_eq!(page.get_pixel(MARGIN + CELL - 1, top + 127).0, [200, 0, 0], "shape kept: 256 × 128");
        assert_eq!(page.get_pixel(MARGIN + CELL - 1, top + 128).0, BACKGROUND);
        assert_eq!(page.get_pixel(MARGIN + CELL + GUTTER, top + 511).0, [0, 200, 0]);
        let dark = |page: &RgbImage| page.pixels().filter(|p| p.0 == INK).count();
        assert!(dark(&page) > dark(&compose("", "two pictures", &rows).unwrap()) + 50);
        assert!(compose("", "", &[row(vec![picture(1, 4000, [0; 3])])]).is_err(), "it would be too high");
    }

    #[test]
    fn every_character_but_space_has_ink_and_no_two_look_alike() {
        for (i, shape) in GLYPHS.iter().enumerate().skip(1) {
            assert!(![0, UNKNOWN].contains(shape) && !GLYPHS[..i].contains(shape), "{i}");
        }
        assert_eq!([' ', '~', '☃'].map(glyph), [GLYPHS[0], GLYPHS[94], UNKNOWN]);
    }

    #[test]
    fn widths_add_up_and_long_texts_are_cut() {
        assert_eq!(text_width("", 2.0), 0);
        assert_eq!(text_width("00", 2.0), 22);
        assert_eq!(text_width("11", 1.0), text_width("88", 1.0));
        let cut = fitted("a very long name indeed", 2.0, 120);
        assert!(cut.ends_with("...") && text_width(&cut, 2.0) <= 120, "{cut}");
        assert_eq!(fitted("short", 2.0, 120), "short");
        assert_eq!(fitted("W", 2.0, 1), "");
    }

    #[test]
    fn an_l_is_drawn_where_it_should_be() {
        let mut picture = RgbImage::new(20, 20);
        draw_text(&mut picture, [2, 3], 2.0, [255; 3], "L");
        assert_eq!(picture.get_pixel(3, 6).0, [255; 3], "stem");
        assert_eq!(picture.get_pixel(9, 16).0, [255; 3], "foot");
        assert_eq!(picture.get_pixel(8, 6).0, [0; 3], "right of the stem");
        // Outside the picture: nothing happens.
        draw_text(&mut picture, [18, 15], 3.0, [255; 3], "off");
    }
}
