//! Tells the command its version, with the commit it is built from: `0.1.0 (abcdef123 2026-11-21)`.
//! Without git, or apart from this repository (in a package, say), it is the version alone. Strips
//! symbols of programs that are installed.

use std::{env, path::Path, process::Command};

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let version = env!("CARGO_PKG_VERSION");
    let version = match commit() {
        Some(commit) => format!("{version} ({commit})"),
        None => version.to_owned(),
    };
    println!("cargo::rustc-env=LOBELIA_VERSION={version}");
    // Cargo does not strip symbols of a package that has an `opt-level` of its own.
    let is = |name: &str, value: &str| env::var(name).is_ok_and(|is| is == value);
    if is("PROFILE", "release") && is("DEBUG", "false") && is("CARGO_CFG_TARGET_OS", "linux") {
        println!("cargo::rustc-link-arg-bins=-Wl,--strip-all");
    }
}

/// Short hash and date of the commit that is checked out.
fn commit() -> Option<String> {
    // A package may lie in somebody else's repository.
    if !Path::new("../../.git").exists() {
        return None;
    }
    // Every commit, checkout and reset writes the second, and nothing else does.
    for file in ["HEAD", "logs/HEAD"] {
        // Cargo would run this at every build if it were to watch a file that is missing.
        if let Some(path) = git(&["rev-parse", "--git-path", file]).filter(|path| Path::new(path).exists()) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    git(&["log", "-1", "--format=%h %cs", "--abbrev=9"])
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let text = text.trim();
    (output.status.success() && !text.is_empty()).then(|| text.to_owned())
}
