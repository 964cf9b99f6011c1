//! Packing: charts side by side in a square texture, as large as possible.
//!
//! Charts stand upright ([`upright`]), and the largest goes first, each as low as it can be in one of four turns ([`page`]; the rule is
//! Baker, Coffman, Rivest: "Orthogonal packings in two dimensions", SIAM Journal on Computing 1980, for shapes instead of
//! rectangles, as in Lévy, Petitjean, Ray, Maillot: "Least squares conformal maps", SIGGRAPH 2002). The scale is found by trial.

mod mask;
mod page;
mod upright;

use super::chart::Chart;
use glam::{DVec2, UVec2, Vec2Swizzles};
use mask::Mask;
use page::{Page, Scratch};
use rayon::prelude::*;
use std::collections::HashMap;
use upright::set_upright;

/// Texels between two charts that neither touches, at least.
pub const GUTTER: u32 = 4;
/// Texels at the border of the texture that no chart touches, at least.
pub const MARGIN: u32 = 2;
/// Most cells along a side of the page: cells of larger textures are squares of texels.
const MOST_CELLS: u32 = 512;
/// Part of the texture that the first trial fills, with gutters.
const FIRST_FILL: f64 = 0.9;
/// The first step between trials, and the last, as ratios of scales.
const STEPS: (f64, f64) = (1.08, 1.008);
/// Charts are not made smaller than this, in texels along the longest of them.
const SMALLEST: f64 = 1.0;
/// Masks up to this large share the row where the search begins.
const SMALL_MASK: u32 = 12;

/// Packs charts into a texture of `size`² texels. All get the same scale; their places become texels. False, and no change but of places, if
/// they do not fit.
pub fn pack(charts: &mut [Chart], size: u32) -> bool {
    let corners: Vec<DVec2> = charts.par_iter_mut().map(|chart| set_upright(&mut chart.places)).collect();
    let packing = Packing::new(charts, &corners, size);
    let Some((scale, placed)) = packing.largest() else { return false };
    let cell = f64::from(packing.cell);
    for (i, chart) in charts.iter_mut().enumerate() {
        let Placed { at, turn } = placed[i];
        let moved = |p: DVec2| turned(p * scale, corners[i] * scale, turn) + at.as_dvec2() * cell;
        chart.places.iter_mut().for_each(|p| *p = moved(*p));
    }
    true
}

/// A point of a chart with the box from the origin to `corner`, turned by quarters, so that the box begins at the origin again.
fn turned(point: DVec2, corner: DVec2, quarters: usize) -> DVec2 {
    match quarters {
        0 => point,
        1 => DVec2::new(corner.y - point.y, point.x),
        2 => corner - point,
        _ => DVec2::new(point.y, corner.x - point.x),
    }
}

/// Where a chart is: its first cell, and its quarter turns.
#[derive(Clone, Copy, Debug)]
struct Placed {
    at: UVec2,
    turn: usize,
}

/// Charts to pack.
struct Packing<'a> {
    charts: &'a [Chart],
    corners: &'a [DVec2],
    /// The largest first.
    order: Vec<usize>,
    size: u32,
    /// Texels along a cell, and cells along the page.
    cell: u32,
    side: u32,
}

impl<'a> Packing<'a> {
    fn new(charts: &'a [Chart], corners: &'a [DVec2], size: u32) -> Self {
        let mut order: Vec<usize> = (0..charts.len()).collect();
        order.sort_by(|a, b| corners[*b].element_sum().total_cmp(&corners[*a].element_sum()).then(a.cmp(b)));
        let cell = size.div_ceil(MOST_CELLS).max(1);
        Self { charts, corners, order, size, cell, side: size / cell }
    }

    /// The largest scale that is found, in texels per world unit, and where the charts are then.
    fn largest(&self) -> Option<(f64, Vec<Placed>)> {
        // One texel and half the gutter around it, for each chart.
        let (count, room) = (self.charts.len() as f64, f64::from(self.size + GUTTER));
        if count * f64::from(1 + GUTTER).powi(2) > room * room || self.size <= 2 * MARGIN {
            return None;
        }
        let longest = self.corners.iter().fold(0.0, |longest, corner| corner.x.max(longest));
        let mut scale = self.first_scale().clamp(SMALLEST / longest, room / longest);
        let mut best = self.place(scale).map(|placed| (scale, placed));
        let up = best.is_some();
        let mut step = STEPS.0;
        // Up or down until it fits no more, or does.
        loop {
            let next = if up { scale * step } else { scale / step };
            let placed = if next * longest < SMALLEST { return best } else { self.place(next) };
            let fits = placed.is_some();
            if let Some(placed) = placed {
                best = Some((next, placed));
            }
            if fits != up {
                break;
            }
            scale = next;
            step = if up { step } else { step * step };
        }
        let mut low = best.as_ref()?.0;
        let mut high = low * step;
        while high > low * STEPS.1 {
            let middle = (low * high).sqrt();
            match self.place(middle) {
                Some(placed) => (best, low) = (Some((middle, placed)), middle),
                None => high = middle,
            }
        }
        best
    }

    /// The scale at which charts and gutters fill a good part of the texture.
    fn first_scale(&self) -> f64 {
        let areas: f64 = self.charts.iter().map(Chart::area).sum();
        let sides: f64 = self.corners.iter().map(|corner| corner.element_sum()).sum();
        let gutter = f64::from(GUTTER);
        // areas s² + gutter sides s + gutter² count = fill size²
        let (b, c) = (gutter * sides, gutter * gutter * self.charts.len() as f64);
        let rest = (FIRST_FILL * f64::from(self.size).powi(2) - c).max(0.0);
        2.0 * rest / (b + (b * b + 4.0 * areas * rest).sqrt())
    }

    /// Places all charts at a scale, if they fit.
    fn place(&self, scale: f64) -> Option<Vec<Placed>> {
        let gutter = GUTTER.div_ceil(self.cell);
        let masks: Vec<[Mask; 4]> = self.order.par_iter().map(|&i| self.masks(i, scale / f64::from(self.cell))).collect();
        if masks.iter().map(|turns| turns[0].cells()).sum::<usize>() > self.side.pow(2) as usize {
            return None;
        }
        let mut page = Page::new(self.side, MARGIN.div_ceil(self.cell));
        let mut placed = vec![Placed { at: UVec2::ZERO, turn: 0 }; self.charts.len()];
        let mut begin: HashMap<UVec2, u32> = HashMap::new();
        let mut scratch = Scratch::default();
        for (&i, turns) in self.order.iter().zip(&masks) {
            let mut best: Option<(u32, Placed)> = None;
            for (turn, mask) in turns.iter().enumerate() {
                let small = mask.size.max_element() <= SMALL_MASK;
                let first = if small { begin.get(&mask.size).copied().unwrap_or(0) } else { 0 };
                let limit = best.map_or(self.side, |(top, _)| top.saturating_sub(1));
                let Some(at) = page.find(mask, first, limit, &mut scratch) else { continue };
                best = Some((at.y + mask.size.y, Placed { at, turn }));
                if small {
                    begin.insert(mask.size, at.y);
                }
            }
            let (_, here) = best?;
            page.take(&turns[here.turn], here.at, gutter);
            placed[i] = here;
        }
        Some(placed)
    }

    /// A chart's cells in each quarter turn; `scale` in cells per world unit.
    fn masks(&self, i: usize, scale: f64) -> [Mask; 4] {
        let (chart, corner) = (&self.charts[i], self.corners[i] * scale);
        [0, 1, 2, 3].map(|turn| {
            let place = |v: u32| turned(chart.places[v as usize] * scale, corner, turn).max(DVec2::ZERO);
            let far = if turn % 2 == 0 { corner } else { corner.yx() };
            Mask::new(chart.triangles.iter().map(|t| t.map(place)), far)
        })
    }
}
