//! Random points, lobes and visibilities, and what kernels make of them.

use super::whole::Whole;
use crate::Gpu;
use lobelia_sg::shading::*;
use lobelia_sg::{accurate::ACCURATE_DEFAULT, brdf::Ndf, sg::Lobe};
use rand::{RngExt, SeedableRng, rngs::SmallRng};

/// A batch and its visibility.
pub struct Batch {
    pub points: Vec<ShadePoint>,
    pub lobes: LobeColumns,
    pub specular: SpecularValue,
    pub rows: Vec<u8>,
    pub around: Vec<PointVisibility>,
    pub adjoint: Vec<RadianceAdjoint>,
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
    pub fn new(points: usize, lobes: usize, roughness: f32) -> Self {
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
    pub fn lightings(&self) -> [Lighting<'_>; 3] {
        let points = &self.around[..];
        let with =
            |lobes| Lighting { lobes: &self.lobes, visibility: Some(LobeVisibility { lobes, points }) };
        [Lighting::from(&self.lobes), with(&[]), with(&self.rows[..])]
    }

    /// The call that shades the batch.
    pub fn call<'a>(&'a self, form: ClosedForm, lighting: Lighting<'a>) -> ShadeCall<'a> {
        ShadeCall { form, points: &self.points, specular: &self.specular, lighting }
    }

    pub fn radiance<'a>(&'a self, shaded: &'a [Layers]) -> RadianceColumns<'a> {
        RadianceColumns { shaded, adjoint: &self.adjoint }
    }

    /// Only point `i`, and `lighting` there.
    fn alone<'a>(&self, i: usize, lighting: Lighting<'a>) -> (Self, Lighting<'a>) {
        let stride = self.lobes.stride();
        let one = Self {
            points: vec![self.points[i]],
            lobes: self.lobes.clone(),
            specular: self.specular,
            rows: Vec::new(),
            around: Vec::new(),
            adjoint: vec![self.adjoint[i]],
        };
        let visibility = lighting.visibility.map(|v| LobeVisibility {
            lobes: if v.lobes.is_empty() { v.lobes } else { &v.lobes[i * stride..(i + 1) * stride] },
            points: &v.points[i..=i],
        });
        (one, Lighting { visibility, ..lighting })
    }
}

/// Results of the forward and adjoint kernels.
#[derive(Clone, Debug, PartialEq)]
pub struct Results {
    pub shaded: Vec<Layers>,
    pub points: Vec<PointAdjoint>,
    /// Per lobe.
    pub lobes: Vec<[f32; 7]>,
    pub material: [f32; 4],
}

/// A kind of values and the values.
type Kind = (&'static str, Vec<f32>);

impl Results {
    fn new(shaded: Vec<Layers>, points: Vec<PointAdjoint>, shared: &SharedGradient) -> Self {
        let lobes = (0..shared.lobes.len()).map(|i| {
            let Lobe { axis: [x, y, z], sharpness, amplitude: [r, g, b] } = shared.lobes.get(i);
            [x, y, z, sharpness, r, g, b]
        });
        let [r, g, b] = shared.specular.albedo;
        Self { shaded, points, lobes: lobes.collect(), material: [r, g, b, shared.specular.roughness] }
    }

    /// By the closed form as it is, or (`whole`) with every pair.
    pub fn cpu(form: ClosedForm, whole: bool, batch: &Batch, lighting: Lighting<'_>) -> Self {
        let model = Whole(ACCURATE_DEFAULT);
        let whole = whole && form != ClosedForm::Published;
        let (inputs, specular) = (&batch.points[..], &batch.specular);
        let mut shaded = vec![Layers::default(); inputs.len()];
        let mut points = vec![PointAdjoint::default(); inputs.len()];
        let mut shared = SharedGradient::default();
        if whole {
            shade_with(model, inputs, specular, lighting, &mut shaded);
            let radiance = batch.radiance(&shaded);
            shade_adjoint_with(model, inputs, specular, lighting, radiance, &mut points, &mut shared);
        } else {
            form.shade(inputs, specular, lighting, &mut shaded);
            let radiance = batch.radiance(&shaded);
            form.shade_adjoint(inputs, specular, lighting, radiance, &mut points, &mut shared);
        }
        Self::new(shaded, points, &shared)
    }

    /// The adjoint at the radiance that the CPU has found, so that the same channels are clamped.
    pub fn gpu(
        gpu: &Gpu,
        form: ClosedForm,
        batch: &Batch,
        lighting: Lighting<'_>,
        shaded: &[Layers],
    ) -> Self {
        let call = batch.call(form, lighting);
        let mut own = vec![Layers::default(); shaded.len()];
        let mut points = vec![PointAdjoint::default(); shaded.len()];
        let (mut sums, mut shared) = (ChunkSums::default(), SharedGradient::default());
        gpu.shade(call, &mut own).unwrap();
        gpu.shade_adjoint(call, batch.radiance(shaded), &mut points, &mut sums).unwrap();
        sums.total_into(&mut shared);
        Self::new(own, points, &shared)
    }

    /// These with every sum over points replaced by the sum of its magnitudes.
    pub fn magnitudes(&self, form: ClosedForm, batch: &Batch, lighting: Lighting<'_>) -> Self {
        let mut sums = Self { lobes: vec![[0.0; 7]; self.lobes.len()], material: [0.0; 4], ..self.clone() };
        for i in 0..batch.points.len() {
            let (one, lighting) = batch.alone(i, lighting);
            let part = Self::cpu(form, true, &one, lighting);
            let pairs = sums.lobes.as_flattened_mut().iter_mut().zip(part.lobes.as_flattened());
            for (sum, value) in pairs.chain(sums.material.iter_mut().zip(&part.material)) {
                *sum += value.abs();
            }
        }
        sums
    }

    /// The values by kind.
    fn kinds(&self) -> [Kind; 9] {
        let of_lobes = |first: usize, last: usize| {
            self.lobes.iter().flat_map(|g| g[first..last].iter().copied()).collect()
        };
        [
            ("diffuse", self.shaded.iter().flat_map(|l| l.diffuse).collect()),
            ("specular", self.shaded.iter().flat_map(|l| l.specular).collect()),
            ("albedo", self.points.iter().flat_map(|p| p.albedo).collect()),
            ("normal", self.points.iter().flat_map(|p| p.normal).collect()),
            ("axis", of_lobes(0, 3)),
            ("sharpness", of_lobes(3, 4)),
            ("amplitude", of_lobes(4, 7)),
            ("specular albedo", self.material[..3].to_vec()),
            ("roughness", self.material[3..].to_vec()),
        ]
    }

    /// Largest difference from `other` of each kind, relative to the largest value of that kind in
    /// `sizes`.
    pub fn errors(&self, other: &Self, sizes: &Self) -> Vec<(&'static str, f32)> {
        let largest = |values: &[f32]| values.iter().fold(0.0f32, |a, b| a.max(b.abs()));
        let mut errors = Vec::new();
        for (((kind, own), (_, other)), (_, sizes)) in
            self.kinds().into_iter().zip(other.kinds()).zip(sizes.kinds())
        {
            assert_eq!(own.len(), other.len(), "{kind}");
            assert!(own.iter().chain(&other).all(|x| x.is_finite()), "{kind}");
            let apart: Vec<f32> = own.iter().zip(&other).map(|(a, b)| a - b).collect();
            errors.push((kind, largest(&apart) / largest(&sizes).max(1e-20)));
        }
        errors
    }
}
