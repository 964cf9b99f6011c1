//! Rays, hits, and the two questions a renderer asks of a scene: what does a ray meet, and what light comes from there.

use glam::{Vec2, Vec3};

/// A half-line in world space; `direction` has unit length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start, in world units.
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
}

/// The four texels whose blend is the value at a surface point (bilinear weights, summing to one).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TexelAddress {
    /// Rows of the texel pool, `y * width + x`.
    pub indices: [u32; 4],
    /// Blend weights, in `[0, 1]`, summing to one.
    pub weights: [f32; 4],
}

impl TexelAddress {
    /// The blended value of `texels` here.
    pub fn blend(&self, texels: &[Vec3]) -> Vec3 {
        (0..4).map(|i| texels[self.indices[i] as usize] * self.weights[i]).sum()
    }
}

/// Where a ray meets the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray, in world units.
    pub distance: f32,
    /// World position.
    pub position: Vec3,
    /// Interpolated unit shading normal, world space, on the mesh's own outer side.
    pub normal: Vec3,
    /// Unit normal of the flat triangle (or of the analytic surface), same side as `normal`.
    pub geometric_normal: Vec3,
    /// Texture coordinates in the atlas, `[0, 1]²`, v down (texel row 0 is v = 0).
    pub uv: Vec2,
    /// Texels blended at this point.
    pub texels: TexelAddress,
}

/// Anything rays can be cast against.
pub trait Intersect: Send + Sync {
    /// Nearest hit at a distance in `(min_distance, ∞)`.
    fn intersect(&self, ray: &Ray, min_distance: f32) -> Option<Hit>;
    /// Whether anything is met at a distance in `(min_distance, max_distance)`.
    fn occluded(&self, ray: &Ray, min_distance: f32, max_distance: f32) -> bool;
    /// Radius of a ball around everything, world units: the measure of what is small. 1 unless a surface says otherwise.
    fn radius(&self) -> f32 {
        1.0
    }
}

/// A direction drawn from distant light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// Unit direction towards the light, world space.
    pub direction: Vec3,
    /// Radiance arriving from there, linear RGB.
    pub radiance: Vec3,
    /// Probability density per steradian; zero if no sample could be drawn.
    pub pdf: f32,
}

/// Distant light, seen from the origin.
pub trait Illuminate: Send + Sync {
    /// Radiance arriving from the unit `direction`, linear RGB.
    fn radiance(&self, direction: Vec3) -> Vec3;
    /// Draws a direction from three uniform numbers in `[0, 1)`.
    fn sample(&self, uniform: [f32; 3]) -> LightSample;
    /// Density per steradian with which [`Illuminate::sample`] draws `direction`.
    fn pdf(&self, direction: Vec3) -> f32;
}
