//! The last part of a `Fit` pass with `detail`: a texture as fine as the photographs, solved for from all their pixels.

use crate::error::Result;
use crate::fit::components::TexelSeen;
use crate::fit::detail::{DetailOptions, finest_side, solve_detail, visited_pixels};
use crate::fit::groups::forget_visibility;
use crate::fit::roughness::texel::TexelRoughness;
use crate::fit::run::FitOptions;
use crate::material::sheen::KnownAlong;
use crate::material::{
    DiffuseAlbedo, DiffuseSheen, DiffuseTilt, SpecularBlend, TexelIndex, recovered_albedo, texels_in_order,
};
use crate::math::ray::TexelAddress;
use crate::mesh::Surface;
use crate::mesh::atlas::address;
use crate::pass::session::Session;
use crate::pipeline::pool::{despawn_rows, read_column};
use crate::profile::stage;
use crate::sample::point::Scenery;
use crate::scene::{FitPass, Tilt};
use crate::view::{Camera, Photograph, Split};
use bevy_ecs::prelude::{Component, With, World};
use glam::{Vec2, Vec3};
use std::sync::Arc;
use std::time::Instant;

/// Makes the texture as fine as the photographs, if it is not, and solves for its albedo, sheen and tilt.
///
/// # Errors
/// The first error of a system; a surface whose shadows would take too much memory.
pub(crate) fn refine_texture(session: &mut Session, pass: &FitPass, options: &FitOptions) -> Result<()> {
    let _detail = stage("texture");
    let start = Instant::now();
    let factor = factor_for(session)?;
    if factor > 1 {
        refine(session, factor)?;
    }
    let visibility = options.visibility && session.has_visibility()?;
    let tilt = session.scene.material.tilt == Tilt::Unknown;
    let bar = session.progress.bar(&pass.name, 100);
    bar.set_message("texture".into());
    let settings = DetailOptions { form: options.form, visibility, tilt, metal: options.unknowns.metal };
    solve_detail(&mut session.pipeline, settings, &mut |done| bar.set_position((100.0 * done) as u64))?;
    bar.finish_and_clear();
    let (side, seconds) = (session.surface.atlas().width, start.elapsed().as_secs_f64());
    session
        .progress
        .print(&format!("{}: texture of {side}² texels from all pixels in {seconds:.1} s", pass.name));
    session.scores.fit_secs = Some(session.scores.fit_secs.unwrap_or(0.0) + seconds);
    Ok(())
}

/// The whole factor that makes a texel about a pixel wide in the median training photograph, as far as [`finest_side`] lets it.
fn factor_for(session: &mut Session) -> Result<u32> {
    let (middle, _) = session.surface.bounding_sphere();
    let world = &mut session.pipeline.world;
    let mut views = world.query_filtered::<(&Camera, &Split), With<Photograph>>();
    let training = views.iter(world).filter(|(_, split)| **split == Split::Train);
    let pixel = |(camera, _): (&Camera, _)| camera.position().distance(middle) / camera.focal[0];
    let mut pixels: Vec<f32> = training.map(pixel).collect();
    pixels.sort_by(f32::total_cmp);
    let Some(pixel) = pixels.get(pixels.len() / 2) else { return Ok(1) };
    let pixels = visited_pixels(world)?;
    let atlas = session.surface.atlas();
    let side = atlas.width.max(atlas.height).max(1);
    let most = finest_side(pixels as f64) as u32 / side;
    // A cast of what is not a number is 0.
    Ok(((atlas.texel_size() / pixel).round() as u32).min(most).max(1))
}

/// Divides each texel into `factor`² texels of the same material.
fn refine(session: &mut Session, factor: u32) -> Result<()> {
    let atlas = session.surface.atlas();
    let (width, height) = (atlas.width, atlas.height);
    let surface = Arc::new(Surface::new(session.surface.mesh().clone(), width * factor)?);
    let fine = surface.atlas();
    let (fine_width, fine_height) = (fine.width, fine.height);
    let center = |i: u32, size: u32| (i as f32 + 0.5) / size as f32;
    let place = |i: u32| Vec2::new(center(i % fine_width, fine_width), center(i / fine_width, fine_height));
    let from: Vec<TexelAddress> =
        (0..fine_width * fine_height).map(|i| address(place(i), width, height)).collect();
    divide_texels(&mut session.pipeline.world, &from)?;
    session.pipeline.world.insert_resource(Scenery(surface.clone()));
    forget_visibility(&mut session.pipeline.world);
    (session.surface, session.surface_found) = (surface, true);
    Ok(())
}

/// Replaces the texels by texels whose material is that of the old ones at these places: albedo and sheen between them, the rest of
/// the nearest.
fn divide_texels(world: &mut World, from: &[TexelAddress]) -> Result<()> {
    let albedo: Vec<Vec3> = recovered_albedo(world)?;
    let sheen = read_column::<TexelIndex, DiffuseSheen>(world)?;
    let sheen: Vec<Vec3> = sheen.into_iter().map(|sheen| sheen.0).collect();
    let tilt = read_column::<TexelIndex, DiffuseTilt>(world)?;
    let tilt: Vec<Vec3> = tilt.into_iter().map(|tilt| tilt.0).collect();
    let blends = read_column::<TexelIndex, SpecularBlend>(world)?;
    let seen = read_column::<TexelIndex, TexelSeen>(world)?;
    let gloss = read_column::<TexelIndex, TexelRoughness>(world).ok();
    let nearest = |address: &TexelAddress| {
        let most = (0..4).max_by(|a, b| address.weights[*a].total_cmp(&address.weights[*b])).unwrap_or(0);
        address.indices[most] as usize
    };
    if let Some(known) = world.get_resource::<KnownAlong>().map(|known| known.divided(from)) {
        world.insert_resource(known);
    }
    let old = texels_in_order(world);
    despawn_rows(world, &old);
    // With all their components at once: bevy would keep the room of a table that they leave.
    world.spawn_batch((0..).map(TexelIndex).zip(from).map(|(index, at)| {
        let (sheen, tilt) = (DiffuseSheen(at.blend(&sheen)), DiffuseTilt(at.blend(&tilt)));
        (index, DiffuseAlbedo(at.blend(&albedo)), sheen, tilt, blends[nearest(at)], seen[nearest(at)])
    }));
    if let Some(gloss) = gloss.filter(|gloss| !gloss.is_empty()) {
        give_texels(world, &from.iter().map(|at| gloss[nearest(at)]).collect::<Vec<_>>());
    }
    Ok(())
}

/// Gives each texel a component, in the order of [`TexelIndex`].
fn give_texels<T: Component + Copy>(world: &mut World, values: &[T]) {
    for (texel, value) in texels_in_order(world).into_iter().zip(values) {
        world.entity_mut(texel).insert(*value);
    }
}
