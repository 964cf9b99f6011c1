//! Rays of one origin and of similar directions, traced together: the boxes of a node are tested against all of them at once, and only a box that they
//! then enter against each.
//!
//! Source: Boulos, Wald and Shirley, "Geometric and Arithmetic Culling Methods for Entire Ray Packets" (2006): interval arithmetic on the inverse
//! directions, which have the same signs.
//!
//! | name | unit | value | meaning |
//! | --- | --- | --- | --- |
//! | [`PACKET`] | | 16 | most rays of a packet |

use crate::mesh::ray_triangle::{Nearest, RayFrame, TriangleHit};
use crate::mesh::wide_bvh::{BoxCorners, BoxRays, Each, Leaf, LeafVisitor, ROUNDING, inverse};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16};
use glam::Vec3;

/// Most rays of a packet.
pub(super) const PACKET: usize = 16;

/// The directions, as bits, by the signs of their components; and those that are traced alone: those that are not finite, and all unless `together`.
pub(super) fn sides_of(directions: &[Vec3], together: bool) -> ([u32; 8], u32) {
    assert!(directions.len() <= PACKET, "a packet has at most {PACKET} rays");
    let (mut sides, mut alone) = ([0; 8], 0);
    for (i, direction) in directions.iter().enumerate() {
        if together && direction.is_finite() && *direction != Vec3::ZERO {
            sides[direction.signum().cmplt(Vec3::ZERO).bitmask() as usize] |= 1 << i;
        } else {
            alone |= 1 << i;
        }
    }
    (sides, alone)
}

/// Rays whose directions have the same signs.
pub(super) struct Packet {
    origin: [f32; 3],
    /// Inverse components of the directions, by axis; missing rays repeat the first.
    inverse: [[f32; PACKET]; 3],
    /// Distances to what the rays meet; missing rays have none.
    limits: [f32; PACKET],
    rays: [Nearest; PACKET],
    /// The number of each ray.
    numbers: [usize; PACKET],
    count: usize,
    /// A bit for each ray that enters the last box.
    entering: u64,
}

impl Packet {
    /// The rays in these of the `directions`, of which at least one is set.
    pub fn new(origin: Vec3, directions: &[Vec3], bits: u32, min_distance: f32) -> Self {
        let (mut numbers, mut count) = ([bits.trailing_zeros() as usize; PACKET], 0);
        for i in (0..directions.len()).filter(|i| bits >> i & 1 == 1) {
            numbers[count] = i;
            count += 1;
        }
        let ray =
            |direction| Nearest { frame: RayFrame::new(origin, direction), low: min_distance, found: None };
        Self {
            origin: origin.to_array(),
            inverse: std::array::from_fn(|axis| numbers.map(|i| inverse(directions[i][axis]))),
            limits: std::array::from_fn(|i| if i < count { f32::INFINITY } else { f32::NEG_INFINITY }),
            rays: numbers.map(|i| ray(directions[i])),
            numbers,
            count,
            entering: 0,
        }
    }

    /// All of the rays, as boxes are tested against them.
    pub fn boxes(&self) -> BoxPacket {
        let of =
            |fold: fn(f32, f32) -> f32| self.inverse.map(|each| each.into_iter().reduce(fold).unwrap_or(0.0));
        BoxPacket { origin: self.origin, least: of(f32::min), most: of(f32::max) }
    }

    /// Writes what the rays have met to the places of their directions.
    pub fn put(self, found: &mut [Option<TriangleHit>; PACKET]) {
        for (ray, number) in self.rays.into_iter().zip(self.numbers).take(self.count) {
            found[number] =
                ray.found.map(|hit| TriangleHit { distance: hit.distance.max(ray.low.next_up()), ..hit });
        }
    }

    /// A bit for each ray that enters a box before it meets what it has met.
    #[inline(always)]
    fn entering<S: Simd>(&self, simd: S, around: &BoxCorners) -> u64 {
        let (near_x, far_x) = self.planes(simd, around, 0);
        let (near_y, far_y) = self.planes(simd, around, 1);
        let (near_z, far_z) = self.planes(simd, around, 2);
        let entry = near_x.max(near_y).max(near_z.max(f32x16::splat(simd, 0.0)));
        let exit = far_x.min(far_y).min(far_z) * f32x16::splat(simd, ROUNDING);
        entry.simd_le(exit.min(f32x16::from_slice(simd, &self.limits))).to_bitmask()
    }

    /// Distances at which each ray meets the nearer and the farther plane of a box along an axis.
    #[inline(always)]
    fn planes<S: Simd>(&self, simd: S, around: &BoxCorners, axis: usize) -> (f32x16<S>, f32x16<S>) {
        let inverse = f32x16::from_slice(simd, &self.inverse[axis]);
        let near = usize::from(self.inverse[axis][0] < 0.0);
        let low = f32x16::splat(simd, around[near][axis] - self.origin[axis]);
        let high = f32x16::splat(simd, around[1 - near][axis] - self.origin[axis]);
        (low * inverse, high * inverse)
    }
}

impl LeafVisitor for Packet {
    #[inline(always)]
    fn enters<S: Simd>(&mut self, simd: S, around: &BoxCorners) -> bool {
        self.entering = self.entering(simd, around);
        self.entering != 0
    }

    #[inline(always)]
    fn visit<S: Simd>(&mut self, simd: S, leaf: &Leaf, _limit: f32) -> f32 {
        let mut entering = self.entering;
        while entering != 0 {
            let i = entering.trailing_zeros() as usize % PACKET;
            entering &= entering - 1;
            self.limits[i] = self.rays[i].visit(simd, leaf, self.limits[i]);
        }
        f32x16::from_slice(simd, &self.limits).reduce_max()
    }
}

/// The directions of a packet as ranges of their inverse components.
pub(super) struct BoxPacket {
    origin: [f32; 3],
    least: [f32; 3],
    most: [f32; 3],
}

impl BoxRays for BoxPacket {
    #[inline(always)]
    fn planes<S: Simd>(&self, simd: S, bounds: &[[Each; 3]; 2], axis: usize) -> (f32x8<S>, f32x8<S>) {
        let origin = f32x8::splat(simd, self.origin[axis]);
        let least = f32x8::splat(simd, self.least[axis]);
        let most = f32x8::splat(simd, self.most[axis]);
        let near = usize::from(self.least[axis] < 0.0);
        let low = f32x8::from_slice(simd, &bounds[near][axis]) - origin;
        let high = f32x8::from_slice(simd, &bounds[1 - near][axis]) - origin;
        ((low * least).min(low * most), (high * least).max(high * most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::fibonacci::fibonacci_axes;
    use crate::math::ray::Ray;
    use crate::mesh::bvh::TriangleBvh;
    use crate::mesh::primitive::ball_over_plate;

    #[test]
    fn rays_of_a_packet_meet_what_each_meets_alone() {
        let bvh = TriangleBvh::new(&ball_over_plate(0.02, 1.01, 0.3));
        let mut hits = 0;
        // From between the ball and the plate, from within the ball, from outside and from far away; near directions and all kinds of them.
        for origin in [Vec3::new(0.1, 0.4, 0.2), Vec3::Y, Vec3::new(3.0, 2.0, 1.0), Vec3::splat(500.0)] {
            let toward = (Vec3::Y * 0.5 - origin).normalize();
            let all = fibonacci_axes(400);
            let near = all.iter().map(|d| (toward + 0.2 * *d).normalize());
            let directions: Vec<Vec3> = near.chain(all.iter().copied()).collect();
            for directions in directions.chunks(PACKET).chain(directions.chunks(PACKET - 5)) {
                let found = bvh.nearest_of_packet(origin, directions, 1e-4);
                for (direction, found) in directions.iter().zip(found) {
                    let ray = Ray { origin, direction: *direction };
                    assert_eq!(found, bvh.nearest(&ray, 1e-4), "{ray:?}");
                    hits += usize::from(found.is_some());
                }
            }
        }
        assert!(hits > 1600, "{hits}");
    }

    #[test]
    fn directions_along_axes_and_such_as_are_none_are_traced_too() {
        let bvh = TriangleBvh::new(&ball_over_plate(0.02, 1.01, 0.3));
        let directions = [Vec3::Y, Vec3::NEG_Y, Vec3::new(-0.0, -1.0, -0.0), Vec3::ZERO, Vec3::NAN];
        let origin = Vec3::new(0.01, 0.5, 0.02);
        let found = bvh.nearest_of_packet(origin, &directions, 0.0);
        assert_eq!(found.map(|hit| hit.is_some())[..5], [true, true, true, false, false]);
        for (direction, found) in directions.into_iter().zip(found) {
            assert_eq!(found, bvh.nearest(&Ray { origin, direction }, 0.0));
        }
        assert_eq!(found[5..], [None; PACKET - 5]);
    }
}
