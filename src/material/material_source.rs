//! The material that a system reads: the recovered one of a fit, or the shown one of a frame.

use super::components::{
    BaseMaterial, DiffuseAlbedo, DiffuseSheen, DiffuseTilt, MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe,
    TexelIndex, Texels,
};
use super::components::{ShownAlbedo, ShownBlend, ShownSheen, ShownSpecular, ShownTilt};
use crate::error::{Error, Result};
use crate::pipeline::SystemResult;
use bevy_ecs::component::Mutable;
use bevy_ecs::prelude::{Changed, Component, Entity, Local, Query, Res, ResMut, Resource, With};
use glam::Vec3;
use std::marker::PhantomData;

/// A column of diffuse albedo.
pub trait AlbedoColumn: Component<Mutability = Mutable> + Copy {
    /// Linear RGB in `[0, 1]`.
    fn albedo(&self) -> Vec3;
}

/// A column of sheen.
pub trait SheenColumn: Component<Mutability = Mutable> + Copy {
    /// Difference of albedo, linear RGB in [−1, 1].
    fn sheen(&self) -> Vec3;
}

/// A column of tilt.
pub trait TiltColumn: Component<Mutability = Mutable> + Copy {
    /// A vector in the object's axes.
    fn tilt(&self) -> Vec3;
}

/// A column of blend weights.
pub trait BlendColumn: Component<Mutability = Mutable> + Copy {
    /// The weights.
    fn blend(&self) -> SpecularBlend;
}

/// The specular part of base materials.
pub trait SpecularColumn: Component<Mutability = Mutable> + Copy {
    /// The lobe.
    fn lobe(&self) -> SpecularLobe;
}

impl AlbedoColumn for DiffuseAlbedo {
    fn albedo(&self) -> Vec3 {
        self.0
    }
}

impl AlbedoColumn for ShownAlbedo {
    fn albedo(&self) -> Vec3 {
        self.0
    }
}

impl SheenColumn for DiffuseSheen {
    fn sheen(&self) -> Vec3 {
        self.0
    }
}

impl SheenColumn for ShownSheen {
    fn sheen(&self) -> Vec3 {
        self.0
    }
}

impl TiltColumn for DiffuseTilt {
    fn tilt(&self) -> Vec3 {
        self.0
    }
}

impl TiltColumn for ShownTilt {
    fn tilt(&self) -> Vec3 {
        self.0
    }
}

impl BlendColumn for SpecularBlend {
    fn blend(&self) -> SpecularBlend {
        *self
    }
}

impl BlendColumn for ShownBlend {
    fn blend(&self) -> SpecularBlend {
        self.0
    }
}

impl SpecularColumn for SpecularLobe {
    fn lobe(&self) -> SpecularLobe {
        *self
    }
}

impl SpecularColumn for ShownSpecular {
    fn lobe(&self) -> SpecularLobe {
        self.0
    }
}

/// The component types of one material on texels and base materials.
pub trait MaterialSource: Send + Sync + 'static {
    /// Diffuse albedo of texels.
    type Albedo: AlbedoColumn;
    /// Sheen of texels.
    type Sheen: SheenColumn;
    /// Tilt of texels.
    type Tilt: TiltColumn;
    /// Blend weights of texels.
    type Blend: BlendColumn;
    /// Specular part of base materials.
    type Specular: SpecularColumn;
}

/// The recovered material: the result of a fit, or given by a scene.
pub struct Recovered;

/// The shown material of a frame.
pub struct Shown;

impl MaterialSource for Recovered {
    type Albedo = DiffuseAlbedo;
    type Sheen = DiffuseSheen;
    type Tilt = DiffuseTilt;
    type Blend = SpecularBlend;
    type Specular = SpecularLobe;
}

impl MaterialSource for Shown {
    type Albedo = ShownAlbedo;
    type Sheen = ShownSheen;
    type Tilt = ShownTilt;
    type Blend = ShownBlend;
    type Specular = ShownSpecular;
}

/// The base materials of this run, by ascending number.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct BaseMaterials {
    /// Each with its number, which is its index in the blend weights of texels.
    pub lobes: Vec<(usize, SpecularLobe)>,
    /// Their entities.
    pub entities: Vec<Entity>,
    /// Whether blend weights are used: false if the only material is number 0 and has weight 1 at every texel.
    pub blended: bool,
}

impl BaseMaterials {
    /// The lobes without their numbers.
    pub fn only_lobes(&self) -> impl Iterator<Item = &SpecularLobe> {
        self.lobes.iter().map(|(_, lobe)| lobe)
    }

    /// The lobes with their numbers.
    pub fn by_number(&self) -> impl Iterator<Item = (usize, &SpecularLobe)> {
        self.lobes.iter().map(|(number, lobe)| (*number, lobe))
    }
}

/// Whether all texels have base material 0 only; written by [`note_plain_blends`].
#[derive(Resource)]
pub struct PlainBlends<M: MaterialSource> {
    plain: bool,
    source: PhantomData<M>,
}

impl<M: MaterialSource> Default for PlainBlends<M> {
    fn default() -> Self {
        Self { plain: false, source: PhantomData }
    }
}

/// Run condition: whether the blend weights of a texel have changed, or texels have been added or removed.
pub(crate) fn blends_changed<M: MaterialSource>(
    changed: Query<(), (Changed<M::Blend>, With<TexelIndex>)>,
    texels: Query<(), (With<M::Blend>, With<TexelIndex>)>,
    mut known: Local<usize>,
) -> bool {
    let now = texels.iter().len();
    std::mem::replace(&mut *known, now) != now || !changed.is_empty()
}

/// Gather: records whether any texel blends base materials; runs if `blends_changed`.
pub fn note_plain_blends<M: MaterialSource>(
    texels: Query<&M::Blend, With<TexelIndex>>,
    mut noted: ResMut<PlainBlends<M>>,
) {
    noted.plain = texels.iter().all(|blend| blend.blend() == SpecularBlend::default());
}

/// Gather: the base materials by number.
pub fn gather_materials<M: MaterialSource>(
    materials: Query<(Entity, &BaseMaterial, &M::Specular)>,
    plain: Res<PlainBlends<M>>,
    mut gathered: ResMut<BaseMaterials>,
) -> SystemResult {
    let mut found: Vec<_> =
        materials.iter().map(|(entity, number, lobe)| (number.0 as usize, lobe.lobe(), entity)).collect();
    found.sort_by_key(|(number, ..)| *number);
    check_numbers(found.iter().map(|(number, ..)| *number))?;
    gathered.lobes = found.iter().map(|(number, lobe, _)| (*number, *lobe)).collect();
    gathered.entities = found.iter().map(|(_, _, entity)| *entity).collect();
    gathered.blended = !(plain.plain && matches!(gathered.lobes.as_slice(), [] | [(0, _)]));
    Ok(())
}

/// Checks that each number is in range and occurs once.
pub(crate) fn check_numbers(rising: impl Iterator<Item = usize>) -> Result<()> {
    let mut before = None;
    for number in rising {
        if number >= MAX_SPECULAR_LOBES {
            let problem = format!("one has number {number}: there are at most {MAX_SPECULAR_LOBES}, from 0");
            return Err(Error::run("the base materials", problem));
        }
        if before.replace(number) == Some(number) {
            return Err(Error::run("the base materials", format!("two have number {number}")));
        }
    }
    Ok(())
}

/// The texels of one material, as a system parameter.
pub type MaterialTexels<'w, 's, M> = Texels<
    'w,
    's,
    (
        &'static <M as MaterialSource>::Albedo,
        &'static <M as MaterialSource>::Sheen,
        &'static <M as MaterialSource>::Tilt,
        &'static <M as MaterialSource>::Blend,
    ),
>;
