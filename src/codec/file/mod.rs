//! Reading and writing of whole files: reading has errors that name the problem, and writing never leaves an incomplete file under
//! its final name. What is not a regular file (a pipe, a device) is refused before it is opened, because it might never end, and
//! so is what is larger than its kind can be.
//!
//! | function | does |
//! | --- | --- |
//! | [`open`], [`read_bytes`], `read_up_to`, `read_text`, `read_parts`, `first_bytes`, `read_folder` | read |
//! | `obstacle` | says what keeps a file or folder from being read |
//! | `write_file`, [`write_bytes`], `write_by_path` | write, all or nothing |
//! | [`check_writable`], `check_room`, `check_file_name` | say before the work whether results can be written |
//! | [`check_apart`], `check_not_among`, `lies_in` | say whether what is written is something that is read |
//! | `check_inside` | says whether what is read lies where it may |
//! | [`DiskFile`] | the one file through which all of this goes |
//! | [`FolderLock`] | keeps two processes from writing into one folder |
//! | `file_stems` | the one way from names of views to names of files |
//! | `scratch_folder`, `is_unfinished`, `clear_scratch` | what is unfinished, and its end |

mod apart;
mod disk;
#[cfg(test)]
pub(crate) mod faults;
mod inside;
mod lock;
mod output;
mod read;
mod scratch;
mod write;

pub use apart::{FileUse, check_apart};
pub(crate) use apart::{check_not_among, lies_in};
pub use disk::DiskFile;
pub use inside::Links;
pub(crate) use inside::check_inside;
pub use lock::FolderLock;
pub(crate) use lock::LOCK;
pub use output::check_writable;
pub(crate) use output::{check_file_name, check_room, file_stems};
pub use read::{FileKind, is_there, open, read_bytes};
pub(crate) use read::{
    MOST_TEXT, Obstacle, first_bytes, obstacle, read_folder, read_parts, read_text, read_up_to,
};
pub(crate) use scratch::{clear_scratch, is_unfinished, scratch_folder};
pub use write::write_bytes;
pub(crate) use write::{write_by_path, write_file};
