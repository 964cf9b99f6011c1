//! Images that are not where the file of cameras says: it is from another machine, or names paths of Windows.

use super::*;

/// A folder with these photographs, and a file of nerfstudio that names these images.
fn transforms(photographs: &[&str], images: &[&str]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    photographs.iter().for_each(|path| write_photograph(&dir.path().join(path), 1));
    let frames: Vec<Value> = images.iter().map(|path| nerf_frame(path)).collect();
    let json = json!({"fl_x": 8.0, "fl_y": 9.0, "cx": 3.0, "cy": 2.0, "w": 6, "h": 4, "frames": frames});
    fs::write(dir.path().join("transforms.json"), json.to_string()).unwrap();
    dir
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
        let photographs = ["f_0.png", "f_1.png"].map(|name| format!("{folder}{name}"));
        // The second is named without extension.
        let images = ["f_0.png", "f_1"].map(|name| format!("{named}{name}"));
        let dir =
            transforms(&photographs.each_ref().map(String::as_str), &images.each_ref().map(String::as_str));
        let set = read_all(dir.path()).unwrap();
        assert_eq!(names(&set), ["f_0", "f_1"], "{named}");
        assert!(set.views.iter().all(|view| view.photograph.is_some()), "{named}");
        assert_eq!(set.notes.len(), 1, "{:?}", set.notes);
        assert_says(&set.notes[0], &["not where transforms.json says, e.g. `", "f_0.png`", "same names in"]);
        assert!(read_split(dir.path(), Split::Test).unwrap().notes.is_empty());
    }
}

#[test]
fn images_may_have_been_converted_since() {
    for (photograph, named) in [
        ("images/a.PNG", "images/a.png"),
        ("images/a.png", "images/a.jpg"),
        ("images/a.PNG", "images/a"),
        ("images/a.png", "/home/me/images/a.JPG"),
    ] {
        let set = read_all(transforms(&[photograph], &[named]).path()).unwrap();
        assert!(names(&set) == ["a"] && set.views[0].photograph.is_some(), "{photograph} for {named}");
    }
    // Of two that it could be, none is taken.
    let dir = transforms(&["images/a.png", "images/b.png"], &["images/a.jpg", "images/b.png"]);
    fs::copy(dir.path().join("images/a.png"), dir.path().join("images/a.webp")).unwrap();
    assert_says(&input_error(read_all(dir.path())), &["images/a.jpg", "is missing"]);
}

#[test]
fn folders_below_those_that_are_named_are_kept_apart() {
    let images = ["/home/me/images/left/0.png", "/home/me/images/right/0.png"];
    let set = read_all(transforms(&["images/left/0.png", "images/right/0.png"], &images).path()).unwrap();
    assert_eq!(names(&set), ["left_0", "right_0"]);
    let text = input_error(read_all(transforms(&["images/0.png"], &images).path()));
    assert_says(&text, &["transforms.json, frame 1", "there is only the one of frame 0", "into the folders"]);
}

#[test]
fn moved_images_have_moved_masks() {
    let dir = transforms(&["images/0.png"], &["/home/me/images/0.png"]);
    write_mask(&dir.path().join("masks/0.png"));
    assert!(read_all(dir.path()).unwrap().views[0].mask.is_some());
    let file = dir.path().join("transforms.json");
    let mut json: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    json["frames"][0]["mask_path"] = json!("/home/me/masks/0.png");
    fs::write(&file, json.to_string()).unwrap();
    assert_eq!(mask_of(&read_all(dir.path()).unwrap().views[0]).coverage[3..5], [1.0, 0.0]);
}

#[test]
fn images_that_are_nowhere_are_named_where_there_are_others() {
    for folder in ["images/", ""] {
        let dir = transforms(&[&format!("{folder}other.png")], &["/home/me/f_0.png"]);
        let text = input_error(read_all(dir.path()));
        assert_says(
            &text,
            &["transforms.json", "e.g. `/home/me/f_0.png`", "other names", "correct each file_path"],
        );
    }
    let dir = transforms(&["images/f_0.png"], &["/home/me/f_0.png", "/home/me/f_1.png"]);
    let text = input_error(read_all(dir.path()));
    assert_says(&text, &["frame 1 (`/home/me/f_1.png`)", "images/f_1.png", "is missing"]);
    let dir = transforms(&[], &["/home/me/f_0.png"]);
    let set = read_all(dir.path()).unwrap();
    assert!(set.views[0].photograph.is_none());
    assert_says(&set.notes.join(" "), &["cameras only", "transforms.json", "`/home/me/f_0.png`"]);
    fs::create_dir(dir.path().join("images")).unwrap();
    fs::write(dir.path().join("images/f_0.heic"), b"\0\0\0\x18ftypheic\0\0\0\0").unwrap();
    assert_says(&input_error(read_all(dir.path())), &["f_0.heic: this is a HEIC"]);
}

/// A COLMAP model of the images `named`, beside these photographs.
fn colmap(photographs: &[&str], named: &[&str]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    photographs.iter().for_each(|path| write_photograph(&dir.path().join(path), 1));
    fs::create_dir_all(dir.path().join("sparse/0")).unwrap();
    fs::write(dir.path().join("sparse/0/cameras.txt"), "1 SIMPLE_PINHOLE 6 4 8 3 2").unwrap();
    let lines: String = named.iter().map(|name| format!("1 1 0 0 0 0 0 3 1 {name}\n\n")).collect();
    fs::write(dir.path().join("sparse/0/images.txt"), lines).unwrap();
    dir
}

#[test]
fn colmap_may_have_photographs_in_other_folders() {
    for folder in ["image", "Images", "rgb", "input"] {
        let dir = colmap(&["images/a.png"], &["a.png"]);
        fs::rename(dir.path().join("images"), dir.path().join(folder)).unwrap();
        assert_eq!(names(&read_all(dir.path()).unwrap()), ["a"], "{folder}");
    }
    let dir = colmap(&["images/a.png"], &["a.png"]);
    fs::rename(dir.path().join("images"), dir.path().join("holidays")).unwrap();
    assert_says(&input_error(read_all(dir.path())), &["images", "is missing", "rename their folder"]);
    // Models need not begin with 0.
    fs::rename(dir.path().join("holidays"), dir.path().join("images")).unwrap();
    fs::rename(dir.path().join("sparse/0"), dir.path().join("sparse/3")).unwrap();
    assert_eq!(names(&read_all(dir.path()).unwrap()), ["a"]);
}

#[test]
fn colmap_may_have_paths_of_windows() {
    let dir = colmap(&["images/a/0.jpg", "images/b/0.jpg"], &["a\\0.jpg", "b\\0.jpg"]);
    ["a", "b"].iter().for_each(|name| write_mask(&dir.path().join(format!("masks/{name}/0.png"))));
    let set = read_all(dir.path()).unwrap();
    assert_eq!((names(&set), set.notes.len()), (vec!["a_0", "b_0"], 1), "{:?}", set.notes);
    assert!(set.views.iter().all(|view| view.mask.is_some()));
    let set = read_all(colmap(&["images/0.jpg"], &["C:\\scan\\images\\0.jpg"]).path()).unwrap();
    assert_eq!((names(&set), set.notes.len()), (vec!["0"], 0), "{:?}", set.notes);
    let set = read_all(colmap(&["images/0.png"], &["/home/me/images/0.jpg"]).path()).unwrap();
    assert_eq!(names(&set), ["0"]);
    let text = input_error(read_all(colmap(&["images/0.jpg"], &["a/0.jpg", "b/0.jpg"]).path()));
    assert_says(&text, &["two views are called `0`", "image `b/0.jpg`"]);
    let text = input_error(read_all(colmap(&["images/0.jpg"], &["a/1.jpg"]).path()));
    assert_says(&text, &["images/a", "the folder is missing", "`a/1.jpg` should be in it"]);
}

#[test]
fn exports_may_have_paths_of_windows() {
    let dir = tempfile::tempdir().unwrap();
    // The ending tells photographs of one stem apart.
    ["a.png", "a.jpg"].iter().for_each(|name| write_photograph(&dir.path().join("images").join(name), 1));
    let csv = "#name,x,y,alt,heading,pitch,roll,f\nC:\\scan\\images\\a.png,0,0,5,0,0,0,18";
    fs::write(dir.path().join("cameras.csv"), csv).unwrap();
    let plan = crate::dataset::reality_capture::plan(dir.path()).unwrap();
    assert_eq!(
        (plan.views[0].name.as_str(), &plan.views[0].image),
        ("a", &Some(dir.path().join("images/a.png")))
    );
    let set = metashape::Metashape::new().with("label=\"b.jpg\"", "label=\"C:\\scan\\images\\b.jpg\"");
    assert_eq!(names(&set.read().unwrap()), ["a", "b"]);
}

#[test]
fn masks_of_files_of_splits_are_found() {
    let set = Nerf::new(2);
    fs::create_dir_all(set.path("masks")).unwrap();
    for i in 0..2 {
        let all = GrayImage::from_pixel(6, 4, image::Luma([255]));
        all.save(set.path(&format!("masks/r_{i}.png"))).unwrap();
    }
    let covered = |set: &Nerf| mask_of(&set.read().unwrap().views[1]).coverage[4];
    assert_eq!(covered(&set), 1.0, "the mask's, where alpha is 0");
    fs::create_dir_all(set.path("masks/test")).unwrap();
    for i in 0..2 {
        write_mask(&set.path(&format!("masks/test/r_{i}.png")));
    }
    assert_eq!(covered(&set), 0.0, "folders of images in that of masks go first");
    fs::remove_dir_all(set.path("masks/test")).unwrap();
    fs::remove_file(set.path("masks/r_1.png")).unwrap();
    assert_says(&input_error(set.read()), &["masks/r_1.png", "the mask of `r_1.png` is missing"]);
}
