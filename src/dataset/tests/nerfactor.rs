//! The layout of NeRFactor and TensoIR-Synthetic.

use super::*;

const POSE: &str = "1.0,0.0,0.0,0.1,0.0,1.0,0.0,0.2,0.0,0.0,1.0,3.0,0.0,0.0,0.0,1.0";

/// A view's folder with these pictures.
fn write_view(dir: &Path, name: &str, pictures: &[&str]) {
    let folder = dir.join(name);
    fs::create_dir_all(&folder).unwrap();
    let camera = json!({"cam_transform_mat": POSE, "cam_angle_x": 0.8, "imw": 6, "imh": 4, "scene": "lego"});
    fs::write(folder.join("metadata.json"), camera.to_string()).unwrap();
    for (shade, picture) in (1..).zip(pictures) {
        write_photograph(&folder.join(picture), shade);
    }
}

#[test]
fn each_view_has_a_folder_and_a_light_of_its_photograph() {
    let dir = tempfile::tempdir().unwrap();
    for view in ["train_000", "train_010", "train_002"] {
        write_view(dir.path(), view, &["rgba_sunset.png", "rgba_city.png", "albedo.png"]);
    }
    write_view(dir.path(), "test_000", &["rgba.png", "rgba_city.png"]);
    write_view(dir.path(), "val_000", &["rgba.png"]);
    write_view(dir.path(), "train_notes", &["rgba.png"]);
    let train = read_split(dir.path(), Split::Train).unwrap();
    assert_eq!(
        (train.layout, names(&train)),
        (Layout::Nerfactor, vec!["train_000", "train_002", "train_010"])
    );
    let camera = train.views[0].camera;
    assert!((camera.focal[0] - 3.0 / 0.4f32.tan()).abs() < 1e-5);
    assert_eq!(camera.world_from_camera.translation, Vec3::new(0.1, 0.2, 3.0).into());
    assert_eq!(camera.world_from_camera.matrix3.z_axis, Vec3::NEG_Z.into());
    assert_eq!(names(&read_split(dir.path(), Split::Test).unwrap()), ["test_000"]);
    // Files of NeRF's form beside the folders change nothing, and a test view under several other lights is a camera.
    fs::write(
        dir.path().join("transforms_train.json"),
        json!({"frames": [nerf_frame("./train_000/rgba")]}).to_string(),
    )
    .unwrap();
    assert_eq!(read_split(dir.path(), Split::Train).unwrap().layout, Layout::Nerfactor);
    fs::remove_file(dir.path().join("test_000/rgba.png")).unwrap();
    write_photograph(&dir.path().join("test_000/rgba_night.png"), 1);
    let test = read_split(dir.path(), Split::Test).unwrap();
    assert!(test.views[0].photograph.is_none() && test.views[0].camera.width == 6);
    // Without a folder called so, what is called validation is the test split.
    fs::remove_dir_all(dir.path().join("test_000")).unwrap();
    assert_eq!(names(&read_split(dir.path(), Split::Test).unwrap()), ["val_000"]);
}

#[test]
fn the_photograph_is_the_usual_one_or_the_only_one() {
    let dir = tempfile::tempdir().unwrap();
    let planned = |pictures: &[&str]| {
        let folder = dir.path().join("train_000");
        let _ = fs::remove_dir_all(&folder);
        write_view(dir.path(), "train_000", pictures);
        crate::dataset::nerfactor::plan(dir.path(), Split::Train)
            .map(|plan| plan.views[0].image.clone().unwrap())
    };
    assert!(planned(&["rgba_city.png"]).unwrap().ends_with("train_000/rgba_city.png"));
    assert!(planned(&["rgba_sunset.png", "rgba.png"]).unwrap().ends_with("train_000/rgba.png"));
    let text = planned(&["rgba_city.png", "rgba_night.png"]).unwrap_err().to_string();
    assert_says(&text, &["train_000: which is the photograph? There are rgba_city.png, rgba_night.png"]);
    let text = planned(&["albedo.png"]).unwrap_err().to_string();
    assert_says(&text, &["train_000/rgba.png", "photograph of this view is missing"]);
}

#[test]
fn a_wrong_camera_is_named() {
    let dir = tempfile::tempdir().unwrap();
    write_view(dir.path(), "train_000", &["rgba.png"]);
    let file = dir.path().join("train_000/metadata.json");
    let wrong = |pose: &str| {
        let camera = json!({"cam_transform_mat": pose, "cam_angle_x": 0.8, "imw": 6, "imh": 4});
        fs::write(&file, camera.to_string()).unwrap();
        input_error(read_split(dir.path(), Split::Train))
    };
    assert_says(&wrong("1,2,3"), &["train_000/metadata.json: cam_transform_mat has 3 numbers, not 16"]);
    assert_says(&wrong(&POSE.replace("0.1", "x")), &["cam_transform_mat has `x`, which is not a number"]);
    assert_says(&wrong(&POSE.replacen("1.0", "2.0", 1)), &["cam_transform_mat is not rigid"]);
    fs::write(&file, "{}").unwrap();
    assert_says(&input_error(read_split(dir.path(), Split::Train)), &["metadata.json", "cam_transform_mat"]);
    fs::rename(dir.path().join("train_000"), dir.path().join("test_000")).unwrap();
    let text = input_error(read_split(dir.path(), Split::Train));
    assert_says(&text, &["train_000/metadata.json", "no train split"]);
}
