//! Help for wrong names: similar names that exist, and the contents of a folder.

use crate::codec::file::folder_of;
use std::{cmp::Ordering, path::Path};

/// Natural order of names: runs of digits compare as numbers, so that `r_2` comes before `r_10`.
pub fn natural_order(a: &str, b: &str) -> Ordering {
    fn runs(text: &str) -> impl Iterator<Item = &[u8]> {
        text.as_bytes().chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit())
    }
    let by_value = |(a, b): (&[u8], &[u8])| {
        if !(a[0].is_ascii_digit() && b[0].is_ascii_digit()) {
            return a.cmp(b);
        }
        let [a, b] = [a, b].map(|run| &run[run.iter().take_while(|digit| **digit == b'0').count()..]);
        a.len().cmp(&b.len()).then_with(|| a.cmp(b))
    };
    let order = runs(a).zip(runs(b)).map(by_value).find(|order| order.is_ne());
    // Names that differ by leading zeros only ("r_1", "r_01") still need a definite order.
    order.unwrap_or_else(|| runs(a).count().cmp(&runs(b).count()).then_with(|| a.cmp(b)))
}

/// Up to three of `candidates` that are similar to `name`, closest first.
pub fn closest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    // No file or view has so long a name, and comparing takes time in proportion to the length.
    if name.len() > 1000 {
        return Vec::new();
    }
    let limit = 2 + name.chars().count() / 4;
    let lower = name.to_ascii_lowercase();
    let mut scored: Vec<(usize, &str)> = candidates
        .into_iter()
        .map(|candidate| (strsim::levenshtein(&lower, &candidate.to_ascii_lowercase()), candidate))
        .filter(|&(distance, _)| distance <= limit)
        .collect();
    scored.sort_by(|a, b| a.0.cmp(&b.0).then_with(|| natural_order(a.1, b.1)));
    scored.into_iter().take(3).map(|(_, candidate)| candidate).collect()
}

/// Help for a missing `path`: similar names, or how much its folder holds, or the part of the path
/// that is missing.
pub fn missing_file_help(path: &Path) -> String {
    let folder = folder_of(path);
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::PermissionDenied => {
            return format!("The folder {} may not be read: `chmod u+rx` allows it.", folder.display());
        }
        Err(_) => {
            let existing = folder.ancestors().find(|ancestor| ancestor.is_dir());
            let existing = existing.map(|existing| format!("; {} exists", existing.display()));
            return format!("There is no folder {}{}.", folder.display(), existing.unwrap_or_default());
        }
    };
    let names: Vec<String> =
        entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    let wanted = path.file_name().unwrap_or_default().to_string_lossy();
    let near = closest(&wanted, names.iter().map(String::as_str));
    match (names.len(), near.as_slice()) {
        (0, _) => "The folder is empty.".to_owned(),
        (1, []) => "The folder has one file or folder of another name.".to_owned(),
        (count, []) => format!("The folder has {count} files and folders of other names."),
        _ => format!("The folder has {}.", near.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_ordered_by_value() {
        let mut names = ["r_10", "r_2", "r_02", "a", "r_1_b", "r_1", "10", "9", ""];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["", "9", "10", "a", "r_1", "r_1_b", "r_02", "r_2", "r_10"]);
    }

    #[test]
    fn a_missing_file_is_told_with_what_there_is() {
        let dir = tempfile::tempdir().unwrap();
        let help = |name: &str| missing_file_help(&dir.path().join(name));
        assert_eq!(help("a3.exr"), "The folder is empty.");
        for name in ["a2.exr", "a1.exr", "cameras.json"] {
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        assert_eq!(help("a3.exr"), "The folder has a1.exr, a2.exr.");
        assert_eq!(help("elephant"), "The folder has 3 files and folders of other names.");
        let help = help("no/such/a.exr");
        assert!(help.contains("There is no folder") && help.contains("exists"), "{help}");
    }
}
