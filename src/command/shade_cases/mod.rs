//! `lobelia shade-cases`: shades a table of single points under one SG each, to check a shading mode against known values.
//!
//! A case is a JSON object with `normal`, `view` (from the point to the viewer), `lobe_axis`, `lobe_sharpness`,
//! `lobe_amplitude`, `roughness`, `specular` (specular albedo) and `albedo`; other fields are carried over. The output has
//! the same objects in the same order with the outgoing radiance added as `diffuse` and `specular`. Since the specular
//! albedo came under that name, it moves to `specular_albedo`, which is also read in preference to `specular`: a written
//! table can be read again.

mod case_file;
mod mode;
mod monte_carlo;

use super::args::{CaseMode, CasePrecision, CaseQuality, ShadeCasesArgs};
use super::output_checks::refuse_inputs;
use super::terminal::print;
use super::threads::start_threads;
use case_file::{Case, read_table, triple, write_table};
use lobelia::math::accurate::Quality;
use lobelia::math::brdf::Facets;
use lobelia::math::published::Lobe;
use lobelia::math::real::Vec3Of;
use lobelia::math::shading::{ClosedForm, Scalar};
use lobelia::{Error, Result};
use mode::{Precision, ShadeMode};
use monte_carlo::{Shaded, path_traced};
use rayon::prelude::*;
use serde_json::{Map, Value};
use std::path::Path;
use std::time::Instant;

/// How many values agree with the reference that the table brought.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Agreement {
    /// RGB values compared.
    pub values: usize,
    /// Of these, how many were within the tolerance.
    pub within: usize,
}

/// What was done.
#[derive(Clone, Debug, PartialEq)]
struct ShadeCasesReport {
    /// Cases shaded.
    pub cases: usize,
    /// Paths per case; 0 for closed forms.
    pub samples: u32,
    /// Time to shade all, in seconds.
    pub elapsed_secs: f64,
    /// Against `exact_*` within 4 standard errors (path-traced) or 5e-2·|exact| + 1e-4 (accurate), or against `approx_*` within 1e-3·|approx| + 1e-6 in `f64`,
    /// 5e-3·|approx| + 1e-4 in `f32` (published); counts only values that the table has.
    pub agreement: Agreement,
}

/// Runs the command.
pub fn run(args: &ShadeCasesArgs) -> Result<()> {
    refuse_inputs(std::slice::from_ref(&args.cases), &[(&args.out, "the shaded table")])?;
    start_threads(args.threads)?;
    let mode = match args.mode {
        CaseMode::Published => ShadeMode::ClosedForm(ClosedForm::Published),
        CaseMode::Accurate => ShadeMode::ClosedForm(ClosedForm::Accurate(quality(args.quality))),
        CaseMode::PathTraced => ShadeMode::PathTraced { samples: args.samples },
    };
    let precision = match args.precision {
        CasePrecision::F32 => Precision::F32,
        CasePrecision::F64 => Precision::F64,
    };
    let report = shade_cases(&args.cases, &args.out, mode, precision)?;
    print(&format!(
        "{} cases in {:.2} s; {} of {} values agree with those of the table\n",
        report.cases, report.elapsed_secs, report.agreement.within, report.agreement.values
    ))
}

fn quality(quality: CaseQuality) -> Quality {
    match quality {
        CaseQuality::Default => Quality::Default,
        CaseQuality::High => Quality::High,
    }
}

/// Shades the table at `input` and writes it to `output` (to a file beside it first, then renamed).
///
/// # Errors
/// [`Error::Input`] naming the case for a table that is not a list of complete, finite, sensible cases;
/// [`Error::Usage`] for fewer than two samples; [`Error::Io`]; [`Error::Run`] if a shaded value is not finite. Nothing is
/// written in any of them.
fn shade_cases(
    input: &Path,
    output: &Path,
    mode: ShadeMode,
    precision: Precision,
) -> Result<ShadeCasesReport> {
    if matches!(mode, ShadeMode::PathTraced { samples: 0 | 1 }) {
        return Err(Error::usage("path-traced cases need at least 2 samples", "try 4096"));
    }
    let (mut objects, cases) = read_table(input)?;
    let started = Instant::now();
    let shaded: Vec<Shaded> = cases
        .par_iter()
        .enumerate()
        .map(|(index, case)| match mode {
            ShadeMode::ClosedForm(form) => {
                Shaded { radiance: in_closed_form(form, case, precision), stderr: None }
            }
            ShadeMode::PathTraced { samples } => path_traced(case, index as u64, samples, precision),
        })
        .collect();
    let elapsed_secs = started.elapsed().as_secs_f64();
    let mut agreement = Agreement::default();
    for (index, (object, shaded)) in objects.iter_mut().zip(&shaded).enumerate() {
        check_finite(index, shaded)?;
        agreement.count(object, shaded, mode, precision);
        add_result(object, &cases[index], shaded);
    }
    write_table(output, objects)?;
    let samples = if let ShadeMode::PathTraced { samples } = mode { samples } else { 0 };
    Ok(ShadeCasesReport { cases: cases.len(), samples, elapsed_secs, agreement })
}

/// Diffuse and specular radiance of a case in closed form.
fn in_closed_form(form: ClosedForm, case: &Case<f64>, precision: Precision) -> [[f64; 3]; 2] {
    match precision {
        Precision::F64 => shade_case(form, case),
        Precision::F32 => shade_case(form, &case.to_f32()).map(|layer| layer.map(f64::from)),
    }
}

fn shade_case<F: Scalar>(form: ClosedForm, case: &Case<F>) -> [Vec3Of<F>; 2] {
    let lobe = Lobe { axis: case.lobe_axis, sharpness: case.lobe_sharpness, amplitude: case.lobe_amplitude };
    form.shade_pair([case.normal, case.view], &lobe, case.albedo, case.specular, Facets::sg(case.roughness))
}

const PARTS: [&str; 2] = ["diffuse", "specular"];

impl Agreement {
    fn count(&mut self, object: &Map<String, Value>, shaded: &Shaded, mode: ShadeMode, precision: Precision) {
        let published = mode == ShadeMode::ClosedForm(ClosedForm::Published);
        let prefix = if published { "approx" } else { "exact" };
        for (part, name) in PARTS.iter().enumerate() {
            let Some(reference) = object.get(&format!("{prefix}_{name}")).and_then(triple) else { continue };
            for channel in 0..3 {
                let expected = reference[channel];
                let tolerance = match (shaded.stderr, precision) {
                    (Some(stderr), _) => 4.0 * stderr[part][channel],
                    (None, _) if !published => 5e-2 * expected.abs() + 1e-4,
                    (None, Precision::F64) => 1e-3 * expected.abs() + 1e-6,
                    (None, Precision::F32) => 5e-3 * expected.abs() + 1e-4,
                };
                self.values += 1;
                let difference = (shaded.radiance[part][channel] - expected).abs();
                self.within += usize::from(difference <= tolerance);
            }
        }
    }
}

fn check_finite(index: usize, shaded: &Shaded) -> Result<()> {
    let stderr = shaded.stderr.unwrap_or_default();
    if shaded.radiance.iter().chain(&stderr).flatten().all(|v| v.is_finite()) {
        return Ok(());
    }
    Err(Error::run("shade-cases", format!("case {index}: the shaded value is not finite")))
}

fn add_result(object: &mut Map<String, Value>, case: &Case<f64>, shaded: &Shaded) {
    object.entry("specular_albedo").or_insert_with(|| Value::from(case.specular.to_vec()));
    for (part, name) in PARTS.iter().enumerate() {
        object.insert((*name).to_owned(), Value::from(shaded.radiance[part].to_vec()));
    }
    if let Some(stderr) = shaded.stderr {
        for (part, name) in PARTS.iter().enumerate() {
            object.insert(format!("{name}_stderr"), Value::from(stderr[part].to_vec()));
        }
    }
}

#[cfg(test)]
mod tests;
