//! Data sets that are well-formed.

use super::*;

#[test]
fn physg_views_come_with_camera_image_and_mask() {
    let dataset = PhySg::new(2).read().unwrap();
    assert_eq!(dataset.layout, Layout::PhySg);
    assert!(dataset.notes.is_empty(), "{:?}", dataset.notes);
    assert_eq!(names(&dataset), ["v_0", "v_1"]);
    let view = &dataset.views[1];
    let camera = view.camera;
    assert_eq!((camera.width, camera.height, camera.skew, camera.pixel_center), (6, 4, 0.5, 0.5));
    assert_eq!((camera.focal, camera.center), ([8.0, 9.0], [3.0, 2.0]));
    // W2C sends the eye to the origin and looks along world −X with world +Y up.
    assert!(camera.position().distance(Vec3::new(3.0, 0.0, 0.25)) < 1e-6);
    assert!(camera.ray(3.0, 2.0).direction.distance(Vec3::NEG_X) < 1e-6);
    let (_, y, _) = camera.project(Vec3::new(0.0, 0.1, 0.25)).unwrap();
    assert!(y < 2.0, "world +Y is up in the image");
    assert_eq!(view.photograph.as_ref().unwrap().radiance(0), Vec3::splat(1.5));
    assert_eq!(mask_of(view).coverage[..6], [1.0, 1.0, 1.0, 1.0, 0.0, 0.0]);
}

#[test]
fn nerf_views_come_in_opencv_axes_with_alpha_as_mask() {
    let dataset = Nerf::new(2).read().unwrap();
    assert_eq!((dataset.layout, dataset.views[0].split), (Layout::Nerf, Split::Test));
    assert_eq!(names(&dataset), ["r_0", "r_1"]);
    let camera = dataset.views[0].camera;
    assert!((camera.focal[0] - 3.0 / 0.4f32.tan()).abs() < 1e-5);
    assert_eq!((camera.focal[1], camera.center), (camera.focal[0], [3.0, 2.0]));
    assert!(camera.position().distance(Vec3::new(0.1, 0.2, 3.0)) < 1e-6);
    assert!(camera.ray(3.0, 2.0).direction.distance(Vec3::NEG_Z) < 1e-6, "OpenGL cameras look along −Z");
    let (_, y, _) = camera.project(Vec3::new(0.1, 0.5, 0.0)).unwrap();
    assert!(y < 2.0, "world +Y is up in the image");
    assert_eq!(mask_of(&dataset.views[0]).coverage[3..5], [1.0, 0.0]);
    assert_eq!(dataset.views[0].photograph.as_ref().unwrap().radiance(5), Vec3::ZERO);
}

#[test]
fn nerf_intrinsics_of_a_frame_go_before_the_shared_ones() {
    let mut set = Nerf::new(2);
    set.json["fl_y"] = json!(11.0);
    set.json["cx"] = json!(2.75);
    set.json["k1"] = json!(0.4);
    set.json["frames"][1]["k1"] = json!(0.0);
    set.json["frames"][1]["fl_x"] = json!(7.0);
    set.json["frames"][1]["camera_angle_y"] = json!(1.0);
    set.json["frames"][1]["w"] = json!(6);
    set.json["frames"][1]["h"] = json!(4.0);
    set.write();
    let dataset = set.read().unwrap();
    let [shared, own] = [0, 1].map(|i| dataset.views[i].camera);
    assert_eq!((shared.focal[1], shared.width), (11.0, 4), "the pincushion's frame shrinks");
    assert_eq!((own.width, own.center), (6, [2.75, 2.0]));
    assert_eq!(own.focal[0], 7.0);
    assert!((own.focal[1] - 2.0 / 0.5f32.tan()).abs() < 1e-5);
}

#[test]
fn names_are_ordered_naturally_and_thinned() {
    let set = PhySg::new(12);
    let every = |every| {
        let dataset = set.read_with(&DatasetOptions { every, ..DatasetOptions::default() }).unwrap();
        names(&dataset).join(" ")
    };
    assert_eq!(every(1), "v_0 v_1 v_2 v_3 v_4 v_5 v_6 v_7 v_8 v_9 v_10 v_11");
    assert_eq!(every(5), "v_0 v_5 v_10");
    assert_eq!(every(100), "v_0");
    let select = Some(["v_10", "v_2", "v_3", "v_2"].map(String::from).to_vec());
    let options = DatasetOptions { select, every: 2, ..DatasetOptions::default() };
    assert_eq!(names(&set.read_with(&options).unwrap()), ["v_2", "v_10"]);
}

#[test]
fn downscaling_keeps_image_mask_and_camera_together() {
    let set = PhySg::new(1);
    let full = set.read().unwrap().views.remove(0);
    let options = DatasetOptions { downscale: 2, pixel_center: Some(0.0), ..DatasetOptions::default() };
    let half = set.read_with(&options).unwrap().views.remove(0);
    assert_eq!((half.camera.width, half.camera.height, half.camera.pixel_center), (3, 2, 0.0));
    let photograph = half.photograph.unwrap();
    assert_eq!(photograph.size(), [3, 2]);
    assert_eq!(half.mask.unwrap().mask().coverage, [1.0, 1.0, 0.0, 1.0, 1.0, 0.0]);
    let mut unscaled = full.camera;
    unscaled.pixel_center = 0.0;
    let (a, b) = (unscaled.ray(5.0, 1.0), half.camera.ray(2.5, 0.5));
    assert!(a.direction.distance(b.direction) < 1e-6);
}

#[test]
fn cameras_without_images_are_read() {
    let set = PhySg::new(2);
    for folder in ["train/image", "train/mask"] {
        fs::remove_dir_all(set.path(folder)).unwrap();
    }
    let views = set.read().unwrap().views;
    assert!(views.iter().all(|view| view.photograph.is_none() && view.mask.is_none()));

    let mut set = Nerf::new(1);
    fs::remove_dir_all(set.path("test")).unwrap();
    set.json["w"] = json!(6);
    set.json["h"] = json!(4);
    set.json["frames"]
        .as_array_mut()
        .unwrap()
        .push(json!({"transform_matrix": nerf_frame("")["transform_matrix"]}));
    set.write();
    let dataset = set.read().unwrap();
    assert_eq!(names(&dataset), ["frame_000001", "r_0"]);
    assert!(dataset.views.iter().all(|view| view.photograph.is_none() && view.camera.width == 6));
}

#[test]
fn nan_and_infinite_pixels_are_counted_in_a_note() {
    let set = PhySg::new(2);
    let mut red = on_black(1.0);
    red[0] = f32::NAN;
    red[7] = f32::INFINITY;
    let channels = [("R", red), ("G", on_black(1.0)), ("B", on_black(1.0))];
    write_exr(&set.path("train/image/v_1.exr"), 6, 4, &channels);
    let dataset = set.read().unwrap();
    assert_eq!(dataset.notes.len(), 1);
    assert_says(&dataset.notes[0], &["2 NaN or infinite pixels", "v_1: 2"]);
    let photograph = dataset.views[1].photograph.as_ref().unwrap();
    assert_eq!(
        (photograph.radiance(7), photograph.is_saturated(7), photograph.is_saturated(8)),
        (Vec3::ZERO, true, false)
    );
}

#[test]
fn photographs_without_alpha_are_put_on_black() {
    let set = PhySg::new(1);
    fs::remove_file(set.path("train/image/v_0.exr")).unwrap();
    image::RgbImage::from_pixel(6, 4, image::Rgb([255, 200, 90]))
        .save(set.path("train/image/v_0.png"))
        .unwrap();
    let dataset = set.read().unwrap();
    assert_says(&dataset.notes.join(" "), &["made black in 1 photographs"]);
    let photograph = dataset.views[0].photograph.as_ref().unwrap();
    assert_eq!((photograph.radiance(4), photograph.radiance(3).x), (Vec3::ZERO, 1.0));
    assert_eq!([3, 4].map(|i| photograph.is_saturated(i)), [true, false]);
}

#[test]
fn float_photographs_lose_their_background_and_renderings_keep_their_rim() {
    let set = PhySg::new(1);
    let write = |background: f32, lit: usize| {
        let mut values = on_black(1.0);
        let outside = (0..values.len()).filter(|i| i % SIZE.0 >= 4);
        outside.take(lit).for_each(|i| values[i] = background);
        let channels = ["R", "G", "B"].map(|c| (c, values.clone()));
        write_exr(&set.path("train/image/v_0.exr"), SIZE.0, SIZE.1, &channels);
        let dataset = set.read().unwrap();
        (dataset.notes.join(" "), dataset.views[0].photograph.as_ref().unwrap().radiance(4))
    };
    let (note, pixel) = write(3.0, 8);
    assert_says(&note, &["made black in 1 photographs"]);
    assert_eq!(pixel, Vec3::ZERO);
    assert_eq!(write(3.0, 0), (String::new(), Vec3::ZERO));
    // Large enough that one lit pixel, in a hole of the mask, is a rim.
    let set = PhySg::new(1);
    let wide = (60, 4);
    let mut values: Vec<f32> = (0..240).map(|i| if i % 60 < 20 { 1.0 } else { 0.0 }).collect();
    values[65] = 0.001;
    let channels = ["R", "G", "B"].map(|c| (c, values.clone()));
    write_exr(&set.path("train/image/v_0.exr"), wide.0, wide.1, &channels);
    let mask =
        GrayImage::from_fn(60, 4, |x, y| image::Luma([if x < 20 && (x, y) != (5, 1) { 255 } else { 0 }]));
    mask.save(set.path("train/mask/v_0.png")).unwrap();
    let mut camera = physg_camera();
    camera["img_size"] = json!([60, 4]);
    let cameras = json!({ "v_0.exr": camera });
    fs::write(set.path("train/cam_dict_norm.json"), cameras.to_string()).unwrap();
    let dataset = set.read().unwrap();
    assert!(dataset.notes.is_empty(), "{:?}", dataset.notes);
    assert_eq!(dataset.views[0].photograph.as_ref().unwrap().radiance(65), Vec3::splat(0.001));
}

#[test]
fn images_without_camera_are_noted_and_mask_folder_may_be_replaced_by_alpha() {
    let set = PhySg::new(1);
    let channels = ["R", "G", "B", "A"].map(|c| (c, vec![0.5; 24]));
    write_exr(&set.path("train/image/v_0.exr"), 6, 4, &channels);
    write_exr(&set.path("train/image/other.exr"), 6, 4, &channels);
    fs::remove_dir_all(set.path("train/mask")).unwrap();
    let dataset = set.read().unwrap();
    assert_says(&dataset.notes.join(" "), &["1 images in", "have no camera"]);
    assert_eq!(mask_of(&dataset.views[0]).coverage[0], 0.5);
}

#[test]
fn image_paths_may_be_absolute_or_lead_outside() {
    let pictures = Nerf::new(2);
    let mut set = Nerf::new(0);
    let absolute = pictures.path("test/r_1.png").display().to_string();
    let sideways = format!("../{}/test/r_0", pictures.dir.path().file_name().unwrap().to_string_lossy());
    set.json["frames"] = json!([nerf_frame(&absolute), nerf_frame(&sideways)]);
    set.write();
    let dataset = set.read().unwrap();
    assert_eq!(names(&dataset), ["r_0", "r_1"]);
    assert!(dataset.views.iter().all(|view| view.photograph.is_some()));
}

#[test]
fn small_errors_of_rotation_are_made_good() {
    let mut set = PhySg::new(1);
    let mut matrix = physg_camera()["W2C"].clone();
    matrix[2] = json!(-1.0004);
    set.spoil(0, "W2C", matrix);
    let rotation = set.read().unwrap().views[0].camera.world_from_camera.matrix3;
    assert!((rotation.determinant() - 1.0).abs() < 1e-6);
}

#[test]
fn options_are_read_from_ron() {
    let options: DatasetOptions = ron::from_str(
        "(layout: Nerf, gamma: Power(2.2), downscale: 2, select: Some([\"a\"]), up: (0, 0, 1))",
    )
    .unwrap();
    assert_eq!((options.layout, options.gamma, options.downscale), (Layout::Nerf, Gamma::Power(2.2), 2));
    assert_eq!((options.up, options.every, options.pixel_center), (Vec3::Z, 1, None));
    assert!(ron::from_str::<DatasetOptions>("(downscal: 2)").is_err());
    let text = ron::to_string(&options).unwrap();
    assert_eq!(ron::from_str::<DatasetOptions>(&text).unwrap(), options);
}
