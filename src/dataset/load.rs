//! Functions that all layouts share: reading JSON with errors that name the position, and finding files.

use crate::codec::file::is_there;
use crate::codec::image::{IMAGE_EXTENSIONS, image_header, is_unread_name};
use crate::codec::nearby::missing_file_help;
use crate::dataset::names::{ImageName, composed, has_image_extension, view_name};
use crate::error::{Error, Result};
use serde::de::DeserializeOwned;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

/// Most bytes of a camera file. COLMAP's text model of a thousand views has some hundred MiB.
const MOST_TEXT: u64 = 2 << 30;

/// Reads a text file, as [`Error::Input`] if it is not UTF-8.
pub(super) fn read_text(path: &Path) -> Result<String> {
    crate::codec::file::read_text(path, MOST_TEXT, missing_file_help)
}

/// Parses JSON; errors name line and column.
pub(super) fn parse_json<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T> {
    serde_json::from_str(text).map_err(|error| {
        let (line, column) = (error.line(), error.column());
        let message = error.to_string();
        let message = message.split(" at line ").next().unwrap_or_default();
        let line_text = text.lines().nth(line.saturating_sub(1)).unwrap_or_default();
        let near = |word: &str| column_window(line_text, column).contains(word);
        let (problem, help) = if error.is_syntax() && (near("NaN") || near("nfinity")) {
            (
                "a number is NaN or infinite, which JSON does not have".to_owned(),
                "Correct the camera: all its numbers must be finite.",
            )
        } else {
            (format!("the JSON is wrong: {message}"), "Correct the file at that place, or export it again.")
        };
        Error::input(path, format!("line {line}, column {column}"), problem, help)
    })
}

/// The text around a (1-based, byte) column.
fn column_window(line: &str, column: usize) -> String {
    let start = column.saturating_sub(3).min(line.len());
    let bytes = &line.as_bytes()[start..];
    String::from_utf8_lossy(&bytes[..bytes.len().min(12)]).into_owned()
}

/// The name of a file, for messages and lookups.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The file itself if it exists, else with an image extension added, else the same of a path whose letters with accents are made of other
/// characters, else the only image of another format with that stem. What is called as an image and is none, or may not be read, is found as
/// well: reading it says why.
pub(super) fn find_image(path: &Path) -> Option<PathBuf> {
    find_spelled(path).or_else(|| {
        let (folder, name) = (spelled_as_on_disk(path.parent()?)?, path.file_name()?.to_str()?);
        let of_folder = || find_spelled(&folder.join(name));
        let of_twins = || twins(&folder, name, true).find_map(|twin| find_spelled(&twin));
        of_folder().or_else(of_twins).or_else(|| find_converted(&folder.join(name)))
    })
}

/// A path that exists and differs from this one at most in the characters that letters with accents are made of.
pub(super) fn spelled_as_on_disk(path: &Path) -> Option<PathBuf> {
    if is_there(path) || path.as_os_str().is_empty() {
        return Some(path.to_owned());
    }
    let folder = spelled_as_on_disk(path.parent()?)?;
    twins(&folder, path.file_name()?.to_str()?, false).next()
}

/// The entries of a folder called as `name` but for the characters that letters with accents are made of, also with an image extension
/// added if `or_longer`; by name. A name without such letters has none.
fn twins(folder: &Path, name: &str, or_longer: bool) -> impl Iterator<Item = PathBuf> + use<> {
    let wanted = composed(name).into_owned();
    let entries = (!name.is_ascii()).then(|| std::fs::read_dir(folder).ok()).flatten();
    let is_twin = |path: &PathBuf| {
        let found = file_name(path);
        let found = composed(&found);
        found == wanted || (or_longer && has_image_extension(path) && view_name(&found) == wanted)
    };
    let mut found: Vec<PathBuf> =
        entries.into_iter().flatten().flatten().map(|entry| entry.path()).filter(is_twin).collect();
    found.sort();
    found.into_iter()
}

/// [`find_image`] of exactly this path.
fn find_spelled(path: &Path) -> Option<PathBuf> {
    if path.is_file() || (has_image_extension(path) && is_there(path)) {
        return Some(path.to_owned());
    }
    let with = |extension: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(format!(".{extension}"));
        Some(PathBuf::from(name)).filter(|candidate| candidate.is_file())
    };
    let in_capitals = || IMAGE_EXTENSIONS.iter().find_map(|extension| with(&extension.to_uppercase()));
    IMAGE_EXTENSIONS.iter().find_map(|extension| with(extension)).or_else(in_capitals)
}

/// The only image with the stem of `path`, which is named with the extension of an image that is not there: photographs that were converted.
fn find_converted(path: &Path) -> Option<PathBuf> {
    if !has_image_extension(path) {
        return None;
    }
    let stem = path.file_stem()?;
    let mut alike =
        image_files(path.parent()?).ok()?.into_iter().filter(|file| file.file_stem() == Some(stem));
    alike.next().filter(|_| alike.next().is_none())
}

/// A folder's image files in the order of their names; hidden files are none.
pub(super) fn image_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for entry in crate::codec::file::read_folder(folder)? {
        paths.push(entry.map_err(Error::io("read", folder))?.path());
    }
    let is_hidden =
        |path: &Path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
    paths.retain(|path| has_image_extension(path) && !is_hidden(path));
    paths.sort();
    Ok(paths)
}

/// Whether a folder can be listed and has image files, or files that `is_other` takes for such.
pub(super) fn has_images(folder: &Path, is_other: fn(&Path) -> bool) -> bool {
    let mut entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    image_files(folder).is_ok_and(|files| !files.is_empty()) || entries.any(|path| is_other(&path))
}

/// Why the first file of a folder that is named as an image of a format that is not read is not read; of those with this stem, if one
/// is given. `None` if there is no such file.
pub(super) fn refusal_of_unread(folder: &Path, stem: Option<&str>) -> Option<Error> {
    let is_wanted = |path: &PathBuf| {
        let has_stem = |stem: &str| {
            path.file_stem().is_some_and(|found| composed(&found.to_string_lossy()) == composed(stem))
        };
        is_unread_name(path) && stem.is_none_or(has_stem)
    };
    let entries = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    image_header(entries.filter(is_wanted).min()?).err()
}

/// Whether a path in a camera file leads out of the folder that it starts from, by its spelling.
pub(super) fn leads_away(path: &str) -> bool {
    let is_up = |part| !matches!(part, Component::Normal(_) | Component::CurDir);
    Path::new(path).components().any(is_up)
}

/// A folder's image files by name without extension.
pub(super) struct StemIndex {
    pub folder: PathBuf,
    /// Whether files in it may be opened to say why one is missing.
    pub explains: bool,
    files: BTreeMap<String, PathBuf>,
    /// The same by composed names, where these are others.
    composed: BTreeMap<String, PathBuf>,
    /// The same by composed names in lower case, the first of those that differ only in case.
    in_lower_case: BTreeMap<String, PathBuf>,
}

impl StemIndex {
    /// `None` if there is no such folder.
    pub fn of_folder(folder: &Path) -> Result<Option<Self>> {
        if !is_there(folder) {
            return Ok(None);
        }
        let [mut files, mut others, mut in_lower_case] = [const { BTreeMap::new() }; 3];
        for path in image_files(folder)? {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            in_lower_case.entry(composed(&stem).to_lowercase()).or_insert_with(|| path.clone());
            if let Cow::Owned(stem) = composed(&stem) {
                others.entry(stem).or_insert_with(|| path.clone());
            }
            files.entry(stem).or_insert(path);
        }
        let (folder, explains) = (folder.to_owned(), true);
        Ok(Some(Self { folder, explains, files, composed: others, in_lower_case }))
    }

    /// The image with this name, with or without the folders in it, or another one with its stem. One of a format that is not read is
    /// refused here, before its mask is looked for.
    pub fn find(&self, name: ImageName) -> Result<PathBuf> {
        let name = name.as_str();
        let path = self.folder.join(name);
        for name in [name, &file_name(Path::new(name))] {
            let Some(exact) = self.exact(name) else { continue };
            if self.explains && !leads_away(name) && is_unread_name(&exact) {
                image_header(&exact)?;
            }
            return Ok(exact);
        }
        self.stem(&view_name(name)).ok_or_else(|| {
            let problem = "the camera file names this view, but its image is missing (with any extension)";
            let refusal = || refusal_of_unread(&self.folder, Some(&view_name(name)));
            self.explains
                .then(refusal)
                .flatten()
                .unwrap_or_else(|| Error::input(&path, "", problem, missing_file_help(&path)))
        })
    }

    /// Whether there is an image with this file name, or another one with its stem.
    pub fn has(&self, name: &str) -> bool {
        self.exact(name).is_some() || self.stem(&view_name(name)).is_some()
    }

    /// The file with this path below the folder, if there is one.
    pub fn exact(&self, path: &str) -> Option<PathBuf> {
        Some(self.folder.join(path))
            .filter(|path| path.is_file() || (has_image_extension(path) && is_there(path)))
    }

    /// The image with this file stem, if there is one; with that very one, or else with one that is shown alike.
    pub fn stem(&self, stem: &str) -> Option<PathBuf> {
        let alike = || {
            let stem = composed(stem);
            self.files.get(stem.as_ref()).or_else(|| self.composed.get(stem.as_ref()))
        };
        self.files.get(stem).or_else(alike).cloned()
    }

    /// The image with this file stem in lower case, if there is one, whatever its case.
    pub fn stem_in_lower_case(&self, stem: &str) -> Option<PathBuf> {
        self.in_lower_case.get(composed(stem).as_ref()).cloned()
    }

    /// The file stems as they are on disk.
    pub fn stems(&self) -> impl Iterator<Item = &str> {
        self.files.keys().map(String::as_str)
    }
}
