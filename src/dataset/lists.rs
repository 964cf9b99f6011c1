//! Lists of the views of each split beside a COLMAP model, as Stanford-ORB has them: `train_id.txt` and `test_id.txt`, a name a line.
//!
//! Names are those of the model, with or without extension. A list of test views gives the test split, and the training split is that of
//! the other list, or all other views. With a list of training views alone there are no other views, and
//! [`crate::dataset::DatasetOptions::hold_out`] makes the test split.

use crate::codec::file::{MOST_TEXT, is_there, read_text};
use crate::codec::nearby::{closest, missing_file_help};
use crate::dataset::names::{composed, portable, quoted, shown, view_name};
use crate::dataset::plan::split_name;
use crate::error::{Error, Result};
use crate::view::Split;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The file that lists the views of a split.
fn list_file(dir: &Path, split: Split) -> PathBuf {
    dir.join(format!("{}_id.txt", split_name(split)))
}

/// Whether the folder has a list of test views.
pub(super) fn has_test_list(dir: &Path) -> bool {
    is_there(&list_file(dir, Split::Test))
}

/// The names of one list.
struct List {
    file: PathBuf,
    /// Names as [`key`] has them, with the first of their lines as it stands, and its number.
    lines: BTreeMap<String, (String, usize)>,
}

/// The lists of a folder.
pub(super) struct Lists {
    train: Option<List>,
    test: Option<List>,
}

impl Lists {
    /// # Errors
    /// [`Error::Input`] if a list cannot be read, has no names, or has a name that the other has, too.
    pub fn read(dir: &Path) -> Result<Self> {
        let [train, test] = [Split::Train, Split::Test].map(|split| List::read(list_file(dir, split)));
        let lists = Self { train: train?, test: test? };
        lists.refuse_shared().map(|()| lists)
    }

    /// Refuses names that none of `names` is, and lists that leave no view to train.
    ///
    /// # Errors
    /// [`Error::Input`] that names file and line.
    pub fn check(&self, names: &[&str]) -> Result<()> {
        let known: BTreeMap<String, &str> = names.iter().map(|name| (key(name), *name)).collect();
        for list in [&self.train, &self.test].into_iter().flatten() {
            list.refuse_unknown(&known)?;
        }
        match &self.test {
            Some(test) if !names.iter().any(|name| self.contains(Split::Train, name)) => {
                let problem = "it lists all views, so that none is left for the training split";
                let help = "Leave out some lines, or remove the file: `hold_out` then makes a test split.";
                Err(Error::input(&test.file, "", problem, help))
            }
            _ => Ok(()),
        }
    }

    /// Whether the split has the view with this name.
    pub fn contains(&self, split: Split, name: &str) -> bool {
        let is_in = |list: &List| list.lines.contains_key(&key(name));
        match (split, &self.train, &self.test) {
            (Split::Train, Some(train), _) => is_in(train),
            (Split::Train, None, test) => !test.as_ref().is_some_and(is_in),
            (Split::Test, _, test) => test.as_ref().is_some_and(is_in),
        }
    }

    /// A note on those of `names` that are in no split.
    pub fn note_of_unlisted(&self, names: &[&str]) -> Option<String> {
        let is_listed =
            |name: &str| [Split::Train, Split::Test].iter().any(|split| self.contains(*split, name));
        let mut unlisted = names.iter().filter(|name| !is_listed(name));
        let first = unlisted.next()?;
        // Without a list of training views, the training split has all that the other list has not.
        let files = match &self.test {
            Some(_) => "neither train_id.txt nor test_id.txt has",
            None => "train_id.txt does not have",
        };
        Some(format!(
            "{} views that {files} are left out (the first is {})",
            unlisted.count() + 1,
            quoted(first)
        ))
    }

    fn refuse_shared(&self) -> Result<()> {
        let (Some(train), Some(test)) = (&self.train, &self.test) else { return Ok(()) };
        let shared = test.lines.iter().filter(|(key, _)| train.lines.contains_key(*key));
        shared.min_by_key(|(_, (_, line))| *line).map_or(Ok(()), |(key, (name, line))| {
            let (_, other) = &train.lines[key];
            let problem = format!("{} is in train_id.txt as well, line {other}", quoted(name));
            let help = "A view belongs to one split: remove one of the lines.";
            Err(Error::input(&test.file, format!("line {line}"), problem, help))
        })
    }
}

impl List {
    /// `None` if there is no such file.
    fn read(file: PathBuf) -> Result<Option<Self>> {
        if !is_there(&file) {
            return Ok(None);
        }
        let text = read_text(&file, MOST_TEXT, missing_file_help)?;
        let mut lines = BTreeMap::new();
        for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let name = line.trim();
            lines.entry(key(name)).or_insert_with(|| (name.to_owned(), number + 1));
        }
        if lines.is_empty() {
            let help = "Write a name of the model in each line, or remove the file.";
            return Err(Error::input(&file, "", "the list has no names of views", help));
        }
        Ok(Some(Self { file, lines }))
    }

    fn refuse_unknown(&self, known: &BTreeMap<String, &str>) -> Result<()> {
        let unknown = self.lines.iter().filter(|(key, _)| !known.contains_key(*key));
        let Some((_, (name, line))) = unknown.min_by_key(|(_, (_, line))| *line) else { return Ok(()) };
        let near: Vec<String> =
            closest(name, known.values().copied()).iter().map(|near| shown(near)).collect();
        let near = if near.is_empty() { String::new() } else { format!(" Near: {}.", near.join(", ")) };
        let problem = format!("the model has no image {}", quoted(name));
        let help = format!("Write names as the model has them, or remove the line.{near}");
        Err(Error::input(&self.file, format!("line {line}"), problem, help))
    }
}

/// What two names of the same image have in common: photographs are found by their names without extension.
fn key(name: &str) -> String {
    let name = portable(name);
    composed(&Path::new(&name).with_file_name(view_name(&name)).to_string_lossy()).into_owned()
}
