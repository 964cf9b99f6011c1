//! The initialization of a fit: solves alternately for amplitudes and albedo, starting from gray albedo and uniform light.
pub mod linear;
pub mod place_lobes;

use crate::error::{Error, Result};
use crate::fit::components::Unknowns;
use crate::fit::initialization::linear::{solve_albedo, solve_amplitudes};
use crate::fit::initialization::place_lobes::move_lobes_to_the_light;
use crate::light::lights::LobeOf;
use crate::light::{LightLobe, kernel_lobe};
use crate::material::{
    DiffuseAlbedo, MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe, TexelIndex, recovered_albedo,
    recovered_materials,
};
use crate::math::shading::{ClosedForm, Layers, Lighting, LobeColumns, PointVisibility, ShadePoint};
use crate::pipeline::pool::write_column;
use crate::sample::observation::{Observation, Observations};
use crate::sample::point::SurfacePoint;
use crate::shade::systems::kernel_specular;
use crate::view::{ByView, Camera, Photograph, ViewIndex};
use crate::visibility::{ObjectVisibility, WindowVisibility};
use bevy_ecs::prelude::{Entity, Query, With, Without, World};
use bevy_ecs::system::SystemState;
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;

/// Most pixels in a solve for the amplitudes.
const AMPLITUDE_PIXELS: usize = 6144;
/// Most pixels in a solve for the albedo…
const ALBEDO_PIXELS: usize = 400_000;
/// …or this many per texel, if that is more.
const PIXELS_PER_TEXEL: usize = 4;
/// Rounds, each of light and then albedo.
const ROUNDS: usize = 4;
/// Rounds, after the first, that begin by moving faint lobes to bright regions.
const MOVES: usize = 1;

/// Points whose visibility is in memory at a time.
const CHUNK: usize = 1 << 16;

/// Solves alternately for amplitudes and albedo, where they are unknown, starting from gray, with the closed form `form`; if `shadowed`,
/// with occlusion and interreflection from [`ObjectVisibility`].
///
/// # Errors
/// If a pool is incomplete.
pub fn initialize_light_and_albedo(
    world: &mut World,
    unknowns: Unknowns,
    form: ClosedForm,
    shadowed: bool,
) -> Result<()> {
    if !unknowns.light && !unknowns.albedo {
        return Ok(());
    }
    let mut query = world.query_filtered::<(Entity, &LightLobe), Without<LobeOf>>();
    let (entities, mut lobes): (Vec<Entity>, Vec<LightLobe>) =
        query.iter(world).map(|(entity, lobe)| (entity, *lobe)).unzip();
    let specular = least_rough(world);
    let mut texels = recovered_albedo(world)?;
    let mut visibility = if shadowed { world.remove_resource::<ObjectVisibility>() } else { None };
    let object = visibility.as_mut();
    let guessed =
        guess_from_samples(world, &mut lobes, &mut texels, Known { form, specular, unknowns, object });
    if let Some(visibility) = visibility {
        world.insert_resource(visibility);
    }
    guessed?;
    for (entity, guess) in entities.into_iter().zip(&lobes) {
        world.entity_mut(entity).insert(*guess);
    }
    let texels: Vec<DiffuseAlbedo> = texels.into_iter().map(DiffuseAlbedo).collect();
    write_column::<TexelIndex, DiffuseAlbedo>(world, &texels)
}

/// The inputs of the initialization besides samples.
struct Known<'a> {
    form: ClosedForm,
    specular: SpecularLobe,
    unknowns: Unknowns,
    object: Option<&'a mut ObjectVisibility>,
}

fn guess_from_samples(
    world: &mut World,
    lobes: &mut [LightLobe],
    texels: &mut Vec<Vec3>,
    known: Known,
) -> Result<()> {
    let Known { form, specular, unknowns, object } = known;
    type Inputs<'w, 's> =
        (Observations<'w, 's>, Query<'w, 's, (&'static ViewIndex, &'static Camera), With<Photograph>>);
    let mut state = SystemState::<Inputs>::new(world);
    let (observations, views) = state.get(world).map_err(|error| Error::run("fit", error.to_string()))?;
    let cameras = views.iter().map(|(index, camera)| (*index, *camera)).collect();
    let observations = observations.columns()?;
    let mut guess = Guess { form, observations: &observations, cameras, specular, unknowns, object };
    guess.alternate(lobes, texels)
}

/// The base material of least roughness that a texel has: it shows best where the light is. (With the mean of two, the fitted roughness is farther from the truth.)
fn least_rough(world: &mut World) -> SpecularLobe {
    let mut shown = [false; MAX_SPECULAR_LOBES];
    for blend in world.query::<&SpecularBlend>().iter(world) {
        shown.iter_mut().zip(&blend.0).for_each(|(shown, weight)| *shown |= *weight > 0.0);
    }
    let lobes = recovered_materials(world).into_iter().filter(|(number, _)| shown[*number]);
    let first = lobes.map(|(_, lobe)| lobe).min_by(|a, b| a.roughness.total_cmp(&b.roughness));
    first.unwrap_or(SpecularLobe::new(Vec3::ZERO, 1.0))
}

/// The data of the initialization.
struct Guess<'a> {
    form: ClosedForm,
    observations: &'a [Observation],
    cameras: ByView<Camera>,
    specular: SpecularLobe,
    unknowns: Unknowns,
    object: Option<&'a mut ObjectVisibility>,
}

impl Guess<'_> {
    fn alternate(&mut self, lobes: &mut [LightLobe], texels: &mut Vec<Vec3>) -> Result<()> {
        for round in 0..ROUNDS {
            if self.unknowns.light {
                if (1..=MOVES).contains(&round) {
                    move_lobes_to_the_light(lobes);
                }
                self.solve_light(lobes, texels)?;
            }
            if self.unknowns.albedo {
                let n = self.observations.len().min(ALBEDO_PIXELS.max(PIXELS_PER_TEXEL * texels.len()));
                *texels = self.albedo_under(lobes, texels, n)?;
            }
        }
        Ok(())
    }

    fn solve_light(&mut self, lobes: &mut [LightLobe], texels: &[Vec3]) -> Result<()> {
        let n = self.observations.len().min(AMPLITUDE_PIXELS);
        let points = self.gather(0..n, |point| point.texels.blend(texels))?;
        let columns = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
        self.refresh(&columns, texels);
        let (rows, seen) = self.seen(0..n, &points);
        let lighting = Lighting { lobes: &columns, visibility: rows.view(&seen) };
        let specular = kernel_specular(&self.specular);
        let observations = &self.observations[..n];
        let amplitudes = solve_amplitudes(self.form, &points, observations, &specular, lighting, 1e-2);
        for (lobe, amplitude) in lobes.iter_mut().zip(amplitudes) {
            lobe.amplitude = amplitude.max(Vec3::splat(1e-3));
        }
        Ok(())
    }

    fn albedo_under(&mut self, lobes: &[LightLobe], texels: &[Vec3], n: usize) -> Result<Vec<Vec3>> {
        let columns = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
        self.refresh(&columns, texels);
        let specular = kernel_specular(&self.specular);
        let mut unit = vec![Layers::default(); n];
        for start in (0..n).step_by(CHUNK) {
            let run = start..n.min(start + CHUNK);
            let white = self.gather(run.clone(), |_| Vec3::ONE)?;
            let (rows, seen) = self.seen(run.clone(), &white);
            let lighting = Lighting { lobes: &columns, visibility: rows.view(&seen) };
            self.form.shade(&white, &specular, lighting, &mut unit[run]);
        }
        Ok(solve_albedo(&self.observations[..n], &unit, texels.len(), Vec3::splat(0.4)))
    }

    /// The inputs of shading at a range of observed pixels, with this albedo.
    fn gather(
        &self,
        run: Range<usize>,
        albedo: impl Fn(&SurfacePoint) -> Vec3 + Sync,
    ) -> Result<Vec<ShadePoint>> {
        let gathered = self.observations[run].par_iter().map(|Observation { pixel, point, .. }| {
            let ray = self.cameras.of(pixel.view)?.pixel_ray(pixel.pixel);
            Ok(ShadePoint {
                normal: point.normal.into(),
                to_viewer: (-ray.direction).into(),
                albedo: albedo(point).into(),
            })
        });
        gathered.collect()
    }

    fn refresh(&mut self, lobes: &LobeColumns, texels: &[Vec3]) {
        let gloss = self.specular.albedo;
        if let Some(object) = &mut self.object {
            object.refresh(lobes, &|texel| (texels[texel as usize] + gloss).min(Vec3::ONE));
        }
    }

    /// The visibility at a range of observed pixels, gathered in `points`; empty without visibility.
    fn seen(&self, run: Range<usize>, points: &[ShadePoint]) -> (WindowVisibility, Vec<PointVisibility>) {
        let mut rows = WindowVisibility::default();
        let Some(object) = &self.object else { return (rows, Vec::new()) };
        let mut seen = vec![PointVisibility::OPEN; run.len()];
        let surface: Vec<SurfacePoint> = self.observations[run].iter().map(|o| o.point).collect();
        object.window(&surface, points, |_| self.specular.roughness, &mut rows, &mut seen);
        (rows, seen)
    }
}
