//! The table of rooms in `docs/design.md`.

use super::{ALL_ABOVE, MATH, PAGE, SECTION};
use std::collections::BTreeSet;

/// A row of the table.
#[derive(Debug)]
pub struct Room {
    pub name: String,
    /// Rooms, or parts of one as `fit::loss`.
    pub imports: Vec<String>,
    /// Whether these are all rooms above, named as such.
    pub all_above: bool,
    pub line: usize,
}

/// The rows of the table, and what is wrong with the table itself.
pub fn table(page: &str) -> (Vec<Room>, Vec<String>) {
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
                    "{PAGE}:{line}: `{name}` may import `{entry}`, which is no room above it: rooms import downward only, \
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
pub fn rows_and_rooms(rooms: &[Room], there: &BTreeSet<String>) -> Vec<String> {
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
