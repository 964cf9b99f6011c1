//! `objects.csv`: an object a row.
//!
//! | column | type | default | meaning |
//! | --- | --- | --- | --- |
//! | `scene` | path | none | the scene file |
//! | `data` | path | that of `--data` | what `$DATA` stands for |
//! | `name` | text | name of the data folder, or of the scene file | name of the unit |
//! | any other | RON | the scene's own | a value of the scene file by its path, as `--set` takes it: `passes.fit.steps` |
//!
//! Paths start from the folder of the table. An empty cell is as if its column were not there. Lines that begin with `#` are left out.

use crate::codec::file::{MOST_TEXT, read_text};
use crate::error::{Error, Result};
use crate::jobs::unit::Unit;
use csv::{ReaderBuilder, StringRecord, Trim};
use std::path::Path;

/// The units of a table.
pub(super) fn read(table: &Path, data: Option<&Path>) -> Result<Vec<Unit>> {
    let text = read_text(table, MOST_TEXT, |_| "Give a table objects.csv with a column `scene`.".to_owned())?;
    let bytes = text.trim_start_matches('\u{feff}').as_bytes();
    let mut reader = ReaderBuilder::new().trim(Trim::All).comment(Some(b'#')).from_reader(bytes);
    let wrong = |problem: String| Error::usage(format!("{}: {problem}", table.display()), HELP);
    let columns = reader.headers().map_err(|error| wrong(error.to_string()))?.clone();
    if !columns.iter().any(|column| column == "scene") {
        return Err(wrong("there is no column `scene`".into()));
    }
    if let Some(column) = columns
        .iter()
        .enumerate()
        .find(|(i, c)| c.is_empty() || columns.iter().take(*i).any(|other| other == *c))
    {
        return Err(wrong(format!("column {} has no name of its own", column.0 + 1)));
    }
    let folder = table.parent().unwrap_or(Path::new(""));
    let unit = |row: csv::Result<StringRecord>| {
        let row = row.map_err(|error| wrong(error.to_string()))?;
        let line = row.position().map_or(0, csv::Position::line);
        unit_of(&columns, &row, folder, data).ok_or_else(|| wrong(format!("line {line} says no scene file")))
    };
    let units: Vec<Unit> = reader.records().map(unit).collect::<Result<_>>()?;
    if units.is_empty() { Err(wrong("there are no rows".into())) } else { Ok(units) }
}

const HELP: &str = "Columns are `scene`, `data`, `name`, and values of the scene file by their paths, e.g. `passes.fit.steps`.";

/// The unit of a row; `None` if it says no scene.
fn unit_of(columns: &StringRecord, row: &StringRecord, folder: &Path, data: Option<&Path>) -> Option<Unit> {
    let cell = |name: &str| {
        let at = columns.iter().position(|column| column == name)?;
        row.get(at).filter(|cell| !cell.is_empty())
    };
    let scene = folder.join(cell("scene")?);
    let own = cell("data").map(|cell| folder.join(cell));
    let of_path = || own.as_deref().map_or(scene.file_stem(), Path::file_name);
    let usual = || of_path().map(|name| name.to_string_lossy().into_owned());
    let name = cell("name").map(str::to_owned).or_else(usual);
    let sets = columns
        .iter()
        .zip(row)
        .filter(|(column, cell)| !cell.is_empty() && !["scene", "data", "name"].contains(column));
    Some(Unit {
        name: name.unwrap_or_default(),
        data: own.or(data.map(Path::to_owned)),
        sets: sets.map(|(path, value)| (path.to_owned(), value.to_owned())).collect(),
        scene,
        pass: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn read_text(text: &str) -> Result<Vec<Unit>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("objects.csv");
        fs::write(&path, text).unwrap();
        let mut units = read(&path, Some(Path::new("/common")))?;
        for unit in &mut units {
            unit.scene = unit.scene.strip_prefix(folder.path()).unwrap_or(&unit.scene).to_owned();
            unit.data =
                unit.data.take().map(|data| data.strip_prefix(folder.path()).unwrap_or(&data).to_owned());
        }
        Ok(units)
    }

    #[test]
    fn rows_are_units_and_further_columns_values_of_the_scene() {
        let text = "\u{feff}scene, data, name, passes.fit.steps, up\n# a comment\nobject.ron, photos/vase.1,, 200,\n/all/photos.ron,,jug 2,,\"(0, 0, 1)\"\n";
        let units = read_text(text).unwrap();
        let set = |path: &str, value: &str| vec![(path.to_owned(), value.to_owned())];
        let first = Unit {
            name: "vase.1".into(),
            scene: "object.ron".into(),
            data: Some("photos/vase.1".into()),
            sets: set("passes.fit.steps", "200"),
            pass: None,
        };
        let second = Unit {
            name: "jug 2".into(),
            scene: "/all/photos.ron".into(),
            data: Some("/common".into()),
            sets: set("up", "(0, 0, 1)"),
            pass: None,
        };
        assert_eq!(units, [first, second]);
    }

    #[test]
    fn what_is_wrong_is_said_with_its_place() {
        for (text, words) in [
            ("data\na\n", "no column `scene`"),
            ("scene,scene\na,b\n", "column 2"),
            ("scene,data\n", "no rows"),
            ("scene,data\na.ron,b\n,c\n", "line 3"),
            ("scene,data\na.ron\n", "line: 2"),
        ] {
            let error = read_text(text).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("objects.csv"), "{error}");
        }
    }
}
