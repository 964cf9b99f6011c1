//! Rust source as tokens: what a file imports, and how long its functions are.

use super::{MATH, repository};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A word or a mark of the source, with its line.
#[derive(Clone, Debug, PartialEq)]
pub struct Token {
    pub text: String,
    pub line: usize,
}

/// A source file below `src`, or of the kernels.
#[derive(Clone)]
pub struct Source {
    /// From the repository, with `/`.
    pub path: String,
    /// Its module: `["fit", "cameras"]` for `src/fit/cameras/mod.rs`.
    pub module: Vec<String>,
    /// The module that `crate` is: nothing for `src`, the room of the kernels for their crate.
    root: Vec<String>,
    pub tokens: Vec<Token>,
    pub lines: usize,
}

/// A path that a file names: the module or item it leads to, from the crate's root.
pub struct Import {
    pub to: Vec<String>,
    pub line: usize,
}

/// The tokens of Rust source without comments, and with each string, character and lifetime as nothing.
pub fn tokens(text: &str) -> Vec<Token> {
    let bytes: Vec<char> = text.chars().collect();
    let at = |i: usize| bytes.get(i).copied().unwrap_or('\0');
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let (mut found, mut i, mut line) = (Vec::new(), 0, 1);
    while i < bytes.len() {
        let start = i;
        let c = at(i);
        let raw_hashes = (1..).take_while(|k| at(i + k) == '#').count();
        if c == '/' && at(i + 1) == '/' {
            i += bytes[i..].iter().take_while(|c| **c != '\n').count();
        } else if c == '/' && at(i + 1) == '*' {
            i = end_of_comment(&bytes, i);
        } else if c == 'r' && at(i + 1 + raw_hashes) == '"' {
            i = end_of_raw_string(&bytes, i + 1 + raw_hashes, raw_hashes);
        } else if c == '"' {
            i = end_of_string(&bytes, i);
        } else if c == '\'' {
            i = if at(i + 1) == '\\' {
                i + 3 + bytes[i + 3..].iter().take_while(|c| **c != '\'').count() + 1
            } else if at(i + 2) == '\'' {
                i + 3
            } else {
                i + 1 + bytes[i + 1..].iter().take_while(|c| is_word(**c)).count()
            };
        } else if is_word(c) {
            i += bytes[i..].iter().take_while(|c| is_word(**c)).count();
            found.push(Token { text: bytes[start..i].iter().collect(), line });
        } else {
            i += 1;
            if !c.is_whitespace() {
                found.push(Token { text: c.to_string(), line });
            }
        }
        line += bytes[start..i.min(bytes.len())].iter().filter(|c| **c == '\n').count();
    }
    found
}

fn end_of_comment(text: &[char], start: usize) -> usize {
    let (mut depth, mut i) = (0, start);
    while i < text.len() {
        match (text[i], text.get(i + 1)) {
            ('/', Some('*')) => (depth, i) = (depth + 1, i + 2),
            ('*', Some('/')) => (depth, i) = (depth - 1, i + 2),
            _ => i += 1,
        }
        if depth == 0 {
            break;
        }
    }
    i
}

fn end_of_string(text: &[char], start: usize) -> usize {
    let mut i = start + 1;
    while i < text.len() && text[i] != '"' {
        i += if text[i] == '\\' { 2 } else { 1 };
    }
    i + 1
}

/// `quote` is where the string's first quotation mark is.
fn end_of_raw_string(text: &[char], quote: usize, hashes: usize) -> usize {
    let ends =
        |i: &usize| text[*i] == '"' && text[i + 1..].iter().take_while(|c| **c == '#').count() >= hashes;
    (quote + 1..text.len()).find(ends).map_or(text.len(), |end| end + 1 + hashes)
}

/// Index of the token after the bracket that closes the one at `open`.
pub fn after_group(tokens: &[Token], open: usize) -> usize {
    let mut depth = 0usize;
    for (i, token) in tokens.iter().enumerate().skip(open) {
        match token.text.as_str() {
            "{" | "(" | "[" => depth += 1,
            "}" | ")" | "]" => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth == 0 {
            return i + 1;
        }
    }
    tokens.len()
}

pub fn starts_with(tokens: &[Token], words: &[&str]) -> bool {
    tokens.len() >= words.len() && tokens.iter().zip(words).all(|(token, word)| token.text == *word)
}

/// The tokens without items under `#[cfg(test)]`.
fn without_tests(all: &[Token]) -> Vec<Token> {
    let mut kept = Vec::new();
    let mut i = 0;
    while i < all.len() {
        if !starts_with(&all[i..], &["#", "[", "cfg", "(", "test", ")", "]"]) {
            kept.push(all[i].clone());
            i += 1;
            continue;
        }
        i += 7;
        while starts_with(&all[i..], &["#"]) {
            i = after_group(all, i + 1);
        }
        while i < all.len() && all[i].text != ";" && all[i].text != "{" {
            i = if all[i].text == "(" { after_group(all, i) } else { i + 1 };
        }
        i = if starts_with(&all[i..], &["{"]) { after_group(all, i) } else { i + 1 };
    }
    kept
}

impl Source {
    pub fn new(path: &str, text: &str) -> Self {
        let of_kernels = path.strip_prefix(MATH);
        let root: Vec<String> = of_kernels.iter().map(|_| MATH.to_owned()).collect();
        let inside = of_kernels.unwrap_or(path).trim_start_matches('/').trim_start_matches("src/");
        let inside = inside.trim_end_matches(".rs");
        let mut module: Vec<String> = root.clone();
        module.extend(inside.split('/').map(str::to_owned));
        if module.last().is_some_and(|last| last == "mod" || last == "lib" || last == "main") {
            module.pop();
        }
        Self {
            path: path.to_owned(),
            module,
            root,
            tokens: without_tests(&tokens(text)),
            lines: text.lines().count(),
        }
    }

    pub fn room(&self) -> &str {
        self.module.first().map_or("", String::as_str)
    }

    /// The paths that the file names, whether in `use` or in its code.
    pub fn imports(&self, children: &BTreeSet<String>) -> Vec<Import> {
        let mut found = Vec::new();
        let mut i = 0;
        while i < self.tokens.len() {
            let token = &self.tokens[i];
            let inner = i > 1 && starts_with(&self.tokens[i - 2..], &[":", ":"]);
            if token.text == "use" {
                let end = self.tokens[i..].iter().position(|t| t.text == ";").map_or(i + 1, |at| i + at);
                let mut paths = Vec::new();
                flatten(&self.tokens[i + 1..end], &[], &mut paths);
                found.extend(paths.iter().filter_map(|(path, line)| self.resolved(path, *line, children)));
                i = end;
            } else if !inner && starts_with(&self.tokens[i + 1..], &[":", ":"]) {
                let mut path = vec![token.text.clone()];
                let mut next = i + 1;
                while starts_with(&self.tokens[next..], &[":", ":"]) && next + 2 < self.tokens.len() {
                    path.push(self.tokens[next + 2].text.clone());
                    next += 3;
                }
                found.extend(self.resolved(&path, token.line, children));
            }
            i += 1;
        }
        found
    }

    /// A path from the crate's root; `None` if it leads out of this project.
    fn resolved(&self, path: &[String], line: usize, children: &BTreeSet<String>) -> Option<Import> {
        let (first, rest) = path.split_first()?;
        let to = match first.as_str() {
            "lobelia_math" => vec!["math".to_owned()],
            "crate" | "lobelia" => [&self.root, rest].concat(),
            "self" => [&self.module, rest].concat(),
            "super" => {
                let ups = path.iter().take_while(|step| *step == "super").count();
                let base = self.module.len().checked_sub(ups)?;
                [&self.module[..base], &path[ups..]].concat()
            }
            child if children.contains(child) => [&self.module, path].concat(),
            _ => return None,
        };
        Some(Import { to, line })
    }
}

/// The commas from `start` to `end` that are in no inner braces.
fn commas(tree: &[Token], start: usize, end: usize) -> Vec<usize> {
    let (mut found, mut i) = (Vec::new(), start);
    while i < end {
        if tree[i].text == "," {
            found.push(i);
        }
        i = if tree[i].text == "{" { after_group(tree, i) } else { i + 1 };
    }
    found
}

/// All paths of a `use` tree.
pub fn flatten(tree: &[Token], before: &[String], found: &mut Vec<(Vec<String>, usize)>) {
    let mut path = before.to_vec();
    let mut i = 0;
    while i < tree.len() {
        match tree[i].text.as_str() {
            "{" => {
                let end = after_group(tree, i) - 1;
                let mut start = i + 1;
                for k in commas(tree, start, end).into_iter().chain([end]) {
                    flatten(&tree[start..k], &path, found);
                    start = k + 1;
                }
                return;
            }
            "as" => break,
            ":" | "*" => {}
            "self" if i > 0 || !before.is_empty() => {}
            word => path.push(word.to_owned()),
        }
        i += 1;
    }
    if let Some(token) = tree.first() {
        found.push((path, token.line));
    }
}

/// A function with the number of its lines.
#[derive(Debug, PartialEq)]
pub struct Function {
    pub lines: usize,
    pub name: String,
    pub place: String,
}

/// The functions of a file.
pub fn functions(source: &Source) -> Vec<Function> {
    let all = &source.tokens;
    let mut found = Vec::new();
    for i in 0..all.len().saturating_sub(1) {
        if all[i].text != "fn" || all[i + 1].text == "(" {
            continue;
        }
        let mut k = i + 2;
        while k < all.len() && all[k].text != "{" && all[k].text != ";" {
            k = if matches!(all[k].text.as_str(), "(" | "[") { after_group(all, k) } else { k + 1 };
        }
        if starts_with(&all[k.min(all.len())..], &["{"]) {
            let last = after_group(all, k) - 1;
            found.push(Function {
                lines: all[last].line - all[i].line + 1,
                name: all[i + 1].text.clone(),
                place: format!("{}:{}", source.path, all[i].line),
            });
        }
    }
    found
}

/// The files below `src`, without those of tests; first `lib.rs`.
pub fn sources() -> (Source, Vec<Source>) {
    let (roots, rooms): (Vec<Source>, Vec<Source>) =
        below("src").into_iter().partition(|source| source.module.is_empty());
    let library = roots.into_iter().find(|source| source.path == "src/lib.rs").unwrap();
    (library, rooms)
}

/// The files of the crate of the kernels, without those of tests; first `lib.rs`.
pub fn kernels() -> (Source, Vec<Source>) {
    let (library, rest): (Vec<Source>, Vec<Source>) =
        below(&format!("{MATH}/src")).into_iter().partition(|source| source.path.ends_with("src/lib.rs"));
    (library.into_iter().next().unwrap(), rest)
}

/// The Rust files below a folder of the repository.
fn below(folder: &str) -> Vec<Source> {
    let mut paths = Vec::new();
    walk(&repository().join(folder), &mut paths);
    paths.sort();
    let read = |path: &PathBuf| Source::new(&name_of(path), &std::fs::read_to_string(path).unwrap());
    paths.iter().map(read).collect()
}

/// A file's path from the repository, with `/`.
pub fn name_of(path: &Path) -> String {
    path.strip_prefix(repository()).unwrap().to_string_lossy().replace('\\', "/")
}

pub fn walk(folder: &Path, paths: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.file_stem().is_some_and(|stem| stem == "tests" || stem == "test_data" || stem == "target") {
            continue;
        }
        if path.is_dir() {
            walk(&path, paths);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            paths.push(path);
        }
    }
}
