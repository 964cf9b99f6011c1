//! A function of directions as a table over the sphere.
//!
//! Cells are those of a square grid over octahedral coordinates (Cigolle et al., "A Survey of Efficient Representations for Independent Unit Vectors", 2014).

use crate::math::statistics::median;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Cells a side.
const SIDE: usize = 48;
/// Sharpness of a kernel that reaches where a narrower one has seen nothing, and its weight.
const WIDE: f32 = 4.0;
const WIDE_SHARE: f32 = 1e-3;

/// RGB values by direction, and the mean of their squares.
#[derive(Clone, Debug, PartialEq)]
pub struct DirectionTable {
    cells: Vec<Vec3>,
    mean_square: Vec3,
}

impl DirectionTable {
    /// The same everywhere.
    pub fn constant(value: Vec3) -> Self {
        Self::new(vec![value; SIDE * SIDE])
    }

    fn new(cells: Vec<Vec3>) -> Self {
        let mean_square = cells.iter().map(|v| v * v).sum::<Vec3>() / cells.len() as f32;
        Self { cells, mean_square }
    }

    /// The mean of the squares of its cells.
    #[inline]
    pub fn mean_square(&self) -> Vec3 {
        self.mean_square
    }

    /// The value of the cell of a unit direction.
    #[inline]
    pub fn at(&self, direction: Vec3) -> Vec3 {
        self.cells[cell(direction)]
    }
}

/// The cell of a unit direction.
#[inline]
fn cell(direction: Vec3) -> usize {
    let sum = direction.abs().element_sum().max(f32::MIN_POSITIVE);
    let flat = Vec2::new(direction.x, direction.y) / sum;
    let folded = if direction.z < 0.0 {
        (Vec2::ONE - Vec2::new(flat.y.abs(), flat.x.abs())).copysign(flat)
    } else {
        flat
    };
    let at = ((folded + 1.0) * (0.5 * SIDE as f32)).clamp(Vec2::ZERO, Vec2::splat(SIDE as f32 - 1.0));
    at.y as usize * SIDE + at.x as usize
}

/// The unit direction of the middle of a cell.
fn middle(cell: usize) -> Vec3 {
    let at = |i: usize| (i as f32 + 0.5) * (2.0 / SIDE as f32) - 1.0;
    let (x, y) = (at(cell % SIDE), at(cell / SIDE));
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    Vec3::new(x - fold.copysign(x), y - fold.copysign(y), z).normalize()
}

/// Weighted sums by cell for a table T of which products f T are known: Σ w f², and Σ w f y for what is to be explained, y.
#[derive(Clone, Debug)]
pub(crate) struct Sums {
    squares: Vec<Vec3>,
    products: Vec<Vec3>,
}

impl Default for Sums {
    fn default() -> Self {
        Self { squares: vec![Vec3::ZERO; SIDE * SIDE], products: vec![Vec3::ZERO; SIDE * SIDE] }
    }
}

impl Sums {
    /// Adds an observation y = `value` of weight w, with the factor f, in a unit direction.
    #[inline]
    pub fn add(&mut self, direction: Vec3, weight: f32, factor: Vec3, value: Vec3) {
        let cell = cell(direction);
        self.squares[cell] += weight * factor * factor;
        self.products[cell] += weight * factor * value;
    }

    /// Adds other sums.
    pub fn merge(&mut self, other: &Self) {
        self.squares.iter_mut().zip(&other.squares).for_each(|(a, b)| *a += *b);
        self.products.iter_mut().zip(&other.products).for_each(|(a, b)| *a += *b);
    }

    /// The table ≥ 0 with least squared error, where it is smoothed by a spherical Gaussian of this sharpness. With `share`, a cell has also a
    /// value of its own: the smooth one counts beside its sums with this weight, relative to the median of the cells that are seen.
    pub fn table(&self, sharpness: f32, share: Option<f32>) -> DirectionTable {
        let middles: Vec<Vec3> = (0..SIDE * SIDE).map(middle).collect();
        let smooth = |i: usize| {
            let (mut products, mut squares) = (Vec3::ZERO, Vec3::splat(1e-30));
            for (j, other) in middles.iter().enumerate() {
                let apart = middles[i].dot(*other) - 1.0;
                let kernel = (sharpness * apart).exp() * sharpness + WIDE_SHARE * (WIDE * apart).exp() * WIDE;
                products += kernel * self.products[j];
                squares += kernel * self.squares[j];
            }
            products / squares
        };
        let smooth: Vec<Vec3> = (0..SIDE * SIDE).into_par_iter().map(smooth).collect();
        let Some(share) = share else {
            return DirectionTable::new(smooth.into_iter().map(|v| v.max(Vec3::ZERO)).collect());
        };
        let mut seen: Vec<f32> =
            self.squares.iter().map(|v| v.element_sum() / 3.0).filter(|square| *square > 0.0).collect();
        let weight = share * median(&mut seen).unwrap_or(1.0) + 1e-30;
        let own = |i: usize| (self.products[i] + weight * smooth[i]) / (self.squares[i] + weight);
        DirectionTable::new((0..smooth.len()).map(|i| own(i).max(Vec3::ZERO)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::fibonacci::fibonacci_axes;

    #[test]
    fn cells_know_their_middles() {
        (0..SIDE * SIDE).for_each(|i| assert_eq!(cell(middle(i)), i));
        for axis in fibonacci_axes(500) {
            assert!(middle(cell(axis)).angle_between(axis).to_degrees() < 5.0, "{axis}");
        }
    }

    #[test]
    fn a_table_is_found_from_products() {
        let truth = |axis: Vec3| Vec3::new(1.0 + axis.x, 0.5, 1.0 - axis.y);
        let mut sums = Sums::default();
        for (i, axis) in fibonacci_axes(20_000).into_iter().enumerate() {
            let factor = Vec3::splat(0.2 + 0.1 * (i % 7) as f32);
            sums.add(axis, 1.0, factor, factor * truth(axis));
        }
        for share in [None, Some(0.05)] {
            let table = sums.table(200.0, share);
            let worst = fibonacci_axes(300)
                .into_iter()
                .map(|axis| (table.at(axis) - truth(axis)).abs().max_element());
            assert!(worst.fold(0.0, f32::max) < 0.08);
        }
    }

    #[test]
    fn where_nothing_is_seen_the_surroundings_count() {
        let mut sums = Sums::default();
        sums.add(Vec3::Z, 1.0, Vec3::ONE, Vec3::splat(2.0));
        let table = sums.table(60.0, Some(0.05));
        assert!((table.at(Vec3::Z) - 2.0).abs().max_element() < 1e-3);
        assert!((table.at(Vec3::X) - 2.0).abs().max_element() < 0.1, "{}", table.at(Vec3::X));
    }
}
