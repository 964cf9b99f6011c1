//! Light both ways: SG lobes drawn as an environment map, the map fitted by lobes again, and how
//! much was lost.
//!
//! `cargo run --release --example render_env_lobes` writes two pictures under `out/examples/`.

use image::{Rgb, RgbImage};
use lobelia::{codec::png_file::write_rgb8, codec::tone::srgb8, ecs::*, prelude::*};

fn main() -> Result<()> {
    let lobe = |axis: [f32; 3], sharpness, amplitude: [f32; 3]| LightLobe {
        axis: Vec3::from(axis).normalize(),
        sharpness,
        amplitude: amplitude.into(),
    };
    let lobes = [
        lobe([0.0, 1.0, 0.0], 1.0, [0.3, 0.4, 0.6]),
        lobe([0.5, 0.6, 0.6], 60.0, [4.0, 3.4, 2.4]),
        lobe([-0.9, 0.1, 0.3], 12.0, [0.8, 0.3, 0.2]),
        lobe([0.2, -0.3, -0.9], 25.0, [0.2, 0.5, 0.3]),
    ];
    let map = render_lobes(&lobes, 128, 64);
    write("render_env_lobes_given", &map)?;

    for count in [2, 3, 4] {
        let report = fit_map(&map, count, &MapFit::default())?;
        let relative = (report.mse / report.mean_square).sqrt();
        let [r, g, b] = report.power_ratio;
        println!("{count} lobes: relative error {relative:.2e}, power kept {r:.4} {g:.4} {b:.4}");
        if count == 4 {
            write("render_env_lobes_fitted", &render_lobes(&report.lobes, map.width, map.height))?;
        }
    }
    Ok(())
}

fn write(name: &str, map: &EnvironmentMap) -> Result<()> {
    let path = format!("out/examples/{name}.png");
    let texel = |x: u32, y: u32| Rgb(srgb8(map.radiance[(y * map.width + x) as usize]));
    write_rgb8(&path, &RgbImage::from_fn(map.width, map.height, texel))?;
    println!("{path}");
    Ok(())
}
