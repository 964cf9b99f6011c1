//! Whether the values of a scene make sense: ranges, counts, names, files that are there, and
//! passes that need one another.
//!
//! Values that the types rule out are not checked again.

mod passes;

pub use passes::unknown_parts;
pub(crate) use passes::uses_published;

use crate::scene::{
    Albedo, AlbedoSource, CameraSpec, Dataset, Edit, Gloss, Light, LightFrameChoice, LightSource, Material,
    NdfChoice, Pattern, Photographed, PlacementLight, PlacementSpec, RenderSettings, Roughness, Scene, Sheen,
    Specular, SpecularAlbedo, Surface, Tilt, Views, Visibility, diagnostic::Problem,
    ron_tree::options as ron_options, source::LoadOptions,
};
use glam::Vec3;
use lobelia_geometry::mesh::MAX_COORDINATE;
use lobelia_geometry::{Error, Result};
use lobelia_io::codec::file::{FileKind, Obstacle, obstacle};
use lobelia_io::codec::{image::Gamma, nearby::missing_file_help};
use lobelia_solve::fit::scale::ScaleRule;
use lobelia_world::light::{MAX_RADIANCE, MAX_SHARPNESS, MOST_LOBES, map_fit::MOST_FITTED};
use lobelia_world::material::MAX_SPECULAR_LOBES;
use std::{
    cell::RefCell, collections::BTreeSet, fmt::Display, ops::RangeInclusive, path::Path, path::PathBuf,
};

/// Least radius or edge length of a primitive, in world units.
const MIN_LENGTH: f32 = 1e-9;
/// The greatest weight of a prior.
const MOST_PRIOR: f32 = 100.0;
/// Most cameras of a scene file: as many as one that is saved can have.
const MOST_CAMERAS: usize = 20_000;

/// Checks every value of the scene of a file in `base_dir`, and resolves every path in place.
pub(super) fn check(scene: &mut Scene, base_dir: &Path, options: &LoadOptions) -> Found {
    let found = RefCell::default();
    let root = Place { path: String::new(), base_dir, options, found: &found };
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
    if let Views::Photographed(made) = &scene.views
        && !made.truth.other_lights.is_empty()
        && !matches!(scene.light, Light::Unknown(_))
    {
        let expected = "expected Unknown(…), as there are `other_lights`, which a fit is to find as well";
        root.at("light").fail("the light is given", expected, "");
    }
    values(&root, scene);
    found.into_inner()
}

/// Checks what a program says of an object whose surface and photographs it has.
pub(crate) fn check_without_views(scene: &Scene) -> Result<()> {
    // Photographs stand for those that it has.
    let views = ron_options().from_str(r#"Dataset(path: ".")"#).expect("the path is all that it must have");
    let mut scene = Scene { views, ..scene.clone() };
    without_file(|root| {
        if let Surface::Mesh { texture_size, .. } | Surface::Unknown { texture_size, .. } = scene.surface {
            root.count("texture_size", texture_size, 8..=4096);
        }
        values(root, &mut scene);
    })
}

/// Checks how a program shows an object.
pub(crate) fn check_shown(edits: &[Edit], settings: &RenderSettings) -> Result<()> {
    without_file(|root| {
        passes::edits(root, &mut edits.to_vec());
        passes::render(root, settings);
    })
}

/// The first problem of values that no file says.
fn without_file(check: impl FnOnce(&Place)) -> Result<()> {
    let (found, options) = (RefCell::default(), LoadOptions::default());
    check(&Place { path: String::new(), base_dir: Path::new(""), options: &options, found: &found });
    let first = found.into_inner().problems.into_iter().next();
    first.map_or(Ok(()), |Problem { path, problem, expected, help }| {
        Err(Error::usage(format!("{path}: {problem}: {expected}"), help))
    })
}

/// Checks light, material and passes.
fn values(root: &Place, scene: &mut Scene) {
    match &mut scene.light {
        Light::Unknown(unknown) => root.at("light").count("lobes", unknown.lobes, 1..=MOST_LOBES as u32),
        Light::Initial(source) | Light::Fixed(source) => light_source(&root.at("light"), source),
    }
    light_frame(root, scene.light_frame);
    material(&root.at("material"), &mut scene.material);
    if scene.own_material().is_some() && scene.material != Material::default() {
        let help = "Remove `material`, or `own_material` from the surface.";
        root.at("material").fail("the mesh's own material is taken", "expected no other material", help);
    }
    scale(root, scene.scale);
    if let Visibility::Traced { directions, bounces, refresh_every } = scene.visibility {
        let at = root.at("visibility");
        at.count("directions", directions, 64..=4096);
        at.count("bounces", bounces, 0..=8);
        at.count("refresh_every", refresh_every, 1..=u32::MAX);
    }
    passes::passes(&root.at("passes"), scene);
}

fn surface(at: &Place, surface: &mut Surface) {
    match surface {
        Surface::Mesh { path, .. } => at.file("path", path),
        Surface::Unknown { cells, .. } => at.count("cells", *cells, 16..=256),
        Surface::Sphere { center, radius, .. } => {
            at.point("center", *center);
            at.number("radius", *radius, MIN_LENGTH..=MAX_COORDINATE);
        }
        Surface::Box { center, size, .. } => {
            at.point("center", *center);
            let ok = size.min_element() >= MIN_LENGTH && size.max_element() <= MAX_COORDINATE;
            let expected = format!("three numbers from {MIN_LENGTH:e} to {MAX_COORDINATE:e}");
            at.require(ok, "size", *size, &expected);
        }
    }
    let (Surface::Mesh { texture_size, .. }
    | Surface::Unknown { texture_size, .. }
    | Surface::Sphere { texture_size, .. }
    | Surface::Box { texture_size, .. }) = surface;
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
    let (is_known, is_unknown) = (matches!(own, Light::Fixed(_)), matches!(own, Light::Unknown(_)));
    let (value, suits, expected) = match &mut placement.light {
        PlacementLight::Same => return,
        _ if is_first => ("said", false, "nothing: the first placement is in the scene's `light`"),
        PlacementLight::Own if is_known => {
            ("Own", false, "Fixed(…), as the scene's `light` is known, or Same")
        }
        PlacementLight::Own => {
            ("Own", is_unknown, "Same, or a scene's `light` that is Unknown(…) and not Initial(…)")
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

/// Least roughness: below it the specular lobe is sharper than `f32` can hold.
pub const MIN_ROUGHNESS: f32 = 0.03;
/// Least field of view, in degrees: a hundred times narrower than any telephoto lens.
const MIN_FOV_DEGREES: f32 = 0.001;

/// Problems and files of a scene.
#[derive(Default)]
pub(super) struct Found {
    /// Every value that makes no sense.
    pub problems: Vec<Problem>,
    /// Files and folders that are there, without repeats, in the order of the scene file.
    pub files: Vec<PathBuf>,
    /// Paths below `$DATA`, which stands for nothing.
    pub unseen: Vec<PathBuf>,
}

/// A place in the scene file: a struct, list or choice whose values are checked by their names
/// there.
#[derive(Clone)]
struct Place<'a> {
    /// Steps joined by dots, as [`Node::locate`](crate::scene::ron_tree::Node::locate) reads them.
    path: String,
    /// The folder of the scene file.
    base_dir: &'a Path,
    options: &'a LoadOptions,
    found: &'a RefCell<Found>,
}

impl<'a> Place<'a> {
    /// The place of a field, or of an item by its index.
    pub fn at(&self, step: impl Display) -> Self {
        let path = if self.path.is_empty() { step.to_string() } else { format!("{}.{step}", self.path) };
        Self { path, ..self.clone() }
    }

    /// Adds a problem with this place.
    pub fn fail(&self, problem: impl Into<String>, expected: impl Into<String>, help: impl Into<String>) {
        let (path, problem) = (self.path.clone(), problem.into());
        let problem = Problem { path, problem, expected: expected.into(), help: help.into() };
        self.found.borrow_mut().problems.push(problem);
    }

    pub fn require(&self, ok: bool, field: &str, found: impl Display, expected: &str) {
        if !ok {
            let at = self.at(field);
            // The last step that is a word.
            let name = at.path.rsplit('.').find(|step| step.starts_with(|c: char| c.is_alphabetic()));
            at.fail(format!("{} is {found}", name.unwrap_or("it")), format!("expected {expected}"), "");
        }
    }

    /// A number in `range`; NaN is in none.
    pub fn number(&self, field: &str, value: f32, range: RangeInclusive<f32>) {
        let expected = format!("a number from {} to {}", range.start(), range.end());
        self.require(range.contains(&value), field, value, &expected);
    }

    /// A finite number above 0.
    pub fn positive(&self, field: &str, value: f32) {
        self.require(value > 0.0 && value.is_finite(), field, value, "a number above 0");
    }

    /// A finite number not below 0.
    pub fn not_negative(&self, field: &str, value: f32) {
        self.require(value >= 0.0 && value.is_finite(), field, value, "a number not below 0");
    }

    /// A whole number in `range`.
    pub fn count(&self, field: &str, value: u32, range: RangeInclusive<u32>) {
        let expected = match *range.end() {
            u32::MAX => format!("a whole number from {}", range.start()),
            end => format!("a whole number from {} to {end}", range.start()),
        };
        self.require(range.contains(&value), field, value, &expected);
    }

    /// A list of 1 to `most` items.
    pub fn length<T>(&self, field: &str, list: &[T], most: usize) {
        self.count(field, u32::try_from(list.len()).unwrap_or(u32::MAX), 1..=most as u32);
    }

    /// Three finite numbers.
    pub fn finite(&self, field: &str, value: Vec3) {
        self.require(value.is_finite(), field, value, "finite numbers");
    }

    /// A finite vector that is not zero.
    pub fn direction(&self, field: &str, value: Vec3) {
        let ok = value.is_finite() && value.length_squared().is_normal();
        self.require(ok, field, value, "a direction: finite, not (0, 0, 0)");
    }

    /// A point that a surface may be at.
    pub fn point(&self, field: &str, value: Vec3) {
        let ok = value.abs().max_element() <= MAX_COORDINATE && value.is_finite();
        self.require(ok, field, value, &format!("three numbers, none beyond {MAX_COORDINATE:e}"));
    }

    /// Three numbers from 0 to `most`.
    pub fn channels(&self, field: &str, value: Vec3, most: f32) {
        let ok = value.to_array().iter().all(|channel| (0.0..=most).contains(channel));
        let most = if most > 1.0 { format!("{most:e}") } else { most.to_string() };
        self.require(ok, field, value, &format!("three numbers from 0 to {most}"));
    }

    /// A color with channels in [0, 1].
    pub fn color(&self, field: &str, value: Vec3) {
        self.channels(field, value, 1.0);
    }

    /// Three finite numbers not below 0.
    pub fn factors(&self, field: &str, value: Vec3) {
        let ok = value.is_finite() && value.min_element() >= 0.0;
        self.require(ok, field, value, "three numbers not below 0");
    }

    pub fn roughness(&self, field: &str, value: f32) {
        self.number(field, value, MIN_ROUGHNESS..=1.0);
    }

    /// A distance of cameras from what they look at.
    pub fn distance(&self, field: &str, value: f32) {
        let expected = format!("a number above 0, at most {MAX_COORDINATE:e}");
        self.require(value > 0.0 && value <= MAX_COORDINATE, field, value, &expected);
    }

    /// A field of view.
    pub fn fov(&self, value: f32) {
        self.number("fov_degrees", value, MIN_FOV_DEGREES..=170.0);
    }

    /// An image's width or height.
    pub fn pixels(&self, field: &str, value: u32) {
        self.count(field, value, 1..=16384);
    }

    /// A name that can be a file's, and that no other of its `kind` has.
    pub fn name(&self, name: &str, kind: &str, is_taken: bool, help: &str) {
        let fits = (1..=100).contains(&name.len());
        let ok = fits && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
        self.require(ok, "name", format_args!("{name:?}"), "1 to 100 letters, digits, `_` and `-`");
        if is_taken {
            let problem = format!("two {kind} are called {name:?} (case does not count)");
            self.at("name").fail(problem, "expected another name", help);
        }
    }

    /// Resolves a path in place and looks for what is there: `$DATA/…` starts at `--data` and is
    /// left as it is without; other relative paths start at the folder of the scene file.
    pub fn path(&self, field: &str, kind: FileKind, path: &mut PathBuf) {
        let at = self.at(field);
        let full = match (path.strip_prefix("$DATA"), &self.options.data) {
            (Err(_), _) => self.base_dir.join(&path),
            (Ok(rest), Some(data)) if rest.as_os_str().is_empty() => data.clone(),
            (Ok(rest), Some(data)) => data.join(rest),
            (Ok(_), None) => {
                // One report stands for every `$DATA/…`: they have the same remedy.
                if self.found.borrow().unseen.is_empty() && !self.options.without_data {
                    let expected = "expected --data to say what $DATA is";
                    let help = "Give the folder on the command line: --data DIR.";
                    at.fail("$DATA stands for nothing here", expected, help);
                }
                if !self.found.borrow().unseen.contains(path) {
                    self.found.borrow_mut().unseen.push(path.clone());
                }
                return;
            }
        };
        if let Some(Obstacle { problem, help }) = obstacle(&full, kind) {
            let help = match kind {
                _ if !help.is_empty() => help,
                FileKind::File if full.is_dir() => "Name a file in it.".into(),
                FileKind::Folder if full.is_file() => "Name the folder that it is in.".into(),
                _ => missing_file_help(&full),
            };
            let expected = if kind == FileKind::File { "expected a file" } else { "expected a folder" };
            at.fail(format!("{}: {problem}", full.display()), expected, help);
        } else if !self.found.borrow().files.contains(&full) {
            self.found.borrow_mut().files.push(full.clone());
        }
        *path = full;
    }

    pub fn file(&self, field: &str, path: &mut PathBuf) {
        self.path(field, FileKind::File, path);
    }

    pub fn folder(&self, field: &str, path: &mut PathBuf) {
        self.path(field, FileKind::Folder, path);
    }
}
