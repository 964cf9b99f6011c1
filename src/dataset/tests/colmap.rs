//! COLMAP's layout: text and binary, splits, distortion, masks, and what can be wrong with it.

use super::*;
use glam::{DMat3, DQuat, DVec3};

/// A quaternion (w first) and a translation: a quarter turn about y, and an offset.
const POSE: ([f64; 4], [f64; 3]) =
    ([std::f64::consts::FRAC_1_SQRT_2, 0.0, std::f64::consts::FRAC_1_SQRT_2, 0.0], [0.1, -0.2, 3.0]);

/// A data set of RGB photographs with masks, one camera, and a model written as asked.
struct Colmap {
    dir: TempDir,
    views: usize,
}

impl Colmap {
    fn new(views: usize) -> Self {
        let set = Self { dir: tempfile::tempdir().unwrap(), views };
        for folder in ["sparse/0", "images", "masks"] {
            fs::create_dir_all(set.path(folder)).unwrap();
        }
        for i in 0..views {
            let image = image::RgbImage::from_fn(6, 4, |x, _| image::Rgb([40 * x as u8, 20 + i as u8, 9]));
            image.save(set.path(&format!("images/p{i:02}.png"))).unwrap();
            let mask = GrayImage::from_fn(6, 4, |x, _| image::Luma([if x < 4 { 255 } else { 0 }]));
            mask.save(set.path(&format!("masks/p{i:02}.png"))).unwrap();
        }
        set.write_text("PINHOLE 6 4 8 9 3.0 2.0");
        set
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write_text(&self, camera: &str) {
        fs::write(self.path("sparse/0/cameras.txt"), format!("# cameras\n\n7 {camera}\n")).unwrap();
        let ([w, x, y, z], [tx, ty, tz]) = POSE;
        let mut text = "# images\n".to_owned();
        // Not in order of name, as COLMAP's ids are not; points are there, or not.
        for i in (0..self.views).rev() {
            let points = if i % 2 == 0 { "1.5 2.5 -1 3 4 17" } else { "" };
            text += &format!("{} {w} {x} {y} {z} {tx} {ty} {tz} 7 p{i:02}.png\n{points}\n", i + 1);
        }
        fs::write(self.path("sparse/0/images.txt"), text).unwrap();
    }

    /// Replaces the text by a binary model.
    fn write_binary(&self, model: u32, size: [u64; 2], parameters: &[f64]) {
        let mut cameras = [1u64.to_le_bytes().as_slice(), &7u32.to_le_bytes(), &model.to_le_bytes()].concat();
        size.iter().for_each(|value| cameras.extend(value.to_le_bytes()));
        parameters.iter().for_each(|value| cameras.extend(value.to_le_bytes()));
        let mut images = (self.views as u64).to_le_bytes().to_vec();
        for i in 0..self.views {
            images.extend((i as u32 + 1).to_le_bytes());
            POSE.0.iter().chain(&POSE.1).for_each(|value| images.extend(value.to_le_bytes()));
            images.extend(7u32.to_le_bytes());
            images.extend(format!("p{i:02}.png\0").as_bytes());
            images.extend((i as u64).to_le_bytes());
            images.extend(vec![0; 24 * i]);
        }
        fs::write(self.path("sparse/0/cameras.bin"), cameras).unwrap();
        fs::write(self.path("sparse/0/images.bin"), images).unwrap();
        for name in ["cameras", "images"] {
            fs::remove_file(self.path(&format!("sparse/0/{name}.txt"))).unwrap();
        }
    }

    fn read(&self, split: Split) -> Result<Dataset> {
        read_dataset(self.dir.path(), split, &DatasetOptions::default())
    }
}

#[test]
fn text_and_binary_models_give_the_same_views() {
    let set = Colmap::new(10);
    let text = set.read(Split::Train).unwrap();
    assert_eq!(text.layout, Layout::Colmap);
    let camera = text.views[0].camera;
    assert_eq!((camera.focal, camera.center, camera.pixel_center), ([8.0, 9.0], [3.0, 2.0], 0.5));
    set.write_binary(1, [6, 4], &[8.0, 9.0, 3.0, 2.0]);
    let binary = set.read(Split::Train).unwrap();
    for (a, b) in text.views.iter().zip(&binary.views) {
        assert_eq!((&a.name, a.camera, mask_of(a)), (&b.name, b.camera, mask_of(b)));
        assert_eq!(mask_of(a).coverage[3..5], [1.0, 0.0]);
    }
}

/// A point through the model's own formulas: x = R(q) X + t, pixel = f x / z + c, pixel centers at +0.5.
#[test]
fn quaternion_and_translation_are_camera_from_world() {
    let camera = Colmap::new(1).read(Split::Test).unwrap().views[0].camera;
    let [w, x, y, z] = POSE.0;
    let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w));
    // Row by row as in COLMAP's documentation, for a quarter turn about y.
    assert!((rotation.row(0) - DVec3::Z).length() < 1e-12 && (rotation.row(2) + DVec3::X).length() < 1e-12);
    let point = DVec3::new(0.5, 0.3, -0.4);
    let at = rotation * point + DVec3::from(POSE.1);
    let (px, py, depth) = camera.project(point.as_vec3()).unwrap();
    assert!((f64::from(px) - (8.0 * at.x / at.z + 3.0)).abs() < 1e-5);
    assert!((f64::from(py) - (9.0 * at.y / at.z + 2.0)).abs() < 1e-5);
    assert!((f64::from(depth) - at.z).abs() < 1e-5);
    assert!(camera.ray(3.0, 2.0).direction.distance(rotation.row(2).as_vec3()) < 1e-6);
}

#[test]
fn every_eighth_view_is_held_out() {
    let set = Colmap::new(18);
    assert_eq!(names(&set.read(Split::Test).unwrap()), ["p00", "p08", "p16"]);
    let train = set.read(Split::Train).unwrap();
    assert_eq!((train.views.len(), names(&train)[0], names(&train)[7]), (15, "p01", "p09"));
    let none = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
    assert_eq!(read_dataset(set.dir.path(), Split::Train, &none).unwrap().views.len(), 18);
    assert!(!has_split(set.dir.path(), Split::Test, &none).unwrap());
    let text = input_error(read_dataset(set.dir.path(), Split::Test, &none));
    assert_says(&text, &["no views", "hold_out: 8"]);
    let all = DatasetOptions { hold_out: 1, ..DatasetOptions::default() };
    assert_says(&usage_error(read_dataset(set.dir.path(), Split::Test, &all)), &["hold_out: 1"]);
}

#[test]
fn models_may_lie_in_sparse_itself_and_photographs_in_folders() {
    let set = Colmap::new(0);
    fs::remove_dir_all(set.path("sparse")).unwrap();
    for folder in ["sparse", "images/left", "images/right", "masks/left", "masks/right"] {
        fs::create_dir_all(set.path(folder)).unwrap();
    }
    fs::write(set.path("sparse/cameras.txt"), "1 SIMPLE_PINHOLE 6 4 8 3 2").unwrap();
    let mut text = String::new();
    for side in ["left", "right"] {
        image::RgbImage::new(6, 4).save(set.path(&format!("images/{side}/0.png"))).unwrap();
        let mask = GrayImage::from_fn(6, 4, |x, _| image::Luma([x as u8 * 51]));
        mask.save(set.path(&format!("masks/{side}/0.jpg.png"))).unwrap();
        // The photographs have become PNGs since.
        text += &format!("1 1 0 0 0 0 0 3 1 {side}/0.jpg\n\n");
    }
    image::RgbImage::new(6, 4).save(set.path("images/left/9.png")).unwrap();
    fs::write(set.path("sparse/images.txt"), text).unwrap();
    let options = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
    let dataset = read_dataset(set.dir.path(), Split::Train, &options).unwrap();
    assert_eq!(names(&dataset), ["left_0", "right_0"]);
    assert_says(&dataset.notes.join(" "), &["1 images in", "have no camera"]);
    assert_eq!(mask_of(&dataset.views[0]).coverage[5], 1.0);
}

#[test]
fn distorted_photographs_are_straightened_with_their_masks() {
    for camera in ["SIMPLE_RADIAL 6 4 8 3 2 0.1", "RADIAL 6 4 8 3 2 0.1 0", "OPENCV 6 4 8 8 3 2 0.1 0 0 0"] {
        let set = Colmap::new(1);
        set.write_text(camera);
        let view = set.read(Split::Test).unwrap().views.remove(0);
        let size = (view.camera.width, view.camera.height);
        assert!(size.0 < 6, "a pincushion's frame shrinks: {size:?}");
        let photograph = view.photograph.unwrap();
        let mask = view.mask.unwrap();
        assert_eq!((photograph.size(), mask.size()), ([size.0, size.1], [size.0, size.1]));
    }
    let set = Colmap::new(1);
    set.write_text("SIMPLE_RADIAL 6 4 8 3 2 -30");
    assert_says(&input_error(set.read(Split::Test)), &["image `p00.png`", "folds", "Undistort"]);
}

#[test]
fn models_that_cannot_be_read_are_named() {
    let set = Colmap::new(1);
    let text = |camera: &str| {
        set.write_text(camera);
        input_error(set.read(Split::Test))
    };
    assert_says(
        &text("OPENCV_FISHEYE 6 4 8 8 3 2 0 0 0 0"),
        &["line 3", "camera 7", "OPENCV_FISHEYE", "image_undistorter"],
    );
    assert_says(&text("PINHOLE 6 4 8 3 2"), &["PINHOLE camera has 3 parameters, not 4"]);
    assert_says(&text("PINHOLE 6 4 8 x 3 2"), &["cameras.txt, line 3", "not a camera"]);
    assert_says(&text("PINHOLE 12 8 8 8 3 2"), &["6×4", "12×8"]);
    set.write_text("PINHOLE 6 4 8 8 3 2");
    set.write_binary(7, [6, 4], &[0.0; 5]);
    assert_says(&input_error(set.read(Split::Test)), &["cameras.bin, camera 7", "FOV", "image_undistorter"]);
    fs::write(
        set.path("sparse/0/cameras.bin"),
        [[1u8, 0, 0, 0].as_slice(), &[0; 8], &[99, 0, 0, 0]].concat(),
    )
    .unwrap();
    assert_says(&input_error(set.read(Split::Test)), &["model number 99"]);
}

#[test]
fn truncated_binaries_are_refused_wherever_they_end() {
    let set = Colmap::new(3);
    set.write_binary(1, [6, 4], &[8.0, 9.0, 3.0, 2.0]);
    for name in ["cameras.bin", "images.bin"] {
        let path = set.path(&format!("sparse/0/{name}"));
        let bytes = fs::read(&path).unwrap();
        for end in 1..bytes.len() {
            fs::write(&path, &bytes[..end]).unwrap();
            assert_says(
                &input_error(set.read(Split::Train)),
                &[name, "byte ", "truncated", "Copy the file again"],
            );
        }
        fs::write(&path, bytes).unwrap();
    }
    assert_eq!(set.read(Split::Train).unwrap().views.len(), 2);
}

#[test]
fn bad_image_lists_are_refused() {
    let set = Colmap::new(1);
    let text = |line: &str| {
        fs::write(set.path("sparse/0/images.txt"), line).unwrap();
        input_error(set.read(Split::Test))
    };
    assert_says(&text("1 1 0 0 0 0 0 3 8 p00.png\n"), &["image `p00.png`", "no camera 8"]);
    assert_says(&text("1 0 0 0 0 0 0 3 7 p00.png\n"), &["line 1", "p00.png", "not a rotation"]);
    assert_says(&text("\n1 1 0 0 0 0 0 7 p00.png\n"), &["line 2", "neither an image nor points"]);
    assert_says(&text("1 1 0 0 0 0 0 3 7 gone.png\n"), &["gone.png", "missing"]);
    fs::remove_file(set.path("masks/p00.png")).unwrap();
    assert_says(&text("1 1 0 0 0 0 0 3 7 p00.png\n"), &["masks/p00.png", "missing"]);
    fs::remove_dir_all(set.path("images")).unwrap();
    assert_says(&text("1 1 0 0 0 0 0 3 7 p00.png\n"), &["images", "folder of photographs is missing"]);
}
