use super::*;
use crate::math::ray::Ray;
use crate::math::statistics::median;
use crate::mesh::primitive::sphere_mesh;
use crate::sdf::SdfGrid;
use crate::view::{Image, Mask};
use std::ops::ControlFlow::Continue;

const SIZE: u32 = 160;

/// A sphere of radius 1 with a fine pattern, without shading, as cameras around it see it.
struct Pictures {
    cameras: Vec<Camera>,
    photographs: Vec<Photograph>,
    masks: Vec<StoredMask>,
}

impl Pictures {
    fn new() -> Self {
        Self::of(|at, _| pattern(at))
    }

    /// Of a ball whose color depends on the place and on the direction in which a ray goes on from there.
    fn of(color: impl Fn(Vec3, Vec3) -> Vec3) -> Self {
        let cameras = Camera::around(60, 3.5, 40.0, SIZE).unwrap();
        let (mut photographs, mut masks) = (Vec::new(), Vec::new());
        for camera in &cameras {
            let shown: Vec<Option<Vec3>> =
                (0..SIZE * SIZE).map(|pixel| ball(&camera.pixel_ray(pixel), &color)).collect();
            let pixels = shown.iter().map(|color| color.unwrap_or(Vec3::ZERO)).collect();
            photographs.push(Photograph::of_image(&Image { width: SIZE, height: SIZE, pixels }));
            let coverage = shown.iter().map(|color| f32::from(u8::from(color.is_some()))).collect();
            masks.push(StoredMask::new(&Mask { width: SIZE, height: SIZE, coverage }));
        }
        Self { cameras, photographs, masks }
    }

    fn views(&self) -> TrainingViews<'_> {
        let parts = self.cameras.iter().zip(&self.photographs).zip(&self.masks);
        everybodys_views(parts.map(|((camera, photograph), mask)| (camera, photograph, mask)))
    }
}

/// What a ray sees: the color at its first point on the ball, by place and mirrored direction.
fn ball(ray: &Ray, color: impl Fn(Vec3, Vec3) -> Vec3) -> Option<Vec3> {
    let middle = -ray.origin.dot(ray.direction);
    let root = middle * middle - ray.origin.length_squared() + 1.0;
    let p = ray.origin + ray.direction * (middle - root.max(0.0).sqrt());
    (root > 0.0).then(|| color(p, ray.direction - p * (2.0 * p.dot(ray.direction))))
}

fn pattern(p: Vec3) -> Vec3 {
    let waves = (31.0 * p.x).sin()
        + (27.0 * p.y + 1.0).sin()
        + (29.0 * p.z + 2.0).sin()
        + (17.0 * (p.x + p.y - p.z)).sin();
    Vec3::splat(0.3 + 0.06 * waves)
}

/// A sphere with bumps and dents of up to 3 % of its radius.
fn bumpy() -> Mesh {
    let mut mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
    mesh.uvs = None;
    for p in &mut mesh.positions {
        *p *= 1.0 + 0.03 * (4.0 * p.x).sin() * (3.0 * p.y + 1.0).cos();
    }
    mesh
}

/// A model error of this size everywhere.
fn error(squared: f32) -> ModelError {
    let mut error = ModelError::new(&SdfGrid::from_fn(Vec3::ZERO, 1.3, 24, |p| p.length() - 1.0));
    error.sums.fill([squared, 1.0]);
    error
}

fn off(mesh: &Mesh) -> f32 {
    mesh.positions.iter().map(|p| (p.length() - 1.0).abs()).sum::<f32>() / mesh.positions.len() as f32
}

/// Without masks.
fn guided(error: &ModelError) -> StereoGuides<'_> {
    StereoGuides { silhouettes: &[], error }
}

#[test]
fn a_mesh_moves_to_where_photographs_agree() {
    let (pictures, mut mesh) = (Pictures::new(), bumpy());
    let (before, triangles) = (off(&mesh), mesh.triangles.clone());
    let report = refine(&mut mesh, &pictures.views(), &guided(&error(0.01)), |_| Continue(())).unwrap();
    assert!(off(&mesh) < 0.25 * before, "{before} {} {report:?}", off(&mesh));
    assert!(report.trusted > 0.5 && report.moved > 0.005);
    assert_eq!(mesh.triangles, triangles);
    assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-4));
    let turned = mesh.normals.iter().zip(&mesh.positions).map(|(n, p)| n.angle_between(*p));
    assert!(turned.sum::<f32>() / (mesh.normals.len() as f32) < 0.1);
}

#[test]
fn a_mesh_stays_where_the_model_explains_the_photographs() {
    let (pictures, mut mesh) = (Pictures::new(), bumpy());
    let before = mesh.clone();
    let report = refine(&mut mesh, &pictures.views(), &guided(&error(1e-5)), |_| Continue(())).unwrap();
    assert_eq!(report, StereoReport::default());
    assert_eq!(mesh, before);
}

#[test]
fn a_mesh_stays_where_only_a_spot_of_it_agrees() {
    // How many vertices are trusted in the first round, and how far all move.
    let moved = |above: f32| {
        let cap = |p: Vec3, _| if p.z > above { pattern(p) } else { Vec3::splat(0.3) };
        let (pictures, mut mesh) = (Pictures::of(cap), bumpy());
        let (views, (relative, search)) = (pictures.views(), ROUNDS[0]);
        let small = match_pictures(&views, relative * finest_factor(&mesh, &views).unwrap()).unwrap();
        let votes = all_votes(&TriangleBvh::new(&mesh), &Shell::new(&mesh), &small, search, None).unwrap();
        let trusted = votes.iter().filter(|vote| vote.share(HALF_SHARE) > TRUSTED).count();
        (trusted, refine(&mut mesh, &views, &guided(&error(0.01)), |_| Continue(())).unwrap().moved)
    };
    let (spot, half) = (moved(0.985), moved(0.0));
    assert!(spot.0 > 0 && spot.1 == 0.0 && half.1 > 0.001, "{spot:?} {half:?}");
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let pictures = Pictures::new();
    let refined = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut mesh = bumpy();
        pool.install(|| {
            refine(&mut mesh, &pictures.views(), &guided(&error(0.01)), |_| Continue(())).unwrap()
        });
        mesh
    };
    assert_eq!(refined(1), refined(3));
}

#[test]
fn nothing_moves_without_views_or_when_stopped() {
    let (pictures, mut mesh) = (Pictures::new(), bumpy());
    let before = mesh.clone();
    assert_eq!(
        refine(&mut mesh, &TrainingViews::new(Vec::new(), None, |_| None), &guided(&error(0.01)), |_| {
            Continue(())
        })
        .unwrap(),
        StereoReport::default()
    );
    assert_eq!(
        refine(&mut mesh, &pictures.views(), &guided(&error(0.01)), |_| ControlFlow::Break(()))
            .unwrap()
            .moved,
        0.0
    );
    assert_eq!(mesh, before);
}

#[test]
fn a_thin_plate_is_not_pushed_through_itself() {
    // Two sheets 0.02 apart; both are to move 0.1 toward each other.
    let corner = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let positions = vec![
        corner(-1.0, -1.0, 0.01),
        corner(1.0, -1.0, 0.01),
        corner(0.0, 1.0, 0.01),
        corner(-1.0, -1.0, -0.01),
        corner(1.0, -1.0, -0.01),
        corner(0.0, 1.0, -0.01),
    ];
    let normals: Vec<Vec3> = positions.iter().map(|p| Vec3::Z * p.z.signum()).collect();
    let triangles = vec![[0, 1, 2], [3, 5, 4]];
    // Inset, so that the rays of corners meet the other sheet.
    let start: Vec<Vec3> = positions.iter().map(|p| Vec3::new(0.9 * p.x, 0.9 * p.y - 0.02, p.z)).collect();
    let bvh = TriangleBvh::new(&Mesh { positions, normals: normals.clone(), uvs: None, triangles });
    let wanted: Vec<Vec3> = start.iter().zip(&normals).map(|(p, n)| *p - *n * 0.1).collect();
    let steps = steps_within_room(&bvh, &start, &normals, &wanted, 1e-4);
    assert!(steps.iter().all(|step| (step.length() - 0.15 * 0.0199).abs() < 1e-5), "{steps:?}");
}

#[test]
fn a_pattern_is_told_from_a_reflection() {
    let mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
    let shares = |pictures: &Pictures| {
        let mut shares =
            pattern_shares(&mesh, &Shell::new(&mesh), &match_pictures(&pictures.views(), 1).unwrap());
        median(&mut shares).unwrap()
    };
    let (painted, mirror) = (shares(&Pictures::new()), shares(&Pictures::of(|_, to| pattern(to))));
    assert!(painted > 0.9 && mirror < 0.2, "{painted} {mirror}");
}

#[test]
fn what_a_ball_mirrors_leaves_no_dents() {
    let pictures = Pictures::of(|_, to| pattern(0.4 * to));
    let mut mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
    mesh.uvs = None;
    let before = off(&mesh);
    refine(&mut mesh, &pictures.views(), &guided(&error(0.01)), |_| Continue(())).unwrap();
    assert!(off(&mesh) < before + 5e-4, "{before} {}", off(&mesh));
}
