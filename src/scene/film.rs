//! How films are described: where the camera is over time, and what changes of light and material.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// The camera at one time of a film. A value that no key gives is that of the orbit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OrbitKey {
    /// When, from 0 (first frame) to 1 (last frame); not before the key above it.
    pub at: f32,
    /// Angle around the object in degrees, counterclockwise from above; 0 is in front. Default: no key, and so one even turn.
    #[serde(default)]
    pub angle_degrees: Option<f32>,
    /// Height of the camera over the horizon in degrees, −89 to 89. Default: no key.
    #[serde(default)]
    pub elevation_degrees: Option<f32>,
    /// Distance from the object's center > 0. Default: no key.
    #[serde(default)]
    pub radius: Option<f32>,
    /// How the values change from the key before to this one. Default `Smooth`.
    #[serde(default)]
    pub easing: Easing,
}

/// How a value changes between two times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Easing {
    /// Evenly.
    Linear,
    /// Slowly at both ends.
    #[default]
    Smooth,
    /// Slowly at first.
    In,
    /// Slowly at last.
    Out,
    /// Not at all before the later time, and then at once.
    Hold,
}

impl Easing {
    /// The part of the change that is made at the part `t` of the time, both from 0 to 1.
    pub fn at(self, t: f32) -> f32 {
        let t = t.clamp(0.0, 1.0);
        match self {
            Self::Linear => t,
            Self::Smooth => t * t * (3.0 - 2.0 * t),
            Self::In => t * t,
            Self::Out => t * (2.0 - t),
            Self::Hold => t.floor(),
        }
    }
}

/// The light turns over the frames of a film.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightSweep {
    /// Axis of the turn. Default: the scene's `up`.
    pub axis: Option<Vec3>,
    /// Angle at the first frame in degrees. Default 0.
    pub from_degrees: f32,
    /// Angle one frame after the last, so that whole turns play without a break; with `Hold` at the last frame. Default 360.
    pub to_degrees: f32,
    /// How it changes. Default `Linear`.
    pub easing: Easing,
}

impl Default for LightSweep {
    fn default() -> Self {
        Self { axis: None, from_degrees: 0.0, to_degrees: 360.0, easing: Easing::Linear }
    }
}

/// The material changes over the frames of a film: factors on what the pass shows, at the first frame and at the last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MaterialSweep {
    /// Factors ≥ 0 on the roughness. Default (1, 1).
    pub roughness: (f32, f32),
    /// Factors ≥ 0 on the diffuse albedo. Default (1, 1).
    pub albedo: (f32, f32),
    /// Factors ≥ 0 on the specular albedo. Default (1, 1).
    pub specular: (f32, f32),
    /// How they change. Default `Linear`.
    pub easing: Easing,
}

impl Default for MaterialSweep {
    fn default() -> Self {
        Self { roughness: (1.0, 1.0), albedo: (1.0, 1.0), specular: (1.0, 1.0), easing: Easing::Linear }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn easings_begin_and_end_alike() {
        for easing in [Easing::Linear, Easing::Smooth, Easing::In, Easing::Out, Easing::Hold] {
            assert_eq!(
                (easing.at(-1.0), easing.at(0.0), easing.at(1.0), easing.at(2.0)),
                (0.0, 0.0, 1.0, 1.0)
            );
        }
        let early = |easing: Easing| easing.at(0.25);
        assert_eq!(early(Easing::Linear), 0.25);
        assert!(early(Easing::In) < early(Easing::Smooth) && early(Easing::Smooth) < 0.25);
        assert!(early(Easing::Out) > 0.25 && early(Easing::Hold) == 0.0);
    }
}
