//! The systems of the Gather stage between its slots, and those for
//! [`Slot::Shading`](lobelia_world::pipeline::Slot::Shading); each fetches columns and calls a
//! kernel. To change from a closed form to the path tracer is to swap one of these for another.

use crate::shade::device::{ShadingDevice, failed, loops_of};
use crate::shade::path_tracer::{PathEstimate, PathPoint, PathQuery, PathScene, PathSettings, shade_points};
use crate::visibility::WindowVisibility;
use bevy_ecs::prelude::{IntoScheduleConfigs, Res};
use bevy_ecs::{schedule::ScheduleConfigs, system::ScheduleSystem};
use glam::{Mat3, Vec3};
use lobelia_geometry::{error::Error, parallel};
use lobelia_sg::shading::{
    ClosedForm, Layers, Lighting, LobeVisibility, PointVisibility, ShadeCall, ShadePoint, SpecularValue,
};
use lobelia_world::material::material_source::{BaseMaterials, ColumnOf, Holds, MaterialSource};
use lobelia_world::material::{Diffuse, MAX_SPECULAR_LOBES, Shown, SpecularBlend, SpecularLobe, Texels};
use lobelia_world::sample::pixel::{PixelOf, SampleIndex, ViewRay};
use lobelia_world::sample::point::{PointBlend, Scenery, SurfacePoint};
use lobelia_world::sample::{LightRotations, Samples};
use lobelia_world::{light::lights::IncidentLight, pipeline::SystemResult, pipeline::pool::Columns};

/// Settings of path tracing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathTracing {
    /// Paths per pixel sample.
    pub paths_per_sample: u32,
    /// Most surface hits of a path; 1 is direct light only.
    pub max_bounces: u32,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Samples per pixel, which share its random sequence.
    pub samples_per_pixel: u32,
}

/// The specular lobe as the kernels read it.
pub fn kernel_specular(lobe: &SpecularLobe) -> SpecularValue {
    SpecularValue { albedo: lobe.albedo.into(), roughness: lobe.roughness, ndf: lobe.ndf }
}

/// The base materials of this run as the kernels read them, with their numbers.
pub fn kernel_materials(materials: &BaseMaterials) -> Vec<(usize, SpecularValue)> {
    materials.by_number().map(|(number, lobe)| (number, kernel_specular(lobe))).collect()
}

/// Gather: interpolates the texels of a material at each surface point into the inputs of shading,
/// in the light's frame.
pub fn gather_points<M: MaterialSource>(
    texels: Texels<&ColumnOf<M, Diffuse>>,
    turns: LightRotations,
    samples: Samples<(&SurfacePoint, &ViewRay, &PixelOf, &mut ShadePoint)>,
) -> SystemResult {
    let texels = texels.columns()?;
    let turns = turns.by_view();
    let (points, rays, pixels, mut gathered) = samples.columns()?;
    let columns = ((&mut *gathered, &*points), (&*rays, &*pixels));
    parallel::for_each_row(columns, 1024, |((out, point), (ray, pixel))| {
        *out = ShadePoint::default();
        if !point.is_hit() {
            return;
        }
        let to_viewer = -ray.0.direction;
        let mixed = Diffuse::mixed(&point.texels, |texel| texels[texel].value());
        let albedo = mixed.toward(point.normal, to_viewer).into();
        *out = ShadePoint { normal: point.normal.into(), to_viewer: to_viewer.into(), albedo };
        if let Some(turn) = turns.get(pixel.view) {
            *out = turned(out, *turn);
        }
    });
    Ok(())
}

/// A point with its directions rotated into the light's frame.
pub fn turned(point: &ShadePoint, light_from_world: Mat3) -> ShadePoint {
    let turned = |direction: [f32; 3]| (light_from_world * Vec3::from(direction)).into();
    ShadePoint { normal: turned(point.normal), to_viewer: turned(point.to_viewer), ..*point }
}

/// Gather: interpolates the weights of the base materials at each surface point, if there are
/// several.
pub fn gather_blends<M: MaterialSource>(
    materials: Res<BaseMaterials>,
    texels: Texels<&ColumnOf<M, SpecularBlend>>,
    samples: Samples<(&SurfacePoint, &mut PointBlend)>,
) -> SystemResult {
    if !materials.blended {
        return Ok(());
    }
    let texels = texels.columns()?;
    let (points, mut blends) = samples.columns()?;
    for (blend, point) in blends.iter_mut().zip(&*points) {
        if point.is_hit() {
            let weight = |k: usize, i: usize| {
                texels[point.texels.indices[i] as usize].value().0[k] * point.texels.weights[i]
            };
            blend.0 = std::array::from_fn(|k| (0..4).map(|i| weight(k, i)).sum());
        }
    }
    Ok(())
}

/// The columns that closed-form shading reads and writes.
type ShadeColumns = (&'static ShadePoint, &'static PointBlend, &'static PointVisibility, &'static mut Layers);

/// For [`Slot::Shading`](lobelia_world::pipeline::Slot::Shading): shades with this closed form,
/// with the shadows and interreflection from `Slot::Visibility`.
pub fn shade_closed_form(form: ClosedForm) -> ScheduleConfigs<ScheduleSystem> {
    let system = move |light: Res<IncidentLight>,
                       materials: Res<BaseMaterials>,
                       visibility: Option<Res<WindowVisibility>>,
                       device: Option<Res<ShadingDevice>>,
                       samples: Samples<ShadeColumns>|
          -> SystemResult {
        let (points, blends, seen, mut shaded) = samples.columns()?;
        let visibility = visibility.as_ref().and_then(|visibility| visibility.view(&seen));
        let lighting = Lighting { lobes: &light.lobes, visibility };
        if let ([(_, one)], false) = (kernel_materials(&materials).as_slice(), materials.blended) {
            let call = ShadeCall { form, points: &points, specular: one, lighting };
            loops_of(device.as_ref(), form, one.ndf).shade(call, &mut shaded).map_err(failed)?;
            return Ok(());
        }
        shade_materials(form, &points, &blends, &materials, lighting, &mut shaded);
        Ok(())
    };
    system.into_configs()
}

/// Shades points with the base materials that they show.
pub(crate) fn shade_materials(
    form: ClosedForm,
    points: &[ShadePoint],
    blends: &[PointBlend],
    materials: &BaseMaterials,
    lighting: Lighting<'_>,
    shaded: &mut [Layers],
) {
    match kernel_materials(materials).as_slice() {
        [] => shaded.fill(Layers::default()),
        [(_, one)] if !materials.blended => form.shade(points, one, lighting, shaded),
        many => shade_blended(form, points, blends, many, lighting, shaded),
    }
}

/// The points where one of the base materials has a weight.
pub(crate) struct Showing {
    /// Their indices, ascending.
    pub numbers: Vec<usize>,
    /// The points.
    pub points: Vec<ShadePoint>,
    /// Their visibility.
    pub seen: Vec<PointVisibility>,
    rows: Vec<u8>,
}

impl Showing {
    /// Selects the `points` where the material at this `place` among `materials` has a weight. The
    /// first material also gets the points without any weight, for their diffuse light.
    pub fn new(
        points: &[ShadePoint],
        blends: &[PointBlend],
        lighting: Lighting<'_>,
        materials: &[(usize, SpecularValue)],
        place: usize,
    ) -> Self {
        let has = |blend: &PointBlend, place: usize| blend.0[materials[place].0] > 0.0;
        let has_none = |blend: &PointBlend| !(0..materials.len()).any(|place| has(blend, place));
        let shows = |blend: &PointBlend| has(blend, place) || (place == 0 && has_none(blend));
        let numbers: Vec<usize> = (0..points.len()).filter(|&i| shows(&blends[i])).collect();
        let stride = lighting.lobes.stride();
        let row = |i: &usize| LobeVisibility::point(lighting.visibility, *i, stride);
        Self {
            points: numbers.iter().map(|&i| points[i]).collect(),
            rows: numbers.iter().flat_map(|i| row(i).0.unwrap_or_default()).copied().collect(),
            seen: numbers.iter().map(|i| row(i).1).collect(),
            numbers,
        }
    }

    /// The lighting of these points.
    pub fn lighting<'a>(&'a self, all: Lighting<'a>) -> Lighting<'a> {
        let visibility = LobeVisibility { lobes: &self.rows, points: &self.seen };
        Lighting { visibility: all.visibility.map(|_| visibility), ..all }
    }
}

/// Shades once per base material and blends by the weights of the points.
fn shade_blended(
    form: ClosedForm,
    points: &[ShadePoint],
    blends: &[PointBlend],
    materials: &[(usize, SpecularValue)],
    lighting: Lighting<'_>,
    shaded: &mut [Layers],
) {
    shaded.fill(Layers::default());
    let mut one = Vec::new();
    for (place, (k, material)) in materials.iter().enumerate() {
        let part = Showing::new(points, blends, lighting, materials, place);
        one.resize(part.numbers.len(), Layers::default());
        form.shade(&part.points, material, part.lighting(lighting), &mut one);
        for (i, one) in part.numbers.iter().zip(&one) {
            let (sum, weight) = (&mut shaded[*i], blends[*i].0[*k]);
            sum.diffuse = one.diffuse;
            sum.specular = std::array::from_fn(|c| sum.specular[c] + weight * one.specular[c]);
        }
    }
}

/// The columns that path tracing reads and writes.
type PathColumns = (
    &'static SampleIndex,
    &'static PixelOf,
    (&'static SurfacePoint, &'static ViewRay),
    &'static ShadePoint,
    &'static PointBlend,
    &'static mut Layers,
);

/// For [`Slot::Shading`](lobelia_world::pipeline::Slot::Shading): shades by path tracing, with
/// shadows, interreflection and noise.
pub fn shade_path_traced(paths: PathTracing) -> ScheduleConfigs<ScheduleSystem> {
    let system = move |scenery: Res<Scenery>,
                       light: Res<IncidentLight>,
                       materials: Res<BaseMaterials>,
                       texels: Texels<(&Shown<Diffuse>, &Shown<SpecularBlend>)>,
                       samples: Samples<PathColumns>|
          -> SystemResult {
        let Some(distant) = &light.distant else {
            return Err(Error::run("path tracing", "there is no light").into());
        };
        let (diffuse, blends) = texels.columns()?;
        let mut specular = [None; MAX_SPECULAR_LOBES];
        materials.by_number().for_each(|(number, lobe)| specular[number] = Some(*lobe));
        let count = materials.lobes.last().map_or(0, |(number, _)| number + 1);
        let scene = PathScene {
            surface: scenery.0.as_ref(),
            light: distant.as_ref(),
            diffuse: &diffuse,
            blends: if materials.blended { &blends } else { &[] },
            specular: &specular[..count],
        };
        trace_paths(&scene, &paths, samples.columns()?);
        Ok(())
    };
    system.into_configs()
}

/// Traces the paths of the samples that met the surface; the others get none.
fn trace_paths(scene: &PathScene, paths: &PathTracing, columns: <PathColumns as Columns>::Slices<'_>) {
    let (index, pixels, (points, rays), gathered, weights, mut shaded) = columns;
    let hits: Vec<usize> = (0..points.len()).filter(|&i| points[i].is_hit()).collect();
    let query = |&i: &usize| PathQuery {
        point: PathPoint {
            position: points[i].position,
            normal: points[i].normal,
            geometric_normal: points[i].geometric_normal,
            albedo: gathered[i].albedo.into(),
            blend: weights[i].0,
        },
        to_viewer: -rays[i].0.direction,
        stream: u64::from(pixels[i].view.0) << 32 | u64::from(pixels[i].pixel),
        first_sample: index[i].0 % paths.samples_per_pixel * paths.paths_per_sample,
    };
    let queries: Vec<PathQuery> = hits.iter().map(query).collect();
    let mut estimates = vec![PathEstimate::default(); queries.len()];
    let settings =
        PathSettings { max_bounces: paths.max_bounces, seed: paths.seed, ..PathSettings::default() };
    shade_points(scene, &settings, &queries, paths.paths_per_sample, &mut estimates);
    shaded.fill(Layers::default());
    for (i, estimate) in hits.into_iter().zip(estimates) {
        shaded[i] = Layers { diffuse: estimate.diffuse.into(), specular: estimate.specular.into() };
    }
}
