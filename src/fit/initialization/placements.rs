//! How the object lies in each [placement](crate::light::placement), found from the photographs.
//!
//! The light is solved for from the photographs of the first placement, or is there already. A rotation of another placement turns the object
//! under it, and the error is what no albedo explains of the photographs of both: a place that both see has one albedo. Rotations are tried all
//! over their group (super-Fibonacci spirals; Alexa 2022, equation 7), then the best ones are improved by ever smaller steps, and once more under the
//! light that the photographs of all placements have together.

use super::{Initialization, Known, least_rough, lobes_of, with_initialization};
use crate::error::Result;
use crate::error::stop::check_interrupted;
use crate::fit::components::Unknowns;
use crate::light::light_frame::{LightFrame, turning_axis};
use crate::light::placement::{
    LightGroup, PlacedFrame, PlacementTurn, Placements, TurnSource, light_from_world,
};
use crate::light::{LightLobe, kernel_lobe};
use crate::material::recovered_albedo;
use crate::math::shading::{ClosedForm, Layers, Lighting, LobeColumns, ShadePoint, SpecularValue};
use crate::profile::stage;
use crate::sample::observation::Observation;
use crate::shade::systems::{kernel_specular, turned};
use crate::view::Placement;
use crate::view::{Camera, Photograph};
use bevy_ecs::prelude::{With, World};
use glam::{Mat3, Quat, UVec3, Vec3};
use std::collections::HashMap;

/// Rotations that are tried first; the next of each is about 20° away.
const ROTATIONS: usize = 720;
/// How many of them are improved.
const IMPROVED: usize = 12;
/// Pixels of a placement with which rotations are tried first, and with which the best is improved.
const PIXELS: [usize; 2] = [6_000, 40_000];
/// First and last step of the improvement of many, of the best, and of one that was found in the round before; degrees.
const STEPS: [[f32; 2]; 3] = [[10.0, 1.0], [1.0, 0.05], [3.0, 0.05]];
/// Cells along the longest side of the object; the pixels in one have one albedo.
const CELLS: f32 = 96.0;
/// Rounds of light and then rotations, of which the first has the light of the first placement.
const ROUNDS: usize = 3;

/// Finds the rotations of placements that are not known, of an object in a light whose frame is known. A light that stands before the camera does not
/// mind how the object lies; then nothing is found.
///
/// # Errors
/// If a pool is incomplete.
pub(crate) fn find_placements(world: &mut World, unknowns: Unknowns, form: ClosedForm) -> Result<()> {
    let PlacedFrame { frame, placements: Placements(turns) } = PlacedFrame::own(world);
    let is_open = |number: &usize| turns[*number].source == TurnSource::Unknown;
    let open: Vec<usize> = (1..turns.len()).filter(is_open).collect();
    if open.is_empty() || frame == LightFrame::Camera {
        return Ok(());
    }
    let _finding = stage("placements");
    for round in 0..if unknowns.light { ROUNDS } else { 1 } {
        let first = (round == 0).then_some(Placement(0));
        let lobes = light_now(world, unknowns, form, first)?;
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

/// The light: that of the photographs, or those of one `placement` alone, if it is not known yet.
fn light_now(
    world: &mut World,
    unknowns: Unknowns,
    form: ClosedForm,
    placement: Option<Placement>,
) -> Result<Vec<LightLobe>> {
    let mut lobes = lobes_of(world).1;
    if unknowns.light {
        let mut texels = recovered_albedo(world)?;
        let specular = least_rough(world);
        let known = Known { form, specular, unknowns, object: None, in_part: true, placement };
        with_initialization(world, known, |problem| problem.alternate(&mut lobes, &mut texels))?;
    }
    Ok(lobes)
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
        if let Some(own) = turning_axis(&axes).filter(|_| turn_about_one(&axes)) {
            return Ok(Quat::from_rotation_arc(own.normalize(), axis.normalize_or(Vec3::Y)));
        }
    }
    let specular = least_rough(world);
    let known = Known { form, specular, unknowns, object: None, in_part: true, placement: None };
    let placements = world.resource::<Placements>().clone();
    with_initialization(world, known, |problem| {
        let aligned = Aligned::new(problem, (frame, lobes), &placements, number)?;
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

/// Whether cameras look from sides that differ by 20° and more, so that they tell the axis that they turn about.
fn turn_about_one(world_from_camera: &[Mat3]) -> bool {
    let differ = |a: &Mat3, b: &Mat3| a.x_axis.cross(b.x_axis).length() > 0.34;
    world_from_camera.first().is_some_and(|first| world_from_camera.iter().any(|other| differ(first, other)))
}

/// The camera axes of the photographs of a placement.
pub(super) fn camera_axes(world: &mut World, placement: Placement) -> Vec<Mat3> {
    let mut views = world.query_filtered::<(&Camera, Option<&Placement>), With<Photograph>>();
    let of = views.iter(world).filter(|(_, of)| of.copied().unwrap_or_default() == placement);
    of.map(|(camera, _)| Mat3::from(camera.world_from_camera.matrix3)).collect()
}

/// Sums over the pixels in a cell, for each channel: squares of the diffuse light of a white surface, its products with what is not specular of the
/// photographs, and the squares of that.
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
    /// What the known placements say of each cell.
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
        let lobes = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
        let specular = kernel_specular(&problem.specular);
        let form = problem.form;
        let mut aligned = Self { form, frame, lobes, specular, views, pixels, known: HashMap::new() };
        for (turn, pixels) in placements.0.iter().zip(&by_placement) {
            if turn.source != TurnSource::Unknown {
                aligned.take_known(pixels, turn.room_from_object);
            }
        }
        Ok(aligned)
    }

    /// Takes up what pixels of a known placement say.
    fn take_known(&mut self, pixels: &[PlacedPixel], room_from_object: Quat) {
        let unit = self.unit(pixels, room_from_object);
        for (pixel, unit) in pixels.iter().zip(&unit) {
            self.known.entry(pixel.cell).or_default().add(unit, pixel.observed);
        }
    }

    /// Radiance of pixels of an object of albedo 1 with this rotation in the room.
    fn unit(&self, pixels: &[PlacedPixel], room_from_object: Quat) -> Vec<Layers> {
        let room_from_object = Mat3::from_quat(room_from_object);
        let of_view = |axes: &Mat3| light_from_world(self.frame, *axes, room_from_object);
        let turns: Vec<Mat3> = self.views.iter().map(of_view).collect();
        let points: Vec<ShadePoint> =
            pixels.iter().map(|pixel| turned(&pixel.point, turns[pixel.view])).collect();
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

    /// A rotation of less error near this one, by steps about three axes from one angle down to another in degrees.
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

/// The cell of an observation: its place in a grid, and the octant of its normal, so that the two sides of what is thin differ. Numbers are mixed:
/// their order is random.
fn cells(observations: &[Observation]) -> impl Fn(&Observation) -> u64 {
    let both = |(low, high): (Vec3, Vec3), row: &Observation| {
        (low.min(row.point.position), high.max(row.point.position))
    };
    let (low, high) = observations.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), both);
    let side = (high - low).max_element().max(1e-6) / CELLS;
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
