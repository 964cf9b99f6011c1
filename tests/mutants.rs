//! Some hundred changed copies of a small good file for each parser: every one is read or refused, in little time, without a panic. The same
//! copies at every run; `fuzz/` has those that are found by looking.

use crate::common::{Data, evening};
use glam::Vec3;
use lobelia::codec::exr::read_exr_layers;
use lobelia::codec::exr_frame::{Frame, read_frame, write_frame};
use lobelia::codec::gltf::export::write_glb;
use lobelia::codec::gltf::import::read_mesh;
use lobelia::codec::gltf::material::read_material;
use lobelia::codec::image::{Gamma, Orientation, read_image, read_mask};
use lobelia::codec::npy::{NpyConvention, read_lobes, write_lobes};
use lobelia::codec::npz::Npz;
use lobelia::dataset::{DatasetOptions, read_dataset};
use lobelia::light::EnvironmentMap;
use lobelia::mesh::primitive::box_mesh;
use lobelia::scene::{LoadOptions, load};
use lobelia::spawn::light_file::{LightConventions, read_light};
use lobelia::view::Split;
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use std::io::Write as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Changed copies of each file.
const MUTANTS: u64 = 300;
/// Most time for one of them.
const MOST_TIME: Duration = Duration::from_secs(10);

/// What numbers in texts are replaced by.
const NUMBERS: [&str; 12] = [
    "-1",
    "0",
    "1e999",
    "-1e38",
    "nan",
    "18446744073709551616",
    "4294967295",
    "0.0000001",
    "\"x\"",
    "[]",
    "{}",
    "",
];

fn mutant(good: &[u8], seed: u64) -> Vec<u8> {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut bytes = good.to_vec();
    for _ in 0..random.random_range(1..4) {
        let at = random.random_range(0..bytes.len().max(1)).min(bytes.len().saturating_sub(1));
        if bytes.is_empty() {
            return bytes;
        }
        match random.random_range(0..7) {
            0 => bytes[at] ^= 1 << random.random_range(0..8),
            1 => bytes[at] = [0, 0xff, 0x7f, 0x80][random.random_range(0..4)],
            2 => bytes.truncate(at),
            3 => {
                let end = (at + random.random_range(1..40)).min(bytes.len());
                let part = bytes[at..end].to_vec();
                bytes.splice(at..at, part);
            }
            4 => drop(bytes.drain(at..(at + random.random_range(1..9)).min(bytes.len()))),
            5 => {
                let end = (at + 4).min(bytes.len());
                let word = random.random::<u32>().to_le_bytes();
                bytes[at..end].copy_from_slice(&word[..end - at]);
            }
            _ => replace_number(&mut bytes, at, NUMBERS[random.random_range(0..NUMBERS.len())]),
        }
    }
    bytes
}

/// Replaces the next number in a text.
fn replace_number(bytes: &mut Vec<u8>, from: usize, by: &str) {
    let is_digit = |byte: &u8| byte.is_ascii_digit() || *byte == b'.';
    let Some(start) = bytes[from..].iter().position(is_digit).map(|at| from + at) else { return };
    let length = bytes[start..].iter().position(|byte| !is_digit(byte)).unwrap_or(bytes.len() - start);
    bytes.splice(start..start + length, by.bytes());
}

/// Reads `path` in `MUTANTS` changed forms.
#[track_caller]
fn survives(path: &Path, read: impl Fn(&Path) -> Result<(), lobelia::Error>) {
    let good = std::fs::read(path).unwrap();
    read(path).unwrap_or_else(|error| panic!("{}: the good file is refused: {error}", path.display()));
    let mut refused = 0;
    for seed in 0..MUTANTS {
        std::fs::write(path, mutant(&good, seed)).unwrap();
        let started = Instant::now();
        let Ok(ended) = catch_unwind(AssertUnwindSafe(|| read(path))) else {
            panic!("{}: mutant {seed} ends in a panic", path.display());
        };
        let took = started.elapsed();
        assert!(took < MOST_TIME, "{}: mutant {seed} takes {took:?}", path.display());
        if let Err(error) = ended {
            refused += 1;
            assert!(!error.to_string().is_empty() && error.to_string().len() < 4000, "{error}");
            assert!(matches!(error.exit_code(), 1 | 2), "mutant {seed}: {error}");
        }
    }
    std::fs::write(path, good).unwrap();
    assert!(refused > 0, "{}: no mutant is refused", path.display());
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

#[test]
fn scene_files() {
    let folder = Folder::new();
    let text = include_str!("../scenes/quickstart.ron");
    survives(&folder.file("scene.ron", text), |path| load(path, &LoadOptions::default()).map(drop));
}

#[test]
fn light_files() {
    let folder = Folder::new();
    let light = "Lobes(lobes: [(axis: (0, 1, 0), sharpness: 5, amplitude: (1, 0.5, 0.25))], scale: 2)";
    survives(&folder.file("light.ron", light), |path| {
        read_light(path, LightConventions::default()).map(drop)
    });
}

fn dataset(root: &Path) -> Result<(), lobelia::Error> {
    let options = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
    read_dataset(root, Split::Train, &options).map(drop)
}

#[test]
fn cameras_of_physg() {
    let data = Data::new();
    survives(&data.path("train/cam_dict_norm.json"), |_| dataset(data.root()));
}

const PNG: &str = "images/a.png";

/// A folder with a photograph of 8 × 6 pixels.
fn photograph() -> Folder {
    let folder = Folder::new();
    folder.file(PNG, "");
    image::RgbImage::from_pixel(8, 6, image::Rgb([90, 120, 60])).save(folder.path(PNG)).unwrap();
    folder
}

#[test]
fn cameras_of_nerf() {
    let folder = photograph();
    let cameras = r#"{"fl_x": 10.0, "fl_y": 10.0, "cx": 4.0, "cy": 3.0, "w": 8, "h": 6, "k1": 0.01, "frames": [
        {"file_path": "images/a.png", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]}]}"#;
    survives(&folder.file("transforms.json", cameras), |_| dataset(folder.0.path()));
}

#[test]
fn colmap_as_text() {
    let folder = photograph();
    let cameras = folder.file("sparse/0/cameras.txt", "# cameras\n1 SIMPLE_RADIAL 8 6 10.0 4.0 3.0 0.01\n");
    let images = folder.file("sparse/0/images.txt", "# images\n1 1 0 0 0 0 0 3 1 a.png\n\n");
    folder.file("sparse/0/points3D.txt", "");
    survives(&cameras, |_| dataset(folder.0.path()));
    survives(&images, |_| dataset(folder.0.path()));
}

#[test]
fn colmap_as_bytes() {
    let folder = photograph();
    let mut camera = 1u64.to_le_bytes().to_vec();
    camera.extend([1i32.to_le_bytes(), 2i32.to_le_bytes()].concat());
    camera.extend([8u64.to_le_bytes(), 6u64.to_le_bytes()].concat());
    camera.extend([10.0f64, 4.0, 3.0, 0.01].iter().flat_map(|value| value.to_le_bytes()));
    let mut image = 1u64.to_le_bytes().to_vec();
    image.extend(1i32.to_le_bytes());
    image.extend([1.0f64, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0].iter().flat_map(|value| value.to_le_bytes()));
    image.extend(1i32.to_le_bytes());
    image.extend(b"a.png\0");
    image.extend(0u64.to_le_bytes());
    let cameras = folder.file("sparse/0/cameras.bin", camera);
    let images = folder.file("sparse/0/images.bin", image);
    folder.file("sparse/0/points3D.bin", 0u64.to_le_bytes());
    survives(&cameras, |_| dataset(folder.0.path()));
    survives(&images, |_| dataset(folder.0.path()));
}

#[test]
fn arrays_of_lobes() {
    let folder = Folder::new();
    let path = folder.path("light.npy");
    write_lobes(&path, &evening(), NpyConvention::Lobelia).unwrap();
    survives(&path, |path| read_lobes(path, NpyConvention::Lobelia).map(drop));
}

#[test]
fn archives_of_matrices() {
    let folder = Folder::new();
    let path = folder.file("cameras.npz", "");
    let mut header = "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 2), }".to_owned();
    header += &" ".repeat(128 - 11 - header.len());
    let values = [1.0f64, 2.0, 3.0, 4.0].iter().flat_map(|value| value.to_le_bytes());
    let mut array = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    array.extend(header.bytes().chain([b'\n']).chain(values));
    let mut archive = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
    archive.start_file("k.npy", zip::write::SimpleFileOptions::default()).unwrap();
    archive.write_all(&array).unwrap();
    archive.finish().unwrap();
    survives(&path, |path| {
        let mut archive = Npz::open(path, |_| String::new())?;
        let names = archive.names();
        names.iter().try_for_each(|name| archive.matrix(name).map(drop))
    });
}

#[test]
fn meshes() {
    let folder = Folder::new();
    let path = folder.path("mesh.glb");
    write_glb(&path, &box_mesh(Vec3::ZERO, Vec3::ONE).unwrap(), None).unwrap();
    survives(&path, |path| {
        // Most have no material.
        let _ = read_material(path);
        read_mesh(path).map(drop)
    });
}

fn frame() -> Frame {
    let (width, height) = (8, 4);
    let colors: Vec<Vec3> = (0..width * height).map(|i| Vec3::new(0.1, 0.02 * i as f32, 0.5)).collect();
    Frame {
        width,
        height,
        color: colors.clone(),
        diffuse: colors.clone(),
        specular: colors.clone(),
        albedo: colors.clone(),
        normal: colors,
        depth: vec![1.0; width * height],
        alpha: vec![1.0; width * height],
    }
}

#[test]
fn pictures_and_maps_in_openexr() {
    let folder = Folder::new();
    let path = folder.path("a.exr");
    write_frame(&path, &frame()).unwrap();
    survives(&path, |path| read_exr_layers(path).map(drop));
    survives(&path, |path| read_frame(path).map(drop));
    survives(&path, |path| read_image(path, Gamma::Srgb, Orientation::AsStored).map(drop));
    survives(&path, |path| EnvironmentMap::read(path).map(drop));
}

#[test]
fn maps_in_radiance_hdr() {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n".to_vec();
    bytes.extend((0..32).flat_map(|i| [i * 8, 100, 200, 128]));
    let folder = Folder::new();
    let path = folder.file("a.hdr", bytes);
    survives(&path, |path| EnvironmentMap::read(path).map(drop));
    survives(&path, |path| read_image(path, Gamma::Srgb, Orientation::AsStored).map(drop));
}

#[test]
fn photographs_and_masks() {
    let folder = Folder::new();
    let picture = image::RgbImage::from_fn(9, 7, |x, y| image::Rgb([x as u8 * 20, y as u8 * 30, 77]));
    for name in ["a.png", "a.jpg"] {
        let path = folder.path(name);
        picture.save(&path).unwrap();
        survives(&path, |path| read_image(path, Gamma::Srgb, Orientation::AsStored).map(drop));
    }
    let path = folder.path("mask.png");
    image::GrayImage::from_fn(9, 7, |x, _| image::Luma([if x > 3 { 255 } else { 0 }])).save(&path).unwrap();
    survives(&path, |path| read_mask(path, Orientation::AsStored).map(drop));
}
