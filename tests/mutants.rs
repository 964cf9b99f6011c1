//! A hundred changed copies of a small good file for each parser: every one is read or refused, in
//! little time, without a panic. The same copies at every run; `fuzz/` has those that are found by
//! looking.

use crate::common::{Data, camera, day, shoot, studio};
use glam::Vec3;
use lobelia::codec::exr_frame::{read_frame, write_frame};
use lobelia::codec::image::{Gamma, Orientation, read_image};
use lobelia::dataset::{DatasetOptions, read_dataset};
use lobelia::scene::{LoadOptions, load};
use lobelia::view::{Camera, Split};
use lobelia::{
    codec::envmap::read_map, codec::exr::read_exr_layers, codec::gltf::export::write_glb,
    codec::gltf::import::read_mesh, codec::gltf::material::read_material, mesh::primitive::box_mesh,
};
use rand::{RngExt, SeedableRng, rngs::SmallRng};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

/// Changed copies of each file.
const MUTANTS: u64 = 100;
/// Most time for one of them.
const MOST_TIME: Duration = Duration::from_secs(10);

/// Replacements for numbers in texts.
const NUMBERS: [&str; 8] = ["-1", "0", "1e999", "nan", "18446744073709551616", "4294967295", "\"x\"", ""];

fn mutant(good: &[u8], seed: u64) -> Vec<u8> {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut bytes = good.to_vec();
    for _ in 0..random.random_range(1..4) {
        if bytes.is_empty() {
            return bytes;
        }
        let at = random.random_range(0..bytes.len());
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

#[test]
fn scene_files() {
    let folder = Data::bare();
    let text = include_str!("../scenes/quickstart.ron");
    survives(&folder.write("scene.ron", text), |path| load(path, &LoadOptions::default()).map(drop));
}

fn dataset(root: &Path) -> Result<(), lobelia::Error> {
    let options = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
    read_dataset(root, Split::Train, &options).map(drop)
}

const PNG: &str = "images/a.png";

/// A folder with a photograph of 8 × 6 pixels.
fn photograph() -> Data {
    let folder = Data::bare();
    folder.write(PNG, "");
    image::RgbImage::from_pixel(8, 6, image::Rgb([90, 120, 60])).save(folder.path(PNG)).unwrap();
    folder
}

#[test]
fn cameras_of_nerf() {
    let folder = photograph();
    let cameras = r#"{"fl_x": 10.0, "fl_y": 10.0, "cx": 4.0, "cy": 3.0, "w": 8, "h": 6, "k1": 0.01, "frames": [
        {"file_path": "images/a.png", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]}]}"#;
    survives(&folder.write("transforms.json", cameras), |_| dataset(folder.root()));
}

#[test]
fn colmap_as_bytes() {
    let folder = photograph();
    let (int, count) = (|value: i32| value.to_le_bytes().to_vec(), |value: u64| value.to_le_bytes().to_vec());
    let floats = |values: &[f64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let camera = [count(1), int(1), int(2), count(8), count(6), floats(&[10.0, 4.0, 3.0, 0.01])];
    let pose = floats(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0]);
    let image = [count(1), int(1), pose, int(1), b"a.png\0".to_vec(), count(0)];
    let cameras = folder.write("sparse/0/cameras.bin", camera.concat());
    let images = folder.write("sparse/0/images.bin", image.concat());
    folder.write("sparse/0/points3D.bin", count(0));
    survives(&cameras, |_| dataset(folder.root()));
    survives(&images, |_| dataset(folder.root()));
    survives(&folder.path(PNG), |_| dataset(folder.root()));
}

#[test]
fn meshes() {
    let folder = Data::bare();
    let path = folder.path("mesh.glb");
    write_glb(&path, &box_mesh(Vec3::ZERO, Vec3::ONE).unwrap(), None).unwrap();
    survives(&path, |path| {
        // Most have no material.
        let _ = read_material(path);
        read_mesh(path).map(drop)
    });
}

#[test]
fn pictures_and_maps_in_openexr() {
    let folder = Data::bare();
    let path = folder.path("a.exr");
    // Twice as wide as high, as maps are.
    let camera = Camera { height: 4, ..camera([0.1, 0.2, 1.0], 8) };
    write_frame(&path, &shoot(&mut studio(&day()), camera)).unwrap();
    survives(&path, |path| read_exr_layers(path).map(drop));
    survives(&path, |path| read_frame(path).map(drop));
    survives(&path, |path| read_image(path, Gamma::Srgb, Orientation::AsStored).map(drop));
    survives(&path, |path| read_map(path).map(drop));
}
