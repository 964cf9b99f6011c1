//! Checkpoints: what a run depends on from here on, so that a process that was killed goes on with
//! the same bits.
//!
//! A plugin says which of its resources and components are state, by name ([`keep_resource`],
//! [`keep_pool`], [`keep_keyed`], [`keep_each`]); all else is derived from these and from the scene
//! by the code that a resumed run goes through again. State is saved at the end of each pass, and
//! within a pass that takes long at the end of its parts, such as a level of a `Shape`. A part
//! begins from nothing but state: a resumed run goes through the beginning of the pass, takes up
//! the state of the part, and goes on.
//!
//! Nothing here knows of files: [`Checkpoints`] has a function that writes.

use crate::pipeline::pool::PoolIndex;
use bevy_ecs::prelude::{Component, Entity, EntityRef, Mut, Resource, With, World};
use bevy_ecs::query::QueryFilter;
use lobelia_geometry::{Error, Result, error::stop::stopped_by};
use serde::{Serialize, de::DeserializeOwned};
use std::any::type_name;
use std::time::{Duration, Instant};

/// Saved state: values as bytes, by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Saved(pub Vec<(String, Vec<u8>)>);

impl Saved {
    /// Adds a value that is of no world.
    ///
    /// # Errors
    /// If it has no serialized form.
    pub fn add<T: Serialize>(&mut self, name: &str, value: &T) -> Result<()> {
        self.0.push((name.to_owned(), to_bytes(value)?));
        Ok(())
    }

    /// Takes such a value out again.
    ///
    /// # Errors
    /// If it is not there, or is another.
    pub fn take<T: DeserializeOwned>(&mut self, name: &str) -> Result<T> {
        let at = self.0.iter().position(|(other, _)| other == name).ok_or_else(|| foreign(name))?;
        from_bytes(&self.0.swap_remove(at).1)
    }
}

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

/// Whether checkpoints are kept: not once a run was stopped, for what it writes then is not what it
/// would have found.
pub fn are_kept(world: &World) -> bool {
    stopped_by().is_none() && world.contains_resource::<Checkpoints>()
}

/// Keeps the beginning of a pass.
///
/// # Errors
/// If it cannot be written.
pub fn keep_pass(world: &mut World, pass: u32, saved: &Saved) -> Result<()> {
    let Some(mut kept) = world.get_resource_mut::<Checkpoints>() else { return Ok(()) };
    (kept.pass, kept.since, kept.ahead) = (pass, Instant::now(), None);
    (kept.write)(ResumePoint::Pass(pass), saved)
}

/// Keeps the beginning of another part of the pass at work.
///
/// # Errors
/// If it cannot be written.
pub fn keep_part(world: &mut World, saved: &Saved) -> Result<()> {
    let Some(mut kept) = world.get_resource_mut::<Checkpoints>() else { return Ok(()) };
    kept.since = Instant::now();
    let point = ResumePoint::Part(kept.pass);
    (kept.write)(point, saved)
}

/// Whether a resumed run goes on from a part of the pass at work, so that what comes before it need
/// not be found again.
pub fn has_part_ahead(world: &World) -> bool {
    world.get_resource::<Checkpoints>().is_some_and(|kept| kept.ahead.is_some())
}

/// Takes the state of the part that a resumed run goes on from.
pub fn take_part(world: &mut World) -> Option<Saved> {
    world.get_resource_mut::<Checkpoints>()?.ahead.take()
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

fn keep(world: &mut World, part: Part) {
    let kept = &mut world.get_resource_or_init::<Kept>().0;
    kept.retain(|other| other.name != part.name);
    kept.push(part);
}

/// Registers a resource.
pub fn keep_resource<R: Resource + Serialize + DeserializeOwned>(world: &mut World, span: Span) {
    let save = |world: &mut World| world.get_resource::<R>().map(to_bytes).transpose();
    let load = |world: &mut World, bytes: &[u8]| {
        world.insert_resource(from_bytes::<R>(bytes)?);
        Ok(())
    };
    keep(world, Part { name: type_name::<R>(), span, save: Box::new(save), load: Box::new(load) });
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
    let save = move |world: &mut World| {
        let values = rows(world).into_iter().map(|(.., key, value)| Some((key, value?)));
        let values: Option<Vec<(K, T)>> = values.collect();
        values.filter(|values| !values.is_empty()).map(|values| to_bytes(&values)).transpose()
    };
    let load = move |world: &mut World, bytes: &[u8]| {
        let saved: Vec<(K, T)> = from_bytes(bytes)?;
        let rows = rows(world);
        if !rows.iter().map(|(.., key, _)| key).eq(saved.iter().map(|(key, _)| key)) {
            let (found, kept) = (rows.len(), saved.len());
            return Err(foreign(&format!("{kept} values of {name} for {found} entities")));
        }
        // In the order in which a system would insert them: tables keep it, and sums over these
        // entities depend on it.
        let mut values = vec![None; rows.len()];
        for ((_, at, entity, ..), (_, value)) in rows.into_iter().zip(saved) {
            values[at] = Some((entity, value));
        }
        world.insert_batch(values.into_iter().flatten().collect::<Vec<_>>());
        Ok(())
    };
    keep(world, Part { name, span, save: Box::new(save), load: Box::new(load) });
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
fn to_bytes<T: Serialize>(value: &T) -> Result<Vec<u8>> {
    postcard::to_allocvec(value).map_err(|error| Error::run("writing a checkpoint", error.to_string()))
}

/// The value that these are the bytes of.
fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T> {
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
    fn a_part_is_ahead_until_it_is_taken_or_the_pass_is_done() {
        let mut saved = Saved::default();
        saved.add("level", &(3u32, "text")).unwrap();
        let written = Arc::new(Mutex::new(Vec::new()));
        let to = written.clone();
        let write = move |place: ResumePoint, saved: &Saved| {
            to.lock().unwrap().push((place, saved.0.len()));
            Ok(())
        };
        let mut world = World::new();
        keep_part(&mut world, &saved).unwrap();
        assert!(!is_due(&world) && !has_part_ahead(&world) && take_part(&mut world).is_none());
        world.insert_resource(Checkpoints::new(Box::new(write), Duration::ZERO, 2, Some(saved.clone())));
        assert!(is_due(&world) && has_part_ahead(&world));
        let mut part = take_part(&mut world).unwrap();
        assert_eq!(part.take::<(u32, String)>("level").unwrap(), (3, "text".to_owned()));
        assert!(part.take::<u8>("level").is_err() && !has_part_ahead(&world));
        keep_part(&mut world, &saved).unwrap();
        keep_pass(&mut world, 3, &Saved::default()).unwrap();
        keep_part(&mut world, &saved).unwrap();
        let expected = [(ResumePoint::Part(2), 1), (ResumePoint::Pass(3), 0), (ResumePoint::Part(3), 1)];
        assert_eq!(*written.lock().unwrap(), expected);
    }
}
