//! Texture coordinates for meshes that have none, or unusable ones.

use crate::mesh::atlas::chart::{Chart, charts};
use crate::mesh::atlas::{texels_near, texture_corners};
use crate::{Error, Result, mesh::atlas::pack::pack, mesh::triangles::Mesh};
use glam::{DVec2, Vec2};
use std::collections::HashMap;

/// Largest fraction of the covered texels on which existing coordinates may overlap.
const MAX_OVERLAP: f64 = 0.01;
/// Largest fraction of the surface area that may have no area in the texture.
const MAX_COLLAPSED: f64 = 0.01;
/// Overlap is measured on a grid at least this fine, since small triangles miss the centers of
/// coarse texels.
const OVERLAP_GRID: u32 = 1024;
/// Texture coordinates may exceed the unit square by this much (rounding).
const SLACK: f32 = 1e-4;

/// A mesh with usable texture coordinates, from [`unwrap_mesh`].
#[derive(Clone, Debug, PartialEq)]
pub struct UnwrappedMesh {
    /// The mesh; same triangles in the same order, vertices on seams duplicated.
    pub mesh: Mesh,
    /// Number of charts if it was unwrapped; `None` if its own coordinates were kept.
    pub charts: Option<u32>,
    /// The reason why existing coordinates were not kept.
    pub note: Option<String>,
}

/// Gives `mesh` texture coordinates whose charts do not overlap, packed for a texture of
/// `texture_size`² texels.
///
/// Coordinates that the mesh has are kept (clamped to `[0, 1]`) if they are in the unit square and
/// hardly overlap; otherwise it is unwrapped, and a note says why.
///
/// # Errors
/// [`Error::Usage`] if the charts do not fit the texture, [`Error::Run`] if the mesh cannot be
/// unwrapped, [`Error::Interrupted`] if the work is to stop.
pub fn unwrap_mesh(mesh: &Mesh, texture_size: u32) -> Result<UnwrappedMesh> {
    let fault = mesh.uvs.as_ref().map(|uvs| fault(mesh, uvs, texture_size));
    if let Some(None) = fault {
        let mut mesh = mesh.clone();
        mesh.uvs.iter_mut().flatten().for_each(|uv| *uv = uv.clamp(Vec2::ZERO, Vec2::ONE));
        return Ok(UnwrappedMesh { mesh, charts: None, note: None });
    }
    mesh.check_lists().map_err(|problem| Error::run("unwrapping the mesh", problem))?;
    let mut charts = charts(mesh)?;
    let count = charts.len() as u32;
    if !pack(&mut charts, texture_size) {
        let problem = format!("the {count} charts of the unwrapped mesh do not fit {texture_size}² texels");
        return Err(Error::usage(problem, "Say a larger `texture_size` in `surface`."));
    }
    let note = fault.flatten().map(|why| format!("the mesh's own texture coordinates were replaced: {why}"));
    Ok(UnwrappedMesh { mesh: with_places(mesh, &charts, texture_size), charts: Some(count), note })
}

/// The reason why these texture coordinates do not have one texel per surface point, if there is
/// one.
fn fault(mesh: &Mesh, uvs: &[Vec2], texture_size: u32) -> Option<String> {
    let used = || mesh.triangles.iter().flatten().map(|&vertex| uvs[vertex as usize]);
    let inside = |uv: Vec2| uv.min_element() >= -SLACK && uv.max_element() <= 1.0 + SLACK;
    if let Some(outside) = used().find(|&uv| !inside(uv)) {
        return Some(format!("{outside} lies outside the unit square"));
    }
    let collapsed = collapsed_part(mesh, uvs);
    if collapsed > MAX_COLLAPSED {
        return Some(format!("{:.0} % of the surface has no area in the texture", 100.0 * collapsed));
    }
    let overlap = overlapping_part(mesh, texture_size.clamp(OVERLAP_GRID, 4 * OVERLAP_GRID));
    (overlap > MAX_OVERLAP)
        .then(|| format!("they overlap on {:.0} % of the texture they use", 100.0 * overlap))
}

/// Fraction of the surface area in triangles without area in the texture.
fn collapsed_part(mesh: &Mesh, uvs: &[Vec2]) -> f64 {
    let (mut collapsed, mut total) = (0.0, 0.0);
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let [u, v, w] = triangle.map(|vertex| uvs[vertex as usize].as_dvec2());
        let area = mesh.doubled_area_vector(t).length();
        total += area;
        if (v - u).perp_dot(w - u).abs() < 1e-12 {
            collapsed += area;
        }
    }
    if total > 0.0 { collapsed / total } else { 0.0 }
}

/// Fraction of the covered grid points that are strictly inside more than one triangle.
fn overlapping_part(mesh: &Mesh, grid: u32) -> f64 {
    let mut counts = vec![0u8; grid as usize * grid as usize];
    for triangle in &mesh.triangles {
        let Some(corners) = texture_corners(mesh, triangle, DVec2::splat(f64::from(grid))) else { continue };
        for (x, y) in texels_near(corners, grid, grid) {
            let point = DVec2::new(f64::from(x), f64::from(y));
            let sides = [0, 1, 2].map(|i: usize| {
                let (from, to) = (corners[i], corners[(i + 1) % 3]);
                (to - from).perp_dot(point - from)
            });
            if sides.iter().all(|&s| s > 0.0) || sides.iter().all(|&s| s < 0.0) {
                let count = &mut counts[(y * grid + x) as usize];
                *count = count.saturating_add(1);
            }
        }
    }
    let covered = counts.iter().filter(|&&c| c > 0).count();
    let shared = counts.iter().filter(|&&c| c > 1).count();
    shared as f64 / covered.max(1) as f64
}

/// The mesh with texture coordinates from places in texels. A triangle in no chart, which has no
/// area, collapses to a point of the texture.
fn with_places(mesh: &Mesh, charts: &[Chart], texture_size: u32) -> Mesh {
    let mut places = vec![None; mesh.triangles.len()];
    for (number, chart) in charts.iter().enumerate() {
        for (face, corners) in chart.faces.iter().zip(&chart.triangles) {
            places[*face as usize] = Some((number as u32, *corners));
        }
    }
    let mut made = Mesh { uvs: Some(Vec::new()), ..Mesh::default() };
    // By the vertex, and chart and place there.
    let mut vertices: HashMap<(u32, u32, u32), u32> = HashMap::new();
    for (triangle, place) in mesh.triangles.iter().zip(places) {
        let (chart, corners) = place.unwrap_or((u32::MAX, [0; 3]));
        made.triangles.push([0, 1, 2].map(|k| {
            let (source, place) = (triangle[k], corners[k]);
            *vertices.entry((source, chart, place)).or_insert_with(|| {
                let at = charts.get(chart as usize).map_or(DVec2::ZERO, |chart| chart.places[place as usize]);
                made.positions.push(mesh.positions[source as usize]);
                made.normals.push(mesh.normals[source as usize]);
                made.uvs.iter_mut().for_each(|uvs| uvs.push((at / f64::from(texture_size)).as_vec2()));
                made.positions.len() as u32 - 1
            })
        }));
    }
    made
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::{box_mesh, sphere_mesh};
    use crate::mesh::tests::{ball, scattered};
    use glam::Vec3;

    fn bare_sphere() -> Mesh {
        Mesh { uvs: None, ..sphere_mesh(Vec3::ZERO, 1.0).unwrap() }
    }

    #[test]
    fn a_mesh_without_coordinates_gets_ones_that_do_not_overlap() {
        let bare = bare_sphere();
        let made = unwrap_mesh(&bare, 128).unwrap();
        assert!(made.charts.is_some() && made.note.is_none());
        assert_eq!(fault(&made.mesh, made.mesh.uvs.as_ref().unwrap(), 128), None);
        assert!(overlapping_part(&made.mesh, 1024) < 1e-3);
        // Same triangles at the same places, in order.
        assert_eq!(made.mesh.triangles.len(), bare.triangles.len());
        for t in 0..bare.triangles.len() {
            assert_eq!(made.mesh.corners(t), bare.corners(t));
        }
        assert_eq!(unwrap_mesh(&bare, 128).unwrap(), made, "not deterministic");
    }

    #[test]
    fn every_triangle_has_texels_that_no_other_chart_has() {
        let mesh = ball(12, 0.01);
        let made = unwrap_mesh(&mesh, 256).unwrap().mesh;
        let uvs = made.uvs.as_ref().unwrap();
        let density = |t: usize| {
            let [a, b, c] = mesh.corners(t);
            let [u, v, w] = made.triangles[t].map(|vertex| uvs[vertex as usize] * 256.0);
            (v - u).perp_dot(w - u) / (b - a).cross(c - a).length()
        };
        let all: Vec<f32> = (0..mesh.triangles.len()).map(density).collect();
        let mean = all.iter().sum::<f32>() / all.len() as f32;
        assert!(all.iter().all(|d| (0.25..4.0).contains(&(d / mean))), "{mean} {all:?}");
        assert_eq!(overlapping_part(&made, 4096), 0.0);
        // Vertices are doubled on seams alone.
        assert!(made.positions.len() < mesh.welded_vertices().len() + 400, "{}", made.positions.len());
    }

    #[test]
    fn threads_make_no_difference() {
        let mesh = ball(12, 0.01);
        let with = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let [one, three] = [1, 3].map(|threads| with(threads).install(|| unwrap_mesh(&mesh, 128).unwrap()));
        assert!(one == three);
    }

    #[test]
    fn triangles_without_area_take_no_room() {
        let mut mesh = scattered(3);
        mesh.triangles.insert(1, [0, 0, 4]);
        let made = unwrap_mesh(&mesh, 64).unwrap();
        assert_eq!((made.charts, made.mesh.triangles.len()), (Some(3), 4));
        for t in 0..4 {
            assert_eq!(made.mesh.corners(t), mesh.corners(t));
        }
        let uvs = made.mesh.uvs.unwrap();
        assert!(made.mesh.triangles[1].iter().all(|v| uvs[*v as usize] == Vec2::ZERO));
        assert_eq!(unwrap_mesh(&Mesh::default(), 64).unwrap().charts, Some(0));
    }

    #[test]
    fn a_mesh_that_is_none_is_an_error() {
        let good = scattered(2);
        let wrong = |change: &dyn Fn(&mut Mesh)| {
            let mut mesh = good.clone();
            change(&mut mesh);
            unwrap_mesh(&mesh, 64).unwrap_err().to_string()
        };
        assert!(wrong(&|m| m.triangles[1][2] = 6).contains("triangle 1 names a vertex beyond the 6"));
        assert!(wrong(&|m| m.positions[4].y = f32::NAN).contains("vertex 4 is not finite"));
        assert!(wrong(&|m| m.normals.truncate(5)).contains("6 positions, 5 normals"));
    }

    #[test]
    fn good_coordinates_are_kept() {
        for mesh in [sphere_mesh(Vec3::ZERO, 1.0).unwrap(), box_mesh(Vec3::ZERO, Vec3::ONE).unwrap()] {
            let kept = unwrap_mesh(&mesh, 256).unwrap();
            assert_eq!(kept, UnwrappedMesh { mesh, charts: None, note: None });
        }
    }

    #[test]
    fn bad_coordinates_are_replaced_and_the_note_says_why() {
        let good = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        let with = |change: &dyn Fn(usize, Vec2) -> Vec2| {
            let uvs = good.uvs.as_ref().unwrap().iter().enumerate().map(|(i, &uv)| change(i, uv)).collect();
            Mesh { uvs: Some(uvs), ..good.clone() }
        };
        for (mesh, word) in [
            (with(&|_, uv| uv * 2.0), "outside"),
            (with(&|_, _| Vec2::NAN), "outside"),
            (with(&|_, _| Vec2::splat(0.5)), "no area"),
            // Every face on the same square.
            (with(&|i, _| [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y][i % 4]), "overlap"),
        ] {
            let replaced = unwrap_mesh(&mesh, 64).unwrap();
            let note = replaced.note.unwrap();
            assert!(note.contains(word), "{note}");
            assert_eq!(fault(&replaced.mesh, replaced.mesh.uvs.as_ref().unwrap(), 64), None);
        }
    }

    #[test]
    fn a_texture_that_is_too_small_is_an_error() {
        assert!(unwrap_mesh(&bare_sphere(), 4).is_err() && unwrap_mesh(&bare_sphere(), 0).is_err());
        // Separate triangles need more than a few texels each.
        let error = unwrap_mesh(&scattered(300), 16).unwrap_err();
        assert!(error.to_string().contains("charts of the unwrapped mesh do not fit 16²"), "{error}");
        assert!(error.exit_code() == 2 && error.help().unwrap().contains("texture_size"), "{error:?}");
    }
}
