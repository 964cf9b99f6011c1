//! Tests of reading data sets, each on a tiny one made in a temporary folder.

mod colmap;
mod layouts;
mod nerf;
mod priors;
mod reading;

use super::*;
use crate::codec::test_data::{input_error, write_exr};
use image::{GrayImage, Luma, Rgb, RgbImage, RgbaImage};
use lobelia_geometry::view::Mask;
use serde_json::{Value, json};
use std::{fs, path::PathBuf};
use tempfile::TempDir;

/// A name with an accent in two forms: as most files of cameras have it, and as file systems of
/// macOS do.
const COMPOSED: &str = "gr\u{fc}n";
const DECOMPOSED: &str = "gru\u{308}n";
/// Width and height of the tiny images.
const SIZE: [u32; 2] = [6, 4];
/// The start of a file of a format that is not read.
const HEIC: &[u8] = b"\0\0\0\x18ftypheic\0\0\0\0";

/// A data set in a temporary folder.
struct Set(TempDir);

impl Set {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The path of a file, in a folder that is there.
    fn file(&self, name: &str) -> PathBuf {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        path
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.file(name), content).unwrap();
    }

    /// Writes a photograph of [`SIZE`] times `factor`, gray with a gradient.
    fn photograph(&self, name: &str, factor: u32) {
        let [width, height] = SIZE.map(|side| side * factor);
        let picture = RgbImage::from_fn(width, height, |x, y| Rgb([90 + x as u8, 90 + y as u8, 90]));
        picture.save(self.file(name)).unwrap();
    }

    /// Writes an EXR of this value in all channels where masks cover, and of another elsewhere.
    fn exr(&self, name: &str, channels: &[&str], inside: f32, outside: f32) {
        let values: Vec<f32> = (0..24).map(|i| if i % 6 < 4 { inside } else { outside }).collect();
        let channels: Vec<_> = channels.iter().map(|channel| (*channel, values.clone())).collect();
        write_exr(&self.file(name), 6, 4, &channels);
    }

    /// Writes a mask of [`SIZE`] that covers the left four columns.
    fn mask(&self, name: &str) {
        GrayImage::from_fn(6, 4, |x, _| Luma([if x < 4 { 255 } else { 0 }])).save(self.file(name)).unwrap();
    }

    fn rename(&self, from: &str, to: &str) {
        fs::rename(self.path(from), self.file(to)).unwrap();
    }

    /// Removes a file or a folder with all that is in it.
    fn remove(&self, name: &str) {
        let path = self.path(name);
        let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
        removed.unwrap();
    }

    /// Puts a value into a JSON file, at this pointer.
    fn put(&self, file: &str, pointer: &str, value: Value) {
        let mut json: Value = serde_json::from_slice(&fs::read(self.path(file)).unwrap()).unwrap();
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        match json.pointer_mut(parent).unwrap() {
            Value::Array(list) => list[key.parse::<usize>().unwrap()] = value,
            object => object[key] = value,
        }
        self.write(file, json.to_string());
    }

    fn open_with(&self, split: Split, options: &DatasetOptions) -> Result<LoadedDataset> {
        read_dataset(self.0.path(), split, options)
    }

    /// All views, without a test split.
    fn all_with(&self, options: DatasetOptions) -> Result<LoadedDataset> {
        self.open_with(Split::Train, &DatasetOptions { hold_out: 0, ..options })
    }

    fn all(&self) -> LoadedDataset {
        self.all_with(DatasetOptions::default()).unwrap()
    }

    fn split(&self, split: Split) -> LoadedDataset {
        self.open_with(split, &DatasetOptions::default()).unwrap()
    }

    /// Whether there is a test split with this `hold_out`.
    fn has_test(&self, hold_out: u32) -> bool {
        let options = DatasetOptions { hold_out, ..DatasetOptions::default() };
        has_split(self.0.path(), Split::Test, &options).unwrap()
    }

    #[track_caller]
    fn assert_splits(&self, train: &[&str], test: &[&str]) {
        assert_eq!(names(&self.split(Split::Train)), train);
        assert_eq!(names(&self.split(Split::Test)), test);
    }

    /// Message and help of the error of reading all views, which is the input's fault.
    #[track_caller]
    fn error(&self) -> String {
        input_error(self.all_with(DatasetOptions::default()))
    }

    /// The error with another value in a JSON file, which is restored.
    #[track_caller]
    fn error_with(&self, file: &str, pointer: &str, value: Value) -> String {
        let before = fs::read(self.path(file)).unwrap();
        self.put(file, pointer, value);
        let error = self.error();
        self.write(file, before);
        error
    }
}

fn names(set: &LoadedDataset) -> Vec<&str> {
    set.views.iter().map(|view| view.name.as_str()).collect()
}

fn mask_of(view: &ViewRecord) -> Mask {
    view.mask.as_ref().unwrap().mask()
}

/// Whether a view has the mask that [`Set::mask`] writes.
fn is_masked(view: &ViewRecord) -> bool {
    view.mask.as_ref().is_some_and(|mask| mask.mask().coverage[3..5] == [1.0, 0.0])
}

#[track_caller]
fn assert_says(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
}

const PHYSG_FILE: &str = "train/cam_dict_norm.json";

fn physg_camera() -> Value {
    json!({
        "K": [8.0, 0.5, 3.0, 0.0,  0.0, 9.0, 2.0, 0.0,  0.0, 0.0, 1.0, 0.0,  0.0, 0.0, 0.0, 1.0],
        "W2C": [0.0, 0.0, -1.0, 0.25,  0.0, -1.0, 0.0, 0.0,  -1.0, 0.0, 0.0, 3.0,  0.0, 0.0, 0.0, 1.0],
        "img_size": SIZE,
    })
}

/// A PhySG data set of EXR images with PNG masks.
fn physg(views: usize) -> Set {
    let set = Set::new();
    let mut cameras = serde_json::Map::new();
    for i in 0..views {
        cameras.insert(format!("v_{i}.exr"), physg_camera());
        set.exr(&format!("train/image/v_{i}.exr"), &["R", "G", "B"], i as f32 + 0.5, 0.0);
        set.mask(&format!("train/mask/v_{i}.png"));
    }
    set.write(PHYSG_FILE, Value::Object(cameras).to_string());
    set
}

/// At (0.1, 0.2, 3), looking along −Z with +Y up.
fn nerf_frame(file_path: &str) -> Value {
    let rows = [[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.2], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]];
    json!({ "file_path": file_path, "transform_matrix": rows })
}

/// A NeRF data set of RGBA PNGs `r_0` … with a file of frames for each of these words.
fn nerf_of(words: &[&str], views: usize) -> Set {
    let set = Set::new();
    let frames: Vec<Value> = (0..views).map(|i| nerf_frame(&format!("./r/r_{i}"))).collect();
    for i in 0..views {
        let image = RgbaImage::from_fn(6, 4, |x, _| {
            image::Rgba(if x < 4 { [10, 20, 30 + i as u8, 255] } else { [9, 9, 9, 0] })
        });
        image.save(set.file(&format!("r/r_{i}.png"))).unwrap();
    }
    let json = json!({ "camera_angle_x": 0.8, "frames": frames }).to_string();
    words.iter().for_each(|word| set.write(&format!("transforms_{word}.json"), &json));
    set
}

const NERF_FILE: &str = "transforms_train.json";

fn nerf(views: usize) -> Set {
    nerf_of(&["train"], views)
}

const TRANSFORMS: &str = "transforms.json";

/// A folder with these photographs, and a file of nerfstudio that names these images.
fn transforms(photographs: &[&str], images: &[&str]) -> Set {
    let set = Set::new();
    photographs.iter().for_each(|path| set.photograph(path, 1));
    let frames: Vec<Value> = images.iter().map(|path| nerf_frame(path)).collect();
    let json = json!({"fl_x": 8.0, "fl_y": 9.0, "cx": 3.0, "cy": 2.0, "w": 6, "h": 4, "frames": frames});
    set.write(TRANSFORMS, json.to_string());
    set
}

/// [`transforms`] of photographs that are where the file says.
fn transforms_of(images: &[&str]) -> Set {
    transforms(images, images)
}

/// A folder with these photographs, and a COLMAP model in `folder` of the images `named`.
fn model(folder: &str, photographs: &[&str], named: &[&str]) -> Set {
    let set = Set::new();
    photographs.iter().for_each(|path| set.photograph(path, 1));
    set.write(&format!("{folder}/cameras.txt"), "1 SIMPLE_PINHOLE 6 4 8 3 2");
    let lines: String = named.iter().map(|name| format!("1 1 0 0 0 0 0 3 1 {name}\n\n")).collect();
    set.write(&format!("{folder}/images.txt"), lines);
    set
}
