//! A table of cases, read with every field checked and every problem named with its case, and written.

use lobelia::codec::file::{read_bytes, write_bytes};
use lobelia::codec::nearby::missing_file_help;
use lobelia::{Error, Result};
use serde_json::{Map, Value};
use std::path::Path;

/// One point under one SG of light; all directions have unit length, colors are linear RGB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Case<F> {
    /// Shading normal.
    pub normal: [F; 3],
    /// Direction from the point to the viewer.
    pub view: [F; 3],
    /// ξ of the light, direction toward it.
    pub lobe_axis: [F; 3],
    /// λ ≥ 0 of the light.
    pub lobe_sharpness: F,
    /// μ ≥ 0 of the light, radiance at its axis.
    pub lobe_amplitude: [F; 3],
    /// The paper's roughness R in `(0, 1]`.
    pub roughness: F,
    /// Specular albedo in `[0, 1]`.
    pub specular: [F; 3],
    /// Diffuse albedo in `[0, 1]`.
    pub albedo: [F; 3],
}

impl Case<f64> {
    /// The same case in single precision.
    pub(super) fn to_f32(self) -> Case<f32> {
        let triple = |v: [f64; 3]| v.map(|x| x as f32);
        Case {
            normal: triple(self.normal),
            view: triple(self.view),
            lobe_axis: triple(self.lobe_axis),
            lobe_sharpness: self.lobe_sharpness as f32,
            lobe_amplitude: triple(self.lobe_amplitude),
            roughness: self.roughness as f32,
            specular: triple(self.specular),
            albedo: triple(self.albedo),
        }
    }
}

/// The objects as they came, and the cases read from them.
pub(super) type CaseTable = (Vec<Map<String, Value>>, Vec<Case<f64>>);

/// Reads and checks the whole table.
pub(super) fn read_table(path: &Path) -> Result<CaseTable> {
    let text = String::from_utf8(read_bytes(path, missing_file_help)?)
        .map_err(|_| Error::input(path, "", "not UTF-8 text", "give a JSON list of cases"))?;
    let value: Value = serde_json::from_str(&text)
        .map_err(|e| Error::input(path, "", format!("not JSON: {e}"), "give a JSON list of cases"))?;
    let Value::Array(list) = value else {
        return Err(Error::input(
            path,
            "",
            "not a JSON list",
            "the file is to be a list of objects, one a case",
        ));
    };
    let mut objects = Vec::with_capacity(list.len());
    let mut cases = Vec::with_capacity(list.len());
    for (index, entry) in list.into_iter().enumerate() {
        let place = format!("case {index}");
        let Value::Object(object) = entry else {
            return Err(Error::input(path, place, "not an object", "give each case as {\"normal\": …}"));
        };
        let case = read_case(&object).map_err(|Problem { field, what }| {
            Error::input(path, place, format!("`{field}` {what}"), HELP)
        })?;
        cases.push(case);
        objects.push(object);
    }
    Ok((objects, cases))
}

const HELP: &str = "a case has normal, view, lobe_axis (directions), lobe_amplitude, specular, albedo (RGB, not negative), \
                    lobe_sharpness (not negative) and roughness (above 0, at most 1)";

struct Problem {
    field: &'static str,
    what: &'static str,
}

type Checked<T> = std::result::Result<T, Problem>;

fn read_case(object: &Map<String, Value>) -> Checked<Case<f64>> {
    let specular = if object.contains_key("specular_albedo") { "specular_albedo" } else { "specular" };
    let roughness = number(object, "roughness")?;
    if roughness <= 0.0 || roughness > 1.0 {
        return Err(Problem { field: "roughness", what: "must be above 0 and at most 1" });
    }
    let lobe_sharpness = number(object, "lobe_sharpness")?;
    if lobe_sharpness < 0.0 {
        return Err(Problem { field: "lobe_sharpness", what: "must not be negative" });
    }
    Ok(Case {
        normal: direction(object, "normal")?,
        view: direction(object, "view")?,
        lobe_axis: direction(object, "lobe_axis")?,
        lobe_sharpness,
        lobe_amplitude: color(object, "lobe_amplitude")?,
        roughness,
        specular: color(object, specular)?,
        albedo: color(object, "albedo")?,
    })
}

fn get<'a>(object: &'a Map<String, Value>, field: &'static str) -> Checked<&'a Value> {
    object.get(field).ok_or(Problem { field, what: "is missing" })
}

fn number(object: &Map<String, Value>, field: &'static str) -> Checked<f64> {
    let value = get(object, field)?.as_f64().filter(|v| v.is_finite());
    value.ok_or(Problem { field, what: "is not a finite number" })
}

fn vector(object: &Map<String, Value>, field: &'static str) -> Checked<[f64; 3]> {
    triple(get(object, field)?).ok_or(Problem { field, what: "is not a list of three finite numbers" })
}

/// Three finite numbers.
pub(super) fn triple(value: &Value) -> Option<[f64; 3]> {
    let list = value.as_array().filter(|list| list.len() == 3)?;
    let mut triple = [0.0; 3];
    for (to, from) in triple.iter_mut().zip(list) {
        *to = from.as_f64().filter(|v| v.is_finite())?;
    }
    Some(triple)
}

fn direction(object: &Map<String, Value>, field: &'static str) -> Checked<[f64; 3]> {
    let v = vector(object, field)?;
    // By the largest component first, so that neither tiny nor huge vectors under- or overflow.
    let largest = v.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    if largest == 0.0 {
        return Err(Problem { field, what: "is zero and has no direction" });
    }
    let v = v.map(|x| x / largest);
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    Ok(v.map(|x| x / length))
}

fn color(object: &Map<String, Value>, field: &'static str) -> Checked<[f64; 3]> {
    let v = vector(object, field)?;
    if v.iter().any(|&x| x < 0.0) {
        return Err(Problem { field, what: "must not be negative" });
    }
    Ok(v)
}

/// Writes the objects, all or nothing.
pub(super) fn write_table(output: &Path, objects: Vec<Map<String, Value>>) -> Result<()> {
    let list = Value::Array(objects.into_iter().map(Value::Object).collect());
    let text = format!("{list:#}\n");
    if output.file_name().is_none() {
        return Err(Error::usage(
            format!("{} is not a file name to write to", output.display()),
            "name a .json file",
        ));
    }
    write_bytes(output, text.as_bytes())
}
