//! Default values of fields, as a scene file would write them: what the code says, and what the doc comment says.

use super::rust_items::{Field, Kind, Payload, Source, Token, Type, split};

/// All source files.
pub struct Library(pub Vec<Source>);

/// A type and the file it is in.
#[derive(Clone, Copy)]
pub struct Found<'a> {
    pub source: &'a Source,
    pub of: &'a Type,
}

impl Found<'_> {
    /// Whether both are the same declaration.
    pub fn is(&self, other: &Self) -> bool {
        std::ptr::eq(self.of, other.of)
    }
}

impl Library {
    /// The type that `name` means in `source`: its own, the only one, or the one that a `use` brings.
    pub fn find<'a>(&'a self, source: &'a Source, name: &str) -> Option<Found<'a>> {
        let all = self.0.iter().flat_map(|s| s.types.iter().map(move |of| Found { source: s, of }));
        let named: Vec<Found> = all.filter(|found| found.of.name == name).collect();
        if let Some(own) = named.iter().find(|found| std::ptr::eq(found.source, source)) {
            return Some(*own);
        }
        let used = source.uses.iter().find(|path| path.last().is_some_and(|last| last == name));
        let score = |found: &Found| {
            let Some(path) = used else { return 0 };
            path.iter().filter(|step| found.source.path.split(['/', '.']).any(|part| part == *step)).count()
        };
        named.into_iter().max_by_key(score)
    }

    /// The default of `field`, if it has one: `Ok(None)` if it is too complicated to be written here.
    pub fn default_of(&self, found: Found, field: &Field) -> Option<Option<String>> {
        match field.serde.get("default") {
            Some(Some(function)) => {
                let function = function.rsplit("::").next().unwrap_or(function);
                let everywhere = std::iter::once(found.source).chain(&self.0);
                let body = everywhere.filter_map(|source| source.functions.get(function)).next();
                Some(body.and_then(|body| self.evaluate(found, body)))
            }
            Some(None) => Some(self.of_type(found.source, &field.of)),
            None if found.of.serde.contains_key("default") => Some(self.of_container(found, field)),
            None => None,
        }
    }

    /// A field's default as the type's own `Default` gives it.
    fn of_container(&self, found: Found, field: &Field) -> Option<String> {
        let Some(body) = found.source.defaults.get(&found.of.name) else {
            return self.of_type(found.source, &field.of);
        };
        let [Token::Word(_), Token::Mark('{'), fields @ .., Token::Mark('}')] = body.as_slice() else {
            return None;
        };
        let is_it = |value: &Vec<Token>| value.first() == Some(&Token::Word(field.name.clone()));
        let value = split(fields, ',').into_iter().find(is_it)?;
        self.evaluate(found, value.get(2..)?)
    }

    /// The default of a type.
    fn of_type(&self, source: &Source, of: &str) -> Option<String> {
        let text = match of {
            "f32" | "f64" | "u8" | "u16" | "u32" | "u64" | "usize" => "0",
            "bool" => "false",
            "Vec3" => "(0, 0, 0)",
            _ if of.starts_with("Option<") => "none",
            _ if of.starts_with("Vec<") => "[]",
            _ => {
                let found = self.find(source, of)?;
                let Kind::Enum(variants) = &found.of.kind else { return Some("()".to_owned()) };
                if let Some(variant) = variants.iter().find(|variant| variant.is_default) {
                    return Some(variant.name.clone());
                }
                return self.evaluate(found, found.source.defaults.get(of)?);
            }
        };
        Some(text.to_owned())
    }

    /// The value of a simple expression.
    fn evaluate(&self, found: Found, tokens: &[Token]) -> Option<String> {
        use Token::{Mark, Text, Word};
        let list = |tokens: &[Token]| -> Option<String> {
            let parts: Option<Vec<String>> =
                split(tokens, ',').iter().map(|part| self.evaluate(found, part)).collect();
            Some(parts?.join(", "))
        };
        match tokens {
            [Text(text)] => Some(format!("{text:?}")),
            [Text(text), Mark('.'), Word(_), Mark('('), Mark(')')] => Some(format!("{text:?}")),
            [Word(word)] if word.starts_with(|c: char| c.is_ascii_digit()) => Some(number(word)),
            [Word(word)] if word == "None" => Some("none".to_owned()),
            [Word(word)] if word == "true" || word == "false" => Some(word.clone()),
            [Word(word), Mark('('), inside @ .., Mark(')')] if word == "Some" => list(inside),
            [Word(word), Mark('!'), Mark('['), inside @ .., Mark(']')] if word == "vec" => {
                Some(format!("[{}]", list(inside)?))
            }
            [Word(function), Mark('('), Mark(')')] => {
                self.evaluate(found, found.source.functions.get(function)?)
            }
            [Mark('('), inside @ .., Mark(')')] => Some(format!("({})", list(inside)?)),
            [Word(of), Mark(':'), Mark(':'), rest @ ..] => self.associated(found, of, rest),
            _ => None,
        }
    }

    /// The value of `of::rest`.
    fn associated(&self, found: Found, of: &str, rest: &[Token]) -> Option<String> {
        use Token::{Mark, Word};
        match (of, rest) {
            ("Vec3", [Word(name)]) => {
                let text = match name.as_str() {
                    "X" => "(1, 0, 0)",
                    "Y" => "(0, 1, 0)",
                    "Z" => "(0, 0, 1)",
                    "ZERO" => "(0, 0, 0)",
                    "ONE" => "(1, 1, 1)",
                    _ => return None,
                };
                Some(text.to_owned())
            }
            ("Vec3", [Word(splat), Mark('('), value @ .., Mark(')')]) if splat == "splat" => {
                let value = self.evaluate(found, value)?;
                Some(format!("({value}, {value}, {value})"))
            }
            ("Vec", [Word(new), ..]) if new == "new" => Some("[]".to_owned()),
            (of, [Word(default), Mark('('), Mark(')')]) if default == "default" => {
                self.of_type(found.source, of)
            }
            (_, [Word(variant)]) => Some(variant.clone()),
            // A variant with fields is short where all of these have defaults of their own.
            ("Self", [Word(name), Mark('{'), ..]) => {
                let Kind::Enum(variants) = &found.of.kind else { return None };
                let variant = variants.iter().find(|variant| variant.name == *name)?;
                let Payload::Fields(fields) = &variant.payload else { return None };
                fields.iter().all(|field| field.serde.contains_key("default")).then(|| format!("{name}()"))
            }
            _ => None,
        }
    }
}

/// A number without its type, digit separators and trailing zeros.
fn number(word: &str) -> String {
    let plain = word.replace('_', "");
    match plain.strip_suffix(".0") {
        Some(whole) => whole.to_owned(),
        None => plain.trim_end_matches("f32").trim_end_matches("u32").to_owned(),
    }
}

/// What a doc comment says of a default.
pub struct Said {
    /// The value, or a phrase.
    pub value: String,
    /// The value can be compared with the code's.
    pub exact: bool,
    /// The comment without the sentence that says no more than the value.
    pub rest: String,
}

/// Finds the sentence `Default VALUE.` or `Default: phrase.` in a doc comment.
pub fn said(docs: &str) -> Option<Said> {
    let start = if docs.starts_with("Default") { 0 } else { docs.find(". Default")? + 2 };
    let end = start + sentence_end(&docs[start..]);
    let sentence = docs[start..end].trim_end_matches('.');
    let body = sentence.strip_prefix("Default")?;
    let without = format!("{}{}", &docs[..start], docs[end..].trim_start()).trim_end().to_owned();
    if let Some(phrase) = body.strip_prefix(": ") {
        return Some(Said { value: phrase.to_owned(), exact: false, rest: without });
    }
    let body = body.trim_start();
    let length = match body.chars().next()? {
        '`' => body[1..].find('`')? + 2,
        '(' => body.find(')')? + 1,
        '[' => body.find(']')? + 1,
        '"' => body[1..].find('"')? + 2,
        _ => {
            let digits = body.len() - body.trim_start_matches(|c: char| c.is_ascii_digit() || c == ' ').len();
            let word = body.find([' ', ':', ',']).unwrap_or(body.len());
            digits.max(word)
        }
    };
    let value = body[..length].trim_matches('`').trim().to_owned();
    let rest = if length < body.len() { docs.to_owned() } else { without };
    Some(Said { value, exact: true, rest })
}

/// Where the first sentence ends: a full stop before a space, outside brackets and code.
fn sentence_end(text: &str) -> usize {
    let (mut depth, mut code) = (0, false);
    for (i, c) in text.char_indices() {
        match c {
            '(' | '[' => depth += 1,
            ')' | ']' => depth -= 1,
            '`' => code = !code,
            '.' if depth == 0 && !code && text[i + 1..].chars().next().is_none_or(char::is_whitespace) => {
                return i + 1;
            }
            _ => {}
        }
    }
    text.len()
}

/// A value as it is compared: no digit groups, no spaces, no `.0`.
pub fn plain(value: &str) -> String {
    value.replace([' ', '_'], "").replace(".0,", ",").replace(".0)", ")")
}

#[test]
fn default_sentences_are_found() {
    let at = |docs: &str| said(docs).map(|said| (said.value, said.exact, said.rest));
    let some = |value: &str, exact, rest: &str| Some((value.to_owned(), exact, rest.to_owned()));
    assert_eq!(at("Radius > 0. Default 0.8."), some("0.8", true, "Radius > 0."));
    assert_eq!(at("Default (0, 1, 0). And more."), some("(0, 1, 0)", true, "And more."));
    assert_eq!(at("A. Default `Unknown(lobes: 128)`."), some("Unknown(lobes: 128)", true, "A."));
    assert_eq!(at("A. Default 2 000 000."), some("2 000 000", true, "A."));
    assert_eq!(at("A. Default: all unknown."), some("all unknown", false, "A."));
    assert_eq!(at("A. Default 0: a hard edge."), some("0", true, "A. Default 0: a hard edge."));
    assert_eq!(at("By default the scene's own."), None);
}
