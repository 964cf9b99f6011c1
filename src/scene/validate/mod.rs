//! Whether the values of a scene make sense: ranges, counts, names, files that are there, and passes that need one another.
//!
//! Values that the types rule out are not checked again.

mod passes;
mod place;

pub use passes::unknown_parts;
pub(crate) use passes::uses_published;
pub(super) use place::Found;
pub use place::MIN_ROUGHNESS;

use crate::scene::{
    Albedo, AlbedoSource, CameraSpec, Dataset, Gloss, Light, LightFrameChoice, LightSource, Material,
    NdfChoice, Pattern, Photographed, PlacementLight, PlacementSpec, Roughness, Scene, Sheen, Specular,
    SpecularAlbedo, Surface, Tilt, VERSION, Views, Visibility, load::LoadOptions,
};
use glam::Vec3;
use lobelia_geometry::mesh::MAX_COORDINATE;
use lobelia_io::codec::image::Gamma;
use lobelia_solve::fit::scale::ScaleRule;
use lobelia_world::light::{MAX_RADIANCE, MAX_SHARPNESS, MOST_LOBES, map_fit::MOST_FITTED};
use lobelia_world::material::MAX_SPECULAR_LOBES;
use place::Place;
use std::{cell::RefCell, collections::BTreeSet, path::Path};

/// Least radius or edge length of a primitive, in world units.
const MIN_LENGTH: f32 = 1e-9;
/// The greatest weight of a prior.
const MOST_PRIOR: f32 = 100.0;
/// Most cameras of a scene file: as many as one that is saved can have.
const MOST_CAMERAS: usize = 20_000;

/// Checks every value of the scene of a file in `base_dir`, and resolves every path in place.
pub(super) fn check(scene: &mut Scene, base_dir: &Path, options: &LoadOptions) -> Found {
    let found = RefCell::default();
    let root = Place::new(base_dir, options, &found);
    if scene.version != VERSION {
        root.at("version").fail(format!("version is {}", scene.version), format!("expected {VERSION}"), "");
    }
    root.direction("up", scene.up);
    surface(&root.at("surface"), &mut scene.surface);
    let has_photographs = matches!(scene.views, Views::Dataset(_));
    if matches!(scene.surface, Surface::Unknown { .. }) && !has_photographs {
        let expected = "expected a known surface, or views with photographs: Dataset(…)";
        root.at("surface").fail("an unknown surface without photographs", expected, "");
    }
    let at = root.at("views");
    match &mut scene.views {
        Views::Dataset(data) => dataset(&at, data, &scene.light),
        Views::Cameras(list) => cameras(&at, list),
        Views::Photographed(made) => photographed(&at, made),
    }
    match &mut scene.light {
        Light::Unknown(unknown) => root.at("light").count("lobes", unknown.lobes, 1..=MOST_LOBES as u32),
        Light::Initial(source) | Light::Fixed(source) => light_source(&root.at("light"), source),
    }
    if let Views::Photographed(made) = &scene.views
        && !made.truth.other_lights.is_empty()
    {
        if !matches!(scene.light, Light::Unknown(_)) {
            let expected = "expected Unknown(…), as there are `other_lights`, which a fit is to find as well";
            root.at("light").fail("the light is given", expected, "");
        }
    }
    light_frame(&root, scene.light_frame);
    material(&root.at("material"), &mut scene.material);
    if scene.own_material().is_some() && scene.material != Material::default() {
        let help = "Remove `material`, or `own_material` from the surface.";
        root.at("material").fail("the mesh's own material is taken", "expected no other material", help);
    }
    scale(&root, scene.scale);
    if let Visibility::Traced { directions, bounces, refresh_every } = scene.visibility {
        let at = root.at("visibility");
        at.count("directions", directions, 64..=4096);
        at.count("bounces", bounces, 0..=8);
        at.count("refresh_every", refresh_every, 1..=u32::MAX);
    }
    passes::passes(&root.at("passes"), scene);
    found.into_inner()
}

fn surface(at: &Place, surface: &mut Surface) {
    let texture_size = match surface {
        Surface::Mesh { path, texture_size, .. } => {
            at.file("path", path);
            texture_size
        }
        Surface::Unknown { cells, texture_size } => {
            at.count("cells", *cells, 16..=256);
            texture_size
        }
        Surface::Sphere { center, radius, texture_size } => {
            at.point("center", *center);
            at.number("radius", *radius, MIN_LENGTH..=MAX_COORDINATE);
            texture_size
        }
        Surface::Box { center, size, texture_size } => {
            at.point("center", *center);
            let ok = size.min_element() >= MIN_LENGTH && size.max_element() <= MAX_COORDINATE;
            let expected = format!("three numbers from {MIN_LENGTH:e} to {MAX_COORDINATE:e}");
            at.require(ok, "size", *size, &expected);
            texture_size
        }
    };
    at.count("texture_size", *texture_size, 8..=4096);
}

fn dataset(at: &Place, dataset: &mut Dataset, light: &Light) {
    at.folder("path", &mut dataset.path);
    if let Some(center) = dataset.pixel_center {
        at.number("pixel_center", center, 0.0..=1.0);
    }
    at.number("focal_scale", dataset.focal_scale, 0.5..=2.0);
    at.count("downscale", dataset.downscale, 1..=1024);
    at.count("every", dataset.every, 1..=u32::MAX);
    let expected = "0, for no test split, or a whole number from 2";
    at.require(dataset.hold_out != 1, "hold_out", dataset.hold_out, expected);
    gamma(at, dataset.gamma);
    let mut names = BTreeSet::new();
    for (i, placement) in dataset.placements.iter_mut().enumerate() {
        let at = at.at("placements").at(i);
        let name = &placement.photographs;
        let expected = "a folder, or what names begin with";
        at.require(!name.is_empty(), "photographs", "nothing", expected);
        at.require(names.insert(name.clone()), "photographs", name, "a name of its own");
        if let Some(turned) = placement.turned_degrees {
            at.finite("turned_degrees", turned);
            let expected = "nothing: others are turned relative to the first placement";
            at.require(i > 0 || turned == Vec3::ZERO, "turned_degrees", turned, expected);
        }
        placement_light(&at, placement, i == 0, light);
    }
    let at = at.at("priors");
    if let Some(prior) = &mut dataset.priors.albedo {
        at.at("albedo").folder("folder", &mut prior.folder);
        gamma(&at.at("albedo"), prior.gamma);
    }
    if let Some(prior) = &mut dataset.priors.normals {
        at.at("normals").folder("folder", &mut prior.folder);
        at.at("normals").number("weight", prior.weight, 0.0..=MOST_PRIOR);
    }
}

/// The light of a placement beside the scene's own.
fn placement_light(at: &Place, placement: &mut PlacementSpec, is_first: bool, own: &Light) {
    let is_known = matches!(own, Light::Fixed(_));
    let (value, suits, expected) = match &mut placement.light {
        PlacementLight::Same => return,
        _ if is_first => ("said", false, "nothing: the first placement is in the scene's `light`"),
        PlacementLight::Own if is_known => {
            ("Own", false, "Fixed(…), as the scene's `light` is known, or Same")
        }
        PlacementLight::Own => {
            let unknown = matches!(own, Light::Unknown(_));
            ("Own", unknown, "Same, or a scene's `light` that is Unknown(…) and not Initial(…)")
        }
        PlacementLight::Fixed(source) => {
            light_source(&at.at("light"), source);
            ("Fixed(…)", is_known, "Own, as the scene's `light` is not known, or Same")
        }
    };
    at.require(suits, "light", value, expected);
}

fn gamma(at: &Place, gamma: Gamma) {
    if let Gamma::Power(exponent) = gamma {
        let expected = "an exponent above 0, at most 5";
        at.require(exponent > 0.0 && exponent <= 5.0, "gamma", exponent, expected);
    }
}

fn cameras(at: &Place, cameras: &[CameraSpec]) {
    if !(1..=MOST_CAMERAS).contains(&cameras.len()) {
        let expected = format!("expected 1 to {MOST_CAMERAS} cameras");
        return at.fail(format!("there are {} cameras", cameras.len()), expected, "");
    }
    let mut names = BTreeSet::new();
    for (index, camera) in cameras.iter().enumerate() {
        // `views` is the wrapper `Cameras([…])`, whose only item is the list.
        let at = at.at(0).at(index);
        let help = "Output files carry the view's name, and some file systems do not tell cases apart.";
        at.name(&camera.name, "cameras", !names.insert(camera.name.to_lowercase()), help);
        at.point("eye", camera.eye);
        at.point("target", camera.target);
        at.direction("up", camera.up);
        at.fov(camera.fov_degrees);
        at.pixels("width", camera.width);
        at.pixels("height", camera.height);
    }
}

fn photographed(at: &Place, photographed: &mut Photographed) {
    let (ring, cameras) = (&photographed.cameras, at.at("cameras"));
    cameras.count("count", ring.count, 1..=10_000);
    cameras.count("test", ring.test, 0..=10_000);
    cameras.point("target", ring.target);
    cameras.distance("radius", ring.radius);
    cameras.fov(ring.fov_degrees);
    cameras.pixels("size", ring.size);
    at.count("spp", photographed.spp, 1..=65536);
    at.count("max_bounces", photographed.max_bounces, 1..=64);
    let (truth, at) = (&mut photographed.truth, at.at("truth"));
    pattern(&at, &truth.albedo);
    at.at("specular").color("albedo", truth.specular.albedo);
    at.at("specular").roughness("roughness", truth.specular.roughness);
    light_source(&at.at("light"), &mut truth.light);
    light_frame(&at, truth.light_frame.into());
    for (i, turned) in truth.placements.iter().enumerate() {
        at.at("placements").finite(&i.to_string(), *turned);
    }
    for (i, other) in truth.other_lights.iter_mut().enumerate() {
        light_source(&at.at("other_lights").at(i), other);
    }
    passes::edits(&at, &mut truth.edits);
}

fn pattern(truth: &Place, pattern: &Pattern) {
    let at = truth.at("albedo");
    let mut colors = Vec::new();
    match pattern {
        Pattern::Constant(color) => truth.color("albedo", *color),
        Pattern::Checker { colors: (first, second), size }
        | Pattern::Waves { colors: (first, second), size } => {
            colors = vec![*first, *second];
            at.positive("size", *size);
        }
        Pattern::Stripes { colors: all, axis, width } => {
            if all.is_empty() {
                at.at("colors").fail("there is no color", "expected at least one color", "");
            }
            colors.clone_from(all);
            at.direction("axis", *axis);
            at.positive("width", *width);
        }
    }
    for (index, color) in colors.iter().enumerate() {
        at.at("colors").color(&index.to_string(), *color);
    }
}

/// The `light_frame` of a place.
fn light_frame(at: &Place, frame: LightFrameChoice) {
    if let LightFrameChoice::Turntable(axis) = frame {
        at.direction("light_frame", axis);
    }
}

/// A light at its place.
fn light_source(at: &Place, source: &mut LightSource) {
    match source {
        LightSource::Lobes { lobes, .. } => {
            at.length("lobes", lobes, MOST_LOBES);
            for (index, lobe) in lobes.iter().enumerate() {
                let at = at.at("lobes").at(index);
                at.direction("axis", lobe.axis);
                at.number("sharpness", lobe.sharpness, 0.0..=MAX_SHARPNESS);
                at.channels("amplitude", lobe.amplitude, MAX_RADIANCE);
            }
        }
        LightSource::Npy { path, .. } | LightSource::Ron { path, .. } => at.file("path", path),
        LightSource::Map { path, lobes, .. } => {
            at.file("path", path);
            at.count("lobes", *lobes, 1..=MOST_FITTED as u32);
        }
    }
    let (scale, rotation) = source.scale_and_turn();
    at.not_negative("scale", scale);
    at.finite("rotation_degrees", rotation);
}

fn scale(root: &Place, rule: ScaleRule) {
    match rule {
        ScaleRule::Highlights { white_light } => {
            let ok = white_light.is_finite() && white_light >= 0.0;
            root.at("scale").require(ok, "white_light", white_light, "a finite weight of 0 or more");
        }
        ScaleRule::MeanAlbedo(color) if !(color.min_element() > 0.0 && color.max_element() <= 0.9) => {
            let expected = "expected every channel above 0, and 0.9 at most";
            root.at("scale").fail(format!("the mean albedo is {color}"), expected, "");
        }
        _ => {}
    }
}

/// An albedo that is given.
fn albedo_source(material: &Place, field: &str, source: &mut AlbedoSource) {
    match source {
        AlbedoSource::Constant(color) => material.color(field, *color),
        AlbedoSource::Texture(path) => material.at(field).file("0", path),
    }
}

fn material(at: &Place, material: &mut Material) {
    gloss(at, material);
    if let Albedo::Initial(source) | Albedo::Fixed(source) = &mut material.albedo {
        albedo_source(at, "albedo", source);
    }
    let is_fixed = matches!(material.albedo, Albedo::Fixed(_));
    match &mut material.sheen {
        Sheen::Fixed(source) => albedo_source(at, "sheen", source),
        Sheen::Unknown if is_fixed => at.at("sheen").fail(
            "the sheen is unknown, but the albedo is said to be known",
            "expected `None` or `Fixed(…)`, because a fit finds both together",
            "Leave `sheen` out, or let the fit improve the albedo: `albedo: Initial(…)`.",
        ),
        _ => {}
    }
    if let Tilt::Fixed(path) = &mut material.tilt {
        at.at("tilt").file("0", path);
        if !is_fixed {
            at.at("tilt").fail(
                "the tilt is said to be known, but the albedo is not",
                "expected `Unknown` or `None`, because a fit finds both together",
                "Leave `tilt` out, or say that the albedo is known: `albedo: Fixed(…)`.",
            );
        }
    }
    let (specular, at) = (material.specular, at.at("specular"));
    match specular.albedo {
        SpecularAlbedo::Unknown { initial, .. } => {
            initial.iter().for_each(|color| at.at("albedo").color("initial", *color));
        }
        SpecularAlbedo::Fixed(color) => at.color("albedo", color),
    }
    match specular.roughness {
        Roughness::Unknown { initial } => {
            initial.iter().for_each(|value| at.at("roughness").roughness("initial", *value));
        }
        Roughness::Fixed(value) => at.roughness("roughness", value),
    }
}

fn gloss(material_at: &Place, material: &mut Material) {
    let at = material_at.at("gloss");
    match &mut material.gloss {
        Gloss::Auto | Gloss::One => {}
        Gloss::Blend { materials } => at.count("materials", *materials, 2..=4),
        Gloss::Texels { smoothness, color_width, .. } => {
            at.not_negative("smoothness", *smoothness);
            at.positive("color_width", *color_width);
        }
        Gloss::Fixed { lobes, weights } => {
            at.file("weights", weights);
            at.length("lobes", lobes, MAX_SPECULAR_LOBES);
            for (index, lobe) in lobes.iter().enumerate() {
                let at = at.at("lobes").at(index);
                at.color("albedo", lobe.albedo);
                at.roughness("roughness", lobe.roughness);
            }
            // Scenes that were saved when a fit could not choose say `Sg`.
            let unsaid = [NdfChoice::Auto, NdfChoice::Sg].map(|ndf| Specular { ndf, ..Specular::default() });
            if !unsaid.contains(&material.specular) {
                let problem = "`gloss: Fixed(…)` says all about the specular material";
                let help = "Leave one of the two out.";
                material_at.at("specular").fail(problem, "expected no `specular`", help);
            }
        }
    }
    let varies = matches!(material.gloss, Gloss::Blend { .. } | Gloss::Texels { .. });
    if varies && matches!(material.specular.roughness, Roughness::Fixed(_)) {
        let problem = "the roughness is to vary over the surface, but is said to be known";
        let expected = "expected `roughness: Unknown(…)` beside it";
        at.fail(problem, expected, "Leave one of the two out.");
    }
}
