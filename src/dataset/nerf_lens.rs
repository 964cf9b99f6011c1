//! Intrinsics in the camera files of NeRF, nerfstudio and instant-ngp.
//!
//! They are at the top of the file or in a frame; those of the frame have priority.
//!
//! | fields | unit | meaning |
//! | --- | --- | --- |
//! | `w`, `h` | pixels | image size |
//! | `fl_x`, `fl_y` | pixels | focal lengths |
//! | `camera_angle_x`, `camera_angle_y` | radians | full fields of view, instead of focal lengths |
//! | `x_fov`, `y_fov` | degrees | the same |
//! | `cx`, `cy` | pixels | principal point |
//! | `camera_model` | | `OPENCV_FISHEYE`, `FULL_OPENCV`; other models of COLMAP with fewer coefficients count as `OPENCV` |
//! | `is_fisheye` | | whether the model is `OPENCV_FISHEYE` |
//! | `k1` to `k4` | | radial polynomial; `k4`, `k5`, `k6` of `FULL_OPENCV` are its divisor |
//! | `p1`, `p2` | | tangential distortion |
//! | `distortion_params` | | nerfstudio's list of `k1` to `k4`, `p1` and `p2`, which goes before these |

use crate::dataset::distortion::{Distortion, Projection};
use crate::dataset::lens::{Focal, Lens};
use serde::Deserialize;
use serde::de::IgnoredAny;

/// The fields that may be at the top level and in each frame.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Intrinsics {
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    x_fov: Option<f64>,
    y_fov: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    k5: Option<f64>,
    k6: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    distortion_params: Option<Vec<f64>>,
    // What instant-ngp has instead of a pinhole or fisheye lens.
    ftheta_p0: Option<IgnoredAny>,
    latlong: Option<IgnoredAny>,
    equirectangular: Option<IgnoredAny>,
}

/// A problem, and its remedy.
type Trouble = (String, &'static str);

const ADD_HELP: &str = "Add it to the frame or at the top of the file.";
const MODEL_HELP: &str = "Undistort the photographs to pinhole cameras first; PINHOLE, OPENCV, FULL_OPENCV and OPENCV_FISHEYE are read.";

impl Intrinsics {
    /// The n-th of `k1` to `k4`, `p1` and `p2`.
    fn coefficient(&self, n: usize) -> Option<f64> {
        let fields = [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2];
        let listed = self.distortion_params.as_ref().and_then(|list| list.get(n).copied());
        listed.or(fields[n])
    }

    /// Refuses a list of another length.
    fn check_list(&self) -> Result<(), Trouble> {
        const COUNT: usize = 6;
        match &self.distortion_params {
            Some(list) if list.len() != COUNT => {
                let problem = format!("distortion_params has {} numbers, not {COUNT}", list.len());
                Err((problem, "Write k1, k2, k3, k4, p1, p2, as nerfstudio does."))
            }
            _ => Ok(()),
        }
    }
}

/// Intrinsics of a frame and those of the whole file.
pub(super) struct Levels<'a> {
    pub own: &'a Intrinsics,
    pub shared: &'a Intrinsics,
}

impl Levels<'_> {
    pub fn lens(&self) -> Result<Lens, Trouble> {
        let focal_x = self.focal(|i| i.fl_x, |i| i.camera_angle_x, |i| i.x_fov);
        let focal_y = self.focal(|i| i.fl_y, |i| i.camera_angle_y, |i| i.y_fov);
        let size = match (self.either(|i| i.w), self.either(|i| i.h)) {
            (Some(w), Some(h)) => Some([whole(w)?, whole(h)?]),
            (None, None) => None,
            _ => return Err(("only one of w and h is given".into(), ADD_HELP)),
        };
        Ok(Lens {
            size,
            focal_x: focal_x.ok_or(("there is neither camera_angle_x nor fl_x".into(), ADD_HELP))?,
            focal_y,
            center: [self.either(|i| i.cx), self.either(|i| i.cy)],
            skew: 0.0,
            distortion: self.distortion()?,
            resizable: false,
            by_side: false,
        })
    }

    fn either<T>(&self, value: impl Fn(&Intrinsics) -> Option<T>) -> Option<T> {
        value(self.own).or_else(|| value(self.shared))
    }

    /// Focal length along one axis: the frame's value has priority over the shared one, and pixels over angles.
    fn focal(
        &self,
        pixels: fn(&Intrinsics) -> Option<f64>,
        radians: fn(&Intrinsics) -> Option<f64>,
        degrees: fn(&Intrinsics) -> Option<f64>,
    ) -> Option<Focal> {
        self.either(|level| {
            let angle = radians(level).or_else(|| degrees(level).map(f64::to_radians));
            pixels(level).map(Focal::Pixels).or_else(|| angle.map(Focal::Angle))
        })
    }

    fn distortion(&self) -> Result<Distortion, Trouble> {
        let other = [
            ("ftheta_p0", self.either(|i| i.ftheta_p0).is_some()),
            ("latlong", self.either(|i| i.latlong).is_some()),
            ("equirectangular", self.either(|i| i.equirectangular).is_some()),
        ];
        if let Some((field, _)) = other.iter().find(|(_, stated)| *stated) {
            return Err((format!("`{field}` is of a lens that cannot be read"), MODEL_HELP));
        }
        [self.own, self.shared].into_iter().try_for_each(Intrinsics::check_list)?;
        let [k1, k2, k3, k4, p1, p2] =
            std::array::from_fn(|n| self.either(|i| i.coefficient(n)).unwrap_or(0.0));
        let (radial, tangential) = ([k1, k2, k3, k4, 0.0, 0.0], [p1, p2]);
        let [k5, k6] = [self.either(|i| i.k5), self.either(|i| i.k6)].map(|k| k.unwrap_or(0.0));
        let stated = self.either(|i| i.camera_model.as_deref().map(str::to_ascii_uppercase));
        let is_fisheye = self.either(|i| i.is_fisheye).unwrap_or(false);
        match stated.as_deref() {
            Some("OPENCV_FISHEYE") => {}
            None | Some("OPENCV") if is_fisheye => {}
            Some("FULL_OPENCV") => return Ok(rational(radial, [k5, k6], tangential)),
            None | Some("SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV") => {
                // Only the model with a divisor has these.
                let is_full = k5 != 0.0 || k6 != 0.0;
                return Ok(match is_full {
                    true => rational(radial, [k5, k6], tangential),
                    false => Distortion { radial, tangential, ..Distortion::NONE },
                });
            }
            Some(other) => return Err((format!("the camera_model {other} cannot be read"), MODEL_HELP)),
        }
        Ok(Distortion { projection: Projection::Equidistant, radial, tangential, ..Distortion::NONE })
    }
}

/// OpenCV's full model, with k₄ in `radial` and k₅, k₆.
fn rational(radial: [f64; 6], [k5, k6]: [f64; 2], tangential: [f64; 2]) -> Distortion {
    let [k1, k2, k3, k4, ..] = radial;
    Distortion { divisor: [k4, k5, k6], ..Distortion::brown_conrady([k1, k2, k3], tangential) }
}

fn whole(value: f64) -> Result<u32, Trouble> {
    let is_size = value.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&value);
    if is_size {
        Ok(value as u32)
    } else {
        Err((format!("the image size {value} is not a whole number above 0"), ADD_HELP))
    }
}
