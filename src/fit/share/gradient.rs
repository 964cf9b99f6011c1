//! What samples share, summed over processes.

use crate::error::Result;
use crate::fit::components::StepGradient;
use crate::math::shading::{LobeColumns, SpecularAdjoint};
use crate::ranks::packed::{Message, Received};

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
    *lobes = LobeColumns::zeros(lobes.len());
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
