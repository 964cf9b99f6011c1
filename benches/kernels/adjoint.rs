//! Radiance again, and its adjoint to points, lobes and specular material.

use super::{CACHES, LOBES, POINTS, Turns, plain, workload};
use criterion::{Criterion, Throughput};
use lobelia::math::published::Published;
use lobelia::math::shading::shade_adjoint_with;

pub fn adjoint(c: &mut Criterion) {
    let mut group = c.benchmark_group("shade adjoint");
    group.throughput(Throughput::Elements((POINTS * LOBES) as u64));
    for (cache, points) in CACHES {
        let mut work = workload(points);
        work.shade(Published);
        let lobes = plain::lobes(&work.lobes);
        let mut turns = Turns::new(points);
        group.bench_function(format!("kernel, {cache}"), |b| {
            b.iter(|| {
                let rows = turns.take(POINTS);
                let radiance = (&work.shaded[rows.clone()], &work.adjoint[rows.clone()]);
                let out = &mut work.point_adjoint[rows.clone()];
                let (points, gradient) = (&work.points[rows], &mut work.gradient);
                shade_adjoint_with(Published, points, &work.specular, &work.lobes, radiance, out, gradient);
            });
        });
        group.bench_function(format!("plain loop, {cache}"), |b| {
            b.iter(|| {
                let rows = turns.take(POINTS);
                let out = &mut work.point_adjoint[rows.clone()];
                let adjoint = &work.adjoint[rows.clone()];
                plain::shade_adjoint(&work.points[rows], &work.specular, &lobes, adjoint, out)
            });
        });
    }
}
