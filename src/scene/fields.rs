//! The values of a scene file, each by its path: to compare files of any version, without types.

use crate::scene::ron_tree::{Body, Node, parse};

/// The values in the text with their paths, as `--set` writes these; nothing if it is not RON. Only what the text says is there: defaults are
/// not. A list of numbers is one value.
pub fn fields(text: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    if let Ok(root) = parse(text) {
        walk(&root, text, "", &mut found);
    }
    found
}

fn walk(node: &Node, text: &str, path: &str, found: &mut Vec<(String, String)>) {
    let inner = node.inner();
    match &inner.body {
        Body::Fields(fields) => {
            let named = kinds(node, inner, text);
            if !named.is_empty() && !path.is_empty() {
                found.push((path.to_owned(), named));
            }
            for field in fields {
                walk(&field.value, text, &joined(path, &text[field.name.clone()]), found);
            }
        }
        Body::Items(items) if inner.name.is_none() && !items.iter().all(is_plain) => {
            for (i, item) in items.iter().enumerate() {
                walk(item, text, &joined(path, &item_name(items, i, text)), found);
            }
        }
        _ => found.push((path.to_owned(), on_one_line(&text[node.span.clone()]))),
    }
}

/// The names of wrappers from `node` to `inner`: "Fixed(Map)".
fn kinds(node: &Node, inner: &Node, text: &str) -> String {
    let own = node.name(text).unwrap_or_default();
    match &node.body {
        Body::Items(items) if !std::ptr::eq(node, inner) => {
            format!("{own}({})", kinds(&items[0], inner, text))
        }
        _ => own.to_owned(),
    }
}

fn is_plain(node: &Node) -> bool {
    matches!(node.body, Body::Plain | Body::Text(_))
}

/// What an item of a list is called: its name, else its kind if no other is of it, else its number.
fn item_name(items: &[Node], i: usize, text: &str) -> String {
    let item = &items[i];
    let own = |node: &Node| match node.field(text, "name").map(|name| &name.body) {
        Some(Body::Text(range)) => Some(text[range.clone()].to_owned()),
        _ => None,
    };
    let kind = |node: &Node| node.name(text).map(str::to_ascii_lowercase);
    let is_only = |name: &String| {
        items.iter().filter(|other| own(other).or_else(|| kind(other)).as_ref() == Some(name)).count() == 1
    };
    own(item).or_else(|| kind(item)).filter(is_only).unwrap_or_else(|| i.to_string())
}

fn joined(path: &str, step: &str) -> String {
    if path.is_empty() { step.to_owned() } else { format!("{path}.{step}") }
}

fn on_one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let found: Vec<String> =
            fields(text).iter().map(|(path, value)| format!("{path} = {value}")).collect();
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
    }

    #[test]
    fn what_is_not_ron_has_no_values() {
        assert!(fields("Scene(").is_empty() && fields("").is_empty());
    }
}
