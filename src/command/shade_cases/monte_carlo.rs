//! Path-traced shading of a case: one point, nothing in the way, so the first vertex is the whole path.

use super::case_file::Case;
use super::mode::{Precision, REPLICATES};
use glam::Vec3;
use lobelia::light::LightLobe;
use lobelia::material::{SpecularBlend, SpecularLobe};
use lobelia::math::brdf::Facets;
use lobelia::math::ray::{Hit, Intersect, Ray};
use lobelia::math::real::scale;
use lobelia::math::sg;
use lobelia::shade::path_tracer::{PathPoint, PathQuery, PathScene, PathSettings, shade_point};
use lobelia::shade::sampling::lobe_table::LobeTable;
use lobelia::shade::sampling::sobol::Sequence;
use lobelia::shade::sampling::{Scattered, Scatterer, SingleLobe, Strategy, TangentFrame, sample_sg, sg_pdf};

/// Outgoing radiance, diffuse and specular, with its standard errors if it was estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shaded {
    /// Diffuse and specular RGB.
    pub radiance: [[f64; 3]; 2],
    /// One standard error of each.
    pub stderr: Option<[[f64; 3]; 2]>,
}

/// Seed of every table; a case's index is its stream.
const SEED: u64 = 1;

/// Shades `case` with about `samples` ≥ 2 paths, in independent replicates whose spread gives the standard errors.
pub(super) fn path_traced(case: &Case<f64>, index: u64, samples: u32, precision: Precision) -> Shaded {
    let replicates = samples.min(REPLICATES);
    let each = samples.div_ceil(replicates);
    let stream = |replicate: u32| index * u64::from(REPLICATES) + u64::from(replicate);
    match precision {
        Precision::F32 => {
            let case = case.to_f32();
            spread((0..replicates).map(|r| traced_in_f32(&case, stream(r), each)))
        }
        Precision::F64 => {
            let Some(point) = PointInF64::new(case) else {
                return Shaded { radiance: [[0.0; 3]; 2], stderr: Some([[0.0; 3]; 2]) };
            };
            spread((0..replicates).map(|r| point.estimate(stream(r), each)))
        }
    }
}

/// Mean and standard error of at least two independent estimates.
fn spread(estimates: impl ExactSizeIterator<Item = [[f64; 3]; 2]>) -> Shaded {
    let count = estimates.len() as f64;
    let estimates: Vec<_> = estimates.collect();
    let each_value = |f: &dyn Fn(usize, usize) -> f64| [0, 1].map(|part| [0, 1, 2].map(|c| f(part, c)));
    let radiance = each_value(&|part, c| estimates.iter().map(|e| e[part][c]).sum::<f64>() / count);
    let stderr = each_value(&|part, c| {
        let mean = radiance[part][c];
        if mean == 0.0 {
            return 0.0;
        }
        // Relative to the mean, so that squares of tiny values do not underflow.
        let squares: f64 = estimates.iter().map(|e| (e[part][c] / mean - 1.0).powi(2)).sum();
        mean.abs() * (squares / ((count - 1.0) * count)).sqrt()
    });
    Shaded { radiance, stderr: Some(stderr) }
}

/// Space without anything in it.
struct Empty;

impl Intersect for Empty {
    fn intersect(&self, _: &Ray, _: f32) -> Option<Hit> {
        None
    }
    fn occluded(&self, _: &Ray, _: f32, _: f32) -> bool {
        false
    }
}

/// The renderer itself on one point: the code that makes pictures.
fn traced_in_f32(case: &Case<f32>, stream: u64, samples: u32) -> [[f64; 3]; 2] {
    let light = SingleLobe::new(LightLobe {
        axis: case.lobe_axis.into(),
        sharpness: case.lobe_sharpness,
        amplitude: case.lobe_amplitude.into(),
    });
    let specular = [Some(SpecularLobe::new(case.specular.into(), case.roughness))];
    let scene = PathScene {
        surface: &Empty,
        light: &light,
        albedo: &[],
        sheen: &[],
        tilt: &[],
        blends: &[],
        specular: &specular,
    };
    let settings = PathSettings { max_bounces: 1, seed: SEED, ..Default::default() };
    let normal = Vec3::from(case.normal);
    let point = PathPoint {
        position: Vec3::ZERO,
        normal,
        geometric_normal: normal,
        albedo: case.albedo.into(),
        blend: SpecularBlend::default().0,
    };
    let query = PathQuery { point, to_viewer: case.view.into(), stream, first_sample: 0 };
    let estimate = shade_point(&scene, &settings, &query, samples);
    [estimate.diffuse, estimate.specular].map(|v| v.as_dvec3().to_array())
}

/// The same estimator in double precision, with light drawn from tables that reach into the tails.
struct PointInF64<'a> {
    case: &'a Case<f64>,
    scatterer: Scatterer<f64>,
    /// Around the lobe's axis.
    lobe_frame: TangentFrame<f64>,
    /// For the diffuse and for the specular product. The lobe itself is drawn from half of the time, these a quarter each.
    tables: [LobeTable; 2],
}

impl<'a> PointInF64<'a> {
    /// None if the viewer is below the horizon.
    fn new(case: &'a Case<f64>) -> Option<Self> {
        let specular = Some((case.specular, Facets::sg(case.roughness)));
        let scatterer = Scatterer::new(case.normal, case.view, case.albedo, specular)?;
        let table = |mirror| LobeTable::new(case.normal, case.lobe_axis, case.lobe_sharpness, mirror);
        let lobe_frame = TangentFrame::new(case.lobe_axis);
        Some(Self {
            case,
            scatterer,
            lobe_frame,
            tables: [table(None), table(Some((case.view, case.roughness)))],
        })
    }

    fn estimate(&self, stream: u64, samples: u32) -> [[f64; 3]; 2] {
        let mut sums = [[0.0; 3]; 2];
        for sample in 0..samples {
            let sequence = Sequence::new(SEED, stream, sample);
            let drawn = self.draw_light(sequence.group(0));
            self.add(&mut sums, drawn, Strategy::light_weight, |light, _| light);
            if let Some(drawn) = self.scatterer.sample(sequence.group(1)) {
                self.add(&mut sums, drawn, Strategy::brdf_weight, |_, brdf| brdf);
            }
        }
        sums.map(|sum| scale(sum, 1.0 / f64::from(samples)))
    }

    fn draw_light(&self, [pick, u, v]: [f64; 3]) -> [f64; 3] {
        if pick < 0.5 {
            return sample_sg(&self.lobe_frame, self.case.lobe_sharpness, [u, v]);
        }
        let pick = 4.0 * pick - 2.0;
        self.tables[pick as usize].sample([pick.fract(), u, v])
    }

    fn light_pdf(&self, direction: [f64; 3]) -> f64 {
        let lobe = sg_pdf(direction, self.case.lobe_axis, self.case.lobe_sharpness);
        0.5 * lobe + 0.25 * (self.tables[0].pdf(direction) + self.tables[1].pdf(direction))
    }

    /// Adds what light from `direction` is worth, weighted by `weight` and divided by the density that `own` names.
    fn add(
        &self,
        sums: &mut [[f64; 3]; 2],
        direction: [f64; 3],
        weight: fn(Strategy, f64, f64) -> f64,
        own: fn(f64, f64) -> f64,
    ) {
        let Scattered { diffuse, specular, pdf } = self.scatterer.evaluate(direction);
        let light_pdf = self.light_pdf(direction);
        let density = own(light_pdf, pdf);
        // A direction exactly on a seam may have no density; it has no solid angle either.
        if density <= 0.0 {
            return;
        }
        let worth = weight(Strategy::Combined, light_pdf, pdf) / density;
        let light = sg::evaluate(direction, self.case.lobe_axis, self.case.lobe_sharpness) * worth;
        for (sum, part) in sums.iter_mut().zip([diffuse, specular]) {
            for c in 0..3 {
                sum[c] += part[c] * light * self.case.lobe_amplitude[c];
            }
        }
    }
}
