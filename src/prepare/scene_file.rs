//! A commented scene file for a data set: what is known of it, what a fit has to find, and what may
//! be worth changing.

use glam::Vec3;
use lobelia_geometry::{Error, Result, view::Split};
use lobelia_io::dataset::{
    DatasetOptions, Layout, OpenDataset, PlannedView, find_layout, has_split, open_dataset,
};
use std::path::{Path, PathBuf};

/// The lines of a scene file, each behind a mark that says where it stands; in braces is what
/// differs.
const TEMPLATE: &str = include_str!("assets/scene.txt");
/// Longer side of the photographs that a fit needs at most; larger ones are downscaled in a new
/// scene file.
const ENOUGH_PIXELS: u32 = 1600;
/// Fewest views of which some are held out.
const FEWEST_HELD_OUT: usize = 12;

/// The scene file `scene` for the data set in `data`, as text; it loads, and `lobelia check`
/// passes. It follows from the camera files and from the first photograph with its mask. A path in
/// it starts at `scene` if that is inside `data`, else at `$DATA`.
///
/// # Errors
/// [`Error::Input`] if the folder is no data set, its first view cannot be read, or it has neither
/// masks nor a mesh: its shape can then not be found.
pub fn scene_for(data: &Path, layout: Layout, scene: &Path) -> Result<String> {
    let asked = layout;
    let layout = find_layout(data, asked, |layout| format!("`--layout {layout:?}`"))?;
    let options = DatasetOptions { layout, hold_out: 0, ..DatasetOptions::default() };
    let OpenDataset { views, .. } = open_dataset(data, Split::Train, &options)?;
    let first =
        views.first().ok_or_else(|| Error::input(data, "", "the data set has no views", ""))?.load()?;
    let Some(photograph) = &first.record.photograph else {
        let problem = "the data set has cameras without photographs: there is nothing to fit to";
        return Err(Error::input(data, "", problem, "Put the photographs where the cameras name them."));
    };
    let (mesh, has_masks) = (mesh_in(data)?, first.record.mask.is_some());
    if mesh.is_none() && !has_masks {
        let problem =
            "the data set has neither masks nor a mesh: without one of them, there is no shape to fit";
        let help = "Add a folder of masks or alpha to the photographs (`lobelia prepare` makes masks), or put mesh.glb into the folder.";
        return Err(Error::input(data, "", problem, help));
    }
    let (count, [width, height]) = (views.len(), photograph.size());
    let has_test = has_split(data, Split::Test, &options)?;
    // A line break in the name would end the comment.
    let folder = data.display().to_string().replace(['\n', '\r'], " ");
    let beside = scene.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let is_beside = matches!((beside.canonicalize(), data.canonicalize()), (Ok(a), Ok(b)) if a == b);
    let (path, below, command) = if is_beside {
        (".", "", format!("lobelia run {folder}/scene.ron --out OUT"))
    } else {
        ("$DATA", "$DATA/", format!("lobelia run SCENE.ron --data {folder} --out OUT"))
    };
    let name = if layout == Layout::Colmap { "COLMAP".to_owned() } else { format!("{layout:?}") };
    // Of other layouts, the world has an up of its own.
    let up = mean_up(&views).filter(|_| layout == Layout::Colmap);
    let downscale = width.max(height).div_ceil(ENOUGH_PIXELS);
    let is_held_out = has_test || count >= FEWEST_HELD_OUT;
    let applies = |mark: &str| match mark {
        "" => true,
        "up" => up.is_some(),
        "mesh" => mesh.is_some(),
        "no mesh" => mesh.is_none(),
        "layout" => asked != Layout::Auto,
        "held out" => is_held_out,
        "every 8th" => is_held_out && !has_test,
        "none" => !is_held_out,
        "small" => downscale <= 1,
        "large" => downscale > 1,
        // Cameras that a data set splits itself come from a renderer or a rig.
        _ => !has_test,
    };
    let lines = TEMPLATE.lines().filter_map(|line| line.split_once('|'));
    let lines = lines.filter(|(mark, _)| applies(mark.trim_end()));
    let text: String = lines.map(|(_, line)| format!("{line}\n")).collect();
    // Adding 0 makes −0 positive.
    let [x, y, z] = (up.unwrap_or_default() + Vec3::ZERO).to_array();
    let mesh = mesh.as_ref().and_then(|mesh| mesh.file_name()).unwrap_or_default().to_string_lossy();
    let slots = [
        ("{count}", count.to_string()),
        ("{size}", format!("{width}×{height}")),
        ("{masks}", if has_masks { "with masks" } else { "without masks" }.to_owned()),
        ("{name}", name),
        ("{up}", format!("{x:.3}, {y:.3}, {z:.3}")),
        ("{path}", path.to_owned()),
        ("{layout}", format!("{layout:?}")),
        ("{downscale}", downscale.to_string()),
        ("{unknowns}", if has_test { "" } else { "exposure: Brightness, cameras: Poses" }.to_owned()),
        ("{comma}", if has_test { "" } else { ", " }.to_owned()),
        ("{command}", command),
        // As it stands inside the quotes of a RON string.
        ("{mesh}", format!("{below}{mesh}").replace('\\', "\\\\").replace('"', "\\\"")),
    ];
    Ok(slots.iter().fold(text, |text, (slot, value)| text.replace(slot, value)))
}

/// The mean of what is up in the pictures, world space; `None` if they have none in common.
fn mean_up(views: &[PlannedView]) -> Option<Vec3> {
    let up = |view: &PlannedView| -Vec3::from(view.world_from_camera().matrix3.y_axis).normalize_or_zero();
    let mean = views.iter().map(up).sum::<Vec3>() / views.len().max(1) as f32;
    (mean.length() > 0.5).then(|| mean.normalize())
}

/// The mesh of a data set: `mesh.glb` or `mesh.gltf`, or the only one in the folder.
fn mesh_in(data: &Path) -> Result<Option<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(data).map_err(Error::io("read", data))? {
        let path = entry.map_err(Error::io("read", data))?.path();
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        if path.is_file() && (extension == "glb" || extension == "gltf") {
            found.push(path);
        }
    }
    found.sort();
    let named = found.iter().position(|path| path.file_stem().is_some_and(|stem| stem == "mesh"));
    Ok(match named {
        Some(named) => Some(found.swap_remove(named)),
        None if found.len() == 1 => found.pop(),
        None => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{LoadOptions, load};
    use image::{Luma, Rgb, RgbImage};
    use std::fs;
    use tempfile::TempDir;

    /// A COLMAP data set as text, of photographs of this size.
    fn data(views: usize, size: [u32; 2], masks: bool) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["images", "sparse/0"] {
            fs::create_dir_all(at(name)).unwrap();
        }
        let [width, height] = size;
        fs::write(
            at("sparse/0/cameras.txt"),
            format!("1 PINHOLE {width} {height} 50 50 {} {}\n", width / 2, height / 2),
        )
        .unwrap();
        let mut images = String::new();
        for i in 0..views {
            images += &format!("{} 1 0 0 0 {i} 0 4 1 {i}.png\n\n", i + 1);
            RgbImage::from_pixel(width, height, Rgb([90; 3])).save(at(&format!("images/{i}.png"))).unwrap();
            if masks {
                fs::create_dir_all(at("masks")).unwrap();
                image::GrayImage::from_fn(width, height, |x, _| Luma([if x > 1 { 255 } else { 0 }]))
                    .save(at(&format!("masks/{i}.png")))
                    .unwrap();
            }
        }
        fs::write(at("sparse/0/images.txt"), images).unwrap();
        folder
    }

    fn loads(folder: &Path, scene: &Path) -> String {
        let text = scene_for(folder, Layout::Auto, scene).unwrap();
        fs::write(scene, &text).unwrap();
        let options = LoadOptions { data: Some(folder.to_owned()), ..LoadOptions::default() };
        let loaded = load(scene, &options).unwrap_or_else(|error| panic!("{error:?}\n{text}"));
        assert!(loaded.unseen.is_empty());
        text
    }

    #[track_caller]
    fn refused(data: &Path, words: &str) -> Error {
        let error = scene_for(data, Layout::Auto, Path::new("scene.ron")).unwrap_err();
        assert!(error.to_string().contains(words) && error.exit_code() == 2, "{error}");
        error
    }

    #[track_caller]
    fn has(text: &str, parts: &[&str]) {
        parts.iter().for_each(|part| assert!(text.contains(part), "{part}\n{text}"));
    }

    #[test]
    fn an_unknown_shape_has_a_shape_pass() {
        let data = data(13, [8, 6], true);
        let inside = data.path().join("scene.ron");
        let text = loads(data.path(), &inside);
        has(&text, &["surface: Unknown()", "path: \".\"", "hold_out: 8", "// 13 photographs of 8×6"]);
        has(
            &text,
            &["Shape(exposure: Brightness, cameras: Poses)", "up: (0.000, -1.000, 0.000)", "\"novel\""],
        );
        assert!(load(&inside, &LoadOptions::default()).is_ok(), "it needs no --data");
        let elsewhere = tempfile::tempdir().unwrap();
        assert!(loads(data.path(), &elsewhere.path().join("a.ron")).contains("path: \"$DATA\""));
    }

    #[test]
    fn views_of_a_training_split_alone_are_held_out() {
        let data = tempfile::tempdir().unwrap();
        let frame = |i: usize| {
            let rows = format!("[[1, 0, 0, {i}], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]");
            format!("{{\"file_path\": \"r_{i}\", \"transform_matrix\": {rows}}}")
        };
        let frames: Vec<String> = (0..13).map(frame).collect();
        let text = format!("{{\"camera_angle_x\": 0.8, \"frames\": [{}]}}", frames.join(", "));
        fs::write(data.path().join("transforms_train.json"), text).unwrap();
        for i in 0..13 {
            image::RgbaImage::from_fn(8, 6, |x, _| image::Rgba([90, 90, 90, if x > 1 { 255 } else { 0 }]))
                .save(data.path().join(format!("r_{i}.png")))
                .unwrap();
        }
        let text = loads(data.path(), &data.path().join("scene.ron"));
        has(&text, &["hold_out: 8", "name: \"novel\""]);
        let test = open_dataset(data.path(), Split::Test, &DatasetOptions::default()).unwrap();
        assert_eq!(test.views.len(), 2);
    }

    #[test]
    fn a_mesh_is_found_and_large_photographs_are_downscaled() {
        let data = data(3, [1700, 4], false);
        fs::write(data.path().join("statue.glb"), "glTF").unwrap();
        let text = loads(data.path(), &data.path().join("scene.ron"));
        has(
            &text,
            &[
                "Mesh(path: \"statue.glb\")",
                "downscale: 2,",
                "hold_out: 0",
                "        Fit(exposure",
                "views: Train",
            ],
        );
        fs::write(data.path().join("other.glb"), "glTF").unwrap();
        assert_eq!(mesh_in(data.path()).unwrap(), None);
        fs::write(data.path().join("mesh.gltf"), "{}").unwrap();
        assert_eq!(mesh_in(data.path()).unwrap(), Some(data.path().join("mesh.gltf")));
    }

    #[test]
    fn data_without_a_shape_and_several_layouts_are_refused() {
        refused(data(3, [8, 6], false).path(), "neither masks nor a mesh");
        let data = data(3, [8, 6], true);
        fs::write(data.path().join("cameras.npz"), "").unwrap();
        let error = refused(data.path(), "several layouts: Colmap, Idr");
        assert_eq!(error.help(), Some("Say which one with `--layout Colmap` or `--layout Idr`."));
        let text = scene_for(data.path(), Layout::Colmap, Path::new("scene.ron")).unwrap();
        assert!(text.contains("layout: Colmap"), "{text}");
    }
}
