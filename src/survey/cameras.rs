//! How cameras lie around the object: on a sphere, a hemisphere, rings, or on one side.

use crate::survey::finding::{Finding, named};
use crate::survey::look::ViewLook;
use crate::survey::meeting::{Outline, Sight, meeting_point};
use crate::survey::mesh_overlap::overlap;
use glam::{Mat3, Vec3};
use serde::Serialize;

/// Largest difference of elevations in one ring of cameras, degrees.
const RING_DEGREES: f32 = 6.0;
/// Cameras that a ring has at least.
const RING_CAMERAS: usize = 6;
/// Rings that a capture may have to count as made of rings.
const MOST_RINGS: usize = 3;
/// Largest gap between neighbors of a ring, degrees.
const RING_GAP_DEGREES: f32 = 75.0;
/// Largest gap in azimuth of cameras that are all around the object, degrees.
const AROUND_GAP_DEGREES: f32 = 100.0;
/// Elevations beyond which the object is seen from above and from below, degrees.
const ABOVE_DEGREES: f32 = 40.0;
const BELOW_DEGREES: f32 = -20.0;

/// Length of the mean of the cameras' up directions below which they say nothing.
const LEAST_UPRIGHT: f32 = 0.3;
/// Cosine of the angle (30°) within which a direction is that of the data, or of an axis.
const NEAR_AXIS: f32 = 0.866;

/// Overlap of masks below which they are not of the same view of the object.
const SAME_MASK: f32 = 0.95;

/// Views with the same camera and other silhouettes: one of them has the camera of another. An error where all views have one camera.
pub(crate) fn same_cameras(looks: &[ViewLook]) -> Option<Finding> {
    let has_same_camera =
        |a: &ViewLook, b: &ViewLook| a.camera.world_from_camera == b.camera.world_from_camera;
    let contradicts = |a: &ViewLook, b: &ViewLook| {
        let masks = a.mask.as_ref().zip(b.mask.as_ref());
        let masks = masks.filter(|(a, b)| a.small.inside.len() == b.small.inside.len());
        masks
            .and_then(|(a, b)| overlap(&a.small.inside, &b.small.inside))
            .is_some_and(|same| same < SAME_MASK)
    };
    let is_named = |a: &&ViewLook| looks.iter().any(|b| has_same_camera(a, b) && contradicts(a, b));
    let views: Vec<String> = looks.iter().filter(is_named).map(|look| look.name.clone()).collect();
    let first = looks.first().filter(|_| !views.is_empty())?;
    if looks.iter().all(|look| has_same_camera(first, look)) {
        let problem = format!("all {} views have the same camera, and their masks differ", looks.len());
        let help = "Give each view its own pose, in the frame of the object: of an object that turns before a fixed camera, as if the \
                    camera went around it. `lobelia prepare PHOTOS OUT` finds such poses.";
        return Some(Finding::error("same-cameras", Vec::new(), problem, help));
    }
    let problem = format!("the same camera is given for views whose masks differ: {}", named(&views));
    let help = "Correct these poses, or leave the views out with `select`.";
    Some(Finding::warning("same-cameras", views, problem, help))
}

/// The kind of an arrangement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ArrangementKind {
    /// Circles around one axis, at one to three heights.
    Rings(usize),
    /// All around, from above and below.
    Sphere,
    /// All around, also from above.
    Hemisphere,
    /// All around, neither from above nor below.
    Belt,
    /// A side is not seen.
    OneSide,
}

/// How the cameras lie.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Arrangement {
    /// What they look like together.
    pub kind: ArrangementKind,
    /// What they look at, in world units.
    pub target: Vec3,
    /// The axis of rings, else the up direction: that of the data, unless the cameras have another; of unit length.
    pub axis: Vec3,
    /// Lowest and highest elevation above the plane through the target across `axis`, in degrees.
    pub elevation_degrees: [f32; 2],
    /// The largest gap between azimuths around `axis`, in degrees.
    pub azimuth_gap_degrees: f32,
    /// The least and the greatest distance from the target, in world units.
    pub distance: [f32; 2],
}

impl Arrangement {
    /// Of the cameras of `looks` around `center` if it is known, else around the point they look at. `None` without a camera apart
    /// from that point.
    pub fn new(looks: &[ViewLook], center: Option<Vec3>, up: Vec3) -> Option<Self> {
        let target = center.or_else(|| target(looks)).filter(|target| target.is_finite())?;
        let offsets: Vec<Vec3> = looks.iter().map(|look| look.camera.position() - target).collect();
        let directions: Vec<Vec3> = offsets.iter().filter_map(|offset| offset.try_normalize()).collect();
        if directions.is_empty() {
            return None;
        }
        let up = upright(looks, up.try_normalize().unwrap_or(Vec3::Y));
        let rings = ring_axis(&directions, up).and_then(|axis| Some((count_rings(&directions, axis)?, axis)));
        let axis = rings.map_or(up, |rings| rings.1);
        let elevations: Vec<f32> = directions.iter().map(|direction| elevation(*direction, axis)).collect();
        let elevation_degrees = range(&elevations);
        let gap = largest_gap(&directions, axis);
        let distances: Vec<f32> = offsets.iter().map(|offset| offset.length()).collect();
        let kind = match rings {
            Some((count, _)) => ArrangementKind::Rings(count),
            None if gap > AROUND_GAP_DEGREES => ArrangementKind::OneSide,
            None if elevation_degrees[1] < ABOVE_DEGREES => ArrangementKind::Belt,
            None if elevation_degrees[0] < BELOW_DEGREES => ArrangementKind::Sphere,
            None => ArrangementKind::Hemisphere,
        };
        let distance = range(&distances);
        Some(Self { kind, target, axis, elevation_degrees, azimuth_gap_degrees: gap, distance })
    }

    /// "all around and from above: elevation −3° to 88°, widest gap 14°, distance 4.03 to 4.1; up is +Z".
    pub fn words(&self) -> String {
        let kind = match self.kind {
            ArrangementKind::Rings(1) => "one ring".to_owned(),
            ArrangementKind::Rings(count) => format!("{count} rings"),
            ArrangementKind::Sphere => "all around, from above and below".to_owned(),
            ArrangementKind::Hemisphere => "all around and from above".to_owned(),
            ArrangementKind::Belt => "all around, near one height".to_owned(),
            ArrangementKind::OneSide => "from one side".to_owned(),
        };
        let ([low, high], [near, far]) = (self.elevation_degrees, self.distance);
        let gap = self.azimuth_gap_degrees;
        let up = match axis_name(self.axis).as_str() {
            "+Y" => String::new(),
            other => format!("; up is {other}"),
        };
        format!(
            "{kind}: elevation {low:.0}° to {high:.0}°, widest gap {gap:.0}°, distance {near:.3} to {far:.3}{up}"
        )
    }

    /// The unit direction of each view from the target.
    pub fn directions(&self, looks: &[ViewLook]) -> Vec<Vec3> {
        looks.iter().map(|look| (look.camera.position() - self.target).normalize_or(self.axis)).collect()
    }
}

/// Where the centers of the masks meet, or the middles of the frames.
fn target(looks: &[ViewLook]) -> Option<Vec3> {
    let of_masks: Vec<Sight> =
        looks.iter().filter_map(|look| Outline::new(look).map(|outline| outline.sight())).collect();
    let middle = |look: &ViewLook| {
        Sight::new(&look.camera, 0.5 * look.camera.width as f32, 0.5 * look.camera.height as f32)
    };
    let sights = if of_masks.len() < 2 { looks.iter().map(middle).collect() } else { of_masks };
    meeting_point(&sights).map(|point| point.as_vec3())
}

/// Where the tops of the pictures point in the mean: an axis, where it is near one; `given`, where it is near that, or where cameras are
/// held in all ways.
fn upright(looks: &[ViewLook], given: Vec3) -> Vec3 {
    // Cameras have y down.
    let top = |look: &ViewLook| -Vec3::from(look.camera.world_from_camera.matrix3.y_axis);
    let mean = looks.iter().map(top).sum::<Vec3>() / looks.len().max(1) as f32;
    let Some(up) = mean.try_normalize().filter(|_| mean.length() >= LEAST_UPRIGHT) else { return given };
    if up.dot(given) >= NEAR_AXIS {
        return given;
    }
    nearest_axis(up).unwrap_or(up)
}

/// The axis, or its opposite, that a unit direction is near.
fn nearest_axis(direction: Vec3) -> Option<Vec3> {
    let k = direction.abs().max_position();
    (direction[k].abs() >= NEAR_AXIS).then(|| Vec3::AXES[k] * direction[k].signum())
}

/// "+Y", "-Z", "(0.00, 0.71, 0.71)".
fn axis_name(direction: Vec3) -> String {
    match nearest_axis(direction) {
        Some(axis) => {
            let sign = if axis.element_sum() < 0.0 { '-' } else { '+' };
            format!("{sign}{}", ["X", "Y", "Z"][axis.abs().max_position()])
        }
        None => format!("({:.2}, {:.2}, {:.2})", direction.x, direction.y, direction.z),
    }
}

fn elevation(direction: Vec3, axis: Vec3) -> f32 {
    direction.dot(axis).clamp(-1.0, 1.0).asin().to_degrees()
}

/// Least and greatest.
fn range(values: &[f32]) -> [f32; 2] {
    let least = values.iter().copied().fold(f32::INFINITY, f32::min);
    [least, values.iter().copied().fold(f32::NEG_INFINITY, f32::max)]
}

/// The direction along which directions vary least, on the side of `up`: the eigenvector of their covariance with the smallest
/// eigenvalue. `None` for directions that do not span a plane.
fn ring_axis(directions: &[Vec3], up: Vec3) -> Option<Vec3> {
    const ROUNDS: usize = 64;
    let mean = directions.iter().sum::<Vec3>() / directions.len() as f32;
    let outer = |d: Vec3| Mat3::from_cols(d * d.x, d * d.y, d * d.z);
    let covariance = directions.iter().fold(Mat3::ZERO, |sum, d| sum + outer(*d - mean));
    let trace = covariance.x_axis.x + covariance.y_axis.y + covariance.z_axis.z;
    // The smallest eigenvalue of the covariance is the largest of this matrix.
    let shifted = Mat3::from_diagonal(Vec3::splat(trace)) - covariance;
    let mut axis = (up + Vec3::new(0.011, 0.023, 0.037)).normalize();
    for _ in 0..ROUNDS {
        axis = (shifted * axis).try_normalize()?;
    }
    Some(if axis.dot(up) < 0.0 { -axis } else { axis })
}

/// The number of rings around `axis`, if all directions lie on few.
fn count_rings(directions: &[Vec3], axis: Vec3) -> Option<usize> {
    let mut by_height: Vec<(f32, Vec3)> =
        directions.iter().map(|direction| (elevation(*direction, axis), *direction)).collect();
    by_height.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut rings: Vec<Vec<(f32, Vec3)>> = Vec::new();
    for camera in by_height {
        match rings.last_mut().filter(|ring| camera.0 - ring[0].0 <= RING_DEGREES) {
            Some(ring) => ring.push(camera),
            None => rings.push(vec![camera]),
        }
    }
    let is_round = |ring: &Vec<(f32, Vec3)>| {
        let directions: Vec<Vec3> = ring.iter().map(|camera| camera.1).collect();
        ring.len() >= RING_CAMERAS && largest_gap(&directions, axis) <= RING_GAP_DEGREES
    };
    (rings.len() <= MOST_RINGS && rings.iter().all(is_round)).then_some(rings.len())
}

/// The largest gap between azimuths around `axis`, in degrees; directions along the axis have none.
fn largest_gap(directions: &[Vec3], axis: Vec3) -> f32 {
    let (side, front) = axis.any_orthonormal_pair();
    let across = |direction: &&Vec3| direction.cross(axis).length() > 0.05;
    let azimuth = |direction: &Vec3| direction.dot(side).atan2(direction.dot(front)).to_degrees();
    let mut azimuths: Vec<f32> = directions.iter().filter(across).map(azimuth).collect();
    azimuths.sort_by(f32::total_cmp);
    let (Some(first), Some(last)) = (azimuths.first(), azimuths.last()) else { return 360.0 };
    let closing = first + 360.0 - last;
    azimuths.windows(2).map(|pair| pair[1] - pair[0]).fold(closing, f32::max)
}
