//! What `lobelia env` says about lights.

use glam::{DVec3, Vec3};
use lobelia::light::map_fit::Sun;
use lobelia::light::{EnvironmentMap, LightLobe, lobes_power, lobes_radiance};
use lobelia::math::color::luminance;
use lobelia::spawn::light_file::LightFile;
use std::f64::consts::PI;
use std::fmt::Write as _;

/// Lines of the lobe table unless all are asked for.
const TABLE_LINES: usize = 16;

/// One line for each sun that was fitted apart, with what its lobe does to the peak.
pub fn sun_notes(suns: &[Sun]) -> Vec<String> {
    let note = |sun: &Sun| {
        format!(
            "sun at {}: peak {:.3e} over {:.1e} sr, {:.1} % of the power; its lobe has sharpness {:.0} and peak {:.3e}",
            direction(sun.lobe.axis),
            sun.peak.max_element(),
            sun.solid_angle,
            100.0 * sun.power_share,
            sun.lobe.sharpness,
            sun.lobe.amplitude.max_element()
        )
    };
    suns.iter().map(note).collect()
}

/// What is in a light: mean, power, peak, and a table of its lobes by power (all of them, or the first 16).
pub fn info(light: &LightFile, all: bool) -> String {
    let mut text = match light {
        LightFile::Lobes(lobes) => {
            let lit = lobes.iter().filter(|l| l.amplitude.max_element() > 0.0).count();
            format!("{} lobes, {lit} of them not black\n", lobes.len())
        }
        LightFile::Map(map) => format!("map of {} × {} texels\n", map.width, map.height),
    };
    let (power, (peak, toward)) = match light {
        LightFile::Lobes(lobes) => (lobes_power(lobes), lobe_peak(lobes)),
        LightFile::Map(map) => (map.power(), map_peak(map)),
    };
    let upper = upper_power(light);
    // Writing to a `String` cannot fail.
    let _ = writeln!(text, "  mean radiance   {}", rgb(power / (4.0 * PI)));
    let _ = writeln!(text, "  power           {} (integral over the sphere, radiance × sr)", rgb(power));
    let _ = match luminous(power) {
        whole if whole > 0.0 => {
            writeln!(text, "  from above      {:.1} % of the luminous power", 100.0 * upper / whole)
        }
        _ => writeln!(text, "  from above      nothing: it gives no light"),
    };
    let _ = writeln!(text, "  peak            {} at {}", rgb(peak.as_dvec3()), direction(toward));
    if let LightFile::Lobes(lobes) = light {
        table(&mut text, lobes, if all { lobes.len() } else { TABLE_LINES });
    }
    text
}

/// Luminous power from above the horizon.
fn upper_power(light: &LightFile) -> f64 {
    let map = light.to_map(512, 256);
    let upper = EnvironmentMap { height: map.height, width: map.width, radiance: map.radiance };
    let half = upper.width as usize * (upper.height as usize / 2);
    let above: Vec<Vec3> =
        upper.radiance.iter().enumerate().map(|(k, &r)| if k < half { r } else { Vec3::ZERO }).collect();
    luminous(EnvironmentMap { radiance: above, ..upper }.power())
}

fn luminous(power: DVec3) -> f64 {
    f64::from(luminance(power.as_vec3()))
}

/// Greatest luminance of the lobes' sum at a lobe's axis: the peak of the whole is at one of them or close by.
fn lobe_peak(lobes: &[LightLobe]) -> (Vec3, Vec3) {
    let at_axis = |lobe: &LightLobe| (lobes_radiance(lobes, lobe.axis), lobe.axis);
    brightest(lobes.iter().map(at_axis))
}

fn map_peak(map: &EnvironmentMap) -> (Vec3, Vec3) {
    let at = |k: usize| {
        let (i, j) = (k as u32 % map.width, k as u32 / map.width);
        (map.radiance[k], map.texel_direction(i, j))
    };
    brightest((0..map.radiance.len()).map(at))
}

fn brightest(radiances: impl Iterator<Item = (Vec3, Vec3)>) -> (Vec3, Vec3) {
    let brighter = |a: (Vec3, Vec3), b: (Vec3, Vec3)| if luminance(b.0) > luminance(a.0) { b } else { a };
    radiances.reduce(brighter).unwrap_or((Vec3::ZERO, Vec3::Y))
}

fn table(text: &mut String, lobes: &[LightLobe], lines: usize) {
    let total = luminous(lobes_power(lobes));
    let share = |l: &LightLobe| if total > 0.0 { 100.0 * luminous(l.power()) / total } else { 0.0 };
    let mut order: Vec<(usize, f64)> = lobes.iter().map(share).enumerate().collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1));
    let _ = writeln!(
        text,
        "  {:>4}  {:>6}  {:^24}  {:>9}  {:>10}  {:^29}",
        "lobe", "power", "axis x y z", "sharpness", "half-width", "amplitude r g b"
    );
    for (k, share) in order.iter().take(lines) {
        let lobe = &lobes[*k];
        let _ = writeln!(
            text,
            "  {k:>4}  {share:>5.1}%  {}  {:>9.2}  {:>9.1}°  {}",
            direction(lobe.axis),
            lobe.sharpness,
            half_width_degrees(lobe.sharpness),
            rgb(lobe.amplitude.as_dvec3())
        );
    }
    if order.len() > lines {
        let _ = writeln!(text, "  … and {} more (--all)", order.len() - lines);
    }
}

/// Angle from the axis at which an SG has half its peak, in degrees: cos = 1 − ln 2/λ; 180 where it nowhere falls so low.
fn half_width_degrees(sharpness: f32) -> f32 {
    (1.0 - std::f32::consts::LN_2 / sharpness).max(-1.0).acos().to_degrees()
}

fn direction(d: Vec3) -> String {
    format!("({:>6.3}, {:>6.3}, {:>6.3})", d.x, d.y, d.z)
}

fn rgb(v: DVec3) -> String {
    format!("{:>9.4} {:>9.4} {:>9.4}", v.x, v.y, v.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia::light::render_lobes;

    fn lobes() -> Vec<LightLobe> {
        let lobe = |axis, sharpness, gray| LightLobe { axis, sharpness, amplitude: Vec3::splat(gray) };
        vec![lobe(Vec3::Y, 1.0, 0.5), lobe(Vec3::X, 40.0, 9.0), lobe(Vec3::Z, 3.0, 0.0)]
    }

    #[test]
    fn info_says_what_is_there() {
        let text = info(&LightFile::Lobes(lobes()), false);
        assert!(text.contains("3 lobes, 2 of them not black"), "{text}");
        assert!(text.lines().any(|l| l.contains("peak") && l.contains("( 1.000,  0.000,  0.000)")), "{text}");
        let map = info(&LightFile::Map(render_lobes(&lobes(), 64, 32)), false);
        assert!(map.contains("64 × 32") && !map.contains("axis x y z"), "{map}");
        let black = info(&LightFile::Lobes(vec![lobes()[2]]), false);
        assert!(black.contains("it gives no light") && !black.contains("NaN"), "{black}");
        assert_eq!(half_width_degrees(0.0), 180.0);
        let cos = half_width_degrees(40.0).to_radians().cos();
        assert!(((40.0 * (cos - 1.0)).exp() - 0.5).abs() < 1e-4);
    }
}
