//! Properties for all inputs: results are finite, not negative, and monotone where physics requires
//! it.

use crate::brdf::{Facets, Ndf};
use crate::cases::{direction, unit};
use crate::shading::*;
use crate::{accurate::Quality, real::dot, sg::Lobe};
use proptest::prelude::*;

/// Every closed form with every NDF that it supports.
const FORMS: [(ClosedForm, Ndf); 5] = [
    (ClosedForm::Published, Ndf::Sg),
    (ClosedForm::Accurate(Quality::Default), Ndf::Sg),
    (ClosedForm::Accurate(Quality::High), Ndf::Sg),
    (ClosedForm::Accurate(Quality::Default), Ndf::Ggx),
    (ClosedForm::Accurate(Quality::High), Ndf::Ggx),
];

/// Few bright values and many between, with zero among them.
fn amplitude() -> impl Strategy<Value = f32> {
    prop_oneof![Just(0.0f32), 1e-6f32..1e3]
}

fn lobe() -> impl Strategy<Value = Lobe<f32>> {
    (direction(), -3.0f32..6.0, prop::array::uniform3(amplitude())).prop_map(|(axis, log, amplitude)| Lobe {
        axis,
        sharpness: 10f32.powf(log),
        amplitude,
    })
}

fn point() -> impl Strategy<Value = ShadePoint> {
    (direction(), direction(), prop::array::uniform3(0.0f32..=1.0))
        .prop_map(|(normal, to_viewer, albedo)| ShadePoint { normal, to_viewer, albedo })
}

fn material() -> impl Strategy<Value = SpecularValue> {
    (prop::array::uniform3(0.0f32..=1.0), prop_oneof![Just(0.03f32), Just(1.0), 0.03f32..1.0])
        .prop_map(|(albedo, roughness)| SpecularValue { albedo, roughness, ndf: Ndf::Sg })
}

fn shaded(
    (form, ndf): (ClosedForm, Ndf),
    point: &ShadePoint,
    material: &SpecularValue,
    lobes: &[Lobe<f32>],
) -> Layers {
    let material = SpecularValue { ndf, ..*material };
    let mut out = [Layers::default()];
    form.shade(&[*point], &material, &LobeColumns::from_lobes(lobes.iter().copied()), &mut out);
    out[0]
}

fn all(layers: &Layers) -> impl Iterator<Item = f32> {
    layers.diffuse.into_iter().chain(layers.specular)
}

/// Returns the point seen from above, and not grazing.
fn lifted(point: &ShadePoint) -> ShadePoint {
    let [n, v] = [point.normal, point.to_viewer].map(|v| v.map(f64::from));
    let side = if dot(n, v) < 0.0 { -1.0 } else { 1.0 };
    let above = unit(std::array::from_fn(|c| side * v[c] + 0.03 * n[c]));
    ShadePoint { to_viewer: above.map(|x| x as f32), ..*point }
}

/// Every number of the adjoint of a radiance.
fn adjoint(
    (form, ndf): (ClosedForm, Ndf),
    point: &ShadePoint,
    material: &SpecularValue,
    lobes: &[Lobe<f32>],
    out: Layers,
) -> Vec<f32> {
    let material = SpecularValue { ndf, ..*material };
    let columns = LobeColumns::from_lobes(lobes.iter().copied());
    let (mut back, mut gradient) = ([PointAdjoint::default()], SharedGradient::default());
    let ones = [RadianceAdjoint([1.0, -0.5, 0.7])];
    let radiance = RadianceColumns { shaded: &[out], adjoint: &ones };
    form.shade_adjoint(&[*point], &material, &columns, radiance, &mut back, &mut gradient);
    let mut numbers = [back[0].albedo, back[0].normal, gradient.specular.albedo].concat();
    numbers.push(gradient.specular.roughness);
    for i in 0..lobes.len() {
        let l = gradient.lobes.get(i);
        numbers.extend(l.axis.into_iter().chain([l.sharpness]).chain(l.amplitude));
    }
    numbers
}

/// A vector of lobes has lanes without one. Those of the rule for smooth lobes had a broad lobe, around
/// which directions are no unit vectors, so that this rough point had a gradient of 0 · NaN.
#[test]
fn lanes_without_a_lobe_add_nothing() {
    let point = ShadePoint {
        normal: [0.260_415_46, 0.770_149_3, -0.582_283_4],
        to_viewer: [-0.784_849_46, 0.613_858_16, 0.084_791_11],
        albedo: [0.163_871_97, 0.265_465_83, 0.271_713_08],
    };
    let material = SpecularValue { albedo: [0.041_443_19; 3], roughness: 0.739_726_9, ndf: Ndf::Sg };
    let axis = [0.706_513_8, 0.650_160_25, 0.279_517_47];
    let lobes = [Lobe { axis, sharpness: 181.838_01, amplitude: [3.090_958, 3.274_684, 3.785_63] }];
    let form = (ClosedForm::default(), Ndf::Sg);
    let numbers = adjoint(form, &point, &material, &lobes, shaded(form, &point, &material, &lobes));
    assert!(numbers.iter().all(|x| x.is_finite()), "{numbers:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]
    #[test]
    fn radiance_is_never_negative_and_all_is_finite(
        point in point(), material in material(), lobes in prop::collection::vec(lobe(), 1..4),
    ) {
        for form in FORMS {
            let out = shaded(form, &point, &material, &lobes);
            prop_assert!(all(&out).all(|x| x >= 0.0 && x.is_finite()), "{form:?} {out:?}");
            let numbers = adjoint(form, &point, &material, &lobes, out);
            prop_assert!(numbers.iter().all(|x| x.is_finite()), "{form:?} {numbers:?}");
        }
    }

    #[test]
    fn without_light_there_is_none(point in point(), material in material(), lobe in lobe()) {
        let dark = [Lobe { amplitude: [0.0; 3], ..lobe }];
        for form in FORMS {
            let out = shaded(form, &point, &material, &dark);
            prop_assert_eq!(out, Layers::default());
            prop_assert!(adjoint(form, &point, &material, &dark, out).iter().all(|x| x.is_finite()));
        }
    }

    #[test]
    fn more_light_is_never_darker(
        point in point(), material in material(), lobe in lobe(), factor in 1.0f32..10.0,
    ) {
        let brighter = Lobe { amplitude: lobe.amplitude.map(|a| a * factor), ..lobe };
        for form in FORMS {
            let (before, after) =
                (shaded(form, &point, &material, &[lobe]), shaded(form, &point, &material, &[brighter]));
            for (a, b) in all(&before).zip(all(&after)) {
                prop_assert!(b >= a * (1.0 - 1e-6), "{form:?} {a} {b}");
            }
        }
    }

    #[test]
    fn a_higher_albedo_is_never_darker(
        point in point(), material in material(), lobe in lobe(), to_white in 0.0f32..1.0,
    ) {
        let raised = |albedo: [f32; 3]| albedo.map(|a| a + (1.0 - a) * to_white);
        let (paler, shinier) = (
            ShadePoint { albedo: raised(point.albedo), ..point },
            SpecularValue { albedo: raised(material.albedo), ..material },
        );
        for form in FORMS {
            let before = shaded(form, &point, &material, &[lobe]);
            let after = shaded(form, &paler, &shinier, &[lobe]);
            for (a, b) in all(&before).zip(all(&after)) {
                prop_assert!(b >= a * (1.0 - 1e-5), "{form:?} {a} {b}");
            }
        }
    }

    /// Diffuse light falls as a lobe turns away from the normal, and as it narrows at the same
    /// amplitude.
    #[test]
    fn diffuse_light_falls_as_the_lobe_turns_away_or_narrows(
        log in -3.0f64..6.0, wider in 0.0f64..1.0, one in -1.0f64..=1.0, other in -1.0f64..=1.0,
    ) {
        use crate::accurate::diffuse::cosine_integral;
        let sharpness = 10f64.powf(log);
        let (low, high) = (one.min(other), one.max(other));
        let at = |l: f64, c: f64| cosine_integral(l, c).value;
        let most = at(sharpness, 1.0);
        prop_assert!(at(sharpness, low) <= at(sharpness, high) + 1e-6 * most);
        prop_assert!(at(sharpness, one) <= at(sharpness * 10f64.powf(-wider), one) + 1e-4 * most);
        prop_assert!(most <= std::f64::consts::PI);
    }

    /// Compares the formulas in the two precisions, a lobe at a time.
    #[test]
    fn single_precision_agrees_with_double(
        point in point(), material in material(), lobe in lobe(),
    ) {
        agrees_in_both_precisions(&lifted(&point), &material, &lobe);
    }
}

fn agrees_in_both_precisions(point: &ShadePoint, material: &SpecularValue, lobe: &Lobe<f32>) {
    let wide = |v: [f32; 3]| v.map(f64::from);
    // Sharper ones feel the rounding of directions.
    let (axis, sharpness) = (lobe.axis, lobe.sharpness.min(1e4));
    for (form, ndf) in FORMS {
        // The published cosine is the difference of two terms thirty times as large.
        let relative = if form == ClosedForm::Published { 2e-3 } else { 1e-4 };
        let single = form.shade_pair(
            [point.normal, point.to_viewer],
            &Lobe { axis, sharpness, amplitude: [1.0; 3] },
            point.albedo,
            material.albedo,
            Facets { ndf, roughness: material.roughness },
        );
        let double = form.shade_pair(
            [wide(point.normal), wide(point.to_viewer)],
            &Lobe { axis: wide(axis), sharpness: f64::from(sharpness), amplitude: [1.0; 3] },
            wide(point.albedo),
            wide(material.albedo),
            Facets { ndf, roughness: f64::from(material.roughness) },
        );
        for (single, double) in single.into_iter().flatten().zip(double.into_iter().flatten()) {
            let error = (f64::from(single) - double).abs();
            assert!(error <= relative * double + 0.01 * relative, "{form:?} {ndf:?}: {single} {double}");
        }
    }
}

/// A light along the normal, where the gradient of n·ω vanishes up to rounding: its sign must not
/// be lost.
#[test]
fn a_light_along_the_normal_is_as_exact_in_single_precision() {
    let normal = unit([1e-5, 1.0, 0.0]).map(|x| x as f32);
    let material = SpecularValue { albedo: [0.25; 3], roughness: 1.0, ndf: Ndf::Sg };
    let lobe = Lobe { axis: normal, sharpness: 4752.387, amplitude: [1.0; 3] };
    let found =
        ShadePoint { normal, to_viewer: [-0.689_739_3, -0.670_959_7, -0.272_163_1], albedo: [0.0; 3] };
    agrees_in_both_precisions(&lifted(&found), &material, &lobe);
}
