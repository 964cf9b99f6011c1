//! Folders beside the photographs that have images of the same names: masks under unusual names, and others.

use super::*;
use crate::dataset::priors::{AlbedoPrior, Priors};

/// Three photographs of nerfstudio in `images`, and images of the same names in this folder.
fn with_folder(folder: &str, write: fn(&Path)) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let names = ["a", "b", "c"];
    let frames = names.map(|name| nerf_frame(&format!("images/{name}.png")));
    let json = json!({"fl_x": 8.0, "fl_y": 9.0, "cx": 3.0, "cy": 2.0, "w": 6, "h": 4, "frames": frames});
    fs::write(dir.path().join("transforms.json"), json.to_string()).unwrap();
    for name in names {
        write_photograph(&dir.path().join(format!("images/{name}.png")), 1);
        write(&dir.path().join(folder).join(format!("{name}.png")));
    }
    dir
}

fn write_gray(path: &Path) {
    write_photograph(path, 1);
}

#[test]
fn folders_that_are_called_as_masks_are_read() {
    for folder in
        ["sam_masks", "object-mask", "Matte", "masks2", "segmentation_sam", "fg", "seg_2", "silhouettes_v2"]
    {
        let set = read_all(with_folder(folder, write_mask).path()).unwrap();
        assert!(set.views.iter().all(|view| mask_of(view).coverage[3..5] == [1.0, 0.0]), "{folder}");
        assert_says(&set.notes.join(" "), &["the masks are those in", folder]);
    }
    // Under a name of one of masks, in a folder beside that of others.
    let dir = with_folder("depth", write_gray);
    ["a", "b", "c"].iter().for_each(|name| write_mask(&dir.path().join(format!("my masks/{name}_mask.png"))));
    assert!(read_all(dir.path()).unwrap().views.iter().all(|view| view.mask.is_some()));
}

#[test]
fn other_folders_are_named_and_not_read() {
    for (folder, write) in
        [("silver", write_mask as fn(&Path)), ("figures", write_mask), ("sam_masks", write_gray)]
    {
        let dir = with_folder(folder, write);
        let set = read_all(dir.path()).unwrap();
        assert!(set.views.iter().all(|view| view.mask.is_none()), "{folder}");
        assert_says(
            &set.notes.join(" "),
            &[
                "there are no masks, but",
                folder,
                "has images of the same names: rename it to masks/ if it holds masks",
            ],
        );
        let open = open_dataset(dir.path(), Split::Train, &DatasetOptions::default()).unwrap();
        assert_eq!(open.masks_beside, Some(dir.path().join(folder)));
    }
    for folder in ["images_2", "depth", "normals", "albedo_maps", "test", ".hidden"] {
        let set = read_all(with_folder(folder, write_mask).path()).unwrap();
        assert!(set.notes.is_empty() && set.views[0].mask.is_none(), "{folder}: {:?}", set.notes);
    }
}

#[test]
fn a_folder_of_prior_maps_is_none_of_masks() {
    let dir = with_folder("alpha_net", write_mask);
    let folder = dir.path().join("./alpha_net");
    let albedo = Some(AlbedoPrior { folder, gamma: Gamma::Srgb });
    let options = DatasetOptions { priors: Priors { albedo, normals: None }, ..DatasetOptions::default() };
    let open = open_dataset(dir.path(), Split::Train, &options).unwrap();
    assert!(open.notes.is_empty() && open.masks_beside.is_none(), "{:?}", open.notes);
    let read = read_dataset(dir.path(), Split::Train, &options).unwrap();
    assert!(read.views.iter().all(|view| view.mask.is_none() && view.priors.albedo.is_some()));
}

#[test]
fn incomplete_folders_and_photographs_with_alpha_are_left_alone() {
    let dir = with_folder("sam_masks", write_mask);
    fs::remove_file(dir.path().join("sam_masks/b.png")).unwrap();
    let set = read_all(dir.path()).unwrap();
    assert!(set.notes.is_empty() && set.views[0].mask.is_none(), "{:?}", set.notes);
    let set = Nerf::new(2);
    (0..2).for_each(|i| {
        fs::create_dir_all(set.path("fg")).unwrap();
        GrayImage::from_pixel(6, 4, image::Luma([255])).save(set.path(&format!("fg/r_{i}.png"))).unwrap();
    });
    let views = set.read().unwrap();
    assert!(mask_of(&views.views[0]).coverage[4] == 0.0 && views.notes.is_empty(), "alpha is the mask");
}

#[test]
fn an_error_of_missing_masks_names_the_folder() {
    let set = PhySg::new(2);
    fs::rename(set.path("train/mask"), set.path("train/object")).unwrap();
    let text = input_error(set.read());
    assert_says(
        &text,
        &["the view `v_0` has no mask", "object has images of the same names", "rename it to masks/"],
    );
    fs::rename(set.path("train/object"), set.path("train/object_mask")).unwrap();
    assert_eq!(mask_of(&set.read().unwrap().views[1]).coverage[3..5], [1.0, 0.0]);
}
