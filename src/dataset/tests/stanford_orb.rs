//! Stanford-ORB's layout.

use super::*;

/// Two training views and a test view, EXR, lit all over.
fn write_set(dir: &Path) {
    for (split, views) in [("train", 2), ("test", 1)] {
        fs::create_dir_all(dir.join(split)).unwrap();
        let frames: Vec<Value> = (0..views).map(|i| nerf_frame(&format!("{split}/{i:04}"))).collect();
        let json = json!({ "camera_angle_x": 0.8, "frames": frames });
        fs::write(dir.join(format!("transforms_{split}.json")), json.to_string()).unwrap();
        for i in 0..views {
            let channels = ["R", "G", "B"].map(|c| (c, vec![2.5; 24]));
            write_exr(&dir.join(format!("{split}/{i:04}.exr")), SIZE.0, SIZE.1, &channels);
            write_mask(&dir.join(format!("{split}_mask/{i:04}.png")));
        }
    }
}

#[test]
fn masks_come_from_their_own_folders_and_cut_the_background() {
    let dir = tempfile::tempdir().unwrap();
    write_set(dir.path());
    let train = read_split(dir.path(), Split::Train).unwrap();
    assert_eq!((train.layout, names(&train)), (Layout::StanfordOrb, vec!["0000", "0001"]));
    assert_says(&train.notes.join(" "), &["made black in 2 photographs"]);
    let view = &train.views[1];
    assert_eq!(mask_of(view).coverage[3..5], [1.0, 0.0]);
    assert_eq!(view.photograph.as_ref().unwrap().image().pixels[3..5], [Vec3::splat(2.5), Vec3::ZERO]);
    assert!((view.camera.focal[0] - 3.0 / 0.4f32.tan()).abs() < 1e-5);
    assert_eq!(names(&read_split(dir.path(), Split::Test).unwrap()), ["0000"]);
}

#[test]
fn missing_masks_are_named() {
    let dir = tempfile::tempdir().unwrap();
    write_set(dir.path());
    fs::remove_file(dir.path().join("train_mask/0001.png")).unwrap();
    let text = input_error(read_split(dir.path(), Split::Train));
    assert_says(&text, &["train_mask/0001.png", "mask of `0001` is missing"]);
    fs::remove_dir_all(dir.path().join("test_mask")).unwrap();
    let text = input_error(read_split(dir.path(), Split::Test));
    assert_says(&text, &["test_mask", "folder of the Stanford-ORB layout is missing"]);
    fs::remove_dir_all(dir.path().join("train_mask")).unwrap();
    assert_eq!(read_split(dir.path(), Split::Train).unwrap().layout, Layout::Nerf);
}

#[test]
fn the_same_folder_can_be_read_as_nerfs() {
    let dir = tempfile::tempdir().unwrap();
    write_set(dir.path());
    let options = DatasetOptions { layout: Layout::Nerf, ..DatasetOptions::default() };
    let told = read_dataset(dir.path(), Split::Train, &options).unwrap();
    assert_eq!((told.layout, names(&told)), (Layout::Nerf, vec!["0000", "0001"]));
    assert!(has_split(dir.path(), Split::Test, &options).unwrap());
    // Masks of the other split have names of photographs of this one.
    fs::remove_dir_all(dir.path().join("train_mask")).unwrap();
    write_mask(&dir.path().join("test_mask/0001.png"));
    let told = read_dataset(dir.path(), Split::Train, &options).unwrap();
    assert!(told.views.iter().all(|view| view.mask.is_none()), "{:?}", told.notes);
}
