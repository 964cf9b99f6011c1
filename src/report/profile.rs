//! Where the time of a run went, as a table for the terminal.

use crate::profile::{Part, PartKind, Profile};
use crate::report::score_table::aligned;

/// Parts of less than this share of both wall and processor time are left out.
const LEAST: f64 = 0.005;
const HEAD: [&str; 9] =
    ["time by part", "runs", "wall s", "share", "CPU s", "share", "threads", "allocs", "MiB"];
/// Columns without those of allocations.
const TIMES: usize = 7;

/// A table with a line per part, inner ones indented, and a line for what is in none of the parts inside another; without
/// allocations if the profile has none. Ends with a line break.
pub(crate) fn profile_table(profile: &Profile) -> String {
    let mut rows = vec![HEAD.map(str::to_owned)];
    add_rows(&profile.whole, 0, &profile.whole, &mut rows);
    let threads =
        if profile.threads == 1 { "1 thread".to_owned() } else { format!("{} threads", profile.threads) };
    let table = if profile.whole.allocations.is_some() { aligned(&rows) } else { aligned(&times(&rows)) };
    format!("{table}Of {threads}; parts below {} % are in metrics.json alone.\n", 100.0 * LEAST)
}

fn times(rows: &[[String; HEAD.len()]]) -> Vec<[String; TIMES]> {
    rows.iter().map(|row| std::array::from_fn(|column| row[column].clone())).collect()
}

fn add_rows(part: &Part, depth: usize, whole: &Part, rows: &mut Vec<[String; HEAD.len()]>) {
    if !is_shown(part.wall_share, part.cpu_share) {
        return;
    }
    let name = match part.kind {
        PartKind::Pass => format!("pass {}", part.name),
        _ => part.name.clone(),
    };
    rows.push(row(format!("{:1$}{name}", "", 2 * depth), Some(part.runs), part));
    for inside in &part.parts {
        add_rows(inside, depth + 1, whole, rows);
    }
    let rest = rest_of(part, whole);
    if !part.parts.is_empty() && is_shown(rest.wall_share, rest.cpu_share) {
        rows.push(row(format!("{:1$}(other)", "", 2 * depth + 2), None, &rest));
    }
}

fn is_shown(wall_share: f64, cpu_share: Option<f64>) -> bool {
    wall_share >= LEAST || cpu_share.is_some_and(|share| share >= LEAST)
}

/// What of a part is in none of those inside it.
fn rest_of(part: &Part, whole: &Part) -> Part {
    let (wall_secs, cpu_secs) = part.rest();
    let (allocations, allocated_mib) = part.rest_allocations();
    let of = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
    Part {
        wall_secs,
        wall_share: of(wall_secs, whole.wall_secs),
        cpu_secs,
        cpu_share: cpu_secs.zip(whole.cpu_secs).map(|(rest, all)| of(rest, all)),
        threads_busy: cpu_secs.map(|cpu| of(cpu, wall_secs)),
        allocations,
        allocated_mib,
        ..Part::default()
    }
}

fn row(name: String, runs: Option<u64>, part: &Part) -> [String; HEAD.len()] {
    let secs = |secs: f64| format!("{secs:.2}");
    let share = |share: f64| format!("{:.1} %", 100.0 * share);
    let known = |value: Option<f64>, words: &dyn Fn(f64) -> String| value.map_or("–".to_owned(), words);
    [
        name,
        runs.map_or(String::new(), |runs| runs.to_string()),
        secs(part.wall_secs),
        share(part.wall_share),
        known(part.cpu_secs, &secs),
        known(part.cpu_share, &share),
        known(part.threads_busy, &|busy| format!("{busy:.1}")),
        part.allocations.map_or("–".to_owned(), |count| count.to_string()),
        known(part.allocated_mib, &|mib| format!("{mib:.1}")),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(name: &str, kind: PartKind, wall: f64, cpu: f64, parts: Vec<Part>) -> Part {
        Part {
            name: name.into(),
            kind,
            runs: 2,
            wall_secs: wall,
            wall_share: wall / 10.0,
            cpu_secs: Some(cpu),
            cpu_share: Some(cpu / 16.0),
            threads_busy: Some(cpu / wall),
            allocations: Some((100.0 * cpu) as u64),
            allocated_mib: Some(10.0 * wall),
            parts,
        }
    }

    #[test]
    fn parts_are_indented_and_small_ones_left_out() {
        let systems = vec![
            part("shade", PartKind::System, 5.0, 10.0, Vec::new()),
            part("nothing", PartKind::System, 0.01, 0.01, Vec::new()),
        ];
        let fit = part("fit", PartKind::Pass, 6.0, 11.5, systems);
        let mut profile = Profile { threads: 2, whole: part("run", PartKind::Whole, 10.0, 16.0, vec![fit]) };
        let expected = "\
time by part  runs  wall s    share  CPU s    share  threads  allocs    MiB
───────────────────────────────────────────────────────────────────────────
run              2   10.00  100.0 %  16.00  100.0 %      1.6    1600  100.0
  pass fit       2    6.00   60.0 %  11.50   71.9 %      1.9    1150   60.0
    shade        2    5.00   50.0 %  10.00   62.5 %      2.0    1000   50.0
    (other)           0.99    9.9 %   1.49    9.3 %      1.5     149    9.9
  (other)             4.00   40.0 %   4.50   28.1 %      1.1     450   40.0
Of 2 threads; parts below 0.5 % are in metrics.json alone.
";
        assert_eq!(profile_table(&profile), expected);
        // Where the system does not say processor time, and the allocator does not count.
        let unknown = Part { allocations: None, allocated_mib: None, ..profile.whole };
        profile.whole = Part { cpu_secs: None, cpu_share: None, threads_busy: None, ..unknown };
        profile.whole.parts.clear();
        profile.threads = 1;
        let table = profile_table(&profile);
        assert!(
            table.contains("run              2   10.00  100.0 %      –") || table.contains('–'),
            "{table}"
        );
        assert!(table.contains("Of 1 thread;") && !table.contains("allocs"), "{table}");
    }
}
