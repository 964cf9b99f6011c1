//! Shades a JSON list of single points under one spherical Gaussian each, to check a shading mode
//! against known values.
//!
//! `cargo run --release --example shade_cases -- cases.json shaded.json --mode accurate`
//!
//! A case has `normal`, `view` (from the point to the viewer), `lobe_axis`, `lobe_sharpness`,
//! `lobe_amplitude`, `roughness`, `specular` (specular albedo) and `albedo`; other fields are
//! carried over. The output is the same list with the outgoing radiance added as `diffuse` and
//! `specular`; the specular albedo moves to `specular_albedo`, which is also read in preference to
//! `specular`. Modes: `published` (default), `accurate`, `accurate-high` (more quadrature nodes)
//! and `path-traced`, which is the renderer itself, adds `diffuse_stderr` and `specular_stderr`,
//! and takes `--samples N` paths (default 1024). Closed forms are computed in `f64`.

use lobelia::light::illuminate::LobeLight;
use lobelia::material::SpecularBlend;
use lobelia::sg::accurate::Quality;
use lobelia::sg::brdf::Facets;
use lobelia::sg::published::Lobe;
use lobelia::sg::ray::{Hit, Intersect, Ray};
use lobelia::sg::shading::ClosedForm;
use lobelia::shade::path_tracer::{PathPoint, PathQuery, PathScene, PathSettings, shade_point};
use lobelia::{ecs::*, prelude::*};
use serde::Deserialize;
use serde_json::{Map, Value};

/// Diffuse and specular RGB.
type Layers = [[f64; 3]; 2];

const PARTS: [&str; 2] = ["diffuse", "specular"];
/// Independent estimates whose spread is the standard error of a path-traced case.
const REPLICATES: u32 = 32;

/// A point under a lobe of light; colors are linear RGB.
#[derive(Deserialize)]
struct Case {
    normal: [f64; 3],
    view: [f64; 3],
    #[serde(rename = "lobe_axis")]
    axis: [f64; 3],
    #[serde(rename = "lobe_sharpness")]
    sharpness: f64,
    #[serde(rename = "lobe_amplitude")]
    amplitude: [f64; 3],
    roughness: f64,
    specular: [f64; 3],
    albedo: [f64; 3],
}

/// Reads a case; its directions get unit length.
fn read(fields: &Map<String, Value>) -> Result<Case, String> {
    let mut fields = fields.clone();
    if let Some(specular) = fields.remove("specular_albedo") {
        fields.insert("specular".into(), specular);
    }
    let mut case: Case = serde_json::from_value(fields.into()).map_err(|error| error.to_string())?;
    for (name, v) in [("normal", &mut case.normal), ("view", &mut case.view), ("lobe_axis", &mut case.axis)] {
        let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length == 0.0 {
            return Err(format!("`{name}` has no direction"));
        }
        *v = v.map(|x| x / length);
    }
    let mut colors = [case.amplitude, case.specular, case.albedo].into_iter().flatten();
    if case.sharpness < 0.0 || colors.any(|x| x < 0.0) {
        return Err("`lobe_sharpness` and colors must not be negative".into());
    }
    if !(f64::MIN_POSITIVE..=1.0).contains(&case.roughness) {
        return Err("`roughness` is not above 0 and at most 1".into());
    }
    Ok(case)
}

fn in_closed_form(form: ClosedForm, case: &Case) -> Layers {
    let lobe = Lobe { axis: case.axis, sharpness: case.sharpness, amplitude: case.amplitude };
    let facets = Facets::sg(case.roughness);
    form.shade_pair([case.normal, case.view], &lobe, case.albedo, case.specular, facets)
}

/// Space without anything in it.
struct Empty;

impl Intersect for Empty {
    fn intersect(&self, _: &Ray, _: f32) -> Option<Hit> {
        None
    }
    fn occluded(&self, _: &Ray, _: f32, _: f32) -> bool {
        false
    }
}

/// One estimate by the renderer, of `paths` paths with the random numbers of `stream`.
fn traced(case: &Case, stream: u64, paths: u32) -> Layers {
    let vec = |v: [f64; 3]| Vec3::from(v.map(|x| x as f32));
    let (sharpness, roughness) = (case.sharpness as f32, case.roughness as f32);
    let lobe = LightLobe { axis: vec(case.axis), sharpness, amplitude: vec(case.amplitude) };
    let light = LobeLight::new(&[lobe]);
    let specular = [Some(SpecularLobe::new(vec(case.specular), roughness))];
    let (surface, light, specular) = (&Empty, &light, &specular);
    let scene = PathScene { surface, light, diffuse: &[], blends: &[], specular };
    let (position, normal, albedo) = (Vec3::ZERO, vec(case.normal), vec(case.albedo));
    let blend = SpecularBlend::default().0;
    let point = PathPoint { position, normal, geometric_normal: normal, albedo, blend };
    let query = PathQuery { point, to_viewer: vec(case.view), stream, first_sample: 0 };
    let settings = PathSettings { max_bounces: 1, seed: 1, ..Default::default() };
    let found = shade_point(&scene, &settings, &query, paths);
    [found.diffuse, found.specular].map(|v| v.as_dvec3().to_array())
}

/// Mean of the estimates of a case, and its standard error.
fn path_traced(case: &Case, index: u64, samples: u32) -> [Layers; 2] {
    let each = samples.div_ceil(REPLICATES);
    let stream = |replicate: u32| index * u64::from(REPLICATES) + u64::from(replicate);
    let estimates: Vec<Layers> = (0..REPLICATES).map(|r| traced(case, stream(r), each)).collect();
    let count = f64::from(REPLICATES);
    let value = |f: &dyn Fn(usize, usize) -> f64| [0, 1].map(|part| [0, 1, 2].map(|c| f(part, c)));
    let mean = value(&|part, c| estimates.iter().map(|e| e[part][c]).sum::<f64>() / count);
    let error = value(&|part, c| {
        let squares: f64 = estimates.iter().map(|e| (e[part][c] - mean[part][c]).powi(2)).sum();
        (squares / (count * (count - 1.0))).sqrt()
    });
    [mean, error]
}

/// Adds to each case what comes out of it.
pub fn shade(cases: &mut [Map<String, Value>], mode: &str, samples: u32) -> Result<(), String> {
    let form = match mode {
        "published" => Some(ClosedForm::Published),
        "accurate" => Some(ClosedForm::Accurate(Quality::Default)),
        "accurate-high" => Some(ClosedForm::Accurate(Quality::High)),
        "path-traced" => None,
        _ => return Err(format!("{mode} is not a mode")),
    };
    for (index, object) in cases.iter_mut().enumerate() {
        let case = read(object).map_err(|problem| format!("case {index}: {problem}"))?;
        let shaded = match form {
            Some(form) => vec![("", in_closed_form(form, &case))],
            None => ["", "_stderr"].into_iter().zip(path_traced(&case, index as u64, samples)).collect(),
        };
        object.entry("specular_albedo").or_insert_with(|| Value::from(case.specular.to_vec()));
        for (suffix, layers) in shaded {
            for (part, rgb) in PARTS.iter().zip(layers) {
                object.insert(format!("{part}{suffix}"), Value::from(rgb.to_vec()));
            }
        }
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (mut files, mut mode, mut samples) = (Vec::new(), "published".to_owned(), 1024);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--mode" => mode = arguments.next().unwrap_or_default(),
            "--samples" => samples = arguments.next().unwrap_or_default().parse()?,
            _ => files.push(argument),
        }
    }
    let [input, output] = files.as_slice() else {
        println!("usage: shade_cases CASES.json OUT.json [--mode MODE] [--samples N]");
        return Ok(());
    };
    let mut cases: Vec<Map<String, Value>> = serde_json::from_slice(&std::fs::read(input)?)?;
    shade(&mut cases, &mode, samples)?;
    std::fs::write(output, serde_json::to_string_pretty(&cases)? + "\n")?;
    println!("{} cases", cases.len());
    Ok(())
}
