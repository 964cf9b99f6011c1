//! Adapters, the device, and the cached state of calls.

use crate::buffers::Buffers;
use crate::error::GpuError;
use crate::kernels::Pipelines;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};

/// Bytes of a buffer at most; a call with more takes its points in batches.
const MOST_BYTES: u64 = 64 << 20;
/// Bytes of workgroup memory that the kernels use.
const SHARED_BYTES: u32 = 14_560;
/// Storage buffers of a kernel.
const STORAGE_BUFFERS: u32 = 8;
/// Threads of a workgroup.
const THREADS: u32 = 64;

/// State kept between calls.
#[derive(Default)]
pub(crate) struct State {
    pub(crate) pipelines: Pipelines,
    pub(crate) buffers: Buffers,
}

/// A GPU, with pipelines and buffers that calls reuse. Calls from several threads take turns.
pub struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    name: String,
    state: Mutex<State>,
    /// The first failure that is not reported yet.
    failure: Arc<Mutex<Option<String>>>,
    /// Bytes of a buffer at most.
    pub(crate) most_bytes: u64,
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Gpu").field("name", &self.name).finish_non_exhaustive()
    }
}

/// The value behind a lock, also where a thread has panicked while it held it.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Name and interface of an adapter.
fn name_of(adapter: &wgpu::Adapter) -> String {
    let info = adapter.get_info();
    format!("{} ({:?})", info.name, info.backend)
}

/// Whether an adapter can run the kernels.
fn computes(adapter: &wgpu::Adapter) -> bool {
    let limits = adapter.limits();
    limits.max_compute_workgroup_storage_size >= SHARED_BYTES
        && limits.max_storage_buffers_per_shader_stage >= STORAGE_BUFFERS
        && limits.max_compute_invocations_per_workgroup >= THREADS
}

/// Software comes last.
fn rank(adapter: &wgpu::Adapter) -> u8 {
    match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

/// The output of a future of wgpu, which is ready at once everywhere but in a browser.
fn wait_for<F: Future>(future: F) -> F::Output {
    let (mut future, mut context) = (std::pin::pin!(future), Context::from_waker(Waker::noop()));
    loop {
        if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
            return output;
        }
        std::thread::yield_now();
    }
}

/// The adapters that can run the kernels, the fastest kind first.
fn adapters() -> Vec<wgpu::Adapter> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let mut all = wait_for(instance.enumerate_adapters(wgpu::Backends::all()));
    all.retain(computes);
    all.sort_by_key(rank);
    all
}

impl Gpu {
    /// Names of the adapters that can run the kernels, the one that [`Gpu::open`] prefers first. Software counts, and comes last.
    pub fn names() -> Vec<String> {
        adapters().iter().map(name_of).collect()
    }

    /// Opens the first adapter of [`Gpu::names`] that has `name_contains` in its name (upper or lower case), or the first of all.
    pub fn open(name_contains: Option<&str>) -> Result<Self, GpuError> {
        let all = adapters();
        if all.is_empty() {
            return Err(GpuError::NoAdapter);
        }
        let wanted = name_contains.unwrap_or_default().to_lowercase();
        let Some(adapter) = all.iter().find(|a| name_of(a).to_lowercase().contains(&wanted)) else {
            let found = all.iter().map(name_of).collect();
            return Err(GpuError::NoSuchAdapter {
                wanted: name_contains.unwrap_or_default().to_owned(),
                found,
            });
        };
        Self::of(adapter)
    }

    fn of(adapter: &wgpu::Adapter) -> Result<Self, GpuError> {
        let name = name_of(adapter);
        let limits = adapter.limits();
        let most_bytes =
            MOST_BYTES.min(limits.max_storage_buffer_binding_size).min(limits.max_buffer_size / 2);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("lobelia"),
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        };
        let (device, queue) = wait_for(adapter.request_device(&descriptor))
            .map_err(|cause| GpuError::Failed { name: name.clone(), cause: cause.to_string() })?;
        let failure = Arc::new(Mutex::new(None));
        let seen = Arc::clone(&failure);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            locked(&seen).get_or_insert_with(|| error.to_string());
        }));
        Ok(Self { device, queue, name, state: Mutex::default(), failure, most_bytes })
    }

    /// Name of the adapter and the interface that it is used through.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Runs `call` with pipelines and buffers, one call at a time. The state left by a failed call
    /// is dropped.
    pub(crate) fn with_state<T>(
        &self,
        call: impl FnOnce(&mut State) -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        let mut state = locked(&self.state);
        let result = call(&mut state);
        if result.is_err() {
            *state = State::default();
        }
        result
    }

    /// An error of this GPU.
    pub(crate) fn failed(&self, cause: impl ToString) -> GpuError {
        GpuError::Failed { name: self.name.clone(), cause: cause.to_string() }
    }

    /// The first failure since the last call of this, if any.
    fn check(&self) -> Result<(), GpuError> {
        locked(&self.failure).take().map_or(Ok(()), |cause| Err(self.failed(cause)))
    }

    /// Submits commands, waits for their end and returns the first `count` values of `buffer`.
    pub(crate) fn finish(
        &self,
        commands: wgpu::CommandBuffer,
        buffer: &wgpu::Buffer,
        count: usize,
    ) -> Result<Vec<f32>, GpuError> {
        let bytes = ..4 * count as u64;
        self.queue.submit([commands]);
        buffer.map_async(wgpu::MapMode::Read, bytes, |_| {});
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        waited.map_err(|cause| self.failed(cause))?;
        let view = buffer.get_mapped_range(bytes).map_err(|cause| self.failed(cause))?;
        let values = bytemuck::pod_collect_to_vec(&view);
        drop(view);
        buffer.unmap();
        Ok(values)
    }
}
