//! Low-discrepancy random numbers: Owen-scrambled Sobol' points, three dimensions at a time.
//!
//! Every random decision of a path draws one *group* of three numbers. Within a group the points of
//! a pixel's samples are a Sobol' net; different groups and different pixels are shuffled and
//! scrambled independently by hashes ("padding"), after Burley, "Practical Hash-based Owen
//! Scrambling", JCGT 9(4), 2020, with Vegdahl's hash. The numbers depend on (seed, stream, sample,
//! group) only, not on threads or call order.
//!
//! ```
//! use lobelia_solve::shade::sampling::sobol::Sequence;
//!
//! let mut counts = [0; 256];
//! for sample in 0..256 {
//!     let [u, ..] = Sequence::new(7, 3, sample).group(0);
//!     counts[(u * 256.0) as usize] += 1;
//! }
//! // One number lies in each of as many intervals.
//! assert_eq!(counts, [1; 256]);
//! ```

/// Direction numbers of the first three Sobol' dimensions (Joe and Kuo's `new-joe-kuo-6`).
const DIRECTIONS: [[u32; 32]; 3] =
    [directions(0, 0, [0, 0]), directions(1, 0, [1, 0]), directions(2, 1, [1, 3])];

/// Direction numbers of the primitive polynomial of `degree` with inner coefficients `inner`;
/// degree 0 is van der Corput's.
const fn directions(degree: usize, inner: u32, initial: [u32; 2]) -> [u32; 32] {
    let mut v = [0u32; 32];
    let mut i = 0;
    while i < 32 {
        v[i] = if degree == 0 {
            1 << (31 - i)
        } else if i < degree {
            initial[i] << (31 - i)
        } else {
            let mut x = v[i - degree] ^ (v[i - degree] >> degree);
            let mut k = 1;
            while k < degree {
                if (inner >> (degree - 1 - k)) & 1 == 1 {
                    x ^= v[i - k];
                }
                k += 1;
            }
            x
        };
        i += 1;
    }
    v
}

/// The Sobol' point `index` in one dimension, as a 32-bit fixed-point fraction.
#[inline]
fn sobol(mut index: u32, dimension: usize) -> u32 {
    if dimension == 0 {
        return index.reverse_bits();
    }
    let mut x = 0;
    while index != 0 {
        x ^= DIRECTIONS[dimension][index.trailing_zeros() as usize];
        index &= index - 1;
    }
    x
}

/// Nested uniform (Owen) scrambling of a fixed-point fraction: each bit is flipped by a hash of the
/// bits above it.
#[inline]
fn owen_scramble(x: u32, seed: u32) -> u32 {
    let mut x = x.reverse_bits();
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// A well-mixed 64-bit hash of two words (the finalizer of SplitMix64).
#[inline]
pub fn hash(a: u64, b: u64) -> u64 {
    let mut z = a.wrapping_add(b.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The random numbers of one sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct Sequence {
    key: u64,
    sample: u32,
}

impl Sequence {
    /// The numbers of sample `sample` of `stream` (a pixel, say) under `seed`.
    #[inline]
    pub fn new(seed: u64, stream: u64, sample: u32) -> Self {
        Self { key: hash(hash(seed, 0x6c6f_6265), stream), sample }
    }

    /// Three 32-bit fixed-point fractions for the decision number `group`.
    #[inline]
    pub fn group_bits(&self, group: u32) -> [u32; 3] {
        let first = hash(self.key, u64::from(group));
        let second = hash(first, 1);
        let index = owen_scramble(self.sample, first as u32);
        [
            owen_scramble(sobol(index, 0), (first >> 32) as u32),
            owen_scramble(sobol(index, 1), second as u32),
            owen_scramble(sobol(index, 2), (second >> 32) as u32),
        ]
    }

    /// Three numbers in `[0, 1)` for the decision number `group`.
    #[inline]
    pub fn group(&self, group: u32) -> [f32; 3] {
        // 24 bits, so that the result stays below one.
        self.group_bits(group).map(|bits| (bits >> 8) as f32 * (1.0 / 16_777_216.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first two dimensions are a (0, m, 2)-net: 256 points put one in each cell of every grid
    /// of 256 cells.
    #[test]
    fn points_are_stratified_in_every_dimension() {
        for group in 0..8 {
            let mut seen = [[0u32; 256]; 3];
            let mut grid = [0u32; 256];
            for sample in 0..256 {
                let bits = Sequence::new(7, 3, sample).group_bits(group);
                for d in 0..3 {
                    seen[d][(bits[d] >> 24) as usize] += 1;
                }
                grid[((bits[0] >> 28) * 16 + (bits[1] >> 28)) as usize] += 1;
            }
            assert!(seen.iter().flatten().all(|&n| n == 1), "group {group}: one point in each 1/256");
            assert!(grid.iter().all(|&n| n == 1), "group {group}: one point in each cell of 16 × 16");
        }
    }

    #[test]
    fn streams_and_groups_differ_and_repeat() {
        let a = Sequence::new(1, 2, 3).group_bits(0);
        assert_eq!(a, Sequence::new(1, 2, 3).group_bits(0));
        for other in [Sequence::new(1, 3, 3), Sequence::new(2, 2, 3), Sequence::new(1, 2, 4)] {
            assert_ne!(a, other.group_bits(0));
        }
        assert_ne!(a, Sequence::new(1, 2, 3).group_bits(1));
    }

    /// Scrambled points are uniform: over independent streams the first point's mean and mean
    /// square are ½ and ⅓.
    #[test]
    fn each_point_is_uniform_over_streams() {
        let count = 20_000;
        let (mut mean, mut square) = (0.0, 0.0);
        for stream in 0..count {
            let u = f64::from(Sequence::new(5, stream, 9).group(2)[2]);
            mean += u;
            square += u * u;
        }
        let n = count as f64;
        assert!((mean / n - 0.5).abs() < 4.0 * (1.0f64 / 12.0 / n).sqrt());
        assert!((square / n - 1.0 / 3.0).abs() < 4.0 * (4.0f64 / 45.0 / n).sqrt());
    }
}
