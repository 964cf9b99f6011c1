//! Lens models: known values, inverses, derivatives, undistortion of pictures, and impossible parameters.

use crate::dataset::colmap_model::distortion_of;
use crate::dataset::distortion::{Distortion, Projection, Unseen};
use crate::dataset::lens::{Focal, Lens, crop_note};
use crate::dataset::straighten::{Straightening, on_plane};
use crate::view::{Camera, Image};
use glam::{Affine3A, DVec2, Vec3};
use proptest::prelude::*;

const BENT: Distortion =
    Distortion { radial: [-0.12, 0.03, 0.0, 0.0, 0.0, 0.0], tangential: [0.004, -0.003], ..Distortion::NONE };

/// One lens of every kind, with moderate coefficients.
fn lenses() -> Vec<Distortion> {
    let projected = |projection| Distortion { projection, ..Distortion::NONE };
    let fisheye = Distortion::fisheye([-0.03, 0.01, -0.004, 0.0006]);
    vec![
        Distortion::NONE,
        BENT,
        Distortion { divisor: [0.2, -0.05, 0.01], radial: [0.25, 0.1, -0.02, 0.0, 0.0, 0.0], ..BENT },
        Distortion { radial: [-0.1, 0.02, -0.003, 0.0004, 0.0, 0.0], ..BENT },
        projected(Projection::Equidistant),
        fisheye,
        Distortion { tangential: [0.002, -0.001], prism: [0.003, 0.0, -0.002, 0.0], ..fisheye },
        Distortion {
            radial: [-0.03, 0.01, -0.004, 0.0006, -0.0002, 0.00001],
            tangential: [0.002, -0.001],
            prism: [0.003, -0.001, -0.002, 0.0005],
            shifts_scaled: true,
            ..fisheye
        },
        projected(Projection::Fov(0.9)),
        projected(Projection::Fov(-0.9)),
        projected(Projection::Fov(1e-5)),
        projected(Projection::Fov(0.0)),
        projected(Projection::Division(-0.2)),
        projected(Projection::Division(0.08)),
        projected(Projection::Unified { alpha: 0.6, beta: 1.2 }),
        projected(Projection::Unified { alpha: 0.3, beta: 0.9 }),
    ]
}

proptest! {
    #[test]
    fn undistorting_undoes(x in -1.2f64..1.2, y in -1.2f64..1.2) {
        let p = DVec2::new(x, y);
        for lens in lenses() {
            let back = lens.undistort(lens.distort(p));
            prop_assert!(back.is_ok_and(|back| back.distance(p) < 1e-8), "{lens}: {back:?} {p}");
        }
    }

    #[test]
    fn fisheye_lenses_are_undone_far_out(angle in 0.0f64..1.5, around in 0.0f64..6.2) {
        let p = DVec2::from_angle(around) * angle.tan();
        for lens in lenses().into_iter().filter(|lens| lens.projection == Projection::Equidistant) {
            let back = lens.undistort(lens.distort(p));
            prop_assert!(back.is_ok_and(|back| back.distance(p) < 1e-8 * (1.0 + p.length_squared())), "{lens}: {back:?} {p}");
        }
    }

    /// Newton's steps are exact: the image of a shifted point differs by the derivative, to second order.
    #[test]
    fn images_move_as_the_inverse_says(x in -1.1f64..1.1, y in -1.1f64..1.1) {
        let (p, h) = (DVec2::new(x, y), 1e-5);
        for lens in lenses() {
            for axis in [DVec2::X, DVec2::Y] {
                let slope = (lens.distort(p + axis * h) - lens.distort(p - axis * h)) / (2.0 * h);
                let error = lens.derivative(p) * axis - slope;
                prop_assert!(error.length() < 1e-8, "{lens} at {p}: {error}");
            }
        }
    }
}

/// Values by the formulas of COLMAP's `sensor/models` and OpenCV's `calib3d`, written out term by term in another language.
#[test]
fn known_values() {
    let p = DVec2::new(0.4, -0.3);
    let expect = |lens: Distortion, x: f64, y: f64| {
        let found = lens.distort(p);
        assert!(found.distance(DVec2::new(x, y)) < 1e-12, "{lens}: {found:?}");
    };
    let colmap = |model, coefficients: &[f64]| distortion_of(model, coefficients).unwrap();
    expect(Distortion::brown_conrady([-0.2, 0.05, -0.01], [0.003, -0.002]), 0.3793275, -0.284120625);
    expect(
        Distortion {
            divisor: [0.1, -0.03, 0.02],
            ..Distortion::brown_conrady([-0.2, 0.05, -0.01], [0.003, -0.002])
        },
        0.3705980152671757,
        -0.2775735114503817,
    );
    expect(Distortion::fisheye([0.05, -0.01, 0.002, -0.0003]), 0.3747406078916136, -0.2810554559187101);
    expect(
        colmap("THIN_PRISM_FISHEYE", &[0.05, -0.01, 0.003, -0.002, 0.002, -0.0003, 0.004, -0.001]),
        0.3740011141692709,
        -0.2797484437582906,
    );
    expect(
        colmap(
            "RAD_TAN_THIN_PRISM_FISHEYE",
            &[0.05, -0.01, 0.002, -0.0003, 0.0001, -0.00002, 0.003, -0.002, 0.004, -0.001, 0.0005, 0.0007],
        ),
        0.3774923116608145,
        -0.2822988058934741,
    );
    expect(colmap("FOV", &[0.9]), 0.4, -0.3);
    expect(colmap("DIVISION", &[-0.15]), 0.3860294905405911, -0.2895221179054433);
    expect(colmap("EUCM", &[0.6, 1.2]), 0.368967863713614, -0.2767258977852105);
}

#[test]
fn lenses_reduce_to_each_other() {
    let p = DVec2::new(0.31, -0.47);
    let close = |a: Distortion, b: Distortion, tolerance: f64| {
        let (a, b) = (a.distort(p), b.distort(p));
        assert!(a.distance(b) < tolerance, "{a} {b}");
    };
    let projected = |projection| Distortion { projection, ..Distortion::NONE };
    close(projected(Projection::Fov(0.0)), projected(Projection::Fov(1e-7)), 1e-13);
    close(projected(Projection::Division(0.0)), Distortion::NONE, 1e-15);
    close(projected(Projection::Unified { alpha: 0.0, beta: 1.0 }), Distortion::NONE, 1e-15);
    close(Distortion::fisheye([0.0; 4]), projected(Projection::Equidistant), 1e-15);
    close(Distortion::brown_conrady([-0.12, 0.03, 0.0], [0.004, -0.003]), BENT, 1e-15);
    assert_eq!(Distortion::brown_conrady([0.0; 3], [0.0; 2]), Distortion::NONE);
    // Small distortions of the division model are those of one radial coefficient.
    close(projected(Projection::Division(1e-5)), Distortion::brown_conrady([1e-5, 0.0, 0.0], [0.0; 2]), 1e-9);
}

#[test]
fn rays_to_the_side_and_behind_have_no_point_on_the_plane() {
    let at = |lens: Distortion, r: f64| lens.undistort(DVec2::new(0.0, r));
    let fisheye = Distortion::fisheye([0.0; 4]);
    assert!((at(fisheye, 1.5).unwrap().y - 1.5f64.tan()).abs() < 1e-9);
    assert_eq!(at(fisheye, 1.58), Err(Unseen::Behind));
    // The polynomial ends at 1.3 rad, as calibrations of image circles do.
    let k1 = -1.0 / (3.0 * 1.3 * 1.3);
    assert_eq!(at(Distortion::fisheye([k1, 0.0, 0.0, 0.0]), 1.0), Err(Unseen::Behind));
    // At 0.5 rad it is wrong.
    let k1 = -1.0 / (3.0 * 0.5 * 0.5);
    assert_eq!(at(Distortion::fisheye([k1, 0.0, 0.0, 0.0]), 1.0), Err(Unseen::Folded));
    let projected = |projection| Distortion { projection, ..Distortion::NONE };
    assert_eq!(at(projected(Projection::Fov(1.0)), 1.6), Err(Unseen::Behind));
    assert_eq!(at(projected(Projection::Division(-1.0)), 1.1), Err(Unseen::Behind));
    assert_eq!(at(projected(Projection::Division(1.0)), 1.1), Err(Unseen::Folded));
    assert_eq!(at(projected(Projection::Unified { alpha: 0.6, beta: 1.0 }), 1.7), Err(Unseen::Behind));
    assert_eq!(at(projected(Projection::Unified { alpha: 0.6, beta: 1.0 }), 9.0), Err(Unseen::Behind));
}

/// Of a picture of 80×60 pixels.
fn camera() -> Camera {
    Camera {
        width: 80,
        height: 60,
        focal: [70.0, 72.0],
        center: [41.0, 29.5],
        skew: 0.0,
        world_from_camera: Affine3A::IDENTITY,
        pixel_center: 0.5,
    }
}

/// A smooth picture over the image plane.
fn picture(p: DVec2) -> f32 {
    (0.5 + 0.3 * (6.0 * p.x).sin() * (5.0 * p.y).cos()) as f32
}

/// Photographs [`picture`] through a lens, straightens it, and compares with what the pinhole sees.
fn straightened(lens: Distortion, bent: Camera) -> Straightening {
    let (width, height) = (bent.width, bent.height);
    let pixels = (0..width * height).map(|i| {
        let p = lens.undistort(on_plane(&bent, f64::from(i % width), f64::from(i / width)));
        Vec3::splat(p.map_or(9.0, picture))
    });
    let photograph = Image { width, height, pixels: pixels.collect() };
    let way = Straightening::new(lens, &bent).unwrap();
    let straight = way.image(&photograph);
    // Where pixels are coarse compared with the picture, interpolation is not exact.
    let tolerance = 0.25 * 36.0 / bent.focal[0].powi(2);
    for (i, pixel) in straight.pixels.iter().enumerate() {
        let (x, y) = (i as u32 % straight.width, i as u32 / straight.width);
        let direction = way.camera.ray(x as f32 + 0.5, y as f32 + 0.5).direction.as_dvec3();
        let expected = picture(direction.truncate() / direction.z);
        let slack = tolerance * (1.0 + (direction.truncate() / direction.z).length_squared() as f32).powi(2);
        assert!((pixel.x - expected).abs() < slack, "{lens} ({x}, {y}): {} {expected}", pixel.x);
    }
    way
}

#[test]
fn a_bent_photograph_becomes_what_the_pinhole_sees() {
    for k1 in [-0.12, 0.15] {
        let lens = Distortion::brown_conrady([k1, 0.03, 0.0], BENT.tangential);
        let way = straightened(lens, camera());
        assert_eq!(k1 < 0.0, way.camera.width > 80, "barrels grow, pincushions shrink: {}", way.camera.width);
        assert!(!way.is_cropped);
    }
    for lens in lenses() {
        let way = straightened(lens, camera());
        assert!(
            way.camera.width >= 60 && way.camera.width <= 120 && !way.is_cropped,
            "{lens}: {}",
            way.camera.width
        );
    }
}

/// Fields of view of 120°, 180° and 220° over a frame of 120×90 pixels, corners beyond it.
#[test]
fn wide_fisheye_photographs_are_cropped_to_what_a_pinhole_shows() {
    for (degrees, is_cropped) in [(90.0f32, false), (150.0, true), (180.0, true), (220.0, true)] {
        let focal = [120.0 / degrees.to_radians(); 2];
        let bent = Camera { width: 120, height: 90, focal, center: [60.0, 45.0], ..camera() };
        let way = Straightening::new(Distortion::fisheye([0.0; 4]), &bent).unwrap();
        assert_eq!(way.is_cropped, is_cropped, "{degrees}");
        let [width, height] = way.field_degrees();
        assert!(width > 60.0 && width < 160.0 && height > 60.0, "{degrees}: {width} {height}");
        assert!(way.camera.width <= 240 && way.camera.height <= 180);
        let lens = Lens {
            size: Some([120, 90]),
            focal_x: Focal::Pixels(f64::from(focal[0])),
            focal_y: None,
            center: [None; 2],
            skew: 0.0,
            distortion: Distortion::fisheye([0.0; 4]),
            resizable: false,
            by_side: false,
        };
        let note = crop_note([lens, lens].iter());
        assert_eq!(note.is_some(), is_cropped, "{note:?}");
        assert!(note.is_none_or(|note| note.contains("2 photographs") && note.contains("cropped to")));
    }
    straightened(
        Distortion::fisheye([0.01, 0.0, 0.0, 0.0]),
        Camera { width: 160, height: 120, focal: [60.0; 2], center: [82.0, 60.0], ..camera() },
    );
}

/// A barrel whose polynomial ends just before the corners: the rectangle lies inside.
#[test]
fn folds_in_the_corners_are_left_out() {
    let bent = Camera { focal: [60.0; 2], center: [40.0, 30.0], ..camera() };
    let lens = Distortion::brown_conrady([-0.24, 0.0, 0.0], [0.0; 2]);
    assert_eq!(lens.undistort(on_plane(&bent, 0.0, 0.0)), Err(Unseen::Folded));
    let way = straightened(lens, bent);
    assert!(way.camera.width >= 80 && way.camera.height >= 60, "{:?}", way.camera);
}

#[test]
fn no_distortion_changes_nothing() {
    let way = Straightening::new(Distortion::NONE, &camera()).unwrap();
    assert_eq!((way.camera, way.is_cropped), (camera(), false));
    let flags: Vec<bool> = (0..80 * 60).map(|i| i % 7 == 0).collect();
    assert_eq!(way.flags(&flags), flags);
}

#[test]
fn folding_coefficients_are_refused() {
    let wrong = |radial| {
        let lens = Distortion::brown_conrady(radial, [0.0; 2]);
        Straightening::new(lens, &camera()).map(|way| way.camera).unwrap_err()
    };
    assert_eq!(wrong([-3.0, 0.0, 0.0]), "the lens distortion (Pinhole, radial [-3.0]) folds the image over");
    assert!(wrong([f64::NAN, 0.0, 0.0]).contains("folds"));
    assert!(wrong([-30.0, 400.0, 0.0]).contains("folds"), "it unfolds again farther out");
    assert!(wrong([400.0, 0.0, 0.0]).contains("leaves"));
    let fisheye = Distortion::fisheye([-3.0, 0.0, 0.0, 0.0]);
    assert!(Straightening::new(fisheye, &camera()).is_err_and(|problem| problem.contains("Equidistant")));
}

#[test]
fn impossible_parameters_are_named() {
    let wrong = |lens: Distortion| lens.check().unwrap_err();
    assert_eq!(
        wrong(Distortion::fisheye([0.0, f64::NAN, 0.0, 0.0])),
        "a coefficient of the lens distortion is NaN"
    );
    let projected = |projection| wrong(Distortion { projection, ..Distortion::NONE });
    assert!(projected(Projection::Fov(f64::INFINITY)).contains("is inf"));
    assert!(projected(Projection::Fov(3.2)).contains("ω is 3.2 radians"));
    assert!(projected(Projection::Unified { alpha: 1.1, beta: 1.0 }).contains("α is 1.1"));
    assert!(projected(Projection::Unified { alpha: 0.5, beta: 0.0 }).contains("β 0"));
    assert!(lenses().iter().all(|lens| lens.check().is_ok()));
}

#[test]
fn focal_lengths_and_principal_points_have_bounds() {
    let good = Lens {
        size: Some([80, 60]),
        focal_x: Focal::Pixels(70.0),
        focal_y: None,
        center: [None; 2],
        skew: 0.0,
        distortion: Distortion::NONE,
        resizable: false,
        by_side: false,
    };
    let camera = |lens: Lens| lens.camera([80, 60], Affine3A::IDENTITY, 0.5);
    assert_eq!(camera(good).unwrap().focal, [70.0; 2]);
    let focal = |pixels: f64| camera(Lens { focal_x: Focal::Pixels(pixels), ..good });
    for pixels in [1e-40, 1e30, 0.3, 900_000.0] {
        let problem = focal(pixels).unwrap_err();
        assert!(problem.contains("must lie between 0.4 and 800000"), "{problem}");
    }
    for pixels in [0.0, -8.0, f64::NAN, f64::INFINITY] {
        assert!(focal(pixels).unwrap_err().contains("it must be above 0"));
    }
    assert!(focal(0.5).is_ok() && focal(700_000.0).is_ok());
    let second = Lens { focal_y: Some(Focal::Pixels(1e-40)), ..good };
    assert!(camera(second).unwrap_err().contains("1e-40"));
    let angle = |radians| camera(Lens { focal_x: Focal::Angle(radians), ..good });
    assert!(angle(std::f64::consts::PI).unwrap_err().contains("must lie between"));
    assert!(angle(1e-9).unwrap_err().contains("must lie between"));
    let center = |x| camera(Lens { center: [Some(x), None], ..good });
    assert!(center(-700.0).is_ok() && center(800.0).is_ok());
    for x in [-900.0, 1e30, f64::NAN] {
        let problem = center(x).unwrap_err();
        assert!(
            problem.contains("the principal point is (") && problem.contains("10 image sizes"),
            "{problem}"
        );
    }
    assert!(camera(Lens { skew: f64::NAN, ..good }).unwrap_err().contains("skew"));
    let lens = Lens { distortion: Distortion::fisheye([f64::NAN; 4]), ..good };
    assert!(camera(lens).unwrap_err().contains("lens distortion is NaN"));
}
