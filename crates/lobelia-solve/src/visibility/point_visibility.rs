//! The visibility of a point from the rows around it: the part of the specular light that arrives,
//! and interreflected light.
//!
//! The directions of [`TexelVisibility`] are too far apart for a narrow lobe of the BRDF: of a
//! glossy surface in which another part is reflected, a few rays within the lobe say what it meets.
//! Where they meet the surface, that sends diffuse light, and its reflection of the sky in turn.

use crate::visibility::occlusion::{Bounce, Cones, MOST_MIRRORED, Mirror, Sky, sharpness_of_lobe, widened};
use crate::visibility::texel_visibility::{MAX_DIRECTIONS, OFFSET, TOGETHER, TexelVisibility};
use fearless_simd::Simd;
use glam::{Mat3, Vec3};
use lobelia_sg::real::{Real, dot};
use lobelia_sg::{brdf::ndf_sharpness, color::luminance, lanes::Lanes, ray::Hit};
use lobelia_sg::{ray::Intersect, shading::PointVisibility};
use lobelia_world::sample::pixel::PixelOf;
use std::{f32::consts::PI, sync::LazyLock};

/// Directions contribute to specular light where the BRDF lobe is above e to the power of minus
/// this.
const MIRROR_REACH: f32 = 4.0;
/// Sharpness of a lobe from which rays are cast: R < 0.27 straight on.
const LEAST_SHARPNESS: f32 = 100.0;
/// Rays of a point, and in a step of a fit, which sees each pixel a few times.
const RAYS: usize = 16;
const RAYS_OF_STEP: usize = 4;
/// Angle between two points of a spiral that is evenly dense (Vogel 1979).
const GOLDEN_ANGLE: f32 = 2.399_963_2;

/// Up to four rows of texels and their weights, which sum to one.
pub(crate) type Blend = [(usize, f32); 4];

/// Whether nothing is hidden from rows around a point.
pub(crate) fn is_open(visibility: &TexelVisibility, blend: &Blend) -> bool {
    blend.iter().all(|(row, weight)| *weight == 0.0 || visibility.sees_all(*row))
}

/// A point that is seen.
#[derive(Clone, Copy)]
pub(crate) struct SeenPoint {
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit normal of the flat triangle.
    pub geometric_normal: Vec3,
    /// Unit direction to the viewer.
    pub to_viewer: Vec3,
    /// Roughness R of its material.
    pub roughness: f32,
}

impl SeenPoint {
    /// Whether another point not farther away than `near` mirrors nearly the same: their lobes are
    /// turned by at most a quarter of their width.
    fn mirrors_as(&self, other: &Self, near: f32) -> bool {
        let up = self.normal.dot(self.to_viewer);
        let sharpness = sharpness_of_lobe(ndf_sharpness(self.roughness), up);
        // The normals' angle α is an eighth of 1/√λ; 1 − cos α = α²/2.
        self.position.distance_squared(other.position) <= near * near
            && 1.0 - self.normal.dot(other.normal) <= 1.0 / (128.0 * sharpness)
            && (self.roughness - other.roughness).abs() <= 0.05 * self.roughness
    }
}

/// For each of `count` points the first one of its pixel, of those one after another, if that
/// mirrors as it does, or else itself. `pixel_of` has the pixel of a point that is on the object,
/// and `at` the point.
pub(crate) fn first_of_alike(
    count: usize,
    pixel_of: impl Fn(usize) -> Option<PixelOf>,
    at: impl Fn(usize) -> SeenPoint,
    near: f32,
) -> Vec<usize> {
    let mut first: Option<(usize, PixelOf)> = None;
    let of = |i: usize| {
        let Some(pixel) = pixel_of(i) else { return i };
        match first.filter(|(_, of)| *of == pixel) {
            Some((number, _)) if at(i).mirrors_as(&at(number), near) => number,
            Some(_) => i,
            None => {
                first = Some((i, pixel));
                i
            }
        }
    };
    (0..count).map(of).collect()
}

/// Rays within narrow lobes.
#[derive(Clone, Copy)]
pub struct LobeRays<'a> {
    pub(super) surface: &'a dyn Intersect,
    spiral: &'a [InLobe],
}

impl<'a> LobeRays<'a> {
    /// The rays of a picture, or the fewer of a step of a fit.
    pub fn new(surface: &'a dyn Intersect, of_step: bool) -> Self {
        Self { surface, spiral: if of_step { &*SPIRAL_OF_STEP } else { &*SPIRAL } }
    }
}

/// Occlusion and light around a point.
#[derive(Clone, Copy)]
pub(crate) struct Surroundings<'a> {
    /// Hidden directions of the light.
    pub visibility: &'a TexelVisibility,
    pub sky: &'a Sky,
    /// The light that the surface sends.
    pub bounce: &'a Bounce,
    /// Rays of narrow lobes, if they are to be cast.
    pub rays: Option<LobeRays<'a>>,
}

impl Surroundings<'_> {
    /// The visibility of a point from the rows around it.
    ///
    /// Specular light is scaled by Σ_d B(d)·L(d) over Σ_d B(d)·sky(d), where B is the lobe of the
    /// BRDF around the mirror direction (sharpness L/(4 n·v), Wang et al. 2009) times the cosine,
    /// and L the incident radiance from d: that of the sky, or of what occludes it. The directions
    /// d are those of the rows, or for a narrow lobe some within it.
    pub fn of(&self, blend: &Blend, point: &SeenPoint) -> PointVisibility {
        let indirect: Vec3 = blend.iter().map(|(row, weight)| self.bounce.indirect[*row] * *weight).sum();
        let part = self.specular_part(blend, point).unwrap_or(Vec3::ONE);
        PointVisibility { specular: part.into(), indirect: indirect.into() }
    }

    /// The part of the specular light; `None` if all of it arrives.
    fn specular_part(&self, blend: &Blend, point: &SeenPoint) -> Option<Vec3> {
        let Self { visibility, sky, bounce, rays } = *self;
        let normal = point.normal;
        let up = normal.dot(point.to_viewer);
        if is_open(visibility, blend) || up <= 0.0 {
            return None;
        }
        let axis = 2.0 * up * normal - point.to_viewer;
        let narrow = sharpness_of_lobe(ndf_sharpness(point.roughness), up);
        let sharpness = widened(narrow, visibility.directions.len() as f32 / 2.0);
        let least = 1.0 - MIRROR_REACH / sharpness;
        let mut near = [0; MAX_DIRECTIONS / 64];
        lobelia_sg::dispatch!(simd => directions_near(simd, sky, axis, least, &mut near));
        let rows = blend.iter().filter(|(_, part)| *part > 0.0);
        if !rows.clone().any(|(row, _)| visibility.hides_any(*row, &near)) {
            return None;
        }
        if let Some(rays) = rays.filter(|_| narrow > LEAST_SHARPNESS) {
            return Some(self.part_by_rays(rays, point, axis, narrow));
        }
        let (vectors, lobe, mut weights) = ([axis, normal], [sharpness, least], [0.0; MAX_DIRECTIONS]);
        let unhidden =
            lobelia_sg::dispatch!(simd => weigh_directions(simd, sky, vectors, lobe, &near, &mut weights));
        let arriving = rows.fold(unhidden, |arriving, (row, part)| {
            // A back face sends nothing.
            let sent = |hider: u32| bounce.leaving.get(hider as usize).copied().unwrap_or(Vec3::ZERO);
            let hidden = visibility.hidden_among(*row, &near);
            let instead = hidden.map(|(d, hider)| (sent(hider) - sky.radiance(d)) * weights[d]);
            arriving + instead.sum::<Vec3>() * *part
        });
        let floor = Vec3::splat(1e-6 * luminance(unhidden).max(1e-20));
        Some((arriving / unhidden.max(floor)).clamp(Vec3::ZERO, Vec3::splat(MOST_MIRRORED)))
    }

    /// The part of the light in a lobe of this `sharpness` around the direction `axis` that arrives
    /// at a point, by rays.
    fn part_by_rays(&self, rays: LobeRays, point: &SeenPoint, axis: Vec3, sharpness: f32) -> Vec3 {
        let SeenPoint { position: origin, normal, geometric_normal, .. } = *point;
        let (x, y) = axis.any_orthonormal_pair();
        let world_from_lobe = Mat3::from_cols(x, y, axis);
        let LobeRays { surface, spiral } = rays;
        let (mut directions, mut hits, mut sent) = ([Vec3::ZERO; RAYS], [None; RAYS], [None; RAYS]);
        let (directions, hits) = (&mut directions[..spiral.len()], &mut hits[..spiral.len()]);
        for (direction, place) in directions.iter_mut().zip(spiral) {
            *direction = world_from_lobe * direction_in_lobe(*place, sharpness);
        }
        surface.intersect_packet(origin, directions, OFFSET * surface.radius(), hits);
        for ((sent, hit), direction) in sent.iter_mut().zip(hits).zip(&*directions) {
            // A ray that enters the flat triangle meets nothing that the smooth surface would.
            let hit = hit.filter(|_| geometric_normal.dot(*direction) > 0.0);
            *sent = hit.map(|hit| self.sent_back(&hit, *direction));
        }
        if sent.iter().all(Option::is_none) {
            return Vec3::ONE;
        }
        let (mut arriving, mut unhidden) = (Vec3::ZERO, Vec3::ZERO);
        for (direction, sent) in directions.iter().copied().zip(sent) {
            let cosine = normal.dot(direction).max(0.0);
            let sky = self.sky.toward(direction, sharpness * spiral.len() as f32);
            unhidden += sky * cosine;
            arriving += sent.unwrap_or(sky) * cosine;
        }
        let floor = Vec3::splat(1e-6 * unhidden.max_element().max(1e-20));
        (arriving / unhidden.max(floor)).clamp(Vec3::ZERO, Vec3::splat(MOST_MIRRORED))
    }

    /// Radiance that a place of the surface sends back along a ray that has met it: diffuse, and
    /// the sky that it mirrors.
    fn sent_back(&self, hit: &Hit, direction: Vec3) -> Vec3 {
        if hit.geometric_normal.dot(direction) >= 0.0 {
            return Vec3::ZERO;
        }
        let (mut sum, mut total) = (Mirror::default(), 0.0);
        for (texel, weight) in hit.texels.indices.into_iter().zip(hit.texels.weights) {
            if let Some(mirror) = self.bounce.mirrors.get(self.visibility.rows[texel as usize] as usize) {
                (sum, total) = (sum.plus(mirror, weight), total + weight);
            }
        }
        let place = Mirror::default().plus(&sum, total.max(f32::MIN_POSITIVE).recip());
        let up = -direction.dot(hit.normal);
        if up <= 0.0 {
            return place.diffuse;
        }
        let fresnel = place.albedo + (1.0 - place.albedo) * (1.0 - up).powi(5);
        let out = direction + 2.0 * up * hit.normal;
        place.diffuse + fresnel * self.sky.toward(out, sharpness_of_lobe(place.sharpness, up))
    }
}

/// A direction of a lobe: the logarithm of the part of the lobe's power that is farther from its
/// axis; cosine and sine of its angle around the axis.
type InLobe = [f32; 3];

/// Directions of equal weight.
static SPIRAL: LazyLock<[InLobe; RAYS]> = LazyLock::new(spiral);
static SPIRAL_OF_STEP: LazyLock<[InLobe; RAYS_OF_STEP]> = LazyLock::new(spiral);

/// Pairs on opposite sides of the axis, so that the mean direction is the axis however few there
/// are. Each pair has as much of the lobe's power around the axis, and is where the mean of its
/// power is.
fn spiral<const COUNT: usize>() -> [InLobe; COUNT] {
    let pairs = (COUNT / 2) as f32;
    // ∫ −ln(1 − p) dp.
    let below = |p: f32| p + if p < 1.0 { (1.0 - p) * (1.0 - p).ln() } else { 0.0 };
    std::array::from_fn(|i| {
        let pair = (i / 2) as f32;
        let beyond = (below(pair / pairs) - below((pair + 1.0) / pairs)) * pairs;
        // What is opposite comes again after half a turn, and so does the angle of a spiral.
        let (sin, cos) = (pair * 0.5 * GOLDEN_ANGLE + (i % 2) as f32 * PI).sin_cos();
        [beyond, cos, sin]
    })
}

/// A direction of a lobe around +Z.
fn direction_in_lobe([beyond, cos, sin]: InLobe, sharpness: f32) -> Vec3 {
    // The part of e^{λ(z − 1)} between 1 and z; beyond λ = 100 nothing is below z = −1.
    let z = (1.0 + beyond / sharpness).max(-1.0);
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(radius * cos, radius * sin, z)
}

/// Sets the bit of each direction whose cosine to `axis` is above `least`.
#[inline(always)]
fn directions_near<S: Simd>(simd: S, sky: &Sky, axis: Vec3, least: f32, near: &mut [u64]) {
    let lanes = axis.to_array().map(|c| Lanes::splat(simd, c));
    let bound = Lanes::splat(simd, least);
    for first in (0..sky.cones.edge[0].len()).step_by(Lanes::<S>::LEN) {
        let mut cones = cones_near(simd, &sky.cones, first, axis, least);
        while cones != 0 {
            let begin = (first + cones.trailing_zeros() as usize) * TOGETHER;
            cones &= cones - 1;
            let end = sky.directions[0].len().min(begin + TOGETHER);
            for at in (begin..end).step_by(Lanes::<S>::LEN) {
                let column = |c: usize| Lanes::load(simd, &sky.directions[c][at..at + Lanes::<S>::LEN]);
                let bits = bound.bits_below(dot([column(0), column(1), column(2)], lanes));
                near[at / 64] |= bits << (at % 64);
            }
        }
    }
}

/// A bit for each cone of a vector from the `first` on that has a place whose cosine to `axis` may
/// be above `least`.
#[inline(always)]
fn cones_near<S: Simd>(simd: S, cones: &Cones, first: usize, axis: Vec3, least: f32) -> u64 {
    let axis = axis.to_array().map(|c| Lanes::splat(simd, c));
    let least = least.clamp(-1.0, 1.0);
    let [cosine, sine] = [least, (1.0 - least * least).sqrt()].map(|c| Lanes::splat(simd, c));
    let column = |values: &[f32]| Lanes::load(simd, &values[first..first + Lanes::<S>::LEN]);
    let to_axis = dot([column(&cones.axes[0]), column(&cones.axes[1]), column(&cones.axes[2])], axis);
    let [edge, edge_sine] = [column(&cones.edge[0]), column(&cones.edge[1])];
    // The cosine of the sum of both angles; a sum beyond 180° is near to all.
    let farthest = cosine * edge - sine * edge_sine - cosine.lit(1e-5);
    let all = (-cosine).bits_below(edge) ^ u64::MAX;
    (farthest.bits_below(to_axis) | all) & (u64::MAX >> (64 - Lanes::<S>::LEN))
}

/// The lobe of the BRDF around the mirrored view, `axis`, where its cosine to a direction is above
/// `least`, times the cosine with `normal`: its value at each direction, in groups of lanes of
/// which a bit of `near` is set, and the light of the whole sky weighted by it.
#[inline(always)]
fn weigh_directions<S: Simd>(
    simd: S,
    sky: &Sky,
    [axis, normal]: [Vec3; 2],
    [sharpness, least]: [f32; 2],
    near: &[u64],
    weights: &mut [f32; MAX_DIRECTIONS],
) -> Vec3 {
    let [axis, normal] = [axis, normal].map(|v| v.to_array().map(|c| Lanes::splat(simd, c)));
    let [least, sharpness, zero] = [least, sharpness, 0.0].map(|c| Lanes::splat(simd, c));
    let mut light = [zero; 3];
    let group = u64::MAX >> (64 - Lanes::<S>::LEN);
    for at in (0..sky.directions[0].len()).step_by(Lanes::<S>::LEN) {
        if near[at / 64] >> (at % 64) & group == 0 {
            continue;
        }
        let load =
            |columns: &[Vec<f32>; 3], c: usize| Lanes::load(simd, &columns[c][at..at + Lanes::<S>::LEN]);
        let direction = [0, 1, 2].map(|c| load(&sky.directions, c));
        let cosine = dot(direction, axis);
        let value = (sharpness * (cosine - cosine.one()).min(zero)).decay() * dot(direction, normal).relu();
        let value = least.select_lt(cosine, value, zero);
        value.store(&mut weights[at..at + Lanes::<S>::LEN]);
        for (c, sum) in light.iter_mut().enumerate() {
            *sum += load(&sky.radiance, c) * value;
        }
    }
    Vec3::from_array(light.map(Lanes::sum))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{shape::test_support::Wall, visibility::texel_visibility::cluster};
    use lobelia_sg::{fibonacci::fibonacci_axes, sg::Lobe, shading::LobeColumns};
    use std::f32::consts::LN_2;

    static WALL: Wall = Wall(Vec3::X);

    #[test]
    fn points_of_a_pixel_share_what_is_alike() {
        let point = |x: f32, tilt: f32, roughness: f32| SeenPoint {
            position: Vec3::X * x,
            normal: Vec3::new(tilt.sin(), 0.0, tilt.cos()),
            geometric_normal: Vec3::Z,
            to_viewer: Vec3::Z,
            roughness,
        };
        let first = point(0.0, 0.0, 0.3);
        let of = |others: &[(Option<SeenPoint>, u32)]| {
            let all: Vec<_> = [(Some(first), 7)].iter().chain(others).copied().collect();
            let pixel = |i: usize| all[i].0.map(|_| PixelOf { pixel: all[i].1, ..PixelOf::default() });
            first_of_alike(all.len(), pixel, |i| all[i].0.unwrap(), 0.01)
        };
        // λ/(4 n·v) = 62 at R = 0.3: an eighth of the width is 0.9°.
        let (alike, turned) = (Some(point(0.009, 0.015, 0.3)), Some(point(0.0, 0.017, 0.3)));
        assert_eq!(of(&[(alike, 7), (None, 7), (turned, 7), (alike, 7)]), [0, 0, 2, 3, 0]);
        assert_eq!(of(&[(Some(point(0.011, 0.0, 0.3)), 7), (Some(point(0.0, 0.0, 0.32)), 7)]), [0, 1, 2]);
        assert_eq!(of(&[(alike, 8), (alike, 8), (alike, 7)]), [0, 1, 1, 3]);
    }

    fn sky(lobes: &[([f32; 3], f32, f32)]) -> Sky {
        let lobe = |(axis, sharpness, radiance): &([f32; 3], f32, f32)| Lobe {
            axis: *axis,
            sharpness: *sharpness,
            amplitude: [*radiance; 3],
        };
        let columns = LobeColumns::from_lobes(lobes.iter().map(lobe));
        Sky::new(&fibonacci_axes(64), &columns, Mat3::IDENTITY)
    }

    /// The part of a narrow lobe around `axis` that arrives over a floor, whose flat triangle has
    /// this normal, beside the wall.
    fn part_over(geometric_normal: Vec3, rays: LobeRays, axis: Vec3, wall: Mirror, sky: &Sky) -> Vec3 {
        let mut visibility = TexelVisibility::default();
        visibility.rows = vec![0];
        let bounce = Bounce { mirrors: vec![wall], ..Bounce::default() };
        let around = Surroundings { visibility: &visibility, sky, bounce: &bounce, rays: Some(rays) };
        let (position, normal) = (Vec3::ZERO, Vec3::Y);
        let point = SeenPoint { position, normal, geometric_normal, to_viewer: Vec3::Y, roughness: 0.1 };
        around.part_by_rays(rays, &point, axis.normalize(), 2000.0)
    }

    #[test]
    fn a_lobe_that_meets_a_wall_has_its_light() {
        let sky = sky(&[([0.0, 1.0, 0.0], 0.0, 2.0)]);
        let red = Mirror { diffuse: Vec3::new(1.0, 0.5, 0.0), ..Mirror::default() };
        for rays in [false, true].map(|of_step| LobeRays::new(&WALL, of_step)) {
            let part = |axis: Vec3| part_over(Vec3::Y, rays, axis, red, &sky);
            assert!(part(Vec3::new(1.0, 1.0, 0.0)).abs_diff_eq(Vec3::new(0.5, 0.25, 0.0), 1e-3));
            assert!(part(Vec3::new(-1.0, 1.0, 0.0)).abs_diff_eq(Vec3::ONE, 1e-6));
            // Half of the lobe meets it.
            assert!(part(Vec3::Y).abs_diff_eq(Vec3::new(0.75, 0.625, 0.5), 0.04));
        }
    }

    #[test]
    fn a_white_mirror_shows_the_sky_before_it() {
        let white = Mirror { albedo: Vec3::ONE, sharpness: 5000.0, ..Mirror::default() };
        let even = sky(&[([0.0, 1.0, 0.0], 0.0, 2.0)]);
        let part =
            |axis: Vec3, wall, sky: &Sky| part_over(Vec3::Y, LobeRays::new(&WALL, false), axis, wall, sky);
        assert!(part(Vec3::new(1.0, 1.0, 0.0), white, &even).abs_diff_eq(Vec3::ONE, 1e-3));
        // The lamp in the mirror is behind the point; toward the wall it is dark.
        let lamp = |dark: f32| sky(&[([-1.0, 0.0, 0.0], 30.0, 1.0), ([1.0, 0.0, 0.0], 0.5, dark)]);
        let gray = Mirror { albedo: Vec3::splat(0.2), ..white };
        let axis = Vec3::new(1.0, 0.1, 0.0).normalize();
        // A fifth of the lamp, 0.1 beside its axis, over the sky that the wall hides.
        let bright = part(axis, gray, &lamp(0.05)).x;
        let expected = 0.2 * (30.0 * (axis.x - 1.0)).exp() / (0.05 * (0.5 * (axis.x - 1.0)).exp());
        assert!((bright / expected - 1.0).abs() < 0.04, "{bright} {expected}");
        assert_eq!(part(axis, gray, &lamp(0.01)), Vec3::splat(MOST_MIRRORED));
    }

    #[test]
    fn rays_that_enter_the_flat_triangle_see_the_sky() {
        let sky = sky(&[([0.0, 1.0, 0.0], 0.0, 2.0)]);
        let (rays, axis) = (LobeRays::new(&WALL, false), Vec3::new(1.0, 0.1, 0.0));
        let part = |geometric: Vec3| part_over(geometric, rays, axis, Mirror::default(), &sky);
        assert_eq!(part(Vec3::Y), Vec3::ZERO);
        assert_eq!(part(Vec3::new(-0.5, 0.8, 0.0)), Vec3::ONE);
    }

    #[test]
    fn light_that_is_convolved_keeps_its_power() {
        let sky = sky(&[([0.6, 0.0, 0.8], 120.0, 3.0), ([0.0, -1.0, 0.0], 8.0, 0.5)]);
        let power = 2.0 * std::f32::consts::PI * (3.0 / 120.0 + 0.5 / 8.0);
        let directions = fibonacci_axes(20_000);
        for sharpness in [60.0, 500.0] {
            let sum: f32 = directions.iter().map(|d| sky.toward(*d, sharpness).x).sum();
            let found = sum * 4.0 * std::f32::consts::PI / directions.len() as f32;
            assert!((found / power - 1.0).abs() < 0.01, "{sharpness}: {found} {power}");
        }
    }

    #[test]
    fn directions_have_the_density_of_the_lobe() {
        for (sharpness, places) in [(100.0, &SPIRAL[..]), (4000.0, &SPIRAL[..]), (100.0, &SPIRAL_OF_STEP[..])]
        {
            let all: Vec<Vec3> = places.iter().map(|place| direction_in_lobe(*place, sharpness)).collect();
            let mean = all.iter().sum::<Vec3>() / all.len() as f32;
            // The mean of 1 − z is 1/λ.
            assert!(((1.0 - mean.z) * sharpness - 1.0).abs() < 1e-2, "{mean}");
            assert!(mean.truncate().length() < 1e-3 / sharpness.sqrt(), "{mean}");
            // Half of the power is beyond cos θ = 1 − ln 2/λ.
            let near = all.iter().filter(|d| (1.0 - d.z) * sharpness < LN_2).count();
            assert_eq!(2 * near, all.len());
            assert!(all.iter().all(|d| d.is_normalized()));
        }
    }

    #[test]
    fn all_directions_near_an_axis_are_found_and_no_others() {
        for count in [64, 320, 512] {
            let mut directions = fibonacci_axes(count);
            cluster(&mut directions);
            let sky = Sky::new(&directions, &LobeColumns::from_lobes(std::iter::empty()), Mat3::IDENTITY);
            for (i, axis) in fibonacci_axes(60).into_iter().enumerate() {
                let least = [0.99, 0.9, 0.3, -0.4, -0.98, -1.5][i % 6];
                let mut near = [0; MAX_DIRECTIONS / 64];
                lobelia_sg::dispatch!(simd => directions_near(simd, &sky, axis, least, &mut near));
                for (d, direction) in directions.iter().enumerate() {
                    let cosine = direction.dot(axis);
                    let is_near = near[d / 64] >> (d % 64) & 1 == 1;
                    assert!((cosine - least).abs() < 1e-6 || is_near == (cosine > least), "{cosine} {least}");
                }
                assert!(near[count / 64..].iter().all(|word| *word == 0));
            }
        }
    }
}
