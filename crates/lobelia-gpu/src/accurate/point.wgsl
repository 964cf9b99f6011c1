// The terms of a surface point and its specular lobe, and the last part of the adjoint of a point:
// `lobelia_sg::accurate::point` with one SG for the NDF.

struct Point {
    // Tangent (in the plane of normal and view), bitangent and normal.
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
    normal: vec3<f32>,
    // View direction along tangent and normal, the latter at least 0.
    view: vec2<f32>,
    // k of the shadowing term G (PhySG supp. eqs. 1–7).
    k: f32,
    // Sharpness L of the NDF (PhySG supp. eq. 4) in h.
    sharpness: f32,
    // Position along the tangent, in the chart, of the peak of the NDF times (n·ω)(v·h).
    start: f32,
    // The factors of the integrand that do not depend on ω; 0 for a viewer below the horizon.
    scale: f32,
}

// dk/dR and dL/dR.
struct Frozen {
    shadowing: f32,
    slope: f32,
}

// Adjoints of the normal, along tangent and bitangent, at fixed n·v; of k, through n·ω only; of the sharpness and the logarithm of the
// weight of the NDF.
struct Sums {
    normal: vec2<f32>,
    shadowing: f32,
    ndf: vec2<f32>,
}

// The part of `v` across the normal.
fn reject(normal: vec3<f32>, v: vec3<f32>) -> vec3<f32> {
    return v - normal * dot(normal, v);
}

// Tangent of a unit normal, in the plane of normal and view. For a view along the normal any is valid. The rejection is applied twice,
// because a short one is not exactly perpendicular.
fn tangent_towards(normal: vec3<f32>, to_viewer: vec3<f32>) -> vec3<f32> {
    var tangent = reject(normal, to_viewer);
    if (dot(tangent, tangent) < 1e-8) {
        tangent = reject(normal, select(vec3(0.0, 1.0, 0.0), vec3(1.0, 0.0, 0.0), normal.x * normal.x < 0.5));
    }
    tangent = reject(normal, tangent / sqrt(dot(tangent, tangent)));
    return tangent / sqrt(dot(tangent, tangent));
}

// The terms that depend on the point and the specular material but not on the light.
fn prepare_point(normal: vec3<f32>, to_viewer: vec3<f32>, roughness: f32) -> Prepared {
    let tangent = tangent_towards(normal, to_viewer);
    let up = dot(normal, to_viewer);
    let view = vec2(relu(dot(tangent, to_viewer)), relu(up));
    let k = shadowing_k(roughness);
    let masked = select(0.0, 0.5 / (PI * (view.y * (1.0 - k.x) + k.x)), up > 0.0);
    let sharpness = ndf_sharpness(roughness);
    // The maximum of 2 ln(v·h) − L|X|²/2 along the tangent, to first order in X.
    let steep = sharpness * view.y;
    let root = sqrt(steep * steep + sharpness * view.x * view.x * 8.0);
    let start = min(view.x * 4.0 / max(steep + root, 1e-6), 1.0);
    let bitangent = cross(normal, tangent);
    let point = Point(tangent, bitangent, normal, view, k.x, sharpness, start, masked * sharpness);
    return Prepared(point, Frozen(k.y, -4.0 * sharpness / roughness));
}

fn in_frame(point: Point, v: vec3<f32>) -> vec3<f32> {
    return vec3(dot(point.tangent, v), dot(point.bitangent, v), dot(point.normal, v));
}

fn in_world(point: Point, v: vec3<f32>) -> vec3<f32> {
    return point.tangent * v.x + point.bitangent * v.y + point.normal * v.z;
}

// Adjoints of a point's normal (along its tangent plane), specular albedo and roughness, given the sums over lobes.
fn pull_back_point(prepared: Prepared, sums: Sums, end: PointEnd) -> PointBack {
    let point = prepared.point;
    // The factor 1/(n·v(1 − k) + k) of the viewer.
    let inverse = sums.ndf.y / (point.view.y * (1.0 - point.k) + point.k);
    let shadowing = sums.shadowing - inverse * (1.0 - point.view.y);
    let roughness = sums.ndf.x * prepared.frozen.slope + shadowing * prepared.frozen.shadowing;
    let along = sums.normal.x - inverse * (1.0 - point.k) * point.view.x;
    let normal = point.tangent * along + point.bitangent * sums.normal.y;
    return PointBack(normal, end.specular_light[1], roughness);
}
