//! A square of cells, some of them taken, and the lowest place where a mask fits.
//!
//! Bottom-left placement of shapes as bitmaps. For one row of the page all columns are tested at once: a run of n cells is blocked at every
//! column that has a taken cell at most n − 1 columns further on, which is about log₂ n shifts of the row.

use super::cell_mask::{CellMask, CellRun, set};
use glam::UVec2;
use std::ops::Range;

/// A square page.
#[derive(Clone, Debug)]
pub struct Page {
    side: u32,
    stride: usize,
    /// Taken cells, row by row; those beyond the side are taken.
    taken: Vec<u64>,
    /// The longest run of free cells in each row.
    longest_free: Vec<u32>,
}

impl Page {
    /// A page of `side`² cells, of which the `margin` outermost on each side are taken.
    pub fn new(side: u32, margin: u32) -> Self {
        let stride = (side as usize).div_ceil(64);
        let mut page = Self {
            side,
            stride,
            taken: vec![0; stride * side as usize],
            longest_free: vec![side; side as usize],
        };
        let beyond = stride as u32 * 64;
        for y in 0..side {
            let inner = y >= margin && y + margin < side && 2 * margin < side;
            let outside = if inner { [0..margin, side - margin..beyond] } else { [0..side, side..beyond] };
            for columns in outside.into_iter().filter(|columns| !columns.is_empty()) {
                set(page.row_mut(y), columns.start, columns.end - 1);
            }
            page.measure(y);
        }
        page
    }

    fn row(&self, y: u32) -> &[u64] {
        &self.taken[y as usize * self.stride..(y as usize + 1) * self.stride]
    }

    fn row_mut(&mut self, y: u32) -> &mut [u64] {
        &mut self.taken[y as usize * self.stride..(y as usize + 1) * self.stride]
    }

    /// Finds the longest free run of a row again.
    fn measure(&mut self, y: u32) {
        let (mut longest, mut length) = (0, 0);
        for &bits in self.row(y) {
            if bits == 0 {
                length += 64;
            } else {
                let mut at = 0;
                while at < 64 {
                    let free = (bits >> at).trailing_zeros().min(64 - at);
                    length += free;
                    at += free;
                    longest = longest.max(length);
                    if at < 64 {
                        length = 0;
                        at += (!(bits >> at)).trailing_zeros();
                    }
                }
            }
            longest = longest.max(length);
        }
        self.longest_free[y as usize] = longest;
    }

    /// The lowest of `rows` where the mask touches no taken cell, and the first column there.
    pub fn find(&self, mask: &CellMask, rows: Range<u32>, scratch: &mut Scratch) -> Option<UVec2> {
        let end = rows.end.min((self.side + 1).checked_sub(mask.size.y)?);
        if mask.size.x > self.side {
            return None;
        }
        (rows.start..end).find_map(|y| Some(UVec2::new(self.column(mask, y, scratch)?, y)))
    }

    /// The first column where the mask fits in row `y`.
    fn column(&self, mask: &CellMask, y: u32, scratch: &mut Scratch) -> Option<u32> {
        let room = |run: &CellRun| run.to - run.from < self.longest_free[(y + run.y) as usize];
        if !mask.runs.iter().all(room) {
            return None;
        }
        let Scratch { blocked, spread } = scratch;
        blocked.clear();
        blocked.resize(self.stride, 0);
        if self.side - mask.size.x + 1 < self.stride as u32 * 64 {
            set(blocked, self.side - mask.size.x + 1, self.stride as u32 * 64 - 1);
        }
        for run in &mask.runs {
            let row = self.row(y + run.y);
            if row.iter().all(|bits| *bits == 0) {
                continue;
            }
            spread.clear();
            spread.extend_from_slice(row);
            let (mut wide, length) = (1, run.to - run.from + 1);
            while wide < length {
                let by = wide.min(length - wide);
                or_shifted_self(spread, by);
                wide += by;
            }
            or_shifted(blocked, spread, run.from);
            if blocked.iter().all(|bits| *bits == u64::MAX) {
                return None;
            }
        }
        let word = blocked.iter().position(|bits| *bits != u64::MAX)?;
        Some(64 * word as u32 + (!blocked[word]).trailing_zeros())
    }

    /// Takes the cells of a mask at `at`, and those at most `gutter` cells away in each direction.
    pub fn take(&mut self, mask: &CellMask, at: UVec2, gutter: u32) {
        for run in &mask.runs {
            let (from, to) =
                ((at.x + run.from).saturating_sub(gutter), (at.x + run.to + gutter).min(self.side - 1));
            let rows = (at.y + run.y).saturating_sub(gutter)..=(at.y + run.y + gutter).min(self.side - 1);
            rows.for_each(|y| set(self.row_mut(y), from, to));
        }
        let rows = at.y.saturating_sub(gutter)..=(at.y + mask.size.y - 1 + gutter).min(self.side - 1);
        rows.for_each(|y| self.measure(y));
    }
}

/// Rows of bits for [`Page::find`].
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    blocked: Vec<u64>,
    spread: Vec<u64>,
}

/// The word of `row` that begins at bit `64 word + by`.
fn shifted(row: &[u64], word: usize, by: u32) -> u64 {
    let (words, bits) = ((by / 64) as usize, by % 64);
    let at = |i: usize| row.get(i).copied().unwrap_or(0);
    let low = at(word + words) >> bits;
    if bits == 0 { low } else { low | at(word + words + 1) << (64 - bits) }
}

/// Sets in `to` every bit that is set in `row` `by` bits further on.
fn or_shifted(to: &mut [u64], row: &[u64], by: u32) {
    (0..to.len()).for_each(|word| to[word] |= shifted(row, word, by));
}

/// The same of a row with itself.
fn or_shifted_self(row: &mut [u64], by: u32) {
    // In this order each word reads only words that have not changed yet, or itself.
    (0..row.len()).for_each(|word| row[word] |= shifted(row, word, by));
}
