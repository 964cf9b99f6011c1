//! A survey as a short table for the terminal. Below its rows are the findings and a verdict.

use crate::survey::{Severity, Survey, counted};
use lobelia_geometry::view::Split;
use lobelia_geometry::view::look::{MaskOrigin, ViewLook};
use lobelia_sg::statistics::{median, quantile};

/// Rows of label and text.
pub fn rows(survey: &Survey) -> Vec<(&'static str, String)> {
    let mut rows = vec![("data", data(survey)), ("masks", masks(&survey.looks))];
    rows.extend(exposure(&survey.looks).map(|text| ("light", text)));
    rows.extend(survey.arrangement.as_ref().map(|arrangement| ("cameras", arrangement.words())));
    rows.extend(agreement(survey).map(|text| ("overlap", text)));
    rows
}

/// Warnings and further errors, each with its remedy; the first error is what a program ends with.
pub fn findings(survey: &Survey) -> String {
    let is_error = survey.findings.first().is_some_and(|finding| finding.severity == Severity::Error);
    let further = survey.findings.iter().skip(usize::from(is_error));
    let line = further.map(|finding| {
        let severity = if finding.severity == Severity::Error { "error" } else { "warning" };
        format!("{severity} ({}): {}\n  help: {}\n", finding.name, finding.problem, finding.help)
    });
    line.collect()
}

/// "fine", "2 warnings", "1 error, 2 warnings"; `further_errors` are those that no survey finds.
pub fn verdict(survey: Option<&Survey>, further_errors: usize) -> String {
    let count = |severity| survey.map_or(0, |survey| survey.findings_of(severity).count());
    let counts = [(count(Severity::Error) + further_errors, "error"), (count(Severity::Warning), "warning")];
    let found = counts.into_iter().filter(|(count, _)| *count > 0).map(|(count, noun)| counted(count, noun));
    let found: Vec<String> = found.collect();
    if found.is_empty() { "fine".to_owned() } else { found.join(", ") }
}

/// "PhySg: 6 training views of 800×600, 2 test views of 640×480 to 4000×3000".
fn data(survey: &Survey) -> String {
    let part = |split, name: &str| {
        let sizes = survey.looks.iter().filter(|look| look.split == split).map(|look| look.size);
        let mut sizes: Vec<[u32; 2]> = sizes.collect();
        sizes.sort_by_key(|size| (u64::from(size[0]) * u64::from(size[1]), *size));
        let words = |[width, height]: [u32; 2]| format!("{width}×{height}");
        let count = sizes.len();
        sizes.dedup();
        match sizes[..] {
            [] => format!("no {name} views"),
            [only] => format!("{count} {name} views of {}", words(only)),
            [first, .., last] => format!("{count} {name} views of {} to {}", words(first), words(last)),
        }
    };
    format!("{:?}: {}, {}", survey.layout, part(Split::Train, "training"), part(Split::Test, "test"))
}

fn masks(looks: &[ViewLook]) -> String {
    let origins = [(MaskOrigin::File, "files"), (MaskOrigin::Alpha, "alpha"), (MaskOrigin::Nowhere, "none")];
    let of = origins.into_iter().filter_map(|(origin, name)| {
        let count = looks.iter().filter(|look| look.mask_source == origin).count();
        (count > 0).then(|| format!("{name} of {}", counted(count, "view")))
    });
    let of = of.collect::<Vec<_>>().join(", ");
    let masks = || looks.iter().filter_map(|look| Some((look, look.mask.as_ref()?)));
    let mut coverage: Vec<f32> = masks().map(|(_, mask)| 100.0 * mask.coverage).collect();
    let Some(middle) = median(&mut coverage) else { return of };
    let [least, most] = [0.0, 1.0].map(|share| quantile(&mut coverage, share).unwrap_or(middle));
    let cut = counted(masks().filter(|(look, mask)| mask.is_cut(&look.camera)).count(), "view");
    format!(
        "{of}; the object covers {least:.1} to {most:.1} % of the frame, median {middle:.1} %; the frame cuts it in {cut}"
    )
}

fn exposure(looks: &[ViewLook]) -> Option<String> {
    let lights = || looks.iter().filter_map(|look| Some((&look.name, look.light?)));
    let medians = lights().map(|(_, light)| light.median).filter(|median| *median > 0.0);
    let mut medians: Vec<f32> = medians.collect();
    let middle = median(&mut medians)?;
    let mut stops = |share: f32| (quantile(&mut medians, share).unwrap_or(middle) / middle).log2();
    let (low, high) = (stops(0.0), stops(1.0));
    let clipped = 100.0 * lights().map(|(_, light)| light.clipped).sum::<f32>() / lights().count() as f32;
    let (name, most) = lights().max_by(|(a, x), (b, y)| x.clipped.total_cmp(&y.clipped).then(b.cmp(a)))?;
    let share = 100.0 * most.clipped;
    let most = if share > 0.0 { format!(", most in `{name}`: {share:.2} %") } else { String::new() };
    Some(format!(
        "median luminance in the object {middle:.3}, {low:+.1} to {high:+.1} stops; clipped {clipped:.2} % of its pixels{most}"
    ))
}

fn agreement(survey: &Survey) -> Option<String> {
    let views = || survey.looks.iter().filter_map(|look| Some((look.overlap?, &look.name)));
    let middle = median(&mut views().map(|view| view.0).collect::<Vec<_>>())?;
    let (least, name) = views().min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(b.1)))?;
    let with = if survey.has_mesh { "the mesh" } else { "their visual hull" };
    Some(format!(
        "masks overlap with {with} to {middle:.3} (intersection over union, median), least {least:.3} in `{name}`"
    ))
}
