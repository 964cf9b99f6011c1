//! Findings about photographs and masks alone: black or differently exposed photographs; dim,
//! inverted or missing masks.

use crate::survey::{Finding, Severity, counted, named};
use glam::Vec3;
use lobelia_geometry::view::look::{MaskLook, ViewLook};
use lobelia_geometry::view::{Placement, Split};
use lobelia_sg::statistics::median;
use std::collections::BTreeMap;

/// Ratio to the median of all photographs below which the brightest hundredth of one is black.
const BLACK: f32 = 1e-3;
/// Highest coverage below which a mask never says that a pixel is the object's.
const DIM: f32 = 0.9;
/// Share of the frame's border that an inverted mask covers, and share of the frame that it leaves
/// out.
const BORDER: f32 = 0.95;
const LEFT_OUT: f32 = 0.03;
/// Views that a view is compared with, and the least number of views for that.
const NEIGHBORS: usize = 6;
const LEAST_VIEWS: usize = 8;
/// Stops from which on a view beside neighbors within `NEAR_DEGREES` is an outlier; `FAR_STOPS`
/// beside others.
const STOPS: f32 = 1.5;
const FAR_STOPS: f32 = 2.5;
const NEAR_DEGREES: f32 = 35.0;
/// Standard deviations of the usual difference that an outlier exceeds, and the least deviation,
/// stops.
const SIGMAS: f32 = 5.0;
const LEAST_SIGMA: f32 = 0.1;
/// Factor from the median absolute deviation to the standard deviation of a normal distribution.
const SIGMA_PER_MAD: f32 = 1.4826;

fn names<'a>(looks: impl IntoIterator<Item = &'a ViewLook>) -> Vec<String> {
    looks.into_iter().map(|look| look.name.clone()).collect()
}

/// Photographs that cannot be photographs of the object.
pub(super) fn black(looks: &[ViewLook]) -> Option<Finding> {
    // Photographs of a placement are in one light.
    let mut medians: BTreeMap<Placement, Vec<f32>> = BTreeMap::new();
    for look in looks {
        medians.entry(look.placement).or_default().extend(look.light.map(|light| light.median));
    }
    let usual = medians.into_iter().map(|(key, mut values)| (key, median(&mut values).unwrap_or(0.0)));
    let usual: BTreeMap<Placement, f32> = usual.collect();
    let is_black = |look: &&ViewLook| {
        let (light, usual) = (look.light, usual[&look.placement]);
        light.is_some_and(|of| of.highest <= 0.0 || (usual > 0.0 && of.bright < BLACK * usual))
    };
    let views = names(looks.iter().filter(is_black));
    let problem = format!("the photograph is black where the object is, in {}", named(&views));
    let help = "Replace it, or leave the view out with `select`.";
    (!views.is_empty()).then(|| Finding::new(Severity::Error, "black", views, problem, help))
}

/// Findings about the masks of all views; `has_mesh` says whether the shape is known.
pub(super) fn of_masks(looks: &[ViewLook], has_mesh: bool) -> impl Iterator<Item = Finding> {
    [dim(looks), inverted(looks), missing(looks, has_mesh)].into_iter().flatten()
}

fn masked(looks: &[ViewLook]) -> impl Iterator<Item = (&ViewLook, &MaskLook)> {
    looks.iter().filter_map(|look| Some((look, look.mask.as_ref()?)))
}

fn dim(looks: &[ViewLook]) -> Option<Finding> {
    let dim = || masked(looks).filter(|(_, mask)| mask.highest < DIM);
    let highest = 255.0 * dim().next()?.1.highest;
    let views = names(dim().map(|(look, _)| look));
    let problem = format!(
        "no pixel of the mask is white in {}: the highest value is {highest:.0} of 255",
        named(&views)
    );
    let help = "Write masks with 0 for the background and 255 (in 16 bits 65535) for the object.";
    Some(Finding::new(Severity::Error, "dim-masks", views, problem, help))
}

/// Masks of the background: all around the frame, with a hole.
fn inverted(looks: &[ViewLook]) -> Option<Finding> {
    let is_inverted = |mask: &MaskLook| mask.border > BORDER && mask.coverage < 1.0 - LEFT_OUT;
    let views = names(masked(looks).filter(|(_, mask)| is_inverted(mask)).map(|(look, _)| look));
    let is_error = 2 * views.len() >= masked(looks).count();
    let (severity, is_there) = (Severity::error_if(is_error), !views.is_empty());
    let problem = format!("the mask looks inverted, white around the object, in {}", named(&views));
    let help = "A mask is white where the object is and black elsewhere: invert it.";
    is_there.then(|| Finding::new(severity, "inverted-masks", views, problem, help))
}

/// Views without masks. Where no view has one, that is a warning beside a mesh, and an error of the
/// cameras without a mesh.
fn missing(looks: &[ViewLook], has_mesh: bool) -> Option<Finding> {
    let without = || looks.iter().filter(|look| look.mask.is_none() && look.light.is_some());
    let has_none = masked(looks).next().is_none();
    if without().next().is_none() || (has_none && !has_mesh) {
        return None;
    }
    let help = "Without a mask the background counts where the object is rendered: add masks, white where the object is.";
    if has_none {
        let problem = "no view has a mask: there is neither a folder of masks nor alpha";
        return Some(Finding::new(Severity::Warning, "missing-masks", Vec::new(), problem, help));
    }
    let of_test = without().filter(|look| look.split == Split::Test).count();
    let views = names(without());
    let problem =
        format!("there is no mask in {} ({} of the test split)", named(&views), counted(of_test, "view"));
    Some(Finding::new(Severity::Warning, "missing-masks", views, problem, help))
}

/// Compares the exposure of each view with that of views of the same placement from nearly the same
/// side: sets [`ViewLook::stops`], and names outliers. `directions` are those of the cameras from
/// the object; views with another fault (`spoiled`) are left out.
pub(super) fn of_exposure(looks: &mut [ViewLook], directions: &[Vec3], spoiled: &[bool]) -> Option<Finding> {
    let level = |look: &ViewLook| look.light.map(|light| light.level).filter(|level| *level > 0.0);
    let mut by_placement: BTreeMap<Placement, Vec<(usize, f32)>> = BTreeMap::new();
    for (i, look) in looks.iter().enumerate().filter(|(i, _)| !spoiled[*i]) {
        let stops = level(look).map(|level| (i, level.log2()));
        by_placement.entry(look.placement).or_default().extend(stops);
    }
    let mut outliers: Vec<(usize, f32)> = Vec::new();
    for chosen in by_placement.values().filter(|chosen| chosen.len() >= LEAST_VIEWS) {
        let around: Vec<Vec3> = chosen.iter().map(|(i, _)| directions[*i]).collect();
        let near = neighbors(&around, NEIGHBORS);
        let difference = |i: usize| {
            let mut values: Vec<f32> = near[i].iter().map(|&k| chosen[k].1).collect();
            median(&mut values).map_or(0.0, |usual| chosen[i].1 - usual)
        };
        let differences: Vec<f32> = (0..chosen.len()).map(difference).collect();
        let mut sizes: Vec<f32> = differences.iter().map(|difference| difference.abs()).collect();
        let sigma = (SIGMA_PER_MAD * median(&mut sizes).unwrap_or(0.0)).max(LEAST_SIGMA);
        for (i, difference) in differences.into_iter().enumerate() {
            let farthest = near[i].last().map_or(1.0, |&k| around[i].dot(around[k]));
            let is_near = farthest.clamp(-1.0, 1.0).acos().to_degrees() < NEAR_DEGREES;
            looks[chosen[i].0].stops = Some(difference);
            let limit = if is_near { STOPS } else { FAR_STOPS };
            if difference.abs() > limit.max(SIGMAS * sigma) {
                outliers.push((chosen[i].0, difference));
            }
        }
    }
    outliers.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()).then(a.0.cmp(&b.0)));
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
    Some(Finding::new(Severity::Warning, "exposure", views, problem, help))
}

/// For each unit direction, the indices of the `count` nearest others, the nearest first; equal
/// distances are ordered by index.
fn neighbors(directions: &[Vec3], count: usize) -> Vec<Vec<usize>> {
    let nearest = |i: usize| {
        let mut others: Vec<usize> = (0..directions.len()).filter(|&k| k != i).collect();
        let closeness = |k: &usize| -directions[i].dot(directions[*k]);
        others.sort_by(|a, b| closeness(a).total_cmp(&closeness(b)).then(a.cmp(b)));
        others.truncate(count);
        others
    };
    (0..directions.len()).map(nearest).collect()
}
