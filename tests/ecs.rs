//! Usual idioms of bevy: markers, despawning, sorting, change detection, systems and plugins of
//! one's own.

use crate::common::{RADIUS, camera, column, day, evening, photographs_of, shoot, studio};
use lobelia::checkpoint::{Span, keep_pool, load, save};
use lobelia::fit::components::TexelSeen;
use lobelia::light::groups::{all_lights, spawn_group_lights};
use lobelia::sg::fibonacci::fibonacci_axes;
use lobelia::sg::shading::{LobeColumns, ShadePoint};
use lobelia::{
    codec::exr::read_exr_layers, ecs::*, material::shown::recovered_material, object::save::write_material,
    prelude::*,
};
use serde::{Deserialize, Serialize};
use std::{ops::ControlFlow, sync::LazyLock};

#[path = "../examples/own_shader.rs"]
#[allow(dead_code)]
mod own_shader;

#[derive(Component, Clone, Copy, Serialize, Deserialize)]
struct Marked;

fn front() -> Camera {
    camera([0.2, 0.3, 1.0], 20)
}

/// A fit of eight photographs of the studio, which may be changed before it runs.
fn fitted(change: impl FnOnce(&mut Pipeline)) -> Pipeline {
    let mut truth = studio(&day());
    let mut pipeline = studio(&LightLobe::even(16));
    pipeline.add_plugin(&FitPlugin);
    let views = photographs_of(&mut truth, 8, 24, |_, _| {});
    spawn_views(&mut pipeline.world, views);
    change(&mut pipeline);
    let options = FitOptions { steps: 12, batch: 256, ..FitOptions::default() };
    run_fit(&mut pipeline, &options, &mut |_, _| ControlFlow::Continue(())).unwrap();
    pipeline
}

type Found = (Vec<Diffuse>, Vec<LightLobe>, SpecularLobe);

fn found(mut pipeline: Pipeline) -> Found {
    let world = &mut pipeline.world;
    let lobes = world.query::<&LightLobe>().iter(world).copied().collect();
    (column(world), lobes, *world.query::<&SpecularLobe>().single(world).unwrap())
}

/// What a fit finds that nothing changed.
static PLAIN: LazyLock<Found> = LazyLock::new(|| found(fitted(|_| ())));

/// The message of a picture that cannot be rendered.
fn refusal(pipeline: &mut Pipeline) -> String {
    render_frame(pipeline, front(), 1).map(|_| ()).unwrap_err().to_string()
}

fn texel(world: &mut World, number: u32) -> Entity {
    let mut query = world.query::<(Entity, &TexelIndex)>();
    query.iter(world).find(|(_, index)| index.0 == number).unwrap().0
}

fn marked(world: &mut World) -> Vec<u32> {
    let mut query = world.query_filtered::<&TexelIndex, With<Marked>>();
    let mut marked: Vec<u32> = query.iter(world).map(|index| index.0).collect();
    marked.sort_unstable();
    marked
}

#[test]
fn lights_of_groups_and_markers_are_state_that_is_saved_and_loaded() {
    let two_rooms = |other: Vec<LightLobe>| {
        let mut pipeline = studio(&day());
        pipeline.add_plugin(&FitPlugin);
        spawn_group_lights(&mut pipeline.world, &[(other, None)]);
        keep_pool::<TexelIndex, Marked>(&mut pipeline.world, Span::Run);
        pipeline
    };
    let mut first = two_rooms(evening());
    for number in [517, 3] {
        let texel = texel(&mut first.world, number);
        first.world.entity_mut(texel).insert(Marked);
    }
    let saved = save(&mut first.world, Span::Run).unwrap();
    let mut second = two_rooms(LightLobe::even(evening().len()));
    load(&mut second.world, &saved).unwrap();
    assert_eq!(marked(&mut second.world), [3, 517]);
    assert_eq!(all_lights(&mut second.world), [day(), evening()]);
}

#[test]
fn a_marker_on_a_texel_an_observed_pixel_or_a_sample_does_not_change_a_fit() {
    fn mark_sample(samples: Query<(Entity, &SampleIndex), Without<Marked>>, mut commands: Commands) {
        let wanted = samples.iter().filter(|(_, index)| index.0 == 30);
        wanted.for_each(|(sample, _)| _ = commands.entity(sample).insert(Marked));
    }
    fn mark_pixels(pixels: Query<(Entity, &ObservationIndex)>, mut commands: Commands) {
        let wanted = pixels.iter().filter(|(_, index)| [0, 301].contains(&index.0));
        wanted.for_each(|(pixel, _)| _ = commands.entity(pixel).insert(Marked));
    }
    #[derive(Resource, Default)]
    struct Seen(usize);
    fn count(marked: Query<&Marked>, mut seen: ResMut<Seen>) {
        seen.0 = marked.iter().len();
    }
    let with_marker = fitted(|pipeline| {
        let texel = texel(&mut pipeline.world, 517);
        pipeline.world.entity_mut(texel).insert(Marked);
        pipeline.world.init_resource::<Seen>();
        pipeline.add_systems(Phase::Prepare, Stage::Write, mark_pixels);
        pipeline.add_systems(Phase::FitStep, Stage::Write, (count, mark_sample).chain());
    });
    assert_eq!(with_marker.world.resource::<Seen>().0, 4, "all were there until the last step");
    assert_eq!(found(with_marker), *PLAIN);
}

#[test]
fn a_texel_that_is_missing_is_named() {
    let mut pipeline = studio(&day());
    let gone = texel(&mut pipeline.world, 40);
    pipeline.world.despawn(gone);
    assert!(refusal(&mut pipeline).contains("texel 40 is missing"));
}

fn close(a: &Frame, b: &Frame) -> bool {
    a.color.iter().zip(&b.color).all(|(a, b)| a.abs_diff_eq(*b, 1e-5 * a.max_element().max(1.0)))
}

#[test]
fn light_lobes_are_despawned_spawned_and_sorted_between_pictures() {
    let mut pipeline = studio(&day());
    let whole = shoot(&mut pipeline, front());
    let world = &mut pipeline.world;
    let lobes: Vec<_> = world.query::<(Entity, &LightLobe)>().iter(world).map(|(e, l)| (e, *l)).collect();
    world.despawn(lobes[1].0);
    assert_eq!(shoot(&mut pipeline, front()), shoot(&mut studio(&[day()[0], day()[2]]), front()));
    // Back, at the end, and one with a marker: another order and another table.
    pipeline.world.spawn((lobes[1].1, Marked));
    let again = shoot(&mut pipeline, front());
    assert!(close(&again, &whole), "the sum is the same but for rounding");
    assert!(again.color.iter().any(|color| *color != Vec3::ZERO));
}

/// The studio with a second base material in one half; `order` in which the two are spawned.
fn two_materials(order: [u32; 2], weight: f32) -> Pipeline {
    let mut pipeline = studio(&day());
    let world = &mut pipeline.world;
    let old = world.query_filtered::<Entity, With<SpecularLobe>>().single(world).unwrap();
    world.despawn(old);
    for number in order {
        let lobe = SpecularLobe::new(Vec3::splat(0.2 + 0.2 * number as f32), 0.3 + 0.2 * number as f32);
        world.spawn((BaseMaterial(number), lobe));
    }
    for mut blend in world.query::<&mut SpecularBlend>().iter_mut(world) {
        (blend.0[0], blend.0[1]) = (1.0 - weight, weight);
    }
    pipeline
}

#[test]
fn base_materials_are_known_by_number_whatever_their_order() {
    let first = shoot(&mut two_materials([0, 1], 0.25), front());
    assert_eq!(shoot(&mut two_materials([1, 0], 0.25), front()), first);
    assert_ne!(shoot(&mut two_materials([0, 1], 0.75), front()), first);
    // What a despawned material had is without specular light, and comes back with it.
    let mut pipeline = two_materials([0, 1], 0.25);
    let world = &mut pipeline.world;
    let mut query = world.query::<(Entity, &BaseMaterial, &SpecularLobe)>();
    let (second, _, &lobe) = query.iter(world).find(|(_, number, _)| number.0 == 1).unwrap();
    world.despawn(second);
    let without = shoot(&mut pipeline, front());
    assert_eq!(without.diffuse, first.diffuse);
    let red = first.specular.iter().zip(&without.specular).map(|(with, without)| (with.x, without.x));
    let (with, without) = red.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
    assert!(without > 0.0 && without < with);
    pipeline.world.spawn((BaseMaterial(1), lobe));
    assert_eq!(shoot(&mut pipeline, front()), first);
    pipeline.world.spawn((BaseMaterial(1), lobe));
    assert!(refusal(&mut pipeline).contains("two have number 1"));
}

#[derive(Resource, Default)]
struct Refreshes(u32);

fn count_refreshes(object: Res<ObjectVisibility>, mut refreshes: ResMut<Refreshes>) {
    refreshes.0 += u32::from(object.is_changed());
}

#[test]
fn shadows_are_computed_again_when_light_or_material_change_and_only_then() {
    let surface = Arc::new(Surface::new(box_mesh(Vec3::ZERO, Vec3::ONE).unwrap(), 32).unwrap());
    let mut pipeline = studio(&day());
    pipeline.world.insert_resource(ObjectVisibility::new(&surface, VisibilitySettings::default()));
    pipeline.world.init_resource::<Refreshes>();
    pipeline.swap(Phase::Frame, Slot::Visibility, see_shown());
    pipeline.add_systems(Phase::Frame, Stage::Gather, count_refreshes.after(Slot::Visibility));
    let refreshes = |pipeline: &mut Pipeline| {
        shoot(pipeline, front());
        pipeline.world.resource::<Refreshes>().0
    };
    assert_eq!(refreshes(&mut pipeline), 1);
    assert_eq!(refreshes(&mut pipeline), 1, "nothing has changed");
    let world = &mut pipeline.world;
    let lobe = world.query_filtered::<Entity, With<LightLobe>>().iter(world).next().unwrap();
    world.get_mut::<LightLobe>(lobe).unwrap().amplitude *= 2.0;
    assert_eq!(refreshes(&mut pipeline), 2, "Changed<LightLobe>");
    pipeline.world.despawn(lobe);
    assert_eq!(refreshes(&mut pipeline), 3, "a lobe less");
    let texel = texel(&mut pipeline.world, 9);
    pipeline.world.get_mut::<Diffuse>(texel).unwrap().albedo *= 0.5;
    assert_eq!(refreshes(&mut pipeline), 4, "Changed<Diffuse>, by way of what is shown");
    let world = &mut pipeline.world;
    world.query::<&mut SpecularLobe>().single_mut(world).unwrap().roughness = 0.5;
    assert_eq!(refreshes(&mut pipeline), 5);
    spawn_light(&mut pipeline.world, "evening", &evening(), None);
    pipeline.swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Named("evening".into()), false));
    assert_eq!(refreshes(&mut pipeline), 6, "another light");
    pipeline.swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Own, false));
    assert_eq!(refreshes(&mut pipeline), 7, "and back");
    assert_eq!(refreshes(&mut pipeline), 7);
}

/// An edit as a system of one's own: what is red becomes green, from every side.
fn paint_green(composition: Composition) -> SystemResult {
    composition.compose(|material| {
        let red = material.diffuse.iter_mut().filter(|texel| texel.albedo.x > 0.5);
        red.for_each(|texel| *texel = Diffuse::of_albedo(Vec3::Y));
        Ok(())
    })
}

/// The same edit as an entity, with a region of weights.
fn spawn_green(world: &mut World) -> Entity {
    let weight = |texel: &Diffuse| f32::from(u8::from(texel.albedo.x > 0.5));
    let region = EditRegion(Some(column(world).iter().map(weight).collect()));
    let action = EditAction::Set(Vec3::Y);
    world.spawn((EditName("green".into()), EditTarget::Diffuse, action, region)).id()
}

/// The studio with a sheen and a tilt on all texels.
fn studio_with_sheen_and_tilt() -> Pipeline {
    let mut pipeline = studio(&day());
    for mut texel in pipeline.world.query::<&mut Diffuse>().iter_mut(&mut pipeline.world) {
        (texel.sheen, texel.tilt) = (Vec3::splat(0.2), Vec3::new(0.1, 0.2, 0.0));
    }
    pipeline
}

#[test]
fn an_edit_of_ones_own_shows_the_sheen_and_tilt_that_it_leaves() {
    let mut pipeline = studio_with_sheen_and_tilt();
    pipeline.swap(Phase::Compose, Slot::Material, paint_green.run_if(recovered_changed));
    // Without a picture before it.
    let shown = frame_material(&mut pipeline).unwrap();
    let painted = shoot(&mut pipeline, front());
    let plain = recovered_material(&mut pipeline.world).unwrap();
    let is_red = |texel: &Diffuse| texel.albedo.x > 0.5;
    let green = Diffuse::of_albedo(Vec3::Y);
    let expected = plain.diffuse.iter().map(|texel| if is_red(texel) { green } else { *texel });
    assert!(expected.eq(shown.diffuse.iter().copied()));
    assert!(plain.diffuse.iter().any(is_red) && !plain.diffuse.iter().all(is_red));
    spawn_green(&mut pipeline.world);
    pipeline.swap(Phase::Compose, Slot::Material, show_edited("green"));
    assert!(close(&shoot(&mut pipeline, front()), &painted), "the same but for rounding of the sheen");
    // What it shows can be written.
    let surface = Surface::new(sphere_mesh(Vec3::ZERO, RADIUS).unwrap(), 32).unwrap();
    let folder = tempfile::tempdir().unwrap();
    write_material(folder.path(), &shown, surface.atlas()).unwrap();
    let albedo = read_exr_layers(folder.path().join("albedo.exr")).unwrap();
    for (channel, found) in ["R", "G", "B"].map(|name| &albedo.channels[name]).into_iter().enumerate() {
        assert!(found.iter().eq(shown.diffuse.iter().map(|texel| &texel.albedo[channel])), "{channel}");
    }
    assert!(["albedo_along.exr", "albedo_tilt.exr"].iter().all(|file| folder.path().join(file).exists()));
    pipeline.swap(Phase::Compose, Slot::Material, show_recovered());
    assert_eq!(frame_material(&mut pipeline).unwrap(), plain);
}

#[test]
fn a_shader_of_ones_own_is_fitted_by_its_adjoint() {
    let lamps = LobeColumns::from_lobes(LightLobe::even(12).iter().map(Into::into));
    let point = |(normal, to_viewer): (&Vec3, &Vec3)| ShadePoint {
        normal: normal.to_array(),
        to_viewer: to_viewer.to_array(),
        albedo: [0.5; 3],
    };
    let axes = fibonacci_axes(40);
    let points: Vec<ShadePoint> = axes.iter().zip(axes.iter().skip(2)).map(point).collect();
    for roughness in [0.25, 0.5, 0.9] {
        let step = 2e-3;
        let [low, here, high] =
            [-step, 0.0, step].map(|by| own_shader::phong(&points, &lamps, roughness + by));
        for i in 0..points.len() {
            let difference = (high[i][1] - low[i][1]) / (2.0 * step);
            let off = (here[i][2] - difference).length();
            assert!(off < 1e-3 * (1.0 + difference.length()), "{} is not {difference}", here[i][2]);
        }
        assert!(here.iter().any(|[.., slope]| slope.x > 0.1));
    }
    let (albedo, lobe) = (Vec3::new(0.6, 0.3, 0.1), SpecularLobe::new(Vec3::splat(0.3), 0.3));
    let start = (Vec3::splat(0.4), SpecularLobe::new(Vec3::splat(0.15), 0.5));
    let mut pipeline = own_shader::fitted((albedo, lobe), start).unwrap();
    let seen = column::<TexelSeen>(&mut pipeline.world);
    let (texels, _, found) = found(pipeline);
    let known = texels.iter().zip(&seen).filter(|(_, seen)| seen.0 > 4.0).map(|(texel, _)| texel.albedo);
    let off: Vec<f32> = known.map(|found| (found - albedo).abs().max_element()).collect();
    assert!(off.len() > 50 && off.iter().sum::<f32>() < 0.005 * off.len() as f32, "{off:?}");
    assert!((found.roughness - lobe.roughness).abs() < 0.005, "{found:?}");
    assert!((found.albedo - lobe.albedo).abs().max_element() < 0.005, "{found:?}");
}

#[test]
fn a_fit_refuses_a_shader_without_adjoint() {
    let mut pipeline = studio(&day());
    spawn_views(&mut pipeline.world, photographs_of(&mut studio(&day()), 1, 8, |_, _| {}));
    let paths = PathTracing { paths_per_sample: 1, max_bounces: 1, seed: 0, samples_per_pixel: 1 };
    pipeline.add_plugin(&FitPlugin).set_shader(Phase::FitStep, Shader::new(shade_path_traced(paths)));
    let fitted = run_fit(&mut pipeline, &FitOptions::default(), &mut |_, _| ControlFlow::Continue(()));
    assert_eq!(fitted.unwrap_err().to_string(), "the shader of the fit has no adjoint");
}

#[test]
fn an_edit_is_a_system_in_a_slot_and_leaves_what_was_recovered() {
    let mut pipeline = studio(&day());
    let plain = shoot(&mut pipeline, front());
    let recovered = column::<Diffuse>(&mut pipeline.world);
    pipeline.swap(Phase::Compose, Slot::Material, paint_green);
    let painted = shoot(&mut pipeline, front());
    assert_ne!(painted.albedo, plain.albedo);
    let edit = spawn_green(&mut pipeline.world);
    pipeline.swap(Phase::Compose, Slot::Material, show_edited("green"));
    assert_eq!(shoot(&mut pipeline, front()), painted);

    // An edit that changes, goes, or is not of that name.
    *pipeline.world.get_mut::<EditAction>(edit).unwrap() = EditAction::Scale(Vec3::splat(0.5));
    let darker = shoot(&mut pipeline, front());
    assert!(darker != painted && darker != plain);
    let rough = EditAction::Set(Vec3::splat(0.9));
    pipeline.world.spawn((EditName("other".into()), EditTarget::Roughness, rough));
    assert_eq!(shoot(&mut pipeline, front()), darker);
    pipeline.world.despawn(edit);
    assert_eq!(shoot(&mut pipeline, front()), plain);

    pipeline.swap(Phase::Compose, Slot::Material, show_edited("other"));
    assert_ne!(shoot(&mut pipeline, front()).specular, plain.specular);
    pipeline.swap(Phase::Compose, Slot::Material, show_recovered());
    assert_eq!(shoot(&mut pipeline, front()), plain);
    assert_eq!(column::<Diffuse>(&mut pipeline.world), recovered);
}

#[test]
fn an_edit_of_a_region_shows_base_materials_that_go_with_it() {
    let mut pipeline = studio(&day());
    let plain = shoot(&mut pipeline, front());
    let count = column::<Diffuse>(&mut pipeline.world).len();
    let region = EditRegion(Some((0..count).map(|i| if i < count / 2 { 1.0 } else { 0.0 }).collect()));
    let edit = (EditName("polish".into()), EditTarget::Roughness, EditAction::Set(Vec3::splat(0.1)), region);
    pipeline.world.spawn(edit);
    pipeline.swap(Phase::Compose, Slot::Material, show_edited("polish"));
    let polished = shoot(&mut pipeline, front());
    assert_ne!(polished.specular, plain.specular);
    let shown = |world: &mut World| world.query::<&Shown<SpecularLobe>>().iter(world).len();
    assert_eq!(shown(&mut pipeline.world), 2);
    assert_eq!(shoot(&mut pipeline, front()), polished, "made once, not at every picture");
    pipeline.swap(Phase::Compose, Slot::Material, show_recovered());
    assert_eq!(shoot(&mut pipeline, front()), plain);
    assert_eq!(shown(&mut pipeline.world), 1);
}

#[test]
fn a_named_light_goes_with_its_lobes_and_another_can_take_its_name() {
    let mut pipeline = studio(&day());
    let by_day = shoot(&mut pipeline, front());
    let light = spawn_light(&mut pipeline.world, "lamp", &evening(), None);
    assert_eq!(shoot(&mut pipeline, front()), by_day, "the scene's own light is not touched");
    pipeline.swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Named("lamp".into()), false));
    assert_eq!(shoot(&mut pipeline, front()), shoot(&mut studio(&evening()), front()));
    // A lobe is taken from it and one given to it, as any related entity.
    let world = &mut pipeline.world;
    let lobe = world.query_filtered::<Entity, With<LobeOf>>().iter(world).next().unwrap();
    world.despawn(lobe);
    world.spawn((evening()[0], LobeOf(light)));
    assert!(close(&shoot(&mut pipeline, front()), &shoot(&mut studio(&evening()), front())));
    spawn_light(&mut pipeline.world, "lamp", &day(), None);
    assert_eq!(shoot(&mut pipeline, front()), by_day);
    let world = &mut pipeline.world;
    let left = world.query::<&LobeOf>().iter(world).len();
    assert_eq!(left, day().len(), "the old lobes went with the old light");
}

#[test]
fn an_edit_that_fails_fails_again_and_leaves_nothing_behind() {
    let mut pipeline = studio(&day());
    let plain = shoot(&mut pipeline, front());
    let texels: Arc<[Vec3]> = vec![Vec3::ONE; 7].into();
    let edit = (EditName("paint".into()), EditTarget::Diffuse, EditAction::PerTexel(texels));
    let edit = pipeline.world.spawn(edit).id();
    pipeline.swap(Phase::Compose, Slot::Material, show_edited("paint"));
    for _ in 0..2 {
        assert!(refusal(&mut pipeline).contains("7 texels"));
    }
    pipeline.world.despawn(edit);
    assert_eq!(shoot(&mut pipeline, front()), plain);
}
