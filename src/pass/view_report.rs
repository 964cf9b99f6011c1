//! How each view came out, and what went wrong: `views.csv`, and the warnings of `metrics.json`.

use crate::codec::file::write_bytes;
use crate::error::Result;
use crate::fit::by_view::{ViewSum, ViewSums, is_outlier};
use crate::fit::guard::StepGuard;
use crate::light::LightLobe;
use crate::light::groups::other_lights;
use crate::light::lights::own_lobes;
use crate::math::statistics::median;
use crate::mesh::Surface;
use crate::pass::session::Session;
use crate::report::scores::{EvalView, ViewOutcome};
use crate::survey::finding::named;
use crate::view::{Camera, Photograph, Split, StoredMask, ViewIndex, ViewMask, ViewName};
use bevy_ecs::prelude::{Entity, With, World};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use std::fmt::Write as _;
use std::path::Path;

/// The report, in the folder of an `Evaluate`.
pub const VIEWS: &str = "views.csv";

/// Most pixels along a side of the silhouettes that are compared.
const SIDE: u32 = 96;
/// Mean luminance of the object below which a photograph is black.
const BLACK: f64 = 1e-3;
/// Overlap of mask and surface below which they disagree.
const DISAGREES: f64 = 0.6;
/// A mesh this many times too large or too small is off by a factor.
const FACTOR: f32 = 1.15;
/// Share of outliers from which on a view is named, and that of the median view that it must be above.
const OUTLIERS: f64 = 0.5;
/// Radiance of a lobe beyond this, relative to the photographs, is no light that they show.
const RUNAWAY: f32 = 1e4;

/// How a view of the first score came out.
pub(super) struct ScoredOutcome {
    /// The view: names repeat, as those of training and test views.
    pub view: Entity,
    /// PSNR as it is scored, in dB.
    pub psnr: f64,
    /// Share of outliers of the prediction as it is scored.
    pub outliers: Option<f64>,
}

/// A view of the world, as far as its silhouette needs it.
struct Outline {
    entity: Entity,
    name: String,
    split: Split,
    index: ViewIndex,
    camera: Camera,
    mask: Option<StoredMask>,
}

/// A mask beside the surface.
#[derive(Clone, Copy)]
struct Overlap {
    /// Of the mask's pixels, the share that the surface covers.
    hit: f64,
    iou: f64,
    /// Square root of the surface's area over the mask's.
    factor: f32,
}

/// Notes how the training views came out of a fit, and what went wrong in it.
pub(super) fn note_fit(session: &mut Session) {
    let outlines = outlines(&mut session.pipeline.world, Some(Split::Train));
    let sums = session.pipeline.world.get_resource::<ViewSums>().cloned().unwrap_or_default();
    let overlaps = overlaps(&session.surface, &outlines);
    let mut lobes = own_lobes(&mut session.pipeline.world);
    lobes.extend(other_lights(&mut session.pipeline.world).into_iter().flat_map(|(lobes, _)| lobes));
    let found: Vec<(ViewOutcome, ViewSum)> = outlines
        .iter()
        .zip(&overlaps)
        .map(|(view, overlap)| (outcome(view, *overlap, Some(sums.of(view.index))), sums.of(view.index)))
        .collect();
    let factors = overlaps.iter().flatten().map(|overlap| overlap.factor).collect();
    let warnings = warnings(&found, factors, &lobes);
    let guard = session.pipeline.world.get_resource::<StepGuard>();
    if let Some(first) = guard.and_then(|guard| guard.first.clone()) {
        warn(session, format!("steps of a fit were taken back; first {first}"));
    }
    session.scores.views = found.into_iter().map(|(view, _)| view).collect();
    for warning in warnings {
        warn(session, warning);
    }
}

/// Tells a warning, once, and keeps it for `metrics.json`.
pub(super) fn warn(session: &mut Session, warning: String) {
    if !session.scores.warnings.contains(&warning) {
        session.progress.note(&warning);
        session.scores.warnings.push(warning);
    }
}

fn outcome(view: &Outline, overlap: Option<Overlap>, sum: Option<ViewSum>) -> ViewOutcome {
    ViewOutcome {
        name: view.name.clone(),
        split: if view.split == Split::Train { "train" } else { "test" }.into(),
        pixels: sum.map(|sum| sum.pool),
        hit: overlap.map(|overlap| overlap.hit),
        mask_iou: overlap.map(|overlap| overlap.iou),
        psnr: sum.and_then(|sum| sum.psnr()),
        outliers: sum.and_then(|sum| sum.outlier_share()),
    }
}

type OutlineView = (
    Entity,
    &'static ViewName,
    &'static Split,
    &'static ViewIndex,
    &'static Camera,
    Option<&'static ViewMask>,
);

/// Views with photographs, in the order of their numbers.
fn outlines(world: &mut World, split: Option<Split>) -> Vec<Outline> {
    let mut query = world.query_filtered::<OutlineView, With<Photograph>>();
    let wanted = query.iter(world).filter(|view| split.is_none_or(|split| *view.2 == split));
    let mut outlines: Vec<Outline> = wanted
        .map(|(entity, name, split, index, camera, mask)| Outline {
            entity,
            name: name.0.clone(),
            split: *split,
            index: *index,
            camera: *camera,
            mask: mask.map(|mask| mask.0.clone()),
        })
        .collect();
    outlines.sort_by_key(|view| view.index);
    outlines
}

fn overlaps(surface: &Surface, views: &[Outline]) -> Vec<Option<Overlap>> {
    views.par_iter().map(|view| overlap(surface, &view.camera, view.mask.as_ref()?)).collect()
}

/// The surface beside a mask, at few pixels; `None` if both are empty.
fn overlap(surface: &Surface, camera: &Camera, mask: &StoredMask) -> Option<Overlap> {
    let factor = camera.width.max(camera.height).div_ceil(SIDE).max(1);
    let (camera, mask) = (camera.scaled(factor), mask.mask().downscaled(factor));
    let (mut inside, mut covered, mut both) = (0u32, 0u32, 0u32);
    for (pixel, coverage) in (0..camera.width * camera.height).zip(&mask.coverage) {
        let is_inside = *coverage >= 0.5;
        let is_covered = surface.nearest(&camera.pixel_ray(pixel), 0.0).is_some();
        inside += u32::from(is_inside);
        covered += u32::from(is_covered);
        both += u32::from(is_inside && is_covered);
    }
    let either = inside + covered - both;
    let share = |part: u32, of: u32| f64::from(part) / f64::from(of.max(1));
    (either > 0).then(|| Overlap {
        hit: share(both, inside),
        iou: share(both, either),
        factor: share(covered, inside).sqrt() as f32,
    })
}

/// What went wrong in a fit, in sentences.
fn warnings(views: &[(ViewOutcome, ViewSum)], factors: Vec<f32>, lobes: &[LightLobe]) -> Vec<String> {
    let names = |is_bad: &dyn Fn(&ViewOutcome, &ViewSum) -> bool| -> Vec<String> {
        views.iter().filter(|(view, sum)| is_bad(view, sum)).map(|(view, _)| view.name.clone()).collect()
    };
    let mut found = Vec::new();
    let mut add = |views: &[String], words: &dyn Fn(String) -> String| {
        if !views.is_empty() {
            found.push(words(named(views)));
        }
    };
    let unused = names(&|_, sum| sum.pool == 0);
    add(&unused, &|views| format!("no pixel of {views} was used: none shows the surface inside its mask"));
    let black = names(&|_, sum| sum.pixels > 0 && sum.observed / (sum.pixels as f64) < BLACK);
    add(&black, &|views| format!("the object is black in the photograph of {views}"));
    let off = off_by(factors);
    let strays = names(&|view, _| view.mask_iou.is_some_and(|iou| iou < DISAGREES));
    let all = 2 * strays.len() > views.len();
    let of_all = off.as_deref().unwrap_or("check that mesh, cameras and masks belong together");
    add(&strays, &|views| {
        let words = format!("mask and surface overlap to less than {DISAGREES} in {views}");
        if all { format!("{words}: {of_all}") } else { words }
    });
    let mut shares: Vec<f32> = views.iter().filter_map(|(view, _)| Some(view.outliers? as f32)).collect();
    let usual = f64::from(median(&mut shares).unwrap_or(0.0));
    let wrong = names(&|view, _| view.outliers.is_some_and(|share| share > OUTLIERS && share > 2.0 * usual));
    add(&wrong, &|views| {
        format!("most pixels of {views} are not explained: a wrong pose, mask or exposure?")
    });
    found.extend(runaway(lobes, views));
    found
}

/// By which factor the surface is too large or too small, if all views say the same.
fn off_by(mut factors: Vec<f32>) -> Option<String> {
    factors.retain(|factor| factor.is_finite() && *factor > 0.0);
    let middle = median(&mut factors)?;
    if middle > FACTOR {
        Some(format!("the surface looks {middle:.2} times too large"))
    } else if middle < 1.0 / FACTOR {
        Some(format!("the surface looks {:.2} times too small", 1.0 / middle))
    } else {
        None
    }
}

/// A light that is brighter than anything that photographs of this brightness can show.
fn runaway(lobes: &[LightLobe], views: &[(ViewOutcome, ViewSum)]) -> Option<String> {
    let (sum, pixels) =
        views.iter().fold((0.0, 0), |(sum, pixels), (_, view)| (sum + view.observed, pixels + view.pixels));
    let usual = (sum / pixels.max(1) as f64).max(1e-6) as f32;
    // A lobe's light is its amplitude over its solid angle, about 2π over its sharpness.
    let light = |lobe: &LightLobe| {
        lobe.amplitude.max_element() * (1.0 - (-2.0 * lobe.sharpness).exp()) / lobe.sharpness.max(1e-3)
    };
    let (number, brightest) =
        lobes.iter().map(light).enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|_| pixels > 0)?;
    (brightest > RUNAWAY * usual).then(|| {
        format!(
            "light lobe {number} ran away: it gives {:.0} times the light of the photographs",
            brightest / usual
        )
    })
}

/// Share of outliers among the pixels of a view that count.
pub(super) fn outlier_share(view: &EvalView, predicted: &[glam::Vec3]) -> Option<f64> {
    let counted = view.mask.iter().filter(|counts| **counts).count();
    let pairs = predicted.iter().zip(&view.truth).zip(&view.mask).filter(|(_, counts)| **counts);
    let outliers = pairs.filter(|((predicted, truth), _)| is_outlier(**predicted, **truth)).count();
    (counted > 0).then(|| outliers as f64 / counted as f64)
}

/// Adds scored views that no fit has told of, in place of those that an earlier `Evaluate` has told of, and writes the report of all views.
///
/// # Errors
/// If it cannot be written.
pub(super) fn write(session: &mut Session, folder: &Path, scored: &[ScoredOutcome]) -> Result<()> {
    let mut outlines = outlines(&mut session.pipeline.world, None);
    let scored: HashMap<Entity, &ScoredOutcome> =
        scored.iter().rev().map(|scored| (scored.view, scored)).collect();
    outlines.retain(|view| scored.contains_key(&view.entity));
    // Those of a fit say how many pixels it may visit.
    session.scores.views.retain(|view| view.pixels.is_some());
    let key = |view: &ViewOutcome| (view.name.clone(), view.split.clone());
    let mut known: HashSet<(String, String)> = session.scores.views.iter().map(key).collect();
    outlines.retain(|view| known.insert(key(&outcome(view, None, None))));
    for (view, overlap) in outlines.iter().zip(overlaps(&session.surface, &outlines)) {
        let found = scored[&view.entity];
        let new = outcome(view, overlap, None);
        session.scores.views.push(ViewOutcome { psnr: Some(found.psnr), outliers: found.outliers, ..new });
    }
    write_bytes(&folder.join(VIEWS), csv(&session.scores.views).as_bytes())
}

/// The report as text.
fn csv(views: &[ViewOutcome]) -> String {
    let mut text = String::from("view,split,pixels,hit,mask_iou,psnr,outliers\n");
    let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.4}"));
    for view in views {
        let name = if view.name.contains([',', '"', '\n']) {
            format!("\"{}\"", view.name.replace('"', "\"\""))
        } else {
            view.name.clone()
        };
        let pixels = view.pixels.map_or(String::new(), |pixels| pixels.to_string());
        let numbers = [view.hit, view.mask_iou, view.psnr, view.outliers].map(number).join(",");
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{name},{},{pixels},{numbers}", view.split);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn view(name: &str, iou: f64, outliers: f64) -> (ViewOutcome, ViewSum) {
        let sum = ViewSum { pool: 9, pixels: 9, observed: 4.5, ..ViewSum::default() };
        let view = ViewOutcome {
            name: name.into(),
            split: "train".into(),
            pixels: Some(9),
            mask_iou: Some(iou),
            outliers: Some(outliers),
            ..ViewOutcome::default()
        };
        (view, sum)
    }

    fn lobe(amplitude: f32) -> LightLobe {
        LightLobe { axis: Vec3::Y, sharpness: 2.0, amplitude: Vec3::splat(amplitude) }
    }

    fn said(views: &[(ViewOutcome, ViewSum)], factor: f32, amplitude: f32) -> Vec<String> {
        warnings(views, vec![factor; views.len()], &[lobe(0.1), lobe(amplitude)])
    }

    #[test]
    fn sound_views_give_no_warning() {
        let views: Vec<_> = ["a", "b", "c"].iter().map(|name| view(name, 0.95, 0.02)).collect();
        assert!(said(&views, 1.0, 3.0).is_empty());
        assert!(warnings(&[], Vec::new(), &[]).is_empty());
    }

    #[test]
    fn what_went_wrong_is_named_with_its_views() {
        let good = || ["a", "b", "c"].iter().map(|name| view(name, 0.95, 0.02)).collect::<Vec<_>>();
        let with = |bad: (ViewOutcome, ViewSum)| said(&[good(), vec![bad]].concat(), 1.0, 3.0).join("\n");
        let (outcome, sum) = view("d", 0.95, 0.02);
        assert!(
            with((outcome.clone(), ViewSum { pool: 0, ..sum })).contains("no pixel of view `d` was used")
        );
        assert!(
            with((outcome, ViewSum { observed: 1e-4, ..sum }))
                .contains("black in the photograph of view `d`")
        );
        let stray = with(view("d", 0.3, 0.02));
        assert!(stray.contains("less than 0.6 in view `d`") && !stray.contains("times"), "{stray}");
        assert!(with(view("d", 0.95, 0.8)).contains("most pixels of view `d`"));
        assert!(said(&good(), 1.0, 1e6).join("\n").contains("light lobe 1 ran away"));
    }

    #[test]
    fn a_surface_that_all_masks_deny_is_off_by_a_factor() {
        let views: Vec<_> = ["a", "b", "c"].iter().map(|name| view(name, 0.4, 0.02)).collect();
        assert!(said(&views, 1.5, 3.0).join("\n").contains("1.50 times too large"));
        assert!(said(&views, 0.5, 3.0).join("\n").contains("2.00 times too small"));
        assert!(said(&views, 1.0, 3.0).join("\n").contains("belong together"));
    }

    #[test]
    fn the_report_is_a_table() {
        let (outcome, _) = view("a,\"b", 0.5, 0.25);
        let text = csv(&[outcome]);
        assert_eq!(text.lines().nth(1), Some("\"a,\"\"b\",train,9,,0.5000,,0.2500"));
    }
}
