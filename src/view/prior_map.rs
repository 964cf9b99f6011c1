//! What somebody else says of the surface in a photograph, pixel by pixel: a network's estimate, a drawing.

use crate::view::image::Image;
use crate::view::numbers::packed;
use crate::view::window::PixelWindow;
use bevy_ecs::prelude::{Component, World};
use glam::Vec3;
use half::f16;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Three numbers for the pixels of a view that have some, as half floats and only inside a window. A clone shares its memory.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PriorMap {
    width: u32,
    window: PixelWindow,
    /// Zero where nothing is known.
    #[serde(with = "packed")]
    values: Arc<[[f16; 3]]>,
}

impl PriorMap {
    /// Keeps what of a picture lies in a window; zero is a pixel of which nothing is known.
    pub fn new(image: &Image, window: PixelWindow) -> Self {
        let values = window.pixels(image.width).map(|i| image.pixels[i].to_array().map(f16::from_f32));
        Self { width: image.width, window, values: values.collect() }
    }

    /// What is known of pixel `y * width + x`.
    #[inline]
    pub fn at(&self, pixel: usize) -> Option<Vec3> {
        let value = Vec3::from(self.values[self.window.place(pixel, self.width)?].map(f16::to_f32));
        (value != Vec3::ZERO).then_some(value)
    }
}

/// Somebody's diffuse albedo of what a view shows: linear, known up to one factor for the whole picture.
#[derive(Component, Clone, Debug)]
pub struct AlbedoMap(pub PriorMap);

impl AlbedoMap {
    /// Whether a view has one, which is then where a fit of light and albedo begins.
    pub fn are_in(world: &mut World) -> bool {
        world.query::<&Self>().iter(world).next().is_some()
    }
}

/// Somebody's unit normals of what a view shows, in the world.
#[derive(Component, Clone, Debug)]
pub struct NormalMap(pub PriorMap);

/// The maps of a view.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct ViewPriors {
    /// Diffuse albedo, as in [`AlbedoMap`].
    pub albedo: Option<PriorMap>,
    /// Normals, as in [`NormalMap`].
    pub normals: Option<PriorMap>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_knows_the_pixels_of_its_window_that_are_not_zero() {
        let pixels = (0..20).map(|i| if i == 7 { Vec3::ZERO } else { Vec3::new(i as f32, -0.5, 0.25) });
        let image = Image { width: 5, height: 4, pixels: pixels.collect() };
        let map = PriorMap::new(&image, PixelWindow { x: 1, y: 1, width: 3, height: 2 });
        for i in 0..20 {
            let known = [6, 8, 11, 12, 13].contains(&i);
            assert_eq!(map.at(i), known.then(|| image.pixels[i]), "{i}");
        }
        assert_eq!(map.values.len(), 6);
    }
}
