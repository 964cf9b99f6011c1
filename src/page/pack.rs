//! Arrays of numbers in one compressed block of text, with a table of what is where. The mesh is
//! among them in 16-bit numbers: positions in its box, normals as octahedral coordinates, texture
//! coordinates in their range; and the data for shadows and reflected light under any light on the
//! page, as in [`visibility`](lobelia_solve::visibility).
//!
//! Each array may be kept as differences from the element `delta` places before, and its bytes are
//! sorted by significance; both make the block smaller under deflate, and `data.js` undoes them.
//! Numbers are little-endian.
//!
//! The hidden directions are kept for every texel, one picture of bits per direction: neighboring
//! texels are alike, and a picture of them is small once deflated. The patch that hides a direction
//! is kept for patches of the surface, of which there are at most `MOST_PATCHES`: cells of a grid
//! in space, divided by the side that the surface faces.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use flate2::{Compression, write::DeflateEncoder};
use glam::{IVec3, Vec2, Vec3};
use lobelia_geometry::{Error, Result, mesh::Surface, mesh::triangles::Mesh};
use lobelia_solve::{visibility::ObjectVisibility, visibility::texel_visibility::TexelVisibility};
use lobelia_world::{material::MAX_SPECULAR_LOBES, material::edit::MaterialState};
use serde_json::{Map, Value, json};
use std::{collections::HashMap, io::Write as _};

/// Arrays that are packed one after another.
#[derive(Default)]
pub(super) struct Pack {
    bytes: Vec<u8>,
    /// Where each array is in the block.
    pub table: Map<String, Value>,
}

impl Pack {
    /// Adds bytes as they are.
    pub fn bytes(&mut self, name: &str, values: &[u8]) {
        self.enter(name, "u8", 0, values.len());
        self.bytes.extend_from_slice(values);
    }

    /// Adds 16-bit numbers, as differences from the one `delta` places before (0: as they are).
    pub fn shorts(&mut self, name: &str, values: impl IntoIterator<Item = u16>, delta: usize) {
        self.planes(name, "u16", 2, delta, values.into_iter().map(u32::from).collect());
    }

    /// Adds finite single-precision numbers.
    pub fn floats(&mut self, name: &str, values: impl IntoIterator<Item = f32>) -> Result<()> {
        let bits: Vec<u32> = values.into_iter().map(f32::to_bits).collect();
        if let Some(bad) = bits.iter().position(|bits| !f32::from_bits(*bits).is_finite()) {
            return Err(Error::run("writing the page", format!("{name}: number {bad} is not finite")));
        }
        self.planes(name, "f32", 4, 0, bits);
        Ok(())
    }

    fn enter(&mut self, name: &str, kind: &str, delta: usize, count: usize) {
        let entry = json!({ "kind": kind, "at": self.bytes.len(), "count": count, "delta": delta });
        self.table.insert(name.to_owned(), entry);
    }

    /// Adds numbers of `width` bytes, as differences from the one `delta` places before (0: as they
    /// are): the lowest bytes of all, then the next.
    fn planes(&mut self, name: &str, kind: &str, width: usize, delta: usize, values: Vec<u32>) {
        self.enter(name, kind, delta, values.len());
        let before = |i: usize| if delta > 0 && i >= delta { values[i - delta] } else { 0 };
        let left = |i: usize| values[i].wrapping_sub(before(i)).to_le_bytes();
        for plane in 0..width {
            self.bytes.extend((0..values.len()).map(|i| left(i)[plane]));
        }
    }

    /// The block: deflated, in base64.
    pub fn block(&self) -> Result<String> {
        let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
        let deflated = encoder.write_all(&self.bytes).and_then(|()| encoder.finish());
        Ok(STANDARD.encode(deflated.map_err(|error| Error::run("compressing", error.to_string()))?))
    }
}

/// Largest 16-bit number, for fractions.
const MOST: f32 = 65535.0;

/// A range that fractions of 16 bits divide.
#[derive(Clone, Copy)]
pub(super) struct Range {
    /// Least value.
    pub low: f32,
    /// Greatest minus least, not 0.
    pub size: f32,
}

impl Range {
    fn fraction(self, value: f32) -> u16 {
        ((value - self.low) / self.size * MOST).round().clamp(0.0, MOST) as u16
    }

    fn of(values: impl Iterator<Item = f32>) -> Self {
        let (low, high) = values.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        match high - low {
            size if size > 0.0 => Self { low, size },
            _ => Self { low: if low.is_finite() { low } else { 0.0 }, size: 1.0 },
        }
    }
}

/// Octahedral coordinates of a unit direction as 16-bit fractions of [−1, 1].
fn octahedral(direction: Vec3) -> [u16; 2] {
    let sum = direction.abs().element_sum().max(f32::MIN_POSITIVE);
    let mut flat = Vec2::new(direction.x, direction.y) / sum;
    if direction.z < 0.0 {
        let sign = |x: f32| if x < 0.0 { -1.0 } else { 1.0 };
        flat = Vec2::new((1.0 - flat.y.abs()) * sign(flat.x), (1.0 - flat.x.abs()) * sign(flat.y));
    }
    flat.to_array().map(|value| Range { low: -1.0, size: 2.0 }.fraction(value))
}

/// Packs the mesh and returns the ranges of its numbers.
pub(super) fn pack_mesh(pack: &mut Pack, mesh: &Mesh) -> Value {
    let axes: [Range; 3] = [0, 1, 2].map(|c| Range::of(mesh.positions.iter().map(|p| p[c])));
    let uvs = mesh.uvs.as_deref().unwrap_or_default();
    let texture: [Range; 2] = [0, 1].map(|c| Range::of(uvs.iter().map(|uv| uv[c])));
    let positions = mesh.positions.iter().flat_map(|p| [0, 1, 2].map(|c| axes[c].fraction(p[c])));
    pack.shorts("positions", positions, 3);
    pack.shorts("normals", mesh.normals.iter().flat_map(|normal| octahedral(*normal)), 2);
    let places = uvs.iter().flat_map(|uv| [0, 1].map(|c| texture[c].fraction(uv[c])));
    pack.shorts("uvs", places, 2);
    pack.planes("triangles", "u32", 4, 1, mesh.triangles.as_flattened().to_vec());
    json!({
        "low": axes.map(|axis| axis.low), "size": axes.map(|axis| axis.size),
        "uvLow": texture.map(|axis| axis.low), "uvSize": texture.map(|axis| axis.size),
    })
}

/// Most patches: their numbers have 12 bits, and the last stands for none.
const MOST_PATCHES: usize = 4095;
/// The number that stands for no patch, and for back faces, which reflect nothing.
const NONE: u16 = 4095;
/// The part of a patch for which a direction is hidden is kept in this many steps.
const STEPS: f32 = 15.0;
/// Most bytes of bits, before they are deflated.
const MOST_BITS: usize = 1 << 28;

/// Packs the visibility of the texels of a surface.
pub(super) fn pack_visibility(
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
    pack.shorts("texelNormals", normals, 2);
    pack.bytes("hidden", &hidden_bits(texels));
    let (patches, of_texel) = patches(surface, texels);
    pack.shorts("patchOfTexel", of_texel.iter().copied(), 1);
    pack.shorts("hiders", hiders(texels, patches, &of_texel), 0);
    // The mean normal, albedo and blend weights of each patch.
    const EACH: usize = 6 + MAX_SPECULAR_LOBES;
    let mut sums = vec![[0.0; EACH]; patches];
    let mut counts = vec![0.0; patches];
    for (texel, row) in texels.covered() {
        let patch = usize::from(of_texel[texel]);
        let normal = texels.normals[row].to_array();
        let albedo = material.diffuse[texel].mean_albedo();
        let values = normal.into_iter().chain(albedo.to_array()).chain(material.blends[texel].0);
        sums[patch].iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        counts[patch] += 1.0;
    }
    let means = sums.iter().zip(&counts).flat_map(|(sum, count)| sum.map(|value| value / count));
    pack.floats("patchMeans", means)?;
    let directions = texels.directions.len();
    Ok(json!({ "directions": directions, "bounces": settings.bounces, "patches": patches }))
}

/// One picture of bits per direction: bit `t % 8` of byte `t / 8` is set if the direction is hidden
/// from texel `t`.
fn hidden_bits(texels: &TexelVisibility) -> Vec<u8> {
    let plane = texels.rows.len().div_ceil(8);
    let mut bits = vec![0; plane * texels.directions.len()];
    for (texel, row) in texels.covered() {
        for (direction, _) in texels.hidden(row) {
            bits[direction * plane + texel / 8] |= 1 << (texel % 8);
        }
    }
    bits
}

/// The patches of the finest grid that has few enough: their number, and the patch of each texel
/// ([`NONE`] for texels that are not covered).
fn patches(surface: &Surface, texels: &TexelVisibility) -> (usize, Vec<u16>) {
    let (_, radius) = surface.bounding_sphere();
    let mut cells = 32.0;
    loop {
        let cell = 2.0 * radius.max(f32::MIN_POSITIVE) / cells;
        let mut numbers: HashMap<(IVec3, usize), u16> = HashMap::new();
        let mut of_texel = vec![NONE; texels.rows.len()];
        for (texel, row) in texels.covered() {
            let at = (surface.atlas().position[texel] / cell).floor().as_ivec3();
            let next = numbers.len().min(usize::from(NONE)) as u16;
            of_texel[texel] = *numbers.entry((at, side(texels.normals[row]))).or_insert(next);
        }
        if numbers.len() < MOST_PATCHES {
            return (numbers.len(), of_texel);
        }
        cells *= 0.8;
    }
}

/// Which of six sides a normal faces.
fn side(normal: Vec3) -> usize {
    let along = normal.abs();
    let axis = if along.x >= along.y && along.x >= along.z { 0 } else { 1 + usize::from(along.z > along.y) };
    2 * axis + usize::from(normal[axis] < 0.0)
}

/// For each patch and direction: the patch that hides it, and above its 12 bits the part of the
/// texels for which it is hidden.
fn hiders(texels: &TexelVisibility, patches: usize, of_texel: &[u16]) -> Vec<u16> {
    let directions = texels.directions.len();
    let mut found = vec![NONE; patches * directions];
    let mut counts = vec![0u32; patches * directions];
    let mut sizes = vec![0u32; patches];
    for (texel, row) in texels.covered() {
        let patch = usize::from(of_texel[texel]);
        sizes[patch] += 1;
        for (direction, hider) in texels.hidden(row) {
            let at = patch * directions + direction;
            counts[at] += 1;
            if found[at] == NONE {
                let texel = texels.texels.get(hider as usize);
                found[at] = texel.map_or(NONE, |texel| of_texel[*texel as usize]);
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
pub(super) mod tests {
    use super::*;
    use flate2::read::DeflateDecoder;
    use lobelia_geometry::mesh::primitive::ball_over_plate;
    use lobelia_sg::fibonacci::fibonacci_axes;
    use lobelia_solve::visibility::VisibilitySettings;
    use lobelia_world::material::{Diffuse, SpecularBlend};
    use std::io::Read as _;

    /// The bytes of a block.
    pub fn unpacked(block: &str) -> Vec<u8> {
        let packed = STANDARD.decode(block).unwrap();
        let mut bytes = Vec::new();
        DeflateDecoder::new(&packed[..]).read_to_end(&mut bytes).unwrap();
        bytes
    }

    /// The value of a fraction, as the page decodes it.
    pub fn value(range: Range, fraction: u16) -> f32 {
        range.low + range.size * (f32::from(fraction) / MOST)
    }

    /// The direction of `octahedral` coordinates, likewise.
    pub fn direction(fractions: [u16; 2]) -> Vec3 {
        let [x, y] = fractions.map(|fraction| value(Range { low: -1.0, size: 2.0 }, fraction));
        let z = 1.0 - x.abs() - y.abs();
        let fold = (-z).max(0.0);
        Vec3::new(x - fold.copysign(x), y - fold.copysign(y), z).normalize_or(Vec3::Z)
    }

    #[test]
    fn arrays_lie_where_the_table_says() {
        let mut pack = Pack::default();
        pack.bytes("a", &[7, 8, 9]);
        pack.shorts("b", [1, 0x203, 0xffff, 0], 2);
        pack.planes("c", "u32", 4, 1, vec![5, 4]);
        pack.floats("d", [1.0]).unwrap();
        let bytes = unpacked(&pack.block().unwrap());
        assert_eq!(bytes[..3], [7, 8, 9]);
        // 1, 0x203, 0xfffe, 0xfdfd: low bytes, then high bytes.
        assert_eq!(bytes[3..11], [1, 3, 0xfe, 0xfd, 0, 2, 0xff, 0xfd]);
        assert_eq!(bytes[11..19], [5, 0xff, 0, 0xff, 0, 0xff, 0, 0xff]);
        assert_eq!(bytes[19..], 1.0f32.to_le_bytes());
        let at: Vec<u64> = ["a", "b", "c", "d"].map(|name| pack.table[name]["at"].as_u64().unwrap()).into();
        assert_eq!(at, [0, 3, 11, 19]);
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let mut pack = Pack::default();
        assert!(pack.floats("x", [0.0, f32::NAN]).unwrap_err().to_string().contains("number 1"));
        assert!(pack.floats("x", [f32::INFINITY]).is_err());
    }

    #[test]
    fn a_range_of_one_value_has_it() {
        let flat = Range::of([2.0; 3].into_iter());
        assert_eq!(value(flat, flat.fraction(2.0)), 2.0);
    }

    /// A ball over a plate.
    fn scenery() -> (Surface, TexelVisibility) {
        let mesh = ball_over_plate(0.1, 0.6, 0.4);
        let surface = Surface::new(mesh, 48).unwrap();
        let texels = TexelVisibility::trace(surface.atlas(), &surface, fibonacci_axes(128), usize::MAX);
        (surface, texels)
    }

    #[test]
    fn the_planes_hold_the_same_bits() {
        let (_, texels) = scenery();
        let bits = hidden_bits(&texels);
        let plane = texels.rows.len().div_ceil(8);
        let mut set = 0;
        for row in 0..texels.row_count() {
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
        let visibility = ObjectVisibility::new(&surface, VisibilitySettings::default());
        let count = surface.atlas().position.len();
        let material = MaterialState {
            diffuse: vec![Diffuse::default(); count],
            blends: vec![SpecularBlend::even(1); count],
            lobes: vec![None],
        };
        let mut pack = Pack::default();
        pack_visibility(&mut pack, &surface, &material, &visibility).unwrap();
        let count = 3 * visibility.texels().directions.len();
        // The first array.
        let number = |i: usize| std::array::from_fn(|plane| pack.bytes[plane * count + i]);
        let ways: Vec<f32> = (0..count).map(|i| f32::from_le_bytes(number(i))).collect();
        let ways: Vec<Vec3> = ways.chunks_exact(3).map(Vec3::from_slice).collect();
        assert_eq!(ways, visibility.texels().directions);
        // Not in the order of the spiral.
        assert_ne!(ways, fibonacci_axes(ways.len()));
    }

    #[test]
    fn patches_are_small_and_know_what_hides_them() {
        let (surface, texels) = scenery();
        let (count, of_texel) = patches(&surface, &texels);
        assert!(count > 200 && count < MOST_PATCHES);
        let mut at = vec![None; count];
        for texel in &texels.texels {
            let place = surface.atlas().position[*texel as usize];
            let first = *at[usize::from(of_texel[*texel as usize])].get_or_insert(place);
            assert!(place.distance(first) < 0.3, "{place} {first}");
        }
        let table = hiders(&texels, count, &of_texel);
        let from_below = texels.directions.iter().position(|d| d.y < -0.95).unwrap();
        let ball = (0..count).find(|patch| at[*patch].is_some_and(|p| p.y < 0.25 && p.y > 0.2)).unwrap();
        let hider = table[ball * 128 + from_below];
        assert!(hider >> 12 > 8 && at[usize::from(hider & NONE)].unwrap().y < 0.11, "{hider}");
    }
}
