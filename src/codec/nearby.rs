//! Help for wrong names: similar names that exist, and the contents of a folder.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::path::Path;

/// Natural order of names: runs of digits compare as numbers, so that `r_2` comes before `r_10`.
pub(crate) fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut rest_a, mut rest_b) = (a, b);
    loop {
        let (chunk_a, chunk_b) = (leading_chunk(rest_a), leading_chunk(rest_b));
        if chunk_a.is_empty() || chunk_b.is_empty() {
            // Names that differ by leading zeros only ("r_1", "r_01") still need a definite order.
            return chunk_a.len().cmp(&chunk_b.len()).then_with(|| a.cmp(b));
        }
        let order = compare_chunks(chunk_a, chunk_b);
        if order != Ordering::Equal {
            return order;
        }
        (rest_a, rest_b) = (&rest_a[chunk_a.len()..], &rest_b[chunk_b.len()..]);
    }
}

fn leading_chunk(text: &str) -> &str {
    let starts_with_digit = text.starts_with(|c: char| c.is_ascii_digit());
    let end = text.find(|c: char| c.is_ascii_digit() != starts_with_digit).unwrap_or(text.len());
    &text[..end]
}

fn compare_chunks(a: &str, b: &str) -> Ordering {
    let both_numbers = a.as_bytes()[0].is_ascii_digit() && b.as_bytes()[0].is_ascii_digit();
    if !both_numbers {
        return a.cmp(b);
    }
    let (a, b) = (a.trim_start_matches('0'), b.trim_start_matches('0'));
    a.len().cmp(&b.len()).then_with(|| a.cmp(b))
}

/// Up to three of `candidates` that are similar to `name`, closest first.
pub(crate) fn closest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    // No file or view has so long a name, and comparing takes time in proportion to the length.
    if name.len() > 1000 {
        return Vec::new();
    }
    let limit = 2 + name.chars().count() / 4;
    let mut scored: Vec<(usize, &str)> = candidates
        .into_iter()
        .map(|candidate| (edit_distance(name, candidate), candidate))
        .filter(|&(distance, _)| distance <= limit)
        .collect();
    scored.sort_by(|a, b| a.0.cmp(&b.0).then_with(|| natural_order(a.1, b.1)));
    scored.into_iter().take(3).map(|(_, candidate)| candidate).collect()
}

/// Levenshtein distance in characters, ignoring ASCII case.
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.to_ascii_lowercase().chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, from) in a.to_ascii_lowercase().chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, &to) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(from != to);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

/// Help for a missing `path`: similar names, or the contents of its folder ("the folder has 32 .exr
/// files"), or the part of the path that is missing.
pub fn missing_file_help(path: &Path) -> String {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::PermissionDenied => {
            return format!("The folder {} may not be read: `chmod u+rx` allows it.", folder.display());
        }
        entries => entries,
    };
    let Ok(entries) = entries else {
        let existing = folder.ancestors().find(|ancestor| ancestor.is_dir());
        return match existing {
            Some(existing) => {
                format!("There is no folder {}; {} exists.", folder.display(), existing.display())
            }
            None => format!("There is no folder {}.", folder.display()),
        };
    };
    let mut names: Vec<String> =
        entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort_by(|a, b| natural_order(a, b));
    let wanted = path.file_name().unwrap_or_default().to_string_lossy();
    let near = closest(&wanted, names.iter().map(String::as_str));
    let near = if near.is_empty() { String::new() } else { format!(" Near: {}.", near.join(", ")) };
    format!("The folder has {}.{near}", summary(&names))
}

/// "32 .exr files, 1 .json file", most frequent first.
fn summary(names: &[String]) -> String {
    if names.is_empty() {
        return "nothing in it".to_owned();
    }
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for name in names {
        let kind = match name.rsplit_once('.') {
            Some((stem, extension)) if !stem.is_empty() => format!(".{extension} file"),
            _ => "other entry".to_owned(),
        };
        *counts.entry(kind).or_default() += 1;
    }
    let mut counts: Vec<_> = counts.into_iter().collect();
    counts.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
    let plural = |kind: String, count: usize| match (count, kind.as_str()) {
        (1, _) => format!("1 {kind}"),
        (_, "other entry") => format!("{count} other entries"),
        _ => format!("{count} {kind}s"),
    };
    counts.into_iter().take(4).map(|(kind, count)| plural(kind, count)).collect::<Vec<_>>().join(", ")
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
    fn close_names_are_found() {
        let names = ["rgb_000001", "rgb_000002", "depth"];
        assert_eq!(closest("rgb_00001", names), ["rgb_000001", "rgb_000002"]);
        assert!(closest("elephant", names).is_empty());
        assert_eq!(edit_distance("kitten", "sitting"), 3);
        assert_eq!(edit_distance("", "abc"), 3);
    }

    #[test]
    fn a_folder_is_summed_up() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["a1.exr", "a2.exr", "cameras.json", "notes"] {
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        let help = missing_file_help(&dir.path().join("a3.exr"));
        assert!(
            help.starts_with("The folder has 2 .exr files, 1 .json file, 1 other entry. Near: a1.exr"),
            "{help}"
        );
        let help = missing_file_help(&dir.path().join("no/such/a.exr"));
        assert!(help.contains("There is no folder") && help.contains("exists"), "{help}");
    }
}
