//! Whether the values of a scene make sense: ranges, counts, names, and passes that need one another.
//!
//! What the types already rule out is not repeated here, and files are looked for in [`crate::scene::paths`].

mod checks;
mod film;
mod light;
pub mod passes;

pub use checks::MIN_ROUGHNESS;

use crate::codec::image::Gamma;
use crate::fit::scale::ScaleRule;
use crate::material::MAX_SPECULAR_LOBES;
use crate::mesh::MAX_COORDINATE;
use crate::scene::description::{Scene, VERSION};
use crate::scene::diagnostic::Problem;
use crate::scene::material::{
    Albedo, AlbedoSource, Gloss, Material, NdfChoice, Roughness, Sheen, Specular, SpecularAlbedo, Tilt,
};
use crate::scene::photographed::{Pattern, Photographed};
use crate::scene::surface::Surface;
use crate::scene::validate::checks::Checks;
use crate::scene::validate::light::{light, light_frame, light_source, other_lights};
use crate::scene::views::{CameraSpec, Dataset, PlacementSpec, Views};
use crate::scene::visibility::Visibility;
use glam::Vec3;
use std::collections::BTreeSet;

/// Least radius or edge length of a primitive, in world units.
const MIN_LENGTH: f32 = 1e-9;
/// The greatest weight of a prior.
const MOST_PRIOR: f32 = 100.0;

/// Most cameras of a scene file: as many as one that is saved can have.
const MOST_CAMERAS: usize = 20_000;

/// Every value of the scene that makes no sense.
pub fn check(scene: &Scene) -> Vec<Problem> {
    let mut checks = Checks { problems: Vec::new() };
    if scene.version != VERSION {
        checks.fail("version", format!("version is {}", scene.version), format!("expected {VERSION}"), "");
    }
    checks.direction("up", scene.up);
    surface(&mut checks, &scene.surface);
    if matches!((&scene.surface, &scene.views), (Surface::Unknown { .. }, views) if !matches!(views, Views::Dataset(_)))
    {
        let expected = "expected a known surface, or views with photographs: Dataset(…)";
        checks.fail("surface", "an unknown surface without photographs", expected, "");
    }
    views(&mut checks, &scene.views);
    light(&mut checks, &scene.light);
    light_frame(&mut checks, "light_frame", scene.light_frame);
    other_lights(&mut checks, &scene.views, &scene.light);
    material(&mut checks, &scene.material);
    if scene.own_material().is_some() && scene.material != Material::default() {
        let help = "Remove `material`, or `own_material` from the surface.";
        checks.fail("material", "the mesh's own material is taken", "expected no other material", help);
    }
    scale(&mut checks, scene.scale);
    visibility(&mut checks, scene.visibility);
    passes::passes(&mut checks, scene);
    checks.problems
}

fn surface(checks: &mut Checks, surface: &Surface) {
    let texture_size = match surface {
        Surface::Mesh { texture_size, .. } => *texture_size,
        Surface::Unknown { cells, texture_size } => {
            checks.count("surface.cells", *cells, 16..=256);
            *texture_size
        }
        Surface::Sphere { center, radius, texture_size } => {
            checks.place("surface.center", *center);
            checks.number("surface.radius", *radius, MIN_LENGTH..=MAX_COORDINATE);
            *texture_size
        }
        Surface::Box { center, size, texture_size } => {
            checks.place("surface.center", *center);
            let ok = size.min_element() >= MIN_LENGTH && size.max_element() <= MAX_COORDINATE;
            let expected = format!("three numbers from {MIN_LENGTH:e} to {MAX_COORDINATE:e}");
            checks.require(ok, "surface.size", *size, &expected);
            *texture_size
        }
    };
    checks.count("surface.texture_size", texture_size, 8..=4096);
}

fn visibility(checks: &mut Checks, visibility: Visibility) {
    if let Visibility::Traced { directions, bounces, refresh_every } = visibility {
        checks.count("visibility.directions", directions, 64..=4096);
        checks.count("visibility.bounces", bounces, 0..=8);
        checks.count("visibility.refresh_every", refresh_every, 1..=u32::MAX);
    }
}

fn views(checks: &mut Checks, views: &Views) {
    match views {
        Views::Dataset(dataset) => self::dataset(checks, dataset),
        Views::Cameras(cameras) => self::cameras(checks, cameras),
        Views::Photographed(photographed) => self::photographed(checks, photographed),
    }
}

fn dataset(checks: &mut Checks, dataset: &Dataset) {
    if let Some(center) = dataset.pixel_center {
        checks.number("views.pixel_center", center, 0.0..=1.0);
    }
    checks.number("views.focal_scale", dataset.focal_scale, 0.5..=2.0);
    checks.count("views.downscale", dataset.downscale, 1..=1024);
    checks.count("views.every", dataset.every, 1..=u32::MAX);
    let expected = "0, for no test split, or a whole number from 2";
    checks.require(dataset.hold_out != 1, "views.hold_out", dataset.hold_out, expected);
    gamma(checks, "views.gamma", dataset.gamma);
    placements(checks, &dataset.placements);
    if let Some(prior) = &dataset.priors.albedo {
        gamma(checks, "views.priors.albedo.gamma", prior.gamma);
    }
    if let Some(prior) = &dataset.priors.normals {
        checks.number("views.priors.normals.weight", prior.weight, 0.0..=MOST_PRIOR);
    }
}

fn placements(checks: &mut Checks, placements: &[PlacementSpec]) {
    for (i, placement) in placements.iter().enumerate() {
        let path = format!("views.placements[{i}]");
        let named = format!("{path}.photographs");
        let name = placement.photographs.as_str();
        checks.require(!name.is_empty(), &named, "nothing", "a folder, or what names begin with");
        let is_new = placements[..i].iter().all(|other| other.photographs != name);
        checks.require(is_new, &named, name, "a name of its own");
        if let Some(turned) = placement.turned_degrees {
            let path = format!("{path}.turned_degrees");
            checks.finite(&path, turned);
            let expected = "nothing: others are turned relative to the first placement";
            checks.require(i > 0 || turned == Vec3::ZERO, &path, turned, expected);
        }
    }
}

fn gamma(checks: &mut Checks, path: &str, gamma: Gamma) {
    if let Gamma::Power(exponent) = gamma {
        checks.require(exponent > 0.0 && exponent <= 5.0, path, exponent, "an exponent above 0, at most 5");
    }
}

fn cameras(checks: &mut Checks, cameras: &[CameraSpec]) {
    if !(1..=MOST_CAMERAS).contains(&cameras.len()) {
        let expected = format!("expected 1 to {MOST_CAMERAS} cameras");
        return checks.fail("views", format!("there are {} cameras", cameras.len()), expected, "");
    }
    let mut names = BTreeSet::new();
    for (index, camera) in cameras.iter().enumerate() {
        // `views` is the wrapper `Cameras([…])`, whose only item is the list.
        let path = |field: &str| format!("views.0.{index}.{field}");
        checks.name(&path("name"), &camera.name);
        if !names.insert(camera.name.to_lowercase()) {
            let problem = format!("two cameras are called {:?} (case does not count)", camera.name);
            checks.fail(
                &path("name"),
                problem,
                "expected another name",
                "Output files carry the view's name, and some file systems do not tell cases apart.",
            );
        }
        checks.place(&path("eye"), camera.eye);
        checks.place(&path("target"), camera.target);
        checks.direction(&path("up"), camera.up);
        let forward = camera.target - camera.eye;
        checks.require(forward != Vec3::ZERO, &path("eye"), camera.eye, "another point than the target");
        if let (Some(forward), Some(up)) = (forward.try_normalize(), camera.up.try_normalize())
            && forward.cross(up).length() < 1e-4
        {
            checks.fail(&path("up"), "up is along the line of sight", "expected another direction", "");
        }
        checks.fov(&path("fov_degrees"), camera.fov_degrees);
        checks.pixels(&path("width"), camera.width);
        checks.pixels(&path("height"), camera.height);
    }
}

fn photographed(checks: &mut Checks, photographed: &Photographed) {
    let ring = &photographed.cameras;
    checks.count("views.cameras.count", ring.count, 1..=10_000);
    checks.count("views.cameras.test", ring.test, 0..=10_000);
    checks.place("views.cameras.target", ring.target);
    checks.distance("views.cameras.radius", ring.radius);
    checks.fov("views.cameras.fov_degrees", ring.fov_degrees);
    checks.pixels("views.cameras.size", ring.size);
    checks.count("views.spp", photographed.spp, 1..=65536);
    checks.count("views.max_bounces", photographed.max_bounces, 1..=64);
    let truth = &photographed.truth;
    pattern(checks, &truth.albedo);
    checks.color("views.truth.specular.albedo", truth.specular.albedo);
    checks.roughness("views.truth.specular.roughness", truth.specular.roughness);
    light_source(checks, "views.truth.light", &truth.light);
    light_frame(checks, "views.truth.light_frame", truth.light_frame.into());
    for (i, turned) in truth.placements.iter().enumerate() {
        checks.finite(&format!("views.truth.placements[{i}]"), *turned);
    }
    for (i, other) in truth.other_lights.iter().enumerate() {
        light_source(checks, &format!("views.truth.other_lights.{i}"), other);
    }
    passes::edits(checks, "views.truth", &truth.edits);
}

fn pattern(checks: &mut Checks, pattern: &Pattern) {
    let at = |field: &str| format!("views.truth.albedo.{field}");
    match pattern {
        Pattern::Constant(color) => checks.color("views.truth.albedo", *color),
        Pattern::Checker { colors, size } | Pattern::Waves { colors, size } => {
            checks.color(&at("colors.0"), colors.0);
            checks.color(&at("colors.1"), colors.1);
            checks.positive(&at("size"), *size);
        }
        Pattern::Stripes { colors, axis, width } => {
            if colors.is_empty() {
                checks.fail(&at("colors"), "there is no color", "expected at least one color", "");
            }
            for (index, color) in colors.iter().enumerate() {
                checks.color(&at(&format!("colors.{index}")), *color);
            }
            checks.direction(&at("axis"), *axis);
            checks.positive(&at("width"), *width);
        }
    }
}

fn scale(checks: &mut Checks, rule: ScaleRule) {
    match rule {
        ScaleRule::Highlights { white_light } if !(white_light.is_finite() && white_light >= 0.0) => {
            let expected = "expected a finite weight of 0 or more";
            checks.fail("scale.white_light", format!("white_light is {white_light}"), expected, "");
        }
        ScaleRule::MeanAlbedo(color) if !(color.min_element() > 0.0 && color.max_element() <= 0.9) => {
            let expected = "expected every channel above 0, and 0.9 at most";
            checks.fail("scale", format!("the mean albedo is {color}"), expected, "");
        }
        _ => {}
    }
}

fn unknown_roughness(checks: &mut Checks, material: &Material) {
    if let Roughness::Fixed(_) = material.specular.roughness {
        let problem = "the roughness is to vary over the surface, but is said to be known";
        let expected = "expected `roughness: Unknown(…)` beside it";
        checks.fail("material.gloss", problem, expected, "Leave one of the two out.");
    }
}

fn sheen(checks: &mut Checks, material: &Material) {
    if let Sheen::Fixed(AlbedoSource::Constant(color)) = material.sheen {
        checks.color("material.sheen", color);
    }
    if material.sheen == Sheen::Unknown && matches!(material.albedo, Albedo::Fixed(_)) {
        checks.fail(
            "material.sheen",
            "the sheen is unknown, but the albedo is said to be known",
            "expected `None` or `Fixed(…)`, because a fit finds both together",
            "Leave `sheen` out, or let the fit improve the albedo: `albedo: Initial(…)`.",
        );
    }
}

fn tilt(checks: &mut Checks, material: &Material) {
    if matches!(material.tilt, Tilt::Fixed(_)) && !matches!(material.albedo, Albedo::Fixed(_)) {
        checks.fail(
            "material.tilt",
            "the tilt is said to be known, but the albedo is not",
            "expected `Unknown` or `None`, because a fit finds both together",
            "Leave `tilt` out, or say that the albedo is known: `albedo: Fixed(…)`.",
        );
    }
}

/// Whether nothing is said of the lobe. Scenes that were saved when a fit could not choose say `Sg`.
fn is_unsaid(specular: Specular) -> bool {
    let is = |ndf| specular == Specular { ndf, ..Specular::default() };
    is(NdfChoice::Auto) || is(NdfChoice::Sg)
}

fn material(checks: &mut Checks, material: &Material) {
    match &material.gloss {
        Gloss::Auto | Gloss::One => {}
        Gloss::Blend { materials } => {
            checks.count("material.gloss.materials", *materials, 2..=4);
            unknown_roughness(checks, material);
        }
        Gloss::Texels { smoothness, color_width, .. } => {
            checks.not_negative("material.gloss.smoothness", *smoothness);
            checks.positive("material.gloss.color_width", *color_width);
            unknown_roughness(checks, material);
        }
        Gloss::Fixed { lobes, .. } => {
            let count = u32::try_from(lobes.len()).unwrap_or(u32::MAX);
            checks.count("material.gloss.lobes", count, 1..=MAX_SPECULAR_LOBES as u32);
            for (index, lobe) in lobes.iter().enumerate() {
                checks.color(&format!("material.gloss.lobes.{index}.albedo"), lobe.albedo);
                checks.roughness(&format!("material.gloss.lobes.{index}.roughness"), lobe.roughness);
            }
            if !is_unsaid(material.specular) {
                let problem = "`gloss: Fixed(…)` says all about the specular material";
                checks.fail(
                    "material.specular",
                    problem,
                    "expected no `specular`",
                    "Leave one of the two out.",
                );
            }
        }
    }
    if let Albedo::Initial(AlbedoSource::Constant(color)) | Albedo::Fixed(AlbedoSource::Constant(color)) =
        material.albedo
    {
        checks.color("material.albedo", color);
    }
    sheen(checks, material);
    tilt(checks, material);
    specular(checks, &material.specular);
}

fn specular(checks: &mut Checks, specular: &Specular) {
    match specular.albedo {
        SpecularAlbedo::Unknown { initial: None, .. } => {}
        SpecularAlbedo::Unknown { initial: Some(color), .. } => {
            checks.color("material.specular.albedo.initial", color);
        }
        SpecularAlbedo::Fixed(color) => checks.color("material.specular.albedo", color),
    }
    match specular.roughness {
        Roughness::Unknown { initial: None } => {}
        Roughness::Unknown { initial: Some(value) } => {
            checks.roughness("material.specular.roughness.initial", value);
        }
        Roughness::Fixed(value) => checks.roughness("material.specular.roughness", value),
    }
}
