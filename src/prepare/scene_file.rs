//! A commented scene file for a data set: what is known of it, what a fit has to find, and what may be worth changing.

use crate::dataset::{
    DatasetOptions, Layout, OpenDataset, PlannedView, find_layout, has_split, masks_hint, open_dataset,
};
use crate::error::{Error, Result};
use crate::view::Split;
use glam::Vec3;
use std::path::{Path, PathBuf};

/// Longer side of the photographs that a fit needs at most; larger ones are downscaled in a new scene file.
const ENOUGH_PIXELS: u32 = 1600;
/// Fewest views of which some are held out.
const FEWEST_HELD_OUT: usize = 12;
/// Extensions of meshes.
const MESHES: [&str; 2] = ["glb", "gltf"];

/// What a data set has.
#[derive(Clone, Debug, PartialEq)]
pub struct DatasetSummary {
    /// The layout.
    pub layout: Layout,
    /// Whether it was asked for, because the folder has several.
    pub is_asked: bool,
    /// The mesh in the folder, if there is exactly one or one called `mesh`.
    pub mesh: Option<PathBuf>,
    /// Training views when every view is one that the data set does not hold out itself.
    pub views: usize,
    /// Width and height of the first photograph in pixels.
    pub size: [u32; 2],
    /// Whether the first view has a mask.
    pub has_masks: bool,
    /// Where there are no masks: a folder that may have them under an unusual name.
    pub masks_beside: Option<PathBuf>,
    /// Whether the data set has a test split of its own.
    pub has_test: bool,
    /// Up in the photographs on average, world space, where a layout's world has no up of its own.
    pub up: Option<Vec3>,
}

/// Looks at a data set: its camera files, and the first photograph with its mask.
///
/// # Errors
/// [`Error::Input`] if the folder is no data set, or its first view cannot be read.
pub fn summarize(data: &Path, asked: Layout) -> Result<DatasetSummary> {
    let layout = find_layout(data, asked, |layout| format!("`--layout {layout:?}`"))?;
    let options = DatasetOptions { layout, hold_out: 0, ..DatasetOptions::default() };
    let OpenDataset { views, masks_beside, .. } = open_dataset(data, Split::Train, &options)?;
    let first =
        views.first().ok_or_else(|| Error::input(data, "", "the data set has no views", ""))?.load()?;
    let (Some(photograph), mask) = (&first.record.photograph, &first.record.mask) else {
        let problem = "the data set has cameras without photographs: there is nothing to fit to";
        return Err(Error::input(data, "", problem, "Put the photographs where the cameras name them."));
    };
    Ok(DatasetSummary {
        layout,
        is_asked: asked != Layout::Auto,
        mesh: mesh_in(data)?,
        views: views.len(),
        size: photograph.size(),
        has_masks: mask.is_some(),
        masks_beside,
        has_test: has_split(data, Split::Test, &options)?,
        up: if layout == Layout::Colmap { mean_up(&views) } else { None },
    })
}

/// The mean of what is up in the pictures, world space; `None` if they have none in common.
fn mean_up(views: &[PlannedView]) -> Option<Vec3> {
    let up = |view: &PlannedView| -Vec3::from(view.world_from_camera().matrix3.y_axis).normalize_or_zero();
    let mean = views.iter().map(up).sum::<Vec3>() / views.len().max(1) as f32;
    (mean.length() > 0.5).then(|| mean.normalize())
}

/// The scene file `scene` for the data set in `data`, as text. A path in it starts at `scene` if that is inside `data`, else at `$DATA`.
///
/// # Errors
/// Those of [`summarize`]; [`Error::Input`] if a data set has neither masks nor a mesh: its shape can then not be found.
pub fn scene_for(data: &Path, layout: Layout, scene: &Path) -> Result<String> {
    let summary = summarize(data, layout)?;
    if summary.mesh.is_none() && !summary.has_masks {
        let problem =
            "the data set has neither masks nor a mesh: without one of them, there is no shape to fit";
        let beside = summary.masks_beside.as_deref().map(|folder| format!("{}. Or: ", masks_hint(folder)));
        let help = format!(
            "{}Add a folder of masks or alpha to the photographs (`lobelia prepare` makes masks), or put mesh.glb into the folder.",
            beside.unwrap_or_default()
        );
        return Err(Error::input(data, "", problem, help));
    }
    Ok(scene_text(&summary, data, is_beside(data, scene)))
}

/// Whether the scene file lies directly in the data's folder.
fn is_beside(data: &Path, scene: &Path) -> bool {
    let folder = scene.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    matches!((folder.canonicalize(), data.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// The mesh of a data set: `mesh.glb` or `mesh.gltf`, or the only one in the folder.
fn mesh_in(data: &Path) -> Result<Option<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(data).map_err(Error::io("read", data))? {
        let path = entry.map_err(Error::io("read", data))?.path();
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        if path.is_file() && MESHES.contains(&extension.as_str()) {
            found.push(path);
        }
    }
    found.sort();
    let named = found.iter().find(|path| path.file_stem().is_some_and(|stem| stem == "mesh"));
    Ok(match (named, found.as_slice()) {
        (Some(mesh), _) => Some(mesh.clone()),
        (None, [only]) => Some(only.clone()),
        _ => None,
    })
}

/// What a new scene file says; it loads, and `lobelia check` passes.
fn scene_text(summary: &DatasetSummary, data: &Path, is_beside: bool) -> String {
    let downscale = summary.size[0].max(summary.size[1]).div_ceil(ENOUGH_PIXELS).max(1);
    // Cameras that a data set splits itself come from a renderer or a rig; the others from photographs.
    let is_captured = !summary.has_test;
    let tests = summary.has_test || summary.views >= FEWEST_HELD_OUT;
    let mut text = header(summary, data, is_beside);
    text += "Scene(\n    version: 1,\n";
    if let Some(up) = summary.up {
        text += "    // Up in the photographs on average: orbits turn around it.\n";
        // Adding 0 makes −0 positive.
        let up = up + Vec3::ZERO;
        text += &format!("    up: ({:.3}, {:.3}, {:.3}),\n", up.x, up.y, up.z);
    }
    text += &surface(summary, is_beside);
    text += &views(summary, is_beside, downscale);
    text += MATERIAL;
    text += "    passes: [\n";
    text += &fits(summary, is_captured);
    text += if tests {
        "        // The held-out views, rendered and compared with their photographs.\n        Render(name: \"novel\"),\n        \
         Evaluate(name: \"scores\", scores: [(pass: \"novel\", truth: Photographs)]),\n"
    } else {
        "        // No view is held out; the training views are rendered and compared with their photographs.\n        \
         Render(name: \"again\", render: (views: Train)),\n        \
         Evaluate(name: \"scores\", scores: [(pass: \"again\", truth: Photographs)]),\n"
    };
    text += LAST_PASSES;
    text
}

fn header(summary: &DatasetSummary, data: &Path, is_beside: bool) -> String {
    let [width, height] = summary.size;
    let masks = if summary.has_masks { "with masks" } else { "without masks" };
    // A line break in the name would end the comment.
    let folder = data.display().to_string().replace(['\n', '\r'], " ");
    let command = if is_beside {
        format!("lobelia run {folder}/scene.ron --out OUT")
    } else {
        format!("lobelia run SCENE.ron --data {folder} --out OUT")
    };
    let layout = match summary.layout {
        Layout::Colmap => "COLMAP".to_owned(),
        other => format!("{other:?}"),
    };
    format!(
        "// {} photographs of {width}×{height} pixels {masks}, in the layout of {layout}.\n// {command}\n\
         // A quick try: --set views.downscale=4 --set passes.fit.steps=200\n",
        summary.views
    )
}

fn surface(summary: &DatasetSummary, is_beside: bool) -> String {
    let folder = if is_beside { "" } else { "$DATA/" };
    let name = summary.mesh.as_ref().and_then(|mesh| mesh.file_name());
    match name.map(|name| name.to_string_lossy()) {
        Some(name) => format!(
            "    // The shape is known. `Unknown()` finds it from photographs and masks instead; it needs a `Shape()` pass first.\n    \
             surface: Mesh(path: \"{}\"),\n",
            quoted(&format!("{folder}{name}"))
        ),
        None => "    // The shape is found from photographs and masks. With a mesh: Mesh(path: \"mesh.glb\"), and no `Shape` pass.\n    \
                 surface: Unknown(),\n"
            .to_owned(),
    }
}

/// Text inside the quotes of a RON string.
fn quoted(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"")
}

fn views(summary: &DatasetSummary, is_beside: bool, downscale: u32) -> String {
    let path = if is_beside { "." } else { "$DATA" };
    let hold_out = match (summary.has_test, summary.views >= FEWEST_HELD_OUT) {
        (true, _) => String::new(),
        (false, true) => "        // Every 8th view is kept out of the fit to measure the quality; 0: none.\n        hold_out: 8,\n".into(),
        (false, false) => "        // So few views are all needed; 8 would keep every 8th out of the fit.\n        hold_out: 0,\n".into(),
    };
    let size = if downscale > 1 {
        format!(
            "        // Full size needs more memory and time, and rarely gives more.\n        downscale: {downscale},\n"
        )
    } else {
        "        // downscale: 2,        // half the size: a quarter of memory and time\n".to_owned()
    };
    let layout =
        if summary.is_asked { format!("        layout: {:?},\n", summary.layout) } else { String::new() };
    format!(
        "    views: Dataset(\n        path: \"{path}\",\n{layout}{hold_out}{size}        \
         // gamma: Linear,       // 8- and 16-bit values are taken as sRGB; this says otherwise\n    ),\n"
    )
}

/// Light and material are unknown by default.
const MATERIAL: &str = "    // Light and material are unknown. What is known can be said, for example:\n    \
    // light: Fixed(Map(path: \"sky.exr\")),\n    \
    // material: (specular: (albedo: Fixed(0.04, 0.04, 0.04))),    // a plain dielectric\n    \
    // material: (gloss: Blend(materials: 2)),                     // glossy and matte regions\n";

fn fits(summary: &DatasetSummary, is_captured: bool) -> String {
    let mut text = String::new();
    if is_captured {
        text += "        // Photographs of a camera: each has an exposure of its own, and poses are a little off. With a locked exposure\n        \
                 // or exact poses, leave these out. A light that turns with the camera, as on a turntable, is found.\n";
    }
    let unknowns = if is_captured { "exposure: Brightness, cameras: Poses" } else { "" };
    match summary.mesh {
        Some(_) => text + &format!("        Fit({unknowns}),\n"),
        None => {
            let comma = if is_captured { ", " } else { "" };
            text + &format!(
                "        Shape({unknowns}),\n        Fit({unknowns}{comma}vertices: true, detail: true,\n            steps: 1200, rates: (albedo: 0.02, light: 0.02, specular: 0.01)),\n"
            )
        }
    }
}

const LAST_PASSES: &str = "        // The object as a scene of its own, with everything known, and as meshes for other programs.\n        \
    Save(name: \"saved\"),\n        Export(name: \"export\"),\n    ],\n)\n";

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

    #[test]
    fn an_unknown_shape_has_a_shape_pass() {
        let data = data(13, [8, 6], true);
        let inside = data.path().join("scene.ron");
        let text = loads(data.path(), &inside);
        for part in [
            "surface: Unknown()",
            "path: \".\"",
            "hold_out: 8",
            "Shape(exposure: Brightness, cameras: Poses)",
            "// 13 photographs of 8×6",
            "up: (0.000, -1.000, 0.000)",
            "name: \"novel\"",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        let options = LoadOptions::default();
        assert!(load(&inside, &options).is_ok(), "it needs no --data");
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
        assert!(text.contains("hold_out: 8") && text.contains("name: \"novel\""), "{text}");
        let test = open_dataset(data.path(), Split::Test, &DatasetOptions::default()).unwrap();
        assert_eq!(test.views.len(), 2);
    }

    #[test]
    fn a_mesh_is_found_and_large_photographs_are_downscaled() {
        let data = data(3, [1700, 4], false);
        fs::write(data.path().join("statue.glb"), "glTF").unwrap();
        let text = loads(data.path(), &data.path().join("scene.ron"));
        for part in [
            "Mesh(path: \"statue.glb\")",
            "downscale: 2,",
            "hold_out: 0",
            "        Fit(exposure",
            "views: Train",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        fs::write(data.path().join("other.glb"), "glTF").unwrap();
        assert_eq!(mesh_in(data.path()).unwrap(), None);
        fs::write(data.path().join("mesh.gltf"), "{}").unwrap();
        assert_eq!(mesh_in(data.path()).unwrap(), Some(data.path().join("mesh.gltf")));
    }

    #[test]
    fn data_of_which_no_shape_follows_is_refused() {
        let data = data(3, [8, 6], false);
        let error = scene_for(data.path(), Layout::Auto, &data.path().join("scene.ron")).unwrap_err();
        assert!(error.to_string().contains("neither masks nor a mesh") && error.exit_code() == 2, "{error}");
    }

    #[test]
    fn a_folder_that_may_have_masks_is_named() {
        let data = data(3, [8, 6], false);
        fs::create_dir(data.path().join("figure")).unwrap();
        for i in 0..3 {
            image::GrayImage::from_fn(8, 6, |x, _| Luma([if x > 1 { 255 } else { 0 }]))
                .save(data.path().join(format!("figure/{i}.png")))
                .unwrap();
        }
        let scene = data.path().join("scene.ron");
        let error = scene_for(data.path(), Layout::Auto, &scene).unwrap_err();
        let help = error.help().unwrap();
        assert!(help.contains("figure has images of the same names: rename it to masks/"), "{help}");
        fs::rename(data.path().join("figure"), data.path().join("figure_masks")).unwrap();
        assert!(scene_for(data.path(), Layout::Auto, &scene).unwrap().contains("surface: Unknown()"));
    }

    #[test]
    fn several_layouts_are_told_in_the_words_of_the_command_line() {
        let data = data(3, [8, 6], true);
        fs::write(data.path().join("cameras.npz"), "").unwrap();
        let error = summarize(data.path(), Layout::Auto).unwrap_err();
        assert!(error.to_string().contains("several layouts: Colmap, Idr"), "{error}");
        assert_eq!(error.help(), Some("Say which one with `--layout Colmap` or `--layout Idr`."));
        assert!(
            scene_for(data.path(), Layout::Colmap, Path::new("scene.ron"))
                .unwrap()
                .contains("layout: Colmap")
        );
    }

    #[test]
    fn photographs_without_cameras_lead_to_prepare() {
        let data = data(3, [8, 6], false);
        fs::remove_dir_all(data.path().join("sparse")).unwrap();
        for folder in [data.path().to_owned(), data.path().join("images")] {
            let error = summarize(&folder, Layout::Auto).unwrap_err();
            let help = error.help().unwrap();
            assert!(
                help.contains("3 photographs and no cameras") && help.contains("lobelia prepare"),
                "{help}"
            );
        }
        let empty = tempfile::tempdir().unwrap();
        assert!(summarize(empty.path(), Layout::Auto).unwrap_err().to_string().contains("not a data set"));
        assert!(
            summarize(&empty.path().join("none"), Layout::Auto)
                .unwrap_err()
                .to_string()
                .contains("no such folder")
        );
        assert!(
            summarize(&data.path().join("images/0.png"), Layout::Auto)
                .unwrap_err()
                .to_string()
                .contains("a file")
        );
    }
}
