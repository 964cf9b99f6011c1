//! The usual names of folders of masks, and of masks.

use super::*;

/// Two photographs of nerfstudio, and their masks as these files.
fn with_masks(masks: [&str; 2]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let frames = ["images/a.png", "images/b.png"].map(nerf_frame);
    let json = json!({"fl_x": 8.0, "fl_y": 9.0, "cx": 3.0, "cy": 2.0, "w": 6, "h": 4, "frames": frames});
    fs::write(dir.path().join("transforms.json"), json.to_string()).unwrap();
    ["a", "b"].iter().for_each(|name| write_photograph(&dir.path().join(format!("images/{name}.png")), 1));
    masks.iter().for_each(|mask| write_mask(&dir.path().join(mask)));
    dir
}

#[track_caller]
fn assert_found(masks: [&str; 2]) {
    let dir = with_masks(masks);
    let views = read_all(dir.path()).unwrap().views;
    assert!(views.iter().all(|view| mask_of(view).coverage[3..5] == [1.0, 0.0]), "{masks:?}");
}

#[test]
fn folders_of_masks_are_found_under_their_usual_names_without_case() {
    for folder in [
        "masks",
        "Masks",
        "MASK",
        "alpha",
        "Alpha",
        "images_mask",
        "Image_Masks",
        "images/masks",
        "images/Mask",
    ] {
        assert_found([&format!("{folder}/a.png"), &format!("{folder}/b.png")]);
    }
    let none = with_masks(["other/a.png", "other/b.png"]);
    assert!(read_all(none.path()).unwrap().views.iter().all(|view| view.mask.is_none()));
}

#[test]
fn masks_are_found_under_their_usual_names_without_case() {
    for [a, b] in [
        ["a_seg.png", "b_seg.png"],
        ["a_alpha.png", "alpha_b.png"],
        ["a_MASK.PNG", "B-Mask.PNG"],
        ["A.PNG", "Mask_B.png"],
        ["a.png.png", "b.mask.png"],
    ] {
        assert_found([&format!("masks/{a}"), &format!("masks/{b}")]);
    }
    let text = input_error(read_all(with_masks(["masks/a_SEG.png", "masks/c_seg.png"]).path()));
    assert_says(&text, &["masks/b.png", "the mask of `b.png` is missing", "with any image extension"]);
}

#[cfg(target_os = "linux")]
#[test]
fn the_exact_name_goes_first() {
    let dir = with_masks(["masks/A.png", "masks/b.png"]);
    GrayImage::from_pixel(6, 4, image::Luma([255])).save(dir.path().join("masks/a.png")).unwrap();
    let views = read_all(dir.path()).unwrap().views;
    assert_eq!(mask_of(&views[0]).coverage[3..5], [1.0, 1.0]);
    let other = with_masks(["Masks/a.png", "masks/a.png"]);
    assert_says(&input_error(read_all(other.path())), &["masks/b.png"]);
}

#[test]
fn masks_of_layouts_with_splits_have_the_usual_names_too() {
    let set = PhySg::new(2);
    fs::rename(set.path("train/mask"), set.path("train/Masks")).unwrap();
    fs::rename(set.path("train/Masks/v_1.png"), set.path("train/Masks/v_1_MASK.png")).unwrap();
    assert_eq!(mask_of(&set.read().unwrap().views[1]).coverage[3..5], [1.0, 0.0]);
    let dir = tempfile::tempdir().unwrap();
    deepvoxels::write_split(dir.path(), 1);
    image::RgbImage::from_pixel(6, 4, image::Rgb([90; 3])).save(dir.path().join("rgb/000000.png")).unwrap();
    write_mask(&dir.path().join("images_mask/000000_seg.png"));
    assert_eq!(mask_of(&read_all(dir.path()).unwrap().views[0]).coverage[3..5], [1.0, 0.0]);
}
