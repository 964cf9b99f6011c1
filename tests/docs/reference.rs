//! `docs/src/reference.md`: every word of a scene file, from the doc comments of the types that serde reads it into.

use super::defaults::{Found, Library, plain, said};
use super::markdown::{anchor, repository};
use super::rust_items::{Field, Kind, Payload, Token, Variant, parse};
use std::fmt::Write as _;
use std::path::Path;

/// Where the types are looked for: source files, or folders with all below them. Types that are not reachable from
/// [`ROOT`] are ignored.
const SOURCES: &[&str] = &["src", "crates/lobelia-math/src"];

/// The type of a whole scene file.
const ROOT: &str = "Scene";

/// The generated pages: the type that each begins with, the file, and the text above the first type.
const PAGES: [(&str, &str, &str); 2] = [
    (
        ROOT,
        "reference.md",
        "\
# Scene-file reference: the object

<!-- Generated from the doc comments by tests/docs/reference.rs. Regenerate: LOBELIA_BLESS=1 cargo test --release reference -->

Every type of the scene file, in the order in which [`Scene`](#scene) uses them; the types of the `passes` list are on the
[next page](reference-passes.md). [Scene files](scene-files.md) explains the syntax. The general rules:

- Lengths are in the unit of the data set. Colors are linear Rec. 709. Angles are in degrees.
- Paths may start with `$DATA`; other paths are relative to the scene file.
- A field that is not listed is an error. A field with a default may be left out.
- The default `()` means that all fields of that type have their defaults.
",
    ),
    (
        "Pass",
        "reference-passes.md",
        "\
# Scene-file reference: passes

<!-- Generated from the doc comments by tests/docs/reference.rs. Regenerate: LOBELIA_BLESS=1 cargo test --release reference -->

The types of the `passes` list of a scene file. [The object](reference.md) has the other types and the general rules.
[Passes and outputs](passes.md) describes what the passes do.
",
    ),
];

/// Where the pages are.
const FOLDER: &str = "docs/src";

#[test]
fn reference_is_what_the_types_say() {
    let (pages, problems) = generate();
    assert!(problems.is_empty(), "doc comments and code disagree:\n{}", problems.join("\n"));
    for ((_, file, _), page) in PAGES.iter().zip(&pages) {
        let path = repository().join(FOLDER).join(file);
        if std::env::var_os("LOBELIA_BLESS").is_some() {
            std::fs::write(&path, page).unwrap();
        }
        let committed = std::fs::read_to_string(&path).unwrap_or_default();
        let line = committed.lines().zip(page.lines()).position(|(a, b)| a != b).map_or(0, |line| line + 1);
        assert!(
            committed == *page,
            "{FOLDER}/{file} is not what the types say (first difference: line {line}). Regenerate it:\n    \
             LOBELIA_BLESS=1 cargo test --release reference\nand commit the result."
        );
    }
}

/// The text of each page, and where doc comments and code disagree.
fn generate() -> (Vec<String>, Vec<String>) {
    let mut library = Library(Vec::new());
    SOURCES.iter().for_each(|source| read(&mut library, Path::new(source)));
    pages_of(&library)
}

fn pages_of(library: &Library) -> (Vec<String>, Vec<String>) {
    let root = library.0.iter().find_map(|source| {
        let of = source.types.iter().find(|of| of.name == ROOT)?;
        Some(Found { source, of })
    });
    let mut sections = Vec::new();
    collect(library, root.expect("the root type is in SOURCES"), &mut sections, "");
    let mut problems = Vec::new();
    let mut texts = Vec::new();
    for (number, (_, _, header)) in PAGES.iter().enumerate() {
        let text = (*header).to_owned();
        let mut page = Page { library, sections: &sections, number, text, problems: Vec::new() };
        page.contents();
        sections.iter().filter(|section| section.page == number).for_each(|section| page.section(section));
        texts.push(page.text);
        problems.extend(page.problems);
    }
    (texts, problems)
}

fn read(library: &mut Library, path: &Path) {
    let full = repository().join(path);
    if full.is_dir() {
        let mut entries: Vec<_> =
            std::fs::read_dir(&full).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        entries.sort();
        entries.iter().for_each(|entry| read(library, &path.join(entry)));
    } else if path.extension().is_some_and(|extension| extension == "rs") {
        let name = path.to_string_lossy().replace('\\', "/");
        library.0.push(parse(&name, &std::fs::read_to_string(&full).unwrap()));
    }
}

/// A type with the heading of its section and its page.
struct Section<'a> {
    found: Found<'a>,
    heading: String,
    page: usize,
}

/// `found` and all types that it uses, each before what it uses itself.
fn collect<'a>(library: &'a Library, found: Found<'a>, sections: &mut Vec<Section<'a>>, user: &str) {
    if sections.iter().any(|section| section.found.is(&found)) {
        return;
    }
    let name = &found.of.name;
    let taken = sections.iter().any(|section| section.found.of.name == *name);
    let heading = if taken { format!("{name} of {user}") } else { name.clone() };
    let begun = PAGES.iter().position(|(first, _, _)| first == name);
    let page = begun.or(sections.last().map(|section| section.page)).unwrap_or(0);
    sections.push(Section { found, heading, page });
    let mut used = Vec::new();
    match &found.of.kind {
        Kind::Struct(fields) => used.extend(fields.iter().map(|field| field.of.as_str())),
        Kind::Enum(variants) => {
            for variant in variants {
                match &variant.payload {
                    Payload::None => {}
                    Payload::Tuple(of) => used.extend(of.iter().map(String::as_str)),
                    Payload::Fields(fields) => used.extend(fields.iter().map(|field| field.of.as_str())),
                }
            }
        }
    }
    for of in used {
        for word in of.split(|c: char| !c.is_alphanumeric() && c != '_') {
            if let Some(other) = library.find(found.source, word) {
                collect(library, other, sections, name);
            }
        }
    }
}

struct Page<'a> {
    library: &'a Library,
    sections: &'a [Section<'a>],
    /// Its index in [`PAGES`].
    number: usize,
    text: String,
    problems: Vec<String>,
}

impl Page<'_> {
    fn contents(&mut self) {
        let own = self.sections.iter().filter(|section| section.page == self.number);
        let links = own.map(|section| self.link(section));
        let links = links.collect::<Vec<_>>().join(" · ");
        let _ = writeln!(self.text, "\n{links}");
    }

    fn section(&mut self, section: &Section) {
        let Section { found, heading, .. } = section;
        let found = *found;
        let docs = found.of.docs.iter().map(|line| self.linked(found, line)).collect::<Vec<_>>().join("\n");
        let _ = write!(self.text, "\n## {heading}\n\n{docs}\n");
        match &found.of.kind {
            Kind::Struct(fields) => {
                if !found.of.serde.contains_key("deny_unknown_fields") {
                    self.problems.push(format!("{heading} does not refuse unknown fields"));
                }
                self.fields(found, heading, fields);
            }
            Kind::Enum(variants) => self.variants(found, heading, variants),
        }
    }

    fn fields(&mut self, found: Found, place: &str, fields: &[Field]) {
        self.text += "\n| field | type | default | meaning |\n| --- | --- | --- | --- |\n";
        for field in fields {
            let place = format!("{place}.{}", field.name);
            let of = self.written_type(found, &field.of);
            let (default, meaning) = self.default_and_meaning(found, &place, field);
            let _ = writeln!(self.text, "| `{}` | {of} | {default} | {meaning} |", field.name);
        }
    }

    fn default_and_meaning(&mut self, found: Found, place: &str, field: &Field) -> (String, String) {
        let docs = self.linked(found, &field.docs.join(" "));
        if docs.is_empty() {
            self.problems.push(format!("{place} has no doc comment"));
        }
        let Some(code) = self.library.default_of(found, field) else {
            return ("required".to_owned(), cell(&docs));
        };
        match (said(&docs), code) {
            (Some(said), code) => {
                let differs = code.filter(|code| !code.contains("()") && plain(code) != plain(&said.value));
                if let Some(code) = differs.filter(|_| said.exact) {
                    let value = &said.value;
                    self.problems.push(format!("{place}: the comment says default {value}, the code {code}"));
                }
                let value = if said.exact { format!("`{}`", said.value) } else { said.value };
                (cell(&value), cell(&said.rest))
            }
            (None, Some(code)) if code == "none" => (code, cell(&docs)),
            (None, Some(code)) => (format!("`{code}`"), cell(&docs)),
            (None, None) => {
                self.problems.push(format!("{place}: say the default in the doc comment"));
                (String::new(), cell(&docs))
            }
        }
    }

    fn variants(&mut self, found: Found, place: &str, variants: &[Variant]) {
        self.text += "\n| value | meaning |\n| --- | --- |\n";
        for variant in variants {
            let (written, more) = match &variant.payload {
                Payload::None => (variant.name.clone(), String::new()),
                Payload::Fields(_) => (format!("{}(…)", variant.name), " Fields below.".to_owned()),
                Payload::Tuple(of) => self.written_tuple(found, &variant.name, of),
            };
            let docs = self.linked(found, &variant.docs.join(" "));
            let default = if variant.is_default { " The default." } else { "" };
            let _ = writeln!(self.text, "| `{written}` | {}{more}{default} |", cell(&docs));
        }
        for variant in variants {
            if let Payload::Fields(fields) = &variant.payload {
                let _ = writeln!(self.text, "\nFields of `{}(…)`:", variant.name);
                self.fields(found, &format!("{place}::{}", variant.name), fields);
            }
        }
    }

    /// How a variant with a value is written, and what belongs there.
    fn written_tuple(&self, found: Found, name: &str, of: &[String]) -> (String, String) {
        let [of] = of else { return (format!("{name}(…)"), format!(" Holds ({}).", of.join(", "))) };
        match of.as_str() {
            "Vec3" => (format!("{name}(x, y, z)"), String::new()),
            "PathBuf" | "String" => (format!("{name}(\"…\")"), String::new()),
            "f32" | "u32" => (format!("{name}(number)"), String::new()),
            _ if of.starts_with("Vec<") => {
                (format!("{name}([…])"), format!(" Holds a {}.", self.written_type(found, of)))
            }
            _ => {
                let is_struct = self
                    .library
                    .find(found.source, of)
                    .is_some_and(|inner| matches!(inner.of.kind, Kind::Struct(_)));
                let holds = if is_struct { "Has the fields of" } else { "Holds a" };
                (format!("{name}(…)"), format!(" {holds} {}.", self.written_type(found, of)))
            }
        }
    }

    fn link(&self, section: &Section) -> String {
        let file = if section.page == self.number { "" } else { PAGES[section.page].1 };
        format!("[`{}`]({file}#{})", section.heading, anchor(&section.heading))
    }

    fn written_type(&self, found: Found, of: &str) -> String {
        let inside = |outer: &str| of.strip_prefix(outer).and_then(|rest| rest.strip_suffix('>'));
        if let Some(inner) = inside("Option<") {
            return self.written_type(found, inner);
        }
        if let Some(inner) = inside("Vec<") {
            return format!("list of {}", self.written_type(found, inner));
        }
        if let Some(inner) = of.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')) {
            let parts: Vec<String> = inner.split(", ").map(|part| self.written_type(found, part)).collect();
            return format!("({})", parts.join(", "));
        }
        match of {
            "f32" | "f64" => "number".to_owned(),
            "u32" | "u64" => "whole number".to_owned(),
            "bool" => "`true` or `false`".to_owned(),
            "String" => "text".to_owned(),
            "PathBuf" => "path".to_owned(),
            "Vec3" => "`(x, y, z)`".to_owned(),
            _ => self.link_to(found, of).unwrap_or_else(|| format!("`{of}`")),
        }
    }

    fn link_to(&self, found: Found, name: &str) -> Option<String> {
        let other = self.library.find(found.source, name)?;
        self.sections.iter().find(|section| section.found.is(&other)).map(|section| self.link(section))
    }

    /// A doc comment with rustdoc's links turned into links of this page, or into the values of constants.
    fn linked(&self, found: Found, docs: &str) -> String {
        let mut out = String::new();
        let mut rest = docs;
        while let Some(start) = rest.find("[`") {
            let Some(length) = rest[start..].find("`]") else { break };
            let name = &rest[start + 2..start + length];
            out += &rest[..start];
            rest = &rest[start + length + 2..];
            if rest.starts_with('(') {
                rest = &rest[rest.find(')').map_or(0, |end| end + 1)..];
            }
            let value = match found.source.constants.get(name).map(Vec::as_slice) {
                Some([Token::Word(value)]) => Some(value.clone()),
                _ => self
                    .link_to(found, name.split("::").next().unwrap_or(name))
                    .filter(|_| !name.contains("::")),
            };
            out += &value.unwrap_or_else(|| format!("`{}`", name.replace("::", ".")));
        }
        out + rest
    }
}

/// Text that stays in one table cell.
fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}

#[test]
fn wrong_and_missing_comments_are_found() {
    let text = r#"
        /// A scene.
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Scene {
            /// Right, see [`Inner`]. Default 2.
            #[serde(default = "two")]
            right: f32,
            /// Wrong. Default 3.
            #[serde(default = "two")]
            wrong: Option<Inner>,
            #[serde(default)]
            bare: bool,
        }
        /// Inside.
        #[derive(Deserialize)]
        struct Inner {
            /// A number.
            x: u32,
        }
        fn two() -> f32 { 2.0 }
    "#;
    let (pages, problems) = pages_of(&Library(vec![parse("a.rs", text)]));
    assert!(pages[0].contains("| `right` | number | `2` | Right, see [`Inner`](#inner). |"), "{}", pages[0]);
    assert!(pages[0].contains("| `x` | whole number | required | A number. |"));
    let expected = [
        "Scene.wrong: the comment says default 3, the code 2",
        "Scene.bare has no doc comment",
        "Inner does not refuse unknown fields",
    ];
    assert_eq!(problems, expected);
}
