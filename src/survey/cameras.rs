//! Cameras: whether they see one point, how they lie around the object, and whether the object
//! turned in front of a camera that stood still.

use crate::survey::{Finding, Severity};
use glam::{DMat3, DVec3, Mat3, Vec3};
use lobelia_geometry::error::{Error, Result};
use lobelia_geometry::view::look::{PixelBounds, ViewLook};
use lobelia_geometry::view::{Camera, Split};
use lobelia_sg::statistics::median;
use serde::Serialize;

/// Views with masks that a shape needs.
const MIN_VIEWS: usize = 3;
/// Fraction of the views that may disagree with the others; the visual hull tolerates them.
const FORGIVEN: f64 = 0.02;
/// Distance of the meeting point from a mask's box beyond which a view disagrees, in sizes of the
/// box.
const FAR: f32 = 0.5;
/// Part of the object's radius within which a camera is inside the object.
const INSIDE: f64 = 0.9;
/// Iterations of Weiszfeld's algorithm (1937) for the point of least distances.
const MEETING_STEPS: usize = 30;

/// Largest difference of elevations in one ring of cameras, degrees.
const RING_DEGREES: f32 = 6.0;
/// Least number of cameras of a ring.
const RING_CAMERAS: usize = 6;
/// Largest number of rings of a capture that is made of rings.
const MOST_RINGS: usize = 3;
/// Largest gap between neighbors of a ring, degrees.
const RING_GAP_DEGREES: f32 = 75.0;
/// Largest gap in azimuth of cameras that are all around the object, degrees.
const AROUND_GAP_DEGREES: f32 = 100.0;

/// Most pixels a side of the backgrounds that are compared, and the number of photographs compared.
pub(super) const BACKGROUND_SIDE: u32 = 64;
pub(super) const BACKGROUNDS: usize = 12;
/// Pixels that must be background in all of them.
const LEAST_PIXELS: usize = 150;
/// Standard deviation over the background below which it is plain, in square roots of its mean
/// luminance.
const PLAIN: f32 = 0.03;
/// Correlation between backgrounds from which on they are the same.
pub(super) const SAME: f32 = 0.85;

/// A line of sight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sight {
    /// Where it starts.
    pub origin: DVec3,
    /// Its direction, of unit length.
    pub direction: DVec3,
}

impl Sight {
    /// Through a place of a camera's image, in pixels.
    pub fn new(camera: &Camera, x: f32, y: f32) -> Self {
        let ray = camera.ray(x, y);
        Self { origin: ray.origin.as_dvec3(), direction: ray.direction.as_dvec3() }
    }

    /// Through the center of a mask's bounding box; `None` without a mask, or for an empty one.
    fn of_mask(look: &ViewLook) -> Option<Self> {
        let PixelBounds { low, high } = look.mask.as_ref()?.bounds?;
        Some(Self::new(&look.camera, 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])))
    }
}

/// The point with the least sum of distances to all lines, so that a few wrong ones do not affect
/// it; `None` if they are parallel.
pub(super) fn meeting_point(sights: &[Sight]) -> Option<DVec3> {
    let base = sights.iter().map(|sight| sight.origin).sum::<DVec3>() / sights.len() as f64;
    let mut weights = vec![1.0; sights.len()];
    let mut point = DVec3::ZERO;
    for _ in 0..MEETING_STEPS {
        let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
        for (sight, weight) in sights.iter().zip(&weights) {
            let d = sight.direction;
            let across = (DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z)) * *weight;
            a += across;
            b += across * (sight.origin - base);
        }
        let total: f64 = weights.iter().sum();
        point = a.inverse() * b;
        if !(a.determinant() > 1e-6 * total.powi(3) && point.is_finite()) {
            return None;
        }
        let apart = |sight: &Sight| sight.direction.cross(point - (sight.origin - base)).length();
        let distances: Vec<f64> = sights.iter().map(apart).collect();
        let floor = 1e-3 * distances.iter().sum::<f64>() / distances.len() as f64;
        weights = distances.iter().map(|distance| 1.0 / distance.max(floor).max(f64::MIN_POSITIVE)).collect();
        let largest = weights.iter().copied().fold(0.0, f64::max);
        weights.iter_mut().for_each(|weight| *weight /= largest);
    }
    Some(base + point)
}

/// Checks that training cameras see one point, by the rays through the centers of the masks'
/// bounding boxes, which nearly meet in one point of the object.
pub(super) fn check_meeting(looks: &[ViewLook]) -> Result<()> {
    let views = || looks.iter().filter(|look| look.split == Split::Train);
    let masked: Vec<&ViewLook> = views().filter(|view| view.mask.is_some()).collect();
    if masked.len() < MIN_VIEWS {
        let without = views().find(|view| view.mask.is_none());
        let without = without.map_or(String::new(), |view| format!(" (view `{}` has none)", view.name));
        let count = masked.len();
        let problem = format!("a shape needs at least three views with masks; there are {count}{without}");
        let help =
            "Give every photograph a mask, white where the object is, or alpha; or give the scene a mesh.";
        return Err(Error::usage(problem, help));
    }
    let is_white = |view: &&&ViewLook| view.mask.as_ref().is_some_and(|mask| mask.all_covered);
    if let Some(view) = masked.iter().find(is_white) {
        let problem = format!("the mask of view `{}` is all white: it has no silhouette", view.name);
        return Err(Error::usage(problem, "Repair the mask, or leave the view out with `select`."));
    }
    let outlines: Vec<(&ViewLook, Sight)> =
        masked.iter().filter_map(|view| Some((*view, Sight::of_mask(view)?))).collect();
    let is_cut = |view: &ViewLook| view.mask.as_ref().is_some_and(|mask| mask.is_cut(&view.camera));
    if let (Some((first, _)), true) = (outlines.first(), outlines.iter().all(|(view, _)| is_cut(view))) {
        let problem = format!("every frame cuts the object (the first is view `{}`)", first.name);
        let help = "A shape needs views that show the whole object: move the camera back, or remove other objects from the masks.";
        return Err(Error::usage(problem, help));
    }
    let sights: Vec<Sight> = outlines.iter().map(|(_, sight)| *sight).collect();
    let Some(meeting) = meeting_point(&sights) else {
        let problem = "all views look along one line: the distance of the object cannot be determined";
        let help = "Add views from other sides, and give each its own pose in the frame of the object: of an object that turns before a \
                    fixed camera, as if the camera went around it. `lobelia prepare PHOTOS OUT` finds such poses.";
        return Err(Error::usage(problem, help));
    };
    let is_behind = |sight: &Sight| sight.direction.dot(meeting - sight.origin) < 0.0;
    let behind = outlines.iter().filter(|(_, sight)| is_behind(sight));
    let behind: Vec<&str> = behind.map(|(view, _)| view.name.as_str()).collect();
    if 2 * behind.len() > outlines.len() {
        let (count, all, first) = (behind.len(), outlines.len(), behind[0]);
        let problem = format!(
            "{count} of {all} cameras look away from where their views meet (the first is view `{first}`)"
        );
        let help =
            "Check the convention of the poses: camera axes, and world_from_camera or camera_from_world.";
        return Err(Error::usage(problem, help));
    }
    // Half the shorter side of the box, as a length at the object's distance.
    let radius = |(view, sight): &(&ViewLook, Sight)| {
        let PixelBounds { low, high } = view.mask.as_ref()?.bounds?;
        let halves = [0, 1].map(|k| 0.5 * (high[k] - low[k]) / view.camera.focal[k]);
        Some(halves[0].min(halves[1]) * sight.origin.distance(meeting) as f32)
    };
    let mut radii: Vec<f32> = outlines.iter().filter_map(radius).collect();
    let radius = f64::from(median(&mut radii).unwrap_or(0.0));
    let is_inside = |sight: &Sight| sight.origin.distance(meeting) < INSIDE * radius;
    if let Some((view, sight)) = outlines.iter().find(|(_, sight)| is_inside(sight)) {
        let problem = format!("the camera of view `{}` is inside the object", view.name);
        let help = format!(
            "It is at {:.3}, the object around {meeting:.3}: correct the pose, or leave the view out with `select`.",
            sight.origin
        );
        return Err(Error::usage(problem, help));
    }
    let far = outlines.iter().map(|(view, _)| (stray(view, meeting.as_vec3()), view.name.as_str()));
    let far: Vec<(f32, &str)> = far.filter(|(stray, _)| *stray > FAR).collect();
    let (count, all) = (far.len(), outlines.len());
    let worst = far.into_iter().max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(a.1)));
    let Some((_, worst)) = worst.filter(|_| count as f64 > FORGIVEN * all as f64) else { return Ok(()) };
    let problem = format!(
        "cameras and masks are inconsistent: in {count} of {all} views the place where the others see the object is not in the mask; \
         view `{worst}` is farthest off"
    );
    Err(Error::usage(problem, "Correct that view's pose or mask, or leave it out with `select`."))
}

/// Distance of the projection of `point` from the mask's box, in sizes of the box; infinity behind
/// the camera, 0 outside the frame.
fn stray(view: &ViewLook, point: Vec3) -> f32 {
    let Some(PixelBounds { low, high }) = view.mask.as_ref().and_then(|mask| mask.bounds) else { return 0.0 };
    let Some((x, y, _)) = view.camera.project(point) else { return f32::INFINITY };
    let (at, size) = ([x, y], [view.camera.width as f32, view.camera.height as f32]);
    if (0..2).any(|k| at[k] < 0.0 || at[k] > size[k]) {
        return 0.0;
    }
    let beyond =
        |k: usize| (low[k] - at[k]).max(at[k] - high[k]).max(0.0) / (high[k] - low[k] + 0.04 * size[k]);
    beyond(0).max(beyond(1))
}

/// How the cameras lie.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Arrangement {
    /// The number of circles around one axis on which all cameras lie, if they are at most three.
    pub rings: Option<usize>,
    /// The point that they look at, in world units.
    pub target: Vec3,
    /// The axis of rings, else the data's up direction; of unit length.
    pub axis: Vec3,
    /// Lowest and highest elevation above the plane through the target across `axis`, in degrees.
    pub elevation_degrees: [f32; 2],
    /// The largest gap between azimuths around `axis`, in degrees.
    pub azimuth_gap_degrees: f32,
    /// The least and the greatest distance from the target, in world units.
    pub distance: [f32; 2],
}

impl Arrangement {
    /// From the cameras of `looks` around `center` if it is known, else around the point they look
    /// at. `None` without a camera apart from that point.
    pub fn new(looks: &[ViewLook], center: Option<Vec3>, up: Vec3) -> Option<Self> {
        let target = center.or_else(|| target(looks)).filter(|target| target.is_finite())?;
        let offsets: Vec<Vec3> = looks.iter().map(|look| look.camera.position() - target).collect();
        let directions: Vec<Vec3> = offsets.iter().filter_map(|offset| offset.try_normalize()).collect();
        if directions.is_empty() {
            return None;
        }
        let up = up.try_normalize().unwrap_or(Vec3::Y);
        let rings = ring_axis(&directions, up).and_then(|axis| Some((count_rings(&directions, axis)?, axis)));
        let axis = rings.map_or(up, |rings| rings.1);
        Some(Self {
            rings: rings.map(|rings| rings.0),
            target,
            axis,
            elevation_degrees: range(directions.iter().map(|direction| elevation(*direction, axis))),
            azimuth_gap_degrees: largest_gap(&directions, axis),
            distance: range(offsets.iter().map(|offset| offset.length())),
        })
    }

    /// "all around: elevation −3° to 88°, widest gap 14°, distance 4.03 to 4.1".
    pub fn words(&self) -> String {
        let ([low, high], [near, far]) = (self.elevation_degrees, self.distance);
        let gap = self.azimuth_gap_degrees;
        let kind = match self.rings {
            Some(1) => "one ring".to_owned(),
            Some(count) => format!("{count} rings"),
            None if gap > AROUND_GAP_DEGREES => "from one side".to_owned(),
            None => "all around".to_owned(),
        };
        format!(
            "{kind}: elevation {low:.0}° to {high:.0}°, widest gap {gap:.0}°, distance {near:.3} to {far:.3}"
        )
    }

    /// The unit direction of each view from the target.
    pub fn directions(&self, looks: &[ViewLook]) -> Vec<Vec3> {
        looks.iter().map(|look| (look.camera.position() - self.target).normalize_or(self.axis)).collect()
    }
}

/// Where the centers of the masks meet, or the middles of the frames.
fn target(looks: &[ViewLook]) -> Option<Vec3> {
    let of_masks: Vec<Sight> = looks.iter().filter_map(Sight::of_mask).collect();
    let middle = |look: &ViewLook| {
        Sight::new(&look.camera, 0.5 * look.camera.width as f32, 0.5 * look.camera.height as f32)
    };
    let sights = if of_masks.len() < 2 { looks.iter().map(middle).collect() } else { of_masks };
    meeting_point(&sights).map(|point| point.as_vec3())
}

fn elevation(direction: Vec3, axis: Vec3) -> f32 {
    direction.dot(axis).clamp(-1.0, 1.0).asin().to_degrees()
}

/// Least and greatest.
fn range(values: impl Iterator<Item = f32>) -> [f32; 2] {
    values
        .fold([f32::INFINITY, f32::NEG_INFINITY], |[least, most], value| [least.min(value), most.max(value)])
}

/// The direction along which directions vary least, on the side of `up`: the eigenvector of their
/// covariance with the smallest eigenvalue. `None` for directions that do not span a plane.
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
    let mut by_height = directions.to_vec();
    let height = |direction: &Vec3| elevation(*direction, axis);
    by_height.sort_by(|a, b| height(a).total_cmp(&height(b)));
    let mut rings: Vec<Vec<Vec3>> = Vec::new();
    for camera in by_height {
        match rings.last_mut().filter(|ring| height(&camera) - height(&ring[0]) <= RING_DEGREES) {
            Some(ring) => ring.push(camera),
            None => rings.push(vec![camera]),
        }
    }
    let is_round =
        |ring: &Vec<Vec3>| ring.len() >= RING_CAMERAS && largest_gap(ring, axis) <= RING_GAP_DEGREES;
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

/// The background of one photograph, before its mask makes it black.
#[derive(Clone, Debug, PartialEq)]
pub struct Background {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Square root of luminance of each pixel; `None` where the object is.
    pub values: Vec<Option<f32>>,
}

/// Median correlation of each background with the mean of the others, over pixels that are
/// background in all. `None` if they differ in size, leave too few pixels, or are plain.
pub(super) fn sameness(backgrounds: &[Background]) -> Option<f32> {
    let first = backgrounds.first().filter(|_| backgrounds.len() >= 3)?;
    if backgrounds.iter().any(|background| background.size != first.size) {
        return None;
    }
    let is_common = |i: &usize| backgrounds.iter().all(|background| background.values[*i].is_some());
    let common: Vec<usize> = (0..first.values.len()).filter(is_common).collect();
    if common.len() < LEAST_PIXELS {
        return None;
    }
    let row = |of: &Background| common.iter().filter_map(|&i| of.values[i]).collect();
    let rows: Vec<Vec<f32>> = backgrounds.iter().map(row).collect();
    let count = rows.len() as f32;
    let sums: Vec<f32> = (0..common.len()).map(|i| rows.iter().map(|row| row[i]).sum()).collect();
    let mean = sums.iter().sum::<f32>() / (count * common.len() as f32);
    let spread = deviation(&sums) / count;
    if spread <= PLAIN * mean.max(0.05) {
        return None;
    }
    let one = |row: &Vec<f32>| {
        let others = sums.iter().zip(row).map(|(sum, value)| (sum - value) / (count - 1.0));
        correlation(row, &others.collect::<Vec<_>>())
    };
    median(&mut rows.iter().map(one).collect::<Vec<_>>())
}

fn deviation(values: &[f32]) -> f32 {
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f32>() / values.len() as f32).sqrt()
}

/// 0 where one of the two does not vary.
fn correlation(a: &[f32], b: &[f32]) -> f32 {
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let product: f32 = a.iter().zip(b).map(|(a, b)| (a - mean_a) * (b - mean_b)).sum();
    let both = deviation(a) * deviation(b) * a.len() as f32;
    if both > 0.0 { product / both } else { 0.0 }
}

/// The consequence of a turntable for a fit.
pub(super) fn turntable(sameness: f32) -> Finding {
    let problem = format!(
        "this is a turntable capture: the cameras lie on a ring and the background is the same in all photographs (correlation \
         {sameness:.2}), so the light did not turn with the object"
    );
    let help = "A fit of an unknown light finds that by itself, unless `light_frame` says otherwise; see Turntables in the manual's chapter on photographs.";
    Finding::new(Severity::Warning, "turntable", Vec::new(), problem, help)
}
