//! The GPU against the CPU.

use crate::{Adjoints, Gpu, GpuError, time};
use lobelia_math::accurate::Quality;
use lobelia_math::brdf::{Ndf, SpecularValue};
use lobelia_math::columns::{LobeColumns, SharedGradient};
use lobelia_math::lighting::{Lighting, LobeVisibility, PointVisibility};
use lobelia_math::lobe::Lobe;
use lobelia_math::sample::{Layers, PointAdjoint, RadianceAdjoint, RadianceColumns, ShadePoint};
use lobelia_math::shading::ClosedForm;
use rand::{RngExt, SeedableRng, rngs::SmallRng};
use std::sync::OnceLock;

const FORMS: [ClosedForm; 2] = [ClosedForm::Published, ClosedForm::Accurate(Quality::Default)];
const ROUGHNESS: [f32; 3] = [0.1, 0.3, 0.7];
/// Largest difference between GPU and CPU, relative to the largest value of its kind in the batch.
const AGREEMENT: f32 = 1e-4;

/// The GPU of the tests; `None` where there is no adapter.
fn gpu() -> Option<&'static Gpu> {
    static OPEN: OnceLock<Option<Gpu>> = OnceLock::new();
    let open = || match Gpu::open(None) {
        Ok(gpu) => Some(gpu),
        Err(GpuError::NoAdapter) => {
            eprintln!("no GPU adapter: not tested");
            None
        }
        Err(error) => panic!("{error}"),
    };
    OPEN.get_or_init(open).as_ref()
}

/// A batch and its visibility.
struct Batch {
    points: Vec<ShadePoint>,
    lobes: LobeColumns,
    specular: SpecularValue,
    rows: Vec<u8>,
    around: Vec<PointVisibility>,
    adjoint: Vec<RadianceAdjoint>,
}

fn color(rng: &mut SmallRng, low: f32, high: f32) -> [f32; 3] {
    std::array::from_fn(|_| low + (high - low) * rng.random::<f32>())
}

fn direction(rng: &mut SmallRng) -> [f32; 3] {
    loop {
        let v = color(rng, -1.0, 1.0);
        let square: f32 = v.iter().map(|x| x * x).sum();
        if (0.01..1.0).contains(&square) {
            return v.map(|x| x / square.sqrt());
        }
    }
}

fn point(rng: &mut SmallRng, i: usize) -> ShadePoint {
    let (normal, mut to_viewer) = (direction(rng), direction(rng));
    let up: f32 = normal.iter().zip(&to_viewer).map(|(n, v)| n * v).sum();
    match i % 16 {
        // Now and then a ray without a hit, a view along the normal, or one from below.
        3 => return ShadePoint { normal: [0.0; 3], to_viewer, albedo: [0.5; 3] },
        5 => to_viewer = normal,
        7 => {}
        _ if up < 0.0 => to_viewer = to_viewer.map(|v| -v),
        _ => {}
    }
    ShadePoint { normal, to_viewer, albedo: color(rng, 0.0, 1.0) }
}

impl Batch {
    fn new(points: usize, lobes: usize, roughness: f32) -> Self {
        let mut rng = SmallRng::seed_from_u64(7);
        let each = (0..lobes).map(|i| Lobe {
            axis: direction(&mut rng),
            sharpness: [0.5, 4.0, 30.0, 200.0][i % 4] * (0.5 + rng.random::<f32>()),
            amplitude: color(&mut rng, 0.1, 2.0),
        });
        let lobes = LobeColumns::from_lobes(each.collect::<Vec<_>>().into_iter());
        let around = |rng: &mut SmallRng| PointVisibility {
            specular: color(rng, 0.0, 1.2),
            indirect: color(rng, 0.0, 0.4),
        };
        Self {
            points: (0..points).map(|i| point(&mut rng, i)).collect(),
            specular: SpecularValue { albedo: [0.3, 0.2, 0.04], roughness, ndf: Ndf::Sg },
            rows: (0..points * lobes.stride()).map(|_| rng.random::<u8>()).collect(),
            around: (0..points).map(|_| around(&mut rng)).collect(),
            adjoint: (0..points).map(|_| RadianceAdjoint(color(&mut rng, -1.0, 1.0))).collect(),
            lobes,
        }
    }

    /// Without visibility, with that of points, or with both kinds.
    fn lightings(&self) -> [Lighting<'_>; 3] {
        let points = &self.around[..];
        let with =
            |lobes| Lighting { lobes: &self.lobes, visibility: Some(LobeVisibility { lobes, points }) };
        [Lighting::from(&self.lobes), with(&[]), with(&self.rows[..])]
    }

    fn radiance<'a>(&'a self, shaded: &'a [Layers]) -> RadianceColumns<'a> {
        RadianceColumns { shaded, adjoint: &self.adjoint }
    }
}

/// What forward and adjoint kernels compute, by kind.
#[derive(Clone, Debug, Default, PartialEq)]
struct Results {
    shaded: Vec<Layers>,
    points: Vec<PointAdjoint>,
    gradient: Vec<[f32; 7]>,
    material: [f32; 4],
}

impl Results {
    fn new(shaded: Vec<Layers>, points: Vec<PointAdjoint>, shared: &SharedGradient) -> Self {
        let gradient = (0..shared.lobes.len()).map(|i| {
            let Lobe { axis: [x, y, z], sharpness, amplitude: [r, g, b] } = shared.lobes.get(i);
            [x, y, z, sharpness, r, g, b]
        });
        let [r, g, b] = shared.specular.albedo;
        let material = [r, g, b, shared.specular.roughness];
        Self { shaded, points, gradient: gradient.collect(), material }
    }

    fn cpu(form: ClosedForm, batch: &Batch, lighting: Lighting<'_>) -> Self {
        let mut shaded = vec![Layers::default(); batch.points.len()];
        let mut points = vec![PointAdjoint::default(); batch.points.len()];
        let mut shared = SharedGradient::default();
        form.shade(&batch.points, &batch.specular, lighting, &mut shaded);
        let radiance = batch.radiance(&shaded);
        form.shade_adjoint(&batch.points, &batch.specular, lighting, radiance, &mut points, &mut shared);
        Self::new(shaded, points, &shared)
    }

    /// The adjoint at the radiance that the CPU has found, so that the same channels are clamped.
    fn gpu(gpu: &Gpu, form: ClosedForm, batch: &Batch, lighting: Lighting<'_>, shaded: &[Layers]) -> Self {
        let mut own = vec![Layers::default(); batch.points.len()];
        let mut points = vec![PointAdjoint::default(); batch.points.len()];
        let mut shared = SharedGradient::default();
        gpu.shade(form, &batch.points, &batch.specular, lighting, &mut own).unwrap();
        let out = Adjoints { points: &mut points, shared: &mut shared };
        let radiance = batch.radiance(shaded);
        gpu.shade_adjoint(form, &batch.points, &batch.specular, lighting, radiance, out).unwrap();
        Self::new(own, points, &shared)
    }

    /// The values by kind.
    fn kinds(&self) -> [(&'static str, Vec<f32>); 9] {
        let gradient = |r: std::ops::Range<usize>| {
            self.gradient.iter().flat_map(move |g| g[r.clone()].to_vec()).collect()
        };
        [
            ("diffuse", self.shaded.iter().flat_map(|l| l.diffuse).collect()),
            ("specular", self.shaded.iter().flat_map(|l| l.specular).collect()),
            ("albedo", self.points.iter().flat_map(|p| p.albedo).collect()),
            ("normal", self.points.iter().flat_map(|p| p.normal).collect()),
            ("axis", gradient(0..3)),
            ("sharpness", gradient(3..4)),
            ("amplitude", gradient(4..7)),
            ("specular albedo", self.material[..3].to_vec()),
            ("roughness", self.material[3..].to_vec()),
        ]
    }

    /// Largest difference of each kind, relative to its largest value here.
    fn errors(&self, other: &Self) -> Vec<(&'static str, f32)> {
        let largest = |values: &mut dyn Iterator<Item = f32>| values.fold(0.0f32, |a, b| a.max(b.abs()));
        let error = |((kind, own), (_, other)): ((&'static str, Vec<f32>), (&'static str, Vec<f32>))| {
            assert_eq!(own.len(), other.len(), "{kind}");
            assert!(own.iter().chain(&other).all(|x| x.is_finite()), "{kind}");
            let size = largest(&mut own.iter().copied()).max(1e-20);
            (kind, largest(&mut own.iter().zip(&other).map(|(a, b)| a - b)) / size)
        };
        self.kinds().into_iter().zip(other.kinds()).map(error).collect()
    }
}

#[test]
fn gpu_agrees_with_cpu() {
    let Some(gpu) = gpu() else { return };
    eprintln!("on {}", gpu.name());
    let mut wrong = Vec::new();
    for form in FORMS {
        for roughness in ROUGHNESS {
            for lobes in [1, 21, 128] {
                let batch = Batch::new(300, lobes, roughness);
                for (kind, lighting) in ["open", "around", "rows"].into_iter().zip(batch.lightings()) {
                    let cpu = Results::cpu(form, &batch, lighting);
                    let found = Results::gpu(gpu, form, &batch, lighting, &cpu.shaded);
                    let errors = cpu.errors(&found);
                    let case = format!("{form:?} R {roughness} lobes {lobes} {kind}: {errors:?}");
                    eprintln!("{case}");
                    if errors.iter().any(|(_, error)| *error > AGREEMENT) {
                        wrong.push(case);
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn two_calls_have_the_same_bits() {
    let Some(gpu) = gpu() else { return };
    for form in FORMS {
        let batch = Batch::new(300, 21, 0.3);
        let [.., lighting] = batch.lightings();
        let shaded = Results::cpu(form, &batch, lighting).shaded;
        let first = Results::gpu(gpu, form, &batch, lighting, &shaded);
        // A call of another size in between.
        let other = Batch::new(70, 40, 0.5);
        let between = vec![Layers::default(); 70];
        Results::gpu(gpu, form, &other, other.lightings()[0], &between);
        assert_eq!(first, Results::gpu(gpu, form, &batch, lighting, &shaded));
    }
}

#[test]
fn nothing_may_be_empty() {
    let Some(gpu) = gpu() else { return };
    for form in FORMS {
        for (points, lobes) in [(0, 3), (5, 0), (0, 0)] {
            let batch = Batch::new(points, lobes, 0.3);
            for lighting in batch.lightings() {
                let cpu = Results::cpu(form, &batch, lighting);
                let found = Results::gpu(gpu, form, &batch, lighting, &cpu.shaded);
                let errors = cpu.errors(&found);
                assert!(errors.iter().all(|(_, error)| *error < AGREEMENT), "{points} {lobes} {errors:?}");
            }
        }
    }
}

#[test]
fn what_is_not_there_is_an_error() {
    assert!(Gpu::supports(ClosedForm::Published, Ndf::Ggx));
    assert!(Gpu::supports(ClosedForm::Accurate(Quality::Default), Ndf::Sg));
    let missing =
        [(Quality::High, Ndf::Sg), (Quality::Default, Ndf::Ggx)].map(|(q, n)| (ClosedForm::Accurate(q), n));
    assert!(missing.iter().all(|(form, ndf)| !Gpu::supports(*form, *ndf)));
    let Some(gpu) = gpu() else { return };
    let batch = Batch::new(5, 3, 0.3);
    let mut out = vec![Layers::default(); 5];
    for (form, ndf) in missing {
        let specular = SpecularValue { ndf, ..batch.specular };
        let error =
            gpu.shade(form, &batch.points, &specular, Lighting::from(&batch.lobes), &mut out).unwrap_err();
        assert_eq!(error, GpuError::Unsupported { form, ndf });
    }
    let error = Gpu::open(Some("no such GPU")).unwrap_err().to_string();
    assert!(error.contains("\"no such GPU\"") && error.contains(gpu.name()), "{error}");
    let name = gpu.name().to_uppercase();
    assert_eq!(Gpu::open(Some(&name)).unwrap().name(), gpu.name());
    assert_eq!(Gpu::names()[0], gpu.name());
}

#[test]
fn wrong_lengths_are_errors() {
    let Some(gpu) = gpu() else { return };
    let (form, batch) = (ClosedForm::default(), Batch::new(5, 3, 0.3));
    let [open, around, rows] = batch.lightings();
    let call = |lighting: Lighting<'_>, points: usize, out: usize| {
        let mut out = vec![Layers::default(); out];
        gpu.shade(form, &batch.points[..points], &batch.specular, lighting, &mut out).unwrap_err()
    };
    let length = |what, found, expected| GpuError::Length { what, found, expected };
    assert_eq!(call(open, 5, 4), length("radiance", 4, 5));
    assert_eq!(call(around, 4, 4), length("visibility of points", 5, 4));
    let short = Lighting {
        visibility: Some(LobeVisibility { lobes: &batch.rows[1..], points: &batch.around }),
        ..rows
    };
    assert_eq!(call(short, 5, 5), length("visibility of lobes", 79, 80));
    let shaded = vec![Layers::default(); 5];
    let mut shared = SharedGradient::default();
    let out = Adjoints { points: &mut [], shared: &mut shared };
    let radiance = batch.radiance(&shaded);
    let error = gpu.shade_adjoint(form, &batch.points, &batch.specular, open, radiance, out).unwrap_err();
    assert_eq!(error, length("adjoints of points", 0, 5));
}

#[test]
fn pairs_take_time() {
    let Some(gpu) = gpu() else { return };
    let (forward, adjoint) = time(gpu, ClosedForm::default(), 100, 3, 0.3, 0.0).unwrap();
    assert!(forward > 0.0 && adjoint > 0.0);
}
