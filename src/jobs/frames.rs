//! The frames of films, so many a unit: of the film of pass `turn`, `turn_000000-000023` has the first 24.

use crate::error::{Error, Result};
use crate::jobs::unit::Unit;
use crate::scene::load::load;
use crate::scene::{EditPass, LoadOptions, Orbit, Pass, RelightPass, RenderPass};
use std::ops::Range;
use std::path::Path;

/// The film of a pass, if it makes one.
fn film_of(pass: &Pass) -> Option<&Orbit> {
    match pass {
        Pass::Render(RenderPass { render, .. })
        | Pass::Edit(EditPass { render, .. })
        | Pass::Relight(RelightPass { render, .. }) => render.orbit.as_ref(),
        _ => None,
    }
}

/// The name of the unit of some frames.
fn name_of(pass: &str, frames: &Range<u32>) -> String {
    format!("{pass}_{:06}-{:06}", frames.start, frames.end - 1)
}

/// The pass and the frames of a unit of this name.
pub(super) fn of_name(unit: &str) -> Option<(&str, Range<u32>)> {
    let (pass, frames) = unit.rsplit_once('_')?;
    let (first, last) = frames.split_once('-')?;
    let (first, last): (u32, u32) = (first.parse().ok()?, last.parse().ok()?);
    let range = first..last.checked_add(1)?;
    // As it is written here, and in no other way.
    (first <= last && name_of(pass, &range) == unit).then_some((pass, range))
}

/// The units of the films of a scene file.
pub(super) fn of_films(scene: &Path, data: Option<&Path>, frames: u32) -> Result<Vec<Unit>> {
    let films = films(scene, data)?;
    let parts = films.iter().flat_map(|(pass, count)| {
        let firsts = (0..*count).step_by(frames.max(1) as usize);
        firsts
            .map(move |first| unit(scene, data, pass, first..count.min(&(first + frames.max(1))).to_owned()))
    });
    Ok(parts.collect())
}

/// The unit of this name of a scene file.
pub(super) fn named(scene: &Path, data: Option<&Path>, name: &str) -> Result<Unit> {
    let films = films(scene, data)?;
    let is_there = |(pass, frames): &(&str, Range<u32>)| {
        films.iter().any(|(film, count)| film == pass && frames.end <= *count)
    };
    let (pass, frames) = of_name(name).filter(is_there).ok_or_else(|| {
        let first = films.first().map(|(pass, count)| name_of(pass, &(0..*count))).unwrap_or_default();
        let problem = format!("--only {name}: {} has no film with these frames", scene.display());
        Error::usage(
            problem,
            format!("Say its pass, its first frame and its last, as {first}; `lobelia list` names units."),
        )
    })?;
    Ok(unit(scene, data, pass, frames))
}

fn unit(scene: &Path, data: Option<&Path>, pass: &str, frames: Range<u32>) -> Unit {
    let orbit = format!("passes.{pass}.render.orbit");
    Unit {
        name: name_of(pass, &frames),
        scene: scene.to_owned(),
        data: data.map(Path::to_owned),
        sets: vec![
            (format!("{orbit}.part"), format!("({}, {})", frames.start, frames.len())),
            (format!("{orbit}.format"), "Frames".to_owned()),
            // Views beside the film would be rendered by each unit.
            (format!("passes.{pass}.render.views"), "Named([])".to_owned()),
        ],
        pass: Some(pass.to_owned()),
    }
}

/// The names of the passes of a scene file that make films, with the numbers of frames.
fn films(scene: &Path, data: Option<&Path>) -> Result<Vec<(String, u32)>> {
    let options = LoadOptions { data: data.map(Path::to_owned), ..LoadOptions::default() };
    let passes = load(scene, &options)?.scene.passes;
    let shown = scene.display();
    if let Some(pass) = passes.iter().find(|pass| matches!(pass, Pass::Fit(_) | Pass::Shape(_))) {
        let problem =
            format!("{shown}: each unit of a film would find the object anew, in pass {}", pass.name());
        let help = "Run the scene with a `Save`; films of what it saved are units. Objects are: give their folder or table.";
        return Err(Error::usage(problem, help));
    }
    let is_numbered = |pass: &&Pass| film_of(pass).is_some() && pass.name().parse::<usize>().is_ok();
    if let Some(pass) = passes.iter().find(is_numbered) {
        let problem = format!("{shown}: pass {:?} makes a film, and its name is a number", pass.name());
        // `passes.7` is the eighth pass.
        return Err(Error::usage(problem, "Give it a name with a letter: units replace its values by that."));
    }
    let films = passes.iter().filter_map(|pass| Some((pass.name().to_owned(), film_of(pass)?.frames)));
    let films: Vec<(String, u32)> = films.collect();
    if films.is_empty() {
        let help = "Give a scene file with an `orbit`, a folder of scene files, or a table objects.csv.";
        return Err(Error::usage(format!("{shown} makes no film"), help));
    }
    Ok(films)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_frames_are_read_as_they_are_written() {
        assert_eq!(of_name("turn_000024-000047"), Some(("turn", 24..48)));
        assert_eq!(of_name("a_b_000000-000000"), Some(("a_b", 0..1)));
        for wrong in ["turn", "turn_24-47", "turn_000047-000024", "turn_000001", "turn_0000x1-000002"] {
            assert_eq!(of_name(wrong), None, "{wrong}");
        }
    }
}
