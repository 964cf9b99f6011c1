use super::*;
use lobelia_sg::brdf::{Facets, Ndf, specular_affine};
use lobelia_sg::ray::{LightSample, TexelAddress};
use lobelia_world::{light::LightLobe, light::illuminate::LobeLight};
use std::f64::consts::PI;

/// Light of one radiance from everywhere.
struct Constant(Vec3);

impl Illuminate for Constant {
    fn radiance(&self, _: Vec3) -> Vec3 {
        self.0
    }
    fn sample(&self, u: [f32; 3]) -> LightSample {
        let z = 1.0 - 2.0 * u[1];
        let r = (1.0 - z * z).max(0.0).sqrt();
        let (s, c) = (2.0 * std::f32::consts::PI * u[2]).sin_cos();
        let direction = Vec3::new(r * c, r * s, z);
        LightSample { direction, radiance: self.0, pdf: self.pdf(direction) }
    }
    fn pdf(&self, _: Vec3) -> f32 {
        (0.25 / PI) as f32
    }
}

/// Nothing in the way.
struct Empty;

impl Intersect for Empty {
    fn intersect(&self, _: &Ray, _: f32) -> Option<Hit> {
        None
    }
    fn occluded(&self, _: &Ray, _: f32, _: f32) -> bool {
        false
    }
}

/// A sphere, or the part of its wall below `brim` (a height over the center in radii; 1 for all of
/// it), with one texel.
struct Shell {
    center: Vec3,
    radius: f32,
    brim: f32,
    /// 1: normals outward; −1: inward.
    side: f32,
}

impl Intersect for Shell {
    fn intersect(&self, ray: &Ray, min_distance: f32) -> Option<Hit> {
        let from = ray.origin - self.center;
        let b = from.dot(ray.direction);
        // |from|² − r² without cancellation far from the origin.
        let c = (from.length() - self.radius) * (from.length() + self.radius);
        let root = (b * b - c).sqrt();
        [-b - root, -b + root].into_iter().find_map(|distance| {
            let outward = (from + ray.direction * distance) / self.radius;
            (distance > min_distance && outward.z <= self.brim).then(|| Hit {
                distance,
                position: self.center + outward * self.radius,
                normal: outward.normalize() * self.side,
                geometric_normal: outward.normalize() * self.side,
                uv: Default::default(),
                texels: TexelAddress { indices: [0; 4], weights: [1.0, 0.0, 0.0, 0.0] },
            })
        })
    }
    fn occluded(&self, ray: &Ray, min_distance: f32, max_distance: f32) -> bool {
        self.intersect(ray, min_distance).is_some_and(|hit| hit.distance < max_distance)
    }
}

/// A scene whose surface has one texel of this diffuse material, or none.
fn scene<'a>(
    surface: &'a dyn Intersect,
    light: &'a dyn Illuminate,
    diffuse: &'a [Shown<Diffuse>],
    specular: &'a [Option<SpecularLobe>],
) -> PathScene<'a> {
    PathScene { surface, light, diffuse, blends: &[], specular }
}

fn query(position: Vec3, normal: Vec3, to_viewer: Vec3, albedo: Vec3) -> PathQuery {
    let point =
        PathPoint { position, normal, geometric_normal: normal, albedo, blend: SpecularBlend::default().0 };
    PathQuery { point, to_viewer: to_viewer.normalize(), stream: 0, first_sample: 0 }
}

/// Means of diffuse and specular with standard errors from the spread of 16 independent streams.
fn estimate(
    scene: &PathScene,
    settings: &PathSettings,
    query: &PathQuery,
    samples: u32,
) -> [[(f64, f64); 3]; 2] {
    let queries: Vec<_> = (0..16).map(|stream| PathQuery { stream, ..*query }).collect();
    let mut out = vec![PathEstimate::default(); queries.len()];
    shade_points(scene, settings, &queries, samples, &mut out);
    assert!(out.iter().all(|e| e.rejected == 0));
    [0, 1].map(|part| {
        [0, 1, 2].map(|c| {
            let values = out.iter().map(|e| f64::from([e.diffuse, e.specular][part][c]));
            let mean = values.clone().sum::<f64>() / 16.0;
            let squares = values.map(|v| (v - mean).powi(2)).sum::<f64>();
            (mean, (squares / (15.0 * 16.0)).sqrt())
        })
    })
}

fn assert_close((mean, stderr): (f64, f64), expected: f64, what: &str) {
    let tolerance = 4.0 * stderr + 2e-4 * expected;
    assert!((mean - expected).abs() <= tolerance, "{what}: {mean} ± {stderr}, expected {expected}");
    assert!(stderr < 0.05 * expected.max(1e-3), "{what}: {stderr} is too noisy to tell");
}

const GRAY_SPECULAR: [Option<SpecularLobe>; 1] = [Some(SpecularLobe::new(Vec3::splat(0.3), 0.4))];

/// ∫ f_s (n·ωi) dωi over the hemisphere for a specular albedo, in f64 by the midpoint rule.
fn specular_integral(slant: f64, facets: Facets<f64>, albedo: f64) -> f64 {
    let (rings, sectors) = (500, 1000);
    let to_viewer = [slant.sin(), 0.0, slant.cos()];
    let mut sum = 0.0;
    for i in 0..rings {
        // z = cos θ as t(2 − t): finer near the horizon's other end, where sharp lobes are.
        let t = (f64::from(i) + 0.5) / f64::from(rings);
        let z = t * (2.0 - t);
        let r = (1.0 - z * z).sqrt();
        for j in 0..sectors {
            let (s, c) = (2.0 * PI * (f64::from(j) + 0.5) / f64::from(sectors)).sin_cos();
            let (constant, slope) = specular_affine([0.0, 0.0, 1.0], to_viewer, [r * c, r * s, z], facets);
            sum += (constant + slope * albedo) * z * (2.0 - 2.0 * t);
        }
    }
    sum * 2.0 * PI / f64::from(rings * sectors)
}

#[test]
fn open_sky_matches_numerical_integration() {
    let light = Constant(Vec3::new(1.0, 2.0, 0.5));
    let albedo = Vec3::new(0.8, 0.1, 0.4);
    let materials = [Ndf::Sg, Ndf::Ggx].into_iter().flat_map(|ndf| [0.2, 0.5, 1.0].map(|r| (ndf, r)));
    for (ndf, roughness) in materials {
        for slant in [0.1f64, 0.9, 1.4] {
            let albedo_0 = Vec3::new(0.9, 0.04, 0.3);
            let specular = [Some(SpecularLobe { albedo: albedo_0, roughness: roughness as f32, ndf })];
            let scene = scene(&Empty, &light, &[], &specular);
            let to_viewer = Vec3::new(slant.sin() as f32, 0.0, slant.cos() as f32);
            let query = query(Vec3::ZERO, Vec3::Z, to_viewer, albedo);
            let found = estimate(&scene, &PathSettings::default(), &query, 256);
            for c in 0..3 {
                let radiance = f64::from(light.0[c]);
                let facets = Facets { ndf, roughness };
                let gloss = specular_integral(slant, facets, f64::from(albedo_0[c]));
                let what = format!("{ndf:?}, roughness {roughness}, slant {slant}, channel {c}");
                assert_close(found[0][c], f64::from(albedo[c]) * radiance, &format!("diffuse, {what}"));
                assert_close(found[1][c], gloss * radiance, &format!("specular, {what}"));
            }
        }
    }
}

/// A ball overhead of angular radius α hides sin²α of a floor's irradiance.
#[test]
fn a_ball_overhead_casts_its_shadow() {
    let ball = Shell { center: Vec3::new(0.0, 0.0, 2.0), radius: 1.2, brim: 1.0, side: 1.0 };
    let light = Constant(Vec3::ONE);
    let texels = [Shown(Diffuse::of_albedo(Vec3::ZERO))];
    let scene = scene(&ball, &light, &texels, &[]);
    let settings = PathSettings { max_bounces: 1, ..Default::default() };
    let query = query(Vec3::ZERO, Vec3::Z, Vec3::new(1.0, 0.0, 0.2), Vec3::splat(0.5));
    let found = estimate(&scene, &settings, &query, 512);
    assert_close(found[0][1], 0.5 * (1.0 - 0.36), "diffuse");
    assert_eq!(found[1], [(0.0, 0.0); 3], "a surface without base material has no specular part");
}

#[test]
fn the_inside_of_a_closed_shell_is_black() {
    let shell = Shell { center: Vec3::ZERO, radius: 1.0, brim: 1.0, side: -1.0 };
    let light = Constant(Vec3::ONE);
    let texels = [Shown(Diffuse::of_albedo(Vec3::splat(0.5)))];
    let scene = scene(&shell, &light, &texels, &GRAY_SPECULAR);
    let query = query(-Vec3::Z, Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::splat(0.5));
    let found = estimate(&scene, &PathSettings::default(), &query, 64);
    assert_eq!(found, [[(0.0, 0.0); 3]; 2]);
}

/// A sphere's own surface does not shadow it, near the origin or far away.
#[test]
fn a_convex_surface_does_not_shadow_itself() {
    for center in [Vec3::ZERO, Vec3::new(300.0, -20.0, 7.0)] {
        let ball = Shell { center, radius: 1.0, brim: 1.0, side: 1.0 };
        let light = Constant(Vec3::ONE);
        let texels = [Shown(Diffuse::of_albedo(Vec3::ONE))];
        let scene = scene(&ball, &light, &texels, &[]);
        let normal = Vec3::new(0.3, -0.5, 0.8).normalize();
        let query = query(center + normal, normal, normal, Vec3::splat(0.5));
        let found = estimate(&scene, &PathSettings::default(), &query, 256);
        assert_close(found[0][0], 0.5, "diffuse");
    }
}

/// In a diffuse spherical bowl every wall point sees every other alike: with f the open cap's share
/// of the sphere, a bounce passes on a(1 − f), and n bounces give a·f·Σ (a(1 − f))^i, i < n, of the
/// sky's radiance.
#[test]
fn a_bowl_gathers_its_geometric_series() {
    let bowl = Shell { center: Vec3::ZERO, radius: 1.0, brim: 0.4, side: -1.0 };
    let (albedo, open) = (0.8f64, 0.3);
    let light = Constant(Vec3::new(1.0, 0.5, 2.0));
    let texels = [Shown(Diffuse::of_albedo(Vec3::splat(albedo as f32)))];
    let scene = scene(&bowl, &light, &texels, &[]);
    for max_bounces in [1, 2, 3, 6, 60] {
        let expected: f64 = (0..max_bounces).map(|i| albedo * open * (albedo * (1.0 - open)).powi(i)).sum();
        let settings = PathSettings { max_bounces: max_bounces as u32, ..Default::default() };
        for normal in [Vec3::Z, Vec3::new(0.8, 0.0, 0.6)] {
            let query = query(-normal, normal, normal + Vec3::X * 0.5, texels[0].0.albedo);
            let found = estimate(&scene, &settings, &query, 1024);
            assert_close(found[0][0], expected, &format!("{max_bounces} bounces"));
            assert_close(found[0][2], 2.0 * expected, &format!("{max_bounces} bounces"));
        }
    }
}

/// Early roulette changes nothing, glossy bounces included.
#[test]
fn roulette_keeps_the_mean() {
    let bowl = Shell { center: Vec3::ZERO, radius: 1.0, brim: 0.4, side: -1.0 };
    let lobe = LightLobe { axis: Vec3::new(0.28, 0.0, 0.96), sharpness: 4.0, amplitude: Vec3::ONE };
    let light = LobeLight::new(&[lobe]);
    let texels = [Shown(Diffuse::of_albedo(Vec3::splat(0.5)))];
    let scene = scene(&bowl, &light, &texels, &GRAY_SPECULAR);
    let query = query(-Vec3::Z, Vec3::Z, Vec3::new(-0.5, 0.2, 0.7), texels[0].0.albedo);
    let both = PathSettings { max_bounces: 4, ..Default::default() };
    let reference = estimate(&scene, &both, &query, 2048);
    let early = PathSettings { roulette_after: 1, seed: 3, ..both };
    let found = estimate(&scene, &early, &query, 4096);
    for part in 0..2 {
        let ((a, sa), (b, sb)) = (reference[part][0], found[part][0]);
        assert!(a > 0.01 && sb < 0.05 * a, "{a} {sb}");
        assert!((a - b).abs() < 4.0 * sa.hypot(sb), "part {part}: {a} ± {sa}, {b} ± {sb}");
    }
}

/// Threads and the split into calls do not change a bit; samples taken in two halves are the
/// samples taken at once.
#[test]
fn results_depend_on_the_query_alone() {
    let bowl = Shell { center: Vec3::ZERO, radius: 1.0, brim: 0.2, side: -1.0 };
    let light = Constant(Vec3::ONE);
    let texels = [Shown(Diffuse::of_albedo(Vec3::splat(0.7)))];
    let scene = scene(&bowl, &light, &texels, &GRAY_SPECULAR);
    let settings = PathSettings { seed: 9, ..Default::default() };
    let base = query(-Vec3::Z, Vec3::Z, Vec3::new(0.1, 0.2, 0.7), texels[0].0.albedo);
    let queries: Vec<_> = (0..100).map(|stream| PathQuery { stream, ..base }).collect();
    let runs = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut out = vec![PathEstimate::default(); queries.len()];
        pool.install(|| shade_points(&scene, &settings, &queries, 8, &mut out));
        out
    });
    assert_eq!(runs[0], runs[1]);
    assert_eq!(runs[0][42], shade_point(&scene, &settings, &queries[42], 8));
    assert_ne!(runs[0][42].diffuse, runs[0][43].diffuse, "streams differ");
    let half =
        |first_sample| shade_point(&scene, &settings, &PathQuery { first_sample, ..queries[42] }, 4).diffuse;
    assert!((0.5 * (half(0) + half(4)) - runs[0][42].diffuse).abs().max_element() < 1e-6);
}

#[test]
fn what_cannot_be_shaded_is_black_and_counted() {
    let light = Constant(Vec3::ONE);
    let scene = scene(&Empty, &light, &[], &GRAY_SPECULAR);
    let settings = PathSettings::default();
    let behind = query(Vec3::ZERO, Vec3::Z, Vec3::new(0.5, 0.0, -0.5), Vec3::ONE);
    let seen = shade_point(&scene, &settings, &behind, 16);
    assert_eq!((seen.diffuse, seen.specular), (Vec3::ZERO, Vec3::ZERO));
    let broken = query(Vec3::ZERO, Vec3::Z, Vec3::Z, Vec3::splat(f32::NAN));
    let seen = shade_point(&scene, &settings, &broken, 16);
    assert!(seen.rejected > 0 && seen.diffuse.is_finite());
    let none = shade_point(&scene, &PathSettings { max_bounces: 0, ..settings }, &behind, 16);
    assert_eq!(none.diffuse, Vec3::ZERO);
}
