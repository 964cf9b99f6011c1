//! The material that a system reads: the recovered one of a fit, or the shown one of a frame.

use super::{BaseMaterial, Diffuse, MAX_SPECULAR_LOBES, Shown, SpecularBlend, SpecularLobe, TexelIndex};
use crate::pipeline::SystemResult;
use bevy_ecs::component::Mutable;
use bevy_ecs::prelude::{Changed, Component, Entity, Local, Query, Res, ResMut, Resource, With};
use lobelia_geometry::{Error, Result};
use std::marker::PhantomData;

/// A component that holds a value `T` of a material: the value itself, or [`Shown`] of it.
pub trait Holds<T>: Component<Mutability = Mutable> + Copy {
    /// The value.
    fn value(&self) -> T;
}

impl<T: Component<Mutability = Mutable> + Copy> Holds<T> for T {
    fn value(&self) -> T {
        *self
    }
}

impl<T: Component<Mutability = Mutable> + Copy> Holds<T> for Shown<T> {
    fn value(&self) -> T {
        self.0
    }
}

/// One material on texels and base materials: which components hold its values.
pub trait MaterialSource: Default + Send + Sync + 'static {
    /// The component that holds a value.
    type Column<T: Component<Mutability = Mutable> + Copy>: Holds<T>;
}

/// The recovered material: the result of a fit, or given by a scene.
#[derive(Default)]
pub struct RecoveredMaterial;

impl MaterialSource for RecoveredMaterial {
    type Column<T: Component<Mutability = Mutable> + Copy> = T;
}

/// The shown material of a frame.
#[derive(Default)]
pub struct ShownMaterial;

impl MaterialSource for ShownMaterial {
    type Column<T: Component<Mutability = Mutable> + Copy> = Shown<T>;
}

/// A value of all texels or base materials, as a column.
pub type ColumnOf<M, T> = <M as MaterialSource>::Column<T>;

/// The columns of the texels of one material.
pub type TexelColumns<M> = (&'static ColumnOf<M, Diffuse>, &'static ColumnOf<M, SpecularBlend>);

/// The base materials of this run, by ascending number.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct BaseMaterials {
    /// Each with its number, which is its index in the blend weights of texels.
    pub lobes: Vec<(usize, SpecularLobe)>,
    /// Their entities.
    pub entities: Vec<Entity>,
    /// Whether blend weights are used: false if the only material is number 0 and has weight 1 at
    /// every texel.
    pub blended: bool,
}

impl BaseMaterials {
    /// The lobes with their numbers.
    pub fn by_number(&self) -> impl Iterator<Item = (usize, &SpecularLobe)> {
        self.lobes.iter().map(|(number, lobe)| (*number, lobe))
    }
}

/// Whether all texels have base material 0 only; written by [`note_plain_blends`].
#[derive(Resource, Default)]
pub struct PlainBlends<M: MaterialSource>(bool, PhantomData<M>);

/// Texels whose blend weights have changed.
type ChangedBlends<M> = (Changed<ColumnOf<M, SpecularBlend>>, With<TexelIndex>);
/// Texels with blend weights.
type BlendedTexels<M> = (With<ColumnOf<M, SpecularBlend>>, With<TexelIndex>);

/// Run condition: whether the blend weights of a texel have changed, or texels have been added or
/// removed.
pub fn blends_changed<M: MaterialSource>(
    changed: Query<(), ChangedBlends<M>>,
    texels: Query<(), BlendedTexels<M>>,
    mut known: Local<usize>,
) -> bool {
    let now = texels.iter().len();
    std::mem::replace(&mut *known, now) != now || !changed.is_empty()
}

/// Gather: records whether any texel blends base materials; runs if `blends_changed`.
pub fn note_plain_blends<M: MaterialSource>(
    texels: Query<&ColumnOf<M, SpecularBlend>, With<TexelIndex>>,
    mut noted: ResMut<PlainBlends<M>>,
) {
    noted.0 = texels.iter().all(|blend| blend.value() == SpecularBlend::default());
}

/// Gather: the base materials by number.
pub fn gather_materials<M: MaterialSource>(
    materials: Query<(Entity, &BaseMaterial, &ColumnOf<M, SpecularLobe>)>,
    plain: Res<PlainBlends<M>>,
    mut gathered: ResMut<BaseMaterials>,
) -> SystemResult {
    let mut found: Vec<_> =
        materials.iter().map(|(entity, number, lobe)| (number.0 as usize, lobe.value(), entity)).collect();
    found.sort_by_key(|(number, ..)| *number);
    check_numbers(found.iter().map(|(number, ..)| *number))?;
    gathered.lobes = found.iter().map(|(number, lobe, _)| (*number, *lobe)).collect();
    gathered.entities = found.iter().map(|(_, _, entity)| *entity).collect();
    gathered.blended = !(plain.0 && matches!(gathered.lobes.as_slice(), [] | [(0, _)]));
    Ok(())
}

/// Checks that each number is in range and occurs once.
pub(super) fn check_numbers(rising: impl Iterator<Item = usize>) -> Result<()> {
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
