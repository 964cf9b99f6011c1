//! The `View` pass: a page that shows the object in a browser, with small photographs, of which
//! only the part that shows the object.

use crate::object::Object;
use crate::page::{Contents, PageCamera, PageLight, PagePhotograph, html, upright};
use crate::scene::{Pass, ViewPass, load::edit_to_ron};
use crate::{report::sheet::choose_evenly, survey::counted};
use bevy_ecs::prelude::{Entity, World};
use glam::Vec3;
use image::{GrayImage, Luma};
use lobelia_geometry::error::{Result, stop::check_interrupted};
use lobelia_geometry::view::{
    Camera, Photograph, PixelWindow, Placement, Split, ViewIndex, ViewMask, ViewName,
};
use lobelia_io::codec::file::write_bytes;
use lobelia_io::codec::tone::{Picture, jpeg_address, side_within, thumbnail_jpeg, thumbnail_mask};
use lobelia_solve::{fit::exposure::Exposures, visibility::ObjectVisibility};
use lobelia_world::light::light_frame::{LightFrame, OwnLightFrame};
use lobelia_world::light::{
    LightLobe, lights::named_light, lights::own_lobes, placement::LightGroup, placement::Placements,
};
use std::path::Path;

/// The page's file name.
pub const PAGE: &str = "view.html";

/// Writes the page of the object, with the lights of all passes.
pub(crate) fn run(object: &mut Object, out: &Path, pass: &ViewPass) -> Result<()> {
    let (scene, world) = (object.scene(), &mut object.pipeline.world);
    let lobes = |pass: &Pass| Some((pass.name().to_owned(), named_light(world, pass.name())?.0));
    let named = scene.passes.iter().filter_map(lobes).collect();
    write_page(object, out, pass, named, &out.join(&pass.name).join(PAGE))
}

/// Writes the page of the object with these lights besides its own.
pub(crate) fn write_page(
    object: &mut Object,
    out: &Path,
    pass: &ViewPass,
    named: Vec<(String, Vec<LightLobe>)>,
    path: &Path,
) -> Result<()> {
    let material = object.shown_by(pass.of.as_deref()).material()?;
    let scene = object.scene();
    let edits = scene.pass_named(pass.of.as_deref()).map_or(&[][..], Pass::edits);
    let edits = edits.iter().map(edit_to_ron).collect::<Result<Vec<String>>>()?;
    let shadows = object.has_visibility()?;
    // Those held out first, each group by name.
    let mut query = object.pipeline.world.query::<(Entity, &ViewName, &Camera, &Split)>();
    let camera = |(view, name, camera, split): (Entity, &ViewName, &Camera, &Split)| {
        (view, PageCamera { name: name.0.clone(), split: *split, camera: *camera, photograph: None })
    };
    let mut all: Vec<_> = query.iter(&object.pipeline.world).map(camera).collect();
    all.sort_by_cached_key(|(_, camera)| (camera.split != Split::Test, camera.name.clone()));
    let (views, mut cameras): (Vec<_>, Vec<_>) = all.into_iter().unzip();
    let embedded = add_photographs(&object.pipeline.world, &views, &mut cameras, pass.photographs as usize)?;
    let world = &mut object.pipeline.world;
    let frame = world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default();
    let mut lights = vec![PageLight { name: "found".into(), lobes: own_lobes(world), frame, own: true }];
    let frame = LightFrame::World;
    lights.extend(named.into_iter().map(|(name, lobes)| PageLight { name, lobes, frame, own: false }));
    // The light of the pass `of`, if it has one, is the first.
    if let Some(first) = lights.iter().position(|light| !light.own && Some(&light.name) == pass.of.as_ref()) {
        lights[..=first].rotate_right(1);
    }
    // That of the scene file, if nobody said another.
    let title = out.file_name().map(|name| name.to_string_lossy().into_owned());
    let contents = Contents {
        title: title.as_deref().unwrap_or("Lobelia"),
        up: upright(&cameras, scene.up),
        surface: &object.surface(),
        material: &material,
        edits,
        lights,
        cameras,
        visibility: object.pipeline.world.get_resource::<ObjectVisibility>().filter(|_| shadows),
    };
    let text = html(&contents)?;
    write_bytes(path, text.as_bytes())?;
    let mib = text.len() as f64 / 1048576.0;
    let with = if embedded > 0 { format!(", {}", counted(embedded, "photograph")) } else { String::new() };
    object.print(&format!("{}: {}{with}, {mib:.1} MiB", pass.name, path.display()));
    Ok(())
}

/// Bytes of all photographs of a page, about; addresses take a third more.
const BUDGET: f64 = 1.5e6;
/// Bytes of addresses that are never exceeded: further photographs are left out.
const MOST_BYTES: usize = 3_000_000;
/// Part of the longer side of the object's window that is added around it.
const MARGIN: f32 = 0.04;

/// Adds photographs to at most `max` of the cameras, which are of these views: held-out views
/// first, evenly chosen. Returns to how many.
fn add_photographs(world: &World, views: &[Entity], cameras: &mut [PageCamera], max: usize) -> Result<usize> {
    // They can be compared with what the scene's own light shows.
    let is_under_own_light = |view: Entity| {
        let (all, own) = (world.get_resource::<Placements>(), world.get::<Placement>(view));
        all.zip(own).is_none_or(|(all, placement)| all.light(*placement) == LightGroup::OWN)
    };
    let is_there = |view: Entity| {
        is_under_own_light(view)
            && world.get::<Photograph>(view).is_some_and(|photograph| !photograph.window().is_empty())
    };
    let mut chosen = Vec::new();
    for split in [Split::Test, Split::Train] {
        let there: Vec<_> =
            (0..views.len()).filter(|&i| cameras[i].split == split && is_there(views[i])).collect();
        chosen.extend(choose_evenly(there.len(), max - chosen.len()).into_iter().map(|i| there[i]));
    }
    let side = side_within(chosen.len(), BUDGET);
    let (mut bytes, mut count) = (0, 0);
    for place in chosen {
        check_interrupted()?;
        let Some(photograph) = embedded(world, views[place], side)? else { continue };
        bytes += photograph.address.len();
        if bytes > MOST_BYTES {
            break;
        }
        cameras[place].photograph = Some(photograph);
        count += 1;
    }
    Ok(count)
}

/// A view's photograph at the exposure of renders; `None` if it does not show the object.
pub(crate) fn embedded(world: &World, view: Entity, side: u32) -> Result<Option<PagePhotograph>> {
    let Some(photograph) = world.get::<Photograph>(view) else { return Ok(None) };
    let mask = world.get::<ViewMask>(view).map(|mask| &mask.0).filter(|mask| !mask.is_full());
    let window = match mask {
        // With a margin, as far as the picture reaches.
        Some(mask) => {
            let (PixelWindow { x, y, width, height }, size) = (mask.window(), photograph.size());
            let margin = (MARGIN * width.max(height) as f32).ceil() as u32;
            let (left, top) = (x.saturating_sub(margin), y.saturating_sub(margin));
            let [right, bottom] = [x + width, y + height].map(|end| end + margin);
            let (width, height) = (right.min(size[0]) - left, bottom.min(size[1]) - top);
            PixelWindow { x: left, y: top, width, height }
        }
        None => photograph.window(),
    };
    if window.is_empty() || mask.is_some_and(|mask| mask.window().is_empty()) {
        return Ok(None);
    }
    let factor = world.get_resource::<Exposures>().zip(world.get::<ViewIndex>(view));
    let factor = factor.map_or(Vec3::ONE, |(exposures, index)| exposures.factor(*index));
    let pixels = || window.pixels(photograph.size()[0]);
    let color: Vec<Vec3> = pixels().map(|i| photograph.radiance(i) / factor).collect();
    let alpha: Vec<f32> = pixels().map(|i| mask.map_or(1.0, |mask| mask.coverage(i))).collect();
    let (width, height) = (window.width as usize, window.height as usize);
    let picture = Picture { width, height, color: &color, alpha: &alpha };
    let jpeg = thumbnail_jpeg(&picture.on_mat()?, side)?;
    let covered = |x: u32, y: u32| Luma([(alpha[y as usize * width + x as usize] * 255.0 + 0.5) as u8]);
    let coverage = thumbnail_mask(&GrayImage::from_fn(window.width, window.height, covered), side);
    let size = coverage.dimensions().into();
    let coverage = mask.map(|_| coverage.into_raw());
    Ok(Some(PagePhotograph { window, size, address: jpeg_address(&jpeg), coverage }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_geometry::view::{Image, Mask, StoredMask};
    use lobelia_solve::fit::exposure::ExposureChoice;

    /// Views of 40 × 30 pixels: training views, and then test views, whose object is a red square.
    fn world(train: usize, test: usize) -> (World, Vec<Entity>, Vec<PageCamera>) {
        let (width, height) = (40, 30);
        let inside = |i: u32| (10..20).contains(&(i % width)) && (6..16).contains(&(i / width));
        let red = |i: u32| if inside(i) { Vec3::new(0.5, 0.0, 0.0) } else { Vec3::ZERO };
        let pixels = (0..width * height).map(red).collect();
        let photograph = Photograph::of_image(&Image { width, height, pixels });
        let coverage = (0..width * height).map(|i| f32::from(u8::from(inside(i)))).collect();
        let mask = StoredMask::new(&Mask { width, height, coverage });
        let camera = Camera::look_at(Vec3::Z, Vec3::ZERO, Vec3::Y, 40.0, width, height).unwrap();
        let mut world = World::new();
        let mut views = Vec::new();
        let mut cameras = Vec::new();
        for i in 0..train + test {
            let split = if i < train { Split::Train } else { Split::Test };
            let name = format!("{i}");
            let view = (ViewName(name.clone()), split, photograph.clone(), ViewMask(mask.clone()));
            views.push(world.spawn(view).id());
            cameras.push(PageCamera { name, split, camera, photograph: None });
        }
        (world, views, cameras)
    }

    fn with(cameras: &[PageCamera]) -> Vec<usize> {
        (0..cameras.len()).filter(|i| cameras[*i].photograph.is_some()).collect()
    }

    #[test]
    fn held_out_views_come_first_and_few_are_chosen_evenly() {
        let (world, views, mut cameras) = world(10, 2);
        assert_eq!(add_photographs(&world, &views, &mut cameras, 5).unwrap(), 5);
        assert_eq!(with(&cameras), [0, 5, 9, 10, 11]);
        cameras.iter_mut().for_each(|camera| camera.photograph = None);
        assert_eq!(add_photographs(&world, &views, &mut cameras, 1).unwrap(), 1);
        assert_eq!(with(&cameras), [10]);
        cameras.iter_mut().for_each(|camera| camera.photograph = None);
        assert_eq!(add_photographs(&world, &views, &mut cameras, 0).unwrap(), 0);
        assert!(with(&cameras).is_empty());
    }

    #[test]
    fn the_part_with_the_object_is_shown_on_the_mat() {
        let (world, views, mut cameras) = world(0, 1);
        add_photographs(&world, &views, &mut cameras, 24).unwrap();
        let photograph = cameras[0].photograph.clone().unwrap();
        assert_eq!(photograph.window, PixelWindow { x: 9, y: 5, width: 12, height: 12 });
        assert_eq!(photograph.size, [12, 12]);
        let coverage = photograph.coverage.unwrap();
        assert_eq!((coverage[0], coverage[12 * 6 + 6], coverage.len()), (0, 255, 144));
        assert!(photograph.address.starts_with("data:image/jpeg;base64,"));
    }

    #[test]
    fn views_without_a_photograph_or_without_the_object_are_left_out() {
        let (mut world, views, mut cameras) = world(0, 3);
        world.entity_mut(views[0]).remove::<Photograph>();
        let empty = StoredMask::new(&Mask { width: 40, height: 30, coverage: vec![0.0; 1200] });
        world.entity_mut(views[1]).insert(ViewMask(empty));
        assert_eq!(add_photographs(&world, &views, &mut cameras, 24).unwrap(), 1);
        assert_eq!(with(&cameras), [2]);
    }

    #[test]
    fn photographs_are_shown_at_the_exposure_of_renders() {
        let (mut world, views, mut cameras) = world(1, 0);
        let address = |world: &World, cameras: &mut [PageCamera]| {
            add_photographs(world, &views, cameras, 1).unwrap();
            cameras[0].photograph.clone().unwrap().address
        };
        let plain = address(&world, &mut cameras);
        world.entity_mut(views[0]).insert(ViewIndex(0));
        let mut exposures = Exposures::default();
        (exposures.used, exposures.factors) = (ExposureChoice::Brightness, vec![Vec3::splat(2.0)]);
        world.insert_resource(exposures);
        assert_ne!(address(&world, &mut cameras), plain);
    }
}
