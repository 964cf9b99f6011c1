//! Other orders of the photographs against the cameras: a list that is shifted or reversed.

use crate::codec::nearby::natural_order;
use crate::report::sheet::choose_evenly;
use crate::survey::change::{Cause, Change};
use crate::survey::look::{SmallMask, ViewLook};
use crate::view::Split;

/// Places by which lists are shifted at most.
const MOST_SHIFT: usize = 8;
/// Views below which no order is tried.
const LEAST_VIEWS: usize = 8;

/// Every order that is tried, as a cause, with some of the masks under the cameras that they would then have.
pub(crate) fn orders(looks: &[ViewLook], most: usize) -> Vec<(Cause, Vec<SmallMask>)> {
    let list = list(looks);
    let count = list.len();
    if count < LEAST_VIEWS {
        return Vec::new();
    }
    let shifts = (1..=MOST_SHIFT.min(count / 2)).flat_map(|by| {
        let later = (later_words(by), by);
        [later, (earlier_words(by), count - by)]
    });
    let shifted = shifts.map(|(words, by)| {
        let camera_of = move |i: usize| (i + by) % count;
        (words, chosen(&list, most, camera_of))
    });
    let reversed = ("the photographs are in the reverse order of the cameras".to_owned(), {
        chosen(&list, most, |i| count - 1 - i)
    });
    let cause = |(words, masks): (String, Option<Vec<SmallMask>>)| {
        let help = "Bring cameras and photographs into the same order: the n-th camera belongs to the n-th photograph by name. If it is the masks \
                    that are out of order, rename them.";
        Some((Cause { change: Change::Order, words, help: help.to_owned() }, masks?))
    };
    std::iter::once(reversed).chain(shifted).filter_map(cause).collect()
}

fn later_words(by: usize) -> String {
    format!("each photograph has the camera of the one {} before it", places(by))
}

fn earlier_words(by: usize) -> String {
    format!("each photograph has the camera of the one {} after it", places(by))
}

fn places(by: usize) -> String {
    if by == 1 { "1 place".to_owned() } else { format!("{by} places") }
}

/// The views of one list of photographs in their order: all, where test views were held out of the same list, else the training views.
fn list(looks: &[ViewLook]) -> Vec<&ViewLook> {
    let mut all: Vec<&ViewLook> = looks.iter().collect();
    all.sort_by(|a, b| natural_order(&a.name, &b.name));
    let changes = all.windows(2).filter(|pair| pair[0].split != pair[1].split).count();
    let told_apart = looks.iter().any(|look| look.name.starts_with("train/"));
    if changes > 1 && !told_apart {
        return all;
    }
    looks.iter().filter(|look| look.split == Split::Train).collect()
}

/// Masks, evenly chosen, with the camera of another view of the list. `None` if sizes differ, or masks are missing.
fn chosen(list: &[&ViewLook], most: usize, camera_of: impl Fn(usize) -> usize) -> Option<Vec<SmallMask>> {
    let of = |i: usize| {
        let mut mask = list[i].mask.as_ref().filter(|mask| !mask.all_covered)?.small.clone();
        let other = &list[camera_of(i)].mask.as_ref()?.small.camera;
        let is_same = (mask.camera.width, mask.camera.height) == (other.width, other.height);
        mask.camera.world_from_camera = other.world_from_camera;
        is_same.then_some(mask)
    };
    choose_evenly(list.len(), most).into_iter().map(of).collect()
}
