//! Arrays of numbers in one compressed block of text, with a table of what is where.
//!
//! Each array may be kept as differences from the element `delta` places before, and its bytes are sorted by significance; both
//! make the block smaller under deflate, and `data.js` undoes them. Numbers are little-endian.

use crate::codec::deflate::deflate;
use crate::error::{Error, Result};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Map, Value, json};

/// The type of an array's numbers, as the page names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ScalarType {
    /// Unsigned, 8 bits.
    U8,
    /// Unsigned, 16 bits.
    U16,
    /// Unsigned, 32 bits.
    U32,
    /// IEEE single precision.
    F32,
}

impl ScalarType {
    fn word(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::U16 => "u16",
            Self::U32 => "u32",
            Self::F32 => "f32",
        }
    }
}

/// Arrays that are packed one after another.
#[derive(Default)]
pub(crate) struct Pack {
    bytes: Vec<u8>,
    table: Map<String, Value>,
}

impl Pack {
    /// Adds bytes as they are.
    pub fn bytes(&mut self, name: &str, values: &[u8]) {
        self.enter(name, ScalarType::U8, 0, values.len());
        self.bytes.extend_from_slice(values);
    }

    /// Adds 16-bit numbers, as differences from the one `delta` places before (0: as they are).
    pub fn shorts(&mut self, name: &str, values: &[u16], delta: usize) {
        self.enter(name, ScalarType::U16, delta, values.len());
        let before = |i: usize| if delta > 0 && i >= delta { values[i - delta] } else { 0 };
        let left = values.iter().enumerate().map(|(i, value)| value.wrapping_sub(before(i)).to_le_bytes());
        self.planes(&left.collect::<Vec<_>>());
    }

    /// Adds 32-bit numbers, as differences from the one `delta` places before (0: as they are).
    pub fn words(&mut self, name: &str, values: &[u32], delta: usize) {
        self.enter(name, ScalarType::U32, delta, values.len());
        let before = |i: usize| if delta > 0 && i >= delta { values[i - delta] } else { 0 };
        let left = values.iter().enumerate().map(|(i, value)| value.wrapping_sub(before(i)).to_le_bytes());
        self.planes(&left.collect::<Vec<_>>());
    }

    /// Adds finite single-precision numbers.
    ///
    /// # Errors
    /// [`Error::Run`] if one is not finite.
    pub fn floats(&mut self, name: &str, values: impl IntoIterator<Item = f32>) -> Result<()> {
        let values: Vec<f32> = values.into_iter().collect();
        if let Some(bad) = values.iter().position(|value| !value.is_finite()) {
            return Err(Error::run("writing the page", format!("{name}: number {bad} is not finite")));
        }
        self.enter(name, ScalarType::F32, 0, values.len());
        self.planes(&values.iter().map(|value| value.to_le_bytes()).collect::<Vec<_>>());
        Ok(())
    }

    /// An array of single-precision numbers, as the page reads it.
    #[cfg(test)]
    pub fn floats_of(&self, name: &str) -> Vec<f32> {
        let [at, count] = ["at", "count"].map(|key| self.table[name][key].as_u64().unwrap() as usize);
        let number = |i: usize| std::array::from_fn(|plane| self.bytes[at + plane * count + i]);
        (0..count).map(|i| f32::from_le_bytes(number(i))).collect()
    }

    fn enter(&mut self, name: &str, kind: ScalarType, delta: usize, count: usize) {
        let entry = json!({ "kind": kind.word(), "at": self.bytes.len(), "count": count, "delta": delta });
        self.table.insert(name.to_owned(), entry);
    }

    /// The lowest bytes of all numbers, then the next.
    fn planes<const N: usize>(&mut self, numbers: &[[u8; N]]) {
        for plane in 0..N {
            self.bytes.extend(numbers.iter().map(|number| number[plane]));
        }
    }

    /// Where each array is in the block.
    pub fn table(&self) -> Value {
        Value::Object(self.table.clone())
    }

    /// The block: deflated, in base64.
    ///
    /// # Errors
    /// If it cannot be compressed, which does not happen in memory.
    pub fn block(&self) -> Result<String> {
        Ok(STANDARD.encode(deflate(&self.bytes)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::read::DeflateDecoder;
    use std::io::Read as _;

    fn unpacked(pack: &Pack) -> Vec<u8> {
        let packed = STANDARD.decode(pack.block().unwrap()).unwrap();
        let mut bytes = Vec::new();
        DeflateDecoder::new(&packed[..]).read_to_end(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn arrays_lie_where_the_table_says() {
        let mut pack = Pack::default();
        pack.bytes("a", &[7, 8, 9]);
        pack.shorts("b", &[1, 0x203, 0xffff, 0], 2);
        pack.words("c", &[5, 4], 1);
        pack.floats("d", [1.0]).unwrap();
        let bytes = unpacked(&pack);
        assert_eq!(bytes[..3], [7, 8, 9]);
        // 1, 0x203, 0xfffe, 0xfdfd: low bytes, then high bytes.
        assert_eq!(bytes[3..11], [1, 3, 0xfe, 0xfd, 0, 2, 0xff, 0xfd]);
        assert_eq!(bytes[11..19], [5, 0xff, 0, 0xff, 0, 0xff, 0, 0xff]);
        assert_eq!(bytes[19..], 1.0f32.to_le_bytes());
        let at: Vec<u64> = ["a", "b", "c", "d"].map(|name| pack.table()[name]["at"].as_u64().unwrap()).into();
        assert_eq!(at, [0, 3, 11, 19]);
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let mut pack = Pack::default();
        assert!(pack.floats("x", [0.0, f32::NAN]).unwrap_err().to_string().contains("number 1"));
        assert!(pack.floats("x", [f32::INFINITY]).is_err());
    }
}
