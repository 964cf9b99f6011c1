//! Sampling for paths: scattered directions, and their combination with those of the light.

pub mod sobol;

use lobelia_sg::brdf::{Facets, Ndf, fresnel_power, ndf_sharpness, normal_distribution, specular_affine};
use lobelia_sg::real::{Real, Vec3Of, add, dot, scale, sub};
use std::f32::consts::{FRAC_1_PI, TAU};

/// Whether a number is above zero; false for NaN.
#[inline(always)]
pub(crate) fn above_zero(value: f32) -> bool {
    value > 0.0
}

/// Three orthonormal axes; the third is the normal.
#[derive(Clone, Copy, Debug)]
struct TangentFrame {
    tangent: Vec3Of<f32>,
    bitangent: Vec3Of<f32>,
    normal: Vec3Of<f32>,
}

impl TangentFrame {
    /// Axes around a unit normal (Duff et al., "Building an Orthonormal Basis, Revisited", JCGT
    /// 6(1), 2017).
    #[inline]
    fn new(normal: Vec3Of<f32>) -> Self {
        let [x, y, z] = normal;
        let sign = if z < 0.0 { -1.0 } else { 1.0 };
        let a = -(sign + z).recip();
        let b = x * y * a;
        Self {
            tangent: [sign * x * x * a + 1.0, sign * b, -(sign * x)],
            bitangent: [b, sign + y * y * a, -y],
            normal,
        }
    }

    /// The world-space vector with these local coordinates.
    #[inline]
    fn world(&self, x: f32, y: f32, z: f32) -> Vec3Of<f32> {
        add(add(scale(self.tangent, x), scale(self.bitangent, y)), scale(self.normal, z))
    }
}

/// Least sharpness; below it, sampling is practically uniform over the sphere.
const LEAST_SHARPNESS: f32 = 1e-6;

/// Draws a direction distributed exactly as an SG around the frame's normal, over the whole sphere.
#[inline]
fn sample_sg(frame: &TangentFrame, sharpness: f32, u: [f32; 2]) -> Vec3Of<f32> {
    let sharpness = sharpness.max(LEAST_SHARPNESS);
    // 1 − cos θ rather than cos θ: sharp lobes keep their accuracy in f32.
    let fall = (-(u[0] * (sharpness * -2.0).exp_m1()).ln_1p() / sharpness).relu().min(2.0);
    let sine = (fall * (2.0 - fall)).sqrt();
    let (s, c) = (u[1] * TAU).sin_cos();
    frame.world(sine * c, sine * s, 1.0 - fall)
}

/// Draws a microfacet normal around the frame's normal in proportion to GGX's D·(n·h).
#[inline]
fn sample_ggx(frame: &TangentFrame, roughness: f32, u: [f32; 2]) -> Vec3Of<f32> {
    let square = roughness * roughness;
    let alpha2 = square * square;
    let scaled = alpha2 * u[0];
    let sine2 = scaled / (1.0 - u[0] + scaled);
    let cosine = (1.0 - sine2).relu().sqrt();
    let (s, c) = (u[1] * TAU).sin_cos();
    let sine = sine2.sqrt();
    frame.world(sine * c, sine * s, cosine)
}

/// Scattering at a point for light from one direction: BRDF times cosine, in two parts, and the
/// density of the direction.
#[derive(Clone, Copy, Debug)]
pub struct Scattered {
    /// a/π · (n·ωi), per channel.
    pub diffuse: Vec3Of<f32>,
    /// f_s · (n·ωi), per channel.
    pub specular: Vec3Of<f32>,
    /// Density per steradian with which [`Scatterer::sample`] draws the direction.
    pub pdf: f32,
}

/// A surface point seen from one side: evaluates and samples its BRDF.
///
/// The density is a mixture of the cosine around the normal and of mirror directions at microfacet
/// normals drawn exactly from the NDF's SG, for which f_s (n·ωi)/pdf = F·G·(ωo·h)/((n·ωo)·chance)
/// is bounded. From GGX they are drawn in proportion to D·(n·h), for which it is that over n·h:
/// bounded as well, since n·h ≥ (n·ωo + n·ωi)/2.
#[derive(Clone, Copy, Debug)]
pub struct Scatterer {
    frame: TangentFrame,
    to_viewer: Vec3Of<f32>,
    albedo: Vec3Of<f32>,
    specular_albedo: Vec3Of<f32>,
    facets: Facets<f32>,
    /// Probability of sampling the specular part; zero if there is none.
    specular_chance: f32,
}

impl Scatterer {
    /// A point with a unit shading `normal`, seen along the unit direction `to_viewer`; `specular`
    /// is (albedo, microfacets).
    ///
    /// `None` if the viewer is below the horizon of the shading normal, where the point scatters no
    /// light.
    #[inline]
    pub fn new(
        normal: Vec3Of<f32>,
        to_viewer: Vec3Of<f32>,
        albedo: Vec3Of<f32>,
        specular: Option<(Vec3Of<f32>, Facets<f32>)>,
    ) -> Option<Self> {
        let cos_view = dot(normal, to_viewer);
        if !above_zero(cos_view) {
            return None;
        }
        let mean = |c: Vec3Of<f32>| (c[0] + c[1] + c[2]) * (1.0 / 3.0);
        let (specular_albedo, facets, specular_chance) = match specular {
            None => ([0.0; 3], Facets::sg(1.0), 0.0),
            Some((s, facets)) => {
                let power = fresnel_power(cos_view);
                let reflected = mean(s) * (1.0 - power) + power;
                let chance = reflected / (reflected + mean(albedo).max(1e-6));
                (s, facets, chance.clamp(0.2, 0.8))
            }
        };
        let frame = TangentFrame::new(normal);
        Some(Self { frame, to_viewer, albedo, specular_albedo, facets, specular_chance })
    }

    /// BRDF times cosine for light from the unit direction `to_light`, and the density of
    /// [`Self::sample`]; zero below the horizon.
    #[inline]
    pub fn evaluate(&self, to_light: Vec3Of<f32>) -> Scattered {
        let normal = self.frame.normal;
        let cosine = dot(normal, to_light);
        if !above_zero(cosine) {
            return Scattered { diffuse: [0.0; 3], specular: [0.0; 3], pdf: 0.0 };
        }
        let cosine_pdf = cosine * FRAC_1_PI;
        let diffuse = scale(self.albedo, cosine_pdf);
        if self.specular_chance <= 0.0 {
            return Scattered { diffuse, specular: [0.0; 3], pdf: cosine_pdf };
        }
        let (constant, slope) = specular_affine(normal, self.to_viewer, to_light, self.facets);
        let specular = self.specular_albedo.map(|s| (slope * s + constant) * cosine);
        let pdf = cosine_pdf + self.specular_chance * (self.specular_pdf(to_light) - cosine_pdf);
        Scattered { diffuse, specular, pdf }
    }

    /// p(h)/(4 ωo·h): density of the mirror direction at a microfacet normal h drawn from the NDF.
    #[inline]
    fn specular_pdf(&self, to_light: Vec3Of<f32>) -> f32 {
        let half = add(self.to_viewer, to_light);
        let length = dot(half, half).sqrt();
        let half = scale(half, length.max(1e-12).recip());
        let cos_half = dot(self.to_viewer, half);
        if !above_zero(cos_half) {
            return 0.0;
        }
        let density = normal_distribution(self.frame.normal, half, self.facets);
        let share = match self.facets.ndf {
            Ndf::Sg => -(ndf_sharpness(self.facets.roughness) * -2.0).exp_m1().recip(),
            Ndf::Ggx => dot(self.frame.normal, half),
        };
        density * share / (cos_half * 4.0)
    }

    /// Samples a direction; `None` if it is below the horizon (a valid sample of value zero).
    #[inline]
    pub fn sample(&self, u: [f32; 3]) -> Option<Vec3Of<f32>> {
        let direction = if u[0] < self.specular_chance {
            let (roughness, u) = (self.facets.roughness, [u[1], u[2]]);
            let half = match self.facets.ndf {
                Ndf::Sg => sample_sg(&self.frame, ndf_sharpness(roughness), u),
                Ndf::Ggx => sample_ggx(&self.frame, roughness, u),
            };
            let cos_half = dot(self.to_viewer, half);
            if !above_zero(cos_half) {
                return None;
            }
            sub(scale(half, cos_half * 2.0), self.to_viewer)
        } else {
            let radius = u[1].sqrt();
            let (s, c) = (u[2] * TAU).sin_cos();
            self.frame.world(radius * c, radius * s, (1.0 - u[1]).relu().sqrt())
        };
        let direction = scale(direction, dot(direction, direction).sqrt().recip());
        above_zero(dot(direction, self.frame.normal)).then_some(direction)
    }
}

/// The power heuristic (Veach and Guibas 1995), the weight of a direction drawn with density `own` >
/// 0, which another strategy would draw with density `other`: own²/(own² + other²), computed from
/// the ratio so that no square overflows.
#[inline]
pub fn power_heuristic(own: f32, other: f32) -> f32 {
    if other > own {
        let ratio = own / other;
        ratio * ratio / (ratio * ratio + 1.0)
    } else {
        let ratio = other / own;
        (ratio * ratio + 1.0).recip()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shade::sampling::sobol::Sequence;
    use std::f64::consts::PI;

    /// Midpoint rule over the sphere.
    fn integrate(rings: usize, f: impl Fn([f32; 3]) -> f32) -> f64 {
        let sectors = 2 * rings;
        let mut sum = 0.0;
        for i in 0..rings {
            let z = -1.0 + 2.0 * (i as f64 + 0.5) / rings as f64;
            let r = (1.0 - z * z).sqrt();
            for j in 0..sectors {
                let (s, c) = (2.0 * PI * (j as f64 + 0.5) / sectors as f64).sin_cos();
                sum += f64::from(f([r * c, r * s, z].map(|x| x as f32)));
            }
        }
        sum * 4.0 * PI / (rings * sectors) as f64
    }

    #[test]
    fn frame_is_orthonormal() {
        for normal in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.36, -0.48, -0.8]] {
            let frame = TangentFrame::new(normal);
            let axes = [frame.tangent, frame.bitangent, frame.normal];
            for i in 0..3 {
                for j in 0..3 {
                    let expected = if i == j { 1.0 } else { 0.0 };
                    assert!((dot(axes[i], axes[j]) - expected).abs() < 1e-6);
                }
            }
        }
    }

    /// The scatterer's density integrates to the fraction of draws that are above the horizon, and
    /// the moments agree.
    #[test]
    fn scattered_draws_follow_their_density() {
        let normal = [0.0, 0.0, 1.0];
        let cases = [(0.3, 0.3f32), (0.5, 1.2), (0.9, 0.8)];
        let each = cases.into_iter().flat_map(|case| [(Ndf::Sg, case), (Ndf::Ggx, case)]);
        for (ndf, (roughness, slant)) in each {
            let to_viewer = [slant.sin(), 0.0, slant.cos()];
            let specular = Some(([0.3; 3], Facets { ndf, roughness }));
            let point = Scatterer::new(normal, to_viewer, [0.5; 3], specular).unwrap();
            let count = 1 << 14;
            for moment in 0..3 {
                let value = |w: [f32; 3]| [1.0, w[0], w[2] * w[2]][moment];
                let expected = integrate(500, |w| value(w) * point.evaluate(w).pdf);
                let drawn = (0..count).filter_map(|i| point.sample(Sequence::new(2, 0, i).group(0)));
                let drawn = drawn.map(|w| f64::from(value(w))).sum::<f64>() / f64::from(count);
                let off = (drawn - expected).abs();
                assert!(off < 2e-3, "{ndf:?} {roughness} {slant} {moment}: {drawn} {expected}");
            }
        }
    }

    #[test]
    fn heuristic_weights_sum_to_one() {
        for (a, b) in [(1.0, 2.0), (1e-30, 1e-25), (3.0, 0.0), (1e30, 1e20)] {
            let light = power_heuristic(a, b);
            let brdf = if b > 0.0 { power_heuristic(b, a) } else { 0.0 };
            assert!((0.0..=1.0).contains(&light), "{light}");
            assert!((light + brdf - 1.0).abs() < 1e-6, "{light} {brdf}");
        }
    }

    #[test]
    fn a_viewer_below_the_horizon_sees_nothing() {
        let normal = [0.0, 0.0, 1.0];
        assert!(Scatterer::new(normal, [0.6, 0.0, -0.8], [0.5; 3], None).is_none());
        assert!(Scatterer::new(normal, [1.0, 0.0, 0.0], [0.5; 3], None).is_none());
        assert!(Scatterer::new([f32::NAN; 3], [0.0, 0.0, 1.0], [0.5; 3], None).is_none());
    }
}
