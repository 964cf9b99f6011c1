use super::flatten::{Laplacian, energy, is_simple};
use super::*;
use crate::mesh::primitive::box_mesh;
use crate::mesh::tests::{ball, plate, scattered, torus, tube};
use glam::Vec3;

fn doubled_area(chart: &Chart, triangle: &[u32; 3]) -> f64 {
    let [a, b, c] = triangle.map(|v| chart.places[v as usize]);
    (b - a).perp_dot(c - a)
}

/// Points of a grid over the chart that lie strictly inside two triangles.
fn doubly_covered(chart: &Chart) -> usize {
    let low = chart.places.iter().copied().fold(DVec2::INFINITY, DVec2::min);
    let high = chart.places.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
    let step = (high - low).max_element() / 96.0;
    let mut owners = vec![0; 97 * 97];
    for triangle in &chart.triangles {
        let corners = triangle.map(|v| (chart.places[v as usize] - low) / step);
        let from = corners[0].min(corners[1]).min(corners[2]).as_uvec2();
        let to = corners[0].max(corners[1]).max(corners[2]).as_uvec2();
        for (x, y) in (from.y..=to.y).flat_map(|y| (from.x..=to.x).map(move |x| (x, y))) {
            let at = DVec2::new(f64::from(x), f64::from(y));
            let side = |k: usize| (corners[(k + 1) % 3] - corners[k]).perp_dot(at - corners[k]);
            owners[(y * 97 + x) as usize] += u32::from((0..3).all(|k| side(k) > 1e-9));
        }
    }
    owners.iter().filter(|count| **count > 1).count()
}

/// The charts of a mesh, after a look at all that must hold.
fn good_charts(mesh: &Mesh) -> Vec<Chart> {
    let found = charts(mesh).unwrap();
    let mut faces: Vec<u32> = found.iter().flat_map(|chart| chart.faces.iter().copied()).collect();
    faces.sort_unstable();
    let expected: Vec<u32> =
        (0..mesh.triangles.len() as u32).filter(|t| !mesh.is_degenerate(*t as usize)).collect();
    assert_eq!(faces, expected, "each triangle with area in one chart");
    let (mut uneven, mut total) = (0.0, 0.0);
    for chart in &found {
        let mut area = 0.0;
        for (face, triangle) in chart.faces.iter().zip(&chart.triangles) {
            let [a, b, c] = mesh.corners(*face as usize).map(|p| p.as_dvec3());
            let (here, there) = (doubled_area(chart, triangle), (b - a).cross(c - a).length());
            assert!(here > 0.0, "triangle {face} is turned over");
            area += there;
            total += there;
            uneven += if (0.5..=2.0).contains(&(here / there)) { 0.0 } else { there };
        }
        assert!((2.0 * chart.area() / area - 1.0).abs() < 1e-6, "as large as in the world");
        assert_eq!(doubly_covered(chart), 0);
    }
    assert!(uneven <= JOINED.uneven * total, "{uneven} of {total} is uneven");
    found
}

#[test]
fn charts_are_few_and_flat_and_cover_nothing_twice() {
    // A closed ball, a torus with its handle, a tube with two borders, flat and thin parts with
    // creases.
    for (mesh, most) in [
        (ball(16, 0.0), 8),
        (torus(24, 12), 14),
        (tube(32, 12), 4),
        (box_mesh(Vec3::ZERO, Vec3::ONE).unwrap(), 6),
    ] {
        let found = good_charts(&mesh);
        assert!(found.len() <= most, "{} charts, more than {most}", found.len());
    }
    assert_eq!(good_charts(&plate(12)).len(), 1);
}

#[test]
fn noise_makes_no_specks() {
    let found = good_charts(&ball(24, 0.02));
    let specks = found.iter().filter(|chart| chart.faces.len() < 16).count();
    assert!(found.len() <= 16 && specks == 0, "{} charts, {specks} specks", found.len());
}

#[test]
fn any_triangles_get_charts() {
    assert_eq!(good_charts(&scattered(40)).len(), 40);
    let one = Mesh { triangles: vec![[0, 1, 2]], ..scattered(1) };
    assert_eq!(good_charts(&one).len(), 1);
    assert_eq!(charts(&Mesh::default()).unwrap().len(), 0);
    // Three triangles on an edge, one twice, one turned, one without area.
    let mut fan = scattered(2);
    fan.positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, -Vec3::Y, Vec3::new(2.0, 0.0, 0.0)];
    fan.triangles = vec![[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 1, 2], [1, 5, 3], [0, 1, 5], [2, 2, 2]];
    let found = good_charts(&fan);
    assert!(found.iter().map(|chart| chart.faces.len()).sum::<usize>() == 5);
    // All without area.
    fan.triangles = vec![[0, 1, 5], [3, 3, 1]];
    assert_eq!(charts(&fan).unwrap().len(), 0);
}

#[test]
fn size_does_not_matter() {
    for scale in [1e-15, 1e-3, 1e9] {
        let mut mesh = ball(16, 0.0);
        mesh.positions.iter_mut().for_each(|p| *p *= scale);
        good_charts(&mesh);
    }
}

#[test]
fn a_crease_is_a_seam() {
    // Two plates at a sharp angle, each 12 × 12 squares.
    let flat = plate(12);
    let mut bent = flat.clone();
    let fold = |p: Vec3| Vec3::new(p.x.abs(), p.y, if p.x < 0.0 { -0.15 * p.x } else { 0.0 });
    bent.positions.iter_mut().for_each(|p| *p = fold(*p));
    let found = good_charts(&bent);
    assert_eq!(found.len(), 2);
    for chart in found {
        let sides: Vec<bool> =
            chart.faces.iter().map(|t| bent.corners(*t as usize).iter().any(|p| p.z > 0.0)).collect();
        assert!(sides.iter().all(|side| *side == sides[0]), "a chart goes over the crease");
    }
}

fn patch_of(mesh: &Mesh) -> Patch {
    let topology = Topology::new(mesh);
    let faces = (0..mesh.triangles.len() as u32).filter(|t| topology.has_area(*t)).collect();
    Patch::new(&topology, faces)
}

#[test]
fn only_what_lies_in_a_plane_is_flattened() {
    let loose = Tolerance { mean: 1e9, uneven: 1.0 };
    for (mesh, count, planar) in
        [(plate(4), 1, true), (tube(12, 3), 2, true), (ball(8, 0.0), 0, false), (torus(12, 8), 0, false)]
    {
        let patch = patch_of(&mesh);
        assert_eq!((loops(&patch.border).count(), patch.is_planar()), (count, planar));
        assert!(planar || flatten(&patch, &loose).is_none());
    }
    // Two parts are not one patch.
    assert!(!patch_of(&scattered(2)).is_planar());
    // A cap of a ball: with distortion, and not without.
    let mut cap = ball(16, 0.0);
    let up = |t: &[u32; 3]| t.iter().all(|v| cap.positions[*v as usize].y >= 0.4);
    cap.triangles = cap.triangles.iter().copied().filter(up).collect();
    let patch = patch_of(&cap);
    assert!(flatten(&patch, &USUAL).is_some());
    assert!(flatten(&patch, &Tolerance { mean: 4.01, uneven: 0.0 }).is_none());
}

#[test]
fn triangles_that_meet_in_a_point_have_vertices_of_their_own() {
    let mut mesh = scattered(2);
    mesh.positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y, -Vec3::X, -Vec3::Y];
    mesh.triangles = vec![[0, 1, 2], [0, 3, 4]];
    let patch = patch_of(&mesh);
    assert_eq!((patch.points.len(), loops(&patch.border).count(), patch.border.len()), (6, 2, 6));
}

#[test]
fn borders_that_cross_are_found() {
    let closed = |n: u32| (0..n).map(|i| [i, (i + 1) % n]).collect::<Vec<_>>();
    let corners = |points: &[(f64, f64)]| points.iter().map(|p| DVec2::from(*p)).collect::<Vec<_>>();
    let square = corners(&[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]);
    assert!(is_simple(&closed(4), &square));
    assert!(!is_simple(&closed(4), &[square[0], square[2], square[1], square[3]]));
    // Clockwise, the patch would be outside.
    assert!(!is_simple(&closed(4), &corners(&[(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)])));
    // A hole, one across the side, one that has turned inside out, one that has closed.
    let two: Vec<[u32; 2]> =
        closed(4).into_iter().chain(closed(4).iter().map(|e| e.map(|v| v + 4))).collect();
    let with = |by: DVec2, sides: DVec2| {
        let hole = square.iter().rev().map(|p| *p * sides + by);
        [&square[..], &hole.collect::<Vec<_>>()].concat()
    };
    let quarter = DVec2::splat(0.25);
    assert!(is_simple(&two, &with(DVec2::splat(0.3), quarter)));
    assert!(!is_simple(&two, &with(DVec2::new(0.9, 0.3), quarter)));
    assert!(!is_simple(&two, &with(DVec2::splat(0.6), quarter * DVec2::new(-1.0, 1.0))));
    assert!(is_simple(&two, &with(DVec2::splat(0.3), DVec2::new(0.25, 0.0))));
}

#[test]
fn energy_knows_rigid_stretched_and_turned() {
    let turn = [DVec2::new(0.6, 0.8), DVec2::new(-0.8, 0.6)];
    assert!((energy(turn) - 4.0).abs() < 1e-12);
    assert!((energy([DVec2::new(2.0, 0.0), DVec2::new(0.0, 1.0)]) - 6.25).abs() < 1e-12);
    assert_eq!(energy([DVec2::X, -DVec2::Y]), f64::INFINITY);
    assert_eq!(energy([DVec2::X, DVec2::X]), f64::INFINITY);
}

#[test]
fn descent_lowers_the_energy_along_its_gradient() {
    let patch = patch_of(&plate(6));
    let laplacian = Laplacian::new(&patch);
    let bent = |p: &DVec3| DVec2::new(p.x + 0.2 * p.y * p.y, 0.6 * p.y + 0.1 * p.x * p.x);
    let mut map: Vec<DVec2> = patch.points.iter().map(bent).collect();
    let before = patch.mean_energy(&map);
    assert!(before.is_finite() && before > 4.2, "{before}");
    let gradient = patch.gradient(&map);
    for vertex in [0, 17, 30] {
        for axis in 0..2 {
            let moved = |by: f64| {
                let mut map = map.clone();
                map[vertex][axis] += by;
                patch.mean_energy(&map)
            };
            let difference = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            let found = gradient[vertex][axis];
            assert!((difference - found).abs() < 1e-6, "{difference} {found}");
        }
    }
    let after = patch.even_out(&laplacian, &mut map, (60, 1e-6, 4.0));
    assert!(after < 4.001 && (patch.mean_energy(&map) - after).abs() < 1e-12, "{before} {after}");
}

#[test]
fn the_laplacian_is_solved() {
    let patch = patch_of(&plate(8));
    let laplacian = Laplacian::new(&patch);
    let mut right = vec![DVec2::ZERO; patch.points.len()];
    (right[3], right[40]) = (DVec2::new(1.0, -2.0), DVec2::new(-1.0, 2.0));
    let x = laplacian.solve(&right, 1e-12, 500);
    for (vertex, wanted) in right.iter().enumerate() {
        let edges = &laplacian.edges[vertex];
        let found: DVec2 = edges.iter().map(|(to, weight)| (x[vertex] - x[*to as usize]) * *weight).sum();
        assert!((found - *wanted).length() < 1e-9);
    }
    // Nothing to do, and nothing that can be done.
    assert!(laplacian.solve(&vec![DVec2::ZERO; right.len()], 1e-6, 10).iter().all(|x| *x == DVec2::ZERO));
    assert!(laplacian.solve(&vec![DVec2::NAN; right.len()], 1e-6, 10).iter().all(|x| *x == DVec2::ZERO));
}

#[test]
fn regions_form_a_tree_over_all_triangles() {
    let mesh = torus(16, 8);
    let tree = RegionTree::new(&Topology::new(&mesh));
    let mut all: Vec<u32> = tree.roots.iter().flat_map(|root| tree.triangles(*root)).collect();
    all.sort_unstable();
    assert_eq!(all, (0..mesh.triangles.len() as u32).collect::<Vec<_>>());
    let total: u32 = tree.roots.iter().map(|root| tree.counts[*root as usize]).sum();
    assert_eq!(total as usize, all.len());
    for (i, node) in tree.nodes.iter().enumerate() {
        assert!(!matches!(node, RegionNode::Pair(a, b) if *a as usize >= i || *b as usize >= i));
    }
}
