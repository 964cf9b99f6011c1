//! What the page needs to find shadows and reflected light under any light, as [`visibility`](crate::visibility) does.
//!
//! Which directions are hidden is kept for every texel, one picture of bits per direction: neighboring texels are alike, and a
//! picture of them is small once deflated. What hides a direction is kept for patches of the surface, of which there are at most
//! `MOST_PATCHES`: cells of a grid in space, divided by the side that the surface faces.

use crate::error::{Error, Result};
use crate::material::MAX_SPECULAR_LOBES;
use crate::material::edit::MaterialState;
use crate::material::sheen::mean_albedo;
use crate::mesh::Surface;
use crate::page::mesh::octahedral;
use crate::page::pack::Pack;
use crate::visibility::ObjectVisibility;
use crate::visibility::texel_visibility::TexelVisibility;
use glam::{IVec3, Vec3};
use serde_json::{Value, json};
use std::collections::HashMap;

/// Most patches: their numbers have 12 bits, and the last stands for none.
pub(crate) const MOST_PATCHES: usize = 4095;
/// The number that stands for no patch, and for back faces, which reflect nothing.
const NONE: u16 = 4095;
/// The part of a patch for which a direction is hidden is kept in this many steps.
const STEPS: f32 = 15.0;
/// Most bytes of bits, before they are deflated.
const MOST_BITS: usize = 1 << 28;

/// Packs the visibility of the texels of a surface.
///
/// # Errors
/// [`Error::Usage`] for more texels × directions than a page can hold.
pub(crate) fn pack_visibility(
    pack: &mut Pack,
    surface: &Surface,
    material: &MaterialState,
    visibility: &ObjectVisibility,
) -> Result<Value> {
    let texels = visibility.texels();
    let (settings, atlas) = (visibility.settings(), surface.atlas());
    if atlas.covered.len().div_ceil(8) * texels.directions.len() > MOST_BITS {
        let size = format!("{} texels in {} directions", atlas.covered.len(), texels.directions.len());
        let help = "Lower `texture_size` or `visibility: Traced(directions: …)`, or say `visibility: None`.";
        return Err(Error::usage(format!("shadows of {size} do not fit into a page"), help));
    }
    let normals = atlas.normal.iter().flat_map(|normal| octahedral(*normal));
    pack.floats("ways", texels.directions.iter().flat_map(|direction| direction.to_array()))?;
    pack.shorts("texelNormals", &normals.collect::<Vec<_>>(), 2);
    pack.bytes("hidden", &planes(texels));
    let patches = Patches::new(surface, texels);
    pack.shorts("patchOfTexel", &patches.of_texel, 1);
    pack.shorts("hiders", &hiders(texels, &patches), 0);
    patches.pack_means(pack, texels, material)?;
    Ok(json!({
        "directions": texels.directions.len(), "bounces": settings.bounces, "patches": patches.count,
    }))
}

/// One picture of bits per direction: bit `t % 8` of byte `t / 8` is set if the direction is hidden from texel `t`.
fn planes(texels: &TexelVisibility) -> Vec<u8> {
    let plane = texels.rows.len().div_ceil(8);
    let mut bits = vec![0; plane * texels.directions.len()];
    for (texel, row) in texels.covered() {
        for (direction, _) in texels.hidden(row) {
            bits[direction * plane + texel / 8] |= 1 << (texel % 8);
        }
    }
    bits
}

/// Patches of a surface.
struct Patches {
    count: usize,
    /// The patch of each texel; [`NONE`] for texels that are not covered.
    of_texel: Vec<u16>,
}

impl Patches {
    /// The finest grid that has few enough patches.
    fn new(surface: &Surface, texels: &TexelVisibility) -> Self {
        let (_, radius) = surface.bounding_sphere();
        let mut cells = 32.0;
        loop {
            let patches = Self::on_grid(surface, texels, 2.0 * radius.max(f32::MIN_POSITIVE) / cells);
            if patches.count < MOST_PATCHES {
                return patches;
            }
            cells *= 0.8;
        }
    }

    fn on_grid(surface: &Surface, texels: &TexelVisibility, cell: f32) -> Self {
        let mut numbers: HashMap<(IVec3, usize), u16> = HashMap::new();
        let mut of_texel = vec![NONE; texels.rows.len()];
        for (texel, row) in texels.covered() {
            let at = (surface.atlas().position[texel] / cell).floor().as_ivec3();
            let next = numbers.len().min(usize::from(NONE)) as u16;
            of_texel[texel] = *numbers.entry((at, side(texels.normals[row]))).or_insert(next);
        }
        Self { count: numbers.len(), of_texel }
    }

    /// Packs the mean normal, albedo and blend weights of each patch.
    fn pack_means(&self, pack: &mut Pack, texels: &TexelVisibility, material: &MaterialState) -> Result<()> {
        const EACH: usize = 6 + MAX_SPECULAR_LOBES;
        let mut sums = vec![[0.0; EACH]; self.count];
        let mut counts = vec![0.0; self.count];
        for (texel, row) in texels.covered() {
            let patch = usize::from(self.of_texel[texel]);
            let normal = texels.normals[row].to_array();
            let albedo = mean_albedo(material.albedo[texel].0, material.sheen[texel].0);
            let values = normal.into_iter().chain(albedo.to_array()).chain(material.blends[texel].0);
            sums[patch].iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
            counts[patch] += 1.0;
        }
        let means = sums.iter().zip(&counts).flat_map(|(sum, count)| sum.map(|value| value / count));
        pack.floats("patchMeans", means)
    }
}

/// Which of six sides a normal faces.
fn side(normal: Vec3) -> usize {
    let along = normal.abs();
    let axis = if along.x >= along.y && along.x >= along.z { 0 } else { 1 + usize::from(along.z > along.y) };
    2 * axis + usize::from(normal[axis] < 0.0)
}

/// For each patch and direction: the patch that hides it, and above its 12 bits the part of the texels for which it is hidden.
fn hiders(texels: &TexelVisibility, patches: &Patches) -> Vec<u16> {
    let directions = texels.directions.len();
    let mut found = vec![NONE; patches.count * directions];
    let mut counts = vec![0u32; patches.count * directions];
    let mut sizes = vec![0u32; patches.count];
    for (texel, row) in texels.covered() {
        let patch = usize::from(patches.of_texel[texel]);
        sizes[patch] += 1;
        for (direction, hider) in texels.hidden(row) {
            let at = patch * directions + direction;
            counts[at] += 1;
            if found[at] == NONE {
                let texel = texels.texels.get(hider as usize);
                found[at] = texel.map_or(NONE, |texel| patches.of_texel[*texel as usize]);
            }
        }
    }
    let part = |at: usize| {
        let part = counts[at] as f32 / sizes[at / directions] as f32;
        if counts[at] == 0 { 0 } else { (STEPS * part).round().clamp(1.0, STEPS) as u16 }
    };
    found.iter().enumerate().map(|(at, hider)| hider | part(at) << 12).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::{DiffuseAlbedo, DiffuseSheen, DiffuseTilt, SpecularBlend};
    use crate::math::fibonacci::fibonacci_axes;
    use crate::mesh::primitive::ball_over_plate;
    use crate::visibility::VisibilitySettings;

    /// A ball over a plate.
    fn scenery() -> (Surface, TexelVisibility) {
        let mesh = ball_over_plate(0.1, 0.6, 0.4);
        let surface = Surface::new(mesh, 48).unwrap();
        let texels =
            TexelVisibility::trace(surface.atlas(), &surface, fibonacci_axes(128), usize::MAX, None).unwrap();
        (surface, texels)
    }

    #[test]
    fn the_planes_hold_the_same_bits() {
        let (_, texels) = scenery();
        let bits = planes(&texels);
        let plane = texels.rows.len().div_ceil(8);
        let mut set = 0;
        for row in 0..texels.len() {
            let texel = texels.texels[row] as usize;
            for (direction, _) in texels.hidden(row) {
                assert!(bits[direction * plane + texel / 8] >> (texel % 8) & 1 == 1);
                set += 1;
            }
        }
        assert!(set > 1000 && bits.iter().map(|byte| byte.count_ones()).sum::<u32>() == set);
    }

    #[test]
    fn the_page_has_the_directions_that_the_planes_are_of() {
        let (surface, _) = scenery();
        let visibility = ObjectVisibility::new(&surface, VisibilitySettings::default(), None).unwrap();
        let count = surface.atlas().position.len();
        let material = MaterialState {
            albedo: vec![DiffuseAlbedo::default(); count],
            sheen: vec![DiffuseSheen::default(); count],
            tilt: vec![DiffuseTilt::default(); count],
            blends: vec![SpecularBlend::even(1); count],
            lobes: vec![None],
        };
        let mut pack = Pack::default();
        pack_visibility(&mut pack, &surface, &material, &visibility).unwrap();
        let ways: Vec<Vec3> = pack.floats_of("ways").chunks_exact(3).map(Vec3::from_slice).collect();
        assert_eq!(ways, visibility.texels().directions);
        // Not in the order of the spiral.
        assert_ne!(ways, fibonacci_axes(ways.len()));
    }

    #[test]
    fn patches_are_small_and_know_what_hides_them() {
        let (surface, texels) = scenery();
        let patches = Patches::new(&surface, &texels);
        assert!(patches.count > 200 && patches.count < MOST_PATCHES);
        let mut at = vec![None; patches.count];
        for texel in &texels.texels {
            let place = surface.atlas().position[*texel as usize];
            let first = *at[usize::from(patches.of_texel[*texel as usize])].get_or_insert(place);
            assert!(place.distance(first) < 0.3, "{place} {first}");
        }
        let table = hiders(&texels, &patches);
        let from_below = texels.directions.iter().position(|d| d.y < -0.95).unwrap();
        let ball =
            (0..patches.count).find(|patch| at[*patch].is_some_and(|p| p.y < 0.25 && p.y > 0.2)).unwrap();
        let hider = table[ball * 128 + from_below];
        assert!(hider >> 12 > 8 && at[usize::from(hider & NONE)].unwrap().y < 0.11, "{hider}");
    }
}
