//! Whether the passes of a scene make sense, each by itself and in their order.

use crate::codec::video::has_frames_of;
use crate::math::brdf::Ndf;
use crate::scene::description::Scene;
use crate::scene::diagnostic::nearest;
use crate::scene::edit::{ColorAction, DiffuseAction, Edit, Region, ScalarAction};
use crate::scene::evaluate::{EvaluatePass, LayerTruth, Truth, VIEW};
use crate::scene::fit::{FitPass, FitShading, ShapePass};
use crate::scene::light::Light;
use crate::scene::material::{Albedo, Gloss, Roughness, SpecularAlbedo};
use crate::scene::output::{ExportPass, ExportScale};
use crate::scene::passes::{EditPass, Pass, RelightPass};
use crate::scene::render::{Orbit, OrbitFormat, RenderSettings, Shading, ViewChoice};
use crate::scene::surface::Surface;
use crate::scene::validate::checks::Checks;
use crate::scene::validate::light::light_source;
use crate::scene::views::Views;
use std::path::{Component, Path, PathBuf};

/// Most passes of a scene file.
const MOST_PASSES: usize = 1000;

/// Fewest paths per pixel of a picture whose noise is filtered away.
const LEAST_DENOISED: u32 = 4;

/// Most points of a stroke.
const MOST_STROKE_POINTS: u32 = 256;

/// Checks every pass of the scene.
pub(super) fn passes(checks: &mut Checks, scene: &Scene) {
    if scene.passes.len() > MOST_PASSES {
        let problem = format!("there are {} passes", scene.passes.len());
        return checks.fail("passes", problem, format!("expected at most {MOST_PASSES}"), "");
    }
    let mut fitted = false;
    for (index, pass) in scene.passes.iter().enumerate() {
        let (at, earlier) = (format!("passes.{index}"), &scene.passes[..index]);
        own_name(checks, &at, pass, earlier);
        settings(checks, &at, pass, scene, earlier);
        known_to_published(checks, &at, pass, scene);
        fitted |= matches!(pass, Pass::Fit(_) | Pass::Shape(_));
        if !fitted {
            nothing_unknown(checks, &at, pass, scene);
        }
    }
}

/// A pass has a name that can be a folder's, and that no earlier one has.
fn own_name(checks: &mut Checks, at: &str, pass: &Pass, earlier: &[Pass]) {
    let path = format!("{at}.name");
    checks.name(&path, pass.name());
    if earlier.iter().any(|other| other.name().eq_ignore_ascii_case(pass.name())) {
        let problem = format!("two passes are called {:?} (case does not count)", pass.name());
        let help = "A pass writes into OUT/<name>/, and some file systems do not tell cases apart.";
        checks.fail(&path, problem, "expected another name", help);
    }
}

/// Checks what a pass of its kind says.
fn settings(checks: &mut Checks, at: &str, pass: &Pass, scene: &Scene, earlier: &[Pass]) {
    match pass {
        Pass::Fit(fit) => self::fit(checks, at, fit, scene),
        Pass::Shape(shape) => self::shape(checks, at, shape, scene),
        Pass::Edit(edit) => edit_pass(checks, at, edit),
        Pass::Relight(relight) => relight_pass(checks, at, relight),
        Pass::Evaluate(evaluate) => self::evaluate(checks, at, evaluate, scene, earlier),
        Pass::Export(export) => {
            self::export(checks, at, export);
            shown_by(checks, at, export.of.as_deref(), scene);
        }
        Pass::Save(save) => shown_by(checks, at, save.of.as_deref(), scene),
        Pass::View(view) => shown_by(checks, at, view.of.as_deref(), scene),
        Pass::Render(_) => {}
    }
    if let Some(render) = pass.render() {
        self::render(checks, &format!("{at}.render"), render, &scene.views);
    }
}

/// The published formulas have the supplement's NDF alone.
fn known_to_published(checks: &mut Checks, at: &str, pass: &Pass, scene: &Scene) {
    let Some(field) = published_field(pass) else { return };
    let path = format!("{at}.{field}");
    if scene.material.specular.ndf.first() == Ndf::Ggx {
        checks.fail(
            &path,
            "`Published` shading cannot show a material with `ndf: Ggx`",
            "expected `Accurate` (or `PathTraced`) shading",
            "The published formulas know the single spherical Gaussian only; or say `ndf: Sg` in `material.specular`.",
        );
    }
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
fn nothing_unknown(checks: &mut Checks, at: &str, pass: &Pass, scene: &Scene) {
    let light = match pass {
        Pass::Render(_) | Pass::Save(_) | Pass::View(_) => true,
        Pass::Edit(edit) => edit.light.is_none(),
        Pass::Fit(_) | Pass::Shape(_) | Pass::Relight(_) | Pass::Evaluate(_) | Pass::Export(_) => false,
    };
    let unknown = unknown_parts(scene);
    let missing: Vec<&str> = unknown.into_iter().filter(|part| light || *part != "light").collect();
    if !missing.is_empty() && !matches!(pass, Pass::Evaluate(_)) {
        let problem = format!("this pass needs the {}, which nothing has found yet", missing.join(", "));
        checks.fail(
            at,
            problem,
            "expected a `Fit` before this pass",
            "Put a `Fit` pass before it, or give the values.",
        );
    }
}

/// What the scene leaves to a fit and gives no value for, in plain words.
pub fn unknown_parts(scene: &Scene) -> Vec<&'static str> {
    let mut parts = Vec::new();
    let open = scene.own_material().is_none();
    if open && matches!(scene.material.albedo, Albedo::Unknown) {
        parts.push("diffuse albedo");
    }
    let open_gloss = open && !matches!(scene.material.gloss, Gloss::Fixed { .. });
    if open_gloss && matches!(scene.material.specular.albedo, SpecularAlbedo::Unknown { .. }) {
        parts.push("specular albedo");
    }
    if open_gloss && matches!(scene.material.specular.roughness, Roughness::Unknown { .. }) {
        parts.push("roughness");
    }
    if matches!(scene.light, Light::Unknown(_)) {
        parts.push("light");
    }
    parts
}

fn shape(checks: &mut Checks, at: &str, shape: &ShapePass, scene: &Scene) {
    let path = |field: &str| format!("{at}.{field}");
    if matches!(scene.material.gloss, Gloss::Fixed { .. }) {
        let problem = "known blend weights belong to a known surface";
        checks.fail("material.gloss", problem, "expected `Auto`, `One` or `Blend(…)`", "");
    }
    if matches!(scene.material.gloss, Gloss::Texels { .. }) {
        let problem = "a surface that is still being found has no texels to give a gloss each";
        let help = "Find the shape first, export it, and fit `Texels(…)` on that mesh.";
        checks.fail("material.gloss", problem, "expected `Auto`, `One` or `Blend(…)`", help);
    }
    checks.count(&path("max_pixels"), shape.max_pixels, 1..=u32::MAX);
    checks.count(&path("batch"), shape.batch, 1..=u32::MAX);
    checks.count(&path("silhouette_batch"), shape.silhouette_batch, 1..=u32::MAX);
    checks.count(&path("blur"), shape.blur, 0..=64);
    checks.not_negative(&path("silhouette"), shape.silhouette);
    checks.not_negative(&path("smoothness"), shape.smoothness);
    checks.not_negative(&path("rates.albedo"), shape.rates.albedo);
    checks.not_negative(&path("rates.light"), shape.rates.light);
    checks.not_negative(&path("rates.specular"), shape.rates.specular);
    if shape.levels.is_empty() {
        checks.fail(&path("levels"), "there are no levels", "expected at least one grid", "");
    }
    for (i, level) in shape.levels.iter().enumerate() {
        let path = |field: &str| format!("{at}.levels[{i}].{field}");
        checks.count(&path("cells"), level.cells, 16..=512);
        checks.count(&path("texel_cells"), level.texel_cells, 8..=512);
        checks.count(&path("steps"), level.steps, 1..=u32::MAX);
        checks.number(&path("rates"), level.rates.0, 1e-6..=1.0);
        checks.number(&path("rates"), level.rates.1, 1e-6..=1.0);
        checks.not_negative(&path("pixels"), level.pixels);
    }
    if !matches!(scene.surface, Surface::Unknown { .. }) {
        let help = "Write `surface: Unknown()`, or remove the `Shape`.";
        checks.fail(at, "the surface is given", "expected a surface that is not known", help);
    }
}

fn fit(checks: &mut Checks, at: &str, fit: &FitPass, scene: &Scene) {
    let path = |field: &str| format!("{at}.{field}");
    checks.count(&path("steps"), fit.steps, 1..=u32::MAX);
    checks.count(&path("max_pixels"), fit.max_pixels, 1..=u32::MAX);
    checks.count(&path("batch"), fit.batch, 1..=u32::MAX);
    checks.not_negative(&path("rates.albedo"), fit.rates.albedo);
    checks.not_negative(&path("rates.light"), fit.rates.light);
    checks.not_negative(&path("rates.specular"), fit.rates.specular);
    let inside = fit.milestones.iter().all(|m| *m > 0.0 && *m < 1.0);
    if !inside || !fit.milestones.is_sorted_by(|a, b| a < b) {
        let problem = format!("milestones are {:?}", fit.milestones);
        checks.fail(&path("milestones"), problem, "expected rising fractions between 0 and 1", "");
    }
    checks.number(&path("decay"), fit.decay, f32::MIN_POSITIVE..=1.0);
    if matches!(scene.views, Views::Cameras(_)) {
        let help = "Use `views: Dataset(…)` or `views: Photographed(…)`, or remove the `Fit`.";
        checks.fail(at, "a fit needs photographs, and the views are cameras only", "nothing to fit to", help);
    }
    let all_fixed = unknown_parts(scene).is_empty()
        && !matches!(scene.material.albedo, Albedo::Initial(_))
        && !matches!(scene.light, Light::Initial(_));
    if all_fixed {
        checks.fail(
            at,
            "everything is fixed, so there is nothing to fit",
            "nothing to fit",
            "Remove the `Fit`.",
        );
    }
}

fn export(checks: &mut Checks, at: &str, export: &ExportPass) {
    if export.formats.is_empty() {
        let path = format!("{at}.formats");
        checks.fail(
            &path,
            "there is no format",
            "expected some of `Glb`, `Ply`, `Obj`, `Usda` and `Usdz`",
            "",
        );
    }
    let (ExportScale::Factor(scale) | ExportScale::Size(scale)) = export.scale;
    checks.positive(&format!("{at}.scale"), scale);
    if let Some(triangles) = export.triangles {
        checks.count(&format!("{at}.triangles"), triangles, 4..=u32::MAX);
    }
}

fn edit_pass(checks: &mut Checks, at: &str, pass: &EditPass) {
    if pass.edits.is_empty() {
        checks.fail(&format!("{at}.edits"), "there is no edit", "expected at least one edit", "");
    }
    edits(checks, at, &pass.edits);
    if let Some(light) = &pass.light {
        light_source(checks, &format!("{at}.light"), light);
    }
}

fn relight_pass(checks: &mut Checks, at: &str, pass: &RelightPass) {
    light_source(checks, &format!("{at}.light"), &pass.light);
    edits(checks, at, &pass.edits);
}

pub(super) fn edits(checks: &mut Checks, at: &str, edits: &[Edit]) {
    for (index, edit) in edits.iter().enumerate() {
        let at = format!("{at}.edits.{index}");
        let action = format!("{at}.action");
        match edit {
            Edit::Diffuse { action: DiffuseAction::Texture(_), .. } => {}
            Edit::Diffuse { action: DiffuseAction::Set(color), .. }
            | Edit::Specular { action: ColorAction::Set(color), .. } => checks.color(&action, *color),
            Edit::Diffuse { action: DiffuseAction::Scale(factors), .. }
            | Edit::Specular { action: ColorAction::Scale(factors), .. } => checks.factors(&action, *factors),
            Edit::Diffuse { action: DiffuseAction::Blend { color, weight }, .. }
            | Edit::Specular { action: ColorAction::Blend { color, weight }, .. } => {
                checks.color(&format!("{action}.color"), *color);
                checks.number(&format!("{action}.weight"), *weight, 0.0..=1.0);
            }
            Edit::Roughness { action: scalar, .. } => scalar_action(checks, &action, scalar),
        }
        region(checks, &format!("{at}.region"), edit);
    }
}

fn scalar_action(checks: &mut Checks, path: &str, action: &ScalarAction) {
    match action {
        ScalarAction::Set(value) => checks.roughness(path, *value),
        ScalarAction::Scale(factor) => checks.not_negative(path, *factor),
        ScalarAction::Blend { value, weight } => {
            checks.roughness(&format!("{path}.value"), *value);
            checks.number(&format!("{path}.weight"), *weight, 0.0..=1.0);
        }
    }
}

fn region(checks: &mut Checks, path: &str, edit: &Edit) {
    match edit.region() {
        Region::All | Region::Mask(_) => {}
        Region::Box { min, max, falloff } => {
            checks.not_negative(&format!("{path}.falloff"), *falloff);
            checks.finite(&format!("{path}.min"), *min);
            checks.finite(&format!("{path}.max"), *max);
            if min.cmpgt(*max).any() {
                let path = format!("{path}.max");
                checks.fail(
                    &path,
                    "the box is inside out",
                    format!("expected no number below min's {min}"),
                    "",
                );
            }
        }
        Region::Sphere { center, radius, falloff } => {
            checks.not_negative(&format!("{path}.falloff"), *falloff);
            checks.finite(&format!("{path}.center"), *center);
            checks.positive(&format!("{path}.radius"), *radius);
        }
        Region::Stroke { points, radius, falloff } => {
            checks.not_negative(&format!("{path}.falloff"), *falloff);
            checks.positive(&format!("{path}.radius"), *radius);
            let count = u32::try_from(points.len()).unwrap_or(u32::MAX);
            checks.count(&format!("{path}.points"), count, 1..=MOST_STROKE_POINTS);
            for (index, point) in points.iter().enumerate() {
                checks.place(&format!("{path}.points.{index}"), *point);
            }
        }
    }
}

fn render(checks: &mut Checks, at: &str, render: &RenderSettings, views: &Views) {
    let path = |field: &str| format!("{at}.{field}");
    checks.count(&path("samples_per_pixel"), render.samples_per_pixel, 1..=1024);
    checks.number(&path("exposure"), render.exposure, -20.0..=20.0);
    if let Shading::PathTraced { spp, max_bounces, denoise, .. } = render.shading {
        if denoise && spp < LEAST_DENOISED {
            checks.fail(
                &path("shading.denoise"),
                format!("{spp} paths per pixel do not tell how much noise there is"),
                format!("expected `spp` to be at least {LEAST_DENOISED}"),
                "Give more paths, e.g. `spp: 16`, or leave `denoise` out.",
            );
        }
        checks.count(&path("shading.spp"), spp, 1..=65536);
        checks.count(&path("shading.max_bounces"), max_bounces, 1..=64);
    }
    if let Some(orbit) = &render.orbit {
        self::orbit(checks, &path("orbit"), orbit);
    }
    if let (ViewChoice::Named(names), Views::Cameras(cameras)) = (&render.views, views) {
        let known = || cameras.iter().map(|camera| camera.name.as_str());
        for name in names.iter().filter(|name| known().all(|k| k != name.as_str())) {
            let help = listing("views", name, known());
            checks.fail(&path("views"), format!("there is no view called {name:?}"), "not a view", help);
        }
    }
}

fn orbit(checks: &mut Checks, at: &str, orbit: &Orbit) {
    let path = |field: &str| format!("{at}.{field}");
    checks.count(&path("frames"), orbit.frames, 1..=10_000);
    if let Some((first, count)) = orbit.part
        && (count == 0 || first.checked_add(count).is_none_or(|end| end > orbit.frames))
    {
        let expected =
            format!("expected frames from 0 to {}, and at least one", orbit.frames.saturating_sub(1));
        checks.fail(
            &path("part"),
            format!("({first}, {count}) is no part of the film"),
            expected,
            "Give the first frame and how many, e.g. (0, 24).",
        );
    }
    checks.number(&path("elevation_degrees"), orbit.elevation_degrees, -89.0..=89.0);
    if let Some(radius) = orbit.radius {
        checks.distance(&path("radius"), radius);
    }
    checks.fov(&path("fov_degrees"), orbit.fov_degrees);
    checks.pixels(&path("size"), orbit.size);
    for (name, side) in [("width", orbit.width), ("height", orbit.height)] {
        if let Some(side) = side {
            checks.pixels(&path(name), side);
        }
    }
    if orbit.format == OrbitFormat::Mp4 && !has_frames_of(orbit.sides()) {
        let [width, height] = orbit.sides();
        let help = "8192 × 4320 is the largest common size; `format: Frames` writes PNG files of any.";
        let expected = "expected at most 35.6 megapixels";
        checks.fail(at, format!("no video has frames of {width} × {height} pixels"), expected, help);
    }
    checks.count(&path("fps"), orbit.fps, 1..=100);
    super::film::film(checks, at, orbit);
}

fn evaluate(checks: &mut Checks, at: &str, evaluate: &EvaluatePass, scene: &Scene, earlier: &[Pass]) {
    let EvaluatePass { scores, albedo, normal, mesh, .. } = evaluate;
    if scores.is_empty() && albedo.is_none() && normal.is_none() && mesh.is_none() {
        let help = "Name passes to score, e.g. `scores: [(pass: \"novel\", truth: Photographs)]`.";
        checks.fail(at, "this pass scores nothing", "expected `scores`, `albedo`, `normal` or `mesh`", help);
    }
    let self_made = matches!(scene.views, Views::Photographed(_));
    for (index, score) in evaluate.scores.iter().enumerate() {
        let at = format!("{at}.scores.{index}");
        let rendered = || earlier.iter().filter(|pass| pass.render().is_some()).map(Pass::name);
        if rendered().all(|name| name != score.pass) {
            let problem = format!("no earlier pass called {:?} renders images", score.pass);
            let help = listing("earlier passes that render", &score.pass, rendered());
            checks.fail(&format!("{at}.pass"), problem, "expected an earlier Render, Edit or Relight", help);
        }
        let truth = format!("{at}.truth");
        file_of_view(checks, &truth, score.truth.files());
        match score.truth {
            Truth::Photographs if matches!(scene.views, Views::Cameras(_)) => {
                checks.fail(&truth, "the views are cameras only", "there are no photographs", "");
            }
            Truth::SelfMade { spp } => {
                checks.count(&format!("{truth}.spp"), spp, 1..=65536);
                needs_self_made(checks, &truth, self_made);
            }
            Truth::Photographs | Truth::Folder(_) | Truth::Files { .. } => {}
        }
    }
    for (field, truth) in [("albedo", &evaluate.albedo), ("normal", &evaluate.normal)] {
        let at = format!("{at}.{field}");
        file_of_view(checks, &at, truth.as_ref().and_then(LayerTruth::files));
        if matches!(truth, Some(LayerTruth::SelfMade)) {
            needs_self_made(checks, &at, self_made);
        }
    }
}

/// The path of a file of each view lies below its folder, and says which view it is of.
fn file_of_view(checks: &mut Checks, at: &str, files: Option<(&PathBuf, Option<&str>)>) {
    let Some((folder, Some(file))) = files else { return };
    let is_below =
        Path::new(file).components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    let help = format!("For the views of {}, write `file: \"{VIEW}/albedo.png\"`.", folder.display());
    if !file.contains(VIEW) {
        let expected = format!("a path with `{VIEW}`, which stands for the name of a view");
        checks.fail(&format!("{at}.file"), format!("{file:?} is one file for all views"), expected, help);
    } else if !is_below {
        let problem = format!("{file:?} does not lie in `folder`");
        checks.fail(&format!("{at}.file"), problem, "expected a path from there, without `..`", help);
    }
}

/// What is saved or exported as a pass shows it must name a pass that shows something else than what was found.
fn shown_by(checks: &mut Checks, at: &str, of: Option<&str>, scene: &Scene) {
    let Some(of) = of else { return };
    let shows = |pass: &&Pass| matches!(pass, Pass::Edit(_) | Pass::Relight(_));
    let names = || scene.passes.iter().filter(shows).map(Pass::name);
    if names().all(|name| name != of) {
        let problem = format!("no Edit or Relight pass is called {of:?}");
        let help = listing("passes that edit or relight", of, names());
        checks.fail(&format!("{at}.of"), problem, "expected the name of an Edit or Relight pass", help);
    }
}

fn needs_self_made(checks: &mut Checks, path: &str, self_made: bool) {
    if !self_made {
        let help = "Give a folder of true images: `Folder(\"…\")`.";
        checks.fail(path, "only `Photographed` views have a self-made truth", "there is no such truth", help);
    }
}

fn listing<'a>(kind: &str, found: &str, names: impl Iterator<Item = &'a str> + Clone) -> String {
    let all = names.clone().collect::<Vec<_>>().join(", ");
    match nearest(found, names) {
        Some(name) => format!("Did you mean {name:?}? The {kind}: {all}."),
        None if all.is_empty() => format!("There are no {kind}."),
        None => format!("The {kind}: {all}."),
    }
}
