//! Normals from what the surface mirrors.
//!
//! Stereo and silhouettes give positions, and a normal from positions is good to a few degrees: too
//! little for polished metal or glaze, which mirrors a lamp at a place or does not. The photographs
//! know better: a place of which some views show a highlight faces halfway between the lamp and
//! these cameras. So every vertex gets a normal of its own, which may differ from that of its
//! triangles.
//!
//! The model is much freer than that of a fit, so that nothing has to be right before the normals
//! are. With the normal n and the direction to the camera v, both in the frame in which the light
//! stands still, a vertex has the radiance
//!
//! ```math
//! L_o = a\, E(n) + s\, M(2 (n \cdot v)\, n - v)
//! ```
//!
//! with two colors a and s of the vertex and two tables for the whole object: the irradiance E by
//! normal, and the mirrored radiance M by direction, as blurred as the gloss and the normals leave
//! it. In turn, the tables are solved for with all normals given, and each vertex tries many
//! normals: the colors follow in closed form for each. The best is taken, and then drawn toward its
//! neighbors.
//!
//! Some views are kept aside. The normals are used only if they show what those views show clearly
//! better than the normals of the mesh do with tables and colors of their own.
//!
//! Sources: the separation of a shading into a diffuse and a mirrored part over normals and
//! reflected directions is that of preintegrated image-based lighting (Ramamoorthi and Hanrahan,
//! "Frequency Space Environment Map Rendering", 2002); normals by matching many views of highlights
//! are shape from specularity (Healey and Binford 1988), here by exhaustive search.

use crate::shape::pictures::TrainingView;
use crate::shape::shell::{Shell, VertexGraph};
use glam::{Mat3, Vec2, Vec3};
use lobelia_geometry::mesh::{bvh::TriangleBvh, triangles::Mesh};
use lobelia_geometry::{error::stop::is_stopping, parallel, view::raster::bilinear};
use lobelia_sg::{ray::Ray, statistics::median};
use lobelia_world::light::placement::PlacedFrame;
use std::{f32::consts::TAU, ops::ControlFlow};

/// Angles around a normal that are tried, in degrees, and rings of directions within them: first
/// around the mesh's, then around the best.
const ROUNDS: [(f32, usize); 4] = [(25.0, 5), (8.0, 2), (6.0, 2), (4.0, 2)];
/// Largest angle between a normal and the mesh's, degrees.
const MOST_DEGREES: f32 = 26.0;
/// How far a normal is drawn toward the mean of its neighbors after a round.
const DRAWN: f32 = 0.3;
/// Sharpness of the kernels by which irradiance and mirrored radiance are smoothed.
const SMOOTH_IRRADIANCE: f32 = 8.0;
const SMOOTH_MIRRORED: f32 = 60.0;
/// Weight of the smooth table beside the sums of a cell, relative to the median of the cells that
/// are seen.
const SMOOTH_SHARE: f32 = 0.05;
/// Cells a side of a table.
const SIDE: usize = 48;
/// Sharpness of a kernel that reaches where a narrower one has seen nothing, and its weight.
const WIDE: f32 = 4.0;
const WIDE_SHARE: f32 = 1e-3;
/// Times that tables and colors are solved for in turn, at the start of a round.
const TURNS: usize = 3;
/// One view in so many is kept aside.
const ASIDE_EVERY: u32 = 5;
/// Squared error of the views kept aside, relative to that with the normals of the mesh, from which
/// on the normals are used.
const BETTER: f64 = 0.85;
/// Views that must show a vertex for a normal of its own.
const LEAST_SIGHTS: usize = 6;
/// Part of the squared radiance of the views kept aside that the normals of the mesh must leave
/// unexplained: 22 % on polished metal, 1 to 5 % on glossy paint, satin and matte clay, where the
/// mesh's normals are the better ones.
const UNEXPLAINED: f64 = 0.1;
/// Vertices a chunk, whose sums are added in order: the same bits with any number of threads.
const CHUNK: usize = 2048;
/// Vertices that are searched for one after another.
const SEARCHED: usize = 256;
/// Least cosine between the direction to a view and the normal of the mesh.
const LEAST_COSINE: f32 = 0.25;
/// Coverage that all pixels around the projection of a vertex must have.
const COVERED: f32 = 0.99;
/// Start of the ray to a view above the surface, in mean edges.
const LIFT: f32 = 0.3;
/// Radiance, relative to the median, that is added to that of a sight for its weight: noise of dark
/// pixels counts less than that of bright ones, relative to their value more.
const FLOOR: f32 = 0.5;
/// Views whose sights are found at once.
const AT_A_TIME: usize = 32;
/// Least cosine between a normal and the direction to a view that sees the vertex.
const FACING_COSINE: f32 = 0.05;
/// Penalty on a normal far from the mesh's: part of the squared radiance, for an angle of one
/// radian.
const FAR: f32 = 0.5;
/// Added to the determinant of a vertex's equations, relative to the product of its diagonal.
const DAMPING: f32 = 1e-3;
/// Part of the mean square of the mirrored radiance that a vertex is taken to have seen besides:
/// else the mirrored color of one that mirrors only dark parts of the light could be any.
const MIRRORED_FLOOR: f32 = 0.02;

/// Result of a refinement of normals.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NormalReport {
    /// Squared error of the views kept aside relative to that with the normals of the mesh; `None`
    /// if nothing was tried.
    pub error: Option<f32>,
    /// Part of the squared radiance of the views kept aside that the model leaves unexplained with
    /// the normals of the mesh.
    pub unexplained: f32,
    /// Median angle by which normals changed, degrees; 0 if they stay.
    pub turned_degrees: f32,
}

/// Gives the vertices of `mesh` normals that explain what `views` show, if the mesh's leave much
/// unexplained in views kept aside, and the others clearly less. The light stands still in `frame`.
/// `go_on` is asked before each round, with its number of `rounds()`.
pub(crate) fn refine_normals(
    mesh: &mut Mesh,
    views: &[TrainingView],
    frame: &PlacedFrame,
    mut go_on: impl FnMut(usize) -> ControlFlow<()>,
) -> NormalReport {
    let mut report = NormalReport::default();
    let shell = Shell::new(mesh);
    // The unit normals of the mesh at merged vertices.
    let mut sums = vec![Vec3::ZERO; shell.positions.len()];
    shell.graph.of.iter().zip(&mesh.normals).for_each(|(of, normal)| sums[*of as usize] += *normal);
    let given: Vec<_> = sums.iter().zip(&shell.normals).map(|(sum, area)| sum.normalize_or(*area)).collect();
    let sights = sights(mesh, &shell, &given, views, frame);
    let mut before = Model::new(&given, &sights);
    let shown = sights.iter().filter(|sights| sights.len() >= LEAST_SIGHTS).count();
    if shown < LEAST_SIGHTS || go_on(0).is_break() {
        return report;
    }
    before.solve_light(2 * TURNS);
    let aside = sights.iter().flatten().filter(|sight| !before.counts(sight));
    let squares: f64 = aside.map(|sight| f64::from(sight.weight * sight.radiance.length_squared())).sum();
    let unexplained = before.error_aside() / squares.max(f64::MIN_POSITIVE);
    report.unexplained = unexplained as f32;
    if unexplained < UNEXPLAINED {
        return report;
    }
    let mut model = before.clone();
    for (round, (degrees, rings)) in ROUNDS.into_iter().enumerate() {
        if go_on(round).is_break() {
            return report;
        }
        model.search(&shell.graph, degrees, rings);
        model.solve_light(TURNS);
    }
    let error = model.error_aside() / before.error_aside().max(f64::MIN_POSITIVE);
    report.error = Some(error as f32);
    if error > BETTER || is_stopping() || go_on(ROUNDS.len()).is_break() {
        return report;
    }
    // Another round of the finest search, in which no view is kept aside.
    model.keeps_aside = false;
    model.solve_light(TURNS);
    let (degrees, rings) = ROUNDS[ROUNDS.len() - 1];
    model.search(&shell.graph, degrees, rings);
    for (normal, of) in mesh.normals.iter_mut().zip(&shell.graph.of) {
        *normal = model.normals[*of as usize];
    }
    let mut angles: Vec<f32> = given.iter().zip(&model.normals).map(|(a, b)| a.angle_between(*b)).collect();
    report.turned_degrees = median(&mut angles).unwrap_or(0.0).to_degrees();
    report
}

/// Rounds that a refinement asks before.
pub const fn rounds() -> usize {
    ROUNDS.len() + 1
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
    /// Whether one view in [`ASIDE_EVERY`] does not count.
    keeps_aside: bool,
}

impl<'a> Model<'a> {
    fn new(given: &'a [Vec3], sights: &'a [Vec<VertexSight>]) -> Self {
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
        Self { given, sights, normals, colors, irradiance, mirrored, keeps_aside: true }
    }

    /// Whether a sight counts: its view is not kept aside.
    fn counts(&self, sight: &VertexSight) -> bool {
        !self.keeps_aside || sight.view % ASIDE_EVERY != ASIDE_EVERY / 2
    }

    /// Solves for the tables and the colors in turn.
    fn solve_light(&mut self, turns: usize) {
        for _ in 0..turns {
            if is_stopping() {
                return;
            }
            let sums = self.sums(|sight, normal, colors| {
                let rest = sight.radiance - colors.diffuse * self.irradiance.at(sight.in_light(normal));
                [sight.mirrored(normal), colors.mirrored, rest]
            });
            self.mirrored = DirectionTable::of_sums(&sums, SMOOTH_MIRRORED, Some(SMOOTH_SHARE));
            let sums = self.sums(|sight, normal, colors| {
                let rest = sight.radiance - colors.mirrored * self.mirrored.at(sight.mirrored(normal));
                [sight.in_light(normal), colors.diffuse, rest]
            });
            self.irradiance = DirectionTable::of_sums(&sums, SMOOTH_IRRADIANCE, None);
            self.solve_colors();
        }
    }

    fn solve_colors(&mut self) {
        let of_vertex = |i: usize| self.moments(i, self.normals[i]).map_or(self.colors[i], |m| m.colors());
        self.colors = parallel::map(self.normals.len(), 1024, of_vertex);
    }

    /// Sums over what a sight adds: the direction, the factor there, and what is to be explained.
    fn sums(&self, part: impl Fn(&VertexSight, Vec3, &VertexColors) -> [Vec3; 3] + Sync) -> Vec<CellSums> {
        let of_chunk = |chunk: usize| {
            let first = chunk * CHUNK;
            let mut sums = vec![CellSums::default(); SIDE * SIDE];
            for i in first..(first + CHUNK).min(self.normals.len()) {
                for sight in self.sights[i].iter().filter(|sight| self.counts(sight)) {
                    let [direction, factor, rest] = part(sight, self.normals[i], &self.colors[i]);
                    sums[cell(direction)].add(sight.weight, factor, rest);
                }
            }
            sums
        };
        let parts: Vec<Vec<CellSums>> = parallel::map(self.normals.len().div_ceil(CHUNK), 1, of_chunk);
        let mut all = vec![CellSums::default(); SIDE * SIDE];
        for part in &parts {
            for (sum, part) in all.iter_mut().zip(part) {
                sum.squares += part.squares;
                sum.products += part.products;
            }
        }
        all
    }

    /// The sums of vertex `i` with this world normal for its colors; `None` if a view would see it
    /// from behind, or none sees it.
    fn moments(&self, i: usize, normal: Vec3) -> Option<ProductSums> {
        let mut sums = ProductSums::default();
        let mut weight = 0.0;
        for sight in self.sights[i].iter().filter(|sight| self.counts(sight)) {
            let in_light = sight.in_light(normal);
            let cosine = in_light.dot(sight.to_view);
            if cosine < FACING_COSINE {
                return None;
            }
            let e = self.irradiance.at(in_light);
            let m = self.mirrored.at(2.0 * cosine * in_light - sight.to_view);
            sums.add(sight.weight, e, m, sight.radiance);
            weight += sight.weight;
        }
        sums.mm += MIRRORED_FLOOR * weight * self.mirrored.mean_square;
        (weight > 0.0).then_some(sums)
    }

    /// A round of the search: all vertices try normals, and are then drawn toward their neighbors.
    fn search(&mut self, graph: &VertexGraph, degrees: f32, rings: usize) {
        let of_vertex = |i: usize| {
            if self.sights[i].len() < LEAST_SIGHTS || is_stopping() {
                return self.normals[i];
            }
            // The candidate with the least error, within an angle of the normal of the mesh.
            let judged = |normal: Vec3| {
                let angle = normal.angle_between(self.given[i]);
                let is_near = angle <= MOST_DEGREES.to_radians();
                let sums = is_near.then(|| self.moments(i, normal)).flatten()?;
                Some((sums.error(&sums.colors()) + FAR * angle * angle * sums.ll.element_sum(), normal))
            };
            let tried = around(self.normals[i], degrees.to_radians(), rings).filter_map(judged);
            let best = tried.min_by(|a, b| a.0.total_cmp(&b.0));
            best.map_or(self.normals[i], |(_, normal)| normal)
        };
        let best: Vec<Vec3> = parallel::map(self.normals.len(), SEARCHED, of_vertex);
        let drawn = |i: usize| {
            let near = graph.around(i);
            let mean = near.iter().map(|&j| best[j as usize]).sum::<Vec3>() / near.len().max(1) as f32;
            best[i].lerp(mean, DRAWN).normalize_or(best[i])
        };
        self.normals = parallel::map(best.len(), 1024, drawn);
        self.solve_colors();
    }

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

/// Radiance of a vertex in one view.
#[derive(Clone, Copy, Debug)]
struct VertexSight {
    view: u32,
    /// Rotation from the world into the light's frame.
    light_from_world: Mat3,
    /// Unit direction to the camera, in the light's frame.
    to_view: Vec3,
    radiance: Vec3,
    /// Weight of a squared difference, in units of 1 / radiance.
    weight: f32,
}

impl VertexSight {
    #[inline]
    fn in_light(&self, world: Vec3) -> Vec3 {
        self.light_from_world * world
    }

    /// The direction that a surface with this world normal mirrors to the view, in the light's
    /// frame.
    #[inline]
    fn mirrored(&self, normal: Vec3) -> Vec3 {
        let normal = self.in_light(normal);
        2.0 * normal.dot(self.to_view) * normal - self.to_view
    }
}

/// Returns the sights of each merged vertex of `shell`, one per view that sees it.
fn sights(
    mesh: &Mesh,
    shell: &Shell,
    normals: &[Vec3],
    views: &[TrainingView],
    frame: &PlacedFrame,
) -> Vec<Vec<VertexSight>> {
    let bvh = TriangleBvh::new(mesh);
    let lift = LIFT * shell.graph.mean_edge(&shell.positions);
    let of_view = |view: &TrainingView| -> Vec<(u32, Vec3, Vec3)> {
        let of_vertex = |i: usize| {
            let [to_view, radiance] = shown_by(view, &bvh, shell.positions[i], normals[i], lift)?;
            Some((i as u32, to_view, radiance))
        };
        parallel::flat_map(normals.len(), 1024, of_vertex)
    };
    let mut all = vec![Vec::new(); normals.len()];
    // Some views at a time: what all of them show would be in memory twice.
    for (first, some) in (0..).step_by(AT_A_TIME).zip(views.chunks(AT_A_TIME)) {
        let shown: Vec<_> = parallel::map_slice(some, 1, of_view);
        for (view, (TrainingView { camera, placement, .. }, shown)) in (first..).zip(some.iter().zip(shown)) {
            let light_from_world =
                frame.light_from_world(camera.world_from_camera.matrix3.into(), *placement);
            for (vertex, to_view, radiance) in shown {
                let to_view = light_from_world * to_view;
                let sight = VertexSight { view, light_from_world, to_view, radiance, weight: 1.0 };
                all[vertex as usize].push(sight);
            }
        }
    }
    all.iter_mut().for_each(Vec::shrink_to_fit);
    let mean = |sight: &VertexSight| sight.radiance.element_sum() / 3.0;
    let mut some: Vec<f32> = all.iter().filter_map(|sights| sights.first()).map(mean).collect();
    let floor = (FLOOR * median(&mut some).unwrap_or(0.0)).max(f32::MIN_POSITIVE);
    for sight in all.iter_mut().flatten() {
        sight.weight = 1.0 / (floor + mean(sight));
    }
    all
}

/// The world direction to a view, and the radiance that it shows at a point with this normal;
/// `None` if it does not see it.
fn shown_by(view: &TrainingView, bvh: &TriangleBvh, at: Vec3, normal: Vec3, lift: f32) -> Option<[Vec3; 2]> {
    let offset = view.camera.position() - at;
    let (distance, to_view) = (offset.length(), offset.normalize_or_zero());
    if normal.dot(to_view) < LEAST_COSINE {
        return None;
    }
    let (x, y, _) = view.camera.project(at)?;
    let (width, height) = (view.camera.width, view.camera.height);
    let inside = x >= 0.5 && y >= 0.5 && x <= width as f32 - 0.5 && y <= height as f32 - 0.5;
    if !inside {
        return None;
    }
    let taps = bilinear(width, height, x - 0.5, y - 0.5);
    if taps.iter().any(|(pixel, _)| view.mask.coverage(*pixel) < COVERED) {
        return None;
    }
    let ray = Ray { origin: at + lift * normal, direction: to_view };
    let radiance = || taps.iter().map(|(pixel, weight)| view.photograph.radiance(*pixel) * *weight).sum();
    (!bvh.any(&ray, 0.0, distance)).then(|| [to_view, radiance()])
}

/// The two colors of a vertex, ≥ 0: they multiply the tables.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct VertexColors {
    diffuse: Vec3,
    mirrored: Vec3,
}

/// Weighted sums over the sights of a vertex, by channel: products of irradiance E, mirrored
/// radiance M and radiance L.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct ProductSums {
    ee: Vec3,
    mm: Vec3,
    em: Vec3,
    el: Vec3,
    ml: Vec3,
    ll: Vec3,
}

impl ProductSums {
    #[inline]
    fn add(&mut self, w: f32, e: Vec3, m: Vec3, l: Vec3) {
        let (we, wm) = (w * e, w * m);
        self.ee += we * e;
        self.mm += wm * m;
        self.em += we * m;
        self.el += we * l;
        self.ml += wm * l;
        self.ll += w * l * l;
    }

    /// The colors ≥ 0 with the least squared error.
    fn colors(&self) -> VertexColors {
        let (ee, mm) = (self.ee.max(Vec3::splat(1e-20)), self.mm.max(Vec3::splat(1e-20)));
        let determinant = ee * mm * (1.0 + DAMPING) - self.em * self.em;
        let diffuse = (self.el * mm - self.ml * self.em) / determinant;
        let mirrored = (self.ml * ee - self.el * self.em) / determinant;
        let channel = |c: usize| match (diffuse[c] < 0.0, mirrored[c] < 0.0) {
            (false, false) => [diffuse[c], mirrored[c]],
            (true, _) => [0.0, (self.ml[c] / mm[c]).max(0.0)],
            (false, true) => [(self.el[c] / ee[c]).max(0.0), 0.0],
        };
        let [r, g, b] = [0, 1, 2].map(channel);
        VertexColors { diffuse: Vec3::new(r[0], g[0], b[0]), mirrored: Vec3::new(r[1], g[1], b[1]) }
    }

    fn error(&self, colors: &VertexColors) -> f32 {
        let VertexColors { diffuse: a, mirrored: s } = *colors;
        let explained =
            a * (a * self.ee + 2.0 * s * self.em - 2.0 * self.el) + s * (s * self.mm - 2.0 * self.ml);
        (self.ll + explained).element_sum()
    }
}

/// A unit vector and rings of others around it, up to an angle in radians.
fn around(axis: Vec3, most: f32, rings: usize) -> impl Iterator<Item = Vec3> {
    let (side, front) = axis.any_orthonormal_pair();
    let ring = move |ring: usize| {
        let (sine, cosine) = (most * ring as f32 / rings as f32).sin_cos();
        let count = 6 * ring;
        (0..count).map(move |i| {
            let (y, x) = (TAU * i as f32 / count as f32).sin_cos();
            (cosine * axis + sine * (x * side + y * front)).normalize()
        })
    };
    std::iter::once(axis).chain((1..=rings).flat_map(ring))
}

/// A function of directions as a table over the sphere: RGB values by direction, and the mean of
/// their squares. Cells are those of a square grid over octahedral coordinates (Cigolle et al., "A
/// Survey of Efficient Representations for Independent Unit Vectors", 2014).
#[derive(Clone, Debug, PartialEq)]
struct DirectionTable {
    cells: Vec<Vec3>,
    mean_square: Vec3,
}

impl DirectionTable {
    fn constant(value: Vec3) -> Self {
        Self::new(vec![value; SIDE * SIDE])
    }

    fn new(cells: Vec<Vec3>) -> Self {
        let mean_square = cells.iter().map(|v| v * v).sum::<Vec3>() / cells.len() as f32;
        Self { cells, mean_square }
    }

    /// The table ≥ 0 with least squared error, where it is smoothed by a spherical Gaussian of this
    /// sharpness. With `share`, a cell has also a value of its own: the smooth one counts beside
    /// its sums with this weight, relative to the median of the cells that are seen.
    fn of_sums(sums: &[CellSums], sharpness: f32, share: Option<f32>) -> Self {
        let middles: Vec<Vec3> = (0..SIDE * SIDE).map(middle).collect();
        let smooth = |i: usize| {
            let (mut products, mut squares) = (Vec3::ZERO, Vec3::splat(1e-30));
            for (other, sums) in middles.iter().zip(sums) {
                let apart = middles[i].dot(*other) - 1.0;
                let kernel = (sharpness * apart).exp() * sharpness + WIDE_SHARE * (WIDE * apart).exp() * WIDE;
                products += kernel * sums.products;
                squares += kernel * sums.squares;
            }
            products / squares
        };
        let mut cells: Vec<Vec3> = parallel::map(SIDE * SIDE, 1, smooth);
        if let Some(share) = share {
            let squares = sums.iter().map(|sums| sums.squares.element_sum() / 3.0);
            let mut seen: Vec<f32> = squares.filter(|square| *square > 0.0).collect();
            let weight = share * median(&mut seen).unwrap_or(1.0) + 1e-30;
            for (cell, sums) in cells.iter_mut().zip(sums) {
                *cell = (sums.products + weight * *cell) / (sums.squares + weight);
            }
        }
        Self::new(cells.into_iter().map(|value| value.max(Vec3::ZERO)).collect())
    }

    #[inline]
    fn at(&self, direction: Vec3) -> Vec3 {
        self.cells[cell(direction)]
    }
}

#[inline]
fn cell(direction: Vec3) -> usize {
    let sum = direction.abs().element_sum().max(f32::MIN_POSITIVE);
    let flat = Vec2::new(direction.x, direction.y) / sum;
    let folded = if direction.z < 0.0 {
        (Vec2::ONE - Vec2::new(flat.y.abs(), flat.x.abs())).copysign(flat)
    } else {
        flat
    };
    let at = ((folded + 1.0) * (0.5 * SIDE as f32)).clamp(Vec2::ZERO, Vec2::splat(SIDE as f32 - 1.0));
    at.y as usize * SIDE + at.x as usize
}

/// The unit direction of the middle of a cell.
fn middle(cell: usize) -> Vec3 {
    let at = |i: usize| (i as f32 + 0.5) * (2.0 / SIDE as f32) - 1.0;
    let (x, y) = (at(cell % SIDE), at(cell / SIDE));
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    Vec3::new(x - fold.copysign(x), y - fold.copysign(y), z).normalize()
}

/// Weighted sums in a cell for a table T of which products f T are known.
#[derive(Clone, Copy, Debug, Default)]
struct CellSums {
    /// Σ w f².
    squares: Vec3,
    /// Σ w f y for what is to be explained, y.
    products: Vec3,
}

impl CellSums {
    /// Adds an observation y = `value` of weight w, with the factor f.
    #[inline]
    fn add(&mut self, weight: f32, factor: Vec3, value: Vec3) {
        self.squares += weight * factor * factor;
        self.products += weight * factor * value;
    }
}

#[cfg(test)]
mod tests;
