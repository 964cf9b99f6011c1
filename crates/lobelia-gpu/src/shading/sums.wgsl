// The second pass of sums over points: over the workgroups of the first, a workgroup for each row, in a fixed order.

// Number of rows and their length.
struct Size {
    rows: u32,
    length: u32,
    // Nothing: a uniform has a multiple of 16 bytes.
    rest: vec2<u32>,
}

@group(0) @binding(0) var<uniform> size: Size;
@group(0) @binding(1) var<storage, read> parts: array<f32>;
@group(0) @binding(2) var<storage, read_write> totals: array<f32>;

const GROUP = 64u;

var<workgroup> shares: array<f32, GROUP>;

@compute @workgroup_size(64)
fn sum(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = group.y * groups.x + group.x;
    var part = 0.0;
    if (row < size.rows) {
        for (var k = lane; k < size.length; k += GROUP) {
            part += parts[row * size.length + k];
        }
    }
    shares[lane] = part;
    workgroupBarrier();
    if (lane == 0u && row < size.rows) {
        var total = 0.0;
        for (var k = 0u; k < GROUP; k++) {
            total += shares[k];
        }
        totals[row] = total;
    }
}
