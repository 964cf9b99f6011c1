//! What the command line adds to a scene file: `--set path=value` on its text; and the values of a
//! scene file of any version by their paths.

use crate::scene::ron_tree::{Body, Node, parse};
use std::{ops::Range, path::PathBuf};

/// Additions of the command line to a scene file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadOptions {
    /// Folder that `$DATA` stands for.
    pub data: Option<PathBuf>,
    /// `--set` values in order: path and RON text.
    pub sets: Vec<(String, String)>,
    /// Replaces the scene's seed.
    pub seed: Option<u64>,
    /// Without `data`, leave `$DATA/…` as it is and do not look for it, instead of refusing the
    /// scene: such a scene can be checked but not run.
    pub without_data: bool,
}

/// A sentence and a help text.
type Refusal = (String, String);

/// Replaces the value at `path` by `value`, or inserts it where its struct lacks the field.
///
/// Where a string is replaced, `value` may be given without quotes. Returns the new text.
///
/// # Errors
/// A sentence and a help text, if the text or the value is not RON, or the path leads nowhere.
pub fn set(text: &str, path: &str, value: &str) -> Result<String, Refusal> {
    let root = parse(text).map_err(|_| ("the scene file is not valid RON".to_owned(), String::new()))?;
    let steps: Vec<&str> = path.split('.').collect();
    if steps.contains(&"") {
        let help = "Join names by dots, e.g. `passes.fit.steps=4`.";
        return Err((format!("`{path}` is not a path"), help.to_owned()));
    }
    let mut node = &root;
    for (depth, step) in steps.iter().enumerate() {
        match node.step(text, step) {
            Some(next) => node = next,
            None => return insert(text, node.inner(), &steps, depth, value),
        }
    }
    let is_text = matches!(node.body, Body::Text(_));
    let is_quoted = value.trim_start().starts_with(['"', 'r']) && parse(value).is_ok();
    let value = if is_text && !is_quoted { format!("{value:?}") } else { checked(value)?.to_owned() };
    Ok(splice(text, node.span.clone(), &value))
}

fn checked(value: &str) -> Result<&str, Refusal> {
    let help = "Examples: 0.25, \"text\" (quoted, also for the shell: --set 'name=\"text\"'), (0.8, 0.1, 0.1), Fixed(0.3).";
    parse(value).map(|_| value).map_err(|error| {
        (format!("`{value}` is not a RON value: expected {}", error.expected), help.to_owned())
    })
}

/// Inserts the value of a path of which `node` has the first `depth` steps.
fn insert(text: &str, node: &Node, steps: &[&str], depth: usize, value: &str) -> Result<String, Refusal> {
    let is_name = |step: &str| step.starts_with(|c: char| c.is_alphabetic() || c == '_');
    let missing = match &node.body {
        Body::Fields(_) => steps[depth..].iter().find(|step| !is_name(step)),
        _ => Some(&steps[depth]),
    };
    if let Some(missing) = missing {
        let at = if depth == 0 { "the scene".to_owned() } else { format!("`{}`", steps[..depth].join(".")) };
        return Err((format!("{at} has no `{missing}`"), what_is_there(text, node)));
    }
    let [outer @ .., last] = &steps[depth..] else { return Ok(text.to_owned()) };
    let last = format!("{last}: {}", checked(value)?);
    let inserted = outer.iter().rev().fold(last, |inside, step| format!("{step}: ({inside})"));
    match &node.body {
        Body::Fields(fields) if !fields.is_empty() => {
            let end = fields[fields.len() - 1].1.span.end;
            Ok(splice(text, end..end, &format!(", {inserted}")))
        }
        _ => Ok(splice(text, node.span.end - 1..node.span.end - 1, &inserted)),
    }
}

fn what_is_there(text: &str, node: &Node) -> String {
    match &node.body {
        Body::Items(items) if items.is_empty() => "The list is empty.".to_owned(),
        Body::Items(items) => {
            let is_plain = |item: &Node| item.body == Body::Plain;
            let names: Vec<String> =
                items.iter().filter(|of| !is_plain(of)).filter_map(|of| label(of, text)).collect();
            match names.is_empty() {
                true => format!("It has items 0 to {}.", items.len() - 1),
                false => format!("It has: {}.", names.join(", ")),
            }
        }
        Body::Plain | Body::Text(_) => format!("It is `{}`, which has no parts.", &text[node.span.clone()]),
        Body::Fields(_) => String::new(),
    }
}

/// The name of a list's item, else its kind: how a path calls it, if no other is called so.
fn label(item: &Node, text: &str) -> Option<String> {
    let kind = || item.name(text).map(str::to_ascii_lowercase);
    item.own_name(text).map(str::to_owned).or_else(kind)
}

fn splice(text: &str, range: Range<usize>, new: &str) -> String {
    format!("{}{new}{}", &text[..range.start], &text[range.end..])
}

/// The values in the text with their paths, as `--set` writes these; nothing if it is not RON. Only
/// what the text says is there: defaults are not. A list of numbers is one value.
pub fn fields(text: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    if let Ok(root) = parse(text) {
        walk(&root, text, "", &mut found);
    }
    found
}

fn walk(node: &Node, text: &str, path: &str, found: &mut Vec<(String, String)>) {
    let joined = |step: &str| if path.is_empty() { step.to_owned() } else { format!("{path}.{step}") };
    let is_plain = |node: &Node| matches!(node.body, Body::Plain | Body::Text(_));
    let inner = node.inner();
    match &inner.body {
        Body::Fields(fields) => {
            let named = kinds(node, inner, text);
            if !named.is_empty() && !path.is_empty() {
                found.push((path.to_owned(), named));
            }
            for (name, value) in fields {
                walk(value, text, &joined(&text[name.clone()]), found);
            }
        }
        Body::Items(items) if inner.name.is_none() && !items.iter().all(is_plain) => {
            let labels: Vec<Option<String>> = items.iter().map(|item| label(item, text)).collect();
            for (i, item) in items.iter().enumerate() {
                let is_only = labels.iter().filter(|label| **label == labels[i]).count() == 1;
                let step = labels[i].clone().filter(|_| is_only).unwrap_or_else(|| i.to_string());
                walk(item, text, &joined(&step), found);
            }
        }
        _ => {
            let words: Vec<&str> = text[node.span.clone()].split_whitespace().collect();
            found.push((path.to_owned(), words.join(" ")));
        }
    }
}

/// The names of wrappers from `node` to `inner`: "Fixed(Map)".
fn kinds(node: &Node, inner: &Node, text: &str) -> String {
    let own = node.name(text).unwrap_or_default();
    match &node.body {
        Body::Items(of) if !std::ptr::eq(node, inner) => format!("{own}({})", kinds(&of[0], inner, text)),
        _ => own.to_owned(),
    }
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
    odd: (r#"raw " ) string"#, "by\"te", -1.5e-3, true),
    passes: [
        Fit(steps: 3),
        Render(name: "novel", render: ()),
        Render(name: "orbit", render: (exposure: 0.5,)),
    ],
)
"##;

    fn at(path: &str) -> (String, bool) {
        let (span, is_exact) = parse(TEXT).unwrap().locate(TEXT, path);
        (TEXT[span].to_owned(), is_exact)
    }

    #[test]
    fn paths_lead_to_their_text() {
        assert_eq!(at("version"), ("1".into(), true));
        assert_eq!(at("light.scale"), ("2.0".into(), true));
        assert_eq!(at("light.path"), (r#""a \"b\" ) c""#.into(), true));
        assert_eq!(at("material.specular.roughness.initial"), ("0.4".into(), true));
        assert_eq!(at("odd.0"), (r##"r#"raw " ) string"#"##.into(), true));
        assert_eq!(at("odd.2"), ("-1.5e-3".into(), true));
        assert_eq!(at("passes.fit.steps"), ("3".into(), true));
        assert_eq!(at("passes.2.render.exposure"), ("0.5".into(), true));
        assert_eq!(at("passes.orbit.render.exposure"), ("0.5".into(), true));
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
            assert!(parse(&new).unwrap().locate(&new, path).1);
        };
        check("version", "2", "version: 2, /*");
        check("light.path", "b.exr", r#"Map(path: "b.exr", scale"#);
        check("light.path", "\"c.exr\"", r#"Map(path: "c.exr", scale"#);
        check("light.path", "rgb.exr", r#"Map(path: "rgb.exr", scale"#);
        check("passes.novel.render.exposure", "1.5", "render: (exposure: 1.5)");
        check("passes.orbit.render.tone", "Filmic", "exposure: 0.5, tone: Filmic,)");
        check("passes.fit.rates.light", "0", "Fit(steps: 3, rates: (light: 0))");
        check("seed", "7", "], seed: 7,");
    }

    #[test]
    fn set_refuses_what_leads_nowhere() {
        let refused = |path: &str, value: &str| set(TEXT, path, value).unwrap_err();
        assert!(refused("passes.missing.name", "1").1.contains("fit, novel, orbit"));
        assert!(refused("version.major", "1").1.contains("`1`"));
        assert!(refused("odd.9", "1").1.contains("0 to 3"));
        assert!(refused("version", "(1").0.contains("closing `)`"));
        assert!(refused("version", "1, seed: 2").0.contains("not a RON value"));
        assert!(refused("", "1").0.contains("not a path"));
    }

    #[test]
    fn values_have_the_paths_of_set() {
        let text = r#"// a scene
Scene(
    version: 1,
    surface: Sphere(radius: 0.9),
    light: Fixed(Map(path: "sky.exr", scale: 4)),
    material: (specular: (albedo: Fixed(0.3,
        0.2, 0.1))),
    passes: [
        Fit(steps: 5),
        Render(name: "novel", render: (views: Named(["a", "b"]))),
        Save(), Save(),
    ],
)"#;
        let found: Vec<_> = fields(text).iter().map(|(path, value)| format!("{path} = {value}")).collect();
        let expected = [
            "version = 1",
            "surface = Sphere",
            "surface.radius = 0.9",
            "light = Fixed(Map)",
            "light.path = \"sky.exr\"",
            "light.scale = 4",
            "material.specular.albedo = Fixed(0.3, 0.2, 0.1)",
            "passes.fit = Fit",
            "passes.fit.steps = 5",
            "passes.novel = Render",
            "passes.novel.name = \"novel\"",
            "passes.novel.render.views = Named([\"a\", \"b\"])",
            "passes.2 = Save",
            "passes.3 = Save",
        ];
        assert_eq!(found, expected);
        assert!(fields("Scene(").is_empty() && fields("").is_empty());
    }
}
