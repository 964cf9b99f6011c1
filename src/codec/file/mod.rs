//! Reading and writing of whole files: reading has errors that name the problem, and writing never leaves an incomplete file under
//! its final name. What is not a regular file (a pipe, a device) is refused before it is opened, because it might never end, and
//! so is what is larger than its kind can be.
//!
//! | function | does |
//! | --- | --- |
//! | [`open`], [`read_bytes`] | read |
//! | [`write_bytes`] | writes, all or nothing |
//! | [`check_writable`] | says before the work whether results can be written |
//! | [`check_apart`] | says whether what is written is something that is read |
//! | [`DiskFile`] | the one file through which all of this goes |
//! | [`FolderLock`] | keeps two processes from writing into one folder |

// Within the library: `read_up_to`, `read_text`, `read_parts`, `first_bytes` and `read_folder` read as well, and `obstacle` says what keeps
// a file or folder from it; `write_file` writes; `check_room` and `check_file_name` look ahead; `check_not_among` and
// `lies_in` compare what is written with what is read, and `check_inside` says whether what is read lies where it may; `file_stems` is the
// one way from names of views to names of files; `scratch_folder`, `is_unfinished` and `clear_scratch` are for what is unfinished.

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
pub(crate) use write::write_file;
