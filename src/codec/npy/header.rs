//! The header of an `.npy` file: magic bytes, version, length, and a Python dictionary of three plain values.
//!
//! Only arrays of one plain type are supported. No value may contain others, so the parser never recurses
//! and reads every byte once; a header of more than [`MOST_BYTES`] is an error, as in NumPy.

use std::str::from_utf8;

const MAGIC: &[u8] = b"\x93NUMPY";
/// Most bytes of a dictionary.
const MOST_BYTES: usize = 10_000;
/// Most values of an array; a header with more is damaged.
const MOST_VALUES: u64 = 1 << 40;

/// The contents of the dictionary.
#[derive(Debug, PartialEq)]
pub(super) struct Header<'a> {
    /// The type of the values in NumPy's short form, e.g. `<f4`.
    pub descr: &'a str,
    /// Whether the first index runs fastest.
    pub fortran_order: bool,
    /// Lengths of the array; their product is at most 2⁴⁰.
    pub shape: Vec<u64>,
}

/// The header, and the bytes after it.
///
/// # Errors
/// The problem, as the rest of a sentence that starts with the name of the file.
pub(super) fn split(bytes: &[u8]) -> Result<(Header<'_>, &[u8]), String> {
    let Some(rest) = bytes.strip_prefix(MAGIC) else { return Err("is not a NumPy .npy file".to_owned()) };
    let (length, rest) = match *rest {
        [1, _, a, b, ref rest @ ..] => (u32::from(u16::from_le_bytes([a, b])), rest),
        [2 | 3, _, a, b, c, d, ref rest @ ..] => (u32::from_le_bytes([a, b, c, d]), rest),
        [1..=3, ..] | [] => return Err(broken("it ends before its length")),
        [major, ..] => return Err(broken(&format!("version {major} is not known"))),
    };
    let length = length as usize;
    if length > MOST_BYTES {
        return Err(broken(&format!("it is {length} bytes long; the limit is {MOST_BYTES}")));
    }
    let Some((text, data)) = rest.split_at_checked(length) else {
        return Err(broken(&format!("it ends after {} of {length} bytes", rest.len())));
    };
    let text = from_utf8(text).map_err(|_| broken("it is not text"))?;
    let header = Cursor { text, at: 0 }.dictionary()?;
    let product = header.shape.iter().try_fold(1_u64, |product, &n| product.checked_mul(n.max(1)));
    if product.is_none_or(|product| product > MOST_VALUES) {
        return Err(impossible());
    }
    Ok((header, data))
}

/// The header of a `<f4` array in C order; the values follow it.
pub(super) fn for_singles(shape: [usize; 2]) -> Vec<u8> {
    let [rows, columns] = shape;
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    // Values start at a multiple of 64 bytes, after a line break.
    let start = (MAGIC.len() + 4 + text.len() + 1).next_multiple_of(64);
    let length = start - MAGIC.len() - 4;
    text.extend(std::iter::repeat_n(' ', length - 1 - text.len()));
    text.push('\n');
    // Two numbers of at most 20 digits: far below 2¹⁶ bytes.
    [MAGIC, &[1, 0], &(length as u16).to_le_bytes(), text.as_bytes()].concat()
}

fn broken(why: &str) -> String {
    format!("has a broken header ({why})")
}

fn impossible() -> String {
    "claims an impossible shape, so its header is damaged".to_owned()
}

/// A position in the text of the dictionary.
struct Cursor<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Cursor<'a> {
    fn dictionary(mut self) -> Result<Header<'a>, String> {
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        self.expect('{')?;
        while !self.eat('}') {
            let key = self.string()?;
            self.expect(':')?;
            let again = match key {
                "descr" => descr.replace(self.string()?).is_some(),
                "fortran_order" => fortran_order.replace(self.boolean()?).is_some(),
                "shape" => shape.replace(self.numbers()?).is_some(),
                _ => return Err(broken(&format!("`{}` means nothing", key.escape_debug()))),
            };
            if again {
                return Err(broken(&format!("`{key}` is given twice")));
            }
            if !self.eat(',') {
                self.expect('}')?;
                break;
            }
        }
        if !self.rest().is_empty() {
            return Err(self.expected("the end"));
        }
        let missing = |key: &str| broken(&format!("`{key}` is missing"));
        Ok(Header {
            descr: descr.ok_or_else(|| missing("descr"))?,
            fortran_order: fortran_order.ok_or_else(|| missing("fortran_order"))?,
            shape: shape.ok_or_else(|| missing("shape"))?,
        })
    }

    /// The remaining text, from the next byte that is not blank.
    fn rest(&mut self) -> &'a str {
        let rest = self.text[self.at..].trim_start_matches([' ', '\t', '\r', '\n']);
        self.at = self.text.len() - rest.len();
        rest
    }

    fn eat(&mut self, wanted: char) -> bool {
        let found = self.rest().starts_with(wanted);
        self.at += if found { wanted.len_utf8() } else { 0 };
        found
    }

    fn expect(&mut self, wanted: char) -> Result<(), String> {
        if self.eat(wanted) { Ok(()) } else { Err(self.expected(&format!("`{wanted}`"))) }
    }

    fn expected(&self, what: &str) -> String {
        broken(&format!("expected {what} at byte {}", self.at))
    }

    /// A string in quotes, without escapes.
    fn string(&mut self) -> Result<&'a str, String> {
        let rest = self.rest();
        let quoted = ['\'', '"'].into_iter().find_map(|quote| rest.strip_prefix(quote)?.split_once(quote));
        let Some((text, _)) = quoted.filter(|(text, _)| !text.contains(['\\', '\n'])) else {
            return Err(self.expected("a name in quotes"));
        };
        self.at += text.len() + 2;
        Ok(text)
    }

    fn boolean(&mut self) -> Result<bool, String> {
        let rest = self.rest();
        let found = [("True", true), ("False", false)].into_iter().find(|(word, _)| rest.starts_with(word));
        let Some((word, value)) = found else { return Err(self.expected("`True` or `False`")) };
        self.at += word.len();
        Ok(value)
    }

    /// Whole numbers in brackets.
    fn numbers(&mut self) -> Result<Vec<u64>, String> {
        let mut numbers = Vec::new();
        self.expect('(')?;
        while !self.eat(')') {
            let rest = self.rest();
            let digits = &rest[..rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len())];
            if digits.is_empty() {
                return Err(self.expected("a whole number"));
            }
            numbers.push(digits.parse().map_err(|_| impossible())?);
            self.at += digits.len();
            // Python 2 marks long numbers.
            let _ = self.eat('L');
            if !self.eat(',') {
                self.expect(')')?;
                break;
            }
        }
        Ok(numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    /// A file of `version` with this dictionary and two bytes of data.
    fn file(version: u8, text: &str) -> Vec<u8> {
        let length = if version == 1 {
            (text.len() as u16).to_le_bytes().to_vec()
        } else {
            (text.len() as u32).to_le_bytes().to_vec()
        };
        [MAGIC, &[version, 0], &length, text.as_bytes(), b"ab"].concat()
    }

    #[track_caller]
    fn refused(text: &str, word: &str) {
        let message = split(&file(2, text)).expect_err("a bad header must be refused");
        assert!(message.contains(word), "{message} should say {word}");
    }

    #[test]
    fn every_version_and_spelling_is_read() {
        let texts = [
            "{'descr': '<f4', 'fortran_order': True, 'shape': (3, 7), }  \n",
            "{\"shape\":(3L,7L,),\"fortran_order\":True,\"descr\":\"<f4\"}",
            " {'fortran_order' : True , 'descr' : '<f4' , 'shape' : ( 3 , 7 ) } \n",
        ];
        let expected = Header { descr: "<f4", fortran_order: true, shape: vec![3, 7] };
        for (version, text) in (1..=3).flat_map(|version| texts.map(|text| (version, text))) {
            assert_eq!(
                split(&file(version, text)),
                Ok((Header { shape: vec![3, 7], ..expected }, &b"ab"[..]))
            );
        }
        let shape = |text: &str| {
            let text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {text}}}");
            split(&file(1, &text)).map(|(header, _)| header.shape)
        };
        assert_eq!(shape("()"), Ok(vec![]));
        assert_eq!(shape("(5,)"), Ok(vec![5]));
    }

    #[test]
    fn written_headers_are_read_and_end_at_64_bytes() {
        for rows in [0, 1, 99, 123_456_789] {
            let bytes = for_singles([rows, 7]);
            assert!(bytes.len().is_multiple_of(64) && bytes.ends_with(b"\n"), "{}", bytes.len());
            let expected = Header { descr: "<f4", fortran_order: false, shape: vec![rows as u64, 7] };
            assert_eq!(split(&bytes), Ok((expected, &b""[..])));
        }
    }

    #[test]
    fn bad_headers_are_refused_with_the_place() {
        let good = "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 7), }";
        refused(&good.replace("'descr': '<f4', ", ""), "`descr` is missing");
        refused(&good.replace("'shape': (3, 7), ", ""), "`shape` is missing");
        refused(&good.replace("fortran_order", "order"), "`order` means nothing");
        refused(&good.replace("'fortran_order': False", "'descr': '<f4'"), "`descr` is given twice");
        refused(&good.replace("False", "0"), "`True` or `False` at byte 34");
        refused(&good.replace("'<f4'", "[('x', '<f4')]"), "in quotes at byte 10");
        refused(&good.replace("'<f4'", "'<f4"), "broken header");
        refused(&good.replace("'<f4'", "'<f\\x34'"), "in quotes at byte 10");
        refused(&good.replace("(3, 7)", "(-3, 7)"), "a whole number at byte 51");
        refused(&good.replace("(3, 7)", "(3 7)"), "`)`");
        refused(&good.replace("(3, 7)", "[3, 7]"), "`(`");
        refused(&good.replace("(3, 7)", "(3.0, 7)"), "`)`");
        refused(&good.replace(" }", ""), "in quotes");
        refused(&good.replace(", }", ""), "`}`");
        refused(&format!("{good} {good}"), "the end");
        refused("", "`{`");
        refused("é", "`{`");
        for shape in ["(4294967296, 4294967296)", "(99999999999999999999, 7)", "(0, 18446744073709551615, 7)"]
        {
            refused(&good.replace("(3, 7)", shape), "impossible shape");
        }
    }

    #[test]
    fn bad_starts_are_refused() {
        let refused = |bytes: &[u8], word: &str| {
            let message = split(bytes).expect_err("a bad start must be refused");
            assert!(message.contains(word), "{message} should say {word}");
        };
        refused(b"", "not a NumPy");
        refused(b"\x93NUMPY", "ends before its length");
        refused(b"\x93NUMPY\x01\x00\x10", "ends before its length");
        refused(b"\x93NUMPY\x02\x00\x10\x00", "ends before its length");
        refused(b"\x93NUMPY\x04\x00\x10\x00\x00\x00", "version 4");
        refused(b"\x93NUMPY\x01\x00\x10\x00{", "after 1 of 16 bytes");
        refused(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{", "4294967295 bytes long");
        refused(b"\x93NUMPY\x01\x00\x02\x00{\xff", "not text");
    }

    #[test]
    fn nested_and_long_headers_take_no_time() {
        let started = Instant::now();
        for open in ["(", "[", "{", "{'shape': ", "'"] {
            for depth in [24, MOST_BYTES / open.len() - 100] {
                let nested = open.repeat(depth);
                refused(&nested, "broken header");
                refused(
                    &format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {nested}"),
                    "broken header",
                );
            }
        }
        refused(&" ".repeat(MOST_BYTES + 1), "10001 bytes long");
        assert!(started.elapsed().as_secs() < 2);
    }
}
