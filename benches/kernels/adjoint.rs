//! Radiance again, and its adjoint to points, lobes and specular material.

use super::{CACHES, LOBES, POINTS, Turns, plain, workload};
use criterion::{Criterion, Throughput};
use lobelia_sg::shading::{ClosedForm, RadianceColumns};

pub fn adjoint(c: &mut Criterion) {
    let mut group = c.benchmark_group("shade adjoint");
    group.throughput(Throughput::Elements((POINTS * LOBES) as u64));
    for (cache, points) in CACHES {
        let mut work = workload(points);
        work.shade(ClosedForm::Published);
        let lobes = plain::lobes(&work.lobes);
        let mut turns = Turns::new(points);
        for (form, name) in [(ClosedForm::Published, "published"), (ClosedForm::default(), "accurate")] {
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
