//! The memory that this machine lets a process have: what is built in, less what its control groups and its own address space are
//! limited to. Only Linux says it, in text files.

use std::fs::read_to_string;
use std::path::{Path, PathBuf};

/// The text files that say it, and the folders of control groups of version 2 and 1.
struct Places<'a> {
    processes: &'a Path,
    groups: [&'a Path; 2],
}

/// The least of all limits, in bytes; `None` if the memory of the machine is unknown.
pub(crate) fn machine_memory() -> Option<u64> {
    let groups = ["/sys/fs/cgroup", "/sys/fs/cgroup/memory"].map(Path::new);
    least_limit(&Places { processes: Path::new("/proc"), groups })
}

fn least_limit(places: &Places) -> Option<u64> {
    let total = total_of(&read_to_string(places.processes.join("meminfo")).ok()?)?;
    let own = |file: &str| read_to_string(places.processes.join("self").join(file)).unwrap_or_default();
    let space = address_space_of(&own("limits"));
    let groups = group_files(&own("cgroup"), places.groups);
    let of_groups = groups.iter().filter_map(|file| read_to_string(file).ok()?.trim().parse::<u64>().ok());
    Some(of_groups.chain(space).fold(total, u64::min))
}

/// `MemTotal` of `/proc/meminfo`, in bytes.
fn total_of(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

/// The soft limit of the address space in `/proc/self/limits` (`ulimit -v`), in bytes; `None` if it is unlimited.
fn address_space_of(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// The files with the limits of the groups in `/proc/self/cgroup` and of all groups that these are in. A container sees its own group as
/// the uppermost.
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{create_dir_all, write};

    const TOTAL: &str = "MemTotal:       24607004 kB\nMemFree: 1 kB\n";

    #[test]
    fn the_machines_memory_is_read() {
        assert_eq!(total_of(TOTAL), Some(24607004 * 1024));
        assert_eq!(total_of("nothing"), None);
    }

    #[test]
    fn the_address_space_may_be_limited() {
        let limits = "Limit                     Soft Limit           Hard Limit           Units\n\
                      Max data size             unlimited            unlimited            bytes\n\
                      Max address space         2147483648           unlimited            bytes\n";
        assert_eq!(address_space_of(limits), Some(2 << 30));
        assert_eq!(address_space_of(&limits.replace("2147483648", "unlimited ")), None);
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
        let found = || least_limit(&Places { processes: &processes, groups: [&unified, &memory] });
        assert_eq!(found(), None);
        put("proc/meminfo", TOTAL);
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
