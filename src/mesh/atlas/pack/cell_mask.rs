//! The cells that a chart touches.

use glam::{DVec2, UVec2};

/// Some cells of a row, from the first to the last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellRun {
    /// Row.
    pub y: u32,
    /// First column.
    pub from: u32,
    /// Last column.
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
                set(
                    &mut bits[y * stride..(y + 1) * stride],
                    run.from.min(size.x - 1),
                    run.to.min(size.x - 1),
                );
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
pub fn set(row: &mut [u64], from: u32, to: u32) {
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
