//! Poses that are written with few decimals.

use super::*;

/// A frame with the matrix of a turn about all axes, of so many decimals.
fn frame(index: usize, decimals: i32) -> Value {
    let turn = glam::DMat3::from_rotation_z(0.7)
        * glam::DMat3::from_rotation_y(0.4)
        * glam::DMat3::from_rotation_x(1.0);
    let unit = 10f64.powi(decimals);
    let at = |i: usize, k: usize| (turn.col(k)[i] * unit).round() / unit;
    let rows: Vec<Vec<f64>> = (0..3).map(|i| vec![at(i, 0), at(i, 1), at(i, 2), index as f64]).collect();
    json!({ "file_path": format!("test/r_{index}"), "transform_matrix": rows })
}

fn with_decimals(decimals: [i32; 3]) -> Nerf {
    let mut set = Nerf::new(3);
    set.json["frames"] = (0..3).map(|i| frame(i, decimals[i])).collect();
    set.write();
    set
}

#[test]
fn poses_of_three_decimals_are_made_exact_with_a_note() {
    assert!(with_decimals([8, 6, 5]).read().unwrap().notes.is_empty());
    let set = with_decimals([3, 8, 3]).read().unwrap();
    let words =
        ["the poses of 2 views are written with too few decimals", "(r_", "off by 1.", "`cameras: Poses`"];
    assert_says(&set.notes.join(" "), &words);
    let [rounded, exact] = [0, 1].map(|i| set.views[i].camera.ray(3.0, 2.0).direction);
    assert!((rounded.length() - 1.0).abs() < 1e-6 && rounded.distance(exact) < 2e-3, "{rounded} {exact}");
}

#[test]
fn poses_of_one_decimal_are_refused() {
    let text = input_error(with_decimals([8, 1, 8]).read());
    assert_says(&text, &["frame 1", "transform_matrix is not rigid"]);
    let mut set = Nerf::new(1);
    set.json["frames"][0]["transform_matrix"][0] = json!([1.0, 0.01, 0.0, 0.1]);
    set.write();
    assert_says(&input_error(set.read()), &["is not rigid", "too few decimals: export it with 6"]);
}
