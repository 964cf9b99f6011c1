//! Checks of single values, each of which says where the value is and what was expected there, and the files that a scene names.

use crate::scene::{diagnostic::Problem, load::LoadOptions};
use glam::Vec3;
use lobelia_geometry::mesh::MAX_COORDINATE;
use lobelia_io::codec::{file::FileKind, file::Obstacle, file::obstacle, nearby::missing_file_help};
use std::{cell::RefCell, fmt::Display, ops::RangeInclusive, path::Path, path::PathBuf};

/// Least roughness: below it the specular lobe is sharper than `f32` can hold.
pub const MIN_ROUGHNESS: f32 = 0.03;
/// Least field of view, in degrees: a hundred times narrower than any telephoto lens.
const MIN_FOV_DEGREES: f32 = 0.001;

/// Problems and files of a scene.
#[derive(Default)]
pub(in crate::scene) struct Found {
    /// Every value that makes no sense.
    pub problems: Vec<Problem>,
    /// Files and folders that are there, without repeats, in the order of the scene file.
    pub files: Vec<PathBuf>,
    /// Paths below `$DATA`, which stands for nothing.
    pub unseen: Vec<PathBuf>,
}

/// A place in the scene file: a struct, list or choice whose values are checked by their names there.
#[derive(Clone)]
pub(super) struct Place<'a> {
    /// Steps joined by dots, as [`Node::locate`](crate::scene::ron_tree::Node::locate) reads them.
    path: String,
    /// The folder of the scene file.
    base_dir: &'a Path,
    options: &'a LoadOptions,
    found: &'a RefCell<Found>,
}

impl<'a> Place<'a> {
    /// The whole scene.
    pub fn new(base_dir: &'a Path, options: &'a LoadOptions, found: &'a RefCell<Found>) -> Self {
        Self { path: String::new(), base_dir, options, found }
    }

    /// The place of a field, or of an item by its index.
    pub fn at(&self, step: impl Display) -> Self {
        let path = if self.path.is_empty() { step.to_string() } else { format!("{}.{step}", self.path) };
        Self { path, ..self.clone() }
    }

    /// The place of the whole scene.
    pub fn root(&self) -> Self {
        Self { path: String::new(), ..self.clone() }
    }

    /// Adds a problem with this place.
    pub fn fail(&self, problem: impl Into<String>, expected: impl Into<String>, help: impl Into<String>) {
        let (path, problem) = (self.path.clone(), problem.into());
        let problem = Problem { path, problem, expected: expected.into(), help: help.into() };
        self.found.borrow_mut().problems.push(problem);
    }

    pub fn require(&self, ok: bool, field: &str, found: impl Display, expected: &str) {
        if !ok {
            let at = self.at(field);
            // The last step that is a word.
            let name = at.path.rsplit('.').find(|step| step.starts_with(|c: char| c.is_alphabetic()));
            at.fail(format!("{} is {found}", name.unwrap_or("it")), format!("expected {expected}"), "");
        }
    }

    /// A number in `range`; NaN is in none.
    pub fn number(&self, field: &str, value: f32, range: RangeInclusive<f32>) {
        let expected = format!("a number from {} to {}", range.start(), range.end());
        self.require(range.contains(&value), field, value, &expected);
    }

    /// A finite number above 0.
    pub fn positive(&self, field: &str, value: f32) {
        self.require(value > 0.0 && value.is_finite(), field, value, "a number above 0");
    }

    /// A finite number not below 0.
    pub fn not_negative(&self, field: &str, value: f32) {
        self.require(value >= 0.0 && value.is_finite(), field, value, "a number not below 0");
    }

    /// A whole number in `range`.
    pub fn count(&self, field: &str, value: u32, range: RangeInclusive<u32>) {
        let expected = match *range.end() {
            u32::MAX => format!("a whole number from {}", range.start()),
            end => format!("a whole number from {} to {end}", range.start()),
        };
        self.require(range.contains(&value), field, value, &expected);
    }

    /// A list of 1 to `most` items.
    pub fn length<T>(&self, field: &str, list: &[T], most: usize) {
        self.count(field, u32::try_from(list.len()).unwrap_or(u32::MAX), 1..=most as u32);
    }

    /// Three finite numbers.
    pub fn finite(&self, field: &str, value: Vec3) {
        self.require(value.is_finite(), field, value, "finite numbers");
    }

    /// A finite vector that is not zero.
    pub fn direction(&self, field: &str, value: Vec3) {
        let ok = value.is_finite() && value.length_squared().is_normal();
        self.require(ok, field, value, "a direction: finite, not (0, 0, 0)");
    }

    /// A point that a surface may be at.
    pub fn point(&self, field: &str, value: Vec3) {
        let ok = value.abs().max_element() <= MAX_COORDINATE && value.is_finite();
        self.require(ok, field, value, &format!("three numbers, none beyond {MAX_COORDINATE:e}"));
    }

    /// Three numbers from 0 to `most`.
    pub fn channels(&self, field: &str, value: Vec3, most: f32) {
        let ok = value.to_array().iter().all(|channel| (0.0..=most).contains(channel));
        let most = if most > 1.0 { format!("{most:e}") } else { most.to_string() };
        self.require(ok, field, value, &format!("three numbers from 0 to {most}"));
    }

    /// A color with channels in [0, 1].
    pub fn color(&self, field: &str, value: Vec3) {
        self.channels(field, value, 1.0);
    }

    /// Three finite numbers not below 0.
    pub fn factors(&self, field: &str, value: Vec3) {
        let ok = value.is_finite() && value.min_element() >= 0.0;
        self.require(ok, field, value, "three numbers not below 0");
    }

    pub fn roughness(&self, field: &str, value: f32) {
        self.number(field, value, MIN_ROUGHNESS..=1.0);
    }

    /// A distance of cameras from what they look at.
    pub fn distance(&self, field: &str, value: f32) {
        let expected = format!("a number above 0, at most {MAX_COORDINATE:e}");
        self.require(value > 0.0 && value <= MAX_COORDINATE, field, value, &expected);
    }

    /// A field of view.
    pub fn fov(&self, value: f32) {
        self.number("fov_degrees", value, MIN_FOV_DEGREES..=170.0);
    }

    /// An image's width or height.
    pub fn pixels(&self, field: &str, value: u32) {
        self.count(field, value, 1..=16384);
    }

    /// A name that can be a file's, and that no other of its `kind` has.
    pub fn name(&self, name: &str, kind: &str, is_taken: bool, help: &str) {
        let fits = (1..=100).contains(&name.len());
        let ok = fits && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
        self.require(ok, "name", format_args!("{name:?}"), "1 to 100 letters, digits, `_` and `-`");
        if is_taken {
            let problem = format!("two {kind} are called {name:?} (case does not count)");
            self.at("name").fail(problem, "expected another name", help);
        }
    }

    /// Resolves a path in place and looks for what is there: `$DATA/…` starts at `--data` and is left as it is without; other relative
    /// paths start at the folder of the scene file.
    pub fn path(&self, field: &str, kind: FileKind, path: &mut PathBuf) {
        let at = self.at(field);
        let full = match (path.strip_prefix("$DATA"), &self.options.data) {
            (Err(_), _) => self.base_dir.join(&path),
            (Ok(rest), Some(data)) if rest.as_os_str().is_empty() => data.clone(),
            (Ok(rest), Some(data)) => data.join(rest),
            (Ok(_), None) => {
                // One report stands for every `$DATA/…`: they have the same remedy.
                if self.found.borrow().unseen.is_empty() && !self.options.without_data {
                    let expected = "expected --data to say what $DATA is";
                    let help = "Give the folder on the command line: --data DIR.";
                    at.fail("$DATA stands for nothing here", expected, help);
                }
                if !self.found.borrow().unseen.contains(path) {
                    self.found.borrow_mut().unseen.push(path.clone());
                }
                return;
            }
        };
        if let Some((problem, help)) = complaint(&full, kind) {
            let expected = if kind == FileKind::File { "expected a file" } else { "expected a folder" };
            at.fail(problem, expected, help);
        } else if !self.found.borrow().files.contains(&full) {
            self.found.borrow_mut().files.push(full.clone());
        }
        *path = full;
    }

    pub fn file(&self, field: &str, path: &mut PathBuf) {
        self.path(field, FileKind::File, path);
    }

    pub fn folder(&self, field: &str, path: &mut PathBuf) {
        self.path(field, FileKind::Folder, path);
    }
}

fn complaint(path: &Path, kind: FileKind) -> Option<(String, String)> {
    let Obstacle { problem, help } = obstacle(path, kind)?;
    let help = match kind {
        _ if !help.is_empty() => help,
        FileKind::File if path.is_dir() => "Name a file in it.".into(),
        FileKind::Folder if path.is_file() => "Name the folder that it is in.".into(),
        _ => missing_file_help(path),
    };
    Some((format!("{}: {problem}", path.display()), help))
}
