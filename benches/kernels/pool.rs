//! Overhead of the ECS in a loop over a pool: Adam on the albedo of texels and its reflectance at
//! pixel samples, over plain `Vec`s, over pools as they are spawned, and over pools that a marker
//! has split into two tables.

use bevy_ecs::prelude::{Component, Entity, Mut, World};
use bevy_ecs::system::SystemState;
use criterion::Criterion;
use glam::Vec3;
use lobelia::fit::components::{AdamStep, AlbedoGradient, AlbedoMoments, Moments};
use lobelia::material::{Diffuse, TexelIndex, Texels};
use std::hint::black_box;

/// Texels of a 512 × 512 atlas.
const TEXELS: usize = 512 * 512;

#[derive(Component)]
struct Marked;

type Columns = (&'static mut Diffuse, &'static mut AlbedoGradient, &'static mut AlbedoMoments);

fn world() -> World {
    let mut world = World::new();
    let gradient = |i: u32| AlbedoGradient(Vec3::splat((i % 17) as f32 - 8.0));
    let texel = |i: u32| {
        (TexelIndex(i), Diffuse::of_albedo(Vec3::splat(0.5)), gradient(i), AlbedoMoments(Moments::default()))
    };
    world.spawn_batch((0..TEXELS as u32).map(texel).collect::<Vec<_>>());
    world
}

fn step(texels: &mut [Diffuse], gradient: &[AlbedoGradient], moments: &mut [AlbedoMoments]) {
    let adam = AdamStep::new(1e-3, 10);
    for ((texel, gradient), moments) in texels.iter_mut().zip(gradient).zip(moments) {
        let step = adam.advance(&mut moments.0, &gradient.0.to_array());
        texel.albedo -= Vec3::from(step);
    }
}

fn by_pool(world: &mut World, state: &mut SystemState<Texels<Columns>>) {
    let texels = state.get_mut(world).expect("the world has texels");
    let (mut texels, gradient, moments) = texels.columns().expect("the pool is whole");
    let mut moments = moments.quiet();
    step(&mut texels, &gradient, &mut moments);
}

pub fn pool(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("pool");
    let mut texels = vec![Diffuse::of_albedo(Vec3::splat(0.5)); TEXELS];
    let gradient: Vec<_> = (0..TEXELS).map(|i| AlbedoGradient(Vec3::splat((i % 17) as f32 - 8.0))).collect();
    let mut moments = vec![AlbedoMoments::default(); TEXELS];
    group.bench_function("plain Vec", |b| {
        b.iter(|| step(black_box(&mut texels), black_box(&gradient), black_box(&mut moments)));
    });
    let mut spawned = world();
    let mut state = SystemState::new(&mut spawned);
    group.bench_function("pool in order", |b| b.iter(|| by_pool(&mut spawned, &mut state)));
    let mut split = world();
    let mut query = split.query::<(Entity, &TexelIndex)>();
    let texel = query.iter(&split).find(|(_, index)| index.0 == 1000).expect("it was spawned").0;
    split.entity_mut(texel).insert(Marked);
    let mut state = SystemState::new(&mut split);
    group.bench_function("pool with a marker on one texel", |b| b.iter(|| by_pool(&mut split, &mut state)));
    let mut query = spawned.query::<(&mut Diffuse, &AlbedoGradient, &mut AlbedoMoments)>();
    group.bench_function("query, entity by entity", |b| {
        b.iter(|| {
            let adam = AdamStep::new(1e-3, 10);
            for (mut texel, gradient, moments) in query.iter_mut(&mut spawned) {
                let step = adam.advance(&mut Mut::into_inner(moments).0, &gradient.0.to_array());
                texel.albedo -= Vec3::from(step);
            }
        });
    });
    group.finish();
}
