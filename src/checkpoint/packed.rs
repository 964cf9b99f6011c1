//! Bytes of values, and `serde` forms that these are short in.

use crate::error::{Error, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{self, Write};

/// A value as bytes, in postcard's format.
///
/// # Errors
/// [`Error::Run`] for a value that has no length or no serialized form; no state is one.
pub(crate) fn to_bytes<T: Serialize + ?Sized>(value: &T) -> Result<Vec<u8>> {
    postcard::to_allocvec(value).map_err(|error| Error::run("writing a checkpoint", error.to_string()))
}

/// Writes the bytes of a value, without ever having all of them.
///
/// # Errors
/// Those of the writer.
pub(crate) fn write_to<T: Serialize + ?Sized>(value: &T, to: impl Write) -> io::Result<()> {
    let mut to = Remembering { to, failed: None };
    let written = postcard::to_io(value, &mut to).map(drop);
    match to.failed {
        Some(error) => Err(error),
        None => written.map_err(io::Error::other),
    }
}

/// A writer with its first error, which postcard forgets.
struct Remembering<W> {
    to: W,
    failed: Option<io::Error>,
}

impl<W: Write> Write for Remembering<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.to.write(bytes).map_err(|error| {
            let kind = error.kind();
            if kind != io::ErrorKind::Interrupted {
                self.failed.get_or_insert(error);
            }
            kind.into()
        })
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}

/// The value that these are the bytes of.
///
/// # Errors
/// [`Error::Run`] for bytes of another type.
pub(crate) fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T> {
    let (value, rest) = postcard::take_from_bytes(bytes).map_err(|error| damaged(&error.to_string()))?;
    if rest.is_empty() { Ok(value) } else { Err(damaged("there is more")) }
}

fn damaged(problem: &str) -> Error {
    Error::run("reading a checkpoint", problem)
}

/// The error for a checkpoint whose bytes are right and that does not fit the world all the same.
pub(super) fn foreign(part: &str) -> Error {
    Error::run("resuming", format!("the checkpoint does not fit this run: {part}; start again with --force"))
}

/// Arrays of any length, for `#[serde(with = "array")]`.
pub mod array {
    use serde::de::{Deserialize, Error};
    use serde::{Deserializer, Serialize, Serializer};

    /// Writes it as a list.
    ///
    /// # Errors
    /// The serializer's.
    pub fn serialize<S: Serializer, T: Serialize, const N: usize>(
        values: &[T; N],
        to: S,
    ) -> Result<S::Ok, S::Error> {
        values.as_slice().serialize(to)
    }

    /// Reads it back.
    ///
    /// # Errors
    /// The deserializer's; a list of another length is one.
    pub fn deserialize<'de, D: Deserializer<'de>, T: Deserialize<'de>, const N: usize>(
        from: D,
    ) -> Result<[T; N], D::Error> {
        let values = Vec::<T>::deserialize(from)?;
        let count = values.len();
        values.try_into().map_err(|_| D::Error::custom(format!("{count} values for {N}")))
    }
}

/// Columns that are mostly zero, for `#[serde(with = "sparse")]`: the length, and the rows that are not.
pub mod sparse {
    use serde::de::{Deserialize, Error};
    use serde::{Deserializer, Serialize, Serializer};

    /// Writes the rows that differ from the default.
    ///
    /// # Errors
    /// The serializer's.
    pub fn serialize<S: Serializer, T: Serialize + Default + PartialEq>(
        values: &[T],
        to: S,
    ) -> Result<S::Ok, S::Error> {
        let none = T::default();
        let rows: Vec<(u32, &T)> = (0..).zip(values).filter(|(_, value)| **value != none).collect();
        (values.len() as u32, rows).serialize(to)
    }

    /// Reads them back.
    ///
    /// # Errors
    /// The deserializer's; a row beyond the length is one.
    pub fn deserialize<'de, D: Deserializer<'de>, T: Deserialize<'de> + Default + Clone>(
        from: D,
    ) -> Result<Vec<T>, D::Error> {
        let (count, rows) = <(u32, Vec<(u32, T)>)>::deserialize(from)?;
        let mut values = vec![T::default(); count as usize];
        for (row, value) in rows {
            let place = values.get_mut(row as usize);
            *place.ok_or_else(|| D::Error::custom(format!("row {row} of {count}")))? = value;
        }
        Ok(values)
    }
}
