//! What may be wrong with cameras, photographs or a mesh as a whole: axes of another convention, mirrored pictures, inverted poses,
//! another unit. Each is a change of the cameras that would put it right.

use crate::survey::look::SmallMask;
use crate::view::Camera;
use glam::{Affine3A, Mat3A, Vec3, Vec3A};

/// A change of all cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Change {
    /// Camera axes: the camera's own are these columns.
    CameraAxes(Mat3A),
    /// Photographs and masks are turned or mirrored: as `CameraAxes`, and the intrinsics turn with the picture. Only the first two axes
    /// change.
    Picture(Mat3A),
    /// The poses are the other way around; then as `CameraAxes`.
    Inverted(Mat3A),
    /// The world of the mesh is turned or mirrored by this against that of the cameras: cameras move into it.
    World(Mat3A),
    /// The mesh, turned so and `scale` times larger around the origin, then moved by `shift`, is where the cameras see the object.
    Placed {
        /// How it is turned first, as in `World`.
        turn: Mat3A,
        /// Factor on its size.
        scale: f32,
        /// Where its origin goes, world units.
        shift: Vec3,
    },
    /// Focal lengths are so many times longer.
    Focal(f32),
    /// Photographs have the cameras of other photographs; no change of one camera.
    Order,
    /// Masks are wrong; no change of cameras.
    Masks,
}

/// A change with its name and what to do.
#[derive(Clone, Debug, PartialEq)]
pub struct Cause {
    /// What is done to the cameras.
    pub change: Change,
    /// What is wrong, as the end of a sentence.
    pub words: String,
    /// The remedy.
    pub help: String,
}

impl Change {
    /// The view with its camera changed.
    pub fn of(&self, view: &SmallMask) -> SmallMask {
        let pose = view.camera.world_from_camera;
        let turned = |pose: Affine3A, axes: &Mat3A| Affine3A { matrix3: pose.matrix3 * *axes, ..pose };
        let world_from_camera = match self {
            Self::CameraAxes(axes) | Self::Picture(axes) => turned(pose, axes),
            Self::Inverted(axes) => turned(inverse(pose), axes),
            Self::World(turn) => into_world(pose, turn, 1.0, Vec3::ZERO),
            Self::Placed { turn, scale, shift } => into_world(pose, turn, *scale, *shift),
            Self::Focal(_) | Self::Order | Self::Masks => pose,
        };
        let mut changed = view.clone();
        changed.camera.world_from_camera = world_from_camera;
        if let Self::Picture(axes) = self {
            turn_intrinsics(&mut changed.camera, axes);
        }
        if let Self::Focal(factor) = self {
            changed.camera.focal = changed.camera.focal.map(|focal| focal * factor);
        }
        changed
    }
}

/// The intrinsics of the picture with these axes of the camera's own. Width and height stay: of a picture that is not square a quarter
/// turn leaves the intrinsics as they are.
fn turn_intrinsics(camera: &mut Camera, axes: &Mat3A) {
    let given = *camera;
    let old_axis = [axes.x_axis, axes.y_axis].map(|axis| axis.abs().max_position());
    if old_axis[0] == 1 && given.width != given.height {
        return;
    }
    let size = [given.width as f32, given.height as f32];
    let is_mirrored = [0, 1].map(|k| axes.col(k).min_element() < -0.5);
    for k in 0..2 {
        let from = old_axis[k];
        camera.focal[k] = given.focal[from];
        // Places are measured from the corner of the first pixel.
        camera.center[k] = if is_mirrored[k] { size[from] - given.center[from] } else { given.center[from] };
    }
    if is_mirrored[0] != is_mirrored[1] {
        camera.skew = -given.skew;
    }
}

/// The transform is rigid, perhaps mirrored: the transpose of its matrix is its inverse.
fn inverse(pose: Affine3A) -> Affine3A {
    let matrix3 = pose.matrix3.transpose();
    Affine3A { matrix3, translation: -(matrix3 * pose.translation) }
}

/// A pose in the coordinates of a mesh that is turned, scaled and shifted into the world; directions keep their length.
fn into_world(pose: Affine3A, turn: &Mat3A, scale: f32, shift: Vec3) -> Affine3A {
    let back = turn.transpose();
    let translation = back * ((pose.translation - Vec3A::from(shift)) / scale);
    Affine3A { matrix3: back * pose.matrix3, translation }
}

fn diagonal(x: f32, y: f32, z: f32) -> Mat3A {
    Mat3A::from_diagonal(Vec3::new(x, y, z))
}

/// OpenGL's camera axes in OpenCV's, and the reverse.
fn opengl() -> Mat3A {
    diagonal(1.0, -1.0, -1.0)
}

/// LLFF's camera axes (down, right, backward) in OpenCV's: right is the second, down the first, forward minus the third.
fn llff() -> Mat3A {
    Mat3A::from_cols(Vec3A::Y, Vec3A::X, -Vec3A::Z)
}

/// What to do about camera axes.
const AXES: &str = "Write the axes of the layout's convention (see the manual, Data layouts).";
/// The same if they are those of OpenGL in place of OpenCV's, or the reverse.
const OPENGL_AXES: &str = "Write the axes of the layout's convention (see the manual, Data layouts): negate the second and the third \
                           column of each camera's rotation.";
/// What to do about inverted poses.
const INVERT: &str =
    "Write the matrices of the layout's convention (see the manual, Data layouts): invert each of them.";
/// What to do about pictures that are mirrored or turned.
const MIRROR: &str = "Mirror the photographs and masks back, or the cameras with them.";
const TURN: &str =
    "Turn photographs and masks as the cameras are; check the EXIF orientation that was applied.";

fn cause(change: Change, words: &str, help: &str) -> Cause {
    Cause { change, words: words.into(), help: help.into() }
}

/// What may be wrong with the cameras or the photographs themselves, the likelier first.
pub(crate) fn camera_causes() -> Vec<Cause> {
    let axes = |axes, words, help| cause(Change::CameraAxes(axes), words, help);
    let inverted = |axes, words| cause(Change::Inverted(axes), words, INVERT);
    let likely = [
        axes(
            opengl(),
            "y and z of the camera axes are negated (OpenGL and OpenCV are confused)",
            OPENGL_AXES,
        ),
        inverted(Mat3A::IDENTITY, "camera_from_world is taken for world_from_camera"),
        inverted(
            opengl(),
            "camera_from_world is taken for world_from_camera, and y and z of the camera axes are negated",
        ),
    ];
    let unlikely = [
        axes(llff(), "the camera axes are LLFF's (down, right, backward)", AXES),
        axes(diagonal(-1.0, 1.0, -1.0), "x and z of the camera axes are negated", AXES),
        axes(diagonal(-1.0, -1.0, 1.0), "x and y of the camera axes are negated", AXES),
    ];
    likely.into_iter().chain(picture_causes()).chain(unlikely).collect()
}

/// What may be wrong with the photographs, the likelier first.
fn picture_causes() -> [Cause; 5] {
    let counterclockwise = Mat3A::from_cols(Vec3A::Y, -Vec3A::X, Vec3A::Z);
    let clockwise = Mat3A::from_cols(-Vec3A::Y, Vec3A::X, Vec3A::Z);
    let picture = |axes, words, help| cause(Change::Picture(axes), words, help);
    [
        picture(diagonal(-1.0, 1.0, 1.0), "photographs are mirrored left to right", MIRROR),
        picture(diagonal(1.0, -1.0, 1.0), "photographs are mirrored top to bottom", MIRROR),
        picture(diagonal(-1.0, -1.0, 1.0), "photographs are upside down", TURN),
        picture(counterclockwise, "photographs are turned by 90° counterclockwise", TURN),
        picture(clockwise, "photographs are turned by 90° clockwise", TURN),
    ]
}

/// The turns and mirror images of a mesh that map axes to axes, without the identity, the likelier first.
pub(crate) fn world_causes() -> Vec<Cause> {
    let mut causes: Vec<(u32, Cause)> = signed_permutations().into_iter().map(world_cause).collect();
    causes.sort_by_key(|(rank, _)| *rank);
    causes.into_iter().map(|(_, cause)| cause).collect()
}

/// The proper ones of these turns, with the identity first.
pub fn turns() -> Vec<Mat3A> {
    let turns = signed_permutations().into_iter().filter(|turn| turn.determinant() > 0.0);
    std::iter::once(Mat3A::IDENTITY).chain(turns).collect()
}

/// All 48 but the identity.
fn signed_permutations() -> Vec<Mat3A> {
    let axes = [Vec3A::X, Vec3A::Y, Vec3A::Z];
    let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let all = orders.into_iter().flat_map(|order| {
        (0..8u32).map(move |signs| {
            let column = |k: usize| if signs >> k & 1 == 1 { -axes[order[k]] } else { axes[order[k]] };
            Mat3A::from_cols(column(0), column(1), column(2))
        })
    });
    all.filter(|matrix| *matrix != Mat3A::IDENTITY).collect()
}

/// The cause, and its rank by how often it happens.
fn world_cause(turn: Mat3A) -> (u32, Cause) {
    let z_up = Mat3A::from_cols(Vec3A::X, Vec3A::Z, -Vec3A::Y);
    let proper = turn.determinant() > 0.0;
    let (rank, words) = match turn {
        _ if turn == z_up => (0, "the mesh has +Y up, the cameras have +Z up".to_owned()),
        _ if turn == z_up.transpose() => (1, "the mesh has +Z up, the cameras have +Y up".to_owned()),
        _ if proper => (2, format!("the mesh is turned: its (x, y, z) are the cameras' {}", images(&turn))),
        _ => (3, format!("the mesh is mirrored: its (x, y, z) are the cameras' {}", images(&turn))),
    };
    let help =
        format!("Turn the mesh into the cameras' world: write each vertex (x, y, z) as {}.", formula(&turn));
    (rank, Cause { change: Change::World(turn), words, help })
}

/// "(x, −z, y)": where the mesh's axes point.
fn images(turn: &Mat3A) -> String {
    let name = |axis: Vec3A| signed(Vec3::from(axis));
    format!("({}, {}, {})", name(turn.x_axis), name(turn.y_axis), name(turn.z_axis))
}

/// "(x, −z, y)": a vertex's new coordinates by its old ones.
pub fn formula(turn: &Mat3A) -> String {
    images(&turn.transpose())
}

fn signed(axis: Vec3) -> String {
    let letter = ["x", "y", "z"][axis.abs().max_position()];
    if axis.min_element() < -0.5 { format!("-{letter}") } else { letter.to_owned() }
}
