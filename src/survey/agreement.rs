//! Findings about the whole of cameras, masks and a known mesh: what does not agree, and the change that makes it agree.

use crate::mesh::bvh::TriangleBvh;
use crate::report::sheet::choose_evenly;
use crate::survey::change::{Cause, Change, camera_causes, turns, world_causes};
use crate::survey::finding::{Finding, Severity, named};
use crate::survey::hull;
use crate::survey::look::{MaskLook, SmallMask, ViewLook};
use crate::survey::placement::{find_placement, placement_cause};
use crate::survey::silhouette::{Agreement, median_agreement};
use crate::survey::statistics::median;
use crate::view::Split;
use glam::Mat3A;

/// Overlap of a mesh with the masks from which on nothing is looked for.
const AGREES: f32 = 0.75;
/// Overlap below which a mesh is not that of the photographs.
const MISSES: f32 = 0.6;
/// Overlap that a change must reach, and by how much it must be better, to be named as the cause.
const EXPLAINS: f32 = 0.7;
const BETTER: f32 = 0.15;
/// Overlaps this close are equally good: the likelier cause is named.
const TIE: f32 = 0.02;
/// A view below this overlap, and this far below the median, is named.
const STRAY: f32 = 0.75;
const STRAY_BY: f32 = 0.12;
/// Overlap of the hull with the masks from which on nothing is looked for, and that below which masks and cameras are doubtful. Sound
/// data reach 0.88 to 0.92, mirrored photographs 0.61 to 0.83.
const CONSISTENT: f32 = 0.8;
const INCONSISTENT: f32 = 0.75;
/// By how much a change must make the hull better. A hull fits even wrong cameras, so that differences are smaller than with a mesh.
const BETTER_HULL: f32 = 0.1;
/// Views and pixels a side that causes are tried on.
const TRIED_VIEWS: usize = 10;
const TRIED_SIDE: u32 = 40;
/// The same for a hull.
const HULL_VIEWS: usize = 24;
const HULL_SIDE: u32 = 96;

/// What is wrong with how a known mesh and the masks agree.
pub fn of_mesh(bvh: &TriangleBvh, looks: &[ViewLook], found: &[Option<Agreement>]) -> Vec<Finding> {
    let mut all: Vec<f32> = found.iter().flatten().map(|found| found.iou).collect();
    let Some(middle) = median(&mut all) else { return Vec::new() };
    let white = white(looks, found);
    if let Some(finding) = white_finding(&white, all.len()) {
        // They say nothing about the others.
        let rest: Vec<Option<Agreement>> = looks
            .iter()
            .zip(found)
            .map(|(look, found)| found.filter(|_| !white.contains(&look.name)))
            .collect();
        let further =
            if finding.severity == Severity::Error { Vec::new() } else { of_mesh(bvh, looks, &rest) };
        return std::iter::once(finding).chain(further).collect();
    }
    let inverted = inverted(looks, found);
    if 2 * inverted.len() >= all.len() {
        let problem = format!("masks are inverted: they are white around the mesh, in {}", named(&inverted));
        return vec![Finding::error("inverted-masks", inverted, problem, INVERT_HELP)];
    }
    if middle >= AGREES {
        return strays(looks, found, middle);
    }
    let views = tried(looks, TRIED_VIEWS, TRIED_SIDE);
    let given = median_agreement(bvh, &views);
    if let Some((cause, reached)) = mesh_cause(bvh, &views, given) {
        let problem = format!(
            "silhouettes of the mesh agree with the masks to {reached:.2} instead of {given:.2} (intersection over union) once this is \
             put right: {}",
            cause.words
        );
        let is_placed = matches!(cause.change, Change::Placed { .. });
        let name = if is_placed { "other-place" } else { "other-axes" };
        return vec![Finding::error(name, Vec::new(), problem, cause.help)];
    }
    let worst = worst(looks, found);
    let problem = format!(
        "the mesh does not cover the masks: they overlap to {middle:.2} (intersection over union, median of {} views); {} is worst",
        all.len(),
        named(&worst[..1])
    );
    let help = "Check that mesh, cameras and masks are of the same object, in the same coordinates.";
    if middle < MISSES {
        vec![Finding::error("mesh-misses-masks", worst, problem, help)]
    } else {
        vec![Finding::warning("mesh-misses-masks", worst, problem, help)]
    }
}

/// Views whose mask has no silhouette, though the mesh does not fill their frames.
fn white(looks: &[ViewLook], found: &[Option<Agreement>]) -> Vec<String> {
    let views = looks.iter().zip(found).filter(|(look, found)| {
        let is_white = look.mask.as_ref().is_some_and(|mask| mask.all_covered);
        is_white && found.is_some_and(|found| found.iou < AGREES)
    });
    views.map(|(look, _)| look.name.clone()).collect()
}

/// A finding about these views, of so many with masks.
fn white_finding(white: &[String], all: usize) -> Option<Finding> {
    if white.is_empty() {
        return None;
    }
    let problem = format!("the mask is all white in {}: it has no silhouette", named(white));
    let severity = if 2 * white.len() >= all { Severity::Error } else { Severity::Warning };
    let help = "Write masks that are white where the object is and black elsewhere, or leave the view out with `select`.";
    Some(Finding::new(severity, "white-masks", white.to_vec(), problem, help))
}

/// How to repair inverted masks.
pub const INVERT_HELP: &str = "A mask is white where the object is and black elsewhere: invert it.";

/// Views whose background is the mesh.
fn inverted(looks: &[ViewLook], found: &[Option<Agreement>]) -> Vec<String> {
    // A mesh that fills the frame covers the background as well; its mask is not white along the border.
    let is_inverted = |found: &Agreement, mask: &MaskLook| {
        found.iou < MISSES && found.inverse_iou > AGREES && mask.border > 0.5
    };
    let views = looks
        .iter()
        .zip(found)
        .filter_map(|(look, found)| Some((look, found.as_ref()?, look.mask.as_ref()?)));
    views.filter(|(_, found, mask)| is_inverted(found, mask)).map(|(look, ..)| look.name.clone()).collect()
}

/// Names of views with masks, the least overlap first.
fn worst(looks: &[ViewLook], found: &[Option<Agreement>]) -> Vec<String> {
    let mut views: Vec<(f32, &str)> = looks
        .iter()
        .zip(found)
        .filter_map(|(look, found)| Some((found.as_ref()?.iou, look.name.as_str())))
        .collect();
    views.sort_by(|a, b| a.0.total_cmp(&b.0));
    views.into_iter().map(|view| view.1.to_owned()).collect()
}

/// Single views that do not agree where the others do.
fn strays(looks: &[ViewLook], found: &[Option<Agreement>], middle: f32) -> Vec<Finding> {
    let inverted = inverted(looks, found);
    let mut findings = Vec::new();
    let limit = STRAY.min(middle - STRAY_BY);
    let strays = found.iter().flatten().filter(|found| found.iou < limit).count();
    let views: Vec<String> =
        worst(looks, found).into_iter().take(strays).filter(|name| !inverted.contains(name)).collect();
    if !inverted.is_empty() {
        let problem = format!("the mask is inverted in {}: it is white around the mesh", named(&inverted));
        findings.push(Finding::error("inverted-masks", inverted, problem, INVERT_HELP));
    }
    if !views.is_empty() {
        let problem = format!(
            "mask or camera does not agree with the mesh in {}: they overlap to less than {limit:.2}",
            named(&views)
        );
        let help = "Correct that mask or pose, or leave the view out with `select`.";
        findings.push(Finding::warning("stray-view", views, problem, help));
    }
    findings
}

/// A few small masks, evenly chosen among those of training views, or of all if there are few.
fn tried(looks: &[ViewLook], most: usize, side: u32) -> Vec<SmallMask> {
    let of = |train: bool| {
        let views = looks.iter().filter(|look| !train || look.split == Split::Train);
        let masks = views.filter_map(|look| look.mask.as_ref().filter(|mask| !mask.all_covered));
        masks.map(|mask| &mask.small).collect::<Vec<_>>()
    };
    let masks = if of(true).len() >= 3 { of(true) } else { of(false) };
    choose_evenly(masks.len(), most).into_iter().map(|i| masks[i].at_most(side)).collect()
}

/// The cause that makes mesh and masks agree, with the overlap that it reaches.
fn mesh_cause(bvh: &TriangleBvh, views: &[SmallMask], given: f32) -> Option<(Cause, f32)> {
    let axes = camera_causes().into_iter().chain(world_causes());
    if let found @ Some(_) = best(axes, given, EXPLAINS, BETTER, |cause| agreement_after(bvh, views, cause)) {
        return found;
    }
    let (center, radius) = bvh.bounding_sphere();
    let placed = |turn: Mat3A| placement_cause(find_placement(bvh, views, turn)?, center, radius);
    let upright = placed(Mat3A::IDENTITY).into_iter();
    if let found @ Some(_) =
        best(upright, given, EXPLAINS, BETTER, |cause| agreement_after(bvh, views, cause))
    {
        return found;
    }
    let turned = turns().into_iter().skip(1).filter_map(placed);
    best(turned, given, EXPLAINS, BETTER, |cause| agreement_after(bvh, views, cause))
}

fn agreement_after(bvh: &TriangleBvh, views: &[SmallMask], cause: &Cause) -> f32 {
    let changed: Vec<SmallMask> = views.iter().map(|view| cause.change.of(view)).collect();
    median_agreement(bvh, &changed)
}

/// The first of the best causes, if it explains enough.
fn best(
    causes: impl Iterator<Item = Cause>,
    given: f32,
    least: f32,
    better: f32,
    reached: impl Fn(&Cause) -> f32,
) -> Option<(Cause, f32)> {
    let tried: Vec<(Cause, f32)> = causes.map(|cause| (cause.clone(), reached(&cause))).collect();
    let most = tried.iter().map(|(_, reached)| *reached).fold(0.0, f32::max);
    let first = tried.into_iter().find(|(_, reached)| *reached >= most - TIE);
    first.filter(|(_, reached)| *reached >= least.max(given + better))
}

/// How masks agree with each other, where no mesh is known; `None` for fewer than three masks.
pub fn hull_agreement(looks: &[ViewLook]) -> Option<f32> {
    hull::consistency(&tried(looks, HULL_VIEWS, HULL_SIDE))
}

/// What is wrong with how masks and cameras agree, where no mesh is known. `given` is [`hull_agreement`], `complaint` what
/// [`check_masks`](crate::survey::meeting::check_masks) has to say.
pub fn of_masks(looks: &[ViewLook], given: f32, complaint: Option<Finding>) -> Option<Finding> {
    if given >= CONSISTENT && complaint.is_none() {
        return None;
    }
    let views = tried(looks, HULL_VIEWS, HULL_SIDE);
    let after = |cause: &Cause| {
        let changed: Vec<SmallMask> = views.iter().map(|view| cause.change.of(view)).collect();
        hull::consistency(&changed).unwrap_or(0.0)
    };
    if given < CONSISTENT
        && let Some((cause, reached)) = best(camera_causes().into_iter(), given, EXPLAINS, BETTER_HULL, after)
    {
        let problem = format!(
            "the masks agree with their visual hull to {reached:.2} instead of {given:.2} (intersection over union) once this is put \
             right: {}",
            cause.words
        );
        return Some(Finding::error("other-axes", Vec::new(), problem, cause.help));
    }
    let doubt = || {
        let problem = format!(
            "masks and cameras hardly agree: the visual hull of all covers {given:.2} of the masks (mean intersection over union)"
        );
        let help = "Check poses, intrinsics and masks; the contact sheet of `lobelia check --out DIR` shows all of them.";
        Finding::warning("inconsistent-masks", Vec::new(), problem, help)
    };
    complaint.or_else(|| (given < INCONSISTENT).then(doubt))
}
