//! Propagation of errors of systems to the caller of [`Pipeline::run`](super::Pipeline::run), from any thread.
//!
//! bevy's error handler is a function pointer without access to the world or the run. So each run reserves a cell of a fixed
//! table and installs the handler that writes to that cell: concurrent runs of several pipelines, on any threads of their
//! executors, do not see each other's errors.

use crate::error::Error;
use bevy_ecs::error::{BevyError, ErrorContext, ErrorHandler, FallbackErrorHandler};
use bevy_ecs::prelude::{Res, Resource, World};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Most concurrent runs in one process; further runs wait, those inside other runs as well.
const CELLS: usize = 16;

/// The contents of a cell.
#[derive(Default)]
struct Cell {
    taken: bool,
    first: Option<Error>,
}

static TABLE: Mutex<[Cell; CELLS]> = Mutex::new([const { Cell { taken: false, first: None } }; CELLS]);
static RELEASED: Condvar = Condvar::new();

fn table() -> MutexGuard<'static, [Cell; CELLS]> {
    // A panic in another thread does not corrupt the cells: each is written completely.
    TABLE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Stores the first error of the run with cell `CELL`.
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

/// The cell of the current run in this world.
#[derive(Resource, Clone, Copy)]
pub(super) struct RunCell(usize);

/// A run that is watched: the world has a cell's handler while this lives, and what it had before when this is dropped.
pub(super) struct Failure<'w> {
    pub(super) world: &'w mut World,
    cell: usize,
    handler_before: Option<FallbackErrorHandler>,
    cell_before: Option<RunCell>,
}

impl<'w> Failure<'w> {
    /// Reserves a cell, waits if none is free, and installs its handler.
    pub(super) fn watch(world: &'w mut World) -> Self {
        let mut cells = table();
        let cell = loop {
            match cells.iter().position(|cell| !cell.taken) {
                Some(free) => break free,
                None => cells = RELEASED.wait(cells).unwrap_or_else(PoisonError::into_inner),
            }
        };
        cells[cell] = Cell { taken: true, first: None };
        drop(cells);
        let handler_before = world.remove_resource::<FallbackErrorHandler>();
        let cell_before = world.remove_resource::<RunCell>();
        world.insert_resource(FallbackErrorHandler(HANDLERS[cell]));
        world.insert_resource(RunCell(cell));
        Self { world, cell, handler_before, cell_before }
    }

    /// The first error of the run.
    pub(super) fn first(&self) -> Option<Error> {
        table()[self.cell].first.clone()
    }
}

impl Drop for Failure<'_> {
    fn drop(&mut self) {
        put_back(self.world, self.handler_before.take());
        put_back(self.world, self.cell_before.take());
        table()[self.cell] = Cell::default();
        RELEASED.notify_one();
    }
}

/// Gives the world the resource that it had before, or none.
fn put_back<R: Resource>(world: &mut World, before: Option<R>) {
    match before {
        Some(before) => world.insert_resource(before),
        None => _ = world.remove_resource::<R>(),
    }
}

/// Run condition of every system: no system has failed in this run.
pub(super) fn nothing_failed(run: Option<Res<RunCell>>) -> bool {
    run.is_none_or(|run| table()[run.0].first.is_none())
}
