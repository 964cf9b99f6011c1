//! Files that camera files name: text and JSON, names of images and views, images and masks in
//! folders, and lists of the views of a split.

use crate::codec::file::{check_file_name, is_there, read_folder};
use crate::codec::image::{IMAGE_EXTENSIONS, has_extension, image_header, is_unread_name};
use crate::codec::nearby::{closest, missing_file_help};
use lobelia_geometry::{Error, Result, view::Split};
use serde::de::DeserializeOwned;
use std::path::{Component, Path, PathBuf};
use std::{borrow::Cow, collections::BTreeMap, collections::BTreeSet};
use unicode_normalization::{UnicodeNormalization, is_nfc};

/// Most bytes of a camera file. COLMAP's text model of a thousand views has some hundred MiB.
const MOST_TEXT: u64 = 2 << 30;
/// Most characters of a name in a message.
const LONGEST: usize = 60;
/// Names that folders of photographs usually have, in lower case, the most usual first: COLMAP
/// takes any.
pub(super) const PHOTOGRAPH_FOLDERS: [&str; 8] =
    ["images", "image", "input", "rgb", "photos", "photographs", "pictures", "imgs"];
/// Names of mask folders in lower case, in the order in which they are looked for.
const MASK_FOLDERS: &str = "masks mask silhouettes silhouette segmentation segmentations seg alpha images_mask images_masks image_mask \
                            image_masks";
/// Words within the names of other folders of masks.
const MASK_WORDS: [&str; 5] = ["mask", "matte", "matting", "silhouette", "segment"];
/// Words of folders of one split, whose masks may have the names of photographs of another.
const SPLIT_WORDS: [&str; 3] = ["train", "test", "val"];

/// Reads a text file, as [`Error::Input`] if it is not UTF-8.
pub(super) fn read_text(path: &Path) -> Result<String> {
    crate::codec::file::read_text(path, MOST_TEXT, missing_file_help)
}

/// Reads a JSON file; errors name line and column.
pub(super) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_str(&read_text(path)?).map_err(|error| {
        let message = error.to_string();
        let problem = format!("the JSON is wrong: {}", message.split(" at line ").next().unwrap_or_default());
        let help = "Correct the file at that place, or export it again. Numbers must be finite: JSON has no NaN and no Infinity.";
        Error::input(path, format!("line {}, column {}", error.line(), error.column()), problem, help)
    })
}

/// The name of a file, for messages and lookups.
pub fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The last part of a portable path.
fn last(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// A view's name from its image's path: the file name without an image extension (`./train/r_0.5`
/// is called `r_0.5`), be it of a format that is read or of another.
pub(super) fn view_name(path: &str) -> String {
    let path = Path::new(path);
    let is_image = has_extension(path, &IMAGE_EXTENSIONS) || is_unread_name(path);
    let name = if is_image { path.file_stem() } else { path.file_name() };
    name.unwrap_or_default().to_string_lossy().into_owned()
}

/// The name of a view: the path of its image below the folder of images, without extension, as one
/// file name. An absolute path is taken without its root.
pub(super) fn flat_name(path: &str) -> String {
    let folders = Path::new(path).parent().into_iter().flat_map(Path::components);
    let named = folders.filter(|part| !matches!(part, Component::RootDir | Component::Prefix(_)));
    let folders = named.map(|part| format!("{}_", part.as_os_str().to_string_lossy()));
    folders.collect::<String>() + &view_name(path)
}

/// A path in a camera file as this program compares and opens it: Windows' separators and a leading
/// `./` are replaced.
pub(super) fn portable(path: &str) -> String {
    let path = path.replace('\\', "/");
    path.strip_prefix("./").map_or_else(|| path.clone(), str::to_owned)
}

/// A name in the form in which letters with accents are one character each (NFC), as most programs
/// write it; file systems of macOS may have it in another.
fn composed(name: &str) -> Cow<'_, str> {
    if is_nfc(name) { Cow::Borrowed(name) } else { Cow::Owned(name.nfc().collect()) }
}

/// The common part of the paths by which an image may be named: portable, composed and without
/// extension.
pub(super) fn image_key(path: &str) -> String {
    let path = portable(path);
    composed(&Path::new(&path).with_file_name(view_name(&path)).to_string_lossy()).into_owned()
}

/// A portable path, then what is left of it without the first of its folders, without the first
/// two, and so on to the file's name.
pub(super) fn tails(path: &str) -> impl Iterator<Item = &str> {
    std::iter::successors(Some(path), |tail| Some(tail.split_once('/')?.1.trim_start_matches('/')))
}

/// Whether a path in a camera file leads out of the folder that it starts from, by its spelling.
pub(super) fn leads_away(path: &str) -> bool {
    Path::new(path).components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir))
}

/// A name of a file or view between backticks, without control characters, and cut where it is
/// long.
pub(super) fn quoted(name: &str) -> String {
    let shown: String = name.chars().take(LONGEST).flat_map(char::escape_debug).collect();
    format!("`{shown}{}`", if name.chars().nth(LONGEST).is_some() { "…" } else { "" })
}

/// " Near: a, b." of the names that are similar to one; empty if none is.
pub(super) fn near<'a>(name: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    let near: Vec<String> = closest(name, names).into_iter().map(quoted).collect();
    if near.is_empty() { String::new() } else { format!(" Near: {}.", near.join(", ")) }
}

/// Refuses a path with control characters, which a message would pass on.
///
/// # Errors
/// [`Error::Input`] that names the path, the camera file and the place in it.
pub(super) fn check_path(path: &str, camera_file: &Path, place: &str) -> Result<()> {
    path.chars().find(|c| c.is_control()).map_or(Ok(()), |c| {
        let problem = format!("the path {} holds {c:?}, which a path must not", quoted(path));
        Err(Error::input(camera_file, place, problem, "Give the file or its folder another name."))
    })
}

/// Refuses a view's name that files cannot have.
///
/// # Errors
/// [`Error::Input`] that names the view, the camera file and the place in it.
pub(super) fn check_name(name: &str, camera_file: &Path, place: &str) -> Result<()> {
    check_file_name(name).map_err(|problem| {
        let help = "Output files have the view's name: give the image another.";
        Error::input(camera_file, place, format!("the view name {} {problem}", quoted(name)), help)
    })
}

/// Refuses the path of an image that no file or view can have, before it is looked for.
///
/// # Errors
/// As for [`check_path`] and [`check_name`].
pub(super) fn check_image_name(path: &str, camera_file: &Path, place: &str) -> Result<()> {
    check_name(&view_name(path), camera_file, place)?;
    check_path(path, camera_file, place)
}

/// The entries of a folder; none if it cannot be listed.
pub(super) fn entries(folder: &Path) -> impl Iterator<Item = PathBuf> + use<> {
    std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
}

/// A folder's image files in the order of their names; hidden files are none.
pub(super) fn image_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = read_folder(folder)?.map(|entry| Ok(entry.map_err(Error::io("read", folder))?.path()));
    let mut paths = entries.collect::<Result<Vec<_>>>()?;
    paths.retain(|path| has_extension(path, &IMAGE_EXTENSIONS) && !file_name(path).starts_with('.'));
    paths.sort();
    Ok(paths)
}

/// Why the first file of a folder that is named as an image of a format that is not read is not
/// read; of those with this stem, if one is given. `None` if there is no such file.
pub(super) fn refusal_of_unread(folder: &Path, stem: Option<&str>) -> Option<Error> {
    let has_stem = |path: &Path, stem: &str| composed(&view_name(&file_name(path))) == composed(stem);
    let is_wanted = |path: &PathBuf| is_unread_name(path) && stem.is_none_or(|stem| has_stem(path, stem));
    image_header(entries(folder).filter(is_wanted).min()?).err()
}

/// A path that exists and differs from this one at most in the characters that letters with accents
/// are made of.
fn spelled_as_on_disk(path: &Path) -> Option<PathBuf> {
    if is_there(path) || path.as_os_str().is_empty() {
        return Some(path.to_owned());
    }
    let (folder, name) = (spelled_as_on_disk(path.parent()?)?, path.file_name()?.to_str()?);
    entries(&folder).filter(|path| composed(&file_name(path)) == composed(name)).min()
}

/// A folder's image files by name without extension.
pub struct StemIndex {
    /// The folder of the files.
    pub folder: PathBuf,
    /// By composed names; files that are called alike are in the order of their names.
    files: BTreeMap<String, Vec<PathBuf>>,
    /// The first of those whose composed names in lower case are alike.
    in_lower_case: BTreeMap<String, PathBuf>,
}

impl StemIndex {
    /// `None` if there is no such folder.
    pub fn of_folder(folder: &Path) -> Result<Option<Self>> {
        if !is_there(folder) {
            return Ok(None);
        }
        let mut index =
            Self { folder: folder.to_owned(), files: BTreeMap::new(), in_lower_case: BTreeMap::new() };
        for path in image_files(folder)? {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let stem = composed(&stem).into_owned();
            index.in_lower_case.entry(stem.to_lowercase()).or_insert_with(|| path.clone());
            index.files.entry(stem).or_default().push(path);
        }
        Ok(Some(index))
    }

    fn alike(&self, stem: &str) -> &[PathBuf] {
        self.files.get(composed(stem).as_ref()).map_or(&[], Vec::as_slice)
    }

    /// The first image with this file stem, if there is one.
    pub fn stem(&self, stem: &str) -> Option<PathBuf> {
        self.alike(stem).first().cloned()
    }
}

/// Image files below a folder.
pub(super) struct Folders {
    root: PathBuf,
    /// The folders that were looked into, by their paths below the root; `None` where there is
    /// none.
    found: BTreeMap<PathBuf, Option<StemIndex>>,
    /// The photographs that were found.
    used: BTreeSet<PathBuf>,
}

impl Folders {
    pub fn below(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into(), found: BTreeMap::new(), used: BTreeSet::new() }
    }

    /// The folder of the file with this path below the root, as the disk spells it.
    fn folder(&mut self, path: &str) -> Result<Option<&StemIndex>> {
        let below = Path::new(path).parent().unwrap_or(Path::new(""));
        if !self.found.contains_key(below) {
            let folder = spelled_as_on_disk(&self.root.join(below)).filter(|folder| folder.is_dir());
            let index = folder.map(|folder| StemIndex::of_folder(&folder)).transpose()?.flatten();
            self.found.insert(below.to_owned(), index);
        }
        Ok(self.found[below].as_ref())
    }

    /// The photograph with this path below the root, perhaps with another extension, or else with
    /// what is left of the path without some of its folders; and the path that it was found by.
    pub fn find(&mut self, path: &str) -> Option<(String, PathBuf)> {
        let mut inside = tails(path).filter(|tail| *tail == path || !leads_away(tail));
        let found = inside.find_map(|tail| Some((tail.to_owned(), self.image(tail)?)))?;
        self.used.insert(found.1.clone());
        Some(found)
    }

    /// [`Self::find`] with an error for a photograph that is missing.
    pub fn photograph(&mut self, path: &str) -> Result<(String, PathBuf)> {
        self.find(path).ok_or_else(|| {
            let expected = self.root.join(path);
            let folder = expected.parent().unwrap_or(&self.root);
            let problem = "the camera file names this view, but its image is missing (with any extension)";
            refusal_of_unread(folder, Some(&view_name(path)))
                .unwrap_or_else(|| Error::input(&expected, "", problem, missing_file_help(&expected)))
        })
    }

    /// The image with this path below the root, if there is one: itself, else with an extension
    /// added, in the order in which they are tried and small letters first, else the only one of
    /// that name with another extension, as of photographs that were converted.
    pub fn image(&mut self, path: &str) -> Option<PathBuf> {
        let folder = self.folder(path).ok()??;
        let exact = folder.folder.join(last(path));
        // Or something that is called as an image: reading it says why it is none.
        if exact.is_file() || (has_extension(&exact, &IMAGE_EXTENSIONS) && is_there(&exact)) {
            return Some(exact);
        }
        let rank = |file: &&PathBuf| {
            let extension = file.extension().unwrap_or_default().to_string_lossy().into_owned();
            let lower = extension.to_lowercase();
            (extension != lower, IMAGE_EXTENSIONS.iter().position(|known| *known == lower))
        };
        let converted = folder.alike(&view_name(path));
        let is_called = |file: &&PathBuf| composed(&file_name(file)) == composed(last(path));
        let only = || converted.first().filter(|_| converted.len() == 1);
        let longer = folder.alike(last(path)).iter().min_by_key(rank);
        longer.or_else(|| converted.iter().find(is_called)).or_else(only).cloned()
    }

    /// The mask of the photograph with this path below the folder of photographs: folders of masks
    /// are those of photographs, but for some above them.
    pub fn mask(&mut self, photograph: &str) -> Result<PathBuf> {
        for tail in tails(photograph).filter(|tail| !leads_away(tail)) {
            if let Some(mask) = self.folder(tail)?.and_then(|masks| mask_file(masks, last(tail))) {
                return Ok(mask);
            }
        }
        Err(missing_mask(&self.root, last(photograph)))
    }

    /// A note on the photographs, in the folders that were looked into, that were not found for any
    /// view.
    pub fn note_of_unused(&self) -> Option<String> {
        let is_used = |files: &Vec<PathBuf>| files.iter().any(|file| self.used.contains(file));
        let stems = self.found.values().flatten().flat_map(|folder| folder.files.values());
        let extra = stems.filter(|files| !is_used(files)).count();
        let folder = self.root.display();
        (extra > 0).then(|| format!("{extra} images in {folder} have no camera and are left out"))
    }
}

/// The folder of masks in `dir`, or in its folder of photographs, if there is one: of a usual name,
/// or else the only one whose name has a word of masks and none of a split. Case does not count.
pub(super) fn mask_folder(dir: &Path) -> Option<PathBuf> {
    // Of several that differ in case, the one that has the name as it is, or else the first.
    let called = |dir: &Path, name: &str| {
        let exact = dir.join(name);
        let alike = || entries(dir).filter(|path| file_name(path).to_lowercase() == name).min();
        if is_there(&exact) { Some(exact) } else { alike() }
    };
    let first = |dir: &Path, names: &str| names.split(' ').find_map(|name| called(dir, name));
    let above = PHOTOGRAPH_FOLDERS.iter().filter_map(|name| called(dir, name));
    let mut above = above.filter(|folder| folder.is_dir());
    let usual = first(dir, MASK_FOLDERS);
    usual.or_else(|| above.find_map(|folder| first(&folder, "masks mask"))).or_else(|| {
        let has = |path: &Path, words: &[&str]| {
            let name = file_name(path).to_lowercase();
            words.iter().any(|word| name.contains(word))
        };
        let is_one = |path: &PathBuf| path.is_dir() && has(path, &MASK_WORDS) && !has(path, &SPLIT_WORDS);
        let mut others = entries(dir).filter(is_one);
        others.next().filter(|_| others.next().is_none())
    })
}

/// The mask of the photograph with the file name `photograph`, with any image extension. For
/// `a.jpg` the most exact of `a.jpg`, `a`, `a.jpg.mask`, `a.mask`, `a_mask`, `a-mask`, `mask_a` and
/// the like.
///
/// # Errors
/// [`Error::Input`] that names the photograph if there is none.
pub fn find_mask(masks: &StemIndex, photograph: &str) -> Result<PathBuf> {
    mask_file(masks, photograph).ok_or_else(|| missing_mask(&masks.folder, photograph))
}

/// [`find_mask`] without an error. Case counts only where two names differ in nothing else.
pub(super) fn mask_file(masks: &StemIndex, photograph: &str) -> Option<PathBuf> {
    let name = view_name(photograph);
    let mut stems =
        vec![photograph.to_owned(), name.clone(), format!("{photograph}.mask"), format!("{name}.mask")];
    for word in ["mask", "seg", "alpha"] {
        stems.extend([format!("{name}_{word}"), format!("{name}-{word}"), format!("{word}_{name}")]);
    }
    let in_lower_case = |stem: &String| masks.in_lower_case.get(&composed(stem).to_lowercase()).cloned();
    stems.iter().find_map(|stem| masks.stem(stem)).or_else(|| stems.iter().find_map(in_lower_case))
}

fn missing_mask(folder: &Path, photograph: &str) -> Error {
    let name = view_name(photograph);
    let path = folder.join(format!("{name}.png"));
    let problem = format!(
        "the mask of {} is missing; {photograph}.png, {name}_mask.png or mask_{name}.png would also do, with any \
         image extension",
        quoted(photograph)
    );
    Error::input(&path, "", problem, missing_file_help(&path))
}

/// A list of the views of a split.
pub(super) struct SplitList {
    pub file: PathBuf,
    /// `None` for views that are of neither split.
    pub split: Option<Split>,
    /// Images as the list has them, and the place in the file of each.
    pub names: Vec<(String, String)>,
}

/// Whether the split has each of the views with these images, by lists of both; and a note on views
/// that are left out. Without a list of its own the training split has the views of no other list.
///
/// # Errors
/// [`Error::Input`] that names the place of the first image that no view has.
pub(super) fn listed(
    lists: &[SplitList],
    split: Split,
    images: &[&str],
) -> Result<(Vec<bool>, Option<String>)> {
    let keys: Vec<String> = images.iter().map(|image| image_key(image)).collect();
    let known: BTreeSet<&String> = keys.iter().collect();
    let mut named: Vec<(Option<Split>, BTreeSet<String>)> = Vec::new();
    for SplitList { file, split, names } in lists {
        if let Some((name, place)) = names.iter().find(|(name, _)| !known.contains(&image_key(name))) {
            let problem = format!("there is no view with the image {}", quoted(name));
            let near = near(&portable(name), images.iter().copied());
            let help = format!("Write names as the file of the cameras has them, or remove this one.{near}");
            return Err(Error::input(file, place, problem, help));
        }
        named.push((*split, names.iter().map(|(name, _)| image_key(name)).collect()));
    }
    let is_in = |split: Split, key: &String| match named.iter().find(|(of, _)| *of == Some(split)) {
        Some((_, names)) => names.contains(key),
        None => split == Split::Train && !named.iter().any(|(_, names)| names.contains(key)),
    };
    let is_left_out = |key: &String| !is_in(Split::Train, key) && !is_in(Split::Test, key);
    let left_out: Vec<&&str> =
        images.iter().zip(&keys).filter(|(_, key)| is_left_out(key)).map(|(image, _)| image).collect();
    let note = left_out.first().map(|first| {
        let count = left_out.len();
        format!("{count} views that no list of a split has are left out (the first is {})", quoted(first))
    });
    Ok((keys.iter().map(|key| is_in(split, key)).collect(), note))
}
