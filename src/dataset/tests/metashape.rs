//! Metashape's layout.

use super::*;
use glam::DVec2;
use std::time::Instant;

const CALIBRATION: &str = "<f>20</f><cx>0.5</cx><cy>-0.25</cy><b1>1</b1><b2>0.5</b2>\
    <k1>-0.02</k1><k2>0.01</k2><k3>0.003</k3><p1>0.004</p1><p2>-0.006</p2>";
/// At (1, 2, 3), looking along +Y with +Z up: OpenCV's axes right, down and forward are columns.
const TRANSFORM: &str = "1 0 0 1  0 0 1 2  0 -1 0 3  0 0 0 1";

/// A folder with the photographs `a.jpg` and `b.jpg`, twice smaller than the calibration says, and a camera for each.
pub(super) struct Metashape {
    dir: TempDir,
    text: String,
}

impl Metashape {
    pub(super) fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        for name in ["a", "b"] {
            write_photograph(&dir.path().join(format!("images/{name}.jpg")), 1);
            write_mask(&dir.path().join(format!("masks/{name}.png")));
        }
        let cameras = ["a", "b.jpg"].map(|label| {
            format!(
                "<camera id=\"0\" sensor_id=\"3\" component_id=\"7\" label=\"{label}\">\n\
                 <transform>{TRANSFORM}</transform></camera>\n"
            )
        });
        let text = format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"1.5.0\">\n<chunk label=\"Chunk 1\">\n\
             <sensors>\n<sensor id=\"3\" label=\"x\" type=\"frame\">\n<resolution width=\"12\" height=\"8\"/>\n\
             <calibration type=\"frame\" class=\"initial\"><f>99</f></calibration>\n\
             <calibration type=\"frame\" class=\"adjusted\"><resolution width=\"12\" height=\"8\"/>{CALIBRATION}</calibration>\n\
             </sensor>\n</sensors>\n<cameras>\n<group label=\"all\">{}</group>\n{}</cameras>\n</chunk>\n</document>\n",
            cameras[0], cameras[1]
        );
        Self { dir, text }
    }

    pub(super) fn with(mut self, from: &str, to: &str) -> Self {
        assert!(self.text.contains(from), "{from}");
        self.text = self.text.replace(from, to);
        self
    }

    pub(super) fn read(&self) -> Result<LoadedDataset> {
        fs::write(self.dir.path().join("cameras.xml"), &self.text).unwrap();
        read_all(self.dir.path())
    }
}

/// The error after a replacement.
fn error(from: &str, to: &str) -> String {
    input_error(Metashape::new().with(from, to).read())
}

#[test]
fn cameras_come_in_the_chunks_world() {
    let set = Metashape::new();
    let dataset = set.read().unwrap();
    assert_eq!((dataset.layout, names(&dataset)), (Layout::Metashape, vec!["a", "b"]));
    let camera = dataset.views[0].camera;
    assert!(camera.position().distance(Vec3::new(1.0, 2.0, 3.0)) < 1e-6);
    let (x, y, depth) = camera.project(Vec3::new(1.0, 4.0, 3.0)).unwrap();
    assert!(
        (depth - 2.0).abs() < 1e-6
            && (x - camera.center[0]).abs() < 1e-5
            && (y - camera.center[1]).abs() < 1e-5
    );
    let (right, ..) = camera.project(Vec3::new(1.1, 4.0, 3.0)).unwrap();
    let (_, above, _) = camera.project(Vec3::new(1.0, 4.0, 3.1)).unwrap();
    assert!(right > x && above < y, "world +X is right, +Z up");
    assert_eq!(camera.pixel_center, 0.5);
    assert_eq!(names(&read_split(set.dir.path(), Split::Test).unwrap()), ["a"]);
    assert_eq!(mask_of(&dataset.views[1]).coverage[0], 1.0);
}

#[test]
fn lenses_project_as_the_manual_says() {
    let set = Metashape::new();
    set.read().unwrap();
    let plan = crate::dataset::metashape::plan(set.dir.path()).unwrap();
    let lens = plan.views[0].lens;
    let camera = lens.camera([12, 8], glam::Affine3A::IDENTITY, 0.5).unwrap();
    for (x, y) in [(0.1, 0.2), (-0.25, 0.1), (0.2, -0.15)] {
        // Metashape's manual, "Camera models", frame cameras.
        let r2: f64 = x * x + y * y;
        let radial = 1.0 - 0.02 * r2 + 0.01 * r2 * r2 + 0.003 * r2 * r2 * r2;
        let (p1, p2) = (0.004, -0.006);
        let bent_x = x * radial + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y;
        let bent_y = y * radial + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y;
        let u = 6.0 + 0.5 + bent_x * 20.0 + bent_x * 1.0 + bent_y * 0.5;
        let v = 4.0 - 0.25 + bent_y * 20.0;
        let bent = lens.distortion.distort(DVec2::new(x, y));
        let (column, row, _) = camera.project(bent.extend(1.0).as_vec3()).unwrap();
        assert!(
            (f64::from(column) - u).abs() < 1e-4 && (f64::from(row) - v).abs() < 1e-4,
            "{column} {u} {row} {v}"
        );
    }
}

#[test]
fn transforms_of_component_or_chunk_are_applied() {
    let transform = "<transform><rotation>0 -1 0 1 0 0 0 0 1</rotation><translation>10 20 30</translation>\
                     <scale>2</scale></transform>";
    let of_component = format!("<components><component id=\"7\">{transform}</component></components>");
    for text in [&of_component, transform] {
        let set = Metashape::new().with("<cameras>", &format!("{text}<cameras>"));
        let camera = set.read().unwrap().views[0].camera;
        // (1, 2, 3) turned by 90° about z is (−2, 1, 3).
        assert!(camera.position().distance(Vec3::new(6.0, 22.0, 36.0)) < 1e-5, "{}", camera.position());
        assert!(camera.world_from_camera.matrix3.z_axis.distance(Vec3::NEG_X.into()) < 1e-6);
        assert!((camera.world_from_camera.matrix3.determinant() - 1.0).abs() < 1e-6);
    }
    let other = of_component.replace("\"7\"", "\"8\"");
    let set = Metashape::new().with("<cameras>", &format!("{other}<cameras>"));
    assert!(set.read().unwrap().views[0].camera.position().distance(Vec3::new(1.0, 2.0, 3.0)) < 1e-6);
    let bad = |from: &str, to: &str| error("<cameras>", &format!("{}<cameras>", transform.replace(from, to)));
    assert_says(&bad(">2<", ">0<"), &["scale is 0"]);
    assert_says(&bad("0 -1 0", "0 0 0"), &["line 11", "the transform is singular"]);
    assert_says(&bad("10 20 30", "10 20"), &["<translation> has 2 numbers, not 3"]);
    assert_says(&bad("10 20 30", "1e300 0 0"), &["NaN or infinite"]);
}

#[test]
fn cameras_without_pose_are_left_out() {
    let one = "<camera label=\"c\" sensor_id=\"3\"/><camera label=\"d\" sensor_id=\"3\" enabled=\"0\">\
               <transform>1</transform></camera></cameras>";
    let dataset = Metashape::new().with("</cameras>", one).read().unwrap();
    assert_eq!(names(&dataset), ["a", "b"]);
    assert_says(&dataset.notes.join(" "), &["2 cameras have no pose", "the first is c"]);
    let none = Metashape::new().with("transform>", "pose>").read();
    assert_says(&input_error(none), &["no cameras with a pose"]);
}

#[test]
fn bad_values_are_named_with_their_lines() {
    assert_says(&error("0 0 1 2", "0 0 x 2"), &["cameras.xml, line 13", "<transform> is not finite numbers"]);
    assert_says(&error("0 0 1 2", "0 0 NaN 2"), &["line 13", "<transform> is not finite numbers"]);
    assert_says(&error("0 0 1 2", "0 0 1"), &["line 13", "<transform> has 15 numbers, not 16"]);
    assert_says(&error("0 0 1 2", "0 0 0 2"), &["line 13", "the camera's transform is singular"]);
    assert_says(&error("0 0 1 2", "0 0 2 2"), &["line 13", "not rigid"]);
    assert_says(&error("<f>20</f>", ""), &["line 8", "no focal length <f>"]);
    assert_says(&error("<f>20</f>", "<f>-3</f>"), &["camera `a`", "focal length"]);
    assert_says(&error("<k1>-0.02", "<k1>inf"), &["line 8", "<k1> is not finite"]);
    assert_says(&error("<k1>", "<k4>0.1</k4><k1>"), &["line 8", "k4 is 0.1", "cannot be read"]);
    assert_says(
        &error("calibration type=\"frame\"", "calibration type=\"fisheye\""),
        &["sensor 3", "type fisheye"],
    );
    assert_says(&error("width=\"12\"", "width=\"12.5\""), &["the width or the height is not a whole number"]);
    assert_says(&error("sensor id=\"3\"", "sensor id=\"4\""), &["line 12", "no sensor 3"]);
    assert_says(&error("calibration", "kalibration"), &["line 5", "sensor 3 has no calibration"]);
    assert_says(&error("label=\"a\"", "name=\"a\""), &["line 12", "no label"]);
    assert_says(&error("label=\"a\"", "label=\"c\""), &["images/c", "image is missing"]);
    assert_says(&error("</chunk>", "</chunk><chunk/>"), &["more than one chunk"]);
}

#[test]
fn broken_documents_are_refused_in_bounded_time() {
    assert_says(&error("</sensors>", "</sensor>"), &["cameras.xml, line 10", "this is not XML"]);
    let set = Metashape::new();
    let half = set.text[..set.text.len() / 2].to_owned();
    let text = set.text.clone();
    assert_says(&input_error(set.with(&text, &half).read()), &["this is not XML"]);
    let entities = "<!DOCTYPE x [<!ENTITY a \"aaaa\"><!ENTITY b \"&a;&a;&a;\">]>\n<document ";
    assert_says(&error("<document ", entities), &["this is not XML"]);
    let started = Instant::now();
    let deep = "<group>".repeat(200_000);
    assert_says(&error("<cameras>", &format!("<cameras>{deep}")), &["this is not XML"]);
    let deep = format!("{deep}{}", "</group>".repeat(200_000));
    let set = Metashape::new().with("<cameras>", &format!("<cameras>{deep}"));
    assert_eq!(set.read().unwrap().views.len(), 2);
    assert!(started.elapsed().as_secs() < 20);
    assert_says(&error("<chunk ", "<junk "), &["not a data set"]);
}
