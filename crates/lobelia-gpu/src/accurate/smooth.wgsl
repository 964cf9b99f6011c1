// Lobes over which the BRDF is smooth: the irradiance of the lobe, times the mean of the BRDF in four directions, and its adjoint;
// `lobelia_sg::accurate::smooth`.

// Least ratio of the curvatures of light and BRDF; L from which on no lobe is taken for smooth; curvature of all but the NDF.
const LEAST_SG = 4.0;
const GLOSSY = 25.0;
const REST = 4.0;
// Least (n·ξ)²λ of a lobe above the horizon, and least k²λ of others.
const HEIGHT = 2.9;
const SOFTNESS = 1.5;
// Where the horizon is so far below that nothing is clipped.
const HIGHEST = 100.0;
// Where it is so far above that next to nothing is left.
const LOWEST = -3.2;
// Half the weight of two directions, over the BRDF's 4.
const SHARE = 0.125;
// ln 2/2.
const HALF_LN_2 = 0.34657359027997264;

// How far a lobe is within what this rule needs; above 0 the lobe is smooth.
fn smoothness(point: Point, light: LocalLight) -> f32 {
    let cosine = light.axis.z;
    // r·ξ for the mirrored view r, 1 − r·ξ and 1 + v·ξ.
    let mirrored = dot(vec3(-point.view.x, 0.0, point.view.y), light.axis);
    let fading = relu(1.0 - mirrored);
    let facing = cosine * point.view.y * 2.0 - mirrored + 1.0;
    let steep = point.sharpness * fading * 0.25 + 1.0;
    let curved = light.sharpness * facing * 2.0 - fma(steep, point.sharpness, REST) * LEAST_SG;
    let high = fma(relu(cosine) * cosine, light.sharpness, -HEIGHT);
    let soft = fma(point.k * point.k, light.sharpness, -SOFTNESS);
    return min(max(high, soft), min(curved, GLOSSY - point.sharpness));
}

// The directions around a lobe.
struct Ring {
    axis: vec3<f32>,
    // Unit vectors across the axis, toward the normal and level.
    toward: vec3<f32>,
    level: vec2<f32>,
    // 1/√λ.
    width: f32,
    // Sine of the angle between axis and normal.
    sine: f32,
    // Position of the axis above the horizon in units of the width.
    height: f32,
    // Positions along `toward` in units of the width, and weights.
    offsets: vec2<f32>,
    weights: vec2<f32>,
}

// Gauss's rule of two nodes for v·e^(−(v − t)²/2) on v > 0: v − t, and weights.
fn two_nodes(t: f32) -> vec4<f32> {
    let square = fma(t, t, 4.0);
    let over_root = inverseSqrt(square);
    let tau = t * over_root;
    let a = fma(square, over_root, -t) * 0.5;
    let x = vec3(tau);
    var p = fma(vec3(0.39004127, 0.32586162, 0.08087648), x, vec3(-0.052472423, -0.21379183, 0.0076033717));
    p = fma(p, x, vec3(-0.48047788, -0.13100331, -0.12418148));
    p = fma(p, x, vec3(-0.2507373, -0.18360849, -0.032522302));
    p = fma(p, x, vec3(-0.38990615, 0.053427626, -0.085341476));
    p = fma(p, x, vec3(-0.22558696, 1.1455448, 0.65104744));
    return vec4(a + p.x, a + p.y, p.z, 1.0 - p.z);
}

fn ring_of(light: LocalLight) -> Ring {
    let axis = light.axis;
    let square = max(dot(axis.xy, axis.xy), 1e-12);
    let over_sine = inverseSqrt(square);
    let sine = square * over_sine;
    // For an axis along the normal any direction is level.
    let plane = vec2(select(axis.x * over_sine, 1.0, square < 1.1e-12), axis.y * over_sine);
    let width = inverseSqrt(light.sharpness);
    let height = clamp(axis.z * light.sharpness * width * over_sine, LOWEST, HIGHEST);
    let nodes = two_nodes(height);
    return Ring(
        axis, vec3(-plane * axis.z, sine), vec2(-plane.y, plane.x), width, sine, height, nodes.xy, nodes.zw,
    );
}

// A direction of the ring, and |X|²/2 there.
struct Outward {
    direction: vec3<f32>,
    bend: f32,
}

fn outward_of(ring: Ring, n: u32) -> Outward {
    let u = ring.offsets[n / 2u];
    let bend = fma(u, u, 1.0) * ring.width * ring.width * 0.5;
    // √(1 − |X|²/4).
    let root = fma(bend, bend * (-1.0 / 32.0) - 0.25, 1.0);
    let center = ring.axis * (1.0 - bend) + ring.toward * (root * u * ring.width);
    let side = ring.level * (root * ring.width * select(1.0, -1.0, n % 2u == 1u));
    return Outward(center + vec3(side, 0.0), bend);
}

// The BRDF in one direction, times the direction's weight, without the factors of the point and without F.
struct Reading {
    half: vec3<f32>,
    // 1 − h·n.
    drop: f32,
    // 1/(n·ω(1 − k) + k).
    shadowing: f32,
    // 1/|v + ω|, v·ω and v·h.
    over_sum: f32,
    view_cosine: f32,
    view_half: f32,
    value: f32,
    fresnel: f32,
}

fn reading_of(point: Point, direction: vec3<f32>, weight: f32) -> Reading {
    let view = vec3(point.view.x, 0.0, point.view.y);
    // |v + ω|²/2 = 1 + v·ω = 2(v·h)².
    let view_cosine = fma(view.x, direction.x, view.z * direction.z);
    let half_square = max(view_cosine + 1.0, 1e-6);
    let over_sum = inverseSqrt(half_square * 2.0);
    let half = (view + direction) * over_sum;
    let view_half = half_square * over_sum;
    let drop = dot(half.xy, half.xy) / (half.z + 1.0);
    let shadowing = 1.0 / fma(relu(direction.z), 1.0 - point.k, point.k);
    let value = shadowing * weight * decay(-(point.sharpness * drop));
    return Reading(half, drop, shadowing, over_sum, view_cosine, view_half, value, fresnel_power(view_half));
}

// The specular light of a smooth lobe for specular albedo s, `constant + slope·s`, given its irradiance.
fn smooth_light(point: Point, light: LocalLight, irradiance: f32) -> vec2<f32> {
    let ring = ring_of(light);
    var powered = 0.0;
    var plain = 0.0;
    for (var n = 0u; n < 4u; n++) {
        let reading = reading_of(point, outward_of(ring, n).direction, ring.weights[n / 2u]);
        plain += reading.value;
        powered = fma(reading.value, reading.fresnel, powered);
    }
    return vec2(powered, plain - powered) * (point.scale * irradiance * SHARE);
}

// Light, and the adjoints of axis, sharpness and the terms of the point.
struct SpecularBack {
    light: vec2<f32>,
    axis: vec3<f32>,
    sharpness: f32,
    sums: Sums,
}

// As `smooth_light`, with the adjoints; the directions move with the lobe.
fn pull_back_smooth(point: Point, light: LocalLight, irradiance: Dual, adjoint: vec2<f32>) -> SpecularBack {
    let ring = ring_of(light);
    let scale = point.scale * irradiance.value * SHARE;
    let shares = vec2(adjoint.x - adjoint.y, adjoint.y) * scale;
    let view = vec3(point.view.x, 0.0, point.view.y);
    var powered = 0.0;
    var plain = 0.0;
    var total = 0.0;
    // Direction × gradient of the logarithm of the BRDF there; and that gradient times the way of the direction from the axis.
    var torque = vec3(0.0);
    var outward = 0.0;
    var normal = vec2(0.0);
    var shadowing = 0.0;
    var drop = 0.0;
    for (var n = 0u; n < 4u; n++) {
        let at = outward_of(ring, n);
        let reading = reading_of(point, at.direction, ring.weights[n / 2u]);
        let cosine = relu(at.direction.z);
        let bright = reading.value * reading.fresnel;
        plain += reading.value;
        powered += bright;
        let share = bright * shares.x;
        let value = fma(reading.value, shares.y, share);
        total += value;
        let falls = reading.shadowing * (1.0 - point.k);
        let pull = point.sharpness * reading.over_sum;
        let rising = value * (pull - falls);
        // d(ln of the Fresnel power)/d(v·h) = −ln 2·(2·5.55473 v·h + 6.8316), and d(v·h) = v·dω/(2|v + ω|).
        let glancing = fma(reading.view_half, 11.10946, 6.8316) * HALF_LN_2;
        let seen = reading.over_sum * fma(value * pull, reading.half.z, share * glancing);
        torque += cross(at.direction, vec3(0.0, 0.0, rising) - seen * view);
        let twice = at.bend + 1.0;
        let rise = cosine - twice * light.axis.z;
        outward += rising * rise - seen * (reading.view_cosine - twice * dot(view, light.axis));
        normal += value * point.sharpness * reading.half.xy - value * falls * at.direction.xy;
        shadowing = fma(value * reading.shadowing, 1.0 - cosine, shadowing);
        drop = fma(value, reading.drop, drop);
    }
    let per_light = total / max(irradiance.value, 1e-20);
    let tilt = per_light * irradiance.by_cosine;
    let toward = -dot(torque.xy, ring.level);
    let level = dot(torque, ring.toward);
    let apart = ring.offsets.y - ring.offsets.x;
    let follow = toward * ring.weights.x * ring.weights.y * apart * apart;
    let left = toward - follow;
    let spreading = fma(left * ring.height, ring.width, outward) * ring.width * ring.width * 0.5;
    let turn = tilt - left / ring.sine;
    return SpecularBack(
        vec2(powered, plain - powered) * scale,
        in_world(point, follow * ring.toward + vec3(level * ring.level, tilt)),
        per_light * irradiance.by_sharpness - spreading,
        Sums(normal + turn * light.axis.xy, -shadowing, vec2(total / point.sharpness - drop, total)),
    );
}
