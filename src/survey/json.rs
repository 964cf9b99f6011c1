//! A survey as JSON, for programs.

use crate::codec::file::write_bytes;
use crate::error::{Error, Result};
use crate::survey::estimate::Estimate;
use crate::survey::examine::Survey;
use crate::survey::look::MaskOrigin;
use serde_json::{Value, json};
use std::path::Path;

/// Writes `survey.json`: the layout, the findings, how the cameras lie, the estimate, and an entry per view.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written.
pub fn write_json(path: &Path, survey: &Survey, estimate: &Estimate) -> Result<()> {
    let text = serde_json::to_string_pretty(&value(survey, estimate));
    let text = text.map_err(|error| Error::run("writing the survey", error.to_string()))?;
    write_bytes(path, text.as_bytes())
}

/// The survey as a JSON value.
pub fn value(survey: &Survey, estimate: &Estimate) -> Value {
    let views: Vec<Value> = (0..survey.looks.len()).map(|i| view(survey, i)).collect();
    json!({
        "layout": survey.layout,
        "notes": survey.notes,
        "findings": survey.findings,
        "cameras": survey.arrangement,
        "hull_iou": survey.hull_iou,
        "background_correlation": survey.background,
        "estimate": {
            "bytes": estimate.bytes(),
            "seconds": estimate.seconds(),
            "threads": estimate.threads,
            "processes": estimate.processes,
            "parts": estimate.parts,
        },
        "views": views,
    })
}

fn view(survey: &Survey, i: usize) -> Value {
    let look = &survey.looks[i];
    let source = match look.mask_source {
        MaskOrigin::File => "file",
        MaskOrigin::Alpha => "alpha",
        MaskOrigin::Nowhere => "none",
    };
    json!({
        "name": look.name,
        "split": look.split,
        "size": look.size,
        "position": look.camera.position(),
        "mask": source,
        "coverage": look.mask.as_ref().map(|mask| mask.coverage),
        "cut": look.mask.as_ref().map(|mask| mask.is_cut(&look.camera)),
        "median_luminance": look.light.map(|light| light.median),
        "clipped": look.light.map(|light| light.clipped),
        "stops_from_neighbors": survey.compared[i].stops,
        "sharpness_of_neighbors": survey.compared[i].sharpness,
        "mesh_iou": survey.mesh_iou[i],
        "mask_uncovered": survey.mask_uncovered[i],
        "flags": survey.flags(&look.name),
    })
}
