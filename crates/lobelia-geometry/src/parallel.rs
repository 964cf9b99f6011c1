//! Loops on all threads of the current rayon pool.
//!
//! A parallel iterator of rayon is compiled anew for each closure, a few thousand lines of LLVM IR each time. Here
//! threads share the parts of a loop behind one function pointer, and only the plain loop over a part is compiled anew.
//! Results stand in the order of their indices, so that bits depend neither on parts nor on threads.

use rayon::prelude::*;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Parts of a loop per thread: enough that all threads end at about the same time.
const PARTS_PER_THREAD: usize = 16;

/// Returns the values of the indices below `count`, in this order. `grain` is the least number of indices that are worth
/// a task of their own.
pub fn map<R: Send>(count: usize, grain: usize, value: impl Fn(usize) -> R + Sync) -> Vec<R> {
    gather(count, grain, &|part| part.map(&value).collect())
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
    run(items.len(), &|k| {
        let item = items[k].lock().unwrap_or_else(PoisonError::into_inner).take();
        item.into_iter().for_each(&task);
    });
}

fn gather<R: Send>(count: usize, grain: usize, of_part: &(dyn Fn(Range<usize>) -> Vec<R> + Sync)) -> Vec<R> {
    let most = PARTS_PER_THREAD * rayon::current_num_threads();
    let parts = (count / grain.max(1)).clamp(1, most);
    let done: Vec<Mutex<Vec<R>>> = (0..parts).map(|_| Mutex::default()).collect();
    run(parts, &|k| {
        let values = of_part(k * count / parts..(k + 1) * count / parts);
        *done[k].lock().unwrap_or_else(PoisonError::into_inner) = values;
    });
    let mut done = done.into_iter().map(|part| part.into_inner().unwrap_or_else(PoisonError::into_inner));
    let mut all = done.next().unwrap_or_default();
    done.for_each(|mut part| all.append(&mut part));
    all
}

fn run(tasks: usize, task: &(dyn Fn(usize) + Sync)) {
    (0..tasks).into_par_iter().with_max_len(1).for_each(task);
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
    }
}
