//! What units have come to: a row each in `units.csv` and on a page, and the films whose frames are all there.

use crate::codec::file::write_bytes;
use crate::codec::film::{FilmRecorder, frame_file};
use crate::codec::png_file::read_rgb8;
use crate::codec::video::has_frames_of;
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::jobs::frames::of_name;
use crate::jobs::page;
use crate::jobs::unit::{UnitRow, scored_passes};
use crate::pass::render::FRAMES;
use crate::pass::summary::read_outcome;
use crate::scene::Orbit;
use std::collections::BTreeMap;
use std::fs;
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
    /// The films that were joined: file, frames that are there, frames of the film.
    pub films: Vec<(PathBuf, usize, u32)>,
}

/// The units whose folders are in `out`; none if it has no folder of a run.
///
/// # Errors
/// [`Error::Io`] if the folder cannot be read.
pub fn units(out: &Path) -> Result<Vec<UnitRow>> {
    let entries = fs::read_dir(out).map_err(Error::io("read", out))?;
    let mut units = Vec::new();
    for entry in entries {
        let entry = entry.map_err(Error::io("read", out))?;
        if let Some(outcome) = read_outcome(&entry.path()) {
            units.push((entry.file_name().to_string_lossy().into_owned(), outcome));
        }
    }
    units.sort_by(|a, b| a.0.cmp(&b.0));
    Ok(units)
}

/// Writes `units.csv` and joins films, `PASS.mp4` from the frames of all units of a pass; returns those with the page.
///
/// # Errors
/// [`Error::Io`] if a file cannot be written; [`Error::Input`] for frames that cannot be read.
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
        Ok(bytes) if !bytes.starts_with(b"unit,state,secs,") => {
            let problem = format!("{} is not a table that this command wrote", path.display());
            Err(Error::usage(problem, "Move it away; it is not replaced."))
        }
        _ => Ok(()),
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
            number(Some(outcome.secs), 1),
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
}

fn parts_of_films(units: &[UnitRow]) -> BTreeMap<String, FilmParts> {
    let mut films = BTreeMap::new();
    for (name, outcome) in units {
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
        let film = films.entry(pass.to_owned()).or_insert(FilmParts { fps, frames, units: Vec::new() });
        if outcome.is_finished() {
            film.units.push(name.clone());
        }
    }
    films
}

/// Joins a film whose frames are all there.
fn join(out: &Path, pass: &str, parts: &FilmParts) -> Result<(PathBuf, usize, u32)> {
    let file_of = |frame: u32| {
        let folders = parts.units.iter().map(|unit| out.join(unit).join(pass).join(FRAMES));
        folders.map(|folder| folder.join(frame_file(frame as usize))).find(|file| file.is_file())
    };
    let files: Vec<PathBuf> = (0..parts.frames).map_while(file_of).collect();
    let there = (0..parts.frames).filter(|frame| file_of(*frame).is_some()).count();
    let film = out.join(format!("{pass}.mp4"));
    if files.len() < parts.frames as usize {
        return Ok((film, there, parts.frames));
    }
    let first = read_rgb8(&files[0])?;
    if !has_frames_of([first.width(), first.height()]) {
        return Ok((film, 0, parts.frames));
    }
    let mut recorder = FilmRecorder::without_files().with_video(parts.fps);
    for file in &files {
        check_interrupted()?;
        recorder.push(read_rgb8(file)?)?;
    }
    recorder.finish()?.take_video().map_or(Ok(()), |video| video.write(&film))?;
    Ok((film, there, parts.frames))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pass::summary::Outcome;

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
    fn parts_of_a_film_are_those_of_finished_units() {
        let fields = [("frames", "48"), ("fps", "12")]
            .map(|(field, value)| (format!("passes.turn.render.orbit.{field}"), value.to_owned()));
        let with = |(name, outcome): UnitRow| (name, Outcome { fields: fields.to_vec(), ..outcome });
        let units = [
            with(unit("turn_000000-000023", "finished", &[])),
            with(unit("turn_000024-000047", "running", &[])),
            unit("vase", "finished", &[]),
        ];
        let films = parts_of_films(&units);
        let film = &films["turn"];
        assert_eq!((films.len(), film.frames, film.fps), (1, 48, 12));
        assert_eq!(film.units, ["turn_000000-000023"]);
    }
}
