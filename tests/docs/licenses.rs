//! The list of the dependencies' licenses has every dependency, and nothing else.

use super::markdown::repository;
use std::collections::BTreeSet;

#[test]
fn licenses_of_all_dependencies_are_listed() {
    let read = |file: &str| std::fs::read_to_string(repository().join(file)).unwrap();
    let lock = read("Cargo.lock");
    // Packages of this workspace have no source.
    let packages = lock.split("[[package]]").filter(|package| package.contains("\nsource = "));
    let name = |package: &str| package.split('"').nth(1).unwrap().to_owned();
    let locked: BTreeSet<String> = packages.map(name).collect();
    let page = read("docs/licenses.md");
    let rows = page.lines().filter(|line| line.starts_with("| ") && line.contains('`'));
    let listed: BTreeSet<String> =
        rows.flat_map(|row| row.split('`').skip(1).step_by(2)).map(str::to_owned).collect();
    let missing: Vec<&String> = locked.difference(&listed).collect();
    assert!(missing.is_empty(), "docs/licenses.md lacks {missing:?}: `cargo metadata` says their licenses");
    let gone: Vec<&String> = listed.difference(&locked).collect();
    assert!(gone.is_empty() && locked.len() > 100, "docs/licenses.md has {gone:?}, which Cargo.lock has not");
}
