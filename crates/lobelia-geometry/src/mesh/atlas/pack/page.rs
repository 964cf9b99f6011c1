//! A square of cells, some of them taken, the cells that a chart touches, and the lowest place
//! where these fit.
//!
//! Bottom-left placement of shapes as bitmaps. For one row of the page all columns are tested at
//! once: a run of n cells is blocked at every column that has a taken cell at most n − 1 columns
//! further on, which is about log₂ n shifts of the row.

use glam::{DVec2, UVec2};
use std::ops::Range;

/// Some cells of a row, from the first to the last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellRun {
    pub y: u32,
    pub from: u32,
    pub to: u32,
}

/// Cells in a box, as runs.
#[derive(Clone, Debug)]
pub struct CellMask {
    /// Columns and rows of the box.
    pub size: UVec2,
    /// The runs, the longest first.
    pub runs: Vec<CellRun>,
}

impl CellMask {
    /// All cells that the triangles touch. Corners are in units of cells, none of them negative.
    pub fn new(triangles: impl Iterator<Item = [DVec2; 3]>, corner: DVec2) -> Self {
        let size = corner.as_uvec2() + 1;
        let stride = size.x.div_ceil(64) as usize;
        let mut bits = vec![0u64; stride * size.y as usize];
        for triangle in triangles {
            for run in rows(triangle) {
                let y = run.y.min(size.y - 1) as usize;
                let [from, to] = [run.from, run.to].map(|x| x.min(size.x - 1));
                set(&mut bits[y * stride..(y + 1) * stride], from, to);
            }
        }
        let rows = bits.chunks_exact(stride).enumerate();
        let mut runs: Vec<CellRun> = rows.flat_map(|(y, row)| runs(y as u32, row)).collect();
        runs.sort_by_key(|run| (std::cmp::Reverse(run.to - run.from), run.y, run.from));
        Self { size, runs }
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.runs.iter().map(|run| (run.to - run.from + 1) as usize).sum()
    }
}

/// The cells that a triangle touches, row by row.
fn rows(corners: [DVec2; 3]) -> impl Iterator<Item = CellRun> {
    let low = corners.iter().fold(f64::INFINITY, |low, c| low.min(c.y));
    let high = corners.iter().fold(f64::NEG_INFINITY, |high, c| high.max(c.y));
    (low as u32..=high as u32).map(move |y| {
        let (bottom, top) = (f64::from(y), f64::from(y) + 1.0);
        let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            // The part of the edge between the two lines.
            let (a, b) = if a.y <= b.y { (a, b) } else { (b, a) };
            if b.y < bottom || a.y > top {
                continue;
            }
            let at = |y: f64| a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y));
            let first = if a.y < bottom { at(bottom) } else { a.x };
            let last = if b.y > top { at(top) } else { b.x };
            from = from.min(first).min(last);
            to = to.max(first).max(last);
        }
        CellRun { y, from: from.max(0.0) as u32, to: to.max(0.0) as u32 }
    })
}

/// Sets the bits of a row from the first to the last.
fn set(row: &mut [u64], from: u32, to: u32) {
    let (first, last) = (from as usize / 64, to as usize / 64);
    for (word, bits) in row.iter_mut().enumerate().take(last + 1).skip(first) {
        let low = if word == first { from % 64 } else { 0 };
        let high = if word == last { to % 64 } else { 63 };
        *bits |= (u64::MAX << low) & (u64::MAX >> (63 - high));
    }
}

/// The runs of set bits of a row.
fn runs(y: u32, row: &[u64]) -> Vec<CellRun> {
    let mut found: Vec<CellRun> = Vec::new();
    for (word, &bits) in row.iter().enumerate() {
        let mut rest = bits;
        while rest != 0 {
            let begin = rest.trailing_zeros();
            let length = (!(rest >> begin)).trailing_zeros();
            let (from, to) = (64 * word as u32 + begin, 64 * word as u32 + begin + length - 1);
            match found.last_mut() {
                Some(last) if last.to + 1 == from => last.to = to,
                _ => found.push(CellRun { y, from, to }),
            }
            rest = if begin + length < 64 { rest >> (begin + length) << (begin + length) } else { 0 };
        }
    }
    found
}

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
        let (taken, longest_free) = (vec![0; stride * side as usize], vec![side; side as usize]);
        let mut page = Self { side, stride, taken, longest_free };
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
        let (mut longest, mut begin) = (0, 0);
        for run in runs(y, self.row(y)) {
            longest = longest.max(run.from - begin);
            begin = run.to + 1;
        }
        self.longest_free[y as usize] = longest.max(64 * self.stride as u32 - begin);
    }

    /// The lowest of `rows` where the mask touches no taken cell, and the first column there.
    /// `scratch` keeps the room of two rows of bits.
    pub fn find(&self, mask: &CellMask, rows: Range<u32>, scratch: &mut [Vec<u64>; 2]) -> Option<UVec2> {
        let end = rows.end.min((self.side + 1).checked_sub(mask.size.y)?);
        if mask.size.x > self.side {
            return None;
        }
        (rows.start..end).find_map(|y| Some(UVec2::new(self.column(mask, y, scratch)?, y)))
    }

    /// The first column where the mask fits in row `y`.
    fn column(&self, mask: &CellMask, y: u32, [blocked, spread]: &mut [Vec<u64>; 2]) -> Option<u32> {
        let room = |run: &CellRun| run.to - run.from < self.longest_free[(y + run.y) as usize];
        if !mask.runs.iter().all(room) {
            return None;
        }
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
                // In this order each word reads only words that have not changed yet, or itself.
                (0..spread.len()).for_each(|word| spread[word] |= shifted(spread, word, by));
                wide += by;
            }
            (0..blocked.len()).for_each(|word| blocked[word] |= shifted(spread, word, run.from));
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

/// The word of `row` that begins at bit `64 word + by`.
fn shifted(row: &[u64], word: usize, by: u32) -> u64 {
    let (words, bits) = ((by / 64) as usize, by % 64);
    let at = |i: usize| row.get(i).copied().unwrap_or(0);
    let low = at(word + words) >> bits;
    if bits == 0 { low } else { low | at(word + words + 1) << (64 - bits) }
}
