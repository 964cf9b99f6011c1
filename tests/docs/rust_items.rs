//! Structs, enums, default values and `use` paths of a Rust source file, with doc comments and serde attributes.
//!
//! A tokenizer and a parser for as much of the language as declarations need; bodies are skipped.

use std::collections::BTreeMap;

/// A token of Rust source.
#[derive(Clone, Debug, PartialEq)]
pub enum Token {
    /// One line of a `///` comment.
    Doc(String),
    /// An identifier, a keyword or a number.
    Word(String),
    /// The contents of a string literal.
    Text(String),
    /// A punctuation character.
    Mark(char),
}

/// A source file.
#[derive(Default)]
pub struct Source {
    /// Its path, with `/`.
    pub path: String,
    /// Its types that serde reads.
    pub types: Vec<Type>,
    /// The paths of its `use` declarations.
    pub uses: Vec<Vec<String>>,
    /// Bodies of its functions.
    pub functions: BTreeMap<String, Vec<Token>>,
    /// Bodies of `Default::default`, by type.
    pub defaults: BTreeMap<String, Vec<Token>>,
    /// Values of its constants.
    pub constants: BTreeMap<String, Vec<Token>>,
}

/// A struct or an enum.
pub struct Type {
    pub name: String,
    pub docs: Vec<String>,
    pub serde: Serde,
    pub kind: Kind,
}

pub enum Kind {
    Struct(Vec<Field>),
    Enum(Vec<Variant>),
}

/// What `#[serde(…)]` says: keys, and their values if they have one.
pub type Serde = BTreeMap<String, Option<String>>;

pub struct Field {
    pub name: String,
    pub docs: Vec<String>,
    pub serde: Serde,
    /// Its type as written.
    pub of: String,
}

pub struct Variant {
    pub name: String,
    pub docs: Vec<String>,
    /// Marked with `#[default]`.
    pub is_default: bool,
    pub payload: Payload,
}

pub enum Payload {
    None,
    Tuple(Vec<String>),
    Fields(Vec<Field>),
}

/// Tokens of a source text.
pub fn tokenize(text: &str) -> Vec<Token> {
    let chars: Vec<char> = text.chars().collect();
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let (mut tokens, mut i) = (Vec::new(), 0);
    while i < chars.len() {
        let c = chars[i];
        if c.is_whitespace() {
            i += 1;
        } else if c == '/' && at(i + 1) == '/' {
            let end = (i..chars.len()).find(|j| chars[*j] == '\n').unwrap_or(chars.len());
            if at(i + 2) == '/' && at(i + 3) != '/' {
                let line: String = chars[i + 3..end].iter().collect();
                tokens.push(Token::Doc(line.strip_prefix(' ').unwrap_or(&line).trim_end().to_owned()));
            }
            i = end;
        } else if c == '/' && at(i + 1) == '*' {
            let mut depth = 0;
            loop {
                match (at(i), at(i + 1)) {
                    ('/', '*') => (depth, i) = (depth + 1, i + 2),
                    ('*', '/') => (depth, i) = (depth - 1, i + 2),
                    _ => i += 1,
                }
                if depth == 0 || i >= chars.len() {
                    break;
                }
            }
        } else if let Some((contents, end)) = raw_string(&chars, i) {
            tokens.push(Token::Text(contents));
            i = end;
        } else if c == '"' {
            let mut contents = String::new();
            i += 1;
            while i < chars.len() && chars[i] != '"' {
                i += usize::from(chars[i] == '\\');
                contents.push(at(i));
                i += 1;
            }
            tokens.push(Token::Text(contents));
            i += 1;
        } else if c == '\'' {
            // A character, or a lifetime.
            if at(i + 1) == '\\' {
                i = (i + 3..chars.len()).find(|j| chars[*j] == '\'').unwrap_or(chars.len()) + 1;
            } else if at(i + 2) == '\'' {
                i += 3;
            } else {
                i += 1;
            }
        } else if is_word(c) {
            let start = i;
            let number = c.is_ascii_digit();
            while is_word(at(i))
                || (number && at(i) == '.' && at(i + 1).is_ascii_digit())
                || (number && at(i) == '-' && matches!(at(i - 1), 'e' | 'E'))
            {
                i += 1;
            }
            tokens.push(Token::Word(chars[start..i].iter().collect()));
        } else {
            tokens.push(Token::Mark(c));
            i += 1;
        }
    }
    tokens
}

/// The contents of a raw string at `i`, and where it ends.
fn raw_string(chars: &[char], i: usize) -> Option<(String, usize)> {
    let prefix = usize::from(chars[i] == 'b');
    if chars.get(i + prefix) != Some(&'r')
        || (i > 0 && (chars[i - 1].is_alphanumeric() || chars[i - 1] == '_'))
    {
        return None;
    }
    let hashes = chars[i + prefix + 1..].iter().take_while(|c| **c == '#').count();
    let start = i + prefix + 1 + hashes;
    if chars.get(start) != Some(&'"') {
        return None;
    }
    let closes = |j: &usize| {
        chars[*j] == '"' && chars[j + 1..].iter().take(hashes).filter(|c| **c == '#').count() == hashes
    };
    let end = (start + 1..chars.len()).find(closes)?;
    Some((chars[start + 1..end].iter().collect(), end + 1 + hashes))
}

/// Parses a source file.
pub fn parse(path: &str, text: &str) -> Source {
    let mut source = Source { path: path.to_owned(), ..Source::default() };
    let mut parser = Parser { tokens: tokenize(text), at: 0 };
    while parser.peek().is_some() {
        parser.item(&mut source);
    }
    source
}

/// Doc comments and attributes before a declaration.
#[derive(Default)]
struct Head {
    docs: Vec<String>,
    attributes: Vec<Vec<Token>>,
}

impl Head {
    fn serde(&self) -> Serde {
        let lists = self.attributes.iter().filter(|tokens| is_word(tokens.first(), "serde"));
        let items = lists.flat_map(|tokens| split(&tokens[2..tokens.len() - 1], ','));
        let pair = |item: Vec<Token>| match (item.first(), item.get(2)) {
            (Some(Token::Word(key)), Some(Token::Text(value))) => (key.clone(), Some(value.clone())),
            (Some(Token::Word(key)), _) => (key.clone(), None),
            _ => (String::new(), None),
        };
        items.map(pair).collect()
    }

    fn derives(&self, name: &str) -> bool {
        self.attributes
            .iter()
            .any(|tokens| is_word(tokens.first(), "derive") && tokens.contains(&Token::Word(name.to_owned())))
    }

    fn is_default(&self) -> bool {
        self.attributes.iter().any(|tokens| tokens.len() == 1 && is_word(tokens.first(), "default"))
    }
}

fn is_word(token: Option<&Token>, word: &str) -> bool {
    matches!(token, Some(Token::Word(w)) if w == word)
}

/// The parts between `separator`s that are in no brackets; empty ones are left out.
pub fn split(tokens: &[Token], separator: char) -> Vec<Vec<Token>> {
    let (mut parts, mut depth) = (vec![Vec::new()], 0);
    for token in tokens {
        match token {
            Token::Mark('(' | '[' | '{' | '<') => depth += 1,
            Token::Mark(')' | ']' | '}' | '>') => depth -= 1,
            _ => {}
        }
        match token {
            Token::Mark(c) if *c == separator && depth == 0 => parts.push(Vec::new()),
            other => parts.last_mut().unwrap().push(other.clone()),
        }
    }
    parts.retain(|part| !part.is_empty());
    parts
}

/// A type, or any other tokens, as text.
fn written(tokens: &[Token]) -> String {
    let text = |token: &Token| match token {
        Token::Doc(_) => String::new(),
        Token::Word(word) => word.clone(),
        Token::Text(text) => format!("{text:?}"),
        Token::Mark(',') => ", ".to_owned(),
        Token::Mark(c) => c.to_string(),
    };
    tokens.iter().map(text).collect()
}

struct Parser {
    tokens: Vec<Token>,
    at: usize,
}

impl Parser {
    fn peek(&self) -> Option<&Token> {
        self.tokens.get(self.at)
    }

    fn peek_mark(&self, mark: char) -> bool {
        self.peek() == Some(&Token::Mark(mark))
    }

    fn next(&mut self) -> Option<Token> {
        self.at += 1;
        self.tokens.get(self.at - 1).cloned()
    }

    fn word(&mut self) -> String {
        match self.next() {
            Some(Token::Word(word)) => word,
            _ => String::new(),
        }
    }

    /// The tokens inside the brackets that begin here.
    fn bracketed(&mut self) -> Vec<Token> {
        let (start, mut depth) = (self.at + 1, 0);
        while let Some(token) = self.next() {
            match token {
                Token::Mark('(' | '[' | '{') => depth += 1,
                Token::Mark(')' | ']' | '}') => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                break;
            }
        }
        self.tokens[start.min(self.at - 1)..self.at - 1].to_vec()
    }

    /// Everything up to one of `marks`, which is left, jumping over brackets.
    fn until(&mut self, marks: &[char]) -> Vec<Token> {
        let start = self.at;
        while let Some(token) = self.peek() {
            match token {
                Token::Mark(c) if marks.contains(c) => break,
                Token::Mark('(' | '[' | '{') => drop(self.bracketed()),
                _ => self.at += 1,
            }
        }
        self.tokens[start..self.at].to_vec()
    }

    fn head(&mut self) -> Head {
        let mut head = Head::default();
        loop {
            match self.peek() {
                Some(Token::Doc(line)) => {
                    head.docs.push(line.clone());
                    self.at += 1;
                }
                Some(Token::Mark('#')) => {
                    self.at += 1;
                    self.at += usize::from(self.peek_mark('!'));
                    head.attributes.push(self.bracketed());
                }
                _ => break,
            }
        }
        if is_word(self.peek(), "pub") {
            self.at += 1;
            if self.peek_mark('(') {
                self.bracketed();
            }
        }
        head
    }

    fn item(&mut self, source: &mut Source) {
        let head = self.head();
        match self.next() {
            Some(Token::Word(word)) => match word.as_str() {
                "struct" | "enum" => self.declaration(&word, head, source),
                "fn" => {
                    let name = self.word();
                    self.until(&['{', ';']);
                    if self.peek_mark('{') {
                        let body = self.bracketed();
                        source.functions.insert(name, body);
                    }
                }
                "impl" => self.implementation(source),
                "use" => {
                    let tree = self.until(&[';']);
                    flatten(&tree, &[], &mut source.uses);
                }
                "const" if !is_word(self.peek(), "fn") => {
                    let name = self.word();
                    self.until(&['=', ';']);
                    self.at += 1;
                    let value = self.until(&[';']);
                    source.constants.insert(name, value);
                }
                _ => {}
            },
            Some(Token::Mark('(' | '[' | '{')) => {
                self.at -= 1;
                self.bracketed();
            }
            _ => {}
        }
    }

    fn declaration(&mut self, word: &str, head: Head, source: &mut Source) {
        let name = self.word();
        self.until(&['{', '(', ';']);
        if !self.peek_mark('{') {
            self.until(&[';']);
            return;
        }
        let mut body = Parser { tokens: self.bracketed(), at: 0 };
        if !head.derives("Deserialize") {
            return;
        }
        let kind = if word == "struct" { Kind::Struct(body.fields()) } else { Kind::Enum(body.variants()) };
        let mut serde = head.serde();
        if head.derives("Default") {
            serde.insert("derived default".to_owned(), None);
        }
        source.types.push(Type { name, serde, docs: head.docs, kind });
    }

    fn fields(&mut self) -> Vec<Field> {
        let mut fields = Vec::new();
        while self.peek().is_some() {
            let head = self.head();
            let name = self.word();
            self.at += 1;
            let mut of = Vec::new();
            let mut depth = 0;
            while let Some(token) = self.next() {
                match token {
                    Token::Mark(',') if depth == 0 => break,
                    Token::Mark('<' | '(' | '[') => depth += 1,
                    Token::Mark('>' | ')' | ']') => depth -= 1,
                    _ => {}
                }
                of.push(token);
            }
            let serde = head.serde();
            let name = serde.get("rename").cloned().flatten().unwrap_or(name);
            fields.push(Field { name, serde, docs: head.docs, of: written(&of) });
        }
        fields
    }

    fn variants(&mut self) -> Vec<Variant> {
        let mut variants = Vec::new();
        while self.peek().is_some() {
            let head = self.head();
            let name = head.serde().get("rename").cloned().flatten();
            let own = self.word();
            let payload = match self.peek() {
                Some(Token::Mark('(')) => {
                    Payload::Tuple(split(&self.bracketed(), ',').iter().map(|of| written(of)).collect())
                }
                Some(Token::Mark('{')) => {
                    Payload::Fields(Parser { tokens: self.bracketed(), at: 0 }.fields())
                }
                _ => Payload::None,
            };
            self.until(&[',']);
            self.at += 1;
            variants.push(Variant {
                name: name.unwrap_or(own),
                is_default: head.is_default(),
                docs: head.docs,
                payload,
            });
        }
        variants
    }

    /// Keeps the body of `impl Default for Name`.
    fn implementation(&mut self, source: &mut Source) {
        let header = self.until(&['{', ';']);
        let mut body = Parser { tokens: self.bracketed(), at: 0 };
        if let [Token::Word(default), Token::Word(_), Token::Word(name)] = header.as_slice()
            && default == "Default"
        {
            let mut inside = Source::default();
            while body.peek().is_some() {
                body.item(&mut inside);
            }
            source.defaults.extend(inside.functions.remove("default").map(|body| (name.clone(), body)));
        }
    }
}

/// The paths that a `use` tree stands for.
fn flatten(tree: &[Token], before: &[String], paths: &mut Vec<Vec<String>>) {
    let mut path = before.to_vec();
    for (i, token) in tree.iter().enumerate() {
        match token {
            Token::Word(word) if word == "as" => break,
            Token::Word(word) => path.push(word.clone()),
            Token::Mark('{') => {
                for branch in split(&tree[i + 1..tree.len() - 1], ',') {
                    flatten(&branch, &path, paths);
                }
                return;
            }
            _ => {}
        }
    }
    paths.push(path);
}

#[test]
fn declarations_are_read() {
    let source = parse(
        "a.rs",
        r##"use crate::{b::{C, D as E}, f};
        /// A lens.
        #[derive(Clone, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct Lens {
            /// Width > 0. Default 2.
            #[serde(default = "two", rename = "wide")]
            pub(super) width: Option<Vec<(f32, u8)>>,
        }
        impl Default for Lens { fn default() -> Self { Self { width: '"'.into() } } }
        /* fn two() { } /* nested */ */
        fn two<'a>() -> f32 { r#"a"b"# ; 2.5e-1 }
        #[derive(Deserialize)]
        enum Kind { #[default] None, Some(Vec3, u8), With { x: f32 } }
        const LIMIT: u32 = 7;"##,
    );
    assert_eq!(source.uses, [vec!["crate", "b", "C"], vec!["crate", "b", "D"], vec!["crate", "f"]]);
    assert_eq!(source.constants["LIMIT"], [Token::Word("7".into())]);
    let body = &source.functions["two"];
    assert_eq!(body, &[Token::Text("a\"b".into()), Token::Mark(';'), Token::Word("2.5e-1".into())]);
    assert!(source.defaults.contains_key("Lens"));
    let [lens, kind] = source.types.as_slice() else { panic!("{}", source.types.len()) };
    assert!(lens.serde.contains_key("deny_unknown_fields") && lens.docs == ["A lens."]);
    let Kind::Struct(fields) = &lens.kind else { panic!() };
    assert_eq!((fields[0].name.as_str(), fields[0].of.as_str()), ("wide", "Option<Vec<(f32, u8)>>"));
    assert_eq!(fields[0].serde["default"].as_deref(), Some("two"));
    let Kind::Enum(variants) = &kind.kind else { panic!() };
    assert!(variants[0].is_default && matches!(variants[0].payload, Payload::None));
    assert!(matches!(&variants[1].payload, Payload::Tuple(of) if of == &["Vec3", "u8"]));
    assert!(matches!(&variants[2].payload, Payload::Fields(fields) if fields[0].of == "f32"));
}
