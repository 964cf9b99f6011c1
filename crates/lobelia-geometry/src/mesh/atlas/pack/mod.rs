//! Packing: charts side by side in a square texture, as large as possible.
//!
//! Charts stand upright (`set_upright`), and the largest goes first, each as low as it can be in
//! one of four turns ([`page`]; the rule is Baker, Coffman, Rivest: "Orthogonal packings in two
//! dimensions", SIAM Journal on Computing 1980, for shapes instead of rectangles, as in Lévy,
//! Petitjean, Ray, Maillot: "Least squares conformal maps", SIGGRAPH 2002). The scale is found by
//! trial.

mod page;

use super::chart::Chart;
use crate::parallel;
use glam::{DVec2, UVec2, Vec2Swizzles};
use page::{CellMask, Page};
use std::collections::HashMap;

/// Texels between two charts that neither touches, at least.
pub(crate) const GUTTER: u32 = 4;
/// Texels at the border of the texture that no chart touches, at least.
pub const MARGIN: u32 = 2;
/// Most cells along a side of the page: cells of larger textures are squares of texels, if charts
/// are large.
const MOST_CELLS: u32 = 512;
/// Cells along the side of a mean chart's share of the page, at least.
const CHART_CELLS: f64 = 32.0;
/// Part of the texture that the first trial fills, with gutters.
const FIRST_FILL: f64 = 0.9;
/// The first step between trials, as a ratio of scales, and the step at which the search ends.
const STEPS: (f64, f64) = (1.08, 1.02);
/// Orders of the charts that are tried then, and the gain in scale that each must bring.
const ORDERS: (usize, f64) = (32, 1.005);
/// Charts that all these orders together may place: thousands of charts fill a texture well at
/// once.
const MOST_PLACED: usize = 8192;
/// How far chance moves a chart in the order, as a part of its size.
const SHUFFLE: f64 = 0.25;
/// Charts are not made smaller than this, in texels along the longest of them.
const SMALLEST: f64 = 1.0;
/// Masks up to this large share the row where the search begins.
const SMALL_MASK: u32 = 12;

/// Packs charts into a texture of `size`² texels. All get the same scale; their places become
/// texels. False, and no change but of places, if they do not fit.
pub(crate) fn pack(charts: &mut [Chart], size: u32) -> bool {
    if charts.is_empty() {
        return true;
    }
    let upright = |chart: &mut Chart| set_upright(&mut chart.places);
    let corners: Vec<DVec2> = parallel::map_items(charts.iter_mut(), upright);
    let packing = Packing::new(charts, &corners, size);
    let Some((scale, placed)) = packing.largest() else { return false };
    let cell = f64::from(packing.cell);
    for (i, chart) in charts.iter_mut().enumerate() {
        let (at, turn) = placed[i];
        let moved = |p: DVec2| turned(p * scale, corners[i] * scale, turn) + at.as_dvec2() * cell;
        chart.places.iter_mut().for_each(|p| *p = moved(*p));
    }
    true
}

/// A point of a chart with the box from the origin to `corner`, turned by quarters, so that the box
/// begins at the origin again.
fn turned(point: DVec2, corner: DVec2, quarters: usize) -> DVec2 {
    match quarters {
        0 => point,
        1 => DVec2::new(corner.y - point.y, point.x),
        2 => corner - point,
        _ => DVec2::new(point.y, corner.x - point.x),
    }
}

/// Where a chart is: its first cell, and its quarter turns.
type Placed = (UVec2, usize);

/// Charts to pack.
struct Packing<'a> {
    charts: &'a [Chart],
    corners: &'a [DVec2],
    size: u32,
    /// Texels along a cell, and cells along the page.
    cell: u32,
    side: u32,
}

impl<'a> Packing<'a> {
    fn new(charts: &'a [Chart], corners: &'a [DVec2], size: u32) -> Self {
        let share = f64::from(size) / (charts.len() as f64).sqrt();
        let cell = size.div_ceil(MOST_CELLS).min((share / CHART_CELLS) as u32).max(1);
        Self { charts, corners, size, cell, side: size / cell }
    }

    /// The charts, the largest first; of number 1 on, with some chance in what counts as large.
    fn order(&self, number: u64) -> Vec<usize> {
        let size = |i: usize| {
            let by_chance = SHUFFLE * chance(number, i as u64) * number.min(1) as f64;
            self.corners[i].element_sum() * (1.0 + by_chance)
        };
        let mut order: Vec<usize> = (0..self.charts.len()).collect();
        order.sort_by(|a, b| size(*b).total_cmp(&size(*a)));
        order
    }

    /// The largest scale that is found, in texels per world unit, and where the charts are then.
    fn largest(&self) -> Option<(f64, Vec<Placed>)> {
        // One texel and half the gutter around it, for each chart.
        let (count, room) = (self.charts.len() as f64, f64::from(self.size + GUTTER));
        if count * f64::from(1 + GUTTER).powi(2) > room * room || self.size <= 2 * MARGIN {
            return None;
        }
        let mut best = self.first_fit(&self.order(0), room)?;
        let mut masks = self.masks(best.0 * ORDERS.1);
        for number in 1..=ORDERS.0.min(MOST_PLACED / self.charts.len()) {
            let order = self.order(number as u64);
            while let Some(placed) = self.place(&masks, &order) {
                best = (best.0 * ORDERS.1, placed);
                masks = self.masks(best.0 * ORDERS.1);
            }
        }
        Some(best)
    }

    /// A scale at which the charts fit in this order and, a step further, do not.
    fn first_fit(&self, order: &[usize], room: f64) -> Option<(f64, Vec<Placed>)> {
        let longest = self.corners.iter().fold(0.0, |longest, corner| corner.x.max(longest));
        let try_at = |scale: f64| {
            let placed =
                if scale * longest < SMALLEST { None } else { self.place(&self.masks(scale), order) };
            placed.map(|placed| (scale, placed))
        };
        let mut scale = self.first_scale().clamp(SMALLEST / longest, room / longest);
        let (mut best, mut step, mut high) = (try_at(scale), STEPS.0, scale);
        if best.is_some() {
            while let Some(found) = try_at(scale * step) {
                scale = found.0;
                best = Some(found);
            }
            high = scale * step;
        } else {
            // In growing steps down.
            while best.is_none() && scale * longest >= SMALLEST {
                scale /= step;
                best = try_at(scale);
                high = scale * step;
                step *= step;
            }
        }
        while best.is_some() && high > scale * STEPS.1 {
            let middle = (scale * high).sqrt();
            match try_at(middle) {
                Some(found) => (best, scale) = (Some(found), middle),
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

    /// Places all charts in this order, if they fit.
    fn place(&self, masks: &[[CellMask; 4]], order: &[usize]) -> Option<Vec<Placed>> {
        let gutter = GUTTER.div_ceil(self.cell);
        if masks.iter().map(|turns| turns[0].cells()).sum::<usize>() > self.side.pow(2) as usize {
            return None;
        }
        let mut page = Page::new(self.side, MARGIN.div_ceil(self.cell));
        let mut placed = vec![(UVec2::ZERO, 0); self.charts.len()];
        let mut begin: HashMap<UVec2, u32> = HashMap::new();
        let mut scratch = Default::default();
        for &i in order {
            // That turn whose middle is lowest.
            let mut best: Option<(u32, Placed)> = None;
            for (turn, mask) in masks[i].iter().enumerate() {
                let small = mask.size.max_element() <= SMALL_MASK;
                let first = if small { begin.get(&mask.size).copied().unwrap_or(0) } else { 0 };
                let end =
                    best.map_or(self.side, |(middle, _)| middle.saturating_sub(mask.size.y).div_ceil(2));
                let Some(at) = page.find(mask, first..end, &mut scratch) else { continue };
                best = Some((2 * at.y + mask.size.y, (at, turn)));
                if small {
                    begin.insert(mask.size, at.y);
                }
            }
            let (_, (at, turn)) = best?;
            page.take(&masks[i][turn], at, gutter);
            placed[i] = (at, turn);
        }
        Some(placed)
    }

    /// The charts' cells in each quarter turn, at a scale in texels per world unit.
    fn masks(&self, scale: f64) -> Vec<[CellMask; 4]> {
        let scale = scale / f64::from(self.cell);
        let of_chart = |i: usize| {
            let (chart, corner) = (&self.charts[i], self.corners[i] * scale);
            [0, 1, 2, 3].map(|turn| {
                let place = |v: u32| turned(chart.places[v as usize] * scale, corner, turn).max(DVec2::ZERO);
                let far = if turn % 2 == 0 { corner } else { corner.yx() };
                CellMask::new(chart.triangles.iter().map(|t| t.map(place)), far)
            })
        };
        parallel::map(self.charts.len(), 1, of_chart)
    }
}

/// A number in [−1, 1) that looks like chance: SplitMix64 (Steele, Lea, Flood: "Fast splittable
/// pseudorandom number generators", OOPSLA 2014).
fn chance(series: u64, index: u64) -> f64 {
    let mut z = (series << 32 | index).wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    (z ^ z >> 31) as i64 as f64 / 2f64.powi(63)
}

/// Turns the points so that the axis-parallel box around them is smallest, with its low corner at
/// the origin and its long side along x. Returns the other corner. One side of the smallest box
/// lies on the convex hull (Freeman, Shapira: "Determining the minimum-area encasing rectangle for
/// an arbitrary closed curve", CACM 1975).
fn set_upright(points: &mut [DVec2]) -> DVec2 {
    let hull = convex_hull(points);
    let mut best = (f64::INFINITY, DVec2::X);
    for (i, from) in hull.iter().enumerate() {
        let Some(along) = (hull[(i + 1) % hull.len()] - *from).try_normalize() else { continue };
        let (low, high) = extent(hull.iter().map(|p| in_axes(*p, along)));
        let area = (high - low).x * (high - low).y;
        if area < best.0 {
            best = (area, along);
        }
    }
    let (low, high) = extent(hull.iter().map(|p| in_axes(*p, best.1)));
    let along = if (high - low).x < (high - low).y { best.1.perp() } else { best.1 };
    points.iter_mut().for_each(|p| *p = in_axes(*p, along));
    let (low, high) = extent(points.iter().copied());
    points.iter_mut().for_each(|p| *p -= low);
    high - low
}

/// The point in axes whose first is `along`.
fn in_axes(point: DVec2, along: DVec2) -> DVec2 {
    DVec2::new(point.dot(along), point.dot(along.perp()))
}

fn extent(points: impl Iterator<Item = DVec2>) -> (DVec2, DVec2) {
    points.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
}

/// Corners of the convex hull, counter-clockwise, by Andrew's monotone chain.
fn convex_hull(points: &[DVec2]) -> Vec<DVec2> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let chain = |points: &mut dyn Iterator<Item = &DVec2>| {
        let mut chain: Vec<DVec2> = Vec::new();
        for &point in points {
            while let [.., a, b] = chain[..]
                && (b - a).perp_dot(point - a) <= 0.0
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut sorted.iter());
    hull.extend(chain(&mut sorted.iter().rev()));
    hull
}

#[cfg(test)]
mod tests;
