//! One `transforms.json` for all views, as of nerfstudio, Polycam and instant-ngp; lens models in the files of NeRF.

use super::*;

/// A folder with `images/f_0.png` … and one camera file.
struct Transforms {
    dir: TempDir,
    json: Value,
}

impl Transforms {
    fn new(views: usize) -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir_all(dir.path().join("images")).unwrap();
        let frames: Vec<Value> = (0..views).map(|i| nerf_frame(&format!("./images/f_{i}.png"))).collect();
        let set = Self {
            dir,
            json: json!({"camera_model": "OPENCV", "fl_x": 8.0, "fl_y": 9.0, "cx": 3.0, "cy": 2.0, "w": 6, "h": 4, "frames": frames}),
        };
        for i in 0..views {
            let image = image::RgbImage::from_fn(6, 4, |x, _| image::Rgb([40 * x as u8, 20 + i as u8, 9]));
            image.save(set.path(&format!("images/f_{i}.png"))).unwrap();
        }
        set
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn read(&self, split: Split) -> Result<LoadedDataset> {
        fs::write(self.path("transforms.json"), self.json.to_string()).unwrap();
        read_dataset(self.dir.path(), split, &DatasetOptions::default())
    }

    fn has_test_split(&self, hold_out: u32) -> bool {
        let options = DatasetOptions { hold_out, ..DatasetOptions::default() };
        has_split(self.dir.path(), Split::Test, &options).unwrap()
    }

    /// The error after a change of the file.
    fn wrong(&self, change: impl FnOnce(&mut Value)) -> String {
        let mut json = self.json.clone();
        change(&mut json);
        fs::write(self.path("transforms.json"), json.to_string()).unwrap();
        let options = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
        input_error(read_dataset(self.dir.path(), Split::Train, &options))
    }
}

#[test]
fn one_file_is_divided_by_hold_out() {
    let set = Transforms::new(11);
    let test = set.read(Split::Test).unwrap();
    assert_eq!((test.layout, names(&test)), (Layout::Nerf, vec!["f_0", "f_8"]));
    let train = set.read(Split::Train).unwrap();
    assert_eq!((train.views.len(), names(&train)[8]), (9, "f_10"), "in natural order");
    let camera = train.views[0].camera;
    assert_eq!((camera.focal, camera.center), ([8.0, 9.0], [3.0, 2.0]));
    assert!(camera.ray(3.0, 2.0).direction.distance(Vec3::NEG_Z) < 1e-6);
    assert!(set.has_test_split(8) && !set.has_test_split(0));
    assert!(train.notes.is_empty(), "{:?}", train.notes);
}

#[test]
fn lists_divide_the_views() {
    let mut set = Transforms::new(5);
    set.json["test_filenames"] = json!(["images/f_1.png", "./images/f_4.png"]);
    assert_eq!(names(&set.read(Split::Test).unwrap()), ["f_1", "f_4"]);
    assert_eq!(names(&set.read(Split::Train).unwrap()), ["f_0", "f_2", "f_3"]);
    assert!(set.has_test_split(0), "lists do not need hold_out");
    set.json["train_filenames"] = json!(["images\\f_2.png"]);
    let train = set.read(Split::Train).unwrap();
    assert_eq!(names(&train), ["f_2"]);
    assert_says(&train.notes.join(" "), &["2 frames are in neither"]);
    set.json.as_object_mut().unwrap().remove("test_filenames");
    set.json["val_filenames"] = json!(["images/f_0.png"]);
    assert_eq!(names(&set.read(Split::Test).unwrap()), ["f_0"], "validation stands for a missing test list");
    set.json.as_object_mut().unwrap().remove("val_filenames");
    set.json["test_filenames"] = json!([]);
    assert_eq!(
        names(&set.read(Split::Test).unwrap()),
        ["f_2"],
        "of the training list, hold_out makes a test split"
    );
    assert!(set.has_test_split(8) && !set.has_test_split(0));
    set.json.as_object_mut().unwrap().remove("test_filenames");
    let text = set.wrong(|json| json["train_filenames"] = json!(["images/f_9.png"]));
    assert_says(
        &text,
        &["transforms.json, train_filenames", "no frame has the image `images/f_9.png`", "Near: "],
    );
}

#[test]
fn files_of_splits_go_before_the_common_one() {
    let nerf = Nerf::new(3);
    fs::write(nerf.path("transforms.json"), "{\"frames\": []}").unwrap();
    assert_eq!(nerf.read().unwrap().views.len(), 3);
    assert!(!has_split(nerf.dir.path(), Split::Train, &DatasetOptions::default()).unwrap());
}

#[test]
fn the_reconstruction_that_nerfstudio_keeps_is_no_second_layout() {
    let set = Transforms::new(2);
    fs::create_dir_all(set.path("colmap/sparse/0")).unwrap();
    fs::write(set.path("colmap/sparse/0/cameras.txt"), "1 SIMPLE_PINHOLE 6 4 8 3 2").unwrap();
    fs::write(set.path("colmap/sparse/0/images.txt"), "1 1 0 0 0 0 0 3 1 f_0.png\n\n").unwrap();
    assert_eq!(set.read(Split::Train).unwrap().layout, Layout::Nerf);
    let options = DatasetOptions { layout: Layout::Colmap, hold_out: 0, ..DatasetOptions::default() };
    assert_eq!(names(&read_dataset(set.dir.path(), Split::Train, &options).unwrap()), ["f_0"]);
    fs::remove_file(set.path("transforms.json")).unwrap();
    let auto = read_dataset(set.dir.path(), Split::Test, &DatasetOptions::default()).unwrap();
    assert_eq!(auto.layout, Layout::Colmap);
}

#[test]
fn masks_are_those_named_or_those_beside() {
    let mut set = Transforms::new(2);
    let mask = GrayImage::from_fn(6, 4, |x, _| image::Luma([if x < 4 { 255 } else { 0 }]));
    fs::create_dir_all(set.path("masks")).unwrap();
    assert_says(&input_error(set.read(Split::Train)), &["masks/f_0.png", "the mask of `f_0.png` is missing"]);
    for i in 0..2 {
        mask.save(set.path(&format!("masks/f_{i}.png"))).unwrap();
    }
    let view = set.read(Split::Train).unwrap().views.remove(0);
    assert_eq!(view.mask.unwrap().mask().coverage[3..5], [1.0, 0.0]);
    mask.save(set.path("images/own.png")).unwrap();
    for i in 0..2 {
        set.json["frames"][i]["mask_path"] = json!("images\\own");
    }
    fs::remove_dir_all(set.path("masks")).unwrap();
    assert_eq!(set.read(Split::Test).unwrap().views[0].mask.as_ref().unwrap().coverage(4), 0.0);
    let text = set.wrong(|json| json["frames"][1]["mask_path"] = json!("images/gone.png"));
    assert_says(&text, &["images/gone.png", "no such file"]);
}

#[test]
fn paths_may_have_no_extension_and_foreign_separators() {
    let mut set = Transforms::new(2);
    set.json["frames"][0]["file_path"] = json!("images/f_0");
    set.json["frames"][1]["file_path"] = json!(".\\images\\f_1.png");
    assert_eq!(names(&set.read(Split::Train).unwrap()), ["f_1"]);
    assert_eq!(names(&set.read(Split::Test).unwrap()), ["f_0"]);
}

#[test]
fn applied_transforms_are_noted() {
    let mut set = Transforms::new(2);
    let identity = json!([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
    set.json["applied_transform"] = identity;
    assert!(set.read(Split::Train).unwrap().notes.is_empty());
    set.json["applied_transform"] =
        json!([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0]]);
    let dataset = set.read(Split::Train).unwrap();
    assert_says(&dataset.notes.join(" "), &["applied_transform is not undone"]);
    assert!(dataset.views[0].camera.position().distance(Vec3::new(0.1, 0.2, 3.0)) < 1e-6);
}

/// Width of the undistorted picture of 60×40 pixels at a focal length of 40; the edge is at 0.75.
fn straight_width(fields: &Value) -> u32 {
    let mut set = Transforms::new(1);
    image::RgbImage::from_pixel(60, 40, image::Rgb([9; 3])).save(set.path("images/f_0.png")).unwrap();
    for (key, value) in [("fl_x", 40.0), ("fl_y", 40.0), ("cx", 30.0), ("cy", 20.0), ("w", 60.0), ("h", 40.0)]
    {
        set.json[key] = json!(value);
    }
    set.json.as_object_mut().unwrap().remove("camera_model");
    for (key, value) in fields.as_object().unwrap() {
        set.json[key] = value.clone();
    }
    let view = set.read(Split::Test).unwrap().views.remove(0);
    let image = view.photograph.unwrap().image();
    assert_eq!((image.width, image.height), (view.camera.width, view.camera.height));
    image.width
}

#[test]
fn distortion_is_undone_by_every_model() {
    // The half width a that is seen at 29.5 / 40, by the model's formula, in pixels.
    let expected = |seen: fn(f64) -> f64| {
        let (mut low, mut high) = (0.1f64, 2.0f64);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if seen(middle) < 29.5 / 40.0 { low = middle } else { high = middle }
        }
        // Of columns at half pixels from the center.
        2 * (40.0 * low - 0.5 + 1e-3).floor() as u32 + 2
    };
    assert_eq!(straight_width(&json!({})), 60);
    assert_eq!(straight_width(&json!({"camera_model": "PINHOLE", "k1": 0.0})), 60);
    let barrel = expected(|a| a * (1.0 - 0.2 * a * a + 0.1 * a.powi(8)));
    assert!(barrel > 62);
    assert_eq!(straight_width(&json!({"k1": -0.2, "k4": 0.1})), barrel);
    assert_eq!(straight_width(&json!({"camera_model": "opencv", "k1": -0.2, "k4": 0.1})), barrel);
    let full = expected(|a| a * (1.0 - 0.1 * a * a) / (1.0 + 0.1 * a * a));
    assert_eq!(straight_width(&json!({"camera_model": "FULL_OPENCV", "k1": -0.1, "k4": 0.1})), full);
    let full = expected(|a| a * (1.0 - 0.1 * a * a) / (1.0 + 0.05 * a.powi(6)));
    assert_eq!(straight_width(&json!({"k1": -0.1, "k6": 0.05})), full, "only the full model has k6");
    let fisheye = expected(|a| a.atan() * (1.0 + 0.05 * a.atan().powi(2)));
    assert!(fisheye > 66);
    assert_eq!(straight_width(&json!({"camera_model": "OPENCV_FISHEYE", "k1": 0.05})), fisheye);
    assert_eq!(straight_width(&json!({"is_fisheye": true, "k1": 0.05})), fisheye);
}

#[test]
fn lenses_that_cannot_be_read_are_refused() {
    let set = Transforms::new(1);
    let model = |name: &str| {
        let name = name.to_owned();
        set.wrong(move |json| json["camera_model"] = json!(name))
    };
    assert_says(
        &model("EQUIRECTANGULAR"),
        &["frame 0", "camera_model EQUIRECTANGULAR cannot be read", "OPENCV_FISHEYE"],
    );
    assert_says(&model("FISHEYE624"), &["FISHEYE624"]);
    assert_says(&set.wrong(|json| json["ftheta_p0"] = json!(0.1)), &["`ftheta_p0`"]);
    assert_says(&set.wrong(|json| json["equirectangular"] = json!(true)), &["`equirectangular`"]);
    assert_says(&set.wrong(|json| json["camera_model"] = json!(3)), &["line 1, column", "expected a string"]);
    assert_says(&set.wrong(|json| json["k1"] = json!(-30.0)), &["frame 0", "folds the image over"]);
    assert_says(
        &set.wrong(|json| json["fl_x"] = json!(1e-40)),
        &["transforms.json, frame 0", "1e-40", "must lie between"],
    );
    assert_says(&set.wrong(|json| json["fl_y"] = json!(1e30)), &["1e30", "must lie between"]);
    assert_says(
        &set.wrong(|json| json["cx"] = json!(900.0)),
        &["principal point is (900, 2)", "10 image sizes"],
    );
    let of_frame = set.wrong(|json| json["frames"][0]["k2"] = json!("x"));
    assert_says(&of_frame, &["line 1, column", "invalid type"]);
}

#[test]
fn poses_must_be_rigid() {
    let set = Transforms::new(1);
    let row = |row: usize, values: [f64; 4]| {
        set.wrong(move |json| json["frames"][0]["transform_matrix"][row] = json!(values))
    };
    assert_says(
        &row(0, [-1.0, 0.0, 0.0, 0.0]),
        &["frame 0", "transform_matrix is a reflection (determinant −1)"],
    );
    let scaled = set.wrong(|json| {
        for i in 0..3 {
            json["frames"][0]["transform_matrix"][i][i] = json!(0.25);
        }
    });
    assert_says(
        &scaled,
        &["transform_matrix is not rigid", "(scale 0.2500)", "is a rotation and a translation"],
    );
}

#[test]
fn fields_of_view_may_be_in_degrees() {
    let mut set = Transforms::new(1);
    set.json.as_object_mut().unwrap().remove("fl_x");
    set.json["x_fov"] = json!(90.0);
    let camera = set.read(Split::Test).unwrap().views[0].camera;
    assert!((camera.focal[0] - 3.0).abs() < 1e-6 && camera.focal[1] == 9.0);
}
