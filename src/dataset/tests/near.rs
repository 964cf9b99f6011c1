//! Camera files that are nearly what is read, and files without cameras.

use super::*;

fn exports(lines: &[&str]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    ["a", "b"].iter().for_each(|name| write_photograph(&dir.path().join(format!("images/{name}.jpg")), 1));
    fs::write(dir.path().join("cameras.csv"), lines.join("\n")).unwrap();
    dir
}

#[test]
fn columns_that_are_missing_are_named() {
    let error = |head: &str| input_error(read_all(exports(&[head, "a.jpg,0,0,5,0,0,0"]).path()));
    let text = error("#name,x,y,alt,heading,pitch,roll");
    assert_says(&text, &["cameras.csv has no column f, which", "Internal/External camera parameters has"]);
    assert!(!text.contains("lobelia prepare"), "{text}");
    assert_says(&error("# of today\nname;x;y;alt"), &["has no columns heading, pitch, roll, f"]);
    assert_says(&error("name,count"), &["lobelia prepare"]);
}

#[test]
fn comments_above_the_names_of_columns_are_skipped() {
    let head = "#name,x,y,alt,heading,pitch,roll,f";
    let lines = ["\u{feff}# RealityCapture, 1 camera", "", head, "a.jpg,0,0,5,0,0,0,18"];
    assert_eq!(names(&read_all(exports(&lines).path()).unwrap()), ["a"]);
    let wrong = [lines[0], lines[1], head, lines[3], "b.jpg,0,0,5,0,0,0,x"];
    assert_says(&input_error(read_all(exports(&wrong).path())), &["cameras.csv, line 5: f is `x`"]);
}

/// A text model with one image, in this folder beside `images`.
fn write_model(dir: &Path, folder: &str) {
    write_photograph(&dir.join("images/a.jpg"), 1);
    fs::create_dir_all(dir.join(folder)).unwrap();
    fs::write(dir.join(folder).join("cameras.txt"), "1 SIMPLE_PINHOLE 6 4 8 3 2").unwrap();
    fs::write(dir.join(folder).join("images.txt"), "1 1 0 0 0 0 0 3 1 a.jpg\n\n").unwrap();
}

#[test]
fn models_may_lie_beside_the_photographs() {
    for folder in ["0", "colmap", "colmap/0", "colmap_text", "model"] {
        let dir = tempfile::tempdir().unwrap();
        write_model(dir.path(), folder);
        let set = read_all(dir.path()).unwrap();
        assert_eq!((set.layout, names(&set)), (Layout::Colmap, vec!["a"]), "{folder}");
    }
    // Where COLMAP puts its models there are no photographs: the folder above is meant.
    let dir = tempfile::tempdir().unwrap();
    write_model(dir.path(), "sparse/0");
    let text = input_error(read_all(&dir.path().join("sparse")));
    assert_says(&text, &["Give the folder above it"]);
}

#[test]
fn a_model_that_instant_ngp_keeps_is_no_second_layout() {
    let dir = tempfile::tempdir().unwrap();
    write_model(dir.path(), "colmap_text");
    let json = json!({"fl_x": 8.0, "frames": [nerf_frame("images/a.jpg")]});
    fs::write(dir.path().join("transforms.json"), json.to_string()).unwrap();
    assert_eq!(read_all(dir.path()).unwrap().layout, Layout::Nerf);
}

#[test]
fn files_without_views_to_fit_to_are_named() {
    let dir = tempfile::tempdir().unwrap();
    write_model(dir.path(), "sparse/0");
    let text = input_error(read_split(dir.path(), Split::Train));
    let words = ["images.txt", "image `a.jpg`", "train split has no views", "held out", "`hold_out: 0`"];
    assert_says(&text, &words);
    fs::write(dir.path().join("sparse/0/images.txt"), "# none\n").unwrap();
    let text = input_error(read_split(dir.path(), Split::Train));
    assert_says(&text, &["images.txt", "no images", "Give a model in which photographs are registered"]);
    fs::remove_dir_all(dir.path().join("sparse")).unwrap();
    fs::write(dir.path().join("transforms.json"), "{\"fl_x\": 8, \"frames\": []}").unwrap();
    let text = input_error(read_split(dir.path(), Split::Train));
    assert_says(&text, &["transforms.json", "train split has no views", "`frames` is empty", "Export"]);
}

#[test]
fn nerfstudios_list_of_distortion_is_read() {
    let dir = tempfile::tempdir().unwrap();
    write_photograph(&dir.path().join("images/a.jpg"), 1);
    write_photograph(&dir.path().join("images/b.jpg"), 1);
    let mut json = json!({"fl_x": 8.0, "frames": [nerf_frame("images/a.jpg"), nerf_frame("images/b.jpg")]});
    json["distortion_params"] = json!([-0.01, 0.002, 0.003, 0.0, 0.004, 0.005]);
    json["frames"][1]["distortion_params"] = json!([0.02, 0, 0, 0, 0, 0]);
    let write = |json: &Value| fs::write(dir.path().join("transforms.json"), json.to_string()).unwrap();
    write(&json);
    let plan = crate::dataset::nerf::plan(dir.path(), Split::Train).unwrap();
    let [shared, own] = [0, 1].map(|n| plan.views[n].lens.distortion);
    assert_eq!(
        (shared.radial[..4].to_vec(), shared.tangential),
        (vec![-0.01, 0.002, 0.003, 0.0], [0.004, 0.005])
    );
    assert_eq!((own.radial[0], own.radial[1], own.tangential), (0.02, 0.0, [0.0; 2]));
    json["distortion_params"] = json!([0.1, 0.2, 0.3, 0.4]);
    write(&json);
    let words = ["frame 0", "distortion_params has 4 numbers, not 6", "k1, k2, k3, k4, p1, p2"];
    assert_says(&input_error(read_all(dir.path())), &words);
}
