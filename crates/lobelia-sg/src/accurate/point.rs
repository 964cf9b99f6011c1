//! The terms of a surface point and its specular lobe that the integral of every light lobe reads,
//! and the last part of the adjoint of a point.

use crate::brdf::{Facets, Ndf, ndf_sharpness, shadowing_k};
use crate::real::{Real, Vec3Of, add, dot, scale, sub};
use std::f64::consts::PI;

/// One SG of the distribution of normals, as the pairs of a point read it.
#[derive(Clone, Copy)]
pub struct NdfTerms<F> {
    /// Sharpness L of the SG in h.
    pub sharpness: F,
    /// Position along the tangent, in the chart, of the peak of the NDF times (n·ω)(v·h).
    pub(super) start: F,
    /// The factors of the integrand that do not depend on ω; 0 for a viewer below the horizon.
    pub(super) scale: F,
}

/// The terms of a surface point and its specular lobe that the integral of every light lobe reads.
#[derive(Clone, Copy)]
pub struct PointTerms<F, const NDF: usize = 1> {
    /// Tangent (in the plane of normal and view), bitangent and normal; unit vectors.
    pub(super) frame: [Vec3Of<F>; 3],
    /// View direction along tangent and normal, the latter at least 0.
    pub(super) view: [F; 2],
    /// k of the shadowing term G ([`shadowing_k`]).
    pub(super) shadowing: F,
    pub(super) ndf: [NdfTerms<F>; NDF],
}

/// The derivatives that [`pull_back_point`] needs; they do not depend on the light.
#[derive(Clone, Copy)]
pub struct PointDerivatives<F, const NDF: usize = 1> {
    /// d(sharpness)/dR and d(ln weight)/dR of each SG of the NDF.
    pub(super) ndf: [[F; 2]; NDF],
    /// dk/dR.
    pub(super) shadowing: F,
}

impl<F: Real, const NDF: usize> PointTerms<F, NDF> {
    /// A world-space vector along tangent, bitangent and normal.
    #[inline(always)]
    pub(super) fn in_frame(&self, v: Vec3Of<F>) -> Vec3Of<F> {
        [dot(self.frame[0], v), dot(self.frame[1], v), dot(self.frame[2], v)]
    }

    #[inline(always)]
    pub(super) fn in_world(&self, v: Vec3Of<F>) -> Vec3Of<F> {
        let plane = add(scale(self.frame[0], v[0]), scale(self.frame[1], v[1]));
        add(plane, scale(self.frame[2], v[2]))
    }
}

/// The part of `v` across the normal.
#[inline(always)]
fn reject<F: Real>(normal: Vec3Of<F>, v: Vec3Of<F>) -> Vec3Of<F> {
    sub(v, scale(normal, dot(normal, v)))
}

/// Tangent, bitangent and normal with the view direction in the plane of the first and last.
#[inline(always)]
fn frame_towards<F: Real>(normal: Vec3Of<F>, to_viewer: Vec3Of<F>) -> [Vec3Of<F>; 3] {
    let one = normal[0].one();
    let zero = one.zero();
    let steep = (normal[0] * normal[0]).select_lt(one.times(0.5), one, zero);
    let other = reject(normal, [steep, one - steep, zero]);
    let along = reject(normal, to_viewer);
    let square = dot(along, along);
    // For a view along the normal any tangent is valid. The rejection is applied twice, because a
    // short one is not exactly perpendicular.
    let bound = one.times(1e-8);
    let tangent = [
        square.select_lt(bound, other[0], along[0]),
        square.select_lt(bound, other[1], along[1]),
        square.select_lt(bound, other[2], along[2]),
    ];
    let tangent = reject(normal, scale(tangent, dot(tangent, tangent).sqrt().recip()));
    let tangent = scale(tangent, dot(tangent, tangent).sqrt().recip());
    let bitangent = [
        normal[1] * tangent[2] - normal[2] * tangent[1],
        normal[2] * tangent[0] - normal[0] * tangent[2],
        normal[0] * tangent[1] - normal[1] * tangent[0],
    ];
    [tangent, bitangent, normal]
}

/// An NDF of one SG in h, or of several followed by the distribution that they approximate.
pub trait Mixture<const NDF: usize>: Copy + Send + Sync {
    /// The distribution that its shadowing term belongs to.
    const KIND: Ndf;

    /// [L, w] of every SG, D = Σ w·(L/2π)·e^{L(h·n − 1)}, and their [dL/dR, d(ln w)/dR].
    fn of<F: Real>(roughness: F) -> ([[F; 2]; NDF], [[F; 2]; NDF]);
}

/// The NDF of PhySG supp. eq. 4.
#[derive(Clone, Copy, Debug, Default)]
pub struct OneSg;

impl Mixture<1> for OneSg {
    const KIND: Ndf = Ndf::Sg;

    #[inline(always)]
    fn of<F: Real>(roughness: F) -> ([[F; 2]; 1], [[F; 2]; 1]) {
        let sharpness = ndf_sharpness(roughness);
        let slope = -(sharpness / roughness).times(4.0);
        let zero = roughness.zero();
        ([[sharpness, zero.one()]], [[slope, zero]])
    }
}

/// [`prepare_with_ndf`] for the NDF of PhySG supp. eq. 4 (one SG).
#[inline(always)]
pub fn prepare_point<F: Real>(
    normal: Vec3Of<F>,
    to_viewer: Vec3Of<F>,
    roughness: F,
) -> (PointTerms<F>, PointDerivatives<F>) {
    prepare_with_ndf::<F, OneSg, 1>(normal, to_viewer, roughness)
}

/// The terms that depend on the point and the specular material but not on the light.
///
/// `roughness` is the paper's R in [0.03, 1]; for n·v ≤ 0 the specular light is 0.
#[inline(always)]
pub fn prepare_with_ndf<F: Real, D: Mixture<NDF>, const NDF: usize>(
    normal: Vec3Of<F>,
    to_viewer: Vec3Of<F>,
    roughness: F,
) -> (PointTerms<F, NDF>, PointDerivatives<F, NDF>) {
    let (ndf, derivatives) = D::of(roughness);
    let [k, k_by_roughness] = shadowing_k(Facets { ndf: D::KIND, roughness });
    let frame = frame_towards(normal, to_viewer);
    let up = dot(normal, to_viewer);
    let view = [dot(frame[0], to_viewer).relu(), up.relu()];
    let zero = up.zero();
    let masked = zero.select_lt(up, (view[1] * (k.one() - k) + k).recip(), zero).times(0.5 / PI);
    let nothing = NdfTerms { sharpness: zero, start: zero, scale: zero };
    let mut terms = [nothing; NDF];
    for (terms, [sharpness, weight]) in terms.iter_mut().zip(ndf) {
        // The maximum of 2 ln(v·h) − L|X|²/2 along the tangent, to first order in X.
        let steep = sharpness * view[1];
        let root = (steep * steep + (sharpness * view[0] * view[0]).times(8.0)).sqrt();
        // For a viewer directly below, both vanish; any small number is valid.
        let start = (view[0].times(4.0) / (steep + root).max(k.lit(1e-6))).min(k.one());
        *terms = NdfTerms { sharpness, start, scale: masked * sharpness * weight };
    }
    (
        PointTerms { frame, view, shadowing: k, ndf: terms },
        PointDerivatives { ndf: derivatives, shadowing: k_by_roughness },
    )
}

/// Adjoints of the terms of a point, summed over lobes; the input of [`pull_back_point`].
#[derive(Clone, Copy)]
pub struct PointSums<F, const NDF: usize = 1> {
    /// With respect to the normal, along tangent and bitangent, at fixed n·v.
    pub normal: [F; 2],
    /// With respect to k of the shadowing term, through n·ω only.
    pub shadowing: F,
    /// With respect to the sharpness and the logarithm of the weight of each SG of the NDF.
    pub ndf: [[F; 2]; NDF],
}

impl<F: Real, const NDF: usize> PointSums<F, NDF> {
    /// All zero, in the lanes of `like`.
    #[inline(always)]
    pub fn zero(like: F) -> Self {
        let zero = like.zero();
        Self { normal: [zero; 2], shadowing: zero, ndf: [[zero; 2]; NDF] }
    }

    /// Adds the sums of another lobe.
    #[inline(always)]
    pub fn add(&mut self, other: &Self) {
        self.normal[0] += other.normal[0];
        self.normal[1] += other.normal[1];
        self.shadowing += other.shadowing;
        for m in 0..NDF {
            self.ndf[m][0] += other.ndf[m][0];
            self.ndf[m][1] += other.ndf[m][1];
        }
    }
}

/// Adjoints of one pair. All but the axis may be summed over lobes, in the frame of the point.
#[derive(Clone, Copy)]
pub struct PairAdjoint<F, const NDF: usize = 1> {
    /// With respect to the lobe's axis (world space).
    pub axis: Vec3Of<F>,
    /// With respect to the lobe's sharpness.
    pub sharpness: F,
    /// With respect to the point.
    pub point: PointSums<F, NDF>,
}

impl<F: Real, const NDF: usize> PairAdjoint<F, NDF> {
    /// Each number from those of two adjoints.
    #[inline(always)]
    pub(super) fn zip(&self, other: &Self, with: impl Fn(F, F) -> F) -> Self {
        let mut out = *self;
        for c in 0..3 {
            out.axis[c] = with(self.axis[c], other.axis[c]);
        }
        out.sharpness = with(self.sharpness, other.sharpness);
        out.point.shadowing = with(self.point.shadowing, other.point.shadowing);
        for c in 0..2 {
            out.point.normal[c] = with(self.point.normal[c], other.point.normal[c]);
            for m in 0..NDF {
                out.point.ndf[m][c] = with(self.point.ndf[m][c], other.point.ndf[m][c]);
            }
        }
        out
    }
}

/// Adjoints of a point's normal (along its tangent plane) and roughness, given the sums over lobes.
#[inline(always)]
pub fn pull_back_point<F: Real, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    derivatives: &PointDerivatives<F, NDF>,
    sums: &PointSums<F, NDF>,
) -> (Vec3Of<F>, F) {
    let k = point.shadowing;
    let mut value = k.zero();
    let mut roughness = k.zero();
    for m in 0..NDF {
        value += sums.ndf[m][1];
        roughness += sums.ndf[m][0] * derivatives.ndf[m][0] + sums.ndf[m][1] * derivatives.ndf[m][1];
    }
    // The factor 1/(n·v(1 − k) + k) of the viewer.
    let view = point.view[1];
    let inverse = value / (view * (k.one() - k) + k);
    roughness += (sums.shadowing - inverse * (k.one() - view)) * derivatives.shadowing;
    let along = sums.normal[0] - inverse * (k.one() - k) * point.view[0];
    (add(scale(point.frame[0], along), scale(point.frame[1], sums.normal[1])), roughness)
}
