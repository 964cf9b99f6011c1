//! Findings about masks alone: dim, soft, inverted or missing ones, and the object cut by the frame.

use crate::survey::agreement::INVERT_HELP;
use crate::survey::finding::{Finding, counted, named};
use crate::survey::look::{MaskLook, ViewLook};
use crate::view::Split;

/// Highest coverage below which a mask never says that a pixel is the object's.
const DIM: f32 = 0.9;
/// Share of soft pixels from which on a mask is no silhouette.
const SOFT: f32 = 0.5;
const MASKS_HELP: &str = "Without a mask the background counts where the object is rendered: add masks, white where the object is.";
/// A mask that covers this much of the frame's border and leaves this much of the frame is the background's.
const BORDER: f32 = 0.95;
const LEFT_OUT: f32 = 0.03;

/// Findings about the masks of all views; `scored` says whether test views are compared with their photographs, `has_mesh` whether the
/// shape is known.
pub(crate) fn of_masks(looks: &[ViewLook], scored: bool, has_mesh: bool) -> Vec<Finding> {
    let mut found = Vec::new();
    found.extend(dim(looks));
    found.extend(inverted(looks));
    found.extend(soft(looks));
    found.extend(missing(looks, has_mesh));
    if scored {
        found.extend(unscorable(looks));
    }
    found.extend(cut(looks));
    found
}

fn names(looks: &[ViewLook], is_bad: impl Fn(&ViewLook, &MaskLook) -> bool) -> Vec<String> {
    let masks = looks.iter().filter_map(|look| Some((look, look.mask.as_ref()?)));
    masks.filter(|(look, mask)| is_bad(look, mask)).map(|(look, _)| look.name.clone()).collect()
}

fn dim(looks: &[ViewLook]) -> Option<Finding> {
    let views = names(looks, |_, mask| mask.highest < DIM);
    let first = looks.iter().find(|look| views.first() == Some(&look.name))?;
    let highest = 255.0 * first.mask.as_ref()?.highest;
    let problem = format!(
        "no pixel of the mask is white in {}: the highest value is {highest:.0} of 255",
        named(&views)
    );
    let help = "Write masks with 0 for the background and 255 (in 16 bits 65535) for the object.";
    Some(Finding::error("dim-masks", views, problem, help))
}

/// Masks of the background: all around the frame, with a hole.
fn inverted(looks: &[ViewLook]) -> Option<Finding> {
    let is_inverted = |_: &ViewLook, mask: &MaskLook| mask.border > BORDER && mask.coverage < 1.0 - LEFT_OUT;
    let views = names(looks, is_inverted);
    if views.is_empty() {
        return None;
    }
    let all = looks.iter().filter(|look| look.mask.is_some()).count();
    let problem = format!("the mask looks inverted, white around the object, in {}", named(&views));
    if 2 * views.len() >= all {
        return Some(Finding::error("inverted-masks", views, problem, INVERT_HELP));
    }
    Some(Finding::warning("inverted-masks", views, problem, INVERT_HELP))
}

fn soft(looks: &[ViewLook]) -> Option<Finding> {
    let views = names(looks, |_, mask| mask.soft > SOFT && mask.highest >= DIM);
    let problem = || format!("most pixels of the mask are neither black nor white in {}", named(&views));
    let help = "Pixels count only where the mask is white: raise its contrast.";
    (!views.is_empty()).then(|| Finding::warning("soft-masks", views.clone(), problem(), help))
}

/// Views without masks. That none has one is told beside a mesh; without, it is an error of its own.
fn missing(looks: &[ViewLook], has_mesh: bool) -> Option<Finding> {
    let without = looks.iter().filter(|look| look.mask.is_none() && look.light.is_some());
    let views: Vec<String> = without.map(|look| look.name.clone()).collect();
    let has_none = looks.iter().all(|look| look.mask.is_none());
    if views.is_empty() || (has_none && !has_mesh) {
        return None;
    }
    if has_none {
        let problem = "no view has a mask: there is neither a folder of masks nor alpha";
        return Some(Finding::warning("missing-masks", Vec::new(), problem, MASKS_HELP));
    }
    let of_test = looks.iter().filter(|look| look.split == Split::Test && views.contains(&look.name)).count();
    let problem =
        format!("there is no mask in {} ({} of the test split)", named(&views), counted(of_test, "view"));
    Some(Finding::warning("missing-masks", views, problem, MASKS_HELP))
}

/// Test views of which no pixel would count in a score.
fn unscorable(looks: &[ViewLook]) -> Option<Finding> {
    let is_whole = |look: &ViewLook| look.size == [look.camera.width, look.camera.height];
    let views = names(looks, |look, mask| {
        look.split == Split::Test
            && look.light.is_some()
            && is_whole(look)
            && !mask.scorable
            && mask.highest >= DIM
    });
    let problem = || {
        format!(
            "no pixel can be scored in {}: the mask has no fully covered pixel with fully covered neighbors",
            named(&views)
        )
    };
    let help =
        "Raise the mask's contrast, leave the view out with `select`, or do not score against `Photographs`.";
    (!views.is_empty()).then(|| Finding::error("unscorable-masks", views.clone(), problem(), help))
}

/// More than half of the frames cut the object.
fn cut(looks: &[ViewLook]) -> Option<Finding> {
    let views =
        names(looks, |look, mask| mask.is_cut(&look.camera) && !mask.all_covered && mask.border < BORDER);
    let all = looks.iter().filter(|look| look.mask.is_some()).count();
    let problem = || {
        format!(
            "the frame cuts the object in {} of {all} views, for example {}",
            views.len(),
            named(&views[..1])
        )
    };
    let help = "A shape is better found from views that show the whole object: step back when photographing.";
    (2 * views.len() > all).then(|| Finding::warning("cut", views.clone(), problem(), help))
}
