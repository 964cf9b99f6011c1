//! Films: what changes over their frames, and what they are written as.

use crate::common::{Data, Outcome, command, files_below};
use image::RgbImage;
use std::path::Path;

/// A gray sphere under a lamp at the side; `{ORBIT}` is filled in.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(texture_size: 16),
    views: Cameras([(name: "a", eye: (0, 0, 3), width: 16, height: 16)]),
    light: Fixed(Lobes(lobes: [(axis: (1, 0.2, 0.5), sharpness: 4, amplitude: (1, 1, 1))])),
    material: (albedo: Fixed(Constant(0.5, 0.5, 0.5)), specular: (albedo: Fixed(0.1, 0.1, 0.1), roughness: Fixed(0.3))),
    passes: [Render(name: "film", render: (views: Named([]), orbit: (frames: 4, size: 48, format: Frames, {ORBIT})))],
)"#;

/// Runs the scene, where no other program can be found.
fn run(data: &Data, orbit: &str, out: &str) -> Outcome {
    let scene = data.path("scene.ron");
    std::fs::write(&scene, SCENE.replace("{ORBIT}", orbit)).unwrap();
    let mut program = command(&["run", "--quiet"]);
    Outcome::of(program.arg(&scene).arg("--out").arg(data.path(out)).env("PATH", ""))
}

fn frames(folder: &Path) -> Vec<RgbImage> {
    let frame = |i| image::open(folder.join(format!("orbit_frames/{i:06}.png"))).unwrap().into_rgb8();
    (0..4).map(frame).collect()
}

/// Mean difference of two frames, in steps of 8 bits.
fn difference(a: &RgbImage, b: &RgbImage) -> f64 {
    let sum: u64 = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.as_raw().len() as f64
}

#[test]
fn the_light_may_go_with_the_camera_and_the_frames_stay() {
    let data = Data::new();
    run(&data, "", "still").succeeded();
    let files = files_below(&data.path("still/film"));
    let expected = ["orbit.mp4", "orbit_frames/000000.png", "orbit_frames/000003.png"];
    assert!(
        files.len() == 5 && expected.iter().all(|name| files.iter().any(|file| file == name)),
        "{files:?}"
    );
    let still = frames(&data.path("still/film"));
    assert!(difference(&still[0], &still[2]) > 20.0, "the lamp is on the other side after half a turn");
    run(&data, "light: ()", "turned").succeeded();
    let turned = frames(&data.path("turned/film"));
    assert!(difference(&turned[0], &still[0]) < 0.1);
    for frame in &turned[1..] {
        let found = difference(&turned[0], frame);
        assert!(found < 1.0, "a sphere looks alike from all sides if the light comes along: {found}");
    }
}

/// Root mean square difference of two frames, in steps of 8 bits.
fn deviation(a: &RgbImage, b: &RgbImage) -> f64 {
    let square = |(a, b): (&u8, &u8)| f64::from(a.abs_diff(*b)).powi(2);
    (a.as_raw().iter().zip(b.as_raw()).map(square).sum::<f64>() / a.as_raw().len() as f64).sqrt()
}

#[test]
fn denoised_films_are_closer_to_converged_ones_and_say_what_they_are() {
    let data = Data::new();
    let filmed = |shading: &str, out: &str| {
        let scene = data.path("scene.ron");
        let text = SCENE.replace("{ORBIT}", "").replace("Named([])", "All");
        std::fs::write(&scene, text.replace("orbit:", &format!("shading: PathTraced({shading}), orbit:")))
            .unwrap();
        Outcome::of(command(&["run", "--quiet"]).arg(&scene).arg("--out").arg(data.path(out))).succeeded();
        frames(&data.path(&format!("{out}/film")))
    };
    let converged = filmed("spp: 1024", "converged");
    let noisy = filmed("spp: 8", "noisy");
    let denoised = filmed("spp: 8, denoise: true", "denoised");
    for ((converged, noisy), denoised) in converged.iter().zip(&noisy).zip(&denoised) {
        let (before, after) = (deviation(noisy, converged), deviation(denoised, converged));
        assert!(after < 0.7 * before, "{before} became {after}");
    }
    let says = |file: &str, word: &[u8]| {
        std::fs::read(data.path(file)).unwrap().windows(word.len()).any(|bytes| bytes == word)
    };
    assert!(says("denoised/film/a.exr", b"Denoised: ") && !says("noisy/film/a.exr", b"Denoised: "));
    assert!(says("denoised/run.json", b"4 film frames, denoised") && !says("noisy/run.json", b", denoised"));
    assert_eq!(filmed("spp: 8, denoise: true", "again"), denoised, "the same bits");
}

#[test]
fn keys_move_the_camera_and_the_material_changes() {
    let data = Data::new();
    let still = "keys: [(at: 0, angle_degrees: 30)]";
    run(&data, still, "still").succeeded();
    let frames_of = |out: &str| frames(&data.path(out).join("film"));
    let kept = frames_of("still");
    assert!(kept.iter().all(|frame| *frame == kept[0]), "one key is a camera that stands");
    run(&data, &format!("{still}, material: (albedo: (1, 0.2), specular: (1, 0))"), "darker").succeeded();
    let darker = frames_of("darker");
    let mean = |frame: &RgbImage| frame.as_raw().iter().map(|x| f64::from(*x)).sum::<f64>();
    assert_eq!(darker[0], kept[0]);
    assert!(darker.windows(2).all(|pair| mean(&pair[1]) < mean(&pair[0])));
    let away = "keys: [(at: 0, angle_degrees: 30, radius: 4), (at: 1, radius: 8)]";
    run(&data, away, "away").succeeded();
    let covered = |frame: &RgbImage| frame.pixels().filter(|pixel| pixel[0] > 60).count();
    let covers: Vec<usize> = frames_of("away").iter().map(covered).collect();
    assert!(covers.windows(2).all(|pair| pair[1] < pair[0]), "{covers:?}");
}

/// The object fits into wide and high pictures alike.
#[test]
fn pictures_may_be_wide_or_high() {
    let data = Data::new();
    let first = |orbit: &str, out: &str| {
        run(&data, orbit, out).succeeded();
        frames(&data.path(out).join("film")).swap_remove(0)
    };
    let (wide, high) = (first("width: 80", "wide"), first("width: 24, height: 60", "high"));
    assert_eq!((wide.dimensions(), high.dimensions()), ((80, 48), (24, 60)));
    let covered = |frame: &RgbImage, x: u32, y: u32| frame.get_pixel(x, y)[0] > 60;
    for frame in [&wide, &high] {
        let [width, height] = [frame.width(), frame.height()];
        assert!(covered(frame, width / 2, height / 2));
        let edge = (0..width).flat_map(|x| [(x, 0), (x, height - 1)]);
        let edge = edge.chain((0..height).flat_map(|y| [(0, y), (width - 1, y)]));
        assert!(edge.into_iter().all(|(x, y)| !covered(frame, x, y)), "the object leaves the picture");
    }
    // The sphere takes nine tenths of the shorter side, and its lit half can be told.
    assert!((0..24).filter(|x| covered(&high, *x, 30)).count() >= 10);
}

#[test]
fn a_video_has_the_frames_of_its_format() {
    let data = Data::new();
    run(&data, "", "frames").succeeded();
    let only = |text: &str| SCENE.replace("format: Frames, {ORBIT}", text);
    let scene = data.path("other.ron");
    let written = |format: &str, out: &str| {
        std::fs::write(&scene, only(format)).unwrap();
        let mut program = command(&["run", "--quiet"]);
        Outcome::of(program.arg(&scene).arg("--out").arg(data.path(out)).env("PATH", "")).succeeded();
        files_below(&data.path(out).join("film"))
    };
    assert_eq!(written("format: Mp4", "video"), ["orbit.mp4"]);
    assert_eq!(written("format: Apng", "apng"), ["orbit.mp4", "orbit.png"]);
    let video = |out: &str| std::fs::read(data.path(out).join("film/orbit.mp4")).unwrap();
    assert!(video("video") == video("frames") && video("video") == video("apng"));
    let has = |name: &[u8]| video("video").windows(4).any(|bytes| bytes == name);
    assert!(has(b"avc1") && has(b"moov") && has(b"mdat"));
}

#[test]
fn keys_that_make_no_sense_are_shown() {
    let data = Data::new();
    for (orbit, word) in [
        ("keys: [(at: 0.5, radius: 3), (at: 0.2, radius: 4)]", "0.5 to 1"),
        ("keys: [(at: 0.5)]", "gives no value"),
        ("light: (axis: (0, 0, 0))", "direction"),
        ("material: (albedo: (1, -1))", "not below 0"),
    ] {
        let outcome = run(&data, orbit, "out");
        assert!(outcome.code == Some(2) && outcome.stderr.contains(word), "{word}: {}", outcome.stderr);
    }
}
