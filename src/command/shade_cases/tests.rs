use super::*;
use lobelia::math::real::{add, dot};
use serde_json::json;
use std::f64::consts::PI;

/// Eight cases: rough and sharp, bright and in the far tails, light above and below the horizon, viewers near it.
/// `exact_*` are hemisphere integrals from elsewhere, `approx_*` the published formulas in double precision.
const CASES: &str = r#"[
  {"normal": [0.018681436816318283, 0.742906754880426, 0.669134184952101], "view": [0.6054175337735679, -0.05957666161708024, 0.7936751421016629], "lobe_axis": [0.8604248818876323, -0.17270545711195887, -0.4794182388190954], "lobe_sharpness": 11.782033216020132, "lobe_amplitude": [3.194550459115169, 2.7473702195894383, 2.1470527912360096], "roughness": 0.9, "specular": [0.7795648854517819, 0.5306400000491245, 0.932249684546494], "albedo": [0.22383304213053817, 0.5206708084354437, 0.46108099238487954], "exact_diffuse": [0.00113390571081394, 0.002268419692501699, 0.0015698672702577497], "exact_specular": [0.0006370845022773826, 0.0003732959247825648, 0.0005118820211787639], "approx_diffuse": [0.0001422633825434727, 0.000284603080667134, 0.0001969604931709168], "approx_specular": [0.0001928314449382018, 0.0001153292555467686, 0.00015381334762507026]},
  {"normal": [-0.8983919201214413, -0.3808382939970124, -0.2187559180592721], "view": [-0.6243349842015175, -0.780921455579804, 0.019170490792130793], "lobe_axis": [-0.9685607872390891, 0.2193625708388219, -0.11734591572687471], "lobe_sharpness": 22.696325416118437, "lobe_amplitude": [0.7612269398559575, 2.758776957648461, 0.968420905594545], "roughness": 0.4, "specular": [0.8583309031800045, 0.22194787939923116, 0.05075945926100868], "albedo": [0.2206536110370364, 0.3438856926922936, 0.44857193890911196], "exact_diffuse": [0.011493033233018445, 0.06491426904247494, 0.029723895927190488], "exact_specular": [0.17476076159515866, 0.16444510295015854, 0.013447236211523099], "approx_diffuse": [0.01151374746791145, 0.06503126595613518, 0.02977746818698357], "approx_specular": [0.1794525450815696, 0.16876307524656742, 0.01376510187096125]},
  {"normal": [-0.6491985276722457, 0.12101858568380124, 0.7509299392002432], "view": [-0.928847483644149, 0.3698842272476393, -0.02068841611503788], "lobe_axis": [0.7881884653958774, -0.2380443866509656, -0.5675330941899839], "lobe_sharpness": 19.33966729643686, "lobe_amplitude": [1.5657658904483513, 0.8196159632018098, 3.995449453003127], "roughness": 0.15, "specular": [0.15393428259593472, 0.24721243184722913, 0.3522143328849601], "albedo": [0.10175369747280977, 0.7898271794868337, 0.5909072085836556], "exact_diffuse": [9.136797404570687e-11, 3.712440063495067e-10, 1.353947724394826e-09], "exact_specular": [3.303015011526879e-13, 2.7028156043004653e-13, 1.8519444568258803e-12], "approx_diffuse": [0.0, 0.0, 0.0], "approx_specular": [3.088528168507873e-13, 2.531791840550717e-13, 1.7363360291471855e-12]},
  {"normal": [-0.5897215785490141, 0.6576887377616404, 0.46869391292735957], "view": [-0.847886142740647, -0.2249835552595878, -0.48007446173603463], "lobe_axis": [0.09123000729349053, 0.9953061776577092, 0.03229084213256697], "lobe_sharpness": 208.847953151009, "lobe_amplitude": [1.8133043831630455, 2.574587770573063, 3.4500651732547203], "roughness": 0.2, "specular": [0.6814760735927438, 0.2545986392445343, 0.02708729943711561], "albedo": [0.7977949873481628, 0.5798814991895748, 0.10397351000819899], "exact_diffuse": [0.008492110350164, 0.00876396368634294, 0.0021057345307606973], "exact_specular": [1.3048916963754047e-40, 1.0164068465806732e-40, 7.647321957636955e-41], "approx_diffuse": [0.008470446101051632, 0.008741605911339545, 0.0021003625848535212], "approx_specular": [4.756895116718321e-46, 5.099895608146531e-46, 5.652738152542137e-46]},
  {"normal": [-0.6591485175180543, 0.31656680231670703, -0.6821353909047134], "view": [-0.6314705592314258, 0.6492799254117354, 0.4238873804223025], "lobe_axis": [0.8080749376067046, 0.3331120038895722, -0.48585109660943876], "lobe_sharpness": 772.1833835970887, "lobe_amplitude": [3.08634370556697, 3.550329834525082, 3.149112597544884], "roughness": 0.2, "specular": [0.11176179827967879, 0.5603851499406224, 0.7660454527097685], "albedo": [0.39984608244417374, 0.7674403677705072, 0.1911046479705072], "exact_diffuse": [1.3856719365368564e-07, 3.059402581503718e-07, 6.75744821827366e-08], "exact_specular": [2.5807553780189922e-158, 7.714350425254482e-158, 8.772223452660992e-158], "approx_diffuse": [0.0, 0.0, 0.0], "approx_specular": [6.697432219641015e-114, 2.0596929701096642e-113, 2.3511699214310563e-113]},
  {"normal": [0.7223807251006558, -0.3249917877931511, 0.6103658131563908], "view": [-0.46861606916303145, 0.31345854688045904, 0.8259193175545538], "lobe_axis": [0.7387623712763802, -0.27391595000168073, 0.6157923441557035], "lobe_sharpness": 667.6731808946097, "lobe_amplitude": [2.2115103252587502, 1.2336906617378356, 3.2015798625441905], "roughness": 0.4, "specular": [0.25858023545470454, 0.13521426462566918, 0.5802694808808444], "albedo": [0.6961177765700469, 0.22421975932935723, 0.33372006406645527], "exact_diffuse": [0.004597844815171849, 0.000826157353447104, 0.0031910181267169407], "exact_specular": [4.0436992846343214e-11, 1.1981874424867899e-11, 1.3010778737858777e-10], "approx_diffuse": [0.004632946823012518, 0.0008324646089252867, 0.0032153797891493474], "approx_specular": [5.653651892938195e-99, 3.021341376179914e-99, 9.081685823734037e-99]},
  {"normal": [-0.8909575499638056, -0.3037418186868221, 0.3375434071987104], "view": [-0.9009232175413503, 0.3699409572853152, -0.22689434593608834], "lobe_axis": [0.8252428903127986, 0.09686760217821305, -0.556408878107118], "lobe_sharpness": 23.185147579038475, "lobe_amplitude": [3.9466033924684014, 1.1695822596544891, 0.35976704246248037], "roughness": 0.1, "specular": [0.5965229879771834, 0.8323263818816188, 0.1017145069663387], "albedo": [0.08891688467479361, 0.6255482337882311, 0.5367026578506116], "exact_diffuse": [2.106311343899309e-11, 4.391434587634052e-11, 1.1589640523988748e-11], "exact_specular": [2.1037302183851038e-16, 8.645638547726681e-17, 3.6136885998407966e-18], "approx_diffuse": [0.0, 0.0, 0.0], "approx_specular": [2.07502976632605e-16, 8.528406290813862e-17, 3.559759301301628e-18]},
  {"normal": [0.14013383359170287, -0.27855503121984115, 0.950141885859689], "view": [-0.282200060222957, -0.9531723645944412, 0.10874543385173023], "lobe_axis": [0.9978797740617016, -0.0019859069631587437, 0.06505392141985955], "lobe_sharpness": 158.84017409244737, "lobe_amplitude": [0.49347903778331487, 2.5913637142928705, 0.7391399451214522], "roughness": 0.15, "specular": [0.6576318226920597, 0.5199451412560729, 0.08634450219670019], "albedo": [0.4080829675571892, 0.5146818656061669, 0.26180176928617965], "exact_diffuse": [0.0005098222157194625, 0.0033765160458790167, 0.0004898925429511915], "exact_specular": [6.84414119165581e-42, 2.982592318326267e-41, 3.015310210497275e-42], "approx_diffuse": [0.0004917935253708483, 0.0032571133200438585, 0.0004725686196527801], "approx_specular": [6.018812674322939e-41, 2.628882023183389e-40, 2.7222049172233304e-41]}
]
"#;

/// The published formulas (PhySG's `render_with_sg`), written for reading: (diffuse, specular).
fn reference_published(case: &Case<f64>) -> ([f64; 3], [f64; 3]) {
    let unit = |v: [f64; 3]| v.map(|x| x / (dot(v, v).sqrt() + 1e-6));
    let (n, v, axis) = (case.normal, case.view, unit(case.lobe_axis));
    let r4 = case.roughness.powi(4);
    let nv = dot(n, v).max(0.0);
    let mirror = unit([0, 1, 2].map(|i| 2.0 * nv * n[i] - v[i]));
    let warped = (mirror, 2.0 / r4 / (4.0 * nv + 1e-6), 1.0 / (PI * r4));
    let half = unit(add(mirror, v));
    let vh = dot(v, half).max(0.0);
    let nr = dot(n, mirror).max(0.0);
    let k = (case.roughness + 1.0).powi(2) / 8.0;
    let g = |c: f64| c / (c * (1.0 - k) + k + 1e-6);
    let frozen = g(nr) * g(nv) / (4.0 * nr * nv + 1e-6);
    let lobe = (axis, case.lobe_sharpness, 1.0);
    let cosine_weighted = |p: ([f64; 3], f64, f64)| {
        32.7080 * clamped_integral(product(p, (n, 0.0315, 1.0)), n) - 31.7003 * clamped_integral(p, n)
    };
    let diffuse = cosine_weighted(lobe) / PI;
    let specular = cosine_weighted(product(lobe, warped)) * frozen;
    let power = 2f64.powf(-(5.55473 * vh + 6.8316) * vh);
    let channel = |f: &dyn Fn(usize) -> f64| [0, 1, 2].map(|c| (case.lobe_amplitude[c] * f(c)).max(0.0));
    let fresnel = |c: usize| case.specular[c] + (1.0 - case.specular[c]) * power;
    (channel(&|c| diffuse * case.albedo[c]), channel(&|c| specular * fresnel(c)))
}

type Lobe = ([f64; 3], f64, f64);

fn product((a1, s1, m1): Lobe, (a2, s2, m2): Lobe) -> Lobe {
    let q = s1 / s2;
    let t = (q * q + 1.0 + 2.0 * q * dot(a1, a2)).sqrt().min(q + 1.0);
    let axis = [0, 1, 2].map(|i| (q * a1[i] + a2[i]) / t);
    (axis, s2 * t, m1 * m2 * (s2 * (t - q - 1.0)).exp())
}

fn clamped_integral((axis, sharpness, amplitude): Lobe, n: [f64; 3]) -> f64 {
    let l = sharpness + 1e-6;
    let c = dot(axis, n);
    let t = l.sqrt() * (1.6988 * l * l + 10.8438 * l) / (l * l + 6.2201 * l + 10.2415);
    let s = if c >= 0.0 {
        (1.0 - (-t - t * c).exp()) / ((1.0 - (-t).exp()) * (1.0 + (-t * c).exp()))
    } else {
        ((t * c).exp() - (-t).exp()) / ((1.0 - (-t).exp()) * ((t * c).exp() + 1.0))
    };
    amplitude * 2.0 * PI / l * (1.0 - (-l).exp()) * (s + (1.0 - s) * (-l).exp())
}

const PUBLISHED: ShadeMode = ShadeMode::ClosedForm(ClosedForm::Published);

/// Writes `text`, shades it, and returns the report and what was written.
fn shaded(text: &str, mode: ShadeMode, precision: Precision) -> Result<(ShadeCasesReport, String)> {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("in.json"), folder.path().join("out.json"));
    std::fs::write(&input, text).unwrap();
    let report = shade_cases(&input, &output, mode, precision);
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), if report.is_ok() { 2 } else { 1 }, "no part file is left: {left:?}");
    report.map(|report| (report, std::fs::read_to_string(output).unwrap()))
}

#[test]
fn the_reference_agrees_with_the_kernel() {
    for case in read_cases() {
        let (diffuse, specular) = reference_published(&case);
        let kernel = in_closed_form(ClosedForm::Published, &case, Precision::F64);
        for (a, b) in diffuse.iter().chain(&specular).zip(kernel.as_flattened()) {
            assert!((a - b).abs() <= 1e-3 * a.abs() + 1e-6, "{a} {b}");
        }
    }
}

fn read_cases() -> Vec<Case<f64>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("in.json");
    std::fs::write(&path, CASES).unwrap();
    read_table(&path).unwrap().1
}

#[test]
fn published_values_agree_with_the_table() {
    let (report, _) = shaded(CASES, PUBLISHED, Precision::F64).unwrap();
    assert_eq!((report.cases, report.samples), (8, 0));
    assert_eq!(report.agreement, Agreement { values: 48, within: 48 });
}

/// In double precision every value, down to 1e-157, is found to a few per cent, and within 4 standard errors.
///
/// The table's own integrals are good to 1 % here, no better, hence the few samples.
#[test]
fn path_traced_values_agree_with_exact_integrals() {
    let (report, text) = shaded(CASES, ShadeMode::PathTraced { samples: 512 }, Precision::F64).unwrap();
    let list: Value = serde_json::from_str(&text).unwrap();
    for (index, case) in list.as_array().unwrap().iter().enumerate() {
        for part in PARTS {
            let found = triple(&case[part]).unwrap();
            let stderr = triple(&case[format!("{part}_stderr")]).unwrap();
            let exact = triple(&case[format!("exact_{part}")]).unwrap();
            for c in 0..3 {
                let off = (found[c] / exact[c] - 1.0).abs();
                assert!(off < 0.15 && stderr[c] < 0.1 * exact[c], "case {index} {part}: {off}");
                assert!(stderr[c] > 0.0);
            }
        }
    }
    assert_eq!(report.agreement.within, 48);
}

/// The renderer's own code agrees too wherever a value fits in single precision.
#[test]
fn single_precision_agrees_with_double() {
    let mode = ShadeMode::PathTraced { samples: 2048 };
    let [single, double] = [Precision::F32, Precision::F64].map(|precision| {
        serde_json::from_str::<Vec<Value>>(&shaded(CASES, mode, precision).unwrap().1).unwrap()
    });
    let mut compared = 0;
    for (index, (s, d)) in single.iter().zip(&double).enumerate() {
        for part in PARTS {
            let of = |v: &Value, name: String| triple(&v[name]).unwrap()[1];
            let stderr = |v: &Value| of(v, format!("{part}_stderr"));
            let expected = of(d, part.to_owned());
            if expected > 1e-8 {
                let tolerance = 4.0 * stderr(s).hypot(stderr(d));
                assert!((of(s, part.to_owned()) - expected).abs() < tolerance, "case {index} {part}");
                compared += 1;
            }
        }
    }
    assert!(compared >= 8, "{compared}");
}

#[test]
fn fields_are_carried_over_and_a_written_table_can_be_read_again() {
    let mut case: Value = serde_json::from_str::<Vec<Value>>(CASES).unwrap().swap_remove(1);
    case["note"] = json!({"zebra": 1, "apple": [1.5, null]});
    let text = json!([case]).to_string();
    let (_, once) = shaded(&text, PUBLISHED, Precision::F64).unwrap();
    let written: Vec<Map<String, Value>> = serde_json::from_str(&once).unwrap();
    let names: Vec<_> = written[0].keys().map(String::as_str).collect();
    assert_eq!(names[..3], ["normal", "view", "lobe_axis"]);
    assert_eq!(names[names.len() - 3..], ["note", "specular_albedo", "diffuse"]);
    assert_eq!(written[0]["note"].to_string(), r#"{"zebra":1,"apple":[1.5,null]}"#);
    assert_eq!(written[0]["specular_albedo"], case["specular"]);
    let (_, twice) = shaded(&once, PUBLISHED, Precision::F64).unwrap();
    assert_eq!(once, twice);
}

#[test]
fn the_same_table_gives_the_same_bytes() {
    let mode = ShadeMode::PathTraced { samples: 64 };
    for precision in [Precision::F32, Precision::F64] {
        assert_eq!(shaded(CASES, mode, precision).unwrap().1, shaded(CASES, mode, precision).unwrap().1);
    }
}

#[test]
fn bad_tables_are_refused_by_case_and_field() {
    let good: Vec<Value> = serde_json::from_str(CASES).unwrap();
    let spoilt = |field: &str, value: Value| {
        let mut cases = good.clone();
        cases[2][field] = value;
        Value::from(cases).to_string()
    };
    let mut without = good.clone();
    without[2].as_object_mut().unwrap().remove("albedo");
    for (text, said) in [
        ("[{".to_owned(), "not JSON"),
        ("{}".to_owned(), "not a JSON list"),
        ("[3]".to_owned(), "case 0: not an object"),
        (Value::from(without).to_string(), "case 2: `albedo` is missing"),
        (spoilt("roughness", json!(0)), "case 2: `roughness` must be above 0"),
        (spoilt("roughness", json!("rough")), "case 2: `roughness` is not a finite number"),
        (spoilt("normal", json!([0, 0, 0])), "case 2: `normal` is zero"),
        (spoilt("view", json!([0, 1])), "case 2: `view` is not a list of three"),
        (spoilt("lobe_axis", json!([null, 0, 1])), "case 2: `lobe_axis` is not a list of three"),
        (spoilt("lobe_sharpness", json!(-1)), "case 2: `lobe_sharpness` must not be negative"),
        (spoilt("lobe_amplitude", json!([1, -1, 1])), "case 2: `lobe_amplitude` must not be negative"),
        (CASES.replacen("0.018681436816318283", "1e999", 1), "not JSON"),
    ] {
        let error = shaded(&text, PUBLISHED, Precision::F64).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(said), "{error} should say {said}");
    }
    let few = shaded(CASES, ShadeMode::PathTraced { samples: 1 }, Precision::F64).unwrap_err();
    assert_eq!(few.exit_code(), 2);
}

#[test]
fn a_viewer_below_the_horizon_sees_black() {
    let mut case: Value = serde_json::from_str::<Vec<Value>>(CASES).unwrap().swap_remove(1);
    for c in 0..3 {
        case["view"][c] = json!(-case["view"][c].as_f64().unwrap());
    }
    for precision in [Precision::F32, Precision::F64] {
        let mode = ShadeMode::PathTraced { samples: 64 };
        let (_, text) = shaded(&json!([case]).to_string(), mode, precision).unwrap();
        let written: Value = serde_json::from_str(&text).unwrap();
        for name in ["diffuse", "specular", "diffuse_stderr", "specular_stderr"] {
            assert_eq!(triple(&written[0][name]), Some([0.0; 3]));
        }
    }
}

#[test]
fn a_value_that_is_not_finite_is_an_error() {
    let broken = Shaded { radiance: [[f64::NAN; 3], [0.0; 3]], stderr: None };
    let error = check_finite(3, &broken).unwrap_err();
    assert!(error.to_string().contains("case 3"), "{error}");
}

#[test]
fn accurate_values_agree_with_the_exact_ones() {
    let accurate = ShadeMode::ClosedForm(ClosedForm::default());
    for precision in [Precision::F64, Precision::F32] {
        let (report, _) = shaded(CASES, accurate, precision).unwrap();
        assert_eq!((report.agreement.values, report.agreement.within), (48, 48));
    }
}
