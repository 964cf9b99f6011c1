// The inputs of the loops over points and lobes.

struct Call {
    // Specular albedo and roughness.
    albedo: vec3<f32>,
    roughness: f32,
    points: u32,
    lobes: u32,
    // Words of a point's row of visibility; 0 if all light reaches all points.
    words: u32,
    // Whether there is an entry of `around` for each point.
    occluded: u32,
}

// A surface point; a zero normal marks a ray without a hit.
struct Surface {
    normal: vec3<f32>,
    to_viewer: vec3<f32>,
    albedo: vec3<f32>,
}

// The part of the visibility of a point that does not depend on the lobe.
struct Around {
    specular: vec3<f32>,
    indirect: vec3<f32>,
}

@group(0) @binding(0) var<uniform> call: Call;
@group(0) @binding(1) var<storage, read> surfaces: array<Surface>;
@group(0) @binding(2) var<storage, read> lobes: array<Lobe>;
// One row of bytes per point: the fraction of each lobe's irradiance that reaches it, 0 to 255.
@group(0) @binding(3) var<storage, read> visible: array<u32>;
@group(0) @binding(4) var<storage, read> surroundings: array<Around>;

// The fraction of a lobe's irradiance that reaches a point.
fn reaching(i: u32, lobe: u32) -> f32 {
    if (call.words == 0u) {
        return 1.0;
    }
    let word = visible[i * call.words + lobe / 4u];
    return f32((word >> (lobe % 4u * 8u)) & 255u) * (1.0 / 255.0);
}

fn around_point(i: u32) -> Around {
    if (call.occluded == 0u) {
        return Around(vec3(1.0), vec3(0.0));
    }
    return surroundings[i];
}

fn is_missed(surface: Surface) -> bool {
    return all(surface.normal == vec3(0.0));
}
