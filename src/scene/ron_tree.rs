//! RON text as a light tree of byte ranges, with no types.
//!
//! It serves three ends: the caret of an error about a value (`material.specular.roughness`),
//! `--set path=value`, which replaces a value's text before the file is read as usual, and
//! comparing scene files of any version.
//!
//! A path is a list of steps joined by dots. A step is a field's name, an index of a list or tuple,
//! the `name` of a list's item, or (where no item has that name) the only item of that kind:
//! `passes.novel.render.exposure`, `passes.fit.rates.light`. Wrappers such as
//! `Fixed(Map(scale: 2))` are looked through: `light.scale`.

use ron::extensions::Extensions;
use std::ops::Range;

/// The RON dialect of scene files.
pub(crate) fn options() -> ron::Options {
    ron::Options::default()
        .with_default_extension(Extensions::IMPLICIT_SOME | Extensions::UNWRAP_VARIANT_NEWTYPES)
}

/// Nesting beyond this is refused, so that hostile text cannot exhaust the stack.
const MAX_DEPTH: usize = 100;
/// Text with more values than this is refused, because each takes some hundred bytes of memory. A
/// saved scene of 20 000 cameras has fewer than half as many.
const MAX_VALUES: usize = 1_000_000;

/// A value in the text.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Bytes of the whole value, with its name (`Fit(…)`).
    pub span: Range<usize>,
    /// Bytes of the name before `(`, or of a bare identifier such as `Unknown`.
    pub name: Option<Range<usize>>,
    /// Its content.
    pub body: Body,
}

/// Content of a value.
#[derive(Clone, Debug, PartialEq)]
pub enum Body {
    /// A number, boolean, character or bare identifier.
    Plain,
    /// A string; the bytes between the quotes.
    Text(Range<usize>),
    /// `(field: value, …)`, with the bytes of each name; also an empty `()`.
    Fields(Vec<(Range<usize>, Node)>),
    /// `[…]`, or `(value, …)`.
    Items(Vec<Node>),
}

/// Text that is not RON.
#[derive(Clone, Debug, PartialEq)]
pub struct SyntaxError {
    /// Where reading stopped.
    pub at: Range<usize>,
    /// The expectation there.
    pub expected: String,
    /// The bracket or quote that is still open there.
    pub open: Option<Range<usize>>,
}

/// What was read, or the first place where the text is not RON.
type Read<T> = Result<T, SyntaxError>;

impl Node {
    /// The name before `(`, or the bare identifier.
    pub fn name<'a>(&self, text: &'a str) -> Option<&'a str> {
        self.name.clone().map(|range| &text[range])
    }

    /// The field with this name, looking through wrappers.
    pub fn field(&self, text: &str, name: &str) -> Option<&Node> {
        match &self.inner().body {
            Body::Fields(fields) => fields.iter().find(|f| &text[f.0.clone()] == name).map(|f| &f.1),
            _ => None,
        }
    }

    /// The text of a list's item that names it: that of its field `name`.
    pub fn own_name<'a>(&self, text: &'a str) -> Option<&'a str> {
        match &self.field(text, "name")?.body {
            Body::Text(range) => Some(&text[range.clone()]),
            _ => None,
        }
    }

    /// The innermost value of wrappers such as `Fixed(Map(…))`.
    pub fn inner(&self) -> &Node {
        match &self.body {
            Body::Items(items) if self.name.is_some() && items.len() == 1 && items[0].name.is_some() => {
                items[0].inner()
            }
            _ => self,
        }
    }

    /// The innermost value with a body of a kind whose bytes contain `at`; this one if there is
    /// none.
    pub fn innermost(&self, at: usize, is_wanted: impl Fn(&Body) -> bool) -> &Node {
        let (mut best, mut here) = (self, Some(self));
        while let Some(node) = here {
            if is_wanted(&node.body) {
                best = node;
            }
            let contains = |child: &&Node| child.span.contains(&at);
            here = match &node.body {
                Body::Plain | Body::Text(_) => None,
                Body::Fields(fields) => fields.iter().map(|(_, value)| value).find(contains),
                Body::Items(items) => items.iter().find(contains),
            };
        }
        best
    }

    /// A short range that stands for the value in a message: itself, or its name or opening bracket
    /// if it is long.
    pub fn handle(&self, text: &str) -> Range<usize> {
        match &self.name {
            _ if !text[self.span.clone()].contains('\n') => self.span.clone(),
            Some(name) => name.clone(),
            None => self.span.start..self.span.start + 1,
        }
    }

    /// The part of this value that one step of a path names.
    pub fn step(&self, text: &str, step: &str) -> Option<&Node> {
        match &self.inner().body {
            Body::Fields(_) => self.field(text, step),
            Body::Items(items) => match step.parse::<usize>() {
                Ok(index) => items.get(index),
                Err(_) => items.iter().find(|item| item.own_name(text) == Some(step)).or_else(|| {
                    let is_kind = |of: &&Node| of.name(text).is_some_and(|n| n.eq_ignore_ascii_case(step));
                    let mut of_kind = items.iter().filter(is_kind);
                    of_kind.next().filter(|_| of_kind.next().is_none())
                }),
            },
            Body::Plain | Body::Text(_) => None,
        }
    }

    /// Where `path` leads, as a short range, and whether its value is in the text: else it is that
    /// of what comes nearest.
    pub fn locate(&self, text: &str, path: &str) -> (Range<usize>, bool) {
        let mut node = self;
        for step in path.split('.').filter(|step| !step.is_empty()) {
            match node.step(text, step) {
                Some(next) => node = next,
                None => return (node.handle(text), false),
            }
        }
        (node.handle(text), true)
    }
}

/// Reads RON text into a tree of byte ranges.
///
/// # Errors
/// The first place where the text is not RON.
pub fn parse(text: &str) -> Read<Node> {
    let mut parser = Parser { text, at: 0, depth: 0, values: 0 };
    parser.skip_blank()?;
    while parser.rest().starts_with("#!") {
        let end = parser.rest().find(']').map(|end| parser.at + end + 1);
        parser.at = end.ok_or_else(|| parser.error("the attribute's closing `]`", None))?;
        parser.skip_blank()?;
    }
    let node = parser.value()?;
    parser.skip_blank()?;
    if parser.rest().is_empty() { Ok(node) } else { Err(parser.error("the end of the file", None)) }
}

struct Parser<'a> {
    text: &'a str,
    at: usize,
    depth: usize,
    values: usize,
}

impl Parser<'_> {
    fn rest(&self) -> &str {
        &self.text[self.at..]
    }

    fn peek(&self) -> Option<char> {
        self.rest().chars().next()
    }

    fn error(&self, expected: &str, open: Option<&Range<usize>>) -> SyntaxError {
        let width = self.peek().map_or(0, char::len_utf8);
        SyntaxError { at: self.at..self.at + width, expected: expected.to_owned(), open: open.cloned() }
    }

    /// Skips white space and comments.
    fn skip_blank(&mut self) -> Read<()> {
        loop {
            self.take_while(char::is_whitespace);
            if self.rest().starts_with("//") {
                self.take_while(|c| c != '\n');
            } else if self.rest().starts_with("/*") {
                self.skip_block_comment()?;
            } else {
                return Ok(());
            }
        }
    }

    fn skip_block_comment(&mut self) -> Read<()> {
        let open = self.at..self.at + 2;
        let mut depth = 0;
        loop {
            let rest = self.rest();
            let (opens, closes) = (rest.starts_with("/*"), rest.starts_with("*/"));
            let Some(next) = rest.chars().next() else {
                return Err(self.error("the comment's closing `*/`", Some(&open)));
            };
            self.at += if opens || closes { 2 } else { next.len_utf8() };
            depth += i32::from(opens) - i32::from(closes);
            if depth == 0 {
                return Ok(());
            }
        }
    }

    fn value(&mut self) -> Read<Node> {
        self.skip_blank()?;
        self.values += 1;
        if self.values > MAX_VALUES {
            return Err(self.error("a scene file of fewer values", None));
        }
        let start = self.at;
        let body = match self.peek() {
            Some('(') => self.group()?,
            Some('[') => {
                let mut items = Vec::new();
                self.bracket(']', |parser, _| parser.value().map(|item| items.push(item)))?;
                Body::Items(items)
            }
            Some('"') => self.quoted()?,
            Some('r') if self.starts_raw() => self.quoted()?,
            Some(c) if c.is_alphabetic() || c == '_' => {
                let name = self.identifier();
                self.skip_blank()?;
                let is_alone = self.peek() != Some('(');
                if is_alone {
                    self.at = name.end;
                }
                let body = if is_alone { Body::Plain } else { self.group()? };
                return Ok(Node { span: start..self.at, name: Some(name), body });
            }
            Some(c) if c.is_ascii_digit() || matches!(c, '+' | '-' | '.') => {
                self.take_while(|c| c.is_alphanumeric() || matches!(c, '+' | '-' | '.' | '_'));
                Body::Plain
            }
            _ => return Err(self.error("a value", None)),
        };
        Ok(Node { span: start..self.at, name: None, body })
    }

    fn identifier(&mut self) -> Range<usize> {
        let start = self.at;
        if self.rest().starts_with("r#") {
            self.at += 2;
        }
        self.take_while(|c| c.is_alphanumeric() || c == '_');
        start..self.at
    }

    fn take_while(&mut self, keep: impl Fn(char) -> bool) {
        self.at += self.rest().find(|c| !keep(c)).unwrap_or(self.rest().len());
    }

    /// Reads what is between the bracket here and `close`: items, each by `read`, with commas
    /// between them.
    fn bracket(
        &mut self,
        close: char,
        mut read: impl FnMut(&mut Self, &Range<usize>) -> Read<()>,
    ) -> Read<()> {
        if self.depth == MAX_DEPTH {
            return Err(self.error("fewer brackets inside each other", None));
        }
        let open = self.at..self.at + 1;
        self.at += 1;
        self.depth += 1;
        let mut is_separated = true;
        loop {
            self.skip_blank()?;
            match self.peek() {
                None => return Err(self.error(&format!("a closing `{close}`"), Some(&open))),
                Some(c) if c == close => break,
                Some(',') if !is_separated => {
                    self.at += 1;
                    is_separated = true;
                }
                Some(_) if is_separated => {
                    read(self, &open)?;
                    is_separated = false;
                }
                Some(_) => return Err(self.error(&format!("`,` or `{close}`"), Some(&open))),
            }
        }
        self.at += 1;
        self.depth -= 1;
        Ok(())
    }

    fn group(&mut self) -> Read<Body> {
        let (mut fields, mut items) = (Vec::new(), Vec::new());
        self.bracket(')', |parser, open| {
            match parser.field_name()? {
                Some(name) if items.is_empty() => fields.push((name, parser.value()?)),
                None if fields.is_empty() => items.push(parser.value()?),
                _ => return Err(parser.error("a field name and `:` before each value", Some(open))),
            }
            Ok(())
        })?;
        Ok(if items.is_empty() { Body::Fields(fields) } else { Body::Items(items) })
    }

    /// Consumes `name:` if that is what follows.
    fn field_name(&mut self) -> Read<Option<Range<usize>>> {
        let start = self.at;
        if self.peek().is_some_and(|c| c.is_alphabetic() || c == '_') && !self.starts_raw() {
            let name = self.identifier();
            self.skip_blank()?;
            if self.peek() == Some(':') {
                self.at += 1;
                return Ok(Some(name));
            }
        }
        self.at = start;
        Ok(None)
    }

    /// Whether a raw string (`r"`, `r#"`) follows, rather than an identifier.
    fn starts_raw(&self) -> bool {
        self.rest().strip_prefix('r').is_some_and(|rest| rest.trim_start_matches('#').starts_with('"'))
    }

    fn quoted(&mut self) -> Read<Body> {
        let start = self.at;
        self.take_while(|c| c != '"');
        let is_raw = self.at > start;
        let close = format!("\"{}", "#".repeat((self.at - start).saturating_sub(1)));
        self.at += 1;
        let content = self.at;
        while !self.rest().starts_with(&close) {
            if !is_raw && self.rest().starts_with('\\') {
                self.at += 1;
            }
            let Some(next) = self.peek() else {
                return Err(self.error(&format!("a closing `{close}`"), Some(&(start..content))));
            };
            self.at += next.len_utf8();
        }
        let inside = content..self.at;
        self.at += close.len();
        Ok(Body::Text(inside))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broken_text_names_the_place_and_the_open_bracket() {
        let error = parse("Scene(\n  passes: [Fit(\n").unwrap_err();
        assert_eq!((error.at, error.open), (23..23, Some(21..22)));
        let error = parse("(a: 1 b: 2)").unwrap_err();
        assert_eq!((error.at, error.open), (6..7, Some(0..1)));
        assert_eq!(parse("(a: \"x").unwrap_err().open, Some(4..5));
        assert!(parse("(a: /* x").is_err() && parse("").is_err() && parse("(1, a: 2)").is_err());
        assert!(parse("(1) 2").unwrap_err().expected.contains("end of the file"));
        assert!(parse(&"(".repeat(100_000)).is_err());
    }

    proptest::proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "[(){}\\[\\],:\"'a-zé0-9#/* \\\\\n!.-]{0,60}") {
            if let Ok(node) = parse(&text) {
                proptest::prop_assert!(text.get(node.span).is_some());
            }
        }
    }
}
