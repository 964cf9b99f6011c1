//! Names of images, and of the views after which output files are called.

use crate::codec::file::check_file_name;
use crate::codec::image::{IMAGE_EXTENSIONS, is_unread_name};
use crate::dataset::plan::ViewPlan;
use crate::error::{Error, Result};
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;
use unicode_normalization::{UnicodeNormalization, is_nfc};

/// Names that folders of photographs usually have, in lower case, the most usual first: COLMAP takes any.
pub(super) const PHOTOGRAPH_FOLDERS: [&str; 8] =
    ["images", "image", "input", "rgb", "photos", "photographs", "pictures", "imgs"];
/// Most characters of a name in a message.
const LONGEST: usize = 60;

/// Whether a path ends as images that are read do, in any case.
pub(super) fn has_image_extension(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
    extension.is_some_and(|extension| IMAGE_EXTENSIONS.contains(&extension.as_str()))
}

/// A view's name from its image's path: the file name without an image extension (`./train/r_0.5` is called `r_0.5`), be it of a format
/// that is read or of another.
pub(super) fn view_name(path: &str) -> String {
    let path = Path::new(path);
    let is_image = has_image_extension(path) || is_unread_name(path);
    let name = if is_image { path.file_stem() } else { path.file_name() };
    name.unwrap_or_default().to_string_lossy().into_owned()
}

/// A path in a camera file as this program compares and opens it: Windows' separators and a leading `./` are replaced.
pub(super) fn portable(path: &str) -> String {
    let path = path.replace('\\', "/");
    path.strip_prefix("./").map_or_else(|| path.clone(), str::to_owned)
}

/// A name in the form in which letters with accents are one character each (NFC), as most programs write it; file systems of macOS may
/// have it in another.
pub(super) fn composed(name: &str) -> Cow<'_, str> {
    if is_nfc(name) { Cow::Borrowed(name) } else { Cow::Owned(name.nfc().collect()) }
}

/// A portable path, then what is left of it without the first of its folders, without the first two, and so on to the file's name.
pub(super) fn tails(path: &str) -> impl Iterator<Item = &str> {
    std::iter::successors(Some(path), |tail| Some(tail.split_once('/')?.1.trim_start_matches('/')))
}

/// A name of a file or view between backticks, without control characters, and cut where it is long.
pub(super) fn quoted(name: &str) -> String {
    format!("`{}`", shown(name))
}

/// [`quoted`] without backticks.
pub(super) fn shown(name: &str) -> String {
    let shown: String = name.chars().take(LONGEST).flat_map(char::escape_debug).collect();
    if name.chars().nth(LONGEST).is_some() { shown + "…" } else { shown }
}

/// The path of an image as a camera file has it, which a file and a view can have. Files are looked up by nothing else, so that no name
/// is looked for, or told, before it is checked.
#[derive(Clone, Copy, Debug)]
pub(super) struct ImageName<'a>(&'a str);

impl<'a> ImageName<'a> {
    /// # Errors
    /// [`Error::Input`] that names the view or path, the camera file and the place in it.
    pub fn new(path: &'a str, camera_file: &Path, place: &str) -> Result<Self> {
        check_name(&view_name(path), camera_file, place)?;
        check_path(path, camera_file, place).map(|()| Self(path))
    }

    /// The name without its folders.
    pub fn last(self) -> Self {
        Self(Path::new(self.0).file_name().and_then(|name| name.to_str()).unwrap_or_default())
    }

    pub fn as_str(self) -> &'a str {
        self.0
    }
}

/// Refuses a path with control characters, which a message would pass on.
///
/// # Errors
/// [`Error::Input`] that names the path, the camera file and the place in it.
pub(super) fn check_path(path: &str, camera_file: &Path, place: &str) -> Result<()> {
    match path.chars().find(|c| c.is_control()) {
        None => Ok(()),
        Some(c) => {
            let problem = format!("the path {} holds {c:?}, which a path must not", quoted(path));
            Err(Error::input(camera_file, place, problem, "Give the file or its folder another name."))
        }
    }
}

/// Refuses a view's name that files cannot have.
///
/// # Errors
/// [`Error::Input`] that names the view, the camera file and the place in it.
fn check_name(name: &str, camera_file: &Path, place: &str) -> Result<()> {
    check_file_name(name).map_err(|problem| {
        let help = "Output files have the view's name: give the image another.";
        Error::input(camera_file, place, format!("the view name {} {problem}", quoted(name)), help)
    })
}

/// Refuses names that files cannot have, and names that two views have. Names that differ only in case give a note: some file
/// systems take them for the same.
///
/// # Errors
/// [`Error::Input`] that names the view, the camera file and the place in it.
pub(super) fn check_names(plans: &[ViewPlan]) -> Result<Vec<String>> {
    let wrong = |plan: &ViewPlan, problem: String, help: &str| {
        Error::input(&plan.camera_file, &plan.place, problem, help)
    };
    let (mut seen, mut notes) = (HashMap::new(), Vec::new());
    for plan in plans {
        check_name(&plan.name, &plan.camera_file, &plan.place)?;
        match seen.insert(plan.name.to_lowercase(), plan) {
            Some(other) if other.name == plan.name => {
                let problem = format!("two views are called `{}`; the other is {}", plan.name, other.place);
                let help =
                    "Output files have the view's name: remove one, or give the images different names.";
                return Err(wrong(plan, problem, help));
            }
            Some(other) => notes.push(format!(
                "the views {} and {} differ only in case: where both are rendered, the files of one get a number",
                other.name, plan.name
            )),
            None => {}
        }
    }
    Ok(notes)
}
