//! What the fits of a run found: lights, textures, and values with words on how far they can be trusted.

use crate::codec::file::{MOST_TEXT, read_text};
use crate::codec::npy::{NpyConvention, read_lobes};
use crate::light::LightLobe;
use crate::material::SpecularLobe;
use crate::math::color::srgb_from_linear;
use crate::pass::fit::{TRUE_ENVIRONMENT, light_files};
use crate::pass::summary::pictures::Pictures;
use crate::report::html::data::{FitFinding, ReportPicture};
use crate::report::scores::{MaterialsTried, NdfTried, ScaleFound, Scores, given_up_words};
use std::path::Path;

/// Longer side of pictures of lights and textures, in pixels.
const SIDE: u32 = 512;

/// The pictures that a fit writes beside those of lights, and what they show.
const PICTURES: [(&str, &str); 5] = [
    (TRUE_ENVIRONMENT, "true light"),
    ("albedo.png", "albedo"),
    ("blend.png", "weights of the base materials"),
    ("roughness.png", "roughness"),
    ("seen.png", "texels that are seen"),
];

/// The pictures of a fit.
pub(crate) fn fit_pictures(out: &Path, pass: &str, pictures: &mut Pictures) -> Vec<ReportPicture> {
    let mut shown = |file: &str, title: &str| {
        let address = pictures.small(&out.join(pass).join(file), SIDE)?;
        Some(ReportPicture { title: format!("{pass}: {title}"), address })
    };
    let [_, _, own] = light_files("");
    let mut all: Vec<ReportPicture> = shown(&own, "recovered light").into_iter().collect();
    // Those of further groups of photographs, as many as there are.
    all.extend((2..).map_while(|number| {
        let [_, _, other] = light_files(&format!("_{number}"));
        shown(&other, &format!("recovered light {number}"))
    }));
    all.extend(PICTURES.iter().filter_map(|(file, title)| shown(file, title)));
    all
}

/// What the fits of these names found, and what the scores say of it.
pub fn findings(out: &Path, fits: &[&str], scores: &Scores) -> Vec<FitFinding> {
    let mut found: Vec<FitFinding> = scores.scale.iter().flat_map(of_scale).collect();
    found.extend(of_light_frame(scores));
    found.extend(scores.materials_tried.map(of_materials_tried));
    let determined = scores.determined.and_then(|found| found.words());
    found.extend(determined.map(|words| plain("determined by the photographs", words)));
    found.extend(scores.ndf_tried.and_then(of_ndf_tried));
    found.extend(scores.warnings.iter().map(|warning| plain("warning", warning.clone())));
    for pass in fits {
        let folder = out.join(pass);
        let of_pass = of_light(&folder).into_iter().chain(of_materials(&folder)).chain(of_exposures(&folder));
        found.extend(
            of_pass.map(|finding| FitFinding { what: format!("{pass}: {}", finding.what), ..finding }),
        );
    }
    found
}

fn plain(what: &str, value: String) -> FitFinding {
    FitFinding { what: what.to_owned(), value, color: None }
}

/// A linear color, with its numbers.
fn colored(what: &str, color: [f32; 3], more: &str) -> FitFinding {
    let [r, g, b] = color;
    let largest = color.into_iter().fold(1.0, f32::max);
    let shown = color.map(|c| (srgb_from_linear((c / largest).clamp(0.0, 1.0)) * 255.0).round() as u8);
    FitFinding { what: what.to_owned(), value: format!("{r:.3}, {g:.3}, {b:.3}{more}"), color: Some(shown) }
}

fn of_scale(scale: &ScaleFound) -> Vec<FitFinding> {
    let sure = match scale.rule.as_str() {
        "Known" => "",
        _ => " — photographs do not determine it: brightness of light and albedo are known up to this choice",
    };
    vec![
        plain("scale between light and albedo", format!("{}{sure}", scale.rule)),
        colored("mean light", scale.mean_light, ""),
        colored("mean albedo of seen texels", scale.mean_albedo, ""),
    ]
}

/// The frame of the light, and how much better it explains the photographs than the others that were tried.
fn of_light_frame(scores: &Scores) -> Option<FitFinding> {
    let frame = scores.light_frame.as_ref()?;
    let errors: Vec<String> =
        scores.light_frames_tried.iter().map(|tried| format!("{} {:.4}", tried.frame, tried.error)).collect();
    let sure = match errors.len() {
        0 | 1 => String::new(),
        _ => format!("; error of the initialization if it {}", errors.join(", if it ")),
    };
    Some(plain("light stands still in", format!("{frame}{sure}")))
}

fn of_materials_tried(tried: MaterialsTried) -> FitFinding {
    let MaterialsTried { one, several, steps, given_up, .. } = tried;
    let early = given_up_words(given_up);
    let words =
        format!("error with one {one:.4}, with several {several:.4}{early}, after {steps} steps each");
    plain("base materials tried", words)
}

fn of_ndf_tried(tried: NdfTried) -> Option<FitFinding> {
    let NdfTried { ggx, sg, steps, given_up, .. } = tried;
    let (early, sg) = (given_up_words(given_up), sg?);
    let words =
        format!("error with GGX {ggx:.4}{early}, with the spherical Gaussian {sg:.4}, after {steps} steps");
    Some(plain("distributions of normals tried", words))
}

fn of_light(folder: &Path) -> Option<FitFinding> {
    let lobes = read_lobes(folder.join("light.npy"), NpyConvention::Lobelia).ok()?;
    let mut powers: Vec<f64> = lobes.iter().map(power).collect();
    powers.sort_by(|a, b| b.total_cmp(a));
    let total: f64 = powers.iter().sum();
    let mut sum = 0.0;
    let most = powers
        .iter()
        .take_while(|power| {
            let before = sum;
            sum += **power;
            before < 0.9 * total
        })
        .count();
    Some(plain("light", format!("{} lobes; 90 % of the power is in {most}", lobes.len())))
}

/// Integral of a lobe over the sphere, 2π/λ (1 − e^−2λ) μ (PhySG eq. 7), mean of the channels.
fn power(lobe: &LightLobe) -> f64 {
    let sharpness = f64::from(lobe.sharpness).max(1e-6);
    let mean = f64::from(lobe.amplitude.element_sum()) / 3.0;
    std::f64::consts::TAU / sharpness * -(-2.0 * sharpness).exp_m1() * mean
}

fn of_materials(folder: &Path) -> Vec<FitFinding> {
    let text = read_text(&folder.join("materials.ron"), MOST_TEXT, |_| String::new()).unwrap_or_default();
    let lobes: Vec<SpecularLobe> = ron::from_str(&text).unwrap_or_default();
    let finding = |(i, lobe): (usize, &SpecularLobe)| {
        let more = format!("; roughness {:.3}, distribution of normals {:?}", lobe.roughness, lobe.ndf);
        colored(&format!("specular albedo {}", i + 1), lobe.albedo.to_array(), &more)
    };
    lobes.iter().enumerate().map(finding).collect()
}

/// The range of the exposures of the photographs.
fn of_exposures(folder: &Path) -> Option<FitFinding> {
    let text = read_text(&folder.join("exposures.csv"), MOST_TEXT, |_| String::new()).ok()?;
    let mut factors: Vec<f64> =
        text.lines().skip(1).filter_map(|line| line.rsplit_once(',')?.1.trim().parse().ok()).collect();
    factors.sort_by(f64::total_cmp);
    let (first, last) = (factors.first()?, factors.last()?);
    let median = factors[factors.len() / 2];
    let value = format!("{first:.3} to {last:.3}, median {median:.3}, of {} photographs", factors.len());
    Some(plain("exposures", value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::npy::write_lobes;
    use crate::report::scores::FrameTried;
    use glam::Vec3;
    use std::fs::write;

    #[test]
    fn what_a_fit_wrote_is_found() {
        let out = tempfile::tempdir().unwrap();
        let fit = out.path().join("fit");
        std::fs::create_dir(&fit).unwrap();
        let lobe = |amplitude| LightLobe { axis: Vec3::Y, sharpness: 4.0, amplitude: Vec3::splat(amplitude) };
        write_lobes(fit.join("light.npy"), &[lobe(9.5), lobe(0.5), lobe(0.5)], NpyConvention::Lobelia)
            .unwrap();
        write(
            fit.join("materials.ron"),
            "// words\n[\n    (albedo: (0.3, 0.2, 0.1), roughness: 0.25, ndf: Sg),\n]\n",
        )
        .unwrap();
        write(fit.join("exposures.csv"), "view,exposure\na,1.00000\n\"b,c\",0.50000\n").unwrap();
        let scale =
            ScaleFound { rule: "WhiteLight".into(), mean_light: [2.0, 1.0, 0.0], mean_albedo: [0.1; 3] };
        let tried = |frame: &str, error| FrameTried { frame: frame.into(), error };
        let scores = Scores {
            scale: Some(scale),
            light_frame: Some("Camera".into()),
            light_frames_tried: vec![tried("stands", 0.03), tried("goes", 0.04)],
            ..Scores::default()
        };
        let found = findings(out.path(), &["fit"], &scores);
        let lines: Vec<String> = found.iter().map(|f| format!("{} = {}", f.what, f.value)).collect();
        let text = lines.join("\n");
        for words in [
            "albedo = WhiteLight — photographs",
            "mean light = 2.000, 1.000, 0.000",
            "Camera; error of the initialization if it stands 0.0300, if it goes 0.0400",
            "fit: light = 3 lobes; 90 % of the power is in 1",
            "fit: specular albedo 1 = 0.300, 0.200, 0.100; roughness 0.250, distribution of normals Sg",
            "fit: exposures = 0.500 to 1.000, median 1.000, of 2 photographs",
        ] {
            assert!(text.contains(words), "no {words:?} in\n{text}");
        }
        assert_eq!(found[1].color, Some([255, 188, 0]));
    }

    #[test]
    fn what_cannot_be_read_is_left_out() {
        let out = tempfile::tempdir().unwrap();
        std::fs::create_dir(out.path().join("fit")).unwrap();
        for file in ["light.npy", "materials.ron", "exposures.csv"] {
            write(out.path().join("fit").join(file), "nothing, of, use").unwrap();
        }
        assert!(findings(out.path(), &["fit", "none"], &Scores::default()).is_empty());
        assert!(fit_pictures(out.path(), "fit", &mut Pictures::default()).is_empty());
    }
}
