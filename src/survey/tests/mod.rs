//! A small object photographed from all sides, and what the survey says when one thing is wrong with it.

mod axes;
mod cameras;
mod compact;
mod consensus;
mod masks;
mod output;
mod photographs;

use crate::math::fibonacci::fibonacci_axes;
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::primitive::box_mesh;
use crate::mesh::triangles::Mesh;
use crate::survey::look::{OpenPhotograph, OpenView};
use crate::survey::{MaskOrigin, Subject, Survey, ViewLook, examine};
use crate::view::{Camera, Image, Mask, Placement, Split};
use glam::Vec3;
use std::sync::OnceLock;

/// Width and height of the photographs.
const SIDE: u32 = 96;
/// Distance of the cameras.
const DISTANCE: f32 = 3.0;
/// Training and test views.
const VIEWS: [usize; 2] = [20, 4];

/// Three boxes that no turn and no mirror maps to themselves.
fn object() -> Mesh {
    let boxes = [
        (Vec3::ZERO, Vec3::new(1.1, 0.6, 0.4)),
        (Vec3::new(0.4, 0.5, 0.1), Vec3::new(0.25, 0.5, 0.2)),
        (Vec3::new(-0.4, -0.1, 0.45), Vec3::new(0.2, 0.25, 0.6)),
    ];
    joined(boxes.map(|(center, size)| box_mesh(center, size).unwrap()))
}

/// One mesh of several.
fn joined<const N: usize>(parts: [Mesh; N]) -> Mesh {
    let mut mesh = Mesh { uvs: Some(Vec::new()), ..Mesh::default() };
    for part in parts {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(part.positions);
        mesh.normals.extend(part.normals);
        mesh.uvs.as_mut().unwrap().extend(part.uvs.unwrap());
        mesh.triangles.extend(part.triangles.iter().map(|triangle| triangle.map(|vertex| vertex + first)));
    }
    mesh
}

/// The object seen by a camera: a checkered texture, and a mask.
fn photographed(name: &str, split: Split, camera: Camera, bvh: &TriangleBvh) -> OpenView {
    let count = camera.width * camera.height;
    let hits: Vec<Option<Vec3>> = (0..count)
        .map(|pixel| {
            let ray = camera.pixel_ray(pixel);
            bvh.nearest(&ray, 0.0).map(|hit| ray.origin + ray.direction * hit.distance)
        })
        .collect();
    let color = |hit: &Option<Vec3>| {
        let Some(at) = hit else { return Vec3::ZERO };
        let cell = ((*at + 10.013) / 0.09).floor();
        let dark = (cell.x + cell.y + cell.z).rem_euclid(2.0) < 1.0;
        Vec3::new(0.5, 0.4, 0.3) * if dark { 0.3 } else { 1.0 }
    };
    let (width, height) = (camera.width, camera.height);
    let image = Image { width, height, pixels: hits.iter().map(color).collect() };
    let coverage = hits.iter().map(|hit| f32::from(u8::from(hit.is_some()))).collect();
    OpenView {
        name: name.to_owned(),
        split,
        camera,
        photograph: Some(OpenPhotograph { saturated: vec![false; image.pixels.len()], image }),
        mask: Some(Mask { width, height, coverage }),
        placement: Placement::default(),
        negative: 0.0,
        exif: [1; 2],
    }
}

fn camera(direction: Vec3) -> Camera {
    let up = if direction.y.abs() > 0.95 { Vec3::X } else { Vec3::Y };
    // Cameras look a little beside the origin, so that no transposed pose is also a right one.
    Camera::look_at(direction * DISTANCE, Vec3::new(0.05, 0.08, -0.03), up, 38.0, SIDE, SIDE).unwrap()
}

/// The views without a fault.
fn good() -> Vec<OpenView> {
    static VIEWS_ONCE: OnceLock<Vec<OpenView>> = OnceLock::new();
    VIEWS_ONCE.get_or_init(|| views_of(&object())).clone()
}

/// The same of another object.
fn views_of(object: &Mesh) -> Vec<OpenView> {
    let bvh = TriangleBvh::new(object);
    let views = |split: Split, count: usize, letter: char| {
        let directions = fibonacci_axes(count).into_iter().enumerate();
        let turned =
            directions.map(|(i, d)| (i, if split == Split::Test { Vec3::new(d.z, d.y, -d.x) } else { d }));
        turned
            .map(|(i, direction)| photographed(&format!("{letter}{i}"), split, camera(direction), &bvh))
            .collect::<Vec<_>>()
    };
    [views(Split::Train, VIEWS[0], 'v'), views(Split::Test, VIEWS[1], 't')].concat()
}

fn looks(views: &[OpenView]) -> Vec<ViewLook> {
    let look = |view: &OpenView| {
        ViewLook::new(view, [view.camera.width, view.camera.height], MaskOrigin::File, true)
    };
    views.iter().map(look).collect()
}

/// A survey of views of a mesh, or of an unknown object.
fn surveyed(views: &[OpenView], mesh: Option<&Mesh>) -> Survey {
    let subject = Subject { mesh, up: Vec3::Y, texture_size: 128, refined: false, scored: true };
    examine(looks(views), &subject, &[])
}

/// Expects one finding alone, with these views and all words.
#[track_caller]
fn expect(survey: &Survey, name: &str, views: &[&str], words: &[&str]) {
    let names: Vec<&str> = survey.findings.iter().map(|finding| finding.name).collect();
    assert_eq!(names, [name], "{:#?}", survey.findings);
    let finding = &survey.findings[0];
    assert_eq!(finding.views, views, "{finding:?}");
    let text = format!("{} | {}", finding.problem, finding.help);
    words.iter().for_each(|word| assert!(text.contains(word), "no `{word}` in: {text}"));
    assert!(!finding.help.is_empty());
}

#[test]
fn nothing_is_wrong_with_good_views() {
    let views = good();
    let with_mesh = surveyed(&views, Some(&object()));
    assert_eq!(with_mesh.findings, []);
    assert!(with_mesh.mesh_iou.iter().all(|iou| iou.unwrap() > 0.99), "{:?}", with_mesh.mesh_iou);
    let without = surveyed(&views, None);
    assert_eq!(without.findings, []);
    assert!(without.hull_iou.unwrap() > 0.75, "{:?}", without.hull_iou);
    let uncovered = || without.mask_uncovered.iter().map(|share| share.unwrap());
    assert!(uncovered().all(|share| share < 0.02), "{:?}", without.mask_uncovered);
}

#[test]
fn the_same_views_give_the_same_survey() {
    let values = || {
        let survey = surveyed(&good(), None);
        (survey.hull_iou, survey.compared, survey.arrangement)
    };
    assert_eq!(values(), values());
}
