//! The material that a scene describes: what a fit starts from, or what is known.

use crate::codec::gltf::material::read_material;
use crate::codec::texture;
use crate::error::Result;
use crate::fit::roughness::texel::{BASE_ROUGHNESSES, TexelRoughness};
use crate::material::sheen::KnownAlong;
use crate::material::tilt::MOST_TILT;
use crate::material::{DiffuseSheen, DiffuseTilt, SpecularBlend, SpecularLobe, USUAL_ALBEDO};
use crate::math::brdf::Ndf;
use crate::mesh::Surface;
use crate::scene::validate::MIN_ROUGHNESS;
use crate::scene::{Albedo, AlbedoSource, Gloss, Roughness, Sheen, Specular, SpecularAlbedo, Tilt};
use bevy_ecs::prelude::World;
use glam::Vec3;
use std::path::Path;

/// Albedo and roughness from which the base materials start that a fit may choose instead of one: what may be metal (between [metal and dielectrics](crate::fit::metal)), and a dielectric.
const METAL: (f32, f32) = (0.3, 0.25);
const DIELECTRIC: (f32, f32) = (0.04, 0.5);

/// The roughest base material at first, over the least rough.
const ROUGHNESS_SPREAD: f32 = 2.5;

/// The base materials and each texel's blend of them, starting from the lobe `specular`.
pub(super) fn initial_gloss(
    gloss: &Gloss,
    specular: SpecularLobe,
    surface: &Surface,
) -> Result<(Vec<SpecularLobe>, Vec<SpecularBlend>)> {
    let (width, height) = (surface.atlas().width, surface.atlas().height);
    let count = (width * height) as usize;
    match gloss {
        Gloss::Auto | Gloss::One => Ok((vec![specular], vec![SpecularBlend::default(); count])),
        Gloss::Blend { materials } => {
            Ok((spread(specular, *materials), vec![SpecularBlend::even(*materials as usize); count]))
        }
        Gloss::Texels { specular: varied, .. } => {
            let lobes = BASE_ROUGHNESSES.map(|roughness| SpecularLobe { roughness, ..specular });
            let blend = SpecularBlend(TexelRoughness::first(specular.roughness, *varied).weights());
            Ok((lobes.to_vec(), vec![blend; count]))
        }
        Gloss::Fixed { lobes, weights } => {
            Ok((lobes.clone(), texture::read_weights(weights, lobes.len(), width, height)?))
        }
    }
}

/// Several base materials with roughnesses spread around that of `specular`.
fn spread(specular: SpecularLobe, materials: u32) -> Vec<SpecularLobe> {
    let place = |k: u32| k as f32 / (materials - 1) as f32 - 0.5;
    let roughness = |k| (specular.roughness * ROUGHNESS_SPREAD.powf(place(k))).clamp(MIN_ROUGHNESS, 1.0);
    (0..materials).map(|k| SpecularLobe { roughness: roughness(k), ..specular }).collect()
}

/// The base materials that a fit may choose instead of one ([`Gloss::Auto`]), and the blend that it starts with: see [`metal`](crate::fit::metal).
pub fn several_materials() -> (Vec<SpecularLobe>, SpecularBlend) {
    let lobe = |(albedo, roughness)| SpecularLobe {
        ndf: Ndf::Ggx,
        ..SpecularLobe::new(Vec3::splat(albedo), roughness)
    };
    (vec![lobe(METAL), lobe(DIELECTRIC)], SpecularBlend::even(2))
}

/// Puts what is known of the albedo along this surface into the world.
///
/// # Errors
/// If a texture cannot be read.
pub(crate) fn insert_known_along(world: &mut World, sheen: &Sheen, surface: &Surface) -> Result<()> {
    match sheen {
        Sheen::Auto | Sheen::None | Sheen::Unknown => drop(world.remove_resource::<KnownAlong>()),
        Sheen::Fixed(AlbedoSource::Constant(color)) => world.insert_resource(KnownAlong::Everywhere(*color)),
        Sheen::Fixed(source) => {
            world.insert_resource(KnownAlong::Texels(given_albedo(source, surface)?));
        }
    }
    Ok(())
}

/// The sheen of each texel that a fit starts from, or the known one, beside this albedo.
pub(super) fn initial_sheen(world: &World, albedo: &[Vec3]) -> Vec<DiffuseSheen> {
    let known = world.get_resource::<KnownAlong>().and_then(|known| known.sheen(albedo));
    known.unwrap_or_else(|| vec![DiffuseSheen::default(); albedo.len()])
}

/// The tilt of each texel: none, or the known one.
pub(super) fn initial_tilt(tilt: &Tilt, surface: &Surface) -> Result<Vec<DiffuseTilt>> {
    let (width, height) = (surface.atlas().width, surface.atlas().height);
    let Tilt::Fixed(path) = tilt else {
        return Ok(vec![DiffuseTilt::default(); (width * height) as usize]);
    };
    let known = texture::read_vectors(path, ["X", "Y", "Z"], width, height)?;
    Ok(known.into_iter().map(|tilt| DiffuseTilt(tilt.clamp_length_max(MOST_TILT))).collect())
}

/// The albedo of each texel that a fit starts from, or the known one.
pub(super) fn initial_albedo(albedo: &Albedo, surface: &Surface) -> Result<Vec<Vec3>> {
    match albedo {
        Albedo::Unknown => given_albedo(&AlbedoSource::Constant(Vec3::splat(USUAL_ALBEDO)), surface),
        Albedo::Initial(source) | Albedo::Fixed(source) => given_albedo(source, surface),
    }
}

fn given_albedo(source: &AlbedoSource, surface: &Surface) -> Result<Vec<Vec3>> {
    let (width, height) = (surface.atlas().width, surface.atlas().height);
    match source {
        AlbedoSource::Constant(color) => Ok(vec![*color; (width * height) as usize]),
        AlbedoSource::Texture(path) => texture::read_texture(path, width, height),
    }
}

/// Specular albedo and roughness that a fit starts from where nothing else is said.
const START: (f32, f32) = (0.3, 0.4);

/// The lobe that a fit starts from, or the known one.
pub(crate) fn initial_specular(specular: &Specular) -> SpecularLobe {
    SpecularLobe {
        albedo: match specular.albedo {
            SpecularAlbedo::Unknown { mono: true, initial: Some(initial) } => {
                Vec3::splat(initial.element_sum() / 3.0)
            }
            SpecularAlbedo::Unknown { initial, .. } => initial.unwrap_or(Vec3::splat(START.0)),
            SpecularAlbedo::Fixed(value) => value,
        },
        roughness: match specular.roughness {
            Roughness::Unknown { initial } => initial.unwrap_or(START.1),
            Roughness::Fixed(value) => value,
        },
        ndf: specular.ndf.first(),
    }
}

/// The material of a mesh file, with what glTF's lobe leaves of the base color as albedo.
pub(super) fn own_material(path: &Path, surface: &Surface) -> Result<(Vec<Vec3>, SpecularLobe)> {
    let material = read_material(path)?;
    let roughness = material.roughness.clamp(MIN_ROUGHNESS, 1.0);
    // As this project writes it: a file made by other programs means GGX, but does not say what wrote it.
    let lobe = SpecularLobe::new(Vec3::ONE, roughness);
    let albedo = material.specular_albedo(&lobe);
    let factor = material.base_color * material.diffuse_share(roughness);
    let (width, height) = (surface.atlas().width, surface.atlas().height);
    let mut texels = match &material.base_color_image {
        Some(bytes) => texture::decode_texture(path, bytes, width, height)?,
        None => vec![Vec3::ONE; (width * height) as usize],
    };
    texels.iter_mut().for_each(|texel| *texel *= factor);
    Ok((texels, SpecularLobe { albedo, ..lobe }))
}
