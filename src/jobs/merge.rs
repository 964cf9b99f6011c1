//! What units have come to: a row each in `units.csv` and on a page, and the films whose frames are all there.

use crate::codec::file::{is_there, write_bytes};
use crate::codec::film::{FilmRecorder, frame_file};
use crate::codec::png_file::{comment_of, read_rgb8};
use crate::codec::video::{has_frames_of, title_of};
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::jobs::frames::of_name;
use crate::jobs::page;
use crate::jobs::unit::{JoinedFilm, NOT_BEGUN, Unit, UnitRow, scored_passes};
use crate::pass::render::FRAMES;
use crate::pass::summary::{Outcome, read_outcome};
use crate::scene::Orbit;
use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// The table of the units in their folder.
pub const UNITS: &str = "units.csv";

/// What is written of many units.
#[derive(Clone, Debug, PartialEq)]
pub struct Merged {
    /// The units, by name.
    pub units: Vec<UnitRow>,
    /// How many units are in each state, in words.
    pub words: String,
    /// The page, as HTML.
    pub page: String,
    /// The films that units have parts of.
    pub films: Vec<JoinedFilm>,
}

/// The units whose folders are in `out`, and those of `named` that have none; by name.
///
/// # Errors
/// [`Error::Io`] if the folder cannot be read.
pub fn units(out: &Path, named: &[Unit]) -> Result<Vec<UnitRow>> {
    let entries = fs::read_dir(out).map_err(Error::io("read", out))?;
    let mut units = Vec::new();
    for entry in entries {
        let entry = entry.map_err(Error::io("read", out))?;
        if let Some(outcome) = read_outcome(&entry.path()) {
            units.push((entry.file_name().to_string_lossy().into_owned(), outcome));
        }
    }
    let lacks = |unit: &&Unit| units.iter().all(|(name, _)| *name != unit.name);
    let waiting = Outcome { state: NOT_BEGUN.to_owned(), ..Outcome::default() };
    let waiting: Vec<UnitRow> =
        named.iter().filter(lacks).map(|unit| (unit.name.clone(), waiting.clone())).collect();
    units.extend(waiting);
    units.sort_by(|a, b| a.0.cmp(&b.0));
    Ok(units)
}

/// Writes `units.csv` and joins films, `PASS.mp4` from the frames of all units of a pass; returns those with the page.
///
/// # Errors
/// [`Error::Usage`] if `units.csv` is not such a table; [`Error::Io`] if it cannot be read, or a file cannot be written.
pub fn merge(out: &Path, units: Vec<UnitRow>) -> Result<Merged> {
    check_table(&out.join(UNITS))?;
    write_bytes(&out.join(UNITS), table(&units)?.as_bytes())?;
    let films = parts_of_films(&units)
        .iter()
        .map(|(pass, parts)| join(out, pass, parts))
        .collect::<Result<Vec<_>>>()?;
    let page = page::page(out, &units, &films);
    Ok(Merged { words: page::words(&units), units, page, films })
}

/// Refuses to replace a table that is not one of units.
fn check_table(path: &Path) -> Result<()> {
    match fs::read(path) {
        Ok(bytes) if bytes.starts_with(b"unit,state,secs,") => Ok(()),
        Ok(_) => {
            let problem = format!("{} is not a table that this command wrote", path.display());
            Err(Error::usage(problem, "Move it away; it is not replaced."))
        }
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(Error::io("read", path)(error)),
    }
}

/// The table, with PSNR in dB, seconds and MiB; a cell without a value is empty.
fn table(units: &[UnitRow]) -> Result<String> {
    let passes = scored_passes(units);
    let mut table = csv::Writer::from_writer(Vec::new());
    let failed = |error: String| Error::run("writing units.csv", error);
    let scores = passes.iter().flat_map(|pass| [format!("{pass}_psnr"), format!("{pass}_ssim")]);
    let fixed = ["unit", "state", "secs", "peak_mib", "albedo_psnr"].map(str::to_owned);
    let header: Vec<String> = fixed.into_iter().chain(scores).chain(["error".to_owned()]).collect();
    table.write_record(&header).map_err(|error| failed(error.to_string()))?;
    for (name, outcome) in units {
        let number = |value: Option<f64>, digits: usize| {
            value.map_or_else(String::new, |value| format!("{value:.digits$}"))
        };
        let of_pass = |pass: &String| {
            let found = outcome.scores.iter().find(|(scored, _)| scored == pass).map(|(_, score)| *score);
            [number(found.map(|score| score[0]), 3), number(found.map(|score| score[1]), 5)]
        };
        let row = [
            name.clone(),
            outcome.state.clone(),
            number((outcome.state != NOT_BEGUN).then_some(outcome.secs), 1),
            number(outcome.peak_rss_mib, 0),
            number(outcome.albedo_psnr, 3),
        ];
        let row = row
            .into_iter()
            .chain(passes.iter().flat_map(of_pass))
            .chain([outcome.error.clone().unwrap_or_default()]);
        table.write_record(row).map_err(|error| failed(error.to_string()))?;
    }
    let bytes = table.into_inner().map_err(|error| failed(error.to_string()))?;
    String::from_utf8(bytes).map_err(|error| failed(error.to_string()))
}

/// A film that units have parts of.
struct FilmParts {
    fps: u32,
    frames: u32,
    /// Units that are finished.
    units: Vec<String>,
    /// What was rendered by the first of them.
    rendered: Vec<(String, String)>,
    /// The hash of each file that was read, by path, and the first unit that has read it.
    inputs: BTreeMap<String, (String, String)>,
    /// Two units that have rendered something else, and the path of a value or file that differs.
    other: Option<([String; 2], String)>,
}

impl FilmParts {
    fn none(fps: u32, frames: u32) -> Self {
        Self { fps, frames, units: vec![], rendered: vec![], inputs: BTreeMap::new(), other: None }
    }

    /// Compares what another unit has rendered, and the files that it has read, with those before it.
    fn compare(&mut self, name: &str, shown: Vec<(String, String)>, outcome: &Outcome) {
        let mut other = None;
        match self.units.first() {
            None => self.rendered = shown,
            Some(first) => {
                other =
                    difference(&self.rendered, &shown).map(|path| ([first.clone(), name.to_owned()], path));
            }
        }
        // Where two machines have a file at different paths, nothing is known of it.
        for (path, hash) in &outcome.inputs {
            let new = || (hash.clone(), name.to_owned());
            let (found, unit) = self.inputs.entry(path.clone()).or_insert_with(new);
            if found != hash && other.is_none() {
                other = Some(([unit.clone(), name.to_owned()], path.clone()));
            }
        }
        self.other = self.other.take().or(other);
    }
}

/// The values of the scene file of a unit that all units of its film have.
fn rendered(pass: &str, fields: &[(String, String)]) -> Vec<(String, String)> {
    let (own, part) = (format!("passes.{pass}."), format!("passes.{pass}.render.orbit.part"));
    let counts = |(path, _): &&(String, String)| {
        (path.starts_with(&own) || !path.starts_with("passes.")) && *path != part
    };
    fields.iter().filter(counts).cloned().collect()
}

/// The path of the first value that only one of two scene files has.
fn difference(one: &[(String, String)], other: &[(String, String)]) -> Option<String> {
    let lacks = |these: &[(String, String)], those: &[(String, String)]| {
        these.iter().find(|field| !those.contains(field)).map(|(path, _)| path.clone())
    };
    lacks(other, one).or_else(|| lacks(one, other))
}

fn parts_of_films(units: &[UnitRow]) -> BTreeMap<String, FilmParts> {
    let mut films = BTreeMap::new();
    // Of a unit that has not begun nothing is known.
    for (name, outcome) in units.iter().filter(|(_, outcome)| outcome.state != NOT_BEGUN) {
        let Some((pass, _)) = of_name(name) else { continue };
        let of_orbit = |field: &str, usual: u32| {
            let path = format!("passes.{pass}.render.orbit.{field}");
            let value = outcome.fields.iter().find(|(at, _)| *at == path).map(|(_, value)| value.parse());
            value.map_or(Some(usual), std::result::Result::ok)
        };
        let usual = Orbit::default();
        let (Some(frames), Some(fps)) = (of_orbit("frames", usual.frames), of_orbit("fps", usual.fps)) else {
            continue;
        };
        let film = films.entry(pass.to_owned()).or_insert_with(|| FilmParts::none(fps, frames));
        if !outcome.is_finished() {
            continue;
        }
        film.compare(name, rendered(pass, &outcome.fields), outcome);
        if film.units.is_empty() {
            (film.fps, film.frames) = (fps, frames);
        }
        film.units.push(name.clone());
    }
    films
}

/// Joins a film whose frames are all there. What cannot be read of it is told with the film, since the others and the page are whole without it.
fn join(out: &Path, pass: &str, parts: &FilmParts) -> Result<JoinedFilm> {
    let file = out.join(format!("{pass}.mp4"));
    let mut joined = JoinedFilm { file, frames: parts.frames, ..JoinedFilm::default() };
    match write_film(out, pass, parts, &mut joined) {
        Err(error @ (Error::Input { .. } | Error::Io { action: "read", .. })) => {
            joined.problem = Some(format!("{error}; run its unit again with --force"));
            joined.is_unreadable = true;
        }
        written => written?,
    }
    Ok(joined)
}

/// Writes a film whose frames are all there, and says of `joined` how many are, and what else is in the way.
fn write_film(out: &Path, pass: &str, parts: &FilmParts, joined: &mut JoinedFilm) -> Result<()> {
    let files = frames_of(out, pass, parts)?;
    joined.there = files.len();
    let first = files.first().filter(|_| files.len() == parts.frames as usize);
    joined.problem = obstacle(&joined.file, parts, first)?;
    if !joined.is_joined() {
        return Ok(());
    }
    let mut recorder = FilmRecorder::without_files().with_video(parts.fps);
    if let Some(comment) = files.first().and_then(comment_of) {
        recorder = recorder.with_comment(comment);
    }
    for file in &files {
        check_interrupted()?;
        recorder.push(read_rgb8(file)?)?;
    }
    recorder.finish()?.take_video().map_or(Ok(()), |video| video.write(&joined.file))
}

/// The frames that are there, in their order; of several of one number that of the first unit.
fn frames_of(out: &Path, pass: &str, parts: &FilmParts) -> Result<Vec<PathBuf>> {
    let mut found = BTreeMap::new();
    for unit in &parts.units {
        let folder = out.join(unit).join(pass).join(FRAMES);
        let files = match fs::read_dir(&folder) {
            Ok(files) => files,
            Err(error) if error.kind() == ErrorKind::NotFound => continue,
            Err(error) => return Err(Error::io("read", &folder)(error)),
        };
        for entry in files {
            let file = entry.map_err(Error::io("read", &folder))?.path();
            let number = file.file_stem().and_then(|stem| stem.to_str()?.parse().ok());
            let is_named = |number: &u32| file.file_name() == Some(frame_file(*number as usize).as_ref());
            if let Some(number) = number.filter(|number| *number < parts.frames && is_named(number)) {
                found.entry(number).or_insert(file);
            }
        }
    }
    Ok(found.into_values().collect())
}

/// Why a film cannot be joined from these parts.
fn obstacle(film: &Path, parts: &FilmParts, first: Option<&PathBuf>) -> Result<Option<String>> {
    if let Some(([unit, other], path)) = &parts.other {
        let again = "run the units of the older one again in another folder";
        return Ok(Some(format!("{unit} and {other} are of different films ({path}): {again}")));
    }
    if is_there(film) && title_of(film).is_none() {
        let problem =
            "a file of this name is there that Lobelia, or this version of it, has not written: move it away";
        return Ok(Some(problem.to_owned()));
    }
    let Some(first) = first.map(|file| read_rgb8(file)).transpose()? else { return Ok(None) };
    let is_too_large = !has_frames_of([first.width(), first.height()]);
    Ok(is_too_large.then(|| "no MP4 has frames as large as these".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(name: &str, state: &str, scores: &[(&str, f64)]) -> UnitRow {
        let scores = scores.iter().map(|(pass, psnr)| ((*pass).to_owned(), [*psnr, 0.9])).collect();
        (name.to_owned(), Outcome { state: state.into(), scores, secs: 2.0, ..Outcome::default() })
    }

    #[test]
    fn the_table_has_a_column_for_each_score_of_any_unit() {
        let failed = Outcome { error: Some("a, \"b\"".into()), ..unit("", "failed", &[]).1 };
        let units = [
            unit("a", "finished", &[("novel", 30.0)]),
            unit("b", "finished", &[("relit", 25.5)]),
            ("c".into(), failed),
        ];
        let expected = "unit,state,secs,peak_mib,albedo_psnr,novel_psnr,novel_ssim,relit_psnr,relit_ssim,error\n\
            a,finished,2.0,,,30.000,0.90000,,,\n\
            b,finished,2.0,,,,,25.500,0.90000,\n\
            c,failed,2.0,,,,,,,\"a, \"\"b\"\"\"\n";
        assert_eq!(table(&units).unwrap(), expected);
    }

    #[test]
    fn units_that_have_not_begun_are_there() {
        let folder = tempfile::tempdir().unwrap();
        let named = |name: &str| Unit {
            name: name.into(),
            scene: "a.ron".into(),
            data: None,
            sets: vec![],
            pass: None,
        };
        let units = units(folder.path(), &[named("vase"), named("jug")]).unwrap();
        assert_eq!(page::words(&units), "2 units: 2 not begun");
        assert!(table(&units).unwrap().ends_with("error\njug,not begun,,,,\nvase,not begun,,,,\n"));
    }

    #[test]
    fn parts_of_a_film_are_those_of_finished_units() {
        let with = |fps: &str, part: &str, (name, outcome): UnitRow| {
            let fields = [("frames", "48"), ("fps", fps), ("part", part)];
            let path = |field: &str| format!("passes.turn.render.orbit.{field}");
            let fields = fields.map(|(field, value)| (path(field), value.to_owned()));
            (name, Outcome { fields: fields.to_vec(), ..outcome })
        };
        let mut units = vec![
            with("12", "(0, 24)", unit("turn_000000-000023", "finished", &[])),
            with("25", "(24, 24)", unit("turn_000024-000047", "running", &[])),
            unit("vase", "finished", &[]),
        ];
        let films = parts_of_films(&units);
        let film = &films["turn"];
        assert_eq!((films.len(), film.frames, film.fps), (1, 48, 12));
        assert_eq!((film.units.len(), &film.other), (1, &None));
        units.push(with("12", "(24, 24)", unit("turn_000024-000047", "finished", &[])));
        assert_eq!(parts_of_films(&units)["turn"].other, None);
        // The first has another albedo, which is at another path on its machine; the second and a third do not agree.
        let read = |path: &str, hash: &str| [(path.to_owned(), hash.to_owned())].into();
        (units[0].1.inputs, units[3].1.inputs) = (read("a/albedo.exr", "1"), read("b/albedo.exr", "2"));
        assert_eq!(parts_of_films(&units)["turn"].other, None);
        let mut changed = with("12", "(24, 24)", unit("turn_000030-000039", "finished", &[]));
        changed.1.inputs = read("b/albedo.exr", "3");
        units.push(changed);
        let other = |first: &str, path: &str| {
            Some(([first.to_owned(), "turn_000030-000039".to_owned()], path.to_owned()))
        };
        let found = parts_of_films(&units)["turn"].other.clone();
        assert_eq!(found, other("turn_000024-000047", "b/albedo.exr"));
        *units.last_mut().unwrap() = with("25", "(30, 10)", unit("turn_000030-000039", "finished", &[]));
        let path = "passes.turn.render.orbit.fps";
        assert_eq!(parts_of_films(&units)["turn"].other, other("turn_000000-000023", path));
    }

    #[test]
    fn frames_are_found_once_whatever_else_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let parts = FilmParts { units: vec!["a".into(), "b".into(), "c".into()], ..FilmParts::none(12, 5) };
        for file in
            ["a/000003.png", "b/000003.png", "b/000001.png", "b/000007.png", "b/2.png", "b/000004.txt"]
        {
            let (unit, name) = file.split_once('/').unwrap();
            let frames = folder.path().join(unit).join("turn").join(FRAMES);
            fs::create_dir_all(&frames).unwrap();
            fs::write(frames.join(name), "").unwrap();
        }
        let found = frames_of(folder.path(), "turn", &parts).unwrap();
        let names: Vec<_> = found.iter().map(|file| file.strip_prefix(folder.path()).unwrap()).collect();
        let frame = |unit: &str, name: &str| Path::new(unit).join("turn").join(FRAMES).join(name);
        assert_eq!(names, [frame("b", "000001.png"), frame("a", "000003.png")]);
        // What cannot be read is not taken for frames that are not there.
        fs::create_dir_all(folder.path().join("c/turn")).unwrap();
        fs::write(folder.path().join("c/turn").join(FRAMES), "").unwrap();
        let film = join(folder.path(), "turn", &parts).unwrap();
        assert!(!film.is_joined() && film.words().contains(FRAMES), "{}", film.words());
    }

    #[test]
    fn only_a_table_of_units_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(UNITS);
        check_table(&path).unwrap();
        fs::write(&path, table(&[]).unwrap()).unwrap();
        check_table(&path).unwrap();
        fs::write(&path, "length,unit\n").unwrap();
        assert!(check_table(&path).unwrap_err().to_string().contains("not a table that this command wrote"));
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(check_table(&path).unwrap_err().to_string().contains(UNITS));
    }
}
