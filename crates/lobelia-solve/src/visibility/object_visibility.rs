//! [`ObjectVisibility`]: the occlusion of an object by itself, and the light on it at the last update.

use crate::visibility::occlusion::{Behind, Bounce, Mirror, Reflectance, Sky, light_chunk, light_rows};
use crate::visibility::point_visibility::{
    Blend, LobeRays, SeenPoint, Surroundings, first_of_alike, is_open,
};
use crate::visibility::texel_visibility::TexelVisibility;
use bevy_ecs::prelude::{Entity, Resource};
use glam::{Mat3, Vec3};
use lobelia_geometry::{mesh::Surface, parallel};
use lobelia_sg::fibonacci::fibonacci_axes;
use lobelia_sg::shading::{LobeColumns, LobeVisibility, PointVisibility};
use lobelia_world::light::placement::LightGroup;
use lobelia_world::sample::{pixel::PixelOf, point::SurfacePoint};
use std::{any::TypeId, collections::BTreeMap, sync::Arc};

/// Angle below which two rotations count as one: 2°.
const SAME_TURN: f32 = 0.035;
/// Most rotations of a light that turns with the views that are told apart.
const MOST_SKIES: usize = 96;
/// Rotations of which the interreflection is the mean, if there are many.
const MEAN_SKIES: usize = 6;
/// Most rotations that each have shadows and interreflection of their own: the placements of an
/// object that is turned over.
const FEW_SKIES: usize = 4;

/// Most rows of shadows, but for squares of texels across borders of charts.
const MOST_ROWS: usize = 1 << 18;

/// Distance of two points that may have what one of them mirrors, in radii of the object.
const NEAR: f32 = 0.01;
/// Points that a thread takes at a time.
const TASK: usize = 256;

/// Settings of shadows and interreflection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VisibilitySettings {
    /// Directions over the sphere per texel, a multiple of 64.
    pub directions: u32,
    /// Interreflections between parts of the object; 0 for shadows only.
    pub bounces: u32,
    /// Steps of a fit between two updates.
    pub refresh_every: u32,
}

impl VisibilitySettings {
    /// Rows of shadows for so many covered texels: each its own, or squares of them.
    pub fn rows(&self, texels: usize) -> usize {
        texels.min(MOST_ROWS)
    }

    /// Estimated bytes for so many covered texels under so many skies of each of so many lights,
    /// with 128 lobes and a quarter of the directions above a row occluded.
    pub fn bytes(&self, texels: usize, skies: usize, lights: usize) -> usize {
        let directions = self.directions as usize;
        let light = 128 + 48 + size_of::<Mirror>();
        let lit = light * lights * if skies > FEW_SKIES { 1 } else { skies };
        self.rows(texels) * (directions / 8 + directions / 2 + lit) + texels * size_of::<u32>()
    }
}

impl Default for VisibilitySettings {
    fn default() -> Self {
        Self { directions: 512, bounces: 2, refresh_every: 50 }
    }
}

/// Occlusion of the object by itself, and the light on it at the last update.
#[derive(Resource, Default)]
pub struct ObjectVisibility {
    settings: VisibilitySettings,
    texels: Arc<TexelVisibility>,
    /// The inputs of the last update.
    pub(super) made: Option<Made>,
    /// The light as the object sees it: one, or several of a light that turns with the views.
    skies: Vec<Sky>,
    /// The sky of each view, if there are several.
    sky_of_view: Vec<usize>,
    /// Interreflected light under each sky, or one mean of many skies.
    bounces: Vec<Bounce>,
    /// The part of each lobe that reaches each row, for each sky, if there are few.
    parts: Vec<Vec<u8>>,
    pub(super) stride: usize,
    /// The group of photographs whose light this is, and the same under the lights of others, which
    /// take turns in a fit.
    group: LightGroup,
    others: BTreeMap<LightGroup, Self>,
}

/// The inputs of shadows and interreflection: the light's lobes and the base materials, by entity,
/// the rotation that the light of a picture has had, and the type of the material.
pub(super) type Made = (Vec<Entity>, Mat3, TypeId);

impl ObjectVisibility {
    /// Traces a surface.
    pub fn new(surface: &Surface, settings: VisibilitySettings) -> Self {
        let directions = fibonacci_axes(settings.directions.next_multiple_of(64).max(64) as usize);
        let texels = TexelVisibility::trace(surface.atlas(), surface, directions, MOST_ROWS);
        Self { settings, texels: Arc::new(texels), ..Self::default() }
    }

    /// The traced occlusion without the light of the last update: for another world.
    pub fn unlit(&self) -> Self {
        Self { settings: self.settings, texels: self.texels.clone(), ..Self::default() }
    }

    /// Takes up the shadows and interreflection under the light of a group as they were in its turn
    /// before.
    pub(crate) fn turn_to(&mut self, group: LightGroup) {
        if group != self.group {
            let mut others = std::mem::take(&mut self.others);
            let next = others.remove(&group).unwrap_or_else(|| Self { group, ..self.unlit() });
            let before = std::mem::replace(self, next);
            others.insert(before.group, before);
            self.others = others;
        }
    }

    /// Forgets shadows and interreflection under all lights but the scene's own.
    pub(crate) fn forget_turns(&mut self) {
        self.turn_to(LightGroup::OWN);
        self.others.clear();
    }

    /// Whether no texel occludes another.
    pub fn sees_all(&self) -> bool {
        (0..self.texels.row_count()).all(|row| self.texels.sees_all(row))
    }

    /// Which directions are hidden from each texel.
    pub fn texels(&self) -> &TexelVisibility {
        &self.texels
    }

    /// The settings.
    pub fn settings(&self) -> VisibilitySettings {
        self.settings
    }

    /// Memory in bytes, for at least 128 lobes.
    pub fn bytes(&self) -> usize {
        let per_row = self.stride.max(128) + 2 * size_of::<Vec3>() + size_of::<Mirror>();
        self.texels.bytes() + self.texels.row_count() * per_row * self.parts.len().max(1)
    }

    /// Computes shadows and interreflection for this light and this reflectance (diffuse and
    /// specular, by texel).
    ///
    /// `turns` are the rotations of the views into the frame of a light that turns with them, by
    /// index; empty if it does not. Shadows are those of each view, interreflection is the mean of
    /// some views if more than four differ.
    pub fn refresh(
        &mut self,
        lobes: &LobeColumns,
        turns: &[Option<Mat3>],
        reflectance: &(dyn Fn(u32) -> Reflectance + Sync),
    ) {
        // What has changed for one light has changed for all.
        self.others.values_mut().for_each(|other| other.made = None);
        self.made = None;
        let (distinct, of_view) = distinct_turns(turns);
        self.sky_of_view = of_view;
        let sky = |turn: &Mat3| Sky::new(&self.texels.directions, lobes, turn.transpose());
        self.skies = parallel::map_slice(&distinct, 1, sky);
        self.stride = lobes.stride();
        let of_skies = self.direct();
        let bounces = self.settings.bounces;
        let bounce = |direct: &Vec<Vec3>| Bounce::new(&self.texels, direct, reflectance, bounces);
        self.bounces = of_skies.iter().map(bounce).collect();
    }

    /// Irradiance of each row under each sky, and the parts of the lobes that reach it; of many
    /// skies the mean of up to [`MEAN_SKIES`], without parts.
    fn direct(&mut self) -> Vec<Vec<Vec3>> {
        let Self { skies, texels, parts, .. } = self;
        if skies.len() <= FEW_SKIES {
            parts.resize(skies.len(), Vec::new());
            let lit = |(sky, parts)| light_rows(texels, sky, parts);
            return skies.iter().zip(parts).map(lit).collect();
        }
        parts.clear();
        let (mut mean, mut unused) = (vec![Vec3::ZERO; texels.row_count()], Vec::new());
        let every = skies.len().div_ceil(MEAN_SKIES);
        let some: Vec<&Sky> = skies.iter().step_by(every).collect();
        for sky in &some {
            let direct = light_rows(texels, sky, &mut unused);
            mean.iter_mut().zip(&direct).for_each(|(mean, direct)| *mean += *direct / some.len() as f32);
        }
        vec![mean]
    }

    /// Computes the visibility of points, given the direction to the viewer, the pixel and the
    /// roughness of each by index; overwrites `rows` and `seen`. With `rays`, these find what
    /// narrow lobes mirror of the object, and of the points of one pixel, one after another, those
    /// that are alike have what the first of them mirrors.
    pub fn window(
        &self,
        points: &[SurfacePoint],
        viewer: impl Fn(usize) -> (Vec3, PixelOf) + Sync,
        roughness: impl Fn(usize) -> f32 + Sync,
        rays: Option<LobeRays>,
        rows: &mut WindowVisibility,
        seen: &mut [PointVisibility],
    ) {
        let at = |i: usize| {
            let SurfacePoint { position, normal, geometric_normal, .. } = points[i];
            SeenPoint { position, normal, geometric_normal, to_viewer: viewer(i).0, roughness: roughness(i) }
        };
        let pixel_of = |i: usize| points[i].is_hit().then(|| viewer(i).1);
        let firsts = rays.map_or_else(
            || (0..points.len()).collect(),
            |rays| first_of_alike(points.len(), pixel_of, at, NEAR * rays.surface.radius()),
        );
        rows.stride = self.stride;
        rows.rows.resize(points.len() * self.stride, 255);
        let fill = |i: usize, parts: &mut [u8], seen: &mut PointVisibility, behind: &mut Behind| {
            let point = &points[i];
            *seen = PointVisibility::OPEN;
            parts.fill(255);
            let Some(blend) = self.blend(point).filter(|_| point.is_hit()) else { return };
            let view = viewer(i).1.view.0 as usize;
            let number = self.sky_of_view.get(view).copied().unwrap_or(0);
            let sky = &self.skies[number];
            match self.parts.get(number) {
                // All of each lobe arrives.
                _ if is_open(&self.texels, &blend) => {}
                Some(of_rows) => {
                    let rows = blend.map(|(row, _)| &of_rows[row * self.stride..][..self.stride]);
                    let weights = mix_weights(&blend);
                    lobelia_sg::dispatch!(_simd => mix_parts(rows, weights, parts));
                }
                None => {
                    let nearest = blend.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(row, _)| *row);
                    let rows = nearest..nearest + 1;
                    light_chunk(&self.texels, sky, rows, behind, (parts, &mut [Vec3::ZERO]));
                }
            }
            if firsts[i] != i {
                return;
            }
            let bounce = &self.bounces[number.min(self.bounces.len() - 1)];
            let around = Surroundings { visibility: &self.texels, sky, bounce, rays };
            *seen = around.of(&blend, &at(i));
        };
        let stride = self.stride.max(1);
        let tasks = rows.rows.chunks_mut(TASK * stride).zip(seen.chunks_mut(TASK)).enumerate();
        parallel::for_each(tasks, |(task, (parts, seen))| {
            let mut behind = Behind::default();
            let outputs = (task * TASK..).zip(parts.chunks_mut(stride).zip(seen));
            outputs.for_each(|(i, (parts, seen))| fill(i, parts, seen, &mut behind));
        });
        (0..points.len()).filter(|i| firsts[*i] != *i).for_each(|i| seen[i] = seen[firsts[i]]);
    }

    /// The rows that are interpolated at a point.
    fn blend(&self, point: &SurfacePoint) -> Option<Blend> {
        let mut blend = [(0, 0.0); 4];
        let mut total = 0.0;
        for (i, slot) in blend.iter_mut().enumerate() {
            let row = self.texels.rows[point.texels.indices[i] as usize];
            if row != TexelVisibility::NONE {
                *slot = (row as usize, point.texels.weights[i]);
                total += slot.1;
            }
        }
        blend.iter_mut().for_each(|(_, weight)| *weight /= total);
        (total > 0.0).then_some(blend)
    }
}

/// The weights of four rows in units of 1/256, so that 255 in all of them stays 255; the row of
/// most weight has what rounding leaves.
fn mix_weights(blend: &Blend) -> [u16; 4] {
    let mut weights = blend.map(|(_, weight)| (weight * 256.0) as u16);
    let most = (0..4).fold(0, |most, k| if weights[k] > weights[most] { k } else { most });
    weights[most] += 256 - weights.iter().sum::<u16>();
    weights
}

/// The mean of four rows, with weights that sum to 256.
#[inline(always)]
fn mix_parts([a, b, c, d]: [&[u8]; 4], weights: [u16; 4], out: &mut [u8]) {
    for ((((out, a), b), c), d) in out.iter_mut().zip(a).zip(b).zip(c).zip(d) {
        let [a, b, c, d] = [a, b, c, d].map(|part| u16::from(*part));
        *out = ((a * weights[0] + b * weights[1] + c * weights[2] + d * weights[3]) >> 8) as u8;
    }
}

/// The different ones among the views' rotations, and which of them each is or is nearest to. Those
/// that differ by less than [`SAME_TURN`] count as one, or by less than a multiple of it that
/// leaves at most [`MOST_SKIES`]. The identity alone if there are none.
fn distinct_turns(turns: &[Option<Mat3>]) -> (Vec<Mat3>, Vec<usize>) {
    let cosine = |a: &Mat3, b: &Mat3| {
        let trace = a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis);
        0.5 * (trace - 1.0)
    };
    let (mut distinct, mut apart) = (Vec::new(), SAME_TURN);
    loop {
        for turn in turns.iter().flatten() {
            if distinct.iter().all(|other| cosine(other, turn) < apart.min(3.0).cos()) {
                distinct.push(*turn);
            }
        }
        if distinct.len() <= MOST_SKIES {
            break;
        }
        distinct.clear();
        apart *= 1.5;
    }
    let nearest = |turn: &Option<Mat3>| {
        let Some(turn) = turn else { return 0 };
        let by_angle =
            |a: &usize, b: &usize| cosine(&distinct[*a], turn).total_cmp(&cosine(&distinct[*b], turn));
        (0..distinct.len()).max_by(by_angle).unwrap_or(0)
    };
    let of_view = turns.iter().map(nearest).collect();
    (if distinct.is_empty() { vec![Mat3::IDENTITY] } else { distinct }, of_view)
}

/// The visibility of the lobes at the points of the current window.
#[derive(Resource, Default)]
pub struct WindowVisibility {
    rows: Vec<u8>,
    /// Values of a point; 0 while nothing is known of this window.
    pub(super) stride: usize,
}

impl WindowVisibility {
    /// The visibility as the kernels read it, if there is any; `points` are those of the window.
    pub fn view<'a>(&'a self, points: &'a [PointVisibility]) -> Option<LobeVisibility<'a>> {
        let there = self.stride > 0 && self.rows.len() == points.len() * self.stride;
        there.then_some(LobeVisibility { lobes: &self.rows, points })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_mixed_by_their_weights() {
        let rows: [Vec<u8>; 4] = std::array::from_fn(|k| (0..37).map(|i| (i * 7 + k * 60) as u8).collect());
        let weights = [120, 80, 56, 0];
        let mut mixed = [0; 37];
        lobelia_sg::dispatch!(_simd => mix_parts(rows.each_ref().map(Vec::as_slice), weights, &mut mixed));
        for (i, mixed) in mixed.into_iter().enumerate() {
            let mean: u32 = (0..4).map(|k| u32::from(rows[k][i]) * u32::from(weights[k])).sum();
            assert_eq!(u32::from(mixed), mean / 256);
        }
        // A row of no weight does not count, also not for what rounding leaves.
        assert_eq!(mix_weights(&[(0, 0.0), (7, 0.299), (8, 0.3), (9, 0.401)]), [0, 76, 76, 104]);
        let full = [&[255u8; 9][..]; 4];
        let mut open = [0; 9];
        mix_parts(full, [253, 1, 1, 1], &mut open);
        assert_eq!(open, [255; 9]);
    }

    #[test]
    fn lights_that_take_turns_keep_their_own_shadows() {
        let mut object = ObjectVisibility { stride: 16, ..ObjectVisibility::default() };
        let other = LightGroup(1);
        object.turn_to(other);
        assert_eq!(object.stride, 0);
        object.stride = 32;
        let mut stride_of = |group: LightGroup| {
            object.turn_to(group);
            object.stride
        };
        assert_eq!([LightGroup::OWN, other, other].map(&mut stride_of), [16, 32, 32]);
        object.forget_turns();
        assert_eq!(object.stride, 16);
        object.turn_to(other);
        assert_eq!(object.stride, 0);
    }

    #[test]
    fn turns_that_hardly_differ_share_a_sky() {
        let about = |angles: &[f32]| -> Vec<Option<Mat3>> {
            angles.iter().map(|angle| Some(Mat3::from_rotation_y(*angle))).collect()
        };
        let mut turns = about(&[0.0, 0.01, 1.0, 2.0, 1.01]);
        turns.push(None);
        let (distinct, of_view) = distinct_turns(&turns);
        assert_eq!((distinct.len(), of_view), (3, vec![0, 0, 1, 2, 1, 0]));
        let (distinct, of_view) = distinct_turns(&[]);
        assert_eq!((distinct, of_view), (vec![Mat3::IDENTITY], Vec::new()));
        // Of many, each has one that is near, whatever their order.
        let angles: Vec<f32> = (0..300).map(|i| i as f32 * 0.02).collect();
        let (distinct, of_view) = distinct_turns(&about(&angles));
        assert!(distinct.len() <= MOST_SKIES && distinct.len() > MOST_SKIES / 3);
        for (angle, sky) in angles.iter().zip(&of_view) {
            let apart = Mat3::from_rotation_y(*angle) * distinct[*sky].transpose();
            assert!(apart.x_axis.x > 0.99, "{angle}");
        }
    }
}
