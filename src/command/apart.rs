//! What commands with one input do before they write.

use lobelia::Result;
use lobelia::codec::file::{FileUse, check_apart};
use std::path::Path;

/// Refuses to write what is read: `outputs` are paths with what writes them.
pub fn refuse_input(input: &Path, outputs: &[(&Path, &str)]) -> Result<()> {
    let outputs: Vec<FileUse> = outputs.iter().map(|(path, by)| FileUse::new(*path, *by)).collect();
    check_apart(&[FileUse::new(input, "which is read")], &outputs, "Give what is written another name.")
}
