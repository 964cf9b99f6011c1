//! The directions of the rule for smooth lobes, and the light that it finds.

use crate::accurate::narrow::{mirror, narrowness};
use crate::accurate::placement::{GGX, LocalLight, SG, Tail, Vec2Of, dot2};
use crate::accurate::point::{NdfTerms, PointTerms};
use crate::accurate::specular::{Factors, PointTermsView, factors, fresnel};
use crate::real::{Real, Vec3Of, add, dot, polynomial, scale};
use crate::{sg::Dual, two::Two};

/// Least ratio of curvatures for an SG.
const LEAST_SG: f64 = 4.0;
/// Least ratio of curvatures for GGX.
const LEAST_GGX: f64 = 6.0;
/// L of an SG from which on no lobe is taken for smooth (R = 0.53).
const GLOSSY: f64 = 25.0;
/// Curvature of the Fresnel, shadowing and cosine terms together.
const REST: f64 = 4.0;
/// Least (n·ξ)²λ of a lobe above the horizon.
const HEIGHT: f64 = 2.9;
/// Least k²λ of other lobes.
const SOFTNESS: f64 = 1.5;

/// How far a lobe is within what this rule needs, given r·ξ; above 0 the lobe is smooth.
#[inline(always)]
pub fn smoothness<F: Real, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
    mirrored: F,
) -> F {
    let cosine = dot(point.frame[2], axis);
    // 1 − r·ξ, and 1 + v·ξ with v = 2(n·v)n − r.
    let fading = (-mirrored).plus(1.0).relu();
    let facing = (cosine * point.view[1].times(2.0) - mirrored).plus(1.0);
    let light = sharpness * facing.times(2.0);
    let l = point.ndf[NDF - 1].sharpness;
    let curved = if NDF == 1 {
        let steep = (l * fading).times(0.25).plus(1.0);
        (light - steep.mul_plus(l, REST).times(LEAST_SG)).min(broadness(point))
    } else {
        let spread = (l * fading).times(0.125).plus(1.0);
        light.mul_add(spread, -l.plus(REST).times(LEAST_GGX))
    };
    let high = (cosine.relu() * cosine).mul_plus(sharpness, -HEIGHT);
    let soft = (point.shadowing * point.shadowing).mul_plus(sharpness, -SOFTNESS);
    high.max(soft).min(curved)
}

/// [`smoothness`] of a pair; of several SGs, only of a lobe for the rule that reads GGX.
#[inline(always)]
pub fn pair_smoothness<F: Real, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
) -> F {
    let margin = smoothness(point, axis, sharpness, dot(mirror(point), axis));
    if NDF == 1 { margin } else { margin.min(narrowness(point, axis, sharpness).0.plus(-1.0)) }
}

/// Above 0 where a point may have smooth lobes. Of a glossy SG they would be few, which is not
/// worth a pass of their own.
#[inline(always)]
pub fn broadness<F: Real, const NDF: usize>(point: &PointTerms<F, NDF>) -> F {
    let l = point.ndf[NDF - 1].sharpness;
    if NDF == 1 { (-l).plus(GLOSSY) } else { l.one() }
}

/// The directions around a lobe.
#[derive(Clone, Copy)]
pub struct Ring<F> {
    /// ξ.
    pub axis: Vec3Of<F>,
    /// Unit vectors across the axis, toward the normal and level.
    pub toward: Vec3Of<F>,
    pub level: Vec2Of<F>,
    /// 1/√λ.
    pub width: F,
    /// 1 over the sine of the angle between axis and normal.
    pub over_sine: F,
    /// Position of the axis above the horizon in units of the width.
    pub height: F,
    /// Positions along `toward` in units of the width.
    pub offsets: [F; 2],
    /// Weight of the first position; the second has the rest.
    pub weight: F,
}

impl<F: Real> Ring<F> {
    /// For a light whose 1/√λ is known.
    #[inline(always)]
    pub fn new(light: &LocalLight<F>, width: F) -> Self {
        let axis @ [x, y, z] = light.axis;
        let one = z.one();
        let square = dot2([x, y], [x, y]).max(z.lit(1e-12));
        let over_sine = square.quick_rsqrt();
        let sine = square * over_sine;
        // For an axis along the normal any direction is level.
        let (px, py) = (square.select_lt(z.lit(1.1e-12), one, x * over_sine), y * over_sine);
        let height = (z * light.sharpness * width * over_sine).min(z.lit(HIGHEST)).max(z.lit(LOWEST));
        let (offsets, weight) = two_nodes(height);
        Self {
            axis,
            toward: [-(px * z), -(py * z), sine],
            level: [-py, px],
            width,
            over_sine,
            height,
            offsets,
            weight,
        }
    }

    /// Variance of the clipped Gaussian, in units of the width's square.
    #[inline(always)]
    pub fn variance(&self) -> F {
        let apart = self.offsets[1] - self.offsets[0];
        self.weight * self.weight(1) * apart * apart
    }

    #[inline(always)]
    pub fn weight(&self, index: usize) -> F {
        if index == 0 { self.weight } else { self.weight.one() - self.weight }
    }

    /// The two directions at offset `index`: half of their sum, half of their difference along
    /// tangent and bitangent, and |X|²/2.
    #[inline(always)]
    pub fn pair(&self, index: usize) -> (Vec3Of<F>, Vec2Of<F>, F) {
        let u = self.offsets[index];
        let bend = (u.mul_add(u, u.one()) * self.width * self.width).times(0.5);
        // √(1 − |X|²/4).
        let root = bend.mul_add(bend.times(-1.0 / 32.0).plus(-0.25), u.one());
        let (step, level) = (root * u * self.width, root * self.width);
        let center = add(scale(self.axis, (-bend).plus(1.0)), scale(self.toward, step));
        (center, [level * self.level[0], level * self.level[1]], bend)
    }
}

/// Where the horizon is so far below that nothing is clipped.
const HIGHEST: f64 = 100.0;
/// Where it is so far above that next to nothing is left.
const LOWEST: f64 = -3.2;

const FIRST: [f64; 6] = [-0.22558696, -0.38990615, -0.2507373, -0.48047788, -0.052472423, 0.39004127];
const SECOND: [f64; 6] = [1.1455448, 0.053427626, -0.18360849, -0.13100331, -0.21379183, 0.32586162];
const WEIGHT: [f64; 6] = [0.65104744, -0.085341476, -0.032522302, -0.12418148, 0.0076033717, 0.08087648];

/// Gauss's rule of two nodes for the weight v·e^(−(v − t)²/2) on v > 0, whose maximum is at v − t =
/// a, 1/a − a = t: v − t of both nodes, and the part of the mass at the first. For t between
/// [`LOWEST`] and [`HIGHEST`], beyond which a cancels.
///
/// First node − a, second node − a and the first's weight are polynomials in τ = t/√(t² + 4),
/// fitted from [`LOWEST`] on: errors 9e-3, 4e-3 and 3e-3.
#[inline(always)]
pub fn two_nodes<F: Real>(t: F) -> ([F; 2], F) {
    let square = t.mul_add(t, t.lit(4.0));
    let over_root = square.quick_rsqrt();
    let tau = t * over_root;
    let a = square.mul_add(over_root, -t).times(0.5);
    ([a + polynomial(tau, &FIRST), a + polynomial(tau, &SECOND)], polynomial(tau, &WEIGHT))
}

/// The BRDF in one direction, times the direction's weight, without the factors of the point and
/// without F.
pub struct Reading<F> {
    pub factors: Factors<F>,
    /// h along tangent, bitangent and normal.
    pub half: Vec3Of<F>,
    /// 1/|v + ω|.
    pub over_sum: F,
    /// v·ω.
    pub view_cosine: F,
    pub view_half: F,
    pub value: F,
    /// 2^(−(5.55473 v·h + 6.8316) v·h).
    pub fresnel: F,
}

#[inline(always)]
pub fn read<F: Real, const TAIL: Tail>(
    point: &PointTermsView<F>,
    ndf: &NdfTerms<F>,
    direction: Vec3Of<F>,
    blocked: F,
    weight: F,
) -> Reading<F> {
    let [along, aside, cosine] = direction;
    let [view, rise] = point.view;
    // |v + ω|²/2 = 1 + v·ω = 2(v·h)².
    let view_cosine = view.mul_add(along, rise * cosine);
    let half_square = view_cosine.plus(1.0).max(cosine.lit(1e-6));
    let over_sum = half_square.times(2.0).quick_rsqrt();
    let half = [(view + along) * over_sum, aside * over_sum, (rise + cosine) * over_sum];
    let view_half = half_square * over_sum;
    let sine2 = dot2([half[0], half[1]], [half[0], half[1]]);
    let drop = sine2 * half[2].plus(1.0).inverse();
    let factors = factors::<F, TAIL>(ndf, [sine2, drop, half[2]], blocked);
    let mut value = factors.distribution * weight;
    if TAIL == SG {
        value = value * (-(ndf.sharpness * drop)).decay();
    }
    Reading { factors, half, over_sum, view_cosine, view_half, value, fresnel: fresnel(view_half) }
}

/// The specular light of a smooth lobe, `[constant, slope]`, given its irradiance.
#[inline(always)]
pub fn smooth_light<F: Real, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    light: &LocalLight<F>,
    ring: &Ring<F>,
    irradiance: &Dual<F>,
) -> [F; 2] {
    if NDF == 1 {
        smooth_light_of::<F, NDF, SG>(point, light, ring, irradiance)
    } else {
        smooth_light_of::<F, NDF, GGX>(point, light, ring, irradiance)
    }
}

#[inline(always)]
fn smooth_light_of<F: Real, const NDF: usize, const TAIL: Tail>(
    point: &PointTerms<F, NDF>,
    light: &LocalLight<F>,
    ring: &Ring<F>,
    irradiance: &Dual<F>,
) -> [F; 2] {
    let (view, ndf) = (PointTermsView::new(point), &point.ndf[NDF - 1]);
    let (mut powered, mut plain) = (light.sharpness.zero(), light.sharpness.zero());
    for i in 0..2 {
        let (center, side, _) = ring.pair(i);
        let blocked = center[2].relu().mul_add(view.one_minus_k, view.k);
        for direction in both(center, side) {
            let reading = read::<F, TAIL>(&view, ndf, direction, blocked, ring.weight(i));
            plain += reading.value;
            powered = reading.value.mul_add(reading.fresnel, powered);
        }
    }
    let scale = (ndf.scale * irradiance.value).times(SHARE);
    let (constant, total) = (powered * scale, plain * scale);
    [constant, total - constant]
}

/// Half the weight of two directions, over the BRDF's 4.
pub const SHARE: f64 = 1.0 / 8.0;

/// The two directions of a pair.
#[inline(always)]
pub fn both<F: Real>([x, y, z]: Vec3Of<F>, [a, b]: Vec2Of<F>) -> [Vec3Of<F>; 2] {
    [[x + a, y + b, z], [x - a, y - b, z]]
}

impl<F: Copy> Ring<Two<F>> {
    /// The first and the second.
    #[inline(always)]
    pub fn split(self) -> [Ring<F>; 2] {
        [self.each(|two| two.0), self.each(|two| two.1)]
    }

    #[inline(always)]
    fn each(&self, one: impl Fn(Two<F>) -> F) -> Ring<F> {
        let three = |[x, y, z]: Vec3Of<Two<F>>| [one(x), one(y), one(z)];
        let two = |[x, y]: Vec2Of<Two<F>>| [one(x), one(y)];
        Ring {
            axis: three(self.axis),
            toward: three(self.toward),
            level: two(self.level),
            width: one(self.width),
            over_sine: one(self.over_sine),
            height: one(self.height),
            offsets: two(self.offsets),
            weight: one(self.weight),
        }
    }
}
