//! Findings about masks and cameras where no mesh is known: single views that the others contradict, and cameras that do not fit the
//! photographs as a whole.

use crate::math::statistics::median;
use crate::report::sheet::choose_evenly;
use crate::survey::agreement::tried;
use crate::survey::change::{Cause, Change, camera_causes};
use crate::survey::finding::{Finding, Severity, named};
use crate::survey::look::{SmallMask, ViewLook};
use crate::survey::mask_hull::{CELLS, FINE_CELLS, FORGIVEN, carved, consistency, solid, uncovered};
use crate::survey::order::orders;

/// Views that are judged at least, and the pixels that their masks have in the median at least.
const LEAST_VIEWS: usize = 8;
const LEAST_PIXELS: usize = 100;
/// Pixels of a mask below which limits grow, as the border weighs more.
const PLENTY: f32 = 1000.0;
/// Views that make the hull.
const VOTERS: usize = 96;
/// Shares of views that may be wrong for the first hulls, and the uncovered share beyond which a view has no say in the next. With 12 of
/// 49 to 125 views exchanged, right views have 0.003 at most, wrong ones 0.007 and more.
const LOOSE: [f32; 2] = [0.25, 0.12];
const DISTRUSTED: f32 = 0.01;
/// Uncovered share of a mask from which on its view is named. Over seven sound sets (three rendered, one benchmark, three photographed;
/// 42 to 125 views) the worst view has 0.016. Of 12 views exchanged with neighbors the least has 0.03 to 0.10 (on a turntable a third
/// has less than 0.01), with views from elsewhere 0.04 to 0.18; 10° off it is 0.02 to 0.08, 40° off 0.05 to 0.35.
const STRAY: f32 = 0.03;
/// The same in standard deviations of the views above their median.
const STRAY_SIGMAS: f32 = 8.0;
/// Median of the uncovered shares from which on explanations are tried, and from which on all cameras are doubtful without one. The sound
/// sets have 0.003 at most; a turntable whose cameras are one place off has 0.016, five places 0.08, reversed or mirrored 0.10 to 0.12;
/// other sets 0.2 to 0.7.
const SUSPECT: f32 = 0.008;
const DOUBTFUL: f32 = 0.02;
/// Median from which on no run is worth its time; also of single views, if more than [`FEW`] have it.
const WRONG: f32 = 0.1;
/// Share of the views that may be wrong for a run.
const FEW: f32 = 0.1;
/// Views that are left out at most to find masks which lack a part of the object, and those that are tried for each of them.
const MOST_LACKING: usize = 3;
const SUSPECTS: usize = 4;
/// An explanation leaves at most [`DOUBTFUL`], and this part of what was left without it.
const BETTER: f32 = 1.0 / 3.0;
/// Explanations this close are equally good.
const TIE: f32 = 0.004;
/// Overlap with the hull that an explanation has at least.
const EXPLAINS: f32 = 0.7;
/// How much the overlap must rise where the hull of the others covers the masks as they are.
const CLEARLY: f32 = 0.05;
/// Intersection over union of masks and hull below which no camera or no mask can be right.
const HARDLY_ANY: f32 = 0.1;
/// Overlap with the hull of all masks below which masks and cameras are doubtful, where few views or small masks leave single views
/// unjudged. Sound data reach 0.88 to 0.92, mirrored photographs 0.61 to 0.83.
const CONSISTENT: f32 = 0.8;
const INCONSISTENT: f32 = 0.75;
/// Views and pixels a side that explanations are tried on.
const TRIED_VIEWS: usize = 24;
const TRIED_SIDE: u32 = 96;

/// How each mask agrees with the hull of the others.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Consensus {
    /// Share of each view's mask that the hull of the others leaves uncovered; `None` without a mask.
    pub uncovered: Vec<Option<f32>>,
    /// The median of these shares.
    pub middle: f32,
    /// Factor on limits: 1, or more for small masks.
    slack: f32,
    /// Views whose masks lack what those of the others have: they have no say in the hull.
    lacking: Vec<usize>,
}

impl Consensus {
    /// Of all views with a silhouette; `None` for few or small masks.
    pub fn new(looks: &[ViewLook]) -> Option<Self> {
        let has_outline = |look: &ViewLook| {
            look.mask.as_ref().is_some_and(|mask| !mask.all_covered && mask.bounds.is_some())
        };
        let chosen: Vec<usize> = (0..looks.len()).filter(|&i| has_outline(&looks[i])).collect();
        let masks: Vec<SmallMask> =
            chosen.iter().filter_map(|&i| Some(looks[i].mask.as_ref()?.small.clone())).collect();
        let slack = slack(&masks)?;
        let mut voters = vec![false; masks.len()];
        choose_evenly(masks.len(), VOTERS).into_iter().for_each(|i| voters[i] = true);
        let trusted = trusted(&masks, &voters);
        let coarse = Self::of(&masks, &trusted, slack)?;
        // Of a thin plate, coarse cells leave too much uncovered.
        let all =
            if coarse.is_suspect() { Self::on_cells(&masks, &trusted, slack, FINE_CELLS)? } else { coarse };
        let found = all.without_few(&masks, trusted).unwrap_or(all);
        let mut uncovered = vec![None; looks.len()];
        chosen.iter().zip(found.uncovered).for_each(|(i, share)| uncovered[*i] = share);
        let lacking = found.lacking.into_iter().map(|i| chosen[i]).collect();
        Some(Self { uncovered, lacking, ..found })
    }

    /// Of masks, with the hull of those that are trusted.
    fn of(masks: &[SmallMask], trusted: &[bool], slack: f32) -> Option<Self> {
        Self::on_cells(masks, trusted, slack, CELLS)
    }

    /// The same with a hull of `cells` cells a side.
    fn on_cells(masks: &[SmallMask], trusted: &[bool], slack: f32, cells: u32) -> Option<Self> {
        let shares = uncovered(masks, trusted, FORGIVEN, cells);
        let middle = median(&mut shares.clone())?;
        let uncovered = shares.into_iter().map(Some).collect();
        Some(Self { uncovered, middle, slack, lacking: Vec::new() })
    }

    /// Without the few views whose masks lack what those of the others have, if the others agree then: one such mask takes a part of the
    /// hull from all views, and its own is covered.
    fn without_few(&self, masks: &[SmallMask], mut trusted: Vec<bool>) -> Option<Self> {
        if self.is_sound() {
            return None;
        }
        let most = ((FEW * masks.len() as f32) as usize).clamp(1, MOST_LACKING);
        let mut lacking = Vec::new();
        while lacking.len() < most {
            let (next, found) = without_one(masks, &trusted, self.slack)?;
            trusted[next] = false;
            lacking.push(next);
            if found.is_sound() && found.mean() <= BETTER * self.mean() {
                return Some(Self { lacking, ..found });
            }
        }
        None
    }

    /// Whether nothing is wrong with any view.
    fn is_sound(&self) -> bool {
        !self.is_suspect() && self.strays().is_empty()
    }

    /// The mean of the shares.
    fn mean(&self) -> f32 {
        let shares: Vec<f32> = self.uncovered.iter().flatten().copied().collect();
        shares.iter().sum::<f32>() / shares.len().max(1) as f32
    }

    /// The views that the others contradict, the worst first.
    fn strays(&self) -> Vec<usize> {
        let shares = || self.uncovered.iter().flatten();
        let mut sizes: Vec<f32> = shares().map(|share| (share - self.middle).abs()).collect();
        let sigma = 1.4826 * median(&mut sizes).unwrap_or(0.0);
        let limit = (STRAY * self.slack).max(self.middle + STRAY_SIGMAS * sigma);
        let share = |i: &usize| self.uncovered[*i].unwrap_or(0.0);
        let mut views: Vec<usize> = (0..self.uncovered.len()).filter(|i| share(i) > limit).collect();
        views.sort_by(|a, b| share(b).total_cmp(&share(a)).then(a.cmp(b)));
        views
    }

    fn is_suspect(&self) -> bool {
        self.middle > SUSPECT * self.slack || self.is_wrong()
    }

    fn is_doubtful(&self) -> bool {
        self.middle > DOUBTFUL * self.slack
    }

    /// Whether more than a few of the views are far off.
    fn is_wrong(&self) -> bool {
        let shares: Vec<f32> = self.uncovered.iter().flatten().copied().collect();
        let wrong = shares.iter().filter(|share| **share > WRONG * self.slack).count();
        wrong as f32 > FEW * shares.len() as f32
    }
}

/// The view among those that take most from the hull without which the others agree best, and how they agree then.
fn without_one(masks: &[SmallMask], trusted: &[bool], slack: f32) -> Option<(usize, Consensus)> {
    let voters = trusted.iter().filter(|trusted| **trusted).count();
    // One view at least is forgiven.
    let taken = carved(masks, trusted, LOOSE[1].max(1.5 / voters.max(1) as f32));
    let mut views: Vec<usize> = (0..masks.len()).filter(|i| taken[*i] > 0.0).collect();
    views.sort_by(|a, b| taken[*b].total_cmp(&taken[*a]).then(a.cmp(b)));
    views.truncate(SUSPECTS);
    let without = |i: usize| {
        let rest: Vec<bool> = trusted.iter().enumerate().map(|(k, trusted)| *trusted && k != i).collect();
        Some((i, Consensus::of(masks, &rest, slack)?))
    };
    views.into_iter().filter_map(without).min_by(|a, b| a.1.mean().total_cmp(&b.1.mean()))
}

/// The factor on limits for masks of this size; `None` for few or small ones.
fn slack(masks: &[SmallMask]) -> Option<f32> {
    let mut sizes: Vec<f32> =
        masks.iter().map(|mask| solid(mask).iter().filter(|solid| **solid).count() as f32).collect();
    let size =
        median(&mut sizes).filter(|size| masks.len() >= LEAST_VIEWS && *size >= LEAST_PIXELS as f32)?;
    Some((PLENTY / size).sqrt().max(1.0))
}

/// The voters that the others do not contradict, if that is most of them; else all.
fn trusted(masks: &[SmallMask], voters: &[bool]) -> Vec<bool> {
    let count = |flags: &[bool]| flags.iter().filter(|flag| **flag).count();
    let mut trusted = voters.to_vec();
    for forgiven in LOOSE {
        let shares = uncovered(masks, &trusted, forgiven, CELLS);
        trusted.iter_mut().zip(shares).for_each(|(trusted, share)| *trusted &= share <= DISTRUSTED);
        if 2 * count(&trusted) < count(voters) {
            return voters.to_vec();
        }
    }
    trusted
}

/// How masks agree with each other, where no mesh is known; `None` for fewer than three masks.
pub(crate) fn hull_agreement(looks: &[ViewLook]) -> Option<f32> {
    consistency(&tried(looks, TRIED_VIEWS, TRIED_SIDE))
}

/// What is wrong with how masks and cameras agree, where no mesh is known. `given` is [`hull_agreement`], `complaint` what
/// [`check_masks`](crate::survey::meeting::check_masks) has to say.
pub(crate) fn of_masks(
    looks: &[ViewLook],
    given: f32,
    consensus: Option<&Consensus>,
    complaint: Option<Finding>,
) -> Option<Finding> {
    let is_suspect = consensus.map_or(given < CONSISTENT, Consensus::is_suspect);
    if !is_suspect && complaint.is_none() {
        return consensus.and_then(|found| view_finding(looks, found));
    }
    if let Some(finding) = (is_suspect || given < CONSISTENT).then(|| explained(looks, given)).flatten() {
        return Some(finding);
    }
    complaint.or_else(|| match consensus {
        Some(found) if found.is_doubtful() => Some(doubt(looks, given, found)),
        Some(found) => view_finding(looks, found),
        None => (given < INCONSISTENT).then(|| vague_doubt(given)),
    })
}

/// What is wrong with single views.
fn view_finding(looks: &[ViewLook], found: &Consensus) -> Option<Finding> {
    lacking_finding(looks, found).or_else(|| stray_finding(looks, found))
}

/// Names views whose masks lack what those of the others have.
fn lacking_finding(looks: &[ViewLook], found: &Consensus) -> Option<Finding> {
    let views: Vec<String> = found.lacking.iter().map(|i| looks[*i].name.clone()).collect();
    let problem = || {
        let views = named(&views);
        format!(
            "mask or camera disagrees with the other views in {views}: a part of the object that the others agree on is outside the mask"
        )
    };
    let help = "Correct mask or pose of the views that are named, or leave them out with `select`.";
    (!views.is_empty()).then(|| Finding::error("stray-view", views.clone(), problem(), help))
}

/// Names views that the others contradict.
fn stray_finding(looks: &[ViewLook], found: &Consensus) -> Option<Finding> {
    let strays = found.strays();
    let worst = found.uncovered[*strays.first()?]?;
    let views: Vec<String> = strays.into_iter().map(|i| looks[i].name.clone()).collect();
    let problem = format!(
        "mask or camera disagrees with the other views in {}: by their masks, {:.0} % of the mask of `{}` is empty (of the median view's \
         {:.1} %)",
        named(&views),
        100.0 * worst,
        views[0],
        100.0 * found.middle
    );
    let help = "Correct pose or mask of the views that are named, or leave them out with `select`; perhaps their photographs or poses are \
                exchanged.";
    let severity = if found.is_wrong() { Severity::Error } else { Severity::Warning };
    Some(Finding::new(severity, "stray-view", views, problem, help))
}

/// Most views disagree, and nothing that is tried explains it.
fn doubt(looks: &[ViewLook], given: f32, found: &Consensus) -> Finding {
    let share = |i: &usize| found.uncovered[*i].unwrap_or(0.0);
    let worst = (0..looks.len()).max_by(|a, b| share(a).total_cmp(&share(b)).then(b.cmp(a)));
    let worst = worst.map_or("", |i| looks[i].name.as_str());
    let problem = format!(
        "the cameras do not fit the photographs: by the other masks, {:.0} % of a mask is empty (median; most in view `{worst}`), and the \
         visual hull of all overlaps with the masks to {given:.2}",
        100.0 * found.middle
    );
    let help = "No mirror image, other axes or other order of the photographs explains it. Check that the n-th camera is that of the n-th \
                photograph, then poses, intrinsics and masks; the contact sheet of `lobelia check --out DIR` shows all of them.";
    let severity = if found.middle > WRONG * found.slack { Severity::Error } else { Severity::Warning };
    Finding::new(severity, "inconsistent-masks", Vec::new(), problem, help)
}

fn vague_doubt(given: f32) -> Finding {
    let problem = format!(
        "masks and cameras hardly agree: the visual hull of all covers {given:.2} of the masks (mean intersection over union)"
    );
    let help = "Check poses, intrinsics and masks; the contact sheet of `lobelia check --out DIR` shows all of them.";
    let severity = if given < HARDLY_ANY { Severity::Error } else { Severity::Warning };
    Finding::new(severity, "inconsistent-masks", Vec::new(), problem, help)
}

/// What would make the masks agree: other axes, a mirror image, inverted poses, or another order of the photographs.
fn explained(looks: &[ViewLook], given: f32) -> Option<Finding> {
    let views = tried(looks, TRIED_VIEWS, TRIED_SIDE);
    let left = rest(&views);
    let least = if left < SUSPECT { given + CLEARLY } else { given };
    let mut found = candidates(looks, &views, DOUBTFUL.min(BETTER * left)).into_iter().filter_map(|found| {
        let reached = consistency(&found.views).filter(|reached| *reached >= EXPLAINS.max(least))?;
        Some((found, reached))
    });
    let (Candidate { cause, rest, .. }, reached) = found.next()?;
    let other = found.next().map_or(String::new(), |other| format!("; or this: {}", other.0.cause.words));
    let problem = format!(
        "the masks agree with their visual hull to {reached:.2} instead of {given:.2} (intersection over union), and it leaves {:.1} % \
         of them uncovered instead of {:.1} %, once this is put right: {}{other}",
        100.0 * rest,
        100.0 * left,
        cause.words
    );
    let name = if cause.change == Change::Order { "other-order" } else { "other-axes" };
    Some(Finding::error(name, Vec::new(), problem, cause.help))
}

/// A cause with the views as they are without it, and their mean uncovered share.
struct Candidate {
    cause: Cause,
    views: Vec<SmallMask>,
    rest: f32,
}

/// The causes that leave at most `most` uncovered, and those alone that leave about the least; the likelier first.
fn candidates(looks: &[ViewLook], views: &[SmallMask], most: f32) -> Vec<Candidate> {
    let changed = |cause: &Cause| views.iter().map(|view| cause.change.of(view)).collect();
    let of_cameras = camera_causes().into_iter().map(|cause| {
        let views: Vec<SmallMask> = changed(&cause);
        (cause, views)
    });
    let all = of_cameras.chain(orders(looks, TRIED_VIEWS));
    let mut found: Vec<Candidate> = all
        .map(|(cause, views)| Candidate { cause, rest: rest(&views), views })
        .filter(|found| found.rest <= most)
        .collect();
    let least = found.iter().map(|found| found.rest).fold(f32::INFINITY, f32::min);
    found.retain(|found| found.rest <= least + TIE);
    found
}

/// Mean uncovered share of masks.
fn rest(views: &[SmallMask]) -> f32 {
    let shares = uncovered(views, &vec![true; views.len()], FORGIVEN, CELLS);
    shares.iter().sum::<f32>() / shares.len().max(1) as f32
}
