//! The memory that a run may take: known before it begins, and kept by smaller pools or refused.

use crate::error::{Error, Result};
use crate::pass::memory_limits::machine_memory;
use crate::pass::progress::Progress;
use crate::scene::{Pass, Scene};
use crate::survey::estimate::{Estimate, Workers, estimate, memory};
use crate::survey::look::ViewLook;
use std::borrow::Cow;

/// Share of the memory that a process may have which a run takes if nothing else is said.
const USUAL_SHARE: f64 = 0.75;
/// Fewest pixels of a pool: below, fits become poor.
pub(crate) const LEAST_PIXELS: u32 = 200_000;

/// What a run takes where nothing is said: three quarters of the memory that the machine lets a process have, in bytes; `None` if that is unknown.
pub fn usual_budget() -> Option<u64> {
    machine_memory().map(|bytes| (bytes as f64 * USUAL_SHARE) as u64)
}

/// Bytes of "8GiB", "500 MB", "1.5g" or a plain number; `Err` says what is expected.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let text = text.trim().to_ascii_lowercase();
    let digits = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let (number, unit) = (text[..digits].trim(), &text[digits..]);
    let factor: f64 = match unit {
        "" | "b" => 1.0,
        "kib" => 1024.0,
        "mib" | "m" => 1048576.0,
        "gib" | "g" => 1073741824.0,
        "tib" | "t" => 1099511627776.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        _ => 0.0,
    };
    let bytes = number.parse::<f64>().unwrap_or(f64::NAN) * factor;
    if (1e6..1e18).contains(&bytes) {
        Ok(bytes as u64)
    } else {
        Err("give an amount such as 8GiB or 500MiB".to_owned())
    }
}

/// The scene as each of some `processes` keeps to a budget of `bytes`, with these views: the same if it does, else with smaller pools, which a note tells.
///
/// # Errors
/// [`Error::Usage`] with the memory that would do, if the smallest pools take too much.
pub fn within<'a>(
    scene: &'a Scene,
    looks: &[ViewLook],
    bytes: Option<u64>,
    processes: usize,
    progress: &dyn Progress,
) -> Result<Cow<'a, Scene>> {
    let Some(budget) = bytes.map(|bytes| bytes as f64) else { return Ok(Cow::Borrowed(scene)) };
    let needs_of = |scene: &Scene, processes| estimate(looks, scene, Workers { threads: 1, processes });
    // As many pixels as one process would take, so that results do not depend on the number of processes; unless one could not do it at all.
    let can_alone = needs_of(&with_pools(scene, LEAST_PIXELS), 1).bytes() <= budget;
    let processes = if can_alone { 1 } else { processes };
    let needs = |scene: &Scene| needs_of(scene, processes);
    let full = needs(scene);
    if full.bytes() <= budget {
        return Ok(Cow::Borrowed(scene));
    }
    let least = with_pools(scene, LEAST_PIXELS);
    if needs(&least).bytes() > budget {
        return Err(too_little(&full, &needs(&least), budget));
    }
    // The most pixels, to a thousandth, with which the estimate keeps to the budget.
    let (mut low, mut high) = (LEAST_PIXELS, u32::MAX);
    while high - low > low / 1000 {
        let middle = low + (high - low) / 2;
        if needs(&with_pools(scene, middle)).bytes() <= budget { low = middle } else { high = middle }
    }
    progress.note(&format!(
        "this run would take about {}; to keep to {}, pools have at most {low} pixels (--memory allows more)",
        memory(full.bytes()),
        memory(budget)
    ));
    Ok(Cow::Owned(with_pools(scene, low)))
}

fn too_little(full: &Estimate, least: &Estimate, budget: f64) -> Error {
    let most = least.parts.iter().max_by(|a, b| a.bytes.total_cmp(&b.bytes));
    let most = most.map_or(String::new(), |part| format!(", most of it for {}", part.what));
    let problem = format!(
        "this run takes about {}, and {} with the smallest pools{most}; {} are allowed",
        memory(full.bytes()),
        memory(least.bytes()),
        memory(budget)
    );
    let help = format!(
        "Allow more with `--memory {:.1}GiB`, or make it smaller: `--set views.downscale=2`, a smaller `texture_size`, \
         fewer `directions` of `visibility`.",
        (least.bytes() / f64::from(1 << 30)).max(0.1) + 0.05
    );
    Error::usage(problem, help)
}

/// The scene with no pool above this many pixels.
fn with_pools(scene: &Scene, most: u32) -> Scene {
    let mut scene = scene.clone();
    for pass in &mut scene.passes {
        match pass {
            Pass::Fit(fit) => fit.max_pixels = fit.max_pixels.min(most),
            Pass::Shape(shape) => shape.max_pixels = shape.max_pixels.min(most),
            _ => {}
        }
    }
    scene
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pass::progress::Silent;
    use crate::scene::{LoadOptions, load};

    #[test]
    fn amounts_are_read_with_any_usual_unit() {
        let read = |text| parse_bytes(text).unwrap();
        assert_eq!((read("8GiB"), read("8 g"), read("500MB")), (8 << 30, 8 << 30, 500_000_000));
        assert_eq!((read("1.5GiB"), read("2000000")), (3 << 29, 2_000_000));
        for wrong in ["", "8", "GiB", "-1GiB", "8 elephants", "nanGiB", "1e30GiB", "infGiB"] {
            assert!(parse_bytes(wrong).unwrap_err().contains("8GiB"), "{wrong}");
        }
    }

    #[test]
    fn a_budget_is_kept_or_refused_whatever_the_views_are() {
        let scene = |size: u32, texture: u32| {
            let text = format!(
                "Scene(version: 1, surface: Sphere(radius: 0.8, texture_size: {texture}), views: Cameras([(name: \"a\", eye: (0, 0, 3), \
                 width: {size}, height: {size})]), visibility: Traced(directions: 1024), \
                 light: Fixed(Lobes(lobes: [(axis: (0, 1, 0), sharpness: 5, amplitude: (1, 1, 1))])), \
                 material: (albedo: Fixed(Constant(0.5, 0.5, 0.5)), specular: (albedo: Fixed(0.2, 0.2, 0.2), roughness: Fixed(0.3))), \
                 passes: [Render(name: \"novel\")])"
            );
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("scene.ron");
            std::fs::write(&path, text).unwrap();
            load(&path, &LoadOptions::default()).unwrap().scene
        };
        let refused = |scene: &Scene, budget: u64| {
            let looks = crate::pass::looks(scene, None).unwrap();
            within(scene, &looks, Some(budget), 1, &Silent).err().map(|error| error.to_string())
        };
        assert_eq!(refused(&scene(64, 64), 300 << 20), None);
        let said = refused(&scene(64, 1024), 300 << 20).unwrap();
        assert!(said.contains("most of it for texels") && said.contains("300 MiB are allowed"), "{said}");
        assert_eq!(refused(&scene(64, 1024), 8 << 30), None);
    }
}
