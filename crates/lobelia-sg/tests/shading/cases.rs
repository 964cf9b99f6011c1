//! Random points and lobes for unit tests and for those of `tests/shading`.
#![allow(dead_code, reason = "each of the two reads a part")]

use crate::real::{add, dot, scale, sub};
use proptest::prelude::*;
use rand::{RngExt, rngs::SmallRng};

/// One case: normal, view, lobe, albedo, specular albedo, roughness.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Case {
    pub normal: [f64; 3],
    pub to_viewer: [f64; 3],
    pub axis: [f64; 3],
    pub sharpness: f64,
    pub amplitude: [f64; 3],
    pub albedo: [f64; 3],
    pub specular: [f64; 3],
    pub roughness: f64,
}

pub(crate) fn unit(v: [f64; 3]) -> [f64; 3] {
    scale(v, dot(v, v).sqrt().recip())
}

pub(crate) fn random_case(rng: &mut SmallRng) -> Case {
    let mut direction = || unit(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
    let (normal, mut to_viewer, mut axis) = (direction(), direction(), direction());
    if dot(normal, to_viewer) < 0.05 {
        to_viewer = unit(add(scale(normal, 0.2 - dot(normal, to_viewer)), to_viewer));
    }
    if rng.random_bool(0.5) {
        // Half of the cases look near the highlight, where the specular part is large.
        let mirror = sub(scale(normal, 2.0 * dot(normal, to_viewer)), to_viewer);
        axis = unit(add(mirror, scale(axis, 0.3)));
    }
    let mut color = || std::array::from_fn(|_| rng.random_range(0.1..0.9));
    let (amplitude, albedo, specular) = (color(), color(), color());
    Case {
        normal,
        to_viewer,
        axis,
        sharpness: 10f64.powf(rng.random_range(-1.5..3.0)),
        amplitude,
        albedo,
        specular,
        roughness: rng.random_range(0.1..0.9),
    }
}

/// Any direction; often an axis, or nearly one.
pub(crate) fn direction() -> impl Strategy<Value = [f32; 3]> {
    let special = prop::sample::select(vec![
        [0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0],
        [1.0, 0.0, 0.0],
        [-1.0, 0.0, 0.0],
        [1.0, 1e-4, 0.0],
        [-1.0, -1e-6, 0.0],
        [1e-5, 1.0, 0.0],
    ]);
    let free = prop::array::uniform3(-1.0f64..1.0).prop_filter("no direction", |v| dot(*v, *v) > 1e-3);
    prop_oneof![special, free].prop_map(|v| unit(v).map(|x| x as f32))
}
