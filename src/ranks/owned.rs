//! Items of which only one process has all that belongs to them, such as views with their photographs.
//!
//! | name | unit | value | meaning |
//! | --- | --- | --- | --- |
//! | `AT_A_TIME` | | 32 | items that are worked on before the processes exchange what they have made of them |

use super::{OTHER_DATA, Ranks, broken};
use crate::error::Result;
use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Items that are worked on before they are exchanged: only what is made of these is in memory several times. As many as processes, if these are more; of one
/// process four for each thread, if these are more.
pub(crate) const AT_A_TIME: usize = 32;

/// Items that several processes share: an item with an owner is left to that process, and all others get what it makes of it; one without is everybody's, and
/// each process works on it.
#[derive(Clone, Debug)]
pub struct OwnedItems<'a, V> {
    /// The items, which each process has, if not all that belongs to them.
    pub items: Vec<V>,
    owners: Vec<Option<u32>>,
    ranks: Option<&'a Ranks>,
}

impl<'a, V: Sync> OwnedItems<'a, V> {
    /// Items with the ranks of their owners. Without `ranks` all are everybody's.
    pub fn new(items: Vec<V>, ranks: Option<&'a Ranks>, owner: impl Fn(&V) -> Option<u32>) -> Self {
        Self { owners: items.iter().map(owner).collect(), items, ranks }
    }

    /// The processes that share the items.
    pub fn ranks(&self) -> Option<&'a Ranks> {
        self.ranks
    }

    /// Those of the items that `is_wanted` says.
    pub fn filtered(self, is_wanted: impl Fn(&V) -> bool) -> Self {
        let pairs = self.items.into_iter().zip(self.owners).filter(|(item, _)| is_wanted(item));
        let (items, owners) = pairs.unzip();
        Self { items, owners, ranks: self.ranks }
    }

    /// Every `stride`-th of the items, from the first one.
    pub fn every(&self, stride: usize) -> Self
    where
        V: Clone,
    {
        let items = self.items.iter().step_by(stride).cloned().collect();
        let owners = self.owners.iter().step_by(stride).copied().collect();
        Self { items, owners, ranks: self.ranks }
    }

    /// What `of` makes of each, with its place among them, in their order.
    ///
    /// # Errors
    /// If another process is gone.
    pub fn each<T: Serialize + DeserializeOwned + Send>(
        &self,
        of: impl Fn(usize, &V) -> T + Sync + Send,
    ) -> Result<Vec<T>> {
        let mut all = Vec::with_capacity(self.items.len());
        self.each_in_turn(of, |_, made| all.push(made))?;
        Ok(all)
    }

    /// Hands what `of` makes of each to `take`, in their order; only that of a few is in memory at once.
    ///
    /// # Errors
    /// If another process is gone.
    pub fn each_in_turn<T: Serialize + DeserializeOwned + Send>(
        &self,
        of: impl Fn(usize, &V) -> T + Sync + Send,
        take: impl FnMut(usize, T),
    ) -> Result<()> {
        let workers = self.ranks.map_or(4 * rayon::current_num_threads(), Ranks::size);
        self.in_groups(AT_A_TIME.max(workers), |_| true, of, take)
    }

    /// Hands the items that `is_wanted` says of their places to `take`, in their order: large ones, of which only as many as there are processes are sent
    /// before they are taken. All processes get the bytes of all; those that are not wanted are dropped.
    ///
    /// # Errors
    /// If another process is gone.
    pub fn send_whole<T: Serialize + DeserializeOwned + Send>(
        &self,
        is_wanted: impl Fn(usize) -> bool + Sync + Send,
        of: impl Fn(&V) -> T + Sync + Send,
        take: impl FnMut(usize, T),
    ) -> Result<()> {
        self.in_groups(self.ranks.map_or(1, Ranks::size), is_wanted, |_, item| of(item), take)
    }

    /// Works on the items in groups of `at_a_time`.
    fn in_groups<T: Serialize + DeserializeOwned + Send>(
        &self,
        at_a_time: usize,
        is_wanted: impl Fn(usize) -> bool + Sync + Send,
        of: impl Fn(usize, &V) -> T + Sync + Send,
        mut take: impl FnMut(usize, T),
    ) -> Result<()> {
        let ranks = self.ranks.filter(|_| self.owners.iter().any(Option::is_some));
        for (number, owners) in self.owners.chunks(at_a_time).enumerate() {
            let first = number * at_a_time;
            let of = |place: usize| of(first + place, &self.items[first + place]);
            let is_wanted = |place: usize| is_wanted(first + place);
            let made: Vec<Option<T>> = match ranks {
                None => (0..owners.len()).into_par_iter().map(|at| is_wanted(at).then(|| of(at))).collect(),
                Some(ranks) => exchange(ranks, owners, is_wanted, of)?,
            };
            (first..).zip(made).for_each(|(place, made)| made.into_iter().for_each(|made| take(place, made)));
        }
        Ok(())
    }
}

/// What the owners make of each of a few items, as far as it is wanted here.
fn exchange<T: Serialize + DeserializeOwned + Send>(
    ranks: &Ranks,
    owners: &[Option<u32>],
    is_wanted: impl Fn(usize) -> bool + Sync + Send,
    of: impl Fn(usize) -> T + Sync + Send,
) -> Result<Vec<Option<T>>> {
    let own = Some(ranks.rank() as u32);
    let is_made_here = |place: usize| owners[place].map_or(is_wanted(place), |owner| Some(owner) == own);
    let here = |place: usize| is_made_here(place).then(|| of(place));
    let mut all: Vec<Option<T>> = (0..owners.len()).into_par_iter().map(here).collect();
    // As the processes send them: by rank.
    let mut sent: Vec<usize> = (0..owners.len()).filter(|place| owners[*place].is_some()).collect();
    sent.sort_by_key(|place| owners[*place]);
    let mine = sent.iter().filter(|place| owners[**place] == own);
    let bytes: Vec<Vec<u8>> =
        mine.filter_map(|place| all[*place].as_ref()).map(packed).collect::<Result<_>>()?;
    for (place, list) in sent.iter().zip(ranks.join_lists(&bytes, sent.len())?) {
        if owners[*place] == own && !is_wanted(*place) {
            all[*place] = None;
        } else if all[*place].is_none() && is_wanted(*place) {
            all[*place] = Some(postcard::from_bytes(&list).map_err(|_| broken(OTHER_DATA))?);
        }
    }
    Ok(all)
}

/// A value as bytes.
fn packed<T: Serialize>(value: &T) -> Result<Vec<u8>> {
    postcard::to_allocvec(value).map_err(|error| broken(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ranks::threads::ThreadRank;
    use std::sync::Arc;

    #[test]
    fn what_owners_make_is_everybodys() {
        let owner = |item: &usize| [None, Some(2), Some(0), Some(2)][item % 4];
        let text = |item: usize| format!("item {item}");
        let alone: Vec<String> = (0..70).map(text).collect();
        let items = || (0..70).collect::<Vec<usize>>();
        assert_eq!(OwnedItems::new(items(), None, owner).each(|_, item| text(*item)).unwrap(), alone);
        std::thread::scope(|scope| {
            for rank in ThreadRank::group(3) {
                scope.spawn(|| {
                    let ranks = Ranks::new(Arc::new(rank));
                    let of = |place: usize, item: &usize| {
                        let is_own = owner(item).is_none_or(|owner| owner as usize == ranks.rank());
                        assert!(is_own && place == *item, "{item} is of another process");
                        text(*item)
                    };
                    let owned = OwnedItems::new(items(), Some(&ranks), owner);
                    assert_eq!(owned.each(of).unwrap(), alone);
                    assert!(ranks.take_traffic().of_shares.bytes > 0);
                    let mut whole = Vec::new();
                    let is_wanted = |place: usize| place % 5 == ranks.rank();
                    owned
                        .send_whole(is_wanted, |item| text(*item), |place, item| whole.push((place, item)))
                        .unwrap();
                    let wanted = (0..70).filter(|place| is_wanted(*place));
                    assert_eq!(whole, wanted.map(|place| (place, text(place))).collect::<Vec<_>>());
                    ranks.take_traffic();
                    let everybodys = OwnedItems::new(items(), Some(&ranks), |_| None);
                    assert_eq!(everybodys.each(|_, item| text(*item)).unwrap(), alone);
                    assert_eq!(ranks.take_traffic().of_shares.bytes, 0, "what all have is not sent");
                });
            }
        });
    }
}
