//! What commands check before they write.

use lobelia::codec::file::{FileUse, check_apart};
use lobelia::{Error, Result};
use std::path::Path;

/// Refuses to write what is read: `outputs` are paths with what writes them.
pub fn refuse_input(input: &Path, outputs: &[(&Path, &str)]) -> Result<()> {
    let outputs: Vec<FileUse> = outputs.iter().map(|(path, by)| FileUse::new(*path, *by)).collect();
    check_apart(&[FileUse::new(input, "which is read")], &outputs, "Give what is written another name.")
}

/// Refuses to replace a page that this program did not write: one without its signature.
pub fn refuse_foreign(page: &Path, signature: &str) -> Result<()> {
    let signed = |bytes: &[u8]| bytes.windows(signature.len()).any(|window| window == signature.as_bytes());
    match std::fs::read(page) {
        Ok(bytes) if !signed(&bytes) => {
            let problem = format!("{} is not a page that this command wrote", page.display());
            Err(Error::usage(problem, "Move it away; it is not replaced."))
        }
        _ => Ok(()),
    }
}
