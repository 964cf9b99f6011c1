//! NumPy files: SG lobes of shape `[M, 7]` (axis, sharpness, RGB amplitude) and matrices in `.npy`,
//! and matrices in `.npz`, a zip archive, stored or deflated, of `.npy` files.
//!
//! The header of an array is magic bytes, a version, a length, and a Python dictionary of three
//! plain values. None of them contains others, so the parser never recurses; a header of more than
//! 10 000 bytes is an error, as in NumPy.
//!
//! ```
//! use lobelia_io::codec::npy::{NpyConvention, read_lobes, write_lobes};
//! use lobelia_world::light::LightLobe;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("light.npy");
//! let lobes = LightLobe::even(24);
//! write_lobes(&path, &lobes, NpyConvention::Lobelia)?;
//! assert_eq!(read_lobes(&path, NpyConvention::Lobelia)?, lobes);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::codec::file::{check_finite, read_up_to, write_bytes};
use glam::{DVec3, Vec3};
use lobelia_geometry::{Error, Result};
use lobelia_world::light::{LightLobe, MAX_RADIANCE, MAX_SHARPNESS, MOST_LOBES};
use serde::{Deserialize, Serialize};
use std::{io::Cursor, io::Read as _, path::Path, path::PathBuf};
use zip::{ZipArchive, result::ZipError};

const MAGIC: &[u8] = b"\x93NUMPY";
/// Most bytes of a dictionary.
const MOST_HEADER_BYTES: usize = 10_000;
/// Largest file of lobes that is read: the most take 115 kB in double precision, and the shape of a
/// larger light is worth naming.
const MOST_FILE_BYTES: u64 = 256 << 20;
/// Most bytes of an archive.
const MOST_ARCHIVE_BYTES: u64 = 64 << 20;
/// Most bytes of a matrix in it, so that a small archive cannot fill the memory.
const MOST_MATRIX_BYTES: u64 = 1 << 20;

const HELP: &str =
    "save an array of float32 or float64 of shape [M, 7]: axis x y z, sharpness, amplitude r g b";

/// The convention of the axes in a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum NpyConvention {
    /// World directions (PhySG's own training writes the same).
    #[default]
    Lobelia,
    /// PhySG's published `envmap*_sg_fit` files, whose maps have θ = 2πu: (x, y, z) in the file is
    /// (z, y, −x) in the world.
    PhySgFit,
}

/// A matrix, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub columns: usize,
    /// `rows * columns` values; they may be NaN or infinite.
    pub values: Vec<f64>,
}

/// The matrix in an `.npy` file of `bytes`: `f32` or `f64`, little-endian, C or Fortran order.
///
/// # Errors
/// The problem, as the rest of a sentence that starts with the name of the file.
pub(crate) fn parse_matrix(bytes: &[u8]) -> Result<Matrix, String> {
    let ((descr, is_fortran, shape), data) = split(bytes)?;
    let [rows, columns] = shape[..] else {
        return Err(format!("has shape {shape:?}, not that of a matrix"));
    };
    let size = match descr {
        "<f4" => 4,
        "<f8" => 8,
        other => return Err(format!("holds {}, not 32- or 64-bit floats", other.escape_debug())),
    };
    let Some(data) = data.get(..rows.saturating_mul(columns).saturating_mul(size)) else {
        return Err(format!("is truncated: too short for its shape {shape:?}"));
    };
    let values: Vec<f64> = match size {
        4 => data.as_chunks().0.iter().map(|value| f64::from(f32::from_le_bytes(*value))).collect(),
        _ => data.as_chunks().0.iter().map(|value| f64::from_le_bytes(*value)).collect(),
    };
    let transposed = || (0..values.len()).map(|k| values[(k % columns) * rows + k / columns]).collect();
    let values = if is_fortran { transposed() } else { values };
    Ok(Matrix { rows, columns, values })
}

/// Reads lobes from an `.npy` file of shape `[M, 7]`, or `[M, 5]` with one gray amplitude.
///
/// `f32` or `f64`, little-endian, C or Fortran order; at most 2048 rows. Reading takes the absolute
/// values of sharpness and amplitude, and normalizes axes. An axis whose length is within 10⁻⁶ of 1
/// keeps its bits, so that files written by [`write_lobes`] are read back exactly.
///
/// # Errors
/// [`Error::Input`] naming the row (from 0) for a zero axis or a non-finite value, and for a
/// missing or truncated file, one of another format, another shape or type, no rows or more than
/// 2048.
pub fn read_lobes(path: impl AsRef<Path>, convention: NpyConvention) -> Result<Vec<LightLobe>> {
    let path = path.as_ref();
    // More than a header and the most rows are read only to say that there are more.
    let bytes = read_up_to(path, MOST_FILE_BYTES, |_| "check the path of the lobes".to_owned())?;
    let bad = |problem: String| Error::input(path, "", problem, HELP);
    let ((_, _, shape), _) = split(&bytes).map_err(bad)?;
    match shape[..] {
        [0, 5 | 7] => return Err(bad("has no rows, so there are no lobes".to_owned())),
        [rows, 5 | 7] if rows > MOST_LOBES => {
            let problem = format!("has {rows} rows, and a light has at most {MOST_LOBES} lobes");
            let help = "Fit fewer lobes to the light: `lobelia env fit MAP --lobes 128`.";
            return Err(Error::input(path, "", problem, help));
        }
        [_, 5 | 7] => {}
        _ => return Err(bad(format!("has shape {shape:?}, not [M, 7]"))),
    }
    let Matrix { columns, values, .. } = parse_matrix(&bytes).map_err(bad)?;
    values.chunks_exact(columns).enumerate().map(|(row, v)| lobe_of_row(path, row, v, convention)).collect()
}

/// Writes lobes as an `f32`, little-endian, C-order `.npy` file of shape `[M, 7]`; it is created
/// only when it is complete.
///
/// # Errors
/// [`Error::Run`] for a lobe that is not finite; [`Error::Io`] if the file cannot be written.
pub fn write_lobes(path: impl AsRef<Path>, lobes: &[LightLobe], convention: NpyConvention) -> Result<()> {
    let path = path.as_ref();
    let row = |lobe: &LightLobe| {
        let Vec3 { x, y, z } = lobe.axis;
        let axis = if convention == NpyConvention::PhySgFit { [-z, y, x] } else { [x, y, z] };
        let [r, g, b] = lobe.amplitude.to_array();
        [axis[0], axis[1], axis[2], lobe.sharpness, r, g, b]
    };
    let values: Vec<f32> = lobes.iter().flat_map(row).collect();
    check_finite(path, values.iter().copied(), |at| format!("lobe {} is not finite", at / 7))?;
    let text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, 7), }}", lobes.len());
    // Values start at a multiple of 64 bytes, after a line break; two numbers of at most 20 digits
    // are far below 2¹⁶ bytes.
    let start = (MAGIC.len() + 4 + text.len() + 1).next_multiple_of(64);
    let length = start - MAGIC.len() - 4;
    let padded = format!("{text:<width$}\n", width = length - 1);
    let mut bytes = [MAGIC, &[1, 0], &(length as u16).to_le_bytes(), padded.as_bytes()].concat();
    bytes.extend(values.into_iter().flat_map(f32::to_le_bytes));
    write_bytes(path, &bytes)
}

fn lobe_of_row(path: &Path, row: usize, v: &[f64], convention: NpyConvention) -> Result<LightLobe> {
    let bad = |problem: &str| Error::input(path, format!("row {row}"), problem, HELP);
    // Values must also be finite as f32: 1e300 becomes infinite.
    if v.iter().any(|x| !(*x as f32).is_finite()) {
        return Err(bad("holds NaN, an infinity, or a number too large"));
    }
    let file_axis = DVec3::new(v[0], v[1], v[2]);
    let length = file_axis.length();
    if length < 1e-20 {
        return Err(bad("has a zero axis, so it has no direction"));
    }
    let light = v[4..].iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    if light > f64::from(MAX_RADIANCE) || v[3].abs() > f64::from(MAX_SHARPNESS) {
        return Err(bad(&format!(
            "has amplitude {light:.3e} and sharpness {:.3e}; at most {MAX_RADIANCE:e} and {MAX_SHARPNESS:e} are usable",
            v[3].abs()
        )));
    }
    let unit = if (length - 1.0).abs() > 1e-6 { file_axis / length } else { file_axis };
    let turned = DVec3::new(unit.z, unit.y, -unit.x);
    let amplitude = if v.len() == 7 { DVec3::new(v[4], v[5], v[6]) } else { DVec3::splat(v[4]) };
    Ok(LightLobe {
        axis: if convention == NpyConvention::PhySgFit { turned } else { unit }.as_vec3(),
        sharpness: v[3].abs() as f32,
        amplitude: amplitude.abs().as_vec3(),
    })
}

/// The header of an array: the type of the values in NumPy's short form, e.g. `<f4`; whether the
/// first index runs fastest; and its lengths.
type Header<'a> = (&'a str, bool, Vec<usize>);

/// The header, and the bytes after it.
fn split(bytes: &[u8]) -> Result<(Header<'_>, &[u8]), String> {
    let Some(rest) = bytes.strip_prefix(MAGIC) else { return Err("is not a NumPy .npy file".to_owned()) };
    let (length, rest) = match *rest {
        [1, _, a, b, ref rest @ ..] => (usize::from(u16::from_le_bytes([a, b])), rest),
        [2 | 3, _, a, b, c, d, ref rest @ ..] => (u32::from_le_bytes([a, b, c, d]) as usize, rest),
        _ => return Err("has a broken header (its version or length)".to_owned()),
    };
    let parts = rest.split_at_checked(length).filter(|_| length <= MOST_HEADER_BYTES);
    parts.and_then(|(text, data)| Some((dictionary(std::str::from_utf8(text).ok()?)?, data))).ok_or_else(
        || "has a broken header (it is not a dictionary of `descr`, `fortran_order` and `shape`)".to_owned(),
    )
}

/// The values of a Python dictionary of these three keys.
fn dictionary(text: &str) -> Option<Header<'_>> {
    let value = |key: &str| Some(text.split_once(key)?.1.trim_start_matches(['\'', '"', ':', ' ']));
    let descr = value("descr")?.split_once(['\'', '"'])?.0;
    let order = value("fortran_order")?;
    let is_fortran = order.starts_with("True");
    let lengths = value("shape")?.strip_prefix('(')?.split_once(')')?.0;
    let lengths = lengths.split(',').map(str::trim).filter(|length| !length.is_empty());
    // Python 2 marks long numbers by an L.
    let shape = lengths.map(|length| length.trim_end_matches('L').parse().ok()).collect::<Option<_>>()?;
    (is_fortran || order.starts_with("False")).then_some((descr, is_fortran, shape))
}

/// An `.npz` file whose matrices are read one by one.
pub struct Npz {
    path: PathBuf,
    archive: ZipArchive<Cursor<Vec<u8>>>,
}

impl Npz {
    /// Opens an archive; `help` returns the remedy for a missing file.
    ///
    /// # Errors
    /// [`Error::Input`] if the file is missing, empty, larger than 64 MiB, or not an undamaged zip
    /// archive.
    pub fn open(path: &Path, help: impl FnOnce(&Path) -> String) -> Result<Self> {
        let bytes = read_up_to(path, MOST_ARCHIVE_BYTES, help)?;
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
    /// [`Error::Input`] that names the array if it is damaged, has more than 1 MiB, or is not a
    /// matrix of floats.
    pub fn matrix(&mut self, name: &str) -> Result<Option<Matrix>> {
        let Self { path, archive } = self;
        let place = format!("`{name}`");
        let entry = match archive.by_name(&format!("{name}.npy")) {
            Err(ZipError::FileNotFound) => return Ok(None),
            entry => entry.map_err(|error| damaged(path, &place, &error))?,
        };
        let mut bytes = Vec::new();
        let read = entry.take(MOST_MATRIX_BYTES + 1).read_to_end(&mut bytes);
        read.map_err(|error| damaged(path, &place, &error.into()))?;
        let matrix = if bytes.len() as u64 > MOST_MATRIX_BYTES {
            Err(format!("has more than {} MiB", MOST_MATRIX_BYTES >> 20))
        } else {
            parse_matrix(&bytes)
        };
        matrix
            .map(Some)
            .map_err(|problem| Error::input(&*path, place, format!("the array {problem}"), ARCHIVE_HELP))
    }
}

const ARCHIVE_HELP: &str = "Copy the file again, or write it again with numpy.savez.";

fn damaged(path: &Path, place: &str, error: &ZipError) -> Error {
    let problem =
        format!("this is not an .npz file as NumPy writes it, or it is damaged or truncated ({error})");
    Error::input(path, place, problem, ARCHIVE_HELP)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::{npy, npy_matrix, temporary, write_npz};
    use lobelia_sg::fibonacci::fibonacci_axes;

    fn lobes() -> Vec<LightLobe> {
        let lobe = |(i, axis)| LightLobe {
            axis,
            sharpness: 0.1 + 7.3 * i as f32,
            amplitude: Vec3::new(1.0 / (1 + i) as f32, 0.2, i as f32),
        };
        fibonacci_axes(37).into_iter().enumerate().map(lobe).collect()
    }

    fn singles(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    fn read(bytes: &[u8], convention: NpyConvention) -> Result<Vec<LightLobe>> {
        let (_folder, path) = temporary("lobes.npy");
        std::fs::write(&path, bytes).unwrap();
        read_lobes(path, convention)
    }

    fn refused<T>(result: Result<T>, words: &str) {
        let error = result.err().expect(words);
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(words), "{error} should say {words}");
    }

    #[test]
    fn both_conventions_come_back_bit_for_bit_and_nothing_else_is_written() {
        let (_folder, path) = temporary("lobes.npy");
        let mut broken = lobes();
        broken[3].amplitude.y = f32::NAN;
        for convention in [NpyConvention::Lobelia, NpyConvention::PhySgFit] {
            let error = write_lobes(&path, &broken, convention).unwrap_err();
            assert!(error.to_string().contains("lobe 3 is not finite") && !path.exists(), "{error}");
            write_lobes(&path, &lobes(), convention).unwrap();
            assert_eq!(read_lobes(&path, convention).unwrap(), lobes());
            let bytes = std::fs::read(&path).unwrap();
            assert_eq!((bytes.len() - 37 * 28, bytes[127]), (128, b'\n'), "values start at a multiple of 64");
            std::fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn axes_are_mapped_and_normalized_and_signs_dropped() {
        let row = npy("<f4", false, "(1, 7)", &singles(&[0.0, 3.0, 4.0, -20.0, -1.0, 2.0, -3.0]));
        let lobe = read(&row, NpyConvention::Lobelia).unwrap()[0];
        assert_eq!(lobe.axis, Vec3::new(0.0, 0.6, 0.8));
        assert_eq!((lobe.sharpness, lobe.amplitude), (20.0, Vec3::new(1.0, 2.0, 3.0)));
        let lobe = read(&row, NpyConvention::PhySgFit).unwrap()[0];
        assert_eq!(lobe.axis, Vec3::new(0.8, 0.6, -0.0));
        let gray = npy("<f4", false, "(1, 5)", &singles(&[0.0, 0.0, 1.0, 2.0, 3.0]));
        assert_eq!(read(&gray, NpyConvention::Lobelia).unwrap()[0].amplitude, Vec3::splat(3.0));
    }

    #[test]
    fn types_and_orders_are_understood_and_others_refused() {
        let doubles = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let expected = Matrix { rows: 2, columns: 3, values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0] };
        for bytes in [
            npy("<f8", false, "(2, 3)", &doubles(&expected.values)),
            npy("<f8", true, "(2, 3)", &doubles(&[1.0, 4.0, 2.0, 5.0, 3.0, 6.0])),
            npy("<f4", false, "(2, 3)", &singles(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])),
        ] {
            assert_eq!(parse_matrix(&bytes), Ok(expected.clone()));
        }
        for (descr, shape, words) in [
            ("<f8", "(2, 1, 3)", "has shape [2, 1, 3]"),
            ("<f8", "(6,)", "not that of a matrix"),
            ("<f8", "(2, 4)", "truncated"),
            ("<f8", "(9000000000, 9000000000)", "truncated"),
            ("<i8", "(2, 3)", "not 32- or 64-bit floats"),
            (">f8", "(2, 3)", "not 32- or 64-bit floats"),
        ] {
            let problem = parse_matrix(&npy(descr, false, shape, &[0; 48])).unwrap_err();
            assert!(problem.contains(words), "{problem} should say {words}");
        }
        let empty = parse_matrix(&npy("<f8", true, "(0, 3)", &[])).unwrap();
        assert_eq!((empty.rows, empty.values.len()), (0, 0));
    }

    /// A file of `version` with this dictionary and two bytes of data.
    fn file_of(version: u8, text: &str) -> Vec<u8> {
        let length = (text.len() as u32).to_le_bytes();
        let length = if version == 1 { &length[..2] } else { &length };
        [MAGIC, &[version, 0], length, text.as_bytes(), b"ab"].concat()
    }

    #[test]
    fn every_version_and_spelling_of_a_header_is_read_and_broken_ones_are_refused() {
        let good = "{'descr': '<f4', 'fortran_order': True, 'shape': (3, 7), }  \n";
        for text in [
            good,
            "{\"shape\":(3L,7L,),\"fortran_order\":True,\"descr\":\"<f4\"}",
            " {'fortran_order' : True , 'descr' : '<f4' , 'shape' : ( 3 , 7 ) } \n",
        ] {
            for version in 1..=3 {
                let expected = ("<f4", true, vec![3, 7]);
                assert_eq!(split(&file_of(version, text)), Ok((expected, &b"ab"[..])));
            }
        }
        for bad in [
            &good.replace("'descr': '<f4', ", ""),
            &good.replace("fortran_order", "order"),
            &good.replace("True", "0"),
            &good.replace("(3, 7)", "(3 7)"),
            &good.replace("(3, 7)", "[3]"),
            &good.replace("(3, 7)", "(-3,)"),
            &"(".repeat(9000),
            &"{'shape': (".repeat(900),
            "",
        ] {
            assert!(split(&file_of(2, bad)).unwrap_err().contains("broken header"), "{bad}");
        }
        for bytes in [
            &b"\x93NUMPY"[..],
            b"\x93NUMPY\x02\x00\x10\x00",
            b"\x93NUMPY\x04\x00\x10\x00\x00\x00",
            b"\x93NUMPY\x01\x00\x10\x00{",
            b"\x93NUMPY\x02\x00\xff\xff\xff\xff{",
            b"\x93NUMPY\x01\x00\x02\x00{\xff",
        ] {
            assert!(split(bytes).unwrap_err().contains("broken header"));
        }
        assert!(split(b"").unwrap_err().contains("not a NumPy"));
    }

    #[test]
    fn bad_lobes_are_refused_and_rows_named() {
        let good = [0.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0];
        let with = |at: usize, value: f32| std::array::from_fn(|i| if i == at { value } else { good[i] });
        for (shape, rows, words) in [
            ("(2, 7)", [good, with(1, 0.0)], "row 1"),
            ("(2, 7)", [with(5, f32::NAN), good], "row 0"),
            ("(2, 7)", [with(6, 1e38), good], "row 0"),
            ("(3, 7)", [good, good], "truncated"),
            ("(9000000000, 7)", [good, good], "at most 2048"),
            ("(7,)", [good, good], "shape"),
            ("(1, 6)", [good, good], "shape"),
            ("(0, 7)", [good, good], "no rows"),
        ] {
            refused(read(&npy("<f4", false, shape, &singles(&rows.concat())), NpyConvention::Lobelia), words);
        }
        refused(read_lobes("/no/such/file.npy", NpyConvention::Lobelia), "no such file");
    }

    fn open(path: &Path) -> Result<Npz> {
        Npz::open(path, |_| String::new())
    }

    #[test]
    fn truncated_archives_are_errors_and_damage_is_not_taken() {
        let (_folder, path) = temporary("a.npz");
        write_npz(&path, &[("a", npy_matrix(4, 4, &[0.5; 16]))]);
        let whole = std::fs::read(&path).unwrap();
        for at in (1..whole.len()).step_by(7) {
            std::fs::write(&path, &whole[..at]).unwrap();
            refused(open(&path).and_then(|mut npz| npz.matrix("a")), "damaged or truncated");
            let mut bytes = whole.clone();
            bytes[at] ^= 0x55;
            std::fs::write(&path, &bytes).unwrap();
            // Some bytes mean nothing; none may change a value without notice.
            if let Ok(Some(matrix)) = open(&path).and_then(|mut npz| npz.matrix("a")) {
                assert_eq!(matrix.values, [0.5; 16], "byte {at}");
            }
        }
    }

    #[test]
    fn bombs_and_other_arrays_are_refused() {
        let (_folder, path) = temporary("a.npz");
        let arrays = [("large", npy_matrix(1000, 1000, &[0.0; 1_000_000])), ("hello", b"hello".to_vec())];
        write_npz(&path, &arrays);
        assert!(std::fs::metadata(&path).unwrap().len() < 20_000);
        let mut npz = open(&path).unwrap();
        refused(npz.matrix("large"), "`large`: the array has more than 1 MiB");
        refused(npz.matrix("hello"), "`hello`: the array is not a NumPy");
        std::fs::write(&path, b"no zip at all").unwrap();
        refused(open(&path), "not an .npz file");
    }
}
