// The second pass of sums over points: over the workgroups of the first, a workgroup for each row, in a fixed order.

// Length of a row. The rest is nothing: a uniform has a multiple of 16 bytes.
struct Size {
    length: u32,
    rest_0: u32,
    rest_1: u32,
    rest_2: u32,
}

@group(0) @binding(0) var<uniform> size: Size;
@group(0) @binding(1) var<storage, read> parts: array<f32>;
@group(0) @binding(2) var<storage, read_write> totals: array<f32>;

const GROUP = 64u;

var<workgroup> shares: array<f32, GROUP>;

@compute @workgroup_size(64)
fn sum(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = group.x;
    var part = 0.0;
    for (var k = lane; k < size.length; k += GROUP) {
        part += parts[row * size.length + k];
    }
    shares[lane] = part;
    workgroupBarrier();
    if (lane == 0u) {
        var total = 0.0;
        for (var k = 0u; k < GROUP; k++) {
            total += shares[k];
        }
        totals[row] = total;
    }
}
