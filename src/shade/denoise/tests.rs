use super::*;

/// Width and height of the pictures.
const SIZE: usize = 48;
/// Samples of a pixel.
const SAMPLES: usize = 4;

/// What is seen at a pixel of the scene without noise.
#[derive(Clone, Copy)]
struct Seen {
    albedo: Vec3,
    normal: Vec3,
    irradiance: Vec3,
    specular: Vec3,
}

/// Two walls that meet in the middle row, the lower one darker and glossier, both white on the left and red without any blue on the right.
fn walls(x: usize, y: usize) -> Seen {
    let is_left = x < SIZE / 2;
    let albedo = if is_left { Vec3::splat(0.8) } else { Vec3::new(0.5, 0.1, 0.0) };
    let (normal, irradiance, specular) = if y < SIZE / 2 { (Vec3::Z, 1.0, 0.1) } else { (Vec3::Y, 0.3, 0.5) };
    Seen { albedo, normal, irradiance: Vec3::splat(irradiance), specular: Vec3::splat(specular) }
}

/// Numbers of the samples of pixels, even in `[0, 1)`.
fn even(seed: usize) -> f32 {
    let mut bits = seed as u64 ^ 0x9E37_79B9_7F4A_7C15;
    for factor in [0xBF58_476D_1CE4_E5B9, 0x94D0_49BB_1331_11EB] {
        bits = (bits ^ bits >> 29).wrapping_mul(factor);
    }
    (bits >> 40) as f32 / (1 << 24) as f32
}

/// A picture whose samples are between 1 − noise and 1 + noise times what is seen, with its positions.
fn photographed(seen: impl Fn(usize, usize) -> Seen, noise: f32) -> (Frame, Vec<Vec3>, Vec<SampleSpread>) {
    let mut frame = Frame { width: SIZE, height: SIZE, ..Frame::default() };
    let (mut positions, mut spreads) = (Vec::new(), Vec::new());
    for at in 0..SIZE * SIZE {
        let (x, y) = (at % SIZE, at / SIZE);
        let (seen, mut spread) = (seen(x, y), SampleSpread::default());
        let (mut diffuse, mut specular) = (Vec3::ZERO, Vec3::ZERO);
        for sample in 0..SAMPLES {
            let factor = |part| 1.0 + noise * (2.0 * even((at * SAMPLES + sample) * 2 + part) - 1.0);
            let light = [seen.albedo * seen.irradiance * factor(0), seen.specular * factor(1)];
            spread.add(seen.albedo, light[0], light[1]);
            diffuse += light[0] / SAMPLES as f32;
            specular += light[1] / SAMPLES as f32;
        }
        let below = (y as f32 - (SIZE / 2) as f32).max(0.0);
        positions.push(Vec3::new(x as f32, (SIZE / 2) as f32 - y as f32 + below, below));
        spreads.push(spread);
        frame.color.push(diffuse + specular);
        frame.alpha.push(1.0);
        frame.diffuse.push(diffuse);
        frame.specular.push(specular);
        frame.albedo.push(seen.albedo);
        frame.normal.push(seen.normal);
        frame.depth.push(3.0);
    }
    (frame, positions, spreads)
}

/// Root mean square difference of two pictures, over pixels at which `counts` holds.
fn difference(a: &Frame, b: &Frame, counts: impl Fn(usize, usize) -> bool) -> f32 {
    let chosen: Vec<usize> = (0..SIZE * SIZE).filter(|at| counts(at % SIZE, at / SIZE)).collect();
    let sum: f32 = chosen.iter().map(|&at| a.color[at].distance_squared(b.color[at])).sum();
    (sum / chosen.len() as f32).sqrt()
}

#[test]
fn noise_goes_and_edges_of_albedo_and_normals_stay() {
    let truth = photographed(walls, 0.0).0;
    let (noisy, positions, spread) = photographed(walls, 0.5);
    let mut filtered = noisy.clone();
    denoise(&mut filtered, &positions, &spread);
    let all = |_: usize, _: usize| true;
    let (before, after) = (difference(&noisy, &truth, all), difference(&filtered, &truth, all));
    assert!(after < before / 3.0, "{before} became {after}");
    let middle = |k: usize| k.abs_diff(SIZE / 2) < 2;
    let at_edges = difference(&filtered, &truth, |x, y| middle(x) || middle(y));
    assert!(at_edges < before / 2.0, "{at_edges} at edges, {before} before");
    let guides = |frame: &Frame| (frame.alpha.clone(), frame.albedo.clone(), frame.depth.clone());
    assert!(guides(&filtered) == guides(&noisy) && filtered.normal == noisy.normal);
    let sum = |at: usize| filtered.diffuse[at] + filtered.specular[at];
    assert!((0..SIZE * SIZE).all(|at| filtered.color[at] == sum(at)));
}

#[test]
fn what_has_no_noise_stays_as_it_is() {
    let even = |_, _| walls(0, 0);
    for seen in [&even as &dyn Fn(usize, usize) -> Seen, &walls] {
        let (truth, positions, spread) = photographed(seen, 0.0);
        let mut filtered = truth.clone();
        denoise(&mut filtered, &positions, &spread);
        let largest = filtered.color.iter().zip(&truth.color).map(|(a, b)| (*a - *b).abs().max_element());
        assert!(largest.fold(0.0, f32::max) < 2e-6);
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let (noisy, positions, spread) = photographed(walls, 0.5);
    let filtered = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut frame = noisy.clone();
        pool.install(|| denoise(&mut frame, &positions, &spread));
        frame
    };
    assert!(filtered(1) == filtered(3));
}

#[test]
fn what_lies_around_the_object_is_not_mixed_in() {
    let (mut noisy, positions, mut spread) = photographed(|_, _| walls(0, 0), 0.3);
    let truth = photographed(|_, _| walls(0, 0), 0.0).0;
    let is_outside = |x: usize, y: usize| x < 10 || y == 30;
    for at in (0..SIZE * SIZE).filter(|at| is_outside(at % SIZE, at / SIZE)) {
        (noisy.alpha[at], noisy.albedo[at], noisy.normal[at]) = (0.0, Vec3::ZERO, Vec3::ZERO);
        (noisy.diffuse[at], noisy.specular[at], spread[at]) =
            (Vec3::ZERO, Vec3::ZERO, SampleSpread::default());
    }
    denoise(&mut noisy, &positions, &spread);
    let outside = (0..SIZE * SIZE).filter(|at| is_outside(at % SIZE, at / SIZE));
    assert!(outside.into_iter().all(|at| noisy.color[at] == Vec3::ZERO));
    let inside = difference(&noisy, &truth, |x, y| !is_outside(x, y));
    assert!(inside < 0.03, "{inside}");
}

#[test]
fn partly_covered_pixels_keep_their_coverage() {
    let (mut noisy, positions, mut spread) = photographed(|_, _| walls(0, 0), 0.3);
    let (middle, seen) = (SIZE * SIZE / 2 + SIZE / 2, walls(0, 0));
    let quarter = [seen.albedo * seen.irradiance / 4.0, seen.specular / 4.0];
    (noisy.alpha[middle], noisy.diffuse[middle], noisy.specular[middle]) = (0.25, quarter[0], quarter[1]);
    spread[middle] = SampleSpread::default();
    spread[middle].add(seen.albedo, 4.0 * quarter[0], 4.0 * quarter[1]);
    denoise(&mut noisy, &positions, &spread);
    let expected = quarter[0] + quarter[1];
    assert!(noisy.color[middle].distance(expected) < 0.03 * expected.length(), "{}", noisy.color[middle]);
}

#[test]
fn a_single_outlier_is_spread_out_and_nothing_is_lost_to_infinity() {
    let (mut noisy, positions, mut spread) = photographed(|_, _| walls(0, 0), 0.3);
    let (at, seen) = (SIZE * SIZE / 2 + SIZE / 2, walls(0, 0));
    let usual = noisy.specular[at].x;
    noisy.specular[at] += Vec3::splat(50.0);
    spread[at] = SampleSpread::default();
    for extra in [0.0, 0.0, 0.0, 200.0] {
        spread[at].add(seen.albedo, seen.albedo * seen.irradiance, seen.specular + extra);
    }
    denoise(&mut noisy, &positions, &spread);
    assert!(noisy.specular[at].x < usual + 15.0, "{}", noisy.specular[at]);
    assert!(noisy.color.iter().all(|color| color.is_finite()));
}
