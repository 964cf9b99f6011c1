//! Parts shared by the whole-program tests: a small known object, a data set photographed of it,
//! and running the command.

use glam::Mat4;
use lobelia::codec::exr::{ExrLayers, read_exr_layers};
use lobelia::codec::exr_frame::{write_channels, write_frame};
use lobelia::codec::npy::{NpyConvention, write_lobes};
use lobelia::pass::{self, RunOptions};
use lobelia::progress::{Bar, Progress, Silent};
use lobelia::scene::{LoadOptions, load};
use lobelia::{codec::gltf::export::write_glb, ecs::*, prelude::*};
use serde_json::{Map, Value, json};
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use std::{fs::File, sync::LazyLock};
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
    let halves = |at: &Vec3| if at.y > 0.0 { Vec3::new(0.6, 0.3, 0.2) } else { Vec3::new(0.2, 0.35, 0.5) };
    painted_studio(lobes, 32, halves)
}

/// Returns the studio with another albedo, in a texture of `texture_size`² texels.
pub fn painted_studio(lobes: &[LightLobe], texture_size: u32, color: impl Fn(&Vec3) -> Vec3) -> Pipeline {
    let mesh = sphere_mesh(Vec3::ZERO, RADIUS).unwrap();
    object(mesh, lobes, texture_size, color, SpecularLobe::new(Vec3::splat(0.25), 0.35)).0
}

/// An object ready to be rendered, and its surface.
pub fn object(
    mesh: Mesh,
    lobes: &[LightLobe],
    texture_size: u32,
    color: impl Fn(&Vec3) -> Vec3,
    material: SpecularLobe,
) -> (Pipeline, Arc<Surface>) {
    let surface = Arc::new(Surface::new(mesh, texture_size).unwrap());
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin);
    let albedo: Vec<Vec3> = surface.atlas().position.iter().map(color).collect();
    spawn_object(&mut pipeline.world, &surface, &albedo, &[material], lobes);
    (pipeline, surface)
}

/// A component of all texels.
pub fn column<C: Component + Copy>(world: &mut World) -> Vec<C> {
    read_column::<TexelIndex, C>(world).unwrap()
}

/// Adds another mesh, without texture coordinates.
pub fn join(mesh: &mut Mesh, other: &Mesh) {
    let first = mesh.positions.len() as u32;
    mesh.triangles.extend(other.triangles.iter().map(|corners| corners.map(|v| v + first)));
    mesh.positions.extend(&other.positions);
    mesh.normals.extend(&other.normals);
}

/// A camera in direction `from` of the object.
pub fn camera(from: [f32; 3], size: u32) -> Camera {
    let eye = Vec3::from(from).normalize() * DISTANCE;
    Camera::look_at(eye, Vec3::ZERO, Vec3::Y, 38.0, size, size).unwrap()
}

/// Renders the studio through `camera`.
pub fn shoot(pipeline: &mut Pipeline, camera: Camera) -> Frame {
    resolve(&render_frame(pipeline, camera, 4).unwrap())
}

/// Training photographs of what `truth` shows, by `count` cameras around it; `change` gets the
/// number of each and its frame.
pub fn photographs_of(
    truth: &mut Pipeline,
    count: usize,
    size: u32,
    change: impl Fn(usize, &mut Frame),
) -> Vec<ViewRecord> {
    let cameras = Camera::around(count, DISTANCE, 38.0, size).unwrap();
    let photograph = |(number, camera): (usize, Camera)| {
        let mut frame = shoot(truth, camera);
        change(number, &mut frame);
        let (width, height) = (size, size);
        let photograph = Some(Photograph::of_image(&Image { width, height, pixels: frame.color }));
        let mask = Some(StoredMask::new(&Mask { width, height, coverage: frame.alpha }));
        ViewRecord { photograph, mask, ..ViewRecord::of_camera("front".into(), Split::Train, camera) }
    };
    cameras.into_iter().enumerate().map(photograph).collect()
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

/// A folder of data and results, which goes when this is dropped, or stays for the next run of the
/// tests if it is shared.
pub struct Data {
    root: PathBuf,
    _folder: Option<TempDir>,
}

/// Says on the terminal, whatever becomes of a test's own output, that something of it is skipped.
pub fn skipped(why: &str) {
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "skipped: {why}");
}

/// Tells whether a program is installed and runs, and says it if it is not.
pub fn is_installed(program: &str) -> bool {
    let runs = Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success());
    if !runs {
        skipped(&format!("{program} is not installed"));
    }
    runs
}

impl Data {
    /// An empty folder.
    pub fn bare() -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self { root: folder.path().to_owned(), _folder: Some(folder) }
    }

    /// A PhySG data set: photographs of the studio; also the truth of the test views and two
    /// lights.
    pub fn new() -> Self {
        Self::bare().with_studio()
    }

    /// The data set of [`Data::new`] in the folder of a run that several tests look at. Only one
    /// process at a time has it.
    pub fn shared(name: &str) -> Self {
        static LOCK: LazyLock<File> = LazyLock::new(|| {
            let lock = File::create(concat!(env!("CARGO_TARGET_TMPDIR"), "/shared.lock")).unwrap();
            lock.lock().unwrap();
            lock
        });
        LazyLock::force(&LOCK);
        let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = std::fs::remove_dir_all(&root);
        Self { root, _folder: None }.with_studio()
    }

    /// With the files of the data set, which are made once.
    fn with_studio(self) -> Self {
        static FILES: LazyLock<Vec<(String, Vec<u8>)>> = LazyLock::new(|| {
            let made = Data::bare();
            made.make_studio();
            files_below(made.root()).into_iter().map(|file| (file.clone(), made.bytes(file))).collect()
        });
        FILES.iter().for_each(|(file, bytes)| _ = self.write(file, bytes));
        self
    }

    fn make_studio(&self) {
        write_glb(&self.path("mesh.glb"), &sphere_mesh(Vec3::ZERO, RADIUS).unwrap(), None).unwrap();
        write_lobes(self.path("evening.npy"), &evening(), NpyConvention::Lobelia).unwrap();
        write_lobes(self.path("day.npy"), &day(), NpyConvention::Lobelia).unwrap();
        self.photograph(&mut studio(&day()), |from| camera(from, SIZE));
        let mut relit = studio(&evening());
        for (i, from) in TEST.into_iter().enumerate() {
            let frame = shoot(&mut relit, camera(from, SIZE));
            let gt = self.path("test/gt");
            write_frame(gt.join(format!("relit/rgb_{i:06}.exr")), &frame).unwrap();
            write_image(&gt.join(format!("albedo_{i:06}.exr")), &frame.albedo, frame.width);
            write_image(&gt.join(format!("normal_{i:06}.exr")), &frame.normal, frame.width);
        }
    }

    /// Takes the photographs of both splits again, of what this pipeline shows, by cameras at these
    /// directions.
    pub fn photograph(&self, studio: &mut Pipeline, camera: impl Fn([f32; 3]) -> Camera) {
        for (split, views) in [("train", &TRAIN[..]), ("test", &TEST)] {
            let (folder, mut cameras) = (self.path(split), Map::new());
            for (i, from) in views.iter().enumerate() {
                let (camera, name) = (camera(*from), format!("rgb_{i:06}"));
                let frame = shoot(studio, camera);
                write_image(&folder.join(format!("image/{name}.exr")), &frame.color, frame.width);
                write_mask(&folder.join(format!("mask/{name}.png")), &frame);
                let ([fx, fy], [cx, cy]) = (camera.focal, camera.center);
                let k = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
                let w2c = Mat4::from(camera.world_from_camera.inverse()).transpose().to_cols_array();
                let size = [camera.width, camera.height];
                cameras.insert(format!("{name}.exr"), json!({ "K": k, "W2C": w2c, "img_size": size }));
            }
            self.write(format!("{split}/cam_dict_norm.json"), Value::from(cameras).to_string());
        }
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    pub fn path(&self, relative: impl AsRef<Path>) -> PathBuf {
        self.root().join(relative)
    }

    /// Writes a file, and the folders that it is in.
    pub fn write(&self, file: impl AsRef<Path>, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }

    /// Writes a COLMAP model of photographs in `colmap/images`, all seen by one camera from one
    /// place.
    pub fn write_colmap(&self, names: &[&str], focal: f32) {
        let lines: Vec<String> = names.iter().map(|name| format!("1 1 0 0 0 0 0 2.8 1 {name}\n\n")).collect();
        self.write("colmap/sparse/0/images.txt", lines.concat());
        let camera = format!("1 PINHOLE {SIZE} {SIZE} {focal} {focal} 12 12");
        self.write("colmap/sparse/0/cameras.txt", camera);
    }

    #[track_caller]
    pub fn bytes(&self, file: impl AsRef<Path>) -> Vec<u8> {
        let path = self.path(file);
        std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    #[track_caller]
    pub fn text(&self, file: impl AsRef<Path>) -> String {
        String::from_utf8(self.bytes(file)).unwrap()
    }

    #[track_caller]
    pub fn json(&self, file: impl AsRef<Path>) -> Value {
        serde_json::from_str(&self.text(file)).unwrap()
    }

    /// The scores of a run.
    #[track_caller]
    pub fn metrics(&self, out: &str) -> Value {
        self.json(format!("{out}/metrics.json"))
    }

    /// What a run says of itself.
    #[track_caller]
    pub fn manifest(&self, out: &str) -> Value {
        self.json(format!("{out}/run.json"))
    }

    /// The states of the passes of a run.
    #[track_caller]
    pub fn states(&self, out: &str) -> Vec<String> {
        let manifest = self.manifest(out);
        let passes = manifest["passes"].as_array().unwrap().iter();
        passes.map(|pass| pass["state"].as_str().unwrap().to_owned()).collect()
    }

    /// The mean PSNR of the pass `novel` of a run.
    #[track_caller]
    pub fn novel(&self, out: &str) -> f64 {
        self.metrics(out)["passes"]["novel"]["psnr"].as_f64().unwrap()
    }

    #[track_caller]
    pub fn exr(&self, file: impl AsRef<Path>) -> ExrLayers {
        read_exr_layers(self.path(file)).unwrap()
    }

    /// The pictures of a pass, in the order of their names.
    pub fn pictures(&self, pass: &str) -> Vec<String> {
        let files = files_below(&self.path(pass)).into_iter().filter(|file| file.ends_with(".exr"));
        files.map(|file| format!("{pass}/{file}")).collect()
    }

    /// Expects that the pictures of two passes have the same bytes.
    #[track_caller]
    pub fn same_pictures(&self, one: &str, other: &str) {
        let [one, other] = [one, other].map(|pass| self.pictures(pass));
        assert!(!one.is_empty() && one.len() == other.len(), "{one:?} {other:?}");
        for (one, other) in one.iter().zip(&other) {
            assert!(self.bytes(one) == self.bytes(other), "{one} and {other} differ");
        }
    }

    /// Changes the cameras of a split, by name.
    pub fn change_cameras(&self, split: &str, change: impl FnOnce(&mut Value)) {
        let path = format!("{split}/cam_dict_norm.json");
        let mut cameras = self.json(&path);
        change(&mut cameras);
        self.write(path, cameras.to_string());
    }

    /// Changes the channels of an EXR.
    pub fn change_image(&self, relative: &str, change: impl FnOnce(&mut ExrLayers)) {
        let mut channels = self.exr(relative);
        change(&mut channels);
        write_unchecked(&self.path(relative), &channels);
    }

    /// Writes `text` as `scene.ron` and runs it into `out`.
    pub fn run(&self, scene: &str, out: &str, arguments: &[&str]) -> Outcome {
        self.write("scene.ron", scene);
        self.run_file("scene.ron", out, arguments)
    }

    /// Runs a scene file, such as the one that `Save` wrote.
    pub fn run_file(&self, scene: &str, out: &str, arguments: &[&str]) -> Outcome {
        let mut command = command(&["run"]);
        command.arg(self.path(scene)).arg("--data").arg(self.root()).arg("--out").arg(self.path(out));
        Outcome::of(command.args(arguments))
    }

    /// Runs a scene into `out` in this process.
    pub fn run_here(
        &self,
        scene: &str,
        out: &str,
        checkpoint_every: Option<Duration>,
        resume: bool,
        progress: Arc<dyn Progress>,
    ) -> Result<()> {
        let options = LoadOptions { data: Some(self.root.clone()), ..LoadOptions::default() };
        let loaded = load(&self.write("scene.ron", scene), &options)?;
        let run = RunOptions { out: self.path(out), checkpoint_every, resume, ..RunOptions::default() };
        pass::run(&loaded, &run, progress)
    }

    /// Opens the object that `Save` wrote in a run, and expects the same pictures of `novel`, which
    /// come to `again`.
    #[track_caller]
    pub fn reopens(&self, out: &str) {
        self.run_file(&format!("{out}/saved/scene.ron"), "again", &["--quiet", "--force"]).succeeded();
        self.same_pictures(&format!("{out}/novel"), "again/novel");
    }

    /// Writes `text` as `scene.ron` and checks it.
    pub fn check(&self, scene: &str) -> Outcome {
        let path = self.write("scene.ron", scene);
        Outcome::of(command(&["check"]).arg(path).arg("--data").arg(self.root()))
    }

    /// Runs a command in this folder.
    pub fn lobelia(&self, arguments: &[&str]) -> Outcome {
        Outcome::of(command(arguments).current_dir(self.root()))
    }

    /// Expects that a command in this folder is refused with all `words`, and writes nothing.
    #[track_caller]
    pub fn refuses(&self, arguments: &[&str], words: &[&str]) {
        let before = files_below(self.root());
        self.lobelia(arguments).refused(words);
        assert_eq!(files_below(self.root()), before);
    }
}

/// Writes what a frame covers as a mask; folders are made.
pub fn write_mask(path: &Path, frame: &Frame) {
    let mask = image::GrayImage::from_fn(frame.width as u32, frame.height as u32, |x, y| {
        image::Luma([(frame.alpha[y as usize * frame.width + x as usize] * 255.0).round() as u8])
    });
    save_png(path, &image::DynamicImage::ImageLuma8(mask));
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
    use exr::prelude::{AnyChannel, AnyChannels, FlatSamples, Image, WritableImage};
    let channels = layers.channels.iter();
    let channels = channels.map(|(name, x)| AnyChannel::new(name.as_str(), FlatSamples::F32(x.clone())));
    let size = (layers.width as usize, layers.height as usize);
    Image::from_channels(size, AnyChannels::sort(channels.collect())).write().to_file(path).unwrap();
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

impl From<Output> for Outcome {
    fn from(Output { status, stdout, stderr }: Output) -> Self {
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        Self { code: status.code(), stdout: text(stdout), stderr: text(stderr) }
    }
}

impl Outcome {
    pub fn of(command: &mut Command) -> Self {
        command.output().unwrap().into()
    }

    #[track_caller]
    pub fn succeeded(self) -> Self {
        assert_eq!(self.code, Some(0), "{}", self.stderr);
        self
    }

    /// Expects exit code 2 and one short message with all `words`.
    #[track_caller]
    pub fn refused(&self, words: &[&str]) {
        let stderr = &self.stderr;
        assert_eq!(self.code, Some(2), "{stderr}{}", self.stdout);
        assert!(!stderr.contains("panicked") && stderr.len() < 3000, "{stderr}");
        assert_eq!(stderr.matches("error: ").count(), 1, "one message, not:\n{stderr}");
        for word in words {
            assert!(flat(stderr).contains(word), "no {word:?} in\n{stderr}");
        }
    }
}

/// The text with `from`, which must be there once, replaced by `to`.
#[track_caller]
pub fn changed(text: &str, from: &str, to: &str) -> String {
    assert_eq!(text.matches(from).count(), 1, "{from:?} must be there once");
    text.replace(from, to)
}

/// A message on one line, so that a wrapped sentence is found.
pub fn flat(text: &str) -> String {
    text.replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// All files below a folder by relative path, sorted; empty if there is no such folder.
pub fn files_below(folder: &Path) -> Vec<String> {
    let (mut files, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(below) = folders.pop() {
        for path in std::fs::read_dir(below).into_iter().flatten().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else {
                files.push(path.strip_prefix(folder).unwrap().to_str().unwrap().replace('\\', "/"));
            }
        }
    }
    files.sort();
    files
}

/// Whether a file name is that of an unfinished file.
pub fn is_temporary(file: &str) -> bool {
    let name = file.rsplit('/').next().unwrap_or(file);
    name.starts_with('.') || name.contains(".part") || name.ends_with(".tmp")
}

/// Does something when the bar of a pass comes to a step.
#[derive(Clone)]
pub struct AtStep<F>(pub &'static str, pub u64, pub F);

impl<F: Fn() + Clone + Send + Sync + 'static> Progress for AtStep<F> {
    fn bar(&self, title: &str, _: u64) -> Box<dyn Bar> {
        if title == self.0 { Box::new(Fuse(self.clone(), AtomicU64::new(0))) } else { Box::new(Silent) }
    }
}

struct Fuse<F>(AtStep<F>, AtomicU64);

impl<F: Fn() + Send + Sync> Bar for Fuse<F> {
    fn inc(&self, steps: u64) {
        self.set_position(self.1.load(Ordering::Relaxed) + steps);
    }

    fn set_position(&self, steps: u64) {
        self.1.store(steps, Ordering::Relaxed);
        if steps == self.0.1 {
            (self.0.2)();
        }
    }
}

/// How long a test waits for something that a run does.
const PATIENCE: Duration = Duration::from_secs(300);

/// A run that is at work, and is ended with the test.
pub struct AtWork {
    child: Child,
    /// The events of its log (`--log json`).
    events: Receiver<Value>,
}

impl AtWork {
    /// Starts a run of `scene.ron`, which a signal stops also where the tests themselves ignore it,
    /// as after `nohup`.
    pub fn begin(data: &Data, arguments: &[&str]) -> Self {
        let by: &[&str] = if cfg!(target_os = "linux") { &["env", "--default-signal=INT,HUP"] } else { &[] };
        Self::begin_by(data, by, arguments)
    }

    /// Starts a run through another program, which becomes the run.
    pub fn begin_by(data: &Data, by: &[&str], arguments: &[&str]) -> Self {
        let words = [by, &[env!("CARGO_BIN_EXE_lobelia"), "run", "--log", "json"]].concat();
        let mut run = Command::new(words[0]);
        run.args(&words[1..]);
        run.arg(data.path("scene.ron")).arg("--data").arg(data.root()).arg("--out").arg(data.path("out"));
        let mut child = run.args(arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let (sender, events) = channel();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        std::thread::spawn(move || {
            // The run must not wait for a reader, whether or not the test listens.
            for line in lines.map_while(|line| line.ok()) {
                let _ = serde_json::from_str(&line).map(|event| sender.send(event));
            }
        });
        Self { child, events }
    }

    /// Starts a run and waits until a pass is at work.
    pub fn start(data: &Data, scene: &str, arguments: &[&str], pass: &str) -> Self {
        data.write("scene.ron", scene);
        let at_work = Self::begin(data, arguments);
        at_work.until(|event| event["event"] == "pass" && event["name"] == pass);
        at_work
    }

    /// Waits until the run tells of such an event.
    #[track_caller]
    pub fn until(&self, is_it: impl Fn(&Value) -> bool) {
        let started = Instant::now();
        loop {
            let left = PATIENCE.saturating_sub(started.elapsed());
            let event = self.events.recv_timeout(left).expect("the run ended, or stands still");
            if is_it(&event) {
                return;
            }
        }
    }

    /// Waits until the run has taken further steps of a fit or shape.
    pub fn until_a_step(&self) {
        while self.events.try_recv().is_ok() {}
        self.until(|event| event["event"] == "step");
    }

    /// Waits for the end of the run, and returns its exit code.
    pub fn ended(mut self) -> Option<i32> {
        let started = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            assert!(started.elapsed() < PATIENCE, "the run does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Sends it a signal, by name; SIGTERM if nothing else matters, for a program in the background
    /// may inherit that the others are ignored.
    #[cfg(unix)]
    pub fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        assert!(Command::new("kill").args([&format!("-{name}"), &id]).status().unwrap().success());
    }

    /// Kills it, as a power cut would.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for AtWork {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A gray sphere under a lamp at the side, and a pass `{PASS}`.
pub const GRAY_SPHERE: &str = r#"Scene(
    version: 1,
    surface: Sphere(texture_size: 16),
    views: Cameras([(name: "a", eye: (0, 0, 3), width: 16, height: 16)]),
    light: Fixed(Lobes(lobes: [(axis: (1, 0.2, 0.5), sharpness: 4, amplitude: (1, 1, 1))])),
    material: (albedo: Fixed(Constant(0.5, 0.5, 0.5)), specular: (albedo: Fixed(0.1, 0.1, 0.1), roughness: Fixed(0.3))),
    passes: [{PASS}],
)"#;

/// Passes of [`scene`].
pub const FIT: &str = r#"Fit(name: "fit", steps: 10, batch: 256), "#;
pub const NOVEL: &str = r#"Render(name: "novel"), "#;
pub const SCORES: &str = r#"Evaluate(scores: [(pass: "novel", truth: Photographs)]), "#;
/// A fit that does not end.
pub const ENDLESS: &str = r#"Fit(name: "endless", steps: 1500000000, batch: 256), "#;

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

/// A scene of the data set of which all is known: a gray mesh under the other light.
pub fn known_scene(passes: &str) -> String {
    let material = "material: (albedo: Fixed(Constant(0.4, 0.4, 0.4)), \
                    specular: (albedo: Fixed(0.2, 0.2, 0.2), roughness: Fixed(0.3))),";
    scene(passes)
        .replace("Unknown(lobes: 6)", r#"Fixed(Npy(path: "$DATA/evening.npy"))"#)
        .replace("passes:", &format!("{material}\n    passes:"))
}

/// A scene of the model that [`Data::write_colmap`] writes.
pub fn colmap_scene() -> String {
    known_scene(r#"Render(name: "novel", render: (views: All)),"#)
        .replace(r#"Dataset(path: "$DATA")"#, r#"Dataset(path: "$DATA/colmap")"#)
}

/// A right scene.
pub fn usual() -> String {
    scene(&[FIT, NOVEL, SCORES].concat())
}

/// A scene with photographs of its own, taken under this light.
pub fn photographed(passes: &str, light: &str) -> String {
    let views = format!(
        "Photographed(cameras: (count: 6, test: 2, size: 20), spp: 2, truth: (albedo: Constant(0.5, 0.3, 0.2), \
         specular: (albedo: (0.3, 0.3, 0.3), roughness: 0.25), light: {light}))"
    );
    scene(passes).replace(r#"Dataset(path: "$DATA")"#, &views)
}
