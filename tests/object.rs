//! The façade: photographs in memory, an object found from them, shown in other ways, kept and opened
//! again, all without a scene file.

use lobelia::{codec::gltf::import::read_mesh, prelude::*};
use std::ops::ControlFlow;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU32, Ordering};

const SIZE: u32 = 40;

/// An object of two colors under two lamps.
fn truth() -> Object {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("truth.ron");
    let text = r#"(version: 1, surface: Sphere(texture_size: 48), views: Cameras([(name: "a", eye: (0, 0, 3))]),
        light: Fixed(Lobes(lobes: [(axis: (0.6, 0.6, 0.5), sharpness: 12, amplitude: (3, 3, 3)),
            (axis: (0, 1, 0), sharpness: 0.5, amplitude: (0.5, 0.5, 0.6))])),
        material: (albedo: Fixed(Constant(0.5, 0.3, 0.2)), sheen: None, tilt: None, gloss: One,
            specular: (albedo: Fixed(0.1, 0.1, 0.1), roughness: Fixed(0.4))))"#;
    std::fs::write(&path, text).unwrap();
    Object::open(&path).unwrap()
}

static CAPTURE: LazyLock<Capture> = LazyLock::new(|| {
    let mut truth = truth();
    let cameras = Camera::around(16, 2.8, 38.0, SIZE).unwrap().into_iter().enumerate();
    let view = |(i, camera): (usize, Camera)| {
        let frame = truth.render(camera).unwrap();
        ViewRecord::of_camera(format!("{i:02}"), Split::Train, camera).with_frame(frame)
    };
    Capture::from(cameras.map(view).collect::<Vec<_>>()).hold_out(8)
});

fn options() -> ReconstructOptions {
    let fit = FitPass { steps: 150, batch: 1024, ..FitPass::default() };
    ReconstructOptions { texture_size: 48, lobes: 24, fit: Some(fit), ..ReconstructOptions::default() }
}

fn found(options: &ReconstructOptions) -> Object {
    Object::fit(&sphere_mesh(Vec3::ZERO, 0.8).unwrap(), &CAPTURE.train(), options).unwrap()
}

/// The mean absolute difference of colors.
fn apart(a: &Frame, b: &Frame) -> f32 {
    let sum: f32 = a.color.iter().zip(&b.color).map(|(a, b)| (*a - *b).abs().element_sum()).sum();
    sum / (3 * a.color.len()) as f32
}

#[test]
fn an_object_found_from_photographs_in_memory_is_shown_kept_and_opened_again() {
    let test = CAPTURE.test();
    assert_eq!((CAPTURE.train().len(), test.len()), (14, 2));
    let camera = test[0].camera;
    let mut object = found(&options());
    let frame = object.render(camera).unwrap();
    let photograph = test[0].photograph.as_ref().unwrap().image().pixels;
    let truth = Frame { color: photograph, ..frame.clone() };
    assert!(apart(&frame, &truth) < 0.01, "{}", apart(&frame, &truth));

    let gold = || [Edit::metal("#d4af37", 0.2).unwrap()];
    // Another light and an edit leave what was found.
    let below =
        Light::of_lobes(vec![LightLobe { axis: Vec3::NEG_Y, sharpness: 12.0, amplitude: Vec3::splat(3.0) }]);
    let night = object.relit(&below).render(camera).unwrap();
    let golden = object.edited(gold()).render(camera).unwrap();
    let both = object.relit(&below).edited(gold()).render(camera).unwrap();
    for other in [&night, &golden, &both] {
        assert!(apart(&frame, other) > 0.01, "{}", apart(&frame, other));
    }
    assert!(apart(&golden, &both) > 0.01, "a light after another appearance is gone");
    assert_eq!(object.render(camera).unwrap(), frame);

    let folder = tempfile::tempdir().unwrap();
    object.save(folder.path()).unwrap();
    let mut again = Object::open(folder.path().join("scene.ron")).unwrap();
    assert_eq!(again.render(camera).unwrap(), frame);
    let mesh = folder.path().join("gold.glb");
    object.edited(gold()).export(&mesh).unwrap();
    assert_eq!(read_mesh(&mesh).unwrap().triangles.len(), object.surface().mesh().triangles.len());
    object.edited(gold()).save(folder.path().join("gold")).unwrap();
    let mut again = Object::open(folder.path().join("gold/scene.ron")).unwrap();
    assert_eq!(again.render(camera).unwrap(), golden);
}

#[test]
fn a_callback_sees_each_step_and_may_end_the_fit() {
    static LAST: AtomicU32 = AtomicU32::new(0);
    let watch = |at: &Step| {
        LAST.store(at.step, Ordering::Relaxed);
        if at.step == 30 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let mut object = found(&ReconstructOptions { progress: Arc::new(watch), ..options() });
    assert_eq!(LAST.load(Ordering::Relaxed), 30);
    assert!(object.render(CAPTURE[0].camera).unwrap().color.iter().any(|color| color.x > 0.05));
}

#[test]
fn a_request_to_stop_is_of_what_is_done_under_it_and_a_callback_of_one_object() {
    let stops_at = |last: u32| {
        let watch =
            move |at: &Step| if at.step < last { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
        ReconstructOptions { progress: Arc::new(watch), ..options() }
    };
    let steps = |object: &mut Object| {
        let log =
            object.pipeline().world.query::<&SpecularLobe>().iter(&object.pipeline().world).next().copied();
        (log, object.scores().fit_secs.is_some())
    };
    // The second object with the same options is stopped as the first was.
    let options = stops_at(20);
    let (mut first, mut second) = (found(&options), found(&options));
    assert_eq!(steps(&mut first), steps(&mut second));
    assert_ne!(steps(&mut first), steps(&mut found(&stops_at(1000))));
    options.stop.ask();
    let error =
        Object::fit(&sphere_mesh(Vec3::ZERO, 0.8).unwrap(), &CAPTURE.train(), &options).err().unwrap();
    assert!(matches!(error, Error::Interrupted), "{error}");
    found(&stops_at(5));
}

#[test]
fn an_unknown_surface_is_found() {
    let level = lobelia::scene::GridLevel { cells: 32, texel_cells: 16, steps: 30, ..Default::default() };
    let shape =
        ShapePass { levels: vec![level], stereo: false, normals: false, batch: 1024, ..Default::default() };
    let options = ReconstructOptions { shape: Some(shape), ..options() };
    let mut object = Object::reconstruct(&CAPTURE.train(), &options).unwrap();
    let surface = object.surface();
    let radii: Vec<f32> = surface.mesh().positions.iter().map(|at| at.length()).collect();
    let mean = radii.iter().sum::<f32>() / radii.len() as f32;
    assert!((mean - 0.8).abs() < 0.05, "{mean}");
    assert!(object.render(CAPTURE[0].camera).unwrap().alpha.contains(&1.0));
}

#[test]
fn what_cannot_work_is_one_clear_error() {
    let error = Capture::read("no/such/folder").unwrap_err();
    assert!(error.to_string().contains("no/such/folder") && error.help().is_some(), "{error}");
    let mut object = truth();
    let error = object.export("object.stl").unwrap_err();
    assert!(error.to_string().contains("object.stl") && error.help().unwrap().contains(".glb"), "{error}");
    assert!(Edit::metal("gold", 0.2).unwrap_err().help().unwrap().contains("#rrggbb"));
    let camera = CAPTURE[0].camera;
    let none = RenderSettings { samples_per_pixel: 0, ..RenderSettings::default() };
    let error = object.shown().rendered_by(none).render(camera).unwrap_err();
    assert!(error.to_string().contains("samples_per_pixel"), "{error}");
    let error = object.edited([Edit::metal("#d4af37", f32::NAN).unwrap()]).render(camera).unwrap_err();
    assert!(error.to_string().contains("edits.2.action"), "{error}");
    assert!(object.render(camera).is_ok());
    let wrong =
        |options: ReconstructOptions| Object::reconstruct(&CAPTURE, &options).err().unwrap().to_string();
    let error = wrong(ReconstructOptions { texture_size: 4, ..options() });
    assert!(error.contains("texture_size"), "{error}");
    let shape = Some(ShapePass { levels: Vec::new(), ..ShapePass::default() });
    let error = wrong(ReconstructOptions { shape, ..options() });
    assert!(error.contains("levels"), "{error}");
    let cameras = |view: &ViewRecord| ViewRecord { mask: None, ..view.clone() };
    let bare = Capture::from(CAPTURE.iter().map(cameras).collect::<Vec<_>>());
    let error = Object::reconstruct(&bare, &options()).err().unwrap();
    assert!(error.to_string().contains("mask"), "{error}");
}
