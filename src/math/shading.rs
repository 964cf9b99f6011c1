//! SG shading of many points by many lobes: the slice kernels behind the Shade and Gradient stages.
//!
//! Lobes lie in columns, padded to a whole number of SIMD vectors; points are taken one by one, in chunks over
//! the threads. Sums over points are made per chunk and then over chunks in order, so the result does not depend
//! on the number of threads.

use super::lanes::{Lanes, MAX_LANES};
use super::published::{
    FrozenBrdf, Lobe, Pair, PointTerms, evaluate_pair, prepare_point, pull_back_normal, pull_back_pair,
};
use super::real::Vec3Of;
use fearless_simd::{Level, Simd, dispatch};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Points a thread takes at a time; also the grain of the fixed-order sums.
const CHUNK: usize = 256;

/// Number of columns of a lobe: axis x, y, z, sharpness, amplitude r, g, b.
pub const LOBE_COLUMNS: usize = 7;

/// Light lobes (or their gradient) in columns of equal, padded length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LobeColumns {
    data: Vec<f32>,
    len: usize,
    stride: usize,
}

impl LobeColumns {
    /// Columns for `len` lobes, all zero.
    pub fn zeros(len: usize) -> Self {
        let stride = len.div_ceil(MAX_LANES) * MAX_LANES;
        Self { data: vec![0.0; stride * LOBE_COLUMNS], len, stride }
    }

    /// Columns of these lobes; padding has no amplitude.
    pub fn from_lobes(lobes: impl ExactSizeIterator<Item = Lobe<f32>>) -> Self {
        let mut columns = Self::zeros(lobes.len());
        for (i, lobe) in lobes.enumerate() {
            columns.set(i, &lobe);
        }
        for i in columns.len..columns.stride {
            columns.set(i, &Lobe { axis: [0.0, 1.0, 0.0], sharpness: 1.0, amplitude: [0.0; 3] });
        }
        columns
    }

    /// Number of lobes.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The values of lobe `i`.
    pub fn get(&self, i: usize) -> Lobe<f32> {
        let at = |c: usize| self.data[c * self.stride + i];
        Lobe { axis: [at(0), at(1), at(2)], sharpness: at(3), amplitude: [at(4), at(5), at(6)] }
    }

    fn set(&mut self, i: usize, lobe: &Lobe<f32>) {
        let [x, y, z] = lobe.axis;
        let [r, g, b] = lobe.amplitude;
        for (c, value) in [x, y, z, lobe.sharpness, r, g, b].into_iter().enumerate() {
            self.data[c * self.stride + i] = value;
        }
    }
}

/// A surface point as the kernels read it; a zero normal marks a ray that met nothing, which shades to zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShadePoint {
    /// Unit normal.
    pub normal: Vec3Of<f32>,
    /// Unit direction from the point to the viewer.
    pub to_viewer: Vec3Of<f32>,
    /// Diffuse albedo.
    pub albedo: Vec3Of<f32>,
}

impl ShadePoint {
    /// Whether this stands for a ray that met nothing.
    pub fn is_missed(&self) -> bool {
        self.normal == [0.0; 3]
    }
}

/// The specular material as the kernels read it, and the shape of its gradient.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpecularValue {
    /// Specular albedo.
    pub albedo: Vec3Of<f32>,
    /// Roughness R.
    pub roughness: f32,
}

/// Outgoing radiance in its two layers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Layers {
    /// Diffusely reflected radiance.
    pub diffuse: Vec3Of<f32>,
    /// Specularly reflected radiance.
    pub specular: Vec3Of<f32>,
}

/// Adjoint of a point's outgoing radiance, the sum of its layers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RadianceAdjoint(pub Vec3Of<f32>);

/// Adjoints of one point's inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PointAdjoint {
    /// With respect to the diffuse albedo.
    pub albedo: Vec3Of<f32>,
    /// With respect to the normal (along its tangent plane).
    pub normal: Vec3Of<f32>,
}

/// Gradient with respect to everything that the points share.
#[derive(Clone, Debug, Default)]
pub struct SharedGradient {
    /// With respect to the light lobes.
    pub lobes: LobeColumns,
    /// With respect to the specular material.
    pub specular: SpecularValue,
}

/// Shades `points` with the published formulas; `out` has their length.
pub fn shade(points: &[ShadePoint], specular: &SpecularValue, lobes: &LobeColumns, out: &mut [Layers]) {
    assert_eq!(points.len(), out.len(), "one output a point");
    points.par_chunks(CHUNK).zip(out.par_chunks_mut(CHUNK)).for_each(|(points, out)| {
        dispatch!(Level::new(), simd => shade_chunk(simd, points, specular, lobes, out));
    });
}

/// Pulls the adjoint of each point's radiance back to the points and to what they share.
///
/// `shaded` is what [`shade`] gave: where a channel was clamped to zero its adjoint is dropped.
pub fn shade_adjoint(
    points: &[ShadePoint],
    specular: &SpecularValue,
    lobes: &LobeColumns,
    shaded: &[Layers],
    adjoint: &[RadianceAdjoint],
    point_adjoint: &mut [PointAdjoint],
) -> SharedGradient {
    assert!(points.len() == shaded.len() && points.len() == adjoint.len(), "one value a point");
    assert_eq!(points.len(), point_adjoint.len(), "one output a point");
    let partial: Vec<SharedGradient> = points
        .par_chunks(CHUNK)
        .zip(shaded.par_chunks(CHUNK).zip(adjoint.par_chunks(CHUNK)))
        .zip(point_adjoint.par_chunks_mut(CHUNK))
        .map(|((points, (shaded, adjoint)), out)| {
            dispatch!(Level::new(), simd => adjoint_chunk(simd, points, specular, lobes, (shaded, adjoint), out))
        })
        .collect();
    sum_in_order(&partial, lobes.len)
}

fn sum_in_order(partial: &[SharedGradient], len: usize) -> SharedGradient {
    let mut total = SharedGradient { lobes: LobeColumns::zeros(len), ..Default::default() };
    for p in partial {
        for (sum, value) in total.lobes.data.iter_mut().zip(&p.lobes.data) {
            *sum += value;
        }
        for c in 0..3 {
            total.specular.albedo[c] += p.specular.albedo[c];
        }
        total.specular.roughness += p.specular.roughness;
    }
    total
}

/// One vector of lobes.
#[inline(always)]
fn load_lobes<S: Simd>(simd: S, lobes: &LobeColumns, at: usize) -> Lobe<Lanes<S>> {
    let column = |c: usize| {
        let start = c * lobes.stride + at;
        Lanes::load(simd, &lobes.data[start..start + Lanes::<S>::LEN])
    };
    Lobe {
        axis: [column(0), column(1), column(2)],
        sharpness: column(3),
        amplitude: [column(4), column(5), column(6)],
    }
}

/// A point's terms, with the same value in every lane.
#[inline(always)]
fn splat_terms<S: Simd>(simd: S, terms: &PointTerms<f32>) -> PointTerms<Lanes<S>> {
    let three = |v: Vec3Of<f32>| v.map(|x| Lanes::splat(simd, x));
    PointTerms {
        normal: three(terms.normal),
        mirror: three(terms.mirror),
        mirror_cosine: Lanes::splat(simd, terms.mirror_cosine),
        warp_sharpness: Lanes::splat(simd, terms.warp_sharpness),
    }
}

#[inline(always)]
fn frozen(brdf: &FrozenBrdf<f32>, specular: &SpecularValue) -> Vec3Of<f32> {
    specular.albedo.map(|s| brdf.constant + brdf.slope * s)
}

#[inline(always)]
fn shade_chunk<S: Simd>(
    simd: S,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lobes: &LobeColumns,
    out: &mut [Layers],
) {
    for (point, out) in points.iter().zip(out) {
        *out = Layers::default();
        if point.is_missed() {
            continue;
        }
        let (terms, brdf) = prepare_point(point.normal, point.to_viewer, specular.roughness);
        let wide = splat_terms(simd, &terms);
        let mut diffuse = [Lanes::splat(simd, 0.0); 3];
        let mut glossy = diffuse;
        for at in (0..lobes.stride).step_by(Lanes::<S>::LEN) {
            let lobe = load_lobes(simd, lobes, at);
            let pair = evaluate_pair(&wide, lobe.axis, lobe.sharpness);
            for c in 0..3 {
                diffuse[c] += lobe.amplitude[c] * pair.diffuse.value;
                glossy[c] += lobe.amplitude[c] * pair.specular;
            }
        }
        let m = frozen(&brdf, specular);
        for c in 0..3 {
            out.diffuse[c] = (diffuse[c].sum() * point.albedo[c] / PI).max(0.0);
            out.specular[c] = (glossy[c].sum() * m[c]).max(0.0);
        }
    }
}

/// Sums over the lobes that a point's own adjoint needs.
struct PointSums<S: Simd> {
    diffuse: Vec3Of<Lanes<S>>,
    glossy: Vec3Of<Lanes<S>>,
    normal: Vec3Of<Lanes<S>>,
    mirror: Vec3Of<Lanes<S>>,
    mirror_cosine: Lanes<S>,
    warp_sharpness: Lanes<S>,
}

impl<S: Simd> PointSums<S> {
    #[inline(always)]
    fn zero(simd: S) -> Self {
        let zero = Lanes::splat(simd, 0.0);
        Self {
            diffuse: [zero; 3],
            glossy: [zero; 3],
            normal: [zero; 3],
            mirror: [zero; 3],
            mirror_cosine: zero,
            warp_sharpness: zero,
        }
    }
}

#[inline(always)]
fn adjoint_chunk<S: Simd>(
    simd: S,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lobes: &LobeColumns,
    (shaded, adjoint): (&[Layers], &[RadianceAdjoint]),
    out: &mut [PointAdjoint],
) -> SharedGradient {
    let mut gradient = SharedGradient { lobes: LobeColumns::zeros(lobes.len), ..Default::default() };
    for (i, point) in points.iter().enumerate() {
        out[i] = PointAdjoint::default();
        if point.is_missed() {
            continue;
        }
        let (terms, brdf) = prepare_point(point.normal, point.to_viewer, specular.roughness);
        // A channel that was clamped to zero does not move with its inputs.
        let live = |value: f32, adjoint: f32| if value > 0.0 { adjoint } else { 0.0 };
        let diffuse_adjoint: Vec3Of<f32> =
            std::array::from_fn(|c| live(shaded[i].diffuse[c], adjoint[i].0[c]));
        let specular_adjoint: Vec3Of<f32> =
            std::array::from_fn(|c| live(shaded[i].specular[c], adjoint[i].0[c]));
        let m = frozen(&brdf, specular);
        let diffuse_weight = std::array::from_fn(|c| diffuse_adjoint[c] * point.albedo[c] / PI);
        let specular_weight = std::array::from_fn(|c| specular_adjoint[c] * m[c]);
        let sums = pull_back_lobes(
            simd,
            &splat_terms(simd, &terms),
            lobes,
            (diffuse_weight, specular_weight),
            &mut gradient.lobes,
        );
        out[i] = pull_back_point(
            point,
            specular,
            &brdf,
            (diffuse_adjoint, specular_adjoint),
            &sums,
            &mut gradient.specular,
        );
    }
    gradient
}

/// Walks the lobes for one point: adds their gradient onto `gradient` and returns the point's own sums.
#[inline(always)]
fn pull_back_lobes<S: Simd>(
    simd: S,
    terms: &PointTerms<Lanes<S>>,
    lobes: &LobeColumns,
    (diffuse_weight, specular_weight): (Vec3Of<f32>, Vec3Of<f32>),
    gradient: &mut LobeColumns,
) -> PointSums<S> {
    let kd = diffuse_weight.map(|w| Lanes::splat(simd, w));
    let ks = specular_weight.map(|w| Lanes::splat(simd, w));
    let mut sums = PointSums::zero(simd);
    for at in (0..lobes.stride).step_by(Lanes::<S>::LEN) {
        let lobe = load_lobes(simd, lobes, at);
        let pair: Pair<Lanes<S>> = evaluate_pair(terms, lobe.axis, lobe.sharpness);
        let mu = lobe.amplitude;
        let diffuse_adjoint = kd[0] * mu[0] + kd[1] * mu[1] + kd[2] * mu[2];
        let specular_adjoint = ks[0] * mu[0] + ks[1] * mu[1] + ks[2] * mu[2];
        let back = pull_back_pair(&pair, terms, lobe.axis, lobe.sharpness, diffuse_adjoint, specular_adjoint);
        let mut store = |c: usize, value: Lanes<S>| {
            let start = c * gradient.stride + at;
            value.add_to(&mut gradient.data[start..start + Lanes::<S>::LEN]);
        };
        store(3, back.sharpness);
        for c in 0..3 {
            store(c, back.axis[c]);
            store(4 + c, kd[c] * pair.diffuse.value + ks[c] * pair.specular);
            sums.diffuse[c] += mu[c] * pair.diffuse.value;
            sums.glossy[c] += mu[c] * pair.specular;
            sums.normal[c] += back.normal[c];
            sums.mirror[c] += back.mirror[c];
        }
        sums.mirror_cosine += back.mirror_cosine;
        sums.warp_sharpness += back.warp_sharpness;
    }
    sums
}

/// From the sums over lobes to the adjoints of one point's inputs and of the specular material.
#[inline(always)]
fn pull_back_point<S: Simd>(
    point: &ShadePoint,
    specular: &SpecularValue,
    brdf: &FrozenBrdf<f32>,
    (diffuse_adjoint, specular_adjoint): (Vec3Of<f32>, Vec3Of<f32>),
    sums: &PointSums<S>,
    gradient: &mut SpecularValue,
) -> PointAdjoint {
    let mut out = PointAdjoint::default();
    let (mut constant, mut slope) = (0.0, 0.0);
    for c in 0..3 {
        out.albedo[c] = diffuse_adjoint[c] / PI * sums.diffuse[c].sum();
        let glossy = specular_adjoint[c] * sums.glossy[c].sum();
        constant += glossy;
        slope += glossy * specular.albedo[c];
        gradient.albedo[c] += glossy * brdf.slope;
    }
    let warp = sums.warp_sharpness.sum();
    let chain = |by: &[f32; 3]| constant * by[0] + slope * by[1] + warp * by[2];
    gradient.roughness += chain(&brdf.by_roughness);
    let cosine = chain(&brdf.by_cosine) + sums.mirror_cosine.sum();
    let through_view = pull_back_normal(point.normal, point.to_viewer, sums.mirror.map(Lanes::sum), cosine);
    out.normal = std::array::from_fn(|c| sums.normal[c].sum() + through_view[c]);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::published::tests::{Case, forward, gradient, random_case};
    use rand::{SeedableRng, rngs::SmallRng};

    fn narrow(v: [f64; 3]) -> [f32; 3] {
        v.map(|x| x as f32)
    }

    /// Cases that share one material: `lobes` lobes seen from `points` points.
    fn cases(points: usize, lobes: usize) -> Vec<Vec<Case>> {
        let mut rng = SmallRng::seed_from_u64(11);
        let light: Vec<Case> = (0..lobes).map(|_| random_case(&mut rng)).collect();
        (0..points)
            .map(|_| {
                let point = random_case(&mut rng);
                let with = |l: &Case| Case {
                    normal: point.normal,
                    to_viewer: point.to_viewer,
                    albedo: point.albedo,
                    specular: [0.3, 0.4, 0.5],
                    roughness: 0.35,
                    ..*l
                };
                light.iter().map(with).collect()
            })
            .collect()
    }

    fn inputs(cases: &[Vec<Case>]) -> (Vec<ShadePoint>, SpecularValue, LobeColumns) {
        let points = cases.iter().map(|c| ShadePoint {
            normal: narrow(c[0].normal),
            to_viewer: narrow(c[0].to_viewer),
            albedo: narrow(c[0].albedo),
        });
        let lobes = LobeColumns::from_lobes(cases[0].iter().map(|c| Lobe {
            axis: narrow(c.axis),
            sharpness: c.sharpness as f32,
            amplitude: narrow(c.amplitude),
        }));
        (points.collect(), SpecularValue { albedo: [0.3, 0.4, 0.5], roughness: 0.35 }, lobes)
    }

    fn close(name: &str, fast: f32, exact: f64, size: f64) {
        assert!(
            (f64::from(fast) - exact).abs() <= 1e-3 * exact.abs() + 2e-4 * size,
            "{name}: {fast} {exact}"
        );
    }

    #[test]
    fn slices_agree_with_the_sum_of_pairs_in_f64() {
        let cases = cases(300, 21);
        let (points, specular, lobes) = inputs(&cases);
        let mut shaded = vec![Layers::default(); points.len()];
        shade(&points, &specular, &lobes, &mut shaded);
        for (case, out) in cases.iter().zip(&shaded) {
            for c in 0..3 {
                let sum =
                    |layer: fn(&Case) -> [f64; 3]| case.iter().map(|k| layer(k)[c]).sum::<f64>().max(0.0);
                close("diffuse", out.diffuse[c], sum(|k| forward(k).0), 1.0);
                close("specular", out.specular[c], sum(|k| forward(k).1), 1.0);
            }
        }
    }

    #[test]
    fn slice_adjoint_agrees_with_the_sum_of_pairs_in_f64() {
        let cases = cases(300, 21);
        let (points, specular, lobes) = inputs(&cases);
        let (wd, ws) = ([0.7, -0.4, 0.5], [0.7, -0.4, 0.5]);
        let n = points.len();
        let mut shaded = vec![Layers::default(); n];
        shade(&points, &specular, &lobes, &mut shaded);
        let adjoint = vec![RadianceAdjoint(narrow(wd)); n];
        let mut back = vec![PointAdjoint::default(); n];
        let shared = shade_adjoint(&points, &specular, &lobes, &shaded, &adjoint, &mut back);
        let (mut roughness, mut sharpness) = (0.0, vec![0.0; lobes.len()]);
        for (case, out) in cases.iter().zip(&back) {
            let all: Vec<Case> = case.iter().map(|k| gradient(k, wd, ws)).collect();
            for c in 0..3 {
                close("normal", out.normal[c], all.iter().map(|g| g.normal[c]).sum(), 20.0);
                close("albedo", out.albedo[c], all.iter().map(|g| g.albedo[c]).sum(), 1.0);
            }
            roughness += all.iter().map(|g| g.roughness).sum::<f64>();
            for (sum, g) in sharpness.iter_mut().zip(&all) {
                *sum += g.sharpness;
            }
        }
        close("roughness", shared.specular.roughness, roughness, 100.0);
        for (i, exact) in sharpness.iter().enumerate() {
            close("sharpness", shared.lobes.get(i).sharpness, *exact, 1.0);
        }
    }

    #[test]
    fn extreme_inputs_stay_finite() {
        let axis_of = |k: usize| [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]][k % 3];
        for roughness in [0.03f32, 0.3, 1.0] {
            for sharpness in [0.0f32, 1e-3, 1.0, 1e6] {
                for view in [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [1.0, 1e-4, 0.0]] {
                    let point = ShadePoint { normal: [0.0, 1.0, 0.0], to_viewer: view, albedo: [0.5; 3] };
                    let lobes = LobeColumns::from_lobes((0..3).map(|k| Lobe {
                        axis: axis_of(k),
                        sharpness,
                        amplitude: [1.0; 3],
                    }));
                    let specular = SpecularValue { albedo: [0.3; 3], roughness };
                    let mut out = [Layers::default()];
                    shade(&[point], &specular, &lobes, &mut out);
                    let ones = [RadianceAdjoint([1.0; 3])];
                    let mut back = [PointAdjoint::default()];
                    let shared = shade_adjoint(&[point], &specular, &lobes, &out, &ones, &mut back);
                    let all = out[0].diffuse.iter().chain(&out[0].specular).chain(&back[0].normal);
                    assert!(all.chain(&shared.specular.albedo).all(|x| x.is_finite()), "{out:?} {back:?}");
                    assert!(shared.specular.roughness.is_finite());
                    assert!((0..3).all(|k| shared.lobes.get(k).sharpness.is_finite()));
                }
            }
        }
    }
}
