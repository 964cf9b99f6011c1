//! Normals from what the surface mirrors.
//!
//! Stereo and silhouettes give positions, and a normal from positions is good to a few degrees: too little for polished metal or glaze, which
//! mirrors a lamp at a place or does not. The photographs know better: a place of which some views show a highlight faces halfway
//! between the lamp and these cameras. So every vertex gets a normal of its own, which may differ from that of its triangles.
//!
//! The model is much freer than that of a fit, so that nothing has to be right before the normals are. With the normal n and the direction
//! to the camera v, both in the frame in which the light stands still, a vertex has the radiance
//!
//! ```math
//! L_o = a\, E(n) + s\, M(2 (n \cdot v)\, n - v)
//! ```
//!
//! with two colors a and s of the vertex and two tables (`direction_table`) for the whole object: the irradiance E by normal, and the mirrored radiance M by
//! direction, as blurred as the gloss and the normals leave it. In turn, the tables are solved for with all normals given, and each vertex tries
//! many normals (`search`): the colors follow in closed form for each. The best is taken, and then drawn toward its neighbors.
//!
//! Some views are kept aside. The normals are used only if they show what those views show clearly better than the normals of the mesh
//! do with tables and colors of their own.
//!
//! | file | holds |
//! | --- | --- |
//! | `sights` | what each view shows at each vertex |
//! | `direction_table` | a function of directions as a table, from weighted sums |
//! | `search` | colors in closed form, and the search for one vertex |
//!
//! Sources: the separation of a shading into a diffuse and a mirrored part over normals and reflected directions is that of preintegrated image-based lighting
//! (Ramamoorthi and Hanrahan, "Frequency Space Environment Map Rendering", 2002); normals by matching many views of highlights are shape from
//! specularity (Healey and Binford 1988), here by exhaustive search.

pub(crate) mod direction_table;
pub(crate) mod search;
pub(crate) mod sights;

use crate::error::Result;
use crate::error::stop::is_stopping;
use crate::light::placement::PlacedFrame;
use crate::math::statistics::median;
use crate::mesh::triangles::Mesh;
use crate::ranks::Ranks;
use crate::ranks::packed::divided;
use crate::shape::stereo::TrainingViews;
use crate::shape::stereo::votes::Shell;
use crate::shape::vertex_graph::VertexGraph;
use direction_table::{DirectionTable, Sums};
use glam::Vec3;
use rayon::prelude::*;
use search::{ProductSums, VertexColors, around, best_normal, moments};
use sights::{VertexSight, sights};
use std::ops::ControlFlow;

/// Angles around a normal that are tried, in degrees, and rings of directions within them: first around the mesh's, then around the best.
const ROUNDS: [(f32, usize); 4] = [(25.0, 5), (8.0, 2), (6.0, 2), (4.0, 2)];
/// Largest angle between a normal and the mesh's, degrees.
const MOST_DEGREES: f32 = 26.0;
/// How far a normal is drawn toward the mean of its neighbors after a round.
const DRAWN: f32 = 0.3;
/// Sharpness of the kernels by which irradiance and mirrored radiance are smoothed.
const SMOOTH_IRRADIANCE: f32 = 8.0;
const SMOOTH_MIRRORED: f32 = 60.0;
/// Weight of the smooth table beside the sums of a cell, relative to the median of the cells that are seen.
const SMOOTH_SHARE: f32 = 0.05;
/// Times that tables and colors are solved for in turn, at the start of a round.
const TURNS: usize = 3;
/// One view in so many is kept aside.
const ASIDE_EVERY: u32 = 5;
/// Squared error of the views kept aside, relative to that with the normals of the mesh, from which on the normals are used.
const BETTER: f64 = 0.85;
/// Views that must show a vertex for a normal of its own.
const LEAST_SIGHTS: usize = 6;
/// Part of the squared radiance of the views kept aside that the normals of the mesh must leave unexplained: 22 % on polished metal, 1 to 5 % on
/// glossy paint, satin and matte clay, where the mesh's normals are the better ones.
const UNEXPLAINED: f64 = 0.1;
/// Vertices a chunk, whose sums are added in order: the same bits with any number of threads.
const CHUNK: usize = 2048;
/// Vertices that are searched for one after another.
const SEARCHED: usize = 256;

/// What [`refine_normals`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct NormalReport {
    /// Squared error of the views kept aside relative to that with the normals of the mesh; `None` if nothing was tried.
    pub error: Option<f32>,
    /// Part of the squared radiance of the views kept aside that the model leaves unexplained with the normals of the mesh.
    pub unexplained: f32,
    /// Median angle by which normals changed, degrees; 0 if they stay.
    pub turned_degrees: f32,
}

/// Gives the vertices of `mesh` normals that explain what `views` show, if the mesh's leave much unexplained in views kept aside, and the others
/// clearly less. The light stands still in `frame`. `go_on` is asked before each round, with its number of `rounds()`.
///
/// # Errors
/// If another process is gone.
pub(crate) fn refine_normals(
    mesh: &mut Mesh,
    views: &TrainingViews,
    frame: &PlacedFrame,
    mut go_on: impl FnMut(usize) -> ControlFlow<()>,
) -> Result<NormalReport> {
    let mut report = NormalReport::default();
    let shell = Shell::new(mesh);
    let given = merged_normals(mesh, &shell);
    let sights = sights(mesh, &shell, &given, views, frame)?;
    let mut before = Model::new(&given, &sights, (Some(ASIDE_EVERY), views.ranks()));
    if before.is_empty() || go_on(0).is_break() {
        return Ok(report);
    }
    before.solve_light(2 * TURNS);
    let unexplained = before.error_aside() / before.squares_aside().max(f64::MIN_POSITIVE);
    report.unexplained = unexplained as f32;
    if unexplained < UNEXPLAINED {
        return Ok(report);
    }
    let Some(after) = searched(&before, &shell.graph, &mut go_on)? else { return Ok(report) };
    let error = after.error_aside() / before.error_aside().max(f64::MIN_POSITIVE);
    report.error = Some(error as f32);
    if error > BETTER || is_stopping() || go_on(ROUNDS.len()).is_break() {
        return Ok(report);
    }
    report.turned_degrees = put(mesh, &shell, &given, &normals_by_all(after, &shell.graph)?);
    Ok(report)
}

/// The model after all rounds of the search; `None` if it is not to go on before one of them.
fn searched<'a>(
    before: &Model<'a>,
    graph: &VertexGraph,
    mut go_on: impl FnMut(usize) -> ControlFlow<()>,
) -> Result<Option<Model<'a>>> {
    let mut model = before.clone();
    for (round, (degrees, rings)) in ROUNDS.into_iter().enumerate() {
        if go_on(round).is_break() {
            return Ok(None);
        }
        model.search(graph, degrees, rings)?;
        model.solve_light(TURNS);
    }
    Ok(Some(model))
}

/// The normals after another round of the finest search, in which no view is kept aside.
fn normals_by_all(after: Model, graph: &VertexGraph) -> Result<Vec<Vec3>> {
    let mut all = Model { aside: None, ..after };
    all.solve_light(TURNS);
    let (degrees, rings) = ROUNDS[ROUNDS.len() - 1];
    all.search(graph, degrees, rings)?;
    Ok(all.normals)
}

/// Rounds that `refine_normals` asks before.
pub const fn rounds() -> usize {
    ROUNDS.len() + 1
}

/// The unit normals of the mesh at merged vertices.
fn merged_normals(mesh: &Mesh, shell: &Shell) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; shell.positions.len()];
    shell.graph.of.iter().zip(&mesh.normals).for_each(|(of, normal)| sums[*of as usize] += *normal);
    sums.iter().zip(&shell.normals).map(|(sum, area)| sum.normalize_or(*area)).collect()
}

/// Writes the normals; returns the median angle, in degrees.
fn put(mesh: &mut Mesh, shell: &Shell, before: &[Vec3], after: &[Vec3]) -> f32 {
    for (normal, of) in mesh.normals.iter_mut().zip(&shell.graph.of) {
        *normal = after[*of as usize];
    }
    let mut angles: Vec<f32> = before.iter().zip(after).map(|(a, b)| a.angle_between(*b)).collect();
    median(&mut angles).unwrap_or(0.0).to_degrees()
}

/// Normals and colors of the vertices, and the tables of the light.
#[derive(Clone)]
struct Model<'a> {
    given: &'a [Vec3],
    sights: &'a [Vec<VertexSight>],
    normals: Vec<Vec3>,
    colors: Vec<VertexColors>,
    irradiance: DirectionTable,
    mirrored: DirectionTable,
    /// One view in so many does not count.
    aside: Option<u32>,
    /// The processes that divide the search.
    ranks: Option<&'a Ranks>,
}

impl<'a> Model<'a> {
    fn new(
        given: &'a [Vec3],
        sights: &'a [Vec<VertexSight>],
        (aside, ranks): (Option<u32>, Option<&'a Ranks>),
    ) -> Self {
        let mean = |sights: &Vec<VertexSight>| {
            let sum = |of: fn(&VertexSight) -> Vec3| sights.iter().map(of).sum::<Vec3>();
            let weight: f32 = sights.iter().map(|sight| sight.weight).sum();
            sum(|sight| sight.radiance * sight.weight) / weight.max(f32::MIN_POSITIVE)
        };
        let means: Vec<Vec3> = sights.iter().map(mean).collect();
        let usual = means.iter().sum::<Vec3>().element_sum() / (3 * means.len().max(1)) as f32;
        // To begin with, irradiance explains most.
        let colors =
            means.iter().map(|mean| VertexColors { diffuse: 0.7 * *mean, mirrored: Vec3::splat(usual) });
        let (irradiance, mirrored) =
            (DirectionTable::constant(Vec3::ONE), DirectionTable::constant(Vec3::ZERO));
        let (normals, colors) = (given.to_vec(), colors.collect());
        Self { given, sights, normals, colors, irradiance, mirrored, aside, ranks }
    }

    fn is_empty(&self) -> bool {
        self.sights.iter().filter(|sights| sights.len() >= LEAST_SIGHTS).count() < LEAST_SIGHTS
    }

    /// Whether a sight counts.
    fn counts(&self, sight: &VertexSight) -> bool {
        self.aside.is_none_or(|every| !is_aside(sight, every))
    }

    /// Solves for the tables and the colors in turn.
    fn solve_light(&mut self, turns: usize) {
        for _ in 0..turns {
            if is_stopping() {
                return;
            }
            let sums = self.sums(|sight, normal, colors| {
                let rest = sight.radiance - colors.diffuse * self.irradiance.at(sight.in_light(normal));
                (sight.mirrored(normal), colors.mirrored, rest)
            });
            self.mirrored = sums.table(SMOOTH_MIRRORED, Some(SMOOTH_SHARE));
            let sums = self.sums(|sight, normal, colors| {
                let rest = sight.radiance - colors.mirrored * self.mirrored.at(sight.mirrored(normal));
                (sight.in_light(normal), colors.diffuse, rest)
            });
            self.irradiance = sums.table(SMOOTH_IRRADIANCE, None);
            self.solve_colors();
        }
    }

    fn solve_colors(&mut self) {
        let of_vertex = |i: usize| self.moments(i, self.normals[i]).map_or(self.colors[i], |m| m.colors());
        self.colors = (0..self.normals.len()).into_par_iter().map(of_vertex).collect();
    }

    /// Sums over what a sight adds: the direction, the factor there, and what is to be explained.
    fn sums(&self, part: impl Fn(&VertexSight, Vec3, &VertexColors) -> (Vec3, Vec3, Vec3) + Sync) -> Sums {
        let of_chunk = |first: usize| {
            let mut sums = Sums::default();
            for i in first..(first + CHUNK).min(self.normals.len()) {
                for sight in self.sights[i].iter().filter(|sight| self.counts(sight)) {
                    let (direction, factor, rest) = part(sight, self.normals[i], &self.colors[i]);
                    sums.add(direction, sight.weight, factor, rest);
                }
            }
            sums
        };
        let starts: Vec<usize> = (0..self.normals.len()).step_by(CHUNK).collect();
        let parts: Vec<Sums> = starts.into_par_iter().map(of_chunk).collect();
        let mut all = Sums::default();
        parts.iter().for_each(|part| all.merge(part));
        all
    }

    /// What vertex `i` says of its colors with this normal; `None` if a view would see it from behind, or few see it at all.
    fn moments(&self, i: usize, normal: Vec3) -> Option<ProductSums> {
        let counted = self.sights[i].iter().filter(|sight| self.counts(sight));
        moments(counted, normal, &self.irradiance, &self.mirrored)
    }

    /// A round of the search: all vertices try normals, and are then drawn toward their neighbors.
    fn search(&mut self, graph: &VertexGraph, degrees: f32, rings: usize) -> Result<()> {
        let of_vertex = |i: usize| {
            if self.sights[i].len() < LEAST_SIGHTS || is_stopping() {
                return self.normals[i];
            }
            let candidates = around(self.normals[i], degrees.to_radians(), rings);
            best_normal(candidates, self.given[i], MOST_DEGREES.to_radians(), |normal| {
                self.moments(i, normal)
            })
            .unwrap_or(self.normals[i])
        };
        let count = self.normals.len();
        let of_chunk = |chunk: usize| -> Vec<Vec3> {
            (chunk * SEARCHED..count.min((chunk + 1) * SEARCHED)).map(of_vertex).collect()
        };
        let best = divided(self.ranks, count.div_ceil(SEARCHED), of_chunk)?;
        let best: Vec<Vec3> = best.into_iter().flatten().collect();
        let drawn = |i: usize| {
            let near = graph.around(i);
            let mean = near.iter().map(|&j| best[j as usize]).sum::<Vec3>() / near.len().max(1) as f32;
            best[i].lerp(mean, DRAWN).normalize_or(best[i])
        };
        self.normals = (0..best.len()).into_par_iter().map(drawn).collect();
        self.solve_colors();
        Ok(())
    }

    /// Weighted squared radiance of the sights kept aside.
    fn squares_aside(&self) -> f64 {
        let aside = self.sights.iter().flatten().filter(|sight| !self.counts(sight));
        aside.map(|sight| f64::from(sight.weight * sight.radiance.length_squared())).sum()
    }

    /// Weighted squared error of the sights kept aside.
    fn error_aside(&self) -> f64 {
        let of_vertex = |i: usize| {
            let (normal, colors) = (self.normals[i], &self.colors[i]);
            let aside = self.sights[i].iter().filter(|sight| !self.counts(sight));
            let error = |sight: &VertexSight| {
                let shown = colors.diffuse * self.irradiance.at(sight.in_light(normal))
                    + colors.mirrored * self.mirrored.at(sight.mirrored(normal));
                f64::from(sight.weight * (shown - sight.radiance).length_squared())
            };
            aside.map(error).sum::<f64>()
        };
        (0..self.normals.len()).map(of_vertex).sum()
    }
}

/// Whether a sight is of a view that is kept aside.
fn is_aside(sight: &VertexSight, every: u32) -> bool {
    sight.view % every == every / 2
}

#[cfg(test)]
mod tests;
