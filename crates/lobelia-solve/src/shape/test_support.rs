//! Cameras around an object, and what they show of it.

use crate::shape::{pictures::TrainingView, silhouette::Silhouette};
use glam::Vec3;
use lobelia_geometry::view::{Camera, Image, Mask, Photograph, Placement, StoredMask, ViewIndex};
use lobelia_geometry::{parallel, sdf::SdfGrid};
use lobelia_sg::ray::{Hit, Intersect, Ray, TexelAddress};

pub(crate) fn around(count: usize, distance: f32, size: u32) -> Vec<Camera> {
    Camera::around(count, distance, 40.0, size).unwrap()
}

/// The mask of `camera` in which rays are covered to this part, by their number and themselves.
pub(crate) fn mask(camera: &Camera, covered: impl Fn(&Ray) -> f32 + Sync) -> StoredMask {
    let (width, height) = (camera.width, camera.height);
    let covered = |pixel: usize| covered(&camera.pixel_ray(pixel as u32));
    let coverage = parallel::map((width * height) as usize, 1024, covered);
    StoredMask::new(&Mask { width, height, coverage })
}

/// The silhouettes `v0`, `v1`, … of an object whose surface rays meet at a distance; `hidden` says
/// by view and point what a mask lacks.
pub(crate) fn silhouettes_but(
    cameras: &[Camera],
    meets: impl Fn(&Ray) -> Option<f32> + Sync,
    hidden: impl Fn(usize, Vec3) -> bool + Sync,
) -> Vec<Silhouette> {
    let view = |(i, camera): (usize, &Camera)| {
        let is_covered = |ray: &Ray| meets(ray).is_some_and(|t| !hidden(i, ray.origin + t * ray.direction));
        let mask = mask(camera, |ray| f32::from(u8::from(is_covered(ray))));
        Silhouette::new(&format!("v{i}"), camera, &mask).unwrap()
    };
    cameras.iter().enumerate().map(view).collect()
}

pub(crate) fn silhouettes(cameras: &[Camera], field: &SdfGrid) -> Vec<Silhouette> {
    silhouettes_but(cameras, |ray| field.first_crossing(ray, 0.0), |_, _| false)
}

/// The first distance at which a ray meets a ball.
pub(crate) fn meets_ball(ray: &Ray, center: Vec3, radius: f32) -> Option<f32> {
    let from = ray.origin - center;
    let (b, c) = (from.dot(ray.direction), from.length_squared() - radius * radius);
    (b * b > c).then(|| -b - (b * b - c).sqrt())
}

pub(crate) struct Pictures {
    pub(crate) cameras: Vec<Camera>,
    pub(crate) photographs: Vec<Photograph>,
    pub(crate) masks: Vec<StoredMask>,
}

impl Pictures {
    /// Of what has a color where rays meet it.
    pub(crate) fn new(cameras: Vec<Camera>, color: impl Fn(&Camera, &Ray) -> Option<Vec3> + Sync) -> Self {
        let picture = |camera: &Camera| {
            let (width, height) = (camera.width, camera.height);
            let colors = (0..width * height).map(|pixel| color(camera, &camera.pixel_ray(pixel)));
            let colors: Vec<Option<Vec3>> = colors.collect();
            let pixels = colors.iter().map(|color| color.unwrap_or(Vec3::ZERO)).collect();
            let coverage = colors.iter().map(|color| f32::from(u8::from(color.is_some()))).collect();
            let photograph = Photograph::of_image(&Image { width, height, pixels });
            (photograph, StoredMask::new(&Mask { width, height, coverage }))
        };
        let (photographs, masks) = parallel::map_slice(&cameras, 1, picture).into_iter().unzip();
        Self { cameras, photographs, masks }
    }

    pub(crate) fn views(&self) -> Vec<TrainingView<'_>> {
        let parts = self.cameras.iter().zip(&self.photographs).zip(&self.masks);
        let view = |((camera, photograph), mask)| {
            let (index, placement) = (ViewIndex(0), Placement(0));
            TrainingView { index, name: "view", camera, photograph, mask, placement }
        };
        parts.map(view).collect()
    }

    pub(crate) fn silhouettes(&self) -> Vec<Silhouette> {
        self.views().iter().filter_map(TrainingView::silhouette).collect()
    }
}

/// All that is beyond 1 along an axis.
pub(crate) struct Wall(pub(crate) Vec3);

impl Intersect for Wall {
    fn intersect(&self, ray: &Ray, _: f32) -> Option<Hit> {
        let distance = (1.0 - ray.origin.dot(self.0)) / ray.direction.dot(self.0);
        (distance > 0.0 && self.occluded(ray, 0.0, 0.0)).then(|| Hit {
            distance,
            position: ray.origin + distance * ray.direction,
            normal: -self.0,
            geometric_normal: -self.0,
            uv: glam::Vec2::ZERO,
            texels: TexelAddress { weights: [0.25; 4], ..TexelAddress::default() },
        })
    }

    fn occluded(&self, ray: &Ray, _: f32, _: f32) -> bool {
        ray.direction.dot(self.0) > 0.0
    }
}
