//! The unbiased path tracer: the reference for closed forms, and the renderer for final quality.
//!
//! At every vertex of a path one direction is sampled from the light (next event estimation, with a
//! shadow ray) and one from the BRDF, in which the path continues; multiple importance sampling
//! weights both by the power heuristic. Nothing is clamped. The BRDF is that of PhySG supp. eqs.
//! 1–7; for materials with GGX, D is GGX itself, not the SGs that closed forms use for it. The BRDF
//! does not conserve energy: with high albedo and at grazing angles a vertex can reflect more light
//! than it receives, and the throughput of a long path in a concave object may then grow.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::{Surface, primitive::box_mesh};
//! use lobelia_solve::shade::path_tracer::{PathPoint, PathQuery, PathScene};
//! use lobelia_solve::shade::path_tracer::{PathSettings, shade_point};
//! use lobelia_world::light::{EnvironmentMap, illuminate::MapLight};
//! use lobelia_world::material::SpecularBlend;
//!
//! // The top of a box sees a sky of radiance one, and nothing else.
//! let surface = &Surface::new(box_mesh(Vec3::ZERO, Vec3::ONE)?, 16)?;
//! let light = &MapLight::new(EnvironmentMap::from_directions(8, 4, |_| Vec3::ONE));
//! let scene = PathScene { surface, light, diffuse: &[], blends: &[], specular: &[] };
//! let (position, normal, albedo) = (Vec3::new(0.1, 0.5, 0.2), Vec3::Y, Vec3::splat(0.5));
//! let blend = SpecularBlend::default().0;
//! let point = PathPoint { position, normal, geometric_normal: normal, albedo, blend };
//! let query = PathQuery { point, to_viewer: Vec3::Y, stream: 0, first_sample: 0 };
//! let found = shade_point(&scene, &PathSettings::default(), &query, 256);
//! assert!((found.diffuse.x - 0.5).abs() < 0.02 && found.rejected == 0);
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use crate::shade::sampling::{Scattered, Scatterer, above_zero, power_heuristic, sobol::Sequence};
use glam::{DVec3, Vec3};
use lobelia_geometry::{error::stop::is_stopping, parallel};
use lobelia_sg::ray::{Hit, Illuminate, Intersect, Ray, TexelAddress};
use lobelia_world::material::{Diffuse, MAX_SPECULAR_LOBES, Shown, SpecularBlend, SpecularLobe};

/// The scene that is rendered.
#[derive(Clone, Copy)]
pub struct PathScene<'a> {
    /// The surface.
    pub surface: &'a dyn Intersect,
    /// The distant light.
    pub light: &'a dyn Illuminate,
    /// Diffuse material of every texel of the surface.
    pub diffuse: &'a [Shown<Diffuse>],
    /// Blend weights of the base materials at every texel; empty if all of the surface is material
    /// 0.
    pub blends: &'a [Shown<SpecularBlend>],
    /// Base materials by number; `None` has no specular light.
    pub specular: &'a [Option<SpecularLobe>],
}

/// Settings of the path tracer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSettings {
    /// Most scattering events of a path; 1 is direct light only, 0 is black.
    pub max_bounces: u32,
    /// Seed of every random number.
    pub seed: u64,
    /// Scattering events before Russian roulette may end a path.
    pub roulette_after: u32,
    /// Offset of the ray origin from the surface along its geometric normal, in radii of the scene.
    pub ray_offset: f32,
}

impl Default for PathSettings {
    fn default() -> Self {
        Self { max_bounces: 6, seed: 0, roulette_after: 3, ray_offset: 2e-5 }
    }
}

/// A surface point to shade.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// World position.
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit geometric normal, same side as `normal`.
    pub geometric_normal: Vec3,
    /// Diffuse albedo toward the viewer, linear RGB in `[0, 1]`.
    pub albedo: Vec3,
    /// Blend weights of the base materials, summing to at most one.
    pub blend: [f32; MAX_SPECULAR_LOBES],
}

impl PathPoint {
    /// The point of a hit, with its material toward a viewer, interpolated from the texels.
    pub fn from_hit(hit: &Hit, to_viewer: Vec3, scene: &PathScene) -> Self {
        let TexelAddress { indices, weights } = hit.texels;
        let blend = match scene.blends {
            [] => SpecularBlend::default().0,
            blends => {
                std::array::from_fn(|k| (0..4).map(|i| blends[indices[i] as usize].0.0[k] * weights[i]).sum())
            }
        };
        let mixed = Diffuse::mixed(&hit.texels, |texel| scene.diffuse[texel].0);
        Self {
            position: hit.position,
            normal: hit.normal,
            geometric_normal: hit.geometric_normal,
            albedo: mixed.toward(hit.normal, to_viewer),
            blend,
        }
    }
}

/// A surface point, the direction to its viewer, and its random numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathQuery {
    /// The point.
    pub point: PathPoint,
    /// Unit direction from the point to the viewer.
    pub to_viewer: Vec3,
    /// Index of an independent stream of random numbers, e.g. the index of the pixel over all
    /// views.
    pub stream: u64,
    /// Index of the first sample in its stream: the points of one pixel (for antialiasing) have
    /// one stream and successive indices, so that its samples are well distributed together.
    pub first_sample: u32,
}

/// Outgoing radiance at a point, as a mean over samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathEstimate {
    /// Radiance of paths whose vertex next to the viewer scatters by the diffuse term (all bounces
    /// included), linear RGB.
    pub diffuse: Vec3,
    /// Radiance of paths whose vertex next to the viewer scatters by the specular term; the pixel
    /// is the sum of the two.
    pub specular: Vec3,
    /// Samples that are not finite and count as zero; a number above 0 indicates an error.
    pub rejected: u32,
}

/// Outgoing radiance at the point of `query` toward its viewer, from `samples` paths.
///
/// Zero if the viewer is below the horizon of the shading normal. The result depends on the
/// arguments only.
pub fn shade_point(
    scene: &PathScene,
    settings: &PathSettings,
    query: &PathQuery,
    samples: u32,
) -> PathEstimate {
    let (mut sums, mut rejected) = ([DVec3::ZERO; 2], 0);
    for sample in 0..samples {
        let sequence = Sequence::new(settings.seed, query.stream, query.first_sample.wrapping_add(sample));
        let mut path = Path { scene, settings, sequence, found: Split::default() };
        path.walk(query);
        let found = [path.found.diffuse, path.found.specular];
        if found.iter().all(|part| part.is_finite()) {
            sums.iter_mut().zip(found).for_each(|(sum, part)| *sum += part.as_dvec3());
        } else {
            rejected += 1;
        }
    }
    let [diffuse, specular] = sums.map(|sum| (sum / f64::from(samples.max(1))).as_vec3());
    PathEstimate { diffuse, specular, rejected }
}

/// [`shade_point`] for every query, in parallel; `out` is as long as `queries` (excess entries of
/// either are ignored).
///
/// Each result depends on its own query only, so that it is independent of threads and of the
/// partition of queries. A run that is stopping ([`is_stopping`]) leaves entries as they are.
pub fn shade_points(
    scene: &PathScene,
    settings: &PathSettings,
    queries: &[PathQuery],
    samples: u32,
    out: &mut [PathEstimate],
) {
    debug_assert_eq!(queries.len(), out.len());
    parallel::for_each(out.chunks_mut(CHUNK).zip(queries.chunks(CHUNK)), |(out, queries)| {
        for (estimate, query) in out.iter_mut().zip(queries) {
            if is_stopping() {
                return;
            }
            *estimate = shade_point(scene, settings, query, samples);
        }
    });
}

/// Points that a thread processes at a time.
const CHUNK: usize = 16;

/// A color in two parts: scattered by the diffuse term, and by the specular term, at the first
/// vertex.
#[derive(Clone, Copy, Debug, Default)]
struct Split {
    diffuse: Vec3,
    specular: Vec3,
}

impl Split {
    fn scaled(self, factor: f32) -> Self {
        Self { diffuse: self.diffuse * factor, specular: self.specular * factor }
    }

    fn tinted(self, tint: Vec3) -> Self {
        Self { diffuse: self.diffuse * tint, specular: self.specular * tint }
    }

    fn largest(self) -> f32 {
        self.diffuse.max_element().max(self.specular.max_element())
    }
}

/// Decisions at a vertex; each takes its own three random numbers.
const DECISIONS: u32 = 4;
const DRAW_LIGHT: u32 = 0;
const DRAW_BRDF: u32 = 1;
const ROULETTE: u32 = 2;
const PICK_MATERIAL: u32 = 3;

/// The state of one path.
struct Path<'a> {
    scene: &'a PathScene<'a>,
    settings: &'a PathSettings,
    sequence: Sequence,
    found: Split,
}

impl Path<'_> {
    /// Traces the path from the viewer's point until it leaves the scene, is absorbed, or has the
    /// maximum length.
    fn walk(&mut self, query: &PathQuery) {
        let mut point = query.point;
        let mut to_viewer = query.to_viewer;
        // Throughput to the viewer; `None` until the first scattering event splits it in two parts.
        let mut carried: Option<Split> = None;
        for depth in 1..=self.settings.max_bounces {
            let vertex = Vertex { point, carried, depth };
            let Some(scatterer) = self.scatterer(&point, to_viewer, depth) else { return };
            self.find_light(&vertex, &scatterer);
            let Some((direction, hit, onward)) = self.follow_brdf(&vertex, &scatterer) else { return };
            let Some(survived) = self.roulette(depth, onward) else { return };
            to_viewer = -direction;
            point = PathPoint::from_hit(&hit, to_viewer, self.scene);
            carried = Some(survived);
        }
    }

    fn scatterer(&self, point: &PathPoint, to_viewer: Vec3, depth: u32) -> Option<Scatterer> {
        let picked = self.scene.specular.get(self.pick_material(point, depth)).and_then(Option::as_ref);
        let specular = picked.map(|lobe| (lobe.albedo.to_array(), lobe.facets()));
        Scatterer::new(point.normal.to_array(), to_viewer.to_array(), point.albedo.to_array(), specular)
    }

    /// Samples one of the blended materials with a probability equal to its weight, so that the
    /// expected value is the blend. The remaining probability selects no material.
    fn pick_material(&self, point: &PathPoint, depth: u32) -> usize {
        if self.scene.specular.len() < 2 && self.scene.blends.is_empty() {
            return 0;
        }
        let sum: f32 = point.blend.iter().sum();
        // A sum that is one up to rounding counts as one.
        let whole = if sum > 1.0 - 1e-4 { sum } else { 1.0 };
        let mut rest = self.uniforms(depth, PICK_MATERIAL)[0] * whole;
        for (k, weight) in point.blend.iter().enumerate().take(self.scene.specular.len()) {
            if rest < *weight {
                return k;
            }
            rest -= weight;
        }
        if whole == sum { 0 } else { usize::MAX }
    }

    /// Next event estimation: a direction sampled from the light, weighted by multiple importance
    /// sampling.
    fn find_light(&mut self, vertex: &Vertex, scatterer: &Scatterer) {
        let drawn = self.scene.light.sample(self.uniforms(vertex.depth, DRAW_LIGHT));
        if !above_zero(drawn.pdf) {
            return;
        }
        let scattered = scatterer.evaluate(drawn.direction.to_array());
        let weight = power_heuristic(drawn.pdf, scattered.pdf) / drawn.pdf;
        let light = vertex.carry(&scattered).tinted(drawn.radiance).scaled(weight);
        if !above_zero(light.largest()) {
            return;
        }
        let ray = self.ray_from(&vertex.point, drawn.direction);
        if !self.scene.surface.occluded(&ray, 0.0, f32::INFINITY) {
            self.add(light);
        }
    }

    /// Samples a direction from the BRDF and adds its light; if the path may continue: the
    /// direction, what it meets, and the throughput.
    fn follow_brdf(&mut self, vertex: &Vertex, scatterer: &Scatterer) -> Option<(Vec3, Hit, Split)> {
        let direction = scatterer.sample(self.uniforms(vertex.depth, DRAW_BRDF))?;
        let scattered = scatterer.evaluate(direction);
        if !above_zero(scattered.pdf) {
            return None;
        }
        let carried = vertex.carry(&scattered).scaled(scattered.pdf.recip());
        let direction = Vec3::from(direction);
        let ray = self.ray_from(&vertex.point, direction);
        if vertex.depth == self.settings.max_bounces {
            // The path ends here: an occlusion test is enough.
            if !self.scene.surface.occluded(&ray, 0.0, f32::INFINITY) {
                self.add_background(direction, scattered.pdf, carried);
            }
            return None;
        }
        let hit = self.scene.surface.intersect(&ray, 0.0);
        if hit.is_none() {
            self.add_background(direction, scattered.pdf, carried);
        }
        Some((direction, hit?, carried))
    }

    /// Adds the light of a direction that is sampled from the BRDF.
    fn add_background(&mut self, direction: Vec3, pdf: f32, carried: Split) {
        let (radiance, light_pdf) = self.scene.light.radiance_and_pdf(direction);
        let weight = power_heuristic(pdf, light_pdf);
        if weight > 0.0 {
            self.add(carried.tinted(radiance).scaled(weight));
        }
    }

    /// Russian roulette: ends paths of low throughput at random and increases the weight of the
    /// others.
    fn roulette(&self, depth: u32, carried: Split) -> Option<Split> {
        if depth < self.settings.roulette_after {
            return Some(carried);
        }
        let survival = carried.largest().min(0.95);
        (self.uniforms(depth, ROULETTE)[0] < survival).then(|| carried.scaled(survival.recip()))
    }

    fn add(&mut self, light: Split) {
        self.found.diffuse += light.diffuse;
        self.found.specular += light.specular;
    }

    fn uniforms(&self, depth: u32, decision: u32) -> [f32; 3] {
        self.sequence.group(depth * DECISIONS + decision)
    }

    /// A ray with its origin offset from the surface, to the side of its direction.
    fn ray_from(&self, point: &PathPoint, direction: Vec3) -> Ray {
        // Far from the world origin, rounding of positions may exceed the offset.
        let offset = (self.settings.ray_offset * self.scene.surface.radius())
            .max(point.position.abs().max_element() * 1e-6);
        let side = if direction.dot(point.geometric_normal) < 0.0 { -offset } else { offset };
        Ray { origin: point.position + point.geometric_normal * side, direction }
    }
}

/// A vertex of the path.
struct Vertex {
    point: PathPoint,
    carried: Option<Split>,
    depth: u32,
}

impl Vertex {
    /// The throughput to the viewer after scattering with BRDF times cosine `scattered`.
    #[inline]
    fn carry(&self, scattered: &Scattered) -> Split {
        let (diffuse, specular) = (Vec3::from(scattered.diffuse), Vec3::from(scattered.specular));
        match self.carried {
            None => Split { diffuse, specular },
            Some(carried) => carried.tinted(diffuse + specular),
        }
    }
}

#[cfg(test)]
mod tests;
