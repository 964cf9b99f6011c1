//! Checks of single values, each of which says where the value is and what was expected there.

use crate::mesh::MAX_COORDINATE;
use crate::scene::diagnostic::Problem;
use glam::Vec3;
use std::ops::RangeInclusive;

/// Least roughness: below it the specular lobe is sharper than `f32` can hold.
pub const MIN_ROUGHNESS: f32 = 0.03;

/// Least field of view, in degrees: a hundred times narrower than any telephoto lens.
const MIN_FOV_DEGREES: f32 = 0.001;

/// The problems found so far, and the common kinds of checks. A `path` is where a value is in the scene file.
pub(super) struct Checks {
    pub(super) problems: Vec<Problem>,
}

impl Checks {
    pub(super) fn fail(
        &mut self,
        path: &str,
        problem: impl Into<String>,
        expected: impl Into<String>,
        help: impl Into<String>,
    ) {
        self.problems.push(Problem {
            path: path.to_owned(),
            problem: problem.into(),
            expected: expected.into(),
            help: help.into(),
        });
    }

    pub(super) fn require(&mut self, ok: bool, path: &str, found: impl std::fmt::Display, expected: &str) {
        if !ok {
            self.fail(path, format!("{} is {found}", last_word(path)), format!("expected {expected}"), "");
        }
    }

    /// A number in `range`; NaN is in none.
    pub(super) fn number(&mut self, path: &str, value: f32, range: RangeInclusive<f32>) {
        let expected = format!("a number from {} to {}", range.start(), range.end());
        self.require(range.contains(&value), path, value, &expected);
    }

    /// A finite number above 0.
    pub(super) fn positive(&mut self, path: &str, value: f32) {
        self.require(value > 0.0 && value.is_finite(), path, value, "a number above 0");
    }

    /// A finite number not below 0.
    pub(super) fn not_negative(&mut self, path: &str, value: f32) {
        self.require(value >= 0.0 && value.is_finite(), path, value, "a number not below 0");
    }

    /// A whole number in `range`.
    pub(super) fn count(&mut self, path: &str, value: u32, range: RangeInclusive<u32>) {
        let expected = match *range.end() {
            u32::MAX => format!("a whole number from {}", range.start()),
            end => format!("a whole number from {} to {end}", range.start()),
        };
        self.require(range.contains(&value), path, value, &expected);
    }

    /// Three finite numbers.
    pub(super) fn finite(&mut self, path: &str, value: Vec3) {
        self.require(value.is_finite(), path, value, "finite numbers");
    }

    /// A finite vector that is not zero.
    pub(super) fn direction(&mut self, path: &str, value: Vec3) {
        let ok = value.is_finite() && value.length_squared().is_normal();
        self.require(ok, path, value, "a direction: finite, not (0, 0, 0)");
    }

    /// A point that a surface may be at.
    pub(super) fn place(&mut self, path: &str, value: Vec3) {
        let ok = value.abs().max_element() <= MAX_COORDINATE && value.is_finite();
        self.require(ok, path, value, &format!("three numbers, none beyond {MAX_COORDINATE:e}"));
    }

    /// A color with channels in [0, 1].
    pub(super) fn color(&mut self, path: &str, value: Vec3) {
        let ok = value.to_array().iter().all(|channel| (0.0..=1.0).contains(channel));
        self.require(ok, path, value, "three numbers from 0 to 1");
    }

    /// Three finite numbers not below 0.
    pub(super) fn factors(&mut self, path: &str, value: Vec3) {
        let ok = value.is_finite() && value.min_element() >= 0.0;
        self.require(ok, path, value, "three numbers not below 0");
    }

    /// A roughness.
    pub(super) fn roughness(&mut self, path: &str, value: f32) {
        self.number(path, value, MIN_ROUGHNESS..=1.0);
    }

    /// A distance of cameras from what they look at.
    pub(super) fn distance(&mut self, path: &str, value: f32) {
        let expected = format!("a number above 0, at most {MAX_COORDINATE:e}");
        self.require(value > 0.0 && value <= MAX_COORDINATE, path, value, &expected);
    }

    /// A field of view.
    pub(super) fn fov(&mut self, path: &str, value: f32) {
        self.number(path, value, MIN_FOV_DEGREES..=170.0);
    }

    /// An image's width or height.
    pub(super) fn pixels(&mut self, path: &str, value: u32) {
        self.count(path, value, 1..=16384);
    }

    /// A name that can be a file's.
    pub(super) fn name(&mut self, path: &str, value: &str) {
        let fits = (1..=100).contains(&value.len());
        let ok = fits && value.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
        self.require(ok, path, format_args!("{value:?}"), "1 to 100 letters, digits, `_` and `-`");
    }
}

/// The last step of a path that is a word.
fn last_word(path: &str) -> &str {
    path.rsplit('.').find(|step| step.starts_with(|c: char| c.is_alphabetic())).unwrap_or(path)
}
