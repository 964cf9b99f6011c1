//! Data sets that bring no test split, in layouts that may have one.

use super::*;

/// The views of both splits without a file of test views: those that `hold_out` makes.
#[track_caller]
fn assert_held_out(dir: &Path, layout: Layout, [train, test]: [&[&str]; 2]) {
    let set = read_split(dir, Split::Train).unwrap();
    assert_eq!((set.layout, names(&set).as_slice()), (layout, train));
    assert_eq!(names(&read_split(dir, Split::Test).unwrap()), test);
    assert!(has_split(dir, Split::Test, &DatasetOptions::default()).unwrap());
    let none = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
    assert!(!has_split(dir, Split::Test, &none).unwrap());
    assert_eq!(read_all(dir).unwrap().views.len(), train.len() + test.len());
    assert_says(
        &input_error(read_dataset(dir, Split::Test, &none)),
        &["the test split has no views", "hold_out: 8"],
    );
}

/// A NeRF data set with a file of frames for each of these words.
fn nerf(words: &[&str], views: usize) -> Nerf {
    let set = Nerf::new(views);
    let text = fs::read(set.path("transforms_test.json")).unwrap();
    fs::remove_file(set.path("transforms_test.json")).unwrap();
    words.iter().for_each(|word| fs::write(set.path(&format!("transforms_{word}.json")), &text).unwrap());
    set
}

#[test]
fn training_views_of_physg_are_held_out() {
    let set = PhySg::new(3);
    assert_held_out(set.dir.path(), Layout::PhySg, [&["v_1", "v_2"], &["v_0"]]);
    let told = DatasetOptions { layout: Layout::PhySg, hold_out: 2, ..DatasetOptions::default() };
    assert_eq!(names(&read_dataset(set.dir.path(), Split::Test, &told).unwrap()), ["v_0", "v_2"]);
}

#[test]
fn training_views_of_nerf_are_held_out() {
    let set = nerf(&["train"], 3);
    assert_held_out(set.dir.path(), Layout::Nerf, [&["r_1", "r_2"], &["r_0"]]);
}

#[test]
fn training_views_of_stanford_orb_are_held_out() {
    let set = nerf(&["train"], 3);
    (0..3).for_each(|i| write_mask(&set.path(&format!("train_mask/r_{i}.png"))));
    assert_held_out(set.dir.path(), Layout::StanfordOrb, [&["r_1", "r_2"], &["r_0"]]);
}

#[test]
fn training_views_of_deepvoxels_are_held_out() {
    let dir = tempfile::tempdir().unwrap();
    deepvoxels::write_split(&dir.path().join("train"), 3);
    assert_held_out(dir.path(), Layout::DeepVoxels, [&["000001", "000002"], &["000000"]]);
}

#[test]
fn validation_stands_for_a_missing_test_split() {
    let set = nerf(&["train", "val"], 3);
    for split in [Split::Train, Split::Test] {
        assert_eq!(names(&read_split(set.dir.path(), split).unwrap()), ["r_0", "r_1", "r_2"]);
    }
    let none = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
    assert!(has_split(set.dir.path(), Split::Test, &none).unwrap());
    for name in ["train_mask", "val_mask"] {
        (0..3).for_each(|i| write_mask(&set.path(&format!("{name}/r_{i}.png"))));
    }
    let test = read_split(set.dir.path(), Split::Test).unwrap();
    assert!(test.layout == Layout::StanfordOrb && test.views.iter().all(|view| view.mask.is_some()));
    let set = nerf(&["train", "val"], 1);
    let one = read_split(set.dir.path(), Split::Test).unwrap();
    fs::write(set.path("transforms_test.json"), "{\"camera_angle_x\": 0.8, \"frames\": []}").unwrap();
    assert_says(&input_error(read_split(set.dir.path(), Split::Test)), &["the test split has no views"]);
    assert_eq!(one.views.len(), 1, "a test split goes first");
}
