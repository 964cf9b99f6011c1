//! Whether one base material has spherical Gaussians or GGX as its distribution of microfacet normals, where the scene leaves that to the photographs
//! ([`NdfChoice::Auto`]).
//!
//! The fit begins with the spherical Gaussian. After the first [`TRIED`] steps it takes as many with GGX in its place, which goes on from the same light and albedo; then
//! it goes back and takes the same steps as it is. A pixel's error is measured before a step moves anything; of large or many photographs most pixels of these steps have not
//! been visited before. A trial that is hopeless ends early. Where cameras or vertices are fitted too, they move in the second half of the comparison only. The fit goes on with GGX only if its error is clearly less.
//!
//! Measured in `docs/src/ablation.md`.

use crate::checkpoint::{Span, carry, restore};
use crate::error::stop::is_stopping;
use crate::error::{Error, Result};
use crate::fit::run::{Done, FitOptions, Initialize};
use crate::material::{BaseMaterial, SpecularLobe, first_material};
use crate::math::brdf::Ndf;
use crate::pass::session::Session;
use crate::pass::steps::{Steps, error_after, options};
use crate::profile::stage;
use crate::report::scores::{NdfTried, given_up_words};
use crate::scene::{FitPass, Gloss, NdfChoice, uses_published};
use bevy_ecs::prelude::{With, World};
use glam::Vec3;

/// Steps before the trial, and of the trial.
const TRIED: u32 = 100;
/// A choice is made only in a fit of at least this many steps: vertices begin to move after a quarter of them.
const LEAST_STEPS: u32 = 800;
/// PSNR of linear radiance, in dB, from which nothing is tried: there is little left to explain.
pub(super) const EXPLAINED: f64 = 40.0;
/// Steps of the trial after which it ends if its error is so many times that of the spherical Gaussian before it. After 20 steps it is 1.3 times that on spheres of
/// GGX, and after 50 steps 0.8 times; on `cheburashka`, which has none, 1.4 and 1.3 times, and on `spot` 2.2 times after 20.
const HOPELESS: [(u32, f64); 2] = [(20, 1.6), (50, 1.15)];
/// Error with GGX relative to that of the spherical Gaussian below which it is chosen.
const CLEARLY: f64 = 0.975;

/// Whether the photographs decide about the distribution of normals in this fit.
pub(super) fn is_open(session: &Session, pass: &FitPass) -> bool {
    let scene = session.scene;
    let unknowns = session.unknowns();
    let unsaid = scene.material.specular.ndf == NdfChoice::Auto && scene.own_material().is_none();
    let is_one = matches!(scene.material.gloss, Gloss::Auto | Gloss::One) && !session.several;
    let moves = unknowns.roughness || unknowns.specular_albedo;
    let untried = session.scores.ndf_tried.is_none();
    unsaid && is_one && moves && untried && pass.steps >= LEAST_STEPS && !uses_published(scene)
}

/// The step after which the trial that has begun is decided.
pub(super) fn decided_after(session: &Session) -> Option<u32> {
    session.scores.ndf_tried.filter(|tried| tried.sg.is_none() && !session.several).map(|tried| tried.steps)
}

/// Takes the steps of the trial with GGX from here, after those with the spherical Gaussian, and goes back.
///
/// # Errors
/// If a system fails; [`Error::Interrupted`] if the run is stopped.
pub(super) fn try_ggx(session: &mut Session, pass: &FitPass, sg: &Steps) -> Result<()> {
    let _trying = stage("ggx tried");
    let options = FitOptions {
        initialize: Initialize::NONE,
        ..options(session, pass, Done { steps: sg.summary.steps, secs: 0.0 })?
    };
    let world = &mut session.pipeline.world;
    let before = carry(world, Span::Pass)?;
    let first = first_material(world);
    put_lobe(world, SpecularLobe { ndf: Ndf::Ggx, ..first });
    let hopeless =
        |step: u32, error: f64| HOPELESS.iter().any(|(from, most)| step >= *from && error > most * sg.error);
    let tried = error_after(session, &options, &format!("{}, GGX", pass.name), TRIED, hopeless);
    let world = &mut session.pipeline.world;
    let found = first_material(world);
    restore(world, before)?;
    let (ggx, given_up) = tried?;
    if is_stopping() {
        return Err(Error::Interrupted);
    }
    let (ggx_albedo, ggx_roughness) = (found.albedo.to_array(), found.roughness);
    session.scores.ndf_tried = Some(NdfTried {
        ggx,
        sg: None,
        ggx_albedo,
        ggx_roughness,
        given_up,
        steps: options.done.steps + TRIED,
    });
    Ok(())
}

/// Decides, after the same steps with the spherical Gaussian; GGX begins with the light and albedo of these, and the lobe of the trial.
pub(super) fn decide(session: &mut Session, pass: &FitPass, sg: &Steps) {
    let Some(mut tried) = session.scores.ndf_tried else { return };
    tried.sg = Some(sg.error);
    session.scores.ndf_tried = Some(tried);
    let is_better = tried.given_up.is_none() && tried.ggx < CLEARLY * sg.error;
    if is_better {
        let (albedo, roughness) = (Vec3::from(tried.ggx_albedo), tried.ggx_roughness);
        put_lobe(&mut session.pipeline.world, SpecularLobe { albedo, roughness, ndf: Ndf::Ggx });
    }
    session.progress.print(&words(&pass.name, is_better, tried, sg.error));
}

/// What a choice has come to, in a line.
fn words(pass: &str, is_better: bool, tried: NdfTried, sg: f64) -> String {
    let NdfTried { ggx, given_up, steps, .. } = tried;
    let early = given_up_words(given_up);
    let chosen = if is_better { "GGX is chosen" } else { "the spherical Gaussian is kept" };
    format!(
        "{pass}: distribution of normals: {chosen}: error {ggx:.4} with GGX{early}, {sg:.4} with the Gaussian, after {steps} steps"
    )
}

/// Gives the only base material this lobe; its optimizer's moments stay.
fn put_lobe(world: &mut World, lobe: SpecularLobe) {
    let mut materials = world.query_filtered::<&mut SpecularLobe, With<BaseMaterial>>();
    materials.iter_mut(world).for_each(|mut own| *own = lobe);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_says_what_was_chosen_and_why() {
        let tried = NdfTried { ggx: 0.0065, steps: 200, ..NdfTried::default() };
        let chosen = words("fit", true, tried, 0.0077);
        assert_eq!(
            chosen,
            "fit: distribution of normals: GGX is chosen: error 0.0065 with GGX, 0.0077 with the Gaussian, after 200 steps"
        );
        assert!(words("fit", false, tried, 0.0064).contains("the spherical Gaussian is kept"));
        let given_up = NdfTried { ggx: 0.02, given_up: Some(50), ..tried };
        assert!(
            words("fit", false, given_up, 0.01).contains("0.0200 with GGX (given up after 50 steps), 0.0100")
        );
    }
}
