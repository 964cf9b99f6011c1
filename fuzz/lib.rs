//! Shared code of the targets: the input as a file, because parsers read files.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

thread_local! {
    static FOLDER: RefCell<Option<TempDir>> = const { RefCell::new(None) };
}

/// A folder that lasts as long as the process.
pub fn folder() -> PathBuf {
    FOLDER.with_borrow_mut(|folder| {
        let made = folder.get_or_insert_with(|| tempfile::tempdir().expect("a temporary folder"));
        made.path().to_owned()
    })
}

/// Writes the input as a file of this name below [`folder`], and reads it.
pub fn read<T>(name: &str, data: &[u8], read: impl FnOnce(&Path) -> T) -> T {
    let path = folder().join(name);
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent).expect("a folder");
    }
    std::fs::write(&path, data).expect("a file");
    read(&path)
}

/// A photograph of 8 × 6 pixels for data sets, as PPM would be, in Radiance HDR.
pub fn photograph() -> Vec<u8> {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 6 +X 8\n".to_vec();
    bytes.extend((0..48).flat_map(|i| [i * 5, 100, 200, 128]));
    bytes
}

/// Reads a data set of one photograph.
pub fn dataset() {
    use lobelia::dataset::{DatasetOptions, read_dataset};
    read("images/a.hdr", &photograph(), |_| ());
    let options = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
    let _ = read_dataset(folder(), lobelia::view::Split::Train, &options);
}
