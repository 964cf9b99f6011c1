//! The layout of IDR, NeuS and VolSDF.

use super::*;
use crate::codec::npy::Matrix;
use crate::codec::test_data::{npy_matrix, write_npz};
use glam::{DMat3, DMat4, DVec3, DVec4};
use proptest::prelude::*;
use zip::CompressionMethod;

const FOCAL: [f64; 2] = [8.0, 9.0];
const CENTER: [f64; 2] = [2.75, 1.5];
const SKEW: f64 = 0.25;

/// World_from_camera of the n-th camera, around an object far from the origin.
fn pose(n: usize) -> DMat4 {
    let rotation = DMat3::from_rotation_y(0.4 + 0.3 * n as f64) * DMat3::from_rotation_x(0.2);
    let target = DVec3::new(-28.0, -28.0, 640.0);
    DMat4::from_mat3_translation(rotation, target - rotation.z_axis * 500.0)
}

/// The projection K [R | t] times `factor`, row by row.
fn projection(pose: DMat4, factor: f64) -> Vec<f64> {
    let k = DMat3::from_cols(
        DVec3::new(FOCAL[0], 0.0, 0.0),
        DVec3::new(SKEW, FOCAL[1], 0.0),
        DVec3::new(CENTER[0], CENTER[1], 1.0),
    );
    let product = DMat4::from_mat3(k) * pose.inverse() * factor;
    let mut rows = product.transpose().to_cols_array().to_vec();
    rows[12..].copy_from_slice(&[0.0, 0.0, 0.0, 1.0]);
    rows
}

struct Idr {
    dir: TempDir,
    arrays: Vec<(String, Vec<u8>)>,
}

impl Idr {
    fn new(views: usize) -> Self {
        let mut set = Self { dir: tempfile::tempdir().unwrap(), arrays: Vec::new() };
        for n in 0..views {
            write_photograph(&set.path(&format!("image/{n:06}.png")), 1);
            write_mask(&set.path(&format!("mask/{n:03}.png")));
            let factor = if n % 2 == 0 { 1.0 } else { -3.7 };
            set.arrays.push((format!("world_mat_{n}"), npy_matrix(4, 4, &projection(pose(n), factor))));
            let mut scale =
                [164.0, 0.0, 0.0, -28.0, 0.0, 164.0, 0.0, -28.0, 0.0, 0.0, 164.0, 640.0, 0.0, 0.0, 0.0, 1.0];
            scale[3] -= 1.0;
            set.arrays.push((format!("scale_mat_{n}"), npy_matrix(4, 4, &scale)));
        }
        set.write();
        set
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write(&self) {
        write_npz(&self.path("cameras_sphere.npz"), CompressionMethod::Deflated, &self.arrays);
    }

    /// The error with another `world_mat_1`.
    fn error_with(&mut self, matrix: Vec<u8>) -> String {
        self.arrays[2].1 = matrix;
        self.write();
        self.error()
    }

    fn error(&self) -> String {
        input_error(read_all(self.dir.path()))
    }
}

#[test]
fn projections_become_cameras_in_the_world_of_the_capture() {
    let set = Idr::new(2);
    let dataset = read_all(set.dir.path()).unwrap();
    assert_eq!((dataset.layout, names(&dataset)), (Layout::Idr, vec!["000000", "000001"]));
    for (n, view) in dataset.views.iter().enumerate() {
        let camera = view.camera;
        let near = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-4;
        assert!(
            (0..2).all(|k| near(camera.focal[k], FOCAL[k]) && near(camera.center[k], CENTER[k])),
            "{camera:?}"
        );
        assert!(near(camera.skew, SKEW));
        assert!(camera.position().as_dvec3().distance(pose(n).w_axis.truncate()) < 1e-3);
        let p = projection(pose(n), 1.0);
        let world = DVec3::new(-20.0, -30.0, 650.0);
        let row = |i: usize| DVec4::from_slice(&p[4 * i..]).dot(world.extend(1.0));
        let (x, y, depth) = camera.project(world.as_vec3()).unwrap();
        // The center of the first pixel is (0, 0) in the file and (0.5, 0.5) in `project`.
        assert!(near(x, row(0) / row(2) + 0.5) && near(y, row(1) / row(2) + 0.5), "({x}, {y})");
        assert!(f64::from(depth) > 0.0 && (f64::from(depth) - row(2)).abs() < 1e-2);
        assert_eq!((camera.pixel_center, mask_of(view).coverage[3..5].to_vec()), (0.0, vec![1.0, 0.0]));
    }
}

#[test]
fn every_nth_view_is_held_out_and_options_go_first() {
    let set = Idr::new(9);
    let test = read_split(set.dir.path(), Split::Test).unwrap();
    assert_eq!(names(&test), ["000000", "000008"]);
    assert_eq!(read_split(set.dir.path(), Split::Train).unwrap().views.len(), 7);
    assert!(has_split(set.dir.path(), Split::Test, &DatasetOptions::default()).unwrap());
    assert!(
        !has_split(set.dir.path(), Split::Test, &DatasetOptions { hold_out: 0, ..Default::default() })
            .unwrap()
    );
    let options = DatasetOptions { pixel_center: Some(0.5), ..DatasetOptions::default() };
    let views = read_dataset(set.dir.path(), Split::Test, &options).unwrap().views;
    assert_eq!(views[0].camera.pixel_center, 0.5);
}

#[test]
fn masks_have_the_photographs_names_or_order_or_are_absent() {
    let set = Idr::new(3);
    for n in 0..3 {
        fs::rename(set.path(&format!("mask/{n:03}.png")), set.path(&format!("mask/{n:06}.png"))).unwrap();
    }
    assert_eq!(read_all(set.dir.path()).unwrap().views.len(), 3);
    fs::remove_file(set.path("mask/000001.png")).unwrap();
    assert_says(&set.error(), &["mask/000001.png", "the mask of `000001.png` is missing", "2 .png files"]);
    fs::remove_dir_all(set.path("mask")).unwrap();
    assert!(read_all(set.dir.path()).unwrap().views.iter().all(|view| view.mask.is_none()));
    let set = Idr::new(3);
    fs::remove_file(set.path("mask/001.png")).unwrap();
    assert_says(&set.error(), &["mask", "2 masks here, but 3 photographs"]);
}

#[test]
fn matrices_that_are_no_cameras_are_named() {
    let mut set = Idr::new(3);
    let good = projection(pose(1), 1.0);
    let with = |i: usize, value: f64| {
        let mut rows = good.clone();
        rows[i] = value;
        npy_matrix(4, 4, &rows)
    };
    let place = ["cameras_sphere.npz, `world_mat_1`"];
    let text = set.error_with(with(6, f64::NAN));
    assert_says(&text, &[place[0], "NaN or infinite value in row 2, column 3"]);
    assert_says(&set.error_with(with(3, f64::INFINITY)), &[place[0], "row 1, column 4"]);
    assert_says(&set.error_with(npy_matrix(4, 4, &[0.0; 16])), &[place[0], "singular"]);
    let mut flat = good.clone();
    flat.copy_within(0..4, 4);
    assert_says(&set.error_with(npy_matrix(4, 4, &flat)), &[place[0], "singular"]);
    assert_says(&set.error_with(npy_matrix(3, 3, &good[..9])), &[place[0], "is 3×3, not 4×4"]);
    assert_says(&set.error_with(b"\x93NUMPY".to_vec()), &[place[0], "ends before its length"]);
    let huge: Vec<f64> = good.iter().map(|value| value * 1e300).collect();
    set.arrays[2].1 = npy_matrix(4, 4, &huge);
    set.write();
    assert_eq!(read_all(set.dir.path()).unwrap().views.len(), 3);
    let text = set.error_with(with(3, 1e300));
    assert_says(&text, &[place[0], "puts the camera at infinity"]);
}

#[test]
fn missing_and_surplus_cameras_are_named() {
    let mut set = Idr::new(4);
    let removed = set.arrays.remove(2);
    set.write();
    assert_says(&set.error(), &["`world_mat_1` is missing, but others follow"]);
    set.arrays.insert(2, removed);
    set.write();
    fs::remove_file(set.path("image/000002.png")).unwrap();
    let text = set.error();
    assert_says(&text, &["4 cameras, but 3 photographs", "image", "Missing in the sequence: 000002"]);
    write_photograph(&set.path("image/000002.png"), 1);
    write_photograph(&set.path("image/000009.png"), 1);
    assert_says(&set.error(), &["4 cameras, but 5 photographs", "order of their names"]);
    fs::remove_dir_all(set.path("image")).unwrap();
    assert_says(&set.error(), &["no photographs: looked for images in image, images, rgb"]);
    set.arrays.retain(|(name, _)| name.starts_with("scale"));
    set.write();
    assert_says(&set.error(), &["no `world_mat_0`", "There is scale_mat_"]);
    let file = set.path("cameras_sphere.npz");
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() - 30]).unwrap();
    assert_says(&set.error(), &["cameras_sphere.npz", "damaged or truncated", "Copy the file again"]);
    fs::write(&file, "").unwrap();
    assert_says(&set.error(), &["cameras_sphere.npz", "empty"]);
}

proptest! {
    #[test]
    fn any_camera_is_found_again(
        focal in [10.0f64..1e5, 10.0f64..1e5],
        center in [-1e4f64..1e4, -1e4f64..1e4],
        skew in -50.0f64..50.0,
        angles in [-3.0f64..3.0, -1.5f64..1.5, -3.0f64..3.0],
        position in [-1e4f64..1e4, -1e4f64..1e4, -1e4f64..1e4],
        factor in prop_oneof![1e-6f64..1e6, -1e6f64..-1e-6],
    ) {
        let rotation = DMat3::from_rotation_z(angles[0]) * DMat3::from_rotation_y(angles[1]) * DMat3::from_rotation_x(angles[2]);
        let position = DVec3::from(position);
        let k = DMat3::from_cols_array(&[focal[0], 0.0, 0.0, skew, focal[1], 0.0, center[0], center[1], 1.0]);
        let pose = DMat4::from_mat3_translation(rotation, position);
        let product = (DMat4::from_mat3(k) * pose.inverse() * factor).transpose().to_cols_array();
        let matrix = Matrix { rows: 3, columns: 4, values: product[..12].to_vec() };
        let (lens, found) = crate::dataset::idr::taken_apart(&matrix).unwrap();
        // Within the bounds of an image of that size, but for the shortest focal lengths.
        let camera = lens.camera([4000, 3000], found.to_affine(), 0.0);
        prop_assume!(camera.is_ok());
        let Some(lens::Focal::Pixels(fy)) = lens.focal_y else { panic!("no focal length") };
        prop_assert!((fy / focal[1] - 1.0).abs() < 1e-5);
        prop_assert!((lens.skew - skew).abs() < 1e-5 * focal[0].max(1e4));
        prop_assert!((lens.center[0].unwrap() - center[0]).abs() < 1e-5 * focal[0].max(1e4));
        prop_assert!(found.translation.distance(position) < 1e-3, "{} {position}", found.translation);
        let off = (found.rotation - rotation).to_cols_array();
        prop_assert!(off.iter().all(|value| value.abs() < 1e-6), "{off:?}");
    }
}
