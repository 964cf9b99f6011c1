//! Tests of masks in the values and colors that programs write.

use super::*;

#[test]
fn masks_are_luma_or_alpha() {
    let (_dir, at) = folder();
    GrayImage::from_raw(3, 1, vec![0, 51, 255]).unwrap().save(at("gray.png")).unwrap();
    assert_eq!(read_mask(at("gray.png"), Orientation::Upright).unwrap().mask.coverage, [0.0, 0.2, 1.0]);
    let rgba = |pixels: Vec<u8>| RgbaImage::from_raw(2, 1, pixels).unwrap().save(at("rgba.png")).unwrap();
    rgba(vec![0, 0, 0, 255, 0, 0, 0, 51]);
    assert_eq!(read_mask(at("rgba.png"), Orientation::Upright).unwrap().mask.coverage, [1.0, 0.2]);
    rgba(vec![255, 255, 255, 255, 0, 0, 0, 255]);
    assert_eq!(read_mask(at("rgba.png"), Orientation::Upright).unwrap().mask.coverage, [1.0, 0.0]);
    rgba(vec![0, 0, 0, 255, 0, 0, 0, 255]);
    assert_eq!(read_mask(at("rgba.png"), Orientation::Upright).unwrap().mask.coverage, [0.0, 0.0]);
    let deep: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_raw(2, 1, vec![65535u16, 13107]).unwrap();
    deep.save(at("deep.png")).unwrap();
    assert_eq!(read_mask(at("deep.png"), Orientation::Upright).unwrap().mask.coverage, [1.0, 0.2]);
    write_exr(&at("m.exr"), 2, 1, &[("Y", vec![0.25, 1.5])]);
    assert_eq!(read_mask(at("m.exr"), Orientation::Upright).unwrap().mask.coverage, [0.25, 1.0]);
    write_exr(&at("m.exr"), 2, 1, &[("Y", vec![0.25, f32::NAN])]);
    assert!(problem_of(read_mask(at("m.exr"), Orientation::Upright)).contains("pixel (1, 0)"));
}

fn gray(at: &impl Fn(&str) -> PathBuf, values: &[u8]) -> LoadedMask {
    let path = at("mask.png");
    GrayImage::from_raw(values.len() as u32, 1, values.to_vec()).unwrap().save(&path).unwrap();
    read_mask(path, Orientation::Upright).unwrap()
}

#[test]
fn one_low_value_is_full_coverage() {
    let (_dir, at) = folder();
    for low in [1, 127, 128, 254] {
        let loaded = gray(&at, &[0, low, low, 0]);
        assert_eq!(loaded.mask.coverage, [0.0, 1.0, 1.0, 0.0]);
        assert_eq!(loaded.full, f32::from(low) / 255.0);
    }
    // Edges between 0 and 127.
    let loaded = gray(&at, &[0, 64, 127, 127, 126, 32]);
    assert_eq!(loaded.mask.coverage[2..4], [1.0, 1.0]);
    assert!((loaded.mask.coverage[1] - 64.0 / 127.0).abs() < 1e-6);
    assert_eq!(loaded.full, 127.0 / 255.0);
    assert_eq!(gray(&at, &[0, 200, 255, 0]).full, 1.0);
    // Soft coverage that has no one value is what it is.
    let soft = gray(&at, &[40, 80, 120, 160, 200, 120, 80, 40]);
    assert_eq!((soft.full, soft.mask.coverage[4]), (1.0, 200.0 / 255.0));
    assert_eq!(gray(&at, &[0, 0]), LoadedMask { mask: soft_black(), full: 1.0 });
    let deep: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_raw(3, 1, vec![0u16, 255, 255]).unwrap();
    deep.save(at("deep.png")).unwrap();
    let loaded = read_mask(at("deep.png"), Orientation::Upright).unwrap();
    assert_eq!((loaded.mask.coverage, loaded.full), (vec![0.0, 1.0, 1.0], 255.0 / 65_535.0));
}

fn soft_black() -> crate::view::Mask {
    crate::view::Mask { width: 2, height: 1, coverage: vec![0.0; 2] }
}

/// A row of palette indices.
fn palette(path: &PathBuf, colors: &[[u8; 3]], indices: &[u8]) {
    let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), indices.len() as u32, 1);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(colors.concat());
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(indices).unwrap();
    writer.finish().unwrap();
}

#[test]
fn one_color_of_a_palette_is_full_coverage_and_several_are_refused() {
    let (_dir, at) = folder();
    let (black, red, green) = ([0, 0, 0], [128, 0, 0], [0, 128, 0]);
    palette(&at("p.png"), &[black, red, green], &[0, 1, 1, 0]);
    let loaded = read_mask(at("p.png"), Orientation::Upright).unwrap();
    assert_eq!(loaded.mask.coverage, [0.0, 1.0, 1.0, 0.0]);
    assert!(loaded.full < 0.2);
    // Colors count, not indices.
    palette(&at("p.png"), &[[255; 3], black], &[0, 1, 1, 0]);
    let loaded = read_mask(at("p.png"), Orientation::Upright).unwrap();
    assert_eq!((loaded.mask.coverage, loaded.full), (vec![1.0, 0.0, 0.0, 1.0], 1.0));
    palette(&at("p.png"), &[black, red, green], &[0, 1, 2, 0]);
    let problem = problem_of(read_mask(at("p.png"), Orientation::Upright));
    assert!(problem.contains("2 colors") && problem.contains("white where the object is"), "{problem}");
}

#[test]
fn soft_edges_of_one_color_are_coverage() {
    let (_dir, at) = folder();
    let colors = [[0, 0, 0], [200, 40, 10], [100, 20, 5], [51, 10, 3]];
    palette(&at("p.png"), &colors, &[0, 1, 1, 1, 1, 2, 3]);
    let coverage = read_mask(at("p.png"), Orientation::Upright).unwrap().mask.coverage;
    let expected = [0.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.25];
    assert!(coverage.iter().zip(expected).all(|(found, truth)| (found - truth).abs() < 0.02), "{coverage:?}");
}

#[test]
fn gray_labels_are_refused() {
    let (_dir, at) = folder();
    GrayImage::from_raw(4, 1, vec![0, 1, 2, 3]).unwrap().save(at("m.png")).unwrap();
    let problem = problem_of(read_mask(at("m.png"), Orientation::Upright));
    assert!(problem.contains("values from 0 to 3"), "{problem}");
}

#[test]
fn noise_of_a_black_jpeg_is_no_object() {
    let (_dir, at) = folder();
    GrayImage::from_fn(16, 16, |x, _| Luma([u8::from(x > 7) * 3])).save(at("m.jpg")).unwrap();
    let loaded = read_mask(at("m.jpg"), Orientation::Upright).unwrap();
    assert!(loaded.full == 1.0 && loaded.mask.coverage.iter().all(|&c| c < 0.03), "{loaded:?}");
}

#[test]
fn the_alpha_of_a_cut_out_photograph_is_the_mask() {
    let (_dir, at) = folder();
    let cut = RgbaImage::from_fn(8, 8, |x, y| {
        if x < 4 { Rgba([30 * x as u8, 9 * y as u8, 200, 255]) } else { Rgba([0; 4]) }
    });
    cut.save(at("m.png")).unwrap();
    let coverage = read_mask(at("m.png"), Orientation::Upright).unwrap().mask.coverage;
    assert!(coverage.iter().enumerate().all(|(i, &c)| c == if i % 8 < 4 { 1.0 } else { 0.0 }));
}
