//! The checkpoints of a run as files.
//!
//! The manifest says with what the run was begun. `OUT/.checkpoint` has `pass.state` for the
//! beginning of the pass at work, unless that is the first, and `part.state` for the last part of
//! it that was done. A file counts if it is whole and of this run.

use crate::{object::Object, progress::Progress};
use crate::{scene::Scene, survey::open::OpenScene};
use lobelia_geometry::error::{Error, Result, stop::check_interrupted};
use lobelia_geometry::parallel;
use lobelia_io::codec::file::{clear_scratch, is_there, read_bytes, read_parts, write_file};
use lobelia_world::checkpoint::{Checkpoints, ResumePoint, Saved, load};
use serde::{Deserialize, Serialize};
use std::io::Write as _;
use std::{collections::BTreeMap, fmt::Debug, fs, path::Path, path::PathBuf, time::Duration};

/// The folder of checkpoints, in the output folder.
pub(super) const FOLDER: &str = ".checkpoint";
/// The checkpoint of the beginning of a pass, and that of a part of it.
const PASS: &str = "pass.state";
const PART: &str = "part.state";
/// Time between two checkpoints where nothing is said.
pub(super) const USUAL_TIME: Duration = Duration::from_secs(60);

const START_AGAIN: &str = "Start again with --force.";

/// The hash of no bytes, and that of more bytes after others: FNV-1a with 64 bits, the same in
/// every build.
const NOTHING: u64 = 0xcbf2_9ce4_8422_2325;

fn hash_on(hash: u64, bytes: &[u8]) -> u64 {
    bytes.iter().fold(hash, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3))
}

/// Hash of a value as it is printed for programmers.
fn hash_of(value: &impl Debug) -> u64 {
    hash_on(NOTHING, format!("{value:?}").as_bytes())
}

/// Dependencies of a run: a resumed one must have the same. Hashes are 16 hexadecimal digits.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct RunStart {
    pub version: String,
    /// Hash of the scene, with what the command line adds.
    #[serde(default)]
    scene_hash: String,
    /// Hash of the scene as it keeps to its memory.
    #[serde(default)]
    within_memory: String,
    #[serde(default)]
    threads: usize,
    /// Hash of the views of a data set: their names, splits, cameras and files.
    #[serde(default)]
    views: String,
    /// Hash of each photograph, mask, camera file, mesh, texture, light and ground truth that is
    /// read.
    #[serde(default)]
    inputs: BTreeMap<String, String>,
}

impl RunStart {
    /// The start of a run that is begun now. `scene` is the loaded one as it keeps to its memory,
    /// `data` its data set.
    pub fn new(loaded: &Scene, scene: &Scene, data: Option<&OpenScene>, inputs: &[PathBuf]) -> Result<Self> {
        let hash = |path: &PathBuf| {
            check_interrupted()?;
            let mut hash = NOTHING;
            read_parts(path, |part| hash = hash_on(hash, part))?;
            Ok((path.to_string_lossy().into_owned(), format!("{hash:016x}")))
        };
        Ok(Self {
            version: crate::version().into(),
            scene_hash: Self::hash(loaded),
            within_memory: Self::hash(scene),
            threads: rayon::current_num_threads(),
            views: Self::hash(&data.map(|data| &data.views)),
            inputs: parallel::map_slice(inputs, 1, hash).into_iter().collect::<Result<_>>()?,
        })
    }

    fn hash(value: &impl Debug) -> String {
        format!("{:016x}", hash_of(value))
    }

    /// Whether it is of another scene, as far as this version can tell.
    pub fn is_of_another(&self, scene: &Scene) -> bool {
        self.version == crate::version() && self.scene_hash != Self::hash(scene)
    }

    /// Checks that a run that was begun with this goes on with the same program and scene.
    pub fn check_scene(&self, scene: &Scene) -> Result<()> {
        let version = crate::version();
        if self.version != version {
            let problem = format!("the run was begun by version {}, and this is {version}", self.version);
            return other(problem, "Resume it with that version");
        }
        if self.is_of_another(scene) {
            let problem = "the scene is not the one that the run was begun with";
            return other(problem, "Resume it with the same scene file, --data, --set and --seed");
        }
        Ok(())
    }

    /// Checks that it goes on with the same data; a note says that bits may differ with another
    /// number of threads.
    pub fn check_data(&self, now: &Self, progress: &dyn Progress) -> Result<()> {
        let differs = |(path, hash): &(&String, &String)| self.inputs.get(*path) != Some(*hash);
        let lacks = |path: &&String| !now.inputs.contains_key(*path);
        let changed = now.inputs.iter().find(differs).map(|(path, _)| path);
        if let Some(path) = changed.or_else(|| self.inputs.keys().find(lacks)) {
            let problem = format!("{path} is not what it was when the run was begun");
            return other(problem, "Put it back as it was");
        }
        if self.views != now.views {
            let problem = "the cameras or lists of views are not what they were when the run was begun";
            return other(problem, "Put them back as they were");
        }
        if self.within_memory != now.within_memory {
            let problem = "the run was begun with other sizes of its pools, as it was allowed other memory";
            return other(problem, "Give the same --memory");
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
}

/// The error of a run that would go on with something else than it was begun with.
fn other(problem: impl Into<String>, remedy: &str) -> Result<()> {
    Err(Error::usage(problem, format!("{remedy}, or start again with --force.")))
}

/// The head of a checkpoint, in JSON on a line of its own; the bytes of its parts follow.
#[derive(Serialize, Deserialize)]
struct Head {
    /// Hash of the [`RunStart`] of the run.
    run: u64,
    /// The pass at work.
    pass: u32,
    /// Hash of the pass and of the names and bytes of all parts.
    hash: u64,
    parts: Vec<(String, usize)>,
}

fn hash_of_parts(pass: u32, saved: &Saved) -> u64 {
    let start = hash_on(NOTHING, &pass.to_le_bytes());
    saved.0.iter().fold(start, |hash, (name, bytes)| hash_on(hash_on(hash, name.as_bytes()), bytes))
}

/// Writes a checkpoint in place of the one before.
fn write(folder: &Path, run: u64, place: ResumePoint, saved: &Saved) -> Result<()> {
    let (pass, path) = match place {
        ResumePoint::Pass(pass) => (pass, folder.join(PASS)),
        ResumePoint::Part(pass) => (pass, folder.join(PART)),
    };
    let parts = saved.0.iter().map(|(name, bytes)| (name.clone(), bytes.len())).collect();
    let head = serde_json::to_string(&Head { run, pass, hash: hash_of_parts(pass, saved), parts })
        .map_err(|error| Error::run("writing a checkpoint", error.to_string()))?;
    write_file(&path, |writer| {
        let mut parts = saved.0.iter();
        let written = writeln!(writer, "{head}")
            .and_then(|()| parts.try_for_each(|(_, bytes)| writer.write_all(bytes)));
        written.map_err(Error::io("write", &path))
    })
}

/// The pass that a checkpoint is of, and its state.
fn read(path: &Path, run: u64) -> Result<(u32, Saved)> {
    let bytes = read_bytes(path, |_| START_AGAIN.to_owned())?;
    let saved = || {
        let end = bytes.iter().position(|byte| *byte == b'\n')?;
        let head: Head = serde_json::from_slice(&bytes[..end]).ok()?;
        let mut rest = &bytes[end + 1..];
        let mut saved = Saved::default();
        for (name, length) in head.parts {
            let (part, after) = rest.split_at_checked(length)?;
            saved.0.push((name, part.to_vec()));
            rest = after;
        }
        let is_whole = head.run == run && rest.is_empty() && head.hash == hash_of_parts(head.pass, &saved);
        is_whole.then_some((head.pass, saved))
    };
    saved().ok_or_else(|| Error::input(path, "", "the checkpoint is damaged", START_AGAIN))
}

/// The last place at which the run in a folder can be taken up, its very beginning if it has kept
/// nothing yet: the passes that are done, the state at the beginning of the next, unless that is
/// the first, and the state at the beginning of a part of it. A note tells of a part that cannot be
/// used.
///
/// # Errors
/// [`Error::Input`] if the beginning of the pass cannot be used.
fn find(folder: &Path, run: u64, progress: &dyn Progress) -> Result<(u32, Option<Saved>, Option<Saved>)> {
    let [pass, part] = [PASS, PART].map(|file| Some(folder.join(file)).filter(|file| is_there(file)));
    let (done, state) = pass.map(|path| read(&path, run)).transpose()?.unzip();
    let done = done.unwrap_or(0);
    let part = part.and_then(|path| {
        let tell = |error| progress.note(&format!("{error}; the pass begins again"));
        read(&path, run).map_err(tell).ok()
    });
    // A part of an earlier pass is of no use any more.
    Ok((done, state, part.filter(|(pass, _)| *pass == done).map(|(_, part)| part)))
}

/// Has the object's run keep checkpoints; one that is `resumed` takes up where it was. Returns how
/// many passes are done.
///
/// # Errors
/// [`Error::Input`] if no checkpoint can be used; [`Error::Run`] if the state is of another world.
pub(super) fn take_up(
    object: &mut Object,
    out: &Path,
    of: &RunStart,
    resumed: bool,
    every: Duration,
) -> Result<usize> {
    let (run, folder, progress) = (hash_of(of), out.join(FOLDER), object.progress());
    let (pass, state, part) = if resumed { find(&folder, run, &*progress)? } else { (0, None, None) };
    if resumed {
        let words = match object.scene().passes.get(pass as usize) {
            None => "all passes are done".to_owned(),
            Some(next) if part.is_some() => format!("the run goes on in pass {}", next.name()),
            Some(_) if pass == 0 => "there is no checkpoint yet: the run begins again".to_owned(),
            Some(next) => format!("the run goes on with pass {}", next.name()),
        };
        progress.note(&words);
    }
    fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    let write = move |place: ResumePoint, saved: &Saved| write(&folder, run, place, saved);
    let world = &mut object.pipeline.world;
    world.insert_resource(Checkpoints::new(Box::new(write), every, pass, part));
    state.map_or(Ok(()), |state| load(world, &state))?;
    Ok(pass as usize)
}

/// Removes the checkpoints of an earlier run, or of one that is done, and nothing else.
pub(super) fn clear(out: &Path) -> Result<()> {
    let folder = out.join(FOLDER);
    check_folder(out)?;
    for path in [PASS, PART].map(|file| folder.join(file)).iter().filter(|path| is_there(path)) {
        fs::remove_file(path).map_err(Error::io("remove", path))?;
    }
    clear_scratch(&folder)?;
    // It stays if it has something else.
    let _ = fs::remove_dir(&folder);
    Ok(())
}

/// Checks that checkpoints are not written somewhere else.
pub(super) fn check_folder(out: &Path) -> Result<()> {
    check_no_link(&out.join(FOLDER))
}

/// Refuses a folder in the output folder that is a symbolic link.
pub(super) fn check_no_link(folder: &Path) -> Result<()> {
    if folder.symlink_metadata().is_ok_and(|found| found.is_symlink()) {
        let problem =
            format!("{} is a symbolic link: the run would write outside the output folder", folder.display());
        return Err(Error::usage(problem, "Remove the link, or choose another folder with --out."));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    const RUN: u64 = 7;

    fn folder(out: &tempfile::TempDir) -> PathBuf {
        out.path().join(FOLDER)
    }

    /// A checkpoint that says where it is of.
    fn saved(text: &str) -> Saved {
        Saved(vec![("first".into(), vec![0, 255, b'\n']), ("place".into(), text.into())])
    }

    /// Checkpoints of a run that was killed in a later part of its third pass.
    fn killed() -> tempfile::TempDir {
        let out = tempfile::tempdir().unwrap();
        let places = [
            (ResumePoint::Part(0), "0-part"),
            (ResumePoint::Pass(1), "1"),
            (ResumePoint::Pass(2), "2"),
            (ResumePoint::Part(2), "2-part before"),
            (ResumePoint::Part(2), "2-part"),
        ];
        for (place, text) in places {
            write(&folder(&out), RUN, place, &saved(text)).unwrap();
        }
        out
    }

    /// The pass that a run goes on with, and the states of its beginning and of a part of it.
    fn found(out: &tempfile::TempDir) -> (u32, Option<Saved>, Option<Saved>) {
        find(&folder(out), RUN, &Silent).unwrap()
    }

    #[test]
    fn the_last_pass_and_the_last_part_of_it_are_kept() {
        let out = killed();
        assert_eq!(found(&out), (2, Some(saved("2")), Some(saved("2-part"))));
        write(&folder(&out), RUN, ResumePoint::Pass(3), &saved("3")).unwrap();
        assert_eq!(found(&out), (3, Some(saved("3")), None));
        let out = tempfile::tempdir().unwrap();
        assert_eq!(found(&out), (0, None, None));
        write(&folder(&out), RUN, ResumePoint::Part(0), &saved("0-part")).unwrap();
        assert_eq!(found(&out), (0, None, Some(saved("0-part"))));
    }

    #[test]
    fn a_damaged_part_is_left_out_and_a_damaged_beginning_refused() {
        let out = killed();
        let [pass, part] = [PASS, PART].map(|name| folder(&out).join(name));
        let whole = std::fs::read(&part).unwrap();
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 1;
            for damaged in [&bytes[..], &whole[..at]] {
                std::fs::write(&part, damaged).unwrap();
                assert_eq!(found(&out), (2, Some(saved("2")), None), "byte {at}");
            }
        }
        std::fs::write(&part, &whole).unwrap();
        let refused = |run| {
            let error = find(&folder(&out), run, &Silent).err().unwrap();
            assert!(error.exit_code() == 2 && error.to_string().contains("damaged"), "{error}");
        };
        refused(RUN + 1);
        std::fs::write(&pass, b"x").unwrap();
        refused(RUN);
    }

    #[test]
    fn a_hash_is_the_same_in_every_build() {
        assert_eq!(hash_of(&6usize), 0xaf63_ab4c_8601_9949);
        assert_eq!(hash_on(hash_on(NOTHING, b"foo"), b"bar"), 0x8594_4171_f739_67e8);
    }

    #[test]
    fn clearing_removes_checkpoints_and_nothing_else() {
        let out = killed();
        std::fs::write(folder(&out).join(".lobelia-abc.part.state"), "half").unwrap();
        clear(out.path()).unwrap();
        assert!(!out.path().join(FOLDER).exists());
        clear(out.path()).unwrap();
        std::fs::create_dir(out.path().join(FOLDER)).unwrap();
        std::fs::write(out.path().join(FOLDER).join("mine"), "x").unwrap();
        clear(out.path()).unwrap();
        assert!(out.path().join(FOLDER).join("mine").exists());
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_that_leads_elsewhere_is_refused() {
        let out = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/", out.path().join(FOLDER)).unwrap();
        assert_eq!(clear(out.path()).unwrap_err().exit_code(), 2);
    }

    fn begun() -> RunStart {
        let inputs = ["a.png", "b.png"].map(|file| (file.to_owned(), "1".to_owned())).into();
        RunStart { version: "1".into(), threads: 2, inputs, ..RunStart::default() }
    }

    #[test]
    fn other_data_are_named() {
        let refused = |change: fn(&mut RunStart)| {
            let mut now = begun();
            change(&mut now);
            let error = begun().check_data(&now, &Silent).unwrap_err();
            assert!(error.exit_code() == 2 && error.help().unwrap().contains("--force"), "{error}");
            error.to_string()
        };
        assert!(refused(|now| now.inputs.get_mut("b.png").unwrap().push('3')).starts_with("b.png"));
        assert!(refused(|now| _ = now.inputs.remove("a.png")).starts_with("a.png"));
        assert!(refused(|now| _ = now.inputs.insert("c.png".into(), "1".into())).starts_with("c.png"));
        assert!(refused(|now| now.within_memory.push('9')).contains("memory"));
        assert!(refused(|now| now.views.push('4')).contains("cameras"));
        // Another number of threads changes bits alone.
        begun().check_data(&RunStart { threads: 1, ..begun() }, &Silent).unwrap();
    }
}
