//! Sheen as an unknown: each texel's albedo along the surface, beside that straight on.
//!
//! The albedo toward a viewer blends both by c = n·v ([`crate::material::sheen`]), so that the adjoint of a sample's albedo is
//! shared between them by c and 1 − c. A texel that is seen from few angles keeps its sheen near zero.
//!
//! | system | stage, slot | reads | writes |
//! | --- | --- | --- | --- |
//! | [`scatter_to_sheen`] | Gradient, `ScatterAdjoints` | samples | [`SheenGradient`], `AlbedoGradient` |
//! | [`share_with_known`] | Gradient, `ScatterAdjoints` | samples, [`KnownAlong`] | `AlbedoGradient` |
//! | [`move_sheen`] | Update, `Slot::Optimizer`, instead of `move_texels` | [`SheenGradient`], `AlbedoGradient` | `DiffuseSheen`, `DiffuseAlbedo` |
//! | [`follow_known`] | Update, after `Slot::Optimizer` | [`KnownAlong`], `DiffuseAlbedo` | `DiffuseSheen` |

pub mod evidence;

use crate::fit::adam::{AdamStep, Bounded, Moments};
use crate::fit::components::{AlbedoGradient, AlbedoMoments, StepRates, Unknowns};
use crate::fit::systems::move_texel;
use crate::material::DiffuseSheen;
use crate::material::sheen::{KnownAlong, grazing};
use crate::material::{DiffuseAlbedo, Texels};
use crate::math::shading::{PointAdjoint, ShadePoint};
use crate::pipeline::SystemResult;
use crate::sample::Samples;
use crate::sample::point::SurfacePoint;
use bevy_ecs::prelude::{Component, Res};
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Gradient of the loss with respect to a texel's albedo along the surface, and the weight of the samples that it sums over.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct SheenGradient(pub Vec3, pub f32);

/// Adam's moments of a texel's albedo along the surface.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SheenMoments(pub Moments<3>);

/// Weight of the mean square of the sheen, relative to the image loss.
const PRIOR: f32 = 0.02;

/// Gradient: shares the albedo adjoints of the samples, which `scatter_to_texels` has added to the albedo straight on, with the albedo
/// along the surface.
pub fn scatter_to_sheen(
    unknowns: Res<Unknowns>,
    samples: Samples<(&SurfacePoint, &ShadePoint, &PointAdjoint)>,
    texels: Texels<(&mut AlbedoGradient, &mut SheenGradient)>,
) -> SystemResult {
    if !unknowns.sheen {
        return Ok(());
    }
    let (points, gathered, back) = samples.columns()?;
    let (albedo, sheen) = texels.columns()?;
    let (mut albedo, mut sheen) = (albedo.quiet(), sheen.quiet());
    let (albedo, sheen) = (&mut *albedo, &mut *sheen);
    shares(&points, &gathered, &back, |texel, weight, part| {
        albedo[texel].0 -= part;
        sheen[texel].0 += part;
        sheen[texel].1 += weight / points.len() as f32;
    });
    Ok(())
}

/// Gradient: takes from the albedo adjoints, which `scatter_to_texels` has added to the albedo straight on, the share of a known albedo
/// along the surface.
pub fn share_with_known(
    unknowns: Res<Unknowns>,
    known: Option<Res<KnownAlong>>,
    samples: Samples<(&SurfacePoint, &ShadePoint, &PointAdjoint)>,
    texels: Texels<&mut AlbedoGradient>,
) -> SystemResult {
    if known.is_none() || !unknowns.albedo {
        return Ok(());
    }
    let (points, gathered, back) = samples.columns()?;
    let mut albedo = texels.columns()?.quiet();
    let albedo = &mut *albedo;
    shares(&points, &gathered, &back, |texel, _, part| albedo[texel].0 -= part);
    Ok(())
}

/// Calls `take` with each texel of each sample that meets the surface, its weight, and the part of its adjoint that is that of the albedo
/// along the surface.
fn shares(
    points: &[SurfacePoint],
    gathered: &[ShadePoint],
    back: &[PointAdjoint],
    mut take: impl FnMut(usize, f32, Vec3),
) {
    for ((point, gathered), back) in points.iter().zip(gathered).zip(back).filter(|((p, _), _)| p.is_hit()) {
        let along = grazing(Vec3::from(gathered.normal).dot(Vec3::from(gathered.to_viewer)));
        for (texel, weight) in point.texels.indices.into_iter().zip(point.texels.weights) {
            take(texel as usize, weight, Vec3::from(back.albedo) * (weight * along));
        }
    }
}

/// Update: the sheen beside a known albedo along the surface, once the albedo straight on has moved.
pub fn follow_known(
    unknowns: Res<Unknowns>,
    known: Option<Res<KnownAlong>>,
    texels: Texels<(&DiffuseAlbedo, &mut DiffuseSheen)>,
) -> SystemResult {
    let Some(known) = known.filter(|_| unknowns.albedo) else { return Ok(()) };
    let (albedo, mut sheen) = texels.columns()?;
    let albedo: Vec<Vec3> = albedo.iter().map(|albedo| albedo.0).collect();
    if let Some(found) = known.sheen(&albedo) {
        sheen.copy_from_slice(&found);
    }
    Ok(())
}

/// Update: Adam on the logits of each texel's albedo straight on and along the surface, instead of
/// [`move_texels`](crate::fit::systems::move_texels), if the sheen is unknown; clears the gradients.
pub fn move_sheen(
    rates: Res<StepRates>,
    unknowns: Res<Unknowns>,
    texels: Texels<SheenColumns>,
) -> SystemResult {
    if !unknowns.sheen {
        return Ok(());
    }
    let ((mut albedo, mut sheen), (albedo_gradient, gradient), (albedo_moments, moments)) =
        texels.columns()?;
    let (mut albedo_gradient, mut gradient) = (albedo_gradient.quiet(), gradient.quiet());
    let (mut albedo_moments, mut moments) = (albedo_moments.quiet(), moments.quiet());
    let adam = AdamStep::new(rates.albedo, rates.step);
    let colors = albedo.par_iter_mut().zip(&mut *sheen);
    let gradients = albedo_gradient.par_iter_mut().zip(&mut *gradient);
    let moments = albedo_moments.par_iter_mut().zip(&mut *moments);
    colors.zip(gradients).zip(moments).with_min_len(4096).for_each(|((colors, gradients), moments)| {
        let (albedo, sheen) = colors;
        let along = moved_along(&adam, albedo.0 + sheen.0, sheen.0, gradients.1, moments.1);
        move_texel(&adam, albedo, gradients.0, moments.0);
        sheen.0 = along - albedo.0;
    });
    Ok(())
}

type SheenColumns = (
    (&'static mut DiffuseAlbedo, &'static mut DiffuseSheen),
    (&'static mut AlbedoGradient, &'static mut SheenGradient),
    (&'static mut AlbedoMoments, &'static mut SheenMoments),
);

/// The albedo along the surface after a step; clears its gradient.
fn moved_along(
    adam: &AdamStep,
    along: Vec3,
    sheen: Vec3,
    gradient: &mut SheenGradient,
    moments: &mut SheenMoments,
) -> Vec3 {
    let pulled = gradient.0 + sheen * (2.0 / 3.0 * PRIOR * gradient.1);
    *gradient = SheenGradient::default();
    let by_logit = std::array::from_fn(|c| pulled[c] * Bounded::UNIT.derivative(along[c]));
    let step = adam.advance(&mut moments.0, &by_logit);
    if step == [0.0; 3] {
        return along;
    }
    Vec3::from_array(std::array::from_fn(|c| Bounded::UNIT.move_by(along[c], -step[c])))
}
