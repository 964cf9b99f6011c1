//! The initialization of a fit: solves alternately for amplitudes and albedo, starting from gray albedo and uniform light.
pub mod linear;
pub mod place_lobes;
pub mod placements;
pub mod start;

use crate::error::{Error, Result};
use crate::fit::components::Unknowns;
use crate::fit::groups::exchange_light;
use crate::fit::initialization::linear::{solve_albedo, solve_amplitudes};
use crate::fit::initialization::place_lobes::move_lobes_to_the_light;
use crate::light::groups::light_groups;
use crate::light::lights::LobeOf;
use crate::light::placement::{LightGroup, PlacedFrame};
use crate::light::{LightLobe, kernel_lobe};
use crate::material::sheen::write_albedo;
use crate::material::{
    MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe, USUAL_ALBEDO, recovered_albedo, recovered_materials,
};
use crate::math::brdf::Ndf;
use crate::math::shading::{
    self, ClosedForm, Layers, Lighting, LobeColumns, PointVisibility, ShadePoint, SpecularValue,
};
use crate::profile::stage;
use crate::ranks::{Ranks, check_interrupted_together};
use crate::sample::observation::{Observation, Observations};
use crate::sample::point::SurfacePoint;
use crate::sample::turn::TurnTable;
use crate::shade::systems::{kernel_specular, turned};
use crate::view::Placement;
use crate::view::{ByView, Camera, Photograph, ViewIndex};
use crate::visibility::{ObjectVisibility, Reflectance, WindowVisibility};
use bevy_ecs::prelude::{Entity, Query, With, Without, World};
use bevy_ecs::system::SystemState;
use glam::Vec3;
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::Range;

/// Most pixels in a solve for the amplitudes.
const AMPLITUDE_PIXELS: usize = 6144;
/// The same on a part of the surface.
const PART_AMPLITUDE_PIXELS: usize = 2048;
/// Most pixels in a solve for the albedo…
const ALBEDO_PIXELS: usize = 400_000;
/// …or this many per texel, if that is more.
const PIXELS_PER_TEXEL: usize = 4;
/// Most pixels over which the error of an initialization is the mean.
const ERROR_PIXELS: usize = 100_000;
/// Pixels on the part of the surface that starts are tried on, about.
const PART_PIXELS: usize = 60_000;
/// Cells along the longest side of the object, of which that part has some.
const PART_CELLS: f32 = 16.0;
/// Rounds, each of light and then albedo.
const ROUNDS: usize = 4;
/// Rounds, after the first, that begin by moving faint lobes to bright regions.
const MOVES: usize = 1;

/// Points whose visibility is in memory at a time.
const CHUNK: usize = 1 << 16;

/// Solves alternately for amplitudes and albedo, where they are unknown, starting from gray, with the closed form `form`; if `shadowed`,
/// with occlusion and interreflection from [`ObjectVisibility`]. The light stands still in the world's [`PlacedFrame`].
///
/// # Errors
/// If a pool is incomplete.
pub(crate) fn initialize_light_and_albedo(
    world: &mut World,
    unknowns: Unknowns,
    form: ClosedForm,
    shadowed: bool,
) -> Result<()> {
    if !unknowns.light && !unknowns.albedo {
        return Ok(());
    }
    let mut lights: Vec<Vec<LightLobe>> = groups(world).map(|group| lobes_of_light(world, group)).collect();
    let specular = least_rough(world);
    let mut texels = recovered_albedo(world)?;
    let object = traced(world, shadowed);
    let known = Known { form, specular, unknowns, object, in_part: false, placement: None };
    with_groups(world, known, |problems| alternate(problems, &mut lights, &mut texels))?;
    for (group, lobes) in groups(world).zip(&lights) {
        exchange_light(world, group);
        for (entity, lobe) in lobes_of(world).0.into_iter().zip(lobes) {
            world.entity_mut(entity).insert(*lobe);
        }
        exchange_light(world, group);
    }
    write_albedo(world, texels)
}

/// The groups of photographs, each under a light of its own.
fn groups(world: &mut World) -> impl Iterator<Item = LightGroup> + use<> {
    (0..light_groups(world) as u32).map(LightGroup)
}

/// The lobes of the light of a group, also those without radiance.
fn lobes_of_light(world: &mut World, group: LightGroup) -> Vec<LightLobe> {
    exchange_light(world, group);
    let lobes = lobes_of(world).1;
    exchange_light(world, group);
    lobes
}

/// The occlusion of the object, without the light of the last update, if it is `shadowed`.
pub(crate) fn traced(world: &World, shadowed: bool) -> Option<ObjectVisibility> {
    world.get_resource::<ObjectVisibility>().filter(|_| shadowed).map(ObjectVisibility::unlit)
}

/// The lobes of the scene's own light.
pub(crate) fn lobes_of(world: &mut World) -> (Vec<Entity>, Vec<LightLobe>) {
    let mut query = world.query_filtered::<(Entity, &LightLobe), Without<LobeOf>>();
    query.iter(world).map(|(entity, lobe)| (entity, *lobe)).unzip()
}

/// The inputs of the initialization besides samples.
pub(crate) struct Known {
    pub form: ClosedForm,
    pub specular: SpecularLobe,
    pub unknowns: Unknowns,
    /// The occlusion of the object.
    pub object: Option<ObjectVisibility>,
    /// Whether [`part_of_surface`] is enough.
    pub in_part: bool,
    /// The only placement that is looked at.
    pub placement: Option<Placement>,
}

/// Calls `run` with the data of the initialization, of the photographs under the scene's own light.
pub(crate) fn with_initialization<T>(
    world: &mut World,
    known: Known,
    run: impl FnOnce(&mut Initialization) -> Result<T>,
) -> Result<T> {
    with_groups(world, known, |problems| run(&mut problems[0]))
}

type Views<'w, 's> =
    Query<'w, 's, (&'static ViewIndex, &'static Camera, Option<&'static Placement>), With<Photograph>>;
type Inputs<'w, 's> = (Observations<'w, 's>, Views<'w, 's>);

/// The processes that divide the work. A part is too little for that, and mostly one of several trials, which are divided.
fn dividing_ranks(world: &World, in_part: bool) -> Option<Ranks> {
    world.get_resource::<Ranks>().filter(|_| !in_part).cloned()
}

/// Calls `run` with the data of the initialization of each group of photographs, in order.
fn with_groups<T>(
    world: &mut World,
    known: Known,
    run: impl FnOnce(&mut [Initialization]) -> Result<T>,
) -> Result<T> {
    let Known { form, specular, unknowns, object, in_part, placement } = known;
    let ranks = dividing_ranks(world, in_part);
    let lights = light_groups(world);
    let frame = PlacedFrame::own(world);
    let mut state = SystemState::<Inputs>::new(world);
    let (observations, views) = state.get(world).map_err(|error| Error::run("fit", error.to_string()))?;
    let views: Vec<(ViewIndex, Camera, Placement)> =
        views.iter().map(|(index, camera, of)| (*index, *camera, of.copied().unwrap_or_default())).collect();
    let cameras: ByView<Camera> = views.iter().map(|(index, camera, _)| (*index, *camera)).collect();
    let placements: ByView<Placement> = views.iter().map(|(index, _, of)| (*index, *of)).collect();
    let turns = TurnTable::new(&frame, views.into_iter());
    let observations = observations.columns()?;
    let chosen = placement.map(|placement| rows_of_placement(&observations, placement, &placements));
    let observations = chosen.as_deref().unwrap_or(&observations);
    let light_of = |row: &Observation| {
        let placement = placements.get(row.pixel.view).copied().unwrap_or_default();
        frame.placements.light(placement)
    };
    let of_group = |number: usize| rows_of_group(observations, LightGroup(number as u32), light_of);
    let part = |all| in_part.then(|| part_of_surface(all)).flatten().map_or(Cow::Borrowed(all), Cow::Owned);
    let parts: Vec<Cow<[Observation]>> = (0..lights).map(of_group).map(part).collect();
    let problem = |observations| Initialization {
        form,
        observations,
        amplitude_pixels: if in_part { PART_AMPLITUDE_PIXELS } else { AMPLITUDE_PIXELS },
        cameras: &cameras,
        placements: &placements,
        turns: &turns,
        specular,
        unknowns,
        object: object.as_ref().map(ObjectVisibility::unlit),
        ranks: ranks.as_ref(),
    };
    run(&mut parts.iter().map(|part| problem(part.as_ref())).collect::<Vec<_>>())
}

/// The rows of the photographs of a placement.
fn rows_of_placement(
    all: &[Observation],
    placement: Placement,
    of_view: &ByView<Placement>,
) -> Vec<Observation> {
    let is_of = |row: &&Observation| of_view.get(row.pixel.view) == Some(&placement);
    all.iter().filter(is_of).copied().collect()
}

/// The rows under the light of a group; rows are in the order of their groups.
fn rows_of_group(
    all: &[Observation],
    group: LightGroup,
    light_of: impl Fn(&Observation) -> LightGroup,
) -> &[Observation] {
    let rest = &all[all.partition_point(|row| light_of(row) < group)..];
    &rest[..rest.partition_point(|row| light_of(row) == group)]
}

/// Solves alternately for the lights of the groups and the albedo that is common to them.
fn alternate(
    problems: &mut [Initialization],
    lights: &mut [Vec<LightLobe>],
    texels: &mut Vec<Vec3>,
) -> Result<()> {
    let (unknowns, ranks) = (problems[0].unknowns, problems[0].ranks);
    for round in 0..ROUNDS {
        for (problem, lobes) in problems.iter_mut().zip(&mut *lights).filter(|_| unknowns.light) {
            check_interrupted_together(ranks)?;
            if (1..=MOVES).contains(&round) {
                move_lobes_to_the_light(lobes);
            }
            problem.solve_light(lobes, texels, round > 0)?;
        }
        check_interrupted_together(ranks)?;
        if unknowns.albedo {
            *texels = albedo_under(problems, lights, texels)?;
        }
    }
    Ok(())
}

/// The albedo that explains the photographs of all groups best.
fn albedo_under(
    problems: &mut [Initialization],
    lights: &[Vec<LightLobe>],
    texels: &[Vec3],
) -> Result<Vec<Vec3>> {
    let _solving = stage("albedo");
    let most = ALBEDO_PIXELS.max(PIXELS_PER_TEXEL * texels.len());
    let mut shaded = Vec::new();
    for (problem, lobes) in problems.iter_mut().zip(lights) {
        let n = problem.observations.len().min(most);
        shaded.push((&problem.observations[..n], problem.of_white(lobes, texels, n)?));
    }
    let pixels = shaded.iter().flat_map(|(observations, white)| observations.iter().zip(white));
    Ok(solve_albedo(pixels, texels, Vec3::splat(USUAL_ALBEDO)))
}

/// The pixels on a part of the surface, about [`PART_PIXELS`]: all that see it, so that its texels are known as well as if all of the surface
/// were looked at. `None` if there are not twice as many in all.
fn part_of_surface(all: &[Observation]) -> Option<Vec<Observation>> {
    let every = (all.len() / PART_PIXELS) as u32;
    if every < 2 {
        return None;
    }
    let at = all.par_iter().map(|observation| [observation.point.position; 2]);
    let [low, high] = at.reduce_with(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
    let side = (high - low).max_element().max(1e-6) / PART_CELLS;
    let is_in = |observation: &&Observation| {
        let cell = ((observation.point.position - low) / side).as_uvec3();
        let mixed = cell.x.wrapping_mul(0x9e37_79b1)
            ^ cell.y.wrapping_mul(0x85eb_ca77)
            ^ cell.z.wrapping_mul(0xc2b2_ae3d);
        ((mixed ^ mixed >> 15).wrapping_mul(0x2c1b_3c6d) >> 12).is_multiple_of(every)
    };
    let part: Vec<Observation> = all.par_iter().filter(is_in).copied().collect();
    (part.len() >= PART_PIXELS / 4).then_some(part)
}

/// The base material of least roughness that a texel has: it shows best where the light is. (With the mean of two, the fitted roughness is farther from the truth.) As a
/// spherical Gaussian, which does as well here as GGX in a third of the time.
fn least_rough(world: &mut World) -> SpecularLobe {
    let mut shown = [false; MAX_SPECULAR_LOBES];
    for blend in world.query::<&SpecularBlend>().iter(world) {
        shown.iter_mut().zip(&blend.0).for_each(|(shown, weight)| *shown |= *weight > 0.0);
    }
    let lobes = recovered_materials(world).into_iter().filter(|(number, _)| shown[*number]);
    let first = lobes.map(|(_, lobe)| lobe).min_by(|a, b| a.roughness.total_cmp(&b.roughness));
    SpecularLobe { ndf: Ndf::Sg, ..first.unwrap_or(SpecularLobe::new(Vec3::ZERO, 1.0)) }
}

/// The data of the initialization.
pub(crate) struct Initialization<'a> {
    pub form: ClosedForm,
    pub observations: &'a [Observation],
    /// Most pixels in a solve for the amplitudes.
    amplitude_pixels: usize,
    cameras: &'a ByView<Camera>,
    placements: &'a ByView<Placement>,
    turns: &'a TurnTable,
    pub specular: SpecularLobe,
    pub unknowns: Unknowns,
    object: Option<ObjectVisibility>,
    /// The processes that divide the work.
    ranks: Option<&'a Ranks>,
}

impl Initialization<'_> {
    /// Solves alternately for the light of these photographs and the albedo.
    fn alternate(&mut self, lobes: &mut Vec<LightLobe>, texels: &mut Vec<Vec3>) -> Result<()> {
        alternate(std::slice::from_mut(self), std::slice::from_mut(lobes), texels)
    }

    /// Solves for the amplitudes; `is_lit` if the lobes have some that explain the photographs already.
    fn solve_light(&mut self, lobes: &mut [LightLobe], texels: &[Vec3], is_lit: bool) -> Result<()> {
        let _solving = stage("light");
        let n = self.observations.len().min(self.amplitude_pixels);
        let points = self.gather(0..n, |point| point.texels.blend(texels))?;
        let columns = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
        self.refresh(&columns, texels)?;
        let (rows, seen) = self.seen(0..n)?;
        let lighting = Lighting { lobes: &columns, visibility: rows.view(&seen) };
        let specular = kernel_specular(&self.specular);
        let targets = self.targets(&points, &specular, lighting, is_lit);
        let amplitudes = solve_amplitudes(self.form, &points, &targets, &specular, lighting, 1e-2);
        for (lobe, amplitude) in lobes.iter_mut().zip(amplitudes) {
            lobe.amplitude = amplitude.max(Vec3::splat(1e-3));
        }
        Ok(())
    }

    /// The radiance that the first observed pixels, at `points`, should have: that of the photographs, or in clipped channels more if the light
    /// until now says so.
    fn targets(
        &self,
        points: &[ShadePoint],
        specular: &SpecularValue,
        lighting: Lighting<'_>,
        is_lit: bool,
    ) -> Vec<Vec3> {
        let observed = || self.observations[..points.len()].iter().map(|observation| &observation.observed);
        if !is_lit || !observed().any(|observed| observed.saturated) {
            return observed().map(|observed| observed.radiance).collect();
        }
        let mut shaded = vec![Layers::default(); points.len()];
        self.form.shade(points, specular, lighting, &mut shaded);
        let all = |layers: &Layers| Vec3::from(layers.diffuse) + Vec3::from(layers.specular);
        observed().zip(&shaded).map(|(observed, layers)| observed.target(all(layers))).collect()
    }

    /// The radiance of the first `n` pixels if the surface were white.
    fn of_white(&mut self, lobes: &[LightLobe], texels: &[Vec3], n: usize) -> Result<Vec<Layers>> {
        let columns = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
        self.refresh(&columns, texels)?;
        let specular = kernel_specular(&self.specular);
        let mut unit = vec![Layers::default(); n];
        let own = self.ranks.map_or(0..n, |ranks| ranks.share(n, shading::CHUNK));
        for start in own.clone().step_by(CHUNK) {
            let run = start..own.end.min(start + CHUNK);
            let white = self.gather(run.clone(), |_| Vec3::ONE)?;
            let (rows, seen) = self.seen(run.clone())?;
            let lighting = Lighting { lobes: &columns, visibility: rows.view(&seen) };
            self.form.shade(&white, &specular, lighting, &mut unit[run]);
        }
        if let Some(ranks) = self.ranks {
            ranks.complete(&mut unit, shading::CHUNK)?;
        }
        Ok(unit)
    }

    /// The inputs of shading at a range of observed pixels, with this albedo.
    pub fn gather(
        &self,
        run: Range<usize>,
        albedo: impl Fn(&SurfacePoint) -> Vec3 + Sync,
    ) -> Result<Vec<ShadePoint>> {
        let gathered = self.observations[run].par_iter().map(|Observation { pixel, point, .. }| {
            let ray = self.cameras.of(pixel.view)?.pixel_ray(pixel.pixel);
            let point = ShadePoint {
                normal: point.normal.into(),
                to_viewer: (-ray.direction).into(),
                albedo: albedo(point).into(),
            };
            Ok(self.turns.of(pixel.view).map_or(point, |turn| turned(&point, turn)))
        });
        gathered.collect()
    }

    pub fn refresh(&mut self, lobes: &LobeColumns, texels: &[Vec3]) -> Result<()> {
        let _refreshing = stage("shadows");
        let Some(object) = &mut self.object else { return Ok(()) };
        let SpecularLobe { albedo: specular, roughness, .. } = self.specular;
        let of = |texel: u32| Reflectance { diffuse: texels[texel as usize], specular, roughness };
        object.refresh(lobes, self.turns.all(), &of, self.ranks)
    }

    /// The visibility at a range of observed pixels; empty without visibility.
    pub fn seen(&self, run: Range<usize>) -> Result<(WindowVisibility, Vec<PointVisibility>)> {
        let mut rows = WindowVisibility::default();
        let Some(object) = &self.object else { return Ok((rows, Vec::new())) };
        let observations = &self.observations[run];
        let mut seen = vec![PointVisibility::OPEN; observations.len()];
        let surface: Vec<SurfacePoint> = observations.par_iter().map(|o| o.point).collect();
        let viewer = |Observation { pixel, .. }: &Observation| {
            Ok(-self.cameras.of(pixel.view)?.pixel_ray(pixel.pixel).direction)
        };
        let viewers: Vec<Vec3> = observations.par_iter().map(viewer).collect::<Result<_>>()?;
        let viewer = |i: usize| (viewers[i], observations[i].pixel);
        object.window(&surface, viewer, |_| self.specular.roughness, None, &mut rows, &mut seen);
        Ok((rows, seen))
    }

    /// Mean absolute difference between the first observed pixels and what this light and albedo show, over pixels and channels.
    fn error(&self, lobes: &[LightLobe], texels: &[Vec3]) -> Result<f32> {
        let n = self.observations.len().min(ERROR_PIXELS);
        let points = self.gather(0..n, |point| point.texels.blend(texels))?;
        let columns = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
        let (rows, seen) = self.seen(0..n)?;
        let lighting = Lighting { lobes: &columns, visibility: rows.view(&seen) };
        let mut shaded = vec![Layers::default(); n];
        self.form.shade(&points, &kernel_specular(&self.specular), lighting, &mut shaded);
        let of = |(shaded, Observation { observed, .. }): (&Layers, &Observation)| {
            let channel = |c: usize| observed.difference(c, shaded.diffuse[c] + shaded.specular[c]).abs();
            f64::from((0..3).map(channel).sum::<f32>())
        };
        let sum: f64 = shaded.iter().zip(self.observations).map(of).sum();
        Ok((sum / (3 * n.max(1)) as f64) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::pixel::{Observed, PixelOf};

    #[test]
    fn a_part_of_the_surface_has_all_pixels_of_its_places() {
        let seen = |place: usize| {
            let [x, y] = [place % 600, place / 600 % 600].map(|at| at as f32 / 300.0 - 1.0);
            let point = SurfacePoint { position: Vec3::new(x, y, x * y), ..SurfacePoint::default() };
            let observed = Observed { radiance: Vec3::ONE, saturated: false };
            Observation { pixel: PixelOf { view: ViewIndex(0), pixel: place as u32 }, observed, point }
        };
        // Each of 360 000 places is seen three times.
        let all: Vec<Observation> = (0..3 * 360_000).map(seen).collect();
        assert!(part_of_surface(&all[..2 * PART_PIXELS - 1]).is_none());
        let part = part_of_surface(&all).unwrap();
        assert!((PART_PIXELS / 2..PART_PIXELS * 2).contains(&part.len()), "{}", part.len());
        let mut times = vec![0; 360_000];
        part.iter().for_each(|seen| times[seen.pixel.pixel as usize % 360_000] += 1);
        assert!(times.iter().all(|times| [0, 3].contains(times)));
    }
}
