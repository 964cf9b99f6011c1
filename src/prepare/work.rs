//! The output folder of a preparation: nothing gets its final name before all of it is done, and
//! what was done is not done again. And other programs at work: their output goes to log files that
//! are read meanwhile, and Ctrl-C stops them.

use crate::progress::Progress;
use lobelia_geometry::{Error, Result, error::stop::check_interrupted};
use lobelia_io::codec::file::{FolderLock, is_there, read_folder, write_bytes};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::{ffi::OsStr, ffi::OsString, fs, fs::File, io::ErrorKind, io::Read as _, time::Duration};

/// Names of what a prepared data set consists of.
const FINISHED: [&str; 4] = ["images", "masks", "sparse", "scene.ron"];
/// Where work in progress lies, inside the output folder.
const WORK: &str = ".work";
/// Where the output of programs goes.
const LOGS: &str = "logs";

/// An output folder with work in progress.
pub(super) struct Work<'a> {
    out: PathBuf,
    pub progress: &'a dyn Progress,
    /// The settings of all steps so far, each after the steps that it depends on.
    settings: String,
    /// Whether a step was done again, after which no later one holds.
    stale: bool,
    lock: FolderLock,
}

impl<'a> Work<'a> {
    /// Takes `out`, which is new, empty, or holds work in progress.
    pub fn claim(out: &Path, progress: &'a dyn Progress) -> Result<Self> {
        let mut names = Vec::new();
        if is_there(out) {
            for entry in read_folder(out)? {
                names.push(entry.map_err(Error::io("read", out))?.file_name());
            }
        }
        let has = |name: &str| names.iter().any(|there| there == name);
        let is_ours = |name: &OsString| [WORK, LOGS].iter().chain(&FINISHED).any(|ours| name == ours);
        if let Some(other) = names.iter().find(|name| !(has(WORK) && is_ours(name))) {
            let (out, other) = (out.display(), other.display());
            let problem = format!("the output folder {out} is not empty: it has {other}");
            let help = match FINISHED.iter().all(|name| *name == "masks" || has(name)) {
                true => "It holds a data set that is finished; for other options, give another folder.",
                false => "Give a folder that is new or empty.",
            };
            return Err(Error::usage(problem, help));
        }
        make_folder(&out.join(WORK))?;
        make_folder(&out.join(LOGS))?;
        let lock = FolderLock::take(&out.join(WORK))?;
        Ok(Self { out: out.to_owned(), progress, settings: String::new(), stale: false, lock })
    }

    /// A path of work in progress.
    pub fn path(&self, name: &str) -> PathBuf {
        self.out.join(WORK).join(name)
    }

    /// The log of a step.
    pub fn log(&self, name: &str) -> PathBuf {
        self.out.join(LOGS).join(format!("{name}.log"))
    }

    /// Does a step, unless it was done with the same settings before, and so were all steps before
    /// it.
    pub fn step(&mut self, name: &str, settings: &str, step: impl FnOnce(&Self) -> Result<()>) -> Result<()> {
        self.settings += &format!("{name}: {settings}\n");
        let stamp = self.path(&format!("{name}.done"));
        if !self.stale && fs::read_to_string(&stamp).is_ok_and(|done| done == self.settings) {
            return Ok(());
        }
        self.stale = true;
        remove(&stamp)?;
        step(self)?;
        write_bytes(&stamp, self.settings.as_bytes())
    }

    /// Runs a program under a bar of `length` steps; `done` reads from a line of its output how
    /// many are finished.
    pub fn run(
        &self,
        name: &str,
        program: &Program,
        words: &[OsString],
        length: u64,
        done: impl Fn(&str) -> Option<u64>,
    ) -> Result<()> {
        let bar = self.progress.bar(name, length);
        let watch = |line: &str| done(line).iter().for_each(|at| bar.set_position(*at));
        program.run(words, &self.log(name), watch)
    }

    /// An empty folder of work in progress, whatever an earlier run left there.
    pub fn emptied(&self, name: &str) -> Result<PathBuf> {
        let folder = self.path(name);
        remove(&folder)?;
        make_folder(&folder)?;
        Ok(folder)
    }

    /// Gives finished work its final name. What already has it, from an earlier run that was
    /// stopped, stays.
    pub fn publish(&self, from: &str, name: &str) -> Result<()> {
        let (from, to) = (self.path(from), self.out.join(name));
        if !from.exists() && to.exists() {
            return Ok(());
        }
        make_folder_of(&to)?;
        // An older result of work in progress, by other settings, is no longer one.
        remove(&to)?;
        fs::rename(from, &to).map_err(Error::io("create", &to))
    }

    /// Removes what the work needed.
    pub fn finish(self) -> Result<()> {
        let Self { out, lock, .. } = self;
        drop(lock);
        remove(&out.join(WORK))
    }
}

/// Creates a folder and those around it, unless they exist.
pub(super) fn make_folder(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).map_err(Error::io("create folder", folder))
}

/// Creates the folder that a file is to lie in.
pub(super) fn make_folder_of(file: &Path) -> Result<()> {
    file.parent().map_or(Ok(()), make_folder)
}

/// Removes a file or folder, if it exists.
pub(super) fn remove(path: &Path) -> Result<()> {
    let removed = match path.symlink_metadata() {
        Ok(metadata) if metadata.is_dir() => fs::remove_dir_all(path),
        Ok(_) => fs::remove_file(path),
        Err(error) => Err(error),
    };
    match removed {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::io("remove", path)(error)),
        _ => Ok(()),
    }
}

/// Lines of a failed program's output that its error quotes, and most characters of each.
const QUOTED_LINES: usize = 3;
const QUOTED_CHARS: usize = 300;
/// Longest pause between two looks at a working program.
const LONGEST_PAUSE: Duration = Duration::from_millis(100);

/// A program that may or may not be installed.
pub(super) struct Program {
    /// A name on the PATH, or a path.
    pub path: PathBuf,
    /// Help where it is missing.
    pub install: &'static str,
}

impl Program {
    /// The program's help: both streams, whatever its exit status.
    pub fn help(&self, arguments: &[&str]) -> Result<String> {
        let output = self.command().args(arguments).output().map_err(|error| self.cannot_start(&error))?;
        Ok(String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned())
    }

    /// Runs the program to its end. `watch` gets each line of its output soon after it is written;
    /// `log` keeps them all.
    pub fn run(&self, arguments: &[OsString], log: &Path, mut watch: impl FnMut(&str)) -> Result<()> {
        let file = File::create(log).map_err(Error::io("write", log))?;
        let twin = file.try_clone().map_err(Error::io("write", log))?;
        let started = self.command().args(arguments).stdout(file).stderr(twin).spawn();
        let mut running = Running(started.map_err(|error| self.cannot_start(&error))?);
        let mut output = File::open(log).map_err(Error::io("read", log))?;
        let (mut rest, mut pause) = (Vec::new(), Duration::from_millis(2));
        let status = loop {
            let ended = running.0.try_wait();
            let ended = ended.map_err(|error| Error::run("waiting for a program", error.to_string()))?;
            output.read_to_end(&mut rest).map_err(Error::io("read", log))?;
            if let Some(end) = rest.iter().rposition(|byte| *byte == b'\n') {
                let whole: Vec<u8> = rest.drain(..=end).collect();
                String::from_utf8_lossy(&whole).lines().for_each(&mut watch);
            }
            if let Some(status) = ended {
                break status;
            }
            check_interrupted()?;
            std::thread::sleep(pause);
            pause = (2 * pause).min(LONGEST_PAUSE);
        };
        if status.success() {
            return Ok(());
        }
        // Ctrl-C reaches the program as well: it may be gone before this one has heard of it.
        std::thread::sleep(LONGEST_PAUSE);
        check_interrupted()?;
        let command = arguments.first().map(|word| word.to_string_lossy());
        let command = command.filter(|command| !command.starts_with('-'));
        let command = command.map(|command| format!(" {command}")).unwrap_or_default();
        let name = format!("{}{command}", self.path.file_name().unwrap_or_default().display());
        let output = fs::read(log).unwrap_or_default();
        let output = String::from_utf8_lossy(&output);
        let lines = output.lines().map(str::trim).filter(|line| line.chars().any(char::is_alphanumeric));
        let lines: Vec<String> = lines.map(|line| line.chars().take(QUOTED_CHARS).collect()).collect();
        let mut said = lines[lines.len().saturating_sub(QUOTED_LINES)..].join("\n");
        if said.is_empty() {
            said = "it gave no reason".to_owned();
        }
        let problem = format!("it failed ({status}): {said}\nIts whole output is in {}", log.display());
        Err(Error::run(name, problem))
    }

    /// A command without input. COLMAP opens a display only to use a GPU; it must not fail where
    /// there is none.
    fn command(&self) -> Command {
        let mut command = Command::new(&self.path);
        command.stdin(Stdio::null());
        if std::env::var_os("QT_QPA_PLATFORM").is_none() {
            command.env("QT_QPA_PLATFORM", "offscreen");
        }
        command
    }

    fn cannot_start(&self, error: &std::io::Error) -> Error {
        let path = self.path.display();
        let problem = match error.kind() {
            ErrorKind::NotFound if self.path.components().count() == 1 => {
                format!("there is no program `{path}` on the PATH")
            }
            ErrorKind::NotFound => format!("there is no program {path}"),
            _ => format!("the program {path} cannot be started: {error}"),
        };
        Error::usage(problem, self.install)
    }
}

/// The words of a command line; values follow their options.
pub(super) fn words(command: &str, options: &[(&str, &dyn AsRef<OsStr>)]) -> Vec<OsString> {
    let options = options.iter().flat_map(|(option, value)| [OsStr::new(option), value.as_ref()]);
    std::iter::once(OsStr::new(command)).chain(options).map(OsStr::to_owned).collect()
}

/// A program at work, which ends at the latest when this is dropped.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // Neither has an effect on a program that has ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::{prepare::tests::script, progress::Silent};
    use std::time::Instant;

    fn claim(out: &Path) -> Result<Work<'static>> {
        Work::claim(out, &Silent)
    }

    #[track_caller]
    fn refused(out: &Path, words: &str) {
        let error = claim(out).err().unwrap();
        assert!(error.to_string().contains(words) && error.exit_code() == 2, "{error}");
    }

    #[test]
    fn steps_are_done_once_until_their_settings_change() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("new/out");
        for (settings, expected) in [("111", "abc"), ("111", ""), ("121", "bc"), ("111", "bc")] {
            let (mut work, mut done) = (claim(&out).unwrap(), String::new());
            for (name, settings) in ["a", "b", "c"].into_iter().zip(settings.chars()) {
                work.step(name, &settings.to_string(), |_| {
                    done += name;
                    Ok(())
                })
                .unwrap();
            }
            assert_eq!(done, expected, "{settings}");
        }
    }

    #[test]
    fn a_folder_with_other_files_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        fs::create_dir(out.join("images")).unwrap();
        refused(out, "is not empty: it has images");
        assert!(!out.join(WORK).exists());
        // Work in progress may have published part of its results, and nothing else.
        fs::create_dir(out.join(WORK)).unwrap();
        let work = claim(out).unwrap();
        refused(out, "another run");
        drop(work);
        fs::write(out.join("thesis.txt"), "x").unwrap();
        refused(out, "thesis.txt");
        refused(&out.join("thesis.txt"), "is a file");
    }

    #[test]
    fn results_get_their_names_at_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let work = claim(folder.path()).unwrap();
        fs::write(work.emptied("made").unwrap().join("a"), "x").unwrap();
        work.publish("made", "sparse/0").unwrap();
        // The second time, after a stop, it is there already.
        work.publish("made", "sparse/0").unwrap();
        assert!(work.publish("nothing", "images").is_err());
        work.finish().unwrap();
        assert!(folder.path().join("sparse/0/a").is_file() && !folder.path().join(WORK).exists());
    }

    /// Runs a shell script; returns the lines that were heard, and what the log holds.
    fn run(body: &str, arguments: &[&str]) -> (Result<()>, Vec<String>, String) {
        let folder = tempfile::tempdir().unwrap();
        let program = Program { path: script(folder.path(), "speaker", body), install: "" };
        let (log, mut heard) = (folder.path().join("log"), Vec::new());
        let arguments: Vec<OsString> = arguments.iter().map(Into::into).collect();
        let ran = program.run(&arguments, &log, |line| heard.push(line.to_owned()));
        (ran, heard, fs::read_to_string(&log).unwrap())
    }

    #[test]
    fn output_is_watched_and_kept_and_of_a_failure_quoted() {
        let body = "echo one; echo two >&2; printf three; echo; echo \"$1\"";
        let (ran, heard, log) = run(body, &["four"]);
        ran.unwrap();
        assert_eq!(heard, ["one", "two", "three", "four"]);
        assert_eq!(log, "one\ntwo\nthree\nfour\n");
        let (ran, ..) = run("echo a; echo b; echo c; echo disk is full; echo; exit 3", &["mapper"]);
        let text = ran.unwrap_err().to_string();
        let expected =
            "speaker mapper: it failed (exit status: 3): b\nc\ndisk is full\nIts whole output is in /";
        assert!(text.starts_with(expected), "{text}");
        let text = run("exit 1", &["-h"]).0.unwrap_err().to_string();
        assert!(text.starts_with("speaker: ") && text.contains("it gave no reason"), "{text}");
    }

    #[test]
    fn a_program_that_cannot_be_started_says_how_to_install_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("notes.txt");
        fs::write(&file, "text").unwrap();
        for (path, words) in [
            ("no-such-program".into(), "no program `no-such-program` on the PATH"),
            (file, "cannot be started"),
        ] {
            let error = Program { path, install: "Install it." }.help(&["-h"]).unwrap_err();
            assert!(error.to_string().contains(words) && error.exit_code() == 2, "{error}");
            assert_eq!(error.help(), Some("Install it."));
        }
    }

    /// A program dropped while it works is stopped: this ends long before the minute that it takes.
    #[test]
    fn a_program_is_stopped_with_the_work_that_waits_for_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = script(folder.path(), "sleeper", "exec sleep 60");
        let started = Instant::now();
        drop(Running(Program { path, install: "" }.command().spawn().unwrap()));
        assert!(started.elapsed() < Duration::from_secs(30));
    }
}
