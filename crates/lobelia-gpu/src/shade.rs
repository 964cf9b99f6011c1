//! The calls: batches of points, what they upload and read back.

use crate::buffers::{Buffers, Slot};
use crate::device::{Gpu, State};
use crate::kernels::{Kernel, Model};
use bytemuck::cast_slice;
use lobelia_sg::brdf::{Ndf, SpecularAdjoint, SpecularValue};
use lobelia_sg::sg::Lobe;
use lobelia_sg::shading::{
    ChunkSums, ClosedForm, LOBE_COLUMNS, Layers, LobeColumns, PairLoops, PointAdjoint, RadianceColumns,
    ShadeCall, SharedGradient,
};
use std::ops::Range;

/// Points of a workgroup.
const GROUP: usize = 64;
/// Points of a batch at most.
const BATCH: usize = 1 << 17;
/// Bytes of a lobe on the device.
const LOBE_BYTES: usize = 64;
/// Values of two vectors of three, each padded to four.
const TWO_VECTORS: usize = 8;
/// Lobes at most: a software driver may end all loops of a thread after 65,535 turns in sum, and
/// says nothing.
pub(crate) const MOST_LOBES: usize = 4096;

/// A call on a device.
#[derive(Clone, Copy)]
struct Job<'a> {
    gpu: &'a Gpu,
    model: Model,
    call: ShadeCall<'a>,
}

impl PairLoops for Gpu {
    fn supports(&self, form: ClosedForm, ndf: Ndf) -> bool {
        Model::of(form, ndf).is_some()
    }

    fn shade(&self, call: ShadeCall<'_>, out: &mut [Layers]) -> Result<(), String> {
        assert_eq!(call.points.len(), out.len(), "one output per point");
        let job = Job::new(self, call)?;
        self.with_state(|state| {
            job.upload_lobes(state);
            for range in job.batches() {
                let values = job.forward(state, range.clone())?;
                for (out, value) in out[range].iter_mut().zip(values.chunks_exact(TWO_VECTORS)) {
                    let [diffuse, specular] = two_vectors(value);
                    *out = Layers { diffuse, specular };
                }
            }
            Ok(())
        })
    }

    fn shade_adjoint(
        &self,
        call: ShadeCall<'_>,
        radiance: RadianceColumns<'_>,
        out: &mut [PointAdjoint],
        sums: &mut ChunkSums,
    ) -> Result<(), String> {
        let lengths = [radiance.shaded.len(), radiance.adjoint.len(), out.len()];
        assert_eq!(lengths, [call.points.len(); 3], "one value and one output per point");
        let job = Job::new(self, call)?;
        let mut totals = vec![0.0; job.rows()];
        self.with_state(|state| {
            job.upload_lobes(state);
            for range in job.batches() {
                let values = job.adjoint(state, range.clone(), radiance)?;
                let (of_points, sums) = values.split_at(TWO_VECTORS * range.len());
                for (out, value) in out[range].iter_mut().zip(of_points.chunks_exact(TWO_VECTORS)) {
                    let [albedo, normal] = two_vectors(value);
                    *out = PointAdjoint { albedo, normal };
                }
                for (total, sum) in totals.iter_mut().zip(sums) {
                    *total += f64::from(*sum);
                }
            }
            Ok(())
        })?;
        sums.set_total(&gradient_of(&totals, call.lighting.lobes.len()));
        Ok(())
    }
}

/// A gradient from seven sums for each lobe, and four for the specular material.
fn gradient_of(totals: &[f64], count: usize) -> SharedGradient {
    let mut lobes = LobeColumns::zeros(count);
    let (of_lobes, material) = totals.split_at(LOBE_COLUMNS * count);
    let at = |values: &[f64], i: usize| values[i] as f32;
    for (i, sums) in of_lobes.chunks_exact(LOBE_COLUMNS).enumerate() {
        let three = |first: usize| std::array::from_fn(|c| at(sums, first + c));
        lobes.set(i, &Lobe { axis: three(0), sharpness: at(sums, 3), amplitude: three(4) });
    }
    let albedo = std::array::from_fn(|c| at(material, c));
    SharedGradient { lobes, specular: SpecularAdjoint { albedo, roughness: at(material, 3) } }
}

/// Two vectors from [`TWO_VECTORS`] values.
fn two_vectors(values: &[f32]) -> [[f32; 3]; 2] {
    [0, 4].map(|first| std::array::from_fn(|c| values[first + c]))
}

/// Values of vectors of three, each padded to four.
fn padded<const N: usize>(vectors: impl Iterator<Item = [[f32; 3]; N]>) -> Vec<f32> {
    vectors.flatten().flat_map(|[x, y, z]| [x, y, z, 0.0]).collect()
}

impl<'a> Job<'a> {
    fn new(gpu: &'a Gpu, call: ShadeCall<'a>) -> Result<Self, String> {
        let (form, ndf) = (call.form, call.specular.ndf);
        let model = Model::of(form, ndf).ok_or_else(|| {
            format!("{form:?} shading with the {ndf:?} distribution is not on the GPU; shade on the CPU")
        })?;
        call.lighting.check(call.points.len());
        let count = call.lighting.lobes.len();
        let most = MOST_LOBES.min(gpu.most_bytes as usize / LOBE_BYTES);
        if count > most {
            return Err(format!("{count} lobes are more than the GPU takes; at most {most}"));
        }
        Ok(Self { gpu, model, call })
    }

    /// Number of sums over points.
    fn rows(&self) -> usize {
        LOBE_COLUMNS * self.call.lighting.lobes.len() + 4
    }

    /// The points in batches whose buffers are not too large. What they are depends on the number
    /// of lobes only.
    fn batches(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        // Of a workgroup: a row of visibility for each point, and the sums.
        let bytes = (GROUP * self.call.lighting.lobes.stride()).max(4 * self.rows());
        let groups = (self.gpu.most_bytes as usize / bytes).clamp(1, BATCH / GROUP);
        let (batch, count) = (groups * GROUP, self.call.points.len());
        (0..count).step_by(batch).map(move |first| first..count.min(first + batch))
    }

    fn upload(&self, buffers: &mut Buffers, slot: Slot, bytes: &[u8]) {
        buffers.reserve(&self.gpu.device, slot, bytes.len() as u64);
        self.gpu.queue.write_buffer(buffers.get(slot), 0, bytes);
    }

    fn upload_lobes(&self, state: &mut State) {
        let lobes = self.call.lighting.lobes;
        let mut values = Vec::with_capacity(lobes.len() * LOBE_BYTES / 4);
        for i in 0..lobes.len() {
            let Lobe { axis, sharpness, amplitude } = lobes.get(i);
            values.extend(axis);
            values.push(sharpness);
            values.extend(amplitude);
            values.push(0.0);
            values.extend(self.model.lobe_terms(sharpness));
        }
        self.upload(&mut state.buffers, Slot::Lobes, cast_slice(&values));
    }

    /// Uploads what depends on the points of a batch, but for their radiance.
    fn upload_points(&self, buffers: &mut Buffers, range: Range<usize>) {
        let points = self.call.points[range.clone()].iter().map(|p| [p.normal, p.to_viewer, p.albedo]);
        self.upload(buffers, Slot::Points, cast_slice(&padded(points)));
        let stride = self.call.lighting.lobes.stride();
        let (mut rows, mut around, mut words): (&[u8], _, _) = (&[], Vec::new(), 0);
        if let Some(visibility) = self.call.lighting.visibility {
            around = padded(visibility.points[range.clone()].iter().map(|p| [p.specular, p.indirect]));
            if !visibility.lobes.is_empty() {
                rows = &visibility.lobes[range.start * stride..range.end * stride];
                words = stride / 4;
            }
        }
        self.upload(buffers, Slot::Visible, rows);
        self.upload(buffers, Slot::Around, cast_slice(&around));
        let SpecularValue { albedo: [r, g, b], roughness, .. } = *self.call.specular;
        let numbers = [range.len(), self.call.lighting.lobes.len(), words, usize::from(!around.is_empty())];
        let both = [[r, g, b, roughness].map(f32::to_bits), numbers.map(|n| n as u32)];
        self.upload(buffers, Slot::Call, cast_slice(&both));
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// Runs a kernel with these buffers, in the order of its bindings.
    fn dispatch(
        &self,
        state: &mut State,
        encoder: &mut wgpu::CommandEncoder,
        kernel: Kernel,
        slots: &[Slot],
        groups: usize,
    ) {
        let pipeline = state.pipelines.get(kernel, &self.gpu.device);
        let entry = |(slot, binding): (&Slot, u32)| wgpu::BindGroupEntry {
            binding,
            resource: state.buffers.get(*slot).as_entire_binding(),
        };
        let entries: Vec<wgpu::BindGroupEntry<'_>> = slots.iter().zip(0..).map(entry).collect();
        let bound = self.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &bound, &[]);
        pass.dispatch_workgroups(groups as u32, 1, 1);
    }

    /// Copies `counts` values of each of these buffers to the host, one after another, after the
    /// commands of `encoder`.
    fn read(
        &self,
        state: &mut State,
        mut encoder: wgpu::CommandEncoder,
        counts: &[(Slot, usize)],
    ) -> Result<Vec<f32>, String> {
        let total = counts.iter().map(|(_, count)| count).sum::<usize>();
        state.buffers.reserve(&self.gpu.device, Slot::Back, 4 * total as u64);
        let (back, mut at) = (state.buffers.get(Slot::Back), 0);
        for (slot, count) in counts {
            let bytes = 4 * *count as u64;
            encoder.copy_buffer_to_buffer(state.buffers.get(*slot), 0, back, at, bytes);
            at += bytes;
        }
        self.gpu.finish(encoder.finish(), back, total)
    }

    /// Diffuse and specular radiance of a batch.
    fn forward(&self, state: &mut State, range: Range<usize>) -> Result<Vec<f32>, String> {
        let count = TWO_VECTORS * range.len();
        self.upload_points(&mut state.buffers, range.clone());
        state.buffers.reserve(&self.gpu.device, Slot::Out, 4 * count as u64);
        let mut encoder = self.encoder();
        let slots = [Slot::Call, Slot::Points, Slot::Lobes, Slot::Visible, Slot::Around, Slot::Out];
        let groups = range.len().div_ceil(GROUP);
        self.dispatch(state, &mut encoder, Kernel::Forward(self.model), &slots, groups);
        self.read(state, encoder, &[(Slot::Out, count)])
    }

    /// Adjoints of the points of a batch, then sums over them.
    fn adjoint(
        &self,
        state: &mut State,
        range: Range<usize>,
        radiance: RadianceColumns<'_>,
    ) -> Result<Vec<f32>, String> {
        let (count, groups, rows) = (TWO_VECTORS * range.len(), range.len().div_ceil(GROUP), self.rows());
        self.upload_points(&mut state.buffers, range.clone());
        self.upload_adjoint(&mut state.buffers, range, radiance);
        let size = [groups as u32, 0, 0, 0];
        self.upload(&mut state.buffers, Slot::Size, cast_slice(&size));
        for (slot, count) in [(Slot::Out, count), (Slot::Parts, rows * groups), (Slot::Totals, rows)] {
            state.buffers.reserve(&self.gpu.device, slot, 4 * count as u64);
        }
        let mut encoder = self.encoder();
        let slots = [Slot::Call, Slot::Points, Slot::Lobes, Slot::Visible, Slot::Around];
        let slots = [&slots[..], &[Slot::LayersAdjoint, Slot::Out, Slot::Parts]].concat();
        self.dispatch(state, &mut encoder, Kernel::Adjoint(self.model), &slots, groups);
        let slots = [Slot::Size, Slot::Parts, Slot::Totals];
        self.dispatch(state, &mut encoder, Kernel::Sums, &slots, rows);
        self.read(state, encoder, &[(Slot::Out, count), (Slot::Totals, rows)])
    }

    /// Uploads the adjoints of the layers of a batch; a channel that is clamped to zero has an
    /// adjoint of zero.
    fn upload_adjoint(&self, buffers: &mut Buffers, range: Range<usize>, radiance: RadianceColumns<'_>) {
        let live = |layer: [f32; 3], adjoint: [f32; 3]| {
            std::array::from_fn(|c| if layer[c] > 0.0 { adjoint[c] } else { 0.0 })
        };
        let both = radiance.shaded[range.clone()].iter().zip(&radiance.adjoint[range]);
        let adjoints =
            both.map(|(layers, adjoint)| [live(layers.diffuse, adjoint.0), live(layers.specular, adjoint.0)]);
        self.upload(buffers, Slot::LayersAdjoint, cast_slice(&padded(adjoints)));
    }
}
