//! The memory that a run may take: known before it begins, and kept by smaller pools or refused;
//! and the machine that it works on.

use crate::survey::{counted, estimate::estimate, estimate::memory};
use crate::{progress::Progress, scene::Pass, scene::Scene};
use lobelia_geometry::error::{Error, Result};
use lobelia_geometry::view::look::ViewLook;
use lobelia_sg::lanes::level_name;
use serde::{Deserialize, Serialize};
use std::{borrow::Cow, fs::read_to_string, path::Path, path::PathBuf};

/// Fewest pixels of a pool: below, fits become poor.
pub(crate) const LEAST_PIXELS: u32 = 200_000;

/// Returns the default memory of a run: three quarters of the memory that the machine lets a
/// process have, in bytes; `None` if that is unknown.
pub fn usual_budget() -> Option<u64> {
    machine_memory().map(|bytes| (bytes as f64 * 0.75) as u64)
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
    let is_usual = (1e6..1e18).contains(&bytes);
    is_usual.then_some(bytes as u64).ok_or_else(|| "give an amount such as 8GiB or 500MiB".to_owned())
}

/// The scene as it keeps to `bytes` of memory with these views: the same if it does, else with
/// smaller pools, which a note tells.
///
/// # Errors
/// [`Error::Usage`] with the memory that would do, if the smallest pools take too much.
pub fn within<'a>(
    scene: &'a Scene,
    looks: &[ViewLook],
    bytes: Option<u64>,
    progress: &dyn Progress,
) -> Result<Cow<'a, Scene>> {
    let Some(bytes) = bytes.map(|bytes| bytes as f64) else { return Ok(Cow::Borrowed(scene)) };
    let full = estimate(looks, scene, 1);
    if full.bytes() <= bytes {
        return Ok(Cow::Borrowed(scene));
    }
    let holds = |most: u32| estimate(looks, &with_pools(scene, most), 1).bytes() <= bytes;
    let (mut low, mut high) = (LEAST_PIXELS, u32::MAX);
    if !holds(low) {
        let least = estimate(looks, &with_pools(scene, low), 1).bytes();
        let most = full.parts.iter().max_by(|a, b| a.bytes.total_cmp(&b.bytes));
        let most = most.map_or(String::new(), |part| format!(", most of it for {}", part.what));
        let problem = format!(
            "this run takes about {}, and {} with the smallest pools{most}; {} are allowed",
            memory(full.bytes()),
            memory(least),
            memory(bytes)
        );
        let help = format!(
            "Allow more with `--memory {:.1}GiB`, or make it smaller: `--set views.downscale=2`, a smaller \
             `texture_size`, fewer `directions` of `visibility`, fewer `cells` of the last of the `levels` of a `Shape`.",
            (least / f64::from(1 << 30)).max(0.1) + 0.05
        );
        return Err(Error::usage(problem, help));
    }
    // To a thousandth.
    while high - low > low / 1000 {
        let middle = low + (high - low) / 2;
        if holds(middle) { low = middle } else { high = middle }
    }
    progress.note(&format!(
        "this run would take about {}; to keep to {}, pools have at most {low} pixels (--memory allows more)",
        memory(full.bytes()),
        memory(bytes)
    ));
    Ok(Cow::Owned(with_pools(scene, low)))
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

/// The memory that this machine lets a process have, in bytes: what is built in, less what its
/// control groups and its own address space are limited to. Only Linux says it, in text files;
/// `None` if the memory of the machine is unknown.
fn machine_memory() -> Option<u64> {
    let groups = ["/sys/fs/cgroup", "/sys/fs/cgroup/memory"].map(Path::new);
    least_limit(Path::new("/proc"), groups)
}

/// The least limit that the files of processes and the folders of control groups of version 2 and 1
/// say.
fn least_limit(processes: &Path, groups: [&Path; 2]) -> Option<u64> {
    let total = read_to_string(processes.join("meminfo")).ok()?;
    let total = total.lines().find_map(|line| line.strip_prefix("MemTotal:"))?.trim().strip_suffix("kB")?;
    let total = total.trim().parse::<u64>().ok()? * 1024;
    let own = |file: &str| read_to_string(processes.join("self").join(file)).unwrap_or_default();
    // The soft limit of the address space (`ulimit -v`); no number if it is unlimited.
    let limits = own("limits");
    let space = limits.lines().find_map(|line| line.strip_prefix("Max address space"));
    let space = space.and_then(|line| line.split_whitespace().next()?.parse().ok());
    let groups = group_files(&own("cgroup"), groups);
    let of_groups = groups.iter().filter_map(|file| read_to_string(file).ok()?.trim().parse::<u64>().ok());
    Some(of_groups.chain(space).fold(total, u64::min))
}

/// The files with the limits of the groups in `/proc/self/cgroup` and of all groups that these are
/// in. A container sees its own group as the uppermost.
fn group_files(text: &str, [unified, memory]: [&Path; 2]) -> Vec<PathBuf> {
    let mut files = vec![unified.join("memory.max"), memory.join("memory.limit_in_bytes")];
    for line in text.lines() {
        let mut parts = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(group)) = (parts.next(), parts.next()) else { continue };
        let group = Path::new(group.trim_start_matches('/'));
        let (root, file) = match controllers {
            "" => (unified, "memory.max"),
            names if names.split(',').any(|name| name == "memory") => (memory, "memory.limit_in_bytes"),
            _ => continue,
        };
        files.extend(group.ancestors().map(|group| root.join(group).join(file)));
    }
    files
}

/// Machine of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Machine {
    /// Operating system and architecture: "linux x86_64".
    pub system: String,
    /// The processor's name; `None` where the system does not say it.
    pub processor: Option<String>,
    /// Instruction set of the kernels.
    pub simd: String,
    /// Worker threads.
    pub threads: usize,
    /// Memory in MiB, or what the container is limited to; `None` where the system does not say it.
    pub memory_mib: Option<u64>,
}

impl Machine {
    /// This machine, with the threads that rayon has.
    pub fn this() -> Self {
        let text = read_to_string("/proc/cpuinfo").unwrap_or_default();
        let line = text.lines().find(|line| line.starts_with("model name")).and_then(|of| of.split_once(':'));
        let processor = line.map(|(_, name)| name.split_whitespace().collect::<Vec<_>>().join(" "));
        Self {
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            processor: processor.filter(|name| !name.is_empty()),
            simd: level_name().to_owned(),
            threads: rayon::current_num_threads(),
            memory_mib: machine_memory().map(|bytes| bytes >> 20),
        }
    }

    /// "AMD EPYC 9354P, 2 threads, avx2, 15.6 GiB, linux x86_64".
    pub fn words(&self) -> String {
        let (threads, simd) = (Some(counted(self.threads, "thread")), Some(self.simd.clone()));
        let memory = self.memory_mib.map(|mib| format!("{:.1} GiB", mib as f64 / 1024.0));
        let parts = [self.processor.clone(), threads, simd, memory];
        let parts = parts.into_iter().flatten().chain([self.system.clone()]);
        parts.collect::<Vec<_>>().join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{progress::Silent, scene::LoadOptions, scene::load::read};
    use std::fs::{create_dir_all, write};

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
            read(text, Path::new("scene.ron"), &LoadOptions::default()).unwrap().scene
        };
        let refused = |scene: &Scene, budget: u64| {
            let looks = crate::pass::looks(scene, None).unwrap();
            within(scene, &looks, Some(budget), &Silent).err().map(|error| error.to_string())
        };
        assert_eq!(refused(&scene(64, 64), 300 << 20), None);
        let said = refused(&scene(64, 1024), 300 << 20).unwrap();
        assert!(said.contains("most of it for texels") && said.contains("300 MiB are allowed"), "{said}");
        assert_eq!(refused(&scene(64, 1024), 8 << 30), None);
    }

    #[test]
    fn the_least_limit_of_all_groups_counts() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let put = |name: &str, text: &str| {
            create_dir_all(at(name).parent().unwrap()).unwrap();
            write(at(name), text).unwrap();
        };
        let (processes, unified, memory) = (at("proc"), at("unified"), at("memory"));
        let found = || least_limit(&processes, [&unified, &memory]);
        assert_eq!(found(), None);
        put("proc/meminfo", "MemTotal:       24607004 kB\nMemFree: 1 kB\n");
        assert_eq!(found(), Some(24607004 * 1024));
        put("proc/self/cgroup", "12:cpu:/ignored\n4:hugetlb,memory:/job/step\n0::/slice/run.scope\n");
        put("unified/slice/run.scope/memory.max", "max\n");
        put("unified/slice/memory.max", "9000000000\n");
        assert_eq!(found(), Some(9_000_000_000));
        put("memory/job/memory.limit_in_bytes", "8000000000\n");
        assert_eq!(found(), Some(8_000_000_000));
        put("unified/memory.max", "7000000000\n");
        assert_eq!(found(), Some(7_000_000_000));
        put("memory/ignored/memory.limit_in_bytes", "5\n");
        put("proc/self/limits", "Max address space 6000000000 unlimited bytes\n");
        assert_eq!(found(), Some(6_000_000_000));
    }
}
