//! Radiance of points under lobes.

use super::{CACHES, LOBES, POINTS, Turns, plain, workload};
use criterion::{Criterion, Throughput};
use lobelia_sg::shading::ClosedForm;

pub fn forward(c: &mut Criterion) {
    let mut group = c.benchmark_group("shade forward");
    group.throughput(Throughput::Elements((POINTS * LOBES) as u64));
    for (cache, points) in CACHES {
        let mut work = workload(points);
        let lobes = plain::lobes(&work.lobes);
        let mut turns = Turns::new(points);
        for (form, name) in [(ClosedForm::Published, "published"), (ClosedForm::default(), "accurate")] {
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
