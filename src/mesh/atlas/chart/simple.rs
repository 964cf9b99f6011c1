//! Whether a border crosses itself.

use glam::{DVec2, IVec2};

/// Most cells of the grid along a side.
const MOST_CELLS: f64 = 512.0;

/// Whether no two segments without a common end meet. A map of a planar patch in which no triangle is turned over and whose border is such
/// covers no point twice.
pub fn is_simple(border: &[[u32; 2]], map: &[DVec2]) -> bool {
    let ends = |[a, b]: [u32; 2]| [map[a as usize], map[b as usize]];
    let grid = Grid::over(border.iter().map(|segment| ends(*segment)));
    // (cell, segment), so that those of a cell lie together.
    let mut entries: Vec<(u32, u32)> = Vec::with_capacity(4 * border.len());
    for (i, segment) in border.iter().enumerate() {
        entries.extend(grid.cells(ends(*segment)).map(|cell| (cell, i as u32)));
    }
    entries.sort_unstable();
    entries.chunk_by(|a, b| a.0 == b.0).all(|cell| {
        cell.iter().enumerate().all(|(k, (_, i))| {
            cell[..k].iter().all(|(_, j)| {
                let (one, two) = (border[*i as usize], border[*j as usize]);
                one.iter().any(|v| two.contains(v)) || !meet(ends(one), ends(two))
            })
        })
    })
}

/// Square cells over a box.
struct Grid {
    low: DVec2,
    cell: f64,
    columns: i32,
}

impl Grid {
    /// Cells about as wide as the segments are long.
    fn over(segments: impl Iterator<Item = [DVec2; 2]>) -> Self {
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let (mut length, mut count) = (0.0, 0);
        for [a, b] in segments {
            low = low.min(a).min(b);
            high = high.max(a).max(b);
            length += a.distance(b);
            count += 1;
        }
        let side = (high - low).max_element();
        let cell = (length / f64::from(count.max(1))).max(side / MOST_CELLS).max(f64::MIN_POSITIVE);
        Self { low, cell, columns: (side / cell) as i32 + 1 }
    }

    /// The cells of a segment's box.
    fn cells(&self, [a, b]: [DVec2; 2]) -> impl Iterator<Item = u32> {
        let cell = |p: DVec2| -> IVec2 { ((p - self.low) / self.cell).as_ivec2() };
        let (low, high) = (cell(a.min(b)), cell(a.max(b)));
        let columns = self.columns;
        (low.y..=high.y).flat_map(move |y| (low.x..=high.x).map(move |x| (y * columns + x) as u32))
    }
}

/// Whether two segments have a point in common.
fn meet([a, b]: [DVec2; 2], [c, d]: [DVec2; 2]) -> bool {
    let side = |from: DVec2, to: DVec2, at: DVec2| (to - from).perp_dot(at - from);
    let (of_c, of_d) = (side(a, b, c), side(a, b, d));
    let (of_a, of_b) = (side(c, d, a), side(c, d, b));
    if of_c == 0.0 && of_d == 0.0 {
        // On one line: whether their boxes meet.
        return a.max(b).cmpge(c.min(d)).all() && c.max(d).cmpge(a.min(b)).all();
    }
    of_c * of_d <= 0.0 && of_a * of_b <= 0.0
}
