//! The interface between a closed-form shading mode and the slice kernels of `shading`: one point ×
//! one lobe, and the terms prepared per point and per lobe.
//!
//! The kernels own the loops, the columns, the threads and the sums; a [`PairModel`] owns the
//! formulas. Radiance of channel c is Σ over lobes of μ_c·(albedo_c/π·diffuse + Σ_b
//! weight_bc·specular_b), where `diffuse` and the model's one or more specular terms `specular_b`
//! belong to the pair and the weights to the point.

use crate::brdf::{SpecularAdjoint, SpecularValue};
use crate::columns::ShadePoint;
use crate::real::{Real, Vec3Of};
use crate::sg::{Dual, Shape};

/// A fixed number of values, at least one: the terms of a point, a lobe or a pair. Implemented for
/// arrays, and for pairs of an array and an array of arrays.
pub trait Terms<F>: Copy {
    /// Number of values.
    const LEN: usize;
    /// Creates the terms from the value of each index.
    fn from_fn(value: impl FnMut(usize) -> F) -> Self;
    /// Value of one index.
    fn at(&self, index: usize) -> F;
    /// Mutable value of one index.
    fn at_mut(&mut self, index: usize) -> &mut F;
}

impl<F: Copy, const N: usize> Terms<F> for [F; N] {
    const LEN: usize = N;
    #[inline(always)]
    fn from_fn(mut value: impl FnMut(usize) -> F) -> Self {
        // A loop: closures inside the functions of arrays are not always inlined.
        let mut all = [value(0); N];
        for (i, each) in all.iter_mut().enumerate().skip(1) {
            *each = value(i);
        }
        all
    }
    #[inline(always)]
    fn at(&self, index: usize) -> F {
        self[index]
    }
    #[inline(always)]
    fn at_mut(&mut self, index: usize) -> &mut F {
        &mut self[index]
    }
}

impl<F: Copy, const N: usize, const EACH: usize, const PARTS: usize> Terms<F>
    for ([F; N], [[F; EACH]; PARTS])
{
    const LEN: usize = N + EACH * PARTS;
    #[inline(always)]
    fn from_fn(mut value: impl FnMut(usize) -> F) -> Self {
        let shared = <[F; N] as Terms<F>>::from_fn(&mut value);
        let mut parts = [[shared[0]; EACH]; PARTS];
        for (p, part) in parts.iter_mut().enumerate() {
            for (i, each) in part.iter_mut().enumerate() {
                *each = value(N + EACH * p + i);
            }
        }
        (shared, parts)
    }
    #[inline(always)]
    fn at(&self, index: usize) -> F {
        if index < N { self.0[index] } else { self.1[(index - N) / EACH][(index - N) % EACH] }
    }
    #[inline(always)]
    fn at_mut(&mut self, index: usize) -> &mut F {
        if index < N { &mut self.0[index] } else { &mut self.1[(index - N) / EACH][(index - N) % EACH] }
    }
}

/// The part of a pair to compute: [`DIFFUSE`], [`SPECULAR`] or [`BOTH`]. The other part of the
/// result is zero.
pub type Part = u8;
/// The diffuse part alone.
pub const DIFFUSE: Part = 1;
/// The specular part alone.
pub const SPECULAR: Part = 2;
/// The specular part by the model's rule for lobes that are narrow against the point's response
/// ([`PairModel::narrow`]).
pub const NARROW: Part = 4;
/// The specular part by the model's rule for lobes over which the point's response is smooth
/// ([`PairModel::smooth`]).
pub const SMOOTH: Part = 8;
/// The rules for the specular part of a lobe.
pub const RULES: [Part; 3] = [SPECULAR, NARROW, SMOOTH];
/// Both.
pub const BOTH: Part = DIFFUSE | SPECULAR;

/// Bounds of the specular light that a point receives from a lobe (axis ξ, sharpness λ): at most
/// about the light from an aligned lobe times e^(−aλ/(a + λ)·(1 − r·ξ)), and at most the lobe's
/// irradiance times the BRDF's largest value.
#[derive(Clone, Copy)]
pub struct Reach<F> {
    /// r, a unit direction.
    pub axis: Vec3Of<F>,
    /// a.
    pub sharpness: F,
    /// The BRDF's largest value, or more.
    pub brightest: F,
}

/// The light of one pair for unit amplitude.
#[derive(Clone, Copy)]
pub struct Response<F, T> {
    /// Irradiance: times albedo/π it is the diffuse radiance.
    pub diffuse: F,
    /// The specular terms; [`PairModel::specular_weights`] has their weights per channel.
    pub specular: T,
}

/// Adjoints of one pair.
#[derive(Clone, Copy)]
pub struct PairAdjoint<F, T> {
    /// With respect to the lobe's shape.
    pub shape: Shape<F>,
    /// The part of the adjoint of the point that is summed over lobes.
    pub point: T,
}

/// Result of [`PairModel::pull_back`].
pub type PulledBack<F, M> =
    (Response<F, <M as PairModel>::Specular<F>>, PairAdjoint<F, <M as PairModel>::Sums<F>>);

/// The inputs of the last part of the adjoint of a point.
pub struct PointEnd<'a, M: PairModel> {
    /// The point.
    pub point: &'a ShadePoint,
    /// The specular material.
    pub specular: &'a SpecularValue,
    /// From [`PairModel::prepare_point`].
    pub terms: &'a M::Point<f32>,
    /// From [`PairModel::prepare_point`].
    pub frozen: &'a M::Frozen<f32>,
    /// Sums over the lobes of [`PairAdjoint::point`].
    pub sums: &'a M::Sums<f32>,
    /// Per specular term and channel: adjoint of the channel's radiance × Σ over lobes of
    /// μ·specular.
    pub specular_light: &'a M::Specular<Vec3Of<f32>>,
}

/// Why a method of [`PairModel`] is not called.
const CULLS_NOTHING: &str = "a model that culls nothing has no nodes";

/// The formulas of a shading mode. All methods should be `#[inline(always)]`: they run inside SIMD
/// loops.
///
/// The methods with a default are called only if [`PairModel::CULLS`] (the rules for [`NARROW`] and
/// [`SMOOTH`], only if the model has them).
pub trait PairModel: Copy + Send + Sync {
    /// Whether the kernels may skip the specular part of pairs by [`PairModel::reach`]. The kernels
    /// then evaluate the two parts of such a model separately, and its specular part must not read
    /// the terms of the lobe.
    const CULLS: bool;
    /// Whether there is a rule for narrow lobes, [`NARROW`].
    const HAS_NARROW: bool = false;
    /// Whether there is a rule for lobes over which the response is smooth, [`SMOOTH`].
    const HAS_SMOOTH: bool = false;
    /// The terms of a point that a pair reads.
    type Point<F: Copy>: Terms<F>;
    /// The terms of a point that only its weights and the last part of its adjoint read.
    type Frozen<F: Copy>: Terms<F>;
    /// The terms of a lobe that a pair reads in addition to the shape: computed from the sharpness
    /// once per call, stored in columns.
    type Lobe<F: Copy>: Terms<F>;
    /// Where the nodes of a pair's specular part lie.
    type Placed<F: Copy>: Copy;
    /// The specular terms of a pair.
    type Specular<F: Copy>: Terms<F>;
    /// The sums over lobes that a point's adjoint needs.
    type Sums<F: Copy>: Terms<F>;

    /// Computes the terms that depend on the point and the roughness but not on the light.
    fn prepare_point<F: Real>(
        &self,
        normal: Vec3Of<F>,
        to_viewer: Vec3Of<F>,
        roughness: F,
    ) -> (Self::Point<F>, Self::Frozen<F>);

    /// Computes the terms that depend on the sharpness of a lobe only.
    fn prepare_lobe<F: Real>(&self, sharpness: F) -> Self::Lobe<F>;

    /// The weights of the specular terms in each channel.
    fn specular_weights(
        &self,
        frozen: &Self::Frozen<f32>,
        specular: &SpecularValue,
    ) -> Self::Specular<Vec3Of<f32>>;

    /// Bounds of the specular light of the point.
    fn reach<F: Real>(&self, _point: &Self::Point<F>) -> Reach<F> {
        unreachable!("{CULLS_NOTHING}")
    }

    /// How narrow a lobe is against the response of the point, and what the BRDF's largest value
    /// may be divided by for its axis. From 1 on the lobe is for [`NARROW`].
    fn narrow<F: Real>(&self, _point: &Self::Point<F>, _shape: &Shape<F>) -> (F, F) {
        unreachable!("{CULLS_NOTHING}")
    }

    /// Whether a point may have lobes for [`SMOOTH`] at all.
    fn may_have_smooth<F: Real>(&self, _point: &Self::Point<F>) -> bool {
        false
    }

    /// How smooth the response of the point is over a lobe, given its axis times that of
    /// [`PairModel::reach`]. Above 0 the lobe is for [`SMOOTH`], unless the model has [`NARROW`]
    /// and the lobe is not for that.
    fn smooth<F: Real>(&self, _point: &Self::Point<F>, _shape: &Shape<F>, _reached: F) -> F {
        unreachable!("{CULLS_NOTHING}")
    }

    /// The irradiance from a lobe: that of [`PairModel::evaluate`], with its derivatives.
    fn irradiance<F: Real>(&self, _: &Self::Point<F>, _shape: &Shape<F>, _lobe: &Self::Lobe<F>) -> Dual<F> {
        unreachable!("{CULLS_NOTHING}")
    }

    /// Places the nodes of the specular part `PART` of a pair, given 1/√λ of the lobe, and for
    /// [`SMOOTH`] the irradiance from it.
    fn place<F: Real, const PART: Part>(
        &self,
        _point: &Self::Point<F>,
        _shape: &Shape<F>,
        _width: F,
        _irradiance: Dual<F>,
    ) -> Self::Placed<F> {
        unreachable!("{CULLS_NOTHING}")
    }

    /// [`PairModel::place`] for two pairs of a point together, which takes less time than one after
    /// the other.
    fn place_two<F: Real, const PART: Part>(
        &self,
        _point: &Self::Point<F>,
        _shapes: [&Shape<F>; 2],
        _widths: [F; 2],
        _irradiances: [Dual<F>; 2],
    ) -> [Self::Placed<F>; 2] {
        unreachable!("{CULLS_NOTHING}")
    }

    /// The specular part `PART` of a pair, given its nodes.
    fn specular<F: Real, const PART: Part>(
        &self,
        _point: &Self::Point<F>,
        _shape: &Shape<F>,
        _placed: &Self::Placed<F>,
    ) -> Self::Specular<F> {
        unreachable!("{CULLS_NOTHING}")
    }

    /// [`PairModel::specular`] and its adjoints, given the adjoint of each term.
    fn pull_back_specular<F: Real, const PART: Part>(
        &self,
        _point: &Self::Point<F>,
        _shape: &Shape<F>,
        _placed: &Self::Placed<F>,
        _adjoint: &Self::Specular<F>,
    ) -> (Self::Specular<F>, PairAdjoint<F, Self::Sums<F>>) {
        unreachable!("{CULLS_NOTHING}")
    }

    /// Evaluates one point × lobe.
    fn evaluate<F: Real, const PART: Part>(
        &self,
        point: &Self::Point<F>,
        shape: &Shape<F>,
        lobe: &Self::Lobe<F>,
    ) -> Response<F, Self::Specular<F>>;

    /// Evaluates one point × lobe and, given the adjoint of its response, the adjoints of its
    /// inputs.
    fn pull_back<F: Real, const PART: Part>(
        &self,
        point: &Self::Point<F>,
        shape: &Shape<F>,
        lobe: &Self::Lobe<F>,
        adjoint: &Response<F, Self::Specular<F>>,
    ) -> PulledBack<F, Self>;

    /// Finishes the adjoint of a point: returns the adjoint of its normal, and adds the adjoint of
    /// the specular material to `gradient`.
    fn pull_back_point(&self, end: &PointEnd<'_, Self>, gradient: &mut SpecularAdjoint) -> Vec3Of<f32>;
}
