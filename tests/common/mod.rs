//! What the whole-program tests share: a small known object, a data set photographed of it, and running the command.

use glam::{Mat4, Vec3};
use lobelia::codec::exr::{ExrLayers, read_exr_layers};
use lobelia::codec::exr_frame::{Frame, write_channels, write_frame};
use lobelia::codec::gltf::export::write_glb;
use lobelia::codec::npy::{NpyConvention, write_lobes};
use lobelia::light::LightLobe;
use lobelia::material::SpecularLobe;
use lobelia::mesh::Surface;
use lobelia::mesh::primitive::sphere_mesh;
use lobelia::pipeline::Pipeline;
use lobelia::prelude::{Image, Mask, Photograph, Split, StoredMask, ViewRecord};
use lobelia::shade::frame::{FramePlugin, render_frame, resolve};
use lobelia::spawn::spawn_object;
use lobelia::view::Camera;
use serde_json::{Map, Value, json};
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Width and height of all images.
pub const SIZE: u32 = 24;
/// Radius of the object.
pub const RADIUS: f32 = 0.8;
/// Distance of the cameras from its center.
pub const DISTANCE: f32 = 2.8;

/// The light that the photographs are taken under.
pub fn day() -> Vec<LightLobe> {
    let lobe = |axis: [f32; 3], sharpness, amplitude: [f32; 3]| LightLobe {
        axis: Vec3::from(axis).normalize(),
        sharpness,
        amplitude: amplitude.into(),
    };
    vec![
        lobe([0.0, 1.0, 0.0], 0.7, [0.35, 0.45, 0.6]),
        lobe([0.6, 0.5, 0.6], 20.0, [3.0, 2.6, 2.0]),
        lobe([-0.7, 0.2, -0.5], 8.0, [0.8, 1.0, 1.4]),
    ]
}

/// Another light, from the other side.
pub fn evening() -> Vec<LightLobe> {
    vec![
        LightLobe { axis: Vec3::NEG_X, sharpness: 10.0, amplitude: Vec3::new(3.0, 1.5, 0.6) },
        LightLobe { axis: Vec3::Y, sharpness: 1.0, amplitude: Vec3::new(0.1, 0.15, 0.4) },
    ]
}

/// The known object, a glossy sphere of two colors, under `lobes`, ready to be rendered.
pub fn studio(lobes: &[LightLobe]) -> Pipeline {
    painted_studio(
        lobes,
        32,
        |at| {
            if at.y > 0.0 { Vec3::new(0.6, 0.3, 0.2) } else { Vec3::new(0.2, 0.35, 0.5) }
        },
    )
}

/// The same with another albedo, in a texture of `texture_size`² texels.
pub fn painted_studio(lobes: &[LightLobe], texture_size: u32, color: impl Fn(&Vec3) -> Vec3) -> Pipeline {
    let mesh = sphere_mesh(Vec3::ZERO, RADIUS).unwrap();
    let surface = Arc::new(Surface::new(mesh, texture_size).unwrap());
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin);
    let albedo: Vec<Vec3> = surface.atlas().position.iter().map(color).collect();
    let material = SpecularLobe::new(Vec3::splat(0.25), 0.35);
    spawn_object(&mut pipeline.world, &surface, &albedo, &[material], lobes);
    pipeline
}

/// A camera in direction `from` of the object.
pub fn camera(from: [f32; 3], size: u32) -> Camera {
    let eye = Vec3::from(from).normalize() * DISTANCE;
    Camera::look_at(eye, Vec3::ZERO, Vec3::Y, 38.0, size, size).unwrap()
}

/// What the studio's systems see through `camera`.
pub fn shoot(pipeline: &mut Pipeline, camera: Camera) -> Frame {
    resolve(&render_frame(pipeline, camera, 4).unwrap())
}

/// Training photographs of what `truth` shows, by `count` cameras around it; `change` gets the number of each and its frame.
pub fn photographs_of(
    truth: &mut Pipeline,
    count: usize,
    size: u32,
    change: impl Fn(usize, &mut Frame),
) -> Vec<ViewRecord> {
    let photograph = |(number, camera): (usize, Camera)| {
        let mut frame = shoot(truth, camera);
        change(number, &mut frame);
        let (width, height) = (camera.width, camera.height);
        let photograph = Photograph::of_image(&Image { width, height, pixels: frame.color });
        let mask = Some(StoredMask::new(&Mask { width, height, coverage: frame.alpha }));
        let bare = ViewRecord::of_camera("v".into(), Split::Train, camera);
        ViewRecord { photograph: Some(photograph), mask, ..bare }
    };
    Camera::around(count, DISTANCE, 38.0, size).unwrap().into_iter().enumerate().map(photograph).collect()
}

/// Where the training cameras are.
pub const TRAIN: [[f32; 3]; 6] = [
    [0.1, 0.4, 1.0],
    [1.0, 0.3, 0.2],
    [-0.9, 0.2, 0.5],
    [0.2, -0.4, -1.0],
    [0.3, 1.0, 0.3],
    [-0.2, -1.0, 0.4],
];
/// Where the test cameras are.
pub const TEST: [[f32; 3]; 2] = [[0.7, 0.5, 0.8], [-0.5, 0.3, -0.9]];

/// A PhySG data set in a folder of its own, which goes when this is dropped.
pub struct Data {
    folder: TempDir,
}

impl Data {
    /// Photographs the studio; also the truth of the test views and two lights.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let data = Self { folder };
        write_glb(&data.path("mesh.glb"), &sphere_mesh(Vec3::ZERO, RADIUS).unwrap(), None).unwrap();
        write_lobes(data.path("evening.npy"), &evening(), NpyConvention::Lobelia).unwrap();
        let mut studio = studio(&day());
        data.photograph(&mut studio, SIZE);
        let mut relit = self::studio(&evening());
        for (i, from) in TEST.into_iter().enumerate() {
            let frame = shoot(&mut relit, camera(from, SIZE));
            let gt = data.path("test/gt");
            write_frame(gt.join(format!("relit/rgb_{i:06}.exr")), &frame).unwrap();
            write_image(&gt.join(format!("albedo_{i:06}.exr")), &frame.albedo, frame.width);
            write_image(&gt.join(format!("normal_{i:06}.exr")), &frame.normal, frame.width);
        }
        data
    }

    /// Takes the photographs of both splits again, of what this pipeline shows, `size` pixels wide and high.
    pub fn photograph(&self, studio: &mut Pipeline, size: u32) {
        write_split(&self.path("train"), studio, &TRAIN, size);
        write_split(&self.path("test"), studio, &TEST, size);
    }

    pub fn root(&self) -> &Path {
        self.folder.path()
    }

    pub fn path(&self, relative: &str) -> PathBuf {
        self.root().join(relative)
    }

    /// Changes one camera of a split.
    pub fn change_camera(&self, split: &str, name: &str, change: impl FnOnce(&mut Value)) {
        let path = self.path(split).join("cam_dict_norm.json");
        let mut cameras: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        change(cameras.get_mut(name).unwrap());
        std::fs::write(path, cameras.to_string()).unwrap();
    }

    /// Changes the channels of an EXR.
    pub fn change_image(&self, relative: &str, change: impl FnOnce(&mut ExrLayers)) {
        let mut channels = read_exr_layers(self.path(relative)).unwrap();
        change(&mut channels);
        write_unchecked(&self.path(relative), &channels);
    }

    /// Writes `text` as `scene.ron` and runs it into `out`.
    pub fn run(&self, scene: &str, out: &str, arguments: &[&str]) -> Outcome {
        let path = self.path("scene.ron");
        std::fs::write(&path, scene).unwrap();
        let mut command = command(&[]);
        command.arg("run").arg(path).arg("--data").arg(self.root()).arg("--out").arg(self.path(out));
        Outcome::of(command.args(arguments))
    }
}

fn write_split(folder: &Path, studio: &mut Pipeline, views: &[[f32; 3]], size: u32) {
    let mut cameras = Map::new();
    for (i, from) in views.iter().enumerate() {
        let camera = camera(*from, size);
        let frame = shoot(studio, camera);
        let name = format!("rgb_{i:06}");
        write_image(&folder.join(format!("image/{name}.exr")), &frame.color, frame.width);
        write_mask(&folder.join(format!("mask/{name}.png")), &frame);
        cameras.insert(format!("{name}.exr"), camera_entry(&camera));
    }
    std::fs::write(folder.join("cam_dict_norm.json"), Value::from(cameras).to_string()).unwrap();
}

/// Writes what a frame covers as a mask; folders are made.
pub fn write_mask(path: &Path, frame: &Frame) {
    let mask = image::GrayImage::from_fn(frame.width as u32, frame.height as u32, |x, y| {
        image::Luma([(frame.alpha[y as usize * frame.width + x as usize] * 255.0).round() as u8])
    });
    save_png(path, &image::DynamicImage::ImageLuma8(mask));
}

fn camera_entry(camera: &Camera) -> Value {
    let ([fx, fy], [cx, cy]) = (camera.focal, camera.center);
    let k = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let w2c = Mat4::from(camera.world_from_camera.inverse()).transpose().to_cols_array();
    json!({ "K": k, "W2C": w2c, "img_size": [camera.width, camera.height] })
}

/// Writes an EXR with R, G, B; folders are made.
pub fn write_image(path: &Path, pixels: &[Vec3], width: usize) {
    let height = (pixels.len() / width) as u32;
    let mut layers = ExrLayers { width: width as u32, height, ..ExrLayers::default() };
    layers.insert_triple(["R", "G", "B"], pixels);
    write_channels(path, &layers).unwrap();
}

/// Writes an EXR as another program might: with NaN, too.
pub fn write_unchecked(path: &Path, layers: &ExrLayers) {
    use exr::prelude::{
        AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage,
    };
    let channel = |(name, values): (&String, &Vec<f32>)| {
        AnyChannel::new(name.as_str(), FlatSamples::F32(values.clone()))
    };
    let channels = AnyChannels::sort(layers.channels.iter().map(channel).collect());
    let size = (layers.width as usize, layers.height as usize);
    let layer = Layer::new(size, LayerAttributes::default(), Encoding::FAST_LOSSLESS, channels);
    Image::from_layer(layer).write().to_file(path).unwrap();
}

/// Writes a PNG; folders are made.
pub fn save_png(path: &Path, image: &image::DynamicImage) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.save_with_format(path, image::ImageFormat::Png).unwrap();
}

/// The program, to be started.
pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lobelia"));
    command.args(arguments);
    command
}

/// How a run ended and what it said.
pub struct Outcome {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Outcome {
    pub fn of(command: &mut Command) -> Self {
        let Output { status, stdout, stderr } = command.output().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        Self { code: status.code(), stdout: text(stdout), stderr: text(stderr) }
    }

    #[track_caller]
    pub fn succeeded(self) -> Self {
        assert_eq!(self.code, Some(0), "{}", self.stderr);
        self
    }
}

/// All files below a folder by relative path, sorted; empty if there is no such folder.
pub fn files_below(folder: &Path) -> Vec<String> {
    fn visit(folder: &Path, root: &Path, files: &mut Vec<String>) {
        for entry in std::fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                visit(&path, root, files);
            } else {
                files.push(path.strip_prefix(root).unwrap().to_str().unwrap().replace('\\', "/"));
            }
        }
    }
    let mut files = Vec::new();
    visit(folder, folder, &mut files);
    files.sort();
    files
}

/// Whether a file name is that of an unfinished file.
pub fn is_temporary(file: &str) -> bool {
    let name = file.rsplit('/').next().unwrap_or(file);
    name.starts_with('.') || name.contains(".part") || name.ends_with(".tmp")
}

/// The manifest of a run.
pub fn manifest(out: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(out.join("run.json")).unwrap()).unwrap()
}

/// The states of the passes in a manifest.
pub fn states(manifest: &Value) -> Vec<String> {
    let passes = manifest["passes"].as_array().unwrap();
    passes.iter().map(|pass| pass["state"].as_str().unwrap().to_owned()).collect()
}

/// A run that is at work, and is ended with the test.
pub struct AtWork(Child);

impl AtWork {
    /// Starts a run of `scene.ron`.
    pub fn begin(data: &Data, arguments: &[&str]) -> Self {
        Self::begin_by(data, &[], arguments)
    }

    /// The same through another program, which becomes the run.
    pub fn begin_by(data: &Data, by: &[&str], arguments: &[&str]) -> Self {
        let words = [by, &[env!("CARGO_BIN_EXE_lobelia"), "run", "--quiet"]].concat();
        let mut run = Command::new(words[0]);
        run.args(&words[1..]);
        run.arg(data.path("scene.ron")).arg("--data").arg(data.root()).arg("--out").arg(data.path("out"));
        Self(run.args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
    }

    /// Starts a run with a page, and returns the port at which it says it is.
    pub fn begin_live(data: &Data, scene: &str, arguments: &[&str]) -> (Self, u16) {
        std::fs::write(data.path("scene.ron"), scene).unwrap();
        let mut run = command(&["run", "--quiet"]);
        run.arg(data.path("scene.ron")).arg("--data").arg(data.root()).arg("--out").arg(data.path("out"));
        run.args(arguments).arg("--live");
        let mut at_work = Self(run.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap());
        let mut line = String::new();
        BufReader::new(at_work.0.stderr.take().unwrap()).read_line(&mut line).unwrap();
        let port =
            line.trim().strip_prefix("live: http://127.0.0.1:").and_then(|rest| rest.strip_suffix('/'));
        (at_work, port.unwrap_or_else(|| panic!("{line}")).parse().unwrap())
    }

    /// Starts a run and waits until a pass is at work.
    pub fn start(data: &Data, scene: &str, arguments: &[&str], pass: &str) -> Self {
        std::fs::write(data.path("scene.ron"), scene).unwrap();
        let (mut at_work, started) = (Self::begin(data, arguments), Instant::now());
        let is_running = || -> Option<bool> {
            let text = std::fs::read(data.path("out/run.json")).ok()?;
            let manifest: Value = serde_json::from_slice(&text).ok()?;
            let passes = manifest["passes"].as_array()?.clone();
            Some(passes.iter().any(|found| found["name"] == pass && found["state"] == "running"))
        };
        while is_running() != Some(true) {
            assert!(at_work.0.try_wait().unwrap().is_none(), "the run ended");
            assert!(started.elapsed() < Duration::from_secs(300), "{pass} does not begin");
            std::thread::sleep(Duration::from_millis(10));
        }
        at_work
    }

    /// Waits until the run, which has `--checkpoint 0s`, has kept a step of a pass.
    pub fn until_a_step_is_kept(&self, data: &Data) {
        // Not of the beginning of a pass or level, and not half-written.
        let is_step = |file: &String| {
            file.ends_with(".state") && !file.ends_with("-0.state") && !file.contains(".part.")
        };
        let start = Instant::now();
        while !files_below(&data.path("out/.checkpoint")).iter().any(is_step) {
            assert!(start.elapsed() < Duration::from_secs(300), "process {} keeps no step", self.0.id());
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Waits for the end of the run, and returns its exit code.
    pub fn ended(mut self) -> Option<i32> {
        let started = Instant::now();
        loop {
            if let Some(status) = self.0.try_wait().unwrap() {
                return status.code();
            }
            assert!(started.elapsed() < Duration::from_secs(300), "the run does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Sends it a signal, by name.
    #[cfg(unix)]
    pub fn signal(&self, name: &str) {
        let id = self.0.id().to_string();
        assert!(Command::new("kill").args([&format!("-{name}"), &id]).status().unwrap().success());
    }

    /// Kills it, as a power cut would.
    pub fn kill(mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for AtWork {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A scene of a data set with its mesh and an unknown light, and with these passes.
pub fn scene(passes: &str) -> String {
    format!(
        r#"Scene(
    version: 1,
    surface: Mesh(path: "$DATA/mesh.glb", texture_size: 16),
    views: Dataset(path: "$DATA"),
    light: Unknown(lobes: 6),
    passes: [{passes}],
)
"#
    )
}
