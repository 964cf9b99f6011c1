//! The vector exponential.

use super::{CACHES, POINTS, Turns};
use criterion::{Criterion, Throughput};
use fearless_simd::{Level, Simd, dispatch};
use lobelia_sg::{lanes::Lanes, real::Real};

/// Values of one run.
pub const VALUES: usize = 4096;

#[inline(always)]
fn exp_all<S: Simd>(simd: S, values: &[f32], out: &mut [f32]) {
    let lanes = Lanes::<S>::LEN;
    for (values, out) in values.chunks_exact(lanes).zip(out.chunks_exact_mut(lanes)) {
        Lanes::load(simd, values).exp().store(out);
    }
}

pub fn exp(c: &mut Criterion) {
    let mut group = c.benchmark_group("exp");
    group.throughput(Throughput::Elements(VALUES as u64));
    for (cache, points) in CACHES {
        let len = points / POINTS * VALUES;
        let values: Vec<f32> = (0..len).map(|i| -20.0 * (i % 997) as f32 / 997.0).collect();
        let mut out = vec![0.0; len];
        let mut turns = Turns::new(len);
        group.bench_function(format!("kernel, {cache}"), |b| {
            b.iter(|| {
                let rows = turns.take(VALUES);
                let (values, out) = (&values[rows.clone()], &mut out[rows]);
                dispatch!(Level::new(), simd => exp_all(simd, values, out));
            });
        });
        group.bench_function(format!("plain loop, {cache}"), |b| {
            b.iter(|| {
                let rows = turns.take(VALUES);
                for (x, y) in values[rows.clone()].iter().zip(&mut out[rows]) {
                    *y = x.exp();
                }
            });
        });
    }
}
