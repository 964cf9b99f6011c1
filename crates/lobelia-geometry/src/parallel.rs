//! Loops on all threads of the current rayon pool.
//!
//! A parallel iterator of rayon is compiled anew for each closure, a few thousand lines of LLVM IR
//! each time. Here threads share the parts of a loop behind one function pointer, and only the plain
//! loop over a part is compiled anew. Results stand in the order of their indices, so that bits
//! depend neither on parts nor on threads.
//!
//! ```
//! use lobelia_geometry::parallel;
//!
//! let squares = parallel::map(100, 8, |i| i * i);
//! assert_eq!(squares[..4], [0, 1, 4, 9]);
//! let mut sums = vec![1_usize; 100];
//! parallel::for_each_row((&mut sums[..], &squares[..]), 8, |(sum, square)| *sum += *square);
//! assert_eq!(sums[..4], [1, 2, 5, 10]);
//! ```

use crate::error::stop::Work;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Parts of a loop per thread: enough that all threads end at about the same time.
const PARTS_PER_THREAD: usize = 16;

/// Returns the values of the indices below `count`, in this order. `grain` is the least number of
/// indices that are worth a task of their own.
pub fn map<R: Send>(count: usize, grain: usize, value: impl Fn(usize) -> R + Sync) -> Vec<R> {
    gather(count, grain, &|part| part.map(&value).collect())
}

/// Returns the values of items, in their order; see [`map`].
pub fn map_slice<'a, T: Sync, R: Send>(
    items: &'a [T],
    grain: usize,
    value: impl Fn(&'a T) -> R + Sync,
) -> Vec<R> {
    map(items.len(), grain, |i| value(&items[i]))
}

/// Returns all values of the indices below `count`, in this order; see [`map`].
pub fn flat_map<I: IntoIterator<Item: Send>>(
    count: usize,
    grain: usize,
    values: impl Fn(usize) -> I + Sync,
) -> Vec<I::Item> {
    gather(count, grain, &|part| part.flat_map(&values).collect())
}

/// Calls `task` with each item. Items are worth a task each: chunks of columns, views.
pub fn for_each<T: Send>(items: impl IntoIterator<Item = T>, task: impl Fn(T) + Sync) {
    let items: Vec<_> = items.into_iter().map(|item| Mutex::new(Some(item))).collect();
    run(items.len(), &|k| taken(&items[k]).into_iter().for_each(&task));
}

/// Returns the values of items, in their order; see [`for_each`].
pub fn map_items<T: Send, R: Send>(
    items: impl IntoIterator<Item = T>,
    value: impl Fn(T) -> R + Sync,
) -> Vec<R> {
    let items: Vec<_> = items.into_iter().map(|item| Mutex::new(Some(item))).collect();
    flat_map(items.len(), 1, |k| taken(&items[k]).map(&value))
}

/// Calls `task` with each row of columns; `grain` as for [`map`]. Rows without an element in each
/// column are left out.
pub fn for_each_row<C: Rows>(columns: C, grain: usize, task: impl Fn(C::Row) + Sync) {
    let count = columns.count();
    let parts = parts(count, grain);
    let (mut rest, mut divided) = (columns, Vec::with_capacity(parts));
    for k in (1..parts).rev() {
        let (first, last) = rest.split(k * count / parts);
        divided.push(last);
        rest = first;
    }
    divided.push(rest);
    for_each(divided, |part: C| part.rows().for_each(&task));
}

/// What [`for_each_row`] divides by rows: slices, ranges, and pairs of columns.
pub trait Rows: Send + Sized {
    /// The elements of a row.
    type Row;
    /// The number of rows.
    fn count(&self) -> usize;
    /// The rows below `at`, and the others.
    fn split(self, at: usize) -> (Self, Self);
    /// The rows in order.
    fn rows(self) -> impl Iterator<Item = Self::Row>;
}

impl<'a, T: Sync> Rows for &'a [T] {
    type Row = &'a T;

    fn count(&self) -> usize {
        self.len()
    }

    fn split(self, at: usize) -> (Self, Self) {
        self.split_at(at)
    }

    fn rows(self) -> impl Iterator<Item = Self::Row> {
        self.iter()
    }
}

impl<'a, T: Send> Rows for &'a mut [T] {
    type Row = &'a mut T;

    fn count(&self) -> usize {
        self.len()
    }

    fn split(self, at: usize) -> (Self, Self) {
        self.split_at_mut(at)
    }

    fn rows(self) -> impl Iterator<Item = Self::Row> {
        self.iter_mut()
    }
}

impl Rows for Range<usize> {
    type Row = usize;

    fn count(&self) -> usize {
        self.len()
    }

    fn split(self, at: usize) -> (Self, Self) {
        let middle = self.start + at;
        (self.start..middle, middle..self.end)
    }

    fn rows(self) -> impl Iterator<Item = Self::Row> {
        self
    }
}

impl<A: Rows, B: Rows> Rows for (A, B) {
    type Row = (A::Row, B::Row);

    fn count(&self) -> usize {
        self.0.count().min(self.1.count())
    }

    fn split(self, at: usize) -> (Self, Self) {
        let (a, b) = (self.0.split(at), self.1.split(at));
        ((a.0, b.0), (a.1, b.1))
    }

    fn rows(self) -> impl Iterator<Item = Self::Row> {
        self.0.rows().zip(self.1.rows())
    }
}

fn taken<T>(item: &Mutex<Option<T>>) -> Option<T> {
    item.lock().unwrap_or_else(PoisonError::into_inner).take()
}

/// The number of parts of a loop.
fn parts(count: usize, grain: usize) -> usize {
    (count / grain.max(1)).clamp(1, PARTS_PER_THREAD * rayon::current_num_threads())
}

fn gather<R: Send>(count: usize, grain: usize, of_part: &(dyn Fn(Range<usize>) -> Vec<R> + Sync)) -> Vec<R> {
    let parts = parts(count, grain);
    let done: Vec<Mutex<Vec<R>>> = (0..parts).map(|_| Mutex::default()).collect();
    run(parts, &|k| {
        let values = of_part(k * count / parts..(k + 1) * count / parts);
        *done[k].lock().unwrap_or_else(PoisonError::into_inner) = values;
    });
    let done = done.into_iter().map(|part| part.into_inner().unwrap_or_else(PoisonError::into_inner));
    let done: Vec<Vec<R>> = done.collect();
    let others = done.iter().skip(1).map(Vec::len).sum();
    let mut done = done.into_iter();
    let mut all = done.next().unwrap_or_default();
    all.reserve_exact(others);
    done.for_each(|mut part| all.append(&mut part));
    all
}

fn run(tasks: usize, task: &(dyn Fn(usize) + Sync)) {
    // What stops this thread's work stops its tasks, wherever they run.
    let work = Work::current();
    (0..tasks).into_par_iter().with_max_len(1).for_each(|k| work.over(|| task(k)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_index_is_met_once_and_in_order() {
        for count in [0, 1, 7, 1000] {
            for grain in [0, 1, 64] {
                assert_eq!(map(count, grain, |i| 2 * i), (0..count).map(|i| 2 * i).collect::<Vec<_>>());
                let odd = |i: usize| (i % 2 == 1).then_some(i);
                assert_eq!(flat_map(count, grain, odd), (0..count).filter_map(odd).collect::<Vec<_>>());
            }
        }
        let mut rows = [0; 10];
        for_each(rows.chunks_mut(3).enumerate(), |(k, rows)| rows.fill(k));
        assert_eq!(rows, [0, 0, 0, 1, 1, 1, 2, 2, 2, 3]);
        assert_eq!(map_items(rows.chunks_mut(4), |rows| rows[0]), [0, 1, 2]);
    }

    #[test]
    fn every_row_is_met_once() {
        for grain in [1, 3, 20] {
            let (mut sums, numbers) = ([1; 10], [2, 3, 5, 7, 11, 13, 17, 19, 23]);
            for_each_row(((&mut sums[..], &numbers[..]), 0..20), grain, |((sum, n), i)| *sum += n * i);
            assert_eq!(sums, [1, 4, 11, 22, 45, 66, 103, 134, 185, 1]);
        }
    }
}
