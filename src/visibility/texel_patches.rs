//! Squares of texels that share shadows.
//!
//! A fine texture has more texels than shadows need. Then the texels of a square of k × k in texture space share one row, k the smallest that
//! leaves at most the wanted number of rows. A square across the border of two charts falls into one patch for each: texels share a row
//! only where they are near to each other on the surface and face alike.

use crate::mesh::atlas::TexelAtlas;
use glam::Vec3;

/// Row of a texel that has none.
pub(crate) const NO_ROW: u32 = u32::MAX;

/// Least cosine between the normals of texels that share a row.
const ALIKE: f32 = 0.7;
/// Largest distance between texels that share a row, relative to the square's diagonal at the mean size of a texel.
const NEAR: f32 = 2.0;

/// Rows of texels.
#[derive(Debug, PartialEq)]
pub(crate) struct Patches {
    /// Row of each texel; [`NO_ROW`] for texels that are not covered.
    pub rows: Vec<u32>,
    /// The texel of each row that stands for it: the one nearest to the middle of the square.
    pub texels: Vec<u32>,
}

impl Patches {
    /// The patches of `atlas`, about `most_rows` or fewer.
    pub fn of(atlas: &TexelAtlas, most_rows: usize) -> Self {
        let count = (0..atlas.covered.len()).filter(|&t| counts(atlas, t)).count();
        let side = (1..).find(|side| count / (side * side) <= most_rows).unwrap_or(1);
        let mut patches = Self { rows: vec![NO_ROW; atlas.covered.len()], texels: Vec::new() };
        let (width, height) = (atlas.width as usize, atlas.height as usize);
        let apart = NEAR * side as f32 * std::f32::consts::SQRT_2 * atlas.texel_size();
        for y in (0..height).step_by(side) {
            for x in (0..width).step_by(side) {
                let square = || {
                    (y..(y + side).min(height))
                        .flat_map(|y| (x..(x + side).min(width)).map(move |x| y * width + x))
                };
                let mut left: Vec<usize> = square().filter(|&t| counts(atlas, t)).collect();
                while !left.is_empty() {
                    left = patches.take(atlas, left, [x + side / 2, y + side / 2], apart);
                }
            }
        }
        patches
    }

    /// Makes one row of the texel nearest to `middle` and those that belong to it; returns the others.
    fn take(&mut self, atlas: &TexelAtlas, left: Vec<usize>, middle: [usize; 2], apart: f32) -> Vec<usize> {
        let width = atlas.width as usize;
        let from_middle =
            |t: &usize| (t % width).abs_diff(middle[0]).pow(2) + (t / width).abs_diff(middle[1]).pow(2);
        let Some(center) = left.iter().copied().min_by_key(from_middle) else { return Vec::new() };
        let row = self.texels.len() as u32;
        self.texels.push(center as u32);
        let alike = |t: usize| {
            let near = atlas.position[t].distance(atlas.position[center]) <= apart;
            t == center || near && atlas.normal[t].dot(atlas.normal[center]) >= ALIKE
        };
        let (own, others): (Vec<usize>, Vec<usize>) = left.into_iter().partition(|&t| alike(t));
        own.into_iter().for_each(|t| self.rows[t] = row);
        others
    }
}

/// Whether a texel has shadows at all.
fn counts(atlas: &TexelAtlas, texel: usize) -> bool {
    atlas.covered[texel] && atlas.normal[texel] != Vec3::ZERO
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Surface;
    use crate::mesh::primitive::{box_mesh, sphere_mesh};

    #[test]
    fn a_texture_that_is_coarse_enough_has_a_row_for_each_texel() {
        let surface = Surface::new(sphere_mesh(Vec3::ZERO, 1.0).unwrap(), 64).unwrap();
        let patches = Patches::of(surface.atlas(), 1 << 20);
        let covered = surface.atlas().covered.iter().filter(|&&c| c).count();
        assert_eq!(patches.texels.len(), covered);
        assert!(patches.texels.iter().zip(0..).all(|(&texel, row)| patches.rows[texel as usize] == row));
    }

    #[test]
    fn texels_that_share_a_row_are_near_and_face_alike() {
        for mesh in [sphere_mesh(Vec3::ZERO, 1.0).unwrap(), box_mesh(Vec3::ZERO, Vec3::ONE).unwrap()] {
            let surface = Surface::new(mesh, 256).unwrap();
            let atlas = surface.atlas();
            let covered: Vec<usize> = (0..atlas.covered.len()).filter(|&t| counts(atlas, t)).collect();
            let patches = Patches::of(atlas, covered.len() / 9);
            assert!(
                patches.texels.len() < covered.len() / 6,
                "{} of {}",
                patches.texels.len(),
                covered.len()
            );
            for t in covered {
                let center = patches.texels[patches.rows[t] as usize] as usize;
                assert!(atlas.normal[t].dot(atlas.normal[center]) > 0.69);
                assert!(atlas.position[t].distance(atlas.position[center]) < 0.1);
            }
        }
    }
}
