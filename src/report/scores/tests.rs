//! Tests of scores.

use super::*;

/// A view whose prediction's layers differ from the truth's by known factors.
fn view(index: usize, diffuse_factor: f32, specular_factor: f32) -> EvalView {
    let (width, height) = (14, 12);
    let value = |i: usize, k: usize| ((i * 7919 + index * 31 + k * 104_729) % 997) as f32 / 2500.0;
    let layer = |k: usize| -> Vec<Vec3> {
        (0..width * height).map(|i| Vec3::new(value(i, k), value(i, k + 1), value(i, k + 2))).collect()
    };
    let (diffuse, specular) = (layer(0), layer(9));
    let sum = |a: f32, b: f32| diffuse.iter().zip(&specular).map(|(d, s)| a * *d + b * *s).collect();
    EvalView {
        name: format!("view_{index}"),
        width,
        height,
        prediction: sum(1.0, 1.0),
        truth: sum(diffuse_factor, specular_factor),
        mask: vec![true; width * height],
        diffuse,
        specular,
        ..EvalView::default()
    }
}

#[test]
fn scales_are_shared_by_all_views() {
    let views = [view(0, 1.25, 1.25), view(1, 1.25, 1.25)];
    let scored = score_views(2, Scaling::PerChannel, |i| Ok(&views[i])).unwrap();
    assert!(scored.scale.iter().all(|s| (s - 1.25).abs() < 1e-6), "{:?}", scored.scale);
    assert!(scored.psnr > 90.0 && scored.psnr_raw < 30.0);
    assert!(scored.ssim > 0.999_999);
    assert_eq!(scored.views[1].name, "view_1");
    // One view at 1, one at 2: a shared scale fits neither.
    let views = [view(0, 1.0, 1.0), view(1, 2.0, 2.0)];
    let scored = score_views(2, Scaling::PerChannel, |i| Ok(&views[i])).unwrap();
    assert!(scored.scale.iter().all(|&s| s > 1.3 && s < 1.7) && scored.psnr < 30.0);
    let mean = (scored.views[0].psnr + scored.views[1].psnr) / 2.0;
    assert_eq!(scored.psnr, mean);
}

#[test]
fn layers_have_scales_of_their_own() {
    let views = [view(0, 0.5, 1.5), view(1, 0.5, 1.5)];
    let single = score_views(2, Scaling::PerChannel, |i| Ok(&views[i])).unwrap();
    let layers = score_views(2, Scaling::PerLayer, |i| Ok(&views[i])).unwrap();
    assert!(layers.psnr > 90.0 && single.psnr < 35.0, "{} {}", layers.psnr, single.psnr);
    assert!(layers.scale_specular.unwrap().iter().all(|s| (s - 1.5).abs() < 1e-5));
    let raw = score_views(2, Scaling::None, |i| Ok(views[i].clone())).unwrap();
    assert_eq!(raw.scored_prediction(&views[0]), views[0].prediction);
    let shown = layers.scored_prediction(&views[1]);
    assert!(shown.iter().zip(&views[1].truth).all(|(p, t)| p.abs_diff_eq(*t, 1e-5)));
    assert_eq!(raw.psnr, raw.psnr_raw);
    assert_eq!(raw.psnr, layers.psnr_raw);
}

#[test]
fn each_view_may_have_its_own_scale() {
    let views = [view(0, 1.25, 1.25), view(1, 0.5, 0.5)];
    let scored = |scaling| score_views(2, scaling, |i| Ok(&views[i])).unwrap();
    let (shared, own) = (scored(Scaling::PerChannel), scored(Scaling::PerView));
    assert!(shared.psnr < 40.0 && own.psnr > 90.0, "{} {}", shared.psnr, own.psnr);
    assert!((own.views[1].scale.unwrap()[0] - 0.5).abs() < 1e-6 && (own.scale[0] - 0.875).abs() < 1e-6);
    let shown = own.scored_prediction(&views[1]);
    assert!(shown.iter().zip(&views[1].truth).all(|(p, t)| p.abs_diff_eq(*t, 1e-5)));
    assert!(own.stanford_orb.is_some() && shared.stanford_orb.is_none());
}

#[test]
fn bad_views_are_named() {
    let mut bad = view(3, 1.0, 1.0);
    bad.prediction[15].y = f32::INFINITY;
    let message = score_views(1, Scaling::None, |_| Ok(&bad)).unwrap_err().to_string();
    assert!(message.contains("view_3") && message.contains("pixel (1, 1)"), "{message}");
    let mut bad = view(3, 1.0, 1.0);
    bad.specular.clear();
    assert!(score_views(1, Scaling::PerLayer, |_| Ok(&bad)).is_err());
    assert!(score_views(0, Scaling::None, |_| Ok(&bad)).is_err());
}

#[test]
fn srgb_scores_are_of_the_scaled_prediction_and_only_where_wanted() {
    let wanted = |i: usize| EvalView { in_srgb: true, ..view(i, 1.25, 1.25) };
    let scored = |scaling| score_views(2, scaling, |i| Ok(wanted(i))).unwrap();
    let (plain, scaled) = (scored(Scaling::None), scored(Scaling::PerChannel));
    let of_views: Vec<f64> = plain.views.iter().map(|v| v.srgb.unwrap().psnr_mask).collect();
    assert_eq!(plain.srgb.unwrap().psnr_mask, (of_views[0] + of_views[1]) / 2.0);
    assert!(plain.srgb.unwrap().psnr_mask < 30.0);
    assert!(scaled.psnr > 90.0 && scaled.srgb.unwrap().psnr_mask > 90.0);
    let unwanted = score_views(2, Scaling::None, |i| Ok(view(i, 1.25, 1.25))).unwrap();
    assert_eq!((unwanted.srgb, unwanted.views[0].srgb), (None, None));
    assert_eq!((unwanted.psnr, unwanted.ssim), (plain.psnr, plain.ssim));
    let short = EvalView { alpha: vec![1.0], ..wanted(3) };
    let message = score_views(1, Scaling::None, |_| Ok(&short)).unwrap_err().to_string();
    assert!(message.contains("view_3") && message.contains("1 of coverage"), "{message}");
}

#[test]
fn json_has_the_asked_for_form() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("metrics.json");
    let mut scores = Scores { albedo_psnr: Some(35.5), fit_secs: Some(61.25), ..Scores::default() };
    let views = [EvalView { in_srgb: true, ..view(0, 1.1, 1.1) }];
    scores.passes.insert("relit".into(), score_views(1, Scaling::PerChannel, |i| Ok(&views[i])).unwrap());
    scores.write_json(&path).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    for key in ["psnr", "psnr_raw", "ssim"] {
        assert!(json["passes"]["relit"][key].is_f64(), "{text}");
    }
    assert_eq!(json["passes"]["relit"]["scaling"], "per_channel");
    assert_eq!(json["albedo_psnr"], 35.5);
    assert!(json["normal_deg"].is_null() && json.as_object().unwrap().contains_key("peak_rss_mib"));
    for key in ["psnr_mask", "psnr_white", "psnr_black", "ssim_white", "ssim_black"] {
        assert!(json["passes"]["relit"]["srgb"][key].is_f64(), "{text}");
        assert!(json["passes"]["relit"]["views"][0]["srgb"][key].is_f64(), "{text}");
    }
    let read: Scores = serde_json::from_str(&text).unwrap();
    let (read, made) = (&read.passes["relit"], &scores.passes["relit"]);
    assert_eq!((read.scaling, read.views.len()), (Scaling::PerChannel, 1));
    assert!((read.psnr_raw - made.psnr_raw).abs() < 1e-9 && (read.scale[1] - made.scale[1]).abs() < 1e-9);
    // A file of before these were scored.
    let mut old = json;
    for key in ["normal_median_deg", "normal_pixels"] {
        old.as_object_mut().unwrap().remove(key).unwrap();
    }
    old["passes"]["relit"].as_object_mut().unwrap().remove("srgb").unwrap();
    let read: Scores = serde_json::from_value(old).unwrap();
    assert_eq!((read.passes["relit"].srgb, read.normal_median_deg, read.normal_pixels), (None, None, None));
}

#[test]
fn peak_memory() {
    assert_eq!(peak_in_status("Name:\tx\nVmHWM:\t  2048 kB\nVmRSS:\t 1 kB\n"), Some(2.0));
    assert_eq!(peak_in_status("VmHWM: many kB"), None);
    if cfg!(target_os = "linux") {
        assert!(peak_rss_mib().unwrap() > 1.0);
    }
}
