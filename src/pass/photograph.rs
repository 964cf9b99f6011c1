//! Rendered photographs: the scene's surface with a known material under a known light, path traced. The fit does not use that knowledge.

use crate::codec::exr_frame::Frame;
use crate::error::Result;
use crate::error::stop::check_interrupted;
use crate::light::LightLobe;
use crate::light::light_frame::LightFrame;
use crate::light::lights::{LightChoice, provide_light, spawn_light};
use crate::light::placement::{LightGroup, PicturePlacement};
use crate::material::edit::MaterialState;
use crate::material::shown::{show_edited, spawn_material};
use crate::material::{DiffuseAlbedo, SpecularBlend};
use crate::material::{DiffuseSheen, DiffuseTilt};
use crate::math::fibonacci::fibonacci_axes;
use crate::math::ray::Intersect;
use crate::mesh::Surface;
use crate::pass::edit::{apply_edits, spawn_edits};
use crate::pass::progress::Progress;
use crate::pass::shading::set_shading;
use crate::pipeline::{Phase, Pipeline, Slot};
use crate::sample::point::Scenery;
use crate::scene::{CameraRing, CameraSpec, Edit, Pattern, Photographed, RenderSettings, Scene, Shading};
use crate::shade::frame::{FramePlugin, render_frame, resolve};
use crate::spawn::light_file::rotation;
use crate::spawn::{LoadedLight, load_light};
use crate::view::Placement;
use crate::view::camera::Camera;
use crate::view::{Image, Mask, Photograph, Split, StoredMask, ViewRecord};
use glam::{Mat3, Vec3};
use std::sync::Arc;

/// Name of the light and the edits of the true object.
const TRUTH: &str = "truth";

/// The object that is photographed, in a separate world.
pub struct TrueObject {
    pipeline: Pipeline,
    surface: Arc<Surface>,
    /// Its light in each round.
    lights: Vec<LoadedLight>,
    light_frame: LightFrame,
    placements: Vec<Mat3>,
    max_bounces: u32,
}

impl TrueObject {
    /// Creates the object that a scene file describes.
    ///
    /// # Errors
    /// If its light, or an image of its edits, cannot be read.
    pub fn new(spec: &Photographed, surface: &Arc<Surface>) -> Result<Self> {
        let mut pipeline = Pipeline::new();
        pipeline.add_plugin(&FramePlugin);
        let scenery: Arc<dyn Intersect> = surface.clone();
        pipeline.world.insert_resource(Scenery(scenery));
        let albedo =
            surface.atlas().position.iter().map(|p| DiffuseAlbedo(pattern_at(&spec.truth.albedo, *p)));
        let albedo: Vec<DiffuseAlbedo> = albedo.collect();
        let blends = vec![SpecularBlend::default(); albedo.len()];
        let sheen = vec![DiffuseSheen::default(); albedo.len()];
        let tilt = vec![DiffuseTilt::default(); albedo.len()];
        let mut material =
            MaterialState { albedo, sheen, tilt, blends, lobes: vec![Some(spec.truth.specular)] };
        apply_edits(&mut material, &spec.truth.edits, surface)?;
        spawn_material(&mut pipeline.world, &material);
        let others = spec.truth.other_lights.iter().map(load_light);
        let lights = std::iter::once(load_light(&spec.truth.light)).chain(others).collect::<Result<_>>()?;
        Ok(Self {
            pipeline,
            surface: surface.clone(),
            lights,
            light_frame: spec.truth.light_frame,
            placements: rounds(spec),
            max_bounces: spec.max_bounces,
        })
    }

    /// The lobes of its light in the first round.
    pub fn lobes(&self) -> &[LightLobe] {
        &self.lights[0].lobes
    }

    /// Path-traced pictures of the true object, optionally under another light or with edits. In its own light it lies as in the placement of each.
    ///
    /// # Errors
    /// If an edit's image cannot be read, or a system fails.
    pub fn pictures(
        &mut self,
        views: &[(Camera, Placement)],
        light: Option<&LoadedLight>,
        edits: &[Edit],
        spp: u32,
        seed: u64,
        mut done: impl FnMut(),
    ) -> Result<Vec<Frame>> {
        let lights = self.spawn_lights(light);
        spawn_edits(&mut self.pipeline.world, TRUTH, edits, &self.surface)?;
        self.pipeline.swap(Phase::Frame, Slot::Material, show_edited(TRUTH));
        let shading = Shading::PathTraced { spp, max_bounces: self.max_bounces, map: true, denoise: false };
        let side = (f64::from(spp.min(64)).sqrt().floor()).max(1.0) as u32;
        let settings =
            RenderSettings { shading, samples_per_pixel: side * side, ..RenderSettings::default() };
        let mut frames = Vec::new();
        for (i, (camera, placement)) in views.iter().enumerate() {
            check_interrupted()?;
            set_shading(&mut self.pipeline, &settings, seed.wrapping_add(i as u64));
            let round = placement.0 as usize;
            let room_from_object = self.placements.get(round).copied().unwrap_or(Mat3::IDENTITY);
            // Rounds under other lights come after those of placements.
            let number = (round + 1).saturating_sub(self.placements.len()).min(lights.len() - 1);
            let choice = LightChoice::Named(lights[number].clone());
            let shown = PicturePlacement { room_from_object, light: LightGroup::OWN };
            self.pipeline.swap(Phase::Frame, Slot::Light, provide_light(choice, true));
            self.pipeline.world.insert_resource(shown);
            frames.push(resolve(&render_frame(&mut self.pipeline, *camera, settings.samples_per_pixel)?));
            done();
        }
        Ok(frames)
    }

    /// Spawns this light, or its own; returns their names.
    fn spawn_lights(&mut self, light: Option<&LoadedLight>) -> Vec<String> {
        let frame = light.is_none().then_some(self.light_frame);
        let lights = light.map_or(self.lights.as_slice(), std::slice::from_ref);
        let mut names = Vec::new();
        for (number, light) in lights.iter().enumerate() {
            let name = format!("{TRUTH} {number}");
            let spawned = spawn_light(&mut self.pipeline.world, &name, &light.lobes, light.map.clone());
            frame.into_iter().for_each(|frame| _ = self.pipeline.world.entity_mut(spawned).insert(frame));
            names.push(name);
        }
        names
    }
}

/// Renders all photographs of a scene.
///
/// # Errors
/// If a system fails.
pub fn take(
    truth: &mut TrueObject,
    spec: &Photographed,
    scene: &Scene,
    progress: &dyn Progress,
) -> Result<Vec<ViewRecord>> {
    let ring = ring(&spec.cameras, scene.up);
    let cameras: Vec<Camera> = ring.iter().map(camera_of).collect::<Result<_>>()?;
    let bar = progress.bar("photograph", cameras.len() as u64);
    let shown: Vec<(Camera, Placement)> = cameras.into_iter().zip(placements_in_turn(spec)).collect();
    let frames = truth.pictures(&shown, None, &[], spec.spp, scene.seed, || bar.inc(1))?;
    bar.finish_and_clear();
    let records = ring.into_iter().zip(shown).zip(frames).map(|((spec, (camera, placement)), frame)| {
        let (width, height) = (camera.width, camera.height);
        ViewRecord {
            photograph: Some(Photograph::of_image(&Image { width, height, pixels: frame.color })),
            mask: Some(StoredMask::new(&Mask { width, height, coverage: frame.alpha })),
            placement,
            ..ViewRecord::of_camera(spec.name, spec.split, camera)
        }
    });
    Ok(records.collect())
}

/// The views of [`take`] with photographs that are not rendered, for checks that look at no pixel.
///
/// # Errors
/// If a camera cannot be used.
pub(crate) fn imagine(spec: &Photographed, scene: &Scene) -> Result<Vec<ViewRecord>> {
    let view = |(spec, placement): (CameraSpec, Placement)| {
        let camera = camera_of(&spec)?;
        let photograph = Some(Photograph::without_pixels(camera.width, camera.height));
        Ok(ViewRecord { photograph, placement, ..ViewRecord::of_camera(spec.name, spec.split, camera) })
    };
    ring(&spec.cameras, scene.up).into_iter().zip(placements_in_turn(spec)).map(view).collect()
}

/// Rotations of the object in the rounds of photographs.
fn rounds(spec: &Photographed) -> Vec<Mat3> {
    let others = spec.truth.placements.iter().map(|degrees| Mat3::from_quat(rotation(*degrees)));
    std::iter::once(Mat3::IDENTITY).chain(others).collect()
}

/// The placement that each view shows.
fn placements_in_turn(spec: &Photographed) -> impl Iterator<Item = Placement> + use<> {
    let rounds = spec.truth.rounds() as u32;
    (0..).map(move |view| Placement(view % rounds))
}

/// Cameras distributed over a sphere around the target; every n-th is a test view, so that test views lie between the others.
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
    let along = |direction: Vec3| sight.dot(direction.normalize_or(Vec3::Y)).abs() > 0.99;
    if !along(up) {
        up
    } else if !along(Vec3::Z) {
        Vec3::Z
    } else {
        Vec3::X
    }
}

/// The color of the pattern at a point.
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

/// The camera that a scene describes.
pub(super) fn camera_of(spec: &CameraSpec) -> Result<Camera> {
    Camera::look_at(spec.eye, spec.target, spec.up, spec.fov_degrees, spec.width, spec.height)
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

    #[test]
    fn checkers_alternate_across_the_origin() {
        let pattern = Pattern::Checker { colors: (Vec3::ZERO, Vec3::ONE), size: 0.5 };
        assert_ne!(pattern_at(&pattern, Vec3::splat(0.1)), pattern_at(&pattern, Vec3::new(-0.1, 0.1, 0.1)));
    }
}
