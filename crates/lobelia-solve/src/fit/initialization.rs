//! The initialization of a fit: solves alternately for amplitudes and albedo, starting from gray
//! albedo and uniform light.
//!
//! For fixed axes and sharpness, radiance is linear in the amplitudes of the lobes, and for fixed
//! light it is linear in the albedo. A light that were solved for as if the albedo were known would
//! hardly leave the one that goes with it, so from the second round on a solve for light lets the
//! albedo [follow](crate::fit::elimination). Once the amplitudes of uniformly distributed lobes are
//! known, lobes with very little power are moved to resolve the bright parts: like split and merge
//! in [`fit_map`](lobelia_world::light::map_fit), with photographs in place of the map.

use crate::fit::elimination::{Paints, TexelSums};
use crate::fit::{components::Unknowns, loss::radiance};
use crate::shade::systems::{kernel_specular, turned};
use crate::visibility::{ObjectVisibility, Reflectance, WindowVisibility};
use bevy_ecs::prelude::{With, World};
use bevy_ecs::system::SystemState;
use glam::{DVec3, Mat3, Vec3};
use lobelia_geometry::view::{ByView, Camera, Photograph, Placement, ViewIndex};
use lobelia_geometry::{Error, Result, error::stop::check_interrupted, parallel};
use lobelia_sg::linear::descend_nonnegative;
use lobelia_sg::shading::{
    ClosedForm, Layers, Lighting, LobeColumns, LobeVisibility, PointVisibility, ShadePoint, SpecularValue,
};
use lobelia_sg::{brdf::Ndf, color::luminance, published::Lobe, sg::sphere_integral, shading::RESPONSE_ROWS};
use lobelia_world::light::groups::{all_lights, entities_of_group, light_groups};
use lobelia_world::light::placement::{LightGroup, PlacedFrame};
use lobelia_world::material::{
    MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe, USUAL_ALBEDO, recovered_albedo, recovered_materials,
};
use lobelia_world::sample::{Observation, Observations, light_rotations, point::SurfacePoint};
use lobelia_world::{light::LightLobe, material::diffuse::write_albedo};
use std::{borrow::Cow, f32::consts::FRAC_1_PI, ops::Range};
use tracing::info_span;

/// Pixels in a solve for the amplitudes, about, of texels of which each has all of its pixels.
const AMPLITUDE_PIXELS: usize = 24_000;
/// Pixels in such a solve on a part of the surface, about.
const PART_AMPLITUDE_PIXELS: usize = 8000;
/// Most pixels in a solve for the albedo…
const ALBEDO_PIXELS: usize = 400_000;
/// …or this many per texel, if that is more.
const PIXELS_PER_TEXEL: usize = 4;
/// Pixels on the part of the surface that starts are tried on, about.
const PART_PIXELS: usize = 60_000;
/// Rounds, each of light and then albedo.
const ROUNDS: usize = 4;

/// Points whose visibility is in memory at a time.
const LIT_AT_ONCE: usize = 1 << 16;

/// Solves alternately for amplitudes and albedo, where they are unknown, starting from gray, with
/// the closed form `form`; if `shadowed`, with occlusion and interreflection from
/// [`ObjectVisibility`]. The light stands still in the world's [`PlacedFrame`].
pub(crate) fn initialize_light_and_albedo(
    world: &mut World,
    unknowns: Unknowns,
    form: ClosedForm,
    shadowed: bool,
) -> Result<()> {
    if !unknowns.light && !unknowns.albedo {
        return Ok(());
    }
    let mut lights = all_lights(world);
    let specular = least_rough(world);
    let mut texels = recovered_albedo(world)?;
    let object = traced(world, shadowed);
    let known = Known { form, specular, unknowns, object, in_part: false, placement: None };
    with_initialization(world, known, |problems| alternate(problems, &mut lights, &mut texels))?;
    for (number, lobes) in (0..).zip(lights) {
        let entities = entities_of_group(world, LightGroup(number));
        world.insert_batch(entities.into_iter().zip(lobes));
    }
    write_albedo(world, &texels)
}

/// The occlusion of the object, without the light of the last update, if it is `shadowed`.
pub(crate) fn traced(world: &World, shadowed: bool) -> Option<ObjectVisibility> {
    world.get_resource::<ObjectVisibility>().filter(|_| shadowed).map(ObjectVisibility::unlit)
}

/// The inputs of the initialization besides samples.
pub(crate) struct Known {
    pub form: ClosedForm,
    pub specular: SpecularLobe,
    pub unknowns: Unknowns,
    /// The occlusion of the object.
    pub object: Option<ObjectVisibility>,
    /// Whether [`of_some_texels`] is enough.
    pub in_part: bool,
    /// The only placement that is looked at.
    pub placement: Option<Placement>,
}

/// Calls `run` with the data of the initialization of each group of photographs, in order; the
/// first are those under the scene's own light.
pub(crate) fn with_initialization<T>(
    world: &mut World,
    known: Known,
    run: impl FnOnce(&mut [Initialization]) -> Result<T>,
) -> Result<T> {
    let lights = light_groups(world);
    let Known { in_part, placement, .. } = known;
    let frame = PlacedFrame::own(world);
    let mut views = world.query_filtered::<(&ViewIndex, &Camera, Option<&Placement>), With<Photograph>>();
    let views = views.iter(world);
    let views: Vec<(ViewIndex, Camera, Placement)> =
        views.map(|(index, camera, of)| (*index, *camera, of.copied().unwrap_or_default())).collect();
    let cameras: ByView<Camera> = views.iter().map(|(index, camera, _)| (*index, *camera)).collect();
    let placements: ByView<Placement> = views.iter().map(|(index, _, of)| (*index, *of)).collect();
    let turns = light_rotations(&frame, views.into_iter());
    let mut state = SystemState::<Observations>::new(world);
    let observations = state.get(world).map_err(|error| Error::run("fit", error.to_string()))?.columns()?;
    let of = |row: &Observation| placements.get(row.pixel.view).copied();
    let chosen: Option<Vec<Observation>> =
        placement.map(|only| observations.iter().filter(|row| of(row) == Some(only)).copied().collect());
    let all = chosen.as_deref().unwrap_or(&observations);
    // Rows are in the order of their groups.
    let of_group = |number: usize| {
        let light = |row: &Observation| frame.placements.light(of(row).unwrap_or_default()).0 as usize;
        let rest = &all[all.partition_point(|row| light(row) < number)..];
        &rest[..rest.partition_point(|row| light(row) == number)]
    };
    let part = |all| if in_part { Cow::Owned(of_some_texels(all, PART_PIXELS)) } else { Cow::Borrowed(all) };
    let parts: Vec<Cow<[Observation]>> = (0..lights).map(of_group).map(part).collect();
    let problem = |observations| {
        let known = Known { object: known.object.as_ref().map(ObjectVisibility::unlit), ..known };
        Initialization { known, observations, cameras: &cameras, placements: &placements, turns: &turns }
    };
    run(&mut parts.iter().map(|part| problem(part.as_ref())).collect::<Vec<_>>())
}

/// Solves alternately for the lights of the groups and the albedo that is common to them.
fn alternate(
    problems: &mut [Initialization],
    lights: &mut [Vec<LightLobe>],
    texels: &mut Vec<Vec3>,
) -> Result<()> {
    let unknowns = problems[0].known.unknowns;
    for round in 0..ROUNDS {
        for (problem, lobes) in problems.iter_mut().zip(&mut *lights).filter(|_| unknowns.light) {
            check_interrupted()?;
            if round == 1 {
                move_lobes_to_the_light(lobes);
            }
            problem.solve_light(lobes, texels, round > 0)?;
        }
        check_interrupted()?;
        if unknowns.albedo {
            let _solving = info_span!("albedo").entered();
            let most = ALBEDO_PIXELS.max(PIXELS_PER_TEXEL * texels.len());
            let mut shaded = Vec::new();
            for (problem, lobes) in problems.iter_mut().zip(&*lights) {
                let n = problem.observations.len().min(most);
                shaded.push((&problem.observations[..n], problem.of_white(lobes, texels, n)?));
            }
            let pixels = shaded.iter().flat_map(|(observations, white)| observations.iter().zip(white));
            *texels = solve_albedo(pixels, texels, Vec3::splat(USUAL_ALBEDO));
        }
    }
    Ok(())
}

/// The texel that a pixel shows most of.
fn texel_of(pixel: &Observation) -> u32 {
    pixel.point.texels.main()
}

/// About `most` pixels, in order of the texel that they show: all that see some texels, so that these
/// are known as well as if all of the surface were looked at. All pixels, if they are not twice as
/// many.
fn of_some_texels(all: &[Observation], most: usize) -> Vec<Observation> {
    let every = (all.len() / most) as u32;
    let is_in = |pixel: &Observation| {
        // Parts of a part are independent of it.
        let mixed = (texel_of(pixel) ^ (most as u32) << 8).wrapping_mul(0x9e37_79b1);
        every < 2 || ((mixed ^ mixed >> 15).wrapping_mul(0x2c1b_3c6d) >> 12).is_multiple_of(every)
    };
    let mut some: Vec<Observation> =
        parallel::flat_map(all.len(), 4096, |i| is_in(&all[i]).then_some(all[i]));
    // A surface of few texels has more pixels in each.
    if some.len() < most / 4 {
        some = all.to_vec();
    }
    some.truncate(2 * most);
    some.sort_by_key(texel_of);
    some
}

/// The lowest corner of the box around observed points, and its longest side, world units.
pub(super) fn extent(observations: &[Observation]) -> (Vec3, f32) {
    let nowhere = [Vec3::INFINITY, Vec3::NEG_INFINITY];
    let around = |a: [Vec3; 2], b: [Vec3; 2]| [a[0].min(b[0]), a[1].max(b[1])];
    let of_chunk = |chunk: &[Observation]| {
        chunk.iter().map(|observation| [observation.point.position; 2]).fold(nowhere, around)
    };
    let boxes: Vec<[Vec3; 2]> = parallel::map_items(observations.chunks(4096), of_chunk);
    let [low, high] = boxes.into_iter().fold(nowhere, around);
    (low, (high - low).max_element().max(1e-6))
}

/// The base material of least roughness that a texel has: it shows best where the light is. (With
/// the mean of two, the fitted roughness is farther from the truth.) As a spherical Gaussian, which
/// does as well here as GGX in a third of the time.
pub(super) fn least_rough(world: &mut World) -> SpecularLobe {
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
    pub known: Known,
    pub observations: &'a [Observation],
    pub cameras: &'a ByView<Camera>,
    pub placements: &'a ByView<Placement>,
    turns: &'a ByView<Mat3>,
}

impl Initialization<'_> {
    /// Solves alternately for the light of these photographs and the albedo.
    pub fn alternate(&mut self, lobes: &mut Vec<LightLobe>, texels: &mut Vec<Vec3>) -> Result<()> {
        alternate(std::slice::from_mut(self), std::slice::from_mut(lobes), texels)
    }

    /// Solves for the amplitudes; `is_lit` if the lobes have some that explain the photographs
    /// already.
    fn solve_light(&mut self, lobes: &mut [LightLobe], texels: &[Vec3], is_lit: bool) -> Result<()> {
        let _solving = info_span!("light").entered();
        let most = if self.known.in_part { PART_AMPLITUDE_PIXELS } else { AMPLITUDE_PIXELS };
        let observations = of_some_texels(self.observations, most);
        let columns = LobeColumns::from_lobes(lobes.iter().map(Into::into));
        self.refresh(&columns, texels);
        let lit = self.lit(&observations, &columns, |point| point.texels.blend(texels))?;
        let (form, own) = (self.known.form, &self.known.specular);
        let shaded = if is_lit { lit.shade(form, own) } else { Vec::new() };
        // In clipped channels it should be more than that of the photographs, if the light until
        // now says so.
        let target = |(i, Observation { observed, .. }): (usize, &Observation)| {
            shaded.get(i).map_or(observed.radiance, |shaded| observed.target(radiance(shaded)))
        };
        let targets: Vec<Vec3> = observations.iter().enumerate().map(target).collect();
        let diffuse: Vec<Vec3> = shaded.iter().map(|shaded| shaded.diffuse.into()).collect();
        let diffuse = Some(diffuse.as_slice()).filter(|_| self.known.unknowns.albedo && is_lit);
        let specular = kernel_specular(own);
        let amplitudes =
            solve_amplitudes(form, &observations, &lit.points, &targets, diffuse, &specular, lit.lighting());
        for (lobe, amplitude) in lobes.iter_mut().zip(amplitudes) {
            lobe.amplitude = amplitude.max(Vec3::splat(1e-3));
        }
        Ok(())
    }

    /// The radiance of the first `n` pixels if the surface were white.
    fn of_white(&mut self, lobes: &[LightLobe], texels: &[Vec3], n: usize) -> Result<Vec<Layers>> {
        let columns = LobeColumns::from_lobes(lobes.iter().map(Into::into));
        self.refresh(&columns, texels);
        let mut unit = Vec::with_capacity(n);
        for start in (0..n).step_by(LIT_AT_ONCE) {
            let white =
                self.lit(&self.observations[start..n.min(start + LIT_AT_ONCE)], &columns, |_| Vec3::ONE)?;
            unit.append(&mut white.shade(self.known.form, &self.known.specular));
        }
        Ok(unit)
    }

    /// Finds the shadows and the reflected light of these lobes on a surface of this albedo.
    pub fn refresh(&mut self, lobes: &LobeColumns, texels: &[Vec3]) {
        let _refreshing = info_span!("shadows").entered();
        let SpecularLobe { albedo: specular, roughness, .. } = self.known.specular;
        let Some(object) = &mut self.known.object else { return };
        let of = |texel: u32| Reflectance { diffuse: texels[texel as usize], specular, roughness };
        object.refresh(lobes, self.turns.all(), &of);
    }

    /// The inputs of shading at these pixels, with this albedo.
    pub fn lit<'l>(
        &self,
        observations: &[Observation],
        lobes: &'l LobeColumns,
        albedo: impl Fn(&SurfacePoint) -> Vec3 + Sync,
    ) -> Result<Lit<'l>> {
        let viewer = |Observation { pixel, .. }: &Observation| {
            Ok(-self.cameras.of(pixel.view)?.pixel_ray(pixel.pixel).direction)
        };
        let viewers = parallel::map_slice(observations, 1024, viewer);
        let viewers = viewers.into_iter().collect::<Result<Vec<Vec3>>>()?;
        let point = |i: usize| {
            let Observation { pixel, point, .. } = &observations[i];
            let albedo = albedo(point).into();
            let point = ShadePoint { normal: point.normal.into(), to_viewer: viewers[i].into(), albedo };
            self.turns.get(pixel.view).map_or(point, |turn| turned(&point, *turn))
        };
        let points = parallel::map(observations.len(), 1024, point);
        let (mut rows, mut seen) = (WindowVisibility::default(), Vec::new());
        if let Some(object) = &self.known.object {
            seen.resize(observations.len(), PointVisibility::OPEN);
            let surface: Vec<SurfacePoint> = parallel::map_slice(observations, 1024, |o| o.point);
            let viewer = |i: usize| (viewers[i], observations[i].pixel);
            object.window(&surface, viewer, |_| self.known.specular.roughness, None, &mut rows, &mut seen);
        }
        Ok(Lit { lobes, points, rows, seen })
    }

    /// Mean absolute difference between the observed pixels and what this light and albedo show, over
    /// pixels and channels.
    pub fn error(&self, lobes: &[LightLobe], texels: &[Vec3]) -> Result<f32> {
        let columns = LobeColumns::from_lobes(lobes.iter().map(Into::into));
        let lit = self.lit(self.observations, &columns, |point| point.texels.blend(texels))?;
        let of = |(shaded, Observation { observed, .. }): (&Layers, &Observation)| {
            let [r, g, b] = observed.differences(radiance(shaded)).abs().to_array();
            f64::from(r + g + b)
        };
        let shaded = lit.shade(self.known.form, &self.known.specular);
        let sum: f64 = shaded.iter().zip(self.observations).map(of).sum();
        Ok((sum / (3 * self.observations.len().max(1)) as f64) as f32)
    }
}

/// Points, and what they see of the light.
pub(crate) struct Lit<'a> {
    lobes: &'a LobeColumns,
    pub points: Vec<ShadePoint>,
    rows: WindowVisibility,
    /// Empty without visibility.
    seen: Vec<PointVisibility>,
}

impl Lit<'_> {
    pub fn lighting(&self) -> Lighting<'_> {
        Lighting { lobes: self.lobes, visibility: self.rows.view(&self.seen) }
    }

    /// Radiance of the points if this is their specular lobe.
    pub fn shade(&self, form: ClosedForm, specular: &SpecularLobe) -> Vec<Layers> {
        let mut shaded = vec![Layers::default(); self.points.len()];
        form.shade(&self.points, &kernel_specular(specular), self.lighting(), &mut shaded);
        shaded
    }
}

/// Texels whose pixels a thread processes at a time; the chunk of the fixed-order sums.
const CHUNK: usize = 16;
/// Weight of the prior of a texel's albedo in a solve for albedo, in pixels of mean irradiance.
const PRIOR_IN_ALBEDO: f64 = 1.0;
/// Lobes whose products are summed at once, in registers.
const TILE: usize = 16;
/// Responses below this count as none, because products of two such are subnormal numbers, with
/// which processors are many times slower.
const TINY: f32 = 1e-18;
/// Weight of the prior toward equal amplitudes, relative to the mean diagonal of the normal
/// equations: it determines lobes that no pixel distinguishes.
const RIDGE: f64 = 1e-2;
/// Most sweeps of the descent to the amplitudes.
const SWEEPS: usize = 300;

/// Responses of a chunk of points to unit lobes in one channel: [`TILE`] lobes of every point after
/// each other, then the next lobes.
type Responses = Vec<[f32; TILE]>;

/// A chunk of points: its responses and targets of each channel.
struct Rows {
    responses: [Responses; 3],
    targets: [Vec<f32>; 3],
}

impl Rows {
    fn new(count: usize, lobes: usize) -> Self {
        let responses = std::array::from_fn(|_| vec![[0.0; TILE]; lobes.div_ceil(TILE) * count]);
        Self { responses, targets: std::array::from_fn(|_| vec![0.0; count]) }
    }
}

/// The ranges of pixels of one texel.
fn runs_of_texels(pixels: &[Observation]) -> Vec<Range<usize>> {
    let runs = pixels.chunk_by(|a, b| texel_of(a) == texel_of(b));
    let next = |end: &mut usize, run: &[Observation]| {
        *end += run.len();
        Some(*end - run.len()..*end)
    };
    runs.scan(0, next).collect()
}

/// Non-negative amplitudes of the lobes (whose own are ignored) that fit the radiance of the pixels
/// best in the least-squares sense, given the specular material, the visibility and the albedo at
/// the points. Where there is `diffuse` radiance, the albedo [follows](crate::fit::elimination).
/// Pixels are in order of their texels.
fn solve_amplitudes(
    form: ClosedForm,
    observations: &[Observation],
    points: &[ShadePoint],
    targets: &[Vec3],
    diffuse: Option<&[Vec3]>,
    specular: &SpecularValue,
    Lighting { lobes, visibility }: Lighting<'_>,
) -> Vec<Vec3> {
    let of_unit = |i: usize| Lobe { amplitude: [1.0; 3], ..lobes.get(i) };
    let lobes = LobeColumns::from_lobes((0..lobes.len()).map(of_unit));
    let stride = lobes.stride();
    let chunk = |runs: &[Range<usize>]| {
        let run = runs[0].start..runs[runs.len() - 1].end;
        let count = run.len();
        let mut values = vec![0.0; count * RESPONSE_ROWS * stride];
        form.respond(&points[run.clone()], specular, &lobes, &mut values);
        let mut rows = Rows::new(count, lobes.len());
        for (k, (n, value)) in run.clone().zip(values.chunks_exact(RESPONSE_ROWS * stride)).enumerate() {
            let (parts, around) = LobeVisibility::point(visibility, n, stride);
            let (irradiance, glossy) = value.split_at(stride);
            for (c, glossy) in glossy.chunks_exact(stride).enumerate() {
                let diffuse = points[n].albedo[c] * FRAC_1_PI;
                // The visibility of a lobe approximates the visibility of its specular light, and
                // does not need the amplitudes.
                let part = |i: usize| parts.map_or(1.0, |parts| f32::from(parts[i]) / 255.0);
                for i in 0..lobes.len() {
                    let response = (diffuse * irradiance[i] + glossy[i]) * part(i);
                    rows.responses[c][i / TILE * count + k][i % TILE] =
                        if response < TINY { 0.0 } else { response };
                }
                rows.targets[c][k] = (targets[n][c] - diffuse * around.indirect[c]).max(0.0);
            }
        }
        rows
    };
    let runs = runs_of_texels(observations);
    let rows: Vec<Rows> = parallel::map_items(runs.chunks(CHUNK), chunk);
    let mut channels = [0, 1, 2].map(|channel| normal_equations(&rows, channel, lobes.len()));
    if let Some(diffuse) = diffuse {
        let places: Vec<Vec3> = runs.iter().map(|run| observations[run.start].point.position).collect();
        let albedo: Vec<Vec3> = runs.iter().map(|run| points[run.start].albedo.into()).collect();
        let squares: f32 = diffuse.iter().map(|diffuse| diffuse.length_squared()).sum();
        let paints = Paints::new(&places, &albedo, squares / (3 * diffuse.len().max(1)) as f32);
        for (c, system) in channels.iter_mut().enumerate() {
            paints.eliminate(c, &sums_of_texels(&rows, &runs, diffuse, c, lobes.len()), system);
        }
    }
    let solved: Vec<Vec<f64>> = parallel::map_items(channels, |(matrix, right)| solve(matrix, &right, RIDGE));
    (0..lobes.len()).map(|i| Vec3::from_array(std::array::from_fn(|c| solved[c][i] as f32))).collect()
}

/// Sums over the pixels of texels, in a channel: each adds its `diffuse` radiance times its equation.
fn sums_of_texels(
    rows: &[Rows],
    runs: &[Range<usize>],
    diffuse: &[Vec3],
    c: usize,
    lobes: usize,
) -> TexelSums {
    let mut sums = TexelSums { responses: vec![0.0; runs.len() * lobes], ..TexelSums::default() };
    let mut lines = sums.responses.chunks_exact_mut(lobes);
    for (rows, runs) in rows.iter().zip(runs.chunks(CHUNK)) {
        let count = rows.targets[c].len();
        for (run, line) in runs.iter().zip(&mut lines) {
            let (mut squares, mut targets) = (0.0, 0.0);
            for n in run.clone() {
                let (k, weight) = (n - runs[0].start, diffuse[n][c]);
                squares += weight * weight;
                targets += weight * rows.targets[c][k];
                for (line, tile) in line.chunks_mut(TILE).zip(rows.responses[c][k..].iter().step_by(count)) {
                    line.iter_mut().zip(tile).for_each(|(sum, response)| *sum += weight * response);
                }
            }
            sums.squares.push(squares);
            sums.targets.push(targets);
        }
    }
    sums
}

/// The normal equations of one channel: the symmetric matrix row by row, and the right side.
/// Products of lobes are summed in f32 over a chunk, and chunks in f64.
fn normal_equations(rows: &[Rows], channel: usize, n: usize) -> (Vec<f64>, Vec<f64>) {
    let mut matrix = vec![0.0; n * n];
    let mut right = vec![0.0; n];
    let lines = matrix.chunks_mut(TILE * n).zip(right.chunks_mut(TILE)).enumerate();
    parallel::for_each(lines, |(tile, (lines, right))| {
        for Rows { responses, targets } in rows {
            let (responses, targets) = (&responses[channel], &targets[channel]);
            let own = &responses[tile * targets.len()..][..targets.len()];
            for (other, responses) in responses.chunks_exact(targets.len()).take(tile + 1).enumerate() {
                let products = lobelia_sg::dispatch!(_simd => tile_products(own, responses));
                for (line, products) in lines.chunks_exact_mut(n).zip(&products) {
                    let sums = line[other * TILE..].iter_mut().zip(products);
                    sums.for_each(|(sum, product)| *sum += f64::from(*product));
                }
            }
            for (response, target) in own.iter().zip(targets) {
                right.iter_mut().zip(response).for_each(|(sum, a)| *sum += f64::from(a * target));
            }
        }
    });
    for i in 0..n {
        for j in 0..i {
            matrix[j * n + i] = matrix[i * n + j];
        }
    }
    (matrix, right)
}

/// Sums over points of the products of all lobes of a tile with all of another.
#[inline(always)]
fn tile_products(a: &[[f32; TILE]], b: &[[f32; TILE]]) -> [[f32; TILE]; TILE] {
    let mut products = [[0.0; TILE]; TILE];
    // So few lines at a time stay in registers.
    for start in (0..TILE).step_by(4) {
        let mut sums = [[0.0; TILE]; 4];
        for (a, b) in a.iter().zip(b) {
            for line in 0..4 {
                for k in 0..TILE {
                    sums[line][k] += a[start + line] * b[k];
                }
            }
        }
        products[start..start + 4].copy_from_slice(&sums);
    }
    products
}

/// Non-negative solution of normal equations with the prior, from equal amplitudes.
fn solve(mut matrix: Vec<f64>, right: &[f64], ridge: f64) -> Vec<f64> {
    let n = right.len();
    let diagonal: f64 = (0..n).map(|i| matrix[i * n + i]).sum::<f64>() / n as f64;
    let total: f64 = matrix.iter().sum();
    let level = (right.iter().sum::<f64>() / total.max(1e-30)).max(0.0);
    let mut x = vec![level; n];
    // The prior has no slope at equal amplitudes.
    let slope = |(row, right): (&[f64], &f64)| level * row.iter().sum::<f64>() - right;
    let mut gradient: Vec<f64> = matrix.chunks_exact(n).zip(right).map(slope).collect();
    (0..n).for_each(|i| matrix[i * n + i] += ridge * diagonal + 1e-30);
    descend_nonnegative(&matrix, &mut x, &mut gradient, SWEEPS);
    x
}

/// Each texel's least-squares albedo given the light: `pixels` are samples with their radiance if
/// the albedo were 1, `before` the albedo until now, with which clipped samples are brighter than
/// they are seen or not. Each is drawn to `prior` as by [`PRIOR_IN_ALBEDO`]. Results are in
/// `[0.02, 0.98]`.
fn solve_albedo<'a>(
    pixels: impl Iterator<Item = (&'a Observation, &'a Layers)>,
    before: &[Vec3],
    prior: Vec3,
) -> Vec<Vec3> {
    let texels = before.len();
    let (mut above, mut below) = (vec![DVec3::ZERO; texels], vec![DVec3::ZERO; texels]);
    let (mut power, mut count) = (DVec3::ZERO, 0u32);
    for (Observation { point, observed, .. }, unit) in pixels {
        let (white, specular) = (Vec3::from(unit.diffuse), Vec3::from(unit.specular));
        let target = (observed.target(white * point.texels.blend(before) + specular) - specular).as_dvec3();
        let diffuse = white.as_dvec3();
        power += diffuse * diffuse;
        count += 1;
        for i in 0..4 {
            let (texel, weight) = (point.texels.indices[i] as usize, f64::from(point.texels.weights[i]));
            above[texel] += diffuse * target * weight;
            below[texel] += diffuse * diffuse * weight;
        }
    }
    let lean = power * (PRIOR_IN_ALBEDO / f64::from(count.max(1))) + DVec3::splat(1e-12);
    let prior = prior.as_dvec3();
    let albedo = |(a, b): (&DVec3, &DVec3)| (*a + lean * prior) / (*b + lean);
    let in_range = |albedo: DVec3| albedo.clamp(DVec3::splat(0.02), DVec3::splat(0.98)).as_vec3();
    above.iter().zip(&below).map(albedo).map(in_range).collect()
}

/// A lobe may be moved if its power is below this fraction of the mean power.
const FAINT: f32 = 0.25;
/// Most lobes that are moved at a time, as a fraction of all.
const MOST: f32 = 0.25;
/// A lobe sharper than this is not split, because photographs do not resolve more.
const SHARPEST: f32 = 400.0;

/// Removes up to a quarter of the lobes, the faintest, and for each splits one of the brightest in
/// two; the total power stays the same.
///
/// A lobe of sharpness λ becomes two of sharpness 2λ, half a standard deviation (1/√λ) to either
/// side on a great circle, so that together they are as wide as the original.
fn move_lobes_to_the_light(lobes: &mut [LightLobe]) {
    let total: f32 = lobes.iter().map(power).sum();
    if total <= 0.0 || total.is_nan() {
        return;
    }
    let faint = FAINT * total / lobes.len() as f32;
    for turn in 0..(lobes.len() as f32 * MOST) as usize {
        let by_power = |a: &usize, b: &usize| power(&lobes[*a]).total_cmp(&power(&lobes[*b]));
        let weakest = (0..lobes.len()).min_by(by_power);
        let strongest = (0..lobes.len()).filter(|i| lobes[*i].sharpness <= SHARPEST).max_by(by_power);
        let (Some(weakest), Some(strongest)) = (weakest, strongest) else { return };
        if power(&lobes[weakest]) > faint || power(&lobes[strongest]) < 2.0 * faint {
            return;
        }
        let LightLobe { axis, sharpness, amplitude } = lobes[strongest];
        let (across, along) = axis.any_orthonormal_pair();
        let (sin, cos) = (turn as f32 * 2.4).sin_cos();
        let apart = (across * cos + along * sin) * (0.5 / sharpness.max(1.0).sqrt());
        let amplitude = amplitude * (0.5 * integral(sharpness) / integral(2.0 * sharpness));
        let half = |axis: Vec3| LightLobe { axis: axis.normalize(), sharpness: 2.0 * sharpness, amplitude };
        lobes[strongest] = half(axis + apart);
        lobes[weakest] = half(axis - apart);
    }
}

/// Luminance of the amplitude times the integral over the sphere.
fn power(lobe: &LightLobe) -> f32 {
    luminance(lobe.amplitude) * integral(lobe.sharpness)
}

fn integral(sharpness: f32) -> f32 {
    sphere_integral(f64::from(sharpness)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_sg::fibonacci::{fibonacci_axes, spacing_sharpness};
    use lobelia_sg::ray::TexelAddress;
    use lobelia_world::sample::pixel::{Observed, PixelOf};

    fn pixel(number: u32, texel: u32) -> Observation {
        let texels = TexelAddress { indices: [7, texel, 7, 7], weights: [0.1, 0.7, 0.1, 0.1] };
        let pixel = PixelOf { pixel: number, ..PixelOf::default() };
        Observation {
            pixel,
            point: SurfacePoint { texels, ..SurfacePoint::default() },
            ..Observation::default()
        }
    }

    #[test]
    fn a_part_of_the_surface_has_all_pixels_of_its_texels() {
        // Each of 360 000 texels is seen three times.
        let all: Vec<Observation> = (0..3 * 360_000).map(|i| pixel(i, i % 360_000)).collect();
        assert_eq!(of_some_texels(&all[..PART_PIXELS], PART_PIXELS).len(), PART_PIXELS);
        let part = of_some_texels(&all, PART_PIXELS);
        let few = of_some_texels(&part, PART_PIXELS / 8);
        for (part, most) in [(&part, PART_PIXELS), (&few, PART_PIXELS / 8)] {
            assert!((most / 2..most * 2).contains(&part.len()), "{}", part.len());
            assert!(part.chunk_by(|a, b| texel_of(a) == texel_of(b)).all(|texel| texel.len() == 3));
            assert_eq!(runs_of_texels(part)[1], 3..6);
        }
        // Of one texel they are as many.
        let all: Vec<Observation> = (0..9000).map(|i| pixel(i, 5)).collect();
        assert_eq!(of_some_texels(&all, 1000).len(), 2000);
    }

    /// Chunks of 200 points in all, of which each sees `response(point, lobe)` of a lobe in every
    /// channel, and shows what the amplitudes `truth` make of it.
    fn rows(truth: &[f32], response: impl Fn(usize, usize) -> f32) -> Vec<Rows> {
        let chunk = |points: Range<usize>| {
            let mut rows = Rows::new(points.len(), truth.len());
            for (c, (k, point)) in (0..3).flat_map(|c| points.clone().enumerate().map(move |of| (c, of))) {
                for lobe in 0..truth.len() {
                    rows.responses[c][lobe / TILE * points.len() + k][lobe % TILE] = response(point, lobe);
                }
                rows.targets[c][k] = truth.iter().enumerate().map(|(i, x)| response(point, i) * x).sum();
            }
            rows
        };
        vec![chunk(0..130), chunk(130..200)]
    }

    #[test]
    fn amplitudes_are_found_again_and_none_is_negative() {
        for lobes in [11, 37] {
            let response = |pixel, lobe| 0.5 + 0.5 * (0.731 * (pixel * (lobe + 1)) as f32).sin();
            let amplitude = |i| if i % 3 == 0 { 0.0 } else { 0.3 + 0.1 * i as f32 };
            let truth: Vec<f32> = (0..lobes).map(amplitude).collect();
            let (matrix, right) = normal_equations(&rows(&truth, response), 1, lobes);
            for (i, j) in [(0, 0), (3, 8), (10, 2), (lobes - 1, 1), (1, lobes - 1)] {
                let sum: f64 = (0..200).map(|p| f64::from(response(p, i) * response(p, j))).sum();
                assert!((matrix[i * lobes + j] - sum).abs() < 1e-3, "{i} {j}");
            }
            for (found, truth) in solve(matrix, &right, 0.0).iter().zip(&truth) {
                assert!((found - f64::from(*truth)).abs() < 1e-2 && *found >= 0.0, "{found} {truth}");
            }
        }
    }

    #[test]
    fn the_prior_makes_of_nothing_nothing_and_of_what_no_pixel_sees_the_mean() {
        let (matrix, right) = normal_equations(&rows(&[0.0; 5], |_, _| 0.0), 0, 5);
        assert_eq!(solve(matrix, &right, 1e-2), vec![0.0; 5]);
        let (matrix, right) = normal_equations(&rows(&[2.0; 5], |_, lobe| f32::from(lobe != 3)), 0, 5);
        let found = solve(matrix, &right, 1e-2);
        assert!(found.iter().all(|x| (x - 2.0).abs() < 1e-3), "{found:?}");
    }

    #[test]
    fn clipped_samples_do_not_darken_an_albedo() {
        // One texel of albedo 0.6 under lights from 0.5 to 2.5: the photograph ends at 1.
        let lights: [f32; 9] = std::array::from_fn(|i| 0.5 + 0.25 * i as f32);
        let unit = lights.map(|light| Layers { diffuse: [light; 3], specular: [0.0; 3] });
        let texels = TexelAddress { weights: [1.0, 0.0, 0.0, 0.0], ..TexelAddress::default() };
        let point = SurfacePoint { texels, ..SurfacePoint::default() };
        let observations = lights.map(|light| {
            let radiance = Vec3::splat((0.6 * light).min(1.0));
            let observed = Observed { radiance, saturated: 0.6 * light >= 1.0 };
            Observation { observed, point, ..Observation::default() }
        });
        let mut albedo = vec![Vec3::splat(0.4)];
        let mut found = Vec::new();
        for _ in 0..30 {
            albedo = solve_albedo(observations.iter().zip(&unit), &albedo, Vec3::splat(0.6));
            found.push(albedo[0].x);
        }
        assert!(found[0] < 0.52 && (found[29] - 0.6).abs() < 1e-3, "{found:?}");
        assert!(found.windows(2).all(|pair| pair[1] >= pair[0] - 1e-6), "{found:?}");
    }

    #[test]
    fn faint_lobes_go_to_the_bright_side_and_power_stays() {
        let sharpness = spacing_sharpness(64);
        let bright = |axis: Vec3| if axis.y > 0.8 { 1.0 } else { 1e-3 };
        let lobe = |axis| LightLobe { axis, sharpness, amplitude: Vec3::splat(bright(axis)) };
        let mut lobes: Vec<LightLobe> = fibonacci_axes(64).into_iter().map(lobe).collect();
        let before: f32 = lobes.iter().map(power).sum();
        let shining = |lobes: &[LightLobe]| lobes.iter().filter(|l| l.amplitude.x > 0.1).count();
        let many = shining(&lobes);
        move_lobes_to_the_light(&mut lobes);
        assert_eq!(shining(&lobes), many + 16);
        assert!(lobes.iter().all(|l| l.amplitude.x < 0.1 || l.axis.y > 0.6));
        let after: f32 = lobes.iter().map(power).sum();
        assert!((after / before - 1.0).abs() < 0.02, "{before} {after}");
        assert!(lobes.iter().all(|l| (l.axis.length() - 1.0).abs() < 1e-5 && l.amplitude.is_finite()));
        // An even or dark light is left alone.
        for amplitude in [Vec3::ZERO, Vec3::ONE] {
            let lobe = |axis| LightLobe { axis, sharpness: 20.0, amplitude };
            let lobes: Vec<LightLobe> = fibonacci_axes(32).into_iter().map(lobe).collect();
            let mut moved = lobes.clone();
            move_lobes_to_the_light(&mut moved);
            assert_eq!(moved, lobes);
        }
    }
}
