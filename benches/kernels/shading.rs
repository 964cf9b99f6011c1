//! Radiance of points under lobes, and its adjoint to points, lobes and specular material.

use super::{CACHES, LOBES, POINTS, Turns, plain};
use criterion::{Criterion, Throughput};
use lobelia_sg::accurate::Quality;
use lobelia_sg::shading::{ClosedForm, RadianceColumns};
use lobelia_sg::workload::Workload;

const FORMS: [(ClosedForm, &str); 2] =
    [(ClosedForm::Published, "published"), (ClosedForm::Accurate(Quality::Default), "accurate")];

pub fn forward(c: &mut Criterion) {
    let mut group = c.benchmark_group("shade forward");
    group.throughput(Throughput::Elements((POINTS * LOBES) as u64));
    for (cache, points) in CACHES {
        let mut work = Workload::new(points, LOBES, 0.3);
        let lobes = plain::lobes(&work.lobes);
        let mut turns = Turns::new(points);
        for (form, name) in FORMS {
            group.bench_function(format!("{name} kernel, {cache}"), |b| {
                b.iter(|| {
                    let rows = turns.take(POINTS);
                    let (points, out) = (&work.points[rows.clone()], &mut work.shaded[rows]);
                    form.shade(points, &work.specular, &work.lobes, out);
                });
            });
        }
        group.bench_function(format!("published plain loop, {cache}"), |b| {
            b.iter(|| {
                let rows = turns.take(POINTS);
                plain::shade(&work.points[rows.clone()], &work.specular, &lobes, &mut work.shaded[rows]);
            });
        });
    }
}

pub fn adjoint(c: &mut Criterion) {
    let mut group = c.benchmark_group("shade adjoint");
    group.throughput(Throughput::Elements((POINTS * LOBES) as u64));
    for (cache, points) in CACHES {
        let mut work = Workload::new(points, LOBES, 0.3);
        work.shade(ClosedForm::Published);
        let lobes = plain::lobes(&work.lobes);
        let mut turns = Turns::new(points);
        for (form, name) in FORMS {
            group.bench_function(format!("{name} kernel, {cache}"), |b| {
                b.iter(|| {
                    let rows = turns.take(POINTS);
                    let radiance = RadianceColumns {
                        shaded: &work.shaded[rows.clone()],
                        adjoint: &work.adjoint[rows.clone()],
                    };
                    let out = &mut work.point_adjoint[rows.clone()];
                    let (points, gradient) = (&work.points[rows], &mut work.gradient);
                    form.shade_adjoint(points, &work.specular, &work.lobes, radiance, out, gradient);
                });
            });
        }
        group.bench_function(format!("published plain loop, {cache}"), |b| {
            b.iter(|| {
                let rows = turns.take(POINTS);
                let out = &mut work.point_adjoint[rows.clone()];
                let adjoint = &work.adjoint[rows.clone()];
                plain::shade_adjoint(&work.points[rows], &work.specular, &lobes, adjoint, out)
            });
        });
    }
}
