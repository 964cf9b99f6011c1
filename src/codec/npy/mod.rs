//! NumPy `.npy` files: SG lobes of shape `[M, 7]` (axis, sharpness, RGB amplitude), and matrices.

mod array;
mod header;

use std::path::Path;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use array::Floats;
pub use array::Matrix;
pub(crate) use array::parse_matrix;

use crate::codec::file;
use crate::codec::finite::check_finite;
use crate::light::{LightLobe, MAX_RADIANCE, MAX_SHARPNESS, MOST_LOBES};
use crate::{Error, Result};

/// The convention of the axes in a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum NpyConvention {
    /// World directions (PhySG's own training writes the same).
    #[default]
    Lobelia,
    /// PhySG's published `envmap*_sg_fit` files, whose maps have θ = 2πu: (x, y, z) in the file is (z, y, −x) in the world.
    PhySgFit,
}

impl NpyConvention {
    /// World direction of an axis in the file.
    fn world_from_file(self, axis: DVec3) -> DVec3 {
        match self {
            Self::Lobelia => axis,
            Self::PhySgFit => DVec3::new(axis.z, axis.y, -axis.x),
        }
    }

    /// Axis in the file of a world direction.
    fn file_from_world(self, axis: Vec3) -> Vec3 {
        match self {
            Self::Lobelia => axis,
            Self::PhySgFit => Vec3::new(-axis.z, axis.y, axis.x),
        }
    }
}

/// Largest file that is read: the most lobes in double precision take 28 kB, and the shape of a larger light is worth naming.
const MOST_FILE_BYTES: u64 = 256 << 20;

const HELP: &str =
    "save an array of float32 or float64 of shape [M, 7]: axis x y z, sharpness, amplitude r g b";

/// Reads lobes from an `.npy` file of shape `[M, 7]`, or `[M, 5]` with one gray amplitude.
///
/// `f32` or `f64`, C or Fortran order, either byte order; at most 2048 rows. Reading takes the absolute values of sharpness and
/// amplitude, and normalizes axes. An axis whose length is within 10⁻⁶ of 1 keeps its bits, so that files written
/// by [`write_lobes`] are read back exactly.
///
/// # Errors
/// [`Error::Input`] naming the row (from 0) for a zero axis or a non-finite value, and for a missing or truncated file, one
/// of another format, another shape or type, no rows or more than 512.
pub fn read_lobes(path: impl AsRef<Path>, convention: NpyConvention) -> Result<Vec<LightLobe>> {
    let path = path.as_ref();
    // More than a header and the most rows are read only to say that there are more.
    let bytes = file::read_up_to(path, MOST_FILE_BYTES, |_| "check the path of the lobes".to_owned())?;
    let (values, columns) = read_table(path, &bytes)?;
    values.chunks_exact(columns).enumerate().map(|(row, v)| lobe_of_row(path, row, v, convention)).collect()
}

/// Writes lobes as an `f32`, little-endian, C-order `.npy` file of shape `[M, 7]`; it is created only when it is complete.
///
/// # Errors
/// [`Error::Run`] for a lobe that is not finite; [`Error::Io`] if the file cannot be written.
pub fn write_lobes(path: impl AsRef<Path>, lobes: &[LightLobe], convention: NpyConvention) -> Result<()> {
    let path = path.as_ref();
    let row = |lobe: &LightLobe| {
        let axis = convention.file_from_world(lobe.axis);
        let [r, g, b] = lobe.amplitude.to_array();
        [axis.x, axis.y, axis.z, lobe.sharpness, r, g, b]
    };
    let values: Vec<f32> = lobes.iter().flat_map(row).collect();
    check_finite(path, values.iter().copied(), |at| format!("lobe {} is not finite", at / 7))?;
    let mut bytes = header::for_singles([lobes.len(), 7]);
    bytes.extend(values.into_iter().flat_map(f32::to_le_bytes));
    file::write_bytes(path, &bytes)
}

/// The file's values in C order, as `f64`, and the number of columns.
fn read_table(path: &Path, bytes: &[u8]) -> Result<(Vec<f64>, usize)> {
    let bad = |problem: String| Error::input(path, "", problem, HELP);
    let (header, _) = header::split(bytes).map_err(bad)?;
    let (rows, columns) = match header.shape.as_slice() {
        [rows, columns @ (5 | 7)] => (*rows as usize, *columns as usize),
        shape => return Err(bad(format!("has shape {shape:?}, not [M, 7]"))),
    };
    if rows == 0 {
        return Err(bad("has no rows, so there are no lobes".to_owned()));
    }
    if rows > MOST_LOBES {
        return Err(Error::input(
            path,
            "",
            format!("has {rows} rows, and a light has at most {MOST_LOBES} lobes"),
            "Fit fewer lobes to the light: `lobelia env fit MAP --lobes 128`.",
        ));
    }
    Ok((Floats::new(bytes).map_err(bad)?.matrix(rows, columns), columns))
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
    let amplitude = if v.len() == 7 { DVec3::new(v[4], v[5], v[6]) } else { DVec3::splat(v[4]) };
    Ok(LightLobe {
        axis: convention.world_from_file(unit).as_vec3(),
        sharpness: v[3].abs() as f32,
        amplitude: amplitude.abs().as_vec3(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::fibonacci::fibonacci_axes;

    fn lobes() -> Vec<LightLobe> {
        let lobe = |(i, axis)| LightLobe {
            axis,
            sharpness: 0.1 + 7.3 * i as f32,
            amplitude: Vec3::new(1.0 / (1 + i) as f32, 0.2, i as f32),
        };
        fibonacci_axes(37).into_iter().enumerate().map(lobe).collect()
    }

    fn path_in(folder: &tempfile::TempDir) -> std::path::PathBuf {
        folder.path().join("lobes.npy")
    }

    /// A version 1.0 file, assembled here so that the test of the reader does not depend on the writer.
    fn npy(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
        let order = if fortran { "True" } else { "False" };
        let mut header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
        while (10 + header.len() + 1) % 64 != 0 {
            header.push(' ');
        }
        header.push('\n');
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn read_bytes(bytes: &[u8], convention: NpyConvention) -> Result<Vec<LightLobe>> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(path_in(&folder), bytes).expect("a test file");
        read_lobes(path_in(&folder), convention)
    }

    #[test]
    fn both_conventions_come_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        for convention in [NpyConvention::Lobelia, NpyConvention::PhySgFit] {
            write_lobes(path_in(&folder), &lobes(), convention).unwrap();
            assert_eq!(read_lobes(path_in(&folder), convention).unwrap(), lobes());
        }
    }

    #[test]
    fn axes_are_mapped_and_normalized_and_signs_dropped() {
        let row: Vec<u8> =
            [0.0_f32, 3.0, 4.0, -20.0, -1.0, 2.0, -3.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let bytes = npy("<f4", false, "(1, 7)", &row);
        let lobe = read_bytes(&bytes, NpyConvention::Lobelia).unwrap()[0];
        assert_eq!(lobe.axis, Vec3::new(0.0, 0.6, 0.8));
        assert_eq!((lobe.sharpness, lobe.amplitude), (20.0, Vec3::new(1.0, 2.0, 3.0)));
        let lobe = read_bytes(&bytes, NpyConvention::PhySgFit).unwrap()[0];
        assert_eq!(lobe.axis, Vec3::new(0.8, 0.6, -0.0));
    }

    #[test]
    fn types_orders_and_gray_amplitudes_are_understood() {
        let rows = [[1.0, 0.0, 0.0, 5.0, 1.0, 2.0, 3.0], [0.0, 1.0, 0.0, 6.0, 4.0, 5.0, 6.0_f64]];
        let expected: Vec<LightLobe> = rows
            .iter()
            .map(|r| LightLobe {
                axis: Vec3::new(r[0] as f32, r[1] as f32, r[2] as f32),
                sharpness: r[3] as f32,
                amplitude: Vec3::new(r[4] as f32, r[5] as f32, r[6] as f32),
            })
            .collect();
        let by_rows: Vec<f64> = rows.concat();
        let by_columns: Vec<f64> = (0..14).map(|k| rows[k % 2][k / 2]).collect();
        let read = |descr, fortran, data: Vec<u8>| {
            read_bytes(&npy(descr, fortran, "(2, 7)", &data), NpyConvention::Lobelia).unwrap()
        };
        assert_eq!(read("<f8", false, by_rows.iter().flat_map(|v| v.to_le_bytes()).collect()), expected);
        assert_eq!(read(">f8", true, by_columns.iter().flat_map(|v| v.to_be_bytes()).collect()), expected);
        let singles = by_rows.iter().flat_map(|v| (*v as f32).to_be_bytes()).collect();
        assert_eq!(read(">f4", false, singles), expected);
        let gray: Vec<u8> = [0.0_f32, 0.0, 1.0, 2.0, 3.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let lobe = read_bytes(&npy("<f4", false, "(1, 5)", &gray), NpyConvention::Lobelia).unwrap()[0];
        assert_eq!(lobe.amplitude, Vec3::splat(3.0));
    }

    #[test]
    fn matrices_are_read_in_rows() {
        let bytes = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let expected = Matrix { rows: 2, columns: 3, values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0] };
        let rows = npy("<f8", false, "(2, 3)", &bytes(&expected.values));
        assert_eq!(parse_matrix(&rows), Ok(expected.clone()));
        let columns = npy("<f8", true, "(2, 3)", &bytes(&[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]));
        assert_eq!(parse_matrix(&columns), Ok(expected));
        let refused = |bytes: &[u8], word: &str| {
            let problem = parse_matrix(bytes).expect_err("it is no matrix");
            assert!(problem.contains(word), "{problem} should say {word}");
        };
        refused(&npy("<f8", false, "(2, 1, 3)", &[0; 48]), "has shape [2, 1, 3]");
        refused(&npy("<f8", false, "(6,)", &[0; 48]), "not that of a matrix");
        refused(&npy("<f8", false, "(2, 4)", &[0; 48]), "truncated");
        refused(&npy("<i8", false, "(2, 3)", &[0; 48]), "not 32- or 64-bit floats");
        let empty = parse_matrix(&npy("<f8", true, "(0, 3)", &[])).unwrap();
        assert_eq!((empty.rows, empty.values.len()), (0, 0));
    }

    #[test]
    fn damaged_bytes_never_panic() {
        let folder = tempfile::tempdir().unwrap();
        write_lobes(path_in(&folder), &lobes()[..3], NpyConvention::Lobelia).unwrap();
        let whole = std::fs::read(path_in(&folder)).unwrap();
        for at in 0..whole.len() {
            for value in [0, b'9', b'(', 0xff] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                if let Ok(lobes) = read_bytes(&bytes, NpyConvention::Lobelia) {
                    assert!(crate::light::validate_lobes(&lobes).is_ok());
                }
            }
        }
    }

    #[test]
    fn bad_files_are_refused_and_rows_named() {
        let refused = |bytes: &[u8], word: &str| {
            let error = read_bytes(bytes, NpyConvention::Lobelia).expect_err("a bad file must be refused");
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains(word), "{error} should say {word}");
        };
        let data =
            |rows: &[[f32; 7]]| rows.concat().iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let good = [0.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0];
        let mut zero_axis = good;
        zero_axis[1] = 0.0;
        let mut nan = good;
        nan[5] = f32::NAN;
        refused(&npy("<f4", false, "(2, 7)", &data(&[good, zero_axis])), "row 1");
        refused(&npy("<f4", false, "(2, 7)", &data(&[nan, good])), "row 0");
        refused(&npy("<f4", false, "(2, 7)", &data(&[good])), "truncated");
        refused(&npy("<f4", false, "(512, 7)", &data(&[good])), "truncated");
        refused(&npy("<f4", false, "(9000000000, 7)", &data(&[good])), "at most 2048");
        refused(&npy("<f4", false, "(900000000000, 7)", &data(&[good])), "impossible");
        refused(&npy("<f4", false, "(0, 18446744073709551615, 7)", &data(&[good])), "impossible");
        refused(&npy("<f4", false, "(7,)", &data(&[good])), "shape");
        refused(&npy("<f4", false, "(1, 6)", &data(&[good])), "shape");
        refused(&npy("<f4", false, "(0, 7)", &[]), "no rows");
        refused(&npy("<i4", false, "(1, 7)", &data(&[good])), "floats");
        refused(&npy("|O", false, "(1, 7)", &data(&[good])), "holds |O");
        refused(&npy("<f4", false, "(1000000, 7)", &data(&vec![good; 1_000_000])), "at most 2048");
        refused(&npy("<f8", false, "(1, 7)", &data(&[good])), "truncated");
        refused(b"PK\x03\x04", "not a NumPy");
        refused(b"\x93NUMPY\x01\x00\x10\x00{", "header");
        assert!(read_lobes("/no/such/file.npy", NpyConvention::Lobelia).is_err());
        let mut bright = good;
        bright[6] = 1e38;
        refused(&npy("<f4", false, "(1, 7)", &data(&[bright])), "row 0");
    }

    #[test]
    fn a_lobe_that_is_not_finite_is_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let mut broken = lobes();
        broken[3].amplitude.y = f32::NAN;
        let error = write_lobes(path_in(&folder), &broken, NpyConvention::PhySgFit).unwrap_err();
        assert!(error.to_string().contains("lobe 3 is not finite"), "{error}");
        assert!(!path_in(&folder).exists());
    }
}
