// Adjoint of points, one thread each, and of what they share: `lobelia_sg::shading::adjoint`.
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
    let first = column * PITCH;
    for (var k = first; k < first + GROUP; k += 4u) {
        sum += (shares[k] + shares[k + 1u]) + (shares[k + 2u] + shares[k + 3u]);
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

// A thread and its point: adjoints of diffuse light and of each specular term, per channel.
struct Thread {
    i: u32,
    lane: u32,
    kd: vec3<f32>,
    ks: mat2x3<f32>,
}

// Sums over the lobes.
struct Totals {
    diffuse: vec3<f32>,
    specular: mat2x3<f32>,
    sums: Sums,
}

// Adds a lobe to the sums of a point, and puts its gradient into the tile that begins with `first`.
fn add_lobe(thread: Thread, point: Point, l: u32, first: u32, totals: Totals) -> Totals {
    let lobe = lobes[l];
    let mu = lobe.amplitude;
    let kd = thread.kd;
    let ks = thread.ks;
    let reached = reaching(thread.i, l);
    let given = Response(dot(kd, mu) * reached, vec2(dot(ks[0], mu), dot(ks[1], mu)));
    let back = pull_back(point, lobe, given);
    let irradiance = back.response.diffuse * reached;
    let specular = back.response.specular;
    share(l - first, thread.lane, back, kd * irradiance + ks[0] * specular.x + ks[1] * specular.y);
    let terms = mat2x3(totals.specular[0] + mu * specular.x, totals.specular[1] + mu * specular.y);
    return Totals(totals.diffuse + mu * irradiance, terms, add_sums(totals.sums, back.sums));
}

// Sums over the lobes; those over the points of each tile go to `parts`.
fn add_lobes(thread: Thread, point: Point, group: u32, groups: u32) -> Totals {
    var totals = Totals(vec3(0.0), mat2x3<f32>(), no_sums());
    for (var first = 0u; first < call.lobes; first += TILE) {
        for (var l = first; l < min(first + TILE, call.lobes); l++) {
            totals = add_lobe(thread, point, l, first, totals);
        }
        workgroupBarrier();
        let column = first * COLUMNS + thread.lane;
        if (thread.lane < TILE * COLUMNS && column < call.lobes * COLUMNS) {
            parts[column * groups + group] = sum_of(thread.lane);
        }
        workgroupBarrier();
    }
    return totals;
}

// Sums the adjoints of the specular material over the workgroup.
fn add_material(lane: u32, back: PointBack, group: u32, groups: u32) {
    shares[lane] = back.albedo.x;
    shares[lane + PITCH] = back.albedo.y;
    shares[lane + 2u * PITCH] = back.albedo.z;
    shares[lane + 3u * PITCH] = back.roughness;
    workgroupBarrier();
    if (lane < 4u) {
        parts[(call.lobes * COLUMNS + lane) * groups + group] = sum_of(lane);
    }
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
    var around = around_point(i);
    if (id.x >= call.points || is_missed(surface)) {
        surface = Surface(vec3(0.0, 0.0, 1.0), vec3(0.0, 0.0, 1.0), vec3(0.0));
        adjoint = LayersAdjoint(vec3(0.0), vec3(0.0));
        around = Around(vec3(0.0), vec3(0.0));
    }
    let prepared = prepare_point(surface.normal, surface.to_viewer, call.roughness);
    let weights = specular_weights(prepared.frozen, call.albedo);
    let of_specular = adjoint.specular * around.specular;
    let kd = adjoint.diffuse * surface.albedo / PI;
    let thread = Thread(i, lane, kd, mat2x3(of_specular * weights[0], of_specular * weights[1]));
    let totals = add_lobes(thread, prepared.point, group.x, groups.x);
    let light = mat2x3(of_specular * totals.specular[0], of_specular * totals.specular[1]);
    let end = PointEnd(surface.normal, surface.to_viewer, call.albedo, light);
    let back = pull_back_point(prepared, totals.sums, end);
    if (id.x < call.points) {
        point_adjoint[i] = PointAdjoint(adjoint.diffuse / PI * (totals.diffuse + around.indirect), back.normal);
    }
    add_material(lane, back, group.x, groups.x);
}
