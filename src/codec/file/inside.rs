//! Whether what is read lies in the folders that a run is confined to.

use super::apart::{FileUse, lies_in};
use crate::{Error, Result};
use std::path::{Component, Path, PathBuf};

/// What a link counts as that lies in one of the folders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Links {
    /// What it leads to.
    Followed,
    /// A file of the folder, wherever it leads: whoever made the folder made the link.
    Trusted,
}

/// Checks that a file lies in one of the folders `roots`. What does not exist counts by its spelling.
///
/// # Errors
/// [`Error::Usage`] that names the file and its use.
pub(crate) fn check_inside(roots: &[PathBuf], input: &FileUse, links: Links) -> Result<()> {
    let path = &input.path;
    let by_spelling = || roots.iter().any(|root| spelled(path).starts_with(spelled(root)));
    let trusts_spelling = links == Links::Trusted || path.canonicalize().is_err();
    if roots.iter().any(|root| lies_in(path, root)) || (trusts_spelling && by_spelling()) {
        return Ok(());
    }
    let problem =
        format!("{}, {}, is outside the folder of the scene file and --data", path.display(), input.by);
    Err(Error::usage(
        problem,
        "Say --data with a folder that it is in, or --allow-outside to read it all the same.",
    ))
}

/// An absolute path without `.` and `..`, by its words alone.
fn spelled(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in std::path::absolute(path).unwrap_or_default().components() {
        match part {
            Component::ParentDir => drop(plain.pop()),
            Component::CurDir => {}
            part => plain.push(part),
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn is_inside(path: &Path, root: &Path, links: Links) -> bool {
        check_inside(&[root.to_owned()], &FileUse::new(path, "a light"), links).is_ok()
    }

    #[test]
    fn files_count_by_where_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("mine/sub")).unwrap();
        for name in ["mine/a.npy", "b.npy"] {
            fs::write(at(name), "x").unwrap();
        }
        for links in [Links::Followed, Links::Trusted] {
            let inside = |name: &str| is_inside(&at(name), &at("mine"), links);
            assert!(inside("mine/a.npy") && inside("mine/sub/../a.npy") && inside("mine/none.npy"));
            assert!(!inside("b.npy") && !inside("mine/../b.npy") && !inside("mine/../none.npy"));
        }
        let error = check_inside(&[at("mine")], &FileUse::new(at("b.npy"), "a light"), Links::Trusted);
        let error = error.unwrap_err();
        assert!(
            error.to_string().contains("b.npy, a light, is outside") && error.exit_code() == 2,
            "{error}"
        );
    }

    #[cfg(unix)]
    #[test]
    fn links_count_by_what_they_lead_to_unless_they_are_trusted() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("mine")).unwrap();
        fs::write(at("b.npy"), "x").unwrap();
        symlink(at("b.npy"), at("mine/link.npy")).unwrap();
        symlink(folder.path(), at("mine/up")).unwrap();
        symlink(at("mine"), at("other")).unwrap();
        for name in ["mine/link.npy", "mine/up/b.npy"] {
            assert!(!is_inside(&at(name), &at("mine"), Links::Followed), "{name}");
            assert!(is_inside(&at(name), &at("mine"), Links::Trusted), "{name}");
        }
        fs::write(at("mine/a.npy"), "x").unwrap();
        assert!(is_inside(&at("other/a.npy"), &at("mine"), Links::Followed));
        assert!(is_inside(&at("mine/a.npy"), &at("other"), Links::Followed));
    }
}
