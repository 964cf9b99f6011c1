//! The device on which closed forms shade, where a run names one.

use bevy_ecs::prelude::{Res, Resource};
use lobelia_geometry::error::{Error, Result};
use lobelia_sg::brdf::Ndf;
use lobelia_sg::shading::{ClosedForm, Cpu, PairLoops};
use std::sync::Arc;

/// The device of closed-form shading of objects with one base material; without it, and for all
/// else, this processor.
#[derive(Resource, Clone, Debug)]
pub struct ShadingDevice(pub Arc<dyn PairLoops>);

impl PartialEq for ShadingDevice {
    /// Whether both are the same device, opened once.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl ShadingDevice {
    /// The device of this name: `cpu`, `gpu` for the first graphics adapter, or a part of an
    /// adapter's name.
    ///
    /// # Errors
    /// [`Error::Usage`] if there is none, or if the program is built without the feature `gpu`.
    pub fn open(name: &str) -> Result<Self> {
        if name.eq_ignore_ascii_case("cpu") { Ok(Self(Arc::new(Cpu))) } else { open_gpu(name) }
    }
}

#[cfg(feature = "gpu")]
fn open_gpu(name: &str) -> Result<ShadingDevice> {
    let wanted = (!name.eq_ignore_ascii_case("gpu")).then_some(name);
    let gpu = lobelia_gpu::Gpu::open(wanted).map_err(|error| {
        Error::usage(format!("--device {name}: {error}"), "`--device cpu` needs nothing.")
    })?;
    Ok(ShadingDevice(Arc::new(gpu)))
}

#[cfg(not(feature = "gpu"))]
fn open_gpu(name: &str) -> Result<ShadingDevice> {
    let problem = format!("--device {name}: this program is built without the feature `gpu`");
    Err(Error::usage(problem, "Build it with `cargo build --release --features gpu`, or leave --device out."))
}

/// The loops that shade with this form: those of the device, as far as it has them.
pub(crate) fn loops_of(
    device: Option<&Res<ShadingDevice>>,
    form: ClosedForm,
    ndf: Ndf,
) -> Arc<dyn PairLoops> {
    let device = device.map(|device| &device.0).filter(|device| device.supports(form, ndf));
    device.cloned().unwrap_or_else(|| Arc::new(Cpu))
}

/// A failure of the device.
pub(crate) fn failed(problem: String) -> Error {
    Error::run("shading on the device of --device", problem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_is_not_there_is_named() {
        assert!(ShadingDevice::open("CPU").is_ok());
        let error = ShadingDevice::open("no such adapter").unwrap_err().to_string();
        assert!(error.contains("no such adapter"), "{error}");
    }
}
