//! Text for contact sheets: a built-in 5×7 bitmap font, drawn with antialiasing at any size.
//!
//! Each glyph is enlarged eightfold by the Scale2x rule (A. Mazzoleni, 2001), applied three times, which rounds its corners, and then
//! averaged down to the requested size, so that letters have smooth edges.

use image::{Rgb, RgbImage};

/// First and last character of [`GLYPHS`].
const FIRST: u32 = 0x20;
const LAST: u32 = 0x7E;

/// Rows of a glyph: seven, and one for descenders.
const ROWS: usize = 8;

/// Enlargement before averaging down.
const FINE: usize = 8;

/// Columns from left to right; bit 0 is the top row, bit 7 the descender's.
const GLYPHS: [[u8; 5]; (LAST - FIRST + 1) as usize] = [
    [0x00, 0x00, 0x00, 0x00, 0x00], // space
    [0x00, 0x00, 0x5F, 0x00, 0x00], // !
    [0x00, 0x07, 0x00, 0x07, 0x00], // "
    [0x14, 0x7F, 0x14, 0x7F, 0x14], // #
    [0x24, 0x2A, 0x7F, 0x2A, 0x12], // $
    [0x23, 0x13, 0x08, 0x64, 0x62], // %
    [0x36, 0x49, 0x56, 0x20, 0x50], // &
    [0x00, 0x00, 0x07, 0x00, 0x00], // '
    [0x00, 0x1C, 0x22, 0x41, 0x00], // (
    [0x00, 0x41, 0x22, 0x1C, 0x00], // )
    [0x14, 0x08, 0x3E, 0x08, 0x14], // *
    [0x08, 0x08, 0x3E, 0x08, 0x08], // +
    [0x00, 0x80, 0x60, 0x00, 0x00], // ,
    [0x00, 0x08, 0x08, 0x08, 0x08], // -
    [0x00, 0x60, 0x60, 0x00, 0x00], // .
    [0x20, 0x10, 0x08, 0x04, 0x02], // /
    [0x3E, 0x51, 0x49, 0x45, 0x3E], // 0
    [0x00, 0x42, 0x7F, 0x40, 0x00], // 1
    [0x42, 0x61, 0x51, 0x49, 0x46], // 2
    [0x21, 0x41, 0x45, 0x4B, 0x31], // 3
    [0x18, 0x14, 0x12, 0x7F, 0x10], // 4
    [0x27, 0x45, 0x45, 0x45, 0x39], // 5
    [0x3C, 0x4A, 0x49, 0x49, 0x30], // 6
    [0x01, 0x71, 0x09, 0x05, 0x03], // 7
    [0x36, 0x49, 0x49, 0x49, 0x36], // 8
    [0x06, 0x49, 0x49, 0x29, 0x1E], // 9
    [0x00, 0x36, 0x36, 0x00, 0x00], // :
    [0x00, 0x80, 0x66, 0x00, 0x00], // ;
    [0x08, 0x14, 0x22, 0x41, 0x00], // <
    [0x14, 0x14, 0x14, 0x14, 0x14], // =
    [0x00, 0x41, 0x22, 0x14, 0x08], // >
    [0x02, 0x01, 0x51, 0x09, 0x06], // ?
    [0x3E, 0x41, 0x5D, 0x55, 0x5E], // @
    [0x7E, 0x11, 0x11, 0x11, 0x7E], // A
    [0x7F, 0x49, 0x49, 0x49, 0x36], // B
    [0x3E, 0x41, 0x41, 0x41, 0x22], // C
    [0x7F, 0x41, 0x41, 0x22, 0x1C], // D
    [0x7F, 0x49, 0x49, 0x49, 0x41], // E
    [0x7F, 0x09, 0x09, 0x09, 0x01], // F
    [0x3E, 0x41, 0x49, 0x49, 0x7A], // G
    [0x7F, 0x08, 0x08, 0x08, 0x7F], // H
    [0x00, 0x41, 0x7F, 0x41, 0x00], // I
    [0x20, 0x40, 0x41, 0x3F, 0x01], // J
    [0x7F, 0x08, 0x14, 0x22, 0x41], // K
    [0x7F, 0x40, 0x40, 0x40, 0x40], // L
    [0x7F, 0x02, 0x0C, 0x02, 0x7F], // M
    [0x7F, 0x04, 0x08, 0x10, 0x7F], // N
    [0x3E, 0x41, 0x41, 0x41, 0x3E], // O
    [0x7F, 0x09, 0x09, 0x09, 0x06], // P
    [0x3E, 0x41, 0x51, 0x21, 0x5E], // Q
    [0x7F, 0x09, 0x19, 0x29, 0x46], // R
    [0x46, 0x49, 0x49, 0x49, 0x31], // S
    [0x01, 0x01, 0x7F, 0x01, 0x01], // T
    [0x3F, 0x40, 0x40, 0x40, 0x3F], // U
    [0x1F, 0x20, 0x40, 0x20, 0x1F], // V
    [0x3F, 0x40, 0x38, 0x40, 0x3F], // W
    [0x63, 0x14, 0x08, 0x14, 0x63], // X
    [0x07, 0x08, 0x70, 0x08, 0x07], // Y
    [0x61, 0x51, 0x49, 0x45, 0x43], // Z
    [0x00, 0x7F, 0x41, 0x41, 0x00], // [
    [0x02, 0x04, 0x08, 0x10, 0x20], // backslash
    [0x00, 0x41, 0x41, 0x7F, 0x00], // ]
    [0x04, 0x02, 0x01, 0x02, 0x04], // ^
    [0x80, 0x80, 0x80, 0x80, 0x80], // _
    [0x00, 0x01, 0x02, 0x04, 0x00], // `
    [0x20, 0x54, 0x54, 0x54, 0x78], // a
    [0x7F, 0x48, 0x44, 0x44, 0x38], // b
    [0x38, 0x44, 0x44, 0x44, 0x28], // c
    [0x38, 0x44, 0x44, 0x48, 0x7F], // d
    [0x38, 0x54, 0x54, 0x54, 0x18], // e
    [0x00, 0x08, 0x7E, 0x09, 0x02], // f
    [0x18, 0xA4, 0xA4, 0xA4, 0x7C], // g
    [0x7F, 0x08, 0x04, 0x04, 0x78], // h
    [0x00, 0x44, 0x7D, 0x40, 0x00], // i
    [0x00, 0x80, 0x84, 0x7D, 0x00], // j
    [0x00, 0x7F, 0x10, 0x28, 0x44], // k
    [0x00, 0x41, 0x7F, 0x40, 0x00], // l
    [0x7C, 0x04, 0x78, 0x04, 0x78], // m
    [0x7C, 0x08, 0x04, 0x04, 0x78], // n
    [0x38, 0x44, 0x44, 0x44, 0x38], // o
    [0xFC, 0x24, 0x24, 0x24, 0x18], // p
    [0x18, 0x24, 0x24, 0x24, 0xFC], // q
    [0x7C, 0x08, 0x04, 0x04, 0x08], // r
    [0x48, 0x54, 0x54, 0x54, 0x24], // s
    [0x00, 0x04, 0x3F, 0x44, 0x40], // t
    [0x3C, 0x40, 0x40, 0x20, 0x7C], // u
    [0x1C, 0x20, 0x40, 0x20, 0x1C], // v
    [0x3C, 0x40, 0x30, 0x40, 0x3C], // w
    [0x44, 0x28, 0x10, 0x28, 0x44], // x
    [0x1C, 0xA0, 0xA0, 0xA0, 0x7C], // y
    [0x44, 0x64, 0x54, 0x4C, 0x44], // z
    [0x00, 0x08, 0x36, 0x41, 0x00], // {
    [0x00, 0x00, 0x7F, 0x00, 0x00], // |
    [0x00, 0x41, 0x36, 0x08, 0x00], // }
    [0x10, 0x08, 0x18, 0x10, 0x08], // ~
];

/// The glyph for characters that the font does not have: an empty box.
const UNKNOWN: [u8; 5] = [0x7F, 0x41, 0x41, 0x41, 0x7F];

fn columns(character: char) -> [u8; 5] {
    match character {
        '×' => [0x22, 0x14, 0x08, 0x14, 0x22],
        '°' => [0x00, 0x06, 0x09, 0x09, 0x06],
        '·' => [0x00, 0x18, 0x18, 0x00, 0x00],
        '–' | '—' | '−' => columns('-'),
        'Δ' => [0x70, 0x4C, 0x43, 0x4C, 0x70],
        '±' => [0x44, 0x44, 0x5F, 0x44, 0x44],
        '’' => columns('\''),
        _ => {
            let code = u32::from(character);
            if (FIRST..=LAST).contains(&code) { GLYPHS[(code - FIRST) as usize] } else { UNKNOWN }
        }
    }
}

/// The columns of a character: blank edges are removed, but digits keep their full width so that numbers align.
fn inked(character: char) -> Vec<u8> {
    let all = columns(character);
    if character == ' ' {
        return vec![0; 3];
    }
    if character.is_ascii_digit() {
        return all.to_vec();
    }
    let first = all.iter().position(|&c| c != 0).unwrap_or(0);
    let last = all.iter().rposition(|&c| c != 0).unwrap_or(0);
    all[first..=last].to_vec()
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
pub fn fitted(text: &str, size: f32, width: u32) -> String {
    if text_width(text, size) <= width {
        return text.to_owned();
    }
    let mut kept: Vec<char> = text.chars().collect();
    while let Some(_gone) = kept.pop() {
        let shorter: String = kept.iter().collect::<String>().trim_end().to_owned() + "...";
        if text_width(&shorter, size) <= width {
            return shorter;
        }
    }
    String::new()
}

/// Draws `text` with its top left corner at (`left`, `top`), `size` pixels per font dot, in sRGB `color`. Parts outside the
/// picture are clipped.
pub fn draw_text(picture: &mut RgbImage, [left, top]: [u32; 2], size: f32, color: [u8; 3], text: &str) {
    let mut column = 0usize;
    for character in text.chars() {
        let glyph = Glyph::new(&inked(character));
        let (start, end) = (column as f32 * size, (column + glyph.columns) as f32 * size);
        for y in 0..line_height(size) {
            for x in start.floor() as u32..end.ceil() as u32 {
                let coverage = glyph.coverage((x as f32 - start) / size, y as f32 / size, 1.0 / size);
                blend(picture, left + x, top + y, color, coverage);
            }
        }
        column += glyph.columns + 1;
    }
}

fn blend(picture: &mut RgbImage, x: u32, y: u32, color: [u8; 3], coverage: f32) {
    if coverage <= 0.0 || x >= picture.width() || y >= picture.height() {
        return;
    }
    let Rgb(under) = *picture.get_pixel(x, y);
    let mix = |c: usize| {
        (f32::from(under[c]) + (f32::from(color[c]) - f32::from(under[c])) * coverage).round() as u8
    };
    picture.put_pixel(x, y, Rgb([mix(0), mix(1), mix(2)]));
}

/// An enlarged and rounded glyph.
struct Glyph {
    columns: usize,
    width: usize,
    height: usize,
    ink: Vec<bool>,
}

impl Glyph {
    fn new(columns: &[u8]) -> Self {
        let mut glyph = Self {
            columns: columns.len(),
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

    /// Twice the size by Scale2x: a corner gets the color of its two outer neighbors if they are equal.
    fn doubled(&self) -> Self {
        let (width, height) = (2 * self.width, 2 * self.height);
        let dot = |i: usize| {
            let (x, y) = ((i % width / 2) as isize, (i / width / 2) as isize);
            let (dx, dy) = ((i % width % 2) as isize * 2 - 1, (i / width % 2) as isize * 2 - 1);
            let (side, other_side) = (self.at(x + dx, y), self.at(x - dx, y));
            let (end, other_end) = (self.at(x, y + dy), self.at(x, y - dy));
            if side == end && side != other_end && end != other_side { side } else { self.at(x, y) }
        };
        Self { columns: self.columns, width, height, ink: (0..width * height).map(dot).collect() }
    }

    /// Coverage of the square of side `step` font dots whose corner is (`x`, `y`) dots from the corner of the glyph.
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
    fn every_character_but_space_has_ink_and_no_two_look_alike() {
        let glyphs: Vec<[u8; 5]> = (FIRST..=LAST).filter_map(char::from_u32).map(columns).collect();
        for (i, glyph) in glyphs.iter().enumerate().skip(1) {
            assert_ne!(*glyph, [0; 5], "{i}");
            assert_ne!(*glyph, UNKNOWN);
            assert!(!glyphs[..i].contains(glyph), "{:?}", char::from_u32(FIRST + i as u32));
        }
        assert_eq!(columns('☃'), UNKNOWN);
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
