//! The adjoint of the specular light of a smooth lobe. Directions move with the lobe: a clipped
//! Gaussian's mean follows its center by its variance.

use super::ring::{Reading, Ring, SHARE, both, read};
use crate::accurate::placement::{LocalLight, Tail, Vec2Of};
use crate::accurate::point::{PairAdjoint, PointSums, PointTerms};
use crate::real::{Real, Vec3Of, dot};
use crate::{accurate::specular::PointTermsView, sg::Dual};

/// Sums over directions for the adjoint; each is weighted by its share of the objective.
struct Sums<F> {
    powered: F,
    plain: F,
    value: F,
    /// Direction × gradient of the logarithm of the BRDF there; along the normal, over v's part
    /// along the tangent.
    torque: Vec3Of<F>,
    /// Gradient · offset of the direction from the axis.
    outward: F,
    normal: Vec2Of<F>,
    shadowing: F,
    drop: F,
}

impl<F: Real> Sums<F> {
    #[inline(always)]
    fn new(like: F) -> Self {
        let zero = like.zero();
        Self {
            powered: zero,
            plain: zero,
            value: zero,
            torque: [zero; 3],
            outward: zero,
            normal: [zero; 2],
            shadowing: zero,
            drop: zero,
        }
    }

    /// Adds a direction: how far its pair is from the axis along the normal, and the reduction of
    /// v·ω for that distance along the view.
    #[inline(always)]
    fn add(
        &mut self,
        point: &PointTermsView<F>,
        reading: &Reading<F>,
        [along, aside, cosine]: Vec3Of<F>,
        [rise, reduced]: [F; 2],
        [powered, plain]: [F; 2],
    ) {
        let Reading { factors, half, over_sum, view_cosine, view_half, value: light, fresnel } = reading;
        let bright = *light * *fresnel;
        self.plain += *light;
        self.powered = light.mul_add(*fresnel, self.powered);
        let share = bright * powered;
        let value = light.mul_add(plain, share);
        self.value += value;
        let falls = factors.shadowing * point.one_minus_k;
        let pull = factors.toward * *over_sum;
        let up = value * (pull - falls);
        // d(ln of the Fresnel power)/d(v·h) = −ln 2·(2·5.55473 v·h + 6.8316), and d(v·h) =
        // v·dω/(2|v + ω|).
        let glancing = view_half.mul_plus(view_half.lit(11.10946 * FRESNEL), 6.8316 * FRESNEL);
        let view = *over_sum * (value * pull).mul_add(half[2], share * glancing);
        // The gradient is up·n − view·v.
        let across = (-view).mul_add(point.view[1], up);
        self.torque[0] = across.mul_add(aside, self.torque[0]);
        self.torque[1] = self.torque[1] - across.mul_add(along, view * point.view[0] * cosine);
        self.torque[2] = view.mul_add(aside, self.torque[2]);
        self.outward += up.mul_add(rise, -(view * (*view_cosine - reduced)));
        let (turn, tilt) = (value * falls, value * factors.toward);
        self.normal[0] += tilt.mul_add(half[0], -(turn * along));
        self.normal[1] += tilt.mul_add(half[1], -(turn * aside));
        self.shadowing = (value * factors.shadowing).mul_add(cosine.one() - cosine, self.shadowing);
        self.drop = value.mul_add(factors.half_drop, self.drop);
    }
}

/// ln 2/2.
const FRESNEL: f64 = 0.5 * std::f64::consts::LN_2;

/// [`super::pull_back_smooth`] for one distribution of normals.
#[inline(always)]
pub(super) fn pull_back_of<F: Real, const NDF: usize, const TAIL: Tail>(
    point: &PointTerms<F, NDF>,
    light: &LocalLight<F>,
    ring: &Ring<F>,
    irradiance: &Dual<F>,
    [constant_adjoint, slope_adjoint]: [F; 2],
) -> ([F; 2], PairAdjoint<F, NDF>) {
    let (view, ndf) = (PointTermsView::new(point), &point.ndf[NDF - 1]);
    let scale = (ndf.scale * irradiance.value).times(SHARE);
    let shares = [(constant_adjoint - slope_adjoint) * scale, slope_adjoint * scale];
    let mut sums = Sums::new(scale);
    let view_axis = view.view[0].mul_add(light.axis[0], view.view[1] * light.axis[2]);
    for i in 0..2 {
        let (center, side, bend) = ring.pair(i);
        let cosine = center[2].relu();
        let blocked = cosine.mul_add(view.one_minus_k, view.k);
        // The part of X along the axis shrinks with the square of the width.
        let twice = bend.plus(1.0);
        let away = [(-twice).mul_add(light.axis[2], cosine), twice * view_axis];
        for direction in both(center, side) {
            let reading = read::<F, TAIL>(&view, ndf, direction, blocked, ring.weight(i));
            sums.add(&view, &reading, [direction[0], direction[1], cosine], away, shares);
        }
    }
    let mut out = PointSums::zero(scale);
    out.ndf[NDF - 1] = [sums.value / ndf.sharpness - sums.drop, sums.value];
    let (constant, total) = (sums.powered * scale, sums.plain * scale);
    ([constant, total - constant], sums.finish(point, light, ring, irradiance, out))
}

impl<F: Real> Sums<F> {
    /// The adjoints of the pair, given those with respect to the distribution of normals.
    #[inline(always)]
    fn finish<const NDF: usize>(
        self,
        point: &PointTerms<F, NDF>,
        light: &LocalLight<F>,
        ring: &Ring<F>,
        irradiance: &Dual<F>,
        ndf: PointSums<F, NDF>,
    ) -> PairAdjoint<F, NDF> {
        let per_light = self.value * irradiance.value.max(self.value.lit(1e-20)).inverse();
        let (variance, tilt) = (ring.variance(), per_light * irradiance.by_cosine);
        // The gradient toward the normal, and level.
        let [x, y, z] = self.torque;
        let toward = -(x.mul_add(ring.level[0], y * ring.level[1]));
        let level = dot([x, y, z * point.view[0]], ring.toward);
        let follow = toward * variance;
        let axis = [
            follow.mul_add(ring.toward[0], level * ring.level[0]),
            follow.mul_add(ring.toward[1], level * ring.level[1]),
            follow.mul_add(ring.toward[2], tilt),
        ];
        let left = toward - follow;
        let spreading =
            (left * ring.height).mul_add(ring.width, self.outward) * (ring.width * ring.width).times(0.5);
        let turn = tilt - left * ring.over_sine;
        PairAdjoint {
            axis: point.in_world(axis),
            sharpness: per_light.mul_add(irradiance.by_sharpness, -spreading),
            point: PointSums {
                normal: [
                    turn.mul_add(light.axis[0], self.normal[0]),
                    turn.mul_add(light.axis[1], self.normal[1]),
                ],
                shadowing: -self.shadowing,
                ..ndf
            },
        }
    }
}
