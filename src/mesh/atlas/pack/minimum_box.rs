//! The rotation that makes a chart's box smallest.
//!
//! Freeman, Shapira: "Determining the minimum-area encasing rectangle for an arbitrary closed curve", CACM 1975: one side of the box lies on
//! the convex hull, here by Andrew's monotone chain.

use glam::DVec2;

/// Turns the points so that the axis-parallel box around them is smallest, with its low corner at the origin and its long side along x.
/// Returns the other corner.
pub(crate) fn set_upright(points: &mut [DVec2]) -> DVec2 {
    let hull = convex_hull(points);
    let mut best = (f64::INFINITY, DVec2::X);
    for (i, from) in hull.iter().enumerate() {
        let Some(along) = (hull[(i + 1) % hull.len()] - *from).try_normalize() else { continue };
        let (low, high) = extent(hull.iter().map(|p| turned(*p, along)));
        let area = (high - low).x * (high - low).y;
        if area < best.0 {
            best = (area, along);
        }
    }
    let (low, high) = extent(hull.iter().map(|p| turned(*p, best.1)));
    let along = if (high - low).x < (high - low).y { best.1.perp() } else { best.1 };
    points.iter_mut().for_each(|p| *p = turned(*p, along));
    let (low, high) = extent(points.iter().copied());
    points.iter_mut().for_each(|p| *p -= low);
    high - low
}

/// The point in axes whose first is `along`.
fn turned(point: DVec2, along: DVec2) -> DVec2 {
    DVec2::new(point.dot(along), point.dot(along.perp()))
}

fn extent(points: impl Iterator<Item = DVec2>) -> (DVec2, DVec2) {
    points.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
}

/// Corners of the convex hull, counter-clockwise.
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
