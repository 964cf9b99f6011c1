//! What commands check before they write.

use lobelia::codec::file::{FileUse, check_apart, is_there, read_bytes};
use lobelia::{Error, Result};
use std::path::{Path, PathBuf};

/// Refuses to write what is read: `inputs` are paths that are read, `outputs` are paths with what writes them.
pub fn refuse_inputs(inputs: &[PathBuf], outputs: &[(&Path, &str)]) -> Result<()> {
    let inputs: Vec<FileUse> = inputs.iter().map(|path| FileUse::new(path, "which is read")).collect();
    let outputs: Vec<FileUse> = outputs.iter().map(|(path, by)| FileUse::new(*path, *by)).collect();
    check_apart(&inputs, &outputs, "Give what is written another name.")
}

/// Refuses to replace a page that this program did not write: one without its signature.
pub fn refuse_foreign(page: &Path, signature: &str) -> Result<()> {
    let signed = |bytes: &[u8]| bytes.windows(signature.len()).any(|window| window == signature.as_bytes());
    // Of a folder in its place the writer tells.
    if !is_there(page)
        || page.is_dir()
        || read_bytes(page, |_| String::new()).is_ok_and(|bytes| signed(&bytes))
    {
        return Ok(());
    }
    let problem = format!("{} is not a page that this command wrote", page.display());
    Err(Error::usage(problem, "Move it away; it is not replaced."))
}
