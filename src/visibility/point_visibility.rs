//! The visibility of a point from the rows around it: the part of the specular light that arrives, and interreflected light.

use crate::math::brdf::ndf_sharpness;
use crate::math::color::luminance;
use crate::math::lanes::Lanes;
use crate::math::real::{Real, dot};
use crate::math::shading::PointVisibility;
use crate::visibility::mirrored::{LEAST_SHARPNESS, LobeRays, Mirrored, SeenPoint};
use crate::visibility::occlusion::{Bounce, Cones, MOST_MIRRORED, Sky, sharpness_of_lobe, widened};
use crate::visibility::texel_visibility::{MAX_DIRECTIONS, TOGETHER, TexelVisibility};
use fearless_simd::{Level, Simd, dispatch};
use glam::Vec3;

/// Directions contribute to specular light where the BRDF lobe is above e to the power of minus this.
const MIRROR_REACH: f32 = 4.0;

/// Up to four rows of texels and their weights, which sum to one.
pub(crate) type Blend = [(usize, f32); 4];

/// What is around a point.
#[derive(Clone, Copy)]
pub(crate) struct Surroundings<'a> {
    /// What of the light is hidden.
    pub visibility: &'a TexelVisibility,
    /// The light.
    pub sky: &'a Sky,
    /// The light that the surface sends.
    pub bounce: &'a Bounce,
    /// Rays, if they are to find what narrow lobes meet.
    pub rays: Option<LobeRays<'a>>,
}

impl Surroundings<'_> {
    /// The visibility of a point from the rows around it.
    ///
    /// Specular light is scaled by Σ_d B(d)·L(d) over Σ_d B(d)·sky(d), where B is the lobe of the BRDF around the mirror direction
    /// (sharpness L/(4 n·v), Wang et al. 2009) times the cosine, and L the incident radiance from d: that of the sky, or of what occludes it. The
    /// directions d are those of the rows, or for a narrow lobe some within it ([`Mirrored`]).
    pub fn of(&self, blend: &Blend, point: &SeenPoint) -> PointVisibility {
        let indirect: Vec3 = blend.iter().map(|(row, weight)| self.bounce.indirect[*row] * *weight).sum();
        let part = self.specular_part(blend, point).unwrap_or(Vec3::ONE);
        PointVisibility { specular: part.into(), indirect: indirect.into() }
    }

    /// The part of the specular light; `None` if all of it arrives.
    fn specular_part(&self, blend: &Blend, point: &SeenPoint) -> Option<Vec3> {
        let Self { visibility, sky, bounce, rays } = *self;
        let normal = point.normal;
        let open = blend.iter().all(|(row, weight)| *weight == 0.0 || visibility.sees_all(*row));
        let up = normal.dot(point.to_viewer);
        if open || up <= 0.0 {
            return None;
        }
        let axis = 2.0 * up * normal - point.to_viewer;
        let narrow = sharpness_of_lobe(ndf_sharpness(point.roughness), up);
        let sharpness = widened(narrow, visibility.directions.len() as f32 / 2.0);
        let least = 1.0 - MIRROR_REACH / sharpness;
        let mut near = [0; MAX_DIRECTIONS / 64];
        dispatch!(Level::new(), simd => directions_near(simd, sky, axis, least, &mut near));
        let rows = blend.iter().filter(|(_, part)| *part > 0.0);
        if !rows.clone().any(|(row, _)| visibility.hides_any(*row, &near)) {
            return None;
        }
        if let Some(rays) = rays.filter(|_| narrow > LEAST_SHARPNESS) {
            let mirrored = Mirrored { rays, visibility, sky, bounce };
            return Some(mirrored.part(point, axis, narrow));
        }
        let lobe = MirroredLobe { axis, sharpness, least, normal };
        let mut weights = [0.0; MAX_DIRECTIONS];
        let unhidden =
            dispatch!(Level::new(), simd => weigh_directions(simd, sky, &lobe, &near, &mut weights));
        let arriving = rows.fold(unhidden, |arriving, (row, part)| {
            let instead = visibility
                .hidden_among(*row, &near)
                .map(|(d, hider)| (bounce.sent_from(hider) - sky.radiance(d)) * weights[d]);
            arriving + instead.sum::<Vec3>() * *part
        });
        let floor = Vec3::splat(1e-6 * luminance(unhidden).max(1e-20));
        Some((arriving / unhidden.max(floor)).clamp(Vec3::ZERO, Vec3::splat(MOST_MIRRORED)))
    }
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

/// A bit for each cone of a vector from the `first` on that has a place whose cosine to `axis` may be above `least`.
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

/// The lobe of the BRDF around the mirrored view, where its cosine to a direction is above `least`, times the cosine with `normal`.
struct MirroredLobe {
    axis: Vec3,
    sharpness: f32,
    least: f32,
    normal: Vec3,
}

/// The lobe's value at each direction, in groups of lanes of which a bit of `near` is set, and the light of the whole sky weighted by it.
#[inline(always)]
fn weigh_directions<S: Simd>(
    simd: S,
    sky: &Sky,
    lobe: &MirroredLobe,
    near: &[u64],
    weights: &mut [f32; MAX_DIRECTIONS],
) -> Vec3 {
    let [axis, normal] = [lobe.axis, lobe.normal].map(|v| v.to_array().map(|c| Lanes::splat(simd, c)));
    let [least, sharpness, zero] = [lobe.least, lobe.sharpness, 0.0].map(|c| Lanes::splat(simd, c));
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
    use crate::math::fibonacci::fibonacci_axes;
    use crate::math::shading::LobeColumns;
    use crate::visibility::texel_visibility::clustered;
    use glam::Mat3;

    #[test]
    fn all_directions_near_an_axis_are_found_and_no_others() {
        let (few, some) = (fibonacci_axes(64), clustered(fibonacci_axes(320)));
        for directions in [few, some, clustered(fibonacci_axes(512))] {
            let count = directions.len();
            let sky = Sky::new(&directions, &LobeColumns::from_lobes(std::iter::empty()), Mat3::IDENTITY);
            for (i, axis) in fibonacci_axes(60).into_iter().enumerate() {
                let least = [0.99, 0.9, 0.3, -0.4, -0.98, -1.5][i % 6];
                let mut near = [0; MAX_DIRECTIONS / 64];
                dispatch!(Level::new(), simd => directions_near(simd, &sky, axis, least, &mut near));
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
