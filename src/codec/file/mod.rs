//! Reading and writing of whole files: reading has errors that name the problem, and writing never leaves an incomplete file under
//! its final name. What is not a regular file (a pipe, a device) is refused before it is opened, because it might never end, and
//! so is what is larger than its kind can be.
//!
//! | function | does |
//! | --- | --- |
//! | [`open`], [`read_bytes`], [`read_up_to`], [`read_text`], [`read_folder`] | read |
//! | [`obstacle`] | says what keeps a file or folder from being read |
//! | [`write_file`], [`write_bytes`], [`write_by_path`] | write, all or nothing |
//! | [`check_writable`], [`check_room`], [`free_bytes`], [`check_file_name`] | say before the work whether results can be written |

mod output;
mod read;
mod write;

pub use output::{check_file_name, check_room, check_writable, free_bytes};
pub use read::{
    Kind, MOST_TEXT, Obstacle, is_there, obstacle, open, read_bytes, read_folder, read_text, read_up_to,
};
pub use write::{write_by_path, write_bytes, write_file};
