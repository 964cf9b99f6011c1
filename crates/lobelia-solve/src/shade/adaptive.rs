//! Frames of films: one ray at the middle of each pixel that may show the object, and the whole
//! grid of rays only at pixels that differ from a neighbor, which show edges, patterns or
//! highlights. Closed forms have no noise. What lies between the middles of pixels that are alike,
//! such as a wire thinner than a pixel where none of nine middles meets it, is not seen.

use crate::shade::frame::{FrameTarget, PixelSums, bands, render_rows, spawn_pool};
use bevy_ecs::prelude::World;
use glam::Vec3;
use lobelia_geometry::{error::Result, parallel, view::Camera};
use lobelia_world::{pipeline::Pipeline, sample::point::Scenery};
use std::ops::Range;

/// Difference of shown colors from which two pixels are told apart: 5 of 255.
pub const CONTRAST: f32 = 0.02;

/// Some rows of a picture without its layers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColorBand {
    /// Number of the first row.
    pub first_row: u32,
    /// Radiance on black, row by row.
    pub color: Vec<Vec3>,
    /// Coverage in [0, 1].
    pub alpha: Vec<f32>,
    /// At how many of these pixels all rays were cast.
    pub refined: usize,
}

/// Renders one picture in bands of `rows_per_band` rows (at least 1), from the top, with up to
/// about `samples_per_pixel` rays per pixel. Colors are told apart as they are shown: `encode`
/// makes values in [0, 1] of radiance. `take` gets each band; bands have the same bits whatever
/// their height. The pool of samples is left for the next frame: `despawn_pool` ends a film.
///
/// # Errors
/// The first error of a system or of `take`.
pub fn render_adaptive(
    pipeline: &mut Pipeline,
    camera: Camera,
    samples_per_pixel: u32,
    encode: &(dyn Fn(Vec3) -> Vec3 + Sync),
    rows_per_band: u32,
    take: &mut dyn FnMut(&World, ColorBand) -> Result<()>,
) -> Result<()> {
    let shows = object_window(&pipeline.world, &camera);
    let per_pixel = FrameTarget::band(camera, samples_per_pixel, 0..0).samples_per_pixel();
    let most = shows.iter().map(|side| side.len()).product::<usize>() * per_pixel;
    spawn_pool(&mut pipeline.world, most);
    bands(camera, rows_per_band).try_for_each(|rows| {
        let band = render_band(pipeline, camera, samples_per_pixel, encode, rows, &shows)?;
        take(&pipeline.world, band)
    })
}

/// The columns and rows that the object may be seen in: those of the box around it, or all if the
/// camera is too close to tell.
fn object_window(world: &World, camera: &Camera) -> [Range<u32>; 2] {
    let sides = [camera.width, camera.height];
    let bounds = world.get_resource::<Scenery>().and_then(|scenery| scenery.0.bounds());
    let corner = |(low, high): (Vec3, Vec3), k: u32| {
        Vec3::select(glam::BVec3::new(k & 1 > 0, k & 2 > 0, k & 4 > 0), high, low)
    };
    let seen: Option<Vec<[f32; 2]>> = bounds.and_then(|bounds| {
        (0..8).map(|k| camera.project(corner(bounds, k)).map(|(x, y, _)| [x, y])).collect()
    });
    let Some(seen) = seen else { return sides.map(|side| 0..side) };
    std::array::from_fn(|axis| {
        let of = |pick: fn(f32, f32) -> f32, from: f32| seen.iter().map(|at| at[axis]).fold(from, pick);
        let (low, high) = (of(f32::min, f32::INFINITY), of(f32::max, f32::NEG_INFINITY));
        // A pixel more on each side, for rounding.
        let pixel = |at: f32| at.clamp(0.0, sides[axis] as f32) as u32;
        pixel(low.floor() - 1.0)..pixel(high.ceil() + 1.0)
    })
}

/// Renders `rows`, and a row more on each side, with which the outer ones are compared.
fn render_band(
    pipeline: &mut Pipeline,
    camera: Camera,
    samples_per_pixel: u32,
    encode: &(dyn Fn(Vec3) -> Vec3 + Sync),
    rows: Range<u32>,
    [columns, seen_rows]: &[Range<u32>; 2],
) -> Result<ColorBand> {
    let width = camera.width as usize;
    let around = rows.start.saturating_sub(1)..(rows.end + 1).min(camera.height);
    let pixels = around.clone().filter(|row| seen_rows.contains(row));
    let pixels = pixels.flat_map(|row| columns.clone().map(move |column| row * camera.width + column));
    let mut coarse = FrameTarget::band(camera, 1, around);
    coarse.chosen = Some(pixels.collect());
    let mut target = render_rows(pipeline, coarse)?;
    let skipped = (rows.start - target.rows.start) as usize * width;
    let inner = skipped..skipped + rows.len() * width;
    let side = FrameTarget::band(camera, samples_per_pixel, 0..0).side;
    let differing =
        if side == 1 { Vec::new() } else { differing_pixels(&target.pixels, width, inner.clone(), encode) };
    let refined = differing.len();
    target.side = side;
    let count = target.samples_per_pixel() as f32;
    let mut is_refined = vec![false; target.pixels.len()];
    for &i in &differing {
        (target.pixels[i], is_refined[i]) = (PixelSums::default(), true);
    }
    let first = target.first_pixel();
    target.chosen = Some(differing.into_iter().map(|i| (first + i) as u32).collect());
    let target = render_rows(pipeline, target)?;
    let share = |i: usize| if is_refined[i] { 1.0 / count } else { 1.0 };
    let color = |i: usize| share(i) * (target.pixels[i].diffuse + target.pixels[i].specular);
    let alpha = |i: usize| share(i) * target.pixels[i].hits as f32;
    Ok(ColorBand {
        first_row: rows.start,
        color: parallel::map(inner.len(), 1024, |k| color(inner.start + k)),
        alpha: parallel::map(inner.len(), 1024, |k| alpha(inner.start + k)),
        refined,
    })
}

/// The pixels among `inner` that differ from one of their four neighbors, and those around an
/// outline.
fn differing_pixels(
    pixels: &[PixelSums],
    width: usize,
    inner: Range<usize>,
    encode: &(dyn Fn(Vec3) -> Vec3 + Sync),
) -> Vec<usize> {
    // Pixels of which one alone shows the object differ anyway.
    let shown = |sums: &PixelSums| {
        if sums.hits > 0 { encode(sums.diffuse + sums.specular) } else { Vec3::ZERO }
    };
    let colors: Vec<Vec3> = parallel::map_slice(pixels, 1024, shown);
    let height = pixels.len() / width;
    let differs = |i: usize| {
        let (x, y) = (i % width, i / width);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        rows.flat_map(|row| columns.clone().map(move |column| [column, row])).any(|[column, row]| {
            let j = row * width + column;
            let is_beside = column == x || row == y;
            pixels[i].hits != pixels[j].hits
                || (is_beside && (colors[i] - colors[j]).abs().max_element() > CONTRAST)
        })
    };
    parallel::flat_map(inner.len(), 1024, |k| Some(inner.start + k).filter(|&i| differs(i)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shade::frame::{FramePlugin, render_frame, resolve};
    use lobelia_geometry::{mesh::Surface, mesh::primitive::sphere_mesh};
    use lobelia_world::{
        light::LightLobe, light::lights::IncidentLight, material::SpecularLobe, sample::spawn_object,
    };
    use std::sync::Arc;

    /// A sphere of two colors under two lobes.
    fn studio() -> Pipeline {
        let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, 0.8).unwrap(), 64).unwrap());
        let color = |at: &Vec3| if at.x > 0.1 { Vec3::new(0.7, 0.2, 0.1) } else { Vec3::splat(0.3) };
        let albedo: Vec<Vec3> = surface.atlas().position.iter().map(color).collect();
        let lobe =
            |axis, sharpness, amplitude| LightLobe { axis, sharpness, amplitude: Vec3::splat(amplitude) };
        let mut pipeline = Pipeline::new();
        pipeline.add_plugin(&FramePlugin);
        let material = SpecularLobe::new(Vec3::splat(0.2), 0.2);
        let lobes = [lobe(Vec3::Y, 0.5, 0.5), lobe(Vec3::Z, 30.0, 2.0)];
        spawn_object(&mut pipeline.world, &surface, &albedo, &[material], &lobes);
        pipeline
    }

    fn camera(eye: Vec3) -> Camera {
        Camera::look_at(eye, Vec3::ZERO, Vec3::Y, 40.0, 120, 90).unwrap()
    }

    /// All rows, and how many pixels were refined.
    fn adaptive(camera: Camera, rays: u32, rows_per_band: u32) -> ColorBand {
        let mut all = ColorBand::default();
        let encode = |color: Vec3| color.clamp(Vec3::ZERO, Vec3::ONE).map(f32::sqrt);
        render_adaptive(&mut studio(), camera, rays, &encode, rows_per_band, &mut |_, band| {
            assert_eq!(band.first_row as usize * 120, all.color.len());
            all.color.extend(&band.color);
            all.alpha.extend(&band.alpha);
            all.refined += band.refined;
            Ok(())
        })
        .unwrap();
        all
    }

    #[test]
    fn few_pixels_need_all_rays_and_the_picture_is_that_of_all() {
        let camera = camera(Vec3::new(0.3, 0.4, 2.6));
        let whole = resolve(&render_frame(&mut studio(), camera, 16).unwrap());
        let found = adaptive(camera, 16, 90);
        let covered = whole.alpha.iter().filter(|alpha| **alpha > 0.0).count();
        assert!(found.refined * 3 < covered, "{} of {covered}", found.refined);
        let shown = |color: &Vec3| color.clamp(Vec3::ZERO, Vec3::ONE).map(f32::sqrt);
        let off = |i: usize| (shown(&found.color[i]) - shown(&whole.color[i])).abs().max_element();
        let worst = (0..whole.color.len()).map(off).fold(0.0, f32::max);
        assert!(worst < CONTRAST, "{worst}");
        // Outlines are those of all rays.
        assert_eq!(found.alpha, whole.alpha);
        let (whole, found) =
            (resolve(&render_frame(&mut studio(), camera, 1).unwrap()), adaptive(camera, 1, 90));
        assert_eq!((found.refined, found.color, found.alpha), (0, whole.color, whole.alpha), "of one ray");
    }

    /// The number of rays is that of a square grid, which may be more than was asked for.
    #[test]
    fn an_object_of_few_pixels_has_all_its_rays() {
        // All of it within the pixel to the lower left of the middle.
        let at = Vec3::new(0.65, 0.65, 0.0);
        let far = Camera::look_at(at + 160.0 * Vec3::Z, at, Vec3::Y, 40.0, 120, 90).unwrap();
        for rays in [3, 7, 13] {
            let ColorBand { refined, alpha, .. } = adaptive(far, rays, 90);
            assert!(refined >= 9 && alpha.iter().any(|alpha| *alpha > 0.0), "{rays}: {refined}");
        }
    }

    #[test]
    fn the_light_is_there_before_a_band_without_the_object() {
        let far = camera(Vec3::new(0.0, 0.0, 9.0));
        let mut pipeline = studio();
        let mut lights = Vec::new();
        render_adaptive(&mut pipeline, far, 4, &|color| color, 8, &mut |world, _| {
            lights.push(world.resource::<IncidentLight>().lobes.len());
            Ok(())
        })
        .unwrap();
        assert_eq!(lights, [2; 12]);
    }

    #[test]
    fn bands_of_any_height_have_the_same_bits() {
        let camera = camera(Vec3::new(0.0, 0.2, 2.6));
        let whole = adaptive(camera, 16, 90);
        for rows in [1, 7, 64] {
            assert_eq!(adaptive(camera, 16, rows), whole, "{rows}");
        }
    }

    #[test]
    fn an_object_around_the_camera_is_seen_everywhere() {
        let inside = object_window(&studio().world, &camera(Vec3::new(0.0, 0.0, 0.1)));
        assert_eq!(inside, [0..120, 0..90]);
        let [columns, rows] = object_window(&studio().world, &camera(Vec3::new(0.0, 0.0, 4.0)));
        assert!(columns.start > 20 && columns.end < 100, "{columns:?}");
        assert!(rows.start > 5 && rows.end < 85, "{rows:?}");
        // Beside the picture: nothing is left to look at.
        let away = Camera::look_at(4.0 * Vec3::Z, 9.0 * Vec3::X, Vec3::Y, 40.0, 120, 90).unwrap();
        assert!(object_window(&studio().world, &away)[0].is_empty());
    }
}
