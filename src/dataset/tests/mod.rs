//! Tests of reading data sets, each on a tiny one made in a temporary folder.

mod bad;
mod beside;
mod colmap;
mod deepvoxels;
mod distortion;
mod files;
mod good;
mod idr;
mod lists;
mod llff;
mod mask_names;
mod metashape;
mod moved;
mod near;
mod nerfactor;
mod priors;
mod reality_capture;
mod recognition;
mod rounded;
mod splits;
mod stanford_orb;
mod transforms;
mod unicode;

use super::*;
use crate::codec::image::Gamma;
use crate::codec::test_data::write_exr;
use crate::view::Mask;
use image::{GrayImage, RgbaImage};
use serde_json::{Value, json};
use std::fs;
use tempfile::TempDir;

/// Width and height of the tiny images.
const SIZE: (usize, usize) = (6, 4);

fn physg_camera() -> Value {
    json!({
        "K": [8.0, 0.5, 3.0, 0.0,  0.0, 9.0, 2.0, 0.0,  0.0, 0.0, 1.0, 0.0,  0.0, 0.0, 0.0, 1.0],
        "W2C": [0.0, 0.0, -1.0, 0.25,  0.0, -1.0, 0.0, 0.0,  -1.0, 0.0, 0.0, 3.0,  0.0, 0.0, 0.0, 1.0],
        "img_size": [SIZE.0, SIZE.1],
    })
}

/// An EXR channel of this value where masks cover, the left four columns, and 0 elsewhere.
fn on_black(value: f32) -> Vec<f32> {
    (0..SIZE.0 * SIZE.1).map(|i| if i % SIZE.0 < 4 { value } else { 0.0 }).collect()
}

/// A PhySG data set of EXR images with PNG masks, and cameras that can be spoiled before they are written.
struct PhySg {
    dir: TempDir,
    cameras: serde_json::Map<String, Value>,
}

impl PhySg {
    fn new(views: usize) -> Self {
        let dir = tempfile::tempdir().unwrap();
        for folder in ["image", "mask"] {
            fs::create_dir_all(dir.path().join("train").join(folder)).unwrap();
        }
        let mut set = Self { dir, cameras: serde_json::Map::new() };
        for i in 0..views {
            set.cameras.insert(format!("v_{i}.exr"), physg_camera());
            let channels = ["R", "G", "B"].map(|c| (c, on_black(i as f32 + 0.5)));
            write_exr(&set.path(&format!("train/image/v_{i}.exr")), SIZE.0, SIZE.1, &channels);
            set.write_mask(i, |x, _| if x < 4 { 255 } else { 0 });
        }
        set.write_cameras();
        set
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write_mask(&self, view: usize, value: fn(u32, u32) -> u8) {
        let mask = GrayImage::from_fn(SIZE.0 as u32, SIZE.1 as u32, |x, y| image::Luma([value(x, y)]));
        mask.save(self.path(&format!("train/mask/v_{view}.png"))).unwrap();
    }

    fn write_cameras(&self) {
        fs::write(self.path("train/cam_dict_norm.json"), serde_json::to_string(&self.cameras).unwrap())
            .unwrap();
    }

    /// Changes one camera's field and writes the file again.
    fn spoil(&mut self, view: usize, field: &str, value: Value) {
        self.cameras[&format!("v_{view}.exr")][field] = value;
        self.write_cameras();
    }

    fn read(&self) -> Result<LoadedDataset> {
        self.read_with(&DatasetOptions::default())
    }

    /// All views, without a test split.
    fn read_with(&self, options: &DatasetOptions) -> Result<LoadedDataset> {
        let options = DatasetOptions { hold_out: 0, ..options.clone() };
        read_dataset(self.dir.path(), Split::Train, &options)
    }
}

fn nerf_frame(file_path: &str) -> Value {
    json!({
        "file_path": file_path,
        "transform_matrix": [[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.2], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]],
    })
}

/// A NeRF data set of RGBA PNGs, with cameras that can be spoiled before they are written.
struct Nerf {
    dir: TempDir,
    json: Value,
}

impl Nerf {
    fn new(views: usize) -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir_all(dir.path().join("test")).unwrap();
        let frames: Vec<Value> = (0..views).map(|i| nerf_frame(&format!("./test/r_{i}"))).collect();
        let set = Self { dir, json: json!({ "camera_angle_x": 0.8, "frames": frames }) };
        for i in 0..views {
            let image = RgbaImage::from_fn(SIZE.0 as u32, SIZE.1 as u32, |x, _| {
                if x < 4 { image::Rgba([10, 20, 30 + i as u8, 255]) } else { image::Rgba([9, 9, 9, 0]) }
            });
            image.save(set.path(&format!("test/r_{i}.png"))).unwrap();
        }
        set.write();
        set
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write(&self) {
        let text = serde_json::to_string_pretty(&self.json).unwrap();
        fs::write(self.path("transforms_test.json"), text).unwrap();
    }

    fn read(&self) -> Result<LoadedDataset> {
        read_dataset(self.dir.path(), Split::Test, &DatasetOptions::default())
    }
}

/// Message and help of an error that is the input's fault.
fn input_error(result: Result<LoadedDataset>) -> String {
    let error = result.unwrap_err();
    assert!(matches!(error, Error::Input { .. }), "{error:?}");
    format!("{error} | {}", error.help().unwrap_or_default())
}

fn usage_error(result: Result<LoadedDataset>) -> String {
    let error = result.unwrap_err();
    assert!(matches!(error, Error::Usage { .. }), "{error:?}");
    format!("{error} | {}", error.help().unwrap_or_default())
}

fn names(dataset: &LoadedDataset) -> Vec<&str> {
    dataset.views.iter().map(|view| view.name.as_str()).collect()
}

#[track_caller]
fn assert_says(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
}

fn mask_of(view: &ViewRecord) -> Mask {
    view.mask.as_ref().unwrap().mask()
}

/// Writes a photograph of [`SIZE`] times `factor`, gray with a gradient.
fn write_photograph(path: &Path, factor: u32) {
    let [width, height] = [SIZE.0 as u32 * factor, SIZE.1 as u32 * factor];
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::RgbImage::from_fn(width, height, |x, y| image::Rgb([90 + x as u8, 90 + y as u8, 90]))
        .save(path)
        .unwrap();
}

/// Writes a mask of [`SIZE`] that covers the left four columns.
fn write_mask(path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let value = |x, _| image::Luma([if x < 4 { 255 } else { 0 }]);
    GrayImage::from_fn(SIZE.0 as u32, SIZE.1 as u32, value).save(path).unwrap();
}

fn read_split(dir: &Path, split: Split) -> Result<LoadedDataset> {
    read_dataset(dir, split, &DatasetOptions::default())
}

/// All views, without a test split.
fn read_all(dir: &Path) -> Result<LoadedDataset> {
    read_dataset(dir, Split::Train, &DatasetOptions { hold_out: 0, ..DatasetOptions::default() })
}
