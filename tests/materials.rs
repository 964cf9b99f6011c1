//! Materials from photographs to a saved scene: the distribution of normals, several glosses, metal
//! beside paint, sheen, tilt, and textures as fine as the photographs.

use crate::common::*;
use crate::lights::lamp;
use lobelia::fit::detail::{DetailOptions, solve_detail};
use lobelia::material::diffuse::{KnownAlong, write_albedo};
use lobelia::{
    ecs::*, fit::components::TexelSeen, material::edit::apply_edit, material::shown::recovered_material,
    prelude::*,
};
use std::ops::{ControlFlow, Range};
use std::sync::LazyLock;

/// A sphere of one color under a known light, which a fit finds with its gloss; nothing can hide
/// anything.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.9, texture_size: 32),
    views: Photographed(
        cameras: (count: COUNT, test: 1, size: SIZE),
        spp: 32,
        max_bounces: 1,
        truth: (
            albedo: Constant(0.4, 0.3, 0.2),
            specular: (albedo: (0.3, 0.3, 0.3), TRUTH,
            light: Lobes(lobes: LIGHT),
        ),
    ),
    light: Fixed(Lobes(lobes: LIGHT)),
    material: (MATERIAL),
    passes: [Fit(name: "fit", steps: 300, batch: 1024), Render(name: "novel"), MORE],
)
"#;
/// The first lobes are those of the scenes with few views.
const LIGHT: [&str; 5] = [
    "(axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.35, 0.45, 0.6))",
    "(axis: (0.5, 0.6, 0.62), sharpness: 60, amplitude: (6, 5, 4))",
    "(axis: (-0.8, 0.3, -0.3), sharpness: 30, amplitude: (2, 3, 4))",
    "(axis: (0.3, -0.5, -0.8), sharpness: 40, amplitude: (4, 4, 4))",
    "(axis: (-0.5, -0.6, 0.6), sharpness: 40, amplitude: (4, 4, 4))",
];

fn known_light(truth: &str, material: &str, more: &str, lobes: usize) -> String {
    let [count, size] = if lobes < 5 { ["8", "40"] } else { ["16", "48"] };
    let light = format!("[{}]", LIGHT[..lobes].join(", "));
    let words =
        [("COUNT", count), ("SIZE", size), ("TRUTH", truth), ("LIGHT", &light), ("MATERIAL", material)];
    words.iter().fold(SCENE.replace("MORE", more), |text, (word, by)| text.replace(word, by))
}

/// The numbers that stand after `word` in a RON text.
fn numbers(text: &str, word: &str) -> Vec<f64> {
    let parts = text.split(word).skip(1).filter_map(|rest| rest.split([',', ')']).next());
    parts.filter_map(|number| number.trim().parse().ok()).collect()
}

/// Mean absolute difference relative to the mean, of the specular light in the first pictures of
/// two passes.
fn difference(data: &Data, a: &str, b: &str) -> f32 {
    let [a, b] = [a, b].map(|pass| data.exr(&data.pictures(pass)[0]).channels["specular.G"].clone());
    a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum::<f32>() / b.iter().sum::<f32>()
}

/// A run whose photographs, material and shading are all GGX, into `out`.
pub static GGX: LazyLock<Data> = LazyLock::new(|| {
    let data = Data::shared("ggx");
    let more = r#"Render(name: "traced", render: (shading: PathTraced(spp: 256, max_bounces: 1))),
        Edit(name: "dull", edits: [Roughness(action: Set(0.6))]), Save(name: "saved"),
        Evaluate(scores: [(pass: "novel", truth: Photographs)])"#;
    let material = "specular: (roughness: Unknown(initial: 0.45), ndf: Ggx)";
    let scene = known_light("roughness: 0.3, ndf: Ggx)", material, more, 3).replace("spp: 32", "spp: 96");
    data.run(&scene, "out", &["--quiet"]).succeeded();
    data
});

#[test]
fn a_ggx_material_is_photographed_fitted_traced_and_saved() {
    let data = &GGX;
    let found = data.text("out/fit/materials.ron");
    let (roughness, albedo) = (numbers(&found, "roughness:")[0], numbers(&found, "albedo: (")[0]);
    assert!((roughness - 0.3).abs() < 0.02 && (albedo - 0.3).abs() < 0.03, "{found}");
    assert!(found.contains("ndf: Ggx"), "{found}");
    let metrics = data.metrics("out");
    let deviation = |of: &str| metrics["determined"][of].as_f64().unwrap();
    // The light is known, and with it the material.
    assert!(metrics["determined"]["brightness"].is_null() && metrics["determined"]["lobes"].is_null());
    assert!((roughness / 0.3).ln().abs() < deviation("roughness") && deviation("roughness") < 0.2);
    assert!((albedo / 0.3).ln().abs() < deviation("specular_albedo"));
    let off = difference(data, "out/novel", "out/traced");
    assert!(off < 0.04, "closed form and path tracer differ by {off}");
    assert!(difference(data, "out/dull", "out/novel") > 0.1, "the edit shows");
    assert!(data.text("out/saved/scene.ron").contains("ndf: Ggx"));
    data.reopens("out");
    // The same photographs read as one SG: no roughness explains the tail.
    let as_sg = ["--set", "material.specular.ndf=Sg", "--set", "passes=[Fit(steps: 300, batch: 1024)]"];
    data.run_file("scene.ron", "sg", &as_sg).succeeded();
    let [right, wrong] = ["out", "sg"].map(|out| {
        let metrics = data.metrics(out);
        let views = metrics["views"].as_array().unwrap();
        views.iter().map(|view| view["psnr"].as_f64().unwrap()).sum::<f64>() / views.len() as f64
    });
    assert!(right > wrong + 6.0, "{right} {wrong}");
}

#[test]
fn photographs_choose_the_distribution_of_normals() {
    let data = Data::bare();
    // Photographs of the Gaussian; coarse texels under a narrow light leave something to explain.
    for (truth, ndf) in [("roughness: 0.3, ndf: Ggx)", "Ggx"), ("roughness: 0.12)", "Sg")] {
        let scene = known_light(truth, "specular: (roughness: Unknown(initial: 0.45))", "", 3);
        let scene = scene.replace("steps: 300", "steps: 800").replace("spp: 32", "spp: 96");
        data.run(&scene, ndf, &["--quiet"]).succeeded();
        let (found, tried) = (data.text(format!("{ndf}/fit/materials.ron")), &data.metrics(ndf)["ndf_tried"]);
        assert!(found.contains(&format!("ndf: {ndf}")), "{found}");
        let ratio = tried["ggx"].as_f64().unwrap() / tried["sg"].as_f64().unwrap();
        assert!(if ndf == "Ggx" { ratio < 0.975 } else { ratio > 1.0 }, "{tried}");
        assert!(ndf == "Sg" || (numbers(&found, "roughness:")[0] - 0.3).abs() < 0.02, "{found}");
    }
}

/// A sphere whose one cap is rougher than the rest.
fn two_glosses(gloss: &str) -> String {
    let truth = "roughness: 0.25), edits: [Roughness(action: Set(0.5), region: Box(min: (-1, -1, -1), max: (1, 1, 0)))]";
    let more = r#"Save(name: "saved"), Export(name: "export")"#;
    known_light(truth, &format!("gloss: {gloss}"), more, 5)
        .replace("texture_size: 32", "texture_size: 48")
        .replace("steps: 300, batch: 1024", "steps: 400, batch: 2048")
}

#[test]
fn two_glosses_are_told_apart_and_kept() {
    let data = Data::bare();
    data.run(&two_glosses("Blend(materials: 2)"), "out", &["--quiet"]).succeeded();
    let found = numbers(&data.text("out/fit/materials.ron"), "roughness: ");
    assert!((found[0] - 0.25).abs() < 0.03 && (found[1] - 0.5).abs() < 0.06, "{found:?}");
    // The back is rough, the front is not. Row y of the texture is at polar angle π(y + ½)/48,
    // column x at azimuth 2π(x + ½)/48 − π/2.
    let rough = &data.exr("out/fit/blend.exr").channels["weight1"];
    let right = (0..48 * 48).filter(|i| {
        let phi = std::f32::consts::PI * ((i / 48) as f32 + 0.5) / 48.0;
        let azimuth = std::f32::consts::TAU * ((i % 48) as f32 + 0.5) / 48.0 - std::f32::consts::FRAC_PI_2;
        (rough[*i] > 0.5) == (azimuth.sin() * phi.sin() < 0.0)
    });
    assert!(right.count() > 48 * 48 * 9 / 10);
    data.reopens("out");
    // Scenes that were saved before a fit could choose the distribution say `Sg` beside the
    // materials.
    let saved = data.text("out/saved/scene.ron");
    let check = |ndf: &str| {
        data.write("out/saved/older.ron", changed(&saved, "ndf: Auto", ndf));
        data.lobelia(&["check", "out/saved/older.ron"])
    };
    check("ndf: Sg").succeeded();
    check("ndf: Ggx").refused(&["says all about the specular material"]);
    // The export carries the roughness as a texture.
    assert!(String::from_utf8_lossy(&data.bytes("out/export/mesh.glb")).contains("metallicRoughnessTexture"));
}

#[test]
fn each_texel_finds_its_roughness_and_keeps_it() {
    let data = Data::bare();
    data.run(&two_glosses("Texels(specular: true)"), "out", &["--quiet"]).succeeded();
    let found = &data.exr("out/fit/roughness.exr").channels["Y"];
    // The middle rows of the front (+Z) and of the back.
    let mean = |columns: Range<usize>| {
        let texels = (20..28).flat_map(|y| columns.clone().map(move |x| found[y * 48 + x]));
        texels.sum::<f32>() / (8 * columns.len()) as f32
    };
    let (front, back) = (mean(16..32), (mean(0..8) + mean(40..48)) / 2.0);
    assert!((front - 0.25).abs() < 0.05 && (back - 0.5).abs() < 0.1, "{front} {back}");
    data.reopens("out");
}

#[test]
fn blends_that_cannot_be_are_refused() {
    let data = Data::bare();
    for (gloss, words) in [
        ("Blend(materials: 9)", ["materials is 9", "2 to 4"]),
        ("Texels(color_width: 0)", ["color_width", "0"]),
        ("Texels(smoothness: -1)", ["smoothness", "-1"]),
        ("Fixed(lobes: [], weights: \"none.exr\")", ["none.exr", "lobes"]),
    ] {
        // Some have several problems.
        let said = data.check(&two_glosses(gloss));
        assert_eq!(said.code, Some(2));
        words.iter().for_each(|word| assert!(said.stderr.contains(word), "{word}: {}", said.stderr));
    }
}

/// A sphere whose upper half may be of gold.
fn metal(edits: &str) -> String {
    let light = LIGHT[..4].join(", ");
    let words = [
        ("albedo: (0.3, 0.3, 0.3), roughness: 0.3", "albedo: (0.04, 0.04, 0.04), roughness: 0.5, ndf: Ggx"),
        ("(axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.4, 0.4, 0.4)),", ""),
        ("(axis: (0.8, 0.5, 0.4), sharpness: 20, amplitude: (4, 4, 4)),", &light),
        ("lobes: 32", "lobes: 48"),
        ("steps: 200, batch: 1024", "steps: 300, batch: 512"),
    ];
    lamp(&format!("edits: [{edits}],"), "", &words)
}

const GOLD: &str = "
    Diffuse(action: Set(0.0, 0.0, 0.0), region: Box(min: (-1, 0, -1), max: (1, 1, 1))),
    Specular(action: Set(1.0, 0.7, 0.3), region: Box(min: (-1, 0, -1), max: (1, 1, 1))),
    Roughness(action: Set(0.25), region: Box(min: (-1, 0, -1), max: (1, 1, 1))),
";

/// Red and blue of the specular albedo of the least rough material.
fn glossiest(materials: &str) -> [f64; 2] {
    let numbers = |line: &str| -> Vec<f64> {
        line.split(|c: char| !(c.is_ascii_digit() || c == '.')).filter_map(|n| n.parse().ok()).collect()
    };
    let lobes = materials.lines().filter(|line| line.contains("roughness: ")).map(numbers);
    lobes.min_by(|a, b| a[3].total_cmp(&b[3])).map(|least| [least[0], least[2]]).unwrap()
}

/// The upper half of the sphere, and of its texture, is gold.
fn assert_little_diffuse_light_beneath(data: &Data, out: &str) {
    let albedo = image::open(data.path(out).join("fit/albedo.png")).unwrap().to_rgb8();
    let (width, height) = albedo.dimensions();
    let mean = |rows: Range<u32>| {
        let values = rows.clone().flat_map(|y| (0..width).flat_map(move |x| [(x, y)]));
        let sum: f64 = values.flat_map(|(x, y)| albedo.get_pixel(x, y).0).map(f64::from).sum();
        sum / f64::from(255 * 3 * width * rows.len() as u32)
    };
    let (gold, paint) = (mean(height / 8..height * 3 / 8), mean(height * 5 / 8..height * 7 / 8));
    assert!(gold < 0.45 && paint > 0.6, "{gold} {paint}");
}

#[test]
fn metal_beside_paint_gets_a_material_of_its_own_and_paint_alone_keeps_one() {
    let data = Data::bare();
    let run = |edits: &str, out: &str, settings: &[&str]| {
        data.run(&metal(edits), out, &[&["--quiet"], settings].concat()).succeeded();
        (data.metrics(out), data.text(format!("{out}/fit/materials.ron")))
    };
    let tried = |metrics: &serde_json::Value| {
        let of = |name: &str| metrics["materials_tried"][name].as_f64();
        of("several").zip(of("one")).map(|(several, one)| several / one)
    };
    let (gold, materials) = run(GOLD, "gold", &[]);
    assert!(tried(&gold).unwrap() < 0.9, "{gold}");
    let [r, b] = glossiest(&materials);
    assert!(materials.matches("roughness: ").count() == 2 && r > 2.0 * b, "{materials}");
    // The color of the gold is not that of the light, which is (0.32, 0.38, 0.47) on average.
    let light = &gold["scale"]["mean_light"];
    assert!(light[0].as_f64() < light[2].as_f64(), "{light}");
    assert_little_diffuse_light_beneath(&data, "gold");
    let (one, _) = run(GOLD, "one", &["--set", "material.gloss=One"]);
    assert!(one["materials_tried"].is_null() && data.novel("gold") > data.novel("one") + 2.0);
    let (paint, materials) = run("", "paint", &[]);
    assert_eq!(materials.matches("roughness: ").count(), 1, "{materials}");
    assert!(tried(&paint).is_none_or(|ratio| ratio > 0.9), "{paint}");
}

// Albedo that depends on the side from which it is seen.

/// Red along the surface.
const SHEEN: Vec3 = Vec3::new(0.35, -0.1, -0.1);
/// Brighter from +X.
const TILT: Vec3 = Vec3::new(0.5, 0.0, 0.0);

/// The object, with all its texels changed.
fn with_texels(mut pipeline: Pipeline, change: impl Fn(&mut Diffuse)) -> Pipeline {
    let mut texels = pipeline.world.query::<&mut Diffuse>();
    texels.iter_mut(&mut pipeline.world).for_each(|mut texel| change(&mut texel));
    pipeline
}

/// The studio, with a sheen or without.
fn cloth(sheen: Vec3) -> Pipeline {
    with_texels(studio(&day()), |texel| texel.sheen = sheen)
}

/// The studio with one albedo on all texels.
fn plain_studio(albedo: Vec3) -> Pipeline {
    painted_studio(&day(), 32, |_| albedo)
}

/// One with this tilt.
fn velvet(tilt: Vec3) -> Pipeline {
    with_texels(plain_studio(Vec3::new(0.5, 0.4, 0.3)), |texel| texel.tilt = tilt)
}

fn sum(colors: &[Vec3]) -> Vec3 {
    colors.iter().sum()
}

/// Sums of the colors of a picture in closed form, and by the path tracer.
fn both_shadings(mut pipeline: Pipeline, view: Camera) -> [Vec3; 2] {
    let closed = sum(&shoot(&mut pipeline, view).color);
    let paths = PathTracing { paths_per_sample: 64, max_bounces: 1, seed: 1, samples_per_pixel: 4 };
    pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced(paths));
    [closed, sum(&shoot(&mut pipeline, view).color)]
}

#[test]
fn closed_form_and_path_tracer_show_the_same_sheen_and_tilt() {
    let view = camera([0.2, 0.3, 1.0], 24);
    let [closed, traced] = both_shadings(cloth(SHEEN), view);
    assert!((closed.element_sum() / traced.element_sum() - 1.0).abs() < 0.03, "{closed} {traced}");
    assert!((closed.x / traced.x - 1.0).abs() < 0.03, "{closed} {traced}");
    assert!(closed.x > 1.1 * sum(&shoot(&mut cloth(Vec3::ZERO), view).color).x);
    for (eye, brighter) in [([1.0, 0.2, 0.4], true), ([-1.0, 0.2, 0.4], false)] {
        let view = camera(eye, 24);
        let [closed, traced] = both_shadings(velvet(TILT), view).map(Vec3::element_sum);
        assert!((closed / traced - 1.0).abs() < 0.03, "{closed} {traced}");
        let factor = closed / sum(&shoot(&mut velvet(Vec3::ZERO), view).color).element_sum();
        assert!(if brighter { factor > 1.03 } else { factor < 0.97 }, "{factor}");
    }
}

/// A fit of the albedo of twelve photographs of `truth` under the known light.
fn fitted_cloth(truth: Vec3, options: FitOptions, prepare: impl FnOnce(&mut World)) -> Pipeline {
    let mut pipeline = studio(&day());
    pipeline.add_plugin(&FitPlugin);
    spawn_views(&mut pipeline.world, photographs_of(&mut cloth(truth), 12, 48, |_, _| {}));
    prepare(&mut pipeline.world);
    let unknowns = Unknowns { light: false, specular_albedo: false, roughness: false, ..Unknowns::default() };
    let options = FitOptions { steps: 240, batch: 1024, unknowns, ..options };
    run_fit(&mut pipeline, &options, &mut |_, _| ControlFlow::Continue(())).unwrap();
    pipeline
}

#[test]
fn a_fit_finds_a_sheen_and_none_where_there_is_none() {
    let found = |truth: Vec3| {
        let looks = FitOptions { looks_for_sheen: true, ..FitOptions::default() };
        let mut fitted = fitted_cloth(truth, looks, |_| ());
        let texels = column::<Diffuse>(&mut fitted.world);
        let moved: Vec<Vec3> = texels.iter().map(|of| of.sheen).filter(|of| *of != Vec3::ZERO).collect();
        sum(&moved) / moved.len().max(1) as f32
    };
    let red = found(SHEEN);
    assert!((red - SHEEN).length() < 0.15, "{red}");
    assert_eq!(found(Vec3::ZERO), Vec3::ZERO);
}

#[test]
fn an_unknown_albedo_is_fitted_beside_a_known_one_along_the_surface() {
    let truth = column::<Diffuse>(&mut cloth(SHEEN).world);
    let along: Vec<Vec3> = truth.iter().map(Diffuse::along).collect();
    let initialize = Initialize { light: false, albedo: true, specular: false };
    let mut pipeline = fitted_cloth(SHEEN, FitOptions { initialize, ..FitOptions::default() }, |world| {
        world.insert_resource(KnownAlong::Texels(along.clone()));
        write_albedo(world, &vec![Vec3::splat(0.4); along.len()]).unwrap();
    });
    let world = &mut pipeline.world;
    let found = column::<Diffuse>(world);
    assert!(found.iter().zip(&along).all(|(found, along)| found.along().abs_diff_eq(*along, 1e-6)));
    let seen = column::<TexelSeen>(world);
    let well = (0..along.len()).filter(|i| seen[*i].0 > 1.0);
    let off: Vec<f32> = well.map(|i| (found[i].albedo - truth[i].albedo).abs().max_element()).collect();
    let mean = off.iter().sum::<f32>() / off.len() as f32;
    assert!(off.len() > 100 && mean < 0.03, "{mean} over {}", off.len());
}

#[test]
fn a_saved_sheen_opens_with_the_same_bits() {
    let data = Data::bare();
    let text = GRAY_SPHERE
        .replace("material: (", "material: (sheen: Fixed(Constant(0.7, 0.3, 0.1)), ")
        .replace("{PASS}", r#"Render(name: "novel"), Save(name: "saved")"#);
    data.run(&text, "out", &["--quiet"]).succeeded();
    assert!((data.exr("out/saved/albedo_along.exr").channels["R"][40] - 0.7).abs() < 1e-6);
    data.reopens("out");
    let unknown = text.replace("sheen: Fixed(Constant(0.7, 0.3, 0.1))", "sheen: Unknown");
    data.check(&unknown).refused(&["sheen: Unknown", "a fit finds both together"]);
}

/// The studio after its albedo, from gray on, and its tilt if asked for, are solved for from these
/// photographs.
fn solved(mut start: Pipeline, photographs: Vec<ViewRecord>, tilt: bool) -> Pipeline {
    start.add_plugin(&FitPlugin);
    for texel in lobelia::material::texels_in_order(&mut start.world) {
        start.world.entity_mut(texel).insert(TexelSeen::default());
    }
    spawn_views(&mut start.world, photographs);
    let options = DetailOptions { tilt, metal: false };
    let mut done = 0.0;
    solve_detail(&mut start, options, &mut |part| done = part).unwrap();
    assert_eq!(done, 1.0);
    start
}

#[test]
fn all_photographs_together_tell_the_tilt() {
    let sides = |mut pipeline: Pipeline| {
        let total = |x: f32, pipeline: &mut Pipeline| {
            sum(&shoot(pipeline, camera([x, 0.2, 0.4], 24)).color).element_sum()
        };
        total(-1.0, &mut pipeline) / total(1.0, &mut pipeline)
    };
    let [truth, plain] = [TILT, Vec3::ZERO].map(|tilt| sides(velvet(tilt)));
    assert!(truth < 0.9 * plain, "{truth} {plain}");
    let found = |truth, tilt| {
        let photographs = photographs_of(&mut velvet(truth), 40, 48, |_, _| ());
        sides(solved(velvet(Vec3::ZERO), photographs, tilt))
    };
    let tilted = found(TILT, true);
    assert!((tilted / truth - 1.0).abs() < 0.03, "{tilted} {truth}");
    let none = found(Vec3::ZERO, true);
    assert!((none / plain - 1.0).abs() < 0.01, "{none} {plain}");
    let unasked = found(TILT, false);
    assert!(unasked > 1.05 * truth, "{unasked} {truth}");
}

#[test]
fn an_edit_of_the_color_leaves_as_much_tilt_as_it_leaves_color() {
    let material = recovered_material(&mut velvet(TILT).world).unwrap();
    let after = |action: EditAction| {
        let mut state = material.clone();
        apply_edit(&mut state, EditTarget::Diffuse, &action, &EditRegion(None)).unwrap();
        state.diffuse[7].tilt
    };
    assert_eq!(after(EditAction::Scale(Vec3::splat(0.5))), TILT);
    assert_eq!(after(EditAction::Blend { value: Vec3::ONE, weight: 0.75 }), 0.25 * TILT);
    assert_eq!(after(EditAction::Set(Vec3::X)), Vec3::ZERO);
}

/// Fits textures to the photographs of a data set under the known light, with these words about the
/// fit and the material, and saves what was found.
fn fitted_texture(data: &Data, out: &str, fit: &str, material: &str) -> String {
    let passes = format!(
        r#"Fit(name: "fit", {fit}), Render(name: "novel"),
           Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]), Save(name: "saved")"#
    );
    let scene = scene(&passes).replace("Unknown(lobes: 6)", r#"Fixed(Npy(path: "$DATA/day.npy"))"#);
    data.run(&scene.replace("passes:", &format!("material: ({material}), passes:")), out, &["--quiet"])
        .succeeded();
    data.text(format!("{out}/saved/scene.ron"))
}

/// Stripes as wide as three pixels, for texels that are several pixels wide.
#[test]
fn a_finer_texture_shows_what_the_photographs_show() {
    let data = Data::new();
    let color = |at: &Vec3| {
        if (at.y / 0.05).rem_euclid(2.0) < 1.0 { Vec3::new(0.7, 0.2, 0.2) } else { Vec3::new(0.2, 0.3, 0.7) }
    };
    data.photograph(&mut painted_studio(&day(), 256, color), |from| camera(from, 120));
    let saved = fitted_texture(&data, "coarse", "steps: 100, batch: 2048", "");
    assert!(saved.contains("texture_size: 16"), "{saved}");
    let saved = fitted_texture(&data, "fine", "steps: 100, batch: 2048, detail: true", "");
    assert!(!saved.contains("texture_size: 16,") && saved.contains("texture_size: "), "{saved}");
    let [coarse, fine] = ["coarse", "fine"].map(|out| data.novel(out));
    assert!(fine > coarse + 3.0, "{coarse} {fine}");
    data.reopens("fine");
}

#[test]
fn a_saved_tilt_opens_with_the_same_bits_and_none_is_saved_where_none_is_wanted() {
    let data = Data::new();
    data.photograph(&mut velvet(TILT), |from| camera(from, 48));
    let fit = "steps: 60, batch: 1024, detail: true";
    assert!(!fitted_texture(&data, "none", fit, "tilt: None").contains("albedo_tilt.exr"));
    let saved = fitted_texture(&data, "out", fit, "tilt: Unknown");
    assert!(saved.contains(r#"tilt: Fixed("albedo_tilt.exr")"#), "{saved}");
    let vectors = data.exr("out/saved/albedo_tilt.exr");
    assert!(vectors.channels["X"].iter().any(|x| *x > 0.2));
    data.reopens("out");
    // A file of another kind is named.
    std::fs::copy(data.path("out/saved/albedo.exr"), data.path("out/saved/albedo_tilt.exr")).unwrap();
    data.run_file("out/saved/scene.ron", "bad", &[]).refused(&["albedo_tilt.exr", "has no channel X"]);
    std::fs::copy(data.path("out/saved/albedo.exr"), data.path("t.exr")).unwrap();
    let known = scene("Fit()").replace("passes:", r#"material: (tilt: Fixed("t.exr")), passes:"#);
    data.check(&known).refused(&["the tilt is said to be known"]);
}

/// The albedo of the texels that are well seen; those that no view sees stay gray.
fn well_seen(mut solved: Pipeline) -> Vec<Vec3> {
    let diffuse = column::<Diffuse>(&mut solved.world);
    let seen = column::<TexelSeen>(&mut solved.world);
    let texels = || diffuse.iter().map(|texel| texel.albedo).zip(seen.iter().map(|seen| seen.0));
    assert!(texels().filter(|texel| texel.1 == 0.0).all(|(albedo, _)| albedo == Vec3::splat(0.4)));
    texels().filter(|texel| texel.1 > 4.0).map(|texel| texel.0).collect()
}

#[test]
fn the_albedo_is_that_of_the_photographs_and_one_that_disagrees_counts_less() {
    let gray = Vec3::splat(0.4);
    for truth in [Vec3::new(0.7, 0.3, 0.1), Vec3::ONE, Vec3::ZERO] {
        let views = photographs_of(&mut plain_studio(truth), 12, 48, |_, _| ());
        let found = well_seen(solved(plain_studio(gray), views, false));
        assert!(found.len() > 100, "{}", found.len());
        let off = found.iter().map(|found| (*found - truth).abs().max_element()).fold(0.0, f32::max);
        assert!(off < 0.02, "{truth}: off by {off}");
    }
    let truth = Vec3::new(0.5, 0.3, 0.2);
    let spoil = |number: usize, frame: &mut Frame| {
        if number == 0 {
            frame.color.iter_mut().for_each(|color| *color += 4.0);
        }
    };
    let views = photographs_of(&mut plain_studio(truth), 12, 48, spoil);
    let spoiled = well_seen(solved(plain_studio(gray), views, false));
    // The plain mean of some four photographs of a texel is off by a quarter of what one of them is
    // off.
    let mean = sum(&spoiled) / spoiled.len() as f32;
    assert!((mean - truth).length() < 0.04, "{mean}");
    // Cameras that disagree with their photographs are no error.
    let mut views = photographs_of(&mut plain_studio(Vec3::splat(0.6)), 12, 48, |_, _| ());
    views.iter_mut().for_each(|view| view.camera = camera([0.0, 0.0, 1.0], 48));
    let found = well_seen(solved(plain_studio(gray), views, false));
    assert!(found.iter().all(|albedo| albedo.is_finite()));
}
