use super::choice::Windows;
use super::views::SharedViews;
use super::*;
use crate::material::TexelIndex;
use crate::math::ray::{Hit, TexelAddress};
use crate::pipeline::Stage;
use crate::view::{Image, Mask, Split, StoredMask};
use glam::{Affine3A, Vec2};

#[test]
fn broken_pixels_of_one_photograph_are_not_fitted_to() {
    let mut world = World::new();
    for view in 0..5 {
        let mut pixels = vec![Vec3::splat(0.5); 16];
        // A highlight that all have, and one broken pixel.
        pixels[3] = Vec3::splat(30.0);
        if view == 2 {
            pixels[7] = Vec3::new(0.1, 1e5, 0.1);
        }
        let photograph = Photograph::of_image(&Image { width: 4, height: 4, pixels });
        let camera = Camera::look_at(Vec3::Z, Vec3::ZERO, Vec3::Y, 40.0, 4, 4).unwrap();
        world.spawn((ViewIndex(view), camera, photograph, Split::Train));
    }
    let counts: Vec<usize> =
        usable_by_view(&mut world).unwrap().into_iter().map(|view| view.pixels).collect();
    assert_eq!(counts, [16, 16, 15, 16, 16]);
    let pixels = usable_pixels(&mut world, ViewIndex(2), 1);
    assert!(pixels.iter().all(|of| of.pixel.pixel != 7) && pixels.iter().any(|of| of.pixel.pixel == 3));
}

/// All that is beyond z = 1.
struct Wall;

impl Intersect for Wall {
    fn intersect(&self, ray: &Ray, _: f32) -> Option<Hit> {
        let distance = (1.0 - ray.origin.z) / ray.direction.z;
        let normal = Vec3::NEG_Z;
        (distance > 0.0).then(|| Hit {
            distance,
            position: ray.origin + distance * ray.direction,
            normal,
            geometric_normal: normal,
            uv: glam::Vec2::ZERO,
            texels: TexelAddress { weights: [0.25; 4], ..TexelAddress::default() },
        })
    }

    fn occluded(&self, ray: &Ray, _: f32, _: f32) -> bool {
        ray.direction.z > 0.0
    }
}

#[test]
fn a_pool_is_made_once_for_the_same_pixels_cameras_and_surface() {
    let mut pipeline = Pipeline::new();
    let world = &mut pipeline.world;
    let camera = Camera::look_at(Vec3::ZERO, Vec3::Z, Vec3::Y, 40.0, 4, 4).unwrap();
    let gray = Photograph::of_image(&Image { width: 4, height: 4, pixels: vec![Vec3::splat(0.5); 16] });
    let view = world.spawn((ViewIndex(0), camera, gray, Split::Train)).id();
    world.insert_resource(Scenery(Arc::new(Wall)));
    world.insert_resource(PixelChoice { seed: 1, max_pixels: 10, evenly: false });
    world.spawn((TexelIndex(0), TexelSeen(0.0)));
    world.init_resource::<Candidates>();
    world.init_resource::<ObservedWindow>();
    pipeline.add_systems(Phase::Prepare, Stage::Sample, choose_pixels);
    pipeline.add_systems(Phase::Prepare, Stage::Trace, trace_pixels);
    pipeline.add_systems(Phase::Prepare, Stage::Gather, count_seen_texels);
    assert_eq!(make_pool(&mut pipeline).unwrap(), 10);
    let seen = |world: &mut World| world.query::<&TexelSeen>().single(world).map(|seen| seen.0).unwrap();
    assert_eq!(seen(&mut pipeline.world), 10.0);
    // A step narrows the window, and the next part of the fit begins with all, and with texels that nobody has seen.
    pipeline.world.resource_mut::<ObservedWindow>().0 = 3..5;
    pipeline.world.query::<&mut TexelSeen>().single_mut(&mut pipeline.world).unwrap().0 = 0.0;
    assert_eq!(make_pool(&mut pipeline).unwrap(), 10);
    assert_eq!(pipeline.world.resource::<ObservedWindow>().0, 0..10);
    assert_eq!(seen(&mut pipeline.world), 10.0);
    let turned = Camera::look_at(Vec3::ZERO, Vec3::Z, Vec3::X, 40.0, 4, 4).unwrap();
    pipeline.world.entity_mut(view).insert(turned);
    assert!(!pool_holds(&mut pipeline.world));
    assert_eq!(make_pool(&mut pipeline).unwrap(), 10);
    assert!(pool_holds(&mut pipeline.world));
    pipeline.world.insert_resource(Scenery(Arc::new(Wall)));
    assert!(!pool_holds(&mut pipeline.world));
    pipeline.world.insert_resource(PixelChoice { seed: 1, max_pixels: 12, evenly: false });
    assert_eq!(make_pool(&mut pipeline).unwrap(), 12);
    release_pool(&mut pipeline.world);
    assert!(!pool_holds(&mut pipeline.world));
    assert_eq!(pipeline.world.query::<&ObservationIndex>().iter(&pipeline.world).len(), 0);
}

const SIDE: u32 = 1200;

/// A view of which a disc is covered; its pixels left of the middle are saturated.
fn view() -> (Camera, Photograph, StoredMask) {
    let count = (SIDE * SIDE) as usize;
    let at = |i: usize| Vec3::new((i % SIDE as usize) as f32, (i / SIDE as usize) as f32, 0.0);
    let inside = |i: usize| at(i).distance(Vec3::new(700.0, 500.0, 0.0)) < 400.0;
    let image = Image { width: SIDE, height: SIDE, pixels: (0..count).map(|i| at(i) / 1200.0).collect() };
    let saturated: Vec<bool> = (0..count).map(|i| i % (SIDE as usize) < 600).collect();
    let coverage = (0..count).map(|i| if inside(i) { 1.0 } else { 0.0 }).collect();
    let mask = StoredMask::new(&Mask { width: SIDE, height: SIDE, coverage });
    let photograph = Photograph::new(&image, &saturated, mask.window(), true).unwrap();
    let camera = Camera {
        width: SIDE,
        height: SIDE,
        focal: [1000.0; 2],
        center: [600.0; 2],
        skew: 0.0,
        world_from_camera: Affine3A::IDENTITY,
        pixel_center: 0.5,
    };
    (camera, photograph, mask)
}

#[test]
fn scattered_pixels_are_usable_and_each_view_has_its_share() {
    let (camera, photograph, mask) = view();
    let of_index = |index: u32| ObservedView {
        index: ViewIndex(index),
        camera: &camera,
        photograph: &photograph,
        mask: Some(&mask),
        limit: f32::MAX,
    };
    let views = SharedViews::new((0..20).map(of_index).collect(), None, |_| None);
    let choice = PixelChoice { seed: 3, max_pixels: 50_000, evenly: false };
    let chosen = Windows::new(&views, false).scattered(choice).unwrap().unwrap();
    assert!((49_000..=50_000).contains(&chosen.len()), "{}", chosen.len());
    let distinct: std::collections::BTreeSet<(u32, u32)> =
        chosen.iter().map(|c| (c.pixel.view.0, c.pixel.pixel)).collect();
    assert_eq!(distinct.len(), chosen.len());
    let mut shares = [0; 20];
    for c in &chosen {
        assert!(views.items[0].is_usable(c.pixel.pixel as usize));
        assert_eq!(c.observed.radiance, photograph.radiance(c.pixel.pixel as usize));
        shares[c.pixel.view.0 as usize] += 1;
    }
    assert!(shares.iter().all(|share| (2350..2650).contains(share)), "{shares:?}");
    // As often below as above the middle of the disc.
    let below = chosen.iter().filter(|c| c.pixel.pixel / SIDE > 500).count() as f64 / chosen.len() as f64;
    assert!((below - 0.5).abs() < 0.01, "{below}");
    let one = views.filtered(|view| view.index == ViewIndex(0));
    assert!(Windows::new(&one, false).scattered(choice).unwrap().is_none(), "few enough to look at all");
}

#[test]
fn gradients_are_those_of_the_picture_where_its_neighbors_are_usable() {
    let (camera, photograph, mask) = view();
    let view = ObservedView {
        index: ViewIndex(0),
        camera: &camera,
        photograph: &photograph,
        mask: Some(&mask),
        limit: f32::MAX,
    };
    let at = |x: u32, y: u32| view.candidate((y * SIDE + x) as usize, true).gradient.0;
    // The mean of three channels is (x + y) / 3600, as half floats.
    let found = at(800, 500).unwrap();
    assert!((found * 3600.0 - Vec2::ONE).abs().max_element() < 0.3, "{found}");
    assert_eq!([at(601, 500).is_some(), at(600, 500).is_some()], [true, false], "beside saturated pixels");
    let edge = (0..SIDE).rfind(|x| mask.coverage((500 * SIDE + x) as usize) > 0.0).unwrap();
    assert_eq!(
        [at(edge - 1, 500).is_some(), at(edge, 500).is_some()],
        [true, false],
        "at the edge of the mask"
    );
    assert_eq!(view.candidate((500 * SIDE + 800) as usize, false).gradient, ImageGradient(None));
}
