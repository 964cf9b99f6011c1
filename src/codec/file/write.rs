//! Writing whole files: a temporary file in the same folder, which is renamed when it is complete and on the disk.

use crate::codec::file::disk::DiskFile;
use crate::codec::file::scratch::{PREFIX, is_scratch};
use crate::{Error, Result};
use std::fs::{self, File};
use std::io::BufWriter;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use tempfile::{NamedTempFile, TempPath};

/// Writes `path` through `write`: the bytes go to a hidden temporary file in the same folder (created if missing), which
/// gets the final name only when `write` has succeeded and the bytes are on the disk. An existing file of that name is replaced;
/// on failure it stays as it was and the temporary file is removed.
///
/// # Errors
/// Whatever `write` returns, or [`Error::Io`] for other errors of the operating system.
pub(crate) fn write_file(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<DiskFile>) -> Result<()>,
) -> Result<()> {
    let (file, temporary) = temporary_beside(path)?.into_parts();
    let mut writer = BufWriter::new(DiskFile::new(file, path));
    write(&mut writer)?;
    let file = writer.into_inner().map_err(|failed| Error::io("write", path)(failed.into_error()))?;
    finish(&file, temporary, path)
}

/// `write_file` for bytes that are already in memory.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_file(path, |writer| writer.write_all(bytes).map_err(Error::io("write", path)))
}

fn temporary_beside(path: &Path) -> Result<NamedTempFile> {
    let folder = folder_of(path);
    create_folders(&folder)?;
    let suffix = match path.extension() {
        Some(extension) => format!(".part.{}", extension.to_string_lossy()),
        None => ".part".to_owned(),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(&suffix);
    // A temporary file is private to its owner by default; a result has the usual permissions (0666 less umask).
    #[cfg(unix)]
    let builder = builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(&folder).map_err(Error::io("create a file in", &folder))
}

/// Creates `folder` and those around it that are missing, with their names on the disk; returns them, from the innermost.
///
/// # Errors
/// [`Error::Io`].
pub(crate) fn create_folders(folder: &Path) -> Result<Vec<PathBuf>> {
    let is_new = |place: &&Path| !place.as_os_str().is_empty() && !place.exists();
    let made: Vec<PathBuf> = folder.ancestors().take_while(is_new).map(Path::to_owned).collect();
    fs::create_dir_all(folder).map_err(Error::io("create folder", folder))?;
    let lasting = made.iter().filter(|made| !is_scratch(made));
    lasting.map(|made| folder_of(made)).try_for_each(|around| sync_folder(&around))?;
    Ok(made)
}

fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
        _ => PathBuf::from("."),
    }
}

/// Gives a complete file its name. After a power cut there is the old file or the new one, never an empty one.
fn finish(file: &DiskFile, temporary: TempPath, path: &Path) -> Result<()> {
    let counts = !is_scratch(path);
    if counts {
        file.sync_all().map_err(Error::io("write", path))?;
    }
    temporary.persist(path).map_err(|refused| Error::io("write", path)(refused.error))?;
    if counts { sync_folder(&folder_of(path)) } else { Ok(()) }
}

/// Puts the names in a folder on the disk.
#[cfg(unix)]
fn sync_folder(folder: &Path) -> Result<()> {
    use rustix::io::Errno;
    let synced = File::open(folder).and_then(|opened| opened.sync_all());
    match synced {
        Err(error) if matches!(Errno::from_io_error(&error), Some(Errno::IO | Errno::NOSPC)) => {
            Err(Error::io("write", folder)(error))
        }
        // Some file systems have no such thing, and some folders may be written but not read.
        _ => Ok(()),
    }
}

/// This system writes the names in a folder by itself.
#[cfg(not(unix))]
fn sync_folder(_: &Path) -> Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names_in(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn success_leaves_only_the_final_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/out.txt");
        write_bytes(&path, b"one").unwrap();
        write_bytes(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(names_in(path.parent().unwrap()), ["out.txt"]);
    }

    #[test]
    fn failure_keeps_the_old_file_and_no_temporary() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.txt");
        write_bytes(&path, b"old").unwrap();
        let refused = write_file(&path, |writer| {
            writer.write_all(b"half of the new").map_err(Error::io("write", &path))?;
            Err(Error::run("test", "stopped"))
        });
        assert!(refused.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names_in(folder.path()), ["out.txt"]);
    }

    #[cfg(unix)]
    #[test]
    fn the_result_is_not_more_private_than_a_plain_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, plain) = (folder.path().join("ours"), folder.path().join("plain"));
        write_bytes(&ours, b"x").unwrap();
        fs::write(&plain, b"x").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&plain));
    }

    #[test]
    fn an_impossible_folder_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, b"x").unwrap();
        let error = write_bytes(&file.join("below"), b"y").unwrap_err();
        assert!(matches!(error, Error::Io { .. }), "{error}");
    }
}
