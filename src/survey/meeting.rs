//! Checks of masks and cameras before a shape is reconstructed from them, with errors that name a bad view.
//!
//! Rays are cast through the centers of the masks' bounding boxes; these rays nearly meet in one point of the object
//! if cameras and masks are consistent. The point minimizes the sum of distances, so that a few wrong views do not affect it.

use crate::error::{Error, Result};
use crate::survey::finding::{Finding, named};
use crate::survey::look::{MaskLook, PixelBounds, ViewLook};
use crate::view::Camera;
use glam::{DMat3, DVec3, Vec3};

/// Views with masks that a shape needs.
const MIN_VIEWS: usize = 3;
/// Fraction of the views that may disagree with the others; the visual hull tolerates them.
const FORGIVEN: f64 = 0.02;
/// Iterations of Weiszfeld's algorithm (1937) for the point of least distances.
const MEETING_STEPS: usize = 30;
const SELECT_HELP: &str = "Repair the mask, or leave the view out with `select`.";

/// The bounding box of a mask in pixels, and the ray through its center.
pub struct Outline<'a> {
    name: &'a str,
    camera: Camera,
    bounds: PixelBounds,
    ray: Sight,
    is_cut: bool,
}

/// A line of sight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
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
}

impl<'a> Outline<'a> {
    /// `None` if there is no mask, or it is empty.
    pub fn new(look: &'a ViewLook) -> Option<Self> {
        let mask = look.mask.as_ref()?;
        let PixelBounds { low, high } = mask.bounds?;
        let ray = Sight::new(&look.camera, 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]));
        let (camera, bounds) = (look.camera, PixelBounds { low, high });
        Some(Self { name: &look.name, camera, bounds, ray, is_cut: mask.is_cut(&camera) })
    }

    /// The ray through the center of the box.
    pub fn sight(&self) -> Sight {
        self.ray
    }

    /// Half the shorter side of the box, as a length at the distance of `point`.
    pub fn radius_at(&self, point: DVec3) -> f64 {
        let halves = [0, 1].map(|k| 0.5 * (self.bounds.high[k] - self.bounds.low[k]) / self.camera.focal[k]);
        f64::from(halves[0].min(halves[1])) * self.ray.origin.distance(point)
    }

    /// Distance of the projection of `point` from the box, in sizes of the box; infinity behind the camera, 0 outside the frame.
    fn stray(&self, point: Vec3) -> f32 {
        let Some((x, y, _)) = self.camera.project(point) else { return f32::INFINITY };
        let (at, size) = ([x, y], [self.camera.width as f32, self.camera.height as f32]);
        if (0..2).any(|k| at[k] < 0.0 || at[k] > size[k]) {
            return 0.0;
        }
        let beyond = |k: usize| {
            let outside = (self.bounds.low[k] - at[k]).max(at[k] - self.bounds.high[k]).max(0.0);
            outside / (self.bounds.high[k] - self.bounds.low[k] + 0.04 * size[k])
        };
        beyond(0).max(beyond(1))
    }
}

/// Checks that the masks of the views are usable for reconstruction; a warning names views that are inconsistent with the others.
///
/// # Errors
/// [`Error::Usage`] that names a view and a remedy: fewer than three masks, a mask that is all covered, an object cut by every
/// frame, views along one line, a camera inside the object, cameras that look away from it, or cameras and masks that are
/// inconsistent.
pub(crate) fn check_masks(views: &[&ViewLook]) -> Result<Option<Finding>> {
    let masks = || views.iter().filter_map(|view| Some((*view, view.mask.as_ref()?)));
    if masks().count() < MIN_VIEWS {
        return Err(too_few(views, masks().count()));
    }
    let is_white = |mask: &MaskLook| mask.all_covered;
    if let Some((view, _)) = masks().find(|(_, mask)| is_white(mask)) {
        let problem = format!("the mask of view `{}` is all white: it has no silhouette", view.name);
        return Err(Error::usage(problem, SELECT_HELP));
    }
    let outlines: Vec<Outline> = views.iter().filter_map(|view| Outline::new(view)).collect();
    if let (Some(first), true) = (outlines.first(), outlines.iter().all(|outline| outline.is_cut)) {
        let problem = format!("every frame cuts the object (the first is view `{}`)", first.name);
        let help = "A shape needs views that show the whole object: move the camera back, or remove other objects from the masks.";
        return Err(Error::usage(problem, help));
    }
    let sights: Vec<Sight> = outlines.iter().map(Outline::sight).collect();
    let meeting = meeting_point(&sights).ok_or_else(|| {
        let problem = "all views look along one line: the distance of the object cannot be determined";
        Error::usage(problem, "Add views from other sides.")
    })?;
    check_places(&outlines, meeting)?;
    strangers(&outlines, meeting)
}

fn too_few(views: &[&ViewLook], masks: usize) -> Error {
    let without = views.iter().find(|view| view.mask.is_none());
    let without = without.map_or(String::new(), |view| format!(" (view `{}` has none)", view.name));
    let problem = format!("a shape needs at least three views with masks; there are {masks}{without}");
    let help = "Give every photograph a mask, white where the object is, or alpha; or give the scene a mesh.";
    Error::usage(problem, help)
}

/// The point with the least sum of distances to all rays; `None` if they are parallel.
pub(crate) fn meeting_point(sights: &[Sight]) -> Option<DVec3> {
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
        let sound = a.determinant() > 1e-6 * total.powi(3) && point.is_finite();
        if !sound {
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

/// Checks that cameras look at the object, from outside.
fn check_places(outlines: &[Outline], meeting: DVec3) -> Result<()> {
    let behind: Vec<&Outline> = outlines
        .iter()
        .filter(|outline| outline.ray.direction.dot(meeting - outline.ray.origin) < 0.0)
        .collect();
    if let (Some(first), true) = (behind.first(), 2 * behind.len() > outlines.len()) {
        let problem = format!(
            "{} of {} cameras look away from where their views meet (the first is view `{}`)",
            behind.len(),
            outlines.len(),
            first.name
        );
        let help =
            "Check the convention of the poses: camera axes, and world_from_camera or camera_from_world.";
        return Err(Error::usage(problem, help));
    }
    let mut radii: Vec<f64> = outlines.iter().map(|outline| outline.radius_at(meeting)).collect();
    radii.sort_by(f64::total_cmp);
    let radius = radii[radii.len() / 2];
    match outlines.iter().find(|outline| outline.ray.origin.distance(meeting) < 0.9 * radius) {
        None => Ok(()),
        Some(outline) => {
            let problem = format!("the camera of view `{}` is inside the object", outline.name);
            let at = outline.ray.origin;
            let help = format!(
                "It is at ({:.3}, {:.3}, {:.3}), the object around ({:.3}, {:.3}, {:.3}): correct the pose, or leave the \
                 view out with `select`.",
                at.x, at.y, at.z, meeting.x, meeting.y, meeting.z
            );
            Err(Error::usage(problem, help))
        }
    }
}

/// Views whose mask is far from the point on which the others agree.
fn strangers(outlines: &[Outline], meeting: DVec3) -> Result<Option<Finding>> {
    let point = meeting.as_vec3();
    let far = outlines.iter().map(|outline| (outline.stray(point), outline.name)).filter(|far| far.0 > 0.5);
    let mut far: Vec<(f32, &str)> = far.collect();
    far.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(b.1)));
    let Some(worst) = far.first() else { return Ok(None) };
    let (count, all, name) = (far.len(), outlines.len(), worst.1);
    if count as f64 <= FORGIVEN * all as f64 {
        let names: Vec<String> = far.iter().map(|far| far.1.to_owned()).collect();
        let problem = format!(
            "mask or camera disagrees with the other views in {}; the shape ignores it",
            named(&names)
        );
        return Ok(Some(Finding::warning("stray-view", names, problem, SELECT_HELP)));
    }
    let problem = format!(
        "cameras and masks are inconsistent: in {count} of {all} views the place where the others see the object \
         is not in the mask; view `{name}` is farthest off"
    );
    Err(Error::usage(problem, "Correct that view's pose or mask, or leave it out with `select`."))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::fibonacci::fibonacci_axes;
    use crate::survey::look::{MaskOrigin, OpenView};
    use crate::view::{Mask, Placement, Split};

    const SIDE: u32 = 64;

    /// Views of a ball of radius 1 around `center`, times `scale`.
    fn ball(center: Vec3, scale: f32, count: usize) -> Vec<OpenView> {
        let view = |(i, axis): (usize, Vec3)| {
            let up = if axis.y.abs() > 0.9 { Vec3::X } else { Vec3::Y };
            let camera = Camera::look_at((center + 4.0 * axis) * scale, center * scale, up, 40.0, SIDE, SIDE);
            let name = format!("v{i}");
            OpenView {
                name,
                split: Split::Train,
                camera: camera.unwrap(),
                photograph: None,
                mask: None,
                placement: Placement::default(),
                negative: 0.0,
                exif: [1; 2],
            }
        };
        let mut views: Vec<OpenView> = fibonacci_axes(count).into_iter().enumerate().map(view).collect();
        views.iter_mut().for_each(|view| view.mask = Some(disk([32.0, 32.0], 22.0)));
        views
    }

    fn disk(center: [f32; 2], radius: f32) -> Mask {
        let covered = |i: u32| {
            let (x, y) = ((i % SIDE) as f32 + 0.5 - center[0], (i / SIDE) as f32 + 0.5 - center[1]);
            if x * x + y * y < radius * radius { 1.0 } else { 0.0 }
        };
        Mask { width: SIDE, height: SIDE, coverage: (0..SIDE * SIDE).map(covered).collect() }
    }

    fn check(views: &[OpenView]) -> Result<Option<Finding>> {
        let look = |view: &OpenView| {
            ViewLook::new(view, [view.camera.width, view.camera.height], MaskOrigin::File, false)
        };
        let looks: Vec<ViewLook> = views.iter().map(look).collect();
        check_masks(&looks.iter().collect::<Vec<_>>())
    }

    #[track_caller]
    fn refused(views: &[OpenView], words: &[&str]) {
        let error = check(views).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let text = format!("{error} | {}", error.help().unwrap());
        words.iter().for_each(|word| assert!(text.contains(word), "`{word}` is not in: {text}"));
    }

    #[test]
    fn sound_views_pass_at_any_place_and_scale() {
        for (center, scale) in
            [(Vec3::ZERO, 1.0), (Vec3::new(50.0, -20.0, 30.0), 1000.0), (Vec3::splat(40.0), 1e-3)]
        {
            assert_eq!(check(&ball(center, scale, 20)).unwrap(), None);
        }
    }

    #[test]
    fn masks_that_say_nothing_are_named() {
        let mut views = ball(Vec3::ZERO, 1.0, 12);
        views[5].mask.as_mut().unwrap().coverage.fill(1.0);
        refused(&views, &["`v5`", "all white", "select"]);
        refused(&views[..2], &["at least three views", "there are 2"]);
        views.iter_mut().skip(2).for_each(|view| view.mask = None);
        refused(&views, &["there are 2", "view `v2` has none", "white where the object is"]);
    }

    #[test]
    fn an_object_cut_by_every_frame_is_refused() {
        let mut views = ball(Vec3::ZERO, 1.0, 12);
        views.iter_mut().for_each(|view| view.mask = Some(disk([32.0, 50.0], 22.0)));
        refused(&views, &["every frame cuts", "`v0`", "move the camera back"]);
        views[3].mask = Some(disk([32.0, 32.0], 22.0));
        assert!(!check(&views).is_err_and(|error| error.to_string().contains("cuts")));
    }

    #[test]
    fn cameras_inside_the_object_are_named() {
        let mut views = ball(Vec3::new(5.0, 0.0, 0.0), 1.0, 24);
        views[7].camera.world_from_camera.translation = Vec3::new(5.3, 0.1, 0.0).into();
        refused(&views, &["camera of view `v7` is inside the object", "select"]);
    }

    #[test]
    fn cameras_in_other_axes_or_along_one_line_are_told() {
        let mut views = ball(Vec3::ZERO, 1.0, 24);
        for view in &mut views {
            let rotation = &mut view.camera.world_from_camera.matrix3;
            (rotation.y_axis, rotation.z_axis) = (-rotation.y_axis, -rotation.z_axis);
        }
        refused(&views, &["24 of 24 cameras look away", "camera axes"]);
        let same: Vec<OpenView> = vec![views[0].clone(); 5];
        refused(&same, &["along one line", "other sides"]);
    }

    #[test]
    fn a_view_that_disagrees_is_named() {
        let mut views = ball(Vec3::ZERO, 1.0, 24);
        views[9].mask = Some(disk([8.0, 8.0], 5.0));
        refused(&views, &["1 of 24 views", "view `v9` is farthest off"]);
        let mut many = ball(Vec3::ZERO, 1.0, 60);
        many[9].mask = Some(disk([8.0, 8.0], 5.0));
        let stray = check(&many).unwrap().unwrap();
        assert!(
            stray.views == ["v9"] && stray.problem.contains("disagrees with the other views"),
            "{stray:?}"
        );
    }
}
