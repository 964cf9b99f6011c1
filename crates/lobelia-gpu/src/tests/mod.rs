//! The GPU against the CPU.

mod batch;
mod whole;

use crate::{Gpu, device::NO_ADAPTER, shade::MOST_LOBES};
use batch::{Batch, Results};
use lobelia_sg::shading::{ClosedForm, Layers, Lighting, PairLoops, ShadeCall, SpecularValue};
use lobelia_sg::{accurate::Quality, brdf::Ndf, workload::Workload};
use std::sync::OnceLock;

const FORMS: [ClosedForm; 2] = [ClosedForm::Published, ClosedForm::Accurate(Quality::Default)];
const ROUGHNESS: [f32; 3] = [0.1, 0.3, 0.7];
/// Largest difference between GPU and CPU, relative to the largest value of its kind in the batch,
/// or to the largest sum of magnitudes. An exponent −λ (1 − cos θ) is rounded to λ ε, where λ = 2 /
/// R⁴ is the sharpness of the NDF; how much of that is seen depends on the instructions of both.
fn agreement(roughness: f32) -> f32 {
    1e-4 + 0.1 * f32::EPSILON * 2.0 / roughness.powi(4)
}

/// The GPU of the tests; `None` where there is no adapter.
fn gpu() -> Option<&'static Gpu> {
    static OPEN: OnceLock<Option<Gpu>> = OnceLock::new();
    let open = || match Gpu::open(None) {
        Ok(gpu) => Some(gpu),
        Err(error) if error == NO_ADAPTER => {
            eprintln!("skipped: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    };
    OPEN.get_or_init(open).as_ref()
}

#[test]
fn gpu_agrees_with_cpu() {
    let Some(gpu) = gpu() else { return };
    for form in FORMS {
        for (roughness, lobes) in ROUGHNESS.into_iter().flat_map(|r| [1, 21, 128].map(|n| (r, n))) {
            let batch = Batch::new(300, lobes, roughness);
            for (kind, lighting) in ["open", "around", "rows"].into_iter().zip(batch.lightings()) {
                let cpu = Results::cpu(form, true, &batch, lighting);
                let sizes = cpu.magnitudes(form, &batch, lighting);
                let found = Results::gpu(gpu, form, &batch, lighting, &cpu.shaded);
                for (kind_of_value, error) in cpu.errors(&found, &sizes) {
                    let case = format!("{form:?}, R = {roughness}, {lobes} lobes, {kind}");
                    assert!(error < agreement(roughness), "{kind_of_value}: {error} with {case}");
                }
            }
        }
    }
}

#[test]
fn what_the_cpu_leaves_out_is_small() {
    let Some(gpu) = gpu() else { return };
    for (form, roughness) in FORMS.into_iter().flat_map(|form| ROUGHNESS.map(|r| (form, r))) {
        let mut work = Workload::new(1000, 128, roughness);
        work.shade(form);
        let mut own = vec![Layers::default(); work.points.len()];
        let lighting = Lighting::from(&work.lobes);
        let call = ShadeCall { form, points: &work.points, specular: &work.specular, lighting };
        gpu.shade(call, &mut own).unwrap();
        let specular = |layers: &[Layers]| layers.iter().flat_map(|l| l.specular).collect::<Vec<_>>();
        let (cpu, own) = (specular(&work.shaded), specular(&own));
        let apart = cpu.iter().zip(&own).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let brightest = cpu.into_iter().fold(0.0, f32::max);
        assert!(apart < 2e-3 * brightest, "{form:?}, R = {roughness}: {apart} of {brightest}");
    }
}

#[test]
fn two_calls_have_the_same_bits() {
    let Some(gpu) = gpu() else { return };
    for form in FORMS {
        let batch = Batch::new(300, 21, 0.3);
        let [.., lighting] = batch.lightings();
        let shaded = Results::cpu(form, false, &batch, lighting).shaded;
        let first = Results::gpu(gpu, form, &batch, lighting, &shaded);
        // A call of another size in between.
        let other = Batch::new(70, 40, 0.5);
        let between = vec![Layers::default(); 70];
        Results::gpu(gpu, form, &other, other.lightings()[0], &between);
        assert_eq!(first, Results::gpu(gpu, form, &batch, lighting, &shaded));
    }
}

#[test]
fn batches_do_not_change_results() {
    let Some(gpu) = gpu() else { return };
    let mut small = Gpu::open(None).unwrap();
    small.most_bytes = 4096;
    for form in FORMS {
        let batch = Batch::new(300, 21, 0.3);
        let [.., lighting] = batch.lightings();
        let shaded = Results::cpu(form, true, &batch, lighting).shaded;
        let whole = Results::gpu(gpu, form, &batch, lighting, &shaded);
        let parts = Results::gpu(&small, form, &batch, lighting, &shaded);
        assert_eq!((&whole.shaded, &whole.points), (&parts.shaded, &parts.points));
        let errors = whole.errors(&parts, &whole.magnitudes(form, &batch, lighting));
        assert!(errors.iter().all(|(_, error)| *error < 1e-6), "{errors:?}");
    }
    let batch = Batch::new(3, 70, 0.3);
    let mut out = vec![Layers::default(); 3];
    let error = small.shade(batch.call(FORMS[0], batch.lightings()[0]), &mut out).unwrap_err();
    assert_eq!(error, "70 lobes are more than the GPU takes; at most 64");
}

#[test]
fn most_lobes_are_all_summed() {
    let Some(gpu) = gpu() else { return };
    let batch = Batch::new(4, MOST_LOBES, 0.3);
    let [lighting, ..] = batch.lightings();
    for form in FORMS {
        let cpu = Results::cpu(form, true, &batch, lighting);
        let found = Results::gpu(gpu, form, &batch, lighting, &cpu.shaded);
        let errors = cpu.errors(&found, &cpu.magnitudes(form, &batch, lighting));
        assert!(errors.iter().all(|(_, error)| *error < agreement(0.3)), "{errors:?}");
    }
}

#[test]
fn threads_may_share_a_gpu() {
    let Some(gpu) = gpu() else { return };
    let batch = Batch::new(100, 21, 0.3);
    let shade = &|form: ClosedForm| {
        let mut out = vec![Layers::default(); 100];
        gpu.shade(batch.call(form, batch.lightings()[0]), &mut out).unwrap();
        out
    };
    let alone = FORMS.map(shade);
    let together = std::thread::scope(|scope| {
        let threads = FORMS.map(|form| scope.spawn(move || shade(form)));
        threads.map(|thread| thread.join().unwrap())
    });
    assert_eq!(alone, together);
}

#[test]
fn nothing_may_be_empty() {
    let Some(gpu) = gpu() else { return };
    for form in FORMS {
        for (points, lobes) in [(0, 3), (5, 0), (0, 0)] {
            let batch = Batch::new(points, lobes, 0.3);
            for lighting in batch.lightings() {
                let cpu = Results::cpu(form, false, &batch, lighting);
                let found = Results::gpu(gpu, form, &batch, lighting, &cpu.shaded);
                let errors = cpu.errors(&found, &cpu);
                assert!(
                    errors.iter().all(|(_, error)| *error < agreement(0.3)),
                    "{points} {lobes} {errors:?}"
                );
            }
        }
    }
}

#[test]
fn what_is_not_there_is_an_error() {
    let Some(gpu) = gpu() else { return };
    assert!(gpu.supports(ClosedForm::Published, Ndf::Ggx));
    assert!(gpu.supports(ClosedForm::Accurate(Quality::Default), Ndf::Sg));
    let batch = Batch::new(5, 3, 0.3);
    let mut out = vec![Layers::default(); 5];
    for (quality, ndf) in [(Quality::High, Ndf::Sg), (Quality::Default, Ndf::Ggx)] {
        let form = ClosedForm::Accurate(quality);
        assert!(!gpu.supports(form, ndf));
        let specular = &SpecularValue { ndf, ..batch.specular };
        let call = ShadeCall { specular, ..batch.call(form, batch.lightings()[0]) };
        let error = gpu.shade(call, &mut out).unwrap_err();
        assert!(error.ends_with("is not on the GPU; shade on the CPU"), "{error}");
    }
    let error = Gpu::open(Some("no such GPU")).unwrap_err();
    assert!(error.contains("\"no such GPU\"") && error.contains(&gpu.name), "{error}");
    assert_eq!(Gpu::open(Some(&gpu.name.to_uppercase())).unwrap().name, gpu.name);
}
