//! Letters with accents, which are one character in most files of cameras and two in names of files on macOS.

use super::*;

const COMPOSED: &str = "gr\u{fc}n";
const DECOMPOSED: &str = "gru\u{308}n";

/// A photograph and a mask with this name, and a model of COLMAP that has the name `named`.
fn colmap(photograph: &str, mask: &str, named: &str) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    write_photograph(&dir.path().join(format!("images/{photograph}.png")), 1);
    write_mask(&dir.path().join(format!("masks/{mask}.png")));
    fs::create_dir_all(dir.path().join("sparse/0")).unwrap();
    fs::write(dir.path().join("sparse/0/cameras.txt"), "1 SIMPLE_PINHOLE 6 4 8 3 2").unwrap();
    fs::write(dir.path().join("sparse/0/images.txt"), format!("1 1 0 0 0 0 0 3 1 {named}.png\n\n")).unwrap();
    dir
}

#[test]
fn photographs_and_masks_of_a_model_are_found() {
    for (photograph, mask, named) in [
        (DECOMPOSED, DECOMPOSED, COMPOSED),
        (COMPOSED, COMPOSED, DECOMPOSED),
        (DECOMPOSED, COMPOSED, COMPOSED),
        (COMPOSED, DECOMPOSED, COMPOSED),
    ] {
        let set = read_all(colmap(photograph, mask, named).path()).unwrap();
        assert_eq!((names(&set), set.notes.len()), (vec![named], 1), "{:?}", set.notes);
        assert_says(&set.notes[0], &["made black"]);
        assert_eq!(mask_of(&set.views[0]).coverage[3..5], [1.0, 0.0]);
    }
    let [photograph, mask] = [format!("{DECOMPOSED}/0"), format!("{DECOMPOSED}/0_mask")];
    let set = read_all(colmap(&photograph, &mask, &format!("{COMPOSED}/0")).path()).unwrap();
    assert_eq!(names(&set), [format!("{COMPOSED}_0")]);
    assert_eq!(mask_of(&set.views[0]).coverage[3..5], [1.0, 0.0]);
    // Another letter is another name.
    assert_says(&input_error(read_all(colmap("grun", "grun", COMPOSED).path())), &["its image is missing"]);
}

#[cfg(target_os = "linux")]
#[test]
fn the_very_name_goes_first() {
    let dir = colmap(DECOMPOSED, DECOMPOSED, COMPOSED);
    image::RgbImage::from_pixel(6, 4, image::Rgb([255; 3]))
        .save(dir.path().join(format!("images/{COMPOSED}.png")))
        .unwrap();
    GrayImage::from_pixel(6, 4, image::Luma([255]))
        .save(dir.path().join(format!("masks/{COMPOSED}.png")))
        .unwrap();
    let view = read_all(dir.path()).unwrap().views.remove(0);
    assert_eq!(mask_of(&view).coverage[5], 1.0);
    assert_eq!(view.photograph.unwrap().image().pixels[0], Vec3::ONE);
}

#[test]
fn images_that_frames_name_are_found() {
    for named in ["images/NAME.png", "images/NAME", "./images/NAME", "/home/me/images/NAME.png"] {
        let dir = tempfile::tempdir().unwrap();
        write_photograph(&dir.path().join(format!("images/{DECOMPOSED}.png")), 1);
        write_mask(&dir.path().join(format!("masks/{DECOMPOSED}.png")));
        let frames = [nerf_frame(&named.replace("NAME", COMPOSED))];
        let json = json!({"fl_x": 8.0, "fl_y": 9.0, "cx": 3.0, "cy": 2.0, "w": 6, "h": 4, "frames": frames});
        fs::write(dir.path().join("transforms.json"), json.to_string()).unwrap();
        let set = read_all(dir.path()).unwrap();
        assert_eq!(names(&set), [COMPOSED], "{named}");
        assert!(set.views[0].photograph.is_some() && set.views[0].mask.is_some(), "{named}");
    }
    let dir = tempfile::tempdir().unwrap();
    write_photograph(&dir.path().join(format!("{DECOMPOSED}/0.png")), 1);
    let json = json!({"fl_x": 8.0, "frames": [nerf_frame(&format!("{COMPOSED}/0.png"))]});
    fs::write(dir.path().join("transforms.json"), json.to_string()).unwrap();
    assert!(read_all(dir.path()).unwrap().views[0].photograph.is_some());
}

#[test]
fn lists_of_splits_may_have_the_other_form() {
    let dir = colmap(DECOMPOSED, DECOMPOSED, COMPOSED);
    fs::write(dir.path().join("train_id.txt"), format!("{DECOMPOSED}.png\n")).unwrap();
    assert_eq!(names(&read_all(dir.path()).unwrap()), [COMPOSED]);
}
