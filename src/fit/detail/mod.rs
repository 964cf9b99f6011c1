//! The detail of a texture: each texel's albedo, sheen and tilt, from every pixel that shows it.
//!
//! A fit by small random steps finds light, shape and specular lobes from a part of the pixels; more pixels and finer texels
//! would only make it slower. The detail of the albedo needs all of them. With everything else held, the radiance is linear in albedo and
//! sheen, and nearly so in the tilt, so that least squares over all training photographs gives them at once (`equations`): a step of variable projection (Golub
//! and Pereyra 2003). A pixel sees a bilinear mixture of four texels; its residual counts for each by its weight, and some sweeps
//! over all pixels take back what this blurs (as SIRT does, Gilbert 1972). Pixels that disagree with the others of a texel, by highlights
//! and shadows that the model does not have, count less.
//!
//! | system | stage, slot | writes |
//! | --- | --- | --- |
//! | [`show_pixels`] | Detail: Sample | the pixels of this run as samples |
//! | `trace_samples` | Detail: Trace | where their rays meet the surface |
//! | those of [`GatherPoints`], [`whiten_points`] | Detail: Gather | what shading needs, for a white surface |
//! | `provide_light`, `refresh_visibility`, `gather_visibility` | Detail: `Slot::Light`, `Slot::Visibility` | light and shadows as in a fit |
//! | `shade_closed_form` | Detail: `Slot::Shading` | diffuse radiance of a white surface, specular radiance |
//! | [`keep_pixels`] | Detail: Gradient | [`KeptPixels`] |

pub(crate) mod equations;
pub(crate) mod kept;

use crate::error::Result;
use crate::error::stop::is_stopping;
use crate::fit::components::TexelSeen;
use crate::fit::exposure::Exposures;
use crate::fit::groups::{exchange_light, groups_of_views};
use crate::fit::metal::Metals;
use crate::fit::observe::{Candidate, UsableView, spawn_samples, usable_by_view, usable_pixels};
use crate::light::lights::{LightChoice, provide_light};
use crate::light::placement::LightGroup;
use crate::material::material_source::Recovered;
use crate::material::sheen::{KnownAlong, has_sheen, mean_albedo, write_albedo};
use crate::material::tilt::{DirectionalAlbedo, MOST_TILT, along_surface};
use crate::material::{
    DiffuseAlbedo, DiffuseSheen, DiffuseTilt, SpecularBlend, TexelIndex, recovered_materials,
};
use crate::math::shading::{ClosedForm, Layers, ShadePoint};
use crate::pipeline::pool::{read_column, write_column};
use crate::pipeline::{GatherPoints, Phase, Pipeline, Plugin, Slot, Stage, SystemResult};
use crate::profile::stage;
use crate::ranks::Ranks;
use crate::ranks::owned::OwnedItems;
use crate::sample::Samples;
use crate::sample::bundle::despawn_pool;
use crate::sample::pixel::{Observed, PixelOf, ViewRay, Window};
use crate::sample::point::SurfacePoint;
use crate::shade::frame::{add_gathering, add_material_resources, trace_samples};
use crate::shade::shade_closed_form;
use crate::view::{ByView, Camera, Photograph, ViewIndex};
use crate::visibility::WindowVisibility;
use crate::visibility::systems::{gather_visibility, light_or_material_changed, refresh_visibility};
use bevy_ecs::prelude::{IntoScheduleConfigs, Query, Res, ResMut, Resource, With, World};
use equations::{LEAST_COLOR, TexelEquations};
use glam::Vec3;
use kept::{KeptPixel, PackedPixels, ShadedPixel, add_pixels};
use rayon::prelude::*;
use std::ops::ControlFlow;

/// Sweeps over all pixels. They are cheap beside shading.
const SWEEPS: u32 = 7;
/// Most texels a side that a texture is refined to.
const MOST_SIDE: u32 = 2048;
/// Least pixels for a texel of a texture that is refined.
const PIXELS_OF_TEXEL: f64 = 2.0;
/// Pixels of one run of the phase, and of a sweep between two looks whether it is stopped.
const BATCH: usize = 1 << 16;
/// Most pixels that are kept; of more, every n-th is visited.
pub(crate) const MOST_PIXELS: usize = 1 << 25;
/// Shaded pixels that processes exchange at a time, about.
const SENT_AT_ONCE: usize = 1 << 20;
/// Part of the work that is shading.
const SHADING_PART: f32 = 0.8;

/// Settings of the solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetailOptions {
    /// The closed form used for shading.
    pub form: ClosedForm,
    /// Whether shading includes shadows and reflections; the world then needs an [`ObjectVisibility`](crate::visibility::ObjectVisibility).
    pub visibility: bool,
    /// Whether the tilt is unknown as well.
    pub tilt: bool,
    /// Whether the first base material may be a metal, beneath which there is no diffuse light ([`metal`](crate::fit::metal)).
    pub metal: bool,
}

/// The systems of [`Phase::Detail`].
pub struct DetailPlugin(pub DetailOptions);

impl Plugin for DetailPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.world.init_resource::<PresentPixels>();
        pipeline.world.init_resource::<KeptPixels>();
        pipeline.world.init_resource::<Exposures>();
        add_material_resources::<Recovered>(&mut pipeline.world);
        add_gathering::<Recovered>(pipeline, Phase::Detail);
        pipeline
            .add_systems(Phase::Detail, Stage::Sample, show_pixels)
            .add_systems(Phase::Detail, Stage::Trace, trace_samples)
            .add_systems(Phase::Detail, Stage::Gather, whiten_points.after(GatherPoints))
            .swap(Phase::Detail, Slot::Light, provide_light(LightChoice::Own, false))
            .swap(Phase::Detail, Slot::Shading, shade_closed_form(self.0.form))
            .add_systems(Phase::Detail, Stage::Gradient, keep_pixels);
        pipeline.world.insert_resource(WindowVisibility::default());
        if self.0.visibility {
            let refresh = refresh_visibility::<Recovered>.run_if(light_or_material_changed::<Recovered>);
            pipeline.swap(Phase::Detail, Slot::Visibility, (refresh, gather_visibility).chain());
        }
    }

    fn cleanup(world: &mut World) {
        world.remove_resource::<PresentPixels>();
        world.remove_resource::<KeptPixels>();
        world.insert_resource(WindowVisibility::default());
    }
}

/// The pixels of one run of the phase.
#[derive(Resource, Default)]
pub struct PresentPixels(Vec<Candidate>);

/// What has been shaded.
#[derive(Resource, Default)]
pub struct KeptPixels(Vec<KeptPixel>);

/// Solves for albedo, sheen and tilt of all texels: shades the pixels of the training photographs, then sweeps over them a few times.
/// `watch` is called with the part of the work that is done. Raises [`TexelSeen`] where the sweeps see more than the fit did. A run that is
/// stopped keeps the sweeps before.
///
/// # Errors
/// The first error of a system.
pub fn solve_detail(
    pipeline: &mut Pipeline,
    options: DetailOptions,
    watch: &mut dyn FnMut(f32),
) -> Result<()> {
    pipeline.add_plugin(&DetailPlugin(options));
    spawn_samples(&mut pipeline.world, BATCH);
    let shaded = shade_pixels(pipeline, &mut |part| watch(SHADING_PART * part));
    let pixels = std::mem::take(&mut pipeline.world.resource_mut::<KeptPixels>().0);
    despawn_pool(&mut pipeline.world);
    pipeline.remove_plugin::<DetailPlugin>();
    shaded?;
    let _sweeping = stage("sweeps");
    for number in 0..SWEEPS {
        if sweep(&mut pipeline.world, &pixels, options)?.is_break() {
            break;
        }
        watch(SHADING_PART + (1.0 - SHADING_PART) * (number + 1) as f32 / SWEEPS as f32);
    }
    Ok(())
}

/// The most texels a side of a texture that so many pixels are visited for.
pub(crate) fn finest_side(pixels: f64) -> f64 {
    (pixels / PIXELS_OF_TEXEL).sqrt().min(f64::from(MOST_SIDE))
}

/// The pixels of the training photographs that are visited.
///
/// # Errors
/// If another process is gone.
pub(crate) fn visited_pixels(world: &mut World) -> Result<usize> {
    let total: usize = usable_by_view(world)?.iter().map(|of| of.pixels).sum();
    Ok(total / total.div_ceil(MOST_PIXELS).max(1))
}

/// Shades all pixels as if the surface were white, and keeps them.
fn shade_pixels(pipeline: &mut Pipeline, watch: &mut dyn FnMut(f32)) -> Result<()> {
    let groups = groups_of_views(&mut pipeline.world);
    let group_of = |of: &UsableView| groups.get(of.view).copied().unwrap_or_default();
    let mut views = usable_by_view(&mut pipeline.world)?;
    // Shadows are found once for the light of each group.
    views.sort_by_key(group_of);
    let total: usize = views.iter().map(|of| of.pixels).sum();
    let every = total.div_ceil(MOST_PIXELS).max(1);
    // As many as there may be, so that growing never copies them.
    let most = views.iter().map(|of| of.pixels.div_ceil(every)).sum();
    let mut kept = Vec::with_capacity(most);
    let mut done = 0;
    for of_group in views.chunk_by(|a, b| group_of(a) == group_of(b)) {
        let group = of_group.first().map_or(LightGroup::OWN, group_of);
        exchange_light(&mut pipeline.world, group);
        let mut take = |mut of_view: Vec<KeptPixel>| kept.append(&mut of_view);
        let shaded = shade_group(pipeline, of_group, every, &mut take, &mut || {
            done += 1;
            watch(done as f32 / views.len() as f32);
        });
        exchange_light(&mut pipeline.world, group);
        shaded?;
    }
    pipeline.world.resource_mut::<KeptPixels>().0 = kept;
    Ok(())
}

/// Shades every n-th pixel of views under one light, of each process those whose photographs it keeps, and hands what is kept of each view to `take`. Leaves the
/// rest out once the run is stopped.
fn shade_group(
    pipeline: &mut Pipeline,
    views: &[UsableView],
    every: usize,
    take: &mut dyn FnMut(Vec<KeptPixel>),
    watch: &mut dyn FnMut(),
) -> Result<()> {
    let Some(ranks) = pipeline.world.get_resource::<Ranks>().cloned() else {
        for of in views {
            take(shade_view(pipeline, of.view, every)?);
            watch();
        }
        return Ok(());
    };
    if is_stopping() {
        return Ok(());
    }
    // All processes find the shadows of this light, also one without a view of it.
    shade_batch(pipeline, &[])?;
    let own = Some(ranks.rank() as u32);
    let mut shaded = Vec::with_capacity(views.len());
    for of in views {
        let is_own = of.keeper.is_none() || of.keeper == own;
        shaded.push(if is_own { shade_view(pipeline, of.view, every)? } else { Vec::new() });
        watch();
    }
    send_shaded(&ranks, shaded, views, every, take)
}

/// Hands what is kept of each view to `take`, in all processes, from that which has shaded it.
fn send_shaded(
    ranks: &Ranks,
    shaded: Vec<Vec<KeptPixel>>,
    views: &[UsableView],
    every: usize,
    take: &mut dyn FnMut(Vec<KeptPixel>),
) -> Result<()> {
    // A few at a time: only these are in memory several times.
    let mut left = shaded.into_iter().zip(views);
    loop {
        let (mut some, mut pixels) = (Vec::new(), 0);
        while pixels < SENT_AT_ONCE * every
            && let Some((kept, of)) = left.next()
        {
            pixels += of.pixels;
            some.push((kept, of.keeper));
        }
        if some.is_empty() {
            return Ok(());
        }
        let some = OwnedItems::new(some, Some(ranks), |(_, keeper)| *keeper);
        some.each_in_turn(|_, (kept, _)| PackedPixels(kept.clone()), |_, PackedPixels(kept)| take(kept))?;
    }
}

/// Shades every n-th pixel of a view whose photograph is here; leaves the rest out once the run is stopped.
fn shade_view(pipeline: &mut Pipeline, view: ViewIndex, every: usize) -> Result<Vec<KeptPixel>> {
    if is_stopping() {
        return Ok(Vec::new());
    }
    let pixels = usable_pixels(&mut pipeline.world, view, every);
    for part in pixels.chunks(BATCH).take_while(|_| !is_stopping()) {
        shade_batch(pipeline, part)?;
    }
    Ok(std::mem::take(&mut pipeline.world.resource_mut::<KeptPixels>().0))
}

/// Shades a few pixels, and keeps them.
fn shade_batch(pipeline: &mut Pipeline, pixels: &[Candidate]) -> Result<()> {
    pipeline.world.resource_mut::<Window>().0 = 0..pixels.len();
    pipeline.world.resource_mut::<PresentPixels>().0 = pixels.to_vec();
    pipeline.run(Phase::Detail)
}

/// Visits all pixels, then moves the texels; breaks if the run is stopped before.
fn sweep(world: &mut World, pixels: &[KeptPixel], options: DetailOptions) -> Result<ControlFlow<()>> {
    let albedo = read_column::<TexelIndex, DiffuseAlbedo>(world)?;
    let sheen = read_column::<TexelIndex, DiffuseSheen>(world)?;
    let tilts = read_column::<TexelIndex, DiffuseTilt>(world)?;
    let of = |texel: usize| DirectionalAlbedo {
        albedo: albedo[texel].0,
        sheen: sheen[texel].0,
        tilt: tilts[texel].0,
    };
    let is_known = world.contains_resource::<KnownAlong>();
    let mut equations = vec![TexelEquations::default(); albedo.len()];
    for part in pixels.chunks(BATCH) {
        if is_stopping() {
            return Ok(ControlFlow::Break(()));
        }
        add_pixels(part, of, is_known, &mut equations);
    }
    move_by_equations(world, &equations, options).map(ControlFlow::Continue)
}

/// The columns of a sample that say what it is a sample of.
type PixelColumns = (&'static mut PixelOf, &'static mut Observed, &'static mut ViewRay);

/// Sample: the pixels of this run become the samples.
pub fn show_pixels(
    present: Res<PresentPixels>,
    views: Query<(&ViewIndex, &Camera), With<Photograph>>,
    samples: Samples<PixelColumns>,
) -> SystemResult {
    let cameras: ByView<Camera> = views.iter().map(|(index, camera)| (*index, *camera)).collect();
    let (mut pixels, mut observed, mut rays) = samples.columns()?;
    let columns = pixels.iter_mut().zip(&mut *observed).zip(&mut *rays);
    for (((pixel, observed), ray), from) in columns.zip(&present.0) {
        (*pixel, *observed) = (from.pixel, from.observed);
        ray.0 = cameras.of(from.pixel.view)?.pixel_ray(from.pixel.pixel);
    }
    Ok(())
}

/// Gather: shading is that of a white surface, because radiance per unit of albedo is wanted, also of black texels.
pub fn whiten_points(samples: Samples<&mut ShadePoint>) -> SystemResult {
    samples.columns()?.iter_mut().for_each(|point| point.albedo = [1.0; 3]);
    Ok(())
}

/// The columns that are kept.
type ShadedColumns =
    ((&'static SurfacePoint, &'static ViewRay), &'static Layers, (&'static Observed, &'static PixelOf));

/// Gradient: keeps the pixels that show the surface.
pub fn keep_pixels(
    exposures: Res<Exposures>,
    samples: Samples<ShadedColumns>,
    mut kept: ResMut<KeptPixels>,
) -> SystemResult {
    let ((points, rays), shaded, (observed, pixels)) = samples.columns()?;
    let shown = |i: usize| {
        let (point, to_viewer) = (&points[i], -rays[i].0.direction);
        let facing = point.normal.dot(to_viewer);
        let exposure = exposures.factor(pixels[i].view);
        (point.is_hit() && facing > 0.0).then(|| {
            KeptPixel::from(ShadedPixel {
                texels: point.texels,
                facing,
                side: along_surface(point.normal, to_viewer),
                unit: Vec3::from(shaded[i].diffuse) * exposure,
                specular: Vec3::from(shaded[i].specular) * exposure,
                observed: observed[i],
            })
        })
    };
    kept.0.par_extend((0..points.len()).into_par_iter().filter_map(shown));
    Ok(())
}

/// The largest diffuse albedo of each texel.
fn most_diffuse(world: &mut World, metal: bool) -> Result<Vec<f32>> {
    let blends = read_column::<TexelIndex, SpecularBlend>(world)?;
    if !metal {
        return Ok(vec![1.0; blends.len()]);
    }
    let materials = recovered_materials(world);
    let metals = Metals::of(materials.iter().map(|(number, lobe)| (*number, lobe)));
    Ok(blends.iter().map(|blend| metals.most_diffuse(&blend.0)).collect())
}

/// Moves albedo, sheen and tilt of all texels to the solution, within their bounds. Without any sheen so far there will be none.
fn move_by_equations(world: &mut World, equations: &[TexelEquations], options: DetailOptions) -> Result<()> {
    let mut albedo = read_column::<TexelIndex, DiffuseAlbedo>(world)?;
    let mut sheen = read_column::<TexelIndex, DiffuseSheen>(world)?;
    let is_known = world.contains_resource::<KnownAlong>();
    let (with_sheen, with_tilt) = (has_sheen(&sheen) && !is_known, options.tilt && !is_known);
    let mut tilt = read_column::<TexelIndex, DiffuseTilt>(world)?;
    let most = most_diffuse(world, options.metal)?;
    let texels = albedo.par_iter_mut().zip(&mut sheen).zip(&mut tilt);
    texels.zip(equations).zip(&most).with_min_len(4096).for_each(
        |((((albedo, sheen), tilt), equations), most)| {
            let mean = mean_albedo(albedo.0, sheen.0);
            let before = with_tilt.then_some((mean, tilt.0));
            let change = equations.solve(with_sheen, before);
            let most = Vec3::splat(*most);
            let along = (albedo.0 + sheen.0 + change.albedo + change.sheen).clamp(Vec3::ZERO, most);
            albedo.0 = (albedo.0 + change.albedo).clamp(Vec3::ZERO, most);
            if with_sheen {
                sheen.0 = along - albedo.0;
            }
            // The difference between sides is what was solved for, not its part of the albedo, which changes as well.
            let now = mean_albedo(albedo.0, sheen.0);
            let part = mean.dot(now) / now.length_squared().max(LEAST_COLOR);
            tilt.0 = ((tilt.0 + change.tilt) * part).clamp_length_max(MOST_TILT);
        },
    );
    // A texel that no pixel meets between texels that the fit has seen keeps what the fit has found there.
    let mut seen = read_column::<TexelIndex, TexelSeen>(world)?;
    seen.iter_mut().zip(equations).for_each(|(seen, equations)| seen.0 = seen.0.max(equations.seen()));
    write_column::<TexelIndex, DiffuseSheen>(world, &sheen)?;
    write_column::<TexelIndex, DiffuseTilt>(world, &tilt)?;
    write_albedo(world, albedo.into_iter().map(|albedo| albedo.0).collect())?;
    write_column::<TexelIndex, TexelSeen>(world, &seen)
}
