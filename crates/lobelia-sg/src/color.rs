//! Color: kernels work in linear Rec. 709; conversion from and to sRGB (IEC 61966-2-1).

/// Linear value in `[0, 1]` of an sRGB-encoded value in `[0, 1]`.
pub fn linear_from_srgb(encoded: f32) -> f32 {
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// sRGB-encoded value in `[0, 1]` of a linear value, which is clamped to `[0, 1]`.
pub fn srgb_from_linear(linear: f32) -> f32 {
    let linear = linear.clamp(0.0, 1.0);
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// Rec. 709 luminance of a linear RGB triple.
pub fn luminance(linear: glam::Vec3) -> f32 {
    linear.dot(glam::Vec3::new(0.2126, 0.7152, 0.0722))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_round_trips() {
        for i in 0..=255 {
            let encoded = i as f32 / 255.0;
            assert!((srgb_from_linear(linear_from_srgb(encoded)) - encoded).abs() < 1e-5);
        }
    }
}
