//! What a reconstruction of COLMAP holds: how many photographs, and how well its points project into them.

use crate::codec::file::read_bytes;
use crate::codec::nearby::{missing_file_help, natural_order};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// A point of `points3D.bin` up to its track: ID, position, color, error, length of the track.
const POINT_BYTES: usize = 8 + 3 * 8 + 3 + 8 + 8;
/// Where in it the error is.
const ERROR_AT: usize = 8 + 3 * 8 + 3;
/// A photograph in `images.bin` up to its name: ID, rotation, translation, camera.
const POSE_BYTES: usize = 4 + 7 * 8 + 4;
/// A feature in it: its place, and the ID of its point or −1.
const FEATURE_BYTES: usize = 3 * 8;
/// A photograph and a feature in it.
const TRACK_BYTES: usize = 8;

/// A reconstruction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SparseModel {
    pub folder: PathBuf,
    /// How many photographs it places.
    pub images: u64,
}

/// The reconstructions in the folders of `models`, the one of most photographs first.
///
/// # Errors
/// [`Error::Io`] or [`Error::Input`] if one cannot be read.
pub(super) fn models(models: &Path) -> Result<Vec<SparseModel>> {
    let mut folders = Vec::new();
    for entry in std::fs::read_dir(models).map_err(Error::io("read", models))? {
        let folder = entry.map_err(Error::io("read", models))?.path();
        if folder.join("images.bin").is_file() {
            folders.push(folder);
        }
    }
    folders.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    let found = folders
        .into_iter()
        .map(|folder| Ok(SparseModel { images: count(&folder.join("images.bin"))?, folder }));
    let mut found = found.collect::<Result<Vec<_>>>()?;
    found.sort_by_key(|model| std::cmp::Reverse(model.images));
    Ok(found)
}

/// The number that a binary file of COLMAP begins with.
fn count(file: &Path) -> Result<u64> {
    let bytes = read_bytes(file, missing_file_help)?;
    let first = bytes.first_chunk().copied().map(u64::from_le_bytes);
    first.ok_or_else(|| cut_short(file))
}

/// Mean reprojection error of a model's points, in pixels; `None` for a model without points.
///
/// # Errors
/// [`Error::Input`] if `points3D.bin` is missing or truncated.
pub(super) fn mean_reprojection_error(model: &Path) -> Result<Option<f64>> {
    let file = model.join("points3D.bin");
    let bytes = read_bytes(&file, missing_file_help)?;
    let (sum, points) = errors(&bytes).ok_or_else(|| cut_short(&file))?;
    Ok((points > 0).then(|| sum / points as f64))
}

/// Sum of the errors of all points, and their number; `None` if the file is truncated.
fn errors(bytes: &[u8]) -> Option<(f64, u64)> {
    let points = u64::from_le_bytes(*bytes.first_chunk()?);
    let (mut sum, mut at) = (0.0, 8_usize);
    for _ in 0..points {
        let point = bytes.get(at..at.checked_add(POINT_BYTES)?)?;
        sum += f64::from_le_bytes(*point[ERROR_AT..].first_chunk()?);
        let track = u64::from_le_bytes(*point.last_chunk()?);
        let skipped = usize::try_from(track).ok()?.checked_mul(TRACK_BYTES)?;
        at = at.checked_add(POINT_BYTES)?.checked_add(skipped)?;
    }
    (at <= bytes.len()).then_some((sum, points))
}

/// How many points of the model each photograph of `images.bin` sees, by name.
///
/// # Errors
/// [`Error::Input`] if the file is missing or truncated.
pub(super) fn points_seen(model: &Path) -> Result<Vec<(String, u64)>> {
    Ok(photographs(model)?.into_iter().map(|photograph| (photograph.name, photograph.points)).collect())
}

/// The direction in which each photograph of `images.bin` looks, in the model's world, by name.
///
/// # Errors
/// [`Error::Input`] if the file is missing or truncated.
pub(super) fn view_directions(model: &Path) -> Result<Vec<(String, [f64; 3])>> {
    let placed = photographs(model)?.into_iter();
    Ok(placed.map(|photograph| (photograph.name, photograph.direction)).collect())
}

/// A photograph of a model.
struct Placed {
    name: String,
    /// The third row of the rotation from world to camera.
    direction: [f64; 3],
    /// How many points it sees.
    points: u64,
}

fn photographs(model: &Path) -> Result<Vec<Placed>> {
    let file = model.join("images.bin");
    let bytes = read_bytes(&file, missing_file_help)?;
    placed(&bytes).ok_or_else(|| cut_short(&file))
}

/// The photographs of `images.bin`; `None` if the file is truncated.
fn placed(bytes: &[u8]) -> Option<Vec<Placed>> {
    let photographs = u64::from_le_bytes(*bytes.first_chunk()?);
    let (mut found, mut at) = (Vec::new(), 8_usize);
    for _ in 0..photographs {
        // The rotation is a unit quaternion, its real part first.
        let number = |k: usize| Some(f64::from_le_bytes(*bytes.get(at + 4 + 8 * k..)?.first_chunk()?));
        let [w, x, y, z] = [number(0)?, number(1)?, number(2)?, number(3)?];
        let direction = [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
        at = at.checked_add(POSE_BYTES)?;
        let length = bytes.get(at..)?.iter().position(|byte| *byte == 0)?;
        let name = String::from_utf8_lossy(&bytes[at..at + length]).into_owned();
        at += length + 1;
        let features = usize::try_from(u64::from_le_bytes(*bytes.get(at..)?.first_chunk()?)).ok()?;
        let end = at.checked_add(8)?.checked_add(features.checked_mul(FEATURE_BYTES)?)?;
        let features = bytes.get(at + 8..end)?.chunks_exact(FEATURE_BYTES);
        let has_point = |feature: &&[u8]| feature[FEATURE_BYTES - 8..] != [0xff; 8];
        found.push(Placed { name, direction, points: features.filter(has_point).count() as u64 });
        at = end;
    }
    Some(found)
}

fn cut_short(file: &Path) -> Error {
    Error::input(file, "", "the file is truncated", "Delete the output folder and prepare the data again.")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(errors: &[f64]) -> Vec<u8> {
        let mut bytes = (errors.len() as u64).to_le_bytes().to_vec();
        for (i, error) in errors.iter().enumerate() {
            bytes.extend([0; ERROR_AT]);
            bytes.extend(error.to_le_bytes());
            bytes.extend((i as u64).to_le_bytes());
            bytes.extend(vec![7; i * TRACK_BYTES]);
        }
        bytes
    }

    #[test]
    fn the_mean_error_is_over_points() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("points3D.bin");
        std::fs::write(&file, points(&[0.5, 1.5, 1.0])).unwrap();
        assert_eq!(mean_reprojection_error(folder.path()).unwrap(), Some(1.0));
        std::fs::write(&file, points(&[])).unwrap();
        assert_eq!(mean_reprojection_error(folder.path()).unwrap(), None);
        let whole = points(&[0.5, 1.5, 1.0]);
        for length in [4, 8, 40, whole.len() - 1] {
            std::fs::write(&file, &whole[..length]).unwrap();
            let error = mean_reprojection_error(folder.path()).unwrap_err();
            assert!(error.to_string().contains("truncated"), "{length}: {error}");
        }
        let mut endless = whole;
        endless[..8].copy_from_slice(&u64::MAX.to_le_bytes());
        std::fs::write(&file, &endless).unwrap();
        assert!(mean_reprojection_error(folder.path()).is_err());
    }

    /// `images.bin` of photographs whose features have these points.
    fn photographs(features: &[(&str, &[i64])]) -> Vec<u8> {
        let mut bytes = (features.len() as u64).to_le_bytes().to_vec();
        for (name, points) in features {
            bytes.extend([0; POSE_BYTES]);
            bytes.extend(name.as_bytes());
            bytes.push(0);
            bytes.extend((points.len() as u64).to_le_bytes());
            for point in *points {
                bytes.extend([0; 16]);
                bytes.extend(point.to_le_bytes());
            }
        }
        bytes
    }

    #[test]
    fn the_points_that_a_photograph_sees_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("images.bin");
        let whole = photographs(&[("a.jpg", &[4, -1, 7]), ("b/c.jpg", &[-1]), ("d.jpg", &[])]);
        std::fs::write(&file, &whole).unwrap();
        let expected = [("a.jpg".to_owned(), 2), ("b/c.jpg".to_owned(), 0), ("d.jpg".to_owned(), 0)];
        assert_eq!(points_seen(folder.path()).unwrap(), expected);
        for length in [3, 20, POSE_BYTES + 10, whole.len() - 1] {
            std::fs::write(&file, &whole[..length]).unwrap();
            assert!(points_seen(folder.path()).unwrap_err().to_string().contains("truncated"), "{length}");
        }
    }

    #[test]
    fn the_largest_model_is_first() {
        let folder = tempfile::tempdir().unwrap();
        for (name, images) in [("0", 3u64), ("1", 60), ("2", 3)] {
            std::fs::create_dir(folder.path().join(name)).unwrap();
            std::fs::write(folder.path().join(name).join("images.bin"), images.to_le_bytes()).unwrap();
        }
        std::fs::create_dir(folder.path().join("3")).unwrap();
        let found = models(folder.path()).unwrap();
        let names: Vec<_> = found.iter().map(|model| model.folder.file_name().unwrap().to_owned()).collect();
        assert_eq!(names, ["1", "0", "2"]);
        std::fs::write(folder.path().join("3/images.bin"), [1, 2]).unwrap();
        assert!(models(folder.path()).unwrap_err().to_string().contains("truncated"));
        assert!(models(&folder.path().join("none")).is_err());
    }
}
