//! The vertices of a mesh as parameters: they move along their normals to match the shading.
//!
//! For details that a grid cannot represent, and with all effects of mesh shading, including
//! shadows and reflections. The adjoint of the normal of a sample is propagated to the normals of
//! vertices, and through the areas of triangles to their positions. Steps are smoothed by (I +
//! λL)⁻², L the graph's Laplacian, as in Nicolet, Jacobson and Jakob, "Large Steps in Inverse
//! Rendering of Geometry" (2021). A printed pattern that the texture is too coarse for looks like
//! slopes and would move them as well. Masks are not deceived: every few moves the contours are
//! brought back to their outlines (`outline`).

use crate::fit::guard::{StepGuard, is_usable};
use crate::shape::shell::{Shell, VertexGraph, by_axis, pull_back_unit};
use crate::shape::systems::{OUTLIER, root_mean_square};
use crate::{fit::components::StepRates, shape::outline::OutlineGuide, shape::silhouette::Silhouette};
use bevy_ecs::prelude::{Res, ResMut, Resource};
use glam::Vec3;
use lobelia_geometry::mesh::{Surface, bvh::TriangleBvh, bvh::TriangleHit, triangles::Mesh};
use lobelia_geometry::parallel;
use lobelia_sg::shading::PointAdjoint;
use lobelia_world::pipeline::SystemResult;
use lobelia_world::sample::point::{Scenery, SurfacePoint};
use lobelia_world::sample::{Samples, pixel::ViewRay};
use std::sync::Arc;

/// Steps between two moves; adjoints are summed over these.
const MOVE_EVERY: u32 = 12;
/// Moves between two looks at the outlines of the masks.
const OUTLINES_EVERY: u32 = 4;
/// Fraction of the fit before the first move: light and material are fitted first.
const HELD: f32 = 0.25;
/// Root-mean-square length of the first and the last move, in mean edge lengths.
const RATES: (f32, f32) = (0.04, 0.004);
const SMOOTHING: f32 = 19.0;
/// λ of the low-frequency part of the displacement, which is removed at each move: the masks have
/// determined it already.
const WIDE: f32 = 200.0;
/// Largest displacement of a vertex, in mean edge lengths: it limits the effect of model errors.
const REACH: f32 = 0.2;
/// Decay factor of the running mean, per move.
const MEAN_DECAY: f32 = 0.8;

/// The mesh whose vertices fits optimize while it is in the world.
#[derive(Resource)]
pub struct MovingMesh {
    /// The current surface.
    pub surface: Arc<Surface>,
    /// Its merged vertices, as they were at the last look at the outlines.
    shell: Shell,
    /// The given positions of the merged vertices, and those now.
    start: Vec<Vec3>,
    positions: Vec<Vec3>,
    /// Adjoint of each vertex's unit normal, summed since the last move.
    adjoint: Vec<Vec3>,
    /// Running mean of the smoothed gradient of each vertex along its normal.
    moments: Vec<f32>,
    /// Guide that holds the contours, if there are masks.
    outlines: Option<OutlineGuide>,
    /// The hits of the rays of the window.
    found: Vec<Option<TriangleHit>>,
    /// Steps of the fit.
    steps: u32,
}

impl MovingMesh {
    /// A given mesh, before a fit of so many `steps`. The contours are to meet the outlines of
    /// `masks`, the training masks by [`Silhouette::new`]; there may be none.
    pub fn new(surface: Arc<Surface>, steps: u32, masks: Vec<Silhouette>) -> Self {
        let shell = Shell::new(surface.mesh());
        let guide = |masks| OutlineGuide::new(&shell, &TriangleBvh::new(surface.mesh()), masks);
        let outlines = (!masks.is_empty()).then(|| guide(masks.into()));
        Self {
            start: shell.positions.clone(),
            positions: shell.positions.clone(),
            adjoint: vec![Vec3::ZERO; shell.positions.len()],
            moments: vec![0.0; shell.positions.len()],
            surface,
            shell,
            outlines,
            found: Vec::new(),
            steps,
        }
    }
}

/// Trace: intersects the rays of the window with the current mesh.
pub fn retrace_vertices(
    mut mesh: ResMut<MovingMesh>,
    samples: Samples<(&ViewRay, &mut SurfacePoint)>,
) -> SystemResult {
    let (rays, mut points) = samples.columns()?;
    let MovingMesh { surface, found, .. } = &mut *mesh;
    found.resize(rays.len(), None);
    let columns = ((&mut *points, &*rays), &mut **found);
    parallel::for_each_row(columns, 256, |((point, ray), found)| {
        *found = surface.nearest(&ray.0, 0.0);
        let hit = found.map(|found| surface.hit(found));
        *point = hit.filter(|hit| hit.normal.dot(ray.0.direction) < 0.0).into();
    });
    Ok(())
}

/// Gradient: propagates the normal adjoints of the samples to the normals of vertices.
pub fn pull_back_to_vertices(
    mut mesh: ResMut<MovingMesh>,
    mut guard: ResMut<StepGuard>,
    samples: Samples<(&SurfacePoint, &PointAdjoint)>,
) -> SystemResult {
    let (points, back) = samples.columns()?;
    let limit = OUTLIER * root_mean_square(&back);
    let normals = &mesh.surface.mesh().normals;
    let mut shares = Vec::new();
    for ((point, back), found) in points.iter().zip(&*back).zip(&mesh.found) {
        let Some(found) = found.filter(|_| point.is_hit()) else { continue };
        let corners = mesh.surface.mesh().triangles[found.triangle as usize];
        let blended: Vec3 = (0..3).map(|k| normals[corners[k] as usize] * found.weights[k]).sum();
        let by_blend = pull_back_unit(blended, Vec3::from(back.normal).clamp_length_max(limit));
        for (corner, weight) in corners.into_iter().zip(found.weights) {
            shares.push((mesh.shell.graph.of[corner as usize], weight * by_blend));
        }
    }
    // Sums last for several steps: nothing of one that is not taken reaches them.
    match shares.iter().find(|(_, share)| !is_usable(&share.to_array())) {
        Some((vertex, _)) => guard.find("the gradient", None, format!("vertex {vertex} of the surface")),
        None => shares.iter().for_each(|(vertex, share)| mesh.adjoint[*vertex as usize] += *share),
    }
    Ok(())
}

/// Update: every `MOVE_EVERY` steps, one smoothed step of all vertices along their normals; resets
/// the sums.
pub fn move_vertices(rates: Res<StepRates>, mut mesh: ResMut<MovingMesh>, mut scenery: ResMut<Scenery>) {
    let MovingMesh { surface, shell, start, positions, adjoint, moments, outlines, steps, .. } = &mut *mesh;
    let done = rates.step as f32 / (*steps).max(1) as f32;
    if done < HELD {
        return adjoint.fill(Vec3::ZERO);
    }
    if !rates.step.is_multiple_of(MOVE_EVERY) {
        return;
    }
    let along = smooth_steps(&shell.graph, positions, adjoint, moments);
    adjoint.fill(Vec3::ZERO);
    let edge = shell.graph.mean_edge(positions);
    let rate = RATES.0 * (RATES.1 / RATES.0).powf((done - HELD) / (1.0 - HELD)) * edge;
    let moved: Vec<Vec3> = positions.iter().zip(&along).map(|(at, step)| at - rate * step).collect();
    let reach = REACH * shell.graph.mean_edge(start);
    // Without the low-frequency part of their displacement, and not far from where they were given.
    let narrow = without_wide(&shell.graph, start, moved);
    let near = |(start, moved): (&Vec3, Vec3)| *start + (moved - *start).clamp_length_max(reach);
    let mut moved: Vec<Vec3> = start.iter().zip(narrow).map(near).collect();
    // A move that makes a triangle degenerate is rejected, and one that is not finite starts again
    // from rest.
    if moved.iter().any(|at| !at.is_finite()) {
        return moments.fill(0.0);
    }
    let mut found = placed(surface.mesh(), &shell.graph, &moved);
    // Every few moves, and at the last one, back to the outlines of the masks as far as contours
    // have left them.
    let is_last = rates.step + MOVE_EVERY > *steps;
    if let Some(outlines) = outlines
        && (is_last || (rates.step / MOVE_EVERY).is_multiple_of(OUTLINES_EVERY))
    {
        shell.move_to(moved);
        let along = outlines.displacements(shell, &TriangleBvh::new(&found));
        let to = |(i, by): (usize, &f32)| shell.positions[i] + shell.normals[i] * by.clamp(-reach, reach);
        moved = along.iter().enumerate().map(to).collect();
        found = placed(surface.mesh(), &shell.graph, &moved);
    }
    if let Ok(found) = Surface::new(found, surface.atlas().width) {
        *surface = Arc::new(found);
        scenery.0 = surface.clone();
        *positions = moved;
    }
}

/// Positions without the low-frequency part of their displacement from `start` along each axis.
fn without_wide(graph: &VertexGraph, start: &[Vec3], moved: Vec<Vec3>) -> Vec<Vec3> {
    let wide = by_axis(|axis| {
        let shift: Vec<f32> = moved.iter().zip(start).map(|(to, from)| to[axis] - from[axis]).collect();
        graph.smoothed(&shift, WIDE)
    });
    moved.iter().zip(wide).map(|(moved, wide)| *moved - wide).collect()
}

/// Steps of the vertices along their normals, with a root mean square of 1.
fn smooth_steps(graph: &VertexGraph, at: &[Vec3], by_normal: &[Vec3], moments: &mut [f32]) -> Vec<Vec3> {
    let normals = graph.normals(at);
    let back = graph.pull_back_normals(at, by_normal);
    let gradients: Vec<f32> = back.iter().zip(&normals).map(|(back, normal)| back.dot(*normal)).collect();
    for (moment, gradient) in moments.iter_mut().zip(graph.smoothed(&gradients, SMOOTHING)) {
        *moment = MEAN_DECAY * *moment + (1.0 - MEAN_DECAY) * gradient;
    }
    let along = graph.smoothed(moments, SMOOTHING);
    let sum: f64 = along.iter().map(|a| f64::from(a * a)).sum();
    let rms = (sum / along.len().max(1) as f64).sqrt().max(1e-30) as f32;
    along.iter().zip(&normals).map(|(along, normal)| *normal * (along / rms)).collect()
}

/// A mesh whose vertices have the positions of merged ones, with smooth normals.
fn placed(mesh: &Mesh, graph: &VertexGraph, positions: &[Vec3]) -> Mesh {
    let (mut mesh, normals) = (mesh.clone(), graph.area_vectors(positions));
    for (vertex, of) in graph.of.iter().map(|of| *of as usize).enumerate() {
        mesh.positions[vertex] = positions[of];
        mesh.normals[vertex] = normals[of].try_normalize().unwrap_or(mesh.normals[vertex]);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_geometry::mesh::primitive::sphere_mesh;

    fn bumpy() -> (VertexGraph, Vec<Vec3>) {
        let (graph, positions) = VertexGraph::new(&sphere_mesh(Vec3::ZERO, 1.0).unwrap());
        let bump = |p: Vec3| p * (1.0 + 0.1 * (5.0 * p.x).sin() * (4.0 * p.y).cos());
        (graph, positions.into_iter().map(bump).collect())
    }

    #[test]
    fn normals_pull_back_as_differences_say() {
        let (graph, positions) = bumpy();
        let adjoint: Vec<Vec3> =
            (0..positions.len()).map(|i| Vec3::new((i as f32).sin(), 0.3, (1.7 * i as f32).cos())).collect();
        let back = graph.pull_back_normals(&positions, &adjoint);
        for vertex in [7, positions.len() / 2, positions.len() - 9] {
            for axis in 0..3 {
                let loss = |by: f32| {
                    let mut moved = positions.clone();
                    moved[vertex][axis] += by;
                    let normals = graph.area_vectors(&moved).into_iter().map(|n| n.as_dvec3().normalize());
                    normals.zip(&adjoint).map(|(n, a)| n.dot(a.as_dvec3())).sum::<f64>()
                };
                let exact = ((loss(2e-4) - loss(-2e-4)) / 4e-4) as f32;
                let found = back[vertex][axis];
                let off = (found - exact).abs();
                assert!(off < 0.02 * exact.abs() + 0.05, "{vertex} {axis}: {found} {exact}");
            }
        }
    }

    #[test]
    fn steps_bring_the_normals_that_are_asked_for() {
        let (graph, mut positions) = bumpy();
        let wanted: Vec<Vec3> = positions.iter().map(|p| p.normalize()).collect();
        let off = |positions: &[Vec3]| {
            let apart =
                graph.area_vectors(positions).into_iter().zip(&wanted).map(|(n, w)| n.normalize() - w);
            apart.collect::<Vec<Vec3>>()
        };
        let size = |off: &[Vec3]| off.iter().map(|d| f64::from(d.length_squared())).sum::<f64>();
        let (before, edge) = (size(&off(&positions)), graph.mean_edge(&positions));
        let mut moments = vec![0.0; positions.len()];
        for _ in 0..60 {
            let steps = smooth_steps(&graph, &positions, &off(&positions), &mut moments);
            positions.iter_mut().zip(&steps).for_each(|(at, step)| *at -= 0.04 * edge * step);
        }
        let after = size(&off(&positions));
        assert!(after < 0.5 * before, "{before} {after}");
    }

    #[test]
    fn what_is_wide_of_a_displacement_is_taken_back() {
        let (graph, start) = bumpy();
        let wide = start.iter().map(|p| *p + 0.01 * Vec3::Y).collect();
        let back = without_wide(&graph, &start, wide);
        assert!(back.iter().zip(&start).all(|(a, b)| a.distance(*b) < 1e-3));
        let mut narrow = start.clone();
        narrow[100] += 0.01 * Vec3::Y;
        let kept = without_wide(&graph, &start, narrow)[100].distance(start[100]);
        assert!(kept > 0.008, "{kept}");
    }
}
