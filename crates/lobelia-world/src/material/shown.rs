//! The material that a frame shows. It is computed from the recovered one, which never changes, so
//! that edits need not be undone.
//!
//! The system in [`Slot::Material`](crate::pipeline::Slot::Material) writes it: [`show_recovered`],
//! [`show_edited`], or one of your own ([`Composition::compose`]).

use super::edit::{EditAction, EditName, EditOrder, EditRegion, EditTarget, MaterialState, apply_edit};
use super::material_source::{
    ColumnOf, Holds, MaterialSource, RecoveredMaterial, ShownMaterial, TexelColumns,
};
use super::{BaseMaterial, Diffuse, Shown, SpecularBlend, SpecularLobe, TexelIndex, Texels, spawn_texels};
use crate::{pipeline::SystemResult, pipeline::pool::with_columns};
use bevy_ecs::prelude::*;
use bevy_ecs::system::{ScheduleSystem, SystemParam};
use bevy_ecs::{change_detection::DetectChangesMut, component::Mutable, schedule::ScheduleConfigs};
use lobelia_geometry::Result;

/// Shown components of a texel's material.
type ShownTexel = (&'static mut Shown<Diffuse>, &'static mut Shown<SpecularBlend>);

/// The system parameter that reads the recovered material and writes the shown one, all of it: see
/// [`Composition::compose`].
#[derive(SystemParam)]
pub struct Composition<'w, 's> {
    texels: Texels<'w, 's, (TexelColumns<RecoveredMaterial>, ShownTexel)>,
    recovered:
        Query<'w, 's, (&'static BaseMaterial, &'static SpecularLobe, &'static mut Shown<SpecularLobe>)>,
    added: Query<'w, 's, Entity, (With<Shown<SpecularLobe>>, Without<SpecularLobe>)>,
    commands: Commands<'w, 's>,
}

impl Composition<'_, '_> {
    /// Shows what `edit` makes of the recovered material; what it leaves alone is shown as it was
    /// recovered. A system of one's own in [`Slot::Material`](crate::pipeline::Slot::Material) is a
    /// call of this.
    ///
    /// # Errors
    /// If the pool of texels is incomplete, base materials share a number, or `edit` fails.
    pub fn compose(mut self, edit: impl FnOnce(&mut MaterialState) -> Result<()>) -> SystemResult {
        let ((diffuse, blends), (mut shown_diffuse, mut shown_blends)) = self.texels.columns()?;
        let (diffuse, blends) = (diffuse.into_owned(), blends.into_owned());
        let mut state = MaterialState { diffuse, blends, lobes: Vec::new() };
        for (number, lobe, _) in &self.recovered {
            state.set_lobe(*number, *lobe)?;
        }
        edit(&mut state)?;
        show(&mut shown_diffuse, &state.diffuse);
        show(&mut shown_blends, &state.blends);
        for (number, _, mut shown) in &mut self.recovered {
            if let Some(lobe) = state.lobes.get_mut(number.0 as usize).and_then(Option::take) {
                shown.0 = lobe;
            }
        }
        self.added.iter().for_each(|added| self.commands.entity(added).despawn());
        for (number, lobe) in (0..).zip(&state.lobes) {
            if let Some(lobe) = lobe {
                self.commands.spawn((BaseMaterial(number), Shown(*lobe)));
            }
        }
        Ok(())
    }
}

fn show<T: Copy + Send + Sync>(shown: &mut [Shown<T>], values: &[T]) {
    shown.iter_mut().zip(values).for_each(|(shown, value)| shown.0 = *value);
}

/// Changes of the recovered material after which the shown one is stale.
type RecoveredChanged = Or<(Changed<Diffuse>, Changed<SpecularBlend>, Changed<SpecularLobe>)>;

/// Run condition: whether the recovered material has changed, or base materials have been added or
/// removed.
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

/// For [`Slot::Material`](crate::pipeline::Slot::Material): shows the recovered material; runs when
/// it has changed.
pub fn show_recovered() -> ScheduleConfigs<ScheduleSystem> {
    let system = |composition: Composition| composition.compose(|_| Ok(()));
    system.run_if(recovered_changed)
}

/// For [`Slot::Material`](crate::pipeline::Slot::Material): shows the recovered material with the
/// edits of this name, by ascending [`EditOrder`]; runs when one of these has changed.
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
    material_state::<RecoveredMaterial>(world)
}

/// The material that was shown last, as plain columns; base materials that exist only there have
/// their numbers.
///
/// # Errors
/// If the pool of texels is not whole.
pub fn shown_material(world: &mut World) -> Result<MaterialState> {
    material_state::<ShownMaterial>(world)
}

fn material_state<M: MaterialSource>(world: &mut World) -> Result<MaterialState> {
    let mut state = with_columns::<TexelIndex, TexelColumns<M>, _>(world, |(diffuse, blends)| {
        let diffuse = diffuse.iter().map(Holds::value).collect();
        Ok(MaterialState { diffuse, blends: blends.iter().map(Holds::value).collect(), lobes: Vec::new() })
    })?;
    for (number, lobe) in world.query::<(&BaseMaterial, &ColumnOf<M, SpecularLobe>)>().iter(world) {
        state.set_lobe(*number, lobe.value())?;
    }
    Ok(state)
}

/// Spawns texels and base materials with this state as the recovered material.
pub fn spawn_material(world: &mut World, state: &MaterialState) {
    spawn_texels(world, &state.diffuse, &state.blends);
    for (number, lobe) in state.materials() {
        world.spawn((BaseMaterial(number as u32), *lobe));
    }
}

/// Marks the recovered and the shown material as changed, so that what is made of them is made
/// again.
pub fn mark_material_changed(world: &mut World) {
    fn mark<T: Component<Mutability = Mutable>>(world: &mut World) {
        world.query::<&mut T>().iter_mut(world).for_each(|mut component| component.set_changed());
        world.query::<&mut Shown<T>>().iter_mut(world).for_each(|mut component| component.set_changed());
    }
    mark::<Diffuse>(world);
    mark::<SpecularBlend>(world);
    mark::<SpecularLobe>(world);
}
