//! Matrices in a NumPy `.npz` file: a zip archive, stored or deflated, of `.npy` files.

use crate::codec::file;
use crate::codec::npy::{Matrix, parse_matrix};
use crate::{Error, Result};
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use zip::ZipArchive;
use zip::result::ZipError;

/// Most bytes of an archive.
const MOST_BYTES: u64 = 64 << 20;
/// Most bytes of a matrix, so that a small archive cannot fill the memory.
const MOST_MATRIX_BYTES: u64 = 1 << 20;
const HELP: &str = "Copy the file again, or write it again with numpy.savez.";

/// An `.npz` file whose matrices are read one by one.
pub struct Npz {
    path: PathBuf,
    archive: ZipArchive<Cursor<Vec<u8>>>,
}

impl Npz {
    /// Opens an archive; `help` returns the remedy for a missing file.
    ///
    /// # Errors
    /// [`Error::Input`] if the file is missing, empty, larger than 64 MiB, or not an undamaged zip archive.
    pub fn open(path: &Path, help: impl FnOnce(&Path) -> String) -> Result<Self> {
        let mut bytes = Vec::new();
        let reader = file::open(path, help)?;
        reader.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(Error::io("read", path))?;
        if bytes.len() as u64 > MOST_BYTES {
            let problem = format!("the file has more than {} MiB", MOST_BYTES >> 20);
            return Err(Error::input(path, "", problem, "Write an archive that has the matrices only."));
        }
        let archive = ZipArchive::new(Cursor::new(bytes)).map_err(|error| damaged(path, "", &error))?;
        Ok(Self { path: path.to_owned(), archive })
    }

    /// Names of the arrays, without `.npy`.
    pub fn names(&self) -> Vec<String> {
        let names = self.archive.file_names().filter_map(Result::ok);
        names.filter_map(|name| Some(name.strip_suffix(".npy")?.to_owned())).collect()
    }

    /// The matrix called `name`; `None` if there is no array of this name.
    ///
    /// # Errors
    /// [`Error::Input`] that names the array if it is damaged, has more than 1 MiB, or is not a matrix of floats.
    pub fn matrix(&mut self, name: &str) -> Result<Option<Matrix>> {
        let Self { path, archive } = self;
        let entry = match archive.by_name(&format!("{name}.npy")) {
            Err(ZipError::FileNotFound) => return Ok(None),
            entry => entry.map_err(|error| damaged(path, name, &error))?,
        };
        let mut bytes = Vec::new();
        let read = entry.take(MOST_MATRIX_BYTES + 1).read_to_end(&mut bytes);
        read.map_err(|error| damaged(path, name, &error.into()))?;
        let wrong = |problem: String| Error::input(&*path, format!("`{name}`"), problem, HELP);
        if bytes.len() as u64 > MOST_MATRIX_BYTES {
            return Err(wrong(format!("the array has more than {} MiB", MOST_MATRIX_BYTES >> 20)));
        }
        parse_matrix(&bytes).map(Some).map_err(|problem| wrong(format!("the array {problem}")))
    }
}

fn damaged(path: &Path, name: &str, error: &ZipError) -> Error {
    let place = if name.is_empty() { String::new() } else { format!("`{name}`") };
    let problem = match error {
        ZipError::UnsupportedArchive(what) => format!("the archive cannot be read: {what}"),
        ZipError::CompressionMethodNotSupported(_) => {
            "it is compressed in another way than NumPy's".to_owned()
        }
        error => format!("this is not an .npz file, or it is damaged or truncated ({error})"),
    };
    Error::input(path, place, problem, HELP)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::{npy_matrix, write_npz};
    use zip::CompressionMethod;

    fn refused<T>(result: Result<T>) -> String {
        let error = result.err().expect("a bad file must be refused");
        assert_eq!(error.exit_code(), 2, "{error}");
        error.to_string()
    }

    fn open(path: &Path) -> Result<Npz> {
        Npz::open(path, |_| String::new())
    }

    #[test]
    fn stored_and_deflated_matrices_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npz");
        let values = [1.5, -2.0, 3.0, 4.0, 0.0, 1e300];
        for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
            let matrices = [("a", npy_matrix(2, 3, &values)), ("b", npy_matrix(3, 2, &values))];
            write_npz(&path, method, &matrices);
            let mut npz = open(&path).unwrap();
            let mut names = npz.names();
            names.sort();
            assert_eq!(names, ["a", "b"]);
            let matrix = npz.matrix("b").unwrap().unwrap();
            assert_eq!((matrix.rows, matrix.columns, matrix.values.as_slice()), (3, 2, &values[..]));
            assert_eq!(npz.matrix("c").unwrap(), None);
        }
    }

    #[test]
    fn every_truncation_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npz");
        write_npz(&path, CompressionMethod::Deflated, &[("a", npy_matrix(4, 4, &[0.5; 16]))]);
        let whole = std::fs::read(&path).unwrap();
        for length in 1..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            let text = refused(open(&path).and_then(|mut npz| npz.matrix("a")));
            assert!(text.contains("damaged or truncated"), "{length}: {text}");
        }
        for (at, _) in whole.iter().enumerate() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x55;
            std::fs::write(&path, &bytes).unwrap();
            // Some bytes mean nothing; none may panic or change a value without notice.
            if let Ok(Some(matrix)) = open(&path).and_then(|mut npz| npz.matrix("a")) {
                assert_eq!(matrix.values, [0.5; 16], "byte {at}");
            }
        }
    }

    #[test]
    fn bombs_and_other_arrays_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npz");
        let large = npy_matrix(1000, 1000, &[0.0; 1_000_000]);
        let text = [b"\x93NUMPY\x01\x00\x02\x00{}".to_vec(), b"hello".to_vec()];
        let [header, hello] = text;
        write_npz(
            &path,
            CompressionMethod::Deflated,
            &[("large", large), ("header", header), ("hello", hello)],
        );
        assert!(std::fs::metadata(&path).unwrap().len() < 20_000);
        let mut npz = open(&path).unwrap();
        assert!(refused(npz.matrix("large")).contains("`large`: the array has more than 1 MiB"));
        assert!(refused(npz.matrix("header")).contains("`header`: the array has a broken header"));
        assert!(refused(npz.matrix("hello")).contains("`hello`: the array is not a NumPy"));
        std::fs::write(&path, b"no zip at all").unwrap();
        assert!(refused(open(&path)).contains("not an .npz file"));
        assert!(open(&folder.path().join("none.npz")).is_err());
    }
}
