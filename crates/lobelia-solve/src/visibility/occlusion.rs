//! Kernels of [`crate::visibility`]: light on a set of directions, and the part of it that reaches
//! partly occluded texels and points.
//!
//! The set has D near-uniform directions, each the center of a cell of 4π/D steradians. A lobe of
//! sharpness λ is convolved with a Gaussian of the width of a cell, λ' = λ·λ_c/(λ + λ_c) with λ_c =
//! D/2 (2π/λ_c is a cell's solid angle), with the same power, so that no sharp lobe falls between
//! two directions.

use crate::visibility::texel_visibility::{TOGETHER, TexelVisibility};
use fearless_simd::Simd;
use glam::{Mat3, Vec3};
use lobelia_geometry::parallel;
use lobelia_sg::lanes::{Lanes, MAX_LANES, Row};
use lobelia_sg::real::{Real, dot};
use lobelia_sg::shading::LobeColumns;
use lobelia_sg::{accurate::diffuse::cosine_integral, brdf::ndf_sharpness, sg::sphere_integral};
use std::ops::Range;

/// Least sharpness of a lobe.
const LEAST_LOBE: f32 = 1e-6;
/// Exponent below which a lobe's weight counts as none (4e-18): long before weights are subnormal
/// numbers, with which processors are many times slower.
const LEAST_EXPONENT: f32 = -40.0;
/// Rows that a thread processes at a time.
const CHUNK: usize = 64;
/// Upper bound of the specular factor.
pub(crate) const MOST_MIRRORED: f32 = 8.0;

#[derive(Clone, Debug, Default)]
pub(crate) struct Sky {
    /// e^{λ'(ξ·d − 1)} of each lobe at each direction, or 0 below e to the power of
    /// [`LEAST_EXPONENT`]: those of 16 lobes at all directions, then those of the next 16 (padded
    /// as the columns are). What is read together, 32 KiB for 512 directions, stays in the nearest
    /// cache.
    weights: Vec<Row>,
    stride: usize,
    /// The convolved lobes, in columns: axis x, y, z, λ', amplitude r, g, b.
    lobes: [Vec<f32>; 7],
    /// The lobes as they are, in the same columns.
    narrow: [Vec<f32>; 7],
    /// The coordinates of the directions, in columns.
    pub directions: [Vec<f32>; 3],
    /// Radiance from each direction, in columns.
    pub radiance: [Vec<f32>; 3],
    /// The cone around each 16 directions.
    pub cones: Cones,
}

/// Cones around 16 directions each, in columns.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cones {
    /// The coordinates of the axes.
    pub axes: [Vec<f32>; 3],
    /// Cosine and sine of the angle from the axis to the edge.
    pub edge: [Vec<f32>; 2],
}

impl Cones {
    fn around(directions: &[Vec3]) -> Self {
        let mut cones = Self::default();
        for directions in directions.chunks(TOGETHER) {
            let axis = directions.iter().sum::<Vec3>().normalize_or(Vec3::Y);
            let cosine = directions.iter().map(|d| d.dot(axis)).fold(1.0, f32::min);
            let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
            cones.axes.iter_mut().zip(axis.to_array()).for_each(|(column, c)| column.push(c));
            cones.edge.iter_mut().zip([cosine, sine]).for_each(|(column, c)| column.push(c));
        }
        let padded = cones.edge[0].len().next_multiple_of(MAX_LANES);
        cones.axes.iter_mut().chain(&mut cones.edge).for_each(|column| column.resize(padded, 0.0));
        cones
    }
}

impl Sky {
    /// The light at `directions` of `lobes`, which are rotated into the world.
    pub fn new(directions: &[Vec3], lobes: &LobeColumns, world_from_light: Mat3) -> Self {
        let stride = lobes.stride();
        let padded: [Vec<f32>; 7] = std::array::from_fn(|c| vec![if c == 3 { 1.0 } else { 0.0 }; stride]);
        let mut sky = Self {
            weights: Vec::new(),
            stride,
            lobes: padded.clone(),
            narrow: padded,
            directions: std::array::from_fn(|axis| directions.iter().map(|d| d[axis]).collect()),
            radiance: Default::default(),
            cones: Cones::around(directions),
        };
        let cell = directions.len() as f32 / 2.0;
        for (i, lobe) in (0..lobes.len()).map(|i| lobes.get(i)).enumerate() {
            let [x, y, z] = (world_from_light * Vec3::from(lobe.axis)).into();
            let sharpness = widened(lobe.sharpness, cell);
            let put = |columns: &mut [Vec<f32>; 7], sharpness: f32, [r, g, b]: [f32; 3]| {
                let values = [x, y, z, sharpness, r, g, b];
                columns.iter_mut().zip(values).for_each(|(column, value)| column[i] = value);
            };
            put(&mut sky.narrow, lobe.sharpness.max(LEAST_LOBE), lobe.amplitude);
            let integral = |sharpness: f32| sphere_integral(f64::from(sharpness)) as f32;
            let factor = integral(lobe.sharpness) / integral(sharpness);
            put(&mut sky.lobes, sharpness, lobe.amplitude.map(|a| a * factor));
        }
        let weights_at = |group: usize, direction: Vec3| {
            let weight = |lane: usize| {
                let [x, y, z, sharpness] = std::array::from_fn(|c| sky.lobes[c][group * MAX_LANES + lane]);
                let exponent = sharpness * (Vec3::new(x, y, z).dot(direction) - 1.0);
                if exponent < LEAST_EXPONENT { 0.0 } else { exponent.exp() }
            };
            Row(std::array::from_fn(weight))
        };
        let of_group = |group: usize| directions.iter().map(move |direction| weights_at(group, *direction));
        sky.weights = parallel::flat_map(stride / MAX_LANES, 1, of_group);
        // The sum of all lobes at each direction.
        let sum_at = |direction: usize| {
            let columns = &sky.lobes;
            let groups = sky.weights.iter().skip(direction).step_by(directions.len());
            let weights = groups.flat_map(|row| &row.0).enumerate();
            let radiance = |i: usize| Vec3::new(columns[4][i], columns[5][i], columns[6][i]);
            weights.map(|(i, weight)| radiance(i) * *weight).sum::<Vec3>()
        };
        let radiance: Vec<Vec3> = parallel::map(directions.len(), 1, sum_at);
        sky.radiance = std::array::from_fn(|c| radiance.iter().map(|r| r[c]).collect());
        sky
    }

    /// Radiance of the lobes around a direction, convolved with a Gaussian of this sharpness (well
    /// above 1).
    pub fn toward(&self, direction: Vec3, sharpness: f32) -> Vec3 {
        lobelia_sg::dispatch!(simd => light_toward(simd, &self.narrow, direction, sharpness))
    }

    pub fn radiance(&self, direction: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|c| self.radiance[c][direction]))
    }
}

/// [`Sky::toward`]: λ' = λ s/(λ + s), and by their nearly equal power, a' = a λ'/λ.
#[inline(always)]
fn light_toward<S: Simd>(simd: S, lobes: &[Vec<f32>; 7], direction: Vec3, sharpness: f32) -> Vec3 {
    let direction = direction.to_array().map(|c| Lanes::splat(simd, c));
    let [width, zero] = [sharpness, 0.0].map(|value| Lanes::splat(simd, value));
    let mut light = [zero; 3];
    for at in (0..lobes[0].len()).step_by(Lanes::<S>::LEN) {
        let column = |c: usize| Lanes::load(simd, &lobes[c][at..at + Lanes::<S>::LEN]);
        let part = width / (column(3) + width);
        let cosine = dot([column(0), column(1), column(2)], direction);
        let value = (column(3) * part * (cosine - cosine.one()).min(zero)).decay() * part;
        for (c, sum) in light.iter_mut().enumerate() {
            *sum += column(4 + c) * value;
        }
    }
    Vec3::from_array(light.map(Lanes::sum))
}

/// Sharpness of the lobe of the BRDF around the mirrored view, given that of the microfacet normals
/// (2/R⁴) and the cosine of the view (Wang et al. 2009).
pub(crate) fn sharpness_of_lobe(of_normals: f32, up: f32) -> f32 {
    of_normals / (4.0 * up.max(0.05))
}

/// The sharpness of a lobe after convolution with the Gaussian of a cell.
pub(crate) fn widened(sharpness: f32, cell: f32) -> f32 {
    sharpness * cell / (sharpness + cell)
}

/// The irradiance of each row of `visibility`; `parts` becomes the fraction of each lobe's
/// irradiance that reaches it, 0 to 255, in rows of the lobes' stride.
pub(crate) fn light_rows(visibility: &TexelVisibility, sky: &Sky, parts: &mut Vec<u8>) -> Vec<Vec3> {
    let (count, stride) = (visibility.row_count(), sky.stride);
    parts.clear();
    parts.resize(count * stride, 255);
    let mut direct = vec![Vec3::ZERO; count];
    if stride == 0 {
        return direct;
    }
    let chunks = parts.chunks_mut(CHUNK * stride).zip(direct.chunks_mut(CHUNK));
    parallel::for_each(chunks.enumerate(), |(chunk, (parts, direct))| {
        let first = chunk * CHUNK;
        light_chunk(visibility, sky, first..first + direct.len(), &mut Behind::default(), (parts, direct));
    });
    direct
}

/// Directions of some rows that other parts of the surface hide, and the light on the rows so far;
/// memory that is used again.
#[derive(Default)]
pub(crate) struct Behind {
    /// The hidden directions of the rows, one row after another: their numbers, and the cosines
    /// with the normal times a cell's solid angle.
    hidden: Vec<(u32, f32)>,
    /// Where the hidden directions of each row end.
    ends: Vec<usize>,
    /// Irradiance of each row so far, by lane of the lobes.
    irradiance: Vec<[Row; 3]>,
}

/// [`light_rows`] for some of the rows; overwrites `parts` and `direct` of these.
pub(crate) fn light_chunk(
    visibility: &TexelVisibility,
    sky: &Sky,
    rows: Range<usize>,
    behind: &mut Behind,
    (parts, direct): (&mut [u8], &mut [Vec3]),
) {
    behind.hidden.clear();
    behind.ends.clear();
    behind.irradiance.clear();
    behind.irradiance.resize(rows.len(), [Row::ZERO; 3]);
    let cell = cell_angle(visibility);
    for row in rows.clone() {
        let normal = visibility.normals[row];
        let cosine = |d: usize| visibility.directions[d].dot(normal);
        behind.hidden.extend(visibility.hidden(row).map(|(d, _)| (d as u32, cell * cosine(d))));
        behind.ends.push(behind.hidden.len());
    }
    lobelia_sg::dispatch!(simd => light_all(simd, sky, &visibility.normals[rows], behind, parts));
    for (direct, light) in direct.iter_mut().zip(&behind.irradiance) {
        *direct = Vec3::from_array(light.map(|row| row.0.iter().sum()));
    }
}

/// All lobes, 16 after 16, for all rows: the parts of them that arrive, as bytes, and their
/// irradiance.
#[inline(always)]
fn light_all<S: Simd>(simd: S, sky: &Sky, normals: &[Vec3], behind: &mut Behind, parts: &mut [u8]) {
    let count = sky.directions[0].len();
    for group in 0..sky.stride / MAX_LANES {
        let weights = &sky.weights[group * count..(group + 1) * count];
        let mut begin = 0;
        for (i, normal) in normals.iter().enumerate() {
            let normal = normal.to_array().map(|c| Lanes::splat(simd, c));
            let hidden = &behind.hidden[begin..behind.ends[i]];
            begin = behind.ends[i];
            for lane in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
                let at = group * MAX_LANES + lane;
                let column = |c: usize| Lanes::load(simd, &sky.lobes[c][at..at + Lanes::<S>::LEN]);
                let all = cosine_integral(column(3), dot([column(0), column(1), column(2)], normal)).value;
                let hidden = light_behind(simd, weights, lane, hidden);
                let part = (all.one() - hidden / all.max(all.lit(1e-9))).relu();
                let mut bytes = Row::ZERO;
                part.store(&mut bytes.0[..Lanes::<S>::LEN]);
                let parts = &mut parts[i * sky.stride + at..][..Lanes::<S>::LEN];
                for (out, part) in parts.iter_mut().zip(&bytes.0) {
                    *out = (part * 255.0 + 0.5) as u8;
                }
                for (c, sum) in behind.irradiance[i].iter_mut().enumerate() {
                    (column(4 + c) * all * part).add_to(&mut sum.0[lane..lane + Lanes::<S>::LEN]);
                }
            }
        }
    }
}

/// The sums over the `hidden` directions of the weights of a vector of lobes, from a lane of their
/// group on.
#[inline(always)]
fn light_behind<S: Simd>(simd: S, weights: &[Row], lane: usize, hidden: &[(u32, f32)]) -> Lanes<S> {
    // Four sums, so that one multiplication need not wait for the one before it.
    let mut sums = [Lanes::splat(simd, 0.0); 4];
    let (fours, rest) = hidden.as_chunks::<4>();
    for four in fours {
        for k in 0..4 {
            let row = Lanes::load(simd, &weights[four[k].0 as usize].0[lane..lane + Lanes::<S>::LEN]);
            sums[k] = row.mul_add(Lanes::splat(simd, four[k].1), sums[k]);
        }
    }
    for (direction, cosine) in rest {
        let row = Lanes::load(simd, &weights[*direction as usize].0[lane..lane + Lanes::<S>::LEN]);
        sums[0] = row.mul_add(Lanes::splat(simd, *cosine), sums[0]);
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// Interreflected light of rows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bounce {
    /// Irradiance of each row from other parts of the surface.
    pub indirect: Vec<Vec3>,
    /// Outgoing radiance of each row, as if all reflection were diffuse.
    pub leaving: Vec<Vec3>,
    /// Radiance and reflection of each row for the rays of narrow lobes.
    pub mirrors: Vec<Mirror>,
}

/// How a texel reflects light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reflectance {
    /// Diffuse albedo.
    pub diffuse: Vec3,
    /// Specular albedo.
    pub specular: Vec3,
    /// Roughness R of its specular lobe.
    pub roughness: f32,
}

/// A row that is mirrored in another.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Mirror {
    /// Outgoing diffuse radiance.
    pub diffuse: Vec3,
    /// Specular albedo.
    pub albedo: Vec3,
    /// Sharpness of its microfacet normals.
    pub sharpness: f32,
}

impl Mirror {
    /// The sum with another of this weight.
    pub fn plus(&self, other: &Self, weight: f32) -> Self {
        Self {
            diffuse: self.diffuse + other.diffuse * weight,
            albedo: self.albedo + other.albedo * weight,
            sharpness: self.sharpness + other.sharpness * weight,
        }
    }
}

impl Bounce {
    /// Propagates the `direct` irradiance of each row for `bounces` reflections, with a
    /// `reflectance` per texel.
    pub fn new(
        visibility: &TexelVisibility,
        direct: &[Vec3],
        of: &(dyn Fn(u32) -> Reflectance + Sync),
        bounces: u32,
    ) -> Self {
        let rows = visibility.row_count();
        let values = |Reflectance { diffuse, specular, roughness }: Reflectance| {
            [(diffuse + specular).min(Vec3::ONE), diffuse.min(Vec3::ONE), specular, Vec3::splat(roughness)]
        };
        let reflectance = visibility.means(&|texel| values(of(texel)));
        let radiance = |albedo: Vec3, irradiance: Vec3| albedo * irradiance * std::f32::consts::FRAC_1_PI;
        let sent = |row: usize, irradiance: Vec3| radiance(reflectance[row][0], irradiance);
        let mut leaving: Vec<Vec3> = direct.iter().enumerate().map(|(row, e)| sent(row, *e)).collect();
        let mut indirect = vec![Vec3::ZERO; rows];
        for _ in 0..bounces {
            // From the texels that occlude directions.
            let gathered = |row: usize| {
                let normal = visibility.normals[row];
                let light = visibility.hidden(row).map(|(d, hider)| {
                    let sent = leaving.get(hider as usize).map_or(Vec3::ZERO, |sent| *sent);
                    sent * visibility.directions[d].dot(normal)
                });
                light.sum::<Vec3>() * cell_angle(visibility)
            };
            indirect = parallel::map(rows, 64, gathered);
            let both = direct.iter().zip(&indirect).enumerate();
            leaving = both.map(|(row, (direct, indirect))| sent(row, *direct + *indirect)).collect();
        }
        let mirror = |row: usize| {
            let [_, diffuse, albedo, roughness] = reflectance[row];
            let diffuse = radiance(diffuse, direct[row] + indirect[row]);
            Mirror { diffuse, albedo, sharpness: ndf_sharpness(roughness.x) }
        };
        let mirrors = parallel::map(rows, 64, mirror);
        Self { indirect, leaving, mirrors }
    }
}

fn cell_angle(visibility: &TexelVisibility) -> f32 {
    4.0 * std::f32::consts::PI / visibility.directions.len() as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_geometry::mesh::{Surface, primitive::ball_over_plate};
    use lobelia_sg::{fibonacci::fibonacci_axes, sg::Lobe};

    #[test]
    fn parts_of_lobes_are_what_a_plain_sum_leaves() {
        let surface = Surface::new(ball_over_plate(0.02, 1.01, 0.3), 32).unwrap();
        let visibility = TexelVisibility::trace(surface.atlas(), &surface, fibonacci_axes(512), usize::MAX);
        // More than two groups of lobes, some of which are sharp enough to weigh nothing at most
        // directions.
        let lobe = |(i, axis): (usize, Vec3)| Lobe {
            axis: axis.into(),
            sharpness: [2.0, 30.0, 900.0][i % 3],
            amplitude: [0.5, 1.0, 0.1 * i as f32],
        };
        let lobes = LobeColumns::from_lobes(fibonacci_axes(40).into_iter().enumerate().map(lobe));
        let sky = Sky::new(&visibility.directions, &lobes, Mat3::IDENTITY);
        let mut parts = Vec::new();
        let direct = light_rows(&visibility, &sky, &mut parts);
        let cell = 4.0 * std::f32::consts::PI / 512.0;
        let mut counts = [0; 4];
        for row in 0..visibility.row_count() {
            let normal = visibility.normals[row];
            counts[visibility.hidden(row).count() % 4] += 1;
            let mut irradiance = Vec3::ZERO;
            for i in 0..lobes.len() {
                let [x, y, z, sharpness, r, g, b] = std::array::from_fn(|c| sky.lobes[c][i]);
                let axis = Vec3::new(x, y, z);
                let hidden = visibility.hidden(row).map(|(d, _)| visibility.directions[d]);
                let weight = |d: Vec3| (sharpness * (axis.dot(d) - 1.0)).exp() * d.dot(normal) * cell;
                let all = cosine_integral(sharpness, axis.dot(normal)).value;
                let part = (1.0 - hidden.map(weight).sum::<f32>() / all.max(1e-9)).max(0.0);
                irradiance += Vec3::new(r, g, b) * all * part;
                let found = f32::from(parts[row * sky.stride + i]) / 255.0;
                assert!(all < 1e-6 || (found - part.min(1.0)).abs() < 5e-3, "{row} {i}: {found} {part}");
            }
            assert!((direct[row] - irradiance).length() < 1e-3 * irradiance.length().max(1e-3), "row {row}");
        }
        assert!(counts.iter().all(|count| *count > 0), "{counts:?}");
        assert!(light_rows(&visibility, &Sky::default(), &mut parts).len() == visibility.row_count());
    }
}
