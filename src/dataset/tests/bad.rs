//! Data sets with something wrong: each gives one clear error.

use super::*;

#[test]
fn unrecognized_folders_say_what_was_looked_for() {
    let dir = tempfile::tempdir().unwrap();
    let read = |path: &Path| input_error(read_dataset(path, Split::Train, &DatasetOptions::default()));
    fs::write(dir.path().join("a.exr"), "").unwrap();
    assert_says(&read(dir.path()), &["train/cam_dict_norm.json", "transforms_train.json", "1 .exr file"]);
    assert_says(&read(&dir.path().join("nowhere")), &["no such folder"]);
    assert_says(&read(&dir.path().join("a.exr")), &["a file, not a folder"]);
    let set = PhySg::new(1);
    assert_says(&read(&set.path("train")), &["give the folder above"]);
    fs::write(set.path("transforms_test.json"), "{}").unwrap();
    assert_says(&input_error(set.read()), &["several layouts: PhySg, Nerf", "layout: PhySg"]);
    let told = DatasetOptions { layout: Layout::PhySg, ..DatasetOptions::default() };
    assert_eq!(set.read_with(&told).unwrap().layout, Layout::PhySg);
}

#[test]
fn absent_splits_say_which_there_are() {
    let set = Nerf::new(1);
    let text = input_error(read_split(set.dir.path(), Split::Train));
    assert_says(
        &text,
        &["no train split", "transforms_train.json", "There is a test split only. Add the train"],
    );
}

#[test]
fn a_truncated_exr_is_named() {
    let set = PhySg::new(2);
    let path = set.path("train/image/v_1.exr");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() - 20]).unwrap();
    assert_says(&input_error(set.read()), &["v_1.exr", "damaged or truncated"]);
}

#[test]
fn a_missing_image_is_named() {
    let set = PhySg::new(2);
    fs::remove_file(set.path("train/image/v_1.exr")).unwrap();
    assert_says(&input_error(set.read()), &["v_1.exr", "missing", "The folder has 1 .exr file"]);
    let set = Nerf::new(2);
    fs::remove_file(set.path("test/r_1.png")).unwrap();
    assert_says(&input_error(set.read()), &["frame 1", "r_1", "missing", "1 .png file"]);
    fs::remove_file(set.path("test/r_0.png")).unwrap();
    assert_says(&input_error(set.read()), &["frame 0", "missing", "nothing in it"]);
}

#[test]
fn a_missing_mask_is_named() {
    let set = PhySg::new(2);
    fs::remove_file(set.path("train/mask/v_1.png")).unwrap();
    assert_says(&input_error(set.read()), &["mask/v_1", "missing", "1 .png file"]);
    fs::remove_dir_all(set.path("train/mask")).unwrap();
    assert_says(&input_error(set.read()), &["v_0", "no mask", "no folder", "no alpha"]);
}

#[test]
fn an_empty_mask_names_the_view() {
    let set = PhySg::new(3);
    set.write_mask(1, |_, _| 0);
    assert_says(&input_error(set.read()), &["mask/v_1.png", "view `v_1` is empty", "select"]);
}

#[test]
fn sizes_have_to_match() {
    let set = PhySg::new(1);
    GrayImage::from_pixel(5, 4, image::Luma([255])).save(set.path("train/mask/v_0.png")).unwrap();
    assert_says(&input_error(set.read()), &["mask/v_0.png", "5×4", "6×4"]);
    let mut set = PhySg::new(1);
    set.spoil(0, "img_size", json!([6, 5]));
    assert_says(&input_error(set.read()), &["image/v_0.exr", "6×4", "6×5", "camera `v_0.exr`"]);
    let mut set = Nerf::new(1);
    set.json["w"] = json!(60);
    set.json["h"] = json!(40);
    set.write();
    assert_says(&input_error(set.read()), &["r_0.png", "6×4", "60×40"]);
}

#[test]
fn an_image_that_is_all_nan_is_an_error() {
    let set = PhySg::new(1);
    let channels = ["R", "G", "B"].map(|c| (c, vec![f32::NAN; 24]));
    write_exr(&set.path("train/image/v_0.exr"), 6, 4, &channels);
    assert_says(&input_error(set.read()), &["v_0.exr", "every pixel is NaN"]);
}

/// The error after entry `index` of a matrix has been set to `value`.
fn spoiled_matrix(field: &str, index: usize, value: f64) -> String {
    let mut set = PhySg::new(1);
    let mut matrix = physg_camera()[field].clone();
    matrix[index] = json!(value);
    set.spoil(0, field, matrix);
    input_error(set.read())
}

#[test]
fn unusable_camera_matrices_are_refused() {
    assert_says(
        &spoiled_matrix("K", 0, 0.0),
        &["camera `v_0.exr`", "K is singular", "focal lengths are 0 and 9"],
    );
    assert_says(&spoiled_matrix("K", 10, 0.0), &["K is singular"]);
    assert_says(&spoiled_matrix("K", 0, -8.0), &["focal length is -8"]);
    assert_says(&spoiled_matrix("K", 4, 1.0), &["not a calibration matrix", "row 2, column 1"]);
    assert_says(&spoiled_matrix("K", 2, 1e300), &["K has a NaN or infinite value in row 1, column 3"]);
    assert_says(&spoiled_matrix("W2C", 8, 0.0), &["camera `v_0.exr`", "W2C is singular"]);
    assert_says(&spoiled_matrix("W2C", 8, -1.1), &["W2C is not rigid"]);
    assert_says(&spoiled_matrix("W2C", 8, 1.0), &["W2C is a reflection"]);
    assert_says(&spoiled_matrix("W2C", 13, 2.0), &["last row"]);
    assert_says(&spoiled_matrix("W2C", 3, -1e200), &["W2C has a NaN or infinite value in row 1, column 4"]);
}

#[test]
fn arrays_of_wrong_length_are_refused() {
    let mut set = PhySg::new(1);
    set.spoil(0, "K", json!(vec![1.0; 9]));
    assert_says(&input_error(set.read()), &["camera `v_0.exr`", "K has 9 numbers, not 16"]);
    let mut set = PhySg::new(1);
    set.spoil(0, "img_size", json!([6]));
    assert_says(&input_error(set.read()), &["img_size has 1 numbers, not 2"]);
    let mut set = Nerf::new(1);
    set.json["frames"][0]["transform_matrix"][2] = json!([0.0, 1.0]);
    set.write();
    assert_says(&input_error(set.read()), &["frame 0", "2 numbers in row 3"]);
    set.json["frames"][0]["transform_matrix"] = json!([[1.0, 0.0, 0.0, 0.0]]);
    set.write();
    assert_says(&input_error(set.read()), &["has 1 rows, not 4"]);
}

#[test]
fn malformed_json_gives_line_and_column() {
    let set = PhySg::new(1);
    let write = |text: &str| fs::write(set.path("train/cam_dict_norm.json"), text).unwrap();
    write("{\n  \"v_0.exr\": {\"K\": [1,, 2]}\n}");
    assert_says(&input_error(set.read()), &["cam_dict_norm.json, line 2, column 23", "JSON is wrong"]);
    write("{\n  \"v_0.exr\": {\"K\": [1.0, NaN]}\n}");
    assert_says(&input_error(set.read()), &["line 2, column", "NaN or infinite, which JSON does not have"]);
    write("{\n  \"v_0.exr\": {\"K\": [1.0, -Infinity]}\n}");
    assert_says(&input_error(set.read()), &["line 2, column", "NaN or infinite"]);
    write("{\"v_0.exr\": {\"K\": \"x\"}}");
    assert_says(&input_error(set.read()), &["line 1, column 21", "expected a sequence"]);
    write("{\"v_0.exr\": {\"K\": []}}");
    assert_says(&input_error(set.read()), &["missing field `W2C`"]);
    write("{\"v_0.exr\": ");
    assert_says(&input_error(set.read()), &["EOF"]);
    write("[]");
    assert_says(&input_error(set.read()), &["an object that maps image names to cameras"]);
    write("");
    assert_says(&input_error(set.read()), &["0 bytes"]);
    fs::write(set.path("train/cam_dict_norm.json"), [0xff, 0xfe, 0]).unwrap();
    assert_says(&input_error(set.read()), &["not UTF-8"]);
    let nerf = Nerf::new(1);
    fs::write(nerf.path("transforms_test.json"), "{\n\"frames\": [{}]}").unwrap();
    assert_says(&input_error(nerf.read()), &["line 2, column", "missing field `transform_matrix`"]);
    fs::write(nerf.path("transforms_test.json"), "{\"camera_angle_x\": 1}").unwrap();
    assert_says(&input_error(nerf.read()), &["missing field `frames`"]);
}

#[test]
fn cameras_too_far_from_the_origin_are_refused() {
    let mut set = Nerf::new(2);
    for i in 0..2 {
        set.json["frames"][i]["transform_matrix"][0][3] = json!(500_000.0 + 3.0 * i as f64);
    }
    set.write();
    assert_says(&input_error(set.read()), &["times farther from the origin", "Subtract (50000"]);
    // Inverted poses of cameras that look at the origin.
    for i in 0..2 {
        for (row, value) in [0.0, 1e-7 * i as f64, 4.0 + 1e-6 * i as f64].into_iter().enumerate() {
            set.json["frames"][i]["transform_matrix"][row][3] = json!(value);
        }
    }
    set.write();
    assert_says(&input_error(set.read()), &["times farther from the origin", "invert each matrix"]);
}

#[test]
fn duplicate_frames_are_refused() {
    let set = PhySg::new(1);
    let camera = physg_camera();
    let text = format!("{{\"v_0.exr\": {camera}, \"v_0.exr\": {camera}}}");
    fs::write(set.path("train/cam_dict_norm.json"), text).unwrap();
    assert_says(&input_error(set.read()), &["two views are called `v_0`", "camera `v_0.exr`"]);
    let mut set = Nerf::new(2);
    set.json["frames"][1]["file_path"] = json!("test/r_0.png");
    set.write();
    assert_says(&input_error(set.read()), &["frame 1", "two views are called `r_0`", "frame 0"]);
}

#[test]
fn views_with_names_that_output_files_cannot_have_are_refused() {
    let long = "a".repeat(210);
    for (name, words) in [
        ("v\u{7}.exr", "the view name `v\\u{7}` holds '\\u{7}'"),
        ("a\nb.exr", "the view name `a\\nb` holds '\\n'"),
        (&format!("{long}.exr"), "has 210 bytes"),
    ] {
        let set = PhySg::new(1);
        for (folder, ending) in [("image", "exr"), ("mask", "png")] {
            let stem = name.strip_suffix(".exr").unwrap();
            let folder = set.path(&format!("train/{folder}"));
            fs::rename(folder.join(format!("v_0.{ending}")), folder.join(format!("{stem}.{ending}")))
                .unwrap();
        }
        let cameras = json!({ name: physg_camera() });
        fs::write(set.path("train/cam_dict_norm.json"), cameras.to_string()).unwrap();
        assert_says(&input_error(set.read()), &["cam_dict_norm.json", words]);
    }
    for name in ["a\u{0}b", "a\u{1b}[2Jb", &"a".repeat(300), "c\u{1b}/b.exr"] {
        let set = PhySg::new(1);
        let cameras = json!({ name: physg_camera() });
        fs::write(set.path("train/cam_dict_norm.json"), cameras.to_string()).unwrap();
        let text = input_error(set.read());
        assert_says(&text, &["cam_dict_norm.json, camera `"]);
        let is_named =
            ["the view name `a", "the path `c\\u{1b}/b.exr` holds"].iter().any(|words| text.contains(words));
        assert!(is_named && text.len() < 600 && !text.contains(char::is_control), "{text:?}");
    }
    for name in ["a\u{0}b", &"a".repeat(300)] {
        let mut set = Nerf::new(1);
        set.json["frames"][0]["file_path"] = json!(name);
        set.write();
        assert_says(&input_error(set.read()), &["transforms_test.json", "frame 0", "view name"]);
    }
}

#[test]
fn camera_files_may_begin_with_a_byte_order_mark() {
    let set = PhySg::new(1);
    let path = set.path("train/cam_dict_norm.json");
    fs::write(&path, format!("\u{feff}{}", fs::read_to_string(&path).unwrap())).unwrap();
    assert_eq!(set.read().unwrap().views.len(), 1);
}

#[cfg(target_os = "linux")]
#[test]
fn views_whose_names_differ_in_case_are_noted() {
    let mut set = PhySg::new(2);
    for (folder, ending) in [("image", "exr"), ("mask", "png")] {
        let folder = set.path(&format!("train/{folder}"));
        fs::rename(folder.join(format!("v_1.{ending}")), folder.join(format!("V_0.{ending}"))).unwrap();
    }
    let camera = set.cameras.remove("v_1.exr").unwrap();
    set.cameras.insert("V_0.exr".to_owned(), camera);
    set.write_cameras();
    let notes = set.read().unwrap().notes;
    assert!(notes.iter().any(|note| note.contains("V_0 and v_0 differ only in case")), "{notes:?}");
}

#[test]
fn nerf_cameras_need_a_lens_and_a_size() {
    let spoiled = |change: fn(&mut Value)| {
        let mut set = Nerf::new(1);
        change(&mut set.json);
        set.write();
        input_error(set.read())
    };
    let text = spoiled(|json| drop(json.as_object_mut().unwrap().remove("camera_angle_x")));
    assert_says(&text, &["frame 0", "neither camera_angle_x nor fl_x"]);
    assert_says(&spoiled(|json| json["camera_angle_x"] = json!(0.0)), &["field of view is 0 radians"]);
    assert_says(&spoiled(|json| json["camera_angle_x"] = json!(40.0)), &["field of view is 40 radians"]);
    assert_says(&spoiled(|json| json["fl_x"] = json!(0.0)), &["frame 0", "focal length is 0"]);
    assert_says(&spoiled(|json| json["w"] = json!(6)), &["only one of w and h"]);
    assert_says(&spoiled(|json| json["cx"] = json!(1e300)), &["principal point"]);
    let size = |json: &mut Value| {
        json["w"] = json!(6.5);
        json["h"] = json!(4);
    };
    assert_says(&spoiled(size), &["6.5 is not a whole number"]);
    assert_says(&spoiled(|json| json["frames"][0]["file_path"] = json!("gone/r_0")), &["nor its size"]);
    assert_says(
        &spoiled(|json| json["frames"][0]["transform_matrix"][0][0] = json!(2.0)),
        &["frame 0", "transform_matrix is not rigid"],
    );
}

#[test]
fn a_frame_without_path_among_others_is_refused() {
    let mut set = Nerf::new(2);
    set.json["frames"][1].as_object_mut().unwrap().remove("file_path");
    set.write();
    assert_says(&input_error(set.read()), &["frame 1", "no file_path"]);
}

#[test]
fn no_views_left_is_an_error() {
    let set = PhySg::new(12);
    let with = |select: &[&str]| {
        let select = Some(select.iter().map(|&name| name.to_owned()).collect());
        usage_error(set.read_with(&DatasetOptions { select, ..DatasetOptions::default() }))
    };
    assert_says(&with(&["v_1", "w_11"]), &["`w_11`", "Near: v_11"]);
    assert_says(&with(&["elephant"]), &["`elephant`", "12 views, from v_0 to v_11"]);
    assert_says(&with(&[]), &["no views are left"]);
    let set = PhySg::new(0);
    assert_says(&input_error(set.read()), &["no views"]);
}

#[test]
fn options_out_of_range_are_refused() {
    let set = PhySg::new(1);
    let with = |options: DatasetOptions| usage_error(set.read_with(&options));
    assert_says(&with(DatasetOptions { every: 0, ..DatasetOptions::default() }), &["at least 1"]);
    assert_says(&with(DatasetOptions { downscale: 0, ..DatasetOptions::default() }), &["at least 1"]);
    assert_says(&with(DatasetOptions { up: Vec3::ZERO, ..DatasetOptions::default() }), &["up"]);
    assert_says(
        &with(DatasetOptions { pixel_center: Some(f32::NAN), ..DatasetOptions::default() }),
        &["pixel_center"],
    );
    assert_says(&with(DatasetOptions { gamma: Gamma::Power(0.0), ..DatasetOptions::default() }), &["gamma"]);
    let options = DatasetOptions { downscale: 5, ..DatasetOptions::default() };
    assert_says(&input_error(set.read_with(&options)), &["downscale: 5 leaves no pixel of 6×4"]);
}
