//! Rotations of the object's [placements](crate::light::placement) as unknowns: those that were found move with the rest of a fit.
//!
//! | system | stage | reads | writes |
//! | --- | --- | --- | --- |
//! | [`sum_turns`] | Gradient | points, radiance, photographs, light, materials | [`TurnSums`]: normal equations |
//! | [`turn_placements`] | Update | normal equations | [`Placements`] |
//!
//! A small rotation of the object in the room is one of all normals and views of its placement in the light's frame. Derivatives of the radiance are
//! central differences, with shadows as they are; those are found anew later. Residuals have
//! weights that minimize the sum of absolute differences.
//!
//! | name | unit | value | meaning |
//! | --- | --- | --- | --- |
//! | `SUM_EVERY` | steps under one light | 3 | how often a window is summed |
//! | `TURN_EVERY` | steps | 25 | how often rotations move |
//! | `DIFFERENCE` | radians | 0.01 | half the distance of central differences |
//! | `LONGEST` | radians | 0.03 | longest rotation at a time |
//! | `PRIOR` | | 10 | weight of where it is, in residuals of typical size per radian of typical derivative |

use crate::fit::components::StepRates;
use crate::fit::exposure::Exposures;
use crate::light::light_frame::LightFrame;
use crate::light::lights::IncidentLight;
use crate::light::placement::{PlacedFrame, Placements, TurnSource};
use crate::material::material_source::BaseMaterials;
use crate::math::shading::{ClosedForm, Layers, Lighting, PointVisibility, ShadePoint};
use crate::pipeline::{Phase, Pipeline, Plugin, Stage, SystemResult};
use crate::sample::Samples;
use crate::sample::pixel::{Observed, PixelOf};
use crate::sample::point::PointBlend;
use crate::shade::systems::{shade_materials, turned};
use crate::view::Placement;
use crate::view::{ByView, Photograph, ViewIndex};
use crate::visibility::WindowVisibility;
use bevy_ecs::prelude::{IntoScheduleConfigs, Query, Res, ResMut, Resource, With, World};
use bevy_ecs::schedule::ScheduleConfigs;
use bevy_ecs::system::ScheduleSystem;
use glam::{DMat3, DVec3, Mat3, Quat, Vec3};
use serde::{Deserialize, Serialize};

/// Steps between two windows that are summed.
const SUM_EVERY: u32 = 3;
/// Steps between two moves.
const TURN_EVERY: u32 = 25;
/// Half the distance of central differences, radians.
const DIFFERENCE: f32 = 0.01;
/// Longest rotation at a time, radians.
const LONGEST: f64 = 0.03;
/// Weight of a rotation that stays where it is, in residuals.
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

    /// The rotation vector that reduces the residuals most, not longer than [`LONGEST`]; zero if they say nothing.
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

/// The systems that turn placements whose rotation a fit has found, of an object in a light that stands still.
pub struct PlacementPlugin(pub ClosedForm);

impl Plugin for PlacementPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.world.insert_resource(PlacementsTurn);
        pipeline
            .add_systems(Phase::FitStep, Stage::Gradient, sum_turns(self.0).run_if(is_summed))
            .add_systems(Phase::FitStep, Stage::Update, turn_placements);
    }

    fn cleanup(world: &mut World) {
        world.remove_resource::<PlacementsTurn>();
    }
}

/// Rotations of placements move: their system reads the shadows of a whole window.
#[derive(Resource)]
pub struct PlacementsTurn;

/// Whether a fit improves rotations of placements.
pub(super) fn placements_turn(world: &World) -> bool {
    let PlacedFrame { frame, placements } = PlacedFrame::own(world);
    frame == LightFrame::World && placements.0.iter().any(|turn| turn.source == TurnSource::Found)
}

/// Run condition: whether this window is summed.
pub fn is_summed(rates: Res<StepRates>) -> bool {
    rates.visit.is_multiple_of(SUM_EVERY)
}

/// The columns that shading and its comparison read.
type TurnColumns = (
    &'static ShadePoint,
    &'static PointBlend,
    &'static PointVisibility,
    (&'static Layers, &'static Observed),
    &'static PixelOf,
);

/// Gradient: adds the residuals of the window to the normal equations of its placements, shaded with this closed form.
pub fn sum_turns(form: ClosedForm) -> ScheduleConfigs<ScheduleSystem> {
    let system =
        move |(light, materials, exposures): (Res<IncidentLight>, Res<BaseMaterials>, Res<Exposures>),
              visibility: Option<Res<WindowVisibility>>,
              views: Query<(&ViewIndex, &Placement), With<Photograph>>,
              mut sums: ResMut<TurnSums>,
              samples: Samples<TurnColumns>|
              -> SystemResult {
            let (points, blends, seen, (shaded, observed), pixels) = samples.columns()?;
            let visibility = visibility.as_ref().and_then(|visibility| visibility.view(&seen));
            let lighting = Lighting { lobes: &light.lobes, visibility };
            let shade = |points: &[ShadePoint]| {
                let mut shaded = vec![Layers::default(); points.len()];
                shade_materials(form, points, &blends, &materials, lighting, &mut shaded);
                shaded
            };
            let derivatives = derivatives(&points, &shade);
            let placements: ByView<Placement> = views.iter().map(|(view, of)| (*view, *of)).collect();
            let residuals: Vec<Vec3> = (0..points.len())
                .map(|i| residual(exposures.factor(pixels[i].view), &shaded[i], &observed[i]))
                .collect();
            let noise = mean_size(&residuals);
            for (i, residual) in residuals.iter().enumerate() {
                let number = placements.of(pixels[i].view)?.0 as usize;
                let count = sums.0.len().max(number + 1);
                sums.0.resize(count, TurnEquations::default());
                let factor = exposures.factor(pixels[i].view);
                for c in 0..3 {
                    let jacobian =
                        DVec3::from_array([0, 1, 2].map(|k| f64::from(factor[c] * derivatives[k][i][c])));
                    let weight = 1.0 / (noise * residual[c].abs().max(noise));
                    if jacobian.is_finite() && residual[c] != 0.0 {
                        sums.0[number].add(jacobian, f64::from(residual[c]), f64::from(weight));
                    }
                }
            }
            Ok(())
        };
    system.into_configs()
}

/// Derivatives of the radiance of points by a rotation about each axis, in radiance per radian.
fn derivatives(points: &[ShadePoint], shade: &dyn Fn(&[ShadePoint]) -> Vec<Layers>) -> [Vec<Vec3>; 3] {
    [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| {
        let shaded = |angle: f32| {
            let turn = Mat3::from_axis_angle(axis, angle);
            shade(&points.iter().map(|point| turned(point, turn)).collect::<Vec<_>>())
        };
        let (above, below) = (shaded(DIFFERENCE), shaded(-DIFFERENCE));
        let slope = |(above, below): (&Layers, &Layers)| (sum(above) - sum(below)) / (2.0 * DIFFERENCE);
        above.iter().zip(&below).map(slope).collect()
    })
}

fn sum(layers: &Layers) -> Vec3 {
    Vec3::from(layers.diffuse) + Vec3::from(layers.specular)
}

/// Prediction less observation; zero where that says nothing.
fn residual(factor: Vec3, shaded: &Layers, observed: &Observed) -> Vec3 {
    let predicted = factor * sum(shaded);
    Vec3::from_array(std::array::from_fn(|c| observed.difference(c, predicted[c])))
}

/// Mean size of the residuals, not zero.
fn mean_size(residuals: &[Vec3]) -> f32 {
    let sum: f64 = residuals.iter().map(|residual| f64::from(residual.abs().element_sum())).sum();
    ((sum / (3 * residuals.len()).max(1) as f64) as f32).max(1e-6)
}

/// Update: every `TURN_EVERY` steps, a Gauss–Newton step of each rotation that was found; resets the sums.
pub fn turn_placements(
    rates: Res<StepRates>,
    mut sums: ResMut<TurnSums>,
    mut placements: ResMut<Placements>,
) {
    if !rates.step.is_multiple_of(TURN_EVERY) {
        return;
    }
    for (turn, sums) in placements.0.iter_mut().zip(&sums.0) {
        if turn.source == TurnSource::Found {
            let step = Quat::from_scaled_axis(sums.step().as_vec3());
            turn.room_from_object = (step * turn.room_from_object).normalize();
        }
    }
    sums.0.clear();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::placement::PlacementTurn;
    use crate::math::fibonacci::fibonacci_axes;
    use bevy_ecs::system::RunSystemOnce;

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
            let expected = sum(before).x + (0..3).map(|k| turn[k] * slopes[k][i].x).sum::<f32>();
            assert!((sum(after).x - expected).abs() < 2e-4, "{i}");
        }
    }

    #[test]
    fn steps_lead_to_the_true_turn() {
        let (points, truth) = (points(), Quat::from_scaled_axis(Vec3::new(0.02, -0.015, 0.03)));
        let at = |turn: Quat| -> Vec<ShadePoint> {
            points.iter().map(|point| turned(point, Mat3::from_quat(turn))).collect()
        };
        let seen = shade(&at(truth));
        let mut found = Quat::IDENTITY;
        for _ in 0..6 {
            let here = at(found);
            let slopes = derivatives(&here, &shade);
            let mut sums = TurnEquations::default();
            for (i, (shaded, seen)) in shade(&here).iter().zip(&seen).enumerate() {
                let jacobian = DVec3::from_array([0, 1, 2].map(|k| f64::from(slopes[k][i].x)));
                sums.add(jacobian, f64::from(sum(shaded).x - sum(seen).x), 1.0);
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
            world.insert_resource(StepRates {
                step,
                visit: step,
                progress: 0.0,
                albedo: 0.0,
                light: 0.0,
                specular: 0.0,
            });
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
}
