//! The checkpoints of a run as files, and the state of a session between two passes.
//!
//! `OUT/.checkpoint` has `begun.json`, which says with what the run was begun, and one file for each kept [`Place`]. A file counts if it is
//! whole and of this run, and if those on the way to it are. The last two places are kept, so that there is one if the last is damaged.

use crate::checkpoint::{self, Checkpoint, Checkpoints, Place, Store, packed};
use crate::codec::file::{MOST_TEXT, is_there, read_bytes, read_parts, read_text, write_bytes, write_file};
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::fit::run::Initialize;
use crate::material::replace_materials;
use crate::math::lanes::level_name;
use crate::mesh::Surface;
use crate::mesh::triangles::Mesh;
use crate::pass::progress::Progress;
use crate::pass::session::{Chosen, Placed, Session};
use crate::ranks::Ranks;
use crate::report::scores::Scores;
use crate::sample::point::Scenery;
use crate::scene::load::LoadedScene;
use crate::scene::{Pass, Scene, Sheen};
use crate::shape::run::replace_texels;
use crate::spawn::{insert_known_along, several_materials};
use crate::survey::open::OpenScene;
use bevy_ecs::prelude::World;
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::fs;
use std::hash::{DefaultHasher, Hasher};
use std::io::{self, BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// The folder of checkpoints, in the output folder.
const FOLDER: &str = ".checkpoint";
/// What the run was begun with.
const BEGUN: &str = "begun.json";
/// The ending of checkpoints.
const ENDING: &str = ".state";
/// How a checkpoint begins: the program, and the version of its layout.
const MAGIC: [u8; 8] = *b"lobelia1";
/// Bytes of the head: the magic, the run, the checksum of the rest.
const HEAD: usize = 24;

/// What a run depends on: a resumed one must have the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct RunStart {
    version: String,
    /// Hash of the scene, with what the command line adds.
    scene: u64,
    /// Hash of the scene as it keeps to its memory.
    within_memory: u64,
    threads: usize,
    /// Hash of the views of a data set: their names, splits, cameras and files.
    #[serde(default)]
    views: u64,
    /// Hash of each file that is read.
    inputs: BTreeMap<String, u64>,
}

impl RunStart {
    /// What a run is begun with now. `scene` is the loaded one as it keeps to its memory, `data` its data set.
    ///
    /// # Errors
    /// [`Error::Io`] if an input cannot be read; [`Error::Interrupted`].
    pub fn new(loaded: &Scene, scene: &Scene, data: Option<&OpenScene>, inputs: &[PathBuf]) -> Result<Self> {
        let hash = |path: &PathBuf| {
            check_interrupted()?;
            Ok((path.to_string_lossy().into_owned(), hash_of_file(path)?))
        };
        Ok(Self {
            version: env!("LOBELIA_VERSION").into(),
            scene: hash_of(loaded),
            within_memory: hash_of(scene),
            threads: rayon::current_num_threads(),
            views: hash_of(&data.map(|data| &data.views)),
            inputs: inputs.par_iter().map(hash).collect::<Result<_>>()?,
        })
    }

    /// What the run in `out` was begun with; `None` if it has not come so far, or keeps no checkpoints.
    ///
    /// # Errors
    /// [`Error::Input`] if that cannot be read.
    pub fn read(out: &Path) -> Result<Option<Self>> {
        let path = out.join(FOLDER).join(BEGUN);
        if !is_there(&path) {
            return Ok(None);
        }
        let text = read_text(&path, MOST_TEXT, |_| String::new())?;
        let damaged = |error| Error::input(&path, "", format!("the file is damaged: {error}"), START_AGAIN);
        serde_json::from_str(&text).map(Some).map_err(damaged)
    }

    /// Checks that a run that was begun with this goes on with the same program and scene.
    ///
    /// # Errors
    /// [`Error::Usage`] that says what differs.
    pub fn check_scene(&self, scene: &Scene) -> Result<()> {
        let version = env!("LOBELIA_VERSION");
        if self.version != version {
            let problem = format!("the run was begun by version {}, and this is {version}", self.version);
            return Err(Error::usage(problem, "Resume it with that version, or start again with --force."));
        }
        if self.scene != hash_of(scene) {
            let problem = "the scene is not the one that the run was begun with";
            let help =
                "Resume it with the same scene file, --data, --set and --seed, or start again with --force.";
            return Err(Error::usage(problem, help));
        }
        Ok(())
    }

    /// Checks that it goes on with the same data; a note says that bits may differ with another number of threads.
    ///
    /// # Errors
    /// [`Error::Usage`] that says what differs.
    pub fn check_data(&self, now: &Self, progress: &dyn Progress) -> Result<()> {
        let differs = |(path, hash): &(&String, &u64)| self.inputs.get(*path) != Some(*hash);
        let lacks = |path: &&String| !now.inputs.contains_key(*path);
        let changed = now.inputs.iter().find(differs).map(|(path, _)| path);
        if let Some(path) = changed.or_else(|| self.inputs.keys().find(lacks)) {
            let problem = format!("{path} is not what it was when the run was begun");
            return Err(Error::usage(problem, "Put it back as it was, or start again with --force."));
        }
        if self.views != now.views {
            let problem =
                "the cameras or lists of views of the data set are not what they were when the run was begun";
            return Err(Error::usage(problem, "Put them back as they were, or start again with --force."));
        }
        if self.within_memory != now.within_memory {
            let problem =
                "the run was begun with other sizes of its pools, because it was allowed other memory";
            let help = "Give the same --memory, or start as many processes on a machine, or start again with --force.";
            return Err(Error::usage(problem, help));
        }
        if self.threads != now.threads {
            let text = format!(
                "the run was begun with {} threads and goes on with {}: bits may differ from those of a run without a break",
                self.threads, now.threads
            );
            progress.note(&text);
        }
        Ok(())
    }

    /// Writes it, for a run that begins; of an earlier one nothing is there ([`clear`]).
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be written.
    pub fn write(&self, out: &Path) -> Result<()> {
        let text =
            serde_json::to_string_pretty(self).map_err(|error| Error::run(BEGUN, error.to_string()))?;
        write_bytes(&out.join(FOLDER).join(BEGUN), (text + "\n").as_bytes())
    }

    /// Hash of each file that is read, as hexadecimal digits.
    pub fn inputs(&self) -> BTreeMap<String, String> {
        self.inputs.iter().map(|(path, hash)| (path.clone(), format!("{hash:016x}"))).collect()
    }

    /// What marks the checkpoints of this run.
    fn mark(&self) -> u64 {
        hash_of(self)
    }
}

/// Checks that all processes begin alike: those that do not would wait for each other forever, or find something else. `memory` says what they may take; `out` is the output folder of this one.
///
/// # Errors
/// [`Error::Usage`] that says what differs; if another process is gone.
pub(super) fn agree(
    ranks: &Ranks,
    loaded: &LoadedScene,
    (out, memory): (&Path, String),
    begun: Option<&RunStart>,
    has_finished: bool,
) -> Result<()> {
    // Those of a run that is replaced only the first process sees.
    let mut kept = if begun.is_some() { places(&out.join(FOLDER)) } else { Vec::new() };
    kept.sort_unstable();
    let state =
        if has_finished { "a finished run".to_owned() } else { format!("{:016x}", hash_of(&(begun, kept))) };
    ranks.agree(&[
        ("versions", env!("LOBELIA_VERSION").to_owned()),
        ("numbers of threads", rayon::current_num_threads().to_string()),
        ("instruction sets", level_name().to_owned()),
        ("scenes", format!("{:016x}", hash_of(&loaded.scene))),
        ("amounts of memory", memory),
        ("checkpoints to go on from", state),
    ])
}

const START_AGAIN: &str = "Start again with --force.";

/// Hash of a value as it is printed for programmers.
pub(super) fn hash_of(value: &impl Debug) -> u64 {
    let mut hashing = Hashing(DefaultHasher::new());
    // A hasher takes everything.
    let _ = write!(hashing, "{value:?}");
    hashing.0.finish()
}

fn hash_of_bytes(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    hasher.write(bytes);
    hasher.finish()
}

fn hash_of_file(path: &Path) -> Result<u64> {
    let mut hasher = DefaultHasher::new();
    read_parts(path, |part| hasher.write(part))?;
    Ok(hasher.finish())
}

/// A writer that only hashes.
struct Hashing(DefaultHasher);

impl io::Write for Hashing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Checkpoints as files.
struct Files {
    folder: PathBuf,
    mark: u64,
    /// The last place that was kept.
    last: Place,
}

impl Store for Files {
    fn write(&mut self, place: Place, checkpoint: &Checkpoint) -> Result<()> {
        let path = self.folder.join(file_name(place));
        // Twice from the state, because its bytes beside it would double what it takes.
        let mut hashing = BufWriter::with_capacity(1 << 16, Hashing(DefaultHasher::new()));
        packed::write_to(checkpoint, &mut hashing).map_err(Error::io("write", &path))?;
        let hashed = hashing.into_inner().map_err(|error| Error::io("write", &path)(error.into_error()))?;
        write_file(&path, |writer| {
            let head = [MAGIC, self.mark.to_le_bytes(), hashed.0.finish().to_le_bytes()].concat();
            let written = writer.write_all(&head).and_then(|()| packed::write_to(checkpoint, writer));
            written.map_err(Error::io("write", &path))
        })?;
        let needed = [place.route(), self.last.route()].concat();
        self.last = place;
        for old in places(&self.folder).into_iter().filter(|old| !needed.contains(old)) {
            // One that cannot be removed does no harm.
            let _ = fs::remove_file(self.folder.join(file_name(old)));
        }
        Ok(())
    }
}

fn file_name(Place { pass, level, step }: Place) -> String {
    format!("{pass}-{level}-{step}{ENDING}")
}

fn place_of(name: &str) -> Option<Place> {
    let numbers: Vec<u32> =
        name.strip_suffix(ENDING)?.split('-').map(|number| number.parse().ok()).collect::<Option<_>>()?;
    let [pass, level, step] = numbers[..] else { return None };
    Some(Place { pass, level, step })
}

/// The places of which there are files.
fn places(folder: &Path) -> Vec<Place> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|entry| place_of(&entry.file_name().to_string_lossy())).collect()
}

fn read_checkpoint(folder: &Path, place: Place, mark: u64) -> Result<Checkpoint> {
    let path = folder.join(file_name(place));
    let bytes = read_bytes(&path, |_| START_AGAIN.to_owned())?;
    let damaged = || Error::input(&path, "", "the checkpoint is damaged", START_AGAIN);
    let (head, rest) = bytes.split_at_checked(HEAD).ok_or_else(damaged)?;
    if *head != [MAGIC, mark.to_le_bytes(), hash_of_bytes(rest).to_le_bytes()].concat() {
        return Err(damaged());
    }
    packed::from_bytes(rest).map_err(|_| damaged())
}

/// The checkpoints that the run in `out` goes through to go on where it was; none if it has kept none yet.
///
/// # Errors
/// [`Error::Input`] if none of several can be used; a note tells of those that cannot.
fn find(out: &Path, mark: u64, progress: &dyn Progress) -> Result<Vec<(Place, Checkpoint)>> {
    let folder = out.join(FOLDER);
    let mut candidates = places(&folder);
    candidates.sort_unstable_by(|a, b| b.cmp(a));
    let mut first = None;
    for place in candidates {
        let way = place.route().into_iter().map(|at| Ok((at, read_checkpoint(&folder, at, mark)?)));
        match way.collect::<Result<Vec<_>>>() {
            Ok(way) => return Ok(way),
            Err(error) => {
                progress.note(&format!("{error}; the one before is taken"));
                first.get_or_insert(error);
            }
        }
    }
    first.map_or(Ok(Vec::new()), Err)
}

/// Has the session's run keep checkpoints; one that is `resumed` takes up where it was. Returns how many passes are done.
///
/// # Errors
/// [`Error::Input`] if no checkpoint can be used; [`Error::Run`] if the state is of another world.
pub(super) fn take_up(
    session: &mut Session,
    begun: &RunStart,
    resumed: bool,
    every: Duration,
) -> Result<usize> {
    let mark = begun.mark();
    let ahead = if resumed { find(&session.out, mark, session.progress)? } else { Vec::new() };
    let last = ahead.last().map_or(Place::default(), |(place, _)| *place);
    if resumed {
        session.progress.note(&words(session, last));
    }
    let files = Files { folder: session.out.join(FOLDER), mark, last };
    let world = &mut session.pipeline.world;
    world.insert_resource(Checkpoints::new(Box::new(files), every, ahead));
    restore(session, At::Pass)?;
    Ok(last.pass as usize)
}

/// Where a run goes on.
fn words(session: &Session, Place { pass, level, step }: Place) -> String {
    let Some(found) = session.scene.passes.get(pass as usize) else {
        return "all passes are done".to_owned();
    };
    let name = found.name();
    // The hull of a shape is its first part.
    let part = match found {
        Pass::Shape(_) => format!("level {level}"),
        _ => format!("part {}", level + 1),
    };
    match (level, step) {
        (0, 0) if pass == 0 => "there is no checkpoint yet: the run begins again".to_owned(),
        (0, 0) => format!("the run goes on with pass {name}"),
        (_, 0) => format!("the run goes on in pass {name}, {part}"),
        (0, step) => format!("the run goes on in pass {name} after step {step}"),
        (_, step) => format!("the run goes on in pass {name}, {part}, after step {step}"),
    }
}

/// Removes the checkpoints of an earlier run, or of one that is done, and nothing else.
///
/// # Errors
/// [`Error::Usage`] if the folder leads elsewhere; [`Error::Io`] if something cannot be removed.
pub(super) fn clear(out: &Path) -> Result<()> {
    let folder = out.join(FOLDER);
    check_folder(out)?;
    let states = places(&folder).into_iter().map(file_name);
    // Without the first, the others stand for nothing.
    for name in std::iter::once(BEGUN.to_owned()).chain(states) {
        let path = folder.join(name);
        if is_there(&path) {
            fs::remove_file(&path).map_err(Error::io("remove", &path))?;
        }
    }
    crate::codec::file::clear_scratch(&folder)?;
    // It stays if it has something else.
    let _ = fs::remove_dir(&folder);
    Ok(())
}

/// Checks that checkpoints are not written somewhere else.
///
/// # Errors
/// [`Error::Usage`] if the folder is a link.
pub(super) fn check_folder(out: &Path) -> Result<()> {
    let folder = out.join(FOLDER);
    if folder.symlink_metadata().is_ok_and(|found| found.is_symlink()) {
        let problem =
            format!("{} is a symbolic link: checkpoints would be written elsewhere", folder.display());
        return Err(Error::usage(problem, "Remove the link, or choose another folder with --out."));
    }
    Ok(())
}

/// What passes leave to those after them beside the world.
#[derive(Serialize, Deserialize)]
struct SessionState {
    initialize: Initialize,
    has_object: bool,
    several: bool,
    chosen: Chosen,
    placed: Placed,
    /// In RON, which has numbers that are not finite.
    scores: String,
    /// The surface that was found, if one was, and the width of its texture.
    surface: Option<(Mesh, u32)>,
}

/// Keeps the state of the session after so many passes.
///
/// # Errors
/// If it cannot be written.
pub(super) fn keep(session: &mut Session, done: usize) -> Result<()> {
    let state = state_of(session)?;
    checkpoint::keep_pass(&mut session.pipeline.world, done as u32, &state)
}

/// Keeps the state of the session at the beginning of a level (from 1) of a pass.
///
/// # Errors
/// If it cannot be written.
pub(super) fn keep_level(session: &mut Session, level: u32) -> Result<()> {
    let state = state_of(session)?;
    checkpoint::keep_level(&mut session.pipeline.world, level, &state)
}

fn state_of(session: &Session) -> Result<SessionState> {
    let unwritten = |error: ron::Error| Error::run("writing a checkpoint", error.to_string());
    let surface = &session.surface;
    Ok(SessionState {
        initialize: session.initialize,
        has_object: session.has_object,
        several: session.several,
        chosen: session.chosen,
        placed: session.placed,
        scores: ron::to_string(&session.scores).map_err(unwritten)?,
        surface: session.surface_found.then(|| (surface.mesh().clone(), surface.atlas().width)),
    })
}

/// Where a session is taken up.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum At {
    /// The beginning of a pass.
    Pass,
    /// The beginning of a level of the pass at work.
    Level,
}

/// Takes up the session there, if that is ahead; returns whether it was.
///
/// # Errors
/// If the checkpoint is not one of this scene.
pub(super) fn restore(session: &mut Session, at: At) -> Result<bool> {
    let mut found = None;
    let sheen = &session.scene.material.sheen;
    let prepare = |world: &mut World, state: &SessionState| {
        if let Some((mesh, width)) = &state.surface {
            found = Some(put_surface(world, mesh, *width, sheen)?);
        }
        if state.several {
            let (lobes, blend) = several_materials();
            replace_materials(world, &lobes, blend)?;
        }
        Ok(())
    };
    let world = &mut session.pipeline.world;
    let resumed = match at {
        At::Pass => checkpoint::resume_pass(world, prepare)?,
        At::Level => checkpoint::resume_level(world, prepare)?,
    };
    let Some((_, SessionState { initialize, has_object, several, chosen, placed, scores, .. })) = resumed
    else {
        return Ok(false);
    };
    let unread = |error: ron::error::SpannedError| Error::run("reading a checkpoint", error.to_string());
    session.scores = ron::from_str::<Scores>(&scores).map_err(unread)?;
    (session.initialize, session.has_object, session.several) = (initialize, has_object, several);
    (session.chosen, session.placed) = (chosen, placed);
    if let Some(surface) = found {
        (session.surface, session.surface_found) = (surface, true);
    }
    Ok(true)
}

/// Puts a surface that was found into the world, with texels that are not found yet.
fn put_surface(world: &mut World, mesh: &Mesh, width: u32, sheen: &Sheen) -> Result<Arc<Surface>> {
    let surface = Arc::new(Surface::new(mesh.clone(), width)?);
    world.insert_resource(Scenery(surface.clone()));
    insert_known_along(world, sheen, &surface)?;
    replace_texels(world, &vec![Vec3::ZERO; surface.atlas().position.len()]);
    Ok(surface)
}

#[cfg(test)]
mod tests;
