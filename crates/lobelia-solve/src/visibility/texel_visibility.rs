//! Tracing of the directions of each texel that other parts of the surface occlude.
//!
//! Rays are cast from every covered texel into the hemisphere above it, along a set of near-uniform
//! directions that is common to all texels. A row stores one bit per direction, and for each
//! occluded direction the texel that occludes it, for interreflection ([`crate::visibility`]).
//!
//! A fine texture has more texels than shadows need. Then the texels of a square of k × k in
//! texture space share one row, k the smallest that leaves at most the wanted number of rows. A
//! square across the border of two charts falls into one patch for each: texels share a row only
//! where they are near to each other on the surface and face alike.
//!
//! Memory per row: one bit per direction, and 4 bytes per occluded direction.

use glam::Vec3;
use lobelia_geometry::{error::stop::is_stopping, mesh::atlas::TexelAtlas, parallel};
use lobelia_sg::ray::Intersect;

/// Most directions.
pub(crate) const MAX_DIRECTIONS: usize = 4096;

/// Offset of the ray origin from the surface, relative to the radius of the object.
pub(crate) const OFFSET: f32 = 1e-4;
/// Directions that are near each other: their rays are traced together.
pub(crate) const TOGETHER: usize = 16;
/// Texels that a thread traces at a time.
const CHUNK: usize = 256;
/// Least cosine between the normals of texels that share a row.
const ALIKE: f32 = 0.7;
/// Largest distance between texels that share a row, relative to the square's diagonal at the mean
/// size of a texel.
const NEAR: f32 = 2.0;

/// Occluded directions of the texels of a surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TexelVisibility {
    /// Unit directions over the sphere, the same for every texel; those of each 16 are near each
    /// other.
    pub directions: Vec<Vec3>,
    /// Row of each texel; [`TexelVisibility::NONE`] for texels that are not covered.
    pub rows: Vec<u32>,
    /// The texel of each row from which it is traced.
    pub texels: Vec<u32>,
    /// Unit shading normal of each row.
    pub normals: Vec<Vec3>,
    /// `directions.len() / 64` words per row; a bit is set if the direction is occluded.
    hidden: Vec<u64>,
    /// Start of the `hiders` of each row, and the end of the last.
    first: Vec<u32>,
    /// The row of what occludes each occluded direction, in the order of the bits;
    /// [`TexelVisibility::NONE`] for a back face.
    hiders: Vec<u32>,
}

/// The indices of the bits that are set.
fn set_bits(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (word != 0).then(|| {
            let bit = word.trailing_zeros() as usize;
            word &= word - 1;
            bit
        })
    })
}

impl TexelVisibility {
    /// Row of a texel that has none.
    pub const NONE: u32 = u32::MAX;

    /// Traces `directions` from the covered texels of `atlas`, or of more than `most_rows` from
    /// squares of them, against `surface`, which has the same texels.
    ///
    /// # Panics
    /// If the number of directions is not a multiple of 64, or more than `MAX_DIRECTIONS`.
    pub fn trace(
        atlas: &TexelAtlas,
        surface: &dyn Intersect,
        mut directions: Vec<Vec3>,
        most_rows: usize,
    ) -> Self {
        assert!(directions.len().is_multiple_of(64), "the number of directions is a multiple of 64");
        assert!(directions.len() <= MAX_DIRECTIONS, "at most {MAX_DIRECTIONS} directions");
        cluster(&mut directions);
        let (rows, texels) = patches(atlas, most_rows);
        let trace = |&texel: &u32| {
            let (normal, mut hiders) = (atlas.normal[texel as usize], Vec::new());
            let origin = atlas.position[texel as usize] + normal * (OFFSET * surface.radius());
            let word = |directions: &[Vec3]| {
                // Whoever asked for it drops what is not traced ([`is_stopping`]).
                let parts = directions.chunks(TOGETHER).enumerate().filter(|_| !is_stopping());
                parts.fold(0, |word, (k, directions)| {
                    let bits = trace_together(surface, origin, normal, directions, &mut hiders);
                    word | u64::from(bits) << (k * TOGETHER)
                })
            };
            let hidden: Vec<u64> = directions.chunks(64).map(word).collect();
            (hidden, hiders)
        };
        let traced: Vec<(Vec<u64>, Vec<u32>)> = parallel::map_slice(&texels, CHUNK, trace);
        let row_of = |texel: &u32| rows.get(*texel as usize).copied().unwrap_or(Self::NONE);
        let ends = traced.iter().scan(0, |end, (_, hiders)| {
            *end += hiders.len() as u32;
            Some(*end)
        });
        Self {
            normals: texels.iter().map(|&t| atlas.normal[t as usize]).collect(),
            first: std::iter::once(0).chain(ends).collect(),
            hidden: traced.iter().flat_map(|(hidden, _)| hidden).copied().collect(),
            hiders: traced.iter().flat_map(|(_, hiders)| hiders).map(row_of).collect(),
            directions,
            rows,
            texels,
        }
    }

    /// The covered texels, each with its row.
    pub fn covered(&self) -> impl Iterator<Item = (usize, usize)> {
        let rows = self.rows.iter().enumerate().filter(|(_, row)| **row != Self::NONE);
        rows.map(|(texel, row)| (texel, *row as usize))
    }

    /// Means over the texels of each row of some values per texel.
    pub fn means<const N: usize>(&self, values: &(dyn Fn(u32) -> [Vec3; N] + Sync)) -> Vec<[Vec3; N]> {
        let mut sums = vec![([Vec3::ZERO; N], 0.0f32); self.texels.len()];
        for (texel, row) in self.covered() {
            let (sum, count) = &mut sums[row];
            sum.iter_mut().zip(values(texel as u32)).for_each(|(sum, value)| *sum += value);
            *count += 1.0;
        }
        sums.into_iter().map(|(sums, count)| sums.map(|sum| sum / count.max(1.0))).collect()
    }

    /// Number of rows.
    pub fn row_count(&self) -> usize {
        self.texels.len()
    }

    fn words(&self) -> usize {
        self.directions.len() / 64
    }

    /// Whether no direction of a row is occluded.
    pub fn sees_all(&self, row: usize) -> bool {
        self.first[row] == self.first[row + 1]
    }

    /// The occluded directions of a row, by index, with the rows of what occludes them.
    pub fn hidden(&self, row: usize) -> impl Iterator<Item = (usize, u32)> {
        let hiders = &self.hiders[self.first[row] as usize..self.first[row + 1] as usize];
        let words = &self.hidden[row * self.words()..(row + 1) * self.words()];
        let bits =
            words.iter().enumerate().flat_map(|(w, &word)| set_bits(word).map(move |bit| w * 64 + bit));
        bits.zip(hiders.iter().copied())
    }

    /// Whether any of the directions whose bits are set in `among` is occluded for a row.
    #[inline]
    pub fn hides_any(&self, row: usize, among: &[u64]) -> bool {
        self.hidden[row * self.words()..][..self.words()].iter().zip(among).any(|(a, b)| a & b != 0)
    }

    /// As [`Self::hidden`], of the directions whose bits are set in `among`.
    #[inline]
    pub fn hidden_among(&self, row: usize, among: &[u64]) -> impl Iterator<Item = (usize, u32)> {
        let words = &self.hidden[row * self.words()..][..self.words()];
        let mut first = self.first[row] as usize;
        words.iter().zip(among).enumerate().flat_map(move |(w, (&word, among))| {
            let hiders = &self.hiders[first..];
            first += word.count_ones() as usize;
            set_bits(word & among).map(move |bit| {
                let before = (word & ((1 << bit) - 1)).count_ones();
                (w * 64 + bit, hiders[before as usize])
            })
        })
    }

    /// Memory in bytes.
    pub fn bytes(&self) -> usize {
        let of_rows = size_of_val(&*self.hidden) + size_of_val(&*self.normals) + size_of_val(&*self.first);
        of_rows + 4 * (self.hiders.len() + self.rows.len() + self.texels.len())
    }
}

/// Casts rays into those of the directions that are above the surface; returns a bit for each that
/// is occluded, and adds what occludes it to `hiders`.
fn trace_together(
    surface: &dyn Intersect,
    origin: Vec3,
    normal: Vec3,
    directions: &[Vec3],
    hiders: &mut Vec<u32>,
) -> u16 {
    let (mut above, mut numbers, mut count) = ([Vec3::ZERO; TOGETHER], [0; TOGETHER], 0);
    for (number, direction) in directions.iter().enumerate().filter(|(_, d)| d.dot(normal) > 0.0) {
        (above[count], numbers[count]) = (*direction, number);
        count += 1;
    }
    let mut hits = [None; TOGETHER];
    surface.intersect_packet(origin, &above[..count], 0.0, &mut hits[..count]);
    let mut bits = 0;
    for (k, hit) in hits.iter().enumerate() {
        let Some(hit) = hit else { continue };
        bits |= 1 << numbers[k];
        // The back of an open surface reflects no light.
        let front = hit.geometric_normal.dot(above[k]) < 0.0;
        hiders.push(if front { heaviest(&hit.texels) } else { TexelVisibility::NONE });
    }
    bits
}

/// Sorts directions so that those of each [`TOGETHER`] are near each other.
pub(super) fn cluster(directions: &mut [Vec3]) {
    if directions.len() <= TOGETHER {
        return;
    }
    let low = directions.iter().fold(Vec3::MAX, |low, d| low.min(*d));
    let high = directions.iter().fold(Vec3::MIN, |high, d| high.max(*d));
    let widest = (high - low).max_position();
    directions.sort_by(|a, b| a[widest].total_cmp(&b[widest]));
    let (first, second) = directions.split_at_mut((directions.len() / 2).next_multiple_of(TOGETHER));
    cluster(first);
    cluster(second);
}

/// The row of each texel, about `most_rows` or fewer, and the texel of each row that stands for it:
/// the one nearest to the middle of the square.
fn patches(atlas: &TexelAtlas, most_rows: usize) -> (Vec<u32>, Vec<u32>) {
    let has_shadows = |t: &usize| atlas.covered[*t] && atlas.normal[*t] != Vec3::ZERO;
    let count = (0..atlas.covered.len()).filter(has_shadows).count();
    let side = (1..).find(|side| count / (side * side) <= most_rows).unwrap_or(1);
    let (mut rows, mut texels) = (vec![TexelVisibility::NONE; atlas.covered.len()], Vec::new());
    let (width, height) = (atlas.width as usize, atlas.height as usize);
    let apart = NEAR * side as f32 * std::f32::consts::SQRT_2 * atlas.texel_size();
    let squares = (0..height).step_by(side).flat_map(|y| (0..width).step_by(side).map(move |x| (x, y)));
    for (x, y) in squares {
        let lines = (y..(y + side).min(height)).map(|y| y * width);
        let square = lines.flat_map(|line| (x..(x + side).min(width)).map(move |x| line + x));
        let mut left: Vec<usize> = square.filter(has_shadows).collect();
        let from_middle =
            |t: &usize| (t % width).abs_diff(x + side / 2).pow(2) + (t / width).abs_diff(y + side / 2).pow(2);
        while let Some(center) = left.iter().copied().min_by_key(from_middle) {
            left.retain(|&t| {
                let near = atlas.position[t].distance(atlas.position[center]) <= apart;
                let is_own = t == center || near && atlas.normal[t].dot(atlas.normal[center]) >= ALIKE;
                if is_own {
                    rows[t] = texels.len() as u32;
                }
                !is_own
            });
            texels.push(center as u32);
        }
    }
    (rows, texels)
}

/// The texel with the greatest weight.
fn heaviest(address: &lobelia_sg::ray::TexelAddress) -> u32 {
    let best = (0..4).reduce(|a, b| if address.weights[b] > address.weights[a] { b } else { a });
    address.indices[best.unwrap_or(0)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3Swizzles;
    use lobelia_geometry::mesh::primitive::{ball_over_plate, box_mesh, sphere_mesh};
    use lobelia_geometry::mesh::{Surface, triangles::Mesh};
    use lobelia_sg::fibonacci::fibonacci_axes;

    fn traced(mesh: Mesh) -> (Surface, TexelVisibility) {
        let surface = Surface::new(mesh, 64).unwrap();
        let visibility = TexelVisibility::trace(surface.atlas(), &surface, fibonacci_axes(512), usize::MAX);
        (surface, visibility)
    }

    #[test]
    fn directions_are_ordered_so_that_each_sixteen_are_near_each_other() {
        for n in [64, 320, 512] {
            let (mut ordered, mut left) = (fibonacci_axes(n), fibonacci_axes(n));
            cluster(&mut ordered);
            left.retain(|direction| !ordered.contains(direction));
            assert!(ordered.len() == n && left.is_empty());
            // A cap with so many of the directions has 1 − cos ρ = 2·16/n.
            for near in ordered.chunks(TOGETHER) {
                let mean = near.iter().sum::<Vec3>().normalize();
                let farthest = near.iter().map(|d| 1.0 - d.dot(mean)).fold(0.0, f32::max);
                assert!(farthest < 3.5 * 32.0 / n as f32, "{n}: {farthest}");
            }
        }
    }

    #[test]
    fn convex_shapes_hide_nothing() {
        for mesh in [sphere_mesh(Vec3::ZERO, 0.8).unwrap(), box_mesh(Vec3::ZERO, Vec3::ONE).unwrap()] {
            let (_, visibility) = traced(mesh);
            let hidden: usize = (0..visibility.row_count()).map(|row| visibility.hidden(row).count()).sum();
            // Facets of a sphere rise a little over the tangent plane of interpolated normals.
            let all = visibility.row_count() * 256;
            assert!((hidden as f64) < 0.01 * all as f64, "{hidden} of {all}");
        }
    }

    #[test]
    fn a_ball_above_a_plate_hides_its_own_disc() {
        // A ball of radius 0.3 at height 1 over the middle of a thin plate covers 1 − cos(asin 0.3)
        // of 2π there.
        let mesh = ball_over_plate(0.02, 1.01, 0.3);
        let surface = Surface::new(mesh, 64).unwrap();
        let visibility = TexelVisibility::trace(surface.atlas(), &surface, fibonacci_axes(4096), usize::MAX);
        let middle = |row: &usize| {
            let at = surface.atlas().position[visibility.texels[*row] as usize];
            at.xz().length() < 0.1 && at.y > 0.0 && at.y < 0.1
        };
        let row = (0..visibility.row_count()).find(middle).unwrap();
        let part = visibility.hidden(row).count() as f64 / 4096.0;
        let exact = (1.0 - 0.3f64.asin().cos()) / 2.0;
        assert!((part / exact - 1.0).abs() < 0.1, "{part} {exact}");
        for (_, hider) in visibility.hidden(row) {
            let hider = surface.atlas().position[visibility.texels[hider as usize] as usize];
            assert!((hider - Vec3::new(0.0, 1.01, 0.0)).length() < 0.35, "{hider}");
        }
        let among: Vec<u64> = (0..64).map(|word| 0x9e37_79b9_7f4a_7c15_u64.rotate_left(word)).collect();
        let is_among = |(d, _): &(usize, u32)| among[d / 64] >> (d % 64) & 1 == 1;
        let some: Vec<_> = visibility.hidden(row).filter(is_among).collect();
        assert!(!some.is_empty() && some.len() < visibility.hidden(row).count());
        assert!(visibility.hidden_among(row, &among).eq(some));
    }

    #[test]
    fn texels_that_share_a_row_are_near_and_face_alike() {
        for mesh in [sphere_mesh(Vec3::ZERO, 1.0).unwrap(), box_mesh(Vec3::ZERO, Vec3::ONE).unwrap()] {
            let surface = Surface::new(mesh, 256).unwrap();
            let atlas = surface.atlas();
            // A texture that is coarse enough has a row for each texel.
            let (rows, covered) = patches(atlas, 1 << 20);
            assert!(covered.iter().zip(0..).all(|(&texel, row)| rows[texel as usize] == row));
            let (rows, texels) = patches(atlas, covered.len() / 9);
            assert!(texels.len() < covered.len() / 6, "{} of {}", texels.len(), covered.len());
            for t in covered.into_iter().map(|t| t as usize) {
                let center = texels[rows[t] as usize] as usize;
                assert!(atlas.normal[t].dot(atlas.normal[center]) > 0.69);
                assert!(atlas.position[t].distance(atlas.position[center]) < 0.1);
            }
        }
    }
}
