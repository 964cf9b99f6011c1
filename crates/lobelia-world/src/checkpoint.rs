//! Checkpoints: what a run depends on from here on, so that a process that was killed goes on with
//! the same bits.
//!
//! A plugin says which of its resources and components are state, by name ([`keep_resource`],
//! [`keep_pool`], [`keep_keyed`], [`keep_each`], and [`keep_state`] for what more hangs on); all else is derived from these and from the scene
//! by the code that a resumed run goes through again. State is saved at the end of each pass, and
//! within a pass that takes long at the end of its parts, such as a level of a `Shape`. A part
//! begins from nothing but state: a resumed run goes through the beginning of the pass, takes up
//! the state of the part, and goes on.
//!
//! Nothing here knows of files: [`Checkpoints`] has a function that writes.

use crate::pipeline::pool::PoolIndex;
use bevy_ecs::prelude::{Component, Entity, EntityRef, Mut, Resource, With, World};
use bevy_ecs::query::QueryFilter;
use lobelia_geometry::{Error, Result, error::stop::was_asked_to_stop};
use serde::{Serialize, de::DeserializeOwned};
use std::any::type_name;
use std::time::{Duration, Instant};

/// Saved state: values as bytes, by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Saved(pub Vec<(String, Vec<u8>)>);

/// The point of a run that a checkpoint resumes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResumePoint {
    /// The beginning of a pass, by its number.
    Pass(u32),
    /// The beginning of a part of this pass after its first.
    Part(u32),
}

/// A function that writes checkpoints.
pub type Write = Box<dyn FnMut(ResumePoint, &Saved) -> Result<()> + Send + Sync>;

/// The checkpoints of a run. Without this resource none are written.
#[derive(Resource)]
pub struct Checkpoints {
    write: Write,
    /// The pass at work.
    pass: u32,
    /// Time between two checkpoints where a pass may end a part at any time.
    every: Duration,
    since: Instant,
    /// The part of the pass at work that a resumed run goes on from.
    ahead: Option<Saved>,
}

impl Checkpoints {
    /// Checkpoints of a run that begins with `pass`, or goes on from a part of it. One in the
    /// middle of a part is due after `every`.
    pub fn new(write: Write, every: Duration, pass: u32, ahead: Option<Saved>) -> Self {
        Self { write, pass, every, since: Instant::now(), ahead }
    }
}

/// Whether the last checkpoint is so long ago that a part may end.
pub fn is_due(world: &World) -> bool {
    world.get_resource::<Checkpoints>().is_some_and(|kept| kept.since.elapsed() >= kept.every)
}

/// Keeps the beginning of a pass, if checkpoints are kept.
///
/// # Errors
/// If it cannot be written.
pub fn keep_pass(world: &mut World, pass: u32) -> Result<()> {
    keep_at(world, ResumePoint::Pass(pass))
}

/// Keeps the beginning of another part of the pass at work, if checkpoints are kept.
///
/// # Errors
/// If it cannot be written.
pub fn keep_part(world: &mut World) -> Result<()> {
    let pass = world.get_resource::<Checkpoints>().map_or(0, |kept| kept.pass);
    keep_at(world, ResumePoint::Part(pass))
}

/// None is kept once a run was stopped, for what it finds then is not what it would have found.
fn keep_at(world: &mut World, point: ResumePoint) -> Result<()> {
    if was_asked_to_stop() || !world.contains_resource::<Checkpoints>() {
        return Ok(());
    }
    let saved = save(world, if matches!(point, ResumePoint::Pass(_)) { Span::Run } else { Span::Pass })?;
    let mut kept = world.resource_mut::<Checkpoints>();
    if let ResumePoint::Pass(pass) = point {
        (kept.pass, kept.ahead) = (pass, None);
    }
    kept.since = Instant::now();
    (kept.write)(point, &saved)
}

/// Whether a resumed run goes on from a part of the pass at work, so that what comes before it need
/// not be found again.
pub fn has_part_ahead(world: &World) -> bool {
    world.get_resource::<Checkpoints>().is_some_and(|kept| kept.ahead.is_some())
}

/// Loads the state of the part that a resumed run goes on from, once; returns whether there is one.
///
/// # Errors
/// As [`load`].
pub fn resume_part(world: &mut World) -> Result<bool> {
    let part = world.get_resource_mut::<Checkpoints>().and_then(|mut kept| kept.ahead.take());
    part.map_or(Ok(false), |part| load(world, &part).map(|()| true))
}

/// The time that state lasts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Span {
    /// From one pass to the next.
    Run,
    /// Within a pass alone: the next one sets it again.
    Pass,
}

type Save = dyn Fn(&mut World) -> Result<Option<Vec<u8>>> + Send + Sync;
type Load = dyn Fn(&mut World, &[u8]) -> Result<()> + Send + Sync;

/// A part of a world that is state.
struct Part {
    name: &'static str,
    span: Span,
    /// Saves it; `None` if the world does not have it.
    save: Box<Save>,
    /// Puts it back.
    load: Box<Load>,
}

/// The parts of a world that are state.
#[derive(Resource, Default)]
struct Kept(Vec<Part>);

/// Registers state that is neither a resource nor a component, or that more hangs on: `load` makes
/// the world what it was when `save` returned these bytes. Parts are loaded in the order in which
/// they were registered.
pub fn keep_state(
    world: &mut World,
    name: &'static str,
    span: Span,
    save: impl Fn(&mut World) -> Result<Option<Vec<u8>>> + Send + Sync + 'static,
    load: impl Fn(&mut World, &[u8]) -> Result<()> + Send + Sync + 'static,
) {
    let kept = &mut world.get_resource_or_init::<Kept>().0;
    kept.retain(|other| other.name != name);
    kept.push(Part { name, span, save: Box::new(save), load: Box::new(load) });
}

/// Registers a resource.
pub fn keep_resource<R: Resource + Serialize + DeserializeOwned>(world: &mut World, span: Span) {
    let save = |world: &mut World| world.get_resource::<R>().map(to_bytes).transpose();
    let load = |world: &mut World, bytes: &[u8]| {
        world.insert_resource(from_bytes::<R>(bytes)?);
        Ok(())
    };
    keep_state(world, type_name::<R>(), span, save, load);
}

/// A component that can be saved.
pub trait StateComponent: Component + Copy + Serialize + DeserializeOwned {}

impl<T: Component + Copy + Serialize + DeserializeOwned> StateComponent for T {}

/// Registers a component of the entities of a pool.
pub fn keep_pool<I: PoolIndex, T: StateComponent>(world: &mut World, span: Span) {
    keep_component::<T, With<I>, _, _>(world, type_name::<(I, T)>(), span, |entity| {
        (entity.get::<I>().map(I::row), ())
    });
}

/// Registers a component of a few entities that a filter selects, by a number `K` that is the same
/// in every run of a scene, such as that of a base material: it does not matter in which order they
/// are spawned.
pub fn keep_keyed<K: StateComponent + Ord, T: StateComponent, F: QueryFilter + 'static>(
    world: &mut World,
    span: Span,
) {
    keep_component::<T, F, _, _>(world, type_name::<(K, T, F)>(), span, |entity| {
        let key = entity.get::<K>().copied();
        (key, key)
    });
}

/// Registers a component of a few entities that a filter selects and that nothing tells apart, such
/// as light lobes. They are known by the order in which they were spawned: a run that is resumed
/// must spawn them in that order, before anything is found, and never sort them.
pub fn keep_each<T: StateComponent, F: QueryFilter + 'static>(world: &mut World, span: Span) {
    keep_component::<T, F, _, _>(world, type_name::<(T, F)>(), span, |entity| (entity.id(), ()));
}

/// Registers a component of the entities that `F` selects. `key` gives the order in which their
/// values are saved, and what of it is saved beside a value, to be the same again when it is
/// loaded.
fn keep_component<T, F, O, K>(world: &mut World, name: &'static str, span: Span, key: fn(EntityRef) -> (O, K))
where
    T: StateComponent,
    F: QueryFilter + 'static,
    O: Ord + 'static,
    K: PartialEq + Serialize + DeserializeOwned + 'static,
{
    let rows = move |world: &mut World| {
        let mut rows: Vec<(O, usize, Entity, K, Option<T>)> = Vec::new();
        for (at, entity) in world.query_filtered::<EntityRef, F>().iter(world).enumerate() {
            let (order, key) = key(entity);
            rows.push((order, at, entity.id(), key, entity.get::<T>().copied()));
        }
        rows.sort_by(|a, b| a.0.cmp(&b.0));
        rows
    };
    // With those that have no value: a component may mark some.
    let save = move |world: &mut World| {
        let values: Vec<(K, Option<T>)> =
            rows(world).into_iter().map(|(.., key, value)| (key, value)).collect();
        let has_any = values.iter().any(|(_, value)| value.is_some());
        has_any.then(|| to_bytes(&values)).transpose()
    };
    let load = move |world: &mut World, bytes: &[u8]| {
        let saved: Vec<(K, Option<T>)> = from_bytes(bytes)?;
        let rows = rows(world);
        if !rows.iter().map(|(.., key, _)| key).eq(saved.iter().map(|(key, _)| key)) {
            let (found, kept) = (rows.len(), saved.len());
            return Err(foreign(&format!("{kept} values of {name} for {found} entities")));
        }
        // In the order in which a system would insert them: tables keep it, and sums over these
        // entities depend on it.
        let mut values = vec![None; rows.len()];
        for ((_, at, entity, ..), (_, value)) in rows.into_iter().zip(saved) {
            values[at] = value.map(|value| (entity, value));
        }
        world.insert_batch(values.into_iter().flatten().collect::<Vec<_>>());
        Ok(())
    };
    keep_state(world, name, span, save, load);
}

/// The state of this span and of longer ones.
///
/// # Errors
/// If state has no serialized form; no state is such.
pub fn save(world: &mut World, span: Span) -> Result<Saved> {
    let mut saved = Saved::default();
    world.init_resource::<Kept>();
    world.resource_scope(|world, kept: Mut<Kept>| {
        for part in kept.0.iter().filter(|part| part.span <= span) {
            saved.0.extend((part.save)(world)?.map(|bytes| (part.name.to_owned(), bytes)));
        }
        Ok(saved)
    })
}

/// Puts saved state back into a world that has it registered.
///
/// # Errors
/// If the world has other entities than the one that it is of.
pub fn load(world: &mut World, saved: &Saved) -> Result<()> {
    world.init_resource::<Kept>();
    world.resource_scope(|world, kept: Mut<Kept>| {
        saved.0.iter().try_for_each(|(name, bytes)| {
            let part = kept.0.iter().find(|part| part.name == name).ok_or_else(|| foreign(name))?;
            (part.load)(world, bytes)
        })
    })
}

/// A value as bytes, in postcard's format.
///
/// # Errors
/// If it has no serialized form.
pub fn to_bytes<T: Serialize>(value: &T) -> Result<Vec<u8>> {
    postcard::to_allocvec(value).map_err(|error| Error::run("writing a checkpoint", error.to_string()))
}

/// The value that these are the bytes of.
///
/// # Errors
/// If they are those of another.
pub fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T> {
    match postcard::take_from_bytes(bytes) {
        Ok((value, [])) => Ok(value),
        Ok(_) => Err(Error::run("reading a checkpoint", "there is more")),
        Err(error) => Err(Error::run("reading a checkpoint", error.to_string())),
    }
}

/// The error for a checkpoint whose bytes are right and that does not fit the world all the same.
fn foreign(part: &str) -> Error {
    Error::run("resuming", format!("the checkpoint does not fit this run: {part}; start again with --force"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::pool::pool_index;
    use serde::Deserialize;
    use std::sync::{Arc, Mutex};

    pool_index! {
        /// A row.
        Row("row");
    }

    #[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
    struct Height(f32);

    #[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
    struct Weight(f32);

    #[derive(Component)]
    struct Lamp;

    /// Key of lamps of another kind.
    #[derive(Component, Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
    struct Number(u8);

    #[derive(Resource, Debug, PartialEq, Serialize, Deserialize)]
    struct Sums(Vec<f32>);

    /// A world in which nothing is found yet.
    fn world(rows: u32) -> World {
        let mut world = World::new();
        world.spawn_batch((0..rows).map(|row| (Row(row), Height(0.0))).collect::<Vec<_>>());
        world.spawn_batch(vec![Lamp, Lamp]);
        world.insert_resource(Sums(vec![0.0; 5]));
        keep_pool::<Row, Height>(&mut world, Span::Run);
        keep_each::<Weight, With<Lamp>>(&mut world, Span::Run);
        keep_resource::<Sums>(&mut world, Span::Pass);
        world
    }

    /// Finds something.
    fn work(world: &mut World) {
        let mut rows = world.query::<(&Row, &mut Height)>();
        rows.iter_mut(world).for_each(|(row, mut value)| value.0 = row.0 as f32 + 0.1);
        let lamps: Vec<Entity> = world.query_filtered::<Entity, With<Lamp>>().iter(world).collect();
        for (lamp, weight) in lamps.into_iter().zip([3.0, f32::NEG_INFINITY]) {
            world.entity_mut(lamp).insert(Weight(weight));
        }
        world.resource_mut::<Sums>().0[3] = 7.5;
    }

    fn found(world: &mut World) -> (Vec<(u32, f32)>, Vec<Weight>, Vec<f32>) {
        let mut rows: Vec<(u32, f32)> =
            world.query::<(&Row, &Height)>().iter(world).map(|(row, value)| (row.0, value.0)).collect();
        rows.sort_by_key(|row| row.0);
        let weights = world.query::<&Weight>().iter(world).copied().collect();
        (rows, weights, world.resource::<Sums>().0.clone())
    }

    #[test]
    fn saved_state_is_the_same_in_another_world() {
        let mut first = world(4);
        work(&mut first);
        let (of_run, of_pass) = (save(&mut first, Span::Run).unwrap(), save(&mut first, Span::Pass).unwrap());
        let (mut second, (rows, weights, sums)) = (world(4), found(&mut first));
        load(&mut second, &of_run).unwrap();
        assert_eq!(found(&mut second), (rows.clone(), weights.clone(), vec![0.0; 5]), "sums last for a pass");
        load(&mut second, &of_pass).unwrap();
        assert_eq!(found(&mut second), (rows, weights, sums));
    }

    #[test]
    fn state_of_another_world_is_refused() {
        let mut first = world(4);
        work(&mut first);
        let saved = save(&mut first, Span::Pass).unwrap();
        let refused = |mut world: World| {
            let error = load(&mut world, &saved).unwrap_err();
            assert!(error.to_string().contains("does not fit this run"), "{error}");
        };
        refused(world(5));
        let mut more = world(4);
        more.spawn(Lamp);
        refused(more);
        refused(World::new());
        for length in 0..saved.0[0].1.len() {
            let cut = Saved(vec![(saved.0[0].0.clone(), saved.0[0].1[..length].to_vec())]);
            assert!(load(&mut world(4), &cut).is_err(), "{length} bytes");
        }
    }

    #[test]
    fn entities_with_a_number_are_found_by_it_in_any_order() {
        let numbered = |numbers: &[u8]| {
            let mut world = World::new();
            world.spawn_batch(numbers.iter().map(|number| Number(*number)).collect::<Vec<_>>());
            keep_keyed::<Number, Height, With<Number>>(&mut world, Span::Run);
            world
        };
        let mut first = numbered(&[0, 1, 2, 5]);
        let mut numbers = first.query::<(Entity, &Number)>();
        let pairs: Vec<_> = numbers.iter(&first).map(|(entity, number)| (entity, *number)).collect();
        for (entity, number) in pairs {
            first.entity_mut(entity).insert(Height(f32::from(number.0)));
        }
        let saved = save(&mut first, Span::Run).unwrap();
        let mut second = numbered(&[2, 0, 5, 1]);
        load(&mut second, &saved).unwrap();
        let mut values = second.query::<(&Number, &Height)>();
        assert_eq!(values.iter(&second).len(), 4);
        assert!(values.iter(&second).all(|(number, value)| value.0 == f32::from(number.0)));
        for others in [[0, 1, 2, 4].as_slice(), &[0, 1, 2], &[0, 1, 2, 5, 5], &[0, 1, 2, 2]] {
            let error = load(&mut numbered(others), &saved).unwrap_err();
            assert!(error.to_string().contains("does not fit this run"), "{others:?}: {error}");
        }
    }

    #[test]
    fn a_component_of_some_rows_marks_the_same_ones_again() {
        let marked = |rows: &[u32]| {
            let mut world = world(4);
            keep_pool::<Row, Weight>(&mut world, Span::Run);
            let mut all = world.query::<(Entity, &Row)>();
            let found: Vec<Entity> =
                all.iter(&world).filter(|(_, row)| rows.contains(&row.0)).map(|(row, _)| row).collect();
            found.into_iter().for_each(|row| _ = world.entity_mut(row).insert(Weight(1.0)));
            world
        };
        let saved = save(&mut marked(&[1, 3]), Span::Run).unwrap();
        let mut second = marked(&[]);
        load(&mut second, &saved).unwrap();
        let mut marks = second.query_filtered::<&Row, With<Weight>>();
        let mut rows: Vec<u32> = marks.iter(&second).map(|row| row.0).collect();
        rows.sort_unstable();
        assert_eq!(rows, [1, 3]);
    }

    #[test]
    fn a_part_is_ahead_until_it_is_taken_or_the_pass_is_done() {
        let written = Arc::new(Mutex::new(Vec::new()));
        let to = written.clone();
        let write = move |place: ResumePoint, saved: &Saved| {
            to.lock().unwrap().push((place, saved.0.len()));
            Ok(())
        };
        let mut first = world(4);
        work(&mut first);
        let saved = save(&mut first, Span::Pass).unwrap();
        let mut world = world(4);
        keep_part(&mut world).unwrap();
        assert!(!is_due(&world) && !has_part_ahead(&world) && !resume_part(&mut world).unwrap());
        world.insert_resource(Checkpoints::new(Box::new(write), Duration::ZERO, 2, Some(saved)));
        assert!(is_due(&world) && has_part_ahead(&world));
        assert!(resume_part(&mut world).unwrap() && !has_part_ahead(&world));
        assert_eq!(found(&mut world), found(&mut first));
        keep_part(&mut world).unwrap();
        keep_pass(&mut world, 3).unwrap();
        keep_part(&mut world).unwrap();
        let expected = [(ResumePoint::Part(2), 3), (ResumePoint::Pass(3), 2), (ResumePoint::Part(3), 3)];
        assert_eq!(*written.lock().unwrap(), expected);
    }
}
