//! Reading a COLMAP reconstruction: `cameras` and `images`, as text or binary.
//!
//! A camera model is a list of parameters; an image is a quaternion (w first) and a translation, both
//! camera_from_world, OpenCV axes. Points are skipped.

use crate::codec::file::is_there;
use crate::codec::nearby::missing_file_help;
use crate::dataset::distortion::{Distortion, Projection};
use crate::dataset::lens::{Focal, Lens};
use crate::dataset::load::read_text;
use crate::dataset::names::quoted;
use crate::dataset::pose::Rigid;
use crate::error::{Error, Result};
use glam::{Affine3A, DMat3, DQuat, DVec3};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// COLMAP's camera models by number, with their counts of focal lengths and of further coefficients. Two numbers for the principal
/// point are between them.
const MODELS: [(&str, usize, usize); 17] = [
    ("SIMPLE_PINHOLE", 1, 0),
    ("PINHOLE", 2, 0),
    ("SIMPLE_RADIAL", 1, 1),
    ("RADIAL", 1, 2),
    ("OPENCV", 2, 4),
    ("OPENCV_FISHEYE", 2, 4),
    ("FULL_OPENCV", 2, 8),
    ("FOV", 2, 1),
    ("SIMPLE_RADIAL_FISHEYE", 1, 1),
    ("RADIAL_FISHEYE", 1, 2),
    ("THIN_PRISM_FISHEYE", 2, 8),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 2, 12),
    ("SIMPLE_DIVISION", 1, 1),
    ("DIVISION", 2, 1),
    ("SIMPLE_FISHEYE", 1, 0),
    ("FISHEYE", 2, 0),
    ("EUCM", 2, 2),
];
/// The number and name of the model without focal length.
const PANORAMA: (u32, &str) = (17, "EQUIRECTANGULAR");
const UNKNOWN_MODEL_HELP: &str =
    "Undistort the photographs with COLMAP's image_undistorter and give its output folder.";
const PANORAMA_HELP: &str = "Cut the panoramas into perspective pictures before the reconstruction.";
const PARAMETERS_HELP: &str = "Write the model again with COLMAP's model_converter, or correct the camera.";
const CUT_SHORT_HELP: &str = "Copy the file again, or write the model again with COLMAP's model_converter.";

/// One photograph of a reconstruction.
pub(super) struct ModelImage {
    /// The path below the image folder, as in the file.
    pub name: String,
    pub camera: u32,
    pub camera_from_world: Rigid,
}

/// A reconstruction's cameras and photographs.
pub(super) struct Model {
    pub cameras: BTreeMap<u32, Lens>,
    pub images: Vec<ModelImage>,
    /// The file that lists the images.
    pub image_file: PathBuf,
}

/// The `images` file of a model folder, binary before text; `None` if there is no model in it.
pub(super) fn image_file(folder: &Path) -> Option<PathBuf> {
    ["bin", "txt"]
        .into_iter()
        .find(|kind| {
            ["cameras", "images"].iter().all(|name| is_there(&folder.join(format!("{name}.{kind}"))))
        })
        .map(|kind| folder.join(format!("images.{kind}")))
}

/// The number of photographs that the file `image_file` announces.
pub(super) fn image_count(image_file: &Path) -> Result<u64> {
    if is_text(image_file) {
        return images_of_text(image_file).map(|images| images.len() as u64);
    }
    let mut count = [0; 8];
    let mut file = crate::codec::file::open(image_file, missing_file_help)?;
    file.read_exact(&mut count).map_err(|_| cut_short(image_file, 0))?;
    Ok(u64::from_le_bytes(count))
}

fn is_text(file: &Path) -> bool {
    file.extension().is_some_and(|kind| kind == "txt")
}

/// Reads the model of which `image_file` is the `images` file.
pub(super) fn read_model(image_file: PathBuf) -> Result<Model> {
    let is_text = is_text(&image_file);
    let camera_file = image_file.with_file_name(if is_text { "cameras.txt" } else { "cameras.bin" });
    let (cameras, images) = if is_text {
        (cameras_of_text(&camera_file)?, images_of_text(&image_file)?)
    } else {
        (cameras_of_bytes(&camera_file)?, images_of_bytes(&image_file)?)
    };
    Ok(Model { cameras, images, image_file })
}

/// A problem of a camera, and its remedy.
type Trouble = (String, &'static str);

fn model_number(number: u32) -> Result<(&'static str, usize, usize), Trouble> {
    let known = usize::try_from(number).ok().and_then(|number| MODELS.get(number).copied());
    known.ok_or_else(|| match number {
        number if number == PANORAMA.0 => is_panorama(),
        _ => (format!("the camera model number {number} cannot be read"), UNKNOWN_MODEL_HELP),
    })
}

fn is_panorama() -> Trouble {
    (
        format!("the camera model {} is a panorama, of which no pinhole camera shows all", PANORAMA.1),
        PANORAMA_HELP,
    )
}

/// A lens from a camera model's name and parameters.
fn lens_of(model: &str, size: [u64; 2], parameters: &[f64]) -> Result<Lens, Trouble> {
    if model == PANORAMA.1 {
        return Err(is_panorama());
    }
    let Some(&(_, focals, others)) = MODELS.iter().find(|known| known.0 == model) else {
        return Err((format!("the camera model {model} cannot be read"), UNKNOWN_MODEL_HELP));
    };
    let (count, expected) = (parameters.len(), focals + 2 + others);
    if count != expected {
        return Err((format!("the {model} camera has {count} parameters, not {expected}"), PARAMETERS_HELP));
    }
    let [width, height] = size.map(u32::try_from);
    let (Ok(width), Ok(height)) = (width, height) else {
        return Err((format!("the image size is {}×{}", size[0], size[1]), CUT_SHORT_HELP));
    };
    let (focal, rest) = parameters.split_at(focals);
    let (center, coefficients) = rest.split_at(2);
    let distortion = distortion_of(model, coefficients)
        .ok_or_else(|| (format!("the camera model {model} cannot be read"), UNKNOWN_MODEL_HELP))?;
    let lens = Lens {
        size: Some([width, height]),
        focal_x: Focal::Pixels(focal[0]),
        focal_y: Some(Focal::Pixels(focal[focals - 1])),
        center: [Some(center[0]), Some(center[1])],
        skew: 0.0,
        distortion,
        resizable: false,
        by_side: false,
    };
    match lens.camera([width, height], Affine3A::IDENTITY, 0.5) {
        Ok(_) => Ok(lens),
        Err(problem) => Err((problem, PARAMETERS_HELP)),
    }
}

/// The distortion of a model in the order of its coefficients (COLMAP's `sensor/models`).
pub(super) fn distortion_of(model: &str, coefficients: &[f64]) -> Option<Distortion> {
    let lens = |projection| Distortion { projection, ..Distortion::NONE };
    Some(match (model, coefficients) {
        ("SIMPLE_PINHOLE" | "PINHOLE", []) => Distortion::NONE,
        ("SIMPLE_RADIAL", &[k]) => Distortion::brown_conrady([k, 0.0, 0.0], [0.0; 2]),
        ("RADIAL", &[k1, k2]) => Distortion::brown_conrady([k1, k2, 0.0], [0.0; 2]),
        ("OPENCV", &[k1, k2, p1, p2]) => Distortion::brown_conrady([k1, k2, 0.0], [p1, p2]),
        ("FULL_OPENCV", &[k1, k2, p1, p2, k3, k4, k5, k6]) => {
            Distortion { divisor: [k4, k5, k6], ..Distortion::brown_conrady([k1, k2, k3], [p1, p2]) }
        }
        ("SIMPLE_FISHEYE" | "FISHEYE", []) => lens(Projection::Equidistant),
        ("SIMPLE_RADIAL_FISHEYE", &[k]) => Distortion::fisheye([k, 0.0, 0.0, 0.0]),
        ("RADIAL_FISHEYE", &[k1, k2]) => Distortion::fisheye([k1, k2, 0.0, 0.0]),
        ("OPENCV_FISHEYE", &[k1, k2, k3, k4]) => Distortion::fisheye([k1, k2, k3, k4]),
        ("THIN_PRISM_FISHEYE", &[k1, k2, p1, p2, k3, k4, sx, sy]) => Distortion {
            tangential: [p1, p2],
            prism: [sx, 0.0, sy, 0.0],
            ..Distortion::fisheye([k1, k2, k3, k4])
        },
        // Its p₀ and p₁ are OpenCV's p₂ and p₁.
        ("RAD_TAN_THIN_PRISM_FISHEYE", &[k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3]) => Distortion {
            radial: [k0, k1, k2, k3, k4, k5],
            tangential: [p1, p0],
            prism: [s0, s1, s2, s3],
            shifts_scaled: true,
            ..lens(Projection::Equidistant)
        },
        ("FOV", &[omega]) => lens(Projection::Fov(omega)),
        ("SIMPLE_DIVISION" | "DIVISION", &[k]) => lens(Projection::Division(k)),
        ("EUCM", &[alpha, beta]) => lens(Projection::Unified { alpha, beta }),
        _ => return None,
    })
}

/// A pose from a quaternion, w first, and a translation. `Err` says what is wrong, as a clause.
fn pose_of(q: [f64; 4], t: [f64; 3]) -> Result<Rigid, String> {
    let quaternion = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
    let length = quaternion.length();
    let sound = length > 1e-6 && length.is_finite() && t.iter().all(|&t| (t as f32).is_finite());
    if !sound {
        return Err(format!(
            "the pose is not a rotation and translation: quaternion {q:?}, translation {t:?}"
        ));
    }
    let rotation = DMat3::from_quat(quaternion.normalize());
    Ok(Rigid::new(rotation, DVec3::from(t)))
}

/// Lines that are not empty or comments, with their numbers.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

fn numbers<T: FromStr>(words: &[&str]) -> Option<Vec<T>> {
    words.iter().map(|word| word.parse().ok()).collect()
}

fn cameras_of_text(file: &Path) -> Result<BTreeMap<u32, Lens>> {
    let mut cameras = BTreeMap::new();
    for (number, line) in lines(&read_text(file)?) {
        let wrong = |problem: String, help: &str| Error::input(file, format!("line {number}"), problem, help);
        let words: Vec<&str> = line.split_whitespace().collect();
        let expected =
            || wrong("this is not a camera".into(), "A line is CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS.");
        let [id, model, width, height, parameters @ ..] = words.as_slice() else { return Err(expected()) };
        let id: u32 = id.parse().map_err(|_| expected())?;
        let size: Vec<u64> = numbers(&[width, height]).ok_or_else(expected)?;
        let parameters: Vec<f64> = numbers(parameters).ok_or_else(expected)?;
        let lens = lens_of(model, [size[0], size[1]], &parameters)
            .map_err(|(problem, help)| wrong(format!("camera {id}: {problem}"), help))?;
        cameras.insert(id, lens);
    }
    Ok(cameras)
}

/// Each image has its own line; the lines of points between images hold triples of numbers, or are empty.
fn images_of_text(file: &Path) -> Result<Vec<ModelImage>> {
    let mut images = Vec::new();
    for (number, line) in lines(&read_text(file)?) {
        let words: Vec<&str> = line.split_whitespace().collect();
        if words.len().is_multiple_of(3) && words.iter().all(|word| word.parse::<f64>().is_ok()) {
            continue;
        }
        let wrong = |problem: String| {
            let help = "A line is IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME.";
            Error::input(file, format!("line {number}"), problem, help)
        };
        let expected = || wrong("this is neither an image nor points".into());
        let [_, pose @ .., _, _] = words.get(..10).ok_or_else(expected)? else { return Err(expected()) };
        let pose: Vec<f64> = numbers(pose).ok_or_else(expected)?;
        let camera: u32 = words[8].parse().map_err(|_| expected())?;
        let name = words[9..].join(" ");
        let camera_from_world = pose_of([pose[0], pose[1], pose[2], pose[3]], [pose[4], pose[5], pose[6]])
            .map_err(|problem| wrong(format!("image {}: {problem}", quoted(&name))))?;
        images.push(ModelImage { name, camera, camera_from_world });
    }
    Ok(images)
}

fn cut_short(file: &Path, byte: usize) -> Error {
    let problem = "the file is truncated: it ends before the content that it announces";
    Error::input(file, format!("byte {byte}"), problem, CUT_SHORT_HELP)
}

/// A binary file being read, little-endian.
struct Bytes<'a> {
    file: &'a Path,
    bytes: Vec<u8>,
    at: usize,
}

impl<'a> Bytes<'a> {
    fn open(file: &'a Path) -> Result<Self> {
        Ok(Self { file, bytes: crate::codec::file::read_bytes(file, missing_file_help)?, at: 0 })
    }

    fn cut_short(&self) -> Error {
        cut_short(self.file, self.at)
    }

    fn skip(&mut self, count: u64) -> Result<&[u8]> {
        let end = usize::try_from(count).ok().and_then(|count| self.at.checked_add(count));
        match end.filter(|&end| end <= self.bytes.len()) {
            Some(end) => {
                let start = std::mem::replace(&mut self.at, end);
                Ok(&self.bytes[start..end])
            }
            None => Err(self.cut_short()),
        }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        let taken = self.skip(N as u64)?.first_chunk().copied();
        taken.ok_or_else(|| self.cut_short())
    }

    fn u32(&mut self) -> Result<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.take().map(f64::from_le_bytes)?;
        }
        Ok(values)
    }

    /// Text up to a zero byte.
    fn text(&mut self) -> Result<String> {
        let rest = &self.bytes[self.at..];
        let length = rest.iter().position(|&byte| byte == 0).ok_or_else(|| self.cut_short())?;
        let text = String::from_utf8_lossy(&rest[..length]).into_owned();
        self.at += length + 1;
        Ok(text)
    }
}

fn cameras_of_bytes(file: &Path) -> Result<BTreeMap<u32, Lens>> {
    let mut bytes = Bytes::open(file)?;
    let mut cameras = BTreeMap::new();
    for _ in 0..bytes.u64()? {
        let (id, model) = (bytes.u32()?, bytes.u32()?);
        let wrong = |problem: String, help: &str| Error::input(file, format!("camera {id}"), problem, help);
        let (name, focals, others) = model_number(model).map_err(|(problem, help)| wrong(problem, help))?;
        let size = [bytes.u64()?, bytes.u64()?];
        let parameters = (0..focals + 2 + others)
            .map(|_| bytes.f64s::<1>().map(|[value]| value))
            .collect::<Result<Vec<_>>>()?;
        let lens = lens_of(name, size, &parameters).map_err(|(problem, help)| wrong(problem, help))?;
        cameras.insert(id, lens);
    }
    Ok(cameras)
}

fn images_of_bytes(file: &Path) -> Result<Vec<ModelImage>> {
    /// x and y as `f64`, and the ID of a point.
    const POINT_BYTES: u64 = 24;
    let mut bytes = Bytes::open(file)?;
    let mut images = Vec::new();
    for _ in 0..bytes.u64()? {
        bytes.u32()?;
        let (q, t) = (bytes.f64s()?, bytes.f64s()?);
        let camera = bytes.u32()?;
        let name = bytes.text()?;
        let points = bytes.u64()?;
        bytes.skip(points.saturating_mul(POINT_BYTES))?;
        let camera_from_world = pose_of(q, t).map_err(|problem| {
            Error::input(
                file,
                format!("image {}", quoted(&name)),
                problem,
                "Register the photograph again, or remove it.",
            )
        })?;
        images.push(ModelImage { name, camera, camera_from_world });
    }
    Ok(images)
}
