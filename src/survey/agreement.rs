//! Findings about the whole of cameras, masks and a known mesh: what does not agree, and the change that makes it agree.

use crate::math::statistics::median;
use crate::mesh::bvh::TriangleBvh;
use crate::report::sheet::choose_evenly;
use crate::survey::change::{Cause, Change, camera_causes, turns, world_causes};
use crate::survey::finding::{Finding, Severity, named};
use crate::survey::look::{MaskLook, SmallMask, ViewLook};
use crate::survey::mesh_overlap::{Agreement, median_agreement};
use crate::survey::mesh_placement::{find_placement, placement_cause};
use crate::survey::order::orders;
use crate::survey::rivals::{joined, rivals};
use crate::view::Split;
use glam::Mat3A;

/// Overlap of a mesh with the masks from which on nothing is looked for.
const AGREES: f32 = 0.97;
/// Overlap from which on a mesh is that of the photographs: of a compact object also with mirrored photographs or other cameras.
const COVERS: f32 = 0.75;
/// Overlap below which a mesh is not that of the photographs.
const MISSES: f32 = 0.6;
/// Overlap that a change must reach, and by how much it must be better, to be named as the cause.
const EXPLAINS: f32 = 0.7;
const BETTER: f32 = 0.15;
/// The same of a mesh that covers the masks: the overlap, and the part of the disagreement (1 − overlap) that may be left.
const EXPLAINS_WELL: f32 = 0.9;
const LEFT: f32 = 0.5;
/// Overlaps this close are equally good, or this part of the disagreement: the likelier cause is named.
const TIE: f32 = 0.02;
const TIE_SHARE: f32 = 0.1;
/// A view below this overlap, and this far below the median, is named.
const STRAY: f32 = 0.75;
const STRAY_BY: f32 = 0.12;
/// So is one that disagrees by this and so many times as much as the median, with outlines so many pixels apart: a thin object, or what
/// the frame leaves of one, disagrees by less than a pixel everywhere. Two exchanged views of a compact object have 0.12 beside 0.001;
/// of the sound sets the worst view has 0.004.
const STRAY_FLOOR: f32 = 0.05;
const STRAY_TIMES: f32 = 8.0;
const STRAY_OFFSET: f32 = 0.5;
/// Part of a mask well outside the mesh, or the reverse, that is no rough outline, and the part of the views that must have it: a missing
/// part is behind the others in many. Sound sets have none.
const MISSING: f32 = 0.01;
const MISSING_VIEWS: f32 = 0.25;
/// Views and pixels a side that causes are tried on.
const TRIED_VIEWS: usize = 10;
const TRIED_SIDE: u32 = 40;
/// Pixels a side that causes which are nearly alike are told apart on.
const RIVAL_SIDE: u32 = 96;

/// What is wrong with how a known mesh and the masks agree.
pub(crate) fn of_mesh(bvh: &TriangleBvh, looks: &[ViewLook], found: &[Option<Agreement>]) -> Vec<Finding> {
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
    if let Some(finding) = (middle < AGREES).then(|| explained(bvh, looks, middle)).flatten() {
        return vec![finding];
    }
    if middle >= COVERS {
        return other_parts(looks, found).into_iter().chain(strays(looks, found, middle)).collect();
    }
    vec![unexplained(looks, found, middle)]
}

/// Overlap that explains a given one.
fn enough(given: f32) -> f32 {
    if given < COVERS { EXPLAINS.max(given + BETTER) } else { EXPLAINS_WELL.max(1.0 - LEFT * (1.0 - given)) }
}

/// What would make mesh and masks agree, whose median overlap is `middle`.
fn explained(bvh: &TriangleBvh, looks: &[ViewLook], middle: f32) -> Option<Finding> {
    // Small differences need more pixels.
    let side = if middle < COVERS { TRIED_SIDE } else { RIVAL_SIDE };
    let views = tried(looks, TRIED_VIEWS, side);
    let given = median_agreement(bvh, &views);
    let (cause, reached) = match mesh_cause(bvh, looks, &views, side, given) {
        Some((cause, reached)) if is_clear(&cause) => (cause, reached),
        placed => {
            let views = tried(looks, TRIED_VIEWS, RIVAL_SIDE);
            let mut causes = rivals(bvh, looks, &views, placed.map(|placed| placed.0));
            let reached = causes.first().map(|first| first.1).filter(|reached| *reached >= enough(given))?;
            causes.retain(|cause| given < COVERS || cause.1 >= enough(given));
            (joined(&causes)?, reached)
        }
    };
    Some(cause_finding(cause, given, reached))
}

/// Whether silhouettes tell a cause from others.
fn is_clear(cause: &Cause) -> bool {
    match cause.change {
        Change::Placed { turn, .. } => turn != Mat3A::IDENTITY,
        Change::Focal(_) | Change::Masks => false,
        _ => true,
    }
}

/// The cause by which the overlap rises from `given` to `reached`.
fn cause_finding(cause: Cause, given: f32, reached: f32) -> Finding {
    let problem = format!(
        "silhouettes of the mesh agree with the masks to {reached:.2} instead of {given:.2} (intersection over union) once this is put \
         right: {}",
        cause.words
    );
    let name = match cause.change {
        Change::Placed { .. } => "other-place",
        Change::Focal(_) => "other-focal",
        Change::Masks => "other-outline",
        Change::Order => "other-order",
        _ => "other-axes",
    };
    // A mesh that is a little too large covers the photographs nonetheless.
    let is_little = given >= COVERS && !is_clear(&cause);
    let severity = if is_little { Severity::Warning } else { Severity::Error };
    Finding::new(severity, name, Vec::new(), problem, cause.help)
}

/// The mesh is not that of the masks, and no cause is known.
fn unexplained(looks: &[ViewLook], found: &[Option<Agreement>], middle: f32) -> Finding {
    let worst = worst(looks, found);
    let problem = format!(
        "the mesh does not cover the masks: they overlap to {middle:.2} (intersection over union, median of {} views); {} is worst",
        worst.len(),
        named(&worst[..1])
    );
    let help = "Check that mesh, cameras and masks are of the same object, in the same coordinates.";
    let severity = if middle < MISSES { Severity::Error } else { Severity::Warning };
    Finding::new(severity, "mesh-misses-masks", worst, problem, help)
}

/// Views whose mask has no silhouette, though the mesh does not fill their frames.
fn white(looks: &[ViewLook], found: &[Option<Agreement>]) -> Vec<String> {
    let views = looks.iter().zip(found).filter(|(look, found)| {
        let is_white = look.mask.as_ref().is_some_and(|mask| mask.all_covered);
        is_white && found.is_some_and(|found| found.iou < COVERS)
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
pub(crate) const INVERT_HELP: &str = "A mask is white where the object is and black elsewhere: invert it.";

/// Views whose background is the mesh.
fn inverted(looks: &[ViewLook], found: &[Option<Agreement>]) -> Vec<String> {
    // A mesh that fills the frame covers the background as well; its mask is not white along the border.
    let is_inverted = |found: &Agreement, mask: &MaskLook| {
        found.iou < MISSES && found.inverse_iou > COVERS && mask.border > 0.5
    };
    let views = looks
        .iter()
        .zip(found)
        .filter_map(|(look, found)| Some((look, found.as_ref()?, look.mask.as_ref()?)));
    views.filter(|(_, found, mask)| is_inverted(found, mask)).map(|(look, ..)| look.name.clone()).collect()
}

/// Parts of the object that only the masks have, or only the mesh.
fn other_parts(looks: &[ViewLook], found: &[Option<Agreement>]) -> Option<Finding> {
    let shares = |share: fn(&Agreement) -> f32| {
        let of_view = |(look, found): (&ViewLook, &Option<Agreement>)| {
            found.as_ref().map(share).filter(|share| *share > MISSING).map(|share| (share, look.name.clone()))
        };
        let mut views: Vec<(f32, String)> = looks.iter().zip(found).filter_map(of_view).collect();
        views.sort_by(|a, b| b.0.total_cmp(&a.0));
        views
    };
    let least = MISSING_VIEWS * found.iter().flatten().count() as f32;
    let (missing, beyond) = (shares(|found| found.missing), shares(|found| found.beyond));
    let (views, words) = if missing.len() as f32 >= least.max(1.0) {
        (missing, "the mesh lacks parts that the masks have")
    } else if beyond.len() as f32 >= least.max(1.0) {
        (beyond, "the mesh has parts that the masks do not have")
    } else {
        return None;
    };
    let percent = 100.0 * views[0].0;
    let views: Vec<String> = views.into_iter().map(|view| view.1).collect();
    let problem = format!("{words}, in {}: {percent:.0} % of the mask in the worst", named(&views));
    let help =
        "Give the mesh of the whole object and masks of the same parts, or fit without a mesh (`Shape`).";
    Some(Finding::warning("other-parts", views, problem, help))
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
    let apart: Vec<Option<Agreement>> =
        found.iter().map(|found| found.filter(|found| is_stray(found, middle))).collect();
    let least = apart.iter().flatten().map(|found| found.iou).fold(1.0, f32::min);
    let views: Vec<String> =
        worst(looks, &apart).into_iter().filter(|name| !inverted.contains(name)).collect();
    if !inverted.is_empty() {
        let problem = format!("the mask is inverted in {}: it is white around the mesh", named(&inverted));
        findings.push(Finding::error("inverted-masks", inverted, problem, INVERT_HELP));
    }
    if !views.is_empty() {
        let problem = format!(
            "mask or camera does not agree with the mesh in {}: they overlap to {least:.2} in the worst (intersection over union), to {middle:.2} \
             in the median view",
            named(&views)
        );
        let help = "Correct that mask or pose, or leave the view out with `select`.";
        findings.push(Finding::warning("stray-view", views, problem, help));
    }
    findings
}

/// Whether a view does not agree where the median of all is `middle`.
fn is_stray(found: &Agreement, middle: f32) -> bool {
    let is_apart = 1.0 - found.iou > STRAY_FLOOR.max(STRAY_TIMES * (1.0 - middle));
    (is_apart && found.offset > STRAY_OFFSET) || found.iou < STRAY.min(middle - STRAY_BY)
}

/// A few small masks, evenly chosen among those of training views, or of all if there are few.
pub fn tried(looks: &[ViewLook], most: usize, side: u32) -> Vec<SmallMask> {
    let of = |train: bool| {
        let views = looks.iter().filter(|look| !train || look.split == Split::Train);
        let masks = views.filter_map(|look| look.mask.as_ref().filter(|mask| !mask.all_covered));
        masks.map(|mask| &mask.small).collect::<Vec<_>>()
    };
    let masks = if of(true).len() >= 3 { of(true) } else { of(false) };
    choose_evenly(masks.len(), most).into_iter().map(|i| masks[i].at_most(side)).collect()
}

/// The cause that makes mesh and masks agree, with the overlap that it reaches; `views` are of `looks`, at most `side` pixels wide.
fn mesh_cause(
    bvh: &TriangleBvh,
    looks: &[ViewLook],
    views: &[SmallMask],
    side: u32,
    given: f32,
) -> Option<(Cause, f32)> {
    let with_views = |cause: Cause| {
        let changed: Vec<SmallMask> = views.iter().map(|view| cause.change.of(view)).collect();
        (cause, changed)
    };
    let axes = camera_causes().into_iter().chain(world_causes()).map(with_views);
    let orders = orders(looks, TRIED_VIEWS).into_iter().map(|(cause, views)| {
        let small: Vec<SmallMask> = views.iter().map(|view| view.at_most(side)).collect();
        (cause, small)
    });
    let (center, radius) = bvh.bounding_sphere();
    let placed = |turn: Mat3A| placement_cause(find_placement(bvh, views, turn)?, center, radius);
    let upright = || placed(Mat3A::IDENTITY).into_iter().map(with_views);
    // A mesh that covers the masks is not turned and of another size at once.
    let others = if given < COVERS { turns() } else { Vec::new() };
    let turned = || others.into_iter().skip(1).filter_map(placed).map(with_views);
    best(bvh, axes.chain(orders), given)
        .or_else(|| best(bvh, upright(), given))
        .or_else(|| best(bvh, turned(), given))
}

/// The first of the best causes, each with the views as they are without it, if it explains enough.
fn best(
    bvh: &TriangleBvh,
    causes: impl Iterator<Item = (Cause, Vec<SmallMask>)>,
    given: f32,
) -> Option<(Cause, f32)> {
    let tried: Vec<(Cause, f32)> =
        causes.map(|(cause, views)| (cause, median_agreement(bvh, &views))).collect();
    let most = tried.iter().map(|(_, reached)| *reached).fold(0.0, f32::max);
    let tie = TIE.min(TIE_SHARE * (1.0 - given));
    let first = tried.into_iter().find(|(_, reached)| *reached >= most - tie);
    first.filter(|(_, reached)| *reached >= enough(given))
}
