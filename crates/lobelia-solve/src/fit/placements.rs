//! Rotations of the object's [placements](lobelia_world::light::placement) as unknowns: those that
//! were found move with the rest of a fit.
//!
//! A small rotation of the object in the room is one of all normals and views of its placement in
//! the light's frame. Derivatives of the radiance are central differences, with shadows as they
//! are; those are found anew later. Residuals have weights that minimize the sum of absolute
//! differences.
//!
//! Before that they are found from the photographs. The light is solved for from the photographs of
//! the first placement, or is there already. A rotation of another placement turns the object under
//! it, and the error is what no albedo explains of the photographs of both: a place that both see
//! has one albedo. Rotations are tried all over their group (super-Fibonacci spirals; Alexa 2022,
//! equation 7), then the best ones are improved by ever smaller steps, and once more under the
//! light that the photographs of all placements have together.

use crate::fit::components::{StepRates, Unknowns};
use crate::fit::initialization::{Initialization, Known, extent, least_rough, with_initialization};
use crate::shade::systems::{kernel_specular, shade_materials, turned};
use crate::{fit::exposure::Exposures, fit::loss::radiance, visibility::WindowVisibility};
use bevy_ecs::prelude::{Query, Res, ResMut, Resource, With, World};
use glam::{DMat3, DVec3, Mat3, Quat, UVec3, Vec3};
use lobelia_geometry::view::{ByView, Camera, Photograph, Placement, ViewIndex};
use lobelia_geometry::{Result, error::stop::check_interrupted};
use lobelia_sg::shading::{
    ClosedForm, Layers, Lighting, LobeColumns, PointVisibility, ShadePoint, SpecularValue,
};
use lobelia_world::light::LightLobe;
use lobelia_world::light::light_frame::{LightFrame, OwnLightFrame, turning_axis};
use lobelia_world::light::lights::{IncidentLight, own_lobes};
use lobelia_world::light::placement::{
    LightGroup, PlacedFrame, PlacementTurn, Placements, TurnSource, light_from_world,
};
use lobelia_world::material::{material_source::BaseMaterials, recovered_albedo};
use lobelia_world::pipeline::{FitForm, SystemResult};
use lobelia_world::sample::pixel::{Observed, PixelOf};
use lobelia_world::sample::{Observation, Samples, point::PointBlend};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use tracing::info_span;

/// Steps under one light between two windows that are summed.
const SUM_EVERY: u32 = 3;
/// Steps between two moves.
const TURN_EVERY: u32 = 25;
/// Half the distance of central differences, radians.
const DIFFERENCE: f32 = 0.01;
/// Longest rotation at a time, radians.
const LONGEST: f64 = 0.03;
/// Weight of where it is, in residuals of typical size per radian of typical derivative.
const PRIOR: f64 = 10.0;

/// Normal equations of a rotation vector, in radians about the axes of the room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TurnEquations {
    /// Σ w Jᵀ J.
    matrix: DMat3,
    /// Σ w Jᵀ r.
    right: DVec3,
    /// Number of residuals.
    count: u32,
}

impl TurnEquations {
    /// Adds a residual (prediction less observation) with its derivatives.
    fn add(&mut self, jacobian: DVec3, residual: f64, weight: f64) {
        let weighted = weight * jacobian;
        self.matrix += DMat3::from_cols(weighted * jacobian.x, weighted * jacobian.y, weighted * jacobian.z);
        self.right += weighted * residual;
        self.count += 1;
    }

    /// The rotation vector that reduces the residuals most, not longer than [`LONGEST`]; zero if
    /// they say nothing.
    fn step(&self) -> DVec3 {
        let trace = self.matrix.x_axis.x + self.matrix.y_axis.y + self.matrix.z_axis.z;
        let prior = PRIOR * trace / (3.0 * f64::from(self.count.max(1)));
        let matrix = self.matrix + DMat3::from_diagonal(DVec3::splat(prior));
        if trace <= 0.0 || matrix.determinant().abs() < f64::MIN_POSITIVE {
            return DVec3::ZERO;
        }
        let step = -(matrix.inverse() * self.right);
        if step.is_finite() { step.clamp_length_max(LONGEST) } else { DVec3::ZERO }
    }
}

/// The normal equations of each placement, by number.
#[derive(Resource, Clone, Debug, Default, Serialize, Deserialize)]
pub struct TurnSums(Vec<TurnEquations>);

/// Run condition: whether a fit improves rotations of placements, those that it has found of an
/// object in a light that stands still.
pub fn placements_turn(frame: Option<Res<OwnLightFrame>>, placements: Option<Res<Placements>>) -> bool {
    let is_still = frame.is_none_or(|frame| frame.0 == LightFrame::World);
    is_still && placements.is_some_and(|of| of.0.iter().any(|turn| turn.source == TurnSource::Found))
}

/// Run condition: whether this step adds to the [`TurnSums`].
pub fn turns_are_summed(
    rates: Res<StepRates>,
    frame: Option<Res<OwnLightFrame>>,
    placements: Option<Res<Placements>>,
) -> bool {
    rates.visit.is_multiple_of(SUM_EVERY) && placements_turn(frame, placements)
}

/// The columns that shading and its comparison read.
type TurnColumns = (
    &'static ShadePoint,
    &'static PointBlend,
    &'static PointVisibility,
    (&'static Layers, &'static Observed),
    &'static PixelOf,
);

/// Gradient: adds the residuals of the window to the normal equations of its placements.
pub fn sum_turns(
    (light, materials, exposures): (Res<IncidentLight>, Res<BaseMaterials>, Res<Exposures>),
    (form, visibility): (Res<FitForm>, Option<Res<WindowVisibility>>),
    views: Query<(&ViewIndex, &Placement), With<Photograph>>,
    mut sums: ResMut<TurnSums>,
    samples: Samples<TurnColumns>,
) -> SystemResult {
    let (points, blends, seen, (shaded, observed), pixels) = samples.columns()?;
    let visibility = visibility.as_ref().and_then(|visibility| visibility.view(&seen));
    let lighting = Lighting { lobes: &light.lobes, visibility };
    let shade = |points: &[ShadePoint]| {
        let mut shaded = vec![Layers::default(); points.len()];
        shade_materials(form.0, points, &blends, &materials, lighting, &mut shaded);
        shaded
    };
    let derivatives = derivatives(&points, &shade);
    let placements: ByView<Placement> = views.iter().map(|(view, of)| (*view, *of)).collect();
    let residual =
        |i: usize| observed[i].differences(exposures.factor(pixels[i].view) * radiance(&shaded[i]));
    let residuals: Vec<Vec3> = (0..points.len()).map(residual).collect();
    let sizes = residuals.iter().map(|residual| f64::from(residual.abs().element_sum()));
    let noise = ((sizes.sum::<f64>() / (3 * residuals.len()).max(1) as f64) as f32).max(1e-6);
    for (i, residual) in residuals.iter().enumerate() {
        let number = placements.of(pixels[i].view)?.0 as usize;
        let count = sums.0.len().max(number + 1);
        sums.0.resize(count, TurnEquations::default());
        let factor = exposures.factor(pixels[i].view);
        for c in 0..3 {
            let jacobian = DVec3::from_array([0, 1, 2].map(|k| f64::from(factor[c] * derivatives[k][i][c])));
            let weight = 1.0 / (noise * residual[c].abs().max(noise));
            if jacobian.is_finite() && residual[c] != 0.0 {
                sums.0[number].add(jacobian, f64::from(residual[c]), f64::from(weight));
            }
        }
    }
    Ok(())
}

/// Derivatives of the radiance of points by a rotation about each axis, in radiance per radian.
fn derivatives(points: &[ShadePoint], shade: &dyn Fn(&[ShadePoint]) -> Vec<Layers>) -> [Vec<Vec3>; 3] {
    [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| {
        let shaded = |angle: f32| {
            let turn = Mat3::from_axis_angle(axis, angle);
            shade(&points.iter().map(|point| turned(point, turn)).collect::<Vec<_>>())
        };
        let (up, down) = (shaded(DIFFERENCE), shaded(-DIFFERENCE));
        let slope = |(up, down): (&Layers, &Layers)| (radiance(up) - radiance(down)) / (2.0 * DIFFERENCE);
        up.iter().zip(&down).map(slope).collect()
    })
}

/// Update: every `TURN_EVERY` steps, a Gauss–Newton step of each rotation that was found; resets
/// the sums.
pub fn turn_placements(rates: Res<StepRates>, mut sums: ResMut<TurnSums>, mut turns: ResMut<Placements>) {
    if !rates.step.is_multiple_of(TURN_EVERY) {
        return;
    }
    for (turn, sums) in turns.0.iter_mut().zip(&sums.0) {
        if turn.source == TurnSource::Found {
            let step = Quat::from_scaled_axis(sums.step().as_vec3());
            turn.room_from_object = (step * turn.room_from_object).normalize();
        }
    }
    sums.0.clear();
}

/// Rotations that are tried first; the next of each is about 20° away.
const ROTATIONS: usize = 720;
/// How many of them are improved.
const IMPROVED: usize = 12;
/// Pixels of a placement with which rotations are tried first, and with which the best is improved.
const PIXELS: [usize; 2] = [6_000, 40_000];
/// First and last step of the improvement of many, of the best, and of one that was found in the
/// round before; degrees.
const STEPS: [[f32; 2]; 3] = [[10.0, 1.0], [1.0, 0.05], [3.0, 0.05]];
/// Cells along the longest side of the object; the pixels in one have one albedo.
const CELLS: f32 = 96.0;
/// Rounds of light and then rotations, of which the first has the light of the first placement.
const ROUNDS: usize = 3;

/// Finds the rotations of placements that are not known, of an object in a light whose frame is
/// known. A light that stands before the camera does not mind how the object lies; then nothing is
/// found.
pub(crate) fn find_placements(world: &mut World, unknowns: Unknowns, form: ClosedForm) -> Result<()> {
    let PlacedFrame { frame, placements: Placements(turns) } = PlacedFrame::own(world);
    let is_open = |number: &usize| turns[*number].source == TurnSource::Unknown;
    let open: Vec<usize> = (1..turns.len()).filter(is_open).collect();
    if open.is_empty() || frame == LightFrame::Camera {
        return Ok(());
    }
    let _finding = info_span!("placements").entered();
    for round in 0..if unknowns.light { ROUNDS } else { 1 } {
        let mut lobes = own_lobes(world);
        if unknowns.light {
            // That of the first placement alone is known without the rotations of others.
            let placement = (round == 0).then_some(Placement(0));
            let (mut texels, specular) = (recovered_albedo(world)?, least_rough(world));
            let known = Known { form, specular, unknowns, object: None, in_part: true, placement };
            with_initialization(world, known, |problems| problems[0].alternate(&mut lobes, &mut texels))?;
        }
        for number in open.iter().copied() {
            check_interrupted()?;
            let room_from_object = turn_of(world, number, (frame, &lobes), form, unknowns)?;
            let mut placements = world.resource_mut::<Placements>();
            placements.0[number] =
                PlacementTurn { room_from_object, source: TurnSource::Found, light: LightGroup::OWN };
        }
    }
    Ok(())
}

/// The rotation of a placement.
fn turn_of(
    world: &mut World,
    number: usize,
    (frame, lobes): (LightFrame, &[LightLobe]),
    form: ClosedForm,
    unknowns: Unknowns,
) -> Result<Quat> {
    let turn = world.resource::<Placements>().0[number];
    if let LightFrame::Turntable(axis) = frame {
        let axes = camera_axes(world, Placement(number as u32));
        // From sides that differ by 20° and more, so that they tell the axis that they turn about.
        let differ = |other: &Mat3| axes[0].x_axis.cross(other.x_axis).length() > 0.34;
        if let Some(own) = turning_axis(&axes).filter(|_| axes.iter().any(differ)) {
            return Ok(Quat::from_rotation_arc(own.normalize(), axis.normalize_or(Vec3::Y)));
        }
    }
    let specular = least_rough(world);
    let known = Known { form, specular, unknowns, object: None, in_part: true, placement: None };
    let placements = world.resource::<Placements>().clone();
    with_initialization(world, known, |problems| {
        let aligned = Aligned::new(&problems[0], (frame, lobes), &placements, number)?;
        Ok(match turn.source {
            TurnSource::Unknown => aligned.found()?,
            _ => aligned.improved(turn.room_from_object, STEPS[2], PIXELS[1]).0,
        })
    })
}

/// Whether the rotation of a placement is to be found.
pub(super) fn placements_are_open(world: &World) -> bool {
    let is_open = |turn: &PlacementTurn| turn.source == TurnSource::Unknown;
    world.get_resource::<Placements>().is_some_and(|placements| placements.0.iter().skip(1).any(is_open))
}

/// The camera axes of the photographs of a placement.
pub(super) fn camera_axes(world: &mut World, placement: Placement) -> Vec<Mat3> {
    let mut views = world.query_filtered::<(&Camera, Option<&Placement>), With<Photograph>>();
    let of = views.iter(world).filter(|(_, of)| of.copied().unwrap_or_default() == placement);
    of.map(|(camera, _)| Mat3::from(camera.world_from_camera.matrix3)).collect()
}

/// Sums over the pixels in a cell, for each channel: squares of the diffuse light of a white
/// surface, its products with what is not specular of the photographs, and the squares of that.
#[derive(Clone, Copy, Debug, Default)]
struct CellSums([[f64; 3]; 3]);

impl CellSums {
    fn add(&mut self, unit: &Layers, observed: Vec3) {
        for c in 0..3 {
            let (white, rest) = (f64::from(unit.diffuse[c]), f64::from(observed[c] - unit.specular[c]));
            let products = [white * white, white * rest, rest * rest];
            self.0[c].iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
        }
    }

    /// Squares that are left with the best albedo in `[0, 1]`.
    fn error(&self) -> f64 {
        let left = |[white, both, rest]: &[f64; 3]| {
            let albedo = if *white > 0.0 { (both / white).clamp(0.0, 1.0) } else { 0.0 };
            rest - 2.0 * albedo * both + albedo * albedo * white
        };
        self.0.iter().map(left).sum()
    }
}

/// A pixel, with what shading needs in the world.
#[derive(Clone, Copy)]
struct PlacedPixel {
    cell: u64,
    view: usize,
    point: ShadePoint,
    observed: Vec3,
}

/// The photographs of a placement beside those of the placements that are known.
struct Aligned {
    form: ClosedForm,
    frame: LightFrame,
    lobes: LobeColumns,
    specular: SpecularValue,
    /// Camera axes of the views, by index.
    views: Vec<Mat3>,
    /// Pixels of the placement by cell, cells in a random order.
    pixels: Vec<PlacedPixel>,
    /// Sums of the known placements by cell.
    known: HashMap<u64, CellSums>,
}

impl Aligned {
    fn new(
        problem: &Initialization,
        (frame, lobes): (LightFrame, &[LightLobe]),
        placements: &Placements,
        number: usize,
    ) -> Result<Self> {
        let cell = cells(problem.observations);
        let mut by_placement: Vec<Vec<PlacedPixel>> = vec![Vec::new(); placements.0.len()];
        let mut views = Vec::new();
        for row in problem.observations.iter().filter(|row| !row.observed.saturated) {
            let (index, camera) = (row.pixel.view, problem.cameras.of(row.pixel.view)?);
            let view = index.0 as usize;
            views.resize(views.len().max(view + 1), Mat3::IDENTITY);
            views[view] = camera.world_from_camera.matrix3.into();
            let to_viewer = (-camera.pixel_ray(row.pixel.pixel).direction).into();
            let point = ShadePoint { normal: row.point.normal.into(), to_viewer, albedo: [1.0; 3] };
            let pixel = PlacedPixel { cell: cell(row), view, point, observed: row.observed.radiance };
            by_placement[problem.placements.of(index)?.0 as usize].push(pixel);
        }
        let mut pixels = std::mem::take(&mut by_placement[number]);
        pixels.sort_by_key(|pixel| pixel.cell);
        let lobes = LobeColumns::from_lobes(lobes.iter().map(Into::into));
        let specular = kernel_specular(&problem.known.specular);
        let form = problem.known.form;
        let mut aligned = Self { form, frame, lobes, specular, views, pixels, known: HashMap::new() };
        for (turn, pixels) in placements.0.iter().zip(&by_placement) {
            if turn.source != TurnSource::Unknown {
                let unit = aligned.unit(pixels, turn.room_from_object);
                for (pixel, unit) in pixels.iter().zip(&unit) {
                    aligned.known.entry(pixel.cell).or_default().add(unit, pixel.observed);
                }
            }
        }
        Ok(aligned)
    }

    /// Radiance of pixels of an object of albedo 1 with this rotation in the room.
    fn unit(&self, pixels: &[PlacedPixel], room_from_object: Quat) -> Vec<Layers> {
        let room_from_object = Mat3::from_quat(room_from_object);
        let of_view = |axes: &Mat3| light_from_world(self.frame, *axes, room_from_object);
        let turns: Vec<Mat3> = self.views.iter().map(of_view).collect();
        let points: Vec<_> = pixels.iter().map(|pixel| turned(&pixel.point, turns[pixel.view])).collect();
        let mut unit = vec![Layers::default(); points.len()];
        self.form.shade(&points, &self.specular, Lighting::from(&self.lobes), &mut unit);
        unit
    }

    /// Mean square that no albedo explains of the first `most` pixels, given a rotation.
    fn error(&self, room_from_object: Quat, most: usize) -> f64 {
        let pixels = &self.pixels[..most.min(self.pixels.len())];
        let unit = self.unit(pixels, room_from_object);
        let mut seen = pixels.iter().zip(&unit).peekable();
        let mut error = 0.0;
        while let Some((first, _)) = seen.peek() {
            let cell = first.cell;
            let mut sums = self.known.get(&cell).copied().unwrap_or_default();
            while let Some((pixel, unit)) = seen.next_if(|(pixel, _)| pixel.cell == cell) {
                sums.add(unit, pixel.observed);
            }
            error += sums.error();
        }
        error / pixels.len().max(1) as f64
    }

    /// The best of all rotations.
    fn found(&self) -> Result<Quat> {
        let mut tried = Vec::with_capacity(ROTATIONS);
        for rotation in rotations(ROTATIONS) {
            check_interrupted()?;
            tried.push((rotation, self.error(rotation, PIXELS[0])));
        }
        tried.sort_by(|a, b| a.1.total_cmp(&b.1));
        let improved = tried[..IMPROVED].iter().map(|(turn, _)| self.improved(*turn, STEPS[0], PIXELS[0]));
        let best = improved.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(Quat::IDENTITY, |(turn, _)| turn);
        Ok(self.improved(best, STEPS[1], PIXELS[1]).0)
    }

    /// A rotation of less error near this one, by steps about three axes from one angle down to
    /// another in degrees.
    fn improved(&self, start: Quat, [first, last]: [f32; 2], most: usize) -> (Quat, f64) {
        let mut best = (start, self.error(start, most));
        let mut step = first;
        while step >= last {
            let before = best.1;
            for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
                for angle in [-step, step] {
                    let turn = (Quat::from_axis_angle(axis, angle.to_radians()) * best.0).normalize();
                    let error = self.error(turn, most);
                    if error < best.1 {
                        best = (turn, error);
                    }
                }
            }
            if best.1 == before {
                step *= 0.5;
            }
        }
        best
    }
}

/// The cell of an observation: its place in a grid, and the octant of its normal, so that the two
/// sides of what is thin differ. Numbers are mixed: their order is random.
fn cells(observations: &[Observation]) -> impl Fn(&Observation) -> u64 {
    let (low, longest) = extent(observations);
    let side = longest / CELLS;
    move |row| {
        let UVec3 { x, y, z } = ((row.point.position - low) / side).as_uvec3();
        let octant = row.point.normal.cmpgt(Vec3::ZERO).bitmask();
        let number = [x, y, z, octant].iter().fold(0, |number, part| number << 10 | u64::from(*part));
        number.wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(32).wrapping_mul(0xd6e8_feb8_6659_fd93)
    }
}

/// Rotations that are evenly spread (super-Fibonacci spirals; Alexa 2022).
fn rotations(count: usize) -> impl Iterator<Item = Quat> {
    use std::f64::consts::{SQRT_2, TAU};
    /// The positive root of x⁴ = x + 4.
    const PSI: f64 = 1.533_751_168_755_204_3;
    (0..count).map(move |i| {
        let s = i as f64 + 0.5;
        let part = s / count as f64;
        let ((a, b), (c, d)) = ((TAU * s / SQRT_2).sin_cos(), (TAU * s / PSI).sin_cos());
        let (inner, outer) = (part.sqrt(), (1.0 - part).sqrt());
        let [x, y, z, w] = [inner * a, inner * b, outer * c, outer * d].map(|value| value as f32);
        Quat::from_xyzw(x, y, z, w).normalize()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy_ecs::system::RunSystemOnce;
    use lobelia_sg::fibonacci::fibonacci_axes;
    use lobelia_world::light::placement::PlacementTurn;

    /// Radiance of a white surface under a sun.
    fn shade(points: &[ShadePoint]) -> Vec<Layers> {
        let sun = Vec3::new(0.3, 0.8, 0.5).normalize();
        let light = |point: &ShadePoint| (3.0 * (sun.dot(Vec3::from(point.normal)) - 1.0)).exp();
        points.iter().map(|point| Layers { diffuse: [light(point); 3], ..Layers::default() }).collect()
    }

    fn points() -> Vec<ShadePoint> {
        let point = |n: Vec3| ShadePoint { normal: n.into(), to_viewer: n.into(), albedo: [1.0; 3] };
        fibonacci_axes(400).into_iter().map(point).collect()
    }

    #[test]
    fn derivatives_agree_with_a_turn() {
        let points = points();
        let slopes = derivatives(&points, &shade);
        let turn = Vec3::new(0.002, -0.003, 0.001);
        let moved = Mat3::from_quat(Quat::from_scaled_axis(turn));
        let after = shade(&points.iter().map(|point| turned(point, moved)).collect::<Vec<_>>());
        for (i, (before, after)) in shade(&points).iter().zip(&after).enumerate() {
            let expected = radiance(before).x + (0..3).map(|k| turn[k] * slopes[k][i].x).sum::<f32>();
            assert!((radiance(after).x - expected).abs() < 2e-4, "{i}");
        }
    }

    #[test]
    fn steps_lead_to_the_true_turn() {
        let (points, truth) = (points(), Quat::from_scaled_axis(Vec3::new(0.02, -0.015, 0.03)));
        let at = |turn| points.iter().map(|at| turned(at, Mat3::from_quat(turn))).collect::<Vec<_>>();
        let seen = shade(&at(truth));
        let mut found = Quat::IDENTITY;
        for _ in 0..6 {
            let here = at(found);
            let slopes = derivatives(&here, &shade);
            let mut sums = TurnEquations::default();
            for (i, (shaded, seen)) in shade(&here).iter().zip(&seen).enumerate() {
                let jacobian = DVec3::from_array([0, 1, 2].map(|k| f64::from(slopes[k][i].x)));
                sums.add(jacobian, f64::from(radiance(shaded).x - radiance(seen).x), 1.0);
            }
            assert!(sums.step().length() <= LONGEST + 1e-9);
            found = Quat::from_scaled_axis(sums.step().as_vec3()) * found;
        }
        // A turn about the sun changes nothing; all else is found.
        let sun = Vec3::new(0.3, 0.8, 0.5).normalize();
        let apart = (found.inverse() * sun).distance(truth.inverse() * sun);
        assert!(apart < 2e-3, "{apart}");
        assert_eq!(TurnEquations::default().step(), DVec3::ZERO);
    }

    #[test]
    fn only_rotations_that_were_found_move_and_their_sums_begin_again() {
        let mut sums = TurnEquations::default();
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            // The residual falls with a turn about Y.
            (0..100).for_each(|_| sums.add(axis, -0.02 * axis.y, 1.0));
        }
        let of = |source| PlacementTurn { source, ..PlacementTurn::said(Quat::from_rotation_x(1.0)) };
        let turns = [TurnSource::Said, TurnSource::Found, TurnSource::Said].map(of);
        let mut world = World::new();
        world.insert_resource(Placements(turns.to_vec()));
        let after = |world: &mut World, step: u32| {
            world.insert_resource(StepRates { step, ..StepRates::default() });
            world.insert_resource(TurnSums(vec![sums; 3]));
            world.run_system_once(turn_placements).unwrap();
            world.resource::<Placements>().0.clone()
        };
        assert_eq!(after(&mut world, TURN_EVERY + 1), turns);
        let moved = after(&mut world, TURN_EVERY);
        assert_eq!((moved[0], moved[2]), (turns[0], turns[2]));
        // In the room, after the rotation that it has.
        let expected = Quat::from_rotation_y(0.02) * Quat::from_rotation_x(1.0);
        assert!(moved[1].room_from_object.angle_between(expected) < 2e-3, "{}", moved[1].room_from_object);
        assert!(world.resource::<TurnSums>().0.is_empty());
    }

    #[test]
    fn rotations_are_spread_over_all() {
        let all: Vec<Quat> = rotations(ROTATIONS).collect();
        let nearest = |turn: Quat| {
            let apart = all.iter().map(|other| turn.angle_between(*other).to_degrees());
            apart.fold(f32::INFINITY, f32::min)
        };
        // Those of another count lie anywhere between.
        let far = rotations(101).map(nearest).fold(0.0, f32::max);
        assert!(far < 32.0, "{far}");
    }

    #[test]
    fn an_albedo_explains_what_is_diffuse() {
        let unit = |white: f32| Layers { diffuse: [white; 3], specular: [0.25; 3] };
        let mut sums = CellSums::default();
        for white in [0.5, 1.0, 2.0] {
            sums.add(&unit(white), Vec3::splat(0.25 + 0.5 * white));
        }
        assert!(sums.error().abs() < 1e-9, "{}", sums.error());
        sums.add(&unit(1.0), Vec3::splat(0.25 + 0.9));
        assert!(sums.error() > 0.1);
    }
}
