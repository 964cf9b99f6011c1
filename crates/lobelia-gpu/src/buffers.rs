//! Buffers on the device, kept between calls.

use std::collections::HashMap;
use wgpu::BufferUsages;

/// Purpose of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Slot {
    /// The inputs that all points share.
    Call,
    /// Length of the rows to sum.
    Size,
    Points,
    Lobes,
    /// Visibility of lobes.
    Visible,
    /// The other part of the visibility of points.
    Around,
    /// Adjoints of the layers of points.
    LayersAdjoint,
    /// Results of points.
    Out,
    /// Sums of workgroups.
    Parts,
    /// Totals of the sums of workgroups.
    Totals,
    /// Data read by the host.
    Back,
}

impl Slot {
    fn usage(self) -> BufferUsages {
        match self {
            Self::Call | Self::Size => BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            Self::Out | Self::Totals => BufferUsages::STORAGE | BufferUsages::COPY_SRC,
            Self::Back => BufferUsages::MAP_READ | BufferUsages::COPY_DST,
            _ => BufferUsages::STORAGE | BufferUsages::COPY_DST,
        }
    }
}

/// Bytes of a buffer at least: the largest element of an array.
const LEAST_BYTES: u64 = 64;

/// Buffers that grow with what is put into them.
#[derive(Default)]
pub(crate) struct Buffers(HashMap<Slot, wgpu::Buffer>);

impl Buffers {
    /// Makes room for `bytes`.
    pub(crate) fn reserve(&mut self, device: &wgpu::Device, slot: Slot, bytes: u64) {
        if self.0.get(&slot).is_some_and(|buffer| buffer.size() >= bytes) {
            return;
        }
        let label = format!("{slot:?}");
        let descriptor = wgpu::BufferDescriptor {
            label: Some(label.as_str()),
            size: bytes.max(LEAST_BYTES).next_multiple_of(16),
            usage: slot.usage(),
            mapped_at_creation: false,
        };
        self.0.insert(slot, device.create_buffer(&descriptor));
    }

    /// A buffer that room was made for.
    pub(crate) fn get(&self, slot: Slot) -> &wgpu::Buffer {
        &self.0[&slot]
    }
}
