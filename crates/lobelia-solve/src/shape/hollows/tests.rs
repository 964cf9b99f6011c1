use super::*;
use crate::shape::hull::{regrow, visual_hull};
use crate::shape::test_support::Pictures;
use glam::UVec3;
use lobelia_geometry::view::Camera;
use std::f32::consts::TAU;

const SIZE: u32 = 96;

/// A cup: a cylinder without what is above its floor and within its wall, both 0.12 thick.
fn cup(p: Vec3) -> f32 {
    let cylinder =
        |radius: f32, low: f32, high: f32| (p.with_y(0.0).length() - radius).max(p.y - high).max(low - p.y);
    cylinder(0.6, -0.5, 0.5).max(-cylinder(0.48, -0.38, 2.0))
}

fn full(p: Vec3) -> f32 {
    (p.with_y(0.0).length() - 0.6).max(p.y.abs() - 0.5)
}

/// Photographs of a field with a printed pattern, from all around, without shading.
fn pictures(field: impl Fn(Vec3) -> f32 + Sync, pattern: impl Fn(Vec3) -> f32 + Sync) -> Pictures {
    pictures_by_side(field, |at, _| pattern(at))
}

/// Photographs of a field with a color that also depends on the direction of the ray.
fn pictures_by_side(
    field: impl Fn(Vec3) -> f32 + Sync,
    pattern: impl Fn(Vec3, Vec3) -> f32 + Sync,
) -> Pictures {
    let grid = SdfGrid::from_fn(Vec3::ZERO, 0.8, 64, field);
    Pictures::new(Camera::around(70, 3.0, 36.0, SIZE).unwrap(), |_, ray| {
        let distance = grid.first_crossing(ray, 0.0)?;
        Some(Vec3::splat(pattern(ray.origin + ray.direction * distance, ray.direction)))
    })
}

/// The hull on a grid of `cells` cells a side, what `open` leaves of it, and the share that went.
fn opened(
    pictures: &Pictures,
    cells: u32,
    open: impl Fn(&mut SdfGrid, &[Silhouette], &[TrainingView]) -> f32,
) -> (SdfGrid, SdfGrid, f32) {
    let mut silhouettes = pictures.silhouettes();
    let hull = visual_hull(&mut silhouettes, cells).unwrap();
    let mut carved = hull.clone();
    let share = open(&mut carved, &silhouettes, &pictures.views());
    (hull, carved, share)
}

fn carved(pictures: &Pictures, cells: u32) -> (SdfGrid, SdfGrid, f32) {
    opened(pictures, cells, |hull, silhouettes, views| carve_hollows(hull, silhouettes, views, HULL_SHARE))
}

fn looked_through(pictures: &Pictures, cells: u32) -> (SdfGrid, SdfGrid, f32) {
    opened(pictures, cells, |grid, silhouettes, views| look_through(grid, silhouettes, views).0)
}

/// Expects that the hollow is open, and the wall at a radius and the floor at a height are not.
fn assert_is_a_cup(hull: &SdfGrid, carved: &SdfGrid, wall: f32, floor: f32) {
    for height in [0.35, 0.2] {
        let inside = Vec3::new(0.1, height, -0.1);
        assert!(hull.value(inside) < -0.05, "no silhouette shows the hollow");
        assert!(carved.value(inside) > 0.0, "{height}: {}", carved.value(inside));
    }
    for around in around() {
        let (wall, floor) = (wall * around, (0.3 * around).with_y(floor));
        assert!(carved.value(wall) < 0.0 && carved.value(floor) < 0.0, "{wall} {floor}");
    }
}

fn around() -> impl Iterator<Item = Vec3> {
    (0..24).map(|k| k as f32 * TAU / 24.0).map(|angle| Vec3::new(angle.cos(), 0.0, angle.sin()))
}

fn waves(p: Vec3) -> f32 {
    let (a, b) = ((23.0 * p.x).sin() + (21.0 * p.z + 1.0).sin(), (19.0 * p.y + 2.0).sin());
    0.3 + 0.05 * (a + b + (13.0 * (p.x + p.y - p.z)).sin())
}

#[test]
fn a_cup_is_opened_and_keeps_its_wall() {
    let (hull, carved, _) = carved(&pictures(cup, waves), 40);
    assert_is_a_cup(&hull, &carved, 0.54, -0.44);
}

/// Colors that change so slowly that no two photographs agree clearly on a depth.
fn soft(p: Vec3) -> f32 {
    0.3 + 0.12 * (4.0 * p.x + 1.0).sin() + 0.12 * (5.0 * p.z + 3.0 * p.y).sin()
}

#[test]
fn a_field_opens_a_cup_with_a_soft_pattern() {
    let (hull, carved, share) = looked_through(&pictures(cup, soft), 40);
    assert!(share > 0.2, "{share}");
    assert_is_a_cup(&hull, &carved, 0.57, -0.45);
}

#[test]
fn what_is_known_to_be_empty_stays_so_where_gaps_in_a_wall_are_closed() {
    // The wall has gaps all around, as where a grid is too coarse for it.
    let gaps = |p: Vec3| p.with_y(0.0).length() > 0.4 && p.y > -0.2 && (6.0 * p.z.atan2(p.x)).sin() > 0.0;
    let on_grid = |field: &(dyn Fn(Vec3) -> f32 + Sync)| SdfGrid::from_fn(Vec3::ZERO, 0.8, 40, field);
    let mut grid = on_grid(&|p| if gaps(p) { cup(p).max(0.03) } else { cup(p) });
    let opened = |p: Vec3| full(p) < 0.0 && cup(p) > grid.spacing;
    let empty = on_grid(&|p| if opened(p) { cup(p) - grid.spacing } else { f32::MIN });
    let inside = Vec3::new(0.1, 0.1, -0.1);
    let wall = |grid: &SdfGrid| around().filter(|around| grid.value(0.54 * *around) < 0.0).count();
    assert!(grid.value(inside) > 0.0 && wall(&grid) < 16);
    regrow(&mut grid, &pictures(cup, waves).silhouettes(), 0.0);
    assert!(grid.value(inside) < 0.0, "a lid: {}", grid.value(inside));
    keep_empty(&mut grid, &empty);
    assert!(grid.value(inside) > 0.0 && wall(&grid) == 24, "{} {}", grid.value(inside), wall(&grid));
}

#[test]
fn what_is_full_mirrors_or_has_no_pattern_stays_closed() {
    let mirrored = |at: Vec3, ray: Vec3| 0.5 * waves(at) + waves(at + 2.0 * ray);
    for (words, share) in [
        ("a field, reflections", looked_through(&pictures_by_side(full, mirrored), 28).2),
        ("a pattern", carved(&pictures(full, waves), 28).2),
        ("no pattern", carved(&pictures(cup, |_| 0.4), 28).2),
    ] {
        assert!(share < 0.005, "{words}: {share}");
    }
}

#[test]
fn a_narrow_hollow_needs_a_fine_grid() {
    let bored = |p: Vec3| full(p).max(-(p.with_y(0.0).length() - 0.2).max(0.2 - p.y));
    let pictures = pictures(bored, waves);
    let value = |cells| carved(&pictures, cells).1.value(Vec3::new(0.0, 0.38, 0.0));
    assert!(value(12) < 0.0, "{}", value(12));
    assert!(value(40) > 0.0, "{}", value(40));
}

#[test]
fn space_without_a_way_out_stays_full() {
    let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 20, |p| p.length() - 0.8);
    let middle_after = |is_empty: &dyn Fn(Vec3) -> bool| {
        let rows = 0..grid.values.len();
        let empty: Vec<f32> =
            rows.map(|row| if is_empty(grid.position(grid.vertex(row))) { 1.0 } else { -1.0 }).collect();
        let mut carved = grid.clone();
        carve(&mut carved, &empty);
        carved.values[grid.index(UVec3::splat(10))]
    };
    assert!(middle_after(&|p| p.length() < 0.4) < -0.5, "a bubble");
    let bottle = |p: Vec3| p.length() < 0.4 || (p.y > 0.0 && p.with_y(0.0).length() < 0.15);
    assert!(middle_after(&bottle) > 0.0, "a bottle");
}

/// Whether the inside of an open cup is still empty after the photographs were asked whether it is
/// one.
fn stays_open(pictures: &Pictures) -> bool {
    let of = |field: fn(Vec3) -> f32| SdfGrid::from_fn(Vec3::ZERO, 0.8, 40, field);
    let (mut grid, closed) = (of(cup), of(full));
    fill_reflections(&mut grid, &closed, &[], &MatchPicture::of_views(&pictures.views(), 1));
    grid.value(Vec3::new(0.0, 0.1, 0.0)) > 0.0
}

#[test]
fn a_hollow_with_a_pattern_stays_open_and_one_of_reflections_is_filled() {
    assert!(stays_open(&pictures(cup, waves)));
    assert!(!stays_open(&pictures_by_side(cup, |at, ray| waves(at + 2.0 * ray))));
}

#[test]
fn spaces_that_touch_along_edges_are_one() {
    let closed = SdfGrid::from_fn(Vec3::ZERO, 1.0, 4, |_| -1.0);
    let mut grid = closed.clone();
    for (x, y, z) in [(1, 1, 1), (1, 2, 1), (3, 3, 3), (2, 3, 1)] {
        let row = grid.index(UVec3::new(x, y, z));
        grid.values[row] = 1.0;
    }
    let (spaces, count) = opened_spaces(&grid, &closed);
    let of = |x, y, z| spaces[grid.index(UVec3::new(x, y, z))];
    assert!(count == 3 && of(1, 1, 1) == of(1, 2, 1) && of(1, 2, 1) != of(2, 3, 1), "{spaces:?}");
}
