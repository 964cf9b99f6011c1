//! Draws the picture of `docs/src/conventions.md`: one light as a map of three programs, and a
//! mirror ball under it.
//!
//! `cargo run --release --example map_conventions` writes `out/examples/map_conventions.png`.

use image::{Rgb, RgbImage, imageops};
use lobelia::report::sheet::{draw_text, text_width};
use lobelia::{codec::png_file::write_rgb8, codec::tone::srgb8, ecs::*, prelude::*};

const MAP: (u32, u32) = (360, 180);
const MARGIN: u32 = 10;
const LINE: u32 = 22;
const INK: [u8; 3] = [40; 3];

/// The six directions of a world, each with its label and color.
const MARKS: [(Vec3, &str, Vec3); 6] = [
    (Vec3::X, "+X", Vec3::new(0.9, 0.1, 0.1)),
    (Vec3::NEG_X, "-X", Vec3::new(0.9, 0.6, 0.6)),
    (Vec3::Y, "+Y", Vec3::new(0.1, 0.7, 0.1)),
    (Vec3::NEG_Y, "-Y", Vec3::new(0.6, 0.85, 0.6)),
    (Vec3::Z, "+Z", Vec3::new(0.15, 0.2, 0.9)),
    (Vec3::NEG_Z, "-Z", Vec3::new(0.6, 0.65, 0.95)),
];

/// Discs of 20° around the six directions on a grid of 30°.
fn radiance(d: Vec3) -> Vec3 {
    if let Some((.., color)) = MARKS.iter().find(|(axis, ..)| d.angle_between(*axis) < 0.35) {
        return *color;
    }
    let (u, v) = EnvironmentMap::uv(d);
    let near_line = |angle: f32| ((angle / 30.0).round() * 30.0 - angle).abs() < 0.8;
    Vec3::splat(if near_line(360.0 * u) || near_line(180.0 * v) { 0.35 } else { 0.55 })
}

fn draw(size: (u32, u32), color: impl Fn(u32, u32) -> Vec3) -> RgbImage {
    RgbImage::from_fn(size.0, size.1, |x, y| Rgb(srgb8(color(x, y))))
}

fn map_picture(convention: MapConvention) -> RgbImage {
    let world = EnvironmentMap::from_directions(4 * MAP.0, 4 * MAP.1, radiance);
    let map = convention.from_lobelia(world).downsampled(MAP.0, MAP.1);
    let mut picture = draw(MAP, |x, y| map.radiance[(y * MAP.0 + x) as usize]);
    for (axis, label, _) in MARKS {
        let (u, v) = EnvironmentMap::uv(convention.turn().inverse() * axis);
        // A pole is a whole row: the label stands in the middle. The left edge is the right edge
        // too.
        let u = if (0.02..0.98).contains(&v) { u } else { 0.5 };
        let half = text_width(label, 2.0) / 2;
        let left = ((u * MAP.0 as f32) as u32).saturating_sub(half).clamp(2, MAP.0 - 2 * half - 2);
        let top = ((v * MAP.1 as f32) as u32).saturating_sub(8).clamp(4, MAP.1 - 20);
        let ink = if label.starts_with('-') { INK } else { [255; 3] };
        draw_text(&mut picture, [left, top], 2.0, ink, label);
    }
    picture
}

/// A mirror ball seen from +Z, +X to the right and +Y up.
fn mirror_ball() -> RgbImage {
    let (size, scale) = (MAP.1, 2.0 / MAP.1 as f32);
    draw((size, size), |i, j| {
        let (x, y) = ((i as f32 + 0.5) * scale - 1.0, 1.0 - (j as f32 + 0.5) * scale);
        let square = x * x + y * y;
        if square > 0.95 {
            return Vec3::ONE;
        }
        let normal = Vec3::new(x, y, (1.0 - square).sqrt());
        radiance(2.0 * normal.z * normal - Vec3::Z)
    })
}

fn main() -> Result<()> {
    let rows = [
        (MapConvention::Lobelia, "Lobelia, Mitsuba: +Y up"),
        (MapConvention::ThreeJs, "ThreeJs, BlenderYUp: +Y up"),
        (MapConvention::Blender, "Blender: +Z up"),
    ];
    let step = MAP.1 + LINE + MARGIN;
    let mut sheet = RgbImage::from_pixel(MAP.0 + MAP.1 + 3 * MARGIN, 3 * step + MARGIN, Rgb([255; 3]));
    for (k, (convention, title)) in (0..).zip(rows) {
        let top = MARGIN + k * step;
        draw_text(&mut sheet, [MARGIN, top], 2.0, INK, title);
        imageops::replace(&mut sheet, &map_picture(convention), i64::from(MARGIN), i64::from(top + LINE));
    }
    let left = MAP.0 + 2 * MARGIN;
    draw_text(&mut sheet, [left, MARGIN], 2.0, INK, "a mirror ball");
    imageops::replace(&mut sheet, &mirror_ball(), i64::from(left), i64::from(MARGIN + LINE));
    for (k, line) in (0..).zip(["under each map,", "seen from +Z,", "+X right, +Y up"]) {
        draw_text(&mut sheet, [left, MARGIN + LINE + MAP.1 + 8 + k * LINE], 2.0, INK, line);
    }
    write_rgb8("out/examples/map_conventions.png", &sheet)?;
    println!("out/examples/map_conventions.png");
    Ok(())
}
