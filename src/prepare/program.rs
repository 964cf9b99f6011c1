//! Running another program: its output goes to a log file that is read while it works, and Ctrl-C stops it.

use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

/// Lines of a failed program's output that its error quotes.
const QUOTED_LINES: usize = 3;
/// Most characters of a quoted line.
const QUOTED_CHARS: usize = 300;
/// Comes before the place of the log in an error.
const WHOLE_OUTPUT: &str = "\nIts whole output is in ";
/// Longest pause between two looks at a working program.
const LONGEST_PAUSE: Duration = Duration::from_millis(100);

/// A program that may or may not be installed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Program {
    /// A name on the PATH, or a path.
    pub path: PathBuf,
    /// What to do where it is missing.
    pub install: &'static str,
}

impl Program {
    /// What the program prints when it is asked for help: both streams, whatever its exit status.
    ///
    /// # Errors
    /// [`Error::Usage`] that says how to install it if it cannot be started.
    pub fn help(&self, arguments: &[&str]) -> Result<String> {
        let output = command(self.path.as_os_str()).args(arguments).output();
        let output = output.map_err(|error| self.cannot_start(&error))?;
        let both = [output.stdout, output.stderr].concat();
        Ok(String::from_utf8_lossy(&both).into_owned())
    }

    /// Runs the program to its end. `watch` gets each line of its output soon after it is written; `log` keeps them all.
    ///
    /// # Errors
    /// [`Error::Usage`] if it cannot be started, [`Error::Run`] with its last lines if it fails, [`Error::Interrupted`] after Ctrl-C
    /// (the program is stopped), [`Error::Io`] if the log cannot be written.
    pub fn run(&self, arguments: &[OsString], log: &Path, watch: &mut dyn FnMut(&str)) -> Result<()> {
        let file = File::create(log).map_err(Error::io("write", log))?;
        let twin = file.try_clone().map_err(Error::io("write", log))?;
        let mut starting = command(self.path.as_os_str());
        starting.args(arguments).stdout(file).stderr(twin);
        let child = starting.spawn().map_err(|error| self.cannot_start(&error))?;
        let mut lines = Lines::open(log)?;
        let status = Running(child).wait(|| lines.read(watch))?;
        if status.success() {
            return Ok(());
        }
        // Ctrl-C reaches the program as well: it may be gone before this one has heard of it.
        std::thread::sleep(LONGEST_PAUSE);
        check_interrupted()?;
        let first = arguments.first().map_or_else(String::new, |word| format!(" {}", word.display()));
        let name = self.path.file_name().unwrap_or_default().display().to_string();
        let said = last_lines(&std::fs::read(log).unwrap_or_default());
        let problem = format!("it failed ({status}): {said}{WHOLE_OUTPUT}{}", log.display());
        Err(Error::run(format!("{name}{}", if first.starts_with(" -") { "" } else { &first }), problem))
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

/// What a program that failed said, without the place of its log, which is gone.
pub(super) fn without_log(problem: &str) -> &str {
    problem.split(WHOLE_OUTPUT).next().unwrap_or(problem)
}

/// A command without input. COLMAP opens a display only to use a GPU; it must not fail where there is none.
fn command(program: &OsStr) -> Command {
    let mut command = Command::new(program);
    command.stdin(Stdio::null());
    if std::env::var_os("QT_QPA_PLATFORM").is_none() {
        command.env("QT_QPA_PLATFORM", "offscreen");
    }
    command
}

/// A program at work, which ends at the latest when this is dropped.
struct Running(Child);

impl Running {
    /// Waits for its end and calls `look` now and then, and once afterward.
    fn wait(mut self, mut look: impl FnMut() -> Result<()>) -> Result<ExitStatus> {
        let mut pause = Duration::from_millis(2);
        loop {
            let ended =
                self.0.try_wait().map_err(|error| Error::run("waiting for a program", error.to_string()))?;
            look()?;
            if let Some(status) = ended {
                return Ok(status);
            }
            check_interrupted()?;
            std::thread::sleep(pause);
            pause = (2 * pause).min(LONGEST_PAUSE);
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Neither has an effect on a program that has ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The lines of a file that grows.
struct Lines<'a> {
    path: &'a Path,
    file: File,
    rest: Vec<u8>,
}

impl<'a> Lines<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io("read", path))?;
        Ok(Self { path, file, rest: Vec::new() })
    }

    fn read(&mut self, watch: &mut dyn FnMut(&str)) -> Result<()> {
        self.file.read_to_end(&mut self.rest).map_err(Error::io("read", self.path))?;
        let Some(end) = self.rest.iter().rposition(|byte| *byte == b'\n') else { return Ok(()) };
        let whole: Vec<u8> = self.rest.drain(..=end).collect();
        String::from_utf8_lossy(&whole).lines().for_each(watch);
        Ok(())
    }
}

/// The last lines of an output that say something, each cut to a bearable length.
fn last_lines(output: &[u8]) -> String {
    let text = String::from_utf8_lossy(output);
    let mut lines: Vec<String> = text
        .lines()
        .rev()
        .map(str::trim)
        .filter(|line| line.chars().any(char::is_alphanumeric))
        .take(QUOTED_LINES)
        .map(|line| line.chars().take(QUOTED_CHARS).collect())
        .collect();
    lines.reverse();
    if lines.is_empty() { "it gave no reason".to_owned() } else { lines.join("\n") }
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::prepare::test_data::script;

    fn program(path: PathBuf) -> Program {
        Program { path, install: "Install it." }
    }

    #[test]
    fn output_is_watched_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let speaker =
            script(folder.path(), "speaker", "echo one; echo two >&2; printf three; echo; echo \"$1\"");
        let log = folder.path().join("log");
        let mut heard = Vec::new();
        program(speaker).run(&["four".into()], &log, &mut |line| heard.push(line.to_owned())).unwrap();
        assert_eq!(heard, ["one", "two", "three", "four"]);
        assert_eq!(std::fs::read_to_string(&log).unwrap(), "one\ntwo\nthree\nfour\n");
    }

    #[test]
    fn a_failure_quotes_the_last_lines_and_names_the_log() {
        let folder = tempfile::tempdir().unwrap();
        let failing =
            script(folder.path(), "failing", "echo a; echo b; echo c; echo disk is full; echo; exit 3");
        let log = folder.path().join("log");
        let error = program(failing).run(&["mapper".into()], &log, &mut |_| ()).unwrap_err();
        let text = error.to_string();
        assert!(
            text.starts_with("failing mapper: it failed (exit status: 3): b\nc\ndisk is full\n"),
            "{text}"
        );
        assert!(text.contains(&log.display().to_string()), "{text}");
        let silent = script(folder.path(), "silent", "exit 1");
        let text = program(silent).run(&[], &log, &mut |_| ()).unwrap_err().to_string();
        assert!(text.contains("it gave no reason"), "{text}");
    }

    #[test]
    fn a_missing_program_says_how_to_install_it() {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("log");
        let missing = program("no-such-program-anywhere".into());
        for error in [missing.run(&[], &log, &mut |_| ()).unwrap_err(), missing.help(&["-h"]).unwrap_err()] {
            assert_eq!(error.exit_code(), 2);
            assert!(
                error.to_string().contains("no program `no-such-program-anywhere` on the PATH"),
                "{error}"
            );
            assert_eq!(error.help(), Some("Install it."));
        }
        let no_program = folder.path().join("notes.txt");
        std::fs::write(&no_program, "text").unwrap();
        let text = program(no_program).help(&[]).unwrap_err().to_string();
        assert!(text.contains("cannot be started"), "{text}");
    }

    /// What is dropped while it works is stopped: this ends long before the minute that the program takes.
    #[test]
    fn a_program_is_stopped_with_the_work_that_waits_for_it() {
        let folder = tempfile::tempdir().unwrap();
        let sleeper = script(folder.path(), "sleeper", "exec sleep 60");
        let started = std::time::Instant::now();
        let running = Running(command(sleeper.as_os_str()).spawn().unwrap());
        let mut looks = 0;
        let outcome = running.wait(|| {
            looks += 1;
            if looks > 3 { Err(Error::Interrupted) } else { Ok(()) }
        });
        assert!(matches!(outcome, Err(Error::Interrupted)));
        assert!(started.elapsed() < Duration::from_secs(30));
    }

    #[test]
    fn quoted_lines_are_bounded() {
        let long = format!("a\n{}\n----\n\n", "x".repeat(5000));
        let quoted = last_lines(long.as_bytes());
        assert_eq!(quoted, format!("a\n{}", "x".repeat(QUOTED_CHARS)));
        assert_eq!(last_lines(&[0xff, b'o', b'k']), "\u{fffd}ok");
    }
}
