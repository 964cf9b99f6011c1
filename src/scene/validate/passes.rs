//! Whether the passes of a scene make sense, each by itself and in their order.

use crate::scene::{
    Albedo, ColorAction, Edit, EvaluatePass, ExportPass, ExportScale, FitPass, FitShading, Gloss, LayerTruth,
    Light, Orbit, Pass, Rates, Region, RenderSettings, Roughness, ScalarAction, Scene, Shading, ShapePass,
    SpecularAlbedo, Surface, Truth, VIEW, Views, validate::Place, validate::light_source,
};
use lobelia_io::codec::nearby::closest;
use lobelia_sg::brdf::Ndf;
use std::path::{Component, Path, PathBuf};

/// Most passes of a scene file.
const MOST_PASSES: usize = 1000;
/// Most points of a stroke.
const MOST_STROKE_POINTS: usize = 256;

/// Checks every pass of the scene.
pub(super) fn passes(at: &Place, scene: &mut Scene) {
    if scene.passes.len() > MOST_PASSES {
        let problem = format!("there are {} passes", scene.passes.len());
        return at.fail(problem, format!("expected at most {MOST_PASSES}"), "");
    }
    // Passes change, as paths are resolved in place; the rest of the scene does not.
    let mut passes = std::mem::take(&mut scene.passes);
    let shows = |pass: &&Pass| matches!(pass, Pass::Edit(_) | Pass::Relight(_));
    let shown: Vec<String> = passes.iter().filter(shows).map(|pass| pass.name().to_owned()).collect();
    let mut fitted = false;
    for index in 0..passes.len() {
        let at = at.at(index);
        let (earlier, rest) = passes.split_at_mut(index);
        let pass = &mut rest[0];
        let is_taken = earlier.iter().any(|other| other.name().eq_ignore_ascii_case(pass.name()));
        let help = "A pass writes into OUT/<name>/, and some file systems do not tell cases apart.";
        at.name(pass.name(), "passes", is_taken, help);
        match pass {
            Pass::Fit(pass) => fit(&at, pass, scene),
            Pass::Shape(pass) => shape(&at, pass, scene),
            Pass::Render(pass) if !pass.edits.is_empty() || pass.light.is_some() => {
                at.fail("this pass changes the object", "expected `Edit` or `Relight`", "");
            }
            Pass::Edit(pass) if pass.edits.is_empty() => {
                at.at("edits").fail("there is no edit", "expected at least one edit", "");
            }
            Pass::Relight(pass) if pass.light.is_none() => {
                at.at("light").fail("there is no light", "expected a light, such as `Map(path: …)`", "");
            }
            Pass::Render(_) | Pass::Edit(_) | Pass::Relight(_) => {}
            Pass::Evaluate(pass) => evaluate(&at, pass, &scene.views, earlier),
            Pass::Export(pass) => {
                export(&at, pass);
                shown_by(&at, pass.of.as_deref(), &shown);
            }
            Pass::Save(pass) => shown_by(&at, pass.of.as_deref(), &shown),
            Pass::View(pass) => shown_by(&at, pass.of.as_deref(), &shown),
        }
        if let Pass::Render(pass) | Pass::Edit(pass) | Pass::Relight(pass) = pass {
            edits(&at, &mut pass.edits);
            pass.light.iter_mut().for_each(|light| light_source(&at.at("light"), light));
            render(&at.at("render"), &pass.render);
        }
        // The published formulas have the supplement's NDF alone.
        let is_ggx = scene.material.specular.ndf.first() == Ndf::Ggx;
        if let Some(field) = published_field(pass).filter(|_| is_ggx) {
            let problem = "`Published` shading cannot show a material with `ndf: Ggx`";
            let help = "The published formulas know the single spherical Gaussian only; or say `ndf: Sg` in `material.specular`.";
            at.at(field).fail(problem, "expected `Accurate` (or `PathTraced`) shading", help);
        }
        fitted |= matches!(pass, Pass::Fit(_) | Pass::Shape(_));
        if !fitted {
            nothing_unknown(&at, pass, scene);
        }
    }
    scene.passes = passes;
}

/// The field in which a pass says `Published`, if it does.
fn published_field(pass: &Pass) -> Option<&'static str> {
    match pass {
        Pass::Fit(fit) if fit.shading == FitShading::Published => Some("shading"),
        Pass::Shape(shape) if shape.shading == FitShading::Published => Some("shading"),
        _ => pass.render().filter(|r| r.shading == Shading::Published).map(|_| "render.shading"),
    }
}

/// Whether a pass of the scene uses the published formulas, which know no GGX.
pub(crate) fn uses_published(scene: &Scene) -> bool {
    scene.passes.iter().any(|pass| published_field(pass).is_some())
}

/// Before a fit, a pass can only use what the scene file says.
fn nothing_unknown(at: &Place, pass: &Pass, scene: &Scene) {
    let light = match pass {
        Pass::Evaluate(_) => return,
        Pass::Save(_) | Pass::View(_) => true,
        Pass::Render(pass) | Pass::Edit(pass) | Pass::Relight(pass) => pass.light.is_none(),
        Pass::Fit(_) | Pass::Shape(_) | Pass::Export(_) => false,
    };
    let unknown = unknown_parts(scene);
    let missing: Vec<&str> = unknown.into_iter().filter(|part| light || *part != "light").collect();
    if !missing.is_empty() {
        let problem = format!("this pass needs the {}, which nothing has found yet", missing.join(", "));
        let help = "Put a `Fit` pass before it, or give the values.";
        at.fail(problem, "expected a `Fit` before this pass", help);
    }
}

/// Names the parts that the scene leaves to a fit and gives no value for, in plain words.
pub fn unknown_parts(scene: &Scene) -> Vec<&'static str> {
    let material = &scene.material;
    let open = scene.own_material().is_none();
    let open_gloss = open && !matches!(material.gloss, Gloss::Fixed { .. });
    let parts = [
        ("diffuse albedo", open && matches!(material.albedo, Albedo::Unknown)),
        ("specular albedo", open_gloss && matches!(material.specular.albedo, SpecularAlbedo::Unknown { .. })),
        ("roughness", open_gloss && matches!(material.specular.roughness, Roughness::Unknown { .. })),
        ("light", matches!(scene.light, Light::Unknown(_))),
    ];
    parts.into_iter().filter(|part| part.1).map(|part| part.0).collect()
}

fn rates(at: &Place, rates: &Rates) {
    at.not_negative("albedo", rates.albedo);
    at.not_negative("light", rates.light);
    at.not_negative("specular", rates.specular);
}

fn shape(at: &Place, shape: &ShapePass, scene: &Scene) {
    let place = Place { path: "material.gloss".to_owned(), ..at.clone() };
    let gloss = |problem, help| place.fail(problem, "expected `Auto`, `One` or `Blend(…)`", help);
    match scene.material.gloss {
        Gloss::Fixed { .. } => gloss("known blend weights belong to a known surface", ""),
        Gloss::Texels { .. } => gloss(
            "a surface that is still being found has no texels to give a gloss each",
            "Find the shape first, export it, and fit `Texels(…)` on that mesh.",
        ),
        _ => {}
    }
    at.count("max_pixels", shape.max_pixels, 1..=u32::MAX);
    at.count("batch", shape.batch, 1..=u32::MAX);
    at.count("silhouette_batch", shape.silhouette_batch, 1..=u32::MAX);
    at.count("blur", shape.blur, 0..=64);
    at.not_negative("silhouette", shape.silhouette);
    at.not_negative("smoothness", shape.smoothness);
    rates(&at.at("rates"), &shape.rates);
    if shape.levels.is_empty() {
        at.at("levels").fail("there are no levels", "expected at least one grid", "");
    }
    for (i, level) in shape.levels.iter().enumerate() {
        let at = at.at("levels").at(i);
        at.count("cells", level.cells, 16..=512);
        at.count("texel_cells", level.texel_cells, 8..=512);
        at.count("steps", level.steps, 1..=u32::MAX);
        at.number("rates", level.rates.0, 1e-6..=1.0);
        at.number("rates", level.rates.1, 1e-6..=1.0);
        at.not_negative("pixels", level.pixels);
    }
    if !matches!(scene.surface, Surface::Unknown { .. }) {
        let help = "Write `surface: Unknown()`, or remove the `Shape`.";
        at.fail("the surface is given", "expected a surface that is not known", help);
    }
}

fn fit(at: &Place, fit: &FitPass, scene: &Scene) {
    at.count("steps", fit.steps, 1..=u32::MAX);
    at.count("max_pixels", fit.max_pixels, 1..=u32::MAX);
    at.count("batch", fit.batch, 1..=u32::MAX);
    rates(&at.at("rates"), &fit.rates);
    let inside = fit.milestones.iter().all(|m| *m > 0.0 && *m < 1.0);
    if !inside || !fit.milestones.is_sorted_by(|a, b| a < b) {
        let problem = format!("milestones are {:?}", fit.milestones);
        at.at("milestones").fail(problem, "expected rising fractions between 0 and 1", "");
    }
    at.number("decay", fit.decay, f32::MIN_POSITIVE..=1.0);
    let cannot = |problem: &str, help: &str| at.fail(problem, "nothing to fit", help);
    if matches!(scene.views, Views::Cameras(_)) {
        cannot(
            "a fit needs photographs, and the views are cameras only",
            "Use `views: Dataset(…)` or `views: Photographed(…)`, or remove the `Fit`.",
        );
    }
    let (light, albedo) = (&scene.light, &scene.material.albedo);
    let is_initial = matches!((light, albedo), (Light::Initial(_), _) | (_, Albedo::Initial(_)));
    if unknown_parts(scene).is_empty() && !is_initial {
        cannot("everything is fixed, so there is nothing to fit", "Remove the `Fit`.");
    }
}

fn export(at: &Place, export: &ExportPass) {
    if export.formats.is_empty() {
        at.at("formats").fail("there is no format", "expected some of `Glb`, `Usda` and `Usdz`", "");
    }
    let (ExportScale::Factor(scale) | ExportScale::Size(scale)) = export.scale;
    at.positive("scale", scale);
    if let Some(triangles) = export.triangles {
        at.count("triangles", triangles, 4..=u32::MAX);
    }
}

/// Checks the `edits` of a place.
pub(super) fn edits(at: &Place, edits: &mut [Edit]) {
    for (index, edit) in edits.iter_mut().enumerate() {
        let at = at.at("edits").at(index);
        let action = at.at("action");
        match edit {
            Edit::Specular { action: ColorAction::Texture(_), .. } => {
                action.fail("a texture is no specular albedo", "expected `Set`, `Scale` or `Blend`", "");
            }
            Edit::Diffuse { action: of, .. } | Edit::Specular { action: of, .. } => match of {
                ColorAction::Set(color) => at.color("action", *color),
                ColorAction::Scale(factors) => at.factors("action", *factors),
                ColorAction::Blend { color, weight } => {
                    action.color("color", *color);
                    action.number("weight", *weight, 0.0..=1.0);
                }
                ColorAction::Texture(path) => action.file("0", path),
            },
            Edit::Roughness { action: ScalarAction::Set(value), .. } => at.roughness("action", *value),
            Edit::Roughness { action: ScalarAction::Scale(factor), .. } => at.not_negative("action", *factor),
            Edit::Roughness { action: ScalarAction::Blend { value, weight }, .. } => {
                action.roughness("value", *value);
                action.number("weight", *weight, 0.0..=1.0);
            }
        }
        let (Edit::Diffuse { region, .. } | Edit::Specular { region, .. } | Edit::Roughness { region, .. }) =
            edit;
        self::region(&at.at("region"), region);
    }
}

fn region(at: &Place, region: &mut Region) {
    let falloff = match region {
        Region::All => return,
        Region::Mask(path) => return at.file("0", path),
        Region::Box { min, max, falloff } => {
            at.finite("min", *min);
            at.finite("max", *max);
            if min.cmpgt(*max).any() {
                let expected = format!("expected no number below min's {min}");
                at.at("max").fail("the box is inside out", expected, "");
            }
            falloff
        }
        Region::Sphere { center, radius, falloff } => {
            at.finite("center", *center);
            at.positive("radius", *radius);
            falloff
        }
        Region::Stroke { points, radius, falloff } => {
            at.positive("radius", *radius);
            at.length("points", points, MOST_STROKE_POINTS);
            for (index, point) in points.iter().enumerate() {
                at.at("points").point(&index.to_string(), *point);
            }
            falloff
        }
    };
    at.not_negative("falloff", *falloff);
}

pub(super) fn render(at: &Place, render: &RenderSettings) {
    at.count("samples_per_pixel", render.samples_per_pixel, 1..=1024);
    at.number("exposure", render.exposure, -20.0..=20.0);
    if let Shading::PathTraced { spp, max_bounces, .. } = render.shading {
        at.at("shading").count("spp", spp, 1..=65536);
        at.at("shading").count("max_bounces", max_bounces, 1..=64);
    }
    if let Some(orbit) = &render.orbit {
        self::orbit(&at.at("orbit"), orbit);
    }
}

fn orbit(at: &Place, orbit: &Orbit) {
    const DEGREES: f32 = 36_000.0;
    at.count("frames", orbit.frames, 1..=10_000);
    at.number("elevation_degrees", orbit.elevation_degrees, -89.0..=89.0);
    orbit.radius.iter().for_each(|radius| at.distance("radius", *radius));
    at.fov(orbit.fov_degrees);
    at.pixels("size", orbit.size);
    for (name, side) in [("width", orbit.width), ("height", orbit.height)] {
        side.iter().for_each(|side| at.pixels(name, *side));
    }
    at.count("fps", orbit.fps, 1..=100);
    let mut earliest = 0.0;
    for (i, key) in orbit.keys.iter().enumerate() {
        let at = at.at("keys").at(i);
        at.number("at", key.at, earliest..=1.0);
        earliest = key.at;
        key.angle_degrees.iter().for_each(|angle| at.number("angle_degrees", *angle, -DEGREES..=DEGREES));
        key.elevation_degrees.iter().for_each(|angle| at.number("elevation_degrees", *angle, -89.0..=89.0));
        key.radius.iter().for_each(|radius| at.distance("radius", *radius));
        if [key.angle_degrees, key.elevation_degrees, key.radius].iter().all(Option::is_none) {
            let expected = "expected some of `angle_degrees`, `elevation_degrees` and `radius`";
            at.fail("this key gives no value", expected, "");
        }
    }
    if let Some(sweep) = &orbit.light {
        let at = at.at("light");
        sweep.axis.iter().for_each(|axis| at.direction("axis", *axis));
        at.number("from_degrees", sweep.from_degrees, -DEGREES..=DEGREES);
        at.number("to_degrees", sweep.to_degrees, -DEGREES..=DEGREES);
    }
    if let Some(sweep) = &orbit.material {
        let pairs = [("roughness", sweep.roughness), ("albedo", sweep.albedo), ("specular", sweep.specular)];
        for (field, (from, to)) in pairs {
            at.at("material").not_negative(field, from);
            at.at("material").not_negative(field, to);
        }
    }
}

fn evaluate(at: &Place, evaluate: &mut EvaluatePass, views: &Views, earlier: &[Pass]) {
    let EvaluatePass { scores, albedo, normal, mesh, .. } = evaluate;
    if scores.is_empty() && albedo.is_none() && normal.is_none() && mesh.is_none() {
        let help = "Name passes to score, e.g. `scores: [(pass: \"novel\", truth: Photographs)]`.";
        at.fail("this pass scores nothing", "expected `scores`, `albedo`, `normal` or `mesh`", help);
    }
    let needs_self_made = |at: &Place| {
        if !matches!(views, Views::Photographed(_)) {
            let problem = "only `Photographed` views have a self-made truth";
            let help = "Give a folder of true images: `Folder(\"…\")`.";
            at.fail(problem, "there is no such truth", help);
        }
    };
    for (index, score) in scores.iter_mut().enumerate() {
        let at = at.at("scores").at(index);
        let rendered = || earlier.iter().filter(|pass| pass.render().is_some()).map(Pass::name);
        if rendered().all(|name| name != score.pass) {
            let problem = format!("no earlier pass called {:?} renders images", score.pass);
            let help = listing("earlier passes that render", &score.pass, rendered());
            at.at("pass").fail(problem, "expected an earlier Render, Edit or Relight", help);
        }
        let at = at.at("truth");
        match &mut score.truth {
            Truth::Photographs => {}
            Truth::SelfMade { spp } => {
                at.count("spp", *spp, 1..=65536);
                needs_self_made(&at);
            }
            Truth::Folder(folder) => at.folder("0", folder),
            Truth::Files { folder, file } => files_of_views(&at, folder, file),
        }
    }
    for (field, truth) in [("albedo", albedo), ("normal", normal)] {
        let at = at.at(field);
        match truth {
            None => {}
            Some(LayerTruth::SelfMade) => needs_self_made(&at),
            Some(LayerTruth::Folder(folder)) => at.folder("0", folder),
            Some(LayerTruth::Files { folder, file }) => files_of_views(&at, folder, file),
        }
    }
    mesh.iter_mut().for_each(|path| at.file("mesh", path));
}

/// The path of a file of each view lies below its folder, and says which view it is of.
fn files_of_views(at: &Place, folder: &mut PathBuf, file: &str) {
    let below = Path::new(file).components().all(|of| matches!(of, Component::Normal(_) | Component::CurDir));
    let help = format!("For the views of {}, write `file: \"{VIEW}/albedo.png\"`.", folder.display());
    if !file.contains(VIEW) {
        let expected = format!("a path with `{VIEW}`, which stands for the name of a view");
        at.at("file").fail(format!("{file:?} is one file for all views"), expected, help);
    } else if !below {
        let problem = format!("{file:?} does not lie in `folder`");
        at.at("file").fail(problem, "expected a path from there, without `..`", help);
    }
    at.folder("folder", folder);
}

/// Checks that `of`, whose object is saved or exported, names one of the Edit and Relight passes.
fn shown_by(at: &Place, of: Option<&str>, shown: &[String]) {
    let names = || shown.iter().map(String::as_str);
    if let Some(of) = of.filter(|of| names().all(|name| name != *of)) {
        let problem = format!("no Edit or Relight pass is called {of:?}");
        let help = listing("passes that edit or relight", of, names());
        at.at("of").fail(problem, "expected the name of an Edit or Relight pass", help);
    }
}

fn listing<'a>(kind: &str, found: &str, names: impl Iterator<Item = &'a str> + Clone) -> String {
    let all = names.clone().collect::<Vec<_>>().join(", ");
    match closest(found, names).first() {
        Some(name) => format!("Did you mean {name:?}? The {kind}: {all}."),
        None if all.is_empty() => format!("There are no {kind}."),
        None => format!("The {kind}: {all}."),
    }
}
