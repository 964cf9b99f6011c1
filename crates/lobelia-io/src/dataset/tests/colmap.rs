//! COLMAP's layout: text and binary, splits, distortion, masks, and what can be wrong with it.

use super::*;
use crate::codec::test_data::{jpeg_with_orientation, npy_matrix};
use glam::{DMat3, DQuat, DVec3};

/// A quaternion (w first) and a translation: a quarter turn about y, and an offset.
const POSE: ([f64; 4], [f64; 3]) =
    ([std::f64::consts::FRAC_1_SQRT_2, 0.0, std::f64::consts::FRAC_1_SQRT_2, 0.0], [0.1, -0.2, 3.0]);
const CAMERAS: &str = "sparse/0/cameras.txt";
const IMAGES: &str = "sparse/0/images.txt";
const GOOD_IMAGE: &str = "1 1 0 0 0 0 0 3 7 p00.png\n";

/// A data set of photographs `p00` … with masks, and a text model.
fn colmap(views: usize) -> Set {
    let set = Set::new();
    let ([w, x, y, z], [tx, ty, tz]) = POSE;
    let mut text = "# images\n".to_owned();
    // Not in order of name, as COLMAP's ids are not; points are there, or not.
    for i in (0..views).rev() {
        set.photograph(&format!("images/p{i:02}.png"), 1);
        set.mask(&format!("masks/p{i:02}.png"));
        let points = if i % 2 == 0 { "1.5 2.5 -1 3 4 17" } else { "" };
        text += &format!("{} {w} {x} {y} {z} {tx} {ty} {tz} 7 p{i:02}.png\n{points}\n", i + 1);
    }
    set.write(IMAGES, text);
    write_camera(&set, "PINHOLE 6 4 8 9 3.0 2.0");
    set
}

fn write_camera(set: &Set, camera: &str) {
    set.write(CAMERAS, format!("# cameras\n\n7 {camera}\n"));
}

/// Adds a binary model, which goes before the text.
fn write_binary(set: &Set, views: usize, model: u32, size: [u64; 2], parameters: &[f64]) {
    let mut cameras = [1u64.to_le_bytes().as_slice(), &7u32.to_le_bytes(), &model.to_le_bytes()].concat();
    size.iter().for_each(|value| cameras.extend(value.to_le_bytes()));
    parameters.iter().for_each(|value| cameras.extend(value.to_le_bytes()));
    let mut images = (views as u64).to_le_bytes().to_vec();
    for i in 0..views {
        images.extend((i as u32 + 1).to_le_bytes());
        POSE.0.iter().chain(&POSE.1).for_each(|value| images.extend(value.to_le_bytes()));
        images.extend(7u32.to_le_bytes());
        images.extend(format!("p{i:02}.png\0").as_bytes());
        images.extend((i as u64).to_le_bytes());
        images.extend(vec![0; 24 * i]);
    }
    set.write("sparse/0/cameras.bin", cameras);
    set.write("sparse/0/images.bin", images);
}

/// A point through the model's own formulas: x = R(q) X + t, pixel = f x / z + c, pixel centers at
/// +0.5.
#[test]
fn quaternion_and_translation_are_camera_from_world() {
    let camera = colmap(1).all().views[0].camera;
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
fn photographs_may_lie_in_folders_and_have_been_converted() {
    let set = model(
        "sparse",
        &["images/left/0.png", "images/right/0.png", "images/left/9.png"],
        &["left/0.jpg", "right/0.jpg"],
    );
    ["left", "right"].iter().for_each(|side| set.mask(&format!("masks/{side}/0.jpg.png")));
    let set = set.all();
    assert_eq!(names(&set), ["left_0", "right_0"]);
    assert_says(&set.notes.join(" "), &["1 images in", "have no camera"]);
    assert!(set.views.iter().all(is_masked));
}

/// Every model by number and name, with coefficients that hardly distort; in text and binary.
#[test]
fn all_models_are_read_and_photographs_straightened_with_their_masks() {
    let models: [(u32, &str, &[f64]); 10] = [
        (1, "PINHOLE", &[8.0, 9.0, 3.0, 2.0]),
        (2, "SIMPLE_RADIAL", &[8.0, 3.0, 2.0, 0.1]),
        (3, "RADIAL", &[8.0, 3.0, 2.0, 0.1, 0.0]),
        (4, "OPENCV", &[8.0, 8.0, 3.0, 2.0, 0.1, 0.0, 0.0, 0.0]),
        (5, "OPENCV_FISHEYE", &[8.0, 8.0, 3.0, 2.0, 0.5, 0.0, 0.0, 0.0]),
        (6, "FULL_OPENCV", &[8.0, 8.0, 3.0, 2.0, 0.1, 0.0, 0.0, 0.0, 0.0, -0.1, 0.0, 0.0]),
        (8, "SIMPLE_RADIAL_FISHEYE", &[8.0, 3.0, 2.0, 0.5]),
        (9, "RADIAL_FISHEYE", &[8.0, 3.0, 2.0, 0.5, 0.0]),
        (14, "SIMPLE_FISHEYE", &[8.0, 3.0, 2.0]),
        (15, "FISHEYE", &[8.0, 8.0, 3.0, 2.0]),
    ];
    for (number, name, parameters) in models {
        let set = colmap(1);
        let words: Vec<String> = parameters.iter().map(f64::to_string).collect();
        write_camera(&set, &format!("{name} 6 4 {}", words.join(" ")));
        let text = set.all().views.remove(0);
        write_binary(&set, 1, number, [6, 4], parameters);
        let view = set.all().views.remove(0);
        assert_eq!((view.camera, mask_of(&view)), (text.camera, mask_of(&text)), "{name}");
        let size = [view.camera.width, view.camera.height];
        let pincushion = !["PINHOLE", "SIMPLE_FISHEYE", "FISHEYE"].contains(&name);
        assert_eq!(size[0] < 6, pincushion, "the frame of a pincushion shrinks: {name} {size:?}");
        assert_eq!((view.photograph.unwrap().size(), view.mask.unwrap().size()), (size, size));
    }
}

#[test]
fn cameras_that_cannot_be_read_are_named() {
    let set = colmap(1);
    let place = "cameras.txt, line 3";
    for (camera, words) in [
        ("LENS_2030 6 4 8 3 2 0", [place, "camera 7", "LENS_2030", "image_undistorter"].as_slice()),
        ("EQUIRECTANGULAR 6 4 6 4", &[place, "EQUIRECTANGULAR", "panoramas"]),
        ("RADIAL 6 4 8 3 2 0", &["RADIAL camera has 4 parameters, not 5"]),
        ("PINHOLE 6 4 8 x 3 2", &[place, "not a camera"]),
        ("PINHOLE 12 8 8 8 3 2", &["6×4", "12×8"]),
        ("PINHOLE 6 4 1e-40 8 3 2", &[place, "camera 7: a focal length is 1e-40 pixels", "between"]),
        ("SIMPLE_PINHOLE 6 4 8 NaN 2", &[place, "principal point is (NaN, 2)"]),
        ("SIMPLE_RADIAL 6 4 8 3 2 NaN", &[place, "lens distortion is NaN"]),
        ("PINHOLE 0 4 8 8 3 2", &[place, "image size is 0×4"]),
        ("SIMPLE_RADIAL 6 4 8 3 2 -30", &["image `p00.png`", "folds", "Undistort"]),
    ] {
        write_camera(&set, camera);
        assert_says(&set.error(), words);
    }
    write_binary(&set, 1, 17, [6, 4], &[6.0, 4.0]);
    assert_says(&set.error(), &["cameras.bin, camera 7", "model number 17"]);
    write_binary(&set, 1, 1, [6, 4], &[f64::INFINITY, 8.0, 3.0, 2.0]);
    assert_says(&set.error(), &["cameras.bin, camera 7", "focal length is inf"]);
}

#[test]
fn truncated_binaries_are_refused_wherever_they_end() {
    let set = colmap(3);
    write_binary(&set, 3, 1, [6, 4], &[8.0, 9.0, 3.0, 2.0]);
    for name in ["cameras.bin", "images.bin"] {
        let file = format!("sparse/0/{name}");
        let bytes = fs::read(set.path(&file)).unwrap();
        for end in 1..bytes.len() {
            set.write(&file, &bytes[..end]);
            assert_says(&set.error(), &[name, "byte ", "truncated", "Copy the file again"]);
        }
        set.write(&file, bytes);
    }
    assert_eq!(set.all().views.len(), 3);
}

#[test]
fn bad_image_lists_are_refused() {
    let set = colmap(1);
    let text = |line: &str| {
        set.write(IMAGES, line);
        set.error()
    };
    assert_says(&text("1 1 0 0 0 0 0 3 8 p00.png\n"), &["image `p00.png`", "no camera 8"]);
    assert_says(&text("1 0 0 0 0 0 0 3 7 p00.png\n"), &["line 1", "p00.png", "not a rotation"]);
    assert_says(&text("\n1 1 0 0 0 0 0 7 p00.png\n"), &["line 2", "neither an image nor points"]);
    assert_says(&text("1 1 0 0 0 0 0 3 7 gone.png\n"), &["gone.png", "its image is missing"]);
    assert_says(&text("1 1 0 0 0 0 0 3 7 a/1.jpg\n"), &["images/a/1.jpg", "There is no folder"]);
    assert_says(&text("# none\n"), &["images.txt", "no images", "in which photographs are registered"]);
    set.remove("masks/p00.png");
    assert_says(&text(GOOD_IMAGE), &["masks/p00.png", "mask of `p00.png` is missing", "p00_mask.png"]);
    set.rename("images", "holidays");
    assert_says(&text(GOOD_IMAGE), &["images", "folder of photographs is missing", "rename their folder"]);
    let set = model("sparse/0", &["images/a.jpg"], &["a.jpg"]);
    let text = input_error(set.open_with(Split::Train, &DatasetOptions::default()));
    let words = ["images.txt", "image `a.jpg`", "train split has no views", "held out", "`hold_out: 0`"];
    assert_says(&text, &words);
}

#[test]
fn reconstructions_and_photographs_are_found_where_they_are_usual() {
    for (models, images) in [
        ("sparse", "images"),
        ("sparse/3", "images"),
        ("colmap/sparse/0", "images"),
        ("colmap/sparse", "colmap/images"),
        ("dense/sparse", "dense/images"),
        ("dense/0/sparse", "dense/0/images"),
        ("distorted/sparse/0", "input"),
        ("0", "images"),
        ("colmap", "images"),
        ("colmap/0", "images"),
        ("colmap_text", "images"),
        ("model", "images"),
        ("sparse/0", "image"),
        ("sparse/0", "Images"),
        ("sparse/0", "rgb"),
        ("sparse/0", "input"),
    ] {
        let set = model(models, &[&format!("{images}/a.png")], &["a.jpg"]);
        set.mask(Path::new(images).with_file_name("masks/a.png").to_str().unwrap());
        let read = set.all();
        assert_eq!((read.layout, names(&read)), (Layout::Colmap, vec!["a"]), "{models} {images}");
        assert!(is_masked(&read.views[0]), "masks beside {images}");
    }
    // The output of image_undistorter beside the reconstruction it is of: the photographs decide.
    let set = colmap(2);
    for name in ["cameras.txt", "images.txt"] {
        fs::copy(set.path("sparse/0").join(name), set.file(&format!("dense/sparse/{name}"))).unwrap();
    }
    set.rename("images", "dense/images");
    assert_eq!(set.all().views.len(), 2);
    // Where COLMAP puts its models there are no photographs: the folder above is meant.
    let set = model("sparse/0", &["images/a.jpg"], &["a.jpg"]);
    let read = read_dataset(set.path("sparse"), Split::Train, &DatasetOptions::default());
    assert_says(&input_error(read), &["Give the folder above it"]);
}

#[test]
fn the_largest_of_several_models_is_read() {
    let set = colmap(3);
    set.rename("sparse/0", "sparse/1");
    set.write(CAMERAS, "7 SIMPLE_PINHOLE 6 4 8 3 2");
    set.write(IMAGES, GOOD_IMAGE);
    let read = set.all();
    assert_eq!(read.views.len(), 3);
    assert_says(&read.notes.join(" "), &["2 models of 1, 3 images", "sparse/1, is read"]);
    // Binary ones are compared by their headers; of equals the first counts.
    write_binary(&set, 3, 1, [6, 4], &[8.0, 9.0, 3.0, 2.0]);
    assert_says(&set.all().notes.join(" "), &["2 models of 3, 3 images", "sparse/0, is read"]);
    set.write("sparse/0/images.bin", [1, 2]);
    assert_says(&set.error(), &["images.bin, byte 0", "truncated"]);
}

#[test]
fn photographs_are_taken_as_stored() {
    let set = colmap(1);
    ["images/p00.png", "masks"].iter().for_each(|name| set.remove(name));
    set.write("images/p00.jpg", jpeg_with_orientation(6));
    write_camera(&set, "PINHOLE 16 8 20 20 8 4");
    let image = set.all().views.remove(0).photograph.unwrap().image();
    assert_eq!((image.width, image.height), (16, 8));
    assert!(image.pixels[0].x > 0.7 && image.pixels[15].x < 0.1);
    let turned = "16×8 as stored and 8×16 as its EXIF orientation shows it; its camera is 8×16";
    for (camera, orientation, words) in [
        ("PINHOLE 8 16 20 20 4 8", 6, [turned, "auto-orient"]),
        ("PINHOLE 8 15 20 20 4 8", 6, ["the image has 16×8 pixels, its camera 8×15", ""]),
        ("PINHOLE 8 16 20 20 4 8", 3, ["the image has 16×8 pixels, its camera 8×16", ""]),
    ] {
        set.write("images/p00.jpg", jpeg_with_orientation(orientation));
        write_camera(&set, camera);
        assert_says(&set.error(), &words);
    }
    set.write("images/p00.jpg", jpeg_with_orientation(8));
    write_camera(&set, "PINHOLE 16 8 20 20 8 4");
    GrayImage::from_pixel(8, 16, Luma([255])).save(set.file("masks/p00.png")).unwrap();
    assert_says(&set.error(), &["masks/p00.png", "its mask is 8×16", "turn the mask"]);
}

#[test]
fn names_may_be_paths_of_another_machine() {
    let set = model("sparse/0", &["images/a/0.jpg", "images/b/0.jpg"], &["a\\0.jpg", "b\\0.jpg"]);
    ["a", "b"].iter().for_each(|name| set.mask(&format!("masks/{name}/0.png")));
    let read = set.all();
    assert_eq!(names(&read), ["a_0", "b_0"]);
    assert!(read.views.iter().all(is_masked));
    for name in ["C:\\scan\\images\\0.jpg", "/home/me/images/0.png"] {
        let read = model("sparse/0", &["images/0.jpg"], &[name]).all();
        assert_eq!((names(&read), read.notes.len()), (vec!["0"], 0), "{:?}", read.notes);
    }
    let text = model("sparse/0", &["images/0.jpg"], &["a/0.jpg", "b/0.jpg"]).error();
    assert_says(&text, &["two views are called `0`", "image `b/0.jpg`"]);
}

#[test]
fn names_with_accents_are_found() {
    /// A photograph and a mask with this name, and a model that has the name `named`.
    fn accented(photograph: &str, mask: &str, named: &str) -> Set {
        let set = model("sparse/0", &[&format!("images/{photograph}.png")], &[&format!("{named}.png")]);
        set.mask(&format!("masks/{mask}.png"));
        set
    }
    for (photograph, mask, named) in [
        (DECOMPOSED, DECOMPOSED, COMPOSED),
        (COMPOSED, COMPOSED, DECOMPOSED),
        (DECOMPOSED, COMPOSED, COMPOSED),
        (COMPOSED, DECOMPOSED, COMPOSED),
    ] {
        let set = accented(photograph, mask, named).all();
        assert_eq!((names(&set), set.notes.len()), (vec![named], 1), "{:?}", set.notes);
        assert!(is_masked(&set.views[0]));
    }
    let [photograph, mask] = [format!("{DECOMPOSED}/0"), format!("{DECOMPOSED}/0_mask")];
    let set = accented(&photograph, &mask, &format!("{COMPOSED}/0")).all();
    assert_eq!(names(&set), [format!("{COMPOSED}_0")]);
    assert!(is_masked(&set.views[0]));
    // Another letter is another name.
    assert_says(&accented("grun", "grun", COMPOSED).error(), &["its image is missing"]);
}

/// A folder as `llff_colmap_HDR` of Stanford-ORB: EXR photographs that the model calls PNG, and
/// cameras of LLFF as well.
fn orb(views: usize) -> Set {
    let named: Vec<String> = (0..views).map(|i| format!("{i:04}.png")).collect();
    let set = model("sparse/0", &[], &named.iter().map(String::as_str).collect::<Vec<_>>());
    ["cameras.txt", "images.txt"]
        .iter()
        .for_each(|name| set.write(&format!("sparse/teapot_scene002/{name}"), "no model"));
    for i in 0..views {
        set.exr(&format!("images/{i:04}.exr"), &["R", "G", "B"], 2.5, 2.5);
        set.mask(&format!("masks/{i:04}.png"));
    }
    let row = [0.0, 1.0, 0.0, 0.1, 4.0, -1.0, 0.0, 0.0, 0.2, 6.0, 0.0, 0.0, 1.0, 3.0, 20.0, 1.0, 9.0];
    set.write("poses_bounds.npy", npy_matrix(views, 17, &row.repeat(views)));
    set.write("poses_bounds_novel.npy", "not read");
    set.write("novel_id.txt", "not/read.png\n");
    set
}

#[test]
fn listed_views_are_the_splits() {
    let set = orb(5);
    set.write("train_id.txt", "0001.png\n0003.png\n0004.png\n");
    // Of an editor of Windows, with spaces and blank lines.
    set.write("test_id.txt", "\u{feff}\r\n0002.png  \r\n\r\n  0000.png\t\r\n0000.png");
    set.assert_splits(&["0001", "0003", "0004"], &["0000", "0002"]);
    assert!(set.has_test(0), "the data brings a test split");
    set.remove("train_id.txt");
    set.write("test_id.txt", "0004\n0000.exr\n");
    set.assert_splits(&["0001", "0002", "0003"], &["0000", "0004"]);
    // Views of no list may lack their masks.
    set.write("train_id.txt", "0003.png\n");
    set.remove("masks/0002.png");
    set.assert_splits(&["0003"], &["0000", "0004"]);
    let notes = set.split(Split::Train).notes.join(" ");
    assert_says(&notes, &["2 views that no list of a split has are left out (the first is `0001.png`)"]);
    assert!(!notes.contains("have no camera"), "{notes}");
    let of_test = set.split(Split::Test).notes.join(" ");
    assert!(!of_test.contains("left out"), "{of_test}");
    set.remove("test_id.txt");
    set.write("train_id.txt", "0000.png\n0003.png\n0004.png\n");
    set.assert_splits(&["0003", "0004"], &["0000"]);
    assert_says(&set.split(Split::Train).notes.join(" "), &["2 views that no list", "are left out"]);
}

#[test]
fn lists_that_do_not_fit_the_model_name_the_line() {
    let set = orb(3);
    for (train, test, words) in [
        (
            "",
            "0000.png\n\n0007.png\n0009.png\n",
            ["test_id.txt, line 3: there is no view with the image `0007.png`", "Near: `0000.png`"],
        ),
        (
            "0001.png\n0002.png\n",
            "0000.png\n0002.png\n",
            ["test_id.txt, line 2: `0002.png` is in train_id.txt as well, line 2", "one split"],
        ),
        (" \r\n\n", "0000.png\n", ["train_id.txt: the list has no names", "or remove the file"]),
        ("", "0000.png\n0001.png\n0002.png\n", ["the train split has no views", ""]),
    ] {
        set.write("test_id.txt", test);
        if train.is_empty() {
            let _ = fs::remove_file(set.path("train_id.txt"));
        } else {
            set.write("train_id.txt", train);
        }
        assert_says(&set.error(), &words);
    }
    set.write("test_id.txt", "0000.png\na\u{1b}[2J\n");
    let text = set.error();
    assert!(text.contains("line 2") && !text.contains(char::is_control), "{text:?}");
    set.write("test_id.txt", b"\xff\xfe0\x000\x00");
    assert_says(&set.error(), &["test_id.txt, byte 0: is not UTF-8 text", "UTF-16"]);
}

#[test]
fn a_model_goes_before_poses_that_are_made_of_it() {
    let set = orb(3);
    let train = set.split(Split::Train);
    assert_eq!(train.layout, Layout::Colmap);
    assert_eq!(train.views[0].photograph.as_ref().unwrap().radiance(0), Vec3::splat(2.5));
    assert_says(&train.notes.join(" "), &["poses_bounds.npy is not read", "`layout: Llff` reads it"]);
    assert!(!set.split(Split::Test).notes.join(" ").contains("poses_bounds"));
    for layout in [Layout::Llff, Layout::Colmap] {
        let told = set.all_with(DatasetOptions { layout, ..DatasetOptions::default() }).unwrap();
        assert!(told.layout == layout && !told.notes.join(" ").contains("poses_bounds"), "{:?}", told.notes);
    }
    // Photographs of another size alone can be read with the poses only.
    set.rename("images", "images_2");
    assert_eq!(set.split(Split::Train).layout, Layout::Llff);
    // A model for the record yields, and others do not.
    for (kept, layout) in
        [("colmap", Layout::Llff), ("model", Layout::Llff), ("dense/sparse", Layout::Colmap)]
    {
        let set = orb(3);
        set.rename("sparse/0", kept);
        set.remove("sparse");
        if kept.starts_with("dense") {
            set.rename("images", "dense/images");
        }
        assert_eq!(set.split(Split::Train).layout, layout, "{kept}");
    }
    let set = orb(3);
    set.write(TRANSFORMS, json!({"fl_x": 8.0, "frames": [nerf_frame("images/0000")]}).to_string());
    assert_says(&set.error(), &["several layouts: Nerf, Colmap", "`layout: Nerf` or `layout: Colmap`"]);
    let error = find_layout(set.0.path(), Layout::Auto, |layout| format!("--layout {layout:?}"));
    assert_says(error.unwrap_err().help().unwrap(), &["--layout Nerf or --layout Colmap"]);
}
