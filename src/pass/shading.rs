//! How frames are shaded: the closed form or the path tracer that a pass asks for.

use crate::math::shading::ClosedForm;
use crate::pipeline::{Phase, Pipeline, Slot};
use crate::scene::{RenderSettings, Shading};
use crate::shade::{PathTracing, shade_closed_form, shade_path_traced};

/// Swaps in the shading system.
pub(crate) fn set_shading(pipeline: &mut Pipeline, settings: &RenderSettings, seed: u64) {
    let closed_form = match settings.shading {
        Shading::Accurate => ClosedForm::Accurate(settings.quality),
        Shading::Published => ClosedForm::Published,
        Shading::PathTraced { spp, max_bounces, .. } => {
            let rays = camera_rays(settings);
            let paths_per_sample = spp.div_ceil(rays);
            let paths = PathTracing { paths_per_sample, max_bounces, seed, samples_per_pixel: rays };
            pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced(paths));
            return;
        }
    };
    pipeline.swap(Phase::Frame, Slot::Shading, shade_closed_form(closed_form));
}

/// Camera rays per pixel of a picture whose noise is filtered away, at least: how they differ tells how much noise there is.
const DENOISED_RAYS: u32 = 4;

/// Camera rays per pixel: a path tracer with fewer paths than that takes one path a ray.
pub(crate) fn camera_rays(settings: &RenderSettings) -> u32 {
    match settings.shading {
        Shading::Accurate | Shading::Published => settings.samples_per_pixel,
        Shading::PathTraced { spp, denoise, .. } => {
            let wanted = settings.samples_per_pixel.max(if denoise { DENOISED_RAYS } else { 1 });
            let side = f64::from(wanted.min(spp)).sqrt().floor().max(1.0) as u32;
            side * side
        }
    }
}
