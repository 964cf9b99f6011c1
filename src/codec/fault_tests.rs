//! Every codec on a disk that gives few bytes at a time, is interrupted, or fails: the same bytes and values, or one error and nothing left.

use crate::codec::exr::read_exr_layers;
use crate::codec::exr_frame::{Frame, read_frame, write_frame};
use crate::codec::file::faults::{Call, Faulty, FileFault};
use crate::codec::file::{read_parts, read_text, write_bytes};
use crate::codec::gltf::export::write_glb;
use crate::codec::gltf::import::read_mesh;
use crate::codec::image::{Gamma, Orientation, image_header, read_image, read_mask};
use crate::codec::npy::{NpyConvention, read_lobes, write_lobes};
use crate::codec::npz::Npz;
use crate::codec::ply_obj::write_ply;
use crate::codec::png_file::{write_gray8, write_rgb8};
use crate::codec::test_data::{hdr_bytes, npy_matrix, write_npz};
use crate::error::{Error, Result};
use crate::light::EnvironmentMap;
use crate::light::LightLobe;
use crate::mesh::primitive::box_mesh;
use glam::Vec3;
use image::{GrayImage, Luma, Rgb, RgbImage};
use std::path::Path;

/// The numbers of errors: EIO, ENOSPC, EPIPE.
const ERRORS: [i32; 3] = [5, 28, 32];

type Writer = (&'static str, fn(&Path) -> Result<()>);
type Reader = (&'static str, fn(&Path), fn(&Path) -> Result<String>);

fn picture() -> RgbImage {
    RgbImage::from_fn(19, 13, |x, y| Rgb([x as u8 * 13, y as u8 * 19, (x * y) as u8]))
}

fn frame() -> Frame {
    let (width, height) = (9, 7);
    let colors: Vec<Vec3> = (0..width * height).map(|i| Vec3::new(0.1, 0.02 * i as f32, 0.5)).collect();
    Frame {
        width,
        height,
        color: colors.clone(),
        diffuse: colors.clone(),
        specular: colors.clone(),
        albedo: colors.clone(),
        normal: colors.clone(),
        depth: vec![1.0; width * height],
        alpha: vec![1.0; width * height],
    }
}

fn lobes() -> Vec<LightLobe> {
    LightLobe::even(7)
}

fn cube() -> crate::mesh::triangles::Mesh {
    box_mesh(Vec3::ZERO, Vec3::ONE).unwrap()
}

const WRITERS: [Writer; 6] = [
    ("a.png", |path| write_rgb8(path, &picture())),
    ("a.exr", |path| write_frame(path, &frame())),
    ("a.npy", |path| write_lobes(path, &lobes(), NpyConvention::Lobelia)),
    ("a.glb", |path| write_glb(path, &cube(), None)),
    ("a.ply", |path| write_ply(path, &cube(), &vec![[9, 8, 7]; cube().positions.len()])),
    ("a.txt", |path| write_bytes(path, &[7; 20_000])),
];

/// What a reader finds, in a form that can be compared.
fn shown(value: impl std::fmt::Debug) -> Result<String> {
    Ok(format!("{value:?}"))
}

fn write_tiff(path: &Path) {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut bytes).unwrap();
    encoder.write_image::<tiff::encoder::colortype::RGB8>(19, 13, picture().as_raw()).unwrap();
    std::fs::write(path, bytes.into_inner()).unwrap();
}

fn write_webp(path: &Path) {
    let mut bytes = Vec::new();
    let encoder = image_webp::WebPEncoder::new(&mut bytes);
    encoder.encode(picture().as_raw(), 19, 13, image_webp::ColorType::Rgb8).unwrap();
    std::fs::write(path, bytes).unwrap();
}

fn save(path: &Path, format: image::ImageFormat) {
    picture().save_with_format(path, format).unwrap();
}

const READERS: [Reader; 14] = [
    ("a.png", |path| write_rgb8(path, &picture()).unwrap(), read_any),
    ("a.jpg", |path| save(path, image::ImageFormat::Jpeg), read_any),
    ("a.tif", write_tiff, read_any),
    ("a.webp", write_webp, read_any),
    ("b.exr", |path| write_frame(path, &frame()).unwrap(), read_any),
    (
        "b.hdr",
        |path| std::fs::write(path, hdr_bytes(8, 4, &[Vec3::new(0.5, 0.25, 1.0); 32])).unwrap(),
        read_any,
    ),
    ("h.png", |path| write_rgb8(path, &picture()).unwrap(), |path| shown(image_header(path)?)),
    ("m.png", |path| mask().save(path).unwrap(), |path| shown(read_mask(path, Orientation::AsStored)?.mask)),
    ("f.exr", |path| write_frame(path, &frame()).unwrap(), |path| shown(read_frame(path)?)),
    ("l.exr", |path| write_frame(path, &frame()).unwrap(), |path| shown(read_exr_layers(path)?.channels)),
    (
        "m.hdr",
        |path| std::fs::write(path, hdr_bytes(8, 4, &[Vec3::ONE; 32])).unwrap(),
        |path| shown(EnvironmentMap::read(path)?),
    ),
    (
        "a.npy",
        |path| write_lobes(path, &lobes(), NpyConvention::Lobelia).unwrap(),
        |path| shown(read_lobes(path, NpyConvention::Lobelia)?),
    ),
    ("a.glb", |path| write_glb(path, &cube(), None).unwrap(), |path| shown(read_mesh(path)?)),
    (
        "a.npz",
        |path| write_npz(path, zip::CompressionMethod::Deflated, &[("k", npy_matrix(2, 2, &[1.0; 4]))]),
        |path| Npz::open(path, |_| String::new())?.matrix("k").and_then(shown),
    ),
];

fn mask() -> GrayImage {
    GrayImage::from_fn(11, 9, |x, _| Luma([if x > 4 { 255 } else { 0 }]))
}

fn read_any(path: &Path) -> Result<String> {
    shown(read_image(path, Gamma::Srgb, Orientation::AsStored)?.image)
}

fn names_in(folder: &Path) -> usize {
    std::fs::read_dir(folder).unwrap().count()
}

#[test]
fn few_bytes_at_a_time_and_interruptions_write_the_same_bytes() {
    for (name, write) in WRITERS {
        let (plain, odd) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        write(&plain.path().join(name)).unwrap();
        let bytes = std::fs::read(plain.path().join(name)).unwrap();
        for fault in [FileFault::Short(1), FileFault::Short(3), FileFault::Interrupted] {
            let _faulty = Faulty::new(odd.path(), Call::Write, fault);
            write(&odd.path().join(name)).unwrap_or_else(|error| panic!("{name}, {fault:?}: {error}"));
            assert!(std::fs::read(odd.path().join(name)).unwrap() == bytes, "{name}, {fault:?}");
        }
    }
}

#[test]
fn a_disk_that_fails_leaves_the_old_file_and_nothing_else() {
    for (name, write) in WRITERS {
        for (call, after) in [(Call::Write, 0), (Call::Write, 1), (Call::Sync, 0)] {
            for errno in ERRORS {
                let folder = tempfile::tempdir().unwrap();
                let path = folder.path().join(name);
                std::fs::write(&path, b"old").unwrap();
                let faulty = Faulty::new(folder.path(), call, FileFault::Errno { errno, after });
                let written = write(&path);
                drop(faulty);
                let Err(error) = written else {
                    // A small file is written at once.
                    assert!(call == Call::Write && after > 0, "{name}: {call:?} {errno} was not met");
                    continue;
                };
                let said = error.to_string();
                assert!(said.contains(name) && error.exit_code() == 1, "{said}");
                assert!(matches!(error, Error::Io { .. } | Error::Run { .. }), "{error:?}");
                assert_eq!(std::fs::read(&path).unwrap(), b"old", "{name}");
                assert_eq!(names_in(folder.path()), 1, "{name}: an unfinished file is left");
            }
        }
    }
}

#[test]
fn few_bytes_at_a_time_and_interruptions_read_the_same_values() {
    for (name, write, read) in READERS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        write(&path);
        let whole = read(&path).unwrap();
        for fault in [FileFault::Short(1), FileFault::Short(5), FileFault::Interrupted] {
            let _faulty = Faulty::new(folder.path(), Call::Read, fault);
            let found = read(&path).unwrap_or_else(|error| panic!("{name}, {fault:?}: {error}"));
            assert!(found == whole, "{name}, {fault:?}");
        }
    }
}

#[test]
fn a_disk_that_fails_while_it_is_read_is_one_error_that_names_the_file() {
    for (name, write, read) in READERS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        write(&path);
        for after in [0, 1] {
            let _faulty = Faulty::new(folder.path(), Call::Read, FileFault::Errno { errno: 5, after });
            match read(&path) {
                Err(error) => assert!(error.to_string().contains(name), "{error}"),
                // A small file is read at once.
                Ok(_) => assert!(after > 0, "{name}"),
            }
        }
    }
}

#[test]
fn texts_and_parts_are_whole_in_spite_of_interruptions() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ron");
    let text = "grün ".repeat(300);
    std::fs::write(&path, &text).unwrap();
    for fault in [FileFault::Short(1), FileFault::Interrupted] {
        let _faulty = Faulty::new(folder.path(), Call::Read, fault);
        assert_eq!(read_text(&path, 1 << 20, |_| String::new()).unwrap(), text);
        let mut parts = Vec::new();
        read_parts(&path, |part| parts.extend_from_slice(part)).unwrap();
        assert_eq!(parts, text.as_bytes());
    }
    write_gray8(folder.path().join("b.png"), &mask()).unwrap();
}
