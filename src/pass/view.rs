//! The `View` pass: a page that shows the object in a browser.

use crate::codec::file::write_bytes;
use crate::error::Result;
use crate::light::LightLobe;
use crate::light::light_frame::{LightFrame, OwnLightFrame};
use crate::light::lights::own_lobes;
use crate::page::upright::upright;
use crate::page::{Contents, PageCamera, PageLight, html};
use crate::pass::page_cameras::page_cameras;
use crate::pass::session::Session;
use crate::pass::show::material_of;
use crate::pass::view_photographs::add_photographs;
use crate::scene::load::edit_to_ron;
use crate::scene::{Pass, ViewPass};
use crate::visibility::ObjectVisibility;
use bevy_ecs::prelude::Entity;
use std::path::Path;

/// The page's file name.
pub const PAGE: &str = "view.html";

/// Writes the page of the object, with the lights of all passes.
///
/// # Errors
/// If an edit's image cannot be read, or the page is too large or cannot be written.
pub(crate) fn run(session: &mut Session, pass: &ViewPass) -> Result<()> {
    let named = session.scene.passes.iter().filter_map(|pass| {
        let light = session.lights.of_passes.get(pass.name())?;
        Some((pass.name().to_owned(), light.lobes.clone()))
    });
    let named = named.collect();
    let path = session.folder(&pass.name).join(PAGE);
    write_page(session, pass, named, &path)
}

/// Writes the page of the object with these lights besides its own.
///
/// # Errors
/// As [`run`].
pub(crate) fn write_page(
    session: &mut Session,
    pass: &ViewPass,
    named: Vec<(String, Vec<LightLobe>)>,
    path: &Path,
) -> Result<()> {
    let material = material_of(session, pass.of.as_deref())?;
    let edits = session.pass_named(pass.of.as_deref()).map_or(&[][..], Pass::edits);
    let edits = edits.iter().map(edit_to_ron).collect::<Result<Vec<String>>>()?;
    let shadows = session.has_visibility()?;
    let (views, mut cameras): (Vec<Entity>, Vec<PageCamera>) =
        page_cameras(&mut session.pipeline.world).into_iter().unzip();
    let embedded = add_photographs(&session.pipeline.world, &views, &mut cameras, pass.photographs as usize)?;
    let lights = lights(session, pass.of.as_deref(), named);
    let contents = Contents {
        title: &title(session),
        up: upright(&cameras, session.scene.up),
        surface: &session.surface,
        material: &material,
        edits,
        lights,
        cameras,
        visibility: session.pipeline.world.get_resource::<ObjectVisibility>().filter(|_| shadows),
    };
    let text = html(&contents)?;
    write_bytes(path, text.as_bytes())?;
    let mib = text.len() as f64 / 1048576.0;
    let with = match embedded {
        0 => String::new(),
        1 => ", 1 photograph".to_owned(),
        count => format!(", {count} photographs"),
    };
    session.progress.print(&format!("{}: {}{with}, {mib:.1} MiB", pass.name, path.display()));
    Ok(())
}

/// The name of the output folder, which is that of the scene file if nobody said another.
fn title(session: &Session) -> String {
    let name = session.out.file_name().map(|name| name.to_string_lossy().into_owned());
    name.unwrap_or_else(|| "Lobelia".to_owned())
}

/// The object's own light and the named ones; that of the pass `of`, if it has one, is the first.
fn lights(session: &mut Session, of: Option<&str>, named: Vec<(String, Vec<LightLobe>)>) -> Vec<PageLight> {
    let world = &mut session.pipeline.world;
    let frame = world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default();
    let own = PageLight { name: "found".into(), lobes: own_lobes(world), frame, own: true };
    let named = named.into_iter().map(|(name, lobes)| PageLight {
        name,
        lobes,
        frame: LightFrame::World,
        own: false,
    });
    let mut lights: Vec<PageLight> = std::iter::once(own).chain(named).collect();
    if let Some(first) = lights.iter().position(|light| !light.own && Some(light.name.as_str()) == of) {
        lights[..=first].rotate_right(1);
    }
    lights
}
