//! The rooms of the code, as `docs/design.md` lists them, against what the code imports.
//!
//! Source is read by a small tokenizer: comments, strings and what is only compiled for tests are left out.

mod graph;
mod source;
mod table;
mod types;

use graph::Graph;
use source::{Function, Source, functions, kernels, name_of, sources, walk};
use std::path::PathBuf;
use table::{rows_and_rooms, table};
use types::shared_names;

/// Most lines of a file.
const MOST_LINES: usize = 500;
/// Most lines of a function, from `fn` to its closing brace.
const MOST_FUNCTION_LINES: usize = 40;
/// Folders of Rust files beside `src` and the crates.
const OTHER_FOLDERS: [&str; 4] = ["tests", "examples", "benches", "fuzz"];
/// The page with the table, and its section.
const PAGE: &str = "docs/design.md";
const SECTION: &str = "## Rooms";
/// The room of the crate that has the kernels.
const MATH: &str = "crates/lobelia-math";
/// An entry of the table's last column: every room above.
const ALL_ABOVE: &str = "all above";
/// Names that two visible types may share, each with the reason.
const SHARED_NAMES: [(&str, &str); 1] =
    [("Surface", "a word of scene files, and the name of the prelude for what is traced")];

fn repository() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
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
    let (library, rooms) = sources();
    assert_none(&Graph::new(&rooms, &library).cycles());
    let (library, files) = kernels();
    assert_none(&Graph::new(&files, &library).cycles());
}

#[test]
fn files_and_functions_are_short() {
    let sources = [sources().1, kernels().1].concat();
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

#[test]
fn visible_types_have_names_of_their_own() {
    assert_none(&shared_names(&sources().1, &SHARED_NAMES));
}

#[test]
fn tests_and_examples_are_short_files() {
    let mut paths = Vec::new();
    OTHER_FOLDERS.iter().for_each(|folder| walk(&repository().join(folder), &mut paths));
    let lines = |path: &PathBuf| std::fs::read_to_string(path).unwrap().lines().count();
    let long = paths.iter().map(|path| (name_of(path), lines(path))).filter(|(_, lines)| *lines > MOST_LINES);
    let long: Vec<String> = long.map(|(name, lines)| format!("{name}: {lines} lines; split it")).collect();
    assert_none(&long);
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
    let cycles = graph.cycles();
    assert!(
        cycles.len() == 1 && cycles[0].contains("src/low/plain.rs:1 imports src/low/mod.rs"),
        "{cycles:?}"
    );
    let kernels = ["use crate::b::X;", "use super::a::Y;"].into_iter().zip(["a", "b"]);
    let kernels: Vec<Source> =
        kernels.map(|(text, name)| Source::new(&format!("{MATH}/src/{name}.rs"), text)).collect();
    assert_eq!(Graph::new(&kernels, &library).cycles().len(), 1);
    let files = misshapen_files(&sources);
    assert!(files.len() == 2 && files[0].contains("src/middle/mod.rs"), "{files:?}");
    let long = functions(&sources[4]);
    assert_eq!((long[0].lines, long[0].name.as_str()), (601, "long"));
}

/// Two visible types of one name, beside names that only look shared: private, of a function, in tests, and from a macro.
#[test]
fn types_of_one_name_are_found() {
    let sources = [
        Source::new(
            "src/one.rs",
            "pub struct A;\npub(crate) enum B { A }\nstruct C;\npub trait D {}\npub struct $name;",
        ),
        Source::new("src/two.rs", "pub(super) type A = u8;\npub fn d() {}\npub struct C;\npub struct $name;"),
        Source::new(
            "src/three.rs",
            "#[cfg(test)]\nmod tests { pub struct C; }\n// pub struct B;\npub unsafe trait D {}",
        ),
    ];
    let found = shared_names(&sources, &[("D", "known"), ("E", "gone")]);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[0].starts_with("src/one.rs:1: type `A`") && found[0].contains("src/two.rs:1"), "{found:?}");
    assert!(found[1].contains("`E` (gone)"), "{found:?}");
}
