//! Whether a map of a patch covers a point twice, seen from its border.

use glam::{DVec2, IVec2};

/// Most cells of the grid along a side.
const MOST_CELLS: f64 = 512.0;
/// A hole that has turned inside out by less than this part of the outer loop's area is a slit.
const SLIT: f64 = 1e-9;

/// Whether a map without turned triangles covers no point twice. `border` holds closed loops, one after another, with the patch on their left.
///
/// The number of times that a point is covered is the sum of how often the loops wind around it. If no two segments cross, each loop winds
/// once: around the patch if it is the outer one, the other way if it is that of a hole. A hole may have closed to a slit.
pub(crate) fn is_simple(border: &[[u32; 2]], map: &[DVec2]) -> bool {
    let areas = loop_areas(border, map);
    let outer = areas.iter().copied().fold(0.0, f64::max);
    areas.iter().filter(|area| **area > SLIT * outer).count() == 1 && !crosses(border, map)
}

/// The area inside each loop, negative if it runs clockwise.
fn loop_areas(border: &[[u32; 2]], map: &[DVec2]) -> Vec<f64> {
    let mut areas: Vec<f64> = Vec::new();
    let mut first = None;
    for [a, b] in border {
        let start = *first.get_or_insert_with(|| {
            areas.push(0.0);
            *a
        });
        let [from, to] = [a, b].map(|v| map[*v as usize] - map[start as usize]);
        if let Some(area) = areas.last_mut() {
            *area += 0.5 * from.perp_dot(to);
        }
        if *b == start {
            first = None;
        }
    }
    areas
}

/// Whether any two segments cross.
fn crosses(border: &[[u32; 2]], map: &[DVec2]) -> bool {
    let ends = |[a, b]: [u32; 2]| [map[a as usize], map[b as usize]];
    let grid = Grid::over(border.iter().map(|segment| ends(*segment)));
    let width_of = |i: u32| {
        let [a, b] = ends(border[i as usize]);
        (a.x.min(b.x), a.x.max(b.x))
    };
    // Cell, left end and segment, so that those of a cell lie together and from left to right.
    let mut entries: Vec<(u32, f64, u32)> = Vec::with_capacity(4 * border.len());
    for i in 0..border.len() as u32 {
        entries.extend(grid.cells(ends(border[i as usize])).map(|cell| (cell, width_of(i).0, i)));
    }
    entries.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    entries.chunk_by(|a, b| a.0 == b.0).any(|cell| {
        cell.iter().enumerate().any(|(k, (_, _, i))| {
            let right = width_of(*i).1;
            cell[k + 1..].iter().take_while(|(_, left, _)| *left <= right).any(|(_, _, j)| {
                let (one, two) = (border[*i as usize], border[*j as usize]);
                !one.iter().any(|v| two.contains(v)) && cross(ends(one), ends(two))
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

/// Whether two segments cross inside both.
fn cross([a, b]: [DVec2; 2], [c, d]: [DVec2; 2]) -> bool {
    let side = |from: DVec2, to: DVec2, at: DVec2| (to - from).perp_dot(at - from);
    side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
}
