//! What frames show: which material, which light, how shaded. Each is one system in a slot of the Frame phase, and a pass swaps them;
//! the recovered material and the scene's own light are never touched.

use super::Session;
use super::edit::{apply_edits, spawn_edits};
use crate::error::Result;
use crate::light::lights::{LightChoice, provide_light, spawn_light};
use crate::material::edit::MaterialState;
use crate::material::shown::{recovered_material, show_edited, show_recovered};
use crate::math::shading::ClosedForm;
use crate::pipeline::{Phase, Pipeline, Slot};
use crate::scene::description::Light;
use crate::scene::passes::{Pass, RenderSettings, Shading};
use crate::shade::{PathTracing, shade_closed_form, shade_path_traced};
use crate::visibility::FrameVisibilityPlugin;

/// Swaps in the material, light, shading and visibility of a pass.
///
/// # Errors
/// If an image of an edit cannot be read, or visibility would take too much memory.
pub fn show(session: &mut Session, pass: &Pass, settings: &RenderSettings) -> Result<()> {
    show_material(session, pass)?;
    show_light(session, pass, settings.shading);
    set_shading(&mut session.pipeline, settings, session.scene.seed);
    session.pipeline.remove_plugin::<FrameVisibilityPlugin>();
    // The published formulas are for comparison and know of neither shadows nor reflections; paths find both themselves.
    if settings.shading == Shading::Accurate && session.has_visibility()? {
        session.pipeline.add_plugin(&FrameVisibilityPlugin);
    }
    Ok(())
}

/// Swaps in the system that shows the recovered material with the edits of a pass.
fn show_material(session: &mut Session, pass: &Pass) -> Result<()> {
    if pass.edits().is_empty() {
        session.pipeline.swap(Phase::Frame, Slot::Material, show_recovered());
        return Ok(());
    }
    spawn_edits(&mut session.pipeline.world, pass.name(), pass.edits(), &session.surface)?;
    session.pipeline.swap(Phase::Frame, Slot::Material, show_edited(pass.name()));
    Ok(())
}

/// Swaps in the light of a pass: its own, or the scene's.
fn show_light(session: &mut Session, pass: &Pass, shading: Shading) {
    let by_map = matches!(shading, Shading::PathTraced { map: true, .. });
    let choice = match session.lights.of_passes.get(pass.name()) {
        Some(light) => {
            let (name, map) = (pass.name().to_owned(), light.map.clone());
            spawn_light(&mut session.pipeline.world, name.clone(), &light.lobes, map);
            LightChoice::Named(name)
        }
        None => LightChoice::Own,
    };
    // A fit may have moved the lobes away from the map that they began as.
    let by_map = by_map && (choice != LightChoice::Own || matches!(session.scene.light, Light::Fixed(_)));
    session.pipeline.swap(Phase::Frame, Slot::Light, provide_light(choice, by_map));
}

/// Swaps in the shading system.
pub fn set_shading(pipeline: &mut Pipeline, settings: &RenderSettings, seed: u64) {
    let closed_form = match settings.shading {
        Shading::Accurate => ClosedForm::Accurate(settings.quality),
        Shading::Published => ClosedForm::Published,
        Shading::PathTraced { spp, max_bounces, .. } => {
            let rays = camera_rays(settings);
            let paths_per_sample = spp.div_ceil(rays);
            let paths = PathTracing { paths_per_sample, max_bounces, seed, samples_per_pixel: rays };
            pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced(paths));
            return;
        }
    };
    pipeline.swap(Phase::Frame, Slot::Shading, shade_closed_form(closed_form));
}

/// Camera rays per pixel: a path tracer with fewer paths than that takes one path a ray.
pub fn camera_rays(settings: &RenderSettings) -> u32 {
    match settings.shading {
        Shading::Accurate | Shading::Published => settings.samples_per_pixel,
        Shading::PathTraced { spp, .. } => {
            let side = f64::from(settings.samples_per_pixel.min(spp)).sqrt().floor().max(1.0) as u32;
            side * side
        }
    }
}

/// The material as the pass `of` shows it, or the recovered one.
///
/// # Errors
/// If an image of an edit cannot be read.
pub fn material_of(session: &mut Session, of: Option<&str>) -> Result<MaterialState> {
    let mut material = recovered_material(&mut session.pipeline.world)?;
    if let Some(pass) = session.pass_named(of) {
        apply_edits(&mut material, pass.edits(), &session.surface)?;
    }
    Ok(material)
}
