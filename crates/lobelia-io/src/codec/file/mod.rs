//! Reading and writing of whole files: reading has errors that name the problem, and writing never
//! leaves an incomplete file under its final name. What is not a regular file (a pipe, a device) is
//! refused before it is opened, because it might never end, and so is what is larger than its kind
//! can be.

#[doc(hidden)]
pub mod faults;
mod folder;
mod write;

pub use folder::{FileUse, FolderLock, LOCK, check_apart, check_not_among, check_writable, lies_in};
pub use write::{
    check_file_name, check_finite, clear_scratch, file_stems, is_unfinished, scratch_folder, write_bytes,
    write_file,
};
pub(crate) use write::{folder_of, not_written};

use faults::{Call, meet};
use lobelia_geometry::{Error, Result};
use std::fs::{self, File, FileType, ReadDir};
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Most bytes of a text file that people write: a scene, a light. The largest scene that a pass
/// saves is a few MiB.
pub const MOST_TEXT: u64 = 16 << 20;
/// Most bytes of any file that is read whole.
const MOST_BYTES: u64 = 4 << 30;

/// A file on the disk: the one through which everything is read and written. Tests give it the
/// faults of disks and pipes.
#[derive(Debug)]
pub struct DiskFile {
    pub(in crate::codec) file: File,
    path: PathBuf,
}

impl DiskFile {
    /// Opens a file for reading.
    pub(in crate::codec) fn open(path: &Path) -> io::Result<Self> {
        Ok(Self { file: File::open(path)?, path: path.to_owned() })
    }

    /// Puts its bytes on the disk.
    fn sync_all(&self) -> io::Result<()> {
        meet(&self.path, Call::Sync, 0)?;
        self.file.sync_all()
    }
}

/// Tries again what a signal has interrupted: not every decoder does.
fn uninterrupted(mut call: impl FnMut() -> io::Result<usize>) -> io::Result<usize> {
    loop {
        match call() {
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            ended => return ended,
        }
    }
}

impl Read for DiskFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        uninterrupted(|| {
            let length = meet(&self.path, Call::Read, buffer.len())?;
            self.file.read(&mut buffer[..length])
        })
    }
}

impl Write for DiskFile {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        uninterrupted(|| {
            let length = meet(&self.path, Call::Write, buffer.len())?;
            self.file.write(&buffer[..length])
        })
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for DiskFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// Bytes that a decoder reads. Decoders are generic; of one type of source, each is compiled once.
pub(crate) trait Source: BufRead + Seek {}
impl<T: BufRead + Seek> Source for T {}

/// The kind of entry that must be at a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A regular file.
    File,
    /// A folder.
    Folder,
}

/// Why a path cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Obstacle {
    /// A clause that follows the path: "there is no such file".
    pub problem: String,
    /// The remedy; empty where it depends on the use of the file.
    pub help: String,
}

impl Obstacle {
    fn new(problem: impl Into<String>, help: &str) -> Self {
        Self { problem: problem.into(), help: help.to_owned() }
    }
}

/// The reason why `path` cannot be read as a `kind`, if there is one. A pipe or a device is not
/// opened.
pub fn obstacle(path: &Path, kind: FileKind) -> Option<Obstacle> {
    if kind == FileKind::File { open_regular(path).err() } else { open_folder(path).err() }
}

/// True if something exists at a path, of whatever kind, or if the system does not tell.
pub fn is_there(path: &Path) -> bool {
    fs::symlink_metadata(path).map_or_else(|error| error.kind() == ErrorKind::PermissionDenied, |_| true)
}

fn open_regular(path: &Path) -> Result<DiskFile, Obstacle> {
    let refused = |error: io::Error| refusal(path, FileKind::File, &error);
    let found = fs::metadata(path).map_err(refused)?.file_type();
    if found.is_dir() {
        return Err(Obstacle::new("this is a folder, not a file", ""));
    }
    if !found.is_file() {
        let problem = format!("this is a {}, not a regular file", special(found));
        return Err(Obstacle::new(problem, "Copy its data into a file, and name that file."));
    }
    DiskFile::open(path).map_err(refused)
}

fn open_folder(path: &Path) -> Result<ReadDir, Obstacle> {
    let refused = |error: io::Error| refusal(path, FileKind::Folder, &error);
    let found = fs::metadata(path).map_err(refused)?.file_type();
    if !found.is_dir() {
        let what = if found.is_file() { "file" } else { special(found) };
        return Err(Obstacle::new(format!("this is a {what}, not a folder"), ""));
    }
    // What is in a folder may be listed and yet not be opened.
    fs::metadata(path.join(".")).and_then(|_| fs::read_dir(path)).map_err(refused)
}

/// The reason that the system gives, in words.
fn refusal(path: &Path, kind: FileKind, error: &io::Error) -> Obstacle {
    let noun = if kind == FileKind::File { "file" } else { "folder" };
    match error.kind() {
        ErrorKind::NotFound => match fs::read_link(path) {
            Ok(target) => Obstacle::new(
                format!("this is a symbolic link to {}, which does not exist", target.display()),
                "Restore what the link leads to, or name another file.",
            ),
            Err(_) => Obstacle::new(format!("there is no such {noun}"), ""),
        },
        ErrorKind::PermissionDenied => Obstacle::new(
            "permission denied: this user may not read it",
            "Allow it: `chmod u+r` for the file, `chmod u+rx` for the folders that it is in.",
        ),
        ErrorKind::NotADirectory => Obstacle::new("a part of its path is a file, not a folder", ""),
        _ => Obstacle::new(format!("it cannot be read: {error}"), ""),
    }
}

/// The kind of a file that is neither a regular file nor a folder.
#[cfg(unix)]
fn special(found: FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt;
    match found {
        pipe if pipe.is_fifo() => "pipe",
        socket if socket.is_socket() => "socket",
        _ => "device",
    }
}

#[cfg(not(unix))]
fn special(_: FileType) -> &'static str {
    "device"
}

/// Opens a file for reading; `help` returns the remedy for a missing file.
///
/// # Errors
/// [`Error::Input`] if the file is missing, empty, a folder, a pipe or a device, or may not be
/// read.
pub fn open(path: &Path, help: impl FnOnce(&Path) -> String) -> Result<BufReader<DiskFile>> {
    let file = open_regular(path).map_err(|Obstacle { problem, help: own }| {
        Error::input(path, "", problem, if own.is_empty() { help(path) } else { own })
    })?;
    if file.file.metadata().map_err(Error::io("read", path))?.len() == 0 {
        return Err(Error::input(path, "", "the file is empty (0 bytes)", "Copy it again."));
    }
    Ok(BufReader::new(file))
}

/// The first `count` bytes of a file that is at its beginning, or all if it has fewer; it is at its
/// beginning again then. A single read may give fewer, as from a network.
///
/// # Errors
/// [`Error::Io`] if it cannot be read.
pub fn first_bytes(path: &Path, file: &mut BufReader<DiskFile>, count: usize) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(count);
    let read = file.take(count as u64).read_to_end(&mut bytes);
    read.and_then(|_| file.rewind()).map_err(Error::io("read", path))?;
    Ok(bytes)
}

/// Reads a file of any size in parts.
///
/// # Errors
/// [`Error::Io`] if it cannot be read.
pub fn read_parts(path: &Path, mut take: impl FnMut(&[u8])) -> Result<()> {
    let mut file = DiskFile::open(path).map_err(Error::io("read", path))?;
    let mut part = vec![0; 1 << 18];
    loop {
        match file.read(&mut part).map_err(Error::io("read", path))? {
            0 => return Ok(()),
            count => take(&part[..count]),
        }
    }
}

/// Reads a whole file of at most 4 GiB; `help` returns the remedy for a missing file.
///
/// # Errors
/// [`Error::Input`] if it is missing, larger or not a regular file, [`Error::Io`] if it cannot be
/// read.
pub fn read_bytes(path: &Path, help: impl FnOnce(&Path) -> String) -> Result<Vec<u8>> {
    read_up_to(path, MOST_BYTES, help)
}

/// Reads a whole file of at most `most` bytes; `help` returns the remedy for a missing file.
///
/// # Errors
/// [`Error::Input`] for what [`open`] refuses, and for a larger file, before it is read;
/// [`Error::Io`] if reading fails.
pub fn read_up_to(path: &Path, most: u64, help: impl FnOnce(&Path) -> String) -> Result<Vec<u8>> {
    let file = open(path, help)?;
    let mut length = file.get_ref().file.metadata().map_err(Error::io("read", path))?.len();
    let mut bytes = Vec::new();
    if length <= most {
        // The file may grow while it is read. What there is no memory for is refused by the reading
        // itself.
        let _ = bytes.try_reserve_exact(length as usize + 1);
        file.take(most + 1).read_to_end(&mut bytes).map_err(Error::io("read", path))?;
        length = bytes.len() as u64;
    }
    if length > most {
        let [length, most] = [length, most].map(|bytes| bytes as f64 / 1_048_576.0);
        let problem = format!("the file has {length:.1} MiB, and at most {most:.1} MiB are read");
        return Err(Error::input(path, "", problem, "Check that it is the right file."));
    }
    Ok(bytes)
}

/// Reads a UTF-8 text of at most `most` bytes, without the byte order mark that some editors put in
/// front; `help` returns the remedy for a missing file.
///
/// # Errors
/// As for [`read_up_to`], and [`Error::Input`] with the place of the first byte that is not UTF-8.
pub fn read_text(path: &Path, most: u64, help: impl FnOnce(&Path) -> String) -> Result<String> {
    let text = String::from_utf8(read_up_to(path, most, help)?).map_err(|error| {
        let place = format!("byte {}", error.utf8_error().valid_up_to());
        let wide = matches!(error.as_bytes(), [0xff, 0xfe, ..] | [0xfe, 0xff, ..]);
        let help = if wide { "It is UTF-16: save it as UTF-8." } else { "Is it the right file?" };
        Error::input(path, place, "is not UTF-8 text", help)
    })?;
    Ok(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text))
}

/// The entries of a folder.
///
/// # Errors
/// [`Error::Input`] if it is missing, a file, or may not be read.
pub fn read_folder(path: &Path) -> Result<ReadDir> {
    open_folder(path).map_err(|Obstacle { problem, help }| Error::input(path, "", problem, help))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::temporary;

    fn refused(path: &Path) -> (String, String) {
        let error = read_bytes(path, |_| "look elsewhere".to_owned()).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        (error.to_string(), error.help().unwrap_or_default().to_owned())
    }

    #[test]
    fn what_is_not_there_is_told_from_what_may_not_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let (problem, help) = refused(&folder.path().join("none"));
        assert!(problem.ends_with("none: there is no such file") && help == "look elsewhere", "{problem}");
        assert!(refused(folder.path()).0.contains("this is a folder"));
        // Whoever runs the tests may read everything, perhaps: the system's answer is made up.
        let denied = refusal(folder.path(), FileKind::File, &ErrorKind::PermissionDenied.into());
        assert!(denied.problem.contains("permission denied") && denied.help.contains("chmod"), "{denied:?}");
        let file = folder.path().join("file");
        fs::write(&file, "x").unwrap();
        assert!(refused(&file.join("below")).0.contains("a part of its path is a file"));
        assert!(refused(&folder.path().join("a\0b")).0.contains("it cannot be read"));
        assert!(read_folder(&file).unwrap_err().to_string().contains("this is a file"));
        assert!(read_folder(&folder.path().join("none")).unwrap_err().to_string().contains("no such folder"));
        assert_eq!(obstacle(&file, FileKind::File).or(obstacle(folder.path(), FileKind::Folder)), None);
    }

    #[cfg(unix)]
    #[test]
    fn what_might_never_end_is_not_opened() {
        let (folder, path) = temporary("special");
        let made = std::process::Command::new("mkfifo").arg(&path).status();
        assert!(made.unwrap().success());
        assert!(refused(&path).0.contains("this is a pipe, not a regular file"));
        fs::remove_file(&path).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(&path).unwrap();
        assert!(refused(&path).0.contains("this is a socket"));
        assert!(refused(Path::new("/dev/zero")).0.contains("this is a device"));
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("nowhere", &link).unwrap();
        assert!(refused(&link).0.contains("symbolic link to nowhere, which does not exist"));
    }

    #[test]
    fn sizes_are_bounded_before_anything_is_read() {
        let (_folder, path) = temporary("large");
        // A sparse file: it takes no room on the disk.
        fs::File::create(&path).unwrap().set_len(MOST_BYTES + 1).unwrap();
        let (problem, _) = refused(&path);
        assert!(problem.contains("the file has 4096.0 MiB, and at most 4096.0 MiB"), "{problem}");
        fs::write(&path, "12345").unwrap();
        assert_eq!(read_up_to(&path, 5, |_| String::new()).unwrap(), b"12345");
        assert!(read_up_to(&path, 4, |_| String::new()).is_err());
    }
}
