//! What holds in all layouts: options, photographs, masks and names, and what is refused; cameras
//! of PhySG and NeRF.

use super::*;

#[test]
fn physg_views_come_with_camera_image_and_mask() {
    let set = physg(2).all();
    assert_eq!((set.layout, names(&set)), (Layout::PhySg, vec!["v_0", "v_1"]));
    assert!(set.notes.is_empty(), "{:?}", set.notes);
    let camera = set.views[1].camera;
    assert_eq!((camera.width, camera.height, camera.skew, camera.pixel_center), (6, 4, 0.5, 0.5));
    assert_eq!((camera.focal, camera.center), ([8.0, 9.0], [3.0, 2.0]));
    // W2C sends the eye to the origin and looks along world −X with world +Y up.
    assert!(camera.position().distance(Vec3::new(3.0, 0.0, 0.25)) < 1e-6);
    assert!(camera.ray(3.0, 2.0).direction.distance(Vec3::NEG_X) < 1e-6);
    let (_, y, _) = camera.project(Vec3::new(0.0, 0.1, 0.25)).unwrap();
    assert!(y < 2.0, "world +Y is up in the image");
    assert_eq!(set.views[1].photograph.as_ref().unwrap().radiance(0), Vec3::splat(1.5));
    assert!(is_masked(&set.views[1]));
}

#[test]
fn nerf_views_come_in_opencv_axes_with_alpha_as_mask() {
    let set = nerf_of(&["train", "test"], 2).split(Split::Test);
    assert_eq!((set.layout, set.views[0].split), (Layout::Nerf, Split::Test));
    assert_eq!(names(&set), ["r_0", "r_1"]);
    let camera = set.views[0].camera;
    assert!((camera.focal[0] - 3.0 / 0.4f32.tan()).abs() < 1e-5);
    assert_eq!((camera.focal[1], camera.center), (camera.focal[0], [3.0, 2.0]));
    assert!(camera.position().distance(Vec3::new(0.1, 0.2, 3.0)) < 1e-6);
    assert!(camera.ray(3.0, 2.0).direction.distance(Vec3::NEG_Z) < 1e-6, "OpenGL cameras look along −Z");
    let (_, y, _) = camera.project(Vec3::new(0.1, 0.5, 0.0)).unwrap();
    assert!(y < 2.0, "world +Y is up in the image");
    assert!(is_masked(&set.views[0]));
    assert_eq!(set.views[0].photograph.as_ref().unwrap().radiance(5), Vec3::ZERO);
}

#[test]
fn names_are_ordered_naturally_and_thinned() {
    let set = physg(12);
    let select = |names: &[&str]| Some(names.iter().map(|name| (*name).to_owned()).collect());
    for (every, selected, expected) in [
        (1, None, "v_0 v_1 v_2 v_3 v_4 v_5 v_6 v_7 v_8 v_9 v_10 v_11"),
        (5, None, "v_0 v_5 v_10"),
        (100, None, "v_0"),
        (2, select(&["v_10", "v_2", "v_3", "v_2"]), "v_2 v_10"),
    ] {
        let options = DatasetOptions { every, select: selected, ..DatasetOptions::default() };
        assert_eq!(names(&set.all_with(options).unwrap()).join(" "), expected);
    }
    for (selected, words) in [
        (["v_1", "w_11"].as_slice(), ["`w_11`", "Near: `v_11`"]),
        (&["elephant"], ["`elephant`", "12 views, from v_0 to v_11"]),
        (&[], ["`select`", "no views are left"]),
    ] {
        let options = DatasetOptions { select: select(selected), ..DatasetOptions::default() };
        let error = set.all_with(options).unwrap_err();
        assert!(matches!(error, Error::Usage { .. }), "{error:?}");
        assert_says(&format!("{error} {}", error.help().unwrap()), &words);
    }
    assert_says(&physg(0).error(), &["no views"]);
}

#[test]
fn downscaling_keeps_image_mask_and_camera_together() {
    let set = physg(1);
    let full = set.all().views.remove(0);
    let options = DatasetOptions { downscale: 2, pixel_center: Some(0.0), ..DatasetOptions::default() };
    let half = set.all_with(options).unwrap().views.remove(0);
    assert_eq!((half.camera.width, half.camera.height, half.camera.pixel_center), (3, 2, 0.0));
    assert_eq!(half.photograph.unwrap().size(), [3, 2]);
    assert_eq!(half.mask.unwrap().mask().coverage, [1.0, 1.0, 0.0, 1.0, 1.0, 0.0]);
    let mut unscaled = full.camera;
    unscaled.pixel_center = 0.0;
    let (a, b) = (unscaled.ray(5.0, 1.0), half.camera.ray(2.5, 0.5));
    assert!(a.direction.distance(b.direction) < 1e-6);
}

#[test]
fn cameras_without_images_are_read() {
    let set = physg(2);
    ["train/image", "train/mask"].iter().for_each(|folder| set.remove(folder));
    let views = set.all().views;
    assert!(views.iter().all(|view| view.photograph.is_none() && view.mask.is_none()));
    let set = nerf(1);
    set.remove("r");
    ["/w", "/h"].iter().zip(SIZE).for_each(|(field, value)| set.put(NERF_FILE, field, json!(value)));
    let unnamed = json!({"transform_matrix": nerf_frame("")["transform_matrix"]});
    set.put(NERF_FILE, "/frames", json!([nerf_frame("r/r_0"), unnamed]));
    let set = set.all();
    assert_eq!(names(&set), ["frame_000001", "r_0"]);
    assert!(set.views.iter().all(|view| view.photograph.is_none() && view.camera.width == 6));
}

#[test]
fn photographs_lose_their_background_and_renderings_keep_their_rim() {
    // Of integers, without alpha.
    let set = physg(1);
    set.remove("train/image/v_0.exr");
    RgbImage::from_pixel(6, 4, Rgb([255, 200, 90])).save(set.path("train/image/v_0.png")).unwrap();
    let read = set.all();
    assert_says(&read.notes.join(" "), &["made black in 1 photographs"]);
    let photograph = read.views[0].photograph.as_ref().unwrap();
    assert_eq!((photograph.radiance(4), photograph.radiance(3).x), (Vec3::ZERO, 1.0));
    assert_eq!([3, 4].map(|i| photograph.is_saturated(i)), [true, false]);
    // Of floats.
    set.remove("train/image/v_0.png");
    set.exr("train/image/v_0.exr", &["R", "G", "B"], 1.0, 3.0);
    let read = set.all();
    assert_says(&read.notes.join(" "), &["made black in 1 photographs"]);
    assert_eq!(read.views[0].photograph.as_ref().unwrap().radiance(4), Vec3::ZERO);
    // Large enough that one lit pixel, in a hole of the mask, is a rim.
    let mut values: Vec<f32> = (0..240).map(|i| if i % 60 < 20 { 1.0 } else { 0.0 }).collect();
    values[65] = 0.001;
    let channels = ["R", "G", "B"].map(|channel| (channel, values.clone()));
    write_exr(&set.path("train/image/v_0.exr"), 60, 4, &channels);
    let value = |x, y| if x < 20 && (x, y) != (5, 1) { 255 } else { 0 };
    GrayImage::from_fn(60, 4, |x, y| Luma([value(x, y)])).save(set.path("train/mask/v_0.png")).unwrap();
    set.put(PHYSG_FILE, "/v_0.exr/img_size", json!([60, 4]));
    let read = set.all();
    assert!(read.notes.is_empty(), "{:?}", read.notes);
    assert_eq!(read.views[0].photograph.as_ref().unwrap().radiance(65), Vec3::splat(0.001));
}

#[test]
fn images_without_camera_are_noted_and_mask_folder_may_be_replaced_by_alpha() {
    let set = physg(1);
    set.exr("train/image/v_0.exr", &["R", "G", "B", "A"], 0.5, 0.5);
    set.exr("train/image/other.exr", &["R", "G", "B"], 0.5, 0.5);
    set.remove("train/mask");
    let set = set.all();
    assert_says(&set.notes.join(" "), &["1 images in", "have no camera"]);
    assert_eq!(mask_of(&set.views[0]).coverage[0], 0.5);
}

#[test]
fn options_out_of_range_are_refused() {
    let set = physg(1);
    let good = DatasetOptions::default;
    for (options, words) in [
        (DatasetOptions { every: 0, ..good() }, "at least 1"),
        (DatasetOptions { downscale: 0, ..good() }, "at least 1"),
        (DatasetOptions { up: Vec3::ZERO, ..good() }, "up"),
        (DatasetOptions { pixel_center: Some(f32::NAN), ..good() }, "pixel_center"),
        (DatasetOptions { gamma: Gamma::Power(0.0), ..good() }, "gamma"),
        (DatasetOptions { hold_out: 1, ..good() }, "hold_out: 1"),
    ] {
        let error = set.open_with(Split::Train, &options).unwrap_err();
        assert!(matches!(error, Error::Usage { .. }) && error.to_string().contains(words), "{error:?}");
    }
    let options = DatasetOptions { downscale: 5, ..good() };
    assert_says(&input_error(set.all_with(options)), &["downscale: 5 leaves no pixel of 6×4"]);
}

#[test]
fn missing_images_and_masks_are_named() {
    let set = physg(2);
    set.remove("train/mask/v_1.png");
    let words =
        ["train/mask/v_1.png", "the mask of `v_1.exr` is missing", "with any image extension", "has v_0.png"];
    assert_says(&set.error(), &words);
    set.mask("train/mask/v_1.png");
    set.remove("train/image/v_1.exr");
    assert_says(&set.error(), &["v_1.exr", "missing", "The folder has v_0.exr"]);
    set.write("train/image/v_1.heic", HEIC);
    assert_says(&set.error(), &["v_1.heic: this is a HEIC, which is not read", "heif-convert"]);
    let set = nerf(2);
    set.remove("r/r_1.png");
    assert_says(&set.error(), &["frame 1", "r_1", "missing", "one file or folder"]);
    set.remove("r/r_0.png");
    assert_says(&set.error(), &["frame 0", "missing", "The folder is empty"]);
}

#[test]
fn masks_are_checked() {
    let set = physg(3);
    GrayImage::new(6, 4).save(set.path("train/mask/v_1.png")).unwrap();
    assert_says(&set.error(), &["mask/v_1.png", "view `v_1` is empty", "select"]);
    // Before pixels are decoded.
    GrayImage::from_fn(60, 40, |x, y| Luma([(x * y) as u8])).save(set.path("train/mask/v_1.png")).unwrap();
    let bytes = fs::read(set.path("train/mask/v_1.png")).unwrap();
    set.write("train/mask/v_1.png", &bytes[..bytes.len() / 2]);
    assert_says(&set.error(), &["mask/v_1.png", "the mask has 60×40 pixels, its view 6×4"]);
}

#[test]
fn cameras_of_physg_are_checked() {
    let set = physg(1);
    let matrix = |field: &str, index: usize, value: f64| {
        set.error_with(PHYSG_FILE, &format!("/v_0.exr/{field}/{index}"), json!(value))
    };
    for (field, index, value, words) in [
        ("K", 0, 0.0, ["camera `v_0.exr`", "K is singular: 0 in row 1, column 1"]),
        ("K", 10, 0.0, ["camera `v_0.exr`", "K is singular"]),
        ("K", 0, -8.0, ["camera `v_0.exr`", "focal length is -8"]),
        ("K", 4, 1.0, ["not a calibration matrix", "row 2, column 1"]),
        ("K", 2, 1e300, ["K has a NaN", "row 1, column 3"]),
        ("W2C", 8, -1.1, ["camera `v_0.exr`", "W2C is not rigid"]),
    ] {
        assert_says(&matrix(field, index, value), &words);
    }
    let with = |field: &str, value| set.error_with(PHYSG_FILE, &format!("/v_0.exr/{field}"), value);
    let words = ["image/v_0.exr", "6×4", "6×5", "camera `v_0.exr`"];
    assert_says(&with("img_size", json!([6, 5])), &words);
    assert_says(&with("img_size", json!([6])), &["line 1, column", "invalid length 1"]);
    assert_says(&with("K", json!(vec![1.0; 9])), &["camera `v_0.exr`", "K has 9 numbers, not 16"]);
}

#[test]
fn malformed_json_gives_line_and_column() {
    let set = physg(1);
    for (text, words) in [
        ("{\n  \"v_0.exr\": {\"K\": [1,, 2]}\n}", ["cam_dict_norm.json, line 2, column 23", "JSON is wrong"]),
        ("{\n  \"v_0.exr\": {\"K\": [1.0, NaN]}\n}", ["line 2, column", "JSON has no NaN and no Infinity"]),
        ("{\"v_0.exr\": {\"K\": \"x\"}}", ["line 1, column 21", "expected a sequence"]),
        ("{\"v_0.exr\": {}}", ["line 1, column", "missing field `K`"]),
        ("{\"v_0.exr\": ", ["line 1, column", "EOF"]),
        ("", ["cam_dict_norm.json", "0 bytes"]),
    ] {
        set.write(PHYSG_FILE, text);
        assert_says(&set.error(), &words);
    }
    set.write(PHYSG_FILE, [0xff, 0xfe, 0]);
    assert_says(&set.error(), &["not UTF-8"]);
    // A byte order mark is none of these.
    let set = physg(1);
    set.write(PHYSG_FILE, format!("\u{feff}{}", fs::read_to_string(set.path(PHYSG_FILE)).unwrap()));
    assert_eq!(set.all().views.len(), 1);
}

#[test]
fn cameras_too_far_from_the_origin_are_refused() {
    let set = nerf(2);
    let moved = |at: fn(f64) -> [f64; 3]| {
        for i in 0..2 {
            for (row, value) in at(i as f64).into_iter().enumerate() {
                set.put(NERF_FILE, &format!("/frames/{i}/transform_matrix/{row}/3"), json!(value));
            }
        }
        set.error()
    };
    let text = moved(|i| [500_000.0 + 3.0 * i, 0.2, 3.0]);
    assert_says(&text, &["times farther from the origin", "Subtract (50000"]);
    // Inverted poses of cameras that look at the origin.
    let text = moved(|i| [0.0, 1e-7 * i, 4.0 + 1e-6 * i]);
    assert_says(&text, &["times farther from the origin", "invert each matrix"]);
}

#[test]
fn names_that_views_cannot_have_are_refused() {
    let set = nerf(2);
    let text = set.error_with(NERF_FILE, "/frames/1/file_path", json!("r/r_0.png"));
    assert_says(&text, &["frame 1", "two views are called `r_0`", "frame 0"]);
    let long = "a".repeat(300);
    for (name, words) in [
        ("v\u{7}.exr", "the view name `v\\u{7}` holds '\\u{7}'"),
        ("a\u{0}b", "the view name `a\\0b` holds"),
        ("a\u{1b}[2Jb", "the view name `a\\u{1b}[2Jb` holds"),
        ("c\u{1b}/b.exr", "the path `c\\u{1b}/b.exr` holds"),
        (&long, "has 300 bytes"),
    ] {
        let set = physg(1);
        set.write(PHYSG_FILE, json!({ name: physg_camera() }).to_string());
        for text in [set.error(), nerf(1).error_with(NERF_FILE, "/frames/0/file_path", json!(name))] {
            assert_says(&text, &[words]);
            assert!(text.len() < 600 && !text.contains(char::is_control), "{text:?}");
        }
    }
}

/// Two photographs of nerfstudio, and their masks as these files.
fn with_masks(masks: [&str; 2]) -> Set {
    let set = transforms_of(&["images/a.png", "images/b.png"]);
    masks.iter().for_each(|mask| set.mask(mask));
    set
}

#[test]
fn masks_are_found_under_their_usual_names_without_case() {
    let all = |found: fn(&ViewRecord) -> bool, masks: [&str; 2]| {
        assert!(with_masks(masks).all().views.iter().all(found), "{masks:?}");
    };
    let usual = "masks Masks MASK alpha Alpha images_mask Image_Masks images/masks images/Mask";
    let others = "sam_masks object-mask Matte segmentation_sam silhouettes_v2";
    for folder in usual.split(' ').chain(others.split(' ')) {
        all(is_masked, [&format!("{folder}/a.png"), &format!("{folder}/b.png")]);
    }
    for others in ["other", "test_mask", ".hidden"] {
        all(|view| view.mask.is_none(), [&format!("{others}/a.png"), &format!("{others}/b.png")]);
    }
    all(|view| view.mask.is_none(), ["masks_a/a.png", "masks_b/b.png"]);
    for [a, b] in [
        ["a_seg.png", "b_seg.png"],
        ["a_alpha.png", "alpha_b.png"],
        ["a_MASK.PNG", "B-Mask.PNG"],
        ["A.PNG", "Mask_B.png"],
        ["a.png.png", "b.mask.png"],
    ] {
        all(is_masked, [&format!("masks/{a}"), &format!("masks/{b}")]);
    }
    let text = with_masks(["masks/a_SEG.png", "masks/c_seg.png"]).error();
    assert_says(&text, &["masks/b.png", "the mask of `b.png` is missing", "with any image extension"]);
    let set = physg(2);
    set.rename("train/mask", "train/Masks");
    set.rename("train/Masks/v_1.png", "train/Masks/v_1_MASK.png");
    assert!(set.all().views.iter().all(is_masked));
}
