//! Reading of the photographs of a data set; several processes each read a share, and send it to the others.
//!
//! | name | unit | value | meaning |
//! | --- | --- | --- | --- |
//! | [`AT_A_TIME`] | | 32 | views that are read before the processes exchange them |

use crate::checkpoint::packed::{from_bytes, to_bytes};
use crate::dataset::{LoadedView, PlannedView, load_notes};
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::pass::progress::Progress;
use crate::ranks::Ranks;
use crate::scene::{Pass, Scene, Surface};
use crate::survey::open::OpenScene;
use crate::survey::{Severity, Survey, ViewLook};
use crate::view::ViewRecord;
use rayon::prelude::*;

/// Views that are read before the processes exchange them: only these are in memory several times. More with more than so many processes.
const AT_A_TIME: usize = 32;

/// A view, and what a survey keeps of it.
type ReadView = (LoadedView, Option<ViewLook>);

/// Reads the views of a data set that is open, and surveys those that passes learn from or are scored against: a warning is a note, the first
/// error ends the run.
///
/// # Errors
/// [`Error::Usage`](crate::Error::Usage) for the first thing that cannot work; those of reading photographs and masks; if another process is gone.
pub(super) fn read_data(
    scene: &Scene,
    open: &OpenScene,
    ranks: Option<&Ranks>,
    progress: &dyn Progress,
) -> Result<(Vec<ViewRecord>, Option<Survey>)> {
    let learns = |pass: &Pass| matches!(pass, Pass::Fit(_) | Pass::Shape(_) | Pass::Evaluate(_));
    let is_used = matches!(scene.surface, Surface::Unknown { .. }) || scene.passes.iter().any(learns);
    let bar = progress.bar("photographs", open.views.len() as u64);
    let read = |view: &PlannedView| {
        check_interrupted()?;
        let loaded = open.load(view)?;
        let look = is_used.then(|| open.look(view, &loaded, false));
        bar.inc(1);
        Ok((loaded, look))
    };
    let read = match ranks {
        None => read_all(&open.views, read)?,
        Some(ranks) => {
            let views = read_shares(&open.views, ranks, read, || bar.inc(1))?;
            let sent = ranks.take_traffic().of_shares;
            let (count, mb) = (ranks.size(), sent.bytes as f64 / 1e6);
            progress.print(&format!(
                "photographs: read by {count} processes; each received {mb:.1} MB, in {:.1} s with waiting",
                sent.seconds
            ));
            views
        }
    };
    let (loaded, looks): (Vec<LoadedView>, Vec<Option<ViewLook>>) = read.into_iter().unzip();
    bar.finish_and_clear();
    open.notes.iter().chain(&load_notes(&loaded)).for_each(|note| progress.note(note));
    let looks = looks.into_iter().flatten().collect();
    let survey = is_used.then(|| surveyed(open, looks, progress)).transpose()?;
    Ok((loaded.into_iter().map(|view| view.record).collect(), survey))
}

/// The survey of what was looked at; its warnings are told, its first error is one.
fn surveyed(open: &OpenScene, looks: Vec<ViewLook>, progress: &dyn Progress) -> Result<Survey> {
    let survey = open.examine(looks)?;
    survey.findings_of(Severity::Warning).for_each(|warning| progress.note(&warning.problem));
    let error = survey.findings_of(Severity::Error).next().map(|error| error.to_error());
    error.map_or(Ok(survey), Err)
}

/// Reads views on all threads; the first error, in their order, ends it.
fn read_all<T: Send>(
    views: &[PlannedView],
    read: impl Fn(&PlannedView) -> Result<T> + Sync + Send,
) -> Result<Vec<T>> {
    let read: Vec<Result<T>> = views.par_iter().map(read).collect();
    read.into_iter().collect()
}

/// Reads a share of the views and gets the others from those that read them; `arrived` is told of each of these. A view is the same, bit by bit, whoever has read it.
fn read_shares(
    views: &[PlannedView],
    ranks: &Ranks,
    read: impl Fn(&PlannedView) -> Result<ReadView> + Sync + Send,
    arrived: impl Fn() + Sync + Send,
) -> Result<Vec<ReadView>> {
    let said = ranks.join_lists(&[to_bytes(&views.len())?], ranks.size())?;
    if said.iter().any(|other| *other != said[0]) {
        return Err(other_data("numbers of views"));
    }
    let mut all = Vec::with_capacity(views.len());
    for views in views.chunks(AT_A_TIME.max(ranks.size())) {
        let own = ranks.share(views.len(), 1);
        let own_views = read_all(&views[own.clone()], |view| {
            let read = read(view)?;
            Ok((to_bytes(&read)?, read))
        })?;
        let (bytes, own_views): (Vec<Vec<u8>>, Vec<ReadView>) = own_views.into_iter().unzip();
        let lists = ranks.join_lists(&bytes, views.len())?;
        // All know by now whether one of them is asked to stop.
        check_interrupted()?;
        let received = |(planned, bytes): (&PlannedView, &Vec<u8>)| {
            let read: Option<ReadView> = from_bytes(bytes).ok();
            let same = read.filter(|(loaded, _)| loaded.record.name == planned.name());
            let mut read = same.ok_or_else(|| other_data(planned.name()))?;
            read.0.share_tables(planned);
            arrived();
            Ok(read)
        };
        let of = |range: std::ops::Range<usize>| -> Result<Vec<ReadView>> {
            let read: Vec<Result<ReadView>> =
                views[range.clone()].par_iter().zip(&lists[range]).map(received).collect();
            read.into_iter().collect()
        };
        all.extend(of(0..own.start)?);
        all.extend(own_views);
        all.extend(of(own.end..views.len())?);
    }
    Ok(all)
}

/// What was received is of another data set.
fn other_data(what: &str) -> Error {
    let problem =
        format!("the processes have different data sets, or programs of different versions ({what})");
    Error::run("sending photographs between processes", problem)
}
