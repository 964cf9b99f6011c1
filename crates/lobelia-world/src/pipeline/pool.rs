//! Pools: many entities whose columns kernels read as slices.
//!
//! A pool is the set of all entities with one index component ([`PoolIndex`]): pixel samples,
//! texels, vertices, bricks. Kernels refer to a row by that index, never by the position of an
//! entity in a table. While all entities of a pool have the same components and are in the order of
//! their indices, as after spawning in one batch, columns are slices of the table and nothing is
//! copied. If an additional component or another order moves entities to other rows or tables,
//! columns are copied in and out in the order of the indices. The results are the same, but this is
//! slower.
//!
//! ```
//! use bevy_ecs::prelude::World;
//! use glam::Vec3;
//! use lobelia_world::material::{Diffuse, TexelIndex};
//! use lobelia_world::pipeline::pool::{read_column, write_column};
//!
//! let mut world = World::new();
//! world.spawn_batch([2, 0, 1].map(|row| (TexelIndex(row), Diffuse::default())));
//! let gray = [0.2, 0.4, 0.6].map(|albedo| Diffuse::of_albedo(Vec3::splat(albedo)));
//! write_column::<TexelIndex, _>(&mut world, &gray)?;
//! assert_eq!(read_column::<TexelIndex, Diffuse>(&mut world)?, gray);
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use bevy_ecs::prelude::{Component, Entity, Query, World};
use bevy_ecs::system::{SystemParam, SystemState};
use bevy_ecs::{change_detection::ContiguousMut, component::Mutable, query::ContiguousQueryData};
use lobelia_geometry::{Error, Result};
use std::ops::{Deref, DerefMut, Range};
use std::{borrow::Cow, sync::Arc};

/// The row of an entity in its pool: 0 to the length of the pool − 1, each once.
pub trait PoolIndex: Component {
    /// Name of an entity of the pool, for messages.
    const NAME: &'static str;

    /// The row.
    fn row(&self) -> usize;
}

/// Declares index components.
#[macro_export]
macro_rules! pool_index {
    ($($(#[$doc:meta])* $name:ident($what:literal);)*) => { $(
        $(#[$doc])*
        #[derive(bevy_ecs::prelude::Component, Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub struct $name(pub u32);

        impl $crate::pipeline::pool::PoolIndex for $name {
            const NAME: &'static str = $what;

            fn row(&self) -> usize {
                self.0 as usize
            }
        }
    )* };
}
pub use pool_index;

/// A pool as a system parameter: columns `D` (`&T`, `&mut T`, or a tuple of them) of the entities
/// with index `I`.
#[derive(SystemParam)]
pub struct Pool<'w, 's, I: PoolIndex, D: Columns + 'static> {
    query: Query<'w, 's, (&'static I, D)>,
}

impl<'w, 's, I: PoolIndex, D: Columns + 'static> Pool<'w, 's, I, D> {
    /// The columns of all rows. Writing to one marks all its components as changed
    /// ([`ColumnMut::quiet`] does not).
    ///
    /// # Errors
    /// If rows are missing or duplicate.
    pub fn columns(self) -> Result<D::Slices<'w>> {
        self.select(None, true)
    }

    /// The columns of some rows. Writing does not mark them as changed: use this for data that
    /// every run recomputes.
    ///
    /// # Errors
    /// If one of these rows is missing, or duplicate where no table has all of them in order: if
    /// one does, no other table is searched.
    pub fn rows(self, rows: Range<usize>) -> Result<D::Slices<'w>> {
        self.select(Some(rows), false)
    }

    /// Columns of rows, or of all: slices of the table if it has them in order, else copies.
    fn select(self, rows: Option<Range<usize>>, marks: bool) -> Result<D::Slices<'w>> {
        // The parts of the pool in each table.
        let chunks = self.query.contiguous_iter_inner().map_err(|error| failed::<I>(error.to_string()))?;
        let mut chunks: Vec<_> = chunks.filter(|(index, _)| !index.is_empty()).collect();
        let rows = rows.unwrap_or_else(|| 0..chunks.iter().map(|(index, _)| index.len()).sum());
        if let Some(only) = chunks.iter().position(|(index, _)| in_order(index, &rows)) {
            // The other chunks, if any, have none of these rows, or duplicates of them, which are
            // not searched for.
            let (_, chunk) = chunks.swap_remove(only);
            return Ok(D::slices(chunk, rows, marks));
        }
        let indices: Vec<&[I]> = chunks.iter().map(|(index, _)| *index).collect();
        let places = places(&indices, &rows)?;
        Ok(D::gathered(chunks.into_iter().map(|(_, chunk)| chunk).collect(), &places, marks))
    }
}

/// Whether the entities at `rows` of a table have these indices. Without early exit, so that it
/// compiles to a vector loop.
fn in_order<I: PoolIndex>(index: &[I], rows: &Range<usize>) -> bool {
    let Some(part) = index.get(rows.clone()) else { return false };
    part.iter().zip(rows.clone()).fold(0, |off, (index, row)| off | (index.row() ^ row)) == 0
}

/// Locations of rows of a pool: chunk, and row in it.
type Places = Arc<[(u32, u32)]>;

fn places<I: PoolIndex>(indices: &[&[I]], rows: &Range<usize>) -> Result<Places> {
    const NOWHERE: (u32, u32) = (u32::MAX, u32::MAX);
    let wrong = |row, what| failed::<I>(format!("{} {row} {what}: indices count from 0, each once", I::NAME));
    let mut places = vec![NOWHERE; rows.len()];
    for (chunk, index) in indices.iter().enumerate() {
        for (place, index) in index.iter().enumerate() {
            let slot = index.row().checked_sub(rows.start).and_then(|row| places.get_mut(row));
            let Some(slot) = slot else { continue };
            if *slot != NOWHERE {
                return Err(wrong(index.row(), "is duplicate"));
            }
            *slot = (chunk as u32, place as u32);
        }
    }
    match places.iter().position(|place| *place == NOWHERE) {
        Some(missing) => Err(wrong(rows.start + missing, "is missing")),
        None => Ok(places.into()),
    }
}

fn failed<I: PoolIndex>(problem: impl Into<String>) -> Error {
    Error::run(format!("the {} pool", I::NAME), problem)
}

/// The column types of a [`Pool`]: `&T` and `&mut T` of `Copy` components, and tuples of these.
pub trait Columns: ContiguousQueryData {
    /// The columns as slices: `Cow<[T]>` for `&T`, of the table or copied in the order of the
    /// indices; [`ColumnMut`] for `&mut T`.
    type Slices<'w>;

    /// Consecutive rows of a table.
    fn slices<'w>(chunk: Self::Contiguous<'w, '_>, rows: Range<usize>, marks: bool) -> Self::Slices<'w>;

    /// Rows from several locations, copied in order.
    fn gathered<'w>(chunks: Vec<Self::Contiguous<'w, '_>>, places: &Places, marks: bool) -> Self::Slices<'w>;
}

impl<T: Component + Copy> Columns for &'static T {
    type Slices<'w> = Cow<'w, [T]>;

    fn slices<'w>(chunk: Self::Contiguous<'w, '_>, rows: Range<usize>, _marks: bool) -> Cow<'w, [T]> {
        Cow::Borrowed(&chunk[rows])
    }

    fn gathered<'w>(chunks: Vec<Self::Contiguous<'w, '_>>, places: &Places, _marks: bool) -> Cow<'w, [T]> {
        places.iter().map(|&(chunk, place)| chunks[chunk as usize][place as usize]).collect()
    }
}

/// A column that is written. A copy is written back to its table when it is dropped.
pub struct ColumnMut<'w, T: Copy> {
    source: Source<'w, T>,
    /// Whether the first write marks the components as changed.
    marks: bool,
}

enum Source<'w, T> {
    Table { chunk: ContiguousMut<'w, T>, rows: Range<usize> },
    Copied { values: Vec<T>, chunks: Vec<ContiguousMut<'w, T>>, places: Places },
}

impl<T: Copy> ColumnMut<'_, T> {
    /// Disables change marks: writing does not mark components as changed.
    #[must_use]
    pub fn quiet(mut self) -> Self {
        self.marks = false;
        self
    }
}

impl<T: Copy> Deref for ColumnMut<'_, T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        match &self.source {
            Source::Table { chunk, rows } => &chunk[rows.clone()],
            Source::Copied { values, .. } => values,
        }
    }
}

impl<T: Copy> DerefMut for ColumnMut<'_, T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        let marks = std::mem::take(&mut self.marks);
        match &mut self.source {
            Source::Table { chunk, rows } => {
                if marks {
                    chunk.mark_all_as_changed();
                }
                &mut chunk.bypass_change_detection()[rows.clone()]
            }
            Source::Copied { values, chunks, .. } => {
                if marks {
                    chunks.iter_mut().for_each(ContiguousMut::mark_all_as_changed);
                }
                values
            }
        }
    }
}

impl<T: Copy> Drop for ColumnMut<'_, T> {
    fn drop(&mut self) {
        if let Source::Copied { values, chunks, places } = &mut self.source {
            for (value, (chunk, place)) in values.iter().zip(places.iter()) {
                chunks[*chunk as usize].bypass_change_detection()[*place as usize] = *value;
            }
        }
    }
}

impl<T: Component<Mutability = Mutable> + Copy> Columns for &'static mut T {
    type Slices<'w> = ColumnMut<'w, T>;

    fn slices<'w>(chunk: Self::Contiguous<'w, '_>, rows: Range<usize>, marks: bool) -> ColumnMut<'w, T> {
        ColumnMut { source: Source::Table { chunk, rows }, marks }
    }

    fn gathered<'w>(chunks: Vec<Self::Contiguous<'w, '_>>, places: &Places, marks: bool) -> ColumnMut<'w, T> {
        let values = places.iter().map(|&(chunk, place)| chunks[chunk as usize][place as usize]).collect();
        ColumnMut { source: Source::Copied { values, chunks, places: places.clone() }, marks }
    }
}

/// Tuples of columns, up to six.
macro_rules! tuple_columns {
    ($($name:ident $value:ident),*) => {
        #[allow(non_snake_case)]
        impl<$($name: Columns),*> Columns for ($($name,)*) {
            type Slices<'w> = ($($name::Slices<'w>,)*);

            fn slices<'w>(chunk: Self::Contiguous<'w, '_>, rows: Range<usize>, marks: bool) -> Self::Slices<'w> {
                let ($($value,)*) = chunk;
                ($($name::slices($value, rows.clone(), marks),)*)
            }

            fn gathered<'w>(chunks: Vec<Self::Contiguous<'w, '_>>, places: &Places, marks: bool) -> Self::Slices<'w> {
                // Vectors have the names of the types, their elements the names of the values.
                $(let mut $name = Vec::with_capacity(chunks.len());)*
                for ($($value,)*) in chunks {
                    $($name.push($value);)*
                }
                ($($name::gathered($name, places, marks),)*)
            }
        }
    };
}
tuple_columns!(A a);
tuple_columns!(A a, B b);
tuple_columns!(A a, B b, C c);
tuple_columns!(A a, B b, C c, D d);
tuple_columns!(A a, B b, C c, D d, E e);
tuple_columns!(A a, B b, C c, D d, E e, F f);

/// Rows that are despawned before the messages of their removal are dropped.
const DESPAWNED_AT_ONCE: usize = 1 << 16;

/// Removes rows of a pool. Of many rows `RemovedComponents` tells of the last alone: the world
/// keeps the room of these messages, which for the pixels of a fit is as large as the pool.
pub fn despawn_rows(world: &mut World, rows: &[Entity]) {
    for (number, part) in rows.chunks(DESPAWNED_AT_ONCE).enumerate() {
        if number > 0 {
            world.clear_trackers();
        }
        part.iter().for_each(|row| _ = world.despawn(*row));
    }
}

/// The result of `work` on the columns `D` of a pool, all rows.
///
/// # Errors
/// If rows are missing or duplicate, or `work` fails.
pub fn with_columns<I: PoolIndex, D: Columns + 'static, R>(
    world: &mut World,
    work: impl FnOnce(D::Slices<'_>) -> Result<R>,
) -> Result<R> {
    let mut state = SystemState::<Pool<I, D>>::new(world);
    let pool = state.get_mut(world).map_err(|error| failed::<I>(error.to_string()))?;
    work(pool.columns()?)
}

/// A copy of one column of a pool, all rows; empty if the pool is.
///
/// # Errors
/// If rows are missing or duplicate.
pub fn read_column<I: PoolIndex, T: Component + Copy>(world: &mut World) -> Result<Vec<T>> {
    with_columns::<I, &T, _>(world, |column| Ok(column.into_owned()))
}

/// Writes one column of a pool, all rows.
///
/// # Errors
/// If rows are missing or duplicate, or `values` has another length.
pub fn write_column<I: PoolIndex, T>(world: &mut World, values: &[T]) -> Result<()>
where
    T: Component<Mutability = Mutable> + Copy,
{
    with_columns::<I, &mut T, _>(world, |mut column| {
        check_rows::<I>(values.len(), column.len())?;
        column.copy_from_slice(values);
        Ok(())
    })
}

/// Checks that there is a value for each row of a pool.
pub(crate) fn check_rows<I: PoolIndex>(values: usize, rows: usize) -> Result<()> {
    if values == rows { Ok(()) } else { Err(failed::<I>(format!("{values} values for {rows} rows"))) }
}
