//! The material, light and shading of frames. Each is one system in a slot of the Frame phase, and a pass swaps them;
//! the recovered material and the scene's own light do not change.

use crate::error::Result;
use crate::light::lights::{LightChoice, provide_light, spawn_light};
use crate::material::edit::MaterialState;
use crate::material::shown::{recovered_material, show_edited, show_recovered};
use crate::pass::edit::spawn_edits;
use crate::pass::session::Session;
use crate::pass::shading::set_shading;
use crate::pipeline::{Phase, Slot};
use crate::scene::{Light, Pass, RenderSettings, Shading};
use crate::shade::frame::frame_material;
use crate::visibility::FrameVisibilityPlugin;

/// Swaps in the material, light, shading and visibility of a pass.
///
/// # Errors
/// If an image of an edit cannot be read, or visibility needs too much memory.
pub(crate) fn show(session: &mut Session, pass: &Pass, settings: &RenderSettings) -> Result<()> {
    show_material(session, pass)?;
    show_light(session, pass, settings.shading);
    set_shading(&mut session.pipeline, settings, session.scene.seed);
    session.pipeline.remove_plugin::<FrameVisibilityPlugin>();
    // The published formulas are for comparison and include neither shadows nor interreflection; path tracing includes both itself.
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

/// Swaps in the light of a pass: its own, or the light of the scene.
fn show_light(session: &mut Session, pass: &Pass, shading: Shading) {
    if let Some(light) = session.lights.of_passes.get(pass.name()) {
        spawn_light(&mut session.pipeline.world, pass.name(), &light.lobes, light.map.clone());
    }
    let (choice, by_map) = chosen_light(session, pass, shading);
    session.pipeline.swap(Phase::Frame, Slot::Light, provide_light(choice, by_map));
}

/// The light of a pass, and whether path tracing takes its map.
pub(super) fn chosen_light(session: &Session, pass: &Pass, shading: Shading) -> (LightChoice, bool) {
    let by_map = matches!(shading, Shading::PathTraced { map: true, .. });
    let choice = match session.lights.of_passes.get(pass.name()) {
        Some(_) => LightChoice::Named(pass.name().to_owned()),
        None => LightChoice::Own,
    };
    // After a fit the lobes may differ from the map that they were initialized from.
    let by_map = by_map && (choice != LightChoice::Own || matches!(session.scene.light, Light::Fixed(_)));
    (choice, by_map)
}

/// The material that the pass `of` shows, by the system that it swaps in; or the recovered one.
///
/// # Errors
/// If an image of an edit cannot be read, or a system fails.
pub(crate) fn material_of(session: &mut Session, of: Option<&str>) -> Result<MaterialState> {
    let Some(pass) = session.pass_named(of) else {
        return recovered_material(&mut session.pipeline.world);
    };
    show_material(session, pass)?;
    // What is written needs no shadows; a pass that renders puts them back.
    session.pipeline.remove_plugin::<FrameVisibilityPlugin>();
    frame_material(&mut session.pipeline)
}
