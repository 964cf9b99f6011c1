//! Adapters, the device, and the cached state of calls.

use crate::{buffers::Buffers, kernels::Pipelines};
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
    pub(crate) name: String,
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

/// The error of the adapter or device of this name.
fn failure_of(name: &str, cause: &dyn std::fmt::Display) -> String {
    format!("the GPU \"{name}\" failed: {cause}")
}

/// Whether an adapter can run the kernels.
fn computes(adapter: &wgpu::Adapter) -> bool {
    let limits = adapter.limits();
    limits.max_compute_workgroup_storage_size >= SHARED_BYTES
        && limits.max_storage_buffers_per_shader_stage >= STORAGE_BUFFERS
        && limits.max_compute_invocations_per_workgroup >= THREADS
}

/// Software comes last.
fn rank(adapter: &wgpu::Adapter) -> Option<usize> {
    use wgpu::DeviceType::{Cpu, DiscreteGpu, IntegratedGpu, Other, VirtualGpu};
    let kind = adapter.get_info().device_type;
    [DiscreteGpu, IntegratedGpu, VirtualGpu, Other, Cpu].iter().position(|known| *known == kind)
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

/// There is no adapter.
pub(crate) const NO_ADAPTER: &str = "no GPU adapter is there that can compute; install a Vulkan driver (Debian: \
    mesa-vulkan-drivers, which also has one in software)";

impl Gpu {
    /// Opens the first adapter that has `name_contains` in its name (upper or lower case), or the
    /// first of all. Software counts, and comes last.
    ///
    /// # Errors
    /// What is missing, or the failure of the adapter.
    pub fn open(name_contains: Option<&str>) -> Result<Self, String> {
        let all = adapters();
        if all.is_empty() {
            return Err(NO_ADAPTER.to_owned());
        }
        let wanted = name_contains.unwrap_or_default();
        let is_wanted = |a: &&wgpu::Adapter| name_of(a).to_lowercase().contains(&wanted.to_lowercase());
        let Some(adapter) = all.iter().find(is_wanted) else {
            let found: Vec<String> = all.iter().map(name_of).collect();
            return Err(format!(
                "no GPU adapter has \"{wanted}\" in its name; there are: {}",
                found.join(", ")
            ));
        };
        let name = name_of(adapter);
        let limits = adapter.limits();
        let most_bytes =
            MOST_BYTES.min(limits.max_storage_buffer_binding_size).min(limits.max_buffer_size / 2);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("lobelia"),
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        };
        let (device, queue) =
            wait_for(adapter.request_device(&descriptor)).map_err(|cause| failure_of(&name, &cause))?;
        let failure = Arc::new(Mutex::new(None));
        let seen = Arc::clone(&failure);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            locked(&seen).get_or_insert_with(|| error.to_string());
        }));
        Ok(Self { device, queue, name, state: Mutex::default(), failure, most_bytes })
    }

    /// Runs `call` with pipelines and buffers, one call at a time. The state left by a failed call
    /// is dropped.
    pub(crate) fn with_state(
        &self,
        call: impl FnOnce(&mut State) -> Result<(), String>,
    ) -> Result<(), String> {
        let mut state = locked(&self.state);
        let result = call(&mut state);
        if result.is_err() {
            *state = State::default();
        }
        result
    }

    /// Submits commands, waits for their end and returns the first `count` values of `buffer`.
    pub(crate) fn finish(
        &self,
        commands: wgpu::CommandBuffer,
        buffer: &wgpu::Buffer,
        count: usize,
    ) -> Result<Vec<f32>, String> {
        let bytes = ..4 * count as u64;
        self.queue.submit([commands]);
        buffer.map_async(wgpu::MapMode::Read, bytes, |_| {});
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        if let Some(cause) = locked(&self.failure).take() {
            return Err(failure_of(&self.name, &cause));
        }
        waited.map_err(|cause| failure_of(&self.name, &cause))?;
        let view = buffer.get_mapped_range(bytes).map_err(|cause| failure_of(&self.name, &cause))?;
        let values = bytemuck::pod_collect_to_vec(&view);
        drop(view);
        buffer.unmap();
        Ok(values)
    }
}
