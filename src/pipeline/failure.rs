//! How a system's error reaches the caller of [`Pipeline::run`](super::Pipeline::run), whichever thread it happens on.
//!
//! bevy's error handler is a plain function pointer that knows neither world nor run. So each run takes a cell of a fixed
//! table and installs the handler that writes into that cell: runs of several pipelines at once, on whatever threads their
//! executors use, do not see each other's errors.

use crate::error::Error;
use bevy_ecs::error::{BevyError, ErrorContext, ErrorHandler, FallbackErrorHandler};
use bevy_ecs::prelude::{Res, Resource, World};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Runs that can be under way at once in one process; a further one waits for its turn.
const CELLS: usize = 16;

/// What a cell holds.
#[derive(Default)]
struct Cell {
    taken: bool,
    first: Option<Error>,
}

static TABLE: Mutex<[Cell; CELLS]> = Mutex::new([const { Cell { taken: false, first: None } }; CELLS]);
static RELEASED: Condvar = Condvar::new();

fn table() -> MutexGuard<'static, [Cell; CELLS]> {
    // A panic elsewhere does not spoil the cells: each is written whole.
    TABLE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps the first error of the run that has cell `CELL`.
fn record<const CELL: usize>(error: BevyError, context: ErrorContext) {
    let ours = error.downcast_ref::<Error>().cloned();
    let error = ours.unwrap_or_else(|| Error::run(context.name().to_string(), error.to_string()));
    table()[CELL].first.get_or_insert(error);
}

const HANDLERS: [ErrorHandler; CELLS] = [
    record::<0>,
    record::<1>,
    record::<2>,
    record::<3>,
    record::<4>,
    record::<5>,
    record::<6>,
    record::<7>,
    record::<8>,
    record::<9>,
    record::<10>,
    record::<11>,
    record::<12>,
    record::<13>,
    record::<14>,
    record::<15>,
];

/// The cell of the run that is under way in this world.
#[derive(Resource, Clone, Copy)]
pub(super) struct RunCell(usize);

/// A cell that is taken for one run, and free again once dropped.
pub(super) struct Failure {
    cell: usize,
}

impl Failure {
    /// Takes a cell, waiting for a free one, and installs its handler.
    pub(super) fn watch(world: &mut World) -> Self {
        let mut cells = table();
        let cell = loop {
            match cells.iter().position(|cell| !cell.taken) {
                Some(free) => break free,
                None => cells = RELEASED.wait(cells).unwrap_or_else(PoisonError::into_inner),
            }
        };
        cells[cell] = Cell { taken: true, first: None };
        drop(cells);
        world.insert_resource(FallbackErrorHandler(HANDLERS[cell]));
        world.insert_resource(RunCell(cell));
        Self { cell }
    }

    /// The first error of the run.
    pub(super) fn first(&self) -> Option<Error> {
        table()[self.cell].first.clone()
    }
}

impl Drop for Failure {
    fn drop(&mut self) {
        table()[self.cell] = Cell::default();
        RELEASED.notify_one();
    }
}

/// Run condition of every system: none of this run has failed so far.
pub(super) fn nothing_failed(run: Option<Res<RunCell>>) -> bool {
    run.is_none_or(|run| table()[run.0].first.is_none())
}
