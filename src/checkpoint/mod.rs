//! Checkpoints: what a run depends on from here on, so that a process that was killed goes on with the same bits.
//!
//! A plugin says which of its resources and components are state, by name ([`keep_resource`], [`keep_pool`], [`keep_keyed`],
//! [`keep_each`], [`keep_with`]); all else is derived from these and from the scene by the code that a resumed run goes through again. A run has
//! [`Place`]s at which it can be taken up: between two passes, between two levels of a pass, after a step. To go on at a step, it
//! goes through the beginning of the pass and of the level first, from their own checkpoints, because what is derived there (the pool
//! of pixels, the bricks of a field) depends on the state at that time.
//!
//! | file | holds |
//! | --- | --- |
//! | this one | [`Checkpoints`]: where a run is, when it writes, what it goes on from |
//! | [`state`] | the parts of a world that are state |
//! | [`packed`] | `serde` forms of arrays and of columns that are mostly zero |
//!
//! Nothing here knows of files: a [`Store`] does.

pub mod packed;
pub mod state;

pub use state::{Key, Span, keep_each, keep_keyed, keep_pool, keep_resource, keep_with};

use crate::error::Result;
use crate::error::stop::{is_stopping, stopped_by};
use bevy_ecs::prelude::{Resource, World};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// A place in a run at which it can be taken up, in the order of time: the beginning of a pass, of a level of it, or after a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Place {
    /// Passes that are done.
    pub pass: u32,
    /// Levels of the pass that are done; what comes before the first may count as one.
    pub level: u32,
    /// Steps of the level that are done.
    pub step: u32,
}

impl Place {
    /// The beginning of a pass.
    pub fn of_pass(pass: u32) -> Self {
        Self { pass, ..Self::default() }
    }

    /// The places whose checkpoints a resumed run goes through to get here, itself the last. A run begins without one.
    pub fn route(self) -> Vec<Self> {
        let mut way = vec![Self::of_pass(self.pass), Self { step: 0, ..self }, self];
        way.dedup();
        way.retain(|place| *place != Self::default());
        way
    }
}

/// A checkpoint: the parts of the world by name, and what the code at that place keeps beside them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    parts: Vec<(String, Vec<u8>)>,
    own: Vec<u8>,
}

/// Where checkpoints are written.
pub trait Store: Send + Sync + 'static {
    /// Writes a checkpoint, all or nothing. Those that no way to it or to the one before needs may go.
    ///
    /// # Errors
    /// If it cannot be written.
    fn write(&mut self, place: Place, checkpoint: &Checkpoint) -> Result<()>;
}

/// The share of the time that checkpoints within a pass may take is one over this.
const MOST_SHARE: u32 = 50;

/// The checkpoints of a run. Without this resource none are written.
#[derive(Resource)]
pub struct Checkpoints {
    store: Box<dyn Store>,
    /// Time between two checkpoints of steps.
    every: Duration,
    /// The last beginning of a pass or level.
    at: Place,
    due: Instant,
    /// What a resumed run has still to go through.
    ahead: VecDeque<(Place, Checkpoint)>,
}

impl Checkpoints {
    /// Checkpoints that are written into `store`, those of steps after `every` of time; a run that is resumed goes through `ahead`.
    pub fn new(store: Box<dyn Store>, every: Duration, ahead: Vec<(Place, Checkpoint)>) -> Self {
        Self { store, every, at: Place::default(), due: Instant::now() + every, ahead: ahead.into() }
    }

    fn write<T: Serialize>(&mut self, place: Place, parts: Vec<(String, Vec<u8>)>, own: &T) -> Result<()> {
        self.store.write(place, &Checkpoint { parts, own: packed::to_bytes(own)? })
    }
}

/// Says that a pass begins; no other checkpoint of the way to where a run was killed is left by then, but those within it.
pub(crate) fn begin_pass(world: &mut World, pass: u32) {
    if let Some(mut checkpoints) = world.get_resource_mut::<Checkpoints>() {
        checkpoints.at = Place::of_pass(pass);
        checkpoints.due = Instant::now() + checkpoints.every;
    }
}

/// Keeps the beginning of a pass, with what is `own` to it.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn keep_pass<T: Serialize>(world: &mut World, pass: u32, own: &T) -> Result<()> {
    keep_at(world, Span::Run, false, own, |_| Place::of_pass(pass))
}

/// Keeps the beginning of a level (from 1) of the pass at work, with what is `own` to it.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn keep_level<T: Serialize>(world: &mut World, level: u32, own: &T) -> Result<()> {
    let place = |at: Place| Place { level, step: 0, ..at };
    keep_at(world, Span::Pass, false, own, place)?;
    if let Some(mut checkpoints) = world.get_resource_mut::<Checkpoints>() {
        checkpoints.at = place(checkpoints.at);
    }
    Ok(())
}

/// Whether a checkpoint of a step is due.
pub fn is_due(world: &World) -> bool {
    world.get_resource::<Checkpoints>().is_some_and(|kept| is_stopping() || Instant::now() >= kept.due)
}

/// Keeps the state after a step of the level at work, with what is `own` to it.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn keep_step<T: Serialize>(world: &mut World, step: u32, own: &T) -> Result<()> {
    let start = Instant::now();
    keep_at(world, Span::Pass, true, own, |at| Place { step, ..at })?;
    if let Some(mut checkpoints) = world.get_resource_mut::<Checkpoints>() {
        let spent = start.elapsed();
        checkpoints.due = Instant::now() + checkpoints.every.max(MOST_SHARE * spent);
    }
    Ok(())
}

fn keep_at<T: Serialize>(
    world: &mut World,
    span: Span,
    is_whole: bool,
    own: &T,
    place: impl FnOnce(Place) -> Place,
) -> Result<()> {
    // Once a run was stopped it writes what there is, which is not what it would have found; and only a step is whole while it stops.
    let is_over = stopped_by().is_some() && !(is_whole && is_stopping());
    if is_over || !world.contains_resource::<Checkpoints>() {
        return Ok(());
    }
    let parts = state::save(world, span)?;
    let mut checkpoints = world.resource_mut::<Checkpoints>();
    let place = place(checkpoints.at);
    checkpoints.write(place, parts, own)
}

/// Whether a resumed run has a step of the level at work ahead, so that what the level starts from need not be found again.
pub(crate) fn has_step_ahead(world: &World) -> bool {
    let next = world.get_resource::<Checkpoints>().and_then(|kept| Some((kept.at, kept.ahead.front()?.0)));
    next.is_some_and(|(at, next)| next.step > 0 && Place { step: 0, ..next } == at)
}

/// Whether a resumed run has the beginning of a level of the pass at work ahead, so that what comes before it need not be found again.
pub(crate) fn has_level_ahead(world: &World) -> bool {
    let next = world.get_resource::<Checkpoints>().and_then(|kept| Some((kept.at, kept.ahead.front()?.0)));
    next.is_some_and(|(at, next)| is_level_of(at, next))
}

/// Whether `next` is the beginning of a later level of the pass that is at work at `at`.
fn is_level_of(at: Place, next: Place) -> bool {
    next.pass == at.pass && next.level > 0 && next.step == 0
}

/// Takes up the run at the beginning of a pass, if that is ahead; returns what the checkpoint has of its own. `prepare` gets the world ready
/// for the state, which lacks what is derived.
///
/// # Errors
/// If the checkpoint is not one of this world; those of `prepare`.
pub(crate) fn resume_pass<T: DeserializeOwned>(
    world: &mut World,
    prepare: impl FnOnce(&mut World, &T) -> Result<()>,
) -> Result<Option<(u32, T)>> {
    let found = resume(world, |_, next| next.level == 0 && next.step == 0, prepare)?;
    Ok(found.map(|(place, own)| (place.pass, own)))
}

/// The same at the beginning of a level of the pass at work.
///
/// # Errors
/// Those of [`resume_pass`].
pub(crate) fn resume_level<T: DeserializeOwned>(
    world: &mut World,
    prepare: impl FnOnce(&mut World, &T) -> Result<()>,
) -> Result<Option<(u32, T)>> {
    let found = resume(world, is_level_of, prepare)?;
    Ok(found.map(|(place, own)| (place.level, own)))
}

/// The same after a step of the level at work.
///
/// # Errors
/// Those of [`resume_pass`].
pub(crate) fn resume_step<T: DeserializeOwned>(world: &mut World) -> Result<Option<(u32, T)>> {
    if !has_step_ahead(world) {
        return Ok(None);
    }
    let found = resume(world, |_, _| true, |_, _: &T| Ok(()))?;
    Ok(found.map(|(place, own)| (place.step, own)))
}

fn resume<T: DeserializeOwned>(
    world: &mut World,
    is_here: impl FnOnce(Place, Place) -> bool,
    prepare: impl FnOnce(&mut World, &T) -> Result<()>,
) -> Result<Option<(Place, T)>> {
    let Some(mut checkpoints) = world.get_resource_mut::<Checkpoints>() else { return Ok(None) };
    let at = checkpoints.at;
    let here = checkpoints.ahead.pop_front_if(|(next, _)| is_here(at, *next));
    let Some((place, checkpoint)) = here else { return Ok(None) };
    checkpoints.at = Place { step: 0, ..place };
    let own: T =
        packed::from_bytes(&checkpoint.own).map_err(|_| packed::foreign("what it holds beside the world"))?;
    prepare(world, &own)?;
    state::load(world, &checkpoint.parts)?;
    Ok(Some((place, own)))
}

/// State of a world, on its way to another one or to be put back.
pub struct Carried {
    parts: Vec<(String, Vec<u8>)>,
    checkpoints: Option<Checkpoints>,
}

/// Takes up what lasts as long as `span` or longer, and the run's checkpoints, so that nothing is kept until they are put back.
///
/// # Errors
/// If state has no serialized form; no state is such.
pub fn carry(world: &mut World, span: Span) -> Result<Carried> {
    let parts = state::save(world, span)?;
    Ok(Carried { parts, checkpoints: world.remove_resource::<Checkpoints>() })
}

/// Goes on without it: only the run's checkpoints are put back.
pub(crate) fn discard(world: &mut World, carried: Carried) {
    if let Some(checkpoints) = carried.checkpoints {
        world.insert_resource(checkpoints);
    }
}

/// Puts it into another world, which has the same entities.
///
/// # Errors
/// If it has others.
pub fn restore(world: &mut World, carried: Carried) -> Result<()> {
    if let Some(checkpoints) = carried.checkpoints {
        world.insert_resource(checkpoints);
    }
    state::load(world, &carried.parts)
}

#[cfg(test)]
mod tests;
