//! Which file imports which: against the table of rooms, and in circles.

use super::source::{Import, Source, flatten};
use super::table::Room;
use super::{MATH, PAGE};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

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

/// The files, and where paths lead.
pub struct Graph<'a> {
    sources: &'a [Source],
    at: BTreeMap<Vec<String>, usize>,
    root: BTreeMap<String, String>,
}

impl<'a> Graph<'a> {
    pub fn new(sources: &'a [Source], library: &Source) -> Self {
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
    pub fn forbidden(&self, rooms: &[Room]) -> Vec<String> {
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
    pub fn needless(&self, rooms: &[Room]) -> Vec<String> {
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
    pub fn cycles(&self) -> Vec<String> {
        let edges: Vec<BTreeMap<usize, usize>> =
            (0..self.sources.len()).map(|i| self.within_room(i)).collect();
        let mut problems = Vec::new();
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
    let mut ways = VecDeque::from([vec![start]]);
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
