//! Columns and gradients as bytes.

use super::ranks::{Ranks, broken};
use crate::error::Result;
use crate::fit::components::StepGradient;
use crate::math::shading::{Layers, PointAdjoint, SpecularAdjoint};
use std::ops::Range;

/// A value that is a number of floats.
pub(super) trait PackedFloats<const N: usize>: Copy {
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
pub(super) struct Message(Vec<u8>);

impl Message {
    /// Adds floats.
    pub fn add(&mut self, floats: impl IntoIterator<Item = f32>) {
        self.0.extend(floats.into_iter().flat_map(f32::to_le_bytes));
    }

    /// Adds values of a column.
    pub fn add_column<const N: usize>(&mut self, values: &[impl PackedFloats<N>]) {
        self.add(values.iter().flat_map(|value| value.to_floats()));
    }

    /// Sends it to all, and returns what each has sent, by rank.
    pub fn exchange(&self, ranks: &Ranks) -> Result<Vec<Received>> {
        let parts = ranks.all_gather(&self.0)?;
        Ok(parts.into_iter().map(Received::new).collect())
    }
}

/// What one process has sent, as far as it is not taken.
pub(super) struct Received {
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
        taken.ok_or_else(|| broken("another process works on other samples"))
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

/// Adds what samples share to a message: sums over chunks with one base material, else sums over the samples.
pub(super) fn add_gradient(message: &mut Message, gradient: &StepGradient, blended: bool) {
    if !blended {
        return message.add(gradient.chunks.values());
    }
    message.add(gradient.shared.lobes.values().iter().copied());
    for SpecularAdjoint { albedo: [r, g, b], roughness } in &gradient.specular {
        message.add([*r, *g, *b, *roughness]);
    }
}

/// Replaces the gradient of a process by that of all, summed in their order.
pub(super) fn sum_gradients(
    gradient: &mut StepGradient,
    parts: &mut [Received],
    blended: bool,
) -> Result<()> {
    if !blended {
        let chunks: Vec<f32> = parts.iter().flat_map(|part| part.rest()).copied().collect();
        gradient.chunks.set_values(&chunks);
        gradient.take_total();
        return Ok(());
    }
    let lobes = &mut gradient.shared.lobes;
    *lobes = crate::math::shading::LobeColumns::zeros(lobes.len());
    gradient.specular.fill(SpecularAdjoint::default());
    for part in parts {
        lobes.add_values(part.take(lobes.values().len())?);
        for sum in &mut gradient.specular {
            let floats = part.take(4)?;
            sum.albedo.iter_mut().zip(floats).for_each(|(sum, value)| *sum += value);
            sum.roughness += floats[3];
        }
    }
    Ok(())
}
