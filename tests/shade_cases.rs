//! The command `shade-cases`: single points under single lobes, in both shading modes.

use crate::common::{Outcome, command, files_below};
use serde_json::{Value, json};

/// Two cases: a lobe along the normal, and one from behind the surface.
fn cases() -> Value {
    let case = |axis: [f64; 3]| {
        json!({
            "normal": [0, 0, 1], "view": [0.0, 0.6, 0.8], "lobe_axis": axis, "lobe_sharpness": 12.0,
            "lobe_amplitude": [2.0, 1.0, 0.5], "roughness": 0.4, "specular": [0.3, 0.3, 0.3],
            "albedo": [0.5, 0.4, 0.3], "label": "kept",
        })
    };
    json!([case([0.0, 0.0, 1.0]), case([0.0, 0.0, -1.0])])
}

/// Diffuse radiance of the first case: albedo/π times ∫ μ exp(λ(cosθ − 1)) cosθ dω over the hemisphere, in closed form.
fn exact_diffuse(channel: usize) -> f64 {
    let (sharpness, amplitude, albedo) = (12.0f64, [2.0, 1.0, 0.5][channel], [0.5, 0.4, 0.3][channel]);
    let tail = (1.0 - (-sharpness).exp()) / (sharpness * sharpness);
    2.0 * albedo * amplitude * (1.0 / sharpness - tail)
}

fn shade(mode: &[&str]) -> Vec<Value> {
    let folder = tempfile::tempdir().unwrap();
    let [input, output] = ["cases.json", "shaded.json"].map(|name| folder.path().join(name));
    std::fs::write(&input, cases().to_string()).unwrap();
    let mut shade = command(&["shade-cases"]);
    let outcome = Outcome::of(shade.arg(&input).arg(&output).args(mode)).succeeded();
    assert!(outcome.stdout.contains("2 cases"), "{}", outcome.stdout);
    assert_eq!(files_below(folder.path()), ["cases.json", "shaded.json"]);
    serde_json::from_slice::<Vec<Value>>(&std::fs::read(output).unwrap()).unwrap()
}

fn rgb(case: &Value, field: &str) -> [f64; 3] {
    serde_json::from_value(case[field].clone()).unwrap_or_else(|_| panic!("no {field} in {case}"))
}

#[test]
fn shade_cases_in_both_modes() {
    let published = shade(&[]);
    let traced = shade(&["--mode", "path-traced", "--samples", "16384"]);
    for shaded in [&published, &traced] {
        assert_eq!(shaded.len(), 2);
        assert_eq!(shaded[0]["label"], "kept");
        assert_eq!(rgb(&shaded[0], "specular_albedo"), [0.3; 3]);
        assert_eq!(rgb(&shaded[0], "albedo"), [0.5, 0.4, 0.3]);
        assert!(rgb(&shaded[0], "specular").iter().all(|v| *v > 1e-4));
        // e^-λ of the lobe is left over the horizon.
        assert!(rgb(&shaded[1], "diffuse").iter().all(|v| (0.0..2e-3).contains(v)), "{}", shaded[1]);
    }
    for channel in 0..3 {
        let exact = exact_diffuse(channel);
        let by_formula = rgb(&published[0], "diffuse")[channel];
        assert!((by_formula / exact - 1.0).abs() < 0.03, "{by_formula} is not {exact}");
        let by_paths = rgb(&traced[0], "diffuse")[channel];
        let stderr = rgb(&traced[0], "diffuse_stderr")[channel];
        assert!(stderr > 0.0 && stderr < 0.02 * exact, "a standard error of {stderr} about {exact}");
        assert!((by_paths - exact).abs() < 4.0 * stderr, "{by_paths} ± {stderr} is not {exact}");
    }
}

#[test]
fn a_bad_table_of_cases_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [input, output] = ["cases.json", "shaded.json"].map(|name| folder.path().join(name));
    let mut table = cases();
    table[1]["roughness"] = json!(0);
    for (text, words) in [
        (table.to_string(), ["case 1", "`roughness` must be above 0"]),
        ("[{".into(), ["cases.json", "not JSON"]),
    ] {
        std::fs::write(&input, text).unwrap();
        let outcome = Outcome::of(command(&["shade-cases"]).arg(&input).arg(&output));
        assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
        assert!(words.iter().all(|word| outcome.stderr.contains(word)), "{}", outcome.stderr);
        assert!(!output.exists());
    }
    let none = Outcome::of(command(&["shade-cases"]).arg(folder.path().join("none.json")).arg(&output));
    assert_eq!(none.code, Some(2), "{}", none.stderr);
    assert!(none.stderr.contains("none.json"), "{}", none.stderr);
}
