//! The passes of a scene, one after another; one that fails ends only what needs it.

use crate::checkpoint::{Checkpoints, begin_pass};
use crate::error::stop::{finish_stopping, stopped_by};
use crate::error::{Error, Result};
use crate::pass::evaluate;
use crate::pass::export;
use crate::pass::files::read_late;
use crate::pass::fit;
use crate::pass::lend::{LentPhotographs, hand_to_first};
use crate::pass::live::Snapshot;
use crate::pass::progress::{Moment, RecordedMessages};
use crate::pass::record::{RunRecord, RunState};
use crate::pass::render;
use crate::pass::renew::renew;
use crate::pass::resume::keep;
use crate::pass::save;
use crate::pass::session::Session;
use crate::pass::shape;
use crate::pass::summary::Reporter;
use crate::pass::view;
use crate::profile;
use crate::scene::{EditPass, Pass, RelightPass, RenderPass};
use std::io::ErrorKind;

/// The passes that are not finished, and why.
#[derive(Default)]
struct Unfinished<'a> {
    /// They failed, or need one that did.
    failed: Vec<&'a Pass>,
    /// The run was stopped before their end.
    stopped: Vec<&'a Pass>,
    /// The first error of a pass.
    first: Option<Error>,
    /// Whether later passes would end in the same way as the last.
    ends_all: bool,
}

/// Runs all passes after the first `done`, but those that need one that failed; scores and report are written after each. Once the run is
/// asked to stop, only what was found until then is written: scored, saved and exported.
///
/// # Errors
/// The first error of a pass; [`Error::Interrupted`] if the run was stopped.
pub(super) fn run(
    session: &mut Session,
    record: &mut RunRecord,
    report: &mut Reporter,
    told: &RecordedMessages,
    done: usize,
) -> Result<()> {
    let mut unfinished = Unfinished::default();
    record.said_before(told.take());
    if done > 0 {
        session.write_scores()?;
    }
    report.write(&session.out)?;
    for (index, pass) in session.scene.passes.iter().enumerate().skip(done) {
        hand_to_first(session, index)?;
        if session.leave_to_first(index) {
            // A signal from now on is for the first process.
            return unfinished.first.map_or(Ok(()), Err);
        }
        session.agree_on_stop()?;
        if unfinished.leaves_out(session, pass) {
            record.pass(index, RunState::Skipped, told.take())?;
            continue;
        }
        if unfinished.stops_before(session, pass) {
            continue;
        }
        record.pass(index, RunState::Running, Vec::new())?;
        let lent = LentPhotographs::borrow(session, index)?;
        let state = unfinished.carry_out(session, index, pass);
        lent.give_back(session);
        let _after = profile::stage("scores, report, checkpoint");
        let recorded = record.pass(index, state, told.take()).and_then(|()| write_scored(session, report));
        if unfinished.ends_all || recorded.is_err() {
            return unfinished.first.map_or(recorded, Err);
        }
        go_on_after(session, index, &unfinished)?;
    }
    unfinished.outcome()
}

/// Writes the scores so far, and the report that shows them.
fn write_scored(session: &mut Session, report: &mut Reporter) -> Result<()> {
    session.write_scores().and_then(|()| report.write(&session.out))
}

/// Begins a pass, and lets whoever watches the run look at the object before it.
fn begin(session: &mut Session, index: usize) {
    begin_pass(&mut session.pipeline.world, index as u32);
    let (passes, up, progress) = (&session.scene.passes, session.scene.up, session.progress);
    let moment = Moment::Pass { name: passes[index].name(), number: index + 1, count: passes.len() };
    let (world, surface, has_object) = (&mut session.pipeline.world, &session.surface, session.has_object);
    progress.look(moment, &mut |before| match has_object {
        true => Snapshot::copy(world, surface, up, before),
        false => Err(Error::run("the object", "nothing is found yet")),
    });
}

/// Keeps what later passes start from, and leaves what an earlier one needed.
fn go_on_after(session: &mut Session, index: usize, unfinished: &Unfinished) -> Result<()> {
    if !unfinished.failed.is_empty() {
        // A run that goes on repeats all from the first failure.
        session.pipeline.world.remove_resource::<Checkpoints>();
        return Ok(());
    }
    keep(session, index + 1)?;
    let passes = &session.scene.passes;
    let is_last = index + 1 == passes.len();
    let had_pools = matches!(passes[index], Pass::Shape(_) | Pass::Fit(_));
    if had_pools && !is_last && stopped_by().is_none() { renew(session) } else { Ok(()) }
}

impl<'a> Unfinished<'a> {
    /// Whether a pass is left out because it needs one that failed; if so, says which.
    fn leaves_out(&mut self, session: &Session, pass: &'a Pass) -> bool {
        let Some(needed) = self.failed.iter().find(|failed| needs(pass, failed)) else { return false };
        let text = format!("pass {} is left out: it needs {}", pass.name(), needed.name());
        session.progress.note(&text);
        self.failed.push(pass);
        true
    }

    /// Whether a run that is asked to stop does so before a pass.
    fn stops_before(&mut self, session: &Session, pass: &'a Pass) -> bool {
        if stopped_by().is_none() {
            return false;
        }
        let stops = !(session.has_object && writes_results(pass, &self.stopped));
        if stops {
            self.stopped.push(pass);
        } else {
            // The run may have been asked between two passes.
            finish_stopping();
        }
        stops
    }

    /// Runs pass `index`, and returns how it ended.
    fn carry_out(&mut self, session: &mut Session, index: usize, pass: &'a Pass) -> RunState {
        begin(session, index);
        let at_work = profile::pass(pass.name());
        let ended = run_pass(session, pass);
        drop(at_work);
        finish_stopping();
        let state = state_of(&ended);
        self.note(session, pass, ended);
        state
    }

    /// Notes how a pass ended.
    fn note(&mut self, session: &Session, pass: &'a Pass, ended: Result<()>) {
        let error = match ended {
            Ok(()) => return,
            Err(Error::Interrupted) => {
                self.stopped.push(pass);
                return;
            }
            Err(error) => error,
        };
        // Other processes wait for this one in vain.
        self.ends_all = ends_all(&error) || session.ranks.is_some();
        match &self.first {
            _ if self.ends_all => {}
            None => {
                session.progress.note(&format!("pass {} failed; what does not need it goes on", pass.name()));
            }
            Some(_) => session.progress.note(&format!("pass {} failed: {error}", pass.name())),
        }
        self.failed.push(pass);
        self.first.get_or_insert(error);
    }

    /// How the run ends: with the first error of a pass, or because it was stopped.
    fn outcome(self) -> Result<()> {
        let stopped = if stopped_by().is_some() { Err(Error::Interrupted) } else { Ok(()) };
        self.first.map_or(stopped, Err)
    }
}

fn state_of(ended: &Result<()>) -> RunState {
    match ended {
        Ok(()) => RunState::Finished,
        Err(Error::Interrupted) => RunState::Interrupted,
        Err(_) => RunState::Failed,
    }
}

/// Whether a pass writes what was found when a run is stopped: it takes little time, and all that it needs is there.
fn writes_results(pass: &Pass, stopped: &[&Pass]) -> bool {
    match pass {
        Pass::Save(_) | Pass::Export(_) => true,
        Pass::Evaluate(evaluate) => {
            !evaluate.scores.iter().any(|score| stopped.iter().any(|pass| pass.name() == score.pass))
        }
        _ => false,
    }
}

/// Whether a pass has nothing to work with where an earlier one failed: everything after what finds the object, scores after their
/// pictures.
fn needs(pass: &Pass, failed: &Pass) -> bool {
    match (pass, failed) {
        (_, Pass::Fit(_) | Pass::Shape(_)) => true,
        (Pass::Evaluate(evaluate), _) => evaluate.scores.iter().any(|score| score.pass == failed.name()),
        _ => false,
    }
}

/// Whether later passes would end in the same way.
fn ends_all(error: &Error) -> bool {
    match error {
        Error::Io { source, .. } => matches!(
            source.kind(),
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::ReadOnlyFilesystem
        ),
        _ => false,
    }
}

fn run_pass(session: &mut Session, pass: &Pass) -> Result<()> {
    session.watched.check_below(&read_late(session.scene, pass))?;
    match pass {
        Pass::Fit(pass) => fit::run(session, pass),
        Pass::Shape(pass) => shape::run(session, pass),
        Pass::Render(RenderPass { render, .. })
        | Pass::Edit(EditPass { render, .. })
        | Pass::Relight(RelightPass { render, .. }) => render::run(session, pass, render),
        Pass::Evaluate(pass) => evaluate::run(session, pass),
        Pass::Save(pass) => save::run(session, pass),
        Pass::Export(pass) => export::run(session, pass),
        Pass::View(pass) => view::run(session, pass),
    }
}
