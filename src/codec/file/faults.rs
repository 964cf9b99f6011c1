//! Faults that tests give to the files below a folder.

use std::io::{Error, Result};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// What is asked of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Call {
    Read,
    Write,
    Sync,
}

/// What a file answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FileFault {
    /// An error with this number, at every call from the `after`-th on.
    Errno { errno: i32, after: u32 },
    /// EINTR at every second call.
    Interrupted,
    /// No more than so many bytes at a call.
    Short(usize),
}

struct Rule {
    folder: PathBuf,
    call: Call,
    fault: FileFault,
    calls: u32,
}

/// Tests run side by side, each with a folder of its own.
static RULES: Mutex<Vec<Rule>> = Mutex::new(Vec::new());

/// A fault that lasts until this is dropped.
pub(crate) struct Faulty(PathBuf);

impl Faulty {
    pub fn new(folder: &Path, call: Call, fault: FileFault) -> Self {
        RULES.lock().unwrap().push(Rule { folder: folder.to_owned(), call, fault, calls: 0 });
        Self(folder.to_owned())
    }
}

impl Drop for Faulty {
    fn drop(&mut self) {
        RULES.lock().unwrap().retain(|rule| rule.folder != self.0);
    }
}

/// How many of `length` bytes a call may have.
pub(super) fn meet(path: &Path, call: Call, length: usize) -> Result<usize> {
    let mut rules = RULES.lock().unwrap();
    let Some(rule) = rules.iter_mut().find(|rule| rule.call == call && path.starts_with(&rule.folder)) else {
        return Ok(length);
    };
    rule.calls += 1;
    match rule.fault {
        FileFault::Errno { errno, after } if rule.calls > after => Err(Error::from_raw_os_error(errno)),
        FileFault::Interrupted if rule.calls % 2 == 1 => Err(std::io::ErrorKind::Interrupted.into()),
        FileFault::Short(most) => Ok(length.min(most)),
        FileFault::Errno { .. } | FileFault::Interrupted => Ok(length),
    }
}
