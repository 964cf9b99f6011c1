use super::*;
use crate::pipeline::pool::pool_index;
use bevy_ecs::prelude::{Component, With};
use std::sync::{Arc, Mutex};

pool_index! {
    /// A row.
    Row("row");
}

#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Value(f32);

#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Weight(#[serde(with = "packed::array")] [f32; 3]);

#[derive(Component)]
struct Lamp;

#[derive(Resource, Debug, PartialEq, Serialize, Deserialize)]
struct Sums(#[serde(with = "packed::sparse")] Vec<f32>);

type Written = Arc<Mutex<Vec<(Place, Checkpoint)>>>;

struct Memory(Written);

impl Store for Memory {
    fn write(&mut self, place: Place, checkpoint: &Checkpoint) -> Result<()> {
        self.0.lock().unwrap().push((place, checkpoint.clone()));
        Ok(())
    }
}

/// A world in which nothing is found yet, and where its checkpoints go.
fn world(rows: u32, ahead: Vec<(Place, Checkpoint)>) -> (World, Written) {
    let mut world = World::new();
    world.spawn_batch((0..rows).map(|row| (Row(row), Value(0.0))).collect::<Vec<_>>());
    world.spawn_batch(vec![Lamp, Lamp]);
    world.insert_resource(Sums(vec![0.0; 5]));
    keep_pool::<Row, Value>(&mut world, Span::Run);
    keep_each::<Weight, With<Lamp>>(&mut world, Span::Run);
    keep_resource::<Sums>(&mut world, Span::Pass);
    let written = Written::default();
    let store = Box::new(Memory(written.clone()));
    world.insert_resource(Checkpoints::new(store, Duration::ZERO, ahead));
    (world, written)
}

/// Finds something.
fn work(world: &mut World) {
    let mut rows = world.query::<(&Row, &mut Value)>();
    rows.iter_mut(world).for_each(|(row, mut value)| value.0 = row.0 as f32 + 0.1);
    let lamps: Vec<_> = world.query_filtered::<bevy_ecs::prelude::Entity, With<Lamp>>().iter(world).collect();
    for (i, lamp) in lamps.into_iter().enumerate() {
        world.entity_mut(lamp).insert(Weight([i as f32, 0.0, f32::NEG_INFINITY]));
    }
    world.resource_mut::<Sums>().0[3] = 7.5;
}

fn found(world: &mut World) -> (Vec<(u32, f32)>, Vec<Weight>, Vec<f32>) {
    let mut rows: Vec<(u32, f32)> =
        world.query::<(&Row, &Value)>().iter(world).map(|(row, value)| (row.0, value.0)).collect();
    rows.sort_by_key(|row| row.0);
    let weights = world.query::<&Weight>().iter(world).copied().collect();
    (rows, weights, world.resource::<Sums>().0.clone())
}

#[test]
fn the_way_to_a_place_goes_through_its_beginnings() {
    let place = |pass, level, step| Place { pass, level, step };
    assert_eq!(place(0, 0, 7).route(), [place(0, 0, 7)]);
    assert_eq!(place(0, 2, 7).route(), [place(0, 2, 0), place(0, 2, 7)]);
    assert_eq!(place(3, 0, 0).route(), [place(3, 0, 0)]);
    assert_eq!(place(3, 1, 2).route(), [place(3, 0, 0), place(3, 1, 0), place(3, 1, 2)]);
    assert!(place(0, 1, 0) > place(0, 0, 9) && place(1, 0, 0) > place(0, 9, 9));
}

#[test]
fn a_run_goes_on_from_what_was_kept() {
    let (mut first, written) = world(4, Vec::new());
    begin_pass(&mut first, 2);
    assert!(is_due(&first));
    work(&mut first);
    keep_pass(&mut first, 2, &"a pass").unwrap();
    keep_step(&mut first, 9, &vec![1u8, 2]).unwrap();
    let ahead = written.lock().unwrap().clone();
    assert_eq!(
        ahead.iter().map(|(place, _)| *place).collect::<Vec<_>>(),
        Place { pass: 2, level: 0, step: 9 }.route()
    );

    let (mut second, _) = world(4, ahead);
    let resumed = resume_pass::<String>(&mut second, |_, _| Ok(())).unwrap();
    assert_eq!(resumed, Some((2, "a pass".to_owned())));
    let (rows, weights, sums) = found(&mut first);
    assert_eq!(found(&mut second), (rows, weights, vec![0.0; 5]), "sums are state within a pass only");
    assert!(has_step_ahead(&second) && resume_level::<u8>(&mut second, |_, _| Ok(())).unwrap().is_none());
    assert_eq!(resume_step::<Vec<u8>>(&mut second).unwrap(), Some((9, vec![1, 2])));
    assert_eq!(found(&mut second), (found(&mut first).0, found(&mut first).1, sums));
    assert!(resume_step::<Vec<u8>>(&mut second).unwrap().is_none());
}

#[test]
fn a_later_level_ahead_is_known_before_it_is_taken_up() {
    let (mut first, written) = world(4, Vec::new());
    begin_pass(&mut first, 2);
    assert!(!has_level_ahead(&first));
    keep_pass(&mut first, 2, &0u8).unwrap();
    keep_level(&mut first, 1, &1u8).unwrap();
    keep_step(&mut first, 9, &2u8).unwrap();
    let ahead = written.lock().unwrap().clone();

    let (mut second, _) = world(4, ahead);
    assert!(!has_level_ahead(&second), "the pass is taken up first");
    resume_pass::<u8>(&mut second, |_, _| Ok(())).unwrap();
    assert!(has_level_ahead(&second) && !has_step_ahead(&second));
    assert_eq!(resume_level::<u8>(&mut second, |_, _| Ok(())).unwrap(), Some((1, 1)));
    assert!(!has_level_ahead(&second) && has_step_ahead(&second));
}

#[test]
fn what_lasts_is_carried_into_another_world_with_the_checkpoints() {
    let (mut first, written) = world(4, Vec::new());
    begin_pass(&mut first, 3);
    work(&mut first);
    let (mut second, _) = world(4, Vec::new());
    second.remove_resource::<Checkpoints>();
    let carried = carry(&mut first, Span::Run).unwrap();
    restore(&mut second, carried).unwrap();
    let (rows, weights, _) = found(&mut first);
    assert_eq!(found(&mut second), (rows, weights, vec![0.0; 5]), "sums are state within a pass only");
    keep_step(&mut second, 9, &0u8).unwrap();
    assert_eq!(written.lock().unwrap()[0].0, Place { pass: 3, level: 0, step: 9 });
    let carried = carry(&mut second, Span::Run).unwrap();
    assert!(restore(&mut world(5, Vec::new()).0, carried).is_err());
}

#[test]
fn bytes_are_written_as_they_would_be_kept_and_errors_stay_what_they_are() {
    let value = (vec![1u32, 300, 70_000], "text".to_owned());
    let mut written = Vec::new();
    packed::write_to(&value, &mut written).unwrap();
    assert_eq!(written, packed::to_bytes(&value).unwrap());
    struct Full;
    impl std::io::Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::StorageFull.into())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    assert_eq!(packed::write_to(&value, Full).unwrap_err().kind(), std::io::ErrorKind::StorageFull);
}

#[test]
fn what_does_not_fit_is_an_error() {
    let (mut first, written) = world(4, Vec::new());
    work(&mut first);
    keep_pass(&mut first, 1, &1u32).unwrap();
    let ahead = || written.lock().unwrap().clone();
    let refused = |mut world: World| {
        let error = resume_pass::<u32>(&mut world, |_, _| Ok(())).unwrap_err();
        assert!(error.to_string().contains("does not fit this run"), "{error}");
    };
    refused(world(5, ahead()).0);
    let mut more = world(4, ahead()).0;
    more.spawn(Lamp);
    refused(more);
    let mut less = world(4, ahead()).0;
    state::forget(&mut less, std::any::type_name::<(Row, Value)>());
    refused(less);
    let mut other = world(4, ahead()).0;
    assert!(resume_pass::<String>(&mut other, |_, _| Ok(())).is_err());
}

/// What lamps of another kind are known by.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
struct Number(u8);

/// A world with an entity for each of these numbers, in that order.
fn numbered(numbers: &[u8], ahead: Vec<(Place, Checkpoint)>) -> (World, Written) {
    let mut world = World::new();
    world.spawn_batch(numbers.iter().map(|number| Number(*number)).collect::<Vec<_>>());
    keep_keyed::<Number, Value, With<Number>>(&mut world, Span::Run);
    let written = Written::default();
    world.insert_resource(Checkpoints::new(Box::new(Memory(written.clone())), Duration::ZERO, ahead));
    (world, written)
}

#[test]
fn what_has_a_number_is_found_by_it_in_whatever_order() {
    let (mut first, written) = numbered(&[0, 1, 2, 5], Vec::new());
    let mut numbers = first.query::<(bevy_ecs::prelude::Entity, &Number)>();
    let found: Vec<_> = numbers.iter(&first).map(|(entity, number)| (entity, *number)).collect();
    for (entity, number) in found {
        first.entity_mut(entity).insert(Value(f32::from(number.0)));
    }
    keep_pass(&mut first, 1, &0u8).unwrap();
    let ahead = || written.lock().unwrap().clone();

    let mut second = numbered(&[2, 0, 5, 1], ahead()).0;
    resume_pass::<u8>(&mut second, |_, _| Ok(())).unwrap();
    let mut values = second.query::<(&Number, &Value)>();
    assert_eq!(values.iter(&second).len(), 4);
    assert!(values.iter(&second).all(|(number, value)| value.0 == f32::from(number.0)));

    for others in [[0, 1, 2, 4].as_slice(), &[0, 1, 2], &[0, 1, 2, 5, 5], &[0, 1, 2, 2]] {
        let mut other = numbered(others, ahead()).0;
        let error = resume_pass::<u8>(&mut other, |_, _| Ok(())).unwrap_err();
        assert!(error.to_string().contains("does not fit this run"), "{others:?}: {error}");
    }
}

#[test]
fn without_a_store_nothing_is_kept_and_nothing_is_ahead() {
    let mut world = World::new();
    begin_pass(&mut world, 0);
    keep_step(&mut world, 1, &0u8).unwrap();
    assert!(!is_due(&world) && !has_step_ahead(&world));
    assert_eq!(resume_step::<u8>(&mut world).unwrap(), None);
}

#[test]
fn damaged_bytes_are_no_value() {
    let bytes = packed::to_bytes(&Sums(vec![0.0, 2.0, 0.0])).unwrap();
    assert_eq!(packed::from_bytes::<Sums>(&bytes).unwrap(), Sums(vec![0.0, 2.0, 0.0]));
    for length in 0..bytes.len() {
        assert!(packed::from_bytes::<Sums>(&bytes[..length]).is_err());
    }
    let row_beyond = packed::to_bytes(&(1u32, vec![(4u32, 1.0f32)])).unwrap();
    assert!(packed::from_bytes::<Sums>(&row_beyond).is_err());
    let short = packed::to_bytes(&vec![1.0f32, 2.0]).unwrap();
    assert!(packed::from_bytes::<Weight>(&short).is_err());
    assert!(packed::from_bytes::<u8>(&[1, 2]).is_err());
}
