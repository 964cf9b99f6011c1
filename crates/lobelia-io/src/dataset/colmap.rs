//! COLMAP's layout, as the manual's chapter on layouts tells it: a reconstruction in
//! `DIR/sparse/0`, photographs in `DIR/images`, masks in `DIR/masks`, and lists of the splits. An
//! image of the model is a quaternion (w first) and a translation, both camera_from_world, OpenCV
//! axes.

use crate::codec::{file::is_there, file::read_bytes, image::has_extension, nearby::missing_file_help};
use crate::dataset::files::{
    Folders, PHOTOGRAPH_FOLDERS, SplitList, check_image_name, entries, file_name, flat_name, image_files,
    image_key, listed, mask_folder, portable, quoted, read_text,
};
use crate::dataset::lens::{Distortion, Lens, MODELS, Trouble};
use crate::dataset::pose::Rigid;
use crate::dataset::views::{Plan, ViewPlan, split_name};
use glam::{Affine3A, DMat3, DQuat, DVec3};
use lobelia_geometry::{Error, Result, view::Split};
use std::{collections::BTreeMap, collections::BTreeSet, path::Path, path::PathBuf, str::FromStr};

/// Where reconstructions are, and the folder of photographs that belongs to each: COLMAP's own,
/// nerfstudio's, the outputs of COLMAP's `image_undistorter` and `automatic_reconstructor`, what 3D
/// Gaussian splatting keeps of the distorted photographs, and instant-ngp's.
const PLACES: [(&str, &str); 9] = [
    ("sparse", "images"),
    ("colmap/sparse", "images"),
    ("colmap/sparse", "colmap/images"),
    ("dense/sparse", "dense/images"),
    ("dense/0/sparse", "dense/0/images"),
    ("distorted/sparse", "input"),
    ("colmap_text", "images"),
    ("colmap", "images"),
    ("model", "images"),
];
/// Models that are looked for in a folder.
const MOST_MODELS: usize = 100;
/// Folders of reconstructions of which the cameras of another layout are made.
const FOR_THE_RECORD: [&str; 3] = ["colmap", "colmap_text", "model"];
const UNKNOWN_MODEL_HELP: &str = "Undistort the photographs with `colmap image_undistorter` and give its output folder; cut panoramas into \
                                  perspective pictures before the reconstruction.";
const PARAMETERS_HELP: &str = "Write the model again with COLMAP's model_converter, or correct the camera.";
const CUT_SHORT_HELP: &str = "Copy the file again, or write the model again with COLMAP's model_converter.";

/// A reconstruction that was found.
struct Place {
    /// The `images` files of its models; at least one.
    models: Vec<PathBuf>,
    photographs: PathBuf,
    /// Whether the photographs are where they usually are, and not in a folder beside that of
    /// another usual name, or nowhere.
    is_usual: bool,
}

impl Place {
    fn new(models: Vec<PathBuf>, usual: PathBuf) -> Option<Self> {
        let is_usual = usual.is_dir();
        let rank = |path: &Path| {
            let name = file_name(path).to_lowercase();
            PHOTOGRAPH_FOLDERS.iter().position(|usual| *usual == name)
        };
        let has_images = |path: &Path| image_files(path).is_ok_and(|files| !files.is_empty());
        let beside = usual.parent().filter(|_| !is_usual && !models.is_empty()).into_iter().flat_map(entries);
        let other = beside.filter_map(|path| Some((rank(&path).filter(|_| has_images(&path))?, path))).min();
        let photographs = other.map_or(usual, |(_, path)| path);
        (!models.is_empty()).then_some(Self { models, photographs, is_usual })
    }

    /// The first place in a folder with both models and photographs, or else with models.
    fn find(dir: &Path) -> Option<Self> {
        let place = |(models, photographs): &(&str, &str)| {
            let models = dir.join(models);
            let several = numbered_models(&models);
            let models = if several.is_empty() { image_file(&models).into_iter().collect() } else { several };
            Self::new(models, dir.join(photographs))
        };
        // A folder of numbered models alone is that in which COLMAP puts them.
        let loose = Self::new(numbered_models(dir), dir.join("images"));
        let loose = loose.filter(|loose| loose.photographs.is_dir());
        let mut places: Vec<Self> = PLACES.iter().filter_map(place).chain(loose).collect();
        let complete = places.iter().position(|place| place.photographs.is_dir());
        (!places.is_empty()).then(|| places.swap_remove(complete.unwrap_or(0)))
    }
}

/// The models in the folders `0`, `1`, … of `folder`.
fn numbered_models(folder: &Path) -> Vec<PathBuf> {
    // COLMAP counts from 0, but a model that is of no use may have been removed.
    let numbered = (0..MOST_MODELS).map(|i| folder.join(i.to_string()));
    numbered.filter_map(|model| image_file(&model)).collect()
}

/// The `images` file of a model folder, binary before text; `None` if there is no model in it.
fn image_file(folder: &Path) -> Option<PathBuf> {
    let has = |name: &str, kind: &str| is_there(&folder.join(format!("{name}.{kind}")));
    let kind = ["bin", "txt"].into_iter().find(|kind| has("cameras", kind) && has("images", kind))?;
    Some(folder.join(format!("images.{kind}")))
}

/// Whether the folder has this split of a COLMAP data set: the test split is a list.
pub(super) fn has_split(dir: &Path, split: Split) -> bool {
    Place::find(dir).is_some() && (split == Split::Train || is_there(&list_file(dir, split)))
}

/// Whether the reconstruction is there for the record only, beside the cameras of another layout
/// that were made of it, or has no photographs in the folder that belongs to it.
pub(super) fn is_for_the_record(dir: &Path) -> bool {
    let is_kept = |file: &PathBuf| FOR_THE_RECORD.iter().any(|folder| file.starts_with(dir.join(folder)));
    Place::find(dir).is_some_and(|place| place.models.iter().all(is_kept) || !place.is_usual)
}

/// The file of the model with the most images, the first of equals, its images, and a note about
/// the others.
fn largest(models: &[PathBuf]) -> Result<(&Path, Vec<ModelImage>, Option<String>)> {
    let mut read = models.iter().map(|file| images_of(file)).collect::<Result<Vec<_>>>()?;
    let chosen = (0..read.len()).rev().max_by_key(|i| read[*i].len()).unwrap_or(0);
    let list: Vec<String> = read.iter().map(|images| images.len().to_string()).collect();
    let note = format!(
        "the reconstruction has {} models of {} images; only the largest, {}, is read",
        models.len(),
        list.join(", "),
        models[chosen].parent().unwrap_or(Path::new("")).display()
    );
    Ok((&models[chosen], read.swap_remove(chosen), (models.len() > 1).then_some(note)))
}

/// The model with the most photographs of those in the folders `0`, `1`, … of a folder.
pub struct LargestModel {
    /// Of the model.
    pub folder: PathBuf,
    /// The names of its photographs, as paths below the folder of photographs.
    pub names: BTreeSet<String>,
    /// A note about the others.
    pub note: Option<String>,
}

/// Reads the largest model in `folder`, if there is one.
///
/// # Errors
/// [`Error::Input`] if one cannot be read.
pub fn largest_model(folder: &Path) -> Result<Option<LargestModel>> {
    let models = numbered_models(folder);
    if models.is_empty() {
        return Ok(None);
    }
    let (file, images, note) = largest(&models)?;
    let names = images.into_iter().map(|image| image.name).collect();
    Ok(Some(LargestModel { folder: file.parent().unwrap_or(folder).to_owned(), names, note }))
}

/// Plans the views of a split, in the order of their names; without lists, all are of the training
/// split.
pub(super) fn plan(dir: &Path, split: Split) -> Result<Plan> {
    let Some(Place { models, photographs, .. }) = Place::find(dir) else {
        let help = missing_file_help(&dir.join("sparse/0/cameras.bin"));
        return Err(Error::input(dir, "", "there is no COLMAP model", help));
    };
    let (file, mut images, of_models) = largest(&models)?;
    let cameras = cameras_of(file)?;
    if images.is_empty() {
        let problem = "the model has no images, so that there are no views";
        let help = "Give a model in which photographs are registered; COLMAP may have written several.";
        return Err(Error::input(file, "", problem, help));
    }
    if !photographs.is_dir() {
        let near = missing_file_help(&photographs);
        let help = format!("The photographs that COLMAP was given belong there: rename their folder. {near}");
        return Err(Error::input(&photographs, "", "the folder of photographs is missing", help));
    }
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let masks = photographs.parent().and_then(mask_folder).or_else(|| mask_folder(dir));
    let (mut photographs, mut masks) = (Folders::below(photographs), masks.map(Folders::below));
    let names: Vec<&str> = images.iter().map(|image| image.name.as_str()).collect();
    let (wanted, unlisted) = listed(&read_lists(dir)?, split, &names)?;
    let mut views = Vec::new();
    for (image, is_wanted) in images.iter().zip(wanted) {
        let place = format!("image {}", quoted(&image.name));
        let name = portable(&image.name);
        check_image_name(&name, file, &place)?;
        if !is_wanted {
            // Found, so that it is not taken for one without a camera.
            photographs.find(&name);
            continue;
        }
        let (found, photograph) = photographs.photograph(&name)?;
        let Some(lens) = cameras.get(&image.camera).copied() else {
            let problem = format!("there is no camera {} in the model", image.camera);
            return Err(Error::input(file, place, problem, "Write the model again."));
        };
        views.push(ViewPlan {
            name: flat_name(&found),
            camera_file: file.to_owned(),
            place,
            image: Some(photograph),
            mask: masks.as_mut().map(|masks| masks.mask(&found)).transpose()?,
            lens,
            pose: image.camera_from_world.inverse(),
        });
    }
    let mut notes: Vec<String> =
        of_models.into_iter().chain(unlisted).chain(photographs.note_of_unused()).collect();
    // Notes about all views are reported once, with the training split.
    notes.retain(|_| split == Split::Train);
    Ok(Plan { views, notes })
}

/// The file that lists the views of a split.
fn list_file(dir: &Path, split: Split) -> PathBuf {
    dir.join(format!("{}_id.txt", split_name(split)))
}

/// The lists of the splits that a folder has.
///
/// # Errors
/// [`Error::Input`] if a list cannot be read, has no names, or has a name that the other has, too.
fn read_lists(dir: &Path) -> Result<Vec<SplitList>> {
    let mut lists: Vec<SplitList> = Vec::new();
    for split in [Split::Train, Split::Test] {
        let file = list_file(dir, split);
        if !is_there(&file) {
            continue;
        }
        let text = read_text(&file)?;
        let lines = text.lines().map(str::trim).enumerate().filter(|(_, line)| !line.is_empty());
        let names: Vec<_> = lines.map(|(i, name)| (name.to_owned(), format!("line {}", i + 1))).collect();
        if names.is_empty() {
            let help = "Write a name of the model in each line, or remove the file.";
            return Err(Error::input(&file, "", "the list has no names of views", help));
        }
        let others = lists.iter().flat_map(|list| &list.names);
        let others: BTreeMap<_, _> = others.map(|(name, place)| (image_key(name), place)).collect();
        if let Some((name, place)) = names.iter().find(|(name, _)| others.contains_key(&image_key(name))) {
            let problem =
                format!("{} is in train_id.txt as well, {}", quoted(name), others[&image_key(name)]);
            let help = "A view belongs to one split: remove one of the lines.";
            return Err(Error::input(&file, place, problem, help));
        }
        lists.push(SplitList { file, split: Some(split), names });
    }
    Ok(lists)
}

/// One photograph of a reconstruction.
struct ModelImage {
    /// The path below the image folder, as in the file.
    name: String,
    camera: u32,
    camera_from_world: Rigid,
}

/// The photographs of the model of which this is the `images` file.
fn images_of(image_file: &Path) -> Result<Vec<ModelImage>> {
    if has_extension(image_file, &["txt"]) { images_of_text(image_file) } else { images_of_bytes(image_file) }
}

/// The cameras of the model of which this is the `images` file, by their numbers.
fn cameras_of(image_file: &Path) -> Result<BTreeMap<u32, Lens>> {
    let is_text = has_extension(image_file, &["txt"]);
    let file = image_file.with_file_name(if is_text { "cameras.txt" } else { "cameras.bin" });
    if is_text { cameras_of_text(&file) } else { cameras_of_bytes(&file) }
}

/// A lens from a camera model's name and parameters.
fn lens_of(model: &str, size: [u64; 2], parameters: &[f64]) -> Result<Lens, Trouble> {
    let Some(&(_, _, focals, names)) = MODELS.iter().find(|known| known.1 == model) else {
        return Err((format!("the camera model {model} cannot be read"), UNKNOWN_MODEL_HELP));
    };
    let (count, expected) = (parameters.len(), focals + 2 + names.len());
    if count != expected {
        return Err((format!("the {model} camera has {count} parameters, not {expected}"), PARAMETERS_HELP));
    }
    let [Ok(width), Ok(height)] = size.map(u32::try_from) else {
        return Err((format!("the image size is {}×{}", size[0], size[1]), CUT_SHORT_HELP));
    };
    let (focal, rest) = parameters.split_at(focals);
    let (center, coefficients) = rest.split_at(2);
    let coefficient = |name: &str| names.iter().position(|own| *own == name).map_or(0.0, |n| coefficients[n]);
    let lens = Lens {
        size: Some([width, height]),
        distortion: Distortion::of_model(model, coefficient),
        ..Lens::pinhole([focal[0], focal[focals - 1]], [Some(center[0]), Some(center[1])])
    };
    let possible = lens.camera([width, height], Affine3A::IDENTITY, 0.5);
    possible.map(|_| lens).map_err(|problem| (problem, PARAMETERS_HELP))
}

/// A pose from a quaternion, w first, and a translation: seven numbers. `Err` says what is wrong,
/// as a clause.
fn pose_of(pose: &[f64]) -> Result<Rigid, String> {
    let (q, t) = pose.split_at(4);
    let quaternion = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
    let length = quaternion.length();
    if length > 1e-6 && length.is_finite() && t.iter().all(|&t| (t as f32).is_finite()) {
        return Ok(Rigid::new(DMat3::from_quat(quaternion.normalize()), DVec3::from_slice(t)));
    }
    Err(format!("the pose is not a rotation and translation: quaternion {q:?}, translation {t:?}"))
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

/// Each image has its own line; the lines of points between images hold triples of numbers, or are
/// empty.
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
        let camera_from_world =
            pose_of(&pose).map_err(|problem| wrong(format!("image {}: {problem}", quoted(&name))))?;
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
        Ok(Self { file, bytes: read_bytes(file, missing_file_help)?, at: 0 })
    }

    fn skip(&mut self, count: u64) -> Result<&[u8]> {
        let skipped = usize::try_from(count).ok().and_then(|count| self.bytes[self.at..].get(..count));
        let skipped = skipped.ok_or_else(|| cut_short(self.file, self.at))?;
        self.at += skipped.len();
        Ok(skipped)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut taken = [0; N];
        taken.copy_from_slice(self.skip(N as u64)?);
        Ok(taken)
    }

    fn u32(&mut self) -> Result<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64s(&mut self, count: usize) -> Result<Vec<f64>> {
        (0..count).map(|_| self.take().map(f64::from_le_bytes)).collect()
    }

    /// Text up to a zero byte.
    fn text(&mut self) -> Result<String> {
        let length = self.bytes[self.at..].iter().position(|&byte| byte == 0);
        let length = length.ok_or_else(|| cut_short(self.file, self.at))?;
        let text = String::from_utf8_lossy(self.skip(length as u64)?).into_owned();
        self.skip(1).map(|_| text)
    }
}

fn cameras_of_bytes(file: &Path) -> Result<BTreeMap<u32, Lens>> {
    let mut bytes = Bytes::open(file)?;
    let mut cameras = BTreeMap::new();
    for _ in 0..bytes.u64()? {
        let (id, model) = (bytes.u32()?, bytes.u32()?);
        let wrong = |problem: String, help: &str| Error::input(file, format!("camera {id}"), problem, help);
        let Some(&(_, name, focals, names)) = MODELS.iter().find(|known| known.0 == model) else {
            return Err(wrong(format!("the camera model number {model} cannot be read"), UNKNOWN_MODEL_HELP));
        };
        let size = [bytes.u64()?, bytes.u64()?];
        let parameters = bytes.f64s(focals + 2 + names.len())?;
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
        let pose = bytes.f64s(7)?;
        let camera = bytes.u32()?;
        let name = bytes.text()?;
        let points = bytes.u64()?;
        bytes.skip(points.saturating_mul(POINT_BYTES))?;
        let camera_from_world = pose_of(&pose).map_err(|problem| {
            let help = "Register the photograph again, or remove it.";
            Error::input(file, format!("image {}", quoted(&name)), problem, help)
        })?;
        images.push(ModelImage { name, camera, camera_from_world });
    }
    Ok(images)
}
