//! Systems are exchanged between runs in one world: shading for shading, light for light, and back again.

mod common;

use bevy_ecs::prelude::{Component, Entity, With, World};
use common::{camera, day, shoot, studio};
use glam::Vec3;
use lobelia::codec::frame::Frame;
use lobelia::fit::components::{SpecularGradient, SpecularMoments};
use lobelia::light::EnvironmentMap;
use lobelia::light::illuminate::MapLight;
use lobelia::material::SpecularLobe;
use lobelia::math::shading::LobeColumns;
use lobelia::pass::edit::{put_material, take_material};
use lobelia::pipeline::{Phase, Pipeline, Slot};
use lobelia::shade::{
    DistantLight, PathTracing, provide_distant, provide_lobes, shade_closed_form, shade_path_traced,
};
use std::sync::Arc;

const PATHS: u32 = 128;

/// Tells the path tracer how; a pixel has four samples.
fn set_paths(pipeline: &mut Pipeline) {
    pipeline.world.insert_resource(PathTracing {
        paths_per_sample: PATHS / 4,
        max_bounces: 2,
        seed: 7,
        samples_per_pixel: 4,
    });
}

/// Mean colour over the pixels that are wholly on the object, in the part of the picture that `part` picks by column.
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

/// A map that is bright towards −X, on the left of a camera in front.
fn left_sky() -> EnvironmentMap {
    EnvironmentMap::from_directions(64, 32, |d| {
        Vec3::new(1.0, 0.8, 0.6) * (3.0 * (6.0 * (d.dot(Vec3::NEG_X) - 1.0)).exp() + 0.05)
    })
}

#[test]
fn shading_and_light_are_swapped_in_one_world_and_back() {
    let front = camera([0.0, 0.1, 1.0], 20);
    let mut pipeline = studio(&day());
    let published = shoot(&mut pipeline, front);

    // A convex object has no shadow of its own and no interreflection: only the published approximations differ.
    set_paths(&mut pipeline);
    pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced);
    let traced = shoot(&mut pipeline, front);
    assert_ne!(traced.color, published.color);
    let (a, b) = (mean(&published, |_| true), mean(&traced, |_| true));
    for channel in 0..3 {
        let ratio = a[channel] / b[channel];
        assert!((ratio - 1.0).abs() < 0.06, "channel {channel}: published {a}, traced {b}");
    }
    // What does not depend on the shading is the same, bit for bit.
    assert_eq!(
        (&traced.albedo, &traced.normal, &traced.depth, &traced.alpha),
        (&published.albedo, &published.normal, &published.depth, &published.alpha)
    );

    let sky = MapLight::new(left_sky());
    pipeline.world.insert_resource(DistantLight { light: Arc::new(sky), lobes: LobeColumns::default() });
    pipeline.swap(Phase::Frame, Slot::Light, provide_distant);
    let relit = shoot(&mut pipeline, front);
    assert!(right(&traced) > 1.2 * left(&traced), "by day: {} {}", left(&traced), right(&traced));
    assert!(left(&relit) > 1.2 * right(&relit), "under the sky: {} {}", left(&relit), right(&relit));

    // The map has no lobes here: closed-form shading sees a black light, so it is this provider that it reads.
    pipeline.swap(Phase::Frame, Slot::Shading, shade_closed_form);
    let dark = shoot(&mut pipeline, front);
    assert!(dark.color.iter().all(|c| *c == Vec3::ZERO));

    pipeline.swap(Phase::Frame, Slot::Light, provide_lobes);
    let again = shoot(&mut pipeline, front);
    assert_eq!(again, published, "the first systems give the first picture");

    pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced);
    assert_eq!(shoot(&mut pipeline, front), traced, "and the path tracer its own");
}

#[test]
fn a_map_and_its_lobes_light_alike() {
    let front = camera([0.0, 0.1, 1.0], 16);
    let lobes = day();
    let mut pipeline = studio(&lobes);
    set_paths(&mut pipeline);
    pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced);
    let by_lobes = shoot(&mut pipeline, front);
    let map = EnvironmentMap::from_directions(128, 64, |d| lobelia::light::lobes_radiance(&lobes, d));
    let light = Arc::new(MapLight::new(map));
    pipeline.world.insert_resource(DistantLight { light, lobes: LobeColumns::default() });
    pipeline.swap(Phase::Frame, Slot::Light, provide_distant);
    let by_map = shoot(&mut pipeline, front);
    assert_ne!(by_lobes.color, by_map.color, "other samples are drawn");
    let (a, b) = (mean(&by_lobes, |_| true), mean(&by_map, |_| true));
    assert!((a / b - Vec3::ONE).abs().max_element() < 0.03, "lobes {a}, map {b}");
}

#[test]
fn a_missing_resource_is_one_clean_error() {
    let mut pipeline = studio(&day());
    pipeline.swap(Phase::Frame, Slot::Light, provide_distant);
    let front = camera([0.0, 0.1, 1.0], 8);
    let Err(error) = lobelia::shade::frame::render_frame(&mut pipeline, front, 1) else {
        panic!("there is no DistantLight, so this cannot work");
    };
    assert_eq!(error.exit_code(), 1);
    assert!(error.to_string().contains("provide_distant"), "{error}");
    pipeline.swap(Phase::Frame, Slot::Light, provide_lobes);
    assert_eq!(shoot(&mut pipeline, front), shoot(&mut studio(&day()), front));
}

/// Takes up an archetype each, so that the ones that matter get other numbers.
#[derive(Component)]
struct Filler<const N: usize>;

const FILLERS: [fn(&mut World); 8] =
    [fill::<0>, fill::<1>, fill::<2>, fill::<3>, fill::<4>, fill::<5>, fill::<6>, fill::<7>];

fn fill<const N: usize>(world: &mut World) {
    world.spawn(Filler::<N>);
}

/// Blend weights name specular lobes by their order: it must hold although a fit has given the first lobe more components,
/// whatever numbers the archetypes have (a query visits them in an order of its own).
#[test]
fn specular_lobes_keep_their_order_after_a_fit() {
    for fillers in 0..=FILLERS.len() {
        let mut pipeline = studio(&day());
        let world = &mut pipeline.world;
        FILLERS.iter().take(fillers).for_each(|fill| fill(world));
        let fitted: Vec<Entity> = world.query_filtered::<Entity, With<SpecularLobe>>().iter(world).collect();
        world.entity_mut(fitted[0]).insert((SpecularGradient::default(), SpecularMoments::default()));
        let before = take_material(world);
        for count in [3, 2, 8, 1] {
            let mut state = before.clone();
            let lobe = |i: u8| SpecularLobe::new(Vec3::splat(0.1 * f32::from(i)), 0.5);
            state.lobes = (0..count).map(lobe).collect();
            put_material(world, &state);
            assert_eq!(take_material(world).lobes, state.lobes, "{count} lobes, {fillers} fillers");
        }
        put_material(world, &before);
        assert_eq!(take_material(world), before);
    }
}
