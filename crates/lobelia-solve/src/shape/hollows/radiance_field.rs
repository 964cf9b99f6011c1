//! A radiance field inside the hull: densities and colors at the vertices of a grid, and their fit
//! by volume rendering.
//!
//! A surface that is fitted cannot leap over the space between a lid and the floor below it. A
//! field of densities can: it begins nearly transparent, so that each photograph colors all that
//! lies along its rays, and what many rays agree on becomes dense. Colors do not depend on the
//! direction of view: that would explain a lid as well as what is seen through it.
//!
//! With the density of a sample σ = softplus(s) per cell and the step Δ in cells, its opacity is α =
//! 1 − exp(−σΔ), what reaches it T = Π (1 − α) over the samples before it, and the color of the
//! ray Σ T α c.
//!
//! Sources: Max, "Optical Models for Direct Volume Rendering", TVCG 1995; direct optimization of a
//! grid of densities and colors from coarse to fine (Sun, Sun and Chen, "Direct Voxel Grid
//! Optimization", CVPR 2022); smoothness by total variation (Fridovich-Keil et al., "Plenoxels",
//! CVPR 2022); Adam (Kingma and Ba, ICLR 2015).

use crate::shape::{neighbors, pictures::ColorPicture, size};
use glam::{UVec3, Vec3, Vec4, Vec4Swizzles};
use lobelia_geometry::{error::stop::is_stopping, parallel, sdf::SdfGrid};
use lobelia_sg::ray::Ray;
use rand::{RngExt, SeedableRng, rngs::SmallRng};

/// How far outside the surface the field reaches, in cells.
const REACH: f32 = 1.0;
/// Density of all that is outside, before the softplus.
const OUTSIDE: f32 = -6.0;
/// Density at which a fit begins, before the softplus: about 0.13 per cell.
const BEGIN: f32 = -2.0;
/// Length of a step, in cells.
const STEP: f32 = 0.6;
/// How far before the surface a ray begins, in cells.
const BEFORE: f32 = 1.0;
/// Transmittance below which a ray ends, and the most samples that it has.
const DARK: f32 = 1e-4;
const MOST_SAMPLES: usize = 400;
/// Opacity of a sample above which its color counts.
const FAINT: f32 = 1e-5;
/// Steps on the grid of half as many cells, and on the grid itself.
const STEPS: [u32; 2] = [600, 400];
/// Rays of a step: one for so many vertices of the field, at most so many.
const VERTICES_PER_RAY: usize = 4;
const MOST_RAYS: usize = 6144;
/// Adam: largest step of color and density, what is left of it at the end, decay of both moments,
/// smallest divisor.
const COLOR_RATE: f32 = 0.05;
const DENSITY_RATE: f32 = 0.4;
const LAST_RATE: f32 = 0.1;
const DECAY: (f32, f32) = (0.9, 0.99);
const SMALLEST: f32 = 1e-12;
/// Weight of the total variation of densities, and of the square of what passes through the whole
/// object.
const VARIATION: f32 = 1e-3;
const LEAK: f32 = 0.1;
/// Most parts of a step that are summed apart.
const MOST_PARTS: usize = 8;

/// Densities and colors at the vertices of a grid that are inside the object or near it.
#[derive(Clone)]
pub(super) struct RadianceField {
    /// The grid, without its values.
    pub grid: SdfGrid,
    /// The row in `values` of each vertex of the grid; 0 for those that are outside.
    pub rows: Vec<u32>,
    /// Whether the cell above each vertex has one that is not outside.
    holds: Vec<bool>,
    /// The vertex of each row; that of row 0 is meaningless.
    pub vertices: Vec<u32>,
    /// Color with the curve of sRGB, and density per cell before the softplus. Row 0 stands for all
    /// that is outside.
    pub values: Vec<Vec4>,
}

/// A ray of a fit: a pixel of a picture, and where along its ray the surface is.
pub(super) struct FieldRay {
    pub picture: u32,
    /// Index of the pixel in the picture's window.
    pub place: u32,
    /// Distance to the surface, world units.
    pub surface: f32,
}

/// The rays of a fit, and the pictures that they are of.
pub(super) struct FieldRays<'a> {
    pub pictures: &'a [ColorPicture],
    pub rays: Vec<FieldRay>,
}

impl FieldRays<'_> {
    /// A ray in the world, and the color that its picture shows there.
    pub fn of(&self, ray: &FieldRay) -> (Ray, Vec3) {
        let (picture, place) = (&self.pictures[ray.picture as usize], ray.place as usize);
        let pixel = picture.window.pixel(place, picture.camera.width);
        (picture.camera.pixel_ray(pixel as u32), picture.values[place].into())
    }
}

/// How far the indices of a cell's vertices are from that of its first, in a grid of `side`
/// vertices along each axis.
#[inline]
fn corners(side: usize) -> [usize; 8] {
    let (back, both) = (side * side, side + side * side);
    [0, 1, side, side + 1, back, back + 1, both, both + 1]
}

impl RadianceField {
    /// A nearly transparent field of one color.
    pub fn new(grid: &SdfGrid, color: Vec3) -> Self {
        let mut field = Self {
            grid: SdfGrid { values: Vec::new(), ..*grid },
            rows: vec![0; grid.values.len()],
            holds: vec![false; grid.values.len()],
            vertices: vec![0],
            values: vec![color.extend(OUTSIDE)],
        };
        for (vertex, distance) in grid.values.iter().enumerate() {
            if *distance < REACH * grid.spacing {
                field.rows[vertex] = field.vertices.len() as u32;
                field.vertices.push(vertex as u32);
                field.values.push(color.extend(BEGIN));
                let place = grid.vertex(vertex);
                for (k, offset) in (0..).zip(corners(grid.side as usize)) {
                    if place.cmpge(UVec3::new(k & 1, k >> 1 & 1, k >> 2)).all() {
                        field.holds[vertex - offset] = true;
                    }
                }
            }
        }
        field
    }

    pub fn position(&self, row: usize) -> Vec3 {
        self.grid.position(self.grid.vertex(self.vertices[row] as usize))
    }

    /// How far along a ray the grid ends, world units.
    pub fn exit(&self, ray: &Ray) -> f32 {
        let low = self.grid.origin;
        let high = low + Vec3::splat((self.grid.side - 1) as f32 * self.grid.spacing);
        let along = |axis: usize| match ray.direction[axis] {
            0.0 => f32::INFINITY,
            slope if slope > 0.0 => (high[axis] - ray.origin[axis]) / slope,
            slope => (low[axis] - ray.origin[axis]) / slope,
        };
        along(0).min(along(1)).min(along(2))
    }

    /// Rows of the eight vertices around a point, with their trilinear weights.
    #[inline]
    pub fn corners(&self, point: Vec3) -> ([u32; 8], [f32; 8]) {
        let (first, t) = self.cell(point);
        self.corners_of(first, t)
    }

    /// Returns the rows and weights of the vertices around a point; `None` if all of them are
    /// outside.
    #[inline]
    pub fn corners_inside(&self, point: Vec3) -> Option<([u32; 8], [f32; 8])> {
        let (first, t) = self.cell(point);
        self.holds[first].then(|| self.corners_of(first, t))
    }

    /// The first vertex of the cell around a point, and the position in the cell, in [0, 1]³.
    #[inline]
    fn cell(&self, point: Vec3) -> (usize, Vec3) {
        let last = (self.grid.side - 1) as f32;
        let at = ((point - self.grid.origin) / self.grid.spacing).clamp(Vec3::ZERO, Vec3::splat(last - 1e-3));
        let cell = at.as_uvec3();
        (self.grid.index(cell), at - cell.as_vec3())
    }

    #[inline]
    fn corners_of(&self, first: usize, t: Vec3) -> ([u32; 8], [f32; 8]) {
        let s = Vec3::ONE - t;
        let vertices = corners(self.grid.side as usize);
        let (low, high, far_low, far_high) = (s.y * s.z, t.y * s.z, s.y * t.z, t.y * t.z);
        let weights = [low, low, high, high, far_low, far_low, far_high, far_high];
        let across = [s.x, t.x, s.x, t.x, s.x, t.x, s.x, t.x];
        (vertices.map(|vertex| self.rows[first + vertex]), std::array::from_fn(|k| weights[k] * across[k]))
    }

    /// The row of the vertex nearest to a point; 0 outside.
    #[inline]
    pub fn nearest(&self, point: Vec3) -> usize {
        let at = ((point - self.grid.origin) / self.grid.spacing).round();
        if at.min_element() < 0.0 || at.max_element() > (self.grid.side - 1) as f32 {
            return 0;
        }
        self.rows[self.grid.index(at.as_uvec3())] as usize
    }
}

/// A point of a ray, as rendering it has met it.
pub(super) struct FieldSample {
    rows: [u32; 8],
    weights: [f32; 8],
    /// Color, and density before the softplus.
    value: Vec4,
    opacity: f32,
    /// Derivative of the softplus.
    slope: f32,
    /// Transmittance of the samples before it.
    transmittance: f32,
    /// Distance along the ray, world units.
    distance: f32,
}

/// Renders a ray whose surface is `surface` world units away: its color and what passes through the
/// whole object. `jitter` in [0, 1) is the share of a step by which samples are shifted. Leaves the
/// samples in `samples`.
pub(super) fn march(
    field: &RadianceField,
    ray: &Ray,
    surface: f32,
    jitter: f32,
    samples: &mut Vec<FieldSample>,
) -> (Vec3, f32) {
    samples.clear();
    let (mut color, mut transmittance) = (Vec3::ZERO, 1.0);
    let step = STEP * field.grid.spacing;
    let (first, exit) = (surface - BEFORE * field.grid.spacing, field.exit(ray));
    for k in 0..MOST_SAMPLES {
        let distance = first + (k as f32 + jitter) * step;
        if distance > exit {
            break;
        }
        let Some(sample) = sample_at(field, ray, distance, transmittance) else { continue };
        color += transmittance * sample.opacity * sample.value.xyz();
        transmittance *= 1.0 - sample.opacity;
        samples.push(sample);
        if transmittance < DARK {
            break;
        }
    }
    (color, transmittance)
}

/// The sample at a distance; `None` outside the field.
#[inline]
fn sample_at(field: &RadianceField, ray: &Ray, distance: f32, transmittance: f32) -> Option<FieldSample> {
    let (rows, weights) = field.corners_inside(ray.origin + distance * ray.direction)?;
    let value = (0..8).map(|k| field.values[rows[k] as usize] * weights[k]).sum::<Vec4>();
    let (density, slope) = softplus(value.w);
    let opacity = 1.0 - (-density * STEP).exp();
    Some(FieldSample { rows, weights, value, opacity, slope, transmittance, distance })
}

/// Adds the gradient of the field's values to `gradient`, from those of a ray's color and of what
/// passes through.
fn pull_back(samples: &[FieldSample], color: Vec3, passing: f32, gradient: &mut [Vec4]) {
    let last = samples.last().map_or(1.0, |s| s.transmittance * (1.0 - s.opacity));
    let mut behind = passing * last;
    for sample in samples.iter().rev() {
        let shown = color.dot(sample.value.xyz());
        let opacity = sample.transmittance * shown - behind / (1.0 - sample.opacity).max(DARK);
        behind += sample.transmittance * sample.opacity * shown;
        let density = opacity * (1.0 - sample.opacity) * STEP * sample.slope;
        let weight = sample.transmittance * sample.opacity;
        let own = if weight > FAINT { weight * color } else { Vec3::ZERO }.extend(density);
        for (row, share) in sample.rows.iter().zip(sample.weights) {
            gradient[*row as usize] += own * share;
        }
    }
}

/// Distance at which half of the light of a ray is stopped; `None` if more than that passes.
pub(super) fn depth(samples: &[FieldSample]) -> Option<f32> {
    let stopped = |sample: &&FieldSample| sample.transmittance * (1.0 - sample.opacity) < 0.5;
    samples.iter().find(stopped).map(|sample| sample.distance)
}

/// The softplus and its derivative. Without the exact logarithm near 1, which takes twice as long:
/// densities are not as small.
fn softplus(x: f32) -> (f32, f32) {
    if x > 15.0 {
        return (x, 1.0);
    }
    let power = x.exp();
    ((1.0 + power).ln(), power / (1.0 + power))
}

/// Fits a field within a surface to what rays show, first on half as many cells. Nearly transparent
/// where no ray passes.
pub(super) fn fit(grid: &SdfGrid, rays: &FieldRays) -> RadianceField {
    let mean = rays.rays.iter().map(|ray| rays.of(ray).1).sum::<Vec3>() / rays.rays.len().max(1) as f32;
    let mut random = SmallRng::seed_from_u64(0);
    let mut coarse = RadianceField::new(&grid.resampled((grid.side - 1).div_ceil(2)), mean);
    optimize(&mut coarse, rays, STEPS[0], &mut random);
    let mut fine = RadianceField::new(grid, mean);
    for row in 1..fine.values.len() {
        let (rows, weights) = coarse.corners(fine.position(row));
        let known = || rows.iter().zip(weights).filter(|(row, _)| **row > 0);
        let total: f32 = known().map(|(_, weight)| weight).sum();
        if total > 0.0 {
            fine.values[row] = known().map(|(row, w)| coarse.values[*row as usize] * w).sum::<Vec4>() / total;
        }
    }
    optimize(&mut fine, rays, STEPS[1], &mut random);
    fine
}

/// Steps of Adam, each with other rays.
fn optimize(field: &mut RadianceField, all: &FieldRays, steps: u32, random: &mut SmallRng) {
    let rays = &all.rays;
    let count = field.values.len();
    let rays_per_step = (count / VERTICES_PER_RAY).clamp(1, MOST_RAYS);
    let parts = rayon::current_num_threads().min(MOST_PARTS);
    let mut gradients = vec![vec![Vec4::ZERO; count]; parts];
    let mut moments = vec![[Vec4::ZERO; 2]; count];
    for step in (0..steps).take_while(|_| !rays.is_empty() && !is_stopping()) {
        let picks: Vec<(usize, f32)> =
            (0..rays_per_step).map(|_| (random.random_range(0..rays.len()), random.random())).collect();
        let chunks = gradients.iter_mut().zip(picks.chunks(rays_per_step.div_ceil(parts)));
        parallel::for_each(chunks, |(gradient, picks)| {
            gradient.fill(Vec4::ZERO);
            let mut samples = Vec::new();
            for (ray, jitter) in picks {
                // The loss is the squared difference of colors, and the square of what passes
                // through the whole object.
                let (line, shown) = all.of(&rays[*ray]);
                let (color, passing) = march(field, &line, rays[*ray].surface, *jitter, &mut samples);
                let scale = 1.0 / rays_per_step as f32;
                pull_back(&samples, 2.0 * scale * (color - shown), LEAK * scale * passing, gradient);
            }
        });
        let rate = LAST_RATE.powf(step as f32 / steps as f32);
        let rates = rate * Vec3::splat(COLOR_RATE).extend(DENSITY_RATE);
        let unbiased = (1.0 - DECAY.0.powi(step as i32 + 1), 1.0 - DECAY.1.powi(step as i32 + 1));
        let moved = |row: usize, [first, second]: &mut [Vec4; 2]| {
            let value = field.values[row];
            let mut gradient: Vec4 = gradients.iter().map(|gradient| gradient[row]).sum();
            if row == 0 {
                return value;
            }
            gradient.w += VARIATION / count as f32 * variation(field, row);
            *first = *first * DECAY.0 + gradient * (1.0 - DECAY.0);
            *second = *second * DECAY.1 + gradient * gradient * (1.0 - DECAY.1);
            let root = (*second / unbiased.1).map(f32::sqrt) + Vec4::splat(SMALLEST);
            value - rates * (*first / unbiased.0) / root
        };
        let mut values = vec![Vec4::ZERO; count];
        let columns = ((&mut *values, &mut *moments), 0..count);
        parallel::for_each_row(columns, 1024, |((value, moments), row)| *value = moved(row, moments));
        field.values = values;
    }
}

/// Derivative of Σ √(1 + Δ²) over the density of a row, with Δ its differences from its neighbors.
fn variation(field: &RadianceField, row: usize) -> f32 {
    let vertex = field.vertices[row] as usize;
    let of = |other: usize| match field.rows[other] as usize {
        0 => 0.0,
        other => {
            let difference = field.values[row].w - field.values[other].w;
            difference / (1.0 + difference * difference).sqrt()
        }
    };
    neighbors(vertex, size(&field.grid)).map(of).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_adjoint_of_a_ray_is_its_finite_difference() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 6, |p| p.length() - 0.7);
        let mut field = RadianceField::new(&grid, Vec3::splat(0.4));
        for row in 1..field.values.len() {
            let p = field.position(row);
            field.values[row] +=
                Vec4::new((3.0 * p.x).sin(), p.y, (2.0 * p.z).cos(), 2.0 * (4.0 * p.x + p.z).sin());
        }
        let ray =
            Ray { origin: Vec3::new(0.1, 0.2, 3.0), direction: Vec3::new(0.02, -0.05, -1.0).normalize() };
        let (by_color, by_passing) = (Vec3::new(0.7, -0.3, 0.5), 0.9);
        let mut samples = Vec::new();
        let mut loss = |field: &RadianceField| {
            let (color, passing) = march(field, &ray, 2.4, 0.3, &mut samples);
            f64::from(by_color.dot(color) + by_passing * passing)
        };
        let mut gradient = vec![Vec4::ZERO; field.values.len()];
        let mut marched = Vec::new();
        let (_, passing) = march(&field, &ray, 2.4, 0.3, &mut marched);
        assert!(passing > 0.01 && marched.len() > 8, "{passing} {}", marched.len());
        pull_back(&marched, by_color, by_passing, &mut gradient);
        let touched: Vec<usize> = (1..gradient.len()).filter(|row| gradient[*row] != Vec4::ZERO).collect();
        assert!(touched.len() > 20);
        for row in touched {
            for axis in Vec4::AXES {
                let mut moved = [field.clone(), field.clone()];
                moved[0].values[row] += 4e-2 * axis;
                moved[1].values[row] -= 4e-2 * axis;
                let numeric = (loss(&moved[0]) - loss(&moved[1])) / 8e-2;
                let exact = f64::from(gradient[row].dot(axis));
                assert!(
                    (numeric - exact).abs() < 3e-5 + 3e-3 * exact.abs(),
                    "{row} {axis}: {numeric} {exact}"
                );
            }
        }
    }

    #[test]
    fn rays_leave_out_only_what_is_outside() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 10, |p| p.length() - 0.6);
        let field = RadianceField::new(&grid, Vec3::ONE);
        let ray = Ray { origin: Vec3::new(0.1, 0.2, 3.0), direction: Vec3::NEG_Z };
        assert!((field.exit(&ray) - 4.0).abs() < 1e-5);
        for k in 0..200 {
            let point = ray.origin + 0.03 * k as f32 * ray.direction;
            let (rows, weights) = field.corners(point);
            assert_eq!(field.corners_inside(point), (rows != [0; 8]).then_some((rows, weights)), "{point}");
        }
    }
}
