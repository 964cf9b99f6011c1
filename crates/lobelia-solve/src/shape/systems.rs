//! The systems that fit an SDF: retrace, propagate adjoints, smooth, update. Each fetches columns
//! and calls a kernel.

use crate::fit::cameras::{AlignedRow, CameraFit, CameraPose, FIRST_STEP, add_rows, retrace};
use crate::fit::guard::{StepGuard, is_usable};
use crate::fit::loss::{coded_luminance, radiance};
use crate::fit::{components::StepRates, exposure::Exposures};
use crate::shape::field::{
    BAND_CELLS, BrickAt, ModelError, RunValues, SampleAdjoint, SdfField, VertexRun, each, write_runs,
};
use crate::shape::silhouette::{SilhouetteSamples, aligned_silhouette, loss_derivative};
use bevy_ecs::prelude::{Query, Res, ResMut, Resource, With};
use glam::{Vec3, Vec4};
use lobelia_geometry::view::{ByView, Camera, Photograph, ViewIndex};
use lobelia_geometry::{parallel, sdf::SdfGrid};
use lobelia_sg::shading::{Layers, PointAdjoint};
use lobelia_world::material::{Diffuse, Texels};
use lobelia_world::pipeline::SystemResult;
use lobelia_world::sample::pixel::{Observed, PixelOf, ViewRay};
use lobelia_world::sample::{Samples, point::SurfacePoint};
use std::ops::Range;

/// Schedule of the optimization of the shape.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct ShapeSchedule {
    /// Steps of the fit.
    pub steps: u32,
    /// Steps before the shape changes.
    pub hold: u32,
    /// Root-mean-square step of a value at the first and the last step, in cells.
    pub rates: (f32, f32),
    /// Weight of the silhouette loss relative to the image loss.
    pub silhouette: f32,
    /// Silhouette rays per step.
    pub silhouette_batch: usize,
    /// Weight of the squared Laplacian of the field at the end; it starts at `FIRST_SMOOTHNESS`
    /// times that.
    pub smoothness: f32,
    /// Rounds of averaging the gradient over neighbors.
    pub blur: u32,
    /// Steps between two redistancings.
    pub redistance_every: u32,
}

impl ShapeSchedule {
    /// Completed fraction of the steps that change the shape, in [0, 1]; `None` while the shape is
    /// fixed.
    fn progress(&self, step: u32) -> Option<f32> {
        let moving = self.steps.saturating_sub(self.hold).max(1) as f32;
        (step > self.hold).then(|| (step - self.hold) as f32 / moving)
    }

    /// Rows of the `count` silhouette samples that a step visits.
    fn silhouette_rows(&self, step: u32, count: usize) -> Range<usize> {
        let batch = self.silhouette_batch.clamp(1, count.max(1));
        let start = (step as usize - 1) % count.div_ceil(batch).max(1) * batch;
        start..(start + batch).min(count)
    }
}

/// Weight of the smoothness at the start of a level, relative to that at its end.
const FIRST_SMOOTHNESS: f32 = 10.0;

/// Trace: intersects the rays of the window with the current field.
pub fn retrace_window(field: Res<SdfField>, samples: Samples<(&ViewRay, &mut SurfacePoint)>) -> SystemResult {
    retrace(&field.surface, samples)
}

/// Gradient: propagates the normal and albedo adjoints of the samples to the field.
pub fn pull_back_to_field(
    rates: Res<StepRates>,
    schedule: Res<ShapeSchedule>,
    samples: Samples<(&SurfacePoint, &ViewRay, &PointAdjoint)>,
    texels: Texels<&Diffuse>,
    mut field: ResMut<SdfField>,
) -> SystemResult {
    if schedule.progress(rates.step).is_none() {
        return Ok(());
    }
    let texels = texels.columns()?;
    let (points, rays, back) = samples.columns()?;
    let SdfField { surface, adjoint, .. } = &mut *field;
    let limit = OUTLIER * root_mean_square(&back);
    let pulled = |i: usize| {
        let (point, ray, back) = (&points[i], &rays[i], &back[i]);
        let by_normal = Vec3::from(back.normal).clamp_length_max(limit);
        let along = Vec3::from(back.albedo);
        let value = |row: u32| texels[row as usize].albedo.dot(along);
        let by_position = surface.volume.gradient(point.position, &point.texels, value);
        SampleAdjoint::new(&surface.grid, point.position, ray.0.direction, by_normal, by_position)
    };
    let pulled: Vec<SampleAdjoint> =
        parallel::flat_map(points.len(), 64, |i| points[i].is_hit().then(|| pulled(i)));
    pulled.iter().for_each(|sample| adjoint.add(&surface.grid, sample));
    Ok(())
}

/// Gradient: sums the squared error of the window's samples around their surface points, in the
/// second half of a level.
pub(crate) fn sum_model_error(
    rates: Res<StepRates>,
    schedule: Res<ShapeSchedule>,
    exposures: Res<Exposures>,
    samples: Samples<(&SurfacePoint, &Layers, &Observed, &PixelOf)>,
    mut error: ResMut<ModelError>,
) -> SystemResult {
    if schedule.progress(rates.step).is_none_or(|progress| progress < 0.5) {
        return Ok(());
    }
    let (points, shaded, observed, pixels) = samples.columns()?;
    for (i, point) in points.iter().enumerate().filter(|(_, point)| point.is_hit()) {
        let shown = coded_luminance(exposures.factor(pixels[i].view) * radiance(&shaded[i]));
        error.add(point.position, (shown - coded_luminance(observed[i].radiance)).powi(2));
    }
    Ok(())
}

/// Largest normal adjoint of a sample, relative to the root mean square of the window: otherwise a
/// few samples at the edge of a sharp highlight dominate and dent the surface.
pub(super) const OUTLIER: f32 = 1.5;

pub(super) fn root_mean_square(back: &[PointAdjoint]) -> f32 {
    let sum: f64 = back.iter().map(|b| f64::from(Vec3::from(b.normal).length_squared())).sum();
    (sum / back.len().max(1) as f64).sqrt() as f32
}

/// Trace: casts the silhouette rays of this step through the current cameras.
pub fn recast_silhouettes(
    rates: Res<StepRates>,
    schedule: Res<ShapeSchedule>,
    views: Query<(&ViewIndex, &Camera), With<Photograph>>,
    mut samples: ResMut<SilhouetteSamples>,
) -> SystemResult {
    let cameras: ByView<&Camera> = views.iter().map(|(index, camera)| (*index, camera)).collect();
    let rows = schedule.silhouette_rows(rates.step, samples.0.len());
    for sample in &mut samples.0[rows] {
        sample.ray = cameras.of(sample.pixel.view)?.pixel_ray(sample.pixel.pixel);
    }
    Ok(())
}

/// Gradient: adds the distances between the silhouettes of masks and field to the normal equations
/// of the cameras.
pub fn align_silhouettes(
    rates: Res<StepRates>,
    schedule: Res<ShapeSchedule>,
    field: Res<SdfField>,
    mut fit: ResMut<CameraFit>,
    mut guard: ResMut<StepGuard>,
    mut views: Query<(&ViewIndex, &Camera, &mut CameraPose), With<Photograph>>,
    samples: Res<SilhouetteSamples>,
) -> SystemResult {
    let Some(center) = fit.center.filter(|_| rates.step >= FIRST_STEP) else { return Ok(()) };
    let mut views: ByView<_> = views.iter_mut().map(|view| (*view.0, view)).collect();
    let grid = &field.surface.grid;
    let samples = &samples.0[schedule.silhouette_rows(rates.step, samples.0.len())];
    let row = |i: usize| {
        let sample = &samples[i];
        let (_, camera, _) = views.of(sample.pixel.view).ok()?;
        Some((sample.pixel.view, aligned_silhouette(grid, camera, center, sample)?))
    };
    let rows: Vec<(ViewIndex, AlignedRow)> = parallel::flat_map(samples.len(), 64, row);
    add_rows(1, &rows, &mut fit, &mut guard, &mut views)?;
    Ok(())
}

/// Gradient: propagates the silhouette loss to the field.
pub fn pull_back_silhouettes(
    rates: Res<StepRates>,
    schedule: Res<ShapeSchedule>,
    samples: Res<SilhouetteSamples>,
    mut field: ResMut<SdfField>,
) {
    let Some(progress) = schedule.progress(rates.step) else { return };
    let samples = &samples.0[schedule.silhouette_rows(rates.step, samples.0.len())];
    // The width decreases from four pixels to one, from robust to precise.
    let width = 4.0 - 3.0 * progress;
    let SdfField { surface, adjoint, .. } = &mut *field;
    let derivative = |sample| loss_derivative(&surface.grid, sample, width);
    let derivatives: Vec<_> = parallel::map_slice(samples, 64, derivative);
    let each = schedule.silhouette / samples.len().max(1) as f32;
    for (position, derivative) in derivatives.into_iter().flatten() {
        adjoint.add_value(&surface.grid, position, each * derivative);
    }
}

/// Gradient: writes the gradient of the values in bricks, with the smoothness term, blurred, and
/// looks for those that are not finite; clears the adjoints.
pub fn smooth_gradient(
    rates: Res<StepRates>,
    schedule: Res<ShapeSchedule>,
    mut field: ResMut<SdfField>,
    mut guard: ResMut<StepGuard>,
) {
    let Some(progress) = schedule.progress(rates.step) else { return };
    let SdfField { surface, adjoint, scratch, bricks: at, .. } = &mut *field;
    let (grid, [from, to]) = (&surface.grid, &mut *scratch);
    // The gradient of the squared Laplacian is the Laplacian of the Laplacian.
    fill(grid, at, from, |run| laplacian(grid, run, &grid.values));
    let relaxed = schedule.smoothness * FIRST_SMOOTHNESS.powf(1.0 - progress);
    let smoothness = relaxed / (grid.spacing * grid.spacing);
    fill(grid, at, to, |run| {
        let curved = laplacian(grid, run, from);
        let row = |k: usize| adjoint.of_row(grid, run.row + k, run.interior);
        let pulled = |k: usize| if k < run.len { row(k) } else { 0.0 };
        each(|half| {
            Vec4::from_array(std::array::from_fn(|k| pulled(4 * half + k))) + smoothness * curved[half]
        })
    });
    for _ in 0..schedule.blur {
        // Averaged over neighbors.
        scratch.swap(0, 1);
        let [from, to] = scratch;
        fill(grid, at, to, |run| {
            let (own, curved) = (run.of(from), laplacian(grid, run, from));
            each(|half| own[half] + 0.5 * curved[half])
        });
    }
    let gradient = &scratch[1];
    let is_bad = |at: &BrickAt| at.runs(grid).any(|run| !is_usable(&gradient[run.rows()]));
    if let Some(bad) = parallel::map_slice(at, 16, is_bad).into_iter().position(|is_bad| is_bad) {
        let Vec3 { x, y, z } = grid.position(at[bad].0);
        guard.find("the gradient", None, format!("the field near ({x:.3}, {y:.3}, {z:.3})"));
        adjoint.value.fill(0.0);
        adjoint.gradient.fill(Vec3::ZERO);
    } else {
        write_runs(grid, at, &mut adjoint.value, |_, _, values| values.fill(0.0));
        write_runs(grid, at, &mut adjoint.gradient, |_, _, gradients| gradients.fill(Vec3::ZERO));
    }
}

/// The mean of the six neighbors of each vertex of a run minus its own value; 0 near the border.
#[inline(always)]
fn laplacian(grid: &SdfGrid, run: VertexRun, values: &[f32]) -> RunValues {
    if !run.interior {
        return [Vec4::ZERO; 2];
    }
    let (row, side) = (run.row, grid.side as usize);
    let from = |row| VertexRun { row, ..run }.of(values);
    let (left, right, down, up) = (from(row - 1), from(row + 1), from(row - side), from(row + side));
    let (back, front, own) = (from(row - side * side), from(row + side * side), from(row));
    each(|k| (left[k] + right[k] + down[k] + up[k] + back[k] + front[k]) / 6.0 - own[k])
}

/// Writes `values` of every run to `dense` for its vertices in the band, and 0 for all others.
fn fill(grid: &SdfGrid, at: &[BrickAt], dense: &mut [f32], values: impl Fn(VertexRun) -> RunValues + Sync) {
    let reach = Vec4::splat(BAND_CELLS * grid.spacing);
    write_runs(grid, at, dense, |_, run, rows| {
        let is_near = run.of(&grid.values).map(|distance| distance.abs().cmplt(reach));
        if !(is_near[0] | is_near[1]).any() {
            return rows.fill(0.0);
        }
        let values = values(run);
        run.write(each(|half| Vec4::select(is_near[half], values[half], Vec4::ZERO)), rows);
    });
}

/// Decay factor of the running means, per step.
const MEAN_DECAY: f32 = 0.9;
const SQUARE_DECAY: f32 = 0.99;
/// Largest change of a value per step, in cells.
const STEP_LIMIT: f32 = 0.25;

/// Update: momentum steps with one common scale, so that smooth gradients give smooth steps;
/// redistances periodically.
pub fn move_bricks(rates: Res<StepRates>, schedule: Res<ShapeSchedule>, mut field: ResMut<SdfField>) {
    let Some(progress) = schedule.progress(rates.step) else { return };
    let SdfField { surface, scratch: [_, gradient], mean_square, bricks: at, moments, .. } = &mut *field;
    let grid = &mut surface.grid;
    // Mean square of the entries that are not zero.
    let (mut sum, mut entries) = (0.0f64, 0u64);
    for run in at.iter().flat_map(|at| at.runs(grid)) {
        for g in gradient[run.rows()].iter().filter(|g| **g != 0.0) {
            sum += f64::from(g * g);
            entries += 1;
        }
    }
    let count = rates.step - schedule.hold;
    let square = (sum / entries.max(1) as f64) as f32;
    *mean_square = SQUARE_DECAY * *mean_square + (1.0 - SQUARE_DECAY) * square;
    let rms = (*mean_square / (1.0 - SQUARE_DECAY.powi(count as i32))).sqrt().max(1e-20);
    let (first, last) = schedule.rates;
    let h = grid.spacing;
    let scale = first * (last / first).powf(progress) * h / rms;
    parallel::for_each_row((&mut **moments, &**at), 16, |(moments, at)| {
        for run in at.runs(grid) {
            for (mean, g) in moments[run.places()].iter_mut().zip(&gradient[run.rows()]) {
                *mean = MEAN_DECAY * *mean + (1.0 - MEAN_DECAY) * g;
            }
        }
    });
    let mut values = std::mem::take(&mut grid.values);
    write_runs(grid, at, &mut values, |brick, run, rows| {
        for (value, mean) in rows.iter_mut().zip(&moments[brick][run.places()]) {
            *value -= (scale * mean).clamp(-STEP_LIMIT * h, STEP_LIMIT * h);
        }
    });
    grid.values = values;
    if count.is_multiple_of(schedule.redistance_every) {
        grid.redistance_near();
    }
}
