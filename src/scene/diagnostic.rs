//! Errors of scene files: where in the text, what was expected there, and help.

use crate::scene::ron_tree::{Body, Node, SyntaxError};
use lobelia_geometry::error::{Error, Fault, Label, SceneDiagnostic};
use lobelia_io::codec::nearby::closest;
use ron::error::{Error as Ron, Position, SpannedError};
use std::{ops::Range, path::Path, sync::Arc};

/// A value of a scene file that is of the right type and yet wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// Where: steps joined by dots, as [`Node::locate`] reads them.
    pub path: String,
    /// The problem, e.g. "roughness is 0".
    pub problem: String,
    /// The expectation there; stands beside the caret.
    pub expected: String,
    /// The remedy; may be empty.
    pub help: String,
}

/// A scene file's text and name, for messages.
pub struct SceneText<'a> {
    /// The file.
    pub path: &'a Path,
    /// Its text, with `--set` applied.
    pub text: &'a str,
    /// Whether `--set` changed the text.
    pub edited: bool,
}

impl SceneText<'_> {
    /// The finished error, which says once that the text is not quite the file's.
    fn error(&self, faults: Vec<Fault>) -> Error {
        let note = if self.edited { "The text shown has the --set values in it." } else { "" };
        Error::Scene(Arc::new(SceneDiagnostic {
            name: self.path.display().to_string(),
            text: self.text.to_owned(),
            faults,
            note: note.to_owned(),
        }))
    }

    /// Text that is not RON.
    pub fn syntax(&self, error: &SyntaxError) -> Error {
        let expected = format!("expected {}", error.expected);
        let message = format!("this is not a valid scene file: {expected}");
        let mut fault = fault(message, error.at.clone(), expected, "");
        if let Some(open) = &error.open {
            fault.labels.push(Label { at: open.clone(), text: "opened here".into() });
        }
        self.error(vec![fault])
    }

    /// Values that are wrong, all at once.
    pub fn problems(&self, root: Option<&Node>, problems: Vec<Problem>) -> Error {
        let place = |path: &str| root.map_or(0..0, |root| root.locate(self.text, path).0);
        let mut faults: Vec<_> =
            problems.into_iter().map(|p| fault(p.problem, place(&p.path), p.expected, &p.help)).collect();
        faults.sort_by_key(|fault| fault.labels[0].at.start);
        self.error(faults)
    }

    /// RON that does not have the scene's shape.
    pub fn shape(&self, root: &Node, error: &SpannedError) -> Error {
        let at = self.offset(error.span.start)..self.offset(error.span.end);
        let within = |outer: &Option<String>| outer.as_ref().map_or(String::new(), |of| format!(" in {of}"));
        let fault = match &error.code {
            Ron::NoSuchStructField { expected, found, outer } => fault(
                format!("unknown field `{found}`{}", within(outer)),
                self.word_before(found, at.end),
                "not a field here",
                &choices("fields", found, expected),
            ),
            Ron::NoSuchEnumVariant { expected, found, outer } => fault(
                format!("unknown choice `{found}`{}", within(outer)),
                self.word_before(found, at.end),
                "not one of the choices here",
                &choices("choices", found, expected),
            ),
            Ron::MissingStructField { field, outer } => fault(
                format!("missing field `{field}`{}", within(outer)),
                root.innermost(at.start, |body| matches!(body, Body::Fields(_))).handle(self.text),
                format!("expected `{field}` in here"),
                &format!("Add `{field}: …`."),
            ),
            Ron::DuplicateStructField { field, outer } => fault(
                format!("field `{field}` is given twice{}", within(outer)),
                self.word_before(field, at.end),
                "second time",
                "Remove one of the two.",
            ),
            Ron::ExpectedDifferentLength { expected, found } => {
                let is_list = |body: &Body| matches!(body, Body::Fields(_) | Body::Items(_));
                let node = root.innermost(at.start.saturating_sub(1), is_list);
                let expected = if expected.contains("3 f32") { "three numbers" } else { expected.as_str() };
                let expected = format!("expected {expected}");
                fault(format!("{expected}, found {found}"), node.handle(self.text), expected, "")
            }
            other => {
                let node = self.value_at(root, &at);
                let (expected, help) = self.explain(other, node);
                let place = node.handle(self.text);
                let found = &self.text[place.clone()];
                fault(format!("{expected}, found `{found}`"), place, expected, &help)
            }
        };
        self.error(vec![fault])
    }

    /// Byte offset of a line and column counted from 1 in characters.
    fn offset(&self, position: Position) -> usize {
        let lines = self.text.split_inclusive('\n').take(position.line.saturating_sub(1));
        let start: usize = lines.map(str::len).sum();
        let rest = &self.text[start..];
        start + rest.char_indices().nth(position.col.saturating_sub(1)).map_or(rest.len(), |(at, _)| at)
    }

    fn word_before(&self, word: &str, end: usize) -> Range<usize> {
        let end = (end + word.len()).min(self.text.len());
        let head = self.text.get(..end).unwrap_or(self.text);
        head.rfind(word).map_or(end..end, |start| start..start + word.len())
    }

    /// The value that an error's range is about: it begins in the range, or ends just before it.
    fn value_at<'a>(&self, root: &'a Node, at: &Range<usize>) -> &'a Node {
        let blank = self.text[at.clone()].len() - self.text[at.clone()].trim_start().len();
        let node = root.innermost(at.start + blank, |_| true);
        let before = self.text[..at.start].trim_end().len().saturating_sub(1);
        let ends_before = root.innermost(before, |_| true);
        if node.span.start >= at.start || ends_before.span.len() > node.span.len() {
            node
        } else {
            ends_before
        }
    }

    /// What a value that is not of its type should be, and the remedy.
    fn explain(&self, error: &Ron, node: &Node) -> (String, String) {
        let (name, text) = (node.name(self.text).unwrap_or_default(), &self.text[node.span.clone()]);
        let (expected, help) = match error {
            Ron::ExpectedStructLike | Ron::ExpectedNamedStructLike(_) if !name.is_empty() => {
                let help = format!("Write `{name}()` to take every default.");
                return (format!("expected `(` after `{name}`"), help);
            }
            // A choice without fields is read up to its bracket.
            Ron::ExpectedComma if !name.is_empty() && !matches!(node.body, Body::Plain | Body::Text(_)) => {
                return (format!("expected `{name}` alone, which has no fields"), String::new());
            }
            Ron::ExpectedFloat | Ron::ExpectedInteger if text.starts_with('(') => {
                ("a number", "A color in a choice has one pair of brackets: `Constant(0.5, 0.5, 0.5)`.")
            }
            Ron::ExpectedFloat => ("a number", ""),
            Ron::ExpectedInteger => ("a whole number", ""),
            // An integer is read up to its decimal point, and then a comma is missed.
            Ron::ExpectedComma if text.parse::<f64>().is_ok() => ("a whole number", ""),
            Ron::IntegerOutOfBounds => ("a whole number in range", ""),
            Ron::ExpectedString => ("a string in quotes", ""),
            Ron::ExpectedBoolean => ("true or false", ""),
            Ron::InvalidValueForType { expected, .. } => (expected.as_str(), ""),
            other => {
                let text = other.to_string();
                let mut rest = text.chars();
                let first = rest.next().into_iter().flat_map(char::to_lowercase);
                return (first.chain(rest).collect(), String::new());
            }
        };
        (format!("expected {expected}"), help.to_owned())
    }
}

/// A fault of one place; `help` may be empty. Messages quote the text, which may have lines of any
/// length.
fn fault(message: String, at: Range<usize>, label: impl Into<String>, help: &str) -> Fault {
    let labels = vec![Label { at, text: shortened(label.into(), 200) }];
    Fault { message: shortened(message, 300), labels, help: shortened(help.to_owned(), 2000) }
}

/// The text, without its middle if it has more than `most` characters.
fn shortened(text: String, most: usize) -> String {
    let count = text.chars().count();
    if count <= most {
        return text;
    }
    let (head, tail) = (text.chars().take(most * 2 / 3), text.chars().skip(count - most / 6));
    head.chain(" … ".chars()).chain(tail).collect()
}

/// "Did you mean `x`? The fields are: …"; for a word that scene files once had, what to do instead.
fn choices(kind: &str, found: &str, expected: &[&str]) -> String {
    let instead = match found {
        "denoise" => {
            "Noise is removed by other programs: EXR frames have the albedo and normals that OIDN takes. "
        }
        "format" if expected.contains(&"fps") => {
            "Leave it out: frames are PNG files in orbit_frames/, and the film is an MP4 by `ffmpeg`, or a GIF. "
        }
        "Ply" | "Obj" => "Convert `mesh.glb` in Blender, or by `assimp export mesh.glb mesh.obj`. ",
        _ => "",
    };
    let all = expected.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    let near = closest(found, expected.iter().copied());
    let near = near.first().map_or(String::new(), |name| format!("Did you mean `{name}`? "));
    format!("{instead}{near}The {kind} are: {all}.")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_count_characters() {
        let text = SceneText { path: Path::new("x"), text: "é(\nü: 1)\n", edited: false };
        let offset = |line, col| text.offset(ron::error::Position { line, col });
        assert_eq!((offset(1, 1), offset(1, 2), offset(2, 2), offset(2, 5), offset(9, 9)), (0, 2, 6, 9, 11));
    }
}
