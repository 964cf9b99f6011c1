//! The systems of the Gather stage and closed-form shading; each fetches columns and calls a kernel.

use crate::error::Error;
use crate::light::LightLobe;
use crate::light::illuminate::LobeLight;
use crate::material::{DiffuseAlbedo, MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe};
use crate::math::published::Lobe;
use crate::math::shading::{
    ClosedForm, Layers, Lighting, LobeColumns, PointVisibility, ShadePoint, SpecularValue, Visibility,
};
use crate::pipeline::SystemResult;
use crate::sample::bundle::only_table;
use crate::sample::pixel::{PixelOf, ViewRay, Window};
use crate::sample::point::SurfacePoint;
use crate::shade::path_tracer;
use crate::shade::path_tracer::{PathEstimate, PathQuery, PathScene, PathSettings, shade_points};
use crate::shade::{DistantLight, IncidentLight, PathTracing, PointBlend, Scenery, ShadingForm};
use crate::visibility::WindowVisibility;
use bevy_ecs::prelude::{Query, Res, ResMut};
use rayon::prelude::*;
use std::sync::Arc;

/// What the kernels read of a light lobe.
pub fn kernel_lobe(lobe: &LightLobe) -> Lobe<f32> {
    Lobe { axis: lobe.axis.into(), sharpness: lobe.sharpness, amplitude: lobe.amplitude.into() }
}

/// What the kernels read of a specular lobe.
pub fn kernel_specular(lobe: &SpecularLobe) -> SpecularValue {
    SpecularValue { albedo: lobe.albedo.into(), roughness: lobe.roughness, ndf: lobe.ndf }
}

/// The light is the light-lobe entities.
pub fn provide_lobes(lobes: Query<&LightLobe>, mut light: ResMut<IncidentLight>) {
    let lobes: Vec<LightLobe> = lobes.iter().copied().collect();
    light.lobes = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
    light.distant = Some(Arc::new(LobeLight::new(&lobes)));
}

/// The light is the one in [`DistantLight`]: its lobes for closed-form shading, itself for path tracing.
pub fn provide_distant(distant: Res<DistantLight>, mut light: ResMut<IncidentLight>) {
    light.lobes.clone_from(&distant.lobes);
    light.distant = Some(distant.light.clone());
}

/// Blends the texels at each surface point into what shading reads.
pub fn gather_points(
    window: Res<Window>,
    texels: Query<&DiffuseAlbedo>,
    mut samples: Query<(&SurfacePoint, &ViewRay, &mut ShadePoint)>,
) -> SystemResult {
    let texels = only_table(texels.contiguous_iter()?, |t| t.len(), "texel")?.unwrap_or_default();
    let Some((points, rays, mut gathered)) =
        only_table(samples.contiguous_iter_mut()?, |t| t.0.len(), "pixel")?
    else {
        return Ok(());
    };
    let gathered = &mut gathered.bypass_change_detection()[window.0.clone()];
    let points = &points[window.0.clone()];
    let rays = &rays[window.0.clone()];
    let inputs = points.par_iter().zip(rays).with_min_len(1024);
    gathered.par_iter_mut().zip(inputs).for_each(|(out, (point, ray))| {
        *out = gather_point(point, ray, texels);
    });
    Ok(())
}

fn gather_point(point: &SurfacePoint, ray: &ViewRay, texels: &[DiffuseAlbedo]) -> ShadePoint {
    if !point.is_hit() {
        return ShadePoint::default();
    }
    let address = &point.texels;
    let albedo: glam::Vec3 = (0..4).map(|i| texels[address.indices[i] as usize].0 * address.weights[i]).sum();
    ShadePoint { normal: point.normal.into(), to_viewer: (-ray.0.direction).into(), albedo: albedo.into() }
}

/// Blends the weights of the specular lobes at each surface point; one lobe needs none.
pub fn gather_blends(
    window: Res<Window>,
    materials: Query<&SpecularLobe>,
    texels: Query<&SpecularBlend>,
    mut samples: Query<(&SurfacePoint, &mut PointBlend)>,
) -> SystemResult {
    if materials.iter().len() < 2 {
        return Ok(());
    }
    let texels = only_table(texels.contiguous_iter()?, |t| t.len(), "texel")?.unwrap_or_default();
    let Some((points, mut blends)) = only_table(samples.contiguous_iter_mut()?, |t| t.0.len(), "pixel")?
    else {
        return Ok(());
    };
    let blends = &mut blends.bypass_change_detection()[window.0.clone()];
    for (blend, point) in blends.iter_mut().zip(&points[window.0.clone()]) {
        if point.is_hit() {
            blend.0 = std::array::from_fn(|k| {
                (0..4).map(|i| texels[point.texels.indices[i] as usize].0[k] * point.texels.weights[i]).sum()
            });
        }
    }
    Ok(())
}

/// Shades in closed form ([`ShadingForm`] says in which), with what shadows and reflections `Slot::Visibility` has found.
pub fn shade_closed_form(
    window: Res<Window>,
    (light, form): (Res<IncidentLight>, Res<ShadingForm>),
    visibility: Option<Res<WindowVisibility>>,
    materials: Query<&SpecularLobe>,
    mut samples: Query<(&ShadePoint, &PointBlend, &PointVisibility, &mut Layers)>,
) -> SystemResult {
    let Some((points, blends, seen, mut shaded)) =
        only_table(samples.contiguous_iter_mut()?, |t| t.0.len(), "pixel")?
    else {
        return Ok(());
    };
    let points = &points[window.0.clone()];
    let shaded = &mut shaded.bypass_change_detection()[window.0.clone()];
    let materials: Vec<SpecularValue> = materials.iter().map(kernel_specular).collect();
    let visibility = visibility.as_ref().and_then(|visibility| visibility.view(&seen[window.0.clone()]));
    let lighting = Lighting { lobes: &light.lobes, visibility };
    match materials.as_slice() {
        [] => shaded.fill(Layers::default()),
        [one] => form.0.shade(points, one, lighting, shaded),
        many => shade_blended(form.0, points, &blends[window.0.clone()], many, lighting, shaded),
    }
    Ok(())
}

/// The points that show one of the specular lobes.
pub struct Showing {
    /// Their numbers, rising.
    pub numbers: Vec<usize>,
    /// The points.
    pub points: Vec<ShadePoint>,
    rows: Vec<u8>,
    seen: Vec<PointVisibility>,
}

impl Showing {
    /// Those of `points` where lobe `k` has a weight. The first lobe also has those where none has, for their diffuse light.
    pub fn new(points: &[ShadePoint], blends: &[PointBlend], lighting: Lighting<'_>, k: usize) -> Self {
        let shows = |blend: &PointBlend| blend.0[k] > 0.0 || (k == 0 && blend.0 == [0.0; MAX_SPECULAR_LOBES]);
        let numbers: Vec<usize> = (0..points.len()).filter(|&i| shows(&blends[i])).collect();
        let stride = lighting.lobes.stride();
        let row = |i: &usize| Visibility::point(lighting.visibility, *i, stride);
        Self {
            points: numbers.iter().map(|&i| points[i]).collect(),
            rows: numbers.iter().flat_map(|i| row(i).0.unwrap_or_default()).copied().collect(),
            seen: numbers.iter().map(|i| row(i).1).collect(),
            numbers,
        }
    }

    /// Their part of the lighting.
    pub fn lighting<'a>(&'a self, all: Lighting<'a>) -> Lighting<'a> {
        let visibility = Visibility { lobes: &self.rows, points: &self.seen };
        Lighting { visibility: all.visibility.map(|_| visibility), ..all }
    }

    /// What they see, each changed.
    pub fn change_seen(&mut self, mut change: impl FnMut(usize, &mut PointVisibility)) {
        self.numbers.iter().zip(&mut self.seen).for_each(|(i, seen)| change(*i, seen));
    }
}

/// Shades once for each specular lobe and blends by the points' weights.
fn shade_blended(
    form: ClosedForm,
    points: &[ShadePoint],
    blends: &[PointBlend],
    materials: &[SpecularValue],
    lighting: Lighting<'_>,
    shaded: &mut [Layers],
) {
    shaded.fill(Layers::default());
    let mut one = Vec::new();
    for (k, material) in materials.iter().enumerate().take(MAX_SPECULAR_LOBES) {
        let part = Showing::new(points, blends, lighting, k);
        one.resize(part.numbers.len(), Layers::default());
        form.shade(&part.points, material, part.lighting(lighting), &mut one);
        for (i, one) in part.numbers.iter().zip(&one) {
            let (sum, weight) = (&mut shaded[*i], blends[*i].0[k]);
            sum.diffuse = one.diffuse;
            sum.specular = std::array::from_fn(|c| sum.specular[c] + weight * one.specular[c]);
        }
    }
}

/// What a path-traced sample is made from.
type PathColumns<'a> =
    (&'a PixelOf, &'a SurfacePoint, &'a ViewRay, &'a ShadePoint, &'a PointBlend, &'a mut Layers);

/// Shades by path tracing: shadows and interreflection, with noise.
pub fn shade_path_traced(
    window: Res<Window>,
    (scenery, light, paths): (Res<Scenery>, Res<IncidentLight>, Res<PathTracing>),
    materials: Query<&SpecularLobe>,
    texels: Query<(&DiffuseAlbedo, &SpecularBlend)>,
    mut samples: Query<PathColumns>,
) -> SystemResult {
    let Some(distant) = &light.distant else {
        return Err(Error::run("path tracing", "there is no light").into());
    };
    let (albedo, blends) = only_table(texels.contiguous_iter()?, |t| t.0.len(), "texel")?.unwrap_or_default();
    let Some((pixels, points, rays, gathered, weights, mut shaded)) =
        only_table(samples.contiguous_iter_mut()?, |t| t.0.len(), "pixel")?
    else {
        return Ok(());
    };
    let specular: Vec<SpecularLobe> = materials.iter().copied().collect();
    let scene = PathScene {
        surface: scenery.0.as_ref(),
        light: distant.as_ref(),
        albedo,
        blends,
        specular: &specular,
    };
    let rows = window.0.clone();
    let hits: Vec<usize> = rows.clone().filter(|&i| points[i].is_hit()).collect();
    let queries: Vec<PathQuery> = hits
        .iter()
        .map(|&i| PathQuery {
            point: path_tracer::ShadePoint {
                position: points[i].position,
                normal: points[i].normal,
                geometric_normal: points[i].geometric_normal,
                albedo: gathered[i].albedo.into(),
                blend: weights[i].0,
            },
            to_viewer: -rays[i].0.direction,
            stream: u64::from(pixels[i].view) << 32 | u64::from(pixels[i].pixel),
            first_sample: i as u32 % paths.samples_per_pixel * paths.paths_per_sample,
        })
        .collect();
    let mut estimates = vec![PathEstimate::default(); queries.len()];
    let settings =
        PathSettings { max_bounces: paths.max_bounces, seed: paths.seed, ..PathSettings::default() };
    shade_points(&scene, &settings, &queries, paths.paths_per_sample, &mut estimates);
    let shaded = shaded.bypass_change_detection();
    shaded[rows].fill(Layers::default());
    for (i, estimate) in hits.into_iter().zip(estimates) {
        shaded[i] = Layers { diffuse: estimate.diffuse.into(), specular: estimate.specular.into() };
    }
    Ok(())
}
