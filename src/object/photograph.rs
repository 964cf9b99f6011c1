//! Rendered photographs: the scene's surface with a known material under a known light, path
//! traced. The fit does not use that knowledge.

use crate::object::show::{apply_edits, camera_rays, set_shading, spawn_edits};
use crate::scene::{CameraRing, CameraSpec, Edit, Pattern, Photographed, RenderSettings, Scene, Shading};
use crate::{progress::Progress, spawn::LoadedLight, spawn::light::rotation, spawn::load_light};
use bevy_ecs::prelude::Resource;
use glam::{Mat3, Vec3};
use lobelia_geometry::view::{Frame, Photograph, Placement, Split, ViewRecord};
use lobelia_geometry::{error::Result, error::stop::check_interrupted, mesh::Surface, view::camera::Camera};
use lobelia_sg::{fibonacci::fibonacci_axes, ray::Intersect};
use lobelia_solve::shade::frame::{FramePlugin, render_frame, resolve};
use lobelia_world::light::lights::{LightChoice, provide_light, spawn_light};
use lobelia_world::light::{
    groups::GroupLight as NamedLight, light_frame::LightFrame, placement::PicturePlacement,
};
use lobelia_world::material::{Diffuse, SpecularBlend, edit::MaterialState};
use lobelia_world::pipeline::{Phase, Pipeline, Slot};
use lobelia_world::{material::shown::show_edited, material::shown::spawn_material, sample::point::Scenery};
use std::sync::Arc;

/// Name of the light and the edits of the true object.
const TRUTH: &str = "truth";

/// The object that is photographed, in a separate world.
#[derive(Resource)]
pub struct TrueObject {
    pipeline: Pipeline,
    surface: Arc<Surface>,
    /// Its light in each round.
    pub lights: Vec<LoadedLight>,
    light_frame: LightFrame,
    placements: Vec<Mat3>,
    max_bounces: u32,
}

impl TrueObject {
    /// Creates the object that a scene file describes.
    pub fn new(spec: &Photographed, surface: &Arc<Surface>) -> Result<Self> {
        let mut pipeline = Pipeline::new();
        pipeline.add_plugin(&FramePlugin);
        let scenery: Arc<dyn Intersect> = surface.clone();
        pipeline.world.insert_resource(Scenery(scenery));
        let truth = &spec.truth;
        let albedo = surface.atlas().position.iter().map(|p| pattern_at(&truth.albedo, *p));
        let diffuse: Vec<Diffuse> = albedo.map(Diffuse::of_albedo).collect();
        let blends = vec![SpecularBlend::default(); diffuse.len()];
        let mut material = MaterialState { diffuse, blends, lobes: vec![Some(truth.specular)] };
        apply_edits(&mut material, &truth.edits, surface)?;
        spawn_material(&mut pipeline.world, &material);
        // Rotations of the object in the rounds of photographs.
        let turned = truth.placements.iter().map(|degrees| Mat3::from_quat(rotation(*degrees)));
        let others = truth.other_lights.iter().map(load_light);
        let lights = std::iter::once(load_light(&truth.light)).chain(others).collect::<Result<_>>()?;
        Ok(Self {
            pipeline,
            surface: surface.clone(),
            lights,
            light_frame: truth.light_frame,
            placements: std::iter::once(Mat3::IDENTITY).chain(turned).collect(),
            max_bounces: spec.max_bounces,
        })
    }

    /// Path-traced pictures of the true object, optionally under another light or with edits. In
    /// its own light it lies as in the placement of each.
    pub fn pictures(
        &mut self,
        views: &[(Camera, Placement)],
        light: Option<NamedLight>,
        edits: &[Edit],
        spp: u32,
        seed: u64,
        mut done: impl FnMut(),
    ) -> Result<Vec<Frame>> {
        // Each is named by `name_of`.
        let frame = light.is_none().then_some(self.light_frame);
        let own = || self.lights.iter().map(|light| (light.lobes.clone(), light.map.clone())).collect();
        let lights: Vec<NamedLight> = light.map_or_else(own, |light| vec![light]);
        for (number, (lobes, map)) in lights.iter().enumerate() {
            let spawned = spawn_light(&mut self.pipeline.world, name_of(number), lobes, map.clone());
            frame.into_iter().for_each(|frame| _ = self.pipeline.world.entity_mut(spawned).insert(frame));
        }
        spawn_edits(&mut self.pipeline.world, TRUTH, edits, &self.surface)?;
        self.pipeline.swap(Phase::Compose, Slot::Material, show_edited(TRUTH));
        let shading = Shading::PathTraced { spp, max_bounces: self.max_bounces, map: true };
        let settings = RenderSettings { shading, samples_per_pixel: 64, ..RenderSettings::default() };
        let rays = camera_rays(&settings);
        let mut frames = Vec::new();
        for (i, (camera, placement)) in views.iter().enumerate() {
            check_interrupted()?;
            set_shading(&mut self.pipeline, &settings, seed.wrapping_add(i as u64));
            let round = placement.0 as usize;
            let room_from_object = self.placements.get(round).copied().unwrap_or(Mat3::IDENTITY);
            // Rounds under other lights come after those of placements.
            let number = (round + 1).saturating_sub(self.placements.len()).min(lights.len() - 1);
            let choice = LightChoice::Named(name_of(number));
            self.pipeline.swap(Phase::Compose, Slot::Light, provide_light(choice, true));
            self.pipeline.world.insert_resource(PicturePlacement(room_from_object));
            frames.push(resolve(&render_frame(&mut self.pipeline, *camera, rays)?));
            done();
        }
        Ok(frames)
    }

    /// Its photographs, from the cameras of the scene.
    pub fn take(&mut self, spec: &Photographed, scene: &Scene, to: &dyn Progress) -> Result<Vec<ViewRecord>> {
        let views = imagine(spec, scene)?;
        let bar = to.bar("photograph", views.len() as u64);
        let shown: Vec<_> = views.iter().map(|view| (view.camera, view.placement)).collect();
        let frames = self.pictures(&shown, None, &[], spec.spp, scene.seed, || bar.inc(1))?;
        Ok(views.into_iter().zip(frames).map(|(view, frame)| view.with_frame(frame)).collect())
    }
}

fn name_of(light: usize) -> String {
    format!("{TRUTH} {light}")
}

/// The views of [`TrueObject::take`] with photographs that are not rendered, for checks that look
/// at no pixel.
pub(crate) fn imagine(spec: &Photographed, scene: &Scene) -> Result<Vec<ViewRecord>> {
    // The placements in turn.
    let rounds = spec.truth.rounds() as u32;
    let view = |(spec, placement): (CameraSpec, Placement)| {
        let camera = spec.camera()?;
        let photograph = Some(Photograph::without_pixels(camera.width, camera.height));
        Ok(ViewRecord { photograph, placement, ..ViewRecord::of_camera(spec.name, spec.split, camera) })
    };
    ring(&spec.cameras, scene.up).into_iter().zip((0..).map(|i| Placement(i % rounds))).map(view).collect()
}

/// Cameras distributed over a sphere around the target; every n-th is a test view, so that test
/// views lie between the others.
pub fn ring(spec: &CameraRing, up: Vec3) -> Vec<CameraSpec> {
    let total = (spec.count + spec.test) as usize;
    let every = total / (spec.test as usize).max(1);
    let axes = fibonacci_axes(total);
    axes.into_iter()
        .enumerate()
        .map(|(i, axis)| {
            let is_test = i / every < spec.test as usize && i % every == every / 2;
            CameraSpec {
                name: format!("view_{i:03}"),
                split: if is_test { Split::Test } else { Split::Train },
                eye: spec.target + axis * spec.radius,
                target: spec.target,
                up: up_across(up, axis),
                fov_degrees: spec.fov_degrees,
                width: spec.size,
                height: spec.size,
            }
        })
        .collect()
}

/// `up`, or another axis if `up` is nearly along the line of sight.
fn up_across(up: Vec3, sight: Vec3) -> Vec3 {
    let is_across = |of: &Vec3| sight.dot(of.normalize_or(Vec3::Y)).abs() <= 0.99;
    [up, Vec3::Z].into_iter().find(is_across).unwrap_or(Vec3::X)
}

fn pattern_at(pattern: &Pattern, at: Vec3) -> Vec3 {
    match pattern {
        Pattern::Constant(color) => *color,
        Pattern::Checker { colors, size } => {
            let cell = (at / *size).floor();
            let odd = (cell.x + cell.y + cell.z).rem_euclid(2.0) >= 1.0;
            if odd { colors.1 } else { colors.0 }
        }
        Pattern::Stripes { colors, axis, width } => {
            let slab = (at.dot(axis.normalize_or(Vec3::Y)) / *width).floor();
            colors[slab.rem_euclid(colors.len() as f32) as usize % colors.len()]
        }
        Pattern::Waves { colors, size } => {
            let wave = (at * (std::f32::consts::TAU / *size)).map(f32::sin);
            colors.0.lerp(colors.1, (0.5 + 0.25 * (wave.x + wave.y * wave.z)).clamp(0.0, 1.0))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn test_views_lie_among_the_training_views() {
        let spec = CameraRing { count: 10, test: 3, ..Default::default() };
        let cameras = ring(&spec, Vec3::Y);
        let test: Vec<usize> = (0..13).filter(|i| cameras[*i].split == Split::Test).collect();
        assert_eq!(test.len(), 3);
        assert!(test.iter().all(|i| *i > 0 && *i < 12));
    }
}
