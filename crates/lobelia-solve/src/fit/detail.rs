//! The detail of a texture: each texel's albedo, sheen and tilt, from every pixel that shows it.
//!
//! A fit by small random steps finds light, shape and specular lobes from a part of the pixels;
//! more pixels and finer texels would only make it slower. The detail of the albedo needs all of
//! them. With everything else held, the radiance is linear in albedo and sheen, and nearly so in
//! the tilt, so that least squares over all training photographs gives them at once
//! ([`TexelEquations`]): a step of variable projection (Golub and Pereyra 2003). A pixel sees a
//! bilinear mixture of four texels; its residual counts for each by its weight, and some sweeps
//! over all pixels take back what this blurs (as SIRT does, Gilbert 1972). Pixels that disagree
//! with the others of a texel, by highlights and shadows that the model does not have, count less.
//!
//! The equations of a texel: with light, shape and specular lobes held, the radiance of a pixel is
//! L = (ρ + g s + ρ̄ t · v⊥) u + L_s in the albedo ρ, the sheen s and the tilt t of its texels
//! ([`lobelia_world::material::diffuse`]), where g = 1 − c and u is the diffuse radiance of a white
//! surface. A pixel with residual r then says, for changes of the albedo, the sheen and the
//! difference ρ̄ t between sides,
//!
//! δρ + g δs + ρ̄ δt · v⊥ = r / u.
//!
//! All channels share the weight, that of their mean radiance, and the direction of the tilt, so
//! that weighted least squares over the pixels of a texel needs 31 sums.

use crate::fit::groups::{end_turns, groups_of_views};
use crate::fit::observe::{observed_in, spawn_samples, usable_by_view, usable_pixels};
use crate::fit::{components::TexelSeen, exposure::Exposures, metal::Metals};
use crate::shade::{frame::add_gathering, frame::trace_samples, shade_closed_form};
use bevy_ecs::prelude::{IntoScheduleConfigs, Query, Res, ResMut, Resource, World};
use glam::{Mat2, Mat3, Vec2, Vec3};
use half::f16;
use lobelia_geometry::view::{ByView, Camera, Photograph, ViewIndex};
use lobelia_geometry::{Result, error::stop::is_stopping, parallel};
use lobelia_sg::ray::TexelAddress;
use lobelia_sg::shading::{ClosedForm, Layers, ShadePoint};
use lobelia_world::light::lights::{LightChoice, provide_light};
use lobelia_world::material::diffuse::{KnownAlong, MOST_TILT, along_surface, grazing, has_sheen};
use lobelia_world::material::{Diffuse, SpecularBlend, TexelIndex, recovered_materials};
use lobelia_world::pipeline::pool::{read_column, write_column};
use lobelia_world::pipeline::{GatherPoints, Phase, Pipeline, Plugin, Slot, Stage, SystemResult};
use lobelia_world::sample::pixel::{Observed, PixelOf, ViewRay};
use lobelia_world::sample::{Samples, despawn_pool, pixel::Window, point::SurfacePoint};
use lobelia_world::{light::placement::GroupInTurn, material::material_source::RecoveredMaterial};
use std::ops::ControlFlow;
use tracing::info_span;

/// Sweeps over all pixels. They are cheap beside shading.
const SWEEPS: u32 = 7;
/// Most texels a side that a texture is refined to.
const MOST_SIDE: u32 = 2048;
/// Least pixels for a texel of a texture that is refined.
const PIXELS_OF_TEXEL: f64 = 2.0;
/// Pixels of one run of the phase, and of a sweep between two looks whether it is stopped.
const BATCH: usize = 1 << 16;
/// Most pixels that are kept; of more, every n-th is visited.
pub const MOST_PIXELS: usize = 1 << 25;
/// Part of the work that is shading.
const SHADING_PART: f32 = 0.8;

/// Settings of the solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetailOptions {
    /// Whether the tilt is unknown as well.
    pub tilt: bool,
    /// Whether the first base material may be a metal, beneath which there is no diffuse light
    /// ([`metal`](crate::fit::metal)).
    pub metal: bool,
}

/// The systems of [`Phase::Detail`], with accurate closed-form shading, without shadows, until other
/// systems are put into its slots ([`see_recovered`](crate::visibility::see_recovered) into
/// [`Slot::Visibility`]).
pub struct DetailPlugin;

impl Plugin for DetailPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.world.init_resource::<DetailPixels>();
        add_gathering::<RecoveredMaterial>(pipeline, Phase::Detail);
        pipeline
            .add_systems(Phase::Detail, Stage::Sample, show_pixels)
            .add_systems(Phase::Detail, Stage::Trace, trace_samples)
            .add_systems(Phase::Detail, Stage::Gather, whiten_points.after(GatherPoints))
            .swap(Phase::Detail, Slot::Light, provide_light(LightChoice::Own, false))
            .swap(Phase::Detail, Slot::Shading, shade_closed_form(ClosedForm::default()))
            .add_systems(Phase::Detail, Stage::Gradient, keep_pixels);
    }
}

/// The pixels of one run of the phase, and those that have been shaded.
#[derive(Resource, Default)]
pub struct DetailPixels {
    present: Vec<PixelOf>,
    kept: Vec<KeptPixel>,
}

/// Solves for albedo, sheen and tilt of all texels: shades the pixels of the training photographs,
/// then sweeps over them a few times. `watch` is called with the part of the work that is done.
/// Raises [`TexelSeen`] where the sweeps see more than the fit did. A run that is stopped keeps the
/// sweeps before.
///
/// # Errors
/// The first error of a system.
pub fn solve_detail(
    pipeline: &mut Pipeline,
    options: DetailOptions,
    watch: &mut dyn FnMut(f32),
) -> Result<()> {
    spawn_samples(&mut pipeline.world, BATCH);
    let shaded = shade_pixels(pipeline, &mut |part| watch(SHADING_PART * part));
    let pixels = std::mem::take(&mut *pipeline.world.resource_mut::<DetailPixels>()).kept;
    despawn_pool(&mut pipeline.world);
    end_turns(&mut pipeline.world);
    shaded?;
    let _sweeping = info_span!("sweeps").entered();
    for number in 0..SWEEPS {
        if sweep(&mut pipeline.world, &pixels, options)?.is_break() {
            break;
        }
        watch(SHADING_PART + (1.0 - SHADING_PART) * (number + 1) as f32 / SWEEPS as f32);
    }
    Ok(())
}

/// The most texels a side of a texture that so many pixels are visited for.
pub fn finest_side(pixels: f64) -> f64 {
    (pixels / PIXELS_OF_TEXEL).sqrt().min(f64::from(MOST_SIDE))
}

/// The pixels of the training photographs that are visited.
pub fn visited_pixels(world: &mut World) -> usize {
    let total: usize = usable_by_view(world).iter().map(|(_, pixels)| pixels).sum();
    total / total.div_ceil(MOST_PIXELS).max(1)
}

/// Shades all pixels as if the surface were white, and keeps them.
fn shade_pixels(pipeline: &mut Pipeline, watch: &mut dyn FnMut(f32)) -> Result<()> {
    let groups = groups_of_views(&mut pipeline.world);
    let group_of = |(view, _): &(ViewIndex, usize)| groups.get(*view).copied().unwrap_or_default();
    let mut views = usable_by_view(&mut pipeline.world);
    // Shadows are found once for the light of each group.
    views.sort_by_key(group_of);
    let total: usize = views.iter().map(|(_, pixels)| pixels).sum();
    let every = total.div_ceil(MOST_PIXELS).max(1);
    // As many as there may be, so that growing never copies them.
    let most = views.iter().map(|(_, pixels)| pixels.div_ceil(every)).sum();
    pipeline.world.resource_mut::<DetailPixels>().kept.reserve_exact(most);
    for (done, view) in (1..).zip(&views) {
        // The rest is left out once the run is stopped.
        if !is_stopping() {
            pipeline.world.insert_resource(GroupInTurn(group_of(view)));
            let pixels = usable_pixels(&mut pipeline.world, view.0, every);
            for part in pixels.chunks(BATCH).take_while(|_| !is_stopping()) {
                pipeline.world.resource_mut::<Window>().0 = 0..part.len();
                pipeline.world.resource_mut::<DetailPixels>().present = part.to_vec();
                pipeline.run(Phase::Detail)?;
            }
        }
        watch(done as f32 / views.len() as f32);
    }
    Ok(())
}

/// Visits all pixels, then moves albedo, sheen and tilt of all texels to the solution, within their
/// bounds. Without any sheen so far there will be none. Breaks if the run is stopped before.
fn sweep(world: &mut World, pixels: &[KeptPixel], options: DetailOptions) -> Result<ControlFlow<()>> {
    let mut texels = read_column::<TexelIndex, Diffuse>(world)?;
    let is_known = world.contains_resource::<KnownAlong>();
    let mut equations = vec![TexelEquations::default(); texels.len()];
    for part in pixels.chunks(BATCH) {
        if is_stopping() {
            return Ok(ControlFlow::Break(()));
        }
        add_pixels(part, &texels, is_known, &mut equations);
    }
    let (with_sheen, with_tilt) = (has_sheen(&texels) && !is_known, options.tilt && !is_known);
    let materials = if options.metal { recovered_materials(world) } else { Vec::new() };
    let metals = Metals::of(materials.iter().map(|(number, lobe)| (*number, lobe)));
    let blends = read_column::<TexelIndex, SpecularBlend>(world)?;
    let rows = (&mut *texels, (&*equations, &*blends));
    parallel::for_each_row(rows, 4096, |(texel, (equations, blend))| {
        let mean = texel.mean_albedo();
        let change = equations.solve(with_sheen, with_tilt.then_some((mean, texel.tilt)));
        let most = Vec3::splat(metals.most_diffuse(&blend.0));
        let along = (texel.along() + change.albedo + change.sheen).clamp(Vec3::ZERO, most);
        texel.albedo = (texel.albedo + change.albedo).clamp(Vec3::ZERO, most);
        if with_sheen {
            texel.sheen = along - texel.albedo;
        }
        // The difference between sides is what was solved for, not its part of the albedo,
        // which changes as well.
        let now = texel.mean_albedo();
        let part = mean.dot(now) / now.length_squared().max(LEAST_COLOR);
        texel.tilt = ((texel.tilt + change.tilt) * part).clamp_length_max(MOST_TILT);
    });
    world.get_resource::<KnownAlong>().into_iter().for_each(|known| known.set_sheen(&mut texels));
    // A texel that no pixel meets between texels that the fit has seen keeps what the fit has found
    // there.
    let mut seen = read_column::<TexelIndex, TexelSeen>(world)?;
    seen.iter_mut().zip(&equations).for_each(|(seen, equations)| seen.0 = seen.0.max(equations.seen));
    write_column::<TexelIndex, _>(world, &texels)?;
    write_column::<TexelIndex, _>(world, &seen)?;
    Ok(ControlFlow::Continue(()))
}

/// Sample: the pixels of this run become the samples.
pub fn show_pixels(
    shown: Res<DetailPixels>,
    views: Query<(&ViewIndex, &Camera, &Photograph)>,
    samples: Samples<(&mut PixelOf, &mut Observed, &mut ViewRay)>,
) -> SystemResult {
    let views: ByView<_> =
        views.iter().map(|(index, camera, photograph)| (*index, (camera, photograph))).collect();
    let (mut pixels, mut observed, mut rays) = samples.columns()?;
    let columns = pixels.iter_mut().zip(&mut *observed).zip(&mut *rays);
    for (((pixel, seen), ray), from) in columns.zip(&shown.present) {
        let (camera, photograph) = views.of(from.view)?;
        (*pixel, *seen) = (*from, observed_in(photograph, from.pixel));
        ray.0 = camera.pixel_ray(from.pixel);
    }
    Ok(())
}

/// Gather: shading is that of a white surface, because radiance per unit of albedo is wanted, also
/// of black texels.
pub fn whiten_points(samples: Samples<&mut ShadePoint>) -> SystemResult {
    samples.columns()?.iter_mut().for_each(|point| point.albedo = [1.0; 3]);
    Ok(())
}

/// Gradient: keeps the pixels that show the surface.
pub fn keep_pixels(
    exposures: Res<Exposures>,
    samples: Samples<(&SurfacePoint, &ViewRay, &Layers, &Observed, &PixelOf)>,
    mut detail: ResMut<DetailPixels>,
) -> SystemResult {
    let (points, rays, shaded, observed, pixels) = samples.columns()?;
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
    detail.kept.append(&mut parallel::flat_map(points.len(), 1024, shown));
    Ok(())
}

/// Residual relative to the radiance (and [`DARK`]) at which a pixel counts half.
const TOLERATED: f32 = 1.0;
/// Radiance below which residuals count as if it were this.
const DARK: f32 = 0.1;

/// A pixel that shows the surface, as if the surface were white.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ShadedPixel {
    /// The texels that it shows.
    pub texels: TexelAddress,
    /// Cosine between normal and view direction, above 0.
    pub facing: f32,
    /// The part of the view direction along the surface.
    pub side: Vec3,
    /// Diffuse radiance of a white surface, in units of the photograph.
    pub unit: Vec3,
    /// Specular radiance, likewise.
    pub specular: Vec3,
    /// Observation in the photograph.
    pub observed: Observed,
}

/// A `ShadedPixel` in 40 bytes: numbers have 11 bits, places in a texel 16.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct KeptPixel {
    /// The first texel of the upper and of the lower row.
    rows: [u32; 2],
    /// Place between the four texels, in 1/65535.
    place: [u16; 2],
    side: [f16; 3],
    unit: [f16; 3],
    specular: [f16; 3],
    observed: [f16; 3],
    facing: f16,
    /// 1 if it is, else 0.
    saturated: u16,
}

impl From<ShadedPixel> for KeptPixel {
    fn from(pixel: ShadedPixel) -> Self {
        let [_, right, below, both] = pixel.texels.weights;
        let fraction = |part: f32| (part.clamp(0.0, 1.0) * 65535.0).round() as u16;
        let halves = |v: Vec3| v.to_array().map(f16::from_f32);
        Self {
            rows: [pixel.texels.indices[0], pixel.texels.indices[2]],
            place: [fraction(right + both), fraction(below + both)],
            side: halves(pixel.side),
            unit: halves(pixel.unit),
            specular: halves(pixel.specular),
            observed: halves(pixel.observed.radiance),
            facing: f16::from_f32(pixel.facing),
            saturated: u16::from(pixel.observed.saturated),
        }
    }
}

impl From<KeptPixel> for ShadedPixel {
    fn from(kept: KeptPixel) -> Self {
        let [x, y] = kept.place.map(|place| f32::from(place) / 65535.0);
        let [above, below] = kept.rows;
        // At the last column there is no texel to the right, and its weight is 0.
        let right = u32::from(kept.place[0] > 0);
        let vector = |halves: [f16; 3]| Vec3::from(halves.map(f16::to_f32));
        Self {
            texels: TexelAddress {
                indices: [above, above + right, below, below + right],
                weights: [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y],
            },
            facing: kept.facing.to_f32(),
            side: vector(kept.side),
            unit: vector(kept.unit),
            specular: vector(kept.specular),
            observed: Observed { radiance: vector(kept.observed), saturated: kept.saturated != 0 },
        }
    }
}

/// Adds what the pixels say to the `equations` of their texels, as these are now. Beside a known
/// albedo along the surface (`is_known`) the unknown one has only its part.
fn add_pixels(pixels: &[KeptPixel], texels: &[Diffuse], is_known: bool, equations: &mut [TexelEquations]) {
    for pixel in pixels.iter().map(|kept| ShadedPixel::from(*kept)) {
        let albedo = Diffuse::mixed(&pixel.texels, |texel| texels[texel]);
        let predicted = albedo.seen_at(pixel.facing, pixel.side) * pixel.unit + pixel.specular;
        let residual = -pixel.observed.differences(predicted);
        if !(pixel.unit.is_finite() && residual.is_finite()) {
            continue;
        }
        // A pixel seen at an angle shows more than its texels.
        let weight = pixel.facing * pixel.facing * agreement(residual, predicted);
        let along = grazing(pixel.facing);
        let (unit, along) = if is_known { (pixel.unit * (1.0 - along), 0.0) } else { (pixel.unit, along) };
        for (texel, share) in pixel.texels.indices.into_iter().zip(pixel.texels.weights) {
            equations[texel as usize].add(unit, along, pixel.side, residual, share * weight);
        }
    }
}

/// How much a pixel counts whose residual may be that of something the model does not have (Geman
/// and McClure's weight), in [0, 1].
fn agreement(residual: Vec3, predicted: Vec3) -> f32 {
    let relative = residual.length() / (predicted.length() + DARK);
    (1.0 + (relative / TOLERATED).powi(2)).recip()
}

/// Weight against a change of the albedo, in pixels that show the texel straight on and say that
/// nothing changes.
const STILL_ALBEDO: f32 = 0.1;
/// Weight against a change of the sheen, likewise.
const STILL_SHEEN: f32 = 0.5;
/// Weight against a change of the sheen, as a part of all evidence: an albedo along the surface
/// that is hardly seen stays.
const STILL_PART: f32 = 0.01;

/// Least part of the mean of the channels that a channel of the light counts with.
const LEAST_CHANNEL: f32 = 0.05;
/// Sum of the squared channels of an albedo below which it has no tilt.
const LEAST_COLOR: f32 = 1e-4;
/// Weight against a tilt, likewise.
const STILL_TILT: f32 = 0.3;

/// Changes at a texel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct TexelChange {
    albedo: Vec3,
    sheen: Vec3,
    tilt: Vec3,
}

/// Sums over the pixels that show a texel, with weights w u², where u is the mean of the channels;
/// the unknowns of a channel are those of the functions 1, g and v⊥ of the view direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TexelEquations {
    /// 1, g, g².
    one_along: [f32; 3],
    /// v⊥, g v⊥.
    side: [Vec3; 2],
    /// v⊥ v⊥ᵀ: xx, yy, zz and xy, xz, yz.
    side_side: [Vec3; 2],
    /// r / u, g r / u by channel.
    changes: [Vec3; 2],
    /// v⊥ r / u for each channel.
    side_changes: [Vec3; 3],
    /// w.
    seen: f32,
}

impl TexelEquations {
    /// Adds a pixel of this weight: diffuse radiance `unit` of a white surface, g = `along`, v⊥ =
    /// `side`, and observed minus predicted radiance.
    #[inline]
    fn add(&mut self, unit: Vec3, along: f32, side: Vec3, residual: Vec3, weight: f32) {
        let gray = unit.element_sum() / 3.0;
        // A light that lacks a channel says nothing about it.
        let change = residual / unit.max(Vec3::splat(LEAST_CHANNEL * gray));
        if !change.is_finite() {
            return;
        }
        let w = weight * gray * gray;
        self.seen += weight;
        self.one_along =
            [self.one_along[0] + w, self.one_along[1] + w * along, self.one_along[2] + w * along * along];
        let (sided, swapped) = (side * w, Vec3::new(side.x, side.x, side.y));
        self.side[0] += sided;
        self.side[1] += sided * along;
        self.side_side[0] += sided * side;
        self.side_side[1] += swapped * Vec3::new(sided.y, sided.z, sided.z);
        self.changes[0] += change * w;
        self.changes[1] += change * (w * along);
        (0..3).for_each(|c| self.side_changes[c] += sided * change[c]);
    }

    /// The changes that explain most of the residuals. Without `sheen` it stays; so does the tilt
    /// without the mean albedo and the tilt `before`.
    fn solve(&self, sheen: bool, before: Option<(Vec3, Vec3)>) -> TexelChange {
        let one = self.one_along[0] / self.seen;
        if one.is_nan() || one <= 0.0 {
            return TexelChange::default();
        }
        let colors = self.inverse_of_colors(one, sheen);
        let (color, tilt) = before.map_or_else(Default::default, |(color, tilt)| {
            (color, self.solve_tilt(colors, STILL_TILT * one, color, tilt))
        });
        let solved = |c: usize| colors * (self.change(c) - self.toward(tilt) * color[c]);
        let solved: [Vec2; 3] = std::array::from_fn(solved);
        let [albedo, sheen] = [0, 1].map(|unknown| Vec3::from_array(solved.map(|change| change[unknown])));
        TexelChange { albedo, sheen, tilt }
    }

    /// The change of the tilt, where albedo and sheen of each channel follow it (their Schur
    /// complement).
    fn solve_tilt(&self, colors: Mat2, still: f32, color: Vec3, tilt: Vec3) -> Vec3 {
        let power = color.length_squared();
        if power < LEAST_COLOR {
            return Vec3::ZERO;
        }
        let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| self.back(colors * self.toward(axis)));
        // The matrix of v⊥ v⊥ᵀ.
        let [[xx, yy, zz], [xy, xz, yz]] = self.side_side.map(|part| part.to_array());
        let sides = Mat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]);
        let matrix = sides - Mat3::from_cols(x, y, z) + Mat3::from_diagonal(Vec3::splat(still));
        let left = |c: usize| self.side_changes[c] - self.back(colors * self.change(c));
        let explained: Vec3 = (0..3).map(|c| left(c) * color[c]).sum();
        let change = matrix.inverse() * (explained / power - tilt * still);
        // Albedo and sheen then explain what a tilt within its bound does not.
        if change.is_finite() { (tilt + change).clamp_length_max(MOST_TILT) - tilt } else { Vec3::ZERO }
    }

    /// Returns the terms of a tilt in the equations of albedo and sheen.
    fn toward(&self, tilt: Vec3) -> Vec2 {
        Vec2::new(self.side[0].dot(tilt), self.side[1].dot(tilt))
    }

    /// Returns the terms of albedo and sheen in the equations of the tilt.
    fn back(&self, colors: Vec2) -> Vec3 {
        self.side[0] * colors.x + self.side[1] * colors.y
    }

    /// The right side of the equations of albedo and sheen of channel `c`.
    fn change(&self, c: usize) -> Vec2 {
        Vec2::new(self.changes[0][c], self.changes[1][c])
    }

    /// The inverse of the part of the matrix that albedo and sheen have.
    fn inverse_of_colors(&self, one: f32, sheen: bool) -> Mat2 {
        let [a, b, d] = self.one_along;
        let (a, d) = (a + STILL_ALBEDO * one, d + STILL_SHEEN * one + STILL_PART * a);
        if !sheen {
            return Mat2::from_diagonal(Vec2::new(1.0 / a, 0.0));
        }
        let determinant = (a * d - b * b).max(1e-6 * a * d);
        Mat2::from_cols_array(&[d, -b, -b, a]) * (1.0 / determinant)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_geometry::mesh::atlas::address;

    fn shaded(uv: Vec2) -> ShadedPixel {
        ShadedPixel {
            texels: address(uv, 8, 8),
            facing: 0.8,
            side: Vec3::new(0.6, 0.0, 0.0),
            unit: Vec3::new(2.0, 1.5, 1.0),
            specular: Vec3::new(0.25, 0.125, 0.5),
            observed: Observed { radiance: Vec3::new(1.0, 0.5, 0.25), saturated: true },
        }
    }

    #[test]
    fn a_kept_pixel_is_the_pixel_at_any_place() {
        for uv in [Vec2::new(0.4, 0.7), Vec2::ZERO, Vec2::ONE, Vec2::new(1.0, 0.3), Vec2::new(0.1, 1.0)] {
            let pixel = shaded(uv);
            let again = ShadedPixel::from(KeptPixel::from(pixel));
            let share = |of: &ShadedPixel, texel: u32| -> f32 {
                let parts = of.texels.indices.into_iter().zip(of.texels.weights);
                parts.filter(|(index, _)| *index == texel).map(|(_, weight)| weight).sum()
            };
            for texel in 0..64 {
                assert!((share(&pixel, texel) - share(&again, texel)).abs() < 1e-4, "{uv} {texel}");
            }
            assert!((pixel.facing - again.facing).abs() < 1e-3 && pixel.side.abs_diff_eq(again.side, 1e-3));
            let parts = |of: &ShadedPixel| (of.unit, of.specular, of.observed);
            assert_eq!(parts(&pixel), parts(&again));
        }
    }

    const COLOR: Vec3 = Vec3::new(0.5, 0.3, 0.2);

    /// Pixel `i` of a texel whose normal is +Z: g and v⊥ of a view up to `most` from straight on,
    /// as a part of the hemisphere.
    fn view(i: u32, most: f32) -> (f32, Vec3) {
        let along = most * (i * 29 % 100) as f32 / 100.0;
        let sine = (1.0 - (1.0 - along) * (1.0 - along)).sqrt();
        let angle = i as f32 * 2.399_963;
        (along, Vec3::new(angle.cos(), angle.sin(), 0.0) * sine)
    }

    /// Many pixels of a texel that changes by this.
    fn equations(change: TexelChange, most_along: f32) -> TexelEquations {
        let mut sums = TexelEquations::default();
        for i in 0..4000 {
            let (along, side) = view(i, most_along);
            let unit = Vec3::new(0.5, 0.7, 1.1) * (0.6 + 0.01 * (i % 37) as f32);
            let residual = change.albedo + change.sheen * along + COLOR * change.tilt.dot(side);
            sums.add(unit, along, side, residual * unit, 1.0);
        }
        sums
    }

    fn albedo(albedo: Vec3) -> TexelChange {
        TexelChange { albedo, ..TexelChange::default() }
    }

    #[test]
    fn residuals_that_the_model_can_explain_are_explained() {
        let truth = TexelChange {
            albedo: Vec3::new(0.2, -0.1, 0.3),
            sheen: Vec3::new(-0.3, 0.2, 0.1),
            tilt: Vec3::new(0.4, -0.2, 0.0),
        };
        let found = equations(truth, 1.0).solve(true, Some((COLOR, Vec3::ZERO)));
        assert!((found.albedo - truth.albedo).abs().max_element() < 0.02, "{found:?}");
        assert!((found.sheen - truth.sheen).abs().max_element() < 0.05, "{found:?}");
        assert!((found.tilt - truth.tilt).abs().max_element() < 0.01, "{found:?}");
        let found = equations(albedo(truth.albedo), 1.0).solve(false, None);
        assert!((found.albedo - truth.albedo).abs().max_element() < 1e-3, "{found:?}");
        assert_eq!((found.sheen, found.tilt), (Vec3::ZERO, Vec3::ZERO));
    }

    #[test]
    fn what_is_hardly_seen_does_not_change() {
        let found = equations(albedo(Vec3::splat(0.2)), 0.02).solve(true, Some((COLOR, Vec3::ZERO)));
        assert!(found.sheen.abs().max_element() < 0.02, "{found:?}");
        // From one side only, a brighter albedo explains what a tilt does.
        let mut sums = TexelEquations::default();
        for _ in 0..3 {
            sums.add(Vec3::ONE, 0.1, Vec3::X * 0.4, COLOR * 0.2, 1.0);
        }
        let found = sums.solve(false, Some((COLOR, Vec3::ZERO)));
        assert!(found.albedo.length() > 0.5 * (COLOR * 0.2).length(), "{found:?}");
        assert!(found.tilt.length() < 0.25, "{found:?}");
    }

    #[test]
    fn a_tilt_that_nothing_supports_goes() {
        let found = equations(TexelChange::default(), 1.0).solve(true, Some((COLOR, Vec3::Z * 0.5)));
        assert!((found.tilt.z + 0.5).abs() < 1e-3, "a tilt along the normal is not seen: {found:?}");
    }

    #[test]
    fn a_texel_that_is_not_seen_not_lit_or_black_has_no_tilt() {
        let before = Some((COLOR, Vec3::ZERO));
        assert_eq!(TexelEquations::default().solve(true, before), TexelChange::default());
        let mut dark = TexelEquations::default();
        dark.add(Vec3::ZERO, 0.5, Vec3::X, Vec3::ONE, 1.0);
        assert_eq!(dark.solve(true, before), TexelChange::default());
        let black = equations(albedo(Vec3::splat(0.1)), 1.0).solve(true, Some((Vec3::ZERO, Vec3::ZERO)));
        assert_eq!(black.tilt, Vec3::ZERO);
    }

    #[test]
    fn the_change_is_the_least_squares_solution() {
        // The gradient of the sum of squares vanishes there, but for what counts against a change.
        let rows = [(0.5, 0.03, 1.0), (0.8, -0.02, 2.0), (0.3, 0.01, 0.5), (0.6, 0.04, 1.5)];
        let mut sums = TexelEquations::default();
        for (i, &(u, r, w)) in (0..).zip(&rows) {
            let (along, side) = view(40 + 7 * i, 1.0);
            sums.add(Vec3::splat(u), along, side, Vec3::splat(r), w);
        }
        let one = rows.iter().map(|(u, _, w)| w * u * u).sum::<f32>() / sums.seen;
        let color = Vec3::splat(0.4);
        let found = sums.solve(true, Some((color, Vec3::ZERO)));
        let by = |weight: &dyn Fn(f32, Vec3) -> f32| -> f32 {
            let row = |(i, &(u, r, w)): (u32, &(f32, f32, f32))| {
                let (g, v) = view(40 + 7 * i, 1.0);
                let change = found.albedo.x + found.sheen.x * g + color.x * found.tilt.dot(v);
                w * u * weight(g, v) * (r - change * u)
            };
            (0..).zip(&rows).map(row).sum()
        };
        assert!((by(&|_, _| 1.0) - STILL_ALBEDO * one * found.albedo.x).abs() < 1e-4);
        let all = one * sums.seen;
        assert!((by(&|g, _| g) - (STILL_SHEEN * one + STILL_PART * all) * found.sheen.x).abs() < 1e-4);
        assert!(
            (by(&|_, v| color.x * v.x) - color.x * color.x * STILL_TILT * one * found.tilt.x).abs() < 1e-4
        );
    }
}
