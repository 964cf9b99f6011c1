//! `docs/src/reference.md`: every word of a scene file, from the doc comments of the types that
//! serde reads it into.

use super::{anchor, files_with, repository};
use std::fmt::Write as _;
use syn::{
    Attribute, Expr, Field, Fields, GenericArgument, ImplItem, Item, Lit, Meta, Path, PathArguments, Stmt,
    Token, Type, Variant, punctuated::Punctuated,
};

/// The folders of the types, whose names are unique among those that serde reads.
const SOURCES: [&str; 2] = ["src", "crates"];

/// The generated pages, and the type that each begins with. What stands above the list of types is
/// written by hand.
const PAGES: [(&str, &str); 2] = [("Scene", "reference.md"), ("Pass", "reference-passes.md")];

#[test]
fn reference_is_what_the_types_say() {
    let files = SOURCES.iter().flat_map(|folder| files_with(folder, "rs"));
    // Functions that give defaults may stand in a file of their own.
    let files = files.filter(|(path, text)| text.contains("Deserialize") || path.contains("scene"));
    let parsed = files.map(|(path, text)| syn::parse_file(&text).expect(&path).items);
    let library = Library(parsed.collect());
    let mut sections = Vec::new();
    collect(&library, PAGES[0].0, &mut sections);
    for (number, (_, file)) in PAGES.iter().enumerate() {
        let page = Page { library: &library, sections: &sections, number, text: String::new() }.written();
        let path = repository().join("docs/src").join(file);
        let mut committed = std::fs::read_to_string(&path).unwrap();
        let page = format!("{}\n{page}", committed.split("\n[`").next().unwrap());
        if std::env::var_os("LOBELIA_BLESS").is_some() {
            std::fs::write(&path, &page).unwrap();
            committed.clone_from(&page);
        }
        let differs = committed.lines().zip(page.lines()).find(|(a, b)| a != b);
        assert!(
            committed == page,
            "docs/src/{file} is not what the types say: {differs:?}. Regenerate it by \
             `LOBELIA_BLESS=1 cargo test --release reference` and commit the result."
        );
    }
}

/// Whether `#[name(…)]` has such an argument, and its value if it has one.
fn argument(attributes: &[Attribute], name: &str, key: &str) -> Option<Option<String>> {
    let parse = Punctuated::<Meta, Token![,]>::parse_terminated;
    let named = attributes.iter().filter(|of| of.path().is_ident(name));
    let mut arguments = named.flat_map(|of| of.parse_args_with(parse).unwrap());
    arguments.find(|of| last(of.path()) == key).map(|of| text(&of))
}

/// The text of `key = "text"`.
fn text(of: &Meta) -> Option<String> {
    let Meta::NameValue(of) = of else { return None };
    let Expr::Lit(value) = &of.value else { return None };
    if let Lit::Str(text) = &value.lit { Some(text.value()) } else { None }
}

fn last(path: &Path) -> String {
    path.segments.last().unwrap().ident.to_string()
}

/// A doc comment's lines.
fn docs(attributes: &[Attribute]) -> Vec<String> {
    let lines = attributes.iter().filter(|of| of.path().is_ident("doc")).filter_map(|of| text(&of.meta));
    lines.map(|line| line.strip_prefix(' ').unwrap_or(&line).trim_end().to_owned()).collect()
}

fn name_of(attributes: &[Attribute], own: &syn::Ident) -> String {
    argument(attributes, "serde", "rename").flatten().unwrap_or_else(|| own.to_string())
}

/// The name of a type, `(` for a tuple, and the types inside it.
fn parts(of: &Type) -> (String, Vec<&Type>) {
    match of {
        Type::Tuple(tuple) => ("(".to_owned(), tuple.elems.iter().collect()),
        Type::Path(of) => {
            let PathArguments::AngleBracketed(inside) = &of.path.segments.last().unwrap().arguments else {
                return (last(&of.path), Vec::new());
            };
            let types = inside.args.iter();
            let types = types.filter_map(|x| if let GenericArgument::Type(of) = x { Some(of) } else { None });
            (last(&of.path), types.collect())
        }
        _ => (String::new(), Vec::new()),
    }
}

/// A struct with named fields, or an enum, that serde reads, and the index of its file.
#[derive(Clone, Copy)]
struct Found<'a> {
    file: usize,
    name: &'a syn::Ident,
    attributes: &'a [Attribute],
    /// Of a struct.
    fields: Option<&'a Fields>,
    /// Of an enum.
    variants: Option<&'a Punctuated<Variant, Token![,]>>,
}

impl<'a> Found<'a> {
    /// The variants with their names in scene files.
    fn variants(self) -> impl Iterator<Item = (String, &'a Variant)> {
        self.variants.into_iter().flatten().map(|variant| (name_of(&variant.attrs, &variant.ident), variant))
    }
}

fn is_default(variant: &Variant) -> bool {
    variant.attrs.iter().any(|of| of.path().is_ident("default"))
}

/// The items of all files.
struct Library(Vec<Vec<Item>>);

impl Library {
    fn find(&self, wanted: &str) -> Option<Found<'_>> {
        let mut all =
            self.0.iter().enumerate().flat_map(|(file, of)| of.iter().map(move |item| (file, item)));
        all.find_map(|(file, item)| {
            let (name, attributes, fields, variants) = match item {
                Item::Struct(of) => (&of.ident, &of.attrs, Some(&of.fields), None),
                Item::Enum(of) => (&of.ident, &of.attrs, None, Some(&of.variants)),
                _ => return None,
            };
            let is_it = name == wanted && argument(attributes, "derive", "Deserialize").is_some();
            let has_names = fields.is_none_or(|fields| matches!(fields, Fields::Named(_)));
            (is_it && has_names).then_some(Found { file, name, attributes, fields, variants })
        })
    }

    /// Returns the first value that `read` gives for an item, of `file` before any other.
    fn item<'a, T>(&'a self, file: usize, read: impl Fn(&'a Item) -> Option<T>) -> Option<T> {
        std::iter::once(&self.0[file]).chain(&self.0).flatten().find_map(read)
    }

    /// The value of a function whose body is one expression.
    fn function(&self, file: usize, name: &str) -> Option<&Expr> {
        self.item(file, |item| match item {
            Item::Fn(of) if of.sig.ident == name => value_of(&of.block),
            _ => None,
        })
    }

    /// The value of a type's own `Default::default`.
    fn own_default(&self, found: Found) -> Option<&Expr> {
        self.item(found.file, |item| {
            let Item::Impl(of) = item else { return None };
            let is_it = last(&of.trait_.as_ref()?.1) == "Default" && found.name == &parts(&of.self_ty).0;
            let [ImplItem::Fn(function)] = of.items.as_slice() else { return None };
            value_of(&function.block).filter(|_| is_it)
        })
    }

    /// The default of a field as a scene file would write it, if it has one: `Some(None)` if it is
    /// too complicated.
    fn default_of(&self, found: Found, field: &Field) -> Option<Option<String>> {
        let function = argument(&field.attrs, "serde", "default");
        if let Some(Some(path)) = &function {
            if let Some(number) = path.strip_prefix("number::<") {
                return Some(Some(number.trim_end_matches('>').to_owned()));
            }
            let body = self.function(found.file, path.rsplit("::").next().unwrap());
            return Some(body.and_then(|body| self.evaluate(found, body)));
        }
        if function.is_none() {
            argument(found.attributes, "serde", "default")?;
            if let Some(body) = self.own_default(found) {
                let Expr::Struct(body) = body else { return Some(None) };
                let is_it = |member: &syn::Member| matches!(member, syn::Member::Named(name) if Some(name) == field.ident.as_ref());
                let value = body.fields.iter().find(|value| is_it(&value.member));
                return Some(value.and_then(|value| self.evaluate(found, &value.expr)));
            }
        }
        Some(self.default_of_type(&parts(&field.ty).0))
    }

    fn default_of_type(&self, name: &str) -> Option<String> {
        let text = match name {
            "f32" | "f64" | "u8" | "u16" | "u32" | "u64" | "usize" => "0",
            "bool" => "false",
            "Vec3" => "(0, 0, 0)",
            "Option" => "none",
            "Vec" => "[]",
            _ => {
                let found = self.find(name)?;
                if found.fields.is_some() {
                    return Some("()".to_owned());
                }
                let marked = found.variants().find(|(_, variant)| is_default(variant));
                return marked
                    .map_or_else(|| self.evaluate(found, self.own_default(found)?), |it| Some(it.0));
            }
        };
        Some(text.to_owned())
    }

    /// The value of a simple expression.
    fn evaluate(&self, found: Found, of: &Expr) -> Option<String> {
        let list = |parts: &Punctuated<Expr, Token![,]>| -> Option<String> {
            let parts: Option<Vec<String>> = parts.iter().map(|part| self.evaluate(found, part)).collect();
            Some(parts?.join(", "))
        };
        let joined = |path: &Path| -> String {
            path.segments.iter().map(|step| step.ident.to_string()).collect::<Vec<_>>().join("::")
        };
        let text = match of {
            Expr::Lit(value) => return literal(&value.lit),
            Expr::MethodCall(call) if call.args.is_empty() => return self.evaluate(found, &call.receiver),
            Expr::Tuple(tuple) => format!("({})", list(&tuple.elems)?),
            Expr::Macro(of) if of.mac.path.is_ident("vec") => {
                format!("[{}]", list(&of.mac.parse_body_with(Punctuated::parse_terminated).ok()?)?)
            }
            Expr::Call(call) => {
                let Expr::Path(path) = &*call.func else { return None };
                match joined(&path.path).as_str() {
                    "Some" => list(&call.args)?,
                    "Vec3::splat" => format!("({})", vec![list(&call.args)?; 3].join(", ")),
                    "Vec::new" => "[]".to_owned(),
                    other => match other.strip_suffix("::default") {
                        Some(of) => return self.default_of_type(of),
                        None => return self.evaluate(found, self.function(found.file, other)?),
                    },
                }
            }
            Expr::Path(path) => match joined(&path.path).as_str() {
                "None" => "none".to_owned(),
                "Vec3::X" => "(1, 0, 0)".to_owned(),
                "Vec3::Y" => "(0, 1, 0)".to_owned(),
                "Vec3::Z" => "(0, 0, 1)".to_owned(),
                "Vec3::ZERO" => "(0, 0, 0)".to_owned(),
                "Vec3::ONE" => "(1, 1, 1)".to_owned(),
                other => other.split_once("::")?.1.to_owned(),
            },
            // A variant with fields is short where all of these have defaults of their own.
            Expr::Struct(of) => {
                let (name, variant) = found.variants().find(|(name, _)| *name == last(&of.path))?;
                let mut fields = variant.fields.iter();
                let all = fields.all(|field| argument(&field.attrs, "serde", "default").is_some());
                all.then(|| format!("{name}()"))?
            }
            _ => return None,
        };
        Some(text)
    }
}

fn value_of(block: &syn::Block) -> Option<&Expr> {
    if let [Stmt::Expr(value, None)] = block.stmts.as_slice() { Some(value) } else { None }
}

/// A literal as a scene file has it: without its type and trailing zeros.
fn literal(of: &Lit) -> Option<String> {
    match of {
        Lit::Str(text) => Some(format!("{:?}", text.value())),
        Lit::Bool(value) => Some(value.value.to_string()),
        Lit::Int(number) => Some(number.base10_digits().to_owned()),
        Lit::Float(number) => Some(number.base10_digits().trim_end_matches(".0").to_owned()),
        _ => None,
    }
}

/// Reads the sentence `Default VALUE.` or `Default: phrase.` in a doc comment: the value, whether
/// it is exact, and the comment without a sentence that only gives the value.
fn said(docs: &str) -> Option<(String, bool, String)> {
    let start = if docs.starts_with("Default") { 0 } else { docs.find(". Default")? + 2 };
    let end = docs[start..].find(". ").map_or(docs.len(), |end| start + end + 1);
    let body = docs[start..end].trim_end_matches('.').strip_prefix("Default")?;
    let without = format!("{}{}", &docs[..start], docs[end..].trim_start()).trim_end().to_owned();
    if let Some(phrase) = body.strip_prefix(": ") {
        return Some((phrase.to_owned(), false, without));
    }
    let body = body.trim_start();
    let closed = |by: char| Some(body[1..].find(by)? + 2);
    let length = match body.chars().next()? {
        quote @ ('`' | '"') => closed(quote)?,
        '(' => closed(')')?,
        '[' => closed(']')?,
        '0'..='9' => {
            let is_exponent = |at: usize| body[at..].starts_with("e-");
            let mut ends = body.match_indices(|c: char| c.is_alphabetic() || ":,".contains(c));
            ends.find(|(at, _)| !is_exponent(*at)).map_or(body.len(), |(at, _)| at)
        }
        _ => body.find([' ', ':', ',']).unwrap_or(body.len()),
    };
    let rest = if length < body.len() { docs.to_owned() } else { without };
    Some((body[..length].trim_matches('`').trim().to_owned(), true, rest))
}

/// A value as it is compared: no digit groups, no spaces, no `.0`.
fn plain(value: &str) -> String {
    value.replace([' ', '_'], "").replace(".0,", ",").replace(".0)", ")")
}

/// The type `name` with the index of its page, and all types that it uses, each before what it uses
/// itself.
fn collect<'a>(library: &'a Library, name: &str, sections: &mut Vec<(Found<'a>, usize)>) {
    let Some(found) = library.find(name) else { return };
    if sections.iter().any(|(section, _)| section.name == name) {
        return;
    }
    let begun = PAGES.iter().position(|(first, _)| *first == name);
    sections.push((found, begun.or(sections.last().map(|section| section.1)).unwrap_or(0)));
    let variants = found.variants().map(|(_, variant)| &variant.fields);
    let mut used: Vec<&Type> = found.fields.into_iter().chain(variants).flatten().map(|of| &of.ty).collect();
    used.reverse();
    while let Some((name, inside)) = used.pop().map(parts) {
        collect(library, &name, sections);
        used.extend(inside.into_iter().rev());
    }
}

struct Page<'a> {
    library: &'a Library,
    sections: &'a [(Found<'a>, usize)],
    /// Its index in [`PAGES`].
    number: usize,
    text: String,
}

impl Page<'_> {
    /// The text of the page.
    fn written(mut self) -> String {
        let own = || self.sections.iter().filter(|section| section.1 == self.number).map(|section| section.0);
        let links: Vec<String> = own().map(|found| self.link_to(&found.name.to_string()).unwrap()).collect();
        let founds: Vec<Found> = own().collect();
        self.text = links.join(" · ") + "\n";
        founds.into_iter().for_each(|found| self.section(found));
        self.text
    }

    fn section(&mut self, found: Found) {
        let name = found.name.to_string();
        let lines: Vec<String> = docs(found.attributes).iter().map(|line| self.linked(found, line)).collect();
        let _ = write!(self.text, "\n## {name}\n\n{}\n", lines.join("\n"));
        if let Some(fields) = found.fields {
            let refuses = argument(found.attributes, "serde", "deny_unknown_fields").is_some();
            assert!(refuses, "{name} does not refuse unknown fields");
            return self.fields(found, &name, fields);
        }
        self.text += "\n| value | meaning |\n| --- | --- |\n";
        for (name, variant) in found.variants() {
            let (written, more) = self.written_variant(&name, &variant.fields);
            let docs = cell(&self.linked(found, &docs(&variant.attrs).join(" ")));
            let default = if is_default(variant) { " The default." } else { "" };
            let _ = writeln!(self.text, "| `{written}` | {docs}{more}{default} |");
        }
        for (variant, of) in found.variants().filter(|(_, of)| matches!(of.fields, Fields::Named(_))) {
            let _ = writeln!(self.text, "\nFields of `{variant}(…)`:");
            self.fields(found, &format!("{name}::{variant}"), &of.fields);
        }
    }

    fn fields(&mut self, found: Found, place: &str, fields: &Fields) {
        self.text += "\n| field | type | default | meaning |\n| --- | --- | --- | --- |\n";
        for field in fields {
            let name = name_of(&field.attrs, field.ident.as_ref().unwrap());
            let of = self.written_type(&field.ty);
            let (default, meaning) = self.default_and_meaning(found, &format!("{place}.{name}"), field);
            let _ = writeln!(self.text, "| `{name}` | {of} | {default} | {} |", cell(&meaning));
        }
    }

    fn default_and_meaning(&self, found: Found, place: &str, field: &Field) -> (String, String) {
        let docs = self.linked(found, &docs(&field.attrs).join(" "));
        assert!(!docs.is_empty(), "{place} has no doc comment");
        match (said(&docs), self.library.default_of(found, field)) {
            (_, None) => ("required".to_owned(), docs),
            (Some((value, exact, rest)), Some(code)) => {
                if let Some(code) = code.filter(|code| exact && !code.contains("()")) {
                    let is_said = plain(&value) == plain(&code);
                    assert!(is_said, "{place}: the comment says default {value}, the code {code}");
                }
                (cell(&if exact { format!("`{value}`") } else { value }), rest)
            }
            (None, Some(Some(code))) => (if code == "none" { code } else { format!("`{code}`") }, docs),
            (None, Some(None)) => panic!("{place}: say the default in the doc comment"),
        }
    }

    /// How a variant is written, and what belongs between its brackets.
    fn written_variant(&self, name: &str, fields: &Fields) -> (String, String) {
        let of = match fields {
            Fields::Unit => return (name.to_owned(), String::new()),
            Fields::Named(_) => return (format!("{name}(…)"), " Fields below.".to_owned()),
            Fields::Unnamed(fields) => &fields.unnamed[0].ty,
        };
        let (inside, holds) = match parts(of).0.as_str() {
            "Vec3" => ("x, y, z", None),
            "PathBuf" | "String" => ("\"…\"", None),
            "f32" | "u32" => ("number", None),
            "Vec" => ("[…]", Some("Holds a")),
            inner => {
                let is_struct = self.library.find(inner).is_some_and(|inner| inner.fields.is_some());
                ("…", Some(if is_struct { "Has the fields of" } else { "Holds a" }))
            }
        };
        let holds = holds.map(|holds| format!(" {holds} {}.", self.written_type(of)));
        (format!("{name}({inside})"), holds.unwrap_or_default())
    }

    fn written_type(&self, of: &Type) -> String {
        let (name, inside) = parts(of);
        let inside: Vec<String> = inside.into_iter().map(|of| self.written_type(of)).collect();
        match name.as_str() {
            "Option" => inside.concat(),
            "Vec" => format!("list of {}", inside.concat()),
            "(" => format!("({})", inside.join(", ")),
            "f32" | "f64" => "number".to_owned(),
            "u32" | "u64" => "whole number".to_owned(),
            "bool" => "`true` or `false`".to_owned(),
            "String" => "text".to_owned(),
            "PathBuf" => "path".to_owned(),
            "Vec3" => "`(x, y, z)`".to_owned(),
            name => self.link_to(name).unwrap_or_else(|| format!("`{name}`")),
        }
    }

    fn link_to(&self, name: &str) -> Option<String> {
        let (_, page) = self.sections.iter().find(|(section, _)| section.name == name)?;
        let file = if *page == self.number { "" } else { PAGES[*page].1 };
        Some(format!("[`{name}`]({file}#{})", anchor(name)))
    }

    /// A doc comment with rustdoc's links turned into links of this page, or into the values of
    /// constants.
    fn linked(&self, found: Found, docs: &str) -> String {
        let mut parts = docs.split("[`");
        let mut out = parts.next().unwrap_or_default().to_owned();
        for (name, after) in parts.filter_map(|part| part.split_once("`]")) {
            let rest = after.strip_prefix('(').and_then(|target| Some(target.split_once(')')?.1));
            let constant = self.library.0[found.file].iter().find_map(|item| match item {
                Item::Const(syn::ItemConst { ident, expr, .. }) if ident == name => match &**expr {
                    Expr::Lit(value) => literal(&value.lit),
                    _ => None,
                },
                _ => None,
            });
            let value = constant.or_else(|| self.link_to(name));
            out += &value.unwrap_or_else(|| format!("`{}`", name.replace("::", ".")));
            out += rest.unwrap_or(after);
        }
        out
    }
}

/// Text that stays in one table cell.
fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}
