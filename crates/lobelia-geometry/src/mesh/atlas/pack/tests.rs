use super::page::CellRun;
use super::*;
use crate::mesh::tests::{ball, plate, scattered, torus};
use crate::{mesh::atlas::chart::charts, mesh::triangles::Mesh};

/// Where triangle corners lie in the texture, in texels, with the chart's number.
fn corners(charts: &[Chart]) -> impl Iterator<Item = (usize, [DVec2; 3])> {
    let all = charts.iter().enumerate();
    all.flat_map(|(i, chart)| chart.triangles.iter().map(move |t| (i, t.map(|v| chart.places[v as usize]))))
}

/// Packs a mesh and looks at everything that must hold; the part of the texture that triangles
/// fill.
fn good_fill(mesh: &Mesh, size: u32) -> f64 {
    let mut all = charts(mesh).unwrap();
    let areas: Vec<f64> = all.iter().map(Chart::area).collect();
    assert!(pack(&mut all, size));
    // One scale, and nothing mirrored.
    let scales: Vec<f64> = all.iter().zip(&areas).map(|(chart, area)| chart.area() / area).collect();
    assert!(scales.iter().all(|scale| *scale > 0.0 && (scale / scales[0] - 1.0).abs() < 1e-9), "{scales:?}");
    // The texels that each chart touches, by their squares.
    let mut owner = vec![usize::MAX; (size * size) as usize];
    for (chart, triangle) in corners(&all) {
        let inner = f64::from(MARGIN)..=f64::from(size - MARGIN);
        assert!(triangle.iter().all(|p| inner.contains(&p.x) && inner.contains(&p.y)));
        let steps = 2 + (triangle[0].distance(triangle[1]) + triangle[0].distance(triangle[2])) as u32 * 2;
        for (a, b) in (0..=steps).flat_map(|a| (0..=steps - a).map(move |b| (a, b))) {
            // Just inside, since borders of texels are nobody's.
            let [a, b] = [a, b].map(|w| 1e-6 + (1.0 - 3e-6) * f64::from(w) / f64::from(steps));
            let at = (triangle[0] * (1.0 - a - b) + triangle[1] * a + triangle[2] * b).as_uvec2();
            let texel = &mut owner[(at.y * size + at.x) as usize];
            assert!(*texel == usize::MAX || *texel == chart, "two charts on a texel");
            *texel = chart;
        }
    }
    let reach = GUTTER as i32;
    for (x, y) in (0..size as i32).flat_map(|y| (0..size as i32).map(move |x| (x, y))) {
        let own = owner[(y * size as i32 + x) as usize];
        for (dx, dy) in (0..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy))) {
            let inside = (0..size as i32).contains(&(x + dx)) && y + dy < size as i32;
            let other = if inside { owner[((y + dy) * size as i32 + x + dx) as usize] } else { own };
            let apart = own == usize::MAX || other == usize::MAX || own == other;
            assert!(apart, "charts {own}, {other} at {x} {y}");
        }
    }
    all.iter().map(Chart::area).sum::<f64>() / f64::from(size).powi(2)
}

#[test]
fn charts_are_apart_and_fill_the_texture() {
    for (mesh, size, least) in [
        (ball(16, 0.0), 256, 0.5),
        (torus(24, 12), 128, 0.4),
        (scattered(60), 128, 0.15),
        (plate(2), 64, 0.85),
        (scattered(1), 32, 0.15),
    ] {
        let fill = good_fill(&mesh, size);
        assert!(fill >= least, "{fill} of {size}²");
    }
    // Cells of two texels, and a size that no cell divides.
    good_fill(&ball(8, 0.0), 601);
}

#[test]
fn too_many_charts_do_not_fit() {
    let mut all = charts(&scattered(30)).unwrap();
    for (size, fits) in
        [(0, false), (1, false), (4, false), (16, false), (24, false), (64, true), (4096, true)]
    {
        assert_eq!(pack(&mut all.clone(), size), fits, "{size}");
    }
    assert!(pack(&mut [], 64));
    all.truncate(1);
    assert!(pack(&mut all, 8));
}

#[test]
fn boxes_are_smallest() {
    let turn = DVec2::from_angle(0.4);
    let along = |x: f64, y: f64| turn.rotate(DVec2::new(x, y)) + DVec2::new(5.0, -7.0);
    let mut points =
        vec![along(0.0, 0.0), along(0.0, 2.0), along(3.0, 1.0), along(5.0, 0.0), along(5.0, 2.0)];
    let corner = set_upright(&mut points);
    assert!((corner - DVec2::new(5.0, 2.0)).length() < 1e-9, "{corner}");
    assert!(points.iter().all(|p| p.min_element() >= 0.0 && p.x <= corner.x && p.y <= corner.y));
    // The place in the middle stays there.
    assert!((points[2].y - 1.0).abs() < 1e-9);
    let mut line = vec![along(0.0, 0.0), along(1.0, 0.0), along(4.0, 0.0)];
    let corner = set_upright(&mut line);
    assert!((corner - DVec2::new(4.0, 0.0)).length() < 1e-9, "{corner}");
}

#[test]
fn masks_hold_all_that_a_triangle_touches() {
    let triangle = [DVec2::new(0.2, 0.1), DVec2::new(70.4, 3.7), DVec2::new(1.3, 9.6)];
    let mask = CellMask::new([triangle].into_iter(), DVec2::new(70.4, 9.6));
    assert_eq!(mask.size, UVec2::new(71, 10));
    let has = |x: u32, y: u32| mask.runs.iter().any(|run| run.y == y && (run.from..=run.to).contains(&x));
    for (a, b) in (0..=200).flat_map(|a| (0..=200 - a).map(move |b| (a, b))) {
        let [a, b] = [a, b].map(|w| f64::from(w) / 200.0);
        let at = triangle[0] * (1.0 - a - b) + triangle[1] * a + triangle[2] * b;
        assert!(has(at.x as u32, at.y as u32), "{at}");
    }
    assert!(!has(70, 0) && !has(70, 9) && mask.cells() < 71 * 10 * 2 / 3);
}

/// The first place by looking at every cell.
fn plain_find(taken: &[bool], side: u32, mask: &CellMask) -> Option<UVec2> {
    let is_taken = |x: u32, y: u32| taken[(y * side + x) as usize];
    let fits = |at: UVec2, run: &CellRun| (run.from..=run.to).all(|x| !is_taken(at.x + x, at.y + run.y));
    let free = |at: UVec2| mask.runs.iter().all(|run| fits(at, run));
    let end = |length: u32| (side + 1).saturating_sub(length);
    let mut places = (0..end(mask.size.y)).flat_map(|y| (0..end(mask.size.x)).map(move |x| UVec2::new(x, y)));
    places.find(|at| free(*at))
}

#[test]
fn the_lowest_place_is_found() {
    let (side, margin, gutter) = (150, 2, 3);
    let mut page = Page::new(side, margin);
    let outer = |c: u32| c < margin || c >= side - margin;
    let mut taken: Vec<bool> = (0..side * side).map(|i| outer(i % side) || outer(i / side)).collect();
    let mut scratch = Default::default();
    for number in 0..60 {
        let random = |i: u64| (chance(number, i) + 1.0) / 2.0;
        let far = DVec2::new(random(0) * 69.0, random(1) * 30.0);
        let point = |i: u64| DVec2::new(random(i), random(i + 1)) * far;
        let triangles = [[point(2), point(4), far], [DVec2::ZERO, point(6), point(8)]];
        let mask = CellMask::new(triangles.into_iter(), far);
        let found = page.find(&mask, 0..side, &mut scratch);
        assert_eq!(found, plain_find(&taken, side, &mask), "mask {number}");
        let Some(at) = found else { continue };
        assert_eq!(page.find(&mask, 0..at.y, &mut scratch), None);
        page.take(&mask, at, gutter);
        for CellRun { y, from, to } in mask.runs {
            let reach = |low: u32, high: u32| low.saturating_sub(gutter)..=(high + gutter).min(side - 1);
            for y in reach(at.y + y, at.y + y) {
                reach(at.x + from, at.x + to).for_each(|x| taken[(y * side + x) as usize] = true);
            }
        }
    }
    let wide = CellMask { size: UVec2::new(151, 1), runs: vec![CellRun { y: 0, from: 0, to: 150 }] };
    assert_eq!(page.find(&wide, 0..side, &mut scratch), None);
    let point = CellMask::new([[DVec2::ZERO; 3]].into_iter(), DVec2::ZERO);
    assert_eq!(Page::new(4, 2).find(&point, 0..4, &mut scratch), None);
}
