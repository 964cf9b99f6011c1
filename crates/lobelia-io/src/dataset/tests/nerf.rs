//! The layout of NeRF: files of splits, one `transforms.json` for all views, images that are not
//! where it says, lenses, poses, and Stanford-ORB's masks.

use super::*;

#[test]
fn lists_divide_the_views() {
    let set =
        transforms_of(&["images/0.png", "images/1.png", "images/2.png", "images/3.png", "images/4.png"]);
    set.put(TRANSFORMS, "/test_filenames", json!(["images/1.png", "./images/4.png"]));
    set.assert_splits(&["0", "2", "3"], &["1", "4"]);
    assert!(set.has_test(0), "lists do not need hold_out");
    set.put(TRANSFORMS, "/train_filenames", json!(["images\\2.png"]));
    set.assert_splits(&["2"], &["1", "4"]);
    assert_says(&set.split(Split::Train).notes.join(" "), &["2 views that no list", "left out"]);
    set.put(TRANSFORMS, "/train_filenames", json!(null));
    set.put(TRANSFORMS, "/val_filenames", json!(["images/0.png"]));
    set.assert_splits(&["2", "3"], &["1", "4"]);
    set.put(TRANSFORMS, "/test_filenames", json!([]));
    set.assert_splits(&["1", "2", "3", "4"], &["0"]);
    set.put(TRANSFORMS, "/val_filenames", json!([]));
    set.put(TRANSFORMS, "/train_filenames", json!(["images/2.png", "images/3.png"]));
    set.assert_splits(&["3"], &["2"]);
    assert!(set.has_test(8) && !set.has_test(0), "of the training list, hold_out makes a test split");
    let text = set.error_with(TRANSFORMS, "/train_filenames", json!(["images/9.png"]));
    assert_says(
        &text,
        &["transforms.json, train_filenames", "no view with the image `images/9.png`", "Near: "],
    );
}

#[test]
fn the_reconstruction_that_nerfstudio_keeps_is_no_second_layout() {
    let set = model("colmap/sparse/0", &["images/0.png"], &["0.png"]);
    set.write(TRANSFORMS, json!({"fl_x": 8.0, "frames": [nerf_frame("images/0.png")]}).to_string());
    assert_eq!(set.all().layout, Layout::Nerf);
    let options = DatasetOptions { layout: Layout::Colmap, ..DatasetOptions::default() };
    assert_eq!(names(&set.all_with(options).unwrap()), ["0"]);
    set.remove(TRANSFORMS);
    assert_eq!(set.all().layout, Layout::Colmap);
}

#[test]
fn masks_are_those_named_or_those_beside() {
    let set = transforms_of(&["images/0.png", "images/1.png"]);
    set.mask("masks/1.png");
    assert_says(&set.error(), &["masks/0.png", "the mask of `0.png` is missing"]);
    set.mask("masks/0.png");
    assert!(set.all().views.iter().all(is_masked));
    set.remove("masks");
    set.mask("images/own.png");
    (0..2).for_each(|i| set.put(TRANSFORMS, &format!("/frames/{i}/mask_path"), json!("images\\own")));
    assert!(set.all().views.iter().all(is_masked));
    let with = |path: &str| set.error_with(TRANSFORMS, "/frames/1/mask_path", json!(path));
    assert_says(&with("images/gone.png"), &["images/gone.png", "no such file"]);
    assert_says(&with("masks/\u{1b}[2J.png"), &["frame 1", "the path `masks/\\u{1b}[2J.png` holds"]);
}

#[test]
fn masks_of_photographs_in_folders_are_in_the_same_or_above() {
    let set = transforms_of(&["images/left/0.png", "images/right/0.png"]);
    ["left", "right"].iter().for_each(|side| set.mask(&format!("masks/{side}/0.png")));
    let read = set.all();
    assert_eq!(names(&read), ["left_0", "right_0"]);
    assert!(read.views.iter().all(is_masked));
    set.remove("masks/right/0.png");
    assert_says(&set.error(), &["the mask of `0.png` is missing"]);
    let set = transforms_of(&["images/left/0.png", "images/right/1.png"]);
    (0..2).for_each(|i| set.mask(&format!("masks/{i}.png")));
    assert!(set.all().views.iter().all(is_masked));
    // Of the whole path first.
    GrayImage::from_pixel(6, 4, Luma([255])).save(set.file("masks/left/0.png")).unwrap();
    assert_eq!(mask_of(&set.all().views[0]).coverage[4], 1.0);
}

#[test]
fn applied_transforms_are_noted() {
    let set = transforms_of(&["images/0.png"]);
    let notes = |second: [f64; 3]| {
        let [a, b, c] = second;
        let rows = json!([[1.0, 0.0, 0.0, 0.0], [a, b, c, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        set.put(TRANSFORMS, "/applied_transform", rows);
        set.all().notes.join(" ")
    };
    assert_eq!(notes([0.0, 1.0, 0.0]), "");
    assert_says(&notes([0.0, 0.0, 1.0]), &["applied_transform is not undone"]);
    assert!(set.all().views[0].camera.position().distance(Vec3::new(0.1, 0.2, 3.0)) < 1e-6);
}

/// A photograph of 60×40 pixels at a focal length of 40; the edge is at 0.75.
fn wide() -> Set {
    let set = transforms(&[], &["images/0.png"]);
    RgbImage::from_pixel(60, 40, Rgb([9; 3])).save(set.file("images/0.png")).unwrap();
    for (key, value) in [("fl_x", 40), ("fl_y", 40), ("cx", 30), ("cy", 20), ("w", 60), ("h", 40)] {
        set.put(TRANSFORMS, &format!("/{key}"), json!(value));
    }
    set
}

#[test]
fn distortion_is_undone_by_every_model() {
    let width = |fields: Value| {
        let set = wide();
        for (key, value) in fields.as_object().unwrap() {
            set.put(TRANSFORMS, &format!("/{key}"), value.clone());
        }
        let view = set.all().views.remove(0);
        let size = view.photograph.unwrap().size();
        assert_eq!(size, [view.camera.width, view.camera.height]);
        size[0]
    };
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
    let barrel = expected(|a| a * (1.0 - 0.2 * a * a + 0.1 * a.powi(8)));
    let full = expected(|a| a * (1.0 - 0.1 * a * a) / (1.0 + 0.1 * a * a));
    let of_k6 = expected(|a| a * (1.0 - 0.1 * a * a) / (1.0 + 0.05 * a.powi(6)));
    let fisheye = expected(|a| a.atan() * (1.0 + 0.05 * a.atan().powi(2)));
    assert!(barrel > 62 && fisheye > 66);
    for (fields, expected) in [
        (json!({}), 60),
        (json!({"camera_model": "PINHOLE", "k1": 0.0}), 60),
        (json!({"k1": -0.2, "k4": 0.1}), barrel),
        (json!({"camera_model": "opencv", "k1": -0.2, "k4": 0.1}), barrel),
        (json!({"distortion_params": [-0.2, 0, 0, 0.1, 0, 0], "k1": 9}), barrel),
        (json!({"camera_model": "FULL_OPENCV", "k1": -0.1, "k4": 0.1}), full),
        // Only the full model has k6.
        (json!({"k1": -0.1, "k6": 0.05}), of_k6),
        (json!({"camera_model": "OPENCV_FISHEYE", "k1": 0.05}), fisheye),
        (json!({"is_fisheye": true, "k1": 0.05}), fisheye),
    ] {
        assert_eq!(width(fields.clone()), expected, "{fields}");
    }
}

#[test]
fn what_a_pinhole_cannot_show_is_cropped_with_a_note() {
    let set = wide();
    set.put(TRANSFORMS, "/is_fisheye", json!(true));
    for (focal, is_cropped) in [(40, false), (22, true)] {
        ["/fl_x", "/fl_y"].iter().for_each(|field| set.put(TRANSFORMS, field, json!(focal)));
        let notes = set.all().notes.join(" ");
        let note = "1 photographs show more than a pinhole camera can";
        assert_eq!(notes.contains(note), is_cropped, "{notes}");
    }
}

#[test]
fn intrinsics_of_a_frame_go_before_the_shared_ones() {
    let set = transforms_of(&["images/0.png", "images/1.png"]);
    let params = json!([-0.01, 0.002, 0.003, 0.0, 0.004, 0.005]);
    for (pointer, value) in [
        ("/cx", json!(2.75)),
        ("/distortion_params", params),
        ("/frames/1/distortion_params", json!([0.02, 0, 0, 0, 0, 0])),
        ("/frames/1/fl_x", json!(7.0)),
        ("/frames/1/x_fov", json!(1.0)),
        ("/frames/1/camera_angle_y", json!(1.0)),
        ("/frames/1/h", json!(4.0)),
    ] {
        set.put(TRANSFORMS, pointer, value);
    }
    let plan = crate::dataset::nerf::plan(set.0.path(), Split::Train, None).unwrap();
    let [shared, own] = [0, 1].map(|n| plan.views[n].lens);
    let of = shared.distortion;
    assert_eq!((of.radial, of.tangential), ([-0.01, 0.002, 0.003, 0.0], [0.004, 0.005]));
    let of = own.distortion;
    assert_eq!((of.radial[0], of.radial[1], of.tangential), (0.02, 0.0, [0.0; 2]));
    let camera = |lens: lens::Lens| lens.camera(SIZE, glam::Affine3A::IDENTITY, 0.5).unwrap();
    assert_eq!((camera(shared).focal, camera(shared).center), ([8.0, 9.0], [2.75, 2.0]));
    assert_eq!((camera(own).focal[0], own.size), (7.0, Some(SIZE)));
    assert!((camera(own).focal[1] - 2.0 / 0.5f32.tan()).abs() < 1e-5);
}

#[test]
fn cameras_that_cannot_be_read_are_refused() {
    let set = transforms_of(&["images/0.png"]);
    let file = "transforms.json, frame 0";
    for (pointer, value, words) in [
        (
            "/camera_model",
            json!("EQUIRECTANGULAR"),
            [file, "camera_model EQUIRECTANGULAR cannot be read", "OPENCV_FISHEYE"],
        ),
        ("/ftheta_p0", json!(0.1), [file, "`ftheta_p0`", ""]),
        ("/equirectangular", json!(true), [file, "`equirectangular`", ""]),
        ("/camera_model", json!(3), ["line 1, column", "expected a string", ""]),
        ("/frames/0/k2", json!("x"), ["line 1, column", "invalid type", ""]),
        ("/k1", json!(-30.0), [file, "folds the image over", ""]),
        (
            "/distortion_params",
            json!([0.1, 0.2]),
            [file, "distortion_params has 2 numbers, not 6", "k1, k2, k3, k4"],
        ),
        ("/fl_x", json!(1e-40), [file, "1e-40", "must lie between"]),
        ("/fl_x", json!(0), [file, "focal length is 0", ""]),
        ("/fl_x", json!(null), [file, "neither camera_angle_x nor fl_x", ""]),
        ("/cx", json!(900.0), [file, "principal point is (900, 2)", "10 image sizes"]),
        ("/w", json!(null), [file, "only one of w and h", ""]),
        ("/w", json!(6.5), [file, "6.5×4 is not whole numbers", ""]),
        ("/w", json!(60), ["images/0.png", "6×4", "60×4"]),
        ("/frames/0/transform_matrix/0/0", json!(2.0), [file, "transform_matrix is not rigid", ""]),
        ("/frames/0/transform_matrix/2", json!([0.0, 1.0]), [file, "2 numbers in row 3", ""]),
        ("/frames/0/transform_matrix", json!([[1.0, 0.0, 0.0, 0.0]]), [file, "has 1 rows, not 4", ""]),
        ("/frames/0", json!({}), [file, "transform_matrix has 0 rows", ""]),
        ("/frames", json!([]), ["transforms.json", "the train split has no views", "Export"]),
        ("/frames/0/file_path", json!(""), [file, "file_path is empty", "path of the frame's image"]),
    ] {
        assert_says(&set.error_with(TRANSFORMS, pointer, value), &words);
    }
    let long = set.error_with(TRANSFORMS, "/frames/0/file_path", json!("x".repeat(3000)));
    assert!(long.contains("has 3000 bytes") && long.contains("xxx…`") && long.len() < 600, "{long}");
    set.remove("images");
    ["/w", "/h"].iter().for_each(|side| set.put(TRANSFORMS, side, json!(null)));
    assert_says(&set.error(), &[file, "neither an image nor its size", "Add w and h"]);
}

#[test]
fn images_are_found_by_their_names_with_one_note() {
    for (folder, named) in [
        ("images/", "/home/me/scan/images/"),
        ("images/", "../images/"),
        ("images/", "C:\\Users\\me\\scan\\images\\"),
        ("images/", "photos/"),
        ("", "/home/me/scan/images/"),
    ] {
        // The second is named without extension.
        let [a, b, c, d] = ["f_0.png", "f_1.png", "f_0.png", "f_1"];
        let set = transforms(
            &[&format!("{folder}{a}"), &format!("{folder}{b}")],
            &[&format!("{named}{c}"), &format!("{named}{d}")],
        );
        let read = set.all();
        assert_eq!((names(&read), read.notes.len()), (vec!["f_0", "f_1"], 1), "{named} {:?}", read.notes);
        assert!(read.views.iter().all(|view| view.photograph.is_some()), "{named}");
        assert_says(&read.notes[0], &["not where transforms.json says, e.g. `", "f_0.png`", "same names in"]);
        assert!(set.split(Split::Test).notes.is_empty());
    }
    // Masks have moved as well.
    let set = transforms(&["images/0.png"], &["/home/me/images/0.png"]);
    set.mask("masks/0.png");
    assert!(set.all().views.iter().all(is_masked));
    set.put(TRANSFORMS, "/frames/0/mask_path", json!("/home/me/masks/0.png"));
    assert!(set.all().views.iter().all(is_masked));
    let elsewhere = nerf(2);
    let absolute = elsewhere.path("r/r_1.png").display().to_string();
    let sideways = format!("../{}/r/r_0", elsewhere.0.path().file_name().unwrap().to_string_lossy());
    let set = transforms(&[], &[&absolute, &sideways]).all();
    assert_eq!(names(&set), ["r_0", "r_1"]);
    assert!(set.views.iter().all(|view| view.photograph.is_some()));
}

#[test]
fn images_may_have_been_converted_or_renamed_since() {
    for (photograph, named) in [
        ("images/a.PNG", "images/a.png"),
        ("images/a.png", "images/a.jpg"),
        ("images/a.PNG", "images/a"),
        ("images/a.png", "/home/me/images/a.JPG"),
    ] {
        let set = transforms(&[photograph], &[named]).all();
        assert!(names(&set) == ["a"] && set.views[0].photograph.is_some(), "{photograph} for {named}");
    }
    // Letters with accents are one character in most files of cameras, and two in names of files on
    // macOS.
    let set = transforms(&[&format!("images/{DECOMPOSED}.png")], &[&format!("/home/me/images/{COMPOSED}")]);
    set.mask(&format!("masks/{DECOMPOSED}.png"));
    let set = set.all();
    assert!(names(&set) == [COMPOSED] && set.views[0].photograph.is_some() && is_masked(&set.views[0]));
    // Of two that it could be, none is taken; what is there and is no file is not called missing.
    let set = transforms(&["images/a.png", "images/b.png"], &["images/a.jpg", "images/b.png"]);
    fs::copy(set.path("images/a.png"), set.path("images/a.webp")).unwrap();
    assert_says(&set.error(), &["images/a.jpg", "is missing"]);
    fs::create_dir(set.path("images/a.jpg")).unwrap();
    assert_says(&set.error(), &["images/a.jpg: this is a folder, not a file"]);
}

#[test]
fn moved_images_are_kept_apart() {
    let images = ["/home/me/images/left/0.png", "/home/me/images/right/0.png"];
    let set = transforms(&["images/left/0.png", "images/right/0.png"], &images).all();
    assert_eq!(names(&set), ["left_0", "right_0"]);
}

#[test]
fn images_that_are_nowhere_are_named_where_there_are_others() {
    for folder in ["images/", ""] {
        let text = transforms(&[&format!("{folder}other.png")], &["/home/me/f_0.png"]).error();
        let words = ["transforms.json", "e.g. `/home/me/f_0.png`", "other names", "correct each file_path"];
        assert_says(&text, &words);
    }
    let text = transforms(&["images/f_0.png"], &["/home/me/f_0.png", "/home/me/f_1.png"]).error();
    assert_says(&text, &["frame 1 (`/home/me/f_1.png`)", "images/f_1.png", "is missing"]);
    let set = transforms(&[], &["/home/me/f_0.png"]);
    let read = set.all();
    assert!(read.views[0].photograph.is_none());
    assert_says(&read.notes.join(" "), &["cameras only", "transforms.json", "`/home/me/f_0.png`"]);
    set.write("images/f_0.heic", HEIC);
    assert_says(&set.error(), &["f_0.heic: this is a HEIC"]);
}

#[test]
fn validation_stands_for_a_missing_test_split() {
    let set = nerf_of(&["train", "val"], 3);
    set.assert_splits(&["r_0", "r_1", "r_2"], &["r_0", "r_1", "r_2"]);
    assert!(set.has_test(0));
    for folder in ["train_mask", "val_mask"] {
        (0..3).for_each(|i| set.mask(&format!("{folder}/r_{i}.png")));
    }
    let test = set.split(Split::Test);
    assert!(test.layout == Layout::StanfordOrb && test.views.iter().all(|view| view.mask.is_some()));
    let set = nerf_of(&["train", "val"], 1);
    set.write("transforms_test.json", "{\"camera_angle_x\": 0.8, \"frames\": []}");
    let text = input_error(set.open_with(Split::Test, &DatasetOptions::default()));
    assert_says(&text, &["transforms_test.json", "the test split has no views"]);
}

/// A data set whose poses are a turn about all axes, with numbers of so many decimals.
fn with_decimals(decimals: [i32; 3]) -> Set {
    let turn = glam::DMat3::from_rotation_z(0.7)
        * glam::DMat3::from_rotation_y(0.4)
        * glam::DMat3::from_rotation_x(1.0);
    let set = nerf(3);
    for (index, decimals) in decimals.into_iter().enumerate() {
        let unit = 10f64.powi(decimals);
        let at = |i: usize, k: usize| (turn.col(k)[i] * unit).round() / unit;
        let rows: Vec<Vec<f64>> = (0..3).map(|i| vec![at(i, 0), at(i, 1), at(i, 2), index as f64]).collect();
        set.put(NERF_FILE, &format!("/frames/{index}/transform_matrix"), json!(rows));
    }
    set
}

#[test]
fn poses_of_three_decimals_are_made_exact_with_a_note_and_of_one_refused() {
    assert!(with_decimals([8, 6, 5]).all().notes.is_empty());
    let set = with_decimals([3, 8, 3]).all();
    let words =
        ["the poses of 2 views are written with too few decimals", "(r_", "off by 1.", "`cameras: Poses`"];
    assert_says(&set.notes.join(" "), &words);
    let [rounded, exact] = [0, 1].map(|i| set.views[i].camera.ray(3.0, 2.0).direction);
    assert!((rounded.length() - 1.0).abs() < 1e-6 && rounded.distance(exact) < 2e-3, "{rounded} {exact}");
    assert_says(&with_decimals([8, 1, 8]).error(), &["frame 1", "transform_matrix is not rigid"]);
}

/// Stanford-ORB's: two training views and a test view, EXR, lit all over.
#[test]
fn masks_of_splits_come_from_their_own_folders_and_cut_the_background() {
    let set = Set::new();
    for (split, views) in [("train", 2), ("test", 1)] {
        let frames: Vec<Value> = (0..views).map(|i| nerf_frame(&format!("{split}/{i:04}"))).collect();
        let json = json!({ "camera_angle_x": 0.8, "frames": frames });
        set.write(&format!("transforms_{split}.json"), json.to_string());
        for i in 0..views {
            set.exr(&format!("{split}/{i:04}.exr"), &["R", "G", "B"], 2.5, 2.5);
            set.mask(&format!("{split}_mask/{i:04}.png"));
        }
    }
    let train = set.split(Split::Train);
    assert_eq!((train.layout, names(&train)), (Layout::StanfordOrb, vec!["0000", "0001"]));
    assert_says(&train.notes.join(" "), &["made black in 2 photographs"]);
    assert!(train.views.iter().all(is_masked));
    let photograph = train.views[1].photograph.as_ref().unwrap();
    assert_eq!([3, 4].map(|pixel| photograph.radiance(pixel)), [Vec3::splat(2.5), Vec3::ZERO]);
    assert_eq!(names(&set.split(Split::Test)), ["0000"]);
    // Read as NeRF's, there are no masks: those of the other split have names of photographs of
    // this one.
    set.remove("train_mask");
    set.mask("test_mask/0001.png");
    let options = DatasetOptions { layout: Layout::Nerf, ..DatasetOptions::default() };
    let told = set.open_with(Split::Train, &options).unwrap();
    assert_eq!((told.layout, names(&told)), (Layout::Nerf, vec!["0000", "0001"]));
    assert!(told.views.iter().all(|view| view.mask.is_none()), "{:?}", told.notes);
}
