//! RON text as a light tree of byte ranges, with no types.

use std::ops::Range;

/// Nesting beyond this is refused, so that hostile text cannot exhaust the stack.
const MAX_DEPTH: usize = 100;

/// Text with more values than this is refused, because each takes some hundred bytes of memory. A saved scene of 20 000 cameras
/// has fewer than half as many.
const MAX_VALUES: usize = 1_000_000;

/// A value in the text.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Bytes of the whole value, with its name (`Fit(…)`).
    pub span: Range<usize>,
    /// Bytes of the name before `(`, or of a bare identifier such as `Unknown`.
    pub name: Option<Range<usize>>,
    /// What it holds.
    pub body: Body,
}

/// What a value holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Body {
    /// A number, boolean, character or bare identifier.
    Plain,
    /// A string; the bytes between the quotes.
    Text(Range<usize>),
    /// `(field: value, …)`; also an empty `()`.
    Fields(Vec<Field>),
    /// `[…]`, or `(value, …)`.
    Items(Vec<Node>),
    /// `{key: value, …}`.
    Map(Vec<(Node, Node)>),
}

/// A field of a struct.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Bytes of the field's name.
    pub name: Range<usize>,
    /// Its value.
    pub value: Node,
}

/// Text that is not RON.
#[derive(Clone, Debug, PartialEq)]
pub struct SyntaxError {
    /// Where reading stopped.
    pub at: Range<usize>,
    /// What was expected there.
    pub expected: String,
    /// The bracket or quote that is still open there.
    pub open: Option<Range<usize>>,
}

impl Node {
    /// The name before `(`, or the bare identifier.
    pub fn name<'a>(&self, text: &'a str) -> Option<&'a str> {
        self.name.clone().map(|range| &text[range])
    }

    /// The field with this name, looking through wrappers.
    pub fn field<'a>(&'a self, text: &str, name: &str) -> Option<&'a Node> {
        match &self.inner().body {
            Body::Fields(fields) => fields.iter().find(|f| &text[f.name.clone()] == name).map(|f| &f.value),
            _ => None,
        }
    }

    /// What is inside wrappers such as `Fixed(Map(…))`: the innermost value.
    pub(super) fn inner(&self) -> &Node {
        match &self.body {
            Body::Items(items) if self.name.is_some() && items.len() == 1 && items[0].name.is_some() => {
                items[0].inner()
            }
            _ => self,
        }
    }

    /// The values directly inside this one, in order.
    pub fn children(&self) -> Vec<&Node> {
        match &self.body {
            Body::Plain | Body::Text(_) => Vec::new(),
            Body::Fields(fields) => fields.iter().map(|field| &field.value).collect(),
            Body::Items(items) => items.iter().collect(),
            Body::Map(entries) => entries.iter().flat_map(|(key, value)| [key, value]).collect(),
        }
    }

    /// The innermost value whose bytes contain `at`.
    pub fn innermost(&self, at: usize) -> &Node {
        let child = self.children().into_iter().find(|node| node.span.start <= at && at < node.span.end);
        child.map_or(self, |child| child.innermost(at))
    }

    /// The bytes of every field's name, here and further inside.
    pub fn field_names(&self) -> Vec<Range<usize>> {
        let own = match &self.body {
            Body::Fields(fields) => fields.iter().map(|field| field.name.clone()).collect(),
            Body::Plain | Body::Text(_) | Body::Items(_) | Body::Map(_) => Vec::new(),
        };
        own.into_iter().chain(self.children().into_iter().flat_map(Node::field_names)).collect()
    }

    /// A short range that stands for the value in a message: itself, or its name or opening bracket if it is long.
    pub fn handle(&self, text: &str) -> Range<usize> {
        match &self.name {
            _ if !text[self.span.clone()].contains('\n') => self.span.clone(),
            Some(name) => name.clone(),
            None => self.span.start..self.span.start + 1,
        }
    }

    /// The part of this value that one step of a path names.
    pub(super) fn step<'a>(&'a self, text: &str, step: &str) -> Option<&'a Node> {
        let node = self.inner();
        match &node.body {
            Body::Fields(_) => node.field(text, step),
            Body::Items(items) => {
                step.parse::<usize>().map_or_else(|_| named_item(items, text, step), |index| items.get(index))
            }
            Body::Map(entries) => {
                entries.iter().find(|(key, _)| is_text(key, text, step)).map(|(_, value)| value)
            }
            Body::Plain | Body::Text(_) => None,
        }
    }
}

fn is_text(node: &Node, text: &str, wanted: &str) -> bool {
    matches!(&node.body, Body::Text(range) if &text[range.clone()] == wanted)
}

fn named_item<'a>(items: &'a [Node], text: &str, wanted: &str) -> Option<&'a Node> {
    let by_name = |item: &&Node| item.field(text, "name").is_some_and(|name| is_text(name, text, wanted));
    items.iter().find(by_name).or_else(|| {
        let mut of_kind =
            items.iter().filter(|i| i.name(text).is_some_and(|n| n.eq_ignore_ascii_case(wanted)));
        of_kind.next().filter(|_| of_kind.next().is_none())
    })
}

/// Reads RON text into a tree of byte ranges.
///
/// # Errors
/// The first place where the text is not RON.
pub fn parse(text: &str) -> Result<Node, SyntaxError> {
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

    fn error(&self, expected: &str, open: Option<Range<usize>>) -> SyntaxError {
        let width = self.peek().map_or(0, char::len_utf8);
        SyntaxError { at: self.at..self.at + width, expected: expected.to_owned(), open }
    }

    /// Skips white space and comments.
    fn skip_blank(&mut self) -> Result<(), SyntaxError> {
        loop {
            let rest = self.rest();
            let blank = rest.len() - rest.trim_start().len();
            if blank > 0 {
                self.at += blank;
            } else if rest.starts_with("//") {
                self.at += rest.find('\n').unwrap_or(rest.len());
            } else if rest.starts_with("/*") {
                self.skip_block_comment()?;
            } else {
                return Ok(());
            }
        }
    }

    fn skip_block_comment(&mut self) -> Result<(), SyntaxError> {
        let open = self.at..self.at + 2;
        let mut depth = 0;
        loop {
            let rest = self.rest();
            if rest.starts_with("/*") {
                depth += 1;
                self.at += 2;
            } else if rest.starts_with("*/") {
                depth -= 1;
                self.at += 2;
            } else {
                let Some(next) = rest.chars().next() else {
                    return Err(self.error("the comment's closing `*/`", Some(open)));
                };
                self.at += next.len_utf8();
            }
            if depth == 0 {
                return Ok(());
            }
        }
    }

    fn value(&mut self) -> Result<Node, SyntaxError> {
        self.skip_blank()?;
        self.values += 1;
        if self.values > MAX_VALUES {
            return Err(self.error("a scene file of fewer values", None));
        }
        let start = self.at;
        let body = match self.peek() {
            Some('(') => self.nested(Self::group)?,
            Some('[') => self.nested(Self::list)?,
            Some('{') => self.nested(Self::map)?,
            Some('"' | '\'') => self.quoted()?,
            Some('r' | 'b') if self.starts_literal() => self.quoted()?,
            Some(c) if c.is_alphabetic() || c == '_' => return self.named(),
            Some(c) if c.is_ascii_digit() || matches!(c, '+' | '-' | '.') => {
                self.take_while(|c| c.is_alphanumeric() || matches!(c, '+' | '-' | '.' | '_'));
                Body::Plain
            }
            _ => return Err(self.error("a value", None)),
        };
        Ok(Node { span: start..self.at, name: None, body })
    }

    fn named(&mut self) -> Result<Node, SyntaxError> {
        let name = self.identifier();
        let end = self.at;
        self.skip_blank()?;
        if self.peek() == Some('(') {
            let body = self.nested(Self::group)?;
            return Ok(Node { span: name.start..self.at, name: Some(name), body });
        }
        self.at = end;
        Ok(Node { span: name.clone(), name: Some(name), body: Body::Plain })
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

    fn nested(
        &mut self,
        read: impl FnOnce(&mut Self, Range<usize>) -> Result<Body, SyntaxError>,
    ) -> Result<Body, SyntaxError> {
        if self.depth == MAX_DEPTH {
            return Err(self.error("fewer brackets inside each other", None));
        }
        let open = self.at..self.at + 1;
        self.at += 1;
        self.depth += 1;
        let body = read(self, open);
        self.depth -= 1;
        body
    }

    /// Whether an item follows; consumes the closing bracket if not.
    fn more(&mut self, close: char, open: &Range<usize>) -> Result<bool, SyntaxError> {
        self.skip_blank()?;
        match self.peek() {
            Some(c) if c == close => {
                self.at += 1;
                Ok(false)
            }
            None => Err(self.error(&format!("a closing `{close}`"), Some(open.clone()))),
            Some(_) => Ok(true),
        }
    }

    /// Consumes a comma, or leaves the closing bracket to [`Self::more`].
    fn separator(&mut self, close: char, open: &Range<usize>) -> Result<(), SyntaxError> {
        self.skip_blank()?;
        match self.peek() {
            Some(',') => {
                self.at += 1;
                Ok(())
            }
            Some(c) if c == close => Ok(()),
            None => Err(self.error(&format!("a closing `{close}`"), Some(open.clone()))),
            Some(_) => Err(self.error(&format!("`,` or `{close}`"), Some(open.clone()))),
        }
    }

    fn group(&mut self, open: Range<usize>) -> Result<Body, SyntaxError> {
        let (mut fields, mut items) = (Vec::new(), Vec::new());
        while self.more(')', &open)? {
            match self.field_name()? {
                Some(name) if items.is_empty() => fields.push(Field { name, value: self.value()? }),
                None if fields.is_empty() => items.push(self.value()?),
                _ => return Err(self.error("a field name and `:` before each value", Some(open))),
            }
            self.separator(')', &open)?;
        }
        Ok(if items.is_empty() { Body::Fields(fields) } else { Body::Items(items) })
    }

    /// Consumes `name:` if that is what follows.
    fn field_name(&mut self) -> Result<Option<Range<usize>>, SyntaxError> {
        let start = self.at;
        if self.peek().is_some_and(|c| c.is_alphabetic() || c == '_') && !self.starts_literal() {
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

    fn list(&mut self, open: Range<usize>) -> Result<Body, SyntaxError> {
        let mut items = Vec::new();
        while self.more(']', &open)? {
            items.push(self.value()?);
            self.separator(']', &open)?;
        }
        Ok(Body::Items(items))
    }

    fn map(&mut self, open: Range<usize>) -> Result<Body, SyntaxError> {
        let mut entries = Vec::new();
        while self.more('}', &open)? {
            let key = self.value()?;
            self.skip_blank()?;
            if self.peek() != Some(':') {
                return Err(self.error("`:` after the key", Some(open)));
            }
            self.at += 1;
            entries.push((key, self.value()?));
            self.separator('}', &open)?;
        }
        Ok(Body::Map(entries))
    }

    /// Whether a raw string (`r"`, `r#"`), byte string or byte literal follows, rather than an identifier.
    fn starts_literal(&self) -> bool {
        let after_b = self.rest().strip_prefix('b').unwrap_or(self.rest());
        let raw = after_b.strip_prefix('r').is_some_and(|r| r.trim_start_matches('#').starts_with('"'));
        raw || (after_b.len() < self.rest().len() && after_b.starts_with(['"', '\'']))
    }

    fn quoted(&mut self) -> Result<Body, SyntaxError> {
        let start = self.at;
        let raw = {
            let prefix = self.rest().trim_start_matches('b');
            prefix.starts_with('r')
        };
        self.take_while(|c| c == 'b' || c == 'r');
        let hashes = self.rest().len() - self.rest().trim_start_matches('#').len();
        self.at += hashes;
        let quote = self.peek().unwrap_or('"');
        self.at += 1;
        let content = self.at;
        let close = format!("{quote}{}", "#".repeat(hashes));
        while !self.rest().starts_with(&close) {
            if !raw && self.rest().starts_with('\\') {
                self.at += 1;
            }
            let Some(next) = self.peek() else {
                return Err(self.error(&format!("a closing `{close}`"), Some(start..content)));
            };
            self.at += next.len_utf8();
        }
        let inside = content..self.at;
        self.at += close.len();
        Ok(if quote == '"' { Body::Text(inside) } else { Body::Plain })
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
