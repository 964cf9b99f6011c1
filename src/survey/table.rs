//! A survey as a short table for the terminal.

use crate::math::statistics::{median, quantile};
use crate::survey::examine::Survey;
use crate::survey::finding::{Finding, Severity, counted};
use crate::survey::look::{MaskLook, MaskOrigin, RadianceStatistics, ViewLook};
use crate::view::Split;

/// Rows of label and text.
pub fn rows(survey: &Survey) -> Vec<(&'static str, String)> {
    let mut rows = vec![("data", data(survey))];
    rows.push(("masks", masks(&survey.looks)));
    rows.extend(exposure(&survey.looks).map(|text| ("light", text)));
    rows.extend(sharpness(survey).map(|text| ("detail", text)));
    rows.extend(survey.arrangement.as_ref().map(|arrangement| ("cameras", arrangement.words())));
    rows.extend(agreement(survey).map(|text| ("overlap", text)));
    rows
}

/// Warnings and further errors, each with its remedy; the first error is what a program ends with.
pub fn findings(survey: &Survey) -> String {
    let words = |severity| if severity == Severity::Error { "error" } else { "warning" };
    let line = |finding: &Finding| {
        format!(
            "{} ({}): {}\n  help: {}\n",
            words(finding.severity),
            finding.name,
            finding.problem,
            finding.help
        )
    };
    let first =
        survey.findings.iter().take_while(|finding| finding.severity == Severity::Error).take(1).count();
    survey.findings.iter().skip(first).map(line).collect()
}

/// "fine", "2 warnings", "1 error, 2 warnings"; `further_errors` are those that no survey finds.
pub fn verdict(survey: Option<&Survey>, further_errors: usize) -> String {
    let count = |severity| survey.map_or(0, |survey| survey.findings_of(severity).count());
    match (count(Severity::Error) + further_errors, count(Severity::Warning)) {
        (0, 0) => "fine".to_owned(),
        (0, warnings) => counted(warnings, "warning"),
        (errors, 0) => counted(errors, "error"),
        (errors, warnings) => format!("{}, {}", counted(errors, "error"), counted(warnings, "warning")),
    }
}

fn data(survey: &Survey) -> String {
    let of = |split| survey.looks.iter().filter(move |look| look.split == split);
    let part = |split, name: &str| match of(split).count() {
        0 => format!("no {name} views"),
        count => format!("{count} {name} views of {}", sizes(of(split))),
    };
    format!("{:?}: {}, {}", survey.layout, part(Split::Train, "training"), part(Split::Test, "test"))
}

/// "800×600", "640×480 to 4000×3000".
fn sizes<'a>(looks: impl Iterator<Item = &'a ViewLook>) -> String {
    let mut sizes: Vec<[u32; 2]> = looks.map(|look| look.size).collect();
    sizes.sort_by_key(|size| u64::from(size[0]) * u64::from(size[1]));
    let words = |size: &[u32; 2]| format!("{}×{}", size[0], size[1]);
    match (sizes.first(), sizes.last()) {
        (Some(first), Some(last)) if first != last => format!("{} to {}", words(first), words(last)),
        (Some(only), _) => words(only),
        _ => String::new(),
    }
}

fn masks(looks: &[ViewLook]) -> String {
    let count = |source| looks.iter().filter(|look| look.mask_source == source).count();
    let of: Vec<String> =
        [(MaskOrigin::File, "files"), (MaskOrigin::Alpha, "alpha"), (MaskOrigin::Nowhere, "none")]
            .into_iter()
            .filter(|(source, _)| count(*source) > 0)
            .map(|(source, name)| format!("{name} of {}", counted(count(source), "view")))
            .collect();
    let masks = || looks.iter().filter_map(|look| Some((look, look.mask.as_ref()?)));
    let mut coverage: Vec<f32> = masks().map(|(_, mask)| 100.0 * mask.coverage).collect();
    let Some(middle) = median(&mut coverage) else { return of.join(", ") };
    let [least, most] = [0.0, 1.0].map(|share| quantile(&mut coverage, share).unwrap_or(middle));
    let cut = masks().filter(|(look, mask): &(&ViewLook, &MaskLook)| mask.is_cut(&look.camera)).count();
    format!(
        "{}; the object covers {least:.1} to {most:.1} % of the frame, median {middle:.1} %; the frame cuts it in {}",
        of.join(", "),
        counted(cut, "view")
    )
}

fn exposure(looks: &[ViewLook]) -> Option<String> {
    let lights: Vec<&RadianceStatistics> = looks.iter().filter_map(|look| look.light.as_ref()).collect();
    let mut medians: Vec<f32> =
        lights.iter().map(|light| light.median).filter(|median| *median > 0.0).collect();
    let middle = median(&mut medians)?;
    let stops = |value: Option<f32>| (value.unwrap_or(middle) / middle).log2();
    let (low, high) = (stops(quantile(&mut medians, 0.0)), stops(quantile(&mut medians, 1.0)));
    let clipped = 100.0 * lights.iter().map(|light| light.clipped).sum::<f32>() / lights.len() as f32;
    let most = looks.iter().filter(|look| look.light.is_some());
    let most = most.max_by(|a, b| {
        let clipped = |look: &ViewLook| look.light.map_or(0.0, |light| light.clipped);
        clipped(a).total_cmp(&clipped(b)).then(b.name.cmp(&a.name))
    })?;
    let share = 100.0 * most.light?.clipped;
    let where_most =
        if share > 0.0 { format!(", most in `{}`: {share:.2} %", most.name) } else { String::new() };
    Some(format!(
        "median luminance in the object {middle:.3}, {low:+.1} to {high:+.1} stops; clipped {clipped:.2} % of its pixels{where_most}"
    ))
}

fn sharpness(survey: &Survey) -> Option<String> {
    let views = survey.looks.iter().zip(&survey.compared);
    let least = views
        .filter_map(|(look, compared)| Some((compared.sharpness?, &look.name)))
        .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(b.1)))?;
    Some(format!("the least sharp beside its neighbors is `{}`: {:.2} of their sharpness", least.1, least.0))
}

fn agreement(survey: &Survey) -> Option<String> {
    if let Some(hull) = survey.hull_iou {
        return Some(format!(
            "masks agree with their visual hull to {hull:.2} (mean intersection over union)"
        ));
    }
    let mut found: Vec<f32> = survey.mesh_iou.iter().flatten().copied().collect();
    let middle = median(&mut found)?;
    let views = survey.looks.iter().zip(&survey.mesh_iou);
    let least = views
        .filter_map(|(look, iou)| Some(((*iou)?, &look.name)))
        .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(b.1)))?;
    Some(format!(
        "mesh and masks overlap to {middle:.3} (intersection over union, median), least {:.3} in `{}`",
        least.0, least.1
    ))
}
