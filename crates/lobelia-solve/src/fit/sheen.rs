//! Sheen as an unknown: each texel's albedo along the surface, beside that straight on.
//!
//! The albedo toward a viewer blends both by c = n·v ([`lobelia_world::material::diffuse`]), so
//! that the adjoint of a sample's albedo is shared between them by c and 1 − c. A texel that is
//! seen from few angles keeps its sheen near zero.
//!
//! Whether the surface has a sheen is decided by the photographs: a richer material is let in only
//! if it predicts views that it was not fitted to. A fit without sheen leaves residuals r at
//! observed pixels. In each cell of a lattice over the surface they are explained by a changed
//! albedo, r = a u, or also by a sheen, r = (a + s (1 − c)) u, where u is the diffuse radiance per
//! unit of albedo. Both are solved from half of the views and judged on the other half. All of that
//! needs only sums, which the steps of a part of the fit collect.

use crate::fit::components::{AdamStep, AlbedoGradient, AlbedoMoments, Moments, StepRates, Unknowns};
use crate::fit::{exposure::Exposures, loss::radiance, systems::moved_color};
use bevy_ecs::prelude::{Component, Res, ResMut, Resource, With, World};
use glam::Vec3;
use lobelia_geometry::parallel;
use lobelia_geometry::view::{Camera, Photograph, Split, ViewIndex};
use lobelia_sg::shading::{Layers, PointAdjoint, ShadePoint};
use lobelia_world::material::diffuse::{KnownAlong, grazing, has_sheen};
use lobelia_world::material::{Diffuse, TexelIndex, Texels};
use lobelia_world::pipeline::{SystemResult, pool::with_columns};
use lobelia_world::sample::pixel::{Observed, PixelOf};
use lobelia_world::sample::{Samples, point::SurfacePoint};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Gradient of the loss with respect to a texel's albedo along the surface, and the weight of the
/// samples that it sums over.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct SheenGradient(pub Vec3, pub f32);

/// Adam's moments of a texel's albedo along the surface.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SheenMoments(pub Moments<3>);

/// Weight of the mean square of the sheen, relative to the image loss.
const PRIOR: f32 = 0.02;

/// Gradient: shares the albedo adjoints of the samples, which `scatter_to_texels` has added to the
/// albedo straight on, with the albedo along the surface, if that is unknown, and takes its share
/// from them, if it is known.
pub fn scatter_to_sheen(
    (unknowns, known): (Res<Unknowns>, Option<Res<KnownAlong>>),
    samples: Samples<(&SurfacePoint, &ShadePoint, &PointAdjoint)>,
    (albedo, sheen): (Texels<&mut AlbedoGradient>, Texels<&mut SheenGradient>),
) -> SystemResult {
    if !unknowns.sheen && (known.is_none() || !unknowns.albedo) {
        return Ok(());
    }
    let (points, gathered, back) = samples.columns()?;
    let mut albedo = albedo.columns()?.quiet();
    let mut sheen = if unknowns.sheen { Some(sheen.columns()?.quiet()) } else { None };
    let (albedo, mut sheen) = (&mut *albedo, sheen.as_deref_mut());
    let rows = points.iter().zip(&*gathered).zip(&*back);
    for ((point, gathered), back) in rows.filter(|((point, _), _)| point.is_hit()) {
        let along = grazing(Vec3::from(gathered.normal).dot(Vec3::from(gathered.to_viewer)));
        for (texel, weight) in point.texels.indices.into_iter().zip(point.texels.weights) {
            let part = Vec3::from(back.albedo) * (weight * along);
            albedo[texel as usize].0 -= part;
            if let Some(SheenGradient(sum, weights)) = sheen.as_mut().map(|sheen| &mut sheen[texel as usize])
            {
                *sum += part;
                *weights += weight / points.len() as f32;
            }
        }
    }
    Ok(())
}

/// Update: the sheen beside a known albedo along the surface, once the albedo straight on has
/// moved.
pub fn follow_known(
    unknowns: Res<Unknowns>,
    known: Option<Res<KnownAlong>>,
    texels: Texels<&mut Diffuse>,
) -> SystemResult {
    let Some(known) = known.filter(|_| unknowns.albedo) else { return Ok(()) };
    known.set_sheen(&mut texels.columns()?);
    Ok(())
}

/// Update: Adam on the logits of each texel's albedo straight on and along the surface, instead of
/// [`move_texels`](crate::fit::systems::move_texels), if the sheen is unknown; clears the
/// gradients.
pub fn move_sheen(rates: Res<StepRates>, unknowns: Res<Unknowns>, texels: Texels<Columns>) -> SystemResult {
    if !unknowns.sheen {
        return Ok(());
    }
    let (mut texels, (albedo_gradient, gradient), (albedo_moments, moments)) = texels.columns()?;
    let (mut albedo_gradient, mut gradient) = (albedo_gradient.quiet(), gradient.quiet());
    let (mut albedo_moments, mut moments) = (albedo_moments.quiet(), moments.quiet());
    let adam = AdamStep::new(rates.albedo, rates.step);
    let gradients = (&mut *albedo_gradient, &mut *gradient);
    let columns = ((&mut *texels, gradients), (&mut *albedo_moments, &mut *moments));
    parallel::for_each_row(columns, 4096, |((texel, gradients), (albedo_moments, moments))| {
        let (albedo_gradient, gradient) = gradients;
        let pulled = gradient.0 + texel.sheen * (2.0 / 3.0 * PRIOR * gradient.1);
        let along = moved_color(&adam, texel.along(), pulled, &mut moments.0);
        texel.albedo = moved_color(&adam, texel.albedo, albedo_gradient.0, &mut albedo_moments.0);
        texel.sheen = along - texel.albedo;
        (albedo_gradient.0, *gradient) = (Vec3::ZERO, SheenGradient::default());
    });
    Ok(())
}

type Columns = (
    &'static mut Diffuse,
    (&'static mut AlbedoGradient, &'static mut SheenGradient),
    (&'static mut AlbedoMoments, &'static mut SheenMoments),
);

/// Parts of a fit between which residuals are collected; at the end of them the choice is made.
const COLLECTED: (f32, f32) = (0.15, 0.3);
/// Part of the squared residuals of views kept aside that a sheen must explain.
const CONVINCING: f64 = 0.1;
/// Sums of squared residuals below this are none.
const NO_RESIDUALS: f64 = 1e-12;
/// Cells along the longest side of the object.
const CELLS: f32 = 32.0;
/// Residuals count relative to the observed radiance plus this, which is close to how they are
/// seen.
const DARK: f32 = 0.1;

/// Sums over the pixels of a cell, a half of the views and a channel, with weights w.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Sums {
    /// w u², w u² g, w u² g² with g = 1 − c.
    uu: [f64; 3],
    /// w u r, w u g r.
    ur: [f64; 2],
    /// w r².
    rr: f64,
}

impl Sums {
    fn add(&mut self, u: f64, g: f64, r: f64, weight: f64) {
        let uu = weight * u * u;
        self.uu = [self.uu[0] + uu, self.uu[1] + uu * g, self.uu[2] + uu * g * g];
        self.ur = [self.ur[0] + weight * u * r, self.ur[1] + weight * u * g * r];
        self.rr += weight * r * r;
    }

    /// The change of albedo that explains most, without a sheen.
    fn albedo(&self) -> [f64; 2] {
        [self.ur[0] / (self.uu[0] + self.ridge()), 0.0]
    }

    /// The change of albedo and the sheen that together explain most.
    fn albedo_and_sheen(&self) -> [f64; 2] {
        let ridge = self.ridge();
        let [a, b, c] = [self.uu[0] + ridge, self.uu[1], self.uu[2] + ridge];
        let [x, y] = self.ur;
        let determinant = (a * c - b * b).max(1e-30);
        [(c * x - b * y) / determinant, (a * y - b * x) / determinant]
    }

    /// Keeps cells that are seen from few angles, or hardly at all, from explaining noise.
    fn ridge(&self) -> f64 {
        1e-2 * self.uu[0] + 1e-9
    }

    /// The squared residual that is left.
    fn left(&self, [a, s]: [f64; 2]) -> f64 {
        let explained = 2.0 * (a * self.ur[0] + s * self.ur[1]);
        self.rr - explained + a * a * self.uu[0] + 2.0 * a * s * self.uu[1] + s * s * self.uu[2]
    }
}

/// Evidence collected for the choice, and the choice.
#[derive(Resource, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SheenEvidence {
    /// By cell, then by half of the views and channel.
    cells: BTreeMap<[i32; 3], [[Sums; 3]; 2]>,
    /// The half of each view, by [`ViewIndex`].
    halves: Vec<u8>,
    /// Side of a cell, in world units; 0 before the first window.
    side: f32,
    /// Part of the squared residuals of views kept aside that a sheen explains, once it has been
    /// decided.
    pub explained: Option<f64>,
}

impl SheenEvidence {
    /// The part of the squared residuals of views kept aside that a sheen explains: below 0 if it
    /// makes them worse, 0 if there are none.
    fn explained_part(&self) -> f64 {
        let (mut without, mut with) = (0.0, 0.0);
        for halves in self.cells.values() {
            for (c, half) in (0..3).flat_map(|c| [(c, 0), (c, 1)]) {
                let (fitted, judged) = (&halves[half][c], &halves[1 - half][c]);
                without += judged.left(fitted.albedo());
                with += judged.left(fitted.albedo_and_sheen());
            }
        }
        if without < NO_RESIDUALS { 0.0 } else { 1.0 - with / without }
    }
}

/// Loss: collects the residuals of a window, while they are wanted.
pub fn note_residuals(
    rates: Res<StepRates>,
    exposures: Res<Exposures>,
    evidence: Option<ResMut<SheenEvidence>>,
    samples: Samples<(&SurfacePoint, &ShadePoint, &PixelOf, (&Layers, &Observed))>,
) -> SystemResult {
    let Some(mut evidence) = evidence else { return Ok(()) };
    if evidence.explained.is_some() || rates.progress < COLLECTED.0 {
        return Ok(());
    }
    let (points, gathered, pixels, (shaded, observed)) = samples.columns()?;
    if evidence.side == 0.0 {
        let hits = || points.iter().filter(|point| point.is_hit()).map(|point| point.position);
        let extent = hits().reduce(Vec3::max).zip(hits().reduce(Vec3::min));
        evidence.side = extent.map_or(0.0, |(high, low)| (high - low).max_element()).max(1e-6) / CELLS;
    }
    let side = evidence.side;
    let rows = points.iter().zip(&*gathered).zip(&*pixels).zip(shaded.iter().zip(&*observed));
    for (((point, gathered), pixel), (shaded, observed)) in rows.filter(|(((p, _), _), _)| p.is_hit()) {
        let cell = (point.position / side).floor().as_ivec3().to_array();
        let half = evidence.halves.get(pixel.view.0 as usize).map_or(0, |half| usize::from(*half));
        let half = &mut evidence.cells.entry(cell).or_default()[half];
        let along = grazing(Vec3::from(gathered.normal).dot(Vec3::from(gathered.to_viewer)));
        let exposure = exposures.factor(pixel.view);
        let difference = observed.differences(exposure * radiance(shaded));
        for (c, sums) in half.iter_mut().enumerate() {
            let unit = exposure[c] * shaded.diffuse[c] / gathered.albedo[c].max(1e-3);
            let residual = -difference[c];
            let weight = (observed.radiance[c].max(0.0) + DARK).powi(-2);
            sums.add(f64::from(unit), f64::from(along), f64::from(residual), f64::from(weight));
        }
    }
    Ok(())
}

/// Makes the choice once enough of the fit is done (`progress` in [0, 1]), and keeps to it.
pub(crate) fn choose_sheen(world: &mut World, progress: f32) {
    let Some(mut evidence) = world.get_resource_mut::<SheenEvidence>() else { return };
    if progress >= COLLECTED.1 && evidence.explained.is_none() {
        evidence.explained = Some(evidence.explained_part());
        evidence.cells.clear();
    }
    let convincing = evidence.explained.is_some_and(|explained| explained > CONVINCING);
    let mut unknowns = world.resource_mut::<Unknowns>();
    unknowns.sheen |= convincing && unknowns.albedo;
}

/// Begins to look for evidence, unless a fit before this one has found a sheen: then this one goes
/// on with it.
pub(crate) fn look_for_sheen(world: &mut World) -> lobelia_geometry::error::Result<()> {
    if with_columns::<TexelIndex, &Diffuse, _>(world, |texels| Ok(has_sheen(&texels)))? {
        world.resource_mut::<Unknowns>().sheen = true;
    } else {
        let mut query = world.query_filtered::<(&ViewIndex, &Camera, &Split), With<Photograph>>();
        let train = query.iter(world).filter(|(.., split)| **split == Split::Train);
        let (indices, positions): (Vec<usize>, Vec<Vec3>) =
            train.map(|(index, camera, _)| (index.0 as usize, camera.position())).unzip();
        let mut halves = vec![0; indices.iter().map(|index| index + 1).max().unwrap_or(0)];
        indices.iter().zip(halves_of(&positions)).for_each(|(index, half)| halves[*index] = half);
        world.insert_resource(SheenEvidence { halves, ..SheenEvidence::default() });
    }
    Ok(())
}

/// Two halves of cameras that see alike: of two neighbors each gets one. Where the cameras stand
/// decides alone, not their order: a capture may alternate between two rings, or end with one.
fn halves_of(positions: &[Vec3]) -> Vec<u8> {
    let by_place = |a: &usize, b: &usize| {
        let [a, b] = [positions[*a], positions[*b]];
        a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z))
    };
    let mut left: Vec<usize> = (0..positions.len()).collect();
    left.sort_by(by_place);
    let mut halves = vec![0; positions.len()];
    while let [first, others @ ..] = left.as_slice() {
        let (first, from) = (*first, positions[*first]);
        let near = |at: &usize| positions[*at].distance_squared(from);
        let nearest = (0..others.len()).min_by(|a, b| near(&others[*a]).total_cmp(&near(&others[*b])));
        // A coin for each pair, by the bits of its place: else one half might have all cameras of
        // one side.
        let mix = |sum: u64, x: f32| (sum ^ u64::from(x.to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let coin = (from.to_array().into_iter().fold(0, mix) >> 63) as u8;
        halves[first] = coin;
        if let Some(nearest) = nearest {
            halves[others[nearest]] = 1 - coin;
            left.remove(nearest + 1);
        }
        left.remove(0);
    }
    halves
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals of a cell whose albedo is off by `albedo` and that has a sheen, with noise.
    fn evidence(albedo: f64, sheen: f64, noise: f64) -> SheenEvidence {
        let mut evidence = SheenEvidence::default();
        for i in 0..400 {
            let (u, g) = (0.5 + 0.001 * f64::from(i % 37), f64::from(i * 29 % 100) / 100.0);
            let random = f64::from(i * 7919 % 1000) / 500.0 - 1.0;
            let r = (albedo + sheen * g) * u + noise * random;
            let halves = evidence.cells.entry([0, i % 4, 0]).or_default();
            halves[i as usize / 4 % 2].iter_mut().for_each(|sums| sums.add(u, g, r, 1.0));
        }
        evidence
    }

    #[test]
    fn a_sheen_is_seen_in_views_kept_aside_and_neither_a_wrong_albedo_nor_noise_is_taken_for_one() {
        assert!(evidence(0.1, 0.3, 0.02).explained_part() > 0.7);
        assert!(evidence(0.1, 0.3, 0.2).explained_part() > CONVINCING);
        assert!(evidence(0.3, 0.0, 0.02).explained_part() < CONVINCING);
        assert!(evidence(0.0, 0.0, 0.2).explained_part() < CONVINCING);
        assert_eq!(evidence(0.0, 0.0, 0.0).explained_part(), 0.0);
        assert_eq!(SheenEvidence::default().explained_part(), 0.0);
    }

    #[test]
    fn what_is_left_is_the_sum_of_squares() {
        let rows = [(0.5, 0.1, 0.3, 1.0), (0.8, 0.7, -0.2, 2.0), (0.3, 0.4, 0.1, 0.5)];
        let mut sums = Sums::default();
        rows.iter().for_each(|(u, g, r, w)| sums.add(*u, *g, *r, *w));
        let (a, s) = (0.2, -0.4);
        let exact: f64 = rows.iter().map(|(u, g, r, w)| w * (r - (a + s * g) * u).powi(2)).sum();
        assert!((sums.left([a, s]) - exact).abs() < 1e-12);
    }

    #[test]
    fn views_are_halved_by_where_they_stand_and_not_by_their_order() {
        let ring = |height: f32, turn: f32| {
            (0..12).map(move |i| {
                let (sin, cos) = (std::f32::consts::FRAC_PI_6 * (i as f32 + turn)).sin_cos();
                Vec3::new(3.0 * cos, height, 3.0 * sin)
            })
        };
        for turn in [0.0, 0.5] {
            let (low, high): (Vec<Vec3>, Vec<Vec3>) = (ring(0.3, 0.0).collect(), ring(2.0, turn).collect());
            let one_by_one: Vec<Vec3> = low.iter().zip(&high).flat_map(|(a, b)| [*a, *b]).collect();
            let after: Vec<Vec3> = [low.clone(), high].concat();
            let of = |positions: &[Vec3], at: Vec3| {
                halves_of(positions)[positions.iter().position(|found| *found == at).unwrap()]
            };
            for at in &after {
                assert_eq!(of(&one_by_one, *at), of(&after, *at), "{at}");
            }
            for ring in after.chunks(12) {
                let second = ring.iter().filter(|at| of(&after, **at) == 1).count();
                assert!((3..=9).contains(&second), "{second} of 12 are in the second half");
            }
            let all: usize = halves_of(&after).iter().map(|half| usize::from(*half)).sum();
            assert_eq!(all, 12);
        }
        assert_eq!(halves_of(&[Vec3::X; 3]).len(), 3);
        assert!(halves_of(&[]).is_empty());
    }
}
