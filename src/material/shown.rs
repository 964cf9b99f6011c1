//! The material that a frame shows. It is computed from the recovered one, which never changes, so that edits need not be undone.
//!
//! The system in [`Slot::Material`](crate::pipeline::Slot::Material) writes it. Swap that system to change the edits:
//!
//! | system | shows |
//! | --- | --- |
//! | [`show_recovered`] | the recovered material as it is |
//! | [`show_edited`] | the recovered material with the edits of one name ([`EditName`]), in their order |
//! | your own system | what it makes of the recovered material ([`Composition::compose`]) |

use super::components::{
    BaseMaterial, DiffuseAlbedo, DiffuseSheen, DiffuseTilt, SpecularBlend, SpecularLobe, TexelIndex, Texels,
};
pub use super::components::{ShownAlbedo, ShownBlend, ShownSheen, ShownSpecular, ShownTilt};
use super::edit::{EditAction, EditName, EditOrder, EditRegion, EditTarget, MaterialState, apply_edit};
use super::recovered::spawn_texels;
use crate::error::Result;
use crate::pipeline::SystemResult;
use crate::pipeline::pool::read_column;
use bevy_ecs::change_detection::DetectChangesMut;
use bevy_ecs::component::Mutable;
use bevy_ecs::prelude::{
    Changed, Commands, Component, Entity, IntoScheduleConfigs, Local, Or, Query, SystemCondition, With,
    Without, World,
};
use bevy_ecs::schedule::ScheduleConfigs;
use bevy_ecs::system::{ScheduleSystem, SystemParam};
use glam::Vec3;

/// What a texel's shown material is made of.
type RecoveredTexel =
    (&'static DiffuseAlbedo, &'static DiffuseSheen, &'static DiffuseTilt, &'static SpecularBlend);

/// What a texel shows.
type ShownTexel =
    (&'static mut ShownAlbedo, &'static mut ShownSheen, &'static mut ShownTilt, &'static mut ShownBlend);

/// The system parameter that reads the recovered material and writes the shown one, all of it: see [`Composition::compose`].
#[derive(SystemParam)]
pub struct Composition<'w, 's> {
    texels: Texels<'w, 's, (RecoveredTexel, ShownTexel)>,
    recovered: Query<'w, 's, (&'static BaseMaterial, &'static SpecularLobe, &'static mut ShownSpecular)>,
    added: Query<'w, 's, Entity, (With<ShownSpecular>, Without<SpecularLobe>)>,
    commands: Commands<'w, 's>,
}

impl Composition<'_, '_> {
    /// Shows what `edit` makes of the recovered material; what it leaves alone is shown as it was recovered. A system of one's own in
    /// [`Slot::Material`](crate::pipeline::Slot::Material) is a call of this.
    ///
    /// # Errors
    /// If the pool of texels is incomplete, base materials share a number, or `edit` fails.
    pub fn compose(mut self, edit: impl FnOnce(&mut MaterialState) -> Result<()>) -> SystemResult {
        let ((albedo, sheen, tilt, blends), mut shown) = self.texels.columns()?;
        let (albedo, sheen, blends) = (albedo.to_vec(), sheen.to_vec(), blends.to_vec());
        let mut state = MaterialState { albedo, sheen, tilt: tilt.to_vec(), blends, lobes: Vec::new() };
        for (number, lobe, _) in &self.recovered {
            state.set_lobe(*number, *lobe)?;
        }
        edit(&mut state)?;
        shown.0.iter_mut().zip(&state.albedo).for_each(|(shown, albedo)| shown.0 = albedo.0);
        shown.1.iter_mut().zip(&state.sheen).for_each(|(shown, sheen)| shown.0 = sheen.0);
        shown.2.iter_mut().zip(&state.tilt).for_each(|(shown, tilt)| shown.0 = tilt.0);
        shown.3.iter_mut().zip(&state.blends).for_each(|(shown, blend)| shown.0 = *blend);
        for (number, _, mut shown) in &mut self.recovered {
            if let Some(lobe) = state.lobes.get_mut(number.0 as usize).and_then(Option::take) {
                shown.0 = lobe;
            }
        }
        self.added.iter().for_each(|added| self.commands.entity(added).despawn());
        for (number, lobe) in (0..).zip(&state.lobes) {
            if let Some(lobe) = lobe {
                self.commands.spawn((BaseMaterial(number), ShownSpecular(*lobe)));
            }
        }
        Ok(())
    }
}

/// Changes of the recovered material after which the shown one is stale.
type RecoveredChanged = Or<(
    Changed<DiffuseAlbedo>,
    Changed<DiffuseSheen>,
    Changed<DiffuseTilt>,
    Changed<SpecularBlend>,
    Changed<SpecularLobe>,
)>;

/// Run condition: whether the recovered material has changed, or base materials have been added or removed.
pub fn recovered_changed(
    changed: Query<(), RecoveredChanged>,
    materials: Query<Entity, With<SpecularLobe>>,
    mut known: Local<Vec<Entity>>,
) -> bool {
    others(&mut known, materials.iter()) || !changed.is_empty()
}

/// Changes of the components of an edit.
type EditChanged = Or<(
    Changed<EditName>,
    Changed<EditOrder>,
    Changed<EditTarget>,
    Changed<EditAction>,
    Changed<EditRegion>,
)>;

/// Run condition: whether an edit has changed, or edits have been added or removed.
pub fn edits_changed(
    changed: Query<(), EditChanged>,
    edits: Query<Entity, With<EditName>>,
    mut known: Local<Vec<Entity>>,
) -> bool {
    others(&mut known, edits.iter()) || !changed.is_empty()
}

/// Whether the entities differ from the known ones; replaces the known ones.
fn others(known: &mut Vec<Entity>, now: impl Iterator<Item = Entity>) -> bool {
    let now: Vec<Entity> = now.collect();
    std::mem::replace(known, now) != *known
}

/// For [`Slot::Material`](crate::pipeline::Slot::Material): shows the recovered material; runs when it has changed.
pub fn show_recovered() -> ScheduleConfigs<ScheduleSystem> {
    let system = |composition: Composition| composition.compose(|_| Ok(()));
    system.run_if(recovered_changed)
}

/// For [`Slot::Material`](crate::pipeline::Slot::Material): shows the recovered material with the edits of this name, by ascending
/// [`EditOrder`]; runs when one of these has changed.
pub fn show_edited(name: impl Into<String>) -> ScheduleConfigs<ScheduleSystem> {
    let name = EditName(name.into());
    let system = move |composition: Composition, edits: Query<EditColumns>| {
        let mut own: Vec<_> = edits.iter().filter(|(of, ..)| **of == name).collect();
        own.sort_by_key(|(_, order, ..)| **order);
        let mut own = own.into_iter();
        composition.compose(|state| {
            own.try_for_each(|(.., target, action, region)| apply_edit(state, *target, action, region))
        })
    };
    // Not short-circuited, because both conditions update their state.
    system.run_if(recovered_changed.or_eager(edits_changed))
}

/// The components of an edit.
type EditColumns =
    (&'static EditName, &'static EditOrder, &'static EditTarget, &'static EditAction, &'static EditRegion);

/// The recovered material, as plain columns.
///
/// # Errors
/// If the pool of texels is not whole.
pub fn recovered_material(world: &mut World) -> Result<MaterialState> {
    let albedo = read_column::<TexelIndex, DiffuseAlbedo>(world)?;
    let blends = read_column::<TexelIndex, SpecularBlend>(world)?;
    let sheen = read_column::<TexelIndex, DiffuseSheen>(world)?;
    let tilt = read_column::<TexelIndex, DiffuseTilt>(world)?;
    let mut state = MaterialState { albedo, sheen, tilt, blends, lobes: Vec::new() };
    for (number, lobe) in world.query::<(&BaseMaterial, &SpecularLobe)>().iter(world) {
        state.set_lobe(*number, *lobe)?;
    }
    Ok(state)
}

/// The material that was shown last, as plain columns; base materials that exist only there have their numbers.
///
/// # Errors
/// If the pool of texels is not whole.
pub fn shown_material(world: &mut World) -> Result<MaterialState> {
    let albedo = read_column::<TexelIndex, ShownAlbedo>(world)?;
    let sheen = read_column::<TexelIndex, ShownSheen>(world)?;
    let tilt = read_column::<TexelIndex, ShownTilt>(world)?;
    let blends = read_column::<TexelIndex, ShownBlend>(world)?;
    let mut state = MaterialState {
        albedo: albedo.into_iter().map(|shown| DiffuseAlbedo(shown.0)).collect(),
        sheen: sheen.into_iter().map(|shown| DiffuseSheen(shown.0)).collect(),
        tilt: tilt.into_iter().map(|shown| DiffuseTilt(shown.0)).collect(),
        blends: blends.into_iter().map(|shown| shown.0).collect(),
        lobes: Vec::new(),
    };
    for (number, shown) in world.query::<(&BaseMaterial, &ShownSpecular)>().iter(world) {
        state.set_lobe(*number, shown.0)?;
    }
    Ok(state)
}

/// Spawns texels and base materials with this state as the recovered material.
pub fn spawn_material(world: &mut World, state: &MaterialState) {
    let albedo: Vec<Vec3> = state.albedo.iter().map(|albedo| albedo.0).collect();
    spawn_texels(world, &albedo, &state.sheen, &state.tilt, &state.blends);
    for (number, lobe) in state.materials() {
        world.spawn((BaseMaterial(number as u32), *lobe));
    }
}

/// Marks the recovered and the shown material as changed, so that what is made of them is made again.
pub fn mark_material_changed(world: &mut World) {
    fn mark<T: Component<Mutability = Mutable>>(world: &mut World) {
        world.query::<&mut T>().iter_mut(world).for_each(|mut component| component.set_changed());
    }
    mark::<DiffuseAlbedo>(world);
    mark::<DiffuseSheen>(world);
    mark::<DiffuseTilt>(world);
    mark::<SpecularBlend>(world);
    mark::<SpecularLobe>(world);
    mark::<ShownAlbedo>(world);
    mark::<ShownSheen>(world);
    mark::<ShownTilt>(world);
    mark::<ShownBlend>(world);
    mark::<ShownSpecular>(world);
}
