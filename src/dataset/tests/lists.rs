//! Lists of the splits beside a COLMAP model, and which layout goes before which.

use super::*;
use crate::codec::test_data::npy_matrix;

/// A folder as `llff_colmap_HDR` of Stanford-ORB: EXR photographs that the model calls PNG, and cameras of LLFF as well.
struct Orb {
    dir: TempDir,
}

impl Orb {
    fn new(views: usize) -> Self {
        let set = Self { dir: tempfile::tempdir().unwrap() };
        for folder in ["images", "sparse/0", "sparse/teapot_scene002"] {
            fs::create_dir_all(set.path(folder)).unwrap();
        }
        fs::write(set.path("sparse/0/cameras.txt"), "1 SIMPLE_PINHOLE 6 4 8 3 2").unwrap();
        let lines: String =
            (0..views).map(|i| format!("{} 1 0 0 0 {i} 0 3 1 {i:04}.png\n\n", i + 1)).collect();
        fs::write(set.path("sparse/0/images.txt"), lines).unwrap();
        for name in ["cameras.txt", "images.txt"] {
            fs::write(set.path("sparse/teapot_scene002").join(name), "no model").unwrap();
        }
        for i in 0..views {
            let channels = ["R", "G", "B"].map(|channel| (channel, vec![2.5; 24]));
            write_exr(&set.path(&format!("images/{i:04}.exr")), SIZE.0, SIZE.1, &channels);
            write_mask(&set.path(&format!("masks/{i:04}.png")));
        }
        let row = [0.0, 1.0, 0.0, 0.1, 4.0, -1.0, 0.0, 0.0, 0.2, 6.0, 0.0, 0.0, 1.0, 3.0, 20.0, 1.0, 9.0];
        fs::write(set.path("poses_bounds.npy"), npy_matrix(views, 17, &row.repeat(views))).unwrap();
        fs::write(set.path("poses_bounds_novel.npy"), "not read").unwrap();
        fs::write(set.path("novel_id.txt"), "not/read.png\n").unwrap();
        set
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write(&self, split: &str, text: &str) {
        fs::write(self.path(&format!("{split}_id.txt")), text).unwrap();
    }

    fn read(&self, split: Split) -> Result<LoadedDataset> {
        read_split(self.dir.path(), split)
    }

    fn error(&self) -> String {
        input_error(self.read(Split::Train))
    }

    #[track_caller]
    fn assert_splits(&self, train: &[&str], test: &[&str]) {
        assert_eq!(names(&self.read(Split::Train).unwrap()), train);
        assert_eq!(names(&self.read(Split::Test).unwrap()), test);
    }
}

#[test]
fn listed_views_are_the_splits() {
    let set = Orb::new(5);
    set.write("train", "0001.png\n0003.png\n0004.png\n");
    // Of an editor of Windows, with spaces and blank lines.
    set.write("test", "\u{feff}\r\n0002.png  \r\n\r\n  0000.png\t\r\n0000.png");
    set.assert_splits(&["0001", "0003", "0004"], &["0000", "0002"]);
    let train = set.read(Split::Train).unwrap();
    assert_eq!(train.layout, Layout::Colmap);
    assert_eq!(train.views[0].camera.position(), Vec3::new(-1.0, 0.0, -3.0));
    assert_eq!(mask_of(&train.views[0]).coverage[3..5], [1.0, 0.0]);
    assert_eq!(train.views[0].photograph.as_ref().unwrap().image().pixels[0], Vec3::splat(2.5));
    let none = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
    assert!(has_split(set.dir.path(), Split::Test, &none).unwrap(), "the data brings a test split");
    assert_eq!(names(&read_dataset(set.dir.path(), Split::Test, &none).unwrap()), ["0000", "0002"]);
}

#[test]
fn views_of_no_list_are_left_out_or_train() {
    let set = Orb::new(5);
    set.write("test", "0004\n0000.exr\n");
    set.assert_splits(&["0001", "0002", "0003"], &["0000", "0004"]);
    set.write("train", "0003.png\n");
    fs::remove_file(set.path("masks/0002.png")).unwrap();
    set.assert_splits(&["0003"], &["0000", "0004"]);
    let words =
        "2 views that neither train_id.txt nor test_id.txt has are left out (the first is `0001.png`)";
    let notes = set.read(Split::Train).unwrap().notes;
    assert!(notes.iter().any(|note| note == words), "{notes:?}");
    assert!(!notes.join(" ").contains("have no camera"), "{notes:?}");
    let of_test = set.read(Split::Test).unwrap().notes.join(" ");
    assert!(!of_test.contains("left out"), "{of_test}");
    fs::remove_file(set.path("test_id.txt")).unwrap();
    set.write("train", "0000.png\n0003.png\n0004.png\n");
    set.assert_splits(&["0003", "0004"], &["0000"]);
    let notes = set.read(Split::Train).unwrap().notes.join(" ");
    assert_says(&notes, &["2 views that train_id.txt does not have are left out"]);
    fs::remove_file(set.path("train_id.txt")).unwrap();
    write_mask(&set.path("masks/0002.png"));
    set.assert_splits(&["0001", "0002", "0003", "0004"], &["0000"]);
}

#[test]
fn lists_that_do_not_fit_the_model_name_the_line() {
    let set = Orb::new(3);
    set.write("test", "0000.png\n\n0007.png\n0009.png\n");
    let words =
        ["test_id.txt, line 3: the model has no image `0007.png`", "Near: 0000.png", "remove the line"];
    assert_says(&set.error(), &words);
    set.write("test", "0000.png\na\u{1b}[2J\n");
    let text = set.error();
    assert!(text.contains("line 2") && !text.contains(char::is_control), "{text:?}");
    set.write("test", "0000.png\n0002.png\n");
    set.write("train", "0001.png\n0002.png\n");
    let words =
        ["test_id.txt, line 2: `0002.png` is in train_id.txt as well, line 2", "belongs to one split"];
    assert_says(&set.error(), &words);
    set.write("train", " \r\n\n");
    assert_says(&set.error(), &["train_id.txt: the list has no names", "or remove the file"]);
    set.write("train", "");
    assert_says(&set.error(), &["train_id.txt: the file is empty"]);
    fs::remove_file(set.path("train_id.txt")).unwrap();
    set.write("test", "0000.png\n0001.png\n0002.png\n");
    assert_says(&set.error(), &["test_id.txt: it lists all views", "`hold_out`"]);
    fs::write(set.path("test_id.txt"), b"\xff\xfe0\x000\x00").unwrap();
    assert_says(&set.error(), &["test_id.txt, byte 0: is not UTF-8 text", "UTF-16"]);
}

/// A sparse file takes no room on the disk.
#[test]
fn absurdly_long_lists_are_refused_before_they_are_read() {
    let set = Orb::new(3);
    fs::File::create(set.path("test_id.txt")).unwrap().set_len(1 << 33).unwrap();
    assert_says(&set.error(), &["test_id.txt", "8192.0 MiB, and at most 16.0 MiB are read"]);
}

#[test]
fn a_model_goes_before_poses_that_are_made_of_it() {
    let set = Orb::new(3);
    let train = set.read(Split::Train).unwrap();
    assert_eq!(train.layout, Layout::Colmap);
    assert_says(&train.notes.join(" "), &["poses_bounds.npy is not read", "`layout: Llff` reads it"]);
    assert!(!set.read(Split::Test).unwrap().notes.join(" ").contains("poses_bounds"));
    let told = |layout| {
        let options = DatasetOptions { layout, hold_out: 0, ..DatasetOptions::default() };
        read_dataset(set.dir.path(), Split::Train, &options).unwrap()
    };
    let llff = told(Layout::Llff);
    assert_eq!((llff.layout, llff.views.len(), llff.views[0].camera.focal), (Layout::Llff, 3, [20.0; 2]));
    for asked in [llff, told(Layout::Colmap)] {
        assert!(!asked.notes.join(" ").contains("poses_bounds"), "{:?}", asked.notes);
    }
    // Photographs of another size alone can be read with the poses only.
    fs::rename(set.path("images"), set.path("images_2")).unwrap();
    assert_eq!(set.read(Split::Train).unwrap().layout, Layout::Llff);
}

#[test]
fn a_model_for_the_record_yields_and_others_do_not() {
    for (kept, layout) in
        [("colmap", Layout::Llff), ("model", Layout::Llff), ("dense/sparse", Layout::Colmap)]
    {
        let set = Orb::new(3);
        fs::create_dir_all(set.path(kept).parent().unwrap()).unwrap();
        fs::rename(set.path("sparse/0"), set.path(kept)).unwrap();
        fs::remove_dir_all(set.path("sparse")).unwrap();
        if kept.starts_with("dense") {
            fs::rename(set.path("images"), set.path("dense/images")).unwrap();
        }
        assert_eq!(set.read(Split::Train).unwrap().layout, layout, "{kept}");
    }
    let set = Orb::new(3);
    fs::write(
        set.path("transforms.json"),
        json!({"fl_x": 8.0, "frames": [nerf_frame("images/0000")]}).to_string(),
    )
    .unwrap();
    assert_says(&set.error(), &["several layouts: Nerf, Colmap", "`layout: Nerf` or `layout: Colmap`"]);
    let error =
        find_layout(set.dir.path(), Layout::Auto, |layout| format!("--layout {layout:?}")).unwrap_err();
    assert_says(error.help().unwrap(), &["--layout Nerf or --layout Colmap"]);
}
