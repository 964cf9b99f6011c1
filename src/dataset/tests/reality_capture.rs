//! RealityCapture's layout.

use super::*;
use glam::Quat;

const HEADER: &str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2";

/// A folder with the photographs `a.jpg` and `b.jpg`, masks, and this text as its CSV file.
fn set(lines: &[&str]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for name in ["a", "b"] {
        write_photograph(&dir.path().join(format!("images/{name}.jpg")), 1);
        write_mask(&dir.path().join(format!("masks/{name}_mask.png")));
    }
    write(&dir, lines);
    dir
}

fn write(dir: &TempDir, lines: &[&str]) {
    fs::write(dir.path().join("cameras.csv"), lines.join("\r\n")).unwrap();
}

/// Right, down and forward of the only camera with these angles in degrees.
fn axes(heading: f32, pitch: f32, roll: f32) -> [Vec3; 3] {
    let row = format!("a.jpg,1,2,3,{heading},{pitch},{roll},18");
    let dir = set(&["#name,x,y,alt,heading,pitch,roll,f", &row]);
    let camera = read_all(dir.path()).unwrap().views[0].camera;
    assert!(camera.position().distance(Vec3::new(1.0, 2.0, 3.0)) < 1e-6);
    let matrix = camera.world_from_camera.matrix3;
    [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(Vec3::from)
}

#[track_caller]
fn assert_near(found: [Vec3; 3], expected: [Vec3; 3]) {
    assert!((0..3).all(|k| found[k].distance(expected[k]) < 1e-5), "{found:?} {expected:?}");
}

#[test]
fn angles_are_those_of_a_camera_that_looks_down() {
    let (east, north, up) = (Vec3::X, Vec3::Y, Vec3::Z);
    // The top of the image is north, then it turns clockwise as seen from above: a compass.
    assert_near(axes(0.0, 0.0, 0.0), [east, -north, -up]);
    assert_near(axes(90.0, 0.0, 0.0), [-north, -east, -up]);
    // Pitch lifts the view to the horizon, where it looks as the heading says.
    assert_near(axes(0.0, 90.0, 0.0), [east, -up, north]);
    assert_near(axes(90.0, 90.0, 0.0), [-north, -up, east]);
    // A roll to the right turns the view to the left.
    let [_, down, forward] = axes(0.0, 0.0, 30.0);
    assert!(down.distance(-north) < 1e-5 && (forward.x + 0.5).abs() < 1e-5, "{down} {forward}");
}

#[test]
fn angles_turn_about_axes_that_turn_along() {
    for [heading, pitch, roll] in [[20.0, 35.0, -50.0f32], [170.0, 85.0, -22.0], [-100.0, 10.0, 160.0]] {
        // An aircraft that flies north: right wing east, nose north. Each turn is about the axis as the turns before left it.
        let [mut wing, mut nose, mut top] = [Vec3::X, Vec3::Y, Vec3::Z];
        for (turn, degrees) in [(0, heading), (1, pitch), (2, roll)] {
            let axis = [-top, wing, nose][turn];
            let turned = Quat::from_axis_angle(axis, degrees.to_radians());
            [wing, nose, top] = [wing, nose, top].map(|axis| turned * axis);
        }
        // The camera looks through its floor, with the nose at the top of the image.
        assert_near(axes(heading, pitch, roll), [wing, -nose, -top]);
    }
}

#[test]
fn intrinsics_scale_with_the_longer_side() {
    let dir =
        set(&[HEADER, "b.jpg,0,0,5,0,0,0,36,0.05,-0.025,0,0,0,0,0,0", "a,0,0,5,0,0,0,18,0,0,0,0,0,0,0,0"]);
    let dataset = read_all(dir.path()).unwrap();
    assert_eq!((dataset.layout, names(&dataset)), (Layout::RealityCapture, vec!["a", "b"]));
    let [a, b] = [0, 1].map(|n| dataset.views[n].camera);
    assert_eq!((a.focal, a.center, a.pixel_center), ([3.0; 2], [3.0, 2.0], 0.5));
    assert_eq!(b.focal, [6.0; 2]);
    assert!((b.center[0] - 3.3).abs() < 1e-5 && (b.center[1] - 1.85).abs() < 1e-5, "{:?}", b.center);
    assert_eq!(mask_of(&dataset.views[0]).coverage[3..5], [1.0, 0.0]);
    assert_eq!(names(&read_split(dir.path(), Split::Test).unwrap()), ["a"]);
}

#[test]
fn distortion_is_undone_and_columns_may_stand_in_any_order() {
    let row = "\u{feff}#name,f,x,y,alt,heading,pitch,roll,k1";
    let dir = set(&[row, "a.jpg,18,0,0,5,0,0,0,-0.02"]);
    let plan = crate::dataset::reality_capture::plan(dir.path()).unwrap();
    assert_eq!(
        plan.views[0].lens.distortion,
        crate::dataset::distortion::Distortion::brown_conrady([-0.02, 0.0, 0.0], [0.0; 2])
    );
    let dataset = read_all(dir.path()).unwrap();
    assert_says(&dataset.notes.join(" "), &["1 images in", "have no camera"]);
}

#[test]
fn photographs_may_lie_beside_the_file_and_be_exr() {
    let dir = tempfile::tempdir().unwrap();
    let channels = ["R", "G", "B"].map(|c| (c, vec![0.5; 24]));
    write_exr(&dir.path().join("a.exr"), SIZE.0, SIZE.1, &channels);
    write(&dir, &["#name,x,y,alt,heading,pitch,roll,f", "a.exr,0,0,5,0,0,0,18"]);
    let views = read_all(dir.path()).unwrap().views;
    assert!(views[0].camera.focal == [3.0; 2] && views[0].mask.is_none());
}

#[test]
fn bad_lines_are_named() {
    let good = "a.jpg,0,0,5,0,0,0,18,0,0,0,0,0,0,0,0";
    let dir = set(&[]);
    let error = |lines: &[&str]| {
        write(&dir, lines);
        input_error(read_all(dir.path()))
    };
    let place = "cameras.csv, line 3";
    assert_says(&error(&[HEADER, good, "b.jpg,0,0,5"]), &[place, "4 values, not 16"]);
    assert_says(&error(&[HEADER, good, &good.replace("18", "x")]), &[place, "f is `x`", "not a number"]);
    assert_says(&error(&[HEADER, good, &good.replace("18", "")]), &[place, "f is ``"]);
    assert_says(&error(&[HEADER, good, &good.replace("18", "NaN")]), &[place, "f is NaN", "not finite"]);
    assert_says(&error(&[HEADER, good, &good.replace('5', "1e300")]), &[place, "too far away"]);
    assert_says(
        &error(&[HEADER, good, "b.jpg,0,0,5,0,0,0,18,0,0,0,0,0,1,0,0"]),
        &[place, "k4 is 1", "Brown3"],
    );
    assert_says(&error(&[HEADER, &good.replace("18", "-18")]), &["line 2", "focal length is -3"]);
    assert_says(&error(&[HEADER, good, good]), &["two views are called `a`", "line 2"]);
    assert_says(
        &error(&[HEADER, &good.replace("a.jpg", "c.jpg")]),
        &["c.jpg", "image is missing", "2 .jpg files"],
    );
    assert_says(&error(&[HEADER]), &["cameras.csv", "no cameras"]);
    assert_says(&error(&["#name,x,y,alt"]), &["not a data set"]);
    assert_says(
        &error(&[&HEADER.replace(',', ";")]),
        &["not a data set", "not separated by commas", "Export it again"],
    );
    let wide: Vec<u8> = HEADER.encode_utf16().flat_map(u16::to_le_bytes).collect();
    fs::write(dir.path().join("cameras.csv"), [b"\xff\xfe", wide.as_slice()].concat()).unwrap();
    assert_says(&input_error(read_all(dir.path())), &["cameras.csv is UTF-16"]);
    let broken = [HEADER.as_bytes(), b"\na.jpg,\xff\xfe"].concat();
    fs::write(dir.path().join("cameras.csv"), broken).unwrap();
    assert_says(&input_error(read_all(dir.path())), &["cameras.csv", "not UTF-8"]);
}

#[test]
fn missing_masks_and_second_files_are_named() {
    let good = "a.jpg,0,0,5,0,0,0,18,0,0,0,0,0,0,0,0";
    let dir = set(&[HEADER, good]);
    fs::remove_file(dir.path().join("masks/a_mask.png")).unwrap();
    assert_says(&input_error(read_all(dir.path())), &["masks/a.png", "mask of `a.jpg` is missing"]);
    fs::write(dir.path().join("more.csv"), HEADER).unwrap();
    fs::write(dir.path().join("other.csv"), "a,b,c").unwrap();
    let text = input_error(read_all(dir.path()));
    assert_says(&text, &["several files have cameras", "cameras.csv", "more.csv"]);
    assert!(!text.contains("other.csv"), "{text}");
    fs::remove_file(dir.path().join("more.csv")).unwrap();
    fs::write(dir.path().join("images/a.jpg"), "no image").unwrap();
    write_mask(&dir.path().join("masks/a_mask.png"));
    assert_says(&input_error(read_all(dir.path())), &["a.jpg", "neither PNG, JPEG"]);
    fs::remove_dir_all(dir.path().join("images")).unwrap();
    assert_says(
        &input_error(read_all(dir.path())),
        &["no photographs: looked for images in images, image, ."],
    );
}
