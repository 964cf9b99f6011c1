//! Masks beside silhouettes: those of a known mesh, or of the visual hull of all masks. Where they
//! disagree, the usual mistakes with cameras, photographs and meshes are undone one at a time, and
//! the one after which they agree is named.

use crate::survey::{Finding, Severity, named};
use crate::{report::sheet::choose_evenly, survey::cameras::Sight, survey::cameras::meeting_point};
use glam::{Affine3A, Mat3A, Vec3, Vec3A};
use lobelia_geometry::parallel;
use lobelia_geometry::view::look::{SmallMask, ViewLook};
use lobelia_geometry::{Result, mesh::bvh::TriangleBvh, sdf::SdfGrid, view::Split, view::StoredMask};
use lobelia_sg::statistics::median;
use lobelia_solve::{shape::hull::visual_hull, shape::silhouette::Silhouette};

/// Overlap (intersection over union) with a mesh, and with a hull, from which on no mistake is
/// looked for. Seven sound sets of 32 to 100 views have 0.94 to 0.98 with their hulls; mirrored
/// photographs of the six that are not symmetric 0.53 to 0.73.
const AGREES: f32 = 0.97;
const HULL_AGREES: f32 = 0.9;
/// Overlap that the undoing of a mistake must reach, and the part of the disagreement (1 − overlap)
/// that it may leave.
const EXPLAINS: f32 = 0.9;
const LEFT: f32 = 0.5;
/// Overlaps this close are equally good, or this part of the disagreement: the likelier mistake is
/// named.
const TIE: f32 = 0.02;
const TIE_SHARE: f32 = 0.1;
/// Overlap from which on silhouettes are those of the photographs, and below which they are not.
const COVERS: f32 = 0.75;
const MISSES: f32 = 0.6;
/// Difference from the median overlap from which on a view is named. Sound sets have 0.11 at most
/// with hulls of 32 views, and 0.04 with more; two exchanged photographs have 0.16 to 0.5,
/// neighbors of `dino` 0.08.
const STRAY_BY: f32 = 0.12;
/// Views that make the hull, and cells a side of it.
const VOTERS: usize = 96;
const CELLS: u32 = 64;
/// Views that mistakes are tried on, and pixels a side for those that are far from covering the
/// mesh.
const TRIED_VIEWS: usize = 10;
const TRIED_SIDE: u32 = 40;
const FINE_SIDE: u32 = 96;
/// Views that mistakes are tried on with a hull, and cells a side of it.
const TRIED_VOTERS: usize = 24;
const TRIED_CELLS: u32 = 40;
/// Rounds of correcting size and place of a mesh; each renders all views.
const ROUNDS: usize = 4;
/// Relative distance of a scale from 1, and from a ratio of units, within which it is that.
const ONE_SLACK: f32 = 0.03;
const UNIT_SLACK: f32 = 0.1;
/// Way in radii of the mesh's bounding sphere that is no other place.
const SHIFT_SLACK: f32 = 0.05;
/// Ratios of units that meshes and cameras are written in, with their names.
const UNITS: [(f32, &str); 5] = [
    (1000.0, "meters and millimeters"),
    (100.0, "meters and centimeters"),
    (10.0, "centimeters and millimeters"),
    (39.370_08, "meters and inches"),
    (25.4, "inches and millimeters"),
];

/// Axes of OpenGL's cameras.
const OPENGL: Mat3A = Mat3A::from_cols(Vec3A::X, Vec3A::NEG_Y, Vec3A::NEG_Z);
/// The turn of a mesh with +Y up into a world with +Z up.
const Z_UP: Mat3A = Mat3A::from_cols(Vec3A::X, Vec3A::Z, Vec3A::NEG_Y);
/// Undoings of mistakes with cameras and photographs, the likelier first.
const CAMERA_MISTAKES: [Undoing; 6] = [
    Undoing::Axes(OPENGL),
    Undoing::Inverted(Mat3A::IDENTITY),
    Undoing::Inverted(OPENGL),
    Undoing::Picture([-1.0, 1.0]),
    Undoing::Picture([1.0, -1.0]),
    Undoing::Picture([-1.0, -1.0]),
];

/// The shape whose silhouettes are compared with the masks.
enum Shape<'a> {
    Mesh(&'a TriangleBvh),
    /// The visual hull of masks.
    Hull(SdfGrid),
}

impl<'a> Shape<'a> {
    /// The mesh if it is known, else the hull of masks with the names of their views, of `cells`
    /// cells a side.
    fn new<'b>(
        mesh: Option<&'a TriangleBvh>,
        masks: impl Iterator<Item = (&'b str, &'b SmallMask)>,
        cells: u32,
    ) -> Result<Self> {
        let Some(bvh) = mesh else {
            let silhouettes = masks
                .filter_map(|(name, of)| Silhouette::new(name, &of.camera, &StoredMask::new(&of.mask())));
            return visual_hull(&mut silhouettes.collect::<Vec<_>>(), cells).map(Self::Hull);
        };
        Ok(Self::Mesh(bvh))
    }

    /// Whether each pixel of a view's frame is covered.
    fn covered(&self, view: &SmallMask) -> Vec<bool> {
        let rays = (0..view.camera.width * view.camera.height).map(|pixel| view.camera.pixel_ray(pixel));
        match self {
            Self::Mesh(bvh) => rays.map(|ray| bvh.any(&ray, 0.0, f32::INFINITY)).collect(),
            Self::Hull(hull) => rays.map(|ray| hull.first_crossing(&ray, 0.0).is_some()).collect(),
        }
    }

    /// Pixels in both silhouette and mask over pixels in either; 0 if neither has any.
    fn overlap(&self, view: &SmallMask) -> f32 {
        let covered = self.covered(view);
        let count = |is: fn(bool, bool) -> bool| {
            covered.iter().zip(&view.inside).filter(|(a, b)| is(**a, **b)).count() as f32
        };
        count(|a, b| a && b) / count(|a, b| a || b).max(1.0)
    }
}

/// Compares silhouettes of the mesh, or of the hull of all masks, with the masks of all views: sets
/// [`ViewLook::overlap`], and says what does not agree. `complaint` is an error of the cameras
/// alone, told unless a mistake explains it.
pub(super) fn of_silhouettes(
    mesh: Option<&TriangleBvh>,
    looks: &mut [ViewLook],
    complaint: Option<Finding>,
) -> Option<Finding> {
    let masks: Vec<(&str, &SmallMask)> =
        looks.iter().filter_map(|look| Some((look.name.as_str(), &look.mask.as_ref()?.small))).collect();
    let chosen = choose_evenly(masks.len(), VOTERS).into_iter().map(|i| masks[i]);
    let shape = match Shape::new(mesh, chosen, CELLS) {
        Ok(shape) => shape,
        Err(error) => {
            let complaint = complaint.unwrap_or_else(|| Finding::from_error("inconsistent-masks", &error));
            return Some(explained(mesh, looks, 0.0).unwrap_or(complaint));
        }
    };
    let overlap = |look: &ViewLook| look.mask.as_ref().map(|mask| shape.overlap(&mask.small));
    parallel::for_each(looks.iter_mut(), |look| look.overlap = overlap(look));
    let overlaps = looks.iter().filter_map(|look| Some((look.overlap?, look.name.clone())));
    let mut worst: Vec<(f32, String)> = overlaps.collect();
    worst.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some(middle) = median(&mut worst.iter().map(|view| view.0).collect::<Vec<_>>()) else {
        return complaint;
    };
    let (agrees, covers) = if mesh.is_some() { (AGREES, COVERS) } else { (HULL_AGREES, HULL_AGREES) };
    let cause = (middle < agrees || complaint.is_some()).then(|| explained(mesh, looks, middle));
    if let Some(finding) = cause.flatten().or(complaint) {
        return Some(finding);
    }
    let names = |worst: Vec<(f32, String)>| worst.into_iter().map(|view| view.1).collect::<Vec<_>>();
    if middle < covers {
        return Some(unexplained(mesh.is_some(), names(worst), middle));
    }
    // Single views that do not agree where the others do.
    worst.retain(|view| view.0 < middle - STRAY_BY);
    let (least, views) = (worst.first()?.0, names(worst));
    let with = if mesh.is_some() { "the mesh" } else { "the visual hull of all masks" };
    let problem = format!(
        "mask or camera does not agree with {with} in {}: they overlap to {least:.2} in the worst (intersection over union), to {middle:.2} \
         in the median view",
        named(&views)
    );
    let help = "Correct that mask or pose, or leave the view out with `select`; perhaps photographs or poses are exchanged.";
    Some(Finding::new(Severity::Warning, "stray-view", views, problem, help))
}

/// The silhouettes are not those of the masks, and no mistake that was tried explains it.
fn unexplained(is_mesh: bool, worst: Vec<String>, middle: f32) -> Finding {
    let (name, problem, tried, check) = match is_mesh {
        true => (
            "mesh-misses-masks",
            "the mesh does not cover the masks: they overlap",
            ", quarter turns of the mesh, its size and place",
            "that mesh, cameras and masks are of the same object, in the same coordinates",
        ),
        false => (
            "inconsistent-masks",
            "the cameras do not fit the photographs: masks and their visual hull overlap",
            "",
            "that the n-th camera is that of the n-th photograph, then poses, intrinsics and masks",
        ),
    };
    let problem = format!(
        "{problem} to {middle:.2} (intersection over union, median of {} views); {} is worst",
        worst.len(),
        named(&worst[..1])
    );
    let help = format!(
        "None of the usual mistakes explains it (tried: camera axes of OpenGL, inverted poses, photographs mirrored or upside down{tried}). \
         Check {check}."
    );
    Finding::new(Severity::error_if(middle < MISSES), name, worst, problem, help)
}

/// A change of cameras by which silhouettes become right.
#[derive(Clone, Copy, PartialEq)]
enum Undoing {
    /// The camera's own axes are these columns.
    Axes(Mat3A),
    /// The pose is inverted, and its axes are these columns.
    Inverted(Mat3A),
    /// The picture is mirrored along the axes with a −1, with its intrinsics.
    Picture([f32; 2]),
    /// The mesh is turned, made `scale` times larger around the origin, then moved.
    Mesh { turn: Mat3A, scale: f32, shift: Vec3 },
}

impl Undoing {
    fn of(&self, view: &SmallMask) -> SmallMask {
        let mut changed = view.clone();
        let camera = &mut changed.camera;
        let pose = camera.world_from_camera;
        let turned = |pose: Affine3A, axes: Mat3A| Affine3A { matrix3: pose.matrix3 * axes, ..pose };
        camera.world_from_camera = match *self {
            Self::Axes(axes) => turned(pose, axes),
            Self::Inverted(axes) => turned(pose.inverse(), axes),
            Self::Picture([x, y]) => {
                // Places are measured from the corner of the first pixel.
                for (k, _) in [x, y].into_iter().enumerate().filter(|(_, sign)| *sign < 0.0) {
                    camera.center[k] = view.frame[k] - camera.center[k];
                }
                camera.skew *= x * y;
                turned(pose, Mat3A::from_diagonal(Vec3::new(x, y, 1.0)))
            }
            Self::Mesh { turn, scale, shift } => {
                let back = turn.transpose();
                let translation = back * ((pose.translation - Vec3A::from(shift)) / scale);
                Affine3A { matrix3: back * pose.matrix3, translation }
            }
        };
        changed
    }

    /// The mistake, as the end of a sentence, and its remedy.
    fn words(&self) -> (String, String) {
        let convention = "of the layout's convention (see the manual, Data layouts)";
        let negated = "y and z of the camera axes are negated";
        let mirror = "Mirror the photographs and masks back, or the cameras with them.";
        let upright =
            "Turn photographs and masks as the cameras are; check the EXIF orientation that was applied.";
        match *self {
            Self::Axes(_) => {
                let negate = "negate the second and the third column of each camera's rotation.";
                let mistake = format!("{negated} (OpenGL and OpenCV are confused)");
                (mistake, format!("Write the axes {convention}: {negate}"))
            }
            Self::Inverted(axes) => {
                let also = if axes == OPENGL { format!(", and {negated}") } else { String::new() };
                let mistake = format!("camera_from_world is taken for world_from_camera{also}");
                (mistake, format!("Write the matrices {convention}: invert each of them."))
            }
            Self::Mesh { turn, scale, shift } => words_of_mesh(turn, scale, shift),
            Self::Picture([-1.0, -1.0]) => ("photographs are upside down".into(), upright.into()),
            Self::Picture([-1.0, _]) => ("photographs are mirrored left to right".into(), mirror.into()),
            Self::Picture(_) => ("photographs are mirrored top to bottom".into(), mirror.into()),
        }
    }
}

/// A mesh that is turned, of another size or in another place.
fn words_of_mesh(turn: Mat3A, scale: f32, shift: Vec3) -> (String, String) {
    // "(x, -z, y)": a vertex's new coordinates by its old ones.
    let back = turn.transpose();
    let names = [back.x_axis, back.y_axis, back.z_axis].map(|axis| {
        let sign = if axis.min_element() < -0.5 { "-" } else { "" };
        format!("{sign}{}", ["x", "y", "z"][axis.abs().max_position()])
    });
    let (mut words, mut formula) = (Vec::new(), format!("({})", names.join(", ")));
    if scale != 1.0 {
        let (way, times) = if scale > 1.0 { ("small", scale) } else { ("large", 1.0 / scale) };
        let unit = UNITS.iter().find(|(ratio, _)| (times / ratio - 1.0).abs() < UNIT_SLACK);
        let unit = unit.map_or(String::new(), |(_, names)| format!(" (as between {names})"));
        words.push(format!("{} times too {way}{unit}", short(times)));
        formula = format!("{} · {formula}", short(scale));
    }
    if shift != Vec3::ZERO {
        words.push("in another place".to_owned());
        formula += &format!(" + ({})", shift.to_array().map(short).join(", "));
    }
    let placed = (!words.is_empty()).then(|| format!("the mesh is {}", words.join(" and ")));
    let upright = match turn {
        _ if turn == Mat3A::IDENTITY => None,
        _ if turn == Z_UP => Some("the mesh has +Y up, the cameras have +Z up"),
        _ if turn == Z_UP.transpose() => Some("the mesh has +Z up, the cameras have +Y up"),
        _ => Some("the mesh is turned"),
    };
    let words: Vec<String> = upright.map(str::to_owned).into_iter().chain(placed).collect();
    let help = format!(
        "Bring the mesh into the coordinates of the cameras: write each vertex (x, y, z) as {formula}."
    );
    (words.join("; "), help)
}

/// The mistake without which silhouettes and masks agree, whose median overlap is `middle`.
fn explained(mesh: Option<&TriangleBvh>, looks: &[ViewLook], middle: f32) -> Option<Finding> {
    // Small differences need more pixels.
    let (count, side) = match mesh {
        None => (TRIED_VOTERS, FINE_SIDE),
        Some(_) if middle >= COVERS => (TRIED_VIEWS, FINE_SIDE),
        Some(_) => (TRIED_VIEWS, TRIED_SIDE),
    };
    let views = tried(looks, count, side);
    // The median overlap, 0 without a hull.
    let reached = |views: &[SmallMask]| {
        let shape = Shape::new(mesh, views.iter().map(|view| ("", view)), TRIED_CELLS).ok();
        let found = shape.map(|shape| parallel::map_slice(views, 1, |view| shape.overlap(view)));
        found.and_then(|mut found| median(&mut found)).unwrap_or(0.0)
    };
    let given = reached(&views);
    // The first of the best.
    let best = |undoings: Vec<Undoing>| {
        let changed = |undoing: &Undoing| views.iter().map(|view| undoing.of(view)).collect::<Vec<_>>();
        let tried = undoings.into_iter().map(|undoing| (reached(&changed(&undoing)), undoing));
        let tried: Vec<(f32, Undoing)> = tried.collect();
        let most = tried.iter().map(|(reached, _)| *reached).fold(0.0, f32::max);
        let tie = TIE.min(TIE_SHARE * (1.0 - given));
        let (reached, undoing) = tried.into_iter().find(|(reached, _)| *reached >= most - tie)?;
        (reached >= EXPLAINS.max(1.0 - LEFT * (1.0 - given))).then_some((reached, undoing))
    };
    let (reached, undoing) = match mesh {
        None => best(CAMERA_MISTAKES.to_vec())?,
        Some(bvh) => {
            let turns = turns();
            let turned = turns[1..].iter().map(|&turn| Undoing::Mesh { turn, scale: 1.0, shift: Vec3::ZERO });
            let placed =
                |of: &[Mat3A]| best(of.iter().filter_map(|turn| placed(bvh, &views, *turn)).collect());
            // A mesh that covers the masks is not turned and of another size at once.
            let others = if middle < COVERS { &turns[1..] } else { &[] };
            best(CAMERA_MISTAKES.into_iter().chain(turned).collect())
                .or_else(|| placed(&turns[..1]))
                .or_else(|| placed(others))?
        }
    };
    let (mistake, help) = undoing.words();
    let silhouettes = match mesh {
        Some(_) => "silhouettes of the mesh agree with the masks",
        None => "the masks agree with their visual hull",
    };
    let problem = format!(
        "{silhouettes} to {reached:.2} instead of {given:.2} (intersection over union) once this is put right: {mistake}"
    );
    let (name, is_size) = match undoing {
        Undoing::Mesh { scale: 1.0, shift: Vec3::ZERO, .. } => ("other-axes", false),
        Undoing::Mesh { turn, .. } => ("other-place", turn == Mat3A::IDENTITY),
        _ => ("other-axes", false),
    };
    // A mesh that is a little too large covers the photographs nonetheless.
    let is_error = given < COVERS || !is_size;
    Some(Finding::new(Severity::error_if(is_error), name, Vec::new(), problem, help))
}

/// A few small masks, evenly chosen among those of training views, or of all if there are few.
fn tried(looks: &[ViewLook], most: usize, side: u32) -> Vec<SmallMask> {
    let of = |train: bool| {
        let views = looks.iter().filter(|look| !train || look.split == Split::Train);
        let masks = views.filter_map(|look| look.mask.as_ref().filter(|mask| !mask.all_covered));
        masks.map(|mask| &mask.small).collect::<Vec<_>>()
    };
    let masks = if of(true).len() >= 3 { of(true) } else { of(false) };
    choose_evenly(masks.len(), most).into_iter().map(|i| masks[i].at_most(side)).collect()
}

/// The 24 turns that map axes to axes, the identity first, then those that exchange the two usual
/// up directions.
fn turns() -> Vec<Mat3A> {
    let axes = [Vec3A::X, Vec3A::Y, Vec3A::Z].map(|axis| [axis, -axis]).concat();
    let all = axes.iter().flat_map(|x| axes.iter().map(|y| Mat3A::from_cols(*x, *y, x.cross(*y))));
    let mut turns: Vec<Mat3A> = all.filter(|turn| turn.determinant() > 0.5).collect();
    let is_likely = |turn: &Mat3A| [Mat3A::IDENTITY, Z_UP, Z_UP.transpose()].contains(turn);
    turns.sort_by_key(|turn| (!is_likely(turn), *turn != Mat3A::IDENTITY, *turn != Z_UP));
    turns
}

/// Size and place that make the silhouettes of a mesh, turned by `turn`, agree with the masks in
/// center and size. `None` if masks do not determine a place, the mesh is never in sight, or
/// nothing is wrong with size and place.
fn placed(bvh: &TriangleBvh, views: &[SmallMask], turn: Mat3A) -> Option<Undoing> {
    let (target, size) = place(views.iter().filter_map(|view| spot(view, &view.inside)))?;
    let (center, radius) = bvh.bounding_sphere();
    let center = Vec3::from(turn * Vec3A::from(center));
    // The root of a disk's area is 1.77 radii; most objects fill less of their sphere.
    let mut scale = size / (1.4 * radius);
    let mut shift = target - center * scale;
    for _ in 0..ROUNDS {
        let undoing = Undoing::Mesh { turn, scale, shift };
        // The box is seen in the mesh's own coordinates; its rays are those of the view as it is.
        let rendered = |i: usize| spot(&views[i], &Shape::Mesh(bvh).covered(&undoing.of(&views[i])));
        let spots: Vec<(Sight, f32)> = parallel::flat_map(views.len(), 1, rendered);
        let (seen, seen_size) = place(spots.into_iter())?;
        let factor = (size / seen_size).clamp(0.25, 4.0);
        // Around the place where it is seen, then to where it should be.
        shift = (shift - seen) * factor + target;
        scale *= factor;
    }
    // The size is measured; what is meant is a ratio of units, or none. The place of the mesh's
    // middle stays.
    let near = |ratio: f32, slack: f32| (scale / ratio - 1.0).abs() < slack;
    let one = near(1.0, ONE_SLACK).then_some(1.0);
    let mut ratios = UNITS.iter().flat_map(|(ratio, _)| [*ratio, 1.0 / ratio]);
    let meant = one.or_else(|| ratios.find(|ratio| near(*ratio, UNIT_SLACK))).unwrap_or(scale);
    let shift = shift + center * (scale - meant);
    let shift = if shift.length() > SHIFT_SLACK * radius * meant { shift } else { Vec3::ZERO };
    let is_other = meant != 1.0 || shift != Vec3::ZERO;
    let is_sound = meant.is_finite() && meant > 0.0 && shift.is_finite();
    (is_sound && is_other).then_some(Undoing::Mesh { turn, scale: meant, shift })
}

/// The ray through the center of a silhouette, and the root of its area as an angle; `None` if
/// nothing is covered.
fn spot(view: &SmallMask, inside: &[bool]) -> Option<(Sight, f32)> {
    let width = view.camera.width as usize;
    let pixels = || (0..inside.len()).filter(|i| inside[*i]);
    let count = pixels().count() as f32;
    let [x, y] =
        [pixels().map(|i| (i % width) as f32).sum(), pixels().map(|i| (i / width) as f32).sum::<f32>()];
    let sight = || Sight::new(&view.camera, x / count + 0.5, y / count + 0.5);
    let focal = (view.camera.focal[0] * view.camera.focal[1]).abs().sqrt();
    (count > 0.0).then(|| (sight(), count.sqrt() / focal))
}

/// The object as several silhouettes show it: where, and how large.
fn place(spots: impl Iterator<Item = (Sight, f32)>) -> Option<(Vec3, f32)> {
    let spots: Vec<(Sight, f32)> = spots.collect();
    let sights: Vec<Sight> = spots.iter().map(|spot| spot.0).collect();
    let center = meeting_point(&sights).filter(|_| sights.len() >= 2)?;
    let sizes = spots.iter().map(|(sight, size)| size * sight.origin.distance(center) as f32);
    let size = median(&mut sizes.collect::<Vec<_>>())?;
    Some((center.as_vec3(), size)).filter(|(center, size)| center.is_finite() && *size > 0.0)
}

/// A number with three significant digits.
fn short(value: f32) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}
