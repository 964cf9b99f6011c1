//! Tracing of the directions of each texel that other parts of the surface occlude.
//!
//! Rays are cast from every covered texel into the hemisphere above it, along a set of near-uniform directions that is common to all
//! texels. A row stores one bit per direction, and for each occluded direction the texel that occludes it, for interreflection
//! ([`crate::visibility`]). In a fine texture a row stands for a small square of texels ([`crate::visibility::texel_patches`]): shadows need less
//! resolution than albedo, and their memory and time stay bounded.
//!
//! | parameter | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | `directions` | `Vec<Vec3>` | unit | none | near-uniform directions over the whole sphere, a multiple of 64 |
//!
//! Memory per row: one bit per direction, and 4 bytes per occluded direction.

use crate::error::Result;
use crate::error::stop::is_stopping;
use crate::math::ray::Intersect;
use crate::mesh::atlas::TexelAtlas;
use crate::ranks::Ranks;
use crate::visibility::texel_patches::{NO_ROW, Patches};
use glam::Vec3;
use rayon::prelude::*;

/// Most directions.
pub(crate) const MAX_DIRECTIONS: usize = 4096;

/// Offset of the ray origin from the surface, relative to the radius of the object.
pub(crate) const OFFSET: f32 = 1e-4;
/// Directions that are near each other: their rays are traced together.
pub(crate) const TOGETHER: usize = 16;
/// Texels that a thread traces at a time.
const CHUNK: usize = 256;

/// Occluded directions of the texels of a surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TexelVisibility {
    /// Unit directions over the sphere, the same for every texel; those of each 16 are near each other.
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
    /// The row of what occludes each occluded direction, in the order of the bits; [`TexelVisibility::NONE`] for a back face.
    hiders: Vec<u32>,
}

/// The indices of the bits that are set.
fn set_bits(words: &[u64]) -> impl Iterator<Item = usize> {
    words.iter().enumerate().flat_map(|(w, &word)| set_bits_of(word).map(move |bit| w * 64 + bit))
}

fn set_bits_of(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (word != 0).then(|| {
            let bit = word.trailing_zeros() as usize;
            word &= word - 1;
            bit
        })
    })
}

/// The result of a thread, or of a process, for a range of rows.
#[derive(Default)]
struct Traced {
    hidden: Vec<u64>,
    counts: Vec<u32>,
    hiders: Vec<u32>,
}

impl Traced {
    fn append(&mut self, mut next: Self) {
        self.hidden.append(&mut next.hidden);
        self.counts.append(&mut next.counts);
        self.hiders.append(&mut next.hiders);
    }

    /// All rows in order, of which each process has traced its share; each has so many `words` of bits.
    fn completed(self, ranks: &Ranks, rows: usize, words: usize) -> Result<Self> {
        let counts = ranks.joined(&self.counts, rows, u32::to_le_bytes, u32::from_le_bytes)?;
        let hidden = counts.iter().map(|count| *count as usize).sum();
        Ok(Self {
            hidden: ranks.joined(&self.hidden, rows * words, u64::to_le_bytes, u64::from_le_bytes)?,
            hiders: ranks.joined(&self.hiders, hidden, u32::to_le_bytes, u32::from_le_bytes)?,
            counts,
        })
    }
}

impl TexelVisibility {
    /// Row of a texel that has none.
    pub const NONE: u32 = NO_ROW;

    /// Traces `directions` from the covered texels of `atlas`, or of more than `most_rows` from squares of them, against `surface`, which
    /// has the same texels. `ranks` divide the rows.
    ///
    /// # Errors
    /// If another process is gone.
    ///
    /// # Panics
    /// If the number of directions is not a multiple of 64, or more than [`MAX_DIRECTIONS`].
    pub fn trace(
        atlas: &TexelAtlas,
        surface: &dyn Intersect,
        directions: Vec<Vec3>,
        most_rows: usize,
        ranks: Option<&Ranks>,
    ) -> Result<Self> {
        assert!(directions.len().is_multiple_of(64), "the number of directions is a multiple of 64");
        assert!(directions.len() <= MAX_DIRECTIONS, "at most {MAX_DIRECTIONS} directions");
        let directions = clustered(directions);
        let Patches { rows, texels } = Patches::of(atlas, most_rows);
        let own = ranks.map_or(0..texels.len(), |ranks| ranks.share(texels.len(), CHUNK));
        let parts: Vec<Traced> = texels[own]
            .par_chunks(CHUNK)
            .map(|run| {
                let mut traced = Traced::default();
                run.iter().for_each(|&t| trace_texel(atlas, surface, &directions, t as usize, &mut traced));
                traced
            })
            .collect();
        let mut traced = Traced::default();
        parts.into_iter().for_each(|part| traced.append(part));
        if let Some(ranks) = ranks {
            traced = traced.completed(ranks, texels.len(), directions.len() / 64)?;
        }
        let row_of = |texel: &u32| rows.get(*texel as usize).copied().unwrap_or(Self::NONE);
        let ends = traced.counts.iter().scan(0, |end, count| {
            *end += count;
            Some(*end)
        });
        Ok(Self {
            normals: texels.iter().map(|&t| atlas.normal[t as usize]).collect(),
            hidden: traced.hidden,
            first: std::iter::once(0).chain(ends).collect(),
            hiders: traced.hiders.par_iter().map(row_of).collect(),
            directions,
            rows,
            texels,
        })
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
    pub fn len(&self) -> usize {
        self.texels.len()
    }

    /// Words of bits per row.
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
        set_bits(words).zip(hiders.iter().copied())
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
            set_bits_of(word & among).map(move |bit| {
                let before = (word & ((1 << bit) - 1)).count_ones();
                (w * 64 + bit, hiders[before as usize])
            })
        })
    }

    /// Memory in bytes.
    pub fn bytes(&self) -> usize {
        let of = |count: usize, size: usize| count * size;
        of(self.hidden.len(), 8)
            + of(self.hiders.len() + self.first.len() + self.rows.len() + self.texels.len(), 4)
            + of(self.normals.len(), size_of::<Vec3>())
    }
}

fn trace_texel(
    atlas: &TexelAtlas,
    surface: &dyn Intersect,
    directions: &[Vec3],
    texel: usize,
    out: &mut Traced,
) {
    let normal = atlas.normal[texel];
    let reach = OFFSET * surface.radius();
    let origin = atlas.position[texel] + normal * reach;
    let before = out.hiders.len();
    for directions in directions.chunks(64) {
        // Whoever asked for it drops what is not traced ([`is_stopping`]).
        let traced = directions.chunks(TOGETHER).enumerate().filter(|_| !is_stopping());
        let words = traced.map(|(k, directions)| {
            u64::from(trace_together(surface, origin, normal, directions, &mut out.hiders)) << (k * TOGETHER)
        });
        out.hidden.push(words.fold(0, |word, part| word | part));
    }
    out.counts.push((out.hiders.len() - before) as u32);
}

/// Casts rays into those of the directions that are above the surface; returns a bit for each that is occluded, and adds what occludes it to `hiders`.
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

/// Directions in an order in which those of each [`TOGETHER`] are near each other.
pub(super) fn clustered(mut directions: Vec<Vec3>) -> Vec<Vec3> {
    cluster(&mut directions);
    directions
}

fn cluster(directions: &mut [Vec3]) {
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

/// The texel with the greatest weight.
fn heaviest(address: &crate::math::ray::TexelAddress) -> u32 {
    let best = (0..4).reduce(|a, b| if address.weights[b] > address.weights[a] { b } else { a });
    address.indices[best.unwrap_or(0)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::fibonacci::fibonacci_axes;
    use crate::mesh::Surface;
    use crate::mesh::primitive::{ball_over_plate, box_mesh, sphere_mesh};
    use crate::mesh::triangles::Mesh;
    use glam::Vec3Swizzles;

    fn traced(mesh: Mesh) -> (Surface, TexelVisibility) {
        let surface = Surface::new(mesh, 64).unwrap();
        let visibility =
            TexelVisibility::trace(surface.atlas(), &surface, fibonacci_axes(512), usize::MAX, None).unwrap();
        (surface, visibility)
    }

    #[test]
    fn directions_are_ordered_so_that_each_sixteen_are_near_each_other() {
        for n in [64, 320, 512] {
            let ordered = clustered(fibonacci_axes(n));
            let mut left = fibonacci_axes(n);
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
            let hidden: usize = (0..visibility.len()).map(|row| visibility.hidden(row).count()).sum();
            // Facets of a sphere rise a little over the tangent plane of interpolated normals.
            let all = visibility.len() * 256;
            assert!((hidden as f64) < 0.01 * all as f64, "{hidden} of {all}");
        }
    }

    #[test]
    fn a_ball_above_a_plate_hides_its_own_disc() {
        // A ball of radius 0.3 at height 1 over the middle of a thin plate covers 1 − cos(asin 0.3) of 2π there.
        let mesh = ball_over_plate(0.02, 1.01, 0.3);
        let surface = Surface::new(mesh, 64).unwrap();
        let visibility =
            TexelVisibility::trace(surface.atlas(), &surface, fibonacci_axes(4096), usize::MAX, None)
                .unwrap();
        let middle = |row: &usize| {
            let at = surface.atlas().position[visibility.texels[*row] as usize];
            at.xz().length() < 0.1 && at.y > 0.0 && at.y < 0.1
        };
        let row = (0..visibility.len()).find(middle).unwrap();
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
}
