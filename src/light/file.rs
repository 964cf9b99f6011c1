//! Whole files in and out; a file appears under its final name only when it is complete.

use std::io::Write;
use std::path::Path;

use crate::{Error, Result};

/// All bytes of `path`; a missing file or a folder is an input error.
pub fn read_bytes(path: &Path, help: &str) -> Result<Vec<u8>> {
    if path.is_dir() {
        return Err(Error::input(path, "", "is a folder, not a file", help));
    }
    match std::fs::read(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            Err(Error::input(path, "", "there is no such file", help))
        }
        other => other.map_err(Error::io("read", path)),
    }
}

/// Writes `bytes` to a temporary file in the same folder, then renames it to `path`.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".writing-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // As an ordinary new file would have (the umask still applies), not readable by the owner alone.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.tempfile_in(folder).map_err(Error::io("create", path))?;
    file.write_all(bytes).and_then(|()| file.flush()).map_err(Error::io("write", path))?;
    file.persist(path).map_err(|e| Error::io("write", path)(e.error))?;
    Ok(())
}
