//! Pictures in bands have the bits of whole ones, in memory and in files; films have all their frames.

use crate::common::{DISTANCE, Data, day, files_below, is_temporary, studio};
use glam::Vec3;
use image::AnimationDecoder;
use image::codecs::gif::GifDecoder;
use image::codecs::png::PngDecoder;
use lobelia::codec::exr_frame::{Frame, write_frame, write_frame_rows};
use lobelia::pipeline::{Phase, Pipeline, Slot};
use lobelia::report::tone::{Backdrop, Look, Picture, save_png, write_png_rows};
use lobelia::shade::frame::{band_rows, frame_bytes, render_bands, render_frame, resolve};
use lobelia::shade::{PathTracing, shade_path_traced};
use lobelia::view::Camera;
use lobelia::{Error, Result};
use std::io::BufReader;
use std::path::Path;

fn view(width: u32, height: u32) -> Camera {
    let eye = Vec3::new(0.5, 0.3, 0.8).normalize() * DISTANCE;
    Camera::look_at(eye, Vec3::ZERO, Vec3::Y, 38.0, width, height).unwrap()
}

/// The bands of a picture, put together.
fn in_bands(pipeline: &mut Pipeline, camera: Camera, samples: u32, rows: u32) -> Frame {
    let mut whole = Frame { width: camera.width as usize, ..Frame::default() };
    render_bands(pipeline, camera, samples, rows, &mut |_, first, band| {
        assert_eq!((band.width, first as usize), (whole.width, whole.height), "bands come from the top");
        whole.height += band.height;
        whole.color.extend(&band.color);
        whole.alpha.extend(&band.alpha);
        whole.diffuse.extend(&band.diffuse);
        whole.specular.extend(&band.specular);
        whole.albedo.extend(&band.albedo);
        whole.normal.extend(&band.normal);
        whole.depth.extend(&band.depth);
        Ok(())
    })
    .unwrap();
    whole
}

fn traced(pipeline: &mut Pipeline, samples_per_pixel: u32) {
    let paths = PathTracing { paths_per_sample: 1, max_bounces: 2, seed: 5, samples_per_pixel };
    pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced(paths));
}

#[test]
fn bands_have_the_bits_of_the_whole_picture() {
    let mut pipeline = studio(&day());
    let camera = view(19, 23);
    for path_traced in [false, true] {
        for samples in [1, 4, 9] {
            if path_traced {
                traced(&mut pipeline, samples);
            }
            let whole = resolve(&render_frame(&mut pipeline, camera, samples).unwrap());
            assert!(whole.alpha.contains(&1.0) && whole.specular.iter().any(|color| color.x > 0.0));
            for rows in [1, 3, 7, 23, 100] {
                let bands = in_bands(&mut pipeline, camera, samples, rows);
                assert!(bands == whole, "traced {path_traced}, {samples} samples, {rows} rows");
            }
        }
    }
}

/// A tile has 2¹⁶ samples; here tiles end within rows, and within the samples of a pixel.
#[test]
fn bands_have_the_bits_of_the_whole_picture_across_tiles() {
    let mut pipeline = studio(&day());
    let camera = view(97, 90);
    let whole = resolve(&render_frame(&mut pipeline, camera, 9).unwrap());
    assert!(in_bands(&mut pipeline, camera, 9, 7) == whole, "closed form");
    traced(&mut pipeline, 9);
    let whole = resolve(&render_frame(&mut pipeline, camera, 9).unwrap());
    assert!(in_bands(&mut pipeline, camera, 9, 7) == whole, "path traced");
}

#[test]
fn files_of_bands_have_the_bytes_of_files_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (mut pipeline, camera, look) = (studio(&day()), view(19, 23), Look::default());
    let whole = resolve(&render_frame(&mut pipeline, camera, 4).unwrap());
    write_frame(path("whole.exr"), &whole).unwrap();
    save_png(path("whole.png"), &whole, &look).unwrap();
    for rows in [1, 3, 7] {
        write_frame_rows(path("bands.exr"), [19, 23], |layers| {
            write_png_rows(path("bands.png"), [19, 23], true, None, |colors| {
                render_bands(&mut pipeline, camera, 4, rows, &mut |_, _, band| {
                    layers.push(band)?;
                    colors.push(&Picture::of(band).samples8(&look, Backdrop::Transparent)?)
                })
            })
        })
        .unwrap();
        for kind in ["exr", "png"] {
            let [bands, whole] =
                ["bands", "whole"].map(|name| std::fs::read(path(name).with_extension(kind)));
            assert!(bands.unwrap() == whole.unwrap(), "{kind} of {rows} rows");
        }
    }
}

#[test]
fn a_picture_that_is_stopped_amid_its_bands_leaves_no_file_and_the_next_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let mut pipeline = studio(&day());
    let mut taken = 0;
    let stopped: Result<()> = write_frame_rows(folder.path().join("view.exr"), [19, 23], |layers| {
        render_bands(&mut pipeline, view(19, 23), 1, 7, &mut |_, _, band| {
            taken += 1;
            if taken == 3 { Err(Error::Interrupted) } else { layers.push(band) }
        })
    });
    assert!(matches!(stopped, Err(Error::Interrupted)));
    assert_eq!(taken, 3);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let again = in_bands(&mut pipeline, view(19, 23), 1, 23);
    assert!(again == in_bands(&mut studio(&day()), view(19, 23), 1, 23));
}

#[test]
fn memory_of_a_picture_does_not_grow_with_its_height() {
    assert_eq!([[16_384, 16_384], [800, 800], [5, 7]].map(band_rows), [32, 640, 7]);
    let bytes = |width, height| frame_bytes([width, height]);
    assert_eq!(bytes(16_384, 16_384), bytes(16_384, 100));
    assert!(bytes(16_384, 16_384) < 1 << 29, "{}", bytes(16_384, 16_384));
    assert!(bytes(64, 64) < bytes(800, 800));
}

const ORBITS: &str = r#"Scene(
    version: 1,
    surface: Sphere(center: (0, 0, 0), radius: 0.8, texture_size: 32),
    views: Cameras([(name: "front", eye: (0, 0, 3), fov_degrees: 38, width: 40, height: 40)]),
    light: Fixed(Npy(path: "$DATA/evening.npy")),
    material: (
        albedo: Fixed(Constant(0.5, 0.4, 0.3)),
        specular: (albedo: Fixed(0.2, 0.2, 0.2), roughness: Fixed(0.4)),
    ),
    visibility: None,
    passes: [
        Render(name: "full", render: (
            views: All,
            backdrop: true,
            orbit: (frames: 5, size: 40, radius: 3, elevation_degrees: 0, fps: 10, format: Apng),
        )),
        Render(name: "few", render: (
            views: Named([]),
            backdrop: true,
            orbit: (frames: 5, size: 40, radius: 3, elevation_degrees: 0, fps: 10),
        )),
    ],
)
"#;

fn frames<'a>(decoder: impl AnimationDecoder<'a>) -> Vec<image::RgbImage> {
    let frames = decoder.into_frames().collect_frames().unwrap();
    frames.into_iter().map(|frame| image::DynamicImage::from(frame.into_buffer()).into_rgb8()).collect()
}

fn open(path: &Path) -> BufReader<std::fs::File> {
    BufReader::new(std::fs::File::open(path).unwrap())
}

/// Mean difference of two pictures, of 255.
fn difference(a: &image::RgbImage, b: &image::RgbImage) -> f32 {
    assert_eq!(a.dimensions(), b.dimensions());
    let sum: u32 = a.iter().zip(b.iter()).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
    sum as f32 / a.len() as f32
}

#[test]
fn films_have_every_frame_and_leave_no_other_file() {
    let data = Data::new();
    data.run(ORBITS, "out", &[]).succeeded();
    let files = files_below(&data.path("out"));
    assert!(!files.iter().any(|file| is_temporary(file) || file.contains(".film")), "{files:?}");
    let full = PngDecoder::new(open(&data.path("out/full/orbit.png"))).unwrap();
    let full = frames(full.apng().unwrap());
    let few = frames(GifDecoder::new(open(&data.path("out/few/orbit.gif"))).unwrap());
    assert_eq!((full.len(), few.len()), (5, 5));
    // The film begins in front, where the view's camera is.
    let still = image::open(data.path("out/full/front.png")).unwrap().into_rgb8();
    assert!(difference(&full[0], &still) < 0.5, "{}", difference(&full[0], &still));
    for (i, (full, few)) in full.iter().zip(&few).enumerate() {
        assert!(difference(full, few) < 6.0, "frame {i}: {}", difference(full, few));
    }
    assert!(difference(&full[0], &full[1]) > 1.0, "the camera moves");
}
