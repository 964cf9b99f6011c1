//! Findings about photographs: black, negative or absurdly bright ones, other exposures, blur, and the same picture twice.

use crate::math::statistics::median;
use crate::survey::finding::{Finding, Severity, named};
use crate::survey::look::{MaskOrigin, RadianceStatistics, ViewLook};
use crate::survey::statistics::{neighbors, strays};
use crate::view::Placement;
use crate::view::glare::{GLARING, glare_limit};
use glam::Vec3;
use std::collections::BTreeMap;

/// A photograph whose brightest hundredth is this many times darker than the median of all is black.
const BLACK: f32 = 1e-3;
/// One that is this many times brighter than the median of all is absurd.
const ABSURD: f32 = 512.0;
/// Share of negative pixels that is worth a word. A photograph that is mostly negative is not read.
const SOME_NEGATIVE: f32 = 0.01;
/// Share of clipped pixels that is worth a word.
const MANY_CLIPPED: f32 = 0.05;
/// Views that a view is compared with, and the least number of views for that.
const NEIGHBORS: usize = 6;
const LEAST_VIEWS: usize = 8;
/// A view this many stops apart from its neighbors is an outlier, if they are within `NEAR_DEGREES`; otherwise `FAR_STOPS`.
const STOPS: f32 = 1.5;
const FAR_STOPS: f32 = 2.5;
const NEAR_DEGREES: f32 = 35.0;
/// How far it must be beyond the usual difference, in standard deviations.
const SIGMAS: f32 = 5.0;
/// A view with this share of its neighbors' sharpness looks blurred.
const BLURRED: f32 = 0.3;
/// The same of the direction with the least detail, of which a pattern has more in one view than in another: of 24 sharp views of a checkered
/// object the least has 0.24, of one that moved by nine pixels 0.02.
const MOVED: f32 = 0.12;
/// So does one with this share however much the others differ, if those that have more have at least this many times as much, and at most
/// this part of the views has less. The least sharp views of four sound sets have 0.47 to 0.61.
const FAR_BLURRED: f32 = 0.2;
const APART: f32 = 2.0;
const FEW: f32 = 0.2;

/// A view compared with its neighbors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NeighborComparison {
    /// Exposure above that of the neighbors, in stops.
    pub stops: Option<f32>,
    /// Sharpness relative to that of the neighbors.
    pub sharpness: Option<f32>,
}

/// A fault that a photograph has by its radiance alone.
struct Fault<'a> {
    severity: Severity,
    name: &'static str,
    is_bad: &'a dyn Fn(&ViewLook, &RadianceStatistics) -> bool,
    /// What is wrong, given the views' names.
    problem: fn(&str) -> String,
    help: &'static str,
}

impl Fault<'_> {
    /// The finding about the views that have it, if there are any.
    fn find(&self, looks: &[ViewLook]) -> Option<Finding> {
        let bad = lights(looks).filter(|(look, light)| (self.is_bad)(look, light));
        let views: Vec<String> = bad.map(|(look, _)| look.name.clone()).collect();
        let problem = || (self.problem)(&named(&views));
        (!views.is_empty())
            .then(|| Finding::new(self.severity, self.name, views.clone(), problem(), self.help))
    }
}

/// Photographs that cannot be photographs of the object.
pub(crate) fn of_radiance(looks: &[ViewLook]) -> Vec<Finding> {
    // Those of a placement are in one light.
    let usual_in = by_placement(looks, |light| light.median);
    let usual = |look: &ViewLook| usual_in.get(&look.placement).copied().unwrap_or(0.0);
    let is_black = |look: &ViewLook, light: &RadianceStatistics| {
        light.highest <= 0.0 || (usual(look) > 0.0 && light.bright < BLACK * usual(look))
    };
    let is_bright = |look: &ViewLook, light: &RadianceStatistics| {
        usual(look) > 0.0 && light.median > ABSURD * usual(look) && light.median > 1.0
    };
    let black = Fault {
        severity: Severity::Error,
        name: "black",
        is_bad: &is_black,
        problem: |views| format!("the photograph is black where the object is, in {views}"),
        help: "Replace it, or leave the view out with `select`.",
    };
    let bright = Fault {
        severity: Severity::Error,
        name: "absurdly-bright",
        is_bad: &is_bright,
        problem: |views| {
            format!(
                "the photograph is absurdly bright in {views}: no light is so much brighter than in the others"
            )
        },
        help: "Write the image again, in the unit of the others, or leave the view out with `select`.",
    };
    let found = [black.find(looks), bright.find(looks), glaring(looks, is_bright), negative(looks)];
    found.into_iter().chain([turned(looks), clipped(looks)]).flatten().collect()
}

/// The median over the photographs of each placement.
fn by_placement(looks: &[ViewLook], value: impl Fn(&RadianceStatistics) -> f32) -> BTreeMap<Placement, f32> {
    let mut values: BTreeMap<Placement, Vec<f32>> = BTreeMap::new();
    for (look, light) in lights(looks) {
        values.entry(look.placement).or_default().push(value(light));
    }
    let usual = |(placement, mut values): (Placement, Vec<f32>)| Some((placement, median(&mut values)?));
    values.into_iter().filter_map(usual).collect()
}

/// Photographs with many pixels at the top of their range.
fn clipped(looks: &[ViewLook]) -> Option<Finding> {
    let fault = Fault {
        severity: Severity::Warning,
        name: "clipped",
        is_bad: &|_: &ViewLook, light: &RadianceStatistics| light.clipped > MANY_CLIPPED,
        problem: |views| format!("more than a twentieth of the object's pixels are clipped in {views}"),
        help: "Expose less, or write images with more range (16-bit PNG, EXR).",
    };
    fault.find(looks)
}

/// Photographs a few pixels of which are far brighter than anything in the others, but which are not absurd as a whole.
fn glaring(
    looks: &[ViewLook],
    is_absurd: impl Fn(&ViewLook, &RadianceStatistics) -> bool,
) -> Option<Finding> {
    let limit = glare_limit(lights(looks).map(|(_, light)| light.highest));
    let is_glaring =
        |(look, light): &(&ViewLook, &RadianceStatistics)| light.highest > limit && !is_absurd(look, light);
    let views: Vec<String> = lights(looks).filter(is_glaring).map(|(look, _)| look.name.clone()).collect();
    let brightest = lights(looks).map(|(_, light)| light.highest).fold(0.0, f32::max);
    let problem = || {
        let views = named(&views);
        format!(
            "some pixels are {:.0} times brighter than the brightest of a typical photograph in {views}: they are left out of fits",
            GLARING * brightest / limit
        )
    };
    let help = "If they are broken pixels, write the image again, or leave the view out with `select`.";
    (!views.is_empty()).then(|| Finding::warning("glaring-pixels", views.clone(), problem(), help))
}

/// Photographs with an EXIF orientation of which no size tells whether cameras and masks are of the pixels as they are stored.
fn turned(looks: &[ViewLook]) -> Option<Finding> {
    let turned: Vec<&ViewLook> =
        looks.iter().filter(|look| look.light.is_some() && look.exif[0] != 1).collect();
    let views: Vec<String> = turned.iter().map(|look| look.name.clone()).collect();
    let masks =
        turned.iter().filter(|look| look.mask_source == MaskOrigin::File && look.exif[1] != look.exif[0]);
    let masks = match masks.count() {
        0 => String::new(),
        count => format!("; {count} of their masks have another"),
    };
    let problem = || {
        let views = named(&views);
        format!(
            "the EXIF orientation of photographs is ignored, as this layout's programs do, in {views}{masks}"
        )
    };
    let help = "If cameras or masks were made of upright pictures, run `mogrify -auto-orient` on the photographs first; otherwise \
                remove the orientation.";
    (!views.is_empty()).then(|| Finding::warning("exif-orientation", views.clone(), problem(), help))
}

/// Photographs of which some pixels are no radiance, as sharpening filters leave them.
fn negative(looks: &[ViewLook]) -> Option<Finding> {
    let views = looks.iter().filter(|look| look.negative > SOME_NEGATIVE).map(|look| look.name.clone());
    let views: Vec<String> = views.collect();
    let problem = || {
        let views = named(&views);
        format!(
            "more than a hundredth of the pixels that are not black are negative, and set to 0, in {views}"
        )
    };
    let help = "Write the images without a sharpening filter, or clamp them at 0.";
    (!views.is_empty()).then(|| Finding::warning("negative-pixels", views.clone(), problem(), help))
}

fn lights(looks: &[ViewLook]) -> impl Iterator<Item = (&ViewLook, &RadianceStatistics)> {
    looks.iter().filter_map(|look| Some((look, look.light.as_ref()?)))
}

/// Compares each view with those that see nearly the same side; `directions` are those of the cameras from the object. Views with another
/// fault (`spoiled`) are left out.
pub fn compare(
    looks: &[ViewLook],
    directions: &[Vec3],
    spoiled: &[bool],
) -> (Vec<NeighborComparison>, Vec<Finding>) {
    let mut compared = vec![NeighborComparison::default(); looks.len()];
    let mut found = Vec::new();
    let exposures = |light: &RadianceStatistics| (light.level > 0.0).then(|| light.level.log2());
    let mut outliers = Vec::new();
    for Stray { view, difference, sigmas, angle } in stray_views(looks, directions, spoiled, exposures, 0.1) {
        compared[view].stops = Some(difference);
        let limit = if angle < NEAR_DEGREES { STOPS } else { FAR_STOPS };
        if difference.abs() > limit && sigmas.abs() > SIGMAS {
            outliers.push((view, difference));
        }
    }
    if let Some(finding) = exposure_finding(looks, outliers) {
        found.push(finding);
    }
    let everywhere = |light: &RadianceStatistics| light.sharpness.map(|found| found.everywhere.ln());
    let strays = stray_views(looks, directions, spoiled, everywhere, 0.15);
    strays.iter().for_each(|stray| compared[stray.view].sharpness = Some(stray.difference.exp()));
    let least = |light: &RadianceStatistics| light.sharpness.map(|found| found.least.ln());
    let moved = stray_views(looks, directions, spoiled, least, 0.15);
    found.extend(blur_finding(looks, &strays, &moved));
    (compared, found)
}

/// Names views that are less sharp than others, the worst first: everywhere, or along one direction (`moved`).
fn blur_finding(looks: &[ViewLook], strays: &[Stray], moved: &[Stray]) -> Option<Finding> {
    let far = far_blurred(strays);
    let is_unusual = |stray: &Stray, limit: f32| stray.difference < limit.ln() && stray.sigmas < -SIGMAS;
    let is_blurred = |(stray, moved): &(&Stray, &Stray)| {
        is_unusual(stray, BLURRED) || is_unusual(moved, MOVED) || far.contains(&stray.view)
    };
    let mut blurred: Vec<(&Stray, &Stray)> = strays.iter().zip(moved).filter(is_blurred).collect();
    blurred.sort_by(|a, b| a.0.difference.total_cmp(&b.0.difference));
    let views: Vec<String> = blurred.iter().map(|(stray, _)| looks[stray.view].name.clone()).collect();
    let problem = || {
        let (looks_so, views) = (is_or_are(&views), named(&views));
        format!("{looks_so} blurred beside views from nearly the same side: {views}")
    };
    let help = "Leave blurred views out with `select`, or take them again.";
    (!views.is_empty()).then(|| Finding::warning("blurred", views.clone(), problem(), help))
}

/// The few views far less sharp than all others.
fn far_blurred(strays: &[Stray]) -> Vec<usize> {
    let (below, others): (Vec<&Stray>, Vec<&Stray>) =
        strays.iter().partition(|stray| stray.difference < FAR_BLURRED.ln());
    let most = below.iter().map(|stray| stray.difference).fold(f32::NEG_INFINITY, f32::max);
    let least = others.iter().map(|stray| stray.difference).fold(f32::INFINITY, f32::min);
    let is_few = below.len() as f32 <= FEW * strays.len() as f32;
    let is_apart = is_few && least > most + APART.ln();
    if is_apart { below.iter().map(|stray| stray.view).collect() } else { Vec::new() }
}

fn is_or_are(views: &[String]) -> &'static str {
    if views.len() == 1 { "a photograph looks" } else { "photographs look" }
}

fn exposure_finding(looks: &[ViewLook], mut outliers: Vec<(usize, f32)>) -> Option<Finding> {
    outliers.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    let (worst, stops) = *outliers.first()?;
    let views: Vec<String> = outliers.iter().map(|(view, _)| looks[*view].name.clone()).collect();
    let way = if stops > 0.0 { "brighter" } else { "darker" };
    let problem = format!(
        "the exposure differs from that of views from nearly the same side in {}: `{}` is {:.1} stops {way}",
        named(&views),
        looks[worst].name,
        stops.abs()
    );
    let help = "If it is not the object that looks so different from there (its underside, a glare), use `exposure: Color` in the pass that \
                fits, or leave the view out with `select`.";
    Some(Finding::warning("exposure", views, problem, help))
}

/// A view's difference from its neighbors.
struct Stray {
    view: usize,
    difference: f32,
    /// The same in standard deviations of such differences.
    sigmas: f32,
    /// Angle to the farthest neighbor, degrees.
    angle: f32,
}

/// Compares a value of views that have one, within each placement: in another one, the same side is in another light. Nothing for few views.
fn stray_views(
    looks: &[ViewLook],
    directions: &[Vec3],
    spoiled: &[bool],
    value: impl Fn(&RadianceStatistics) -> Option<f32>,
    floor: f32,
) -> Vec<Stray> {
    let with_value =
        |(i, look): (usize, &ViewLook)| Some((i, value(look.light.as_ref().filter(|_| !spoiled[i])?)?));
    let mut by_placement: BTreeMap<Placement, Vec<(usize, f32)>> = BTreeMap::new();
    for (i, value) in looks.iter().enumerate().filter_map(with_value) {
        by_placement.entry(looks[i].placement).or_default().push((i, value));
    }
    let mut all: Vec<Stray> =
        by_placement.values().flat_map(|chosen| strays_among(chosen, directions, floor)).collect();
    all.sort_by_key(|stray| stray.view);
    all
}

/// Compares the values of views, which are in the same light.
fn strays_among(chosen: &[(usize, f32)], directions: &[Vec3], floor: f32) -> Vec<Stray> {
    if chosen.len() < LEAST_VIEWS {
        return Vec::new();
    }
    let values: Vec<f32> = chosen.iter().map(|(_, value)| *value).collect();
    let directions: Vec<Vec3> = chosen.iter().map(|(i, _)| directions[*i]).collect();
    let near = neighbors(&directions, NEIGHBORS);
    let angle = |i: usize| {
        let farthest = near[i].last().map_or(1.0, |&k| directions[i].dot(directions[k]));
        farthest.clamp(-1.0, 1.0).acos().to_degrees()
    };
    let strays = strays(&values, &near, floor).into_iter().enumerate();
    strays
        .map(|(i, (difference, sigmas))| Stray { view: chosen[i].0, difference, sigmas, angle: angle(i) })
        .collect()
}

/// Photographs that are the same as another, pixel by pixel.
pub(crate) fn of_duplicates(looks: &[ViewLook]) -> Option<Finding> {
    let mut by_print: BTreeMap<(u64, [u32; 2]), Vec<&str>> = BTreeMap::new();
    for (look, light) in lights(looks).filter(|(_, light)| light.highest > 0.0) {
        by_print.entry((light.fingerprint, look.size)).or_default().push(&look.name);
    }
    let mut groups: Vec<Vec<&str>> = by_print.into_values().filter(|names| names.len() > 1).collect();
    groups.sort();
    let first = groups.first()?;
    let views: Vec<String> = groups.iter().flatten().map(|name| (*name).to_owned()).collect();
    let pair: Vec<String> = first.iter().map(|name| (*name).to_owned()).collect();
    let rest = if groups.len() > 1 { format!(", and {} more", groups.len() - 1) } else { String::new() };
    let problem = format!("the same photograph is there more than once: {}{rest}", named(&pair));
    let help = "Leave the copies out with `select`; a copy in the test split makes scores meaningless.";
    Some(Finding::warning("duplicates", views, problem, help))
}
