use crate::accurate::{PointDerivatives, PointTerms, pull_back_pair, pull_back_point};
use crate::brdf::{Facets, Ndf};
use crate::cases::{Case, random_case};
use crate::published_pairs::{forward, gradient};
use crate::shading::*;
use crate::{real::add, sg::Lobe};
use rand::{SeedableRng, rngs::SmallRng};
use std::f32::consts::PI;

fn narrow(v: [f64; 3]) -> [f32; 3] {
    v.map(|x| x as f32)
}

/// Adjoint of the radiance of every point, per channel.
const ADJOINT: [f64; 3] = [0.7, -0.4, 0.5];

/// Radiance of points under a form, and the adjoints of the points and of the shared inputs.
struct RoundTrip {
    shaded: Vec<Layers>,
    back: Vec<PointAdjoint>,
    shared: SharedGradient,
}

/// Shades the points, and propagates [`ADJOINT`] back from each.
fn round_trip<'a>(
    form: ClosedForm,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lighting: impl Into<Lighting<'a>>,
) -> RoundTrip {
    let lighting: Lighting<'a> = lighting.into();
    let mut shaded = vec![Layers::default(); points.len()];
    form.shade(points, specular, lighting, &mut shaded);
    let adjoint = vec![RadianceAdjoint(narrow(ADJOINT)); points.len()];
    let mut back = vec![PointAdjoint::default(); points.len()];
    let mut shared = SharedGradient::default();
    let radiance = RadianceColumns { shaded: &shaded, adjoint: &adjoint };
    form.shade_adjoint(points, specular, lighting, radiance, &mut back, &mut shared);
    RoundTrip { shaded, back, shared }
}

/// Cases that share one material: `lobes` lobes seen from `points` points.
fn cases(points: usize, lobes: usize) -> Vec<Vec<Case>> {
    let mut rng = SmallRng::seed_from_u64(11);
    let light: Vec<Case> = (0..lobes).map(|_| random_case(&mut rng)).collect();
    (0..points)
        .map(|_| {
            let point = random_case(&mut rng);
            let with = |l: &Case| Case {
                normal: point.normal,
                to_viewer: point.to_viewer,
                albedo: point.albedo,
                specular: [0.3, 0.4, 0.5],
                roughness: 0.35,
                ..*l
            };
            light.iter().map(with).collect()
        })
        .collect()
}

fn inputs(cases: &[Vec<Case>]) -> (Vec<ShadePoint>, SpecularValue, LobeColumns) {
    let points = cases.iter().map(|c| ShadePoint {
        normal: narrow(c[0].normal),
        to_viewer: narrow(c[0].to_viewer),
        albedo: narrow(c[0].albedo),
    });
    let lobes = LobeColumns::from_lobes(cases[0].iter().map(|c| Lobe {
        axis: narrow(c.axis),
        sharpness: c.sharpness as f32,
        amplitude: narrow(c.amplitude),
    }));
    (points.collect(), SpecularValue { albedo: [0.3, 0.4, 0.5], roughness: 0.35, ndf: Ndf::Sg }, lobes)
}

fn close(name: &str, fast: f32, exact: f64, size: f64) {
    assert!((f64::from(fast) - exact).abs() <= 1e-3 * exact.abs() + 2e-4 * size, "{name}: {fast} {exact}");
}

#[test]
fn slices_agree_with_the_sum_of_pairs_in_f64() {
    let cases = cases(300, 21);
    let (points, specular, lobes) = inputs(&cases);
    let mut shaded = vec![Layers::default(); points.len()];
    ClosedForm::Published.shade(&points, &specular, &lobes, &mut shaded);
    for (case, out) in cases.iter().zip(&shaded) {
        for c in 0..3 {
            let sum = |layer: fn(&Case) -> [f64; 3]| case.iter().map(|k| layer(k)[c]).sum::<f64>().max(0.0);
            close("diffuse", out.diffuse[c], sum(|k| forward(k).0), 1.0);
            close("specular", out.specular[c], sum(|k| forward(k).1), 1.0);
        }
    }
}

#[test]
fn responses_agree_with_those_of_pairs_of_unit_amplitude() {
    let cases = cases(37, 21);
    let (points, specular, lobes) = inputs(&cases);
    let stride = lobes.stride();
    for (form, ndf) in [
        (ClosedForm::Published, Ndf::Sg),
        (ClosedForm::default(), Ndf::Sg),
        (ClosedForm::default(), Ndf::Ggx),
    ] {
        let specular = SpecularValue { ndf, ..specular };
        let mut out = vec![f32::NAN; points.len() * RESPONSE_ROWS * stride];
        form.respond(&points, &specular, &lobes, &mut out);
        let mut shaded = vec![Layers::default(); points.len()];
        form.shade(&points, &specular, &lobes, &mut shaded);
        for ((point, rows), layers) in
            points.iter().zip(out.chunks_exact(RESPONSE_ROWS * stride)).zip(&shaded)
        {
            let sum = |row: usize, c: usize| -> f64 {
                let radiance = |i: usize| f64::from(lobes.get(i).amplitude[c] * rows[row * stride + i]);
                (0..lobes.len()).map(radiance).sum()
            };
            for c in 0..3 {
                close("sum", layers.specular[c], sum(1 + c, c), 1.0);
                close("sum", layers.diffuse[c] * PI / point.albedo[c], sum(0, c), 1.0);
            }
            for i in 0..lobes.len() {
                let one = Lobe { amplitude: [1.0; 3], ..lobes.get(i) };
                let (facets, white) = (Facets { ndf, roughness: specular.roughness }, [1.0; 3]);
                let directions = [point.normal, point.to_viewer];
                let [diffuse, glossy] = form.shade_pair(directions, &one, white, specular.albedo, facets);
                close("irradiance", rows[i], f64::from(diffuse[0] * PI), 1.0);
                // What is negligible is left out.
                let kept = |c: &usize| rows[(1 + c) * stride + i] != 0.0;
                for c in (0..3).filter(kept) {
                    close("specular", rows[(1 + c) * stride + i], f64::from(glossy[c]), 1.0);
                }
            }
        }
    }
}

#[test]
fn slice_adjoint_agrees_with_the_sum_of_pairs_in_f64() {
    let cases = cases(300, 21);
    let (points, specular, lobes) = inputs(&cases);
    let RoundTrip { back, shared, .. } = round_trip(ClosedForm::Published, &points, &specular, &lobes);
    let (mut roughness, mut sharpness) = (0.0, vec![0.0; lobes.len()]);
    for (case, out) in cases.iter().zip(&back) {
        let all: Vec<Case> = case.iter().map(|k| gradient(k, ADJOINT, ADJOINT)).collect();
        for c in 0..3 {
            close("normal", out.normal[c], all.iter().map(|g| g.normal[c]).sum(), 20.0);
            close("albedo", out.albedo[c], all.iter().map(|g| g.albedo[c]).sum(), 1.0);
        }
        roughness += all.iter().map(|g| g.roughness).sum::<f64>();
        for (sum, g) in sharpness.iter_mut().zip(&all) {
            *sum += g.sharpness;
        }
    }
    close("roughness", shared.specular.roughness, roughness, 100.0);
    for (i, exact) in sharpness.iter().enumerate() {
        close("sharpness", shared.lobes.get(i).sharpness, *exact, 1.0);
    }
}

#[test]
fn extreme_inputs_stay_finite() {
    check_extremes(ClosedForm::Published, Ndf::Sg);
    check_extremes(ClosedForm::default(), Ndf::Sg);
    check_extremes(ClosedForm::default(), Ndf::Ggx);
}

fn check_extremes(form: ClosedForm, ndf: Ndf) {
    let axis_of = |k: usize| [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]][k % 3];
    for roughness in [0.03f32, 0.3, 1.0] {
        for sharpness in [0.0f32, 1e-3, 1.0, 1e6] {
            for view in [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [1.0, 1e-4, 0.0]] {
                let point = ShadePoint { normal: [0.0, 1.0, 0.0], to_viewer: view, albedo: [0.5; 3] };
                let lobes = LobeColumns::from_lobes((0..3).map(|k| Lobe {
                    axis: axis_of(k),
                    sharpness,
                    amplitude: [1.0; 3],
                }));
                let specular = SpecularValue { albedo: [0.3; 3], roughness, ndf };
                let RoundTrip { shaded, back, shared } = round_trip(form, &[point], &specular, &lobes);
                let all = shaded[0].diffuse.iter().chain(&shaded[0].specular).chain(&back[0].normal);
                assert!(all.chain(&shared.specular.albedo).all(|x| x.is_finite()), "{shaded:?} {back:?}");
                assert!(shared.specular.roughness.is_finite());
                assert!((0..3).all(|k| shared.lobes.get(k).sharpness.is_finite()));
            }
        }
    }
}

/// Points of more than one chunk, with lobes of all sharpness in every vector, and a gradient that
/// was used before.
#[test]
fn threads_and_what_was_there_before_do_not_change_a_bit() {
    let (mut points, specular, lobes) = inputs(&cases(700, 37));
    points[5] = ShadePoint::default();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut shaded = vec![Layers { diffuse: [7.0; 3], ..Default::default() }; points.len()];
            ClosedForm::Published.shade(&points, &specular, &lobes, &mut shaded);
            let adjoint = vec![RadianceAdjoint([0.7, -0.4, 0.5]); points.len()];
            let mut back = vec![PointAdjoint { albedo: [7.0; 3], ..Default::default() }; points.len()];
            let used = SpecularAdjoint { albedo: [7.0; 3], roughness: 7.0 };
            let mut gradient = SharedGradient { lobes: lobes.clone(), specular: used };
            let radiance = RadianceColumns { shaded: &shaded, adjoint: &adjoint };
            let (out, gradient_out) = (&mut back, &mut gradient);
            ClosedForm::Published.shade_adjoint(&points, &specular, &lobes, radiance, out, gradient_out);
            (shaded, back, gradient.lobes, gradient.specular)
        })
    };
    let (one, three) = (run(1), run(3));
    assert!(one == three);
    assert_eq!((one.0[5], one.1[5]), (Layers::default(), PointAdjoint::default()));
}

#[test]
fn nothing_to_do_is_no_failure() {
    let point = ShadePoint { normal: [0.0, 1.0, 0.0], to_viewer: [0.0, 1.0, 0.0], albedo: [0.5; 3] };
    let specular = SpecularValue { albedo: [0.3; 3], roughness: 0.3, ndf: Ndf::Sg };
    let run = |points: &[ShadePoint], lobes: usize| {
        round_trip(ClosedForm::Published, points, &specular, &LobeColumns::zeros(lobes))
    };
    assert_eq!(run(&[point], 0).shaded, [Layers::default()]);
    let gradient = run(&[], 3).shared;
    assert_eq!((gradient.lobes.len(), gradient.lobes.get(2).sharpness), (3, 0.0));
}

/// Light enough that much is left out: what is left out must not show.
#[test]
fn accurate_slices_agree_with_the_sum_of_all_pairs_in_f64() {
    use crate::{accurate::ggx::prepare_ggx_point, accurate::prepare_point};
    check_accurate_slices(Ndf::Sg, |k| prepare_point(k.normal, k.to_viewer, k.roughness));
    check_accurate_slices(Ndf::Ggx, |k| prepare_ggx_point(k.normal, k.to_viewer, k.roughness));
}

/// A sum, and that of the magnitudes of its terms, by which its error is measured.
#[derive(Clone, Copy, Default)]
struct SizedSum {
    value: f64,
    magnitude: f64,
}

impl SizedSum {
    fn add(&mut self, term: f64) {
        self.value += term;
        self.magnitude += term.abs();
    }

    /// Checks that `found` is within this part of the magnitude, or `least` more.
    fn check(self, name: &str, found: f32, part: f64, least: f64) {
        let (found, Self { value, magnitude }) = (f64::from(found), self);
        assert!((found - value).abs() <= part * magnitude + least, "{name}: {found} {value} {magnitude}");
    }
}

/// Diffuse and specular radiance of one point under one lobe, with this distribution of microfacet
/// normals.
fn exact_layers(form: ClosedForm, case: &Case, ndf: Ndf) -> [[f64; 3]; 2] {
    let lobe = Lobe { axis: case.axis, sharpness: case.sharpness, amplitude: case.amplitude };
    let facets = Facets { ndf, roughness: case.roughness };
    form.shade_pair([case.normal, case.to_viewer], &lobe, case.albedo, case.specular, facets)
}

/// Adjoints of sharpness and roughness of one point under one lobe, given [`ADJOINT`] of its
/// radiance.
fn exact_adjoints<const NDF: usize>(
    case: &Case,
    point: &PointTerms<f64, NDF>,
    derivatives: &PointDerivatives<f64, NDF>,
) -> [f64; 2] {
    let over = |f: &dyn Fn(usize) -> f64| (0..3).map(|c| ADJOINT[c] * case.amplitude[c] * f(c)).sum::<f64>();
    let adjoint =
        [over(&|c| case.albedo[c] / std::f64::consts::PI), over(&|_| 1.0), over(&|c| case.specular[c])];
    let (_, pulled) = pull_back_pair::<f64, 3, 2, NDF>(point, case.axis, case.sharpness, adjoint);
    let (_, by_roughness) = pull_back_point(point, derivatives, &pulled.point);
    [pulled.sharpness, by_roughness]
}

/// Checks a point's radiance against the sums over all lobes.
fn check_layers(out: &Layers, [diffuse, specular]: [[f64; 3]; 2]) {
    for c in 0..3 {
        close("diffuse", out.diffuse[c], diffuse[c], 1.0);
        // The bound on what is left out is on the sum over lobes, not on each point.
        let error = (f64::from(out.specular[c]) - specular[c]).abs();
        assert!(error <= 1e-2 * specular[c] + 2e-3, "specular: {} {}", out.specular[c], specular[c]);
    }
}

/// Fraction of the pairs without specular light, in [0, 1].
fn culled_part(
    form: ClosedForm,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lobes: &LobeColumns,
) -> f64 {
    let mut responses = vec![0.0; points.len() * RESPONSE_ROWS * lobes.stride()];
    form.respond(points, specular, lobes, &mut responses);
    let red = responses
        .chunks_exact(RESPONSE_ROWS * lobes.stride())
        .map(|rows| &rows[lobes.stride()..][..lobes.len()]);
    let dark = red.flatten().filter(|value| **value == 0.0).count();
    dark as f64 / (points.len() * lobes.len()) as f64
}

fn check_accurate_slices<const NDF: usize>(
    ndf: Ndf,
    prepare: impl Fn(&Case) -> (PointTerms<f64, NDF>, PointDerivatives<f64, NDF>),
) {
    let cases = cases(120, 90);
    let (points, specular, lobes) = inputs(&cases);
    let specular = SpecularValue { ndf, ..specular };
    let form = ClosedForm::default();
    let culled = culled_part(form, &points, &specular, &lobes);
    assert!(culled > if ndf == Ndf::Sg { 0.2 } else { 0.02 }, "{culled} left out");
    let RoundTrip { shaded, shared, .. } = round_trip(form, &points, &specular, &lobes);
    let (mut sharpness, mut roughness) = (vec![SizedSum::default(); lobes.len()], SizedSum::default());
    for (case, out) in cases.iter().zip(&shaded) {
        let mut sums = [[0.0; 3]; 2];
        for (k, sharpness) in case.iter().zip(&mut sharpness) {
            let (point, derivatives) = prepare(k);
            let [by_sharpness, by_roughness] = exact_adjoints(k, &point, &derivatives);
            sharpness.add(by_sharpness);
            roughness.add(by_roughness);
            for (sum, layer) in sums.iter_mut().zip(exact_layers(form, k, ndf)) {
                *sum = add(*sum, layer);
            }
        }
        check_layers(out, sums);
    }
    roughness.check("roughness", shared.specular.roughness, 2e-2, 0.0);
    for (i, sharpness) in sharpness.iter().enumerate() {
        sharpness.check("sharpness", shared.lobes.get(i).sharpness, 6e-2, 1e-3);
    }
}

/// Specular light with everything negligible left out, against all of it: an error below that of
/// the integrals themselves.
#[test]
fn what_is_left_out_is_negligible() {
    let mut work = crate::workload::Workload::new(600, 128, 0.3);
    let wide = |v: [f32; 3]| v.map(f64::from);
    let sg = [0.1, 0.3, 0.5, 0.7, 0.9].map(|roughness| (Ndf::Sg, roughness));
    for (ndf, roughness) in sg.into_iter().chain([0.1, 0.3, 0.5, 0.7].map(|roughness| (Ndf::Ggx, roughness)))
    {
        (work.specular.ndf, work.specular.roughness) = (ndf, roughness);
        let form = ClosedForm::default();
        let culled = culled_part(form, &work.points, &work.specular, &work.lobes);
        assert!(culled > 0.1, "{ndf:?} {roughness}: {culled}");
        work.shade(form);
        let (mut error, mut total, mut relative) = (0.0, 0.0, Vec::new());
        for (p, out) in work.points.iter().zip(&work.shaded) {
            let pair = |i: usize| {
                let l = work.lobes.get(i);
                let (axis, amplitude) = (wide(l.axis), wide(l.amplitude));
                let lobe = Lobe { axis, sharpness: f64::from(l.sharpness), amplitude };
                let directions = [wide(p.normal), wide(p.to_viewer)];
                let specular = wide(work.specular.albedo);
                let facets = Facets { ndf, roughness: f64::from(roughness) };
                form.shade_pair(directions, &lobe, wide(p.albedo), specular, facets)[1][0]
            };
            let all: f64 = (0..work.lobes.len()).map(pair).sum();
            let missing = (f64::from(out.specular[0]) - all).abs();
            error += missing;
            total += all;
            relative.push(missing / all.max(1e-9));
        }
        relative.sort_by(f64::total_cmp);
        assert!(error < 2e-3 * total, "{ndf:?}, R {roughness}: {error} of {total}");
        assert!(relative[540] < 5e-3, "{ndf:?}, R {roughness}: 90th percentile {}", relative[540]);
    }
}

/// Visibility of points in the open, but for some occlusion of their specular light and some light
/// from the object.
const AROUND: PointVisibility = PointVisibility { specular: [0.5, 0.25, 1.5], indirect: [0.2, 0.1, 0.4] };

/// Part of a lobe's irradiance that reaches the points, of 255.
fn reaching_part(lobe: usize) -> u8 {
    (lobe * 53 % 256) as u8
}

/// Lobes of which as much is there as [`reaching_part`] lets through.
fn dimmed(lobes: &LobeColumns) -> LobeColumns {
    LobeColumns::from_lobes((0..lobes.len()).map(|i| {
        let lobe = lobes.get(i);
        Lobe { amplitude: lobe.amplitude.map(|a| a * f32::from(reaching_part(i)) / 255.0), ..lobe }
    }))
}

/// Checks radiance and adjoints of points without specular light that see a part of each lobe,
/// against those that see dimmed lobes.
fn check_dimmed_points(points: &[ShadePoint], hidden: &RoundTrip, dim: &RoundTrip) {
    for ((a, b), point) in hidden.shaded.iter().zip(&dim.shaded).zip(points) {
        for c in 0..3 {
            close("diffuse", a.diffuse[c], f64::from(b.diffuse[c]), 1.0);
            assert_eq!(a.specular[c], 0.0);
            assert!(a.diffuse[c] >= AROUND.indirect[c] * point.albedo[c] / std::f32::consts::PI - 1e-6);
        }
    }
    for (a, b) in hidden.back.iter().zip(&dim.back) {
        for c in 0..3 {
            close("albedo", a.albedo[c], f64::from(b.albedo[c]), 1.0);
            close("normal", a.normal[c], f64::from(b.normal[c]), 1.0);
        }
    }
}

/// Checks the gradient of lobes of which a part is seen against that of dimmed lobes.
fn check_dimmed_lobes(hidden: &LobeColumns, dim: &LobeColumns) {
    for i in 0..hidden.len() {
        let (a, b) = (hidden.get(i), dim.get(i));
        close("sharpness", a.sharpness, f64::from(b.sharpness), 1.0);
        for c in 0..3 {
            close("axis", a.axis[c], f64::from(b.axis[c]), 10.0);
            let amplitude = f64::from(b.amplitude[c]) * f64::from(reaching_part(i)) / 255.0;
            close("amplitude", a.amplitude[c], amplitude, 10.0);
        }
    }
}

/// Checks visibility by its definition: rows scale each lobe's diffuse light, the factors specular
/// light, and all adjoints follow.
#[test]
fn visibility_scales_the_lobes_it_hides() {
    let (points, specular, lobes) = inputs(&cases(70, 37));
    let row: Vec<u8> = (0..lobes.stride()).map(reaching_part).collect();
    let rows = row.repeat(points.len());
    let open = vec![255u8; rows.len()];
    for form in [ClosedForm::Published, ClosedForm::default()] {
        let run = |lobes: &LobeColumns, rows: &[u8], around: PointVisibility| {
            let around = vec![around; points.len()];
            let visibility = Some(LobeVisibility { lobes: rows, points: &around });
            round_trip(form, &points, &specular, Lighting { lobes, visibility })
        };
        // All open: not a bit changes.
        let plain = round_trip(form, &points, &specular, &lobes);
        let seen = run(&lobes, &open, PointVisibility::OPEN);
        assert!(plain.shaded == seen.shaded && plain.back == seen.back);
        assert!(plain.shared.lobes == seen.shared.lobes);
        // No specular light: as if the lobes were dimmer.
        let matte = PointVisibility { specular: [0.0; 3], ..AROUND };
        let (hidden, dim) = (run(&lobes, &rows, matte), run(&dimmed(&lobes), &open, matte));
        check_dimmed_points(&points, &hidden, &dim);
        check_dimmed_lobes(&hidden.shared.lobes, &dim.shared.lobes);
        // No diffuse light, half of the specular light in the first channel: half of its radiance.
        let mirror = run(&lobes, &rows, AROUND);
        for (a, b) in mirror.shaded.iter().zip(&plain.shaded) {
            for c in 0..3 {
                close("specular", a.specular[c], f64::from(b.specular[c] * AROUND.specular[c]), 1e-2);
            }
        }
    }
}
