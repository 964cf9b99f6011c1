//! Pairs of texels that are neighbors on the surface.

use crate::mesh::atlas::TexelAtlas;
use glam::IVec3;
use std::collections::HashMap;

/// Most distance of neighbors in a chart, in texels: a gutter between two charts is no neighborhood.
const BESIDE: f32 = 3.0;
/// Most distance of neighbors in two charts, in texels.
const ACROSS: f32 = 1.5;
/// Least cosine between the normals of neighbors in two charts: not the other side of a thin wall.
const ALIKE: f32 = 0.5;

impl TexelAtlas {
    /// Pairs of covered texels that are near each other on the surface: side by side in a chart, and
    /// the nearest one of another chart for a texel at a border.
    pub fn neighbors(&self) -> Vec<[u32; 2]> {
        let (width, count) = (self.width as usize, self.covered.len());
        let size = self.texel_size();
        let distance = |a: usize, b: usize| self.position[a].distance(self.position[b]);
        let beside = |i: usize| {
            let right = (i % width + 1 < width).then_some(i + 1);
            [right, Some(i + width).filter(|j| *j < count)].into_iter().flatten()
        };
        let covered = || (0..count).filter(|i| self.covered[*i]);
        let mut pairs = Vec::new();
        let mut degree = vec![0u8; count];
        for i in covered() {
            for j in beside(i).filter(|j| self.covered[*j] && distance(i, *j) < BESIDE * size) {
                pairs.push([i as u32, j as u32]);
                degree[i] += 1;
                degree[j] += 1;
            }
        }
        // Those at borders, by cells of space.
        let cell = |i: usize| (self.position[i] / (ACROSS * size)).floor().as_ivec3();
        let borders = || covered().filter(|i| degree[*i] < 4);
        let mut cells: HashMap<IVec3, Vec<usize>> = HashMap::new();
        borders().for_each(|i| cells.entry(cell(i)).or_default().push(i));
        for i in borders() {
            let around = (0..27).map(|k| cell(i) + IVec3::new(k % 3, k / 3 % 3, k / 9) - 1);
            let is_apart = |j: usize| {
                (j % width).abs_diff(i % width).max((j / width).abs_diff(i / width)) as f32 > BESIDE
            };
            let is_near = |j: &usize| {
                distance(i, *j) < ACROSS * size && is_apart(*j) && self.normal[i].dot(self.normal[*j]) > ALIKE
            };
            let near = around.flat_map(|at| cells.get(&at).into_iter().flatten().copied()).filter(is_near);
            let nearest = near.min_by(|a, b| distance(i, *a).total_cmp(&distance(i, *b)));
            pairs.extend(nearest.map(|j| [i as u32, j as u32]));
        }
        pairs
    }
}

#[cfg(test)]
mod tests {
    use crate::mesh::{Surface, primitive::sphere_mesh};
    use glam::Vec3;

    #[test]
    fn neighbors_are_near_and_lead_across_all_charts() {
        let surface = Surface::new(sphere_mesh(Vec3::ZERO, 0.8).unwrap(), 64).unwrap();
        let atlas = surface.atlas();
        let pairs = atlas.neighbors();
        let mut part: Vec<usize> = (0..atlas.covered.len()).collect();
        fn first(part: &[usize], mut i: usize) -> usize {
            while part[i] != i {
                i = part[i];
            }
            i
        }
        for [a, b] in pairs.iter().map(|pair| pair.map(|texel| texel as usize)) {
            assert!(atlas.covered[a] && atlas.covered[b]);
            assert!(atlas.position[a].distance(atlas.position[b]) < 3.0 * atlas.texel_size());
            let [a, b] = [first(&part, a), first(&part, b)];
            part[a.max(b)] = a.min(b);
        }
        let covered: Vec<usize> = (0..atlas.covered.len()).filter(|i| atlas.covered[*i]).collect();
        let one = first(&part, covered[0]);
        let joined = covered.iter().filter(|i| first(&part, **i) == one).count();
        assert!(joined * 100 > covered.len() * 98, "{joined} of {}", covered.len());
    }
}
