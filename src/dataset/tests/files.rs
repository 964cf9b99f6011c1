//! Files that are not what they seem: of formats that are not read, folders, names no file has; masks in folders of their own.

use super::*;

/// A data set of nerfstudio with these images; each is written, with a mask, unless its path has no such place.
fn transforms(images: &[&str]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let frames: Vec<Value> = images.iter().map(|path| nerf_frame(path)).collect();
    let lens = json!({"fl_x": 8.0, "fl_y": 9.0, "cx": 3.0, "cy": 2.0, "w": 6, "h": 4, "frames": frames});
    fs::write(dir.path().join("transforms.json"), lens.to_string()).unwrap();
    for path in images
        .iter()
        .filter(|path| path.starts_with("images/") && !path.contains('\u{1b}') && path.len() < 200)
    {
        write_photograph(&dir.path().join(path), 1);
        write_mask(&dir.path().join(path.replacen("images/", "masks/", 1)));
    }
    dir
}

#[test]
fn photographs_in_several_folders_have_masks_in_the_same_folders() {
    let dir = transforms(&["images/left/0.png", "images/right/0.png"]);
    let views = read_all(dir.path()).unwrap();
    assert_eq!(names(&views), ["left_0", "right_0"]);
    assert!(views.views.iter().all(|view| mask_of(view).coverage[3..5] == [1.0, 0.0]));
    fs::remove_file(dir.path().join("masks/right/0.png")).unwrap();
    assert_says(&input_error(read_all(dir.path())), &["the mask of `0.png` is missing"]);
    // Masks of all folders may be in one, if their names differ.
    let dir = transforms(&["images/left/0.png", "images/right/1.png"]);
    for name in ["left/0.png", "right/1.png"] {
        fs::copy(dir.path().join("masks").join(name), dir.path().join("masks").join(&name[name.len() - 5..]))
            .unwrap();
    }
    for folder in ["left", "right"] {
        fs::remove_dir_all(dir.path().join("masks").join(folder)).unwrap();
    }
    assert!(read_all(dir.path()).unwrap().views.iter().all(|view| view.mask.is_some()));
}

#[test]
fn names_that_no_view_can_have_are_refused_before_files_are_looked_for() {
    let wrong = |path: &str| input_error(read_all(transforms(&["images/0.png", path]).path()));
    assert_says(&wrong(""), &["transforms.json, frame 1: file_path is empty", "path of the frame's image"]);
    let text = wrong("images/a\u{1b}[2Jb.png");
    assert_says(&text, &["frame 1 (`images/a\\u{1b}[2Jb.png`)", "the view name `a\\u{1b}[2Jb` holds"]);
    assert!(!text.contains('\u{1b}'), "{text:?}");
    let dir = transforms(&["images/0.png"]);
    let file = dir.path().join("transforms.json");
    let mut json: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    json["frames"][0]["mask_path"] = json!("masks/\u{1b}[2J.png");
    fs::write(&file, json.to_string()).unwrap();
    assert_says(&input_error(read_all(dir.path())), &["frame 0", "the path `masks/\\u{1b}[2J.png` holds"]);
    let text = wrong(&format!("images/{}.png", "x".repeat(3000)));
    assert_says(&text, &["has 3000 bytes", "xxx…`"]);
    assert!(text.len() < 600, "{}", text.len());
}

#[test]
fn what_is_there_and_is_no_file_is_not_called_missing() {
    let dir = transforms(&["images/0.png", "images/1.png"]);
    fs::remove_file(dir.path().join("images/1.png")).unwrap();
    fs::create_dir(dir.path().join("images/1.png")).unwrap();
    assert_says(&input_error(read_all(dir.path())), &["images/1.png: this is a folder, not a file"]);
    let dir = transforms(&["images/0.png"]);
    fs::remove_file(dir.path().join("transforms.json")).unwrap();
    fs::create_dir(dir.path().join("transforms.json")).unwrap();
    assert_says(&input_error(read_all(dir.path())), &["transforms.json: this is a folder, not a file"]);
}

#[test]
fn photographs_of_formats_that_are_not_read_say_so() {
    let set = PhySg::new(2);
    let heic = b"\0\0\0\x18ftypheic\0\0\0\0";
    fs::remove_file(set.path("train/image/v_1.exr")).unwrap();
    fs::write(set.path("train/image/v_1.heic"), heic).unwrap();
    assert_says(&input_error(set.read()), &["v_1.heic: this is a HEIC, which is not read", "heif-convert"]);
    let dir = transforms(&["images/0.png"]);
    let text = fs::read_to_string(dir.path().join("transforms.json")).unwrap().replace("0.png", "0");
    fs::write(dir.path().join("transforms.json"), text).unwrap();
    fs::remove_file(dir.path().join("images/0.png")).unwrap();
    fs::write(dir.path().join("images/0.bmp"), b"BM\0\0\0\0\0\0\0\0").unwrap();
    assert_says(&input_error(read_all(dir.path())), &["0.bmp: this is a BMP, which is not read", "magick"]);
}

#[test]
fn a_missing_mask_is_called_a_mask() {
    let set = PhySg::new(2);
    fs::remove_file(set.path("train/mask/v_1.png")).unwrap();
    let words = ["train/mask/v_1.png", "the mask of `v_1.exr` is missing", "with any image extension"];
    assert_says(&input_error(set.read()), &words);
}

#[test]
fn sizes_are_compared_before_pixels_are_decoded() {
    let set = PhySg::new(1);
    let large = GrayImage::from_fn(60, 40, |x, y| image::Luma([(x * y) as u8]));
    large.save(set.path("train/mask/v_0.png")).unwrap();
    let bytes = fs::read(set.path("train/mask/v_0.png")).unwrap();
    fs::write(set.path("train/mask/v_0.png"), &bytes[..bytes.len() / 2]).unwrap();
    assert_says(&input_error(set.read()), &["the mask has 60×40 pixels, its view 6×4"]);
}
