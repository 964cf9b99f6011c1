//! How each view came out, and what went wrong: `views.csv`, and the warnings of `metrics.json`.

use crate::report::scores::{EvalView, ViewOutcome};
use crate::{object::Object, survey::named};
use bevy_ecs::prelude::{Entity, With};
use lobelia_geometry::parallel;
use lobelia_geometry::view::{Camera, Photograph, Split, StoredMask, ViewIndex, ViewMask, ViewName};
use lobelia_geometry::{error::Result, mesh::Surface};
use lobelia_io::codec::file::write_bytes;
use lobelia_sg::statistics::median;
use lobelia_solve::fit::{guard::StepGuard, loss::ViewSum, loss::ViewSums, loss::is_outlier};
use lobelia_world::light::{LightLobe, groups::all_lights};
use std::fmt::Write as _;
use std::{collections::HashMap, collections::HashSet, path::Path};

/// The report, in the folder of an `Evaluate`.
pub const VIEWS: &str = "views.csv";

/// Most pixels along a side of the silhouettes that are compared.
const SIDE: u32 = 96;
/// Overlap of mask and surface below which they disagree.
const DISAGREES: f64 = 0.6;
/// Share of outliers from which on a view is named, and that of the median view that it must be
/// above.
const OUTLIERS: f64 = 0.5;
/// Radiance of a lobe beyond this, relative to the photographs, is no light that they show.
const RUNAWAY: f32 = 1e4;

/// Notes how the training views came out of a fit, and what went wrong in it.
pub(super) fn note_fit(object: &mut Object) {
    let views = silhouettes(object, |_, split| split == Split::Train);
    let world = &mut object.pipeline.world;
    let sums = world.get_resource::<ViewSums>().cloned().unwrap_or_default();
    let lobes = all_lights(world).concat();
    let with_sums = |(_, index, view): (Entity, ViewIndex, ViewOutcome)| {
        let sum = sums.of(index);
        let (psnr, outliers) = (sum.psnr(), sum.outlier_share());
        (ViewOutcome { pixels: Some(sum.pool), psnr, outliers, ..view }, sum)
    };
    let found: Vec<(ViewOutcome, ViewSum)> = views.into_iter().map(with_sums).collect();
    let warnings = warnings(&found, &lobes);
    if let Some(first) = world.get_resource::<StepGuard>().and_then(|guard| guard.first.clone()) {
        warn(object, format!("steps of a fit were taken back; first {first}"));
    }
    object.scores().views = found.into_iter().map(|(view, _)| view).collect();
    for warning in warnings {
        warn(object, warning);
    }
}

/// Tells a warning, once, and keeps it for `metrics.json`.
pub(super) fn warn(object: &mut Object, warning: String) {
    if !object.scores().warnings.contains(&warning) {
        object.progress().note(&warning);
        object.scores().warnings.push(warning);
    }
}

/// The views with photographs that are wanted, in the order of their numbers, with their masks
/// beside the surface.
fn silhouettes(
    object: &mut Object,
    wanted: impl Fn(Entity, Split) -> bool,
) -> Vec<(Entity, ViewIndex, ViewOutcome)> {
    let world = &mut object.pipeline.world;
    let mut query = world.query_filtered::<(Entity, &ViewIndex, &Split), With<Photograph>>();
    let mut views: Vec<_> = query.iter(world).map(|(view, index, split)| (view, *index, *split)).collect();
    views.retain(|(view, _, split)| wanted(*view, *split));
    views.sort_by_key(|(_, index, _)| *index);
    let (world, surface) = (&object.pipeline.world, object.surface());
    let outcome = |(view, index, split): (Entity, ViewIndex, Split)| {
        let camera = world.get::<Camera>(view);
        let overlap = camera.zip(world.get::<ViewMask>(view));
        let overlap = overlap.and_then(|(camera, mask)| overlap_of(&surface, camera, &mask.0));
        let outcome = ViewOutcome {
            name: world.get::<ViewName>(view).map(|name| name.0.clone()).unwrap_or_default(),
            split: if split == Split::Train { "train" } else { "test" }.into(),
            hit: overlap.map(|[hit, _]| hit),
            mask_iou: overlap.map(|[_, iou]| iou),
            ..ViewOutcome::default()
        };
        (view, index, outcome)
    };
    parallel::map_items(views, outcome)
}

/// The surface beside a mask, at few pixels: of the mask's pixels the share that the surface
/// covers, and their intersection over union; `None` if both are empty.
fn overlap_of(surface: &Surface, camera: &Camera, mask: &StoredMask) -> Option<[f64; 2]> {
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
    let share = |of: u32| f64::from(both) / f64::from(of.max(1));
    (either > 0).then(|| [share(inside), share(either)])
}

/// Returns the problems of a fit, in sentences.
fn warnings(views: &[(ViewOutcome, ViewSum)], lobes: &[LightLobe]) -> Vec<String> {
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
    let strays = names(&|view, _| view.mask_iou.is_some_and(|iou| iou < DISAGREES));
    let all = 2 * strays.len() > views.len();
    let of_all = if all { ": check that mesh, cameras and masks belong together" } else { "" };
    add(&strays, &|views| format!("mask and surface overlap to less than {DISAGREES} in {views}{of_all}"));
    let mut shares: Vec<f32> = views.iter().filter_map(|(view, _)| Some(view.outliers? as f32)).collect();
    let usual = f64::from(median(&mut shares).unwrap_or(0.0));
    let wrong = names(&|view, _| view.outliers.is_some_and(|share| share > OUTLIERS && share > 2.0 * usual));
    add(&wrong, &|of| format!("most pixels of {of} are not explained: a wrong pose, mask or exposure?"));
    found.extend(runaway(lobes, views));
    found
}

/// A light that is brighter than anything that photographs of this brightness can show.
fn runaway(lobes: &[LightLobe], views: &[(ViewOutcome, ViewSum)]) -> Option<String> {
    let (sum, pixels) = views.iter().fold((0.0, 0), |(sum, n), (_, of)| (sum + of.observed, n + of.pixels));
    let usual = (sum / pixels.max(1) as f64).max(1e-6) as f32;
    // A lobe's light is its amplitude over its solid angle, about 2π over its sharpness.
    let light = |lobe: &LightLobe| {
        lobe.amplitude.max_element() * (1.0 - (-2.0 * lobe.sharpness).exp()) / lobe.sharpness.max(1e-3)
    };
    let (number, brightest) =
        lobes.iter().map(light).enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|_| pixels > 0)?;
    (brightest > RUNAWAY * usual).then(|| {
        let times = brightest / usual;
        format!("light lobe {number} ran away: it gives {times:.0} times the light of the photographs")
    })
}

/// Share of outliers among the pixels of a view that count.
pub(crate) fn outlier_share(view: &EvalView, predicted: &[glam::Vec3]) -> Option<f64> {
    let counted = view.mask.iter().filter(|counts| **counts).count();
    let pairs = predicted.iter().zip(&view.truth).zip(&view.mask).filter(|(_, counts)| **counts);
    let outliers = pairs.filter(|((predicted, truth), _)| is_outlier(**predicted, **truth)).count();
    (counted > 0).then(|| outliers as f64 / counted as f64)
}

/// What views come to in the first score: PSNR in dB as it is scored, and the share of outliers.
type Outcomes = HashMap<Entity, (f64, Option<f64>)>;

/// Adds scored views that no fit has told of, in place of those that an earlier `Evaluate` has told
/// of, and writes the report of all views.
pub(crate) fn write(object: &mut Object, folder: &Path, scored: &Outcomes) -> Result<()> {
    let found = silhouettes(object, |view, _| scored.contains_key(&view));
    let views = &mut object.scores().views;
    // Those of a fit say how many pixels it may visit.
    views.retain(|view| view.pixels.is_some());
    let key = |view: &ViewOutcome| (view.name.clone(), view.split.clone());
    let mut known: HashSet<(String, String)> = views.iter().map(key).collect();
    for (view, _, outcome) in found {
        let (psnr, outliers) = scored[&view];
        let outcome = ViewOutcome { psnr: Some(psnr), outliers, ..outcome };
        if known.insert(key(&outcome)) {
            views.push(outcome);
        }
    }
    write_bytes(&folder.join(VIEWS), csv(views).as_bytes())
}

fn csv(views: &[ViewOutcome]) -> String {
    let mut text = String::from("view,split,pixels,hit,mask_iou,psnr,outliers\n");
    let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.4}"));
    for view in views {
        let pixels = view.pixels.map_or(String::new(), |pixels| pixels.to_string());
        let numbers = [view.hit, view.mask_iou, view.psnr, view.outliers].map(number).join(",");
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{},{},{pixels},{numbers}", csv_entry(&view.name), view.split);
    }
    text
}

/// A text as an entry of a CSV file, in quotation marks where it needs them.
pub(crate) fn csv_entry(text: &str) -> String {
    match text.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.to_owned(),
    }
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

    #[test]
    fn what_went_wrong_is_named_with_its_views() {
        let good = || ["a", "b", "c"].iter().map(|name| view(name, 0.95, 0.02)).collect::<Vec<_>>();
        let lobes = |amplitude| [lobe(0.1), lobe(amplitude)];
        assert!(warnings(&good(), &lobes(3.0)).is_empty() && warnings(&[], &[]).is_empty());
        let with = |bad| warnings(&[good(), vec![bad]].concat(), &lobes(3.0)).join("\n");
        let (outcome, sum) = view("d", 0.95, 0.02);
        assert!(with((outcome, ViewSum { pool: 0, ..sum })).contains("no pixel of view `d` was used"));
        let stray = with(view("d", 0.3, 0.02));
        assert!(stray.contains("less than 0.6 in view `d`") && !stray.contains("together"), "{stray}");
        assert!(with(view("d", 0.95, 0.8)).contains("most pixels of view `d`"));
        assert!(warnings(&good(), &lobes(1e6)).join("\n").contains("light lobe 1 ran away"));
        let all = [view("a", 0.4, 0.02), view("b", 0.4, 0.02)];
        assert!(warnings(&all, &lobes(3.0)).join("\n").contains("belong together"));
    }

    #[test]
    fn the_report_is_a_table() {
        let (outcome, _) = view("a,\"b", 0.5, 0.25);
        let text = csv(&[outcome]);
        assert_eq!(text.lines().nth(1), Some("\"a,\"\"b\",train,9,,0.5000,,0.2500"));
    }
}
