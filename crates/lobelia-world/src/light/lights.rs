//! Lights in a world: lobes are entities, a named light is an entity that its lobes refer to, and
//! the system in [`Slot::Light`](crate::pipeline::Slot::Light) selects the active light.
//!
//! Lobes that refer to no light are the scene's own light, which a fit optimizes. Relighting means
//! spawning a named light and swapping in [`provide_light`] with its name; closed forms and the
//! path tracer both use it.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_world::light::LightLobe;
//! use lobelia_world::light::lights::{IncidentLight, LightChoice, provide_light, spawn_light};
//! use lobelia_world::pipeline::{Phase, Pipeline, Slot};
//!
//! let lamp = LightLobe { axis: Vec3::Y, sharpness: 4.0, amplitude: Vec3::ONE };
//! let mut pipeline = Pipeline::new();
//! pipeline.world.init_resource::<IncidentLight>();
//! spawn_light(&mut pipeline.world, "lamp", &[lamp], None);
//! let choice = LightChoice::Named("lamp".into());
//! pipeline.swap(Phase::Compose, Slot::Light, provide_light(choice, false));
//! pipeline.run(Phase::Compose)?;
//! assert_eq!(pipeline.world.resource::<IncidentLight>().lobes.get(0).axis, [0.0, 1.0, 0.0]);
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use super::illuminate::{LobeLight, MapLight, TurnedLight};
use super::light_frame::{LightFrame, OwnLightFrame, PictureRotation};
use super::lobe::{LightLobe, rotate_lobes};
use super::placement::{
    GroupInTurn, LightGroup, PicturePlacement, PlacedFrame, Placements, light_from_world,
};
use crate::pipeline::SystemResult;
use bevy_ecs::prelude::*;
use bevy_ecs::schedule::ScheduleConfigs;
use bevy_ecs::system::{ScheduleSystem, SystemParam};
use glam::{Mat3, Quat};
use lobelia_geometry::{Error, Result};
use lobelia_sg::{ray::Illuminate, shading::LobeColumns};
use std::sync::Arc;

/// Name of a light other than the scene's own.
#[derive(Component, Clone, Debug, PartialEq, Eq)]
#[require(LobesOf)]
pub struct LightName(pub String);

/// The light that a lobe belongs to. Lobes without this component belong to the scene's own light.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
#[relationship(relationship_target = LobesOf)]
pub struct LobeOf(pub Entity);

/// The lobes of a light. They are despawned with it.
#[derive(Component, Clone, Debug, Default, PartialEq, Eq)]
#[relationship_target(relationship = LobeOf, linked_spawn)]
pub struct LobesOf(Vec<Entity>);

impl LobesOf {
    /// Their entities, in order.
    pub fn entities(&self) -> &[Entity] {
        &self.0
    }
}

/// The environment map that the lobes of a light approximate. An entity with this component and
/// neither [`LightName`] nor [`LightGroup`] has the map of the scene's own light.
#[derive(Component, Clone)]
pub struct LightMap(pub Arc<MapLight>);

/// The light of this run, written by the system in [`Slot::Light`](crate::pipeline::Slot::Light).
#[derive(Resource, Clone, Default)]
pub struct IncidentLight {
    /// SG lobes in columns, for closed forms.
    pub lobes: LobeColumns,
    /// The lobes' entities, in the same order.
    pub entities: Vec<Entity>,
    /// The light in a form that can be sampled, for path tracing.
    pub distant: Option<Arc<dyn Illuminate>>,
    /// The frame of the lobes, for samples of several views, and the placements under them. A
    /// picture's light is in the world, turned as its camera has it.
    pub frame: PlacedFrame,
    /// The rotation from the light's frame into the world that the lobes have had already.
    pub turn: Mat3,
}

/// The active light.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum LightChoice {
    /// The scene's own light, or that of the [`GroupInTurn`].
    #[default]
    Own,
    /// The light with this name.
    Named(String),
}

/// The lobes of a light with their entities, its map and its frame, if it has them.
type PlainLight = (Vec<(Entity, LightLobe)>, Option<Arc<MapLight>>, Option<LightFrame>);

/// All lights, as a system parameter.
#[derive(SystemParam)]
struct Lights<'w, 's> {
    own: Query<'w, 's, (Entity, &'static LightLobe), Without<LobeOf>>,
    own_map: Query<'w, 's, &'static LightMap, (Without<LightName>, Without<LightGroup>)>,
    groups: Query<'w, 's, (&'static LightGroup, &'static LobesOf, Option<&'static LightMap>)>,
    named: Query<
        'w,
        's,
        (&'static LightName, &'static LobesOf, Option<&'static LightMap>, Option<&'static LightFrame>),
    >,
    lobes: Query<'w, 's, (Entity, &'static LightLobe), With<LobeOf>>,
    own_frame: Option<Res<'w, OwnLightFrame>>,
    own_placements: Option<Res<'w, Placements>>,
    picture: Option<Res<'w, PictureRotation>>,
    picture_placement: Option<Res<'w, PicturePlacement>>,
    in_turn: Option<Res<'w, GroupInTurn>>,
}

impl Lights<'_, '_> {
    /// The chosen light; an error if there is no light with that name, or there are several.
    fn of(&self, choice: &LightChoice) -> Result<PlainLight> {
        let LightChoice::Named(name) = choice else {
            let frame = Some(self.own_frame.as_deref().map(|own| own.0).unwrap_or_default());
            let group = self.in_turn.as_deref().map(|turn| turn.0);
            if let Some((_, lobes, map)) = self.groups.iter().find(|(of, ..)| Some(**of) == group) {
                return Ok(self.with_lobes(lobes, map, frame));
            }
            let lobes = self.own.iter().map(|(entity, lobe)| (entity, *lobe)).collect();
            return Ok((lobes, self.own_map.iter().next().map(|map| map.0.clone()), frame));
        };
        let mut found = self.named.iter().filter(|(of, ..)| of.0 == *name);
        let (Some((_, lobes, map, frame)), None) = (found.next(), found.next()) else {
            let names: Vec<&str> = self.named.iter().map(|(name, ..)| name.0.as_str()).collect();
            let problem =
                format!("there must be exactly one light named {name}; the lights are: {}", names.join(", "));
            return Err(Error::run("the light", problem));
        };
        Ok(self.with_lobes(lobes, map, frame.copied()))
    }

    fn with_lobes(&self, lobes: &LobesOf, map: Option<&LightMap>, frame: Option<LightFrame>) -> PlainLight {
        let lobes = self.lobes.iter_many(&lobes.0).flatten().map(|(entity, lobe)| (entity, *lobe)).collect();
        (lobes, map.map(|map| map.0.clone()), frame)
    }

    /// The frame of the lobes of a light after a rotation into the world, and that rotation.
    fn placed(&self, choice: &LightChoice, frame: Option<LightFrame>) -> (PlacedFrame, Mat3) {
        // Other lights stand in the world, however the object lies, if they do not say otherwise: a
        // relit object turns under them.
        let Some(frame) = frame else { return (PlacedFrame::default(), Mat3::IDENTITY) };
        let Some(picture) = &self.picture else {
            let own = self.own_placements.as_deref().filter(|_| *choice == LightChoice::Own);
            return (PlacedFrame { frame, placements: own.cloned().unwrap_or_default() }, Mat3::IDENTITY);
        };
        let placement = self.picture_placement.as_deref().map_or(Mat3::IDENTITY, |placement| placement.0);
        (PlacedFrame::default(), light_from_world(frame, picture.0, placement).transpose())
    }
}

/// For [`Slot::Light`](crate::pipeline::Slot::Light): selects the active light. With `by_map`, path
/// tracing samples its map, if it has one; closed forms always use its lobes.
pub fn provide_light(choice: LightChoice, by_map: bool) -> ScheduleConfigs<ScheduleSystem> {
    provide_turned_light(choice, by_map, Quat::IDENTITY)
}

/// [`provide_light`], turned in the world: light from direction d comes from `turn * d`.
pub fn provide_turned_light(
    choice: LightChoice,
    by_map: bool,
    turn: Quat,
) -> ScheduleConfigs<ScheduleSystem> {
    let system = move |lights: Lights, mut light: ResMut<IncidentLight>| -> SystemResult {
        let (lobes, map, frame) = lights.of(&choice)?;
        let mut lobes_only: Vec<LightLobe> = lobes.iter().map(|(_, lobe)| *lobe).collect();
        (light.frame, light.turn) = lights.placed(&choice, frame);
        if turn != Quat::IDENTITY {
            light.turn = Mat3::from_quat(turn) * light.turn;
        }
        if light.turn != Mat3::IDENTITY {
            lobes_only = rotate_lobes(&lobes_only, Quat::from_mat3(&light.turn));
        }
        light.entities = lobes.iter().map(|(entity, _)| *entity).collect();
        light.lobes = LobeColumns::from_lobes(lobes_only.iter().map(Into::into));
        light.distant = Some(match map.filter(|_| by_map) {
            Some(map) if light.turn == Mat3::IDENTITY => map,
            Some(light_of_map) => Arc::new(TurnedLight { light: light_of_map, world_from_light: light.turn }),
            None => Arc::new(LobeLight::new(&lobes_only)),
        });
        Ok(())
    };
    system.into_configs()
}

/// Spawns a named light; replaces a light that has the name already.
pub fn spawn_light(
    world: &mut World,
    name: impl Into<String>,
    lobes: &[LightLobe],
    map: Option<Arc<MapLight>>,
) -> Entity {
    let name = name.into();
    let mut query = world.query::<(Entity, &LightName)>();
    let old: Vec<Entity> = query.iter(world).filter(|(_, of)| of.0 == name).map(|(light, _)| light).collect();
    old.into_iter().for_each(|light| _ = world.despawn(light));
    let light = world.spawn(LightName(name)).id();
    if let Some(map) = map {
        world.entity_mut(light).insert(LightMap(map));
    }
    world.spawn_batch(lobes.iter().map(|lobe| (*lobe, LobeOf(light))).collect::<Vec<_>>());
    light
}

/// The lobes of the light with a name, and its map, if it has one.
pub fn named_light(world: &mut World, name: &str) -> Option<(Vec<LightLobe>, Option<Arc<MapLight>>)> {
    let mut lights = world.query::<(&LightName, &LobesOf, Option<&LightMap>)>();
    let (_, lobes, map) = lights.iter(world).find(|(of, ..)| of.0 == name)?;
    let lobes = lobes.0.iter().filter_map(|lobe| world.get::<LightLobe>(*lobe).copied()).collect();
    Some((lobes, map.map(|map| map.0.clone())))
}

/// The map of the scene's own light, if it has one.
pub fn own_map(world: &mut World) -> Option<Arc<MapLight>> {
    let mut own = world.query_filtered::<&LightMap, (Without<LightName>, Without<LightGroup>)>();
    own.iter(world).next().map(|map| map.0.clone())
}

/// The lobes of the scene's own light.
pub fn own_lobes(world: &mut World) -> Vec<LightLobe> {
    world.query_filtered::<&LightLobe, Without<LobeOf>>().iter(world).copied().collect()
}
