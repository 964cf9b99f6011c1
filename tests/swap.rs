//! Systems are exchanged between runs in one world: shading for shading, light for light, and back again.

use crate::common::{camera, day, shoot, studio};
use bevy_ecs::schedule::ScheduleConfigs;
use bevy_ecs::system::ScheduleSystem;
use glam::Vec3;
use lobelia::codec::exr_frame::Frame;
use lobelia::light::EnvironmentMap;
use lobelia::light::illuminate::MapLight;
use lobelia::light::lights::{LightChoice, provide_light, spawn_light};
use lobelia::math::shading::ClosedForm;
use lobelia::pipeline::{Phase, Slot};
use lobelia::shade::{PathTracing, shade_closed_form, shade_path_traced};
use std::sync::Arc;

const PATHS: u32 = 128;

/// The path tracer; a pixel has four samples.
fn traced_shading() -> ScheduleConfigs<ScheduleSystem> {
    shade_path_traced(PathTracing {
        paths_per_sample: PATHS / 4,
        max_bounces: 2,
        seed: 7,
        samples_per_pixel: 4,
    })
}

/// Mean color over the pixels that are wholly on the object, in the part of the picture that `part` picks by column.
fn mean(frame: &Frame, part: impl Fn(usize) -> bool) -> Vec3 {
    let inside = |i: &usize| frame.alpha[*i] == 1.0 && part(*i % frame.width);
    let pixels: Vec<Vec3> = (0..frame.color.len()).filter(inside).map(|i| frame.color[i]).collect();
    assert!(pixels.len() > 20, "the object is in the picture");
    pixels.iter().sum::<Vec3>() / pixels.len() as f32
}

fn left(frame: &Frame) -> f32 {
    mean(frame, |x| x < frame.width / 2).element_sum()
}

fn right(frame: &Frame) -> f32 {
    mean(frame, |x| x >= frame.width / 2).element_sum()
}

/// A map that is bright toward −X, on the left of a camera in front.
fn left_sky() -> EnvironmentMap {
    EnvironmentMap::from_directions(64, 32, |d| {
        Vec3::new(1.0, 0.8, 0.6) * (3.0 * (6.0 * (d.dot(Vec3::NEG_X) - 1.0)).exp() + 0.05)
    })
}

#[test]
fn shading_and_light_are_swapped_in_one_world_and_back() {
    let front = camera([0.0, 0.1, 1.0], 20);
    let mut pipeline = studio(&day());
    let accurate = shoot(&mut pipeline, front);

    // A convex object has no shadow of its own and no interreflection: only the closed form's approximations differ.
    pipeline.swap(Phase::Frame, Slot::Shading, traced_shading());
    let traced = shoot(&mut pipeline, front);
    assert_ne!(traced.color, accurate.color);
    let (a, b) = (mean(&accurate, |_| true), mean(&traced, |_| true));
    for channel in 0..3 {
        let ratio = a[channel] / b[channel];
        assert!((ratio - 1.0).abs() < 0.06, "channel {channel}: closed form {a}, traced {b}");
    }
    // What does not depend on the shading is the same, bit for bit.
    assert_eq!(
        (&traced.albedo, &traced.normal, &traced.depth, &traced.alpha),
        (&accurate.albedo, &accurate.normal, &accurate.depth, &accurate.alpha)
    );

    // The map has no lobes here: the path tracer samples it, closed forms see a black light.
    let sky = Arc::new(MapLight::new(left_sky()));
    spawn_light(&mut pipeline.world, "sky", &[], Some(sky));
    let by_sky = || provide_light(LightChoice::Named("sky".into()), true);
    pipeline.swap(Phase::Frame, Slot::Light, by_sky());
    let relit = shoot(&mut pipeline, front);
    assert!(right(&traced) > 1.2 * left(&traced), "by day: {} {}", left(&traced), right(&traced));
    assert!(left(&relit) > 1.2 * right(&relit), "under the sky: {} {}", left(&relit), right(&relit));
    pipeline.swap(Phase::Frame, Slot::Shading, shade_closed_form(ClosedForm::default()));
    let dark = shoot(&mut pipeline, front);
    assert!(dark.color.iter().all(|c| *c == Vec3::ZERO));

    pipeline.swap(Phase::Frame, Slot::Light, provide_light(LightChoice::Own, false));
    let again = shoot(&mut pipeline, front);
    assert_eq!(again, accurate, "the first systems give the first picture");
    pipeline.swap(Phase::Frame, Slot::Shading, traced_shading());
    assert_eq!(shoot(&mut pipeline, front), traced, "and the path tracer its own");

    pipeline.swap(Phase::Frame, Slot::Shading, shade_closed_form(ClosedForm::Published));
    let published = shoot(&mut pipeline, front);
    assert_ne!(published.color, accurate.color, "the published formulas are another system in the same slot");
    assert_eq!(published.alpha, accurate.alpha);
}

#[test]
fn a_map_and_its_lobes_light_alike() {
    let front = camera([0.0, 0.1, 1.0], 16);
    let lobes = day();
    let mut pipeline = studio(&lobes);
    pipeline.swap(Phase::Frame, Slot::Shading, traced_shading());
    let by_lobes = shoot(&mut pipeline, front);
    let map = EnvironmentMap::from_directions(128, 64, |d| lobelia::light::lobes_radiance(&lobes, d));
    spawn_light(&mut pipeline.world, "day", &lobes, Some(Arc::new(MapLight::new(map))));
    let day = |by_map| provide_light(LightChoice::Named("day".into()), by_map);
    pipeline.swap(Phase::Frame, Slot::Light, day(true));
    let by_map = shoot(&mut pipeline, front);
    assert_ne!(by_lobes.color, by_map.color, "other samples are drawn");
    let (a, b) = (mean(&by_lobes, |_| true), mean(&by_map, |_| true));
    assert!((a / b - Vec3::ONE).abs().max_element() < 0.03, "lobes {a}, map {b}");
    pipeline.swap(Phase::Frame, Slot::Light, day(false));
    assert_eq!(shoot(&mut pipeline, front), by_lobes, "the same lobes under a name");
}

#[test]
fn a_light_that_is_not_there_is_one_clean_error() {
    let mut pipeline = studio(&day());
    spawn_light(&mut pipeline.world, "noon", &day(), None);
    pipeline.swap(Phase::Frame, Slot::Light, provide_light(LightChoice::Named("night".into()), false));
    let front = camera([0.0, 0.1, 1.0], 8);
    let Err(error) = lobelia::shade::frame::render_frame(&mut pipeline, front, 1) else {
        panic!("there is no such light");
    };
    assert_eq!(error.exit_code(), 1);
    assert!(error.to_string().contains("night") && error.to_string().contains("noon"), "{error}");
    pipeline.swap(Phase::Frame, Slot::Light, provide_light(LightChoice::Own, false));
    assert_eq!(shoot(&mut pipeline, front), shoot(&mut studio(&day()), front));
}
