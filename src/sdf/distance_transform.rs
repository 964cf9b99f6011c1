//! Signed distance to the silhouette of a mask.
//!
//! The exact Euclidean transform of Felzenszwalb and Huttenlocher ("Distance Transforms of Sampled Functions", 2012), run
//! for the pixels on either side; next to the silhouette the coverage of partly covered pixels gives subpixel distances.

/// Signed distance in pixels from the center of every pixel to the silhouette of a mask, negative inside.
///
/// `coverage` holds `width * height` values in [0, 1]; the silhouette is at half coverage. A mask that is all inside or all
/// outside has no silhouette, and distances of the size of the image.
pub(crate) fn signed_distance(coverage: &[f32], width: usize, height: usize) -> Vec<f32> {
    assert_eq!(coverage.len(), width * height, "one coverage per pixel");
    let inside = |i: usize| coverage[i] >= 0.5;
    let to_inside = squared_distance(width, height, inside);
    let to_outside = squared_distance(width, height, |i| !inside(i));
    (0..coverage.len())
        .map(|i| {
            // Pixels next to the other side: the silhouette lies between the two centers, half a pixel away on average.
            let (far, sign) = if inside(i) { (to_outside[i], -1.0) } else { (to_inside[i], 1.0) };
            let partly = coverage[i] > 0.0 && coverage[i] < 1.0;
            if partly && far <= 2.0 { 0.5 - coverage[i] } else { sign * (far.sqrt() - 0.5) }
        })
        .collect()
}

/// Squared distance from every pixel to the nearest one that is `set`; at most that across the image.
fn squared_distance(width: usize, height: usize, set: impl Fn(usize) -> bool) -> Vec<f32> {
    let far = ((width + height) * (width + height)) as f32;
    let mut grid: Vec<f32> = (0..width * height).map(|i| if set(i) { 0.0 } else { far }).collect();
    let mut line = Vec::new();
    for x in 0..width {
        line.clear();
        line.extend((0..height).map(|y| grid[y * width + x]));
        for (y, value) in lower_envelope(&line).into_iter().enumerate() {
            grid[y * width + x] = value;
        }
    }
    for row in grid.chunks_exact_mut(width.max(1)) {
        let transformed = lower_envelope(row);
        row.copy_from_slice(&transformed);
    }
    grid
}

/// min over q of (p − q)² + f(q), for every p: the lower envelope of parabolas.
fn lower_envelope(f: &[f32]) -> Vec<f32> {
    let crossing = |q: usize, v: usize| {
        let (qf, vf) = (q as f32, v as f32);
        ((f[q] + qf * qf) - (f[v] + vf * vf)) / (2.0 * (qf - vf))
    };
    // Parabolas of the envelope, and the start of each.
    let (mut hull, mut starts) = (vec![0], vec![f32::NEG_INFINITY]);
    for q in 1..f.len() {
        let mut start = crossing(q, hull[hull.len() - 1]);
        while start <= starts[starts.len() - 1] {
            hull.pop();
            starts.pop();
            start = crossing(q, hull[hull.len() - 1]);
        }
        hull.push(q);
        starts.push(start);
    }
    let mut k = 0;
    (0..f.len())
        .map(|p| {
            while k + 1 < hull.len() && starts[k + 1] < p as f32 {
                k += 1;
            }
            let d = p as f32 - hull[k] as f32;
            d * d + f[hull[k]]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_to_a_disc_is_right_to_a_fraction_of_a_pixel() {
        let (n, radius) = (64usize, 20.0f32);
        let from_center = |i: usize| {
            let (x, y) = ((i % n) as f32 + 0.5 - 32.0, (i / n) as f32 + 0.5 - 32.0);
            (x * x + y * y).sqrt()
        };
        let coverage: Vec<f32> =
            (0..n * n).map(|i| (radius - from_center(i) + 0.5).clamp(0.0, 1.0)).collect();
        for (i, d) in signed_distance(&coverage, n, n).into_iter().enumerate() {
            assert!((d - (from_center(i) - radius)).abs() < 0.75, "pixel {i}: {d}");
        }
    }

    #[test]
    fn masks_without_a_silhouette_give_finite_distances() {
        for value in [0.0, 1.0] {
            assert!(signed_distance(&[value; 12], 4, 3).iter().all(|d| d.is_finite() && d.abs() > 5.0));
        }
    }
}
