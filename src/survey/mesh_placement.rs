//! Where and how large a mesh would have to be for its silhouettes to agree with the masks.

use crate::math::statistics::median;
use crate::mesh::bvh::TriangleBvh;
use crate::survey::change::{Cause, Change, formula};
use crate::survey::look::SmallMask;
use crate::survey::meeting::{Sight, meeting_point};
use crate::survey::mesh_overlap::covered;
use glam::{Mat3A, Vec3, Vec3A};
use rayon::prelude::*;

/// Rounds of correcting size and place; each renders all views.
const ROUNDS: usize = 4;
/// A scale this close to that of a usual unit, relatively, is that.
const UNIT_SLACK: f32 = 0.1;
/// A scale this close to 1 is 1.
const ONE_SLACK: f32 = 0.03;
/// Ratios of units that meshes and cameras are written in, with their names.
const UNITS: [(f32, &str); 5] = [
    (1000.0, "meters and millimeters"),
    (100.0, "meters and centimeters"),
    (10.0, "centimeters and millimeters"),
    (39.370_08, "meters and inches"),
    (25.4, "inches and millimeters"),
];

/// Center and size of a silhouette: the ray through the middle of its box, and the root of its area as an angle.
struct Spot {
    sight: Sight,
    size: f32,
}

impl Spot {
    /// `None` if nothing is covered.
    fn new(view: &SmallMask, inside: &[bool]) -> Option<Self> {
        let width = view.camera.width as usize;
        let (mut sum, mut count) = ([0.0f32; 2], 0usize);
        for (i, _) in inside.iter().enumerate().filter(|(_, inside)| **inside) {
            sum = [sum[0] + (i % width) as f32 + 0.5, sum[1] + (i / width) as f32 + 0.5];
            count += 1;
        }
        let middle = sum.map(|sum| sum / count as f32);
        let focal = (view.camera.focal[0] * view.camera.focal[1]).abs().sqrt();
        let spot = || Self {
            sight: Sight::new(&view.camera, middle[0], middle[1]),
            size: (count as f32).sqrt() / focal,
        };
        (count > 0).then(spot)
    }
}

/// The object as several silhouettes show it: where, and how large.
fn place(spots: &[Spot]) -> Option<(Vec3, f32)> {
    let sights: Vec<Sight> = spots.iter().map(|spot| spot.sight).collect();
    let center = meeting_point(&sights).filter(|_| sights.len() >= 2)?;
    let mut sizes: Vec<f32> =
        spots.iter().map(|spot| spot.size * spot.sight.origin.distance(center) as f32).collect();
    Some((center.as_vec3(), median(&mut sizes)?)).filter(|(center, size)| center.is_finite() && *size > 0.0)
}

/// The placing of a mesh, turned by `turn`, that makes its silhouettes agree with the masks in center and size. `None` if masks do not
/// determine a place, or the mesh is never in sight.
pub(crate) fn find_placement(bvh: &TriangleBvh, views: &[SmallMask], turn: Mat3A) -> Option<Change> {
    let spots: Vec<Spot> = views.iter().filter_map(|view| Spot::new(view, &view.inside)).collect();
    let (target, size) = place(&spots)?;
    let (center, radius) = bvh.bounding_sphere();
    let center = Vec3::from(turn * glam::Vec3A::from(center));
    // The root of a disk's area is 1.77 radii; most objects fill less of their sphere.
    let mut scale = size / (1.4 * radius);
    let mut shift = target - center * scale;
    for _ in 0..ROUNDS {
        let change = Change::Placed { turn, scale, shift };
        let rendered: Vec<Option<Spot>> = views
            .par_iter()
            .map(|view| {
                // The box is seen in the mesh's own coordinates; its rays are those of the view as it is.
                Spot::new(view, &covered(bvh, &change.of(view)))
            })
            .collect();
        let spots: Vec<Spot> = rendered.into_iter().flatten().collect();
        let (seen, seen_size) = place(&spots)?;
        let factor = (size / seen_size).clamp(0.25, 4.0);
        // Around the place where it is seen, then to where it should be.
        shift = (shift - seen) * factor + target;
        scale *= factor;
    }
    let change = Change::Placed { turn, scale, shift };
    (scale.is_finite() && scale > 0.0 && shift.is_finite()).then_some(change)
}

/// A placing in words; its scale is snapped to 1 or a usual ratio of units, where it is near one.
/// `center` and `radius` are those of the mesh's bounding sphere.
pub(crate) fn placement_cause(change: Change, center: Vec3, radius: f32) -> Option<Cause> {
    let Change::Placed { turn, scale, shift } = change else { return None };
    // The size is measured; what is meant is a ratio of units, or none. The place of the mesh's middle stays.
    let factor = snapped(scale);
    let shift = shift + Vec3::from(turn * Vec3A::from(center)) * (scale - factor);
    let moved = shift.length() > 0.1 * radius * scale;
    let turned = turn != Mat3A::IDENTITY;
    let mut words = Vec::new();
    if turned {
        words.push(format!("turned: its coordinates should be {}", formula(&turn)));
    }
    if factor != 1.0 {
        let size = if scale > 1.0 {
            format!("{} times too small", short(factor))
        } else {
            format!("{} times too large", short(1.0 / factor))
        };
        words.push(format!("{size}{}", unit(scale)));
    }
    if moved {
        let [x, y, z] = shift.to_array().map(short);
        words.push(format!("in another place (it is to be moved by ({x}, {y}, {z}))"));
    }
    let words = if words.is_empty() { return None } else { format!("the mesh is {}", words.join(", and ")) };
    let [x, y, z] = shift.to_array().map(short);
    let turn = if turned {
        format!("write its vertices (x, y, z) as {}, then ", formula(&turn))
    } else {
        String::new()
    };
    let shift = if moved { format!("add ({x}, {y}, {z}) to its vertices") } else { String::new() };
    let size = if factor == 1.0 { String::new() } else { format!("multiply them by {}", short(factor)) };
    let steps: Vec<String> = [size, shift].into_iter().filter(|step| !step.is_empty()).collect();
    let help = format!("Bring the mesh into the coordinates of the cameras: {turn}{}.", steps.join(" and "));
    Some(Cause { change, words, help })
}

fn snapped(scale: f32) -> f32 {
    let near = |ratio: f32, slack: f32| (scale / ratio - 1.0).abs() < slack;
    let mut ratios = UNITS.iter().flat_map(|(ratio, _)| [*ratio, 1.0 / ratio]);
    let one = near(1.0, ONE_SLACK).then_some(1.0);
    one.or_else(|| ratios.find(|ratio| near(*ratio, UNIT_SLACK))).unwrap_or(scale)
}

fn unit(scale: f32) -> String {
    let ratio = scale.max(1.0 / scale);
    let near = UNITS.iter().find(|(of_unit, _)| (ratio / of_unit - 1.0).abs() < UNIT_SLACK);
    near.map_or(String::new(), |(_, names)| format!(" (as between {names})"))
}

/// Three significant digits.
pub fn short(value: f32) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_near_one_is_one_and_the_middle_stays() {
        let (center, wanted) = (Vec3::new(2.0, 0.0, 0.0), Vec3::new(3.0, 1.0, 0.0));
        let scale = 0.98;
        let change = Change::Placed { turn: Mat3A::IDENTITY, scale, shift: wanted - center * scale };
        let cause = placement_cause(change, center, 0.5).unwrap();
        assert!(!cause.help.contains("multiply") && cause.help.contains("add (1, 1, 0)"), "{}", cause.help);
        let unit = Change::Placed { turn: Mat3A::IDENTITY, scale: 0.00098, shift: Vec3::ZERO };
        let cause = placement_cause(unit, Vec3::ZERO, 0.5).unwrap();
        assert!(cause.help.ends_with("multiply them by 0.001."), "{}", cause.help);
    }

    #[test]
    fn numbers_are_short_and_units_are_recognized() {
        assert_eq!([1000.0, 0.001, 1.2345, -0.5].map(short), ["1000", "0.001", "1.23", "-0.5"]);
        assert_eq!((snapped(980.0), snapped(0.00098), snapped(3.0)), (1000.0, 0.001, 3.0));
        assert_eq!([0.91, 0.98, 1.0, 1.02, 1.1].map(snapped), [0.91, 1.0, 1.0, 1.0, 1.1]);
        assert_eq!(
            (unit(0.0011), unit(3.0)),
            (" (as between meters and millimeters)".to_owned(), String::new())
        );
    }
}
