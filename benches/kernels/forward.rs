//! Radiance of points under lobes.

use super::{CACHES, LOBES, POINTS, Turns, plain, workload};
use criterion::{Criterion, Throughput};
use lobelia::math::shading::shade;

pub fn forward(c: &mut Criterion) {
    let mut group = c.benchmark_group("shade forward");
    group.throughput(Throughput::Elements((POINTS * LOBES) as u64));
    for (cache, points) in CACHES {
        let mut work = workload(points);
        let lobes = plain::lobes(&work.lobes);
        let mut turns = Turns::new(points);
        group.bench_function(format!("kernel, {cache}"), |b| {
            b.iter(|| {
                let rows = turns.take(POINTS);
                shade(&work.points[rows.clone()], &work.specular, &work.lobes, &mut work.shaded[rows]);
            });
        });
        group.bench_function(format!("plain loop, {cache}"), |b| {
            b.iter(|| {
                let rows = turns.take(POINTS);
                plain::shade(&work.points[rows.clone()], &work.specular, &lobes, &mut work.shaded[rows]);
            });
        });
    }
}
