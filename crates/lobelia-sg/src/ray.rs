//! Rays, hits, and the two interfaces of a scene: intersection of rays with the surface, and
//! incident light. A surface or a light of your own implements one of them.

use glam::{Vec2, Vec3};

/// A half-line in world space; `direction` has unit length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start, in world units.
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
}

/// The four texels that are interpolated at a surface point, with bilinear weights that sum to one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TexelAddress {
    /// Indices of the texels, `y * width + x`.
    pub indices: [u32; 4],
    /// Weights in `[0, 1]` that sum to one.
    pub weights: [f32; 4],
}

impl TexelAddress {
    /// The interpolated value of `texels` here.
    pub fn blend(&self, texels: &[Vec3]) -> Vec3 {
        (0..4).map(|i| texels[self.indices[i] as usize] * self.weights[i]).sum()
    }

    /// The texel that counts most.
    pub fn main(&self) -> u32 {
        let most = (0..4).max_by(|a, b| self.weights[*a].total_cmp(&self.weights[*b]));
        self.indices[most.unwrap_or(0)]
    }
}

/// The intersection of a ray with the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray, in world units.
    pub distance: f32,
    /// World position.
    pub position: Vec3,
    /// Interpolated unit shading normal, world space, on the outer side of the mesh.
    pub normal: Vec3,
    /// Unit normal of the flat triangle (or of the analytic surface), same side as `normal`.
    pub geometric_normal: Vec3,
    /// Texture coordinates in the atlas, `[0, 1]²`, v down (texel row 0 is v = 0).
    pub uv: Vec2,
    /// The texels that are interpolated at this point.
    pub texels: TexelAddress,
}

/// A surface that rays can be cast against.
pub trait Intersect: Send + Sync {
    /// Nearest hit at a distance in `(min_distance, ∞)`.
    fn intersect(&self, ray: &Ray, min_distance: f32) -> Option<Hit>;
    /// [`Self::intersect`] of rays from one origin: `hits[i]` becomes that of `directions[i]`.
    /// Surfaces may be faster if directions are near those beside them; the default implementation
    /// casts one ray after another. There are as many hits as directions.
    fn intersect_packet(
        &self,
        origin: Vec3,
        directions: &[Vec3],
        min_distance: f32,
        hits: &mut [Option<Hit>],
    ) {
        for (hit, direction) in hits.iter_mut().zip(directions) {
            *hit = self.intersect(&Ray { origin, direction: *direction }, min_distance);
        }
    }
    /// Whether there is a hit at a distance in `(min_distance, max_distance)`.
    fn occluded(&self, ray: &Ray, min_distance: f32, max_distance: f32) -> bool;
    /// Radius of a ball around the surface, world units; small offsets are relative to it. The
    /// default implementation returns 1.
    fn radius(&self) -> f32 {
        1.0
    }
    /// Corners (least and greatest) of a box around the surface, world units. The default
    /// implementation does not know one.
    fn bounds(&self) -> Option<(Vec3, Vec3)> {
        None
    }
}

/// A direction drawn from distant light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// Unit direction toward the light, world space.
    pub direction: Vec3,
    /// Incident radiance from that direction, linear RGB.
    pub radiance: Vec3,
    /// Probability density per steradian; zero if no sample could be drawn.
    pub pdf: f32,
}

/// Distant light.
pub trait Illuminate: Send + Sync {
    /// Incident radiance from the unit `direction`, linear RGB.
    fn radiance(&self, direction: Vec3) -> Vec3;
    /// Draws a direction from three uniform numbers in `[0, 1)`.
    fn sample(&self, uniform: [f32; 3]) -> LightSample;
    /// Density per steradian with which [`Illuminate::sample`] draws `direction`.
    fn pdf(&self, direction: Vec3) -> f32;
    /// [`Illuminate::radiance`] and [`Illuminate::pdf`]; one may be had with the other.
    fn radiance_and_pdf(&self, direction: Vec3) -> (Vec3, f32) {
        (self.radiance(direction), self.pdf(direction))
    }
}
