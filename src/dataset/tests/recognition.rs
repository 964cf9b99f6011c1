//! What is said of folders that are in no layout, or in several.

use super::*;

fn refused(dir: &Path) -> String {
    input_error(read_all(dir))
}

#[test]
fn every_layout_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let marks =
        ["cam_dict_norm.json", "transforms_train.json", "sparse/0", "intrinsics.txt", "cameras_sphere.npz"];
    assert_says(&refused(dir.path()), &marks);
    let layouts = ["Idr", "Llff", "StanfordOrb", "Nerfactor", "RealityCapture", "Metashape"]
        .map(|name| format!("(layout {name})"));
    assert_says(&refused(dir.path()), &layouts.each_ref().map(String::as_str));
    assert_says(&refused(dir.path()), &["poses_bounds.npy", "#name, x, y, alt", "<document>"]);
}

#[test]
fn photographs_without_cameras_can_be_prepared() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("clip.MOV"), "film").unwrap();
    assert_says(&refused(dir.path()), &["lobelia prepare", "clip.MOV OUT", "of the film"]);
    for name in ["a.jpg", "b.JPG", "c.png"] {
        fs::create_dir_all(dir.path().join("images")).unwrap();
        fs::write(dir.path().join("images").join(name), "x").unwrap();
    }
    assert_says(&refused(dir.path()), &["3 photographs and no cameras", "lobelia prepare", "images OUT"]);
    fs::write(dir.path().join("scan.psx"), "x").unwrap();
    assert_says(&refused(dir.path()), &["scan.psx is a project", "Agisoft XML"]);
}

#[test]
fn the_folder_above_or_below_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("object");
    write_photograph(&data.join("images/a.jpg"), 1);
    write_photograph(&data.join("images/b.jpg"), 1);
    fs::write(data.join("poses_bounds.npy"), "").unwrap();
    assert_says(&refused(dir.path()), &["object is a data set (layout Llff): give that folder"]);
    assert_says(&refused(&data.join("images")), &["Give the folder above it", "object"]);
    fs::write(data.join("cameras.npz"), "").unwrap();
    assert_says(&refused(&data), &["several layouts: Idr, Llff", "`layout: Idr` or `layout: Llff`"]);
}

#[test]
fn a_layout_that_is_not_there_says_what_is_missing() {
    let dir = tempfile::tempdir().unwrap();
    let read = |layout| {
        let options = DatasetOptions { layout, ..DatasetOptions::default() };
        assert!(!has_split(dir.path(), Split::Train, &options).unwrap());
        input_error(read_dataset(dir.path(), Split::Train, &options))
    };
    assert_says(&read(Layout::Idr), &["cameras_sphere.npz", "no such file"]);
    assert_says(&read(Layout::Llff), &["poses_bounds.npy", "no such file"]);
    assert_says(&read(Layout::StanfordOrb), &["transforms_train.json", "no train split"]);
    assert_says(&read(Layout::RealityCapture), &["no .csv file with the columns #name"]);
    assert_says(&read(Layout::Metashape), &["no .xml file", "Export Cameras"]);
}
