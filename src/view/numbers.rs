//! Numbers of pictures in as few bytes as hold them.

use half::f16;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Numbers in as few bytes as hold them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum Numbers {
    /// Places in a table.
    Bytes(#[serde(with = "packed")] Vec<u8>, #[serde(with = "packed")] Arc<[f32]>),
    /// Places in a table.
    Words(#[serde(with = "packed")] Vec<u16>, #[serde(with = "packed")] Arc<[f32]>),
    Halves(#[serde(with = "packed")] Vec<f16>),
    Floats(#[serde(with = "packed")] Vec<f32>),
}

impl Numbers {
    /// As half floats if they hold all values exactly, or if rounding is allowed and none is too large.
    pub fn of(values: impl Iterator<Item = f32> + Clone, may_round: bool) -> Self {
        let holds = |value: f32| {
            let rounded = f16::from_f32(value);
            rounded.to_f32() == value || may_round && rounded.is_finite()
        };
        if values.clone().all(holds) {
            Self::Halves(tight(values.map(f16::from_f32)))
        } else {
            Self::Floats(tight(values))
        }
    }

    #[inline]
    pub fn get(&self, i: usize) -> f32 {
        match self {
            Self::Bytes(stored, table) => table[usize::from(stored[i])],
            Self::Words(stored, table) => table[usize::from(stored[i])],
            Self::Halves(stored) => stored[i].to_f32(),
            Self::Floats(stored) => stored[i],
        }
    }

    /// The greatest value, and no less than 0: of stored integers the greatest that they could be.
    pub fn highest(&self) -> f32 {
        let highest = |a: f32, b: f32| a.max(b);
        match self {
            Self::Bytes(_, table) | Self::Words(_, table) => table.iter().copied().fold(0.0, highest),
            Self::Halves(stored) => stored.iter().map(|value| value.to_f32()).fold(0.0, highest),
            Self::Floats(stored) => stored.iter().copied().fold(0.0, highest),
        }
    }

    /// The table in which these are places, if they are.
    pub fn table(&self) -> Option<&Arc<[f32]>> {
        match self {
            Self::Bytes(_, table) | Self::Words(_, table) => Some(table),
            Self::Halves(_) | Self::Floats(_) => None,
        }
    }

    /// Takes a table in place of an equal one.
    pub fn share(&mut self, table: &Arc<[f32]>) {
        if let Self::Bytes(_, own) | Self::Words(_, own) = self
            && **own == **table
        {
            *own = table.clone();
        }
    }

    /// Memory that they take, without the table.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Bytes(stored, _) => stored.len(),
            Self::Words(stored, _) => 2 * stored.len(),
            Self::Halves(stored) => 2 * stored.len(),
            Self::Floats(stored) => 4 * stored.len(),
        }
    }
}

/// Values without the room that a list grows by.
pub(super) fn tight<T>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut list: Vec<T> = values.collect();
    list.shrink_to_fit();
    list
}

/// Lists of numbers as one piece of bytes, for `#[serde(with = "packed")]`: serializers copy it at once. In the byte order of the machine.
pub(crate) mod packed {
    use bytemuck::{Pod, cast_slice, pod_collect_to_vec};
    use serde::de::{Error, Visitor};
    use serde::{Deserializer, Serializer};
    use std::fmt;
    use std::marker::PhantomData;

    /// Writes the numbers.
    pub fn serialize<S: Serializer, T: Pod, L: std::ops::Deref<Target = [T]>>(
        list: &L,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        to.serialize_bytes(cast_slice(list))
    }

    /// Reads them back; bytes that are no whole number of them are an error.
    pub fn deserialize<'de, D: Deserializer<'de>, T: Pod, L: std::ops::Deref<Target = [T]> + From<Vec<T>>>(
        from: D,
    ) -> Result<L, D::Error> {
        from.deserialize_bytes(Bytes(PhantomData)).map(L::from)
    }

    struct Bytes<T>(PhantomData<T>);

    impl<T: Pod> Visitor<'_> for Bytes<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
            write!(f, "numbers of {} bytes each", size_of::<T>())
        }

        fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Vec<T>, E> {
            match bytes.len().is_multiple_of(size_of::<T>()) {
                true => Ok(pod_collect_to_vec(bytes)),
                false => Err(E::invalid_length(bytes.len(), &self)),
            }
        }
    }
}
