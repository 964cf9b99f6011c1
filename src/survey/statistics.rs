//! Views that stray from their neighbors.

use crate::math::statistics::median;
use glam::Vec3;

/// Factor from the median absolute deviation to the standard deviation of a normal distribution.
const SIGMA_PER_MAD: f32 = 1.4826;

/// For each of several directions, the indices of the `count` nearest others, the nearest first.
///
/// Directions have unit length. Equal distances are ordered by index.
pub fn neighbors(directions: &[Vec3], count: usize) -> Vec<Vec<usize>> {
    let nearest = |i: usize| {
        let mut others: Vec<usize> = (0..directions.len()).filter(|&k| k != i).collect();
        let closeness = |k: &usize| -directions[i].dot(directions[*k]);
        others.sort_by(|a, b| closeness(a).total_cmp(&closeness(b)).then(a.cmp(b)));
        others.truncate(count);
        others
    };
    (0..directions.len()).map(nearest).collect()
}

/// How far each value is from the median of its neighbors' values, and that in standard deviations of all such differences (at
/// least `floor`).
pub(crate) fn strays(values: &[f32], neighbors: &[Vec<usize>], floor: f32) -> Vec<(f32, f32)> {
    let difference = |(value, near): (&f32, &Vec<usize>)| {
        let mut near: Vec<f32> = near.iter().map(|&k| values[k]).collect();
        median(&mut near).map_or(0.0, |median| value - median)
    };
    let differences: Vec<f32> = values.iter().zip(neighbors).map(difference).collect();
    let mut sizes: Vec<f32> = differences.iter().map(|difference| difference.abs()).collect();
    let sigma = (SIGMA_PER_MAD * median(&mut sizes).unwrap_or(0.0)).max(floor);
    differences.into_iter().map(|difference| (difference, difference / sigma)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_unlike_its_neighbors_strays() {
        let directions: Vec<Vec3> = (0..24)
            .map(|i| {
                let (s, c) = (0.26 * i as f32).sin_cos();
                Vec3::new(s, c, 0.0)
            })
            .collect();
        let near = neighbors(&directions, 4);
        assert!(near[7].contains(&6) && near[7].contains(&8) && !near[7].contains(&7), "{:?}", near[7]);
        let mut values: Vec<f32> = (0..24).map(|i| (0.26 * i as f32).sin()).collect();
        values[7] -= 2.0;
        let strays = strays(&values, &near, 0.01);
        let worst = (0..24).min_by(|a, b| strays[*a].1.total_cmp(&strays[*b].1)).unwrap();
        assert_eq!(worst, 7);
        assert!(strays[7].0 < -1.5 && strays[7].1 < -5.0 && strays[15].1.abs() < 5.0, "{strays:?}");
    }
}
