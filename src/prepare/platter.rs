//! Cameras by what turns with the object: a turntable's platter, or what it stands on.
//!
//! In front of a camera that stands still, features of the object alone say where the cameras are. A smooth object has few of them.
//! With these cameras known, features around the object can be used too: a point that turns with the object agrees with the cameras,
//! and one of the background, which stands still, does not. Points are triangulated with the cameras held, then both are adjusted,
//! in several rounds.

use crate::codec::file::write_bytes;
use crate::codec::image::decode_picture;
use crate::codec::png_file::write_gray8;
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::prepare::colmap::Pairs;
use crate::prepare::model::{points_seen, view_directions};
use crate::prepare::reconstruct::{Reconstruction, Rounds, remove_database};
use crate::prepare::regions::Bits;
use crate::prepare::work::Work;
use image::GrayImage;
use rayon::prelude::*;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// How far around the object features are taken, as a part of its longer side in the photograph.
const MARGIN: f64 = 0.3;
/// Largest angle between the directions of two cameras whose photographs are matched, in degrees.
const MOST_ANGLE: f64 = 50.0;
impl Reconstruction<'_> {
    /// The cameras of `model` adjusted by what turns with the object; those of `model` if that adds no points, or COLMAP fails.
    ///
    /// # Errors
    /// Those of [`prepare`](crate::prepare::prepare).
    pub(super) fn adjust_by_platter(&self, work: &mut Work, model: &Path) -> Result<PathBuf> {
        match self.adjusted(work, model) {
            Err(error @ Error::Run { .. }) => {
                self.progress.note(&format!("cameras are found by the object alone: {error}"));
                Ok(model.to_owned())
            }
            adjusted => adjusted,
        }
    }

    fn adjusted(&self, work: &mut Work, model: &Path) -> Result<PathBuf> {
        let cameras = self.cameras();
        work.step("platter features", "", |work| {
            self.widen_masks(work)?;
            let (database, images) = (work.path("platter.db"), work.path("photographs"));
            remove_database(work, "platter.db")?;
            let masks = work.path("wide_masks");
            let words = self.colmap.features(&database, &images, Some(&masks), self.options.lens, cameras);
            self.colmap_step(work, "platter features", self.photographs.len() as u64, &words)
        })?;
        work.step("platter matching", "", |work| {
            let words = self.colmap.moving_matching(&work.path("platter.db"), &pairs(work, model)?)?;
            self.colmap_step(work, "platter matching", 100, &words)
        })?;
        let adjusted = work.path("platter");
        work.step("platter adjustment", "", |work| {
            let rounds = Rounds {
                name: "platter adjustment",
                database: "platter.db",
                output: "platter",
                finds_center: false,
            };
            self.adjust_in_rounds(work, &rounds, model)
        })?;
        let observed = |model: &Path| Ok(points_seen(model)?.iter().map(|(_, count)| count).sum::<u64>());
        let [alone, with_platter] = [observed(model)?, observed(&adjusted)?];
        if with_platter <= alone {
            self.progress
                .note("nothing around the object turns with it: its own features say where the cameras are");
            return Ok(model.to_owned());
        }
        let percent = 100.0 * (with_platter - alone) as f64 / (alone as f64).max(1.0);
        self.progress.note(&format!(
            "the cameras are adjusted by what turns with the object too: {percent:.0} % more observations of points"
        ));
        Ok(adjusted)
    }

    /// Writes masks of the object with what is around it.
    fn widen_masks(&self, work: &Work) -> Result<()> {
        let (masks, wide) = (work.path("masks"), work.emptied("wide_masks")?);
        self.photographs.par_iter().try_for_each(|photograph| {
            check_interrupted()?;
            let name = format!("{}.png", photograph.name);
            let to = wide.join(&name);
            let parent = to.parent().unwrap_or(&wide);
            std::fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
            write_gray8(&to, &widened(&decode_picture(masks.join(&name))?.into_luma8()))
        })
    }
}

/// A mask that reaches [`MARGIN`] farther on all sides.
fn widened(mask: &GrayImage) -> GrayImage {
    let (width, height) = mask.dimensions();
    let pixels = mask.iter().map(|value| *value > 127).collect();
    let object = Bits { width: width as usize, height: height as usize, pixels };
    let radius = (MARGIN * object.longer_side() as f64).round() as usize;
    let wide = object.dilated(radius);
    GrayImage::from_fn(width, height, |x, y| {
        image::Luma([if wide.pixels[y as usize * wide.width + x as usize] { 255 } else { 0 }])
    })
}

/// The pairs of photographs that look at the object from similar sides. COLMAP's list of pairs has no way to write a name with a space:
/// then these are all.
fn pairs(work: &Work, model: &Path) -> Result<Pairs> {
    let views = view_directions(model)?;
    if views.iter().any(|(name, _)| name.contains(char::is_whitespace)) {
        return Ok(Pairs::All);
    }
    let file = work.path("pairs.txt");
    write_bytes(&file, list(&views).as_bytes())?;
    Ok(Pairs::Listed(file))
}

/// A line for each pair of photographs whose directions differ by at most [`MOST_ANGLE`].
fn list(views: &[(String, [f64; 3])]) -> String {
    let mut lines = String::new();
    for (i, (name, direction)) in views.iter().enumerate() {
        for (other, toward) in &views[i + 1..] {
            let cosine: f64 = direction.iter().zip(toward).map(|(a, b)| a * b).sum();
            if cosine >= MOST_ANGLE.to_radians().cos() {
                // Writing into a string does not fail.
                let _ = writeln!(lines, "{name} {other}");
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;

    #[test]
    fn masks_are_widened_by_a_part_of_the_object() {
        let inside = |x: u32, y: u32| (40..60).contains(&x) && (30..40).contains(&y);
        let mask = GrayImage::from_fn(100, 70, |x, y| Luma([if inside(x, y) { 255 } else { 0 }]));
        let wide = widened(&mask);
        // 20 pixels wide: by 6.
        for (x, y, value) in
            [(34, 35, 255), (33, 35, 0), (65, 45, 255), (65, 46, 0), (50, 24, 255), (50, 23, 0)]
        {
            assert_eq!(wide.get_pixel(x, y).0[0], value, "{x} {y}");
        }
        let empty = GrayImage::new(20, 10);
        assert_eq!(widened(&empty), empty);
    }

    #[test]
    fn photographs_from_similar_sides_are_pairs() {
        let view = |name: &str, degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            (name.to_owned(), [sin, 0.0, cos])
        };
        let views = [view("a", 0.0), view("b", 40.0), view("c", 85.0), view("d", -45.0)];
        assert_eq!(list(&views), "a b\na d\nb c\n");
    }
}
