// What the loops exchange with a model, which defines `Point`, `Frozen` and `Sums`: `lobelia_sg::model` with two specular terms.

// A light lobe with the terms of its sharpness.
struct Lobe {
    axis: vec3<f32>,
    sharpness: f32,
    amplitude: vec3<f32>,
    terms: array<vec4<f32>, 2>,
}

// A function of sharpness and cosine, with its partial derivatives.
struct Dual {
    value: f32,
    by_sharpness: f32,
    by_cosine: f32,
}

// The light of one pair for unit amplitude: irradiance, and two specular terms.
struct Response {
    diffuse: f32,
    specular: vec2<f32>,
}

// A response, and the adjoints of axis, sharpness and the terms of the point.
struct PulledBack {
    response: Response,
    axis: vec3<f32>,
    sharpness: f32,
    sums: Sums,
}

// The terms of a point, and those that only its weights and the last part of its adjoint read.
struct Prepared {
    point: Point,
    frozen: Frozen,
}

// The inputs of the last part of the adjoint of a point: normal, view, specular albedo, and per specular term and channel the adjoint
// of the channel's radiance × Σ over lobes of μ·specular.
struct PointEnd {
    normal: vec3<f32>,
    to_viewer: vec3<f32>,
    albedo: vec3<f32>,
    specular_light: mat2x3<f32>,
}

// Adjoints of the normal, the specular albedo and the roughness.
struct PointBack {
    normal: vec3<f32>,
    albedo: vec3<f32>,
    roughness: f32,
}
