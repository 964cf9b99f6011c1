//! Where each value of a scene file stands in its text.
//!
//! RON text is read into a light tree of byte ranges, with no types. It serves two ends: the caret of an error
//! about a value (`material.specular.roughness`), and `--set path=value`, which replaces a value's text before
//! the file is read as usual.
//!
//! A path is a list of steps joined by dots. A step is a field's name, an index of a list or tuple, the `name`
//! of a list's item, or (where no item has that name) the only item of that kind: `passes.novel.render.exposure`,
//! `passes.fit.rates.light`. Wrappers such as `Fixed(Map(scale: 2))` are looked through: `light.scale`.

use crate::scene::ron_tree::{Body, Node, parse};
use std::ops::Range;

/// Where a path leads.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Location {
    /// Bytes of the value; of what comes nearest if the path leads to nothing in the text.
    pub span: Range<usize>,
    /// Whether the value itself is in the text.
    pub exact: bool,
}

/// Finds where `path` stands; an empty path is the whole value.
pub(crate) fn locate(root: &Node, text: &str, path: &str) -> Location {
    let mut node = root;
    for step in path.split('.').filter(|step| !step.is_empty()) {
        match node.step(text, step) {
            Some(next) => node = next,
            None => return Location { span: node.handle(text), exact: false },
        }
    }
    Location { span: node.handle(text), exact: true }
}

/// Replaces the value at `path` by `value`, or inserts it where its struct lacks the field.
///
/// Where a string is replaced, `value` may be given without quotes. Returns the new text.
///
/// # Errors
/// A sentence and a help text, if the text or the value is not RON, or the path leads nowhere.
pub fn set(text: &str, path: &str, value: &str) -> Result<String, (String, String)> {
    let root = parse(text).map_err(|_| ("the scene file is not valid RON".to_owned(), String::new()))?;
    let steps: Vec<&str> = path.split('.').collect();
    if path.is_empty() || steps.iter().any(|step| step.is_empty()) {
        return Err((
            format!("`{path}` is not a path"),
            "Join names by dots, e.g. `passes.fit.steps=4`.".to_owned(),
        ));
    }
    let mut node = &root;
    for (depth, step) in steps.iter().enumerate() {
        match node.step(text, step) {
            Some(next) => node = next,
            None => return insert(text, node.inner(), &steps, depth, value),
        }
    }
    let value = match &node.body {
        Body::Text(_) if !value.trim_start().starts_with(['"', 'r']) => format!("{value:?}"),
        Body::Text(_) if parse(value).is_err() => format!("{value:?}"),
        _ => checked(value)?.to_owned(),
    };
    Ok(splice(text, node.span.clone(), &value))
}

fn checked(value: &str) -> Result<&str, (String, String)> {
    match parse(value) {
        Ok(_) => Ok(value),
        Err(error) => Err((
            format!("`{value}` is not a RON value: expected {}", error.expected),
            "Examples: 0.25, \"text\" (quoted, also for the shell: --set 'name=\"text\"'), (0.8, 0.1, 0.1), Fixed(0.3)."
                .to_owned(),
        )),
    }
}

fn insert(
    text: &str,
    node: &Node,
    steps: &[&str],
    depth: usize,
    value: &str,
) -> Result<String, (String, String)> {
    let here = if depth == 0 { "the scene".to_owned() } else { format!("`{}`", steps[..depth].join(".")) };
    let is_name = |step: &&str| step.starts_with(|c: char| c.is_alphabetic() || c == '_');
    let Body::Fields(fields) = &node.body else {
        return Err((format!("{here} has no `{}`", steps[depth]), what_is_there(text, node)));
    };
    if let Some(step) = steps[depth..].iter().find(|step| !is_name(step)) {
        return Err((format!("{here} has no `{step}`"), what_is_there(text, node)));
    }
    let (last, outer) = (steps.len() - 1, &steps[depth..]);
    let mut inserted = format!("{}: {}", steps[last], checked(value)?);
    for step in outer[..outer.len() - 1].iter().rev() {
        inserted = format!("{step}: ({inserted})");
    }
    match fields.last() {
        Some(field) => {
            let end = field.value.span.end;
            Ok(splice(text, end..end, &format!(", {inserted}")))
        }
        None => Ok(splice(text, node.span.end - 1..node.span.end - 1, &inserted)),
    }
}

fn what_is_there(text: &str, node: &Node) -> String {
    match &node.body {
        Body::Items(items) => {
            let name = |item: &Node| match item.field(text, "name").map(|name| &name.body) {
                Some(Body::Text(range)) => Some(text[range.clone()].to_owned()),
                _ if item.body == Body::Plain => None,
                _ => item.name(text).map(str::to_ascii_lowercase),
            };
            let names: Vec<String> = items.iter().filter_map(name).collect();
            match (items.len(), names.is_empty()) {
                (0, _) => "The list is empty.".to_owned(),
                (n, true) => format!("It has items 0 to {}.", n - 1),
                (_, false) => format!("It has: {}.", names.join(", ")),
            }
        }
        Body::Plain | Body::Text(_) => format!("It is `{}`, which has no parts.", &text[node.span.clone()]),
        Body::Fields(_) | Body::Map(_) => String::new(),
    }
}

fn splice(text: &str, range: Range<usize>, new: &str) -> String {
    format!("{}{new}{}", &text[..range.start], &text[range.end..])
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r##"#![enable(implicit_some)]
// a scene, "with" (brackets
Scene(
    version: 1, /* nested /* ( */ comment */
    light: Fixed(Map(path: "a \"b\" ) c", scale: 2.0)),
    material: (specular: (roughness: Unknown(initial: 0.4))),
    odd: (r#"raw " ) string"#, 'x', '\'', b"by\"te", -1.5e-3, true),
    passes: [
        Fit(steps: 3),
        Render(name: "novel", render: ()),
        Render(name: "orbit", render: (exposure: 0.5,)),
    ],
    table: {"k": 1, 2: [3]},
)
"##;

    fn at(path: &str) -> (String, bool) {
        let found = locate(&parse(TEXT).unwrap(), TEXT, path);
        (TEXT[found.span].to_owned(), found.exact)
    }

    #[test]
    fn paths_lead_to_their_text() {
        assert_eq!(at("version"), ("1".into(), true));
        assert_eq!(at("light.scale"), ("2.0".into(), true));
        assert_eq!(at("light.path"), (r#""a \"b\" ) c""#.into(), true));
        assert_eq!(at("material.specular.roughness.initial"), ("0.4".into(), true));
        assert_eq!(at("odd.0"), (r##"r#"raw " ) string"#"##.into(), true));
        assert_eq!(at("odd.4"), ("-1.5e-3".into(), true));
        assert_eq!(at("passes.fit.steps"), ("3".into(), true));
        assert_eq!(at("passes.2.render.exposure"), ("0.5".into(), true));
        assert_eq!(at("passes.orbit.render.exposure"), ("0.5".into(), true));
        assert_eq!(at("table.k"), ("1".into(), true));
    }

    #[test]
    fn a_missing_value_is_shown_where_it_would_be() {
        assert_eq!(at("passes.novel.render.exposure"), ("()".into(), false));
        assert_eq!(at("passes.nothing"), ("[".into(), false));
        assert_eq!(at("seed"), ("Scene".into(), false));
        // Two passes are a `Render`, so that kind names none of them.
        assert!(!at("passes.render").1);
    }

    #[test]
    fn set_replaces_and_inserts() {
        let check = |path: &str, value: &str, has: &str| {
            let new = set(TEXT, path, value).unwrap();
            assert!(new.contains(has), "{new}");
            parse(&new).unwrap();
            let found = locate(&parse(&new).unwrap(), &new, path);
            assert!(found.exact);
        };
        check("version", "2", "version: 2, /*");
        check("light.path", "b.exr", r#"Map(path: "b.exr", scale"#);
        check("light.path", "\"c.exr\"", r#"Map(path: "c.exr", scale"#);
        check("light.path", "rgb.exr", r#"Map(path: "rgb.exr", scale"#);
        check("passes.novel.render.exposure", "1.5", "render: (exposure: 1.5)");
        check("passes.orbit.render.tone", "Filmic", "exposure: 0.5, tone: Filmic,)");
        check("passes.fit.rates.light", "0", "Fit(steps: 3, rates: (light: 0))");
        check("seed", "7", "[3]}, seed: 7,");
    }

    #[test]
    fn set_refuses_what_leads_nowhere() {
        let refused = |path: &str, value: &str| set(TEXT, path, value).unwrap_err();
        assert!(refused("passes.missing.name", "1").1.contains("fit, novel, orbit"));
        assert!(refused("version.major", "1").1.contains("`1`"));
        assert!(refused("odd.9", "1").1.contains("0 to 5"));
        assert!(refused("version", "(1").0.contains("closing `)`"));
        assert!(refused("version", "1, seed: 2").0.contains("not a RON value"));
        assert!(refused("", "1").0.contains("not a path"));
    }
}
