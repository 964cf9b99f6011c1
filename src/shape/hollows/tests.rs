use super::*;
use crate::shape::hull::visual_hull;
use crate::shape::hull_repair::regrow;
use crate::shape::silhouette::Silhouette;
use crate::shape::stereo::everybodys_views;
use crate::view::{Camera, Image, Mask, Photograph, StoredMask};
use glam::UVec3;

const SIZE: u32 = 128;

/// A cup: a cylinder without what is above its floor and within its wall, both 0.12 thick.
fn cup(p: Vec3) -> f32 {
    let cylinder =
        |radius: f32, low: f32, high: f32| (p.with_y(0.0).length() - radius).max(p.y - high).max(low - p.y);
    cylinder(0.6, -0.5, 0.5).max(-cylinder(0.48, -0.38, 2.0))
}

/// The same, filled to the brim.
fn full(p: Vec3) -> f32 {
    (p.with_y(0.0).length() - 0.6).max(p.y.abs() - 0.5)
}

/// Photographs of a field with a printed pattern, from all around, without shading.
struct Pictures {
    cameras: Vec<Camera>,
    photographs: Vec<Photograph>,
    masks: Vec<StoredMask>,
}

impl Pictures {
    fn new(field: impl Fn(Vec3) -> f32 + Sync, pattern: impl Fn(Vec3) -> f32 + Sync) -> Self {
        Self::from_each_side(field, |at, _| pattern(at))
    }

    /// The same, with a color that also depends on the direction of the ray.
    fn from_each_side(
        field: impl Fn(Vec3) -> f32 + Sync,
        pattern: impl Fn(Vec3, Vec3) -> f32 + Sync,
    ) -> Self {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 0.8, 64, field);
        let cameras = Camera::around(70, 3.0, 36.0, SIZE).unwrap();
        let picture = |camera: &Camera| {
            let color = |pixel: u32| {
                let ray = camera.pixel_ray(pixel);
                let distance = grid.first_crossing(&ray, 0.0)?;
                Some(Vec3::splat(pattern(ray.origin + ray.direction * distance, ray.direction)))
            };
            (0..SIZE * SIZE).map(color).collect::<Vec<Option<Vec3>>>()
        };
        let shown: Vec<Vec<Option<Vec3>>> = cameras.par_iter().map(picture).collect();
        let photograph = |shown: &Vec<Option<Vec3>>| {
            let pixels = shown.iter().map(|color| color.unwrap_or(Vec3::ZERO)).collect();
            Photograph::of_image(&Image { width: SIZE, height: SIZE, pixels })
        };
        let mask = |shown: &Vec<Option<Vec3>>| {
            let coverage = shown.iter().map(|color| f32::from(u8::from(color.is_some()))).collect();
            StoredMask::new(&Mask { width: SIZE, height: SIZE, coverage })
        };
        let photographs = shown.iter().map(photograph).collect();
        Self { cameras, photographs, masks: shown.iter().map(mask).collect() }
    }

    fn views(&self) -> TrainingViews<'_> {
        let parts = self.cameras.iter().zip(&self.photographs).zip(&self.masks);
        everybodys_views(parts.map(|((camera, photograph), mask)| (camera, photograph, mask)))
    }

    fn silhouettes(&self) -> Vec<Silhouette> {
        let views = self.cameras.iter().zip(&self.masks).enumerate();
        views.map(|(i, (camera, mask))| Silhouette::new(&format!("v{i}"), camera, mask).unwrap()).collect()
    }

    /// The hull, what is left of it, and the share that went.
    fn carved(&self) -> (SdfGrid, SdfGrid, f32) {
        self.carved_with(40)
    }

    /// The same on a grid of `cells` cells a side.
    fn carved_with(&self, cells: u32) -> (SdfGrid, SdfGrid, f32) {
        self.opened_by(cells, |hull, silhouettes, views| {
            carve_hollows(hull, silhouettes, views, HULL_SHARE).unwrap()
        })
    }

    /// The same by `open`.
    fn opened_by(
        &self,
        cells: u32,
        open: impl Fn(&mut SdfGrid, &[Silhouette], &TrainingViews) -> f32,
    ) -> (SdfGrid, SdfGrid, f32) {
        let mut silhouettes = self.silhouettes();
        let hull = visual_hull(&mut silhouettes, cells, None).unwrap();
        let mut carved = hull.clone();
        let share = open(&mut carved, &silhouettes, &self.views());
        (hull, carved, share)
    }
}

fn waves(p: Vec3) -> f32 {
    let (a, b) = ((23.0 * p.x).sin() + (21.0 * p.z + 1.0).sin(), (19.0 * p.y + 2.0).sin());
    0.3 + 0.05 * (a + b + (13.0 * (p.x + p.y - p.z)).sin())
}

#[test]
fn a_cup_is_opened_and_keeps_its_wall() {
    let (hull, carved, _) = Pictures::new(cup, waves).carved();
    for height in [0.35, 0.2] {
        let inside = Vec3::new(0.1, height, -0.1);
        assert!(hull.value(inside) < -0.05, "no silhouette shows the hollow");
        assert!(carved.value(inside) > 0.0, "{height}: {}", carved.value(inside));
    }
    let around = (0..24).map(|k| k as f32 * std::f32::consts::TAU / 24.0);
    for angle in around {
        for y in [-0.3, 0.0, 0.3] {
            let wall = Vec3::new(0.54 * angle.cos(), y, 0.54 * angle.sin());
            assert!(carved.value(wall) < 0.0, "{wall} {}", carved.value(wall));
        }
        let floor = Vec3::new(0.3 * angle.cos(), -0.44, 0.3 * angle.sin());
        assert!(carved.value(floor) < 0.0, "{floor}");
    }
}

/// Colors that change so slowly that no two photographs agree clearly on a depth.
fn soft(p: Vec3) -> f32 {
    0.3 + 0.12 * (4.0 * p.x + 1.0).sin() + 0.12 * (5.0 * p.z + 3.0 * p.y).sin()
}

#[test]
fn a_field_opens_a_cup_with_a_soft_pattern() {
    let (hull, carved, share) = Pictures::new(cup, soft)
        .opened_by(40, |grid, silhouettes, views| look_through(grid, silhouettes, views).unwrap().0);
    assert!(share > 0.2, "{share}");
    for height in [0.35, 0.2] {
        let inside = Vec3::new(0.1, height, -0.1);
        assert!(hull.value(inside) < -0.05, "no silhouette shows the hollow");
        assert!(carved.value(inside) > 0.0, "{height}: {}", carved.value(inside));
    }
    for angle in (0..24).map(|k| k as f32 * std::f32::consts::TAU / 24.0) {
        let wall = Vec3::new(0.57 * angle.cos(), 0.0, 0.57 * angle.sin());
        let floor = Vec3::new(0.3 * angle.cos(), -0.45, 0.3 * angle.sin());
        assert!(carved.value(wall) < 0.0 && carved.value(floor) < 0.0, "{wall} {floor}");
    }
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
    let wall = |grid: &SdfGrid| (0..24).filter(|k| grid.value(on_wall(*k)) < 0.0).count();
    assert!(grid.value(inside) > 0.0 && wall(&grid) < 16);
    regrow(&mut grid, &Pictures::new(cup, waves).silhouettes(), 0.0);
    assert!(grid.value(inside) < 0.0, "a lid: {}", grid.value(inside));
    keep_empty(&mut grid, &empty);
    assert!(grid.value(inside) > 0.0 && wall(&grid) == 24, "{} {}", grid.value(inside), wall(&grid));
}

/// A place in the middle of the cup's wall, the k-th of 24 around.
fn on_wall(k: u32) -> Vec3 {
    let angle = k as f32 * std::f32::consts::TAU / 24.0;
    Vec3::new(0.54 * angle.cos(), 0.0, 0.54 * angle.sin())
}

#[test]
fn a_field_opens_nothing_that_is_full_or_mirrors() {
    let (_, _, share) = Pictures::new(full, waves)
        .opened_by(40, |grid, silhouettes, views| look_through(grid, silhouettes, views).unwrap().0);
    assert!(share < 0.005, "a pattern: {share}");
    let mirrored = |at: Vec3, ray: Vec3| 0.5 * waves(at) + waves(at + 2.0 * ray);
    let (_, _, share) = Pictures::from_each_side(full, mirrored)
        .opened_by(40, |grid, silhouettes, views| look_through(grid, silhouettes, views).unwrap().0);
    assert!(share < 0.005, "reflections: {share}");
}

#[test]
fn a_narrow_hollow_needs_a_fine_grid() {
    let bored = |p: Vec3| {
        (p.with_y(0.0).length() - 0.6)
            .max(p.y.abs() - 0.5)
            .max(-(p.with_y(0.0).length() - 0.2).max(0.2 - p.y))
    };
    let pictures = Pictures::new(bored, waves);
    let value = |cells| pictures.carved_with(cells).1.value(Vec3::new(0.0, 0.38, 0.0));
    assert!(value(12) < 0.0, "{}", value(12));
    assert!(value(48) > 0.0, "{}", value(48));
}

#[test]
fn what_is_full_stays_full() {
    let (_, _, share) = Pictures::new(full, waves).carved();
    assert!(share < 0.005, "{share}");
}

#[test]
fn a_hollow_without_a_pattern_stays_closed() {
    let (_, _, share) = Pictures::new(cup, |_| 0.4).carved();
    assert!(share < 0.005, "{share}");
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

/// What is left of an open cup after the photographs were asked whether it is one: whether its inside is still empty.
fn stays_open(pictures: &Pictures) -> bool {
    let of = |field: fn(Vec3) -> f32| SdfGrid::from_fn(Vec3::ZERO, 0.8, 40, field);
    let (mut grid, closed) = (of(cup), of(full));
    fill_reflections(&mut grid, &closed, &[], &match_pictures(&pictures.views(), 1).unwrap());
    grid.value(Vec3::new(0.0, 0.1, 0.0)) > 0.0
}

#[test]
fn a_hollow_with_a_pattern_stays_open_and_one_of_reflections_is_filled() {
    assert!(stays_open(&Pictures::new(cup, waves)));
    assert!(!stays_open(&Pictures::from_each_side(cup, |at, ray| waves(at + 2.0 * ray))));
}

#[test]
fn spaces_that_touch_along_edges_are_one() {
    let closed = SdfGrid::from_fn(Vec3::ZERO, 1.0, 4, |_| -1.0);
    let mut grid = closed.clone();
    for (x, y, z) in [(1, 1, 1), (1, 2, 1), (3, 3, 3), (2, 3, 1)] {
        let row = grid.index(UVec3::new(x, y, z));
        grid.values[row] = 1.0;
    }
    let (spaces, count) = reflections::opened_spaces(&grid, &closed);
    let of = |x, y, z| spaces[grid.index(UVec3::new(x, y, z))];
    assert!(count == 3 && of(1, 1, 1) == of(1, 2, 1) && of(1, 2, 1) != of(2, 3, 1), "{spaces:?}");
}
