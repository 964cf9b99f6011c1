//! What is shown of an object. Material, light and shading are each one system in a slot of the phases
//! Compose and Frame, which are swapped; the recovered material and the own light do not change.

use crate::object::{Object, ObjectSurface};
use crate::scene::check_shown;
use crate::scene::{ColorAction, Edit, Light, LightSource, Region, RenderSettings, ScalarAction, Shading};
use crate::spawn::LoadedLight;
use bevy_ecs::prelude::{Entity, World};
use glam::Vec3;
use lobelia_geometry::parallel;
use lobelia_geometry::view::{Camera, Frame, Placement};
use lobelia_geometry::{error::Result, mesh::Surface, mesh::atlas::TexelAtlas};
use lobelia_io::codec::texture::{read_texture, read_texture_mask};
use lobelia_sg::shading::ClosedForm;
use lobelia_solve::shade::frame::{frame_material, render_frame, resolve};
use lobelia_solve::shade::{PathTracing, shade_closed_form, shade_path_traced};
use lobelia_solve::visibility::see_shown;
use lobelia_world::light::lights::{
    LightChoice, named_light, own_lobes, own_map, provide_light, spawn_light,
};
use lobelia_world::light::placement::{GroupInTurn, PicturePlacement, Placements};
use lobelia_world::light::{LightLobe, illuminate::MapLight};
use lobelia_world::material::edit::{
    EditAction, EditName, EditOrder, EditRegion, EditTarget, MaterialState, apply_edit,
};
use lobelia_world::material::shown::{recovered_material, show_edited, show_recovered};
use lobelia_world::pipeline::{Phase, Pipeline, Slot};
use std::sync::Arc;

/// The name of edits and light that are of no pass.
const SHOWN: &str = "shown now";

/// An object as it is shown: with edits, under another light, by another shading. Systems are
/// swapped in for that, and nothing is copied. When this is dropped, the slots of material, light
/// and shading have again what an object begins with.
pub struct Appearance<'a> {
    pub(crate) object: &'a mut Object,
    /// Name of the edits, and of the light, if it is not the object's own.
    name: String,
    pub(super) edits: Vec<Edit>,
    /// The other light: the source that says it, if one does, or none of a light in memory.
    pub(super) relit: Option<Option<LightSource>>,
    settings: RenderSettings,
    /// Whether systems were swapped in, and whether they are those of this appearance as it is now.
    is_in: bool,
    is_current: bool,
}

impl Drop for Appearance<'_> {
    fn drop(&mut self) {
        if self.is_in {
            let pipeline = &mut self.object.pipeline;
            pipeline.swap(Phase::Compose, Slot::Material, show_recovered());
            pipeline.swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Own, false));
            set_shading(pipeline, &RenderSettings::default(), 0);
        }
    }
}

impl Object {
    /// The object as it was found.
    pub fn shown(&mut self) -> Appearance<'_> {
        let (name, edits, settings) = (SHOWN.to_owned(), Vec::new(), RenderSettings::default());
        Appearance { object: self, name, edits, relit: None, settings, is_in: false, is_current: false }
    }

    /// The object as the pass with a name shows it, or as it was found.
    pub(crate) fn shown_by(&mut self, pass: Option<&str>) -> Appearance<'_> {
        let scene = self.scene();
        match scene.pass_named(pass) {
            Some(pass) => Appearance {
                name: pass.name().to_owned(),
                edits: pass.edits().to_vec(),
                relit: pass.light().map(|source| Some(source.clone())),
                settings: pass.render().cloned().unwrap_or_default(),
                is_in: false,
                is_current: false,
                object: self,
            },
            None => self.shown(),
        }
    }

    /// The object under another light.
    pub fn relit(&mut self, light: &LoadedLight) -> Appearance<'_> {
        self.shown().relit(light)
    }

    /// The object with a changed material. Each element is the edits that make one change, as
    /// [`Edit::metal`] does.
    pub fn edited<E: IntoIterator<Item = Edit>>(
        &mut self,
        edits: impl IntoIterator<Item = E>,
    ) -> Appearance<'_> {
        self.shown().edited(edits)
    }

    /// Renders the object with the systems that are in the slots of pictures: as it was found, if
    /// none was swapped in. Shadows and reflections are found for the first picture.
    ///
    /// # Errors
    /// The first error of a system.
    pub fn render(&mut self, camera: Camera) -> Result<Frame> {
        if !self.pipeline.is_filled(Phase::Frame, Slot::Visibility) {
            self.swap_in_visibility(true)?;
        }
        Ok(resolve(&render_frame(&mut self.pipeline, camera, RenderSettings::default().samples_per_pixel)?))
    }

    /// Swaps in shadows and reflections of frames, if they are wanted and the object has some.
    fn swap_in_visibility(&mut self, wanted: bool) -> Result<()> {
        self.set_shadows(Phase::Frame, wanted, see_shown())
    }
}

impl Appearance<'_> {
    /// The same under another light.
    #[must_use]
    pub fn relit(mut self, light: &LoadedLight) -> Self {
        let world = &mut self.object.pipeline.world;
        spawn_light(world, self.name.as_str(), &light.lobes, light.map.clone());
        self.relit = Some(light.source.clone());
        self.is_current = false;
        self
    }

    /// The same with further edits.
    #[must_use]
    pub fn edited<E: IntoIterator<Item = Edit>>(mut self, edits: impl IntoIterator<Item = E>) -> Self {
        self.edits.extend(edits.into_iter().flatten());
        self.is_current = false;
        self
    }

    /// The same with another shading, samples a pixel and so on.
    #[must_use]
    pub fn rendered_by(mut self, settings: RenderSettings) -> Self {
        self.settings = settings;
        self.is_current = false;
        self
    }

    /// Renders a picture, with the samples a pixel of the settings.
    ///
    /// # Errors
    /// If a value of the edits or settings makes no sense; if an edit's texture cannot be read; the
    /// first error of a system.
    pub fn render(&mut self, camera: Camera) -> Result<Frame> {
        if !self.is_current {
            self.swap_in()?;
        }
        let rays = camera_rays(&self.settings);
        Ok(resolve(&render_frame(&mut self.object.pipeline, camera, rays)?))
    }

    /// The material that is shown, as plain columns.
    ///
    /// # Errors
    /// As of [`Self::render`].
    pub fn material(&mut self) -> Result<MaterialState> {
        if self.edits.is_empty() {
            return recovered_material(&mut self.object.pipeline.world);
        }
        self.swap_in_material()?;
        frame_material(&mut self.object.pipeline)
    }

    /// The lobes of the light, and the map that they approximate, if one does.
    pub(super) fn light(&mut self) -> (Vec<LightLobe>, Option<Arc<MapLight>>) {
        let world = &mut self.object.pipeline.world;
        let named = self.relit.as_ref().and_then(|_| named_light(world, &self.name));
        named.unwrap_or_else(|| (own_lobes(world), own_map(world)))
    }

    /// Swaps in the systems of its material, light, shading and visibility.
    pub(crate) fn swap_in(&mut self) -> Result<()> {
        self.swap_in_material()?;
        let (choice, by_map) = self.chosen_light();
        self.object.pipeline.swap(Phase::Compose, Slot::Light, provide_light(choice, by_map));
        let seed = self.object.scene().seed;
        set_shading(&mut self.object.pipeline, &self.settings, seed);
        // The published formulas are for comparison and include neither shadows nor
        // interreflection; path tracing includes both itself.
        self.object.swap_in_visibility(self.settings.shading == Shading::Accurate)?;
        self.is_current = true;
        Ok(())
    }

    fn swap_in_material(&mut self) -> Result<()> {
        check_shown(&self.edits, &self.settings)?;
        self.is_in = true;
        let Object { pipeline } = &mut *self.object;
        if self.edits.is_empty() {
            pipeline.swap(Phase::Compose, Slot::Material, show_recovered());
            return Ok(());
        }
        let surface = pipeline.world.resource::<ObjectSurface>().surface.clone();
        spawn_edits(&mut pipeline.world, &self.name, &self.edits, &surface)?;
        pipeline.swap(Phase::Compose, Slot::Material, show_edited(self.name.as_str()));
        Ok(())
    }

    /// The light, and whether path tracing takes its map.
    pub(crate) fn chosen_light(&self) -> (LightChoice, bool) {
        let by_map = matches!(self.settings.shading, Shading::PathTraced { map: true, .. });
        match self.relit {
            Some(_) => (LightChoice::Named(self.name.clone()), by_map),
            // After a fit the lobes may differ from the map that they were initialized from.
            None => (LightChoice::Own, by_map && matches!(self.object.scene().light, Light::Fixed(_))),
        }
    }
}

pub(crate) fn set_shading(pipeline: &mut Pipeline, settings: &RenderSettings, seed: u64) {
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
pub(crate) fn camera_rays(settings: &RenderSettings) -> u32 {
    match settings.shading {
        Shading::Accurate | Shading::Published => settings.samples_per_pixel,
        Shading::PathTraced { spp, .. } => {
            let side = f64::from(settings.samples_per_pixel.min(spp)).sqrt().floor().max(1.0) as u32;
            side * side
        }
    }
}

/// Spawns edits with a name; replaces the edits that have it already.
pub fn spawn_edits(world: &mut World, name: &str, edits: &[Edit], surface: &Surface) -> Result<()> {
    let resolved = resolved(edits, surface)?;
    let mut query = world.query::<(Entity, &EditName)>();
    let old: Vec<Entity> = query.iter(world).filter(|(_, of)| of.0 == name).map(|(edit, _)| edit).collect();
    old.into_iter().for_each(|edit| _ = world.despawn(edit));
    for ((target, action, region), order) in resolved.into_iter().zip(0..) {
        world.spawn((EditName(name.to_owned()), EditOrder(order), target, action, region));
    }
    Ok(())
}

/// Applies a scene file's edits in order.
pub fn apply_edits(state: &mut MaterialState, edits: &[Edit], surface: &Surface) -> Result<()> {
    let mut resolved = resolved(edits, surface)?.into_iter();
    resolved.try_for_each(|(target, action, region)| apply_edit(state, target, &action, &region))
}

/// Edits as they are of the texels of a surface.
fn resolved(edits: &[Edit], surface: &Surface) -> Result<Vec<(EditTarget, EditAction, EditRegion)>> {
    let atlas = surface.atlas();
    let (width, height) = (atlas.width, atlas.height);
    let blend = |value: Vec3, weight: f32| EditAction::Blend { value, weight };
    let color = |action: &ColorAction| -> Result<EditAction> {
        Ok(match action {
            ColorAction::Set(color) => EditAction::Set(*color),
            ColorAction::Scale(factor) => EditAction::Scale(*factor),
            ColorAction::Blend { color, weight } => blend(*color, *weight),
            ColorAction::Texture(path) => EditAction::PerTexel(read_texture(path, width, height)?.into()),
        })
    };
    let resolve = |edit: &Edit| {
        let (target, action) = match edit {
            Edit::Diffuse { action, .. } => (EditTarget::Diffuse, color(action)?),
            Edit::Specular { action, .. } => (EditTarget::Specular, color(action)?),
            Edit::Roughness { action, .. } => {
                let action = match action {
                    ScalarAction::Set(value) => EditAction::Set(Vec3::splat(*value)),
                    ScalarAction::Scale(factor) => EditAction::Scale(Vec3::splat(*factor)),
                    ScalarAction::Blend { value, weight } => blend(Vec3::splat(*value), *weight),
                };
                (EditTarget::Roughness, action)
            }
        };
        let region = EditRegion(region_weights(edit.region(), atlas)?.map(Into::into));
        Ok((target, action, region))
    };
    edits.iter().map(resolve).collect()
}

/// The indices of the edits, from 0, whose region contains no texel of the surface.
pub fn edits_of_nothing(edits: &[Edit], surface: &Surface) -> Result<Vec<usize>> {
    let atlas = surface.atlas();
    let mut numbers = Vec::new();
    for (number, edit) in edits.iter().enumerate() {
        let Some(weights) = region_weights(edit.region(), atlas)? else { continue };
        if !weights.iter().zip(&atlas.covered).any(|(weight, covered)| *covered && *weight > 0.0) {
            numbers.push(number);
        }
    }
    Ok(numbers)
}

/// The weight of each texel; `None` means 1 everywhere.
fn region_weights(region: &Region, atlas: &TexelAtlas) -> Result<Option<Vec<f32>>> {
    let each = |depth: &(dyn Fn(Vec3) -> f32 + Sync), falloff: f32| {
        Some(parallel::map_slice(&atlas.position, 1024, |p| weight_at(depth(*p), falloff)))
    };
    let around = |line: &[Vec3], radius, falloff| each(&|p| radius - distance_to_line(p, line), falloff);
    Ok(match region {
        Region::All => None,
        Region::Box { min, max, falloff } => {
            each(&|p| (p - *min).min_element().min((*max - p).min_element()), *falloff)
        }
        Region::Sphere { center, radius, falloff } => around(&[*center], *radius, *falloff),
        Region::Stroke { points, radius, falloff } => around(points, *radius, *falloff),
        Region::Mask(path) => Some(read_texture_mask(path, atlas.width, atlas.height)?),
    })
}

/// Distance of a point from the line through others, straight from each to the next; infinite if
/// there are none.
fn distance_to_line(from: Vec3, points: &[Vec3]) -> f32 {
    let to_segment = |ends: &[Vec3]| {
        let (offset, along) = (from - ends[0], ends[1] - ends[0]);
        let squared = along.length_squared();
        let t = if squared > 0.0 { (offset.dot(along) / squared).clamp(0.0, 1.0) } else { 0.0 };
        offset.distance(t * along)
    };
    let first = points.first().map_or(f32::INFINITY, |point| from.distance(*point));
    points.windows(2).map(to_segment).fold(first, f32::min)
}

/// The weight at a depth inside the boundary of the region: 0 outside, 1 from `falloff` on, smooth
/// between.
fn weight_at(depth: f32, falloff: f32) -> f32 {
    if depth < 0.0 {
        return 0.0;
    }
    let t = if depth < falloff { depth / falloff } else { 1.0 };
    t * t * (3.0 - 2.0 * t)
}

/// Pictures to come show the object as it lies in this view.
pub(crate) fn show_placement(world: &mut World, view: Entity) {
    let placement = world.get::<Placement>(view).copied().unwrap_or_default();
    let Some(all) = world.get_resource::<Placements>() else { return };
    let (turn, group) = (all.room_from_object(placement), all.light(placement));
    world.insert_resource(PicturePlacement(turn));
    world.insert_resource(GroupInTurn(group));
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_geometry::mesh::primitive::sphere_mesh;

    /// A bent line, from its first point to the right, and then up.
    const BENT: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 2.0, 0.0)];

    #[test]
    fn a_region_sets_in_over_its_falloff() {
        assert_eq!([-0.1, 0.0, 0.2].map(|depth| weight_at(depth, 0.0)), [0.0, 1.0, 1.0]);
        assert_eq!([-0.1, 0.0, 0.1, 0.2].map(|depth| weight_at(depth, 0.2)), [0.0, 0.0, 0.5, 1.0]);
    }

    #[test]
    fn a_stroke_is_around_its_segments_and_points() {
        let found = |x: f32, y: f32, z: f32| distance_to_line(Vec3::new(x, y, z), &BENT);
        assert_eq!([found(0.5, 0.0, 0.0), found(1.0, 1.5, 0.0)], [0.0, 0.0], "on the line");
        assert_eq!([found(0.5, 0.25, 0.0), found(1.0, 1.0, -0.5)], [0.25, 0.5], "beside it");
        assert_eq!([found(-3.0, 0.0, 4.0), found(1.0, 2.5, 0.0)], [5.0, 0.5], "beyond its ends");
        assert_eq!([found(2.0, -1.0, 0.0), found(1.25, 0.0, 0.0)], [2f32.sqrt(), 0.25], "outside the bend");
        let twice = [Vec3::X, Vec3::X];
        assert_eq!(distance_to_line(Vec3::ZERO, &twice), 1.0, "a segment without length");
        assert_eq!(distance_to_line(Vec3::ZERO, &[]), f32::INFINITY);
    }

    #[test]
    fn a_stroke_of_one_point_is_a_ball() {
        let surface = Surface::new(sphere_mesh(Vec3::ZERO, 0.8).unwrap(), 32).unwrap();
        let weights = |region: Region| region_weights(&region, surface.atlas()).unwrap().unwrap();
        let (center, radius, falloff) = (Vec3::new(0.1, 0.7, 0.3), 0.5, 0.2);
        let ball = weights(Region::Sphere { center, radius, falloff });
        assert_eq!(weights(Region::Stroke { points: vec![center], radius, falloff }), ball);
        let longer = weights(Region::Stroke { points: vec![center, Vec3::Z], radius, falloff });
        assert!(longer.iter().zip(&ball).all(|(longer, ball)| longer >= ball));
        assert!(longer.iter().sum::<f32>() > 1.2 * ball.iter().sum::<f32>());
    }
}
