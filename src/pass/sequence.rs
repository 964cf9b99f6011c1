//! The passes of a scene, one after another; one that fails ends only what needs it.

use crate::error::{Error, Result};
use crate::pass::evaluate;
use crate::pass::export;
use crate::pass::fit;
use crate::pass::interrupt::check_interrupted;
use crate::pass::progress::Told;
use crate::pass::record::{RunRecord, RunState};
use crate::pass::render;
use crate::pass::save;
use crate::pass::session::Session;
use crate::pass::shape;
use crate::pass::summary::Reporter;
use crate::pass::view;
use crate::scene::{EditPass, Pass, RelightPass, RenderPass};
use std::io::ErrorKind;

/// Runs all passes, but those that need one that failed; scores and report are written after each.
///
/// # Errors
/// The first error of a pass.
pub(super) fn run(
    session: &mut Session,
    record: &mut RunRecord,
    told: &Told,
    report: &mut Reporter,
) -> Result<()> {
    let scene = session.scene;
    record.said_before(told.take());
    report.write(&session.out)?;
    let mut failed: Vec<&Pass> = Vec::new();
    let mut first = None;
    for (index, pass) in scene.passes.iter().enumerate() {
        if let Some(needed) = failed.iter().find(|failed| needs(pass, failed)) {
            let text = format!("pass {} is left out: it needs {}", pass.name(), needed.name());
            session.progress.note(&text);
            record.pass(index, RunState::Skipped, told.take())?;
            failed.push(pass);
            continue;
        }
        record.pass(index, RunState::Running, Vec::new())?;
        let ended = run_pass(session, pass);
        let recorded = record.pass(index, state_of(&ended), told.take());
        let recorded =
            recorded.and_then(|()| session.write_scores()).and_then(|()| report.write(&session.out));
        let Err(error) = ended.and_then(|()| check_interrupted()) else {
            recorded?;
            continue;
        };
        if recorded.is_err() || ends_all(&error) {
            return Err(first.unwrap_or(error));
        }
        failed.push(pass);
        match &first {
            None => {
                session.progress.note(&format!("pass {} failed; what does not need it goes on", pass.name()));
                first = Some(error);
            }
            Some(_) => session.progress.note(&format!("pass {} failed: {error}", pass.name())),
        }
    }
    first.map_or(Ok(()), Err)
}

fn state_of(ended: &Result<()>) -> RunState {
    match ended {
        Ok(()) => RunState::Finished,
        Err(Error::Interrupted) => RunState::Interrupted,
        Err(_) => RunState::Failed,
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
        Error::Interrupted => true,
        Error::Io { source, .. } => matches!(
            source.kind(),
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::ReadOnlyFilesystem
        ),
        _ => false,
    }
}

fn run_pass(session: &mut Session, pass: &Pass) -> Result<()> {
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
