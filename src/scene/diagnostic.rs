//! Errors of scene files: where in the text, what was expected there, and help.

use crate::error::{Error, Fault, Label, SceneDiagnostic};
use crate::scene::ron_tree::{Body, Node, SyntaxError};
use crate::scene::source;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// A value of a scene file that is of the right type and yet wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// Where: steps joined by dots, as `locate` reads them.
    pub path: String,
    /// What is wrong, e.g. "roughness is 0".
    pub problem: String,
    /// What was expected there; stands beside the caret.
    pub expected: String,
    /// What to do about it; may be empty.
    pub help: String,
}

/// A scene file's text and name, for messages.
pub(crate) struct SceneText<'a> {
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
        let message = format!("this is not a valid scene file: expected {}", error.expected);
        let label = format!("expected {}", error.expected);
        let mut fault = one(message, error.at.clone(), label, String::new());
        if let Some(open) = &error.open {
            fault.labels.push(Label { at: open.clone(), text: "opened here".into() });
        }
        self.error(vec![fault])
    }

    /// Values that are wrong, all at once.
    pub fn problems(&self, root: Option<&Node>, problems: Vec<Problem>) -> Error {
        let place = |path: &str| root.map_or(0..0, |root| source::locate(root, self.text, path).span);
        let mut faults: Vec<Fault> =
            problems.into_iter().map(|p| one(p.problem, place(&p.path), p.expected, p.help)).collect();
        faults.sort_by_key(|fault| fault.labels[0].at.start);
        self.error(faults)
    }

    /// RON that does not have the scene's shape.
    pub fn shape(&self, root: &Node, error: &ron::error::SpannedError) -> Error {
        let at = self.offset(error.span.start)..self.offset(error.span.end);
        let fault = self.fault_of_name(root, &error.code, &at);
        self.error(vec![fault.unwrap_or_else(|| self.fault_of_value(root, &error.code, &at))])
    }

    /// A field or a choice that is unknown, missing or given twice; `None` for any other error.
    fn fault_of_name(&self, root: &Node, error: &ron::error::Error, at: &Range<usize>) -> Option<Fault> {
        use ron::error::Error as Ron;
        Some(match error {
            Ron::NoSuchStructField { expected, found, outer } => one(
                format!("unknown field `{found}`{}", within(outer)),
                self.field_before(root, found, at.end),
                "not a field here".to_owned(),
                fields_help(found, expected),
            ),
            Ron::NoSuchEnumVariant { expected, found, outer } => one(
                format!("unknown choice `{found}`{}", within(outer)),
                self.word_before(found, at.end),
                "not one of the choices here".to_owned(),
                choices("choices", found, expected),
            ),
            Ron::MissingStructField { field, outer } => one(
                format!("missing field `{field}`{}", within(outer)),
                struct_at(root, at.start).handle(self.text),
                format!("expected `{field}` in here"),
                format!("Add `{field}: …`."),
            ),
            Ron::DuplicateStructField { field, outer } => one(
                format!("field `{field}` is given twice{}", within(outer)),
                self.field_before(root, field, at.end),
                "second time".to_owned(),
                "Remove one of the two.".to_owned(),
            ),
            _ => return None,
        })
    }

    /// A value that is not what is expected in its place.
    fn fault_of_value(&self, root: &Node, error: &ron::error::Error, at: &Range<usize>) -> Fault {
        if let ron::error::Error::ExpectedDifferentLength { expected, found } = error {
            let node = with_parts(root, at.start.saturating_sub(1));
            let expected = match expected.contains("3 f32") {
                true => "expected three numbers".to_owned(),
                false => format!("expected {expected}"),
            };
            return one(
                format!("{expected}, found {found}"),
                node.handle(self.text),
                expected,
                String::new(),
            );
        }
        let node = self.value_at(root, at.start, at.end);
        let (expected, help) = self.explain(error, node);
        let found = &self.text[node.handle(self.text)];
        one(format!("{expected}, found `{found}`"), node.handle(self.text), expected, help)
    }

    /// Byte offset of a line and column counted from 1 in characters.
    fn offset(&self, position: ron::error::Position) -> usize {
        let line_start = if position.line <= 1 {
            0
        } else {
            let mut ends = self.text.match_indices('\n').map(|(at, _)| at + 1);
            ends.nth(position.line - 2).unwrap_or(self.text.len())
        };
        let rest = &self.text[line_start..];
        line_start + rest.char_indices().nth(position.col.saturating_sub(1)).map_or(rest.len(), |(at, _)| at)
    }

    fn field_before(&self, root: &Node, name: &str, end: usize) -> Range<usize> {
        let same = |range: &Range<usize>| &self.text[range.clone()] == name && range.start <= end;
        root.field_names().into_iter().filter(same).max_by_key(|range| range.start).unwrap_or(end..end)
    }

    fn word_before(&self, word: &str, end: usize) -> Range<usize> {
        let end = (end + word.len()).min(self.text.len());
        let head = self.text.get(..end).unwrap_or(self.text);
        head.rfind(word).map_or(end..end, |start| start..start + word.len())
    }

    /// The value that an error's range is about: it begins in the range, or ends just before it.
    fn value_at<'a>(&self, root: &'a Node, start: usize, end: usize) -> &'a Node {
        let blank = self.text[start..end].len() - self.text[start..end].trim_start().len();
        let node = root.innermost(start + blank);
        let ends_before = root.innermost(self.text[..start].trim_end().len().saturating_sub(1));
        if node.span.start >= start || ends_before.span.len() > node.span.len() { node } else { ends_before }
    }

    fn explain(&self, error: &ron::error::Error, node: &Node) -> (String, String) {
        use ron::error::Error as Ron;
        let name = node.name(self.text).unwrap_or_default();
        match error {
            Ron::ExpectedStructLike | Ron::ExpectedNamedStructLike(_) if !name.is_empty() => {
                (format!("expected `(` after `{name}`"), format!("Write `{name}()` to take every default."))
            }
            Ron::InvalidValueForType { expected, .. } => (format!("expected {expected}"), String::new()),
            Ron::ExpectedFloat | Ron::ExpectedInteger if self.text[node.span.clone()].starts_with('(') => (
                "expected a number".into(),
                "A color in a choice has one pair of brackets: `Constant(0.5, 0.5, 0.5)`.".into(),
            ),
            Ron::ExpectedFloat => ("expected a number".into(), String::new()),
            // An integer is read up to its decimal point, and then a comma is missed.
            Ron::ExpectedComma if self.text[node.span.clone()].parse::<f64>().is_ok() => {
                ("expected a whole number".into(), String::new())
            }
            // A choice without fields is read up to its bracket.
            Ron::ExpectedComma if !name.is_empty() && !matches!(node.body, Body::Plain | Body::Text(_)) => {
                let help = if node.field(self.text, "denoise").is_some() { DENOISE_HELP } else { "" };
                (format!("expected `{name}` alone, which has no fields"), help.to_owned())
            }
            Ron::ExpectedInteger => ("expected a whole number".into(), String::new()),
            Ron::IntegerOutOfBounds => ("expected a whole number in range".into(), String::new()),
            Ron::ExpectedString => ("expected a string in quotes".into(), String::new()),
            Ron::ExpectedBoolean => ("expected true or false".into(), String::new()),
            other => (lower_first(&other.to_string()), String::new()),
        }
    }
}

/// A fault of one place; `help` may be empty. Messages quote the text, which may have lines of any length.
fn one(message: String, at: Range<usize>, label: String, help: String) -> Fault {
    let labels = vec![Label { at, text: shortened(label, 200) }];
    Fault { message: shortened(message, 300), labels, help: shortened(help, 2000) }
}

/// The text, without its middle if it has more than `most` characters.
fn shortened(text: String, most: usize) -> String {
    let count = text.chars().count();
    if count <= most {
        return text;
    }
    let (head, tail) = (most * 2 / 3, most / 6);
    let middle = text.char_indices().nth(head).map_or(text.len(), |(at, _)| at);
    let end = text.char_indices().nth(count - tail).map_or(text.len(), |(at, _)| at);
    format!("{} … {}", &text[..middle], &text[end..])
}

/// The innermost struct or choice with fields around `at`.
fn struct_at(node: &Node, at: usize) -> &Node {
    innermost(node, at, |body| matches!(body, Body::Fields(_)))
}

/// The innermost value with parts around `at`.
fn with_parts(node: &Node, at: usize) -> &Node {
    innermost(node, at, |body| matches!(body, Body::Fields(_) | Body::Items(_)))
}

fn innermost(root: &Node, at: usize, wanted: impl Fn(&Body) -> bool) -> &Node {
    let (mut best, mut here) = (root, Some(root));
    while let Some(node) = here {
        if wanted(&node.body) {
            best = node;
        }
        here = node.children().into_iter().find(|child| child.span.start <= at && at < child.span.end);
    }
    best
}

fn within(outer: &Option<String>) -> String {
    outer.as_ref().map_or_else(String::new, |outer| format!(" in {outer}"))
}

fn lower_first(text: &str) -> String {
    let mut chars = text.chars();
    chars.next().map_or_else(String::new, |first| first.to_lowercase().chain(chars).collect())
}

/// Where `denoise` belongs.
const DENOISE_HELP: &str = "Only path tracing has noise: `shading: PathTraced(spp: 16, denoise: true)`.";

/// What to do about an unknown field. One that belongs elsewhere says where.
fn fields_help(found: &str, expected: &[&str]) -> String {
    let fields = choices("fields", found, expected);
    if found == "denoise" {
        return format!("{DENOISE_HELP} {fields}");
    }
    fields
}

/// "Did you mean `x`? The fields are: …"
fn choices(kind: &str, found: &str, expected: &[&str]) -> String {
    let all = expected.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    match nearest(found, expected.iter().copied()) {
        Some(name) => format!("Did you mean `{name}`? The {kind} are: {all}."),
        None => format!("The {kind} are: {all}."),
    }
}

/// The candidate with the fewest changed letters, if that is at most a third of them (rounded up).
pub fn nearest<'a>(found: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // No name is so long, and comparing takes time in proportion to the length.
    if found.len() > 1000 {
        return None;
    }
    let found_lower = found.to_lowercase();
    let limit = found.chars().count().div_ceil(3);
    candidates
        .into_iter()
        .map(|candidate| (distance(&found_lower, &candidate.to_lowercase()), candidate))
        .filter(|(distance, _)| *distance <= limit)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}

/// Levenshtein distance in characters.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_finds_slips_and_leaves_strangers() {
        assert_eq!(nearest("rougness", ["albedo", "roughness"]), Some("roughness"));
        assert_eq!(nearest("published", ["Published", "PathTraced"]), Some("Published"));
        assert_eq!(nearest("colour", ["path", "scale"]), None);
        assert_eq!((distance("kitten", "sitting"), distance("", "ab"), distance("ab", "")), (3, 2, 2));
    }

    #[test]
    fn long_texts_lose_their_middle() {
        assert_eq!(shortened("fine".into(), 4), "fine");
        let short = shortened(format!("unknown field `{}é`", "ü".repeat(65_536)), 300);
        assert!(short.starts_with("unknown field `üü") && short.ends_with("üé`"), "{short}");
        assert_eq!(short.chars().count(), 200 + 3 + 50);
        assert_eq!(nearest(&"x".repeat(1001), ["x"]), None);
    }

    #[test]
    fn offsets_count_characters() {
        let text = SceneText { path: Path::new("x"), text: "é(\nü: 1)\n", edited: false };
        let offset = |line, col| text.offset(ron::error::Position { line, col });
        assert_eq!((offset(1, 1), offset(1, 2), offset(2, 2), offset(2, 5), offset(9, 9)), (0, 2, 6, 9, 11));
    }
}
