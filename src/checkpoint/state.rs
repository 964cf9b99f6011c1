//! The parts of a world that are state: registered by name, saved as bytes, put back.

use crate::checkpoint::packed::{self, foreign};
use crate::error::Result;
use crate::pipeline::pool::PoolIndex;
use bevy_ecs::prelude::{Component, Entity, Resource, World};
use bevy_ecs::query::QueryFilter;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::any::type_name;

/// How long a part is state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Span {
    /// From one pass to the next.
    Run,
    /// Within a pass alone: the next one sets it again.
    Pass,
}

/// Saves a part; `None` if the world does not have it.
pub type Save = fn(&mut World) -> Result<Option<Vec<u8>>>;
/// Puts a part back.
pub(crate) type Load = fn(&mut World, &[u8]) -> Result<()>;

struct Part {
    name: &'static str,
    span: Span,
    save: Save,
    load: Load,
}

/// The parts of a world that are state.
#[derive(Resource, Default)]
struct Kept(Vec<Part>);

/// Registers a part with functions of its own. One of the same name is replaced.
pub fn keep_with(world: &mut World, name: &'static str, span: Span, save: Save, load: Load) {
    forget(world, name);
    world.resource_mut::<Kept>().0.push(Part { name, span, save, load });
}

/// Takes a part out again.
pub(super) fn forget(world: &mut World, name: &str) {
    world.get_resource_or_init::<Kept>().0.retain(|part| part.name != name);
}

/// Registers a resource.
pub fn keep_resource<R: Resource + Serialize + DeserializeOwned>(world: &mut World, span: Span) {
    let save: Save = |world| world.get_resource::<R>().map(packed::to_bytes).transpose();
    let load: Load = |world, bytes| {
        world.insert_resource(packed::from_bytes::<R>(bytes)?);
        Ok(())
    };
    keep_with(world, type_name::<R>(), span, save, load);
}

/// Registers a component of the entities of a pool.
pub fn keep_pool<I: PoolIndex, T>(world: &mut World, span: Span)
where
    T: Component + Copy + Serialize + DeserializeOwned,
{
    keep_with(world, type_name::<(I, T)>(), span, save_pool::<I, T>, load_pool::<I, T>);
}

/// What entities of a few are known by: a number that is the same in every run of a scene, such as that of a base material.
pub trait Key: Component + Copy + Ord + Serialize + DeserializeOwned {}

impl<K: Component + Copy + Ord + Serialize + DeserializeOwned> Key for K {}

/// Registers a component of a few entities that a filter selects, by their [`Key`] `K`: it does not matter in which order they are spawned.
pub fn keep_keyed<K: Key, T, F: QueryFilter + 'static>(world: &mut World, span: Span)
where
    T: Component + Copy + Serialize + DeserializeOwned,
{
    keep_with(world, type_name::<(K, T, F)>(), span, save_keyed::<K, T, F>, load_keyed::<K, T, F>);
}

/// Registers a component of a few entities that a filter selects and that nothing tells apart, such as light lobes. They are known by the
/// order in which they were spawned: a run that is resumed must spawn them in that order, before anything is found, and never sort them.
pub fn keep_each<T, F: QueryFilter + 'static>(world: &mut World, span: Span)
where
    T: Component + Copy + Serialize + DeserializeOwned,
{
    keep_with(world, type_name::<(T, F)>(), span, save_each::<T, F>, load_each::<T, F>);
}

fn save_pool<I: PoolIndex, T: Component + Copy + Serialize>(world: &mut World) -> Result<Option<Vec<u8>>> {
    let mut rows: Vec<(usize, T)> =
        world.query::<(&I, &T)>().iter(world).map(|(index, value)| (index.row(), *value)).collect();
    rows.sort_by_key(|(row, _)| *row);
    let values: Vec<T> = rows.into_iter().map(|(_, value)| value).collect();
    if values.is_empty() { Ok(None) } else { packed::to_bytes(&values).map(Some) }
}

fn load_pool<I: PoolIndex, T: Component + DeserializeOwned>(world: &mut World, bytes: &[u8]) -> Result<()> {
    let values: Vec<T> = packed::from_bytes(bytes)?;
    let mut rows: Vec<(usize, Entity)> =
        world.query::<(&I, Entity)>().iter(world).map(|(index, entity)| (index.row(), entity)).collect();
    rows.sort_unstable();
    if rows.len() != values.len() {
        return Err(foreign(&format!("{} values for {} of pool {}", values.len(), rows.len(), I::NAME)));
    }
    // In the order of the pool, so that its tables keep it.
    world.insert_batch(rows.into_iter().map(|(_, entity)| entity).zip(values).collect::<Vec<_>>());
    Ok(())
}

fn save_keyed<K: Key, T: Component + Copy + Serialize, F: QueryFilter>(
    world: &mut World,
) -> Result<Option<Vec<u8>>> {
    let mut query = world.query_filtered::<(&K, Option<&T>), F>();
    let each: Option<Vec<(K, T)>> =
        query.iter(world).map(|(key, value)| value.map(|value| (*key, *value))).collect();
    let Some(mut each) = each.filter(|each| !each.is_empty()) else { return Ok(None) };
    each.sort_unstable_by_key(|(key, _)| *key);
    packed::to_bytes(&each).map(Some)
}

fn load_keyed<K: Key, T: Component + Copy + DeserializeOwned, F: QueryFilter>(
    world: &mut World,
    bytes: &[u8],
) -> Result<()> {
    let values: Vec<(K, T)> = packed::from_bytes(bytes)?;
    let entities: Vec<(Entity, K)> =
        world.query_filtered::<(Entity, &K), F>().iter(world).map(|(entity, key)| (entity, *key)).collect();
    let mut keys: Vec<K> = entities.iter().map(|(_, key)| *key).collect();
    keys.sort_unstable();
    if !keys.iter().eq(values.iter().map(|(key, _)| key)) || !keys.is_sorted_by(|a, b| a < b) {
        let (found, kept) = (keys.len(), values.len());
        return Err(foreign(&format!("{kept} values of {} for {found} others", type_name::<T>())));
    }
    // In the order in which a system would insert them: that of sums over these entities depends on it.
    for (entity, key) in entities {
        let place = values.partition_point(|(other, _)| *other < key);
        world.entity_mut(entity).insert(values[place].1);
    }
    Ok(())
}

fn save_each<T: Component + Copy + Serialize, F: QueryFilter>(world: &mut World) -> Result<Option<Vec<u8>>> {
    let mut each: Vec<(Entity, Option<T>)> = world
        .query_filtered::<(Entity, Option<&T>), F>()
        .iter(world)
        .map(|(entity, value)| (entity, value.copied()))
        .collect();
    each.sort_unstable_by_key(|(entity, _)| *entity);
    let values: Option<Vec<T>> = each.into_iter().map(|(_, value)| value).collect();
    values.filter(|values| !values.is_empty()).map(|values| packed::to_bytes(&values)).transpose()
}

fn load_each<T: Component + Copy + DeserializeOwned, F: QueryFilter>(
    world: &mut World,
    bytes: &[u8],
) -> Result<()> {
    let values: Vec<T> = packed::from_bytes(bytes)?;
    let entities: Vec<Entity> = world.query_filtered::<Entity, F>().iter(world).collect();
    let mut sorted = entities.clone();
    sorted.sort_unstable();
    if sorted.len() != values.len() {
        return Err(foreign(&format!(
            "{} values for {} of {}",
            values.len(),
            sorted.len(),
            type_name::<T>()
        )));
    }
    // In the order in which a system would insert them: that of sums over these entities depends on it.
    for entity in entities {
        let place = sorted.partition_point(|other| *other < entity);
        world.entity_mut(entity).insert(values[place]);
    }
    Ok(())
}

/// The parts of this span and of longer ones, by name.
pub(super) fn save(world: &mut World, span: Span) -> Result<Vec<(String, Vec<u8>)>> {
    let parts: Vec<(&'static str, Save)> = world
        .get_resource_or_init::<Kept>()
        .0
        .iter()
        .filter(|part| part.span <= span)
        .map(|part| (part.name, part.save))
        .collect();
    let mut saved = Vec::new();
    for (name, save) in parts {
        if let Some(bytes) = save(world)? {
            saved.push((name.to_owned(), bytes));
        }
    }
    Ok(saved)
}

/// Puts saved parts back into a world that has them registered.
pub(super) fn load(world: &mut World, parts: &[(String, Vec<u8>)]) -> Result<()> {
    for (name, bytes) in parts {
        let kept = &world.get_resource_or_init::<Kept>().0;
        let part = kept.iter().find(|part| part.name == name).ok_or_else(|| foreign(name))?;
        let load = part.load;
        load(world, bytes)?;
    }
    Ok(())
}
