use super::*;
use crate::fit::components::{StepRates, Unknowns};
use crate::fit::loss::{Loss, radiance};
use crate::fit::{ObjectTurned, guard::StepGuard, observe::PixelChoice, run::FitPlugin, scale::ScaleRule};
use crate::shade::systems::kernel_specular;
use bevy_ecs::prelude::{Entity, Res, ResMut};
use lobelia_geometry::view::{Image, Mask, StoredMask};
use lobelia_sg::fibonacci::{fibonacci_axes, spacing_sharpness};
use lobelia_sg::shading::{ClosedForm, Layers, LobeColumns, ShadePoint};
use lobelia_sg::{brdf::Ndf, ray::Intersect};
use lobelia_world::light::LightLobe;
use lobelia_world::light::light_frame::{LightFrame, OwnLightFrame};
use lobelia_world::material::{Diffuse, SpecularLobe, diffuse::KnownAlong};
use lobelia_world::pipeline::{Stage, pool::read_column};

const SIZE: u32 = 48;
const SPECULAR: SpecularLobe = SpecularLobe { albedo: Vec3::splat(0.3), roughness: 0.4, ndf: Ndf::Sg };

/// Center and radius of the ball that dents the other.
const DENT: (Vec3, f32) = (Vec3::new(0.0, 0.0, 1.1), 0.55);

fn dented(p: Vec3) -> f32 {
    let dent = DENT.1 - p.distance(DENT.0);
    (p.length() - 0.7).max(dent)
}

fn lobes() -> Vec<LightLobe> {
    let axes = fibonacci_axes(24).into_iter().enumerate();
    let lobe = |(i, axis)| LightLobe {
        axis,
        sharpness: spacing_sharpness(24),
        amplitude: Vec3::splat(if i % 5 == 0 { 1.5 } else { 0.1 }),
    };
    axes.map(lobe).collect()
}

/// A view of the dented ball in closed form: what the fit's own model can explain.
fn photograph(surface: &SdfSurface, camera: &Camera) -> (Photograph, StoredMask) {
    let point = |pixel: u32| {
        let ray = camera.pixel_ray(pixel);
        surface.intersect(&ray, 0.0).map_or(ShadePoint::default(), |hit| ShadePoint {
            normal: hit.normal.into(),
            to_viewer: (-ray.direction).into(),
            albedo: [0.5, 0.4, 0.3],
        })
    };
    let points: Vec<ShadePoint> = (0..SIZE * SIZE).map(point).collect();
    let columns = LobeColumns::from_lobes(lobes().iter().map(Into::into));
    let mut shaded = vec![Layers::default(); points.len()];
    ClosedForm::default().shade(&points, &kernel_specular(&SPECULAR), &columns, &mut shaded);
    let pixels = shaded.iter().map(radiance).collect();
    let coverage = points.iter().map(|p| if p.is_missed() { 0.0 } else { 1.0 }).collect();
    let image = Image { width: SIZE, height: SIZE, pixels };
    (Photograph::of_image(&image), StoredMask::new(&Mask { width: SIZE, height: SIZE, coverage }))
}

fn world_of_photographs() -> Pipeline {
    let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 64, dented);
    let volume = TexelVolume::new(&grid, 16, 0.5);
    let surface = SdfSurface { grid, volume, empty: None };
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FitPlugin);
    for (i, axis) in fibonacci_axes(32).into_iter().enumerate() {
        let up = if axis.y.abs() > 0.9 { Vec3::X } else { Vec3::Y };
        let camera = Camera::look_at(3.0 * axis, Vec3::ZERO, up, 36.0, SIZE, SIZE).unwrap();
        let (photograph, mask) = photograph(&surface, &camera);
        let name = ViewName(format!("{i}"));
        let index = ViewIndex(i as u32);
        pipeline.world.spawn((index, name, camera, Split::Train, photograph, ViewMask(mask)));
    }
    pipeline.world.spawn_batch(lobes());
    pipeline.world.spawn(SPECULAR);
    pipeline
}

/// A fit of the shape on one grid, with a light and a specular lobe that are known.
fn options(steps: u32) -> ShapeOptions {
    let schedule = ShapeSchedule {
        steps,
        hold: 40,
        rates: (0.05, 0.005),
        silhouette: 0.3,
        silhouette_batch: 512,
        smoothness: 1e-6,
        blur: 4,
        redistance_every: 40,
    };
    ShapeOptions {
        levels: vec![ShapeLevel { cells: 40, texel_cells: 12, least_pixels: 0.0, schedule }],
        fit: albedo_fit(steps),
        cameras: CameraUnknowns::Given,
        hollows: false,
        spans_unseen: false,
    }
}

fn albedo_fit(steps: u32) -> FitOptions {
    let unknowns = Unknowns {
        light: false,
        specular_albedo: false,
        mono_specular: false,
        roughness: false,
        ..Unknowns::default()
    };
    FitOptions {
        loss: Loss::L1,
        steps,
        batch: 4096,
        rates: [0.02, 0.0, 0.0],
        milestones: vec![],
        decay: 1.0,
        unknowns,
        pixels: PixelChoice { seed: 1, max_pixels: 100_000, evenly: false },
        initialize: Initialize { light: false, albedo: true, specular: false },
        scale: ScaleRule::Free,
        ..FitOptions::default()
    }
}

fn fitted(pipeline: &mut Pipeline, options: &ShapeOptions) -> SdfSurface {
    fit_shape(pipeline, options, &mut |_, _| ControlFlow::Continue(())).unwrap()
}

/// Mean distance of the true dent's points to the surface found.
fn error_in_dent(found: &SdfGrid) -> f32 {
    let points = fibonacci_axes(400).into_iter().map(|axis| DENT.0 + DENT.1 * axis);
    let inside: Vec<Vec3> = points.filter(|p| p.length() < 0.66).collect();
    inside.iter().map(|p| found.value(*p).abs()).sum::<f32>() / inside.len() as f32
}

#[test]
fn shading_carves_a_dent_that_no_silhouette_shows() {
    let error = |steps| error_in_dent(&fitted(&mut world_of_photographs(), &options(steps)).grid);
    let (hull, found) = (error(40), error(640));
    assert!(hull > 0.03 && found < 0.6 * hull, "{found} of {hull}");
}

#[test]
fn the_geometry_stands_still_when_the_fit_has_ended() {
    let mut pipeline = world_of_photographs();
    let stop_at_once = &mut |_: &ShapeProgress, _: &mut World| ControlFlow::Break(());
    fit_shape(&mut pipeline, &options(50), stop_at_once).unwrap();
    assert!(pipeline.world.get_resource::<SdfField>().is_none());
    assert!(pipeline.world.get_resource::<SilhouetteSamples>().is_none());
    // A fit of a surface that stays as it is runs as before.
    let options = FitOptions { steps: 2, ..options(2).fit };
    let summary = run_fit(&mut pipeline, &options, &mut |_, _| ControlFlow::Continue(())).unwrap();
    assert_eq!(summary.steps, 2);
}

#[test]
fn what_the_hull_loses_is_reported_with_every_step() {
    let reports = |options: ShapeOptions, half: bool| {
        let mut pipeline = world_of_photographs();
        if half {
            let mut views = pipeline.world.query::<(Entity, &Camera)>();
            let behind = views.iter(&pipeline.world).filter(|(_, camera)| camera.position().z < 0.0);
            let behind: Vec<Entity> = behind.map(|(entity, _)| entity).collect();
            behind.into_iter().for_each(|entity| assert!(pipeline.world.despawn(entity)));
        }
        let mut reports = Vec::new();
        fit_shape(&mut pipeline, &options, &mut |at, _| {
            reports.push(at.hull);
            ControlFlow::Continue(())
        })
        .unwrap();
        reports
    };
    assert_eq!(reports(options(2), true), [HullReport::default(); 2]);
    let spanning = |steps| ShapeOptions { spans_unseen: true, ..options(steps) };
    // From one side only, the hull is drawn out to the other.
    let behind = reports(spanning(2), true);
    assert!(behind[0] == behind[1] && behind[0].opened == 0.0 && behind[0].spanned > 0.01, "{behind:?}");
    assert_eq!(reports(spanning(1), false), [HullReport::default()]);
}

#[test]
fn a_level_finer_than_the_pictures_is_left_out() {
    let side = |least_pixels: f32| {
        let mut options = options(2);
        options.levels.push(ShapeLevel { cells: 60, least_pixels, ..options.levels[0] });
        let (mut pipeline, mut levels) = (world_of_photographs(), Vec::new());
        let found = fit_shape(&mut pipeline, &options, &mut |at, _| {
            levels.push(at.levels);
            ControlFlow::Continue(())
        });
        // What will be fitted is known from the first step on.
        let side = found.unwrap().grid.side;
        let fitted = if side > 60 { 2 } else { 1 };
        assert_eq!(levels, vec![fitted; 2 * fitted]);
        side
    };
    // A cell of the second level is 0.6 pixels wide.
    assert!(side(0.4) > 60 && side(0.9) < 60, "{} {}", side(0.4), side(0.9));
}

/// Steps in which a gradient of the field is NaN.
fn poison(rates: Res<StepRates>, field: Option<ResMut<SdfField>>) {
    if let (50..54, Some(mut field)) = (rates.step, field) {
        let near = field.surface.grid.values.iter().position(|value| value.abs() < 0.02).unwrap();
        field.adjoint.value[near] = f32::NAN;
    }
}

#[test]
fn a_step_of_a_field_that_is_not_finite_is_taken_back() {
    let mut pipeline = world_of_photographs();
    let between = poison.after(pull_back_silhouettes).before(smooth_gradient);
    pipeline.add_systems(Phase::FitStep, Stage::Gradient, between);
    let mut values = Vec::new();
    let found = fit_shape(&mut pipeline, &options(60), &mut |_, world| {
        values.push(world.resource::<SdfField>().surface.grid.values.clone());
        ControlFlow::Continue(())
    });
    assert!(found.unwrap().grid.values.iter().all(|value| value.is_finite()));
    assert!(values[48] == values[52] && values[47] != values[48] && values[53] != values[52]);
    let guard = pipeline.world.resource::<StepGuard>();
    let first = guard.first.clone().unwrap();
    assert_eq!(guard.taken_back, 4);
    assert!(first.starts_with("step 50: the gradient is not finite, by the field near ("), "{first}");
}

#[test]
fn texels_that_are_replaced_keep_a_known_albedo_along_the_surface() {
    let mut pipeline = world_of_photographs();
    let along = Vec3::new(0.7, 0.3, 0.1);
    pipeline.world.insert_resource(KnownAlong::Everywhere(along));
    let found = fitted(&mut pipeline, &options(42));
    let texels = read_column::<TexelIndex, Diffuse>(&mut pipeline.world).unwrap();
    assert_eq!(texels.len(), found.volume.len());
    assert!(texels.iter().all(|texel| texel.along().abs_diff_eq(along, 1e-6)));
    assert!(texels.iter().any(|texel| texel.albedo.distance(texels[0].albedo) > 0.01));
}

#[test]
fn hollows_are_looked_for_only_where_the_light_stands_still() {
    let mut world = World::new();
    assert!(!light_turns(&world));
    for (frame, turns) in [(LightFrame::Camera, true), (LightFrame::World, false)] {
        world.insert_resource(OwnLightFrame(frame));
        assert_eq!(light_turns(&world), turns);
    }
    world.insert_resource(ObjectTurned);
    assert!(light_turns(&world));
}
