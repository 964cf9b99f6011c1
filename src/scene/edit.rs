//! Changes of the material: what is done, and where.

use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// One change of the material: `Diffuse(action: Set(0.8, 0.1, 0.1), region: Sphere(center: (0, 0.5, 0), radius: 0.3))`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Edit {
    /// Changes the diffuse albedo.
    Diffuse {
        /// What is done to it.
        action: DiffuseAction,
        /// Where. Default `All`.
        #[serde(default)]
        region: Region,
    },
    /// Changes the specular albedo.
    Specular {
        /// What is done to it.
        action: ColorAction,
        /// Where. Default `All`.
        #[serde(default)]
        region: Region,
    },
    /// Changes the roughness.
    Roughness {
        /// What is done to it.
        action: ScalarAction,
        /// Where. Default `All`.
        #[serde(default)]
        region: Region,
    },
}

impl Edit {
    /// Where the edit applies.
    pub fn region(&self) -> &Region {
        match self {
            Self::Diffuse { region, .. } | Self::Specular { region, .. } | Self::Roughness { region, .. } => {
                region
            }
        }
    }
}

/// What is done to the diffuse albedo; results are clamped to [0, 1].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum DiffuseAction {
    /// Replaces it: `Set(0.8, 0.1, 0.1)`, in [0, 1].
    Set(Vec3),
    /// Multiplies it: `Scale(1.2, 1, 1)`, ≥ 0.
    Scale(Vec3),
    /// Moves it toward a color: old + weight (color − old).
    Blend {
        /// The color, in [0, 1].
        color: Vec3,
        /// In [0, 1].
        weight: f32,
    },
    /// Replaces it by an image in texture space: PNG (sRGB) or EXR (linear); must exist. `Texture("paint.png")`.
    Texture(PathBuf),
}

/// What is done to a color; results are clamped to [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ColorAction {
    /// Replaces it: `Set(0.9, 0.65, 0.3)`, in [0, 1].
    Set(Vec3),
    /// Multiplies it: `Scale(1.2, 1, 1)`, ≥ 0.
    Scale(Vec3),
    /// Moves it toward a color: old + weight (color − old).
    Blend {
        /// The color, in [0, 1].
        color: Vec3,
        /// In [0, 1].
        weight: f32,
    },
}

/// What is done to the roughness; results are clamped to [0.03, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ScalarAction {
    /// Replaces it: `Set(0.15)`, in [0.03, 1].
    Set(f32),
    /// Multiplies it: `Scale(0.5)`, ≥ 0.
    Scale(f32),
    /// Moves it toward a value: old + weight (value − old).
    Blend {
        /// The value, in [0.03, 1].
        value: f32,
        /// In [0, 1].
        weight: f32,
    },
}

/// Where an edit applies.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Region {
    /// The whole object.
    #[default]
    All,
    /// Inside an axis-aligned box in world space.
    Box {
        /// Least corner.
        min: Vec3,
        /// Greatest corner; no coordinate below `min`'s.
        max: Vec3,
        /// Distance inside the walls over which the edit sets in, world units ≥ 0. Default 0: a hard edge.
        #[serde(default)]
        falloff: f32,
    },
    /// Inside a ball in world space.
    Sphere {
        /// Center.
        center: Vec3,
        /// Radius > 0.
        radius: f32,
        /// Distance inside the ball over which the edit sets in, world units ≥ 0. Default 0: a hard edge.
        #[serde(default)]
        falloff: f32,
    },
    /// Within a distance of a line in world space, as a brush paints it: around one point a ball.
    Stroke {
        /// The points that the line goes through, in order, straight from each to the next; 1 to 256.
        points: Vec<Vec3>,
        /// Greatest distance from the line, world units > 0.
        radius: f32,
        /// Distance inside the border over which the edit sets in, world units ≥ 0. Default 0: a hard edge.
        #[serde(default)]
        falloff: f32,
    },
    /// Where an image in texture space is bright (0: not at all, 1: fully); must exist. `Mask("belly.png")`.
    Mask(PathBuf),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stroke_is_written_as_it_is_read() {
        let text = "Stroke(points: [(0, 0.25, 0), (0.1, -2, 3)], radius: 0.5)";
        let region: Region = ron::from_str(text).unwrap();
        let points = vec![Vec3::new(0.0, 0.25, 0.0), Vec3::new(0.1, -2.0, 3.0)];
        assert_eq!(region, Region::Stroke { points, radius: 0.5, falloff: 0.0 });
        assert_eq!(ron::from_str::<Region>(&ron::to_string(&region).unwrap()).unwrap(), region);
    }
}
