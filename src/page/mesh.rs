//! The mesh in 16-bit numbers: positions in its box, normals as octahedral coordinates, texture coordinates in their range.

use crate::mesh::triangles::Mesh;
use crate::page::pack::Pack;
use glam::{Vec2, Vec3};
use serde_json::{Value, json};

/// Largest 16-bit number, for fractions.
const MOST: f32 = 65535.0;

/// A range that fractions of 16 bits divide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range<V> {
    /// Least value.
    pub low: V,
    /// Greatest minus least, not 0.
    pub size: V,
}

impl Range<f32> {
    fn fraction(self, value: f32) -> u16 {
        ((value - self.low) / self.size * MOST).round().clamp(0.0, MOST) as u16
    }

    /// The value of a fraction.
    pub fn value(self, fraction: u16) -> f32 {
        self.low + self.size * (f32::from(fraction) / MOST)
    }

    fn of(values: impl Iterator<Item = f32>) -> Self {
        let (low, high) = values.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let size = high - low;
        if size > 0.0 {
            Self { low, size }
        } else {
            Self { low: if low.is_finite() { low } else { 0.0 }, size: 1.0 }
        }
    }
}

/// Octahedral coordinates of a unit direction as 16-bit fractions of [−1, 1].
pub(crate) fn octahedral(direction: Vec3) -> [u16; 2] {
    let sum = direction.abs().element_sum().max(f32::MIN_POSITIVE);
    let flat = Vec2::new(direction.x, direction.y) / sum;
    let folded = if direction.z < 0.0 {
        let sign = |x: f32| if x < 0.0 { -1.0 } else { 1.0 };
        Vec2::new((1.0 - flat.y.abs()) * sign(flat.x), (1.0 - flat.x.abs()) * sign(flat.y))
    } else {
        flat
    };
    let range = Range { low: -1.0, size: 2.0 };
    [range.fraction(folded.x), range.fraction(folded.y)]
}

/// The direction of `octahedral` coordinates, as the page decodes it.
pub fn direction(fractions: [u16; 2]) -> Vec3 {
    let range = Range { low: -1.0, size: 2.0 };
    let [x, y] = fractions.map(|fraction| range.value(fraction));
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    Vec3::new(x - fold.copysign(x), y - fold.copysign(y), z).normalize_or(Vec3::Z)
}

/// Packs the mesh and returns the ranges of its numbers.
pub(crate) fn pack_mesh(pack: &mut Pack, mesh: &Mesh) -> Value {
    let axes: [Range<f32>; 3] = [0, 1, 2].map(|c| Range::of(mesh.positions.iter().map(|p| p[c])));
    let uvs = mesh.uvs.as_deref().unwrap_or_default();
    let texture: [Range<f32>; 2] = [0, 1].map(|c| Range::of(uvs.iter().map(|uv| uv[c])));
    let positions = mesh.positions.iter().flat_map(|p| [0, 1, 2].map(|c| axes[c].fraction(p[c])));
    pack.shorts("positions", &positions.collect::<Vec<_>>(), 3);
    let normals = mesh.normals.iter().flat_map(|normal| octahedral(*normal));
    pack.shorts("normals", &normals.collect::<Vec<_>>(), 2);
    let places = uvs.iter().flat_map(|uv| [0, 1].map(|c| texture[c].fraction(uv[c])));
    pack.shorts("uvs", &places.collect::<Vec<_>>(), 2);
    pack.words("triangles", mesh.triangles.as_flattened(), 1);
    json!({
        "low": axes.map(|axis| axis.low), "size": axes.map(|axis| axis.size),
        "uvLow": texture.map(|axis| axis.low), "uvSize": texture.map(|axis| axis.size),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::fibonacci::fibonacci_axes;

    #[test]
    fn directions_come_back() {
        let axes = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
        for axis in fibonacci_axes(1000).into_iter().chain(axes) {
            assert!(direction(octahedral(axis)).distance(axis) < 1e-4, "{axis}");
        }
    }

    #[test]
    fn fractions_come_back_within_half_a_step() {
        let values = [-3.0, 5.0, 0.1, 4.99, -2.5];
        let range = Range::of(values.into_iter());
        for value in values {
            assert!((range.value(range.fraction(value)) - value).abs() <= 8.0 / MOST * 0.51);
        }
        let flat = Range::of([2.0; 3].into_iter());
        assert_eq!(flat.value(flat.fraction(2.0)), 2.0);
    }
}
