//! Films: what changes over their frames, and what they are written as; pictures in bands, which
//! have the bits of whole ones.

use crate::common::{Data, GRAY_SPHERE, Outcome, camera, command, day, files_below, is_temporary, studio};
use image::RgbImage;
use lobelia::shade::frame::{band_rows, frame_bytes, render_bands};
use lobelia::{ecs::*, prelude::*};

/// The film; `{}` is filled in.
const FILM: &str = r#"Render(name: "film", render: (views: Named([]), orbit: (frames: 4, size: 48, {})))"#;

fn scene(orbit: &str) -> String {
    GRAY_SPHERE.replace("{PASS}", FILM).replace("{}", orbit)
}

/// Runs the scene, where no other program can be found.
fn run(data: &Data, orbit: &str) -> Outcome {
    data.write("scene.ron", scene(orbit));
    let mut program = command(&["run", "scene.ron", "--out", "out", "--quiet", "--force"]);
    Outcome::of(program.current_dir(data.root()).env("PATH", ""))
}

fn frames(data: &Data) -> Vec<RgbImage> {
    let frame = |i| image::open(data.path(format!("out/film/orbit_frames/{i:06}.png"))).unwrap().into_rgb8();
    (0..4).map(frame).collect()
}

/// The frames of a film that is made with these words.
fn film(data: &Data, orbit: &str) -> Vec<RgbImage> {
    run(data, orbit).succeeded();
    frames(data)
}

/// Mean difference of two frames, in steps of 8 bits.
fn difference(a: &RgbImage, b: &RgbImage) -> f64 {
    let sum: u64 = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.as_raw().len() as f64
}

#[test]
fn the_light_may_go_with_the_camera_and_the_frames_stay() {
    let data = Data::new();
    let still = film(&data, "");
    let files = files_below(&data.path("out/film"));
    let expected = ["orbit.gif", "orbit_frames/000000.png", "orbit_frames/000003.png"];
    assert!(files.len() == 5 && expected.iter().all(|name| files.contains(&(*name).into())), "{files:?}");
    // Without ffmpeg a film is a GIF.
    assert!(data.text("out/run.json").contains("with `ffmpeg` on the PATH"));
    assert!(difference(&still[0], &still[2]) > 20.0, "the lamp is on the other side after half a turn");
    let turned = film(&data, "light: ()");
    assert!(difference(&turned[0], &still[0]) < 0.1);
    for frame in &turned[1..] {
        let found = difference(&turned[0], frame);
        assert!(found < 1.0, "a sphere looks alike from all sides if the light comes along: {found}");
    }
}

#[test]
fn keys_move_the_camera_and_the_material_changes() {
    let data = Data::new();
    let still = "keys: [(at: 0, angle_degrees: 30)]";
    let kept = film(&data, still);
    assert!(kept.iter().all(|frame| *frame == kept[0]), "one key is a camera that stands");
    let darker = film(&data, &format!("{still}, material: (albedo: (1, 0.2), specular: (1, 0))"));
    let mean = |frame: &RgbImage| frame.as_raw().iter().map(|x| f64::from(*x)).sum::<f64>();
    assert_eq!(darker[0], kept[0]);
    assert!(darker.windows(2).all(|pair| mean(&pair[1]) < mean(&pair[0])));
    let away = film(&data, "keys: [(at: 0, angle_degrees: 30, radius: 4), (at: 1, radius: 8)]");
    let covered = |frame: &RgbImage| frame.pixels().filter(|pixel| pixel[0] > 60).count();
    let covers: Vec<usize> = away.iter().map(covered).collect();
    assert!(covers.windows(2).all(|pair| pair[1] < pair[0]), "{covers:?}");
}

/// The object fits into wide and high pictures alike.
#[test]
fn pictures_may_be_wide_or_high() {
    let data = Data::new();
    let [wide, high] = ["width: 80", "width: 24, height: 60"].map(|size| film(&data, size).swap_remove(0));
    assert_eq!((wide.dimensions(), high.dimensions()), ((80, 48), (24, 60)));
    let covered = |frame: &RgbImage, x: u32, y: u32| frame.get_pixel(x, y)[0] > 60;
    for frame in [&wide, &high] {
        let (width, height) = frame.dimensions();
        assert!(covered(frame, width / 2, height / 2));
        let is_edge = |x, y| x == 0 || y == 0 || x == width - 1 || y == height - 1;
        let mut edge = frame.enumerate_pixels().filter(|(x, y, _)| is_edge(*x, *y));
        assert!(edge.all(|(x, y, _)| !covered(frame, x, y)), "the object leaves the picture");
    }
    // The sphere takes nine tenths of the shorter side, and its lit half can be told.
    assert!((0..24).filter(|x| covered(&high, *x, 30)).count() >= 10);
}

/// A film begins in front, where this view's camera is.
#[test]
fn frames_are_pictures_of_views_and_no_other_file_is_left() {
    let data = Data::new();
    let scene = scene("radius: 3, elevation_degrees: 0")
        .replace("Named([])", "All, backdrop: true")
        .replace("width: 16, height: 16", "fov_degrees: 38, width: 48, height: 48");
    data.run(&scene, "out", &["--quiet"]).succeeded();
    let still = image::open(data.path("out/film/a.png")).unwrap().into_rgb8();
    let found = difference(&frames(&data)[0], &still);
    assert!(found < 0.5, "{found}");
    assert!(!files_below(&data.path("out")).iter().any(|file| is_temporary(file)));
}

#[test]
fn words_that_make_no_sense_are_shown_and_others_say_what_to_do_instead() {
    let data = Data::new();
    for (orbit, word) in [
        ("format: Mp4", "PNG files in orbit_frames/"),
        ("), shading: PathTraced(spp: 8, denoise: true", "OIDN"),
        ("keys: [(at: 0.5, radius: 3), (at: 0.2, radius: 4)]", "0.5 to 1"),
        ("keys: [(at: 0.5)]", "gives no value"),
        ("light: (axis: (0, 0, 0))", "direction"),
        ("material: (albedo: (1, -1))", "not below 0"),
    ] {
        run(&data, orbit).refused(&[word]);
    }
}

// Bands.

fn view(width: u32, height: u32) -> Camera {
    let eye = camera([0.5, 0.3, 0.8], 1).position();
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

/// A tile has 2¹⁶ samples; in the large picture tiles end within rows, and within the samples of a
/// pixel.
#[test]
fn bands_have_the_bits_of_the_whole_picture() {
    let (small, large) = (view(19, 23), view(97, 90));
    let all: &[u32] = &[1, 3, 7, 23, 100];
    for path_traced in [false, true] {
        for (camera, samples, heights) in
            [(small, 1, all), (small, 4, all), (small, 9, all), (large, 9, &[7])]
        {
            let mut pipeline = studio(&day());
            if path_traced {
                let paths =
                    PathTracing { paths_per_sample: 1, max_bounces: 2, seed: 5, samples_per_pixel: samples };
                pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced(paths));
            }
            let whole = resolve(&render_frame(&mut pipeline, camera, samples).unwrap());
            assert!(whole.alpha.contains(&1.0) && whole.specular.iter().any(|color| color.x > 0.0));
            for &rows in heights {
                let bands = in_bands(&mut pipeline, camera, samples, rows);
                assert!(bands == whole, "traced {path_traced}, {samples} samples, {rows} rows");
            }
        }
    }
}

#[test]
fn memory_of_a_picture_does_not_grow_with_its_height() {
    assert_eq!([[16_384, 16_384], [800, 800], [5, 7]].map(band_rows), [32, 640, 7]);
    let bytes = |width, height| frame_bytes([width, height]);
    assert_eq!(bytes(16_384, 16_384), bytes(16_384, 100));
    assert!(bytes(16_384, 16_384) < 1 << 29, "{}", bytes(16_384, 16_384));
    assert!(bytes(64, 64) < bytes(800, 800));
}
