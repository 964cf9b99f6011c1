//! Prior maps: which are found, what of them is read, and what is refused.

use super::*;
use crate::dataset::priors::{AlbedoPrior, NormalAxes, NormalPrior, Priors};
use lobelia_geometry::view::{AlbedoMap, NormalMap, ViewPriors};

/// Half the pixels of a view, of the same shape.
const SMALL: [u32; 2] = [3, 2];

fn options(set: &Set, albedo: bool, axes: Option<NormalAxes>) -> DatasetOptions {
    let albedo = albedo.then(|| AlbedoPrior { folder: set.path("albedo"), gamma: Gamma::Linear });
    let normals = axes.map(|axes| NormalPrior { folder: set.path("normals"), axes, weight: 1.0 });
    DatasetOptions { priors: Priors { albedo, normals }, ..DatasetOptions::default() }
}

fn write_map(set: &Set, name: &str, [width, height]: [u32; 2], pixel: fn(u32) -> [u8; 4]) {
    RgbaImage::from_fn(width, height, |x, _| image::Rgba(pixel(x))).save(set.file(name)).unwrap();
}

fn priors(set: &Set, options: DatasetOptions) -> Vec<ViewPriors> {
    set.all_with(options).unwrap().views.into_iter().map(|view| view.priors).collect()
}

#[test]
fn a_map_is_called_as_its_photograph_and_says_nothing_where_it_does_not_cover() {
    let set = physg(2);
    // One view has a map of another size, with a hole; the other has none.
    write_map(&set, "albedo/v_1.png", [12, 8], |x| [51, 102, 153, if x < 4 { 0 } else { 255 }]);
    let options = options(&set, true, None);
    let found = priors(&set, options.clone());
    assert!(found[0].albedo.is_none() && found[1].normals.is_none());
    let map = found[1].albedo.as_ref().unwrap();
    // The mask ends after the fourth column, the hole after the second.
    for (pixel, known) in [(0, false), (1, false), (2, true), (3, true), (4, false), (8, true)] {
        let albedo = map.at(pixel);
        assert_eq!(albedo.is_some(), known, "{pixel}");
        assert!(albedo.is_none_or(|albedo| albedo.abs_diff_eq(Vec3::new(0.2, 0.4, 0.6), 1e-3)), "{albedo:?}");
    }
    let notes = set.all_with(options).unwrap().notes.join(" | ");
    assert_says(&notes, &["1 of 2 training photographs have an albedo map"]);
}

#[test]
fn albedo_of_another_unit_has_its_colors() {
    let set = physg(1);
    // As bytes are, but beyond half floats, and negative in a pixel as filters leave it.
    let channel = |level: f32| (0..24).map(|i| if i == 7 { -level } else { level * 4e5 }).collect::<Vec<_>>();
    let channels = [("R", 0.25), ("G", 0.5), ("B", 1.0)].map(|(name, level)| (name, channel(level)));
    write_exr(&set.file("albedo/v_0.exr"), 6, 4, &channels);
    let map = priors(&set, options(&set, true, None)).remove(0).albedo.unwrap();
    assert!(map.at(8).unwrap().abs_diff_eq(Vec3::new(0.25, 0.5, 1.0), 1e-3), "{:?}", map.at(8));
    assert_eq!(map.at(7), None);
}

#[test]
fn normals_are_turned_into_the_world_and_what_is_none_is_unknown() {
    let set = physg(1);
    // Toward the camera, and a little up.
    write_map(&set, "normals/v_0.png", SMALL, |_| [128, 179, 242, 255]);
    let read = |axes| priors(&set, options(&set, false, Some(axes))).remove(0).normals.unwrap();
    let view = set.all().views.remove(0);
    let [right, down, forward] = view.camera.world_from_camera.matrix3.to_cols_array_2d().map(Vec3::from);
    let expected = (0.004 * right - 0.404 * down - 0.898 * forward).normalize();
    let found = read(NormalAxes::Camera).at(8).unwrap();
    assert!(found.abs_diff_eq(expected, 3e-3), "{found} {expected}");
    // The same numbers are another direction in the world's axes: the cameras look along −x there.
    write_map(&set, "normals/v_0.png", SIZE, |_| [242, 128, 179, 255]);
    let found = read(NormalAxes::World).at(8).unwrap();
    assert!(found.abs_diff_eq(Vec3::new(0.898, 0.004, 0.404).normalize(), 5e-3), "{found}");
    write_map(&set, "normals/v_0.png", SIZE, |x| [128, 128, if x == 1 { 140 } else { 255 }, 255]);
    let map = read(NormalAxes::Camera);
    assert_eq!([0, 1, 2].map(|pixel| map.at(pixel).is_some()), [true, false, true]);
}

#[test]
fn maps_that_cannot_be_of_the_photographs_are_refused() {
    let set = physg(1);
    let refusal = || input_error(set.all_with(options(&set, true, Some(NormalAxes::Camera))));
    write_map(&set, "albedo/other.png", SIZE, |_| [9, 9, 9, 255]);
    assert_says(&refusal(), &["albedo", "none of the 1 training photographs", "v_0.png"]);
    write_map(&set, "albedo/v_0.png", [4, 4], |_| [9, 9, 9, 255]);
    assert_says(&refusal(), &["normals", "none of the 1 training photographs"]);
    write_map(&set, "normals/v_0.png", SIZE, |_| [128, 128, 0, 255]);
    assert_says(&refusal(), &["albedo/v_0.png", "4×4", "6×4", "another shape"]);
    write_map(&set, "albedo/v_0.png", SIZE, |_| [9, 9, 9, 255]);
    let words = ["normals/v_0.png", "100 % of the normals look away", "toward the camera", "World"];
    assert_says(&refusal(), &words);
}

#[test]
fn maps_are_files_that_are_read_and_become_components() {
    let set = physg(1);
    write_map(&set, "albedo/v_0.png", SIZE, |_| [9, 9, 9, 255]);
    write_map(&set, "normals/v_0.png", SIZE, |_| [128, 128, 255, 255]);
    let options = DatasetOptions { hold_out: 0, ..options(&set, true, Some(NormalAxes::Camera)) };
    let open = open_dataset(set.0.path(), Split::Train, &options).unwrap();
    let read: Vec<PathBuf> = open.views[0].pictures().map(|file| file.path).collect();
    assert!(read.contains(&set.path("albedo/v_0.png")) && read.contains(&set.path("normals/v_0.png")));
    let mut world = bevy_ecs::prelude::World::new();
    lobelia_geometry::view::spawn_views(&mut world, set.all_with(options).unwrap().views);
    assert_eq!(world.query::<(&AlbedoMap, &NormalMap)>().iter(&world).count(), 1);
}
