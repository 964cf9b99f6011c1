//! Filling of texels that no view sees, and padding of seams.

use crate::mesh::atlas::TexelAtlas;
use glam::Vec3;

/// Cells along the longest side of the finest grid.
const FINEST_CELLS: u32 = 128;

/// Fills every texel that is not `known` from its nearest known neighbors.
///
/// Covered texels get the values of near texels in *world space*, across chart borders: known
/// values are averaged in a pyramid of grids over the object, and each unknown texel reads the
/// finest levels with known values around it, with smooth transitions to coarser levels (push-pull
/// in three dimensions). Then values grow ring by ring from covered texels across the gutters until
/// the texture is full, so that bilinear lookups and mipmaps never read an unset texel. Known
/// texels keep their bits. Non-finite known values count as unknown. If nothing is known, nothing
/// changes. Deterministic.
///
/// # Panics
/// If the three lengths differ.
pub fn fill_uncovered(values: &mut [Vec3], known: &[bool], atlas: &TexelAtlas) {
    let is_whole = values.len() == known.len() && known.len() == atlas.covered.len();
    assert!(is_whole, "one value and one flag per texel");
    let mut filled: Vec<bool> = values.iter().zip(known).map(|(v, &k)| k && v.is_finite()).collect();
    let sources: Vec<usize> = (0..values.len()).filter(|&i| filled[i] && atlas.covered[i]).collect();
    if !sources.is_empty() {
        let pyramid = Pyramid::new(atlas, values, &sources);
        for i in (0..values.len()).filter(|&i| atlas.covered[i]) {
            if !std::mem::replace(&mut filled[i], true) {
                values[i] = pyramid.sample(atlas.position[i]);
            }
        }
    }
    pad_outwards(values, &mut filled, atlas.width as usize, atlas.height as usize);
}

/// Mean known values in cubic grids over the object, each half as fine as the one before; the last
/// has one cell.
struct Pyramid {
    low: Vec3,
    /// Cells per side and mean values with the cell's weight (0 or 1), finest first.
    levels: Vec<(u32, Vec<(Vec3, f32)>)>,
    /// 1 / side of the whole cube.
    scale: f32,
}

impl Pyramid {
    fn new(atlas: &TexelAtlas, values: &[Vec3], sources: &[usize]) -> Self {
        let covered = || (0..values.len()).filter(|&i| atlas.covered[i]).map(|i| atlas.position[i]);
        let low = covered().fold(Vec3::INFINITY, Vec3::min);
        let side = (covered().fold(Vec3::NEG_INFINITY, Vec3::max) - low).max_element().max(f32::MIN_POSITIVE);
        let mut pyramid = Self { low, levels: Vec::new(), scale: 1.0 / side };
        // A grid finer than the spacing of texels only costs memory: use about as many cells per
        // side as texels.
        let mut cells = (2 * atlas.width.max(atlas.height) / 3).next_power_of_two().min(FINEST_CELLS);
        let mut sums = vec![(Vec3::ZERO, 0.0); (cells * cells * cells) as usize];
        for &source in sources {
            let unit = (atlas.position[source] - low) * pyramid.scale;
            let [x, y, z] = (unit * cells as f32).to_array().map(|c| (c as u32).min(cells - 1));
            let cell = &mut sums[((z * cells + y) * cells + x) as usize];
            cell.0 += values[source];
            cell.1 += 1.0;
        }
        let mean = |&(sum, count): &(Vec3, f32)| {
            if count > 0.0 { (sum / count, 1.0) } else { (Vec3::ZERO, 0.0) }
        };
        loop {
            pyramid.levels.push((cells, sums.iter().map(mean).collect()));
            if cells == 1 {
                return pyramid;
            }
            let half = cells / 2;
            let mut coarse = vec![(Vec3::ZERO, 0.0); (half * half * half) as usize];
            for (i, (sum, count)) in (0..).zip(&sums) {
                let [x, y, z] = [i % cells, i / cells % cells, i / (cells * cells)].map(|c| c / 2);
                let to = &mut coarse[((z * half + y) * half + x) as usize];
                to.0 += *sum;
                to.1 += count;
            }
            (sums, cells) = (coarse, half);
        }
    }

    /// From fine to coarse, each level fills the remaining weight in proportion to its own weight.
    fn sample(&self, position: Vec3) -> Vec3 {
        let unit = (position - self.low) * self.scale;
        let (mut value, mut open) = (Vec3::ZERO, 1.0);
        for (cells, means) in &self.levels {
            let (sum, weight) = trilinear(*cells, means, unit);
            value += sum * open;
            open *= 1.0 - weight.clamp(0.0, 1.0);
            if open < 1e-4 {
                break;
            }
        }
        value / (1.0 - open)
    }
}

/// Weighted sum and sum of weights of the eight cells around `unit` (in `[0, 1]³`), clamped at the
/// borders.
fn trilinear(cells: u32, means: &[(Vec3, f32)], unit: Vec3) -> (Vec3, f32) {
    let place = (unit * cells as f32 - 0.5).clamp(Vec3::ZERO, Vec3::splat((cells - 1) as f32));
    let low = place.floor();
    let fraction = place - low;
    let mut total = (Vec3::ZERO, 0.0);
    for corner in 0..8u32 {
        let [dx, dy, dz] = [corner & 1, corner >> 1 & 1, corner >> 2];
        let side = |d: u32, f: f32| if d == 1 { f } else { 1.0 - f };
        let weight = side(dx, fraction.x) * side(dy, fraction.y) * side(dz, fraction.z);
        if weight > 0.0 {
            let at = |l: f32, d: u32| (l as u32 + d).min(cells - 1);
            let [x, y, z] = [at(low.x, dx), at(low.y, dy), at(low.z, dz)];
            let (mean, known) = means[((z * cells + y) * cells + x) as usize];
            total.0 += mean * (weight * known);
            total.1 += weight * known;
        }
    }
    total
}

/// Grows values ring by ring: each empty texel gets the mean of its neighbors from previous rings.
fn pad_outwards(values: &mut [Vec3], filled: &mut [bool], width: usize, height: usize) {
    let neighbors = |i: usize| {
        let (x, y) = (i % width, i / width);
        let (rows, columns) =
            (y.saturating_sub(1)..(y + 2).min(height), x.saturating_sub(1)..(x + 2).min(width));
        rows.flat_map(move |row| columns.clone().map(move |column| row * width + column))
    };
    let mut ring: Vec<usize> =
        (0..values.len()).filter(|&i| !filled[i] && neighbors(i).any(|n| filled[n])).collect();
    let mut queued = filled.to_vec();
    ring.iter().for_each(|&i| queued[i] = true);
    while !ring.is_empty() {
        let mut next = Vec::new();
        for &i in &ring {
            let known = neighbors(i).filter(|&n| filled[n]).map(|n| values[n]);
            let (sum, count) = known.fold((Vec3::ZERO, 0.0), |(sum, count), v| (sum + v, count + 1.0));
            values[i] = sum / count;
            for n in neighbors(i) {
                if !std::mem::replace(&mut queued[n], true) {
                    next.push(n);
                }
            }
        }
        ring.iter().for_each(|&i| filled[i] = true);
        ring = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::atlas::{address, unwrap_mesh};
    use crate::mesh::primitive::{box_mesh, sphere_mesh};
    use crate::mesh::triangles::Mesh;

    /// Color as a smooth function of the position.
    fn paint(position: Vec3) -> Vec3 {
        Vec3::splat(1.0) + position * 0.5
    }

    #[test]
    fn a_lookup_at_a_seam_never_mixes_in_black() {
        let sphere = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
        let unwrapped = unwrap_mesh(&Mesh { uvs: None, ..sphere }, 128).unwrap().mesh;
        for mesh in [unwrapped, box_mesh(Vec3::ZERO, Vec3::ONE).unwrap()] {
            let atlas = TexelAtlas::new(&mesh, 128, 128);
            let color = |(&covered, &p)| if covered { paint(p) } else { Vec3::ZERO };
            let mut values: Vec<Vec3> = atlas.covered.iter().zip(&atlas.position).map(color).collect();
            fill_uncovered(&mut values, &atlas.covered.clone(), &atlas);
            let uvs = mesh.uvs.as_ref().unwrap();
            for triangle in &mesh.triangles {
                for k in 0..3 {
                    let [a, b] = [triangle[k] as usize, triangle[(k + 1) % 3] as usize];
                    for part in [0.0, 0.3, 0.5] {
                        let looked_up = address(uvs[a].lerp(uvs[b], part), 128, 128).blend(&values);
                        let truth = paint(mesh.positions[a].lerp(mesh.positions[b], part));
                        assert!((looked_up - truth).length() < 0.05, "{looked_up} instead of {truth}");
                    }
                }
            }
            // Mipmaps: no texel at all is left black.
            assert!(values.iter().all(|v| v.min_element() > 0.4));
        }
    }

    #[test]
    fn unseen_texels_follow_their_neighbors_in_space() {
        let sphere = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
        let mesh = unwrap_mesh(&Mesh { uvs: None, ..sphere }, 128).unwrap().mesh;
        let atlas = TexelAtlas::new(&mesh, 128, 128);
        // Only what is above y = −0.7 is known; red on the +x side, green on the other.
        let seen: Vec<bool> =
            (0..atlas.covered.len()).map(|i| atlas.covered[i] && atlas.position[i].y > -0.7).collect();
        let color = |p: Vec3| if p.x > 0.0 { Vec3::X } else { Vec3::Y };
        let start = |i: usize| if seen[i] { color(atlas.position[i]) } else { Vec3::splat(9.0) };
        let mut values: Vec<Vec3> = (0..seen.len()).map(start).collect();
        let before = values.clone();
        fill_uncovered(&mut values, &seen, &atlas);
        let mut filled = 0;
        for i in 0..values.len() {
            if seen[i] {
                assert_eq!(values[i], before[i]);
            } else if atlas.covered[i] {
                filled += 1;
                // A blend of the two colors, and the right one just below the border and away from
                // the divide.
                let v = values[i];
                assert!((v.x + v.y - 1.0).abs() < 1e-4 && v.z == 0.0, "{v}");
                let p = atlas.position[i];
                if p.y > -0.74 && p.x.abs() > 0.3 {
                    assert!(v.dot(color(p)) > 0.9, "{v} at {p}");
                }
            }
        }
        assert!(filled > 500);
        let mut again = before;
        fill_uncovered(&mut again, &seen, &atlas);
        assert_eq!(again, values);
    }

    #[test]
    fn nothing_known_changes_nothing_and_bad_values_count_as_unknown() {
        let atlas = TexelAtlas::new(&box_mesh(Vec3::ZERO, Vec3::ONE).unwrap(), 32, 32);
        let mut values = vec![Vec3::splat(0.25); 32 * 32];
        fill_uncovered(&mut values, &vec![false; 32 * 32], &atlas);
        assert!(values.iter().all(|&v| v == Vec3::splat(0.25)));
        values[100] = Vec3::NAN;
        fill_uncovered(&mut values, &vec![true; 32 * 32], &atlas);
        assert!((values[100] - Vec3::splat(0.25)).length() < 1e-6);
    }
}
