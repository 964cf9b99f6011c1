// Adjoint of points, one thread each, and of what they share: `lobelia_math::shading::adjoint`.
//
// A workgroup sums what its points contribute to the lobes in a fixed order, for `TILE` lobes at a time.

// Adjoints of the layers of a point, 0 in channels that are clamped to zero.
struct LayersAdjoint {
    diffuse: vec3<f32>,
    specular: vec3<f32>,
}

// Adjoints of the inputs of a point.
struct PointAdjoint {
    albedo: vec3<f32>,
    normal: vec3<f32>,
}

@group(0) @binding(5) var<storage, read> layers_adjoint: array<LayersAdjoint>;
@group(0) @binding(6) var<storage, read_write> point_adjoint: array<PointAdjoint>;
// A row of workgroups for each of the columns of all lobes, and for specular albedo (3) and roughness.
@group(0) @binding(7) var<storage, read_write> parts: array<f32>;

// Points of a workgroup, the lobes that are summed together, and columns of a lobe.
const GROUP = 64u;
const TILE = 8u;
const COLUMNS = 7u;
// Length of a column of `shares`: odd, so that threads which read one column each use different banks.
const PITCH = 65u;

var<workgroup> shares: array<f32, TILE * COLUMNS * PITCH>;

// Sum of a column over the workgroup.
fn sum_of(column: u32) -> f32 {
    var sum = 0.0;
    for (var k = 0u; k < GROUP; k++) {
        sum += shares[column * PITCH + k];
    }
    return sum;
}

// Puts the gradient of a lobe into the columns of its place in the tile.
fn share(place: u32, lane: u32, back: PulledBack, color: vec3<f32>) {
    let at = place * COLUMNS * PITCH + lane;
    shares[at] = back.axis.x;
    shares[at + PITCH] = back.axis.y;
    shares[at + 2u * PITCH] = back.axis.z;
    shares[at + 3u * PITCH] = back.sharpness;
    shares[at + 4u * PITCH] = color.x;
    shares[at + 5u * PITCH] = color.y;
    shares[at + 6u * PITCH] = color.z;
}

@compute @workgroup_size(64)
fn shade_adjoint(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    // A thread without a point takes part with adjoints of zero.
    let i = min(id.x, call.points - 1u);
    var surface = surfaces[i];
    var adjoint = layers_adjoint[i];
    let live = id.x < call.points && !is_missed(surface);
    if (!live) {
        surface = Surface(vec3(0.0, 0.0, 1.0), vec3(0.0, 0.0, 1.0), vec3(0.0));
        adjoint = LayersAdjoint(vec3(0.0), vec3(0.0));
    }
    let around = around_point(i);
    let prepared = prepare_point(surface.normal, surface.to_viewer, call.roughness);
    let weights = specular_weights(prepared.frozen, call.albedo);
    let specular_adjoint = select(vec3(0.0), adjoint.specular * around.specular, live);
    let kd = adjoint.diffuse * surface.albedo / PI;
    let ks = mat2x3(specular_adjoint * weights[0], specular_adjoint * weights[1]);
    var diffuse = vec3(0.0);
    var specular = mat2x3<f32>();
    var sums = no_sums();
    for (var first = 0u; first < call.lobes; first += TILE) {
        for (var l = first; l < min(first + TILE, call.lobes); l++) {
            let lobe = lobes[l];
            let reached = reaching(i, l);
            let mu = lobe.amplitude;
            let given = Response(dot(kd, mu) * reached, vec2(dot(ks[0], mu), dot(ks[1], mu)));
            let back = pull_back(prepared.point, lobe, given);
            let response = back.response;
            let irradiance = response.diffuse * reached;
            diffuse += mu * irradiance;
            specular[0] += mu * response.specular.x;
            specular[1] += mu * response.specular.y;
            sums = add_sums(sums, back.sums);
            share(l - first, lane, back, kd * irradiance + ks[0] * response.specular.x + ks[1] * response.specular.y);
        }
        workgroupBarrier();
        let column = first * COLUMNS + lane;
        if (lane < TILE * COLUMNS && column < call.lobes * COLUMNS) {
            parts[column * groups.x + group.x] = sum_of(lane);
        }
        workgroupBarrier();
    }
    let light = mat2x3(specular_adjoint * specular[0], specular_adjoint * specular[1]);
    let end = pull_back_point(prepared, sums, PointEnd(surface.normal, surface.to_viewer, call.albedo, light));
    if (id.x < call.points) {
        let albedo = adjoint.diffuse / PI * (diffuse + around.indirect);
        point_adjoint[i] = PointAdjoint(select(vec3(0.0), albedo, live), select(vec3(0.0), end.normal, live));
    }
    shares[lane] = select(0.0, end.albedo.x, live);
    shares[lane + PITCH] = select(0.0, end.albedo.y, live);
    shares[lane + 2u * PITCH] = select(0.0, end.albedo.z, live);
    shares[lane + 3u * PITCH] = select(0.0, end.roughness, live);
    workgroupBarrier();
    if (lane < 4u) {
        parts[(call.lobes * COLUMNS + lane) * groups.x + group.x] = sum_of(lane);
    }
}
