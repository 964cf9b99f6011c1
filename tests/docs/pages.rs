//! Links lead somewhere, lists are complete, and the README stays short.

use super::markdown::{Page, names, pages, repository};
use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

/// Most words of the README.
const README_WORDS: usize = 1200;

/// The pages whose `rust` blocks are compiled, as doctests of `src/lib.rs`.
const RUST_PAGES: [&str; 2] = ["README.md", "docs/src/extending.md"];

#[test]
fn every_link_leads_somewhere() {
    let pages = pages();
    let mut problems = Vec::new();
    for page in &pages {
        for target in page.targets().iter().filter(|target| !target.contains("://")) {
            if let Err(problem) = follow(page, target, &pages) {
                problems.push(format!("{}: {target}: {problem}", page.path.display()));
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

fn follow(page: &Page, target: &str, pages: &[Page]) -> Result<(), &'static str> {
    let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
    let path = if file.is_empty() { page.path.clone() } else { joined(page.path.parent().unwrap(), file) };
    if !repository().join(&path).exists() {
        return Err("there is no such file");
    }
    if anchor.is_empty() {
        return Ok(());
    }
    let other = pages.iter().find(|page| page.path == path).ok_or("an anchor in a file that is no page")?;
    if other.anchors().iter().any(|known| known == anchor) { Ok(()) } else { Err("there is no such heading") }
}

/// `file` seen from `folder`, without `..`.
fn joined(folder: &Path, file: &str) -> PathBuf {
    let mut path = PathBuf::new();
    for part in folder.join(file).components() {
        match part {
            Component::ParentDir => drop(path.pop()),
            Component::CurDir => {}
            part => path.push(part),
        }
    }
    path
}

#[test]
fn readme_is_short() {
    let text = std::fs::read_to_string(repository().join("README.md")).unwrap();
    let words = text.split_whitespace().count();
    assert!(words <= README_WORDS, "README.md has {words} words; {README_WORDS} are enough");
}

/// A `rust` block anywhere else would not be compiled.
#[test]
fn rust_blocks_are_in_pages_that_are_compiled() {
    for page in pages().iter().filter(|page| !RUST_PAGES.iter().any(|path| page.path == Path::new(path))) {
        let block = page.blocks().into_iter().find(|block| block.language == "rust");
        if let Some(block) = block {
            let place = format!("{}:{}", page.path.display(), block.line);
            panic!("{place}: add the page to RUST_PAGES and to src/lib.rs");
        }
    }
}

/// The README's tables link to every example and every scene, and to nothing else there.
#[test]
fn examples_and_scenes_are_listed() {
    let text = std::fs::read_to_string(repository().join("README.md")).unwrap();
    let readme = Page { path: "README.md".into(), text };
    for folder in ["examples", "scenes"] {
        let targets = readme.targets();
        let listed: BTreeSet<&str> =
            targets.iter().filter_map(|target| target.strip_prefix(folder)?.strip_prefix('/')).collect();
        let there = names(Path::new(folder));
        assert_eq!(listed, there.iter().map(String::as_str).collect(), "{folder} in README.md");
    }
}

/// Messages that the troubleshooting chapter explains are messages that the program has.
#[test]
fn messages_exist() {
    let text = std::fs::read_to_string(repository().join("docs/src/troubleshooting.md")).unwrap();
    let mut code = String::new();
    add_code(Path::new("src"), &mut code);
    let table = text.split("\n## ").find(|section| section.starts_with("Messages")).unwrap();
    let cells =
        table.lines().filter_map(|line| line.strip_prefix("| `")).map(|row| row.split(" | ").next().unwrap());
    // Between backticks stands a message, with … for what varies.
    let messages = cells.flat_map(|cell| cell.split('`').step_by(2));
    let parts: Vec<&str> = messages.flat_map(|message| message.split('…')).map(str::trim).collect();
    let missing: Vec<&&str> = parts.iter().filter(|part| !code.contains(**part)).collect();
    assert!(missing.is_empty() && parts.len() > 8, "no message says {missing:?}");
}

/// The code below `folder`, with strings that go on in the next line joined.
fn add_code(folder: &Path, code: &mut String) {
    for name in names(folder) {
        let path = folder.join(&name);
        if repository().join(&path).is_dir() {
            add_code(&path, code);
        } else {
            let text = std::fs::read_to_string(repository().join(&path)).unwrap();
            let mut lines = text.split("\\\n");
            *code += lines.next().unwrap_or_default();
            lines.for_each(|line| *code += line.trim_start());
        }
    }
}

/// `SUMMARY.md` lists every chapter of the book.
#[test]
fn summary_lists_every_chapter() {
    let folder = Path::new("docs/src");
    let text = std::fs::read_to_string(repository().join(folder).join("SUMMARY.md")).unwrap();
    let summary = Page { path: folder.join("SUMMARY.md"), text };
    let listed: BTreeSet<String> = summary.targets().into_iter().collect();
    let chapters = names(folder).into_iter().filter(|name| name.ends_with(".md") && name != "SUMMARY.md");
    assert_eq!(listed, chapters.collect());
}
