//! Values that are computed block by block, so that blocks in which nothing changes cost one look at their middle.

use crate::sdf::grid::SdfGrid;
use glam::{UVec3, Vec3};
use rayon::prelude::*;

/// Vertices of a block along each axis.
const BLOCK: u32 = 8;

impl SdfGrid {
    /// The values, replaced by `value` of their indices. `most` gets the center and the radius of the ball around a block: where it gives a
    /// number, the block keeps its values, but none above that number.
    pub(crate) fn replaced_in_blocks(
        &self,
        most: impl Fn(Vec3, f32) -> Option<f32> + Sync,
        value: impl Fn(usize) -> f32 + Sync,
    ) -> Vec<f32> {
        let plane = (self.side * self.side) as usize;
        let mut values = self.values.clone();
        let layers = values.par_chunks_mut(plane * BLOCK as usize).enumerate();
        layers.for_each(|(layer, part)| {
            let first = layer * BLOCK as usize * plane;
            for block in self.blocks_of_layer(layer as u32) {
                let (low, high) = (self.position(block.0), self.position(block.1 - UVec3::ONE));
                let most = most(0.5 * (low + high), 0.5 * low.distance(high));
                let replaced =
                    |row: usize| most.map_or_else(|| value(row), |most| self.values[row].min(most));
                self.rows_of(block).for_each(|row| part[row - first] = replaced(row));
            }
        });
        values
    }

    /// The lowest vertices of the blocks of a layer, and those beyond their highest.
    fn blocks_of_layer(&self, layer: u32) -> impl Iterator<Item = (UVec3, UVec3)> + use<> {
        let (side, count) = (self.side, self.side.div_ceil(BLOCK));
        (0..count * count).map(move |i| {
            let low = BLOCK * UVec3::new(i % count, i / count, layer);
            (low, (low + BLOCK).min(UVec3::splat(side)))
        })
    }

    /// The indices of a block's vertices.
    fn rows_of(&self, (low, high): (UVec3, UVec3)) -> impl Iterator<Item = usize> {
        let lines = (low.z..high.z).flat_map(move |z| (low.y..high.y).map(move |y| (y, z)));
        lines.flat_map(move |(y, z)| {
            let first = self.index(UVec3::new(low.x, y, z));
            first..first + (high.x - low.x) as usize
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_outside_the_blocks_that_stay_is_replaced() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 20, |p| p.length() - 0.6);
        let all = grid.replaced_in_blocks(|_, _| None, |row| row as f32);
        assert!(all.iter().enumerate().all(|(row, value)| *value == row as f32));
        let far = grid.replaced_in_blocks(|middle, radius| (middle.x - radius > 0.0).then_some(0.3), |_| 7.0);
        for (row, value) in far.iter().enumerate() {
            let point = grid.position(grid.vertex(row));
            assert!(*value == 7.0 || (*value == grid.values[row].min(0.3) && point.x > 0.0), "{point}");
        }
        assert!(far.contains(&0.3) && far.iter().any(|value| *value < 0.3));
    }
}
