//! DeepVoxels' layout.

use super::*;

const INTRINSICS: &str = "8 3 2 0.\n0. 0. 0.\n1.\n1.\n4 6\n";
/// World_from_camera: at (3, 0, 0.25), looking along −X with +Y up.
const POSE: &str = "0 0 -1 3\n0 -1 0 0\n-1 0 0 0.25\n0 0 0 1\n";

pub fn write_split(folder: &Path, views: usize) {
    for name in ["rgb", "pose"] {
        fs::create_dir_all(folder.join(name)).unwrap();
    }
    fs::write(folder.join("intrinsics.txt"), INTRINSICS).unwrap();
    for i in 0..views {
        fs::write(folder.join(format!("pose/{i:06}.txt")), POSE).unwrap();
        let image = RgbaImage::from_fn(6, 4, |x, _| image::Rgba([90, 90, 90, if x < 4 { 255 } else { 0 }]));
        image.save(folder.join(format!("rgb/{i:06}.png"))).unwrap();
    }
}

fn read(dir: &Path, split: Split) -> Result<LoadedDataset> {
    read_dataset(dir, split, &DatasetOptions::default())
}

#[test]
fn poses_are_world_from_camera_in_opencv_axes() {
    let dir = tempfile::tempdir().unwrap();
    write_split(dir.path(), 9);
    let dataset = read(dir.path(), Split::Test).unwrap();
    assert_eq!((dataset.layout, names(&dataset)), (Layout::DeepVoxels, vec!["000000", "000008"]));
    assert_eq!(read(dir.path(), Split::Train).unwrap().views.len(), 7);
    let camera = dataset.views[0].camera;
    assert_eq!((camera.focal, camera.center), ([8.0; 2], [3.0, 2.0]));
    assert!(camera.position().distance(Vec3::new(3.0, 0.0, 0.25)) < 1e-6);
    assert!(camera.ray(3.0, 2.0).direction.distance(Vec3::NEG_X) < 1e-6);
    assert_eq!(mask_of(&dataset.views[0]).coverage[3..5], [1.0, 0.0]);
}

#[test]
fn inverse_poses_and_other_image_sizes_are_understood() {
    let dir = tempfile::tempdir().unwrap();
    write_split(dir.path(), 1);
    let straight = read(dir.path(), Split::Test).unwrap().views[0].camera;
    // Its pose is its own inverse but for the translation.
    fs::write(dir.path().join("intrinsics.txt"), "16 6 4 0.\n0 0 0\n1\n1\n8 12\n1\n").unwrap();
    fs::write(dir.path().join("pose/000000.txt"), "0 0 -1 0.25 0 -1 0 0 -1 0 0 3 0 0 0 1").unwrap();
    let inverse = read(dir.path(), Split::Test).unwrap().views[0].camera;
    assert_eq!((straight.focal, straight.center), (inverse.focal, inverse.center));
    assert!(straight.position().distance(inverse.position()) < 1e-6);
    fs::write(dir.path().join("intrinsics.txt"), "16 6 4 0.\n0 0 0\n1\n1\n8 8\n").unwrap();
    assert_says(&input_error(read(dir.path(), Split::Test)), &["000000.png", "6×4", "8×8"]);
}

#[test]
fn split_folders_are_used_where_there_are_any() {
    let dir = tempfile::tempdir().unwrap();
    write_split(&dir.path().join("train"), 9);
    assert_eq!(read(dir.path(), Split::Test).unwrap().views.len(), 2);
    write_split(&dir.path().join("validation"), 3);
    assert_eq!(read(dir.path(), Split::Train).unwrap().views.len(), 9);
    assert_eq!(read(dir.path(), Split::Test).unwrap().views.len(), 3);
    write_split(&dir.path().join("test"), 4);
    assert_eq!(read(dir.path(), Split::Test).unwrap().views.len(), 4);
    fs::remove_dir_all(dir.path().join("train")).unwrap();
    assert!(!has_split(dir.path(), Split::Train, &DatasetOptions::default()).unwrap());
    assert_says(&input_error(read(dir.path(), Split::Train)), &["no train split", "train/intrinsics.txt"]);
}

#[test]
fn what_is_missing_is_named() {
    let dir = tempfile::tempdir().unwrap();
    write_split(dir.path(), 1);
    let opaque = image::RgbImage::new(6, 4);
    opaque.save(dir.path().join("rgb/000000.png")).unwrap();
    let error = || input_error(read(dir.path(), Split::Test));
    assert_says(&error(), &["`000000` has no mask", "mask", "no alpha", "Add a mask"]);
    fs::create_dir(dir.path().join("mask")).unwrap();
    assert_says(&error(), &["mask/000000", "missing"]);
    fs::remove_dir(dir.path().join("mask")).unwrap();
    let intrinsics = |text: &str| {
        fs::write(dir.path().join("intrinsics.txt"), text).unwrap();
        error()
    };
    assert_says(&intrinsics("8 3\n"), &["intrinsics.txt, line 1", "2 numbers, not 3"]);
    assert_says(&intrinsics("8 3 2 0\n0 0 0\n1\n1\n"), &["line 5", "0 numbers, not 2"]);
    assert_says(&intrinsics("8 3 2 0\n0 0 0\n1\n1\n4 6.5\n"), &["line 5", "not whole"]);
    fs::write(dir.path().join("intrinsics.txt"), INTRINSICS).unwrap();
    fs::write(dir.path().join("pose/000000.txt"), "1 0 0").unwrap();
    assert_says(&error(), &["pose/000000.txt", "3 numbers, not 16"]);
    fs::write(dir.path().join("pose/000000.txt"), POSE.replace('3', "x")).unwrap();
    assert_says(&error(), &["pose/000000.txt", "`x` is not a number"]);
    fs::remove_dir_all(dir.path().join("pose")).unwrap();
    assert_says(&error(), &["folder of poses is missing"]);
    fs::remove_dir_all(dir.path().join("rgb")).unwrap();
    assert_says(&error(), &["rgb", "folder of the DeepVoxels layout is missing"]);
}

#[test]
fn several_layouts_in_one_folder_are_told_apart_by_the_user() {
    let dir = tempfile::tempdir().unwrap();
    write_split(dir.path(), 1);
    fs::create_dir(dir.path().join("sparse")).unwrap();
    for name in ["cameras.txt", "images.txt"] {
        fs::write(dir.path().join("sparse").join(name), "#\n").unwrap();
    }
    let text = input_error(read(dir.path(), Split::Test));
    assert_says(&text, &["several layouts: Colmap, DeepVoxels", "layout: Colmap", "or `layout: DeepVoxels`"]);
    let told = DatasetOptions { layout: Layout::DeepVoxels, ..DatasetOptions::default() };
    assert_eq!(read_dataset(dir.path(), Split::Test, &told).unwrap().views.len(), 1);
}
