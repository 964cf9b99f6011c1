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

    fn read(&self, split: Split) -> Result<LoadedDataset> {
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

/// Every model of COLMAP that distorts, by number and name, with coefficients that hardly do.
const MODELS: [(u32, &str, &[f64]); 15] = [
    (2, "SIMPLE_RADIAL", &[8.0, 3.0, 2.0, 0.1]),
    (3, "RADIAL", &[8.0, 3.0, 2.0, 0.1, 0.0]),
    (4, "OPENCV", &[8.0, 8.0, 3.0, 2.0, 0.1, 0.0, 0.0, 0.0]),
    (5, "OPENCV_FISHEYE", &[8.0, 8.0, 3.0, 2.0, 0.5, 0.0, 0.0, 0.0]),
    (6, "FULL_OPENCV", &[8.0, 8.0, 3.0, 2.0, 0.1, 0.0, 0.0, 0.0, 0.0, -0.1, 0.0, 0.0]),
    (7, "FOV", &[8.0, 8.0, 3.0, 2.0, 1e-3]),
    (8, "SIMPLE_RADIAL_FISHEYE", &[8.0, 3.0, 2.0, 0.5]),
    (9, "RADIAL_FISHEYE", &[8.0, 3.0, 2.0, 0.5, 0.0]),
    (10, "THIN_PRISM_FISHEYE", &[8.0, 8.0, 3.0, 2.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
    (
        11,
        "RAD_TAN_THIN_PRISM_FISHEYE",
        &[8.0, 8.0, 3.0, 2.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ),
    (12, "SIMPLE_DIVISION", &[8.0, 3.0, 2.0, 0.1]),
    (13, "DIVISION", &[8.0, 8.0, 3.0, 2.0, 0.1]),
    (14, "SIMPLE_FISHEYE", &[8.0, 3.0, 2.0]),
    (15, "FISHEYE", &[8.0, 8.0, 3.0, 2.0]),
    (16, "EUCM", &[8.0, 8.0, 3.0, 2.0, 0.0, 1.0]),
];

/// In text and binary.
#[test]
fn all_models_are_read_and_photographs_straightened_with_their_masks() {
    for (number, name, parameters) in MODELS {
        let set = Colmap::new(1);
        let words: Vec<String> = parameters.iter().map(f64::to_string).collect();
        set.write_text(&format!("{name} 6 4 {}", words.join(" ")));
        let text = set.read(Split::Test).unwrap().views.remove(0);
        set.write_binary(number, [6, 4], parameters);
        let view = set.read(Split::Test).unwrap().views.remove(0);
        assert_eq!((view.camera, mask_of(&view)), (text.camera, mask_of(&text)), "{name}");
        let size = (view.camera.width, view.camera.height);
        let pincushion = !["FOV", "SIMPLE_FISHEYE", "FISHEYE", "EUCM"].contains(&name);
        assert_eq!(size.0 < 6, pincushion, "the frame of a pincushion shrinks: {name} {size:?}");
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
    assert_says(&text("LENS_2030 6 4 8 3 2 0"), &["line 3", "camera 7", "LENS_2030", "image_undistorter"]);
    assert_says(&text("EQUIRECTANGULAR 6 4 6 4"), &["line 3", "panorama", "perspective"]);
    assert_says(&text("FOV 6 4 8 8 3 2"), &["FOV camera has 4 parameters, not 5"]);
    assert_says(&text("PINHOLE 6 4 8 3 2"), &["PINHOLE camera has 3 parameters, not 4"]);
    assert_says(&text("PINHOLE 6 4 8 x 3 2"), &["cameras.txt, line 3", "not a camera"]);
    assert_says(&text("PINHOLE 12 8 8 8 3 2"), &["6×4", "12×8"]);
    set.write_text("PINHOLE 6 4 8 8 3 2");
    set.write_binary(17, [6, 4], &[6.0, 4.0]);
    assert_says(&input_error(set.read(Split::Test)), &["cameras.bin, camera 7", "EQUIRECTANGULAR"]);
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
    assert_says(
        &text("1 1 0 0 0 0 0 3 7 p00.png\n"),
        &["masks/p00.png", "mask of `p00.png` is missing", "p00_mask.png"],
    );
    fs::remove_dir_all(set.path("images")).unwrap();
    assert_says(&text("1 1 0 0 0 0 0 3 7 p00.png\n"), &["images", "folder of photographs is missing"]);
}

/// Parameters that no lens has are found in the camera file, where they are.
#[test]
fn impossible_parameters_name_the_camera() {
    let set = Colmap::new(1);
    let text = |camera: &str| {
        set.write_text(camera);
        input_error(set.read(Split::Test))
    };
    let place = "cameras.txt, line 3";
    assert_says(
        &text("PINHOLE 6 4 1e-40 8 3 2"),
        &[place, "camera 7: a focal length is 1e-40 pixels", "between"],
    );
    assert_says(&text("SIMPLE_PINHOLE 6 4 1e30 3 2"), &[place, "1e30"]);
    assert_says(&text("SIMPLE_PINHOLE 6 4 8 3000 2"), &[place, "principal point is (3000, 2)"]);
    assert_says(&text("SIMPLE_PINHOLE 6 4 8 NaN 2"), &[place, "principal point is (NaN, 2)"]);
    assert_says(&text("SIMPLE_RADIAL 6 4 8 3 2 NaN"), &[place, "lens distortion is NaN"]);
    assert_says(&text("FOV 6 4 8 8 3 2 4"), &[place, "ω is 4 radians"]);
    assert_says(&text("EUCM 6 4 8 8 3 2 1.5 1"), &[place, "α is 1.5"]);
    assert_says(&text("PINHOLE 0 4 8 8 3 2"), &[place, "image size is 0×4"]);
    set.write_text("PINHOLE 6 4 8 8 3 2");
    set.write_binary(1, [6, 4], &[f64::INFINITY, 8.0, 3.0, 2.0]);
    assert_says(&input_error(set.read(Split::Test)), &["cameras.bin, camera 7", "focal length is inf"]);
}

#[test]
fn reconstructions_are_found_where_they_are_usual() {
    for (models, images) in [
        ("sparse", "images"),
        ("colmap/sparse/0", "images"),
        ("colmap/sparse", "colmap/images"),
        ("dense/sparse", "dense/images"),
        ("dense/0/sparse", "dense/0/images"),
        ("distorted/sparse/0", "input"),
    ] {
        let set = Colmap::new(2);
        let moved = tempfile::tempdir().unwrap();
        let (model, photographs) = (moved.path().join(models), moved.path().join(images));
        for folder in [&model, &photographs] {
            fs::create_dir_all(folder.parent().unwrap()).unwrap();
        }
        fs::rename(set.path("sparse/0"), model).unwrap();
        fs::rename(set.path("images"), &photographs).unwrap();
        fs::rename(set.path("masks"), photographs.with_file_name("masks")).unwrap();
        let dataset = read_dataset(moved.path(), Split::Train, &DatasetOptions::default()).unwrap();
        assert_eq!((dataset.layout, names(&dataset)), (Layout::Colmap, vec!["p01"]), "{models}");
        assert!(dataset.views[0].mask.is_some(), "masks beside {images}");
    }
    // The output of image_undistorter beside the reconstruction it is of: the photographs decide.
    let set = Colmap::new(2);
    fs::create_dir_all(set.path("dense/sparse")).unwrap();
    for name in ["cameras.txt", "images.txt"] {
        fs::copy(set.path("sparse/0").join(name), set.path("dense/sparse").join(name)).unwrap();
    }
    fs::rename(set.path("images"), set.path("dense/images")).unwrap();
    assert_eq!(set.read(Split::Train).unwrap().views.len(), 1);
    fs::remove_dir_all(set.path("dense/images")).unwrap();
    assert_says(&input_error(set.read(Split::Train)), &["images", "folder of photographs is missing"]);
}

#[test]
fn the_largest_of_several_models_is_read() {
    let set = Colmap::new(3);
    fs::rename(set.path("sparse/0"), set.path("sparse/1")).unwrap();
    fs::create_dir_all(set.path("sparse/0")).unwrap();
    fs::write(set.path("sparse/0/cameras.txt"), "1 SIMPLE_PINHOLE 6 4 8 3 2").unwrap();
    fs::write(set.path("sparse/0/images.txt"), "1 1 0 0 0 0 0 3 1 p00.png\n\n").unwrap();
    let dataset = set.read(Split::Train).unwrap();
    assert_eq!(dataset.views.len(), 2);
    assert_says(&dataset.notes.join(" "), &["2 models of 1, 3 images", "sparse/1, is read"]);
    // Binary ones are compared by their headers; of equals the first counts.
    let other = Colmap::new(1);
    other.write_binary(1, [6, 4], &[8.0, 9.0, 3.0, 2.0]);
    for name in ["cameras.bin", "images.bin"] {
        fs::rename(other.path("sparse/0").join(name), set.path("sparse/0").join(name)).unwrap();
    }
    assert_eq!(set.read(Split::Train).unwrap().views.len(), 2);
    fs::write(set.path("sparse/0/images.bin"), [1, 2]).unwrap();
    assert_says(&input_error(set.read(Split::Train)), &["images.bin, byte 0", "truncated"]);
}

#[test]
fn rigs_and_frames_beside_the_images_change_nothing() {
    let set = Colmap::new(2);
    set.write_binary(1, [6, 4], &[8.0, 9.0, 3.0, 2.0]);
    for name in ["rigs.bin", "frames.bin", "points3D.bin"] {
        fs::write(set.path("sparse/0").join(name), [0; 8]).unwrap();
    }
    assert_eq!(names(&set.read(Split::Train).unwrap()), ["p01"]);
}

#[test]
fn masks_may_have_any_usual_name() {
    for folder in ["masks", "mask", "silhouettes", "segmentation"] {
        for name in [
            "p00.png.png",
            "p00.png",
            "p00.jpg",
            "p00_mask.png",
            "mask_p00.png",
            "p00.mask.png",
            "p00-mask.png",
        ] {
            let set = Colmap::new(1);
            let path = set.path(folder).join(name);
            if folder != "masks" {
                fs::rename(set.path("masks"), set.path(folder)).unwrap();
            }
            fs::remove_file(set.path(folder).join("p00.png")).unwrap();
            GrayImage::from_fn(6, 4, |_, y| image::Luma([if y < 2 { 255 } else { 0 }])).save(path).unwrap();
            let mask = set.read(Split::Test).unwrap().views.remove(0).mask.unwrap();
            assert!(mask.coverage(0) > 0.9 && mask.coverage(23) < 0.1, "{folder}/{name}");
        }
    }
}

/// Writes a JPEG with an EXIF orientation: bright on the left as stored.
fn write_turned_jpeg(path: &Path, orientation: u8) {
    use image::ImageEncoder;
    let tiff =
        [b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".as_slice(), &[orientation, 0, 0, 0, 0, 0, 0]];
    let image = image::RgbImage::from_fn(16, 8, |x, _| image::Rgb([if x < 8 { 240 } else { 10 }; 3]));
    let mut encoder = image::codecs::jpeg::JpegEncoder::new(fs::File::create(path).unwrap());
    encoder.set_exif_metadata(tiff.concat()).unwrap();
    encoder.encode_image(&image).unwrap();
}

#[test]
fn photographs_are_taken_as_stored() {
    let set = Colmap::new(1);
    fs::remove_file(set.path("images/p00.png")).unwrap();
    fs::remove_dir_all(set.path("masks")).unwrap();
    write_turned_jpeg(&set.path("images/p00.jpg"), 6);
    set.write_text("PINHOLE 16 8 20 20 8 4");
    let view = set.read(Split::Test).unwrap().views.remove(0);
    let image = view.photograph.unwrap().image();
    assert_eq!((image.width, image.height), (16, 8));
    assert!(image.pixels[0].x > 0.7 && image.pixels[15].x < 0.1);

    set.write_text("PINHOLE 8 16 20 20 4 8");
    let text = input_error(set.read(Split::Test));
    assert_says(
        &text,
        &["16×8 as stored and 8×16 as its EXIF orientation shows it; its camera is 8×16", "auto-orient"],
    );
    set.write_text("PINHOLE 8 15 20 20 4 8");
    assert_says(&input_error(set.read(Split::Test)), &["the image has 16×8 pixels, its camera 8×15"]);
    write_turned_jpeg(&set.path("images/p00.jpg"), 3);
    set.write_text("PINHOLE 8 16 20 20 4 8");
    assert_says(&input_error(set.read(Split::Test)), &["the image has 16×8 pixels, its camera 8×16"]);

    write_turned_jpeg(&set.path("images/p00.jpg"), 8);
    set.write_text("PINHOLE 16 8 20 20 8 4");
    fs::create_dir_all(set.path("masks")).unwrap();
    GrayImage::from_pixel(8, 16, image::Luma([255])).save(set.path("masks/p00.png")).unwrap();
    let text = input_error(set.read(Split::Test));
    assert_says(&text, &["masks/p00.png", "its mask is 8×16", "turn the mask"]);
}

#[test]
fn masks_of_undistorted_photographs_may_be_in_the_root() {
    let set = Colmap::new(2);
    fs::create_dir(set.path("dense")).unwrap();
    for folder in ["sparse", "images"] {
        fs::rename(set.path(folder), set.path(&format!("dense/{folder}"))).unwrap();
    }
    let views = read_all(set.dir.path()).unwrap().views;
    assert!(views.len() == 2 && views.iter().all(|view| view.mask.is_some()));
}

#[test]
fn views_are_held_out_in_natural_order() {
    let set = Colmap::new(3);
    for (from, to) in [("p00", "p2"), ("p01", "p10"), ("p02", "p1")] {
        for folder in ["images", "masks"] {
            let path = |name: &str| set.path(&format!("{folder}/{name}.png"));
            fs::rename(path(from), path(to)).unwrap();
        }
        let file = set.path("sparse/0/images.txt");
        let text = fs::read_to_string(&file).unwrap().replace(&format!("{from}.png"), &format!("{to}.png"));
        fs::write(&file, text).unwrap();
    }
    let options = DatasetOptions { hold_out: 2, ..DatasetOptions::default() };
    let test = read_dataset(set.dir.path(), Split::Test, &options).unwrap();
    assert_eq!(names(&test), ["p1", "p10"]);
}

#[test]
fn names_that_no_file_has_are_refused_before_files_are_looked_for() {
    let set = Colmap::new(1);
    let text = fs::read_to_string(set.path("sparse/0/images.txt")).unwrap();
    for name in ["a\u{0}b.png", "a\u{1b}[2Jb.png", &"a".repeat(300), "c\u{1b}/b.png"] {
        fs::write(set.path("sparse/0/images.txt"), text.replace("p00.png", name)).unwrap();
        let text = input_error(read_all(set.dir.path()));
        assert_says(&text, &["images.txt, image `"]);
        let is_named =
            ["the view name `a", "the path `c\\u{1b}/b.png` holds"].iter().any(|words| text.contains(words));
        assert!(is_named && text.len() < 600 && !text.contains(char::is_control), "{text:?}");
    }
    // What is wrong with a pose is told of a name that is not checked yet.
    let spoiled = text.replace("p00.png", "a\u{1b}[2Jb.png").replacen("0.7071067811865476", "NaN", 1);
    fs::write(set.path("sparse/0/images.txt"), spoiled).unwrap();
    let text = input_error(read_all(set.dir.path()));
    assert!(text.contains("image `a\\u{1b}[2Jb.png`: ") && !text.contains(char::is_control), "{text:?}");
}

#[test]
fn photographs_of_a_format_that_is_not_read_are_named_before_their_masks() {
    let starts: [(&str, &[u8], &str); 4] = [
        ("avif", b"\0\0\0\x18ftypavif\0\0\0\0", "avifdec"),
        ("bmp", b"BM\0\0\0\0\0\0\0\0", "magick"),
        ("jp2", b"\0\0\0\x0cjP  \r\n\x87\n", "magick"),
        ("HEIC", b"\0\0\0\x18ftypheic\0\0\0\0", "heif-convert"),
    ];
    for (kind, start, remedy) in starts {
        let set = Colmap::new(2);
        let images = fs::read_to_string(set.path("sparse/0/images.txt")).unwrap();
        fs::write(set.path("sparse/0/images.txt"), images.replace(".png", &format!(".{kind}"))).unwrap();
        // As other photographs of the same names they are found.
        assert_eq!(names(&read_all(set.dir.path()).unwrap()), ["p00", "p01"]);
        for i in 0..2 {
            fs::remove_file(set.path(&format!("images/p{i:02}.png"))).unwrap();
            fs::write(set.path(&format!("images/p{i:02}.{kind}")), start).unwrap();
        }
        for with_masks in [true, false] {
            let text = input_error(read_all(set.dir.path()));
            assert_says(&text, &[&format!("images/p00.{kind}: this is a"), "which is not read", remedy]);
            if with_masks {
                fs::remove_file(set.path("masks/p00.png")).unwrap();
            }
        }
    }
}
