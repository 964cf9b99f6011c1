//! Columns as bytes.

use super::{OTHER_DATA, Ranks, broken, share};
use crate::error::Result;
use crate::math::shading::{Layers, PointAdjoint};
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;

/// A value that is a number of floats.
pub(crate) trait PackedFloats<const N: usize>: Copy {
    fn to_floats(self) -> [f32; N];
    fn of_floats(floats: [f32; N]) -> Self;
}

impl PackedFloats<6> for Layers {
    fn to_floats(self) -> [f32; 6] {
        joined(self.diffuse, self.specular)
    }

    fn of_floats([a, b, c, d, e, f]: [f32; 6]) -> Self {
        Self { diffuse: [a, b, c], specular: [d, e, f] }
    }
}

impl PackedFloats<6> for PointAdjoint {
    fn to_floats(self) -> [f32; 6] {
        joined(self.albedo, self.normal)
    }

    fn of_floats([a, b, c, d, e, f]: [f32; 6]) -> Self {
        Self { albedo: [a, b, c], normal: [d, e, f] }
    }
}

impl PackedFloats<3> for Vec3 {
    fn to_floats(self) -> [f32; 3] {
        self.to_array()
    }

    fn of_floats(floats: [f32; 3]) -> Self {
        Self::from_array(floats)
    }
}

impl PackedFloats<1> for f32 {
    fn to_floats(self) -> [f32; 1] {
        [self]
    }

    fn of_floats([value]: [f32; 1]) -> Self {
        value
    }
}

impl<const N: usize> PackedFloats<N> for [f32; N] {
    fn to_floats(self) -> [f32; N] {
        self
    }

    fn of_floats(floats: [f32; N]) -> Self {
        floats
    }
}

fn joined([a, b, c]: [f32; 3], [d, e, f]: [f32; 3]) -> [f32; 6] {
    [a, b, c, d, e, f]
}

/// What one process sends: floats in a row.
#[derive(Default)]
pub(crate) struct Message(Vec<u8>);

impl Message {
    /// Adds floats.
    pub fn add(&mut self, floats: impl IntoIterator<Item = f32>) {
        self.0.extend(floats.into_iter().flat_map(f32::to_le_bytes));
    }

    /// Adds values of a column.
    pub fn add_column<const N: usize>(&mut self, values: &[impl PackedFloats<N>]) {
        self.add(values.iter().flat_map(|value| value.to_floats()));
    }

    /// Sends it to all as part of a step, and returns what each has sent, by rank.
    pub fn exchange(&self, ranks: &Ranks) -> Result<Vec<Received>> {
        let parts = ranks.all_gather(&self.0)?;
        Ok(parts.into_iter().map(Received::new).collect())
    }
}

impl Ranks {
    /// Exchanges a column of which each process has the values of its [share](Ranks::share); all have all afterwards.
    pub(crate) fn complete<const N: usize>(
        &self,
        column: &mut [impl PackedFloats<N>],
        chunk: usize,
    ) -> Result<()> {
        let mut message = Message::default();
        message.add_column(&column[self.share(column.len(), chunk)]);
        for (rank, bytes) in self.gather_shares(&message.0)?.into_iter().enumerate() {
            let rows = share(column.len(), chunk, rank, self.size());
            Received::new(bytes).take_column(rows, column)?;
        }
        Ok(())
    }

    /// The same of a column with `width` bytes in each row.
    pub(crate) fn complete_bytes(&self, column: &mut [u8], width: usize, chunk: usize) -> Result<()> {
        let count = column.len() / width.max(1);
        let bytes_of = |rank: usize| {
            let rows = share(count, chunk, rank, self.size());
            rows.start * width..rows.end * width
        };
        for (rank, bytes) in self.gather_shares(&column[bytes_of(self.rank())])?.into_iter().enumerate() {
            let of_rank = column[bytes_of(rank)].as_mut();
            if of_rank.len() != bytes.len() {
                return Err(broken(OTHER_DATA));
            }
            of_rank.copy_from_slice(&bytes);
        }
        Ok(())
    }

    /// Lists of bytes for `count` items, in their order, of which each process has those of its [share](Ranks::share), chunks of one.
    pub(crate) fn join_lists(&self, own: &[Vec<u8>], count: usize) -> Result<Vec<Vec<u8>>> {
        let mut bytes = Vec::with_capacity(own.iter().map(|list| 8 + list.len()).sum());
        for list in own {
            bytes.extend((list.len() as u64).to_le_bytes());
            bytes.extend(list);
        }
        let mut all = Vec::with_capacity(count);
        for part in self.gather_shares(&bytes)? {
            let mut rest = &part[..];
            while let Some((length, tail)) = rest.split_first_chunk::<8>() {
                let length = usize::try_from(u64::from_le_bytes(*length)).ok();
                let list = length.and_then(|length| tail.split_at_checked(length));
                let Some((list, after)) = list else { return Err(broken(OTHER_DATA)) };
                all.push(list.to_vec());
                rest = after;
            }
        }
        if all.len() == count { Ok(all) } else { Err(broken(OTHER_DATA)) }
    }

    /// What each process has, one after the other; `count` in all.
    pub(crate) fn joined<T: Copy, const N: usize>(
        &self,
        own: &[T],
        count: usize,
        to_bytes: fn(T) -> [u8; N],
        of_bytes: fn([u8; N]) -> T,
    ) -> Result<Vec<T>> {
        let bytes: Vec<u8> = own.iter().flat_map(|value| to_bytes(*value)).collect();
        let parts = self.gather_shares(&bytes)?;
        let values = parts.iter().flat_map(|part| part.as_chunks::<N>().0).map(|bytes| of_bytes(*bytes));
        let all: Vec<T> = values.collect();
        if all.len() == count { Ok(all) } else { Err(broken(OTHER_DATA)) }
    }
}

/// What `of` makes of each of `count` items, in their order. The threads of this process do it, or those of all `ranks`, each process a share.
pub(crate) fn divided<T: PackedFloats<N> + Send, const N: usize>(
    ranks: Option<&Ranks>,
    count: usize,
    of: impl Fn(usize) -> Vec<T> + Sync + Send,
) -> Result<Vec<Vec<T>>> {
    let Some(ranks) = ranks else { return Ok((0..count).into_par_iter().map(of).collect()) };
    let bytes_of = |item: usize| -> Vec<u8> {
        of(item).iter().flat_map(|value| value.to_floats()).flat_map(f32::to_le_bytes).collect()
    };
    let own: Vec<Vec<u8>> = ranks.share(count, 1).into_par_iter().map(bytes_of).collect();
    let values_of = |bytes: Vec<u8>| -> Vec<T> {
        let floats: Vec<f32> =
            bytes.as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)).collect();
        floats.as_chunks::<N>().0.iter().map(|floats| T::of_floats(*floats)).collect()
    };
    Ok(ranks.join_lists(&own, count)?.into_iter().map(values_of).collect())
}

/// What one process has sent, as far as it is not taken.
pub(crate) struct Received {
    floats: Vec<f32>,
    taken: usize,
}

impl Received {
    fn new(bytes: Vec<u8>) -> Self {
        let floats =
            bytes.chunks_exact(4).map(|four| f32::from_le_bytes([four[0], four[1], four[2], four[3]]));
        Self { floats: floats.collect(), taken: 0 }
    }

    /// Takes so many floats.
    pub fn take(&mut self, count: usize) -> Result<&[f32]> {
        let taken = self.floats.get(self.taken..self.taken + count);
        self.taken += count;
        taken.ok_or_else(|| broken(OTHER_DATA))
    }

    /// Takes the values of `rows` of a column.
    pub fn take_column<const N: usize, T: PackedFloats<N>>(
        &mut self,
        rows: Range<usize>,
        column: &mut [T],
    ) -> Result<()> {
        let floats = self.take(N * rows.len())?;
        for (value, floats) in column[rows].iter_mut().zip(floats.as_chunks::<N>().0) {
            *value = T::of_floats(*floats);
        }
        Ok(())
    }

    /// What is left.
    pub fn rest(&self) -> &[f32] {
        self.floats.get(self.taken..).unwrap_or_default()
    }
}
