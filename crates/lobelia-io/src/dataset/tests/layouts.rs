//! The other layouts: which one is recognized, test splits that are held out, and those of
//! NeRFactor, LLFF and IDR.

use super::*;
use crate::codec::test_data::{npy_matrix, write_npz};
use glam::{DMat3, DMat4, DVec3, DVec4};

#[test]
fn folders_that_are_no_data_sets_say_what_they_are() {
    let set = Set::new();
    set.write("a.exr", "");
    let marks =
        ["cam_dict_norm.json", "transforms_train.json", "sparse/0", "cameras_sphere.npz", "poses_bounds.npy"];
    assert_says(&set.error(), &marks);
    let layouts =
        ["(layout Idr)", "(layout Llff)", "(layout StanfordOrb)", "(layout Nerfactor)", "has one file"];
    assert_says(&set.error(), &layouts);
    let refused = |path: &Path| input_error(read_dataset(path, Split::Train, &DatasetOptions::default()));
    assert_says(&refused(&set.path("nowhere")), &["no such folder"]);
    assert_says(&refused(&set.path("a.exr")), &["a file, not a folder"]);
    let set = physg(1);
    assert_says(&refused(&set.path("train")), &["Give the folder above it"]);
    set.write("transforms_test.json", "{}");
    assert_says(&set.error(), &["several layouts: PhySg, Nerf", "layout: PhySg"]);
    let options = DatasetOptions { layout: Layout::PhySg, ..DatasetOptions::default() };
    assert_eq!(set.all_with(options).unwrap().layout, Layout::PhySg);
    let set = Set::new();
    set.photograph("object/images/a.jpg", 1);
    set.write("object/poses_bounds.npy", "");
    assert_says(&set.error(), &["object is a data set (layout Llff): give that folder"]);
    assert_says(&refused(&set.path("object/images")), &["Give the folder above it", "object"]);
}

#[test]
fn absent_splits_say_which_there_are() {
    let set = nerf_of(&["test"], 1);
    let words = ["no train split", "transforms_train.json", "There is a test split only. Add the train"];
    assert_says(&set.error(), &words);
    for (layout, mark) in [
        (Layout::Idr, "cameras_sphere.npz"),
        (Layout::Llff, "poses_bounds.npy"),
        (Layout::StanfordOrb, "train_mask"),
        (Layout::Colmap, "sparse/0"),
    ] {
        let options = DatasetOptions { layout, ..DatasetOptions::default() };
        assert!(!has_split(set.0.path(), Split::Train, &options).unwrap());
        assert_says(&input_error(set.all_with(options)), &["no train split of this layout", mark]);
    }
}

#[test]
fn photographs_without_cameras_can_be_prepared() {
    let set = Set::new();
    set.write("clip.MOV", "film");
    assert_says(&set.error(), &["lobelia prepare", "clip.MOV OUT", "of the film"]);
    ["a.jpg", "b.JPG", "c.png"].iter().for_each(|name| set.write(&format!("images/{name}"), "x"));
    let prepare = ["3 photographs and no cameras", "lobelia prepare", "images OUT"];
    assert_says(&set.error(), &prepare);
    let (metashape, reality) =
        (["of Metashape", "Export Cameras, COLMAP"], ["of RealityCapture", "Registration > COLMAP"]);
    for (file, text, words) in [
        ("a.psx", "", metashape.as_slice()),
        ("a.xml", "<?xml version=\"1.0\"?>\n<document version=\"1.5\"><chunk label=\"a\">", &metashape),
        ("a.rsproj", "", &reality),
        ("a.csv", "\u{feff}#name,x,y,alt,heading,pitch,roll,f\na.jpg,0,0,5,0,0,0,18", &reality),
        ("a.csv", "# of today\nname;x;y;alt\n", &reality),
        ("b.csv", "name,count\n", &prepare),
    ] {
        set.write(file, text);
        assert_says(&set.error(), words);
        set.remove(file);
    }
}

#[test]
fn training_views_are_held_out_where_there_is_no_test_split() {
    let orb = nerf(3);
    (0..3).for_each(|i| orb.mask(&format!("train_mask/r_{i}.png")));
    for (set, layout, [first, second, third]) in [
        (physg(3), Layout::PhySg, ["v_0", "v_1", "v_2"]),
        (nerf(3), Layout::Nerf, ["r_0", "r_1", "r_2"]),
        (orb, Layout::StanfordOrb, ["r_0", "r_1", "r_2"]),
        (transforms_of(&["f_2.png", "f_10.png", "f_11.png"]), Layout::Nerf, ["f_2", "f_10", "f_11"]),
    ] {
        assert_eq!(set.split(Split::Train).layout, layout);
        set.assert_splits(&[second, third], &[first]);
        assert!(set.has_test(8) && !set.has_test(0));
        assert_eq!(set.all().views.len(), 3);
        let with = |hold_out| {
            set.open_with(Split::Test, &DatasetOptions { layout, hold_out, ..DatasetOptions::default() })
        };
        assert_says(&input_error(with(0)), &["the test split has no views", "hold_out: 8"]);
        assert_eq!(names(&with(2).unwrap()), [first, third]);
    }
}

const NERFACTOR_POSE: &str = "1.0,0.0,0.0,0.1,0.0,1.0,0.0,0.2,0.0,0.0,1.0,3.0,0.0,0.0,0.0,1.0";

/// A view's folder with these pictures.
fn write_view(set: &Set, name: &str, pictures: &[&str]) {
    let camera =
        json!({"cam_transform_mat": NERFACTOR_POSE, "cam_angle_x": 0.8, "imw": 6, "imh": 4, "scene": "lego"});
    set.write(&format!("{name}/metadata.json"), camera.to_string());
    (1..).zip(pictures).for_each(|(shade, picture)| set.photograph(&format!("{name}/{picture}"), shade));
}

#[test]
fn each_view_has_a_folder_and_a_light_of_its_photograph() {
    let set = Set::new();
    for view in ["train_000", "train_010", "train_002"] {
        write_view(&set, view, &["rgba_sunset.png", "rgba_city.png", "albedo.png"]);
    }
    write_view(&set, "test_000", &["rgba.png", "rgba_city.png"]);
    write_view(&set, "val_000", &["rgba.png"]);
    write_view(&set, "train_notes", &["rgba.png"]);
    let train = set.split(Split::Train);
    assert_eq!(train.layout, Layout::Nerfactor);
    set.assert_splits(&["train_000", "train_002", "train_010"], &["test_000"]);
    let camera = train.views[0].camera;
    assert!((camera.focal[0] - 3.0 / 0.4f32.tan()).abs() < 1e-5);
    assert_eq!(camera.world_from_camera.translation, Vec3::new(0.1, 0.2, 3.0).into());
    assert_eq!(camera.world_from_camera.matrix3.z_axis, Vec3::NEG_Z.into());
    // Files of NeRF's form beside the folders change nothing, and a test view under several other
    // lights is a camera.
    set.write(NERF_FILE, json!({"frames": [nerf_frame("./train_000/rgba")]}).to_string());
    assert_eq!(set.split(Split::Train).layout, Layout::Nerfactor);
    set.rename("test_000/rgba.png", "test_000/rgba_night.png");
    let test = set.split(Split::Test);
    assert!(test.views[0].photograph.is_none() && test.views[0].camera.width == 6);
    // Without a folder called so, what is called validation is the test split.
    set.remove("test_000");
    assert_eq!(names(&set.split(Split::Test)), ["val_000"]);
}

#[test]
fn the_photograph_is_the_usual_one_or_the_only_one() {
    let planned = |pictures: &[&str]| {
        let set = Set::new();
        write_view(&set, "train_000", pictures);
        nerfactor::plan(set.0.path(), Split::Train).map(|plan| plan.views[0].image.clone().unwrap())
    };
    assert!(planned(&["rgba_city.png"]).unwrap().ends_with("train_000/rgba_city.png"));
    assert!(planned(&["rgba_sunset.png", "rgba.png"]).unwrap().ends_with("train_000/rgba.png"));
    let text = planned(&["rgba_city.png", "rgba_night.png"]).unwrap_err().to_string();
    let words = ["train_000: the photograph of this view is missing", "rgba_city.png, rgba_night.png"];
    assert_says(&text, &words);
    let text = planned(&["albedo.png"]).unwrap_err().to_string();
    let words = "photograph of this view is missing: there is no rgba.png, and of other lights none";
    assert_says(&text, &[words]);
    let set = Set::new();
    write_view(&set, "train_000", &["rgba.png"]);
    for (pose, words) in [
        ("1,2,3".to_owned(), "cam_transform_mat has 3 numbers, not 16"),
        (NERFACTOR_POSE.replace("0.1", "x"), "cam_transform_mat has `x`, which is not a number"),
        (NERFACTOR_POSE.replacen("1.0", "2.0", 1), "cam_transform_mat is not rigid"),
    ] {
        let text = set.error_with("train_000/metadata.json", "/cam_transform_mat", json!(pose));
        assert_says(&text, &["train_000/metadata.json", words]);
    }
}

/// At (0.1, 0.2, 3), looking along −Z with +Y up: the axes are down, right and backward. Written
/// for 12×8 pixels, twice [`SIZE`].
const ROW: [f64; 17] =
    [0.0, 1.0, 0.0, 0.1, 8.0, -1.0, 0.0, 0.0, 0.2, 12.0, 0.0, 0.0, 1.0, 3.0, 20.0, 1.0, 9.0];
const LLFF_FILE: &str = "poses_bounds.npy";

fn llff(views: usize) -> Set {
    let set = Set::new();
    for n in 7..views + 7 {
        set.photograph(&format!("images/DSC_{n:04}.jpg"), 1);
        set.mask(&format!("masks/DSC_{n:04}.png"));
    }
    set.write(LLFF_FILE, npy_matrix(views, 17, &ROW.repeat(views)));
    set
}

#[test]
fn axes_are_turned_and_focal_lengths_scaled() {
    let set = llff(9);
    let read = set.all();
    assert_eq!((read.layout, read.views.len()), (Layout::Llff, 9));
    let view = &read.views[8];
    let camera = view.camera;
    assert_eq!((view.name.as_str(), camera.focal, camera.center), ("DSC_0015", [10.0; 2], [3.0, 2.0]));
    assert_eq!(camera.pixel_center, 0.5);
    assert!(camera.position().distance(Vec3::new(0.1, 0.2, 3.0)) < 1e-6);
    assert!(camera.ray(3.0, 2.0).direction.distance(Vec3::NEG_Z) < 1e-6);
    let (x, y, _) = camera.project(Vec3::new(0.4, 0.6, 0.0)).unwrap();
    assert!(x > 3.0 && y < 2.0, "world +X is right, +Y up: ({x}, {y})");
    assert!(read.views.iter().all(is_masked));
    assert_eq!(names(&set.split(Split::Test)), ["DSC_0007", "DSC_0015"]);
    // Smaller photographs are found, and masks are optional.
    set.rename("images", "images_2");
    set.remove("masks");
    let views = set.all().views;
    assert!(views.len() == 9 && views.iter().all(|view| view.mask.is_none()));
}

#[test]
fn cameras_photographs_and_masks_must_not_differ_in_number() {
    let set = llff(5);
    set.photograph("images/DSC_0001.jpg", 1);
    assert_says(&set.error(), &["5 cameras, but 6 photographs", "in the order of their names"]);
    // Hidden files of file managers are no photographs.
    set.rename("images/DSC_0001.jpg", "images/._DSC_0001.jpg");
    assert_eq!(set.all().views.len(), 5);
    set.remove("masks/DSC_0010.png");
    assert_says(&set.error(), &["the mask of `DSC_0010.jpg` is missing"]);
    set.remove("images");
    assert_says(&set.error(), &["no photographs: looked for images in images, images_1"]);
    set.write("images/a.heic", HEIC);
    assert_says(&set.error(), &["images/a.heic: this is a HEIC, which is not read"]);
}

#[test]
fn rows_that_are_no_cameras_are_named() {
    let set = llff(2);
    for (i, value, words) in [
        (1, f64::NAN, ["poses_bounds.npy, row 1", "the pose has a NaN"]),
        (1, 2.0, ["row 1: the pose is not rigid", "down, right, backward"]),
        (4, 0.0, ["row 1", "image size 12×0"]),
        (9, 11.5, ["row 1", "image size 11.5×8"]),
        (9, 9.0, ["DSC_0008.jpg", "6×4 pixels, its camera 9×8"]),
        (14, f64::NAN, ["row 1", "focal length is NaN"]),
    ] {
        let mut rows = [ROW, ROW];
        rows[1][i] = value;
        set.write(LLFF_FILE, npy_matrix(2, 17, rows.as_flattened()));
        assert_says(&set.error(), &words);
    }
    set.write(LLFF_FILE, npy_matrix(2, 16, &[0.0; 32]));
    assert_says(&set.error(), &["the array has 16 columns, not 17"]);
    let bytes = npy_matrix(2, 17, [ROW, ROW].as_flattened());
    set.write(LLFF_FILE, &bytes[..bytes.len() - 8]);
    assert_says(&set.error(), &["poses_bounds.npy", "truncated"]);
    // A sparse file takes no room on the disk; read whole, it would take that in memory.
    fs::File::options().write(true).open(set.path(LLFF_FILE)).unwrap().set_len(4 << 30).unwrap();
    assert_says(&set.error(), &["poses_bounds.npy", "at most 64.0 MiB are read"]);
}

const FOCAL: [f64; 2] = [8.0, 9.0];
const CENTER: [f64; 2] = [2.75, 1.5];
const SKEW: f64 = 0.25;
const IDR_FILE: &str = "cameras_sphere.npz";

/// World_from_camera of the n-th camera, around an object far from the origin.
fn pose(n: usize) -> DMat4 {
    let rotation = DMat3::from_rotation_y(0.4 + 0.3 * n as f64) * DMat3::from_rotation_x(0.2);
    let target = DVec3::new(-28.0, -28.0, 640.0);
    DMat4::from_mat3_translation(rotation, target - rotation.z_axis * 500.0)
}

/// The projection K [R | t] times `factor`, row by row.
fn projection(pose: DMat4, factor: f64) -> Vec<f64> {
    let k = DMat3::from_cols_array(&[FOCAL[0], 0.0, 0.0, SKEW, FOCAL[1], 0.0, CENTER[0], CENTER[1], 1.0]);
    let product = DMat4::from_mat3(k) * pose.inverse() * factor;
    let mut rows = product.transpose().to_cols_array().to_vec();
    rows[12..].copy_from_slice(&[0.0, 0.0, 0.0, 1.0]);
    rows
}

type Arrays = Vec<(String, Vec<u8>)>;

/// Photographs, masks of other names in the same order, and the arrays of their cameras.
fn idr(views: usize) -> (Set, Arrays) {
    let (set, mut arrays) = (Set::new(), Vec::new());
    for n in 0..views {
        set.photograph(&format!("image/{n:06}.png"), 1);
        set.mask(&format!("mask/{n:03}.png"));
        let factor = if n % 2 == 0 { 1.0 } else { -3.7 };
        arrays.push((format!("world_mat_{n}"), npy_matrix(4, 4, &projection(pose(n), factor))));
        let scale = DMat4::from_scale(DVec3::splat(164.0)).to_cols_array();
        arrays.push((format!("scale_mat_{n}"), npy_matrix(4, 4, &scale)));
    }
    arrays.push(("world_mat_inv_0".to_owned(), npy_matrix(4, 4, &[0.0; 16])));
    write_npz(&set.path(IDR_FILE), &arrays);
    (set, arrays)
}

#[test]
fn projections_become_cameras_in_the_world_of_the_capture() {
    let read = idr(2).0.all();
    assert_eq!((read.layout, names(&read)), (Layout::Idr, vec!["000000", "000001"]));
    for (n, view) in read.views.iter().enumerate() {
        let camera = view.camera;
        let near = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-4;
        assert!((0..2).all(|k| near(camera.focal[k], FOCAL[k]) && near(camera.center[k], CENTER[k])));
        assert!(near(camera.skew, SKEW) && camera.pixel_center == 0.0 && is_masked(view), "{camera:?}");
        assert!(camera.position().as_dvec3().distance(pose(n).w_axis.truncate()) < 1e-3);
        let p = projection(pose(n), 1.0);
        let world = DVec3::new(-20.0, -30.0, 650.0);
        let row = |i: usize| DVec4::from_slice(&p[4 * i..]).dot(world.extend(1.0));
        let (x, y, depth) = camera.project(world.as_vec3()).unwrap();
        // The center of the first pixel is (0, 0) in the file and (0.5, 0.5) in `project`.
        assert!(near(x, row(0) / row(2) + 0.5) && near(y, row(1) / row(2) + 0.5), "({x}, {y})");
        assert!(f64::from(depth) > 0.0 && (f64::from(depth) - row(2)).abs() < 1e-2);
    }
}

#[test]
fn masks_have_the_photographs_names_or_order_or_are_absent() {
    let (set, _) = idr(3);
    set.rename("mask/001.png", "mask/other.txt");
    assert_says(&set.error(), &["mask", "2 masks here, but 3 photographs"]);
    set.remove("mask");
    assert!(set.all().views.iter().all(|view| view.mask.is_none()));
    (0..3).for_each(|n| set.mask(&format!("mask/{n:06}.png")));
    assert!(set.all().views.iter().all(is_masked));
    set.remove("mask/000001.png");
    assert_says(&set.error(), &["mask/000001.png", "the mask of `000001.png` is missing", "000002.png"]);
}

#[test]
fn matrices_that_are_no_cameras_are_named() {
    let (set, mut arrays) = idr(3);
    let good = projection(pose(1), 1.0);
    let with = |i: usize, value: f64| {
        let mut rows = good.clone();
        rows[i] = value;
        npy_matrix(4, 4, &rows)
    };
    let mut flat = good.clone();
    flat.copy_within(0..4, 4);
    for (matrix, words) in [
        (with(6, f64::NAN), "NaN or infinite value in row 2, column 3"),
        (npy_matrix(4, 4, &[0.0; 16]), "singular"),
        (npy_matrix(4, 4, &flat), "singular"),
        (npy_matrix(3, 3, &good[..9]), "is 3×3, not 4×4"),
        (b"\x93NUMPY".to_vec(), "has a broken header"),
        (with(3, 1e300), "puts the camera at infinity"),
    ] {
        arrays[2].1 = matrix;
        write_npz(&set.path(IDR_FILE), &arrays);
        assert_says(&set.error(), &["cameras_sphere.npz, `world_mat_1`", words]);
    }
    let huge: Vec<f64> = good.iter().map(|value| value * 1e300).collect();
    arrays[2].1 = npy_matrix(4, 4, &huge);
    write_npz(&set.path(IDR_FILE), &arrays);
    assert_eq!(set.all().views.len(), 3);
    arrays.remove(2);
    write_npz(&set.path(IDR_FILE), &arrays);
    assert_says(&set.error(), &["`world_mat_1`: the matrix is missing"]);
    arrays.retain(|(name, _)| name.starts_with("scale"));
    write_npz(&set.path(IDR_FILE), &arrays);
    assert_says(&set.error(), &["`world_mat_0`: the matrix is missing", "has scale_mat_"]);
    let bytes = fs::read(set.path(IDR_FILE)).unwrap();
    set.write(IDR_FILE, &bytes[..bytes.len() - 30]);
    assert_says(&set.error(), &["cameras_sphere.npz", "damaged or truncated", "Copy the file again"]);
}
