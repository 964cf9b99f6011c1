//! How long a pair takes.

use crate::device::Gpu;
use crate::error::GpuError;
use crate::shade::Adjoints;
use lobelia_math::lighting::Lighting;
use lobelia_math::sample::RadianceColumns;
use lobelia_math::shading::ClosedForm;
use lobelia_math::workload::Workload;
use std::time::{Duration, Instant};

/// Least time of a pair in ns over repeated calls, forward and forward with adjoint (a call of [`Gpu::shade_adjoint`], which computes the
/// light again), of [`Workload::new`] with this many points and lobes and this roughness. Each of the two is repeated for `seconds`, and
/// at least twice after a first call that compiles.
///
/// A call lasts until its results are in memory, so copies to the device and back count.
pub fn time(
    gpu: &Gpu,
    form: ClosedForm,
    points: usize,
    lobes: usize,
    roughness: f32,
    seconds: f64,
) -> Result<(f64, f64), GpuError> {
    let mut work = Workload::new(points, lobes, roughness);
    let forward = least_ns(seconds, || {
        gpu.shade(form, &work.points, &work.specular, Lighting::from(&work.lobes), &mut work.shaded)
    })?;
    let radiance = RadianceColumns { shaded: &work.shaded, adjoint: &work.adjoint };
    let adjoint = least_ns(seconds, || {
        let out = Adjoints { points: &mut work.point_adjoint, shared: &mut work.gradient };
        let lighting = Lighting::from(&work.lobes);
        gpu.shade_adjoint(form, &work.points, &work.specular, lighting, radiance, out)
    })?;
    let pairs = (points * lobes).max(1) as f64;
    Ok((forward / pairs, adjoint / pairs))
}

/// The least time of `call` in ns.
fn least_ns(seconds: f64, mut call: impl FnMut() -> Result<(), GpuError>) -> Result<f64, GpuError> {
    call()?;
    let started = Instant::now();
    let (mut least, mut repetitions) = (Duration::MAX, 0);
    while repetitions < 2 || started.elapsed().as_secs_f64() < seconds {
        let before = Instant::now();
        call()?;
        least = least.min(before.elapsed());
        repetitions += 1;
    }
    Ok(least.as_secs_f64() * 1e9)
}
