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

/// Processes that carry out one run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sharing {
    /// How many they are; at least one.
    pub processes: usize,
    /// How many of them divide the memory, those of one machine; at least one.
    pub of_memory: usize,
}

impl Sharing {
    /// One process that has all of the memory.
    pub const ALONE: Self = Self { processes: 1, of_memory: 1 };
}

/// The scene as each of the processes keeps to its part of `bytes`, with these views: the same if it does, else with smaller pools, which a note tells. Pools are those that
/// one process would have with all of `bytes`, so that results do not depend on the number of processes, unless these are too large for the part of each.
///
/// # Errors
/// [`Error::Usage`] with the memory that would do, if the smallest pools take too much.
pub fn within<'a>(
    scene: &'a Scene,
    looks: &[ViewLook],
    bytes: Option<u64>,
    sharing: Sharing,
    progress: &dyn Progress,
) -> Result<Cow<'a, Scene>> {
    let Some(bytes) = bytes.map(|bytes| bytes as f64) else { return Ok(Cow::Borrowed(scene)) };
    let alone = Budget { looks, processes: 1, bytes };
    let of_each = bytes / sharing.of_memory.max(1) as f64;
    let each = Budget { looks, processes: sharing.processes.max(1), bytes: of_each };
    let (by, most) = match alone.most_pixels(scene) {
        Some(most) if each.holds(&with_pools(scene, most)) => (&alone, most),
        _ => (&each, each.most_pixels(scene).ok_or_else(|| each.too_little(scene))?),
    };
    if most == u32::MAX {
        return Ok(Cow::Borrowed(scene));
    }
    let in_one = if by.processes < each.processes { " in one process" } else { "" };
    progress.note(&format!(
        "this run would take about {}{in_one}; to keep to {}, pools have at most {most} pixels (--memory allows more)",
        memory(by.needs(scene).bytes()),
        memory(by.bytes)
    ));
    Ok(Cow::Owned(with_pools(scene, most)))
}

/// Memory that each process of a run may take.
struct Budget<'a> {
    looks: &'a [ViewLook],
    processes: usize,
    bytes: f64,
}

impl Budget<'_> {
    fn needs(&self, scene: &Scene) -> Estimate {
        estimate(self.looks, scene, Workers { threads: 1, processes: self.processes })
    }

    fn holds(&self, scene: &Scene) -> bool {
        self.needs(scene).bytes() <= self.bytes
    }

    /// The most pixels of a pool, to a thousandth, with which a run keeps to it: `u32::MAX` if pools may be as the scene says, `None` if the smallest take too much.
    fn most_pixels(&self, scene: &Scene) -> Option<u32> {
        if self.holds(scene) {
            return Some(u32::MAX);
        }
        let (mut low, mut high) = (LEAST_PIXELS, u32::MAX);
        if !self.holds(&with_pools(scene, low)) {
            return None;
        }
        while high - low > low / 1000 {
            let middle = low + (high - low) / 2;
            if self.holds(&with_pools(scene, middle)) { low = middle } else { high = middle }
        }
        Some(low)
    }

    fn too_little(&self, scene: &Scene) -> Error {
        too_little(&self.needs(scene), &self.needs(&with_pools(scene, LEAST_PIXELS)), self.bytes)
    }
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
         fewer `directions` of `visibility`, fewer `cells` of the last of the `levels` of a `Shape`.",
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
    use crate::scene::{FitPass, LoadOptions, load};
    use crate::survey::look::RadianceStatistics;
    use crate::view::Split;

    #[test]
    fn amounts_are_read_with_any_usual_unit() {
        let read = |text| parse_bytes(text).unwrap();
        assert_eq!((read("8GiB"), read("8 g"), read("500MB")), (8 << 30, 8 << 30, 500_000_000));
        assert_eq!((read("1.5GiB"), read("2000000")), (3 << 29, 2_000_000));
        for wrong in ["", "8", "GiB", "-1GiB", "8 elephants", "nanGiB", "1e30GiB", "infGiB"] {
            assert!(parse_bytes(wrong).unwrap_err().contains("8GiB"), "{wrong}");
        }
    }

    /// A fit to 24 photographs of 1024² pixels, and what is known of them.
    fn fit_of_many() -> (Scene, Vec<ViewLook>) {
        let camera = |i| format!("(name: \"{i}\", eye: (0, 0, 3), width: 1024, height: 1024)");
        let cameras: Vec<String> = (0..24).map(camera).collect();
        let text = format!(
            "Scene(version: 1, surface: Sphere(texture_size: 64), views: Cameras([{}]), \
             light: Fixed(Lobes(lobes: [(axis: (0, 1, 0), sharpness: 5, amplitude: (1, 1, 1))])), \
             material: (albedo: Fixed(Constant(0.5, 0.5, 0.5)), specular: (albedo: Fixed(0.2, 0.2, 0.2), roughness: Fixed(0.3))), \
             passes: [Render(name: \"novel\")])",
            cameras.join(", ")
        );
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.ron");
        std::fs::write(&path, text).unwrap();
        let mut scene = load(&path, &LoadOptions::default()).unwrap().scene;
        let mut looks = crate::pass::looks(&scene, None).unwrap().into_owned();
        for look in &mut looks {
            (look.split, look.light) = (Split::Train, Some(RadianceStatistics::default()));
        }
        scene.passes = vec![Pass::Fit(FitPass::default())];
        (scene, looks)
    }

    #[test]
    fn pools_are_those_of_one_process_wherever_they_fit() {
        let (scene, looks) = fit_of_many();
        let usual = FitPass::default().max_pixels;
        let full = estimate(&looks, &scene, Workers::threads(1)).bytes();
        let pools = |part: f64, processes: usize, of_memory: usize| {
            let sharing = Sharing { processes, of_memory };
            let found = within(&scene, &looks, Some((part * full) as u64), sharing, &Silent).unwrap();
            let Pass::Fit(fit) = &found.passes[0] else { panic!("{:?}", found.passes) };
            fit.max_pixels
        };
        let alone = pools(0.8, 1, 1);
        assert!((LEAST_PIXELS..usual).contains(&alone), "{alone}");
        assert_eq!((pools(1.1, 1, 1), pools(1.1, 3, 1), pools(2.2, 2, 2)), (usual, usual, usual));
        assert_eq!(pools(0.8, 3, 1), alone, "on machines of their own");
        // One process would have all its pixels, and two cannot.
        assert!(pools(1.1, 2, 2) < usual);
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
            within(scene, &looks, Some(budget), Sharing::ALONE, &Silent).err().map(|error| error.to_string())
        };
        assert_eq!(refused(&scene(64, 64), 300 << 20), None);
        let said = refused(&scene(64, 1024), 300 << 20).unwrap();
        assert!(said.contains("most of it for texels") && said.contains("300 MiB are allowed"), "{said}");
        assert_eq!(refused(&scene(64, 1024), 8 << 30), None);
    }
}
