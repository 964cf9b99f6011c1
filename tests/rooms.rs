//! The rooms of the code, as `docs/design.md` lists them, against what the code imports.
//!
//! Source is read by a small tokenizer: comments, strings and what is only compiled for tests are left out.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Most lines of a file.
const MOST_LINES: usize = 500;
/// Most lines of a function, from `fn` to its closing brace.
const MOST_FUNCTION_LINES: usize = 50;
/// Files that their own children still import although they use their children: what both need has no file of its own yet.
const PARENTS_THAT_CHILDREN_IMPORT: [&str; 6] = [
    "src/dataset/mod.rs",
    "src/light/mod.rs",
    "src/material/mod.rs",
    "src/mesh/atlas/mod.rs",
    "src/sdf/mod.rs",
    "src/visibility/mod.rs",
];
/// The page with the table, and its section.
const PAGE: &str = "docs/design.md";
const SECTION: &str = "## Rooms";
/// The room of the crate that has the kernels.
const MATH: &str = "crates/lobelia-math";
/// An entry of the table's last column: every room above.
const ALL_ABOVE: &str = "all above";

/// A row of the table.
#[derive(Debug)]
struct Room {
    name: String,
    /// Rooms, or parts of one as `fit::loss`.
    imports: Vec<String>,
    /// Whether these are all rooms above, named as such.
    all_above: bool,
    line: usize,
}

/// A word or a mark of the source, with its line.
#[derive(Clone, Debug, PartialEq)]
struct Token {
    text: String,
    line: usize,
}

/// A source file below `src`.
struct Source {
    /// From the repository, with `/`.
    path: String,
    /// Its module: `["fit", "cameras"]` for `src/fit/cameras/mod.rs`.
    module: Vec<String>,
    tokens: Vec<Token>,
    lines: usize,
}

/// A path that a file names: the module or item it leads to, from the crate's root.
struct Import {
    to: Vec<String>,
    line: usize,
}

fn repository() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The tokens of Rust source without comments, and with each string, character and lifetime as nothing.
fn tokens(text: &str) -> Vec<Token> {
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
fn after_group(tokens: &[Token], open: usize) -> usize {
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

fn starts_with(tokens: &[Token], words: &[&str]) -> bool {
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
    fn new(path: &str, text: &str) -> Self {
        let inside = path.trim_start_matches("src/").trim_end_matches(".rs");
        let mut module: Vec<String> = inside.split('/').map(str::to_owned).collect();
        if module.last().is_some_and(|last| last == "mod" || last == "lib" || last == "main") {
            module.pop();
        }
        Self {
            path: path.to_owned(),
            module,
            tokens: without_tests(&tokens(text)),
            lines: text.lines().count(),
        }
    }

    fn room(&self) -> &str {
        self.module.first().map_or("", String::as_str)
    }

    /// The paths that the file names, whether in `use` or in its code.
    fn imports(&self, children: &BTreeSet<String>) -> Vec<Import> {
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
            "crate" | "lobelia" => rest.to_vec(),
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
fn flatten(tree: &[Token], before: &[String], found: &mut Vec<(Vec<String>, usize)>) {
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

/// The names that `src/lib.rs` brings to the crate's root, and the room each is from.
fn names_at_root(library: &Source) -> BTreeMap<String, String> {
    let mut names = BTreeMap::from([("math".to_owned(), MATH.to_owned())]);
    for (i, token) in library.tokens.iter().enumerate() {
        if token.text == "use" {
            let end = library.tokens[i..].iter().position(|t| t.text == ";").map_or(i, |at| i + at);
            let mut paths = Vec::new();
            flatten(&library.tokens[i + 1..end], &[], &mut paths);
            for (path, _) in paths {
                if let [room, .., name] = path.as_slice() {
                    names.insert(name.clone(), room.clone());
                }
            }
        }
    }
    names
}

/// The rows of the table, and what is wrong with the table itself.
fn table(page: &str) -> (Vec<Room>, Vec<String>) {
    let (mut rooms, mut problems): (Vec<Room>, Vec<String>) = (Vec::new(), Vec::new());
    let section = page.lines().enumerate().skip_while(|(_, text)| *text != SECTION).skip(1);
    for (i, text) in section.take_while(|(_, text)| !text.starts_with("## ")) {
        let cells: Vec<&str> = text.trim().trim_matches('|').split('|').map(str::trim).collect();
        let [name, _, imports] = cells.as_slice() else { continue };
        let Some(name) = name.strip_prefix('`').and_then(|name| name.strip_suffix('`')) else { continue };
        let line = i + 1;
        let above: Vec<String> = rooms.iter().map(|room| room.name.clone()).collect();
        let mut allowed = Vec::new();
        for entry in imports.split(',').map(|entry| entry.trim().trim_matches('`')) {
            let room = entry.split("::").next().unwrap_or(entry);
            if entry == ALL_ABOVE {
                allowed.extend(above.iter().cloned());
            } else if entry == "nothing" {
            } else if above.iter().any(|above| above == room) {
                allowed.push(entry.to_owned());
            } else {
                problems.push(format!(
                    "{PAGE}:{line}: `{name}` may import `{entry}`, which is no room above it: rooms import downwards only, \
                     and a lower room has a row further up"
                ));
            }
        }
        let all_above = imports.contains(ALL_ABOVE);
        rooms.push(Room { name: name.to_owned(), imports: allowed, all_above, line });
    }
    if rooms.is_empty() {
        problems.push(format!("{PAGE}: no table of rooms in the section \"{SECTION}\""));
    }
    (rooms, problems)
}

/// Rooms without a row, and rows without a room.
fn rows_and_rooms(rooms: &[Room], there: &BTreeSet<String>) -> Vec<String> {
    let mut problems = Vec::new();
    for room in there {
        if !rooms.iter().any(|row| row.name == *room) {
            problems.push(format!("{PAGE}: src/{room} has no row in the table of rooms; add one"));
        }
    }
    for row in rooms.iter().filter(|row| row.name != MATH && !there.contains(&row.name)) {
        problems.push(format!("{PAGE}:{}: there is no src/{}; take the row out", row.line, row.name));
    }
    problems
}

/// The files, and where paths lead.
struct Graph<'a> {
    sources: &'a [Source],
    at: BTreeMap<Vec<String>, usize>,
    root: BTreeMap<String, String>,
}

impl<'a> Graph<'a> {
    fn new(sources: &'a [Source], library: &Source) -> Self {
        let at = sources.iter().enumerate().map(|(i, source)| (source.module.clone(), i)).collect();
        Self { sources, at, root: names_at_root(library) }
    }

    fn imports(&self, source: &Source) -> Vec<Import> {
        let depth = source.module.len();
        let is_child =
            |module: &&Vec<String>| module.len() == depth + 1 && module.starts_with(&source.module);
        let children = self.at.keys().filter(is_child).map(|module| module[depth].clone()).collect();
        source.imports(&children)
    }

    /// The file that a path leads into.
    fn file(&self, path: &[String]) -> Option<usize> {
        (1..=path.len()).rev().find_map(|length| self.at.get(&path[..length]).copied())
    }

    /// The room that a path leads into, and the path with the room's name in front.
    fn room_path(&self, path: &[String]) -> Option<Vec<String>> {
        let first = path.first()?;
        let there = self.sources.iter().any(|source| source.room() == first);
        if there {
            return Some(path.to_vec());
        }
        match self.root.get(first)?.as_str() {
            MATH => Some([&[MATH.to_owned()], &path[1..]].concat()),
            room => Some([&[room.to_owned()], path].concat()),
        }
    }

    /// Imports of other rooms that the table does not allow.
    fn forbidden(&self, rooms: &[Room]) -> Vec<String> {
        let mut problems = Vec::new();
        for source in self.sources {
            let Some(row) = rooms.iter().find(|row| row.name == source.room()) else { continue };
            for import in self.imports(source) {
                let Some(path) = self.room_path(&import.to) else { continue };
                let path = path.join("::");
                let within = |allowed: &String| path == *allowed || path.starts_with(&format!("{allowed}::"));
                if path.split("::").next() != Some(source.room()) && !row.imports.iter().any(within) {
                    problems.push(format!(
                        "{}:{}: `{}` may not import `{path}`; move what is needed into a room below both, or allow it in \
                         {PAGE}:{}",
                        source.path, import.line, row.name, row.line
                    ));
                }
            }
        }
        problems
    }

    /// Entries of the table that no file needs.
    fn needless(&self, rooms: &[Room]) -> Vec<String> {
        let mut problems = Vec::new();
        for row in rooms.iter().filter(|row| !row.all_above && row.name != MATH) {
            let files = self.sources.iter().filter(|source| source.room() == row.name);
            let paths: Vec<String> = files
                .flat_map(|source| self.imports(source))
                .filter_map(|import| Some(self.room_path(&import.to)?.join("::")))
                .collect();
            let used = |entry: &String| {
                paths.iter().any(|path| path == entry || path.starts_with(&format!("{entry}::")))
            };
            for entry in row.imports.iter().filter(|entry| !used(entry)) {
                problems.push(format!(
                    "{PAGE}:{}: `{}` does not import `{entry}`; take it out",
                    row.line, row.name
                ));
            }
        }
        problems
    }

    /// Cycles of imports among the files of a room, each once.
    ///
    /// What the files in `parents` import of their own children does not count; one of them without such a cycle is a problem.
    fn cycles(&self, parents: &[&str]) -> Vec<String> {
        let mut edges: Vec<BTreeMap<usize, usize>> =
            (0..self.sources.len()).map(|i| self.within_room(i)).collect();
        let mut problems = Vec::new();
        let with_children = edges.clone();
        for parent in parents {
            let i = self.sources.iter().position(|source| source.path == *parent);
            if let Some(i) = i.filter(|i| shortest_cycle(&with_children, *i).is_some()) {
                edges[i].retain(|to, _| !self.sources[*to].module.starts_with(&self.sources[i].module));
            } else {
                problems.push(format!("{parent} is in no circle; take it out of the list of those that are"));
            }
        }
        let mut reported = BTreeSet::new();
        for start in 0..edges.len() {
            let Some(cycle) = shortest_cycle(&edges, start) else { continue };
            if cycle.iter().any(|i| reported.contains(i)) {
                continue;
            }
            reported.extend(cycle.iter().copied());
            let step = |(k, from): (usize, &usize)| {
                let to = cycle[(k + 1) % cycle.len()];
                format!(
                    "{}:{} imports {}",
                    self.sources[*from].path, edges[*from][&to], self.sources[to].path
                )
            };
            let steps: Vec<String> = cycle.iter().enumerate().map(step).collect();
            problems.push(format!(
                "files import each other; move what they share into a file of its own: {}",
                steps.join(", ")
            ));
        }
        problems
    }

    /// The other files of its room that a file imports, with the line.
    fn within_room(&self, i: usize) -> BTreeMap<usize, usize> {
        let source = &self.sources[i];
        let mut to = BTreeMap::new();
        for import in self.imports(source) {
            if let Some(other) = self.file(&import.to)
                && other != i
                && self.sources[other].room() == source.room()
            {
                to.entry(other).or_insert(import.line);
            }
        }
        to
    }
}

/// The shortest way from `start` back to it.
fn shortest_cycle(edges: &[BTreeMap<usize, usize>], start: usize) -> Option<Vec<usize>> {
    let mut ways = std::collections::VecDeque::from([vec![start]]);
    let mut seen = BTreeSet::new();
    while let Some(way) = ways.pop_front() {
        for next in edges[*way.last()?].keys() {
            if *next == start {
                return Some(way);
            }
            if seen.insert(*next) {
                ways.push_back([way.clone(), vec![*next]].concat());
            }
        }
    }
    None
}

/// Folders with a file of the same name beside them, and files that are too long.
fn misshapen_files(sources: &[Source]) -> Vec<String> {
    let mut problems = Vec::new();
    for source in sources {
        let folder = format!("{}/", source.path.trim_end_matches(".rs"));
        if sources.iter().any(|other| other.path.starts_with(&folder)) {
            problems.push(format!("{}: there is a folder {folder} too; make it {folder}mod.rs", source.path));
        }
        if source.lines > MOST_LINES {
            let lines = source.lines;
            problems.push(format!("{}:{MOST_LINES}: {lines} lines; split it by what it holds", source.path));
        }
    }
    problems
}

/// A function with the number of its lines.
#[derive(Debug, PartialEq)]
struct Function {
    lines: usize,
    name: String,
    place: String,
}

/// The functions of a file.
fn functions(source: &Source) -> Vec<Function> {
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
fn sources() -> (Source, Vec<Source>) {
    let mut paths = Vec::new();
    walk(&repository().join("src"), &mut paths);
    paths.sort();
    let read = |path: &PathBuf| {
        let name = path.strip_prefix(repository()).unwrap().to_string_lossy().replace('\\', "/");
        Source::new(&name, &std::fs::read_to_string(path).unwrap())
    };
    let (roots, rooms): (Vec<Source>, Vec<Source>) =
        paths.iter().map(read).partition(|source| source.module.is_empty());
    let library = roots.into_iter().find(|source| source.path == "src/lib.rs").unwrap();
    (library, rooms)
}

fn walk(folder: &Path, paths: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.file_stem().is_some_and(|stem| stem == "tests" || stem == "test_data") {
            continue;
        }
        if path.is_dir() {
            walk(&path, paths);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            paths.push(path);
        }
    }
}

fn assert_none(problems: &[String]) {
    assert!(problems.is_empty(), "{} problems:\n{}", problems.len(), problems.join("\n"));
}

#[test]
fn rooms_import_what_the_table_allows() {
    let (library, sources) = sources();
    let page = std::fs::read_to_string(repository().join(PAGE)).unwrap();
    let (rooms, mut problems) = table(&page);
    let there = sources.iter().map(|source| source.room().to_owned()).collect();
    problems.extend(rows_and_rooms(&rooms, &there));
    assert!(repository().join(MATH).is_dir(), "{MATH}");
    let graph = Graph::new(&sources, &library);
    problems.extend(graph.forbidden(&rooms));
    problems.extend(graph.needless(&rooms));
    assert_none(&problems);
}

#[test]
fn files_of_a_room_do_not_import_each_other_in_a_circle() {
    let (library, sources) = sources();
    assert_none(&Graph::new(&sources, &library).cycles(&PARENTS_THAT_CHILDREN_IMPORT));
}

#[test]
fn files_and_functions_are_short() {
    let (_, sources) = sources();
    let mut problems = misshapen_files(&sources);
    let mut functions: Vec<Function> = sources.iter().flat_map(functions).collect();
    functions.sort_by_key(|function| std::cmp::Reverse(function.lines));
    for Function { lines, name, place } in functions.iter().take(10) {
        println!("{lines:>4} lines: {name} ({place})");
    }
    for Function { lines, name, place } in functions.iter().take_while(|f| f.lines > MOST_FUNCTION_LINES) {
        problems.push(format!(
            "{place}: `{name}` has {lines} lines, more than {MOST_FUNCTION_LINES}; take a step out"
        ));
    }
    assert_none(&problems);
}

/// A table and files in which everything is wrong that the tests above look for.
#[test]
fn what_is_wrong_is_found() {
    let page = "# Design\n## Rooms\n| room | holds | may import |\n| --- | --- | --- |\n| `low` | a | `high` |\n\
                | `middle` | b | `low::plain` |\n| `high` | c | all above |\n| `gone` | d | nothing |\n## Next\n| `x` | y | z |\n";
    let (rooms, problems) = table(page);
    assert_eq!(rooms.len(), 4);
    assert!(problems.len() == 1 && problems[0].starts_with("docs/design.md:5: `low`"), "{problems:?}");
    let library = Source::new("src/lib.rs", "pub use low::{Error, Result};\npub use lobelia_math as math;");
    let middle = "// use crate::high::A;\nuse crate::{\n    Error,\n    low::{plain::B, other::{C as D, E}},\n};\n\
                  const S: &str = \"crate::high::F\"; const Q: char = '\"';\n\
                  fn g<'a>(x: &'a u8) { crate::high::h(x) }\n\
                  #[cfg(test)]\nmod tests { use crate::high::I; }\n";
    let sources = [
        Source::new("src/low/mod.rs", "mod plain;\nuse plain::B;"),
        Source::new("src/low/plain.rs", "use super::J;\npub struct B;"),
        Source::new("src/low/other.rs", "pub struct C;"),
        Source::new("src/middle.rs", middle),
        Source::new("src/middle/part.rs", &format!("fn long() {{{}}}", "\n".repeat(600))),
        Source::new("src/high.rs", "use crate::middle::K;"),
        Source::new("src/new.rs", ""),
    ];
    let there = sources.iter().map(|source| source.room().to_owned()).collect();
    let rows = rows_and_rooms(&rooms, &there);
    assert!(rows.len() == 2 && rows[0].contains("src/new") && rows[1].contains("src/gone"), "{rows:?}");
    let graph = Graph::new(&sources, &library);
    let forbidden = graph.forbidden(&rooms);
    let expected = ["low::Error", "low::other::C", "low::other::E", "high::h"];
    assert_eq!(forbidden.len(), expected.len(), "{forbidden:?}");
    for (found, path) in forbidden.iter().zip(expected) {
        assert!(found.contains(&format!("`{path}`")) && found.contains("docs/design.md:6"), "{found}");
    }
    assert!(forbidden[3].starts_with("src/middle.rs:7:"), "{}", forbidden[3]);
    assert_eq!(graph.needless(&rooms).len(), 0);
    let (spare, _) = table(&page.replace("`low::plain`", "`low::none`"));
    assert!(graph.needless(&spare)[0].starts_with("docs/design.md:6: `middle` does not import `low::none`"));
    let cycles = graph.cycles(&[]);
    assert!(
        cycles.len() == 1 && cycles[0].contains("src/low/plain.rs:1 imports src/low/mod.rs"),
        "{cycles:?}"
    );
    assert!(graph.cycles(&["src/low/mod.rs"]).is_empty());
    assert_eq!(graph.cycles(&["src/low/mod.rs", "src/high.rs"]).len(), 1);
    let files = misshapen_files(&sources);
    assert!(files.len() == 2 && files[0].contains("src/middle/mod.rs"), "{files:?}");
    let long = functions(&sources[4]);
    assert_eq!((long[0].lines, long[0].name.as_str()), (601, "long"));
}
