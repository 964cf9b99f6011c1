//! The machine that a run works on, for its record.

use crate::math::lanes::level_name;
use crate::pass::memory_limits::machine_memory;
use serde::{Deserialize, Serialize};
use std::fs::read_to_string;

/// What a run works on.
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
        Self {
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            processor: read_to_string("/proc/cpuinfo").ok().and_then(|text| processor_in(&text)),
            simd: level_name().to_owned(),
            threads: rayon::current_num_threads(),
            memory_mib: machine_memory().map(|bytes| bytes >> 20),
        }
    }

    /// "AMD EPYC 9354P, 2 threads, avx2, 15.6 GiB, linux x86_64".
    pub fn words(&self) -> String {
        let threads =
            if self.threads == 1 { "1 thread".to_owned() } else { format!("{} threads", self.threads) };
        let memory = self.memory_mib.map(|mib| format!("{:.1} GiB", mib as f64 / 1024.0));
        let parts = [self.processor.clone(), Some(threads), Some(self.simd.clone()), memory];
        let parts = parts.into_iter().flatten().chain([self.system.clone()]);
        parts.collect::<Vec<_>>().join(", ")
    }
}

/// The first "model name" of `/proc/cpuinfo`.
fn processor_in(text: &str) -> Option<String> {
    let line = text.lines().find_map(|line| line.strip_prefix("model name"))?;
    let name = line.split_once(':')?.1.split_whitespace().collect::<Vec<_>>().join(" ");
    (!name.is_empty()).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_is_told_in_one_line() {
        let name = processor_in("processor\t: 0\nmodel name\t: AMD  EPYC 9354P\nmodel name\t: other\n");
        assert_eq!(name.as_deref(), Some("AMD EPYC 9354P"));
        assert_eq!(processor_in("Hardware : BCM\n"), None);
        assert_eq!(processor_in("model name :\n"), None);
        let machine =
            Machine { threads: 1, simd: "avx2".into(), system: "linux x86_64".into(), ..Machine::default() };
        assert_eq!(machine.words(), "1 thread, avx2, linux x86_64");
        assert!(Machine::this().threads > 0);
    }
}
